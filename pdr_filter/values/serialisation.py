"""Serialisation of configurations and states as plain values: no code in the bytes is executed.

The bytes are compressed: JSON with a version and a checksum, and the exact bytes of all arrays (`saved_bytes`). Several
stages buffer the same signals, and each signal is stored once. Dataclasses are stored by name. Only dataclasses of this
package, and of the first state that the caller gives, are loaded. Unchanged values of the package's files, such as its
trained models, are stored by name and checksum. Bytes with a forged checksum can produce a filter with wrong values of
the declared types, but cannot execute code.
"""

from __future__ import annotations

import base64
import hashlib
import importlib
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from operator import attrgetter
from typing import Any, NamedTuple, Self, cast, get_args, get_type_hints

import numpy as np

from pdr_filter.values import check_declared
from pdr_filter.values.saved_bytes import compressed, decompressed
from pdr_filter.values.saved_formats import EARLIER_FORMATS, in_present_format, n_values

_PACKAGE = "pdr_filter"
_FORMAT = 12  # `saved_formats` describes the earlier ones
_VALUE = b', "value": '  # separates the header from the text of the checksum
# A filter with own models has some MB, nearly all of it arrays, and some thousand values.
_MAX_BYTES = 64 << 20
_MAX_VALUES = 2_000_000
# Rows of arrays with at least this many numbers are signals, which other arrays may contain as well.
_MIN_SIGNAL = 32
_MAX_COMPARED = 16
# Packages with the classes of a filter. Classes of other packages are loaded only if their module is imported already.
_PACKAGES = ("values.", "classifiers.", "sensing.", "filter.", "recipes.", "tracking.", "apps.maps.")


class Shipped:
    """Base class of dataclasses with values in files of the package, which are saved by name and checksum."""

    __slots__ = ()

    def reference(self) -> tuple[str, str] | None:
        """Return name and checksum if this is an unchanged value of the package, otherwise None."""
        raise NotImplementedError

    @classmethod
    def of_reference(cls, name: str, checksum: str) -> Self:
        """Return the value of the package. ValueError if it has none of this name and checksum."""
        raise NotImplementedError


def to_bytes(value: object, first: object = None, *, whole: bool = False, constant: object = None) -> bytes:
    """Return a value of arrays, numbers, strings, None, tuples, dicts and dataclasses as bytes.

    Dataclasses are those of this package, of `first` (the first state of the part that made the value), and of the
    declared types of their fields. With `whole`, values of the package's files are stored with their content. A value
    of a dict that never changes may be given as `constant`: its text is kept for the next call. TypeError for any other
    class.
    """
    kept = None if constant is None else _kept(constant, whole)
    encoder = _Encoder(_classes_in(first), whole, kept)
    node = encoder.node(value)
    return _packed(node, *encoder.arrays(), kept)


class _Kept(NamedTuple):
    """Text of a value that never changes, and the bytes of its arrays, which come before all others."""

    value: object
    text: str
    arrays: bytes


_KEPT = '{"kept": null}'  # node in place of the value


@lru_cache(maxsize=16)
def _kept(value: object, whole: bool) -> _Kept | None:
    """Return the text and the arrays of a value, or None if it has signals, whose positions depend on all others."""
    encoder = _Encoder({}, whole)
    node = encoder.node(value)
    arrays, signals = encoder.arrays()
    return None if signals else _Kept(value, json.dumps(node, check_circular=False), arrays)


def _classes_in(first: object) -> dict[str, type[Any]]:
    """Return the dataclasses of a value, of its parts, and of the declared types of their fields, by name.

    TypeError for two of one name.
    """
    found: dict[str, type[Any]] = {}
    open_parts: list[Any] = [first]
    while open_parts:
        part = open_parts.pop()
        open_parts += get_args(part)  # of a declared type, such as `tuple[Bout, ...] | None`
        if isinstance(part, tuple | list | dict):
            items = cast(dict[Any, Any] | list[Any], part)
            open_parts += items.values() if isinstance(items, dict) else items
        elif is_dataclass(part):
            cls = part if isinstance(part, type) else type(part)
            if found.get(_name(cls), cls) is not cls:
                raise TypeError(f"two dataclasses are named {_name(cls)}: give one of them another name")
            if _name(cls) not in found:
                found[_name(cls)] = cls
                open_parts += _declared(cls)
            if cls is not part:
                open_parts += (getattr(part, f.name) for f in fields(part) if f.init)
    return found


