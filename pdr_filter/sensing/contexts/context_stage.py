"""Feature windows in, context and carrying-mode probabilities out: which model classifies what, and what is unknown."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from pdr_filter.classifiers.context_model import Assessment, ContextModel
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.irregular_motion import GATE, GATE_ACCELEROMETER, irregular_prob
from pdr_filter.sensing.features.barometer import Climb, climb_log_evidence
from pdr_filter.sensing.features.feature_windows import FeatureWindow
from pdr_filter.sensing.features.sliding_windows import SlidingWindows, W, X
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    DEFAULT_CONTEXTS,
    Context,
    ContextSet,
    FloatArray,
    IntArray,
    check_numbers,
    frozen,
    read_only,
    replace_unchecked,
)
from pdr_filter.values.mixtures import reweighted

# Half a minute to a minute between changes of the carrying mode, at a window a second.
CARRYING_STAY_PROB = 0.98
# Hop over window: overlapping windows repeat the same second of data.
CARRYING_EXPONENT = 0.5
# Where the phone is in all recordings of stairs that the models learn from.
_POCKET = CARRYING_MODES.index("pocket")
_EVEN = read_only(np.full(len(CARRYING_MODES), 1 / len(CARRYING_MODES)))


@dataclass(frozen=True, eq=False)
class WindowContext:
    """The classifiers' result for a window: for the samples from `start_s` to `time_s`."""

    time_s: float  # end of the window
    prob: FloatArray  # (C,) of the contexts of the stage; the unknown share of it is the classifier's prior
    training_prior: FloatArray  # (C,) of the classifier that gave them
    carrying_prob: FloatArray = field(default_factory=lambda: _EVEN)  # (5,) after this window
    unknown_share: float = 0.0  # how unlike the training windows it is, 0 to 1
    stairs_unknown_share: float = 0.0  # how unlike stairs in training window and place are, 0 to 1
    irregular_prob: float = 0.0  # that its motion moves nobody
    model: str = ""  # name of the context model
    climb_rate_mps: float = np.nan  # from the barometer, up positive; NaN without
    has_gyroscope: bool = True  # that angular rate was measured all through the window
    start_s: float = np.nan  # of the first sample that it describes
    hop_s: float = 1.0  # its end less that of the window before, where none is missing

    @property
    def new_since_s(self) -> float:
        """Where its samples begin that no window before has."""
        return self.time_s - self.hop_s


