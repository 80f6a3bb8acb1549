"""Hierarchical linear least squares: parameters of a population, of each person, and their spread between people.

Each person enters as ONE factor, the sum over all of the person's segments. The work of the solver therefore grows with
the number of people, not of segments. The sum is exact, because every segment is linear, and a sum of squares of linear
residuals is a single quadratic form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from pdr_filter.values import FloatArray, IntArray

_POPULATION = 0  # key of the population's parameters; people have the keys 1 to S
# Limit on the ratio of the smallest to the largest diagonal entry of a square-root factor with columns of unit size.
# Below it, two parameters cannot be separated within rounding errors.
_SINGULAR = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class PeoplePosterior:
    """Normal posterior of the parameters of the population and of each person.

    Attributes
    ----------
    population : array (P,)
        Mean of the population's parameters.
    population_cov : array (P, P)
        Covariance of the population's parameters.
    people : array (S, P)
        Mean of each person's parameters. Parameters that people share have the value of the population.
    people_cov : array (S, P, P)
        Covariance of each person's parameters.
    apart_cov : array (S, Q, Q)
        Covariance of the difference between each person's own parameters and the population's.
    """

    population: FloatArray
    population_cov: FloatArray
    people: FloatArray
    people_cov: FloatArray
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
    found = _eliminated(G, g, prior_mean / scale, precision, personal, W)
    y, y_cov, theta, cov = found.population, found.population_cov, found.people, found.people_cov
    n_people = len(theta)
    if free.any() and n_people:
        alone = personal[free]
        spread = theta[:, alone].var(axis=0, ddof=1) if n_people > 1 else np.diagonal(cov[0])[alone]
        y[alone] = theta[:, alone].mean(axis=0)
        y_cov[alone, :] = y_cov[:, alone] = 0.0
        y_cov[alone, alone] = spread / n_people + np.diagonal(cov, axis1=1, axis2=2)[:, alone].mean(axis=0) / n_people
    both = scale[:, None] * scale
    own = both[np.ix_(personal, personal)]
    return PeoplePosterior(y * scale, y_cov * both, theta * scale, cov * both, found.apart_cov * own)


def _eliminated(
    G: FloatArray, g: FloatArray, mean: FloatArray, precision: FloatArray, personal: IntArray, W: FloatArray
) -> PeoplePosterior:
    """Return the posterior of the population's and all people's step-length parameters, by elimination with GTSAM.

    The parameters are scaled so that their values are about one. GTSAM first eliminates the own parameters t_s of each
    person s, then the population's parameters y. Elimination gives R t_s + S y = d + unit normal noise for each person,
    with the matrices R (triangular) and S and the vector d. The arguments are the same as of `solve_people`.
    SingularError if the data do not determine the parameters.
    """
    n_people, n_params = g.shape
    ordering = gtsam.Ordering()
    for key in (*range(1, n_people + 1), _POPULATION):
        if key == _POPULATION or len(personal):
            ordering.push_back(key)
    try:
        net: Any = _graph(G, g, mean, precision, personal, W).eliminateSequential(ordering)
    except RuntimeError as error:
        raise SingularError(_undetermined(G, precision, personal, W)) from error
    R, _, d = _parts(net.at(net.size() - 1))
    diagonal = [R.diagonal()]
    inverse = np.linalg.inv(R)
    y, y_cov = inverse @ d, inverse @ inverse.T
    theta = np.repeat(y[None], n_people, axis=0)
    own_cov = np.zeros((n_people, len(personal), len(personal)))
    follow = np.repeat(np.eye(n_params)[None], n_people, axis=0)  # theta_s = follow_s y + constant + independent noise
    if len(personal):
        parts = [_parts(net.at(s)) for s in range(n_people)]
        R_s, S_s, d_s = (np.stack([p[k] for p in parts]) for k in range(3))
        diagonal.append(np.diagonal(R_s, axis1=1, axis2=2).ravel())
        inverse_s = np.linalg.inv(R_s)
        gain = -inverse_s @ S_s
        theta[:, personal] = np.einsum("sij,sj->si", inverse_s, d_s) + gain @ y
        own_cov = inverse_s @ inverse_s.transpose(0, 2, 1)
        follow[:, personal] = gain
    size = np.abs(np.concatenate(diagonal))
    if not np.isfinite(theta).all() or size.min() < _SINGULAR * max(1.0, float(size.max()) / np.sqrt(max(n_people, 1))):
        raise SingularError(_undetermined(G, precision, personal, W))
    cov = follow @ y_cov @ follow.transpose(0, 2, 1)
    cov[:, personal[:, None], personal] += own_cov
    apart = follow[:, personal] - np.eye(n_params)[personal]
    return PeoplePosterior(y, y_cov, theta, cov, own_cov + apart @ y_cov @ apart.transpose(0, 2, 1))


def _graph(
    G: FloatArray, g: FloatArray, mean: FloatArray, precision: FloatArray, personal: IntArray, W: FloatArray
) -> gtsam.GaussianFactorGraph:
    """Return the factor graph: one factor for the prior of the population, and one per person."""
    n_params = g.shape[1]
    graph = gtsam.GaussianFactorGraph()
    root = np.sqrt(precision)
    unit = gtsam.noiseModel.Unit.Create(n_params)
    graph.add(gtsam.JacobianFactor(_POPULATION, np.diag(root), root * mean, unit))
    if len(personal) == 0:
        for G_s, g_s in zip(G, g, strict=True):
            graph.add(gtsam.HessianFactor(_POPULATION, G_s, g_s, 0.0))
        return graph
    blocks = _blocks(G, g, personal, W)
    for s, (own, cross, own_vector, rest, rest_vector) in enumerate(zip(*blocks, strict=True), 1):
        graph.add(gtsam.HessianFactor(s, _POPULATION, own, cross, own_vector, rest, rest_vector, 0.0))
    return graph


def _blocks(
    G: FloatArray, g: FloatArray, personal: IntArray, W: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the quadratic form of each person s in the own parameters t_s and the population's parameters y.

    It includes the prior of t_s given y. The five blocks are the matrix of t_s, the mixed matrix, the vector of t_s,
    the matrix of y, and the vector of y.
    """
    n_people, n_params = g.shape
    shared = np.delete(np.arange(n_params), personal)
    cross = np.zeros((n_people, len(personal), n_params))
    rest, rest_vector = np.zeros_like(G), np.zeros_like(g)
    cross[:, :, shared] = G[:, personal][:, :, shared]
    cross[:, :, personal] -= W
    rest[:, shared[:, None], shared] = G[:, shared][:, :, shared]
    rest[:, personal[:, None], personal] += W
    rest_vector[:, shared] = g[:, shared]
    return G[:, personal][:, :, personal] + W, cross, g[:, personal], rest, rest_vector


