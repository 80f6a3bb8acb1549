"""Command line `pdr-filter`. Results are on stdout; progress, warnings and errors are on stderr.

Exit codes: 0 for success, 1 if some of several files failed, 2 if all files failed or an option is invalid, and 130 if
the user interrupted the command.
"""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperCommand

from pdr_filter.apps.cli.calibrate import calibrate_command, smooth_command
from pdr_filter.apps.cli.compare import compare_command
from pdr_filter.apps.cli.convert import convert_command
from pdr_filter.apps.cli.info import info_command
from pdr_filter.apps.cli.live import live_command
from pdr_filter.apps.cli.map import map_command
from pdr_filter.apps.cli.options import in_groups
from pdr_filter.apps.cli.plan import plan_command
from pdr_filter.apps.cli.radio import radio_command
from pdr_filter.apps.cli.simulate import demo_command, simulate_command
from pdr_filter.apps.cli.track import track_command
from pdr_filter.apps.cli.train import train_command
from pdr_filter.apps.cli.workbench import workbench_command
from pdr_filter.version import __version__


class _TrackCommand(TyperCommand):
    """Command that names the commands with fixes if `--fixes` is given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if any(arg.partition("=")[0] == "--fixes" for arg in args):
            ctx.fail("track takes no --fixes: use pdr-filter smooth, or pdr-filter compare for known positions")
        return super().parse_args(ctx, args)


app = typer.Typer(
    name="pdr-filter",
    help="Pedestrian dead reckoning: estimate a track with its uncertainty from the inertial sensors of a phone.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for name, command in {
    "track": track_command,
    "info": info_command,
    "convert": convert_command,
    "plan": plan_command,
    "train": train_command,
    "compare": compare_command,
    "calibrate": calibrate_command,
    "smooth": smooth_command,
    "radio": radio_command,
    "simulate": simulate_command,
    "demo": demo_command,
    "live": live_command,
    "app": workbench_command,
    "map": map_command,
}.items():
    app.command(name, cls=_TrackCommand if name == "track" else None)(in_groups(command))


def main() -> None:
    """Run the command line."""
    app()


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pdr-filter {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Show the version."),
) -> None:
    pass


if __name__ == "__main__":
    main()
