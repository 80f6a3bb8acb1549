"""Tables of other apps: what their versions, settings and owners change, and the walk that must come back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from app_files import (
    a_walk,
    assert_same_streams,
    axes,
    matlab_mobile_files,
    on_one_clock,
    phyphox_files,
    phyphox_sheets,
    physics_toolbox_text,
    refusal,
    table_text,
    wall_clock,
    write_folder,
    write_zip,
    xlsx_files,
)

from pdr_filter.io import table as tables
from pdr_filter.io.any_table import read_guessed, read_mapped
from pdr_filter.io.describe import reading_report
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.folders import recordings_in
from pdr_filter.io.formats import read
from pdr_filter.io.mapping import read_mapping
from pdr_filter.values import STANDARD_GRAVITY_MPS2

WALK = on_one_clock(a_walk(50.0))
TIME_S, FORCE = WALK.accelerometer.time_s, WALK.accelerometer.values
assert WALK.gyroscope is not None
RATE = WALK.gyroscope.values
GRAVITY = np.tile(FORCE.mean(axis=0), (len(FORCE), 1))
FORCE_G = FORCE / STANDARD_GRAVITY_MPS2
FIELD = np.tile([20.0, 5.0, -43.0], (len(FORCE), 1))

ANDROSENSOR = (
    "ACCELEROMETER % (m/s\u00b2)",
    "GRAVITY % (m/s\u00b2)",
    "LINEAR ACCELERATION % (m/s\u00b2)",
    "GYROSCOPE % (rad/s)",
)


def androsensor(separator: str = ",", decimal: str = ".", first: str = "sep=,") -> str:
    columns: dict[str, np.ndarray | list[str]] = {}
    for name, values in zip(ANDROSENSOR, (FORCE, GRAVITY, FORCE - GRAVITY, RATE), strict=True):
        columns |= {
            key.replace("x", "X").replace("y", "Y").replace("z", "Z"): v for key, v in axes(name, values).items()
        }
    columns["LOCATION Latitude : "] = np.full(len(TIME_S), 12.9)
    columns["LOCATION Longitude : "] = np.full(len(TIME_S), 77.6)
    columns["Time since start in ms "] = TIME_S * 1000
    columns["YYYY-MO-DD HH-MI-SS_SSS"] = ["2018-08-07 18:41:42:677"] * len(TIME_S)
    return f"{first}\n{table_text(columns, separator, decimal)}"


def androsensor_short() -> str:
    names = ("ACCE%", "GRAV%", "LACC%", "GYRO%")
    columns = {}
    for name, values in zip(names, (FORCE, GRAVITY, FORCE - GRAVITY, RATE), strict=True):
        columns |= {key.upper(): column for key, column in axes(name, values).items()}
    return table_text({**columns, "Time since start in ms ": TIME_S * 1000})


def hyperimu(vendor: str, with_time: bool) -> str:
    time = {"timestamp": 1510411143791 + TIME_S * 1000} if with_time else {}
    columns = time | axes(f"{vendor}_Gyroscope.%", RATE) | axes(f"{vendor}_Accelerometer.%", FORCE)
    about = "@ HyperIMU - ianovir - 2017\n@ Date: Sat Nov 11 15:39:03 GMT+01:00 2017, Sampling Time: 20ms\n\n"
    return about + table_text(columns | axes(f"{vendor}_Linear_Acceleration.%", FORCE - GRAVITY))


def sensorlog(separator: str = ",", decimal: str = ".", raw: bool = True) -> str:
    """Apple's sign, in g; a logging time and one for each sensor."""
    columns: dict[str, np.ndarray | list[str]] = {"loggingTime(txt)": ["2020-03-09 13:57:39.500 +0100"] * len(TIME_S)}
    columns["loggingSample(N)"] = np.arange(len(TIME_S)).astype(float)
    columns["locationTimestamp_since1970(s)"] = 1583758659.0 + 0 * TIME_S
    columns["locationLatitude(WGS84)"], columns["locationLongitude(WGS84)"] = 48.1 + 0 * TIME_S, 11.5 + 0 * TIME_S
    if raw:
        columns["accelerometerTimestamp_sinceReboot(s)"] = 63258.25 + TIME_S
        columns |= {k: v for k, v in axes("accelerometerAcceleration%(G)", -FORCE_G).items()}
    columns["motionTimestamp_sinceReboot(s)"] = 63258.25 + TIME_S
    columns |= axes("motionRotationRate%(rad/s)", RATE)
    columns |= axes("motionUserAcceleration%(G)", -(FORCE - GRAVITY) / STANDARD_GRAVITY_MPS2)
    columns |= axes("motionGravity%(G)", -GRAVITY / STANDARD_GRAVITY_MPS2)
    return table_text(
        {k[:-4] + k[-4:].replace("x(", "X(") if "(" in k else k: v for k, v in columns.items()}, separator, decimal
    )


