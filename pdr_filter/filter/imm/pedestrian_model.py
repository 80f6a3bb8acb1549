"""What a filter believes of pedestrians: modes, how one follows another, noise, evidence, and which fixes it takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.fixes.frame import START_FRAME, Frame
from pdr_filter.filter.imm.motion_model import IRREGULAR, Directions, Mode, MotionNoise
from pdr_filter.filter.imm.weighting import ModeEvidence
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
    pickled,
    read_only,
)


class ModeLengths(NamedTuple):
    """Lengths of one step in each mode without the person's scale, and their variances, (M,) each."""

    length_m: FloatArray  # zero in modes that move nobody
    var_m2: FloatArray  # of the length: residual and parameters
    residual_var_m2: FloatArray  # of a single step about the length of its mode
    parameter_std_m: FloatArray  # due to the parameters of the length model

    def mixture_var_m2(self, weights: FloatArray) -> float:
        """Variance of the length of a step whose mode has these probabilities (M,)."""
        second_moment_m2 = float(weights.dot(self.var_m2 + self.length_m * self.length_m))
        return max(second_moment_m2 - float(weights.dot(self.length_m)) ** 2, 0.0)


@dataclass(frozen=True, eq=False)
class PedestrianModel:
    """Modes with their transitions, noise and evidence; what both trackers filter with.

    The evidence of one window is tempered by an exponent. Hop over window length (0.5) lets no second of overlapping
    windows count twice, and that is the exponent in hindsight. Online it is 1: a filter that knows no later windows is
    late at every change, and doubts cost it more than being too sure (docs/benchmarks.md for both). The exponent of the
    prior is how far the classifier's training prior is divided out: with all of it other people's flat
    walking is classified as stairs, with none of it their stairs as walking.

    Fixes with a larger normalised innovation squared than the gate in every mode are rejected: chi-square keeps 99.9 %
    of good positions below 13.8, of good headings and speeds below 10.8.
    """

    modes: tuple[Mode, ...]  # `WeightedTracker` needs exactly one for each context
    transition_prob: FloatArray  # (M, M) from mode i to mode j between two steps; rows sum to one
    evidence_exponent: float = 1.0
    hindsight_exponent: float = 0.5  # the same where later windows are known, too
    prior_exponent: float = 0.2
    evidence_floor: float = 0.01  # probability below which a context is not pushed by one window
    # Log evidence of a detected step for a mode that stands still against one that moves: handling a phone makes about
    # 16 false detections a minute, walking 110 true ones, log(16 / 110).
    step_log_odds_stationary: float = -1.9
    noise: MotionNoise = field(default_factory=MotionNoise)
    fix_gate_nis: float = 13.8
    scalar_gate_nis: float = 10.8
    frame: Frame = START_FRAME  # of the fixes; `UNKNOWN_FRAME` until some have shown its origin and north to the track
    contexts: tuple[str, ...] = CONTEXTS  # C names in the order of the probabilities of a window

    __reduce__ = pickled

    def __post_init__(self) -> None:
        if not self.modes:
            raise ValueError("modes must hold one mode at least, got none")
        gates, exponents = ("fix_gate_nis", "scalar_gate_nis"), ("evidence_exponent", "hindsight_exponent")
        may_be_zero = (*gates, *exponents, "prior_exponent", "evidence_floor")
        check_numbers(self, zero=may_be_zero, signed=("step_log_odds_stationary",), infinite=gates)
        if self.evidence_floor >= 1:
            raise ValueError(f"evidence_floor must be below 1, got {self.evidence_floor}")
        names = [m.name for m in self.modes]
        if len(set(names)) < len(names):
            raise ValueError(f"mode names must be distinct, got {names}")
        if IRREGULAR in self.contexts:
            raise ValueError(
                f'"{IRREGULAR}" is handling of the phone, got contexts {self.contexts}: rename the context'
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
        """ValueError unless the modes are the contexts, each once."""
        contexts = [m.context for m in self.modes]
        if sorted(contexts) != sorted(self.contexts):
            raise ValueError(
                f'weightings but "imm" need exactly one mode for each of {self.contexts}, got {contexts}; '
                'use weighting="imm" for other modes'
            )

    @cached_property
    def context_set(self) -> ContextSet:
        """Contexts with the meaning that their modes state.

        A context with several modes means what the first of them states. One without a mode means what it means in the
        default; a context that the default does not have is then level walking.
        """
        meanings = {c.name: c for c in DEFAULT_CONTEXTS.contexts} | {m.context: m.meaning for m in reversed(self.modes)}
        return ContextSet(tuple(meanings.get(name, Context(name)) for name in self.contexts))

    @cached_property
    def directions(self) -> Directions:
        """Of all modes."""
        return Directions.of(self.modes)

    @cached_property
    def moves(self) -> FloatArray:
        """1 for the modes in which a step leads somewhere, (M,)."""
        return np.array([float(m.moves) for m in self.modes])

    @cached_property
    def stands(self) -> FloatArray:
        """1 for the modes without steps, (M,): without irregular ones, which have steps as often as walking has."""
        return np.array([float(m.gait is None and m.context != IRREGULAR) for m in self.modes])

    @cached_property
    def step_evidence(self) -> FloatArray:
        """Log evidence (M,) of a detected step for each mode."""
        return self.step_log_odds_stationary * self.stands

    @cached_property
    def on_stairs(self) -> FloatArray:
        """1 for the modes that climb stairs, and for those that go down, (2, M)."""
        return np.array([[float(m.climbs == way) for m in self.modes] for way in (1, -1)])

    @cached_property
    def context_index(self) -> list[int]:
        """Index into `contexts` of each mode; only where all modes are contexts."""
        return [self.contexts.index(m.context) for m in self.modes]

    @cached_property
    def evidence(self) -> ModeEvidence:
        """What windows say for the modes."""
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
        """Mode probabilities (M,) to which the transitions lead; from an even start, which an unmixed chain keeps."""
        return np.linalg.matrix_power(self.transition_prob, 1024).mean(axis=0)

    def lengths(self, step: Step) -> ModeLengths:
        """Return the length of a step in each mode."""
        length_m, parameter_var_m2 = self._lengths.moments(step)
        length_m, parameter_var_m2 = self.moves * length_m, self.moves * parameter_var_m2
        residual_var_m2 = self.own_var_m2(step, length_m)
        return ModeLengths(length_m, residual_var_m2 + parameter_var_m2, residual_var_m2, np.sqrt(parameter_var_m2))

    def own_var_m2(self, step: Step, length_m: FloatArray) -> FloatArray:
        """Variance (M,) of a single step about the lengths (M,) of the modes.

        One that is too quick for walking and too soft for running may be anything from a step on the spot to twice as
        long as a model says: L^2 / 3.
        """
        var_m2 = self._lengths.residual_var_m2 + uneven_var_m2(step) * self.moves
        return var_m2 + length_m * length_m / 3.0 if step.is_quick_and_soft else var_m2

    def mean_heading_offset_rad(self, mode_prob: FloatArray) -> float:
        """The modes' own heading offset, averaged as vectors."""
        sine, cosine = mode_prob.dot(self._offset_vectors).tolist()
        return math.atan2(sine, cosine) if sine * sine + cosine * cosine > 1e-18 else 0.0

    def context_prob(self, mode_prob: FloatArray) -> FloatArray:
        """Context probabilities (C,) that mode probabilities imply: summed over the modes of each context."""
        prob = [sum(p for m, p in zip(self.modes, mode_prob, strict=True) if m.context == c) for c in self.contexts]
        total = sum(prob)  # less than one beside irregular modes
        return np.array(prob) / total if total > 0 else np.full(len(prob), 1 / len(prob))
