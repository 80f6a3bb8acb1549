"""Martinelli et al. 2018: contexts by a relevance vector machine, and distances weighted by their probabilities.

Two kinds of walks through several contexts, as no public recording has a labelled one of known length. Real ones:
recordings of one person of MotionSense one after the other; their length is not known, so that a distance is compared
with that of the same steps in the true contexts, which leaves the share of the error that is the classifier's.
Simulated ones: the paper's 331 m with the phone at the waist, side steps included. People are tested in three
subgroups, as in the paper, always by machines trained on the other people.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.model import ContextModel, load_model
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.config import Config
from pdr_filter.evaluate.classification import accuracy, confusion_matrix, macro_recall, recall
from pdr_filter.evaluate.comparison import epoch_distances, second_over_first
from pdr_filter.evaluate.distance import distance_scores, percent_error, walked_m
from pdr_filter.evaluate.tracks import path_m
from pdr_filter.filter.motion import Mode
from pdr_filter.filter.step_length import FrequencyVarianceStepLength, StepLengthFit, known_length
from pdr_filter.filter.weighting import HC, weighted_distances
from pdr_filter.io.recording import Recording, Truth
from pdr_filter.papers.martinelli2018.features import NAMES, SELECTED_18, TABLE_II, WITHOUT_MAGNETOMETER
from pdr_filter.recipes import default, martinelli2018, with_context_model
from pdr_filter.recording_run import detect_steps, track
from pdr_filter.report.plotting import context_colours
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.features.windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.gait import STAIR_TREAD_M
from pdr_filter.tracks import Track
from pdr_filter.training.contexts import FEATURE_LIMIT, fit, fit_blend, label_of
from pdr_filter.values.arrays import FloatArray, IntArray, table
from pdr_filter.values.contexts import CONTEXTS
from pdr_filter.values.samples import Samples
from tests.studies.data import recordings
from tests.studies.feature_selection import Selection, select_features
from tests.studies.report import Study, StudyFigure, StudyTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TextArray = NDArray[np.str_]
Rows = tuple[Mapping[str, object], ...]

PAPER = (
    'A. Martinelli, H. Gao, P. D. Groves, S. Morosi, "Probabilistic Context-Aware Step Length Estimation for '
    'Pedestrian Dead Reckoning", IEEE Sensors Journal 18(4), pp. 1600-1611, 2018.'
)

# --- What is printed -------------------------------------------------------------------------------------------------

# Table III, per cent, rows and columns in the order of `CONTEXTS` (the paper has sideways third).
TABLE_III = np.array(
    [
        [93.7, 0.9, 0.5, 0.0, 4.9, 0.0],
        [0.0, 85.2, 9.0, 1.0, 4.8, 0.0],
        [0.0, 9.8, 82.5, 4.3, 3.4, 0.0],
        [0.0, 1.0, 3.0, 95.2, 0.8, 0.0],
        [0.0, 6.0, 2.2, 1.8, 90.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 100.0],
    ]
)
ACCURACY = 91.1
# Table IV: %RMSE with HC and WC of subjects 1-5, 6-10, 11-15, and of all.
TABLE_IV = {"hc": (4.5, 6.2, 11.5, 7.9), "wc": (5.7, 5.9, 3.6, 5.2)}
# Table V: %error of subjects 1 to 15.
TABLE_V = {
    "hc": (0.6, -3.3, -5.7, -3.0, -6.9, -7.8, -3.6, -6.0, -4.5, -7.5, -13.6, -13.5, -7.8, -7.5, -13.1),
    "wc": (5.1, 1.2, 4.5, -3.3, -10.3, -9.0, 0.0, -7.5, -0.3, -6.0, -3.0, -3.9, 1.8, 1.2, -6.1),
}
# Table VI: length in m, %error with HC and with WC.
TABLE_VI = {
    "walking": (209.9, -8.5, -5.1),
    "upstairs": (20.6, 6.2, 3.4),
    "downstairs": (30.5, -5.5, -4.2),
    "sideways": (20.0, -5.9, -2.5),
    "running": (50.0, -4.8, -3.3),
}
PATH_M = 331.0
# Of single stairs, up and down (section VI.A).
_STAIR_M = (0.29, 0.43)
_THRESHOLD = 0.8
_SUBGROUPS = tuple(f"subgroup {i} (paper: subjects {n})" for i, n in ((1, "1-5"), (2, "6-10"), (3, "11-15")))


def printed_checks() -> tuple[str, ...]:
    """What the paper's printed figures say against each other, one sentence or two each."""
    table_v = {k: np.array(v) for k, v in TABLE_V.items()}
    found_iv = {k: [distance_scores(part).rmse_percent for part in (*np.split(v, 3), v)] for k, v in table_v.items()}
    largest = max(abs(f - p) for k in found_iv for f, p in zip(found_iv[k], TABLE_IV[k], strict=True))
    length_m, *of_context = np.array(list(TABLE_VI.values())).T
    by_context = {k: float(length_m @ e / length_m.sum()) for k, e in zip(("hc", "wc"), of_context, strict=True)}
    mean = {k: float(v.mean()) for k, v in table_v.items()}
    stairs = [TABLE_VI[c][0] / m for c, m in zip(("upstairs", "downstairs"), _STAIR_M, strict=True)]
    return (
        f"Table V gives Table IV: %RMSE {found_iv['hc'][3]:.2f} (HC) and {found_iv['wc'][3]:.2f} (WC) for the printed "
        f"{TABLE_IV['hc'][3]} and {TABLE_IV['wc'][3]}; the subgroups agree within {largest:.2f}.",
        f"The errors of Table V are biased: mean {mean['hc']:.2f} (HC) and {mean['wc']:.2f} % (WC), spread "
        f"{table_v['hc'].std():.2f} and {table_v['wc'].std():.2f} %. WC's lower %RMSE is its smaller bias; its "
        "spread is the larger one.",
        f"Table VI against Table V: the errors of the contexts, weighted with their lengths, give "
        f"{by_context['hc']:.2f} % (HC) and {by_context['wc']:.2f} % (WC) of the whole path, the mean of Table V is "
        f"{mean['hc']:.2f} and {mean['wc']:.2f} %. That agrees for HC and not for WC.",
        f"The lengths of Table VI add up to {length_m.sum():.1f} m, the length of the path. Its stairs are "
        f"{stairs[0]:.1f} steps of {_STAIR_M[0]} m up and {stairs[1]:.1f} of {_STAIR_M[1]} m down: the same 71.",
        f"The diagonal of Table III has the mean {np.diagonal(TABLE_III).mean():.1f} %, which is the accuracy printed "
        f"({ACCURACY} %), as it must be with as many movements of each context.",
        'The text on the threshold has "true" for HC at 1: the second highest over the highest probability is below 1 '
        "but where the two are equal, and then Algorithm 2 weights.",
    )