def without_header(*values: np.ndarray, at: np.ndarray = TIME_S) -> str:
    return "".join(" ".join(f"{v:.18e}" for v in row) + "\n" for row in np.column_stack([at, *values]).tolist())


def columns_of(time: str, force: str, rate: str, **more: np.ndarray) -> dict[str, np.ndarray]:
    return {time: TIME_S} | axes(force, FORCE) | axes(rate, RATE) | more


def seconds_and_nanoseconds() -> tuple[list[str], list[str]]:
    ticks = [1_787_923_304_123_456_789 + round(t * 1e9) for t in TIME_S.tolist()]
    return [str(tick // 10**9) for tick in ticks], [str(tick % 10**9) for tick in ticks]


BOTH = "accelerometer gyroscope"
# Of phyphox in other languages: time, acceleration, gyroscope, and the names of their files.
LANGUAGES = {
    "German": "Zeit Beschleunigung Gyroskop Beschleunigung Gyroskop",
    "French": "Temps Acc\u00e9l\u00e9ration Gyroscope Acc\u00e9l\u00e9rom\u00e8tre Gyroscope",
    "Spanish": "Tiempo Aceleraci\u00f3n Giroscopio Aceler\u00f3metro Giroscopio",
    "Japanese": "\u6642\u9593 \u52a0\u901f\u5ea6 \u89d2\u901f\u5ea6 \u52a0\u901f\u5ea6\u8a08 \u89d2\u901f\u5ea6",
}


def phyphox_in(language: str, separator: str = ",", decimal: str = ".") -> dict[str, str]:
    time, force, rate, *files = LANGUAGES[language].split()
    columns = (
        {time + " (s)": TIME_S} | axes(f"{force} % (m/s^2)", FORCE),
        {time + " (s)": TIME_S} | axes(f"{rate} % (rad/s)", RATE),
    )
    return {f"{name}.csv": table_text(c, separator, decimal) for name, c in zip(files, columns, strict=True)}


# Name, files and the sensors that must come back; one file is given by itself, several as a folder and as a zip.
CASES: dict[str, tuple[Callable[[], dict[str, str]], str]] = {
    "Physics Toolbox": (lambda: {"walk.csv": physics_toolbox_text(WALK)}, BOTH),
    "Physics Toolbox, comma": (
        lambda: {"walk.csv": table_text({"time": TIME_S} | axes("gF%", FORCE_G) | {"TgF": FORCE_G[:, 0]}, ";", ",")},
        "accelerometer",
    ),
    "Physics Toolbox, clock": (
        lambda: {
            "w.csv": table_text(
                {"time": [d[12:] for d in wall_clock(TIME_S)]} | axes("gF%", FORCE_G) | axes("B%", FIELD)
            )
        },
        "accelerometer",
    ),
    "AndroSensor": (lambda: {"Sensor_record.csv": androsensor()}, BOTH),
    "AndroSensor, semicolon": (lambda: {"Sensor_record.csv": androsensor(";", ",", "sep=;")}, BOTH),
    "AndroSensor, short names": (lambda: {"data.csv": androsensor_short()}, BOTH),
    "HyperIMU": (lambda: {"HIMU.csv": hyperimu("MPL", True)}, BOTH),
    "HyperIMU, no times": (lambda: {"HIMU.csv": hyperimu("LSM6DSO", False)}, BOTH),
    "HyperIMU, no times, the chip behind the word": (
        lambda: {
            "HIMU.csv": "@ HyperIMU - ianovir\n@ Date:Thu May 21 15:07:17 GMT+02:00 2020, Sampling Rate:20ms\n\n"
            + table_text(axes("lsm6ds3_accelerometer.%", FORCE) | axes("gyroscope_lsm6ds3_c.%", RATE)).replace(
                "\n", "\n\n", 1
            )
        },
        BOTH,
    ),
    "Physics Toolbox, minutes and seconds": (
        lambda: {
            "w.csv": table_text(
                {"tiempo": [d[15:] for d in wall_clock(TIME_S)]} | axes("gF%", FORCE_G) | axes("w%", RATE)
            )
        },
        BOTH,
    ),
    "durations of MATLAB": (
        lambda: {
            "w.csv": table_text({"Time": [f"{t:.6f} sec" for t in TIME_S]} | axes("Acc_%", FORCE) | axes("Gyr_%", RATE))
        },
        BOTH,
    ),
    "SensorLog": (lambda: {"2020-03-09_my_iPhone.csv": sensorlog()}, BOTH),
    "SensorLog, semicolon": (lambda: {"stream.csv": sensorlog(";", ",")}, BOTH),
    "SensorLog, motion only": (lambda: {"stream.csv": sensorlog(raw=False)}, BOTH),
    "MATLAB Mobile": (lambda: matlab_mobile_files(WALK), BOTH),
    "MATLAB Mobile, one sensor": (
        lambda: {"80_steps.csv": matlab_mobile_files(WALK)["Acceleration.csv"]},
        "accelerometer",
    ),
    "SensorLog of a university": (
        lambda: {
            "acc.csv": without_header(FORCE, at=1606391908305.0 + 1000 * TIME_S),
            "gyr.csv": without_header(RATE, at=1606391908305.0 + 1000 * TIME_S),
            "mag.csv": without_header(FIELD, at=1606391908305.0 + 1000 * TIME_S),
            "ref.csv": "1606391908305 566578.7 5932830.4 19.6\n1606391912305 566578.7 5932830.4 19.6\n",
        },
        BOTH,
    ),
    "senslogs": (
        lambda: {
            "record.properties": "[Device]\nModel = Nexus 5\n",
            "accelerometer.txt": without_header(FORCE),
            "gyroscope-calibrated.txt": without_header(RATE),
            "gyroscope.txt": without_header(RATE + 0.1, 0.1 + 0 * RATE),
        },
        BOTH,
    ),
    "logger with a line before the header": (
        lambda: {
            "accelerometer_1.csv": "accelerometer-icm20690,invensense,2020-02-18\n"
            + table_text(
                {"timestamp": 172029867 + 1000 * TIME_S, "accuracy(more=better)": 3 + 0 * TIME_S}
                | axes("acc_%[m/s^2]", FORCE)
            ),
            "gyroscope_2.csv": "gyroscope-icm20690,invensense,2020-02-18\n"
            + table_text({"timestamp": 172029867 + 1000 * TIME_S} | axes("ang_vel_%[rad/s]", RATE)),
        },
        BOTH,
    ),
    "phyphox rewritten by a script": (
        lambda: {
            "Accelerometer.csv": table_text({"t": TIME_S} | axes("%", FORCE)),
            "Gyroscope.csv": table_text({"t": TIME_S} | axes("%", RATE)),
        },
        BOTH,
    ),
    "phyphox, members renamed and added": (
        lambda: (
            {("157_" + name if name.startswith("Acc") else name): text for name, text in phyphox_files(WALK).items()}
            | {
                "steps.csv": "foot,n\nleft,80\nright,77\n",
                "old_accelerometer.csv": table_text({"t": TIME_S[:99]} | axes("%", FORCE[:99])),
            }
        ),
        BOTH,
    ),
    **{f"phyphox, {language}": (lambda word=language: phyphox_in(word), BOTH) for language in LANGUAGES},
    "phyphox, decimal comma": (lambda: phyphox_in("French", ";", ","), BOTH),
    "Physics Toolbox, capitals": (
        lambda: {"W.CSV": table_text({"TIME": TIME_S} | axes("GF%", FORCE_G) | axes("W%", RATE)).upper()},
        BOTH,
    ),
    "ROS, as text": (
        lambda: {
            "imu.csv": table_text(
                {"%time": [str(1_787_923_304_123_456_789 + round(t * 1e9)) for t in TIME_S]}
                | axes("field.orientation.%", 0 * FORCE)
                | axes("field.angular_velocity.%", RATE)
                | axes("field.linear_acceleration.%", FORCE)
            )
        },
        BOTH,
    ),
    **{
        f"ROS, seconds and nanoseconds as {seconds} and {nanoseconds}": (
            lambda s=seconds, ns=nanoseconds: {
                "imu.csv": table_text(
                    {"seq": np.arange(len(TIME_S))}
                    | dict(zip((s, ns), seconds_and_nanoseconds(), strict=True))
                    | axes("angular_velocity.%", RATE)
                    | axes("linear_acceleration.%", FORCE)
                )
            },
            BOTH,
        )
        for seconds, nanoseconds in (("header.stamp.secs", "header.stamp.nsecs"), ("sec", "nanosec"))
    },
    "CoreMotion of any app": (
        lambda: {
            "motion.csv": table_text(
                {"timestamp": 1000 + TIME_S}
                | axes("userAcceleration_%", (GRAVITY - FORCE) / STANDARD_GRAVITY_MPS2)
                | axes("gravity_%", -GRAVITY / STANDARD_GRAVITY_MPS2)
                | axes("rotationRate_%", RATE)
            )
        },
        BOTH,
    ),
    "Spanish AndroSensor": (
        lambda: {
            "s.csv": "sep=;\n"
            + table_text(
                axes("ACELER\u00d3METRO % (m/s\u00b2)", FORCE)
                | axes("ACELERACI\u00d3N LINEAL % (m/s\u00b2)", FORCE - GRAVITY)
                | axes("GIROSCOPIO % (rad/s)", RATE)
                | {"Tiempo desde el inicio en ms ": TIME_S * 1000},
                ";",
                ",",
            )
        },
        BOTH,
    ),
    "axes called axes": (
        lambda: {
            "Accelerometer.csv": table_text({"elapsed (s)": TIME_S} | axes("%-axis (m/s^2)", FORCE)),
            "Gyroscope.csv": table_text({"elapsed (s)": TIME_S} | axes("%-axis (deg/s)", np.degrees(RATE))),
        },
        BOTH,
    ),
    "axes called values": (lambda: {"w.csv": table_text({"time": TIME_S} | axes("%_value", FORCE))}, "accelerometer"),
    "names of sensors in merged cells above the axes": (
        lambda: {
            "walk.csv": "Accelerometer,,,,Gyroscope,,,\nTime,X,Y,Z,Time,X,Y,Z\n"
            + table_text({"a": TIME_S} | axes("f%", FORCE) | {"b": TIME_S} | axes("r%", RATE)).split("\n", 1)[1]
        },
        BOTH,
    ),
    "decimal commas in quotation marks": (
        lambda: {
            "walk.csv": table_text(
                {
                    name: [f'"{value!r}"'.replace(".", ",") for value in column.tolist()]
                    for name, column in ({"time": TIME_S} | axes("acc%", FORCE)).items()
                }
            )
        },
        "accelerometer",
    ),
    "units in a line of their own": (
        lambda: {
            "walk.csv": "T;AccX;AccY;AccZ;GyrX;GyrY;GyrZ\nms;m/s^2;m/s^2;m/s^2;\u00b0/s;\u00b0/s;\u00b0/s\n"
            + table_text({"": 1000 * TIME_S} | axes("%", FORCE) | axes("r%", np.degrees(RATE)), ";").split("\n", 1)[1]
        },
        BOTH,
    ),
    "letters in a file that is called after one of its sensors": (
        lambda: {"gyro_walk.csv": table_text(columns_of("time", "a%", "w%"))},
        BOTH,
    ),
    "Sensor Logger in one table": (
        lambda: {
            "merged.csv": table_text(
                {"time": TIME_S}
                | axes("accelerometer_%", FORCE - GRAVITY)
                | axes("gravity_%", GRAVITY)
                | axes("gyroscope_%", RATE)
            )
        },
        BOTH,
    ),
    "degrees and milliseconds": (
        lambda: {
            "walk.tsv": table_text(
                {"Timestamp [ms]": TIME_S * 1000}
                | axes("Accel_% (m/s\u00b2)", FORCE)
                | axes("Gyro_% (deg/s)", np.degrees(RATE)),
                "\t",
            )
        },
        BOTH,
    ),
    "degrees that nobody says": (
        lambda: {"walk.csv": table_text(columns_of("time", "acc%", "gyro%") | axes("gyro%", np.degrees(RATE)))},
        BOTH,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_walk_comes_back(tmp_path: Path, case: str) -> None:
    files, sensors = CASES[case][0](), CASES[case][1]
    folder = write_folder(tmp_path / "walk", files)
    paths = [folder / next(iter(files))] if len(files) == 1 else [folder, write_zip(tmp_path / "walk.zip", files)]
    for path in paths:
        recording = read(path)
        # without times rows come at the rate that the header says, and those of the walk jitter by a millisecond
        assert_same_streams(recording, WALK, sensors, time_s=1e-3 if "no times" in case else 1e-6, rtol=1e-9)
        assert recordings_in(path if path.is_dir() else path.parent)
    assert recordings_in(folder) == [folder] or len(files) == 1
    app = case.partition(",")[0]
    if app in ("Physics Toolbox", "AndroSensor", "HyperIMU", "SensorLog", "MATLAB Mobile", "senslogs"):
        assert app in reading_report(recording).source


@pytest.mark.parametrize("case", CASES)
def test_the_mapping_that_was_guessed_reads_the_same_bits_when_it_is_given(tmp_path: Path, case: str) -> None:
    files = CASES[case][0]()
    folder = write_folder(tmp_path / "walk", files)
    path = folder / next(iter(files)) if len(files) == 1 else folder
    found = read_guessed(path)
    (tmp_path / "map.toml").write_text(found.guess.mapping.toml(), encoding="utf-8")
    again = read_mapped(path, read_mapping(tmp_path / "map.toml"))
    assert again.streams.keys() == found.recording.streams.keys()
    for name, samples in again.streams.items():
        np.testing.assert_array_equal(samples.time_s, found.recording.streams[name].time_s)
        np.testing.assert_array_equal(samples.values, found.recording.streams[name].values)


def test_a_mapping_is_written_as_it_was_read(tmp_path: Path) -> None:
    text = '[time]\nrate_hz = 50\n[accelerometer]\ncolumns = ["a", "b", "c"]\n'
    path = tmp_path / "walk.toml"
    for sign in ("", "sign = 1\n", "sign = -1\n"):
        path.write_text(text + '[gyroscope]\ncolumns = ["d", "e", "f"]\nunit = "deg/s"\n' + sign)
        mapping = read_mapping(path)
        path.write_text(mapping.toml())
        assert read_mapping(path) == mapping


def test_a_digit_that_is_no_number_is_no_time(tmp_path: Path) -> None:
    text = physics_toolbox_text(WALK)
    header, first, rest = text.split("\n", 2)
    damaged = "17879233041\u00b27456789" + first[first.index(",") :]
    (tmp_path / "walk.csv").write_text("\n".join([header, damaged, rest]), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"walk.csv: "):
        read(tmp_path / "walk.csv")


def test_a_header_in_the_code_of_the_phone_is_read(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_bytes(androsensor().encode("latin-1"))
    assert_same_streams(read(tmp_path / "walk.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_a_spreadsheet_of_phyphox_is_read(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    path = write_zip(tmp_path / "walk.xlsx", xlsx_files(phyphox_sheets(WALK)))
    assert_same_streams(read(path), WALK, BOTH, time_s=1e-9, rtol=1e-12)
    assert "phyphox" in reading_report(read(path)).source


def test_a_cell_far_off_in_a_spreadsheet_is_refused_before_its_rectangle_is_made(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    files = xlsx_files(phyphox_sheets(WALK))
    sheet = "xl/worksheets/sheet1.xml"
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    files[sheet] = files[sheet].replace("</sheetData>", far)
    assert "hardly any before it" in refusal(write_zip(tmp_path / "walk.xlsx", files))


def test_what_a_spreadsheet_claims_cannot_end_this_process(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    files = xlsx_files(phyphox_sheets(WALK))
    sheet = "xl/worksheets/sheet1.xml"
    # the cell of the last row and column, written so that a look at the text does not find it
    files[sheet] = files[sheet].replace('r="B3"', 'r="&#88;FD1048576"', 1)
    path = write_zip(tmp_path / "walk.xlsx", files)
    try:
        read(path)
    except ValueError as error:
        assert "walk.xlsx" in str(error)


@pytest.mark.parametrize("style", ["{m:02d}:{s:04.1f}", "18:{m:02d}", "18:{m:02d}:{s:02.0f}", "8/12/2022 18:{m:02d}"])
def test_times_that_a_spreadsheet_rounded_are_refused_with_what_happened(tmp_path: Path, style: str) -> None:
    times = [style.format(m=int(t // 60), s=t // 0.1 / 10 % 60) for t in TIME_S]
    (tmp_path / "walk.csv").write_text(table_text({"time": times} | axes("gF%", FORCE_G) | axes("w%", RATE)))
    assert "the times were rounded, as a spreadsheet does" in refusal(tmp_path / "walk.csv")


def test_decimal_commas_between_commas_are_refused_with_what_to_export(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(table_text({"time": TIME_S + 0.01} | axes("gF%", FORCE_G), ",", ","))
    assert "export it with points in numbers, or with semicolons" in refusal(tmp_path / "walk.csv")


@pytest.mark.parametrize("end", ["\r\r\n", "\n\n"])
def test_a_blank_line_after_each_changes_nothing(tmp_path: Path, end: str) -> None:
    text = table_text(columns_of("time", "acc%", "gyro%"))
    (tmp_path / "walk.csv").write_bytes(text.replace("\n", end).encode())
    assert_same_streams(read(tmp_path / "walk.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_columns_that_were_not_used_are_named(tmp_path: Path) -> None:
    columns = {"time": TIME_S} | axes("acc%", FORCE) | axes("Swing %", RATE)
    (tmp_path / "walk.csv").write_text(table_text(columns))
    assert "columns not used: Swing x, Swing y, Swing z" in reading_report(read(tmp_path / "walk.csv")).lines()


def test_a_header_that_is_there_again_is_two_recordings(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(2 * table_text(columns_of("time", "acc%", "gyro%")))
    assert f"line {len(TIME_S) + 2}: the header is there again" in refusal(tmp_path / "walk.csv").replace(
        ", column", ""
    )


@pytest.mark.parametrize("up_s", [5.0, 172.0, 1_500.0, 172_029.0])
def test_nanoseconds_since_the_phone_was_started_are_known_by_the_rate(tmp_path: Path, up_s: float) -> None:
    times = [str(round((up_s + t) * 1e9)) for t in TIME_S]
    at_s = read_text(tmp_path, {"event.timestamp": times} | axes("acc_%", FORCE))
    np.testing.assert_allclose(at_s, TIME_S, atol=1e-8)


def test_the_sign_that_nothing_shows_is_noted_and_can_be_said(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(physics_toolbox_text(WALK))
    assert any("nothing in the file shows its sign" in note for note in read(tmp_path / "walk.csv").notes)
    turned = read(tmp_path / "walk.csv", platform="ios")
    np.testing.assert_allclose(turned.accelerometer.values, -FORCE, rtol=1e-12)
    assert not turned.notes


def test_a_platform_where_the_sign_is_known_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(sensorlog())
    assert "leave --platform out" in refusal(tmp_path / "walk.csv", platform="ios")
    assert "leave platform out" in refusal(write_zip(tmp_path / "w.zip", phyphox_files(WALK)), platform="ios")
    with pytest.raises(ValueError, match="platform is 'windows'; known are ios, android"):
        read(tmp_path / "walk.csv", platform="windows")


def test_acceleration_without_gravity_is_refused_with_the_app_and_what_to_export(tmp_path: Path) -> None:
    linear = axes("a% (m/s^2)", FORCE - GRAVITY) | {"aT (m/s^2)": np.linalg.norm(FORCE - GRAVITY, axis=1)}
    (tmp_path / "walk.csv").write_text(table_text({"time": TIME_S} | linear))
    message = refusal(tmp_path / "walk.csv")
    assert "this looks like Physics Toolbox, whose acceleration" in message
    assert "export G-Force" in message
    (tmp_path / "other.csv").write_text(table_text({"time": TIME_S} | axes("a%", FORCE - GRAVITY) | axes("w%", RATE)))
    assert "lacks gravity" in refusal(tmp_path / "other.csv")


def test_milliseconds_that_are_declared_are_believed_at_2_hz(tmp_path: Path) -> None:
    columns = {k.upper(): v for k, v in axes("ACCE%", FORCE[:100]).items()}
    text = table_text({**columns, "Time since start in ms ": 500.0 * np.arange(100)})
    (tmp_path / "walk.csv").write_text(text)
    message = refusal(tmp_path / "walk.csv")
    assert "a rate of 2 Hz" in message
    assert "look like" not in message
    assert "AndroSensor" in message


def test_a_table_without_times_is_asked_for_its_rate(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(table_text(axes("acc%", FORCE) | axes("gyro%", RATE)))
    assert "rate_hz" in refusal(tmp_path / "walk.csv")


def test_a_location_that_is_repeated_in_every_row_is_one_fix(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(androsensor())
    found = read(tmp_path / "walk.csv").location
    assert found is not None
    assert len(found) == 1


def test_a_clock_goes_on_at_midnight(tmp_path: Path) -> None:
    time_s = read_text(tmp_path, {"time": [d[12:] for d in wall_clock(TIME_S)]} | axes("gF%", FORCE_G))
    assert time_s[0] == 0
    assert time_s[-1] == pytest.approx(TIME_S[-1], abs=1e-6)
    assert np.diff(time_s).min() > 0


def read_text(folder: Path, columns: dict[str, np.ndarray | list[str]]) -> np.ndarray:
    (folder / "walk.csv").write_text(table_text(columns))
    return read(folder / "walk.csv").accelerometer.time_s


@pytest.mark.parametrize(
    "style", ["{d} {t}", "{d}T{t}Z", "{d} {t} +0530", "{d}T{t}+02:00", "{eu} {t}", "{d} {colon}", "{us} {t}"]
)
def test_dates_are_read_however_they_are_written(tmp_path: Path, style: str) -> None:
    begin = np.datetime64("2024-02-27T22:59:50.000001", "us")
    stamps = [str(begin + np.timedelta64(round(t * 1e6), "us")) for t in TIME_S.tolist()]
    dates = []
    for stamp in stamps:
        d, t = stamp.split("T")
        y, m, day = d.split("-")
        dates.append(style.format(d=d, t=t, eu=f"{day}.{m}.{y}", us=f"{m}/{day}/{y}", colon=t.replace(".", ":")))
    time_s = read_text(tmp_path, {"date": dates} | axes("gF%", FORCE_G))
    np.testing.assert_allclose(time_s, TIME_S, atol=1e-6)


def test_a_clock_of_twelve_hours_goes_on_at_noon(tmp_path: Path) -> None:
    at = [np.datetime64("2024-02-27T11:59:58.000000", "us") + np.timedelta64(round(t * 1e6), "us") for t in TIME_S]
    clock = [stamp.astype(object).strftime("%I:%M:%S.%f %p") for stamp in at]
    assert {text[-2:] for text in clock} == {"AM", "PM"}
    np.testing.assert_allclose(read_text(tmp_path, {"time": clock} | axes("gF%", FORCE_G)), TIME_S, atol=1e-6)


def test_acceleration_without_gravity_is_told_by_its_values_in_any_language(tmp_path: Path) -> None:
    files = phyphox_in("French")
    linear = {"Temps (s)": TIME_S} | axes("Acc\u00e9l\u00e9ration lin\u00e9aire % (m/s^2)", FORCE - GRAVITY)
    name = "Acc\u00e9l\u00e9ration lin\u00e9aire.csv"
    assert_same_streams(
        read(write_folder(tmp_path / "both", files | {name: table_text(linear)})), WALK, BOTH, time_s=1e-6, rtol=1e-9
    )
    only = write_folder(tmp_path / "only", {"Gyroscope.csv": files["Gyroscope.csv"], name: table_text(linear)})
    assert "lacks gravity" in refusal(only)
    assert "'Acceleration with g' in phyphox" in refusal(only)


def test_two_walks_in_one_zip_are_two(tmp_path: Path) -> None:
    first, second = phyphox_files(WALK), phyphox_files(on_one_clock(a_walk(50.0, seed=8)))
    files = {f"a/{k}": v for k, v in first.items()} | {f"b/{k}": v for k, v in second.items()}
    path = write_zip(tmp_path / "export.zip", files)
    assert "holds 2 recordings (a, b)" in refusal(path)
    assert recordings_in(tmp_path) == [path / "a", path / "b"]
    assert_same_streams(read(path / "a"), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    assert read(path / "b").name == "b"
    assert "nothing in it is called c" in refusal(path / "c")


def test_two_tables_that_are_whole_are_two_and_one_walk_in_several_files_is_one(tmp_path: Path) -> None:
    text = physics_toolbox_text(WALK)
    write_folder(tmp_path / "two", {"walk_1.csv": text, "walk_2.csv": text})
    assert len(recordings_in(tmp_path / "two")) == 2
    assert "holds 2 recordings (walk_1.csv, walk_2.csv)" in refusal(tmp_path / "two")
    path = write_zip(tmp_path / "two.zip", {"walk_1.csv": text, "walk_2.csv": text})
    assert recordings_in(path) == [path / "walk_1.csv", path / "walk_2.csv"]
    assert_same_streams(read(path / "walk_2.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    only = {f"{n}_steps.csv": matlab_mobile_files(WALK)["Acceleration.csv"] for n in (80, 250)}
    assert len(recordings_in(write_folder(tmp_path / "steps", only))) == 2


def test_what_is_left_out_of_a_folder_is_noted(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", CASES["phyphox, members renamed and added"][0]())
    assert any("left out: old_accelerometer" in note for note in read(folder).notes)


@pytest.mark.parametrize("n_without_time", [0, 1, 3])
def test_the_gyroscope_is_checked_with_how_gravity_turns(tmp_path: Path, n_without_time: int) -> None:
    at_s = np.arange(0.0, 30.0, 0.02)
    angle = 0.8 * np.sin(2 * np.pi * at_s / 8)
    force = 9.81 * np.column_stack([0 * at_s, np.sin(angle), np.cos(angle)])
    rate = np.column_stack([np.gradient(angle, at_s), 0 * at_s, 0 * at_s])
    for unit, factor in (("rad/s", 1.0), ("deg/s", 180 / np.pi)):
        begun_s = np.where(np.arange(len(at_s)) < n_without_time, np.nan, at_s)
        text = table_text({"time": begun_s} | axes("acc%", force) | axes("gyro%", factor * rate))
        (tmp_path / "walk.csv").write_text(text)
        found = read_guessed(tmp_path / "walk.csv")
        assert any(f"gyroz, {unit}" in line for line in found.guess.evidence)
        assert found.recording.gyroscope is not None
        np.testing.assert_allclose(found.recording.gyroscope.values, rate[n_without_time:], atol=1e-12)
    assert (
        any("gravity turns 1.0" in line for line in read_guessed(tmp_path / "walk.csv").guess.evidence)
        or unit == "deg/s"
    )


@pytest.mark.recordings
def test_real_files_of_apps_are_read_or_refused_rightly(data_dir: Path) -> None:
    from tests.benchmarks.app_files import FILES, row_of

    folder = data_dir.parent / "app_files"
    if not folder.is_dir():
        pytest.skip(f"no files of apps at {folder}")
    there = {p.relative_to(folder).as_posix() for p in folder.glob("*/*")}
    assert there == {known.path for known in FILES}
    wrong = [known.path for known in FILES if not row_of(known, folder, with_steps=False).is_right]
    assert wrong == []


def test_thousandths_of_g_and_of_degrees_are_read_once_the_platform_is_said(tmp_path: Path) -> None:
    force_mg, rate_mdps = 1e3 * FORCE_G, 1e3 * np.degrees(RATE)
    columns = {"timestamp (us)": TIME_S * 1e6} | axes("acc_% [mg]", force_mg) | axes("gyr_% [mdps]", rate_mdps)
    (tmp_path / "imu.csv").write_text(table_text(columns))
    assert "say it with pdr-filter convert FILE --platform" in refusal(tmp_path / "imu.csv")
    recording = read(tmp_path / "imu.csv", platform="android")
    assert_same_streams(recording, WALK, BOTH, time_s=1e-6, rtol=1e-9)


@pytest.mark.parametrize(
    ("separator", "names"), [(",", ("ACC", "GYR", "light")), (";", ("Accelerometer", "Gyroscope", ""))]
)
def test_a_table_with_a_row_for_each_sample_of_any_sensor_is_one_for_each(
    tmp_path: Path, separator: str, names: tuple[str, str, str]
) -> None:
    rows = [
        (int(1e9 * t), name, *values)
        for name, stream in zip(names, (FORCE, RATE, FIELD), strict=True)
        for t, values in zip(TIME_S, stream, strict=True)
    ]
    lines = [separator.join(map(str, row)) for row in sorted(rows, key=lambda row: row[0])]
    header = separator.join(("timestamp_ns", "sensor", "x", "y", "z"))
    (tmp_path / "w.csv").write_text("\n".join([header, *lines]) + "\n")
    found = read_guessed(tmp_path / "w.csv", "android")
    assert_same_streams(found.recording, WALK, "accelerometer gyroscope", time_s=1e-6, rtol=1e-9)
    # and by the mapping that was guessed
    again = read_mapped(tmp_path / "w.csv", found.guess.mapping)
    assert_same_streams(again, WALK, "accelerometer gyroscope", time_s=1e-6, rtol=1e-9)


@pytest.mark.parametrize(
    "odd",
    [
        *("1,2,,4,5\n2,3,nan,4,5\n3,4,inf,5,6\n", "1,2,x,4,5\n", "1,2,1_0,4,5\n", "1,2, 3 ,4,5\n", "1,2,1e400,4,5\n"),
        *("1.0,2,3,4,5\n", ",2,3,4,5\n2,2,3,4,5\n", "1,2,#N/A,4,5\n", "1,2,3,4,5\n\n2,3,4,5,6\n", "1,2,3,4\n"),
        *("1,2,3,4,5,6\n1,2,3,4,5\n", "+1,2,+3,.5,5.\n", "1,2,None,null,5\n", "1,\u00e4,3,4,5\n", '"1",2,3,4,5\n'),
        *("1,2,true,4,5\n", "9223372036854775807,2,3,4,5\n", "1787923304123456789,2,0.1,1e-300,123456.789012345678\n"),
    ],
)
def test_the_library_for_large_tables_has_the_same_bits_and_refuses_the_same(
    monkeypatch: pytest.MonkeyPatch, odd: str
) -> None:
    pytest.importorskip("pyarrow")

    def parsed(least_bytes: int) -> object:
        monkeypatch.setattr(tables, "LARGE_BYTES", least_bytes)
        notes: list[str] = []
        try:
            found = tables.parse_blocks([odd.encode()], tables.Layout((2, 3, 4), 0), "walk.csv", notes)
        except RecordingError as error:
            return str(error)
        return found.whole.tolist(), found.values.tobytes(), notes

    assert parsed(1) == parsed(10**9)
