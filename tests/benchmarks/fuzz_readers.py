"""Mutated files of every format: a recording or a RecordingError, soon, in little memory, without touching other files.

usage: python -m tests.benchmarks.fuzz_readers [--inputs 10000] [--forms own,phyphox:zip,...] [--seed 0] [--data ...]

One of a hundred mutations makes a file large; one of twenty inputs is a folder or a file of which a part is a pipe, a
device, a link or, in hdf5, data kept elsewhere. Forms are small files as the apps would write them, and the first rows
of files that apps wrote for people (`app:...`, in app_files beside the data sets; a third as many inputs). Each form is
read in a process of its own, so that a crash of a C library would be seen, and which ends with a traceback where it
hangs. The table has, for each form, how many were read with a report that fits, refused by the name of the file, failed
in any other way (opening or writing another file is one), and were slower than a second, and by how much the process
grew at most; the first failures are kept in a folder.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from pathlib import Path

from pdr_filter.data.io.formats import read
from pdr_filter.values.errors import RecordingError
from tests.benchmarks.app_files import FILES
from tests.benchmarks.common import Tables, run

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "data" / "io"))

from app_files import write_zip
from mutations import FORMS, faults_of_recording, faults_of_refusal, good_file, mutated_file, of_another_kind

# Files that are read, but for a spreadsheet of 2.5 MB: of its numbers nothing can be cut.
APPS = [f"app:{file.path}" for file in FILES if not file.refusal and not file.path.endswith(".xlsx")]
N_LINES = (300, 4000)  # number of lines that are taken of each table
KEPT = Path(tempfile.gettempdir()) / "fuzz_readers"
ALL = (*FORMS, *APPS)
MEASURED = ("slower than 1 s", "largest memory")
SLOW_S = 1.0  # of processor time
HANG_S = 60.0  # on the wall, on a machine that may be busy: the process ends and says where it was


MOST_BYTES = 4 << 30  # of address space: what takes more ends with a MemoryError
CODE = (".py", ".pyc", ".so")  # of modules that are imported late


def largest_mib() -> int:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def readable_rows(source: Path, folder: Path) -> Path:
    """The first rows of a file of an app, and more of them if gravity is missing, which only a walk of 12 s shows."""
    for n_lines in N_LINES[:-1]:
        with contextlib.suppress(RecordingError):
            read(path := first_rows(source, folder, n_lines))
            return path
    return first_rows(source, folder, N_LINES[-1])


def first_rows(source: Path, folder: Path, n_lines: int) -> Path:
    """The first rows of a file of an app, or of the tables in a zip or a folder, which is packed."""
    if source.is_dir():
        files = {path.relative_to(source).as_posix(): path.read_bytes() for path in source.rglob("*") if path.is_file()}
    elif zipfile.is_zipfile(source):
        with zipfile.ZipFile(source) as archive:
            files = {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    else:
        path = folder / f"good{source.suffix}"
        is_text = source.suffix not in (".mat", ".json")
        path.write_bytes(source.read_bytes() if not is_text else cut(source.read_bytes(), n_lines))
        return path
    return write_zip(folder / "good.zip", {name: cut(content, n_lines) for name, content in files.items()})


def cut(text: bytes, n_lines: int) -> bytes:
    return b"".join(text.splitlines(keepends=True)[:n_lines])


def fuzz(form: str, inputs: int, seed: int, apps: Path) -> Counter[str]:
    """Counts of what happened, and the memory by which the process grew."""
    warnings.simplefilter("error")
    counts: Counter[str] = Counter()
    rng = random.Random(f"{form} {seed}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "good").mkdir()
        app = form.partition(":")[2] if form in APPS else ""
        good = readable_rows(apps / app, folder / "good") if app else good_file(form, folder / "good")
        assert len(read(good).accelerometer) > 0
        (folder / "x").mkdir()
        (folder / "elsewhere").mkdir()
        opened: list[str] = []  # files outside x

        def note_opened(event: str, arguments: tuple[object, ...]) -> None:
            if event == "open" and watching and isinstance(arguments[0], str | bytes):
                where = os.path.realpath(os.fsdecode(arguments[0]))
                if not where.startswith(str(folder.resolve() / "x")) and not where.endswith(CODE):
                    opened.append(where)

        watching = False
        sys.addaudithook(note_opened)
        resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
        before_mib = largest_mib()
        for beside in good.parent.glob("*.toml"):
            (folder / "x" / beside.name).write_bytes(beside.read_bytes())
        beside = {folder / "x" / name for name in (good.name, *(path.name for path in (folder / "x").iterdir()))}
        for i in range(inputs):
            if rng.random() < 0.05:
                path = of_another_kind(good, folder / "x", folder / "elsewhere", rng)
            else:
                path = mutated_file(good, folder / "x", rng)
            # half the time the reader of this format is forced, so that detection does not turn all away
            forced = form.partition(":")[0] if rng.random() < 0.5 and not app else None
            begin = time.process_time()
            try:
                faulthandler.dump_traceback_later(HANG_S, exit=True)
                watching = True
                try:
                    recording = read(path, forced)
                finally:
                    watching = False
                    faulthandler.cancel_dump_traceback_later()
                    if opened:
                        raise AssertionError(f"opened {opened.pop()}")
                if faults := faults_of_recording(recording, forced):
                    raise AssertionError("; ".join(faults))
                counts["read"] += 1
            except RecordingError as error:
                faults = faults_of_refusal(str(error), path)
                counts["refused" if not faults else f"refused, but: {'; '.join(faults)}"] += 1
            except BaseException as error:
                counts[f"failed: {type(error).__name__}: {str(error)[:80]}"] += 1
                KEPT.mkdir(exist_ok=True)
                if path.is_file():
                    (KEPT / f"{re.sub('[:/]', '_', form)}_{i}_{forced}{path.suffix}").write_bytes(path.read_bytes())
            counts["slower than 1 s"] += time.process_time() - begin > SLOW_S
            shutil.rmtree(folder / "x" / "unpacked", ignore_errors=True)
            if {entry.name for entry in folder.iterdir()} != {"good", "x", "elsewhere"} or not beside.issuperset(
                (folder / "x").iterdir()
            ):
                raise AssertionError(f"input {i} wrote a file outside its folder")
        counts["largest memory"] = largest_mib() - before_mib
    return counts


def readers(tables: Tables, arguments: argparse.Namespace) -> None:
    """One row for each form."""
    rows = []
    for form in arguments.forms.split(","):
        inputs = arguments.inputs // 3 if form in APPS else arguments.inputs
        if arguments.here:
            print(json.dumps(fuzz(form, arguments.inputs, arguments.seed, arguments.data.parent / "app_files")))
            return
        command = [sys.executable, "-m", "tests.benchmarks.fuzz_readers", "--here", "--forms", form]
        command += ["--inputs", str(inputs), "--seed", str(arguments.seed), "--data", str(arguments.data)]
        ended = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
        if ended.returncode:
            rows.append([f"`{form}`", inputs, "", "", f"ended with code {ended.returncode}", "", ""])
            continue
        counts = Counter(json.loads(ended.stdout))
        read, refused, slow, mib = (counts.pop(what, 0) for what in ("read", "refused", *MEASURED))
        print(form, read, refused, slow, f"{mib} MiB", dict(counts) or "", flush=True)
        rows.append([f"`{form}`", inputs, read, refused, sum(counts.values()), slow, f"{mib} MiB"])
    if arguments.forms != ",".join(ALL):
        tables = Tables(tables.command, None)
    tables.write("fuzz_readers", ["form", "inputs", "read", "refused", "failed", *MEASURED], rows)


if __name__ == "__main__":
    run(__doc__, readers, inputs=10_000, forms=",".join(ALL), seed=0, here=False)
