"""Resample raw samples to a constant rate on one time base; gaps stay gaps.

All later stages may assume a constant rate. The conditioner is causal, and its output depends only on the samples, not
on the blocks in which they arrive: a uniform sample is the mean of the linearly interpolated signal over its own
interval, so only the samples of that interval enter. Gaps are not filled, because an invented signal would be counted
as steps or standing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np

from pdr_filter.sensing.clock import MAX_GAP_S, ClockState, accept_rows, one_clock
from pdr_filter.sensing.stuck_sensors import WatchdogState, init_watchdog, remove_stuck_values
from pdr_filter.sensing.unit_check import UnitsState, check_units, init_units
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
from pdr_filter.values.arrays import finite_only
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import READING_KEY, Recording

# Columns of the buffered rows: time, specific force, angular rate, magnetic field, and the ages of the last finite
# angular rate and magnetic field.
_FORCE, _RATE, _FIELD, _MOTION, _VALUES = slice(1, 4), slice(4, 7), slice(7, 10), slice(1, 7), slice(1, 10)
_RATE_AGE, _FIELD_AGE = 10, 11
_N_COLUMNS = 12

# Phones saturate at 16 g (156.9 m/s2) and 2000 deg/s (35 rad/s), faster gyroscopes at twice that.
MAX_FORCE_MPS2, MAX_RATE_RADPS = 160.0, 100.0
# Phones' magnetometers saturate at 2 to 5 mT.
MAX_FIELD_UT = 1e4
# Largest plausible magnitude of each column: time, specific force, angular rate and magnetic field.
_LIMITS = np.repeat([np.inf, MAX_FORCE_MPS2, MAX_RATE_RADPS, MAX_FIELD_UT], [1, 3, 3, 3])
# Rows that are processed together, so that the intermediate arrays fit into the processor's cache.
_ROWS_AT_ONCE = 4000
# A note is written when this many rows in a row are rejected, or when this many arrive and no uniform sample results.
_MIN_REJECTED_ROWS = 200
# Resolution of an accelerometer from which a note is written. With 1 m/s2, directions of two of three real walks
# change by more than 10 degrees. With 0.5 m/s2 they do not change, and distances change by 0.2 %.
_COARSE_MPS2 = 0.7
_WITHOUT_RATE, _WITHOUT_FIELD = "used without angular rate", "used without magnetic field"
# Range of each axis of the specific force in a hop (0.2 s) below which the phone rests, m/s2. In 30 walks of ipin2023,
# humolire and ms_indoor, a phone in such a hop turns by 0.005 rad (root mean square), which is less than the heading
# drift. Without noise the sensor may be stuck.
_REST_MPS2 = 0.3
# Time without angular rate from which a note is written: the heading is then uncertain by 0.5 rad (`HeadingDrift`).
_MISSING_RATE_S = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class UniformBlock:
    """Consecutive samples at a constant rate.

    A block holds whole hops, except the last block of a segment. Where a sensor is missing for longer than
    `Conditioner.max_gap_s` its values are zero and `*_known` is False.

    Attributes
    ----------
    time_s : FloatArray
        Middle of the interval of each sample, shape (N,), s.
    specific_force_mps2 : FloatArray
        Specific force in the sensor frame, shape (N, 3), m/s2.
    angular_rate_radps : FloatArray
        Angular rate in the sensor frame, shape (N, 3), rad/s.
    angular_rate_known : BoolArray
        True where the angular rate was measured or bridged, shape (N,).
    turn_known : BoolArray
        True where the angular rate is known, or the specific force shows that the phone rests, shape (N,).
    magnetic_field_ut : FloatArray
        Magnetic field in the sensor frame, shape (N, 3), uT.
    magnetic_field_known : BoolArray
        True where the magnetic field was measured or bridged, shape (N,).
    gap_before_s : float
        Duration of the gap before the block, s. Zero if the block continues the previous one, infinite for the first
        block.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.conditioning import UniformBlock
    >>> rows, known = np.zeros((4, 3)), np.ones(4, dtype=bool)
    >>> block = UniformBlock(np.arange(4) / 100, rows, rows, known, known, rows, ~known, gap_before_s=np.inf)
    >>> len(block.time_s)
    4
    """

    time_s: FloatArray
    specific_force_mps2: FloatArray
    angular_rate_radps: FloatArray
    angular_rate_known: BoolArray
    turn_known: BoolArray
    magnetic_field_ut: FloatArray
    magnetic_field_known: BoolArray
    gap_before_s: float


@dataclass(frozen=True)
class IntakeReport:
    """Counts of the samples that the conditioner received, dropped and emitted."""

    n_received: int = 0  # rows received
    n_not_finite: int = 0  # rows without a finite time or specific force. They are bridged, or are part of a gap.
    # Rows with a specific force or angular rate beyond the range of any phone. A specific force beyond it drops the
    # row, an angular rate beyond it becomes missing.
    n_implausible: int = 0
    n_not_increasing: int = 0  # rows dropped because their time repeats an earlier one or lies before it
    n_clock_jumps: int = 0  # backward clock jumps. The track follows them.
    # Times at which the clock was far ahead of all later samples. Samples with such times are dropped.
    n_clock_glitches: int = 0
    n_dead_force: int = 0  # rows dropped because the accelerometer was stuck while the phone moved
    n_dead_rate: int = 0  # rows whose angular rate was discarded because the gyroscope was stuck while the phone moved
    # Rows whose magnetic field was discarded because the magnetometer was stuck while the phone turned.
    n_dead_field: int = 0
    # Smallest nonzero change of the specific force between two rows, m/s2. Infinite before the first.
    resolution_mps2: float = np.inf
    n_wild_field: int = 0  # rows whose magnetic field was discarded because it is beyond the range of any phone
    n_gaps: int = 0  # gaps between segments
    longest_gap_s: float = 0.0  # duration of the longest gap, s
    lost_s: float = 0.0  # total duration of all gaps, s
    n_emitted: int = 0  # uniform samples emitted
    n_without_rate: int = 0  # uniform samples with unknown angular rate
    n_without_turn: int = 0  # those of these in which the phone may have turned
    n_rejected_times: int = 0  # rows rejected since the last accepted row, because their times contradict it
    rate_hz: float = 100.0  # rate of the uniform samples, Hz
    first_time_s: float = np.nan  # time of the first accepted row, s. NaN before it.
    last_time_s: float = np.nan  # time of the last accepted row, s. NaN before the first.

    @property
    def has_gyroscope(self) -> bool:
        """False if all samples so far are without an angular rate."""
        return self.n_emitted == 0 or self.n_without_rate < self.n_emitted

    def sensor_notes(self) -> list[str]:
        """Return a warning for each sensor that was stuck, and for a coarse accelerometer."""
        found: list[str] = []
        for stuck, n_dead, treatment in (
            ("an axis of the accelerometer was stuck at one value while the phone moved", self.n_dead_force, "dropped"),
            ("an axis of the gyroscope was stuck at one value while the phone moved", self.n_dead_rate, _WITHOUT_RATE),
            ("the magnetometer was stuck at one value while the phone turned", self.n_dead_field, _WITHOUT_FIELD),
        ):
            if n_dead:
                found.append(f"{stuck}: {n_dead} of {self.n_received} samples were {treatment}")
        if _COARSE_MPS2 < self.resolution_mps2 < np.inf:
            found.append(
                f"the accelerometer is rounded to {self.resolution_mps2:.2g} m/s2, probably by the app: walking "
                "directions are less certain than stated; record it without rounding"
            )
        return found

    def notes(self) -> tuple[str, ...]:
        """Return one warning for each kind of repaired, dropped or missing samples, or an empty tuple without any."""
        found: list[str] = []
        if self.n_not_finite:
            found.append(
                f"{self.n_not_finite} of {self.n_received} samples had no finite value and were dropped: the app "
                "writes empty or infinite cells; short stretches are interpolated"
            )
        if self.n_implausible:
            found.append(
                f"{how_many(self.n_implausible, 'sample')} beyond {MAX_FORCE_MPS2:g} m/s2 or {MAX_RATE_RADPS:g} rad/s, "
                "the range of phone sensors, treated as missing: an impact, a wrong unit or a damaged file"
            )
        found += self.sensor_notes()
        if self.n_wild_field:
            found.append(
                f"{how_many(self.n_wild_field, 'magnetic field')} beyond {MAX_FIELD_UT:g} uT, the range of phone "
                "sensors: treated as missing"
            )
        if self.n_clock_jumps:
            found.append(
                f"the clock jumped back {how_often(self.n_clock_jumps)}: the phone corrected its time; later times "
                "continue from before the jump"
            )
        if self.n_clock_glitches:
            found.append(
                f"the clock jumped ahead and returned {how_often(self.n_clock_glitches)}: the samples between had "
                "wrong times and were dropped"
            )
        if self.n_not_increasing:
            found.append(
                f"{self.n_not_increasing} of {self.n_received} samples had a repeated or backward time and were dropped"
            )
        if self.n_rejected_times >= _MIN_REJECTED_ROWS:
            found.append(
                f"no sample accepted since {self.last_time_s:.1f} s: the times of the last {self.n_rejected_times} "
                "samples are constant or lie before it; check the clock of the app"
            )
        if self.n_received >= _MIN_REJECTED_ROWS and self.n_emitted == 0:
            found.append(
                "no two consecutive samples could be used: times must be in seconds (not ms, us or ns), at least four "
                "samples a second, and seconds since 1970 need 64 bits"
            )
        if self.n_gaps:
            found.append(
                f"{how_many(self.n_gaps, 'gap')} ({self.lost_s:.1f} s in all, longest "
                f"{self.longest_gap_s:.1f} s): steps in gaps are unknown, so the covariance was inflated"
            )
        missing_s = self.n_without_turn / self.rate_hz
        if not self.has_gyroscope:
            found.append("no gyroscope: the heading is unknown; only steps, contexts and distance can be trusted")
        elif missing_s > _MISSING_RATE_S:
            found.append(f"no angular rate for {missing_s:.1f} s: the heading is unknown during that time")
        return tuple(found)


@dataclass(frozen=True, eq=False)
class ConditionerState:
    """Buffered rows, the position of the uniform grid, and the report so far."""

    rows: FloatArray  # (R, 12) accepted rows that later uniform samples still need
    # Time of the first sample of the current segment, s, which is the origin of the uniform grid.
    segment_start_s: float
    n_emitted: int  # uniform samples already emitted in this segment
    gap_before_s: float  # gap before this segment, s. It is passed on with the first block of the segment.
    last_rate: FloatArray  # (4,) time and value of the last finite angular rate
    last_field: FloatArray  # (4,) time and value of the last finite magnetic field
    clock: ClockState  # state of the check of times
    watchdog: WatchdogState  # state of the detection of stuck sensors
    units: UnitsState  # state of the check of units and signs
    report: IntakeReport  # counts so far

    def notes(self) -> tuple[str, ...]:
        """Return warnings about units, signs and repaired samples, or an empty tuple."""
        return (*self.units.notes(), *self.report.notes())


@dataclass(frozen=True)
class Conditioner:
    """Causal stage that resamples raw samples to a constant rate and splits them at gaps.

    Parameters
    ----------
    rate_hz : float, default 100
        Rate of the output, Hz. Faster input is averaged over each interval, which is its anti-aliasing filter. Slower
        input is interpolated linearly.
    max_gap_s : float, default 0.3
        A longer time without samples, in s, is a gap: no sample is interpolated there, and later stages restart.
    hop_samples : int, default 20
        Output samples per hop. The output comes in whole hops, except for the remainder at a gap and at the end. Each
        hop costs the later stages as much as some hundred samples. A longer hop delays the detection of steps.

    Raises
    ------
    ValueError
        If a parameter is not a positive number.

    Examples
    --------
    Ten seconds at about 62 Hz become uniform samples at 100 Hz:

    >>> import numpy as np
    >>> from pdr_filter.sensing.conditioning import Conditioner
    >>> from pdr_filter.values import ImuBlock
    >>> time_s = np.arange(0.0, 10.0, 0.016)
    >>> zeros = np.zeros((len(time_s), 3))
    >>> conditioner = Conditioner()
    >>> samples = ImuBlock(time_s, zeros + [0.0, 0.0, 9.81], angular_rate_radps=zeros, magnetic_field_ut=zeros)
    >>> state, (uniform,) = conditioner.update(conditioner.init(), samples)
    >>> uniform.time_s[:3].round(3)
    array([0.005, 0.015, 0.025])
    >>> len(uniform.time_s), uniform.specific_force_mps2[0].round(2)
    (980, array([0.  , 0.  , 9.81]))
    """

    rate_hz: float = 100.0
    max_gap_s: float = MAX_GAP_S
    hop_samples: int = 20

    def __post_init__(self) -> None:
        check_numbers(self)

    def init(self) -> ConditionerState:
        """Return the state before the first sample.

        Returns
        -------
        ConditionerState
            Initial state.
        """
        never = np.array([-np.inf, 0.0, 0.0, 0.0])
        return ConditionerState(
            rows=np.empty((0, _N_COLUMNS)),
            segment_start_s=np.nan,
            n_emitted=0,
            gap_before_s=np.inf,
            last_rate=never,
            last_field=never,
            clock=ClockState(),
            watchdog=init_watchdog(),
            units=init_units(),
            report=IntakeReport(rate_hz=self.rate_hz),
        )

    def update(self, state: ConditionerState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        """Return the new state and the hops completed by a block of raw samples.

        Parameters
        ----------
        state : ConditionerState
            State after the previous block.
        block : ImuBlock
            Raw samples of any number, rate and order, with NaN where a value is missing.

        Returns
        -------
        state : ConditionerState
            New state.
        blocks : list of UniformBlock
            Uniform samples in whole hops. A new element begins after each gap.
        """
        outputs: list[UniformBlock] = []
        for part in block.parts(_ROWS_AT_ONCE):
            state, found = self._update_part(state, part)
            outputs += found
        return state, _blocks_between_gaps(outputs)

    def quiet_s(self, state: ConditionerState) -> tuple[float, float]:
        """Return the times between which rows complete no hop.

        Such rows may be processed together with later ones. There are none before the first hop and the first check of
        units, and while the clock is in doubt.

        Parameters
        ----------
        state : ConditionerState
            State after the previous block.

        Returns
        -------
        after_s : float
            The rows have increasing times after this time, s.
        until_s : float
            The last row has this time or an earlier one, s. Minus infinity if there are no such rows.
        """
        clock = state.clock
        is_begun = state.report.n_emitted > 0 and state.units.n > 0 and len(state.rows) > 0
        if not is_begun or clock.held or clock.n_behind or clock.offset_s:
            return np.inf, -np.inf
        until_s = state.segment_start_s + (state.n_emitted + self.hop_samples) / self.rate_hz
        return clock.last_s, min(until_s, float(state.rows[-1, 0]) + self.max_gap_s)

    def finish(self, state: ConditionerState) -> tuple[ConditionerState, list[UniformBlock]]:
        """Return the new state and the remainder of the last hop, when no further sample will come.

        Parameters
        ----------
        state : ConditionerState
            State after the last block.

        Returns
        -------
        state : ConditionerState
            New state.
        blocks : list of UniformBlock
            Remaining uniform samples, at most one block. Empty if the segment has not yet emitted a hop.
        """
        # A segment that has not emitted anything is too short for the later stages to start with.
        return self._resample(state, state.rows, hop_samples=1) if state.n_emitted > 0 else (state, [])

    def _update_part(self, state: ConditionerState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        """Return the new state and the completed hops for at most `_ROWS_AT_ONCE` raw samples.

        A hop is a block of `hop_samples` uniform samples. At a gap, the remainder of the last hop is returned as well,
        as a shorter block, unless the segment is too short to have a complete hop.
        """
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
        """Return the new state and the accepted rows (N, 12).

        A row has the time, specific force, angular rate, magnetic field, and the ages of the last two. Accepted rows
        have a finite specific force and increasing times. A missing angular rate or magnetic field is held at its last
        value. Its age is the time since it was measured.
        """
        raw = np.empty((len(block.time_s), 10))
        raw[:, 0], raw[:, _FORCE] = block.time_s, block.specific_force_mps2
        raw[:, _RATE], raw[:, _FIELD] = block.angular_rate_radps, block.magnetic_field_ut
        usable, n_not_finite, n_implausible, n_wild_field = _usable_rows(raw)
        accepted = accept_rows(state.clock, usable, self.max_gap_s)
        timed = accepted.rows
        measured, n_dead_force, n_dead_rate, n_dead_field = timed[:, _VALUES], 0, 0, 0
        watchdog, values = remove_stuck_values(state.watchdog, timed[:, 0], measured)
        if values is not measured:  # a sensor is stuck
            is_dead = np.isnan(values[:, 0])
            lost = (np.isnan(values) & ~np.isnan(measured)).sum(axis=0).tolist()
            n_dead_force, n_dead_rate, n_dead_field = lost[::3]
            timed, values = timed[~is_dead], values[~is_dead]
        rows = np.empty((len(values), _N_COLUMNS))
        rows[:, 0], rows[:, _FORCE] = timed[:, 0], values[:, :3]
        rows[:, _RATE], rows[:, _RATE_AGE], last_rate = _hold(rows[:, 0], values[:, 3:6], state.last_rate)
        rows[:, _FIELD], rows[:, _FIELD_AGE], last_field = _hold(rows[:, 0], values[:, 6:], state.last_field)
        old = state.report
        report = replace_unchecked(
            old,
            n_received=old.n_received + len(raw),
            n_not_finite=old.n_not_finite + n_not_finite,
            n_implausible=old.n_implausible + n_implausible,
            n_not_increasing=old.n_not_increasing + accepted.n_dropped,
            n_clock_jumps=old.n_clock_jumps + accepted.n_set_backs,
            n_clock_glitches=old.n_clock_glitches + accepted.n_glitches,
            n_rejected_times=accepted.clock.n_rejected_times,
            n_dead_force=old.n_dead_force + n_dead_force,
            n_dead_rate=old.n_dead_rate + n_dead_rate,
            n_dead_field=old.n_dead_field + n_dead_field,
            resolution_mps2=float(watchdog.resolution[0]),
            n_wild_field=old.n_wild_field + n_wild_field,
        )
        if len(rows):
            first = rows[0, 0] if np.isnan(old.first_time_s) else old.first_time_s
            report = replace_unchecked(report, first_time_s=float(first), last_time_s=float(rows[-1, 0]))
        units = check_units(state.units, timed[:, 0], timed[:, _MOTION])
        checks = {"clock": accepted.clock, "watchdog": watchdog, "units": units, "report": report}
        return replace_unchecked(state, last_rate=last_rate, last_field=last_field, **checks), rows

    def _start_segment(self, state: ConditionerState, part: FloatArray) -> ConditionerState:
        """Return the state at the start of the segment that begins with the rows `part` after a gap.

        The gap is counted.
        """
        # The gap is counted from the end of the emitted samples. A segment that emitted nothing was never reported, so
        # the gap before it is added to this one.
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
        """Return the new state and the uniform samples of all whole hops of `hop_samples` that the rows cover.

        Each uniform sample is the mean of the linear interpolant over its interval of the grid.
        """
        # A grid point needs a sample after it. Without this rule its last bits would depend on where blocks are cut.
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
        # A value counts as known if the last finite measurement before it is at most `max_gap_s` old.
        at = np.minimum(np.searchsorted(rows[:, 0], grid[1:]), len(rows) - 1)
        rate_known = rows[at, _RATE_AGE] <= self.max_gap_s
        field_known = rows[at, _FIELD_AGE] <= self.max_gap_s
        turn_known = rate_known
        if not rate_known.all():
            range_mps2 = np.ptp(means[:, 0:3].reshape(-1, hop_samples, 3), axis=1).max(axis=1)
            turn_known = rate_known | np.repeat((range_mps2 > 0) & (range_mps2 < _REST_MPS2), hop_samples)
        output = UniformBlock(
            time_s=grid[1:] - 0.5 / self.rate_hz,
            specific_force_mps2=np.ascontiguousarray(means[:, 0:3]),
            angular_rate_radps=np.where(rate_known[:, None], means[:, 3:6], 0.0),
            angular_rate_known=rate_known,
            turn_known=turn_known,
            magnetic_field_ut=np.where(field_known[:, None], means[:, 6:9], 0.0),
            magnetic_field_known=field_known,
            gap_before_s=state.gap_before_s if state.n_emitted == 0 else 0.0,
        )
        first_needed = max(int(np.searchsorted(rows[:, 0], grid[-1], side="right")) - 1, 0)
        report = replace_unchecked(
            state.report,
            n_emitted=state.report.n_emitted + len(rate_known),
            n_without_rate=state.report.n_without_rate + len(rate_known) - int(np.count_nonzero(rate_known)),
            n_without_turn=state.report.n_without_turn + len(turn_known) - int(np.count_nonzero(turn_known)),
        )
        new = replace_unchecked(state, rows=rows[first_needed:], n_emitted=n_complete, report=report)
        return new, [output]


def _blocks_between_gaps(blocks: Sequence[UniformBlock]) -> list[UniformBlock]:
    """Return the blocks with consecutive ones concatenated unless a gap separates them."""
    runs: list[list[UniformBlock]] = []
    for block in blocks:
        if runs and block.gap_before_s == 0:
            runs[-1].append(block)
        else:
            runs.append([block])
    return [_one_block(run) if len(run) > 1 else run[0] for run in runs]


def _one_block(run: Sequence[UniformBlock]) -> UniformBlock:
    """Return consecutive blocks as one block."""
    names = [f.name for f in fields(UniformBlock) if f.name != "gap_before_s"]
    joined = {name: np.concatenate([getattr(block, name) for block in run]) for name in names}
    return UniformBlock(**joined, gap_before_s=run[0].gap_before_s)


def _usable_rows(raw: FloatArray) -> tuple[FloatArray, int, int, int]:
    """Return the usable rows (N, 10) of time, force, rate and field, and three counts.

    Rows without a finite time and force and rows with an implausible force are dropped. An implausible angular rate or
    magnetic field becomes NaN. The counts are of rows that are not finite, rows with an implausible force or rate, and
    rows with an implausible field.
    """
    finite, beyond = np.isfinite(raw[:, :4]), np.abs(raw) > _LIMITS  # NaN compares False, so it is never beyond
    if finite.all() and not beyond.any():
        return raw, 0, 0, 0
    wild_force, wild_rate, wild_field = (beyond[:, part].any(axis=1) for part in (_FORCE, _RATE, _FIELD))
    is_finite = finite.all(axis=1)
    n_wild = int((is_finite & (wild_force | wild_rate)).sum())
    raw[wild_rate, _RATE] = raw[wild_field, _FIELD] = np.nan
    return raw[is_finite & ~wild_force], int((~is_finite).sum()), n_wild, int(wild_field.sum())


def _hold(time_s: FloatArray, values: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the values with missing rows held at the last finite row, their ages, and the new last finite row.

    The age of a row is the time since its values were measured, in s, and 0 if it was measured itself. `last` and the
    third result are time and value, shape (4,).
    """
    if np.isfinite(values).all():
        newest = np.concatenate([time_s[-1:], values[-1]]) if len(values) else last
        return values, np.zeros(len(values)), newest
    stack = np.vstack([last, np.column_stack([time_s, values])])
    finite = np.isfinite(stack[:, 1:]).all(axis=1)
    index = np.maximum.accumulate(np.where(finite, np.arange(len(stack)), 0))
    held = stack[index]
    return held[1:, 1:], time_s - held[1:, 0], held[-1]


