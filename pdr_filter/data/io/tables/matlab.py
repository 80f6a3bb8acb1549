"""MATLAB files of version 5: tables of time (timetable), as MATLAB Mobile saves them, and plain columns.

Layout after "MAT-File Format" (The MathWorks). Objects such as a timetable are in a part of the file that is not
described there: a list of values, and tables that say which object has which of them as a property. The bytes are read
here because libraries are less strict (docs/contributing.md): SciPy, on which pymatreader is built, ends the process at
deeply nested cells and does not decode timetables, and SciPy and mat-io unpack whatever a variable claims.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.files.archive import Members, most_unpacked
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.text_sheets import unlike
from pdr_filter.values import FloatArray, IntArray, limits
from pdr_filter.values.errors import RecordingError

_HEAD = b"MATLAB 5.0 MAT-file"
_HEAD_OF_7_3 = b"MATLAB 7.3 MAT-file"
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED = 14, 15
_UTF = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_CELL, _STRUCT, _CHAR, _OPAQUE = 1, 2, 4, 17
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800
_OBJECT = 0xDD000000
_MAX_DEPTH, _MAX_ELEMENTS = 20, 200_000


def is_matlab(head: bytes) -> bool:
    """Return True if a file begins like a MATLAB file, judged by its first bytes."""
    return head.startswith((_HEAD, _HEAD_OF_7_3))


def matlab_sheets(members: Members, name: str) -> list[Sheet]:
    """Return the tables in a MATLAB file. RecordingError if it is damaged, has version 7.3, or holds no table."""
    where = members.where(name)
    content = members.whole(name, limits.MAX_UNPACKED_BYTES)
    if content.startswith(_HEAD_OF_7_3):
        raise RecordingError(f"{where}: a MATLAB file of version 7.3; save it with save(..., '-v7'), or export CSV")
    try:
        return _File(content).sheets(where)
    except (struct.error, zlib.error, ValueError, KeyError, IndexError, TypeError, UnicodeDecodeError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(
            f"{where}: this MATLAB file is damaged, or it has data of a kind that is not read ({str(error)[:100]}); "
            "save it again, or export CSV"
        ) from error


@dataclass(frozen=True, slots=True)
class _Opaque:
    """Variable of a MATLAB file that is an object of the class `kind`; `value` are the integers that refer to it."""

    name: str
    kind: str
    value: Any

    @property
    def number(self) -> int:
        return _object_number(self.value)


class _File:
    """Variables of a MATLAB file, and the properties of its objects."""

    def __init__(self, content: bytes) -> None:
        if len(content) < 128:
            raise ValueError("too short")
        self._order = "<" if content[126:128] == b"IM" else ">"
        self._unpacked_left = most_unpacked(len(content))
        self._elements_left = _MAX_ELEMENTS
        (self._objects_at,) = struct.unpack_from(self._order + "q", content, 116)
        self.variables: dict[str, Any] = {}
        self._cells: list[Any] = []
        for at, kind, data in self._elements(content, 128):
            found = self._matrix(data, 0) if kind == _MATRIX else None
            if found is None:
                continue
            if at == self._objects_at:
                self._cells = self._cells_of(found[1])
            elif isinstance(found[1], _Opaque):
                self.variables[found[1].name] = found[1]
            else:
                self.variables[found[0]] = found[1]

    def sheets(self, where: str) -> list[Sheet]:
        """Return a table for each timetable, and one for each length of other columns, where three are x, y and z."""
        found: list[Sheet] = []
        plain: dict[int, dict[str, FloatArray]] = {}
        for name, value in list(self.variables.items())[: limits.MAX_TABLES]:
            if isinstance(value, _Opaque) and value.kind == "timetable":
                found.append(self._timetable(name, value, f"{where}: {name}"))
            elif isinstance(value, np.ndarray) and value.ndim == 2:
                array = np.asarray(value, dtype=float)
                array = array.T if len(array) == 1 else array
                n, d = array.shape
                names = [name] if d == 1 else [f"{name}_{axis}" for axis in "xyz"] if d == 3 else []
                plain.setdefault(n, {}).update(zip(names, array.T, strict=False))
        for n, columns in plain.items():
            if n >= limits.MIN_SAMPLES and columns:
                found.append(Sheet.of_columns("variables", where, columns))
        if not found:
            raise RecordingError(
                f"{where}: no table in this MATLAB file (variables: {', '.join(self.variables)[:160] or 'none'}); "
                "save the timetables of MATLAB Mobile, or columns of numbers"
            )
        return found

    def _timetable(self, name: str, value: _Opaque, where: str) -> Sheet:
        properties = self._properties(value.number)
        content = cast("dict[str, Any]", properties.get("any", properties))
        names, columns = content["varNames"], content["data"]
        times: Any = content["rowTimes"]
        if not _is_object(times):
            raise RecordingError(
                f"{where}: the timetable has a rate instead of times; save it with a time for each row, or export CSV"
            )
        times = self._properties(_object_number(times))["data"]
        # Milliseconds since 1970; what a float cannot hold of them is in the imaginary part.
        ms = np.real(times).ravel()
        ns: IntArray = np.rint(np.where(np.abs(ms) < 1e15, ms, 0.0) * 1e3).astype(np.int64) * 1000
        arrays = [np.asarray(column, dtype=float).ravel() for column in columns]
        if any(len(array) != len(ns) for array in arrays) or len(names) != len(arrays):
            raise ValueError("the columns of a timetable have other lengths than its times")
        columns = dict(zip(unlike(["Timestamp", *map(str, names)]), (ns, *arrays), strict=True))
        return replace(Sheet.of_columns(name, where, columns, dates={0}), about="MATLAB Mobile")

    # ------------------------------------------------------------------------------------------- objects

    def _cells_of(self, value: Any) -> list[Any]:
        """Return the list of values that the objects of a MATLAB file refer to by number."""
        inner = np.asarray(value, dtype=np.uint8).tobytes()
        for _, kind, data in self._elements(inner, 8):
            found = self._matrix(data, 0) if kind == _MATRIX else None
            if found is not None and isinstance(found[1], dict):
                wrapper: Any = cast("dict[str, Any]", found[1]).get("MCOS")
                if isinstance(wrapper, _Opaque) and isinstance(wrapper.value, list):
                    return cast("list[Any]", wrapper.value)
        return []

    def _properties(self, number: int) -> dict[str, Any]:
        """Return the properties of the object with this number, by name. None for one that has no stored value."""
        meta = np.asarray(self._cells[0], dtype=np.uint8).tobytes()
        words = np.frombuffer(meta[: len(meta) // 4 * 4], dtype=self._order + "u4").astype(int)
        names = meta[40 : words[2]].split(b"\x00")
        objects = words[words[4] // 4 : words[5] // 4].reshape(-1, 6)
        _, _, _, first, second, _ = objects[number]
        at, segment = (words[3] // 4, first) if first else (words[5] // 4, second)
        at += 2
        for _ in range(1, segment):
            at += (1 + 3 * words[at] + 1) // 2 * 2
        found: dict[str, Any] = {}
        for name, kind, place in words[at + 1 : at + 1 + 3 * words[at]].reshape(-1, 3):
            found[names[name - 1].decode()] = self._cells[place + 2] if kind == 1 else None
        return found

    # ------------------------------------------------------------------------------------------- elements

    def _elements(self, content: bytes, at: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield the start index, kind and bytes of consecutive data elements from the index `at` on.

        Those in a compressed element come in its place, with its start index.
        """
        while at + 8 <= len(content):
            self._elements_left -= 1
            if self._elements_left < 0:
                raise ValueError("it has more data elements than a file of tables")
            begin = at
            kind, n = struct.unpack_from(self._order + "II", content, at)
            if kind >> 16:  # a small one, whose length stands beside its kind
                kind, n, data_at, at = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            else:
                data_at, at = at + 8, at + 8 + (n if kind == _COMPRESSED else (n + 7) // 8 * 8)
            data = content[data_at : data_at + n]
            if len(data) < n:
                raise ValueError("its last data element is cut off")
            if kind != _COMPRESSED:
                yield begin, kind, data
                continue
            unpacked = zlib.decompressobj().decompress(data, self._unpacked_left + 1)
            self._unpacked_left -= len(unpacked)
            if self._unpacked_left < 0:
                raise ValueError("it unpacks to more than sensor data can")
            for _, inner_kind, inner in self._elements(unpacked, 0):
                yield begin, inner_kind, inner

    def _matrix(self, content: bytes, depth: int) -> tuple[str, Any] | None:
        """Return name and value of a matrix element, or None for a kind that no table needs.

        The value is an array, a text, a list of cells, the dict of a structure, or an `_Opaque` object.
        """
        if depth > _MAX_DEPTH:
            raise ValueError("too deep")
        parts = [(kind, data) for _, kind, data in self._elements(content, 0)]
        if not parts:
            return "", np.empty((0, 0))
        flags = int(self._array(*parts[0])[0])
        kind = flags & 0xFF
        if kind == _OPAQUE:
            name, _, of = (data.decode("latin-1") for _, data in parts[1:4])
            value = self._matrix(parts[4][1], depth + 1)
            return name, _Opaque(name, of, value[1] if value else None)
        shape, name = self._array(*parts[1]).astype(int), parts[2][1].decode("latin-1")
        values = parts[3:]
        if kind in _NUMERIC:
            array = self._array(*values[0]).astype(np.float64) if kind <= 7 else self._array(*values[0])
            if flags & _COMPLEX and len(values) > 1:
                array = array + 1j * self._array(*values[1])
            return name, array.reshape(shape, order="F")
        if kind == _CHAR:
            of, data = values[0]
            text = data.decode(_UTF[of], "replace") if of in _UTF else "".join(map(chr, self._array(of, data)))
            return name, text
        if kind == _CELL:
            return name, [self._value(data, depth) for of, data in values if of == _MATRIX]
        if kind == _STRUCT:
            length, raw = int(self._array(*values[0])[0]), values[1][1]
            if length < 1:
                raise ValueError("names without letters")
            names = [raw[i : i + length].split(b"\x00")[0].decode("latin-1") for i in range(0, len(raw), length)]
            cells = [self._value(data, depth) for of, data in values[2:] if of == _MATRIX]
            return name, dict(zip(names, cells, strict=False))
        return None

    def _value(self, content: bytes, depth: int) -> Any:
        found = self._matrix(content, depth + 1)
        return None if found is None else found[1]

    def _array(self, kind: int, data: bytes) -> Any:
        of = np.dtype(self._order + _NUMBERS[kind])
        return np.frombuffer(data[: len(data) // of.itemsize * of.itemsize], of)


def _is_object(value: Any) -> bool:
    return isinstance(value, _Opaque) or (
        isinstance(value, np.ndarray) and value.size >= 6 and value.flat[0] == _OBJECT
    )


def _object_number(value: Any) -> int:
    """Return the number of a MATLAB object from the integers that refer to it: a mark, n, n sizes, and the number."""
    words = np.asarray(value.value if isinstance(value, _Opaque) else value).ravel().astype(int)
    return int(words[2 + words[1]])
