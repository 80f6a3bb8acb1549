"""Published experiments done anew on the data at hand: one module a paper, one function `study(data)` each."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from pdr_filter.evaluate.studies.report import Study, StudyFigure, StudyTable

STUDIES = ("martinelli2018", "tian2016", "zhou2019", "guo2018", "susi2013")


def study(name: str, data: str | Path) -> Study:
    """The study of a paper on the recordings of a folder; ValueError for an unknown name or a missing folder."""
    if name not in STUDIES:
        raise ValueError(f"study must be one of {STUDIES}, got {name!r}")
    folder = Path(data)
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; give the folder of the data sets, one folder each")
    # each loads what it needs only when it is asked for
    return import_module(f"{__name__}.{name}").study(folder)


__all__ = ["STUDIES", "Study", "StudyFigure", "StudyTable", "study"]
