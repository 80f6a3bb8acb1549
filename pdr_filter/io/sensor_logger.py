"""Sensor Logger (iOS, Android): a zip or folder with one CSV file for each sensor, or one JSON file.

Layout, units and signs after the app's own documents (github.com/tszheichoi/awesome-sensor-logger: UNITS.md,
COORDINATES.md, CROSSPLATFORM.md; app versions 1.6 to 1.64):

- The order of the columns differs between versions and sensors, so they are found by name.
- `time` is a whole number of nanoseconds since 1970 and is parsed as such: a float holds it to 256 ns only.
- `Accelerometer` has gravity removed. Specific force is `TotalAcceleration` (Android only) or the sum of
  `Accelerometer` and `Gravity`; on iOS both have the opposite sign, unless `standardisation` is true in Metadata.
- `AccelerometerUncalibrated` on iOS is in g with iOS's sign, unless standardised.
- The gyroscope has the same sign on both. The quaternion turns the sensor frame into the world, z up.
- The first row of a sensor may be a value that the phone remembered from days before; `seconds_elapsed` tells.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np

from pdr_filter.io.archive import BLOCK_BYTES, Members, open_members
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.checks import finite
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import (
    Layout,
    decode,
    header_fields,
    parse_blocks,
    parse_lines,
    refuse_far_times,
    split_header,
    to_number,
    whole_number,
)
from pdr_filter.values.arrays import FloatArray, IntArray
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2

VECTOR = ("x", "y", "z")
COLUMNS: dict[str, tuple[str, ...]] = {
    "TotalAcceleration": VECTOR,
    "Accelerometer": VECTOR,
    "Gravity": VECTOR,
    "AccelerometerUncalibrated": VECTOR,
    "Gyroscope": VECTOR,
    "GyroscopeUncalibrated": VECTOR,
    "Magnetometer": VECTOR,
    "MagnetometerUncalibrated": VECTOR,
    "Barometer": ("pressure",),
    "Light": ("lux",),
    "Orientation": ("qw", "qx", "qy", "qz"),
    "Location": ("latitude", "longitude", "altitude", "horizontalAccuracy"),
}
# Streams that are taken over without arithmetic, and what to take if the first is missing.
PLAIN = {
    "gyroscope": ("Gyroscope", "GyroscopeUncalibrated"),
    "magnetometer": ("Magnetometer", "MagnetometerUncalibrated"),
    "barometer": ("Barometer",),
    "light": ("Light",),
    "attitude": ("Orientation",),
    "location": ("Location",),
}
# A row from longer before the start than this is a remembered value: sensors start within a second or two.
STALE_S = 60.0
# Gravity is interpolated to the times of the accelerometer; within this it turns by less than a step's swing.
GRAVITY_GAP_S = 0.3
DIGITS = re.compile(r"[0-9]{1,18}[0-9]?(,[0-9]{1,18}[0-9]?)*")
BETWEEN_OBJECTS = re.compile(rb"\}\s{0,20},\s{0,20}\{")
SENSOR_FIRST = '{"sensor":"'
PLAIN_WORD = re.compile(r"\w{1,100}")
NUMBER = "[-+.0-9eE]++"  # what the app writes as one; possessive, so that nothing is tried twice
TAIL_BYTES = 65536  # in which an object ends, unless one is longer than any of a sensor
# Places tried to cut a piece of JSON; more would let a damaged file take long.
CUTS_TRIED = 4
MAX_ANNOTATIONS = 1000
# The first rows tell when the recording began.
HEAD_BYTES = 65536
HEAD_ROWS = 200
MAX_ELAPSED_S = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
    time_ns: IntArray  # (N,)
    values: FloatArray  # (N, d)


def looks_like(header: str) -> bool:
    """Whether the header line of a CSV file is one of Sensor Logger."""
    return {"time", "seconds_elapsed"} <= set(header_fields(header, ","))


def read_sensor_logger(path: str | Path) -> Recording:
    """Return the recording in a zip file, folder or JSON file of Sensor Logger.

    Raises
    ------
    RecordingError
        If specific force cannot be told with its sign: no Metadata to name the platform, gravity missing, or an
        attitude that contradicts the sign.
    """
    path = Path(path)
    with open_members(path) as members:
        alone = len(members.names) == 1  # the JSON; one CSV is not a recording
        if members.names == (path.name,) or (alone and members.content(members.names[0], 100).lstrip()[:1] == b"["):
            sensors, metadata, annotations, notes = _read_json(members, members.names[0])
        else:
            sensors, metadata, annotations, notes = _read_tables(members)
    return _assemble(path, sensors, metadata, annotations, notes)


def _assemble(
    path: Path,
    sensors: dict[str, _Sensor],
    metadata: dict[str, str],
    annotations: list[tuple[int, str]],
    notes: list[str],
) -> Recording:
    parsed = Parsed(path, _source(metadata), notes=notes)
    parsed.meta = _meta(metadata)
    name, force = _specific_force(path, sensors, metadata, parsed)
    zero_ns = int(force.time_ns[0]) if len(force.time_ns) else 0
    parsed.streams["accelerometer"] = (_seconds(force, zero_ns), force.values)
    taken = {"accelerometer": name}
    for stream, choices in PLAIN.items():
        for choice in choices:
            if choice in sensors and len(sensors[choice].time_ns):
                parsed.streams[stream] = (_seconds(sensors[choice], zero_ns), sensors[choice].values)
                taken[stream] = choice
                if choice.endswith("Uncalibrated"):
                    notes.append(f"{stream}: only the uncalibrated values were recorded, so its bias is in them")
                break
    if "gyroscope" in taken:
        parsed.found.append("gyroscope: rad/s, same sign on iOS and Android")
    if "location" in parsed.streams:
        values = parsed.streams["location"][1]
        values[values[:, 3] < 0, 3] = np.nan  # the app writes -1 for unknown
    asked = _requested_hz(metadata)
    parsed.requested_hz = {stream: asked[name] for stream, name in taken.items() if name in asked}
    parsed.clock = f"unix nanoseconds of the phone; time zero is {zero_ns} ns"
    parsed.meta["epoch_ns"] = zero_ns
    if annotations:
        parsed.meta["annotations"] = [
            {"time_s": (time_ns - zero_ns) * 1e-9, "text": text[:500]} for time_ns, text in annotations
        ]
    return parsed.recording()


def _specific_force(
    path: Path, sensors: dict[str, _Sensor], metadata: dict[str, str], parsed: Parsed
) -> tuple[str, _Sensor]:
    """The sensor that is asked for its rate, and specific force with Android's sign."""
    platform = metadata.get("platform", "").strip().lower()
    standard = metadata.get("standardisation", "").strip().lower() in ("true", "1")
    total, linear, gravity = (sensors.get(n) for n in ("TotalAcceleration", "Accelerometer", "Gravity"))
    raw = sensors.get("AccelerometerUncalibrated")
    if platform not in ("ios", "android"):
        if total is None:
            raise RecordingError(
                f"{path}: Metadata names no platform (found {platform or 'nothing'!r}), and the signs of iOS and "
                "Android are opposite; export with Metadata.csv"
            )
        platform = "android"  # only there TotalAcceleration is written
        parsed.notes.append("no platform in Metadata; taken as Android, because TotalAcceleration is Android's")
    ios_sign = platform == "ios" and not standard
    said = f"{platform}, standardisation {'on' if standard else 'off'}"
    if total is not None and platform == "android":
        parsed.found.append(f"accelerometer: TotalAcceleration, m/s2, sign as it is ({said})")
        return "TotalAcceleration", total
    if linear is not None and gravity is not None:
        force = linear.values + _at_times(gravity, linear.time_ns)
        sign = "-(Accelerometer + Gravity)" if ios_sign else "Accelerometer + Gravity"
        parsed.found.append(f"accelerometer: {sign}, m/s2 ({said})")
        return "Accelerometer", _Sensor(linear.time_ns, -force if ios_sign else force)
    if raw is not None:
        scale = -STANDARD_GRAVITY_MPS2 if ios_sign else 1.0
        unit = "g, sign turned" if ios_sign else "m/s2, sign as it is"
        parsed.found.append(f"accelerometer: AccelerometerUncalibrated, {unit} ({said})")
        return "AccelerometerUncalibrated", _Sensor(raw.time_ns, scale * raw.values)
    if linear is not None:
        raise RecordingError(
            f"{path}: Accelerometer has gravity removed, and neither Gravity nor TotalAcceleration was recorded; "
            "switch one of them on in the app"
        )
    raise RecordingError(
        f"{path}: no accelerometer (found: {', '.join(sorted(sensors)) or 'no sensor'}); "
        "record Accelerometer and Gravity"
    )


