"""Reading a recording in consecutive parts, so that the memory does not depend on its length.

Each file, or table in a file, is a source of blocks of rows. Rows are buffered until all sources have passed their
times, and are then merged as `merge_streams` merges the whole recording, with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pdr_filter.data.io.apps.ronin import open_ronin
from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.checks import NO_OVERLAP
from pdr_filter.data.io.column_names import ANGLES, GRAVITY, LINEAR, PHONE_HEADING, PHONE_STEPS
from pdr_filter.data.io.detection import detect
from pdr_filter.data.io.files.archive import open_members
from pdr_filter.data.io.files.own_format import folder_of, recording_of_streams, stream_blocks
from pdr_filter.data.io.files.own_format_writer import STREAM_COLUMNS
from pdr_filter.data.io.folders import only_recording_in
from pdr_filter.data.io.formats import known_format
from pdr_filter.data.io.tables.any_table import filled_by_guess, sheets_of
from pdr_filter.data.io.tables.column_mapping import Mapping as ColumnMapping
from pdr_filter.data.io.tables.sheet import Parse, Sheet
from pdr_filter.data.io.tables.table_streams import Zero, fill_streams, sheet_of
from pdr_filter.data.io.tables.text_sheets import TextRows, first_rows
from pdr_filter.data.io.text_table import finite
from pdr_filter.sensing.clock import MAX_GAP_S, REORDER_S, is_behind, latest_before
from pdr_filter.sensing.conditioning import at_times
from pdr_filter.values import FloatArray, ImuBlock, Samples, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

# Times (N,) and values (N, d) of some streams, by name.
Block = Mapping[str, tuple[FloatArray, FloatArray]]

# Samples in a part, and its longest duration, s: the filter keeps ten minutes of climb rates (`MAX_CLIMBS`).
_PART_SAMPLES, _PART_S = 32_000, 240.0
# Rows of the accelerometer that wait for another sensor: more than those of five hours at 100 Hz show that the sensor
# has ended, and whether it begins again is known at the end of the file only.
_MOST_WAITING = 2_000_000
_RONIN_ROWS = 100_000
# Rows of a table from which the meanings of its columns are guessed: some minutes.
_HEAD_BLOCKS = 2
_INTERPOLATED = ("gyroscope", "magnetometer")
_SORTED = ("accelerometer", *_INTERPOLATED, "barometer")  # streams that `one_clock` sorts by time
_USED = (*_SORTED, "location", PHONE_HEADING, PHONE_STEPS)


class WholeOnlyError(Exception):
    """The recording can only be read as a whole. The message is the reason."""


class RecordingPart(NamedTuple):
    """Consecutive samples of a recording."""

    block: ImuBlock  # samples of the accelerometer with the other sensors interpolated at their times
    others: Mapping[str, Samples]  # samples of other sensors up to the last one of the block, such as the barometer
    fraction: float  # fraction of the recording up to here, 0 to 1


@dataclass(frozen=True, slots=True, eq=False)
class RecordingInParts:
    """Recording that is read in parts.

    Attributes
    ----------
    head : Recording
        Names, meta data and the first samples of each stream, without ground truth.
    parts : iterator of RecordingPart
        All samples, in order of time.
    spans_s : dict of str to (float, float)
        First and last time of each stream so far, s.
    """

    head: Recording
    parts: Iterator[RecordingPart]
    spans_s: dict[str, tuple[float, float]]

    def holding(self, notes: Sequence[str]) -> tuple[str, ...]:
        """Return notes without those on first samples of a stream, if later ones overlap those of the accelerometer."""
        first_s, last_s = self.spans_s["accelerometer"]
        overlapping = [
            name for name, (begin_s, end_s) in self.spans_s.items() if begin_s <= last_s and end_s >= first_s
        ]
        refuted = {f"{name}{suffix}: {NO_OVERLAP}" for name in overlapping for suffix in ("", ".csv")}
        return tuple(note for note in notes if note not in refuted)


@contextmanager
def recording_in_parts(path: str | Path, file_format: str | None = None) -> Generator[RecordingInParts]:
    """Context manager that opens a recording of the own format, of text tables or of RoNIN, and yields its parts.

    WholeOnlyError, also while parts are read, for another format, and if the whole recording must be known: times that
    go back by 0.1 s or more, samples without own times, dates, or an acceleration without gravity. RecordingError as
    by `read`.
    """
    path = Path(path)
    if file_format is None:
        path = only_recording_in(path)
    file_format = known_format(file_format) if file_format else detect(path)
    if file_format not in _OPENERS:
        raise WholeOnlyError(f"recordings of the format {file_format} are read as a whole")
    with _OPENERS[file_format](path) as (head, sources, fraction):
        merger = _Merger([_Source(blocks) for blocks in sources], fraction)
        yield RecordingInParts(head, merger.parts(), merger.spans_s)


# Recording of the first samples, sources, and a function of the fraction read.
_Opened = tuple[Recording, list[Iterator[Block]], Callable[[], float]]


@contextmanager
def _own(path: Path) -> Generator[_Opened]:
    notes: list[str] = []
    with open_members(path) as members:
        folder = folder_of(members)
        names = [name for name in _USED if f"{folder}{name}.csv" in members.names]
        fraction = members.read_in_parts([f"{folder}{name}.csv" for name in names])
        first = dict[str, tuple[FloatArray, FloatArray]]()
        sources: list[Iterator[Block]] = []
        for name in names:
            blocks = stream_blocks(members, f"{folder}{name}.csv", STREAM_COLUMNS[name], notes)
            head = [*islice(blocks, 1)]
            if head:
                first[name] = head[0]
            sources.append(_named(name, chain(head, blocks)))
        yield recording_of_streams(members, folder, first, notes), sources, fraction


def _named(name: str, blocks: Iterator[tuple[FloatArray, FloatArray]]) -> Iterator[Block]:
    for block in blocks:
        yield {name: block}


@contextmanager
def _ronin(path: Path) -> Generator[_Opened]:
    with open_ronin(path) as ronin:
        n_done = 0

        def blocks() -> Iterator[Block]:
            nonlocal n_done
            for start in range(0, ronin.n_rows, _RONIN_ROWS):
                n_done = min(start + _RONIN_ROWS, ronin.n_rows)
                yield ronin.parsed(slice(start, n_done)).streams

        head, zero_s = _head(replace(ronin.parsed(slice(0, _RONIN_ROWS)), truth={}))
        yield head, [_since(blocks(), zero_s)], lambda: n_done / ronin.n_rows


@contextmanager
def _table(path: Path) -> Generator[_Opened]:
    with open_members(path) as members:
        notes: list[str] = []
        sheets = list(sheets_of(members, notes=notes))
        first_rows = [_first_rows(sheet) for sheet in sheets]
        fraction = members.read_in_parts(members.names)
        filled = filled_by_guess(members, path, None, first_rows, notes)
        mapping = filled.guess.mapping
        if {s.stream for s in mapping.streams} & {LINEAR, GRAVITY, ANGLES}:
            raise WholeOnlyError("gravity or angles are computed from the whole recording")
        if not all(s.time and s.time_unit != "date" for s in mapping.streams) or any("summed" in n for n in notes):
            raise WholeOnlyError("rows have dates, or no times")
        head, zero_s = _head(filled.parsed)
        sources: list[Iterator[Block]] = []
        for sheet, first in zip(sheets, filled.sheets, strict=True):
            streams = tuple(s for s in mapping.streams if sheet_of(s, mapping, filled.sheets) is first)
            if streams:
                used = replace(sheet, used=first.used, notes=notes)
                blocks = _streams_of(used, replace(mapping, streams=streams), filled.zero, _without_values(first))
                sources.append(_since(blocks, zero_s))
        yield head, sources, fraction


_OPENERS = {"own": _own, "ronin": _ronin, "table": _table}


def _first_rows(sheet: Sheet) -> Sheet:
    """Return a table with its first rows only. WholeOnlyError unless it is a text."""
    if not isinstance(rows := sheet.parse, TextRows):
        raise WholeOnlyError("a table is no text, or was cut into several files")
    return replace(sheet, parse=replace(rows, blocks=lambda: islice(rows.blocks(), _HEAD_BLOCKS)))


def _without_values(sheet: Sheet) -> list[int]:
    """Return the columns that may hold numbers and are empty in the first rows, so that their meaning is unknown."""
    is_empty = [bool(column.all()) for column in np.isnan(first_rows(sheet)).T]
    beside = sheet.dates | sheet.texts.keys()
    empty = [i for i in range(len(sheet.fields)) if is_empty[i] and i not in beside]
    known = _with_values(sheet.parse, empty)
    return [i for i in empty if i not in known]


def _with_values(rows: Parse, columns: Sequence[int]) -> list[int]:
    """Return the columns that hold a number. A column of texts holds none."""
    if not columns:
        return []
    with suppress(RecordingError):
        values = rows(columns, None, []).values
        return [i for i, column in zip(columns, values.T, strict=True) if np.isfinite(column).any()]
    # a text in one of several columns
    return [i for column in columns for i in _with_values(rows, [column])] if len(columns) > 1 else []


def _streams_of(sheet: Sheet, mapping: ColumnMapping, zero: Zero, without: Sequence[int]) -> Iterator[Block]:
    """Yield the streams of a text table, block by block. WholeOnlyError for a value in the columns `without` values."""
    last_place = np.full(2, np.nan)
    for part in sheet.parse.in_parts() if isinstance(sheet.parse, TextRows) else ():
        if late := _with_values(part, without):
            names = ", ".join(sheet.fields[i] for i in late)
            raise WholeOnlyError(f"the first rows have no value in {names}, and later rows have")
        parsed = Parsed(Path(), "")
        fill_streams(parsed, mapping, [replace(sheet, parse=part)], zero)
        if "location" in parsed.streams and len(parsed.streams["location"][0]):
            time_s, values = parsed.streams["location"]
            repeats = int((values[0, :2] == last_place).all())  # apps repeat the last location in each row
            parsed.streams["location"] = time_s[repeats:], values[repeats:]
            last_place = values[-1, :2]
        yield parsed.streams


def _since(blocks: Iterator[Block], zero_s: float) -> Iterator[Block]:
    """Yield blocks with times since `zero_s`."""
    for block in blocks:
        yield {name: (time_s - zero_s, values) for name, (time_s, values) in block.items()}


def _head(parsed: Parsed) -> tuple[Recording, float]:
    """Return the recording of the first rows of all streams, and the time that becomes its time zero, s."""
    time_s = parsed.streams["accelerometer"][0]
    known_s = time_s[np.abs(time_s) <= limits.LARGEST_VALUE]
    recording = parsed.recording()
    if parsed.streams["accelerometer"][0] is not time_s:
        raise WholeOnlyError("rows are out of order, or several samples have one time")
    return recording, float(next(iter(known_s), 0.0))


@dataclass(slots=True, eq=False)
class _Source:
    """Blocks of rows of some streams."""

    blocks: Iterator[Block]
    has_ended: bool = False


@dataclass(slots=True, eq=False)
class _Buffer:
    """Rows of a stream that have been read and are still needed, in order of time."""

    source: _Source
    time_s: FloatArray = field(default_factory=lambda: np.empty(0))
    values: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    newest_s: float = -np.inf

    @property
    def until_s(self) -> float:
        """Time up to which all rows are known, s. Rows that are read later may be sorted before rows after it."""
        return np.inf if self.source.has_ended else self.newest_s - REORDER_S

    @property
    def n_known(self) -> int:
        """Number of rows up to `until_s`."""
        return self.n_until(self.until_s)

    def n_until(self, time_s: float) -> int:
        """Return the number of rows up to a time, s."""
        return int(self.time_s.searchsorted(time_s, side="right"))

    def plus(self, time_s: FloatArray, values: FloatArray, is_sorted: bool) -> None:
        """Add rows. WholeOnlyError if one of them is too late to be sorted by time, or if the stream is not sorted."""
        if not len(time_s):
            return
        latest_s = latest_before(time_s, self.newest_s)
        if is_behind(time_s, latest_s, REORDER_S if is_sorted else 0.0).any():
            raise WholeOnlyError(f"times go back by {REORDER_S} s or more")
        self.newest_s = max(self.newest_s, float(time_s.max()))
        is_first = not len(self.time_s)
        self.time_s = time_s if is_first else np.concatenate([self.time_s, time_s])
        self.values = values if is_first else np.concatenate([self.values, values])
        if (time_s < latest_s).any():
            order = np.argsort(self.time_s, kind="stable")
            self.time_s, self.values = self.time_s[order], self.values[order]

    def drop(self, n: int) -> None:
        """Remove the first n rows."""
        self.time_s, self.values = self.time_s[n:], self.values[n:]


class _Merger:
    """Merging of the rows of all sources into parts."""

    def __init__(self, sources: Sequence[_Source], fraction: Callable[[], float]) -> None:
        self._sources, self._fraction = sources, fraction
        self._buffers: dict[str, _Buffer] = {}
        self.spans_s: dict[str, tuple[float, float]] = {}

    def parts(self) -> Iterator[RecordingPart]:
        """Yield all parts of the recording."""
        for source in self._sources:
            self._read(source)
        force = self._buffers["accelerometer"]
        while True:
            while force.n_known < _PART_SAMPLES and not force.source.has_ended:
                self._read(force.source)
            n = min(_PART_SAMPLES, force.n_known)
            if n == 0:
                break
            n = max(min(n, force.n_until(float(force.time_s[0]) + _PART_S)), 1)
            n = force.n_until(float(force.time_s[n - 1]))  # equal times stay together
            end_s = float(force.time_s[n - 1])
            is_last = force.source.has_ended and n == len(force.time_s)
            for name, buffer in self._buffers.items():
                self._read_until(buffer, np.inf if is_last else end_s, name in _INTERPOLATED)
            at_s = force.time_s[:n]
            others = (self._interpolated(name, at_s) for name in _INTERPOLATED)
            block = ImuBlock(at_s, force.values[:n], *others)
            force.drop(n)
            yield RecordingPart(block, self._others(np.inf if is_last else end_s), self._fraction())

    def _read(self, source: _Source) -> None:
        """Read the next block of a source into the buffers of its streams."""
        block = next(source.blocks, None)
        source.has_ended = block is None
        used = () if block is None else [(name, *block[name]) for name in _USED if name in block]
        for name, time_s, values in used:
            buffer = self._buffers.setdefault(name, _Buffer(source))
            values = finite(values, name, [])
            known = ~np.isnan(time_s) if name not in _INTERPOLATED else np.isfinite(time_s) & np.isfinite(values).all(1)
            if not known.all():
                time_s, values = time_s[known], values[known]
            if len(time_s):
                first_s, last_s = self.spans_s.get(name, (np.inf, -np.inf))
                self.spans_s[name] = min(first_s, float(time_s.min())), max(last_s, float(time_s.max()))
            buffer.plus(time_s, values, name in _SORTED)

    def _read_until(self, buffer: _Buffer, until_s: float, is_interpolated: bool) -> None:
        """Read a stream until all rows up to a time are known, and of an interpolated one a row after them as well."""
        force = self._buffers["accelerometer"]
        while not buffer.source.has_ended:
            n = buffer.n_known
            last_s = buffer.until_s if not is_interpolated else buffer.time_s[n - 1] if n > 1 else -np.inf
            if last_s >= until_s:
                break
            if max(len(force.time_s), len(buffer.time_s)) > _MOST_WAITING:
                raise WholeOnlyError("a sensor has no samples for hours, or has another clock")
            self._read(buffer.source)

    def _interpolated(self, name: str, at_s: FloatArray) -> FloatArray:
        """Return the values of a stream at the times of the accelerometer, (N, 3), and drop rows that are past."""
        buffer = self._buffers.get(name)
        if buffer is None:
            return np.full((len(at_s), 3), np.nan)
        # two rows before the first time, because values after the last row are computed from the last two
        buffer.drop(max(int(buffer.time_s.searchsorted(at_s[0])) - 2, 0))
        time_s, first = np.unique(buffer.time_s[: buffer.n_known], return_index=True)
        return at_times(time_s, buffer.values[first], at_s, MAX_GAP_S)

    def _others(self, until_s: float) -> dict[str, Samples]:
        """Return the samples of the other streams up to a time, and drop them."""
        found: dict[str, Samples] = {}
        for name, buffer in self._buffers.items():
            if name not in ("accelerometer", *_INTERPOLATED) and (n := buffer.n_until(until_s)):
                found[name] = Samples(buffer.time_s[:n], buffer.values[:n])
                buffer.drop(n)
        return found
