"""Checks of numbers: of an argument, of an array, and of all fields of a configuration. One wording for each."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields
from math import inf, isfinite
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np

# Least and largest by the unit at the end of the name: nothing here looks back further than eleven days, and no sensor
# is slower or quicker. Lengths of kernels and windows follow from them.
_RANGES = {"s": (1e-6, 1e6), "hz": (1e-3, 1e4), "prob": (1e-12, 1.0)}
_RANGE = (1e-12, 1e12)  # of all others: their squares, and the inverses of those, are numbers
_RANGE_OF_COUNTS = (1, 10**6)
_SHOWN = 36  # numbers of an array that a message shows
Kind = Literal["finite", "positive", "0 or more", "increasing"]
_IS_KIND: Mapping[Kind, Callable[[Any], bool]] = {
    "finite": lambda _: True,
    "positive": lambda array: bool((array > 0).all()),
    "0 or more": lambda array: bool((array >= 0).all()),
    "increasing": lambda array: bool((np.diff(array) > 0).all()),
}
_NUMBERS = re.compile(r"(tuple\[)?(float|int)\b[^|]*")  # as fields are declared


def are_numbers(*values: Any) -> bool:
    """True if all values are finite real numbers; a string of digits and a truth value are none."""
    return all(not isinstance(v, bool) and isinstance(v, Real) and isfinite(v) for v in values)


def check_number(name: str, value: Any, least: float, largest: float, remedy: str) -> None:
    """ValueError unless an argument is a number from `least` to `largest`; the remedy ends the message."""
    if not (are_numbers(value) and least <= value <= largest):
        raise ValueError(f"{name} must be a number from {least:g} to {largest:g}, got {value!r}: {remedy}")


def check_array(
    name: str, value: Any, kind: Kind = "finite", shape: tuple[int, ...] | None = None, remedy: str = ""
) -> None:
    """ValueError unless an array, or a number, has this shape and all its numbers are finite and of this kind."""
    array = np.asarray(value)
    right = array.dtype.kind in "iuf" and shape in (None, array.shape)
    if not (right and np.isfinite(array).all() and _IS_KIND[kind](array)):
        words = kind if kind == "finite" else f"{kind} and finite"
        of_shape = "" if shape is None else f"{shape}, "
        got = repr(value)
        if array.size > _SHOWN:
            got = f"{array.min()} to {array.max()} in an array {array.shape}"
        raise ValueError(f"{name} must be {of_shape}{words}, got {got}{remedy and f': {remedy}'}")


def check_numbers(
    config: Any, *, zero: Collection[str] = (), signed: Collection[str] = (), infinite: Collection[str] = ()
) -> None:
    """ValueError unless every number in the fields of a configuration is positive, finite and can be meant.

    Looks at fields declared as a number or as a tuple of numbers. Those in `zero` may be 0, those in `signed` have any
    sign, those in `infinite` may be infinity, where it switches something off.
    """
    for field in fields(config):
        declared = _NUMBERS.fullmatch(str(field.type))
        if declared is None:
            continue
        name, value = field.name, getattr(config, field.name)
        kind, (least, largest) = (Integral, _RANGE_OF_COUNTS) if declared[2] == "int" else (Real, _RANGE)
        if kind is Real and "_per_" not in name:  # a rate has other units
            least, largest = _RANGES.get(name.rpartition("_")[2], _RANGE)
        words = "positive"
        if name in signed:
            least, words = -largest, "finite"
        elif name in zero:
            least, words = 0, "0 or more"
        or_infinite = name in infinite
        numbers: Any = value if declared[1] and isinstance(value, tuple) else (value,)
        for number in numbers:
            right = issubclass(type(number), kind) and type(number) is not bool
            if not (right and (least <= number <= largest or (or_infinite and number == inf))):
                what = f"{words}{' and whole' if kind is Integral else ''} ({least:g} to {largest:g}"
                usual = "" if field.default is MISSING else f"; its default is {field.default}"
                raise ValueError(
                    f"{name} of {type(config).__name__} must be {what}{', or infinity' if or_infinite else ''}), "
                    f"got {value!r}{usual}"
                )
