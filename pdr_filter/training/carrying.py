"""Train the models that tell where a moving person carries the phone.

Licensed recordings know calling, swinging and the back pocket of one person, so a classifier of them alone learns that
person. Three further sources of windows stand for others, each where nothing real does:

- **simulated** people, who differ in gait and in how they hold the phone, in all modes;
- **turned** windows: a real hand held in front of the body, the phone turned to the ear by one fixed rotation, which is
  calling with a real hand's motion;
- **weak** windows: a real trouser pocket, its motion scaled down, for the slow walkers that the recordings lack.

Every class has the same weight, and inside a class every source its own whatever its size, so neither simulation nor
the largest data set decides. A window that was made of a person's recording is left out together with that person.
There is no bag: no licensed recording of one has a gyroscope. Its probability is zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from joblib import Parallel, delayed
from scipy.spatial.transform import Rotation
from sklearn.linear_model import LogisticRegression
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.familiarity import fit_familiarity
from pdr_filter.classifiers.model import ContextModel, Machine
from pdr_filter.classifiers.probability_calibration import fit_temperature, tempered
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.io.formats import read
from pdr_filter.io.recording import Recording
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.stage import CARRYING_EXPONENT, CARRYING_STAY_PROB, follow_mode
from pdr_filter.sensing.features import carrying, invariant
from pdr_filter.sensing.features.windows import N_MAGNITUDES, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate.people import EAR_PITCH_RAD, EAR_ROLL_RAD, MODES, simulated_person
from pdr_filter.training.contexts import (
    FEATURE_LIMIT,
    SCORED_DATASET,
    Fitted,
    LabelledWindows,
    Plan,
    Progress,
    TextArray,
    card_of,
    label_of,
    score,
)
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.contexts import CARRYING_MODES

SIMULATED, TURNED, WEAK = "simulated", "turned", "weak"
# Simulated people in each mode: as many as two cores make in a minute.
N_SIMULATED = 120

FEATURE_NAMES: tuple[str, ...] = (*invariant.NAMES, *carrying.NAMES)
# Of the force, without the timing of the vertical within a step, which is there to tell stairs: with it half of the
# swinging of oxford, left out, was missed, without it a seventh (calling of tyrex, left out, 12 % and 26 %).
_SHAKING_NAMES: tuple[str, ...] = tuple(n for n in invariant.WITHOUT_GYROSCOPE if not n.startswith("squared_vertical"))


@dataclass(frozen=True)
class CarryingPlan:
    """How one model is made: `plan`, and what else it is trained on."""

    plan: Plan
    has_gyroscope: bool  # without: the angular rate is taken away before anything else, attitude included
    source_weight: Mapping[str, float]  # of simulated, turned and weak windows; a data set has one


def fit_regression(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, tuple[str, ...]]:
    """Multinomial logistic regression and its classes.

    C is a seventh of what the contexts take: classes are known from few people, whose habits it must not learn.
    """
    fitted: Any = LogisticRegression(C=0.003, max_iter=300, tol=1e-3).fit(Z, y, sample_weight=weight)
    return SoftmaxRegression(fitted.coef_, fitted.intercept_), tuple(str(c) for c in fitted.classes_)


_USE = "Windows of a moving person. Of one who stands or sits it says nothing: a phone that lies still is not carried."
_LIMITS = (
    "Four modes: a bag is not among the data, its probability is zero, and a phone in a bag is taken for another mode, "
    "without being called unknown. "
    "Calling and swinging are known from one real person and simulation{more}."
)
PLANS: tuple[CarryingPlan, ...] = (
    CarryingPlan(
        Plan(
            "carrying",
            "carrying_mode",
            "invariant",
            carrying.NAMES,
            ("motionsense", "tyrex", "humolire", "ms_indoor"),
            fit_regression,
            "Logistic regression on attitude, force and turning of the phone; real recordings, recordings turned to "
            "the ear or made weaker, and simulated people.",
            _USE,
            _LIMITS.format(more=", calling also from other people's hands turned to the ear"),
            MODES,
        ),
        True,
        {SIMULATED: 0.3, TURNED: 0.33, WEAK: 2.0},
    ),
    CarryingPlan(
        Plan(
            "carrying_accelerometer",
            "carrying_mode",
            "invariant",
            (*_SHAKING_NAMES, *carrying.ATTITUDE),
            ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford"),
            fit_regression,
            "Logistic regression on what the accelerometer alone knows of force and attitude; real recordings, their "
            "angular rate left out, and simulated people.",
            _USE + " For phones without gyroscope; with one, `carrying` is better.",
            _LIMITS.format(more=", swinging from a second one"),
            MODES,
        ),
        False,
        {SIMULATED: 0.3},
    ),
)


def train_carrying(
    paths: Sequence[Path], out_dir: Path, progress: Progress | None = None, n_simulated: int = N_SIMULATED
) -> list[dict[str, Any]]:
    """Cards of the models of `PLANS`, which are written to `out_dir`.

    Parameters
    ----------
    paths : sequence of Path
        Recordings; those of other data sets than a plan's are not used.
    out_dir : Path
        Where `<name>.npz` and `<name>.json` go.
    progress : callable, optional
        Called with what is done and the fraction of the whole, 0 to 1.
    n_simulated : int
        Simulated people in each carrying mode.
    """
    cards: list[dict[str, Any]] = []
    for i, plan in enumerate(PLANS):

        def tell(what: str, fraction: float, start: float = i / len(PLANS)) -> None:
            if progress is not None:
                progress(what, start + fraction / len(PLANS))

        windows = carrying_windows(plan, paths, n_simulated, lambda what, done, tell=tell: tell(what, 0.7 * done))
        model = train_one(plan, windows, lambda what, done, tell=tell: tell(what, 0.7 + 0.3 * done))
        model.save(out_dir)
        cards.append(dict(model.card))
    return cards


def carrying_windows(
    plan: CarryingPlan, paths: Sequence[Path], n_simulated: int, progress: Progress | None = None
) -> LabelledWindows:
    """Windows of moving people with the features of the plan: real ones, those made of them, and simulated ones.

    `dataset` is the source: a data set, `simulated`, or `turned_` or `weak_` and the data set. `person` is whose motion
    it is.
    """
    jobs = [delayed(_recorded)(plan, path) for path in paths]
    jobs += [delayed(_simulated)(plan, mode, person) for person in range(n_simulated) for mode in MODES]
    parts: list[LabelledWindows] = []
    done: Any = Parallel(n_jobs=-1, return_as="generator")(jobs)
    for i, more in enumerate(done):
        parts += more
        if progress is not None:
            what = paths[i].stem if i < len(paths) else "simulated people"
            progress(f"{plan.plan.name}: features of {what}", (i + 1) / len(jobs))
    if not any(_is_real(part).any() for part in parts):
        raise ValueError(
            f"no windows for {plan.plan.name}: it needs recordings of {', '.join(plan.plan.datasets)} of people who "
            f"move, with the carrying modes {', '.join(MODES)} in their truth_labels.csv"
        )
    columns = [f.name for f in fields(LabelledWindows)]
    return LabelledWindows(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


def _is_real(windows: LabelledWindows) -> BoolArray:
    made = [np.char.startswith(windows.dataset, prefix) for prefix in (SIMULATED, f"{TURNED}_", f"{WEAK}_")]
    return ~np.any(made, axis=0)


@dataclass(frozen=True)
class RawSignals:
    """Features that are the samples of a window, `invariant.SIGNALS`, one row after the other."""

    name: str = "signals"
    names: tuple[str, ...] = invariant.SIGNALS

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Samples (W, 12 N) of the signals of windows (W, N_SIGNALS, N)."""
        return windows[:, N_MAGNITUDES:].reshape(len(windows), -1)


