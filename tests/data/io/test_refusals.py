"""Refusals name the file, the column or the argument, then the value, and end with a remedy."""

from __future__ import annotations

import ast
import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from app_files import (
    axes,
    imu_messages,
    sensor_logger_files,
    table_text,
    wall_clock,
    write_columns,
    write_db3,
    write_folder,
    write_mcap,
    write_text,
    write_zip,
)
from table_cases import FORCE, RATE, TIME_S, WALK

import pdr_filter
from pdr_filter.data.io.fix_files import fixes_of_file, loop_closures_of_file
from pdr_filter.data.io.formats import read
from pdr_filter.values import STANDARD_GRAVITY_MPS2

N = len(TIME_S)
WITHOUT_Z = (FORCE - FORCE.mean(axis=0)) * [1.0, 1.0, 0.0]


def walk_csv(folder: Path, *without: str, **changes: np.ndarray | list[str]) -> Path:
    columns: dict[str, np.ndarray | list[str]] = {"time": TIME_S} | axes("acc_%", FORCE) | axes("gyro_%", RATE)
    columns |= changes
    return write_text(folder / "walk.csv", table_text({k: v for k, v in columns.items() if k not in without}))


def digits(change: Callable[[str], str]) -> Callable[[Path], Path]:
    """Return a function that writes the walk with changed rows below its names."""
    head, _, rows = table_text({"time": TIME_S} | axes("acc_%", FORCE) | axes("gyro_%", RATE)).partition("\n")
    return lambda folder: write_text(folder / "walk.csv", f"{head}\n{change(rows)}")


def scaled(factor: float, force: np.ndarray = FORCE) -> dict[str, np.ndarray]:
    return axes("acc_%", force * factor)


def logger(folder: Path, *without: str) -> Path:
    return write_folder(folder / "walk", {k: v for k, v in sensor_logger_files(WALK).items() if k not in without})


def sqlite(folder: Path) -> Path:
    return write_text(folder / "walk.db", "SQLite format 3\x00 and nothing else")


