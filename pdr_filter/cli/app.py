"""The command `pdr-filter`: results on stdout, everything about the work on stderr.

Exit codes: 0 all well; 1 some of several files failed; 2 the input or the options cannot be used.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pdr_filter import __version__

if TYPE_CHECKING:
    from pdr_filter.classifiers.model import ContextModel
    from pdr_filter.io.recording import Recording
    from pdr_filter.tracks import Track

SOME_FAILED, UNUSABLE = 1, 2

app = typer.Typer(
    name="pdr-filter",
    help="Pedestrian dead reckoning: a phone's inertial recording in, a track with its uncertainty out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

T = TypeVar("T")


class Weighting(StrEnum):
    """How context probabilities become step lengths."""

    HC = "hc"
    WC = "wc"
    IMM = "imm"


class CarryingMode(StrEnum):
    """Where the simulated phone is."""

    TEXTING = "texting"
    POCKET = "pocket"
    SWINGING = "swinging"
    CALLING = "calling"


Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings: zip files or folders.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Format of the files, if it is not to be found by their content.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line for each file, nothing else on stdout.")]


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


@app.command()
def track(
    files: Files,
    recipe: Annotated[str, typer.Option(help="Name of a recipe, such as default or martinelli2018.")] = "default",
    weighting: Annotated[
        Weighting | None, typer.Option(help="How contexts become step lengths; the recipe's own if not given.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Context model (.npz) for windows with gyroscope.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Of pdr-filter calibrate: this person's steps.")] = None,
    transitions: Annotated[Path | None, typer.Option(help="transitions.json of pdr-filter train.")] = None,
    file_format: Format = None,
    height_m: Annotated[
        float | None, typer.Option("--height", min=0.5, max=2.6, help="Height of the person in m, if not recorded.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for NAME.csv and NAME.png.")] = None,
    origin: Annotated[str | None, typer.Option(metavar="LAT,LON", help="Start in degrees: also NAME.geojson.")] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Also NAME.html: one page with all there is to see.")
    ] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Also NAME.parquet, or the table of many so.")] = False,
    jobs: Annotated[int | None, typer.Option(min=1, help="Many recordings at once: one table, which resumes.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="The same on a Dask cluster, such as tcp://host:8786.")] = None,
    as_json: AsJson = False,
) -> None:
    """Track recordings: steps, distance, end point and contexts of each.

    A folder of recordings, --jobs or --scheduler make one table, tracks.csv in the folder of --out: it grows as
    recordings finish, and a run that was broken off goes on from it.
    """
    import pdr_filter as pdr
    from pdr_filter.batch.run import recordings_in
    from pdr_filter.classifiers.transitions import load_transitions
    from pdr_filter.io.writers import pandas_for_parquet

    with _one_line_errors():
        if jobs is not None or scheduler is not None or any(f.is_dir() and recordings_in(f) != [f] for f in files):
            if model is not None or transitions is not None or origin is not None or report or as_json:
                raise ValueError(
                    "many recordings make one table: leave out --model, --transitions, --origin, --report and --json"
                )
            table = (out or Path()) / ("tracks.parquet" if parquet else "tracks.csv")
            options = {"file_format": file_format, "height_m": height_m, "calibration": calibration}
            _track_many(files, recipe, weighting.value if weighting else None, table, jobs or 1, scheduler, options)
            return
        start = _origin(origin)
        if start is not None and out is None:
            raise ValueError("--origin places the GeoJSON file, so it needs --out DIR")
        if parquet:
            if out is None:
                raise ValueError("--parquet writes a file for each track, so it needs --out DIR")
            pandas_for_parquet(out)
        context_model = _checked_options(recipe, model)
        learnt = None if transitions is None else load_transitions(transitions)
    written: set[str] = set()

    def track_one(file: Path, progress: Callable[[float], None]) -> Track:
        recording = pdr.read(file, file_format)
        if height_m is not None:
            recording = recording.of_height(height_m)
        config = pdr.recipes.for_recording(recipe, recording)
        if context_model is not None:
            config = pdr.recipes.with_context_model(config, context_model)
        if learnt is not None:
            config = pdr.recipes.with_transitions(config, learnt)
        result = pdr.track(
            recording, config, weighting.value if weighting else None, progress=progress, calibration=calibration
        )
        name = _unused(result.name, written)
        if out is not None:
            _write_files(result, out, name, start, parquet)
        if report:
            from pdr_filter.report.html import write_report

            write_report(result, (out or Path()) / f"{name}.html", recording)
        if as_json:
            _print_json(result.summary())
            _print_notes(result, _stderr())
        return result

    def tell_failure(name: str, message: str) -> None:
        if as_json:
            _print_json({"name": name, "error": message})

    tracks, failed = _each(files, track_one, tell_failure)
    if tracks and not as_json:
        _print_tracks(tracks)
        if out is not None:
            _stderr().print(f"files written to {escape(str(out))}", highlight=False)
    _exit(failed, len(files))


def _track_many(
    files: Sequence[Path],
    recipe: str,
    weighting: str | None,
    table: Path,
    jobs: int,
    scheduler: str | None,
    options: dict[str, Any],
) -> None:
    from pdr_filter.batch import run as batch

    with _progress("tracking") as show:

        def tell(p: batch.Progress) -> None:
            left = "" if p.left_s is None else f", {p.left_s:.0f} s left"
            show(p.fraction, f"{p.n_done}/{p.n}, {p.n_failed} failed{left}")

        try:
            rows = batch.track(
                files, recipe, weighting, out=table, jobs=jobs, scheduler=scheduler, progress=tell, **options
            )
        except RuntimeError as error:  # a cluster that is gone
            raise ValueError(_message(error)) from error
    failed = {Path(row.path): row.reason for row in rows if row.status == "failed"}
    for path, reason in failed.items():
        _say_error(f"{path}: {reason}")
    typer.echo(f"{len(rows) - len(failed)} recordings tracked, {len(failed)} failed: {table}")
    _exit(failed, len(rows))


@app.command()
def info(files: Files, file_format: Format = None, as_json: AsJson = False) -> None:
    """Describe recordings: sensors, rates, gaps, plausibility of units, truth."""
    import pdr_filter as pdr
    from pdr_filter.io.describe import Description, describe

    def describe_one(file: Path, progress: Callable[[float], None]) -> Description:
        description = describe(pdr.read(file, file_format))
        if as_json:
            _print_json(description.as_dict())
        return description

    def tell_failure(name: str, message: str) -> None:
        if as_json:
            _print_json({"name": name, "error": message})

    descriptions, failed = _each(files, describe_one, tell_failure)
    if not as_json:
        for description in descriptions:
            _print_description(description.as_dict())
    _exit(failed, len(files))


@app.command()
def train(
    data_dir: Annotated[
        Path | None, typer.Argument(help="Folder with one folder of recordings for each data set.")
    ] = None,
    sequences: Annotated[
        Path | None, typer.Option(help="Folder of labelled recordings in which people change what they do.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for NAME.npz, NAME.json and transitions.json.")] = Path("models"),
) -> None:
    """Train the context models on labelled recordings, and estimate transitions and tempering from those that change.

    Without DATA_DIR only transitions and tempering, for the shipped models.
    """
    from pdr_filter.batch.run import recordings_in
    from pdr_filter.training.run import train as train_models

    with _one_line_errors(), _progress("training") as show:
        found = None if sequences is None else recordings_in(sequences)
        cards = train_models(data_dir, out, lambda what, fraction: show(fraction, what), found)
    for card in cards:
        typer.echo(out / card.get("file", f"{card['name']}.npz"))
        for what in ("transition_prob", "exponents"):
            if what in card:
                _stderr().print(f"{what}: {escape(card[what])}", highlight=False, soft_wrap=True)


@app.command()
def compare(files: Files) -> None:
    """Compare the weightings HC, WC and IMM on recordings."""
    import pdr_filter as pdr

    def compare_one(file: Path, progress: Callable[[float], None]) -> list[Track]:
        recording = pdr.read(file)
        tracks: list[Track] = []
        for i, weighting in enumerate(Weighting):
            tracks.append(
                pdr.track(recording, None, weighting.value, progress=lambda part, i=i: progress((i + part) / 3))
            )
        return tracks

    compared, failed = _each(files, compare_one)
    if compared:
        _print_comparison(compared)
    _exit(failed, len(files))


@app.command()
def calibrate(
    files: Files,
    out: Annotated[Path, typer.Option(help="Where the calibration goes: NAME.json, with NAME.npz beside it.")],
    figure: Annotated[Path | None, typer.Option(help="Also draw it, as PNG, PDF or SVG.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Reduce recordings, of folders too, on N processes.")] = None,
    scheduler: Annotated[str | None, typer.Option(help="The same on a Dask cluster, such as tcp://host:8786.")] = None,
) -> None:
    """Calibrate step lengths on recordings with segments of known length, or waypoints.

    With --jobs or --scheduler recordings that cannot be used are left out and named in the report.
    """
    import pdr_filter as pdr

    with _one_line_errors(), _progress("calibrating") as show:
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
        _stderr().print(f"written: {escape(str(path))}", highlight=False)


@app.command()
def smooth(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording with waypoints.")],
    fix_std_m: Annotated[float, typer.Option("--fix-std", min=0.01, help="Deviation of a waypoint, m.")] = 1.0,
    calibration: Annotated[Path | None, typer.Option(help="Of pdr-filter calibrate: this person's steps.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for NAME.csv and NAME.png.")] = None,
    file_format: Format = None,
) -> None:
    """Smooth a whole recording against its waypoints."""
    import pdr_filter as pdr
    from pdr_filter.calibration import load_calibration
    from pdr_filter.offline.smoothing.smoother import waypoint_fixes

    with _one_line_errors(), _progress("smoothing"):
        recording = pdr.read(file, file_format)
        known = None if calibration is None else load_calibration(calibration)
        result = pdr.smooth(recording, waypoint_fixes(recording, fix_std_m), calibration=known)
        if out is not None:
            _write_files(result.track, out, result.track.name)
    _print_tracks([result.track])
    rejected = len(result.rejected)
    typer.echo(
        f"{len(result.observations)} observations, {rejected} not used; "
        f"step scale {result.scale:.3f} +- {result.scale_std:.3f}"
    )
    if out is not None:
        _stderr().print(f"files written to {escape(str(out))}", highlight=False)


@app.command()
def simulate(
    out: Annotated[Path, typer.Option(help="Zip file, or a folder if it has no suffix.")] = Path("simulated_walk.zip"),
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same walk.")] = 0,
    carrying_mode: Annotated[
        CarryingMode | None,
        typer.Option(help="Walk round a block with the phone there; without it, the demonstration walk."),
    ] = None,
) -> None:
    """Write a simulated walk with exact truth as a recording."""
    import pdr_filter as pdr
    from pdr_filter.io.own_format import write_recording

    with _one_line_errors():
        walk = pdr.simulate.demo_walk(seed) if carrying_mode is None else _block_walk(carrying_mode.value, seed)
        path = write_recording(walk, out)
    typer.echo(path)


@app.command()
def demo(
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="A recording; else a simulated walk.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("demo_output"),
) -> None:
    """Track a walk, draw it and say what came out."""
    from pdr_filter.cli.demo import run_demo

    with _one_line_errors(), _progress("tracking") as show:
        result = run_demo(file, out, show)
    result.print(Console(highlight=False))


# --- What the commands share -----------------------------------------------------------------------------------------


def _stderr() -> Console:
    """Console of the messages; made when used, so that a redirected stderr is respected."""
    return Console(stderr=True)


def _message(error: Exception) -> str:
    # The hint of a mapping keeps its lines: they are a file to copy.
    lines = [line.rstrip() for line in str(error).splitlines() if line.strip()]
    return "\n".join(lines) or type(error).__name__


def _say_error(message: str) -> None:
    _stderr().print(f"[bold red]error:[/] {escape(message)}", highlight=False, soft_wrap=True)


@contextmanager
def _one_line_errors() -> Generator[None]:
    """What cannot be used ends the command with one line that says why."""
    try:
        yield
    except (ValueError, OSError) as error:
        _say_error(_message(error))
        raise typer.Exit(UNUSABLE) from None


@contextmanager
def _progress(what: str) -> Generator[Callable[..., None]]:
    """A bar on stderr while it runs, if somebody watches; yields a function of the fraction done (and of what)."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = _stderr()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(escape(what), total=1.0)

        def show(fraction: float, description: str | None = None) -> None:
            bar.update(task, completed=fraction, description=escape(description or what))

        yield show


