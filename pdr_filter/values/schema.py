"""Checks of values against the declared types of dataclass fields, for values from files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from math import isfinite
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

# Largest float, whose square must be finite; largest integer, as times in nanoseconds since 1970 need a full int64; and
# largest integer in place of a float, which must be exact as a float.
_LARGEST, _LARGEST_WHOLE, _LARGEST_EXACT = 1e30, 2**63 - 1, 2**53


def check_declared(cls: type[Any], content: Mapping[str, Any]) -> None:
    """Raise ValueError for the first name that is not a field, or whose value is not of the declared type of its field.

    Numbers, also in arrays, must not be extremely large, and counts (n_...) not negative.
    """
    declared = _declared(cls)
    for name, value in content.items():
        if name not in declared:
            raise ValueError(f"{cls.__name__} has no field {name}: the file was changed or is of another version")
        if not _is_a(value, declared[name]):
            kind = str(declared[name]).replace("typing.", "")
            raise ValueError(f"{name} of {cls.__name__} must be {kind}, got {str(value)[:60]}")
        if name.startswith("n_") and type(value) is int and value < 0:
            raise ValueError(f"{name} of {cls.__name__} must be a non-negative count, got {value}")


def check_whole(value: Any) -> None:
    """Raise ValueError if a field of a dataclass or of a dataclass inside it does not have its declared type."""
    content = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    check_declared(type(value), content)
    for part in content.values():
        if is_dataclass(part):
            check_whole(part)


@cache
def _declared(cls: type[Any]) -> Mapping[str, Any]:
    """Return the declared type of each field that the constructor takes."""
    hints = get_type_hints(cls)
    return {f.name: hints[f.name] for f in fields(cls) if f.init}


def _is_a(value: Any, declared: Any) -> bool:
    """Return True if a value is of a declared type, such as `tuple[float, ...]` or `FloatArray | None`."""
    if declared is Any or isinstance(declared, TypeVar):
        return True
    kind, parts = get_origin(declared) or declared, get_args(declared)
    if kind in (Union, UnionType):
        return any(_is_a(value, part) for part in parts)
    if kind is Literal:
        return isinstance(value, str) and value in parts
    if kind in (bool, str, int, float, NoneType):
        return _is_plain(value, kind)
    if kind is np.ndarray:
        _, dtype = parts  # shape and dtype[...]
        return isinstance(value, np.ndarray) and _is_array(cast(Any, value), get_args(dtype)[0])
    if kind in (tuple, list) or (isinstance(kind, type) and issubclass(kind, Mapping)):
        return _is_collection(value, kind, parts)
    if getattr(kind, "_is_protocol", False):
        return _is_part(value, kind)
    return isinstance(value, kind)


def _is_plain(value: Any, kind: type) -> bool:
    """Return True if a value is of exactly this type, and not extremely large.

    A float may be NaN, infinite, or an integer that a float holds exactly.
    """
    if kind is int:
        return type(value) is int and abs(value) <= _LARGEST_WHOLE
    if kind is float:
        is_whole = type(value) is int and abs(value) <= _LARGEST_EXACT
        return is_whole or (type(value) is float and (not isfinite(value) or abs(value) <= _LARGEST))
    return type(value) is kind


def _is_collection(value: Any, kind: type, parts: tuple[Any, ...]) -> bool:
    """Return True if a value is a tuple, list or dictionary with items of the declared types `parts`."""
    if kind is list:
        return isinstance(value, list) and all(_is_a(item, parts[0]) for item in cast(list[Any], value))
    if kind is not tuple:
        key, content = parts
        items = cast(Mapping[Any, Any], value).items() if isinstance(value, dict) else ()
        return isinstance(value, dict) and all(_is_a(k, key) and _is_a(v, content) for k, v in items)
    if not isinstance(value, tuple):
        return False
    values = cast(tuple[Any, ...], value)
    if parts[-1] is Ellipsis:
        return all(_is_a(item, parts[0]) for item in values)
    return len(values) == len(parts) and all(map(_is_a, values, parts))


def _is_part(value: Any, protocol: type) -> bool:
    """Return True if a value has all members of a protocol, whichever package its class is from."""
    if type(value).__module__.split(".")[0] not in ("builtins", "numpy", "pdr_filter"):
        return not missing_members(value, protocol)
    return is_dataclass(value) and all(
        hasattr(type(value), name) or name in type(value).__dataclass_fields__ for name in _members(protocol)
    )


def check_members(name: str, part: object, protocol: type) -> None:
    """Raise ValueError with the name of the argument and the members of a protocol that a part does not have."""
    missing = missing_members(part, protocol)
    if missing or isinstance(part, type):
        lacks = "a class, not one of its instances" if isinstance(part, type) else f"without {', '.join(missing)}"
        raise ValueError(
            f"{name} must be a {protocol.__name__} of pdr_filter.protocols, got {type(part).__name__} {lacks}: check "
            "the part with pdr_filter.testing"
        )


def missing_members(part: object, protocol: type) -> list[str]:
    """Return the names of the members of a protocol that a part does not have."""
    return sorted(member for member in _members(protocol) if not hasattr(part, member))


def _is_array(value: np.ndarray[Any, Any], of: Any) -> bool:
    """Return True if an array has the data type `of` and no extremely large number."""
    if of is not Any and value.dtype != np.dtype(of):
        return False
    return value.dtype.kind != "f" or not (np.isfinite(value) & (np.abs(value) > _LARGEST)).any()


@cache
def _members(protocol: type) -> frozenset[str]:
    """Return the public methods, properties and attributes of a protocol."""
    return frozenset(name for name in (*dir(protocol), *protocol.__annotations__) if not name.startswith("_"))