# --- Windows and machines --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    """How much is done; the paper's own numbers unless said otherwise."""

    n_simulated: int = 15  # people
    walked: float = 1.0  # part of the walking and the stairs on their path
    n_windows: int = 40  # of each person in each context, in training and in Table III
    n_features: int = 23  # at which the floating search ends
    window_s: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0)


@dataclass(frozen=True, eq=False)
class _Examples:
    """Feature windows inside one context, at most so many of each person in each context."""

    names: tuple[str, ...]
    features: FloatArray  # (N, F)
    context: TextArray  # (N,)
    person: TextArray  # (N,)

    def of(self, names: Sequence[str]) -> FloatArray:
        """Columns of the features with these names."""
        return self.features[:, [self.names.index(n) for n in names]]

    def rows(self, use: Any) -> _Examples:
        """Some of the windows."""
        return replace(self, features=self.features[use], context=self.context[use], person=self.person[use])


def _examples(walks: Iterable[Recording], stages: Mapping[str, FeatureWindows], n_windows: int) -> dict[str, _Examples]:
    """Labelled windows of all stages, every recording conditioned once."""
    found: dict[str, list[tuple[FloatArray, str, str]]] = {name: [] for name in stages}
    for recording in walks:
        conditioner, attitude_estimator = Conditioner(), AttitudeEstimator()
        attitude_state, states = attitude_estimator.init(), {name: s.init() for name, s in stages.items()}
        for part in conditioner.step(conditioner.init(), merge_streams(recording))[1]:
            if part.gap_before_s > 0:
                attitude_state = attitude_estimator.after_gap(attitude_state)
                states = {name: s.init() for name, s in stages.items()}
            attitude_state, attitude = attitude_estimator.step(attitude_state, part)
            for name, stage in stages.items():
                states[name], windows = stage.step(states[name], part, attitude)
                for _, window in windows:
                    label = label_of(recording, window.time_s - stage.window_s, window.time_s)
                    if label is not None:
                        found[name].append((window.features, label[0], str(recording.subject.id)))
    return {name: _balanced(stages[name].features.names, rows, n_windows) for name, rows in found.items() if rows}