def _each(
    files: Sequence[Path],
    work: Callable[[Path, Callable[[float], None]], T],
    tell_failure: Callable[[str, str], None] = lambda _name, _message: None,
) -> tuple[list[T], dict[Path, str]]:
    """Results of the files that can be used, and why the others cannot."""
    results: list[T] = []
    failed: dict[Path, str] = {}
    with _progress("reading") as show:
        for i, file in enumerate(files):

            def show_part(fraction: float, i: int = i, file: Path = file) -> None:
                show((i + fraction) / len(files), file.name)

            show_part(0.0)
            try:
                results.append(work(file, show_part))
            except (ValueError, OSError) as error:
                failed[file] = _message(error)
                tell_failure(file.stem, failed[file])
    for message in failed.values():
        _say_error(message)
    return results, failed


def _exit(failed: dict[Path, str], n_files: int) -> None:
    if not failed:
        return
    if n_files == 1:
        raise typer.Exit(UNUSABLE)
    names = escape(", ".join(map(str, failed)))
    _stderr().print(f"{len(failed)} of {n_files} files failed: {names}", highlight=False, soft_wrap=True)
    raise typer.Exit(SOME_FAILED)


def _print_json(value: dict[str, Any]) -> None:
    typer.echo(json.dumps(value, allow_nan=False))


