"""The package gtsam, imported when the first of its names is used.

`pdr_filter.smooth` can thus be imported where gtsam is not installed, and a call raises an ImportError with the remedy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pdr_filter.values.optional_packages import load_optional

if TYPE_CHECKING:
    import gtsam as gtsam
else:

    class _LatePackage:
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # inspect and doctest ask every object for such names
                raise AttributeError(name)
            value = getattr(load_optional("gtsam"), name)
            setattr(self, name, value)  # the next access finds the value without this method
            return value

    gtsam = _LatePackage()
