"""Training of the models of the carrying mode: where a moving person carries the phone.

Besides recordings, training uses synthetic windows (`synthetic_windows`) where real ones are missing:

- **simulated** people, who differ in gait and in how they hold the phone, in all modes;
- **turned** windows: a real hand in front of the body, with the phone rotated to the ear by one fixed rotation;
- **weak** windows: a real trouser pocket with its motion scaled down, for slow walkers.

There are no bags, because no licensed recording of one has a gyroscope. The probability of a bag is zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax
from threadpoolctl import threadpool_limits

from models.training.data_sets import OTHER_STOREYS, SCORED_DATASET, ShippedPlan, label_of, part_progress
from models.training.sine_people import MODES
from models.training.synthetic_windows import (
    SIMULATED,
    TURNED,
    balanced_weight,
    ear_rotations,
    from_sources,
    synthetic_card,
    windows_of_one,
)
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.probability_calibration import tempered_prob
from pdr_filter.offline.columns import Columns
from pdr_filter.offline.training.classifier_choice import fit_softmax
from pdr_filter.offline.training.cross_validation import (
    HeldOut,
    LabelledWindows,
    Progress,
    TextArray,
    in_window_order,
    score,
    silent,
    train_one,
    with_familiarity,
    worst_person_accuracy,
)
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.context_stage import CARRYING_EXPONENT, CARRYING_STAY_PROB, follow_mode
from pdr_filter.sensing.features import carrying, invariant
from pdr_filter.sensing.features.feature_windows import N_MAGNITUDES, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, IntArray
from pdr_filter.values.recording import Recording

WEAK = "weak"
N_SIMULATED = 120  # simulated people in each mode: as many as two cores simulate in a minute

FEATURE_NAMES: tuple[str, ...] = (*invariant.NAMES, *carrying.NAMES)
# Features of the force without the timing of the vertical within a step, which serves to recognise stairs. With it,
# half of the swinging in the held-out oxford data was missed, and without it a seventh (calling in the held-out tyrex
# data: 12 % and 26 %).
_SHAKING_NAMES: tuple[str, ...] = tuple(n for n in invariant.WITHOUT_GYROSCOPE if not n.startswith("squared_vertical"))


@dataclass(frozen=True, kw_only=True)
class CarryingPlan(ShippedPlan):
    """Plan of one model of the carrying mode.

    `source_weight` has the total weight of the synthetic windows of each kind, relative to one for the windows of a
    recorded data set. The kinds are "simulated" people, "turned" windows (a phone in the hand, rotated to the ear) and
    "weak" windows (a trouser pocket, motion scaled down).
    """

    head: str = "carrying_mode"
    feature_set: str = "invariant"
    source_weight: Mapping[str, float]

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """Return weights (W,) with the same total for every carrying mode.

        Within a mode, each source (data set or kind of synthetic windows) has a total in proportion to `source_weight`.
        """
        return balanced_weight(windows.carrying_mode, windows.dataset, self.source_weight)

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Return the windows of each real person as masks (W,) by name, including synthetic ones made from them."""
        return {str(name): windows.person == name for name in np.unique(windows.person[self.is_real(windows)])}

    def final_model(
        self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, HeldOut]
    ) -> ContextModel:
        """Return the final model, with its temperature, its `Familiarity` and its card.

        The temperature and the limit of `Familiarity` are determined from held-out people.
        """
        left = in_window_order(left_out.values())
        rows, prob, distance = left.rows, left.prob, left.distance
        real = windows.part(rows)
        even = _even_rows(real)
        label = np.array([CARRYING_MODES.index(mode) for mode in real.carrying_mode])
        temperature = fit_temperature(prob[even], label[even])
        prob = tempered_prob(prob, temperature)
        sites = {str(site): site_scores(real, prob, real.dataset == site) for site in np.unique(real.dataset)}
        people = sites.pop(SCORED_DATASET, {})
        card = {
            **self.card(windows, people, sites),
            **synthetic_card(windows.dataset[~rows], self.source_weight),
            "scored": "People and sites that the scored model has not seen, nor anything derived from them. One "
            "number, the temperature, is fitted on the same held-out people. Other draws of simulated people change "
            "the recalls of calling, swinging and pocket on tyrex by up to 6 points, because these are one or two "
            "recordings each.",
        }
        known = with_familiarity(model, windows, float(np.quantile(distance[even], 0.99)))
        return replace(known, temperature=temperature, card=card)


