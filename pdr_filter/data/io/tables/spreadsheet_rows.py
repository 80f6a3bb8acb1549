"""The cells of a spreadsheet as JSON, in a process of its own: `python spreadsheet_rows.py < walk.xlsx`.

What reads them makes a rectangle of all rows and columns that a file claims, and ends its process if the memory for
that is not there. Imports nothing of the package.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from typing import Any

# A sheet has a million rows; with ten columns of objects they take this.
MEMORY_BYTES = 3 * 1024**3


def plain(value: Any) -> Any:
    """Return a cell as a number or a text. Dates and times become texts."""
    return value if isinstance(value, bool | int | float | str) else str(value)


def print_sheets() -> None:
    """Read a spreadsheet from standard input, and write its sheets as JSON. The argument is their largest number."""
    from python_calamine import CalamineWorkbook

    with contextlib.suppress(ImportError, ValueError, OSError):  # not on every system
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with CalamineWorkbook.from_filelike(io.BytesIO(sys.stdin.buffer.read())) as book:
        sheets = [(name, book.get_sheet_by_name(name).to_python()) for name in book.sheet_names[: int(sys.argv[1])]]
    json.dump([[name, [[plain(value) for value in row] for row in rows]] for name, rows in sheets], sys.stdout)


if __name__ == "__main__":
    print_sheets()
