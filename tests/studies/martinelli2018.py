"""Martinelli et al. 2018: contexts by a relevance vector machine, and distances weighted by their probabilities.

Two kinds of walks through several contexts, as no public recording has a labelled one of known length. Real ones:
recordings of one person of MotionSense one after the other; their length is not known, so that a distance is compared
with that of the same steps in the true contexts, which leaves the share of the error that is the classifier's.
Simulated ones: the paper's 331 m with the phone at the waist, side steps included. People are tested in three
subgroups, as in the paper, always by machines trained on the other people.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits

from pdr_filter.evaluate.classification import accuracy, macro_recall, recall
from pdr_filter.evaluate.comparison import second_over_first
from pdr_filter.evaluate.distance import distance_scores, percent_error
from pdr_filter.offline.training.cross_validation import DUPLICATES
from pdr_filter.recipes import default, martinelli2018, with_context_model
from pdr_filter.recipes.martinelli2018.features import NAMES, SELECTED_18, TABLE_II, WITHOUT_MAGNETOMETER
from pdr_filter.report.palette import BLUE, GREEN, INK, ORANGE
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.values import CONTEXTS, IntArray
from tests.studies.data import recordings
from tests.studies.feature_selection import Selection
from tests.studies.measured.martinelli2018 import (
    Examples,
    Size,
    Walk,
    calibrated,
    confusion_of,
    default_machine,
    examples_of,
    machine_accuracy,
    of_subgroups,
    relevance_machine,
    searched_features,
    short_segments,
    simulated_person,
    subgroups,
    walk_of,
    walked_path,
    walks_of_people,
)
from tests.studies.printed.martinelli2018 import (
    ACCURACY,
    PAPER,
    SUBGROUPS,
    TABLE_III,
    TABLE_IV,
    TABLE_V,
    TABLE_VI,
    THRESHOLD,
    printed_checks,
)
from tests.studies.report import Study, StudyFigure, StudyTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
Rows = tuple[Mapping[str, object], ...]


# --- Tables ----------------------------------------------------------------------------------------------------------


def _table_iii(confusion: IntArray) -> Rows:
    """Per cent of each true context, predicted contexts in the columns."""
    rows: list[Mapping[str, object]] = []
    for true, of_paper, counts in zip(CONTEXTS, TABLE_III, confusion, strict=True):
        row: dict[str, object] = {"true": true, "n": int(counts.sum())}
        for c, printed, count in zip(CONTEXTS, of_paper, counts, strict=True):
            row[f"paper {c}"] = float(printed)
            row[f"ours {c}"] = float(100.0 * count / counts.sum()) if counts.sum() else np.nan
        rows.append(row)
    return tuple(rows)


def _recalls(confusions: Mapping[str, IntArray]) -> Rows:
    """Recall of each context, macro recall and accuracy, per cent."""
    of = {name: recall(c) for name, c in confusions.items()}
    rows: list[Mapping[str, object]] = [
        {"context": c, "paper": float(TABLE_III[i, i])} | {name: float(100.0 * r[i]) for name, r in of.items()}
        for i, c in enumerate(CONTEXTS)
    ]
    rows.append({"context": "mean of the contexts", "paper": ACCURACY} | _percent(confusions, macro_recall))
    rows.append({"context": "accuracy", "paper": ACCURACY} | _percent(confusions, accuracy))
    return tuple(rows)


def _percent(confusions: Mapping[str, IntArray], score: Callable[[IntArray], float]) -> dict[str, object]:
    return {name: 100.0 * score(c) for name, c in confusions.items()}


Columns = Mapping[str, Sequence[float]]


def _errors(walks: Sequence[Walk], default_walks: Sequence[Walk] = ()) -> dict[str, list[float]]:
    """Errors of the walks' distances, per cent, by column."""
    columns = {f"ours {w.upper()}": [x.error_percent(x.by(w)) for x in walks] for w in ("hc", "wc", "imm")}
    if default_walks:
        columns["ours default"] = [x.error_percent(x.imm_m) for x in default_walks]
    return columns


