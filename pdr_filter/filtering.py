"""The filter as one pure step over a block of samples."""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite
from operator import attrgetter

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter import height, pedestrian
from pdr_filter.filter.height import HeightState, initial_height
from pdr_filter.filter.pedestrian import StepUpdate
from pdr_filter.filter.person import Person, session_of
from pdr_filter.filter.tracker import Passage, TrackerState
from pdr_filter.gnss import LocationState, position_fixes
from pdr_filter.maps.particles import ParticleState
from pdr_filter.sensing.contexts.stage import WindowContext, with_climb
from pdr_filter.sensing.features.barometric import Climb, ClimbState
from pdr_filter.sensing.front_end import Event, Gap, SensingState
from pdr_filter.sensing.merging import SENSORS, Merged, MergerState, Sensor, StreamMerger
from pdr_filter.values import (
    CONTEXTS,
    HARDLY_AGREE,
    Fix,
    FixResult,
    FloatArray,
    FloorPassage,
    ImuBlock,
    Note,
    OnPlan,
    PositionFix,
    SpeedFix,
    Standstill,
    Step,
    how_many,
    received_s,
    replace,
)

# How old a fix of an app may be: the remembered steps (`pedestrian.TRAIL_STEPS`) are half a minute of walking, and a
# pedestrian who rests now and then makes as many in a minute. A clock that is further off is another clock.
MAX_FIX_AGE_S = 60.0
# A fix of the moment at which the sensors were switched on is one of their first sample.
FIX_TOLERANCE_S = 1.0

