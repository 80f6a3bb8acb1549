"""Check that the notebooks of a folder are stored without outputs; the documentation runs them."""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat


def check(path: Path) -> None:
    """Raise if a notebook has outputs."""
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code" and (cell.outputs or cell.execution_count is not None):
            raise SystemExit(f"{path} has outputs; strip them: jupyter nbconvert --clear-output --inplace {path}")


if __name__ == "__main__":
    found = sorted(Path(sys.argv[1]).glob("*.ipynb"))
    if not found:
        raise SystemExit(f"no notebooks in {sys.argv[1]}")
    for each in found:
        check(each)
