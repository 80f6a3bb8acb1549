"""Doctests run in a temporary folder, because some examples write files."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _examples_are_elsewhere(request: pytest.FixtureRequest) -> None:
    # Not a folder for every test: the time to make one grows with their number, to 13 s for 4000 tests of a worker.
    if isinstance(request.node, pytest.DoctestItem):
        request.getfixturevalue("monkeypatch").chdir(request.getfixturevalue("tmp_path"))
