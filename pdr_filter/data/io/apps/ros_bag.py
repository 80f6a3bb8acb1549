"""ROS 2 bags with `sensor_msgs/Imu`: MCAP files (`pip install "pdr_filter[ros]"`), SQLite files, folders of them.

Messages are CDR, of which these types have a fixed layout behind the name of their frame (docs of common_interfaces).
They are decoded here: rosbags needs a folder on the disk, unpacks chunks of any size and takes three times as long.
By REP 145 an accelerometer reads +9.81 upwards at rest, as on Android; a magnetic field is in T, a pressure in Pa.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.files.archive import Members, most_unpacked, open_members
from pdr_filter.data.io.files.sqlite_file import SQLITE, open_database
from pdr_filter.data.io.text_table import finite
from pdr_filter.values import FloatArray, IntArray, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

MCAP = b"\x89MCAP0\r\n"
_BAGS = (".mcap", ".db3")
_MAX_TOPICS = 1000
# Errors of the library at damaged bytes, besides its own.
_MCAP_ERRORS = (struct.error, ValueError, EOFError, LookupError, OverflowError, TypeError, AttributeError)
IMU, FIELD, PRESSURE, PLACE = (
    f"sensor_msgs/msg/{name}" for name in ("Imu", "MagneticField", "FluidPressure", "NavSatFix")
)


def is_ros_bag(head: bytes) -> bool:
    """Return True if a file begins like a ROS bag, judged by its first bytes."""
    return head.startswith(MCAP) or (head.startswith(SQLITE) and b"topics" in head and b"messages" in head)


def is_bag(members: Members) -> bool:
    """Return True if a zip file or folder contains the files of a ROS bag."""
    return any(is_ros_bag(members.head(name)) for name in _bags(members))


def read_ros_bag(path: str | Path) -> Recording:
    """Return the recording in a bag: an MCAP or SQLite file, or a zip or folder of them.

    RecordingError if it has no `sensor_msgs/msg/Imu` with an acceleration.
    """
    path = Path(path)
    parsed = Parsed(path, "ROS 2 bag")
    with open_members(path) as members:
        topics: dict[str, _Topic] = {}
        seen: dict[str, str] = {}
        for name in _bags(members) or list(members.names[:1]):
            messages = _of_mcap if members.head(name).startswith(MCAP) else _of_database
            for topic, kind, received_ns, content in messages(members, name, seen):
                if topic not in topics and len(topics) >= _MAX_TOPICS:
                    raise RecordingError(f"{members.where(name)}: more than {_MAX_TOPICS} topics; cut the bag")
                topics.setdefault(topic, _Topic(kind)).add(received_ns, content, members.where(name))
    _fill(parsed, topics, seen)
    return parsed.recording()


class _Topic:
    """Messages of one topic of a ROS bag: the time of each message in ns, and the numerical values in it."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._ns: list[int] = []
        self._rows: list[tuple[float, ...]] = []

    def add(self, received_ns: int, content: bytes, where: str) -> None:
        """Add a message with its own time, or with the time of its arrival if it has none.

        RecordingError if it is damaged or its time absurd, or for too many messages.
        """
        if len(self._ns) >= limits.MAX_ARRAY_ROWS:
            raise RecordingError(f"{where}: more than {limits.MAX_ARRAY_ROWS} messages; cut the bag")
        try:
            at_ns, row = _decoded(self.kind, content)
        except (struct.error, ValueError, IndexError) as error:
            raise RecordingError(f"{where}: a message of {self.kind} is damaged ({error}); record it again") from error
        self._ns.append(at_ns or received_ns)
        if abs(self._ns[-1]) >= limits.MAX_WHOLE_TIME:
            raise RecordingError(f"{where}: {self.kind} has the time {self._ns[-1]} ns; stamp it with ns since 1970")
        self._rows.append(row)

    @property
    def ns(self) -> IntArray:
        return np.array(self._ns, dtype=np.int64)

    @property
    def values(self) -> FloatArray:
        return finite(np.array(self._rows, dtype=float).reshape(len(self._rows), -1), self.kind, [])


