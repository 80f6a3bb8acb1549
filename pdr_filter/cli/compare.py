"""Command `pdr-filter compare`, which compares the weightings HC, WC and IMM, or recipes.

HC (highest context) uses the step length of the most probable context. WC (weighted context) uses the mean of the step
lengths, weighted with the context probabilities. IMM is the interacting multiple model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdr_filter.cli import console
from pdr_filter.cli.console import escape
from pdr_filter.cli.options import AsJson, Files
from pdr_filter.values.sanitise import file_name

if TYPE_CHECKING:
    from pdr_filter.tracking.track import Track
    from pdr_filter.values import Table
    from pdr_filter.values.recording import Recording


@dataclass(frozen=True)
class Compared:
    """Tracks of one recording by weighting or recipe. The last track is the baseline of the comparison.

    Attributes
    ----------
    recording : Recording
        Recording that was tracked.
    tracks : dict of str to Track
        Track of each weighting or recipe.
    rmse_m : dict of str to float
        Position RMSE of each track; empty without --truth.
    errors : Table
        Errors of the tracks, from `evaluate.comparison_table`.
    in_contexts : Table or None
        Errors by context, from `evaluate.context_errors`; None without context labels.
    """

    recording: Recording
    tracks: dict[str, Track]
    rmse_m: dict[str, float]
    errors: Table
    in_contexts: Table | None

    def summary(self) -> dict[str, Any]:
        """Return the results of all tracks as JSON values: the name of the recording, and a summary for each track."""
        rows = [
            {"track": name, **track.summary(), **({"rmse_m": self.rmse_m[name]} if name in self.rmse_m else {})}
            for name, track in self.tracks.items()
        ]
        return {"name": self.recording.name, "tracks": rows}


def compare(
    files: Files,
    recipe: Annotated[
        list[str] | None,
        typer.Option(
            help="Recipe to compare. Repeat the option for each recipe. Replaces the comparison of weightings."
        ),
    ] = None,
    truth: Annotated[
        bool,
        typer.Option(
            "--truth",
            help="Also show the position error against the ground truth of the recording, after rigid alignment.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for NAME.compare.html, which shows all tracks, and for tables (CSV, LaTeX)."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare the weightings HC, WC and IMM on recordings, or several recipes.

    HC (highest context) uses the step length of the most probable context. WC (weighted context) uses the mean of the
    step lengths, weighted with the context probabilities. IMM is the interacting multiple model.
    """
    import pdr_filter as pdr
    from pdr_filter.report.html import write_report

    written: set[str] = set()
    without: list[str] = []  # names of recordings without ground truth
    replaced: list[Path] = []

    def compare_one(file: Path, progress: Callable[[float], None]) -> Compared:
        recording = pdr.read(file)
        if recipe:
            tracks = _recipe_tracks(recording, recipe, progress)
        else:
            tracks = pdr.evaluate.weighting_tracks(recording, progress=progress)
        known = _known_places(recording) if truth else None
        rmse_m = {} if known is None else {name: _rmse_m(known, track) for name, track in tracks.items()}
        labels = recording.truth.labels
        in_contexts = None if labels is None or not len(labels) else pdr.evaluate.context_errors(recording, tracks)
        found = Compared(recording, tracks, rmse_m, pdr.evaluate.comparison_table(recording, tracks), in_contexts)
        if truth and known is None:
            without.append(recording.name)
        if out is not None:
            named = [replace(track, name=f"{recording.name}, {name}") for name, track in tracks.items()]
            path = out / f"{console.unique_name(file_name(recording.name), written)}.compare.html"
            if path.exists():
                replaced.append(path)
            write_report(named, path, recording)
        if as_json:
            console.print_json(found.summary())
        return found

    with console.one_line_errors():
        for name in recipe or ():
            pdr.recipes.check_name(name)
        files = console.recordings_of(files)
    compared, failed = console.each(files, compare_one, as_json)
    study = _study(compared) if truth or out is not None else None
    if study is not None and out is not None:
        with console.one_line_errors():
            replaced += _write(study, compared, out)
    if compared and not as_json:
        _print(compared)
        if study is not None:
            _print_study(study)
        console.say_written(out)
    console.say_without_truth(without)
    console.say_replaced(replaced)
    console.exit_if_failed(failed, len(files))


def _recipe_tracks(recording: Recording, names: Sequence[str], progress: Callable[[float], None]) -> dict[str, Track]:
    import pdr_filter as pdr

    tracks: dict[str, Track] = {}
    for i, name in enumerate(names):

        def show(fraction: float, i: int = i) -> None:
            progress((i + fraction) / len(names))

        config = pdr.recipes.for_recording(name, recording)
        tracks[name] = pdr.track(recording, config, progress=show, gnss="off")
    return tracks


def _known_places(recording: Recording) -> Table | None:
    """Return the true positions or else the waypoints of a recording, or None if it has neither."""
    return recording.truth.position if recording.truth.position is not None else recording.truth.waypoints


