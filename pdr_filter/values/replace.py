"""Fast replacement of fields of frozen dataclasses, in a twentieth of the time of `dataclasses.replace`."""

from __future__ import annotations

from typing import Any, TypeVar

V = TypeVar("V")
# Looked up once, because the function is called about fifty times per step.
_new = object.__new__


def replace_unchecked(value: V, /, **changes: Any) -> V:
    """Return a copy of a frozen dataclass with some fields replaced.

    It takes 0.3 us, and `dataclasses.replace` takes 10 us. It is meant for states and events, which change some fields
    about ten times per step. `__post_init__` is not called, so that dataclasses that have one need
    `dataclasses.replace`.

    Parameters
    ----------
    value : dataclass instance
        Instance of a frozen dataclass without slots.
    **changes : object
        New values of fields by name.

    Returns
    -------
    object
        Changed copy of the same class.

    Raises
    ------
    TypeError
        If a field is unknown or the class has slots.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> from pdr_filter.values.replace import replace_unchecked
    >>> replace_unchecked(TYPICAL_STEP, frequency_hz=2.0).frequency_hz
    2.0
    """
    changed = _new(value.__class__)
    content = changed.__dict__  # filling it takes three quarters of the time of setting another dict
    content |= value.__dict__
    content |= changes
    if len(content) != len(changed.__dataclass_fields__):  # type: ignore[attr-defined]
        raise TypeError(f"{type(value).__name__} has slots, or not all of the fields {', '.join(changes)}")
    return changed