class ContextStage(Protocol):
    """A causal stage that finds, window by window, what the person does and where the phone is.

    Samples are numbered from 0 in each segment (between gaps). The result does not depend on how the samples were cut
    into blocks.
    """

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the contexts, C, in the order of the probabilities."""
        ...

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks."""
        ...

    @property
    def hop_s(self) -> float:
        """Longest time from one window end to the next."""
        ...

    def init(self) -> Any:
        """State before the first sample."""
        ...

    def after_gap(self, state: Any) -> Any:
        """State at the start of a new segment: what lasts over a time without samples, and nothing else."""
        ...

    def update(
        self, state: Any, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[Any, list[tuple[int, WindowContext]]]:
        """New state and the windows that became known, each with the number of its last sample."""
        ...


M = TypeVar("M")  # what lasts from window to window


@dataclass(frozen=True, eq=False)
class WindowStageState(Generic[W, M]):
    """Samples of open windows, and what lasts from window to window."""

    windows: W
    memory: M


@dataclass(frozen=True, eq=False)
class WindowStage(ABC, Generic[W, X, M]):
    """A context stage that judges windows one after the other."""

    windows: SlidingWindows[W, X]

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the contexts, those of the default."""
        return CONTEXTS

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks."""
        return self.windows.rate_hz

    @property
    def hop_s(self) -> float:
        """Time from one window end to the next."""
        return self.windows.hop_s

    @abstractmethod
    def first_memory(self) -> M:
        """What lasts from window to window, before the first."""

    @abstractmethod
    def assess(self, memory: M, window: X) -> tuple[M, WindowContext]:
        """New memory, and the result for a window."""

    def assess_all(self, memory: M, windows: Sequence[X]) -> tuple[M, list[WindowContext]]:
        """New memory, and the results for windows that became known together."""
        contexts: list[WindowContext] = []
        for window in windows:
            memory, context = self.assess(memory, window)
            contexts.append(context)
        return memory, contexts

    def memory_after_gap(self, memory: M) -> M:
        """What lasts over a time without samples: nothing."""
        return self.first_memory()

    def init(self) -> WindowStageState[W, M]:
        """State before the first sample."""
        return WindowStageState(self.windows.init(), self.first_memory())

    def after_gap(self, state: WindowStageState[W, M]) -> WindowStageState[W, M]:
        """State at the start of a new segment."""
        return WindowStageState(self.windows.after_gap(state.windows), self.memory_after_gap(state.memory))

    def update(
        self, state: WindowStageState[W, M], block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[WindowStageState[W, M], list[tuple[int, WindowContext]]]:
        """New state and the windows that became known, each with the number of its last sample."""
        windows, found = self.windows.update(state.windows, block, attitude)
        if not found:
            return WindowStageState(windows, state.memory), []
        memory, contexts = self.assess_all(state.memory, [window for _, window in found])
        return WindowStageState(windows, memory), [
            (last, replace_unchecked(context, start_s=window.start_s, hop_s=self.windows.hop_s))
            for (last, window), context in zip(found, contexts, strict=True)
        ]


def known_context(
    time_s: float, context: Mapping[str, float], carrying_mode: Mapping[str, float], contexts: Sequence[str], name: str
) -> WindowContext:
    """The result of a rule: probabilities by name, those not named zero.

    `contexts` are all those that the rule distinguishes, alike before it has seen anything. Where the carrying mode
    is unknown (an empty mapping) all modes are alike.
    """
    prob = np.array([context.get(c, 0.0) for c in CONTEXTS])
    carrying = np.array([carrying_mode.get(c, 0.0) for c in CARRYING_MODES]) if carrying_mode else _EVEN
    prior = np.array([float(c in contexts) for c in CONTEXTS])
    return WindowContext(time_s, read_only(prob), read_only(prior / prior.sum()), read_only(carrying), model=name)


@dataclass(frozen=True, eq=False)
class ContextModels:
    """The models of a filter: which ones classify a window depends on the sensors that it has.

    Stairs are known from trouser pockets. As far as a phone seems to be elsewhere, what a model that guards them
    (`ContextModel.stairs`) says of stairs is not known, however like the windows are: a barometer decides, if there is
    one.

    Context probabilities are of each window alone. A carrying mode lasts, and a phone that nobody moves shows nothing
    of it, so its probabilities are those of all windows so far: a forward filter over the modes that the model knows,
    in which a window counts by how much of it is motion. Without a model of it all modes stay equally probable.
    """

    with_gyroscope: ContextModel
    without_gyroscope: ContextModel | None  # with the same contexts; None: such windows are unknown
    carrying_with_gyroscope: ContextModel | None = None
    carrying_without_gyroscope: ContextModel | None = None
    carrying_stay_prob: float = CARRYING_STAY_PROB  # that the mode is the same a window later
    carrying_exponent: float = CARRYING_EXPONENT  # of a window's evidence

    def __post_init__(self) -> None:
        check_numbers(self, zero=("carrying_exponent",))
        carrying = self.carrying_with_gyroscope, self.carrying_without_gyroscope
        heads = [(self.with_gyroscope, "context"), (self.without_gyroscope, "context")]
        for model, head in [*heads, *((model, "carrying_mode") for model in carrying)]:
            if model is not None and model.head != head:
                raise ValueError(f"model {model.name!r} classifies the {model.head}, not the {head}; give another one")
        if self.without_gyroscope is not None and self.with_gyroscope.labels != self.without_gyroscope.labels:
            raise ValueError(
                f"models of windows with and without gyroscope must have the same contexts, got "
                f"{self.with_gyroscope.labels} and {self.without_gyroscope.labels}"
            )

    @property
    def models(self) -> tuple[ContextModel, ...]:
        """All models that there are."""
        optional = self.without_gyroscope, self.carrying_with_gyroscope, self.carrying_without_gyroscope
        return (self.with_gyroscope, *(model for model in optional if model is not None))

    def init(self) -> FloatArray:
        """Carrying-mode probabilities (5,) before the first window: all modes that are known, alike."""
        model = self.carrying_with_gyroscope or self.carrying_without_gyroscope
        known = np.ones(len(CARRYING_MODES)) if model is None else (model.training_prior > 0).astype(float)
        return read_only(known / known.sum())

    def update(
        self, carrying_prob: FloatArray, window: FeatureWindow, contexts: ContextSet = DEFAULT_CONTEXTS
    ) -> tuple[FloatArray, WindowContext]:
        """New carrying-mode probabilities (5,), and the result for the window."""
        carrying_prob, (context,) = self.step_all(carrying_prob, [window], contexts)
        return carrying_prob, context

    def step_all(
        self, carrying_prob: FloatArray, windows: Sequence[FeatureWindow], contexts: ContextSet = DEFAULT_CONTEXTS
    ) -> tuple[FloatArray, list[WindowContext]]:
        """The same for windows that follow each other, with the same bits: models look at all of them at once."""
        of_contexts = _assessed(self.with_gyroscope, self.without_gyroscope, windows)
        of_carrying = _assessed(self.carrying_with_gyroscope, self.carrying_without_gyroscope, windows)
        irregular = _irregular(windows)
        results: list[WindowContext] = []
        for i, window in enumerate(windows):
            found = of_contexts.get(i), of_carrying.get(i), irregular[i]
            carrying_prob, context = self._judged(carrying_prob, window, *found, contexts.standing)
            results.append(context)
        return carrying_prob, results

    def _judged(
        self,
        carrying_prob: FloatArray,
        window: FeatureWindow,
        of_context: Assessment | None,
        of_carrying: Assessment | None,
        irregular: float,
        standing: IntArray,
    ) -> tuple[FloatArray, WindowContext]:
        """New carrying-mode probabilities (5,), and the result for a window of which this is known."""
        model = (
            self.with_gyroscope if window.has_gyroscope or self.without_gyroscope is None else self.without_gyroscope
        )
        prob, unknown, unlike_stairs = of_context or Assessment(model.training_prior, 1.0, 1.0)
        prob = (1 - unknown) * prob + unknown * model.training_prior
        moving = 1.0 - float(sum(prob[standing].tolist()))
        carrying_prob = self._follow(carrying_prob, window, of_carrying, moving)
        if model.stairs is not None and self.carrying_with_gyroscope is not None:
            unlike_stairs = 1.0 - (1.0 - unlike_stairs) * float(carrying_prob[_POCKET])
        return carrying_prob, WindowContext(
            window.time_s,
            prob,
            model.training_prior,
            carrying_prob,
            unknown,
            unlike_stairs,
            irregular,
            model.name,
            has_gyroscope=window.has_gyroscope,
        )

    def _follow(
        self, carrying_prob: FloatArray, window: FeatureWindow, found: Assessment | None, moving: float
    ) -> FloatArray:
        """Carrying-mode probabilities after one window more; a window counts by how much of it is known motion."""
        model = self.carrying_with_gyroscope if window.has_gyroscope else self.carrying_without_gyroscope
        if model is None or found is None:
            return carrying_prob
        prob, unknown, _ = found
        exponent = self.carrying_exponent * moving * (1 - unknown)
        return follow_mode(carrying_prob, prob, model.training_prior, self.carrying_stay_prob, exponent)


def follow_mode(
    before: FloatArray, window_prob: FloatArray, prior: FloatArray, stay_prob: float, exponent: float
) -> FloatArray:
    """p_k ~ (sum_j p_j t_jk) (w_k / prior_k)^exponent, (D,), over the modes that the classifier knows (prior > 0).

    t has `stay_prob` on its diagonal and shares the rest alike.
    """
    of_mode = list(zip(before.tolist(), window_prob.tolist(), prior.tolist(), strict=True))
    leave = (1 - stay_prob) / max(sum(r > 0 for _, _, r in of_mode) - 1, 1)
    # so few numbers are quicker in plain ones
    after = [
        (p * (stay_prob - leave) + leave) * (max(w, 1e-9) / r) ** exponent if r > 0 else 0.0 for p, w, r in of_mode
    ]
    total = sum(after)
    return frozen(np.array([p / total for p in after]))


def with_climbs(
    windows: Sequence[WindowContext], climbs: Sequence[Climb | None], contexts: ContextSet = DEFAULT_CONTEXTS
) -> list[WindowContext]:
    """The windows with the climb rates of a barometer, where there are some, as evidence for stairs.

    Motion and pressure are independent, so that their likelihoods multiply. Windows of the barometer overlap: the most
    that one can say is bounded, and draughts, which last for seconds, are in its standard deviation.
    """
    both = [(window, climb) for window, climb in zip(windows, climbs, strict=True) if climb is not None]
    if not both:
        return list(windows)
    rates_mps, std_mps = np.array([(climb.climb_rate_mps, climb.std_mps) for _, climb in both]).T
    told = np.array([to_be_told_apart(window.prob, window.stairs_unknown_share, contexts) for window, _ in both])
    prob = iter(reweighted(told, climb_log_evidence(rates_mps, std_mps, contexts)))
    return [
        window if climb is None else replace_unchecked(window, prob=next(prob), climb_rate_mps=climb.climb_rate_mps)
        for window, climb in zip(windows, climbs, strict=True)
    ]


# Step frequency in Hz of people in each context, mean and standard deviation between and within them: medians of people
# of motionsense, difronzo, humolire, ms_indoor and ubicomp13, a fifth wider. Somebody who stands makes no steps.
_WALKING_HZ, _RUNNING_HZ, _UP_HZ, _DOWN_HZ, _TURNED_HZ = (1.85, 0.25), (2.75, 0.25), (1.8, 0.3), (2.0, 0.35), (1.6, 0.5)
# How often steps are found twice or missed, and what they may show then.
_CADENCE_OUTLIER_SHARE, _CADENCE_RANGE_HZ = 0.1, 4.5


def _cadence_hz(context: Context) -> tuple[float, float]:
    """Mean and standard deviation of the step frequency in a context; the mean is NaN without steps."""
    if context.stands:
        return np.nan, 1.0
    if context.runs:
        return _RUNNING_HZ
    if context.climbs:
        return _UP_HZ if context.climbs > 0 else _DOWN_HZ
    return _TURNED_HZ if context.is_turned else _WALKING_HZ


@lru_cache
def _cadences_hz(contexts: ContextSet) -> tuple[FloatArray, FloatArray]:
    """Mean (C,) and standard deviation (C,) of the step frequency in each context."""
    mean_hz, std_hz = np.array([_cadence_hz(c) for c in contexts.contexts]).T
    return mean_hz, std_hz


def cadence_log_evidence(frequency_hz: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> FloatArray:
    """Log likelihood of a step frequency in each context, (C,): log((1 - e) N(f; m_c, s_c^2) + e / range)."""
    mean_hz, std_hz = _cadences_hz(contexts)
    away = (frequency_hz - mean_hz) / std_hz
    density = np.exp(-0.5 * away * away) / (math.sqrt(2 * math.pi) * std_hz)
    right = (1.0 - _CADENCE_OUTLIER_SHARE) * np.nan_to_num(density, nan=0.0)
    return np.log(right + _CADENCE_OUTLIER_SHARE / _CADENCE_RANGE_HZ)


def with_cadence(window: WindowContext, frequency_hz: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> WindowContext:
    """The window in which, as far as it is unlike all training data, the step frequency decides.

    Its unknown share has the classifier's prior. People run with more steps a second than they walk, wherever the phone
    is: at the belt half of all running was taken for walking. Where windows are familiar the classifier has the
    frequency among its features already.
    """
    if window.unknown_share == 0.0:
        return window
    guess = reweighted(window.training_prior, cadence_log_evidence(frequency_hz, contexts))
    return replace_unchecked(window, prob=window.prob + window.unknown_share * (guess - window.training_prior))


def to_be_told_apart(prob: FloatArray, share: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> FloatArray:
    """Probabilities (C,) where another sensor decides what motion does not tell: that share divided into thirds.

    A day's division (`classifiers.context_model.blend_stairs_with_prior`) is a prior. As evidence, window
    after window, it would outvote what the other sensor measures.
    """
    in_thirds = contexts.in_thirds
    return (1.0 - share) * prob + share * (prob @ in_thirds) if share and in_thirds is not None else prob


@lru_cache
def _gated(names: tuple[str, ...]) -> bool:
    """Whether a feature set has what the gate for irregular motion needs."""
    return {*GATE.names, *GATE_ACCELEROMETER.names} <= set(names)


def _irregular(windows: Sequence[FeatureWindow]) -> list[float]:
    """Probability of irregular motion in each window; zero where the gate has not what it needs."""
    prob = np.zeros(len(windows))
    for has_gyroscope in (True, False):
        mine = [i for i, w in enumerate(windows) if w.has_gyroscope == has_gyroscope and _gated(w.names)]
        if mine:
            features = np.stack([windows[i].features for i in mine])
            prob[mine] = irregular_prob(windows[mine[0]].names, features, has_gyroscope)
    return prob.tolist()


def _assessed(
    with_gyroscope: ContextModel | None, without_gyroscope: ContextModel | None, windows: Sequence[FeatureWindow]
) -> dict[int, Assessment]:
    """What the model for its sensors says of each window, by number; nothing where there is none."""
    found: dict[int, Assessment] = {}
    for model, has_gyroscope in ((with_gyroscope, True), (without_gyroscope, False)):
        mine = [i for i, window in enumerate(windows) if window.has_gyroscope == has_gyroscope]
        if model is not None and mine:
            columns = _columns(model.feature_names, windows[0].names)
            assessed = model.assess_all(np.stack([windows[i].features[columns] for i in mine]))
            found |= zip(mine, assessed, strict=True)
    return found


@lru_cache
def _columns(wanted: tuple[str, ...], names: tuple[str, ...]) -> IntArray:
    return np.array([names.index(name) for name in wanted])
