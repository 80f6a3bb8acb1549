"""Streams of single sensors as they arrive, out of step and late, in; what `merge_streams` gives on all of them, out.

A sample of the accelerometer waits until the other sensors have passed its time; then it leaves with their values
there, the same bits that the finished recording gives. Times of the samples are the only clock here:

- samples that come within `reorder_s` of the newest one of their sensor may come in any order;
- where more than `max_gap_s` of a sensor, and more than 2.5 usual intervals, are missing, what came after waits until
  it spans `wait_s`: a message that was overtaken fills the hole;
- a sensor that is more than `wait_s` behind the accelerometer is silent, and nobody waits for it any more;
- what may leave is looked at when a sensor has come `bunch_s` further: once for some samples that come one by one;
- samples of the accelerometer whose time has left are late, and dropped. A minute of late ones alone is a clock that
  was set back: everything starts afresh, and `sensing.clock` follows it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import numpy as np

from pdr_filter.sensing.conditioning import at_times
from pdr_filter.values import FloatArray, ImuBlock, check_numbers, replace_unchecked
from pdr_filter.values.limits import GAP_INTERVALS

Sensor = Literal["accelerometer", "gyroscope", "magnetometer", "barometer"]
SENSORS: tuple[Sensor, ...] = get_args(Sensor)
_COLUMNS = {"accelerometer": 3, "gyroscope": 3, "magnetometer": 3, "barometer": 1}
# Rows that wait for each sensor at most: twice `wait_s` of the fastest phones, 2000 Hz.
_MAX_ROWS = 20_000
# Late samples over so long, without one in time between, are a clock that was set back. Less may be a backlog that is
# sent again after the network was away.
_SET_BACK_S = 60.0
# Samples from which the rate of a sensor is measured.
_RATE_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class StreamState:
    """One sensor: what waits or is still needed, in order of time, and what has come."""

    rows: FloatArray  # (N, 1 + d)
    recent_s: FloatArray = field(default_factory=lambda: np.empty(0))  # times of the last rows, as they came
    n_received: int = 0
    n_late: int = 0  # rows that came when their time had left, or came again

    @property
    def last_s(self) -> float:
        """Time of the last row that came."""
        return float(self.recent_s[-1]) if len(self.recent_s) else -np.inf

    @property
    def rate_hz(self) -> float:
        """As it arrives: 1 / median interval; NaN before the second sample."""
        intervals_s = np.diff(np.unique(self.recent_s))
        return float(1.0 / np.median(intervals_s)) if len(intervals_s) else np.nan


@dataclass(frozen=True, eq=False)
class MergerState:
    """The sensors, in the order of `SENSORS`, and how far they are merged."""

    streams: tuple[StreamState, ...]
    first_s: float = np.nan  # of the accelerometer
    released_s: float = -np.inf  # of the accelerometer, the last that left
    pressure_s: float = -np.inf  # of the barometer, the last that left
    looked_s: tuple[float, ...] = len(SENSORS) * (-np.inf,)  # how far each had come when it was seen what may leave
    late_s: tuple[float, float] = (np.nan, np.nan)  # first and largest time of late rows without one in time between

    def stream(self, sensor: Sensor) -> StreamState:
        """That of a sensor."""
        return self.streams[SENSORS.index(sensor)]

    @property
    def has_received(self) -> bool:
        """Whether any samples came."""
        return any(stream.n_received for stream in self.streams)

    @property
    def is_used(self) -> bool:
        """Whether samples of the accelerometer came through here."""
        return self.stream("accelerometer").n_received > 0


class Merged(NamedTuple):
    """What may leave: samples of a barometer, to be given first, and the others at the times of the accelerometer."""

    pressure_time_s: FloatArray  # (B,)
    pressure_hpa: FloatArray  # (B,)
    block: ImuBlock


@dataclass(frozen=True)
class StreamMerger:
    """Merges streams; see the module.

    Parameters
    ----------
    wait_s : float
        How late a sample may be, on the time of the samples, and how long a silent sensor is waited for.
    reorder_s : float
        How far a sample may be behind a later one of its sensor; all wait so long. For messages over a network that may
        overtake each other, as much as one of them holds, or put them in order before.
    bunch_s : float
        How much later than it could a sample may leave.
    max_gap_s : float
        As of `merge_streams`.
    """

    wait_s: float = 5.0
    reorder_s: float = 0.1
    bunch_s: float = 0.05
    max_gap_s: float = 0.3

    def __post_init__(self) -> None:
        check_numbers(self, zero=("reorder_s", "bunch_s"))

    def init(self) -> MergerState:
        """State before the first sample."""
        return MergerState(tuple(StreamState(np.empty((0, 1 + _COLUMNS[sensor]))) for sensor in SENSORS))

    def update(
        self, state: MergerState, sensor: Sensor, time_s: FloatArray, values: FloatArray
    ) -> tuple[MergerState, Merged]:
        """New state, and what may leave after samples (N,), (N, d) of one sensor."""
        return self.together(state, {sensor: (time_s, values)})

    def together(
        self, state: MergerState, samples: Mapping[Sensor, tuple[FloatArray, FloatArray]]
    ) -> tuple[MergerState, Merged]:
        """New state, and what may leave after samples (N,), (N, d) of several sensors that arrive in one message."""
        for sensor in SENSORS:  # the accelerometer first, because its clock decides what the others are for
            if sensor in samples:
                state = self._arrived(state, sensor, np.column_stack(samples[sensor]))
        force = state.stream("accelerometer")
        further_s = [abs(state.stream(s).last_s - state.looked_s[SENSORS.index(s)]) for s in samples]
        # a clock that stands still comes no further, but its samples may not wait without end
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
        return self._released(state, max(n, len(force.rows) - _MAX_ROWS), passed_s["barometer"] - self.reorder_s)

    def finish(self, state: MergerState) -> tuple[MergerState, Merged]:
        """New state, and all that still waits."""
        return self._released(state, len(state.stream("accelerometer").rows), np.inf)

    def silent(self, state: MergerState) -> tuple[tuple[Sensor, float], ...]:
        """The sensors that have fallen silent, with the time of their last sample."""
        newest_s = max(s.last_s for s in state.streams)
        return tuple(
            (name, stream.last_s)
            for name, stream in zip(SENSORS, state.streams, strict=True)
            if stream.n_received and newest_s - stream.last_s > self.wait_s
        )

    def _arrived(self, state: MergerState, sensor: Sensor, new: FloatArray) -> MergerState:
        """State in which rows wait; the late ones are dropped."""
        finite = np.isfinite(new)
        timed = new if finite.all() else new[finite[:, 0]]
        if sensor == "accelerometer":
            state, kept = self._in_time(state, timed)
            n_late = len(timed) - len(kept)
        else:
            # between two samples both are needed, so that one without a value is none
            known = new[finite.all(axis=1)]
            kept = known[known[:, 0] > (state.pressure_s if sensor == "barometer" else state.released_s)]
            n_late = len(known) - len(kept)
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
            n_received=stream.n_received + len(new),
            n_late=stream.n_late + n_late,
        )
        return _with(state, sensor, stream)

    def _in_time(self, state: MergerState, rows: FloatArray) -> tuple[MergerState, FloatArray]:
        """State, afresh if the clock was set back, and the rows of the accelerometer that are not late."""
        is_late = rows[:, 0] <= state.released_s
        if not is_late.any():
            if len(rows):
                first_s = float(rows[:, 0].min()) if np.isnan(state.first_s) else state.first_s
                state = replace_unchecked(state, first_s=first_s, late_s=_NO_LATE)
            return state, rows
        for i, (time_s, late) in enumerate(zip(rows[:, 0].tolist(), is_late.tolist(), strict=True)):
            begin_s, end_s = state.late_s
            late_s = (float(np.fmin(begin_s, time_s)), float(np.fmax(end_s, time_s))) if late else _NO_LATE
            state = replace_unchecked(state, late_s=late_s)
            if late_s[1] - late_s[0] > _SET_BACK_S:
                return self._in_time(self._afresh(state), rows[i:])
        return state, rows[~is_late]

    def _afresh(self, state: MergerState) -> MergerState:
        """State in which nothing waits, and all that has been counted."""
        begun = zip(self.init().streams, state.streams, strict=True)
        kept = (replace_unchecked(new, n_received=s.n_received, n_late=s.n_late) for new, s in begun)
        return MergerState(tuple(kept))

    def _n_whole(self, stream: StreamState, n: int, before_s: float, others_s: float = -np.inf) -> int:
        """How many of the first n rows lie before the first hole that may still be filled.

        `before_s` is the last time before them, `others_s` how far the accelerometer has come, if they are of another
        sensor.
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
        """How far a sensor has come, of which nothing counts that is far ahead of the accelerometer."""
        time_s = stream.rows[:, 0]
        n = int(time_s.searchsorted(frontier_s + self.wait_s, side="right"))
        n = self._n_whole(stream, n, float(time_s[0]), frontier_s) if n else 0
        # what comes before the first sample takes its value from the first two
        interpolates = stream.rows.shape[1] > 2
        return float(time_s[n - 1]) if n > interpolates else -np.inf

    def _released(self, state: MergerState, n: int, pressure_until_s: float) -> tuple[MergerState, Merged]:
        """State without the first rows of the accelerometer, which leave, and pressures up to a time."""
        force, pressure = state.stream("accelerometer"), state.stream("barometer")
        due = int(pressure.rows[:, 0].searchsorted(pressure_until_s, side="right"))
        out = pressure.rows[:due][pressure.rows[:due, 0] > state.pressure_s]
        if n == len(out) == 0:
            return state, _NOTHING
        leaving, left = force.rows[:n], force.rows[n:]
        time_s = leaving[:, 0]
        rate, field_ut = (
            at_times(s.rows[:, 0], s.rows[:, 1:], time_s, self.max_gap_s)
            for s in (state.stream("gyroscope"), state.stream("magnetometer"))
        )
        block = ImuBlock(time_s, leaving[:, 1:], rate, field_ut)
        if n:
            state = replace_unchecked(state, released_s=float(time_s[-1]))
            state = _with(state, "accelerometer", replace_unchecked(force, rows=left))
            for sensor in ("gyroscope", "magnetometer"):
                stream = state.stream(sensor)
                # the two before are needed: what comes after the last sample is held by both
                first = max(int(np.searchsorted(stream.rows[:, 0], state.released_s, side="right")) - 2, 0)
                state = _with(state, sensor, replace_unchecked(stream, rows=stream.rows[first:]))
        if len(out):
            state = replace_unchecked(state, pressure_s=float(out[-1, 0]))
            state = _with(state, "barometer", replace_unchecked(pressure, rows=pressure.rows[due - 1 :]))
        return state, Merged(out[:, 0], out[:, 1], block)


_NO_LATE = (np.nan, np.nan)
_NOTHING = Merged(np.empty(0), np.empty(0), ImuBlock(np.empty(0), *np.empty((3, 0, 3))))


def _with(state: MergerState, sensor: Sensor, stream: StreamState) -> MergerState:
    """State with another stream."""
    at = SENSORS.index(sensor)
    return replace_unchecked(state, streams=(*state.streams[:at], stream, *state.streams[at + 1 :]))
