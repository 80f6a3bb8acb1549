"""Recordings in folders, and in files with several recordings."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path, PurePosixPath

from pdr_filter.data.io.apps import sensor_logger
from pdr_filter.data.io.column_names import ACCELERATION, GRAVITY, LINEAR, RATE, VECTORS, trial_of
from pdr_filter.data.io.detection import BINARIES, detect, detect_file
from pdr_filter.data.io.files.archive import IN_PLACE, Members, open_members, sensor_folders, zips_among
from pdr_filter.data.io.tables.any_table import TEXTS, sensors_of
from pdr_filter.data.io.tables.column_mapping import mapping_beside
from pdr_filter.data.io.tables.cut_files import in_time, is_numbered
from pdr_filter.data.io.tables.json_tables import SUFFIXES
from pdr_filter.data.io.tables.text_sheets import text_sheet
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

_TEXTS = {".csv", ".txt", ".tsv", *SUFFIXES}
_FILES = {".zip", ".gz", *BINARIES, *IN_PLACE}
# Files whose names say that the folder around them is one recording.
_MEMBERS = {"accelerometer.csv", "accelerometer.json", "data.hdf5", "metadata.csv", "metadata.yaml", "raw data.csv"}
_PERSON = re.compile(r"([^\W\d_]+\d*)(?=[-_ .])")  # in any script
_DATE = re.compile(r"\d{4}-?\d\d-?\d\d")  # in the names of exports
_NO_PERSON = re.compile(
    r"(rec(ord(ing)?)?|walk(ing)?|run(ning)?|stairs|trial|test|session|take|sensors?|log|data|export|file|new|my"
    r"|untitled|track|way|upstairs|downstairs|standing|stationary|elevator|escalator|texting|pocket|swinging|calling|bag"
    r"|hand|jog(ging)?|sit(ting)?|iphone|phone|android|samsung|pixel)\d*"
)
_PEOPLE = "people from the names of files:"
_WHOLE = ("get_sensor_data", "indoor_location", "ronin")


def recordings_of(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return the paths of all recordings that the given paths stand for, in order.

    A folder, or a file with several recordings, stands for its recordings (`recordings_in`), and for itself if there
    is none. A path that does not exist stays.
    """
    given = [paths] if isinstance(paths, str | Path) else paths
    found: list[Path] = []
    for path in map(Path, given):
        found += (recordings_in(path) if path.exists() else []) or [path]
    return found


def absolute_recordings_of(paths: str | Path | Iterable[str | Path]) -> list[str]:
    """Return the absolute paths of `recordings_of`, each once."""
    return list(dict.fromkeys(str(path.resolve()) for path in recordings_of(paths)))


def with_person_of_file(recording: Recording, path: str | Path) -> Recording:
    """Return a recording that names no person with the person in the name of its file, if it has one, and a note."""
    path = Path(path)
    if recording.subject.id or not (person := person_of_file(path)):
        return recording
    people = _people_beside(path)
    subject = {**(recording.meta.get("subject") or {}), "id": person}
    note = (
        f"{_PEOPLE} {', '.join(people[:8])}{', ...' if people[8:] else ''} ({path.parent}), because they begin with "
        "several words; if these are no people, write a word such as walk_ in front of each name, or subject.id in the "
        "metadata"
    )
    return replace(recording, meta={**recording.meta, "subject": subject}, notes=(*recording.notes, note))


def person_of_file(path: Path) -> str:
    """Return the person in the name of a file of a study, or an empty string if the names are not of several people."""
    own = _PERSON.match(path.name)
    return own[1].lower() if own is not None and path.is_file() and _people_beside(path) else ""


def _people_beside(path: Path) -> tuple[str, ...]:
    return _people_in(path.parent, path.suffix, path.parent.stat().st_mtime_ns)


def notes_on_people(recordings: Iterable[Recording]) -> list[str]:
    """Return the different notes of `with_person_of_file` on recordings."""
    return list(dict.fromkeys(note for one in recordings for note in one.notes if note.startswith(_PEOPLE)))


