"""Good files of every format, small, and what can happen to them: cut off, changed, absurd numbers, encodings."""

from __future__ import annotations

import json
import os
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from app_files import (
    GENERIC_MAPPING,
    core_motion_text,
    generic_text,
    get_sensor_data_text,
    imu_messages,
    indoor_location_text,
    matlab_mobile_files,
    metadata,
    phyphox_files,
    phyphox_sheets,
    physics_toolbox_text,
    push_messages,
    sensor_logger_files,
    sensor_logger_json,
    with_level_attitude,
    write_db3,
    write_mat,
    write_mcap,
    write_sqlite,
    write_text,
    write_zip,
    xlsx_files,
)

from pdr_filter.data.io.describe import median_norm, reading_report
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.values import Samples
from pdr_filter.values.limits import LARGEST_VALUE, SPECIFIC_FORCE_RANGE_MPS2
from pdr_filter.values.recording import Recording

N = 24


def small_recording() -> Recording:
    """A quarter of a second in which the phone swings a little."""
    rng = np.random.default_rng(0)
    time_s = np.arange(N) / 100
    force = Samples(time_s, rng.normal(size=(N, 3)) + np.array([0.0, 3.0, 9.3]))
    rate = Samples(time_s, rng.normal(size=(N, 3)))
    recording = Recording("small", force, gyroscope=rate, magnetometer=Samples(time_s, 20 * rng.normal(size=(N, 3))))
    return with_level_attitude(recording)


def good_file(name: str, folder: Path) -> Path:
    """One good file of a format in a folder; `name` may say which of its forms, after a colon."""
    return file_of(name, small_recording(), folder)


def logged(recording: Recording, platform: str = "android") -> dict[str, str]:
    """Files of Sensor Logger."""
    return sensor_logger_files(recording, platform) | {"Metadata.csv": metadata(platform)}


def json_text(recording: Recording) -> str:
    """A line for each sample, with both sensors."""
    force, rate = recording.accelerometer, recording.gyroscope
    rows = zip(force.time_s.tolist(), force.values.tolist(), rate.values.tolist(), strict=True)
    return "\n".join(json.dumps({"timestamp": 1000 + t, "accelerometer": f, "gyroscope": r}) for t, f, r in rows)


def phyphox_text(recording: Recording) -> str:
    files = phyphox_files(recording, ";", ",")
    return "".join(text for name, text in files.items() if "meta" not in name)


def write_generic(path: Path, recording: Recording) -> Path:
    path.with_suffix(".toml").write_text(GENERIC_MAPPING)
    return write_text(path, generic_text(recording))


def write_ronin(path: Path, recording: Recording) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        file["synced/time"] = recording.accelerometer.time_s
        file["pose/tango_pos"] = 0 * recording.accelerometer.values
        names = {"acce": "accelerometer", "gyro": "gyroscope", "magnet": "magnetometer", "game_rv": "attitude"}
        for name, stream in names.items():
            if stream in recording.streams:
                file[f"synced/{name}"] = recording.streams[stream].values
    return path


