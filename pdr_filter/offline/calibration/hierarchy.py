"""Hierarchical linear least squares: parameters of a population, of each person, and their spread between people.

Each person enters as ONE factor, the sum over all of the person's segments. The work of the solver therefore grows with
the number of people, not of segments. The sum is exact, because every segment is linear, and a sum of squares of linear
residuals is a single quadratic form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, IntArray

# Limit on the ratio of the smallest to the largest diagonal entry of a square-root factor with columns of unit size.
# Below it, two parameters cannot be separated within rounding errors.
_SINGULAR = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PeoplePosterior:
    """Normal posterior of the parameters of the population and of each person."""

    population: FloatArray  # (P,) mean of the population's parameters
    population_cov: FloatArray  # (P, P) covariance of the population's parameters
    # (S, P) mean of each person's parameters. Parameters that people share have the value of the population.
    people: FloatArray
    people_cov: FloatArray  # (S, P, P) covariance of each person's parameters
    # (S, Q, Q) covariance of the difference between each person's own parameters and the population's
    apart_cov: FloatArray


class SingularError(ValueError):
    """Error raised if data and priors do not determine all parameters.

    `indices` are the indices of the parameters concerned.
    """

    def __init__(self, indices: tuple[int, ...]) -> None:
        super().__init__("the segments do not determine all parameters")
        self.indices = indices


def solve_people(
    information: FloatArray,
    vector: FloatArray,
    prior_mean: FloatArray,
    prior_precision: FloatArray,
    personal: IntArray,
    between_precision: FloatArray,
) -> PeoplePosterior:
    """Return the posterior of the population's parameters y and the people's own parameters t_s from summed data.

    The solution minimises over y (P,) and t_s (Q,), with theta_s = y except theta_s[personal] = t_s,

        sum_s (theta_s' G_s theta_s - 2 g_s' theta_s) + (t_s - y[personal])' W (t_s - y[personal]) + |y - mean|^2_prior

    `information` (S, P, P) and `vector` (S, P) are G_s and g_s: the sums of row' row / variance and of row' distance /
    variance. `prior_precision` (P,) of 0 means no prior. `between_precision` (Q, Q) is W, the inverse of the covariance
    between people. Its rows are zero for parameters that are independent between people. The population's value of such
    a parameter is the mean over the people. Raises SingularError if neither data nor priors determine a parameter.
    """
    free = np.diagonal(between_precision) == 0  # independent between people
    weight = np.einsum("sii->i", information) + prior_precision
    weight[personal] += np.diagonal(between_precision)
    scale = 1 / np.sqrt(np.where(weight > 0, weight, 1.0))
    G = information * scale[:, None] * scale
    g = vector * scale
    W = between_precision * scale[personal][:, None] * scale[personal]
    precision = prior_precision * scale**2
    # keeps the system regular; the result is overwritten below
    precision[personal[free]] = np.maximum(precision[personal[free]], 1.0)
    try:
        people = _Eliminated.of(G, g, personal, W)
        root = np.linalg.inv(np.linalg.cholesky(people.message.sum(axis=0) + np.diag(precision)))
    except np.linalg.LinAlgError as error:
        raise SingularError(_undetermined(G, precision, personal, W)) from error
    y_cov = root.T @ root
    y = root.T @ (root @ (people.message_vector.sum(axis=0) + precision * (prior_mean / scale)))
    n_people = len(g)
    diagonal = np.concatenate([1 / root.diagonal(), people.diagonal.ravel()])
    theta = np.repeat(y[None], n_people, axis=0)
    theta[:, personal] = people.constant + people.gain @ y
    largest = max(1.0, diagonal.max() / np.sqrt(n_people))
    if not np.isfinite(theta).all() or diagonal.min() < _SINGULAR * largest:
        raise SingularError(_undetermined(G, precision, personal, W))
    follow = np.repeat(np.eye(len(y))[None], n_people, axis=0)  # theta_s = follow_s y + constant + independent noise
    follow[:, personal] = people.gain
    cov = follow @ y_cov @ follow.transpose(0, 2, 1)
    cov[:, personal[:, None], personal] += people.cov
    apart = follow[:, personal] - np.eye(len(y))[personal]
    apart_cov = people.cov + apart @ y_cov @ apart.transpose(0, 2, 1)
    if free.any():
        alone = personal[free]
        spread = theta[:, alone].var(axis=0, ddof=1) if n_people > 1 else np.diagonal(cov[0])[alone]
        y[alone] = theta[:, alone].mean(axis=0)
        y_cov[alone, :] = y_cov[:, alone] = 0.0
        y_cov[alone, alone] = spread / n_people + np.diagonal(cov, axis1=1, axis2=2)[:, alone].mean(axis=0) / n_people
    both = scale[:, None] * scale
    own = both[np.ix_(personal, personal)]
    return PeoplePosterior(y * scale, y_cov * both, theta * scale, cov * both, apart_cov * own)


@dataclass(frozen=True, slots=True, eq=False)
class _Eliminated:
    """People's own parameters t_s eliminated: normal density of t_s given y, and information that s adds about y."""

    # (S, Q) and (S, Q, P) the mean of t_s given the population's parameters y is constant_s + gain_s y
    constant: FloatArray
    gain: FloatArray
    cov: FloatArray  # (S, Q, Q) covariance of t_s given y
    diagonal: FloatArray  # (S, Q) diagonal of the Cholesky factor of the inverse of `cov`
    # (S, P, P) and (S, P) quadratic form of person s in y, without the prior of y (Schur complement)
    message: FloatArray
    message_vector: FloatArray

    @classmethod
    def of(cls, G: FloatArray, g: FloatArray, personal: IntArray, W: FloatArray) -> _Eliminated:
        """Return the elimination of all people. LinAlgError if a person's own parameters are undetermined."""
        own = G[:, personal][:, :, personal] + W
        shared = np.delete(np.arange(g.shape[1]), personal)
        cross = np.zeros((*g.shape[:1], len(personal), g.shape[1]))  # products of t_s and y
        rest, rest_vector = np.zeros_like(G), np.zeros_like(g)  # terms of y alone
        cross[:, :, shared] = G[:, personal][:, :, shared]
        cross[:, :, personal] -= W
        rest[:, shared[:, None], shared] = G[:, shared][:, :, shared]
        rest[:, personal[:, None], personal] += W
        rest_vector[:, shared] = g[:, shared]
        root = np.linalg.cholesky(own)
        half = np.linalg.solve(root, np.concatenate([cross, g[:, personal, None]], axis=2))
        inverse = np.linalg.inv(root).transpose(0, 2, 1)
        mean = inverse @ half
        schur = half[:, :, :-1].transpose(0, 2, 1) @ half
        return cls(
            mean[:, :, -1],
            -mean[:, :, :-1],
            inverse @ inverse.transpose(0, 2, 1),
            np.einsum("sii->si", root),
            rest - schur[:, :, :-1],
            rest_vector - schur[:, :, -1],
        )