# Results of fixes that an app can still ask for.
_N_LAST_FIXES = 16
_STATIONARY, _WALKING = CONTEXTS.index("stationary"), CONTEXTS.index("walking")


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were, and how many of them were odd."""

    n: int = 0
    without_gyroscope: int = 0
    unknown: int = 0
    stairs_unknown: int = 0  # of windows without climb rate in which somebody walks
    irregular: int = 0

    def plus(self, window: WindowContext) -> WindowCounts:
        """With one window more."""
        irregular = window.irregular_prob > 0.5 and window.prob[_STATIONARY] < 0.5
        blind = window.stairs_unknown_share > 0.5 and window.prob[_WALKING] > 0.5 and np.isnan(window.climb_rate_mps)
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + (window.unknown_share > 0.5),
            self.stairs_unknown + int(blind),
            self.irregular + int(irregular),
        )


@dataclass(frozen=True, slots=True)
class StepCounts:
    """How many steps there were, and of how many the direction, or all, is doubtful."""

    n: int = 0
    untrusted: int = 0
    quick_and_soft: int = 0

    def plus(self, step: Step) -> StepCounts:
        """With one step more."""
        is_untrusted = isfinite(step.shown_offset_std_rad) and step.direction_trust < HARDLY_AGREE
        return StepCounts(self.n + 1, self.untrusted + is_untrusted, self.quick_and_soft + step.is_quick_and_soft)


@dataclass(frozen=True, eq=False)
class State:
    """Everything about a filter that changes."""

    sensing: SensingState
    tracker: TrackerState
    barometer: ClimbState
    seen: WindowCounts = WindowCounts()
    walked: StepCounts = StepCounts()
    height: HeightState = field(default_factory=initial_height)
    climbs: tuple[Climb, ...] = ()  # from the barometer, for windows that are still to come
    n_lost_climbs: int = 0  # that waited too long for their windows
    n_climbs_used: int = 0  # of these, by the height
    locations: LocationState = field(default_factory=LocationState)
    waiting_fixes: tuple[Fix, ...] = ()  # not yet received, or from a time whose steps are not yet known
    n_rejected_fixes: int = 0
    n_length_fixes: int = 0  # used ones that say how long steps are: positions and speeds
    particles: ParticleState = field(default_factory=ParticleState)  # on the floor plan, if there is one
    merger: MergerState = field(default_factory=StreamMerger().init)  # of sensors that arrive apart
    window: WindowContext | None = None  # the last one
    last_fixes: tuple[FixResult, ...] = ()  # what became of them
    last_update: StepUpdate | None = None  # of this segment
    finished: bool = False

    @property
    def clock_offset_s(self) -> float:
        """What is added to a time of the samples' clock, which may have been set back, to have the track's."""
        return self.sensing.conditioner.clock.offset_s


@dataclass(frozen=True, eq=False)
class Output:
    """What one block of samples brought."""

    updates: list[StepUpdate] = field(default_factory=list[StepUpdate])
    windows: list[WindowContext] = field(default_factory=list[WindowContext])
    fixes: list[FixResult] = field(default_factory=list[FixResult])
    passages: list[Passage] = field(default_factory=list[Passage])  # how steps and gaps led the estimates on
    floor_passages: list[FloorPassage] = field(default_factory=list[FloorPassage])  # that ended

    def extend(self, later: Output) -> None:
        """Add what came later."""
        for name in ("updates", "windows", "fixes", "passages", "floor_passages"):
            getattr(self, name).extend(getattr(later, name))


def init(config: Config) -> State:
    """State of a filter before its first sample."""
    state = State(config.sensing.init(), config.tracker.init(), config.climb_rate.init())
    on_plan = config.on_plan
    if on_plan is None:
        return state
    if on_plan.start is not None:
        state = replace(state, height=height.with_floor(state.height, on_plan.start.floor))
    # locations are then in the frame of the plan
    return replace(state, locations=LocationState(origin=on_plan.plan.origin), particles=on_plan.init())


def step(config: Config, state: State, block: ImuBlock) -> tuple[State, Output]:
    """New state and output after a block of samples of any length.

    The result depends on the samples and fixes only, not on how they were cut into blocks. ValueError after `finish`.
    """
    if state.finished:
        raise ValueError("the filter is finished: start a new one for further samples")
    whole = Output()
    for part in parts(block):
        sensing, events = config.sensing.step(state.sensing, part)
        state, output = _process(config, replace(state, sensing=sensing), events)
        whole.extend(output)
    return state, whole


def arrive(
    config: Config, state: State, sensor: Sensor, time_s: FloatArray, values: FloatArray
) -> tuple[State, Output]:
    """New state and output after samples (N,), (N, d) of one sensor, which wait for those of the others."""
    if state.finished:
        raise ValueError("the filter is finished: start a new one for further samples")
    merger, merged = config.merger.step(state.merger, sensor, time_s, values)
    return _with_merged(config, replace(state, merger=merger), merged)


def _with_merged(config: Config, state: State, merged: Merged) -> tuple[State, Output]:
    if len(merged.pressure_time_s):
        state = add_pressure(config, state, merged.pressure_time_s, merged.pressure_hpa)
    return step(config, state, merged.block) if len(merged.block.time_s) else (state, Output())


# Samples that go through the stages at once: some minutes, so that memory stays small. No result depends on it.
PART_SAMPLES = 60_000


def parts(block: ImuBlock) -> Iterator[ImuBlock]:
    """A block in pieces of at most `PART_SAMPLES`."""
    for start in range(0, len(block.time_s), PART_SAMPLES):
        part = slice(start, start + PART_SAMPLES)
        yield ImuBlock(
            block.time_s[part],
            block.specific_force_mps2[part],
            block.angular_rate_radps[part],
            block.magnetic_field_ut[part],
        )


# Climb rates that wait for their windows, one a second: ten minutes before the samples a barometer has another clock.
MAX_CLIMBS = 600


def add_pressure(config: Config, state: State, time_s: FloatArray, pressure_hpa: FloatArray) -> State:
    """State with samples of a barometer, (N,) each; windows that end after them use the climb rate.

    Give the pressure of a time before the other samples of that time: a window is classified once.
    """
    barometer, climbs = config.climb_rate.step(state.barometer, time_s + state.clock_offset_s, pressure_hpa)
    all_climbs = (*state.climbs, *climbs)
    n_lost = max(len(all_climbs) - MAX_CLIMBS, 0)
    return replace(
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
) -> State:
    """State with locations of a phone, (N,) each, some of which become fixes in metres from the first of them."""
    time_s = time_s + state.clock_offset_s
    locations, fixes = position_fixes(state.locations, time_s, latitude_deg, longitude_deg, accuracy_m)
    return add_fixes(config, replace(state, locations=locations), fixes)


def add_fixes(config: Config, state: State, fixes: Sequence[Fix]) -> State:
    """State with fixes, on the track's time base, that wait until they are due."""
    waiting = list(state.waiting_fixes)
    for fix in fixes:
        insort(waiting, fix, key=lambda f: due_s(config, f))
    return replace(state, waiting_fixes=tuple(waiting))


def present_position(config: Config, state: State) -> tuple[FloatArray, FloatArray]:
    """Position (2,) and covariance (2, 2) after the last final step, on the floor plan if there is one."""
    place = None if config.on_plan is None else config.on_plan.place(state.particles)
    if place is not None:
        return place.position_m, place.position_cov_m2
    return pedestrian.present_position(state.tracker.pedestrian)


