"""`pdr-filter calibrate` and `pdr-filter smooth`: what is made of whole recordings afterwards."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pdr_filter.cli import console
from pdr_filter.cli.console import escape
from pdr_filter.cli.options import (
    AnchorsFile,
    Files,
    Folder,
    Format,
    Loop,
    PersonFile,
    PlacementOptions,
    RadioFile,
    RangesFile,
    Scheduler,
    ranges_of,
)
from pdr_filter.values.sanitise import file_name


@dataclass(frozen=True)
class Estimation:
    """What a calibration takes for granted."""

    model: Annotated[
        str | None,
        typer.Option(help="Step length of walking: bounce, eq12, kim, tian or weinberg; else what left-out walks say."),
    ] = None
    loss: Annotated[str, typer.Option(help="How wrong segments lose their weight: gnc, cauchy, huber or none.")] = "gnc"
    prior: Annotated[
        float | None, typer.Option(help="How far steps may be from usual ones, relative: 0.1 if not given.")
    ] = None
    subject: Annotated[
        str | None, typer.Option(help="Name of the person of the recordings that do not say whose they are.")
    ] = None
    each_a_person: Annotated[
        bool, typer.Option("--each-a-person", help="Recordings that do not say whose they are: one person each.")
    ] = False


def calibrate(
    files: Files,
    out: Annotated[Path, typer.Option(help="Where the calibration goes: NAME.json, with NAME.npz beside it.")],
    how: Estimation,
    figure: Annotated[Path | None, typer.Option(help="Also draw it, as PNG, PDF or SVG.")] = None,
    tables: Annotated[
        Path | None, typer.Option(help="Folder for its parameters, covariance and segments, as CSV and LaTeX.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Reduce recordings on N processes.")] = None,
    scheduler: Scheduler = None,
    resume: Annotated[
        Path | None, typer.Option(help="Folder that keeps each reduced recording, to go on after a kill.")
    ] = None,
) -> None:
    """Calibrate step lengths on recordings with segments of known length, or waypoints.

    Recordings that do not say whose they are are taken for one person. With --jobs, --scheduler or --resume recordings
    that cannot be used are left out and named in the report.
    """
    import pdr_filter as pdr
    from pdr_filter.classifiers.model_files import file_pair
    from pdr_filter.report.plot.figures import check_picture

    with console.one_line_errors(), console.progress("calibrating") as show:
        if figure is not None:
            check_picture(figure)
        options: Any = {
            "model": how.model,
            "loss": how.loss,
            "prior_std": how.prior,
            "subject": how.subject,
            "each_a_person": how.each_a_person,
            "progress": show,
        }
        if jobs is None and scheduler is None and resume is None:
            result = pdr.calibrate([pdr.read(file) for file in console.recordings_of(files)], **options)
        else:
            result = pdr.batch.calibrate(files, jobs=jobs or 1, scheduler=scheduler, resume=resume, **options)
        as_tables = {} if tables is None else {tables / name: rows for name, rows in result.tables().items()}
        before = console.there(
            *file_pair(out), figure, *(Path(f"{stem}{suffix}") for stem in as_tables for suffix in (".csv", ".tex"))
        )
        written = [result.save(out)]
        if figure is not None:
            result.plot(figure)
            written.append(figure)
        for stem, rows in as_tables.items():
            written += pdr.evaluate.write_tables(rows, stem, digits=4)
    for line in result.report().split("\n"):
        console.print_line(line)
    for path in written:
        console.stderr().print(f"written: {escape(str(path))}")
    console.say_replaced(before)


def smooth(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    placement: PlacementOptions,
    fixes: Annotated[
        Path | None,
        typer.Option(help="CSV of fixes, time_s,east_m,north_m and perhaps std_m."),
    ] = None,
    fix_std_m: Annotated[float, typer.Option("--fix-std", min=0.01, help="Standard deviation of a fix, m.")] = 1.0,
    loop_closures: Annotated[
        Path | None,
        typer.Option(help="CSV of two times at one place, first_s,second_s and perhaps std_m; with --fixes or alone."),
    ] = None,
    wifi_loops: Annotated[
        bool, typer.Option("--wifi-loops", help="Close loops where the recording's own Wi-Fi is alike.")
    ] = False,
    radio: RadioFile = None,
    ranges: RangesFile = None,
    anchors: AnchorsFile = None,
    person: PersonFile = None,
    loop: Loop = False,
    no_marks: Annotated[
        bool, typer.Option("--no-marks", help="Do not use the files of marks beside the recording.")
    ] = False,
    out: Folder = None,
    file_format: Format = None,
) -> None:
    """Smooth a whole recording against fixes and loop closures, or else its own waypoints or locations, if it has any.

    Times in the files are seconds of the recording. Files that pdr-filter app writes beside a recording are used:
    fixes.csv, loop_closures.csv, person.json and walk.json.
    """
    import pdr_filter as pdr
    from pdr_filter.io.fix_files import fixes_of_file, loop_closures_of_file
    from pdr_filter.maps.marks import Marks, read_marks
    from pdr_filter.offline.smoothing.observations import waypoint_fixes
    from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures

    before: dict[Path, int] = {}
    with console.one_line_errors(), console.progress("smoothing"):
        marked = Marks(file) if no_marks else read_marks(file)
        recording = marked.recording(pdr.read(file, file_format))
        known: dict[str, Any] = marked.arguments()
        closed = known.pop("loop_closures") if loop_closures is None else loop_closures_of_file(loop_closures)
        closed += wifi_loop_closures(recording) if wifi_loops else []
        known_places: list[Any] = known.pop("fixes")
        if fixes is not None:
            known_places = list(fixes_of_file(fixes, fix_std_m))
        where = {name: value for name, value in placement.arguments().items() if value is not None}
        is_marked = bool(known or known_places or closed)
        if radio is not None:
            mapped = pdr.RadioMap.load(radio)
            known_places += [*mapped.fixes(recording), *(mapped.grids(recording) if placement.plan else [])]
        known_places += ranges_of(ranges, anchors, where.get("origin"))
        is_given = is_marked or any(
            (fixes, loop_closures, radio, ranges, wifi_loops, loop, replace(placement, plan=None).given())
        )
        if recording.truth.waypoints is not None and not is_given:
            known_places = waypoint_fixes(recording, fix_std_m)
        options: dict[str, Any] = {**known, **where}
        if person is not None:
            options["person"] = person
        if loop:
            options["loop"] = True
        result = pdr.smooth(recording, known_places, loop_closures=closed, **options)
        track = result.track
        if out is not None:
            name = file_name(track.name)
            before = console.files_of(out, name)
            console.write_track(track, out, name)
            if track.origin is not None:
                console.write_map(track, out / f"{name}.geojson")
    if marked.names:
        console.stderr().print(f"marks used: {escape(', '.join(str(marked.folder / n) for n in marked.names))}")
    console.print_tracks([track])
    typer.echo(
        f"{len(result.observations)} observations, {len(result.rejected)} not used; "
        f"step scale {result.scale:.3f} ± {result.scale_std:.3f}"
    )
    console.say_written(out)
    console.say_replaced(console.replaced_of(before))