def _table_iv(errors: Columns, people: Sequence[str]) -> Rows:
    """%RMSE of each subgroup and of all, and bias and spread of all."""
    parts = [np.isin(people, part) for part in subgroups(people)]
    rows: list[Mapping[str, object]] = []
    for k, (name, use) in enumerate([*zip(SUBGROUPS, parts, strict=True), ("all", np.ones(len(people), bool))]):
        row: dict[str, object] = {"%RMSE of": name, "paper HC": TABLE_IV["hc"][k], "paper WC": TABLE_IV["wc"][k]}
        rows.append(row | {c: distance_scores(np.array(e)[use]).rmse_percent for c, e in errors.items()})
    for name, field in (("all: bias", "bias_percent"), ("all: spread", "spread_percent")):
        row = {"%RMSE of": name}
        row |= {f"paper {k.upper()}": getattr(distance_scores(v), field) for k, v in TABLE_V.items()}
        rows.append(row | {c: getattr(distance_scores(e), field) for c, e in errors.items()})
    return tuple(rows)


def _table_v(errors: Columns, people: Sequence[str]) -> Rows:
    """%error of each person; the paper's people are others."""
    n_paper, n = len(TABLE_V["hc"]), len(people)

    def at(values: Sequence[float], i: int) -> float:
        return float(values[i]) if i < len(values) else np.nan

    return tuple(
        {"subject": i + 1, "paper HC": at(TABLE_V["hc"], i), "paper WC": at(TABLE_V["wc"], i)}
        | {"ours": people[i] if i < n else "-"}
        | {c: at(e, i) for c, e in errors.items()}
        for i in range(max(n_paper, n))
    )


def _table_vi(walks: Sequence[Walk], default_walks: Sequence[Walk] = ()) -> Rows:
    """%error under each context, averaged over the people."""

    def mean_error(of: Sequence[Walk], weighting: str, c: int) -> float:
        each = [
            float(percent_error(w.by(weighting)[w.context == c].sum(), w.true_m[w.context == c].sum()))
            for w in of
            if w.true_m[w.context == c].sum() > 0
        ]
        return float(np.mean(each)) if each else np.nan

    rows: list[Mapping[str, object]] = []
    for context, (length_m, hc, wc) in TABLE_VI.items():
        c = CONTEXTS.index(context)
        row: dict[str, object] = {"context": context, "paper length, m": length_m, "paper HC": hc, "paper WC": wc}
        row |= {f"ours {w.upper()}": mean_error(walks, w, c) for w in ("hc", "wc", "imm")}
        rows.append(row | ({"ours default": mean_error(default_walks, "imm", c)} if default_walks else {}))
    return tuple(rows)


_THRESHOLDS = tuple(float(t) for t in np.linspace(0.0, 1.0, 21))


def _sweep(walks: Sequence[Walk]) -> list[float]:
    """%RMSE over the walks with WC at each threshold."""
    return [distance_scores([w.error_percent(w.weighted_m(t)) for w in walks]).rmse_percent for t in _THRESHOLDS]


def _rmse(walks: Sequence[Walk], weighting: str) -> float:
    return distance_scores([w.error_percent(w.by(weighting)) for w in walks]).rmse_percent


# --- Figures ---------------------------------------------------------------------------------------------------------


def _draw_selection(axes: Axes, selection: Selection, machine: Mapping[int, float]) -> None:
    n = np.arange(1, len(selection.curve) + 1)
    mean = 100.0 * np.array([s.score for s in selection.curve])
    std = 100.0 * np.array([s.score_std for s in selection.curve])
    axes.fill_between(n, mean - std, mean + std, color=BLUE, alpha=0.15, linewidth=0)
    axes.plot(n, mean, color=BLUE, label="linear discriminant (searched)")
    of_machine = [100.0 * v for v in machine.values()]
    axes.plot(list(machine), of_machine, color=ORANGE, marker="s", markersize=4, label="RVM, same sets")
    axes.plot(len(SELECTED_18), ACCURACY, color=INK, marker="D", linestyle="none", label="paper's best")
    axes.set(xlabel="number of features", ylabel="accuracy, %")
    axes.legend(frameon=False, loc="lower right", fontsize="small")


