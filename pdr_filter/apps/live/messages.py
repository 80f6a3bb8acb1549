"""Messages of phones as values: the JSON of each app becomes rows of sensors. No content of a message is trusted.

Layouts: Sensor Logger (github.com/tszheichoi/awesome-sensor-logger: PUSHING.md, UNITS.md), SensorServer
(github.com/umer0586/SensorServer), phyphox (phyphox.org/wiki, "Remote-interface communication"), and one of our own
for all other senders (docs/live.md). A body is one message or an array of at most 1000 messages of one device.

A message of our own layout is an object with these fields. Device, session and platform can also be in the address
(`?device=NAME`).

- `device`, `session`: texts.
- `platform`: "ios" or "android", which decides the sign of the specific force.
- `number`: count of the messages of a session, so that they may be repeated and in any order.
- `end`: true in the last message of a session. Its last steps then do not wait for later samples.
- `meta`: object with `name` of the recording, `placement` and `subject`, an object with `height_m`, `weight_kg`, `age`,
  `id` and `gender` of the person. It is used in the messages before the track begins, where later values replace
  earlier ones. A value that cannot be used is left out, with a note.
- `samples`: by sensor (`N_VALUES`), rows of the time and the values. The time is in s, or in ms, us or ns since 1970.
  The specific force is +9.81 m/s2 on z for a phone lying face up. `linear_acceleration` and `gravity` are added; one
  without the other is refused.
- `fix`, in place of `samples`: `east_m` and `north_m`, or `latitude_deg` and `longitude_deg`, with `std_m` (0.01 to
  1000, default 1) and `time_s` (default: the present). With `range_m` it is the distance to an anchor at this place.

Answers, by HTTP status:

- 200: accepted. The operating system has it, so that it is not lost if the server is killed.
- 400: not a message, or a header Host that is no address. 401: no token, or a wrong one. 403: not from this computer,
  or from a page of another site.
- 409: a fix that cannot be used.
- 410: a message after the server stopped waiting for its number.
- 413, 429: more than 4 MB in a message, or more than 1 MB a second.
- 422: a session that cannot be tracked, with the reason. Its messages are recorded.
- 500: a message that has ended its worker twice.
- 503: no room, no time or a full disk at present. Send the body again. Messages of other sessions in it
  may have been taken, and are then recognised.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from pdr_filter.values import FloatArray, IntArray, limits
from pdr_filter.values.recording import check_height
from pdr_filter.values.replace import replace_unchecked
from pdr_filter.values.sanitise import printable

# Sensors by our names, with how many numbers one sample has. Specific force is in m/s2 with Android's sign, or with
# that of iOS (the opposite one), which a message does not always know.
FORCE, LINEAR, GRAVITY, RAW = "accelerometer", "linear_acceleration", "gravity", "accelerometer_uncalibrated"
N_VALUES: Mapping[str, int] = {
    FORCE: 3,
    LINEAR: 3,
    GRAVITY: 3,
    RAW: 3,  # as the sensor gives it: g with the sign of iOS, or m/s2
    "gyroscope": 3,  # rad/s
    "magnetometer": 3,  # uT
    "barometer": 1,  # hPa
    "location": 4,  # latitude and longitude in degrees, altitude and horizontal accuracy in m
    "attitude": 4,  # quaternion wxyz, sensor to world
}
# No phone measures more in any of these units; larger values are errors.
_LARGEST = 1e6
_MAX_MESSAGES = 1000  # in one body
_MAX_NUMBER = 2**53


T = TypeVar("T")


class MessageError(ValueError):
    """Error for a message that cannot be understood. It states the reason."""


class SensorRows(NamedTuple):
    """Samples of one sensor in sent order: times (N,) in whole nanoseconds or float seconds, and values (N, d)."""

    time: IntArray | FloatArray
    values: FloatArray

    @property
    def unit_s(self) -> float:
        """Seconds in one unit of `time`, 1e-9 for whole nanoseconds."""
        return 1.0 if self.time.dtype.kind == "f" else 1e-9


@dataclass(frozen=True, eq=False)
class Message:
    """Content of one message of a phone: its samples or a fix, its device and session."""

    device: str
    session: str
    number: int | None = None  # place in the session, from an app that counts its messages
    platform: str = ""  # "ios" or "android", which decides the sign of forces; empty if unknown
    rows: Mapping[str, SensorRows] = field(default_factory=dict[str, SensorRows])
    fix: Mapping[str, Any] | None = None  # position that a user has marked
    is_end: bool = False  # whether it is the last one of its session
    meta: Mapping[str, Any] = field(default_factory=dict[str, Any])  # name, placement and subject, as in a recording
    notes: tuple[str, ...] = ()  # about the meta data that cannot be used
    source: bytes = b""  # one line of JSON from which `parse` makes the same message again

    @property
    def n_samples(self) -> int:
        """Number of samples of all sensors."""
        return sum(len(rows.time) for rows in self.rows.values())


@dataclass(frozen=True, slots=True)
class MessageBatch:
    """Request to process the messages that one device sent in one HTTP body, received at `received_s`."""

    device: str
    messages: Sequence[Message]
    received_s: float


def together(messages: Sequence[Message], name: str) -> SensorRows | None:
    """Return the rows of one sensor in several messages, or None if there are none."""
    parts = [m.rows[name] for m in messages if name in m.rows and len(m.rows[name].time)]
    if not parts:
        return None
    time: Any = np.concatenate([rows.time for rows in parts])
    return SensorRows(time, np.concatenate([rows.values for rows in parts]))


def parse(body: bytes, device: str = "", session: str = "", platform: str = "") -> list[Message]:
    """Messages of a body, in its order; MessageError if it is not of a known kind.

    `device`, `session` and `platform` are for a message that does not say them. An object with nothing to read, such
    as the test that Sensor Logger's settings send, has no messages.
    """
    items = _items(body)
    known = {"device": device, "session": session, "platform": platform}
    messages: list[Message] = []
    for item in items:
        message = _message(_checked(item, dict, "a message must be a JSON object"), known)
        if message is not None:
            # line ends in JSON are white space, and the journal needs a line for each message
            is_alone = len(items) == 1 and json.detect_encoding(body) == "utf-8"
            if message.fix is not None and item.get("id") is None:  # a repetition has the same line in the journal
                is_alone, item = False, {**item, "id": uuid.uuid4().hex}
            source = body.translate(_ONE_LINE) if is_alone else json.dumps(item).encode()
            messages.append(replace_unchecked(message, source=source))
    return messages


_ONE_LINE = bytes.maketrans(b"\r\n", b"  ")


def _items(body: bytes) -> list[Any]:
    """Return the items of the JSON array in a body, or a single other value as a list."""
    with _refusing("not JSON ({}); send what docs/live.md describes"):
        content: Any = json.loads(body)
    items: list[Any] = cast("list[Any]", content) if isinstance(content, list) else [content]
    if len(items) > _MAX_MESSAGES:
        raise MessageError(f"{len(items)} messages in one body, more than {_MAX_MESSAGES}; send them as they come")
    return items


def to_json(message: Message) -> bytes:
    """Return the body of a message in the package's own layout, as `parse` reads it, without its fix."""
    samples = {name: np.column_stack([rows.time, rows.values]).tolist() for name, rows in message.rows.items()}
    content = {"device": message.device, "session": message.session, "platform": message.platform, "samples": samples}
    numbered = {} if message.number is None else {"number": message.number}
    more = ({"end": True} if message.is_end else {}) | ({"meta": dict(message.meta)} if message.meta else {})
    return json.dumps({**content, **numbered, **more}).encode()