def _balanced(names: tuple[str, ...], rows: list[tuple[FloatArray, str, str]], n_windows: int) -> _Examples:
    """At most so many windows of each person in each context, evenly over time."""
    features, context, person = zip(*rows, strict=True)
    every = _Examples(names, np.array(features), np.array(context), np.array(person))
    use: list[int] = []
    for p in np.unique(every.person):
        for c in np.unique(every.context):
            both = np.flatnonzero((every.person == p) & (every.context == c))
            n = min(n_windows, len(both))
            use += both[np.linspace(0, len(both) - 1, n).round().astype(int)].tolist() if n else []
    return every.rows(sorted(use))


def _subgroups(people: Iterable[str]) -> list[list[str]]:
    """Three subgroups of people, in the order of their names."""
    return [part.tolist() for part in np.array_split(np.unique(list(people)), 3)]


def _folds(examples: _Examples) -> list[tuple[IntArray, IntArray]]:
    """Rows to train with and to test with, for each subgroup."""
    tests = [np.isin(examples.person, part) for part in _subgroups(examples.person)]
    return [(np.flatnonzero(~test), np.flatnonzero(test)) for test in tests if test.any()]


def _relevance_vectors() -> Any:
    """The machine of the martinelli2018 recipe, as an estimator.

    300 candidates: 500 take half as long again and tell people left out no better.
    """
    machine = RelevanceVectorClassifier(kernel="rbf", kernel_width=3.0, max_samples=300, max_basis=200, random_state=0)
    return make_pipeline(StandardScaler(), machine)


def _machine(examples: _Examples, names: Sequence[str]) -> ContextModel:
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


def _default_machine(examples: _Examples) -> ContextModel:
    """The default recipe's model, of other people; the two numbers of its calibration are the shipped model's."""
    weight, nobody = np.ones(len(examples.person)), np.full(len(examples.person), "")
    # without people to leave out nothing is calibrated, which would take four times as long again
    fitted = fit(fit_blend, CONTEXTS, examples.of(invariant.NAMES), examples.context, nobody, weight)
    shipped = load_model("context")
    return ContextModel(
        name="left_out",
        feature_names=invariant.NAMES,
        classes=fitted.classes,
        training_prior=_prior(examples),
        feature_mean=fitted.mean,
        feature_scale=fitted.scale,
        machine=fitted.machine,
        card={},
        temperature=shipped.temperature,
        slip=shipped.slip,
        feature_limit=FEATURE_LIMIT,
    )


def _prior(examples: _Examples) -> FloatArray:
    return np.array([np.mean(examples.context == c) for c in CONTEXTS])


Train = Callable[[_Examples], ContextModel]


