"""Position fixes and loop closures from CSV files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdr_filter.io.files.safe_files import read_small
from pdr_filter.io.tables.text_table import TextTable
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.values import PositionFix, limits


def fixes_of_file(path: str | Path, std_m: float = 1.0) -> list[PositionFix]:
    """Fixes of a CSV file with the columns `time_s,east_m,north_m`, and `std_m` of each if the file has it.

    Times are those of the samples. ValueError names the file, the line and the remedy.
    """
    rows = _rows(Path(path), ("time_s", "east_m", "north_m"), "fixes", std_m)
    return [PositionFix(t, np.array([east, north]), std**2 * np.eye(2)) for t, east, north, std in rows]


def loop_closures_of_file(path: str | Path, std_m: float = 0.5) -> list[LoopClosure]:
    """Loop closures of a CSV file with the columns `first_s,second_s`, and `std_m` of each if the file has it.

    Times are those of the samples. ValueError names the file, the line and the remedy.
    """
    rows = _rows(Path(path), ("first_s", "second_s"), "loop closures", std_m)
    back = next((k for k, (first_s, second_s, _) in enumerate(rows) if not first_s < second_s), None)
    if back is not None:
        raise ValueError(
            f"{path}, row {back + 1}: first_s must be before second_s, got {rows[back][0]:g} and {rows[back][1]:g}; "
            "exchange the two"
        )
    return [LoopClosure(*row) for row in rows]


def _rows(file: Path, names: tuple[str, ...], what: str, std_m: float) -> list[list[float]]:
    """Numbers of the columns, and of `std_m` after them: that of the file if it has this column."""
    table = TextTable([read_small(file, limits.MAX_WHOLE_BYTES)], str(file))
    columns = (*names, *(("std_m",) if "std_m" in table.fields else ()))
    values = table.parse(table.places(columns), []).values
    unknown = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(unknown):
        raise ValueError(f"{file}, row {unknown[0] + 1}: {','.join(columns)} must all be numbers; leave the row out")
    if len(values) > limits.MAX_FIXES:
        raise ValueError(f"{file}: {len(values)} {what}, more than {limits.MAX_FIXES}; leave out some")
    if not len(values):
        raise ValueError(f"{file}: no {what} below the line {','.join(columns)}; write one in each line")
    if len(columns) == len(names):
        values = np.column_stack([values, np.full(len(values), std_m)])
    std = values[:, -1]
    if not (std > 0).all():
        raise ValueError(f"{file}, row {int(np.argmin(std > 0)) + 1}: std_m is {std.min():g}; write a positive number")
    return values.tolist()
