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
    names, cells = _contents(rows)
    head = [f"| {' | '.join(_cell(name, digits) for name in names)} |", f"|{'|'.join(['---'] * len(names))}|"]
    return Markdown("\n".join([*head, *(f"| {' | '.join(_cell(c, digits) for c in row)} |" for row in cells)]))


def latex(
    rows: Table | Sequence[Mapping[str, object]], digits: int = 2, caption: str | None = None, label: str | None = None
) -> str:
    r"""Return a table as LaTeX, which needs the package booktabs.

    Parameters
    ----------
    rows, digits : as in `markdown`
        Table to write, and number of decimals of floats.
    caption : str, optional
        Caption in LaTeX. With a caption, the result is a `table` that contains the `tabular`.
    label : str, optional
        Label for references, such as "tab:study". It needs a caption.

    Returns
    -------
    str
        Text of the table. Headings have words and units instead of column names, such as "RMSE (m)" for `rmse_m`. NaN
        is "--". Rows and columns whose numbers are all NaN are omitted.

    Raises
    ------
    ValueError
        If a label is given without a caption.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.evaluate import latex
    >>> from pdr_filter.values import table
    >>> print(latex(table({"name": np.array(["hc"]), "error_percent": np.array([1.234])})))
    \begin{tabular}{lr}
    \toprule
    Name & Error (\%) \\
    \midrule
    hc & 1.23 \\
    \bottomrule
    \end{tabular}
    """
    if label is not None and caption is None:
        raise ValueError(f"label {label!r} needs a caption, because LaTeX numbers captions: give caption, too")
    names, cells = _contents(rows)
    cells = [row for row in cells if not all(map(_is_nan, filter(_is_float, row))) or not any(map(_is_float, row))]
    kept = [k for k in range(len(names)) if not cells or not all(_is_nan(row[k]) for row in cells)]
    align = "".join("l" if any(_is_text(row[k]) for row in cells) else "r" for k in kept)
    head = " & ".join(_latex_cell(heading(names[k]), digits) for k in kept)
    body = [" & ".join(_latex_cell(row[k], digits) for k in kept) for row in cells]
    lines = [rf"\begin{{tabular}}{{{align}}}", r"\toprule", rf"{head} \\", r"\midrule"]
    lines += [*(rf"{line} \\" for line in body), r"\bottomrule", r"\end{tabular}"]
    if caption is not None:
        named = [] if label is None else [rf"\label{{{label}}}"]
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{caption}}}", *named, *lines, r"\end{table}"]
    return "\n".join(lines)


def heading(name: str) -> str:
    """Return the heading of a column in words, with its unit in parentheses: "RMSE (m)" for `rmse_m`."""
    if name == "context_error_percent":
        return "Windows of wrong context (%)"
    words = name.removeprefix("n_").split("_")
    unit = _UNITS.get(words[-1]) if len(words) > 1 else None
    words = [word.upper() if word in ACRONYMS else word for word in (words[:-1] if unit else words)]
    text = " ".join(words)
    return text[:1].upper() + text[1:] + (f" ({unit})" if unit else "")


def write_tables(
    rows: Table,
    stem: str | Path,
    digits: int = 2,
    caption: str | None = None,
    shown: Table | Sequence[Mapping[str, object]] | None = None,
) -> tuple[Path, Path]:
    """Write a table as STEM.csv, with all digits, and as STEM.tex, with rounded floats.

    Missing folders are created.

    Parameters
    ----------
    rows : Table
        Table with named columns.
    stem : str or Path
        Path without the suffix.
    digits : int, default 2
        Number of decimals of floats in the .tex.
    caption : str, optional
        Caption of the .tex, which then has the label "tab:STEM".
    shown : Table or sequence of mapping, optional
        Rows of the .tex in place of `rows`, such as `study_rows(study)`.

    Returns
    -------
    tuple of Path
        STEM.csv and STEM.tex. NaN is an empty cell in the .csv.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from pdr_filter.evaluate import write_tables
    >>> from pdr_filter.values import table
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     as_csv, as_tex = write_tables(table({"error_m": np.array([1.234])}), f"{folder}/errors")
    ...     print(as_csv.read_text().split())
    ['error_m', '1.234']
    """
    stem = Path(stem)
    stem.parent.mkdir(parents=True, exist_ok=True)
    as_csv, as_tex = stem.with_name(stem.name + ".csv"), stem.with_name(stem.name + ".tex")
    with as_csv.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(rows.dtype.names or ())
        writer.writerows(["" if value != value else value for value in row] for row in rows.tolist())
    label = None if caption is None else f"tab:{stem.name}"
    as_tex.write_text(latex(rows if shown is None else shown, digits, caption, label) + "\n", encoding="utf-8")
    return as_csv, as_tex


_UNITS = {"percent": "%", "m": "m", "s": "s", "mps": "m/s", "rad": "rad", "deg": "deg", "hz": "Hz"}
ACRONYMS = {"rmse", "nees", "nis", "hc", "wc", "imm"}
_LATEX = str.maketrans(
    {c: rf"\{c}" for c in "&%$#_{}"} | {"\\": r"\textbackslash{}", "~": r"\~{}", "^": r"\^{}", "±": r"$\pm$"}
)


def _contents(rows: Table | Sequence[Mapping[str, object]]) -> tuple[list[str], list[list[object]]]:
    """Return the column names and the cells of each row."""
    if isinstance(rows, Sequence):
        names = list(rows[0]) if rows else []
        return names, [[row[name] for name in names] for row in rows]
    return list(rows.dtype.names or ()), [list(row) for row in rows.tolist()]


def _is_float(value: object) -> bool:
    return isinstance(value, float | np.floating)


def _is_text(value: object) -> bool:
    """Return True for a word, and False for a number or a number as text, such as "+1.2 ± 0.3"."""
    return isinstance(value, str) and value[:1] not in "+-0123456789"


def _is_nan(value: object) -> bool:
    return _is_float(value) and value != value


def _latex_cell(value: object, digits: int) -> str:
    return _text(value, digits, "--").translate(_LATEX)


def _cell(value: object, digits: int) -> str:
    return _text(value, digits, "-").replace("|", "\\|")  # escape a character that would end the cell


def _text(value: object, digits: int, nan: str) -> str:
    """Return a value in one line, with rounded floats and `nan` for NaN."""
    if isinstance(value, float | np.floating):
        return nan if value != value else f"{value:.{digits}f}"
    return " ".join(str(value).split())
