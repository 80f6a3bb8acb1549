"""Earlier fixes of a track, as far as the next fix depends on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from pdr_filter.filter.pedestrian.range_solutions import PairedRange
from pdr_filter.filter.pedestrian.relocation import RelocationEvidence
from pdr_filter.filter.pedestrian.repeated_fixes import FixMemory
from pdr_filter.values import N_BEFORE, FloatArray, PositionFix, Standstill, read_only, replace_unchecked

MAX_STANDSTILLS = 16


@dataclass(frozen=True, eq=False)
class UsedFix:
    """Used position fix with a correlated error."""

    fix: PositionFix
    track_m: FloatArray | None  # (2,) position of the track at its time, or None if a gap followed the fix


# Log evidence of a stated standstill against walking, about a hundred thousand to one. It must outweigh a window that
# is certain of walking (a hundred to one, `PedestrianModel.evidence_floor`) and the detected step (seven to one).
STANDSTILL_LOG_EVIDENCE = 12.0
# Steps per second of walking: 110 per minute, as in `PedestrianModel.step_log_odds_stationary`.
_WALKING_HZ = 110.0 / 60.0


@dataclass(frozen=True)
class StandstillSteps:
    """Steps within stated standstills, as evidence of walking.

    Detections are Poisson distributed, with the rate of walking or with that of false detections while standing. The
    log-likelihood ratio of walking therefore grows with each step and decreases with time (E. S. Page, "Continuous
    inspection schemes", Biometrika 41, 1954). Single false steps in a long standstill are no contradiction.
    """

    log_ratio: float = 0.0  # log-likelihood ratio of walking and standing for the last steps, 0 or more
    n_recent: float = 0.0  # expected number of walking steps among these, as far as they are not in `n_contradicting`
    # expected number of walking steps that contradict the standstills: those with a ratio above
    # `STANDSTILL_LOG_EVIDENCE`, including the steps that led to it
    n_contradicting: float = 0.0
    recent_s: float = math.nan  # time of the first of the last steps
    first_s: float = math.nan  # time of the first contradicting step
    last_s: float = math.nan  # time of the last contradicting step

    def plus(self, time_s: float, since_s: float, moving_prob: float, step_log_ratio: float) -> StandstillSteps:
        """Return the evidence after a further step at `time_s`, `since_s` after the last one.

        `moving_prob` is the probability that the step displaces the pedestrian if nothing is stated. `step_log_ratio`
        is the log ratio of the rates of detections in walking and in standing.
        """
        before = max(self.log_ratio - _WALKING_HZ * (1.0 - math.exp(-step_log_ratio)) * since_s, 0.0)
        n_recent, recent_s = (self.n_recent, self.recent_s) if before > 0.0 else (0.0, time_s)
        # at most twice the limit, so that a few seconds of standing end a contradiction
        log_ratio = min(before + moving_prob * step_log_ratio, 2.0 * STANDSTILL_LOG_EVIDENCE)
        n_recent += moving_prob
        if log_ratio <= STANDSTILL_LOG_EVIDENCE:
            return replace_unchecked(self, log_ratio=log_ratio, n_recent=n_recent, recent_s=recent_s)
        return StandstillSteps(
            log_ratio,
            n_contradicting=self.n_contradicting + n_recent,
            recent_s=recent_s,
            first_s=self.first_s if self.n_contradicting else recent_s,
            last_s=time_s,
        )


@dataclass(frozen=True, eq=False)
class FixHistory:
    """Earlier fixes, stored for gating, for correlated errors and for repeated positions."""

    # Rejected position fixes that contradict the track.
    relocation: RelocationEvidence = field(default_factory=RelocationEvidence)
    used: tuple[UsedFix, ...] = ()  # last used fixes whose errors are correlated with the next one
    # Earlier fixes with which a new one is compared to find repetitions.
    memory: FixMemory = field(default_factory=FixMemory)
    n_errors: int = 0  # number of innovations of used position fixes, one for each axis
    squares: float = 0.0  # sum of the normalised squares of these innovations
    n_frozen: int = 0  # number of position fixes that repeated the previous position while steps continued
    n_repeated: int = 0  # number of other fixes that repeated an earlier one
    standstills: tuple[tuple[float, float], ...] = ()  # begin and end of the last standstills, s
    standstill_steps: StandstillSteps = StandstillSteps()  # steps within the standstills
    ranges: tuple[PairedRange, ...] = ()  # last range fixes, each with the track position at its time
    searched_s: float = -math.inf  # time of the last search for positions that fit the ranges, or minus infinity

    def with_used(self, fix: PositionFix, track_m: FloatArray | None) -> FixHistory:
        """Return the history with one more used fix, if its error can be correlated with the errors of later fixes.

        A fix with `correlation_s` 0 is not stored. `track_m` is the track position at the time of the fix. The last
        `N_BEFORE` fixes are kept, without those before an earlier gap.
        """
        if fix.correlation_s == 0:
            return self
        # displacements across a gap stay unknown: the first fix after it is treated as one of those before the gap
        since_gap = tuple(used for used in self.used if used.track_m is not None)
        used = UsedFix(fix, None if track_m is None else read_only(track_m))
        return replace_unchecked(self, used=(*since_gap, used)[-N_BEFORE:])

    def with_standstill(self, standstill: Standstill) -> FixHistory:
        """Return the history with one more standstill. Only the last `MAX_STANDSTILLS` standstills stay in it."""
        standstills = (*self.standstills, (standstill.time_s, standstill.end_s))[-MAX_STANDSTILLS:]
        return replace_unchecked(self, standstills=standstills)

    def is_standing(self, time_s: float) -> bool:
        """Return True if a standstill covers this time."""
        return any(begin_s <= time_s <= end_s for begin_s, end_s in self.standstills)

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> FixHistory:
        """Return the history with its track positions transformed by a function of positions (..., 2).

        The positions of the fixes are unchanged.
        """
        used = (
            u if u.track_m is None else replace_unchecked(u, track_m=read_only(positions(u.track_m))) for u in self.used
        )
        relocation, ranges = (
            self.relocation.with_moved_track(positions),
            tuple(pair.with_moved_track(positions) for pair in self.ranges),
        )
        return replace_unchecked(
            self, relocation=relocation, used=tuple(used), memory=self.memory.with_moved_track(positions), ranges=ranges
        )

    def after_gap(self) -> FixHistory:
        """Return the history after a gap, in which the pedestrian may have gone anywhere.

        The track positions of used fixes become unknown (None). Ranges are deleted. The last position fix is forgotten
        unless it is frozen (`FixMemory.after_gap`).
        """
        used = tuple(replace_unchecked(u, track_m=None) for u in self.used)
        return replace_unchecked(self, used=used, memory=self.memory.after_gap(), ranges=())
