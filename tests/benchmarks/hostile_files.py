"""Hostile files, and what a reader, a writer or the command makes of each: outcome, time and memory, before and after.

usage: python -m tests.benchmarks.hostile_files [--before FOLDER] [--cases NAME,...]

Each case is written to a folder of its own and tried in a process of its own, which may take 60 s and 8 GiB; `--before`
is a checkout of an earlier version, whose column is left out without it.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

SECRET = "root:x:0:0:"  # begins the file of the machine that no recording may hold
MOST_S, MOST_BYTES = 60.0, 8 << 30
_CSV = "accelerometer.csv"
_CASES: dict[str, tuple[str, Callable[[Path], str]]] = {}  # what it is, and what it does in a folder


def case(what: str) -> Callable[[Callable[[Path], str]], Callable[[Path], str]]:
    """Put a function among the cases, under its name."""

    def named(function: Callable[[Path], str]) -> Callable[[Path], str]:
        _CASES[function.__name__] = (what, function)
        return function

    return named


_SPENT_S: list[float] = []  # on reading, not on writing what is read

# --- files -----------------------------------------------------------------------------------------------------------


def rows(n: int = 200) -> str:
    """Samples of a phone that lies still."""
    return "time_s,x,y,z\n" + "".join(f"{i / 100:.2f},0.1,0.2,9.8\n" for i in range(n))


def zipped(path: Path, **members: Iterator[bytes] | str) -> Path:
    """A zip file of the own format with these members, each in pieces."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {"accelerometer": rows(), **members}.items():
            with archive.open(name + (".json" if name == "meta" else ".csv"), "w", force_zip64=True) as file:
                for piece in [content.encode()] if isinstance(content, str) else content:
                    file.write(piece)
    return path


def hdf5(path: Path, n: int = 200) -> Path:
    """A good file of RoNIN without magnetometer."""
    import h5py

    with h5py.File(path, "w") as file:
        file["synced/time"] = np.arange(n) / 200
        file["synced/acce"] = np.tile([0.1, 0.2, 9.8], (n, 1))
    return path


def reading(path: Path, format: str | None = None) -> str:
    """What reading it comes to, and whether a byte of a file of the machine is in it."""
    from pdr_filter.io.files.errors import RecordingError
    from pdr_filter.io.formats import read

    begin = time.perf_counter()
    try:
        recording = read(path, format)
    except RecordingError as error:
        return "refused" + (", with bytes of another file" if SECRET in str(error) else "")
    finally:
        _SPENT_S.append(time.perf_counter() - begin)
    values = b"".join(samples.values.tobytes() for samples in recording.streams.values())
    as_bytes = bytes(int(v) & 255 for v in np.frombuffer(values) if np.isfinite(v) and 0 <= v < 256)
    found = SECRET.encode() in values or SECRET.encode() in as_bytes
    return "read" + (", with bytes of another file" if found else "")


def command(*words: str) -> str:
    """What the command writes to a terminal."""
    import pty

    leader, follower = pty.openpty()
    code = [sys.executable, "-c", "from pdr_filter.cli.app import app; app()", *words]
    with subprocess.Popen(code, stdin=follower, stdout=follower, stderr=follower) as child:
        os.close(follower)
        printed = b""
        with suppress(OSError):  # says that the other side is closed
            while part := os.read(leader, 65536):
                printed += part
        child.wait()
    os.close(leader)
    return printed.decode()


# --- readers ---------------------------------------------------------------------------------------------------------


def header_of(n: int) -> str:
    """Two columns, the second with n spaces in its name."""
    return '"Time (s)","a' + " " * n + 'b"\n0,0\n'


@case("phyphox header with 20,000 spaces in a name")
def phyphox_20_kb(folder: Path) -> str:
    (folder / "a.csv").write_text(header_of(20_000))
    return reading(folder / "a.csv")


@case("the same with 130,000")
def phyphox_130_kb(folder: Path) -> str:
    (folder / "a.csv").write_text(header_of(130_000))
    return reading(folder / "a.csv")


