"""What the gyroscope reads when nothing turns: its bias, learnt while the phone is carried, with its uncertainty.

Three kinds of measurement enter a Kalman filter, each weak, each with a variance of its own, and each perhaps wrong, so
that an outlier hardly moves the estimate (docs/methods/attitude.md):

1. Still windows. The mean angular rate of a window in which nothing moves is the bias, or an even turn, as in a train:
   that is about the vertical, a bias about any axis. As long as a turn is more probable nothing is learnt there.
2. Straight walking. Somebody who walks from corner to corner turned little in between. A long curve counts as one walk,
   or the bias would follow it.
3. The magnetic field should not turn in the attitude's frame. Only its drift counts, never where it points; how far it
   is trusted follows from the scatter of its horizontal and vertical parts. After a jump it starts again.

Each filter also holds by how much the heading is off that was corrected with the estimates so far. A bias that is found
late has turned the heading before: its estimate brings that error with it. What a building's axes say of it is
`pdr_filter.sensing.heading.corridors`.

The bias is about the three axes of the sensor, so what is learnt with the phone in the hand still holds, as far as it
goes, when it hangs in the pocket. Most phones subtract a bias of their own and are off by little, some are not: the
prior is a mixture of normal distributions, each with a Kalman filter of its own, weighted by how well it predicts
(D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans. Automatic Control 10(4), 1965,
doi:10.1109/TAC.1965.1098191). A measurement enters with the probability that it is no outlier, and the doubt that
leaves is added to the covariance (Y. Bar-Shalom, F. Daum, J. Huang, "The probabilistic data association filter", IEEE
Control Systems 29(6), 2009, doi:10.1109/MCS.2009.934469). Walking as a measurement: J. Borenstein, L. Ojeda, "Heuristic
drift elimination for personnel tracking systems", Journal of Navigation 63(4), 2010. Figures:
tests/benchmarks/heading_drift.py.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.sensing.device import Device
from pdr_filter.sensing.heading.heading_offset import UNKNOWN_VAR_RAD2
from pdr_filter.values import FloatArray, check_numbers, read_only, replace_unchecked
from pdr_filter.values.mixtures import combine, possible_outlier

# State of each Kalman filter: bias about x, y, z of the sensor in rad/s; direction of the magnetic field in the
# attitude's frame, and by how much the corrected heading is too large, in rad, clockwise.
_BIAS, _FIELD, _ERROR = slice(0, 3), 3, 4
_HEADINGS = slice(3, 5)  # both
_N_STATES = 5
_IDENTITY = read_only(np.eye(_N_STATES))
_OF_FIELD, _OF_ERROR = read_only(_IDENTITY[_FIELD]), read_only(_IDENTITY[_ERROR])


@dataclass(frozen=True, slots=True, eq=False)
class BiasWindow:
    """What one window says of the bias: means over its samples, and standard deviations summed over the axes."""

    angular_rate_radps: FloatArray  # (3,) as measured
    angular_rate_std_radps: float
    specific_force_std_mps2: float
    up_sensor: FloatArray  # (3,) unit vector
    heading_rad: float  # as corrected, not wrapped
    angular_rate_known: bool  # in all samples
    magnetic_field_ut: FloatArray  # (3,) east, north, up of the attitude's frame
    magnetic_field_known: bool  # in all samples


@dataclass(frozen=True, eq=False)
class StraightWalk:
    """Windows of somebody who walks and has not turned a corner, newest last."""

    heading_rad: tuple[float, ...]  # corrected, of the last two: to see a corner
    measured_rad: tuple[float, ...]  # uncorrected, of those to measure: its slope is the bias
    up_sensor: FloatArray  # (3,) in the first window
    n_to_skip: int  # windows until it is measured again


@dataclass(frozen=True, slots=True, eq=False)
class FieldScatter:
    """Magnetic field of late."""

    n_windows: int
    horizontal_ut: float  # mean
    up_ut: float  # mean
    variance_ut2: float  # of one of them
    direction_rad: float  # in the last window


@dataclass(frozen=True, eq=False)
class GyroBiasState:
    """A bank of Kalman filters, and what the measurements need of the windows before."""

    mean: FloatArray  # (M, 5)
    cov: FloatArray  # (M, 5, 5)
    log_weight: FloatArray  # (M,) largest is 0
    bias_radps: FloatArray  # (3,) mean of the mixture
    bias_cov_radps2: FloatArray  # (3, 3) of the mixture
    heading_error_rad: float = 0.0  # of the corrected heading since the start, of the mixture
    heading_error_var_rad2: float = 0.0
    # Variance that the heading has gained by the uncertain bias since the start, before any measurement took it away:
    # what the filter behind must add, because each measurement reaches it on its own.
    heading_lost_var_rad2: float = 0.0
    corrected_rad: float = 0.0  # what the estimates so far have turned the heading by
    n_still: int = 0  # still windows in a row
    walk: StraightWalk | None = None
    field: FieldScatter | None = None
    field_tracked: bool = False
    n_field_outliers: int = 0  # in a row


@dataclass(frozen=True)
class GyroBias:
    """Gyroscope bias from still windows, straight walking and the drift of the magnetic field.

    Parameters
    ----------
    window_s : float
        Length of the windows. One second averages a step or two, and the turning that each brings.
    prior_std_radps, prior_prob : tuple of float
        The mixture the bias comes from: phones that calibrate themselves (the drifts of known walks here are 0.002 to
        0.006 rad/s), less well (0.02), and not (0.03 to 0.04 on the phones of 4 of 13 people of ubicomp13; 0.1 was
        seen elsewhere). With more weight on the wild ones the ellipses of walks that teach little grow far too large
        (humolire, ms_indoor).
    device, device_prob : Device or None, float
        What an earlier recording of the phone knew, and with which probability it is this one still.
    walk_radps_per_sqrt_s : float
        Random walk of the bias: 0.002 rad/s in five minutes of warming up.
    still_gyr_radps, still_acc_mps2 : float
        A window is still below both standard deviations, and used if the one before was too.
    still_max_radps : float
        No bias is above this; what is still and faster turns evenly.
    still_std_radps, still_std_share : float
        Standard deviation of the mean of a still window: a constant and a share of that within it. On people who stand
        with a phone in hand or pocket the means of 1 s scatter by 0.45 to 0.6 of it; 0.8 for their correlation in time.
    still_outlier_prob, turning_radps : float
        How often a still window has another mean, and how far off.
    even_turn_prob : float
        How often what is still turns evenly about the vertical, as fast as `turning_radps`: in a vehicle, on a
        turntable. All windows of it do, so that they are no witnesses against each other.
    walking_acc_mps2 : float
        Above this standard deviation somebody walks.
    corner_rad, tilted_rad : float
        A change of direction from the last two windows, and of gravity since the first, that ends a straight walk.
    straight_s : tuple of float
        Shortest and longest straight walk that is one measurement. A window at each end is not used, because corners
        are round. The turn in a straight walk does not grow with its length (0.15 to 0.2 rad between 4 and 70 s on
        paths outdoors), so a longer walk determines the bias better.
    straight_again_s : float
        A walk that goes on without a corner is measured again only so much later: a curve looks the same all along.
    straight_turn_rad : float
        How far somebody turns (standard deviation) in a straight walk, whatever its length.
    straight_outlier_prob, curve_radps : float
        Probability that a walk is curved, and the standard deviation of the curve. At most 7 % of the straight walks of
        sisfall, motionsense, terrain and oxiod turn by more than 0.6 rad.
    field_memory_s : float
        Time constant of the mean and the scatter of the field.
    field_correlation_s : float
        How long a disturbance lasts while somebody walks past it: windows closer than that are not independent.
    field_scatter_weight : float
        Variance of the direction for the variance of the field's parts, relative to the horizontal field.
    field_std_rad : float
        Of the direction in an undisturbed field: attitude and calibration.
    field_walk_rad_per_sqrt_s : float
        Random walk of the field's direction from place to place: in buildings it was seen to turn by 0.7 rad along
        a corridor of a minute, smoothly and with hardly a change of its size.
    field_jump_rad, field_jump_scatter : float
        After a larger change since the last window the direction starts again: no bias does that. Nor is it a jump
        within so many standard deviations of the field's scatter: who circles among iron furniture sees the same
        field again, and it tells the drift from lap to lap.
    field_outlier_prob : float
        How often the direction is anything.
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
                f"prior_std_radps and prior_prob must be equally long, got {len(self.prior_std_radps)} and "
                f"{len(self.prior_prob)}"
            )
        if len(self.straight_s) != 2 or self.straight_s[0] > self.straight_s[1]:
            raise ValueError(f"straight_s must be the shortest and the longest time, got {self.straight_s}")

    def init(self) -> GyroBiasState:
        """State before the first window: the prior."""
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
        """State that keeps the bias and forgets what the windows before a time without samples were."""
        return replace_unchecked(state, n_still=0, walk=None, field=None, field_tracked=False, n_field_outliers=0)

    def update(self, state: GyroBiasState, window: BiasWindow) -> GyroBiasState:
        """State after one more window, whose heading was corrected with the bias of the state before."""
        if not window.angular_rate_known:
            return self.after_gap(state)
        correction_rad = self.window_s * _dot(window.up_sensor, state.bias_radps)
        bank = _predict(self, (state.mean, state.cov, state.log_weight), window.up_sensor, correction_rad)
        # an angular rate about up lowers the heading, and so does its bias: without the correction it was so much less
        measured_rad = window.heading_rad - (state.corrected_rad + 0.5 * correction_rad)
        bank, n_still = self._see_still(bank, state.n_still, window)
        bank, walk = self._see_walk(bank, state.walk, window, measured_rad)
        bank, field, field_tracked, n_field_outliers = self._see_field(bank, state, window)
        mean, cov, log_weight = bank
        # The estimate uses the straight walk as far as it has come. It enters the bank once, when it ends: otherwise
        # all of its information would arrive at one moment, and move the track by metres there.
        estimate = self._measure_walk(bank, walk)
        of_all, cov_of_all = _mixture(estimate)
        error_rad, error_var_rad2 = _direction(estimate)
        before = self._measure_walk((state.mean, state.cov, state.log_weight), state.walk)
        _, predicted_var_rad2 = _direction(_predict(self, before, window.up_sensor, correction_rad))
        lost_rad2 = max(predicted_var_rad2 - state.heading_error_var_rad2, 0.0)
        return replace_unchecked(
            state,
            mean=mean,
            cov=cov,
            log_weight=log_weight,
            bias_radps=of_all[_BIAS].copy(),
            bias_cov_radps2=cov_of_all[_BIAS, _BIAS].copy(),
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

    def learnt(self, state: GyroBiasState, error_rad: float = 0.0, error_var_rad2: float = math.inf) -> Device:
        """What is known of the phone; where something else has shown the error of the heading, from that too."""
        bank = state.mean, state.cov, state.log_weight
        if math.isfinite(error_var_rad2):
            bank, _ = _update(bank, _OF_ERROR, error_rad - state.mean[:, _ERROR], error_var_rad2, 1e-9, 0.0)
        bias, bias_cov = _mixture(bank)
        return Device(bias[_BIAS].copy(), bias_cov[_BIAS, _BIAS].copy())

    def _see_still(self, bank: _Bank, n_still: int, window: BiasWindow) -> tuple[_Bank, int]:
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
            innovation, noise = rate - bank[0][:, _BIAS], std**2 * np.eye(3)
            turn = noise + self.turning_radps**2 * window.up_sensor[:, None] * window.up_sensor
            odds = self.even_turn_prob / (1.0 - self.even_turn_prob)
            if _likelihood(bank, innovation, noise) < odds * _likelihood(bank, innovation, turn):
                noise = turn
            otherwise = _outlier_log_density(_dot(rate, rate), 3, self.turning_radps)
            bank = _update_bias(bank, innovation, noise, self.still_outlier_prob, otherwise)
        return bank, n_still + 1

    def _see_walk(
        self, bank: _Bank, walk: StraightWalk | None, window: BiasWindow, measured_rad: float
    ) -> tuple[_Bank, StraightWalk | None]:
        if window.specific_force_std_mps2 < self.walking_acc_mps2:
            return self._measure_walk(bank, walk), None
        if walk is not None:
            late = walk.heading_rad
            is_corner = abs(window.heading_rad - sum(late) / len(late)) > self.corner_rad
            # held in another way, the phone points somewhere else
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
        """The slope of the uncorrected heading, without the first and the last window, is the bias."""
        n = 0 if walk is None else len(walk.measured_rad) - 2
        if walk is None or n * self.window_s < self.straight_s[0]:
            return bank
        measured_rad, up = np.array(walk.measured_rad[1:-1]), walk.up_sensor
        from_centre_s = (np.arange(n) - 0.5 * (n - 1)) * self.window_s
        rate_radps = -float((from_centre_s * measured_rad).sum() / (from_centre_s * from_centre_s).sum())
        variance = (self.straight_turn_rad / (n * self.window_s)) ** 2
        of_rate = np.array([*up, 0.0, 0.0])
        otherwise = _outlier_log_density(rate_radps**2, 1, self.curve_radps)
        seen = rate_radps - bank[0].dot(of_rate)
        return _update(bank, of_rate, seen, variance, self.straight_outlier_prob, otherwise)[0]

    def _see_field(
        self, bank: _Bank, state: GyroBiasState, window: BiasWindow
    ) -> tuple[_Bank, FieldScatter | None, bool, int]:
        """The bank, and what is known of the field: scatter, whether it is tracked, and outliers in a row."""
        if not window.magnetic_field_known:
            return bank, None, False, 0
        east, north, up = window.magnetic_field_ut.tolist()
        direction_rad = math.atan2(east, north)
        before = state.field
        field, variance_ut2 = self._scatter(before, math.hypot(east, north), up, direction_rad)
        if field.n_windows * self.window_s < self.field_correlation_s:
            return bank, field, state.field_tracked, state.n_field_outliers
        # the variance of a mean of correlated samples
        independent = 2 * self.field_correlation_s / self.window_s
        horizontal_ut = max(field.horizontal_ut, 1.0)
        scatter = self.field_scatter_weight * variance_ut2 / horizontal_ut**2
        variance = independent * (scatter + self.field_std_rad**2)
        mean, _, _ = bank
        change_rad = 0.0 if before is None else float(_wrapped(direction_rad - before.direction_rad, 2 * math.pi))
        jump_rad = max(self.field_jump_rad, self.field_jump_scatter * math.sqrt(variance_ut2) / horizontal_ut)
        if state.field_tracked and abs(change_rad) < jump_rad:
            seen = _wrapped(direction_rad - mean[:, _FIELD], 2 * math.pi)
            otherwise = _uniform_log_density(2 * math.pi)
            bank, inlier_prob = _update(bank, _OF_FIELD, seen, variance, self.field_outlier_prob, otherwise)
            n_outliers = state.n_field_outliers + 1 if inlier_prob < 0.5 else 0
            if n_outliers * self.window_s < 2 * self.field_correlation_s:
                return bank, field, True, n_outliers
            # another place, another field: start again
        return _restarted(bank, _FIELD, direction_rad, variance), field, True, 0

    def _scatter(
        self, field: FieldScatter | None, horizontal_ut: float, up_ut: float, direction_rad: float
    ) -> tuple[FieldScatter, float]:
        """Mean and scatter with this window, and the variance to assume for it."""
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
    def wander_cov(self) -> FloatArray:
        """Covariance (5, 5) that a window adds."""
        of_bias, of_field = self.walk_radps_per_sqrt_s**2, self.field_walk_rad_per_sqrt_s**2
        return self.window_s * np.diag((of_bias, of_bias, of_bias, of_field, 0.0))


_Bank = tuple[FloatArray, FloatArray, FloatArray]  # means, covariances, log weights
# A filter is not written off for good: later measurements may speak for it.
_MIN_LOG_WEIGHT = -12.0


def _predict(bias: GyroBias, bank: _Bank, up_sensor: FloatArray, correction_rad: float) -> _Bank:
    """The bank one window later (docs/methods/attitude.md); headings turn clockwise, the bias does not."""
    mean, cov, log_weight = bank
    transition = _IDENTITY.copy()
    transition[_HEADINGS, _BIAS] = -bias.window_s * up_sensor
    mean = mean.dot(transition.T)
    mean[:, _HEADINGS] += correction_rad
    return mean, transition @ cov @ transition.T + bias.wander_cov, log_weight


def _update(
    bank: _Bank, h: FloatArray, innovation: FloatArray, variance: float, outlier_prob: float, outlier_log_density: float
) -> tuple[_Bank, float]:
    """The bank after a measurement of a number h x, (5,), and the probability that it is no outlier.

    Innovations are (M,). g = P h, S = h' g + `variance` (`values.mixtures.possible_outlier`).
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
    log_weight = _relative(log_weight + log_both)
    weight = np.exp(log_weight)
    return (mean, cov, log_weight), float(weight.dot(inlier)) / float(np.add.reduce(weight))


def _update_bias(
    bank: _Bank, innovation: FloatArray, noise: FloatArray, outlier_prob: float, outlier_log_density: float
) -> _Bank:
    """The bank after a measurement of the bias: the same for innovations (M, 3), R = `noise` (3, 3)."""
    mean, cov, log_weight = bank
    hp = cov[:, _BIAS]
    inverse, log_density = _predicted(hp, innovation, noise)
    log_in = math.log1p(-outlier_prob) + log_density
    log_both = np.logaddexp(log_in, math.log(outlier_prob) + outlier_log_density)
    inlier = np.exp(log_in - log_both)
    gain = np.swapaxes(hp, 1, 2) @ inverse
    shift = (gain @ innovation[:, :, None])[:, :, 0]
    mean = mean + inlier[:, None] * shift
    doubt = ((inlier * (1.0 - inlier))[:, None] * shift)[:, :, None] * shift[:, None, :]
    cov = cov - (inlier[:, None, None] * gain) @ hp + doubt
    return mean, 0.5 * (cov + np.swapaxes(cov, 1, 2)), _relative(log_weight + log_both)


def _relative(log_weight: FloatArray) -> FloatArray:
    """Log weights whose largest is 0."""
    return np.maximum(log_weight - np.maximum.reduce(log_weight), _MIN_LOG_WEIGHT)


def _predicted(hp: FloatArray, innovation: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of the covariance (M, 3, 3) of innovations of the bias, and their log densities (M,) but for a constant.

    `hp` (M, 3, 5) are the rows of the bias in the covariances.
    """
    inverse = np.asarray(np.linalg.inv(hp[:, :, _BIAS] + noise), dtype=np.float64)
    log_det = np.log(np.linalg.det(inverse))
    square = (innovation[:, None, :] @ inverse @ innovation[:, :, None])[:, 0, 0]
    return inverse, 0.5 * (log_det - square)


def _likelihood(bank: _Bank, innovation: FloatArray, noise: FloatArray) -> float:
    """Density of a measurement of the bias over the bank, but for a constant."""
    _, cov, log_weight = bank
    _, log_density = _predicted(cov[:, _BIAS], innovation, noise)
    return float(np.exp(log_weight + log_density).sum())


def _restarted(bank: _Bank, index: int, start: float, variance: float) -> _Bank:
    """The bank with one state as just measured, independent of the others."""
    mean, cov = bank[0].copy(), bank[1].copy()
    mean[:, index] = start
    cov[:, index, :] = 0.0
    cov[:, :, index] = 0.0
    cov[:, index, index] = variance
    return mean, cov, bank[2]


def _outlier_log_density(square: float, n: int, std: float) -> float:
    """Logarithm of a normal density in n dimensions, with the constant left out that `_update` leaves out."""
    return -0.5 * square / std**2 - n * math.log(std)


def _uniform_log_density(width: float) -> float:
    return 0.5 * math.log(2 * math.pi) - math.log(width)


def _wrapped(angle_rad: FloatArray | float, period_rad: float) -> FloatArray:
    return angle_rad - period_rad * np.rint(angle_rad / period_rad)


def _mixture(bank: _Bank) -> tuple[FloatArray, FloatArray]:
    """Mean (5,) and covariance (5, 5) over the bank."""
    mean, cov, log_weight = bank
    weight = np.exp(log_weight)
    return combine(mean, cov, weight / np.add.reduce(weight))


def _direction(bank: _Bank) -> tuple[float, float]:
    """Return the heading error of the mixture and its variance, both on the circle.

    The resultant of wrapped normal distributions is r = sum_j w_j exp(i m_j - P_j / 2); the error is its direction,
    with the turns of the most probable filter, and the variance -2 log |r|, that of a uniform heading at most. The
    linear mean of errors of 0 and 7 rad is a direction that no filter has; its variance says nothing of a circle.
    """
    mean, cov, log_weight = bank
    error = mean[:, _ERROR]
    resultant = complex((np.exp(log_weight - 0.5 * cov[:, _ERROR, _ERROR]) * np.exp(1j * error)).sum())
    length = abs(resultant) / float(np.exp(log_weight).sum())
    likely_rad = float(error[log_weight.argmax()])
    error_rad = likely_rad + cmath.phase(resultant * cmath.exp(-1j * likely_rad))
    return error_rad, min(-2.0 * math.log(max(length, 1e-9)), UNKNOWN_VAR_RAD2)


def _dot(a: FloatArray, b: FloatArray) -> float:
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return x * u + y * v + z * w
