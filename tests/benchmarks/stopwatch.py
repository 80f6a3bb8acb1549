"""From a clone to a track of one's own: the README's commands, with seconds and the size of what was installed.

usage: python -m tests.benchmarks.stopwatch FILE [--print]

FILE is a recording of a phone. The clone is that of the last commit here, in a folder that is removed afterwards.
Packages come from pip's index, or from its cache if it has them: the first time of a machine also downloads them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.common import ROOT, Tables, options

_FIRST_FILTER = "import pdr_filter; pdr_filter.OnlineFilter()"


def main() -> None:
    """A row for each command."""
    parser = options(__doc__)
    parser.add_argument("file", type=Path, help="a recording of a phone")
    args = parser.parse_args()
    rows: list[list[str]] = []
    # Nothing of this process: neither the packages that it sees nor its number of threads.
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "OMP_", "OPENBLAS_"))}

    def timed(shown: str, *command: str, cwd: Path) -> None:
        start = time.perf_counter()
        subprocess.run(command, cwd=cwd, env=environment, check=True, stdout=subprocess.DEVNULL)
        rows.append([f"`{shown}`", f"{time.perf_counter() - start:.1f} s"])

    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "pdr_filter"
        timed("git clone", "git", "clone", "--quiet", str(ROOT), str(clone), cwd=Path(folder))
        make = ("make", "--no-print-directory", f"PYTHON={sys.executable}")
        timed("make demo", *make, "demo", cwd=clone)
        timed("make demo", *make, "demo", cwd=clone)
        rows[-1][0] += ", again"
        timed("make demo FILE=walk.zip", *make, "demo", f"FILE={args.file.resolve()}", cwd=clone)
        timed(_FIRST_FILTER, str(clone / ".venv/bin/python"), "-c", _FIRST_FILTER, cwd=clone)
        for what, path in (("the clone", clone / ".git"), ("`.venv`", clone / ".venv")):
            size = sum(p.lstat().st_size for p in path.rglob("*") if not p.is_symlink())
            rows.append([what, f"{size / 2**20:.0f} MiB"])
    about = f"{args.file.name}; packages from pip's cache; load of the two shared cores {os.getloadavg()[0]:.1f}."
    Tables.of(__spec__.name, args).write("stopwatch", ["command", "time, size"], rows, about)


if __name__ == "__main__":
    main()
