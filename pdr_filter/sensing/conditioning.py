"""Samples as they come in, uniform samples out: one time base, fixed rate, gaps kept as gaps.

Everything after this stage may assume a constant rate. The conditioner is causal and its output depends only on the
samples, never on how they were cut into blocks: a uniform sample is the mean of the linearly interpolated signal over
its own interval, so only the samples of that interval enter, whatever arrived with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from pdr_filter.sensing.clock import ClockState, follow, one_clock
from pdr_filter.sensing.stuck_sensors import WatchdogState, watch, watchdog
from pdr_filter.sensing.unit_check import UnitsState, look, units
from pdr_filter.values import (
    BoolArray,
    FloatArray,
    ImuBlock,
    Samples,
    check_numbers,
    how_many,
    how_often,
    replace_unchecked,
)
from pdr_filter.values.recording import Recording

# Columns of the rows that wait in the state: time, specific force, angular rate, magnetic field, and the age of the
# last finite angular rate and magnetic field.
_FORCE, _RATE, _FIELD, _MOTION = slice(1, 4), slice(4, 7), slice(7, 10), slice(1, 7)
_RATE_AGE, _FIELD_AGE = 10, 11
_N_COLUMNS = 12

# Phones saturate at 16 g (156.9 m/s2) and 2000 deg/s (35 rad/s), faster gyroscopes at twice that.
MAX_FORCE_MPS2, MAX_RATE_RADPS = 160.0, 100.0
# Phones' magnetometers saturate at 2 to 5 mT.
MAX_FIELD_UT = 1e4
# Of time, specific force, angular rate and magnetic field.
_LIMITS = np.repeat([np.inf, MAX_FORCE_MPS2, MAX_RATE_RADPS, MAX_FIELD_UT], [1, 3, 3, 3])
# Rows that are conditioned at once: what is made of them fits into a cache.
_ROWS_AT_ONCE = 4000
# So many rows without a believed time, or none that follows another, are worth a word.
_NOTABLE_DEAF = 200


@dataclass(frozen=True, slots=True, eq=False)
class UniformBlock:
    """Consecutive samples at a constant rate: whole hops, but for the last ones of a segment.

    Where a sensor is missing for longer than the longest bridged gap its values are zero and `*_known` is False.
    """

    time_s: FloatArray  # (N,) middle of each sample's interval
    specific_force_mps2: FloatArray  # (N, 3)
    angular_rate_radps: FloatArray  # (N, 3)
    angular_rate_known: BoolArray  # (N,)
    magnetic_field_ut: FloatArray  # (N, 3)
    magnetic_field_known: BoolArray  # (N,)
    gap_before_s: float  # 0 if it continues the block before; inf for the very first


@dataclass(frozen=True)
class IntakeReport:
    """What the conditioner did to the samples it received."""

    n_received: int = 0
    n_not_finite: int = 0  # rows without a finite time or specific force: bridged, or part of a gap
    n_implausible: int = 0  # rows beyond what any phone measures: left out
    n_not_increasing: int = 0  # duplicate or backward timestamps: dropped
    n_clock_jumps: int = 0  # single times far ahead, dropped, and clocks set back, followed
    n_dead_force: int = 0  # rows in which the accelerometer stood still while the phone moved: left out
    n_dead_rate: int = 0  # the same of the gyroscope: without angular rate
    n_wild_field: int = 0  # rows with a magnetic field beyond what any phone measures: without field
    n_gaps: int = 0
    longest_gap_s: float = 0.0
    lost_s: float = 0.0  # time inside gaps
    n_emitted: int = 0  # uniform samples
    n_without_rate: int = 0  # uniform samples whose angular rate is unknown
    n_deaf: int = 0  # rows since the last one whose time was believed
    rate_hz: float = 100.0
    first_time_s: float = np.nan
    last_time_s: float = np.nan

    def notes(self) -> tuple[str, ...]:
        """In plain words, empty if there was nothing to repair."""
        found: list[str] = []
        if self.n_not_finite:
            found.append(f"{self.n_not_finite} of {self.n_received} samples had no finite value and were left out")
        if self.n_implausible:
            found.append(
                f"{how_many(self.n_implausible, 'sample')} beyond {MAX_FORCE_MPS2:g} m/s2 or {MAX_RATE_RADPS:g} rad/s "
                "left out"
            )
        for sensor, n_dead, so in (
            ("accelerometer", self.n_dead_force, "left out"),
            ("gyroscope", self.n_dead_rate, "taken as without angular rate"),
        ):
            if n_dead:
                found.append(
                    f"an axis of the {sensor} gave one number while the phone moved: {n_dead} of {self.n_received} "
                    f"samples are {so}"
                )
        if self.n_wild_field:
            found.append(f"{how_many(self.n_wild_field, 'magnetic field')} beyond {MAX_FIELD_UT:g} uT: taken as none")
        if self.n_clock_jumps:
            found.append(
                f"the clock jumped {how_often(self.n_clock_jumps)}; the track follows the samples, not the clock"
            )
        if self.n_not_increasing:
            found.append(
                f"{self.n_not_increasing} of {self.n_received} samples had a repeated or backward time and were dropped"
            )
        if self.n_deaf >= _NOTABLE_DEAF:
            found.append(
                f"nothing accepted since {self.last_time_s:.1f} s: the times of the last {self.n_deaf} samples stand "
                "still or lie before it"
            )
        if self.n_received >= _NOTABLE_DEAF and self.n_emitted == 0:
            found.append(
                "no two samples follow each other: times must be in seconds (not ms, us or ns), four a second or more, "
                "and seconds since 1970 need 64 bits"
            )
        if self.n_gaps:
            found.append(
                f"{how_many(self.n_gaps, 'gap')} ({self.lost_s:.1f} s in all, longest "
                f"{self.longest_gap_s:.1f} s): steps in there are unknown and the covariance was grown"
            )
        missing_s = self.n_without_rate / self.rate_hz
        if self.n_emitted and self.n_without_rate == self.n_emitted:
            found.append("no gyroscope: the heading is unknown, only steps, contexts and distance can be trusted")
        elif missing_s > 1.0:
            found.append(f"no angular rate for {missing_s:.1f} s: the heading is unknown there")
        return tuple(found)


@dataclass(frozen=True, eq=False)
class ConditionerState:
    """Rows not yet used up, where the uniform grid is, and the report so far."""

    rows: FloatArray  # (R, 12)
    segment_start_s: float
    n_emitted: int  # uniform samples of this segment already emitted
    gap_before_s: float  # of this segment; handed to its first block
    last_rate: FloatArray  # (4,) time and value of the last finite angular rate
    last_field: FloatArray  # (4,)
    clock: ClockState
    watchdog: WatchdogState
    units: UnitsState
    report: IntakeReport

    def notes(self) -> tuple[str, ...]:
        """What is odd about the samples, in plain words."""
        return (*self.units.notes(), *self.report.notes())


@dataclass(frozen=True)
class Conditioner:
    """Uniform rate, causal.

    Parameters
    ----------
    rate_hz : float
        Rate of the output. Faster input is averaged over each interval (which is its anti-alias filter), slower input
        is interpolated linearly.
    max_gap_s : float
        A longer time without samples is a gap: no sample is invented there, and later stages start afresh.
    hop_samples : int
        Output comes in whole hops of this many samples, and what is left of one at a gap and in the end. Each hop costs
        the later stages as much as some hundred samples; the longer it is, the later a step is known.
    """

    rate_hz: float = 100.0
    max_gap_s: float = 0.3
    hop_samples: int = 20

    def __post_init__(self) -> None:
        check_numbers(self)

    def init(self) -> ConditionerState:
        """State before the first sample."""
        nothing = np.array([-np.inf, 0.0, 0.0, 0.0])
        report = IntakeReport(rate_hz=self.rate_hz)
        return ConditionerState(
            np.empty((0, _N_COLUMNS)), np.nan, 0, np.inf, nothing, nothing, ClockState(), watchdog(), units(), report
        )

    def update(self, state: ConditionerState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        """New state and the whole hops that became complete, split at gaps."""
        outputs: list[UniformBlock] = []
        for part in block.parts(_ROWS_AT_ONCE):
            state, found = self._some(state, part)
            outputs += found
        return state, _joined(outputs)

    def finish(self, state: ConditionerState) -> tuple[ConditionerState, list[UniformBlock]]:
        """New state and what is left of a hop, when no further sample will come."""
        # a segment that has not begun has no samples for the later stages to begin with
        return self._resample(state, state.rows, hop_samples=1) if state.n_emitted > 0 else (state, [])

    def _some(self, state: ConditionerState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        """The same of samples whose rows fit into a cache."""
        state, rows = self._accept(state, block)
        if len(rows) == 0:
            return state, []
        times = np.concatenate([state.rows[-1:, 0], rows[:, 0]])
        after_gap = np.flatnonzero(times[1:] - times[:-1] > self.max_gap_s) + (0 if len(state.rows) else 1)
        outputs: list[UniformBlock] = []
        for part in np.split(rows, after_gap) if len(after_gap) else [rows]:
            if len(part) == 0:
                continue
            if len(state.rows) == 0:
                state = replace_unchecked(state, segment_start_s=part[0, 0])
            elif part[0, 0] - state.rows[-1, 0] > self.max_gap_s:
                state, output = self.finish(state)
                outputs += output
                state = self._start_segment(state, part)
            state, output = self._resample(state, np.concatenate([state.rows, part]), self.hop_samples)
            outputs += output
        return state, outputs

    def _accept(self, state: ConditionerState, block: ImuBlock) -> tuple[ConditionerState, FloatArray]:
        """Rows with finite specific force and increasing time; missing rate and field held, with their age."""
        raw = np.empty((len(block.time_s), 10))
        raw[:, 0], raw[:, _FORCE] = block.time_s, block.specific_force_mps2
        raw[:, _RATE], raw[:, _FIELD] = block.angular_rate_radps, block.magnetic_field_ut
        usable, n_not_finite, n_implausible, n_wild_field = _usable(raw)
        clock, followed, n_dropped, n_jumps = follow(state.clock, usable, self.max_gap_s)
        measured, n_dead_force, n_dead_rate = followed[:, _MOTION], 0, 0
        watched, motion = watch(state.watchdog, followed[:, 0], measured)
        if motion is not measured:  # a sensor is dead
            is_dead = np.isnan(motion[:, 0])
            n_dead_force = int(is_dead.sum())
            n_dead_rate = int((np.isnan(motion[:, 3]) & ~np.isnan(followed[:, 4])).sum())
            followed, motion = followed[~is_dead], motion[~is_dead]
        rows = np.empty((len(motion), _N_COLUMNS))
        rows[:, 0], rows[:, _FORCE] = followed[:, 0], motion[:, :3]
        rows[:, _RATE], rows[:, _RATE_AGE], last_rate = _hold(rows[:, 0], motion[:, 3:], state.last_rate)
        rows[:, _FIELD], rows[:, _FIELD_AGE], last_field = _hold(rows[:, 0], followed[:, _FIELD], state.last_field)
        old = state.report
        report = replace_unchecked(
            old,
            n_received=old.n_received + len(raw),
            n_not_finite=old.n_not_finite + n_not_finite,
            n_implausible=old.n_implausible + n_implausible,
            n_not_increasing=old.n_not_increasing + n_dropped,
            n_clock_jumps=old.n_clock_jumps + n_jumps,
            n_deaf=clock.n_deaf,
            n_dead_force=old.n_dead_force + n_dead_force,
            n_dead_rate=old.n_dead_rate + n_dead_rate,
            n_wild_field=old.n_wild_field + n_wild_field,
        )
        if len(rows):
            first = rows[0, 0] if np.isnan(old.first_time_s) else old.first_time_s
            report = replace_unchecked(report, first_time_s=float(first), last_time_s=float(rows[-1, 0]))
        seen = look(state.units, followed[:, 0], followed[:, _MOTION])
        kept_state = {"clock": clock, "watchdog": watched, "units": seen, "report": report}
        return replace_unchecked(state, last_rate=last_rate, last_field=last_field, **kept_state), rows

    def _start_segment(self, state: ConditionerState, part: FloatArray) -> ConditionerState:
        # The gap is counted from the end of what was emitted. If nothing of the old segment was, the gap before it is
        # still open and adds up.
        emitted_until_s = state.segment_start_s + state.n_emitted / self.rate_hz
        gap_s = float(part[0, 0] - emitted_until_s)
        unreported = state.gap_before_s if state.n_emitted == 0 else 0.0
        report = replace_unchecked(
            state.report,
            n_gaps=state.report.n_gaps + 1,
            longest_gap_s=max(state.report.longest_gap_s, gap_s),
            lost_s=state.report.lost_s + gap_s,
        )
        return replace_unchecked(
            state,
            rows=np.empty((0, _N_COLUMNS)),
            segment_start_s=float(part[0, 0]),
            n_emitted=0,
            gap_before_s=gap_s + unreported,
            report=report,
        )

    def _resample(
        self, state: ConditionerState, rows: FloatArray, hop_samples: int
    ) -> tuple[ConditionerState, list[UniformBlock]]:
        """Mean of the linear interpolant over each interval of the grid that the rows cover, in whole hops."""
        # A grid point needs a sample after it: interpolated from the left alone it would have other last bits.
        last_s = float(rows[-1, 0])
        last = math.ceil((last_s - state.segment_start_s) * self.rate_hz) + 1
        while last > 0 and state.segment_start_s + last / self.rate_hz >= last_s:
            last -= 1
        n_complete = last // hop_samples * hop_samples
        if n_complete <= state.n_emitted:
            return replace_unchecked(state, rows=rows), []
        index = np.arange(state.n_emitted, n_complete + 1)
        grid = state.segment_start_s + index / self.rate_hz
        means = _interval_means(rows[:, 0], rows[:, 1:10], grid)
        # A sample counts as known if the last finite value before it is not older than a bridged gap.
        at = np.minimum(np.searchsorted(rows[:, 0], grid[1:]), len(rows) - 1)
        rate_known = rows[at, _RATE_AGE] <= self.max_gap_s
        field_known = rows[at, _FIELD_AGE] <= self.max_gap_s
        output = UniformBlock(
            time_s=grid[1:] - 0.5 / self.rate_hz,
            specific_force_mps2=np.ascontiguousarray(means[:, 0:3]),
            angular_rate_radps=np.where(rate_known[:, None], means[:, 3:6], 0.0),
            angular_rate_known=rate_known,
            magnetic_field_ut=np.where(field_known[:, None], means[:, 6:9], 0.0),
            magnetic_field_known=field_known,
            gap_before_s=state.gap_before_s if state.n_emitted == 0 else 0.0,
        )
        first_needed = max(int(np.searchsorted(rows[:, 0], grid[-1], side="right")) - 1, 0)
        report = replace_unchecked(
            state.report,
            n_emitted=state.report.n_emitted + len(rate_known),
            n_without_rate=state.report.n_without_rate + int((~rate_known).sum()),
        )
        new = replace_unchecked(state, rows=rows[first_needed:], n_emitted=n_complete, report=report)
        return new, [output]


def _joined(blocks: Sequence[UniformBlock]) -> list[UniformBlock]:
    """Blocks that follow each other without a gap as one."""
    runs: list[list[UniformBlock]] = []
    for block in blocks:
        if runs and block.gap_before_s == 0:
            runs[-1].append(block)
        else:
            runs.append([block])
    return [_one(run) if len(run) > 1 else run[0] for run in runs]


def _one(run: Sequence[UniformBlock]) -> UniformBlock:
    names = [f.name for f in fields(UniformBlock) if f.name != "gap_before_s"]
    joined = {name: np.concatenate([getattr(block, name) for block in run]) for name in names}
    return UniformBlock(**joined, gap_before_s=run[0].gap_before_s)


def _usable(raw: FloatArray) -> tuple[FloatArray, int, int, int]:
    """Rows (N, 10) of time, force, rate and field that can be used, a wild rate and a wild field being NaN.

    Also how many were not finite, how many implausible, and how many had a wild field.
    """
    finite, beyond = np.isfinite(raw[:, :4]), np.abs(raw) > _LIMITS  # of NaN nothing is
    if finite.all() and not beyond.any():
        return raw, 0, 0, 0
    wild_force, wild_rate, wild_field = (beyond[:, part].any(axis=1) for part in (_FORCE, _RATE, _FIELD))
    is_finite = finite.all(axis=1)
    n_wild = int((is_finite & (wild_force | wild_rate)).sum())
    raw[wild_rate, _RATE] = raw[wild_field, _FIELD] = np.nan
    return raw[is_finite & ~wild_force], int((~is_finite).sum()), n_wild, int(wild_field.sum())


def _hold(time_s: FloatArray, values: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Values with missing rows replaced by the last finite one, the age of each (0 if measured), and the new last."""
    if np.isfinite(values).all():
        newest = np.concatenate([time_s[-1:], values[-1]]) if len(values) else last
        return values, np.zeros(len(values)), newest
    stack = np.vstack([last, np.column_stack([time_s, values])])
    finite = np.isfinite(stack[:, 1:]).all(axis=1)
    index = np.maximum.accumulate(np.where(finite, np.arange(len(stack)), 0))
    held = stack[index]
    return held[1:, 1:], time_s - held[1:, 0], held[-1]


