"""Train the context models: what a person does, from windows of features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.context_model import ContextModel, not_told_apart
from pdr_filter.classifiers.familiarity import unknown_share
from pdr_filter.classifiers.probability_calibration import fit_calibration, slipped, tempered
from pdr_filter.offline.training.classifier_choice import fit_blend, fit_forest, fit_relevance_vectors
from pdr_filter.offline.training.cross_validation import (
    SCORED_DATASET,
    STAIRS,
    STAIRS_SHARPNESS,
    LabelledWindows,
    LeftOut,
    Progress,
    TextArray,
    TrainingPlan,
    in_order,
    label_of,
    read_recording,
    score,
    silent,
    source_of,
    with_familiarity,
    worst_person_accuracy,
)
from pdr_filter.recipes.martinelli2018 import features as martinelli
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features import invariant, stride
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureSet, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray

FEATURE_SETS: dict[str, FeatureSet] = {s.name: s for s in (martinelli.TABLE_II, ATTITUDE_FREE)}

DEFAULT_MODEL = "context"  # the model of the default recipe: transitions and tempering are estimated for it
# Whose people are left out, one at a time. Were a site's only person, the calibration would be that of new sites as
# well, and make the model unsure about everybody; `Familiarity` is the guard there.
SCORED_DATASETS = (SCORED_DATASET, "difronzo")
# Of the windows on stairs of people left out, those that must still be like stairs in training.
_STAIRS_QUANTILE = 0.98


@dataclass(frozen=True, kw_only=True)
class ContextPlan(TrainingPlan):
    """How one model of the context is made."""

    head: str = "context"
    # How much windows count whose recording's name holds a word; what has none counts one.
    recording_weight: Mapping[str, float] = field(default_factory=dict[str, float])

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """How much each window counts, (W,)."""
        result = np.ones(len(windows.recording))
        for word, weight in self.recording_weight.items():
            result[np.char.find(windows.recording, word) >= 0] = weight
        return result

    def rows(self, windows: LabelledWindows) -> BoolArray:
        """Which windows the model learns from, (W,)."""
        return self.is_real(windows) & (windows.has_gyroscope | (not self.has_gyroscope)) & (windows.context != "")

    def features(self, windows: LabelledWindows) -> FloatArray:
        """The model's features of windows with all features of the set, (W, F)."""
        names = FEATURE_SETS[self.feature_set].names
        return windows.features[:, [names.index(name) for name in self.feature_names]]

    def of(self, windows: LabelledWindows) -> LabelledWindows:
        """The windows that the model learns from, with its features, out of those with all features of the set."""
        return replace(windows, features=self.features(windows)).part(self.rows(windows))

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Every person of the scored data sets."""
        people = np.unique(windows.person[np.isin(windows.dataset, SCORED_DATASETS)])
        return {str(name): windows.person == name for name in people}

    def finished(self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, LeftOut]) -> ContextModel:
        """The model, calibrated, with the limits of what it knows and its card, on which sites are left out too.

        Its calibration is fitted on all people left out; the one that a person is scored with, on all others of them.
        """
        left = in_order(left_out.values())
        of_left = windows.part(left.rows)
        y, person = of_left.context, of_left.person
        prob = cross_calibrated(left.prob, y, person, model)
        temperature, slip = calibration(left.prob, y, model)
        stairs_limit = None
        if self.guards_stairs:
            stairs_limit = float(np.quantile(left.stairs_distance[np.isin(y, STAIRS)], _STAIRS_QUANTILE))
            share = unknown_share(left.stairs_distance, stairs_limit, STAIRS_SHARPNESS)
            prob = not_told_apart(prob, share, [self.labels.index(label) for label in ("walking", *STAIRS)])
        limits = float(np.quantile(left.distance, 0.99)), stairs_limit
        model = replace(model, temperature=temperature, slip=slip)
        scores = {name: self._scores(of_left, prob, name) for name in SCORED_DATASETS if name in of_left.dataset}
        sites: dict[str, Any] = {}
        for site in self.datasets:
            if site not in (*SCORED_DATASETS, "tyrex"):
                rest, own = windows.part(windows.dataset != site), windows.features[windows.dataset == site]
                without = replace(self.fit_machine(rest), temperature=temperature, slip=slip)
                sites[site] = _walking_scores(with_familiarity(without, rest, *limits).probabilities(own))
        card = self.card(windows, {**scores.pop(SCORED_DATASET, {}), **scores}, sites)
        return replace(with_familiarity(model, windows, *limits), card=card)

    def _scores(self, windows: LabelledWindows, prob: FloatArray, dataset: str) -> dict[str, Any]:
        own = windows.dataset == dataset
        y, prob, person = windows.context[own], prob[own], windows.person[own]
        worst = worst_person_accuracy(y, prob, person, self.labels)
        return {**score(y, prob, self.labels), "worst_person_accuracy": worst}


def cross_calibrated(prob: FloatArray, context: TextArray, person: TextArray, model: ContextModel) -> FloatArray:
    """Probabilities (W, C) of people left out, those of each calibrated on all others; `model` has the classes."""
    result = np.zeros_like(prob)
    for name in np.unique(person):
        own = person == name
        result[own] = calibrated(prob[own], model, *calibration(prob[~own], context[~own], model))
    return result


def calibration(prob: FloatArray, context: TextArray, model: ContextModel) -> tuple[float, float]:
    """Return temperature and slip of the probabilities of windows (W, C) of people left out.

    `model` has the classes. The slip is 1 / (W + 2) at least, by Laplace's rule of succession: W windows without a
    surprise do not exclude one, and a single impossible label of a stranger would have an infinite log loss.
    """
    if not len(context):
        return 1.0, 0.0
    label = np.array([model.classes.index(c) for c in context])
    temperature, slip = fit_calibration(prob[:, _columns(model)], label)
    return temperature, max(slip, 1.0 / (len(label) + 2))


def calibrated(prob: FloatArray, model: ContextModel, temperature: float, slip: float) -> FloatArray:
    """Return calibrated probabilities (W, C), which are zero but for the classes of `model`."""
    result = np.zeros_like(prob)
    result[:, _columns(model)] = slipped(tempered(prob[:, _columns(model)], temperature), slip)
    return result


def _columns(model: ContextModel) -> list[int]:
    return [model.labels.index(c) for c in model.classes]


def _walking_scores(prob: FloatArray) -> dict[str, Any]:
    """How much of a site's walking is taken for walking by a model that has not seen the site."""
    walking = CONTEXTS.index("walking")
    return {
        "n_windows": len(prob),
        "walking_recall": round(float((prob.argmax(axis=1) == walking).mean()), 4),
        "mean_walking_prob": round(float(prob[:, walking].mean()), 4),
    }


