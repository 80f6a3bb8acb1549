"""Train the shipped context models on labelled recordings, and say how good they are on people left out.

`pdr-filter train DATA_DIR` runs it. Every figure on a model card is of people (or sites) that the scored model has
not seen; the shipped model is then fitted on all of them.
"""

from __future__ import annotations

import datetime
import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import accuracy_score, log_loss
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from pdr_filter.context.forest import Forest
from pdr_filter.context.model import ContextModel, Machine
from pdr_filter.context.rvm import RelevanceVectorClassifier, stratified_rows
from pdr_filter.context.softmax import SoftmaxRegression, fit_temperature
from pdr_filter.features import invariant, martinelli
from pdr_filter.features.windows import FEATURE_SETS, FeatureWindow, FeatureWindows
from pdr_filter.io import read
from pdr_filter.sensing import Sensing
from pdr_filter.types import CONTEXTS, BoolArray, FloatArray, Recording
from pdr_filter.whole import sensed_events

Progress = Callable[[str, float], None]
TextArray = NDArray[np.str_]

# Held-out people are those of MotionSense: the only set with stairs, and with more than a few people.
SCORED_DATASET = "motionsense"


# Standard deviations at which a feature is cut: beyond them there is nothing to learn from.
FEATURE_LIMIT = 4.0


@dataclass(frozen=True, eq=False)
class Fitted:
    """A machine with what its features need first."""

    machine: Machine
    classes: tuple[str, ...]
    mean: FloatArray  # (F,)
    scale: FloatArray  # (F,)

    def prob(self, X: FloatArray) -> FloatArray:
        """Probabilities (N, 6) of `CONTEXTS`, by the same arrays that are stored."""
        result = np.zeros((len(X), len(CONTEXTS)))
        columns = [CONTEXTS.index(c) for c in self.classes]
        result[:, columns] = self.machine.predict_proba((X - self.mean) / self.scale)
        return result


Fit = Callable[[FloatArray, TextArray, TextArray], Fitted]  # features, contexts, people


def fit_forest(X: FloatArray, y: TextArray, person: TextArray) -> Fitted:
    """A random forest; it needs no scaling and is not calibrated."""
    # Leaves of 20 windows: smaller ones memorise people and cost log loss (0.35 -> 0.38 with 5).
    forest = RandomForestClassifier(50, min_samples_leaf=20, random_state=0, n_jobs=-1).fit(X, y)
    n = X.shape[1]
    return Fitted(Forest.from_sklearn(forest), _names(forest.classes_), np.zeros(n), np.ones(n))