def _interval_means(time_s: FloatArray, values: FloatArray, grid_s: FloatArray) -> FloatArray:
    """Mean over each interval of the grid of the linear interpolant through (time, value), shape (len(grid) - 1, d)."""
    right = np.minimum(np.maximum(time_s.searchsorted(grid_s, side="right"), 1), len(time_s) - 1)
    left = right - 1
    fraction = ((grid_s - time_s[left]) / (time_s[right] - time_s[left]))[:, None]
    before = values.take(left, axis=0)
    at_grid = values.take(right, axis=0)
    at_grid -= before
    at_grid *= fraction
    at_grid += before
    # All knots inside the grid in order: grid points go in before the first sample at or after them.
    position = time_s.searchsorted(grid_s)
    inside = slice(int(position[0]), int(position[-1]))
    position -= position[0]
    of_grid = position + np.arange(len(grid_s))
    n_inside, n_knots = inside.stop - inside.start, inside.stop - inside.start + len(grid_s)
    order, is_sample = np.empty(n_knots, dtype=np.intp), np.ones(n_knots, dtype=bool)
    is_sample[of_grid] = False
    order[is_sample], order[of_grid] = np.arange(n_inside), np.arange(n_inside, n_knots)
    knots_s = np.concatenate([time_s[inside], grid_s]).take(order)
    knots = np.concatenate([values[inside], at_grid]).take(order, axis=0)
    areas = knots[1:] + knots[:-1]
    areas *= 0.5
    areas *= (knots_s[1:] - knots_s[:-1])[:, None]
    first = position[:-1] + np.arange(len(grid_s) - 1)
    # reduceat adds row by row within each interval: the same numbers in the same order however blocks were cut
    return np.add.reduceat(areas, first, axis=0) / (grid_s[1:] - grid_s[:-1])[:, None]