def _at_times(sensor: _Sensor, time_ns: IntArray) -> FloatArray:
    """Values interpolated linearly, NaN where the sensor has a hole."""
    result = np.full((len(time_ns), sensor.values.shape[1]), np.nan)
    if len(sensor.time_ns) == 0 or len(time_ns) == 0:
        return result
    order = np.argsort(sensor.time_ns, kind="stable")
    zero_ns = sensor.time_ns[order[0]]
    at_s, known_s = (time_ns - zero_ns) * 1e-9, (sensor.time_ns[order] - zero_ns) * 1e-9
    for i in range(result.shape[1]):
        result[:, i] = np.interp(at_s, known_s, sensor.values[order, i])
    right = np.clip(np.searchsorted(known_s, at_s), 0, len(known_s) - 1)
    left = np.maximum(right - 1, 0)
    gap_s = np.minimum(np.abs(known_s[right] - at_s), np.abs(known_s[left] - at_s))
    result[gap_s > GRAVITY_GAP_S] = np.nan
    return result


def _seconds(sensor: _Sensor, zero_ns: int) -> FloatArray:
    return (sensor.time_ns - zero_ns).astype(np.float64) * 1e-9  # the difference is exact in int64


def _source(metadata: dict[str, str]) -> str:
    version = metadata.get("appVersion", "").strip()
    platform = metadata.get("platform", "").strip()
    return " ".join(["Sensor Logger", *([version] if version else []), *([f"({platform})"] if platform else [])])[:200]


