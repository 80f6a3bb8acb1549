"""Recent context windows stored by a tracker, and the assignment of windows to steps."""

from __future__ import annotations

import numpy as np

from pdr_filter.values import WindowContext

# The step gate may delay the first steps of a bout by some seconds.
WINDOW_MEMORY_S = 12.0

RecentWindows = tuple[WindowContext, ...]  # windows of one segment, oldest first


def with_window(windows: RecentWindows, window: WindowContext) -> RecentWindows:
    """Return the windows with one more, without those older than `WINDOW_MEMORY_S`.

    A window whose probabilities are not finite has no information and is not added.
    """
    if not np.isfinite(window.prob).all():
        return windows
    return (*(w for w in windows if w.time_s > window.time_s - WINDOW_MEMORY_S), window)


def window_before(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """Return the last window whose new samples begin at or before a time, or None without windows.

    Windows overlap. The new samples of a window are those of its last hop, which no earlier window contains. Later
    windows belong to later steps. The oldest of `windows` is returned for earlier times. It is usually the first
    window of a segment, of which all samples are new.
    """
    return next((w for w in reversed(windows) if w.new_since_s <= time_s), windows[0] if windows else None)


def n_after(windows: RecentWindows, window: WindowContext) -> int:
    """Return the number of windows in `windows` that are later than `window`."""
    n = 0
    while windows[-1 - n].time_s > window.time_s:
        n += 1
    return n


def window_around(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """Return the first window that ends at or after a time, or None if no such window has been classified yet."""
    return next((w for w in windows if w.time_s >= time_s), None)


def window_after(windows: RecentWindows, time_s: float) -> WindowContext | None:
    """Return the first window whose new samples all lie at or after a time, or None if it is not yet classified.

    It is the window after the one that `window_around` returns.
    """
    return next((w for w in windows if w.new_since_s >= time_s), None)
