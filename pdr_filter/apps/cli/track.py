"""Command `pdr-filter track`, which tracks recordings one by one, or many recordings into one table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import typer

from pdr_filter.apps.cli import console, options
from pdr_filter.apps.cli.index_page import write_index

if TYPE_CHECKING:
    from pdr_filter.filter.pedestrian.person import Person
    from pdr_filter.recipes.calibration import Calibration
    from pdr_filter.recipes.config import Config
    from pdr_filter.sensing.device import Device
    from pdr_filter.tracking.track import Track
    from pdr_filter.values.recording import Recording


@dataclass(frozen=True, slots=True)
class Method:
    """Options for recipe, models, persistent files and fixes of a track."""

    recipe: str = typer.Option(
        "default", help="Name of a recipe, such as default, or module:function for a recipe of your own."
    )
    weighting: Literal["hc", "wc", "imm"] | None = typer.Option(
        None,
        help="Weighting of the contexts: highest context (hc), weighted context (wc) or interacting multiple model "
        "(imm). Default: the weighting of the recipe.",
    )
    classifier: options.ClassifierName = None
    model: options.ModelFile = None
    transitions: options.TransitionsFile = None
    device: Path | None = typer.Option(
        None,
        help="File with the gyroscope bias of the phone. It is read if it exists, and updated after a walk that "
        "determines the bias better.",
    )
    person: options.PersonFile = None
    radio: options.RadioFile = None
    ranges: options.RangesFile = None
    anchors: options.AnchorsFile = None
    online: options.Online = False
    loop: options.Loop = False

    def changes(self) -> Callable[[Config], Config]:
        """Return a function that puts the given models into a configuration (`options.context_changes`)."""
        from pdr_filter import recipes

        recipes.check_name(self.recipe)
        return options.context_changes(self.classifier, self.model, self.transitions, self.recipe)

    def known(self) -> tuple[Path | None, Person | Calibration | None]:
        """Return the file of the phone and the person of an earlier walk, or None for a file that does not exist."""
        from pdr_filter.recipes.calibration import read_person

        device = self.device if self.device is not None and self.device.exists() else None
        return device, read_person(self.person) if self.person is not None and self.person.exists() else None

    def save_known(self, track: Track, person: Person | Calibration | None) -> list[str]:
        """Update the files of the phone and of the person after a walk, and return what was learnt of the phone.

        A calibration is not changed.
        """
        from pdr_filter.recipes.calibration import Calibration

        learnt: list[str] = []
        if self.device is not None and track.device is not None:
            learnt.append(_update_device(self.device, track.device))
        if self.person is not None and track.person is not None and not isinstance(person, Calibration):
            track.person.save(self.person)
        return learnt

    def say_unknown_person(self) -> None:
        """Print the reason if the file of the person could not be written."""
        from pdr_filter.filter.pedestrian.person import MAX_SESSION_STD

        if self.person is not None and not self.person.exists():
            console.say(
                f"{self.person} was not written, because the fixes of the walk do not determine the step length to "
                f"{MAX_SESSION_STD:.0%}: track a walk of ten minutes outdoors, or give known positions"
            )


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Options for the files that are written."""

    out: options.Folder = None
    export: list[str] | None = typer.Option(
        None, metavar="KIND,...", help="Also write NAME.KIND for each KIND: csv, geojson, gpx, kml, parquet or tum."
    )
    report: bool = typer.Option(False, "--report", help="Also write NAME.html, a page with map, charts and notes.")
    tiles: options.Tiles = ""
    parquet: bool = typer.Option(
        False,
        "--parquet",
        help="Also write NAME.parquet. With --jobs, --scheduler or --long, write the table as Parquet instead of CSV.",
    )
    long: bool = typer.Option(
        False,
        "--long",
        help="For recordings of days: read, filter and write in parts, in little memory. Writes the online track only, "
        "as NAME.csv.",
    )

    @property
    def table(self) -> Path:
        """Path of the table of many recordings. ValueError without --out."""
        if self.out is None:
            raise ValueError("--jobs and --scheduler write one table, and its folder is not given: add --out FOLDER")
        return self.out / ("tracks.parquet" if self.parquet else "tracks.csv")

    @property
    def kinds(self) -> list[str]:
        """Requested kinds of files, without duplicates. ValueError for an unknown kind."""
        from pdr_filter.data.io.files.track_writers import KINDS

        requested = [kind.strip().lower() for part in self.export or () for kind in part.split(",")]
        for kind in requested:
            if kind not in KINDS:
                raise ValueError(
                    f"--export must be one or several of {', '.join(KINDS)}, separated by commas, got {kind!r}"
                )
        return list(dict.fromkeys([*requested, *(["parquet"] if self.parquet else [])]))

    def check(self) -> None:
        """Raise ValueError for options that cannot be used. Call it before files are read."""
        from pdr_filter.data.io.files.track_writers import pandas_for_parquet

        if self.tiles and not self.report:
            raise ValueError(f"--tiles {self.tiles} is for the page of --report: give --report, or omit --tiles")
        if "parquet" in self.kinds:
            pandas_for_parquet(self.out or Path())

    def write(self, tracks: Sequence[Track], recording: Recording, name: str) -> list[Path]:
        """Write the files of one recording, and return the existing files that were replaced.

        The first track is written to all files. Further tracks appear only in the report. ValueError for GPX or KML of
        a track without a geographic position.
        """
        from pdr_filter.data.io.files.track_writers import GEOGRAPHIC_KINDS, write_by_suffix

        result = tracks[0]
        folder, kinds = self.out or Path(), self.kinds
        before = console.modified_ns(folder, name)
        geographic = [kind for kind in kinds if kind in GEOGRAPHIC_KINDS]
        if geographic and result.origin is None:
            raise ValueError(
                f"{result.name}: --export {','.join(geographic)} needs a geographic position, and no locations were "
                "used: give --origin LAT,LON, with --heading DEG for the first walking direction, or "
                "export geojson, which also stores local metres"
            )
        if self.out is not None:
            console.write_track(result, folder, name)
        for kind in kinds:
            write_by_suffix(result, folder / f"{name}.{kind}", recording.epoch_s)
        if self.report:
            from pdr_filter.apps.report.html import write_report

            write_report(tracks, folder / f"{name}.html", recording, tiles=self.tiles)
        return console.overwritten(before)


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Options for parallel processing of many recordings."""

    jobs: int | None = typer.Option(
        None, min=1, help="Number of processes. Writes one table, from which an interrupted run resumes."
    )
    scheduler: options.Scheduler = None

    def make_one_table(self) -> bool:
        """Return True if the results are written to one table."""
        return self.jobs is not None or self.scheduler is not None


def track_command(
    files: options.Files,
    method: Method,
    georeference: options.GeoreferenceOptions,
    source: options.Source,
    output: OutputOptions,
    workers: WorkerOptions,
    as_json: options.AsJson = False,
) -> None:
    """Track recordings, and show steps, distance, end point and contexts of each.

    The track is smoothed from the whole recording. The report also shows the online track, that is, the estimates that
    were available at each step. With --online, all results are of the online track.

    ± at the end is one standard deviation in the worst direction.

    A folder is replaced by all recordings in it. With --out, table, picture and report of each recording are written,
    and index.html lists them. Without --out, only the files of --export, --report and --parquet are written, to the
    current folder.

    --jobs and --scheduler write one table for all recordings, tracks.csv in the folder of --out, with online tracks.
    The table grows as recordings finish, and an interrupted run resumes from it.

    --long writes the online track of each recording as a table, and needs little memory for a recording of any length.
    """
    import pdr_filter as pdr

    with console.one_line_errors():
        if workers.make_one_table():
            _check_options(method, georeference, output, as_json, is_one_table=True)
            _track_many(files, method, georeference, source, output.table, workers)
            return
        if output.long:
            _check_options(method, georeference, output, as_json, is_one_table=False)
            output.check()
            _track_long(files, method, georeference, source, output)
            return
        given, files = files, console.recording_paths(files)
        if output.out is not None and files != given:
            output = replace(output, report=True)
        output.check()
        changes = method.changes()
        where = georeference.arguments()
        radio = None if method.radio is None else pdr.RadioMap.load(method.radio)
        ranges = options.ranges_of(method.ranges, method.anchors, where)
        if ranges and len(files) > 1:
            raise ValueError(
                f"--ranges are measured in one recording, got {len(files)} recordings: track them one by one"
            )
    written: set[str] = set()
    replaced: list[Path] = []
    listed: dict[str, Track] = {}
    by_phone: list[int | None] = []
    learnt: list[str] = []

    def track_one(file: Path, progress: Callable[[float], None]) -> Track:
        recording = source.read(file)
        device, person = method.known()
        recording = options.with_person_of_calibration(recording, file, person)
        config = changes(pdr.recipes.for_recording(method.recipe, recording))
        if radio is not None or ranges:
            config = config.in_world_frame()
        heard = [] if radio is None else options.wifi_fixes(radio, recording, georeference.plan is not None)
        tracks = console.estimates(
            recording,
            method.online,
            method.loop,
            output.report,
            progress,
            config=config,
            weighting=method.weighting,
            fixes=[*heard, *ranges],
            device=device,
            person=person,
            **where,
        )
        result = tracks[0]
        learnt.extend(method.save_known(result, person))
        name = console.unique_name(result.name, written)
        replaced.extend(output.write(tracks, recording, name))
        listed[name] = result
        by_phone.append(recording.phone_steps)
        if as_json:
            console.print_json({**result.summary(), "name": name})  # two recordings may have one name
        return result

    tracks, failed = console.each_file(files, track_one, as_json)
    console.say_replaced(replaced)
    for text in learnt:
        console.say(text)
    if tracks:
        method.say_unknown_person()
    if output.out is not None and files != given and listed:
        with console.one_line_errors():
            write_index(listed, failed, output.out / "index.html")
    if tracks and not as_json:
        console.print_tracks(tracks, by_phone)
        console.say_written(output.out)
    console.exit_if_failed(failed, len(files))


def _update_device(path: Path, learnt: Device) -> str:
    """Write the phone of a walk to its file unless the file knows the gyroscope bias better, and return what was done.

    The better bias has the smaller determinant of its covariance.
    """
    from pdr_filter.sensing.device import Device

    known = Device.load(path) if path.exists() else None
    if known is not None and np.linalg.det(known.bias_cov_radps2) < np.linalg.det(learnt.bias_cov_radps2):
        return (
            f"{path} was not changed, because its gyroscope bias, {_bias(known)}, is known better than that of this "
            f"walk, {_bias(learnt)}: delete the file to replace it"
        )
    learnt.save(path)
    return f"{path}: gyroscope bias {_bias(learnt)}"


def _bias(device: Device) -> str:
    """Return the bias about the three axes of the sensor, with its standard deviations, as text."""
    std_radps = np.sqrt(np.diag(device.bias_cov_radps2))
    each = zip(device.bias_radps.tolist(), std_radps.tolist(), strict=True)
    return ", ".join(f"{1e3 * bias:z.1f} ± {1e3 * std:.1f}" for bias, std in each) + " mrad/s about x, y, z"


def _check_options(
    method: Method, georeference: options.GeoreferenceOptions, output: OutputOptions, as_json: bool, is_one_table: bool
) -> None:
    """Raise ValueError for options of single, whole recordings with --jobs, --scheduler or --long."""
    given: dict[str, object] = {
        **replace(georeference, gnss=None).given(),
        "--radio": method.radio,
        "--ranges": method.ranges,
        "--loop": method.loop,
        "--export": output.export,
        "--report": output.report,
        "--tiles": output.tiles,
        "--json": as_json,
    }
    mode, writes = "--long", "writes the online track of a recording in parts"
    if is_one_table:
        mode, writes = "--jobs or --scheduler", "write one table of many recordings"
        of_one = {"--classifier": method.classifier, "--model": method.model, "--transitions": method.transitions}
        given |= of_one | {"--device": method.device, "--long": output.long}
    if names := [name for name, value in given.items() if value]:
        raise ValueError(f"{', '.join(names)} cannot be used with {mode}, which {writes}: omit one or the other")


def _track_long(
    files: Sequence[Path],
    method: Method,
    georeference: options.GeoreferenceOptions,
    source: options.Source,
    output: OutputOptions,
) -> None:
    import pdr_filter as pdr
    from pdr_filter.recipes.calibration import with_steps_of

    changes, written, learnt = method.changes(), set[str](), list[str]()

    def track_one(file: Path, progress: Callable[[float], None]) -> pdr.batch.WrittenTrack:
        name = console.unique_name(file.stem, written)
        out = (output.out or Path()) / f"{name}.{'parquet' if output.parquet else 'csv'}"
        console.say_replaced(console.existing(out))
        device, person = method.known()

        def config(head: Recording) -> Config:
            head = head if source.height_m is None else head.of_height(source.height_m)
            found = changes(pdr.recipes.for_recording(method.recipe, head))
            subject = options.with_person_of_calibration(head, file, person).subject
            return found if person is None else with_steps_of(found, person, subject)

        done = pdr.batch.track_file(
            file,
            out,
            config,
            weighting=method.weighting,
            device=device,
            gnss=georeference.gnss,
            file_format=source.file_format,
            progress=progress,
        )
        learnt.extend(method.save_known(done.about, person))
        return done

    tracks, failed = console.each_file(console.recording_paths(files), track_one)
    for done in tracks:
        console.print_line(f"{done.path}: {done.n_steps} steps, {done.distance_m:.1f} m, {done.about.duration_s:.1f} s")
    console.print_notes([done.about for done in tracks])
    for text in learnt:
        console.say(text)
    if tracks:
        method.say_unknown_person()
    console.exit_if_failed(failed, len(failed) + len(tracks))


def _track_many(
    files: Sequence[Path],
    method: Method,
    georeference: options.GeoreferenceOptions,
    source: options.Source,
    table: Path,
    workers: WorkerOptions,
) -> None:
    from pdr_filter.apps import batch

    with console.progress("tracking") as show:
        n_from_table: list[int] = []

        def show_progress(p: batch.Progress) -> None:
            n_from_table.append(p.n_done)
            left = "" if p.left_s is None else f", {p.left_s:.0f} s left"
            show(p.fraction, f"{p.n_done}/{p.n}, {p.n_failed} failed{left}")

        table_s = table.stat().st_mtime if table.exists() else math.inf
        try:
            rows = batch.track(
                files,
                method.recipe,
                method.weighting,
                out=table,
                jobs=workers.jobs or 1,
                scheduler=workers.scheduler,
                progress=show_progress,
                file_format=source.file_format,
                height_m=source.height_m,
                calibration=method.person,
                gnss=georeference.gnss,
            )
        except RuntimeError as error:  # the cluster does not respond
            raise ValueError(console.message(error)) from error
        except KeyboardInterrupt:
            console.say(f"stopped: finished recordings are in {table}; run the same command again to resume")
            raise typer.Exit(console.STOPPED) from None
    failed = {Path(row.path): row.reason for row in rows if row.failed}
    for path, reason in failed.items():
        console.say_error(f"{path}: {reason}")
    known = f" ({n_from_table[0]} of {len(rows)} rows are from an earlier run)" if n_from_table[0] else ""
    typer.echo(f"{len(rows) - len(failed)} recordings tracked, {len(failed)} failed: {table}{known}")
    changed = [row.path for row in rows if _changed_s(Path(row.path)) > table_s]
    if n_from_table[0] and changed:
        console.say(
            f"{changed[0]}{f' and {len(changed) - 1} more' if changed[1:] else ''} may have been replaced since that "
            "run: delete the rows of replaced files, and run the command again"
        )
    console.exit_if_failed(failed, len(rows))


def _changed_s(path: Path) -> float:
    """Return the time of the last change of a file, or of the files in a folder, in s; -inf if there is none."""
    files = [path, *path.iterdir()] if path.is_dir() else [path]
    return max((file.stat().st_mtime for file in files if file.exists()), default=-math.inf)
