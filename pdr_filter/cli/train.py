"""`pdr-filter train`: a context model from labelled recordings."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.cli import console
from pdr_filter.cli.console import escape


class Classifier(StrEnum):
    """Classifiers that files can hold."""

    RVM = "rvm"
    FOREST = "forest"
    BLEND = "blend"


@dataclass(frozen=True)
class Fitting:
    """Options of the model."""

    classifier: Annotated[
        Classifier, typer.Option(help="Relevance vector machine, random forest, or regression and boosted trees.")
    ] = Classifier.RVM
    carrying_modes: Annotated[
        bool, typer.Option("--carrying-modes", help="Learn where the phone is, in place of what the person does.")
    ] = False
    name: Annotated[str, typer.Option(help="Of the model and its files; else contexts or carrying.")] = ""


def train(
    out: Annotated[Path, typer.Option(help="Folder for NAME.npz and NAME.json, or transitions.json.")],
    how: Fitting,
    folder: Annotated[Path | None, typer.Argument(help="Folder of labelled recordings.")] = None,
    sequences: Annotated[
        Path | None,
        typer.Option(help="In place of FOLDER: recordings for transitions of the shipped model, without training."),
    ] = None,
) -> None:
    """Fit a context model on labelled recordings of two people or more, with any names of contexts.

    A recording says whose it is by subject.id of its meta.json, or lies in a folder of its person: FOLDER/anna/1.zip.
    Labels are those of truth_labels.csv. People are held out for the report on stdout.
    """
    if (folder is None) == (sequences is None):
        console.say_error("give FOLDER, or --sequences FOLDER for transitions only: exactly one of the two")
        raise typer.Exit(console.UNUSABLE)
    before = {path: path.stat().st_mtime_ns for path in out.glob("*") if path.is_file()}
    if folder is not None:
        _fit(folder, out, how)
    elif sequences is not None:
        _estimate_transitions(sequences, out)
    console.say_replaced(console.replaced_of(before))


def _fit(folder: Path, out: Path, how: Fitting) -> None:
    """Fit a model on the recordings in a folder, write it and print its report."""
    import pdr_filter as pdr

    with console.one_line_errors(), console.progress("fitting") as show:
        paths = console.recordings_of([folder])
        recordings = [pdr.read(path) for path in paths]
        people = [
            str(recording.subject.id) if recording.subject.id else _person_of(path, folder)
            for path, recording in zip(paths, recordings, strict=True)
        ]
        model = pdr.fit_contexts(
            recordings,
            how.classifier.value,
            head="carrying_mode" if how.carrying_modes else "context",
            people=people,
            name=how.name,
            progress=show,
        )
        path = model.save(out)
    for line in model.report().split("\n"):
        console.print_line(line)
    console.stderr().print(f"written: {escape(str(path))}")


def _person_of(path: Path, folder: Path) -> str:
    """Name of the folder of a person in the folder of all recordings, "unnamed" for a recording beside these."""
    parts = path.resolve().relative_to(folder.resolve()).parts
    return parts[0] if len(parts) > 1 else "unnamed"


def _estimate_transitions(sequences: Path, out: Path) -> None:
    """Write the transitions that recordings in a folder show for the shipped model."""
    from pdr_filter.io.folders import recordings_in
    from pdr_filter.offline.training.train_all import train as train_all

    with console.one_line_errors(), console.progress("training") as show:
        cards = train_all(None, out, lambda what, fraction: show(fraction, what), recordings_in(sequences))
    for card in cards:
        typer.echo(out / card.get("file", f"{card['name']}.npz"))
        for what in ("transition_prob", "exponents"):
            if what in card:
                console.stderr().print(f"{what}: {escape(card[what])}")
