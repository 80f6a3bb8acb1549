"""Handler that keeps the path of past steps, for `OnlineFilter.path`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pdr_filter.filter.chain.handler import Around, Event, Fork, Handler, Output, PathChanges
from pdr_filter.filter.pedestrian.past_path import NO_STEPS, PastPath
from pdr_filter.values import replace_unchecked


@dataclass(frozen=True, eq=False)
class PathState(Around):
    """State of the inner handler, and the path of all steps that belongs to it."""

    path: PastPath


class WithPath:
    """Handler around a tracker that applies the changes of the path. It is not used for whole recordings."""

    def __init__(self, inner: Handler[Any]) -> None:
        self.inner = inner

    def init(self) -> PathState:
        """Return the state with an empty path."""
        return PathState(self.inner.init(), PastPath())

    def on(self, state: PathState, event: Event, known_s: float) -> tuple[PathState, tuple[Output, ...]]:
        """Return the state after an event, and the outputs of the inner handler without the changes of the path."""
        inner, outputs = self.inner.on(state.inner, event, known_s)
        path, others = state.path, list[Output]()
        for output in outputs:
            if isinstance(output, PathChanges):
                path = _changed(state.path, output.changes)
            elif isinstance(output, Fork):
                others.append(output._replace(state=PathState(output.state, _changed(state.path, output.changes))))
            else:
                others.append(output)
        return replace_unchecked(state, inner=inner, path=path), tuple(others)


def _changed(path: PastPath, changes: tuple[Callable[[PastPath], PastPath], ...]) -> PastPath:
    for change in changes:
        path = change(path)
    return path


def for_saving(state: Any, path: bool) -> Any:
    """Return the state of a chain, and of a second hypothesis in it, for saving with or without its `path`."""
    if isinstance(state, PathState):
        steps = state.path.for_saving() if path else replace(state.path, earlier=NO_STEPS, events=())
        return replace(state, path=steps)
    if not isinstance(state, Around):
        return state
    parts = {name: getattr(state, name, None) for name in ("inner", "rival")}
    return replace(state, **{name: for_saving(part, path) for name, part in parts.items() if part is not None})