@case("zip: 200,000 labels, one of 4,000 characters")
def long_label(folder: Path) -> str:
    def labels() -> Iterator[bytes]:
        yield b"start_s,end_s,context,carrying_mode\n0,1," + b"w" * 4000 + b",\n"
        for _ in range(200):
            yield b"0,1,w,\n" * 1000

    return reading(zipped(folder / "a.zip", truth_labels=labels()))


@case("zip: tables of empty rows")
def empty_rows(folder: Path) -> str:
    from pdr_filter.io.files.own_format_writer import TRUTH_COLUMNS

    def empty(columns: tuple[str, ...]) -> Iterator[bytes]:
        yield ",".join(columns).encode() + b"\n"
        for _ in range(60):
            yield (b"," * (len(columns) - 1) + b"\n") * (1_000_000 // len(columns))

    columns = {"gyroscope": ("time_s", "x", "y", "z"), "magnetometer": ("time_s", "x", "y", "z")}
    columns |= {f"truth_{name}": columns for name, columns in TRUTH_COLUMNS.items() if name != "labels"}
    return reading(zipped(folder / "a.zip", **{name: empty(names) for name, names in columns.items()}))


@case("zip: meta.json of 60 MiB")
def big_meta(folder: Path) -> str:
    def meta() -> Iterator[bytes]:
        yield b'{"a":['
        for _ in range(20):
            yield b"{}," * (1 << 20)
        yield b"0]}"

    return reading(zipped(folder / "a.zip", meta=meta()))


@case("folder: a sensor is a link to an endless device")
def endless_device(folder: Path) -> str:
    (folder / _CSV).symlink_to("/dev/zero")
    return reading(folder)


@case("folder: a sensor is a pipe")
def pipe(folder: Path) -> str:
    os.mkfifo(folder / _CSV)
    return reading(folder)


@case("folder of recordings with a pipe and a link to a device, tracked by the batch")
def batch_of_pipes(folder: Path) -> str:
    os.mkfifo(folder / "a.csv")
    os.mkfifo(folder / "a.zip")
    (folder / "b.csv").symlink_to("/dev/zero")
    (folder / "c").mkdir()
    os.mkfifo(folder / "c" / "data.hdf5")
    return command("track", str(folder), "--jobs", "1", "--out", str(folder / "out")).strip().splitlines()[-1][:12]


@case("folder: a sensor is a link to a file elsewhere")
def link_elsewhere(folder: Path) -> str:
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere" / "private.csv").write_text(rows())
    (folder / "walk").mkdir()
    (folder / "walk" / _CSV).symlink_to(folder / "elsewhere" / "private.csv")
    return reading(folder / "walk") + (" another file" if reading(folder / "walk") == "read" else "")


@case("hdf5: external storage in /etc/passwd")
def external_storage(folder: Path) -> str:
    import h5py

    with h5py.File(hdf5(folder / "data.hdf5"), "a") as file:
        file.create_dataset("synced/magnet", (200, 3), "u1", external=[("/etc/passwd", 0, 600)])
    return reading(folder / "data.hdf5")


@case("hdf5: external link to another file")
def external_link(folder: Path) -> str:
    import h5py

    with h5py.File(hdf5(folder / "data.hdf5"), "a") as file, h5py.File(folder / "other.h5", "w") as other:
        other["m"] = np.resize(np.frombuffer(SECRET.encode(), np.uint8), (200, 3))
        file["synced/magnet"] = h5py.ExternalLink(str(folder / "other.h5"), "m")
    return reading(folder / "data.hdf5")


@case("hdf5: virtual data set of another file")
def virtual_data_set(folder: Path) -> str:
    import h5py

    with h5py.File(folder / "other.h5", "w") as other:
        other["m"] = np.resize(np.frombuffer(SECRET.encode(), np.uint8), (200, 3))
    layout = h5py.VirtualLayout((200, 3), "u1")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "m", (200, 3))
    with h5py.File(hdf5(folder / "data.hdf5"), "a", libver="latest") as file:
        file.create_virtual_dataset("synced/magnet", layout)
    return reading(folder / "data.hdf5")


@case("hdf5: the file is a pipe")
def hdf5_pipe(folder: Path) -> str:
    os.mkfifo(folder / "data.hdf5")
    return reading(folder, "ronin")


