"""Estimate the gyroscope bias while the phone is carried, with its uncertainty.

Three kinds of measurement update a Kalman filter. Each is weak, has its own variance, and may be an outlier, so that an
outlier hardly moves the estimate (docs/methods/attitude.md):

1. Still windows. The mean angular rate of a window without motion is the bias, or a uniform rotation, as in a train. A
   rotation is about the vertical, a bias about any axis. As long as a rotation is more probable, the window does not
   update the bias.
2. Straight walking. A pedestrian who walks from corner to corner turns little in between. A long curve counts as one
   walk, otherwise the bias would follow the curve.
3. The magnetic field should not rotate in the attitude frame. Only its drift is used, never its direction. The variance
   follows from the scatter of the horizontal and vertical field. After a jump the direction starts again.

Each filter also estimates the error of the heading that was corrected with the earlier bias estimates. A wrong bias
estimate has turned the heading before it is corrected, so a later measurement of the bias also determines that error.
`pdr_filter.sensing.heading.corridors` adds measurements of this error from the axes of buildings.

The bias is estimated about the three axes of the sensor. What is learned with the phone in the hand therefore remains
valid when the phone is put into a pocket. Most phones subtract a bias estimate of their own and have a small remaining
bias, but some do not. The prior is therefore a mixture of normal distributions with one Kalman filter for each,
weighted by how well it predicts (D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE
Trans. Automatic Control 10(4), 1965, doi:10.1109/TAC.1965.1098191). A measurement is weighted by the probability that
it is not an outlier, and the covariance is inflated by the remaining doubt (Y. Bar-Shalom, F. Daum, J. Huang, "The
probabilistic data association filter", IEEE Control Systems 29(6), 2009, doi:10.1109/MCS.2009.934469). Walking as a
measurement: J. Borenstein, L. Ojeda, "Heuristic drift elimination for personnel tracking systems", Journal of
Navigation 63(4), 2010.

An update takes 59 us, or 5 us if compiled by numba, with other rounding errors. Compiled code is not used, so that
wheels stay pure Python.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.sensing.device import Device
from pdr_filter.values import FloatArray, check_numbers, read_only, replace_unchecked
from pdr_filter.values.angles import UNKNOWN_VAR_RAD2
from pdr_filter.values.mixtures import combine, possible_outlier

# State of each Kalman filter: bias about x, y, z of the sensor in rad/s, direction of the magnetic field in the
# attitude frame in rad, and error of the corrected heading (estimate minus truth) in rad, both clockwise.
_BIAS, _FIELD, _ERROR = slice(0, 3), 3, 4
_HEADINGS = slice(3, 5)  # field direction and heading error, which are driven by the same angular rate
_N_STATES = 5
_IDENTITY = read_only(np.eye(_N_STATES))
_IDENTITY_3 = np.eye(3)
_H_FIELD, _H_ERROR = read_only(_IDENTITY[_FIELD]), read_only(_IDENTITY[_ERROR])
# Log density of a uniform direction, shifted by the constant that `_update` omits.
_LOG_ANY_DIRECTION = 0.5 * math.log(2 * math.pi) - math.log(2 * math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class BiasWindow:
    """Statistics of one window of samples for the estimation of the bias."""

    angular_rate_radps: FloatArray  # (3,) mean measured angular rate, rad/s
    # Standard deviation of the angular rate, rad/s: the square root of the summed variances of the axes.
    angular_rate_std_radps: float
    specific_force_std_mps2: float  # standard deviation of the specific force, m/s2, likewise
    up_sensor: FloatArray  # (3,) mean unit vector up in the sensor frame
    heading_rad: float  # mean corrected heading of the device, not wrapped, rad
    angular_rate_known: bool  # True if the angular rate is known in all samples
    magnetic_field_ut: FloatArray  # (3,) mean magnetic field along east, north and up of the attitude frame, uT
    magnetic_field_known: bool  # True if the magnetic field is known in all samples


@dataclass(frozen=True, eq=False)
class StraightWalk:
    """Windows of walking since the last corner, newest last."""

    heading_rad: tuple[float, ...]  # corrected headings of the last two windows, rad. They serve to detect a corner.
    # Uncorrected headings of the windows that have not yet updated the bias estimate, rad. Their negative slope over
    # time is the bias about the vertical.
    measured_rad: tuple[float, ...]
    up_sensor: FloatArray  # (3,) unit vector up in the sensor frame in the first window
    n_to_skip: int  # number of windows to skip before the walk updates the bias estimate again


@dataclass(frozen=True, slots=True, eq=False)
class FieldScatter:
    """Recent mean and scatter of the magnetic field, with exponential forgetting."""

    n_windows: int  # windows so far
    horizontal_ut: float  # mean horizontal field, uT
    up_ut: float  # mean vertical field, uT
    variance_ut2: float  # mean of the variances of the horizontal field strength and the vertical field, uT2
    direction_rad: float  # direction of the field in the last window, clockwise from north of the attitude frame, rad


@dataclass(frozen=True, eq=False)
class GyroBiasState:
    """Bank of M Kalman filters, and the history that the measurements need."""

    mean: FloatArray  # (M, 5) means of the filters
    cov: FloatArray  # (M, 5, 5) covariances of the filters
    log_weight: FloatArray  # (M,) log weights of the filters. The largest is 0.
    bias_radps: FloatArray  # (3,) mean bias of the mixture, rad/s
    bias_cov_radps2: FloatArray  # (3, 3) covariance of the bias of the mixture, (rad/s)^2
    heading_error_rad: float = 0.0  # error of the corrected heading since the start, estimated by the mixture, rad
    heading_error_var_rad2: float = 0.0  # variance of `heading_error_rad`, rad2
    # Sum of the heading variance that the uncertain bias has added since the start, without reductions by measurements,
    # rad2. The filter of the track must add this variance, because it receives each measurement separately.
    heading_lost_var_rad2: float = 0.0
    corrected_rad: float = 0.0  # total turn by which the bias estimates so far have corrected the heading, rad
    n_still: int = 0  # consecutive still windows
    walk: StraightWalk | None = None  # current straight walk
    field: FieldScatter | None = None  # recent scatter of the magnetic field
    field_tracked: bool = False  # True if the field direction in the filter states is initialised
    n_field_outliers: int = 0  # consecutive outliers of the field direction


@dataclass(frozen=True)
class GyroBias:
    """Estimator of the gyroscope bias from still windows, straight walking and the drift of the magnetic field.

    Parameters
    ----------
    window_s : float
        Length of the windows, s. One second averages over one or two steps and the rotation that each of them brings.
    prior_std_radps, prior_prob : tuple of float
        Standard deviations (rad/s) and probabilities of the zero-mean mixture of normal distributions that is the prior
        of the bias. The three parts are phones that calibrate themselves (the drifts of known walks are 0.002 to 0.006
        rad/s), phones that do so less well (0.02), and phones that do not (0.03 to 0.04 on the phones of 4 of 13
        persons of ubicomp13; 0.1 was seen elsewhere). A larger probability of large biases makes the error ellipses of
        walks with little information far too large (humolire, ms_indoor).
    device, device_prob : Device or None, float
        Bias estimated in an earlier recording of the phone, and the probability that it still holds.
    walk_radps_per_sqrt_s : float
        Random walk of the bias, rad/s per square root of a second. The default is 0.002 rad/s in five minutes, as while
        the phone warms up.
    still_gyr_radps, still_acc_mps2 : float
        A window is still if both its standard deviations are below these limits. It is used if the window before was
        still too.
    still_max_radps : float
        Largest plausible bias, rad/s. A still window with a faster rate is a uniform rotation and is not used.
    still_std_radps, still_std_share : float
        Standard deviation of the mean of a still window: a constant in rad/s plus this share of the standard deviation
        within the window. For persons who stand with a phone in the hand or pocket, the means of 1 s scatter by 0.45 to
        0.6 of that. The default of 0.8 allows for their correlation in time.
    still_outlier_prob, turning_radps : float
        Probability that the mean of a still window is an outlier, and the standard deviation of outliers, rad/s.
    even_turn_prob : float
        Probability that a still phone rotates uniformly about the vertical with a standard deviation of
        `turning_radps`, as in a vehicle or on a turntable. All windows of such a rotation agree, so outlier rejection
        alone cannot detect it.
    walking_acc_mps2 : float
        Standard deviation of the specific force above which the pedestrian walks, m/s2.
    corner_rad, tilted_rad : float
        A straight walk ends when the heading differs from the heading in the last two windows by more than
        `corner_rad`, or the direction of gravity from its direction in the first window by more than `tilted_rad`.
    straight_s : tuple of float
        Shortest and longest straight walk that is one measurement, s. The window at each end is not used, because
        corners are rounded. The turn within a straight walk does not grow with its length (0.15 to 0.2 rad between 4
        and 70 s on outdoor paths), so a longer walk determines the bias better.
    straight_again_s : float
        Time until a walk that continues without a corner is measured again, s. A curve looks the same along its whole
        length, so that consecutive measurements would not be independent.
    straight_turn_rad : float
        Standard deviation of the turn within a straight walk of any length, rad.
    straight_outlier_prob, curve_radps : float
        Probability that a walk is curved, and the standard deviation of the rate of turn in the curve, rad/s. At most 7
        % of the straight walks of sisfall, motionsense, terrain and oxiod turn by more than 0.6 rad.
    field_memory_s : float
        Time constant of the mean and scatter of the magnetic field, s.
    field_correlation_s : float
        Duration of a disturbance while the pedestrian passes its source, s. Windows closer together are not
        independent.
    field_scatter_weight : float
        Factor from the variance of the field components, relative to the squared horizontal field, to the variance of
        the direction.
    field_std_rad : float
        Standard deviation of the direction in an undisturbed field, rad, due to attitude and calibration.
    field_walk_rad_per_sqrt_s : float
        Random walk of the direction of the field from place to place, rad per square root of a second. In buildings it
        was seen to turn by 0.7 rad along a corridor of one minute, smoothly and with almost constant magnitude.
    field_jump_rad, field_jump_scatter : float
        The field direction starts again after a change between two windows of more than `field_jump_rad`, because no
        bias causes it. The change must also exceed `field_jump_scatter` standard deviations of the scatter of the
        field. A pedestrian who walks in circles among iron furniture passes the same field in each lap, and the
        repeated field shows the drift from lap to lap.
    field_outlier_prob : float
        Probability that the direction of the field is uniformly distributed.

    Notes
    -----
    With the scatter sigma of the magnetic field, its mean horizontal strength H and windows of T seconds, the variance
    of the direction of the field is 2 c / T (w sigma^2 / H^2 + s^2). c is `field_correlation_s`, w is
    `field_scatter_weight` and s is `field_std_rad`.
    """

    window_s: float = 1.0
    prior_std_radps: tuple[float, ...] = (0.004, 0.02, 0.05)
    prior_prob: tuple[float, ...] = (0.9, 0.07, 0.03)
    device: Device | None = None
    device_prob: float = 0.9
    walk_radps_per_sqrt_s: float = 1e-4
    still_gyr_radps: float = 0.1
    still_acc_mps2: float = 0.8
    still_max_radps: float = 0.15
    still_std_radps: float = 0.001
    still_std_share: float = 0.8
    still_outlier_prob: float = 0.2
    turning_radps: float = 0.3
    even_turn_prob: float = 0.01
    walking_acc_mps2: float = 1.0
    corner_rad: float = 0.17
    tilted_rad: float = 0.35
    straight_s: tuple[float, float] = (4.0, 30.0)
    straight_again_s: float = 60.0
    straight_turn_rad: float = 0.2
    straight_outlier_prob: float = 0.1
    curve_radps: float = 0.06
    field_memory_s: float = 20.0
    field_correlation_s: float = 5.0
    field_scatter_weight: float = 4.0
    field_std_rad: float = 0.05
    field_walk_rad_per_sqrt_s: float = 0.03
    field_jump_rad: float = 0.5
    field_jump_scatter: float = 2.0
    field_outlier_prob: float = 0.1

    def __post_init__(self) -> None:
        off = ("walk_radps_per_sqrt_s", "field_walk_rad_per_sqrt_s", "device_prob", "still_gyr_radps")
        check_numbers(self, zero=off, infinite=("walking_acc_mps2",))
        if len(self.prior_std_radps) != len(self.prior_prob) or not self.prior_prob:
            raise ValueError(
                "prior_std_radps and prior_prob must be equally long and not empty, got "
                f"{len(self.prior_std_radps)} and {len(self.prior_prob)} values: give one probability for each "
                "standard deviation"
            )
        if len(self.straight_s) != 2:
            raise ValueError(f"straight_s must be (shortest, longest) in seconds, got {self.straight_s}: give both")
        if self.straight_s[0] > self.straight_s[1]:
            raise ValueError(
                f"straight_s must be (shortest, longest) in seconds, got {self.straight_s}: put the shorter time first"
            )

    def init(self) -> GyroBiasState:
        """Return the state before the first window, which is the prior."""
        covs = [std**2 * np.eye(3) for std in self.prior_std_radps]
        means, prob = [np.zeros(3) for _ in covs], np.array(self.prior_prob)
        if self.device is not None:
            means, covs = [self.device.bias_radps, *means], [self.device.bias_cov_radps2, *covs]
            prob = np.concatenate([[self.device_prob], (1.0 - self.device_prob) * prob])
        mean, cov = np.zeros((len(covs), _N_STATES)), np.zeros((len(covs), _N_STATES, _N_STATES))
        mean[:, _BIAS], cov[:, _BIAS, _BIAS] = means, covs
        log_weight = np.log(prob)
        bias, bias_cov = _mixture((mean, cov, log_weight))
        return GyroBiasState(
            mean, cov, log_weight - log_weight.max(), bias[_BIAS].copy(), bias_cov[_BIAS, _BIAS].copy()
        )

    def after_gap(self, state: GyroBiasState) -> GyroBiasState:
        """Return the state after a time without samples, which keeps the bias and forgets the earlier windows."""
        return replace_unchecked(state, n_still=0, walk=None, field=None, field_tracked=False, n_field_outliers=0)

    def update(self, state: GyroBiasState, window: BiasWindow) -> GyroBiasState:
        """Return the state after a window whose heading was corrected with the bias of the given state.

        A window with unknown angular rate has the effect of a gap.
        """
        if not window.angular_rate_known:
            return self.after_gap(state)
        correction_rad = self.window_s * _dot(window.up_sensor, state.bias_radps)
        last = state.mean, state.cov, state.log_weight
        bank = predicted = _predict(self, last, window.up_sensor, correction_rad)
        # A positive angular rate about up decreases the clockwise heading, and so does a positive bias. Subtracting the
        # correction gives the uncorrected heading, at the middle of the window.
        measured_rad = window.heading_rad - (state.corrected_rad + 0.5 * correction_rad)
        bank, n_still = self._update_still(bank, state.n_still, window)
        bank, walk = self._update_walk(bank, state.walk, window, measured_rad)
        bank, field, field_tracked, n_field_outliers = self._update_field(bank, state, window)
        mean, cov, log_weight = bank
        # The estimate already uses the unfinished straight walk, although the walk enters the bank only when it ends.
        # Otherwise all its information would arrive at one moment, and the track would jump by metres.
        estimate = self._measure_walk(bank, walk)
        state_mean, state_cov = _mixture(estimate)
        error_rad, error_var_rad2 = _direction(estimate)
        before = self._measure_walk(last, state.walk)
        if before is not last:
            predicted = _predict(self, before, window.up_sensor, correction_rad)
        _, predicted_var_rad2 = _direction(predicted)
        lost_rad2 = max(predicted_var_rad2 - state.heading_error_var_rad2, 0.0)
        return replace_unchecked(
            state,
            mean=mean,
            cov=cov,
            log_weight=log_weight,
            bias_radps=state_mean[_BIAS].copy(),
            bias_cov_radps2=state_cov[_BIAS, _BIAS].copy(),
            heading_error_rad=error_rad,
            heading_error_var_rad2=error_var_rad2,
            heading_lost_var_rad2=state.heading_lost_var_rad2 + lost_rad2,
            corrected_rad=state.corrected_rad + correction_rad,
            n_still=n_still,
            walk=walk,
            field=field,
            field_tracked=field_tracked,
            n_field_outliers=n_field_outliers,
        )

    def device_fits(self, state: GyroBiasState) -> float:
        """Return the probability that the bias of `device` holds in this recording; 1 without a device."""
        if self.device is None:
            return 1.0
        weight = np.exp(state.log_weight)
        return float(weight[0] / np.add.reduce(weight))

    def learnt_device(self, state: GyroBiasState, error_rad: float = 0.0, error_var_rad2: float = math.inf) -> Device:
        """Return the bias and its covariance for the next recording of the phone.

        `error_rad` is a measurement of the heading error from another source, such as the axes of a building. An
        infinite variance means that there is none.
        """
        bank = state.mean, state.cov, state.log_weight
        if math.isfinite(error_var_rad2):
            bank, _ = _update(bank, _H_ERROR, error_rad - state.mean[:, _ERROR], error_var_rad2, 1e-9, 0.0)
        bias, bias_cov = _mixture(bank)
        return Device(bias[_BIAS].copy(), bias_cov[_BIAS, _BIAS].copy())

    def device_from_smoothed(
        self,
        state: GyroBiasState,
        error_rad: float,
        var_rad2: float,
        other_var_rad2: float,
        ago_s: float,
        up_sensor: FloatArray,
    ) -> Device:
        """Return the bias and its covariance for the next recording, using the heading error of a smoothed walk.

        Parameters
        ----------
        state : GyroBiasState
            State at the end of the recording.
        error_rad, var_rad2 : float
            Smoothed error of the corrected heading at an earlier time, rad, and its variance.
        other_var_rad2 : float
            Variance of the part of the error that does not come from the bias, rad2.
        ago_s : float
            Time from the smoothed error to the end of the recording, s.
        up_sensor : FloatArray
            Unit vector up in the sensor frame during this time, shape (3,).

        Returns
        -------
        Device
            Bias and covariance.

        Notes
        -----
        The smoothed error contains the information of this state, which must not count twice. It is therefore used only
        if its variance is below a quarter of the variance that the heading has in this state.

        With the heading error e and the bias b of this state, the bias b' in use, up u in the sensor frame and the time
        D since the earlier step, it measures e + D u . (b - b'). On walks of 150 s of oxiod, the standard deviation of
        the bias about the vertical is 2.9 to 4.0 mrad/s from straight walking alone, and 1.3 to 1.8 mrad/s with this
        measurement.
        """
        bank = state.mean, state.cov, state.log_weight
        if var_rad2 > 0.25 * state.heading_error_var_rad2:
            return self.learnt_device(state)
        # h' x is the error at the earlier time, because the error has grown by up' (bias in use - bias) a second.
        h = np.array([*(ago_s * up_sensor), 0.0, 1.0])
        innovation = error_rad + ago_s * _dot(up_sensor, state.bias_radps) - bank[0].dot(h)
        bank, _ = _update(bank, h, innovation, var_rad2 + other_var_rad2, 1e-9, 0.0)
        bias, bias_cov = _mixture(bank)
        return Device(bias[_BIAS].copy(), bias_cov[_BIAS, _BIAS].copy())

    def _update_still(self, bank: _Bank, n_still: int, window: BiasWindow) -> tuple[_Bank, int]:
        """Return the bank of filters, and the number of consecutive still windows.

        A still window updates the bank if the window before was still, too.
        """
        is_still = (
            window.angular_rate_std_radps < self.still_gyr_radps
            and _dot(window.angular_rate_radps, window.angular_rate_radps) < self.still_max_radps**2
            and window.specific_force_std_mps2 < self.still_acc_mps2
        )
        if not is_still:
            return bank, 0
        if n_still >= 1:
            std = self.still_std_radps + self.still_std_share * window.angular_rate_std_radps
            rate = window.angular_rate_radps
            innovation, noise = rate - bank[0][:, _BIAS], std**2 * _IDENTITY_3
            rotating_noise = noise + self.turning_radps**2 * window.up_sensor[:, None] * window.up_sensor
            odds = self.even_turn_prob / (1.0 - self.even_turn_prob)
            still, rotating = _innovation_densities(bank, innovation, np.array([noise, rotating_noise]))
            is_rotating = _likelihood(bank, still) < odds * _likelihood(bank, rotating)
            outlier = _outlier_log_density(_dot(rate, rate), 3, self.turning_radps)
            bank = _update_bias(bank, innovation, rotating if is_rotating else still, self.still_outlier_prob, outlier)
        return bank, n_still + 1

    def _update_walk(
        self, bank: _Bank, walk: StraightWalk | None, window: BiasWindow, measured_rad: float
    ) -> tuple[_Bank, StraightWalk | None]:
        """Return the bank of filters and the straight walk after a window.

        When a straight walk ends, it updates the bank. The walk is None if the pedestrian does not walk. `measured_rad`
        is the uncorrected heading in the window.
        """
        if window.specific_force_std_mps2 < self.walking_acc_mps2:
            return self._measure_walk(bank, walk), None
        if walk is not None:
            late = walk.heading_rad
            is_corner = abs(window.heading_rad - sum(late) / len(late)) > self.corner_rad
            # After a tilt the phone is held in another way, and its heading is not comparable to earlier ones.
            if is_corner or _dot(walk.up_sensor, window.up_sensor) < math.cos(self.tilted_rad):
                bank, walk = self._measure_walk(bank, walk), None
        if walk is None:
            return bank, StraightWalk((window.heading_rad,), (measured_rad,), window.up_sensor, 0)
        late = (*walk.heading_rad, window.heading_rad)[-2:]
        if walk.n_to_skip > 0:
            return bank, replace_unchecked(walk, heading_rad=late, n_to_skip=walk.n_to_skip - 1)
        walk = replace_unchecked(walk, heading_rad=late, measured_rad=(*walk.measured_rad, measured_rad))
        if len(walk.measured_rad) >= round(self.straight_s[1] / self.window_s) + 2:
            bank = self._measure_walk(bank, walk)
            walk = replace_unchecked(walk, measured_rad=(), n_to_skip=round(self.straight_again_s / self.window_s))
        return bank, walk

    def _measure_walk(self, bank: _Bank, walk: StraightWalk | None) -> _Bank:
        """Return the filter bank (see `_Bank`) updated with a straight walk, or unchanged if the walk is too short.

        While the pedestrian walks straight, a drift of the uncorrected heading is due to the bias. The negative slope
        of that heading measures the bias about the vertical. The first and the last window are not used.
        """
        n = 0 if walk is None else len(walk.measured_rad) - 2
        if walk is None or n * self.window_s < self.straight_s[0]:
            return bank
        measured_rad, up = np.array(walk.measured_rad[1:-1]), walk.up_sensor
        from_centre_s = (np.arange(n) - 0.5 * (n - 1)) * self.window_s
        rate_radps = -float((from_centre_s * measured_rad).sum() / (from_centre_s * from_centre_s).sum())
        variance = (self.straight_turn_rad / (n * self.window_s)) ** 2
        h = np.array([*up, 0.0, 0.0])
        outlier = _outlier_log_density(rate_radps**2, 1, self.curve_radps)
        innovation = rate_radps - bank[0].dot(h)
        return _update(bank, h, innovation, variance, self.straight_outlier_prob, outlier)[0]

    def _update_field(
        self, bank: _Bank, state: GyroBiasState, window: BiasWindow
    ) -> tuple[_Bank, FieldScatter | None, bool, int]:
        """Return the bank of filters updated with the magnetic field direction of a window, and the field's new state.

        The state of the field is its scatter, whether its direction is tracked, and the number of consecutive outliers.
        A window without a known field resets this state and leaves the bank unchanged.
        """
        if not window.magnetic_field_known:
            return bank, None, False, 0
        east, north, up = window.magnetic_field_ut.tolist()
        direction_rad = math.atan2(east, north)
        before = state.field
        field, variance_ut2 = self._scatter(before, math.hypot(east, north), up, direction_rad)
        if field.n_windows * self.window_s < self.field_correlation_s:
            return bank, field, state.field_tracked, state.n_field_outliers
        # Windows within twice the correlation time carry the information of one, so the variance is that much larger.
        inflation = 2 * self.field_correlation_s / self.window_s
        horizontal_ut = max(field.horizontal_ut, 1.0)
        scatter = self.field_scatter_weight * variance_ut2 / horizontal_ut**2
        variance = inflation * (scatter + self.field_std_rad**2)
        mean, _, _ = bank
        change_rad = 0.0 if before is None else float(_wrap(direction_rad - before.direction_rad))
        jump_rad = max(self.field_jump_rad, self.field_jump_scatter * math.sqrt(variance_ut2) / horizontal_ut)
        if state.field_tracked and abs(change_rad) < jump_rad:
            innovation = _wrap(direction_rad - mean[:, _FIELD])
            bank, inlier = _update(bank, _H_FIELD, innovation, variance, self.field_outlier_prob, _LOG_ANY_DIRECTION)
            weight = np.exp(bank[2])
            inlier_prob = float(weight.dot(inlier)) / float(np.add.reduce(weight))
            n_outliers = state.n_field_outliers + 1 if inlier_prob < 0.5 else 0
            if n_outliers * self.window_s < 2 * self.field_correlation_s:
                return bank, field, True, n_outliers
            # Persistent outliers mean that the field differs at this place: start again.
        return _with_measured_element(bank, _FIELD, direction_rad, variance), field, True, 0

    def _scatter(
        self, field: FieldScatter | None, horizontal_ut: float, up_ut: float, direction_rad: float
    ) -> tuple[FieldScatter, float]:
        """Return the mean and scatter of the field updated with a window, and a variance of the field in this window.

        The variance in uT2 is the updated mean variance of the horizontal field strength and the vertical field. Half
        of the squared deviation of this window from their means is added to it.
        """
        if field is None:
            return FieldScatter(1, horizontal_ut, up_ut, 0.0, direction_rad), 0.0
        n = field.n_windows + 1
        gain = max(1.0 / n, self.window_s / self.field_memory_s)
        along_ut, upward_ut = horizontal_ut - field.horizontal_ut, up_ut - field.up_ut
        own_ut2 = 0.5 * (along_ut * along_ut + upward_ut * upward_ut)
        variance_ut2 = (1.0 - gain) * (field.variance_ut2 + gain * own_ut2)
        mean_ut = field.horizontal_ut + gain * along_ut, field.up_ut + gain * upward_ut
        return FieldScatter(n, *mean_ut, variance_ut2, direction_rad), variance_ut2 + own_ut2

    @cached_property
    def process_noise(self) -> FloatArray:
        """Process noise covariance of one window, shape (5, 5)."""
        bias_var, field_var = self.walk_radps_per_sqrt_s**2, self.field_walk_rad_per_sqrt_s**2
        return self.window_s * np.diag((bias_var, bias_var, bias_var, field_var, 0.0))


# Filter bank: means (M, 5), covariances (M, 5, 5) and log weights (M,) of M parallel Kalman filters.
_Bank = tuple[FloatArray, FloatArray, FloatArray]
# Lower bound of the log weights, so that later measurements can still raise the weight of a filter.
_MIN_LOG_WEIGHT = -12.0


def _predict(bias: GyroBias, bank: _Bank, up_sensor: FloatArray, correction_rad: float) -> _Bank:
    """Return the bank of Kalman filters predicted over one window (equations in docs/methods/attitude.md).

    `correction_rad` is the turn by which the bias estimate in use corrects the heading. Headings are clockwise, the
    bias is counter-clockwise.
    """
    mean, cov, log_weight = bank
    transition = _IDENTITY.copy()
    transition[_HEADINGS, _BIAS] = -bias.window_s * up_sensor
    mean = mean.dot(transition.T)
    mean[:, _HEADINGS] += correction_rad
    return mean, transition @ cov @ transition.T + bias.process_noise, log_weight


def _update(
    bank: _Bank, h: FloatArray, innovation: FloatArray, variance: float, outlier_prob: float, outlier_log_density: float
) -> tuple[_Bank, FloatArray]:
    """Return the bank after a scalar measurement h' x that may be an outlier, and the inlier probabilities (M,).

    The state x (5,) of each of the M filters is the bias (3,), the field direction and the heading error. `h` (5,) is
    the derivative of the measurement with respect to x, and `innovation` (M,) the residual of each filter. With P the
    covariance of a filter, g = P h is the covariance of state and innovation, and S = h' g + `variance` the variance of
    the innovation (`values.mixtures.possible_outlier`).
    """
    mean, cov, log_weight = bank
    g = cov @ h
    S = g.dot(h) + variance
    shift = innovation / S
    log_in = math.log1p(-outlier_prob) - 0.5 * (np.log(S) + innovation * shift)
    log_out = math.log(outlier_prob) + outlier_log_density
    log_both, inlier, by_mean, by_cov = possible_outlier(log_in, log_out, shift, S)
    mean = mean + by_mean[:, None] * g
    cov = cov + (by_cov[:, None] * g)[:, :, None] * g[:, None, :]
    return (mean, cov, _relative(log_weight + log_both)), inlier


def _update_bias(
    bank: _Bank,
    innovation: FloatArray,
    predicted: tuple[FloatArray, FloatArray],
    outlier_prob: float,
    outlier_log_density: float,
) -> _Bank:
    """Return the bank of M Kalman filters (see `_Bank`) after a measurement of the gyroscope bias (3,), in rad/s.

    The measurement may be an outlier, with probability `outlier_prob` and log density `outlier_log_density`. Each
    filter has its innovation, (M, 3), and `predicted` is a result of `_innovation_densities`. Each filter is updated
    with the mixture of an accepted and a rejected measurement, and its weight with the likelihood of the mixture.
    """
    mean, cov, log_weight = bank
    hp = cov[:, _BIAS]
    inverse, log_density = predicted
    log_in = math.log1p(-outlier_prob) + log_density
    log_both = np.logaddexp(log_in, math.log(outlier_prob) + outlier_log_density)
    inlier = np.exp(log_in - log_both)
    gain = np.swapaxes(hp, 1, 2) @ inverse
    shift = (gain @ innovation[:, :, None])[:, :, 0]
    mean = mean + inlier[:, None] * shift
    spread = ((inlier * (1.0 - inlier))[:, None] * shift)[:, :, None] * shift[:, None, :]
    cov = cov - (inlier[:, None, None] * gain) @ hp + spread
    return mean, 0.5 * (cov + np.swapaxes(cov, 1, 2)), _relative(log_weight + log_both)


def _relative(log_weight: FloatArray) -> FloatArray:
    """Return log weights shifted so that the largest is 0, and bounded below by `_MIN_LOG_WEIGHT`."""
    return np.maximum(log_weight - np.maximum.reduce(log_weight), _MIN_LOG_WEIGHT)


def _innovation_densities(
    bank: _Bank, innovation: FloatArray, noise: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return the inverse innovation covariances (M, 3, 3) of a bias measurement, and its log densities (M,).

    `noise` (K, 3, 3) are K alternative covariances of the measurement, and the result has a pair for each. The log
    densities lack a common constant.
    """
    inverse = np.asarray(np.linalg.inv(bank[1][:, _BIAS, _BIAS] + noise[:, None]), dtype=np.float64)
    log_det = np.log(np.linalg.det(inverse))
    square = (innovation[:, None, :] @ inverse @ innovation[:, :, None])[:, :, 0, 0]
    return zip(inverse, 0.5 * (log_det - square), strict=True)


def _likelihood(bank: _Bank, predicted: tuple[FloatArray, FloatArray]) -> float:
    """Return the likelihood of a measurement under the mixture of all filters, up to a constant factor."""
    return float(np.add.reduce(np.exp(bank[2] + predicted[1])))


def _with_measured_element(bank: _Bank, index: int, start: float, variance: float) -> _Bank:
    """Return the bank of filters with one element of each state reset to a measured value.

    The element is then uncorrelated with the other elements.
    """
    mean, cov = bank[0].copy(), bank[1].copy()
    mean[:, index] = start
    cov[:, index, :] = 0.0
    cov[:, :, index] = 0.0
    cov[:, index, index] = variance
    return mean, cov, bank[2]


def _outlier_log_density(square: float, n: int, std: float) -> float:
    """Return the log density of an outlier: a normal distribution in n dimensions.

    The constant that `_update` omits is omitted here as well.
    """
    return -0.5 * square / std**2 - n * math.log(std)


def _wrap(angle_rad: FloatArray | float) -> FloatArray:
    """Return an angle wrapped to half a turn on either side of zero."""
    return angle_rad - 2 * math.pi * np.rint(angle_rad / (2 * math.pi))


def _mixture(bank: _Bank) -> tuple[FloatArray, FloatArray]:
    """Return the mean (5,) and covariance (5, 5) of the mixture of all Kalman filters of a bank (see `_Bank`)."""
    mean, cov, log_weight = bank
    weight = np.exp(log_weight)
    return combine(mean, cov, weight / np.add.reduce(weight))


def _direction(bank: _Bank) -> tuple[float, float]:
    """Return the heading error of the mixture and its variance, both computed on the circle.

    Filter j of the bank has the weight w_j, and its heading error the mean m_j and the variance P_j. The resultant of
    these wrapped normal distributions is r = sum_j w_j exp(i m_j - P_j / 2). The error is the direction of r, with the
    number of full turns of the most probable filter. The variance is -2 log |r|, at most the variance of a uniform
    heading. Linear moments would be wrong: the linear mean of errors of 0 and 7 rad is a direction that no filter has.
    """
    mean, cov, log_weight = bank
    errors_rad = mean[:, _ERROR].tolist()
    weights, shrunk = np.exp([log_weight, log_weight - 0.5 * cov[:, _ERROR, _ERROR]])
    resultant = complex(np.add.reduce([cmath.rect(*polar) for polar in zip(shrunk.tolist(), errors_rad, strict=True)]))
    length = abs(resultant) / float(np.add.reduce(weights))
    likely_rad = errors_rad[log_weight.argmax()]
    error_rad = likely_rad + cmath.phase(resultant * cmath.exp(-1j * likely_rad))
    return error_rad, min(-2.0 * math.log(max(length, 1e-9)), UNKNOWN_VAR_RAD2)


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the dot product of two vectors (3,) in plain floats, which is faster than NumPy."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return x * u + y * v + z * w
