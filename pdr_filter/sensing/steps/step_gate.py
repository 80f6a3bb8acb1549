"""Steps of somebody who walks, without those of a phone that is handled: a causal gate behind the step detector.

The gate holds each step until its fate is known and lets it pass, with its own contact time, where somebody walks. It
needs the specific force alone: neither gyroscope nor attitude, no model, no carrying mode.

1. Evidence of each step, from the specific force around its contact and the contacts before it (`walking_evidence`).
   Of its log odds of walking `evidence_weight` counts, because the windows of neighbouring steps overlap. The clock of
   the evidence runs with the steps: `slowness` stretches its times for a slow walker.
2. Smoothing. Walking and not walking are the two states of a Markov chain in continuous time, observed at the contacts
   (Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 1989, eqs. 20 and 25). A step is accepted if walking
   is more probable than not, from its own evidence and all before.
3. Bouts. Every accepted step corrects the ones before it by the evidence after them (backward recursion). `min_steps`
   of them that are walking are a bout and leave together, later ones leave at once; fewer are dropped.
4. Edges. A step before the first accepted one belongs to the bout if walking is not improbable, and so do up to
   `n_fill` more, close by. A refused step between two accepted ones of a bout belongs to it.

The steps of a block are judged together. docs/methods/steps.md has data and limits, docs/benchmarks.md figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.walking_evidence import (
    EVIDENCE,
    EVIDENCE_HZ,
    MAX_SLOWNESS,
    MIN_ROWS,
    WalkEvidence,
    evidence_features,
    slowness,
)
from pdr_filter.values import FloatArray, Step, check_numbers, replace_unchecked

# A step may become known so long after its contact and still find its window whole.
_MAX_KNOWN_AFTER_S = 4.0


@dataclass(frozen=True, slots=True)
class JudgedStep:
    """A step whose evidence is known."""

    step: Step
    walking_prob: float  # at its contact, from its evidence and all before
    ratio: float  # likelihood of its evidence while walking to that while not
    slowness: float  # of the steps up to it


@dataclass(frozen=True, eq=False)
class StepGateState:
    """Belief in walking, the force of the last seconds, and the steps whose fate is open."""

    walking_prob: float  # after the last step that is judged
    judged_s: float = -math.inf  # its contact
    start_s: float = math.nan  # of the segment: time of its first sample
    n_samples: int = 0  # of the segment
    rest: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # force of samples that are no whole row yet
    rows: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # last rows of averaged force
    waiting: tuple[tuple[int, Step], ...] = ()  # for their window, with the number of the sample that revealed them
    contacts_s: tuple[float, ...] = ()  # the last four of the segment that are judged
    held: tuple[JudgedStep, ...] = ()  # judged, but not out: they may still belong to a bout
    run_s: tuple[float, float] = (-math.inf, -math.inf)  # first and last contact of accepted steps without a pause
    is_bout: bool = False  # that they are a bout

    @property
    def candidates(self) -> tuple[Step, ...]:
        """Steps that are found and not accepted yet; none while the person does not seem to walk."""
        if not (self.is_bout or self.walking_prob > 0.5):
            return ()
        return (*(judged.step for judged in self.held), *(step for _, step in self.waiting))


@dataclass(frozen=True)
class StepGate:
    """Causal gate for steps.

    In a bout a step passes `latency_s` after its contact, 1.04 s, or as soon as the detector knows it. The first steps
    of a bout pass together with the one that makes it `min_steps`: the first waits three step intervals longer, 2.7 s
    at 1.8 steps a second, and longer where the evidence is weak. A gap or the end decides at once.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks, a multiple of 25 Hz.
    evidence : WalkEvidence
        Log odds of walking.
    before_s, after_s : float
        Window of the evidence around a contact: four steps of a usual walk fit in before it, by `slowness` times more
        seconds for a slow one, and the end of a walk is seen.
    evidence_weight : float
        Power of the likelihood of one step. Smaller: fewer steps lost, more handling passes.
    max_log_ratio : float
        Largest weight of one step, natural logarithm.
    mean_walk_s, mean_pause_s : float
        Mean stays of the Markov chain in walking and out of it.
    min_steps : int
        Fewest steps that are a bout. Five in place of four: half of the false steps, half a second more to wait.
    max_interval_s : float
        After a longer time without accepted steps a new bout begins. The slowest steps are 2 s apart.
    min_edge_prob : float
        Probability of walking, with the evidence after it, with which a step before a bout belongs to it.
    max_edge_s : float
        No step before a bout is that early, times `slowness`.
    n_fill : int
        So many refused steps more may belong to the beginning of a bout.
    fill_interval_s : float
        If they are this close, times `slowness`.
    """

    rate_hz: float = 100.0
    evidence: WalkEvidence = field(default=EVIDENCE)
    before_s: float = 2.5
    after_s: float = 1.0
    evidence_weight: float = 0.4
    max_log_ratio: float = 4.0
    mean_walk_s: float = 40.0
    mean_pause_s: float = 13.0
    min_steps: int = 4
    max_interval_s: float = 2.5
    min_edge_prob: float = 0.2
    max_edge_s: float = 3.0
    n_fill: int = 2
    fill_interval_s: float = 1.5

    def __post_init__(self) -> None:
        check_numbers(self, zero=("n_fill",))
        if self.rate_hz % EVIDENCE_HZ:
            raise ValueError(f"rate_hz must be a multiple of {EVIDENCE_HZ:g}, got {self.rate_hz}")

    @cached_property
    def _samples_per_row(self) -> int:
        return round(self.rate_hz / EVIDENCE_HZ)

    @cached_property
    def _n_before(self) -> int:
        return round(self.before_s * EVIDENCE_HZ)

    @cached_property
    def _n_after(self) -> int:
        return round(self.after_s * EVIDENCE_HZ)

    @cached_property
    def _n_rows_kept(self) -> int:
        return round(MAX_SLOWNESS * self._n_before) + self._n_after + round(_MAX_KNOWN_AFTER_S * EVIDENCE_HZ)

    @property
    def latency_s(self) -> float:
        """Time from a contact to its step in a bout, unless the detector takes longer."""
        return (self._n_after + 1) / EVIDENCE_HZ

    def init(self) -> StepGateState:
        """State before the first sample."""
        return StepGateState(self._walking_share)

    def update(
        self, state: StepGateState, block: UniformBlock, attitude: AttitudeBlock, steps: Sequence[tuple[int, Step]]
    ) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """New state and the steps that pass, each with the number of the sample that decided.

        `steps` are what the detector found in this block, in order; the attitude is not looked at.
        """
        samples = np.concatenate([state.rest, block.specific_force_mps2])
        n = self._samples_per_row
        whole = samples[: len(samples) // n * n]
        state = replace_unchecked(
            state,
            start_s=float(block.time_s[0]) if state.n_samples == 0 else state.start_s,
            n_samples=state.n_samples + len(block.time_s),
            rest=samples[len(whole) :],
            # summed one after the other: the same bits however the samples came
            rows=np.concatenate([state.rows, sum((whole[i::n] for i in range(1, n)), whole[0::n]) / n]),
            waiting=(*state.waiting, *steps),
        )
        numbers: list[int] = []
        for known, step in state.waiting:
            number = max(known, (self._row(state, step) + self._n_after + 1) * n - 1)
            if number >= state.n_samples:
                break
            numbers.append(number)
        state, released = self._judge(state, numbers)
        return replace_unchecked(state, rows=state.rows[-self._n_rows_kept :]), released

    def close(
        self, state: StepGateState, steps: Sequence[tuple[int, Step]]
    ) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """State before the first sample after a gap or the end, and the steps that pass of those that still waited.

        `steps` are what the detector's `finish` gave. A bout goes on after a short gap, the belief in walking fades
        with time.
        """
        state = replace_unchecked(state, waiting=(*state.waiting, *steps))
        state, released = self._judge(state, [state.n_samples - 1] * len(state.waiting))
        # Steps that are no bout yet are given up: what the gap holds is unknown.
        after = StepGateState(state.walking_prob, state.judged_s)
        return (replace_unchecked(after, run_s=state.run_s, is_bout=True) if state.is_bout else after), released

    def _row(self, state: StepGateState, step: Step) -> int:
        """Number of the row that a contact is in."""
        return max(math.floor((step.time_s - state.start_s) * EVIDENCE_HZ), 0)

    def _judge(self, state: StepGateState, numbers: Sequence[int]) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """State after the steps that have waited longest, judged at samples of these numbers, and those that pass."""
        if not numbers:
            return state, []
        steps = [step for _, step in state.waiting[: len(numbers)]]
        contacts_s = (*state.contacts_s, *(step.time_s for step in steps))
        intervals_s = [self._intervals_s(contacts_s[: i + 1]) for i in range(len(state.contacts_s), len(contacts_s))]
        state = replace_unchecked(state, waiting=state.waiting[len(numbers) :], contacts_s=contacts_s[-4:])
        released: list[tuple[int, Step]] = []
        log_odds = self._log_odds(state, steps, numbers, intervals_s)
        for step, number, of_step, intervals in zip(steps, numbers, log_odds, intervals_s, strict=True):
            ratio = math.exp(min(max(self.evidence_weight * of_step, -self.max_log_ratio), self.max_log_ratio))
            prob = _posterior(self._prob_after(state.walking_prob, step.time_s - state.judged_s), ratio)
            held = (*state.held, JudgedStep(step, prob, ratio, slowness(intervals)))
            state = replace_unchecked(state, walking_prob=prob, judged_s=step.time_s, held=held)
            state, passed = self._accept(state, step.time_s) if prob > 0.5 else (self._without_old(state), [])
            now_s = state.start_s + number / self.rate_hz
            released += [(number, replace_unchecked(s, detected_time_s=max(now_s, s.detected_time_s))) for s in passed]
        return state, released

    def _intervals_s(self, contacts_s: Sequence[float]) -> list[float]:
        """Up to three intervals before the last contact."""
        return [b - a for a, b in pairwise(contacts_s[-4:]) if 0.0 < b - a < self.max_interval_s]

    def _log_odds(
        self, state: StepGateState, steps: Sequence[Step], numbers: Sequence[int], intervals_s: Sequence[list[float]]
    ) -> list[float]:
        """Log odds of walking of each step, from its evidence alone; even where there is too little of it."""
        rows = [self._row(state, step) for step in steps]
        windows = [
            self._window(state, *of_step) for of_step in zip(rows, numbers, map(slowness, intervals_s), strict=True)
        ]
        seen = [i for i, window in enumerate(windows) if len(window) >= MIN_ROWS]
        log_odds = np.zeros(len(steps))
        if seen:
            features = evidence_features([windows[i] for i in seen], [intervals_s[i] for i in seen])
            log_odds[seen] = self.evidence.log_odds(features)
        return log_odds.tolist()

    def _window(self, state: StepGateState, row: int, number: int, stretch: float) -> FloatArray:
        """Rows around a row; the same however many are remembered."""
        n_rows = (state.n_samples - len(state.rest)) // self._samples_per_row
        n_seen = (number + 1) // self._samples_per_row
        first = max(row - round(stretch * self._n_before), n_seen - self._n_rows_kept, 0)
        last = min(row + self._n_after + 1, n_seen)
        oldest = n_rows - len(state.rows)
        return state.rows[max(first - oldest, 0) : max(last - oldest, 0)]

    def _accept(self, state: StepGateState, contact_s: float) -> tuple[StepGateState, list[Step]]:
        """The last judged step is walking: it leaves if it belongs to a bout, or makes one."""
        continues = contact_s - state.run_s[1] <= self.max_interval_s
        run_s = (state.run_s[0] if continues else contact_s, contact_s)
        if continues and state.is_bout:
            return replace_unchecked(state, run_s=run_s, held=()), [judged.step for judged in state.held]
        state = replace_unchecked(state, run_s=run_s, is_bout=False)
        first, n_walking = self._run(state)
        if n_walking < self.min_steps:
            return self._without_old(state), []
        for _ in range(self.n_fill):
            interval_s = state.held[first].step.time_s - state.held[first - 1].step.time_s
            first -= first > 0 and interval_s <= self.fill_interval_s * state.held[-1].slowness
        return replace_unchecked(state, held=(), is_bout=True), [judged.step for judged in state.held[first:]]

    def _run(self, state: StepGateState) -> tuple[int, int]:
        """First held step of the run, with what belongs to its beginning, and how many from there are walking."""
        first, n_walking, ratio = len(state.held) - 1, 1, 1.0
        for i in range(len(state.held) - 2, -1, -1):
            earlier, later = state.held[i], state.held[i + 1]
            interval_s = later.step.time_s - earlier.step.time_s
            ratio = self._ratio_before(ratio * later.ratio, interval_s)
            prob = _posterior(earlier.walking_prob, ratio)
            is_before = earlier.step.time_s < state.run_s[0]
            if is_before and (interval_s > self.max_interval_s or prob <= self.min_edge_prob):
                break
            first, n_walking = i, n_walking + (prob > 0.5)
        return first, n_walking

    def _without_old(self, state: StepGateState) -> StepGateState:
        """State without the held steps that are too early for any bout to come."""
        begin_s = state.held[-1].step.time_s
        if not state.is_bout and begin_s - state.run_s[1] <= self.max_interval_s:
            begin_s = state.run_s[0]
        max_edge_s = self.max_edge_s * state.held[-1].slowness
        return replace_unchecked(state, held=tuple(j for j in state.held if begin_s - j.step.time_s <= max_edge_s))

    @property
    def _walking_share(self) -> float:
        return self.mean_walk_s / (self.mean_walk_s + self.mean_pause_s)

    def _change_probs(self, duration_s: float) -> tuple[float, float]:
        """Probability to walk no more, and to walk, after a time, of one who did, and of one who did not."""
        forgotten = -math.expm1(-duration_s * (1.0 / self.mean_walk_s + 1.0 / self.mean_pause_s))
        return forgotten * (1.0 - self._walking_share), forgotten * self._walking_share

    def _prob_after(self, prob: float, duration_s: float) -> float:
        """Probability of walking after a time without evidence."""
        leave, enter = self._change_probs(duration_s)
        return prob * (1.0 - leave) + (1.0 - prob) * enter

    def _ratio_before(self, ratio: float, duration_s: float) -> float:
        """Likelihood ratio of what comes, seen from earlier."""
        leave, enter = self._change_probs(duration_s)
        return ((1.0 - leave) * ratio + leave) / (enter * ratio + 1.0 - enter)


def _posterior(prob: float, ratio: float) -> float:
    return prob * ratio / (prob * ratio + 1.0 - prob)
