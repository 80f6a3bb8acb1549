"""Height from barometer and steps, and the detection of floors."""

import importlib
import warnings
from typing import Any


def __getattr__(name: str) -> Any:
    """Return a name of the former module `pdr_filter.filter.height`, with a deprecation warning."""
    if not name.startswith("_") and name != "height_filter":
        module = importlib.import_module(f"{__name__}.height_filter")
        if name in vars(module):
            warnings.warn(f"{__name__}.{name} is now in {module.__name__}", DeprecationWarning, stacklevel=2)
            return vars(module)[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
