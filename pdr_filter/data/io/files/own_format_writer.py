"""Writing the project's own format, and its columns: the reader is `pdr_filter.data.io.files.own_format`."""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.values import FloatArray, Samples, Table, Wifi, address_text, as_plain
from pdr_filter.values.safe_files import whole_file, write_files

STREAM_COLUMNS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("accelerometer", "gyroscope", "magnetometer"), ("x", "y", "z")),
    "barometer": ("pressure_hpa",),
    "light": ("illuminance_lux",),
    "proximity": ("distance_cm",),
    "attitude": ("qw", "qx", "qy", "qz"),
    "location": ("latitude_deg", "longitude_deg", "altitude_m", "horizontal_accuracy_m"),
    "phone_heading": ("heading_rad",),
    "phone_step_count": ("n_steps",),
}
WIFI_COLUMNS = ("bssid", "rssi_dbm", "frequency_mhz")
TRUTH_COLUMNS: dict[str, tuple[str, ...]] = {
    "position": ("time_s", "east_m", "north_m", "up_m"),
    "waypoints": ("time_s", "east_m", "north_m", "floor"),
    "steps": ("time_s",),
    "strides": ("start_s", "end_s", "length_m"),
    "segments": ("start_s", "end_s", "distance_m", "n_steps"),
    "labels": ("start_s", "end_s", "context", "carrying_mode"),
}
FILES = (
    "meta.json",
    "wifi.csv",
    *(f"{name}.csv" for name in STREAM_COLUMNS),
    *(f"truth_{name}.csv" for name in TRUTH_COLUMNS),
)
# Key of `Recording.meta` that is true if the reader has added gravity to the acceleration.
RESTORED_GRAVITY_KEY = "restored_gravity"
# Key of `meta.json` with the notes of the reader that the recording was saved with.
NOTES_KEY = "reading_notes"
TIME_COLUMNS = ("time_s", "start_s", "end_s")
TEXT_COLUMNS = ("context", "carrying_mode")


def write_own_format(
    path: str | Path,
    streams: Mapping[str, Samples],
    truth: Mapping[str, Table],
    meta: Mapping[str, Any],
    wifi: Wifi | None = None,
) -> Path:
    """Write streams and truth tables by name, Wi-Fi, and the meta data, as `Recording.save` describes; return the path.

    ValueError if a truth table lacks a column.
    """
    path = Path(path)
    files = {
        f"{name}.csv": _numbers_csv(("time_s", *STREAM_COLUMNS[name]), [samples.time_s, *samples.values.T])
        for name, samples in streams.items()
    }
    files |= {f"truth_{name}.csv": _table_csv(rows, TRUTH_COLUMNS[name], name) for name, rows in truth.items()}
    if wifi is not None:
        files["wifi.csv"] = _wifi_csv(wifi)
    files["meta.json"] = json.dumps(dict(meta), indent=1, default=_plain) + "\n"
    if not path.suffix:
        write_files({path / name: text.encode() for name, text in files.items()})
        for name in set(FILES) - files.keys():  # files of another recording would be mixed with this one
            (path / name).unlink(missing_ok=True)
        return path
    with whole_file(path) as file, zipfile.ZipFile(file, "w", compression=zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            info = zipfile.ZipInfo(name)  # with the date 1980-01-01, so that the bytes do not depend on the clock
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, text)
    return path


def _numbers_csv(columns: Sequence[str], arrays: Sequence[FloatArray]) -> str:
    row = ",".join(map(_number_format, columns)) + "\n"
    body = (row * len(arrays[0])) % tuple(np.column_stack(arrays).ravel().tolist())
    return ",".join(columns) + "\n" + body.replace("nan", "")


def _wifi_csv(wifi: Wifi) -> str:
    rows = zip(
        wifi.time_s.tolist(), wifi.bssid.tolist(), wifi.rssi_dbm.tolist(), wifi.frequency_mhz.tolist(), strict=True
    )
    body = "".join(f"{t:.6f},{address_text(b)},{rssi:.7g},{mhz:.7g}\n" for t, b, rssi, mhz in rows)
    return ",".join(("time_s", *WIFI_COLUMNS)) + "\n" + body.replace("nan", "")


def _table_csv(rows: Table, columns: Sequence[str], name: str) -> str:
    if missing := [column for column in columns if column not in (rows.dtype.names or ())]:
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
    """Return a mapping, dataclass or NumPy value as plain values that json can write. TypeError for another type."""
    plain = as_plain(value)
    if plain is not value:
        return plain
    raise TypeError(f"meta holds a {type(value).__name__}, which JSON cannot; give numbers, text, lists and dicts")