@dataclass(frozen=True, eq=False)
class _Signals:
    """Windows of one recording and one carrying mode, a moving person's."""

    samples: FloatArray  # (W, 12, N)
    context: TextArray  # (W,)
    mode: str
    has_gyroscope: BoolArray  # (W,)

    def part(self, use: BoolArray | slice) -> _Signals:
        """Some of the windows."""
        return _Signals(self.samples[use], self.context[use], self.mode, self.has_gyroscope[use])


def _signals(plan: CarryingPlan, recording: Recording) -> list[_Signals]:
    """What of a recording the plan is made of."""
    stage = FeatureWindows(features=RawSignals())
    recording = recording if plan.has_gyroscope else replace(recording, gyroscope=None)
    rows: dict[str, list[tuple[FloatArray, str, bool]]] = {}
    for window in feature_windows(stage, [merge_streams(recording)]):
        context, mode = label_of(recording, window.time_s - stage.window_s, window.time_s) or ("", "")
        usable = window.has_gyroscope or not plan.has_gyroscope
        if usable and context not in ("", "stationary") and mode in MODES:
            samples = window.features.reshape(len(invariant.SIGNALS), -1)
            rows.setdefault(mode, []).append((samples, context, window.has_gyroscope))
    result: list[_Signals] = []
    for mode, found in rows.items():
        samples, context, has_gyroscope = zip(*found, strict=True)
        result.append(_Signals(np.array(samples), np.array(context), mode, np.array(has_gyroscope)))
    return result


