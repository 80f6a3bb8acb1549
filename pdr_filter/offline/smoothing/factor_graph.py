"""Nonlinear factor graph of walks for the optimisers of GTSAM, with step-length parameters and gyroscope bias.

The steps between two anchors are preintegrated. Their displacement in the frame of the first anchor is a linear
function of the step-length parameters, so that each interval is a single factor, whatever its number of steps:

    R(o_a)' (p_b - p_a) = sum_i e^(c_i s_a) R(r t_i) (d_i + J_i (theta - theta_0)) + noise,
    o_b = o_a + r t + noise,  s_b = c s_a + noise.

p is the position, o the heading offset and s the log step scale at an anchor, r the rate at which a bias of the
gyroscope turns the walk, t_i the time of step i since the anchor, and c_i the decay of s. Step i has the displacement
d_i at the parameters theta_0, with the derivative J_i. The noise is that of `preintegration.Intervals`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.offline.late_gtsam import gtsam
from pdr_filter.offline.smoothing.linear_graph import cov_of
from pdr_filter.offline.smoothing.location_errors import N_ERRORS, NO_ERRORS, Errors
from pdr_filter.offline.smoothing.preintegration import TURN, scaled_rotation
from pdr_filter.offline.smoothing.problem import Problem
from pdr_filter.offline.smoothing.solve import (
    Solution,
    direction_residuals,
    measurement_residuals,
    position_residuals,
    state_residuals,
)
from pdr_filter.values import FloatArray, IntArray, read_only, wrap_angle

# Walks with up to a million contacts have distinct keys.
_MOST_CONTACTS = 1_000_000
_OWN_LETTERS = "b, e, f, s, x"  # letters of the keys of `WalkGraph`
# Smallest standard deviation of the turning rate of a gyroscope bias, 0.002 degrees in a minute.
_MIN_RATE_RADPS = 1e-6
_FIRST = np.zeros(1, dtype=np.int64)  # index of the first anchor of a factor


@dataclass(frozen=True, slots=True, eq=False)
class PersonKeys:
    """Keys of the step-length parameters of one person.

    theta (F,) is the vector of the population, in which the person's own parameters replace the entries `personal`.
    """

    population: int  # key of the population's parameters (F,)
    person: int  # key of the person's own parameters (Q,), if there are any
    personal: IntArray  # (Q,) indices of the person's own parameters

    @property
    def keys(self) -> list[int]:
        """Keys of the parameters."""
        return [self.population, self.person] if len(self.personal) else [self.population]

    def theta(self, values: gtsam.Values) -> FloatArray:
        """Return the parameters (F,) of the person."""
        return self.joined([values.atVector(key) for key in self.keys])

    def joined(self, vectors: Sequence[FloatArray]) -> FloatArray:
        """Return the parameters (F,) of the person from the vectors of the `keys`."""
        theta = vectors[0].copy()
        if len(self.personal):
            theta[self.personal] = vectors[1]
        return theta

    def split(self, by_theta: FloatArray) -> list[FloatArray]:
        """Return the derivatives by each of the `keys` from the derivative (m, F) by theta."""
        if not len(self.personal):
            return [by_theta]
        by_population = by_theta.copy()
        by_population[:, self.personal] = 0.0
        return [by_population, by_theta[:, self.personal]]


@dataclass(frozen=True, slots=True, eq=False)
class WalkGraph:
    """Factors of one walk, and the keys of its unknowns."""

    # steps between anchors, priors and observations of the walk. Its intervals exclude the random walk of the heading
    # that stands for the gyroscope bias if `rate_std_radps` is positive.
    problem: Problem
    device_rad: FloatArray  # (n + 1,) walking heading at each anchor minus the heading offset
    time_s: FloatArray  # (K,) times of the contacts
    start_s: float  # time at the first anchor
    rate_std_radps: float = 0.0  # prior standard deviation of the turning rate that a gyroscope bias causes, 0 for none
    # (K, 2, F) derivative of the displacement of each step by the parameters of the person, empty for fixed step
    # lengths
    by_theta: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 0)))
    # (F,) parameters at which the displacements in `problem` were computed
    about: FloatArray = field(default_factory=lambda: np.zeros(0))
    person: PersonKeys | None = None  # keys of the parameters, None for walks with fixed step lengths
    number: int = 0  # number of the walk in the graph

    def _key(self, letter: str, index: int) -> int:
        return int(gtsam.symbol(letter, self.number * _MOST_CONTACTS + index))

    def pose(self, node: int) -> int:
        """Key of the pose (`gtsam.Pose2`) at an anchor, with the walking heading counter-clockwise from east.

        The symbol is x with the number of steps before the anchor.
        """
        return self._key("x", int(self.problem.intervals.nodes[node]))

    def scale(self, node: int) -> int:
        """Key of the log step scale (1,) at an anchor. The symbol is s with the number of steps before the anchor."""
        return self._key("s", int(self.problem.intervals.nodes[node]))

    @property
    def rate(self) -> int:
        """Key of the turning rate (1,) in rad/s, clockwise, which a gyroscope bias causes."""
        return self._key("b", 0)

    @property
    def frame(self) -> int:
        """Key of the rotation (1,) from the frame of the heading offsets to that of the positions, in rad."""
        return self._key("f", 0)

    def error(self, number: int) -> int:
        """Key of the errors (6,) of a correlated fix."""
        return self._key("e", number)

    # --- states ---

    def state(self, values: gtsam.Values, node: int) -> FloatArray:
        """Return the state (4,) at an anchor: east, north, heading offset and log scale."""
        pose = values.atPose2(self.pose(node))
        offset_rad = 0.5 * np.pi - self.device_rad[node] - pose.theta()
        return np.array([pose.x(), pose.y(), offset_rad, values.atVector(self.scale(node))[0]])

    def insert_into(self, values: gtsam.Values, found: Solution) -> None:
        """Insert the unknowns of the walk with the values of a `Solution` and a gyroscope without bias."""
        n = self.problem.n_nodes
        for j, state in enumerate(found.mean):
            theta = 0.5 * np.pi - self.device_rad[j] - state[HEADING_OFFSET]
            values.insert(self.pose(j), gtsam.Pose2(state[0], state[1], theta))
            values.insert(self.scale(j), state[LOG_SCALE:])
        for k, error in enumerate(found.states[n:]):
            values.insert(self.error(k), error)
        if len(self.problem.offsets):
            values.insert(self.frame, np.array([found.frame_rad]))
        if self.rate_std_radps:
            values.insert(self.rate, np.zeros(1))

    def states_of(self, values: gtsam.Values, guess: Solution) -> Solution:
        """Return the optimised states. Everything else is that of `guess`."""
        n = self.problem.n_nodes
        mean = np.array([self.state(values, j) for j in range(n)])
        before = guess.mean[:, HEADING_OFFSET]
        mean[:, HEADING_OFFSET] = before + wrap_angle(mean[:, HEADING_OFFSET] - before)
        states = np.zeros((self.problem.n_states, N_ERRORS))
        states[:n, :N_STATES] = mean
        for k in range(len(self.problem.errors)):
            states[n + k] = values.atVector(self.error(k))
        frame_rad = float(values.atVector(self.frame)[0]) if len(self.problem.offsets) else 0.0
        return replace(guess, mean=mean, frame_rad=frame_rad, states=states)

    def solution(self, values: gtsam.Values, tree: gtsam.GaussianBayesTree, guess: Solution) -> Solution:
        """Return the optimised states with the covariances of the Bayes tree of the linearised graph.

        Weights and innovations of the observations are those of `guess`.
        """
        n = self.problem.n_nodes
        T = np.zeros((n, N_STATES, N_STATES))  # from the tangent space of the pose, and the scale, to the state
        for j in range(n):
            T[j, :2, :2] = values.atPose2(self.pose(j)).rotation().matrix()
            T[j, HEADING_OFFSET, HEADING_OFFSET], T[j, LOG_SCALE, LOG_SCALE] = -1.0, 1.0
        joint_cov = np.empty((n - 1, 2 * N_STATES, 2 * N_STATES))
        for j in range(n - 1):
            both = np.zeros((2 * N_STATES, 2 * N_STATES))
            both[:N_STATES, :N_STATES], both[N_STATES:, N_STATES:] = T[j], T[j + 1]
            cov = cov_of(tree, [self.pose(j), self.scale(j), self.pose(j + 1), self.scale(j + 1)])
            joint_cov[j] = both @ cov @ both.T
        return replace(self.states_of(values, guess), joint_cov=joint_cov)

    # --- factors ---

    def add_to(self, graph: gtsam.NonlinearFactorGraph, weight: FloatArray, loss: str = "none") -> None:
        """Add the factors of the walk to a graph: priors, steps between anchors, and observations of non-zero weight.

        `weight` (F + H + S + X,) is in the order of `Solution.weight`. `loss` is the robust loss of the observations.
        """
        problem, factors = self.problem, list[gtsam.NonlinearFactor]()
        factors.append(self._start())
        factors += [self._interval(j) for j in range(len(problem.intervals))]
        if self.rate_std_radps:
            sigma = gtsam.noiseModel.Isotropic.Sigma(1, max(self.rate_std_radps, _MIN_RATE_RADPS))
            factors.append(gtsam.PriorFactorVector(self.rate, np.zeros(1), sigma))
        factors += self._errors()
        if len(problem.offsets):
            sigma = gtsam.noiseModel.Isotropic.Sigma(1, problem.frame_std_rad)
            factors.append(gtsam.PriorFactorVector(self.frame, np.zeros(1), sigma))
            factors += [self._offset(i) for i in range(len(problem.offsets))]
        of_observations = self._position, self._direction, self._state, self._measurement
        for factor_of, weights in zip(of_observations, problem.split(weight), strict=True):
            factors += [factor_of(i, loss) for i in np.flatnonzero(weights > 0).tolist()]
        for factor in factors:
            graph.push_back(factor)

    def _of_states(
        self,
        size: int,
        nodes: Sequence[int],
        function: Callable[[FloatArray, list[FloatArray]], tuple[FloatArray, list[FloatArray]]],
        others: Sequence[int] = (),
        loss: str = "none",
    ) -> gtsam.CustomFactor:
        """Return a factor with whitened residuals (size,) that depend on the states at anchors and on other vectors.

        `function` takes the states (N, 4) and the vectors with the keys `others`. It returns the residuals and their
        derivatives by each state (size, 4) and by each vector.
        """
        keys = [key for node in nodes for key in (self.pose(node), self.scale(node))]

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
            states = np.array([self.state(values, node) for node in nodes])
            residual, derivatives = function(states, [values.atVector(key) for key in others])
            if jacobians is not None:
                for i, node in enumerate(nodes):
                    H = derivatives[i]
                    by_position = H[:, :2] @ values.atPose2(self.pose(node)).rotation().matrix()
                    jacobians[2 * i] = np.column_stack([by_position, -H[:, HEADING_OFFSET]])
                    jacobians[2 * i + 1] = H[:, LOG_SCALE:]
                for i, by_vector in enumerate(derivatives[len(nodes) :], start=len(keys)):
                    jacobians[i] = by_vector
            return residual

        return gtsam.CustomFactor(noise_of(size, loss), [*keys, *others], error)

    def _start(self) -> gtsam.CustomFactor:
        """Return the prior of the first state."""
        whiten = read_only(np.linalg.inv(np.linalg.cholesky(self.problem.start_cov)))
        start = self.problem.start_mean

        def function(states: FloatArray, _: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            difference = states[0] - start
            difference[HEADING_OFFSET] = wrap_angle(difference[HEADING_OFFSET])
            return whiten @ difference, [whiten]

        return self._of_states(N_STATES, [0], function)

    def _interval(self, j: int) -> gtsam.CustomFactor:
        """Return the factor of the steps between the anchors j and j + 1 (see the docstring of the module)."""
        intervals = self.problem.intervals
        first, end = intervals.nodes[j], intervals.nodes[j + 1]
        whiten, total_decay = intervals.whiten[j], float(intervals.total_decay[j])
        step_m, decay = intervals.step_m[first:end], intervals.decay[first:end]
        # a step without a measured heading has a fixed length (`preintegration.increments`)
        is_measured = intervals.is_measured[first:end].astype(float)
        by_theta = self.by_theta[first:end]
        by_theta = by_theta * is_measured[: len(by_theta), None, None]
        since_s = self.time_s[first:end] - (self.time_s[first - 1] if first else self.start_s)
        lasts_s, with_rate, person, about = float(since_s[-1]), self.rate_std_radps > 0, self.person, self.about
        n_theta = by_theta.shape[-1]
        others = [self.rate] if with_rate else []

        def function(states: FloatArray, vectors: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            (a, b), rate = states, float(vectors[0][0]) if with_rate else 0.0
            moved_m = step_m
            if person is not None:
                moved_m = step_m + by_theta @ (person.joined(vectors[len(others) :]) - about)
            rotation = scaled_rotation(rate * since_s, decay * is_measured * a[LOG_SCALE])
            each_m = np.einsum("kab,kb->ka", rotation, moved_m)
            back = scaled_rotation(a[HEADING_OFFSET], np.zeros(())).T
            way_m = back @ (b[:2] - a[:2])
            turned = wrap_angle(b[HEADING_OFFSET] - a[HEADING_OFFSET] - rate * lasts_s)
            residual = np.array([*(way_m - each_m.sum(axis=0)), turned, b[LOG_SCALE] - total_decay * a[LOG_SCALE]])
            by_a, by_b = np.zeros((2, N_STATES, N_STATES))
            by_b[:2, :2], by_a[:2, :2] = back, -back
            by_a[:2, HEADING_OFFSET] = TURN.T @ way_m
            by_a[:2, LOG_SCALE] = -(decay * is_measured) @ each_m
            by_a[HEADING_OFFSET, HEADING_OFFSET], by_b[HEADING_OFFSET, HEADING_OFFSET] = -1.0, 1.0
            by_a[LOG_SCALE, LOG_SCALE], by_b[LOG_SCALE, LOG_SCALE] = -total_decay, 1.0
            derivatives = [whiten @ by_a, whiten @ by_b]
            if with_rate:
                by_rate = np.array([*(-TURN @ (since_s @ each_m)), -lasts_s, 0.0])
                derivatives.append((whiten @ by_rate)[:, None])
            if person is not None:
                H = np.zeros((N_STATES, n_theta))
                H[:2] = -np.einsum("kab,kbp->ap", rotation, by_theta)
                derivatives += person.split(whiten @ H)
            return whiten @ residual, derivatives

        return self._of_states(N_STATES, [j, j + 1], function, [*others, *(person.keys if person else ())])

    def _errors(self) -> list[gtsam.NonlinearFactor]:
        """Return the factors of the errors of correlated fixes, a Gauss-Markov process (`solve`)."""
        factors, decay = list[gtsam.NonlinearFactor](), self.problem.errors.decay
        if not len(self.problem.errors):
            return factors
        factors.append(gtsam.PriorFactorVector(self.error(0), np.zeros(N_ERRORS), noise_of(N_ERRORS)))
        for k, of_one in enumerate(decay):
            inverse = 1 / np.sqrt(1 - of_one**2)
            factors.append(
                linear_factor(self.error(k), -np.diag(inverse * of_one), self.error(k + 1), np.diag(inverse))
            )
        return factors

    def _offset(self, i: int) -> gtsam.CustomFactor:
        """Return the factor of a heading offset that the strides measured."""
        offsets = self.problem.offsets
        offset_rad, inverse = float(offsets.offset_rad[i]), 1 / float(offsets.std_rad[i])
        by_state = np.zeros((1, N_STATES))
        by_state[0, HEADING_OFFSET] = inverse

        def function(states: FloatArray, vectors: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            turned = wrap_angle(states[:1, HEADING_OFFSET] - vectors[0] - offset_rad)
            return np.asarray(turned * inverse), [by_state, np.array([[-inverse]])]

        return self._of_states(1, [int(offsets.node[i])], function, [self.frame])

    def _position(self, i: int, loss: str) -> gtsam.CustomFactor:
        """Return the factor of a position fix, a location or a loop closure."""
        one, errors = self.problem.positions.part(slice(i, i + 1)), self.problem.errors
        is_closure = bool(one.other[0] >= 0)
        nodes = [int(one.node[0]), *([int(one.other[0])] if is_closure and one.other[0] != one.node[0] else [])]
        one = replace(one, node=_FIRST, other=np.full(1, len(nodes) - 1 if is_closure else -1))
        (of_error,) = np.flatnonzero(errors.position == i).tolist()[:1] or (None,)
        own = NO_ERRORS
        others: list[int] = []
        if of_error is not None:
            own = Errors(_FIRST, _FIRST, errors.by[[of_error]], errors.decay[:0])
            others = [self.error(of_error)]
        by_error = [one.whiten[0] @ own.by[0]] if others else []

        def function(states: FloatArray, vectors: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            residual, by_node, by_other = position_residuals(one, own, states, np.array(vectors).reshape(-1, N_ERRORS))
            of_states = [by_node[0], *([by_other[0]] if is_closure else [])]
            of_states = of_states if len(of_states) == len(nodes) else [by_node[0] + by_other[0]]
            return residual[0], [*of_states, *by_error]

        return self._of_states(2, nodes, function, others, loss)

    def _direction(self, i: int, loss: str) -> gtsam.CustomFactor:
        """Return the factor of a known direction between two anchors."""
        one = self.problem.directions.part(slice(i, i + 1))
        nodes, one = [int(one.first[0]), int(one.last[0])], replace(one, first=_FIRST, last=_FIRST + 1)

        def function(states: FloatArray, _: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            residual, by_last = direction_residuals(one, states)
            return residual[0], [-by_last[0], by_last[0]]

        return self._of_states(1, nodes, function, loss=loss)

    def _state(self, i: int, loss: str) -> gtsam.CustomFactor:
        """Return the factor of a heading fix, a speed fix, or magnetic north."""
        one = self.problem.states.part(slice(i, i + 1))
        node, one = int(one.node[0]), replace(one, node=_FIRST)

        def function(states: FloatArray, _: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            residual, by_state = state_residuals(one, states)
            return residual[0], [by_state[0]]

        return self._of_states(1, [node], function, loss=loss)

    def _measurement(self, i: int, loss: str) -> gtsam.CustomFactor:
        """Return the factor of any other measurement, such as a range."""
        one = self.problem.measurements.part(slice(i, i + 1))
        node, one = int(one.node[0]), replace(one, node=_FIRST)
        size = len(measurement_residuals(one, np.array([[*one.guess_m[0], 0.0, 0.0]]))[0][0])

        def function(states: FloatArray, _: list[FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
            ((residual, by_state),) = measurement_residuals(one, states)
            return residual, [by_state]

        return self._of_states(size, [node], function, loss=loss)


# Robust losses of GTSAM by their names in `robust_loss`, with its tuning constants, which are those of GTSAM.
_LOSSES: dict[str, Callable[[], Any]] = {
    "huber": lambda: gtsam.noiseModel.mEstimator.Huber.Create(1.345),
    "cauchy": lambda: gtsam.noiseModel.mEstimator.Cauchy.Create(2.385),
}


def noise_of(size: int, loss: str = "none") -> Any:
    """Return the noise model of whitened residuals (size,), with a robust loss "huber" or "cauchy"."""
    unit = gtsam.noiseModel.Unit.Create(size)
    return gtsam.noiseModel.Robust.Create(_LOSSES[loss](), unit) if loss in _LOSSES else unit


def linear_factor(first: int, A: FloatArray, second: int, B: FloatArray) -> gtsam.NonlinearFactor:
    """Return the factor of the equations A x + B y = 0 with unit noise, for vectors with two keys."""
    zero = gtsam.Values()
    zero.insert(first, np.zeros(A.shape[1]))
    zero.insert(second, np.zeros(B.shape[1]))
    linear = gtsam.JacobianFactor(first, A, second, B, np.zeros(len(A)), gtsam.noiseModel.Unit.Create(len(A)))
    return gtsam.LinearContainerFactor(linear, zero)


def least_squares_values(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    """Return the values that minimise the error of a graph, by Levenberg-Marquardt with QR factorisation.

    A Cholesky factorisation takes the prior of a start in an unknown region for no information at all.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def bayes_tree(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.GaussianBayesTree:
    """Return the Bayes tree of the graph linearised at values, from which `linear_graph.cov_of` takes covariances."""
    linear = graph.linearize(values)
    return linear.eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)