def person_of(config: Config, state: State) -> Person | None:
    """What is known of the person in the end: of walks before, and of the fixes of this one; None if nothing is."""
    session = session_of(config.model, state.tracker.pedestrian, state.n_length_fixes)
    if session is None:
        return config.person
    return (config.person or Person()).pooled(Person((session,)))


# The same of steps: a turn, or a door, is ten of them.
_UNTRUSTED_SHARE, _UNTRUSTED_NUMBER = 0.2, 20
# Share of all windows, and number, above which it is worth saying that something is odd about them.
_NOTABLE_SHARE, _NOTABLE_NUMBER = 0.05, 3


def notes_of(config: Config, state: State) -> list[Note]:
    """What to keep in mind about the track so far: the same for a whole recording and for an app."""
    seen = state.seen
    notes = [Note("samples", text) for text in state.sensing.conditioner.notes()]
    if state.finished and state.tracker.pedestrian.n_final == 0:
        notes.append(Note("steps", "no steps found: dead reckoning does not apply here"))
    moving_s, seen_s = state.sensing.rattle.moving_s, state.sensing.rattle.seen_s
    if moving_s:
        words = f"moving without steps for {moving_s} s, {100 * moving_s / seen_s:.0f} % of the time: "
        notes.append(Note("steps", words + "the phone shakes as on wheels, and no distance is counted there"))
    of_all, notable = f"of {seen.n} windows", max(_NOTABLE_SHARE * seen.n, _NOTABLE_NUMBER)
    if seen.without_gyroscope:
        words = f"contexts of {seen.without_gyroscope} {of_all} without gyroscope, which are less sure: "
        notes.append(Note("sensors", words + "there was no angular rate"))
    if seen.unknown > notable:
        words = f"{seen.unknown} {of_all} are unlike all that the context model was trained on: "
        notes.append(Note("contexts", words + "contexts are unsure there"))
    for sensor, last_s in config.merger.silent(state.merger):
        notes.append(Note("sensors", f"{sensor}: silent since {last_s:.1f} s, the others go on without it"))
    for sensor, stream in zip(SENSORS, state.merger.streams, strict=True):
        if stream.n_late:
            words = f"{sensor}: {stream.n_late} of {stream.n_received} samples came again or too late for the others, "
            notes.append(Note("samples", words + "and were left out"))
    if seen.stairs_unknown > notable:
        words = f"in {seen.stairs_unknown} {of_all} stairs would be taken for level walking: the context model knows "
        notes.append(Note("contexts", words + "them from trouser pockets, and no barometer told"))
    if seen.irregular > notable:
        words = f"in {seen.irregular} {of_all} the phone seems to be handled, not carried by somebody who walks: "
        notes.append(Note("steps", words + "steps there may be false"))
    if state.walked.quick_and_soft > max(_UNTRUSTED_SHARE * state.walked.n, _UNTRUSTED_NUMBER):
        words = (
            f"{state.walked.quick_and_soft} of {state.walked.n} steps are as quick as running and as soft as walking, "
        )
        notes.append(
            Note("steps", words + "as on the spot: lengths and directions there are worse than the covariance says")
        )
    if state.walked.untrusted > max(_UNTRUSTED_SHARE * state.walked.n, _UNTRUSTED_NUMBER):
        words = f"in {state.walked.untrusted} of {state.walked.n} steps strides do not agree on where walking leads, "
        words += "as in a bag: the turn of the phone alone leads there"
        notes.append(Note("heading", words))
    notes += [*config.notes, *height.notes(state.height)]
    if config.on_plan is not None:
        notes += config.on_plan.notes(state.particles)
    frame, where = state.tracker.pedestrian.frame, state.locations
    if where.n_unusable:
        words = (
            f"{where.n_unusable} of {where.n} locations are not used: no place on Earth, no accuracy, or back in time"
        )
        notes.append(Note("fixes", words))
    if state.finished and where.origin is not None and frame.alignment is None:
        words = "the locations do not settle which way the track lies: its north is the most probable one"
        notes.append(Note("fixes", words))
    if frame.moves:
        far_m = ", ".join(f"{np.linalg.norm(m.world_centre_m - m.track_centre_m):.0f}" for m in frame.moves)
        words = (
            f"fixes that agree with each other and not with the track moved it by {far_m} m: after a ride, or wrong "
        )
        notes.append(Note("fixes", words + "first fixes; what was before stays as it was"))
    if state.n_lost_climbs:
        words = f"{how_many(state.n_lost_climbs, 'climb rate')} of the barometer not used: its times are ahead of the "
        notes.append(Note("sensors", words + "samples, both need one clock"))
    if state.finished and frame.name == "north" and frame.compass is not None:
        words = f"north is where the magnetic field says, give or take {np.degrees(frame.compass.std_rad):.0f} degrees"
        notes.append(Note("heading", words))
    if state.n_rejected_fixes:
        notes.append(Note("fixes", f"fixes rejected as outliers: {state.n_rejected_fixes}"))
    if state.finished and state.waiting_fixes:
        notes.append(Note("fixes", f"fixes from after the last sample, not used: {len(state.waiting_fixes)}"))
    return notes


