"""What tests of the command share: a walk, and a file that is none."""

from __future__ import annotations

from pathlib import Path

import pytest

import pdr_filter as pdr
from pdr_filter.io.own_format import write_recording


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The simulated walk as a file."""
    return write_recording(pdr.simulate.demo_walk(), tmp_path_factory.mktemp("walks") / "demo_walk.zip")


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.zip"
    path.write_text("this is no zip file")
    return path
