from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pdr_filter.sensing.device import Device
from pdr_filter.sensing.gyroscope_bias import BiasWindow, GyroBias, GyroBiasState

READING = np.array([0.0, np.sin(0.7), np.cos(0.7)])
NO_FIELD = np.zeros(3)


@dataclass
class Phone:
    """Phone whose heading is corrected by the estimated bias, window by window."""

    bias_radps: np.ndarray
    estimator: GyroBias
    up: np.ndarray
    state: GyroBiasState
    heading_rad: float = 0.0
    field_rad: float = 0.4  # clockwise, in the attitude's frame
    heading_error_rad: float = 0.0  # of the corrected heading

    @classmethod
    def of(cls, bias_radps: np.ndarray, estimator: GyroBias | None = None, up: np.ndarray = READING) -> Phone:
        estimator = GyroBias() if estimator is None else estimator
        return cls(np.asarray(bias_radps, dtype=float), estimator, up, estimator.init())

    @property
    def about_up_radps(self) -> float:
        return float(self.up @ self.state.bias_radps)

    def window(self, turn_radps: float = 0.0, **changes: object) -> BiasWindow:
        """A second of walking, turning clockwise, without magnetometer unless said otherwise."""
        drift_radps = float(self.up @ (self.bias_radps - self.state.bias_radps))
        middle_rad = self.heading_rad + 0.5 * (turn_radps - drift_radps)
        self.heading_rad += turn_radps - drift_radps
        self.field_rad -= drift_radps
        self.heading_error_rad -= drift_radps
        walking = BiasWindow(
            angular_rate_radps=self.bias_radps - turn_radps * self.up,
            angular_rate_std_radps=0.5,
            specific_force_std_mps2=2.0,
            up_sensor=self.up,
            heading_rad=middle_rad,
            angular_rate_known=True,
            magnetic_field_ut=NO_FIELD,
            magnetic_field_known=False,
        )
        return replace(walking, **changes)

    def see(self, window: BiasWindow) -> None:
        self.state = self.estimator.update(self.state, window)

    def walk(self, turns_radps: np.ndarray, wander_rad: np.ndarray | None = None) -> None:
        wander = np.zeros(len(turns_radps)) if wander_rad is None else wander_rad
        for turn, off in zip(turns_radps, wander, strict=True):
            window = self.window(float(turn))
            self.see(replace(window, heading_rad=window.heading_rad + float(off)))

    def rest(self, n: int, std: float = 0.01, noise: np.ndarray | None = None) -> None:
        for k in range(n):
            rate = self.bias_radps + (0.0 if noise is None else noise[k])
            self.see(self.window(angular_rate_radps=rate, angular_rate_std_radps=std, specific_force_std_mps2=0.05))

    def in_field(self, n: int, turn_radps: float = 0.0, disturbance_ut: np.ndarray | None = None) -> None:
        for k in range(n):
            window = self.window(turn_radps, specific_force_std_mps2=0.9)
            field = np.array([25 * np.sin(self.field_rad), 25 * np.cos(self.field_rad), -40.0])
            field = field if disturbance_ut is None else field + disturbance_ut[k]
            self.see(replace(window, magnetic_field_ut=field, magnetic_field_known=True))


def corridors(angles_rad: list[float], leg_s: int = 14) -> np.ndarray:
    """Turn rates of straight legs with corners of two seconds between them."""
    turns: list[float] = []
    for angle in angles_rad:
        turns += [0.0] * leg_s + [angle / 2] * 2
    return np.array(turns + [0.0] * leg_s)


# One normal prior, no outliers, no drift: the textbook case.
PLAIN = GyroBias(
    prior_std_radps=(0.02,),
    prior_prob=(1.0,),
    walk_radps_per_sqrt_s=0.0,
    still_outlier_prob=1e-12,
)


def test_still_windows_are_averaged_with_the_prior_by_their_variances() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(scale=0.01, size=(9, 3))
    phone = Phone.of(np.array([0.01, -0.02, 0.005]), PLAIN)
    phone.rest(9, std=0.02, noise=noise)
    # the first still window is not used
    variance = (PLAIN.still_std_radps + PLAIN.still_std_share * 0.02) ** 2
    information = 1 / 0.02**2 + 8 / variance
    expected = (phone.bias_radps + noise[1:]).sum(axis=0) / variance / information
    np.testing.assert_allclose(phone.state.bias_radps, expected, rtol=1e-6)
    np.testing.assert_allclose(phone.state.bias_cov_radps2, np.eye(3) / information, rtol=1e-6, atol=1e-12)


