"""How long a four-hour recording at 200 Hz takes to read, and how much memory, for each format.

usage: python -m tests.benchmarks.readers [--hours 4] [--rate 200] [--formats own,sensor_logger,...]

Accelerometer and gyroscope, 2.88 million rows each; the files are written to a temporary folder first. Each format is
read in a process of its own, whose processor time and largest resident memory stand beside the time on the wall.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.benchmarks.common import Tables, run

T0_NS, T0_MS = 1_787_923_304_123_456_789, 1_574_659_531_598
START = np.datetime64("2023-03-16T20:00:00.000", "ms")
METADATA = "version,device name,platform,appVersion,sensors,sampleRateMs,standardisation\n3,P,android,1.64,,,false"
MAPPING = """[time]
column = "t"
[accelerometer]
columns = ["ax", "ay", "az"]
[gyroscope]
columns = ["gx", "gy", "gz"]
"""


def values(n: int, seed: int) -> Iterator[list[float]]:
    """Three numbers for each row, with the digits of a real phone (float32 written as double)."""
    rng = np.random.default_rng(seed)
    for first in range(0, n, 100_000):
        block = rng.normal(size=(min(100_000, n - first), 3)).astype(np.float32).astype(float)
        block[:, 2] += 9.81 if seed == 0 else 0.0
        yield from block.tolist()


# Rows of the formats. x, y, z and a, b, c are the values of the sensors, u, v, w the acceleration of the user in g, t
# is the time in s, and ns, ms, date, late are the times of apps that begin elsewhere.
SENSOR_LOGGER_ROW = "{ns},{t:.9f},{z!r},{y!r},{x!r}\n"
JSON_ROW = ',{{"sensor":"SENSOR","time":"{ns}","seconds_elapsed":"{t:.6f}","z":"{z!r}","y":"{y!r}","x":"{x!r}"}}'
PHYPHOX = '"Time (s)","{0} x ({1})","{0} y ({1})","{0} z ({1})"\n'
CORE_MOTION = [f"{group}.{axis}" for group in ("gravity", "rotationRate", "userAcceleration") for axis in "xyz"]
# Folders with a file for each sensor: names and headers of the files, a row, and a further file.
FOLDERS = {
    "own": (
        dict.fromkeys(("accelerometer.csv", "gyroscope.csv"), "time_s,x,y,z\n"),
        "{t:.6f},{x:.7g},{y:.7g},{z:.7g}\n",
        {"meta.json": "{}"},
    ),
    "sensor_logger": (
        dict.fromkeys(("TotalAcceleration.csv", "Gyroscope.csv"), "time,seconds_elapsed,z,y,x\n"),
        SENSOR_LOGGER_ROW,
        {"Metadata.csv": METADATA},
    ),
    "phyphox": (
        {
            "Accelerometer.csv": PHYPHOX.format("Acceleration", "m/s^2"),
            "Gyroscope.csv": PHYPHOX.format("Gyroscope", "rad/s"),
        },
        "{t:.9E},{x:.9E},{y:.9E},{z:.9E}\n",
        {},
    ),
    "table": (  # file of MATLAB Mobile, with dates
        {f"{sensor}.csv": f"{sensor}_Timestamp,X,Y,Z\n" for sensor in ("Acceleration", "AngularVelocity")},
        "{date},{x:.7g},{y:.7g},{z:.7g}\n",
        {},
    ),
}
# Files with both sensors: suffix, header and a row.
FILES = {
    "get_sensor_data": (
        ".txt",
        "",
        "ACCE;{t:.3f};{late:.6f};{x!r};{y!r};{z!r};3\nGYRO;{t:.3f};{late:.6f};{a!r};{b!r};{c!r};3\n",
    ),
    "indoor_location": (
        ".txt",
        "",
        "{ms}\tTYPE_ACCELEROMETER\t{x!r}\t{y!r}\t{z!r}\t3\n{ms}\tTYPE_GYROSCOPE\t{a!r}\t{b!r}\t{c!r}\t3\n",
    ),
    "core_motion": (
        ".csv",
        ",".join(["timestamp", *CORE_MOTION]) + "\n",
        "{t:.6f},0.0,0.0,-1.0,{a!r},{b!r},{c!r},{u:.9g},{v:.9g},{w:.9g}\n",
    ),
    "generic_csv": (".csv", "t,ax,ay,az,gx,gy,gz\n", "{t:.6f},{x!r},{y!r},{z!r},{a!r},{b!r},{c!r}\n"),
}
FORMATS = (*FOLDERS, *FILES, "sensor_logger_json", "ronin")


def rows(row: str, rate_hz: float, first: Iterator[list[float]], second: Iterator[list[float]]) -> Iterator[str]:
    """Rows of a file with the values of one or of two sensors."""
    for i, ((x, y, z), (a, b, c)) in enumerate(zip(first, second, strict=True)):
        t = i / rate_hz
        known = {"t": t, "ns": T0_NS + round(t * 1e9), "ms": T0_MS + round(1000 * t), "late": t + 9e3}
        if "{date}" in row:
            at = str(START + round(1000 * t))
            known["date"] = f"{at[8:10]}-Mar-2023 {at[11:]}"
        yield row.format(x=x, y=y, z=z, a=a, b=b, c=c, u=x / 99, v=y / 99, w=(z - 9.81) / 99, **known)


def write(name: str, folder: Path, n: int, rate_hz: float) -> Path:
    """One recording of n rows a stream in the format, and its path."""
    if name in FOLDERS:
        headers, row, others = FOLDERS[name]
        path = folder / name
        path.mkdir()
        for seed, (file, header) in enumerate(headers.items()):
            with (path / file).open("w") as out:
                out.write(header)
                out.writelines(rows(row, rate_hz, values(n, seed), values(n, seed)))
        for file, text in others.items():
            (path / file).write_text(text)
    elif name in FILES:
        suffix, header, row = FILES[name]
        path = folder / f"{name}{suffix}"
        with path.open("w") as out:
            out.write(header)
            out.writelines(rows(row, rate_hz, values(n, 0), values(n, 1)))
        if name == "generic_csv":
            path.with_suffix(".toml").write_text(MAPPING)
    elif name == "sensor_logger_json":
        path = folder / f"{name}.json"
        with path.open("w") as out:
            out.write('[{"sensor":"Metadata","platform":"android","standardisation":"false"}')
            for seed, sensor in enumerate(("TotalAcceleration", "Gyroscope")):
                row = JSON_ROW.replace("SENSOR", sensor)
                out.writelines(rows(row, rate_hz, values(n, seed), values(n, seed)))
            out.write("]")
    else:
        import h5py

        path = folder / f"{name}.hdf5"
        rng = np.random.default_rng(0)
        with h5py.File(path, "w") as file:
            file["synced/time"] = np.arange(n) / rate_hz
            file["synced/acce"] = rng.normal(size=(n, 3)) + np.array([0, 0, 9.81])
            file["synced/gyro"] = rng.normal(size=(n, 3))
    return path


def reading(tables: Tables, arguments: argparse.Namespace) -> None:
    """One row for each format."""
    if arguments.read:
        from pdr_filter.data.io.formats import read

        begin, cpu = time.perf_counter(), time.process_time()
        recording = read(arguments.read)
        wall_s, cpu_s = time.perf_counter() - begin, time.process_time() - cpu
        peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
        rows = sum(len(samples) for samples in recording.streams.values())
        print(f"{rows / 1e6:.2f} million|{wall_s:.1f} s|{cpu_s:.1f} s|{peak_gib:.2f} GiB")
        return
    n, found = round(arguments.hours * 3600 * arguments.rate), []
    for name in arguments.formats.split(","):
        with tempfile.TemporaryDirectory() as folder:
            try:
                path = write(name, Path(folder), n, arguments.rate)
            except ImportError as error:
                print(f"{name:20s} not measured: {error}")
                continue
            files = [path] if path.is_file() else list(path.iterdir())
            size = sum(file.stat().st_size for file in files) / 1024**2
            command = [sys.executable, "-m", "tests.benchmarks.readers", "--read", str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            rows, *cost = done.stdout.strip().split("|")
            found.append([f"`{name}`", rows, f"{size:.0f} MiB", *cost])
            print(found[-1], flush=True)
    if arguments.formats != ",".join(FORMATS):
        tables = Tables(tables.command, None)
    about = f"{arguments.hours:g} hours at {arguments.rate:g} Hz, accelerometer and gyroscope."
    tables.write("readers", ["format", "rows", "text", "wall", "processor", "largest memory"], found, about)


if __name__ == "__main__":
    run(__doc__, reading, hours=4.0, rate=200.0, formats=",".join(FORMATS), read=None)
