"""One walk as the tables of other apps, in their versions, settings and languages."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from app_files import (
    a_walk,
    axes,
    matlab_mobile_files,
    on_one_clock,
    phyphox_files,
    physics_toolbox_text,
    table_text,
    wall_clock,
)

from pdr_filter.values import STANDARD_GRAVITY_MPS2

WALK = on_one_clock(a_walk(50.0))
TIME_S, FORCE = WALK.accelerometer.time_s, WALK.accelerometer.values
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


TICKS = [1_787_923_304_123_456_789 + round(t * 1e9) for t in TIME_S.tolist()]
CLOCK = wall_clock(TIME_S)


def ros(times: dict[str, list[str]], prefix: str = "") -> dict[str, str]:
    """Angular velocity and acceleration as ROS names them."""
    of_ros = axes(f"{prefix}angular_velocity.%", RATE) | axes(f"{prefix}linear_acceleration.%", FORCE)
    return one(times | axes(f"{prefix}orientation.%", 0 * FORCE) | of_ros)


def seconds_and_nanoseconds(seconds: str, nanoseconds: str) -> dict[str, str]:
    return ros({seconds: [str(t // 10**9) for t in TICKS], nanoseconds: [str(t % 10**9) for t in TICKS]})


def one(columns: Mapping[str, np.ndarray | list[str]], separator: str = ",", decimal: str = ".") -> dict[str, str]:
    """One file with these columns."""
    return {"walk.csv": table_text(columns, separator, decimal)}


def under(head: str, columns: Mapping[str, np.ndarray | list[str]], separator: str = ",") -> str:
    """A table with another head in place of the names of its columns."""
    return head + table_text(columns, separator).split("\n", 1)[1]


def of_university() -> dict[str, str]:
    at_ms = 1606391908305.0 + 1000 * TIME_S
    files = {"acc.csv": FORCE, "gyr.csv": RATE, "mag.csv": FIELD}
    reference = "1606391908305 566578.7 5932830.4 19.6\n1606391912305 566578.7 5932830.4 19.6\n"
    return {name: without_header(values, at=at_ms) for name, values in files.items()} | {"ref.csv": reference}


def with_a_line_before() -> dict[str, str]:
    time, accuracy = {"timestamp": 172029867 + 1000 * TIME_S}, {"accuracy(more=better)": 3 + 0 * TIME_S}
    force, rate = axes("acc_%[m/s^2]", FORCE), axes("ang_vel_%[rad/s]", RATE)
    return {
        "accelerometer_1.csv": "accelerometer-icm20690,invensense,2020-02-18\n" + table_text(time | accuracy | force),
        "gyroscope_2.csv": "gyroscope-icm20690,invensense,2020-02-18\n" + table_text(time | rate),
    }


def of_each(time: str, names: str, rate_names: str = "", rate: np.ndarray = RATE) -> dict[str, str]:
    """A file for each sensor."""
    return {
        "Accelerometer.csv": table_text({time: TIME_S} | axes(names, FORCE)),
        "Gyroscope.csv": table_text({time: TIME_S} | axes(rate_names or names, rate)),
    }


def renamed_and_added() -> dict[str, str]:
    files = {("157_" + name if name.startswith("Acc") else name): text for name, text in phyphox_files(WALK).items()}
    old = table_text({"t": TIME_S[:99]} | axes("%", FORCE[:99]))
    return files | {"steps.csv": "foot,n\nleft,80\nright,77\n", "old_accelerometer.csv": old}


def spanish_androsensor() -> dict[str, str]:
    force = axes("ACELER\u00d3METRO % (m/s\u00b2)", FORCE) | axes(
        "ACELERACI\u00d3N LINEAL % (m/s\u00b2)", FORCE - GRAVITY
    )
    time = {"Tiempo desde el inicio en ms ": TIME_S * 1000}
    return {"s.csv": "sep=;\n" + table_text(force | axes("GIROSCOPIO % (rad/s)", RATE) | time, ";", ",")}


def with_quoted_decimals() -> dict[str, str]:
    columns = {"time": TIME_S} | axes("acc%", FORCE)
    return one({n: [f'"{value!r}"'.replace(".", ",") for value in c.tolist()] for n, c in columns.items()})


def hyperimu_with_the_chip_behind_the_word() -> dict[str, str]:
    about = "@ HyperIMU - ianovir\n@ Date:Thu May 21 15:07:17 GMT+02:00 2020, Sampling Rate:20ms\n\n"
    columns = axes("lsm6ds3_accelerometer.%", FORCE) | axes("gyroscope_lsm6ds3_c.%", RATE)
    return {"HIMU.csv": about + table_text(columns).replace("\n", "\n\n", 1)}


BOTH, FORCE_ALONE = "accelerometer gyroscope", "accelerometer"
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


TIME = {"time": TIME_S}
MERGED = "Accelerometer,,,,Gyroscope,,,\nTime,X,Y,Z,Time,X,Y,Z\n"
WITH_UNITS = "T;AccX;AccY;AccZ;GyrX;GyrY;GyrZ\nms;m/s^2;m/s^2;m/s^2;\u00b0/s;\u00b0/s;\u00b0/s\n"
CORE_MOTION = (
    axes("userAcceleration_%", (GRAVITY - FORCE) / STANDARD_GRAVITY_MPS2)
    | axes("gravity_%", -GRAVITY / STANDARD_GRAVITY_MPS2)
    | axes("rotationRate_%", RATE)
)
# Name, files and the sensors that must come back; one file is given by itself, several as a folder and as a zip.
CASES: dict[str, tuple[Callable[[], dict[str, str]], str]] = {
    "Physics Toolbox": (lambda: {"walk.csv": physics_toolbox_text(WALK)}, BOTH),
    "Physics Toolbox, comma": (
        lambda: one(TIME | axes("gF%", FORCE_G) | {"TgF": FORCE_G[:, 0]}, ";", ","),
        FORCE_ALONE,
    ),
    "Physics Toolbox, clock": (
        lambda: one({"time": [d[12:] for d in CLOCK]} | axes("gF%", FORCE_G) | axes("B%", FIELD)),
        FORCE_ALONE,
    ),
    "Physics Toolbox, minutes and seconds": (
        lambda: one({"tiempo": [d[15:] for d in CLOCK]} | axes("gF%", FORCE_G) | axes("w%", RATE)),
        BOTH,
    ),
    "Physics Toolbox, capitals": (
        lambda: {"W.CSV": table_text({"TIME": TIME_S} | axes("GF%", FORCE_G) | axes("W%", RATE)).upper()},
        BOTH,
    ),
    "AndroSensor": (lambda: {"Sensor_record.csv": androsensor()}, BOTH),
    "AndroSensor, semicolon": (lambda: {"Sensor_record.csv": androsensor(";", ",", "sep=;")}, BOTH),
    "AndroSensor, short names": (lambda: {"data.csv": androsensor_short()}, BOTH),
    "Spanish AndroSensor": (spanish_androsensor, BOTH),
    "HyperIMU": (lambda: {"HIMU.csv": hyperimu("MPL", True)}, BOTH),
    "HyperIMU, no times": (lambda: {"HIMU.csv": hyperimu("LSM6DSO", False)}, BOTH),
    "HyperIMU, no times, the chip behind the word": (hyperimu_with_the_chip_behind_the_word, BOTH),
    "durations of MATLAB": (
        lambda: one({"Time": [f"{t:.6f} sec" for t in TIME_S]} | axes("Acc_%", FORCE) | axes("Gyr_%", RATE)),
        BOTH,
    ),
    "SensorLog": (lambda: {"2020-03-09_my_iPhone.csv": sensorlog()}, BOTH),
    "SensorLog, semicolon": (lambda: {"stream.csv": sensorlog(";", ",")}, BOTH),
    "SensorLog, motion only": (lambda: {"stream.csv": sensorlog(raw=False)}, BOTH),
    "SensorLog of a university": (of_university, BOTH),
    "MATLAB Mobile": (lambda: matlab_mobile_files(WALK), BOTH),
    "MATLAB Mobile, one sensor": (
        lambda: {"80_steps.csv": matlab_mobile_files(WALK)["Acceleration.csv"]},
        FORCE_ALONE,
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
    "logger with a line before the header": (with_a_line_before, BOTH),
    "phyphox rewritten by a script": (lambda: of_each("t", "%"), BOTH),
    "phyphox, members renamed and added": (renamed_and_added, BOTH),
    **{f"phyphox, {language}": (lambda word=language: phyphox_in(word), BOTH) for language in LANGUAGES},
    "phyphox, decimal comma": (lambda: phyphox_in("French", ";", ","), BOTH),
    "ROS, as text": (lambda: ros({"%time": [str(t) for t in TICKS]}, "field."), BOTH),
    "ROS, header.stamp.secs": (lambda: seconds_and_nanoseconds("header.stamp.secs", "header.stamp.nsecs"), BOTH),
    "ROS, sec and nanosec": (lambda: seconds_and_nanoseconds("sec", "nanosec"), BOTH),
    "CoreMotion of any app": (lambda: one({"timestamp": 1000 + TIME_S} | CORE_MOTION), BOTH),
    "axes called axes": (
        lambda: of_each("elapsed (s)", "%-axis (m/s^2)", "%-axis (deg/s)", np.degrees(RATE)),
        BOTH,
    ),
    "axes called values": (lambda: one(TIME | axes("%_value", FORCE)), FORCE_ALONE),
    "names of sensors in merged cells above the axes": (
        lambda: {"w.csv": under(MERGED, TIME | axes("f%", FORCE) | {"b": TIME_S} | axes("r%", RATE))},
        BOTH,
    ),
    "decimal commas in quotation marks": (with_quoted_decimals, FORCE_ALONE),
    "units in a line of their own": (
        lambda: {
            "w.csv": under(WITH_UNITS, {"": 1000 * TIME_S} | axes("%", FORCE) | axes("r%", np.degrees(RATE)), ";")
        },
        BOTH,
    ),
    "letters in a file that is called after one of its sensors": (
        lambda: {"gyro_walk.csv": table_text(columns_of("time", "a%", "w%"))},
        BOTH,
    ),
    "Sensor Logger in one table": (
        lambda: one(
            TIME | axes("accelerometer_%", FORCE - GRAVITY) | axes("gravity_%", GRAVITY) | axes("gyroscope_%", RATE)
        ),
        BOTH,
    ),
    "degrees and milliseconds": (
        lambda: one(
            {"Timestamp [ms]": TIME_S * 1000}
            | axes("Accel_% (m/s\u00b2)", FORCE)
            | axes("Gyro_% (deg/s)", np.degrees(RATE)),
            "\t",
        ),
        BOTH,
    ),
    "degrees that nobody says": (lambda: one(TIME | axes("acc%", FORCE) | axes("gyro%", np.degrees(RATE))), BOTH),
}