# C is a seventh of that of the contexts: some classes have few people, whose habits the model must not learn.
_FIT = partial(fit_softmax, C=0.003)
_USE = "Windows of a moving person. It is not meant for people who stand or sit."
_LIMITS = (
    "Four modes: the data contain no bag, so that its probability is zero, and a phone in a bag is classified as "
    "another mode without a warning. "
    "Calling and swinging come from one real person and simulation{more}."
)
PLANS: tuple[CarryingPlan, ...] = (
    CarryingPlan(
        name="carrying",
        feature_names=carrying.NAMES,
        datasets=("motionsense", "tyrex", "humolire", "ms_indoor"),
        excluded=OTHER_STOREYS,
        machine_fit=_FIT,
        description="Logistic regression on attitude, force and turning of the phone; trained on real recordings, on "
        "recordings rotated to the ear or made weaker, and on simulated people.",
        use=_USE,
        limits=_LIMITS.format(more=", calling also from rotated recordings of other people's hands"),
        source_weight={SIMULATED: 0.3, TURNED: 0.33, WEAK: 2.0},
    ),
    CarryingPlan(
        name="carrying_accelerometer",
        feature_names=(*_SHAKING_NAMES, *carrying.ATTITUDE),
        datasets=("motionsense", "tyrex", "humolire", "ms_indoor", "oxford"),
        excluded=OTHER_STOREYS,
        machine_fit=_FIT,
        description="Logistic regression on the accelerometer's features of force and attitude; trained on real "
        "recordings without their angular rate and on simulated people.",
        use=_USE + " For phones without gyroscope; with one, `carrying` is better.",
        limits=_LIMITS.format(more=", swinging also from a second person"),
        has_gyroscope=False,
        source_weight={SIMULATED: 0.3},
    ),
)


def train_carrying(
    paths: Sequence[Path],
    out_dir: Path,
    progress: Progress = silent,
    n_simulated: int = N_SIMULATED,
    plans: Sequence[CarryingPlan] = PLANS,
) -> list[dict[str, Any]]:
    """Train carrying-mode models, save them to `out_dir`, and return their model cards.

    A model card describes data, purpose and scores. `n_simulated` is the number of simulated people in each mode.
    Recordings of data sets that a plan does not list are ignored.
    """
    cards: list[dict[str, Any]] = []
    for i, plan in enumerate(plans):
        share = 1 / len(plans)
        windows = carrying_windows(plan, paths, n_simulated, part_progress(progress, i * share, 0.7 * share))
        model = train_one(plan, windows, part_progress(progress, (i + 0.7) * share, 0.3 * share))
        model.save(out_dir)
        cards.append(dict(model.card))
        progress(f"{plan.name}: saved", (i + 1) * share)
    return cards


def carrying_windows(
    plan: CarryingPlan, paths: Sequence[Path], n_simulated: int, progress: Progress = silent
) -> LabelledWindows:
    """Return windows of moving people with the features of a training plan: real, made from real ones, and simulated.

    `dataset` of a window is its source: a data set, `simulated`, or `turned_` or `weak_` and the data set.
    """
    found = from_sources(partial(_windows_of, plan), paths, n_simulated, f"{plan.name}: features", progress)
    parts = [part for of_source in found for part in of_source]
    if not any(plan.is_real(part).any() for part in parts):
        raise ValueError(
            f"no windows for {plan.name}: give recordings of {', '.join(plan.datasets)} with moving people and "
            f"the carrying modes {', '.join(MODES)} in their truth_labels.csv"
        )
    return LabelledWindows.concatenate(parts)


