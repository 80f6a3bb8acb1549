"""Recordings in folders, and in files that hold several."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path, PurePosixPath

from pdr_filter.io import limits
from pdr_filter.io.any_table import sensors_of
from pdr_filter.io.archive import IN_PLACE, Members
from pdr_filter.io.columns import ACCELERATION, GRAVITY, LINEAR, quantity_of_file
from pdr_filter.io.detection import detect, detect_file
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.generic_csv import mapping_beside
from pdr_filter.io.json_tables import SUFFIXES
from pdr_filter.io.several import parts_of, recordings_among

_TEXTS = {".csv", ".txt", ".tsv", *SUFFIXES}
_FILES = {".zip", ".gz", ".sqlite", ".db", *IN_PLACE}


def recordings_of(paths: str | Path | Iterable[str | Path]) -> list[str]:
    """Absolute paths, each once and in order; a folder that is not a recording stands for all recordings in it."""
    found: list[Path] = []
    for path in [paths] if isinstance(paths, str | Path) else paths:
        path = Path(path)
        found += (recordings_in(path) or [path]) if path.is_dir() else [path]
    return list(dict.fromkeys(str(path.resolve()) for path in found))


def recordings_in(folder: str | Path) -> list[Path]:
    """Paths of the recordings in a folder and the folders in it, sorted; of one that is a recording, its own.

    Every zip and hdf5 file is taken for one, so that a broken one is reported; text files only if they look like one of
    the known formats, or have a TOML file of their columns beside them. A file that holds several stands for each.
    """
    folder = Path(folder)
    if folder.is_file():
        return _each_of(folder)
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    if _is_one(folder):
        return [folder]
    found: list[Path] = []
    for path in inside:
        if path.is_dir() and not path.is_symlink():
            found += recordings_in(path)
        elif path.is_file() and (path.suffix.lower() in _FILES or (path.suffix.lower() in _TEXTS and _is_known(path))):
            found += _each_of(path)
    return found


def only_recording_in(path: Path) -> Path:
    """The path, or the only recording in a folder around it; RecordingError if there are several."""
    parts = parts_of(path, detect_file)
    # Neither is anybody's home folder searched, nor is a link followed to what nobody gave.
    below = list(islice(path.rglob("*"), limits.MAX_MEMBERS)) if path.is_dir() else []
    is_searched = 0 < len(below) < limits.MAX_MEMBERS and not any(entry.is_symlink() for entry in below)
    if is_searched and (parts or detect(path) == "own"):
        found = recordings_in(path)
        if len(found) == 1:
            return found[0]
        parts = [str(recording.relative_to(path)) for recording in found]
    if parts:
        listed = ", ".join(parts[:3])
        if all(quantity_of_file(PurePosixPath(part).parent.name)[0] for part in parts):
            raise RecordingError(
                f"{path}: several files of a sensor in its folder ({listed}); make a folder of each recording instead"
            )
        raise RecordingError(
            f"{path}: holds {len(parts)} recordings ({listed}{', ...' if parts[3:] else ''}); read one, such as "
            f"{path / parts[0]}, or each that pdr_filter.io.folders.recordings_in lists"
        )
    return path


def _is_one(folder: Path) -> bool:
    """Whether the files of a folder are one recording: others in it are left out, with a note."""
    try:
        members = Members(folder)
        return "." in recordings_among(members, [name for name in members.names if name[0] != "."], detect_file)
    except Exception:
        return False  # something is wrong with one of them, which its row will say


def _each_of(path: Path) -> list[Path]:
    try:
        return [path / part for part in parts_of(path, detect_file)] or [path]
    except Exception:
        return [path]  # something is wrong with it, which its row will say


def _is_known(path: Path) -> bool:
    try:
        found = detect(path)
        if found == "table":  # the table of a track has locations, too
            return bool({ACCELERATION, LINEAR, GRAVITY} & sensors_of(Members(path), path.name))
        return found != "own" and (found != "generic_csv" or mapping_beside(path).is_file())
    except Exception:
        return True  # something is wrong with it, which its row will say
