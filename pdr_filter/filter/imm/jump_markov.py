"""IMM filter and fixed-interval smoother for any linear model with switching modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.filter.imm.imm import mix, predict, update
from pdr_filter.values import FloatArray, check_transition_prob
from pdr_filter.values.arrays import check_cov
from pdr_filter.values.mixtures import combine, posterior_prob, reweighted_prob


@dataclass(frozen=True, eq=False)
class ImmEstimates:
    """Estimates of an IMM filter or smoother for T measurements, of independent filters on the axes "...".

    Attributes
    ----------
    mean : (T, ..., n) array
        Mean of the mixture of all modes.
    cov : (T, ..., n, n) array
        Covariance of the mixture.
    mode_prob : (T, ..., M) array
        Probabilities of the modes.
    mode_mean : (T, ..., M, n) array
        Mean of each mode.
    mode_cov : (T, ..., M, n, n) array
        Covariance of each mode.
    log_likelihood : (...) array
        Log density of all measurements, summed over time.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> model = pdr.imm.JumpMarkovModel(*np.ones((4, 2, 1, 1)), transition_prob=[[0.9, 0.1], [0.1, 0.9]])
    >>> model.filter(np.zeros((5, 1)), [0.0], [[1.0]]).mode_prob.shape
    (5, 2)
    """

    mean: FloatArray
    cov: FloatArray
    mode_prob: FloatArray
    mode_mean: FloatArray
    mode_cov: FloatArray
    log_likelihood: FloatArray


@dataclass(frozen=True, eq=False)
class JumpMarkovModel:
    """Linear Gaussian model whose modes follow a Markov chain (jump Markov linear system), with its IMM estimators.

    In mode m, x_k = F_m x_(k-1) + w with covariance Q_m, and z_k = H_m x_k + v with covariance R_m. All modes have the
    same state of dimension n and the same measurement of dimension d.

    Parameters
    ----------
    F : (M, n, n) array_like
        Transition matrix of each mode.
    Q : (M, n, n) array_like
        Covariance of the process noise of each mode.
    H : (M, d, n) or (d, n) array_like
        Measurement matrix of each mode, or of all modes.
    R : (M, d, d) or (d, d) array_like
        Covariance of the measurement noise of each mode, or of all modes.
    transition_prob : (M, M) array_like
        Probability of a transition from mode i (row) to mode j (column) between two measurements. Rows sum to one.

    Raises
    ------
    ValueError
        If the shapes do not match, a number is not finite, Q or R is no covariance, or rows of `transition_prob` do not
        sum to one.

    Notes
    -----
    Modes with states of different dimensions are not supported. Give all modes the largest state, and a model without
    acceleration zeros in the rows of the acceleration.

    References
    ----------
    H. A. P. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
    coefficients", IEEE Trans. Automatic Control 33(8), 1988 (filter). C.-J. Kim, "Dynamic linear models with
    Markov-switching", Journal of Econometrics 60, 1994 (smoother).

    Examples
    --------
    A target that stands still or moves, seen every second:

    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> F = np.array([[[1.0, 0.0], [0.0, 0.0]], [[1.0, 1.0], [0.0, 1.0]]])
    >>> Q = np.array([np.diag([1e-6, 0.5]), np.diag([1e-6, 1e-2])])
    >>> model = pdr.imm.JumpMarkovModel(F, Q, [[1.0, 0.0]], [[0.01]], transition_prob=[[0.9, 0.1], [0.1, 0.9]])
    >>> z = np.concatenate([np.zeros(10), np.arange(1.0, 11.0)])[:, None]
    >>> filtered = model.filter(z, mean=[0.0, 0.0], cov=np.eye(2))
    >>> model.smooth(filtered).mode_prob.argmax(axis=1).tolist()
    [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
    """

    F: FloatArray
    Q: FloatArray
    H: FloatArray
    R: FloatArray
    transition_prob: FloatArray

    def __init__(self, F: ArrayLike, Q: ArrayLike, H: ArrayLike, R: ArrayLike, transition_prob: ArrayLike) -> None:
        given = {"F": F, "Q": Q, "H": H, "R": R, "transition_prob": transition_prob}
        arrays = {name: _matrices(name, value) for name, value in given.items()}
        if arrays["F"].ndim != 3 or arrays["H"].ndim not in (2, 3):
            raise ValueError(
                f"F must be (M, n, n) and H (M, d, n) or (d, n), got shapes {arrays['F'].shape} and "
                f"{arrays['H'].shape}: stack the matrices of the modes with np.stack"
            )
        n_modes, n = arrays["F"].shape[:2]
        d = arrays["H"].shape[-2]
        shapes = {"F": (n, n), "Q": (n, n), "H": (d, n), "R": (d, d)}
        for name, shape in shapes.items():
            is_shared = name in ("H", "R") and arrays[name].shape == shape
            if not is_shared and arrays[name].shape != (n_modes, *shape):
                shared = f", or {shape} for all modes" if name in ("H", "R") else ""
                raise ValueError(
                    f"{name} must have the shape {(n_modes, *shape)} for the {n_modes} modes of F{shared}, got "
                    f"{arrays[name].shape}: give a matrix for each mode"
                )
            if not np.isfinite(arrays[name]).all():
                raise ValueError(f"{name} must contain finite numbers, got {arrays[name].tolist()}: replace NaN")
            if name in ("Q", "R"):
                check_cov(arrays[name], name)
            object.__setattr__(self, name, np.broadcast_to(arrays[name], (n_modes, *shape)))
        check_transition_prob(arrays["transition_prob"], n_modes)
        object.__setattr__(self, "transition_prob", arrays["transition_prob"])

    def filter(self, z: ArrayLike, mean: ArrayLike, cov: ArrayLike, mode_prob: ArrayLike | None = None) -> ImmEstimates:
        """Return the estimates of the IMM filter after each measurement.

        Parameters
        ----------
        z : (T, ..., d) array_like
            Measurements of independent filters. A measurement with NaN is missing.
        mean : (n,) or (..., n) array_like
            Mean of the state one transition before the first measurement.
        cov : (n, n) or (..., n, n) array_like
            Covariance of the state.
        mode_prob : (M,) array_like, optional
            Probabilities of the modes at that time. By default all modes are equally probable.

        Returns
        -------
        ImmEstimates
            Filtered estimates.

        Raises
        ------
        ValueError
            If the measurements or the first state do not have the dimension of the model, a measurement is infinite,
            or `mode_prob` does not sum to one.

        Examples
        --------
        A thousand filters at once:

        >>> import numpy as np
        >>> import pdr_filter as pdr
        >>> model = pdr.imm.JumpMarkovModel(*np.ones((4, 2, 1, 1)), transition_prob=[[0.9, 0.1], [0.1, 0.9]])
        >>> model.filter(np.zeros((20, 1000, 1)), [0.0], [[1.0]]).mean.shape
        (20, 1000, 1)
        """
        measured = np.asarray(z, dtype=float)
        n_modes, d, n = self.H.shape
        if measured.ndim < 2 or measured.shape[-1] != d:
            remedy = "add the axis of the values with z[:, None]" if measured.ndim == d == 1 else "put the values last"
            raise ValueError(
                f"z must have the shape (T, ..., {d}) for {d} measured values, got {measured.shape}: {remedy}"
            )
        if np.isinf(measured).any():
            raise ValueError("z must contain finite numbers or NaN, got inf: replace inf by NaN, which is missing")
        batch = measured.shape[1:-1]
        x = _first("mean", mean, (n,), batch)[..., None, :]
        x, cov = np.broadcast_to(x, (*batch, n_modes, n)), _first("cov", cov, (n, n), batch)[..., None, :, :]
        check_cov(cov, "cov")
        cov = np.broadcast_to(cov, (*batch, n_modes, n, n))
        prior = np.full(n_modes, 1 / n_modes) if mode_prob is None else np.asarray(mode_prob, dtype=float)
        if prior.shape != (n_modes,) or not (prior >= 0).all() or abs(prior.sum() - 1) > 1e-6:
            raise ValueError(
                f"mode_prob must be {n_modes} probabilities that sum to one, got {prior.tolist()}: divide by the sum"
            )
        prob = np.broadcast_to(prior, (*batch, n_modes))
        shape = (len(measured), *batch, n_modes)
        means, covs, probs, evidence = np.empty((*shape, n)), np.empty((*shape, n, n)), np.empty(shape), np.zeros(shape)
        is_missing = np.isnan(measured) @ np.ones((d, 1)) > 0  # (T, ..., 1)
        any_missing = np.isnan(measured.reshape(len(measured), -1).sum(axis=1)).tolist()
        H = self.H[0] if np.array_equal(self.H, self.H[[0] * n_modes]) else self.H
        R = np.broadcast_to(self.R, (*batch, *self.R.shape))
        predicted = np.empty(shape)
        # each mode can be reached, so that the most likely one is possible: products need no logarithms
        with_evidence = reweighted_prob if (self.transition_prob > 0).all() else posterior_prob
        for k in range(len(measured)):
            x, cov, predicted[k] = mix(x, cov, prob, self.transition_prob)
            before_x, before_cov = predict(x, cov, self.F, self.Q)
            x, cov, evidence[k], _ = update(before_x, before_cov, measured[k], H, R)
            if any_missing[k]:
                missing = is_missing[k]
                evidence[k] = np.where(missing, 0.0, evidence[k])
                x = np.where(missing[..., None], before_x, x)
                cov = np.where(missing[..., None, None], before_cov, cov)
            prob = with_evidence(predicted[k], evidence[k])
            means[k], covs[k], probs[k] = x, cov, prob
        highest = evidence.max(axis=-1)
        density = (predicted * np.exp(evidence - highest[..., None])).sum(axis=-1)
        log_likelihood = (np.log(density) + highest).sum(axis=0)
        return _estimates(probs, means, covs, log_likelihood)

    def smooth(self, filtered: ImmEstimates) -> ImmEstimates:
        """Return the estimates of the fixed-interval smoother, which uses all measurements for each time.

        Parameters
        ----------
        filtered : ImmEstimates
            Result of `filter`.

        Returns
        -------
        ImmEstimates
            Smoothed estimates. `log_likelihood` is that of the filter.

        Notes
        -----
        Backward pass over pairs of a mode j at time k and a mode i at time k + 1, as in Kim's smoother. The later
        measurements are a message about the state in mode i, which is the smoothed density divided by the predicted
        one. Its information matrix is L = P_s^-1 - P_p^-1, and its vector l = P_s^-1 x_s - P_p^-1 x_p. Each pair
        predicts m = F_i x_j and C = F_i P_j F_i' + Q_i. With K = P_j F_i' (I + L C)^-1, its smoothed mean is
        x_j + K (l - L m), and its covariance P_j - K L F_i P_j. Given mode i, the pair has the probability p_ji mu_j
        times the integral of message and prediction. Kim's smoother omits this integral. The pairs of a mode
        are combined, which is the only approximation besides that of the filter.

        Examples
        --------
        >>> import numpy as np
        >>> import pdr_filter as pdr
        >>> model = pdr.imm.JumpMarkovModel(*np.ones((4, 2, 1, 1)), transition_prob=[[0.9, 0.1], [0.1, 0.9]])
        >>> filtered = model.filter(np.zeros((5, 1)), [0.0], [[1.0]])
        >>> bool((model.smooth(filtered).cov[0] < filtered.cov[0]).all())
        True
        """
        prob, mean, cov = (a.copy() for a in (filtered.mode_prob, filtered.mode_mean, filtered.mode_cov))
        no_shift = np.zeros(self.F.shape[:2])
        for k in range(len(prob) - 2, -1, -1):
            here, later = (prob[k], mean[k], cov[k]), (prob[k + 1], mean[k + 1], cov[k + 1])
            prob[k], mean[k], cov[k] = one_step_back(here, later, self.F, no_shift, self.Q, self.transition_prob)
        return _estimates(prob, mean, cov, filtered.log_likelihood)


def _matrices(name: str, value: ArrayLike) -> FloatArray:
    try:
        return np.array(value, dtype=float)
    except ValueError:
        raise ValueError(
            f"{name} must have matrices of one size for all modes: give modes with smaller states rows and columns of "
            "zeros"
        ) from None


def _first(name: str, value: ArrayLike, shape: tuple[int, ...], batch: tuple[int, ...]) -> FloatArray:
    given = np.asarray(value, dtype=float)
    if given.shape not in (shape, (*batch, *shape)):
        or_each = f", or {(*batch, *shape)} for independent filters" if batch else ""
        raise ValueError(
            f"{name} must have the shape {shape}{or_each}, got {given.shape}: give one state for all modes"
        )
    return given


_Modes = tuple[FloatArray, FloatArray, FloatArray]  # probabilities (..., M), means and covariances of the modes


def one_step_back(
    filtered: _Modes, later: _Modes, F: FloatArray, shift: FloatArray, Q: FloatArray, transition_prob: FloatArray
) -> _Modes:
    """Return the smoothed estimates of the modes at time k, from the smoothed ones `later` at time k + 1.

    `filtered` are the estimates of the filter at time k. In mode m, x_(k+1) = F_m x_k + shift_m + w with covariance
    Q_m: F and Q are (M, n, n), the shift is (M, n). `JumpMarkovModel.smooth` has the equations.
    """
    prob, mean, cov = filtered
    mixed_mean, mixed_cov, _ = mix(mean, cov, prob, transition_prob)
    predicted, predicted_cov = predict(mixed_mean, mixed_cov, F, Q)
    information, vector = _message(later[1] - predicted - shift, later[2], predicted_cov)
    information, vector = information[..., None, :, :, :], vector[..., None, :, :]  # (..., 1, i, n)
    x, P = mean[..., :, None, :], cov[..., :, None, :, :]  # (..., j, 1, n)
    # relative to the prediction, because a singular covariance has no inverse in the directions of a common offset
    ahead = np.matmul(F, x[..., None])[..., 0] - predicted[..., None, :, :]  # (..., j, i, n)
    ahead_cov = F @ P @ F.swapaxes(-1, -2) + Q
    ratio = np.eye(F.shape[-1]) + information @ ahead_cov
    shrink, residual = np.linalg.inv(ratio), vector - np.matmul(information, ahead[..., None])[..., 0]
    step = np.matmul(ahead_cov @ shrink, residual[..., None])[..., 0]
    log_match = 0.5 * ((residual * step).sum(axis=-1) + ((vector + residual) * ahead).sum(axis=-1))
    log_match -= 0.5 * np.linalg.slogdet(ratio)[1]
    gain = P @ F.swapaxes(-1, -2) @ shrink
    pair_mean = x + np.matmul(gain, residual[..., None])[..., 0]
    pair_cov = P - gain @ information @ F @ P
    prior = (prob[..., :, None] * transition_prob).swapaxes(-1, -2)  # (..., i, j)
    total = prior.sum(axis=-1, keepdims=True)
    prior = np.divide(prior, total, out=np.full_like(prior, 1 / prior.shape[-1]), where=total > 0)
    joint = posterior_prob(prior, log_match.swapaxes(-1, -2)).swapaxes(-1, -2) * later[0][..., None, :]
    of_mode = joint.sum(axis=-1, keepdims=True)
    weight = np.divide(joint, of_mode, out=np.full_like(joint, 1 / joint.shape[-1]), where=of_mode > 0)
    smoothed, smoothed_cov = combine(pair_mean, pair_cov, weight)
    return of_mode[..., 0] / of_mode.sum(axis=(-1, -2))[..., None], smoothed, smoothed_cov


# Share of the variance below which a direction has no noise, and below which later measurements determine a state.
_MIN_SHARE, _KNOWN_SHARE = 1e-10, 1e-15


def _message(moved: FloatArray, smoothed_cov: FloatArray, predicted_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return information matrix (..., n, n) and vector (..., n) of the later measurements, relative to the prediction.

    They are the quotient of the smoothed and the predicted density. `moved` is the smoothed mean minus the predicted
    one. Directions without noise have no information, and neither have those in which the mixture makes the smoothed
    covariance the larger one. The directions are those of predicted states with unit variances, because the states
    differ in unit.
    """
    std = np.sqrt(np.maximum(np.diagonal(predicted_cov, axis1=-2, axis2=-1), 0.0))  # below zero by rounding
    scale = 1.0 / np.where(std > 0, std, 1.0)
    share, axes = np.linalg.eigh(predicted_cov * scale[..., :, None] * scale[..., None, :])
    has_noise = share > _MIN_SHARE * share[..., -1:]
    # rows that make the predicted covariance the identity, and zero rows for directions without noise
    whiten = axes.swapaxes(-1, -2) * scale[..., None, :]
    whiten = whiten * np.where(has_noise, 1.0 / np.sqrt(np.where(has_noise, share, 1.0)), 0.0)[..., None]
    left, turned = np.linalg.eigh(
        whiten @ smoothed_cov @ whiten.swapaxes(-1, -2) + np.eye(share.shape[-1]) * ~has_noise[..., None]
    )
    gained = np.maximum(1.0 / np.maximum(left, _KNOWN_SHARE) - 1.0, 0.0)
    by_state = turned.swapaxes(-1, -2) @ whiten
    along = np.where(gained > 0, np.matmul(by_state, moved[..., None])[..., 0] * (gained + 1.0), 0.0)
    to_state = by_state.swapaxes(-1, -2)
    return (to_state * gained[..., None, :]) @ by_state, np.matmul(to_state, along[..., None])[..., 0]


def _estimates(prob: FloatArray, mean: FloatArray, cov: FloatArray, log_likelihood: FloatArray) -> ImmEstimates:
    """Return the estimates of each mode with those of their mixture."""
    mixture_mean, mixture_cov = combine(mean, cov, prob)
    return ImmEstimates(mixture_mean, mixture_cov, prob, mean, cov, log_likelihood)
