"""Sensor Logger's JSON: one array of flat objects, each with the name of its sensor; numbers are texts in it.

Read in pieces; objects of a sensor that all have the same keys around numbers, as most do, are read as a table.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pdr_filter.io.files.archive import Members
from pdr_filter.io.files.errors import RecordingError
from pdr_filter.io.tables.text_table import (
    Layout,
    NumberTable,
    finite,
    parse_lines,
    refuse_far_times,
    to_number,
    whole_number,
)
from pdr_filter.values import limits

DIGITS = re.compile(r"[0-9]{1,18}[0-9]?(,[0-9]{1,18}[0-9]?)*")
BETWEEN_OBJECTS = re.compile(rb"\}\s{0,20},\s{0,20}\{")
SENSOR_FIRST = '{"sensor":"'
PLAIN_WORD = re.compile(r"\w{1,100}")
NUMBER = "[-+.0-9eE]++"  # possessive quantifier: the search never backtracks


@dataclass(frozen=True, slots=True)
class Objects:
    """Objects of one sensor, parsed, or as text if all have the same keys."""

    parsed: list[dict[str, Any]]
    keys: tuple[str, ...] = ()  # keys of every object in `texts`, in order
    texts: tuple[str, ...] = ()  # "key":"number" pairs without spaces, the sensor's name first; without braces

    def items(self, most: int | None = None) -> list[dict[str, Any]]:
        """The first objects, as parsed."""
        return json.loads(f"[{{{'},{'.join(self.texts[:most])}}}]") if self.texts else self.parsed[:most]

    def table(self, columns: tuple[str, ...], where: str, notes: list[str]) -> NumberTable:
        """The key `time` as whole numbers, and these as floats; rows without a time are left out."""
        keys = self.keys or tuple(self.parsed[0])
        missing = [key for key in ("time", *columns) if key not in keys]
        if missing:
            raise RecordingError(
                f"{where}: no key {missing[0]!r} (found: {', '.join(map(str, keys))[:120]}); export again"
            )
        if self.texts:
            # Between quotation marks the fields are: nothing, key, colon, value, comma, key, colon, value, ...
            layout = Layout(tuple(3 + 4 * keys.index(c) for c in columns), 3 + 4 * keys.index("time"), separator='"')
            with contextlib.suppress(ValueError):
                return _checked(parse_lines(self.texts, layout), where, notes)
        return _checked(self._table_of_parsed(columns, where), where, notes)

    def _table_of_parsed(self, columns: tuple[str, ...], where: str) -> NumberTable:
        rows = self.items()
        try:
            times = [str(row["time"]) for row in rows]
            if DIGITS.fullmatch(",".join(times)):
                time_ns = np.array(list(map(int, times)), dtype=np.int64)
            else:
                known = [whole_number(time) for time in times]
                rows = [row for row, time in zip(rows, known, strict=True) if time is not None]
                time_ns = np.array([time for time in known if time is not None], dtype=np.int64)
            values = np.empty((len(rows), len(columns)))
            for i, key in enumerate(columns):
                values[:, i] = floats([row.get(key) for row in rows])
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise RecordingError(f"{where}: not a number ({str(error)[:60]}); export it again") from error
        return NumberTable(time_ns, values)


def objects_by_sensor(members: Members, name: str) -> Iterator[dict[str, Objects]]:
    """The objects of the array, some thousand at once: the file is cut where one object ends and the next begins."""
    where = members.where(name)
    rest = b""
    begun = False
    for part in members.pieces(name):
        text = rest + part
        if not begun:
            text, begun = text.lstrip(), True
            if not text.startswith(b"["):
                raise RecordingError(f"{where}: not an array of objects; export JSON from Sensor Logger again")
            text = text[1:]
        tail = max(0, len(text) - limits.TAIL_BYTES)
        cuts = list(BETWEEN_OBJECTS.finditer(text, tail))[-limits.CUTS_TRIED :]
        for cut in reversed(cuts):  # a cut inside a text ends no object: try the cut before
            objects = _objects(text[: cut.start() + 1])
            if objects is not None:
                yield objects
                text = text[cut.end() - 1 :]
                break
        rest = text
        if len(rest) > 2 * limits.BLOCK_BYTES:
            raise RecordingError(f"{where}: the JSON is damaged; export it again")
    rest = rest.rstrip()
    objects = _objects(rest[:-1]) if rest.endswith(b"]") else None
    if objects is None:
        raise RecordingError(f"{where}: the JSON is damaged or cut off; export it again")
    yield objects


def _checked(table: NumberTable, where: str, notes: list[str]) -> NumberTable:
    refuse_far_times(table.whole, where)
    return NumberTable(table.whole, finite(table.values, where, notes))


def floats(column: list[Any]) -> list[float]:
    """Numbers, or texts of numbers; NaN where there is none. ValueError for anything else."""
    kinds = set(map(type, column))
    if kinds <= {int, float} or (kinds == {str} and "_" not in "".join(column)):  # Python would read 1_0 as ten
        with contextlib.suppress(ValueError):
            return list(map(float, column))
    return list(map(_float, column))


def _float(value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) in (int, float):
        return float(value)
    number = to_number(value) if isinstance(value, str) else None
    if number is None:
        raise ValueError(repr(value))
    return number


def _objects(content: bytes) -> dict[str, Objects] | None:
    """Return the objects in the text of an array by sensor, or None for text that is not JSON."""
    groups = _alike(content)  # takes half as long as parsing every object
    if groups is not None:
        return groups
    objects = _loads(content)
    return None if objects is None else _grouped(objects)


def _alike(content: bytes) -> dict[str, Objects] | None:
    """Return these objects for the app's layout, without spaces and with the sensor name first; else None."""
    try:
        text = content.decode()
    except UnicodeDecodeError:
        return None
    if not (text.startswith(SENSOR_FIRST) and text.endswith("}")):
        return None
    by_sensor: dict[str, list[str]] = {}
    begin = len(SENSOR_FIRST) - 1
    for inside in text[1:-1].split("},{"):
        # A cut inside a text leaves parts that begin unlike an object or are not JSON.
        if not inside.startswith(SENSOR_FIRST[1:]):
            return None
        by_sensor.setdefault(inside[begin : inside.find('"', begin)], []).append(inside)
    groups: dict[str, Objects] = {}
    for sensor, texts in by_sensor.items():
        keys = _common_keys(texts)
        parsed = None if keys else _loads(f"{{{'},{'.join(texts)}}}".encode())
        if parsed is not None:
            groups |= _grouped(parsed)
        elif keys:
            groups[sensor] = Objects([], keys, tuple(texts))
        else:
            return None
    return groups


