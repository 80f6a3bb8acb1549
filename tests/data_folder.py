"""Where the real recordings are: the folder that PDR_DATA names, else the one beside the clone."""

from __future__ import annotations

import os
from pathlib import Path

# One folder for each data set, as `pdr_filter.datasets.fetch` has them.
DATA = Path(os.environ.get("PDR_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
