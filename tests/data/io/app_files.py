"""Writes a recording as the apps would, each in its documented layout: for tests and benchmarks of the readers."""

from __future__ import annotations

import json
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.data.io.formats import read
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Samples
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

T0_NS = 1_787_923_304_123_456_789  # odd in the last digit: a float would round it to a multiple of 256
T0_MS = 1_574_659_531_598


@cache
def a_walk(rate_hz: float = 100.0, seed: int = 3) -> Recording:
    """Twenty metres, a turn and ten metres; the phone in front of the body, screen up."""
    legs = [Leg("walking", distance_m=20.0), Leg("walking", distance_m=10.0, turn_rad=1.2)]
    return simulate(legs, rate_hz=rate_hz, seed=seed)


def on_one_clock(recording: Recording) -> Recording:
    """The same with the gyroscope at the times of the accelerometer, as tables with one row for both have it."""
    assert recording.gyroscope is not None
    time_s, gyroscope = recording.accelerometer.time_s, recording.gyroscope
    values = np.column_stack([np.interp(time_s, gyroscope.time_s, column) for column in gyroscope.values.T])
    return replace(recording, gyroscope=Samples(time_s, values))


def with_level_attitude(recording: Recording) -> Recording:
    """The same with an attitude that has the mean specific force pointing up."""
    up = recording.accelerometer.values.mean(axis=0)
    up /= np.linalg.norm(up)
    axis = np.cross(up, [0.0, 0.0, 1.0])  # turns `up` to z: sine of the angle times the axis
    w = np.sqrt((1 + up[2]) / 2)
    quaternion = np.array([w, *(axis / (2 * w))])
    time_s = recording.accelerometer.time_s
    return replace(recording, attitude=Samples(time_s, np.tile(quaternion, (len(time_s), 1))))


# ---------------------------------------------------------------- Sensor Logger

METADATA = (
    "version,device name,recording epoch time,recording time,recording timezone,platform,appVersion,device id,sensors,"
    "sampleRateMs,standardisation,platform version\n"
    "3,Some Phone,1787923304123,2026-08-28_13-21-44,Europe/Berlin,{platform},1.64,id,"
    "Accelerometer|Gravity|Gyroscope|Magnetometer,{period},{standardisation},17"  # and no final line feed
)


def metadata(platform: str, standardisation: bool = False, period_ms: int = 10) -> str:
    return METADATA.format(
        platform=platform, standardisation=str(standardisation).lower(), period="|".join([str(period_ms)] * 4)
    )


def sensor_logger_csv(samples: Samples, columns: str = "z,y,x", values: np.ndarray | None = None) -> str:
    values = samples.values if values is None else values
    names = columns.split(",")
    natural = {3: ["x", "y", "z"], 4: ["qw", "qx", "qy", "qz"]}[values.shape[1]]
    order = [natural.index(name) for name in names]
    rows = [
        f"{T0_NS + round(t * 1e9)},{t:.9f},{','.join(repr(row[i]) for i in order)}\n"
        for t, row in zip(samples.time_s.tolist(), values.tolist(), strict=True)
    ]
    return f"time,seconds_elapsed,{columns}\n" + "".join(rows)


def sensor_logger_files(
    recording: Recording, platform: str = "android", standardisation: bool = False
) -> dict[str, str]:
    """Android: TotalAcceleration. iOS: Accelerometer and Gravity, whose split does not matter."""
    files = {"Metadata.csv": metadata(platform, standardisation), "Annotation.csv": ""}
    force = recording.accelerometer
    if platform == "android":
        files["TotalAcceleration.csv"] = sensor_logger_csv(force)
    else:
        sign = 1.0 if standardisation else -1.0
        gravity = np.tile(force.values.mean(axis=0), (len(force), 1))
        files["Gravity.csv"] = sensor_logger_csv(force, "y,x,z", sign * gravity)
        files["Accelerometer.csv"] = sensor_logger_csv(force, "z,y,x", sign * (force.values - gravity))
    if recording.gyroscope is not None:
        files["Gyroscope.csv"] = sensor_logger_csv(recording.gyroscope, "x,y,z")
    if recording.magnetometer is not None:
        files["Magnetometer.csv"] = sensor_logger_csv(recording.magnetometer)
    if recording.attitude is not None:
        files["Orientation.csv"] = sensor_logger_csv(recording.attitude, "qx,qz,qw,qy")
    return files