def _message(item: Mapping[str, Any], known: Mapping[str, str]) -> Message | None:
    """Return the message in a JSON object, or None if the object is of no known layout."""
    if "payload" in item:
        device, session = _text(item, "deviceId", known["device"]), _text(item, "sessionId", known["session"])
        rows = _sensor_logger_rows(item["payload"])
        return Message(device, session, _whole(item, "messageId"), known["platform"], rows)
    device, session = _text(item, "device", known["device"]), _text(item, "session", known["session"])
    platform = _text(item, "platform", known["platform"])
    if "samples" in item:
        (meta, notes), number, is_end = _meta(item.get("meta")), _whole(item, "number"), item.get("end") is True
        rows = _own_rows(item["samples"])
        return Message(device, session, number, platform, rows, is_end=is_end, meta=meta, notes=notes)
    if "fix" in item:
        fix = _checked(item["fix"], dict, "a fix must be a JSON object")
        return Message(device, session, None, platform, fix=fix)
    if {"type", "timestamp", "values"} <= item.keys():
        return Message(device, session, None, "android", _sensor_server_rows(item))
    return None


@contextmanager
def _refusing(words: str) -> Generator[None]:
    """Turn errors about the content of a message into a MessageError. `words` has {} in place of the reason."""
    try:
        yield
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise MessageError(words.format(printable(error)[:80])) from None