_ALL_SITES = ("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor", "oxford")
_NO_SIDEWAYS = "The data contain no sideways walking, so that its probability is zero."
_FROM_POCKETS = (
    "Stairs, standing and sitting are known from the trouser pockets of sixteen people in two places, running from "
    "pockets and one person's hand. In windows unlike all stairs of the training, stairs are not distinguished from "
    "level walking and have the share of an average day (0.03 each)."
)
PLANS: tuple[ContextPlan, ...] = (
    ContextPlan(
        name="context",
        feature_set="invariant",
        feature_names=(*invariant.NAMES, *stride.NAMES),
        datasets=("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor"),
        machine_fit=fit_blend,
        guards_stairs=True,
        # One person stands for all back pockets, sixteen for front pockets. Counted five times, level walking of
        # ubicomp13 in back pockets is called stairs in 7 % of the steps instead of 11 %, and the macro recall of people
        # left out is 0.4 points lower. (The five was chosen with a look at ubicomp13, which trains nothing.)
        recording_weight={"backpocket": 5.0},
        description="Mean of logistic regression and boosted trees on all attitude-free features; the default recipe.",
        use="A phone in a trouser pocket or in the hand; bags and shirt pockets were not in the training but are "
        "classified well.",
        limits=f"{_NO_SIDEWAYS} {_FROM_POCKETS}",
    ),
    ContextPlan(
        name="context_accelerometer",
        feature_set="invariant",
        feature_names=invariant.WITHOUT_GYROSCOPE,
        datasets=_ALL_SITES,
        machine_fit=fit_blend,
        guards_stairs=True,
        description="Mean of logistic regression and boosted trees on the attitude-free features of the accelerometer.",
        use="Windows without angular rate, however the phone is carried.",
        limits=f"{_NO_SIDEWAYS} {_FROM_POCKETS} One window on stairs in three is missed.",
        has_gyroscope=False,
    ),
    ContextPlan(
        name="context_martinelli_rvm",
        feature_set="martinelli",
        feature_names=martinelli.WITHOUT_MAGNETOMETER,
        datasets=("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor"),
        machine_fit=partial(fit_relevance_vectors, kernel_width=3.0, window_weight=1.0, max_rows=4000, max_samples=500),
        description="Relevance vector machine, one-against-all, RBF kernel, on the 23 features of accelerometer and "
        "gyroscope of Martinelli et al. 2018; the martinelli2018 recipe.",
        use="Comparison with the paper; trouser pockets and hands.",
        limits=f"{_NO_SIDEWAYS} Stairs are known from trouser pockets only.",
    ),
    ContextPlan(
        name="context_martinelli_forest",
        feature_set="martinelli",
        feature_names=martinelli.WITHOUT_GYROSCOPE,
        # Without difronzo: on sixteen features its stairs cost more of the others' walking than they are worth.
        datasets=("motionsense", "tyrex", "humolire", "ms_indoor", "oxford"),
        machine_fit=fit_forest,
        description="Random forest on the 16 accelerometer features of Martinelli et al. 2018.",
        use="The martinelli2018 recipe without a gyroscope.",
        limits=f"{_NO_SIDEWAYS} Stairs are known from trouser pockets only.",
        has_gyroscope=False,
    ),
)


