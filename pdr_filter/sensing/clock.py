"""Time stamps of samples: drop late samples and glitches, follow backward clock jumps.

Samples usually come in order. These rules handle the exceptions:

- A row whose time is not after the last accepted time is a repeat or a late sample, and is dropped. `one_clock`
  and the merging of single sensors first sort samples that are less than `REORDER_S` behind an earlier one.
- If `CLOCK_RESET_SAMPLES` rows in a row lie behind, and their times increase at least once, the clock was set back.
  Rows that were accepted before and arrive again, such as a block that an app sends twice, do not count.
- A row more than `max_gap_s` ahead follows a gap if the next row is ahead too. Otherwise it is a glitch.
- A row more than a minute ahead must be confirmed by `CLOCK_RESET_SAMPLES` rows.

The clock of the track never goes back. `ClockState.offset_s` converts times of samples, fixes and the barometer from
the sample clock to the track clock. In a finished recording all backward clock jumps are known in advance, and
`one_clock` removes them.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from pdr_filter.values import BoolArray, Fix, FloatArray, IntArray, Samples, Standstill, replace_unchecked
from pdr_filter.values.limits import GAP_INTERVALS
from pdr_filter.values.recording import Recording

# Longest time between two samples that is interpolated, in s. Longer times are gaps.
MAX_GAP_S = 0.3
# A sample that is less than this time behind an earlier one of its sensor, in s, is sorted by time. Clocks of phones go
# back by some ticks, of 10 ms in OxIOD, and threads of apps deliver single samples out of order.
REORDER_S = 0.1
# Rows in a row that must contradict the clock before the clock is taken to be set back, or far ahead.
CLOCK_RESET_SAMPLES = 50
# Longest gap that a second sample confirms, in s. Phones sleep for seconds. Longer gaps are rare, whereas glitches of
# two samples occur.
_SHORT_GAP_S = 60.0
# Of the accepted rows, every 25th is kept to recognise blocks that arrive again. The interval is half of
# `CLOCK_RESET_SAMPLES`, so that a repeated block contains a kept row before it resembles a clock that was set back.
_ROWS_PER_KEPT = 25
# Kept rows. They recognise a repeated minute at 100 Hz, as `stream_merging` does, and take 4 KB.
_MAX_KEPT = 256
# Rows tested together for increasing times. The limit keeps the cost linear when every second time repeats, because
# each repeat ends a run and the remaining rows are tested again.
_RUN_ROWS = 256


@dataclass(frozen=True, eq=False)
class ClockState:
    """State of the check of times."""

    last_s: float = -np.inf  # time of the last accepted row on the track clock, s
    offset_s: float = 0.0  # track time minus sample time, s. It changes when the sample clock is set back.
    # Rows (C,), each after a possible gap, held until later rows confirm the gap.
    held: tuple[FloatArray, ...] = field(default=())
    behind_s: float = -np.inf  # time of the last row that lies behind the last accepted one, on the track clock, s
    # True if the time of any of the `n_behind` rows is later than the time of the row before it. False means that the
    # clock stands still.
    is_running: bool = False
    n_behind: int = 0  # consecutive rows that lie behind the last accepted one
    n_rejected_times: int = 0  # rows received since the last accepted one, or since one that arrived again
    # Every 25th accepted row (K, 2), as its time on the sample clock and the `fingerprint` of its specific force.
    # `n_since_kept` counts the rows accepted after the last of them.
    kept: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    n_since_kept: int = _ROWS_PER_KEPT - 1


class AcceptedRows(NamedTuple):
    """Result of the check of times."""

    clock: ClockState
    rows: FloatArray  # (N, C) accepted rows, with increasing times on the track clock
    n_dropped: int = 0  # dropped rows
    n_set_backs: int = 0  # backward clock jumps
    n_glitches: int = 0  # stretches of rows that were dropped because their times were ahead of all later rows


def accept_rows(clock: ClockState, rows: FloatArray, max_gap_s: float) -> AcceptedRows:
    """Return the sample rows with usable times, converted to the track clock, with the new state and counts.

    The first column of `rows` (N, C) is the time on the sample clock, the next three are the specific force. The counts
    are of dropped rows, backward clock jumps and glitches.
    """
    accepted: list[FloatArray] = [rows[:0]]
    n_dropped = n_set_backs = n_glitches = start = 0
    while start < len(rows):
        if not clock.held and clock.n_behind == 0:
            clock, in_order = _in_order(clock, rows[start : start + _RUN_ROWS], max_gap_s)
            clock = _with_kept(clock, in_order)
            accepted.append(in_order)
            start += len(in_order)
            if len(in_order) == _RUN_ROWS or start == len(rows):
                continue
        found = _accept_or_hold(clock, rows[start], max_gap_s)
        n_rejected_times = 0 if found.accepted or found.is_repeat else clock.n_rejected_times + 1
        clock = replace_unchecked(found.clock, n_rejected_times=n_rejected_times)
        for row in found.accepted:
            clock = _with_kept(clock, row[None])
            accepted.append(row[None])
        n_dropped += found.n_dropped
        n_set_backs += found.is_set_back
        n_glitches += found.is_glitch
        start += 1
    joined = accepted[-1] if len(accepted) == 2 else np.concatenate(accepted)
    return AcceptedRows(clock, joined, n_dropped, n_set_backs, n_glitches)


def _in_order(clock: ClockState, rows: FloatArray, max_gap_s: float) -> tuple[ClockState, FloatArray]:
    """Return the new state and the leading rows whose times increase without a gap, with times on the track clock.

    No row may be held or behind in the given state.
    """
    rows = rows.copy()
    rows[:, 0] += clock.offset_s
    steps_s = rows[:, 0].copy()
    steps_s[0] -= clock.last_s
    steps_s[1:] -= rows[:-1, 0]
    is_next = (steps_s > 0) & (steps_s <= max_gap_s)
    # The first sample of all has no predecessor: its step is infinite and is accepted.
    is_next[0] |= steps_s[0] == np.inf
    rows = rows if is_next.all() else rows[: int(is_next.argmin())]
    return (replace_unchecked(clock, last_s=float(rows[-1, 0]), n_rejected_times=0) if len(rows) else clock), rows


def _with_kept(clock: ClockState, accepted: FloatArray) -> ClockState:
    """Return the state that keeps every 25th of the accepted rows, to recognise them if they arrive again."""
    n = clock.n_since_kept + len(accepted)
    if n < _ROWS_PER_KEPT:
        return replace_unchecked(clock, n_since_kept=n)
    new = accepted[_ROWS_PER_KEPT - 1 - clock.n_since_kept :: _ROWS_PER_KEPT]
    new = np.column_stack([new[:, 0] - clock.offset_s, fingerprint(new[:, 1:4])])
    kept = np.concatenate([clock.kept, new])[-_MAX_KEPT:]
    return replace_unchecked(clock, kept=kept, n_since_kept=n % _ROWS_PER_KEPT)


def _is_repeat(clock: ClockState, row: FloatArray) -> bool:
    """Return True if a row on the sample clock is equal to a kept one."""
    # The subtraction of the offset rounds the kept time. Times since 1970 have a resolution of 0.2 us.
    is_same_time = np.abs(clock.kept[:, 0] - row[0]) < 1e-5
    return bool((is_same_time & (clock.kept[:, 1] == fingerprint(row[1:4]))).any())


def fingerprint(force_mps2: FloatArray) -> FloatArray:
    """Return one number for each specific force (..., 3), which hardly any other sample of a sensor has.

    The weights are irrational, because sensors deliver multiples of a smallest value.
    """
    x, y, z = force_mps2[..., 0], force_mps2[..., 1], force_mps2[..., 2]
    return x + math.sqrt(2.0) * y + math.sqrt(3.0) * z


class _Decision(NamedTuple):
    """Decision on one row: the new state, and the rows that are accepted or dropped with it."""

    clock: ClockState
    accepted: tuple[FloatArray, ...] = ()
    n_dropped: int = 0
    is_set_back: bool = False
    is_glitch: bool = False
    is_repeat: bool = False


def _accept_or_hold(clock: ClockState, row: FloatArray, max_gap_s: float) -> _Decision:
    """Return the decision on a sample row: accept it together with the held rows, hold it, or drop it."""
    is_repeat = _is_repeat(clock, row)
    row = row.copy()
    row[0] += clock.offset_s
    time_s = float(row[0])
    if is_repeat:
        # Held rows after the last accepted one arrived again too. They are of the time before a backward jump.
        held = clock.held if time_s <= clock.last_s else ()
        n_dropped = 1 + len(clock.held) - len(held)
        clock = replace_unchecked(clock, held=held, behind_s=-np.inf, is_running=False, n_behind=0)
        return _Decision(clock, n_dropped=n_dropped, is_repeat=True)
    if time_s <= clock.last_s:
        return _behind(clock, row, max_gap_s)
    clock = replace_unchecked(clock, behind_s=-np.inf, is_running=False, n_behind=0)
    n_glitches_dropped = 0
    if clock.held and time_s < clock.held[0][0]:
        # The clock continues from before the held rows, so the held rows were a glitch.
        n_glitches_dropped, clock = len(clock.held), replace_unchecked(clock, held=())
    if not clock.held:
        is_next = time_s - clock.last_s <= max_gap_s or np.isinf(clock.last_s)
        clock = replace_unchecked(clock, **{"last_s": time_s} if is_next else {"held": (row,)})
        accepted = (row,) if is_next else ()
        return _Decision(clock, accepted, n_glitches_dropped, is_glitch=n_glitches_dropped > 0)
    first_s, latest_s = float(clock.held[0][0]), float(clock.held[-1][0])
    if time_s <= latest_s:
        return _Decision(clock, n_dropped=1)
    held = (*clock.held, row)
    if first_s - clock.last_s > _SHORT_GAP_S and len(held) < CLOCK_RESET_SAMPLES:
        return _Decision(replace_unchecked(clock, held=held))
    return _Decision(replace_unchecked(clock, held=(), last_s=time_s), held)


def _behind(clock: ClockState, row: FloatArray, max_gap_s: float) -> _Decision:
    """Return the decision on a row that lies behind the last accepted one: it is dropped.

    After `CLOCK_RESET_SAMPLES` such rows whose times increase, the clock was set back, and the offset changes.
    """
    time_s = float(row[0])
    clock = replace_unchecked(
        clock,
        behind_s=time_s,
        is_running=clock.is_running or time_s > clock.behind_s > -np.inf,
        n_behind=clock.n_behind + 1,
    )
    if clock.n_behind < CLOCK_RESET_SAMPLES or not clock.is_running:
        return _Decision(clock, n_dropped=1)
    # The duration between the last accepted row and the next one is unknown, because rows were dropped. The offset adds
    # twice `max_gap_s`, so that the later stages see a gap.
    offset_s = clock.offset_s + clock.last_s - time_s + 2 * max_gap_s
    after = ClockState(clock.last_s, offset_s, kept=clock.kept)
    # The row that shows the jump is kept, so that the same block, sent again, shows no second jump.
    row[0] = clock.last_s + 2 * max_gap_s
    after = _with_kept(after, row[None])
    return _Decision(after, n_dropped=1 + len(clock.held), is_set_back=True)


def latest_before(time_s: FloatArray, before_s: float = -np.inf) -> FloatArray:
    """Return the latest time before each sample (N,), of the earlier samples and `before_s`."""
    return np.fmax.accumulate(np.concatenate([[before_s], time_s]))[:-1]


def is_behind(time_s: FloatArray, latest_s: FloatArray, reorder_s: float = REORDER_S) -> BoolArray:
    """Return which samples (N,) are late, given the latest time before each of them (N,).

    They are `reorder_s` or more behind it, or have no time. Other samples are sorted by time.
    """
    return ~(time_s > latest_s - reorder_s)


def sorted_note(n_sorted: int, n: int) -> str:
    """Return the note on samples of the accelerometer whose times are slightly behind an earlier one."""
    return (
        f"{n_sorted} of {n} samples had a time before that of an earlier one and were sorted by time: the clock of the "
        "phone went back by some ticks, or the app delivers samples out of order"
    )


def _sorted_stream(stream: Samples) -> tuple[Samples, int]:
    """Return a stream whose samples are sorted by time unless they are late, and how many were behind an earlier one.

    A late sample keeps its place after the latest one before it.
    """
    latest_s = latest_before(stream.time_s)
    is_late = is_behind(stream.time_s, latest_s)
    order = np.argsort(np.where(is_late, latest_s, stream.time_s), kind="stable")
    n_sorted = int((~is_late & (stream.time_s < latest_s)).sum())
    return Samples(stream.time_s[order], stream.values[order]), n_sorted


def _without_late(stream: Samples) -> Samples:
    """Return a stream sorted by time, without the late samples that fill no gap of the others."""
    stream = Samples(stream.time_s[known := np.isfinite(stream.time_s)], stream.values[known])
    latest_s = latest_before(stream.time_s)
    in_order_s = stream.time_s[stream.time_s > latest_s]
    before_s = np.diff(in_order_s, prepend=in_order_s[:1])
    gap_s = max(MAX_GAP_S, GAP_INTERVALS * float(np.median(before_s)))
    fills_gap = before_s[np.minimum(in_order_s.searchsorted(stream.time_s), len(before_s) - 1)] > gap_s
    (kept,) = (fills_gap | ~is_behind(stream.time_s, latest_s)).nonzero()
    order = kept[np.argsort(stream.time_s[kept], kind="stable")]
    return Samples(stream.time_s[order], stream.values[order])


class _SetBack(NamedTuple):
    """A backward clock jump between two samples. Times are on the sample clock."""

    begin_s: float  # first time of the stretch of samples before the jump
    before_s: float  # last time of this stretch
    after_s: float  # first time after the jump
    ahead_s: float  # offset that makes the times after the jump continue those before it


AnyFix = TypeVar("AnyFix", bound=Fix)


def on_track_clock(fix: AnyFix, offset_s: float) -> AnyFix:
    """Return a fix whose times are shifted by `offset_s`, in s, from the sample clock to the track clock.

    Raises ValueError for a foreign class whose times cannot be set.
    """
    if offset_s == 0.0:
        return fix
    received_s = None if fix.received_time_s is None else fix.received_time_s + offset_s
    times = {"time_s": fix.time_s + offset_s, "received_time_s": received_s}
    if isinstance(fix, Standstill):
        times["end_s"] = fix.end_s + offset_s
    if dataclasses.is_dataclass(fix) and times.keys() <= {f.name for f in dataclasses.fields(fix)}:
        return dataclasses.replace(fix, **times)
    later = copy.copy(fix)
    for name, value in times.items():
        try:
            object.__setattr__(later, name, value)
        except AttributeError:
            raise ValueError(
                f"{name} of {type(fix).__name__} cannot be set, which is needed because the clock of the samples was "
                "set back: make time_s and received_time_s plain attributes"
            ) from None
    return later


def one_clock(recording: Recording, fixes: Iterable[AnyFix] = ()) -> tuple[Recording, tuple[AnyFix, ...]]:
    """Return the recording and the fixes with all backward clock jumps of the accelerometer removed.

    After each jump, all times continue from before it. Other streams and fixes, in recorded order, change where their
    own times fall back by the same jump. A stream without such a fall, for example because it was sorted, is assigned
    by time: each sample belongs to the stretch of the accelerometer that contains its time. The ground truth is not
    changed. A note on the recording states each jump. Samples that are less than `REORDER_S` behind an earlier one are
    sorted by time, with a note on their number.
    """
    set_backs, fixes = _set_backs(recording.accelerometer), tuple(fixes)
    if not set_backs:
        return _with_sorted_samples(recording), fixes
    offsets_s, streams = np.cumsum([0.0, *(s.ahead_s for s in set_backs)]), dict[str, Samples]()
    for name, stream in recording.streams.items():
        time_s = stream.time_s + offsets_s[_n_set_backs_before(stream.time_s, set_backs)]
        # The samples of a stream that was sorted by the times of the clock are not in order.
        order = np.argsort(time_s, kind="stable") if name in _INTERPOLATED else np.arange(len(time_s))
        streams[name] = Samples(time_s[order], stream.values[order])
    fix_offsets_s = offsets_s[_n_set_backs_before(np.array([fix.time_s for fix in fixes]), set_backs)]
    jumps = (f"the clock was set back by {s.before_s - s.after_s:.1f} s after {s.before_s:.1f} s" for s in set_backs)
    notes = (*recording.notes, *(f"{jump}: later times continue from there" for jump in jumps))
    wifi = recording.wifi
    if wifi is not None:
        wifi = dataclasses.replace(wifi, time_s=wifi.time_s + offsets_s[_n_set_backs_before(wifi.time_s, set_backs)])
    unified = dataclasses.replace(recording, **streams, wifi=wifi, notes=notes)
    fixes = tuple(on_track_clock(fix, offset_s) for fix, offset_s in zip(fixes, fix_offsets_s.tolist(), strict=True))
    return _with_sorted_samples(unified), fixes


# Sensors whose values are used at the times of the accelerometer.
_INTERPOLATED = ("gyroscope", "magnetometer", "barometer")


def _with_sorted_samples(recording: Recording) -> Recording:
    """Return the recording with the samples of each inertial sensor and the barometer sorted by time.

    Late samples of the accelerometer keep their places, and those of the other sensors are dropped. A note states how
    many samples were sorted. A recording whose times never fall is returned unchanged.
    """
    sensors = ("accelerometer", *_INTERPOLATED)
    fall = {n: s for n, s in recording.streams.items() if n in sensors and not (np.diff(s.time_s) >= 0).all()}
    if not fall:
        return recording
    changed, notes = {name: _without_late(stream) for name, stream in fall.items()}, recording.notes
    if "accelerometer" in fall:
        changed["accelerometer"], n_sorted = _sorted_stream(recording.accelerometer)
        notes += (sorted_note(n_sorted, len(recording.accelerometer)),) if n_sorted else ()
    return dataclasses.replace(recording, **changed, notes=notes)


def _set_backs(stream: Samples) -> list[_SetBack]:
    """Return the backward clock jumps that `accept_rows` detects in the samples of an accelerometer, in order."""
    index = np.flatnonzero(np.isfinite(stream.time_s))
    known_s = stream.time_s[index]
    if is_behind(known_s, np.maximum.accumulate(known_s)).sum() < CLOCK_RESET_SAMPLES:
        return []
    numbered = np.column_stack([known_s, stream.values[index], np.arange(float(len(known_s)))])
    rows = accept_rows(ClockState(), numbered, MAX_GAP_S).rows
    at = rows[:, -1].astype(int)
    changes = np.flatnonzero(np.abs(np.diff(rows[:, 0] - known_s[at])) > 1e-6)
    spacing_s = float(np.median(np.diff(rows[:, 0])))
    result: list[_SetBack] = []
    begin_s = float(known_s[0])
    for i in changes:
        before_s, after_s = float(known_s[at[i]]), float(known_s[at[i] + 1])
        if before_s - after_s < REORDER_S:  # fast sensors have many samples in this time, which are sorted
            continue
        result.append(_SetBack(begin_s, before_s, after_s, before_s - after_s + spacing_s))
        begin_s = after_s
    return result


# Tolerance for the start and end of a stretch, in s, because the streams of a phone do not start and end together.
_STRETCH_MARGIN_S = 1.0


def _n_set_backs_before(time_s: FloatArray, set_backs: Sequence[_SetBack]) -> IntArray:
    """Return how many backward clock jumps precede each time (N,) of a stream, in recorded order."""
    result, start = np.zeros(len(time_s), dtype=int), 0
    for number, (begin_s, before_s, after_s, _) in enumerate(set_backs, start=1):
        rest = time_s[start:]
        # positions at which the stream's own times fall
        falls = start + 1 + np.flatnonzero(np.diff(rest) < 0)
        distance_s = np.abs(time_s[falls - 1] - before_s) + np.abs(time_s[falls] - after_s)
        if (distance_s < before_s - after_s).any():
            start = int(falls[distance_s.argmin()])
            result[start:] = number
        else:
            # the stream has no fall of this size, so each time is assigned by the stretch that contains it
            result[start:][(rest < begin_s - _STRETCH_MARGIN_S) | (rest > before_s + _STRETCH_MARGIN_S)] = number
    return result