def _of_subgroups(examples: _Examples, train: Train) -> list[tuple[list[str], ContextModel]]:
    """Each subgroup with a model of the people in the other two."""
    return [
        (part, train(examples.rows(~np.isin(examples.person, part)))) for part in _subgroups(examples.person) if part
    ]


def _confusion(examples: _Examples, models: list[tuple[list[str], ContextModel]]) -> IntArray:
    """Confusion matrix (C, C) over all people, each told by the model of the others."""
    label, predicted = [], []
    for people, model in models:
        of_part = examples.rows(np.isin(examples.person, people))
        label += [CONTEXTS.index(c) for c in of_part.context]
        predicted += [int(model.predict(x).argmax()) for x in of_part.of(model.feature_names)]
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


def _put_together(data: Path, person: str) -> Recording | None:
    """Parts of a person's recordings one after the other, turned to one mean gravity; None without any.

    Nothing is cross-faded. A part that is missing is left out, a shorter recording gives what it has.
    """
    force: list[FloatArray] = []
    rate: list[FloatArray] = []
    labels: list[tuple[int, str]] = []
    clock = 0
    for trial, start_s, length_s in _PARTS:
        for recording in recordings(data, "motionsense", f"motionsense_{person}_{trial}.zip"):
            assert recording.gyroscope is not None and recording.truth.labels is not None
            time_s = recording.accelerometer.time_s
            use = (time_s >= start_s) & (time_s < start_s + length_s)
            if not use.any():
                continue
            own = recording.accelerometer.values[use]
            up = force[0].mean(axis=0) if force else own.mean(axis=0)
            turn = Rotation.align_vectors([up], [own.mean(axis=0)])[0]
            force.append(turn.apply(own))
            gyroscope = recording.gyroscope
            at = [np.interp(time_s[use], gyroscope.time_s, gyroscope.values[:, i]) for i in range(3)]
            rate.append(turn.apply(np.column_stack(at)))
            clock += int(use.sum())
            labels.append((clock, str(recording.truth.labels["context"][0])))
    if not force:
        return None
    end_s = np.array([n for n, _ in labels]) / 50.0  # MotionSense: the row number divided by 50 Hz
    truth = {"start_s": np.concatenate([[0.0], end_s[:-1]]), "end_s": end_s, "context": [c for _, c in labels]}
    carrying_mode = np.array(["pocket"] * len(labels))
    time_s = np.arange(clock) / 50.0
    return Recording(
        name=f"put_together_{person}",
        accelerometer=Samples(time_s, np.concatenate(force)),
        gyroscope=Samples(time_s, np.concatenate(rate)),
        truth=Truth(labels=table({**truth, "carrying_mode": carrying_mode})),
    )


# On a belt, in front of the hip and upright: it moves with the trunk.
_WAIST = {
    "waist": Carrying(
        pivot=(0.1, 0.06, 0.06),
        pitch_rad=np.pi / 2,
        impact_sideways=0.3,
        wobble_pitch_rad=0.03,
        wobble_roll_rad=0.04,
        wobble_yaw_rad=0.06,
    )
}
_RIGHT = np.pi / 2
_N_STAIRS = 71


def _path(walked: float) -> list[Leg]:
    """The paper's lengths of each context, with its five stops, in an order of our own: Fig. 3 is a map."""
    walking = iter(walked * m for m in (60.0, 50.0, 45.0, 30.0, 24.9))
    stairs_m = round(walked * _N_STAIRS) * STAIR_TREAD_M
    stop = Leg("stationary", duration_s=8.0)
    return [
        stop,
        Leg("walking", distance_m=next(walking)),
        stop,
        Leg("upstairs", distance_m=stairs_m),
        Leg("walking", distance_m=next(walking), turn_rad=_RIGHT),
        Leg("sideways", distance_m=TABLE_VI["sideways"][0]),
        stop,
        Leg("walking", distance_m=next(walking), turn_rad=_RIGHT),
        Leg("running", distance_m=TABLE_VI["running"][0]),
        stop,
        Leg("walking", distance_m=next(walking), turn_rad=_RIGHT),
        Leg("downstairs", distance_m=stairs_m),
        stop,
        Leg("walking", distance_m=next(walking), turn_rad=_RIGHT),
        stop,
    ]