def _checked_options(recipe: str, model: Path | None) -> ContextModel | None:
    """The context model if one is given; ValueError if there is no such recipe, before any file is read."""
    from pdr_filter import recipes
    from pdr_filter.classifiers.model import load_model

    if recipe not in recipes.RECIPES:
        raise ValueError(f"no recipe {recipe!r}; there are {', '.join(sorted(recipes.RECIPES))}")
    return None if model is None else load_model(model)


def _origin(text: str | None) -> tuple[float, float] | None:
    """Latitude and longitude in degrees from LAT,LON."""
    if text is None:
        return None
    try:
        lat_deg, lon_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--origin must be LAT,LON in degrees, such as 51.4779,-0.0015, got {text!r}") from None
    if not (-90 <= lat_deg <= 90 and -180 <= lon_deg <= 180):
        raise ValueError(f"--origin must be LAT,LON, -90..90 and -180..180 degrees, got {text!r}; exchanged?")
    return lat_deg, lon_deg


def _unused(name: str, written: set[str]) -> str:
    """The name for the files of a track: a second recording of the same name gets a number."""
    unused = name
    while unused in written:
        unused = f"{name}_{len(written) + 1}"
    written.add(unused)
    return unused


def _write_files(
    result: Track, out: Path, name: str, start: tuple[float, float] | None = None, parquet: bool = False
) -> None:
    """Write the files of one track."""
    result.to_csv(out / f"{name}.csv")
    result.plot(out / f"{name}.png")
    if start is not None:
        result.to_geojson(out / f"{name}.geojson", start)
    if parquet:
        result.to_parquet(out / f"{name}.parquet")


