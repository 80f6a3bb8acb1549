"""What a study says: the paper's own figures beside ours, on which data, and what differs."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.evaluate.tables import Markdown, markdown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAN = float("nan")
Rows = tuple[Mapping[str, object], ...]


def prefixed(who: str, names: Iterable[str], values: Iterable[object], unit: str = "") -> dict[str, object]:
    """Cells of a row, "WHO NAME UNIT" for each name, such as "paper walking %"."""
    return {f"{who} {name}{unit}": value for name, value in zip(names, values, strict=True)}


def together(scores: Sequence[StepScores]) -> StepScores:
    """The scores of several walks as if they were one."""
    return StepScores(*(sum(getattr(s, name) for s in scores) for name in ("n_true", "n_found", "n_matched")))


def by_count(n_true: int, n_found: int) -> StepScores:
    """Of counts alone: what is over-counted in one place and missed in another is not seen."""
    return StepScores(n_true, n_found, min(n_true, n_found))


@dataclass(frozen=True, eq=False)
class StudyTable:
    """One table of a paper, with what was found here beside what is printed there.

    Parameters
    ----------
    title : str
        Number and subject, as in the paper: "Table III: step detection".
    rows : tuple of mapping
        One for each row, all with the same columns. Columns of the paper's own figures begin with `paper`, of ours with
        `ours`. A figure that is not known is NaN.
    data : str
        What ours were measured on, with how many people and recordings; starts with "simulated" where it is.
    differs : str
        How data and protocol differ from the paper's.
    digits : int
        Decimals that are shown.
    """

    title: str
    rows: Rows
    data: str
    differs: str
    digits: int = 1


@dataclass(frozen=True, eq=False)
class StudyFigure:
    """One figure of a paper, drawn from what was found here.

    Parameters
    ----------
    title : str
        Number and subject, as in the paper.
    draw : callable
        Draws it into the axes given, with units on both.
    data, differs : str
        As for `StudyTable`.
    """

    title: str
    draw: Callable[[Axes], None]
    data: str
    differs: str


@dataclass(frozen=True, eq=False)
class Study:
    """A paper's tables and figures, remade.

    Parameters
    ----------
    name : str
        Of the study: "martinelli2018".
    paper : str
        Authors, title, journal, year.
    tables : tuple of StudyTable
    figures : tuple of StudyFigure
    notes : tuple of str
        What the paper's printed numbers say against each other, and what could not be remade.
    """

    name: str
    paper: str
    tables: tuple[StudyTable, ...]
    figures: tuple[StudyFigure, ...] = ()
    notes: tuple[str, ...] = ()

    def to_markdown(self) -> Markdown:
        """Everything but the figures' curves, as one page of markdown."""
        parts = [f"# {self.name}", self.paper]
        for t in self.tables:
            parts += [f"## {t.title}", f"Data: {t.data}.", markdown(t.rows, t.digits), f"What differs: {t.differs}"]
        for f in self.figures:
            parts += [f"## {f.title}", f"Data: {f.data}.", f"![{f.title}]({_file_name(f.title)}.svg)"]
            parts += [f"What differs: {f.differs}"]
        if self.notes:
            parts += ["## Notes", "\n".join(f"- {note}" for note in self.notes)]
        return Markdown("\n\n".join(parts) + "\n")

    def save(self, folder: str | Path) -> list[Path]:
        """Files written: the page, a CSV file for each table with all digits, an SVG for each figure."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        page = folder / f"{self.name}.md"
        page.write_text(self.to_markdown(), encoding="utf-8")
        written = [page]
        for t in self.tables:
            path = folder / f"{_file_name(t.title)}.csv"
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, list(t.rows[0]) if t.rows else [])
                writer.writeheader()
                writer.writerows(t.rows)
            written.append(path)
        return written + [self._save_figure(f, folder) for f in self.figures]

    def _save_figure(self, figure: StudyFigure, folder: Path) -> Path:
        from matplotlib import rc_context
        from matplotlib.figure import Figure

        # text stays text, and the same figure gives the same file
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": self.name}):
            canvas = Figure(figsize=(5.0, 3.4), layout="constrained")
            figure.draw(canvas.subplots())
            path = folder / f"{_file_name(figure.title)}.svg"
            canvas.savefig(path, metadata={"Date": None})
        return path


def _file_name(title: str) -> str:
    """A file's name from a title's number: "Table III: step detection" is `table_iii`."""
    return "_".join("".join(c if c.isalnum() else " " for c in title.split(":")[0].lower()).split())