def sensor_logger_json(files: Mapping[str, str]) -> str:
    """The same as the app's JSON: one array of flat objects, numbers as text."""
    objects: list[dict[str, str]] = []
    for name, text in files.items():
        lines = text.splitlines()
        if lines:
            keys = lines[0].split(",")
            objects += [
                {"sensor": name.removesuffix(".csv")} | dict(zip(keys, row.split(","), strict=True))
                for row in lines[1:]
            ]
    return json.dumps(objects, separators=(",", ":"))


# ---------------------------------------------------------------- phyphox

PHYPHOX_TABLES = {
    "accelerometer": ("Accelerometer.csv", "Acceleration", "m/s^2"),
    "gyroscope": ("Gyroscope.csv", "Gyroscope", "rad/s"),
    "magnetometer": ("Magnetometer.csv", "Magnetic field", "\u00b5T"),
}


def phyphox_number(value: float, decimal: str) -> str:
    mantissa, exponent = f"{value:.9E}".split("E")
    return f"{mantissa.replace('.', decimal)}E{int(exponent)}"


def phyphox_table(samples: Samples, name: str, unit: str, separator: str = ",", decimal: str = ".") -> str:
    header = separator.join(['"Time (s)"', *(f'"{name} {axis} ({unit})"' for axis in "xyz")])
    rows = [
        separator.join(phyphox_number(v, decimal) for v in (t, *row)) + "\n"
        for t, row in zip(samples.time_s.tolist(), samples.values.tolist(), strict=True)
    ]
    return header + "\n" + "".join(rows)


def phyphox_files(recording: Recording, separator: str = ",", decimal: str = ".") -> dict[str, str]:
    streams = recording.streams
    files = {
        file: phyphox_table(streams[stream], name, unit, separator, decimal)
        for stream, (file, name, unit) in PHYPHOX_TABLES.items()
        if stream in streams
    }
    s = separator
    files["meta/device.csv"] = f'"property"{s}"value"\n"version"{s}"1.1.16"\n"deviceModel"{s}"Some Phone"\n'
    files["meta/time.csv"] = (
        f'"event"{s}"experiment time"{s}"system time"{s}"system time text"\n'
        f'"START"{s}{phyphox_number(0.0, decimal)}{s}1770000000{decimal}250{s}"2026-02-02 02:40:00.250 UTC+00:00"\n'
        f'"PAUSE"{s}{phyphox_number(30.0, decimal)}{s}1770000030{decimal}250{s}"2026-02-02 02:40:30.250 UTC+00:00"\n'
    )
    return files


# ---------------------------------------------------------------- GetSensorData, indoor location

GET_SENSOR_DATA_HEADER = """% LogFile created by the 'GetSensorData' App for Android.
% Date of creation: Fri Jan 12 10:00:00 CET 2018
% Version 2.1 January 2018
% Phone used for this logfile:
% Manufacturer:            \tSome
% Model:                   \tPhone
% LogFile Data format:
% Accelerometer: \t'ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy(integer)'
% Orientation data:   \t'AHRS;AppTimestamp(s);SensorTimestamp(s);PitchX(\u00ba);RollY(\u00ba);YawZ(\u00ba);...'
"""


