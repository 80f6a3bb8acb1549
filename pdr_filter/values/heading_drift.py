"""How fast the heading is lost between measurements: one belief of the heading stage, the filter and the smoother."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pdr_filter.values.arrays import FloatArray

_Number = TypeVar("_Number", float, FloatArray)


@dataclass(frozen=True)
class HeadingDrift:
    """Growth of the variance of the heading offset (walking less device heading) with time.

    Parameters
    ----------
    random_walk_rad_per_sqrt_s : float
        Random walk while the angular rate is measured: what the bias does not explain, and the body's turning against
        the phone.
    unknown_rad_per_sqrt_s : float
        Random walk while no angular rate is measured: after a few seconds nothing is known.
    bias_correlation_s : float
        How long an error of the gyroscope's bias lasts; its variance enters the heading as a random walk with this
        memory. It is short, because the standard deviation of the bias at the start is that of a mixture: few phones
        are off by 0.05 rad/s, most by less than 0.002. With these values the errors of real hand-held walks are about
        as large as predicted (docs/benchmarks.md).
    """

    random_walk_rad_per_sqrt_s: float = 0.008
    unknown_rad_per_sqrt_s: float = 1.0
    bias_correlation_s: float = 3.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise ValueError(f"{name} must be 0 or more and finite, got {value}")

    @property
    def of_device(self) -> HeadingDrift:
        """The same of the device's own heading, which the body's turning against the phone does not touch."""
        return replace(self, random_walk_rad_per_sqrt_s=0.0)

    def variances_rad2(
        self,
        elapsed_s: _Number,
        unknown_s: _Number,
        yaw_bias_std_radps: _Number,
        besides_rad2_per_s: float | FloatArray = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Variance gained in a time with angular rate, and in the part of it without.

        Parameters
        ----------
        elapsed_s, unknown_s : float or array
            The whole time, and how much of it was without angular rate; more than the whole counts as the whole.
        yaw_bias_std_radps : float or array
            Standard deviation of the gyroscope's bias about the vertical.
        besides_rad2_per_s : float or array
            Another random walk, such as a mode's own.
        """
        unknown = np.minimum(unknown_s, elapsed_s)
        rate = self.random_walk_rad_per_sqrt_s**2 + 2 * self.bias_correlation_s * yaw_bias_std_radps**2
        return (rate + besides_rad2_per_s) * (elapsed_s - unknown), self.unmeasured_rad2(unknown)

    def unmeasured_rad2(self, time_s: float | FloatArray) -> FloatArray:
        """Variance gained in a time without angular rate."""
        return np.asarray(self.unknown_rad_per_sqrt_s**2 * time_s)
