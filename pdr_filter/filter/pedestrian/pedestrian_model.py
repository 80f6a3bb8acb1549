"""Configuration of a pedestrian filter: modes, transitions, noise, evidence and gates of the fixes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.imm.motion_model import IRREGULAR, Directions, Mode, MotionNoise
from pdr_filter.filter.imm.transition_probabilities import stationary_prob
from pdr_filter.filter.imm.weighting import ModeEvidence
from pdr_filter.filter.pedestrian.frame import START_FRAME, Frame
from pdr_filter.filter.step_length.models import StepLengths, uneven_var_m2
from pdr_filter.values import (
    CONTEXTS,
    DEFAULT_CONTEXTS,
    Context,
    ContextSet,
    FloatArray,
    Step,
    check_numbers,
    check_transition_prob,
    read_only,
    reduction,
)


class ModeLengths(NamedTuple):
    """Lengths of one step in each mode, without the scale of the person."""

    length_m: FloatArray  # (M,) length in m, zero in modes without displacement
    var_m2: FloatArray  # (M,) variance of the length in m2: residual plus parameters
    residual_var_m2: FloatArray  # (M,) variance of a single step about the length of its mode
    parameter_std_m: FloatArray  # (M,) standard deviation in m due to the parameters of the length model

    def mixture_var_m2(self, weights: FloatArray) -> float:
        """Return the variance in m2 of the length of a step whose mode has probabilities (M,)."""
        second_moment_m2 = float(weights.dot(self.var_m2 + self.length_m * self.length_m))
        return max(second_moment_m2 - float(weights.dot(self.length_m)) ** 2, 0.0)

    def of_one_filter(self, weights: FloatArray) -> ModeLengths:
        """Return the length of a step in a single filter for all modes, the mean with mode weights (M,)."""
        var_m2, parameter_var_m2 = self.mixture_var_m2(weights), float(weights @ self.parameter_std_m**2)
        each = float(weights @ self.length_m), var_m2, max(var_m2 - parameter_var_m2, 0.0), np.sqrt(parameter_var_m2)
        return ModeLengths(*(np.array([value]) for value in each))


@dataclass(frozen=True, eq=False)
class PedestrianModel:
    """Modes, transitions, noise and evidence of a pedestrian filter, shared by both trackers.

    Attributes
    ----------
    modes : tuple of Mode
        M modes. `WeightedTracker` needs exactly one for each context.
    transition_prob : (M, M) array
        Probability of a transition from mode i (row) to mode j (column) between two steps. Rows sum to one.
    evidence_exponent : float, default 1.0
        Exponent of the evidence of a context window in the online filter.
    hindsight_exponent : float, default 0.6
        Exponent of the evidence of a context window in the offline smoother, which also uses later windows.
    prior_exponent : float, default 0.2
        Exponent of the classifier's training prior by which its probabilities are divided.
    evidence_floor : float, default 0.01
        Lower bound of a context probability, so that a single window never excludes a context.
    step_log_odds_stationary : float, default -1.9
        Log evidence of a detected step for a mode without steps, relative to modes with steps, in all weightings.
    noise : MotionNoise
        Process noise and initial uncertainties.
    fix_gate_nis : float, default 13.8
        Gate of position fixes. A fix whose normalised innovation squared is larger is rejected.
    scalar_gate_nis : float, default 10.8
        Gate of one-dimensional measurements, such as headings, speeds and ranges.
    frame : Frame, default `START_FRAME`
        Frame of the fixes. `UNKNOWN_FRAME` means that the first fixes determine its origin and north.
    contexts : tuple of str, default `CONTEXTS`
        Names of the C contexts, in the order of the probabilities of a window.

    Raises
    ------
    ValueError
        If there are no modes, if names repeat, if a mode has an unknown context, or if a number or the transition
        matrix is not allowed.

    Notes
    -----
    Evidence exponent: consecutive windows overlap by half, so that each second of data would count once with 0.5. The
    exponent of the smoother is the largest of three that does not increase the log loss on held-out people. With 0.5,
    0.6 and 0.7 the log loss is 0.087, 0.082 and 0.080 on joined walks of MotionSense, and 0.0163, 0.0163 and 0.0169 on
    difronzo. The online filter knows no later windows and therefore detects every change late. Uncertain probabilities
    cost it more than overconfident ones, so that its exponent is 1 (docs/benchmarks/contexts.md has figures for both).

    Prior exponent: with exponent 1, level walking of unknown people is classified as stairs. With exponent 0 their
    stairs are classified as walking. The default was chosen by the error of the distance on joined walks of
    MotionSense, on MotionSense and on difronzo. With one person held out, the others choose 0.10 to 0.25.

    Step evidence: handling a phone causes about 16 false detections a minute, and walking has 110 steps a minute. The
    default is log(16 / 110).

    Gates: 99.9 % of correct fixes have a chi-square below 13.8 (two dimensions) and 10.8 (one dimension).

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
    >>> modes = pdr.Mode("resting", moves=False), pdr.Mode("level")
    >>> transition_prob = np.array([[0.8, 0.2], [0.02, 0.98]])
    >>> model = PedestrianModel(modes, transition_prob, contexts=("resting", "level"))
    >>> model.long_run_mode_prob.round(3)
    array([0.091, 0.909])
    """

    modes: tuple[Mode, ...]
    transition_prob: FloatArray
    evidence_exponent: float = 1.0
    hindsight_exponent: float = 0.6
    prior_exponent: float = 0.2
    evidence_floor: float = 0.01
    step_log_odds_stationary: float = -1.9
    noise: MotionNoise = field(default_factory=MotionNoise)
    fix_gate_nis: float = 13.8
    scalar_gate_nis: float = 10.8
    frame: Frame = START_FRAME
    contexts: tuple[str, ...] = CONTEXTS

    __reduce__ = reduction

    def __post_init__(self) -> None:
        if not self.modes:
            raise ValueError('modes is empty: give at least one mode, such as pdr.Mode("walking")')
        gates, exponents = ("fix_gate_nis", "scalar_gate_nis"), ("evidence_exponent", "hindsight_exponent")
        may_be_zero = (*gates, *exponents, "prior_exponent", "evidence_floor")
        check_numbers(self, zero=may_be_zero, signed=("step_log_odds_stationary",), infinite=gates)
        if self.evidence_floor >= 1:
            raise ValueError(
                f"evidence_floor is a probability and must be below 1, got {self.evidence_floor}: use a small one, "
                "such as 0.01"
            )
        names = [m.name for m in self.modes]
        if len(set(names)) < len(names):
            raise ValueError(f"mode names must be distinct, got {names}: rename modes that have the same name")
        if IRREGULAR in self.contexts:
            raise ValueError(
                f'contexts must not include "{IRREGULAR}", which is reserved for handling of the phone, got '
                f"{self.contexts}: rename the context"
            )
        for mode in self.modes:
            if mode.context not in (*self.contexts, IRREGULAR):
                raise ValueError(
                    f"context of mode {mode.name!r} must be one of {(*self.contexts, IRREGULAR)}, got "
                    f"{mode.context!r}: name a context of the context model, or give config.with_contexts a model that "
                    "has it"
                )
        check_transition_prob(self.transition_prob, len(self.modes))
        object.__setattr__(self, "transition_prob", read_only(self.transition_prob))

    def check_one_mode_for_each_context(self) -> None:
        """Raise an error unless each context has exactly one mode.

        Raises
        ------
        ValueError
            If a context has no mode or several modes, or if there is an irregular mode.
        """
        contexts = [m.context for m in self.modes]
        if sorted(contexts) != sorted(self.contexts):
            raise ValueError(
                f'weightings other than "imm" need exactly one mode for each of {self.contexts}, got {contexts}: '
                'use weighting="imm" for other modes'
            )

    @cached_property
    def context_set(self) -> ContextSet:
        """Contexts with their meanings, as the modes define them.

        A context with several modes has the meaning of the first one. A context without a mode has its meaning in the
        default configuration. If the default configuration does not have it, it means level walking.
        """
        meanings = {c.name: c for c in DEFAULT_CONTEXTS.contexts} | {m.context: m.meaning for m in reversed(self.modes)}
        return ContextSet(tuple(meanings.get(name, Context(name)) for name in self.contexts))

    @cached_property
    def directions(self) -> Directions:
        """Walking directions of all modes."""
        return Directions.of(self.modes)

    @cached_property
    def moves(self) -> FloatArray:
        """Array (M,) with 1 for modes in which a step displaces the pedestrian, else 0."""
        return np.array([float(m.moves) for m in self.modes])

    @cached_property
    def stands(self) -> FloatArray:
        """Array (M,) with 1 for modes without steps, else 0.

        Irregular modes have 0, because handling the phone causes as many detections as walking.
        """
        return np.array([float(m.gait is None and m.context != IRREGULAR) for m in self.modes])

    @cached_property
    def step_evidence(self) -> FloatArray:
        """Log evidence (M,) of a detected step for each mode.

        The value is `step_log_odds_stationary` for modes in which the person makes no steps, and 0 for all other modes.
        """
        return self.step_log_odds_stationary * self.stands

    @cached_property
    def on_stairs(self) -> FloatArray:
        """Array (2, M) with 1 for modes that go up stairs (first row) and down stairs (second row), else 0."""
        return np.array([[float(m.climbs == way) for m in self.modes] for way in (1, -1)])

    @cached_property
    def context_index(self) -> list[int]:
        """Index into `contexts` of each mode.

        Raises ValueError if there is an irregular mode.
        """
        return [self.contexts.index(m.context) for m in self.modes]

    @cached_property
    def evidence(self) -> ModeEvidence:
        """Evidence model that maps context windows to log evidence of the modes."""
        return ModeEvidence(
            tuple(m.context for m in self.modes),
            tuple(m.carrying_mode for m in self.modes),
            self.evidence_exponent,
            self.prior_exponent,
            self.evidence_floor,
            self.contexts,
        )

    @cached_property
    def _lengths(self) -> StepLengths:
        return StepLengths(tuple(m.step_length for m in self.modes))

    @cached_property
    def _offset_vectors(self) -> FloatArray:
        offset_rad = self.directions.heading_offset_rad
        return np.column_stack([np.sin(offset_rad), np.cos(offset_rad)])

    @cached_property
    def long_run_mode_prob(self) -> FloatArray:
        """Stationary mode probabilities (M,) of the transitions: the mean share of time in each mode, uniform start."""
        return read_only(stationary_prob(self.transition_prob))

    def lengths(self, step: Step) -> ModeLengths:
        """Return the length of a step in each mode.

        Parameters
        ----------
        step : Step
            Detected step.

        Returns
        -------
        ModeLengths
            Lengths and variances, one entry for each mode.
        """
        length_m, parameter_var_m2 = self._lengths.moments(step)
        length_m, parameter_var_m2 = self.moves * length_m, self.moves * parameter_var_m2
        residual_var_m2 = self.own_var_m2(step, length_m)
        return ModeLengths(length_m, residual_var_m2 + parameter_var_m2, residual_var_m2, np.sqrt(parameter_var_m2))

    def lengths_of_all(self, steps: Sequence[Step]) -> list[ModeLengths]:
        """Return the lengths of many steps in each mode, which equal those of `lengths` except for rounding.

        Parameters
        ----------
        steps : sequence of Step
            Detected steps.

        Returns
        -------
        list of ModeLengths
            Lengths and variances of each step.
        """
        length_m, parameter_var_m2 = (self.moves * moment for moment in self._lengths.moments_of_all(steps))
        each = [self.own_var_m2(step, row) for step, row in zip(steps, length_m, strict=True)]
        own_m2 = np.array(each).reshape(length_m.shape)
        rows = zip(length_m, own_m2 + parameter_var_m2, own_m2, np.sqrt(parameter_var_m2), strict=True)
        return [ModeLengths(*row) for row in rows]

    def own_var_m2(self, step: Step, length_m: FloatArray) -> FloatArray:
        """Return the variance of a single step about the length of each mode.

        Parameters
        ----------
        step : Step
            Detected step.
        length_m : (M,) array
            Length of the step in each mode.

        Returns
        -------
        (M,) array
            Variance in m2.

        Notes
        -----
        No model holds for a step that is too quick for walking and too soft for running. It may be anything between a
        step on the spot and a step of twice the modelled length: L^2 / 3 is added.
        """
        var_m2 = self._lengths.residual_var_m2 + uneven_var_m2(step) * self.moves
        return var_m2 + length_m * length_m / 3.0 if step.is_quick_and_soft else var_m2

    def mean_heading_offset_rad(self, mode_prob: FloatArray) -> float:
        """Return the mean heading offset of the modes, averaged as unit vectors.

        Parameters
        ----------
        mode_prob : (M,) array
            Mode probabilities.

        Returns
        -------
        float
            Walking heading minus the heading that the body faces, in rad.
        """
        sine, cosine = mode_prob.dot(self._offset_vectors).tolist()
        return math.atan2(sine, cosine) if sine * sine + cosine * cosine > 1e-18 else 0.0

    def step_mode_prob(self, context_prob: FloatArray) -> FloatArray:
        """Return the mode probabilities of a step from the context probabilities of its window alone.

        Parameters
        ----------
        context_prob : (..., C) array
            Context probabilities of a window, or of one window for each step.

        Returns
        -------
        (..., M) array
            Mode probabilities given window and step, without other steps, windows and fixes.
        """
        has = np.array([[float(m.context == c) for m in self.modes] for c in self.contexts])
        prob = context_prob @ (has / np.maximum(has.sum(axis=1, keepdims=True), 1.0)) * np.exp(self.step_evidence)
        total = prob.sum(axis=-1, keepdims=True)
        return np.where(total > 0.0, prob, self.long_run_mode_prob) / np.where(total > 0.0, total, 1.0)

    def context_prob(self, mode_prob: FloatArray) -> FloatArray:
        """Return the context probabilities that mode probabilities imply.

        Parameters
        ----------
        mode_prob : (M,) array
            Mode probabilities.

        Returns
        -------
        (C,) array
            Sum of the mode probabilities of each context, normalised without irregular modes.
        """
        prob = [sum(p for m, p in zip(self.modes, mode_prob, strict=True) if m.context == c) for c in self.contexts]
        total = sum(prob)  # below one if there are irregular modes
        return np.array(prob) / total if total > 0 else np.full(len(prob), 1 / len(prob))