def _draw_lengths(axes: Axes, accuracy_of: Mapping[float, tuple[float, float]]) -> None:
    length_s = list(accuracy_of)
    mean, std = (100.0 * np.array([v[k] for v in accuracy_of.values()]) for k in (0, 1))
    axes.errorbar(length_s, mean, std, color=BLUE, marker="o", capsize=3, label="ours, spread of the subgroups")
    axes.plot(2.0, ACCURACY, color=INK, marker="D", linestyle="none", label="paper, 2 s")
    axes.set(xlabel="length of the window, s", ylabel="accuracy, %", xlim=(0.0, max(length_s) + 0.25))
    axes.legend(frameon=False, loc="lower right", fontsize="small")


def _draw_sweep(axes: Axes, of: Mapping[str, Sequence[Walk]]) -> None:
    for (name, walks), colour, marker in zip(of.items(), (BLUE, GREEN), ("o", "s"), strict=False):
        axes.plot(_THRESHOLDS, _sweep(walks), color=colour, marker=marker, markersize=4, label=f"{name}: WC")
        axes.axhline(_rmse(walks, "imm"), color=colour, linestyle="--", label=f"{name}: IMM")
    axes.plot(THRESHOLD, TABLE_IV["wc"][3], color=INK, marker="D", linestyle="none", label="paper: WC")
    axes.plot(1.0, TABLE_IV["hc"][3], color=INK, marker="D", fillstyle="none", linestyle="none", label="paper: HC")
    axes.set(xlabel="threshold (0: always WC, 1: HC)", ylabel="RMSE of the distance, %", xlim=(-0.03, 1.03))
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, fontsize="small", loc="lower left")


# --- The study -------------------------------------------------------------------------------------------------------

_NO_MOTIONSENSE = "three people of motionsense are not in the folder: nothing measured"
_TITLES = (
    "Table III: confusion matrix, %",
    "Table III, recall: diagonal of the confusion matrix, %",
    "Table IV: %RMSE of the distance of each subgroup",
    "Table V: %error of the distance of each subject",
    "Table VI: %error of the distance in each context",
    "Fig. 10, numbers: accuracy against the number of features",
    "Fig. 12, numbers: accuracy against the length of the window",
)


def study(data: Path, size: Size | None = None) -> Study:
    """Tables III to VI and Figures 10, 12 and 14 on MotionSense and on simulated walks.

    Parameters
    ----------
    data : Path
        Folder of the data sets; of them `motionsense` is used.
    size : Size, optional
        Smaller for a quick look.
    """
    size = size or Size()
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # it warns of the budget of candidates that is meant here
        tables, figures, real = _real(data, size)
        simulated_tables, simulated = _simulated(size)
        return Study(
            name="martinelli2018",
            paper=PAPER,
            tables=(*tables, *simulated_tables, _sweep_table(real, simulated)),
            figures=(*figures, _sweep_figure(real, simulated)),
            notes=(*printed_checks(), *_notes(real, simulated)),
        )


def _notes(real: Sequence[Walk], simulated: Sequence[Walk]) -> list[str]:
    notes: list[str] = []
    for name, walks in (("real recordings put together", real), ("simulated", simulated)):
        if walks:
            ratio = np.concatenate([second_over_first(w.context_prob) for w in walks])
            notes.append(
                f"The second highest probability is at least {THRESHOLD} of the highest in "
                f"{100.0 * np.mean(ratio >= THRESHOLD):.1f} % of the windows ({name}, n = {len(ratio)}): WC differs "
                "from HC in these only."
            )
    return [
        *notes,
        "Not remade: Table I and Figures 1 to 5, 9 and 11 are definitions, the map and pictures; Table II is in "
        "`pdr_filter.recipes.martinelli2018.features`; Figures 6 to 8 show signals of their recordings. Fig. 13 "
        "is Table V in "
        "metres. Figures 10, 12 and 14 are not printed as numbers: of the paper's curves only the points that the text "
        "gives are drawn.",
        "Tenfold cross-validation over movements, as in the paper, puts the same person into training and test. Here "
        "people are left out always, which is harder.",
    ]


