"""One type for a table of any file: texts, spreadsheets, MATLAB files, JSON.

Readers of files find the names of the columns and which of them hold times. Quantities, units, signs and clocks are
guessed afterwards, from this type alone (`column_groups`, `column_guess`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from pdr_filter.data.io.column_names import column_of_nanoseconds
from pdr_filter.data.io.tables.column_values import are_differences
from pdr_filter.data.io.text_table import NumberTable, finite
from pdr_filter.values import FloatArray, IntArray

# Function that returns the columns with the given indices as floats, and one more column as integers (or none if its
# index is None). Repairs are added to the list of notes.
Parse = Callable[[Sequence[int], int | None, list[str]], NumberTable]


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """A table: names of its columns, which of them are times, and its rows, which are parsed when used."""

    name: str  # name of the file (without folder and suffix), sheet, variable or sensor
    where: str  # description of the table for messages
    fields: tuple[str, ...]
    parse: Parse
    about: str = ""  # text above the table
    dates: frozenset[int] = frozenset()  # columns of dates and clock times, parsed as whole nanoseconds
    exact: frozenset[int] = frozenset()  # columns of whole numbers that a float would round
    texts: Mapping[int, str] = field(default_factory=dict[int, str])  # texts of the first row by column
    rate_hz: float = 0.0  # of the rows, if the file states it above them
    used: Set[int] = frozenset()  # columns that are parsed together
    notes: list[str] = field(default_factory=list[str])
    _parsed: dict[int | None, NumberTable] = field(default_factory=dict[int | None, NumberTable], init=False)

    @classmethod
    def of_columns(
        cls,
        name: str,
        where: str,
        columns: Mapping[str, FloatArray | IntArray],
        dates: Set[int] = frozenset(),
        exact: Set[int] = frozenset(),
    ) -> Sheet:
        """Return a sheet of columns in memory, by name. Columns with indices in `dates` or `exact` are int64."""

        def parse(numbers: Sequence[int], whole: int | None, notes: list[str]) -> NumberTable:
            arrays = [*columns.values()]
            values = np.column_stack([np.empty((len(arrays[0]), 0)), *(arrays[i].astype(float) for i in numbers)])
            ticks = np.zeros(len(values)) if whole is None else arrays[whole]
            return NumberTable(ticks.astype(np.int64), finite(values, where, notes))

        return cls(name, where, tuple(columns), parse, dates=frozenset(dates), exact=frozenset(exact))

    def using(self, places: Set[int | None], notes: list[str]) -> Sheet:
        """Return a sheet that parses the given columns together and adds repairs to `notes`. -1 is ignored."""
        used = {place for place in places if place is not None and place >= 0}
        beside = {place for p in used if (place := column_of_nanoseconds(self.fields, p)) is not None}
        return replace(self, used=(used | beside) - self.dates, notes=notes)

    def stream(
        self, places: Sequence[int], time: int | None, bias: Sequence[int] = ()
    ) -> tuple[IntArray | FloatArray, FloatArray]:
        """Return the times (N,) and the values (N, d) of those rows that have a value in one of the given columns.

        The columns of `bias`, one for each value, are subtracted where they have a value.
        A place that the table does not have (-1) gives NaN. Times are integers if a float would lose digits, and row
        numbers if `time` is None. The table is parsed once for each column of integer times.
        """
        exact = time if time is not None and time in self.dates | self.exact else None
        numbers = sorted(self.used)
        if exact not in self._parsed:
            self._parsed[exact] = self.parse(numbers, exact, self.notes)
        table = self._parsed[exact]
        unknown = np.full(len(table), np.nan)
        values = np.array([table.values[:, numbers.index(p)] if p in numbers else unknown for p in places]).T
        if bias:
            values = values - np.nan_to_num(table.values[:, [numbers.index(p) for p in bias]])
        if time is None:
            ticks = np.arange(len(values))
        elif (nanoseconds := column_of_nanoseconds(self.fields, time)) is not None:
            ticks = table.values[:, [numbers.index(time), numbers.index(nanoseconds)]] @ [1.0, 1e-9]
        else:
            ticks = table.whole if exact is not None else table.values[:, numbers.index(time)]
            if exact is None and are_differences(ticks.astype(np.float64), self.fields[time]):
                ticks = np.nancumsum(ticks, dtype=np.float64)
                words = f"column {self.fields[time]!r} has the times between the samples, which are summed"
                self.notes.append(words)
        known = ~np.isnan(values).all(axis=1)
        return (ticks, values) if known.all() else (ticks[known], values[known])
