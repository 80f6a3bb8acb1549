"""Configurations and states to bytes and back: plain values only, nothing in the bytes is ever executed.

The bytes are zlib-compressed JSON. Arrays are stored as their exact bytes, dataclasses by the name of a dataclass of
this package; any other type is refused, on the way out and on the way in.
"""

from __future__ import annotations

import base64
import importlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, cast

import numpy as np

_PACKAGE = "pdr_filter"
_FORMAT = 2
_MAX_BYTES = 256 << 20  # a filter with its models has some MB


def to_bytes(value: object) -> bytes:
    """Bytes of a value made of dataclasses of this package, arrays, numbers, strings, None, tuples and dicts."""
    return zlib.compress(json.dumps({"format": _FORMAT, "value": _encode(value)}).encode())


def from_bytes(blob: object) -> Any:
    """The value that `to_bytes` was given; ValueError if the bytes are not from there."""
    if not isinstance(blob, bytes):
        raise ValueError(f"a saved filter is bytes, got {type(blob).__name__}")
    try:
        content = json.loads(_inflate(blob))
        if content["format"] != _FORMAT:
            raise ValueError(f"format {content['format']}, this version reads {_FORMAT}")
        return _decode(content["value"])
    except (zlib.error, LookupError, TypeError, AttributeError, ImportError, ValueError, RecursionError) as error:
        raise ValueError(
            f"these {len(blob)} bytes are not a saved filter of this version of {_PACKAGE} ({error}); save it again"
        ) from error


def _inflate(blob: bytes) -> bytes:
    inflater = zlib.decompressobj()
    content = inflater.decompress(blob, _MAX_BYTES)
    if inflater.unconsumed_tail or not inflater.eof:
        raise ValueError(f"cut short, or more than {_MAX_BYTES >> 20} MiB")
    return content


def _encode(value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        array = cast(np.ndarray[Any, Any], value)
        if array.dtype.kind not in "biuf":
            raise TypeError(f"an array of {array.dtype} cannot be saved: only numbers come back as they were")
        data = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
        return {"array": data, "dtype": array.dtype.str, "shape": list(array.shape)}
    if isinstance(value, (tuple, list)):
        items = cast(tuple[Any, ...], value)
        return {"tuple" if isinstance(value, tuple) else "list": [_encode(v) for v in items]}
    if isinstance(value, Mapping):
        mapping = cast(Mapping[Any, Any], value)
        if not all(isinstance(key, str) for key in mapping):
            raise TypeError("only mappings with text keys can be saved: JSON turns others into text")
        return {"dict": {key: _encode(v) for key, v in mapping.items()}}
    if is_dataclass(value) and type(value).__module__.partition(".")[0] == _PACKAGE:
        content = {f.name: _encode(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"dataclass": f"{type(value).__module__}:{type(value).__qualname__}", "fields": content}
    raise TypeError(f"a {type(value).__qualname__} cannot be saved: keep states to arrays, numbers and dataclasses")


def _decode(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    node = cast(dict[str, Any], value)
    if "array" in node:
        dtype = np.dtype(node["dtype"])
        return np.frombuffer(base64.b64decode(node["array"]), dtype=dtype).reshape(node["shape"]).copy()
    if "tuple" in node:
        return tuple(_decode(v) for v in node["tuple"])
    if "list" in node:
        return [_decode(v) for v in node["list"]]
    if "dict" in node:
        return {key: _decode(v) for key, v in node["dict"].items()}
    module_name, _, class_name = str(node["dataclass"]).partition(":")
    if module_name.partition(".")[0] != _PACKAGE:
        raise ValueError(f"refused to load {node['dataclass']!r}")
    cls = getattr(importlib.import_module(module_name), class_name)
    if not (isinstance(cls, type) and is_dataclass(cls)):
        raise ValueError(f"{node['dataclass']!r} is not a value type")
    return cls(**{name: _decode(v) for name, v in node["fields"].items()})
