"""`pdr-filter track`: recordings to tracks, one by one or many into one table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from pdr_filter.cli import console
from pdr_filter.cli.index_page import write_index
from pdr_filter.cli.options import (
    AnchorsFile,
    AsJson,
    Files,
    Folder,
    Format,
    Loop,
    Online,
    PersonFile,
    PlacementOptions,
    RadioFile,
    RangesFile,
    Scheduler,
    ranges_of,
)
from pdr_filter.values.sanitise import file_name

if TYPE_CHECKING:
    from pdr_filter.recipes.config import Config
    from pdr_filter.tracking.track import Track
    from pdr_filter.values.recording import Recording


@dataclass(frozen=True, slots=True)
class Method:
    """How a track is made."""

    recipe: Annotated[
        str, typer.Option(help="Name of a recipe, such as default, or module:function for one of yours.")
    ] = "default"
    weighting: Annotated[
        Literal["hc", "wc", "imm"] | None,
        typer.Option(help="How contexts become step lengths; the recipe's own if not given."),
    ] = None
    model: Annotated[Path | None, typer.Option(help="Context model (.npz) for windows with gyroscope.")] = None
    transitions: Annotated[Path | None, typer.Option(help="transitions.json of pdr-filter train.")] = None
    device: Annotated[
        Path | None, typer.Option(help="What is known of the phone: read if it is there, and written anew.")
    ] = None
    person: PersonFile = None
    radio: RadioFile = None
    ranges: RangesFile = None
    anchors: AnchorsFile = None
    online: Online = False
    loop: Loop = False

    def changes(self) -> Callable[[Config], Config]:
        """What model and transitions change of a recipe; what cannot be used is refused before a file is read."""
        from pdr_filter import recipes
        from pdr_filter.classifiers.context_model import load_model
        from pdr_filter.classifiers.transition_files import load_transitions

        recipes.check_name(self.recipe)
        model = None if self.model is None else load_model(self.model)
        learnt = None if self.transitions is None else load_transitions(self.transitions)

        def changed(config: Config) -> Config:
            if model is not None:
                config = recipes.with_context_model(config, model)
            return config if learnt is None else recipes.with_transitions(config, learnt)

        return changed


@dataclass(frozen=True, slots=True)
class Source:
    """What a file does not say of itself."""

    file_format: Format = None
    height_m: Annotated[
        float | None, typer.Option("--height", min=0.5, max=2.6, help="Height of the person in m, if not recorded.")
    ] = None

    def read(self, file: Path) -> Recording:
        """The recording, of a person of that height."""
        import pdr_filter as pdr

        recording = pdr.read(file, self.file_format)
        return recording if self.height_m is None else recording.of_height(self.height_m)


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """Files that are written."""

    out: Folder = None
    export: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND,...", help="Also NAME.KIND: csv, geojson, gpx, kml, parquet or tum, some of them."),
    ] = None
    report: Annotated[bool, typer.Option("--report", help="Also NAME.html: one page with all there is to see.")] = False
    parquet: Annotated[bool, typer.Option("--parquet", help="Also NAME.parquet, or the table of many so.")] = False

    @property
    def table(self) -> Path:
        """Of many recordings."""
        if self.out is None:
            raise ValueError("--jobs and --scheduler make one table: say with --out in which folder")
        return self.out / ("tracks.parquet" if self.parquet else "tracks.csv")

    @property
    def kinds(self) -> list[str]:
        """Of the files that are asked for, each once; ValueError for those that nobody knows."""
        asked = [kind.strip().lower() for part in self.export or () for kind in part.split(",")]
        for kind in asked:
            if kind not in _EXPORTS:
                raise ValueError(f"--export writes {', '.join(_EXPORTS)}, got {kind!r}; give some of them, with commas")
        return list(dict.fromkeys([*asked, *(["parquet"] if self.parquet else [])]))

    def check(self) -> None:
        """ValueError for options that cannot be used, before a file is read."""
        from pdr_filter.io.files.track_writers import pandas_for_parquet

        if "parquet" in self.kinds:
            pandas_for_parquet(self.out or Path())

    def write(self, tracks: Sequence[Track], recording: Recording, name: str) -> list[Path]:
        """The files of one track; those that were there before, which are replaced, are returned.

        Tracks after the first one are in the report alone.
        """
        result = tracks[0]
        folder, kinds = self.out or Path(), self.kinds
        before = console.files_of(folder, name)
        nowhere = [kind for kind in kinds if kind in ("gpx", "kml")]
        if nowhere and result.origin is None:
            raise ValueError(
                f"{result.name}: --export {','.join(nowhere)} needs a place on Earth, and nothing says where this walk "
                "was: give --origin LAT,LON, with --heading DEG for its direction; geojson does without a place"
            )
        if self.out is not None:
            console.write_track(result, folder, name)
            if result.origin is not None:
                kinds = [*kinds, "geojson"]
        for kind in dict.fromkeys(kinds):
            _EXPORTS[kind](result, folder / f"{name}.{kind}", recording)
        if self.report:
            from pdr_filter.report.html import write_report

            write_report(tracks, folder / f"{name}.html", recording)
        return console.replaced_of(before)


# How each kind of file is written.
_EXPORTS: Mapping[str, Callable[[Track, Path, Recording], Path]] = {
    "csv": lambda track, path, _: track.to_csv(path),
    "geojson": lambda track, path, _: console.write_map(track, path),
    "gpx": lambda track, path, recording: track.to_gpx(path, epoch_s=recording.epoch_s or 0.0),
    "kml": lambda track, path, _: track.to_kml(path),
    "parquet": lambda track, path, _: track.to_parquet(path),
    "tum": lambda track, path, _: track.to_tum(path),
}


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """Where many recordings are tracked."""

    jobs: Annotated[int | None, typer.Option(min=1, help="Many recordings at once: one table, which resumes.")] = None
    scheduler: Scheduler = None

    def make_one_table(self) -> bool:
        """Whether it is one table that is asked for."""
        return self.jobs is not None or self.scheduler is not None


def track(
    files: Files,
    method: Method,
    placement: PlacementOptions,
    source: Source,
    output: OutputOptions,
    workers: WorkerOptions,
    as_json: AsJson = False,
) -> None:
    """Track recordings: steps, distance, end point and contexts of each.

    The track is smoothed from the whole recording. The report shows the online track, too, which is what a phone knew
    at each step; with --online all results are that one.

    ± at the end is one standard deviation in the worst direction.

    A folder stands for all recordings in it: with --out each gets its table, picture and report, and index.html lists
    them. --jobs or --scheduler make one table in place of that, tracks.csv in the folder of --out: it grows as
    recordings finish, and a run that was broken off goes on from it. Its tracks are online. Without --out nothing is
    written.
    """
    import pdr_filter as pdr
    from pdr_filter.recipes.step_length_calibration import Calibration, read_person

    with console.one_line_errors():
        if workers.make_one_table():
            _check_one_table(method, placement, output, as_json)
            _track_many(files, method, placement, source, output.table, workers)
            return
        given, files = files, console.recordings_of(files)
        if output.out is not None and files != given:
            output = replace(output, report=True)
        output.check()
        changes = method.changes()
        where = placement.arguments()
        radio = None if method.radio is None else pdr.RadioMap.load(method.radio)
        ranges = ranges_of(method.ranges, method.anchors, where.get("origin"))
        if ranges and len(files) > 1:
            raise ValueError(f"--ranges are of one recording, got {len(files)}: track them one by one")
    written: set[str] = set()
    replaced: list[Path] = []
    listed: dict[str, Track] = {}

    def track_one(file: Path, progress: Callable[[float], None]) -> Track:
        recording = source.read(file)
        config = changes(pdr.recipes.for_recording(method.recipe, recording))
        if radio is not None or ranges:
            config = config.in_world_frame()
        device = method.device if method.device is not None and method.device.exists() else None
        person = read_person(method.person) if method.person is not None and method.person.exists() else None
        heard = [] if radio is None else [*radio.fixes(recording), *(radio.grids(recording) if placement.plan else [])]
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
        if method.device is not None and result.device is not None:
            result.device.save(method.device)
        if method.person is not None and result.person is not None and not isinstance(person, Calibration):
            result.person.save(method.person)
        name = console.unused(file_name(result.name), written)
        replaced.extend(output.write(tracks, recording, name))
        listed[name] = result
        if as_json:
            console.print_json(result.summary())
        return result

    tracks, failed = console.each(files, track_one, as_json)
    console.say_replaced(replaced)
    if tracks and method.person is not None and not method.person.exists():
        console.stderr().print(
            console.escape(f"{method.person} is not there, and not written: no fix says how long the steps are")
        )
    if output.out is not None and files != given and listed:
        with console.one_line_errors():
            write_index(listed, failed, output.out / "index.html")
    if tracks and not as_json:
        console.print_tracks(tracks)
        console.say_written(output.out)
    console.exit_if_failed(failed, len(files))


def _check_one_table(method: Method, placement: PlacementOptions, output: OutputOptions, as_json: bool) -> None:
    """ValueError for what is of one recording, where many make one table."""
    of_one = {
        "--model": method.model,
        "--transitions": method.transitions,
        "--device": method.device,
        **replace(placement, gnss=None).given(),
        "--radio": method.radio,
        "--ranges": method.ranges,
        "--loop": method.loop,
        "--export": output.export,
        "--report": output.report,
        "--json": as_json,
    }
    if given := [name for name, value in of_one.items() if value]:
        raise ValueError(
            f"many recordings make one table, without {', '.join(given)}: leave it out, or give the files "
            "themselves, without --jobs and --scheduler"
        )


def _track_many(
    files: Sequence[Path],
    method: Method,
    placement: PlacementOptions,
    source: Source,
    table: Path,
    workers: WorkerOptions,
) -> None:
    from pdr_filter import batch

    with console.progress("tracking") as show:

        def show_progress(p: batch.Progress) -> None:
            left = "" if p.left_s is None else f", {p.left_s:.0f} s left"
            show(p.fraction, f"{p.n_done}/{p.n}, {p.n_failed} failed{left}")

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
                gnss=placement.gnss,
            )
        except RuntimeError as error:  # a cluster that is gone
            raise ValueError(console.message(error)) from error
        except KeyboardInterrupt:
            console.stderr().print(
                f"stopped: what is done is in {console.escape(str(table))}; the same command goes on"
            )
            raise typer.Exit(console.STOPPED) from None
    failed = {Path(row.path): row.reason for row in rows if row.failed}
    for path, reason in failed.items():
        console.say_error(f"{path}: {reason}")
    typer.echo(f"{len(rows) - len(failed)} recordings tracked, {len(failed)} failed: {table}")
    console.exit_if_failed(failed, len(rows))