# A window and the climb rate that it uses share at least half of their seconds.
_CLIMB_AGE_S = 1.0


def climb_at(climbs: Sequence[Climb], time_s: float) -> Climb | None:
    """The last climb rate at or before a time, if it is recent enough."""
    i = bisect_right(climbs, time_s, key=attrgetter("time_s"))
    return climbs[i - 1] if i and climbs[i - 1].time_s >= time_s - _CLIMB_AGE_S else None


def finish(config: Config, state: State) -> tuple[State, Output]:
    """New state and output when no further sample will come: late steps are found, waiting ones become final.

    Fixes of the recording's time that still wait are used; later ones stay waiting. A second call gives nothing.
    """
    if state.finished:
        return state, Output()
    merger, merged = config.merger.finish(state.merger)
    state, output = _with_merged(config, replace(state, merger=merger), merged)
    state, late = _process(config, state, config.sensing.finish(state.sensing))
    output.extend(late)
    tracker, last = config.tracker.finish(state.tracker)
    end_s = state.sensing.processed_s
    state = _with_steps(config, state, end_s, last.updates, output)
    output.passages.extend(last.passages)
    state = _with_pressure(config, state, np.inf, output)
    known, passages = height.finish(state.height)
    output.floor_passages.extend(passages)
    state = replace(state, height=known)
    due = [f for f in state.waiting_fixes if received_s(f) <= end_s]
    later = [f for f in state.waiting_fixes if received_s(f) > end_s]
    state = replace(state, tracker=tracker, waiting_fixes=tuple(later), finished=True)
    for fix in due:
        state, result = _use_fix(config, state, fix, end_s)
        output.fixes.append(result)
    return state, output


def _process(config: Config, state: State, events: list[tuple[float, Event]]) -> tuple[State, Output]:
    output = Output()
    for known_s, event in events:
        state, used = _use_due_fixes(config, state, known_s)
        output.fixes.extend(used)
        state = _with_pressure(config, state, known_s, output)
        if isinstance(event, WindowContext):
            state = replace(state, height=height.on_window(state.height, event, config.model))
            context = with_climb(event, climb_at(state.climbs, event.time_s))
            output.windows.append(context)
            state = replace(state, seen=state.seen.plus(context), window=context)
            tracker, brought = config.tracker.on_window(state.tracker, context)
        elif isinstance(event, Gap):
            tracker, brought = config.tracker.on_gap(state.tracker, event.duration_s)
            if config.on_plan is not None:
                particles = config.on_plan.on_gap(state.particles, event.duration_s, config.model)
                state = replace(state, particles=particles)
            state = replace(state, last_update=None)
        else:
            state = replace(state, walked=state.walked.plus(event))
            tracker, brought = config.tracker.on_step(state.tracker, event)
        state = _with_steps(config, replace(state, tracker=tracker), known_s, brought.updates, output)
        output.passages.extend(brought.passages)
    state, used = _use_due_fixes(config, state, state.sensing.processed_s)
    output.fixes.extend(used)
    state = _with_pressure(config, state, state.sensing.processed_s, output)
    n_past = max(bisect_right(state.climbs, state.sensing.processed_s, key=attrgetter("time_s")) - 1, 0)
    n_past = min(n_past, state.n_climbs_used)
    return replace(state, climbs=state.climbs[n_past:], n_climbs_used=state.n_climbs_used - n_past), output


def _with_pressure(config: Config, state: State, until_s: float, output: Output) -> State:
    """State whose height knows the pressure up to a time whose steps are known, but for the first of a bout."""
    until_s -= config.sensing.step_latency_s
    while state.n_climbs_used < len(state.climbs) and state.climbs[state.n_climbs_used].time_s <= until_s:
        known, passages = height.on_pressure(state.height, state.climbs[state.n_climbs_used], config.model)
        output.floor_passages.extend(passages)
        state = replace(state, height=known, n_climbs_used=state.n_climbs_used + 1)
    return state