def cut_zip(folder: Path) -> Path:
    whole = write_zip(folder / "walk.zip", sensor_logger_files(WALK)).read_bytes()
    (folder / "walk.zip").write_bytes(whole[: len(whole) // 2])
    return folder / "walk.zip"


def cut_gzip(folder: Path) -> Path:
    (folder / "walk.csv.gz").write_bytes(gzip.compress(walk_csv(folder).read_bytes())[:5000])
    return folder / "walk.csv.gz"


def rounded(folder: Path) -> Path:
    return walk_csv(folder, time=[text[12:20] for text in wall_clock(TIME_S)])


# File to read, and three parts of the message in their order: the file or column, the value, the remedy.
REFUSALS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no file": (lambda f: f / "walk.zip", "walk.zip ... no such file ... check the path"),
    "digits of another script": (
        digits(
            lambda rows: rows.translate(
                str.maketrans("0123456789.", "\u06f0\u06f1\u06f2\u06f3\u06f4\u06f5\u06f6\u06f7\u06f8\u06f9\u066b")
            )
        ),
        "walk.csv: line 2, column time: '\u06f0\u066b\u06f0' ... digits 0 to 9",
    ),
    "exponents of Fortran": (
        digits(lambda rows: rows.replace(",", "D+00,").replace("\n", "D+00\n")),
        "walk.csv: line 2, column time: '0.0D+00' ... e before an exponent",
    ),
    "an axis that is constant": (
        lambda f: write_text(f / "walk.csv", table_text({"time": TIME_S} | axes("acc_% (m/s^2)", WITHOUT_Z))),
        "walk.csv ... acc_z (m/s^2): z is 0 in all rows ... record all three axes",
    ),
    "an axis that is constant, without a unit": (
        lambda f: walk_csv(f, **axes("acc_%", WITHOUT_Z)),
        "walk.csv ... lacks gravity: z is 0 in all rows ... export the accelerometer itself",
    ),
    "an empty file": (lambda f: write_text(f / "walk.csv", ""), "walk.csv ... 0 bytes ... export the recording again"),
    "a cut zip": (cut_zip, "walk.zip ... cut off ... copy or export it again"),
    "a cut gzip": (cut_gzip, "walk.csv.gz ... damaged ( ... export the recording again"),
    "a database that is none": (sqlite, "walk.db ... database ... export it again"),
    "a bag without messages of a sensor": (
        lambda f: write_mcap(f / "walk.mcap", imu_messages(WALK), "std_msgs/msg/Empty"),
        "walk.mcap ... std_msgs/msg/Empty ... record its topic",
    ),
    "a message that is cut": (
        lambda f: write_db3(f / "walk.db3", [(at_ns, content[:40]) for at_ns, content in imu_messages(WALK)]),
        "walk.db3 ... sensor_msgs/msg/Imu is damaged ... record it again",
    ),
    "a message of another age": (
        lambda f: write_db3(
            f / "walk.db3", [(7 * 10**18, content[:4] + bytes(8) + content[12:]) for _, content in imu_messages(WALK)]
        ),
        "walk.db3 ... has the time 7000000000000000000 ns ... stamp it with ns since 1970",
    ),
    "sensors without an accelerometer": (
        lambda f: walk_csv(f, "acc_x", "acc_y", "acc_z"),
        "walk.csv ... sensors seen: gyroscope ... record it and export again",
    ),
    "one axis": (lambda f: walk_csv(f, "acc_z"), "walk.csv ... no column for z ... export all three axes"),
    "acceleration without gravity": (
        lambda f: walk_csv(f, **scaled(1.0, FORCE - FORCE.mean(axis=0))),
        "walk.csv ... lacks gravity ... export the accelerometer itself",
    ),
    "an app's recording without an accelerometer": (
        lambda f: logger(f, "TotalAcceleration.csv"),
        "walk ... found: Gyroscope, Magnetometer ... record Accelerometer and Gravity",
    ),
    "gravity alone": (
        lambda f: write_columns(f, {"time": TIME_S}, axes("gravity_%", FORCE)),
        "walk.csv ... of gravity alone (gravity_x ... export the accelerometer itself",
    ),
    "a unit that is not known": (
        lambda f: write_columns(f, {"time": TIME_S}, axes("acc_% [furlong]", FORCE)),
        "column 'acc_x [furlong]' ... 'furlong' ... write one of m/s^2",
    ),
    "g under the name of m/s2": (
        lambda f: write_columns(f, {"time": TIME_S}, axes("acc_% (m/s2)", FORCE / 9.8)),
        "accelerometer ... median |a| is 0.9 ... multiply by 9.80665",
    ),
    "degrees under the name of radians": (
        lambda f: write_text(
            f / "walk.csv",
            table_text({"time": TIME_S} | axes("acc_%", FORCE) | axes("gyro_% (rad/s)", np.degrees(RATE) + 20.0)),
        ),
        "gyroscope ... median angular rate is ... multiply x, y and z by pi/180",
    ),
    "g of a platform that is not known": (
        lambda f: walk_csv(f, **scaled(1 / STANDARD_GRAVITY_MPS2)),
        "walk.csv ... acceleration in g, and nothing shows its sign ... --platform ios",
    ),
    "no platform in the metadata": (
        lambda f: write_folder(f / "walk", sensor_logger_files(WALK, "ios") | {"Metadata.csv": "platform\nbeos\n"}),
        "Metadata ... found 'beos' ... --platform ios",
    ),
    "slow samples": (
        lambda f: walk_csv(f, time=TIME_S * 20),
        "time_s ... a rate of 2.5 Hz ... record at 25 Hz or more",
    ),
    "times that were rounded": (rounded, "time_s ... does not increase in ... take the file as the app wrote it"),
    "few samples": (
        lambda f: write_text(f / "walk.csv", table_text({"time": TIME_S[:4]} | axes("acc_%", FORCE[:4]))),
        "accelerometer ... only 4 samples ... record for longer",
    ),
    "no times": (
        lambda f: walk_csv(f, "time"),
        "walk.csv ... no column of times (columns: acc_x ... rate_hz = 50 in place of column",
    ),
    "text among numbers": (
        lambda f: walk_csv(f, acc_y=["far", *map(str, FORCE[1:, 1].tolist())]),
        "column acc_y ... 'far' is not a number ... use '.' as decimal point",
    ),
    "several recordings": (
        lambda f: write_folder(f / "walks", {f"{n}.csv": walk_csv(f).read_text() for n in ("a", "b")}),
        "walks ... holds 2 recordings (a.csv, b.csv) ... read one, such as",
    ),
}


ARGUMENTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "format": (lambda f: read(walk_csv(f), format="excel"), "format ... 'excel' ... give one of own"),
    "platform": (lambda f: read(walk_csv(f), platform="beos"), "platform ... 'beos' ... give one of ios, android"),
    "a platform that the metadata contradict": (
        lambda f: read(logger(f), platform="ios"),
        "Metadata ... says android ... leave platform out",
    ),
    "fixes": (
        lambda f: fixes_of_file(write_text(f / "fixes.csv", "time_s,east_m,north_m,std_m\n1,2,3,-4\n")),
        "fixes.csv, line 2 ... std_m is -4 ... write a positive number",
    ),
    "a storey between two storeys": (
        lambda f: fixes_of_file(write_text(f / "fixes.csv", "time_s,east_m,north_m,floor\n1,2,3,0.5\n")),
        "fixes.csv, line 2 ... floor is 0.5 ... write the number of the storey",
    ),
    "a storey beyond all buildings": (
        lambda f: fixes_of_file(write_text(f / "fixes.csv", "time_s,east_m,north_m,floor\n1,2,3,1e29\n")),
        "fixes.csv, line 2 ... floor is 1e+29 ... write the number of the storey",
    ),
    "loop closures": (
        lambda f: loop_closures_of_file(write_text(f / "loops.csv", "first_s,second_s\n7,5\n")),
        "loops.csv, line 2 ... 7 and 5 ... exchange the two",
    ),
    "a loop closure without duration": (
        lambda f: loop_closures_of_file(write_text(f / "loops.csv", "first_s,second_s\n7,7\n")),
        "loops.csv, line 2 ... 7 and 7 ... correct one of them",
    ),
}


