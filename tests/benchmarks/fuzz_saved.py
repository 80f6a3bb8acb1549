"""Mutated files and messages that are no recordings: each is refused at loading or works, soon and in little memory.

usage: python -m tests.benchmarks.fuzz_saved [--inputs 2000] [--forms filter:default,model,...] [--seed 0]

A saved filter with a forged checksum is given ten seconds of a walk and finished, and may fail at that. A model
classifies windows, a calibration gives everybody's step lengths, a radio map finds a walk, messages of phones become
the samples of a session. No other file may be opened meanwhile. Inputs are tried in a process of their own, so that a
crash of a C library would be seen; it goes on behind an input that ends it or at which it hangs. Memory is the peak
above that before the input (Linux). All forms take hours: a run of some of them replaces their rows of the table.
"""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import tempfile
import time
from collections import Counter
from datetime import date
from pathlib import Path
from typing import Any

from tests.benchmarks.common import FOLDER, Tables, run

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from given_mutations import GIVEN, a_radio_map, try_given, usual_config, walk_to_find
from saved_mutations import FORMS as SAVED
from saved_mutations import a_calibration, good_filter, try_one

FORMS = (*SAVED, *GIVEN)
SLOW_S, LARGE_MB = 1.0, 500.0
HANG_S = 60.0  # on the wall, on a machine that may be busy
EVERY = 100  # inputs between two lines of progress


def memory_mb(what: str) -> float:
    """Memory of this process: VmRSS now, VmHWM the peak since `forget_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(what):
            return int(line.split()[1]) / 1024
    raise ValueError(f"no {what} in /proc/self/status")


def forget_peak() -> None:
    """Let the peak start from what is used now."""
    Path("/proc/self/clear_refs").write_text("5")


def fuzz(form: str, first: int, until: int, seed: int) -> None:
    """Print a line for each input: what happened, seconds of processor time, MB of memory."""
    if form.startswith("filter"):  # made now, not in the time of the first input
        for located in (False, True):
            good_filter(form.partition(":")[2], located=located)
    elif form == "calibration":
        a_calibration()
    elif form == "radio_map":
        _ = a_radio_map(), walk_to_find()
    try_it = try_given if form in GIVEN else try_one
    _ = usual_config()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, until):
            forget_peak()
            begin_s, begin_mb = time.process_time(), memory_mb("VmRSS")
            faulthandler.dump_traceback_later(HANG_S, exit=True)
            what = try_it(form, number, seed, Path(folder))
            faulthandler.cancel_dump_traceback_later()
            used_s, used_mb = time.process_time() - begin_s, memory_mb("VmHWM") - begin_mb
            print(f"{used_s:.3f}\t{used_mb:.1f}\t{' '.join(what.split())}", flush=True)


def results_of(form: str, inputs: int, seed: int) -> list[tuple[float, float, str]]:
    """Of all inputs, whatever ends the process that tries them."""
    found: list[tuple[float, float, str]] = []
    while len(found) < inputs:
        command = [sys.executable, "-m", "tests.benchmarks.fuzz_saved", "--here", str(len(found)), "--forms", form]
        command += ["--inputs", str(inputs), "--seed", str(seed)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
            for line in running.stdout or ():
                used_s, used_mb, what = line.rstrip("\n").split("\t")
                found.append((float(used_s), float(used_mb), what))
                if what not in ("worked", "refused"):
                    print(f"{form} {len(found) - 1}: {what}", flush=True)
                if len(found) % EVERY == 0:
                    print(f"{form}: {len(found)} of {inputs}", flush=True)
        if running.returncode:
            found.append((0.0, 0.0, f"the process ended with code {running.returncode}"))
            print(f"{form} {len(found) - 1}: {found[-1][2]}", flush=True)
    return found


def rows_of_table() -> dict[str, list[Any]]:
    """Rows of the table as it is now, by their forms."""
    cells = [line.strip("| ").split(" | ") for line in (FOLDER / "fuzz_saved.md").read_text("utf-8").splitlines()]
    return {row[0]: list(row) for row in cells if row[0].strip("`") in FORMS}


def saved(tables: Tables, arguments: argparse.Namespace) -> None:
    """One row for each form; those of forms that are not run stay as they are."""
    rows: dict[str, list[Any]] = {f"`{form}`": [f"`{form}`", *["-"] * 9] for form in FORMS}
    rows |= rows_of_table()
    if arguments.here >= 0:
        fuzz(arguments.forms, arguments.here, arguments.inputs, arguments.seed)
        return
    for form in arguments.forms.split(","):
        results = results_of(form, arguments.inputs, arguments.seed)
        counts = Counter(what for _, _, what in results)
        failed = len(results) - counts["worked"] - counts["refused"]
        slow = sum(used_s > SLOW_S for used_s, _, _ in results)
        large = sum(used_mb > LARGE_MB for _, used_mb, _ in results)
        longest, most = max(used_s for used_s, _, _ in results), max(used_mb for _, used_mb, _ in results)
        numbers = len(results), counts["worked"], counts["refused"], failed, slow, large
        rows[f"`{form}`"] = [f"`{form}`", *numbers, f"{longest:.2f} s", f"{most:.0f} MB", date.today()]
    columns = "form | inputs | worked | refused | failed | slower than 1 s | above 500 MB | longest | most | day"
    tables.write("fuzz_saved", columns, list(rows.values()))


if __name__ == "__main__":
    run(__doc__, saved, inputs=2000, forms=",".join(FORMS), seed=0, here=-1)
