"""Train the shipped context models on labelled recordings, and say how good they are on people left out.

`pdr-filter train DATA_DIR` runs it. Every figure on a model card is of people (or sites) that the scored model has
not seen; the shipped model is then fitted on all of them.
"""

from __future__ import annotations

import datetime
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.metrics import accuracy_score, log_loss

from pdr_filter.context.forest import Forest
from pdr_filter.context.kernel_machine import RelevanceVectors
from pdr_filter.context.model import ContextModel
from pdr_filter.context.rvm import RelevanceVectorClassifier, stratified_rows
from pdr_filter.features.martinelli import NAMES, WITHOUT_GYROSCOPE, WITHOUT_MAGNETOMETER
from pdr_filter.features.windows import FeatureWindow
from pdr_filter.io import read
from pdr_filter.sensing import Sensing
from pdr_filter.types import CONTEXTS, BoolArray, FloatArray, Recording
from pdr_filter.whole import sensed_events

Progress = Callable[[str, float], None]
TextArray = NDArray[np.str_]

# Held-out people are those of MotionSense: the only set with stairs, and with more than a few people.
SCORED_DATASET = "motionsense"


@dataclass(frozen=True)
class Plan:
    """How one shipped model is made.

    MotionSense is carried in the pocket only. A model that knows hand-held walking from one person (tyrex) takes the
    weaker motion of a hand-held phone for stairs, so the forests also see the walks of humolire, ms_indoor and oxford;
    the relevance vector machine of the martinelli2018 recipe stays with MotionSense and tyrex.
    """

    name: str
    feature_names: tuple[str, ...]
    datasets: tuple[str, ...]
    make: Callable[[], Any]  # an unfitted scikit-learn classifier
    machine: Callable[[Any], Forest | RelevanceVectors]
    standardise: bool
    description: str
    max_rows: int | None = None  # rows to train on, drawn class by class; None is all


def _forest() -> Any:
    # Leaves of 20 windows: smaller ones memorise people and cost log loss (0.35 -> 0.38 with 5).
    return RandomForestClassifier(50, min_samples_leaf=20, random_state=0, n_jobs=-1)


def _rvm() -> Any:
    # Half the median distance of the standardised features: narrower and wider kernels lose log loss.
    return RelevanceVectorClassifier(kernel_width=3.0, max_samples=200, random_state=0)


PLANS: tuple[Plan, ...] = (
    Plan(
        "context_forest",
        WITHOUT_MAGNETOMETER,
        ("motionsense", "tyrex", "humolire", "ms_indoor"),
        _forest,
        Forest.from_sklearn,
        standardise=False,
        description="Random forest on the 23 features of accelerometer and gyroscope; the default recipe.",
    ),
    Plan(
        "context_forest_accelerometer",
        WITHOUT_GYROSCOPE,
        ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford"),
        _forest,
        Forest.from_sklearn,
        standardise=False,
        description="Random forest on the 16 accelerometer features; used where the gyroscope is missing.",
    ),
    Plan(
        "context_rvm",
        WITHOUT_MAGNETOMETER,
        ("motionsense", "tyrex"),
        _rvm,
        lambda classifier: classifier.machine_,
        standardise=True,
        description="Relevance vector machine, one-against-all, RBF kernel; the martinelli2018 recipe.",
        max_rows=1200,  # training time grows with rows times candidates squared
    ),
)


@dataclass(frozen=True, eq=False)
class LabelledWindows:
    """Feature windows that lie inside one label, with whose they are."""

    features: FloatArray  # (W, 28)
    context: TextArray  # (W,)
    carrying_mode: TextArray  # (W,)
    person: TextArray  # (W,) dataset/subject
    dataset: TextArray  # (W,)
    recording: TextArray  # (W,) name
    has_gyroscope: BoolArray  # (W,)


def labelled_windows(paths: Sequence[Path], progress: Progress | None = None) -> LabelledWindows:
    """Windows of recordings that lie wholly inside a label with a known context."""
    sensing = Sensing()
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
    windows = labelled_windows(paths, lambda what, fraction: tell(what, 0.3 * fraction))
    cards: list[dict[str, Any]] = []
    for i, plan in enumerate(PLANS):
        share = 0.7 / len(PLANS)

        def tell_part(what: str, fraction: float, start: float = 0.3 + i * share, share: float = share) -> None:
            tell(what, start + share * fraction)

        model = train_one(plan, windows, tell_part)
        model.save(out_dir)
        cards.append(dict(model.card))
    return cards


