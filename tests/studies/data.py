"""Recordings of a study: a folder of data sets, one folder each, with zip files of the own format."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pdr_filter.io.formats import read
from pdr_filter.io.recording import Recording


def recordings(data: Path, name: str, pattern: str = "*.zip") -> Iterator[Recording]:
    """Recordings of a data set whose file names match, by name; none if the folder lacks the set."""
    for path in sorted((data / name).glob(pattern)):
        yield read(path)


def has(data: Path, name: str) -> bool:
    """Whether the folder has the data set."""
    return any((data / name).glob("*.zip"))
