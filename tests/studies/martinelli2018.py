"""Martinelli et al. 2018: contexts by a relevance vector machine, and distances weighted by their probabilities.

usage: python -m tests.studies.martinelli2018 [contexts_and_distances] [belt] [windows] [features]

contexts_and_distances: Tables III, IV, V by person, and Fig. 14. "10-fold" is the paper's protocol, over windows, so
that windows of one person are on both sides. belt: walking and running at the belt (SisFall), as in the paper.
windows: Fig. 12, held-out people by the length of the window. features: Fig. 10, sequential floating selection. Table
VI is made by tests.studies.weightings.

No public recording has labelled changes of context and a known length, so that recordings of one
person of MotionSense follow each other. A distance is compared with that of the same steps in the true contexts, which
leaves the share of the error that is the classifier's. People are tested in three subgroups, as in the paper, always by
machines trained on the other people: five contexts, no magnetometer (23 of the 28 features), trouser pocket.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from models.training.context_training import PLANS
from models.training.data_sets import DUPLICATES, label_of
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.evaluate.classification import accuracy, confusion_matrix, macro_recall, recall
from pdr_filter.evaluate.distance import distance_scores, percent_error, walked_m
from pdr_filter.evaluate.runs import epoch_distances
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.weighting import HC, WC, weighted_distances
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.recipes import default, martinelli2018, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.martinelli2018.features import NAMES, TABLE_II, WITHOUT_MAGNETOMETER
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import track
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings
from tests.benchmarks.weightings import Piece, clip, joined_walk
from tests.studies.data import NAN, Part, paper_table, prefixed, run_study

TextArray = NDArray[np.str_]


# --- Windows and machines --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Examples:
    """Feature windows inside one context, at most so many of each person in each context."""

    names: tuple[str, ...]
    features: FloatArray  # (N, F)
    context: TextArray  # (N,)
    person: TextArray  # (N,)

    def of(self, names: Sequence[str]) -> FloatArray:
        """Columns of the features with these names."""
        return self.features[:, [self.names.index(n) for n in names]]

    def rows(self, use: Any) -> Examples:
        """Some of the windows."""
        return replace(self, features=self.features[use], context=self.context[use], person=self.person[use])


def in_pocket(data: Path) -> Iterator[Recording]:
    """Recordings of MotionSense, each once."""
    return (r for r in recordings(data, "motionsense") if r.name not in DUPLICATES)


def examples_of(
    walks: Iterable[Recording], stages: Mapping[str, FeatureWindows], n_windows: int
) -> dict[str, Examples]:
    """Labelled windows of all stages."""
    found: dict[str, list[tuple[FloatArray, str, str]]] = {name: [] for name in stages}
    for recording in walks:
        samples = merge_streams(recording)
        for name, stage in stages.items():
            for window in feature_windows(stage, [samples]):
                label = label_of(recording, window.time_s - stage.window_s, window.time_s)
                if label is not None:
                    found[name].append((window.features, label[0], str(recording.subject.id)))
    return {name: _balanced(stages[name].features.names, rows, n_windows) for name, rows in found.items() if rows}


def _balanced(names: tuple[str, ...], rows: list[tuple[FloatArray, str, str]], n_windows: int) -> Examples:
    """At most so many windows of each person in each context, evenly over time."""
    features, context, person = zip(*rows, strict=True)
    every = Examples(names, np.array(features), np.array(context), np.array(person))
    use: list[int] = []
    for p in np.unique(every.person):
        for c in np.unique(every.context):
            both = np.flatnonzero((every.person == p) & (every.context == c))
            n = min(n_windows, len(both))
            use += both[np.linspace(0, len(both) - 1, n).round().astype(int)].tolist() if n else []
    return every.rows(sorted(use))


def subgroups(people: Iterable[str]) -> list[list[str]]:
    """Three subgroups of people, in the order of their names."""
    return [part.tolist() for part in np.array_split(np.unique(list(people)), 3)]


def _relevance_vectors() -> Any:
    """The machine of the martinelli2018 recipe, as an estimator.

    300 candidates: 500 take half as long again and classify people left out no better.
    """
    machine = RelevanceVectorClassifier(kernel="rbf", kernel_width=3.0, max_samples=300, max_basis=200, random_state=0)
    return make_pipeline(StandardScaler(), machine)


def relevance_machine(examples: Examples, names: Sequence[str]) -> ContextModel:
    """A relevance vector machine as the paper has it: its probabilities normalised, not calibrated."""
    fitted = _relevance_vectors().fit(examples.of(names), examples.context)
    scaler, machine = fitted[0], fitted[1]
    return ContextModel(
        name="left_out",
        feature_names=tuple(names),
        classes=tuple(str(c) for c in machine.classes_),
        training_prior=_prior(examples),
        feature_mean=scaler.mean_,
        feature_scale=scaler.scale_,
        machine=machine.machine_,
        card={},
    )


def default_machine(examples: Examples) -> ContextModel:
    """The default recipe's model, of other people; the two numbers of its calibration are the shipped model's."""
    # not calibrated, which would take four times as long again
    unknown = np.full(len(examples.person), "")
    has_gyroscope = np.ones(len(examples.person), dtype=bool)
    plan, shipped = next(plan for plan in PLANS if plan.name == "context"), load_model("context")
    windows = LabelledWindows(
        examples.of(plan.feature_names), examples.context, unknown, unknown, unknown, unknown, has_gyroscope
    )
    return replace(plan.fit(windows), name="left_out", temperature=shipped.temperature, slip=shipped.slip)


def _prior(examples: Examples) -> FloatArray:
    return np.array([np.mean(examples.context == c) for c in CONTEXTS])


Train = Callable[[Examples], ContextModel]


def of_subgroups(examples: Examples, train: Train) -> list[tuple[list[str], ContextModel]]:
    """Each subgroup with a model of the people in the other two."""
    return [
        (part, train(examples.rows(~np.isin(examples.person, part)))) for part in subgroups(examples.person) if part
    ]


def confusion_of(examples: Examples, models: list[tuple[list[str], ContextModel]]) -> IntArray:
    """Confusion matrix (C, C) over all people, each classified by the model of the others."""
    label, predicted = list[int](), list[int]()
    for people, model in models:
        _classify(examples.rows(np.isin(examples.person, people)), model, label, predicted)
    return confusion_matrix(np.array(label), np.array(predicted), len(CONTEXTS))


def _classify(examples: Examples, model: ContextModel, label: list[int], predicted: list[int]) -> None:
    label += [CONTEXTS.index(c) for c in examples.context]
    predicted += [int(model.predict(x).argmax()) for x in examples.of(model.feature_names)]


def ten_fold(examples: Examples, train: Train) -> IntArray:
    """Confusion matrix (C, C) by the protocol of the paper: ten folds of windows, people on both sides."""
    fold = np.random.default_rng(0).permutation(len(examples.person)) % 10
    label, predicted = list[int](), list[int]()
    for k in range(10):
        _classify(examples.rows(fold == k), train(examples.rows(fold != k)), label, predicted)
    return confusion_matrix(np.array(label), np.array(predicted), len(CONTEXTS))


# --- Walks -----------------------------------------------------------------------------------------------------------

# Trial, start and length in s. The lengths are about those of the paper's path, from 4 s in: the phone has been put
# away by then.
_PARTS: tuple[tuple[str, float, float], ...] = (
    ("std_6", 4.0, 10.0),
    ("wlk_7", 4.0, 50.0),
    ("ups_3", 4.0, 40.0),
    ("wlk_8", 4.0, 50.0),
    ("jog_9", 4.0, 20.0),
    ("sit_5", 4.0, 15.0),
    ("wlk_15", 4.0, 25.0),
    ("dws_1", 4.0, 37.0),
    ("wlk_7", 60.0, 25.0),
    ("std_14", 4.0, 8.0),
)


def put_together(data: Path, person: str) -> Recording | None:
    """Parts of a person's recordings one after the other; None without any.

    A part that is missing is left out, a shorter recording gives what it has.
    """
    pieces: list[Piece] = []
    for trial, start_s, length_s in _PARTS:
        for recording in recordings(data, "motionsense", f"motionsense_{person}_{trial}.zip"):
            assert recording.truth.labels is not None
            force, rate = clip(recording, start_s, length_s)
            if len(force):
                pieces.append((force, rate, str(recording.truth.labels["context"][0])))
    # MotionSense: the row number divided by 50 Hz
    return joined_walk(f"put_together_{person}", pieces, 1 / 50.0, {}) if pieces else None


@dataclass(frozen=True, eq=False)
class Walk:
    """Epochs of a walk, K of them, and the contexts of K + 1 windows."""

    person: str
    context: IntArray  # (K,) true, at the middle of the epoch
    true_m: FloatArray  # (K,)
    distance_m: FloatArray  # (K, C) if every step had been of one context (eq. 17)
    context_prob: FloatArray  # (K + 1, C)
    imm_m: FloatArray  # (K,)

    def weighted_m(self, threshold: float) -> FloatArray:
        """D_k - D_(k-1) of Algorithms 1 and 2, (K,)."""
        found = weighted_distances(self.distance_m, self.context_prob, threshold)
        return 0.5 * (found.provisional_m + found.final_m)

    def by(self, weighting: str) -> FloatArray:
        """Distance of each epoch with HC, WC or IMM, (K,)."""
        return self.imm_m if weighting == "imm" else self.weighted_m({"hc": HC, "wc": WC}[weighting])

    def error_percent(self, found_m: FloatArray) -> float:
        """Of the whole walk."""
        return float(percent_error(found_m.sum(), self.true_m.sum()))


def walk_of(recording: Recording, config: Config) -> Walk:
    """The walk of a recording; its true distance is that of its steps in the true contexts."""
    found: Track = track(recording, config.with_weighting("imm"))
    modes: tuple[Mode, ...] = config.model.modes
    distance_m, context_prob = epoch_distances(found, modes)
    ends_s = found.windows.time_s[:-1]  # ends of the epochs; the last window ends no epoch
    starts_s = np.concatenate([[0.0], ends_s])[:-1]
    context, is_labelled = _context_at(recording, 0.5 * (starts_s + ends_s))
    distance_m = distance_m * is_labelled[:, None]  # unlabelled epochs count nothing
    true_m = distance_m[np.arange(len(context)), context]
    imm_m = walked_m(found.time_s, found.step_length_m, starts_s, ends_s) * is_labelled
    return Walk(str(recording.subject.id), context, true_m, distance_m, context_prob, imm_m)


def _context_at(recording: Recording, time_s: FloatArray) -> tuple[IntArray, BoolArray]:
    """True contexts at times, (T,), and whether there is a label, (T,)."""
    labels = recording.truth.labels
    assert labels is not None
    k = np.minimum(np.searchsorted(labels["end_s"], time_s, side="right"), len(labels) - 1)
    names = [str(c) for c in labels["context"][k]]
    is_labelled = np.asarray(labels["start_s"])[k] <= time_s
    is_labelled &= (time_s < np.asarray(labels["end_s"])[k]) & np.isin(names, CONTEXTS)
    return np.array([CONTEXTS.index(c) if c in CONTEXTS else 0 for c in names]), is_labelled


def walks_of_people(data: Path, models: list[tuple[list[str], ContextModel]], config: Config) -> list[Walk]:
    """A walk of each person by the model of the others."""
    walks: list[Walk] = []
    for people, model in models:
        for person in people:
            recording = put_together(data, person)
            if recording is not None:
                walks.append(replace(walk_of(recording, with_context_model(config, model)), person=person))
    return walks


# --- tables ----------------------------------------------------------------------------------------------------------

_N_WINDOWS = 40  # of each person in each context
# Diagonal of Table III, per cent, in the order of `CONTEXTS`.
_RECALL_PERCENT = (93.7, 85.2, 82.5, 95.2, 90.0, 100.0)
_ACCURACY = 91.1
# Table V: %error of subjects 1 to 15, of which Table IV has the %RMSE of subjects 1-5, 6-10, 11-15, and of all.
_TABLE_IV = {"hc": (4.5, 6.2, 11.5, 7.9), "wc": (5.7, 5.9, 3.6, 5.2)}
TABLE_V = {
    "hc": (0.6, -3.3, -5.7, -3.0, -6.9, -7.8, -3.6, -6.0, -4.5, -7.5, -13.6, -13.5, -7.8, -7.5, -13.1),
    "wc": (5.1, 1.2, 4.5, -3.3, -10.3, -9.0, 0.0, -7.5, -0.3, -6.0, -3.0, -3.9, 1.8, 1.2, -6.1),
}
_SUBGROUPS = tuple(f"subgroup {i} (paper: subjects {n})" for i, n in ((1, "1-5"), (2, "6-10"), (3, "11-15")))
Rows = tuple[Mapping[str, object], ...]


def _recalls(confusions: Mapping[str, IntArray]) -> Rows:
    """Recall of each context, macro recall and accuracy, per cent."""
    of = {name: recall(c) for name, c in confusions.items()}
    rows: list[Mapping[str, object]] = [
        {"context": c, "paper": _RECALL_PERCENT[i]} | {name: float(100.0 * r[i]) for name, r in of.items()}
        for i, c in enumerate(CONTEXTS)
    ]
    rows.append({"context": "mean of the contexts", "paper": _ACCURACY} | _percent(confusions, macro_recall))
    rows.append({"context": "accuracy", "paper": _ACCURACY} | _percent(confusions, accuracy))
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
    for k, (name, use) in enumerate([*zip(_SUBGROUPS, parts, strict=True), ("all", np.ones(len(people), bool))]):
        row: dict[str, object] = {"%RMSE of": name, "paper HC": _TABLE_IV["hc"][k], "paper WC": _TABLE_IV["wc"][k]}
        rows.append(row | {c: distance_scores(np.array(e)[use]).rmse_percent for c, e in errors.items()})
    for name, field in (("all: bias", "bias_percent"), ("all: spread", "spread_percent")):
        row = {"%RMSE of": name}
        row |= {f"paper {k.upper()}": getattr(distance_scores(v), field) for k, v in TABLE_V.items()}
        rows.append(row | {c: getattr(distance_scores(e), field) for c, e in errors.items()})
    return tuple(rows)


# Table III, %: rows the true context in the order of `CONTEXTS`, columns the found one.
_TABLE_III = np.array(
    [
        [93.7, 0.9, 0.5, 0.0, 4.9, 0.0],
        [0.0, 85.2, 9.0, 1.0, 4.8, 0.0],
        [0.0, 9.8, 82.5, 4.3, 3.4, 0.0],
        [0.0, 1.0, 3.0, 95.2, 0.8, 0.0],
        [0.0, 6.0, 2.2, 1.8, 90.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 100.0],
    ]
)


def _matrices(confusions: Mapping[str, IntArray]) -> Rows:
    """Confusion matrices, the paper's first."""
    rows: list[Mapping[str, object]] = []
    for who, matrix in {"paper, 10-fold": _TABLE_III, **confusions}.items():
        for context, counts in zip(CONTEXTS, np.asarray(matrix, dtype=float), strict=True):
            if counts.sum():
                cells = prefixed("found", CONTEXTS, (100.0 * counts / counts.sum()).tolist(), " %")
                rows.append({"who": who, "true": context} | cells)
    return tuple(rows)


