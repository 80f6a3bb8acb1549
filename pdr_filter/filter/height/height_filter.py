"""Height filter: height above the start and storeys, from barometer, steps and contexts.

With a barometer, each second of pressure is explained by seven modes of vertical motion (`vertical_modes`). The height
is the sum of climbed and sloped metres. Storeys depend on the climbed metres alone (`floor_detection`), so that neither
a hill nor the weather changes the storey. Without a barometer, each step climbs one riser with the probability that it
was made on stairs, as given by the mode probabilities of the track.

Height is estimated by a separate filter and is not a state of the tracker, because it needs modes such as a lift, and
changes while the person stands.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdr_filter.filter.height import vertical_modes as vertical
from pdr_filter.filter.height.floor_detection import (
    LEVEL_STD_M,
    USUAL_STOREY_M,
    Climbing,
    FloorState,
    Level,
    Position,
    after_motion,
    floors_at_end,
    floors_numbered_from,
    known_level,
    level_of,
    on_storey,
    with_level,
    with_new_level,
)
from pdr_filter.filter.height.vertical_modes import DOWN, DRIFT, JUMP, LIFT, N_MODES, UP
from pdr_filter.sensing.features.barometer import RISER_M, ClimbState
from pdr_filter.values import (
    Context,
    ContextSet,
    FloatArray,
    FloorPassage,
    GridFix,
    Note,
    Origin,
    PositionFix,
    WindowContext,
    repetition,
    replace_unchecked,
)
from pdr_filter.values.events import Climb
from pdr_filter.values.uncertainty import is_floor_unknown, variance_factor

# Longest ride in a lift or on an escalator. Aircraft cabins, trains and cable cars take longer.
LONGEST_RIDE_S = 120.0
# A vehicle has been left when the climb rate has been below this limit, half of that of a ride, for this time.
CALM_MPS, CALM_S = 0.1, 10.0

# Gate of a known level: 99 % quantile of chi-square with one degree of freedom. Beyond it the stay is on another level.
_LEVEL_GATE = 6.6
# Without a barometer the errors of all steps of a flight, a dozen, are equal.
_FLIGHT_STEPS = 12
_RISER_STD_M = 0.01
# Random walk of the height by unmeasured slopes, per root second: 0.4 m in a minute of walking.
_UNMEASURED_SLOPE_M = 0.05
# Random walk of the height by kerbs and single stairs, where stairs cannot be recognised, per root second.
_UNMEASURED_STAIRS_M = 0.14
# Steps on stairs that cannot be recognised (phone in the hand): a share of all steps goes up or down, as in the labels
# of terrain (flights of 6.3 s, level stretches of 33 s), and a person climbs three storeys of 22 steps in one direction
# before the direction is independent of the first one.
_UNSEEN_SHARE, _UNSEEN_STEPS = 0.16, 66
# Variance of the height that a second without a step adds by an unseen lift: one of two hundred waits of 30 s is a ride
# of four storeys.
_UNSEEN_LIFT_M2 = 0.04
# Limit of the variance by unseen climbs, because buildings have few storeys: four storeys of 3.8 m.
_UNSEEN_MOST_M2 = (4 * USUAL_STOREY_M) ** 2
# Standard deviation of the height of a storey that has not been visited: storeys have 2.6 to 5.5 m.
_STOREY_STD_M = 0.7
# Age of the last pressure from which steps are processed without a barometer.
PRESSURE_AGE_S = 4.0
# Largest delay of a step by the step gate. For this time a second of the barometer may still receive steps.
LATE_S = 6.0
# Change of the air from which a warning is issued: 5 hPa, more than the weather of some hours.
_NOTABLE_AIR_M = 40.0
_M_PER_HPA = 8.3


@dataclass(frozen=True, eq=False)
class Altitude:
    """Estimated altitude of the start, from fixes with an altitude."""

    altitude_m: float = np.nan  # altitude of the start, or NaN
    var_m2: float = np.inf  # variance of the altitude, infinite before the first fix with an altitude
    last_s: float = -np.inf  # time of the last fix

    def of(self, origin: Origin) -> Origin:
        """Return an origin with this altitude, or the unchanged origin if the altitude is unknown."""
        if math.isinf(self.var_m2):
            return origin
        return dataclasses.replace(origin, height_m=self.altitude_m, height_std_m=math.sqrt(self.var_m2))

    def with_fix(self, fix: PositionFix, height_m: float, height_var_m2: float) -> Altitude:
        """Return the altitude of the start after a fix with an altitude.

        `height_m` is the height above the start, with the variance `height_var_m2`. The variance of an unexpected
        altitude is increased as for Student's t errors (`variance_factor`). Raises ValueError for a fix
        without an altitude.
        """
        if fix.altitude_m is None or fix.altitude_std_m is None:
            raise ValueError(f"fix has no altitude, got {fix}: give altitude_m and altitude_std_m")
        var = repetition(fix, self.last_s) * fix.altitude_std_m**2 + height_var_m2
        altitude_m = fix.altitude_m - height_m
        if math.isinf(self.var_m2):
            return Altitude(altitude_m, var, fix.time_s)
        innovation_m = altitude_m - self.altitude_m
        var *= variance_factor(innovation_m**2 / (self.var_m2 + var), 1)
        gain = self.var_m2 / (self.var_m2 + var)
        return Altitude(self.altitude_m + gain * innovation_m, (1.0 - gain) * self.var_m2, fix.time_s)


@dataclass(frozen=True, eq=False)
class HeightEstimate:
    """Height estimate at one time.

    The air state is the part of the pressure height that changes by weather and draughts and not by motion.
    """

    # (7, 5, 5) moments p E[y y'] of the seven vertical modes (`vertical_modes`). p is the probability of a mode, and y
    # = (1, climbed, rate, sloped, air) is its state.
    moments: FloatArray
    climbed_m: float = 0.0  # height climbed on stairs, lifts and escalators since the start
    height_m: float = 0.0  # height above the start, including slopes
    height_var_m2: float = 0.0  # variance of `height_m`
    pressure_s: float = np.nan  # time of the most recent one-second mean of the barometer
    ride: tuple[float, float] | None = None  # start of the present ride, and the climbed height at its start
    # Time for which the pressure must still be calm until a vehicle counts as left, or 0 outside a vehicle.
    calm_in_s: float = 0.0
    first_air_m: float = np.nan  # first estimate of the air state, or NaN before it
    most_air_m: float = 0.0  # largest difference of the air state from `first_air_m`
    floors: FloorState = field(default_factory=FloorState)  # estimate of the storey

    @property
    def height_std_m(self) -> float:
        """Standard deviation of the height, m."""
        return _std(self.height_var_m2)


@dataclass(frozen=True, eq=False)
class PressureSecond:
    """One second of the barometer, and the estimate before it."""

    before: HeightEstimate  # estimate before this second
    climb: Climb  # pressure height and climb rate
    log_evidence: FloatArray  # (7,) log evidence of the context windows that ended in this second
    n_steps: int  # number of steps in this second
    position: Position | None = None  # position of an accurate location in this second


@dataclass(frozen=True, eq=False)
class HeightState:
    """State of the height filter."""

    known: HeightEstimate  # present estimate
    recent: tuple[PressureSecond, ...] = ()  # last seconds, oldest first, which late steps can still change
    # Log evidence of windows since the last second
    log_evidence: FloatArray = field(default_factory=lambda: np.zeros(N_MODES))
    n_steps: int = 0  # number of steps since the last second
    step_s: float = np.nan  # time of the last step
    # Steps since the last measurement of the height, each counted with its `stairs_unknown_share`
    n_unseen: float = 0.0
    # Dissimilarity of the last window to the stairs of the training data, 0 to 1. At 1, the context probabilities give
    # no evidence of stairs.
    stairs_unknown_share: float = 0.0
    start_altitude: Altitude = field(default_factory=lambda: Altitude())  # altitude of the start


def initial_height() -> HeightState:
    """Return the state of the height filter at the start, where the height is zero."""
    return HeightState(HeightEstimate(vertical.initial()))


def mode_log_evidence(context_evidence: FloatArray, context_set: ContextSet) -> FloatArray:
    """Return the log evidence (W, 7) of W windows for the seven vertical modes, from that of their contexts, (W, C).

    The modes are level ground, slope, stairs up, stairs down, lift, sudden change of the air, and drift of the air. The
    evidence is 0 for a window without probabilities. The climb rate of a window is not used, because the barometer is
    a separate measurement.
    """
    any_context = context_evidence.max(axis=1)

    def best_of(holds: Callable[[Context], bool], otherwise: FloatArray) -> FloatArray:
        """Return the highest log evidence (W,) of the contexts for which `holds` (context) is True.

        If `holds` is False for all contexts, the result is `otherwise` (W,).
        """
        index = context_set.index_where(holds)
        return context_evidence[:, index].max(axis=1) if len(index) else otherwise

    walking = best_of(lambda c: c.moves and c.climbs == 0, any_context)
    standing = best_of(lambda c: not c.moves and c.climbs == 0, any_context)
    # a context model without stairs classifies them as level walking
    up, down = best_of(lambda c: c.climbs > 0, walking), best_of(lambda c: c.climbs < 0, walking)
    either = np.maximum(walking, standing)
    mode_evidence = np.column_stack([either, walking, up, down, standing, either, standing])
    mode_evidence[~np.isfinite(mode_evidence).all(axis=1)] = 0.0  # window without probabilities
    return mode_evidence


def on_window(state: HeightState, window: WindowContext, log_evidence: FloatArray | None) -> HeightState:
    """Return the state of the height filter after a context window.

    With a barometer, `log_evidence` (7,) is the `mode_log_evidence` of the window. It is used with the next second of
    the barometer. Without a barometer it is None.
    """
    if log_evidence is not None and state.recent:
        log_evidence = state.log_evidence + log_evidence
        return replace_unchecked(state, stairs_unknown_share=window.stairs_unknown_share, log_evidence=log_evidence)
    return replace_unchecked(state, stairs_unknown_share=window.stairs_unknown_share)


def on_pressure(
    state: HeightState, climb: Climb, step_log_odds: float, position: Position | None = None
) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """Return the state of the height filter after a second of the barometer, and the now certain floor passages.

    A passage is certain when no late step can change it. `position` is an accurate location in that second, or None.
    """
    second = PressureSecond(state.known, climb, state.log_evidence, state.n_steps, position)
    height = _after_pressure(second, step_log_odds)
    recent = (*state.recent, second)
    n_final = sum(s.climb.time_s < climb.time_s - LATE_S for s in state.recent)
    passages = [p for later_second in recent[1 : n_final + 1] for p in later_second.before.floors.passages]
    without_evidence = replace_unchecked(state, log_evidence=np.zeros(N_MODES), n_steps=0, n_unseen=0.0)
    return replace_unchecked(without_evidence, known=height, recent=recent[n_final:]), tuple(passages)


def on_step(
    state: HeightState,
    now_s: float,
    step_s: float,
    up_prob: float,
    down_prob: float,
    step_log_odds: float,
    position: Position | None = None,
) -> tuple[HeightState, HeightEstimate, tuple[FloorPassage, ...]]:
    """Return the state of the height filter after a step, the estimate at the step, and completed floor passages.

    The step was made at `step_s` and detected at `now_s`. With a barometer it counts in the second in which it was
    made, and `on_pressure` returns the passages. Without one it climbs a riser with the probability of stairs.
    `position` is an accurate location at the step, or None.
    """
    since_s = max(step_s - state.step_s, 0.0) if math.isfinite(state.step_s) else 0.5
    elapsed_s = min(since_s, 2.0)
    if state.recent and now_s - state.known.pressure_s < PRESSURE_AGE_S and state.known.calm_in_s == 0:
        if step_s > state.known.pressure_s:
            return replace_unchecked(state, step_s=step_s, n_steps=state.n_steps + 1), state.known, ()
        i = next(i for i, s in enumerate(state.recent) if step_s <= s.climb.time_s)
        seconds = [*state.recent[:i], replace_unchecked(state.recent[i], n_steps=state.recent[i].n_steps + 1)]
        for later_second in state.recent[i + 1 :]:
            seconds.append(replace_unchecked(later_second, before=_after_pressure(seconds[-1], step_log_odds)))
        height = _after_pressure(seconds[-1], step_log_odds)
        height_at_step = seconds[i + 1].before if i + 1 < len(seconds) else height
        return replace_unchecked(state, step_s=step_s, known=height, recent=tuple(seconds)), height_at_step, ()
    n_unseen = state.n_unseen + state.stairs_unknown_share
    unseen_var = unseen_var_m2(n_unseen) - unseen_var_m2(state.n_unseen) + _UNSEEN_LIFT_M2 * (since_s - elapsed_s)
    slope_var = (_UNMEASURED_SLOPE_M**2 + state.stairs_unknown_share * _UNMEASURED_STAIRS_M**2) * elapsed_s
    stairs_prob, added_var_m2 = (up_prob, down_prob), (unseen_var, slope_var)
    height = _after_unmeasured_step(state.known, step_s, elapsed_s, stairs_prob, added_var_m2, position)
    passages = (*_open_passages(state), *height.floors.passages)
    state = replace_unchecked(state, n_unseen=n_unseen)
    state = replace_unchecked(state, step_s=step_s, known=height, recent=(), log_evidence=np.zeros(N_MODES), n_steps=0)
    return state, height, passages


def with_fix(state: HeightState, fix: PositionFix | GridFix) -> HeightState:
    """Return the state of the height filter after a fix with a storey, an altitude, or both.

    A storey renumbers the storeys of the state. An altitude updates the estimated altitude of the start. A fix without
    either leaves the state unchanged.
    """
    if fix.floor is not None:
        state = with_floor(state, fix.floor)
    if isinstance(fix, GridFix) or fix.altitude_m is None:
        return state
    altitude = state.start_altitude.with_fix(fix, state.known.height_m, state.known.height_var_m2)
    return replace_unchecked(state, start_altitude=altitude)


def with_floor(state: HeightState, floor: int) -> HeightState:
    """Return the state on a given storey.

    The first given storey numbers the present one. A later one measures the climbed height as well, if the heights of
    the storeys agree with it, and otherwise only changes the number of the present storey.
    """
    before, known = state.known.floors, state.known
    level = level_of(before.levels, floor, _STOREY_STD_M)
    error_var = level.std_m**2 + LEVEL_STD_M**2
    climbed_var = vertical.combined_height(known.moments).climbed_var_m2
    misfit = (level.climbed_m - known.climbed_m) ** 2 / (climbed_var + error_var)

    def on_floor(height: HeightEstimate) -> HeightEstimate:
        """Return a height estimate with the storey renumbered, or its height measured by the storey."""
        if not before.is_numbered or misfit > _LEVEL_GATE:
            return replace_unchecked(height, floors=floors_numbered_from(height.floors, floor - before.floor))
        moments = vertical.at_level(height.moments, level.climbed_m, error_var)
        now = vertical.combined_height(moments)
        floors = replace_unchecked(height.floors, floor=floor)
        if height.floors.floor != floor:
            floors = on_storey(floors, Level(floor, now.climbed_m, _std(now.climbed_var_m2)))
        return replace_unchecked(height, floors=floors, **_of_moments(moments, now))

    recent = tuple(replace_unchecked(second, before=on_floor(second.before)) for second in state.recent)
    return replace_unchecked(state, known=on_floor(state.known), recent=recent, n_unseen=0.0)


def finish_height(state: HeightState) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """Return the state of the height filter after the last event, and the remaining floor passages.

    These are the passages that were not returned before.
    """
    times = [t for t in (state.step_s, state.known.pressure_s) if np.isfinite(t)]
    last = floors_at_end(state.known.floors, max(times, default=0.0), state.known.climbed_m)
    known = replace_unchecked(state.known, floors=last)
    return replace_unchecked(state, known=known, recent=()), (*_open_passages(state), *last.passages)


def _open_passages(state: HeightState) -> tuple[FloorPassage, ...]:
    """Return the floor passages of the last seconds, which `on_pressure` has not returned yet."""
    if not state.recent:
        return ()
    estimates = (*(second.before for second in state.recent[1:]), state.known)
    return tuple(passage for estimate in estimates for passage in estimate.floors.passages)


def notes(state: HeightState, barometer: ClimbState, is_absence_named: bool = False) -> list[Note]:
    """Return warnings about an unknown storey, a stuck or coarse barometer, and a large change of the air.

    `is_absence_named` is True if another warning names the times without samples of the barometer.
    """
    found, known = list[Note](), state.known
    cause, fault = "" if is_absence_named else "the pressure has gaps", barometer.fault
    if fault:
        cause = fault
    elif math.isnan(known.pressure_s):
        cause = "there is no barometer"
    elif state.step_s - known.pressure_s > PRESSURE_AGE_S and not is_absence_named:
        cause = f"the pressure ends at {known.pressure_s:.0f} s"
    if cause and is_floor_unknown(np.array(known.height_std_m)):
        words = f"height and storey are unknown, ± {known.height_std_m:.0f} m at the end: "
        words += f"{cause}, and nothing else shows stairs; "
        found.append(Note("height", words + "record the pressure, or give fixes with floors"))
    elif fault:
        found.append(Note("height", barometer.note))
    if known.most_air_m >= _NOTABLE_AIR_M:
        hpa = known.most_air_m / _M_PER_HPA
        words = f"the pressure changed by {hpa:.0f} hPa without a climb, as in an aircraft, a vehicle or by the "
        found.append(Note("height", words + "weather: heights and floors ignore this change"))
    return found


def _after_pressure(second: PressureSecond, step_log_odds: float) -> HeightEstimate:
    """Return the estimate after one second of the barometer.

    In a vehicle, only the time of calm pressure is counted, and heights stay.
    """
    previous, climb, n_steps = second.before, second.climb, second.n_steps
    if previous.calm_in_s > 0:
        calm_in_s = CALM_S if abs(climb.climb_rate_mps) > CALM_MPS else previous.calm_in_s - 1.0
        return replace_unchecked(previous, pressure_s=climb.time_s, calm_in_s=max(calm_in_s, 0.0))
    elapsed_s = climb.time_s - previous.pressure_s
    if not elapsed_s > 0:  # first second, or backward clock jump
        elapsed_s = 1.0
    log_evidence = second.log_evidence.copy()
    log_evidence[[LIFT, DRIFT]] += n_steps * step_log_odds
    moments = vertical.moments_after_second(
        previous.moments, elapsed_s, n_steps, climb.height_m, climb.height_std_m**2, log_evidence
    )
    now, prob = vertical.combined_height(moments), moments[:, 0, 0].tolist()
    rides = prob[LIFT]
    ride = (previous.ride or (climb.time_s, previous.climbed_m)) if rides > 0.5 else None
    if ride is not None and climb.time_s - ride[0] > LONGEST_RIDE_S:
        return _in_vehicle(previous, climb.time_s, moments, ride[1])
    on_stairs = prob[UP] + prob[DOWN]
    floors, slope_m = after_motion(
        previous.floors, climb.time_s, elapsed_s, now.climbed_m, on_stairs, rides, n_steps, second.position
    )
    if slope_m != 0.0:
        moments = vertical.as_slope(moments, slope_m)
        now = vertical.combined_height(moments)
    level = known_level(floors, climb.time_s)
    if level is not None:
        variance = level.std_m**2 + LEVEL_STD_M**2
        # After a time without pressure the storey may be another one, whose level would pass the gate as well.
        is_same = not is_floor_unknown(np.array(_std(now.climbed_var_m2)))
        if is_same and (level.climbed_m - now.climbed_m) ** 2 < _LEVEL_GATE * (now.climbed_var_m2 + variance):
            moments = vertical.at_level(moments, level.climbed_m, variance)
            now = vertical.combined_height(moments)
            level = Level(level.floor, now.climbed_m, _std(now.climbed_var_m2))
        floors = with_level(floors, level)
    else:
        floors = with_new_level(floors, climb.time_s, now.climbed_m, _std(now.climbed_var_m2))
    first_air_m = now.air_m if math.isnan(previous.first_air_m) else previous.first_air_m
    return HeightEstimate(
        **_of_moments(moments, now),
        pressure_s=climb.time_s,
        ride=ride,
        first_air_m=first_air_m,
        most_air_m=previous.most_air_m if prob[JUMP] > 0.5 else max(previous.most_air_m, abs(now.air_m - first_air_m)),
        floors=floors,
    )


def _of_moments(moments: FloatArray, now: vertical.Estimate) -> dict[str, Any]:
    """Return the fields of a `HeightEstimate` with these moments (7, 5, 5) and their combined estimate `now`."""
    heights = {"climbed_m": now.climbed_m, "height_m": now.height_m, "height_var_m2": now.height_var_m2}
    return {"moments": moments, **heights}


def unseen_var_m2(n_steps: float) -> float:
    """Return the variance of the height after steps on which stairs cannot be recognised, m2.

    Each step is on stairs with the probability s, up or down by a riser r, and the direction has the correlation
    exp(-k / N) after k steps: var = 2 s r^2 N (n - N (1 - exp(-n / N))).
    """
    n = _UNSEEN_STEPS
    return 2.0 * _UNSEEN_SHARE * RISER_M**2 * n * (n_steps + n * math.expm1(-n_steps / n))


def _after_unmeasured_step(
    previous: HeightEstimate,
    step_s: float,
    elapsed_s: float,
    stairs_prob: tuple[float, float],
    added_var_m2: tuple[float, float],
    position: Position | None,
) -> HeightEstimate:
    """Return the estimate after a step without a barometer, which climbs one riser with the probability of stairs.

    `stairs_prob` are the probabilities of a step up and down. `added_var_m2` are the variances of the height that the
    step adds, by stairs or lifts that cannot be recognised and by slopes.
    """
    (up_prob, down_prob), (unseen_var, slope_var) = stairs_prob, added_var_m2
    rise_m, on_stairs = RISER_M * (up_prob - down_prob), up_prob + down_prob
    stairs_var = on_stairs * (RISER_M**2 + _RISER_STD_M**2) - rise_m**2
    room = max(1.0 - vertical.combined_height(previous.moments).climbed_var_m2 / _UNSEEN_MOST_M2, 0.0)
    climbed_var = _FLIGHT_STEPS * max(stairs_var, 0.0) + room * unseen_var
    moments = vertical.moments_after_step(previous.moments, rise_m, climbed_var, slope_var)
    now = vertical.combined_height(moments)
    floors, slope_m = after_motion(previous.floors, step_s, elapsed_s, now.climbed_m, on_stairs, 0.0, 1, position)
    if slope_m != 0.0:
        moments = vertical.as_slope(moments, slope_m)
        now = vertical.combined_height(moments)
    floors = with_new_level(floors, step_s, now.climbed_m, _std(now.climbed_var_m2))
    return replace_unchecked(previous, floors=floors, **_of_moments(moments, now))


def _in_vehicle(previous: HeightEstimate, now_s: float, moments: FloatArray, before_m: float) -> HeightEstimate:
    """Return the estimate after a ride that was too long for a lift or an escalator.

    Height and storey are reset to those before the ride, and the state of the air is unknown.
    """
    moments = vertical.with_air_unknown(moments, before_m)
    estimate, floor = vertical.combined_height(moments), previous.floors.climbing.from_floor
    climbing = Climbing(now_s, floor, before_m)
    floors = replace_unchecked(previous.floors, floor=floor, climbing=climbing, passages=())
    changes = {"pressure_s": now_s, "ride": None, "calm_in_s": CALM_S, "floors": floors}
    return replace_unchecked(previous, **changes, **_of_moments(moments, estimate))


def _std(variance: float) -> float:
    """Return the square root of a variance that may be negative by rounding."""
    return math.sqrt(max(variance, 0.0))
