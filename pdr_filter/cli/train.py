"""`pdr-filter train`: context models from labelled recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.cli import console
from pdr_filter.cli.console import escape


def train(
    out: Annotated[Path, typer.Option(help="Folder for NAME.npz, NAME.json and transitions.json.")],
    data_dir: Annotated[
        Path | None, typer.Argument(help="Folder with one folder of recordings for each data set.")
    ] = None,
    sequences: Annotated[
        Path | None, typer.Option(help="Folder of labelled recordings in which people change what they do.")
    ] = None,
) -> None:
    """Train the context models on labelled recordings, and estimate transitions and tempering from those that change.

    Without DATA_DIR only transitions and tempering, for the shipped models.
    """
    from pdr_filter.io.folders import recordings_in
    from pdr_filter.offline.training.train_all import train as train_models

    with console.one_line_errors(), console.progress("training") as show:
        found = None if sequences is None else recordings_in(sequences)
        before = {path: path.stat().st_mtime_ns for path in out.glob("*") if path.is_file()}
        cards = train_models(data_dir, out, lambda what, fraction: show(fraction, what), found)
    for card in cards:
        typer.echo(out / card.get("file", f"{card['name']}.npz"))
        for what in ("transition_prob", "exponents"):
            if what in card:
                console.stderr().print(f"{what}: {escape(card[what])}")
    console.say_replaced(console.replaced_of(before))
