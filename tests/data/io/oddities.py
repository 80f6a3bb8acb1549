"""Odd tables, one for each kind: its files, what the reader does with them, and words of what it says.

The table of docs/formats.md is made from these by tests/benchmarks/app_files.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from app_files import axes, core_motion_text, table_text, wall_clock, write_folder
from table_cases import FORCE, GRAVITY, RATE, TIME_S, WALK

import pdr_filter as pdr
from pdr_filter.data.io.describe import reading_report
from pdr_filter.values import STANDARD_GRAVITY_MPS2

N = len(TIME_S)
BOTH = "accelerometer gyroscope"
ACCURACY_M = 7.5
Columns = dict[str, np.ndarray | list[str]]


@dataclass(frozen=True)
class Oddity:
    """Files of a kind, and what becomes of them."""

    kind: str
    done: str
    files: Callable[[], Mapping[str, str] | str]  # a text is that of walk.csv
    said: str  # words of the note, the report or the refusal that says so
    streams: str = BOTH  # that must be those of `WALK`; empty where the files are refused or none is compared
    path: str = ""  # in the folder of the files; the folder itself if empty
    is_refused: bool = False
    time_s: float = 1e-6  # largest error of a time

    def write(self, folder: Path) -> Path:
        """Write the files and return the path to read."""
        files = self.files()
        return write_folder(folder / "walk", {"walk.csv": files} if isinstance(files, str) else files) / self.path

    def sentence(self, path: Path) -> str:
        """The sentence with the words of `said`: of the reader, of the track, or of the refusal."""
        try:
            recording = pdr.read(path)
        except ValueError as error:
            sentences = [str(error).replace(f"{path}/", "").removeprefix(f"{path}: ")]
        else:
            sentences = [*reading_report(recording).lines(), *pdr.track(recording).notes]
        return next((sentence for sentence in sentences if self.said in sentence), "")


def columns(time: str = "time", force: str = "acc_%", rate: str = "gyro_%") -> Columns:
    """Columns of the walk, with % for the axis."""
    return {time: TIME_S} | axes(force, FORCE) | axes(rate, RATE)


def places(speed_mps: float = 1.0) -> Columns:
    """A location each second, on the way to the north."""
    north_deg = np.floor(TIME_S) * speed_mps / 111_000
    return {"latitude": 10.0 + north_deg, "longitude": np.full(N, 20.0)}


def with_accuracies(horizontal: str = "horizontalAccuracy") -> str:
    others = {"bearingAccuracy": 180.0, "locationSpeedAccuracy(m/s)": -1.0, "verticalAccuracy": 3.0}
    accuracies = {**others, horizontal: ACCURACY_M}
    return table_text(columns() | places() | {name: np.full(N, value) for name, value in accuracies.items()})


def lines_of(text: str) -> tuple[str, list[str]]:
    header, *rows = text.splitlines(keepends=True)
    return header, rows


def moved_rows() -> str:
    """Two blocks of two seconds change places."""
    header, rows = lines_of(table_text(columns()))
    return header + "".join(rows[:200] + rows[300:400] + rows[200:300] + rows[400:])


def clock_set_back() -> str:
    later = np.where(np.arange(N) < N // 2, TIME_S, TIME_S - 3.0)
    return table_text({**columns(), "time": later})


def packs(n: int = 3, period_ms: int = 20) -> str:
    """Each pack of samples has the time of its last one."""
    last = np.minimum(np.arange(N) // n * n + n - 1, N - 1)
    return table_text({**columns("timestamp_ms"), "timestamp_ms": 1_700_000_000_000 + period_ms * last})


def sensor_logger_of_2021() -> dict[str, str]:
    """Signs of iOS, which only Metadata.csv names, and no seconds_elapsed."""
    ns: Columns = {"time": [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in TIME_S.tolist()]}

    def text(values: np.ndarray) -> str:
        return table_text(ns | dict(zip("zyx", values.T[::-1], strict=True)))

    return {
        "Metadata.csv": "version,device name,recording time,platform\n2,iPhone,2021-00-12_21-15-35,ios",
        "Accelerometer.csv": text(GRAVITY - FORCE),
        "Gravity.csv": text(-GRAVITY),
        "Gyroscope.csv": text(RATE),
    }


def event_rows(accelerometer: str, gyroscope: str) -> str:
    """A line for each sample of any sensor."""
    pairs = zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
    lines = [
        line.format(t=t, x=x, y=y, z=z)
        for t, force, rate in pairs
        for line, (x, y, z) in ((accelerometer, force), (gyroscope, rate))
    ]
    return "\n".join(lines) + "\n"


def ride(speed_mps: float = 10.0) -> str:
    """A phone at rest in a vehicle, whose locations move on."""
    time_s = np.arange(0.0, 60.0, 0.02)
    still = np.random.default_rng(1).normal([0.2, 3.9, 9.0], 0.1, (len(time_s), 3))
    north_deg = np.floor(time_s) * speed_mps / 111_000
    here = {"latitude": 10.0 + north_deg, "longitude": 20.0 + 0 * time_s, "accuracy": 5.0 + 0 * time_s}
    return table_text({"time": time_s} | axes("acc_%", still) | axes("gyro_%", 0.01 * still) | here)


def trials() -> dict[str, str]:
    force, rate = ({"time": TIME_S} | axes("%", values) for values in (FORCE, RATE))
    files = {"acc": table_text(force), "gyro": table_text(rate)}
    return {f"walk{n}_{sensor}.csv": text for n in (1, 2) for sensor, text in files.items()}


def web() -> dict[str, str]:
    rate = {f"rotationRate.{axis}": np.degrees(v) for axis, v in zip(("alpha", "beta", "gamma"), RATE.T, strict=True)}
    force = axes("acceleration.%", FORCE - GRAVITY) | axes("accelerationIncludingGravity.%", FORCE)
    return {"motion.csv": table_text({"timestamp": 1_700_000_000_000 + TIME_S * 1000} | force | rate)}


def in_g(name: str) -> str:
    return table_text({"timestamp": TIME_S} | axes(name, FORCE / STANDARD_GRAVITY_MPS2), ";")


def with_marks(header: str, row: str) -> str:
    """Rows in a layout of their own."""
    values = zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
    return header + "".join(row.format(t=t, f=f, w=w) for t, f, w in values)


def hourly() -> dict[str, str]:
    """A file for each hour in the folder of each sensor."""
    ms, half = 1_664_625_600_000 + np.round(1000 * (TIME_S - TIME_S[N // 2])).astype(np.int64), N // 2
    return {
        f"{sensor}/2022-10-01 {hour}_00_00.csv": table_text({"timestamp": ms[part]} | axes("%", values[part]))
        for sensor, values in (("accelerometer", FORCE), ("gyro", RATE))
        for hour, part in (("11", slice(half)), ("12", slice(half, None)))
    }


def json_packets(n: int = 4) -> dict[str, str]:
    """Samples of a packet have one time."""
    packets: list[dict[str, object]] = []
    for begin in range(0, N, n):
        at_ms = round(1000 * TIME_S[min(begin + n, N) - 1]) + 1000
        for name, values in (("Acc", FORCE), ("Gyro", RATE)):
            samples = [dict(zip("xyz", row, strict=True)) for row in values[begin : begin + n].tolist()]
            packets.append({name: {"Timestamp": at_ms, f"Array{name}": samples}})
    return {"log.json": json.dumps({"Samples": packets})}


def message_types() -> str:
    """The sensor of each row in a column, uncalibrated values and their biases, and two times."""
    lines = [
        "MessageType,utcTimeMillis,elapsedRealtimeNanos,MeasurementX,MeasurementY,MeasurementZ,BiasX,BiasY,BiasZ\n"
    ]
    for t, force, rate in zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True):
        for name, values, bias in (("UncalAccel", force, (0.0, 0.0, 0.0)), ("UncalGyro", rate, (0.01, -0.02, 0.03))):
            numbers = [*(v + b for v, b in zip(values, bias, strict=True)), *bias]
            lines.append(f"{name},{1_663_164_669_190 + round(1000 * t)},{65_972_054_923_181 + round(1e9 * t)},")
            lines.append(",".join(map(repr, numbers)) + "\n")
    return "".join(lines)


def counts() -> str:
    force = axes("Ac%", np.round(8192 * FORCE / STANDARD_GRAVITY_MPS2))
    return table_text({"millis": np.round(1000 * TIME_S)} | force | axes("Gy%", np.round(16.4 * np.degrees(RATE))))


def core_motion_names() -> str:
    """Apple's signs and angles, under names that no app is known by."""
    walk = core_motion_text(WALK).replace("attitude.", "attitude_").replace("userAcceleration.", "user_acc_")
    rows = walk.replace("rotationRate.", "rotation_rate_").replace("gravity.", "gravity_").splitlines()
    times = ["timestamp", *(repr(t) for t in TIME_S.tolist())]
    names, *values = ([time, *row.split(",")[1:]] for time, row in zip(times, rows, strict=True))
    names = [f"{name}(G)" if "acc" in name or "grav" in name else name for name in names]
    return "".join(",".join(row) + "\n" for row in (names, *values))


