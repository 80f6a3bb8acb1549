"""Height beside the track: what barometer, steps and contexts say of it.

With a barometer each of its seconds is explained by seven modes of moving up and down (`vertical_modes`). Height is
what was climbed and sloped; storeys are of what was climbed alone (`floor_detection`), so that neither a hill nor the
weather of a day leads to another one. Without a barometer a step climbs a riser as probably as the track's own modes
say that it was made on stairs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.filter.fixes.frame_rotation import variance_factor
from pdr_filter.filter.height import vertical_modes as vertical
from pdr_filter.filter.height.floor_detection import (
    LEVEL_STD_M,
    Climbing,
    FloorState,
    Level,
    Place,
    finished,
    fixed,
    followed,
    known_level,
    learnt,
    with_level,
)
from pdr_filter.filter.height.vertical_modes import DOWN, DRIFT, JUMP, LIFT, N_MODES, UP
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.weighting import context_log_evidence
from pdr_filter.sensing.contexts.context_stage import WindowContext, to_be_told_apart
from pdr_filter.sensing.features.barometer import RISER_M, Climb
from pdr_filter.values import (
    Context,
    FloatArray,
    FloorPassage,
    GridFix,
    Note,
    Origin,
    PositionFix,
    repetition,
    replace_unchecked,
)

# No lift and hardly an escalator takes longer; a cabin, a train and a cable car do.
LONGEST_RIDE_S = 120.0
# The air of a vehicle is calm again when the barometer has been below this rate, a half of a ride's, for some time.
CALM_MPS, CALM_S = 0.1, 10.0

# A stay that does not fit its level is on another one: 99 % of those that do, chi-square of one.
_LEVEL_GATE = 6.6
# What is climbed without a barometer is wrong for a flight as a whole: a dozen steps.
_FLIGHT_STEPS = 12
_RISER_STD_M = 0.01
# Where slopes are not measured, what a minute of walking leads up or down: 0.4 m.
_UNSEEN_SLOPE_M = 0.05
# Where stairs are not seen either (a phone in the hand), a storey in ten minutes may have been climbed.
_UNSEEN_STAIRS_M = 0.14
# Without pressure for so long a step counts by itself.
PRESSURE_AGE_S = 4.0
# The first steps of a bout wait for the gate for so long: until then a second of the barometer may get more of them.
LATE_S = 6.0
# From which on it is worth saying that the air changed: 5 hPa, more than the weather of some hours.
_NOTABLE_AIR_M = 40.0
_M_PER_HPA = 8.3


@dataclass(frozen=True, eq=False)
class Altitude:
    """What fixes say of the altitude of the start."""

    altitude_m: float = np.nan
    var_m2: float = np.inf
    last_s: float = -np.inf  # of the last fix

    def of(self, origin: Origin) -> Origin:
        """An origin with this altitude, as far as it is known."""
        if math.isinf(self.var_m2):
            return origin
        return dataclasses.replace(origin, height_m=self.altitude_m, height_std_m=math.sqrt(self.var_m2))

    def with_fix(self, fix: PositionFix, height_m: float, height_var_m2: float) -> Altitude:
        """With a fix of an altitude, where the height above the start is known.

        One that is not as expected counts less, as with Student's t (`frame_rotation.variance_factor`).
        """
        if fix.altitude_m is None or fix.altitude_std_m is None:
            raise ValueError(f"the fix has no altitude, got {fix}: give altitude_m and altitude_std_m")
        var = repetition(fix, self.last_s) * fix.altitude_std_m**2 + height_var_m2
        altitude_m = fix.altitude_m - height_m
        if math.isinf(self.var_m2):
            return Altitude(altitude_m, var, fix.time_s)
        innovation_m = altitude_m - self.altitude_m
        var *= variance_factor(innovation_m**2 / (self.var_m2 + var), 1)
        gain = self.var_m2 / (self.var_m2 + var)
        return Altitude(self.altitude_m + gain * innovation_m, (1.0 - gain) * self.var_m2, fix.time_s)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the height at one time: moments of the modes (`vertical_modes`), their sum, and the storeys."""

    moments: FloatArray  # (7, 5, 5)
    climbed_m: float = 0.0
    height_m: float = 0.0  # above the start
    height_var_m2: float = 0.0
    pressure_s: float = np.nan  # of the last second of the barometer
    ride: tuple[float, float] | None = None  # since when somebody rides, and what was climbed until then
    calm_in_s: float = 0.0  # the pressure is that of a vehicle until it has been calm for so long
    first_air_m: float = np.nan
    most_air_m: float = 0.0  # that the air has changed since then
    floors: FloorState = field(default_factory=FloorState)

    @property
    def height_std_m(self) -> float:
        """Standard deviation of the height."""
        return _std(self.height_var_m2)


