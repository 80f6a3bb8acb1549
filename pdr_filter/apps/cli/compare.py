"""Command `pdr-filter compare`, which compares the weightings HC, WC and IMM, or recipes.

HC (highest context) uses the step length of the most probable context. WC (weighted context) uses the mean of the step
lengths, weighted with the context probabilities. IMM is the interacting multiple model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import typer

from pdr_filter.apps.cli import console, options
from pdr_filter.apps.cli.console import escape

if TYPE_CHECKING:
    from pdr_filter.recipes.config import Config
    from pdr_filter.tracking.track import Track
    from pdr_filter.values import Table
    from pdr_filter.values.recording import Recording


@dataclass(frozen=True)
class Compared:
    """Tracks of one recording by weighting or recipe. The last track is the baseline of the comparison."""

    recording: Recording
    tracks: dict[str, Track]  # by weighting or recipe
    rmse_m: dict[str, float]  # position error of each track, empty without --truth
    tables: dict[str, Table]  # errors of the tracks, by context, and of the distance that are due to contexts


@dataclass(frozen=True, slots=True)
class Setting:
    """Options for configuration, person and fixes, which all compared tracks share."""

    recipe: list[str] | None = typer.Option(
        None,
        help="Recipe to compare. Repeat the option for each recipe. Several recipes replace the comparison of "
        "weightings.",
    )
    classifier: options.ClassifierName = None
    model: options.ModelFile = None
    transitions: options.TransitionsFile = None
    person: options.PersonFile = None
    fixes: options.FixesFile = None
    fix_std_m: float = typer.Option(1.0, "--fix-std", min=0.01, help="Standard deviation in m of fixes without std_m.")

    def check(self, n_files: int) -> None:
        """Raise ValueError for an unknown recipe, and for fixes of more than one recording."""
        import pdr_filter as pdr

        for name in self.recipe or ():
            pdr.recipes.check_name(name)
        if self.fixes is not None and n_files > 1:
            raise ValueError(f"--fixes are of one recording, got {n_files} recordings: compare them one by one")

    def config(self, recording: Recording, name: str) -> Config:
        """Return the configuration of a recipe with the given models."""
        import pdr_filter as pdr

        changed = options.context_changes(self.classifier, self.model, self.transitions, name)
        config = changed(pdr.recipes.for_recording(name, recording))
        return config if self.fixes is None else config.in_world_frame()

    def tracks(
        self, recording: Recording, where: dict[str, Any], progress: Callable[[float], None]
    ) -> dict[str, Track]:
        """Return the track of each weighting, or of each recipe if there are several.

        `where` are the arguments of the georeference. The recording's own locations are used only on request.
        """
        import pdr_filter as pdr

        where = dict(where)
        fixes = () if self.fixes is None else options.fixes_of(self.fixes, self.fix_std_m, recording, where)
        arguments: dict[str, Any] = {
            **where,
            "gnss": where["gnss"] or "off",
            "person": self.person,
            "fixes": fixes,
        }
        names = self.recipe or ["default"]
        if len(names) == 1:
            return pdr.evaluate.weighting_tracks(recording, self.config(recording, names[0]), progress, **arguments)
        tracks: dict[str, Track] = {}
        for i, name in enumerate(names):

            def show(fraction: float, i: int = i) -> None:
                progress((i + fraction) / len(names))

            tracks[name] = pdr.track(recording, self.config(recording, name), progress=show, **arguments)
        return tracks

    def by_contexts(self, recording: Recording) -> Table | None:
        """Return the errors of the weightings that are due to contexts, or None if no context of a step is known."""
        import pdr_filter as pdr

        names = self.recipe or ["default"]
        if len(names) > 1:
            return None
        with suppress(ValueError):
            return pdr.evaluate.weighting_errors(recording, self.config(recording, names[0]))
        return None

    def is_in_sample(self, recording: Recording) -> bool:
        """Return True if a context model was trained on the data set of the recording."""
        for name in self.recipe or ["default"]:
            models = getattr(self.config(recording, name).sensing.contexts, "models", None)
            model = getattr(models, "without_gyroscope" if recording.gyroscope is None else "with_gyroscope", None)
            if recording.meta.get("dataset") in getattr(model, "card", {}).get("data", ()):
                return True
        return False


def compare_command(
    files: options.Files,
    setting: Setting,
    georeference: options.GeoreferenceOptions,
    source: options.Source,
    truth: bool = typer.Option(
        False,
        "--truth",
        help="Also show mean errors over persons, and the position error of each recording after rigid alignment "
        "to its ground truth. With labelled contexts, also the errors of the distance by weighting.",
    ),
    out: Path | None = typer.Option(
        None, help="Folder for NAME.compare.html, which shows all tracks, and for tables (CSV, LaTeX)."
    ),
    as_json: options.AsJson = False,
) -> None:
    """Compare the weightings HC, WC and IMM on recordings, or several recipes.

    HC (highest context) uses the step length of the most probable context. WC (weighted context) uses the mean of the
    step lengths, weighted with the context probabilities. IMM is the interacting multiple model. Tracks are online.

    With --calibration, all tracks have the step lengths of a calibration. Calibrate on some people, and compare on the
    others.
    """
    import numpy as np

    import pdr_filter as pdr
    from pdr_filter.apps.report.html import write_report
    from pdr_filter.data.io.folders import with_person_of_file

    written: set[str] = set()
    without: list[str] = []  # names of recordings without ground truth
    replaced: list[Path] = []
    in_sample: set[str] = set()  # data sets that the context models were trained on

    def compare_one(file: Path, progress: Callable[[float], None]) -> Compared:
        start_s = perf_counter()
        recording = with_person_of_file(source.read(file), file)
        has_labels = recording.truth.labels is not None and len(recording.truth.labels) > 0
        with_weightings = has_labels and (truth or out is not None)
        # The errors of the weightings need five more tracks than the three that are compared.
        share = 3 / 8 if with_weightings else 1.0
        tracks = setting.tracks(recording, where, lambda fraction: progress(share * fraction))
        errors = pdr.evaluate.comparison_table(recording, tracks)
        tables = {"recordings": errors}
        if has_labels:
            tables["contexts"] = pdr.evaluate.context_errors(recording, tracks)
            if with_weightings and (by_contexts := setting.by_contexts(recording)) is not None:
                tables["weightings"] = by_contexts
            if with_weightings and setting.is_in_sample(recording):
                in_sample.add(str(recording.meta["dataset"]))
        is_known = truth and bool(np.isfinite(errors.rmse_m).all())
        rmse_m = dict(zip(tracks, errors.rmse_m.tolist(), strict=True)) if is_known else {}
        if truth and not is_known:
            without.append(recording.name)
        if out is not None:
            named = [replace(track, name=f"{recording.name}, {name}") for name, track in tracks.items()]
            path = out / f"{console.unique_name(recording.name, written)}.compare.html"
            if path.exists():
                replaced.append(path)
            write_report(named, path, recording)
        if as_json:
            of_tracks = [
                {"track": name, **track.summary(), **({"rmse_m": rmse_m[name]} if rmse_m else {})}
                for name, track in tracks.items()
            ]
            console.print_json({"name": recording.name, "tracks": of_tracks})
        if len(files) > 1:
            console.say(f"{files.index(file) + 1} of {len(files)}: {recording.name}, {perf_counter() - start_s:.0f} s")
        return Compared(recording, tracks, rmse_m, tables)

    with console.one_line_errors():
        files = console.recording_paths(files)
        setting.check(len(files))
        where = georeference.arguments()
    compared, failed = console.each_file(files, compare_one, as_json)
    study = _study(compared) if truth or out is not None else None
    if study is not None and out is not None:
        with console.one_line_errors():
            replaced += _write(study, compared, out)
    if compared and not as_json:
        _print(compared)
        if study is not None:
            _print_study(study)
        console.say_written(out)
    if in_sample:
        console.say(
            f"a context model was trained on recordings of {', '.join(sorted(in_sample))}: the errors of contexts and "
            "weightings are smaller than for new people; docs/benchmarks/contexts.md has those of held-out people"
        )
    console.say_without_truth(without)
    console.say_replaced(replaced)
    console.exit_if_failed(failed, len(files))


def _print(compared: Sequence[Compared]) -> None:
    has_truth = any(found.rmse_m for found in compared)
    columns = ["recording", "track", "steps", "distance", "difference to the last", "end east", "end north"]
    columns += ["± at the end", "distance between the ends", *(["error (RMSE)"] if has_truth else [])]
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
                *console.end_of(track),
                console.in_m(end["end_std_m"]) if track.n_steps else "",
                "" if is_reference else console.in_m((apart_east_m**2 + apart_north_m**2) ** 0.5),
                *([console.in_m(found.rmse_m[name]) if found.rmse_m else ""] if has_truth else []),
                end_section=is_reference,
            )
    ends = [track for found in compared for track in found.tracks.values()]
    table.caption = f"{console.end_caption(ends)}\n {console.STD_CAPTION}"
    console.print_table(table)
    console.print_notes([list(found.tracks.values())[-1] for found in compared])


def _study(compared: Sequence[Compared]) -> Table | None:
    """Return a table of mean errors over persons (`evaluate.study_table`), or None if no recording has ground truth.

    It ends with the errors of the distance by weighting, of recordings with labelled contexts.
    """
    import numpy as np

    import pdr_filter as pdr
    from pdr_filter.evaluate.comparison import MEASURES
    from pdr_filter.values import table

    errors = [found.tables["recordings"] for found in compared]
    if not any(np.isfinite(rows[name]).any() for rows in errors for name in MEASURES):
        return None
    people = [found.recording.subject.id or f"recording {k}" for k, found in enumerate(compared)]
    study = pdr.evaluate.study_table(errors, people)
    known = [
        (_distance_errors(found.tables["weightings"]), person)
        for found, person in zip(compared, people, strict=True)
        if "weightings" in found.tables
    ]
    if not known:
        return study
    distances = pdr.evaluate.study_table(*map(list, zip(*known, strict=True)), measures=("distance_error_percent",))
    return table({name: np.concatenate([study[name], distances[name]]) for name in study.dtype.names or ()})


def _distance_errors(weightings: Table) -> Table:
    """Return the errors of `evaluate.weighting_errors` with the IMM as the last row, and without the reference."""
    import numpy as np

    from pdr_filter.values import table

    name, percent = weightings.weighting, weightings.error_percent
    (rest,) = np.nonzero(~np.isin(name, ("imm", "contexts known")))
    order = [*rest, *np.flatnonzero(name == "imm")]
    return table({"name": name[order], "distance_error_percent": percent[order]})


def _write(study: Table, compared: Sequence[Compared], out: Path) -> list[Path]:
    """Write the tables of study, recordings and contexts as CSV and LaTeX, and return the files that were replaced."""
    import numpy as np

    from pdr_filter.evaluate import study_rows, write_tables
    from pdr_filter.values import table

    tables = {"study": study}
    for name in ("recordings", "contexts", "weightings"):
        parts = [(found.recording.name, found.tables[name]) for found in compared if name in found.tables]
        if parts:
            columns = {"recording": np.concatenate([np.full(len(rows), of) for of, rows in parts])}
            columns |= {c: np.concatenate([rows[c] for _, rows in parts]) for c in parts[0][1].dtype.names or ()}
            tables[name] = table(columns)
    before = console.existing(*(out / f"{name}{suffix}" for name in tables for suffix in (".csv", ".tex")))
    for name, rows in tables.items():
        write_tables(rows, out / name, 2, _CAPTIONS[name], study_rows(study) if name == "study" else None)
    return before


_CAPTIONS = {
    "study": r"Mean absolute errors over persons, $\pm$ half of the 95\,\% interval.",
    "recordings": "Errors of each recording.",
    "contexts": "Errors by context.",
    "weightings": "Error of the distance against the same steps with known contexts.",
}


def _print_study(study: Table) -> None:
    """Print mean errors with their 95 % intervals."""
    from pdr_filter.evaluate import study_rows

    rows = study_rows(study)
    shown = console.new_table(*rows[0], n_keys=2)
    for row in rows:
        shown.add_row(*map(str, row.values()))
    has_interval = any("±" in str(row["mean"]) for row in rows)
    shown.caption = f"mean absolute errors over persons{', ± half of the 95 % interval' if has_interval else ''}"
    if "distance_error_percent" in study.measure:
        shown.caption += "; distance error: relative to the same steps with the lengths of their labelled contexts"
    console.print_table(shown)