def _interval_means(time_s: FloatArray, values: FloatArray, grid_s: FloatArray) -> FloatArray:
    """Return the mean of the linear interpolant through (time, value) over each grid interval, (len(grid) - 1, d)."""
    right = np.minimum(np.maximum(time_s.searchsorted(grid_s, side="right"), 1), len(time_s) - 1)
    left = right - 1
    fraction = ((grid_s - time_s[left]) / (time_s[right] - time_s[left]))[:, None]
    before = values.take(left, axis=0)
    at_grid = values.take(right, axis=0)
    at_grid -= before
    at_grid *= fraction
    at_grid += before
    # Merge samples and grid points into one sorted list of knots. A grid point precedes samples at the same time.
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
    # reduceat adds row by row within each interval, so the order of additions does not depend on where blocks are cut.
    return np.add.reduceat(areas, first, axis=0) / (grid_s[1:] - grid_s[:-1])[:, None]


def merge_streams(recording: Recording, max_gap_s: float = MAX_GAP_S) -> ImuBlock:
    """Return all inertial sensors of a recording at the times of its accelerometer.

    Angular rate and magnetic field are interpolated linearly. Samples that are less than 0.1 s behind an earlier one
    are sorted by time, others stay in recorded order. If the clock was set back during the recording, later times
    continue from before the jump.

    Parameters
    ----------
    recording : Recording
        Recording with an accelerometer and optionally a gyroscope and a magnetometer.
    max_gap_s : float, default 0.3
        Longest time between two samples of a stream, in s, that is interpolated. Before its first sample and after its
        last sample, a stream keeps the value of that sample for less than this time.

    Returns
    -------
    ImuBlock
        Times, specific force, angular rate and magnetic field with one row for each accelerometer sample. Values are
        NaN where a stream is missing or its samples are further apart than `max_gap_s`.

    Raises
    ------
    RecordingError
        If no time of the gyroscope or the magnetometer lies within the times of the accelerometer.

    Examples
    --------
    A gyroscope at half the rate of the accelerometer, in a recording without a magnetometer:

    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> time_s = np.arange(0.0, 1.0, 0.01)
    >>> accelerometer = pdr.Samples(time_s, np.full((100, 3), 5.7))
    >>> gyroscope = pdr.Samples(time_s[::2], np.column_stack(3 * [time_s[::2]]))
    >>> samples = pdr.merge_streams(pdr.Recording("walk", accelerometer, gyroscope))
    >>> samples.angular_rate_radps[:3, 0]
    array([0.  , 0.01, 0.02])
    >>> np.isnan(samples.magnetic_field_ut).all()
    np.True_
    """
    (block,) = merged_parts(recording, max(len(recording.accelerometer), 1), max_gap_s)
    return block