@dataclass(frozen=True, eq=False)
class Second:
    """One second of the barometer, and what was known before it."""

    before: Known
    climb: Climb
    log_evidence: FloatArray  # (7,) of the windows that ended in it
    n_steps: int
    place: Place | None = None  # that a good location showed


@dataclass(frozen=True, eq=False)
class HeightState:
    """What is known, the last seconds, of which steps may still become known, and what waits for the next one."""

    known: Known
    recent: tuple[Second, ...] = ()  # oldest first
    log_evidence: FloatArray = field(default_factory=lambda: np.zeros(N_MODES))
    n_steps: int = 0
    step_s: float = np.nan  # of the last step
    stairs_unknown_share: float = 0.0  # of the last window
    start_altitude: Altitude = field(default_factory=lambda: Altitude())


def initial_height() -> HeightState:
    """State at the start, whose height is zero."""
    return HeightState(Known(vertical.initial()))


def window_log_evidence(windows: Sequence[WindowContext], model: PedestrianModel) -> FloatArray:
    """Log evidence (W, 7) of what windows' motion says of stairs; the climb rate, which is pressure, is not in it."""
    if not windows:
        return np.zeros((0, N_MODES))
    of_contexts = context_log_evidence(
        np.array([to_be_told_apart(w.prob, w.stairs_unknown_share, model.context_set) for w in windows]),
        np.array([w.training_prior for w in windows]),
        model.evidence_exponent,
        model.evidence_floor,
        model.prior_exponent,
    )
    any_context = of_contexts.max(axis=1)

    def best_of(holds: Callable[[Context], bool], otherwise: FloatArray) -> FloatArray:
        """Highest evidence (W,) of the contexts for which `holds` is true, or `otherwise` if there is none."""
        index = model.context_set.index_where(holds)
        return of_contexts[:, index].max(axis=1) if len(index) else otherwise

    on_foot = best_of(lambda c: c.moves and c.climbs == 0, any_context)
    standing = best_of(lambda c: not c.moves and c.climbs == 0, any_context)
    # a model without stairs calls them level walking
    up, down = best_of(lambda c: c.climbs > 0, on_foot), best_of(lambda c: c.climbs < 0, on_foot)
    either = np.maximum(on_foot, standing)
    of_modes = np.column_stack([either, on_foot, up, down, standing, either, standing])
    of_modes[~np.isfinite(of_modes).all(axis=1)] = 0.0  # a window without probabilities
    return of_modes


def on_window(state: HeightState, window: WindowContext, log_evidence: FloatArray | None) -> HeightState:
    """State with a window and, where there is a barometer, its `window_log_evidence` (7,)."""
    if log_evidence is not None and state.recent:
        log_evidence = state.log_evidence + log_evidence
        return replace_unchecked(state, stairs_unknown_share=window.stairs_unknown_share, log_evidence=log_evidence)
    return replace_unchecked(state, stairs_unknown_share=window.stairs_unknown_share)


def on_pressure(
    state: HeightState, climb: Climb, model: PedestrianModel, place: Place | None = None
) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """New state after a second of the barometer whose steps are known, and what is certain now of floor changes.

    `place` is where a good location showed the phone in that second.
    """
    second = Second(state.known, climb, state.log_evidence, state.n_steps, place)
    height = _after(second, model)
    recent = (*state.recent, second)
    n_final = sum(s.climb.time_s < climb.time_s - LATE_S for s in state.recent)
    passages = [p for later_second in recent[1 : n_final + 1] for p in later_second.before.floors.passages]
    without_evidence = replace_unchecked(state, log_evidence=np.zeros(N_MODES), n_steps=0)
    return replace_unchecked(without_evidence, known=height, recent=recent[n_final:]), tuple(passages)


