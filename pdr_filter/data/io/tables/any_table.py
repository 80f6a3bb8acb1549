"""Tables of any app, with or without a mapping: texts and JSON, alone or in a zip or folder, spreadsheets, MATLAB."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.column_names import (
    ACCELERATION,
    LINEAR,
    RATE,
    SENSOR_CODES,
    VECTORS,
    column_of,
    letters,
    quantity_of_file,
    trial_of,
    words_of,
)
from pdr_filter.data.io.files.archive import Members, open_members
from pdr_filter.data.io.tables.app_dialects import dialect_of, said_platform
from pdr_filter.data.io.tables.column_groups import Group, groups_of, phone_groups_of
from pdr_filter.data.io.tables.column_guess import Guess, NoAccelerometerError, guess
from pdr_filter.data.io.tables.column_mapping import Mapping, mapping_beside, read_mapping
from pdr_filter.data.io.tables.column_template import asked_mapping
from pdr_filter.data.io.tables.cut_files import with_cut_files_joined
from pdr_filter.data.io.tables.dates import is_date
from pdr_filter.data.io.tables.json_tables import SUFFIXES, is_json, json_fields, json_sheets
from pdr_filter.data.io.tables.matlab import is_matlab, matlab_sheets
from pdr_filter.data.io.tables.phyphox_experiment import read_experiment
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.spreadsheet import is_spreadsheet, spreadsheet_sheets
from pdr_filter.data.io.tables.table_streams import Zero, fill_streams
from pdr_filter.data.io.tables.text_sheets import TextRows, by_text, text_sheet, text_sheets
from pdr_filter.data.io.text_table import SEPARATORS, UNKNOWN, header_fields, to_number
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

TEXTS = (".csv", ".txt", ".tsv", ".log", ".dat")
# Columns that say of which sensor a row is.
_TYPES = ("type", "name", "sensor", "sensortype", "messagetype", "event", "eventtype", "kind")
_LINES_LOOKED_AT = 40
_NAMED_VALUE = re.compile(r"(?m)(?:^|[\s,;])([A-Za-z]+ ?[:=] ?[-+.]?\d)")
_BEGINS_AS_NUMBER = re.compile(r"[+\u2212-]?\d")  # in the digits of any script
_DEVICES = ("device", "deviceid", "devicename", "phone", "phoneid", "phonename", "sensorid")  # that say whose a row is


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """Pair of a recording that was read from tables and the column mapping with which it was read."""

    recording: Recording
    guess: Guess  # mapping of the columns, as guessed from names and values


def read_any_table(path: str | Path, platform: str | None = None) -> Recording:
    """Return the recording in the tables of an app, which are recognised by their columns.

    `platform` ("ios" or "android") determines the sign of the acceleration if the app writes different signs. Gravity
    is added to an acceleration that lacks it, with a note. RecordingError if there is no acceleration, if its sign or
    unit is unknown, or if the file or the app decides the sign, too.
    """
    return read_guessed(Path(path), platform).recording


def read_guessed(path: Path, platform: str | None = None) -> Tables:
    """Read a recording, and return it with the column mapping that was guessed and the evidence for it."""
    with open_members(path) as members:
        notes: list[str] = []
        filled = filled_by_guess(members, path, platform, sheets_of(members, notes=notes), notes)
    try:
        return Tables(filled.parsed.recording(), filled.guess)
    except RecordingError as error:
        raise RecordingError(f"{error} (read as {filled.guess.source})") from error


class Filled(NamedTuple):
    """Streams of tables, and how they were read."""

    parsed: Parsed
    guess: Guess
    sheets: Sequence[Sheet]  # tables with the columns in use
    zero: Zero  # origin of the times


def filled_by_guess(
    members: Members, path: Path, platform: str | None, tables: Sequence[Sheet], notes: list[str]
) -> Filled:
    """Return the streams of tables whose columns are guessed. `notes` are those about the tables so far."""
    parsed, sheets = Parsed(path, "", notes=notes), list(tables)
    where = sheets[0].where if len(sheets) == 1 else str(path)
    groups = [group for i, sheet in enumerate(sheets) for group in groups_of(sheet, i)]
    if not groups:
        raise RecordingError(f"{where}: {_nothing(sheets, path)}")
    groups += _of_phone(sheets, groups)
    for i, sheet in enumerate(sheets):
        used = {place for group in groups if group.sheet == i for place in (*group.places, *group.bias, group.time)}
        sheets[i] = sheet.using(used, parsed.notes)
    shown = "\n".join([*(f"{s.about}\n{','.join(s.fields)}" for s in sheets), *members.names[:100]])
    dialect = dialect_of(shown)
    if dialect.sign is None:
        said = said_platform(members, "\n".join(sheet.about for sheet in sheets))
        if platform and said and said != platform:
            raise RecordingError(f"{where}: its metadata say {said}, and platform is {platform}; leave platform out")
        platform = platform or said or None
    try:
        found = guess(sheets, groups, dialect, platform, where)
    except NoAccelerometerError as error:
        if (folder := _folder_of_recording(members)) is None:
            raise
        problem = str(error).partition("; ")[0]
        raise RecordingError(f"{problem}; this is one sensor of a recording: give its folder {folder}") from None
    parsed.instead = dialect.instead
    zero = fill_streams(parsed, found.mapping, sheets)
    parsed.source = found.source
    read_experiment(members, parsed)
    parsed.found += found.evidence
    used = {name for stream in found.mapping.streams for name in (*stream.columns, *stream.bias, stream.time)}
    beside = [name for s in sheets if not used.isdisjoint(s.fields) for name in s.fields if name not in used]
    if beside:
        parsed.found.append(f"columns not used: {', '.join(dict.fromkeys(beside))[:300]}")
    columns = [column_of(0, name) for name in dict.fromkeys(beside)]
    axes = [column.name for column in columns if column.axis and column.quantity in ("", RATE)]
    if axes and "gyroscope" not in parsed.streams:
        parsed.notes.append(
            f"columns not used: {', '.join(axes)[:300]}: they give no gyroscope, which needs three axes with names "
            "such as gx, gy, gz; correct the names, or give a mapping with pdr-filter convert FILE --map MAP.toml"
        )
    parsed.notes[:] = list(dict.fromkeys([*found.notes, *parsed.notes]))
    parsed.is_unit_of_time_declared = found.is_time_declared
    return Filled(parsed, found, sheets, zero)


def read_generic_csv(path: str | Path) -> Recording:
    """Return the recording in a table whose columns a TOML file of the same name in its folder describes."""
    path = Path(path)
    if not (mapping := mapping_beside(path)).is_file():
        raise RecordingError(
            f"{path}: no {mapping.name} beside it that says which column is what; "
            f"pdr-filter convert {path} shows a mapping to begin with"
        )
    return read_mapped(path, read_mapping(mapping))


def read_mapped(path: Path, mapping: Mapping) -> Recording:
    """Read a recording from tables whose columns a mapping describes. RecordingError if a column is missing."""
    parsed = Parsed(path, "generic CSV")
    with open_members(path) as members:
        sheets = sheets_of(members, mapping.separator or None, parsed.notes)
        if decimal := mapping.decimal:
            texts = {s: replace(s.parse, decimal=decimal) for s in sheets if isinstance(s.parse, TextRows)}
            sheets = [replace(s, parse=texts.get(s, s.parse)) for s in sheets]
        names = {name for stream in mapping.streams for name in (stream.time, *stream.columns, *stream.bias)}
        used = [{i for i, name in enumerate(sheet.fields) if name in names} for sheet in sheets]
        sheets = [sheet.using(places, parsed.notes) for sheet, places in zip(sheets, used, strict=True)]
        fill_streams(parsed, mapping, sheets)
    for stream in mapping.streams:
        columns = ", ".join(stream.columns)
        unit = stream.unit or "unit as it is"
        parsed.found.append(f"{stream.stream}: {columns}, {unit}, factor {stream.factor:.6g}, as given")
    parsed.notes[:] = list(dict.fromkeys(parsed.notes))
    return parsed.recording()


def sheets_of(members: Members, separator: str | None = None, notes: list[str] | None = None) -> Sequence[Sheet]:
    """Return the tables among the files of a recording: text, JSON, spreadsheet or MATLAB.

    A text with rows of several sensors gives a table for each. `separator` is that of texts, detected if None. `notes`
    get what was skipped. RecordingError if there is no table, if there are too many, or if one has rows of several
    devices.
    """
    found: Sequence[Sheet]
    if is_spreadsheet(members):
        found = spreadsheet_sheets(members)
    elif not members.is_container and is_matlab(members.head(members.names[0], 128)):
        found = matlab_sheets(members, members.names[0])
    else:
        texts = [name for name in members.names if _is_text(name, members)]
        if len(texts) > limits.MAX_FILES_LOOKED_AT:
            raise RecordingError(
                f"{members.path}: {len(texts)} tables, and at most {limits.MAX_FILES_LOOKED_AT} are read; leave out "
                "those of other recordings, or divide the files into folders by time and read these as parts: "
                "pdr_filter.read([folder, folder])"
            )
        of_json = [name for name in texts if is_json(members.head(name, 4096))]
        whole = [sheet for name in texts if name not in of_json for sheet in text_sheets(members, name, separator)]
        for sheet in whole:
            _check_one_device(sheet)
        found = with_cut_files_joined([part for sheet in whole for part in _by_sensor(sheet)], notes)
        for name in of_json:
            if not members.is_container or sensors_of(members, name):
                found += json_sheets(members, name, notes)
        for name in of_json if not found else ():
            found += json_sheets(members, name, notes)
        for name in members.names if not found else ():
            if name.lower().endswith(".mat") and is_matlab(members.head(name, 128)):
                found += matlab_sheets(members, name)
    if not found:
        listed = ", ".join(members.names[:8])
        head = b"" if members.is_container else next(members.pieces(members.names[0]), b"")[:4096]
        no_table = "a table has a line of names, and below it a line of numbers for each sample, two or more"
        if members.path.suffix.lower() == ".toml":
            no_table = f"this is a mapping; give it a recording: pdr-filter convert FILE --map {members.path}"
        why = _named_values(head) or _unusual_number(head)
        why = why or f"no table of samples in it (found: {listed or 'nothing'}); {no_table}"
        raise RecordingError(f"{members.path}: {why}")
    return found


def _named_values(head: bytes) -> str:
    """Return the reason why lines such as `ACC: 12, 0.1, 0.2, 9.8` or `x=0.1` cannot be read, or "" for other lines."""
    lines = [line for line in head.decode("utf-8", "replace").splitlines()[:_LINES_LOOKED_AT] if line.strip()]
    named = [found for line in lines if (found := _NAMED_VALUE.search(line)) is not None]
    if 2 * len(named) <= len(lines):  # a few such lines above the table are comments
        return ""
    found = named[0]
    return (
        f"its lines have names in front of their numbers ({found[1]!r}); write the names once, in a line above, and "
        "the sensor of each line in a column of its own, as in sensor,time,x,y,z"
    )


def _unusual_number(head: bytes) -> str:
    """Return why the first line of a table cannot be read: a number of it, such as `1.0D+00`. "" for other texts."""
    names: list[str] = []
    for n, line in enumerate(head.decode("utf-8", "replace").splitlines()[:_LINES_LOOKED_AT], 1):
        fields = max((header_fields(line, separator) for separator in SEPARATORS), key=len)
        numbers = [i for i, text in enumerate(fields) if _BEGINS_AS_NUMBER.match(text) and not is_date(text)]
        unusual = next((i for i in numbers if to_number(fields[i].replace(",", ".")) is None), None)
        if unusual is not None and len(numbers) >= 3 and 2 * len(numbers) > len(fields):
            name = names[unusual] if len(names) == len(fields) else f"{unusual + 1}"
            return (
                f"line {n}, column {name[:60]}: {fields[unusual][:60]!r} is not a number; write numbers with the "
                "digits 0 to 9, a decimal point, and e before an exponent, as in -1.5e-3"
            )
        names = fields
    return ""


def _check_one_device(sheet: Sheet) -> None:
    """Raise RecordingError if a column such as device or phone has several values, unless they name sensors."""
    for i, name in enumerate(sheet.fields):
        if letters(name) not in _DEVICES:
            continue
        values = dict.fromkeys(text for part in by_text(sheet, i) if (text := part.name.strip()) not in ("", *UNKNOWN))
        if len(values) > 1 and not any(quantity_of_file(value)[0] for value in values):
            raise RecordingError(
                f"{sheet.where}: column {name!r} has {len(values)} values ({', '.join(values)[:100]}), so the rows are "
                "of several devices, and a recording is of one; write the rows of each into a file of its own"
            )


def _of_phone(sheets: Sequence[Sheet], groups: Sequence[Group]) -> list[Group]:
    """Return the columns of steps and headings that the phone computed itself.

    Their table has times, or one of the sensors in `groups`, and it is the only one of its name.
    """
    names = [sheet.name for sheet in sheets]
    of_sensors = {group.sheet for group in groups}
    found = (group for i, sheet in enumerate(sheets) for group in phone_groups_of(sheet, i))
    return [g for g in found if names.count(names[g.sheet]) == 1 and (g.time is not None or g.sheet in of_sensors)]


def _folder_of_recording(members: Members) -> Path | None:
    """Return the folder of a file of one sensor that was given alone if the accelerometer is in it, or None.

    The names of the file, or of its folder, and of that of the accelerometer are equal but for the sensor.
    """
    if members.is_container or members.inside:
        return None
    path = members.path
    is_sensor = quantity_of_file(path.parent.name)[0] and not trial_of(path.parent.name)
    up = path.parent.parent if is_sensor else path.parent
    sensor, _ = quantity_of_file(path.parent.name if is_sensor else path.name)
    trials = {trial_of(path.name)} | ({""} if is_sensor else set())  # one file alone in its folder has no trial
    with suppress(RecordingError, OSError):
        beside = Members(up)
        others = [name for name in beside.names if trial_of(name) in trials and _is_text(name, beside)]
        for name in others[: limits.MAX_FILES_LOOKED_AT] if sensor else ():
            sensors = sensors_of(beside, name)
            if ACCELERATION in sensors and sensor not in sensors:
                return up
    return None


def _by_sensor(sheet: Sheet) -> Sequence[Sheet]:
    """Split a table by the column that names the sensor of each row, if there is one that names an acceleration."""
    column = next((i for i, text in sheet.texts.items() if quantity_of_file(text)[0] in VECTORS), None)
    if column is None:
        column = next((i for i, name in enumerate(sheet.fields) if "".join(words_of(name)) in _TYPES), None)
    parts = [] if column is None else by_text(sheet, column)
    if all(part.name.strip() in SENSOR_CODES for part in parts):
        parts = [replace(part, name=SENSOR_CODES[part.name.strip()]) for part in parts]
    is_split = any(quantity_of_file(part.name)[0] in (ACCELERATION, LINEAR) for part in parts)
    return parts if is_split else [sheet]


def _is_text(name: str, members: Members) -> bool:
    pure = PurePosixPath(name)
    return not members.is_container or (pure.suffix.lower() in (*TEXTS, *SUFFIXES) and pure.parent.name != "meta")


def _nothing(sheets: Sequence[Sheet], path: Path) -> str:
    """Return the error message for tables without a known sensor, which asks for a mapping or for column names."""
    sheet = sheets[0]
    if all(name.startswith("column ") for name in sheet.fields):
        head = next(sheet.parse.blocks(), b"")[:4096] if isinstance(sheet.parse, TextRows) else b""
        numbers = "its first line has numbers; write a line with the names of the columns above it, or a mapping"
        if sheet.rate_hz:
            numbers = (
                f"its rows follow the time of the start and the rate of {sheet.rate_hz:g} Hz; a mapping gives a unit"
            )
        return _named_values(head) or f"{numbers}. {asked_mapping(sheets, (), str(path))}"
    seen = ", ".join(dict.fromkeys(name for sheet in sheets for name in sheet.fields[:30]))[:300]
    return f"no column that is known to be of a sensor. Columns seen: {seen}. {asked_mapping(sheets, (), str(path))}"


def sensors_of(members: Members, name: str) -> set[str]:
    """Return the set of sensors that the columns of a text or JSON file name, empty without a table.

    It is the acceleration alone if the columns of the accelerometer have an unknown unit or lack an axis.
    """
    sheets: Sequence[Sheet]
    try:
        if is_json(members.head(name)):
            sheets = json_fields(members, name)
        else:
            sheet = text_sheet(members, name)
            named = [] if sheet is None else [t for t in sheet.texts.values() if quantity_of_file(t)[0] in VECTORS]
            sheets = [] if sheet is None else [replace(sheet, name=named[0]) if named else sheet]
    except RecordingError:
        return set()
    try:
        return {group.quantity for sheet in sheets for group in groups_of(sheet, 0)}
    except RecordingError:  # columns of an accelerometer in an unknown unit or without an axis: reading says so
        return {ACCELERATION}
