"""Tables as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pdr_filter.values import Table


class Markdown(str):
    """Text that a notebook shows typeset and `print` as it is."""

    __slots__ = ()

    def _repr_markdown_(self) -> str:
        return str(self)


def markdown(rows: Table | Sequence[Mapping[str, object]], digits: int = 2) -> Markdown:
    """A table with named columns, or one mapping for each row, as a markdown table; numbers with so many decimals.

    >>> print(markdown([{"weighting": "hc", "distance_m": 101.234}]))
    | weighting | distance_m |
    |---|---|
    | hc | 101.23 |
    """
    if isinstance(rows, Sequence):
        names = list(rows[0]) if rows else []
        cells = [[row[name] for name in names] for row in rows]
    else:
        names = list(rows.dtype.names or ())
        cells = [list(row.item()) for row in rows]
    head = [f"| {' | '.join(_cell(name, digits) for name in names)} |", f"|{'|'.join(['---'] * len(names))}|"]
    return Markdown("\n".join([*head, *(f"| {' | '.join(_cell(c, digits) for c in row)} |" for row in cells)]))


def _cell(value: object, digits: int) -> str:
    if isinstance(value, float | np.floating):
        return "-" if value != value else f"{value:.{digits}f}"
    return " ".join(str(value).split()).replace("|", "\\|")  # neither ends the cell nor the line