def _meta(metadata: dict[str, str]) -> dict[str, Any]:
    device = metadata.get("device name", "").strip()
    return {"device": device[:200]} if device else {}


def _requested_hz(metadata: dict[str, str]) -> dict[str, float]:
    names = [name.replace(" ", "") for name in metadata.get("sensors", "").split("|")]
    periods = metadata.get("sampleRateMs", "").split("|")
    rates: dict[str, float] = {}
    for name, period in zip(names, periods, strict=False):
        try:
            period_ms = float(period)
        except ValueError:
            continue
        if 0.1 < period_ms < 1e6:  # zero is "as fast as possible"
            rates[name] = 1000 / period_ms
    single = metadata.get("sampleRateMs", "").strip()
    if "|" not in single and len(names) > 1 and rates:  # one rate for all, as older versions write it
        rates = dict.fromkeys(names, next(iter(rates.values())))
    # On Android the sensor is called Accelerometer in the list also where TotalAcceleration is written with it.
    if "Accelerometer" in rates:
        for name in ("TotalAcceleration", "Gravity"):
            rates.setdefault(name, rates["Accelerometer"])
    return rates


# ---------------------------------------------------------------- zip and folder


def _read_tables(
    members: Members,
) -> tuple[dict[str, _Sensor], dict[str, str], list[tuple[int, str]], list[str]]:
    notes: list[str] = []
    by_stem: dict[str, str] = {}
    for name in members.names:
        pure = PurePosixPath(name)
        if pure.suffix.lower() == ".csv":
            if pure.stem in by_stem:
                raise RecordingError(f"{members.path}: {pure.name} is there twice; make one zip of each recording")
            by_stem[pure.stem] = name
    metadata: dict[str, str] = {}
    annotations: list[tuple[int, str]] = []
    if "Metadata" in by_stem:
        rows = _text_rows(members, by_stem["Metadata"])
        if len(rows) >= 2:
            metadata = dict(zip([field.strip() for field in rows[0]], rows[1], strict=False))
    if "Annotation" in by_stem:
        annotations = _annotations(_text_rows(members, by_stem["Annotation"]))
    sensors: dict[str, _Sensor] = {}
    for sensor, columns in COLUMNS.items():
        if sensor in by_stem:
            table = _read_sensor(members, by_stem[sensor], columns, notes)
            if table is not None:
                sensors[sensor] = table
    return sensors, metadata, annotations, notes


