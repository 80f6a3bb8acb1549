"""Chain of handlers: each one takes events, owns its state, and adds to what the inner one returns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from pdr_filter.filter.chain.tracker import Tracker, TrackerState
from pdr_filter.filter.pedestrian.past_path import PastPath
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate, over_stepless, without_changes
from pdr_filter.values import Fix, FixOutcome, FloatArray, FloorPassage, Step, replace_unchecked
from pdr_filter.values.events import Climb, Gap, Stepless
from pdr_filter.values.windows import WindowContext


class Window(NamedTuple):
    """Context window with the evidence of its samples for the vertical motion (`height_filter.window_log_evidence`)."""

    context: WindowContext
    height_log_evidence: FloatArray | None


class Locations(NamedTuple):
    """Accurate locations, which distinguish hills from storeys.

    `rows` (P, 3) are time, east and north. Locations before `since_s` are no longer needed.
    """

    rows: FloatArray
    since_s: float


class NewestStep(NamedTuple):
    """Request of a provisional row of the last step. It changes no state."""


class StepsEnd(NamedTuple):
    """End of the steps and windows. Climb rates and fixes may follow."""


class End(NamedTuple):
    """End of the climb rates. Only fixes may follow."""


class FixUse(NamedTuple):
    """Result of a fix: its outcome, its normalised innovation squared, and the storey before it."""

    fix: Fix
    outcome: FixOutcome
    nis: float
    floor: int = 0


class PathChanges(NamedTuple):
    """Changes of the path of past steps by one event (`PedestrianState.changes`)."""

    changes: tuple[Callable[[PastPath], PastPath], ...]


class Fork(NamedTuple):
    """Second hypothesis that a fix has found: state of the handler, log odds against the first, changes of its path."""

    state: Any
    log_odds: float
    changes: tuple[Callable[[PastPath], PastPath], ...]


Event = Window | Step | Stepless | Gap | Climb | Fix | Locations | NewestStep | StepsEnd | End
Output = StepUpdate | FixUse | FloorPassage | PathChanges | Fork


class HandlerState(Protocol):
    """State of a handler, a frozen dataclass."""

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates of the tracker after the last event."""
        ...


@dataclass(frozen=True, eq=False)
class Around:
    """State of a handler around another one, whose state is `inner`."""

    inner: Any

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates of the tracker after the last event."""
        return self.inner.pedestrian


S = TypeVar("S", bound=HandlerState)


class Handler(Protocol[S]):
    """Protocol of a handler of events, such as steps, context windows and fixes.

    The innermost handler is a tracker (`TrackerHandler`). Each of the others passes events to the one inside it,
    reacts to them, and changes or adds to what the inner one returns. `Config.chain` builds the chain, and
    `Config.with_handler` adds one at its outside. A handler never changes the state of another one.
    """

    def init(self) -> S:
        """Return the state before the first event."""
        ...

    def on(self, state: S, event: Event, known_s: float) -> tuple[S, tuple[Output, ...]]:
        """Return the state after an event, and its consequences in order: rows, uses of fixes and floor passages.

        `known_s` is the time in s at which the event became known. A handler passes on events and outputs that it does
        not know. It does not change its state for a `NewestStep`, whose rows are provisional. `OnlineFilter.now` and
        `path` do not include the changes that user-defined handlers make to rows.
        """
        ...


class TrackerHandler:
    """Innermost handler: turns events into calls of a tracker."""

    def __init__(self, tracker: Tracker[Any]) -> None:
        self.tracker = tracker

    def init(self) -> TrackerState:
        """Return the state at the origin."""
        return self.tracker.init()

    def on(self, state: TrackerState, event: Event, known_s: float) -> tuple[TrackerState, tuple[Output, ...]]:
        """Return the state of the tracker after an event, its rows, the use of a fix, and the changes of the path."""
        outputs: tuple[Output, ...] = ()
        if isinstance(event, Step):
            state, outputs = self.tracker.on_step(state, event)
        elif isinstance(event, Window):
            state, outputs = self.tracker.on_window(state, event.context)
        elif isinstance(event, Gap):
            state, outputs = self.tracker.on_gap(state, event.duration_s)
        elif isinstance(event, Stepless):
            state = replace_unchecked(state, pedestrian=over_stepless(state.pedestrian, event.duration_s))
        elif isinstance(event, StepsEnd):
            state, outputs = self.tracker.finish(state)
        elif isinstance(event, NewestStep):
            newest = self.tracker.provisional(state)
            return state, () if newest is None else (newest,)
        elif not isinstance(event, Climb | Locations | End):
            state, outcome, nis = self.tracker.on_fix(state, event)
            outputs = (FixUse(event, outcome, nis),)
        pedestrian = state.pedestrian
        if not pedestrian.changes:
            return state, outputs
        first = replace_unchecked(pedestrian, changes=(), rival=None)
        outputs = (PathChanges(pedestrian.changes), *outputs)
        if pedestrian.rival is not None:
            other = pedestrian.rival.pedestrian
            second = replace_unchecked(state, pedestrian=without_changes(other))
            fork = Fork(second, pedestrian.rival.log_odds, other.changes)
            outputs = (*outputs, fork)
        return replace_unchecked(state, pedestrian=first), outputs


V = TypeVar("V")


def with_pedestrian(state: V, pedestrian: PedestrianState) -> V:
    """Return the state of a tracker, or of a handler around it, with other estimates."""
    if hasattr(state, "inner"):
        return replace(cast(Any, state), inner=with_pedestrian(cast(Any, state).inner, pedestrian))
    return replace_unchecked(state, pedestrian=pedestrian)


def states_of(state: Any) -> Iterator[Any]:
    """Yield the states of the handlers of a chain, from the outermost one to the tracker."""
    yield state
    while hasattr(state, "inner"):
        state = state.inner
        yield state


def part_of(state: object, kind: type[V]) -> V:
    """Return the state of the handler whose states are of a class, from the state of a chain that has this handler."""
    return next(part for part in states_of(state) if isinstance(part, kind))


def with_part(state: V, part: object) -> V:
    """Return the state of a chain with another state of the handler whose states are of the class of `part`.

    `part` keeps the states inside it.
    """
    if isinstance(state, type(part)):
        return cast(V, part)
    return replace(cast(Any, state), inner=with_part(cast(Any, state).inner, part))
