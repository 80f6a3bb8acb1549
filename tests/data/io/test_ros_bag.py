"""ROS 2 bags: topics that say part of it, folders of a bag, other types, and files that claim more than they hold."""

from __future__ import annotations

import sqlite3
import struct
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from app_files import (
    T0_NS,
    a_walk,
    assert_same_streams,
    cdr_header,
    imu_messages,
    on_one_clock,
    refusal,
    write_db3,
    write_folder,
    write_mcap,
)

from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples

WALK = on_one_clock(a_walk(50.0))


def add_topic(path: Path, number: int, name: str, kind: str, messages: list[tuple[int, bytes]]) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", (number, name, kind))
        rows = [(number, *message) for message in messages]
        connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    connection.close()


def test_what_a_topic_leaves_at_zero_is_taken_from_another(tmp_path: Path) -> None:
    nothing = Samples(WALK.gyroscope.time_s, 0 * WALK.gyroscope.values)
    path = write_db3(tmp_path / "bag.db3", imu_messages(replace(WALK, gyroscope=nothing)))
    add_topic(
        path, 2, "/gyro", "sensor_msgs/msg/Imu", imu_messages(replace(WALK, accelerometer=nothing), "other_frame")
    )
    assert_same_streams(read(path), WALK, "accelerometer gyroscope", time_s=1e-9, rtol=0)


def test_magnetic_field_pressure_and_place_are_read_in_their_units(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "bag.db3", imu_messages(WALK))
    begin = b"\x00\x01\x00\x00" + cdr_header(T0_NS)
    field = begin + struct.pack("<12d", 20e-6, 5e-6, -43e-6, *[0.0] * 9)
    pressure = begin + struct.pack("<2d", 101325.0, 0.0)
    header = begin[: 4 + 12 + 4]  # the name of the frame ends where two words of status may begin
    place = (
        header + struct.pack("<bxH4x", 0, 1) + struct.pack("<12d", 48.1, 11.5, 500.0, 9.0, 0, 0, 0, 9.0, 0, 0, 0, 25.0)
    )
    kinds = {"MagneticField": field, "FluidPressure": pressure, "NavSatFix": place}
    for i, (kind, content) in enumerate(kinds.items(), 2):
        add_topic(path, i, f"/{kind}", f"sensor_msgs/msg/{kind}", [(T0_NS, content)])
    recording = read(path)
    np.testing.assert_allclose(recording.magnetometer.values, [[20, 5, -43]])
    np.testing.assert_allclose(recording.barometer.values, [[1013.25]])
    np.testing.assert_allclose(recording.location.values, [[48.1, 11.5, 500.0, 3.0]])


def test_the_folder_of_a_bag_is_one_recording(tmp_path: Path) -> None:
    messages = imu_messages(WALK)
    folder = write_folder(tmp_path / "bag", {"metadata.yaml": "rosbag2_bagfile_information:\n"})
    write_db3(folder / "bag_0.db3", messages[:500])
    write_db3(folder / "bag_1.db3", messages[500:])
    assert recordings_in(tmp_path) == [folder]
    assert_same_streams(read(folder), WALK, "accelerometer gyroscope", time_s=1e-9, rtol=0)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_that_unpacks_to_more_than_it_says_is_refused(tmp_path: Path, compression: str) -> None:
    pytest.importorskip("mcap")
    from mcap.stream_reader import StreamReader
    from mcap.writer import CompressionType, Writer

    kinds = {"lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 28, compression=kinds[compression])
        writer.start()
        channel = writer.register_channel("/imu", "cdr", writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b""))
        writer.add_message(channel, T0_NS, b"\x00" * (100 << 20), T0_NS)
        writer.finish()
    assert "very compressible messages or is damaged" in refusal(path)
    content = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunk = next(r for r in StreamReader(file, emit_chunks=True).records if type(r).__name__ == "Chunk")
    claimed = struct.pack("<Q", chunk.uncompressed_size)
    at = content.index(claimed)
    content[at : at + 8] = struct.pack("<Q", 1000)
    path.write_bytes(content)
    assert "damaged" in refusal(path)


def test_an_mcap_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    path = write_mcap(tmp_path / "bag.mcap", imu_messages(WALK))
    path.write_bytes(path.read_bytes()[:-3000])
    assert "damaged or cut off" in refusal(path)


def test_a_database_that_computes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.sqlite"
    endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x FROM n"
    with sqlite3.connect(path) as connection:
        connection.execute(f"CREATE VIEW Accelerometer AS {endless}")
        connection.execute("CREATE TABLE Gyroscope(time, x, y, z AS (hex(zeroblob(x))))")
        connection.execute("INSERT INTO Gyroscope(time, x, y) VALUES (1, 200000000, 3)")
    connection.close()
    begin = process_time()
    assert "no table has the name and the columns" in refusal(path)  # neither the view nor the column that is computed
    assert process_time() - begin < 3.0
