"""The filter as one pure step over a block of samples."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter.tracking import StepUpdate, TrackerState
from pdr_filter.sensing.contexts.stage import WindowContext, with_climb
from pdr_filter.sensing.features.barometric import Climb, ClimbState
from pdr_filter.sensing.front_end import Event, Gap, SensingState
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.contexts import CONTEXTS
from pdr_filter.values.fixes import Fix, FixResult, Standstill, received_s
from pdr_filter.values.samples import ImuBlock

# How old a fix of an app may be: the remembered steps (`tracking.TRAIL_STEPS`) are half a minute of walking, and a
# pedestrian who rests now and then makes as many in a minute. A clock that is further off is another clock.
MAX_FIX_AGE_S = 60.0


# A fix of the moment at which the sensors were switched on is one of their first sample.
FIX_TOLERANCE_S = 1.0


_STATIONARY = CONTEXTS.index("stationary")


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were, and how many of them were odd."""

    n: int = 0
    without_gyroscope: int = 0
    unknown: int = 0
    irregular: int = 0

    def plus(self, window: WindowContext) -> WindowCounts:
        """With one window more."""
        irregular = window.irregular_prob > 0.5 and window.prob[_STATIONARY] < 0.5
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + (window.unknown_share > 0.5),
            self.irregular + int(irregular),
        )


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything about a filter that changes."""

    sensing: SensingState
    tracker: TrackerState
    barometer: ClimbState
    seen: WindowCounts = WindowCounts()
    climbs: tuple[Climb, ...] = ()  # from the barometer, for windows that are still to come
    waiting_fixes: tuple[Fix, ...] = ()  # not yet received, or from a time whose steps are not yet known
    finished: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """What one block of samples brought."""

    updates: list[StepUpdate] = field(default_factory=list[StepUpdate])
    windows: list[WindowContext] = field(default_factory=list[WindowContext])
    fixes: list[FixResult] = field(default_factory=list[FixResult])


def init(config: Config) -> State:
    """State of a filter before its first sample."""
    return State(config.sensing.init(), config.tracker.init(), config.climb_rate.init())


# Sees the filter's state before each event that changes it.
Watch = Callable[[TrackerState, Event], None]


def step(config: Config, state: State, block: ImuBlock, watch: Watch | None = None) -> tuple[State, Output]:
    """New state and output after a block of samples of any length.

    The result depends on the samples and fixes only, not on how they were cut into blocks. ValueError after `finish`.
    """
    if state.finished:
        raise ValueError("the filter is finished: start a new one for further samples")
    whole = Output()
    for part in parts(block):
        sensing, events = config.sensing.step(state.sensing, part)
        state, output = _process(config, replace(state, sensing=sensing), events, watch)
        whole.updates.extend(output.updates)
        whole.windows.extend(output.windows)
        whole.fixes.extend(output.fixes)
    return state, whole


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


def add_pressure(config: Config, state: State, time_s: FloatArray, pressure_hpa: FloatArray) -> State:
    """State with samples of a barometer, (N,) each; windows that end after them use the climb rate.

    Give the pressure of a time before the other samples of that time: a window that is classified is not seen anew.
    """
    barometer, climbs = config.climb_rate.step(state.barometer, time_s, pressure_hpa)
    return replace(state, barometer=barometer, climbs=(*state.climbs, *climbs))


# Share of all windows, and number, above which it is worth saying that something is odd about them.
_NOTABLE_SHARE, _NOTABLE_NUMBER = 0.05, 3


def context_notes(seen: WindowCounts) -> list[str]:
    """Where a sensor was missing, and where the classifiers do not know what they see."""
    notes: list[str] = []
    if seen.without_gyroscope:
        notes.append(
            f"contexts of {seen.without_gyroscope} of {seen.n} windows without gyroscope, which are less sure: there "
            "was no angular rate"
        )
    if seen.unknown > max(_NOTABLE_SHARE * seen.n, _NOTABLE_NUMBER):
        notes.append(
            f"{seen.unknown} of {seen.n} windows are unlike all that the context model was trained on: "
            "contexts are unsure there"
        )
    if seen.irregular > max(_NOTABLE_SHARE * seen.n, _NOTABLE_NUMBER):
        notes.append(
            f"in {seen.irregular} of {seen.n} windows the phone seems to be handled, not carried by somebody who "
            "walks: steps there may be false"
        )
    return notes


# A window and the climb rate that it uses share at least half of their seconds.
_CLIMB_AGE_S = 1.0


def climb_at(climbs: Sequence[Climb], time_s: float) -> Climb | None:
    """The last climb rate at or before a time, if it is recent enough."""
    i = bisect_right(climbs, time_s, key=_time_s)
    return climbs[i - 1] if i and climbs[i - 1].time_s >= time_s - _CLIMB_AGE_S else None


def _time_s(climb: Climb) -> float:
    return climb.time_s


def finish(config: Config, state: State, watch: Watch | None = None) -> tuple[State, Output]:
    """New state and output when no further sample will come: late steps are found, waiting ones become final.

    Fixes of the recording's time that still wait are used; later ones stay waiting. A second call gives nothing.
    """
    if state.finished:
        return state, Output()
    state, output = _process(config, state, config.sensing.finish(state.sensing), watch)
    tracker, last = config.tracker.finish(state.tracker)
    due = [f for f in state.waiting_fixes if received_s(f) <= state.sensing.processed_s]
    late = tuple(f for f in state.waiting_fixes if received_s(f) > state.sensing.processed_s)
    for fix in due:
        first_s = state.sensing.conditioner.report.first_time_s
        tracker, result = _use_fix(config, tracker, fix, state.sensing.processed_s, first_s)
        output.fixes.append(result)
    state = replace(state, tracker=tracker, waiting_fixes=late, finished=True)
    return state, replace(output, updates=[*output.updates, *last])


def _process(
    config: Config, state: State, events: list[tuple[float, Event]], watch: Watch | None
) -> tuple[State, Output]:
    output = Output()
    tracker, fixes, seen = state.tracker, state.waiting_fixes, state.seen
    first_s = state.sensing.conditioner.report.first_time_s
    for known_s, event in events:
        tracker, fixes, used = _apply_fixes(config, tracker, fixes, known_s, first_s)
        output.fixes.extend(used)
        if watch is not None:
            watch(tracker, event)
        if isinstance(event, WindowContext):
            context = with_climb(event, climb_at(state.climbs, event.time_s))
            output.windows.append(context)
            seen = seen.plus(context)
            tracker, updates = config.tracker.on_window(tracker, context)
        elif isinstance(event, Gap):
            tracker, updates = config.tracker.on_gap(tracker, event.duration_s)
        else:
            tracker, updates = config.tracker.on_step(tracker, event)
        output.updates.extend(updates)
    tracker, fixes, used = _apply_fixes(config, tracker, fixes, state.sensing.processed_s, first_s)
    output.fixes.extend(used)
    climbs = state.climbs[max(bisect_right(state.climbs, state.sensing.processed_s, key=_time_s) - 1, 0) :]
    state = replace(state, tracker=tracker, waiting_fixes=fixes, climbs=climbs, seen=seen)
    return state, output


def _apply_fixes(
    config: Config, state: TrackerState, fixes: tuple[Fix, ...], until_s: float, first_s: float
) -> tuple[TrackerState, tuple[Fix, ...], list[FixResult]]:
    used: list[FixResult] = []
    while fixes and due_s(config, fixes[0]) <= until_s:
        state, result = _use_fix(config, state, fixes[0], until_s, first_s)
        used.append(result)
        fixes = fixes[1:]
    return state, fixes, used


def due_s(config: Config, fix: Fix) -> float:
    """When a fix is used: it waits for the step that it falls into, compared with an earlier place it would pull ahead.

    A standstill waits for nothing: it is about steps to come.
    """
    if isinstance(fix, Standstill):
        return received_s(fix)
    sensing = config.sensing
    delay_s = sensing.step_latency_s + sensing.steps.first_step_s + config.tracker.fix_delay_s
    return max(received_s(fix), fix.time_s + delay_s)


def _use_fix(
    config: Config, state: TrackerState, fix: Fix, now_s: float, first_s: float
) -> tuple[TrackerState, FixResult]:
    if untimely(fix, first_s, received_s(fix)):
        return replace(state, rejected_fixes=state.rejected_fixes + 1), FixResult.of(fix, now_s, np.inf, False)
    n_rejected = state.rejected_fixes
    state, nis = config.tracker.on_fix(state, fix)
    return state, FixResult.of(fix, now_s, nis, state.rejected_fixes == n_rejected)


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