def test_the_mixture_is_the_posterior_that_integration_finds() -> None:
    estimator = replace(PLAIN, prior_std_radps=(0.01, 0.03), prior_prob=(0.8, 0.2), still_outlier_prob=0.3)
    phone = Phone.of(np.array([0.03, 0.01, 0.0]), estimator)
    phone.rest(2, std=0.0125)
    axis = np.linspace(-0.15, 0.15, 101)
    b = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    square = (b**2).sum(axis=-1)
    prior = sum(p * np.exp(-0.5 * square / s**2) / s**3 for p, s in ((0.8, 0.01), (0.2, 0.03)))
    std = estimator.still_std_radps + estimator.still_std_share * 0.0125
    inlier = np.exp(-0.5 * ((phone.bias_radps - b) ** 2).sum(axis=-1) / std**2) / std**3
    outlier_std = estimator.turning_radps
    outlier = np.exp(-0.5 * (phone.bias_radps**2).sum() / outlier_std**2) / outlier_std**3
    posterior = prior * (0.7 * inlier + 0.3 * outlier)
    posterior /= posterior.sum()
    mean = (posterior[..., None] * b).sum(axis=(0, 1, 2))
    away = b - mean
    cov = np.einsum("ijk,ijkl,ijkm->lm", posterior, away, away)
    np.testing.assert_allclose(phone.state.bias_radps, mean, atol=2e-6)
    np.testing.assert_allclose(phone.state.bias_cov_radps2, cov, atol=2e-8)


def test_the_motion_of_a_standing_hand_is_not_taken_for_a_bias() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        phone = Phone.of(np.zeros(3))
        phone.rest(5, std=0.03, noise=rng.normal(scale=0.015, size=(5, 3)))
        assert np.abs(phone.state.bias_radps).max() < 0.008
        assert np.sqrt(phone.state.bias_cov_radps2[0, 0]) < 0.02


def test_a_uniform_rotation_for_seconds_hardly_changes_the_bias() -> None:
    phone = Phone.of(np.zeros(3))
    phone.rest(3, std=0.03, noise=np.tile(0.3 * READING, (3, 1)))
    assert abs(phone.about_up_radps) < 0.002


@pytest.mark.parametrize("turn_radps", [0.05, -0.1])
def test_on_a_turntable_only_the_bias_about_the_other_axes_is_estimated(turn_radps: float) -> None:
    rng = np.random.default_rng(6)
    bias = np.array([0.004, 0.0, 0.0])
    phone = Phone.of(bias)
    phone.rest(60, std=0.003, noise=turn_radps * READING + rng.normal(scale=0.0005, size=(60, 3)))
    assert abs(phone.about_up_radps) < 0.002
    assert np.sqrt(READING @ phone.state.bias_cov_radps2 @ READING) > 0.003
    assert abs(phone.state.bias_radps[0] - 0.004) < 0.001


@pytest.mark.parametrize("turn_radps", [0.003, 0.02])
def test_a_rotation_as_slow_as_the_drift_of_phones_is_taken_for_a_bias(turn_radps: float) -> None:
    phone = Phone.of(turn_radps * READING)
    phone.rest(20, std=0.003)
    np.testing.assert_allclose(phone.state.bias_radps, turn_radps * READING, atol=0.001)


@pytest.mark.parametrize("bias", [-0.1, -0.03, 0.03, 0.1])
def test_straight_legs_between_corners_reveal_a_large_bias(bias: float) -> None:
    rng = np.random.default_rng(5)
    turns = corridors([1.0, -1.9, 0.8, 2.2, -1.3, 1.0])
    phone = Phone.of(bias * READING)
    phone.walk(turns, rng.normal(scale=0.03, size=len(turns)))
    assert phone.about_up_radps == pytest.approx(bias, abs=0.012)