def _rmse_m(known: Table, track: Track) -> float:
    """Return the position RMSE in m against a table of true positions or waypoints, after the best rigid alignment."""
    import numpy as np

    import pdr_filter as pdr

    reference_m = np.column_stack([known["east_m"], known["north_m"]])
    at_m = pdr.evaluate.positions_at(track.time_s, track.position_m, known["time_s"], track.start_position_m)
    return pdr.evaluate.position_rmse_m(at_m, reference_m, "all")


def _print(compared: Sequence[Compared]) -> None:
    has_truth = any(found.rmse_m for found in compared)
    columns = ["recording", "track", "steps", "distance", "difference to the last", "end east", "end north"]
    columns += ["± at the end", "end to last end", *(["error (RMSE)"] if has_truth else [])]
    table = console.new_table(*columns, n_keys=2)
    for found in compared:
        *_, reference = found.tracks.values()
        reference_end = reference.summary()
        for i, (name, track) in enumerate(found.tracks.items()):
            end = track.summary()
            apart_east_m = end["end_east_m"] - reference_end["end_east_m"]
            apart_north_m = end["end_north_m"] - reference_end["end_north_m"]
            is_reference = track is reference
            table.add_row(
                escape(found.recording.name) if i == 0 else "",
                name,
                str(track.n_steps),
                console.in_m(track.distance_m),
                "" if is_reference else console.in_m(track.distance_m - reference.distance_m, "+.1f"),
                console.in_m(end["end_east_m"]),
                console.in_m(end["end_north_m"]),
                console.in_m(end["end_std_m"]) if track.n_steps else "",
                "" if is_reference else console.in_m((apart_east_m**2 + apart_north_m**2) ** 0.5),
                *([console.in_m(found.rmse_m[name]) if found.rmse_m else ""] if has_truth else []),
                end_section=is_reference,
            )
    table.caption = console.STD_CAPTION
    console.print_table(table)
    console.print_notes([list(found.tracks.values())[-1] for found in compared])


def _study(compared: Sequence[Compared]) -> Table | None:
    """Return a table of mean errors over persons (`evaluate.study_table`), or None if no recording has ground truth.

    Each recording without a name of its person counts as another person.
    """
    import numpy as np

    import pdr_filter as pdr
    from pdr_filter.evaluate.study import MEASURES

    if not any(np.isfinite(found.errors[name]).any() for found in compared for name in MEASURES):
        return None
    # recordings without a name of the person count as different persons
    people = [found.recording.subject.id or f"recording {k}" for k, found in enumerate(compared)]
    return pdr.evaluate.study_table([found.errors for found in compared], people)


def _write(study: Table, compared: Sequence[Compared], out: Path) -> list[Path]:
    """Write the tables of study, recordings and contexts as CSV and LaTeX, and return the files that were replaced."""
    import numpy as np

    from pdr_filter.evaluate import write_tables
    from pdr_filter.values import table

    def joined(parts: Sequence[tuple[str, Table]]) -> Table:
        names = parts[0][1].dtype.names or ()
        columns = {name: np.concatenate([part[name] for _, part in parts]) for name in names}
        return table({"recording": np.concatenate([np.full(len(part), of) for of, part in parts]), **columns})

    tables = {"study": study, "recordings": joined([(found.recording.name, found.errors) for found in compared])}
    labelled = [(found.recording.name, found.in_contexts) for found in compared if found.in_contexts is not None]
    if labelled:
        tables["contexts"] = joined(labelled)
    before = console.existing(*(out / f"{name}{suffix}" for name in tables for suffix in (".csv", ".tex")))
    for name, rows in tables.items():
        write_tables(rows, out / name)
    return before


def _print_study(study: Table) -> None:
    """Print mean errors. The column of intervals is omitted for a single person, because an interval needs several."""
    has_interval = bool((study["low"] == study["low"]).any())  # NaN differs from itself
    columns = ["error", "track", "recordings", "persons", "bias", "mean absolute"]
    columns += ["95 % interval of the mean"] if has_interval else []
    shown = console.new_table(*columns, "difference to the last", n_keys=2)
    for row in study:
        difference = "" if row["difference"] != row["difference"] else _with_interval(row, "difference")
        counts = str(row["n_recordings"]), str(row["n_people"])
        interval = (_range(row["low"], row["high"]),) if has_interval else ()
        numbers = f"{row['bias']:+.2f}", f"{row['mean']:.2f}", *interval, difference
        shown.add_row(str(row["measure"]), str(row["name"]), *counts, *numbers)
    console.print_table(shown)


def _with_interval(row: Any, name: str) -> str:
    """Return a value, followed by its interval in brackets if it is known."""
    interval = _range(row[f"{name}_low"], row[f"{name}_high"])
    return f"{row[name]:+.2f}" + (f" ({interval})" if interval else "")


def _range(low: float, high: float) -> str:
    """Return an interval as text, or an empty string if it is unknown (NaN)."""
    return "" if low != low else f"{low:.2f} to {high:.2f}"
