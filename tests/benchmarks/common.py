"""The runner of the benchmarks: arguments, recordings, tables, and the time of each part.

usage: python -m tests.benchmarks.common     copies the tables of README.md from docs/tables

A benchmark writes each of its tables with `Tables.write`. A page includes the file. GitHub includes nothing, so that
README.md holds copies between two comments; `readme_with_tables` makes them, and a test holds them equal.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

import pdr_filter as pdr
from pdr_filter.values import BoolArray, FloatArray, ImuBlock, interpolated_rows
from tests.data_folder import DATA

# Sums of several threads may differ in the last bit from run to run, and times are those of one core: here, where a
# benchmark has most often imported NumPy before, and in the processes that it starts.
threadpool_limits(limits=1)
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "tables"
# Squared errors over their covariances in the plane: limits of half and of 95 % of them.
HALF, MOST = chi2.ppf([0.5, 0.95], 2)
_COPY = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end of table -->)", re.DOTALL)
_DATE = re.compile(r"\d{4}-\d\d-\d\d")


# --- the runner and recordings ----------------------------------------------------------------------------------------


_HELP = {
    "cache": "folder that keeps training windows and trained models, so that a later run does not train again. Use an "
    "empty folder after changes of the training",
    "sets": "data sets to use, such as terrain,ipin2023. Tables are printed only. Default: all",
    "people": "number of people to score in each data set, the last by name. Tables are printed only. Default: all",
}


def run(
    doc: str | None,
    *parts: Callable[[Tables, argparse.Namespace], None],
    prepare: Callable[[argparse.Namespace, Sequence[str]], Sequence[str]] | None = None,
    **options: Any,
) -> None:
    """Run the parts of a benchmark, all or those named on the command line, and report the time that each takes.

    Parameters
    ----------
    doc : str
        Docstring of the script; its first line is shown by `--help`.
    *parts : callable
        Functions of the tables to write and the arguments; the name of a function is the name of its part.
    prepare : callable, optional
        Function of the arguments and the names of the parts, which returns the names of the parts to run. Its
        ValueError ends the command with one sentence.
    **options
        Further options with their defaults, which have their types: `every=4` is `--every N`, an integer, a list takes
        several values, and None is the default of a path.
    """
    by_name = {part.__name__: part for part in parts}
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(by_name)}; all if none is named")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the data sets, one folder each")
    parser.add_argument("--print", action="store_true", help="print the tables and write no file")
    for name, default in options.items():
        many = isinstance(default, list)
        kind = Path if default is None else type(default[0] if many else default)
        given: dict[str, Any] = (
            {"action": "store_true"} if kind is bool else {"type": kind, "nargs": "+" if many else None}
        )
        about = _HELP.get(name, f"default: {default}")
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, help=about, **given)
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - set(by_name):
        parser.error(f"no part {', '.join(sorted(unknown))}; parts are {', '.join(by_name)}")
    names, data = arguments.parts or list(by_name), arguments.data
    try:
        names = names if prepare is None else prepare(arguments, names)
    except ValueError as error:
        parser.exit(2, f"{error}\n")
    spec = sys.modules["__main__"].__spec__
    command = f"python -m {spec.name.removesuffix('.__main__') if spec else 'NAME'}"
    tables = Tables(command, None if arguments.print else FOLDER)
    say(f"{command}: {', '.join(names)}; data in {data}")
    for name in names:
        with timed(name):
            by_name[name](tables, arguments)


def say(text: str) -> None:
    """Print progress on stderr at once."""
    print(text, file=sys.stderr, flush=True)


@contextmanager
def timed(what: str) -> Generator[None]:
    """Print how long the block took."""
    start = time.perf_counter()
    yield
    say(f"{what}: {time.perf_counter() - start:.0f} s")


def paths(data: Path, site: str, pattern: str = "*.zip") -> list[Path]:
    """Files of the recordings of a data set, by name."""
    return sorted((data / site).glob(pattern))


def recordings(data: Path, site: str, pattern: str = "*.zip") -> Iterator[pdr.Recording]:
    """Recordings of a data set, by name."""
    return map(pdr.read, paths(data, site, pattern))


def places_of(rows: Any) -> FloatArray:
    """East and north (N, 2) of the rows of a table of the truth."""
    return np.column_stack([rows.east_m, rows.north_m])


def way_of(recording: pdr.Recording, every_s: float = 0.02, below_hz: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Even times (N,) and places (N, 2) of the continuous reference, low-passed: by default below the sway of steps."""
    truth = recording.truth.position
    if truth is None:
        raise ValueError(f"{recording.name}: no truth_position.csv")
    time_s = np.arange(truth.time_s[0], truth.time_s[-1], every_s)
    place_m = interpolated_rows(time_s, truth.time_s, places_of(truth))
    return time_s, sosfiltfilt(butter(2, below_hz, fs=1 / every_s, output="sos"), place_m, axis=0)


def part_of(block: ImuBlock, use: slice | BoolArray) -> ImuBlock:
    """Some of the samples of a block."""
    return ImuBlock(*(getattr(block, field.name)[use] for field in fields(block)))


def push(online: pdr.OnlineFilter, block: ImuBlock) -> list[pdr.StepUpdate]:
    """Output of the filter for a block."""
    return online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)


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

    def write(
        self,
        name: str,
        columns: str | Sequence[object],
        rows: Sequence[Sequence[object]],
        about: str = "",
        day: str = "",
    ) -> None:
        """Print a table, and write it to NAME.md with the command, the day (today) and what it is about.

        Columns are a list of headings, or a text such as "site | walks | error". A file that differs in the day alone
        is left as it is: the same numbers have the same bytes.
        """
        if isinstance(columns, str):
            columns = columns.split(" | ")
        caption = f"*{about + ' ' if about else ''}`{self.command}`, {day or date.today()}.*"
        text = f"{markdown_table(columns, rows)}\n{caption}\n"
        print(f"\n{name}\n\n{text}", flush=True)
        if self.folder is None:
            return
        path = self.folder / f"{name}.md"
        self.folder.mkdir(parents=True, exist_ok=True)
        if not path.exists() or _DATE.sub("", path.read_text("utf-8")) != _DATE.sub("", text):
            path.write_text(text, encoding="utf-8")


def readme_with_tables(text: str, folder: Path = FOLDER) -> str:
    """The text with each table between `<!-- table NAME -->` and `<!-- end of table -->` as its file has it."""
    return _COPY.sub(lambda m: f"{m[1]}\n{(folder / f'{m[2]}.md').read_text('utf-8')}\n{m[3]}", text)


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(readme_with_tables(readme.read_text("utf-8")), encoding="utf-8")
