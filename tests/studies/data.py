"""Recordings of the studies, and tables with the figures of a paper beside ours."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.evaluate.tables import markdown
from pdr_filter.values import FloatArray, interpolated_rows
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, places_of, recordings

NAN = float("nan")

# Height of somebody of whom it is not known: between the means of women and men, as in the recipes.
HEIGHT_M = 1.70
# Persons 1 to 6 had a say in thresholds, trees and detector constants.
_LEFT_OUT = ("ubicomp13_p0[7-9]_*.zip", "ubicomp13_p1?_*.zip")


def people_left_out(data: Path, places: Collection[str] = ()) -> Iterator[Recording]:
    """Walks of persons 7 to 13 of ubicomp13, on whom nothing was chosen; with the phone in these places if given."""
    for pattern in _LEFT_OUT:
        yield from (r for r in recordings(data, "ubicomp13", pattern) if not places or place_of(r) in places)


def place_of(recording: Recording) -> str:
    """Where the phone was: the end of the name of a ubicomp13 recording."""
    return recording.name.split("_", 3)[-1]


def counted_walk(recording: Recording) -> tuple[float, float, int]:
    """Start and end of the first truth segment, and its number of steps."""
    segments = recording.truth.segments
    if segments is None:
        raise ValueError(f"{recording.name}: no truth_segments.csv")
    return float(segments.start_s[0]), float(segments.end_s[0]), int(segments.n_steps[0])


def even_way(recording: Recording, every_s: float) -> tuple[FloatArray, FloatArray]:
    """Even times, and east and north of the truth then, (N,) and (N, 2)."""
    position = recording.truth.position
    if position is None:
        raise ValueError(f"{recording.name}: no truth_position.csv")
    time_s = np.arange(position.time_s[0], position.time_s[-1], every_s)
    return time_s, interpolated_rows(time_s, position.time_s, places_of(position))


def with_subject(recording: Recording, **known: object) -> Recording:
    """The recording of a person of whom this is known too, such as `id`."""
    return replace(recording, meta={**recording.meta, "subject": {**recording.meta["subject"], **known}})


def prefixed(who: str, names: Iterable[str], values: Iterable[object], unit: str = "") -> dict[str, object]:
    """Cells of a row, "WHO NAME UNIT" for each name, such as "paper walking %"."""
    return {f"{who} {name}{unit}": value for name, value in zip(names, values, strict=True)}


def together(scores: Sequence[StepScores]) -> StepScores:
    """The scores of several walks as if they were one."""
    return StepScores(*(sum(getattr(s, name) for s in scores) for name in ("n_true", "n_found", "n_matched")))


def by_count(n_true: int, n_found: int) -> StepScores:
    """Of counts alone: what is over-counted in one place and missed in another is not seen."""
    return StepScores(n_true, n_found, min(n_true, n_found))


def paper_table(
    tables: Tables, name: str, title: str, rows: Sequence[Mapping[str, object]], data: str, digits: int = 1
) -> None:
    """Write a table of a paper: rows with equal columns, numbers with so many digits, a dash for NaN."""
    columns, _, *cells = ([c.strip() for c in line[1:-1].split("|")] for line in markdown(rows, digits).splitlines())
    tables.write(name, columns, cells, f"{title}. {data[0].upper()}{data[1:]}.")