def get_sensor_data_text(
    recording: Recording,
    scale: float = 1.0,
    boot_s: float = 81_234.5,
    positions: tuple[tuple[float, float, float, float], ...] = (),
) -> str:
    """App time is the sensor's time minus `boot_s`, late by up to 8 ms."""
    rng = np.random.default_rng(0)
    lines: list[tuple[float, str]] = []
    for tag, stream in (("ACCE", "accelerometer"), ("GYRO", "gyroscope"), ("MAGN", "magnetometer")):
        samples = recording.streams.get(stream)
        if samples is not None:
            factor = scale if tag == "ACCE" else 1.0
            for t, row in zip(samples.time_s.tolist(), (samples.values * factor).tolist(), strict=True):
                app_s = t + rng.uniform(0, 0.008)
                lines.append((app_s, f"{tag};{app_s:.3f};{t + boot_s:.6f};{row[0]!r};{row[1]!r};{row[2]!r};3"))
    if recording.attitude is not None:
        for t, q in zip(recording.attitude.time_s.tolist(), recording.attitude.values.tolist(), strict=True):
            lines.append((t, f"AHRS;{t:.3f};{t + boot_s:.6f};1.0;2.0;3.0;{q[1]!r};{q[2]!r};{q[3]!r};3"))
    lines.append((0.5, "WIFI;0.500;81235.0;Some Net;aa:bb:cc:dd:ee:ff;-61"))
    for i, (t, latitude, longitude, floor) in enumerate(positions):
        lines.append((t, f"POSI;{t:.3f};{i + 1};{latitude!r};{longitude!r};{floor:g};20"))
    return GET_SENSOR_DATA_HEADER + "".join(line + "\n" for _, line in sorted(lines, key=lambda item: item[0]))


INDOOR_TAGS = {
    "accelerometer": "TYPE_ACCELEROMETER",
    "gyroscope": "TYPE_GYROSCOPE",
    "magnetometer": "TYPE_MAGNETIC_FIELD",
}


def indoor_location_text(recording: Recording, waypoints: tuple[tuple[float, float, float], ...] = ()) -> str:
    lines: list[tuple[int, str]] = []
    for stream, tag in INDOOR_TAGS.items():
        samples = recording.streams.get(stream)
        if samples is not None:
            for t, row in zip(samples.time_s.tolist(), samples.values.tolist(), strict=True):
                ms = T0_MS + round(t * 1000)
                lines.append((ms, f"{tag}\t{row[0]!r}\t{row[1]!r}\t{row[2]!r}\t3"))
                if stream == "accelerometer":
                    lines.append((ms, f"{tag}_UNCALIBRATED\t99.0\t99.0\t99.0\t0.0\t0.0\t0.0\t3"))
    if recording.attitude is not None:
        for t, q in zip(recording.attitude.time_s.tolist(), recording.attitude.values.tolist(), strict=True):
            lines.append((T0_MS + round(t * 1000), f"TYPE_ROTATION_VECTOR\t{q[1]!r}\t{q[2]!r}\t{q[3]!r}\t3"))
    lines.append((T0_MS + 500, "TYPE_WIFI\tnet\taa:bb:cc:dd:ee:ff\t-61\t5805\t1574659532305"))
    for t, x, y in waypoints:
        lines.append((T0_MS + round(t * 1000), f"TYPE_WAYPOINT\t{x!r}\t{y!r}"))
    body = "".join(f"{ms}\t{line}\n" for ms, line in sorted(lines, key=lambda item: item[0]))
    header = (
        f"#\tstartTime:{T0_MS}\n#\tSiteID:abc\tSiteName:Mall\tFloorId:f\tFloorName:F2\n#\tBrand:SOME\tModel:Phone\n"
    )
    return header + body + "#\tendTime:1574659561598"


# ---------------------------------------------------------------- CoreMotion, generic

CORE_MOTION_HEADER = (
    ",attitude.roll,attitude.pitch,attitude.yaw,gravity.x,gravity.y,gravity.z,rotationRate.x,rotationRate.y,"
    "rotationRate.z,userAcceleration.x,userAcceleration.y,userAcceleration.z\n"
)


