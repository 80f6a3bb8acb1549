"""Filter as a pure function: state and block of samples in, new state and output out."""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from operator import attrgetter
from typing import Any

import numpy as np

from pdr_filter.filter.chain.handler import End, FixUse, HandlerState, Locations, NewestStep, StepsEnd, Window, part_of
from pdr_filter.filter.chain.handler import Event as ChainEvent
from pdr_filter.filter.chain.two_hypotheses import Hypotheses
from pdr_filter.filter.chain.with_height import HeightTrack, window_log_evidence
from pdr_filter.filter.chain.with_plan import PlanTrack
from pdr_filter.filter.fixes.gnss import LocationState, good_locations, position_fixes
from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.filter.height.height_filter import HeightState
from pdr_filter.filter.pedestrian import pedestrian_state as pedestrian
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate, moved_by_heading_m
from pdr_filter.filter.pedestrian.person import LengthFixes, Person, session_of
from pdr_filter.filter.pedestrian.step_history import TRAIL_TIME
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.context_stage import with_climbs
from pdr_filter.sensing.features.barometer import STAIRS_MPS, ClimbState
from pdr_filter.sensing.front_end import Event, SensingState
from pdr_filter.sensing.heading.heading_stage import knows_north
from pdr_filter.sensing.stream_merging import Merged, MergerState, Sensor, StreamMerger
from pdr_filter.tracking.step_statistics import StepCounts, WindowCounts, is_in_standing, is_moving
from pdr_filter.values import (
    ContextSet,
    Fix,
    FixResult,
    FloatArray,
    FloorPassage,
    ImuBlock,
    OnPlan,
    Origin,
    PositionFix,
    Samples,
    Standstill,
    Step,
    WindowContext,
    received_s,
    replace_unchecked,
)
from pdr_filter.values.events import Climb, Gap, Undecided

# Maximum age of a fix. The tracker remembers `pedestrian_state.TRAIL_STEPS` steps: half a minute of continuous walking,
# or about a minute with rests. A larger difference means that fix and samples have different clocks.
MAX_FIX_AGE_S = 60.0
# A fix from the moment at which the sensors are switched on may be slightly older than the first sample.
FIX_TOLERANCE_S = 1.0

# Number of fix results kept for `Now.fixes`.
_N_LAST_FIXES = 16


@dataclass(frozen=True, eq=False)
class WaitingClimbs:
    """Barometer, and the climb rates that wait for the windows and steps of their times."""

    barometer: ClimbState  # state of the climb-rate estimator
    climbs: tuple[Climb, ...] = ()  # climb rates whose windows have not been classified yet
    n_used: int = 0  # number of leading elements of `climbs` that the height filter has used
    n_lost: int = 0  # number of climb rates dropped because their windows did not come


@dataclass(frozen=True, eq=False)
class Statistics:
    """Numbers and events of the walk so far, for its notes."""

    seen: WindowCounts = field(default_factory=WindowCounts)  # numbers of all windows and of unreliable ones
    walked: StepCounts = field(default_factory=StepCounts)  # numbers of all steps and of unreliable ones
    rides: Rides = field(default_factory=Rides)  # vehicle rides found in the position fixes
    # Number and area of the accepted fixes from which the filter learns the step length.
    length_fixes: LengthFixes = field(default_factory=LengthFixes)
    n_rejected_fixes: int = 0  # number of rejected fixes


@dataclass(frozen=True, eq=False)
class LastResults:
    """Last results of the filter."""

    window: WindowContext | None = None  # last classified window
    fixes: tuple[FixResult, ...] = ()  # outcomes of the last fixes
    update: StepUpdate | None = None  # last step since the last gap, or None if there is none
    # Begin of the motion whose steps are not known yet, s, or infinity. Fixes of later times wait for them.
    undecided_s: float = math.inf


