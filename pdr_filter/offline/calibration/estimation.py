"""Parameters of step-length models from the sums over segments: people, noise, wrong segments, all at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from pdr_filter.offline.calibration.segments import SegmentSums
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray
from pdr_filter.values.contexts import CONTEXTS

if TYPE_CHECKING:
    from pdr_filter.offline.calibration.hierarchy import Posterior

LOSSES = ("none", "huber", "cauchy", "gnc")
# Tuning constants in standard deviations: Huber's and Cauchy's lose 5 % of efficiency on normal errors (Zhang,
# "Parameter estimation techniques", Image and Vision Computing 15, 1997); Geman-McClure's, at the end of the graduated
# non-convexity (Yang et al., "Graduated non-convexity for robust spatial perception", RA-L 5, 2020), about as much.
_HUBER, _CAUCHY, _GEMAN_MCCLURE = 1.345, 2.385, 4.0
# A residual of more than so many standard deviations is distrusted: one good segment in 370.
DISTRUST = 3.0
_MAX_ITERATIONS = 200
_CHUNK_SEGMENTS = 4096
_HUBER_ITERATIONS = 5  # a redescending loss needs a start that outliers did not choose


@dataclass(frozen=True, slots=True, eq=False)
class Hierarchy:
    """Prior of all parameters (P,) and of all variances.

    Parameters
    ----------
    mean, std : (P,)
        Of the population; std 0 holds a parameter, inf knows nothing of it.
    between_std : (P,)
        How people differ at the start; 0 for shared parameters, inf for people who tell nothing about each other.
    step_std_m : (C,)
        Of a single step in each of `CONTEXTS`.
    recording_std : float
        How one person's scale differs between recordings, relative.
    between_dof, recording_dof, noise_dof : float
        How many people, recordings and segments these three are worth; inf holds them, 0 takes them from the data.
    """

    mean: FloatArray
    std: FloatArray
    between_std: FloatArray
    step_std_m: FloatArray
    recording_std: float
    between_dof: float = 10.0
    recording_dof: float = 10.0
    noise_dof: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the segments say; covariances given the variances found.

    Parameters
    ----------
    population, population_cov : (P,), (P, P)
    people, people_cov : (S, P), (S, P, P)
    between_cov : (P, P)
        Between people; infinite on the diagonal where people tell nothing about each other.
    recording_std : float
        Of one person's scale between recordings.
    noise_factor : (C,)
        Variance of the segments of each context over that expected.
    predicted_m, left_out_m, stranger_m : (N,)
        Length of each segment with the person's parameters; with those from all other segments; with the population's
        from all other people (NaN if there are none).
    misfit : (N,)
        Residual over its standard deviation, less what the whole recording has in common.
    weight : (N,)
        Of each segment, 1 for one that fits.
    n_iterations : int
    converged : bool
    """

    population: FloatArray
    population_cov: FloatArray
    people: FloatArray
    people_cov: FloatArray
    between_cov: FloatArray
    recording_std: float
    noise_factor: FloatArray
    predicted_m: FloatArray
    left_out_m: FloatArray
    stranger_m: FloatArray
    misfit: FloatArray
    weight: FloatArray
    n_iterations: int
    converged: bool


def weights(misfit: FloatArray, loss: str, mu: float = 1.0) -> FloatArray:
    """Weights w(u) of residuals u in standard deviations; `mu` is the control parameter of the graduated non-convexity.

    Huber min(1, k / |u|); Cauchy 1 / (1 + (u / k)^2); Geman-McClure (mu k^2 / (u^2 + mu k^2))^2, whose loss is convex
    for large mu and redescending for 1.
    """
    if loss == "none":
        return np.ones_like(misfit)
    if loss == "huber":
        return _HUBER / np.maximum(np.abs(misfit), _HUBER)
    if loss == "cauchy":
        return 1 / (1 + (misfit / _CAUCHY) ** 2)
    if loss == "gnc":
        return (mu * _GEMAN_MCCLURE**2 / (misfit**2 + mu * _GEMAN_MCCLURE**2)) ** 2
    raise ValueError(f"loss must be one of {LOSSES}, got {loss!r}")


