"""Merge the streams of single sensors, which arrive late and out of step, into the samples of `merge_streams`.

A sample of the accelerometer waits until the other sensors have passed its time. It is then released with their values
at this time, bit by bit those that `merge_streams` gives for the finished recording. Only the times of the samples
count, never a wall clock:

- Samples of one sensor may arrive in any order within `reorder_s` of the newest. A sample that is further behind is
  late, and is dropped, also if it could still be merged: the result does not depend on the division into messages.
- If a sensor has a hole of more than `max_gap_s` and of more than 2.5 usual intervals, the later samples wait until
  they span `wait_s`, because an overtaken message may still fill the hole.
- A sensor that is more than `wait_s` behind the accelerometer is silent, and the merger no longer waits for it. A
  sensor that has not begun is silent after the first `wait_s`.
- The slowest sensor decides the delay: a barometer at 1 Hz delays the samples by up to a second.
- Samples are released only after a sensor has advanced by `bunch_s`, so that samples that arrive one by one are
  processed in small groups.
- If only late samples of the accelerometer arrive for a minute, the clock was set back. The merger then restarts, and
  `sensing.clock` follows the clock.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np

from pdr_filter.sensing.clock import MAX_GAP_S, REORDER_S, is_behind, latest_before
from pdr_filter.sensing.conditioning import at_times
from pdr_filter.values import BoolArray, FloatArray, ImuBlock, Note, Samples, check_numbers, replace_unchecked
from pdr_filter.values.arrays import finite_only
from pdr_filter.values.limits import GAP_INTERVALS

Sensor = Literal["accelerometer", "gyroscope", "magnetometer", "barometer"]
SENSORS: tuple[Sensor, ...] = get_args(Sensor)
# Consequence of a time without the samples of a sensor.
_LOST = {
    "accelerometer": "the track has no steps there and its deviations do not cover them",
    "barometer": "heights and storeys are uncertain",
    "gyroscope": "the walking direction is unknown there without heading fixes, and contexts are less certain",
}
_COLUMNS = {"accelerometer": 3, "gyroscope": 3, "magnetometer": 3, "barometer": 1}
# Largest number of buffered rows of each sensor: twice `wait_s` at the rate of the fastest phones, 2000 Hz.
_MAX_ROWS = 20_000
# Time spanned by uninterrupted late samples, in s, that shows a backward clock jump. A shorter span may be a backlog
# that is sent again after a network failure.
_SET_BACK_S = 60.0
# Number of recent samples from which the rate of a sensor is estimated.
_RATE_SAMPLES = 64


def absences(spans_s: Mapping[Sensor, tuple[float, float]], wait_s: float) -> list[Note]:
    """Return notes about sensors that began later or stopped earlier than others.

    Parameters
    ----------
    spans_s : mapping of str to (float, float)
        Times of the first and the last sample of each sensor, s.
    wait_s : float
        Difference that is not reported, s.

    Returns
    -------
    list of Note
        One note for each missing beginning or end.
    """
    notes: list[Note] = []
    earliest_s = min((first_s for first_s, _ in spans_s.values()), default=math.inf)
    latest_s = max((last_s for _, last_s in spans_s.values()), default=-math.inf)
    for sensor, (first_s, last_s) in spans_s.items():
        lost = _LOST.get(sensor, "the other sensors are used without it")
        remedy = (
            f"so that {lost}: record it as long as the others; if it has samples there, put all sensors on one clock"
        )
        if first_s - earliest_s > wait_s:
            others = f"other sensors from {earliest_s:z.1f} s"
            notes.append(Note("sensors", f"{sensor}: no samples before {first_s:z.1f} s ({others}), {remedy}"))
        if latest_s - last_s > wait_s:
            others = f"other sensors until {latest_s:z.1f} s"
            notes.append(Note("sensors", f"{sensor}: no samples since {last_s:z.1f} s ({others}), {remedy}"))
    return notes


def absences_in(streams: Mapping[str, Samples]) -> list[Note]:
    """Return the notes of `absences` for the streams of a recording, by their names."""
    spans_s: dict[Sensor, tuple[float, float]] = {}
    for sensor in SENSORS:
        time_s = finite_only(streams[sensor].time_s if sensor in streams else np.empty(0))
        if len(time_s):
            spans_s[sensor] = float(time_s.min()), float(time_s.max())
    return absences(spans_s, StreamMerger().wait_s)


@dataclass(frozen=True, eq=False)
class StreamState:
    """Buffer of one sensor."""

    # (N, 1 + d) times and values of the samples that wait or are still needed, in order of time.
    rows: FloatArray
    # Times of the last samples in the order of their arrival, s.
    recent_s: FloatArray = field(default_factory=lambda: np.empty(0))
    first_s: float = math.inf  # smallest time of a sample, s; inf before the first
    n_received: int = 0  # samples received
    n_late: int = 0  # samples dropped because they were late
    n_sorted: int = 0  # samples that were slightly behind an earlier one, and were sorted by time

    @property
    def last_s(self) -> float:
        """Time of the last sample that arrived, s; -inf before the first."""
        return float(self.recent_s[-1]) if len(self.recent_s) else -np.inf

    @property
    def rate_hz(self) -> float:
        """Rate of the sensor, Hz: the reciprocal of the mean interval of its last samples, without holes.

        Times in whole milliseconds have a wrong median: at 418 Hz it is 2 ms. NaN before the second sample.
        """
        intervals_s = np.diff(np.unique(self.recent_s))
        if not len(intervals_s):
            return np.nan
        return float(1.0 / np.mean(intervals_s[intervals_s <= GAP_INTERVALS * np.median(intervals_s)]))

    @property
    def emptied(self) -> StreamState:
        """Buffer without samples, which keeps the counts of samples."""
        return StreamState(self.rows[:0], n_received=self.n_received, n_late=self.n_late, n_sorted=self.n_sorted)


@dataclass(frozen=True, eq=False)
class MergerState:
    """Buffers of all sensors, and the times up to which samples were released."""

    streams: tuple[StreamState, ...]  # buffers in the order of `SENSORS`
    first_s: float = np.nan  # smallest time of the accelerometer, s. NaN before its first sample.
    released_s: float = -np.inf  # time of the last released sample of the accelerometer, s
    pressure_s: float = -np.inf  # time of the last released sample of the barometer, s
    # Last time of each sensor when the merger last checked which samples can be released, s
    looked_s: tuple[float, ...] = len(SENSORS) * (-np.inf,)
    # Smallest and largest time of the late samples of the accelerometer since its last sample in time, s. NaN if there
    # are none.
    late_s: tuple[float, float] = (np.nan, np.nan)

    def stream(self, sensor: Sensor) -> StreamState:
        """Return the buffer of a sensor."""
        return self.streams[SENSORS.index(sensor)]

    @property
    def has_received(self) -> bool:
        """True if any sensor has received samples."""
        return any(stream.n_received for stream in self.streams)

    @property
    def is_used(self) -> bool:
        """True if the merger has received samples of the accelerometer."""
        return self.stream("accelerometer").n_received > 0


class Merged(NamedTuple):
    """Released samples. Pass the pressures to the filter before the inertial samples."""

    pressure_time_s: FloatArray  # (B,) times of the barometer samples, s
    pressure_hpa: FloatArray  # (B,) pressures, hPa
    block: ImuBlock  # samples of the accelerometer with the other sensors interpolated at their times


@dataclass(frozen=True)
class StreamMerger:
    """Causal stage that merges separately arriving streams; the rules are in the docstring of the module.

    Parameters
    ----------
    wait_s : float, default 5
        Largest delay of a sample against the accelerometer, on the clock of the samples, s. After this time a silent
        sensor is no longer waited for.
    reorder_s : float, default 0.1
        Largest time by which a sample may be behind a later one of its sensor, s. All samples are delayed by this time.
        For messages over a network that can overtake each other, use the duration of one message, or sort them first.
    bunch_s : float, default 0.05
        Largest additional delay of a released sample, s.
    max_gap_s : float, default 0.3
        Longest interpolated interval, s, as in `merge_streams`.
    """

    wait_s: float = 5.0
    reorder_s: float = REORDER_S
    bunch_s: float = 0.05
    max_gap_s: float = MAX_GAP_S

    def __post_init__(self) -> None:
        check_numbers(self, zero=("reorder_s", "bunch_s"))

    def init(self) -> MergerState:
        """Return the state before the first sample."""
        return MergerState(tuple(StreamState(np.empty((0, 1 + _COLUMNS[sensor]))) for sensor in SENSORS))

    def together(
        self, state: MergerState, samples: Mapping[Sensor, tuple[FloatArray, FloatArray]]
    ) -> tuple[MergerState, Merged]:
        """Return the new state and the released samples after samples of several sensors that arrive in one message.

        `samples` maps each sensor to its times (N,) and values (N, d).
        """
        for sensor in SENSORS:  # the accelerometer comes first, because its times decide which other samples are needed
            if sensor in samples:
                state = self._with_rows(state, sensor, np.column_stack(samples[sensor]))
        force = state.stream("accelerometer")
        further_s = [abs(state.stream(s).last_s - state.looked_s[SENSORS.index(s)]) for s in samples]
        # With a clock that stands still no sensor advances, so the size of the buffer also triggers a release.
        if all(s < self.bunch_s for s in further_s) and len(force.rows) <= _MAX_ROWS:
            return state, _NOTHING
        state = replace_unchecked(state, looked_s=tuple(stream.last_s for stream in state.streams))
        before_s = state.released_s if np.isfinite(state.released_s) else float(force.rows[:1, 0].sum())
        n_whole = self._n_whole(force, len(force.rows), before_s)
        frontier_s = float(force.rows[n_whole - 1, 0]) if n_whole else state.released_s
        passed_s = {name: self._passed_s(state.stream(name), frontier_s) for name in SENSORS[1:]}
        first_s = -np.inf if math.isnan(state.first_s) else state.first_s
        awaited_s = [p for p in passed_s.values() if frontier_s - max(p, first_s) <= self.wait_s]
        ready_s = min([frontier_s, *awaited_s]) - self.reorder_s
        n = min(int(np.searchsorted(force.rows[:, 0], ready_s, side="right")), n_whole)
        return self._release(state, max(n, len(force.rows) - _MAX_ROWS), passed_s["barometer"] - self.reorder_s)

    def finish(self, state: MergerState) -> tuple[MergerState, Merged]:
        """Return the new state and all samples that are still buffered."""
        return self._release(state, len(state.stream("accelerometer").rows), np.inf)

    def absences(self, state: MergerState) -> list[Note]:
        """Return notes about sensors that began later or stopped earlier than others by more than `wait_s`."""
        streams = zip(SENSORS, state.streams, strict=True)
        return absences({name: (s.first_s, s.last_s) for name, s in streams if math.isfinite(s.first_s)}, self.wait_s)

    def _with_rows(self, state: MergerState, sensor: Sensor, new: FloatArray) -> MergerState:
        """Return the state with new rows (N, 1 + d) of a sensor buffered in order of time and late rows dropped.

        Rows without a finite time are dropped, and so are rows of other sensors than the accelerometer if any value is
        missing.
        """
        finite = np.isfinite(new)
        timed = new if finite.all() else new[finite[:, 0]]
        # Interpolation needs both neighbours, so rows with a missing value are dropped.
        known = timed if sensor == "accelerometer" else new[finite.all(axis=1)]
        state, kept, n_sorted = self._without_late(state, sensor, known)
        stream = state.stream(sensor)
        rows = np.concatenate([stream.rows, kept])
        intervals_s = rows[1:, 0] - rows[:-1, 0]
        if sensor != "accelerometer" and (intervals_s <= 0).any():
            rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
        elif (intervals_s < 0).any():
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
        n_over = 0 if sensor == "accelerometer" else max(len(rows) - _MAX_ROWS, 0)
        stream = replace_unchecked(
            stream,
            rows=rows[n_over:],
            recent_s=np.concatenate([stream.recent_s, timed[:, 0]])[-_RATE_SAMPLES:],
            first_s=float(timed[:, 0].min(initial=stream.first_s)),
            n_received=stream.n_received + len(new),
            n_late=stream.n_late + len(known) - len(kept),
            n_sorted=stream.n_sorted + n_sorted,
        )
        return _with_stream(state, sensor, stream)

    def _without_late(
        self, state: MergerState, sensor: Sensor, rows: FloatArray
    ) -> tuple[MergerState, FloatArray, int]:
        """Return the state, the rows of a sensor that are not late, and how many of these are behind an earlier one.

        Samples of the accelerometer alone show that the clock was set back. The state is then restarted.
        """
        is_late, n_sorted = self._late_rows(state, sensor, rows)
        if sensor == "accelerometer" and not is_late.any():
            if len(rows):
                first_s = float(rows[:, 0].min()) if np.isnan(state.first_s) else state.first_s
                state = replace_unchecked(state, first_s=first_s, late_s=_NO_LATE)
        elif sensor == "accelerometer":
            for i, (time_s, late) in enumerate(zip(rows[:, 0].tolist(), is_late.tolist(), strict=True)):
                begin_s, end_s = state.late_s
                late_s = (float(np.fmin(begin_s, time_s)), float(np.fmax(end_s, time_s))) if late else _NO_LATE
                state = replace_unchecked(state, late_s=late_s)
                if late_s[1] - late_s[0] > _SET_BACK_S:
                    emptied = MergerState(tuple(stream.emptied for stream in state.streams))
                    return self._without_late(emptied, sensor, rows[i:])
        return state, rows[~is_late], n_sorted

    def _late_rows(self, state: MergerState, sensor: Sensor, rows: FloatArray) -> tuple[BoolArray, int]:
        """Return which rows of a sensor are late, shape (N,), and how many others are behind an earlier one."""
        stream, released_s = state.stream(sensor), state.pressure_s if sensor == "barometer" else state.released_s
        before_s = state.released_s if sensor == "accelerometer" else -np.inf
        time_s, newest_s = rows[:, 0], float(stream.rows[-1, 0]) if len(stream.rows) else before_s
        latest_s = latest_before(time_s, newest_s)
        if (time_s > latest_s).all():
            return time_s <= released_s, 0
        # Rows after a hole do not make the rows late that may still fill it.
        in_order = np.concatenate([stream.rows, rows[time_s > latest_s]])
        before_s = before_s if np.isfinite(before_s) else float(in_order[0, 0])
        n_whole = self._n_whole(replace_unchecked(stream, rows=in_order), len(in_order), before_s)
        whole_s = float(in_order[n_whole - 1, 0]) if n_whole else before_s
        latest_s = latest_before(np.where(time_s > whole_s, -np.inf, time_s), min(newest_s, whole_s))
        is_late = is_behind(time_s, latest_s, self.reorder_s) | (time_s <= released_s)
        return is_late, int((~is_late & (time_s < latest_s)).sum())

    def _n_whole(self, stream: StreamState, n: int, before_s: float, others_s: float = -np.inf) -> int:
        """Return how many of the first n rows of a sensor precede the first hole that may still be filled.

        A hole is an interval longer than `max_gap_s` and than 2.5 usual intervals of the sensor. Late samples may still
        fill it as long as the samples after it span less than `wait_s`. `before_s` is the time of the sample before
        these rows. For a sensor other than the accelerometer, `others_s` is the last usable time of the accelerometer.
        If it is more than `wait_s` after the beginning of a hole, the hole is no longer waited for. For the
        accelerometer itself it is minus infinity, because the accelerometer waits for no other sensor.
        """
        time_s = stream.rows[:n, 0]
        intervals_s = time_s.copy()
        intervals_s[:1] -= before_s
        intervals_s[1:] -= time_s[:-1]
        if not (intervals_s > self.max_gap_s).any():
            return n
        usual_s = 1.0 / stream.rate_hz if stream.rate_hz > 0 else 0.0
        holes = np.flatnonzero(intervals_s > max(self.max_gap_s, GAP_INTERVALS * usual_s))
        begin_s = time_s[holes] - intervals_s[holes]
        waits = holes[(time_s[-1] - time_s[holes] < self.wait_s) & (others_s - begin_s <= self.wait_s)]
        return int(waits[0]) if len(waits) else n

    def _passed_s(self, stream: StreamState, frontier_s: float) -> float:
        """Return the time up to which a sensor other than the accelerometer is complete.

        Samples more than `wait_s` after `frontier_s`, the end of the complete accelerometer samples, are ignored. The
        result is minus infinity without a usable sample, and with only one of a sensor that is interpolated.
        """
        time_s = stream.rows[:, 0]
        n = int(time_s.searchsorted(frontier_s + self.wait_s, side="right"))
        n = self._n_whole(stream, n, float(time_s[0]), frontier_s) if n else 0
        # Values before the first sample are computed from the first two samples, so one sample is not enough. The
        # barometer is not interpolated.
        interpolates = stream.rows.shape[1] > 2
        return float(time_s[n - 1]) if n > interpolates else -np.inf

    def _release(self, state: MergerState, n: int, pressure_until_s: float) -> tuple[MergerState, Merged]:
        """Return the state and the released samples: the first n accelerometer rows, and pressures up to a time."""
        force, pressure = state.stream("accelerometer"), state.stream("barometer")
        due = int(pressure.rows[:, 0].searchsorted(pressure_until_s, side="right"))
        out = pressure.rows[:due][pressure.rows[:due, 0] > state.pressure_s]
        if n == len(out) == 0:
            return state, _NOTHING
        leaving, left = force.rows[:n], force.rows[n:]
        time_s = leaving[:, 0]
        others = (state.stream(sensor).rows for sensor in ("gyroscope", "magnetometer"))
        rate, field_ut = (at_times(rows[:, 0], rows[:, 1:], time_s, self.max_gap_s) for rows in others)
        block = ImuBlock(time_s, leaving[:, 1:], rate, field_ut)
        if n:
            state = replace_unchecked(state, released_s=float(time_s[-1]))
            state = _with_stream(state, "accelerometer", replace_unchecked(force, rows=left))
            for sensor in ("gyroscope", "magnetometer"):
                stream = state.stream(sensor)
                # Keep two samples before the release time, because values after the last sample of a stream are
                # computed from its last two samples.
                first = max(int(np.searchsorted(stream.rows[:, 0], state.released_s, side="right")) - 2, 0)
                state = _with_stream(state, sensor, replace_unchecked(stream, rows=stream.rows[first:]))
        if len(out):
            state = replace_unchecked(state, pressure_s=float(out[-1, 0]))
            state = _with_stream(state, "barometer", replace_unchecked(pressure, rows=pressure.rows[due - 1 :]))
        return state, Merged(out[:, 0], out[:, 1], block)


_NO_LATE = (np.nan, np.nan)
_NOTHING = Merged(np.empty(0), np.empty(0), ImuBlock(np.empty(0), *np.empty((3, 0, 3))))


def _with_stream(state: MergerState, sensor: Sensor, stream: StreamState) -> MergerState:
    """Return the state with the buffer of one sensor replaced."""
    at = SENSORS.index(sensor)
    return replace_unchecked(state, streams=(*state.streams[:at], stream, *state.streams[at + 1 :]))