def _checked(value: Any, kind: type[T], words: str) -> T:
    """Return a part of a message. MessageError that begins with `words` if it is of another kind."""
    if not isinstance(value, kind):
        raise MessageError(f"{words}, got {printable(value)[:40]!r}: see docs/live.md")
    return value


# --- Sensor Logger ----------------------------------------------------------------------------------------------------

# Sensors of the app, with our names and the keys of their values. `accelerometer` has gravity removed.
_XYZ = ("x", "y", "z")
_SENSOR_LOGGER: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "totalacceleration": (FORCE, _XYZ),
    "accelerometer": (LINEAR, _XYZ),
    "gravity": (GRAVITY, _XYZ),
    "accelerometeruncalibrated": (RAW, _XYZ),
    "gyroscope": ("gyroscope", _XYZ),
    "magnetometer": ("magnetometer", _XYZ),
    "barometer": ("barometer", ("pressure",)),
    "location": ("location", ("latitude", "longitude", "altitude", "horizontalAccuracy")),
    "orientation": ("attitude", ("qw", "qx", "qy", "qz")),
}


def _sensor_logger_rows(payload: Any) -> dict[str, SensorRows]:
    """Return the samples in a payload of Sensor Logger by sensor. Sensors that are not used are left out."""
    times: dict[str, list[Any]] = {}
    values: dict[str, list[list[Any]]] = {}
    items = _checked(payload, list, "payload must be an array of samples")
    with _refusing("a sample of the payload must have a name, a time and an object of values ({}): see docs/live.md"):
        for item in items:
            name = item["name"].lower()
            if name in _SENSOR_LOGGER:
                held = item["values"]
                times.setdefault(name, []).append(item["time"])
                values.setdefault(name, []).append([held.get(key) for key in _SENSOR_LOGGER[name][1]])
    return {_SENSOR_LOGGER[name][0]: _plausible(_payload_times(times[name]), _floats(values[name])) for name in times}


# --- SensorServer -----------------------------------------------------------------------------------------------------

ANDROID_SENSORS: Mapping[str, str] = {
    "android.sensor.accelerometer": FORCE,
    "android.sensor.linear_acceleration": LINEAR,
    "android.sensor.gravity": GRAVITY,
    "android.sensor.gyroscope": "gyroscope",
    "android.sensor.magnetic_field": "magnetometer",
    "android.sensor.pressure": "barometer",
}


def _sensor_server_rows(item: Mapping[str, Any]) -> dict[str, SensorRows]:
    """Return the sample of an Android sensor event by sensor. Nothing is returned for a sensor that is not used."""
    sensor = ANDROID_SENSORS.get(str(item["type"]))
    if sensor is None:
        return {}
    values: Any = item["values"]
    if not isinstance(values, list) or len(cast("list[Any]", values)) < N_VALUES[sensor]:
        raise MessageError(
            f"{item['type']}: values are {printable(values)[:40]!r}, but must be {N_VALUES[sensor]} numbers: send the "
            "event as Android delivers it"
        )
    with _refusing("timestamp must be whole nanoseconds ({}): send the event as Android delivers it"):
        time_ns = np.array([int(item["timestamp"])], dtype=np.int64)
    return {sensor: _plausible(time_ns, _floats([cast("list[Any]", values)[: N_VALUES[sensor]]]))}


# --- our own ----------------------------------------------------------------------------------------------------------