def _with_steps(config: Config, state: State, known_s: float, updates: Sequence[StepUpdate], output: Output) -> State:
    """State whose height knows the steps that became final, and the output with theirs."""
    known = state.height
    for update in updates:
        if update.is_final:
            up_prob, down_prob = (float(update.mode_prob @ of_context) for of_context in config.model.on_stairs)
            known, own, passages = height.on_step(known, known_s, update.step.time_s, up_prob, down_prob, config.model)
            output.floor_passages.extend(passages)
        else:
            own = known.known
        there = {"height_m": own.height_m, "height_std_m": own.height_std_m, "floor": own.floors.floor}
        update = replace(update, **there)
        if config.on_plan is not None and update.is_final:
            known_now = state.tracker.pedestrian
            state = replace(state, particles=config.on_plan.on_step(state.particles, update, known_now, config.model))
            update = _on_plan(update, config.on_plan.place(state.particles))
        output.updates.append(update)
    return replace(state, height=known, last_update=output.updates[-1]) if updates else state


def _on_plan(update: StepUpdate, place: OnPlan | None) -> StepUpdate:
    """A step where the particles on a plan are, if there are some."""
    if place is None:
        return update
    return replace(
        update,
        on_plan=place,
        position_m=place.position_m,
        position_cov_m2=place.position_cov_m2,
        walking_heading_rad=place.walking_heading_rad,
        of_start=None,
    )


def _use_due_fixes(config: Config, state: State, until_s: float) -> tuple[State, list[FixResult]]:
    n_due = bisect_right(state.waiting_fixes, until_s, key=lambda f: due_s(config, f))
    used, due = list[FixResult](), state.waiting_fixes[:n_due]
    state = replace(state, waiting_fixes=state.waiting_fixes[n_due:]) if due else state
    for fix in due:
        state, result = _use_fix(config, state, fix, until_s)
        used.append(result)
    return state, used


def due_s(config: Config, fix: Fix) -> float:
    """When a fix is used: it waits for the step that it falls into, compared with an earlier place it would pull ahead.

    A standstill waits for nothing: it is about steps to come.
    """
    if isinstance(fix, Standstill):
        return received_s(fix)
    return max(received_s(fix), fix.time_s + config.fix_delay_s)


def _use_fix(config: Config, state: State, fix: Fix, now_s: float) -> tuple[State, FixResult]:
    if untimely(fix, state.sensing.conditioner.report.first_time_s, received_s(fix)):
        outcome, nis = "rejected", np.inf
    else:
        tracker, outcome, nis = config.tracker.on_fix(state.tracker, fix)
        state = replace(state, tracker=tracker)
        if config.on_plan is not None:
            floor = state.height.known.floors.floor
            particles = config.on_plan.on_fix(state.particles, fix, outcome, tracker.pedestrian, config.model, floor)
            state = replace(state, particles=particles)
    if isinstance(fix, PositionFix) and fix.floor is not None and outcome != "rejected":
        state = replace(state, height=height.with_floor(state.height, fix.floor))
    result = FixResult.of(fix, now_s, outcome, nis)
    state = replace(
        state,
        last_fixes=(*state.last_fixes, result)[-_N_LAST_FIXES:],
        n_rejected_fixes=state.n_rejected_fixes + (outcome == "rejected"),
        n_length_fixes=state.n_length_fixes + (result.accepted and isinstance(fix, PositionFix | SpeedFix)),
    )
    return state, result


def untimely(fix: Fix, first_s: float, last_s: float) -> str:
    """Why a fix is of another time than the samples so far, whose first and last are given; empty if it is not."""
    until_s = fix.end_s if isinstance(fix, Standstill) else fix.time_s
    late_s, ahead_s = max(received_s(fix), last_s) - until_s, fix.time_s - last_s
    remedy = "fixes and samples need one clock, in seconds"
    if until_s < first_s - FIX_TOLERANCE_S:
        return f"the fix at {until_s:.1f} s is from before the first sample ({first_s:.1f} s); {remedy}"
    if late_s > MAX_FIX_AGE_S:
        return (
            f"the fix at {until_s:.1f} s comes {late_s:.0f} s late (last sample {last_s:.1f} s), more than "
            f"{MAX_FIX_AGE_S:.0f} s; {remedy}; pdr_filter.smooth takes fixes of any time"
        )
    if ahead_s > MAX_FIX_AGE_S:
        return f"the fix at {fix.time_s:.1f} s is {ahead_s:.0f} s ahead of the last sample ({last_s:.1f} s); {remedy}"
    return ""