def train_one(plan: Plan, windows: LabelledWindows, progress: Progress) -> ContextModel:
    """The model of one plan, fitted on all its people, its card scored on people left out."""
    use = np.isin(windows.dataset, plan.datasets)
    if "gyro" in " ".join(plan.feature_names):
        use &= windows.has_gyroscope
    columns = [NAMES.index(name) for name in plan.feature_names]
    X, y = windows.features[use][:, columns], windows.context[use]
    person, dataset = windows.person[use], windows.dataset[use]

    held_out = np.unique(person[dataset == SCORED_DATASET])
    prob = np.zeros((len(y), len(CONTEXTS)))
    for i, name in enumerate(held_out):
        test = person == name
        prob[test] = fitted_prob(plan, X[~test], y[~test], X[test])
        progress(f"{plan.name}: without {name}", (i + 1) / (len(held_out) + 2))
    scored = dataset == SCORED_DATASET
    scores = score(y[scored], prob[scored])
    sites = {d: _site_left_out(plan, X, y, dataset, d) for d in plan.datasets if d not in (SCORED_DATASET, "tyrex")}
    progress(f"{plan.name}: sites left out", 1 - 1 / (len(held_out) + 2))

    classifier, mean, scale = _fit(plan, X, y)
    classes = tuple(str(c) for c in classifier.classes_)
    card = _card(plan, y, person, scores, sites)
    progress(f"{plan.name}: done", 1.0)
    return ContextModel(
        name=plan.name,
        feature_names=plan.feature_names,
        classes=classes,
        training_prior=np.array([np.mean(y == c) for c in CONTEXTS]),
        feature_mean=mean,
        feature_scale=scale,
        machine=plan.machine(classifier),
        card=card,
    )


def score(truth: TextArray, prob: FloatArray) -> dict[str, Any]:
    """Accuracy, macro recall, recall of each class and log loss of probabilities (W, 6) in the order of `CONTEXTS`."""
    present = [c for c in CONTEXTS if (truth == c).any()]
    predicted = np.array(CONTEXTS)[prob.argmax(axis=1)]
    recall = np.array([np.mean(predicted[truth == c] == c) for c in present])
    columns = [CONTEXTS.index(c) for c in sorted(present)]
    among = np.clip(prob[:, columns], 1e-15, None)
    return {
        "n_windows": len(truth),
        "accuracy": round(float(accuracy_score(truth, predicted)), 4),
        "macro_recall": round(float(recall.mean()), 4),
        "recall": {c: round(float(r), 4) for c, r in zip(present, recall, strict=True)},
        "log_loss": round(float(log_loss(truth, among / among.sum(axis=1, keepdims=True), labels=sorted(present))), 4),
    }


def _fit(plan: Plan, X: FloatArray, y: TextArray) -> tuple[Any, FloatArray, FloatArray]:
    """A classifier fitted as planned, with the mean and scale that its features need first."""
    if plan.max_rows is not None and len(y) > plan.max_rows:
        label = np.unique(y, return_inverse=True)[1].astype(np.int64)
        rows = stratified_rows(label, plan.max_rows, np.random.RandomState(0))
        return _fit(replace(plan, max_rows=None), X[rows], y[rows])
    mean, scale = np.zeros(X.shape[1]), np.ones(X.shape[1])
    if plan.standardise:
        mean, std = X.mean(axis=0), X.std(axis=0)
        scale = np.where(std > 0, std, 1.0)
    classifier = plan.make()
    classifier.fit((X - mean) / scale, y)
    return classifier, mean, scale


def fitted_prob(plan: Plan, X: FloatArray, y: TextArray, X_test: FloatArray) -> FloatArray:
    """Probabilities (N, 6) of test rows by a classifier fitted as planned to other rows."""
    classifier, mean, scale = _fit(plan, X, y)
    prob = np.zeros((len(X_test), len(CONTEXTS)))
    prob[:, [CONTEXTS.index(str(c)) for c in classifier.classes_]] = classifier.predict_proba((X_test - mean) / scale)
    return prob


def _site_left_out(plan: Plan, X: FloatArray, y: TextArray, dataset: TextArray, site: str) -> dict[str, Any]:
    """How much of a site's walking is taken for walking by a model that has not seen the site."""
    test = dataset == site
    prob = fitted_prob(plan, X[~test], y[~test], X[test])
    walking = CONTEXTS.index("walking")
    return {
        "n_windows": int(test.sum()),
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
        "features": list(plan.feature_names),
        "window_s": 2.0,
        "hop_s": 1.0,
        "leave_one_subject_out": {"people": f"{SCORED_DATASET}, 12 people", **scores},
        "site_left_out": sites,
        "limits": "No sideways walking in the data: its probability is always zero. Stairs are known from trouser "
        "pockets only. Probabilities are not calibrated.",
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scikit-learn": sklearn.__version__,
        },
        "command": "pdr-filter train DATA_DIR --out models",
    }