@pytest.mark.parametrize("curve", [-0.04, 0.007, 0.04])
def test_a_long_curve_does_not_become_the_bias_of_a_good_phone(curve: float) -> None:
    rng = np.random.default_rng(6)
    turns = np.concatenate([np.zeros(40), np.full(120, curve)])
    phone = Phone.of(np.zeros(3))
    phone.walk(turns, rng.normal(scale=0.03, size=len(turns)))
    # a tenth of the curve, and about the bias of good phones
    assert abs(phone.about_up_radps) < 0.005


def test_a_bias_found_late_also_determines_the_heading_error_that_it_caused() -> None:
    for bias in (-0.02, 0.01):
        phone = Phone.of(bias * READING, replace(PLAIN, straight_outlier_prob=1e-12))
        phone.walk(corridors([1.0, -1.9, 0.8, 2.2, -1.3, 1.0]))
        truth_rad = phone.heading_error_rad
        assert abs(truth_rad) > 0.25
        error, std = phone.state.heading_error_rad, np.sqrt(phone.state.heading_error_var_rad2)
        assert error == pytest.approx(truth_rad, abs=2 * std)
        assert error == pytest.approx(truth_rad, rel=0.4)


def test_corridors_at_any_angles_do_not_bias_a_good_phone() -> None:
    worst = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        turns = corridors(list(rng.uniform(0.7, 2.4, 8) * rng.choice([-1, 1], 8)))
        phone = Phone.of(np.zeros(3))
        phone.walk(turns, rng.normal(scale=0.03, size=len(turns)))
        worst.append(abs(phone.about_up_radps))
    assert np.median(worst) < 0.001
    assert max(worst) < 0.004


@pytest.mark.parametrize("bias", [-0.02, 0.02, 0.1])
@pytest.mark.parametrize("turn_radps", [0.0, 0.5])
def test_a_rotating_magnetic_field_reveals_the_bias(bias: float, turn_radps: float) -> None:
    rng = np.random.default_rng(8)
    phone = Phone.of(bias * READING)
    phone.in_field(90, turn_radps, rng.normal(scale=1.5, size=(90, 3)))
    assert phone.about_up_radps == pytest.approx(bias, abs=0.004)


def test_iron_along_the_whole_way_does_not_bias_a_good_phone() -> None:
    rng = np.random.default_rng(9)
    phone = Phone.of(np.zeros(3))
    # lasting for some seconds each
    steps = rng.normal(scale=15.0, size=(30, 3)).repeat(4, axis=0)
    worst = 0.0
    for disturbance in steps:
        phone.in_field(1, 0.5, disturbance[None, :])
        worst = max(worst, abs(phone.about_up_radps))
    assert worst < 0.003


def test_iron_passed_in_every_lap_does_not_hide_the_drift() -> None:
    # sixteen seconds a lap: near the iron the field turns by more than 30 degrees from a second to the next
    phone = Phone.of(-0.013 * READING)
    angle = 2 * np.pi * np.arange(240) / 16
    for disturbance in 16.0 * np.column_stack([np.sin(angle), np.cos(angle), np.zeros(240)]):
        phone.in_field(1, 0.6, disturbance[None, :])
    assert phone.about_up_radps == pytest.approx(-0.013, abs=0.004)


def test_a_jump_of_the_field_direction_is_not_taken_for_drift() -> None:
    rng = np.random.default_rng(10)
    phone = Phone.of(np.zeros(3))
    phone.in_field(40, 0.5, rng.normal(scale=1.0, size=(40, 3)))
    phone.field_rad += 1.2
    for _ in range(60):
        phone.in_field(1, 0.5, rng.normal(scale=1.0, size=(1, 3)))
        assert abs(phone.about_up_radps) < 0.002


def test_a_field_that_turns_and_stays_is_an_outlier_first_and_is_then_tracked_again() -> None:
    rng = np.random.default_rng(10)
    phone = Phone.of(np.zeros(3))
    phone.in_field(40, 0.5, rng.normal(scale=1.0, size=(40, 3)))
    for turn in [0.4, 0.4, 0.4] + [0.0] * 60:  # three seconds, each too little for a jump
        phone.field_rad += turn
        phone.in_field(1, 0.5, rng.normal(scale=1.0, size=(1, 3)))
        assert abs(phone.about_up_radps) < 0.008
    assert abs(phone.about_up_radps) < 0.003


