"""The project's own format: a zip file or a folder with meta.json and CSV files, as docs/formats.md says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import compress
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.checks import checked_streams, with_time
from pdr_filter.data.io.files.archive import IN_PLACE, Members, json_object, open_members
from pdr_filter.data.io.files.own_format_writer import (
    NOTES_KEY,
    RESTORED_GRAVITY_KEY,
    STREAM_COLUMNS,
    TEXT_COLUMNS,
    TIME_COLUMNS,
    TRUTH_COLUMNS,
    WIFI_COLUMNS,
)
from pdr_filter.data.io.row_times import in_order
from pdr_filter.data.io.text_table import TextTable
from pdr_filter.data.io.wifi_rows import wifi_of, with_whole_addresses
from pdr_filter.values import CONTEXTS, FloatArray, Table, Wifi, check_walked, limits, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording, Truth

REQUIRED = "accelerometer.csv"
OTHERS = ("meta.json", "gyroscope.csv")  # a recording has at least one of them


def read_recording(path: str | Path) -> Recording:
    """Return the recording in a zip file or folder of the project's own format.

    Other columns and files are ignored. Values stay as recorded, except that infinite ones become NaN, rows without a
    time are left out, and rows out of order are sorted. `Recording.notes` says so. A RecordingError names the file, the
    column, the value and the remedy.
    """
    path = Path(path)
    notes: list[str] = []
    with open_members(path) as members:
        folder = folder_of(members)
        found = {
            name: _read_stream(members, f"{folder}{name}.csv", columns, notes)
            for name, columns in STREAM_COLUMNS.items()
            if f"{folder}{name}.csv" in members.names
        }
        truth = {
            name: _read_truth(members, f"{folder}truth_{name}.csv", columns, notes)
            for name, columns in TRUTH_COLUMNS.items()
            if f"{folder}truth_{name}.csv" in members.names
        }
        has_wifi = f"{folder}wifi.csv" in members.names
        wifi = _read_wifi(members, f"{folder}wifi.csv", notes) if has_wifi else None
        recording = recording_of_streams(members, folder, in_order(found, ".csv", notes), notes)
    return replace(recording, wifi=wifi, truth=Truth(**truth))


def recording_of_streams(
    members: Members, folder: str, found: Mapping[str, tuple[FloatArray, FloatArray]], notes: list[str]
) -> Recording:
    """Return the recording of streams in order of time, after checks, with its meta data."""
    path = members.path
    meta_notes: list[str] = []
    meta = _read_meta(members, folder + "meta.json", meta_notes)
    notes[:0] = meta_notes
    streams: dict[str, Any] = {**checked_streams(found, 0.0, ".csv", str(path), notes)}
    first_s = streams["accelerometer"].time_s.min()
    if abs(first_s) > 1.0:
        notes.append(f"{REQUIRED}: begins at {first_s:.6f} s instead of 0, kept as recorded")
    name, found_notes = _name(path, meta, notes), tuple(note.removeprefix(f"{path}: ") for note in notes)
    # A saved note about a stream can be found again, with the name of the file.
    known = {*found_notes, *(note.replace(".csv", "") for note in found_notes)}
    saved_notes = _saved_notes(meta)
    return Recording(
        name=name,
        **streams,
        meta=meta,
        source=str(path),
        notes=(*(note for note in saved_notes if note not in known), *found_notes),
    )


def _saved_notes(meta: dict[str, Any]) -> list[str]:
    """Return the notes of the first reader, which `Recording.save` has written, and remove them from the meta data."""
    found: Any = meta.pop(NOTES_KEY, [])
    sentences = cast("list[Any]", found) if isinstance(found, list) else []
    return [str(sentence)[: limits.MAX_TEXT_CHARS] for sentence in sentences[: limits.MAX_SENTENCES]]


def write_recording(recording: Recording, path: str | Path) -> Path:
    """Write a recording in the project's own format.

    Parameters
    ----------
    recording : Recording
        Recording to write.
    path : str or Path
        Zip file, or a folder if the name has no suffix. Files of another recording in the folder are replaced.

    Returns
    -------
    Path
        Path of the file or folder.

    Raises
    ------
    OSError
        If a file cannot be written.

    See Also
    --------
    pdr_filter.Recording.save : Method with the same effect.

    Examples
    --------
    >>> import tempfile, pdr_filter as pdr
    >>> from pdr_filter.data.io.files.own_format import write_recording
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_recording(walk, f"{folder}/walk.zip")
    ...     pdr.read(path).name
    'simulated_walk'
    """
    return recording.save(path)


def folder_of(members: Members) -> str:
    """Return the folder of the recording inside a zip file, with its slash. RecordingError unless there is one."""
    path = members.path
    if not members.is_container and path.name == REQUIRED:
        raise RecordingError(
            f"{path}: one sensor of a recording; give the folder that holds {REQUIRED}, or its zip file"
        )
    if not members.is_container:
        raise RecordingError(
            f"{path}: not recognised as a recording; give a zip file or the folder of a recording, or a table of "
            "samples as text, with a line of names above it, and name no format"
        )
    folders = [name.removesuffix(REQUIRED) for name in members.names if PurePosixPath(name).name == REQUIRED]
    if not folders:
        listed = ", ".join(members.names[:8]) + (f" and {n - 8} more" if (n := len(members.names)) > 8 else "")
        whole = next((name for name in members.names if name.lower().endswith((*IN_PLACE, ".gz"))), None)
        remedy = "add an accelerometer, or name no format" if whole is None else f"unpack {whole}, which is read alone"
        raise RecordingError(
            f"{path}: no recording recognised: no {REQUIRED} (found: {listed or 'nothing'}), nor, unless a "
            f"format was named, a table of an accelerometer; {remedy}"
        )
    if len(folders) > 1:
        names = ", ".join(folder.rstrip("/") or "." for folder in folders[:3])
        raise RecordingError(f"{path}: holds {len(folders)} recordings ({names}); make one zip of each")
    return folders[0]


def _read_meta(members: Members, name: str, notes: list[str]) -> dict[str, Any]:
    if name not in members.names:
        notes.append("meta.json is missing, so subject and device are unknown")
        return {}
    where = members.where(name)
    meta = json_object(members.small(name), where)
    subject: Any = meta.get("subject") or {}
    if not isinstance(subject, dict):
        raise RecordingError(f'{where}: subject is {subject!r}; write it as an object, like {{"id": "s1"}}')
    for key in ("height_m", "weight_kg", "age"):
        value: Any = cast("dict[str, Any]", subject).get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise RecordingError(f"{where}: subject.{key} is {value!r}; write a number, or null if unknown")
        if key == "height_m" and value is not None:
            low, high = limits.HEIGHT_RANGE_M
            if not low <= value <= high:
                raise RecordingError(f"{where}: subject.height_m is {value!r}; give it in metres, like 1.75, or null")
    if meta.get(RESTORED_GRAVITY_KEY) is True:
        notes.append(
            "the acceleration was recorded without gravity, so that the vertical was estimated from the steps and the "
            "gyroscope: turns and directions are less certain, and unknown without a gyroscope; next time record the "
            "accelerometer with gravity"
        )
    return meta


def _name(path: Path, meta: Mapping[str, Any], notes: list[str]) -> str:
    own = path.resolve().name if path.is_dir() else path.stem
    name = meta.get("name")
    if isinstance(name, str) and _is_usable(name):
        return name
    notes.append(f"meta.json has no usable name, so the recording is called {own}")
    return own


def _is_usable(name: str) -> bool:
    """Return True if a name is safe as a file name, because results are written to files of this name."""
    is_short = len(name) <= limits.MAX_NAME_CHARS
    return is_short and name.isprintable() and bool(name.strip(". ")) and not set(name) & set("/\\:")


def _read_stream(
    members: Members, name: str, columns: tuple[str, ...], notes: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Return times (N,) in s and values (N, d) of one sensor. An empty file gives no rows, unless it is required."""
    rows = TextTable(members.blocks(name), members.where(name), ",")
    if rows.is_empty and PurePosixPath(name).name != REQUIRED:
        return np.empty(0), np.empty((0, len(columns)))
    numbers = rows.parse(rows.places(("time_s", *columns)), notes).values
    return numbers[:, 0], numbers[:, 1:]


