"""Sensor Logger (iOS, Android): a zip or folder with one CSV file for each sensor, or one JSON file.

Layout, units and signs after the app's own documents (github.com/tszheichoi/awesome-sensor-logger: UNITS.md,
COORDINATES.md, CROSSPLATFORM.md; app versions 1.6 to 1.64); surprising cases are in docs/robustness.md. The order of
columns differs between versions. `time` is parsed as whole nanoseconds since 1970, which a float holds to 256 ns only.
`Accelerometer` has gravity removed, and on iOS it and `Gravity` have the opposite sign, unless `standardisation` is
true in Metadata. `AccelerometerUncalibrated` of iOS is in g, or in m/s2 if standardised. The gyroscope and the
quaternion have the same sign on both systems.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path, PurePosixPath

import numpy as np

from pdr_filter.data.io.apps.sensor_logger_other import database_tables, is_push, messages_of, push_tables
from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.checks import up_cosine
from pdr_filter.data.io.column_names import PHONE_HEADING, PHONE_STEPS
from pdr_filter.data.io.files.archive import Members, open_members
from pdr_filter.data.io.files.sqlite_file import SQLITE
from pdr_filter.data.io.tables.app_dialects import said_platform
from pdr_filter.data.io.tables.json_tables import ROWS_AT_ONCE, Row, objects_in, table_of_rows
from pdr_filter.data.io.text_table import (
    NumberTable,
    TextTable,
    concatenated,
    find_separator,
    header_fields,
    text_rows,
    whole_number,
)
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, IntArray, Samples, interpolated_near, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

COLUMNS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("TotalAcceleration", "Accelerometer", "Gravity", "AccelerometerUncalibrated"), ("x", "y", "z")),
    **dict.fromkeys(("Gyroscope", "GyroscopeUncalibrated"), ("x", "y", "z")),
    **dict.fromkeys(("Magnetometer", "MagnetometerUncalibrated"), ("x", "y", "z")),
    "Barometer": ("pressure",),
    "Light": ("lux",),
    "Orientation": ("qw", "qx", "qy", "qz"),
    "Location": ("latitude", "longitude", "altitude", "horizontalAccuracy"),
    "Compass": ("magneticBearing",),
    "Pedometer": ("steps",),
}
# Sensors that only describe the walk. Their tables are left out if they lack the column.
_OF_PHONE = ("Compass", "Pedometer")
# Streams that are taken over without arithmetic, and what to take if the first is missing.
PLAIN = {
    "gyroscope": ("Gyroscope", "GyroscopeUncalibrated"),
    "magnetometer": ("Magnetometer", "MagnetometerUncalibrated"),
    "barometer": ("Barometer",),
    "light": ("Light",),
    "attitude": ("Orientation",),
    "location": ("Location",),
    PHONE_HEADING: ("Compass",),
    PHONE_STEPS: ("Pedometer",),
}
# A row from longer before the start than this is a remembered value: sensors start within a second or two.
STALE_S = 60.0


@dataclass
class _Export:
    """Content of a Sensor Logger export. Times are nanoseconds since 1970."""

    sensors: dict[str, NumberTable] = field(default_factory=dict[str, NumberTable])
    metadata: dict[str, str] = field(default_factory=dict[str, str])
    annotations: list[tuple[int, str]] = field(default_factory=list[tuple[int, str]])
    notes: list[str] = field(default_factory=list[str])

    def about(self, key: str) -> str:
        """Return a value of the metadata without surrounding spaces, or an empty string if it does not exist."""
        return self.metadata.get(key, "").strip()


def is_sensor_logger(header: str) -> bool:
    """Return True if the header line of a CSV file is one of Sensor Logger."""
    return {"time", "seconds_elapsed"} <= set(header_fields(header, find_separator(header)))


def is_without_seconds_elapsed(members: Members) -> bool:
    """Return True for an export of 2021, which has no column of elapsed seconds.

    It has an Accelerometer.csv with the columns time, x, y, z, and metadata that name the platform.
    """
    by_stem = {PurePosixPath(name).stem.lower(): name for name in members.names if name.lower().endswith(".csv")}
    if not {"metadata", "accelerometer"} <= by_stem.keys():
        return False
    header = members.head(by_stem["accelerometer"]).partition(b"\n")[0].decode("latin-1").strip()
    return {*header_fields(header, ",")} == {"time", "x", "y", "z"} and bool(said_platform(members))


def looks_like_export(head: bytes) -> bool:
    """Return True if a file begins like an export in one file: JSON, pushed messages, or a database."""
    is_json = head.lstrip()[:1] == b"[" and b'"sensor"' in head[:4096]
    is_json = is_json and (b'"seconds_elapsed"' in head or b'"Metadata"' in head)
    return is_json or is_push(head) or head.startswith(SQLITE)


def sessions_of(members: Members) -> list[str]:
    """Return the names of the sessions (recordings) in a file of messages that Sensor Logger pushed.

    The list is empty for any other file, and if the path already names a session.
    """
    name = members.names[0]
    if members.inside or not is_push(members.head(name)):
        return []
    return list(messages_of(members, name))


def read_sensor_logger(path: str | Path, platform: str | None = None) -> Recording:
    """Return the recording in a zip file, folder, JSON file, database or file of pushed messages of Sensor Logger.

    `platform`, ios or android, is for an export whose Metadata is lost. Gravity is added to an acceleration that lacks
    it, with a note. RecordingError if neither Metadata nor the attitude show the sign of the specific force.
    """
    path = Path(path)
    with open_members(path) as members:
        first = members.names[0] if len(members.names) == 1 else ""  # one file that holds all; one CSV does not
        head = members.head(first) if first else b""
        if head.startswith(SQLITE):
            export = _Export()
            export.sensors, export.metadata = database_tables(members, first, COLUMNS, export.notes)
        elif is_push(head):
            export = _Export(sensors=push_tables(members, first, COLUMNS))
            if (n := max(map(len, export.sensors.values()), default=0)) < limits.MIN_SAMPLES:
                raise RecordingError(
                    f"{path}: messages that Sensor Logger pushed, with at most {n} samples of a sensor: probably only "
                    "one message of the recording was saved; put all messages into one file, one behind the other"
                )
        elif not members.is_container or head.lstrip()[:1] == b"[":
            export = _read_json(members, first)
        else:
            export = _read_tables(members)
    if platform is not None:
        named = export.about("platform").lower()
        if named in ("ios", "android") and named != platform:
            raise RecordingError(f"{path}: Metadata says {named}, and platform is {platform}; leave platform out")
        export.metadata["platform"] = platform
    version, platform = export.about("appVersion"), export.about("platform")
    source = " ".join(["Sensor Logger", *([version] if version else []), *([f"({platform})"] if platform else [])])
    parsed = Parsed(path, source[: limits.MAX_NAME_CHARS], notes=export.notes)
    parsed.set_device(export.about("device name"))
    name, force = _specific_force(export, parsed)
    zero_ns = int(force.whole[0]) if len(force) else 0
    taken = {"accelerometer": name}
    for stream, choices in PLAIN.items():
        choice = next((name for name in choices if len(export.sensors.get(name, ()))), None)
        if choice is not None:
            taken[stream] = choice
            if choice.endswith("Uncalibrated"):
                parsed.notes.append(f"{stream}: only the uncalibrated values were recorded, so its bias is in them")
    for stream, sensor in taken.items():
        table = force if stream == "accelerometer" else export.sensors[sensor]
        # the difference is exact in int64
        parsed.streams[stream] = ((table.whole - zero_ns).astype(np.float64) * 1e-9, table.values)
    if "gyroscope" in taken:
        parsed.found.append("gyroscope: rad/s, same sign on iOS and Android")
    if "location" in taken:
        values = parsed.streams["location"][1]
        values[values[:, 3] < 0, 3] = np.nan  # the app writes -1 for unknown
    if PHONE_HEADING in taken:
        time_s, heading_deg = parsed.streams[PHONE_HEADING]
        is_known = heading_deg[:, 0] != -1
        parsed.streams[PHONE_HEADING] = time_s[is_known], np.radians(heading_deg[is_known])
    asked_hz = _requested_hz(export)
    parsed.requested_hz = {stream: asked_hz[sensor] for stream, sensor in taken.items() if sensor in asked_hz}
    parsed.clock = f"unix nanoseconds of the phone; time zero is {zero_ns} ns"
    if zero_ns > limits.MAX_ELAPSED_S * 1e9:
        parsed.meta["epoch_ns"] = zero_ns
    if export.annotations:
        parsed.meta["annotations"] = [
            {"time_s": (time_ns - zero_ns) * 1e-9, "text": text[: limits.MAX_TEXT_CHARS]}
            for time_ns, text in export.annotations
        ]
    return parsed.recording()


def _specific_force(export: _Export, parsed: Parsed) -> tuple[str, NumberTable]:
    """Return the name of the sensor that measured the acceleration, and the specific force with Android's sign.

    TotalAcceleration of Android is preferred, then Accelerometer plus Gravity, then the uncalibrated one, then
    Accelerometer alone, which lacks gravity (`parsed.linear`). RecordingError without any, or if the sign is unknown.
    """
    path, sensors = parsed.path, export.sensors
    platform = export.about("platform").lower()
    standard = export.about("standardisation").lower() in ("true", "1")
    total, linear, gravity = (sensors.get(n) for n in ("TotalAcceleration", "Accelerometer", "Gravity"))
    raw = sensors.get("AccelerometerUncalibrated")
    if platform not in ("ios", "android"):
        platform = _platform_by_content(export, parsed, platform)
    ios_sign = platform == "ios" and not standard
    how = f"{platform}, standardisation {'on' if standard else 'off'}"
    if total is not None and platform == "android":
        parsed.found.append(f"accelerometer: TotalAcceleration, m/s2, sign as it is ({how})")
        return "TotalAcceleration", total
    if linear is not None and gravity is not None:
        force = linear.values + _at_times(gravity, linear.whole)
        sign = "-(Accelerometer + Gravity)" if ios_sign else "Accelerometer + Gravity"
        parsed.found.append(f"accelerometer: {sign}, m/s2 ({how})")
        return "Accelerometer", NumberTable(linear.whole, -force if ios_sign else force)
    if raw is not None:
        scale = -STANDARD_GRAVITY_MPS2 if ios_sign else 1.0
        unit = "g, sign turned" if ios_sign else "m/s2, sign as it is"
        parsed.found.append(f"accelerometer: AccelerometerUncalibrated, {unit} ({how})")
        return "AccelerometerUncalibrated", NumberTable(raw.whole, scale * raw.values)
    if linear is not None:
        parsed.linear, parsed.instead = "Accelerometer", "Gravity or TotalAcceleration too"
        return "Accelerometer", NumberTable(linear.whole, -linear.values if ios_sign else linear.values)
    raise RecordingError(
        f"{path}: no accelerometer (found: {', '.join(sorted(sensors)) or 'no sensor'}); "
        "record Accelerometer and Gravity"
    )


def _platform_by_content(export: _Export, parsed: Parsed, named: str) -> str:
    """Return the platform, "ios" or "android", that the sensors show. RecordingError if they do not show it.

    TotalAcceleration is Android's. Otherwise gravity shows its sign in the attitude. `named` is the one in the
    metadata.
    """
    gravity, attitude = export.sensors.get("Gravity"), export.sensors.get("Orientation")
    if "TotalAcceleration" in export.sensors:
        parsed.notes.append("no platform in Metadata; taken as Android, because TotalAcceleration is Android's")
        return "android"
    if gravity is not None and attitude is not None and len(gravity) and len(attitude):
        zero = gravity.whole[0]
        cosine = up_cosine(*(Samples((s.whole - zero) * 1e-9, s.values) for s in (gravity, attitude)))
        if abs(cosine) > limits.UP_COSINE_DOUBTFUL:
            platform = "android" if cosine > 0 else "ios"
            way = "up" if cosine > 0 else "down"
            parsed.notes.append(f"no platform in Metadata; {platform}, because Gravity points {way} in Orientation")
            return platform
    raise RecordingError(
        f"{parsed.path}: Metadata names no platform (found {named or 'nothing'!r}), and the signs of iOS and Android "
        "are opposite; export with Metadata.csv, or say it with pdr-filter convert FILE --platform ios, or android"
    )


def _at_times(sensor: NumberTable, time_ns: IntArray) -> FloatArray:
    """Return linearly interpolated values of a sensor at the given times, with NaN where the sensor has a gap."""
    zero_ns = int(sensor.whole.min()) if len(sensor) else 0
    at_s, known_s = ((ns - zero_ns).astype(np.float64) * 1e-9 for ns in (time_ns, sensor.whole))
    return interpolated_near(at_s, known_s, sensor.values, limits.GRAVITY_GAP_S)


def _requested_hz(export: _Export) -> dict[str, float]:
    """Return the sampling rates in Hz that the user chose in the app, by sensor. "As fast as possible" has none."""
    names = [name.replace(" ", "") for name in export.about("sensors").split("|")]
    periods = export.about("sampleRateMs").split("|")
    rates: dict[str, float] = {}
    for name, period in zip(names, periods, strict=False):
        try:
            period_ms = float(period)
        except ValueError:
            continue
        if 0.1 < period_ms < 1e6:  # zero is "as fast as possible"
            rates[name] = 1000 / period_ms
    if len(periods) == 1 and len(names) > 1 and rates:  # one rate for all, as older versions write it
        rates = dict.fromkeys(names, next(iter(rates.values())))
    # On Android the sensor is called Accelerometer in the list also where TotalAcceleration is written with it.
    if "Accelerometer" in rates:
        for name in ("TotalAcceleration", "Gravity"):
            rates.setdefault(name, rates["Accelerometer"])
    return rates


def _read_tables(members: Members) -> _Export:
    """Return the export in the CSV tables of a zip file or folder. Empty tables are left out with a note."""
    export = _Export()
    tables = [name for name in members.names if PurePosixPath(name).suffix.lower() == ".csv"]
    # The last line of these two needs no line feed, and an annotation file may have no bytes at all.
    metadata, annotations = (
        text_rows(members.small(name), members.where(name)) if (name := _member(tables, stem, members)) else []
        for stem in ("Metadata", "Annotation")
    )
    if len(metadata) >= 2:
        export.metadata = dict(zip([name.strip() for name in metadata[0]], metadata[1], strict=False))
    export.annotations = _annotations(annotations)
    begun_ns: int | None = None  # first time, in tables that keep all digits
    rounded: list[str] = []
    for sensor, columns in COLUMNS.items():
        if sensor in _OF_PHONE and not _is_readable(members, tables, sensor):
            continue
        if name := _member(tables, sensor, members):
            table = TextTable(members.blocks(name), members.where(name))
            if table.is_empty:
                export.notes.append(f"{sensor}.csv: empty, left out")
                continue
            has_elapsed = table.fields.count("seconds_elapsed") == 1
            time, *places = table.places(("time", *columns, *["seconds_elapsed"][:has_elapsed]))
            decimal = "," if table.separator != "," and b"," in table.first_rows.split(b"\n", 1)[0] else "."
            rows = table.parse(places, export.notes, whole=time, decimal=decimal)
            elapsed_s = rows.values[:, len(columns) :]
            rows = NumberTable(rows.whole, rows.values[:, : len(columns)])
            if has_elapsed and 2 * np.count_nonzero(np.diff(rows.whole)) < len(rows) - 1:
                known = np.abs(elapsed_s[:, 0]) < limits.MAX_ELAPSED_S
                whole = np.round(elapsed_s[known, 0] * 1e9).astype(np.int64)
                export.sensors[sensor] = NumberTable(whole, rows.values[known])
                rounded.append(sensor)
                continue
            first = zip(rows.whole[: limits.HEAD_ROWS], elapsed_s[: limits.HEAD_ROWS].ravel(), strict=False)
            own_begun_ns = _begun_ns((str(time), str(elapsed)) for time, elapsed in first)
            begun_ns = own_begun_ns or begun_ns
            export.sensors[sensor] = _without_stale(rows, own_begun_ns, sensor, export.notes)
    for sensor in rounded:
        export.notes.append(f"{sensor}.csv: its column time was rounded, so seconds_elapsed is taken")
        rows = export.sensors[sensor]
        export.sensors[sensor] = NumberTable(rows.whole + (begun_ns or 0), rows.values)
    return export


def _is_readable(members: Members, names: Sequence[str], sensor: str) -> bool:
    """Return True if the files have one table of a sensor, with its columns as numbers."""
    with contextlib.suppress(RecordingError):
        if name := _member(names, sensor, members):
            table = TextTable(members.blocks(name), members.where(name))
            time, *places = table.places(("time", *COLUMNS[sensor]))
            return len(table.parse(places, [], whole=time)) > 0
    return False


def _member(names: Sequence[str], sensor: str, members: Members) -> str:
    """Return the file of a sensor, or an empty string if there is none.

    A file with the exact name is preferred to one such as `walk_Gravity (1).csv`. RecordingError if several files fit.
    """
    stems = {name: PurePosixPath(name).stem.lower() for name in names}
    exact = [name for name, stem in stems.items() if stem == sensor.lower()]
    near = [name for name, stem in stems.items() if re.search(rf"(?<![a-z]){sensor.lower()}(?![a-z])", stem)]
    found = exact or near
    if len(found) > 1:
        raise RecordingError(
            f"{members.path}: {PurePosixPath(found[1]).name} is there twice; make one zip of each recording"
            if exact
            else f"{members.path}: {' and '.join(found[:2])} are both {sensor}; keep one of them"
        )
    return found[0] if found else ""


def _read_json(members: Members, name: str) -> _Export:
    """Return the export in a JSON file, in which each object names its sensor and stores numbers as text."""
    export, where = _Export(), members.where(name)
    if not next(members.pieces(name), b"").lstrip().startswith(b"["):
        raise RecordingError(
            f"{where}: not JSON of Sensor Logger, which is an array of objects; give the zip or JSON that it exports"
        )
    rows: dict[str, list[Row]] = {sensor: [] for sensor in COLUMNS}
    parts: dict[str, list[NumberTable]] = {}
    begun_ns: dict[str, int | None] = {}
    annotations = [["time", "text"]]

    def parse(sensor: str) -> None:
        found = rows[sensor]
        if sensor not in parts:
            first = ((str(row.get("time", "")), str(row.get("seconds_elapsed", ""))) for row in found)
            begun_ns[sensor] = _begun_ns(islice(first, limits.HEAD_ROWS))
        with contextlib.suppress(RecordingError) if sensor in _OF_PHONE else contextlib.nullcontext():
            table = table_of_rows(found, COLUMNS[sensor], f"{where}, {sensor}", export.notes)
            parts.setdefault(sensor, []).append(table)
        found.clear()

    for item in objects_in(members.pieces(name), where):
        sensor = str(item.get("sensor"))
        if sensor in rows:
            rows[sensor].append(item)
            if len(rows[sensor]) >= ROWS_AT_ONCE:
                parse(sensor)
        elif sensor.lower() == "metadata":
            export.metadata = {key: str(value) for key, value in item.items()}
        elif sensor == "Annotation" and len(annotations) <= limits.MAX_ANNOTATIONS:
            annotations.append([str(item.get(key, "")) for key in annotations[0]])
    for sensor in (sensor for sensor, found in rows.items() if found):
        parse(sensor)
    export.annotations = _annotations(annotations)
    export.sensors = {
        sensor: _without_stale(concatenated(found), begun_ns[sensor], sensor, export.notes)
        for sensor, found in parts.items()
    }
    return export


def _begun_ns(times: Iterable[tuple[str, str]]) -> int | None:
    """Return the start of the recording in ns since 1970: the median of time minus elapsed seconds; None if unknown."""
    starts: list[int] = []
    for time, elapsed in times:
        with contextlib.suppress(ValueError):
            at_ns, after_s = whole_number(time), float(elapsed.replace(",", "."))
            if at_ns is not None and abs(after_s) < limits.MAX_ELAPSED_S:
                starts.append(at_ns - round(after_s * 1e9))
    return sorted(starts)[len(starts) // 2] if starts else None


def _without_stale(sensor: NumberTable, begun_ns: int | None, name: str, notes: list[str]) -> NumberTable:
    """Return a table without the values that the phone stored over 60 s before the recording, with a note.

    `begun_ns` is the start of the recording. If it is None, the table is unchanged.
    """
    if begun_ns is None:
        return sensor
    kept = sensor.whole.astype(np.float64) >= begun_ns - STALE_S * 1e9
    if kept.all():
        return sensor
    notes.append(f"{name}: {int((~kept).sum())} values that the phone had stored before the recording were dropped")
    return NumberTable(sensor.whole[kept], sensor.values[kept])


def _annotations(rows: list[list[str]]) -> list[tuple[int, str]]:
    """Return time (ns since 1970) and text of the annotations in rows with a time, below a header."""
    if not rows or "time" not in rows[0] or "text" not in rows[0]:
        return []
    at, text = rows[0].index("time"), rows[0].index("text")
    found: list[tuple[int, str]] = []
    for row in rows[1 : limits.MAX_ANNOTATIONS + 1]:
        if len(row) > max(at, text):
            with contextlib.suppress(ValueError):
                if (time_ns := whole_number(row[at])) is not None:
                    found.append((time_ns, row[text]))
    return found