@dataclass(frozen=True, eq=False)
class State:
    """Complete state of a filter: everything that changes with samples and fixes.

    Attributes
    ----------
    sensing : SensingState
        State of the stages from samples to steps and windows.
    chain : HandlerState
        State of the chain of handlers (`Config.chain`): tracker, second hypothesis, path, height, floor plan.
    waiting_climbs : WaitingClimbs
        Climb rates that are not due yet.
    waiting_fixes : tuple of Fix
        Fixes that have not been received yet, or whose steps are not known yet, ordered by due time.
    merger : MergerState
        State of the merging of sensors that arrive separately.
    locations : LocationState
        State of the conversion from geographic locations to position fixes.
    statistics : Statistics
        Numbers and events so far, for the notes.
    last : LastResults
        Last results.
    finished : bool
        True after `finish_filter`.
    """

    sensing: SensingState
    chain: HandlerState
    waiting_climbs: WaitingClimbs
    waiting_fixes: tuple[Fix, ...] = ()
    merger: MergerState = field(default_factory=StreamMerger().init)
    locations: LocationState = field(default_factory=LocationState)
    statistics: Statistics = field(default_factory=Statistics)
    last: LastResults = field(default_factory=LastResults)
    finished: bool = False

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates of the tracker after the last event."""
        return self.chain.pedestrian

    @property
    def height(self) -> HeightState:
        """State of the height filter."""
        return part_of(self.chain, HeightTrack).height

    @property
    def particles(self) -> Any:
        """State of the stage on the floor plan. The configuration must have one."""
        return part_of(self.chain, PlanTrack).particles

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


def init_filter(config: Config) -> State:
    """Return the state of a filter before its first sample.

    With a floor plan, the storey is the storey of the start on the plan, and the plan gives the origin of the
    locations.
    """
    plan = None if config.on_plan is None else config.on_plan.plan
    return State(
        sensing=config.sensing.init(),
        chain=config.chain.init(),
        waiting_climbs=WaitingClimbs(config.climb_rate.init()),
        # With a plan in degrees, the origin of the plan is the origin of the locations.
        locations=LocationState() if plan is None else LocationState(origin=plan.origin),
    )


def check_unfinished(state: State, what: str) -> None:
    """Raise ValueError if the filter is finished and takes no more samples, locations or fixes."""
    if state.finished:
        raise ValueError(f"the filter is finished: start a new one for further {what}")


def update_filter(config: Config, state: State, block: ImuBlock, provisional: bool = False) -> tuple[State, Output]:
    """Return the new state and the output after a block of samples of any length.

    With `provisional`, the output has a provisional update of each step that is not final when it is detected. The
    result depends on samples and fixes only, and not on the division into blocks. ValueError after `finish_filter`.
    """
    check_unfinished(state, "samples")
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
    `provisional` is an argument of `update_filter`. ValueError after `finish_filter`.
    """
    check_unfinished(state, "samples")
    merger, merged = config.merger.together(state.merger, samples)
    return _with_merged(config, replace_unchecked(state, merger=merger), merged, provisional)


def _with_merged(config: Config, state: State, merged: Merged, provisional: bool = False) -> tuple[State, Output]:
    if len(merged.pressure_time_s):
        state = add_pressure(config, state, merged.pressure_time_s, merged.pressure_hpa)
    return update_filter(config, state, merged.block, provisional) if len(merged.block.time_s) else (state, Output())


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
    waiting = state.waiting_climbs
    barometer, new = config.climb_rate.update(waiting.barometer, time_s + state.clock_offset_s, pressure_hpa)
    climbs = (*waiting.climbs, *new)
    n_lost = max(len(climbs) - MAX_CLIMBS, 0)
    waiting = WaitingClimbs(barometer, climbs[n_lost:], max(waiting.n_used - n_lost, 0), waiting.n_lost + n_lost)
    return replace_unchecked(state, waiting_climbs=waiting)


def add_location(config: Config, state: State, location: Samples) -> State:
    """Return the state with geographic locations, a stream as in `Recording`, on the clock of the samples.

    Some of them become position fixes, in metres from the first usable location.
    """
    location = replace(location, time_s=location.time_s + state.clock_offset_s)
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
    where = latitude_deg, longitude_deg, accuracy_m
    locations, fixes = position_fixes(state.locations, location.time_s, *where, altitude_m=altitude_m)
    if locations.origin is not None:
        state = add_terrain_locations(config, state, locations.origin, location)
    return add_fixes(config, replace_unchecked(state, locations=locations), fixes)


# Age up to which locations are kept for terrain detection: steps and pressures become known some seconds late, and the
# height filter compares them with locations some seconds earlier.
_LOCATIONS_S = 20.0