@dataclass(frozen=True, slots=True, eq=False)
class PoseKeys:
    """Keys of the poses of a walk, for factors of the user.

    The pose at a foot contact is a `gtsam.Pose2` with the key `gtsam.symbol("x", n)`, where n is the number of steps
    before the contact: 0 is the start of the walk. Its angle is the walking heading, counter-clockwise from east. Other
    letters than b, e, f, s and x are free for unknowns of the user.

    Attributes
    ----------
    time_s : array (K + 1,)
        Times of the start and of the contacts.
    estimates : array (K + 1, 3)
        East and north in m and walking heading in rad, clockwise from north, smoothed without the factors.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.offline.smoothing.factor_graph import PoseKeys
    >>> keys = PoseKeys(np.array([0.0, 0.5, 1.0]), np.zeros((3, 3)))
    >>> keys.key(0.6), round(keys.estimate(0.6).theta(), 3)
    (8646911284551352321, 1.571)
    """

    time_s: FloatArray
    estimates: FloatArray

    def contact(self, time_s: float) -> int:
        """Return the number of steps before the contact nearest to a time.

        Parameters
        ----------
        time_s : float
            Time on the clock of the recording, in s.

        Returns
        -------
        int
            Number of steps, 0 for the start.
        """
        return int(np.abs(self.time_s - time_s).argmin())

    def key(self, time_s: float) -> int:
        """Return the key of the pose at the contact nearest to a time.

        Parameters
        ----------
        time_s : float
            Time on the clock of the recording, in s.

        Returns
        -------
        int
            Key for a factor of GTSAM.
        """
        return int(gtsam.symbol("x", self.contact(time_s)))

    def estimate(self, time_s: float) -> gtsam.Pose2:
        """Return the pose at the contact nearest to a time, smoothed without the factors.

        Parameters
        ----------
        time_s : float
            Time on the clock of the recording, in s.

        Returns
        -------
        gtsam.Pose2
            East, north, and angle of the walking heading, counter-clockwise from east.
        """
        east_m, north_m, heading_rad = self.estimates[self.contact(time_s)].tolist()
        return gtsam.Pose2(east_m, north_m, 0.5 * np.pi - heading_rad)


