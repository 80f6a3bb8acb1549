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
from pdr_filter.cli.options import (
    AsJson,
    Files,
    FixesFile,
    ModelFile,
    PersonFile,
    PlacementOptions,
    Source,
    TransitionsFile,
    context_changes,
)
from pdr_filter.values.sanitise import file_name

if TYPE_CHECKING:
    from pdr_filter.recipes.config import Config
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


@dataclass(frozen=True, slots=True)
class Setting:
    """Options for configuration, person and fixes, which all compared tracks share."""

    recipe: Annotated[
        list[str] | None,
        typer.Option(
            help="Recipe to compare. Repeat the option for each recipe. Several recipes replace the comparison of "
            "weightings."
        ),
    ] = None
    model: ModelFile = None
    transitions: TransitionsFile = None
    person: PersonFile = None
    fixes: FixesFile = None
    fix_std_m: Annotated[
        float, typer.Option("--fix-std", min=0.01, help="Standard deviation in m of fixes without std_m.")
    ] = 1.0

    def check(self, n_files: int) -> None:
        """Raise ValueError for an unknown recipe, and for fixes of more than one recording."""
        import pdr_filter as pdr

        for name in self.recipe or ():
            pdr.recipes.check_name(name)
        if self.fixes is not None and n_files > 1:
            raise ValueError(f"--fixes are of one recording, got {n_files} recordings: compare them one by one")

    def tracks(
        self, recording: Recording, where: dict[str, Any], progress: Callable[[float], None]
    ) -> dict[str, Track]:
        """Return the track of each weighting, or of each recipe if there are several.

        `where` are the arguments of `PlacementOptions`. The recording's own locations are used only on request.
        """
        import pdr_filter as pdr
        from pdr_filter.io.fix_files import fixes_of_file

        names = self.recipe or ["default"]
        changed = context_changes(self.model, self.transitions)

        def config_of(name: str) -> Config:
            config = changed(pdr.recipes.for_recording(name, recording))
            return config if self.fixes is None else config.in_world_frame()

        options: dict[str, Any] = {
            **where,
            "gnss": where["gnss"] or "off",
            "person": self.person,
            "fixes": () if self.fixes is None else fixes_of_file(self.fixes, self.fix_std_m),
        }
        if len(names) == 1:
            return pdr.evaluate.weighting_tracks(recording, config_of(names[0]), progress, **options)
        tracks: dict[str, Track] = {}
        for i, name in enumerate(names):

            def show(fraction: float, i: int = i) -> None:
                progress((i + fraction) / len(names))

            tracks[name] = pdr.track(recording, config_of(name), progress=show, **options)
        return tracks


def compare(
    files: Files,
    setting: Setting,
    placement: PlacementOptions,
    source: Source,
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
    step lengths, weighted with the context probabilities. IMM is the interacting multiple model. Tracks are online.

    With --calibration, all tracks have the step lengths of a calibration. Calibrate on some people, and compare on the
    others.
    """
    import numpy as np

    import pdr_filter as pdr
    from pdr_filter.report.html import write_report

    written: set[str] = set()
    without: list[str] = []  # names of recordings without ground truth
    replaced: list[Path] = []

    def compare_one(file: Path, progress: Callable[[float], None]) -> Compared:
        recording = source.read(file)
        tracks = setting.tracks(recording, where, progress)
        errors = pdr.evaluate.comparison_table(recording, tracks)
        labels = recording.truth.labels
        in_contexts = None if labels is None or not len(labels) else pdr.evaluate.context_errors(recording, tracks)
        is_known = truth and bool(np.isfinite(errors.rmse_m).all())
        rmse_m = dict(zip(tracks, errors.rmse_m.tolist(), strict=True)) if is_known else {}
        found = Compared(recording, tracks, rmse_m, errors, in_contexts)
        if truth and not is_known:
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
        files = console.recordings_of(files)
        setting.check(len(files))
        where = placement.arguments()
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
    from pdr_filter.evaluate.comparison import MEASURES

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
        write_tables(rows, out / name, caption=_CAPTIONS[name])
    return before


_CAPTIONS = {
    "study": r"Mean errors over persons, with 95\,\% intervals, and differences to the last track.",
    "recordings": "Errors of each recording.",
    "contexts": "Errors by context.",
}


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
