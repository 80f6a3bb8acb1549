"""Where the real recordings are: the folder PDR_DATA, else the one beside the clone, else what was fetched."""

from __future__ import annotations

import os
from pathlib import Path

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"


def _data() -> Path:
    """One folder for each data set, as `pdr_filter.datasets.fetch` writes them."""
    if folder := os.environ.get("PDR_DATA"):
        return Path(folder)
    if not _BESIDE.is_dir():
        from pdr_filter.data.datasets import cache_folder

        try:
            return cache_folder()
        except ImportError:  # without the package for downloads nothing was fetched
            pass
    return _BESIDE


DATA = _data()