def _people(errors: Columns) -> Rows:
    """Table V: error of each person; bias and spread, and %RMSE with the mean error of the others subtracted."""
    n = max(len(TABLE_V["hc"]), len(errors["ours HC"]))
    columns = {f"paper {k.upper()}": np.array(v) for k, v in TABLE_V.items()}
    columns |= {name: np.array(e) for name, e in errors.items()}
    rows: list[Mapping[str, object]] = [
        {"person": str(k + 1)} | {c: float(e[k]) if k < len(e) else NAN for c, e in columns.items()} for k in range(n)
    ]
    for name, field in (("bias", "bias_percent"), ("spread", "spread_percent"), ("RMSE", "rmse_percent")):
        rows.append({"person": name} | {c: getattr(distance_scores(e), field) for c, e in columns.items()})
    without = {c: e - (e.sum() - e) / (len(e) - 1) for c, e in columns.items()}
    rows.append({"person": "RMSE with a constant of the others"} | _rmse(without))
    return tuple(rows)


def _rmse(columns: Mapping[str, FloatArray]) -> dict[str, object]:
    return {c: distance_scores(e).rmse_percent for c, e in columns.items()}


def _thresholds(by_set: Mapping[str, Sequence[Walk]]) -> Rows:
    """Fig. 14: the threshold of Algorithm 2, from always weighted (0) to HC (above 1)."""
    rows: list[Mapping[str, object]] = []
    for threshold in (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0):
        row: dict[str, object] = {"threshold": threshold}
        for name, walks in by_set.items():
            scores = distance_scores([w.error_percent(w.weighted_m(threshold)) for w in walks])
            values = scores.rmse_percent, scores.bias_percent, scores.spread_percent
            row |= prefixed(name, ("RMSE %", "bias %", "spread %"), values)
        rows.append(row)
    return tuple(rows)


