"""Step detector of Zhou et al. 2019, section IV: crossings of adaptive reference lines.

The acceleration a = |f| - g is low-passed with a cutoff that depends on the behaviour (stage 1). Its dominant frequency
f_D defines a window of one period (eq. 5, stage 2). The extrema in the window (eq. 6, stage 3) define the reference
lines R_L, R_M and R_S (Table 2). An event lasts from the first rise through R_M to the next fall through R_S (stage 4).
Events during standing and irregular swing are held, and count only if the behaviour turns out to be walking or running.

An event of the paper is a stride of the instrumented foot, that is, two steps. A phone elsewhere on the body senses
both feet, so that an event is one step. `steps_per_event` is 2 or 1. `FOOT` and `CARRIED` are detectors for the two
cases.

`ReferenceLineStepDetector` lists the deviations from the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import low_pass_kernel
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock, DetectorState, local_maxima
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Step, check_numbers, replace_unchecked

# Codes of the behaviour at a sample. Walking and unknown are 1.
_STATIONARY, _RUNNING = 0, 2
# Spacing of the spectrum. At a period of 0.7 s it is much finer than the width of a spectral line.
_LINE_SPACING_HZ = 0.1
# Standard deviation that a foot on the ground or a phone on a table does not exceed in a second. Such a signal is noise
# without a dominant frequency.
_QUIET_STD_MPS2 = 0.05


@dataclass(frozen=True)
class EventSearch:
    """Parameters of the event detection that depend on the behaviour and on the placement of the sensor."""

    # cutoff (-6 dB) of the FIR filter in Hz, the middle of the printed transition band (4 to 4.5 or 10 to 10.5 Hz)
    cutoff_hz: float
    # range of the dominant frequency f_D in Hz, of strides on a foot and of steps elsewhere
    min_frequency_hz: float
    max_frequency_hz: float
    # smallest amplitude of f_D relative to the highest spectral line. f_D is the lowest local maximum of the spectrum
    # that reaches it, so that harmonics are not selected
    harmonic_part: float
    min_maximum_mps2: float  # smallest threshold T_L in m/s2. Local maxima of the acceleration below it are ignored.

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, eq=False)
class ReferenceLines:
    """Reference lines R_L and R_S of a window, levels of the acceleration in m/s2, and the event in progress.

    R_L is the highest maximum of the window. R_S is a level near its lowest minimum (`small_line_mps2`). An event
    begins when the acceleration rises through R_M, which lies between R_S and R_L, and ends when it falls through R_S.
    """

    large_mps2: float | None = None  # R_L; None before the first maximum
    small_mps2: float | None = None  # R_S
    start: int | None = None  # filtered sample at which the event started; None outside an event
    last_end: float = -np.inf  # fractional filtered sample at which the last event ended


@dataclass(frozen=True, eq=False)
class ReferenceLineState(DetectorState):
    """Delay line, current window with its reference lines, and events whose behaviour is still unknown."""

    period_s: float  # 1 / f_D, the length of the window
    buffer: FloatArray  # (3, B): acceleration filtered for walking and for running, code of the behaviour
    waiting: FloatArray  # (W, 2): sample of an event, dominant period in s
    window_start: int = 0  # filtered sample
    is_running: bool = False  # behaviour of this window
    lines: ReferenceLines = ReferenceLines()
    last_event: float = -np.inf  # sample of the last reported event


@dataclass(frozen=True, kw_only=True)
class ReferenceLineStepDetector(BaseStepDetector[ReferenceLineState]):
    """Step detector of Zhou et al. 2019, which finds crossings of adaptive reference lines.

    An event lasts from a rise of the acceleration through the line R_M to the next fall through the line R_S
    (`ReferenceLines`). It is a stride on the foot and a step elsewhere (`steps_per_event`). The detector is causal. A
    step is usually reported one window and 0.25 s after its contact, and at most `latency_s` after it (3.8 s for
    `CARRIED`, 7.2 s for `FOOT`).

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    max_interval_s : float, default 2.0
        Pause in s after which a new walking bout begins.
    first_step_s : float, default 0.6
        Duration in s of the first step of a bout, because no contact marks its start.
    walking, running : EventSearch
        Parameters for the two behaviours. Any behaviour except running uses the parameters of walking.
    steps_per_event : int
        Steps of an event: 2 for a sensor on the foot, 1 elsewhere on the body.
    relative_maximum : float
        Smallest threshold T_L of maxima, relative to the reference line R_L, which is the highest maximum of the window
        before.
    min_line_part : float
        Smallest height of the lower reference line R_S above the minimum, relative to the height of R_L above the
        minimum.
    min_period_part : float
        Shortest time between the ends of two events, relative to the dominant period.
    low_pass_s : float, default 0.5
        Length of the FIR filters in s. Their delay is half of this.
    spectrum_s : float, default 4.0
        Length in s of the signal from which the dominant frequency is estimated.
    hold_s : float, default 2.75
        Longest time in s that an event is held until the behaviour is known, which requires a window that is mostly
        walking or running.

    Raises
    ------
    ValueError
        If a number is invalid, or if frequencies, cutoffs and rate are not in ascending order.

    Notes
    -----
    The statistics of a step, for the models M2 to M7, are those of the low-passed signal of its behaviour, as in the
    paper.

    The contact is the end of the event. On the foot of a slow walker, it may be in the swing phase, half a stride
    early. The contacts of an event with several steps divide the time since the last event evenly, or the dominant
    period for the first event of a bout.

    Deviations from the paper:

    - The sensor may also be elsewhere on the body (`CARRIED`), with one step for each event.
    - The FIR filters have transition bands of 4 to 4.5 Hz and 10 to 10.5 Hz. Here they have -6 dB at 4.25 and 10.25 Hz,
      are 0.5 s long and roll off within 6.6 Hz. A band of 0.5 Hz would delay by 3.3 s and counts no better.
    - The accelerometer bias is not removed, because the lines follow the signal.
    - Minima of eq. 6 are below T_S. The printed "> T_S" is an error.
    - T_L and T_S are not given. T_L is a part of R_L, and at least a constant. T_S is the mean of the last 4 s.
    - R_S is half of the minimum where it is negative (`small_line_mps2`). Twice a negative minimum, as printed, is
      below the whole signal, and most strides are missed.
    - R_S is at least 15 % (foot: 20 %) of the way from the minimum to R_L, because a foot on the ground stays at its
      minimum.
    - R_M is at least 10 % of the way from R_S to R_L (`median_line_mps2`).
    - An event does not end within 55 % (foot: 70 %) of a dominant period after the last one, because push-off and heel
      strike are two humps. In the paper every fall through R_S ends one.
    - The lines are forgotten after a pause, because the next walk may be gentler.
    - Steps of a transition are counted in the paper until the behaviour is known. Here they are held, and reported only
      if it becomes walking or running, because standing must not count.

    Examples
    --------
    >>> from pdr_filter.recipes.zhou2019.steps import CARRIED
    >>> CARRIED.steps_per_event
    1
    """

    walking: EventSearch
    running: EventSearch
    steps_per_event: int
    relative_maximum: float
    min_line_part: float
    min_period_part: float
    low_pass_s: float = 0.5
    spectrum_s: float = 4.0
    hold_s: float = 2.75

    def __post_init__(self) -> None:
        check_numbers(self)
        for search in (self.walking, self.running):
            if not 0 < search.min_frequency_hz < search.max_frequency_hz < search.cutoff_hz < 0.5 * self.rate_hz:
                raise ValueError(
                    "min_frequency_hz, max_frequency_hz, cutoff_hz and rate_hz / 2 must be "
                    "positive and in ascending order, got "
                    f"{search.min_frequency_hz}, {search.max_frequency_hz}, {search.cutoff_hz}, {0.5 * self.rate_hz}"
                )

    @cached_property
    def _taps(self) -> tuple[FloatArray, FloatArray]:
        cutoffs_hz = (self.walking.cutoff_hz, self.running.cutoff_hz)
        walking, running = (low_pass_kernel(cutoff, self.rate_hz, self.low_pass_s) for cutoff in cutoffs_hz)
        return walking, running

    @property
    def _delay_samples(self) -> int:
        return len(self._taps[0]) // 2

    @property
    def _spectrum_samples(self) -> int:
        return round(self.spectrum_s * self.rate_hz)

    @property
    def _bout_samples(self) -> float:
        """Longest interval in samples between events (steps, or strides on a foot) of one bout of walking."""
        return self.steps_per_event * self.max_interval_s * self.rate_hz

    @property
    def latency_s(self) -> float:
        """Longest time in s from a foot contact to its detection, if its event is held for `hold_s`.

        An event is a step, or a stride on a foot. It is held until the behaviour is known to be walking or running.
        """
        longest_window_s = 1.0 / min(self.walking.min_frequency_hz, self.running.min_frequency_hz)
        within_event_s = (self.steps_per_event - 1) * self.max_interval_s
        return self.hold_s + longest_window_s + within_event_s + (self._delay_samples + 1) / self.rate_hz

    def init(self) -> ReferenceLineState:
        period_s = 2.0 / (self.walking.min_frequency_hz + self.walking.max_frequency_hz)
        line = np.zeros((2, self._n_line))
        return ReferenceLineState(self._log.init(), line, period_s, np.empty((3, 0)), np.empty((0, 2)))

    @property
    def _n_line(self) -> int:
        return len(self._taps[0]) - 1

    def _signals(
        self, state: ReferenceLineState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[ReferenceLineState, FloatArray]:
        """Return the unchanged state, and the acceleration |f| - g and the code of the behaviour, (2, N).

        The code is 0 if the person stands or moves irregularly, 2 for running, and otherwise 1.
        """
        a = specific_force_magnitude(block.specific_force_mps2) - STANDARD_GRAVITY_MPS2
        return state, np.vstack(
            [a, np.select([contexts.stands, contexts.runs], [_STATIONARY, _RUNNING], 1).astype(float)]
        )

    def _signals_after_end(self, state: ReferenceLineState) -> FloatArray:
        """Return signals after the end: the last values, repeated until the window is complete."""
        n_more = self._delay_samples + _window_samples(state.period_s, self.rate_hz)
        return np.repeat(state.line[:, -1:], n_more, axis=1)

    def _detect(
        self, state: ReferenceLineState, line: FloatArray, first: int
    ) -> tuple[ReferenceLineState, list[tuple[int, Step]]]:
        # each output is one dot product with the kernel, so that results are bit-identical for any split into blocks
        filtered = [np.convolve(line[0], taps, mode="valid") for taps in self._taps]
        new = np.stack([*filtered, line[1, self._n_line :]])
        n_samples = first + new.shape[1]
        state = replace_unchecked(state, buffer=np.concatenate([state.buffer, new], axis=1))
        steps: list[tuple[int, Step]] = []
        while state.window_start + _window_samples(state.period_s, self.rate_hz) <= n_samples:
            state, found = self._window(state, n_samples - state.buffer.shape[1])
            steps += found
        held_s = self.hold_s + self.steps_per_event * self.max_interval_s  # the oldest step that may be released
        n_past = max(self._spectrum_samples, round(held_s * self.rate_hz))
        n_kept = n_samples - state.window_start + n_past
        return replace_unchecked(state, buffer=state.buffer[:, -n_kept:]), steps

    def _window(self, state: ReferenceLineState, first: int) -> tuple[ReferenceLineState, list[tuple[int, Step]]]:
        """Return the state after a complete window, and the steps found, each with the number of its newest sample.

        The state has the start and the length of the next window. The buffer starts at sample `first`.
        """
        window_end = state.window_start + _window_samples(state.period_s, self.rate_hz)
        begin, end = state.window_start - first, window_end - first
        search = self.running if state.is_running else self.walking
        past = np.ascontiguousarray(state.buffer[int(state.is_running), max(end - self._spectrum_samples, 0) : end])
        # one sample more than the window, so that no extremum at a boundary is missed
        samples = state.buffer[int(state.is_running), max(begin - 2, 0) : end]
        lines = self._place(state.lines, samples, float(past.mean()), search)
        lines, ends = self._cross(lines, state.buffer[int(state.is_running), begin:end], state)
        events = np.array([[e - self._delay_samples, state.period_s] for e in ends]).reshape(-1, 2)
        state = replace_unchecked(state, lines=lines, waiting=np.concatenate([state.waiting, events]))
        context = round(state.buffer[2, end - 1])
        is_running = context == _RUNNING
        a = state.buffer[int(is_running), self._delay_samples :]  # from sample `first` on, without the delay
        state, steps = self._release(state, context == _STATIONARY, window_end - 1, a, first)
        before = np.ascontiguousarray(state.buffer[int(is_running), max(end - self._spectrum_samples, 0) : end])
        period_s = dominant_period_s(before, self.running if is_running else self.walking, self.rate_hz)
        return (
            replace_unchecked(
                state, window_start=window_end, period_s=period_s or state.period_s, is_running=is_running
            ),
            steps,
        )

    def _place(
        self, lines: ReferenceLines, samples: FloatArray, mean_mps2: float, search: EventSearch
    ) -> ReferenceLines:
        """Return the reference lines for a window, updated by the extrema of its samples (Zhou et al. 2019, Table 2).

        R_L becomes the highest local maximum above the threshold T_L. R_S becomes the level of `small_line_mps2` for
        the lowest local minimum below `mean_mps2`, or the mean of that level and the old R_S if R_S would fall. Without
        such extrema a line is unchanged (rules 1 to 3).
        """
        middle = samples[1:-1]
        large, small = lines.large_mps2, lines.small_mps2
        threshold = max(search.min_maximum_mps2, self.relative_maximum * (large or 0.0))  # T_L
        maxima = middle[local_maxima(samples) & (middle > threshold)]
        minima = middle[local_maxima(-samples) & (middle < mean_mps2)]  # T_S
        if len(maxima):
            large = float(maxima.max())
        if len(minima) and large is not None:
            new = small_line_mps2(float(minima.min()), large, self.min_line_part)
            small = 0.5 * (new + small) if small is not None and new < small else new
        return replace_unchecked(lines, large_mps2=large, small_mps2=small)

    def _cross(
        self, lines: ReferenceLines, window: FloatArray, state: ReferenceLineState
    ) -> tuple[ReferenceLines, list[float]]:
        """Return the reference lines after a window, and the fractional sample numbers at which its events end.

        An event (a step, or a stride on a foot) begins with a rise through R_M and ends with the next fall through R_S.
        After a pause without events, the lines are unknown again.
        """
        large, small, start, last_end = lines.large_mps2, lines.small_mps2, lines.start, lines.last_end
        ends: list[float] = []
        if large is not None and small is not None:
            median = median_line_mps2(large, small)
            min_samples = self.min_period_part * state.period_s * self.rate_hz
            previous = float(window[0])
            for number, value in enumerate(window.tolist(), state.window_start):
                if start is None:
                    start = number if value >= median else None
                elif value <= small:
                    start = None
                    # the line may have moved across the signal between windows; the event then ends at the sample
                    fraction = (previous - small) / (previous - value) if previous > small else 1.0
                    at = number - 1 + fraction
                    if at - last_end >= min_samples:
                        ends.append(at)
                        last_end = at
                previous = value
        window_end = state.window_start + len(window)
        if window_end - max(last_end, -np.inf if start is None else start) > self._bout_samples:
            large = small = start = None  # the next bout may have smaller maxima
        return ReferenceLines(large, small, start, last_end), ends

    def _release(
        self, state: ReferenceLineState, is_still: bool, known: int, a_mps2: FloatArray, first: int
    ) -> tuple[ReferenceLineState, list[tuple[int, Step]]]:
        """Return the new state, and the steps of all held events, each with the number `known` of the newest sample.

        `a_mps2` is the filtered acceleration from sample `first` on. An event is a detected step, or a stride on a
        foot. It is held until the behaviour is known. If the person stands (`is_still`), there are no steps. The events
        stay held, except those held longer than `hold_s`, which are dropped.
        """
        if is_still:
            oldest = known + 1 - self._delay_samples - self.hold_s * self.rate_hz
            return replace_unchecked(state, waiting=state.waiting[state.waiting[:, 0] >= oldest]), []
        steps: list[tuple[int, Step]] = []
        for event, period_s in state.waiting.tolist():
            interval = event - state.last_event
            if interval > self._bout_samples:
                interval = period_s * self.rate_hz
            for k in reversed(range(self.steps_per_event)):
                contact = event - k * interval / self.steps_per_event
                state, step = self._contact(state, contact, known, a_mps2, first)
                steps += [] if step is None else [(known, step)]
            state = replace_unchecked(state, last_event=event)
        return replace_unchecked(state, waiting=np.empty((0, 2))), steps

    def _contact(
        self, state: ReferenceLineState, sample: float, known: int, a_mps2: FloatArray, first: int
    ) -> tuple[ReferenceLineState, Step | None]:
        """Return the new state, and the step that ends at a contact, or None if its samples are not available."""
        contact = int(np.floor(sample))
        if not self._log.can_end(state.log, contact):
            return state, None
        log, span = self._log.end_step(state.log, contact, known, sample - contact)
        log, (step,) = self._log.describe(log, [span])
        start, end = (column + self._log.first_sample(log) - first for column in span.columns)
        a = a_mps2[max(start, 0) : end]
        step = replace_unchecked(
            step,
            variance=float(a.var()),
            magnitude_max_mps2=float(a.max()) + STANDARD_GRAVITY_MPS2,
            magnitude_min_mps2=float(a.min()) + STANDARD_GRAVITY_MPS2,
            mean_abs_mps2=float(np.abs(a).mean()),
        )
        return replace_unchecked(state, log=log), step


def small_line_mps2(minimum_mps2: float, large_mps2: float, min_line_part: float = 0.0) -> float:
    """Return the lower reference line R_S of a window in m/s2 (Zhou et al. 2019, Table 2, rule 2).

    It is twice the minimum of the acceleration, or half of a negative minimum. It is at least `min_line_part` of the
    way from the minimum up to the upper line R_L (`large_mps2`).
    """
    factor = 2.0 if minimum_mps2 > 0 else 0.5
    return max(factor * minimum_mps2, minimum_mps2 + min_line_part * (large_mps2 - minimum_mps2))


def median_line_mps2(large_mps2: float, small_mps2: float) -> float:
    """Return the middle reference line R_M = (R_L + R_S) / 4 in m/s2 (Zhou et al. 2019, Table 2, rule 4).

    R_M is at least a tenth of the way from R_S up to R_L, because the formula gives a line below R_S if R_L < 3 R_S.
    """
    return max(0.25 * (large_mps2 + small_mps2), small_mps2 + 0.1 * (large_mps2 - small_mps2))


def dominant_period_s(acceleration_mps2: FloatArray, search: EventSearch, rate_hz: float) -> float | None:
    """Return the dominant period 1 / f_D of filtered acceleration (N,) in s.

    Return None if the signal is shorter than a second, is noise, or has no dominant frequency in the range.
    """
    if len(acceleration_mps2) < rate_hz or acceleration_mps2.std() < _QUIET_STD_MPS2:
        return None
    centred = (acceleration_mps2 - acceleration_mps2.mean()) * np.hanning(len(acceleration_mps2))
    amplitude = np.abs(np.fft.rfft(centred, max(round(rate_hz / _LINE_SPACING_HZ), len(centred))))
    spacing_hz = rate_hz / max(round(rate_hz / _LINE_SPACING_HZ), len(centred))
    low, high = int(np.ceil(search.min_frequency_hz / spacing_hz)), int(search.max_frequency_hz / spacing_hz)
    stands_out = (amplitude[1:-1] >= amplitude[:-2]) & (amplitude[1:-1] > amplitude[2:])
    strong = amplitude[1:-1] >= search.harmonic_part * amplitude[low:].max()
    found = np.flatnonzero((stands_out & strong)[low - 1 : high]) + low
    return 1.0 / (found[0] * spacing_hz) if len(found) else None


def _window_samples(period_s: float, rate_hz: float) -> int:
    """Return the length of a window in samples, w = f_A / f_D (Zhou et al. 2019, eq. 5).

    f_A is the sampling rate in Hz. f_D is the dominant frequency in Hz, that is, 1 / `period_s`. w is at least 1.
    """
    return max(round(period_s * rate_hz), 1)


# Parameters chosen on every second of the 24 trials of pyshoe (walking and running, sensor on the foot).
FOOT = ReferenceLineStepDetector(
    walking=EventSearch(4.25, 0.45, 1.25, harmonic_part=0.2, min_maximum_mps2=1.5),
    running=EventSearch(10.25, 0.9, 2.0, harmonic_part=0.2, min_maximum_mps2=4.0),
    steps_per_event=2,
    relative_maximum=0.25,
    min_line_part=0.2,
    min_period_part=0.7,
)

# Parameters chosen on persons 1 to 6 of ubicomp13, with phones in seven placements. There are no running recordings
# with known steps.
CARRIED = ReferenceLineStepDetector(
    walking=EventSearch(4.25, 1.2, 2.6, harmonic_part=0.4, min_maximum_mps2=0.5),
    running=EventSearch(10.25, 2.0, 4.0, harmonic_part=0.4, min_maximum_mps2=3.0),
    steps_per_event=1,
    relative_maximum=0.35,
    min_line_part=0.15,
    min_period_part=0.55,
)
