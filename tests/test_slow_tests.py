"""What `make test` leaves out exists: a test that is renamed does not stay on the list."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from tests.conftest import SLOW

ROOT = Path(__file__).resolve().parents[1]


@cache
def text_of(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def test_every_test_that_is_called_slow_exists() -> None:
    for name in SLOW:
        path, _, function = name.partition("::")
        assert f"def {function}(" in text_of(path), name