def stream_blocks(
    members: Members, name: str, columns: tuple[str, ...], notes: list[str]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield times (N,) in s and values (N, d) of one sensor, block by block. An empty file may have no block."""
    rows = TextTable(members.blocks(name), members.where(name), ",")
    if not rows.is_empty or PurePosixPath(name).name == REQUIRED:
        for block in rows.parse_in_parts(rows.places(("time_s", *columns)), notes):
            yield block.values[:, 0], block.values[:, 1:]


def _read_wifi(members: Members, name: str, notes: list[str]) -> Wifi | None:
    """Return the Wi-Fi scans, or None for an empty file."""
    rows = TextTable(with_whole_addresses(members.blocks(name)), members.where(name), ",")
    if rows.is_empty:
        return None
    numbers = rows.parse(rows.places(("time_s", *WIFI_COLUMNS)), notes).values
    return wifi_of(numbers[:, 0], numbers[:, 1:], PurePosixPath(name).name, notes)


def _read_truth(members: Members, name: str, columns: tuple[str, ...], notes: list[str]) -> Table | None:
    """Return the rows of a truth table that have all their times, or None for an empty file."""
    rows = TextTable(members.blocks(name), members.where(name), ",")
    if rows.is_empty:
        return None
    numeric = [column for column in columns if column not in TEXT_COLUMNS]
    textual = [column for column in columns if column in TEXT_COLUMNS]
    place = dict(zip(columns, rows.places(columns), strict=True))
    found = rows.parse([place[name] for name in numeric], notes, texts=[place[name] for name in textual])
    file = PurePosixPath(name).name
    known = with_time(found.values[:, [column in TIME_COLUMNS for column in numeric]].sum(axis=1), file, notes)
    arrays = {column: found.values[known, i] for i, column in enumerate(numeric)}
    texts = {
        column: np.array([*compress(text, known)], np.str_) for column, text in zip(textual, found.texts, strict=True)
    }
    for length in {"distance_m", "length_m"} & arrays.keys():
        for start_s, end_s, walked_m in zip(*(arrays[c] for c in ("start_s", "end_s", length)), strict=True):
            check_walked(f"{file}: {length}", walked_m, end_s - start_s)
    own = sorted(set(texts["context"].tolist()) - {*CONTEXTS, ""}) if "context" in texts else []
    if own:
        notes.append(
            f"{file}: labels of contexts that the default recipe does not have ({', '.join(own)[:80]}): use a recipe "
            "with these contexts, or correct the names"
        )
    return table(arrays | texts)
