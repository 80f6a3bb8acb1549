"""Recordings in folders."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pdr_filter.io.formats import detect
from pdr_filter.io.generic_csv import mapping_beside

# Files whose names say that the folder around them is one recording.
_MEMBERS = {"accelerometer.csv", "accelerometer.json", "data.hdf5", "metadata.csv", "raw data.csv"}
# Endings of which a folder that is one recording has one file each, whatever its owner put before them.
_SENSORS = ("accelerometer.csv", "gyroscope.csv")
_TEXTS = {".csv", ".txt", ".json"}
_FILES = {".zip", ".hdf5", ".h5"}


def recordings_of(paths: str | Path | Iterable[str | Path]) -> list[str]:
    """Absolute paths, each once and in order; a folder that is not a recording stands for all recordings in it."""
    found: list[Path] = []
    for path in [paths] if isinstance(paths, str | Path) else paths:
        path = Path(path)
        found += (recordings_in(path) or [path]) if path.is_dir() else [path]
    return list(dict.fromkeys(str(path.resolve()) for path in found))


def recordings_in(folder: str | Path) -> list[Path]:
    """Paths of the recordings in a folder and the folders in it, sorted.

    Every zip and hdf5 file is taken for one, so that a broken one is reported; text files only if they look like one of
    the known formats, or have a TOML file of their columns beside them.
    """
    folder = Path(folder)
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    names = [path.name.lower() for path in inside]
    if _MEMBERS.intersection(names) or all(sum(n.endswith(end) for n in names) == 1 for end in _SENSORS):
        return [folder]
    found: list[Path] = []
    for path in inside:
        if path.is_dir() and not path.is_symlink():
            found += recordings_in(path)
        elif path.is_file() and (path.suffix.lower() in _FILES or (path.suffix.lower() in _TEXTS and _is_known(path))):
            found.append(path)
    return found


def _is_known(path: Path) -> bool:
    try:
        found = detect(path)
    except Exception:
        return True  # something is wrong with it, which its row will say
    return found != "own" and (found != "generic_csv" or mapping_beside(path).is_file())