@dataclass(frozen=True)
class RawSignals:
    """Feature set of the raw samples of a window, the rows of `invariant.SIGNALS` one after the other."""

    name: str = "signals"
    names: tuple[str, ...] = invariant.SIGNALS
    low_pass_hz: None = None

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the samples (W, 12 N) of the signals of windows (W, N_SIGNALS, N)."""
        return windows[:, N_MAGNITUDES:].reshape(len(windows), -1)


@dataclass(frozen=True, eq=False)
class _Signals(Columns):
    """Windows of a moving person, from one recording and one carrying mode.

    `samples` is (W, 12, N), and all other fields are (W,).
    """

    samples: FloatArray
    context: TextArray
    mode: TextArray
    has_gyroscope: BoolArray


def _windows_of(plan: CarryingPlan, recording: Recording, dataset: str, person: str) -> list[LabelledWindows]:
    """Return the windows of one recording or simulated person, and synthetic windows made from a recording.

    There is one item for each carrying mode and kind of windows. The list is empty for a recording that the training
    plan does not use.
    """
    if dataset != SIMULATED and not plan.uses(dataset, recording.name):
        return []
    found: list[tuple[str, _Signals]] = []
    for signals in _signals(plan, recording):
        found.append((dataset, signals))
        walking, mode = signals.part(signals.context == "walking"), signals.mode[0]
        if dataset == SIMULATED or not len(walking.samples):
            continue
        if TURNED in plan.source_weight and mode == "texting":
            found.append((f"{TURNED}_{dataset}", _turned(walking, recording.name)))
        # only from the data set with many people: for few people, these windows would repeat the same information
        if WEAK in plan.source_weight and mode == "pocket" and dataset == SCORED_DATASET:
            found.append((f"{WEAK}_{dataset}", _weak(walking, recording.name)))
    return [_labelled(plan, signals, person, made_of, recording.name) for made_of, signals in found]


def _signals(plan: CarryingPlan, recording: Recording) -> list[_Signals]:
    """Return the windows of a recording that a training plan can use, one item for each carrying mode.

    They lie inside one label of a moving person with a mode of `MODES`. With `has_gyroscope` they have an angular rate.
    """
    stage = FeatureWindows(features=RawSignals())
    recording = recording if plan.has_gyroscope else replace(recording, gyroscope=None)
    rows: dict[str, list[tuple[FloatArray, str, str, bool]]] = {}
    for window in feature_windows(stage, [merge_streams(recording)]):
        context, mode = label_of(recording, window.time_s - stage.window_s, window.time_s) or ("", "")
        usable = window.has_gyroscope or not plan.has_gyroscope
        if usable and context not in ("", "stationary") and mode in MODES:
            samples = window.features.reshape(len(invariant.SIGNALS), -1)
            rows.setdefault(mode, []).append((samples, context, mode, window.has_gyroscope))
    return [_Signals(*(np.array(column) for column in zip(*found, strict=True))) for found in rows.values()]


def features_of(samples: FloatArray, rate_hz: float = 100.0) -> FloatArray:
    """Return the features (W, F) of windows (W, 12, N) of `invariant.SIGNALS`, in the order of `FEATURE_NAMES`."""
    return invariant.features_in_groups(_features_of_motion, samples, rate_hz, len(FEATURE_NAMES))


def _features_of_motion(motion: invariant.MotionLines, rate_hz: float) -> FloatArray:
    """Return the features (W, F) of a few windows."""
    parts = (invariant.invariant_features_of_motion, carrying.carrying_features_of_motion)
    return np.concatenate([features(motion, rate_hz) for features in parts], axis=1)


def _labelled(plan: CarryingPlan, signals: _Signals, person: str, source: str, name: str) -> LabelledWindows:
    """Return the windows in `signals` with their labels and with the features of a training plan.

    `source` is the data set or the kind of synthetic windows, and `name` is the recording.
    """
    with threadpool_limits(1):
        features = features_of(signals.samples)[:, [FEATURE_NAMES.index(name) for name in plan.feature_names]]
    return windows_of_one(features, signals.context, signals.mode, person, source, name, signals.has_gyroscope)


# Rows of `invariant.SIGNALS`: signals in the world frame, and three vectors in the sensor frame.
_WORLD, _RATE, _UP, _FORCE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Number of rotations per recording, each with every second window. The exact number matters little, because the
# rotations share one weight.
_TURNS = 4


def _turned(signals: _Signals, name: str) -> _Signals:
    """Return synthetic windows of a phone at the ear, with carrying mode "calling".

    `signals` are windows of a phone in front of the body. Their sensor axes are rotated to a phone at the ear, and the
    motion stays the same. Each of `_TURNS` random rotations is applied to every second window. The name of the
    recording, `name`, is the seed of the rotations.
    """
    up = signals.samples[:, _UP].mean(axis=(0, 2))
    parts: list[_Signals] = []
    for turn, matrix in enumerate(ear_rotations([up] * _TURNS, name)):
        half = signals.part(slice(turn % 2, None, 2))
        samples = half.samples.copy()
        for rows in (_RATE, _UP, _FORCE):
            samples[:, rows] = matrix @ samples[:, rows]
        parts.append(replace(half, samples=samples, mode=np.full(len(samples), "calling")))
    return _Signals.concatenate(parts)


def _weak(signals: _Signals, name: str) -> _Signals:
    """Return synthetic windows of a slow walker: every second window, with a smaller motion.

    The motion of each window is scaled by a random factor f between 0.25 and 0.85. Angles and rates are multiplied by
    f. Accelerations are multiplied by f^1.5, because slow walkers have a lower step frequency too. The timing of the
    samples does not change. The name of the recording, `name`, is the seed of the factors.
    """
    signals = signals.part(slice(None, None, 2))
    samples = signals.samples.copy()
    factor = np.random.default_rng(crc32(name.encode())).uniform(0.25, 0.85, len(samples))[:, None, None]
    mean_up, mean_force = (samples[:, rows].mean(axis=2, keepdims=True) for rows in (_UP, _FORCE))
    samples[:, _WORLD] *= factor**1.5
    samples[:, _RATE] *= factor
    up = mean_up + (samples[:, _UP] - mean_up) * factor
    samples[:, _UP] = up / np.sqrt((up * up).sum(axis=1, keepdims=True))
    samples[:, _FORCE] = mean_force + (samples[:, _FORCE] - mean_force) * factor**1.5
    return replace(signals, samples=samples)


def _even_rows(windows: LabelledWindows, at_most: int = 300) -> BoolArray:
    """Return a mask (W,) of at most `at_most` windows of each data set and carrying mode, evenly spaced."""
    use = np.zeros(len(windows.dataset), dtype=bool)
    for dataset in np.unique(windows.dataset):
        for mode in MODES:
            rows = np.flatnonzero((windows.dataset == dataset) & (windows.carrying_mode == mode))
            use[rows[np.linspace(0, len(rows) - 1, min(at_most, len(rows))).astype(int)]] = True
    return use


def site_scores(windows: LabelledWindows, prob: FloatArray, use: BoolArray) -> dict[str, Any]:
    """Return the scores of some windows: `score`, the number of windows of each mode, and the worst person's accuracy.

    `use` is a mask (W,) of these windows. "followed" scores are of the probabilities filtered over time, as
    `ContextModels` does.
    """
    own, prob = windows.part(use), prob[use]
    truth = own.carrying_mode
    followed = score(truth, _followed(own.recording, prob), CARRYING_MODES)
    return {
        **score(truth, prob, CARRYING_MODES),
        "followed_recall": followed["recall"],
        "followed_log_loss": followed["log_loss"],
        "n": {mode: int((truth == mode).sum()) for mode in MODES if (truth == mode).any()},
        "worst_person_accuracy": worst_person_accuracy(truth, prob, own.person, CARRYING_MODES),
    }


def _followed(recording: TextArray, prob: FloatArray) -> FloatArray:
    """Return the filtered probabilities (W, L) of the L `CARRYING_MODES` after each window of its recording.

    Each recording starts with equal probabilities of the modes in `MODES`, and zero for the others.
    """
    prior = np.array([float(mode in MODES) for mode in CARRYING_MODES])
    prior /= prior.sum()
    result = np.zeros_like(prob)
    for i in range(len(prob)):
        before = result[i - 1] if i and recording[i] == recording[i - 1] else prior
        result[i] = follow_mode(before, prob[i], prior, CARRYING_STAY_PROB, CARRYING_EXPONENT)
    return result


def fit_temperature(prob: FloatArray, label: IntArray) -> float:
    """Return the temperature, 0.2 to 5, with the lowest log loss of probabilities (N, K) for labels (N,).

    The probabilities must be of people who are not in the training data. For people in the training data the result
    would be 1 or less.
    """
    log_prob = np.log(np.maximum(prob, 1e-300))

    def log_loss(log_temperature: float) -> float:
        scaled = log_softmax(log_prob / np.exp(log_temperature), axis=1)
        return float(-scaled[np.arange(len(label)), label].mean())

    found: Any = minimize_scalar(log_loss, bounds=(np.log(0.2), np.log(5.0)), method="bounded")
    return float(np.exp(found.x))
