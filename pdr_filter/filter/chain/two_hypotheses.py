"""Handler that follows two hypotheses about the position while ranges fit both, and doubts a contradicted track."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdr_filter.filter.chain.handler import Around, Event, FixUse, Fork, Handler, Output
from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate, past_position, reckoned_position
from pdr_filter.filter.pedestrian.range_solutions import MIN_LOG_ODDS
from pdr_filter.values import FloatArray, PositionFix, read_only, replace_unchecked


@dataclass(frozen=True, eq=False)
class Hypotheses(Around):
    """States of two hypotheses of the inner handler.

    Attributes
    ----------
    inner : object
        State of the more probable hypothesis.
    rival : object or None
        State of the less probable hypothesis, or None if there is one hypothesis only.
    rival_log_odds : float
        Log of the ratio of the probabilities of the rival and the more probable hypothesis, 0 or less.
    conflict : FixConflict
        Position fixes that contradict the track.
    """

    rival: Any = None
    rival_log_odds: float = -math.inf
    conflict: FixConflict = field(default_factory=FixConflict)

    def with_spread(self, position_m: FloatArray, cov_m2: FloatArray) -> FloatArray:
        """Return the covariance (2, 2) of a position, including the possibility that another hypothesis is true.

        The other hypothesis is the rival, or that rejected position fixes are right and the track is wrong.
        """
        if self.conflict.is_doubtful:
            cov_m2 = read_only(cov_m2 + self.conflict.cov_m2)
        if self.rival is None:
            return cov_m2
        away_m = reckoned_position(self.rival.pedestrian)[0] - position_m
        rival_prob = 1.0 / (1.0 + math.exp(-self.rival_log_odds))
        return read_only(cov_m2 + rival_prob * np.outer(away_m, away_m))


class TwoHypotheses:
    """Handler around another one, of which it follows two states while ranges fit both.

    The more probable state becomes the track. `gate_nis` is the gate of the fixes, which bounds their evidence.
    """

    def __init__(self, inner: Handler[Any], gate_nis: float) -> None:
        self.inner, self.gate_nis = inner, gate_nis

    def init(self) -> Hypotheses:
        """Return the state with a single hypothesis."""
        return Hypotheses(self.inner.init())

    def on(self, state: Hypotheses, event: Event, known_s: float) -> tuple[Hypotheses, tuple[Output, ...]]:
        """Return the state after an event of both hypotheses, and the outputs of the more probable one."""
        inner, outputs = self.inner.on(state.inner, event, known_s)
        use, fork = None, None
        for output in outputs:
            if isinstance(output, FixUse):
                use = output
            elif isinstance(output, Fork):
                fork = output
        if use is None:
            rival = None if state.rival is None else self.inner.on(state.rival, event, known_s)[0]
            state = replace_unchecked(state, inner=inner, rival=rival)
        else:
            state = replace_unchecked(state, inner=inner, conflict=_with_fix(state.conflict, use, inner.pedestrian))
            if fork is None:
                state = self._after_fix(state, use, known_s)
            else:
                state = replace_unchecked(state, rival=fork.state, rival_log_odds=fork.log_odds)
        if state.rival is None and not state.conflict.is_doubtful:
            return state, outputs
        others = (output for output in outputs if output is not fork)
        return state, tuple(_with_spread(state, o) if isinstance(o, StepUpdate) else o for o in others)

    def _after_fix(self, state: Hypotheses, use: FixUse, known_s: float) -> Hypotheses:
        """Return the state after a fix that the more probable hypothesis has processed.

        A rival below `MIN_LOG_ODDS` is dropped. The log-likelihood of a rejected fix is bounded by its value at the
        gate.
        """
        if state.rival is None:
            return state
        first, log_odds = state.inner, state.rival_log_odds
        rival, outputs = self.inner.on(state.rival, use.fix, known_s)
        rival_nis = next(output.nis for output in outputs if isinstance(output, FixUse))
        if not (math.isnan(use.nis) or math.isnan(rival_nis)):
            log_odds += 0.5 * (min(use.nis, self.gate_nis) - min(rival_nis, self.gate_nis))
        if log_odds > 0.0:
            first, rival, log_odds = rival, first, -log_odds
        if log_odds < MIN_LOG_ODDS:
            rival, log_odds = None, -math.inf
        return replace_unchecked(state, inner=first, rival=rival, rival_log_odds=log_odds)


def _with_fix(conflict: FixConflict, use: FixUse, pedestrian: PedestrianState) -> FixConflict:
    if not isinstance(use.fix, PositionFix):
        return conflict
    track_m = past_position(pedestrian, use.fix.time_s)
    return conflict.plus(use.outcome, None if track_m is None else use.fix.position_m - track_m)


def _with_spread(state: Hypotheses, update: StepUpdate) -> StepUpdate:
    cov_m2 = state.with_spread(update.position_m, update.position_cov_m2)
    return replace_unchecked(update, position_cov_m2=cov_m2)
