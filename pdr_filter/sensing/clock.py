"""Which times of samples to believe: stragglers and glitches are dropped, clocks that are set back are followed.

Samples come in order, mostly. A row behind the last one is a repeat or a straggler, and so are some in a row; fifty
without one in order are a clock that was set back, if it runs at all. A row far ahead is a gap if the next one is there
too, a glitch otherwise; over a minute ahead fifty must agree. The track's time runs on whatever the clock does, and
`ClockState.offset_s` is what takes a time of the samples, of a fix or of a barometer, to it. Of a recording all is
known, and `one_clock` leaves nothing to follow.
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

# So many samples in a row that contradict the clock are right.
CLOCK_RESET_SAMPLES = 50
# A gap that one sample more can prove: phones sleep for seconds. Longer ones are rare, glitches of two samples are not.
_PLAIN_GAP_S = 60.0
# Rows that are looked at together: where every second time repeats, no row is looked at much more often than once.
_RUN_ROWS = 256


@dataclass(frozen=True, eq=False)
class ClockState:
    """Whether to believe the next time."""

    last_s: float = -np.inf  # of the last accepted row, on the track's time base
    offset_s: float = 0.0  # track time less sample time; changes when the sample clock is set back
    held: tuple[FloatArray, ...] = field(default=())  # rows after a gap, until those that follow confirm it
    behind_s: float = -np.inf  # of the last row that is behind
    moving: bool = False  # whether one of these is later than the one before
    n_behind: int = 0  # rows in a row that are behind
    n_deaf: int = 0  # rows since the last accepted one


def follow(clock: ClockState, rows: FloatArray, max_gap_s: float) -> tuple[ClockState, FloatArray, int, int]:
    """New state, the rows (N, C) with believable increasing times, how many were dropped, how often the clock jumped.

    The first column is the time, on the samples' time base; that of the result is the track's.
    """
    accepted: list[FloatArray] = [rows[:0]]
    n_dropped = n_jumps = start = 0
    while start < len(rows):
        if not clock.held and clock.n_behind == 0:
            clock, in_order = _in_order(clock, rows[start : start + _RUN_ROWS], max_gap_s)
            accepted.append(in_order)
            start += len(in_order)
            if len(in_order) == _RUN_ROWS or start == len(rows):
                continue
        clock, out, dropped, jumps = _believe(clock, rows[start], max_gap_s)
        clock = replace_unchecked(clock, n_deaf=0 if out else clock.n_deaf + 1)
        accepted += [row[None] for row in out]
        n_dropped, n_jumps, start = n_dropped + dropped, n_jumps + jumps, start + 1
    return clock, accepted[-1] if len(accepted) == 2 else np.concatenate(accepted), n_dropped, n_jumps


def _in_order(clock: ClockState, rows: FloatArray, max_gap_s: float) -> tuple[ClockState, FloatArray]:
    """As many of the next rows as follow each other, of a clock that is in doubt about nothing."""
    moved = rows.copy()
    moved[:, 0] += clock.offset_s
    steps_s = moved[:, 0] - np.concatenate([[clock.last_s], moved[:-1, 0]])
    # the very first sample has nothing to be far ahead of
    (stops,) = (~((steps_s > 0) & ((steps_s <= max_gap_s) | np.isinf(steps_s)))).nonzero()
    moved = moved[: stops[0]] if len(stops) else moved
    return (replace_unchecked(clock, last_s=float(moved[-1, 0]), n_deaf=0) if len(moved) else clock), moved


def _believe(clock: ClockState, row: FloatArray, max_gap_s: float) -> tuple[ClockState, list[FloatArray], int, int]:
    """One row: accepted with those held before it, dropped, or held itself."""
    moved = row.copy()
    moved[0] += clock.offset_s
    time_s = float(moved[0])
    if time_s <= clock.last_s:
        return _behind(clock, time_s, max_gap_s)
    clock = replace_unchecked(clock, behind_s=-np.inf, moving=False, n_behind=0)
    if not clock.held:
        if time_s - clock.last_s <= max_gap_s or np.isinf(clock.last_s):
            return replace_unchecked(clock, last_s=time_s), [moved], 0, 0
        return replace_unchecked(clock, held=(moved,)), [], 0, 0
    first_s, latest_s = float(clock.held[0][0]), float(clock.held[-1][0])
    if time_s < first_s:
        # the clock is where it was: what is held was a glitch
        n_held = len(clock.held)
        clock, out, dropped, jumps = _believe(replace_unchecked(clock, held=()), row, max_gap_s)
        return clock, out, dropped + n_held, jumps + 1
    if time_s <= latest_s:
        return clock, [], 1, 0
    held = (*clock.held, moved)
    if first_s - clock.last_s > _PLAIN_GAP_S and len(held) < CLOCK_RESET_SAMPLES:
        return replace_unchecked(clock, held=held), [], 0, 0
    return replace_unchecked(clock, held=(), last_s=time_s), list(held), 0, 0


def _behind(clock: ClockState, time_s: float, max_gap_s: float) -> tuple[ClockState, list[FloatArray], int, int]:
    """After a row that is not after the last one: it is dropped, and the clock set back if there were many."""
    clock = replace_unchecked(
        clock, behind_s=time_s, moving=clock.moving or time_s > clock.behind_s > -np.inf, n_behind=clock.n_behind + 1
    )
    if clock.n_behind < CLOCK_RESET_SAMPLES or not clock.moving:
        return clock, [], 1, 0
    # what comes next follows after a gap of unknown length, of which the dropped samples are a part
    offset_s = clock.offset_s + clock.last_s - time_s + 2 * max_gap_s
    return ClockState(clock.last_s, offset_s), [], 1 + len(clock.held), 1


class _SetBack(NamedTuple):
    """A clock that was set back between two samples."""

    begin_s: float  # the first time of the stretch before
    before_s: float  # its last one
    after_s: float  # the first time after
    ahead_s: float  # what all times after it lack


AnyFix = TypeVar("AnyFix", bound=Fix)


def moved(fix: AnyFix, offset_s: float) -> AnyFix:
    """A fix on the track's time base."""
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
                f"the clock of the samples was set back, and {name} of {type(fix).__name__} cannot be set: make time_s "
                "and received_time_s attributes"
            ) from None
    return later


