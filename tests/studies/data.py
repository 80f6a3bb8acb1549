"""Runner and recordings of the studies, and tables with the figures of a paper beside ours."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZipFile

import numpy as np

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.evaluate.tables import markdown
from pdr_filter.values import FloatArray, interpolated_rows
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, paths, places_of, recordings, run, say

NAN = float("nan")

# Height of somebody of whom it is not known: between the means of women and men, as in the recipes.
HEIGHT_M = 1.70
# Persons 1 to 6 had a say in thresholds, trees and detector constants.
_LEFT_OUT = ("ubicomp13_p0[7-9]_*.zip", "ubicomp13_p1?_*.zip")


@dataclass(frozen=True, kw_only=True)
class Part:
    """Part of a study with its data sets.

    A missing set of `needs` leaves out the part. A missing set of `uses` leaves out its rows. A missing set of
    `trained_on` changes the models. `min_people` is the smallest number of people in a set.
    """

    make: Callable[[Tables, argparse.Namespace], None]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    trained_on: tuple[str, ...] = ()
    min_people: int = 1


def run_study(doc: str | None, *parts: Part, **options: object) -> None:
    """Run the parts of a study with the data sets in the folder, or with those of `--sets` and `--people`."""

    def prepare(arguments: argparse.Namespace, names: Sequence[str]) -> Sequence[str]:
        return with_sets(arguments, [part for part in parts if part.make.__name__ in names])

    run(doc, *(part.make for part in parts), prepare=prepare, sets="", people=0, **options)


def with_sets(arguments: argparse.Namespace, parts: Sequence[Part]) -> list[str]:
    """Return the names of the parts whose data sets are there, and report what is left out.

    `arguments.whole` becomes the folder for training, and `arguments.data` the folder of the chosen sets and people.
    ValueError for an unknown set, and if no part has a set.
    """
    known = dict.fromkeys(name for part in parts for name in (*part.needs, *part.uses))
    chosen = list(dict.fromkeys(name for name in arguments.sets.split(",") if name) or known)
    if unknown := [name for name in chosen if name not in known]:
        raise ValueError(f"--sets has {', '.join(unknown)}, but the sets here are {', '.join(known)}")
    least = max(part.min_people for part in parts)
    if arguments.people and arguments.people < least:
        raise ValueError(f"--people must be at least {least} here, because people are held out, got {arguments.people}")
    is_missing = {name: not paths(arguments.data, name) for part in parts for name in (*known, *part.trained_on)}
    is_whole = not any(is_missing.values()) and len(chosen) == len(known) and not arguments.people
    found, left_out = list[str](), list[str]()
    for part in parts:
        name, of_part = part.make.__name__, (*part.needs, *part.uses)
        missing = [s for s in of_part if s in chosen and is_missing[s]]
        without = [s for s in of_part if s not in chosen or is_missing[s]]
        is_out = any(s in without for s in part.needs) or len(without) == len(of_part)
        if is_out:
            left_out.append(f"{name} is left out: it needs {' and '.join(part.needs) or ' or '.join(part.uses)}")
        elif missing:
            left_out.append(f"{name}: no recordings of {', '.join(missing)}, so that their rows are left out")
        if not is_out:
            found.append(name)
            if untrained := [s for s in part.trained_on if is_missing[s]]:
                left_out.append(f"{name}: models are trained without {', '.join(untrained)}, unlike those of the docs")
    absent = [name for name in chosen if is_missing[name]]
    if not found and not absent:
        raise ValueError(f"--sets {arguments.sets} has too few sets: {'; '.join(left_out)}")
    if not found:
        raise ValueError(
            f"{arguments.data} has no recordings of {', '.join(absent)} (SET/*.zip), so that nothing can be done: name "
            "the folder of the data sets with --data; docs/benchmarks.md says where they are published"
        )
    for sentence in left_out:
        say(sentence)
    if len(chosen) < len(known) or arguments.people:
        present = ", ".join(name for name in chosen if not is_missing[name])
        say(f"data sets: {present}{f'; people of each: {arguments.people}' if arguments.people else ''}")
    arguments.whole = arguments.data
    if not is_whole:
        say("tables are printed and not written, because the study is not complete")
        arguments.print = True
    if len(chosen) < len(known) or arguments.people:
        arguments.folder = TemporaryDirectory()  # removed with the arguments
        arguments.data = linked(arguments.data, chosen, arguments.people, Path(arguments.folder.name))
    return found


def linked(data: Path, sets: Iterable[str], n_people: int, folder: Path) -> Path:
    """Fill a folder with links to the recordings of some sets, of the last people by name or of all (0)."""
    for name in sets:
        person = {path: person_of(path) for path in paths(data, name)} if n_people else {}
        use = sorted(set(person.values()))[-n_people:]
        (folder / name).mkdir()
        for path in paths(data, name):
            if not n_people or person[path] in use:
                (folder / name / path.name).symlink_to(path.resolve())
    return folder


def person_of(path: Path) -> str:
    """Identifier of the person of a recording, "" if it is not known; samples are not read."""
    with ZipFile(path) as file:
        return str(json.loads(file.read("meta.json")).get("subject", {}).get("id") or "")


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
    """Write a table of a paper: rows with equal columns, numbers with so many digits, a dash for NaN.

    Without rows nothing is written.
    """
    if not rows:
        say(f"{title}: no rows without the missing data sets")
        return
    columns, _, *cells = ([c.strip() for c in line[1:-1].split("|")] for line in markdown(rows, digits).splitlines())
    tables.write(name, columns, cells, f"{title}. {data[0].upper()}{data[1:]}.")