def _recorded(plan: CarryingPlan, path: Path) -> list[LabelledWindows]:
    """Windows of a real recording, and what is made of them."""
    recording = read(path)
    dataset = str(recording.meta.get("dataset", ""))
    if dataset not in plan.plan.datasets:
        return []
    person = f"{dataset}/{recording.subject.id}"
    result: list[LabelledWindows] = []
    for signals in _signals(plan, recording):
        result.append(_labelled(plan, signals, person, dataset, recording.name))
        rng = np.random.default_rng(crc32(recording.name.encode()))
        walking = signals.part(signals.context == "walking")
        if not len(walking.samples):
            continue
        if TURNED in plan.source_weight and signals.mode == "texting":
            result.append(_labelled(plan, _turned(walking, rng), person, f"{TURNED}_{dataset}", recording.name))
        # of the one data set with more than a few people: of fewer it would be more of the same
        if WEAK in plan.source_weight and signals.mode == "pocket" and dataset == SCORED_DATASET:
            result.append(_labelled(plan, _weak(walking, rng), person, f"{WEAK}_{dataset}", recording.name))
    return result


def _simulated(plan: CarryingPlan, mode: str, person: int) -> list[LabelledWindows]:
    """Windows of one simulated person."""
    recording = simulated_person(mode, person)
    return [
        _labelled(plan, signals, f"{SIMULATED}/{mode}{person}", SIMULATED, recording.name)
        for signals in _signals(plan, recording)
    ]


def features_of(samples: FloatArray, rate_hz: float = 100.0) -> FloatArray:
    """Features (W, F) of windows of `invariant.SIGNALS`, (W, 12, N), in the order of `FEATURE_NAMES`."""
    parts = [f(samples, rate_hz) for f in (invariant.invariant_features, carrying.carrying_features)]
    return np.concatenate(parts, axis=1)


def _labelled(plan: CarryingPlan, signals: _Signals, person: str, source: str, name: str) -> LabelledWindows:
    with threadpool_limits(1):
        features = features_of(signals.samples)
    n = len(features)
    return LabelledWindows(
        features=features[:, [FEATURE_NAMES.index(name) for name in plan.plan.feature_names]],
        context=signals.context,
        carrying_mode=np.full(n, signals.mode),
        person=np.full(n, person),
        dataset=np.full(n, source),
        recording=np.full(n, name),
        has_gyroscope=signals.has_gyroscope,
    )


# Rows of `invariant.SIGNALS`: what is in the world's frame, and the vectors in the sensor's.
_WORLD, _RATE, _UP, _FORCE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
# Grips that a recording is turned to, each with every second window: how many matters little, as the weight is shared.
_TURNS = 4


def _turned(signals: _Signals, rng: np.random.Generator) -> _Signals:
    """The phone of one recording turned from in front of the body to the ear: calling, with the same motion."""
    up = signals.samples[:, _UP].mean(axis=(0, 2))
    level = Rotation.align_vectors([0.0, 0.0, 1.0], up / np.sqrt(up @ up))[0]
    halves = [signals.part(slice(turn % 2, None, 2)) for turn in range(_TURNS)]
    parts = [replace(half, samples=half.samples.copy()) for half in halves]
    for part in parts:
        side = rng.choice([-1.0, 1.0])
        pitch_rad, roll_rad = rng.normal(EAR_PITCH_RAD, 0.2), -side * rng.normal(EAR_ROLL_RAD, 0.25)
        matrix = (Rotation.from_euler("ZXY", [0.0, pitch_rad, roll_rad]).inv() * level).as_matrix()
        for rows in (_RATE, _UP, _FORCE):
            part.samples[:, rows] = matrix @ part.samples[:, rows]
    samples, context, has_gyroscope = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("samples", "context", "has_gyroscope")
    )
    return _Signals(samples, context, "calling", has_gyroscope)


