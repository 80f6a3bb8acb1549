"""Steps as local maxima of a wavelet transform whose scale follows the power of the motion: the default detector.

The strength of a motion tells its step frequency: people step faster where they step harder. Over 66 walks of 13
people with seven placements, 16 of another and 24 runs of twelve the frequency is

    f = 1.43 R^0.31,  R the rms of |specific force| around the step, m/s2, f in Hz,

with a deviation of 11 %, whoever walks and wherever the phone is (regression of log f on log R, tests/benchmarks/
steps.py); the Mexican hat is an octave wide. 1.37 R^0.3 is taken, a little lower: heel strike and push-off are one step
more surely. A frequency taken from the autocorrelation of the signal was worse: in a back pocket the stride repeats
better than the step, and half of the steps are lost.

1. R(t): standard deviation of the low-passed |f| from `before_s` before to `after_s` after t.
2. Response: transform of |f| with the Mexican hat of frequency 1.37 R(t)^0.3, interpolated between a bank of hats, each
   low-passed and cut off at `after_s`. It has unit gain at its frequency.
3. A local maximum is a step if it reaches `min_peak_mps2` and `relative_peak` of the last ones, and comes
   `min_interval` periods 1 / f or more after the last step. Where it comes when the rhythm of the last steps expects
   it, `rhythm_share` of both thresholds is enough: a weak step of one foot, and the last one of a walk, are kept.

What the parameters stand between, and what came out, is in docs/methods/steps.md. Source of the transform: Martinelli
et al. 2018, section IV (see `pdr_filter.papers.martinelli2018.steps`), which has one scale for everybody.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import firwin

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.detector import ModeBlock, StepLog, StepLogState, specific_force_magnitude
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2
from pdr_filter.values.step import Step

# Frequencies of the bank, a factor of 1.15 apart: 0.6 to 4.9 Hz. Power tells no lower and no higher ones.
_BANK_HZ: FloatArray = np.asarray(0.6 * 1.15 ** np.arange(16), dtype=float)
# A Hamming window of 0.25 s joins the two humps of one step and keeps the harmonics of the next.
_LOW_PASS_S = 0.25


@dataclass(frozen=True, slots=True)
class Rhythm:
    """The last steps of the bout."""

    peak_level_mps2: float  # running mean of their responses
    period_s: float  # running mean of their intervals
    n_intervals: int


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveDetectorState:
    """Filter memory and the last contact."""

    log: StepLogState
    n_samples: int  # that went through the transform
    delay_line: FloatArray  # (H,) |f| less gravity; empty at the start
    response: FloatArray  # (2, 2) last values of the transform, and of R
    rhythm: Rhythm


@dataclass(frozen=True)
class AdaptiveStepDetector:
    """Causal step detector; a step is reported `latency_s`, 0.88 s, after its contact.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    frequency_at_1_mps2_hz, frequency_exponent : float
        Step frequency where R is 1 m/s2, and its power of R; see the module.
    before_s, after_s : float
        What R is taken over: about three steps, the one in question in the middle. Twice as long mixes the end of a
        walk with the rest after it. `after_s` is also half the length of the longest hat.
    power_low_pass_hz, low_pass_hz : float
        Cutoffs (Hamming window, 0.25 s) before R and in the response.
    min_peak_mps2 : float
        Smallest response that is a step outside a rhythm.
    relative_peak : float
        A step must also reach this part of the running mean of the last responses.
    rhythm_share : float
        Part of both thresholds that a peak needs when it is expected.
    rhythm_tolerance : float
        It is expected if the logarithm of interval over period is within this, after two or more intervals.
    min_interval : float
        Smallest interval in periods of the wavelet. Heel strike and push-off are closer.
    min_running_interval : float
        The same from `running_hz` on: there a step is one blow, and R tells less of the frequency.
    running_hz : float
        Wavelet frequency of a run, or of the hardest walking (R = 3.5 m/s2).
    max_interval_s : float
        After a longer pause a new bout begins. The slowest steps, 0.5 Hz, are 2 s apart.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float = 100.0
    frequency_at_1_mps2_hz: float = 1.37
    frequency_exponent: float = 0.3
    before_s: float = 1.0
    after_s: float = 0.75
    power_low_pass_hz: float = 5.5
    low_pass_hz: float = 4.0
    min_peak_mps2: float = 0.2
    relative_peak: float = 0.15
    rhythm_share: float = 1 / 3
    rhythm_tolerance: float = 0.25
    min_interval: float = 0.6
    min_running_interval: float = 0.35
    running_hz: float = 2.0
    max_interval_s: float = 2.5
    first_step_s: float = 0.6

    @cached_property
    def _bank(self) -> tuple[FloatArray, ...]:
        return tuple(bounce_kernel(f, self.low_pass_hz, self.after_s, self.rate_hz) for f in _BANK_HZ)

    @cached_property
    def _bank_rms_mps2(self) -> FloatArray:
        """R at which each member of the bank responds alone."""
        return (_BANK_HZ / self.frequency_at_1_mps2_hz) ** (1.0 / self.frequency_exponent)

    @cached_property
    def _power_low_pass(self) -> FloatArray:
        return low_pass_kernel(self.power_low_pass_hz, self.rate_hz)

    @property
    def _n_before(self) -> int:
        """Samples before a contact that enter."""
        return round(self.before_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _n_after(self) -> int:
        """Samples after a contact that enter."""
        return round(self.after_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def latency_s(self) -> float:
        """Time from a contact to its detection."""
        return (self._n_after + 1) / self.rate_hz

    @cached_property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, self.max_interval_s, self.first_step_s)

    def init(self) -> AdaptiveDetectorState:
        """State before the first sample of a segment."""
        return AdaptiveDetectorState(self._log.init(), 0, np.empty(0), np.zeros((2, 2)), Rhythm(0.0, 0.0, 0))

    def step(
        self, state: AdaptiveDetectorState, block: UniformBlock, attitude: AttitudeBlock, modes: ModeBlock
    ) -> tuple[AdaptiveDetectorState, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        bounce = specific_force_magnitude(block.specific_force_mps2) - STANDARD_GRAVITY_MPS2
        state = replace(state, log=self._log.extend(state.log, block, attitude))
        if state.n_samples == 0:
            # What was before the first sample is taken to be like it: a zero there would look like a blow.
            state = replace(state, delay_line=np.full(self._n_before + self._n_after, bounce[0]))
        state, steps = self._detect(state, bounce)
        return replace(state, log=self._log.trim(state.log)), steps

    def finish(self, state: AdaptiveDetectorState) -> list[tuple[int, Step]]:
        """Steps in the last `latency_s` before a gap or the end, whose last value is taken to stay."""
        if state.n_samples == 0:
            return []
        end = state.n_samples
        last_s = self._log.time_s(state.log, end - 1)
        _, steps = self._detect(state, np.repeat(state.delay_line[-1:], self._n_after + 1))
        return [(end - 1, replace(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _detect(
        self, state: AdaptiveDetectorState, bounce: FloatArray
    ) -> tuple[AdaptiveDetectorState, list[tuple[int, Step]]]:
        """Detect in further samples of |f| less gravity."""
        line = np.concatenate([state.delay_line, bounce])
        rms = self._rms(line)
        response = np.concatenate([state.response, np.stack([self._response(line, rms), rms])], axis=1)
        peak = response[0]
        middle = peak[1:-1]
        lowest = self.rhythm_share * self.min_peak_mps2
        is_peak = (middle > peak[:-2]) & (middle >= peak[2:]) & (middle >= lowest)
        n_before = state.n_samples
        steps: list[tuple[int, Step]] = []
        for i in np.flatnonzero(is_peak):
            known = n_before + int(i)  # the sample that made peak[i + 2]
            state, step = self._accept(state, peak[i : i + 3], float(response[1, i + 1]), known)
            if step is not None:
                steps.append((known, step))
        return (
            replace(
                state,
                n_samples=n_before + len(bounce),
                delay_line=line[len(bounce) :],
                response=response[:, -2:],
            ),
            steps,
        )

    # Every value below is a dot product of the kernel's length, so cutting the signal elsewhere changes no bit.

    def _rms(self, line: FloatArray) -> FloatArray:
        """R at each sample that has enough samples around it."""
        smooth = np.convolve(line, self._power_low_pass, mode="valid")
        n = round(self.before_s * self.rate_hz) + round(self.after_s * self.rate_hz) + 1
        box = np.full(n, 1.0 / n)
        mean = np.convolve(smooth, box, mode="valid")
        return np.sqrt(np.maximum(np.convolve(smooth * smooth, box, mode="valid") - mean * mean, 0.0))

    def _response(self, line: FloatArray, rms: FloatArray) -> FloatArray:
        """Transform at the scale that R asks for, between two members of the bank."""
        place = np.interp(rms, self._bank_rms_mps2, np.arange(len(_BANK_HZ), dtype=float))
        lower = np.minimum(place.astype(int), len(_BANK_HZ) - 2)
        upper_share = place - lower
        response: FloatArray = np.zeros(len(rms))
        for k in np.unique(np.concatenate([lower, lower + 1])):
            kernel = self._bank[k]
            half = len(kernel) // 2
            first = self._n_before - half
            part = line[first : first + len(rms) + 2 * half]
            share: FloatArray = np.where(lower == k, 1.0 - upper_share, np.where(lower == k - 1, upper_share, 0.0))
            response = np.add(response, share * np.convolve(part, kernel, mode="valid"), dtype=float)
        return response

    def _accept(
        self, state: AdaptiveDetectorState, peak: FloatArray, rms: float, known: int
    ) -> tuple[AdaptiveDetectorState, Step | None]:
        """The step that a local maximum of the response makes, if it makes one."""
        contact = known - 1 - self._n_after
        if contact <= max(self._log.first_sample(state.log), 0) or contact >= state.log.n_samples:
            return state, None
        # vertex of the parabola through the three values: contact times finer than the sampling interval
        curvature = peak[0] - 2 * peak[1] + peak[2]
        fraction = float(0.5 * (peak[0] - peak[2]) / curvature) if curvature < 0 else 0.0
        contact_s = self._log.time_s(state.log, contact) + fraction / self.rate_hz
        new_bout = self._log.starts_bout(state.log, contact_s)
        rhythm = Rhythm(0.0, 0.0, 0) if new_bout else state.rhythm
        interval_s = contact_s - state.log.last_contact_s
        share = self.rhythm_share if self._is_expected(rhythm, interval_s) else 1.0
        if peak[1] < share * max(self.min_peak_mps2, self.relative_peak * rhythm.peak_level_mps2):
            return state, None
        if interval_s < self._min_interval_s(rms):
            return state, None
        log, step = self._log.add(state.log, contact, known, fraction)
        return replace(state, log=log, rhythm=_with_step(rhythm, float(peak[1]), interval_s, new_bout)), step

    def _is_expected(self, rhythm: Rhythm, interval_s: float) -> bool:
        if rhythm.n_intervals < 2 or interval_s <= 0:
            return False
        return abs(math.log(interval_s / rhythm.period_s)) < self.rhythm_tolerance

    def _min_interval_s(self, rms: float) -> float:
        frequency_hz = self.frequency_at_1_mps2_hz * rms**self.frequency_exponent
        frequency_hz = min(max(frequency_hz, _BANK_HZ[0]), _BANK_HZ[-1])
        periods = self.min_running_interval if frequency_hz >= self.running_hz else self.min_interval
        return periods / frequency_hz


def _with_step(rhythm: Rhythm, peak_mps2: float, interval_s: float, new_bout: bool) -> Rhythm:
    if new_bout:
        return Rhythm(peak_mps2, 0.0, 0)
    period_s = 0.7 * rhythm.period_s + 0.3 * interval_s if rhythm.n_intervals else interval_s
    return Rhythm(0.7 * rhythm.peak_level_mps2 + 0.3 * peak_mps2, period_s, rhythm.n_intervals + 1)


def low_pass_kernel(cutoff_hz: float, rate_hz: float) -> FloatArray:
    """Low-pass of 0.25 s: symmetric, odd length, unit gain at rest."""
    n_taps = 2 * round(0.5 * _LOW_PASS_S * rate_hz) + 1
    return np.asarray(firwin(n_taps, min(cutoff_hz, 0.45 * rate_hz), fs=rate_hz), dtype=float)


def bounce_kernel(frequency_hz: float, low_pass_hz: float, max_half_s: float, rate_hz: float) -> FloatArray:
    """Low-passed Mexican hat: symmetric, odd length, zero mean, unit gain at its frequency.

    The hat (1 - u^2) exp(-u^2 / 2), u = t / s, has s = 1 / (4 f), a quarter of a step, and ends at 3.5 s (1 % of its
    peak is left there) or at `max_half_s`.
    """
    half = round(min(3.5 * 0.25 / frequency_hz, max_half_s) * rate_hz)
    kernel = np.convolve(_hat(0.25 / frequency_hz, half, rate_hz), low_pass_kernel(low_pass_hz, rate_hz))
    return _with_unit_gain(kernel, frequency_hz, rate_hz)


def _with_unit_gain(kernel: FloatArray, frequency_hz: float, rate_hz: float) -> FloatArray:
    offset_s = (np.arange(len(kernel)) - len(kernel) // 2) / rate_hz
    return np.asarray(kernel / np.sum(kernel * np.cos(2 * np.pi * frequency_hz * offset_s)))


def _hat(scale_s: float, half: int, rate_hz: float) -> FloatArray:
    """Mexican hat with so many samples on each side, less its mean."""
    u = np.arange(-half, half + 1) / (rate_hz * scale_s)
    hat = (1.0 - u * u) * np.exp(-0.5 * u * u)
    return np.asarray(hat - hat.mean(), dtype=float)
