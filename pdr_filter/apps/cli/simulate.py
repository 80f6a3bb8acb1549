"""Commands `pdr-filter simulate`, which writes a simulated walk as a recording, and `pdr-filter demo`."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Gnss, Height, Loop, Online, Platform

if TYPE_CHECKING:
    from pdr_filter.values.recording import Recording


def simulate_command(
    out: Annotated[Path, typer.Option(help="Output: a zip file, or a folder if the name has no suffix.")],
    seed: int = typer.Option(0, min=0, help="Random seed. The same seed gives the same walk."),
    carrying_mode: Literal["texting", "pocket", "swinging", "calling"] | None = typer.Option(
        None,
        metavar="MODE",
        help="Simulate a walk around a block with the phone in this carrying mode: texting, pocket, swinging or "
        "calling. Default: the demonstration walk.",
    ),
) -> None:
    """Write a simulated walk with exact ground truth as a recording."""
    import pdr_filter as pdr
    from pdr_filter.data.io.files.own_format import write_recording

    with console.one_line_errors():
        walk = pdr.simulate.demo_walk(seed) if carrying_mode is None else _block_walk(carrying_mode, seed)
        before = console.existing(out)
        path = write_recording(walk, out)
    typer.echo(path)
    console.say_replaced(before)


def demo_command(
    file: Path | None = typer.Argument(None, metavar="[FILE]", help="Recording. Default: a simulated walk."),
    out: Path | None = typer.Option(None, help="Folder for the files. Default: a new temporary folder."),
    height_m: Height = None,
    platform: Platform = None,
    gnss: Gnss = None,
    online: Online = False,
    loop: Loop = False,
) -> None:
    """Smooth a walk, draw it and print a summary."""
    with console.one_line_errors():  # for the package of the pictures
        from pdr_filter.apps.cli.demo import Demo, run_demo

    written = set[str]()
    folder = Path(tempfile.mkdtemp(prefix="pdr_filter_demo_")) if out is None else out

    def run(one: Path | None, progress: Callable[[float], None]) -> Demo:
        return run_demo(one, folder, progress, gnss, written, online, loop, height_m, platform)

    with console.one_line_errors():
        if file is None and (height_m or platform):
            raise ValueError("--height and --platform are for a recording, and none is given: add its file")
        files = [] if file is None else console.recording_paths([file])
        if file is None:
            with console.progress("tracking") as show:
                demos, failed = [run(None, show)], dict[Path, str]()
        else:
            demos, failed = console.each_file(files, run)
    printed_notes = set[str]()
    for done in demos:
        done.print(Console(highlight=False), printed_notes)
    console.say_replaced([path for done in demos for path in done.replaced])
    console.exit_if_failed(failed, len(files))


def _block_walk(carrying_mode: str, seed: int) -> Recording:
    """Return a simulated walk around a block of 40 m by 25 m."""
    from pdr_filter import simulate

    legs = [simulate.Leg("stationary", duration_s=5.0), simulate.Leg("walking", distance_m=40.0)]
    for distance_m in (25.0, 40.0, 25.0):
        legs.append(simulate.Leg("walking", distance_m=distance_m, turn_rad=math.pi / 2))
    legs.append(simulate.Leg("stationary", duration_s=5.0))
    return simulate.simulate(legs, carrying_mode=carrying_mode, seed=seed, name=f"simulated_{carrying_mode}")
