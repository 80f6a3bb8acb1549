"""Cut sliding windows from a stream that arrives in blocks. No other module counts the samples of windows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import FloatArray, check_numbers


@dataclass(frozen=True, slots=True, eq=False)
class SampleWindow:
    """Samples of one window.

    Attributes
    ----------
    last : int
        Index of the last sample in the segment, from 0.
    start_s, end_s : float
        Start and end of the window, s.
    samples : FloatArray
        Signals, shape (R, N), contiguous so that sums have the same order for every window.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.features.sliding_windows import SampleWindow
    >>> SampleWindow(last=199, start_s=0.0, end_s=2.0, samples=np.zeros((3, 200))).samples.shape
    (3, 200)
    """

    last: int
    start_s: float
    end_s: float
    samples: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WindowBuffer:
    """Samples that later windows still need.

    Attributes
    ----------
    first : int
        Number of the first buffered sample in the segment.
    rows : FloatArray
        Times and signals, shape (1 + R, B).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.features.sliding_windows import WindowBuffer
    >>> WindowBuffer(first=100, rows=np.zeros((4, 100))).first
    100
    """

    first: int
    rows: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DescribedWindow:
    """Time span of a window, the base class of descriptions of windows.

    Attributes
    ----------
    start_s : float
        Start of the window, s.
    time_s : float
        End of the window, s.

    Examples
    --------
    >>> from pdr_filter.sensing.features.sliding_windows import DescribedWindow
    >>> DescribedWindow(start_s=0.0, time_s=2.0).time_s
    2.0
    """

    start_s: float
    time_s: float


W = TypeVar("W")  # type of the state
X = TypeVar("X", bound=DescribedWindow)  # type of the description of a window


@dataclass(frozen=True)
class SlidingWindows(ABC, Generic[W, X]):
    """Base class of stages that cut windows of constant length and hop. The first window starts with the segment.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    window_s : float, default 2
        Length of the windows, s.
    hop_s : float, default 1
        Time between the starts of consecutive windows, s, at most `window_s`.

    Raises
    ------
    ValueError
        If a parameter is not positive or the hop is longer than the window.

    Examples
    --------
    >>> from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
    >>> from pdr_filter.sensing.features.sliding_windows import SlidingWindows
    >>> windows = FeatureWindows(features=ATTITUDE_FREE)
    >>> isinstance(windows, SlidingWindows), windows.hop_samples
    (True, 100)
    """

    rate_hz: float = 100.0
    window_s: float = 2.0
    hop_s: float = 1.0

    _may_be_zero: ClassVar[tuple[str, ...]] = ()  # names of the parameters that may be 0

    def __post_init__(self) -> None:
        check_numbers(self, zero=self._may_be_zero)
        if not 1 <= self.hop_samples <= self.window_samples:
            raise ValueError(
                f"hop_s must be positive and at most window_s, got {self.hop_s} s ({self.hop_samples} samples) and "
                f"{self.window_s} s ({self.window_samples} samples): shorten hop_s or lengthen window_s"
            )

    @property
    def window_samples(self) -> int:
        """Length of a window in samples."""
        return round(self.window_s * self.rate_hz)

    @property
    def hop_samples(self) -> int:
        """Hop in samples."""
        return round(self.hop_s * self.rate_hz)

    @abstractmethod
    def init(self) -> W:
        """Return the state before the first sample.

        Returns
        -------
        W
            Initial state.
        """

    def after_gap(self, state: W) -> W:
        """Return the initial state at the start of a segment after a gap, because no window spans a gap.

        Parameters
        ----------
        state : W
            State before the gap.

        Returns
        -------
        W
            Initial state.
        """
        return self.init()

    @abstractmethod
    def update(self, state: W, block: UniformBlock, attitude: AttitudeBlock) -> tuple[W, list[tuple[int, X]]]:
        """Return the new state and the windows that a block completes.

        Parameters
        ----------
        state : W
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow, N samples.
        attitude : AttitudeBlock
            Attitude at these samples.

        Returns
        -------
        state : W
            New state.
        windows : list of (int, X)
            Descriptions of the windows, each with the index of its last sample in the segment, from 0.
        """

    def cut(
        self, buffer: WindowBuffer, time_s: FloatArray, *signals: FloatArray
    ) -> tuple[WindowBuffer, list[SampleWindow]]:
        """Return the new buffer and the windows completed by further samples.

        Parameters
        ----------
        buffer : WindowBuffer
            Buffer of R signals after the previous samples.
        time_s : (N,) array
            Middles of the intervals of the samples, s.
        *signals : (r, N) array
            Signals, with R rows in total.

        Returns
        -------
        buffer : WindowBuffer
            New buffer.
        windows : list of SampleWindow
            Completed windows in the order of time.
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
        # Copied, because a view would keep the whole block in memory.
        return WindowBuffer(buffer.first + start, rows[:, start:].copy()), windows


def no_samples(n_signals: int) -> WindowBuffer:
    """Return the empty buffer at the start of a segment.

    Parameters
    ----------
    n_signals : int
        Number R of signals.

    Returns
    -------
    WindowBuffer
        Buffer with rows of shape (1 + R, 0).

    Examples
    --------
    >>> from pdr_filter.sensing.features.sliding_windows import no_samples
    >>> no_samples(3).rows.shape
    (4, 0)
    """
    return WindowBuffer(0, np.empty((1 + n_signals, 0)))