def wrist() -> dict[str, str]:
    ns: Columns = {"time": [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in TIME_S.tolist()]}
    parts = axes("gravity%", -GRAVITY) | axes("acceleration%", GRAVITY - FORCE)
    in_g = {name: values / STANDARD_GRAVITY_MPS2 for name, values in parts.items()}
    columns = {"seconds_elapsed": TIME_S} | in_g | axes("rotationRate%", RATE)
    return {
        "WristMotion.csv": table_text(
            ns | {f"{k[:-1]}{k[-1].upper()}" if k[-1] in "xyz" else k: v for k, v in columns.items()}
        )
    }


MAPPING = """[time]
column = "timestamp"
[accelerometer]
columns = ["x (in G's)", "y (in G's)", "z (in G's)"]
unit = "g"
"""
ODDITIES = (
    Oddity(
        "several columns of accuracy, in any order",
        "the horizontal one is used: known in eleven languages, and as `hacc`, `h_acc`, `eph`",
        lambda: with_accuracies(),
        "columns not used: bearingAccuracy, locationSpeedAccuracy(m/s), verticalAccuracy",
    ),
    Oddity(
        "locations without a horizontal accuracy",
        "not used; each cause is counted",
        lambda: table_text(columns() | places()),
        "with no horizontal accuracy above 0",
    ),
    Oddity(
        "names of web browsers, Expo and Cordova: `accelerationIncludingGravity`, `rotationRate.alpha`",
        "the force with gravity is used; alpha, beta and gamma are the rates about x, y and z, in degrees",
        web,
        "accelerationIncludingGravity.x",
    ),
    Oddity(
        "names that end like a known word: `total_acc`, `WAL_acc`",
        "words are compared as words, and the values decide which acceleration has gravity",
        lambda: table_text(columns("time", "total_acc_%", "body_gyro_%") | axes("body_acc_%", FORCE - GRAVITY)),
        "total_acc_x, total_acc_y, total_acc_z",
    ),
    Oddity(
        "file names that contain the letters of a sensor: `access`, `grave`, `preset`, `long_walk`",
        "not taken for that sensor; the columns decide",
        lambda: {"grave.csv": table_text({"time": TIME_S} | axes("%", FORCE))},
        "acceleration: x, y, z, m/s2",
        "accelerometer",
        path="grave.csv",
    ),
    Oddity(
        "columns with a g behind their word: `accG_x`",
        "acceleration in g or m/s2, whichever its size shows",
        lambda: table_text(columns(force="accG_%", rate="rate_%")),
        "accG_x, accG_y, accG_z, m/s2 by its size",
    ),
    Oddity(
        "`accelerometer.csv` of another app, alone or in a folder",
        "the content decides, and a TOML file of columns beside it counts",
        lambda: {"accelerometer.csv": in_g("% (in G's)"), "accelerometer.toml": MAPPING},
        "factor 9.80665, as given",
        "accelerometer",
        path="accelerometer.csv",
    ),
    Oddity(
        "Metadata.csv of Sensor Logger beside tables of 2021, without `seconds_elapsed`",
        "the platform that it names decides the sign, also for one file alone and for tables of unknown apps",
        sensor_logger_of_2021,
        "-(Accelerometer + Gravity), m/s2 (ios",
    ),
    Oddity(
        "units as in `[m s^-2]`, `(in G's)`, `(degrees/second)`",
        "read as m/s2, g, deg/s",
        lambda: table_text(columns("#timestamp [s]", "a_RS_S_% [m s^-2]", "w_RS_S_% [rad s^-1]")),
        "a_RS_S_x [m s^-2]",
    ),
    Oddity(
        "a unit that is not known",
        "refused",
        lambda: table_text(columns(force="acc_% [furlong]")),
        "unit 'furlong' is not known",
        "",
        is_refused=True,
    ),
    Oddity(
        "acceleration in g of an unknown app",
        "refused: iOS and Android have opposite signs",
        lambda: in_g("acc_%"),
        "nothing shows its sign",
        "",
        is_refused=True,
    ),
    Oddity(
        "moved rows, also the last row first",
        "sorted by time if that leaves no gap and no row between others",
        lambda: moved_rows(),
        "rows out of order",
    ),
    Oddity(
        "a clock that was set back",
        "kept as recorded; the filter follows the clock",
        lambda: clock_set_back(),
        "1 backward times, kept as recorded",
        "",
    ),
    Oddity(
        "packs of samples with one time, as of Bluetooth sensors",
        "spread at the estimated rate, or at `rate_hz` of a TOML file",
        lambda: packs(),
        "with one time each",
        time_s=2e-3,
    ),
    Oddity(
        "times that a spreadsheet rounded",
        "refused",
        lambda: table_text({**columns(), "time": [t[12:20] for t in wall_clock(TIME_S)]}),
        "the times may be rounded",
        "",
        is_refused=True,
    ),
    Oddity(
        "the sensor of each row in a column, as a name or as the number of Android",
        "a table for each sensor",
        lambda: "timestamp,sensor_type,value1,value2,value3\n" + event_rows("{t},1,{x},{y},{z}", "{t},4,{x},{y},{z}"),
        "value1, value2, value3 of acceleration",
    ),
    Oddity(
        "names in the line, as in `ACC: 12, 0.1, 0.2, 9.8`",
        "refused",
        lambda: {"walk.txt": event_rows("ACC: {t}, {x}, {y}, {z}", "GYR: {t}, {x}, {y}, {z}")},
        "names in front of their numbers",
        "",
        is_refused=True,
    ),
    Oddity(
        "other columns before the time, without names: the number of a subject, a label, a second clock",
        "the time is the column that increases by nearly equal amounts",
        lambda: {"acc_1600.txt": with_marks("", "1600,A,{t:.4f},{f[0]},{f[1]},{f[2]};\n")},
        "clock: column '3', in s",
        "accelerometer",
        path="acc_1600.txt",
        time_s=1e-4,
    ),
    Oddity(
        "a mark at the end of each line, brackets, slashes or blanks between numbers: `0.1,(0.2 / 9.8 / 0.3);`",
        "read as columns; three numbers below one name are its axes",
        lambda: with_marks("time,acc,gyro\n", "{t},({f[0]} / {f[1]} / {f[2]}),({w[0]} / {w[1]} / {w[2]});\n"),
        "acc x, acc y, acc z",
    ),
    Oddity(
        "times between the samples in place of times",
        "summed",
        lambda: table_text({**columns("dt (s)"), "dt (s)": np.diff(TIME_S, prepend=TIME_S[0])}),
        "the times between the samples",
    ),
    Oddity(
        "a sampling rate or interval above a table, or `dt`, `sample_rate` and the like in JSON, in place of times",
        "rows have this interval",
        lambda: f"# sampling rate: 50 Hz\n{table_text({n: v for n, v in columns().items() if n != 'time'})}",
        "clock: no time column: rows at 50 Hz",
        time_s=0.01,
    ),
    Oddity(
        "times in units of 100 ns since 1601 or the year 1, as of Windows and .NET",
        "recognised; `100ns` in a TOML file",
        lambda: table_text(
            {**columns(), "time": [str(132_702_448_095_356_149 + round(1e7 * t)) for t in TIME_S.tolist()]}
        ),
        "clock: column 'time', in 100ns",
    ),
    Oddity(
        "acceleration in counts of the sensor",
        "refused with a mapping whose `counts_per_unit` gravity shows",
        counts,
        "are counts of the sensor",
        "",
        is_refused=True,
    ),
    Oddity(
        "rows with `MessageType`, uncalibrated values and their biases",
        "a table for each sensor; biases are subtracted",
        message_types,
        "MeasurementX, MeasurementY, MeasurementZ of UncalAccel",
    ),
    Oddity(
        "Core Motion under other names",
        "the phone's attitude shows the sign",
        core_motion_names,
        "sign: Apple's, as the phone's attitude shows",
    ),
    Oddity(
        "gravity and acceleration of a watch apart, in g",
        "added, with Apple's sign",
        wrist,
        "sign: Apple's, whose gravity is in g",
    ),
    Oddity(
        "JSON with packets of samples that share one time",
        "spread, as packs are",
        json_packets,
        "with one time each",
        time_s=2e-3,
    ),
    Oddity(
        "a file for each hour in the folder of each sensor",
        "files that continue each other within 5 s are one recording",
        hourly,
        "continue each other in time",
        time_s=1e-3,
    ),
    Oddity(
        "columns that nobody knows",
        "refused with a mapping whose columns are taken by their values",
        lambda: table_text({"n": np.arange(N), "wert": TIME_S} | axes("spur_%", FORCE)).replace("_", ""),
        'columns = ["spurx", "spury", "spurz"], unit = "m/s2"',
        "",
        is_refused=True,
    ),
    Oddity(
        "pairs of files of two trials in a folder or zip",
        "each trial is a recording: `walk/walk1`",
        trials,
        "acceleration: x, y, z of walk1_acc",
        path="walk1",
    ),
    Oddity(
        "locations that move on while nobody walks: a car, a bus, a train",
        "the track does not follow them",
        lambda: {"ride.csv": ride()},
        "as in a vehicle",
        "",
    ),
)
