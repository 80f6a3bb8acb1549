"""Direction of north in the attitude frame, from the magnetic field along the way, with its uncertainty.

In the attitude frame (east, north, up, rotated by an unknown angle about up), the field measured by the phone is

    f = m + R b + e.

Here m is the field of the Earth, R the rotation from the sensor to the frame, b the hard iron (iron in the phone and a
wrong calibration), and e the disturbance of the place. A linear regression over the way estimates m and b together. b
becomes observable when the pedestrian turns. Before that, the priors of m and b determine the uncertainty of m. The
prior of b has heavy tails, because raw magnetometer data contain the whole hard iron of the phone. The prior of m is a
horizontal and a vertical field. At a known place they come from the World Magnetic Model, so that a field of another
strength or dip reveals hard iron on a straight walk, too. In a building e may rotate single readings by 90 degrees. It
averages out, because it changes every few metres, and the remaining error follows from its scatter.

Single readings are not gated by the magnitude or dip of the field, which hardly show which readings point north. In
ms_indoor the headings of single steps scatter by 11 to 13 degrees at any distance from the model of the Earth's field.
Only the field during steps is used, because all samples at one place share one disturbance. With the field as a
heading fix at each step, tracks become worse.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.values import FloatArray, Step, read_only, replace_unchecked
from pdr_filter.values.quaternions import rotation_matrix

# Duration of a reading, which is a mean over about a step, s.
_READING_S = 0.5
# Columns of the samples that wait for a complete reading, and of the readings that wait for their step.
_FIELD, _QUAT, _KNOWN, _SAMPLE_COLUMNS = slice(0, 3), slice(3, 7), 7, 8
_TIME, _SQUARES, _READING_COLUMNS = 0, slice(1, 50), 50
# Time for which readings are buffered, s. Steps become known some seconds after their contact, above all behind a gate.
_MAX_LATENCY_S = 20.0
_M, _B, _F = slice(0, 3), slice(3, 6), 6
# Angles of the directions of magnetic north over which the evidence is summed, every three degrees.
# The sum is exact to 1e-4 for a standard deviation of two degrees.
_ANGLES_RAD = read_only(np.arange(120) * (np.pi / 60.0))
# With a smaller deviation, which many readings give, the sum is over these angles about the mean of the first one. They
# reach five such deviations, every sixth of a degree.
_FINE_BELOW_RAD, _FINE_ANGLES_RAD = math.radians(2.0), read_only(np.arange(-60, 61) * (np.pi / 1080.0))
# Prior of the hard iron: normal densities of equal probability, by their standard deviations in units of `iron_std_ut`.
# Their mixture is nearly uniform in the logarithm of the hard iron. With 7 uT they span 3.5 uT, of a good calibration,
# to 112 uT on each axis. Public recordings of raw data have 20 to 300 uT in all.
_IRON_FACTORS = 2.0 ** np.arange(-1, 5)
# Squared length of the mean direction below which north is unknown: a standard deviation of 5 rad.
_LEAST_SQUARED_LENGTH = 1e-11
# Share of new readings after which the regression is solved again. North changes little in the attitude frame.
_SOLVE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class MagneticNorthState:
    """Buffered readings of the magnetic field, and the sums of the regression.

    The model of a reading f (3,) in the attitude frame is f = X (m, b) + e with X = [1 R], (3, 6). m is the field of
    the Earth, and b the hard iron of the phone. R is the rotation from the sensor to the attitude frame, and e the
    disturbance of the place. A reading adds the matrix [X f]' [X f], (7, 7), to the sums.
    """

    samples: FloatArray  # (R, 8) samples since the last complete reading
    # (W, 50) time and matrix [X f]' [X f] of each buffered reading, from its mean rotation and mean field.
    readings: FloatArray
    n: float  # effective number of readings used, with exponential forgetting
    squares: FloatArray  # (7, 7) sum of [X f]' [X f] over all readings, with exponential forgetting
    variance_ut2: float  # estimated variance of the disturbance e on each axis, uT2
    used_s: float  # time of the last reading used, s
    n_fresh: int = 0  # readings used since the regression was last solved
    # Direction of true north at the last solution, clockwise from north of the attitude frame, rad.
    north_rad: float = 0.0
    north_std_rad: float = math.inf  # standard deviation of `north_rad`, rad


@dataclass(frozen=True)
class MagneticNorth(StepStage[MagneticNorthState]):
    """Causal stage that estimates the direction of north at each step from the magnetometer.

    It needs a gyroscope and a magnetometer, and sets `Step.north_rad` and `Step.north_std_rad`. The default parameters
    were chosen on storeys B1 and F1 of ms_indoor. The other storeys and data sets agree with them
    (tests/benchmarks/absolute_heading.py).

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    declination_rad, declination_std_rad : float, default 0
        Direction of magnetic north east of true north, and its standard deviation, rad.
    field_ut, field_std_ut : (float, float), default (27, -15) and (8, 35)
        Prior mean and standard deviation of the horizontal and of the upward field of the Earth, uT. The defaults are
        for an unknown place: the largest cities of the continents have horizontal fields of 13 to 39 uT and upward
        fields of -50 to 51 uT.
    iron_std_ut : float, default 7
        Typical hard iron of a calibrated magnetometer on each axis, uT. It is the rms of pedestrians who turned; single
        values reach 13, and are 0 to 3 in the other sets. The standard deviations of the prior are 0.5 to 16 times as
        large, with equal probabilities of all powers of two.
    disturbance_ut, disturbance_readings : float, default 8 and 4
        Prior standard deviation of the disturbances on each axis, uT, and its weight as a number of independent
        readings. Malls have 4, an office 6, a building of steel 15 uT.
    correlation_readings : float, default 6
        Correlation length of disturbances, in readings. Their correlation is 0.9 from one step to the next, 0.4 after
        five and 0.1 after ten steps.
    memory_s : float, default 100
        Time constant of the forgetting, s. The attitude itself drifts by some 0.001 rad/s.

    Notes
    -----
    In the attitude frame, the measured field is f = m + R b + e: the field of the Earth m, the hard iron b of the phone
    rotated by R from the sensor frame, and the disturbance e of the place. A linear regression with forgetting over the
    readings of all steps estimates m and b, for each direction of magnetic north. North is the mean direction minus the
    declination.

    Examples
    --------
    Steps of a simulated walk along a curve receive the direction of north:

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
    >>> recording = pdr.simulate.simulate([pdr.simulate.Leg("walking", duration_s=10.0, turn_rad=1.57, curve=True)])
    >>> config = pdr.recipes.default()
    >>> config = replace(config, sensing=replace(config.sensing, north=MagneticNorth()))
    >>> steps = pdr.track(recording, config).steps
    >>> bool(np.isfinite(steps[-1].north_std_rad))
    True
    """

    rate_hz: float = 100.0
    declination_rad: float = 0.0
    declination_std_rad: float = 0.0
    field_ut: tuple[float, float] = (27.0, -15.0)
    field_std_ut: tuple[float, float] = (8.0, 35.0)
    iron_std_ut: float = 7.0
    disturbance_ut: float = 8.0
    disturbance_readings: float = 4.0
    correlation_readings: float = 6.0
    memory_s: float = 100.0

    def init(self) -> MagneticNorthState:
        return MagneticNorthState(
            samples=np.empty((0, _SAMPLE_COLUMNS)),
            readings=np.empty((0, _READING_COLUMNS)),
            n=0.0,
            squares=np.zeros((7, 7)),
            variance_ut2=self.disturbance_ut**2,
            used_s=-math.inf,
        )

    def after_gap(self, state: MagneticNorthState) -> MagneticNorthState:
        return self.init()

    def update(
        self,
        state: MagneticNorthState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: NumberedSteps,
    ) -> tuple[MagneticNorthState, NumberedSteps]:
        is_sampled = block.magnetic_field_known & block.angular_rate_known
        new = np.column_stack([block.magnetic_field_ut, attitude.quat, is_sampled.astype(float)])
        samples = np.concatenate([state.samples, new])
        size, n_waiting = round(_READING_S * self.rate_hz), len(state.samples)
        whole = samples[: len(samples) // size * size].reshape(-1, size, _SAMPLE_COLUMNS)
        ends_s = block.time_s[np.arange(1, len(whole) + 1) * size - 1 - n_waiting]
        is_known = whole[:, :, _KNOWN].all(axis=1)
        new_readings = _readings(whole[is_known], ends_s[is_known])
        samples = samples[len(samples) // size * size :]
        readings = np.concatenate([state.readings, new_readings])
        state = replace_unchecked(state, samples=samples, readings=readings)
        state, steps = self.finish(state, steps)
        recent = state.readings[:, _TIME] > block.time_s[-1] - _MAX_LATENCY_S
        return replace_unchecked(state, readings=state.readings[recent]), steps

    def finish(self, state: MagneticNorthState, steps: NumberedSteps) -> tuple[MagneticNorthState, NumberedSteps]:
        result: NumberedSteps = []
        times: list[float] = state.readings[:, _TIME].tolist()
        for number, step in steps:
            state = self._at_step(state, step, times)
            step = replace_unchecked(step, north_rad=state.north_rad, north_std_rad=state.north_std_rad)
            result.append((number, step))
        return state, result

    def _at_step(self, state: MagneticNorthState, step: Step, times: list[float]) -> MagneticNorthState:
        """Return the state with the readings made during a step, and with north estimated again if many are new.

        `times` are the times of all buffered readings. If the angular rate was unknown for a time, earlier readings are
        discarded.
        """
        if step.heading_unknown_s > 0:
            # Without angular rate the attitude frame is rotated by an unknown angle, so earlier readings are useless.
            state = replace_unchecked(self.init(), samples=state.samples, readings=state.readings, used_s=state.used_s)
        first = bisect_right(times, max(step.time_s - step.duration_s, state.used_s))
        end = bisect_right(times, step.time_s)
        if end > first:
            state = self._with_readings(state, state.readings[first:end])
        return self._with_solution(state) if state.n_fresh > _SOLVE_SHARE * state.n else state

    def _with_readings(self, state: MagneticNorthState, readings: FloatArray) -> MagneticNorthState:
        """Return the state with readings added to the sums, and older ones forgotten."""
        used_s = float(readings[-1, _TIME])
        weight = np.exp((readings[:, _TIME] - used_s) / self.memory_s)
        stay = math.exp((state.used_s - used_s) / self.memory_s)
        squares = stay * state.squares + (weight @ readings[:, _SQUARES]).reshape(7, 7)
        n, n_fresh = stay * state.n + float(weight.sum()), state.n_fresh + len(readings)
        return replace_unchecked(state, n=n, squares=squares, used_s=used_s, n_fresh=n_fresh)

    def _with_solution(self, state: MagneticNorthState) -> MagneticNorthState:
        """Return the state with the regression f = m + R b + e solved, and the variance of e estimated again.

        The measured field f is the sum of the field of the Earth m = h u + (0, 0, z), the hard iron b rotated by R from
        the sensor to the attitude frame, and the disturbance e. h and z are the horizontal and the upward field, and
        u = (sin psi, cos psi, 0) is the direction of magnetic north. n correlated readings are worth n / c independent
        ones, with c = (1 + r) / (1 - r) and r = exp(-1 / correlation). Given psi and a component of the prior of b, the
        model is linear in (h, z) and b, and its evidence has a closed form. b is eliminated first, for each component,
        and then (h, z), for each direction of a grid. Directions and components are weighted by their evidence. The
        result is the mean direction, with the standard deviation sqrt(-2 log R) of the mean length R.
        """
        north_rad, var_rad2, residual_ut2 = self._north(state, _ANGLES_RAD)
        if var_rad2 < _FINE_BELOW_RAD**2:
            north_rad, var_rad2, residual_ut2 = self._north(state, north_rad + _FINE_ANGLES_RAD)
        c = self._n_correlated
        prior_ut2 = self.disturbance_readings * self.disturbance_ut**2
        # The three components of m use up the degrees of freedom of one independent reading.
        n_independent = max(state.n / c - 1.0, 0.0)
        share = max(residual_ut2, 0.0) / (3.0 * c)
        return replace_unchecked(
            state,
            variance_ut2=(prior_ut2 + share) / (self.disturbance_readings + n_independent),
            n_fresh=0,
            north_rad=north_rad - self.declination_rad,
            north_std_rad=math.sqrt(self.declination_std_rad**2 + var_rad2),
        )

    @property
    def _n_correlated(self) -> float:
        """Number of correlated readings that are worth an independent one."""
        return 1.0 / math.tanh(0.5 / self.correlation_readings)

    def _north(self, state: MagneticNorthState, angles_rad: FloatArray) -> tuple[float, float, float]:
        """Return magnetic north, its variance, and the expected sum of squared residuals in uT2 (`_with_solution`).

        The evidence is summed over the directions with the given angles, which have equal distances.
        """
        directions = np.column_stack([np.sin(angles_rad), np.cos(angles_rad)])
        weight = 1.0 / (self._n_correlated * state.variance_ut2)
        XX, Xf, ff = state.squares[:_F, :_F], state.squares[:_F, _F], float(state.squares[_F, _F])
        prior_b = 1.0 / np.square(self.iron_std_ut * _IRON_FACTORS)
        P_b = np.linalg.inv(weight * XX[_B, _B] + prior_b[:, None, None] * np.eye(3))
        gain = weight * XX[_M, _B] @ P_b
        J, Jm = weight * (XX[_M, _M] - gain @ XX[_B, _M]), weight * (Xf[_M] - gain @ Xf[_B])
        log_prior = 3.0 * np.log(prior_b)
        log_evidence = 0.5 * (log_prior + np.linalg.slogdet(P_b)[1] + weight**2 * (P_b @ Xf[_B] @ Xf[_B]))
        # the information of (h, z) and its product with their mean, for each component and direction
        prior_hz = 1.0 / np.square(self.field_std_ut)
        uJ = directions @ J[:, :2]
        hh, hz, zz = (uJ[..., :2] * directions).sum(axis=-1) + prior_hz[0], uJ[..., 2], J[:, 2, 2, None] + prior_hz[1]
        y_h = Jm[:, :2] @ directions.T + prior_hz[0] * self.field_ut[0]
        y_z = Jm[:, 2, None] + prior_hz[1] * self.field_ut[1]
        determinant = hh * zz - hz**2
        h, z = (zz * y_h - hz * y_z) / determinant, (hh * y_z - hz * y_h) / determinant
        log_prob = log_evidence[:, None] + 0.5 * (h * y_h + z * y_z - np.log(determinant))
        prob = np.exp(log_prob - log_prob.max())
        prob /= prob.sum()
        m = np.concatenate([h[..., None] * directions, z[..., None]], axis=-1)
        x = np.concatenate([m, weight * (Xf[_B] - m @ XX[_M, _B]) @ P_b], axis=-1)
        residual_ut2 = ff - 2.0 * (x @ Xf) + ((x @ XX) * x).sum(axis=-1)
        mean_east, mean_north = prob.sum(axis=0) @ directions
        squared_length = min(max(float(mean_east**2 + mean_north**2), _LEAST_SQUARED_LENGTH), 1.0)
        return math.atan2(mean_east, mean_north), -math.log(squared_length), float((prob * residual_ut2).sum())


def _readings(samples: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return a row (50,) for each of R complete readings: its time, and its flattened matrix [X f]' [X f].

    `samples` (R, size, 8) are the samples of the readings. X = [1 R] and the measured field f are averaged over each
    reading, with the rotation R from the sensor to the attitude frame.
    """
    to_frame = np.moveaxis(rotation_matrix(samples[:, :, _QUAT]), (-2, -1), (0, 1))
    Xf = np.empty((len(samples), 3, 7))
    Xf[:, :, _M], Xf[:, :, _B] = np.eye(3), np.moveaxis(to_frame.mean(axis=3), 2, 0)
    Xf[:, :, _F] = (to_frame * np.moveaxis(samples[:, :, _FIELD], 2, 0)).sum(axis=1).mean(axis=2).T
    return np.column_stack([time_s, (Xf.swapaxes(1, 2) @ Xf).reshape(-1, 49)])