def _short_segments() -> list[Leg]:
    """What the machine learns from: every context twice, "different short path segments traveled twice"."""
    legs: list[Leg] = []
    for pace in (0.95, 1.05):
        legs.append(Leg("stationary", duration_s=11.0))
        legs += [Leg(c, duration_s=11.0, frequency_factor=pace, turn_rad=0.5) for c in CONTEXTS if c != "stationary"]
    return legs


@dataclass(frozen=True, eq=False)
class _Walk:
    """Epochs of a walk, K of them, between the ends of K + 1 windows."""

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
        return self.imm_m if weighting == "imm" else self.weighted_m({"hc": HC, "wc": _THRESHOLD}[weighting])

    def error_percent(self, found_m: FloatArray) -> float:
        """Of the whole walk."""
        return float(percent_error(found_m.sum(), self.true_m.sum()))


def _walk(recording: Recording, config: Config) -> _Walk:
    """The walk of a recording; its true distance, where it has no positions, that of its steps in the true contexts."""
    found: Track = track(recording, config.with_weighting("imm"))
    modes: tuple[Mode, ...] = config.tracker.modes
    distance_m, context_prob = epoch_distances(found, modes)
    ends_s = found.windows.time_s
    context = _context_at(recording, 0.5 * (ends_s[1:] + ends_s[:-1]))
    position = recording.truth.position
    if position is None:
        true_m = distance_m[np.arange(len(context)), context]
    else:
        along_m = path_m(np.column_stack([position.east_m, position.north_m]))
        true_m = np.diff(np.interp(ends_s, position.time_s, along_m))
    imm_m = walked_m(found.time_s, found.step_length_m, ends_s[:-1], ends_s[1:])
    return _Walk(str(recording.subject.id), context, true_m, distance_m, context_prob, imm_m)


def _context_at(recording: Recording, time_s: FloatArray) -> IntArray:
    """True contexts at times, (T,); labels follow each other without a gap."""
    labels = recording.truth.labels
    assert labels is not None
    k = np.minimum(np.searchsorted(labels["end_s"], time_s, side="right"), len(labels) - 1)
    return np.array([CONTEXTS.index(str(c)) for c in labels["context"][k]])


def _calibrated(config: Config, walk: Recording) -> Config:
    """The configuration with k0, k1, k2 of this person, by eq. 13 to 16 on parts of 10 m of the walk itself.

    Group A. Stairs (group B) have one tread, which the least squares solution gives to every step: k1 = k2 = 0.
    k1 and k2 are the person's own too; the paper fits them to all people at once.
    """
    steps, truth = detect_steps(walk, config), walk.truth
    assert truth.position is not None and truth.labels is not None
    along_m = path_m(np.column_stack([truth.position.east_m, truth.position.north_m]))
    fits = {c: known_length(STAIR_TREAD_M, 0.02) for c in ("upstairs", "downstairs")}
    for context in ("walking", "sideways", "running"):
        rows: list[tuple[float, float, float]] = []
        for label in truth.labels[truth.labels["context"] == context]:
            start_m, end_m = np.interp([label["start_s"], label["end_s"]], truth.position.time_s, along_m)
            marks_s = np.interp(np.arange(start_m, end_m + 0.01, 10.0), along_m, truth.position.time_s)
            for begin_s, end_s in pairwise(marks_s):
                own = steps[(steps.time_s > begin_s) & (steps.time_s <= end_s)]
                rows.append((len(own), own["frequency_hz"].sum(), own["variance"].sum()))
        # of few parts the smallest solution: the change with cadence and variance is then not known, and small
        theta = np.linalg.lstsq(np.array(rows), np.full(len(rows), 10.0), rcond=1e-3)[0]
        fits[context] = StepLengthFit(FrequencyVarianceStepLength(), theta, np.zeros((3, 3)), 0.06)
    modes = tuple(replace(m, step_length=fits.get(m.context, m.step_length)) for m in config.tracker.modes)
    return replace(config, tracker=replace(config.tracker, modes=modes))


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


