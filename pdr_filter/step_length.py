"""Step-length models: length = regressors(step) @ theta. The filter and the calibration use the same ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pdr_filter.types import FloatArray, Step, read_only


class StepLengthModel(Protocol):
    """A model that is linear in its parameters."""

    @property
    def n_params(self) -> int:
        """Number of parameters p."""
        ...

    def regressors(self, step: Step) -> FloatArray:
        """Regressors of one step, shape (p,): also the derivative of the length with respect to theta."""
        ...


@dataclass(frozen=True)
class FrequencyVarianceStepLength:
    """Martinelli et al. (2018), eq. 12: L = k0 + k1 f_s + k2 sigma_f^2, theta = (k0, k1, k2) in m, m s, s4/m.

    `max_variance` bounds sigma_f^2 in m2/s4: the variance of a phone in a trouser pocket reaches ten times that of
    one in the hand, and a parameter fitted in the hand would make giants of them (deviation: the paper has one
    placement, the waist, and no bound).
    """

    max_variance: float = np.inf
    n_params: int = 3

    def regressors(self, step: Step) -> FloatArray:
        """(1, f_s, sigma_f^2)."""
        return np.array([1.0, step.frequency_hz, min(step.variance, self.max_variance)])


@dataclass(frozen=True, eq=False)
class StepLengthFit:
    """A model with its parameters, their covariance, and what it leaves unexplained.

    Parameters
    ----------
    model : StepLengthModel
        Regressors of a step.
    theta : (p,)
        Parameters.
    theta_cov : (p, p)
        Their covariance.
    residual_std_m : float
        Standard deviation of a single step about the model.
    """

    model: StepLengthModel
    theta: FloatArray
    theta_cov: FloatArray
    residual_std_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", read_only(self.theta))
        object.__setattr__(self, "theta_cov", read_only(self.theta_cov))
        p = self.model.n_params
        if self.theta.shape != (p,) or self.theta_cov.shape != (p, p) or self.residual_std_m < 0:
            raise ValueError(
                f"{type(self.model).__name__} needs theta ({p},), theta_cov ({p}, {p}) and residual_std_m >= 0, got "
                f"{self.theta.shape}, {self.theta_cov.shape}, {self.residual_std_m}"
            )

    def predict(self, step: Step) -> tuple[float, float]:
        """Length in m (never negative) and its variance in m2: r theta_cov r' + residual variance."""
        r = self.model.regressors(step)
        length_m = max(float(r @ self.theta), 0.0)
        return length_m, float(r @ self.theta_cov @ r) + self.residual_std_m**2


def known_length(length_m: float, std_m: float) -> StepLengthFit:
    """A fit of eq. 12 that gives one length whatever the step: k1 = k2 = 0."""
    return StepLengthFit(FrequencyVarianceStepLength(), np.array([length_m, 0.0, 0.0]), np.zeros((3, 3)), std_m)
