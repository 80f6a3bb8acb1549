"""The project's own format: a zip file or a folder with meta.json and one CSV file for each sensor and truth table.

Required are accelerometer.csv and, unless its absence is to be noted, meta.json. All times are seconds from the first
accelerometer sample; an empty field is unknown.
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.io.archive import read_members
from pdr_filter.io.checks import check_accelerometer, check_gyroscope, finite, overlap_notes, with_time
from pdr_filter.io.columns import fields_to_numbers, read_fields, read_numbers
from pdr_filter.io.describe import describe_stream
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording, Subject, Truth
from pdr_filter.values.arrays import FloatArray, Table, table
from pdr_filter.values.contexts import CONTEXTS
from pdr_filter.values.samples import Samples

STREAM_COLUMNS: dict[str, tuple[str, ...]] = {
    "accelerometer": ("x", "y", "z"),
    "gyroscope": ("x", "y", "z"),
    "magnetometer": ("x", "y", "z"),
    "barometer": ("pressure_hpa",),
    "light": ("illuminance_lux",),
    "proximity": ("distance_cm",),
    "attitude": ("qw", "qx", "qy", "qz"),
    "location": ("latitude_deg", "longitude_deg", "altitude_m", "horizontal_accuracy_m"),
}
TRUTH_COLUMNS: dict[str, tuple[str, ...]] = {
    "position": ("time_s", "east_m", "north_m", "up_m"),
    "waypoints": ("time_s", "east_m", "north_m", "floor"),
    "steps": ("time_s",),
    "strides": ("start_s", "end_s", "length_m"),
    "segments": ("start_s", "end_s", "distance_m", "n_steps"),
    "labels": ("start_s", "end_s", "context", "carrying_mode"),
}
FILES = ("meta.json", *(f"{name}.csv" for name in STREAM_COLUMNS), *(f"truth_{name}.csv" for name in TRUTH_COLUMNS))
TIME_COLUMNS = ("time_s", "start_s", "end_s")
TEXT_COLUMNS = ("context", "carrying_mode")

HEIGHT_RANGE_M = (0.4, 2.8)


def read_recording(path: str | Path) -> Recording:
    """Return the recording in a zip file or folder of the project's own format.

    Columns are found by name, in any order; other columns and files are ignored. Values stay as recorded, except that
    infinite ones become NaN and rows without a time are left out. `Recording.notes` says so, and counts repeated and
    backward times. A sensor without any value is left out with a note.

    Raises
    ------
    RecordingError
        A ValueError whose message names the file, the column, the value and the remedy.
    """
    path = Path(path)
    contents = read_members(path, FILES, required="accelerometer.csv")
    notes: list[str] = []
    meta = _read_meta(contents.get("meta.json"), f"{path}: meta.json", notes)
    streams: dict[str, Samples] = {}
    for name in STREAM_COLUMNS:
        if (content := contents.get(f"{name}.csv")) is not None:
            samples = _read_samples(name, content, path, notes)
            if name == "accelerometer":
                check_accelerometer(samples, f"{path}: accelerometer.csv")
            elif np.isnan(samples.values).all():  # also true of no rows
                notes.append(f"{name}.csv: no values, left out")
                continue
            streams[name] = samples
    _check_other_streams(streams, path, notes)
    truth = {
        name: _read_truth(columns, content, f"truth_{name}.csv", path, notes)
        for name, columns in TRUTH_COLUMNS.items()
        if (content := contents.get(f"truth_{name}.csv"))
    }
    return Recording(
        name=_name(path, meta, notes),
        **streams,
        truth=Truth(**truth),
        meta=meta,
        source=str(path),
        notes=tuple(notes),
    )


def write_recording(recording: Recording, path: str | Path) -> Path:
    """Write a recording and return the path: a folder if the path has no suffix, a zip file otherwise.

    Times get 6 decimals and values 7 significant digits (latitude and longitude 9), so reading it back gives the same
    to that precision. The same recording always gives the same bytes. Notes of the reader are not written. A recording
    that is already there is replaced.
    """
    path = Path(path)
    files = {
        f"{name}.csv": _numbers_csv(("time_s", *STREAM_COLUMNS[name]), [samples.time_s, *samples.values.T])
        for name, samples in recording.streams.items()
    }
    for name in recording.truth.present():
        files[f"truth_{name}.csv"] = _table_csv(getattr(recording.truth, name), TRUTH_COLUMNS[name], name)
    files["meta.json"] = json.dumps({**recording.meta, "name": recording.name}, indent=1, default=_plain) + "\n"
    if not path.suffix:
        path.mkdir(parents=True, exist_ok=True)
        for name in FILES:
            if name in files:
                (path / name).write_text(files[name], encoding="utf-8", newline="\n")
            else:  # of another recording, which must not be mixed with this one
                (path / name).unlink(missing_ok=True)
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", compression=zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            info = zipfile.ZipInfo(name)  # with the date 1980-01-01, so that the bytes do not depend on the clock
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, text)
    return path


def _read_meta(content: bytes | None, where: str, notes: list[str]) -> dict[str, Any]:
    if content is None:
        notes.append("meta.json is missing, so subject and device are unknown")
        return {}
    try:
        meta: Any = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{where}: not JSON ({error}); correct it or leave the file out") from error
    if not isinstance(meta, dict):
        raise RecordingError(f"{where}: holds {str(meta)[:40]!r}; it must be one object in braces, like {{}}")
    meta = cast("dict[str, Any]", meta)
    subject: Any = meta.get("subject") or {}
    if not isinstance(subject, dict):
        raise RecordingError(f'{where}: subject is {subject!r}; write it as an object, like {{"id": "s1"}}')
    for key in ("height_m", "weight_kg", "age"):
        value: Any = cast("dict[str, Any]", subject).get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise RecordingError(f"{where}: subject.{key} is {value!r}; write a number, or null if unknown")
        if key == "height_m" and value is not None and not HEIGHT_RANGE_M[0] <= value <= HEIGHT_RANGE_M[1]:
            raise RecordingError(f"{where}: subject.height_m is {value!r}; give it in metres, like 1.75, or null")
    return meta


def _name(path: Path, meta: Mapping[str, Any], notes: list[str]) -> str:
    own = path.resolve().name if path.is_dir() else path.stem
    name = meta.get("name")
    # Results are written to files of this name, so it must not lead to another folder.
    if isinstance(name, str) and name.isprintable() and name.strip(". ") and not set(name) & set("/\\:"):
        return name
    notes.append(f"meta.json has no usable name, so the recording is called {own}")
    return own


def _read_samples(name: str, content: bytes, path: Path, notes: list[str]) -> Samples:
    file = f"{name}.csv"
    if not content.strip() and name != "accelerometer":
        return Samples(np.empty(0), np.empty((0, len(STREAM_COLUMNS[name]))))
    columns = ("time_s", *STREAM_COLUMNS[name])
    rows = finite(read_numbers(content, columns, f"{path}: {file}", notes), file, notes)
    timed = with_time(rows[:, 0], file, notes)
    samples = Samples(rows[timed, 0], rows[timed, 1:])
    found = describe_stream(name, samples)
    if found.n_duplicates or found.n_backward:
        notes.append(f"{file}: {found.n_duplicates} repeated and {found.n_backward} backward times, kept as recorded")
    return samples


def _check_other_streams(streams: Mapping[str, Samples], path: Path, notes: list[str]) -> None:
    first_s = streams["accelerometer"].time_s.min()
    if "gyroscope" in streams:
        check_gyroscope(streams["gyroscope"], f"{path}: gyroscope.csv")
    if abs(first_s) > 1.0:
        notes.append(f"accelerometer.csv: begins at {first_s:.6f} s instead of 0, kept as recorded")
    notes += overlap_notes(streams)


def _read_truth(columns: tuple[str, ...], content: bytes, file: str, path: Path, notes: list[str]) -> Table:
    where = f"{path}: {file}"
    texts: dict[str, list[str]] = {}
    numeric = [name for name in columns if name not in TEXT_COLUMNS]
    if len(numeric) == len(columns):
        numbers = read_numbers(content, columns, where, notes)
    else:
        rows = read_fields(content, columns, where, notes)
        numbers = fields_to_numbers([(line, row[: len(numeric)]) for line, row in rows], numeric, where)
        texts = {name: [row[columns.index(name)] for _, row in rows] for name in columns if name in TEXT_COLUMNS}
    unknown = sorted(set(texts.get("context", [])) - {*CONTEXTS, ""})
    if unknown:
        notes.append(f"{file}: unknown contexts {', '.join(unknown)[:80]}, kept")
    numbers = finite(numbers, file, notes)
    n_times = sum(name in TIME_COLUMNS for name in columns)
    kept = with_time(numbers[:, :n_times].sum(axis=1), file, notes)
    arrays = {name: numbers[kept, i] for i, name in enumerate(numeric)}
    return table(arrays | {name: np.array(column, dtype=np.str_)[kept] for name, column in texts.items()})


def _numbers_csv(columns: tuple[str, ...], arrays: list[FloatArray]) -> str:
    row = ",".join(map(_number_format, columns)) + "\n"
    body = (row * len(arrays[0])) % tuple(np.column_stack(arrays).ravel().tolist())
    return ",".join(columns) + "\n" + body.replace("nan", "")


def _table_csv(rows: Table, columns: tuple[str, ...], name: str) -> str:
    missing = [column for column in columns if column not in (rows.dtype.names or ())]
    if missing:
        raise ValueError(f"truth table {name} has no column {', '.join(missing)}; give all of {', '.join(columns)}")
    if not set(columns) & set(TEXT_COLUMNS):
        return _numbers_csv(columns, [np.asarray(rows[column], dtype=float) for column in columns])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow(
            [row[c] if c in TEXT_COLUMNS else (_number_format(c) % row[c]).replace("nan", "") for c in columns]
        )
    return text.getvalue()


def _number_format(column: str) -> str:
    if column in TIME_COLUMNS:
        return "%.6f"
    return "%.9g" if column in ("latitude_deg", "longitude_deg") else "%.7g"


def _plain(value: object) -> object:
    """What json can write in place of a value that it cannot."""
    if isinstance(value, Mapping):
        return dict(cast("Mapping[str, object]", value))
    if isinstance(value, Subject):
        return {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"meta holds a {type(value).__name__}, which JSON cannot; give numbers, text, lists and dicts")
