"""The last context windows, as a tracker remembers them, and which of them belongs to a step."""

from __future__ import annotations

import numpy as np

from pdr_filter.sensing.contexts.context_stage import WindowContext

# A gate may hold the first steps of a bout for some seconds.
WINDOW_MEMORY_S = 12.0

RecentWindows = tuple[WindowContext, ...]  # of one segment, oldest first


def with_window(windows: RecentWindows, window: WindowContext) -> RecentWindows:
    """The windows with one more; one whose probabilities are not numbers says nothing and is left out."""
    if not np.isfinite(window.prob).all():
        return windows
    return (*(w for w in windows if w.time_s > window.time_s - WINDOW_MEMORY_S), window)


def window_before(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """The last window that has samples of its own at or before a time: later ones belong to later steps.

    The first window of a segment follows on none: all of its samples are its own.
    """
    return next((w for w in reversed(windows) if w.new_since_s <= time_s), windows[0] if windows else None)


def n_after(windows: RecentWindows, window: WindowContext) -> int:
    """How many windows there are after one of them."""
    n = 0
    while windows[-1 - n].time_s > window.time_s:
        n += 1
    return n


def window_around(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """The first window that ends at or after a time, if it is known: the one in which the time is new."""
    return next((w for w in windows if w.time_s >= time_s), None)


def window_after(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """The first window whose own samples are all at or after a time, if it is known: the one after `window_around`."""
    return next((w for w in windows if w.new_since_s >= time_s), None)