def _errors(walks: Sequence[_Walk], default_walks: Sequence[_Walk] = ()) -> dict[str, list[float]]:
    """Errors of the walks' distances, per cent, by column."""
    columns = {f"ours {w.upper()}": [x.error_percent(x.by(w)) for x in walks] for w in ("hc", "wc", "imm")}
    if default_walks:
        columns["ours default"] = [x.error_percent(x.imm_m) for x in default_walks]
    return columns


def _table_iv(errors: Columns, people: Sequence[str]) -> Rows:
    """%RMSE of each subgroup and of all, and bias and spread of all."""
    parts = [np.isin(people, part) for part in _subgroups(people)]
    rows: list[Mapping[str, object]] = []
    for k, (name, use) in enumerate([*zip(_SUBGROUPS, parts, strict=True), ("all", np.ones(len(people), bool))]):
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


def _table_vi(walks: Sequence[_Walk], default_walks: Sequence[_Walk] = ()) -> Rows:
    """%error under each context, averaged over the people."""

    def mean_error(of: Sequence[_Walk], weighting: str, c: int) -> float:
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


def _sweep(walks: Sequence[_Walk]) -> list[float]:
    """%RMSE over the walks with WC at each threshold."""
    return [distance_scores([w.error_percent(w.weighted_m(t)) for w in walks]).rmse_percent for t in _THRESHOLDS]


def _rmse(walks: Sequence[_Walk], weighting: str) -> float:
    return distance_scores([w.error_percent(w.by(weighting)) for w in walks]).rmse_percent


# --- Figures ---------------------------------------------------------------------------------------------------------

_COLOURS = context_colours()
_BLUE, _ORANGE, _GREEN = _COLOURS["walking"], _COLOURS["upstairs"], _COLOURS["downstairs"]
_INK = "#222222"


def _draw_selection(axes: Axes, selection: Selection, machine: Mapping[int, float]) -> None:
    n = np.arange(1, len(selection.curve) + 1)
    mean = 100.0 * np.array([s.score for s in selection.curve])
    std = 100.0 * np.array([s.score_std for s in selection.curve])
    axes.fill_between(n, mean - std, mean + std, color=_BLUE, alpha=0.15, linewidth=0)
    axes.plot(n, mean, color=_BLUE, label="linear discriminant (searched)")
    of_machine = [100.0 * v for v in machine.values()]
    axes.plot(list(machine), of_machine, color=_ORANGE, marker="s", markersize=4, label="RVM, same sets")
    axes.plot(len(SELECTED_18), ACCURACY, color=_INK, marker="D", linestyle="none", label="paper's best")
    axes.set(xlabel="number of features", ylabel="accuracy, %")
    axes.legend(frameon=False, loc="lower right", fontsize="small")


def _draw_lengths(axes: Axes, accuracy_of: Mapping[float, tuple[float, float]]) -> None:
    length_s = list(accuracy_of)
    mean, std = (100.0 * np.array([v[k] for v in accuracy_of.values()]) for k in (0, 1))
    axes.errorbar(length_s, mean, std, color=_BLUE, marker="o", capsize=3, label="ours, spread of the subgroups")
    axes.plot(2.0, ACCURACY, color=_INK, marker="D", linestyle="none", label="paper, 2 s")
    axes.set(xlabel="length of the window, s", ylabel="accuracy, %", xlim=(0.0, max(length_s) + 0.25))
    axes.legend(frameon=False, loc="lower right", fontsize="small")