def _real(data: Path, size: Size) -> tuple[list[StudyTable], list[StudyFigure], list[Walk]]:
    """Tables and figures of real recordings, and the walks put together of them."""
    stages = {f"{s:g}": FeatureWindows(features=TABLE_II, window_s=s, hop_s=s / 2) for s in (*size.window_s, 2.0)}
    stages["invariant"] = FeatureWindows(features=ATTITUDE_FREE)
    walks = (r for r in recordings(data, "motionsense") if r.name not in DUPLICATES)
    examples = examples_of(walks, stages, size.n_windows)
    if not examples or len(np.unique(examples["2"].person)) < 3:
        return [StudyTable(t, (), _NO_MOTIONSENSE, "nothing to compare") for t in _TITLES], [], []
    two_s, of_default = examples["2"], examples["invariant"]
    models = of_subgroups(two_s, partial(relevance_machine, names=WITHOUT_MAGNETOMETER))
    default_models = of_subgroups(of_default, default_machine)
    confusions = {"ours": confusion_of(two_s, models), "ours default": confusion_of(of_default, default_models)}
    real = walks_of_people(data, models, martinelli2018())
    by_default = walks_of_people(data, default_models, default())

    people = [w.person for w in real]
    errors = _errors(real, by_default)
    n = len(np.unique(two_s.person))
    windows = f"MotionSense, {n} people, phone in the front trouser pocket, {len(two_s.person)} windows of 2 s"
    of_walks = (
        f"recordings of MotionSense put together, {len(real)} walks of {len(real)} people, phone in the front trouser "
        "pocket; error against the distance of the same steps in the true contexts"
    )
    split = (
        "five contexts (no sideways walking is public), no magnetometer (23 of the 28 features), trouser pocket in "
        "place of the waist, three subgroups of people left out in place of ten folds of movements"
    )
    of_path = (
        "the length of the way is not known: the error is what wrong contexts make of it, without that of step lengths "
        "and missed steps. Other people, trouser pocket, no sideways walking. `ours` is the martinelli2018 recipe with "
        "a machine of the other people, `ours default` the default recipe with its model made of the other people"
    )
    iii, diagonal, iv, v, vi, *_ = _TITLES
    tables = [
        StudyTable(iii, _table_iii(confusions["ours"]), windows, split),
        StudyTable(diagonal, _recalls(confusions), windows, split),
        StudyTable(iv, _table_iv(errors, people), of_walks, of_path),
        StudyTable(v, _table_v(errors, people), of_walks, of_path),
        StudyTable(vi, _table_vi(real, by_default), of_walks, of_path),
    ]
    more_tables, figures = _of_windows(examples, size, windows, split)
    return [*tables, *more_tables], figures, real


def _of_windows(
    examples: Mapping[str, Examples], size: Size, windows: str, split: str
) -> tuple[list[StudyTable], list[StudyFigure]]:
    """Accuracy against the number of features and the length of the window."""
    selection, machine = searched_features(examples["2"], size)
    searched = f"{split}. The search scores a linear discriminant, the machine is trained on some of the sets it finds"
    of_length = {
        s: machine_accuracy(examples[f"{s:g}"], WITHOUT_MAGNETOMETER) for s in size.window_s if f"{s:g}" in examples
    }
    lengths = windows.replace(" of 2 s", " of 2 s and as many of each other length, where there are")
    rows = tuple(
        {"window, s": s, "paper": ACCURACY if s == 2.0 else np.nan, "ours": 100.0 * m, "ours, std": 100.0 * d}
        for s, (m, d) in of_length.items()
    )
    draw_selection = partial(_draw_selection, selection=selection, machine=machine)
    draw_lengths = partial(_draw_lengths, accuracy_of=of_length)
    by_number, by_length = _TITLES[-2:]
    return [
        StudyTable(by_number, _selection_rows(selection, machine), windows, searched),
        StudyTable(by_length, rows, lengths, split),
    ], [
        StudyFigure(by_number.replace(", numbers", ""), draw_selection, windows, searched),
        StudyFigure(by_length.replace(", numbers", ""), draw_lengths, lengths, split),
    ]


def _selection_rows(selection: Selection, machine: Mapping[int, float]) -> Rows:
    return tuple(
        {
            "features": len(s.columns),
            "paper": ACCURACY if len(s.columns) == len(SELECTED_18) else np.nan,
            "ours, linear": 100.0 * s.score,
            "ours, std": 100.0 * s.score_std,
            "ours, RVM": 100.0 * machine.get(len(s.columns), np.nan),
            "of the paper's 18": len(set(s.names) & set(SELECTED_18)),
        }
        for s in selection.curve
    )


