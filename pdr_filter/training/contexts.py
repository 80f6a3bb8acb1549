"""Train the shipped context models on labelled recordings, and say how good they are on people left out.

`pdr-filter train DATA_DIR` runs it. Every figure on a model card is of people (or sites) that the scored model has
not seen; the shipped model is then fitted on all of them. Transitions and tempering come last, from the recordings in
which people change their context (`train_evidence`).
"""

from __future__ import annotations

import datetime
import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import sklearn
from joblib import Parallel, delayed
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.blend import Blend
from pdr_filter.classifiers.boosting import BoostedTrees
from pdr_filter.classifiers.familiarity import Familiarity, fit_familiarity
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.model import HEADS, ContextModel, Machine
from pdr_filter.classifiers.probability_calibration import (
    brier_score,
    fit_calibration,
    reliability,
    slipped,
    tempered,
)
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier, stratified_rows
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.io.formats import read
from pdr_filter.io.recording import Recording
from pdr_filter.papers.martinelli2018 import features as martinelli
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features import carrying, invariant
from pdr_filter.sensing.features.windows import ATTITUDE_FREE, FeatureSet, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.contexts import CONTEXTS

Progress = Callable[[str, float], None]
TextArray = NDArray[np.str_]

# Held-out people are those of MotionSense: the only set with stairs, and with more than a few people.
SCORED_DATASET = "motionsense"


FEATURE_SETS: dict[str, FeatureSet] = {s.name: s for s in (martinelli.TABLE_II, ATTITUDE_FREE)}

# Of the default recipe: transitions and tempering are estimated for it.
DEFAULT_MODEL = "context"
# Standard deviations at which a feature is cut: beyond them there is nothing to learn from.
FEATURE_LIMIT = 4.0


