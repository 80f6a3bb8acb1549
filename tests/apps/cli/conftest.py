"""Recordings for the commands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import short_walk
from examples import leave_pictures_blank


@pytest.fixture(scope="module", autouse=True)
def _blank_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        leave_pictures_blank(patch)
        yield


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_walk().save(tmp_path_factory.mktemp("walks") / "short_walk.zip")


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.zip"
    path.write_text("this is no zip file")
    return path
