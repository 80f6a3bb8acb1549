"""Training and scoring protocol of all models: labelled windows, a plan, and held-out people.

`train_one` is the protocol. Each group is scored by a model of all other groups, and then the model is fitted on all
people. The predictions for the held-out groups give its calibration, its `Familiarity` and its card.
"""

from __future__ import annotations

import datetime
import platform
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
import sklearn
from joblib import Parallel, delayed
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.context_model import HEADS, ContextModel
from pdr_filter.classifiers.familiarity import fit_familiarity
from pdr_filter.classifiers.probability_calibration import (
    brier_score,
    fit_calibration,
    reliability_diagram,
    slipped_prob,
    tempered_prob,
)
from pdr_filter.offline.columns import Columns
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, Table
from pdr_filter.values.recording import Recording

J = TypeVar("J")
R = TypeVar("R")
TextArray = NDArray[np.str_]
# Arguments: name of the current task, and the fraction of the whole that is done, 0 to 1.
Progress = Callable[[str, float], None]

# Arguments: standardised features (W, F), labels (W,) and weights (W,). Results: a machine and its classes.
MachineFit = Callable[[FloatArray, TextArray, FloatArray], tuple[Machine, tuple[str, ...]]]

FEATURE_LIMIT = 4.0  # standard deviations at which features are clipped, because larger deviations carry no information
_LEAST_STD = 1e-6  # a smaller standard deviation is rounding noise of a constant feature


def source_of(recording: Recording) -> tuple[str, str]:
    """Return the data set of a recording, and its person as "data set/subject"."""
    dataset = str(recording.meta.get("dataset", ""))
    return dataset, f"{dataset}/{recording.subject.id}"


def label_row(labels: Table | None, column: str, start_s: float, end_s: float) -> int | None:
    """Return the row in the table of labels that contains a time interval, or None if no named label does.

    Labels without a name in `column` are skipped. An interval may exceed its label by 0.02 s at each end.
    """
    # Labels start with their first sample, but windows start half a sample interval before it.
    slack_s = 0.02
    for row, label in enumerate(() if labels is None else labels):
        if label["start_s"] - slack_s <= start_s and end_s <= label["end_s"] + slack_s and label[column]:
            return row
    return None


