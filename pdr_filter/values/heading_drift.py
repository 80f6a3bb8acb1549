"""How fast the heading is lost between measurements: one belief of the heading stage, the filter and the smoother."""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np

from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.checks import check_numbers


@dataclass(frozen=True)
class HeadingDrift:
    """Growth of the variance of the heading offset (walking less device heading) with time."""

    # While the angular rate is measured: what the bias does not explain, and the body's turning against the phone.
    random_walk_rad_per_sqrt_s: float = 0.008
    unknown_rad_per_sqrt_s: float = 1.0  # while no angular rate is measured: after a few seconds nothing is known
    # How long an error of the gyroscope's bias lasts, which enters the heading as a random walk with this memory, for
    # recipes that learn no walking heading. The default's stage sets `Step.yaw_bias_std_radps` so that the walk is what
    # its bank of biases has lost, whatever this is.
    bias_correlation_s: float = 3.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=vars(self))

    @overload
    def variances_rad2(self, elapsed_s: float, unknown_s: float, yaw_bias_std_radps: float) -> tuple[float, float]: ...

    @overload
    def variances_rad2(
        self, elapsed_s: float, unknown_s: float, yaw_bias_std_radps: float, besides_rad2_per_s: FloatArray
    ) -> tuple[FloatArray, float]: ...

    @overload
    def variances_rad2(
        self,
        elapsed_s: FloatArray,
        unknown_s: FloatArray,
        yaw_bias_std_radps: FloatArray,
        besides_rad2_per_s: FloatArray,
    ) -> tuple[FloatArray, FloatArray]: ...

    def variances_rad2(
        self,
        elapsed_s: float | FloatArray,
        unknown_s: float | FloatArray,
        yaw_bias_std_radps: float | FloatArray,
        besides_rad2_per_s: float | FloatArray = 0.0,
    ) -> tuple[float | FloatArray, float | FloatArray]:
        """Variance gained in a time while the angular rate was measured, and in the part of it while it was not.

        `yaw_bias_std_radps` is the standard deviation of the gyroscope's bias about the vertical, `besides_rad2_per_s`
        another random walk, such as a mode's own.
        """
        is_number = isinstance(elapsed_s, float) and isinstance(unknown_s, float)
        unknown = min(unknown_s, elapsed_s) if is_number else np.minimum(unknown_s, elapsed_s)
        rate = self.random_walk_rad_per_sqrt_s**2 + 2 * self.bias_correlation_s * yaw_bias_std_radps**2
        return (rate + besides_rad2_per_s) * (elapsed_s - unknown), self.unmeasured_rad2(unknown)

    def unmeasured_rad2(self, time_s: float | FloatArray) -> float | FloatArray:
        """Variance gained in a time without angular rate."""
        return self.unknown_rad_per_sqrt_s**2 * time_s
