"""Packages that are imported when they are used, with one sentence and the remedy where they are not installed."""

from __future__ import annotations

import importlib
from typing import Any

# Package: what needs it, and the remedy.
_USES = {
    "gtsam": (
        "smoothing (also in calibrations with smooth=True and in maps of many walks)",
        "pip install gtsam. On Windows, where it has no wheel, use the Windows Subsystem for Linux",
    ),
    "filterpy": ("FilterpyImm", "pip install filterpy, or use NumpyImm, which gives the same results"),
    "matplotlib": ("a picture", "pip install matplotlib; reports and tables work without it"),
    "pandas": ("a data frame", 'pip install "pdr_filter[parquet]"'),
    "shapely": ("a floor plan", 'pip install "pdr_filter[maps]"'),
    "pooch": ("a download", 'pip install "pdr_filter[datasets]"'),
    "requests": ("a download", 'pip install "pdr_filter[datasets]"'),  # which pooch requires
}


def load_optional(module: str, needed_by: str = "") -> Any:
    """Return a module of an optional package, imported.

    ImportError if it cannot be imported, which names what needs the package and how to install it. `needed_by` replaces
    the general description of what needs it.
    """
    package = module.split(".")[0]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if (error.name or package).split(".")[0] != package:
            raise  # another package, which this one imports
        user, remedy = _USES[package]
        reason = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be imported ({error})"
        raise ImportError(f"{needed_by or user} needs {package}, which {reason}: {remedy}", name=package) from None


def is_available(package: str) -> bool:
    """Return True if an optional package can be imported."""
    try:
        load_optional(package)
    except ImportError:
        return False
    return True