def _common_keys(texts: list[str]) -> tuple[str, ...]:
    """Keys of all objects if they are the same, in the same order, around numbers; none if they are not."""
    parts = texts[0].split('"')
    sensor, keys = parts[3], tuple(parts[1::4])
    if not all(PLAIN_WORD.fullmatch(word) for word in (sensor, *keys)) or len(set(keys)) < len(keys) or len(keys) < 2:
        return ()
    pairs = ",".join(f'"{key}":"{NUMBER}"' for key in keys[1:])
    one = f'"sensor":"{sensor}",{pairs}\n'
    return keys if re.fullmatch(f"(?:{one})*+", "\n".join([*texts, ""])) else ()


def _grouped(objects: list[dict[str, Any]]) -> dict[str, Objects]:
    by_sensor: dict[str, Objects] = {}
    for item in objects:
        sensor: Any = item.get("sensor")
        if isinstance(sensor, str):
            by_sensor.setdefault(sensor, Objects([])).parsed.append(item)
    return by_sensor


def _loads(inside: bytes) -> list[dict[str, Any]] | None:
    """Return the objects in the text of an array, or None for text that is not JSON."""
    try:
        value: Any = json.loads(b"[" + inside + b"]")
    except (ValueError, RecursionError):
        return None
    return [cast("dict[str, Any]", item) for item in cast("list[Any]", value) if isinstance(item, dict)]
