"""Odd tables: what the reader does with each kind and what it says, as docs/formats.md shows.

usage: python -m tests.benchmarks.oddities [--print]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.benchmarks.common import ROOT, Tables, options

sys.path.insert(0, str(ROOT / "tests" / "io"))
from oddities import ODDITIES

MODULE = "tests.benchmarks.oddities"
_LONGEST = 300


def shown(sentence: str) -> str:
    """A sentence as a cell, cut behind a word."""
    words = sentence.partition("\n")[0].replace("|", "/")
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST].rpartition(' ')[0]} ..."


def main(arguments: list[str] | None = None) -> None:
    rows: list[list[str]] = []
    for oddity in ODDITIES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append([oddity.kind, oddity.done, shown(oddity.sentence(oddity.write(Path(folder))))])
    tables = Tables.of(MODULE, options(__doc__ or "").parse_args(arguments))
    tables.write("oddities", ["kind of oddity", "what is done", "what is said"], rows)


if __name__ == "__main__":
    main()
