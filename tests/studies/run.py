"""The published experiments on the data at hand: `python -m tests.studies.NAME [DATA] [--out FOLDER]`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from tests.data_folder import DATA
from tests.studies.report import Study


def run(study: Callable[[Path], Study]) -> None:
    """Print the page of a study; with --out also write it, with CSV tables and SVG figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="?", default=DATA, help="folder of the data sets, one folder each")
    parser.add_argument("--out", type=Path, help="write the page, CSV tables and SVG figures here")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        parser.error(f"{arguments.data} is no folder; give the folder of the data sets, one folder each")
    done = study(arguments.data)
    print(done.to_markdown())
    if arguments.out is not None:
        for path in done.save(arguments.out):
            print(f"wrote {path}")
