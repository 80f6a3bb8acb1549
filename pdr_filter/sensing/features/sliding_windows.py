"""Windows cut from a stream that arrives in blocks: the one place that counts their samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import FloatArray, check_numbers


@dataclass(frozen=True, slots=True, eq=False)
class SampleWindow:
    """The samples of one window."""

    last: int  # number of its last sample
    start_s: float
    end_s: float
    samples: FloatArray  # (R, N) contiguous, so that reductions take the same path for every window


@dataclass(frozen=True, slots=True, eq=False)
class WindowBuffer:
    """Samples that later windows still need."""

    first: int  # number of the first sample in the buffer
    rows: FloatArray  # (1 + R, B) time and signals


@dataclass(frozen=True, slots=True, eq=False)
class DescribedWindow:
    """What is known of the samples of one window."""

    start_s: float
    time_s: float  # its end


W = TypeVar("W")  # state
X = TypeVar("X", bound=DescribedWindow)


@dataclass(frozen=True)
class SlidingWindows(ABC, Generic[W, X]):
    """Windows of constant length and advance, each described by features; the first starts with the segment.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    window_s, hop_s : float
        Length and advance; the hop is at most the window.
    """

    rate_hz: float = 100.0
    window_s: float = 2.0
    hop_s: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self)
        if not 1 <= self.hop_samples <= self.window_samples:
            raise ValueError(
                f"hop_s must be positive and at most window_s, got {self.hop_samples} and {self.window_samples} samples"
            )

    @property
    def window_samples(self) -> int:
        """Length in samples."""
        return round(self.window_s * self.rate_hz)

    @property
    def hop_samples(self) -> int:
        """Advance in samples."""
        return round(self.hop_s * self.rate_hz)

    @abstractmethod
    def init(self) -> W:
        """State before the first sample."""

    def after_gap(self, state: W) -> W:
        """State at the start of a new segment: every window stands alone."""
        return self.init()

    @abstractmethod
    def update(self, state: W, block: UniformBlock, attitude: AttitudeBlock) -> tuple[W, list[tuple[int, X]]]:
        """New state and the windows that became complete, each with the number of its last sample."""

    def cut(
        self, buffer: WindowBuffer, time_s: FloatArray, *signals: FloatArray
    ) -> tuple[WindowBuffer, list[SampleWindow]]:
        """What is left of the buffer and of further signals, R in all of (r, N), and the windows that became complete.

        `time_s` (N,) is the middle of each sample's interval.
        """
        n_rows, n_old = buffer.rows.shape
        rows = np.empty((n_rows, n_old + len(time_s)))
        rows[:, :n_old] = buffer.rows
        np.concatenate([time_s[None], *signals], out=rows[:, n_old:])
        half_s = 0.5 / self.rate_hz
        windows: list[SampleWindow] = []
        start, n = 0, self.window_samples
        while start + n <= rows.shape[1]:
            samples = np.ascontiguousarray(rows[1:, start : start + n])
            from_s, until_s = float(rows[0, start]) - half_s, float(rows[0, start + n - 1]) + half_s
            windows.append(SampleWindow(buffer.first + start + n - 1, from_s, until_s, samples))
            start += self.hop_samples
        # a copy: a view would keep the whole block in memory
        return WindowBuffer(buffer.first + start, rows[:, start:].copy()), windows


def no_samples(n_signals: int) -> WindowBuffer:
    """Return the empty buffer of `n_signals` signals, for the start of a segment."""
    return WindowBuffer(0, np.empty((1 + n_signals, 0)))