@cache
def moments(loss: str, mu: float = 1.0) -> tuple[float, float]:
    """E w u^2 and the information factor of a loss on standard normal residuals.

    The first makes the scale consistent: sum w u^2 / n tends to it. The second makes covariances right: with
    psi = w u the variance of an M-estimate is E psi^2 / (E psi')^2 times that of least squares, E psi' = E w u^2
    (Stein), while the weighted normal equations say 1 / E w. Their ratio (E w u^2)^2 / (E psi^2 E w) multiplies the
    weights.
    """
    u = np.linspace(-9, 9, 20001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi) * (u[1] - u[0])
    w = weights(u, loss, mu)
    square, psi_square, mean = (float((density * f).sum()) for f in (w * u**2, (w * u) ** 2, w))
    return square, square**2 / (psi_square * mean)


def estimate(
    sums: SegmentSums,
    prior: Hierarchy,
    loss: str = "gnc",
    relinearise: Callable[[FloatArray], SegmentSums] | None = None,
) -> Estimate:
    """Maximum a posteriori of all parameters and variances by expectation-maximisation.

    Segment i of person s in recording w: distance_i = |A_i theta_s| (1 + rho_w) + e_i, with theta_s about the
    population (covariance B), rho_w ~ N(0, tau^2), e_i ~ N(0, phi_c (anchor_i^2 + n_i sigma_c^2)). Every iteration
    takes the direction of A_i theta_s from the last one (Gauss-Newton: the length of a vector changes only with the
    component along it), integrates rho_w out exactly, solves for all theta (`hierarchy.solve`), and takes phi, tau, B
    and the robust weights from the posterior of e, rho and theta_s - population.

    Parameters
    ----------
    sums : SegmentSums
    prior : Hierarchy
    loss : {"gnc", "cauchy", "huber", "none"}
    relinearise : callable, optional
        Sums about the parameters of each person (S, P), for models that are not linear.

    Raises
    ------
    hierarchy.SingularError
        Parameters that neither data nor priors determine.
    """
    from pdr_filter.offline.calibration.hierarchy import solve  # loads gtsam

    weights(np.zeros(1), loss)
    fixed = (prior.std == 0) & (prior.between_std == 0)
    if ((prior.std == 0) & ~fixed).any():
        raise ValueError("a parameter that is held for the population (std 0) cannot differ between people")
    free = np.flatnonzero(~fixed)
    personal = np.flatnonzero(prior.between_std[free] > 0)
    alone = np.isinf(prior.between_std[free][personal])
    order = np.lexsort((sums.recording, sums.subject))
    chunks = [_Chunk(sums, rows, prior, fixed) for rows in _whole_people(sums.subject[order], order)]
    n_people = len(sums.subjects)
    counts = np.bincount(sums.context, minlength=len(CONTEXTS))
    with np.errstate(divide="ignore"):
        precision = 1 / prior.std[free] ** 2
    start_between = np.diag(np.where(alone, 1.0, prior.between_std[free][personal]) ** 2)

    theta = np.repeat(prior.mean[None, free], n_people, axis=0)
    between, tau2, phi = start_between, prior.recording_std**2, np.ones(len(CONTEXTS))
    posterior: Posterior | None = None
    about = theta
    G, g = np.zeros((n_people, len(free), len(free))), np.zeros((n_people, len(free)))
    converged, iteration, settled_from = False, 0, 0
    stage, mu = "none", 1.0
    while iteration < _MAX_ITERATIONS and not converged:
        iteration += 1
        if relinearise is not None and iteration > 1:
            full = np.repeat(prior.mean[None], n_people, axis=0)
            full[:, free] = theta
            renewed = relinearise(full)
            for chunk in chunks:
                chunk.take(renewed, prior.mean, fixed)
        square, information = moments(stage, mu)
        about, before = theta, posterior
        for chunk in chunks:
            chunk.normal_equations(about, phi * (1 / information), tau2, iteration == 1, G, g)
        W = np.zeros_like(between)
        W[np.ix_(~alone, ~alone)] = np.linalg.inv(between[np.ix_(~alone, ~alone)])
        posterior = solve(G, g, prior.mean[free], precision, personal, W)
        theta = posterior.people
        # expectations, then what maximises the variances given them
        old = (phi, tau2, between)
        excess, found, n_recordings = np.zeros(len(CONTEXTS)), 0.0, 0
        for chunk in chunks:
            chunk.expect(about, posterior, phi)
            excess += np.bincount(
                chunk.context, chunk.w * (chunk.error**2 + chunk.spread) / chunk.base_var, minlength=len(CONTEXTS)
            )
            found += chunk.rho_square
            n_recordings += len(chunk.kappa)
        if np.isfinite(prior.noise_dof):
            total = prior.noise_dof + counts
            phi = np.where(total > 0, (prior.noise_dof + excess / square) / np.where(total > 0, total, 1), 1.0)
        if np.isfinite(prior.recording_dof) and tau2 > 0:
            tau2 = (prior.recording_dof * prior.recording_std**2 + found) / (prior.recording_dof + n_recordings)
        if np.isfinite(prior.between_dof) and len(personal):
            apart = theta[:, personal] - posterior.population[personal]
            scatter = apart.T @ apart + posterior.deviation_cov.sum(axis=0)
            between = (prior.between_dof * start_between + scatter) / (prior.between_dof + n_people)
            between[alone] = between[:, alone] = 0.0
            between[alone, alone] = 1.0
        # the weight of a segment is that of its misfit
        largest = max(float(np.abs(chunk.misfit).max()) for chunk in chunks)
        stage, mu, is_final = _stage(loss, iteration, largest, mu)
        for chunk in chunks:
            chunk.w = weights(chunk.misfit, stage, mu)
        settled_from = settled_from if is_final else iteration
        if before is not None and iteration > settled_from + 1:
            moved = np.abs(theta - before.people) / np.sqrt(np.diagonal(posterior.people_cov, axis1=1, axis2=2))
            converged = float(moved.max(initial=0.0)) < 1e-4 and _same(old, (phi, tau2, between))
    assert posterior is not None

    others = np.full_like(theta, np.nan)
    if n_people > 1 and not alone.any():
        others = _without_each(posterior, G, g, personal, np.linalg.inv(between) if len(personal) else between)
    predicted, left_out, stranger, misfit, weight = (np.empty(len(sums)) for _ in range(5))
    for chunk in chunks:
        rows = chunk.rows
        predicted[rows] = chunk.length(theta)
        left_out[rows] = predicted[rows] - chunk.pull(about, posterior)
        stranger[rows] = chunk.length(others)
        misfit[rows], weight[rows] = chunk.misfit, chunk.w
    n_params = len(prior.mean)
    population, people = prior.mean.copy(), np.repeat(prior.mean[None], n_people, axis=0)
    population[free], people[:, free] = posterior.population, posterior.people
    between[alone, alone] = np.inf
    between_cov = np.zeros((n_params, n_params))
    between_cov[np.ix_(free[personal], free[personal])] = between
    population_cov, people_cov = np.zeros((n_params, n_params)), np.zeros((n_people, n_params, n_params))
    population_cov[np.ix_(free, free)] = posterior.population_cov
    people_cov[:, free[:, None], free] = posterior.people_cov
    return Estimate(
        population=population,
        population_cov=population_cov,
        people=people,
        people_cov=people_cov,
        between_cov=between_cov,
        recording_std=float(np.sqrt(tau2)),
        noise_factor=phi,
        predicted_m=predicted,
        left_out_m=left_out,
        stranger_m=stranger,
        misfit=misfit,
        weight=weight,
        n_iterations=iteration,
        converged=converged,
    )


