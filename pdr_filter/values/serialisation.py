"""Serialisation of configurations and states as plain values: no code in the bytes is executed.

The bytes are zlib-compressed JSON with a version and a checksum. Arrays are stored as their exact bytes, and
dataclasses by the name of a dataclass of this package. All other types are refused when saving and when loading. The
checksum detects damage, and the declared types of fields are checked as well. Bytes with a forged checksum can produce
a filter with wrong values, but cannot execute code.
"""

from __future__ import annotations

import base64
import hashlib
import importlib
import json
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any, cast, get_args, get_type_hints

import numpy as np

from pdr_filter.values import check_declared

_PACKAGE = "pdr_filter"
# Formats 2 to 6: 2 has modules of an older layout, 3 a flat state of the tracker, 4 no checksum, 5 modes by name, and 6
# other names of classes and fields.
_FORMAT = 7
_VALUE = ', "value": '  # separates the header from the text of the checksum
# A filter with its models has some MB, nearly all of it arrays, and some thousand values.
_MAX_BYTES = 64 << 20
_MAX_VALUES = 2_000_000
# Packages with the classes of a filter. Classes of other packages are loaded only if their module is imported already.
_PACKAGES = ("values", "classifiers", "sensing", "filter", "recipes", "tracking", "maps")


@dataclass(frozen=True, slots=True)
class ForeignFields:
    """Saved fields of a dataclass of another package.

    The bytes do not name its class (see `restored`).
    """

    fields: dict[str, Any]


def to_bytes(value: object, foreign: bool = False) -> bytes:
    """Return a value of arrays, numbers, strings, None, tuples, dicts and dataclasses of this package as bytes.

    With `foreign`, dataclasses of other packages are saved as well. They are loaded as `ForeignFields`. TypeError for
    any other class.
    """
    return _packed(_encode(value, foreign))


def restored(value: Any, like: Any, declared: Any = Any) -> Any:
    """Return a loaded value in which each `ForeignFields` is replaced by an object of its class.

    `like` is a value of the same structure: the first state of the part that made the saved value. The class is that of
    the object at the same position in `like`. If `like` has no dataclass with these fields there, it is the dataclass
    in the declared type of the field, such as `Bout | None` or `tuple[Bout, ...]`. `declared` is the declared type of
    `value`. Raises ValueError if neither gives exactly one class.
    """
    if isinstance(value, ForeignFields):
        cls = _class_of(value, like, declared)
        of_like, types = _parts(like) if type(like) is cls else {}, _declared(cls)
        return cls(**{n: restored(each, of_like.get(n), types.get(n, Any)) for n, each in value.fields.items()})
    of_like = _parts(like) if type(like) is type(value) else {}
    of_items = declared if isinstance(value, tuple | list | dict) else Any
    changed = {
        key: new
        for key, part in _parts(value).items()
        if (new := restored(part, of_like.get(key), of_items)) is not part
    }
    if not changed:
        return value
    if isinstance(value, tuple | list):
        return type(value)(changed.get(i, part) for i, part in enumerate(cast(list[Any], value)))
    return {**value, **changed} if isinstance(value, dict) else replace(value, **changed)


def check_classes(loaded: Any, saved: Any) -> None:
    """Raise ValueError if a loaded value has another class than the saved value at the same position."""
    if is_dataclass(saved) and type(loaded) is not type(saved):
        raise ValueError(
            f"a {type(saved).__name__} would be loaded as a {type(loaded).__name__}, which has the same fields and is "
            "in the first state: give one of them a field of another name, because saved states do not name classes"
        )
    of_saved = _parts(saved)
    for key, part in _parts(loaded).items():
        check_classes(part, of_saved.get(key))


def _class_of(value: ForeignFields, like: Any, declared: Any) -> type[Any]:
    """Return the class of saved fields: that of `like`, or else the dataclass in the declared type."""
    if is_dataclass(like) and _parts(like).keys() == value.fields.keys():
        return type(like)
    found = [cls for cls in _dataclasses_in(declared) if {f.name for f in fields(cls) if f.init} == value.fields.keys()]
    if len(found) == 1:
        return found[0]
    names = ", ".join(value.fields)
    if is_dataclass(like):
        raise ValueError(
            f"a saved state has a dataclass with other fields, {names}, than {type(like).__name__}: give the part that "
            "made it"
        )
    raise ValueError(
        f"a saved state has a dataclass with the fields {names} where the first state has a {type(like).__name__}: let "
        "init() put a value of that class there, declare its class as the type of a field of a dataclass, or use "
        "arrays, numbers and tuples"
    )


def _dataclasses_in(declared: Any) -> set[type[Any]]:
    """Return the dataclasses of a declared type, such as that of `tuple[Bout, ...] | None`."""
    own = {declared} if isinstance(declared, type) and is_dataclass(declared) else set[type[Any]]()
    return own.union(*map(_dataclasses_in, get_args(declared)))


@cache
def _declared(cls: type[Any]) -> Mapping[str, Any]:
    """Return the declared types of the fields of a dataclass by name, or nothing if a name in them is not defined."""
    try:
        return get_type_hints(cls)
    except (NameError, TypeError):  # classes of a function, or names imported for type checkers only
        return {}


def _parts(value: Any) -> dict[Any, Any]:
    """Return the items of a dictionary, tuple or list by key or index, or the fields of a dataclass by name.

    The result is empty for any other value.
    """
    if isinstance(value, dict):
        return cast(dict[Any, Any], value)
    if isinstance(value, tuple | list):
        return dict(enumerate(cast(list[Any], value)))
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in fields(value) if f.init}
    return {}


