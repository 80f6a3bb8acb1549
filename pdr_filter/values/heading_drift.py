"""Drift of the heading between measurements, shared by the heading stage, the filter and the smoother."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.checks import check_numbers

N = TypeVar("N", float, FloatArray)


@dataclass(frozen=True)
class HeadingDrift:
    """Growth of the variance of the heading offset (walking direction minus device heading) with time.

    Attributes
    ----------
    random_walk_rad_per_sqrt_s : float, default 0.008
        Random walk while the angular rate is measured, rad / sqrt(s). It covers rotations of the body against the
        phone, and gyroscope errors other than the bias.
    unknown_rad_per_sqrt_s : float, default 1.0
        Random walk while the angular rate is not measured, rad / sqrt(s). The heading is unknown after a few seconds.
    bias_correlation_s : float, default 3.0
        Time constant of the error of the gyroscope bias, s, for recipes that do not estimate the walking direction: the
        error enters the heading as a random walk. The default heading stage chooses `Step.yaw_bias_std_radps` so that
        the resulting random walk equals the variance of its bank of biases, for any value of this field.

    Examples
    --------
    >>> from pdr_filter.values.heading_drift import HeadingDrift
    >>> measured_rad2, unmeasured_rad2 = HeadingDrift().variances_rad2(10.0, 2.0, 0.001)
    >>> round(measured_rad2, 6), unmeasured_rad2
    (0.00056, 2.0)
    """

    random_walk_rad_per_sqrt_s: float = 0.008
    unknown_rad_per_sqrt_s: float = 1.0
    bias_correlation_s: float = 3.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=vars(self))

    def variances_rad2(
        self, elapsed_s: N, unknown_s: N, yaw_bias_std_radps: N, besides_rad2_per_s: float | FloatArray = 0.0
    ) -> tuple[Any, N]:
        """Return the variance gained with and without angular rate.

        Parameters
        ----------
        elapsed_s, unknown_s : float or ndarray
            Elapsed time, and its part without angular rate, s.
        yaw_bias_std_radps : float or ndarray
            Standard deviation of the gyroscope bias about the vertical, rad/s.
        besides_rad2_per_s : float or ndarray, default 0.0
            Additional random walk, such as the one of a mode, rad^2/s.

        Returns
        -------
        tuple of float or ndarray
            Variance gained while the angular rate was measured, and while it was not, rad^2.
        """
        unknown: Any = min(unknown_s, elapsed_s) if isinstance(elapsed_s, float) else np.minimum(unknown_s, elapsed_s)
        rate = self.random_walk_rad_per_sqrt_s**2 + 2 * self.bias_correlation_s * yaw_bias_std_radps**2
        return (rate + besides_rad2_per_s) * (elapsed_s - unknown), self.unmeasured_rad2(unknown)

    def unmeasured_rad2(self, time_s: N) -> N:
        """Return the variance gained in a time without angular rate.

        Parameters
        ----------
        time_s : float or ndarray
            Time without angular rate, s.

        Returns
        -------
        float or ndarray
            Variance of the heading, rad^2.
        """
        return self.unknown_rad_per_sqrt_s**2 * time_s
