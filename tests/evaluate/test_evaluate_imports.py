"""Metrics are functions on arrays: what runs the filter is in two modules."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import pdr_filter

PACKAGE = Path(pdr_filter.__file__).resolve().parent


def packages_of(path: Path) -> set[str]:
    """Packages that a module imports from, in functions too."""
    modules = [n.module or "" for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
    own = [module.split(".")[1:] for module in modules if module.startswith("pdr_filter.")]
    return {"/".join(parts[: 2 if parts[0] in ("data", "apps") else 1]) for parts in own}


@pytest.mark.parametrize(
    ("package", "below", "apart"),
    [
        ("evaluate", {"values", "classifiers"}, {"runs.py", "__init__.py"}),
        ("simulate", {"values"}, set()),
        ("apps/report", {"values", "data/io", "apps/maps", "tracking"}, set()),
    ],
)
def test_a_package_imports_only_those_below_that_it_needs(package: str, below: set[str], apart: set[str]) -> None:
    paths = {path.name: path for path in (PACKAGE / package).glob("*.py")}
    assert len(paths) > len(apart) + 3
    assert {name: found for name, path in paths.items() if (found := packages_of(path) - below - {package})}.keys() == (
        apart - {"__init__.py"}
    )
