"""Time stamps of samples: drop late samples and glitches, follow backward clock jumps.

Samples usually come in order. These rules handle the exceptions:

- A row whose time is not after the last accepted time is a repeat or a late sample, and is dropped.
- If `CLOCK_RESET_SAMPLES` rows in a row lie behind, and their times increase at least once, the clock was set back.
- A row more than `max_gap_s` ahead follows a gap if the next row is ahead too. Otherwise it is a glitch.
- A row more than a minute ahead must be confirmed by `CLOCK_RESET_SAMPLES` rows.

The clock of the track never goes back. `ClockState.offset_s` converts times of samples, fixes and the barometer from
the sample clock to the track clock. In a finished recording all backward clock jumps are known in advance, and
`one_clock` removes them.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from pdr_filter.values import Fix, FloatArray, IntArray, Samples, Standstill, replace_unchecked
from pdr_filter.values.recording import Recording

# Longest time between two samples that is interpolated, in s. Longer times are gaps.
MAX_GAP_S = 0.3
# Rows in a row that must contradict the clock before the clock is taken to be set back, or far ahead.
CLOCK_RESET_SAMPLES = 50
# Longest gap that a second sample confirms, in s. Phones sleep for seconds. Longer gaps are rare, whereas glitches of
# two samples occur.
_SHORT_GAP_S = 60.0
# Rows tested together for increasing times. The limit keeps the cost linear when every second time repeats, because
# each repeat ends a run and the remaining rows are tested again.
_RUN_ROWS = 256


@dataclass(frozen=True, eq=False)
class ClockState:
    """State of the check of times.

    Attributes
    ----------
    last_s : float
        Time of the last accepted row on the track clock, s.
    offset_s : float
        Track time minus sample time, s. It changes when the sample clock is set back.
    held : tuple of FloatArray
        Rows after a possible gap, shape (C,) each, held until later rows confirm the gap.
    behind_s : float
        Time of the last row that lies behind the last accepted one, on the track clock, s.
    is_running : bool
        True if the time of any of the `n_behind` rows is later than the time of the row before it. False means that the
        clock stands still.
    n_behind : int
        Consecutive rows that lie behind the last accepted one.
    n_rejected_times : int
        Rows received since the last accepted one.
    """

    last_s: float = -np.inf
    offset_s: float = 0.0
    held: tuple[FloatArray, ...] = field(default=())
    behind_s: float = -np.inf
    is_running: bool = False
    n_behind: int = 0
    n_rejected_times: int = 0


class AcceptedRows(NamedTuple):
    """Result of the check of times.

    Attributes
    ----------
    clock : ClockState
        New state.
    rows : FloatArray
        Accepted rows, shape (N, C), with increasing times on the track clock.
    n_dropped : int
        Dropped rows.
    n_set_backs : int
        Backward clock jumps.
    n_glitches : int
        Stretches of rows that were dropped because their times were ahead of all later rows.
    """

    clock: ClockState
    rows: FloatArray
    n_dropped: int = 0
    n_set_backs: int = 0
    n_glitches: int = 0


def accept_rows(clock: ClockState, rows: FloatArray, max_gap_s: float) -> AcceptedRows:
    """Return the sample rows with usable times, converted to the track clock, with the new state and counts.

    The first column of `rows` (N, C) is the time on the sample clock. The counts are of dropped rows, backward clock
    jumps and glitches.
    """
    accepted: list[FloatArray] = [rows[:0]]
    n_dropped = n_set_backs = n_glitches = start = 0
    while start < len(rows):
        if not clock.held and clock.n_behind == 0:
            clock, in_order = _in_order(clock, rows[start : start + _RUN_ROWS], max_gap_s)
            accepted.append(in_order)
            start += len(in_order)
            if len(in_order) == _RUN_ROWS or start == len(rows):
                continue
        found = _accept_or_hold(clock, rows[start], max_gap_s)
        n_rejected_times = 0 if found.accepted else clock.n_rejected_times + 1
        clock = replace_unchecked(found.clock, n_rejected_times=n_rejected_times)
        accepted += [row[None] for row in found.accepted]
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
    steps_s = rows[:, 0] - np.concatenate([[clock.last_s], rows[:-1, 0]])
    # The first sample of all has no predecessor: its step is infinite and is accepted.
    (stops,) = (~((steps_s > 0) & ((steps_s <= max_gap_s) | np.isinf(steps_s)))).nonzero()
    rows = rows[: stops[0]] if len(stops) else rows
    return (replace_unchecked(clock, last_s=float(rows[-1, 0]), n_rejected_times=0) if len(rows) else clock), rows


class _Decision(NamedTuple):
    """Decision on one row: the new state, and the rows that are accepted or dropped with it."""

    clock: ClockState
    accepted: tuple[FloatArray, ...] = ()
    n_dropped: int = 0
    is_set_back: bool = False
    is_glitch: bool = False


def _accept_or_hold(clock: ClockState, row: FloatArray, max_gap_s: float) -> _Decision:
    """Return the decision on a sample row: accept it together with the held rows, hold it, or drop it."""
    row = row.copy()
    row[0] += clock.offset_s
    time_s = float(row[0])
    if time_s <= clock.last_s:
        return _behind(clock, time_s, max_gap_s)
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


def _behind(clock: ClockState, time_s: float, max_gap_s: float) -> _Decision:
    """Return the decision on a row that lies behind the last accepted one: it is dropped.

    After `CLOCK_RESET_SAMPLES` such rows whose times increase, the clock was set back, and the offset changes.
    """
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
    return _Decision(ClockState(clock.last_s, offset_s), n_dropped=1 + len(clock.held), is_set_back=True)


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
    if isinstance(fix, Standstill):
        return dataclasses.replace(
            fix, time_s=fix.time_s + offset_s, end_s=fix.end_s + offset_s, received_time_s=received_s
        )
    times = {"time_s": fix.time_s + offset_s, "received_time_s": received_s}
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
    changed. A note on the recording states each jump.
    """
    set_backs, fixes = _set_backs(recording.accelerometer.time_s), tuple(fixes)
    if not set_backs:
        return recording, fixes
    offsets_s = np.cumsum([0.0, *(s.ahead_s for s in set_backs)])
    streams = {
        name: Samples(stream.time_s + offsets_s[_n_set_backs_before(stream.time_s, set_backs)], stream.values)
        for name, stream in recording.streams.items()
    }
    fix_offsets_s = offsets_s[_n_set_backs_before(np.array([fix.time_s for fix in fixes]), set_backs)]
    jumps = (f"the clock was set back by {s.before_s - s.after_s:.1f} s after {s.before_s:.1f} s" for s in set_backs)
    notes = (*recording.notes, *(f"{jump}: later times continue from there" for jump in jumps))
    wifi = recording.wifi
    if wifi is not None:
        wifi = dataclasses.replace(wifi, time_s=wifi.time_s + offsets_s[_n_set_backs_before(wifi.time_s, set_backs)])
    unified = dataclasses.replace(recording, **streams, wifi=wifi, notes=notes)
    return unified, tuple(
        on_track_clock(fix, float(offset_s)) for fix, offset_s in zip(fixes, fix_offsets_s, strict=True)
    )


def _set_backs(time_s: FloatArray) -> list[_SetBack]:
    """Return the backward clock jumps that `accept_rows` detects in times (N,), in order."""
    index = np.flatnonzero(np.isfinite(time_s))
    known_s = time_s[index]
    if (known_s < np.maximum.accumulate(known_s)).sum() < CLOCK_RESET_SAMPLES:
        return []
    rows = accept_rows(ClockState(), np.column_stack([known_s, np.arange(float(len(known_s)))]), MAX_GAP_S).rows
    at = rows[:, 1].astype(int)
    changes = np.flatnonzero(np.abs(np.diff(rows[:, 0] - known_s[at])) > 1e-6)
    spacing_s = float(np.median(np.diff(rows[:, 0])))
    result: list[_SetBack] = []
    begin_s = float(known_s[0])
    for i in changes:
        before_s, after_s = float(known_s[at[i]]), float(known_s[at[i] + 1])
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
