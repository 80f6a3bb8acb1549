"""Several recordings in one zip or log, and which files of a folder are one: two walks that are exported together."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath

from pdr_filter.io import limits, sensor_logger
from pdr_filter.io.any_table import TEXTS, sensors_of
from pdr_filter.io.archive import Members, open_members, zips_among
from pdr_filter.io.columns import ACCELERATION, GRAVITY, LINEAR, VECTORS
from pdr_filter.io.json_tables import SUFFIXES

# Files whose names say that the folder around them is one recording.
_MEMBERS = {"accelerometer.csv", "accelerometer.json", "data.hdf5", "metadata.csv", "metadata.yaml", "raw data.csv"}
_WHOLE = ("get_sensor_data", "indoor_location", "core_motion", "ronin")


def parts_of(path: Path, format_of: Callable[[Members, str], str]) -> list[str]:
    """What is to be put behind a path that holds several recordings, of each; empty of any other.

    Of a folder only its own files are looked at; it is one recording if some of them are, whatever else lies there.
    """
    if not path.exists():
        return []
    with open_members(path) as members:
        if not members.is_container:
            sessions = sensor_logger.sessions_of(members)
            return sessions if len(sessions) > 1 else []
        parts = zips_among(members.names) or recordings_among(members, members.names, format_of)
    return parts if len(parts) > 1 and not (path.is_dir() and "." in parts) else []


def recordings_among(members: Members, names: Iterable[str], format_of: Callable[[Members, str], str]) -> list[str]:
    """Folders, and files, of which each is one recording; "." is the folder of all.

    A file with an accelerometer alone and files of other sensors beside it are one, with whatever lies there, too.
    Files of which each has all its sensors, or of which there are none but accelerometers, are one each.
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
        force: list[str] = []
        others: set[str] = set()
        for name in files:
            if not name.lower().endswith((*TEXTS, *SUFFIXES)) or n_looked_at >= limits.MAX_FILES_LOOKED_AT:
                continue
            n_looked_at += 1
            format = format_of(members, name)
            sensors = sensors_of(members, name) if format in ("phyphox", "sensor_logger", "table") else set[str]()
            has_force = ACCELERATION in sensors or {LINEAR, GRAVITY} <= sensors
            if format in _WHOLE or (has_force and sensors - {ACCELERATION, LINEAR, GRAVITY}):
                whole.append(name)
            elif has_force:
                force.append(name)
            else:
                others |= sensors & set(VECTORS)
        if (force and others) or {LINEAR, GRAVITY} <= others or (len(force) == 1 and not whole):
            found.append(folder)
        else:
            found += force
        found += whole
    return found