def _block_walk(carrying_mode: str, seed: int) -> Recording:
    """A walk round a block of 40 m by 25 m."""
    import math

    import pdr_filter as pdr
    from pdr_filter.simulate import Leg

    right = math.pi / 2
    legs = [Leg("stationary", duration_s=5.0), Leg("walking", distance_m=40.0)]
    legs += [Leg("walking", distance_m=distance_m, turn_rad=right) for distance_m in (25.0, 40.0, 25.0)]
    legs += [Leg("stationary", duration_s=5.0)]
    return pdr.simulate.simulate(legs, carrying_mode=carrying_mode, seed=seed, name=f"simulated_{carrying_mode}")


def _print_notes(result: Track, console: Console) -> None:
    for note in result.notes:
        console.print(f"{escape(result.name)}: {escape(note)}", highlight=False, soft_wrap=True)


def _new_table(*columns: str) -> Table:
    """A table with words in the first column and numbers, right-aligned, in the others."""
    from rich import box

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", overflow="fold")
    return table


def _print_table(table: Table) -> None:
    """Print a table as wide as it needs where nobody watches: a pipe has no width."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=max(console.width, 160))
    console.print(table)


def _print_tracks(tracks: Sequence[Track]) -> None:
    table = _new_table("recording", "steps", "distance", "end east", "end north", "duration")
    table.add_column("contexts")
    for result in tracks:
        summary = result.summary()
        seconds: dict[str, float] = summary["contexts"]
        table.add_row(
            escape(result.name),
            str(result.n_steps),
            f"{result.distance_m:.1f} m",
            f"{summary['end_east_m']:.1f} m",
            f"{summary['end_north_m']:.1f} m",
            f"{result.duration_s:.1f} s",
            ", ".join(f"{name} {value:.0f} s" for name, value in seconds.items() if value >= 0.5),
        )
    _print_table(table)
    for result in tracks:
        _print_notes(result, Console())


def _print_description(description: dict[str, Any]) -> None:
    typer.echo(f"{description['name']}: {description['duration_s']:.1f} s, from {description['source']}")
    table = _new_table("sensor", "unit", "samples", "rate", "gaps", "longest", "repeated", "backward", "empty")
    for stream in description["streams"]:
        rate_hz = stream["mean_rate_hz"]  # the median is wrong where times come in whole milliseconds
        table.add_row(
            stream["name"],
            stream["unit"],
            str(stream["n_samples"]),
            "unknown" if rate_hz is None else f"{rate_hz:.1f} Hz",
            str(stream["n_gaps"]),
            f"{stream['longest_gap_s']:.2f} s",
            str(stream["n_duplicates"]),
            str(stream["n_backward"]),
            str(stream["n_missing_rows"]),
        )
    _print_table(table)
    truth = ", ".join(f"{name} ({rows} rows)" for name, rows in description["truth_rows"].items())
    height_m = description["height_m"]
    height = "not known, track it with --height" if height_m is None else f"{height_m:.2f} m"
    person = f"person's height: {height}; phone: {description['placement'] or 'not stated'}"
    for line in (
        *description["units"],
        person,
        f"truth: {truth or 'none'}",
        *(f"note: {n}" for n in description["notes"]),
    ):
        typer.echo(line)
    typer.echo()


def _print_comparison(compared: Sequence[Sequence[Track]]) -> None:
    table = _new_table(
        "recording", "weighting", "steps", "distance", "against imm", "end east", "end north", "end apart"
    )
    for tracks in compared:
        reference = tracks[-1]
        reference_end = reference.summary()
        for i, result in enumerate(tracks):
            end = result.summary()
            apart_east_m = end["end_east_m"] - reference_end["end_east_m"]
            apart_north_m = end["end_north_m"] - reference_end["end_north_m"]
            difference_m = result.distance_m - reference.distance_m
            is_reference = result is reference
            table.add_row(
                escape(result.name) if i == 0 else "",
                result.weighting,
                str(result.n_steps),
                f"{result.distance_m:.1f} m",
                "" if is_reference else f"{difference_m:+.1f} m",
                f"{end['end_east_m']:.1f} m",
                f"{end['end_north_m']:.1f} m",
                "" if is_reference else f"{(apart_east_m**2 + apart_north_m**2) ** 0.5:.1f} m",
                end_section=is_reference,
            )
    _print_table(table)
    for tracks in compared:
        _print_notes(tracks[-1], Console())


if __name__ == "__main__":
    main()
