"""Steps of somebody who walks, without those of a phone that is handled: a causal gate behind the step detector.

The gate holds each step until its fate is known and lets it pass, with its own contact time, where somebody walks. It
needs the specific force alone: neither gyroscope nor attitude, no model, no carrying mode.

1. Evidence of each step, from the specific force around its contact and the contacts before it (`evidence_features`).
   Of its log odds of walking `evidence_weight` counts, because the windows of neighbouring steps overlap. The clock of
   the evidence runs with the steps: `slowness` stretches its times for a slow walker.
2. Smoothing. Walking and not walking are the two states of a Markov chain in continuous time, observed at the contacts
   (Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77, 1989, eqs. 20 and 25). A step is accepted if walking
   is more probable than not, from its own evidence and all before.
3. Bouts. Every accepted step corrects the ones before it by the evidence after them (backward recursion). `min_steps`
   of them that are walking are a bout and leave together, later ones leave at once; fewer are dropped.
4. Edges. A step before the first accepted one belongs to the bout if walking is not improbable, and so do up to
   `n_fill` more, close by. A refused step between two accepted ones of a bout belongs to it.

tests/benchmarks/step_gate.py fits the weights; docs/methods/steps.md has data, figures and limits.
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
from pdr_filter.values import FloatArray, Step, check_numbers, read_only, replace

# Rate at which the evidence looks at the force: steps are below 5 Hz.
_EVIDENCE_HZ = 25.0
# A step may become known so long after its contact and still find its window whole.
_MAX_KNOWN_AFTER_S = 4.0
# A window with fewer rows (1 s) is no evidence: it holds no two steps.
_MIN_ROWS = 26
# Longest interval of a usual walk, 1.67 steps a second: below that the times of the evidence are stretched.
_USUAL_INTERVAL_S = 0.6
# The slowest walk to which they follow, 0.76 steps a second: more of the past would have to be remembered.
_MAX_SLOWNESS = 2.2
# Longest lag at which a motion is looked for again; of slow walkers as many steps, a stride and a quarter.
_MAX_LAG_S = 2.24
_MAX_LAG_STEPS = 2.5
# Standard deviations at which a feature is cut, in the fit too: no single feature can outvote the others.
_LIMIT = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class WalkEvidence:
    """Log odds of walking from the features of `evidence_features`: b + sum_i w_i clip((x_i - m_i) / s_i, -3, 3)."""

    mean: FloatArray  # (4,) m
    scale: FloatArray  # (4,) s
    weight: FloatArray  # (4,) w
    intercept: float  # b

    def __post_init__(self) -> None:
        check_numbers(self, signed=("intercept",))
        for name in ("mean", "scale", "weight"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def log_odds(self, features: Sequence[float]) -> float:
        """Log odds of walking of one step."""
        total = self.intercept
        for x, m, s, w in zip(features, self.mean.tolist(), self.scale.tolist(), self.weight.tolist(), strict=True):
            total += w * min(max((x - m) / s, -_LIMIT), _LIMIT)
        return total


# In the order of `evidence_features`; see the module's docstring. Walking and not walking had the same mass.
EVIDENCE = WalkEvidence(
    mean=np.array([0.40, 0.25, -0.60, 0.55]),
    scale=np.array([0.37, 0.21, 0.96, 0.27]),
    weight=np.array([2.81, -1.92, -1.89, 2.04]),
    intercept=1.42,
)


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

    def fits(self, n_samples: int) -> bool:
        """Whether a segment of so many samples can leave this."""
        return self.n_samples == n_samples and all(number < n_samples for number, _ in self.waiting)


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
        if self.rate_hz % _EVIDENCE_HZ:
            raise ValueError(f"rate_hz must be a multiple of {_EVIDENCE_HZ:g}, got {self.rate_hz}")

    @cached_property
    def _samples_per_row(self) -> int:
        return round(self.rate_hz / _EVIDENCE_HZ)

    @cached_property
    def _n_before(self) -> int:
        return round(self.before_s * _EVIDENCE_HZ)

    @cached_property
    def _n_after(self) -> int:
        return round(self.after_s * _EVIDENCE_HZ)

    @cached_property
    def _n_rows_kept(self) -> int:
        return round(_MAX_SLOWNESS * self._n_before) + self._n_after + round(_MAX_KNOWN_AFTER_S * _EVIDENCE_HZ)

    @property
    def latency_s(self) -> float:
        """Time from a contact to its step in a bout, unless the detector takes longer."""
        return (self._n_after + 1) / _EVIDENCE_HZ

    def init(self) -> StepGateState:
        """State before the first sample."""
        return StepGateState(self._walking_share)

    def step(
        self, state: StepGateState, block: UniformBlock, attitude: AttitudeBlock, steps: Sequence[tuple[int, Step]]
    ) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """New state and the steps that pass, each with the number of the sample that decided.

        `steps` are what the detector found in this block, in order; the attitude is not looked at.
        """
        samples = np.concatenate([state.rest, block.specific_force_mps2])
        n = self._samples_per_row
        whole = samples[: len(samples) // n * n]
        state = replace(
            state,
            start_s=float(block.time_s[0]) if state.n_samples == 0 else state.start_s,
            n_samples=state.n_samples + len(block.time_s),
            rest=samples[len(whole) :],
            # summed one after the other: the same bits however the samples came
            rows=np.concatenate([state.rows, sum((whole[i::n] for i in range(1, n)), whole[0::n]) / n]),
            waiting=(*state.waiting, *steps),
        )
        released: list[tuple[int, Step]] = []
        while state.waiting:
            number = max(state.waiting[0][0], (self._row(state, state.waiting[0][1]) + self._n_after + 1) * n - 1)
            if number >= state.n_samples:
                break
            state, passed = self._judge(state, number)
            released += passed
        return replace(state, rows=state.rows[-self._n_rows_kept :]), released

    def close(
        self, state: StepGateState, steps: Sequence[tuple[int, Step]]
    ) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """State before the first sample after a gap or the end, and the steps that pass of those that still waited.

        `steps` are what the detector's `finish` gave. A bout goes on after a short gap, the belief in walking fades
        with time.
        """
        state = replace(state, waiting=(*state.waiting, *steps))
        released: list[tuple[int, Step]] = []
        while state.waiting:
            state, passed = self._judge(state, state.n_samples - 1)
            released += passed
        # Steps that are no bout yet are given up: what the gap holds is unknown.
        after = StepGateState(state.walking_prob, state.judged_s)
        return (replace(after, run_s=state.run_s, is_bout=True) if state.is_bout else after), released

    def _row(self, state: StepGateState, step: Step) -> int:
        """Number of the row that a contact is in."""
        return max(math.floor((step.time_s - state.start_s) * _EVIDENCE_HZ), 0)

    def _judge(self, state: StepGateState, number: int) -> tuple[StepGateState, list[tuple[int, Step]]]:
        """The evidence of the step that has waited longest, and the steps that pass with it."""
        step = state.waiting[0][1]
        contacts_s = (*state.contacts_s[-3:], step.time_s)
        intervals_s = [b - a for a, b in pairwise(contacts_s) if 0.0 < b - a < self.max_interval_s]
        window = self._window(state, self._row(state, step), number, slowness(intervals_s))
        log_odds = 0.0
        if len(window) >= _MIN_ROWS:
            log_odds = self.evidence.log_odds(evidence_features(window, intervals_s))
        log_ratio = min(max(self.evidence_weight * log_odds, -self.max_log_ratio), self.max_log_ratio)
        ratio = math.exp(log_ratio)
        before = self._prob_after(state.walking_prob, step.time_s - state.judged_s)
        prob = _posterior(before, ratio)
        now_s = state.start_s + number / self.rate_hz
        state = replace(
            state,
            waiting=state.waiting[1:],
            contacts_s=contacts_s,
            walking_prob=prob,
            judged_s=step.time_s,
            held=(*state.held, JudgedStep(step, prob, ratio, slowness(intervals_s))),
        )
        state, passed = self._accept(state, step.time_s) if prob > 0.5 else (self._without_old(state), [])
        return state, [(number, replace(s, detected_time_s=max(now_s, s.detected_time_s))) for s in passed]

    def _window(self, state: StepGateState, row: int, number: int, stretch: float) -> FloatArray:
        """Rows around a row; the same however many are remembered."""
        n_rows = (state.n_samples - len(state.rest)) // self._samples_per_row
        n_seen = (number + 1) // self._samples_per_row
        first = max(row - round(stretch * self._n_before), n_seen - self._n_rows_kept, 0)
        last = min(row + self._n_after + 1, n_seen)
        oldest = n_rows - len(state.rows)
        return np.ascontiguousarray(state.rows[max(first - oldest, 0) : max(last - oldest, 0)])

    def _accept(self, state: StepGateState, contact_s: float) -> tuple[StepGateState, list[Step]]:
        """The last judged step is walking: it leaves if it belongs to a bout, or makes one."""
        continues = contact_s - state.run_s[1] <= self.max_interval_s
        run_s = (state.run_s[0] if continues else contact_s, contact_s)
        state = replace(state, run_s=run_s, is_bout=continues and state.is_bout)
        if state.is_bout:
            return replace(state, held=()), [judged.step for judged in state.held]
        first, n_walking = self._run(state)
        if n_walking < self.min_steps:
            return self._without_old(state), []
        for _ in range(self.n_fill):
            interval_s = state.held[first].step.time_s - state.held[first - 1].step.time_s
            first -= first > 0 and interval_s <= self.fill_interval_s * state.held[-1].slowness
        return replace(state, held=(), is_bout=True), [judged.step for judged in state.held[first:]]

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
        return replace(state, held=tuple(j for j in state.held if begin_s - j.step.time_s <= max_edge_s))

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


def slowness(intervals_s: Sequence[float]) -> float:
    """Median step interval in longest intervals of a usual walk, 1 to 2.2; 1 where none is known."""
    if not intervals_s:
        return 1.0
    return min(max(sorted(intervals_s)[len(intervals_s) // 2] / _USUAL_INTERVAL_S, 1.0), _MAX_SLOWNESS)


def evidence_features(force_mps2: FloatArray, intervals_s: Sequence[float]) -> tuple[float, float, float, float]:
    """The features of one step in which walking and handling differ.

    From the specific force around the contact at 25 Hz, (N, 3), N >= 26, and up to three step intervals before it: how
    much the force repeats with its direction (the autocorrelation's highest value after it was negative), how uneven
    the rhythm is (standard deviation of the logarithm of three intervals), how far the phone turns for how little it
    bounces (log of the rms of the force averaged over 0.76 s, over that of its magnitude), and how much the magnitude
    repeats.

    A walk that is c times as slow, c the `slowness`, is averaged c times as long and looked for again at lags of a
    stride. Its bounce counts c times as much: acceleration falls with c^2 while the tilt of the phone stays. With all
    of c^2 a phone that is wagged slowly passes as a walk.
    """
    stretch = slowness(intervals_s)
    x, y, z = force_mps2.T
    magnitude = np.sqrt(x * x + y * y + z * z)
    bounce_mps2 = (float(magnitude.std()) + 0.02) * stretch
    n_box = min(2 * round(9 * stretch) + 1, len(x) - 1)
    box = np.full(n_box, 1.0 / n_box)
    slow = np.array([np.convolve(c, box, mode="valid") for c in np.ascontiguousarray(force_mps2.T)])
    # fewer than three intervals keep no rhythm: as uneven as handling
    unevenness = float(np.std(np.log(intervals_s))) if len(intervals_s) > 2 else 0.5
    max_lag_s = max(_MAX_LAG_S, _MAX_LAG_STEPS * _USUAL_INTERVAL_S * stretch)
    return (
        repetition(force_mps2, max_lag_s),
        unevenness,
        math.log((math.sqrt(sum(slow.var(axis=1).tolist())) + 0.05) / bounce_mps2),
        repetition(magnitude[:, None], max_lag_s),
    )


def repetition(signal: FloatArray, max_lag_s: float = _MAX_LAG_S) -> float:
    """Highest autocorrelation of (N, d) after it was negative, 0 to 1; 0 if it never was.

    r(l) = sum x(t) . x(t + l) / sqrt(sum |x(t)|^2 sum |x(t + l)|^2) over the samples that both have, of the signal less
    its mean, at 25 Hz and up to a lag: a stride of a usual walk and more.
    """
    centred = signal - signal.mean(axis=0)
    n = len(centred)
    n_lags = min(round(max_lag_s * _EVIDENCE_HZ) + 1, n - 11)
    columns = [np.ascontiguousarray(c) for c in centred.T]
    product = sum((np.correlate(c, c, mode="full")[n - 1 : n - 1 + n_lags] for c in columns), np.zeros(n_lags))
    energy = np.concatenate([[0.0], np.add.accumulate((centred * centred).sum(axis=1))])
    # of the samples up to each lag before the end, and from each lag on
    correlation = product / np.sqrt(energy[: n - n_lags : -1] * (energy[n] - energy[:n_lags]) + 1e-6)
    negative = np.flatnonzero(correlation < 0)
    return max(0.0, float(correlation[negative[0] :].max())) if len(negative) else 0.0


def _posterior(prob: float, ratio: float) -> float:
    return prob * ratio / (prob * ratio + 1.0 - prob)