def _real_changes(data: Path, model: ContextModel) -> list[Walk]:
    """Walks of difronzo, with real changes of context, by a machine of other people at another site."""
    config = with_context_model(martinelli2018(), model)
    return [walk_of(recording, config) for recording in recordings(data, "difronzo")]


def belt(tables: Tables, arguments: argparse.Namespace) -> None:
    """Walking and running at the belt."""
    stages = {"2": FeatureWindows(features=TABLE_II)}
    train = partial(relevance_machine, names=WITHOUT_MAGNETOMETER)
    waist = examples_of(recordings(arguments.data, "sisfall"), stages, _N_WINDOWS)["2"]
    pocket = examples_of(in_pocket(arguments.data), stages, _N_WINDOWS)["2"]
    label, predicted = list[int](), list[int]()
    _classify(waist, train(pocket), label, predicted)
    confusions = {
        "ours, 10-fold": ten_fold(waist, train),
        "ours, held-out people": confusion_of(waist, of_subgroups(waist, train)),
        "ours, trained in the pocket": confusion_matrix(np.array(label), np.array(predicted), len(CONTEXTS)),
    }
    n = len(np.unique(waist.person))
    data = f"SisFall, {n} people, sensor on the belt, {len(waist.person)} windows of 2 s of walking and running"
    title = "Table III at the belt: confusion matrix, %"
    paper_table(tables, "martinelli2018_table_iii_belt", title, _matrices(confusions), data)