def _weak(signals: _Signals, rng: np.random.Generator) -> _Signals:
    """Every second window, its angles and rates scaled by 0.25 to 0.85, its accelerations by that to the power of 1.5.

    A slower pace scales accelerations more than angles: with the square of the frequency as well as with the angle.
    """
    signals = signals.part(slice(None, None, 2))
    samples = signals.samples.copy()
    factor = rng.uniform(0.25, 0.85, len(samples))[:, None, None]
    mean_up, mean_force = (samples[:, rows].mean(axis=2, keepdims=True) for rows in (_UP, _FORCE))
    samples[:, _WORLD] *= factor**1.5
    samples[:, _RATE] *= factor
    up = mean_up + (samples[:, _UP] - mean_up) * factor
    samples[:, _UP] = up / np.sqrt((up * up).sum(axis=1, keepdims=True))
    samples[:, _FORCE] = mean_force + (samples[:, _FORCE] - mean_force) * factor**1.5
    return replace(signals, samples=samples)


def balanced_weight(label: TextArray, source: TextArray, source_weight: Mapping[str, float]) -> FloatArray:
    """Weights (W,), mean one: every class the same sum, and inside a class every source its own, one if not given.

    `source_weight` is by the source's name up to the first underscore, or by the whole name.
    """
    weight = np.zeros(len(label))
    for name in np.unique(label):
        own = label == name
        for part in np.unique(source[own]):
            rows = own & (source == part)
            weight[rows] = source_weight.get(part, source_weight.get(part.split("_")[0], 1.0)) / rows.sum()
        weight[own] /= weight[own].sum()
    return weight / weight.mean()


def fit(plan: CarryingPlan, windows: LabelledWindows) -> Fitted:
    """A machine on features standardised with the windows' weights; its temperature is still one."""
    X, y = windows.features, windows.carrying_mode
    weight = balanced_weight(y, windows.dataset, plan.source_weight)
    mean = np.average(X, axis=0, weights=weight)
    std = np.sqrt(np.average((X - mean) ** 2, axis=0, weights=weight))
    scale = np.where(std > 1e-6, std, 1.0)
    machine, classes = plan.plan.machine_fit(np.clip((X - mean) / scale, -FEATURE_LIMIT, FEATURE_LIMIT), y, weight)
    return Fitted(machine, classes, CARRYING_MODES, mean, scale)


def train_one(plan: CarryingPlan, windows: LabelledWindows, progress: Progress) -> ContextModel:
    """The model of one plan, fitted on everybody, its card scored on people left out."""
    real = _taken(windows, _is_real(windows))
    prob, distance = leave_people_out(plan, windows, progress)
    label = np.array([CARRYING_MODES.index(mode) for mode in real.carrying_mode])
    even = _even_rows(real)
    temperature = fit_temperature(prob[even], label[even])
    prob = tempered(prob, temperature)

    with threadpool_limits(1):
        fitted = fit(plan, windows)
        limit = float(np.quantile(distance[even], 0.99))
        familiarity = fit_familiarity((windows.features - fitted.mean) / fitted.scale, limit)
    weight = balanced_weight(windows.carrying_mode, windows.dataset, plan.source_weight)
    prior = np.array([weight[windows.carrying_mode == mode].sum() for mode in CARRYING_MODES])
    progress(f"{plan.plan.name}: done", 1.0)
    return ContextModel(
        name=plan.plan.name,
        feature_names=plan.plan.feature_names,
        classes=fitted.classes,
        training_prior=prior / prior.sum(),
        feature_mean=fitted.mean,
        feature_scale=fitted.scale,
        machine=fitted.machine,
        card=_carrying_card(plan, windows, real, prob),
        head=plan.plan.head,
        temperature=temperature,
        feature_limit=FEATURE_LIMIT,
        familiarity=familiarity,
    )


