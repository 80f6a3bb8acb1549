"""MATLAB files: timetables of MATLAB Mobile, plain columns, and files that claim more than they hold."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from app_files import a_walk, assert_same_streams, on_one_clock, refusal, write_mat

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.detection import detect
from pdr_filter.data.io.formats import read

WALK = on_one_clock(a_walk(50.0))
CODES = {"f8": (9, 6), "u1": (2, 9), "u4": (6, 13)}  # of the numbers, and of the array that holds them


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + b"\x00" * (-len(content) % 8)


def matrix(of: int, shape: tuple[int, ...], *parts: bytes, name: str = "") -> bytes:
    head = element(6, struct.pack("<II", of, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, name.encode()) + b"".join(parts))


def numbers(values: np.ndarray, kind: str = "f8", name: str = "") -> bytes:
    values = np.atleast_2d(np.asarray(values, kind).T).T
    code, of = CODES[kind]
    return matrix(of, values.shape, element(code, values.tobytes(order="F")), name=name)


def text(value: str) -> bytes:
    return matrix(4, (1, len(value)), element(16, value.encode()))


def cells(*values: bytes) -> bytes:
    return matrix(1, (1, len(values)), *values)


def structure(**fields: bytes) -> bytes:
    names = b"".join(name.encode().ljust(32, b"\x00") for name in fields)
    return matrix(2, (1, 1), element(5, struct.pack("<i", 32)), element(1, names), *fields.values())


def opaque(name: str, kind: str, value: bytes) -> bytes:
    parts = element(6, struct.pack("<II", 17, 0)) + b"".join(element(1, s.encode()) for s in (name, "MCOS", kind))
    return element(14, parts + value)


def object_of(number: int, kind: int) -> bytes:
    return numbers(np.array([0xDD000000, 2, 1, 1, number, kind]), "u4")


def words(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}I", *values)


def timetables(tables: dict[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """A file with a timetable for each name: times in ms since 1970, and three columns."""
    names = b"any\x00data\x00datetime\x00timetable\x00".ljust(32, b"\x00")
    heap: list[bytes] = []
    objects, first, second = words(*[0] * 6), b"", b""
    for i, (times_ms, values) in enumerate(tables.values()):
        data = cells(*(numbers(column) for column in values.T))
        times = object_of(2 * i + 2, 1)
        heap += [numbers(times_ms)]
        heap += [structure(data=data, varNames=cells(*map(text, "XYZ")), rowTimes=times)]
        first += words(1, 1, 1, 2 * i + 1)
        second += words(1, 2, 1, 2 * i)
        objects += words(2, 0, 0, i + 1, 0, 0) + words(1, 0, 0, 0, i + 1, 0)
    classes = words(0, 0, 0, 0) + words(0, 3, 0, 0) + words(0, 4, 0, 0)
    regions = [classes, words(0, 0) + first, objects, words(0, 0) + second, words(0, 0)]
    at = [40 + len(names)]
    for region in regions:
        at.append(at[-1] + len(region))
    meta = words(4, 4, *at[:6], 0, 0) + names + b"".join(regions)
    wrapper = cells(numbers(np.frombuffer(meta, "u1"), "u1"), numbers(np.empty(0)), *heap)
    subsystem = b"\x00\x01IM\x00\x00\x00\x00" + structure(MCOS=opaque("", "FileWrapper__", wrapper))
    variables = b"".join(opaque(name, "timetable", object_of(2 * i + 1, 2)) for i, name in enumerate(tables))
    last = numbers(np.frombuffer(subsystem, "u1"), "u1")
    return head(128 + len(variables)) + variables + last


def head(objects_at: int = 0) -> bytes:
    return b"MATLAB 5.0 MAT-file, made by a test".ljust(116) + struct.pack("<q", objects_at) + b"\x00\x01IM"


def test_timetables_of_matlab_mobile_are_read(tmp_path: Path) -> None:
    at_ms = 1678974717940.0 + 1000 * WALK.accelerometer.time_s
    tables = {
        "Acceleration": (at_ms, WALK.accelerometer.values),
        "AngularVelocity": (at_ms, WALK.gyroscope.values),
        "Orientation": (at_ms, 100 + 0 * WALK.gyroscope.values),
    }
    (tmp_path / "walk.mat").write_bytes(timetables(tables))
    recording = read(tmp_path / "walk.mat")
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-6, rtol=0)
    assert "MATLAB Mobile" in reading_report(recording).source
    assert recording.epoch_s is not None
    assert abs(recording.epoch_s - 1678974717.94) < 1e-3


def test_plain_columns_are_read(tmp_path: Path) -> None:
    recording = read(write_mat(tmp_path / "walk.mat", WALK))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-9, rtol=0)


def test_version_7_3_is_refused_with_how_to_save_it(tmp_path: Path) -> None:
    (tmp_path / "walk.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF")
    assert detect(tmp_path / "walk.mat") == "table"
    assert "save(..., '-v7')" in refusal(tmp_path / "walk.mat")


def test_a_variable_that_unpacks_to_more_than_sensors_can_is_refused(tmp_path: Path) -> None:
    bomb = zlib.compress(element(14, b"\x00" * (64 << 20)), 9)
    (tmp_path / "walk.mat").write_bytes(head() + struct.pack("<II", 15, len(bomb)) + bomb)
    assert "unpacks to more" in refusal(tmp_path / "walk.mat")


def test_an_array_that_claims_more_than_is_there_is_refused(tmp_path: Path) -> None:
    claimed = matrix(6, (2**30, 2**10), element(9, b"\x00" * 80), name="acc")
    (tmp_path / "walk.mat").write_bytes(head() + claimed)
    assert "damaged" in refusal(tmp_path / "walk.mat")


def test_variables_within_each_other_without_end_are_refused(tmp_path: Path) -> None:
    inner = cells()
    for _ in range(100):
        inner = cells(inner)
    (tmp_path / "walk.mat").write_bytes(head() + inner)
    assert "damaged" in refusal(tmp_path / "walk.mat")
