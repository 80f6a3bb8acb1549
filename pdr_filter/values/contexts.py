"""Contexts, their meaning for a pedestrian, and the carrying modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, pi
from typing import Literal

import numpy as np

from pdr_filter.values import limits
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray, read_only

Gait = Literal["walking", "running"]


def check_name_of_context(name: object) -> None:
    """Raise ValueError unless a name is a short printable text in one line, which tables and pages can show."""
    if not (isinstance(name, str) and 0 < len(name) <= limits.MAX_NAME_CHARS and name.isprintable()):
        raise ValueError(
            f"the name of a context must be a string of 1 to {limits.MAX_NAME_CHARS} printable characters, got "
            f"{name!r:.60}"
        )


@dataclass(frozen=True, slots=True)
class Context:
    """Activity that a classifier distinguishes, with its meaning for a pedestrian.

    A `filter.imm.motion_model.Mode` defines the meaning. Stages before the filter get it from there.
    """

    name: str
    moves: bool = True  # True if a step changes the position
    climbs: int = 0  # +1 if steps go up stairs, -1 if they go down
    gait: Gait | None = None  # None for a context without steps, and by default "walking" for one that moves
    heading_offset_rad: float = 0.0  # walking minus facing direction of the body, +pi/2 for steps to the right

    def __post_init__(self) -> None:
        check_name_of_context(self.name)
        if self.climbs not in (-1, 0, 1):
            raise ValueError(f"climbs of {self.name!r} must be +1 (up), -1 (down) or 0, got {self.climbs!r}")
        if self.gait not in (None, "walking", "running"):
            raise ValueError(f'gait of {self.name!r} must be "walking", "running" or None, got {self.gait!r}')
        if not isfinite(self.heading_offset_rad):
            raise ValueError(f"heading_offset_rad of {self.name!r} must be finite, got {self.heading_offset_rad}")
        if self.moves and self.gait is None:
            object.__setattr__(self, "gait", "walking")

    @property
    def stands(self) -> bool:
        """True for a context without steps. A step detected in it is false."""
        return self.gait is None

    @property
    def runs(self) -> bool:
        """True if the gait is running."""
        return self.gait == "running"

    @property
    def is_turned(self) -> bool:
        """True if the walking direction differs from the facing direction: to the side or backward."""
        return self.heading_offset_rad != 0

    @property
    def is_level_walking(self) -> bool:
        """True for ordinary walking: forward, on level ground, with displacement."""
        return self.moves and self.gait == "walking" and self.climbs == 0 and not self.is_turned


@dataclass(frozen=True)
class ContextSet:
    """All contexts of a filter, in the order of its probabilities."""

    contexts: tuple[Context, ...]

    def __post_init__(self) -> None:
        if not self.contexts or len(set(self.names)) < len(self.contexts):
            raise ValueError(f"contexts must be one or more with distinct names, got {self.names}")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the C contexts, in order."""
        return tuple(c.name for c in self.contexts)

    def index_where(self, holds: Callable[[Context], bool]) -> IntArray:
        """Return the indices of the contexts for which a condition holds."""
        return np.flatnonzero([holds(c) for c in self.contexts])

    @cached_property
    def standing(self) -> IntArray:
        """Indices of the contexts without steps."""
        return self.index_where(lambda c: c.stands)

    @cached_property
    def level_walking(self) -> IntArray:
        """Indices of the contexts of ordinary walking."""
        return self.index_where(lambda c: c.is_level_walking)

    @cached_property
    def stands(self) -> BoolArray:
        """Array (C + 1,) that is True for contexts without steps, and False for an unknown one, of index -1."""
        return self._of_each(lambda c: c.stands)

    @cached_property
    def runs(self) -> BoolArray:
        """Array (C + 1,) that is True for running, and False for an unknown context, of index -1."""
        return self._of_each(lambda c: c.runs)

    @cached_property
    def is_turned(self) -> BoolArray:
        """Array (C + 1,) that is True for walking to the side or backward, False for an unknown context."""
        return self._of_each(lambda c: c.is_turned)

    def _of_each(self, holds: Callable[[Context], bool]) -> BoolArray:
        result = np.array([*map(holds, self.contexts), False])
        result.flags.writeable = False
        return result

    @cached_property
    def in_thirds(self) -> FloatArray | None:
        """Matrix (C, C) that divides the probability of level walking and stairs up and down into equal thirds.

        Probabilities (C,) are multiplied from the left; others stay. None if the contexts do not include all three.
        """
        kinds = self.level_walking, self.index_where(lambda c: c.climbs > 0), self.index_where(lambda c: c.climbs < 0)
        if not all(map(len, kinds)):
            return None
        together = np.concatenate(kinds)
        matrix = np.eye(len(self.contexts))
        matrix[together, :] = 0.0
        for kind in kinds:
            matrix[np.ix_(together, kind)] = 1 / 3 / len(kind)
        return read_only(matrix)


#: Default contexts: C1..C6 of Martinelli et al. 2018, Table I.
DEFAULT_CONTEXTS = ContextSet(
    (
        Context("stationary", moves=False),
        Context("walking"),
        Context("upstairs", climbs=1),
        Context("downstairs", climbs=-1),
        # The features do not show the direction of a side step. The convention is a step to the right.
        Context("sideways", heading_offset_rad=pi / 2),
        Context("running", gait="running"),
    )
)

#: Names of the default contexts, in the order of the probabilities.
CONTEXTS: tuple[str, ...] = DEFAULT_CONTEXTS.names

#: Names of the carrying modes, in the order of all their probabilities.
CARRYING_MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket", "bag")