def leave_people_out(plan: CarryingPlan, windows: LabelledWindows, progress: Progress) -> tuple[FloatArray, FloatArray]:
    """Probabilities (W, L) and distances (W,) of the real windows, by machines that do not know the person.

    The temperature is one.
    """
    real = _taken(windows, _is_real(windows))
    prob, distance = np.zeros((len(real.person), len(CARRYING_MODES))), np.zeros(len(real.person))
    people = np.unique(real.person)
    left_out: Any = Parallel(n_jobs=-1, return_as="generator")(
        delayed(_left_out)(plan, windows, person) for person in people
    )
    for i, (person, (of_prob, of_distance)) in enumerate(zip(people, left_out, strict=True)):
        prob[real.person == person], distance[real.person == person] = of_prob, of_distance
        progress(f"{plan.plan.name}: without {person}", (i + 1) / (len(people) + 1))
    return prob, distance


def _left_out(plan: CarryingPlan, windows: LabelledWindows, person: str) -> tuple[FloatArray, FloatArray]:
    """Probabilities and distances of one person's real windows; what was made of them is left out as well."""
    own = windows.person == person
    test, rest = windows.features[own & _is_real(windows)], _taken(windows, ~own)
    with threadpool_limits(1):
        fitted = fit(plan, rest)
        familiarity = fit_familiarity((rest.features - fitted.mean) / fitted.scale, 1.0)
        distance = np.array([familiarity.distance(z) for z in (test - fitted.mean) / fitted.scale])
        return fitted.prob(test), distance


def _taken(windows: LabelledWindows, use: BoolArray) -> LabelledWindows:
    return LabelledWindows(*(getattr(windows, f.name)[use] for f in fields(LabelledWindows)))


def _even_rows(windows: LabelledWindows, at_most: int = 300) -> BoolArray:
    """Rows that hold about as many windows of every data set and carrying mode, (W,)."""
    use = np.zeros(len(windows.dataset), dtype=bool)
    for dataset in np.unique(windows.dataset):
        for mode in MODES:
            rows = np.flatnonzero((windows.dataset == dataset) & (windows.carrying_mode == mode))
            use[rows[np.linspace(0, len(rows) - 1, min(at_most, len(rows))).astype(int)]] = True
    return use


def _carrying_card(
    plan: CarryingPlan, windows: LabelledWindows, real: LabelledWindows, prob: FloatArray
) -> dict[str, Any]:
    """The card of all models, and which windows were made."""
    scores = {dataset: site_scores(real, prob, real.dataset == dataset) for dataset in np.unique(real.dataset)}
    people = scores.pop(SCORED_DATASET, {})
    made = windows.dataset[~_is_real(windows)]
    return {
        **card_of(plan.plan, real.carrying_mode, real.person, people, {str(k): v for k, v in scores.items()}),
        "made_windows": {str(source): int((made == source).sum()) for source in np.unique(made)},
        "source_weight": dict(plan.source_weight),
        "scored": "People and sites that the scored machine has not seen, nor anything made of them. One number, the "
        "temperature, is fitted on the same people left out. Other simulated people, drawn the same way, move the "
        "recalls of calling, swinging and pocket on tyrex by up to 6 points: they are one or two recordings each.",
    }


def site_scores(windows: LabelledWindows, prob: FloatArray, use: BoolArray) -> dict[str, Any]:
    """Scores of some windows: `train.score`, the number of windows of each mode, and the recall of the worst person.

    "followed" are the probabilities after each window, as `ContextModels` follows the mode through a recording.
    """
    truth, person = windows.carrying_mode[use], windows.person[use]
    right = np.array(CARRYING_MODES)[prob[use].argmax(axis=1)] == truth
    followed = score(truth, _followed(windows.recording[use], prob[use]), CARRYING_MODES)
    return {
        **score(truth, prob[use], CARRYING_MODES),
        "followed_recall": followed["recall"],
        "followed_log_loss": followed["log_loss"],
        "n": {mode: int((truth == mode).sum()) for mode in MODES if (truth == mode).any()},
        "worst_person_accuracy": round(float(min(right[person == p].mean() for p in np.unique(person))), 4),
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