@dataclass(frozen=True, eq=False)
class LabelledWindows(Columns):
    """Feature windows that lie inside one label, with their person and source."""

    features: FloatArray  # (W, F) features of each window
    context: TextArray  # (W,) label of the context, or an empty string if unknown
    carrying_mode: TextArray  # (W,) label of the carrying mode, or an empty string if unknown
    person: TextArray  # (W,) person as "data set/subject"
    dataset: TextArray  # (W,) data set, or the kind of synthetic windows and the data set that they were made from
    recording: TextArray  # (W,) name of the recording
    has_gyroscope: BoolArray  # (W,) True for windows with an angular rate

    def label(self, head: str) -> TextArray:
        """Return the true contexts (W,) for the head "context", otherwise carrying modes; empty strings if unknown."""
        return self.context if head == "context" else self.carrying_mode


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions for held-out windows."""

    rows: BoolArray  # (W,) held-out windows among all windows of the plan
    prob: FloatArray  # (n, L) predicted probabilities of the plan's labels
    distance: FloatArray  # (n,) distance from the training windows


@dataclass(frozen=True, kw_only=True)
class TrainingPlan(ABC):
    """Base class of the plans that define how one model is trained."""

    name: str
    head: str  # "context" or "carrying_mode"
    feature_set: str  # name of the set of features
    feature_names: tuple[str, ...]  # features used from that set
    machine_fit: MachineFit
    description: str  # description on the card
    use: str  # intended use on the card
    limits: str  # limits on the card
    command: str  # command that trains the model, on the card
    # if False, the angular rate is removed before any processing, because the attitude, and with it the vertical,
    # differs if it comes from the accelerometer alone
    has_gyroscope: bool = True
    feature_limit: float = FEATURE_LIMIT  # number of standard deviations at which features are clipped

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels that the model distinguishes: all contexts, or all carrying modes."""
        return HEADS[self.head]

    def training_windows(self, windows: LabelledWindows) -> LabelledWindows:
        """Return the training windows: all of them, unless a plan also has unlabelled ones."""
        return windows

    def is_real(self, windows: LabelledWindows) -> BoolArray:
        """Return a mask (W,) of the windows that are recorded, not synthetic. Only these are scored."""
        return np.ones(len(windows.person), dtype=bool)

    def familiar_groups(self, windows: LabelledWindows) -> TextArray | None:
        """Return the group of each window (W,) for its `Familiarity`. None means a single group.

        With the many features of the shipped models, groups of one class each tell new sites from known ones as well as
        a single group (area under the curve 0.97 and 0.98), in files of five times the size.
        """
        return None

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """Return the weight of each window (W,). All are one, unless a plan overrides this."""
        return np.ones(len(windows.person))

    def standardisation(self, features: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted mean and standard deviation (F,) of the features (W, F).

        The standard deviation of a constant feature is replaced by 1.
        """
        mean = np.average(features, axis=0, weights=weight)
        std = np.sqrt(np.average((features - mean) ** 2, axis=0, weights=weight))
        return mean, np.where(std > _LEAST_STD, std, 1.0)

    def fit(self, windows: LabelledWindows) -> ContextModel:
        """Return a model fitted on some windows, without calibration and without `Familiarity`.

        `train_one` uses this method for the held-out groups and for the final model.
        """
        y, weight = windows.label(self.head), self.weight(windows)
        mean, scale = self.standardisation(windows.features, weight)
        standardised = np.clip((windows.features - mean) / scale, -self.feature_limit, self.feature_limit)
        machine, classes = self.machine_fit(standardised, y, weight)
        prior = np.array([weight[y == label].sum() for label in self.labels])
        return ContextModel(
            name=self.name,
            feature_names=self.feature_names,
            classes=classes,
            training_prior=prior / prior.sum(),
            feature_mean=mean,
            feature_scale=scale,
            machine=machine,
            card={},
            head=self.head,
            feature_limit=self.feature_limit,
            labels=self.labels,
        )

    def card(self, windows: LabelledWindows, scores: Mapping[str, Any], sites: Mapping[str, Any]) -> dict[str, Any]:
        """Return the model card: data, purpose, and the scores on held-out people and on held-out sites."""
        n_windows = Counter(windows.label(self.head).tolist())
        return {
            "name": self.name,
            "description": self.description,
            "intended_use": self.use,
            "limits": self.limits,
            "head": self.head,
            "data": [str(name) for name in np.unique(windows.dataset)],
            "n_people": len(np.unique(windows.person)),
            "n_windows": {label: n_windows[label] for label in self.labels},
            "feature_set": self.feature_set,
            "n_features": len(self.feature_names),
            "window_s": 2.0,
            "hop_s": 1.0,
            "leave_one_subject_out": dict(scores),
            "site_left_out": dict(sites),
            **provenance(self.command),
        }

    @abstractmethod
    def held_out(self, windows: LabelledWindows) -> Mapping[str, BoolArray]:
        """Return the groups of windows that are held out together, as masks (W,) by the name of the group."""

    @abstractmethod
    def final_model(
        self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, HeldOut]
    ) -> ContextModel:
        """Return the final model with its card and the calibration from the held-out groups."""


@dataclass(frozen=True, eq=False)
class Fits:
    """Uncalibrated models of one training plan."""

    model: ContextModel  # model fitted on all windows
    # models fitted without a held-out group, by the name of the group, with their `Familiarity`
    without: dict[str, ContextModel]


def train_one(plan: TrainingPlan, windows: LabelledWindows, progress: Progress, n_jobs: int = -1) -> ContextModel:
    """Return the model of one training plan, fitted on all its windows and scored on held-out groups of people.

    A `TrainingPlan` states which model to fit on which windows, and which people to hold out together. `n_jobs` is the
    number of processes, -1 for all processors.
    """
    model = calibrate_fits(plan, windows, fit_groups(plan, windows, progress, n_jobs))
    progress(f"{plan.name}: done", 1.0)
    return model


def fit_groups(plan: TrainingPlan, windows: LabelledWindows, progress: Progress, n_jobs: int = -1) -> Fits:
    """Return the models of a training plan without each held-out group, and the model of all windows."""
    groups = plan.held_out(windows)
    n = len(groups) + 2
    without: dict[str, ContextModel] = {}
    models = in_parallel(partial(_fit_without, plan, windows), groups.values(), n_jobs)
    for i, (name, fitted) in enumerate(zip(groups, models, strict=True)):
        without[name] = fitted
        progress(f"{plan.name}: without {name}", (i + 1) / n)
    with threadpool_limits(1):
        model = plan.fit(plan.training_windows(windows))
    progress(f"{plan.name}: all people", 1 - 1 / n)
    return Fits(model, without)


def calibrate_fits(plan: TrainingPlan, windows: LabelledWindows, fits: Fits) -> ContextModel:
    """Return the final model of a training plan, calibrated and scored on its held-out groups."""
    with threadpool_limits(1):
        return plan.final_model(fits.model, windows, predictions(plan, windows, fits))


def predictions(plan: TrainingPlan, windows: LabelledWindows, fits: Fits) -> dict[str, HeldOut]:
    """Return the predictions for each held-out group by the model that was fitted without it."""
    groups = plan.held_out(windows).items()
    return {name: _prediction(plan, windows, group, fits.without[name]) for name, group in groups}


def _fit_without(plan: TrainingPlan, windows: LabelledWindows, group: BoolArray) -> ContextModel:
    """Return the model of all windows without a group, with its `Familiarity`, whose limits have no meaning."""
    with threadpool_limits(1):
        rest = plan.training_windows(windows.part(~group))
        return with_familiarity(plan.fit(rest), rest, 1.0, plan.familiar_groups(rest))


def _prediction(plan: TrainingPlan, windows: LabelledWindows, group: BoolArray, model: ContextModel) -> HeldOut:
    """Return the predictions of a model for the real windows of a group that it was fitted without."""
    rows = group & plan.is_real(windows)
    features = windows.features[rows]
    known = model.familiarity
    distance = np.zeros(len(features)) if known is None else known.distance(model.standardised(features))
    return HeldOut(rows, model.probabilities(features), distance)


def with_familiarity(
    model: ContextModel,
    windows: LabelledWindows,
    limit: float,
    group: TextArray | None = None,
    usual: float = np.inf,
) -> ContextModel:
    """Return the model with the distribution (`Familiarity`) of its training windows.

    Beyond the distance `limit` from them, a window counts as partly unknown, the more the further away it is. With the
    groups of the windows (W,), each group has a distribution of its own. A tenth of the windows of held-out people are
    beyond the distance `usual`.
    """
    return replace(model, familiarity=fit_familiarity(model.standardised(windows.features), limit, group, usual))


def in_window_order(left_out: Iterable[HeldOut]) -> HeldOut:
    """Return the predictions of all held-out groups as one `HeldOut`, in the order of the windows."""
    groups = list(left_out)
    rows = np.any([group.rows for group in groups], axis=0)
    order = np.argsort(np.concatenate([np.flatnonzero(group.rows) for group in groups]))
    prob, distance = (np.concatenate([getattr(group, name) for group in groups]) for name in ("prob", "distance"))
    return HeldOut(rows, prob[order], distance[order])


def cross_calibrated(prob: FloatArray, context: TextArray, person: TextArray, model: ContextModel) -> FloatArray:
    """Return the probabilities (W, C) of held-out people, each person's calibrated on all other people."""
    result = np.zeros_like(prob)
    for name in np.unique(person):
        own = person == name
        result[own] = calibrated_prob(prob[own], model, *temperature_and_slip(prob[~own], context[~own], model))
    return result


def temperature_and_slip(prob: FloatArray, context: TextArray, model: ContextModel) -> tuple[float, float]:
    """Return the temperature and the slip probability that calibrate the probabilities (W, C) of held-out people.

    The slip probability e is the probability that a window has any class at random, so p becomes (1 - e) p + e / K for
    K classes (`slipped`).

    It is at least 1 / (W + 2), by Laplace's rule of succession. W windows without an error do not exclude an error. A
    single label with probability zero would have an infinite log loss. Without windows, the results are 1 and 0.
    """
    if not len(context):
        return 1.0, 0.0
    label = np.array([model.classes.index(c) for c in context])
    temperature, slip = fit_calibration(prob[:, _columns(model)], label)
    return temperature, max(slip, 1.0 / (len(label) + 2))


def calibrated_prob(prob: FloatArray, model: ContextModel, temperature: float, slip: float) -> FloatArray:
    """Return calibrated probabilities (W, C), which are zero for classes that `model` does not have."""
    result = np.zeros_like(prob)
    result[:, _columns(model)] = slipped_prob(tempered_prob(prob[:, _columns(model)], temperature), slip)
    return result


def _columns(model: ContextModel) -> list[int]:
    """Return the columns of the model's classes among its labels."""
    return [model.labels.index(c) for c in model.classes]


def in_parallel(work: Callable[[J], R], jobs: Iterable[J], n_jobs: int = -1) -> Iterator[R]:
    """Return an iterator over the results in the order of the jobs. Each job uses one thread for linear algebra.

    The matrices are small, so that the synchronisation of threads would cost ten times what it gains.
    """
    done: Any = Parallel(n_jobs=n_jobs, return_as="generator")(delayed(work)(job) for job in jobs)
    return iter(done)


def silent(what: str, fraction: float) -> None:
    """Do nothing. This is the default callback for the progress of a training."""


def most_probable_labels(prob: FloatArray, labels: tuple[str, ...]) -> TextArray:
    """Return the most probable label of each row, (W,)."""
    return np.array(labels)[prob.argmax(axis=1)]


def score(truth: TextArray, prob: FloatArray, labels: tuple[str, ...] = CONTEXTS) -> dict[str, Any]:
    """Return the scores of probabilities (W, L) as a dict.

    It has the number of windows, accuracy, macro recall, recall per class, log loss, Brier score, expected calibration
    error and confusion matrix. Recalls are of the labels that occur in `truth` (W,). Numbers have four decimals.
    """
    present = [c for c in labels if (truth == c).any()]
    best = most_probable_labels(prob, labels)
    recall = np.array([np.mean(best[truth == c] == c) for c in present])
    label = np.array([labels.index(c) for c in truth])
    return {
        "n_windows": len(truth),
        "accuracy": round(float(np.mean(best == truth)), 4),
        "macro_recall": round(float(recall.mean()), 4),
        "recall": {c: round(float(r), 4) for c, r in zip(present, recall, strict=True)},
        "log_loss": round(float(-np.log(np.maximum(prob[np.arange(len(label)), label], 1e-15)).mean()), 4),
        "brier": round(brier_score(prob, label), 4),
        "expected_calibration_error": round(reliability_diagram(prob, best == truth).expected_calibration_error, 4),
        "confusion": {c: {d: int(np.sum(best[truth == c] == d)) for d in labels} for c in present},
    }


def worst_person_accuracy(truth: TextArray, prob: FloatArray, person: TextArray, labels: tuple[str, ...]) -> float:
    """Return the lowest accuracy among the people, to four decimals, from probabilities (W, L) of the labels."""
    right = most_probable_labels(prob, labels) == truth
    return round(float(min(right[person == name].mean() for name in np.unique(person))), 4)


def provenance(command: str) -> dict[str, Any]:
    """Return the date, the package versions and the command of a training, for the card."""
    versions = {"python": platform.python_version(), "numpy": np.__version__, "scikit-learn": sklearn.__version__}
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "versions": versions, "command": command}
