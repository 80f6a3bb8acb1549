"""Calibration of step-length parameters by smoothing: one factor graph over many walks, solved by GTSAM.

The graph has the poses, the step scale and the gyroscope bias of each walk, the step-length parameters of each person,
and those of the population (docs/methods/calibration.md). All observations that the smoother uses calibrate the
parameters, also where no segment has a known length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pdr_filter.filter.imm.motion_model import LOG_SCALE
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.calibration_result import of_height, slices_of
from pdr_filter.filter.step_length.models import StepLengthFit, length_and_jacobian
from pdr_filter.offline.calibration.estimation import PeopleEstimate, embedded_cov
from pdr_filter.offline.calibration.model_forms import hierarchy_of, models_of
from pdr_filter.offline.calibration.priors import StepLengthPrior
from pdr_filter.offline.calibration.segments import Segment
from pdr_filter.offline.late_gtsam import gtsam
from pdr_filter.offline.robust_loss import OUTLIER_STDS
from pdr_filter.offline.smoothing.factor_graph import (
    PersonKeys,
    WalkGraph,
    bayes_tree,
    least_squares_values,
    linear_factor,
    noise_of,
)
from pdr_filter.offline.smoothing.linear_graph import cov_of
from pdr_filter.offline.smoothing.preintegration import MIN_STATE_VAR, Increments, preintegrate
from pdr_filter.offline.smoothing.smooth import Posed, ReckonedWalk
from pdr_filter.offline.smoothing.smoothed import Smoothed
from pdr_filter.offline.smoothing.solve import Solution, solved_from
from pdr_filter.recipes.config import Config
from pdr_filter.values import FloatArray, IntArray, TrackRows, reference_headings, steps_of

# The step lengths are linearised again until no parameter changes by more than this share of its standard deviation.
_CONVERGED_STDS = 0.01
_MAX_ITERATIONS = 10
_MIN_PROB = 1e-3  # a mode with a smaller probability adds less than a millimetre to a step


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationWalk:
    """Walk of a calibration by smoothing, with its person and stretches of known length."""

    subject: str  # name of the person
    height_m: float | None  # body height of the person
    walk: ReckonedWalk  # walk with its observations
    posed: Posed  # problem of the walk alone
    found: Solution  # solution of `posed`
    segments: tuple[Segment, ...] = ()  # stretches of known length that are not positions, such as strides


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointEstimate(PeopleEstimate):
    """Estimated parameters, and the smoothed walks."""

    smoothed: tuple[Smoothed, ...]
    outliers: tuple[list[bool], ...]  # True for each stretch of known length of each walk that was rejected


@dataclass(frozen=True, slots=True, eq=False)
class _ScaleVariances:
    """Covariance (Q, Q) of the people's own parameters, and variance of one person's scale between recordings."""

    between: FloatArray
    recording: float


_POPULATION = int(gtsam.symbol("k", 0))  # key of the parameters of the population


class _FreeParameters:
    """Order of the parameters theta (P,) of all contexts, the F free ones among them, and their keys in the graph."""

    def __init__(self, priors: Mapping[str, StepLengthPrior], recording_std: float, people: Iterable[str]) -> None:
        self.priors = priors
        self.slices, self.n = slices_of(models_of(priors))
        self.prior = hierarchy_of(priors, recording_std, tuple(priors))
        self.mean, std, between = self.prior.mean, self.prior.std, self.prior.between_std
        if not (np.isfinite(std).all() and np.isfinite(between).all()):
            raise ValueError(
                "a calibration by smoothing needs finite std and between_std of all priors, got inf: give finite ones, "
                "or calibrate without smooth"
            )
        if not std.any():
            raise ValueError(
                "nothing to calibrate: the standard deviations of all step-length parameters are 0; give a prior with "
                "a positive std, or name a model of walking (model, --model)"
            )
        self.free: IntArray = np.flatnonzero(std > 0)
        self.std, self.between_std = std[self.free], between[self.free]
        self.personal: IntArray = np.flatnonzero(self.between_std > 0)
        names = dict.fromkeys(people)
        self.keys = {name: PersonKeys(_POPULATION, gtsam.symbol("p", s), self.personal) for s, name in enumerate(names)}

    def all(self, free: FloatArray) -> FloatArray:
        """Return all parameters (P,) from the free ones (F,)."""
        theta = self.mean.copy()
        theta[self.free] = free
        return theta

    def all_cov(self, cov: FloatArray) -> FloatArray:
        """Return the covariance (P, P) of all parameters from that of the free ones (F, F)."""
        return embedded_cov(self.n, self.free, cov)

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        between_cov: FloatArray,
        population: FloatArray,
        theta: Mapping[str, FloatArray],
    ) -> None:
        """Add the parameters of the population and of the people, with their priors."""
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(self.std)
        graph.push_back(gtsam.PriorFactorVector(_POPULATION, self.mean[self.free], sigmas))
        values.insert(_POPULATION, population)
        if not len(self.personal):
            return
        own = np.asarray(np.linalg.inv(np.linalg.cholesky(between_cov)), dtype=float)
        of_population = np.zeros((len(self.personal), len(self.free)))
        of_population[:, self.personal] = -own
        for name, of_one in self.keys.items():
            graph.push_back(linear_factor(_POPULATION, of_population, of_one.person, own))
            values.insert(of_one.person, theta[name][self.personal])

    def scatter(self, values: gtsam.Values, tree: Any) -> FloatArray:
        """Return the expected sum (Q, Q) of squared differences between people and the population."""
        personal = self.personal
        scatter = np.zeros((len(personal), len(personal)))
        by_keys = np.hstack([-np.eye(len(self.free))[personal], np.eye(len(personal))])
        for keys in self.keys.values() if len(personal) else ():
            apart = (keys.theta(values) - values.atVector(_POPULATION))[personal]
            scatter += np.outer(apart, apart) + by_keys @ cov_of(tree, keys.keys) @ by_keys.T
        return scatter

    def people_cov(self, tree: Any) -> FloatArray:
        """Return the covariances (S, P, P) of the parameters of all people."""
        # theta = by_keys @ [population, own], with the person's own parameters
        n_free, n_own = len(self.free), len(self.personal)
        by_keys = np.eye(n_free, n_free + n_own)
        by_keys[self.personal, self.personal] = 0.0
        by_keys[self.personal, n_free + np.arange(n_own)] = 1.0
        return np.array([self.all_cov(by_keys @ cov_of(tree, k.keys) @ by_keys.T) for k in self.keys.values()])


def mode_names(model: PedestrianModel, separate: Mapping[str, str]) -> list[str]:
    """Return the name of the step length of each mode: its own, if it is calibrated separately, or its context."""
    return [m.name if m.name in separate else m.context for m in model.modes]


def with_parameters(
    config: Config,
    priors: Mapping[str, StepLengthPrior],
    theta: Mapping[str, FloatArray],
    names: Sequence[str],
    height_m: float | None,
    log_scale_std: float,
) -> Config:
    """Return a configuration whose modes have the step lengths of a calibration, with known parameters `theta`."""
    fits = {
        name: StepLengthFit(of_height(p.model, height_m), theta[name], np.zeros((p.model.n_params,) * 2), p.step_std_m)
        for name, p in priors.items()
    }
    modes = tuple(
        replace(mode, step_length=fits.get(name, mode.step_length))
        for mode, name in zip(config.model.modes, names, strict=True)
    )
    return config.with_model(modes=modes, noise=replace(config.model.noise, log_scale_std=log_scale_std))


def displacement_by_theta(
    track: TrackRows,
    model: PedestrianModel,
    names: Sequence[str],
    slices: Mapping[str, slice],
    n_params: int,
    *,
    is_weighted: bool,
) -> FloatArray:
    """Return the derivative (K, 2, P) of the displacement of each step by the step-length parameters theta (P,).

    It belongs to the displacements of `preintegration.increments`, sum_m mu_m L_m(theta) u(psi + o_m). `names` has the
    name of the parameters of each mode in `slices`.
    """
    prob, offset_rad = track.mode_prob, model.directions.heading_offset_rad
    by_theta = np.zeros((track.n_steps, 2, n_params))
    psi = reference_headings(track.steps)[:, None] + offset_rad
    if is_weighted:
        psi = np.broadcast_to(psi[np.arange(len(psi)), prob.argmax(axis=1)][:, None], psi.shape)
    along = np.stack([np.sin(psi), np.cos(psi)], axis=-1)
    each = steps_of(track.steps)
    for m, (mode, name) in enumerate(zip(model.modes, names, strict=True)):
        if not mode.moves or name not in slices:
            continue
        fit, part = mode.step_length, slices[name]
        for k in np.flatnonzero(prob[:, m] > _MIN_PROB).tolist():
            length_m, jacobian = length_and_jacobian(fit.model, each[k], fit.theta)
            if length_m > 0:  # a negative length counts as zero
                by_theta[k, :, part] += prob[k, m] * along[k, m][:, None] * jacobian
    return by_theta


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """Walk at the parameters of its person: increments, factors, and those of stretches of known length."""

    steps: Increments
    graph: WalkGraph
    lengths: list[gtsam.CustomFactor]

    def add_to(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        guess: Solution,
        wrong: Sequence[bool],
        loss: str,
    ) -> None:
        """Add the factors of the walk, and its unknowns with the values of a guess. `wrong` lengths are left out."""
        self.graph.add_to(graph, guess.weight if loss == "gnc" else self.graph.problem.possible, loss)
        self.graph.insert_into(values, guess)
        for factor, is_wrong in zip(self.lengths, wrong, strict=True):
            if not is_wrong:
                graph.push_back(factor)


def estimate_jointly(
    walks: Sequence[CalibrationWalk],
    priors: Mapping[str, StepLengthPrior],
    separate: Mapping[str, str],
    recording_std: float,
    loss: str = "gnc",
    progress: Callable[[float], None] | None = None,
) -> JointEstimate:
    """Return the parameters and the smoothed walks that maximise the posterior of all walks together.

    The prior is that of a calibration from segments: theta_s of each person about the population, the population about
    the mean of the priors, and a scale of each recording. The variances between people and between recordings are
    estimated by expectation-maximisation (`estimation.estimate_parameters`), the noise of the steps is that of the
    priors. Step lengths and noise are linearised at the parameters of the last iteration.
    """
    parameters = _FreeParameters(priors, recording_std, (w.subject for w in walks))
    prior, keys = parameters.prior, parameters.keys
    population = parameters.mean[parameters.free]
    theta = dict.fromkeys(keys, population)
    variances = start = _ScaleVariances(np.diag(parameters.between_std[parameters.personal] ** 2), recording_std**2)
    guesses = [w.found for w in walks]
    outliers = [[False] * len(w.segments) for w in walks]
    iteration, converged, is_tested = 0, False, loss != "gnc"
    linearised, values = list[_Linearised](), gtsam.Values()
    tree: Any = None
    while iteration < _MAX_ITERATIONS and not converged:
        iteration += 1
        # wrong lengths have little weight before they are found
        of_lengths = "huber" if loss == "gnc" and iteration == 1 else loss
        options = separate, variances.recording**0.5, of_lengths
        linearised = [
            _linearised(w, i, parameters, theta[w.subject], keys[w.subject], *options) for i, w in enumerate(walks)
        ]
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        parameters.add_to(graph, values, variances.between, population, theta)
        for of_one, guess, wrong in zip(linearised, guesses, outliers, strict=True):
            of_one.add_to(graph, values, guess, wrong, loss)
        values = least_squares_values(graph, values)
        before, theta = theta, {name: of_one.theta(values) for name, of_one in keys.items()}
        population = values.atVector(_POPULATION)
        guesses = [of_one.graph.states_of(values, guess) for of_one, guess in zip(linearised, guesses, strict=True)]
        moved = [np.abs(theta[name] - before[name]) / parameters.std for name in keys]
        tree = bayes_tree(graph, values)
        before_outliers = outliers
        if loss == "gnc":
            of_each = zip(linearised, before_outliers, strict=True)
            outliers = [_outliers(of_one.lengths, wrong, values, tree) for of_one, wrong in of_each]
        converged = float(np.max(moved, initial=0.0)) < _CONVERGED_STDS and outliers == before_outliers
        if converged and not is_tested:
            # outliers were found with the step lengths of each walk alone
            tested = [
                solved_from(of_one.graph.problem, guess.states, guess.frame_rad, guess.weight)
                for of_one, guess in zip(linearised, guesses, strict=True)
            ]
            converged = all(np.array_equal(a.weight, b.weight) for a, b in zip(tested, guesses, strict=True))
            guesses, is_tested = tested, True
        if not converged:
            scatter = parameters.scatter(values, tree)
            square = sum(_scale_square(values, tree, of_one.graph) for of_one in linearised)
            variances = _ScaleVariances(
                (prior.between_dof * start.between + scatter) / (prior.between_dof + len(keys)),
                (prior.recording_dof * start.recording + square) / (prior.recording_dof + len(walks)),
            )
        if progress is not None:
            progress(iteration / _MAX_ITERATIONS)
    between_cov = embedded_cov(len(parameters.free), parameters.personal, variances.between)
    smoothed = [
        _smoothed(w, of_one, of_one.graph.solution(values, tree, guess))
        for w, of_one, guess in zip(walks, linearised, guesses, strict=True)
    ]
    return JointEstimate(
        population=parameters.all(population),
        population_cov=parameters.all_cov(cov_of(tree, [_POPULATION])),
        people=np.array([parameters.all(theta[name]) for name in keys]),
        people_cov=parameters.people_cov(tree),
        smoothed=tuple(smoothed),
        between_cov=parameters.all_cov(between_cov),
        recording_std=variances.recording**0.5,
        outliers=tuple(outliers),
        n_iterations=iteration,
        converged=converged,
    )


def _smoothed(of: CalibrationWalk, linearised: _Linearised, found: Solution) -> Smoothed:
    """Return the smoothed walk for a solution, whose covariances include those of the step-length parameters."""
    known = np.zeros_like(of.posed.parameter_error_m)
    posed = Posed(linearised.steps, known, of.posed.used, linearised.graph.problem)
    return of.walk.on_earth(of.walk.result(posed, found)[0])


def _scale_square(values: gtsam.Values, tree: Any, of: WalkGraph) -> float:
    """Return the expected square of the log scale of a recording."""
    key = of.scale(0)
    return float(values.atVector(key)[0] ** 2 + cov_of(tree, [key])[0, 0])


def _linearised(
    of: CalibrationWalk,
    number: int,
    parameters: _FreeParameters,
    theta: FloatArray,
    keys: PersonKeys,
    separate: Mapping[str, str],
    recording_std: float,
    loss: str,
) -> _Linearised:
    """Return a walk at the free parameters theta (F,) of its person. `loss` is that of known lengths."""
    walk, model = of.walk, of.walk.config.model
    names, full = mode_names(model, separate), parameters.all(theta)
    by_name = {name: full[part] for name, part in parameters.slices.items()}
    config = with_parameters(walk.config, parameters.priors, by_name, names, of.height_m, recording_std)
    walk = replace(walk, config=config)
    with_bias, _ = walk.increments()
    unbiased = walk.track.steps.copy()
    unbiased["yaw_bias_std_radps"] = 0.0
    steps, _ = replace(walk, track=replace(walk.track, steps=unbiased)).increments()
    problem = of.posed.problem
    start_s = float(steps.time_s[0] - steps.duration_s[0])
    lasts_s = max(float(steps.time_s[-1]) - start_s, 1.0)
    bias_var = float((with_bias.drift_var_rad2 - steps.drift_var_rad2).sum())
    start_cov = problem.start_cov.copy()
    start_cov[LOG_SCALE, LOG_SCALE] = recording_std**2 + MIN_STATE_VAR
    by_theta = displacement_by_theta(
        walk.track, config.model, names, parameters.slices, parameters.n, is_weighted=walk.track.weighting != "imm"
    )
    nodes = problem.intervals.nodes
    device_rad = of.posed.used.device_rad[np.maximum(nodes - 1, 0)]
    graph = WalkGraph(
        problem=replace(problem, intervals=preintegrate(steps, nodes), start_cov=start_cov),
        device_rad=device_rad,
        time_s=steps.time_s,
        start_s=start_s,
        # a constant rate whose effect at the end has the variance of the random walk that stands for the bias
        rate_std_radps=float(np.sqrt(max(bias_var, 0.0))) / lasts_s,
        by_theta=np.ascontiguousarray(by_theta[:, :, parameters.free]),
        about=theta,
        person=keys,
        number=number,
    )
    lengths = [_length_factor(segment, graph, keys, parameters, theta, loss) for segment in of.segments]
    return _Linearised(steps, graph, lengths)


def _length_factor(
    segment: Segment, of: WalkGraph, person: PersonKeys, parameters: _FreeParameters, theta: FloatArray, loss: str
) -> gtsam.CustomFactor:
    """Return the factor of a stretch of known length: |sum of its steps| e^s is the length, as in `SegmentSums`."""
    full = parameters.all(theta)
    by_all, constant = np.zeros((2, parameters.n)), np.zeros(2)
    for name, part in parameters.slices.items():
        by_all[:, part], rest = segment.sums(name, parameters.priors[name].model, full[part])
        constant += rest
    way_m, by_free = constant + by_all @ full, by_all[:, parameters.free]
    own = parameters.priors.get(segment.context_names[int(segment.steps_in.argmax())])
    step_std_m = 0.0 if own is None else own.step_std_m
    inverse = 1 / np.sqrt(segment.anchor_std_m**2 + segment.n_steps * step_std_m**2)
    nodes = of.problem.intervals.nodes
    node = int(np.searchsorted(nodes, np.searchsorted(of.time_s, segment.start_s), side="right") - 1)
    about = theta
    keys = [of.scale(min(node, len(nodes) - 1)), *person.keys]

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        vector = way_m + by_free @ (person.theta(values) - about)
        scale = np.exp(values.atVector(keys[0])[0])
        length_m = float(np.hypot(*vector))
        if jacobians is not None:
            jacobians[0] = np.array([[inverse * scale * length_m]])
            by_theta = inverse * scale * (vector / max(length_m, 1e-9)) @ by_free
            for i, H in enumerate(person.split(by_theta[None]), start=1):
                jacobians[i] = H
        return np.array([inverse * (scale * length_m - segment.distance_m)])

    return gtsam.CustomFactor(noise_of(1, loss), keys, error)


def _outliers(
    factors: Sequence[gtsam.CustomFactor], was_wrong: Sequence[bool], values: gtsam.Values, tree: Any
) -> list[bool]:
    """Return True for each known length that everything else contradicts. `was_wrong` are those left out so far."""
    errors = (_held_out_error(f, values, tree, is_used=not w) for f, w in zip(factors, was_wrong, strict=True))
    return [abs(error) > OUTLIER_STDS for error in errors]


def _held_out_error(factor: gtsam.CustomFactor, values: gtsam.Values, tree: Any, *, is_used: bool) -> float:
    """Return the error of a known length predicted by everything else, in its standard deviations.

    The residual would be too small, because the length itself moves the parameters.
    """
    residual = float(factor.unwhitenedError(values)[0])
    H, scaled = factor.linearize(values).jacobian()
    weight = (float(scaled[0]) / residual) ** 2 if residual else 1.0  # weight of the robust loss
    leverage = float((H @ cov_of(tree, list(factor.keys())) @ H.T)[0, 0])  # leverage times weight
    left = max(1.0 - leverage, 1e-9) if is_used else 1.0
    return residual / left / float(np.sqrt(1.0 + leverage / weight / left))