@case("hdf5: 17 million rows that were never written")
def unwritten_rows(folder: Path) -> str:
    import h5py

    n = 17_000_000
    with h5py.File(folder / "data.hdf5", "w") as file:
        file.create_dataset("synced/time", (n,), "f8")
        for name in ("acce", "gyro", "gyro_uncalib", "magnet"):
            file.create_dataset(f"synced/{name}", (n, 3), "f8", chunks=(1000, 3))
    return reading(folder / "data.hdf5")


@case("hdf5: 17 million rows in a sparse file")
def sparse_rows(folder: Path) -> str:
    import h5py

    n = 17_000_000
    with h5py.File(folder / "data.hdf5", "w") as file:
        early = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        early.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        early.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        group = file.create_group("synced")
        for name, shape in {"time": (n,), **dict.fromkeys(("acce", "gyro", "gyro_uncalib", "magnet"), (n, 3))}.items():
            space = h5py.h5s.create_simple(shape)
            h5py.h5d.create(group.id, name.encode(), h5py.h5t.NATIVE_DOUBLE, space, early)
    return reading(folder / "data.hdf5")


# --- filters and models ---------------------------------------------------------------------------------------------


def loading(load: Callable[[], object]) -> str:
    """What loading comes to."""
    begin = time.perf_counter()
    try:
        load()
    except ValueError:
        return "refused"
    except MemoryError:
        return "memory ends"
    finally:
        _SPENT_S.append(time.perf_counter() - begin)
    return "loaded"


@case("saved filter of 30 kB: twelve million empty lists")
def many_lists(folder: Path) -> str:
    import zlib

    import pdr_filter as pdr

    packer = zlib.compressobj()
    pieces = [packer.compress(b'{"format":2,"value":{"list":[')]
    pieces += [packer.compress(b"[]," * 100_000) for _ in range(120)]
    blob = b"".join([*pieces, packer.compress(b"0]}}"), packer.flush()])
    return loading(lambda: pdr.OnlineFilter.load(blob))


