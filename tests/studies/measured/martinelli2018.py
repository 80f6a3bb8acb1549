"""What is measured here for the tables of Martinelli et al. 2018."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.evaluate.classification import confusion_matrix
from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.evaluate.runs import epoch_distances
from pdr_filter.evaluate.tracks import path_m
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.weighting import HC, weighted_distances
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength, StepLengthFit, known_length
from pdr_filter.offline.training.context_training import PLANS
from pdr_filter.offline.training.cross_validation import LabelledWindows, label_of
from pdr_filter.recipes import with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.martinelli2018.features import WITHOUT_MAGNETOMETER
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.gait import STAIR_TREAD_M
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import detect_steps, track
from pdr_filter.values import CONTEXTS, FloatArray, IntArray, Samples, table
from pdr_filter.values.recording import Recording, Truth
from tests.studies.data import recordings, with_subject
from tests.studies.feature_selection import Selection, select_features
from tests.studies.printed.martinelli2018 import TABLE_VI, THRESHOLD

if TYPE_CHECKING:
    pass

TextArray = NDArray[np.str_]


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


def examples_of(
    walks: Iterable[Recording], stages: Mapping[str, FeatureWindows], n_windows: int
) -> dict[str, Examples]:
    """Labelled windows of all stages, every recording conditioned once."""
    found: dict[str, list[tuple[FloatArray, str, str]]] = {name: [] for name in stages}
    for recording in walks:
        conditioner, attitude_estimator = Conditioner(), AttitudeEstimator()
        attitude_state, states = attitude_estimator.init(), {name: s.init() for name, s in stages.items()}
        for part in conditioner.update(conditioner.init(), merge_streams(recording))[1]:
            if part.gap_before_s > 0:
                attitude_state = attitude_estimator.after_gap(attitude_state)
                states = {name: s.init() for name, s in stages.items()}
            attitude_state, attitude = attitude_estimator.update(attitude_state, part)
            for name, stage in stages.items():
                states[name], windows = stage.update(states[name], part, attitude)
                for _, window in windows:
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


def _folds(examples: Examples) -> list[tuple[IntArray, IntArray]]:
    """Rows to train with and to test with, for each subgroup."""
    tests = [np.isin(examples.person, part) for part in subgroups(examples.person)]
    return [(np.flatnonzero(~test), np.flatnonzero(test)) for test in tests if test.any()]


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
    return replace(plan.fit_machine(windows), name="left_out", temperature=shipped.temperature, slip=shipped.slip)


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
    "waist": Carrying(place=(0.1, 0.06, 0.59), strides="texting", pitch_rad=np.pi / 2),
}
_RIGHT = np.pi / 2
_N_STAIRS = 71


def walked_path(walked: float) -> list[Leg]:
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


def short_segments() -> list[Leg]:
    """What the machine learns from: every context twice, "different short path segments traveled twice"."""
    legs: list[Leg] = []
    for pace in (0.95, 1.05):
        legs.append(Leg("stationary", duration_s=11.0))
        legs += [Leg(c, duration_s=11.0, frequency_factor=pace, turn_rad=0.5) for c in CONTEXTS if c != "stationary"]
    return legs


@dataclass(frozen=True, eq=False)
class Walk:
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
        return self.imm_m if weighting == "imm" else self.weighted_m({"hc": HC, "wc": THRESHOLD}[weighting])

    def error_percent(self, found_m: FloatArray) -> float:
        """Of the whole walk."""
        return float(percent_error(found_m.sum(), self.true_m.sum()))


def walk_of(recording: Recording, config: Config) -> Walk:
    """The walk of a recording; its true distance, where it has no positions, that of its steps in the true contexts."""
    found: Track = track(recording, config.with_weighting("imm"))
    modes: tuple[Mode, ...] = config.model.modes
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
    return Walk(str(recording.subject.id), context, true_m, distance_m, context_prob, imm_m)


def _context_at(recording: Recording, time_s: FloatArray) -> IntArray:
    """True contexts at times, (T,); labels follow each other without a gap."""
    labels = recording.truth.labels
    assert labels is not None
    k = np.minimum(np.searchsorted(labels["end_s"], time_s, side="right"), len(labels) - 1)
    return np.array([CONTEXTS.index(str(c)) for c in labels["context"][k]])


def calibrated(config: Config, walk: Recording) -> Config:
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
    modes = tuple(replace(m, step_length=fits.get(m.context, m.step_length)) for m in config.model.modes)
    return config.with_model(modes=modes)


def walks_of_people(data: Path, models: list[tuple[list[str], ContextModel]], config: Config) -> list[Walk]:
    """A walk of each person by the model of the others."""
    walks: list[Walk] = []
    for people, model in models:
        for person in people:
            recording = _put_together(data, person)
            if recording is not None:
                walks.append(replace(walk_of(recording, with_context_model(config, model)), person=person))
    return walks


def machine_accuracy(examples: Examples, names: Sequence[str]) -> tuple[float, float]:
    """Mean accuracy of the machine over the subgroups left out, and its standard deviation."""
    scores = cross_val_score(_relevance_vectors(), examples.of(names), examples.context, cv=_folds(examples))
    return float(scores.mean()), float(scores.std())


# Sizes of sets that the machine is trained on.
_SIZES = (1, 2, 4, 8, 12, 18, 23)


def searched_features(examples: Examples, size: Size) -> tuple[Selection, dict[int, float]]:
    """Floating search over the features, and the accuracy of the machine with some of the sets found."""
    estimator = LinearDiscriminantAnalysis()
    features = examples.of(WITHOUT_MAGNETOMETER)
    folds = _Splits(_folds(examples))
    selection = select_features(
        estimator, features, examples.context, cv=folds, names=WITHOUT_MAGNETOMETER, max_features=size.n_features
    )
    chosen = {n: selection.curve[n - 1] for n in _SIZES if n <= len(selection.curve)}
    return selection, {n: machine_accuracy(examples, subset.names)[0] for n, subset in chosen.items()}


@dataclass(frozen=True)
class _Splits:
    """Known folds, as scikit-learn asks for them."""

    folds: list[tuple[IntArray, IntArray]]

    def split(self, X: Any, y: Any, groups: Any) -> list[tuple[IntArray, IntArray]]:
        """The folds."""
        return self.folds


def simulated_person(legs: Sequence[Leg], seed: int, name: str) -> Recording:
    """A simulated person's walk; `name` is the subject."""
    walk = simulate(legs, Gait.random(seed), "waist", seed=seed, carrying=_WAIST)
    return with_subject(walk, id=name)