POSITIONS = ((0.1, 40.0, -3.0, 0.0), (0.2, 40.001, -3.0, 1.0))
# Each form of a format, the suffix of its file, and a function that writes a recording as that app does.
WRITERS: dict[str, tuple[str, Callable[[Path, Recording], Path]]] = {
    "own": (".zip", lambda path, r: write_recording(r, path)),
    "sensor_logger:android": (".zip", lambda path, r: write_zip(path, logged(r))),
    "sensor_logger:ios": (".zip", lambda path, r: write_zip(path, logged(r, "ios"))),
    "sensor_logger:json": (".json", lambda path, r: write_text(path, sensor_logger_json(logged(r)))),
    "sensor_logger:push": (
        ".json",
        lambda path, r: write_text(path, "\n".join(map(json.dumps, reversed(push_messages(logged(r)))))),
    ),
    "sensor_logger:sqlite": (".sqlite", lambda path, r: write_sqlite(path, logged(r))),
    "phyphox:zip": (".zip", lambda path, r: write_zip(path, phyphox_files(r, ";", ","))),
    "phyphox:csv": (".csv", lambda path, r: write_text(path, phyphox_text(r))),
    "get_sensor_data": (
        ".txt",
        lambda path, r: write_text(path, get_sensor_data_text(r, positions=POSITIONS), "latin-1"),
    ),
    "indoor_location": (".txt", lambda path, r: write_text(path, indoor_location_text(r, ((0.1, 3.0, 4.0),)))),
    "core_motion": (".csv", lambda path, r: write_text(path, core_motion_text(r))),
    "table:physics_toolbox": (".csv", lambda path, r: write_text(path, physics_toolbox_text(r))),
    "table:matlab_mobile": (".zip", lambda path, r: write_zip(path, matlab_mobile_files(r))),
    "table:json": (".json", lambda path, r: write_text(path, json_text(r))),
    "table:mat": (".mat", write_mat),
    "table:xlsx": (".xlsx", lambda path, r: write_zip(path, xlsx_files(phyphox_sheets(r)))),
    "ros_bag:mcap": (".mcap", lambda path, r: write_mcap(path, imu_messages(r))),
    "ros_bag:db3": (".db3", lambda path, r: write_db3(path, imu_messages(r))),
    "generic_csv": (".csv", write_generic),
    "ronin": (".hdf5", write_ronin),
}
FORMS = tuple(WRITERS)


def file_of(name: str, recording: Recording, folder: Path) -> Path:
    """A recording as the app of that format would have written it."""
    suffix, write = WRITERS[name]
    return write(folder / f"good{suffix}", recording)


ABSURD = [*b'1e308 -1e308 1e309 nan inf x 1_0 0x10 99999999999999999999 " -'.split(), b""]
LINE_ENDS = [b"\n", b"\r\n", b"\r", b"\x00", b"\x0b", b"\n\n", b";", b",", b"\t", b'"', b"},{", b"#", b"%"]
ENCODINGS = ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "cp037"]


def truncated(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def with_flipped_bits(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 8, 64])):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def with_absurd_numbers(data: bytes, rng: random.Random) -> bytes:
    found = list(re.finditer(rb"-?\d[\d.eE+-]*", data))
    if not found:
        return with_flipped_bits(data, rng)
    value, every = rng.choice(ABSURD), rng.choice([1, 2, 5, len(found)])
    first = rng.randrange(min(every, len(found)))
    parts, at = [], 0
    for match in found[first::every]:
        parts += [data[at : match.start()], value]
        at = match.end()
    return b"".join([*parts, data[at:]])


def with_pieces_moved(data: bytes, rng: random.Random) -> bytes:
    """A piece is repeated, taken away or put elsewhere."""
    begin = rng.randrange(len(data))
    piece = data[begin : begin + rng.choice([1, 10, 100, 1000])]
    rest = data[:begin] + data[begin + len(piece) :]
    to = rng.randrange(len(rest) + 1)
    return rng.choice([rest, rest[:to] + piece + rest[to:], data[:begin] + piece * rng.choice([2, 50]) + data[begin:]])


def with_other_marks(data: bytes, rng: random.Random) -> bytes:
    old, new = rng.choice(LINE_ENDS), rng.choice(LINE_ENDS)
    return data.replace(old, new, rng.choice([-1, 1, 3])) if old in data else data[:50] + new + data[50:]


def in_another_encoding(data: bytes, rng: random.Random) -> bytes:
    return data.decode("latin-1").encode(rng.choice(ENCODINGS), "replace")