@case("model: npz of 1 MB that unpacks to 1 GiB")
def big_model(folder: Path) -> str:
    import hashlib

    from pdr_filter.classifiers.context_model import load_model

    path = load_model("carrying").save(folder).with_suffix(".npz")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("zeros.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": (1 << 30,)})
        for _ in range(1 << 6):
            file.write(bytes(1 << 24))
    description = json.loads(path.with_suffix(".json").read_text())
    description["npz_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    path.with_suffix(".json").write_text(json.dumps(description))
    return loading(lambda: load_model(path))


def lying(n: int = 400) -> tuple[np.ndarray, ...]:
    """Samples of a phone that lies still: times, force, rate, field."""
    one = np.ones((n, 1))
    return np.arange(n) / 100, one * [0.0, 0.0, 9.81], one * [0.001, 0.0, 0.0], one * [20.0, 0.0, -40.0]


@case("`AttitudeEstimator(tau_acc_s=0)` and samples")
def no_time_constant(folder: Path) -> str:
    from dataclasses import replace

    import pdr_filter as pdr
    from pdr_filter.sensing.attitude import AttitudeEstimator

    config = pdr.recipes.default()
    try:
        attitude = AttitudeEstimator(tau_acc_s=0.0)
    except ValueError:
        return "refused"
    online = pdr.OnlineFilter(replace(config, sensing=replace(config.sensing, attitude=attitude)))
    online.push(*lying())
    return "goes on"


@case("magnetic field of 1e160 uT")
def wild_field(folder: Path) -> str:
    return with_field(1e160)


@case("magnetic field of 1.7e308 uT")
def wilder_field(folder: Path) -> str:
    return with_field(1.7e308)


def with_field(field_ut: float) -> str:
    """What 400 samples with one field that nothing measures come to."""
    import pdr_filter as pdr

    online, (time_s, force, rate, field) = pdr.OnlineFilter(), lying()
    field[200] = field_ut
    try:
        online.push(time_s, force, rate, field)
    except Exception as error:
        return f"{type(error).__name__}, the block is lost"
    said = [note for note in online.notes if "magnetic" in note]
    return "left out, and said" if said else "nothing said"


@case("barometer whose clock is ten hours ahead, for six hours: size of a saved filter")
def early_barometer(folder: Path) -> str:
    import pdr_filter as pdr

    online = pdr.OnlineFilter()
    online.push(*lying())
    fresh = len(online.save())
    for begin_s in range(36_000, 57_600, 600):
        time_s = begin_s + np.arange(0.0, 600.0, 0.2)
        online.push_pressure(time_s, 1000.0 + 0.001 * np.sin(time_s))
    return f"{(len(online.save()) - fresh) / 1e3:.0f} kB more"


@case("batch whose process is killed: workers that are left ten seconds later")
def killed_batch(folder: Path) -> str:
    from pdr_filter.simulate import demo_walk

    walk = demo_walk(0)
    for i in range(40):
        walk.save(folder / f"{i}.zip")
    code = "from pdr_filter.cli.app import app; app()"
    words = ["track", str(folder), "--jobs", "2", "--out", str(folder / "out")]
    batch = subprocess.Popen([sys.executable, "-c", code, *words], start_new_session=True, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 40
    while len(of_session(batch.pid)) < 3 and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(3.0)
    batch.kill()
    batch.wait()
    time.sleep(10.0)
    left = of_session(batch.pid)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    return f"{len(left)} left"


def of_session(session: int) -> list[int]:
    """Processes of a session (Linux)."""
    found: list[int] = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            if os.getsid(int(entry.name)) == session:
                found.append(int(entry.name))
    return found


# --- text of others --------------------------------------------------------------------------------------------------


def escapes(printed: str) -> str:
    """What became of the escape that clears a terminal."""
    return "an escape reaches the terminal" if "\x1b[2J" in printed else "shown as text"


@case("terminal escape in the name of a member")
def escape_in_member(folder: Path) -> str:
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        archive.writestr("\x1b[2J.txt", "x")
    return escapes(command("track", str(folder / "a.zip")))


@case("terminal escape in placement and labels")
def escape_in_placement(folder: Path) -> str:
    zipped(
        folder / "a.zip",
        meta=json.dumps({"placement": "\x1b[2Jpocket"}),
        truth_labels="start_s,end_s,context,carrying_mode\n0,1,\x1b[2Jx,\n",
    )
    return escapes(command("info", str(folder / "a.zip")))


@case("recording called `=cmd|...`: its cell in tracks.csv")
def live_cell(folder: Path) -> str:
    for name in ("a", "b"):
        zipped(folder / f"{name}.zip", meta=json.dumps({"name": "=cmd|'calc'!A0"}))
    command("track", str(folder), "--jobs", "1", "--out", str(folder / "out"))
    table = (folder / "out" / "tracks.csv").read_text()
    return "live" if ",=cmd" in table or ',"=cmd' in table else "text"


# --- writers ---------------------------------------------------------------------------------------------------------


def after_full_disk(path: Path, write: Callable[[], object]) -> str:
    """What is under the name when the disk is full after 4 kB."""
    path.write_text("before")
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    with suppress(OSError):
        write()
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    others = [entry for entry in path.parent.iterdir() if entry != path]
    return ("the old file" if path.read_bytes() == b"before" else "a cut file") + (", and rests" if others else "")


@case("disk full while a recording is written")
def full_disk_recording(folder: Path) -> str:
    from pdr_filter.simulate import demo_walk

    walk = demo_walk(0)
    return after_full_disk(folder / "a.zip", lambda: walk.save(folder / "a.zip"))


@case("disk full while a track is written")
def full_disk_track(folder: Path) -> str:
    import pdr_filter as pdr

    track = pdr.track(pdr.simulate.demo_walk(0))
    return after_full_disk(folder / "a.csv", lambda: track.to_csv(folder / "a.csv"))


@case("recording with a name of 300 characters: files of its track")
def long_name(folder: Path) -> str:
    zipped(folder / "a.zip", meta=json.dumps({"name": "n" * 300}))
    command("track", str(folder / "a.zip"), "--out", str(folder / "out"), "--report")
    return f"{len(list((folder / 'out').glob('*'))) if (folder / 'out').exists() else 0} of 3 files"


# --- values ----------------------------------------------------------------------------------------------------------


@case("`Recording` pickled and copied")
def pickled(folder: Path) -> str:
    import copy
    import pickle

    from pdr_filter.simulate import demo_walk

    recording = demo_walk(0)
    try:
        others = [pickle.loads(pickle.dumps(recording)), copy.copy(recording), copy.deepcopy(recording)]
    except TypeError as error:
        return str(error)
    equal = all((other.accelerometer.values == recording.accelerometer.values).all() for other in others)
    return "equal, read-only" if equal and not others[0].accelerometer.values.flags.writeable else "equal"


@case("masked values in `Samples` and `push`")
def masked(folder: Path) -> str:
    import pdr_filter as pdr
    from pdr_filter.tracking.online import imu_block

    time_s = np.arange(10) / 100
    force = np.ma.masked_greater(np.tile([0.0, 0.0, 9.8], (10, 1)), 9.0)
    kept = (pdr.Samples(time_s, force).values, imu_block(time_s, force).specific_force_mps2)
    return "unknown" if all(np.isnan(values[:, 2]).all() for values in kept) else "taken as measured"


@case("datetime64 as times of `Samples` and `push`")
def datetimes(folder: Path) -> str:
    import pdr_filter as pdr
    from pdr_filter.tracking.online import imu_block

    time: Any = np.datetime64("2026-01-01", "ns") + np.arange(10) * np.timedelta64(10, "ms")
    refused = 0
    makers: tuple[Callable[..., Any], ...] = (pdr.Samples, imu_block)
    for make in makers:
        try:
            make(time, np.zeros((10, 3)))
        except ValueError:
            refused += 1
    return ["taken for seconds", "taken for seconds by one", "refused"][refused]


# --- measuring -------------------------------------------------------------------------------------------------------


def measured(name: str, checkout: Path) -> tuple[str, str]:
    """Outcome, and time and largest memory, of a case with the package of a checkout."""
    environment = {**os.environ, "PYTHONPATH": f"{checkout}", "TERM": "xterm"}
    with tempfile.TemporaryDirectory() as folder:
        code = [sys.executable, __file__, "--cases", name, "--here", folder]
        begin = time.perf_counter()
        child = subprocess.Popen(code, cwd=checkout, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            out, said = child.communicate(timeout=MOST_S + 20)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()
            return "hangs", f"more than {time.perf_counter() - begin:.0f} s"
    if child.returncode == -signal.SIGALRM:
        return "hangs", f"more than {MOST_S:.0f} s"
    if child.returncode:
        return (said.decode().strip().splitlines() or [f"code {child.returncode}"])[-1][:60], ""
    outcome, seconds, mib = json.loads(out.decode().splitlines()[-1])
    return outcome, f"{seconds:.2f} s, {mib:.0f} MiB" if seconds else ""


def one(name: str, folder: Path) -> None:
    """Try a case here: its outcome, its time after imports, and by how much it made the process grow."""
    for module in ("pdr_filter.io.formats", "pdr_filter.tracking.whole_recording", "h5py"):
        importlib.import_module(module)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    signal.alarm(int(MOST_S))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        outcome = _CASES[name][1](folder)
    except MemoryError:
        outcome = "memory ends"
    print(json.dumps([outcome, sum(_SPENT_S), (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024]))


def main() -> None:
    """One row for each case."""
    from tests.benchmarks.common import ROOT, Tables, options

    parser = options(__doc__ or "")
    parser.add_argument("--before", type=Path, help="checkout of an earlier version")
    parser.add_argument("--cases", default=",".join(_CASES))
    args = parser.parse_args()
    found: list[list[str]] = []
    for name in args.cases.split(","):
        row = [_CASES[name][0], *([] if args.before is None else measured(name, args.before)), *measured(name, ROOT)]
        found.append(row)
        print(row, flush=True)
    columns = ["input", *([] if args.before is None else ["before", "cost before"]), "now", "cost"]
    tables = Tables.of(__spec__.name, args)
    if args.cases != ",".join(_CASES):
        tables = Tables(tables.command, None)
    tables.write("hostile_files", columns, found)


if __name__ == "__main__":
    if "--here" in sys.argv:
        here = argparse.ArgumentParser()
        here.add_argument("--cases")
        here.add_argument("--here", type=Path)
        one(**{"name": here.parse_args().cases, "folder": here.parse_args().here})
    else:
        main()