def merge_streams(recording: Recording, max_gap_s: float = 0.3) -> ImuBlock:
    """All sensors of a recording at the times of its accelerometer, in recorded order, on one clock.

    Angular rate and magnetic field are interpolated linearly; they are NaN where the stream is missing or its samples
    are further than `max_gap_s` apart.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> samples = pdr.merge_streams(pdr.simulate.demo_walk())
    >>> samples.specific_force_mps2.shape == samples.angular_rate_radps.shape
    True
    """
    recording, _ = one_clock(recording)
    time_s = recording.accelerometer.time_s
    for sensor in ("gyroscope", "magnetometer"):
        _check_clock(sensor, recording.streams.get(sensor), time_s, max_gap_s)
    return ImuBlock(
        time_s=time_s,
        specific_force_mps2=recording.accelerometer.values,
        angular_rate_radps=_of_stream(recording.gyroscope, time_s, max_gap_s),
        magnetic_field_ut=_of_stream(recording.magnetometer, time_s, max_gap_s),
    )


def _check_clock(sensor: str, stream: Samples | None, at_s: FloatArray, max_gap_s: float) -> None:
    """ValueError if no time of a stream is within those of the accelerometer: its clock is another one."""
    own_s = np.empty(0) if stream is None else stream.time_s[np.isfinite(stream.time_s)]
    at_s = at_s[np.isfinite(at_s)]
    if (
        len(own_s) < 2
        or not len(at_s)
        or (own_s.min() <= at_s.max() + max_gap_s and own_s.max() >= at_s.min() - max_gap_s)
    ):
        return
    raise ValueError(
        f"{sensor}: its times, {own_s.min():.1f} to {own_s.max():.1f} s, are outside those of the accelerometer, "
        f"{at_s.min():.1f} to {at_s.max():.1f} s: it is on another clock or has another unit; add the offset of the "
        "clocks to its times, or leave the stream out"
    )