def _own_rows(samples: Any) -> dict[str, SensorRows]:
    """Return the samples of a message in the package's own layout: rows [time, value, ...] by sensor."""
    found: dict[str, SensorRows] = {}
    for name, rows in _checked(samples, dict, "samples must be an object of sensors").items():
        if name not in N_VALUES:
            raise MessageError(f"unknown sensor {printable(name)[:40]!r}; known are {', '.join(N_VALUES)}")
        table = _floats(rows)
        if table.size and (table.ndim != 2 or table.shape[1] != 1 + N_VALUES[name]):
            raise MessageError(
                f"{name}: a sample must be [time_s and {N_VALUES[name]} numbers], got an array of shape {table.shape}: "
                "see docs/live.md"
            )
        if table.size:
            # seconds stay as they are; times since 1970 in a smaller unit become whole nanoseconds
            time, unit_ns = table[:, 0], _unit_ns(table[:, 0], is_seconds=False)
            found[name] = _plausible(time if unit_ns is None else _nanoseconds(time, unit_ns), table[:, 1:])
    return found


# --- phyphox ----------------------------------------------------------------------------------------------------------

_PHYPHOX: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "accelerometer": (FORCE, _XYZ),
    "linear_acceleration": (LINEAR, _XYZ),
    "gravity": (GRAVITY, _XYZ),
    "gyroscope": ("gyroscope", _XYZ),
    "magnetic_field": ("magnetometer", _XYZ),
    "pressure": ("barometer", ("x",)),
    "location": ("location", ("lat", "lon", "z", "accuracy")),
}


def phyphox_buffers(config: bytes) -> dict[str, tuple[str, ...]]:
    """Names of the buffers of each sensor, time first, from what phyphox answers at /config.

    As the app writes it (phyphox-android, RemoteServer.java, handleConfig): inputs with their source, and outputs as
    objects of one name each. An input over Bluetooth has no outputs.
    """
    found: dict[str, tuple[str, ...]] = {}
    with _refusing("/config is not that of phyphox ({}): check the address, and update phyphox"):
        inputs: list[dict[str, Any]] = json.loads(config)["inputs"]
        for given in inputs:
            sensor, keys = _PHYPHOX.get(given["source"], ("", ()))
            places = {key: str(name) for output in given.get("outputs", ()) for key, name in output.items()}
            if sensor and {"t", *keys} <= places.keys():
                found[sensor] = tuple(places[key] for key in ("t", *keys))
    if FORCE not in found and not {LINEAR, GRAVITY} <= found.keys():
        raise MessageError(
            f"this experiment of phyphox has no acceleration with g (found: {', '.join(found) or 'nothing'}); open one "
            "with accelerometer and gyroscope, or make one with both under Add custom experiment"
        )
    return found


def phyphox_rows(answer: bytes, buffers: Mapping[str, tuple[str, ...]]) -> dict[str, SensorRows]:
    """Return the samples of each sensor in the answer of phyphox at /get, with times in s of the experiment."""
    with _refusing("/get is not that of phyphox ({}): check the address, and update phyphox"):
        content: dict[str, Any] = json.loads(answer)["buffer"]
        columns = {name: [_floats(content[buffer]["buffer"]) for buffer in buffers[name]] for name in buffers}
        for name, lists in columns.items():
            if any(column.ndim != 1 for column in lists):
                raise ValueError(f"a buffer of {name} is not a list of numbers")
    found: dict[str, SensorRows] = {}
    for name, lists in columns.items():
        n = min(map(len, lists))  # one may have grown while they were read
        if n:
            time_s, *values = (column[:n] for column in lists)
            found[name] = _plausible(time_s, np.column_stack(values))
    return found