@lru_cache(maxsize=1000)
def _people_in(folder: Path, suffix: str, *version: int) -> tuple[str, ...]:
    """Return the names of people with which the recordings of a kind in a folder begin, as in `anna_1-2024-05-01.zip`.

    They begin with different names, of which one is there again or all have the date of an export. Words such as walk
    or trial are no names.
    """
    files = [entry for entry in folder.iterdir() if entry.suffix == suffix]
    names = [file.name for file in files if suffix.lower() in _FILES or _is_known(file)]  # not files of fixes
    found = [match[1].lower() for name in names if (match := _PERSON.match(name)) is not None]
    people = tuple(sorted(set(found)))
    if len(found) < len(names) or any(map(_NO_PERSON.fullmatch, found)) or len(people) < 2:
        return ()
    return people if len(people) < len(found) or all(map(_DATE.search, names)) else ()


def recordings_in(folder: str | Path) -> list[Path]:
    """Return the sorted paths of the recordings in a folder and in its subfolders.

    If the folder itself is one recording, the result is its path, with the recordings beside its folders of sensors, if
    it has such. Hidden files and linked folders are skipped. Every zip and hdf5 file counts, so that a broken one is
    reported later. A text file counts if it looks like a known format, or if a TOML file beside it describes its
    columns. A file with several recordings gives a path for each, such as `export.zip/walk_2`, and files such as
    `walk1_acc.csv` and `walk1_gyro.csv` beside those of `walk2` give `walk1` and `walk2`.
    """
    folder = Path(folder)
    if folder.is_file():
        return [folder / part for part in _parts_in(folder)] or [folder]
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    is_mapped = any(
        mapping_beside(path).is_file() for path in inside if path.suffix.lower() in _TEXTS and path.is_file()
    )
    parts = [] if is_mapped else _parts_in(folder)
    is_one = "." in parts
    of_sensors = sensor_folders(path.name for path in inside if path.is_dir()) if parts else set[str]()
    if is_one and not of_sensors:
        return [folder]
    trials = [part for part in parts if not (folder / part).exists()]
    found = [folder / part for part in parts if part == "." or part in trials]
    for path in inside:
        if path.is_dir() and not path.is_symlink():
            if path.name not in of_sensors or not (trials or is_one):
                found += [path / part for part in _parts_in(path)] if is_one else recordings_in(path)
        elif is_one:
            continue
        elif (
            path.is_file() and (path.suffix.lower() in _FILES or _is_known(path)) and trial_of(path.name) not in trials
        ):
            found += [path / part for part in _parts_in(path)] or [path]
    return found


def only_recording_in(path: Path) -> Path:
    """Return the path of a file with one recording, or of the only recording in a folder.

    A folder that has links or very many files is not searched and returned itself. RecordingError for several
    recordings, or for a folder without any.
    """
    # A search of a whole home folder would take long, and links lead to files that were not given.
    below = list(islice(path.rglob("*"), limits.MAX_MEMBERS)) if path.is_dir() else []
    if path.is_dir():
        is_searched = 0 < len(below) < limits.MAX_MEMBERS and not any(entry.is_symlink() for entry in below)
        found = recordings_in(path) if is_searched else [path]
        if len(found) == 1:
            return found[0]
        parts = [str(recording.relative_to(path)) for recording in found]
    else:
        parts = parts_of(path)
    if not parts:
        return path
    listed = ", ".join(parts[:3])
    first = next(part for part in parts if part != ".")  # which is `path` again
    raise RecordingError(
        f"{path}: holds {len(parts)} recordings ({listed}{', ...' if parts[3:] else ''}); read one, such as "
        f"{path / first}, or each that pdr_filter.data.io.folders.recordings_in lists"
    )


def parts_of(path: Path) -> list[str]:
    """Return the names of the recordings in a file, which continue its path. Empty for a file with one recording."""
    if not path.exists():
        return []
    with open_members(path) as members:
        if not members.is_container:
            parts = sensor_logger.sessions_of(members)
        else:
            parts = zips_among(members.names) or recordings_among(members, members.names)
    return parts if len(parts) > 1 else []


