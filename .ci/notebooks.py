"""Run every notebook of a folder, after checking that its outputs are stripped."""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient


def check(path: Path) -> None:
    """Run one notebook; raises if it has outputs or an error."""
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code" and (cell.outputs or cell.execution_count is not None):
            raise SystemExit(f"{path} has outputs; strip them: jupyter nbconvert --clear-output --inplace {path}")
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(path.parent)}}).execute()
    print(f"{path} runs")


if __name__ == "__main__":
    found = sorted(Path(sys.argv[1]).glob("*.ipynb"))
    if not found:
        raise SystemExit(f"no notebooks in {sys.argv[1]}")
    for each in found:
        check(each)
