"""The interacting multiple model: mix, predict, update, combine, for all modes and all pedestrians at once.

Pure functions on arrays: `mean` (..., M, n), `cov` (..., M, n, n), `mode_prob` (..., M). Leading axes, if any,
are pedestrians: each is filtered as if it were alone. Letters follow Blom and Bar-Shalom, "The
interacting multiple model algorithm for systems with Markovian switching coefficients", IEEE Trans. Automatic Control
33(8), 1988. Likelihoods are logarithms throughout, so that no evidence is lost to underflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pdr_filter.values import FloatArray, check_transition_prob
from pdr_filter.values.mixtures import combine, posterior_prob, product

_LOG_2_PI = float(np.log(2 * np.pi))


def mix(
    mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mixed means (..., M, n), mixed covariances (..., M, n, n) and predicted mode probabilities (..., M).

    c_j = sum_i p_ij mu_i;  mu_i|j = p_ij mu_i / c_j;  x_0j = sum_i mu_i|j x_i;
    P_0j = sum_i mu_i|j (P_i + (x_i - x_0j)(x_i - x_0j)').
    A mode that cannot be reached (c_j = 0) keeps its own estimate.
    """
    *batch, n_modes, n = mean.shape
    from_source, predicted = _mixing_weights(mode_prob, transition_prob)
    mixed_mean = product(from_source, mean)
    spread = mean[..., None, :, :] - mixed_mean[..., :, None, :]  # (..., j, i, n)
    mixed_cov = product(from_source, cov.reshape(*batch, n_modes, n * n)).reshape(cov.shape)
    mixed_cov += (spread * from_source[..., None]).swapaxes(-1, -2) @ spread
    return mixed_mean, mixed_cov, predicted


def mixed_values(values: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray) -> FloatArray:
    """Expected values (..., M) given the mode of the next step, of expected values (..., M) given that of the last one.

    v_0j = sum_i mu_i|j v_i. What is summed in each mode over steps and mixed before each is, weighted with the mode
    probabilities, the sum that a smoother would make of them, exactly: E[sum_k l_k(mode at k) | all evidence so far].
    """
    predicted = mode_prob.dot(transition_prob)
    return np.divide((mode_prob * values).dot(transition_prob), predicted, where=predicted > 0, out=values.copy())


