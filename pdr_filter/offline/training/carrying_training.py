"""Train the models of the carrying mode: where a moving person has the phone.

Beside recordings they learn from windows that stand for other people (`synthetic_windows`), each where nothing real
does:

- **simulated** people, who differ in gait and in how they hold the phone, in all modes;
- **turned** windows: a real hand held in front of the body, the phone turned to the ear by one fixed rotation;
- **weak** windows: a real trouser pocket, its motion scaled down, for the slow walkers that the recordings lack.

There is no bag: no licensed recording of one has a gyroscope. Its probability is zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.probability_calibration import fit_temperature, tempered
from pdr_filter.offline.training.classifier_choice import fit_softmax
from pdr_filter.offline.training.cross_validation import (
    SCORED_DATASET,
    Columns,
    LabelledWindows,
    LeftOut,
    Progress,
    TextArray,
    TrainingPlan,
    in_order,
    label_of,
    part_progress,
    score,
    silent,
    train_one,
    with_familiarity,
    worst_person_accuracy,
)
from pdr_filter.offline.training.synthetic_windows import (
    SIMULATED,
    TURNED,
    balanced_weight,
    from_sources,
    grips,
    made_card,
)
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.context_stage import CARRYING_EXPONENT, CARRYING_STAY_PROB, follow_mode
from pdr_filter.sensing.features import carrying, invariant
from pdr_filter.sensing.features.feature_windows import N_MAGNITUDES, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate.population import MODES
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray
from pdr_filter.values.recording import Recording

WEAK = "weak"
N_SIMULATED = 120  # simulated people in each mode: as many as two cores make in a minute

FEATURE_NAMES: tuple[str, ...] = (*invariant.NAMES, *carrying.NAMES)
# Of the force, without the timing of the vertical within a step, which is there to recognise stairs: with it half of
# the swinging of oxford, left out, was missed, without it a seventh (calling of tyrex, left out, 12 % and 26 %).
_SHAKING_NAMES: tuple[str, ...] = tuple(n for n in invariant.WITHOUT_GYROSCOPE if not n.startswith("squared_vertical"))


@dataclass(frozen=True, kw_only=True)
class CarryingPlan(TrainingPlan):
    """How one model of the carrying mode is made.

    `source_weight` is of simulated, turned and weak windows; a data set has one.
    """

    head: str = "carrying_mode"
    feature_set: str = "invariant"
    source_weight: Mapping[str, float]

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """Every mode has the same weight, and inside a mode every source its own."""
        return balanced_weight(windows.carrying_mode, windows.dataset, self.source_weight)

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Every real person."""
        return {str(name): windows.person == name for name in np.unique(windows.person[self.is_real(windows)])}

    def finished(self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, LeftOut]) -> ContextModel:
        """The model with a temperature and the limit of what it knows, both of people left out, and its card."""
        left = in_order(left_out.values())
        rows, prob, distance = left.rows, left.prob, left.distance
        real = windows.part(rows)
        even = _even_rows(real)
        label = np.array([CARRYING_MODES.index(mode) for mode in real.carrying_mode])
        temperature = fit_temperature(prob[even], label[even])
        prob = tempered(prob, temperature)
        sites = {str(site): site_scores(real, prob, real.dataset == site) for site in np.unique(real.dataset)}
        people = sites.pop(SCORED_DATASET, {})
        card = {
            **self.card(windows, people, sites),
            **made_card(windows.dataset[~rows], self.source_weight),
            "scored": "People and sites that the scored model has not seen, nor anything derived from them. One "
            "number, the temperature, is fitted on the same held-out people. Other draws of simulated people change "
            "the recalls of calling, swinging and pocket on tyrex by up to 6 points, because these are one or two "
            "recordings each.",
        }
        known = with_familiarity(model, windows, float(np.quantile(distance[even], 0.99)))
        return replace(known, temperature=temperature, card=card)


# C is a seventh of what the contexts take: classes are known from few people, whose habits it must not learn.
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
    paths: Sequence[Path], out_dir: Path, progress: Progress = silent, n_simulated: int = N_SIMULATED
) -> list[dict[str, Any]]:
    """Cards of the models of `PLANS`, which are written to `out_dir`, with so many simulated people in each mode.

    Recordings of other data sets than a plan's are not used.
    """
    cards: list[dict[str, Any]] = []
    for i, plan in enumerate(PLANS):
        share = 1 / len(PLANS)
        windows = carrying_windows(plan, paths, n_simulated, part_progress(progress, i * share, 0.7 * share))
        model = train_one(plan, windows, part_progress(progress, (i + 0.7) * share, 0.3 * share))
        model.save(out_dir)
        cards.append(dict(model.card))
    return cards


def carrying_windows(
    plan: CarryingPlan, paths: Sequence[Path], n_simulated: int, progress: Progress = silent
) -> LabelledWindows:
    """Windows of moving people with the features of the plan: real ones, those made of them, and simulated ones.

    `dataset` is the source: a data set, `simulated`, or `turned_` or `weak_` and the data set.
    """
    found = from_sources(partial(_windows_of, plan), paths, n_simulated, f"{plan.name}: features", progress)
    parts = [part for of_source in found for part in of_source]
    if not any(plan.is_real(part).any() for part in parts):
        raise ValueError(
            f"no windows for {plan.name}: it needs recordings of {', '.join(plan.datasets)} of people who "
            f"move, with the carrying modes {', '.join(MODES)} in their truth_labels.csv"
        )
    return LabelledWindows.joined(parts)