def _packed(value: Any) -> bytes:
    text = json.dumps(value)
    content = f'{{"format": {_FORMAT}, "sha256": "{_checksum(text)}"{_VALUE}{text}}}'.encode()
    _check_size(content)
    return zlib.compress(content, 1)


def from_bytes(blob: object) -> Any:
    """Return the value from the bytes of `to_bytes`. ValueError for any other bytes."""
    if not isinstance(blob, bytes):
        raise ValueError(f"a saved filter must be bytes, got {type(blob).__name__}: give what save returned")
    try:
        text = _inflate(blob)
        _check_size(text)
        content = json.loads(text)
        if content["format"] != _FORMAT:
            raise ValueError(
                f"saved by another version of {_PACKAGE}, with format {content['format']} instead of {_FORMAT}"
            )
        if content["sha256"] != _checksum(text.decode().partition(_VALUE)[2][:-1]):
            raise ValueError("the checksum does not match, so that the bytes are damaged")
        return _decode(content["value"])
    except Exception as error:  # damaged bytes can raise any exception
        raise ValueError(
            f"these {len(blob)} bytes cannot be loaded as a saved value of this version of {_PACKAGE} ({error}): "
            "process the samples again, or load the bytes with the version that saved them"
        ) from error


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _check_size(text: bytes) -> None:
    n_values = sum(text.count(mark) for mark in (b"{", b"[", b",", b":"))
    if len(text) > _MAX_BYTES or n_values > _MAX_VALUES:
        raise ValueError(
            f"saved data must have at most {_MAX_BYTES} bytes and {_MAX_VALUES} values, got {len(text)} and about "
            f"{n_values}"
        )


def _inflate(blob: bytes) -> bytes:
    inflater = zlib.decompressobj()
    content = inflater.decompress(blob, _MAX_BYTES)
    if inflater.unconsumed_tail or not inflater.eof or inflater.unused_data:
        raise ValueError(f"incomplete, followed by other data, or more than {_MAX_BYTES >> 20} MiB")
    return content


def _encode(value: Any, foreign: bool = False) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        array = cast(np.ndarray[Any, Any], value)
        if array.dtype.kind not in "biuf":
            raise TypeError(f"an array of {array.dtype} cannot be saved: use an array of numbers")
        data = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
        return {"array": data, "dtype": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, (tuple, list)):
        items = cast(tuple[Any, ...], value)
        return {"tuple" if isinstance(value, tuple) else "list": [_encode(v, foreign) for v in items]}
    if isinstance(value, Mapping):
        mapping = cast(Mapping[Any, Any], value)
        if not all(isinstance(key, str) for key in mapping):
            raise TypeError("only mappings with text keys can be saved: JSON turns others into text")
        return {"dict": {key: _encode(v, foreign) for key, v in mapping.items()}}
    if is_dataclass(value) and type(value).__module__.partition(".")[0] == _PACKAGE:
        content = {f.name: _encode(getattr(value, f.name), foreign) for f in fields(value) if f.init}
        return {"dataclass": f"{type(value).__module__}:{type(value).__qualname__}", "fields": content}
    if foreign and is_dataclass(value) and not isinstance(value, type):
        return {"foreign": {f.name: _encode(getattr(value, f.name), foreign) for f in fields(value) if f.init}}
    raise TypeError(f"a {type(value).__qualname__} cannot be saved: keep states to arrays, numbers and dataclasses")


def _decode(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    node = cast(dict[str, Any], value)
    if "array" in node:
        return _array(node)
    if "tuple" in node:
        return tuple(_decode(v) for v in _of_type(node["tuple"], list, "the items of a tuple"))
    if "list" in node:
        return [_decode(v) for v in _of_type(node["list"], list, "the items of a list")]
    if "dict" in node:
        return {key: _decode(v) for key, v in node["dict"].items()}
    if "foreign" in node:
        return ForeignFields({key: _decode(v) for key, v in node["foreign"].items()})
    cls = _dataclass(_of_type(node["dataclass"], str, "the class of a dataclass"))
    content = {name: _decode(v) for name, v in node["fields"].items()}
    check_declared(cls, content)
    return cls(**content)


def _of_type(value: Any, cls: type, what: str) -> Any:
    """Return the value if its type is `cls`, otherwise raise ValueError.

    `what` is the name of the value in the message, to which `from_bytes` adds the remedy.
    """
    if type(value) is not cls:
        raise ValueError(f"{what} must be stored as a {cls.__name__}, got {str(value)[:60]}")
    return value


def _array(node: Mapping[str, Any]) -> np.ndarray[Any, Any]:
    dtype = np.dtype(_of_type(node["dtype"], str, "the type of an array"))
    if dtype.kind not in "biuf":
        raise ValueError(f"the array has type {dtype}, but saved arrays contain only numbers or truth values")
    data = base64.b64decode(node["array"], validate=True)
    return np.frombuffer(data, dtype=dtype).reshape(_of_type(node["shape"], list, "the shape of an array")).copy()


def _dataclass(name: str) -> type[Any]:
    module_name, _, class_name = name.partition(":")
    package, _, rest = module_name.partition(".")
    if package != _PACKAGE or (module_name not in sys.modules and rest.partition(".")[0] not in _PACKAGES):
        raise ValueError(f"refused to load {name!r}, because only the classes of a filter are loaded")
    cls = getattr(importlib.import_module(module_name), class_name)
    if not (isinstance(cls, type) and is_dataclass(cls)):
        raise ValueError(f"{name!r} is not a dataclass, so it cannot be a part of a saved filter")
    return cls