def windows(tables: Tables, arguments: argparse.Namespace) -> None:
    """Fig. 12: recall by the length of the window."""
    stages = {f"{s:g}": FeatureWindows(features=TABLE_II, window_s=s, hop_s=0.5 * s) for s in (1.0, 2.0, 3.0, 4.0)}
    rows: list[Mapping[str, object]] = []
    for length, examples in examples_of(in_pocket(arguments.data), stages, _N_WINDOWS).items():
        models = of_subgroups(examples, partial(relevance_machine, names=WITHOUT_MAGNETOMETER))
        confusion = confusion_of(examples, models)
        cells = {"windows": len(examples.person), "mean recall %": 100.0 * macro_recall(confusion)}
        rows.append({"length s": length} | cells)
    title = "Fig. 12: recall of held-out people by the length of the window"
    paper_table(tables, "martinelli2018_fig_12", title, rows, "MotionSense, phone in the front trouser pocket")


def recall_with(examples: Examples, names: Sequence[str]) -> float:
    """Mean recall in % of held-out people by small machines with some of the features."""
    x, classes = examples.of(names), np.unique(examples.context)
    found = np.empty(len(x), dtype=int)
    for people in subgroups(examples.person):
        test = np.isin(examples.person, people)
        # distances grow with the root of the number of features; 3 is the width of all 23
        width = 3.0 * float(np.sqrt(len(names) / len(WITHOUT_MAGNETOMETER)))
        machine = RelevanceVectorClassifier(kernel_width=width, max_samples=60, max_basis=50, max_iter=20)
        fitted = make_pipeline(StandardScaler(), machine).fit(x[~test], examples.context[~test])
        found[test] = np.searchsorted(classes, fitted.predict(x[test]))
    return 100.0 * macro_recall(confusion_matrix(np.searchsorted(classes, examples.context), found, len(classes)))


