"""How every shipped model is trained and scored: labelled windows, a plan, and people who are left out in turn.

`train_one` is the protocol: each group is scored by a model of all others, then the model is fitted on everybody, and
what was said of the groups left out gives its calibration, its `Familiarity` and its card.
"""

from __future__ import annotations

import datetime
import platform
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import sklearn
from joblib import Parallel, delayed
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.context_model import HEADS, ContextModel
from pdr_filter.classifiers.familiarity import fit_familiarity
from pdr_filter.classifiers.probability_calibration import brier_score, reliability
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, Table
from pdr_filter.values.recording import Recording

J = TypeVar("J")
R = TypeVar("R")
TextArray = NDArray[np.str_]
Progress = Callable[[str, float], None]  # what is done, and the fraction of the whole, 0 to 1
# Standardised features (W, F), labels (W,) and weights (W,) in, a machine and its classes out.
MachineFit = Callable[[FloatArray, TextArray, FloatArray], tuple[Machine, tuple[str, ...]]]

# Held-out people are those of MotionSense: the only set with stairs, and with more than a few people.
SCORED_DATASET = "motionsense"
# Labels that contradict the same person's other recordings in cadence, swing and skewness of the vertical, all three
# as of the other direction: two swapped recordings of MotionSense, and the end of one of Di Fronzo. Recording
# and when the doubt begins, s. Nothing learns from them, and no figure but those "as labelled" counts them.
DOUBTFUL: dict[str, float] = {
    "motionsense_s09_dws_2": 0.0,
    "motionsense_s09_ups_3": 0.0,
    "difronzo_user03_exp07": 428.0,
}
DUPLICATES = ("motionsense_s01_sit_13",)  # published twice: the same samples are also in motionsense_s01_sit_5
STAIRS = ("upstairs", "downstairs")
# Half unknown at 1.09 times the limit, nine tenths at 1.33: walking in bags, hands and at the waist lies at 1.1 to 1.5.
STAIRS_SHARPNESS = 8.0
FEATURE_LIMIT = 4.0  # standard deviations at which a feature is cut: beyond them there is nothing to learn from
_LEAST_STD = 1e-6  # a standard deviation below this is rounding: the feature does not vary


def recordings_of(data_dir: Path, datasets: Iterable[str]) -> list[Path]:
    """Recordings of data sets, one folder each, without those that are published twice."""
    found = [path for dataset in datasets for path in sorted((data_dir / dataset).glob("*.zip"))]
    return [path for path in found if path.stem not in DUPLICATES]


def read_recording(path: Path) -> Recording:
    """Read a recording to train on."""
    # Only when called: fitting works on recordings, whatever their files.
    from pdr_filter.io.formats import read

    return read(path)


def source_of(recording: Recording) -> tuple[str, str]:
    """Data set and person, "data set/subject", of a recording."""
    dataset = str(recording.meta.get("dataset", ""))
    return dataset, f"{dataset}/{recording.subject.id}"


def label_of(recording: Recording, start_s: float, end_s: float) -> tuple[str, str] | None:
    """Context and carrying mode of the label that a window lies inside, None outside every known context.

    None, too, where the label is `DOUBTFUL`.
    """
    labels = recording.truth.labels
    row = None if start_s >= DOUBTFUL.get(recording.name, np.inf) else label_row(labels, "context", start_s, end_s)
    return None if row is None or labels is None else (str(labels["context"][row]), str(labels["carrying_mode"][row]))


def label_row(labels: Table | None, column: str, start_s: float, end_s: float) -> int | None:
    """Row of the label that a time lies inside, None outside every label with a name in this column."""
    # Half a sample of slack: labels start with the first sample, windows half an interval before its middle.
    slack_s = 0.02
    for row, label in enumerate(() if labels is None else labels):
        if label["start_s"] - slack_s <= start_s and end_s <= label["end_s"] + slack_s and label[column]:
            return row
    return None


