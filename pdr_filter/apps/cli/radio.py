"""Command `pdr-filter radio`, which fits the Wi-Fi map of a building for `track --radio` and `smooth --radio`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Files, Format


def radio_command(
    files: Files,
    out: Annotated[Path, typer.Option(help="Output file NAME.json. NAME.npz is written next to it.")],
    file_format: Format = None,
) -> None:
    """Fit the Wi-Fi map of a building from recordings, or folders of recordings, with Wi-Fi scans and waypoints."""
    import pdr_filter as pdr

    with console.one_line_errors(), console.progress("fitting"):
        found = console.recording_paths(files)
        fitted = pdr.RadioMap.fit(pdr.read(path, file_format) for path in found)
        before = console.existing(out, out.with_suffix(".npz"))
        written = fitted.save(out)
    typer.echo(f"{fitted!r} of {len(fitted.card['walks'])} walks in {len(found)} recordings")
    console.say(f"written: {written}")
    console.say_replaced(before)