def _draw_sweep(axes: Axes, of: Mapping[str, Sequence[_Walk]]) -> None:
    for (name, walks), colour, marker in zip(of.items(), (_BLUE, _GREEN), ("o", "s"), strict=False):
        axes.plot(_THRESHOLDS, _sweep(walks), color=colour, marker=marker, markersize=4, label=f"{name}: WC")
        axes.axhline(_rmse(walks, "imm"), color=colour, linestyle="--", label=f"{name}: IMM")
    axes.plot(_THRESHOLD, TABLE_IV["wc"][3], color=_INK, marker="D", linestyle="none", label="paper: WC")
    axes.plot(1.0, TABLE_IV["hc"][3], color=_INK, marker="D", fillstyle="none", linestyle="none", label="paper: HC")
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


def _notes(real: Sequence[_Walk], simulated: Sequence[_Walk]) -> list[str]:
    notes: list[str] = []
    for name, walks in (("real recordings put together", real), ("simulated", simulated)):
        if walks:
            ratio = np.concatenate([second_over_first(w.context_prob) for w in walks])
            notes.append(
                f"The second highest probability is at least {_THRESHOLD} of the highest in "
                f"{100.0 * np.mean(ratio >= _THRESHOLD):.1f} % of the windows ({name}, n = {len(ratio)}): WC differs "
                "from HC in these only."
            )
    return [
        *notes,
        "Not remade: Table I and Figures 1 to 5, 9 and 11 are definitions, the map and pictures; Table II is in "
        "`pdr_filter.papers.martinelli2018.features`; Figures 6 to 8 show signals of their recordings. Fig. 13 "
        "is Table V in "
        "metres. Figures 10, 12 and 14 are not printed as numbers: of the paper's curves only the points that the text "
        "gives are drawn.",
        "Tenfold cross-validation over movements, as in the paper, puts the same person into training and test. Here "
        "people are left out always, which is harder.",
    ]


def _real(data: Path, size: Size) -> tuple[list[StudyTable], list[StudyFigure], list[_Walk]]:
    """Tables and figures of real recordings, and the walks put together of them."""
    stages = {f"{s:g}": FeatureWindows(features=TABLE_II, window_s=s, hop_s=s / 2) for s in (*size.window_s, 2.0)}
    stages["invariant"] = FeatureWindows(features=ATTITUDE_FREE)
    # sit_13 of subject 1 is the same recording as sit_5
    walks = (r for r in recordings(data, "motionsense") if r.name != "motionsense_s01_sit_13")
    examples = _examples(walks, stages, size.n_windows)
    if not examples or len(np.unique(examples["2"].person)) < 3:
        return [StudyTable(t, (), _NO_MOTIONSENSE, "nothing to compare") for t in _TITLES], [], []
    two_s, of_default = examples["2"], examples["invariant"]
    models = _of_subgroups(two_s, partial(_machine, names=WITHOUT_MAGNETOMETER))
    default_models = _of_subgroups(of_default, _default_machine)
    confusions = {"ours": _confusion(two_s, models), "ours default": _confusion(of_default, default_models)}
    real = _told(data, models, martinelli2018())
    by_default = _told(data, default_models, default())

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
    examples: Mapping[str, _Examples], size: Size, windows: str, split: str
) -> tuple[list[StudyTable], list[StudyFigure]]:
    """Accuracy against the number of features and the length of the window."""
    selection, machine = _selection(examples["2"], size)
    searched = f"{split}. The search scores a linear discriminant, the machine is trained on some of the sets it finds"
    of_length = {s: _accuracy(examples[f"{s:g}"], WITHOUT_MAGNETOMETER) for s in size.window_s if f"{s:g}" in examples}
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


def _told(data: Path, models: list[tuple[list[str], ContextModel]], config: Config) -> list[_Walk]:
    """A walk of each person, told by the model of the others."""
    walks: list[_Walk] = []
    for people, model in models:
        for person in people:
            recording = _put_together(data, person)
            if recording is not None:
                walks.append(replace(_walk(recording, with_context_model(config, model)), person=person))
    return walks


