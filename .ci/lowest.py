"""Requirements of the package, and of some of its extras, with their lowest versions, one a line for pip.

`python .ci/lowest.py [EXTRA...]` prints them.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path


def lowest(extras: list[str]) -> list[str]:
    """Return each requirement of the package and of the extras with "~=" in place of ">="."""
    project = tomllib.loads(Path(__file__).resolve().parents[1].joinpath("pyproject.toml").read_text())["project"]
    listed = [*project["dependencies"], *(text for extra in extras for text in project["optional-dependencies"][extra])]
    # "~=2.1.0" is the newest correction of version 2.1, because the first release of a version may have been withdrawn
    return [re.sub(r">=(\d+)(\.\d+)?(\.\d+)?", _pin, text) for text in listed if not text.startswith("pdr_filter[")]


def _pin(bound: re.Match[str]) -> str:
    major, minor, patch = bound.groups(default="")
    return f"~={major}{minor or '.0'}{patch or '.0'}"


if __name__ == "__main__":
    print("\n".join(lowest(sys.argv[1:])))
