"""Detection of the format of a file or folder from its content."""

from __future__ import annotations

from codecs import BOM_UTF8
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePosixPath

from pdr_filter.data.io.apps import get_sensor_data, indoor_location, ros_bag, sensor_logger
from pdr_filter.data.io.apps.ronin import SIGNATURE
from pdr_filter.data.io.files.archive import Members, open_members
from pdr_filter.data.io.files.own_format import OTHERS, REQUIRED
from pdr_filter.data.io.tables import json_tables
from pdr_filter.data.io.tables.any_table import TEXTS, sensors_of
from pdr_filter.data.io.tables.column_mapping import mapping_beside
from pdr_filter.data.io.tables.matlab import is_matlab
from pdr_filter.data.io.tables.spreadsheet import is_spreadsheet
from pdr_filter.data.io.tables.text_sheets import first_rows, text_sheet
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError

BINARIES = (".sqlite", ".db", ".mat")  # files in a zip or folder whose content is looked at, as that of texts is


def detect(path: Path) -> str:
    """Return the name of the format of a file or folder, such as "sensor_logger" or "table".

    It is "own" for missing files and unknown contents, because that reader explains the error. RecordingError if the
    file cannot be opened.
    """
    try:
        with open_members(path) as members:
            return _detect_among(members) if members.is_container else _detect_alone(members)
    except RecordingError:
        if not path.exists() and not any(parent.is_file() for parent in path.parents):
            return "own"
        raise


def _detect_among(members: Members) -> str:
    """Return the format of a zip file or a folder, from the names and first bytes of its files.

    Signatures decide first, then the first file of an app. Otherwise it is "table" if a file looks like a table of
    sensors or of unknown numbers, else "own".
    """
    by_name = {PurePosixPath(name).name: name for name in members.names}
    if is_spreadsheet(members):
        return "table"
    if sensor_logger.is_without_seconds_elapsed(members):
        return "sensor_logger"
    if "accelerometer.csv" in by_name:
        found = detect_file(members, by_name["accelerometer.csv"])
        if found == "sensor_logger" or (found == "table" and "meta.json" not in by_name):
            return found
        if "meta.json" in by_name or _has_own_header(members, by_name["accelerometer.csv"]):
            return "own"
    if "data.hdf5" in by_name and members.path.is_dir():
        return "ronin"
    if ros_bag.is_bag(members):
        return "ros_bag"
    texts = [name for name in members.names if name.lower().endswith((*TEXTS, *json_tables.SUFFIXES, *BINARIES))]
    found = [detect_file(members, name) for name in texts[: limits.MAX_FILES_LOOKED_AT]]
    of_apps = list(dict.fromkeys(format for format in found if format not in ("", "table")))
    if of_apps:
        return of_apps[0]
    is_table = "table" in found or any(map(partial(_is_unknown_table, members), texts[: limits.MAX_FILES_LOOKED_AT]))
    return "table" if is_table else "own"


def _is_unknown_table(members: Members, name: str) -> bool:
    """Return True for a text with numbers in no known layout, which the table reader refuses with the reason."""
    with suppress(RecordingError):
        if name.lower().endswith(TEXTS) and not _has_own_header(members, name):
            return text_sheet(members, name) is not None
        if name.lower().endswith(json_tables.SUFFIXES) and json_tables.is_json(members.head(name)):
            return any(len(first_rows(sheet)) >= limits.MIN_SAMPLES for sheet in json_tables.json_sheets(members, name))
    return False


def _has_own_header(members: Members, name: str) -> bool:
    """Return True if the first line of a file has a column `time_s`, as the project's own format has."""
    line = members.head(name).removeprefix(BOM_UTF8).partition(b"\n")[0]
    return b"time_s" in [field.strip(b' \r"') for field in line.split(b",")]


def _detect_alone(members: Members) -> str:
    """Return the format of a single file.

    It is "generic_csv" if a column mapping lies beside the file, unless the format has its own TOML file.
    """
    path, name = members.path, members.names[0]
    found = detect_file(members, name)
    if mapping_beside(path).is_file() and mapping_beside(path) != path:
        return found if found in ("get_sensor_data", "ronin") else "generic_csv"
    head = members.head(name)
    if (
        not found
        and path.name == REQUIRED
        and _has_own_header(members, name)
        and any(path.with_name(other).is_file() for other in OTHERS)
    ):
        return "own"  # which asks for the folder
    if found == "sensor_logger" and head.lstrip()[:1] not in (b"[", b"{") and not head.startswith(b"SQLite"):
        return "table"  # one sensor of it
    if not found and b"\x00" not in head[:4096] and any(mark in head[:4096] for mark in (b",", b";", b"\t", b"/")):
        return "table"  # which says what it saw
    return found or "own"


def detect_file(members: Members, name: str) -> str:
    """Return the format that the first bytes of a file show, "" for the own format and unknown contents."""
    head = members.head(name)
    if head.startswith(SIGNATURE):
        return "ronin"
    if is_matlab(head) or is_spreadsheet(members, name):
        return "table"
    if ros_bag.is_ros_bag(head):
        return "ros_bag"
    if sensor_logger.looks_like_export(head):
        return "sensor_logger"
    if json_tables.is_json(head):
        return "table" if sensors_of(members, name) else ""
    if indoor_location.is_indoor_location(head):
        return "indoor_location"
    if get_sensor_data.is_get_sensor_data(head):
        return "get_sensor_data"
    line = head.removeprefix(BOM_UTF8).split(b"\n", 1)[0].decode("latin-1").rstrip("\r")
    if sensor_logger.is_sensor_logger(line):
        return "sensor_logger"
    is_own = line.startswith("time_s,")
    return "table" if not is_own and name.lower().endswith(TEXTS) and sensors_of(members, name) else ""