def _name(cls: type[Any]) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _declared(cls: type[Any]) -> list[Any]:
    """Return the declared types of the fields of a dataclass, or nothing if a name in them is not defined."""
    try:
        return list(get_type_hints(cls).values())
    except (NameError, TypeError):  # classes of a function, or names imported for type checkers only
        return []


def _packed(node: Any, arrays: bytes = b"", signals: bytes = b"", kept: _Kept | None = None) -> bytes:
    value = json.dumps(node, check_circular=False)
    text = (value if kept is None else value.replace(_KEPT, kept.text, 1)).encode()
    head = f'{{"format": {_FORMAT}, "sha256": "{_checksum(text, arrays + signals)}"'.encode()
    _check_size(text, len(arrays) + len(signals))
    return compressed(b"".join([head, _VALUE, text, b"}"]), arrays, signals)


def from_bytes(blob: object, first: object = None, *, without: str = "") -> Any:
    """Return the value from the bytes of `to_bytes` with the same `first`. ValueError for any other bytes.

    Of a dict, the value with the key `without` is not loaded, and is None.
    """
    if not isinstance(blob, bytes):
        raise ValueError(f"a saved filter must be bytes, got {type(blob).__name__}: give what save returned")
    try:
        text, arrays = decompressed(blob, _MAX_BYTES)
        _check_size(text, len(arrays))
        content = json.loads(text)
        if content["format"] not in (*EARLIER_FORMATS, _FORMAT):
            raise ValueError(
                f"saved by another version of {_PACKAGE}, with format {content['format']} instead of "
                f"{EARLIER_FORMATS[0]} to {_FORMAT}"
            )
        if content["sha256"] != _checksum(text.partition(_VALUE)[2][:-1], arrays):
            raise ValueError("the checksum does not match, so that the bytes are damaged")
        if without:
            content["value"]["dict"][without] = None
        node = in_present_format(content["value"], content["format"], arrays)
        return _Decoder(_classes_in(first), arrays).value(node)
    except Exception as error:  # damaged bytes can raise any exception
        raise ValueError(
            f"these {len(blob)} bytes cannot be loaded as a saved value of this version of {_PACKAGE} ({error}): "
            "process the samples again, or load the bytes with the version that saved them"
        ) from error


def _checksum(text: bytes, arrays: bytes) -> str:
    return hashlib.sha256(text + arrays).hexdigest()


def _check_size(text: bytes, n_bytes_of_arrays: int) -> None:
    n_bytes, n_values = len(text) + n_bytes_of_arrays, len(text)  # each value has a mark
    if n_values > _MAX_VALUES:
        n_values = sum(text.count(mark) for mark in (b"{", b"[", b",", b":"))
    if n_bytes > _MAX_BYTES or n_values > _MAX_VALUES:
        raise ValueError(
            f"saved data must have at most {_MAX_BYTES} bytes and {_MAX_VALUES} values, got {n_bytes} and about "
            f"{n_values}"
        )


_PLAIN = frozenset({type(None), bool, int, float, str})


class _Fields(NamedTuple):
    """Name of a dataclass, names of its fields, and the function that reads the fields of a value."""

    of: str
    is_own: bool  # a class of this package
    names: tuple[str, ...]
    read: Callable[[Any], tuple[Any, ...]]


@lru_cache(maxsize=1024)
def _fields(cls: type[Any]) -> _Fields | None:
    """Return the fields of a dataclass, or None for any other class."""
    if not is_dataclass(cls):
        return None
    names = tuple(f.name for f in fields(cls) if f.init)
    read: Callable[[Any], tuple[Any, ...]] = lambda value: tuple(getattr(value, name) for name in names)  # noqa: E731
    if len(names) > 1:  # an attrgetter of one name returns no tuple
        read = attrgetter(*names)
    return _Fields(_name(cls), cls.__module__.partition(".")[0] == _PACKAGE, names, read)


@lru_cache(maxsize=64)
def _dtype_name(dtype: np.dtype[Any]) -> str:
    if dtype.kind not in "biuf":
        raise TypeError(f"an array of {dtype} cannot be saved: use an array of numbers")
    return dtype.str