def population_without_each(
    posterior: PeoplePosterior, G: FloatArray, g: FloatArray, personal: IntArray, W: FloatArray
) -> FloatArray:
    """Return the population's parameters (S, P) estimated without each person in turn.

    The person's marginal contribution is subtracted from the population's information. Rows are NaN where the rest does
    not determine the parameters.
    """
    people = _Eliminated.of(G, g, personal, W)
    scale = np.sqrt(np.diagonal(posterior.population_cov))
    total = np.linalg.inv(posterior.population_cov / scale[:, None] / scale)
    left = total - people.message * scale[:, None] * scale
    left_vector = total @ (posterior.population / scale) - people.message_vector * scale
    result = np.full_like(g, np.nan)
    for s, (matrix, vector) in enumerate(zip(left, left_vector, strict=True)):
        if np.linalg.eigvalsh(matrix)[0] > 1e-9:
            result[s] = np.linalg.solve(matrix, vector) * scale
    return result


def _undetermined(G: FloatArray, precision: FloatArray, personal: IntArray, W: FloatArray) -> tuple[int, ...]:
    """Return the indices of the parameters that neither the data nor the priors determine.

    Such parameters are sought in the information matrix of the population (sum over all people plus prior), and in that
    of each person. The indices belong to the large components of eigenvectors with almost no information.
    """
    indices: set[int] = set()
    shared = np.delete(np.arange(len(precision)), personal)
    total = G.sum(axis=0) + np.diag(precision)
    candidates = [total]
    for G_s in G:
        # a person's own parameters are determined only by the person's data and the tie to the population
        own = total.copy()
        own[np.ix_(personal, personal)] = G_s[np.ix_(personal, personal)] + W
        own[np.ix_(personal, shared)] = G_s[np.ix_(personal, shared)]
        own[np.ix_(shared, personal)] = G_s[np.ix_(shared, personal)]
        candidates.append(own)
    for matrix in candidates:
        value, direction = np.linalg.eigh(matrix)
        weak = value < 1e-10 * value[-1]
        for column in direction.T[weak]:
            indices |= set(np.flatnonzero(np.abs(column) > 0.1 * np.abs(column).max()).tolist())
    return tuple(sorted(indices))
