"""Context and carrying-mode probabilities of windows: the interface, the choice of models, and unknown windows."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from pdr_filter.classifiers.context_model import Assessment, ContextModel
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.irregular_motion import GATE, GATE_ACCELEROMETER, irregular_prob
from pdr_filter.sensing.features.barometer import climb_log_evidence
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
    WindowContext,
    check_numbers,
    make_read_only,
    read_only,
    replace_unchecked,
)
from pdr_filter.values.events import Climb
from pdr_filter.values.mixtures import reweighted_prob

# Probability that the carrying mode does not change from one window to the next: 30 to 60 s between changes, at one
# window a second.
CARRYING_STAY_PROB = 0.98
# Exponent of the evidence of a window: hop over window length, because overlapping windows repeat the same data.
CARRYING_EXPONENT = 0.5
# Place of the phone in all training recordings of stairs.
_POCKET = CARRYING_MODES.index("pocket")


class ContextStage(Protocol):
    """Interface of a causal stage that classifies the context and the carrying mode, window by window.

    `config.with_contexts` uses such a stage, and `pdr_filter.testing.verify_stage` tests it. Samples are numbered from
    0 in each segment between gaps. The result must not depend on how samples are cut into blocks.

    Examples
    --------
    A stage that reports walking once a second:

    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from pdr_filter.values import WindowContext
    >>> @dataclass(frozen=True)
    ... class AlwaysWalking:
    ...     contexts: tuple[str, ...] = ("stationary", "walking")
    ...     rate_hz: float = 100.0
    ...     hop_s: float = 1.0
    ...     def init(self):
    ...         return 0
    ...     def after_gap(self, state):
    ...         return 0
    ...     def update(self, state, block, attitude):
    ...         end = state + len(block.time_s)
    ...         lasts = range(state + 99 - state % 100, end, 100)
    ...         prob, prior = np.array([0.1, 0.9]), np.array([0.5, 0.5])
    ...         return end, [(last, WindowContext(float(block.time_s[last - state]), prob, prior)) for last in lasts]
    >>> import pdr_filter as pdr
    >>> modes = [pdr.Mode("stationary", moves=False), pdr.Mode("walking")]
    >>> config = pdr.recipes.default().with_contexts(AlwaysWalking(), modes)
    """

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the C contexts in the order of the probabilities."""
        ...

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks, Hz."""
        ...

    @property
    def hop_s(self) -> float:
        """Longest time between the ends of consecutive windows, s."""
        ...

    def init(self) -> Any:
        """Return the state before the first sample.

        Returns
        -------
        object
            Initial state.
        """
        ...

    def after_gap(self, state: Any) -> Any:
        """Return the state at the start of a segment after a gap.

        Parameters
        ----------
        state : object
            State before the gap.

        Returns
        -------
        object
            State that keeps only the information that remains valid after a time without samples.
        """
        ...

    def update(
        self, state: Any, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[Any, list[tuple[int, WindowContext]]]:
        """Return the new state and the windows that a block completes.

        Parameters
        ----------
        state : object
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow.
        attitude : AttitudeBlock
            Attitude at these samples.

        Returns
        -------
        state : object
            New state.
        windows : list of (int, WindowContext)
            Classified windows, each with the number of its last sample.
        """
        ...


M = TypeVar("M")  # memory of a stage: its state between windows, apart from the samples


@dataclass(frozen=True, eq=False)
class WindowStageState(Generic[W, M]):
    """State of a stage that classifies windows."""

    windows: W  # state of the sliding windows
    memory: M  # state of the classification, which is updated by each window


@dataclass(frozen=True, eq=False)
class WindowStage(ContextStage, ABC, Generic[W, X, M]):
    """Base class of context stages that classify sliding windows one after the other.

    Parameters
    ----------
    windows : SlidingWindows
        Stage that cuts windows and describes them.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.contexts.context_stage import WindowStage
    >>> isinstance(pdr.recipes.default().sensing.contexts, WindowStage)
    True
    """

    windows: SlidingWindows[W, X]

    @property
    def contexts(self) -> tuple[str, ...]:
        return CONTEXTS

    @property
    def rate_hz(self) -> float:
        return self.windows.rate_hz

    @property
    def hop_s(self) -> float:
        return self.windows.hop_s

    @abstractmethod
    def first_memory(self) -> M:
        """Return the memory before the first window.

        Returns
        -------
        M
            Initial memory.
        """

    @abstractmethod
    def assess(self, memory: M, window: X) -> tuple[M, WindowContext]:
        """Return the new memory and the classification of a window.

        Parameters
        ----------
        memory : M
            Memory after the previous window.
        window : X
            Description of the window.

        Returns
        -------
        memory : M
            New memory.
        context : WindowContext
            Classification.
        """

    def assess_all(self, memory: M, windows: Sequence[X]) -> tuple[M, list[WindowContext]]:
        """Return the new memory and the classifications of windows that became complete together.

        Parameters
        ----------
        memory : M
            Memory after the previous window.
        windows : sequence of X
            Descriptions of consecutive windows.

        Returns
        -------
        memory : M
            New memory.
        contexts : list of WindowContext
            Classifications in the same order.
        """
        contexts: list[WindowContext] = []
        for window in windows:
            memory, context = self.assess(memory, window)
            contexts.append(context)
        return memory, contexts

    def memory_after_gap(self, memory: M) -> M:
        """Return the memory after a gap, which is the initial one unless a subclass keeps something.

        Parameters
        ----------
        memory : M
            Memory before the gap.

        Returns
        -------
        M
            Memory after the gap.
        """
        return self.first_memory()

    def init(self) -> WindowStageState[W, M]:
        return WindowStageState(self.windows.init(), self.first_memory())

    def after_gap(self, state: WindowStageState[W, M]) -> WindowStageState[W, M]:
        """Return the state at the start of a segment after a gap.

        Parameters
        ----------
        state : WindowStageState
            State before the gap.

        Returns
        -------
        WindowStageState
            State with empty windows and the memory that remains valid.
        """
        return WindowStageState(self.windows.after_gap(state.windows), self.memory_after_gap(state.memory))

    def update(
        self, state: WindowStageState[W, M], block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[WindowStageState[W, M], list[tuple[int, WindowContext]]]:
        windows, found = self.windows.update(state.windows, block, attitude)
        if not found:
            return WindowStageState(windows, state.memory), []
        memory, contexts = self.assess_all(state.memory, [window for _, window in found])
        return WindowStageState(windows, memory), [
            (last, replace_unchecked(context, start_s=window.start_s, hop_s=self.windows.hop_s))
            for (last, window), context in zip(found, contexts, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class ContextModels:
    """Trained models of a filter, which choose the model of each window by the available sensors.

    Stairs are learned from trouser pockets only. If the phone is probably elsewhere and the model guards its stairs
    (`ContextModel.stairs`), its decision between stairs and walking counts as unknown, however familiar the windows
    look. A barometer decides instead, if there is one.

    Context probabilities depend on each window alone. A carrying mode persists, and a phone at rest gives no evidence
    of it. The carrying-mode probabilities therefore come from all windows so far: a forward filter over the modes that
    the model knows, in which a window is weighted by its probability of motion. Without a carrying model all modes stay
    equally probable.

    All still windows have the same features (`FeatureWindows`), so each model assesses them once. They give no evidence
    of the carrying mode.

    Parameters
    ----------
    with_gyroscope : ContextModel
        Context model for windows with angular rate.
    without_gyroscope : ContextModel or None
        Context model for windows without angular rate, with the same contexts. None means that such windows are
        unknown.
    carrying_with_gyroscope, carrying_without_gyroscope : ContextModel or None
        Carrying-mode models for windows with and without angular rate.
    carrying_stay_prob : float
        Probability that the carrying mode does not change from one window to the next.
    carrying_exponent : float
        Exponent of the carrying-mode evidence of a window.

    Raises
    ------
    ValueError
        If a model classifies something else, or if the two context models have different contexts.

    Examples
    --------
    >>> from pdr_filter.sensing.contexts.context_stage import ContextModels
    >>> from pdr_filter.classifiers.context_model import load_model
    >>> ContextModels(load_model("context"), None).init()
    array([0.2, 0.2, 0.2, 0.2, 0.2])
    """

    with_gyroscope: ContextModel
    without_gyroscope: ContextModel | None
    carrying_with_gyroscope: ContextModel | None = None
    carrying_without_gyroscope: ContextModel | None = None
    carrying_stay_prob: float = CARRYING_STAY_PROB
    carrying_exponent: float = CARRYING_EXPONENT

    def __post_init__(self) -> None:
        check_numbers(self, zero=("carrying_exponent",))
        carrying = self.carrying_with_gyroscope, self.carrying_without_gyroscope
        heads = [(self.with_gyroscope, "context"), (self.without_gyroscope, "context")]
        for model, head in [*heads, *((model, "carrying_mode") for model in carrying)]:
            if model is not None and model.head != head:
                raise ValueError(
                    f"model {model.name!r} classifies the {model.head}, not the {head}: pass a model of the {head}"
                )
        if self.without_gyroscope is not None and self.with_gyroscope.labels != self.without_gyroscope.labels:
            raise ValueError(
                f"models of windows with and without gyroscope must have the same contexts, got "
                f"{self.with_gyroscope.labels} and {self.without_gyroscope.labels}: train both with the same labels"
            )

    @property
    def models(self) -> tuple[ContextModel, ...]:
        """Context and carrying-mode models of this stage, without the ones that are None."""
        optional = self.without_gyroscope, self.carrying_with_gyroscope, self.carrying_without_gyroscope
        return (self.with_gyroscope, *(model for model in optional if model is not None))

    def init(self) -> FloatArray:
        """Return the carrying-mode probabilities before the first window.

        Returns
        -------
        (5,) array
            Equal probabilities of all modes that the model knows.
        """
        model = self.carrying_with_gyroscope or self.carrying_without_gyroscope
        known = np.ones(len(CARRYING_MODES)) if model is None else (model.training_prior > 0).astype(float)
        return read_only(known / known.sum())

    def update(
        self, carrying_prob: FloatArray, window: FeatureWindow, contexts: ContextSet = DEFAULT_CONTEXTS
    ) -> tuple[FloatArray, WindowContext]:
        """Return the new carrying-mode probabilities and the classification of a window.

        Parameters
        ----------
        carrying_prob : (5,) array
            Carrying-mode probabilities after the previous window.
        window : FeatureWindow
            Features of the window.
        contexts : ContextSet, optional
            Meanings of the contexts. The default is the six contexts of `pdr_filter.CONTEXTS`.

        Returns
        -------
        carrying_prob : (5,) array
            New carrying-mode probabilities.
        context : WindowContext
            Classification of the window.
        """
        carrying_prob, (context,) = self.update_all(carrying_prob, [window], contexts)
        return carrying_prob, context

    def update_all(
        self, carrying_prob: FloatArray, windows: Sequence[FeatureWindow], contexts: ContextSet = DEFAULT_CONTEXTS
    ) -> tuple[FloatArray, list[WindowContext]]:
        """Return the new carrying-mode probabilities and the classifications of consecutive windows.

        The models process all windows together. The results have the same bits as with `update` for each window.

        Parameters
        ----------
        carrying_prob : (5,) array
            Carrying-mode probabilities after the previous window.
        windows : sequence of FeatureWindow
            Features of the windows.
        contexts : ContextSet, optional
            Meanings of the contexts. The default is the six contexts of `pdr_filter.CONTEXTS`.

        Returns
        -------
        carrying_prob : (5,) array
            New carrying-mode probabilities.
        contexts : list of WindowContext
            Classifications in the same order.
        """
        context_assessments = _assessments(self.with_gyroscope, self.without_gyroscope, windows)
        carrying_assessments = _assessments(self.carrying_with_gyroscope, self.carrying_without_gyroscope, windows)
        irregular = _irregular_probs(windows)
        results: list[WindowContext] = []
        for i, window in enumerate(windows):
            assessments = context_assessments.get(i), carrying_assessments.get(i), irregular[i]
            carrying_prob, context = self._classification(carrying_prob, window, *assessments, contexts.standing)
            results.append(context)
        return carrying_prob, results

    def _classification(
        self,
        carrying_prob: FloatArray,
        window: FeatureWindow,
        context_assessment: Assessment | None,
        carrying_assessment: Assessment | None,
        irregular: float,
        standing: IntArray,
    ) -> tuple[FloatArray, WindowContext]:
        """Return the new carrying-mode probabilities (5,) and the classification of a window from its assessments.

        An assessment is None if there is no model for the sensors of the window. The context probabilities are then the
        training prior, with the unknown share 1. `standing` are the indices of the contexts without steps.
        """
        model = self.with_gyroscope if window.has_gyroscope else self.without_gyroscope or self.with_gyroscope
        assessment = context_assessment or Assessment(model.training_prior, 1.0, 1.0, True)
        prob, unknown, unlike_stairs, is_unlike = assessment
        prob = (1 - unknown) * prob + unknown * model.training_prior
        moving = 0.0 if window.is_still else 1.0 - float(sum(prob[standing].tolist()))
        carrying_prob = self._update_carrying(carrying_prob, window, carrying_assessment, moving)
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
            is_unlike=is_unlike,
        )

    def _update_carrying(
        self, carrying_prob: FloatArray, window: FeatureWindow, assessment: Assessment | None, moving: float
    ) -> FloatArray:
        """Return the carrying-mode probabilities after a window.

        The evidence of the window is weighted by its probability of motion `moving` and by its familiar share. Without
        a carrying-mode model for the window the probabilities are unchanged.
        """
        model = self.carrying_with_gyroscope if window.has_gyroscope else self.carrying_without_gyroscope
        if model is None or assessment is None:
            return carrying_prob
        prob, unknown, *_ = assessment
        exponent = self.carrying_exponent * moving * (1 - unknown)
        return follow_mode(carrying_prob, prob, model.training_prior, self.carrying_stay_prob, exponent)


def follow_mode(
    before: FloatArray, window_prob: FloatArray, prior: FloatArray, stay_prob: float, exponent: float
) -> FloatArray:
    """Return the posterior (D,) of the modes with a prior above zero.

    The value of mode k is proportional to (sum_j p_j t_jk) (w_k / prior_k)^exponent. Here p is `before`, and w is
    `window_prob`. The transition matrix t has `stay_prob` on its diagonal and equal values elsewhere.
    """
    modes = list(zip(before.tolist(), window_prob.tolist(), prior.tolist(), strict=True))
    leave = (1 - stay_prob) / max(sum(r > 0 for _, _, r in modes) - 1, 1)
    # Plain floats, because NumPy is slower for so few numbers.
    after = [(p * (stay_prob - leave) + leave) * (max(w, 1e-9) / r) ** exponent if r > 0 else 0.0 for p, w, r in modes]
    total = sum(after)
    return make_read_only(np.array([p / total for p in after]))


def with_climbs(
    windows: Sequence[WindowContext], climbs: Sequence[Climb | None], contexts: ContextSet = DEFAULT_CONTEXTS
) -> list[WindowContext]:
    """Return the windows with the evidence of climb rates added to their context probabilities.

    `climbs` holds the climb of the barometer for each window, or None. Motion and pressure are independent, so their
    likelihoods multiply. Windows of the barometer overlap, so the evidence of each is bounded. The standard deviation
    of the climb rate includes draughts, which last for seconds.
    """
    both = [(window, climb) for window, climb in zip(windows, climbs, strict=True) if climb is not None]
    if not both:
        return list(windows)
    rates_mps, std_mps = np.array([(climb.climb_rate_mps, climb.std_mps) for _, climb in both]).T
    prior = np.array([with_stairs_in_thirds(window.prob, window.stairs_unknown_share, contexts) for window, _ in both])
    prob = iter(reweighted_prob(prior, climb_log_evidence(rates_mps, std_mps, contexts)))
    return [
        window if climb is None else replace_unchecked(window, prob=next(prob), climb_rate_mps=climb.climb_rate_mps)
        for window, climb in zip(windows, climbs, strict=True)
    ]


# Mean and standard deviation of the step frequency in each context, Hz, between and within persons. They are medians
# over the persons of motionsense, difronzo, humolire, ms_indoor and ubicomp13, with standard deviations a fifth larger.
_WALKING_HZ, _RUNNING_HZ, _UP_HZ, _DOWN_HZ, _TURNED_HZ = (1.85, 0.25), (2.75, 0.25), (1.8, 0.3), (2.0, 0.35), (1.6, 0.5)
# Probability that steps were missed or detected twice, and the range of frequencies that then results, Hz.
_CADENCE_OUTLIER_SHARE, _CADENCE_RANGE_HZ = 0.1, 4.5


def _cadence_hz(context: Context) -> tuple[float, float]:
    """Return the mean and standard deviation of the step frequency in a context, Hz. The mean is NaN without steps."""
    if context.stands:
        return np.nan, 1.0
    if context.runs:
        return _RUNNING_HZ
    if context.climbs:
        return _UP_HZ if context.climbs > 0 else _DOWN_HZ
    return _TURNED_HZ if context.is_turned else _WALKING_HZ


@lru_cache
def _cadences_hz(contexts: ContextSet) -> tuple[FloatArray, FloatArray]:
    """Return the means (C,) and standard deviations (C,) of the step frequency in all contexts, Hz."""
    mean_hz, std_hz = np.array([_cadence_hz(c) for c in contexts.contexts]).T
    return mean_hz, std_hz


def cadence_log_evidence(frequency_hz: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> FloatArray:
    """Return the log likelihood (C,) of a step frequency f in Hz in each of C contexts.

    It is log((1 - e) N(f; m_c, s_c^2) + e / range). m_c and s_c are the mean and standard deviation of the step
    frequency in context c, e is the probability of an outlier, and range the width of the possible frequencies.
    """
    mean_hz, std_hz = _cadences_hz(contexts)
    normalised = (frequency_hz - mean_hz) / std_hz
    density = np.exp(-0.5 * normalised * normalised) / (math.sqrt(2 * math.pi) * std_hz)
    inlier = (1.0 - _CADENCE_OUTLIER_SHARE) * np.nan_to_num(density, nan=0.0)
    return np.log(inlier + _CADENCE_OUTLIER_SHARE / _CADENCE_RANGE_HZ)


def with_cadence(window: WindowContext, frequency_hz: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> WindowContext:
    """Return the window with the step frequency as evidence for its unknown share.

    The unknown share of the probabilities is the prior of the classifier. Here it is replaced by the posterior given
    the step frequency. The step frequency is higher in running than in walking wherever the phone is. With the phone at
    the belt, half of all running was otherwise classified as walking. For familiar windows the step frequency is
    already among the features of the classifier.
    """
    if window.unknown_share == 0.0:
        return window
    guess = reweighted_prob(window.training_prior, cadence_log_evidence(frequency_hz, contexts))
    return replace_unchecked(window, prob=window.prob + window.unknown_share * (guess - window.training_prior))


def with_stairs_in_thirds(prob: FloatArray, share: float, contexts: ContextSet = DEFAULT_CONTEXTS) -> FloatArray:
    """Return probabilities (C,) as a prior for another sensor that distinguishes stairs from walking.

    The given share of the probability of level walking and stairs is divided into equal thirds: level, up and down. The
    unequal division of `classifiers.context_model.blend_stairs_with_prior` is a prior of daily life. If it were used as
    evidence in each window, it would outvote the measurements of the other sensor.
    """
    in_thirds = contexts.in_thirds
    return (1.0 - share) * prob + share * (prob @ in_thirds) if share and in_thirds is not None else prob


@lru_cache
def _has_gate(names: tuple[str, ...]) -> bool:
    """Return True if a feature set has all features that the gates for irregular motion need."""
    return {*GATE.names, *GATE_ACCELEROMETER.names} <= set(names)


def _irregular_probs(windows: Sequence[FeatureWindow]) -> list[float]:
    """Return the probability of irregular motion for each window.

    It is zero at rest and where features of the gate are missing.
    """
    prob = np.zeros(len(windows))
    described = [(i, w) for i, w in enumerate(windows) if not w.is_still and _has_gate(w.names)]
    for has_gyroscope in (True, False):
        selected = [i for i, w in described if w.has_gyroscope == has_gyroscope]
        if selected:
            features = np.array([windows[i].features for i in selected])
            prob[selected] = irregular_prob(windows[selected[0]].names, features, has_gyroscope)
    return prob.tolist()


def _assessments(
    with_gyroscope: ContextModel | None, without_gyroscope: ContextModel | None, windows: Sequence[FeatureWindow]
) -> dict[int, Assessment]:
    """Return the assessments of windows by their index, from the model for the sensors of each window.

    Windows without such a model are omitted.
    """
    found: dict[int, Assessment] = {}
    for model, has_gyroscope in ((with_gyroscope, True), (without_gyroscope, False)):
        selected = [i for i, window in enumerate(windows) if window.has_gyroscope == has_gyroscope]
        if model is not None and selected:
            columns = _feature_columns(model.feature_names, windows[0].names)
            moving = [i for i in selected if not windows[i].is_still]
            if moving:
                assessed = model.assess_all(np.array([windows[i].features[columns] for i in moving]))
                found |= zip(moving, assessed, strict=True)
            still = [i for i in selected if windows[i].is_still]
            if still:
                found |= dict.fromkeys(still, _assessed_once(model, windows[still[0]].features[columns].tobytes()))
    return found


@lru_cache
def _assessed_once(model: ContextModel, features: bytes) -> Assessment:
    """Return the assessment of a window from the bytes of its features, which is kept for the next such window."""
    return model.assess(np.frombuffer(features))


@lru_cache
def _feature_columns(wanted: tuple[str, ...], names: tuple[str, ...]) -> IntArray:
    """Return the positions of the wanted features among all names."""
    return np.array([names.index(name) for name in wanted])
