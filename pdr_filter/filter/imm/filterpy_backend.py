"""IMM arithmetic with the classes of filterpy: slow and readable, the reference for `pdr_filter.filter.imm.imm`.

`IMMEstimator` of filterpy 2.0 has four problems, which `MendedIMMEstimator` corrects:

1. Its documentation says that M[i, j] leads from mode j to mode i. It leads from i to j, and rows sum to one.
2. `update(None)` should change nothing, but it weights the modes by the likelihood of a zero innovation.
3. A second `predict` without a measurement in between does not change the mode probabilities.
4. Likelihoods that underflow are replaced by the smallest number, so that their evidence is lost. Logarithms keep it.

In addition, a mode that cannot be reached from any other divides zero by zero. Here it keeps its own estimate.

The functions have the names, arguments and results of those in `pdr_filter.filter.imm.imm`, for a single pedestrian.
`ImmTracker(model, FilterpyImm())` uses them. In the tests, the two implementations agree to 1e-9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdr_filter.values import FloatArray, softmax
from pdr_filter.values.optional_packages import load_optional

_KALMAN = load_optional("filterpy.kalman")


class MendedIMMEstimator(_KALMAN.IMMEstimator):  # filterpy has no type hints
    """IMM (interacting multiple model) estimator of filterpy, with four corrections.

    - `M[i, j]` is the transition probability from mode i to mode j, and rows sum to one.
    - A measurement of None changes nothing.
    - Each `predict` applies a transition to the mode probabilities, also without a measurement in between.
    - Likelihoods are logarithms, so that those that underflow keep their evidence.
    """

    def predict(self, u: Any = None) -> None:
        """Mix the modes, predict each of them, and apply one transition to the mode probabilities."""
        self._compute_mixing_probabilities()
        self.mu: FloatArray = self.cbar
        super().predict(u)

    def update(self, z: Any) -> None:
        """Update each mode and its probability. A measurement of None changes nothing."""
        if z is None:
            return
        for kalman in self.filters:
            kalman.update(z)
        self.weigh(np.array([kalman.log_likelihood for kalman in self.filters]))

    def weigh(self, log_likelihood: FloatArray) -> None:
        """Multiply each mode probability by the exponential of its log evidence, and normalise.

        Evidence that excludes every mode, or that is NaN, is ignored.
        """
        with np.errstate(divide="ignore"):
            log_posterior = np.log(self.mu) + log_likelihood
        if np.isfinite(log_posterior.max()):
            self.mu = softmax(log_posterior)
        self._compute_state_estimate()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def _compute_mixing_probabilities(self) -> None:
        self.cbar: FloatArray = self.mu @ self.M
        for i in range(self.N):
            for j in range(self.N):
                # a mode that cannot be reached keeps its own estimate
                self.omega[i, j] = self.M[i, j] * self.mu[i] / self.cbar[j] if self.cbar[j] > 0 else float(i == j)


def estimator(mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray) -> Any:
    """Return a `MendedIMMEstimator` with one static Kalman filter for each mode."""
    return MendedIMMEstimator(_filters(mean, cov), mode_prob, transition_prob)


def mix(
    mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mixed means and covariances, and predicted mode probabilities, as `pdr_filter.filter.imm.imm.mix`.

    Prediction with static filters is mixing alone.
    """
    if len(mean) == 1:  # filterpy requires at least two modes
        return mean, cov, mode_prob
    imm = estimator(mean, cov, mode_prob, transition_prob)
    imm.predict()
    return *_estimates(imm.filters), imm.mu


def update(
    mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return means, covariances, log likelihoods and normalised innovations squared (NIS) of the updated modes.

    The result equals the result of `pdr_filter.filter.imm.imm.update`, except for rounding.
    """
    filters = _filters(mean, cov, len(z))
    for kalman in filters:
        kalman.update(z, R, H)
    log_likelihood = np.array([float(kalman.log_likelihood) for kalman in filters])
    return *_estimates(filters), log_likelihood, np.array([float(kalman.mahalanobis) ** 2 for kalman in filters])


def update_mode_prob(prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Return the posterior mode probabilities, as `pdr_filter.values.mixtures.posterior_prob`."""
    n_modes = len(prior_prob)
    if n_modes == 1:
        return prior_prob
    imm = estimator(np.zeros((n_modes, 1)), np.zeros((n_modes, 1, 1)), prior_prob, np.eye(n_modes))
    imm.weigh(log_likelihood)
    return imm.mu


def combine(mean: FloatArray, cov: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean and covariance of the mixture of all modes, as `pdr_filter.values.mixtures.combine`."""
    if len(mean) == 1:
        return mean[0], cov[0]
    imm = estimator(mean, cov, prob, np.eye(len(mean)))
    return imm.x, imm.P


@dataclass(frozen=True)
class FilterpyImm:
    """Arithmetic of a tracker with the filterpy functions of this module (an `ImmArithmetic`)."""

    mix = staticmethod(mix)
    update = staticmethod(update)
    update_mode_prob = staticmethod(update_mode_prob)
    combine = staticmethod(combine)


def _filters(mean: FloatArray, cov: FloatArray, dim_z: int = 1) -> list[Any]:
    """Return one static filterpy filter for each mode, for measurements with `dim_z` components.

    Static means that the transition matrix F is the identity and the process noise Q is zero.
    """
    filters: list[Any] = [_KALMAN.KalmanFilter(dim_x=mean.shape[1], dim_z=dim_z) for _ in mean]
    for kalman, x, P in zip(filters, mean, cov, strict=True):
        kalman.x, kalman.P, kalman.Q = x.copy(), P.copy(), np.zeros_like(P)
    return filters


def _estimates(filters: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """Return the means (M, n) and covariances (M, n, n) of M filterpy filters with n states."""
    return np.stack([kalman.x for kalman in filters]), np.stack([kalman.P for kalman in filters])