def _read_sensor(members: Members, name: str, columns: tuple[str, ...], notes: list[str]) -> _Sensor | None:
    where = members.where(name)
    header, body = split_header(members.blocks(name), where)
    fields = header_fields(header, ",")
    if not any(fields):
        notes.append(f"{PurePosixPath(name).name}: empty, left out")
        return None
    missing = [column for column in ("time", *columns) if fields.count(column) != 1]
    if missing:
        raise RecordingError(f"{where}: no column {missing[0]!r} (found: {', '.join(fields)[:120]}), or more than one")
    layout = Layout(tuple(fields.index(c) for c in columns), fields.index("time"), names=columns)
    elapsed = fields.index("seconds_elapsed") if fields.count("seconds_elapsed") == 1 else None
    first = next(body, b"")
    begun_ns = _begun_ns(first, fields.index("time"), elapsed)
    rows = parse_blocks(chain([first], body), layout, where, notes)
    return _without_stale(_Sensor(rows.whole, rows.values), begun_ns, PurePosixPath(name).stem, notes)


def _begun_ns(block: bytes, time: int, elapsed: int | None) -> int | None:
    """When the recording began, from the first rows: the median of time minus seconds elapsed; None if not known."""
    starts: list[int] = []
    for line in block[:HEAD_BYTES].split(b"\n")[:HEAD_ROWS] if elapsed is not None else []:
        fields = line.decode("utf-8", "replace").split(",")
        with contextlib.suppress(ValueError, IndexError, TypeError):
            at_ns, after_s = whole_number(fields[time]), float(fields[elapsed or 0])
            if at_ns is not None and abs(after_s) < MAX_ELAPSED_S:
                starts.append(at_ns - round(after_s * 1e9))
    return sorted(starts)[len(starts) // 2] if starts else None


def _without_stale(sensor: _Sensor, begun_ns: int | None, name: str, notes: list[str]) -> _Sensor:
    """Without the values that the phone remembered from before the recording."""
    if begun_ns is None:
        return sensor
    kept = sensor.time_ns.astype(np.float64) >= begun_ns - STALE_S * 1e9
    if kept.all():
        return sensor
    notes.append(f"{name}: {int((~kept).sum())} values remembered from before the recording left out")
    return _Sensor(sensor.time_ns[kept], sensor.values[kept])


def _text_rows(members: Members, name: str) -> list[list[str]]:
    """Rows of a small text table; its last line needs no line feed, and the file may have no bytes at all."""
    text = decode(members.content(name).replace(b"\x00", b""), members.where(name))
    try:
        return [row for row in csv.reader(io.StringIO(text)) if row]
    except csv.Error as error:
        raise RecordingError(f"{members.where(name)}: not CSV text ({error}); export it again") from error


def _annotations(rows: list[list[str]]) -> list[tuple[int, str]]:
    if not rows or "time" not in rows[0] or "text" not in rows[0]:
        return []
    at, text = rows[0].index("time"), rows[0].index("text")
    found: list[tuple[int, str]] = []
    for row in rows[1 : MAX_ANNOTATIONS + 1]:
        if len(row) > max(at, text):
            try:
                time_ns = whole_number(row[at])
            except ValueError:
                continue
            if time_ns is not None:
                found.append((time_ns, row[text]))
    return found


# ---------------------------------------------------------------- JSON


def _read_json(
    members: Members, name: str
) -> tuple[dict[str, _Sensor], dict[str, str], list[tuple[int, str]], list[str]]:
    """One array of flat objects, each with its sensor's name; numbers are texts in it. Read in pieces."""
    where = members.where(name)
    notes: list[str] = []
    times: dict[str, list[IntArray]] = {}
    values: dict[str, list[FloatArray]] = {}
    begun: dict[str, int | None] = {}
    metadata: dict[str, str] = {}
    annotations: list[tuple[int, str]] = []
    for groups in _json_pieces(members, name, where):
        for item in chain(*(groups[key].items() for key in ("Metadata", "metadata") if key in groups)):
            metadata = {key: str(value) for key, value in item.items()}
        if "Annotation" in groups and len(annotations) < MAX_ANNOTATIONS:
            keys = ["time", "text"]
            rows = ([str(item.get(key, "")) for key in keys] for item in groups["Annotation"].items())
            annotations += _annotations([keys, *rows])
        for sensor, columns in COLUMNS.items():
            if sensor in groups:
                group = groups[sensor]
                if sensor not in begun:
                    begun[sensor] = _begun_ns_of(group.items(HEAD_ROWS))
                time_ns, numbers = _json_rows(group, columns, f"{where}, {sensor}", notes)
                times.setdefault(sensor, []).append(time_ns)
                values.setdefault(sensor, []).append(numbers)
    sensors = {
        name: _without_stale(
            _Sensor(np.concatenate(times[name]), np.concatenate(values[name])), begun[name], name, notes
        )
        for name in times
    }
    return sensors, metadata, annotations, notes


def _begun_ns_of(rows: list[dict[str, Any]]) -> int | None:
    lines = [f"{row.get('time', '')},{row.get('seconds_elapsed', '')}" for row in rows]
    return _begun_ns("\n".join(lines).encode("utf-8", "replace"), 0, 1)


@dataclass(frozen=True, slots=True)
class _Objects:
    """Objects of one sensor: as parsed, or as text where all are alike, which is most of any file."""

    parsed: list[dict[str, Any]]
    keys: tuple[str, ...] = ()  # of every object in `texts`, in this order
    texts: tuple[str, ...] = ()  # "key":"number" pairs without spaces, the sensor's name first; without braces

    def items(self, most: int | None = None) -> list[dict[str, Any]]:
        return self.parsed[:most] if self.parsed else json.loads(f"[{{{'},{'.join(self.texts[:most])}}}]")


def _json_rows(group: _Objects, columns: tuple[str, ...], where: str, notes: list[str]) -> tuple[IntArray, FloatArray]:
    keys = group.keys or tuple(group.parsed[0])
    missing = [key for key in ("time", *columns) if key not in keys]
    if missing:
        raise RecordingError(f"{where}: no key {missing[0]!r} (found: {', '.join(map(str, keys))[:120]})")
    if group.texts:
        # Between quotation marks the fields are: nothing, key, colon, value, comma, key, colon, value, ...
        layout = Layout(tuple(3 + 4 * keys.index(c) for c in columns), 3 + 4 * keys.index("time"), separator='"')
        with contextlib.suppress(ValueError):
            table = parse_lines(group.texts, layout)
            refuse_far_times(table.whole, where)
            return table.whole, finite(table.values, where, notes)
    rows = group.items()
    try:
        times = [str(row["time"]) for row in rows]
        if DIGITS.fullmatch(",".join(times)):
            time_ns = np.array(list(map(int, times)), dtype=np.int64)
        else:
            known = [whole_number(time) for time in times]
            rows = [row for row, time in zip(rows, known, strict=True) if time is not None]
            time_ns = np.array([time for time in known if time is not None], dtype=np.int64)
        values = np.empty((len(rows), len(columns)))
        for i, key in enumerate(columns):
            values[:, i] = _floats([row.get(key) for row in rows])
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise RecordingError(f"{where}: not a number ({str(error)[:60]}); export it again") from error
    refuse_far_times(time_ns, where)
    return time_ns, finite(values, where, notes)


def _floats(column: list[Any]) -> list[float]:
    """Numbers, or texts of numbers; NaN where there is none. ValueError for anything else."""
    kinds = set(map(type, column))
    if kinds <= {int, float} or (kinds == {str} and "_" not in "".join(column)):  # Python would read 1_0 as ten
        with contextlib.suppress(ValueError):
            return list(map(float, column))
    return list(map(_json_float, column))


def _json_float(value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) in (int, float):
        return float(value)
    number = to_number(value) if isinstance(value, str) else None
    if number is None:
        raise ValueError(repr(value))
    return number


def _json_pieces(members: Members, name: str, where: str) -> Iterator[dict[str, _Objects]]:
    """The objects of the array, some thousand at once: the file is cut where one object ends and the next begins."""
    rest = b""
    begun = False
    for part in members.pieces(name):
        text = rest + part
        if not begun:
            text, begun = text.lstrip(), True
            if not text.startswith(b"["):
                raise RecordingError(f"{where}: not an array of objects; export JSON from Sensor Logger again")
            text = text[1:]
        tail = max(0, len(text) - TAIL_BYTES)
        cuts = list(BETWEEN_OBJECTS.finditer(text, tail))[-CUTS_TRIED:]
        for cut in reversed(cuts):  # one that lies in a text is not where an object ends; the one before it is
            objects = _objects(text[: cut.start() + 1])
            if objects is not None:
                yield objects
                text = text[cut.end() - 1 :]
                break
        rest = text
        if len(rest) > 2 * BLOCK_BYTES:
            raise RecordingError(f"{where}: the JSON is damaged; export it again")
    rest = rest.rstrip()
    objects = _objects(rest[:-1]) if rest.endswith(b"]") else None
    if objects is None:
        raise RecordingError(f"{where}: the JSON is damaged or cut off; export it again")
    yield objects


def _objects(content: bytes) -> dict[str, _Objects] | None:
    """Objects by sensor of the inside of an array; None if it is no JSON.

    Parsing every object takes twice as long as finding that all of a sensor have the same keys around numbers, and
    reading these as a table.
    """
    groups = _alike(content)
    if groups is not None:
        return groups
    objects = _loads(content)
    return None if objects is None else _grouped(objects)


def _alike(content: bytes) -> dict[str, _Objects] | None:
    """The same in the app's own layout, without spaces and with the sensor's name first; None if it is another."""
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return None
    if not (text.startswith(SENSOR_FIRST) and text.endswith("}")):
        return None
    by_sensor: dict[str, list[str]] = {}
    begin = len(SENSOR_FIRST) - 1
    for inside in text[1:-1].split("},{"):
        # A text in the file that holds such a cut makes parts that do not begin like an object, or are no JSON.
        if not inside.startswith(SENSOR_FIRST[1:]):
            return None
        by_sensor.setdefault(inside[begin : inside.find('"', begin)], []).append(inside)
    groups: dict[str, _Objects] = {}
    for sensor, texts in by_sensor.items():
        keys = _common_keys(texts)
        parsed = None if keys else _loads(f"{{{'},{'.join(texts)}}}".encode())
        if parsed is not None:
            groups |= _grouped(parsed)
        elif keys:
            groups[sensor] = _Objects([], keys, tuple(texts))
        else:
            return None
    return groups


def _common_keys(texts: list[str]) -> tuple[str, ...]:
    """Keys of all objects if they are the same, in the same order, around numbers; none if they are not."""
    parts = texts[0].split('"')
    sensor, keys = parts[3], tuple(parts[1::4])
    if not all(PLAIN_WORD.fullmatch(word) for word in (sensor, *keys)) or len(set(keys)) < len(keys) or len(keys) < 2:
        return ()
    pairs = ",".join(f'"{key}":"{NUMBER}"' for key in keys[1:])
    one = f'"sensor":"{sensor}",{pairs}\n'
    return keys if re.fullmatch(f"(?:{one})*+", "\n".join([*texts, ""])) else ()


def _grouped(objects: list[dict[str, Any]]) -> dict[str, _Objects]:
    by_sensor: dict[str, _Objects] = {}
    for item in objects:
        sensor: Any = item.get("sensor")
        if isinstance(sensor, str):
            by_sensor.setdefault(sensor, _Objects([])).parsed.append(item)
    return by_sensor


def _loads(inside: bytes) -> list[dict[str, Any]] | None:
    """The objects of the inside of an array, None if it is no JSON."""
    try:
        value: Any = json.loads(b"[" + inside + b"]")
    except (ValueError, RecursionError):
        return None
    return [cast("dict[str, Any]", item) for item in cast("list[Any]", value) if isinstance(item, dict)]
