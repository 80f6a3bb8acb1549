"""Conversion of values to JSON types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import Any, cast

import numpy as np


def as_plain(value: Any) -> Any:
    """Return a value or dataclass as dictionaries, lists, texts and numbers. NaN and infinity become None."""
    if is_dataclass(value):
        return {f.name: as_plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return as_plain(cast(Any, value).tolist())
    if isinstance(value, Mapping):
        return {str(key): as_plain(item) for key, item in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in cast("list[Any]", value)]
    return None if isinstance(value, float) and not isfinite(value) else value