class _Encoder:
    """Turns values into nodes of JSON, which are complete after `arrays`."""

    def __init__(self, own: Mapping[str, type[Any]], whole: bool, kept: _Kept | None = None) -> None:
        self.own, self.whole, self._kept = own, whole, kept
        self._small: list[tuple[dict[str, Any], bytes]] = []
        self._signals: list[tuple[dict[str, Any], np.ndarray[Any, Any]]] = []

    def node(self, value: Any) -> Any:
        """Return the node of a value. TypeError if it cannot be saved."""
        cls = cast(type[Any], type(value))
        if cls in _PLAIN:
            return value
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, (tuple, list)):
            items = cast(tuple[Any, ...], value)
            nodes = [v if type(v) in _PLAIN else self.node(v) for v in items]
            return {"tuple" if isinstance(value, tuple) else "list": nodes}
        if not self.whole and isinstance(value, Shipped) and (reference := value.reference()):
            return {"shipped": _name(cls), "reference": list(reference)}
        if self._kept and value is self._kept.value:
            return {"kept": None}
        of_class = _fields(cls)
        if of_class and (of_class.is_own or self.own.get(of_class.of) is cls):
            pairs = zip(of_class.names, of_class.read(value), strict=True)
            content = {name: v if type(v) in _PLAIN else self.node(v) for name, v in pairs}
            return {"dataclass": of_class.of, "fields": content}
        if isinstance(value, Mapping):
            mapping = cast(Mapping[Any, Any], value)
            if not all(isinstance(key, str) for key in mapping):
                raise TypeError("only mappings with text keys can be saved: JSON turns others into text")
            return {"dict": {key: self.node(v) for key, v in mapping.items()}}
        if isinstance(value, (int, float, str)):  # such as an IntEnum
            return value
        if of_class:
            raise TypeError(
                f"a {cls.__qualname__} cannot be saved, because the first state has none: let init() put a value of "
                "this class there, declare it as the type of a field of a dataclass, or use arrays, numbers and tuples"
            )
        raise TypeError(f"a {cls.__qualname__} cannot be saved: keep states to arrays, numbers and dataclasses")

    def _array(self, array: np.ndarray[Any, Any]) -> dict[str, Any]:
        dtype = _dtype_name(array.dtype)
        node = {"array": None, "dtype": dtype, "shape": [*array.shape]}
        if array.size >= _MIN_SIGNAL and dtype == "<f8":
            signals = _signals(array)
            if signals.shape[-1] >= _MIN_SIGNAL:
                self._signals.append((node, signals))
                return node
        self._small.append((node, array.tobytes()))
        return node

    def arrays(self) -> tuple[bytes, bytes]:
        """Return the bytes of small arrays and of signals, and set the positions of all arrays in the nodes.

        Positions count the bytes of both. A signal that equals the end of a longer one is not stored again, because the
        stages buffer signals up to the same sample.
        """
        small, stored = [self._kept.arrays if self._kept else b""], list[bytes]()
        n_bytes = len(small[0])
        for node, array in self._small:
            node["array"] = n_bytes
            small.append(array)
            n_bytes += len(array)
        ends = dict[bytes, list[tuple[bytes, int]]]()
        for node, signals in sorted(self._signals, key=lambda each: -each[1].shape[1]):
            node["array"] = starts = list[int]()
            for signal in map(np.ndarray.tobytes, signals):
                # signals that end in the same way, such as in zeros, are compared with the first few of them only
                longer = ends.setdefault(signal[-_MIN_SIGNAL * signals.itemsize :], [])
                end = next((end for other, end in longer[:_MAX_COMPARED] if other.endswith(signal)), 0)
                if not end:
                    stored.append(signal)
                    n_bytes += len(signal)
                    end = n_bytes
                    longer.append((signal, end))
                starts.append(end - len(signal))
        return b"".join(small), b"".join(stored)


