"""Updates by fixes: gating, rotation of the frame of the fixes, relocation, ranges, and GNSS locations."""

import importlib
import warnings
from typing import Any


def __getattr__(name: str) -> Any:
    """Return a name of the former module `pdr_filter.filter.fixes`, with a deprecation warning."""
    if not name.startswith("_") and name != "fix_updates":
        module = importlib.import_module(f"{__name__}.fix_updates")
        if name in vars(module):
            warnings.warn(f"{__name__}.{name} is now in {module.__name__}", DeprecationWarning, stacklevel=2)
            return vars(module)[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