def labelled_windows(
    paths: Sequence[Path], progress: Progress = silent, feature_set: str = "martinelli", with_gyroscope: bool = True
) -> LabelledWindows:
    """Windows of recordings that lie wholly inside a label with a known context, with or without their gyroscopes."""
    stage = FeatureWindows(features=FEATURE_SETS[feature_set])
    rows: list[tuple[FloatArray, str, str, str, str, str, bool]] = []
    for i, path in enumerate(paths):
        recording = read_recording(path)
        if not with_gyroscope:
            recording = replace(recording, gyroscope=None)
        dataset, person = source_of(recording)
        for window in feature_windows(stage, [merge_streams(recording)]):
            label = label_of(recording, window.time_s - stage.window_s, window.time_s)
            if label is not None:
                rows.append((window.features, *label, person, dataset, recording.name, window.has_gyroscope))
        progress(f"features of {path.stem}", (i + 1) / len(paths))
    if not rows:
        raise ValueError("no labelled windows: the recordings need truth_labels.csv with known contexts")
    return LabelledWindows(*(np.array(column) for column in zip(*rows, strict=True)))


def model_without(
    model: ContextModel, plan: ContextPlan, windows: LabelledWindows, people: Sequence[str]
) -> ContextModel:
    """The model of a plan as it is when these people are not in its training; itself if none of them was.

    Calibration and the limits of what is familiar stay: they are those of people left out already.
    """
    rest = ~np.isin(windows.person, people)
    if rest.all():
        return model
    others = windows.part(rest)
    with threadpool_limits(1):
        without = replace(plan.fit(others), card=model.card, temperature=model.temperature, slip=model.slip)
    if model.familiarity is None:
        return without
    return with_familiarity(without, others, model.familiarity.limit, model.stairs and model.stairs.limit)