def population_without_each(
    posterior: PeoplePosterior, G: FloatArray, g: FloatArray, personal: IntArray, W: FloatArray
) -> FloatArray:
    """Return the population's parameters (S, P) estimated without each person in turn.

    The person's marginal contribution is subtracted from the population's information. Rows are NaN where the rest does
    not determine the parameters.
    """
    own, cross, own_vector, message, message_vector = _blocks(G, g, personal, W)
    if len(personal):
        gain = np.linalg.solve(own, cross)
        message -= cross.transpose(0, 2, 1) @ gain
        message_vector -= np.einsum("sqp,sq->sp", gain, own_vector)
    scale = np.sqrt(np.diagonal(posterior.population_cov))
    total = np.linalg.inv(posterior.population_cov / scale[:, None] / scale)
    left = total - message * scale[:, None] * scale
    left_vector = total @ (posterior.population / scale) - message_vector * scale
    result = np.full_like(g, np.nan)
    for s, (matrix, vector) in enumerate(zip(left, left_vector, strict=True)):
        if np.linalg.eigvalsh(matrix)[0] > 1e-9:
            result[s] = np.linalg.solve(matrix, vector) * scale
    return result


def _parts(conditional: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return R, S and d of a Gaussian conditional density of GTSAM.

    Under the density, R t + S y - d has zero mean and unit covariance. The vector t holds the eliminated variables, and
    y the variables on which they depend.
    """
    return np.asarray(conditional.R()), np.asarray(conditional.S()), np.asarray(conditional.d())


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
