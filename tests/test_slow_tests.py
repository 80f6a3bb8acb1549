"""What `make test` leaves out exists: a test that is renamed does not stay on the list."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.conftest import SLOW

ROOT = Path(__file__).resolve().parents[1]


@cache
def functions(path: str) -> set[str]:
    """Names of the functions in a file."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_test_that_is_called_slow_exists() -> None:
    for name in SLOW:
        path, _, function = name.partition("::")
        assert function in functions(path), name
