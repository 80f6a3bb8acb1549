"""What the benchmarks share: options, recordings, and the files of docs/tables, from which the pages take every figure.

usage: python -m tests.benchmarks.common     copies the tables of README.md from docs/tables

A benchmark writes each of its tables with `Tables.write`. A page includes the file. GitHub includes nothing, so that
README.md holds copies between two comments; `readme_with_tables` makes them, and a test holds them equal.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

import pdr_filter as pdr
from tests.data_folder import DATA

# Sums of several threads may differ in the last bit from run to run, and times are those of one core: here, where a
# benchmark has most often imported NumPy before, and in the processes that it starts.
threadpool_limits(limits=1)
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "tables"
_COPY = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
_DATE = re.compile(r"\d{4}-\d\d-\d\d")


# --- options and recordings ------------------------------------------------------------------------------------------


def options(doc: str, *parts: str) -> argparse.ArgumentParser:
    """Parser of a benchmark: parts to run (all if none is named), `--data` and `--print`."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    if parts:
        parser.add_argument(
            "parts", nargs="*", default=list(parts), help=f"of {', '.join(parts)}; all if none is named"
        )
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the data sets, one folder each")
    parser.add_argument("--print", action="store_true", help="print the tables and write no file")
    return parser


def paths(data: Path, site: str, pattern: str = "*.zip") -> list[Path]:
    """Files of the recordings of a data set, by name."""
    return sorted((data / site).glob(pattern))


def recordings(data: Path, site: str, pattern: str = "*.zip") -> Iterator[pdr.Recording]:
    """Recordings of a data set, by name."""
    return map(pdr.read, paths(data, site, pattern))


# --- figures ---------------------------------------------------------------------------------------------------------


def bias_spread_rms(errors: ArrayLike, digits: int = 1) -> str:
    """Mean with its sign, standard deviation, root mean square."""
    e = np.asarray(errors, dtype=float)
    return f"{e.mean():+.{digits}f}, {e.std():.{digits}f}, {np.sqrt((e**2).mean()):.{digits}f}"


def absolute_bias_spread(errors: ArrayLike, digits: int = 2) -> str:
    """Mean absolute error (bias, standard deviation)."""
    e = np.asarray(errors, dtype=float)
    return f"{np.abs(e).mean():.{digits}f} ({e.mean():+.{digits}f}, {e.std():.{digits}f})"


def median_and(errors: ArrayLike, percentile: float, digits: int = 2) -> str:
    """Median and a percentile; 100 is the largest."""
    e = np.asarray(errors, dtype=float)
    return f"{np.median(e):.{digits}f}, {np.percentile(e, percentile):.{digits}f}"


# --- tables ----------------------------------------------------------------------------------------------------------


def markdown_table(columns: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Rows under their columns."""
    if any(len(row) != len(columns) for row in rows):
        raise ValueError(f"rows must have the {len(columns)} cells of {columns}, got {[len(row) for row in rows]}")
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


@dataclass(frozen=True)
class Tables:
    """Files of tables that one command writes.

    Parameters
    ----------
    command : str
        Stands below each table.
    folder : Path or None
        None prints tables and writes nothing, for runs on a part of the data.
    """

    command: str
    folder: Path | None = FOLDER

    @classmethod
    def of(cls, module: str, arguments: argparse.Namespace) -> Tables:
        """Those of a benchmark that was started as `python -m MODULE`."""
        return cls(f"python -m {module}", None if arguments.print else FOLDER)

    def write(
        self, name: str, columns: Sequence[object], rows: Sequence[Sequence[object]], about: str = "", day: str = ""
    ) -> None:
        """Print a table, and write it to NAME.md with the command, the day (today) and what it is about.

        A file that differs in the day alone is left as it is: the same numbers have the same bytes.
        """
        table = markdown_table(columns, rows)
        print(f"\n{name}\n\n{table}", flush=True)
        if self.folder is None:
            return
        caption = f"*{about + ' ' if about else ''}`{self.command}`, {day or date.today()}.*"
        text, path = f"{table}\n{caption}\n", self.folder / f"{name}.md"
        self.folder.mkdir(parents=True, exist_ok=True)
        if not path.exists() or _DATE.sub("", path.read_text("utf-8")) != _DATE.sub("", text):
            path.write_text(text, encoding="utf-8")


def readme_with_tables(text: str, folder: Path = FOLDER) -> str:
    """The text with each table between `<!-- table NAME -->` and `<!-- end of table -->` as its file has it."""
    return _COPY.sub(lambda m: f"{m[1]}\n{(folder / f'{m[2]}.md').read_text('utf-8')}\n{m[3]}", text)


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(readme_with_tables(readme.read_text("utf-8")), encoding="utf-8")