@dataclass(frozen=True)
class RawSignals:
    """Features that are the samples of a window, `invariant.SIGNALS`, one row after the other."""

    name: str = "signals"
    names: tuple[str, ...] = invariant.SIGNALS
    low_pass_hz: None = None

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Samples (W, 12 N) of the signals of windows (W, N_SIGNALS, N)."""
        return windows[:, N_MAGNITUDES:].reshape(len(windows), -1)


@dataclass(frozen=True, eq=False)
class _Signals(Columns):
    """Windows of one recording and one carrying mode, a moving person's."""

    samples: FloatArray  # (W, 12, N)
    context: TextArray  # (W,)
    mode: TextArray  # (W,)
    has_gyroscope: BoolArray  # (W,)


def _windows_of(plan: CarryingPlan, recording: Recording, dataset: str, person: str) -> list[LabelledWindows]:
    """Windows of one recording or simulated person, and what is made of them."""
    if dataset not in (*plan.datasets, SIMULATED):
        return []
    found: list[tuple[str, _Signals]] = []
    for signals in _signals(plan, recording):
        found.append((dataset, signals))
        walking, mode = signals.part(signals.context == "walking"), signals.mode[0]
        if dataset == SIMULATED or not len(walking.samples):
            continue
        if TURNED in plan.source_weight and mode == "texting":
            found.append((f"{TURNED}_{dataset}", _turned(walking, recording.name)))
        # of the one data set with more than a few people: of fewer it would be more of the same
        if WEAK in plan.source_weight and mode == "pocket" and dataset == SCORED_DATASET:
            found.append((f"{WEAK}_{dataset}", _weak(walking, recording.name)))
    return [_labelled(plan, signals, person, made_of, recording.name) for made_of, signals in found]


def _signals(plan: CarryingPlan, recording: Recording) -> list[_Signals]:
    """What of a recording the plan is made of, by carrying mode."""
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
    """Features (W, F) of windows of `invariant.SIGNALS`, (W, 12, N), in the order of `FEATURE_NAMES`."""
    parts = [f(samples, rate_hz) for f in (invariant.invariant_features, carrying.carrying_features)]
    return np.concatenate(parts, axis=1)


def _labelled(plan: CarryingPlan, signals: _Signals, person: str, source: str, name: str) -> LabelledWindows:
    with threadpool_limits(1):
        features = features_of(signals.samples)[:, [FEATURE_NAMES.index(name) for name in plan.feature_names]]
    return LabelledWindows.of_one(features, signals.context, signals.mode, person, source, name, signals.has_gyroscope)


# Rows of `invariant.SIGNALS`: what is in the world's frame, and the vectors in the sensor's.
_WORLD, _RATE, _UP, _FORCE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Grips that a recording is turned to, each with every second window: how many matters little, as the weight is shared.
_TURNS = 4


def _turned(signals: _Signals, name: str) -> _Signals:
    """The phone of one recording turned from in front of the body to the ear: calling, with the same motion."""
    up = signals.samples[:, _UP].mean(axis=(0, 2))
    parts: list[_Signals] = []
    for turn, matrix in enumerate(grips([up] * _TURNS, name)):
        half = signals.part(slice(turn % 2, None, 2))
        samples = half.samples.copy()
        for rows in (_RATE, _UP, _FORCE):
            samples[:, rows] = matrix @ samples[:, rows]
        parts.append(replace(half, samples=samples, mode=np.full(len(samples), "calling")))
    return _Signals.joined(parts)


def _weak(signals: _Signals, name: str) -> _Signals:
    """Every second window slowed down: angles and rates times f = 0.25 to 0.85, accelerations (frequency too) f^1.5."""
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
    """Rows that hold about as many windows of every data set and carrying mode, (W,)."""
    use = np.zeros(len(windows.dataset), dtype=bool)
    for dataset in np.unique(windows.dataset):
        for mode in MODES:
            rows = np.flatnonzero((windows.dataset == dataset) & (windows.carrying_mode == mode))
            use[rows[np.linspace(0, len(rows) - 1, min(at_most, len(rows))).astype(int)]] = True
    return use


def site_scores(windows: LabelledWindows, prob: FloatArray, use: BoolArray) -> dict[str, Any]:
    """Scores of some windows: `score`, the number of windows of each mode, and the recall of the worst person.

    "followed" are the probabilities after each window, as `ContextModels` follows the mode through a recording.
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
    """Probabilities (W, L) after each window of its recording, all modes alike before the first."""
    prior = np.array([float(mode in MODES) for mode in CARRYING_MODES])
    prior /= prior.sum()
    result = np.zeros_like(prob)
    for i in range(len(prob)):
        before = result[i - 1] if i and recording[i] == recording[i - 1] else prior
        result[i] = follow_mode(before, prob[i], prior, CARRYING_STAY_PROB, CARRYING_EXPONENT)
    return result