def one_clock(recording: Recording, fixes: Iterable[AnyFix] = ()) -> tuple[Recording, tuple[AnyFix, ...]]:
    """The same on one clock: where that of the accelerometer was set back, all times after it go on from before.

    Other streams and fixes, in recorded order, are set back where their own times fall there; where none does, as
    in a stream that was sorted, each belongs to the stretch in whose time it is. Truth stays as it is.
    """
    set_backs, fixes = _set_backs(recording.accelerometer.time_s), tuple(fixes)
    if not set_backs:
        return recording, fixes
    offsets_s = np.cumsum([0.0, *(s.ahead_s for s in set_backs)])
    streams = {
        name: Samples(stream.time_s + offsets_s[_stretch(stream.time_s, set_backs)], stream.values)
        for name, stream in recording.streams.items()
    }
    of_fixes = offsets_s[_stretch(np.array([fix.time_s for fix in fixes]), set_backs)]
    words = (f"the clock was set back by {s.before_s - s.after_s:.1f} s after {s.before_s:.1f} s" for s in set_backs)
    notes = (*recording.notes, *(f"{text}: times go on from there" for text in words))
    wifi = recording.wifi
    if wifi is not None:
        wifi = dataclasses.replace(wifi, time_s=wifi.time_s + offsets_s[_stretch(wifi.time_s, set_backs)])
    on_one = dataclasses.replace(recording, **streams, wifi=wifi, notes=notes)
    return on_one, tuple(moved(fix, float(offset_s)) for fix, offset_s in zip(fixes, of_fixes, strict=True))


def _set_backs(time_s: FloatArray, max_gap_s: float = 0.3) -> list[_SetBack]:
    """Where `follow` would follow a clock back, in order."""
    index = np.flatnonzero(np.isfinite(time_s))
    known_s = time_s[index]
    if (known_s < np.maximum.accumulate(known_s)).sum() < CLOCK_RESET_SAMPLES:
        return []
    _, rows, _, _ = follow(ClockState(), np.column_stack([known_s, np.arange(float(len(known_s)))]), max_gap_s)
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


# Streams start and end this much apart.
_APART_S = 1.0


def _stretch(time_s: FloatArray, set_backs: Sequence[_SetBack]) -> IntArray:
    """How often the clock had been set back before each time (N,), in recorded order."""
    result, start = np.zeros(len(time_s), dtype=int), 0
    for number, (begin_s, before_s, after_s, _) in enumerate(set_backs, start=1):
        rest = time_s[start:]
        falls = start + 1 + np.flatnonzero(np.diff(rest) < 0)
        away_s = np.abs(time_s[falls - 1] - before_s) + np.abs(time_s[falls] - after_s)
        if (away_s < before_s - after_s).any():
            start = int(falls[away_s.argmin()])
            result[start:] = number
        else:
            result[start:][(rest < begin_s - _APART_S) | (rest > before_s + _APART_S)] = number
    return result