def _whole_people(person: IntArray, order: IntArray) -> list[IntArray]:
    """Sorted rows in pieces of some thousands that cut nobody in two: temporary arrays stay in the cache."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(person)) + 1, [len(person)]])
    cuts = [0]
    for end in starts[1:]:
        if end - cuts[-1] >= _CHUNK_SEGMENTS or end == len(person):
            cuts.append(int(end))
    return [order[a:b] for a, b in pairwise(cuts)]


class _Chunk:
    """Segments of some people: what stays, and what one iteration leaves for the next."""

    def __init__(self, sums: SegmentSums, rows: IntArray, prior: Hierarchy, fixed: BoolArray) -> None:
        self.rows = rows
        self.group = _Groups.of(sums.subject[rows], sums.recording[rows])
        self.context, self.distance = sums.context[rows], sums.distance_m[rows]
        self.base_var = sums.anchor_std_m[rows] ** 2 + sums.n_steps[rows] * prior.step_std_m[self.context] ** 2
        if not (self.base_var > 0).all():
            raise ValueError("every segment needs a positive variance: set anchor_std_m or step_std_m")
        self.w = np.ones(len(rows))
        self.error = self.spread = self.misfit = self.variance = self.size = self.kappa = np.empty(0)
        self.a = self.q = np.empty(0)
        self.rho_square = 0.0
        self.take(sums, prior.mean, fixed)

    def take(self, sums: SegmentSums, mean: FloatArray, fixed: BoolArray) -> None:
        """Regressors of the free parameters (n, 2, F), and what the others add (n, 2)."""
        regressors = sums.regressors[self.rows]
        self.A = np.ascontiguousarray(regressors[:, :, ~fixed])
        self.offset = sums.offset_m[self.rows] + regressors[:, :, fixed] @ mean[fixed]

    def length(self, theta: FloatArray) -> FloatArray:
        """Predicted lengths (n,) for the parameters of all people (S, F)."""
        vector = np.einsum("ndp,np->nd", self.A, theta[self.group.person]) + self.offset
        return np.hypot(vector[:, 0], vector[:, 1])

    def normal_equations(
        self, about: FloatArray, phi: FloatArray, tau2: float, first: bool, G: FloatArray, g: FloatArray
    ) -> None:
        """Write the G_s (F, F) and g_s (F,) of these people, linearised about their parameters (S, F)."""
        group = self.group
        self.variance = phi[self.context] * self.base_var / self.w
        row, target = _linearised(self.A, self.offset, about[group.person], self.distance)
        # Recordings: rho integrated out, a rank-one correction each. It scales the predicted length: with the known one
        # theta = 0 and rho = 1 would explain everything.
        self.size = self.distance if first else self.length(about)
        self.a = group.sum_recordings(row * (self.size / self.variance)[:, None])
        s = group.sum_recordings(self.size**2 / self.variance)
        self.q = group.sum_recordings(self.size * target / self.variance)
        self.kappa = tau2 / (1 + tau2 * s)
        G[group.present] = group.gram(row, 1 / self.variance) - group.gram_of_recordings(self.a, self.kappa)
        g[group.present] = group.sum_people(row * (target / self.variance)[:, None])
        g[group.present] -= group.sum_recordings_of_people(self.a * (self.kappa * self.q)[:, None])

    def expect(self, about: FloatArray, posterior: Posterior, phi: FloatArray) -> None:
        """Expectations of e_i (mean and variance) and of the sum of rho_w^2."""
        group, theta = self.group, posterior.people
        row, target = _linearised(self.A, self.offset, about[group.person], self.distance)
        rho = self.kappa * (self.q - np.einsum("wp,wp->w", self.a, theta[group.person_of_recording]))
        self.error = target - np.einsum("np,np->n", row, theta[group.person]) - self.size * rho[group.recording]
        tilted = self._tilted(row)
        self.spread = group.bilinear(tilted, tilted, posterior.people_cov)
        self.spread += self.size**2 * self.kappa[group.recording]
        self.misfit = self.error / np.sqrt(phi[self.context] * self.base_var)
        rho_variance = self.kappa + self.kappa**2 * group.bilinear_of_recordings(self.a, posterior.people_cov)
        self.rho_square = float((rho**2 + rho_variance).sum())

    def pull(self, about: FloatArray, posterior: Posterior) -> FloatArray:
        """How much each segment draws its own prediction, (n,).

        theta without segment i = theta - C tilted_i' error_i / (variance_i - tilted_i C tilted_i' - size_i^2 kappa).
        """
        row, _ = _linearised(self.A, self.offset, about[self.group.person], self.distance)
        gain = self.group.bilinear(self._tilted(row), row, posterior.people_cov)
        return gain / np.maximum(self.variance - self.spread, 1e-6 * self.variance) * self.error

    def _tilted(self, row: FloatArray) -> FloatArray:
        """Derivative of -e_i with respect to theta, through rho_w as well."""
        return row - (self.size * self.kappa[self.group.recording])[:, None] * self.a[self.group.recording]


def _stage(loss: str, iteration: int, largest: float, mu: float) -> tuple[str, float, bool]:
    """Loss and control parameter of the next iteration, and whether they are the final ones."""
    if loss == "cauchy" and iteration < _HUBER_ITERATIONS:
        return "huber", 1.0, False
    if loss == "gnc":
        # as convex at first as the largest residual needs; then 1.4 times less in each iteration
        start = max(1.0, round(2 * (largest / _GEMAN_MCCLURE) ** 2, 1))
        mu = start if iteration == 1 else max(1.0, round(mu / 1.4, 3))
        return loss, mu, mu == 1.0
    return loss, 1.0, True


def _same(old: tuple[FloatArray, float, FloatArray], new: tuple[FloatArray, float, FloatArray]) -> bool:
    """Whether variances changed by less than one in 5000."""
    before = np.concatenate([old[0], [old[1]], np.diagonal(old[2])])
    after = np.concatenate([new[0], [new[1]], np.diagonal(new[2])])
    return bool((np.abs(after - before) <= 2e-4 * np.abs(before)).all())


def _linearised(
    A: FloatArray, offset: FloatArray, theta: FloatArray, distance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows (N, F) and targets (N,) such that distance - |A theta + offset| = target - row @ theta near these theta."""
    vector = np.einsum("ndp,np->nd", A, theta) + offset
    size = np.hypot(vector[:, 0], vector[:, 1])
    nowhere = size < 1e-9  # at the start, if nothing is known: along the largest regressor
    if nowhere.any():
        largest = np.einsum("ndp->np", A[nowhere] ** 2).argmax(axis=1)
        vector = vector.copy()
        vector[nowhere] = A[nowhere, :, largest]
        size = np.hypot(vector[:, 0], vector[:, 1])
    along = vector / np.maximum(size, 1e-12)[:, None]
    row = along[:, :1] * A[:, 0] + along[:, 1:] * A[:, 1]
    return row, distance - (along * offset).sum(axis=1)


