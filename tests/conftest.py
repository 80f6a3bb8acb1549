"""Shared fixtures: where the real recordings are, and what happens where they are not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.data_folder import DATA

# Tests that `make test` leaves to `make test-all` and CI: all that took more than about a second of one core, and those
# of studies, training and pages in a browser, which together take long.
SLOW = frozenset((Path(__file__).parent / "slow_tests.txt").read_text().split())


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings; skips on a user's machine without them, fails in CI."""
    if not DATA.is_dir():
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI needs the recordings at {DATA}")
        pytest.skip(f"no recordings at {DATA}")
    return DATA


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is slow."""
    for item in items:
        if item.nodeid.partition("[")[0] in SLOW:
            item.add_marker(pytest.mark.slow)
