"""Sensor Logger's database, with a table for each sensor, and the messages that it pushes while it records.

A message is `{"messageId", "sessionId", "deviceId", "payload": [{"name", "time", "values": {...}}]}`, with names in
lower case and whole nanoseconds since 1970 (github.com/tszheichoi/awesome-sensor-logger, PUSHING.md). Messages may
arrive in any order; a file of them is an array, one message, or one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.files.sqlite_file import open_database
from pdr_filter.data.io.tables.json_tables import objects_in, table_of_rows
from pdr_filter.data.io.text_table import NumberTable
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError

Columns = Mapping[str, tuple[str, ...]]  # columns of each sensor, named as in the CSV files
Message = dict[str, Any]


def is_push(head: bytes) -> bool:
    """Return True if a file begins like messages that Sensor Logger pushed, judged by its first bytes."""
    return head.lstrip()[:1] in (b"[", b"{") and b'"payload"' in head and b'"sessionId"' in head


def messages_of(members: Members, name: str) -> dict[str, list[Message]]:
    """Return the messages of each session, in the order in which the app sent them."""
    content = members.whole(name, limits.MAX_WHOLE_BYTES)
    sessions: dict[str, list[Message]] = {}
    for message in objects_in([content], members.where(name)):
        if not isinstance(message.get("payload"), list):
            continue
        session = "".join(c for c in str(message.get("sessionId")) if c.isalnum() or c in "-_")[: limits.MAX_NAME_CHARS]
        sessions.setdefault(session, []).append(message)
    return {session: sorted(messages, key=_number_of) for session, messages in sessions.items()}


def push_tables(members: Members, name: str, columns: Columns) -> dict[str, NumberTable]:
    """Return a table for each sensor of the session of pushed messages that the path names, or the only one.

    RecordingError if the file has several sessions and the path names none of them.
    """
    where = members.where(name)
    sessions = messages_of(members, name)
    wanted = members.inside or next(iter(sessions), "")
    if not sessions:
        raise RecordingError(
            f"{where}: no message has a list as payload; save the messages as Sensor Logger pushes them"
        )
    if wanted not in sessions or (not members.inside and len(sessions) > 1):
        first = next(iter(sessions))
        remedy = f"unpack it and read one of them, as {name}/{first}"
        if not members.is_container:
            remedy = f"read one of them, as {members.path.parent if members.inside else members.path}/{first}"
        raise RecordingError(f"{where}: holds {len(sessions)} sessions ({', '.join(list(sessions)[:3])}); {remedy}")
    known = {sensor.lower(): sensor for sensor in columns}
    rows: dict[str, list[Message]] = {}
    for item in (item for message in sessions[wanted] for item in message["payload"] if isinstance(item, dict)):
        sensor = known.get(str(item.get("name")).lower())
        values: Any = item.get("values", item)
        if sensor is None or not isinstance(values, dict):
            continue
        of_columns = {key: cast("Message", values).get(key) for key in columns[sensor]}
        rows.setdefault(sensor, []).append({**of_columns, "time": item.get("time")})
    tables: dict[str, NumberTable] = {}
    for sensor, found in rows.items():
        table = table_of_rows(found, columns[sensor], f"{where}, {sensor}", [])
        order = np.argsort(table.whole, kind="stable")
        tables[sensor] = NumberTable(table.whole[order], table.values[order])
    return tables


def database_tables(
    members: Members, name: str, columns: Columns, notes: list[str]
) -> tuple[dict[str, NumberTable], dict[str, str]]:
    """Return a table for each sensor in a database of Sensor Logger, and the metadata by name."""
    where = members.where(name)
    sensors: dict[str, NumberTable] = {}
    metadata: dict[str, str] = {}
    known = {sensor.lower(): sensor for sensor in columns}
    with open_database(members, name) as database:
        for table, found in database.columns.items():
            sensor = known.get(table.lower())
            if sensor is not None and {"time", *columns[sensor]} <= set(found):
                names = ("time", *columns[sensor])
                rows = [dict(zip(names, row, strict=True)) for row in database.rows(table, names)]
                sensors[sensor] = table_of_rows(rows, columns[sensor], f"{where}, {sensor}", notes)
                if n_timeless := len(rows) - len(sensors[sensor]):
                    notes.append(f"{table}: {n_timeless} rows without a time left out")
            elif table.lower() == "metadata" and found:
                for row in database.rows(table, found)[:1]:
                    metadata = {key: str(value)[: limits.MAX_TEXT_CHARS] for key, value in zip(found, row, strict=True)}
        if not sensors:
            raise RecordingError(
                f"{where}: no table has the name and the columns of a sensor of Sensor Logger (found: "
                f"{', '.join(database.columns)[:160] or 'nothing'}); export the recording again, as CSV if this is "
                "another app's"
            )
    return sensors, metadata


def _number_of(message: Message) -> float:
    number: Any = message.get("messageId")
    return float(number) if isinstance(number, int | float) and abs(number) < limits.MAX_INT64 else 0.0
