"""Filter as a pure function: state and block of samples in, new state and output out."""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from operator import attrgetter
from typing import Any

import numpy as np

from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.filter.fixes.gnss import LocationState, good_places, place_at, position_fixes
from pdr_filter.filter.fixes.range_placement import MIN_LOG_ODDS
from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.filter.height import height_filter as height
from pdr_filter.filter.height.height_filter import HeightState, initial_height
from pdr_filter.filter.imm import pedestrian_state as pedestrian
from pdr_filter.filter.imm.pedestrian_state import StepUpdate, moved_by_heading_m
from pdr_filter.filter.imm.step_history import TRAIL_TIME
from pdr_filter.filter.imm.tracker import TrackerState
from pdr_filter.filter.plan_stage import PlanState
from pdr_filter.filter.step_length.person import LengthFixes, Person, session_of
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.context_stage import with_climbs
from pdr_filter.sensing.features.barometer import STAIRS_MPS, Climb, ClimbState
from pdr_filter.sensing.front_end import Event, Gap, SensingState
from pdr_filter.sensing.heading.heading_stage import knows_north
from pdr_filter.sensing.stream_merging import Merged, MergerState, Sensor, StreamMerger
from pdr_filter.sensing.vehicle_vibration import Stepless, Undecided
from pdr_filter.tracking.step_statistics import StepCounts, WindowCounts, is_in_standing, is_moving
from pdr_filter.values import (
    Fix,
    FixResult,
    FloatArray,
    FloorPassage,
    GridFix,
    ImuBlock,
    OnPlan,
    Origin,
    PositionFix,
    Standstill,
    Step,
    WindowContext,
    read_only,
    received_s,
    replace_unchecked,
)

# Maximum age of a fix. The tracker remembers `pedestrian_state.TRAIL_STEPS` steps: half a minute of continuous walking,
# or about a minute with rests. A larger difference means that fix and samples have different clocks.
MAX_FIX_AGE_S = 60.0
# A fix from the moment at which the sensors are switched on may be slightly older than the first sample.
FIX_TOLERANCE_S = 1.0

# Number of fix results kept for `Now.fixes`.
_N_LAST_FIXES = 16