def on_step(
    state: HeightState,
    now_s: float,
    step_s: float,
    up_prob: float,
    down_prob: float,
    model: PedestrianModel,
    place: Place | None = None,
) -> tuple[HeightState, Known, tuple[FloorPassage, ...]]:
    """New state after a step that became known now, what is known of its own time, and of floor changes.

    With a barometer it counts in its own second. Without, it climbs as far as it was probably made on stairs. `place`
    is where a good location showed the phone at the step.
    """
    elapsed_s = min(max(step_s - state.step_s, 0.0), 2.0) if math.isfinite(state.step_s) else 0.5
    if state.recent and now_s - state.known.pressure_s < PRESSURE_AGE_S and state.known.calm_in_s == 0:
        if step_s > state.known.pressure_s:
            return replace_unchecked(state, step_s=step_s, n_steps=state.n_steps + 1), state.known, ()
        i = next(i for i, s in enumerate(state.recent) if step_s <= s.climb.time_s)
        seconds = [*state.recent[:i], replace_unchecked(state.recent[i], n_steps=state.recent[i].n_steps + 1)]
        for later_second in state.recent[i + 1 :]:
            seconds.append(replace_unchecked(later_second, before=_after(seconds[-1], model)))
        height = _after(seconds[-1], model)
        height_at_step = seconds[i + 1].before if i + 1 < len(seconds) else height
        return replace_unchecked(state, step_s=step_s, known=height, recent=tuple(seconds)), height_at_step, ()
    passages = tuple(p for later_second in state.recent[1:] for p in later_second.before.floors.passages)
    if state.recent:
        passages += state.known.floors.passages
    unseen_var = (_UNSEEN_SLOPE_M**2 + state.stairs_unknown_share * _UNSEEN_STAIRS_M**2) * elapsed_s
    height = _climbed(state.known, step_s, elapsed_s, up_prob, down_prob, unseen_var, place)
    state = replace_unchecked(state, step_s=step_s, known=height, recent=(), log_evidence=np.zeros(N_MODES), n_steps=0)
    return state, height, passages + height.floors.passages


def with_fix(state: HeightState, fix: PositionFix | GridFix) -> HeightState:
    """State with the storey and the altitude of a fix, as far as it has them."""
    if fix.floor is not None:
        state = with_floor(state, fix.floor)
    if isinstance(fix, GridFix) or fix.altitude_m is None:
        return state
    altitude = state.start_altitude.with_fix(fix, state.known.height_m, state.known.height_var_m2)
    return replace_unchecked(state, start_altitude=altitude)


def with_floor(state: HeightState, floor: int) -> HeightState:
    """State that is known to be on a storey of this number now."""

    def named(height: Known) -> Known:
        return replace_unchecked(height, floors=fixed(height.floors, floor - state.known.floors.floor))

    recent = tuple(replace_unchecked(second, before=named(second.before)) for second in state.recent)
    return replace_unchecked(state, known=named(state.known), recent=recent)


def finish(state: HeightState) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """State when nothing more will come, and the last floor changes."""
    passages = [p for later_second in state.recent[1:] for p in later_second.before.floors.passages]
    if state.recent:
        passages += state.known.floors.passages
    times = [t for t in (state.step_s, state.known.pressure_s) if np.isfinite(t)]
    last = finished(state.known.floors, max(times, default=0.0), state.known.climbed_m)
    return replace_unchecked(state, known=replace_unchecked(state.known, floors=last), recent=()), (
        *passages,
        *last.passages,
    )


def notes(state: HeightState) -> list[Note]:
    """What to keep in mind about heights."""
    if state.known.most_air_m < _NOTABLE_AIR_M:
        return []
    hpa = state.known.most_air_m / _M_PER_HPA
    words = f"the pressure changed by {hpa:.0f} hPa that nobody climbed, as in a cabin, a vehicle or by the weather: "
    return [Note("height", words + "heights and floors do not count it")]