def test_errors_are_as_large_as_the_covariance_says() -> None:
    # biases from the prior, turns and scatter as the measurements assume, phones carried through corridors
    rng = np.random.default_rng(11)
    nees = []
    for _ in range(120):
        std = rng.choice(GyroBias().prior_std_radps, p=GyroBias().prior_prob)
        phone = Phone.of(rng.normal(scale=std, size=3))
        phone.rest(4, std=0.05, noise=rng.normal(scale=0.04, size=(4, 3)))
        for angle in rng.uniform(0.7, 2.4, 4):
            slope = rng.normal(scale=0.16 / 14)  # each leg a little bent
            phone.walk(np.concatenate([np.full(16, slope), np.full(2, angle / 2)]))
        phone.rest(3, std=0.05, noise=rng.normal(scale=0.04, size=(3, 3)))
        error = phone.state.bias_radps - phone.bias_radps
        nees.append(error @ np.linalg.solve(phone.state.bias_cov_radps2, error))
    # a mixture has heavier tails than a normal distribution with its covariance, so only the mean is tested
    low, high = chi2.ppf([0.001, 0.999], 3 * len(nees)) / len(nees)
    assert 0.6 * low < np.mean(nees) < 1.4 * high


def test_a_bias_learned_in_one_attitude_determines_its_component_in_another() -> None:
    phone = Phone.of(np.array([0.0, 0.03, 0.0]), up=np.array([0.0, 1.0, 0.0]))
    turns = corridors([1.0, -1.9, 0.8, 2.2, -1.3, 1.0])
    phone.walk(turns, np.random.default_rng(12).normal(scale=0.03, size=len(turns)))
    cov = phone.state.bias_cov_radps2
    upright, flat = np.sqrt(cov[1, 1]), np.sqrt(cov[2, 2])
    assert phone.state.bias_radps[1] == pytest.approx(0.03, abs=0.012)
    assert upright < 0.012 < flat
    assert abs(phone.state.bias_radps[2]) < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_phone_turned_in_the_hand_learns_the_same_bias_about_other_axes(seed: int) -> None:
    turn = Rotation.random(random_state=seed)
    rng = np.random.default_rng(seed)
    bias, noise = 0.02 * rng.normal(size=3), rng.normal(scale=0.01, size=(6, 3))
    turns = corridors([1.0, -1.9, 0.8])
    wander = rng.normal(scale=0.03, size=len(turns))
    one, other = Phone.of(bias), Phone.of(turn.apply(bias), up=turn.apply(READING))
    for phone, seen in ((one, noise), (other, turn.apply(noise))):
        phone.rest(6, std=0.02, noise=seen)
        phone.walk(turns, wander)
        phone.in_field(20, 0.3)
    np.testing.assert_allclose(other.state.bias_radps, turn.apply(one.state.bias_radps), atol=1e-9)


def test_the_estimate_starts_from_the_bias_of_an_earlier_recording() -> None:
    known = np.array([0.05, -0.1, 0.02])
    estimator = GyroBias(device=Device(known, 1e-8 * np.eye(3)), device_prob=0.999)
    phone = Phone.of(known, estimator)
    np.testing.assert_allclose(phone.state.bias_radps, 0.999 * known, rtol=1e-12)
    phone.rest(5)
    np.testing.assert_allclose(phone.state.bias_radps, known, atol=1e-6)
    # another phone than expected
    phone = Phone.of(np.zeros(3), estimator)
    phone.rest(30)
    np.testing.assert_allclose(phone.state.bias_radps, 0.0, atol=0.002)


def test_a_bias_of_another_phone_soon_does_not_fit() -> None:
    known = np.array([0.05, -0.1, 0.02])
    estimator = GyroBias(device=Device(known, 1e-8 * np.eye(3)))
    for true_radps, fits in ((known, True), (np.zeros(3), False)):
        phone = Phone.of(true_radps, estimator)
        assert estimator.device_fits(phone.state) == pytest.approx(0.9)
        phone.rest(5)
        assert (estimator.device_fits(phone.state) > 0.99) == fits
        assert (estimator.device_fits(phone.state) < 0.01) != fits
    assert GyroBias().device_fits(GyroBias().init()) == 1.0