def _signals(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return a view of an array whose rows are signals: time is the last axis, or the longer one of a matrix."""
    if array.ndim == 2 and array.shape[0] > array.shape[1]:
        return array.T
    return array.reshape(-1, array.shape[-1]) if array.ndim and array.size else np.empty((0, 0))


class _Decoder:
    """Turns nodes of JSON into values. `arrays` has the bytes of all arrays."""

    def __init__(self, own: Mapping[str, type[Any]], arrays: bytes) -> None:
        self.own, self.arrays = own, arrays
        self._n_left = _MAX_BYTES  # a forged file could refer to the same bytes many times

    def value(self, node: Any) -> Any:
        """Return the value of a node. ValueError if it cannot be loaded."""
        if not isinstance(node, dict):
            return node
        node = cast(dict[str, Any], node)
        if "array" in node:
            return self._array(node)
        if "tuple" in node:
            return tuple(self.value(v) for v in _of_type(node["tuple"], list, "the items of a tuple"))
        if "list" in node:
            return [self.value(v) for v in _of_type(node["list"], list, "the items of a list")]
        if "dict" in node:
            return {key: self.value(v) for key, v in node["dict"].items()}
        if "shipped" in node:
            return _shipped(node)
        name = _of_type(node["dataclass"], str, "the class of a dataclass")
        content = {field: self.value(v) for field, v in node["fields"].items()}
        if name.partition(":")[0].partition(".")[0] != _PACKAGE:
            if name not in self.own:
                raise ValueError(
                    f"refused to load {name[:60]!r}, because neither {_PACKAGE} nor the first state of the "
                    "configuration has it: give the configuration that was saved, OnlineFilter.load(blob, "
                    "config=config)"
                )
            return self.own[name](**content)
        cls = _dataclass(name)
        check_declared(cls, content)
        return cls(**content)

    def _array(self, node: Mapping[str, Any]) -> np.ndarray[Any, Any]:
        dtype = np.dtype(_of_type(node["dtype"], str, "the type of an array"))
        shape = _of_type(node["shape"], list, "the shape of an array")
        if dtype.kind not in "biuf":
            raise ValueError(f"the array has type {dtype}, but saved arrays contain only numbers or truth values")
        position, n_bytes = node["array"], n_values(shape) * dtype.itemsize
        if isinstance(position, str):  # before format 10
            return np.frombuffer(base64.b64decode(position, validate=True), dtype=dtype).reshape(shape).copy()
        self._n_left -= n_bytes
        if not 0 <= n_bytes <= n_bytes + self._n_left:
            raise ValueError(
                f"an array has the shape {str(shape)[:60]}, or all arrays have more than {_MAX_BYTES} bytes"
            )
        if not isinstance(position, list):
            return np.frombuffer(self._bytes(position, n_bytes), dtype=dtype).reshape(shape).copy()
        array = np.zeros(shape, dtype)
        signals, starts = _signals(array), cast(list[Any], position)
        if len(signals) != len(starts):
            raise ValueError(f"an array of shape {str(shape)[:60]} cannot have {len(starts)} signals")
        for i, start in enumerate(starts):
            signals[i] = np.frombuffer(self._bytes(start, signals.shape[1] * dtype.itemsize), dtype)
        return array

    def _bytes(self, start: Any, n_bytes: int) -> bytes:
        start = _of_type(start, int, "the position of an array")
        if not 0 <= start <= len(self.arrays) - n_bytes:
            raise ValueError(f"{n_bytes} bytes of an array are not in the bytes of the arrays")
        return self.arrays[start : start + n_bytes]


def _shipped(node: Mapping[str, Any]) -> Shipped:
    cls = _dataclass(_of_type(node["shipped"], str, "the class of a shipped value"))
    if not issubclass(cls, Shipped):
        raise ValueError(f"the package has no files of a {cls.__name__}")
    name, checksum = (_of_type(text, str, "name and checksum of a shipped value") for text in node["reference"])
    return cls.of_reference(name, checksum)


def _of_type(value: Any, cls: type, what: str) -> Any:
    """Return the value if its type is `cls`. ValueError, to which `from_bytes` adds the remedy, if not."""
    if type(value) is not cls:
        raise ValueError(f"{what} must be stored as a {cls.__name__}, got {str(value)[:60]}")
    return value


def _dataclass(name: str) -> type[Any]:
    module_name, _, class_name = name.partition(":")
    rest = module_name.partition(".")[2]
    if module_name not in sys.modules and not rest.startswith(_PACKAGES):
        raise ValueError(f"refused to load {name!r}, because only the classes of a filter are loaded")
    cls = getattr(importlib.import_module(module_name), class_name)
    if not (isinstance(cls, type) and is_dataclass(cls)):
        raise ValueError(f"{name!r} is not a dataclass, so it cannot be a part of a saved filter")
    return cls