@dataclass(frozen=True, eq=False)
class RivalTracker:
    """Tracker of the less probable of two position hypotheses, with its log odds against the more probable one."""

    tracker: TrackerState
    log_odds: float

    @property
    def prob(self) -> float:
        """Probability of this hypothesis, at most one half."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))


@dataclass(frozen=True, eq=False)
class State:
    """Complete state of a filter: everything that changes with samples and fixes.

    Attributes
    ----------
    sensing : SensingState
        State of the stages from samples to steps and windows.
    tracker : TrackerState
        State of the tracker.
    barometer : ClimbState
        State of the climb-rate estimator.
    seen : WindowCounts
        Numbers of all windows and of unreliable ones, for the warnings.
    walked : StepCounts
        Numbers of all steps and of unreliable ones, for the warnings.
    height : HeightState
        State of the height filter.
    climbs : tuple of Climb
        Climb rates from the barometer whose windows have not been classified yet.
    n_lost_climbs : int
        Number of climb rates dropped because their windows did not come.
    n_climbs_used : int
        Number of leading elements of `climbs` that the height filter has used.
    locations : LocationState
        State of the conversion from geographic locations to position fixes.
    places : ndarray, shape (N, 3)
        Recent accurate locations (`gnss.good_places`), which distinguish hills from storeys.
    rides : Rides
        Vehicle rides found in the position fixes.
    waiting_fixes : tuple of Fix
        Fixes that have not been received yet, or whose steps are not known yet, ordered by due time.
    n_rejected_fixes : int
        Number of rejected fixes.
    length_fixes : LengthFixes
        Number and area of the accepted fixes from which the filter learns the step length.
    particles : PlanState or None
        Particles on the floor plan. None without a plan.
    merger : MergerState
        State of the merging of sensors that arrive separately.
    window : WindowContext or None
        Last classified window.
    last_fixes : tuple of FixResult
        Outcomes of the last fixes.
    last_update : StepUpdate or None
        Last step since the last gap, or None if there is none.
    rival : RivalTracker or None
        Second hypothesis while ranges fit two positions.
    conflict : FixConflict
        Position fixes that contradict the track.
    undecided_s : float
        Begin of the motion whose steps are not known yet, s, or infinity. Fixes of later times wait for them.
    finished : bool
        True after `finish`.
    """

    sensing: SensingState
    tracker: TrackerState
    barometer: ClimbState
    seen: WindowCounts = field(default_factory=WindowCounts)
    walked: StepCounts = field(default_factory=StepCounts)
    height: HeightState = field(default_factory=initial_height)
    climbs: tuple[Climb, ...] = ()
    n_lost_climbs: int = 0
    n_climbs_used: int = 0
    locations: LocationState = field(default_factory=LocationState)
    places: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    rides: Rides = field(default_factory=Rides)
    waiting_fixes: tuple[Fix, ...] = ()
    n_rejected_fixes: int = 0
    length_fixes: LengthFixes = field(default_factory=LengthFixes)
    particles: PlanState | None = None
    merger: MergerState = field(default_factory=StreamMerger().init)
    window: WindowContext | None = None
    last_fixes: tuple[FixResult, ...] = ()
    last_update: StepUpdate | None = None
    rival: RivalTracker | None = None
    conflict: FixConflict = field(default_factory=FixConflict)
    undecided_s: float = math.inf
    finished: bool = False

    @property
    def clock_offset_s(self) -> float:
        """Offset from the sample clock to the track clock, s. It changes when the sample clock jumps backwards."""
        return self.sensing.conditioner.clock.offset_s


@dataclass(frozen=True, eq=False)
class Output:
    """Events that one block of samples produced: steps, windows, results of fixes, and completed floor passages."""

    updates: list[StepUpdate] = field(default_factory=list[StepUpdate])
    windows: list[WindowContext] = field(default_factory=list[WindowContext])
    fixes: list[FixResult] = field(default_factory=list[FixResult])
    floor_passages: list[FloorPassage] = field(default_factory=list[FloorPassage])

    def extend(self, later: Output) -> None:
        """Append the events of a later output."""
        for name in ("updates", "windows", "fixes", "floor_passages"):
            getattr(self, name).extend(getattr(later, name))


def init(config: Config) -> State:
    """Return the state of a filter before its first sample.

    With a floor plan, the storey is the storey of the start on the plan, and the plan gives the origin of the
    locations.
    """
    state = State(config.sensing.init(), config.tracker.init(), config.climb_rate.init())
    on_plan = config.on_plan
    if on_plan is None:
        return state
    if on_plan.start is not None:
        state = replace_unchecked(state, height=height.with_floor(state.height, on_plan.start.floor))
    # With a plan in degrees, the origin of the plan is the origin of the locations.
    return replace_unchecked(state, locations=LocationState(origin=on_plan.plan.origin), particles=on_plan.init())


def update(config: Config, state: State, block: ImuBlock, provisional: bool = False) -> tuple[State, Output]:
    """Return the new state and the output after a block of samples of any length.

    With `provisional`, the output has a provisional update of each step that is not final when it is detected. The
    result depends on samples and fixes only, and not on the division into blocks. ValueError after `finish`.
    """
    if state.finished:
        raise ValueError("the filter is finished: start a new one for further samples")
    whole = Output()
    for part in parts(block):
        sensing, events = config.sensing.update(state.sensing, part)
        state, output = _process(config, replace_unchecked(state, sensing=sensing), events, provisional)
        whole.extend(output)
    return state, whole


def update_streams(
    config: Config,
    state: State,
    samples: Mapping[Sensor, tuple[FloatArray, FloatArray]],
    provisional: bool = False,
) -> tuple[State, Output]:
    """Return the new state and the output after samples of single sensors.

    `samples` has times (N,) and values (N, d) for each sensor. They wait for the samples of the other sensors.
    `provisional` is an argument of `update`. ValueError after `finish`.
    """
    if state.finished:
        raise ValueError("the filter is finished: start a new one for further samples")
    merger, merged = config.merger.together(state.merger, samples)
    return _with_merged(config, replace_unchecked(state, merger=merger), merged, provisional)


def _with_merged(config: Config, state: State, merged: Merged, provisional: bool = False) -> tuple[State, Output]:
    if len(merged.pressure_time_s):
        state = add_pressure(config, state, merged.pressure_time_s, merged.pressure_hpa)
    return update(config, state, merged.block, provisional) if len(merged.block.time_s) else (state, Output())


# Number of samples that pass the stages at once: some minutes, which bounds memory. Results do not depend on it.
PART_SAMPLES = 32_000


def parts(block: ImuBlock) -> Iterator[ImuBlock]:
    """Split a block into pieces of at most `PART_SAMPLES`."""
    yield from block.parts(PART_SAMPLES)


# Maximum number of climb rates, one per second, that wait for their windows. A barometer that is ten minutes ahead of
# the other samples has another clock.
MAX_CLIMBS = 600


def add_pressure(config: Config, state: State, time_s: FloatArray, pressure_hpa: FloatArray) -> State:
    """Return the state with barometer samples, (N,) each.

    Windows that end after the samples use the climb rate. Give the pressure of a time before the other samples of that
    time, because each window is classified only once. Only the last `MAX_CLIMBS` climb rates wait for their windows.
    """
    barometer, climbs = config.climb_rate.update(state.barometer, time_s + state.clock_offset_s, pressure_hpa)
    all_climbs = (*state.climbs, *climbs)
    n_lost = max(len(all_climbs) - MAX_CLIMBS, 0)
    return replace_unchecked(
        state,
        barometer=barometer,
        climbs=all_climbs[n_lost:],
        n_lost_climbs=state.n_lost_climbs + n_lost,
        n_climbs_used=max(state.n_climbs_used - n_lost, 0),
    )


def add_location(
    config: Config,
    state: State,
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    accuracy_m: FloatArray,
    altitude_m: FloatArray | None = None,
) -> State:
    """Return the state with geographic locations, (N,) each, with times on the clock of the samples.

    Some of them become position fixes, in metres from the first usable location.
    """
    time_s = time_s + state.clock_offset_s
    locations, fixes = position_fixes(
        state.locations, time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m=altitude_m
    )
    if locations.origin is not None:
        state = add_terrain_locations(state, locations.origin, time_s, latitude_deg, longitude_deg, accuracy_m)
    return add_fixes(config, replace_unchecked(state, locations=locations), fixes)


# Age up to which locations are kept for terrain detection: steps and pressures become known some seconds late, and the
# height filter compares them with locations some seconds earlier.
_PLACES_S = 20.0


def add_terrain_locations(
    state: State,
    origin: Origin,
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    accuracy_m: FloatArray,
) -> State:
    """Return the state with locations (N,), on the track clock, that only distinguish hills from storeys."""
    last: list[tuple[float, float, float]] = [tuple(row) for row in state.places[-1:].tolist()]
    new = good_places(origin, time_s, latitude_deg, longitude_deg, accuracy_m, *last)
    is_old = state.places[:, 0] < state.sensing.processed_s - _PLACES_S
    return replace_unchecked(state, places=np.concatenate([state.places[~is_old], new]))


def add_fixes(config: Config, state: State, fixes: Sequence[Fix]) -> State:
    """Return the state with fixes, on the track clock, that wait until they are due."""
    waiting = list(state.waiting_fixes)
    for fix in fixes:
        insort(waiting, fix, key=lambda f: due_s(config, f))
    return replace_unchecked(state, waiting_fixes=tuple(waiting))


# A contradicting fix takes 4 ms, so that adding one takes at most 20 ms.
_MOST_DUE = 5


def outcome_now(config: Config, state: State, fix: Fix) -> FixResult:
    """Return the outcome that a waiting fix has with the samples so far. The state uses it before its next event.

    Until then, fixes that were received earlier may still be added. They are used first, as offline. The outcome is not
    computed behind many waiting fixes, because each of them would be processed again.
    """
    waiting, until_s = FixResult.of(fix, math.nan, "waiting"), state.sensing.processed_s
    if bisect_right(state.waiting_fixes, until_s, key=lambda f: due_s(config, f)) > _MOST_DUE:
        return waiting
    _, used = _use_due_fixes(config, state, until_s)
    same = (result for result in used[::-1] if (result.kind, result.time_s) == (waiting.kind, waiting.time_s))
    return next(same, waiting)


def present_position(config: Config, state: State) -> tuple[FloatArray, FloatArray]:
    """Return position (2,) and covariance (2, 2) after the last final step.

    With a floor plan they are the estimate of the particle filter, once it has started.
    """
    position_m, cov_m2 = pedestrian.present_position(state.tracker.pedestrian)
    reckoned = position_m, _with_spread(state, position_m, cov_m2)
    place = None if config.on_plan is None else config.on_plan.place(state.particles, reckoned)
    return reckoned if place is None else (place.position_m, place.position_cov_m2)


def _with_spread(state: State, position_m: FloatArray, cov_m2: FloatArray) -> FloatArray:
    """Return the covariance (2, 2) of a position, including the possibility that another hypothesis is true.

    The other hypothesis is the rival, or that rejected position fixes are right and the track is wrong.
    """
    if state.conflict.is_doubtful:
        cov_m2 = read_only(cov_m2 + state.conflict.cov_m2)
    if state.rival is None:
        return cov_m2
    away_m = pedestrian.present_position(state.rival.tracker.pedestrian)[0] - position_m
    return read_only(cov_m2 + state.rival.prob * np.outer(away_m, away_m))


def _with_rival(state: State, event: Callable[[Any], tuple[Any, Any]]) -> State:
    """Return the state after an event that is also applied to the rival hypothesis, if there is one."""
    if state.rival is None:
        return state
    tracker, _ = event(state.rival.tracker)
    return replace_unchecked(state, rival=replace_unchecked(state.rival, tracker=tracker))


def _after_fix_of_rival(config: Config, state: State, fix: Fix, nis: float) -> State:
    """Return the state after a fix that both hypotheses have processed.

    The more probable hypothesis becomes the track. A rival below `MIN_LOG_ODDS` is dropped. `nis` is the normalised
    innovation squared of the fix for the track. The log-likelihood of a rejected fix is bounded by its value at the
    gate. If the tracker has just found two positions, the second one becomes the rival.
    """
    tracker, rival = state.tracker, state.rival
    if tracker.pedestrian.rival is not None:
        other = replace(tracker, pedestrian=tracker.pedestrian.rival.pedestrian)
        rival = RivalTracker(other, tracker.pedestrian.rival.log_odds)
        tracker = replace(tracker, pedestrian=replace_unchecked(tracker.pedestrian, rival=None))
        return replace_unchecked(state, tracker=tracker, rival=rival)
    if rival is None:
        return state
    of_rival, _, rival_nis = config.tracker.on_fix(rival.tracker, fix)
    of_rival = replace(of_rival, pedestrian=replace_unchecked(of_rival.pedestrian, rival=None))
    gate, log_odds = config.model.fix_gate_nis, rival.log_odds
    if not (math.isnan(nis) or math.isnan(rival_nis)):
        log_odds += 0.5 * (min(nis, gate) - min(rival_nis, gate))
    if log_odds > 0.0:
        tracker, of_rival, log_odds = of_rival, tracker, -log_odds
    rival = None if log_odds < MIN_LOG_ODDS else RivalTracker(of_rival, log_odds)
    return replace_unchecked(state, tracker=tracker, rival=rival)


def person_of(config: Config, state: State) -> Person | None:
    """Return the person's step length, from earlier walks (`config.person`) and the fixes of this one.

    If the fixes tell nothing, the result is `config.person`, which may be None.
    """
    session = session_of(config.model, state.tracker.pedestrian.estimates, state.length_fixes)
    if session is None:
        return config.person
    return (config.person or Person()).pooled(Person((session,)))


# Windows are 2 s long, so that a window and its climb rate share at least half of their time.
_CLIMB_AGE_S = 1.0


def climb_at(climbs: Sequence[Climb], time_s: float) -> Climb | None:
    """Return the last climb rate at or before a time, or None if it is too old or cannot tell stairs from level ground.

    It is too old after `_CLIMB_AGE_S`. It can tell if its standard deviation is at most half of the rate on stairs.
    """
    i = bisect_right(climbs, time_s, key=attrgetter("time_s"))
    if not i or climbs[i - 1].time_s < time_s - _CLIMB_AGE_S or climbs[i - 1].std_mps > 0.5 * STAIRS_MPS:
        return None
    return climbs[i - 1]


def finish(config: Config, state: State) -> tuple[State, Output]:
    """Return the new state and the output at the end of the samples.

    Candidate steps are decided, provisional steps become final, and fixes received before the end of the samples are
    used. Later fixes stay in `waiting_fixes`. A second call changes nothing.
    """
    if state.finished:
        return state, Output()
    merger, merged = config.merger.finish(state.merger)
    state, output = _with_merged(config, replace_unchecked(state, merger=merger), merged)
    sensing, events = config.sensing.finish(state.sensing)
    state, late = _process(config, replace_unchecked(state, sensing=sensing), events)
    output.extend(late)
    tracker, last = config.tracker.finish(state.tracker)
    state = _with_rival(replace_unchecked(state, tracker=tracker), config.tracker.finish)
    end_s = state.sensing.processed_s
    state = _with_steps(config, state, end_s, last, output)
    state = _with_pressure(config, state, np.inf, output)
    height_state, passages = height.finish(state.height)
    state = _with_passages(config, replace_unchecked(state, height=height_state), passages, output)
    due_fixes = [f for f in state.waiting_fixes if received_s(f) <= end_s]
    later_fixes = [f for f in state.waiting_fixes if received_s(f) > end_s]
    state = replace_unchecked(state, waiting_fixes=tuple(later_fixes), finished=True)
    for fix in due_fixes:
        state, result = _use_fix(config, state, fix, end_s)
        output.fixes.append(result)
    return state, output


def _process(
    config: Config, state: State, events: list[tuple[float, Event]], provisional: bool = False
) -> tuple[State, Output]:
    output = Output()
    if not (events or state.waiting_fixes or state.climbs):  # most blocks of a phone are shorter than a hop
        return state, output
    tracker: TrackerState
    windows = [event for _, event in events if isinstance(event, WindowContext)]
    climbs, context_set = [climb_at(state.climbs, window.time_s) for window in windows], config.model.context_set
    contexts = iter(with_climbs(windows, climbs, context_set))
    of_height = iter(height.window_log_evidence(windows, config.model)) if state.climbs else repeat(None)
    for known_s, event in events:
        if isinstance(event, Step):  # all steps before it are known
            begin_s = event.time_s - event.duration_s
            state = replace_unchecked(state, undecided_s=max(state.undecided_s, begin_s))
        state, used = _use_due_fixes(config, state, known_s)
        output.fixes.extend(used)
        state = _with_pressure(config, state, known_s, output)
        if isinstance(event, WindowContext):
            height_state = height.on_window(state.height, event, next(of_height))
            context = next(contexts)
            output.windows.append(context)
            moves = bool(is_moving(context.prob[context_set.standing].sum()))
            rides = state.rides.with_windows(context.hop_s, moves * context.hop_s)
            state = replace_unchecked(state, rides=rides)
            tracker, updates = config.tracker.on_window(state.tracker, context)
            state = _with_rival(state, lambda rival, at=context: config.tracker.on_window(rival, at))
            state = replace_unchecked(
                state, tracker=tracker, height=height_state, seen=state.seen.plus(context, context_set), window=context
            )
        elif isinstance(event, Stepless):
            tracker, updates = _over_stepless(state.tracker, event.duration_s)
            state = _with_rival(state, lambda rival, at=event: _over_stepless(rival, at.duration_s))
            state = replace_unchecked(state, tracker=tracker)
        elif isinstance(event, Undecided):
            state, updates = replace_unchecked(state, undecided_s=event.since_s), ()
        elif isinstance(event, Gap):
            tracker, updates = config.tracker.on_gap(state.tracker, event.duration_s)
            state = _with_rival(state, lambda rival, at=event: config.tracker.on_gap(rival, at.duration_s))
            if config.on_plan is not None:
                particles = config.on_plan.on_gap(state.particles, event.duration_s, config.model)
                state = replace_unchecked(state, particles=particles)
            state = replace_unchecked(state, tracker=tracker, last_update=None, undecided_s=math.inf)
        else:
            tracker, updates = config.tracker.on_step(state.tracker, event)
            state = _with_rival(state, lambda rival, at=event: config.tracker.on_step(rival, at))
            walked_m = sum(u.step_length_m for u in updates)
            moved_m = moved_by_heading_m(state.tracker.pedestrian, tracker.pedestrian, walked_m)
            heading_std_rad = math.sqrt(pedestrian.heading_var_rad2(tracker.pedestrian))
            walked = state.walked.plus(event, heading_std_rad, moved_m)
            state = replace_unchecked(state, tracker=tracker, walked=walked)
            if provisional and (newest := config.tracker.provisional(tracker)) is not None:
                updates = (*updates, newest)
        state = _with_steps(config, state, known_s, updates, output)
    state, used = _use_due_fixes(config, state, state.sensing.processed_s)
    output.fixes.extend(used)
    state = _with_pressure(config, state, state.sensing.processed_s, output)
    n_past = max(bisect_right(state.climbs, state.sensing.processed_s, key=attrgetter("time_s")) - 1, 0)
    n_past = min(n_past, state.n_climbs_used)
    return replace_unchecked(state, climbs=state.climbs[n_past:], n_climbs_used=state.n_climbs_used - n_past), output


def _over_stepless(tracker: Any, stepless_s: float) -> tuple[Any, tuple[()]]:
    """Return the state of a tracker after a time of motion without a step, and no track rows."""
    return replace_unchecked(tracker, pedestrian=pedestrian.over_stepless(tracker.pedestrian, stepless_s)), ()


def _with_pressure(config: Config, state: State, until_s: float, output: Output) -> State:
    """Return the state whose height filter has used the climb rates up to a time, less the latency of steps.

    All steps before that time are known, except the first step of a bout, which is detected later. Completed floor
    passages are appended to the output.
    """
    if state.n_climbs_used == len(state.climbs):
        return state
    until_s -= config.sensing.step_latency_s
    while state.n_climbs_used < len(state.climbs) and state.climbs[state.n_climbs_used].time_s <= until_s:
        climb = state.climbs[state.n_climbs_used]
        place = place_at(state.places, climb.time_s)
        height_state, passages = height.on_pressure(state.height, climb, config.model, place)
        state = replace_unchecked(state, height=height_state, n_climbs_used=state.n_climbs_used + 1)
        state = _with_passages(config, state, passages, output)
    return state


def _with_passages(config: Config, state: State, passages: Sequence[FloorPassage], output: Output) -> State:
    """Return the state after completed floor passages, which move the particles to their storeys.

    The passages are appended to the output.
    """
    output.floor_passages.extend(passages)
    if config.on_plan is not None:
        for passage in passages:
            particles = config.on_plan.on_passage(state.particles, passage, state.tracker.pedestrian, config.model)
            state = replace_unchecked(state, particles=particles)
    return state


def _with_steps(config: Config, state: State, known_s: float, updates: Sequence[StepUpdate], output: Output) -> State:
    """Return the state after steps, and append the steps to the output.

    Final steps update the height filter and the particles. Each appended step has the height and the storey. With a
    floor plan, final steps have the position of the particles.
    """
    height_state, standing = state.height, config.model.context_set.standing
    for update in updates:
        if update.is_final:
            walked = state.walked.plus_context(bool(is_in_standing(update.context_prob, standing)))
            state = replace_unchecked(state, walked=walked)
            up_prob, down_prob = config.model.on_stairs.dot(update.mode_prob).tolist()
            step_s, model = update.step.time_s, config.model
            height_state, height_at_step, passages = height.on_step(
                height_state, known_s, step_s, up_prob, down_prob, model, place_at(state.places, step_s)
            )
            state = _with_passages(config, state, passages, output)
        else:
            height_at_step = height_state.known
        if state.rival is not None or state.conflict.is_doubtful:
            spread = _with_spread(state, update.position_m, update.position_cov_m2)
            update = replace_unchecked(update, position_cov_m2=spread)
        update = replace_unchecked(
            update,
            height_m=height_at_step.height_m,
            height_std_m=height_at_step.height_std_m,
            floor=height_at_step.floors.floor,
        )
        if config.on_plan is not None and update.is_final:
            particles = config.on_plan.on_step(state.particles, update, state.tracker.pedestrian, config.model)
            state = replace_unchecked(state, particles=particles)
            reckoned = update.position_m, update.position_cov_m2
            update = _on_plan(update, config.on_plan.place(state.particles, reckoned))
        output.updates.append(update)
    return replace_unchecked(state, height=height_state, last_update=output.updates[-1]) if updates else state


def _on_plan(update: StepUpdate, place: OnPlan | None) -> StepUpdate:
    """Return a step with position, covariance and heading of the particles, or unchanged if there are none."""
    if place is None:
        return update
    return replace_unchecked(
        update,
        on_plan=place,
        position_m=place.position_m,
        position_cov_m2=place.position_cov_m2,
        walking_heading_rad=place.walking_heading_rad,
        of_start=None,
    )


def _use_due_fixes(config: Config, state: State, until_s: float) -> tuple[State, list[FixResult]]:
    if not state.waiting_fixes or due_s(config, state.waiting_fixes[0]) > until_s:
        return state, []
    n_due = bisect_right(state.waiting_fixes, until_s, key=lambda f: due_s(config, f))
    used, waiting = list[FixResult](), list[Fix]()
    for fix in state.waiting_fixes[:n_due]:
        # the steps before it may still become known, as in the first seconds of a walk
        if fix.time_s >= state.undecided_s and not isinstance(fix, Standstill):
            waiting.append(fix)
            continue
        state, result = _use_fix(config, state, fix, until_s)
        used.append(result)
    return replace_unchecked(state, waiting_fixes=(*waiting, *state.waiting_fixes[n_due:])), used


def due_s(config: Config, fix: Fix) -> float:
    """Return the time from which on a fix is used.

    A fix waits for the step at its time: compared with an earlier position, it would pull the track ahead. While the
    phone moves without known steps, it waits until they are known (`State.undecided_s`). A standstill does not wait,
    because it concerns later steps.
    """
    if isinstance(fix, Standstill):
        return received_s(fix)
    return max(received_s(fix), fix.time_s + config.fix_delay_s)


def _use_fix(config: Config, state: State, fix: Fix, now_s: float) -> tuple[State, FixResult]:
    tracker: TrackerState
    if timing_error(fix, state.sensing.conditioner.report.first_time_s, received_s(fix)):
        outcome, nis = "rejected", np.inf
    else:
        tracker, outcome, nis = config.tracker.on_fix(state.tracker, fix)
        state = _after_fix_of_rival(config, replace_unchecked(state, tracker=tracker), fix, nis)
        if isinstance(fix, PositionFix):
            rides = state.rides.plus(fix, tracker.pedestrian.steps.trail[:, TRAIL_TIME])
            track_m = pedestrian.past_position(tracker.pedestrian, fix.time_s)
            conflict = state.conflict.plus(outcome, None if track_m is None else fix.position_m - track_m)
            state = replace_unchecked(state, rides=rides, conflict=conflict)
        if config.on_plan is not None:
            floor = state.height.known.floors.floor
            particles = config.on_plan.on_fix(state.particles, fix, outcome, tracker.pedestrian, config.model, floor)
            if outcome in ("nothing to compare", "waiting") and particles is not state.particles:
                outcome = "used"
            state = replace_unchecked(state, particles=particles)
    if isinstance(fix, PositionFix | GridFix) and outcome not in ("rejected", "frozen", "repeated"):
        state = replace_unchecked(state, height=height.with_fix(state.height, fix))
    result = FixResult.of(fix, now_s, outcome, nis)
    state = replace_unchecked(
        state,
        last_fixes=(*state.last_fixes, result)[-_N_LAST_FIXES:],
        n_rejected_fixes=state.n_rejected_fixes + (outcome == "rejected"),
        length_fixes=state.length_fixes.plus(fix) if result.accepted else state.length_fixes,
    )
    return state, result


def frame_name(config: Config, state: State) -> str:
    """Return the name of the frame of the track (`Track.frame`) without a floor plan."""
    name = state.tracker.pedestrian.frame.name
    return "north" if name == "start" and knows_north(config.sensing.heading) else name


def timing_error(fix: Fix, first_s: float, last_s: float) -> str:
    """Return why the time of a fix does not fit the samples, given their first and last times, or an empty string."""
    until_s = fix.end_s if isinstance(fix, Standstill) else fix.time_s
    late_s, ahead_s = max(received_s(fix), last_s) - until_s, fix.time_s - last_s
    remedy = "give fixes and samples on one clock, in seconds"
    if until_s < first_s - FIX_TOLERANCE_S:
        return f"the fix at {until_s:.1f} s is from before the first sample ({first_s:.1f} s); {remedy}"
    if late_s > MAX_FIX_AGE_S:
        return (
            f"the fix at {until_s:.1f} s comes {late_s:.0f} s late (last sample {last_s:.1f} s), more than "
            f"{MAX_FIX_AGE_S:.0f} s; {remedy}, or use pdr_filter.smooth, which takes fixes of any time"
        )
    if ahead_s > MAX_FIX_AGE_S:
        return f"the fix at {fix.time_s:.1f} s is {ahead_s:.0f} s ahead of the last sample ({last_s:.1f} s); {remedy}"
    return ""
