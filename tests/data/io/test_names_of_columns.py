"""Tables whose columns have names that no app is known for: other words, other code pages, a column too few."""

from __future__ import annotations

import gzip
import itertools
from pathlib import Path

import numpy as np
import pytest
from app_files import (
    assert_same_streams,
    axes,
    read_columns,
    refusal,
    table_text,
    write_columns,
    write_folder,
    write_text,
)
from table_cases import BOTH, FORCE, RATE, TIME_S, WALK

from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_guessed, read_mapped
from pdr_filter.data.io.tables.column_mapping import read_mapping
from pdr_filter.data.io.tables.text_sheets import unlike
from pdr_filter.values.errors import RecordingError


@pytest.mark.parametrize("unit", [1.0, np.pi / 180])
@pytest.mark.parametrize("names", ["Rotation %", "rot%", "Rotation % (rad/s)"])
def test_a_rotation_that_averages_out_is_a_gyroscope_also_beside_columns_like_those_of_phyphox(
    tmp_path: Path, names: str, unit: float
) -> None:
    names = names.replace("rad", "deg") if unit < 1 else names
    columns = {"Time (s)": TIME_S} | axes("Acceleration % (m/s^2)", FORCE) | axes(names, RATE / unit)
    recording = read_columns(tmp_path, columns)
    if "(" in names or unit == 1.0:  # a gyroscope that hardly turns gravity shows no degrees
        assert_same_streams(recording, WALK, BOTH, time_s=1e-6, rtol=1e-9)
    assert recording.gyroscope is not None