def merged_parts(recording: Recording, n: int, max_gap_s: float = MAX_GAP_S) -> Iterator[ImuBlock]:
    """Yield the block of `merge_streams` in consecutive parts of at most n samples, one part at least.

    A part is interpolated when it is due, so that the whole block is never in memory.
    """
    recording, _ = one_clock(recording)
    force = recording.accelerometer
    others = recording.gyroscope, recording.magnetometer
    for sensor, stream in zip(("gyroscope", "magnetometer"), others, strict=True):
        _check_clock(recording, sensor, stream, max_gap_s)
    usable = [None if stream is None else _usable_samples(stream) for stream in others]
    for start in range(0, max(len(force), 1), n):
        part = slice(start, start + n)
        at_s = force.time_s[part]
        unknown = np.full((len(at_s), 3), np.nan)
        rate, field_ut = (unknown if s is None else at_times(s.time_s, s.values, at_s, max_gap_s) for s in usable)
        yield ImuBlock(at_s, force.values[part], rate, field_ut)


def _check_clock(recording: Recording, sensor: str, stream: Samples | None, max_gap_s: float) -> None:
    """Raise RecordingError if no time of a stream lies within the times of the accelerometer: the clocks differ."""
    at_s = finite_only(recording.accelerometer.time_s)
    own_s = finite_only(np.empty(0) if stream is None else stream.time_s)
    if len(own_s) < 2 or not len(at_s):
        return
    if own_s.min() > at_s.max() + max_gap_s or own_s.max() < at_s.min() - max_gap_s:
        reading: Any = recording.meta.get(READING_KEY)  # may come from an untrusted file, so that its type is checked
        clock = str(cast("dict[str, Any]", reading).get("clock", "")) if isinstance(reading, dict) else ""
        clock = f" ({clock[:300]})" if clock else ""
        raise RecordingError(
            f"{recording.source or recording.name}: {sensor}: its times, {own_s.min():.1f} to {own_s.max():.1f} s, are "
            f"outside those of the accelerometer, {at_s.min():.1f} to {at_s.max():.1f} s{clock}: the sensor is on "
            "another clock or its times have another unit; add the offset of the clocks to its times, give it the time "
            "column of the accelerometer in the mapping that pdr-filter convert writes, or remove the stream"
        )


