"""Formatting of tables as Markdown and LaTeX, and writing to files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pdr_filter.values import Table


class Markdown(str):
    """Markdown text, which notebooks render and `print` shows unchanged."""

    __slots__ = ()

    def _repr_markdown_(self) -> str:
        return str(self)


def markdown(rows: Table | Sequence[Mapping[str, object]], digits: int = 2) -> Markdown:
    """Return a table as Markdown.

    Parameters
    ----------
    rows : Table or sequence of mapping
        Table with named columns, or a mapping from column names to values for each row.
    digits : int, default 2
        Number of decimals of floats.

    Returns
    -------
    Markdown
        Text of the table, which notebooks render. NaN is "-".

    Examples
    --------
    >>> from pdr_filter.evaluate import markdown
    >>> print(markdown([{"weighting": "hc", "distance_m": 101.234}]))
    | weighting | distance_m |
    |---|---|
    | hc | 101.23 |
    """
    if isinstance(rows, Sequence):
        names = list(rows[0]) if rows else []
        cells = [[row[name] for name in names] for row in rows]
    else:
        names = list(rows.dtype.names or ())
        cells = [list(row.item()) for row in rows]
    head = [f"| {' | '.join(_cell(name, digits) for name in names)} |", f"|{'|'.join(['---'] * len(names))}|"]
    return Markdown("\n".join([*head, *(f"| {' | '.join(_cell(c, digits) for c in row)} |" for row in cells)]))


def latex(rows: Table, digits: int = 2) -> str:
    r"""Return a table as a LaTeX `tabular`, which needs no package.

    Parameters
    ----------
    rows : Table
        Table with named columns.
    digits : int, default 2
        Number of decimals of floats.

    Returns
    -------
    str
        Text of the table. NaN is "--".

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.evaluate import latex
    >>> from pdr_filter.values import table
    >>> print(latex(table({"name": np.array(["hc"]), "error_percent": np.array([1.234])})))
    \begin{tabular}{lr}
    \hline
    name & error\_percent \\
    \hline
    hc & 1.23 \\
    \hline
    \end{tabular}
    """
    names = list(rows.dtype.names or ())
    align = "".join("l" if rows[name].dtype.kind in "US" else "r" for name in names)
    lines = [
        " & ".join(_latex_cell(cell, digits) for cell in line) + r" \\" for line in (names, *map(list, rows.tolist()))
    ]
    head = [rf"\begin{{tabular}}{{{align}}}", r"\hline", lines[0], r"\hline"]
    return "\n".join([*head, *lines[1:], r"\hline", r"\end{tabular}"])


def write_tables(rows: Table, stem: str | Path, digits: int = 2) -> tuple[Path, Path]:
    """Write a table as STEM.csv, with all digits, and as STEM.tex, with rounded floats, and return both paths.

    NaN is an empty cell in the .csv. Missing folders are created.
    """
    stem = Path(stem)
    stem.parent.mkdir(parents=True, exist_ok=True)
    as_csv, as_tex = stem.with_name(stem.name + ".csv"), stem.with_name(stem.name + ".tex")
    with as_csv.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(rows.dtype.names or ())
        writer.writerows(["" if value != value else value for value in row] for row in rows.tolist())
    as_tex.write_text(latex(rows, digits) + "\n", encoding="utf-8")
    return as_csv, as_tex


_LATEX = str.maketrans({c: rf"\{c}" for c in "&%$#_{}"} | {"\\": r"\textbackslash{}", "~": r"\~{}", "^": r"\^{}"})


def _latex_cell(value: object, digits: int) -> str:
    if isinstance(value, float | np.floating):
        return "--" if value != value else f"{value:.{digits}f}"
    return " ".join(str(value).split()).translate(_LATEX)


def _cell(value: object, digits: int) -> str:
    if isinstance(value, float | np.floating):
        return "-" if value != value else f"{value:.{digits}f}"
    return " ".join(str(value).split()).replace("|", "\\|")  # escape characters that would end the cell or the line