def _without_each(posterior: Posterior, G: FloatArray, g: FloatArray, personal: IntArray, W: FloatArray) -> FloatArray:
    """Population's parameters from all people but one, (S, F): the person's message taken from the population's sum."""
    n_params = g.shape[1]
    shared = np.delete(np.arange(n_params), personal)
    message, message_vector = np.zeros_like(G), np.zeros_like(g)
    message[:, shared[:, None], shared] = G[:, shared[:, None], shared]
    message_vector[:, shared] = g[:, shared]
    if len(personal):
        cross = np.zeros((len(g), len(personal), n_params))
        cross[:, :, shared] = G[:, personal[:, None], shared]
        cross[:, :, personal] = -W
        message[:, personal[:, None], personal] += W
        own = G[:, personal[:, None], personal] + W
        gain = np.linalg.solve(own, cross)
        message -= cross.transpose(0, 2, 1) @ gain
        message_vector -= np.einsum("sqp,sq->sp", gain, g[:, personal])
    scale = np.sqrt(np.diagonal(posterior.population_cov))
    total = np.linalg.inv(posterior.population_cov / scale[:, None] / scale)
    left = total - message * scale[:, None] * scale
    left_vector = total @ (posterior.population / scale) - message_vector * scale
    result = np.full((len(g), n_params), np.nan)
    for s, (matrix, vector) in enumerate(zip(left, left_vector, strict=True)):
        if np.linalg.eigvalsh(matrix)[0] > 1e-9:
            result[s] = np.linalg.solve(matrix, vector) * scale
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Groups:
    """Sums over sorted segments by person and by recording of a person."""

    person: IntArray  # (n,)
    recording: IntArray  # (n,) numbered in order of appearance
    present: IntArray  # (S',) people that have segments here
    person_start: IntArray  # (S' + 1,) first segment of each, and n
    recording_start: IntArray  # (W,) first segment of each recording
    person_of_recording: IntArray  # (W,)
    first_recording: IntArray  # (S' + 1,) of each person, and W

    @staticmethod
    def of(person: IntArray, recording: IntArray) -> _Groups:
        starts = np.concatenate([[0], np.flatnonzero(np.diff(person)) + 1, [len(person)]])
        new = np.concatenate([[True], (np.diff(person) != 0) | (np.diff(recording) != 0)])
        recording_start = np.flatnonzero(new)
        owner = person[recording_start]
        first = np.concatenate([[0], np.flatnonzero(np.diff(owner)) + 1, [len(owner)]])
        return _Groups(person, np.cumsum(new) - 1, person[starts[:-1]], starts, recording_start, owner, first)

    def sum_recordings(self, values: FloatArray) -> FloatArray:
        return np.add.reduceat(values, self.recording_start, axis=0)

    def sum_people(self, values: FloatArray) -> FloatArray:
        return np.add.reduceat(values, self.person_start[:-1], axis=0)

    def sum_recordings_of_people(self, values: FloatArray) -> FloatArray:
        return np.add.reduceat(values, self.first_recording[:-1], axis=0)

    def gram(self, rows: FloatArray, weight: FloatArray) -> FloatArray:
        """Sums of weight row' row by person, (S', F, F)."""
        return _gram(rows, weight, self.person_start)

    def gram_of_recordings(self, rows: FloatArray, weight: FloatArray) -> FloatArray:
        return _gram(rows, weight, self.first_recording)

    def bilinear(self, left: FloatArray, right: FloatArray, cov: FloatArray) -> FloatArray:
        """Left C right' of each segment, with the covariance of its person out of (S, F, F)."""
        return _bilinear(left, right, cov[self.present], self.person_start)

    def bilinear_of_recordings(self, rows: FloatArray, cov: FloatArray) -> FloatArray:
        return _bilinear(rows, rows, cov[self.present], self.first_recording)


def _gram(rows: FloatArray, weight: FloatArray, start: IntArray) -> FloatArray:
    weighted = rows * weight[:, None]
    result = np.stack([weighted[a:b].T @ rows[a:b] for a, b in pairwise(start.tolist())])
    return 0.5 * (result + result.transpose(0, 2, 1))


def _bilinear(left: FloatArray, right: FloatArray, cov: FloatArray, start: IntArray) -> FloatArray:
    turned = np.concatenate([left[a:b] @ own for (a, b), own in zip(pairwise(start.tolist()), cov, strict=True)])
    return np.einsum("np,np->n", turned, right)
