"""Windows cut from a stream that arrives in blocks: the one place that counts their samples."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray


def take_windows(
    buffer: FloatArray, first: int, window_samples: int, hop_samples: int
) -> tuple[FloatArray, int, list[tuple[int, FloatArray]]]:
    """What is left of the buffer (rows, B'), the index of its first sample, and the windows that are complete.

    Each window is its last sample's index and its samples (rows, window_samples), contiguous, so that reductions take
    the same path for every window. The hop is at most the window.
    """
    windows: list[tuple[int, FloatArray]] = []
    start = 0
    while start + window_samples <= buffer.shape[1]:
        samples = np.ascontiguousarray(buffer[:, start : start + window_samples])
        windows.append((first + start + window_samples - 1, samples))
        start += hop_samples
    # a copy: a view would keep the whole block in memory
    return buffer[:, start:].copy(), first + start, windows


def check_window(window_samples: int, hop_samples: int) -> None:
    """Raise ValueError unless the hop is positive and at most the window."""
    if not 1 <= hop_samples <= window_samples:
        raise ValueError(f"hop_s must be positive and at most window_s, got {hop_samples} and {window_samples} samples")
