"""The command `pdr-filter`: results on stdout, everything about the work on stderr.

Exit codes: 0 all well; 1 some of several files failed; 2 all of them did, or the options cannot be used; 130 stopped.
"""

from __future__ import annotations

from typing import Annotated

import typer

from pdr_filter.cli.calibrate import calibrate, smooth
from pdr_filter.cli.compare import compare
from pdr_filter.cli.convert import convert
from pdr_filter.cli.info import info
from pdr_filter.cli.live import live
from pdr_filter.cli.options import in_groups
from pdr_filter.cli.plan import plan
from pdr_filter.cli.radio import radio
from pdr_filter.cli.simulate import demo, simulate
from pdr_filter.cli.track import track
from pdr_filter.cli.train import train
from pdr_filter.cli.workbench import app as workbench
from pdr_filter.version import __version__

app = typer.Typer(
    name="pdr-filter",
    help="Pedestrian dead reckoning: a phone's inertial recording in, a track with its uncertainty out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (track, info, convert, plan, train, compare, calibrate, smooth, radio, simulate, demo, live, workbench):
    app.command()(in_groups(command))


def main() -> None:
    """Run the command line."""
    app()


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pdr-filter {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show it.")] = False,
) -> None:
    pass


if __name__ == "__main__":
    main()