def fit_softmax(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[SoftmaxRegression, tuple[str, ...]]:
    """Multinomial logistic regression and its classes.

    C: 0.1 to 0.005 give the same log loss within 0.02 on people left out; below, the probabilities get less sure than
    the temperature is meant to mend.
    """
    fitted: Any = LogisticRegression(C=0.02, max_iter=300, tol=1e-3).fit(Z, y, sample_weight=weight)
    return SoftmaxRegression(fitted.coef_, fitted.intercept_), _names(fitted.classes_)


def fit_blend(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, tuple[str, ...]]:
    """The mean of logistic regression and boosted trees, and its classes.

    A fifth of the features for each split and at least 50 windows in a leaf: the trees then differ and do not learn one
    person's habits (log loss 0.149 -> 0.147 on people left out, and 0.35 -> 0.34 in the pockets of ubicomp13).
    """
    linear, classes = fit_softmax(Z, y, weight)
    options: Any = {"max_iter": 100, "max_leaf_nodes": 15, "max_features": 0.2, "min_samples_leaf": 50}
    boosting = HistGradientBoostingClassifier(**options, early_stopping=cast(Any, False), random_state=0)
    # The stored trees compare float32 numbers: trained on such, they decide everywhere as scikit-learn's.
    boosting.fit(Z.astype(np.float32).astype(np.float64), y, sample_weight=weight)
    return Blend(linear, BoostedTrees.from_sklearn(boosting)), classes


def fit_relevance_vectors(
    Z: FloatArray,
    y: TextArray,
    weight: FloatArray,
    kernel: str = "rbf",
    kernel_width: float | None = None,
    window_weight: float = 0.1,
    max_rows: int = 20_000,
    max_samples: int = 1000,
) -> tuple[Machine, tuple[str, ...]]:
    """Relevance vector machine, one-against-all, and its classes.

    Training time grows with rows, so at most `max_rows` are drawn, class by class. A window counts as `window_weight`
    of an independent example: half of its samples are also in its neighbour's, and the steps of one person are alike;
    counted in full, the evidence is sure of what is a habit of the people in training (macro recall 0.935 instead of
    0.95 on people left out). `kernel_width` None is one and a half times the distance of two typical windows, which is
    the square root of twice the number of features.
    """
    rows = np.arange(len(y))
    if len(y) > max_rows:
        label = np.unique(y, return_inverse=True)[1].astype(np.int64)
        rows = stratified_rows(label, max_rows, np.random.RandomState(0))
    classifier = RelevanceVectorClassifier(
        kernel=kernel,
        kernel_width=1.5 * np.sqrt(2.0 * Z.shape[1]) if kernel_width is None else kernel_width,
        max_samples=max_samples,
        max_basis=200,
        random_state=0,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # it warns of the budget of candidates that is meant here
        classifier.fit(Z[rows], y[rows], sample_weight=window_weight * weight[rows])
    return classifier.machine_, _names(classifier.classes_)


def fit_forest(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, tuple[str, ...]]:
    """A random forest of 50 trees and its classes."""
    # Leaves of 20 windows: smaller ones memorise people and cost log loss (0.35 -> 0.38 with 5).
    forest = RandomForestClassifier(50, min_samples_leaf=20, random_state=0, n_jobs=1).fit(Z, y, sample_weight=weight)
    return Forest.from_sklearn(forest), _names(forest.classes_)


def _names(classes: NDArray[Any]) -> tuple[str, ...]:
    return tuple(str(c) for c in classes)


MachineFit = Callable[[FloatArray, TextArray, FloatArray], tuple[Machine, tuple[str, ...]]]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A machine with what its features need first, and its temperature."""

    machine: Machine
    classes: tuple[str, ...]
    labels: tuple[str, ...]
    mean: FloatArray  # (F,)
    scale: FloatArray  # (F,)
    temperature: float = 1.0
    slip: float = 0.0

    def prob(self, X: FloatArray) -> FloatArray:
        """Probabilities (N, L) of `labels`, by the same arrays that are stored."""
        result = np.zeros((len(X), len(self.labels)))
        columns = [self.labels.index(c) for c in self.classes]
        cut = np.clip((X - self.mean) / self.scale, -FEATURE_LIMIT, FEATURE_LIMIT)
        result[:, columns] = slipped(tempered(self.machine.predict_proba(cut), self.temperature), self.slip)
        return result


def fit(
    machine_fit: MachineFit, labels: tuple[str, ...], X: FloatArray, y: TextArray, person: TextArray, weight: FloatArray
) -> Fitted:
    """A machine fitted on windows, its calibration on people left out one fold of four at a time.

    Only people whose site has at least four of them are left out; the others stay in training. The calibration is then
    that of new people. Were a site's only person left out, it would be that of new sites as well, and make the machine
    unsure about everybody; `Familiarity` is the guard there.
    """
    once = _fit_once(machine_fit, labels, X, y, weight)
    leave = np.flatnonzero(_of_large_sites(person))
    if not len(leave):
        return once
    out_of_fold = np.zeros((len(leave), len(labels)))
    for _, test in GroupKFold(4).split(leave, groups=person[leave]):
        rest = np.setdiff1d(np.arange(len(y)), leave[test])
        part = _fit_once(machine_fit, labels, X[rest], y[rest], weight[rest])
        out_of_fold[test] = part.prob(X[leave[test]])
    columns = [labels.index(c) for c in once.classes]
    label = np.array([once.classes.index(c) for c in y[leave]])
    temperature, slip = fit_calibration(out_of_fold[:, columns], label)
    return replace(once, temperature=temperature, slip=slip)


def _of_large_sites(person: TextArray) -> BoolArray:
    """Which windows are of a data set with at least four people; a person is "data set/subject"."""
    people = np.unique(person)
    site = [name.split("/")[0] for name in people]
    large = [name for name, s in zip(people, site, strict=True) if site.count(s) >= 4]
    return np.isin(person, large)


def _fit_once(
    machine_fit: MachineFit, labels: tuple[str, ...], X: FloatArray, y: TextArray, weight: FloatArray
) -> Fitted:
    mean, std = X.mean(axis=0), X.std(axis=0)
    scale = np.where(std > 0, std, 1.0)
    machine, classes = machine_fit(np.clip((X - mean) / scale, -FEATURE_LIMIT, FEATURE_LIMIT), y, weight)
    return Fitted(machine, classes, labels, mean, scale)


@dataclass(frozen=True)
class Plan:
    """How one shipped model is made.

    `datasets` and `carrying_modes` choose its windows; all carrying modes, and windows without one, if it is None.
    """

    name: str
    head: str
    feature_set: str
    feature_names: tuple[str, ...]
    datasets: tuple[str, ...]
    machine_fit: MachineFit
    description: str
    use: str
    limits: str
    carrying_modes: tuple[str, ...] | None = None

    @property
    def needs_gyroscope(self) -> bool:
        """Whether windows without angular rate are of no use."""
        accelerometer_only = {*martinelli.WITHOUT_GYROSCOPE, *invariant.WITHOUT_GYROSCOPE, *carrying.WITHOUT_GYROSCOPE}
        return not set(self.feature_names) <= accelerometer_only

    @property
    def windows(self) -> tuple[str, bool]:
        """Feature set of its windows, and whether the recordings keep their gyroscopes.

        A model for phones without gyroscope learns from windows without: the attitude, and with it what is vertical,
        is another when it comes from the accelerometer alone.
        """
        return self.feature_set, self.needs_gyroscope

    def rows(self, windows: LabelledWindows) -> BoolArray:
        """Which windows the model is made of, (W,)."""
        use = np.isin(windows.dataset, self.datasets) & (windows.has_gyroscope | (not self.needs_gyroscope))
        use &= windows.label(self.head) != ""
        return use if self.carrying_modes is None else use & np.isin(windows.carrying_mode, self.carrying_modes)

    def features(self, windows: LabelledWindows) -> FloatArray:
        """The model's features of all windows, (W, F)."""
        names = FEATURE_SETS[self.feature_set].names
        return windows.features[:, [names.index(name) for name in self.feature_names]]


_ALL_SITES = ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford")
_NO_SIDEWAYS = "No sideways walking in the data: its probability is zero."
_GYROSCOPE_SITES = ("motionsense", "tyrex", "humolire", "ms_indoor")
_FROM_POCKETS = (
    "Stairs, standing and sitting are known from the trouser pockets of one building's people, running from pockets "
    "and one person's hand."
)
PLANS: tuple[Plan, ...] = (
    Plan(
        "context",
        "context",
        "invariant",
        invariant.NAMES,
        _GYROSCOPE_SITES,
        fit_blend,
        "Mean of logistic regression and boosted trees on all attitude-free features; the default recipe.",
        "A phone in a trouser pocket or in the hand; bags and shirt pockets were not in training but come out well.",
        f"{_NO_SIDEWAYS} {_FROM_POCKETS}",
    ),
    Plan(
        "context_accelerometer",
        "context",
        "invariant",
        invariant.WITHOUT_GYROSCOPE,
        _ALL_SITES,
        fit_blend,
        "Mean of logistic regression and boosted trees on the attitude-free features of the accelerometer.",
        "Windows without angular rate, however the phone is carried.",
        f"{_NO_SIDEWAYS} {_FROM_POCKETS} One window on stairs in three is missed.",
    ),
    Plan(
        "context_pocket",
        "context",
        "invariant",
        invariant.NAMES,
        ("motionsense", "tyrex"),
        fit_softmax,
        "Logistic regression on all attitude-free features, of pockets only.",
        "Studies with the phone in the front trouser pocket: it tells stairs best there.",
        f"{_NO_SIDEWAYS} Not for a phone in the hand: it takes nearly all walking there for stairs.",
        ("pocket",),
    ),
    Plan(
        "context_hand",
        "context",
        "invariant",
        invariant.NAMES,
        _GYROSCOPE_SITES,
        fit_softmax,
        "Logistic regression on all attitude-free features; the linear half of the default, in 7 us a window.",
        "A phone in the hand on devices where the trees of the default cost too much.",
        f"{_NO_SIDEWAYS} {_FROM_POCKETS}",
    ),
    Plan(
        "context_waist",
        "context",
        "invariant",
        invariant.VERTICAL,
        _ALL_SITES,
        fit_softmax,
        "Logistic regression on the attitude-free features of the vertical acceleration alone.",
        "A phone or sensor fixed to the trunk: it bounces with the body and does not swing with a limb.",
        f"{_NO_SIDEWAYS} No recording of a sensor at the waist is among the data: it takes only what every carrying "
        "mode shares, the vertical motion of the body.",
    ),
    Plan(
        "context_rvm",
        "context",
        "invariant",
        invariant.NAMES,
        _GYROSCOPE_SITES,
        fit_relevance_vectors,
        "Relevance vector machine, one-against-all, RBF kernel, on all attitude-free features.",
        "As the default, where relevance vectors are wanted.",
        f"{_NO_SIDEWAYS} {_FROM_POCKETS}",
    ),
    Plan(
        "context_martinelli_rvm",
        "context",
        "martinelli",
        martinelli.WITHOUT_MAGNETOMETER,
        ("motionsense", "tyrex"),
        partial(fit_relevance_vectors, kernel_width=3.0, window_weight=1.0, max_rows=4000, max_samples=500),
        "Relevance vector machine, one-against-all, RBF kernel, on the 23 features of accelerometer and gyroscope of "
        "Martinelli et al. 2018; the martinelli2018 recipe.",
        "Comparison with the paper; trouser pockets.",
        f"{_NO_SIDEWAYS} Hand-held walking is taken for stairs: it knows the hand from one person.",
    ),
    Plan(
        "context_martinelli_forest",
        "context",
        "martinelli",
        martinelli.WITHOUT_GYROSCOPE,
        _ALL_SITES,
        fit_forest,
        "Random forest on the 16 accelerometer features of Martinelli et al. 2018.",
        "The martinelli2018 recipe where the gyroscope is missing.",
        f"{_NO_SIDEWAYS} Stairs are known from trouser pockets only.",
    ),
)


@dataclass(frozen=True, eq=False)
class LabelledWindows:
    """Feature windows that lie inside one label, with whose they are."""

    features: FloatArray  # (W, F)
    context: TextArray  # (W,)
    carrying_mode: TextArray  # (W,)
    person: TextArray  # (W,) dataset/subject
    dataset: TextArray  # (W,)
    recording: TextArray  # (W,) name
    has_gyroscope: BoolArray  # (W,)

    def label(self, head: str) -> TextArray:
        """True labels of a head, "" where unknown."""
        return self.context if head == "context" else self.carrying_mode


def labelled_windows(
    paths: Sequence[Path],
    progress: Progress | None = None,
    feature_set: str = "martinelli",
    with_gyroscope: bool = True,
) -> LabelledWindows:
    """Windows of recordings that lie wholly inside a label with a known context, with or without their gyroscopes."""
    stage = FeatureWindows(features=FEATURE_SETS[feature_set])
    rows: list[tuple[FloatArray, str, str, str, str, str, bool]] = []
    for i, path in enumerate(paths):
        recording = read(path)
        if not with_gyroscope:
            recording = replace(recording, gyroscope=None)
        person = f"{recording.meta.get('dataset', '')}/{recording.subject.id}"
        for window in feature_windows(stage, [merge_streams(recording)]):
            label = label_of(recording, window.time_s - stage.window_s, window.time_s)
            if label is not None:
                dataset = str(recording.meta.get("dataset", ""))
                rows.append((window.features, *label, person, dataset, recording.name, window.has_gyroscope))
        if progress is not None:
            progress(f"features of {path.stem}", (i + 1) / len(paths))
    if not rows:
        raise ValueError("no labelled windows: the recordings need truth_labels.csv with known contexts")
    features, context, carrying_mode, person, dataset, name, has_gyroscope = zip(*rows, strict=True)
    return LabelledWindows(
        np.array(features),
        np.array(context),
        np.array(carrying_mode),
        np.array(person),
        np.array(dataset),
        np.array(name),
        np.array(has_gyroscope),
    )


def label_of(recording: Recording, start_s: float, end_s: float) -> tuple[str, str] | None:
    """Context and carrying mode of the label that a window lies inside, None outside every known context."""
    labels = recording.truth.labels
    if labels is None:
        return None
    # Half a sample of slack: labels start with the first sample, windows half an interval before its middle.
    slack_s = 0.02
    for label in labels:
        if label["start_s"] - slack_s <= start_s and end_s <= label["end_s"] + slack_s and label["context"]:
            return str(label["context"]), str(label["carrying_mode"])
    return None


def train(
    data_dir: Path | None, out_dir: Path, progress: Progress | None = None, sequences_dir: Path | None = None
) -> list[dict[str, Any]]:
    """Cards of the models that were trained and written to `out_dir`, and of the transitions and exponents.

    Parameters
    ----------
    data_dir : Path, optional
        Folder with one folder for each data set of `PLANS`. Without it no model is trained, and transitions and
        exponents are those of the shipped models.
    out_dir : Path
        Where `<name>.npz`, `<name>.json` and `transitions.json` go.
    progress : callable, optional
        Called with what is done and the fraction of the whole, 0 to 1.
    sequences_dir : Path, optional
        Folder of further labelled recordings in which people change their context: for transitions and exponents
        only, no model is trained on them.
    """

    def tell(what: str, fraction: float) -> None:
        if progress is not None:
            progress(what, fraction)

    from pdr_filter.training.carrying import train_carrying  # they build on this module
    from pdr_filter.training.evidence import changing_recordings, shipped_model_without, train_evidence
    from pdr_filter.training.guo2018 import train_guo

    if data_dir is None:
        if sequences_dir is None:
            raise ValueError("nothing to train on: give the folder of the data sets, or one of labelled sequences")
        changing = changing_recordings(_recordings_in(sequences_dir))
        return [train_evidence(changing, out_dir, shipped_model_without, tell)]
    wanted = sorted({d for plan in PLANS for d in plan.datasets})
    paths = [p for d in wanted for p in sorted((data_dir / d).glob("*.zip")) if p.stem != "motionsense_s01_sit_13"]
    if not paths:
        raise ValueError(f"{data_dir} holds none of the data sets {wanted}; give the folder that holds theirs")
    # before the models: a recording that cannot be read shows at once
    changing = changing_recordings([*paths, *(_recordings_in(sequences_dir) if sequences_dir else [])])
    # One thread for the matrices: they are small, and threads that wait for each other cost ten times what they gain.
    with threadpool_limits(1):
        cards: list[dict[str, Any]] = []
        left_out: dict[str, Callable[[Sequence[str]], ContextModel]] = {}
        for kind in sorted({plan.windows for plan in PLANS}):
            plans = [plan for plan in PLANS if plan.windows == kind]
            span = 0.85 * len(plans) / len(PLANS)
            start = 0.85 * len(cards) / len(PLANS)
            windows = labelled_windows(paths, _part(tell, start, 0.2 * span), *kind)
            for i, plan in enumerate(plans):
                part = _part(tell, start + (0.2 + 0.8 * i / len(plans)) * span, 0.8 * span / len(plans))
                model = train_one(plan, windows, part)
                model.save(out_dir)
                cards.append(dict(model.card))
                left_out[plan.name] = partial(model_without, model, plan, windows)
        cards += train_carrying(paths, out_dir, _part(tell, 0.85, 0.1))
        cards.append(train_guo(paths, out_dir, _part(tell, 0.95, 0.04)))
        return [*cards, train_evidence(changing, out_dir, left_out[DEFAULT_MODEL], _part(tell, 0.99, 0.01))]


def _recordings_in(folder: Path) -> list[Path]:
    from pdr_filter.batch.run import recordings_in

    found = recordings_in(folder)
    if not found:
        raise ValueError(f"{folder}: no recordings in it; give a folder of recordings with truth_labels.csv")
    return found


def _part(tell: Progress, start: float, span: float) -> Progress:
    """Progress of a part of the whole."""
    return lambda what, fraction: tell(what, start + span * fraction)


def train_one(plan: Plan, windows: LabelledWindows, progress: Progress) -> ContextModel:
    """The model of one plan, fitted on all its people, its card scored on people left out."""
    use, labels = plan.rows(windows), HEADS[plan.head]
    X, y = plan.features(windows)[use], windows.label(plan.head)[use]
    person, dataset = windows.person[use], windows.dataset[use]
    weight = np.ones(len(y))

    held_out = np.unique(person[dataset == SCORED_DATASET])
    prob, distance = np.zeros((len(y), len(labels))), np.zeros(len(y))
    left_out: Any = Parallel(n_jobs=-1, return_as="generator")(
        delayed(_left_out)(plan.machine_fit, labels, X, y, person, weight, person == name) for name in held_out
    )
    for i, (name, (test_prob, test_distance)) in enumerate(zip(held_out, left_out, strict=True)):
        prob[person == name], distance[person == name] = test_prob, test_distance
        progress(f"{plan.name}: without {name}", (i + 1) / (len(held_out) + 2))
    scored = dataset == SCORED_DATASET
    scores = score(y[scored], prob[scored], labels)
    accuracy = [np.mean(_predicted(prob[person == p], labels) == y[person == p]) for p in held_out]
    scores["worst_person_accuracy"] = round(float(min(accuracy)), 4)
    fitted = fit(plan.machine_fit, labels, X, y, person, weight)
    progress(f"{plan.name}: all people", 1 - 1 / (len(held_out) + 2))
    sites: dict[str, Any] = {}
    for site in plan.datasets:
        if site not in (SCORED_DATASET, "tyrex"):
            rest = dataset != site
            without = _fit_once(plan.machine_fit, labels, X[rest], y[rest], weight[rest])
            without = replace(without, temperature=fitted.temperature, slip=fitted.slip)
            sites[site] = _walking_scores(without.prob(X[~rest]))
    progress(f"{plan.name}: done", 1.0)
    return ContextModel(
        name=plan.name,
        feature_names=plan.feature_names,
        classes=fitted.classes,
        training_prior=_shares(y, labels),
        feature_mean=fitted.mean,
        feature_scale=fitted.scale,
        machine=fitted.machine,
        card=card_of(plan, y, person, scores, sites),
        head=plan.head,
        temperature=fitted.temperature,
        slip=fitted.slip,
        feature_limit=FEATURE_LIMIT,
        familiarity=_familiarity(X, fitted, float(np.quantile(distance[scored], 0.99))),
    )


def model_without(model: ContextModel, plan: Plan, windows: LabelledWindows, people: Sequence[str]) -> ContextModel:
    """The model of a plan as it is when these people are not in its training; itself if none of them was.

    The limit of what is familiar stays: it is that of people left out already.
    """
    use = plan.rows(windows)
    rest = use & ~np.isin(windows.person, people)
    if rest.sum() == use.sum():
        return model
    X, y, labels = plan.features(windows)[rest], windows.label(plan.head)[rest], HEADS[plan.head]
    fitted = fit(plan.machine_fit, labels, X, y, windows.person[rest], np.ones(len(y)))
    return replace(
        model,
        classes=fitted.classes,
        training_prior=_shares(y, labels),
        feature_mean=fitted.mean,
        feature_scale=fitted.scale,
        machine=fitted.machine,
        temperature=fitted.temperature,
        slip=fitted.slip,
        familiarity=None if model.familiarity is None else _familiarity(X, fitted, model.familiarity.limit),
    )


def _shares(y: TextArray, labels: tuple[str, ...]) -> FloatArray:
    return np.array([np.mean(y == c) for c in labels])


def _left_out(
    machine_fit: MachineFit,
    labels: tuple[str, ...],
    X: FloatArray,
    y: TextArray,
    person: TextArray,
    weight: FloatArray,
    test: BoolArray,
) -> tuple[FloatArray, FloatArray]:
    """Probabilities (W, L) of the windows to test, and their distances (W,) from those trained on."""
    rest = ~test
    with threadpool_limits(1):
        fitted = fit(machine_fit, labels, X[rest], y[rest], person[rest], weight[rest])
        familiarity = _familiarity(X[rest], fitted, 1.0)
        distance = np.array([familiarity.distance(z) for z in (X[test] - fitted.mean) / fitted.scale])
        return fitted.prob(X[test]), distance


def _familiarity(X: FloatArray, fitted: Fitted, limit: float) -> Familiarity:
    return fit_familiarity((X - fitted.mean) / fitted.scale, limit)


def _predicted(prob: FloatArray, labels: tuple[str, ...]) -> TextArray:
    return np.array(labels)[prob.argmax(axis=1)]


def score(truth: TextArray, prob: FloatArray, labels: tuple[str, ...] = CONTEXTS) -> dict[str, Any]:
    """Accuracy, macro recall, recall of each class, log loss, Brier score and calibration error of (W, L)."""
    present = [c for c in labels if (truth == c).any()]
    predicted = _predicted(prob, labels)
    recall = np.array([np.mean(predicted[truth == c] == c) for c in present])
    label = np.array([labels.index(c) for c in truth])
    return {
        "n_windows": len(truth),
        "accuracy": round(float(np.mean(predicted == truth)), 4),
        "macro_recall": round(float(recall.mean()), 4),
        "recall": {c: round(float(r), 4) for c, r in zip(present, recall, strict=True)},
        "log_loss": round(float(-np.log(np.maximum(prob[np.arange(len(label)), label], 1e-15)).mean()), 4),
        "brier": round(brier_score(prob, label), 4),
        "expected_calibration_error": round(reliability(prob, predicted == truth).expected_calibration_error, 4),
    }


def _walking_scores(prob: FloatArray) -> dict[str, Any]:
    """How much of a site's walking is taken for walking by a model that has not seen the site."""
    walking = CONTEXTS.index("walking")
    return {
        "n_windows": len(prob),
        "walking_recall": round(float((prob.argmax(axis=1) == walking).mean()), 4),
        "mean_walking_prob": round(float(prob[:, walking].mean()), 4),
    }


def card_of(
    plan: Plan, y: TextArray, person: TextArray, scores: dict[str, Any], sites: dict[str, Any]
) -> dict[str, Any]:
    """The model card: what it is made of and for, and the figures."""
    return {
        "name": plan.name,
        "description": plan.description,
        "intended_use": plan.use,
        "limits": plan.limits,
        "head": plan.head,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "data": list(plan.datasets),
        "n_people": len(np.unique(person)),
        "n_windows": {c: int((y == c).sum()) for c in HEADS[plan.head]},
        "feature_set": plan.feature_set,
        "n_features": len(plan.feature_names),
        "window_s": 2.0,
        "hop_s": 1.0,
        "leave_one_subject_out": {"people": f"{SCORED_DATASET}, 12 people", **scores},
        "site_left_out": sites,
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scikit-learn": sklearn.__version__,
        },
        "command": "pdr-filter train DATA_DIR --out models",
    }