def _simulated(size: Size) -> tuple[list[StudyTable], list[Walk]]:
    """Tables III to VI of simulated people with six contexts and a magnetometer, and their walks."""
    people = {f"{i + 1:02d}": i for i in range(size.n_simulated)}
    short = (simulated_person(short_segments(), i, name) for name, i in people.items())
    examples = examples_of(short, {"2": FeatureWindows(features=TABLE_II)}, size.n_windows)["2"]
    models = of_subgroups(examples, partial(relevance_machine, names=NAMES))
    walks: list[Walk] = []
    for part, model in models:
        for name in part:
            recording = simulated_person(walked_path(size.walked), people[name], name)
            config = with_context_model(martinelli2018(), model)
            walks.append(replace(walk_of(recording, calibrated(config, recording)), person=name))
    errors, names = _errors(walks), [w.person for w in walks]
    length_m = float(np.mean([w.true_m.sum() for w in walks]))
    who = f"simulated, {size.n_simulated} people, phone at the waist"
    windows = f"{who}, {len(examples.person)} windows of 2 s"
    of_walks = f"{who}, {len(walks)} walks of {length_m:.0f} m"
    easy = (
        "nobody walked this. Simulated people are more regular and more alike than real ones, and the magnetic field "
        "is the same everywhere: accuracy here is no accuracy. All 28 features; 20 windows of each person in each "
        "context"
    )
    of_path = (
        "nobody walked this. The paper's lengths in an order of our own; stairs are 0.29 m deep both ways, so that the "
        "path is 10 m shorter. k0, k1 and k2 of each person by eq. 13 to 16 on parts of 10 m of the same walk, as in "
        "the paper. No default: its model takes simulated stairs and side steps for walking"
    )
    return [
        StudyTable(
            "Table III, simulated: confusion matrix, %", _table_iii(confusion_of(examples, models)), windows, easy
        ),
        StudyTable(
            "Table IV, simulated: %RMSE of the distance of each subgroup", _table_iv(errors, names), of_walks, of_path
        ),
        StudyTable(
            "Table V, simulated: %error of the distance of each subject", _table_v(errors, names), of_walks, of_path
        ),
        StudyTable("Table VI, simulated: %error of the distance in each context", _table_vi(walks), of_walks, of_path),
    ], walks


def _sweep_table(real: Sequence[Walk], simulated: Sequence[Walk]) -> StudyTable:
    """%RMSE against the threshold."""
    of_real = _sweep(real) if real else [np.nan] * len(_THRESHOLDS)
    rows: list[Mapping[str, object]] = [
        {"threshold": f"{t:.2f}", "paper": _printed_at(t), "ours": r, "ours, simulated": s}
        for t, r, s in zip(_THRESHOLDS, of_real, _sweep(simulated), strict=True)
    ]
    for name, weighting, printed in (("HC", "hc", TABLE_IV["hc"][3]), ("IMM", "imm", np.nan)):
        own = _rmse(real, weighting) if real else np.nan
        rows.append({"threshold": name, "paper": printed, "ours": own, "ours, simulated": _rmse(simulated, weighting)})
    return StudyTable(
        "Fig. 14, numbers: %RMSE of the distance against the threshold",
        tuple(rows),
        _of_both(real, simulated),
        "as in Tables IV to VI; IMM has no threshold",
        2,
    )


def _printed_at(threshold: float) -> float:
    """%RMSE that the paper prints for a threshold; NaN but at 0.8."""
    return TABLE_IV["wc"][3] if threshold == THRESHOLD else np.nan


def _sweep_figure(real: Sequence[Walk], simulated: Sequence[Walk]) -> StudyFigure:
    of = {"real": real} if real else {}
    return StudyFigure(
        "Fig. 14: %RMSE of the distance against the threshold",
        partial(_draw_sweep, of={**of, "simulated": simulated}),
        _of_both(real, simulated),
        "as in Tables IV to VI; IMM has no threshold",
    )


def _of_both(real: Sequence[Walk], simulated: Sequence[Walk]) -> str:
    return f"simulated: {len(simulated)} walks; real recordings put together: {len(real)} walks, as in Table IV"


if __name__ == "__main__":
    from tests.studies.run import run

    run(study)
