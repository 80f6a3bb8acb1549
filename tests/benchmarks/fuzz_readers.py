"""Mutated files of every format: each must give a recording or a RecordingError, soon, and write nothing.

usage: .venv/bin/python tests/benchmarks/fuzz_readers.py [--inputs 10000] [--forms own,phyphox:zip,...] [--seed 0]

Each form is read in a process of its own, so that a crash of a C library would be seen, and which ends with a traceback
where it hangs. Prints, for each form, how many were read with a report that fits, refused by the name of the file,
slower than a second, and failed in any other way; the first failures are kept in a folder.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "io"))

from mutations import FORMS, faults_of_recording, faults_of_refusal, good_file, mutated_file

KEPT = Path(tempfile.gettempdir()) / "fuzz_readers"
SLOW_S = 1.0  # of processor time
HANG_S = 60.0  # on the wall, on a machine that may be busy: the process ends and says where it was


def fuzz(form: str, inputs: int, seed: int) -> Counter[str]:
    """Counts of what happened."""
    from pdr_filter.io.errors import RecordingError
    from pdr_filter.io.formats import read

    warnings.simplefilter("error")
    counts: Counter[str] = Counter()
    rng = random.Random(f"{form} {seed}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "good").mkdir()
        good = good_file(form, folder / "good")
        assert len(read(good).accelerometer) > 0
        (folder / "x").mkdir()
        for beside in good.parent.glob("*.toml"):
            (folder / "x" / beside.name).write_bytes(beside.read_bytes())
        beside = {folder / "x" / name for name in (good.name, *(path.name for path in (folder / "x").iterdir()))}
        for i in range(inputs):
            path = mutated_file(good, folder / "x", rng)
            # half the time the reader of this format is forced, so that detection does not turn all away
            forced = form.partition(":")[0] if rng.random() < 0.5 else None
            begin = time.process_time()
            try:
                faulthandler.dump_traceback_later(HANG_S, exit=True)
                try:
                    recording = read(path, forced)
                finally:
                    faulthandler.cancel_dump_traceback_later()
                if faults := faults_of_recording(recording, forced):
                    raise AssertionError("; ".join(faults))
                counts["read"] += 1
            except RecordingError as error:
                faults = faults_of_refusal(str(error), path)
                counts["refused" if not faults else f"refused, but: {'; '.join(faults)}"] += 1
            except BaseException as error:
                counts[f"failed: {type(error).__name__}: {str(error)[:80]}"] += 1
                KEPT.mkdir(exist_ok=True)
                (KEPT / f"{form.replace(':', '_')}_{i}_{forced}{path.suffix}").write_bytes(path.read_bytes())
            counts["slower than 1 s"] += time.process_time() - begin > SLOW_S
            if {entry.name for entry in folder.iterdir()} != {"good", "x"} or set((folder / "x").iterdir()) != beside:
                raise AssertionError(f"input {i} wrote a file outside its folder")
    return counts


def main() -> None:
    """Print one line for each form."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--forms", default=",".join(FORMS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    for form in options.forms.split(","):
        if options.here:
            counts = fuzz(form, options.inputs, options.seed)
            print(f"{form:24s} " + ", ".join(f"{what} {n}" for what, n in sorted(counts.items())), flush=True)
            continue
        command = [sys.executable, __file__, "--here", "--forms", form, "--inputs", str(options.inputs)]
        ended = subprocess.run([*command, "--seed", str(options.seed)], check=False)
        if ended.returncode:
            print(f"{form:24s} ended with code {ended.returncode}", flush=True)


if __name__ == "__main__":
    main()