def floating_search(names: Sequence[str], score: Callable[[Sequence[str]], float]) -> list[tuple[float, list[str]]]:
    """Best score found and its features, by their number from 1 on: sequential forward floating selection.

    Each round adds the best feature, and then drops features as long as the smaller set is better than any before.
    """
    best: dict[int, tuple[float, list[str]]] = {}
    chosen = list[str]()
    while len(chosen) < len(names):
        grown = max(((score([*chosen, n]), [*chosen, n]) for n in names if n not in chosen), key=lambda found: found[0])
        chosen = grown[1]
        best[len(chosen)] = max(best.get(len(chosen), grown), grown, key=lambda found: found[0])
        while len(chosen) > 2:
            smaller = ([n for n in chosen if n != dropped] for dropped in chosen)
            shrunk = max(((score(rest), rest) for rest in smaller), key=lambda found: found[0])
            if shrunk[0] <= best[len(chosen) - 1][0]:
                break
            chosen = shrunk[1]
            best[len(chosen)] = shrunk
    return [best[k] for k in sorted(best)]


def features(tables: Tables, arguments: argparse.Namespace) -> None:
    """Fig. 10: recall by the number of features that a floating search chose."""
    warnings.simplefilter("ignore", ConvergenceWarning)
    stages = {"2": FeatureWindows(features=TABLE_II)}
    sets = {"pocket": (in_pocket(arguments.data), 8), "belt": (recordings(arguments.data, "sisfall"), 12)}
    rows: list[dict[str, object]] = [{"features": k + 1} for k in range(len(WITHOUT_MAGNETOMETER))]
    for name, (walks, n_windows) in sets.items():
        examples = examples_of(walks, stages, n_windows)["2"]
        for row, (percent, chosen) in zip(
            rows, floating_search(WITHOUT_MAGNETOMETER, partial(recall_with, examples)), strict=True
        ):
            numbers = sorted(NAMES.index(n) + 1 for n in chosen)
            row |= {f"{name}: mean recall %": percent, f"{name}: features chosen": " ".join(f"F{k}" for k in numbers)}
    title = "Fig. 10: recall of held-out people by the number of features, of a floating search by this recall"
    about = "pocket: MotionSense, five contexts, 480 windows; belt: SisFall, walking and running, 480 windows"
    paper_table(tables, "martinelli2018_fig_10", title, rows, about)


