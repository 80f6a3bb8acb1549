"""Samples of one sensor, and of all sensors on one clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pdr_filter.values.arrays import FloatArray, read_only, reduction

#: Standard gravity, m/s2.
STANDARD_GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Samples:
    """Samples of one sensor with their own timestamps.

    Attributes
    ----------
    time_s : array_like, shape (N,)
        Times since the first accelerometer sample, s. They are as recorded, so that they may repeat or decrease.
    values : array_like, shape (N, d)
        Values in the units of the stream, as described by `Recording`. Missing values are NaN.

    Raises
    ------
    ValueError
        If times and values do not have the same number of rows.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> time_s = np.arange(0.0, 1.0, 0.01)
    >>> samples = pdr.Samples(time_s, np.tile([0.0, 0.0, 9.81], (len(time_s), 1)))
    >>> len(samples), samples.values.shape
    (100, (100, 3))
    """

    time_s: FloatArray
    values: FloatArray

    __reduce__ = reduction

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_s", read_only(self.time_s, "time_s"))
        object.__setattr__(self, "values", read_only(self.values))
        if self.time_s.ndim != 1 or self.values.ndim != 2 or len(self.time_s) != len(self.values):
            raise ValueError(
                f"time_s must be (N,) and values (N, d), got {self.time_s.shape} and {self.values.shape}: "
                "give one time for each row"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Samples({len(self)} x {self.values.shape[1]})"


@dataclass(frozen=True, slots=True, eq=False)
class ImuBlock:
    """Samples of all sensors at common times, in the sensor frame: the input of `OnlineFilter.push`.

    NaN marks missing values. A row without specific force is interpolated or becomes a gap. The angular rate may be
    missing for any time.
    """

    time_s: FloatArray  # (N,)
    specific_force_mps2: FloatArray  # (N, 3), norm about 9.81 at rest
    angular_rate_radps: FloatArray  # (N, 3)
    magnetic_field_ut: FloatArray  # (N, 3)

    def parts(self, n: int) -> Iterator[ImuBlock]:
        """Yield the block in consecutive pieces of at most n samples."""
        if len(self.time_s) <= n:
            yield self
            return
        for start in range(0, len(self.time_s), n):
            part = slice(start, start + n)
            yield ImuBlock(
                self.time_s[part],
                self.specific_force_mps2[part],
                self.angular_rate_radps[part],
                self.magnetic_field_ut[part],
            )
