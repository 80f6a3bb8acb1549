"""How fast libraries parse the rows of a recording, to the same bits: why the readers take pyarrow if it is there.

usage: python -m tests.benchmarks.csv_libraries      needs pyarrow and polars
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pdr_filter.io.tables.text_table import Layout, parse_lines
from pdr_filter.values import limits
from tests.benchmarks.common import Tables, options

N = 300_000
T0_NS = 1_787_923_304_123_456_789
Parsed = tuple[np.ndarray, np.ndarray]


def blocks() -> list[bytes]:
    """Rows of nanoseconds, seconds and three values, in blocks as the readers parse them."""
    values = np.random.default_rng(0).normal(size=(N, 3)).tolist()
    rows = [f"{T0_NS + 5_000_000 * i},{i / 200:.9f},{x!r},{y!r},{z!r}\n" for i, (x, y, z) in enumerate(values)]
    text, found, at = "".join(rows).encode(), [], 0
    while at < len(text):
        end = text.rfind(b"\n", at, at + limits.BLOCK_BYTES) + 1
        found.append(text[at:end])
        at = end
    return found


def with_numpy(block: bytes) -> Parsed:
    table = parse_lines(block.decode().split("\n"), Layout((2, 3, 4), 0))
    return table.whole, table.values


def with_pyarrow(block: bytes) -> Parsed:
    import pyarrow as pa
    from pyarrow import csv

    names = list("abcde")
    types = {"a": pa.int64(), **dict.fromkeys("cde", pa.float64())}
    found = csv.read_csv(
        pa.py_buffer(block),
        csv.ReadOptions(use_threads=False, column_names=names, block_size=len(block) + 1),
        convert_options=csv.ConvertOptions(column_types=types, include_columns=list(types)),
    )
    return found["a"].to_numpy(), np.column_stack([found[name].to_numpy() for name in "cde"])


def with_polars(block: bytes) -> Parsed:
    import polars as pl

    found = pl.read_csv(block, has_header=False, columns=[0, 2, 3, 4])
    return found.to_series(0).to_numpy(), found[:, 1:].to_numpy()


def size_mb(*packages: str) -> str:
    """Of what is installed."""
    total = 0
    for package in packages:
        spec = importlib.util.find_spec(package)
        assert spec is not None and spec.origin is not None
        total += sum(file.stat().st_size for file in Path(spec.origin).parent.rglob("*") if file.is_file())
    return f"{total / 1e6:.0f} MB"


def main() -> None:
    """One row for each library."""
    args = options(__doc__).parse_args()
    ways: dict[str, tuple[Callable[[bytes], Parsed], tuple[str, ...]]] = {
        "numpy.loadtxt": (with_numpy, ()),
        "pyarrow.csv": (with_pyarrow, ("pyarrow",)),
        "polars": (with_polars, ("polars", "_polars_runtime_32")),
    }
    text = blocks()
    expected = [with_numpy(block) for block in text]
    rows: list[list[str]] = []
    for name, (parse, packages) in ways.items():
        parse(text[0])
        begin = time.process_time()
        found = [parse(block) for block in text]
        took_s = time.process_time() - begin
        same = all(
            np.array_equal(a, b) for f, e in zip(found, expected, strict=True) for a, b in zip(f, e, strict=True)
        )
        rows.append(
            [name, f"{took_s:.2f} s", "yes" if same else "NO", size_mb(*packages) if packages else "there anyway"]
        )
    about = f"{N} rows of a whole number and four floats, {sum(map(len, text)) / 2**20:.0f} MiB; time of the processor."
    Tables.of(__spec__.name, args).write("csv_libraries", ["library", "time", "same bits", "installed"], rows, about)


if __name__ == "__main__":
    main()