def _meta(content: Any) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the known fields of the meta data of a message, and a note about each value that cannot be used.

    Such a value is left out, because the samples are worth more than it.
    """
    notes: list[str] = []

    def unused(name: str, value: Any, remedy: str) -> None:
        notes.append(f"{name} in the meta data of the phone is {printable(value)[:40]!r}, which is not used: {remedy}")

    def fields(value: Any, name: str) -> dict[str, Any]:
        if value is not None and not isinstance(value, dict):
            unused(name, value, "send a JSON object")
        return cast("dict[str, Any]", value) if isinstance(value, dict) else {}

    def texts(item: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
        for name in names:
            if not isinstance(item.get(name), str | int | None):
                unused(name, item[name], "send a text")
        return {name: text for name in names if (text := _text(item, name, ""))}

    given = fields(content, "meta")
    person = fields(given.get("subject"), "subject")
    subject: dict[str, Any] = texts(person, ("id", "gender"))
    for name in ("height_m", "weight_kg", "age"):
        value = person.get(name)
        if value is None:
            continue
        try:
            number = float(value)
            if not 0.0 <= number < _LARGEST:
                raise ValueError
            if name == "height_m":
                check_height(number)
        except (TypeError, ValueError, OverflowError):
            unused(name, value, "send a number, and a height in metres")
        else:
            subject[name] = number
    found = texts(given, ("name", "placement"))
    return {**found, "subject": subject} if subject else found, tuple(notes)


# --- numbers ----------------------------------------------------------------------------------------------------------


# Nanoseconds in each unit of times since 1970, with the range of such times from 2001 to 2100.
_SINCE_1970 = tuple((10**k, 1e18 / 10**k, 4.1e18 / 10**k) for k in (0, 3, 6, 9))


def _payload_times(times: Sequence[Any]) -> IntArray:
    """Convert times since 1970 in seconds, milliseconds, microseconds or nanoseconds to whole nanoseconds.

    Sensor Logger sends whole nanoseconds. Programs that imitate it send milliseconds or floats. Only floats can be
    seconds, because whole seconds are too coarse for samples.
    """
    with _refusing("the time of a sample cannot be used ({}): send nanoseconds since 1970 as a whole number"):
        found = np.array(times)
        if found.dtype.kind != "f" or not np.isfinite(found).all():
            found = np.array([int(t) for t in times], dtype=np.int64)
        return _nanoseconds(found, _unit_ns(found, is_seconds=found.dtype.kind == "f") or 1)


def _unit_ns(time: Any, is_seconds: bool) -> int | None:
    """Return the nanoseconds in one unit of the given times, if their size shows times since 1970 (2001 to 2100).

    None for other times, and for seconds unless `is_seconds` is true.
    """
    known = time[np.isfinite(time)]
    usual = abs(float(known[len(known) // 2])) if len(known) else 0.0
    units = _SINCE_1970 if is_seconds else _SINCE_1970[:-1]
    return next((unit_ns for unit_ns, low, high in units if low <= usual <= high), None)


def _nanoseconds(time: Any, unit_ns: int) -> IntArray:
    """Return times in whole nanoseconds. A time too large for an int64 becomes one that `_plausible` discards."""
    if unit_ns == 1 and time.dtype.kind != "f":
        return time
    far = limits.MAX_WHOLE_TIME
    is_near = (time > -far / unit_ns) & (time < far / unit_ns)
    near = np.where(is_near, time, 0)
    whole = np.rint(near * float(unit_ns)).astype(np.int64) if time.dtype.kind == "f" else near * unit_ns
    return np.where(is_near, whole, far)


def _floats(values: Any) -> FloatArray:
    with _refusing("values must be numbers, equally many in each sample ({}): send null for an unknown one"):
        return np.array(values, dtype=np.float64)  # null becomes NaN


def _plausible(time: Any, values: FloatArray) -> SensorRows:
    """Return the rows that have a usable time. Values that no sensor gives become NaN."""
    with np.errstate(invalid="ignore"):
        good = (time > -limits.MAX_WHOLE_TIME) & (time < limits.MAX_WHOLE_TIME)
        values = np.where(np.abs(values) < _LARGEST, values, np.nan)
    return SensorRows(time[good], values[good])


def _text(item: Mapping[str, Any], key: str, otherwise: str) -> str:
    """Return the text or integer at a key of a message, or `otherwise`, as a short text that is safe to display."""
    value: Any = item.get(key)
    return printable(value if isinstance(value, str | int) and value != "" else otherwise)[: limits.MAX_NAME_CHARS]


def _whole(item: Mapping[str, Any], key: str) -> int | None:
    value: Any = item.get(key)
    is_number = isinstance(value, int) and not isinstance(value, bool) and abs(value) < _MAX_NUMBER
    return value if is_number else None