def contexts_and_distances(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tables III and IV, of the same machines."""
    stages = {"2": FeatureWindows(features=TABLE_II), "invariant": FeatureWindows(features=ATTITUDE_FREE)}
    examples = examples_of(in_pocket(arguments.data), stages, _N_WINDOWS)
    two_s, of_default = examples["2"], examples["invariant"]
    warnings.simplefilter("ignore", ConvergenceWarning)  # it warns of the budget of candidates that is meant here
    models = of_subgroups(two_s, partial(relevance_machine, names=WITHOUT_MAGNETOMETER))
    default_models = of_subgroups(of_default, default_machine)
    confusions = {
        "ours, 10-fold": ten_fold(two_s, partial(relevance_machine, names=WITHOUT_MAGNETOMETER)),
        "ours, held-out people": confusion_of(two_s, models),
        "default, held-out people": confusion_of(of_default, default_models),
    }
    n = len(np.unique(two_s.person))
    data = f"MotionSense, {n} people, phone in the front trouser pocket, {len(two_s.person)} windows of 2 s"
    title = "Table III, recall: diagonal of the confusion matrix, %"
    paper_table(tables, "martinelli2018_table_iii_recall", title, _recalls(confusions), data)
    title = "Table III: confusion matrix, %"
    paper_table(tables, "martinelli2018_table_iii", title, _matrices(confusions), data)

    walks = walks_of_people(arguments.data, models, martinelli2018())
    by_default = walks_of_people(arguments.data, default_models, default())
    errors = _errors(walks, by_default)
    rows = _table_iv(errors, [w.person for w in walks])
    data = (
        f"recordings of MotionSense put together, {len(walks)} walks of {len(walks)} people, phone in the front "
        "trouser pocket; error against the distance of the same steps in the true contexts"
    )
    title = "Table IV: %RMSE of the distance of each subgroup"
    paper_table(tables, "martinelli2018_table_iv", title, rows, data)
    title = "Table V: error of the distance of each person, %"
    paper_table(tables, "martinelli2018_table_v_people", title, _people(errors), data)
    title = "Fig. 14: errors of the distance by the threshold of WC"
    of_all = relevance_machine(two_s, names=WITHOUT_MAGNETOMETER)
    real = _real_changes(arguments.data, of_all)
    data = (
        f"joined: {len(walks)} walks of MotionSense, as Table V; real: {len(real)} walks of difronzo with real changes "
        "of context, by a machine of MotionSense; error against the distance of the same steps in the true contexts"
    )
    by_set = {"joined": walks} | ({"real": real} if real else {})
    paper_table(tables, "martinelli2018_fig_14", title, _thresholds(by_set), data)


if __name__ == "__main__":
    run_study(
        __doc__,
        Part(make=contexts_and_distances, needs=("motionsense",), uses=("difronzo",), min_people=3),
        Part(make=belt, needs=("motionsense", "sisfall"), min_people=3),
        Part(make=windows, needs=("motionsense",), min_people=3),
        Part(make=features, needs=("motionsense", "sisfall"), min_people=3),
    )
