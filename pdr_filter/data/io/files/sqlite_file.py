"""Tables of an untrusted SQLite database: read only, from memory, without its functions and triggers."""

from __future__ import annotations

import sqlite3
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any

from pdr_filter.data.io.files.archive import Members
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError

SQLITE = b"SQLite format 3\x00"
# Steps of its machine: reading a row takes some tens; a query without an end is broken off.
_STEPS_A_CALL, _MOST_STEPS = 10_000, 100 * limits.MAX_ARRAY_ROWS
_ALLOWED = (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_PRAGMA)


class Database:
    """The tables of an open database."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self.where = where
        self._connection = connection
        kinds = "SELECT name, sql FROM sqlite_master WHERE type = 'table'"
        names = [str(name) for name, sql in connection.execute(kinds) if sql and "VIRTUAL" not in str(sql).upper()]
        self.columns = {name: self._columns(name) for name in names[: limits.MAX_TABLES]}

    def rows(self, table: str, columns: Sequence[str], where: tuple[str, int] | None = None) -> list[tuple[Any, ...]]:
        """Return columns of a table, for all rows or for those where a column has a given number."""
        asked = f"SELECT {', '.join(map(_quoted, columns))} FROM {_quoted(table)}"
        if where is not None:
            asked += f" WHERE {_quoted(where[0])} = {where[1]:d}"
        rows = self._connection.execute(f"{asked} LIMIT {limits.MAX_ARRAY_ROWS + 1}").fetchall()
        if len(rows) > limits.MAX_ARRAY_ROWS:
            raise RecordingError(f"{self.where}: {table} has more than {limits.MAX_ARRAY_ROWS} rows; cut the recording")
        return rows

    def _columns(self, table: str) -> tuple[str, ...]:
        return tuple(str(row[1]) for row in self._connection.execute(f"PRAGMA table_info({_quoted(table)})"))


@contextmanager
def open_database(members: Members, name: str) -> Generator[Database]:
    """Context manager that opens a SQLite database in memory. RecordingError if it is damaged or another file."""
    where = members.where(name)
    content = members.whole(name, limits.MAX_UNPACKED_BYTES)
    if not content.startswith(SQLITE):
        raise RecordingError(f"{where}: neither a SQLite database nor MCAP; give a ROS 2 bag")
    connection = sqlite3.connect(":memory:")
    calls = 0

    def broken_off() -> bool:
        nonlocal calls
        calls += 1
        return calls * _STEPS_A_CALL > _MOST_STEPS

    try:
        connection.deserialize(content)
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits.MAX_LINE_BYTES)
        connection.set_progress_handler(broken_off, _STEPS_A_CALL)
        connection.set_authorizer(_authorised)
        yield Database(connection, where)
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        raise RecordingError(
            f"{where}: this database is damaged or not one of samples ({error}); export it again"
        ) from error
    finally:
        connection.close()


def _authorised(kind: int, *_: object) -> int:
    return sqlite3.SQLITE_OK if kind in _ALLOWED else sqlite3.SQLITE_DENY


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
