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


class DataSets(type(DATA)):
    """Folder of the data sets. `folder / name` skips the test that names a missing data set, and fails it in CI."""

    def __truediv__(self, name: str | os.PathLike[str]) -> Path:
        data_set = Path(self, Path(name).parts[0])
        if not (data_set.is_dir() and any(data_set.iterdir())):
            import pytest

            if os.environ.get("CI") == "true":
                pytest.fail(f"CI needs the recordings at {data_set}")
            pytest.skip(f"no recordings at {data_set}")
        return Path(self, name)