def _fill(parsed: Parsed, topics: dict[str, _Topic], seen: dict[str, str]) -> None:
    """Store the topic with the most messages as each stream of `parsed`.

    Imu values that are all zero, and an attitude without unit quaternions, are left out. `seen` has the type of every
    topic, for messages. RecordingError without an acceleration.
    """
    imus = {name: topic for name, topic in topics.items() if topic.kind == IMU}
    parts = {"accelerometer": slice(7, 10), "gyroscope": slice(4, 7), "attitude": slice(0, 4)}
    chosen: dict[str, tuple[str, IntArray, FloatArray]] = {}
    for stream, part in parts.items():
        for name, topic in imus.items():
            values = topic.values[:, part]
            # Drivers leave unknown values at zero.
            if np.any(values != 0) and (stream not in chosen or len(values) > len(chosen[stream][2])):
                chosen[stream] = (name, topic.ns, values)
    if "accelerometer" not in chosen:
        listed = ", ".join(f"{name} ({kind})" for name, kind in list(seen.items())[:8]) or "none"
        raise RecordingError(f"{parsed.path}: no {IMU} with an acceleration (topics: {listed}); record its topic")
    for stream, kind, factor in (("magnetometer", FIELD, 1e6), ("barometer", PRESSURE, 0.01), ("location", PLACE, 1.0)):
        of_kind = {name: topic for name, topic in topics.items() if topic.kind == kind}
        if of_kind:
            name = max(of_kind, key=lambda name: len(of_kind[name].values))
            chosen[stream] = (name, of_kind[name].ns, of_kind[name].values * factor)
    used = chosen.get("attitude")
    if used is not None:
        norm = np.linalg.norm(used[2], axis=1)
        if not limits.QUATERNION_NORM_RANGE[0] < np.median(norm) < limits.QUATERNION_NORM_RANGE[1]:
            del chosen["attitude"]
        else:
            chosen["attitude"] = (used[0], used[1], used[2][:, [3, 0, 1, 2]])  # xyzw there
    zero_ns = int(chosen["accelerometer"][1][0])
    for stream, (name, ns, values) in chosen.items():
        parsed.streams[stream] = ((ns - zero_ns).astype(np.float64) * 1e-9, values)
        parsed.found.append(f"{stream}: {name}, units of ROS, Android's sign (REP 145)")
    others = sorted(set(imus) - {name for name, _, _ in chosen.values()})
    if others:
        parsed.notes.append(f"left out: {', '.join(others)[:200]}")
    parsed.clock = f"stamps of the messages; time zero is {zero_ns} ns"
    parsed.meta["epoch_ns"] = zero_ns