def _of_stream(stream: Samples | None, at_s: FloatArray, max_gap_s: float) -> FloatArray:
    if stream is None:
        return np.full((len(at_s), 3), np.nan)
    time_s, values = stream.time_s, stream.values
    if not (np.isfinite(values).all() and (time_s[1:] > time_s[:-1]).all() and np.isfinite(time_s[-1:]).all()):
        good = np.isfinite(time_s) & np.isfinite(values).all(axis=1)
        time_s, first = np.unique(time_s[good], return_index=True)
        values = values[good][first]
    return at_times(time_s, values, at_s, max_gap_s)


def at_times(time_s: FloatArray, values: FloatArray, at_s: FloatArray, max_gap_s: float) -> FloatArray:
    """Values (N, 3) of increasing times (N,) between them, as `merge_streams` has them, at some times (M,).

    Of the samples only the two around each time enter, and the last two where there is none after it.
    """
    if len(time_s) < 2 or not len(at_s):
        return np.full((len(at_s), 3), np.nan)
    if np.array_equal(time_s, at_s):
        return values
    right = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    left_s, right_s = time_s[right - 1], time_s[right]
    # A stream that starts or ends a few samples away from the accelerometer is held, not extrapolated.
    covered = (at_s > time_s[0] - max_gap_s) & (at_s < time_s[-1] + max_gap_s)
    measured = (at_s == left_s) | (at_s == right_s)  # at the edge of a hole
    near = covered & (measured | (right_s - left_s <= max_gap_s))
    fraction = np.clip((at_s - left_s) / (right_s - left_s), 0.0, 1.0)[:, None]
    before, after = values.take(right - 1, axis=0), values.take(right, axis=0)
    between = before + (after - before) * fraction
    # what was measured at that time is not rounded, so that nothing depends on what else is asked for
    np.copyto(between, after, where=fraction == 1.0)
    between[~near] = np.nan
    return between