ONE_PRIOR = GyroBias(prior_std_radps=(0.004,), prior_prob=(1.0,))


def test_a_smoothed_heading_error_is_a_measurement_of_the_bias() -> None:
    phone = Phone.of(0.003 * READING, ONE_PRIOR)
    for _ in range(100):
        phone.see(phone.window(turn_radps=0.5))
    learnt = ONE_PRIOR.device_from_smoothed(phone.state, phone.heading_error_rad, 1e-4, 4e-4, 0.0, READING)
    # independent errors of smoothing and drift over the time, and the random walk of the bias since the mean bias
    var = (1e-4 + 4e-4) / 100.0**2 + ONE_PRIOR.walk_radps_per_sqrt_s**2 * 100.0 / 3
    assert READING @ learnt.bias_radps == pytest.approx(0.003, abs=np.sqrt(var))
    assert READING @ learnt.bias_cov_radps2 @ READING == pytest.approx(var, rel=0.05)
    across = np.cross(READING, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(across @ learnt.bias_cov_radps2 @ across, 0.004**2, rtol=0.1)  # nothing is learnt there


def test_a_smoothed_error_that_is_hardly_better_than_the_gyroscope_teaches_nothing() -> None:
    phone = Phone.of(0.003 * READING)
    phone.walk(corridors([1.0, -1.9, 0.8]))
    expected, var_rad2 = phone.estimator.learnt_device(phone.state), phone.state.heading_error_var_rad2
    for share, teaches in ((0.3, False), (0.2, True)):
        learnt = phone.estimator.device_from_smoothed(phone.state, 0.0, share * var_rad2, 0.0, 0.0, READING)
        assert np.array_equal(learnt.bias_cov_radps2, expected.bias_cov_radps2) != teaches


def test_the_error_of_an_earlier_time_teaches_the_same_bias_as_that_of_the_end() -> None:
    phone, errors_rad = Phone.of(0.003 * READING, ONE_PRIOR), []
    for _ in range(120):
        phone.see(phone.window(turn_radps=0.5))
        errors_rad.append(phone.heading_error_rad)
    learnt = ONE_PRIOR.device_from_smoothed(phone.state, errors_rad[99], 1e-6, 0.0, 20.0, READING)
    assert READING @ learnt.bias_radps == pytest.approx(0.003, abs=2e-4)


def test_an_unknown_angular_rate_changes_no_estimate() -> None:
    phone = Phone.of(0.02 * READING)
    phone.rest(5)
    before = phone.state
    for _ in range(30):
        phone.see(phone.window(angular_rate_known=False, angular_rate_std_radps=0.0, specific_force_std_mps2=0.0))
    np.testing.assert_array_equal(phone.state.bias_radps, before.bias_radps)
    np.testing.assert_array_equal(phone.state.bias_cov_radps2, before.bias_cov_radps2)


def test_a_gap_keeps_the_bias_and_restarts_walks_and_field() -> None:
    phone = Phone.of(0.02 * READING)
    phone.walk(np.zeros(3))
    phone.in_field(10)
    after = phone.estimator.after_gap(phone.state)
    np.testing.assert_array_equal(after.bias_radps, phone.state.bias_radps)
    assert after.walk is None
    assert after.field is None
    assert not after.field_tracked


def test_a_straight_walk_is_measured_once_a_minute_however_long_it_is() -> None:
    # a slope that repeats within a minute belongs to the same curve
    stds = []
    for n in (35, 75, 130):
        phone = Phone.of(np.zeros(3), replace(PLAIN, straight_outlier_prob=1e-12))
        phone.walk(np.zeros(n))
        stds.append(np.sqrt(READING @ phone.state.bias_cov_radps2 @ READING))
    assert stds[1] == pytest.approx(stds[0], rel=1e-9)
    assert stds[2] < stds[1]
    variances = [1 / (1 / 0.02**2 + k * (30 / 0.2) ** 2) for k in (1, 2)]
    np.testing.assert_allclose(np.square([stds[0], stds[2]]), variances, rtol=1e-6)
    assert all(a >= b for a, b in pairwise(stds))