def with_lines_shuffled(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    for _ in range(rng.choice([1, 5, len(lines)])):
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i], lines[j] = lines[j], rng.choice([lines[i], lines[j], b"", lines[i][: len(lines[i]) // 2]])
    return b"\n".join(lines)


def with_a_long_run(data: bytes, rng: random.Random) -> bytes:
    """One byte many times, inside a field or a name."""
    at = rng.randrange(min(len(data), rng.choice([60, len(data)])))
    return (
        data[:at]
        + rng.choice([b" ", b'"', b",", b"\n", b"(", b"0", b"[", b"{},"]) * rng.choice([10**3, 10**5])
        + data[at:]
    )


def with_a_line_repeated(data: bytes, rng: random.Random) -> bytes:
    """A line so often that it becomes a megabyte, whole or with nothing in its fields."""
    lines = data.split(b"\n")
    line = rng.choice(lines)
    if rng.random() < 0.5:
        line = re.sub(rb"[^,;\t]+", b"", line)
    at = rng.randrange(len(lines))
    return b"\n".join([*lines[:at], *[line] * (10**6 // (len(line) + 1)), *lines[at:]])


MUTATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    truncated,
    with_flipped_bits,
    with_absurd_numbers,
    with_pieces_moved,
    with_other_marks,
    in_another_encoding,
    with_lines_shuffled,
)
LARGE_MUTATIONS = (with_a_long_run, with_a_line_repeated)
CANARY = 31415.9265  # a number of a file that nobody gave to a reader


def a_mutation(rng: random.Random) -> Callable[[bytes, random.Random], bytes]:
    """One of a hundred makes the file large."""
    return rng.choice(LARGE_MUTATIONS if rng.random() < 0.01 else MUTATIONS)


def mutated_file(good: Path, folder: Path, rng: random.Random) -> Path:
    """A mutation of a good file: of its bytes, or of one member of a zip, which is then packed again."""
    if zipfile.is_zipfile(good) and rng.random() < 0.7:  # otherwise nearly all end at the checksum
        with zipfile.ZipFile(good) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
        victim = rng.choice(sorted(files))
        if files[victim]:
            files[victim] = a_mutation(rng)(files[victim], rng)
        if rng.random() < 0.05:
            files[rng.choice(["../evil.csv", "/etc/evil.csv", "a\\..\\..\\evil.csv", "C:/evil.csv"])] = b"x"
        if rng.random() < 0.05:
            del files[victim]
        return write_zip(folder / good.name, files)
    data = good.read_bytes()
    for _ in range(rng.choice([1, 1, 2])):
        data = a_mutation(rng)(data, rng) if data else data
    path = folder / good.name
    path.write_bytes(data)
    return path


def of_another_kind(good: Path, folder: Path, elsewhere: Path, rng: random.Random) -> Path:
    """A good file, unpacked if it is a zip, of which one is a pipe, a device, or a link to a copy of it elsewhere."""
    if zipfile.is_zipfile(good):
        path = folder / "unpacked"
        with zipfile.ZipFile(good) as archive:
            archive.extractall(path)
        victim = rng.choice(sorted(entry for entry in path.rglob("*") if entry.is_file()))
    elif good.suffix == ".hdf5" and rng.random() < 0.7:
        return kept_elsewhere(good, folder, elsewhere, rng)
    else:
        path = folder / "unpacked"
        path.mkdir()
        victim = path / {".hdf5": "data.hdf5"}.get(good.suffix, good.name)
        victim.write_bytes(good.read_bytes())
    kind = rng.choice(["pipe", "device", "link"])
    if kind == "link":
        victim.rename(elsewhere / "original")
        victim.symlink_to(elsewhere / "original")
    else:
        victim.unlink()
        os.mkfifo(victim) if kind == "pipe" else victim.symlink_to(rng.choice(["/dev/zero", "/dev/urandom"]))
    return victim if kind != "link" and rng.random() < 0.5 else path


def kept_elsewhere(good: Path, folder: Path, elsewhere: Path, rng: random.Random) -> Path:
    """An hdf5 file of which a data set or a group is in another file."""
    import h5py

    path = folder / good.name
    path.write_bytes(good.read_bytes())
    with h5py.File(elsewhere / "other.hdf5", "w") as other:
        other["synced/time"] = np.arange(N) / 100
        other["synced/acce"] = other["synced/magnet"] = np.full((N, 3), CANARY)
    (elsewhere / "raw").write_bytes(np.full((N, 3), CANARY).tobytes())
    where = str(elsewhere / "other.hdf5")
    name = rng.choice(["synced/acce", "synced/magnet"])
    with h5py.File(path, "a", libver="latest") as file:
        kind = rng.choice(["group", "link", "soft", "external", "virtual"])
        del file["synced" if kind == "group" else name]
        if kind == "group":
            file["synced"] = h5py.ExternalLink(where, "synced")
        elif kind == "link":
            file[name] = h5py.ExternalLink(where, name)
        elif kind == "soft":
            file["elsewhere"] = h5py.ExternalLink(where, "synced")
            file[name] = h5py.SoftLink(f"/elsewhere/{name.partition('/')[2]}")
        elif kind == "external":
            file.create_dataset(name, (N, 3), "f8", external=[(str(elsewhere / "raw"), 0, N * 24)])
        else:
            layout = h5py.VirtualLayout((N, 3), "f8")
            layout[:] = h5py.VirtualSource(where, name, (N, 3))
            file.create_virtual_dataset(name, layout)
    return path


# ---------------------------------------------------------------- what a reader may do with them


def faults_of_refusal(message: str, path: Path) -> list[str]:
    """What is wrong with a refusal: it must name the file, or the TOML file beside it, and say more than that."""
    faults = [] if path.name in message or path.with_suffix(".toml").name in message else ["does not name the file"]
    if len(message.replace(str(path), "").strip(": ")) < 10:
        faults.append("says nothing")
    return faults


def faults_of_recording(recording: Recording, format: str | None) -> list[str]:
    """What is inconsistent in a recording and its reading report; nothing if all is well."""
    faults: list[str] = []
    report = reading_report(recording)
    if {s.name: s.n_samples for s in report.streams} != {name: len(s) for name, s in recording.streams.items()}:
        faults.append("the report counts other samples")
    for stream in report.streams:
        counts = (stream.n_gaps, stream.n_duplicates, stream.n_backward)
        if min(counts) < 0 or sum(counts[1:]) >= max(stream.n_samples, 1) or not stream.longest_gap_s >= 0:
            faults.append(f"{stream.name}: the report counts more or less than there can be")
    if report.notes != recording.notes:
        faults.append("the report has other notes")
    if format is not None and SOURCES[format] not in report.source:
        faults.append(f"read as {report.source}")
    json.dumps(report.as_dict(), allow_nan=False)
    for name, samples in recording.streams.items():
        if not np.isfinite(samples.time_s).all() or len(samples.time_s) != len(samples.values):
            faults.append(f"{name}: times that are not finite, or not one for each row")
        if not (np.isnan(samples.values) | (np.abs(samples.values) <= LARGEST_VALUE)).all():
            faults.append(f"{name}: absurd values")
    if any((samples.values == CANARY).any() for samples in recording.streams.values()):
        faults.append("holds what is in another file")
    median = median_norm(recording.accelerometer.values)
    if not SPECIFIC_FORCE_RANGE_MPS2[0] <= median <= SPECIFIC_FORCE_RANGE_MPS2[1]:
        faults.append(f"median specific force {median}")
    return faults


# How the report names each format.
SOURCES = {
    "own": "own format",
    "sensor_logger": "Sensor Logger",
    "phyphox": "phyphox",
    "get_sensor_data": "GetSensorData",
    "indoor_location": "indoor-location",
    "core_motion": "CoreMotion",
    "generic_csv": "CSV",
    "table": "table",
    "ros_bag": "ROS 2 bag",
    "ronin": "RoNIN",
}