def _usable_samples(stream: Samples) -> Samples:
    """Return the samples of a stream without rows that are not finite or not increasing."""
    time_s, values = stream.time_s, stream.values
    if np.isfinite(values).all() and (time_s[1:] > time_s[:-1]).all() and np.isfinite(time_s[-1:]).all():
        return stream
    good = np.isfinite(time_s) & np.isfinite(values).all(axis=1)
    time_s, first = np.unique(time_s[good], return_index=True)
    return Samples(time_s, values[good][first])


def at_times(time_s: FloatArray, values: FloatArray, at_s: FloatArray, max_gap_s: float) -> FloatArray:
    """Return values (N, 3) at increasing times (N,), interpolated linearly at other times (M,), shape (M, 3).

    The result is NaN between two neighbouring samples that are more than `max_gap_s` apart. At the time of a sample it
    is the value of that sample. A time before the first or after the last sample by less than `max_gap_s` gets the
    value of that sample, unless the first or last two samples are more than `max_gap_s` apart. Each result depends only
    on the two samples around it, or on the last two samples if none follows. With fewer than two samples all results
    are NaN.
    """
    if len(time_s) < 2 or not len(at_s):
        return np.full((len(at_s), 3), np.nan)
    same = slice(first := int(time_s.searchsorted(at_s[0])), first + len(at_s))
    if np.array_equal(time_s[same], at_s):
        return values[same]
    right = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    left_s, right_s = time_s[right - 1], time_s[right]
    # Sensors of one phone start and end a few samples apart. The first and last values are held, because linear
    # extrapolation would amplify noise.
    covered = (at_s > time_s[0] - max_gap_s) & (at_s < time_s[-1] + max_gap_s)
    measured = (at_s == left_s) | (at_s == right_s)  # true also for the samples at the edges of a gap
    near = covered & (measured | (right_s - left_s <= max_gap_s))
    fraction = np.clip((at_s - left_s) / (right_s - left_s), 0.0, 1.0)[:, None]
    before, after = values.take(right - 1, axis=0), values.take(right, axis=0)
    between = before + (after - before) * fraction
    # A value measured at exactly the requested time is copied. Rounding it would make the result depend on the other
    # requested times, because equal time arrays return the values unchanged.
    np.copyto(between, after, where=fraction == 1.0)
    between[~near] = np.nan
    return between
