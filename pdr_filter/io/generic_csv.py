"""Any CSV file, with a small TOML file beside it that says which column is what: docs/formats.md, "Any table"."""

from __future__ import annotations

from pathlib import Path

from pdr_filter.io.any_table import read_mapped
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.files import beside
from pdr_filter.io.mapping import read_mapping
from pdr_filter.io.recording import Recording


def mapping_beside(path: Path) -> Path:
    """Where the mapping of a CSV file is: walk.toml or walk.csv.toml beside walk.csv."""
    longer = beside(path, path.name + ".toml")
    return longer if longer.is_file() else beside(path, path.with_suffix(".toml").name)


def read_generic_csv(path: str | Path) -> Recording:
    """Return the recording in a CSV file, as the TOML file beside it says.

    RecordingError without that file, or if the mapping does not fit.
    """
    path = Path(path)
    mapping = mapping_beside(path)
    if not mapping.is_file():
        raise RecordingError(
            f"{path}: no {mapping.name} beside it that says which column is what; "
            f"pdr-filter convert {path.name} shows a mapping to begin with"
        )
    return read_mapped(path, read_mapping(mapping))
