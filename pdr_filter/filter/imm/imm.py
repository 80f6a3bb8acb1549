"""Interacting multiple model (IMM): mixing, prediction, update, mode probabilities and combination.

All functions are pure functions of arrays, for all modes and all pedestrians at once: `mean` (..., M, n), `cov` (...,
M, n, n), `mode_prob` (..., M). Leading axes, if any, are pedestrians, which are independent of each other. Letters
follow H. A. P. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Automatic Control 33(8), 1988. Likelihoods are logarithms, so that no evidence is lost by
underflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np

from pdr_filter.values import FloatArray, check_transition_prob, read_only
from pdr_filter.values.mixtures import combine, posterior_prob, product

_LOG_2_PI = float(np.log(2 * np.pi))


def mix(
    mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mixed means and covariances, and predicted mode probabilities: the interaction of the IMM.

    Parameters
    ----------
    mean : (..., M, n) array
        Mean of each mode.
    cov : (..., M, n, n) array
        Covariance of each mode.
    mode_prob : (..., M) array
        Probabilities of the modes at the last step.
    transition_prob : (M, M) array
        Probability of a transition from mode i (row) to mode j (column). Rows sum to one.

    Returns
    -------
    mixed_mean : (..., M, n) array
        Mean of each mode for the next step.
    mixed_cov : (..., M, n, n) array
        Covariance of each mode for the next step.
    predicted_prob : (..., M) array
        Probabilities of the modes at the next step.

    Notes
    -----
    c_j = sum_i p_ij mu_i;  mu_i|j = p_ij mu_i / c_j;  x_0j = sum_i mu_i|j x_i;
    P_0j = sum_i mu_i|j (P_i + (x_i - x_0j)(x_i - x_0j)').

    A mode that cannot be reached (c_j = 0) keeps its own estimate.

    References
    ----------
    H. A. P. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
    coefficients", IEEE Trans. Automatic Control 33(8), 1988.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import mix
    >>> mean, cov = np.array([[0.0], [1.0]]), np.ones((2, 1, 1))
    >>> mixed_mean, mixed_cov, prob = mix(mean, cov, np.array([0.5, 0.5]), np.array([[0.9, 0.1], [0.1, 0.9]]))
    >>> mixed_mean[:, 0].round(2), mixed_cov[:, 0, 0].round(2), prob
    (array([0.1, 0.9]), array([1.09, 1.09]), array([0.5, 0.5]))
    """
    *batch, n_modes, n = mean.shape
    from_source, predicted = _mixing_weights(mode_prob, transition_prob)
    mixed_mean = product(from_source, mean)
    spread = mean[..., None, :, :] - mixed_mean[..., :, None, :]  # (..., j, i, n)
    mixed_cov = product(from_source, cov.reshape(*batch, n_modes, n * n)).reshape(cov.shape)
    mixed_cov += (spread * from_source[..., None]).swapaxes(-1, -2) @ spread
    return mixed_mean, mixed_cov, predicted


def mixed_values(values: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray) -> FloatArray:
    """Return expected values given the mode of the next step, from those given the mode of the last step.

    Parameters
    ----------
    values : (..., M) array
        Expected value of a quantity for each mode of the last step.
    mode_prob : (..., M) array
        Probabilities of the modes at the last step.
    transition_prob : (M, M) array
        Probability of a transition from mode i (row) to mode j (column). Rows sum to one.

    Returns
    -------
    (..., M) array
        Expected value for each mode of the next step. A mode that cannot be reached keeps its own value.

    Notes
    -----
    v_0j = sum_i mu_i|j v_i. A sum over steps that is mixed before each step, such as the distance, is exact: weighted
    with the mode probabilities it is the sum that a smoother would give, E[sum_k l_k(mode at k) | all evidence so far].

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import mixed_values
    >>> mixed_values(np.array([0.0, 1.0]), np.array([0.5, 0.5]), np.array([[0.9, 0.1], [0.1, 0.9]])).round(2)
    array([0.1, 0.9])
    """
    predicted = mode_prob.dot(transition_prob)
    return np.divide((mode_prob * values).dot(transition_prob), predicted, where=predicted > 0, out=values.copy())


