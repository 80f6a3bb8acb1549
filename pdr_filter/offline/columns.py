"""Base class of dataclasses of columns, such as the windows of a training and the observations of a walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Self, cast

import numpy as np

from pdr_filter.values import BoolArray, IntArray


class Columns:
    """Base class of dataclasses whose fields are arrays of equal length, or tuples of objects of the same length."""

    __slots__ = ()

    @classmethod
    def names(cls) -> list[str]:
        """Return the names of the columns."""
        return [f.name for f in fields(cast(Any, cls))]

    def __len__(self) -> int:
        return len(getattr(self, self.names()[0]))

    def part(self, use: BoolArray | IntArray | slice) -> Self:
        """Return the rows that a mask, an array of indices or a slice selects."""
        return type(self)(*(_rows(getattr(self, name), use) for name in self.names()))

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of one or more parts, concatenated."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.names()))


def _rows(column: Any, use: BoolArray | IntArray | slice) -> Any:
    """Return the selected rows of a column."""
    if isinstance(column, tuple):
        return tuple(column[k] for k in np.arange(len(column))[use])
    return column[use]
