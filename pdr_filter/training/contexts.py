"""Train the context models: what a person does, from windows of features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.model_selection import GroupKFold

from pdr_filter.classifiers.model import ContextModel
from pdr_filter.classifiers.probability_calibration import fit_calibration
from pdr_filter.io.formats import read
from pdr_filter.papers.martinelli2018 import features as martinelli
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.features.windows import ATTITUDE_FREE, FeatureSet, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.training.machines import fit_blend, fit_forest, fit_relevance_vectors
from pdr_filter.training.protocol import (
    SCORED_DATASET,
    LabelledWindows,
    LeftOut,
    Plan,
    Progress,
    TextArray,
    in_order,
    label_of,
    score,
    silent,
    source_of,
    with_familiarity,
    worst_person_accuracy,
)
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray

FEATURE_SETS: dict[str, FeatureSet] = {s.name: s for s in (martinelli.TABLE_II, ATTITUDE_FREE)}

DEFAULT_MODEL = "context"  # the model of the default recipe: transitions and tempering are estimated for it
_LARGE_SITE = 4  # a site of fewer people is not used for calibration


@dataclass(frozen=True, kw_only=True)
class ContextPlan(Plan):
    """How one model of the context is made."""

    head: str = "context"

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

    def fit(self, windows: LabelledWindows) -> ContextModel:
        """A model, its calibration fitted on people left out one fold of four at a time.

        Only people whose site has at least four of them are left out: were a site's only person, the calibration would
        be that of new sites as well, and make the model unsure about everybody; `Familiarity` is the guard there.
        """
        once = self.fit_machine(windows)
        leave = np.flatnonzero(_of_large_sites(windows.person))
        if not len(leave):
            return once
        out_of_fold = np.zeros((len(leave), len(self.labels)))
        for _, test in GroupKFold(4).split(leave, groups=windows.person[leave]):
            rest = np.ones(len(windows.person), dtype=bool)
            rest[leave[test]] = False
            out_of_fold[test] = self.fit_machine(windows.part(rest)).probabilities(windows.features[leave[test]])
        columns = [self.labels.index(c) for c in once.classes]
        label = np.array([once.classes.index(c) for c in windows.context[leave]])
        temperature, slip = fit_calibration(out_of_fold[:, columns], label)
        return replace(once, temperature=temperature, slip=slip)

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Every person of the scored data set."""
        people = np.unique(windows.person[windows.dataset == SCORED_DATASET])
        return {str(name): windows.person == name for name in people}

    def finished(self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, LeftOut]) -> ContextModel:
        """The model with the limit of what it knows and its card, on which sites are left out too."""
        rows, prob, distance = in_order(left_out.values())
        y, person = windows.context[rows], windows.person[rows]
        worst = worst_person_accuracy(y, prob, person, self.labels)
        scores = {**score(y, prob, self.labels), "worst_person_accuracy": worst}
        sites: dict[str, Any] = {}
        for site in self.datasets:
            if site not in (SCORED_DATASET, "tyrex"):
                own = windows.dataset == site
                without = self.fit_machine(windows.part(~own))
                without = replace(without, temperature=model.temperature, slip=model.slip)
                sites[site] = _walking_scores(without.probabilities(windows.features[own]))
        known = with_familiarity(model, windows, float(np.quantile(distance, 0.99)))
        return replace(known, card=self.card(windows, scores, sites))


def _of_large_sites(person: TextArray) -> BoolArray:
    """Which windows are of a data set with at least four people; a person is "data set/subject"."""
    people = np.unique(person)
    site = [name.split("/")[0] for name in people]
    large = [name for name, s in zip(people, site, strict=True) if site.count(s) >= _LARGE_SITE]
    return np.isin(person, large)


def _walking_scores(prob: FloatArray) -> dict[str, Any]:
    """How much of a site's walking is taken for walking by a model that has not seen the site."""
    walking = CONTEXTS.index("walking")
    return {
        "n_windows": len(prob),
        "walking_recall": round(float((prob.argmax(axis=1) == walking).mean()), 4),
        "mean_walking_prob": round(float(prob[:, walking].mean()), 4),
    }


_ALL_SITES = ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford")
_NO_SIDEWAYS = "No sideways walking in the data: its probability is zero."
_FROM_POCKETS = (
    "Stairs, standing and sitting are known from the trouser pockets of one building's people, running from pockets "
    "and one person's hand."
)
PLANS: tuple[ContextPlan, ...] = (
    ContextPlan(
        name="context",
        feature_set="invariant",
        feature_names=invariant.NAMES,
        datasets=("motionsense", "tyrex", "humolire", "ms_indoor"),
        machine_fit=fit_blend,
        description="Mean of logistic regression and boosted trees on all attitude-free features; the default recipe.",
        use="A phone in a trouser pocket or in the hand; bags and shirt pockets were not in training but come out "
        "well.",
        limits=f"{_NO_SIDEWAYS} {_FROM_POCKETS}",
    ),
    ContextPlan(
        name="context_accelerometer",
        feature_set="invariant",
        feature_names=invariant.WITHOUT_GYROSCOPE,
        datasets=_ALL_SITES,
        machine_fit=fit_blend,
        description="Mean of logistic regression and boosted trees on the attitude-free features of the accelerometer.",
        use="Windows without angular rate, however the phone is carried.",
        limits=f"{_NO_SIDEWAYS} {_FROM_POCKETS} One window on stairs in three is missed.",
        has_gyroscope=False,
    ),
    ContextPlan(
        name="context_martinelli_rvm",
        feature_set="martinelli",
        feature_names=martinelli.WITHOUT_MAGNETOMETER,
        datasets=("motionsense", "tyrex"),
        machine_fit=partial(fit_relevance_vectors, kernel_width=3.0, window_weight=1.0, max_rows=4000, max_samples=500),
        description="Relevance vector machine, one-against-all, RBF kernel, on the 23 features of accelerometer and "
        "gyroscope of Martinelli et al. 2018; the martinelli2018 recipe.",
        use="Comparison with the paper; trouser pockets.",
        limits=f"{_NO_SIDEWAYS} Hand-held walking is taken for stairs: it knows the hand from one person.",
    ),
    ContextPlan(
        name="context_martinelli_forest",
        feature_set="martinelli",
        feature_names=martinelli.WITHOUT_GYROSCOPE,
        datasets=_ALL_SITES,
        machine_fit=fit_forest,
        description="Random forest on the 16 accelerometer features of Martinelli et al. 2018.",
        use="The martinelli2018 recipe where the gyroscope is missing.",
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
        recording = read(path)
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

    The limit of what is familiar stays: it is that of people left out already.
    """
    rest = ~np.isin(windows.person, people)
    if rest.all():
        return model
    others = windows.part(rest)
    without = replace(plan.fit(others), card=model.card)
    return without if model.familiarity is None else with_familiarity(without, others, model.familiarity.limit)
