"""Commands `pdr-filter calibrate` and `pdr-filter smooth`, which process whole recordings offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from pdr_filter.apps.cli import console, options
from pdr_filter.values.sanitise import file_name

if TYPE_CHECKING:
    from pdr_filter.recipes.config import Config
    from pdr_filter.values import Table
    from pdr_filter.values.recording import Recording


@dataclass(frozen=True)
class Estimation:
    """Options of the calibration: recipe, model, loss, prior and persons."""

    recipe: str = typer.Option(
        "default",
        help="Recipe that detects the steps, and whose step-length models are fitted: a name, or module:function.",
    )
    model: str | None = typer.Option(
        None,
        help="Step-length model of walking: bounce, eq12, kim, tian, weinberg, chen, frequency, peak, range, "
        "static or zhou. Default: of the first five, the model with the smallest error on held-out walks.",
    )
    loss: str = typer.Option("gnc", help="Robust loss against wrong segments: gnc, cauchy, huber or none.")
    prior: float | None = typer.Option(
        None, help="Relative standard deviation of the prior of step lengths. Default: 0.1."
    )
    subject: str | None = typer.Option(None, help="Name of the person in recordings that do not name their person.")
    each_a_person: bool = typer.Option(
        False, "--each-a-person", help="Take each recording that does not name its person as another person."
    )


def calibrate_command(
    files: options.Files,
    out: Annotated[Path, typer.Option(help="Output file NAME.json. NAME.npz is written next to it.")],
    how: Estimation,
    figure: Path | None = typer.Option(None, help="Also draw the calibration, as PNG, PDF or SVG."),
    tables: Path | None = typer.Option(
        None, help="Folder for tables of parameters, covariance and segments, as CSV and LaTeX."
    ),
    jobs: int | None = typer.Option(None, min=1, help="Number of processes that process recordings in parallel."),
    scheduler: options.Scheduler = None,
    resume: Path | None = typer.Option(
        None, help="Folder for intermediate results, from which an interrupted run resumes."
    ),
    distance: float | None = typer.Option(
        None, help="Length in m of the path walked in each recording, if it is known."
    ),
    steps: int | None = typer.Option(
        None, help="Counted number of steps in each recording, to check the detected steps."
    ),
    smooth: bool = typer.Option(
        False,
        "--smooth",
        help="Smooth all walks together with the step lengths: locations and marks calibrate them, too.",
    ),
) -> None:
    """Calibrate step lengths on recordings with segments of known length or with waypoints.

    For recordings of walks whose length you know, give --distance, and --steps if you counted them.

    With --smooth, the marks of a recording, which pdr-filter app writes, are used in place of its truth.

    All recordings that do not name their person are assumed to be of one person, unless their file names begin with
    several people (anna_1.zip, ben_1.zip, anna_2.zip). With --jobs, --scheduler or --resume,
    recordings that cannot be used are skipped and listed in the report.
    """
    import pdr_filter as pdr
    from pdr_filter.apps.maps.marks import read_marks
    from pdr_filter.apps.report.plot.figures import check_picture
    from pdr_filter.classifiers.model_files import file_pair
    from pdr_filter.data.io.folders import notes_on_people, with_person_of_file

    with console.one_line_errors(), console.progress("calibrating") as show:
        if figure is not None:
            check_picture(figure)
        arguments: Any = {
            "model": how.model,
            "loss": how.loss,
            "prior_std": how.prior,
            "subject": how.subject,
            "each_a_person": how.each_a_person,
            "progress": show,
        }
        pdr.recipes.check_name(how.recipe)
        if steps is not None and distance is None:
            raise ValueError(f"--steps {steps} needs the length of the walk: give --distance in m, too")
        if jobs is None and scheduler is None and resume is None:
            paths = console.recording_paths(files)
            recordings = [pdr.read(file) for file in paths]
            if how.subject is None and not how.each_a_person:
                recordings = [with_person_of_file(r, file) for r, file in zip(recordings, paths, strict=True)]
                for note in notes_on_people(recordings):
                    console.say(note)
            if smooth:
                marked = [read_marks(file) for file in paths]
                recordings = [m.recording(recording) for m, recording in zip(marked, recordings, strict=True)]
                arguments["smooth"] = True
                arguments["fixes"] = [m.arguments(r)["fixes"] for m, r in zip(marked, recordings, strict=True)]
                arguments["loop_closures"] = [m.all_closures(r) for m, r in zip(marked, recordings, strict=True)]
            if distance is not None:
                recordings = [recording.of_distance(distance, steps) for recording in recordings]
            config = None if how.recipe == "default" else _config_of_all(how.recipe, recordings)
            result = pdr.calibrate(recordings, config=config, **arguments)
        elif distance is not None or smooth or how.recipe != "default":
            raise ValueError(
                "--distance, --smooth and --recipe are for one process: leave out --jobs, --scheduler and --resume"
            )
        else:
            result = pdr.batch.calibrate(files, jobs=jobs or 1, scheduler=scheduler, resume=resume, **arguments)
        n_rejected = len(result.distrusted)
        if n_rejected == len(result.segments):
            console.print_lines(result.report())
            console.say_error(
                "nothing was written, because every segment contradicts the detected steps: see the report"
            )
            raise typer.Exit(1)
        as_tables = {} if tables is None else {tables / name: rows for name, rows in result.tables().items()}
        before = console.existing(
            *file_pair(out), figure, *(Path(f"{stem}{suffix}") for stem in as_tables for suffix in (".csv", ".tex"))
        )
        written = [result.save(out)]
        if figure is not None:
            result.plot(figure)
            written.append(figure)
        for stem, rows in as_tables.items():
            # standard deviations have four decimals in LaTeX, so that covariances need eight
            digits, caption = 8 if stem.name == "covariance" else 4, f"{stem.name.capitalize()} of the calibration."
            written += pdr.evaluate.write_tables(rows, stem, digits, caption, _fitted(rows, result.contexts))
    console.print_lines(result.report())
    for path in written:
        console.say(f"written: {path}")
    console.say_replaced(before)


def _config_of_all(recipe: str, recordings: Sequence[Recording]) -> Config:
    """Return the configuration of a recipe for all recordings.

    A calibration computes the step lengths of each person with the own height. ValueError if the configurations differ
    otherwise, because some sensors were worn on the foot.
    """
    from pdr_filter.recipes import for_recording

    configs = [for_recording(recipe, recording) for recording in recordings]
    for config, recording in zip(configs, recordings, strict=True):
        if config.on_foot != configs[0].on_foot:
            raise ValueError(
                f"of {recordings[0].name} and {recording.name}, one has the sensor on the foot, for which recipe "
                f"{recipe!r} has other steps: calibrate them separately"
            )
    return configs[0]


def _fitted(rows: Table, contexts: Sequence[str]) -> Table:
    """Return the rows of calibrated contexts of a table of parameters or covariances, and all rows of another table."""
    import numpy as np

    columns = [] if "parameter" not in (rows.dtype.names or ()) else ["context", "other_context"]
    is_fitted = [np.isin(rows[name], contexts) for name in columns if name in (rows.dtype.names or ())]
    return cast("Table", rows[np.all(is_fitted, axis=0)]) if is_fitted else rows


def smooth_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    georeference: options.GeoreferenceOptions,
    fixes: options.FixesFile = None,
    fix_std_m: float = typer.Option(
        1.0, "--fix-std", min=0.01, help="Standard deviation in m of waypoints, and of fixes without std_m."
    ),
    loop_closures: Path | None = typer.Option(
        None,
        help="CSV of pairs of times at which the pedestrian was at the same place, with columns first_s, second_s "
        "and optionally std_m. Can be combined with --fixes.",
    ),
    wifi_loops: bool = typer.Option(
        False, "--wifi-loops", help="Detect loop closures from similar Wi-Fi scans of the recording."
    ),
    radio: options.RadioFile = None,
    ranges: options.RangesFile = None,
    anchors: options.AnchorsFile = None,
    person: options.PersonFile = None,
    height_m: options.Height = None,
    loop: options.Loop = False,
    truth_as_fixes: bool = typer.Option(
        False,
        "--truth-as-fixes",
        help="Use the waypoints of the recording, its ground truth, as fixes. The track is then no longer an "
        "estimate that they can evaluate, and a note says so.",
    ),
    no_marks: bool = typer.Option(False, "--no-marks", help="Do not use the marks of the recording."),
    out: options.Folder = None,
    file_format: options.Format = None,
) -> None:
    """Smooth a whole recording with fixes and loop closures.

    Without any, use the recording's own locations. The marks of the recording, which pdr-filter app writes, are used:
    fixes.csv, loop_closures.csv, person.json and walk.json. They are in the folder walk.zip.marks for the file
    walk.zip, and inside a recording that is a folder.

    Times in the CSV files are seconds on the clock of the recording.
    """
    import pdr_filter as pdr
    from pdr_filter.apps.maps.marks import Marks, read_marks, unused_fixes
    from pdr_filter.data.io.fix_files import loop_closures_of_file
    from pdr_filter.offline.smoothing.observations import waypoint_fixes
    from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
    from pdr_filter.recipes.calibration import read_person

    before: dict[Path, int] = {}
    with console.one_line_errors(), console.progress("smoothing"):
        marked = Marks(file) if no_marks else read_marks(file, options.origin_deg(georeference.origin))
        if not no_marks and fixes is None:
            console.say_unused_fixes(unused_fixes([file]), ", or from the file of --fixes")
        recording = marked.recording(pdr.read(file, file_format))
        if height_m is not None:
            recording = recording.of_height(height_m)
        is_given = any(
            (fixes, loop_closures, radio, ranges, wifi_loops, loop, replace(georeference, plan=None).given())
        )
        arguments = marked.arguments(recording, not is_given)
        where = georeference.arguments(arguments.get("origin", marked.origin))
        arguments |= {name: value for name, value in where.items() if value is not None}
        closed = arguments.pop("loop_closures")
        if loop_closures is not None:
            closed = loop_closures_of_file(loop_closures)
        closed += wifi_loop_closures(recording) if wifi_loops else []
        position_fixes: list[Any] = arguments.pop("fixes")
        if fixes is not None:
            position_fixes = options.fixes_of(fixes, fix_std_m, recording, arguments)
        if truth_as_fixes:
            position_fixes += waypoint_fixes(recording, fix_std_m)
        if radio is not None:
            position_fixes += options.wifi_fixes(pdr.RadioMap.load(radio), recording, georeference.plan is not None)
        position_fixes += options.ranges_of(ranges, anchors, arguments)
        if person is not None:
            arguments["person"] = known = read_person(person)
            recording = options.with_person_of_calibration(recording, file, known)
        if loop:
            arguments["loop"] = True
        result = pdr.smooth(recording, fixes=position_fixes, loop_closures=closed, **arguments)
        track = result.track
        if out is not None:
            name = file_name(track.name)
            before = console.modified_ns(out, name)
            console.write_track(track, out, name)
    if marked.names:
        console.say(f"marks used: {', '.join(str(marked.folder / n) for n in marked.names)}")
    console.print_tracks([track], [recording.phone_steps])
    typer.echo(
        f"{len(result.observations)} observations, {len(result.rejected)} not used; "
        f"step scale {result.scale:.3f} ± {result.scale_std:.3f}"
    )
    console.say_written(out)
    console.say_replaced(console.overwritten(before))
