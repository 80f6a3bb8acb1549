"""Joint estimate of step-length parameters, variances and outlier weights from the sums over segments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pdr_filter.offline.calibration.hierarchy import PeoplePosterior, population_without_each, solve_people
from pdr_filter.offline.calibration.segments import SegmentSums
from pdr_filter.offline.robust_loss import loss_moments, next_stage, weights
from pdr_filter.values import BoolArray, FloatArray, IntArray

_MAX_ITERATIONS = 500
# An extrapolation covers at most twenty further steps and changes no variance by more than a factor of two. No
# extrapolation takes place after so many iterations, so that plain steps can settle.
_MAX_RATE, _MAX_FACTOR, _EXTRAPOLATED = 0.95, 2.0, 60


@dataclass(frozen=True, slots=True, eq=False)
class Hierarchy:
    """Prior of all parameters (P,) and of all variances."""

    mean: FloatArray  # (P,) prior mean of the population's parameters
    # (P,) prior standard deviation of the population's parameters: 0 holds a parameter, inf is uninformative
    std: FloatArray
    # (P,) initial standard deviation between people: 0 for shared parameters, inf for parameters that are independent
    # between people
    between_std: FloatArray
    step_std_m: FloatArray  # (C,) standard deviation of a single step in each context
    recording_std: float  # relative standard deviation of one person's scale between recordings
    # weight of the prior of the variances between people, as an equivalent number of people. inf holds the variances, 0
    # estimates them from the data alone
    between_dof: float = 10.0
    recording_dof: float = 10.0  # the corresponding weight of `recording_std`, as a number of recordings
    noise_dof: float = 10.0  # the corresponding weight of the noise of segments, as a number of segments


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PeopleEstimate:
    """Estimated parameters of the population and of S people. The covariances are conditional on the variances."""

    population: FloatArray  # (P,) parameters of the population
    population_cov: FloatArray  # (P, P) covariance of `population`
    people: FloatArray  # (S, P) parameters of each person
    people_cov: FloatArray  # (S, P, P) covariance of `people`
    # (P, P) covariance between people. Infinite on the diagonal for parameters that are independent between people.
    between_cov: FloatArray
    recording_std: float  # relative standard deviation of one person's scale between recordings
    n_iterations: int
    converged: bool  # False if the iterations ended before the changes became negligible


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ParameterEstimate(PeopleEstimate):
    """Estimated parameters from N segments, and the fit of each segment."""

    noise_factor: FloatArray  # (C,) ratio of the estimated to the prior variance of the segments of each context
    predicted_m: FloatArray  # (N,) predicted length of each segment with the parameters of the person
    left_out_m: FloatArray  # (N,) predicted length with the person's parameters estimated without this segment
    # (N,) predicted length with the population's parameters estimated without this person. NaN if there are no other
    # people, if they do not determine the parameters, or if a parameter is independent between people.
    stranger_m: FloatArray
    misfit: FloatArray  # (N,) residual with respect to the prediction from all other segments, in standard deviations
    weight: FloatArray  # (N,) robust weight, 1 for a segment that fits


def estimate_parameters(
    sums: SegmentSums,
    prior: Hierarchy,
    loss: str = "gnc",
    relinearise: Callable[[FloatArray], SegmentSums] | None = None,
) -> ParameterEstimate:
    """Return the maximum a posteriori estimate of all parameters and variances by expectation-maximisation.

    The known length of segment i is | A_i theta_s | (1 + rho_w) + e_i. A_i are the regressors of the segment
    (`SegmentSums`) and theta_s the parameters of person s. rho_w is the scale error of recording w with the variance
    tau^2. e_i is noise, whose variance is the prior variance times the factor phi of the context. B is the covariance
    of theta between people.

    Every iteration linearises at the direction of A_i theta_s from the previous one (Gauss-Newton) and integrates out
    the scale errors rho_w exactly. The iteration then solves for all theta (`hierarchy.solve_people`), and updates the
    robust weights and the variances phi, tau^2 and B from the posterior (docs/methods/calibration.md).

    `relinearise` is a function for nonlinear models, which returns the `SegmentSums` linearised at the given parameters
    of each person (S, P). Raises SingularError if neither data nor priors determine a parameter.
    """
    weights(np.zeros(1), loss)
    task = _Task(sums, prior)
    segments = task.segments
    theta, variances = task.start_theta, task.start_variances
    posterior: PeoplePosterior | None = None
    about = theta
    converged, iteration, settled_from = False, 0, 0
    stage, mu, is_final = "none", 1.0, loss == "none"
    path: list[_Variances] = []
    while iteration < _MAX_ITERATIONS and not converged:
        iteration += 1
        if relinearise is not None and iteration > 1:
            segments.set_regressors(relinearise(task.all_parameters(theta)), prior.mean, task.fixed)
        ratio, information = loss_moments(stage, mu)
        about, before, old = theta, posterior, variances
        posterior = task.posterior(about, variances, information, iteration == 1)
        theta = posterior.people
        segments.compute_residuals(about, posterior, variances.noise)
        # Before the outliers are found, the variances stay fixed: otherwise outliers would increase the noise and the
        # differences between people.
        if is_final:
            variances = task.variances(posterior, old, ratio)
            path = [*path[-2:], variances]
            if len(path) == 3 and iteration <= _EXTRAPOLATED:
                variances, path = path[2].extrapolated(path[0], path[1]), []
        largest = float(np.abs(segments.misfit).max())
        stage, mu, is_final = next_stage(loss, iteration, largest, mu)
        segments.w = weights(segments.misfit, stage, mu)
        settled_from = settled_from if is_final else iteration
        if before is not None and iteration > settled_from + 1:
            moved = np.abs(theta - before.people) / np.sqrt(np.diagonal(posterior.people_cov, axis1=1, axis2=2))
            converged = float(moved.max(initial=0.0)) < 1e-4 and variances.is_near(old)
    if posterior is None:
        raise ValueError(f"the module constant _MAX_ITERATIONS must be 1 or more, got {_MAX_ITERATIONS}: restore it")
    return task.result(about, posterior, variances, iteration, converged)


@dataclass(frozen=True, slots=True, eq=False)
class _Variances:
    """Variances of one iteration.

    `noise` (C,) is phi, the ratio of the estimated to the prior variance of the segments of each context. `recording`
    is tau^2, the variance of one person's scale between recordings. `between` (Q, Q) is B, the covariance of the
    people's own parameters, with ones on the diagonal where people are independent.
    """

    noise: FloatArray
    recording: float
    between: FloatArray

    def is_near(self, other: _Variances) -> bool:
        """Return True if no variance differs by more than one in 5000."""
        own, others = (np.concatenate([v.noise, [v.recording], np.diagonal(v.between)]) for v in (self, other))
        return bool((np.abs(own - others) <= 2e-4 * np.abs(others)).all())

    def _logs(self) -> FloatArray:
        """Return the logarithms of all variances, shape (C + 1 + Q,).

        In this order they are those of `noise` (C contexts), of `recording`, and of the diagonal of `between`. The last
        are the variances between people of their Q own parameters, with ones where people are independent. Variances
        below 1e-300 count as 1e-300.
        """
        values = np.concatenate([self.noise, [self.recording], np.diagonal(self.between)])
        return np.log(np.maximum(values, 1e-300))

    def extrapolated(self, first: _Variances, second: _Variances) -> _Variances:
        """Return the extrapolated limit of three iterations, by Aitken's formula on each logarithm.

        Without it, hundreds of iterations would continue in the same direction when single segments determine noise,
        recordings and people together.
        """
        a, b, c = (v._logs() for v in (first, second, self))
        steady = np.divide(c - b, b - a, where=np.abs(b - a) > 1e-9, out=np.zeros_like(a))
        rate = np.clip(steady, 0.0, _MAX_RATE)
        factor = np.exp(np.clip((c - b) * rate / (1 - rate), -np.log(_MAX_FACTOR), np.log(_MAX_FACTOR)))
        n = len(self.noise)
        root = np.sqrt(factor[n + 1 :])
        return _Variances(self.noise * factor[:n], self.recording * factor[n], self.between * root[:, None] * root)


class _Task:
    """Quantities that stay fixed during the iterations.

    They are the segments, the priors, and the indices of the free and the personal parameters.
    """

    def __init__(self, sums: SegmentSums, prior: Hierarchy) -> None:
        self.prior, self.n_people = prior, len(sums.subjects)
        self.fixed = (prior.std == 0) & (prior.between_std == 0)
        if ((prior.std == 0) & ~self.fixed).any():
            raise ValueError(
                "a parameter that is held for the population (std 0) cannot differ between people: set between_std to 0"
            )
        self.free = np.flatnonzero(~self.fixed)
        between_std = prior.between_std[self.free]
        self.personal = np.flatnonzero(between_std > 0)
        self.alone = np.isinf(between_std[self.personal])  # independent between people
        with np.errstate(divide="ignore"):
            self.precision = 1 / prior.std[self.free] ** 2
        order = np.lexsort((sums.recording, sums.subject))
        self.segments = _Segments(sums, order, prior, self.fixed)
        self.start_theta = np.repeat(prior.mean[None, self.free], self.n_people, axis=0)
        self.start_variances = _Variances(
            np.ones(len(prior.step_std_m)),
            prior.recording_std**2,
            np.diag(np.where(self.alone, 1.0, between_std[self.personal]) ** 2),
        )
        n_free = len(self.free)
        self.G, self.g = np.zeros((self.n_people, n_free, n_free)), np.zeros((self.n_people, n_free))

    def all_parameters(self, theta: FloatArray) -> FloatArray:
        """Return all P parameters of S people, (S, P), from the F estimated ones (S, F).

        The fixed parameters have their prior mean.
        """
        full = np.repeat(self.prior.mean[None], len(theta), axis=0)
        full[:, self.free] = theta
        return full

    def posterior(self, about: FloatArray, variances: _Variances, information: float, first: bool) -> PeoplePosterior:
        """Return the posterior of the parameters of the population and of all S people, given all segments.

        The equations of a person's segments are linearised at this person's row of `about` (S, F), with the F estimated
        parameters. `variances` are the variances of the last iteration. The noise variances are divided by
        `information`, the information factor of the robust loss (`robust_loss.loss_moments`). The factor is 1 for least
        squares. With the factor, the covariances are valid for an M-estimate with this loss. `first` is True in the
        first iteration: the scale error of a recording then multiplies the known distances, and later the predicted
        ones.
        """
        phi = variances.noise / information
        self.segments.normal_equations(about, phi, variances.recording, first, self.G, self.g)
        W = np.zeros_like(variances.between)
        tied = np.ix_(~self.alone, ~self.alone)
        W[tied] = np.linalg.inv(variances.between[tied])
        return solve_people(self.G, self.g, self.prior.mean[self.free], self.precision, self.personal, W)

    def variances(self, posterior: PeoplePosterior, old: _Variances, ratio: float) -> _Variances:
        """Return the variances that maximise the expected log posterior (M step), from the last variances `old`.

        The noise factor phi of a context becomes phi' = (n + phi sum_i w_i (h_i u_i^2 + 1 - h_i)) / (n + sum_i w_i
        (h_i ratio + 1 - h_i)). n is the weight of its prior (`noise_dof`), in which the factor is one. An infinite
        weight holds the factor. The sums are over the segments i of the context. u_i is the standardised residual of a
        segment (`misfit`) and w_i its robust weight. h_i is the share of the noise e_i in the variance of the residual.
        phi (h_i u_i^2 + 1 - h_i) is the expectation of e_i^2 given all data, relative to its prior variance, if the
        segment is not an outlier. `ratio` is E w u^2 / E w of the loss for standard normal residuals u
        (`robust_loss.loss_moments`).
        """
        prior, n_contexts, own = self.prior, len(self.prior.step_std_m), self.segments
        square, share = own.w * own.misfit**2, own.w * (1 - own.noise_share)
        excess = np.bincount(own.context, own.noise_share * square + share, minlength=n_contexts)
        counts = np.bincount(own.context, own.w * own.noise_share * ratio + share, minlength=n_contexts)
        noise, recording, between = old.noise, old.recording, old.between
        if np.isfinite(prior.noise_dof):
            total = prior.noise_dof + counts
            noise = np.where(total > 0, (prior.noise_dof + noise * excess) / np.where(total > 0, total, 1), 1.0)
        if np.isfinite(prior.recording_dof) and recording > 0:
            recording = (prior.recording_dof * prior.recording_std**2 + own.rho_square) / (
                prior.recording_dof + len(own.kappa)
            )
        if np.isfinite(prior.between_dof) and len(self.personal):
            apart = posterior.people[:, self.personal] - posterior.population[self.personal]
            scatter = apart.T @ apart + posterior.apart_cov.sum(axis=0)
            start = self.start_variances.between
            between = (prior.between_dof * start + scatter) / (prior.between_dof + self.n_people)
            between[self.alone] = between[:, self.alone] = 0.0
            between[self.alone, self.alone] = 1.0
        return _Variances(noise, recording, between)

    def result(
        self, about: FloatArray, posterior: PeoplePosterior, variances: _Variances, n_iterations: int, converged: bool
    ) -> ParameterEstimate:
        """Return the final estimate with all parameters, also the fixed ones, and the predicted lengths."""
        theta, between = posterior.people, variances.between.copy()
        others = np.full_like(theta, np.nan)
        if self.n_people > 1 and not self.alone.any():
            W = np.asarray(np.linalg.inv(between), dtype=float) if len(self.personal) else between
            others = population_without_each(posterior, self.G, self.g, self.personal, W)
        own = self.segments
        place = np.argsort(own.rows)  # index of each segment in the order of people
        predicted = own.length(theta)
        between[self.alone, self.alone] = np.inf
        n = len(self.prior.mean)
        return ParameterEstimate(
            population=self.all_parameters(posterior.population[None])[0],
            population_cov=embedded_cov(n, self.free, posterior.population_cov),
            people=self.all_parameters(theta),
            people_cov=np.array([embedded_cov(n, self.free, cov) for cov in posterior.people_cov]),
            between_cov=embedded_cov(n, self.free[self.personal], between),
            recording_std=float(np.sqrt(variances.recording)),
            noise_factor=variances.noise,
            predicted_m=predicted[place],
            left_out_m=(predicted - own.own_influence(about, posterior))[place],
            stranger_m=own.length(others)[place],
            misfit=own.misfit[place],
            weight=own.w[place],
            n_iterations=n_iterations,
            converged=converged,
        )


def embedded_cov(n: int, index: IntArray, cov: FloatArray) -> FloatArray:
    """Return the covariance (n, n) of all parameters from the covariance of the estimated ones.

    Fixed parameters have zero covariance.
    """
    full = np.zeros((n, n))
    full[np.ix_(index, index)] = cov
    return full


class _Segments:
    """Segments in the order of people and recordings, with the results of an iteration that the next one needs."""

    def __init__(self, sums: SegmentSums, rows: IntArray, prior: Hierarchy, fixed: BoolArray) -> None:
        self.rows = rows
        self.group = _Groups.of(sums.subject[rows], sums.recording[rows])
        self.context, self.distance = sums.context[rows], sums.distance_m[rows]
        self.base_var = sums.anchor_std_m[rows] ** 2 + sums.n_steps[rows] * prior.step_std_m[self.context] ** 2
        if not (self.base_var > 0).all():
            raise ValueError("every segment needs a positive variance: set anchor_std_m or step_std_m above zero")
        self.w = np.ones(len(rows))
        self.error = self.misfit = self.noise_share = self.precision = self.left = self.size = self.kappa = np.empty(0)
        self.a = self.q = np.empty(0)
        self.rho_square = 0.0
        self.set_regressors(sums, prior.mean, fixed)

    def set_regressors(self, sums: SegmentSums, mean: FloatArray, fixed: BoolArray) -> None:
        """Set the regressors (n, 2, F) of the F estimated parameters, and the constant displacements (n, 2).

        The constant part of the displacement of each of n segments comes from the fixed parameters and the
        linearisation.
        """
        regressors = sums.regressors[self.rows]
        self.A = np.ascontiguousarray(regressors[:, :, ~fixed])
        self.offset = sums.offset_m[self.rows] + regressors[:, :, fixed] @ mean[fixed]

    def length(self, theta: FloatArray) -> FloatArray:
        """Return the predicted lengths (n,) for the parameters of all people (S, F)."""
        vector = np.einsum("ndp,np->nd", self.A, theta[self.group.person]) + self.offset
        return np.hypot(vector[:, 0], vector[:, 1])

    def normal_equations(
        self, about: FloatArray, phi: FloatArray, tau2: float, first: bool, G: FloatArray, g: FloatArray
    ) -> None:
        """Write the normal equations of these people into G and g, linearised at their S parameter vectors (S, F).

        For each person, G_s (F, F) is the matrix and g_s (F,) the right-hand side of the weighted least-squares
        problem.
        """
        group = self.group
        self.precision = self.w / (phi[self.context] * self.base_var)
        row, target = _linearised(self.A, self.offset, about[group.person], self.distance)
        # The scale error rho of each recording is integrated out, which is a rank-one correction. It multiplies the
        # predicted length: if it multiplied the known length, theta = 0 and rho = 1 would explain all data.
        self.size = self.distance if first else self.length(about)
        self.a = _sums(row * (self.size * self.precision)[:, None], group.recordings)
        s = _sums(self.size**2 * self.precision, group.recordings)
        self.q = _sums(self.size * target * self.precision, group.recordings)
        self.kappa = tau2 / (1 + tau2 * s)
        G[group.present] = _gram(row, self.precision, group.people)
        G[group.present] -= _gram(self.a, self.kappa, group.recordings_of_people)
        g[group.present] = _sums(row * (target * self.precision)[:, None], group.people)
        g[group.present] -= _sums(self.a * (self.kappa * self.q)[:, None], group.recordings_of_people)

    def compute_residuals(self, about: FloatArray, posterior: PeoplePosterior, phi: FloatArray) -> None:
        """Compute the standardised residuals of all segments with respect to predictions by all other segments.

        The results are attributes. `misfit` is the residual of each segment in standard deviations. `noise_share` is
        the share of the noise of the segment in the variance of the residual, of which the rest is due to the
        prediction. `rho_square` is the expectation of sum_w rho_w^2, with rho_w the scale error of recording w.

        The ordinary residual of a segment is not informative. If a person has one segment, the parameters follow it,
        right or wrong.
        """
        group, theta, cov = self.group, posterior.people, posterior.people_cov[self.group.present]
        row, target = _linearised(self.A, self.offset, about[group.person], self.distance)
        rho = self.kappa * (self.q - np.einsum("wp,wp->w", self.a, theta[group.person_of_recording]))
        self.error = target - np.einsum("np,np->n", row, theta[group.person]) - self.size * rho[group.recording]
        tilted = self._marginal_rows(row)
        spread = _bilinear(tilted, tilted, cov, group.people) + self.size**2 * self.kappa[group.recording]
        self.left = np.maximum(1 - self.precision * spread, 1e-6)  # one minus the leverage of the segment
        noise = phi[self.context] * self.base_var
        variance = noise + spread / self.left
        self.misfit, self.noise_share = self.error / (self.left * np.sqrt(variance)), noise / variance
        rho_variance = self.kappa + self.kappa**2 * _bilinear(self.a, self.a, cov, group.recordings_of_people)
        self.rho_square = float((rho**2 + rho_variance).sum())

    def own_influence(self, about: FloatArray, posterior: PeoplePosterior) -> FloatArray:
        """Return the influence (n,) of each segment on its own prediction, m.

        The prediction without the segment is the prediction minus this influence. It follows from theta without segment
        i = theta - C tilted_i' error_i / (variance_i - tilted_i C tilted_i' - size_i^2 kappa). C is the covariance of
        the parameters theta, tilted_i the derivative of the predicted length by theta (`_marginal_rows`), size_i the
        predicted length, and kappa the variance of the scale error of the recording given its data.
        """
        group = self.group
        row, _ = _linearised(self.A, self.offset, about[group.person], self.distance)
        gain = _bilinear(self._marginal_rows(row), row, posterior.people_cov[group.present], group.people)
        return gain * self.precision / self.left * self.error

    def _marginal_rows(self, row: FloatArray) -> FloatArray:
        """Return the derivatives (n, F) of the predicted lengths by the parameters theta (F,) of the person.

        The prediction is row @ theta + size rho_w. The scale error rho_w of a recording has its estimate given theta,
        kappa (q - a @ theta), so that it also depends on theta.
        """
        return row - (self.size * self.kappa[self.group.recording])[:, None] * self.a[self.group.recording]


def _linearised(
    A: FloatArray, offset: FloatArray, theta: FloatArray, distance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the regression rows (N, F) and targets (N,) of N segments, linearised at the parameters theta (N, F).

    A segment adds up to the vector A theta + offset in m, with A (2, F) the sums of the regressors of its steps. Its
    known length is `distance`. Near theta, the residual distance - |A theta + offset| equals target - row @ theta.
    """
    vector = np.einsum("ndp,np->nd", A, theta) + offset
    size = np.hypot(vector[:, 0], vector[:, 1])
    is_zero = size < 1e-9  # no direction at the start, without prior information: use that of the largest regressor
    if is_zero.any():
        largest = np.einsum("ndp->np", A[is_zero] ** 2).argmax(axis=1)
        vector = vector.copy()
        vector[is_zero] = A[is_zero, :, largest]
        size = np.hypot(vector[:, 0], vector[:, 1])
    along = vector / np.maximum(size, 1e-12)[:, None]
    row = along[:, :1] * A[:, 0] + along[:, 1:] * A[:, 1]
    return row, distance - (along * offset).sum(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Groups:
    """Index arrays of segments sorted by person and recording.

    Starts are the first rows of runs of equal labels, followed by the number of rows.
    """

    person: IntArray  # (n,) person of each segment
    recording: IntArray  # (n,) recording of each segment, numbered in order of appearance
    present: IntArray  # (S',) people with segments
    person_of_recording: IntArray  # (W,) person of each recording
    people: IntArray  # (S' + 1,) starts of the people among the segments
    recordings: IntArray  # (W + 1,) starts of the recordings among the segments
    recordings_of_people: IntArray  # (S' + 1,) starts of the people among the recordings

    @classmethod
    def of(cls, person: IntArray, recording: IntArray) -> _Groups:
        """Return the groups of segments that are sorted by person, then by recording."""
        people, recordings = _starts(person), _starts(person, recording)
        owner = person[recordings[:-1]]
        number = np.repeat(np.arange(len(owner)), np.diff(recordings))
        return cls(person, number, person[people[:-1]], owner, people, recordings, _starts(owner))


def _starts(*labels: IntArray) -> IntArray:
    """Return the first row of each run of equal labels, followed by the number of rows."""
    new = np.any([np.diff(label) != 0 for label in labels], axis=0)
    return np.concatenate([[0], np.flatnonzero(new) + 1, [len(labels[0])]])


def _sums(values: FloatArray, starts: IntArray) -> FloatArray:
    """Return the sum of the rows of each group, one row per group.

    `starts` are the starts of the groups (see `_starts`).
    """
    return np.add.reduceat(values, starts[:-1], axis=0)


def _gram(rows: FloatArray, weight: FloatArray, starts: IntArray) -> FloatArray:
    """Return for each group of rows the sum of weight * outer(row, row), shape (groups, F, F)."""
    weighted = rows * weight[:, None]
    result = np.stack([weighted[a:b].T @ rows[a:b] for a, b in pairwise(starts.tolist())])
    return 0.5 * (result + result.transpose(0, 2, 1))


def _bilinear(left: FloatArray, right: FloatArray, cov: FloatArray, starts: IntArray) -> FloatArray:
    """Return left C right' for each pair of rows, with C the covariance of the row's group in `cov` (groups, F, F)."""
    turned = np.concatenate([left[a:b] @ own for (a, b), own in zip(pairwise(starts.tolist()), cov, strict=True)])
    return np.einsum("np,np->n", turned, right)