def _after(second: Second, model: PedestrianModel) -> Known:
    """Return the estimate after one second of the barometer."""
    previous, climb, n_steps = second.before, second.climb, second.n_steps
    if previous.calm_in_s > 0:
        calm_in_s = CALM_S if abs(climb.climb_rate_mps) > CALM_MPS else previous.calm_in_s - 1.0
        return replace_unchecked(previous, pressure_s=climb.time_s, calm_in_s=max(calm_in_s, 0.0))
    elapsed_s = climb.time_s - previous.pressure_s
    if not elapsed_s > 0:  # the first, or a clock that was set back
        elapsed_s = 1.0
    log_evidence = second.log_evidence.copy()
    log_evidence[[LIFT, DRIFT]] += n_steps * model.step_log_odds_stationary
    moments = vertical.after_second(
        previous.moments, elapsed_s, n_steps, climb.height_m, climb.height_std_m**2, log_evidence
    )
    now, prob = vertical.combined(moments), moments[:, 0, 0].tolist()
    rides = prob[LIFT]
    ride = (previous.ride or (climb.time_s, previous.climbed_m)) if rides > 0.5 else None
    if ride is not None and climb.time_s - ride[0] > LONGEST_RIDE_S:
        return _in_vehicle(previous, climb.time_s, moments, ride[1])
    on_stairs = prob[UP] + prob[DOWN]
    way, slope_m = followed(
        previous.floors, climb.time_s, elapsed_s, now.climbed_m, on_stairs, rides, n_steps, second.place
    )
    if slope_m != 0.0:
        moments = vertical.as_slope(moments, slope_m)
        now = vertical.combined(moments)
    level = known_level(way, climb.time_s)
    if level is not None:
        variance = level.std_m**2 + LEVEL_STD_M**2
        if (level.climbed_m - now.climbed_m) ** 2 < _LEVEL_GATE * (now.climbed_var_m2 + variance):
            moments = vertical.at_level(moments, level.climbed_m, variance)
            now = vertical.combined(moments)
            level = Level(level.floor, now.climbed_m, _std(now.climbed_var_m2))
        way = with_level(way, level)
    else:
        way = learnt(way, climb.time_s, now.climbed_m, _std(now.climbed_var_m2))
    first_air_m = now.air_m if math.isnan(previous.first_air_m) else previous.first_air_m
    return Known(
        moments=moments,
        climbed_m=now.climbed_m,
        height_m=now.height_m,
        height_var_m2=now.height_var_m2,
        pressure_s=climb.time_s,
        ride=ride,
        first_air_m=first_air_m,
        most_air_m=previous.most_air_m if prob[JUMP] > 0.5 else max(previous.most_air_m, abs(now.air_m - first_air_m)),
        floors=way,
    )


def _climbed(
    previous: Known,
    step_s: float,
    elapsed_s: float,
    up_prob: float,
    down_prob: float,
    unseen_var: float,
    place: Place | None,
) -> Known:
    """What is known after a step without a barometer."""
    rise_m, on_stairs = RISER_M * (up_prob - down_prob), up_prob + down_prob
    of_stairs = on_stairs * (RISER_M**2 + _RISER_STD_M**2) - rise_m**2
    climbed_var = _FLIGHT_STEPS * max(of_stairs, 0.0)
    moments = vertical.after_step(previous.moments, rise_m, climbed_var, unseen_var)
    now = vertical.combined(moments)
    way, slope_m = followed(previous.floors, step_s, elapsed_s, now.climbed_m, on_stairs, 0.0, 1, place)
    if slope_m != 0.0:
        moments = vertical.as_slope(moments, slope_m)
        now = vertical.combined(moments)
    return replace_unchecked(
        previous,
        moments=moments,
        climbed_m=now.climbed_m,
        height_m=now.height_m,
        height_var_m2=now.height_var_m2,
        floors=learnt(way, step_s, now.climbed_m, _std(now.climbed_var_m2)),
    )


def _in_vehicle(previous: Known, now_s: float, moments: FloatArray, before_m: float) -> Known:
    """What is known when a ride was none: the height is that before it, and nothing of the air."""
    moments = vertical.with_air_unknown(moments, before_m)
    estimate, floor = vertical.combined(moments), previous.floors.climbing.from_floor
    return replace_unchecked(
        previous,
        moments=moments,
        climbed_m=estimate.climbed_m,
        height_m=estimate.height_m,
        height_var_m2=estimate.height_var_m2,
        pressure_s=now_s,
        ride=None,
        calm_in_s=CALM_S,
        floors=replace_unchecked(previous.floors, floor=floor, climbing=Climbing(now_s, floor, before_m), passages=()),
    )


def _std(variance: float) -> float:
    return math.sqrt(max(variance, 0.0))
