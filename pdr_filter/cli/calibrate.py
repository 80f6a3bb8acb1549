"""`pdr-filter calibrate` and `pdr-filter smooth`: what is made of whole recordings afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from pdr_filter.cli import console
from pdr_filter.cli.options import CalibrationFile, Files, Folder, Format, Scheduler


def calibrate(
    files: Files,
    out: Annotated[Path, typer.Option(help="Where the calibration goes: NAME.json, with NAME.npz beside it.")],
    figure: Annotated[Path | None, typer.Option(help="Also draw it, as PNG, PDF or SVG.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Reduce recordings, of folders too, on N processes.")] = None,
    scheduler: Scheduler = None,
) -> None:
    """Calibrate step lengths on recordings with segments of known length, or waypoints.

    With --jobs or --scheduler recordings that cannot be used are left out and named in the report.
    """
    import pdr_filter as pdr

    with console.one_line_errors(), console.progress("calibrating") as show:
        if jobs is None and scheduler is None:
            result = pdr.calibrate([pdr.read(file) for file in files], progress=show)
        else:
            result = pdr.batch.calibrate(files, jobs=jobs or 1, scheduler=scheduler, progress=show)
        written = [result.save(out)]
        if figure is not None:
            result.plot(figure)
            written.append(figure)
    typer.echo(result.report())
    for path in written:
        console.stderr().print(f"written: {escape(str(path))}")


def smooth(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording with waypoints.")],
    fix_std_m: Annotated[float, typer.Option("--fix-std", min=0.01, help="Standard deviation of a waypoint, m.")] = 1.0,
    calibration: CalibrationFile = None,
    out: Folder = None,
    file_format: Format = None,
) -> None:
    """Smooth a whole recording against its waypoints."""
    import pdr_filter as pdr
    from pdr_filter.calibration import load_calibration
    from pdr_filter.offline.smoothing.observations import waypoint_fixes

    with console.one_line_errors(), console.progress("smoothing"):
        recording = pdr.read(file, file_format)
        known = None if calibration is None else load_calibration(calibration)
        result = pdr.smooth(recording, waypoint_fixes(recording, fix_std_m), calibration=known)
        if out is not None:
            console.write_track(result.track, out, result.track.name)
    console.print_tracks([result.track])
    typer.echo(
        f"{len(result.observations)} observations, {len(result.rejected)} not used; "
        f"step scale {result.scale:.3f} +- {result.scale_std:.3f}"
    )
    console.say_written(out)
