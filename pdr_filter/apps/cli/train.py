"""Command `pdr-filter train`, which fits a context model on labelled recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Classifier


@dataclass(frozen=True)
class Fitting:
    """Options for the context model."""

    classifier: Classifier = typer.Option(
        "rvm",
        metavar="NAME",
        help="Relevance vector machine (rvm), random forest (forest), the mean of relevance vector machines and "
        "extremely randomised trees (blend), or of logistic regression and boosted trees (boosted).",
    )
    carrying_modes: bool = typer.Option(
        False, "--carrying-modes", help="Learn the carrying mode of the phone instead of the context."
    )
    name: str = typer.Option("", help="Name of the model and its files. Default: contexts or carrying.")


def train_command(
    out: Annotated[Path, typer.Option(help="Folder for NAME.npz and NAME.json, or transitions.json.")],
    how: Fitting,
    folder: Path | None = typer.Argument(None, help="Folder of labelled recordings."),
    sequences: Path | None = typer.Option(
        None,
        help="Folder of recordings from which the transitions of the shipped model and "
        "the exponents of its evidence are estimated. Replaces FOLDER.",
    ),
) -> None:
    """Fit a context model on labelled recordings, best of ten persons or more. Contexts may have any names.

    The person of a recording is subject.id in its meta.json, or else the name of a folder: FOLDER/anna/1.zip, or the
    beginning of file names if they are of several people: FOLDER/anna_1.zip. Labels are read from truth_labels.csv. The
    report on stdout is from cross-validation with held-out persons, or with held-out recordings if all are of one
    person.
    """
    if (folder is None) == (sequences is None):
        console.say_error(
            "give either FOLDER, or --sequences FOLDER for transitions only: exactly one of the two is needed"
        )
        raise typer.Exit(console.UNUSABLE)
    before = console.modified_ns(out)
    if folder is not None:
        _fit(folder, out, how)
    elif sequences is not None:
        _estimate_transitions(sequences, out)
    console.say_replaced(console.overwritten(before))


def _fit(folder: Path, out: Path, how: Fitting) -> None:
    """Fit a model on the recordings in a folder, write it and print its report."""
    import pdr_filter as pdr
    from pdr_filter.data.io.folders import notes_on_people, with_person_of_file

    with console.one_line_errors(), console.progress("fitting") as show:
        paths = console.recording_paths([folder])
        recordings = [pdr.read(path) for path in paths]
        folders = [path.resolve().relative_to(folder.resolve()).parts[:-1] for path in paths]
        recordings = [
            recording if parts else with_person_of_file(recording, path)
            for recording, path, parts in zip(recordings, paths, folders, strict=True)
        ]
        people = [
            str(recording.subject.id or (parts[0] if parts else "unnamed"))
            for recording, parts in zip(recordings, folders, strict=True)
        ]
        for note in notes_on_people(recordings):
            console.say(note)
        model = pdr.fit_contexts(
            recordings,
            how.classifier,
            head="carrying_mode" if how.carrying_modes else "context",
            people=people,
            name=how.name,
            progress=show,
        )
        path = model.save(out)
    console.print_lines(model.report())
    console.say(f"written: {path}")


def _estimate_transitions(sequences: Path, out: Path) -> None:
    """Estimate transitions and exponents for the shipped model from recordings, and write them to the folder `out`."""
    from pdr_filter.data.io.formats import read
    from pdr_filter.offline.training import transition_training as training

    with console.one_line_errors(), console.progress("training") as show:
        changing = training.changing_recordings(console.recording_paths([sequences]), read)
        card = training.train_evidence(
            changing, read, out, training.shipped_model_without, lambda what, fraction: show(fraction, what)
        )
    typer.echo(out / "transitions.json")
    for what in ("transition_prob", "exponents"):
        console.say(f"{what}: {card[what]}")