def _decoded(kind: str, content: bytes) -> tuple[int, tuple[float, ...]]:
    """Return the time stamp of a message in ns, and the numerical values of the message.

    Imu: quaternion (x, y, z, w), angular rate, acceleration. Location: latitude, longitude, altitude, accuracy in m or
    NaN. ValueError for a message that is too short.
    """
    if len(content) < 16:
        raise ValueError("too short")
    order = "<" if content[1] & 1 else ">"
    body = memoryview(content)[4:]  # alignment counts from here
    second, nanosecond, n_name = struct.unpack_from(order + "iII", body, 0)
    at = 12 + n_name
    at_ns = second * 10**9 + nanosecond

    def doubles(n: int, begin: int) -> tuple[float, ...]:
        return struct.unpack_from(f"{order}{n}d", body, -(-begin // 8) * 8)

    if kind == IMU:
        values = doubles(37, at)
        return at_ns, (*values[0:4], *values[13:16], *values[25:28])
    if kind == FIELD:
        return at_ns, doubles(3, at)
    if kind == PRESSURE:
        return at_ns, doubles(1, at)
    # a place: two status words before it, its covariance behind it
    values = doubles(12, -(-(at + 1) // 2) * 2 + 2)
    accuracy_m = float(np.sqrt(max(values[3] + values[7], 0.0) / 2)) or float("nan")
    return at_ns, (*values[:3], accuracy_m)


def _bags(members: Members) -> list[str]:
    return [name for name in members.names if name.lower().endswith(_BAGS)]


Messages = Iterator[tuple[str, str, int, bytes]]  # topic, type, time of arrival in ns, CDR
_KINDS = (IMU, FIELD, PRESSURE, PLACE)


def _of_database(members: Members, name: str, seen: dict[str, str]) -> Messages:
    with open_database(members, name) as database:
        if not {"topics", "messages"} <= database.columns.keys():
            raise RecordingError(f"{members.where(name)}: this database has no topics and messages; give a ROS bag")
        topics = {row[0]: (str(row[1]), str(row[2])) for row in database.rows("topics", ("id", "name", "type"))}
        seen |= dict(topics.values())
        for number, (topic, kind) in topics.items():
            if kind in _KINDS and isinstance(number, int):
                for received_ns, content in database.rows("messages", ("timestamp", "data"), ("topic_id", number)):
                    if not isinstance(received_ns, int) or not isinstance(content, bytes):
                        raise RecordingError(f"{members.where(name)}: a message lacks time or content; record it again")
                    yield topic, kind, received_ns, content


def _of_mcap(members: Members, name: str, seen: dict[str, str]) -> Messages:
    where = members.where(name)
    try:
        from mcap.exceptions import McapError
        from mcap.records import Channel, Chunk, Message, Schema
        from mcap.stream_reader import StreamReader, breakup_chunk
    except ImportError as error:
        raise RecordingError(f'{where}: an MCAP file needs a package; install "pdr_filter[ros]"') from error
    content = members.whole(name, limits.MAX_UNPACKED_BYTES)
    left = most_unpacked(len(content))
    schemas: dict[int, str] = {}
    topics: dict[int, tuple[str, str]] = {}

    def records() -> Iterator[Any]:
        nonlocal left
        for record in StreamReader(io.BytesIO(content), emit_chunks=True, record_size_limit=len(content)).records:
            if isinstance(record, Chunk):
                unpacked = _unpacked(record.compression, record.data, record.uncompressed_size, left, where)
                left -= len(unpacked)
                yield from breakup_chunk(replace(record, compression="", data=unpacked))
            else:
                yield record

    try:
        for record in records():
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                kind = schemas.get(record.schema_id, "")
                encoding = record.message_encoding
                seen[record.topic] = kind if encoding == "cdr" else f"{kind} in {encoding}"
                if kind in _KINDS and encoding == "cdr":
                    topics[record.id] = (record.topic, kind)
            elif isinstance(record, Message) and record.channel_id in topics:
                yield *topics[record.channel_id], record.log_time, record.data
    except (McapError, *_MCAP_ERRORS) as error:
        if isinstance(error, RecordingError):
            raise
        words = str(error)[:100] or type(error).__name__
        raise RecordingError(f"{where}: this MCAP file is damaged or cut off ({words}); copy it again") from error


def _unpacked(compression: str, data: bytes, claimed: int, most: int, where: str) -> bytes:
    """Return the unpacked records of a chunk, which states their size as `claimed` bytes.

    RecordingError if that is over `most`, or for an unknown compression. ValueError for another size.
    """
    if not compression:
        return data
    if claimed > most:
        raise RecordingError(
            f"{where}: a compressed part states {claimed} bytes, but only {max(most, 0)} are left of "
            f"{limits.UNPACKED_FREELY_BYTES // 1024**2} MB or {limits.MAX_COMPRESSION_RATIO} times the size of the "
            "file: it has very compressible messages or is damaged; write it without compression, or record it again"
        )
    try:
        unpack = _UNPACK[compression]
    except KeyError:
        raise RecordingError(f"{where}: compressed with {compression[:20]!r}; use {' or '.join(_UNPACK)}") from None
    try:
        unpacked = unpack(data, claimed + 1)
    except RuntimeError as error:  # raised by lz4
        raise ValueError(error) from error
    if len(unpacked) != claimed:
        raise ValueError("a chunk is longer or shorter than it says")
    return unpacked


def _lz4(data: bytes, most: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor().decompress(data, max_length=most)


def _zstd(data: bytes, most: int) -> bytes:
    import zstandard

    try:
        return zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(data).read(most)
    except zstandard.ZstdError as error:
        raise ValueError(error) from error


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {"lz4": _lz4, "zstd": _zstd}
