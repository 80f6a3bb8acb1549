"""Step-length models: length = regressors(step) @ theta. The filter and the calibration use the same ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pdr_filter.types import FloatArray, IntArray, Step, read_only


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
        """Length in m (never negative) and its variance in m2: r theta, r theta_cov r' + residual variance."""
        r = self.model.regressors(step)
        length_m = max(float(r @ self.theta), 0.0)
        return length_m, float(r @ self.theta_cov @ r) + self.residual_std_m**2


@dataclass(frozen=True, eq=False)
class StepLengths:
    """Lengths of one step under several fits at once: the same numbers as each `StepLengthFit.predict`."""

    fits: tuple[StepLengthFit, ...]

    @cached_property
    def _groups(self) -> list[tuple[StepLengthModel, IntArray, FloatArray, FloatArray, FloatArray]]:
        """For each distinct model: which fits use it, their theta (m, p), covariance (m, p, p), residual variance."""
        models: list[StepLengthModel] = []
        for fit in self.fits:
            if fit.model not in models:
                models.append(fit.model)
        groups: list[tuple[StepLengthModel, IntArray, FloatArray, FloatArray, FloatArray]] = []
        for model in models:
            index = np.array([i for i, fit in enumerate(self.fits) if fit.model == model])
            own = [self.fits[i] for i in index]
            theta, cov = np.stack([f.theta for f in own]), np.stack([f.theta_cov for f in own])
            groups.append((model, index, theta, cov, np.array([f.residual_std_m**2 for f in own])))
        return groups

    def predict(self, step: Step) -> tuple[FloatArray, FloatArray]:
        """Lengths in m (never negative) and their variances in m2, shape (M,) each."""
        length, variance = np.empty(len(self.fits)), np.empty(len(self.fits))
        for model, index, theta, cov, residual in self._groups:
            r = model.regressors(step)
            length[index] = theta @ r
            variance[index] = (cov @ r) @ r + residual
        return np.maximum(length, 0.0), variance


def known_length(length_m: float, std_m: float) -> StepLengthFit:
    """A fit of eq. 12 that gives one length whatever the step: k1 = k2 = 0."""
    return StepLengthFit(FrequencyVarianceStepLength(), np.array([length_m, 0.0, 0.0]), np.zeros((3, 3)), std_m)