def core_motion_text(recording: Recording) -> str:
    """At 50 Hz, in g and with Apple's sign; gravity is the mean, and the angles are those of that mean."""
    force_g = -recording.accelerometer.values / STANDARD_GRAVITY_MPS2
    gravity = force_g.mean(axis=0) / np.linalg.norm(force_g.mean(axis=0))
    pitch, roll = np.arcsin(-gravity[1]), np.arctan2(gravity[0], -gravity[2])  # gravity = (sr cp, -sp, -cr cp)
    rate = recording.gyroscope.values if recording.gyroscope is not None else np.zeros_like(force_g)
    rows = [
        ",".join([str(i), repr(float(roll)), repr(float(pitch)), "0.3", *map(repr, [*gravity.tolist(), *w, *a])]) + "\n"
        for i, (w, a) in enumerate(zip(rate.tolist(), (force_g - gravity).tolist(), strict=True))
    ]
    return CORE_MOTION_HEADER + "".join(rows)


def generic_text(recording: Recording) -> str:
    """Milliseconds, g with Apple's sign, deg/s; the gyroscope in every row."""
    force_g = -recording.accelerometer.values / STANDARD_GRAVITY_MPS2
    rows = zip(
        recording.accelerometer.time_s.tolist(),
        force_g.tolist(),
        np.degrees(recording.gyroscope.values).tolist(),
        strict=True,
    )
    return "t;ax;ay;az;gx;gy;gz\n" + "".join(
        ";".join(map(repr, [round(1000 * t, 6), *a, *w])) + "\n" for t, a, w in rows
    )


GENERIC_MAPPING = """
[time]
column = "t"
unit = "ms"
[accelerometer]
columns = ["ax", "ay", "az"]
unit = "g"
sign = -1
[gyroscope]
columns = ["gx", "gy", "gz"]
unit = "deg/s"
"""


# ---------------------------------------------------------------- tables of other apps


def table_text(columns: Mapping[str, np.ndarray | list[str]], separator: str = ",", decimal: str = ".") -> str:
    """A table with these columns, numbers with all their digits."""
    fields = [
        list(column) if isinstance(column, list) else [repr(v).replace(".", decimal) for v in column.tolist()]
        for column in columns.values()
    ]
    rows = [separator.join(row) + "\n" for row in zip(*fields, strict=True)]
    return separator.join(columns) + "\n" + "".join(rows)


