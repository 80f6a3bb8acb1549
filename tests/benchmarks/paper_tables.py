"""The tables of the papers' experiments that the pages of docs/methods show, of the studies in tests/studies.

usage: python -m tests.benchmarks.paper_tables [martinelli2018] [tian2016] ... [--data ../shared/data]

A study alone, with all its tables, figures and notes: `python -m tests.studies.NAME [--out FOLDER]`.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable

from pdr_filter.evaluate.tables import markdown
from tests.benchmarks.common import Tables, options
from tests.studies.report import StudyTable

SHOWN = {
    "martinelli2018": ("Table III, recall", "Table IV", "Table IV, simulated", "Fig. 12, numbers"),
    "tian2016": ("Table VI", "Table VII", "Table VIII, steps", "Table VIII", "Table IX"),
    "zhou2019": ("Table 6", "Table 8"),
    "guo2018": ("Table 3, scores", "Table 5", "Table 9, real walks"),
    "susi2013": ("Table 1", "Table 2"),
}


def write(tables: Tables, name: str, found: Iterable[StudyTable]) -> None:
    """Those of a study that its page shows, NAME_table_iv.md and so on."""
    by_title = {table.title.split(":")[0]: table for table in found}
    for title in SHOWN[name]:
        table = by_title[title]
        columns, _, *rows = ([cell.strip() for cell in line[1:-1].split("|")] for line in _lines(table))
        file = "".join(c for c in title.lower().replace(" ", "_") if c.isalnum() or c == "_")
        tables.write(f"{name}_{file}", columns, rows, f"{table.title}. {table.data[0].upper()}{table.data[1:]}.")


def _lines(table: StudyTable) -> list[str]:
    return markdown(table.rows, table.digits).splitlines()


def main() -> None:
    args = options(__doc__, *SHOWN).parse_args()
    tables = Tables.of(__spec__.name, args)
    for name in args.parts:
        write(tables, name, importlib.import_module(f"tests.studies.{name}").study(args.data).tables)


if __name__ == "__main__":
    main()