def _mixing_weights(mode_prob: FloatArray, transition_prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mixing weights and predicted mode probabilities.

    The weights mu_i|j (..., j, i) are the probabilities of the last mode i given the next mode j. A next mode that
    cannot be reached has the weight one for itself. The predicted probabilities c_j are (..., M).
    """
    joint = transition_prob * mode_prob[..., :, None]
    predicted = mode_prob.dot(transition_prob)
    if np.count_nonzero(predicted) == predicted.size:
        joint /= predicted[..., None, :]
        return joint.swapaxes(-1, -2), predicted
    reachable = (predicted > 0)[..., None, :]
    weights = np.where(reachable, joint / np.where(reachable, predicted[..., None, :], 1.0), np.eye(joint.shape[-1]))
    return weights.swapaxes(-1, -2), predicted


def predict(mean: FloatArray, cov: FloatArray, F: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means and covariances after a linear prediction of each mode, x = F x and P = F P F' + Q.

    Parameters
    ----------
    mean : (..., M, n) array
        Mean of each mode.
    cov : (..., M, n, n) array
        Covariance of each mode.
    F : (..., M, n, n) array
        Transition matrix of each mode.
    Q : (..., M, n, n) array
        Covariance of the process noise of each mode.

    Returns
    -------
    mean : (..., M, n) array
        Predicted means.
    cov : (..., M, n, n) array
        Predicted covariances.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import predict
    >>> x, P = predict(np.ones((1, 1)), np.ones((1, 1, 1)), np.full((1, 1, 1), 2.0), np.ones((1, 1, 1)))
    >>> x[0], P[0]
    (array([2.]), array([[5.]]))
    """
    return np.matmul(F, mean[..., None])[..., 0], predict_cov(cov, F, Q)


def predict_cov(cov: FloatArray, F: FloatArray, Q: FloatArray) -> FloatArray:
    """Return the covariances after a linear prediction of each mode, F P F' + Q.

    F is the transition matrix, P the covariance before the prediction, and Q the process noise covariance.

    Parameters
    ----------
    cov : (..., M, n, n) array
        Covariance P of each mode.
    F : (..., M, n, n) array
        Transition matrix of each mode.
    Q : (..., M, n, n) array
        Covariance of the process noise of each mode.

    Returns
    -------
    (..., M, n, n) array
        Predicted covariances.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import predict_cov
    >>> predict_cov(np.ones((1, 1, 1)), np.full((1, 1, 1), 2.0), np.ones((1, 1, 1)))[0]
    array([[5.]])
    """
    return F @ cov @ F.swapaxes(-1, -2) + Q


def update(
    mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the Kalman update of each mode by a linear measurement.

    Parameters
    ----------
    mean : (..., M, n) array
        Mean of each mode.
    cov : (..., M, n, n) array
        Covariance of each mode.
    z : (..., d) or (..., M, d) array
        Measurement of each pedestrian, or of each mode of each pedestrian.
    H : (d, n) or (..., M, d, n) array
        Measurement matrix, of all modes or of each mode.
    R : (..., d, d) or (..., M, d, d) array
        Covariance of the measurement noise of each pedestrian, or of each mode of each pedestrian.

    Returns
    -------
    mean : (..., M, n) array
        Updated means.
    cov : (..., M, n, n) array
        Updated covariances.
    log_likelihood : (..., M) array
        Log density of the measurement in each mode.
    nis : (..., M) array
        Normalised innovation squared in each mode.

    Notes
    -----
    `z` is of each mode if it has as many axes as `mean`, and `R` if it has as many axes as `cov`.

    y = z - H x;  S = H P H' + R;  K = P H' S^-1;  x = x + K y;  P = (I - K H) P (I - K H)' + K R K'.

    Joseph's form of the covariance stays symmetric and positive in spite of rounding.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import update
    >>> z, H, R = np.ones(1), np.eye(1), np.eye(1)
    >>> x, P, log_likelihood, nis = update(np.zeros((1, 1)), np.ones((1, 1, 1)), z, H, R)
    >>> x[0], P[0], nis
    (array([0.5]), array([[0.5]]), array([0.5]))
    """
    z_ = z if z.ndim == mean.ndim else z[..., None, :]
    R_ = R if R.ndim == cov.ndim else R[..., None, :, :]
    innovation = z_ - (mean @ H.T if H.ndim == 2 else np.matmul(H, mean[..., None])[..., 0])
    HP = H @ cov
    S_inverse, log_det_S = _inverse(HP @ H.swapaxes(-1, -2) + R_)
    K = HP.swapaxes(-1, -2) @ S_inverse
    updated_mean = mean + np.matmul(K, innovation[..., None])[..., 0]
    I_KH = _identity(mean.shape[-1]) - K @ H
    updated_cov = I_KH @ cov @ I_KH.swapaxes(-1, -2) + K @ R_ @ K.swapaxes(-1, -2)
    nis = np.add.reduce(innovation * np.matmul(S_inverse, innovation[..., None])[..., 0], axis=-1)
    log_likelihood = -0.5 * (nis + log_det_S + z.shape[-1] * _LOG_2_PI)
    return updated_mean, updated_cov, log_likelihood, nis


def update_mode_prob(prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Return the posterior mode probabilities.

    Parameters
    ----------
    prior_prob : (..., M) array
        Predicted probabilities of the modes c_j, after the interaction (`mix`).
    log_likelihood : (..., M) array
        Log evidence of each mode.

    Returns
    -------
    (..., M) array
        Posterior probabilities mu_j, proportional to c_j exp(log_likelihood_j). A mode with prior probability 0 stays
        at 0.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import update_mode_prob
    >>> update_mode_prob(np.array([0.5, 0.5]), np.log([0.9, 0.1])).round(3)
    array([0.9, 0.1])
    """
    return posterior_prob(prior_prob, log_likelihood)


@cache
def _identity(n: int) -> FloatArray:
    return read_only(np.eye(n))


def _inverse(S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the inverse (..., d, d) and the log determinant (...) of innovation covariances."""
    if S.shape[-1] == 1:
        return 1.0 / S, np.log(S[..., 0, 0])
    if S.shape[-1] != 2:
        return np.asarray(np.linalg.inv(S), dtype=float), np.linalg.slogdet(S)[1]
    # Most measurements are positions. LAPACK would be called once for each of thousands of pedestrians.
    a, b, c, d = S[..., 0, 0], S[..., 0, 1], S[..., 1, 0], S[..., 1, 1]
    det = a * d - b * c
    adjugate = np.empty_like(S)
    adjugate[..., 0, 0], adjugate[..., 0, 1], adjugate[..., 1, 0], adjugate[..., 1, 1] = d, -b, -c, a
    return adjugate / det[..., None, None], np.log(det)


def smoothed_mode_prob(mode_prob: FloatArray, transition_prob: FloatArray, lag: int | None = None) -> FloatArray:
    """Return mode probabilities that use the evidence of later steps, from filtered mode probabilities.

    Parameters
    ----------
    mode_prob : (K, M) array
        Filtered mode probabilities of K steps.
    transition_prob : (M, M) array
        Transition matrix of the model, from row to column.
    lag : int, optional
        Number L of later steps whose evidence is used. Four steps are about two seconds of walking. By default all
        later steps are used.

    Returns
    -------
    (K, M) array
        Smoothed mode probabilities.

    Raises
    ------
    ValueError
        If the lag is negative, or if the transition matrix has the wrong shape or rows that do not sum to one.

    Notes
    -----
    Backward pass of a hidden Markov model, from step k + L (or the last step) to step k:
    p(j at k | k + L) = mu_k(j) sum_i t_ji p(i at k + 1 | k + L) / sum_j mu_k(j) t_ji.

    The result is exact if all modes have the same motion. Evidence of positions for the modes enters only through the
    filtered probabilities.

    References
    ----------
    C.-J. Kim, "Dynamic linear models with Markov-switching", Journal of Econometrics 60, 1994.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import smoothed_mode_prob
    >>> filtered = np.array([[0.5, 0.5], [0.9, 0.1]])
    >>> smoothed_mode_prob(filtered, np.array([[0.9, 0.1], [0.1, 0.9]])).round(2)
    array([[0.82, 0.18],
           [0.9 , 0.1 ]])
    """
    mode_prob = np.asarray(mode_prob, dtype=float)
    check_transition_prob(transition_prob, mode_prob.shape[-1])
    if lag is not None and lag < 0:
        raise ValueError(
            f"lag is a number of steps and must be 0 or more, got {lag}: leave it out to use all later steps"
        )
    n_steps = len(mode_prob)
    if lag is None:
        smoothed, predicted = mode_prob.copy(), mode_prob @ transition_prob
        predicted[predicted <= 0] = np.inf
        for k in range(n_steps - 2, -1, -1):  # the equation of `_one_step_back`, of which each step needs the next one
            row = mode_prob[k] * transition_prob.dot(smoothed[k + 1] / predicted[k])
            total = float(np.add.reduce(row))
            if total > 0:
                smoothed[k] = row / total
        return smoothed
    k = np.arange(n_steps)
    end = np.minimum(k + lag, n_steps - 1)
    smoothed = mode_prob[end]
    for n_back in range(1, lag + 1):
        use = end - n_back >= k
        smoothed[use] = _one_step_back(mode_prob[end[use] - n_back], smoothed[use], transition_prob)
    return smoothed


def _one_step_back(filtered: FloatArray, later: FloatArray, transition_prob: FloatArray) -> FloatArray:
    """Return the smoothed mode probabilities (..., M) of one step.

    `filtered` are the filtered probabilities of this step, and `later` the smoothed probabilities of the next step.
    """
    predicted = filtered @ transition_prob
    ratio = np.divide(later, predicted, where=predicted > 0, out=np.zeros_like(predicted))
    smoothed = filtered * (ratio @ transition_prob.T)
    total = smoothed.sum(axis=-1, keepdims=True)
    return np.where(total > 0, smoothed / np.where(total > 0, total, 1.0), filtered)


class ImmArithmetic(Protocol):
    """Protocol of the arithmetic of a tracker: mixing, update and combination.

    `NumpyImm` is the default. `filterpy_backend.FilterpyImm` gives the same results with the classes of filterpy.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.imm.imm import NumpyImm
    >>> from pdr_filter.filter.chain.imm_tracker import ImmTracker
    >>> tracker = ImmTracker(pdr.recipes.default().model, NumpyImm())
    """

    def mix(
        self, mean: FloatArray, cov: FloatArray, mode_prob: FloatArray, transition_prob: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mixed means and covariances, and predicted mode probabilities.

        Parameters
        ----------
        mean : (..., M, n) array
            Mean of each mode.
        cov : (..., M, n, n) array
            Covariance of each mode.
        mode_prob : (..., M) array
            Probabilities of the modes at the last step.
        transition_prob : (M, M) array
            Probability of a transition from mode i (row) to mode j (column). Rows sum to one.

        Returns
        -------
        mixed_mean : (..., M, n) array
            Mean of each mode for the next step.
        mixed_cov : (..., M, n, n) array
            Covariance of each mode for the next step.
        predicted_prob : (..., M) array
            Probabilities of the modes at the next step.
        """
        ...

    def update(
        self, mean: FloatArray, cov: FloatArray, z: FloatArray, H: FloatArray, R: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the Kalman update of each mode by a linear measurement z = H x + noise.

        Parameters
        ----------
        mean : (..., M, n) array
            Mean of each mode.
        cov : (..., M, n, n) array
            Covariance of each mode.
        z : (..., d) array
            Measurement of each pedestrian.
        H : (d, n) array
            Measurement matrix.
        R : (..., d, d) array
            Covariance of the measurement noise of each pedestrian.

        Returns
        -------
        mean : (..., M, n) array
            Updated means.
        cov : (..., M, n, n) array
            Updated covariances.
        log_likelihood : (..., M) array
            Log density of the measurement in each mode.
        nis : (..., M) array
            Normalised innovation squared in each mode.
        """
        ...

    def update_mode_prob(self, prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
        """Return the posterior mode probabilities.

        Parameters
        ----------
        prior_prob : (..., M) array
            Mode probabilities before the evidence.
        log_likelihood : (..., M) array
            Log evidence for each mode.

        Returns
        -------
        (..., M) array
            Mode probabilities after the evidence. Evidence that is not a number, or that excludes every mode, is
            ignored.
        """
        ...

    def combine(self, mean: FloatArray, cov: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean and the covariance of the mixture of all modes.

        Parameters
        ----------
        mean : (..., M, n) array
            Mean of each mode.
        cov : (..., M, n, n) array
            Covariance of each mode.
        prob : (..., M) array
            Probabilities of the modes.

        Returns
        -------
        mean : (..., n) array
            Mean of the mixture.
        cov : (..., n, n) array
            Covariance of the mixture.
        """
        ...


@dataclass(frozen=True)
class NumpyImm:
    """Default arithmetic of a tracker: the NumPy functions of this module.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.imm import NumpyImm
    >>> x, P = NumpyImm().combine(np.array([[0.0], [1.0]]), np.ones((2, 1, 1)), np.array([0.5, 0.5]))
    >>> x, P
    (array([0.5]), array([[1.25]]))
    """

    mix = staticmethod(mix)
    update = staticmethod(update)
    update_mode_prob = staticmethod(update_mode_prob)
    combine = staticmethod(combine)