def axes(names: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of three axes, `names` with % in place of the axis."""
    return {names.replace("%", axis): values[:, i] for i, axis in enumerate("xyz")}


def wall_clock(time_s: np.ndarray) -> list[str]:
    """Dates as MATLAB Mobile writes them, with more digits."""
    start = np.datetime64("2023-03-16T23:59:58", "us")  # midnight lies within
    dates = [str(start + np.timedelta64(round(t * 1e6), "us")) for t in time_s.tolist()]
    return [
        f"{d[8:10]}-Mar-{d[:4]} {d[11:]}" if len(d) > 19 else f"{d[8:10]}-Mar-{d[:4]} {d[11:]}.000000" for d in dates
    ]


def physics_toolbox_text(recording: Recording) -> str:
    """Blank first line, g, a comma at the end of each line."""
    force_g = recording.accelerometer.values / STANDARD_GRAVITY_MPS2
    still = 0.0 * force_g
    columns = axes("gF%", force_g) | axes("a%", still) | axes("w%", recording.gyroscope.values)
    return "\n" + table_text({"time": recording.accelerometer.time_s, **columns}).replace("\n", ",\n")


def matlab_mobile_files(recording: Recording) -> dict[str, str]:
    names = {"accelerometer": "Acceleration", "gyroscope": "AngularVelocity", "magnetometer": "MagneticField"}
    return {
        f"{name}.csv": table_text(
            {
                f"{name}_Timestamp": wall_clock(samples.time_s),
                **{k.upper(): v for k, v in axes("%", samples.values).items()},
            }
        )
        for stream, name in names.items()
        if (samples := recording.streams.get(stream)) is not None
    }


def write_mat(path: Path, recording: Recording) -> Path:
    """Plain columns, compressed."""
    from scipy.io import savemat

    columns = {"t": recording.accelerometer.time_s[:, None], "Acceleration": recording.accelerometer.values}
    if recording.gyroscope is not None:
        columns["AngularVelocity"] = recording.gyroscope.values
    savemat(path, columns, appendmat=False, do_compression=True)
    return path


WORKBOOK = (
    '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" '
    'xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets>{sheets}</sheets></workbook>'
)
RELATIONS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">{inside}</Relationships>'
)
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"


def xlsx_files(sheets: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, str]:
    """The files of a spreadsheet."""
    files: dict[str, str] = {}
    listed = links = ""
    for n, (name, columns) in enumerate(sheets.items(), 1):
        rows = [[f"<is><t>{key}</t></is>" for key in columns]]
        rows += [[f"<v>{v!r}</v>" for v in row] for row in np.column_stack([*columns.values()]).tolist()]
        cells = "".join(
            f'<row r="{i}">'
            + "".join(
                f'<c r="{chr(65 + j)}{i}"{" t=" + chr(34) + "inlineStr" + chr(34) if i == 1 else ""}>{cell}</c>'
                for j, cell in enumerate(row)
            )
            + "</row>"
            for i, row in enumerate(rows, 1)
        )
        main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
        files[f"xl/worksheets/sheet{n}.xml"] = f'<worksheet xmlns="{main}"><sheetData>{cells}</sheetData></worksheet>'
        listed += f'<sheet name="{name}" sheetId="{n}" r:id="rId{n}"/>'
        links += f'<Relationship Id="rId{n}" Type="{OFFICE}/worksheet" Target="worksheets/sheet{n}.xml"/>'
    files["xl/workbook.xml"] = WORKBOOK.format(sheets=listed)
    files["xl/_rels/workbook.xml.rels"] = RELATIONS.format(inside=links)
    root = f'<Relationship Id="rId1" Type="{OFFICE}/officeDocument" Target="xl/workbook.xml"/>'
    files["_rels/.rels"] = RELATIONS.format(inside=root)
    types = "http://schemas.openxmlformats.org/package/2006/content-types"
    files["[Content_Types].xml"] = (
        f'<Types xmlns="{types}"><Default Extension="xml" ContentType="application/xml"/></Types>'
    )
    return files


def phyphox_sheets(recording: Recording) -> dict[str, dict[str, np.ndarray]]:
    """What phyphox puts into a spreadsheet: a sheet for each sensor."""
    return {
        file.removesuffix(".csv"): {"Time (s)": samples.time_s, **axes(f"{name} % ({unit})", samples.values)}
        for stream, (file, name, unit) in PHYPHOX_TABLES.items()
        if (samples := recording.streams.get(stream)) is not None
    }


# ---------------------------------------------------------------- pushed messages, databases, ROS


def push_messages(files: Mapping[str, str], session: str = "one", rows_each: int = 7) -> list[dict[str, object]]:
    """What Sensor Logger pushes of the same recording as its CSV files."""
    items = []
    for name, text in files.items():
        lines = text.splitlines()
        if lines and lines[0].startswith("time,"):
            keys = lines[0].split(",")
            for line in lines[1:]:
                row = dict(zip(keys, line.split(","), strict=True))
                values = {key: float(value) for key, value in row.items() if key not in ("time", "seconds_elapsed")}
                items.append({"name": name.removesuffix(".csv").lower(), "time": int(row["time"]), "values": values})
    items.sort(key=lambda item: item["time"])
    return [
        {"messageId": i, "sessionId": session, "deviceId": "d", "payload": items[n : n + rows_each]}
        for i, n in enumerate(range(0, len(items), rows_each))
    ]


def write_sqlite(path: Path, files: Mapping[str, str]) -> Path:
    """Sensor Logger's database: a table for each of its CSV files."""
    import sqlite3

    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as connection:
        for name, text in files.items():
            rows = [line.split(",") for line in text.splitlines()]
            if rows:
                table = name.removesuffix(".csv")
                connection.execute(f'CREATE TABLE "{table}" ({", ".join(f"[{key}] TEXT" for key in rows[0])})')
                connection.executemany(f'INSERT INTO "{table}" VALUES ({",".join("?" * len(rows[0]))})', rows[1:])
    connection.close()
    return path


def cdr_header(at_ns: int, frame: str = "imu") -> bytes:
    name = frame.encode() + b"\x00"
    stamp = struct.pack("<iII", at_ns // 10**9, at_ns % 10**9, len(name)) + name
    return stamp + b"\x00" * (-len(stamp) % 8)


def imu_messages(recording: Recording, frame: str = "imu") -> list[tuple[int, bytes]]:
    """Times and CDR of `sensor_msgs/msg/Imu`."""
    n = len(recording.accelerometer)
    quaternion = np.zeros((n, 4)) if recording.attitude is None else recording.attitude.values[:, [1, 2, 3, 0]]
    found = []
    for t, q, w, a in zip(
        recording.accelerometer.time_s.tolist(),
        quaternion.tolist(),
        recording.gyroscope.values.tolist(),
        recording.accelerometer.values.tolist(),
        strict=True,
    ):
        at_ns = T0_NS + round(t * 1e9)
        numbers = [*q, *[0.0] * 9, *w, *[0.0] * 9, *a, *[0.0] * 9]
        found.append((at_ns, b"\x00\x01\x00\x00" + cdr_header(at_ns, frame) + struct.pack("<37d", *numbers)))
    return found


def write_mcap(path: Path, messages: list[tuple[int, bytes]], kind: str = "sensor_msgs/msg/Imu") -> Path:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema(kind, "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        for i, (at_ns, content) in enumerate(messages):
            writer.add_message(channel, at_ns, content, at_ns, i)
        writer.finish()
    return path


def write_db3(path: Path, messages: list[tuple[int, bytes]], kind: str = "sensor_msgs/msg/Imu") -> Path:
    import sqlite3

    path.unlink(missing_ok=True)
    with sqlite3.connect(path) as connection:
        connection.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
        )
        connection.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        connection.execute("INSERT INTO topics VALUES (1, '/imu', ?, 'cdr')", (kind,))
        connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", messages)
    connection.close()
    return path


# ---------------------------------------------------------------- writing, comparing


def write_text(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


def write_folder(path: Path, files: Mapping[str, str | bytes]) -> Path:
    for name, content in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def write_zip(
    path: Path, files: Mapping[str, str | bytes], folder: str = "", compression: int = zipfile.ZIP_DEFLATED
) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in files.items():
            archive.writestr(folder + name, content)
    return path


def read_columns(folder: Path, *columns: Mapping[str, np.ndarray | list[str]]) -> Recording:
    """The recording of a table, of all these columns, in a file."""
    return read(write_columns(folder, *columns))


def write_columns(folder: Path, *columns: Mapping[str, np.ndarray | list[str]]) -> Path:
    return write_text(folder / "walk.csv", table_text({name: part[name] for part in columns for name in part}))


def refusal(path: Path, format: str | None = None, platform: str | None = None) -> str:
    """The message with which a path is refused."""
    with pytest.raises(RecordingError) as caught:
        read(path, format, platform)
    assert isinstance(caught.value, ValueError)
    return str(caught.value)


def assert_same_streams(actual: Recording, expected: Recording, names: str, time_s: float, rtol: float = 1e-6) -> None:
    """The named streams agree: times to `time_s`, values to `rtol` of the largest one."""
    for name in names.split():
        ours, theirs = actual.streams[name], expected.streams[name]
        zero_s = expected.accelerometer.time_s[0]
        np.testing.assert_allclose(ours.time_s, theirs.time_s - zero_s, rtol=0, atol=time_s, err_msg=name)
        np.testing.assert_allclose(
            ours.values, theirs.values, rtol=0, atol=rtol * np.abs(theirs.values).max(), err_msg=name
        )


def assert_same_bits(actual: Recording, expected: Recording) -> None:
    """All streams have the same times and values."""
    assert actual.streams.keys() == expected.streams.keys()
    for name, samples in expected.streams.items():
        np.testing.assert_array_equal(actual.streams[name].time_s, samples.time_s, err_msg=name)
        np.testing.assert_array_equal(actual.streams[name].values, samples.values, err_msg=name)
