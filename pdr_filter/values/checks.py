"""Checks of numbers, with uniform messages: of an argument, of an array, and of all fields of a configuration."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields
from math import inf, isfinite
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np

from pdr_filter.values import limits

# Ranges by the unit at the end of a name. No stage looks back further than eleven days (1e6 s), and no sensor has a
# lower or higher rate. The ranges bound the lengths of kernels and windows.
_RANGES = {"s": (1e-6, 1e6), "hz": (1e-3, 1e4), "prob": (1e-12, 1.0)}
# Range of all other numbers: their squares, and the inverses of the squares, do not overflow.
_RANGE = (1e-12, 1e12)
_RANGE_OF_COUNTS = (1, 10**6)
# Maximum size of an array that a message shows in full.
_SHOWN = 36
# Maximum length of the text of an argument in a message.
_SHOWN_CHARS = 120
Kind = Literal["finite", "positive", "0 or more", "increasing"]
_IS_KIND: Mapping[Kind, Callable[[Any], bool]] = {
    "finite": lambda _: True,
    "positive": lambda array: bool((array > 0).all()),
    "0 or more": lambda array: bool((array >= 0).all()),
    "increasing": lambda array: bool((np.diff(array) > 0).all()),
}
_NUMBERS = re.compile(r"(tuple\[)?(float|int)\b[^|]*")  # declared types of numeric fields


def shown(value: object) -> str:
    """Return a wrong argument for a message: its text, or its class if the text is long."""
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARS and "\n" not in text else f"a {type(value).__name__}"


def are_numbers(*values: Any) -> bool:
    """True if all values are finite real numbers. Strings and bools are not numbers."""
    return all(not isinstance(v, bool) and isinstance(v, Real) and isfinite(v) for v in values)


def check_number(name: str, value: Any, least: float, largest: float, remedy: str) -> None:
    """Raise ValueError unless an argument is a number from `least` to `largest`. The remedy ends the message."""
    if not (are_numbers(value) and least <= value <= largest):
        raise ValueError(f"{name} must be a number from {least:g} to {largest:g}, got {value!r}: {remedy}")


def check_heading(name: str, heading_rad: Any) -> None:
    """Raise ValueError unless a number is a finite heading of at most one turn, in rad."""
    check_array(name, heading_rad)
    heading_deg = np.degrees(heading_rad)
    if not (abs(heading_deg) <= limits.MAX_HEADING_DEG * (1 + 1e-6)).all():
        raise ValueError(
            f"{name} must be in radians clockwise from north, -2 pi to 2 pi, got {heading_rad!r}: convert degrees with "
            f"np.deg2rad({heading_rad!r})"
        )


def check_step_length(name: str, length_m: Any) -> None:
    """Raise ValueError unless a number is a plausible step length in metres."""
    check_number(name, length_m, *limits.STEP_LENGTH_RANGE_M, "step lengths are in metres, such as 0.7")


def check_walked(name: str, distance_m: float, duration_s: float) -> None:
    """Raise ValueError if nobody walks or runs so far in this time."""
    if distance_m > limits.MAX_SPEED_MPS * duration_s:
        raise ValueError(
            f"{name} must be the length of the walked path in metres, got {distance_m:g} m in {duration_s:.1f} s, "
            f"faster than {limits.MAX_SPEED_MPS:g} m/s, which nobody runs: correct the unit or the times"
        )


def check_array(
    name: str, value: Any, kind: Kind = "finite", shape: tuple[int, ...] | None = None, remedy: str = ""
) -> None:
    """Raise ValueError unless an array or a number is finite and has the given shape (None for any) and kind.

    The kinds are "finite" (any number), "positive", "0 or more", and "increasing" from element to element.
    """
    array = np.asarray(value)
    right = array.dtype.kind in "iuf" and shape in (None, array.shape)
    if not (right and np.isfinite(array).all() and _IS_KIND[kind](array)):
        words = kind if kind == "finite" else f"{kind} and finite"
        of_shape = "" if shape is None else f"{shape or 'a number'}, "
        got = repr(value)
        if array.size > _SHOWN:
            got = f"{array.min()} to {array.max()} in an array {array.shape}"
        raise ValueError(f"{name} must be {of_shape}{words}, got {got}{remedy and f': {remedy}'}")


def check_numbers(
    config: Any, *, zero: Collection[str] = (), signed: Collection[str] = (), infinite: Collection[str] = ()
) -> None:
    """Raise ValueError unless every number in the fields of a configuration is positive, finite and plausible.

    Parameters
    ----------
    config : dataclass instance
        Configuration. Its fields declared as a number or as a tuple of numbers are checked.
    zero : collection of str, optional
        Names of fields that may be 0.
    signed : collection of str, optional
        Names of fields that may be negative.
    infinite : collection of str, optional
        Names of fields that may be infinity, which disables a feature.

    Raises
    ------
    ValueError
        If a number has the wrong type, sign or magnitude. The message names the field and its default.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength
    >>> from pdr_filter.values.checks import check_numbers
    >>> check_numbers(FrequencyVarianceStepLength(max_variance=8.0))
    """
    for field in fields(config):
        declared = _NUMBERS.fullmatch(str(field.type))
        if declared is None:
            continue
        name, value = field.name, getattr(config, field.name)
        kind, (least, largest) = (Integral, _RANGE_OF_COUNTS) if declared[2] == "int" else (Real, _RANGE)
        # A name such as rad_per_sqrt_s ends in s, but is not a time.
        if kind is Real and "_per_" not in name:
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