UserFactors = Callable[[PoseKeys], Any]


@dataclass(frozen=True, slots=True, eq=False)
class UserGraph:
    """Factors of the user, values of their own unknowns, and the numbers of steps at whose contacts they need poses."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    anchors: tuple[int, ...]


def user_graph(factors: UserFactors, keys: PoseKeys) -> UserGraph:
    """Return the factors of a function of the user. ValueError if an unknown has no value."""
    made = factors(keys)
    graph, values = made if isinstance(made, tuple) else (made, gtsam.Values())
    if not (isinstance(graph, gtsam.NonlinearFactorGraph) and isinstance(values, gtsam.Values)):
        raise ValueError(
            "factors must return a gtsam.NonlinearFactorGraph, or a pair of it and the gtsam.Values of its own "
            f"unknowns, got {made!r}"
        )
    anchors: list[int] = []
    used = [key for key in graph.keyVector() if gtsam.Symbol(key).chr() != ord("x")]
    taken = [key for key in [*values.keys(), *used] if chr(gtsam.Symbol(key).chr()) in _OWN_LETTERS.split(", ")]
    if taken:
        raise ValueError(
            f"factors give the unknown {gtsam.DefaultKeyFormatter(taken[0])}, but the letters {_OWN_LETTERS} "
            "belong to the walk: use another letter, and no values for the poses of PoseKeys.key"
        )
    for key in graph.keyVector():
        symbol = gtsam.Symbol(key)
        if symbol.chr() == ord("x"):
            if symbol.index() >= len(keys.time_s):
                raise ValueError(
                    f"factors use the pose {symbol.string()}, but the walk has {len(keys.time_s) - 1} steps: use the "
                    "keys of PoseKeys.key"
                )
            anchors.append(int(symbol.index()))
        elif not values.exists(key):
            raise ValueError(
                f"factors use the unknown {gtsam.DefaultKeyFormatter(key)} without a value: return a pair of the graph "
                "and gtsam.Values with an initial value of it"
            )
    return UserGraph(graph, values, tuple(anchors))


def solved_with(graph: WalkGraph, found: Solution, user: UserGraph) -> tuple[Solution, gtsam.Values]:
    """Return the solution of a walk with the factors of the user, and all values. ValueError if it is not unique."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values(user.values)
    graph.add_to(factors, found.weight)
    factors.push_back(user.graph)
    graph.insert_into(values, found)
    try:
        values = least_squares_values(factors, values)
        return graph.solution(values, bayes_tree(factors, values), found), values
    except RuntimeError as error:
        raise ValueError(
            f"the walk and the given factors do not determine all unknowns: {str(error).strip()}; add factors, such as "
            "priors of landmarks"
        ) from error
