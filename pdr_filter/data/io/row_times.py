"""Repair of row times: rows out of order, and groups of samples with a single time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pdr_filter.sensing.clock import REORDER_S
from pdr_filter.values import FloatArray, IntArray, how_many
from pdr_filter.values.limits import GAP_INTERVALS, GAP_S

Streams = Mapping[str, tuple[FloatArray, FloatArray]]

# Share of the rows that repeat the time of the row before: in packs of two it is a half, in a phone's jitter a few
# hundredths.
_PACKED_SHARE = 1 / 3
_FEWEST_PACKS = 10
# A longer pack hides lost samples. One second is also what a clock shows that a spreadsheet rounded.
_LONGEST_PACK_S = 2.0
# A time from which more than this many periods of the samples are missing begins after a loss.
_LOST = 1.5


def in_order(streams: Streams, suffix: str, notes: list[str]) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the streams, with rows sorted by time if rows were moved within the table by an edit.

    Rows after a backward jump of the clock stay as recorded, because the filter handles such jumps: moved rows fill a
    gap when sorted, rows after a jump do not. If the accelerometer shows a jump, no stream is sorted. `notes` names
    sorted streams, with `suffix` after the name.
    """
    found = dict(streams)
    late = {name: n_late for name, (time_s, _) in streams.items() if (n_late := _n_late(time_s))}
    orders = {name: _order(streams[name][0], n_late) for name, n_late in late.items()}
    if orders.get("accelerometer", ...) is None:
        return found
    moved: dict[str, int] = {}
    for name, order in orders.items():
        if order is not None:
            time_s, values = streams[name]
            found[name] = time_s[order], values[order]
            moved[name + suffix] = late[name]
    if moved:
        words = f"{how_many(max(moved.values()), 'row')} out of order, as after editing a table, sorted by time"
        notes.append(f"{', '.join(moved)}: {words}")
    return found


def streams_with_own_times(
    streams: Streams, is_clock: bool, rate_hz: float, notes: list[str]
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return streams in which samples that share one time get individual times, with a note on their rate.

    Bluetooth sensors send several samples in a packet with the time of the last one. `rate_hz` is their sampling rate,
    or 0 to estimate it. Streams in which at most a third of the rows repeat a time with other values are unchanged, and
    so are times that a spreadsheet rounded: to whole seconds, or to tenths if they are dates or times of day
    (`is_clock`).
    """
    found, said = dict(streams), dict[str, list[str]]()
    for name in ("accelerometer", "gyroscope", "magnetometer"):
        if name not in streams:
            continue
        time_s, values = streams[name]
        repeats = np.diff(time_s) == 0
        if repeats.sum() <= _PACKED_SHARE * len(time_s):
            continue
        last = np.append(np.flatnonzero(~repeats), len(time_s) - 1)  # last rows of the packs
        repeats &= (np.diff(values, axis=0) != 0).any(axis=1)
        if repeats.sum() <= _PACKED_SHARE * len(time_s) or len(last) < _FEWEST_PACKS:
            continue
        pack_s, n = time_s[last], np.diff(last, prepend=-1)
        apart_s = np.diff(pack_s)
        grid_s = 0.1 if is_clock else 1.0
        is_rounded = bool((np.abs(pack_s / grid_s - np.round(pack_s / grid_s)) < 1e-6).all())
        if is_rounded or not (apart_s.min() > 0 and np.median(apart_s) <= _LONGEST_PACK_S):
            continue  # refused by the checks of every reader
        period_s = 1 / rate_hz if rate_hz else float(np.median(apart_s / n[1:]))
        before_s = np.append(-np.inf, pack_s[:-1])
        is_after_loss = pack_s - before_s > _LOST * n * period_s
        each_s = np.where(is_after_loss, period_s, (pack_s - np.where(is_after_loss, 0.0, before_s)) / n)
        from_last = np.repeat(last, n) - np.arange(len(time_s))
        found[name] = np.repeat(pack_s, n) - from_last * np.repeat(each_s, n), values
        how = "as given" if rate_hz else "estimated; rate_hz in a TOML file gives another"
        words = (
            f"samples come in packs of {np.median(n):g} with one time each, as from Bluetooth sensors, and are spread"
        )
        said.setdefault(f"{words} at {1 / period_s:.4g} Hz ({how})", []).append(name)
    notes += [f"{', '.join(names)}: {words}" for words, names in said.items()]
    return found


def _n_late(time_s: FloatArray) -> int:
    """Return the number of rows that are earlier than a row above them, or 0 if only the clock jitters."""
    late_s = np.fmax.accumulate(time_s) - time_s
    return int((late_s > 0).sum()) if (late_s > REORDER_S).any() else 0


def _order(time_s: FloatArray, n_late: int) -> IntArray | None:
    """Return the order of the rows by time, or None if sorting does not restore the original order."""
    order = np.argsort(time_s, kind="stable")
    apart_s, sorted_s = np.diff(time_s), np.diff(time_s[order])
    period_s = float(np.nanmedian(np.abs(apart_s[apart_s != 0])))
    gap_s = max(GAP_S, GAP_INTERVALS * period_s)
    n_between = int((sorted_s < 0.5 * period_s).sum()) - int((np.abs(apart_s) < 0.5 * period_s).sum())
    makes_gaps = (sorted_s > gap_s).sum() > (apart_s > gap_s).sum()
    return None if makes_gaps or 10 * n_between > n_late else order