class Columns:
    """Base of a dataclass of arrays with a row for each window."""

    def part(self, use: BoolArray | slice) -> Self:
        """Some of the windows."""
        return type(self)(*(getattr(self, name)[use] for name in vars(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All windows of at least one part, one part after the other."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))


@dataclass(frozen=True, eq=False)
class LabelledWindows(Columns):
    """Feature windows that lie inside one label, with whose they are."""

    features: FloatArray  # (W, F)
    context: TextArray  # (W,)
    carrying_mode: TextArray  # (W,)
    person: TextArray  # (W,) data set/subject
    dataset: TextArray  # (W,) or what was made of which data set
    recording: TextArray  # (W,) name
    has_gyroscope: BoolArray  # (W,)

    @classmethod
    def of_one(
        cls,
        features: FloatArray,
        context: TextArray,
        carrying_mode: TextArray,
        person: str,
        dataset: str,
        recording: str,
        has_gyroscope: BoolArray,
    ) -> Self:
        """Windows of one recording, or made of it."""
        whose, source, name = (np.full(len(features), text) for text in (person, dataset, recording))
        return cls(features, context, carrying_mode, whose, source, name, has_gyroscope)

    def label(self, head: str) -> TextArray:
        """True labels of a head, "" where unknown."""
        return self.context if head == "context" else self.carrying_mode


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What a model said of windows that it had not seen."""

    rows: BoolArray  # (W,) which windows of the plan's
    prob: FloatArray  # (n, L) of the plan's labels
    distance: FloatArray  # (n,) from the windows trained on
    stairs_distance: FloatArray  # (n,) from those on stairs; zeros where the plan does not guard stairs


@dataclass(frozen=True, kw_only=True)
class TrainingPlan(ABC):
    """How one model is made."""

    name: str
    head: str
    feature_set: str  # the set that its features are of
    feature_names: tuple[str, ...]
    datasets: tuple[str, ...]  # that it learns from; windows of any other source were made, and are never scored
    machine_fit: MachineFit
    description: str  # on its card for people, as are the next two
    use: str
    limits: str
    # Without, the angular rate is taken away before anything else: the attitude, and with it what is vertical, is
    # another when it comes from the accelerometer alone.
    has_gyroscope: bool = True
    feature_limit: float = FEATURE_LIMIT  # standard deviations at which its features are cut
    guards_stairs: bool = False  # that stairs are told from walking only where windows are like those on stairs

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the head."""
        return HEADS[self.head]

    def learnt_from(self, windows: LabelledWindows) -> LabelledWindows:
        """Return the windows that the model learns from: all of them, unless a plan has unlabelled ones, too."""
        return windows

    def is_real(self, windows: LabelledWindows) -> BoolArray:
        """Which windows were recorded as they are, (W,)."""
        return np.isin(windows.dataset, self.datasets)

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """How much each window counts, (W,); all alike unless a plan has reasons."""
        return np.ones(len(windows.person))

    def standardisation(self, features: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and scale (F,) of the features (W, F)."""
        mean = np.average(features, axis=0, weights=weight)
        std = np.sqrt(np.average((features - mean) ** 2, axis=0, weights=weight))
        return mean, np.where(std > _LEAST_STD, std, 1.0)

    def fit_machine(self, windows: LabelledWindows) -> ContextModel:
        """A model of some windows, its probabilities not yet calibrated, and nothing unknown to it."""
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

    def fit(self, windows: LabelledWindows) -> ContextModel:
        """A model of some windows as it is used: for those left out, and in the end of all."""
        return self.fit_machine(windows)

    def card(self, windows: LabelledWindows, scores: Mapping[str, Any], sites: Mapping[str, Any]) -> dict[str, Any]:
        """The model card: what it is made of and for, and the figures of `SCORED_DATASET` and of sites left out."""
        real = windows.part(self.is_real(windows))
        n_windows = Counter(real.label(self.head).tolist())
        n_scored = len(np.unique(real.person[real.dataset == SCORED_DATASET]))
        return {
            "name": self.name,
            "description": self.description,
            "intended_use": self.use,
            "limits": self.limits,
            "head": self.head,
            "data": [str(name) for name in np.unique(real.dataset)],
            "n_people": len(np.unique(real.person)),
            "n_windows": {label: n_windows[label] for label in self.labels},
            "feature_set": self.feature_set,
            "n_features": len(self.feature_names),
            "window_s": 2.0,
            "hop_s": 1.0,
            "leave_one_subject_out": {"people": f"{SCORED_DATASET}, {n_scored} people", **scores},
            "site_left_out": dict(sites),
            **provenance("python -m pdr_filter.offline.training.train_all DATA_DIR models"),
        }

    @abstractmethod
    def held_out(self, windows: LabelledWindows) -> Mapping[str, BoolArray]:
        """Groups of windows (W,) that are left out together, by name."""

    @abstractmethod
    def finished(self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, LeftOut]) -> ContextModel:
        """The model of all windows with its card, and what else only windows left out can show."""


def train_one(plan: TrainingPlan, windows: LabelledWindows, progress: Progress, n_jobs: int = -1) -> ContextModel:
    """The model of one plan, fitted on all its windows, its card scored on groups left out, on so many processes."""
    groups = plan.held_out(windows)
    n = len(groups) + 2
    left_out: dict[str, LeftOut] = {}
    said = in_parallel(partial(leave_out, plan, windows), groups.values(), n_jobs)
    for i, (name, group) in enumerate(zip(groups, said, strict=True)):
        left_out[name] = group
        progress(f"{plan.name}: without {name}", (i + 1) / n)
    with threadpool_limits(1):
        model = plan.fit(plan.learnt_from(windows))
        progress(f"{plan.name}: all people", 1 - 1 / n)
        model = plan.finished(model, windows, left_out)
    progress(f"{plan.name}: done", 1.0)
    return model


def leave_out(plan: TrainingPlan, windows: LabelledWindows, group: BoolArray) -> LeftOut:
    """What a model of all other windows says of the real ones of a group; what was made of them is left out with it."""
    with threadpool_limits(1):
        rest, rows = plan.learnt_from(windows.part(~group)), group & plan.is_real(windows)
        model = plan.fit(rest)
        features = windows.features[rows]
        known = with_familiarity(model, rest, 1.0, 1.0 if plan.guards_stairs else None)
        of_all, of_stairs = (
            np.zeros(len(features)) if k is None else k.distance(model.standardised(features))
            for k in (known.familiarity, known.stairs)
        )
        return LeftOut(rows, model.probabilities(features), of_all, of_stairs)


def with_familiarity(
    model: ContextModel, windows: LabelledWindows, limit: float, stairs_limit: float | None = None
) -> ContextModel:
    """The model with the windows that it learnt from as what it knows, up to a distance; so for stairs, if guarded."""
    standardised = model.standardised(windows.features)
    stairs = None
    if stairs_limit is not None:
        on_stairs = np.isin(windows.context, STAIRS)
        stairs = fit_familiarity(standardised[on_stairs], stairs_limit, STAIRS_SHARPNESS)
    return replace(model, familiarity=fit_familiarity(standardised, limit), stairs=stairs)


def in_order(left_out: Iterable[LeftOut]) -> LeftOut:
    """All that was left out in some group, in the order of the windows."""
    groups = list(left_out)
    rows = np.any([group.rows for group in groups], axis=0)
    order = np.argsort(np.concatenate([np.flatnonzero(group.rows) for group in groups]))
    names = "prob", "distance", "stairs_distance"
    return LeftOut(rows, *(np.concatenate([getattr(group, name) for group in groups])[order] for name in names))


def in_parallel(work: Callable[[J], R], jobs: Iterable[J], n_jobs: int = -1) -> Iterator[R]:
    """Results in the order of the jobs, as they come; every job uses one thread for its matrices.

    They are small, and threads that wait for each other cost ten times what they gain.
    """
    done: Any = Parallel(n_jobs=n_jobs, return_as="generator")(delayed(work)(job) for job in jobs)
    return iter(done)


def part_progress(progress: Progress, start: float, span: float) -> Progress:
    """Progress of a part of the whole."""
    return lambda what, fraction: progress(what, start + span * fraction)


def silent(what: str, fraction: float) -> None:
    """Progress that nobody watches."""


def predicted(prob: FloatArray, labels: tuple[str, ...]) -> TextArray:
    """The most probable label of each row, (W,)."""
    return np.array(labels)[prob.argmax(axis=1)]


def score(truth: TextArray, prob: FloatArray, labels: tuple[str, ...] = CONTEXTS) -> dict[str, Any]:
    """Accuracy, macro recall, recall of each class, log loss, Brier score and calibration error of (W, L)."""
    present = [c for c in labels if (truth == c).any()]
    best = predicted(prob, labels)
    recall = np.array([np.mean(best[truth == c] == c) for c in present])
    label = np.array([labels.index(c) for c in truth])
    return {
        "n_windows": len(truth),
        "accuracy": round(float(np.mean(best == truth)), 4),
        "macro_recall": round(float(recall.mean()), 4),
        "recall": {c: round(float(r), 4) for c, r in zip(present, recall, strict=True)},
        "log_loss": round(float(-np.log(np.maximum(prob[np.arange(len(label)), label], 1e-15)).mean()), 4),
        "brier": round(brier_score(prob, label), 4),
        "expected_calibration_error": round(reliability(prob, best == truth).expected_calibration_error, 4),
        "confusion": {c: {d: int(np.sum(best[truth == c] == d)) for d in labels} for c in present},
    }


def worst_person_accuracy(truth: TextArray, prob: FloatArray, person: TextArray, labels: tuple[str, ...]) -> float:
    """Accuracy of the person with the lowest, of (W, L)."""
    right = predicted(prob, labels) == truth
    return round(float(min(right[person == name].mean() for name in np.unique(person))), 4)


def provenance(command: str) -> dict[str, Any]:
    """When something was made, with which versions, and how to make it again."""
    versions = {"python": platform.python_version(), "numpy": np.__version__, "scikit-learn": sklearn.__version__}
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "versions": versions, "command": command}