def fit_relevance_vectors(X: FloatArray, y: TextArray, person: TextArray) -> Fitted:
    """A relevance vector machine on 4000 windows, drawn class by class: training time grows with rows."""
    rows = np.arange(len(y))
    if len(y) > 4000:
        label = np.unique(y, return_inverse=True)[1].astype(np.int64)
        rows = stratified_rows(label, 4000, np.random.RandomState(0))
    mean, scale = _standardisation(X[rows])
    # Half the median distance of the standardised features: narrower and wider kernels lose log loss.
    classifier = RelevanceVectorClassifier(kernel_width=3.0, max_samples=500, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # it warns of the budget of candidates that is meant here
        classifier.fit((X[rows] - mean) / scale, y[rows])
    return Fitted(classifier.machine_, _names(classifier.classes_), mean, scale)


def fit_softmax(X: FloatArray, y: TextArray, person: TextArray) -> Fitted:
    """Multinomial logistic regression, its temperature fitted on people left out one fold of four at a time."""
    classes = np.unique(y)
    out_of_fold = np.zeros((len(y), len(classes)))
    for train, test in GroupKFold(4).split(X, y, person):
        part = _softmax(X[train], y[train], 1.0)
        columns = np.searchsorted(classes, part.classes)
        out_of_fold[test[:, None], columns] = part.machine.predict_proba((X[test] - part.mean) / part.scale)
    label = np.searchsorted(classes, y).astype(np.int64)
    return _softmax(X, y, fit_temperature(out_of_fold, label))


def _softmax(X: FloatArray, y: TextArray, temperature: float) -> Fitted:
    mean, scale = _standardisation(X)
    z = np.clip((X - mean) / scale, -FEATURE_LIMIT, FEATURE_LIMIT)
    fitted: Any = LogisticRegression(C=0.1, max_iter=300, tol=1e-3).fit(z, y)
    machine = SoftmaxRegression(fitted.coef_, fitted.intercept_, temperature, FEATURE_LIMIT)
    return Fitted(machine, _names(fitted.classes_), mean, scale)


def _names(classes: NDArray[Any]) -> tuple[str, ...]:
    return tuple(str(c) for c in classes)


def _standardisation(X: FloatArray) -> tuple[FloatArray, FloatArray]:
    std = X.std(axis=0)
    return X.mean(axis=0), np.where(std > 0, std, 1.0)


@dataclass(frozen=True)
class Plan:
    """How one shipped model is made.

    MotionSense is carried in the pocket only. A model that knows hand-held walking from one person (tyrex) takes the
    weaker motion of a hand-held phone for stairs, so the default's models also see the walks of humolire, ms_indoor and
    oxford; the relevance vector machine of the martinelli2018 recipe stays with MotionSense and tyrex.
    """

    name: str
    feature_set: str
    feature_names: tuple[str, ...]
    datasets: tuple[str, ...]
    fit: Fit
    description: str

    @property
    def needs_gyroscope(self) -> bool:
        """Whether windows without angular rate are of no use."""
        accelerometer_only = {*martinelli.WITHOUT_GYROSCOPE, *invariant.WITHOUT_GYROSCOPE}
        return not set(self.feature_names) <= accelerometer_only


_HAND_HELD = ("motionsense", "tyrex", "humolire", "ms_indoor")
PLANS: tuple[Plan, ...] = (
    Plan(
        "context_softmax",
        "invariant",
        invariant.NAMES,
        _HAND_HELD,
        fit_softmax,
        "Logistic regression on features that do not depend on the phone's attitude, calibrated; the default recipe.",
    ),
    Plan(
        "context_softmax_accelerometer",
        "invariant",
        invariant.WITHOUT_GYROSCOPE,
        (*_HAND_HELD, "oxford"),
        fit_softmax,
        "The same on the features of the accelerometer alone; used where the gyroscope is missing.",
    ),
    Plan(
        "context_forest",
        "martinelli",
        martinelli.WITHOUT_MAGNETOMETER,
        _HAND_HELD,
        fit_forest,
        "Random forest on the 23 features of accelerometer and gyroscope of Martinelli et al. 2018.",
    ),
    Plan(
        "context_forest_accelerometer",
        "martinelli",
        martinelli.WITHOUT_GYROSCOPE,
        (*_HAND_HELD, "oxford"),
        fit_forest,
        "Random forest on the 16 accelerometer features; used where the gyroscope is missing.",
    ),
    Plan(
        "context_rvm",
        "martinelli",
        martinelli.WITHOUT_MAGNETOMETER,
        ("motionsense", "tyrex"),
        fit_relevance_vectors,
        "Relevance vector machine, one-against-all, RBF kernel; the martinelli2018 recipe.",
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


def labelled_windows(
    paths: Sequence[Path], progress: Progress | None = None, feature_set: str = "martinelli"
) -> LabelledWindows:
    """Windows of recordings that lie wholly inside a label with a known context."""
    sensing = Sensing(windows=FeatureWindows(feature_set))
    rows: list[tuple[FloatArray, str, str, str, str, str, bool]] = []
    for i, path in enumerate(paths):
        recording = read(path)
        person = f"{recording.meta.get('dataset', '')}/{recording.subject.id}"
        for event in sensed_events(sensing, recording):
            if isinstance(event, FeatureWindow):
                label = _label_of(recording, event.time_s - sensing.windows.window_s, event.time_s)
                if label is not None:
                    dataset = str(recording.meta.get("dataset", ""))
                    rows.append((event.features, *label, person, dataset, recording.name, event.has_gyroscope))
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


def _label_of(recording: Recording, start_s: float, end_s: float) -> tuple[str, str] | None:
    labels = recording.truth.labels
    if labels is None:
        return None
    # Half a sample of slack: labels start with the first sample, windows half an interval before its middle.
    slack_s = 0.02
    for label in labels:
        if label["start_s"] - slack_s <= start_s and end_s <= label["end_s"] + slack_s and label["context"]:
            return str(label["context"]), str(label["carrying_mode"])
    return None


def train(data_dir: Path, out_dir: Path, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Cards of the models that were trained and written to `out_dir`.

    Parameters
    ----------
    data_dir : Path
        Folder with one folder for each data set of `PLANS`.
    out_dir : Path
        Where `<name>.npz` and `<name>.json` go.
    progress : callable, optional
        Called with what is done and the fraction of the whole, 0 to 1.
    """

    def tell(what: str, fraction: float) -> None:
        if progress is not None:
            progress(what, fraction)

    wanted = sorted({d for plan in PLANS for d in plan.datasets})
    paths = [p for d in wanted for p in sorted((data_dir / d).glob("*.zip")) if p.stem != "motionsense_s01_sit_13"]
    if not paths:
        raise ValueError(f"{data_dir} holds none of the data sets {wanted}; give the folder that holds theirs")
    sets = sorted({plan.feature_set for plan in PLANS})
    windows: dict[str, LabelledWindows] = {}
    for i, feature_set in enumerate(sets):

        def tell_set(what: str, fraction: float, start: float = 0.3 * i / len(sets)) -> None:
            tell(what, start + 0.3 / len(sets) * fraction)

        windows[feature_set] = labelled_windows(paths, tell_set, feature_set)
    # One thread for the matrices: they are small, and threads that wait for each other cost ten times what they gain.
    with threadpool_limits(1):
        return _train_all(windows, out_dir, tell)


def _train_all(windows: dict[str, LabelledWindows], out_dir: Path, tell: Progress) -> list[dict[str, Any]]:
    cards: list[dict[str, Any]] = []
    for i, plan in enumerate(PLANS):

        def tell_plan(what: str, fraction: float, start: float = 0.3 + 0.7 * i / len(PLANS)) -> None:
            tell(what, start + 0.7 / len(PLANS) * fraction)

        model = train_one(plan, windows[plan.feature_set], tell_plan)
        model.save(out_dir)
        cards.append(dict(model.card))
    return cards


def train_one(plan: Plan, windows: LabelledWindows, progress: Progress) -> ContextModel:
    """The model of one plan, fitted on all its people, its card scored on people left out."""
    use = np.isin(windows.dataset, plan.datasets) & (windows.has_gyroscope | (not plan.needs_gyroscope))
    names = FEATURE_SETS[plan.feature_set]
    X, y = windows.features[use][:, [names.index(name) for name in plan.feature_names]], windows.context[use]
    person, dataset = windows.person[use], windows.dataset[use]

    held_out = np.unique(person[dataset == SCORED_DATASET])
    prob = np.zeros((len(y), len(CONTEXTS)))
    for i, name in enumerate(held_out):
        test = person == name
        prob[test] = plan.fit(X[~test], y[~test], person[~test]).prob(X[test])
        progress(f"{plan.name}: without {name}", (i + 1) / (len(held_out) + 2))
    scored = dataset == SCORED_DATASET
    scores = score(y[scored], prob[scored])
    accuracy = [np.mean(_predicted(prob[person == p]) == y[person == p]) for p in held_out]
    scores["worst_person_accuracy"] = round(float(min(accuracy)), 4)
    sites: dict[str, Any] = {}
    for site in plan.datasets:
        if site not in (SCORED_DATASET, "tyrex"):
            test = dataset == site
            sites[site] = _walking_scores(plan.fit(X[~test], y[~test], person[~test]).prob(X[test]))
    progress(f"{plan.name}: sites left out", 1 - 1 / (len(held_out) + 2))

    fitted = plan.fit(X, y, person)
    progress(f"{plan.name}: done", 1.0)
    return ContextModel(
        name=plan.name,
        feature_names=plan.feature_names,
        classes=fitted.classes,
        training_prior=np.array([np.mean(y == c) for c in CONTEXTS]),
        feature_mean=fitted.mean,
        feature_scale=fitted.scale,
        machine=fitted.machine,
        card=_card(plan, y, person, scores, sites),
    )


def _predicted(prob: FloatArray) -> TextArray:
    return np.array(CONTEXTS)[prob.argmax(axis=1)]


def score(truth: TextArray, prob: FloatArray) -> dict[str, Any]:
    """Accuracy, macro recall, recall of each class and log loss of probabilities (W, 6) in the order of `CONTEXTS`."""
    present = [c for c in CONTEXTS if (truth == c).any()]
    predicted = _predicted(prob)
    recall = np.array([np.mean(predicted[truth == c] == c) for c in present])
    columns = [CONTEXTS.index(c) for c in sorted(present)]
    among = np.clip(prob[:, columns], 1e-15, None)
    return {
        "n_windows": len(truth),
        "accuracy": round(float(accuracy_score(truth, predicted)), 4),
        "macro_recall": round(float(recall.mean()), 4),
        "recall": {c: round(float(r), 4) for c, r in zip(present, recall, strict=True)},
        "log_loss": round(float(log_loss(truth, among / among.sum(axis=1, keepdims=True), labels=sorted(present))), 4),
        "brier": round(float(((prob - (truth[:, None] == np.array(CONTEXTS))) ** 2).sum(axis=1).mean()), 4),
        "expected_calibration_error": round(expected_calibration_error(prob, predicted == truth), 4),
    }


def expected_calibration_error(prob: FloatArray, correct: BoolArray, n_bins: int = 15) -> float:
    """Mean distance between confidence and accuracy over bins of confidence (Guo et al. 2017, eq. 3)."""
    confidence = prob.max(axis=1)
    bins = np.minimum((confidence * n_bins).astype(int), n_bins - 1)
    gaps = [abs(confidence[bins == b].mean() - correct[bins == b].mean()) * np.mean(bins == b) for b in np.unique(bins)]
    return float(sum(gaps))


def _walking_scores(prob: FloatArray) -> dict[str, Any]:
    """How much of a site's walking is taken for walking by a model that has not seen the site."""
    walking = CONTEXTS.index("walking")
    return {
        "n_windows": len(prob),
        "walking_recall": round(float((prob.argmax(axis=1) == walking).mean()), 4),
        "mean_walking_prob": round(float(prob[:, walking].mean()), 4),
    }


def _card(plan: Plan, y: TextArray, person: TextArray, scores: dict[str, Any], sites: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": plan.name,
        "description": plan.description,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "data": list(plan.datasets),
        "n_people": len(np.unique(person)),
        "n_windows": {c: int((y == c).sum()) for c in CONTEXTS},
        "feature_set": plan.feature_set,
        "n_features": len(plan.feature_names),
        "window_s": 2.0,
        "hop_s": 1.0,
        "leave_one_subject_out": {"people": f"{SCORED_DATASET}, 12 people", **scores},
        "site_left_out": sites,
        "limits": "No sideways walking in the data: its probability is always zero. Stairs are known from trouser "
        "pockets only. Only the softmax models are calibrated, on people left out within the training set.",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scikit-learn": sklearn.__version__,
        },
        "command": "pdr-filter train DATA_DIR --out models",
    }