def recordings_among(members: Members, names: Iterable[str]) -> list[str]:
    """Return the paths of those folders and files among the names that are one recording each.

    "." stands for the folder of all names. A folder with a typical file of an export, such as `Accelerometer.csv`, is a
    recording. In others, each file that has an acceleration and another sensor is one. Sensors in separate files make
    the folder one recording, or each trial if their names show several (`_of_one_sensor`).
    """
    by_folder: dict[str, list[str]] = {}
    for name in list(names)[: limits.MAX_MEMBERS]:
        pure = PurePosixPath(name)
        if pure.parent.name != "meta":
            by_folder.setdefault(str(pure.parent), []).append(name)
    found: list[str] = []
    n_looked_at = 0
    for folder, files in sorted(by_folder.items()):
        if _MEMBERS.intersection(PurePosixPath(name).name.lower() for name in files):
            found.append(folder)
            continue
        whole: list[str] = []
        of_sensors: dict[str, set[str]] = {}  # the other files, with their sensors
        for name in files:
            if not name.lower().endswith((*TEXTS, *SUFFIXES)) or n_looked_at >= limits.MAX_FILES_LOOKED_AT:
                continue
            n_looked_at += 1
            format = detect_file(members, name)
            sensors = sensors_of(members, name) if format in ("sensor_logger", "table") else set[str]()
            has_force = ACCELERATION in sensors or {LINEAR, GRAVITY} <= sensors
            if format in _WHOLE or (has_force and sensors - {ACCELERATION, LINEAR, GRAVITY}):
                whole.append(name)
            else:
                of_sensors[name] = {ACCELERATION} if has_force else sensors & set(VECTORS)
        found += _of_one_sensor(members, folder, of_sensors, not whole)
        found += whole
    return found


def _of_one_sensor(members: Members, folder: str, of_sensors: dict[str, set[str]], is_all: bool) -> list[str]:
    """Return the recordings in a folder, for its files of one sensor each, which `of_sensors` has by name.

    These are the trials, if two or more have an acceleration and a gyroscope, unless their files continue each other in
    time as those of each hour do; else the folder, if it has an
    acceleration and another sensor, or one acceleration file alone (`is_all`: no file is a recording by itself); else
    each file with an acceleration that includes gravity.
    """
    trials: dict[str, set[str]] = {}
    for name, sensors in of_sensors.items():
        trials.setdefault(trial_of(name), set()).update(sensors)
    whole = [
        trial for trial, sensors in trials.items() if trial and RATE in sensors and sensors & {ACCELERATION, LINEAR}
    ]
    if len(whole) > 1:
        forces = [name for name, sensors in of_sensors.items() if sensors & {ACCELERATION, LINEAR}]
        tables = [text_sheet(members, name) for name in forces if is_numbered(name)]
        sheets = [table for table in tables if table is not None]
        if len(sheets) == len(forces) and in_time(sheets) is not None:
            return [folder]
        return [str(PurePosixPath(folder) / trial) for trial in whole]
    kinds = set[str]().union(*of_sensors.values())
    force_of = ACCELERATION if ACCELERATION in kinds else LINEAR
    force = [name for name, sensors in of_sensors.items() if force_of in sensors]
    is_one = bool(force and kinds - {force_of}) or (len(force) == 1 and is_all)
    return [folder] if is_one else force if force_of == ACCELERATION else []


def _parts_in(path: Path) -> list[str]:
    """Return the names of the recordings in a file or folder, relative to it. "." is the folder itself.

    The list is empty for a file with a single recording, and if a file cannot be read.
    """
    try:
        if path.is_file():
            found = path.stat()
            return list(_parts_of_version(path, found.st_size, found.st_mtime_ns))
        return list(_parts_of_folder(path, Members(path).version()))
    except Exception:
        return []  # something is wrong with one of them, which its row will say


@lru_cache(maxsize=20_000)
def _parts_of_version(path: Path, *version: int) -> tuple[str, ...]:
    """Return `parts_of` a file of this size and time of change, cached because folders are scanned repeatedly."""
    return tuple(parts_of(path))


@lru_cache(maxsize=1000)
def _parts_of_folder(path: Path, version: object) -> tuple[str, ...]:
    """Return `recordings_among` the files in a folder of this `Members.version`, cached as files are."""
    members = Members(path)
    return tuple(recordings_among(members, [name for name in members.names if name[0] != "."]))


def _is_known(path: Path) -> bool:
    """Return True for a text file with a recording of its own, and for one that cannot be read."""
    if path.suffix.lower() not in _TEXTS:
        return False
    try:
        found = detect(path)
        if found == "table":  # the table of a track has locations, too
            return bool({ACCELERATION, LINEAR, GRAVITY} & sensors_of(Members(path), path.name))
        return found != "own" and (found != "generic_csv" or mapping_beside(path).is_file())
    except Exception:
        return True  # something is wrong with it, which its row will say
