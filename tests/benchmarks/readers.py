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

T0_NS = 1_787_923_304_123_456_789
METADATA = "version,device name,platform,appVersion,sensors,sampleRateMs,standardisation\n3,P,android,1.64,,,false"


def values(n: int, seed: int) -> Iterator[tuple[int, list[float]]]:
    """Row number and three numbers with the digits of a real phone (float32 written as double)."""
    rng = np.random.default_rng(seed)
    for first in range(0, n, 100_000):
        block = rng.normal(size=(min(100_000, n - first), 3)).astype(np.float32).astype(float)
        block[:, 2] += 9.81 if seed == 0 else 0.0
        yield from enumerate(block.tolist(), first)


def write(name: str, folder: Path, n: int, rate_hz: float) -> Path:
    """One recording of n rows a stream in the format, and its path."""
    dt = 1 / rate_hz
    path = folder / name
    if name in ("own", "sensor_logger"):
        path.mkdir()
        files = {"own": ("accelerometer", "gyroscope"), "sensor_logger": ("TotalAcceleration", "Gyroscope")}[name]
        for seed, file in enumerate(files):
            with (path / f"{file}.csv").open("w") as out:
                if name == "own":
                    out.write("time_s,x,y,z\n")
                    out.writelines(f"{i * dt:.6f},{x:.7g},{y:.7g},{z:.7g}\n" for i, (x, y, z) in values(n, seed))
                else:
                    out.write("time,seconds_elapsed,z,y,x\n")
                    out.writelines(
                        f"{T0_NS + i * round(dt * 1e9)},{i * dt:.9f},{z!r},{y!r},{x!r}\n"
                        for i, (x, y, z) in values(n, seed)
                    )
        (path / ("meta.json" if name == "own" else "Metadata.csv")).write_text("{}" if name == "own" else METADATA)
    elif name == "sensor_logger_json":
        path = path.with_suffix(".json")
        with path.open("w") as out:
            out.write('[{"sensor":"Metadata","platform":"android","standardisation":"false"}')
            for seed, sensor in enumerate(("TotalAcceleration", "Gyroscope")):
                out.writelines(
                    f',{{"sensor":"{sensor}","time":"{T0_NS + i * round(dt * 1e9)}","seconds_elapsed":"{i * dt:.6f}",'
                    f'"z":"{z!r}","y":"{y!r}","x":"{x!r}"}}'
                    for i, (x, y, z) in values(n, seed)
                )
            out.write("]")
    elif name == "phyphox":
        path.mkdir()
        for seed, (file, word, unit) in enumerate(
            (("Accelerometer", "Acceleration", "m/s^2"), ("Gyroscope", "Gyroscope", "rad/s"))
        ):
            with (path / f"{file}.csv").open("w") as out:
                out.write('"Time (s)",' + ",".join(f'"{word} {axis} ({unit})"' for axis in "xyz") + "\n")
                out.writelines(f"{i * dt:.9E},{x:.9E},{y:.9E},{z:.9E}\n" for i, (x, y, z) in values(n, seed))
    elif name in ("get_sensor_data", "indoor_location"):
        path = path.with_suffix(".txt")
        with path.open("w") as out:
            for (i, (x, y, z)), (_, (a, b, c)) in zip(values(n, 0), values(n, 1), strict=True):
                t = i * dt
                if name == "get_sensor_data":
                    out.write(
                        f"ACCE;{t:.3f};{t + 9e3:.6f};{x!r};{y!r};{z!r};3\n"
                        f"GYRO;{t:.3f};{t + 9e3:.6f};{a!r};{b!r};{c!r};3\n"
                    )
                else:
                    ms = 1_574_659_531_598 + round(1000 * t)
                    out.write(
                        f"{ms}\tTYPE_ACCELEROMETER\t{x!r}\t{y!r}\t{z!r}\t3\n{ms}\tTYPE_GYROSCOPE\t{a!r}\t{b!r}\t{c!r}\t3\n"
                    )
    elif name == "core_motion":
        path = path.with_suffix(".csv")
        groups = ("gravity", "rotationRate", "userAcceleration")
        with path.open("w") as out:
            out.write("timestamp," + ",".join(f"{group}.{axis}" for group in groups for axis in "xyz") + "\n")
            for (i, (x, y, z)), (_, (a, b, c)) in zip(values(n, 0), values(n, 1), strict=True):
                out.write(
                    f"{i * dt:.6f},0.0,0.0,-1.0,{a!r},{b!r},{c!r},{x / 99:.9g},{y / 99:.9g},{(z - 9.81) / 99:.9g}\n"
                )
    elif name == "generic_csv":
        path = path.with_suffix(".csv")
        with path.open("w") as out:
            out.write("t,ax,ay,az,gx,gy,gz\n")
            for (i, (x, y, z)), (_, (a, b, c)) in zip(values(n, 0), values(n, 1), strict=True):
                out.write(f"{i * dt:.6f},{x!r},{y!r},{z!r},{a!r},{b!r},{c!r}\n")
        path.with_suffix(".toml").write_text(
            '[time]\ncolumn = "t"\n[accelerometer]\ncolumns = ["ax", "ay", "az"]\n'
            '[gyroscope]\ncolumns = ["gx", "gy", "gz"]\n'
        )
    elif name == "table":  # of MATLAB Mobile, with dates
        path.mkdir()
        start = np.datetime64("2023-03-16T20:00:00.000", "ms")
        for seed, sensor in enumerate(("Acceleration", "AngularVelocity")):
            with (path / f"{sensor}.csv").open("w") as out:
                out.write(f"{sensor}_Timestamp,X,Y,Z\n")
                for i, (x, y, z) in values(n, seed):
                    at = str(start + round(1000 * i * dt))
                    out.write(f"{at[8:10]}-Mar-2023 {at[11:]},{x:.7g},{y:.7g},{z:.7g}\n")
    elif name == "ronin":
        import h5py

        path = path.with_suffix(".hdf5")
        rng = np.random.default_rng(0)
        with h5py.File(path, "w") as file:
            file["synced/time"] = np.arange(n) * dt
            file["synced/acce"] = rng.normal(size=(n, 3)) + np.array([0, 0, 9.81])
            file["synced/gyro"] = rng.normal(size=(n, 3))
    else:
        raise SystemExit(f"unknown format {name}")
    return path


FORMATS = (
    "own",
    "sensor_logger",
    "sensor_logger_json",
    "phyphox",
    "get_sensor_data",
    "indoor_location",
    "core_motion",
    "table",
    "generic_csv",
    "ronin",
)


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