def _accuracy(examples: _Examples, names: Sequence[str]) -> tuple[float, float]:
    """Mean accuracy of the machine over the subgroups left out, and its standard deviation."""
    scores = cross_val_score(_relevance_vectors(), examples.of(names), examples.context, cv=_folds(examples))
    return float(scores.mean()), float(scores.std())


# Sizes of sets that the machine is trained on.
_SIZES = (1, 2, 4, 8, 12, 18, 23)


def _selection(examples: _Examples, size: Size) -> tuple[Selection, dict[int, float]]:
    """Floating search over the features, and the accuracy of the machine with some of the sets found."""
    estimator = LinearDiscriminantAnalysis()
    features = examples.of(WITHOUT_MAGNETOMETER)
    folds = _Splits(_folds(examples))
    selection = select_features(
        estimator, features, examples.context, cv=folds, names=WITHOUT_MAGNETOMETER, max_features=size.n_features
    )
    chosen = {n: selection.curve[n - 1] for n in _SIZES if n <= len(selection.curve)}
    return selection, {n: _accuracy(examples, subset.names)[0] for n, subset in chosen.items()}


@dataclass(frozen=True)
class _Splits:
    """Known folds, as scikit-learn asks for them."""

    folds: list[tuple[IntArray, IntArray]]

    def split(self, X: Any, y: Any, groups: Any) -> list[tuple[IntArray, IntArray]]:
        """The folds."""
        return self.folds


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


def _simulated(size: Size) -> tuple[list[StudyTable], list[_Walk]]:
    """Tables III to VI of simulated people with six contexts and a magnetometer, and their walks."""
    people = {f"{i + 1:02d}": i for i in range(size.n_simulated)}
    short = (_simulate(_short_segments(), i, name) for name, i in people.items())
    examples = _examples(short, {"2": FeatureWindows(features=TABLE_II)}, size.n_windows)["2"]
    models = _of_subgroups(examples, partial(_machine, names=NAMES))
    walks: list[_Walk] = []
    for part, model in models:
        for name in part:
            recording = _simulate(_path(size.walked), people[name], name)
            config = with_context_model(martinelli2018(), model)
            walks.append(replace(_walk(recording, _calibrated(config, recording)), person=name))
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
            "Table III, simulated: confusion matrix, %", _table_iii(_confusion(examples, models)), windows, easy
        ),
        StudyTable(
            "Table IV, simulated: %RMSE of the distance of each subgroup", _table_iv(errors, names), of_walks, of_path
        ),
        StudyTable(
            "Table V, simulated: %error of the distance of each subject", _table_v(errors, names), of_walks, of_path
        ),
        StudyTable("Table VI, simulated: %error of the distance in each context", _table_vi(walks), of_walks, of_path),
    ], walks


def _simulate(legs: Sequence[Leg], seed: int, name: str) -> Recording:
    """A simulated person's walk; `name` is the subject."""
    walk = simulate(legs, Gait.random(seed), "waist", seed=seed, carrying=_WAIST)
    return replace(walk, meta={**walk.meta, "subject": {**walk.meta["subject"], "id": name}})


def _sweep_table(real: Sequence[_Walk], simulated: Sequence[_Walk]) -> StudyTable:
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
    return TABLE_IV["wc"][3] if threshold == _THRESHOLD else np.nan


def _sweep_figure(real: Sequence[_Walk], simulated: Sequence[_Walk]) -> StudyFigure:
    of = {"real": real} if real else {}
    return StudyFigure(
        "Fig. 14: %RMSE of the distance against the threshold",
        partial(_draw_sweep, of={**of, "simulated": simulated}),
        _of_both(real, simulated),
        "as in Tables IV to VI; IMM has no threshold",
    )


def _of_both(real: Sequence[_Walk], simulated: Sequence[_Walk]) -> str:
    return f"simulated: {len(simulated)} walks; real recordings put together: {len(real)} walks, as in Table IV"


if __name__ == "__main__":
    from tests.studies.run import run

    run(study)