def add_terrain_locations(config: Config, state: State, origin: Origin, location: Samples) -> State:
    """Return the state with locations, on the track clock, that only distinguish hills from storeys."""
    last = part_of(state.chain, HeightTrack).locations[-1:].tolist()
    latitude_deg, longitude_deg, _, accuracy_m = location.values.T
    new = good_locations(origin, location.time_s, latitude_deg, longitude_deg, accuracy_m, *map(tuple, last))
    now_s = state.sensing.processed_s
    chain, _ = config.chain.on(state.chain, Locations(new, now_s - _LOCATIONS_S), now_s)
    return replace_unchecked(state, chain=chain)


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
    position_m, cov_m2 = pedestrian.reckoned_position(state.pedestrian)
    reckoned = position_m, part_of(state.chain, Hypotheses).with_spread(position_m, cov_m2)
    estimate = estimate_on_plan(config, state, reckoned)
    return reckoned if estimate is None else (estimate.position_m, estimate.position_cov_m2)


def estimate_on_plan(config: Config, state: State, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
    """Return the estimate on the floor plan, or None without one, for a position (2,) and covariance (2, 2)."""
    if config.on_plan is None:
        return None
    return config.on_plan.estimate(state.particles, reckoned)


def person_of(config: Config, state: State) -> Person | None:
    """Return the person's step length, from earlier walks (`config.person`) and the fixes of this one.

    If the fixes tell nothing, the result is `config.person`, which may be None.
    """
    session = session_of(config.model, state.pedestrian.estimates, state.statistics.length_fixes)
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


def finish_filter(config: Config, state: State) -> tuple[State, Output]:
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
    end_s = state.sensing.processed_s
    state = _after(config, state, StepsEnd(), end_s, output)
    state = _with_climbs(config, state, np.inf, output)
    state = _after(config, state, End(), end_s, output)
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
    if not (events or state.waiting_fixes or state.waiting_climbs.climbs):  # most blocks are shorter than a hop
        return state, output
    model, contexts = config.model, [event for _, event in events if isinstance(event, WindowContext)]
    climbs = state.waiting_climbs.climbs
    evidence = iter(window_log_evidence(contexts, model)) if climbs else repeat(None)
    contexts = iter(with_climbs(contexts, [climb_at(climbs, w.time_s) for w in contexts], model.context_set))
    for known_s, event in events:
        if isinstance(event, Step):  # all steps before it are known
            begin_s = event.time_s - event.duration_s
            state = _with_last(state, undecided_s=begin_s) if begin_s > state.last.undecided_s else state
        state, used = _use_due_fixes(config, state, known_s)
        output.fixes.extend(used)
        state = _with_climbs(config, state, known_s, output)
        if isinstance(event, Undecided):
            state = _with_last(state, undecided_s=event.since_s)
        elif isinstance(event, WindowContext):
            context = next(contexts)
            output.windows.append(context)
            statistics = _after_window(state.statistics, context, model.context_set)
            last = replace_unchecked(state.last, window=context)
            state = replace_unchecked(state, statistics=statistics, last=last)
            state = _after(config, state, Window(context, next(evidence)), known_s, output)
        elif isinstance(event, Step):
            state = _after_step(config, state, event, known_s, output, provisional)
        else:
            if isinstance(event, Gap):
                state = _with_last(state, update=None, undecided_s=math.inf)
            state = _after(config, state, event, known_s, output)
    state, used = _use_due_fixes(config, state, state.sensing.processed_s)
    output.fixes.extend(used)
    state = _with_climbs(config, state, state.sensing.processed_s, output)
    waiting = state.waiting_climbs
    n_past = max(bisect_right(waiting.climbs, state.sensing.processed_s, key=attrgetter("time_s")) - 1, 0)
    n_past = min(n_past, waiting.n_used)
    waiting = replace_unchecked(waiting, climbs=waiting.climbs[n_past:], n_used=waiting.n_used - n_past)
    return replace_unchecked(state, waiting_climbs=waiting), output


def _with_last(state: State, **changes: Any) -> State:
    return replace_unchecked(state, last=replace_unchecked(state.last, **changes))


def _with_statistics(state: State, **changes: Any) -> State:
    return replace_unchecked(state, statistics=replace_unchecked(state.statistics, **changes))


def _after(config: Config, state: State, event: ChainEvent, known_s: float, output: Output) -> State:
    """Return the state after an event of the chain, whose rows and floor passages are appended to the output."""
    chain, results = config.chain.on(state.chain, event, known_s)
    if not results:
        return replace_unchecked(state, chain=chain)
    statistics, last, standing = state.statistics, state.last, config.model.context_set.standing
    for result in results:
        if isinstance(result, StepUpdate):
            output.updates.append(result)
            last = replace_unchecked(last, update=result)
            if result.is_final:
                is_standing = bool(is_in_standing(result.context_prob, standing))
                statistics = replace_unchecked(statistics, walked=statistics.walked.plus_context(is_standing))
        elif isinstance(result, FloorPassage):
            output.floor_passages.append(result)
    return replace_unchecked(state, chain=chain, statistics=statistics, last=last)


def _after_step(config: Config, state: State, step: Step, known_s: float, output: Output, provisional: bool) -> State:
    """Return the state after a step, with a provisional row if the step is not final and `provisional` is True."""
    before, n_before = state.pedestrian, len(output.updates)
    state = _after(config, state, step, known_s, output)
    after = state.pedestrian
    moved_m = moved_by_heading_m(before, after, sum(update.step_length_m for update in output.updates[n_before:]))
    walked = state.statistics.walked.plus(step, math.sqrt(pedestrian.heading_var_rad2(after)), moved_m)
    state = _with_statistics(state, walked=walked)
    if provisional and config.tracker.waits_for_windows:
        return _after(config, state, NewestStep(), known_s, output)
    return state


def _after_window(statistics: Statistics, context: WindowContext, context_set: ContextSet) -> Statistics:
    moving_s = context.hop_s * bool(is_moving(context.prob[context_set.standing].sum()))
    rides = statistics.rides.with_windows(context.hop_s, moving_s)
    return replace_unchecked(statistics, rides=rides, seen=statistics.seen.plus(context, context_set))


def _with_climbs(config: Config, state: State, until_s: float, output: Output) -> State:
    """Return the state whose chain has received the climb rates up to a time, less the latency of steps.

    All steps before that time are known, except the first step of a bout, which is detected later.
    """
    waiting = state.waiting_climbs
    n_used = waiting.n_used
    if n_used == len(waiting.climbs):
        return state
    until_s -= config.sensing.step_latency_s
    while n_used < len(waiting.climbs) and waiting.climbs[n_used].time_s <= until_s:
        state = _after(config, state, waiting.climbs[n_used], until_s, output)
        n_used += 1
    return replace_unchecked(state, waiting_climbs=replace_unchecked(waiting, n_used=n_used))


def _use_due_fixes(config: Config, state: State, until_s: float) -> tuple[State, list[FixResult]]:
    if not state.waiting_fixes or due_s(config, state.waiting_fixes[0]) > until_s:
        return state, []
    n_due = bisect_right(state.waiting_fixes, until_s, key=lambda f: due_s(config, f))
    used, waiting = list[FixResult](), list[Fix]()
    for fix in state.waiting_fixes[:n_due]:
        # the steps before it may still become known, as in the first seconds of a walk
        if fix.time_s >= state.last.undecided_s and not isinstance(fix, Standstill):
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
    use, rides = FixUse(fix, "rejected", math.inf), state.statistics.rides
    if not timing_error(fix, state.sensing.conditioner.report.first_time_s, received_s(fix)):
        chain, results = config.chain.on(state.chain, fix, now_s)
        use = next(result for result in results if isinstance(result, FixUse))
        state = replace_unchecked(state, chain=chain)
        if isinstance(fix, PositionFix):
            rides = rides.plus(fix, state.pedestrian.steps.trail[:, TRAIL_TIME])
    result, lengths = FixResult.of(fix, now_s, use.outcome, use.nis), state.statistics.length_fixes
    n_rejected = state.statistics.n_rejected_fixes + (use.outcome == "rejected")
    lengths = lengths.plus(fix) if result.accepted else lengths
    state = _with_statistics(state, rides=rides, length_fixes=lengths, n_rejected_fixes=n_rejected)
    return _with_last(state, fixes=(*state.last.fixes, result)[-_N_LAST_FIXES:]), result


def frame_name(config: Config, state: State) -> str:
    """Return the name of the frame of the track (`Track.frame`) without a floor plan."""
    name = state.pedestrian.frame.name
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