def turning_phone() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, specific force, angular rate and orientation, as half angles, of a phone that is tilted to and fro."""
    time_s = np.arange(0.0, 30.0, 0.02)
    angle = 0.5 + 0.8 * np.sin(2 * np.pi * time_s / 8)
    still = np.zeros_like(time_s)
    force = 9.81 * np.column_stack([still, np.sin(angle), np.cos(angle)])
    return (
        time_s,
        force,
        np.column_stack([np.gradient(angle, time_s), still, still]),
        np.column_stack([np.sin(angle / 2), still, still]),
    )


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad/s"), (180 / np.pi, "deg/s")])
def test_a_rotation_that_turns_gravity_is_a_rate_and_one_that_does_not_is_an_orientation(
    tmp_path: Path, factor: float, unit: str
) -> None:
    time_s, force, rate, half_angles = turning_phone()
    columns = {"time": time_s} | axes("acc%", force)
    found = read_guessed(write_text(tmp_path / "rate.csv", table_text(columns | axes("rotation_%", factor * rate))))
    assert any(f"rotation_z, {unit}" in line for line in found.guess.evidence)
    np.testing.assert_allclose(found.recording.gyroscope.values, rate, atol=1e-12)
    of_orientation = table_text(columns | axes("rotation_%", factor * half_angles))
    assert read(write_text(tmp_path / "half_angles.csv", of_orientation)).gyroscope is None


def test_a_rotation_in_degrees_is_no_rate(tmp_path: Path) -> None:
    columns = {"time": TIME_S} | axes("acc%", FORCE) | axes("Rotation % (deg)", RATE)
    assert read_columns(tmp_path, columns).gyroscope is None


def test_a_gyroscope_by_its_name_goes_before_a_rotation(tmp_path: Path) -> None:
    columns = {"time": TIME_S} | axes("acc%", FORCE) | axes("rot%", 2 * RATE) | axes("gyro%", RATE)
    assert_same_streams(read_columns(tmp_path, columns), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize(
    ("encoding", "time", "force", "rate"),
    [
        ("cp1251", "Время (с)", "Ускорение % (м/с2)", "Гироскоп % (рад/с)"),  # noqa: RUF001
        ("gbk", "时间", "加速度 % (m/s^2)", "陀螺仪 % (rad/s)"),
        ("shift_jis", "時間", "加速度 % (m/s^2)", "ジャイロ % (rad/s)"),
        ("euc_kr", "시간", "가속도 % (m/s^2)", "자이로 % (rad/s)"),
        ("latin-1", "Zeit", "Beschleunigung % (m/s²)", "Drehrate über % (rad/s)"),
    ],
)
def test_a_header_in_a_code_page_is_read_and_shown_as_it_was_written(
    tmp_path: Path, encoding: str, time: str, force: str, rate: str
) -> None:
    text = table_text({time: TIME_S} | axes(force, FORCE) | axes(rate, RATE), ";", ",")
    found = read_guessed(write_text(tmp_path / "walk.csv", text, encoding))
    assert_same_streams(found.recording, WALK, BOTH, time_s=1e-6, rtol=1e-9)
    assert found.guess.mapping.streams[0].columns == tuple(axes(force, FORCE))


@pytest.mark.parametrize(("unit", "per_s"), [("ms", 1e3), ("us", 1e6), ("s", 1.0)])
def test_a_letter_with_a_unit_is_a_time(tmp_path: Path, unit: str, per_s: float) -> None:
    columns = {f"t_{unit}": TIME_S * per_s} | axes("a%", FORCE) | axes("g%", RATE)
    assert_same_streams(read_columns(tmp_path, columns), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize("name", ["light_walk.csv", "walking speed.csv", "pressure.csv", "position 2.csv"])
def test_columns_that_say_their_sensor_count_more_than_the_name_of_their_file(tmp_path: Path, name: str) -> None:
    for force, rate in (("acc%", "gyro%"), ("a%", "g%")):
        path = write_text(tmp_path / name, table_text({"t": TIME_S} | axes(force, FORCE) | axes(rate, RATE)))
        assert_same_streams(read(path), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize("unknown", ["", "NA", "N/A", "#N/A", "NaN", "null", "None", "-", "--"])
@pytest.mark.parametrize("copies", [1, 30])  # the larger one is parsed by pyarrow, if that is installed
def test_what_programs_write_for_no_value_is_an_unknown_value(tmp_path: Path, unknown: str, copies: int) -> None:
    time_s = np.arange(copies * len(TIME_S)) / 50
    columns = {"t": time_s} | axes("acc%", np.tile(FORCE, (copies, 1))) | axes("gyro%", np.tile(RATE, (copies, 1)))
    names, *rows = table_text(columns).splitlines()
    rows[0::7] = [row.rsplit(",", 3)[0] + f",{unknown},{unknown},{unknown}" for row in rows[0::7]]
    recording = read(write_text(tmp_path / "walk.csv", "\n".join([names, *rows]) + "\n"))
    known = np.arange(len(time_s)) % 7 != 0
    np.testing.assert_array_equal(recording.gyroscope.values, np.tile(RATE, (copies, 1))[known])
    np.testing.assert_array_equal(recording.accelerometer.values, np.tile(FORCE, (copies, 1)))


@pytest.mark.parametrize("name", ["linear_a%", "lin_a%", "user_a%", "lin_acc_%", "LinearAcceleration%", "user_acc_%"])
def test_acceleration_called_linear_gets_the_gravity_of_the_table_or_one_with_a_note(tmp_path: Path, name: str) -> None:
    gravity = np.tile(FORCE.mean(axis=0), (len(FORCE), 1))
    alone = {"t": TIME_S} | axes(name, FORCE - gravity) | axes("g%", RATE)
    note = read(write_text(tmp_path / "alone.csv", table_text(alone))).notes[0]
    assert f"({name.replace('%', 'x')}, " in note
    assert "lacks gravity" in note
    assert note.endswith("record the accelerometer with gravity")
    both = alone | axes("gravity_%", gravity)
    assert_same_streams(read(write_text(tmp_path / "both.csv", table_text(both))), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize("column", ["device", "phone_id", "sensor_id"])
@pytest.mark.parametrize(("first", "second"), [("0", "1"), ("left", "right")])
def test_a_table_of_two_phones_is_refused_with_the_column_that_says_so(
    tmp_path: Path, column: str, first: str, second: str
) -> None:
    columns = {"t": TIME_S} | axes("acc%", FORCE) | axes("gyro%", RATE)
    names, *rows = table_text(columns).splitlines()
    later = table_text({**columns, "t": TIME_S + 0.004}).splitlines()[1:]
    for others in (later, rows):  # between the times of the first, and at them
        pairs = [f"{a},{first}\n{b},{second}" for a, b in zip(rows, others, strict=True)]
        message = refusal(write_text(tmp_path / "walk.csv", "\n".join([f"{names},{column}", *pairs]) + "\n"))
        assert f"walk.csv: column '{column}' has 2 values ({first}, {second})" in message
        assert "write the rows of each into a file of its own" in message
    for unknown in (first, "", "-", f"{first} "):
        said = itertools.cycle((first, unknown))
        one = "\n".join([f"{names},{column}", *(f"{row},{text}" for row, text in zip(rows, said, strict=False))]) + "\n"
        assert_same_streams(read(write_text(tmp_path / "one.csv", one)), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize(
    ("force", "rate"), [("accelerazione_%", "giroscopio_%"), ("aceleraci\u00f3n %", "giroscopio %"), ("a%", "gyro_%")]
)
def test_sensors_are_known_by_their_names_without_units_whatever_the_file_is_called(
    tmp_path: Path, force: str, rate: str
) -> None:
    for name in ("walk.csv", "gyro walk.csv"):
        path = write_text(tmp_path / name, table_text({"tempo": TIME_S} | axes(force, FORCE) | axes(rate, RATE)))
        assert_same_streams(read(path), WALK, BOTH, 1e-6, 1e-9)


def test_letters_of_the_same_sensor_as_another_column_are_what_the_file_is_called(tmp_path: Path) -> None:
    force = {"t": TIME_S} | axes("a%", FORCE)
    gravity = {"t": TIME_S} | axes("g%", np.tile(FORCE.mean(axis=0), (len(FORCE), 1))) | axes("gyro_%", RATE)
    files = {"Accelerometer.csv": table_text(force), "Gravity.csv": table_text(gravity)}
    assert_same_streams(read(write_folder(tmp_path / "walk", files)), WALK, BOTH, 1e-6, 1e-9)


@pytest.mark.parametrize("line", ["Average,0,0,9.8,0,0,0", '"1,000.2",0,0,9.8,0,0,0'])
def test_a_line_that_is_no_sample_is_refused_with_what_to_do(tmp_path: Path, line: str) -> None:
    columns = {"t": TIME_S} | axes("acc%", FORCE) | axes("gyro%", RATE)
    message = refusal(write_text(tmp_path / "walk.csv", table_text(columns) + line + "\n"))
    assert f"walk.csv, line {len(TIME_S) + 2}, column t: " in message
    assert "no mark between thousands" in message
    assert "take out lines that are no samples" in message


def test_an_accelerometer_under_unknown_names_is_asked_for_by_those_names(tmp_path: Path) -> None:
    message = refusal(write_columns(tmp_path, {"t": TIME_S}, axes("f%", FORCE), axes("w%", RATE)))
    assert "no accelerometer (sensors seen: gyroscope)" in message
    assert "among fx, fy, fz, give a mapping" in message


def test_of_several_tables_that_without_a_time_is_named(tmp_path: Path) -> None:
    files = {"Accelerometer.csv": {"time": TIME_S} | axes("%", FORCE), "Gyroscope.csv": axes("%", RATE)}
    path = write_folder(tmp_path / "walk", {name: table_text(columns) for name, columns in files.items()})
    assert "Gyroscope.csv: there is no column of times (columns: x, y, z)" in refusal(path)
    mapping = tmp_path / "map.toml"
    mapping.write_text('[time]\ncolumn = "time"\n[accelerometer]\ncolumns = ["ax", "ay", "az"]\n')
    with pytest.raises(RecordingError, match="columns ax, ay, az are in 0 tables; correct them"):
        read_mapped(path, read_mapping(mapping))


def test_an_axis_without_values_is_not_taken_for_an_acceleration_without_gravity(tmp_path: Path) -> None:
    message = refusal(write_columns(tmp_path, {"time": TIME_S}, axes("a% (m/s^2)", FORCE * [1.0, 1.0, np.nan])))
    assert "no row has all values of ax (m/s^2), ay (m/s^2), az (m/s^2)" in message


@pytest.mark.parametrize(
    ("rows", "lacks"),
    [("", "a line of numbers for each sample, two or more"), ("0.0,0.1,0.2,9.8,0,0,0\n", "only 1 samples")],
)
def test_a_table_of_less_than_two_samples_is_refused_with_what_it_lacks(tmp_path: Path, rows: str, lacks: str) -> None:
    path = write_text(tmp_path / "walk.csv", "time,ax,ay,az,gx,gy,gz\n" + rows)
    assert lacks in refusal(path)


def test_nothing_in_a_gz_is_called_empty(tmp_path: Path) -> None:
    (tmp_path / "walk.csv.gz").write_bytes(gzip.compress(b""))
    assert "the file in it is empty (0 bytes)" in refusal(tmp_path / "walk.csv.gz")


def test_column_names_become_unique_although_a_name_already_ends_with_a_number() -> None:
    assert unlike(["a #2", "a", "a", ""]) == ("a #2", "a", "a #3", "column 4")