def reading(make: Callable[[Path], Path]) -> Callable[[Path], object]:
    return lambda folder: read(make(folder))


CALLS = {kind: (reading(make), words) for kind, (make, words) in REFUSALS.items()} | ARGUMENTS


@pytest.mark.parametrize("kind", CALLS)
def test_a_refusal_names_the_file_or_argument_then_the_value_then_a_remedy(tmp_path: Path, kind: str) -> None:
    call, words = CALLS[kind]
    with pytest.raises(ValueError) as refused:
        call(tmp_path)
    message, at = str(refused.value), -1
    for word in words.split(" ... "):
        at = message.find(word, at + 1)
        assert at >= 0, (word, message)


def literals(node: ast.expr) -> str:
    """The constant parts of an expression."""
    return "".join(n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str))


def test_the_text_of_each_refusal_of_a_reader_has_a_remedy_behind_a_semicolon() -> None:
    package = Path(pdr_filter.__file__).parent
    without: list[str] = []
    for path in [*sorted((package / "data" / "io").rglob("*.py")), package / "values" / "safe_files.py"]:
        for node in ast.walk(ast.parse(path.read_text())):
            is_refusal = (
                isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and "RecordingError" in node.func.id
            )
            if is_refusal and node.args and len(text := literals(node.args[0])) > 12 and "; " not in text:
                without.append(f"{path.name}:{node.lineno}: {text}")
    assert not without
