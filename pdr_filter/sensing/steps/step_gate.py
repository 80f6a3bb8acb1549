"""Causal gate behind the step detector that rejects steps caused by handling the phone.

The gate holds each step until it is decided. Accepted steps pass with their own contact times. The gate needs only the
specific force: neither gyroscope nor attitude, no context model, no carrying mode.

1. Evidence. The evidence of each step comes from the specific force around its contact and the contacts before it
   (`walking_evidence`). Its log odds of walking are multiplied by `evidence_weight`, because the windows of
   neighbouring steps overlap. For slow walkers the time scales are stretched by `slowness`.
2. Smoothing. Walking and not walking are the two states of a Markov chain in continuous time, observed at the contacts
   (Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 1989, eqs. 20 and 25). A step is accepted if walking
   is more probable than not, given its own evidence and all evidence before.
3. Bouts. Each accepted step updates the probabilities of the steps before it (backward recursion). `min_steps` steps
   that are probably walking form a bout and are released together. Later steps of the bout are released at once. Fewer
   steps are dropped.
4. Edges. A step before the first accepted step belongs to the bout if its probability of walking is above
   `min_edge_prob`. Up to `n_fill` further steps close to it belong to the bout as well. A rejected step between two
   accepted ones of a bout belongs to it.

The steps of a block are judged together. docs/methods/steps.md has the limits, docs/benchmarks/motion.md figures.

A gate that uses the tilt of the phone from the gyroscope, and was also fitted to slowed walks, lowers the count error
of short bouts at 0.3 to 1 m/s (mobgap) from 31 to 23 %. It accepts more false steps of busy hands before a walk, which
raises the smoothed shape error of ipin2023 from 0.93 to 1.22 m. At equal false steps it has 31 % again and is therefore
not used.
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
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.sensing.steps.step_stage import StepStage
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

# Longest delay between a contact and its detection, in s, for which the window of the evidence is still buffered.
_MAX_KNOWN_AFTER_S = 4.0


@dataclass(frozen=True, slots=True)
class JudgedStep:
    """A step with its evidence."""

    step: Step
    walking_prob: float  # probability of walking at its contact, given its evidence and all evidence before
    ratio: float  # likelihood ratio of its evidence, walking to not walking
    slowness: float  # slowness of the steps up to this one


@dataclass(frozen=True, eq=False)
class StepGateState:
    """Probability of walking, recent specific force, and undecided steps."""

    walking_prob: float  # probability of walking after the last judged step
    judged_s: float = -math.inf  # contact time of the last judged step, s
    start_s: float = math.nan  # time of the first sample of the segment, s
    n_samples: int = 0  # samples of the segment
    # (r, 3) specific force of the samples of the incomplete row, m/s2.
    rest: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    # (R, 3) recent rows of specific force averaged to 25 Hz, m/s2.
    rows: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    # Steps whose window is not complete, each with the number of the sample that revealed it.
    waiting: tuple[tuple[int, Step], ...] = ()
    contacts_s: tuple[float, ...] = ()  # last four judged contacts of the segment, s
    held: tuple[JudgedStep, ...] = ()  # judged steps that are not released and may still belong to a bout
    # First and last contact of the current run of accepted steps without a pause, s.
    run_s: tuple[float, float] = (-math.inf, -math.inf)
    is_bout: bool = False  # True if this run is long enough to be a bout

    @property
    def candidates(self) -> tuple[Step, ...]:
        """Detected steps that are not accepted yet; none while walking is improbable."""
        if not (self.is_bout or self.walking_prob > 0.5):
            return ()
        return (*(judged.step for judged in self.held), *(step for _, step in self.waiting))


@dataclass(frozen=True)
class StepGate(StepStage[StepGateState]):
    """Causal gate that rejects false steps.

    Within a bout a step passes `latency_s` (1.04 s) after its contact, or as soon as the detector reveals it. The first
    steps of a bout pass together with the one that completes `min_steps`. The first step therefore waits three step
    intervals longer: 2.7 s at 1.8 steps a second, and longer if the evidence is weak. A gap or the end of the recording
    decides all waiting steps at once.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz, a multiple of 25 Hz.
    evidence : WalkEvidence, default `EVIDENCE`
        Model of the log odds of walking.
    before_s, after_s : float, default 2.5 and 1
        Window of the evidence before and after a contact, s. Four steps of a normal walk fit into the part before the
        contact, which is multiplied by `slowness` for a slow walk. The part after it shows the end of a walk.
    evidence_weight : float, default 0.4
        Power of the likelihood of one step. A smaller value loses fewer steps but lets more handling pass.
    max_log_ratio : float, default 4
        Largest absolute log likelihood ratio of one step.
    mean_walk_s, mean_pause_s : float, default 40 and 13
        Mean durations of walking and of not walking in the Markov chain, s.
    min_steps : int, default 4
        Fewest steps of a bout. Five instead of four halve the false steps and delay the first step by another half
        second.
    max_interval_s : float, default 2.5
        A new bout begins after a longer time without accepted steps, s. The slowest steps are 2 s apart.
    min_edge_prob : float, default 0.2
        Smallest probability of walking, including the evidence after the step, for a step before a bout to belong to
        it.
    max_edge_s : float, default 3
        Longest time of such a step before the bout, s, multiplied by `slowness`.
    n_fill : int, default 2
        Largest number of further rejected steps that are added to the beginning of a bout.
    fill_interval_s : float, default 1.5
        Longest interval between such steps, s, multiplied by `slowness`.

    Raises
    ------
    ValueError
        If a parameter is not positive, or `rate_hz` is not a multiple of 25 Hz.

    Examples
    --------
    The gate passes the steps of a simulated walk. A front end without it reports the same steps earlier:

    >>> from dataclasses import replace
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.simulate([pdr.simulate.Leg("walking", duration_s=8.0)])
    >>> config = pdr.recipes.default()
    >>> ungated = replace(config, sensing=replace(config.sensing, gate=None))
    >>> gated_steps, steps = pdr.detect_steps(recording, config), pdr.detect_steps(recording, ungated)
    >>> bool(gated_steps[0].detected_time_s > steps[0].detected_time_s)
    True
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
            raise ValueError(
                f"rate_hz must be a multiple of {EVIDENCE_HZ:g}, got {self.rate_hz}: set the rate of all stages, for "
                "example to 100"
            )

    @cached_property
    def _samples_per_row(self) -> int:
        """Number of samples that are averaged to one row of the evidence."""
        return round(self.rate_hz / EVIDENCE_HZ)

    @cached_property
    def _n_before(self) -> int:
        """Number of rows of a window before the contact, at normal walking."""
        return round(self.before_s * EVIDENCE_HZ)

    @cached_property
    def _n_after(self) -> int:
        """Number of rows of a window after the contact."""
        return round(self.after_s * EVIDENCE_HZ)

    @cached_property
    def _n_rows_kept(self) -> int:
        """Number of buffered rows: the longest window and the longest delay of a step."""
        return round(MAX_SLOWNESS * self._n_before) + self._n_after + round(_MAX_KNOWN_AFTER_S * EVIDENCE_HZ)

    @property
    def latency_s(self) -> float:
        """Time from a contact to the release of its step within a bout, s, unless the detector takes longer."""
        return (self._n_after + 1) / EVIDENCE_HZ

    def init(self) -> StepGateState:
        return StepGateState(self._walking_share)

    def update(
        self,
        state: StepGateState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: NumberedSteps,
    ) -> tuple[StepGateState, NumberedSteps]:
        samples = np.concatenate([state.rest, block.specific_force_mps2])
        n = self._samples_per_row
        whole = samples[: len(samples) // n * n]
        state = replace_unchecked(
            state,
            start_s=float(block.time_s[0]) if state.n_samples == 0 else state.start_s,
            n_samples=state.n_samples + len(block.time_s),
            rest=samples[len(whole) :],
            # samples are added one after the other, so that the bits do not depend on how blocks are cut
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

    def trimmed(self, state: StepGateState, contact_s: float) -> tuple[StepGateState, tuple[float, ...]]:
        """Return the state without samples that no later window needs, and the contacts of the undecided steps.

        Parameters
        ----------
        state : StepGateState
            State after any number of samples.
        contact_s : float
            Earliest contact that the detector can still find, s.

        Returns
        -------
        state : StepGateState
            State with fewer rows of specific force.
        contacts_s : tuple of float
            Contacts of the steps that the gate can still release, in order of time, s. A release has a step and all
            later ones.
        """
        waiting_s = [step.time_s for _, step in state.waiting]
        contact_s = min(waiting_s, default=contact_s)
        first = math.floor((contact_s - state.start_s) * EVIDENCE_HZ)
        n_rows = (state.n_samples - len(state.rest)) // self._samples_per_row
        n_needed = max(n_rows - first + round(MAX_SLOWNESS * self._n_before), 1)
        first_s = self._first_releasable_s(state, contact_s)
        held_s = [judged.step.time_s for judged in state.held if judged.step.time_s >= first_s]
        return replace_unchecked(state, rows=state.rows[-n_needed:]), (*held_s, *waiting_s)

    def _first_releasable_s(self, state: StepGateState, contact_s: float) -> float:
        """Return the earliest contact of a step that may be released when a step at `contact_s` or later is judged."""
        if contact_s - state.run_s[1] <= self.max_interval_s:
            return min((judged.step.time_s for judged in state.held), default=contact_s)
        # A bout begins after a pause, so that no held step before a pause belongs to it.
        pause_s = max(self.max_interval_s, self.fill_interval_s * MAX_SLOWNESS)
        for judged in reversed(state.held):
            if contact_s - judged.step.time_s > pause_s:
                break
            contact_s = judged.step.time_s
        return contact_s

    def finish(self, state: StepGateState, steps: NumberedSteps) -> tuple[StepGateState, NumberedSteps]:
        # A bout continues after a short gap. The probability of walking decays towards its stationary value with time.
        state = replace_unchecked(state, waiting=(*state.waiting, *steps))
        state, released = self._judge(state, [state.n_samples - 1] * len(state.waiting))
        # Steps that do not form a bout yet are dropped, because a gap gives no evidence for more steps.
        after = StepGateState(state.walking_prob, state.judged_s)
        return (replace_unchecked(after, run_s=state.run_s, is_bout=True) if state.is_bout else after), released

    def _row(self, state: StepGateState, step: Step) -> int:
        """Return the number of the row (specific force averaged to 25 Hz) that contains the contact of a step."""
        return max(math.floor((step.time_s - state.start_s) * EVIDENCE_HZ), 0)

    def _judge(self, state: StepGateState, numbers: Sequence[int]) -> tuple[StepGateState, NumberedSteps]:
        """Return the state and the released steps after judging the steps that have waited longest.

        `numbers` are the numbers of the samples at which these steps are judged, one for each step.
        """
        if not numbers:
            return state, []
        steps = [step for _, step in state.waiting[: len(numbers)]]
        contacts_s = (*state.contacts_s, *(step.time_s for step in steps))
        intervals_s = [self._intervals_s(contacts_s[: i + 1]) for i in range(len(state.contacts_s), len(contacts_s))]
        state = replace_unchecked(state, waiting=state.waiting[len(numbers) :], contacts_s=contacts_s[-4:])
        released: NumberedSteps = []
        log_odds = self._log_odds(state, steps, numbers, intervals_s)
        for step, number, step_log_odds, intervals in zip(steps, numbers, log_odds, intervals_s, strict=True):
            log_ratio = self.evidence_weight * step_log_odds
            ratio = math.exp(min(max(log_ratio, -self.max_log_ratio), self.max_log_ratio))
            prob = _posterior_prob(self._prob_after(state.walking_prob, step.time_s - state.judged_s), ratio)
            held = (*state.held, JudgedStep(step, prob, ratio, slowness(intervals)))
            state = replace_unchecked(state, walking_prob=prob, judged_s=step.time_s, held=held)
            state, passed = self._accept(state, step.time_s) if prob > 0.5 else (self._without_expired(state), [])
            now_s = state.start_s + number / self.rate_hz
            released += [(number, replace_unchecked(s, detected_time_s=max(now_s, s.detected_time_s))) for s in passed]
        return state, released

    def _intervals_s(self, contacts_s: Sequence[float]) -> list[float]:
        """Return up to three step intervals before the last contact, s, without pauses."""
        return [b - a for a, b in pairwise(contacts_s[-4:]) if 0.0 < b - a < self.max_interval_s]

    def _log_odds(
        self, state: StepGateState, steps: Sequence[Step], numbers: Sequence[int], intervals_s: Sequence[list[float]]
    ) -> list[float]:
        """Return the log odds of walking of each step given its own evidence; 0 if its window is too short."""
        around = zip((self._row(state, step) for step in steps), numbers, map(slowness, intervals_s), strict=True)
        windows = [self._window(state, *arguments) for arguments in around]
        usable = [i for i, window in enumerate(windows) if len(window) >= MIN_ROWS]
        log_odds = np.zeros(len(steps))
        if usable:
            features = evidence_features([windows[i] for i in usable], [intervals_s[i] for i in usable])
            log_odds[usable] = self.evidence.log_odds(features)
        return log_odds.tolist()

    def _window(self, state: StepGateState, row: int, number: int, stretch: float) -> FloatArray:
        """Return the rows of specific force (N, 3) of the window around row number `row`, as known at sample `number`.

        `stretch` multiplies the length of the part before the contact. The result does not depend on how many rows are
        still buffered.
        """
        n_rows = (state.n_samples - len(state.rest)) // self._samples_per_row
        n_seen = (number + 1) // self._samples_per_row
        first = max(row - round(stretch * self._n_before), n_seen - self._n_rows_kept, 0)
        last = min(row + self._n_after + 1, n_seen)
        oldest = n_rows - len(state.rows)
        return state.rows[max(first - oldest, 0) : max(last - oldest, 0)]

    def _accept(self, state: StepGateState, contact_s: float) -> tuple[StepGateState, list[Step]]:
        """Return the state and the released steps when the last judged step is walking.

        If the step continues a bout, it is released with the held steps before it. If it completes a new bout, all
        steps of that bout are released, with up to `n_fill` held steps before them.
        """
        continues = contact_s - state.run_s[1] <= self.max_interval_s
        run_s = (state.run_s[0] if continues else contact_s, contact_s)
        if continues and state.is_bout:
            return replace_unchecked(state, run_s=run_s, held=()), [judged.step for judged in state.held]
        state = replace_unchecked(state, run_s=run_s, is_bout=False)
        first, n_walking = self._run(state)
        if n_walking < self.min_steps:
            return self._without_expired(state), []
        for _ in range(self.n_fill):
            interval_s = state.held[first].step.time_s - state.held[first - 1].step.time_s
            first -= first > 0 and interval_s <= self.fill_interval_s * state.held[-1].slowness
        return replace_unchecked(state, held=(), is_bout=True), [judged.step for judged in state.held[first:]]

    def _run(self, state: StepGateState) -> tuple[int, int]:
        """Return the index of the first held step of the current run, and the number of walking steps from there on.

        Held steps before the run belong to its edge if their probability of walking is high enough. The probabilities
        are updated by the evidence after each step (backward recursion).
        """
        first, n_walking, ratio = len(state.held) - 1, 1, 1.0
        for i in range(len(state.held) - 2, -1, -1):
            earlier, later = state.held[i], state.held[i + 1]
            interval_s = later.step.time_s - earlier.step.time_s
            ratio = self._ratio_before(ratio * later.ratio, interval_s)
            prob = _posterior_prob(earlier.walking_prob, ratio)
            is_before = earlier.step.time_s < state.run_s[0]
            if is_before and (interval_s > self.max_interval_s or prob <= self.min_edge_prob):
                break
            first, n_walking = i, n_walking + (prob > 0.5)
        return first, n_walking

    def _without_expired(self, state: StepGateState) -> StepGateState:
        """Return the state without undecided steps that are too early to belong to a future bout."""
        begin_s = state.held[-1].step.time_s
        if not state.is_bout and begin_s - state.run_s[1] <= self.max_interval_s:
            begin_s = state.run_s[0]
        max_edge_s = self.max_edge_s * state.held[-1].slowness
        return replace_unchecked(state, held=tuple(j for j in state.held if begin_s - j.step.time_s <= max_edge_s))

    @property
    def _walking_share(self) -> float:
        """Long-term share of time spent walking: the stationary distribution of the chain of walking and pauses."""
        return self.mean_walk_s / (self.mean_walk_s + self.mean_pause_s)

    def _change_probs(self, duration_s: float) -> tuple[float, float]:
        """Return two probabilities for the end of a time: that a walker has stopped, and that a non-walker walks."""
        mixed = -math.expm1(-duration_s * (1.0 / self.mean_walk_s + 1.0 / self.mean_pause_s))
        return mixed * (1.0 - self._walking_share), mixed * self._walking_share

    def _prob_after(self, prob: float, duration_s: float) -> float:
        """Return the probability of walking after a time without evidence."""
        leave, enter = self._change_probs(duration_s)
        return prob * (1.0 - leave) + (1.0 - prob) * enter

    def _ratio_before(self, ratio: float, duration_s: float) -> float:
        """Return the likelihood ratio of later evidence, propagated back over a time to an earlier step."""
        leave, enter = self._change_probs(duration_s)
        return ((1.0 - leave) * ratio + leave) / (enter * ratio + 1.0 - enter)


def _posterior_prob(prob: float, ratio: float) -> float:
    """Return the posterior probability for a prior probability and a likelihood ratio."""
    return prob * ratio / (prob * ratio + 1.0 - prob)