def _mixing_weights(mode_prob: FloatArray, transition_prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Probabilities mu_i|j (..., j, i) of the last mode given the next one, and predicted ones c_j (..., M)."""
    joint = transition_prob * mode_prob[..., :, None]
    predicted = mode_prob.dot(transition_prob)
    if np.count_nonzero(predicted) == predicted.size:
        joint /= predicted[..., None, :]
        return joint.swapaxes(-1, -2), predicted
    reachable = (predicted > 0)[..., None, :]
    weights = np.where(reachable, joint / np.where(reachable, predicted[..., None, :], 1.0), np.eye(joint.shape[-1]))
    return weights.swapaxes(-1, -2), predicted


def predict(mean: FloatArray, cov: FloatArray, F: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Linear prediction of each mode: x = F x, P = F P F' + Q, with F and Q of shape (..., M, n, n)."""
    return np.matmul(F, mean[..., None])[..., 0], predict_cov(cov, F, Q)


def predict_cov(cov: FloatArray, F: FloatArray, Q: FloatArray) -> FloatArray:
    """Predicted covariances F P F' + Q (..., M, n, n)."""
    return F @ cov @ F.swapaxes(-1, -2) + Q


def update(
    mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Updated means, covariances, log likelihoods (..., M), normalised innovations squared (..., M) of a measurement.

    y = z - H x;  S = H P H' + R;  K = P H' S^-1;  x = x + K y;  P = (I - K H) P (I - K H)' + K R K' (Joseph's form,
    symmetric and positive in rounding). z is (..., d), R (..., d, d), one for each pedestrian; H (d, n).
    """
    innovation = z[..., None, :] - mean @ H.T
    R_ = R[..., None, :, :]
    HP = H @ cov
    S_inverse, log_det_S = _inverse(HP @ H.T + R_)
    K = HP.swapaxes(-1, -2) @ S_inverse
    updated_mean = mean + np.matmul(K, innovation[..., None])[..., 0]
    I_KH = np.eye(mean.shape[-1]) - K @ H
    updated_cov = I_KH @ cov @ I_KH.swapaxes(-1, -2) + K @ R_ @ K.swapaxes(-1, -2)
    nis = (innovation * np.matmul(S_inverse, innovation[..., None])[..., 0]).sum(axis=-1)
    log_likelihood = -0.5 * (nis + log_det_S + z.shape[-1] * _LOG_2_PI)
    return updated_mean, updated_cov, log_likelihood, nis


def _inverse(S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse (..., d, d) and log determinant (...) of innovation covariances."""
    if S.shape[-1] != 2:
        return np.asarray(np.linalg.inv(S), dtype=float), np.linalg.slogdet(S)[1]
    # A position is what most measurements are, and for thousands of pedestrians LAPACK is called once for each matrix.
    a, b, c, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 0], S[..., 1, 1]
    det = a * d - b * c
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return adjugate / det[..., None, None], np.log(det)


def smoothed_mode_prob(mode_prob: FloatArray, transition_prob: FloatArray, lag: int | None = None) -> FloatArray:
    """Mode probabilities (K, M) of each step with the evidence of later ones, from the filtered ones (K, M).

    The backward pass of a hidden Markov model: p(j at k | k + L) = mu_k(j) sum_i t_ji p(i at k + 1 | k + L) /
    sum_j mu_k(j) t_ji, from k + L backwards, or from the last step. Exact for modes that move alike; what the positions
    say of the modes between is in the filtered probabilities only. `transition_prob` (M, M) is that of the model; the
    lag is L in steps, 4 of which are two seconds of walking; all later steps if not given.
    """
    mode_prob = np.asarray(mode_prob, dtype=float)
    check_transition_prob(transition_prob, mode_prob.shape[-1])
    if lag is not None and lag < 0:
        raise ValueError(f"lag must be 0 steps or more, got {lag}")
    n_steps = len(mode_prob)
    if lag is None:
        smoothed = mode_prob.copy()
        for k in range(n_steps - 2, -1, -1):
            smoothed[k] = _one_step_back(mode_prob[k], smoothed[k + 1], transition_prob)
        return smoothed
    k = np.arange(n_steps)
    end = np.minimum(k + lag, n_steps - 1)
    smoothed = mode_prob[end]
    for n_back in range(1, lag + 1):
        use = end - n_back >= k
        smoothed[use] = _one_step_back(mode_prob[end[use] - n_back], smoothed[use], transition_prob)
    return smoothed


def _one_step_back(filtered: FloatArray, later: FloatArray, transition_prob: FloatArray) -> FloatArray:
    """Smoothed probabilities (..., M) from the filtered ones and the smoothed ones of the step after."""
    predicted = filtered @ transition_prob
    ratio = np.divide(later, predicted, where=predicted > 0, out=np.zeros_like(predicted))
    smoothed = filtered * (ratio @ transition_prob.T)
    total = smoothed.sum(axis=-1, keepdims=True)
    return np.where(total > 0, smoothed / np.where(total > 0, total, 1.0), filtered)


class ImmArithmetic(Protocol):
    """Whose arithmetic a tracker uses; the results are those of the functions here."""

    def mix(
        self, mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `mix`."""
        ...

    def update(
        self, mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """As `update`."""
        ...

    def update_mode_prob(self, prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
        """As `values.mixtures.posterior_prob`."""
        ...

    def combine(self, mean: FloatArray, cov: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `values.mixtures.combine`."""
        ...


@dataclass(frozen=True)
class NumpyImm:
    """The functions of this module: whose arithmetic a tracker uses."""

    mix = staticmethod(mix)
    update = staticmethod(update)
    update_mode_prob = staticmethod(posterior_prob)
    combine = staticmethod(combine)
