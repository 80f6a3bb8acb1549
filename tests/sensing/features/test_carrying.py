from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.features.carrying import ATTITUDE, NAMES, WITHOUT_GYROSCOPE, carrying_features_of_motion
from pdr_filter.values import STANDARD_GRAVITY_MPS2

RATE_HZ, N = 100.0, 200
T = np.arange(N) / RATE_HZ
FLAT = np.array([0.0, 0.0, 1.0])


def window(
    vertical: np.ndarray | float = 0.0,
    horizontal: np.ndarray | float = 0.0,
    rate: np.ndarray | float = 0.0,
    up: np.ndarray = FLAT,
) -> np.ndarray:
    """Rows of `invariant.SIGNALS`; vectors are (3, N) or (3,), the horizontal is (2, N)."""
    result = np.zeros((len(invariant.SIGNALS), N))
    result[0], result[1:3], result[3:6] = vertical, horizontal, rate
    result[6:9] = up if up.ndim == 2 else up[:, None]
    result[9:12] = STANDARD_GRAVITY_MPS2 * result[6:9]
    return result


def walk(seed: int = 0) -> np.ndarray:
    """A person walking, the phone upright and tilting about its x axis, all signals noisy."""
    rng = np.random.default_rng(seed)
    angle = 0.4 * np.sin(2 * np.pi * 1.0 * T + rng.uniform(0, 6))
    up = np.stack([0.1 + 0 * T, np.cos(angle), np.sin(angle)])
    result = window(
        vertical=2.5 * np.sin(2 * np.pi * 2.0 * T),
        horizontal=np.stack([1.5 * np.sin(2 * np.pi * T), 0.4 * np.cos(2 * np.pi * 2 * T)]),
        rate=np.stack([0.4 * 2 * np.pi * np.cos(2 * np.pi * T), 0.3 * np.sin(2 * np.pi * T), 0 * T]),
        up=up / np.sqrt((up**2).sum(axis=0)),
    )
    result[:6] += 0.1 * rng.normal(size=(6, N))
    return result


def carrying_features(windows: np.ndarray, rate_hz: float) -> np.ndarray:
    return invariant.features_in_groups(carrying_features_of_motion, windows, rate_hz, len(NAMES))


def named(signals: np.ndarray) -> dict[str, float]:
    return dict(zip(NAMES, carrying_features(signals[None], RATE_HZ)[0], strict=True))


def test_names_are_different_from_each_other_and_from_those_of_the_invariant_features() -> None:
    assert len(NAMES) == 38 == len({*NAMES}) and not {*NAMES} & {*invariant.NAMES}
    assert set(ATTITUDE) < set(WITHOUT_GYROSCOPE) < set(NAMES)


def test_a_phone_that_lies_face_up_has_its_screen_up_and_one_face_down_has_not() -> None:
    face_up, face_down = named(window()), named(window(up=-FLAT))
    for name in ("screen_up", "lowest_screen_up", "screen_up_share"):
        assert (face_up[name], face_down[name]) == pytest.approx((1.0, 0.0))
    assert (face_up["abs_up_z"], face_down["abs_up_z"]) == pytest.approx((1.0, 1.0))


def test_one_knock_does_not_lower_the_lowest_screen_up() -> None:
    up = np.tile(FLAT[:, None], N)
    up[:, 100:115] = np.array([[1.0], [0.0], [0.0]])
    assert named(window(up=up))["lowest_screen_up"] == pytest.approx(1.0)
    assert named(window(up=up))["screen_up_share"] == pytest.approx(185 / 200)


def test_a_long_axis_at_45_degrees_is_most_aslant() -> None:
    assert named(window(up=np.array([1.0, 1.0, 0.0]) / np.sqrt(2)))["long_axis_aslant"] == pytest.approx(0.5)
    assert named(window(up=np.array([0.0, 1.0, 0.0])))["long_axis_aslant"] == pytest.approx(0.0)


# multiples of the 0.5 Hz of a bin: the taper then keeps all of the power inside the band
@pytest.mark.parametrize("frequency_hz", [1.5, 2.0, 2.5])
@pytest.mark.parametrize("angle_rad", [0.05, 0.3, 0.8])
def test_a_swing_of_known_angle_has_the_angle_whatever_its_frequency(frequency_hz: float, angle_rad: float) -> None:
    omega = 2 * np.pi * frequency_hz
    rate = np.stack([angle_rad * omega * np.cos(omega * T), 0 * T, 0 * T])
    found = named(window(rate=rate))
    # the Hann taper spreads a line over three bins with different divisors, an error of some per cent
    assert np.exp(found["log_tilt_angle"]) == pytest.approx(angle_rad / np.sqrt(2), rel=0.2)
    assert np.exp(found["log_tilt_rate"]) == pytest.approx(angle_rad * omega / np.sqrt(2), rel=0.02)
    assert found["tilts_about_one_axis"] == pytest.approx(1.0, abs=0.01)
    assert found["share_of_turning_about_x"] == pytest.approx(1.0, abs=0.01)
    assert np.exp(found["log_yaw_angle"]) == pytest.approx(0.002, rel=0.01)


def test_turning_about_the_vertical_is_yaw_and_not_tilt() -> None:
    rate = np.stack([0 * T, 0 * T, 0.5 * np.cos(2 * np.pi * 2.0 * T)])
    found = named(window(rate=rate))
    assert np.exp(found["log_tilt_angle"]) == pytest.approx(0.002, rel=0.01)
    assert np.exp(found["log_yaw_angle"]) == pytest.approx(0.5 / (4 * np.pi) / np.sqrt(2), rel=0.2)


@pytest.mark.parametrize("lever_m", [0.2, 0.5, 0.9])
def test_a_phone_on_a_lever_shows_its_length(lever_m: float) -> None:
    omega = 2 * np.pi * 1.0
    rate = np.stack([0.4 * omega * np.cos(omega * T), 0 * T, 0 * T])
    acceleration = -lever_m * 0.4 * omega**2 * np.sin(omega * T)
    found = named(window(rate=rate, horizontal=np.stack([0.6 * acceleration, 0.8 * acceleration])))
    # the side bins of the taper have other frequencies, which makes the result 8 % too small at this pace
    assert np.exp(found["log_lever_m"]) - 0.05 == pytest.approx(lever_m, rel=0.1)
    assert found["lever_coherence"] == pytest.approx(1.0, abs=0.1)
    unrelated = named(window(rate=rate, horizontal=np.stack([np.sin(2 * np.pi * 2.5 * T), 0 * T])))
    assert unrelated["lever_coherence"] < 0.1


def test_the_feature_of_motion_on_one_line_is_high_for_a_line_and_low_for_a_circle() -> None:
    line = np.stack([0.6 * np.sin(4 * np.pi * T), 0.8 * np.sin(4 * np.pi * T)])
    circle = np.stack([np.cos(4 * np.pi * T), np.sin(4 * np.pi * T)])
    assert named(window(horizontal=line))["horizontal_on_one_line"] == pytest.approx(1.0, abs=1e-2)
    assert named(window(horizontal=circle))["horizontal_on_one_line"] == pytest.approx(0.0, abs=1e-6)


@given(heading_rad=st.floats(-np.pi, np.pi), seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_walking_in_another_direction_changes_nothing(heading_rad: float, seed: int) -> None:
    signals = walk(seed)
    turned = signals.copy()
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    turned[1:3] = np.array([[c, -s], [s, c]]) @ signals[1:3]
    np.testing.assert_allclose(
        carrying_features(turned[None], RATE_HZ), carrying_features(signals[None], RATE_HZ), rtol=1e-7, atol=1e-7
    )


# of right-handed turns, the only ones that keep the screen's side: head to foot; mirrors: the left pocket for the right
@pytest.mark.parametrize("signs", [(-1.0, -1.0, 1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0)])
def test_turning_the_phone_upside_down_or_to_the_other_side_of_the_body_changes_nothing(
    signs: tuple[float, ...],
) -> None:
    signals = walk()
    other = signals.copy()
    handedness = np.prod(signs)  # a mirror turns the angular rate, an axial vector, the other way
    for rows, factor in ((slice(3, 6), handedness), (slice(6, 9), 1.0), (slice(9, 12), 1.0)):
        other[rows] *= factor * np.array(signs)[:, None]
    np.testing.assert_allclose(
        carrying_features(other[None], RATE_HZ), carrying_features(signals[None], RATE_HZ), rtol=1e-9, atol=1e-9
    )


def test_a_window_has_the_same_bits_alone_and_in_any_batch() -> None:
    windows = np.array([walk(seed) for seed in range(75)])
    together = carrying_features(windows, RATE_HZ)
    for size in (1, 2, 7, 33):
        for start in range(0, 75, size):
            part = carrying_features(windows[start : start + size], RATE_HZ)
            np.testing.assert_array_equal(part, together[start : start + size])
    np.testing.assert_array_equal(carrying_features(windows[::-1], RATE_HZ), together[::-1])


def test_features_without_gyroscope_do_not_depend_on_it_and_all_are_finite_without_it() -> None:
    signals = walk()
    without = signals.copy()
    without[3:6] = 0.0
    present, missing = carrying_features(np.array([signals, without]), RATE_HZ)
    n = len(WITHOUT_GYROSCOPE)
    assert NAMES[:n] == WITHOUT_GYROSCOPE
    np.testing.assert_array_equal(missing[:n], present[:n])
    assert np.isfinite(missing).all()


def test_still_phones_and_windows_of_zeros_have_finite_features() -> None:
    windows = np.array([np.zeros((12, N)), window(), window(up=np.array([0.0, -1.0, 0.0])), 1e4 * walk()])
    assert np.isfinite(carrying_features(windows, RATE_HZ)).all()


@pytest.mark.parametrize(("n", "rate_hz"), [(200, 100.0), (201, 100.0), (100, 50.0), (128, 64.0)])
def test_windows_of_other_lengths_have_about_the_same_features(n: int, rate_hz: float) -> None:
    t = np.arange(n) / rate_hz
    signals = np.zeros((12, n))
    signals[0] = 2.5 * np.sin(2 * np.pi * 2.0 * t)
    signals[3] = 2.0 * np.cos(2 * np.pi * 2.0 * t)
    signals[8] = 1.0
    found = dict(zip(NAMES, carrying_features(signals[None], rate_hz)[0], strict=True))
    assert np.exp(found["log_vertical"]) == pytest.approx(2.5 / np.sqrt(2), rel=0.03)
    assert np.exp(found["log_tilt_angle"]) == pytest.approx(2.0 / (4 * np.pi) / np.sqrt(2), rel=0.2)


def test_no_windows_have_no_features() -> None:
    assert carrying_features(np.empty((0, 12, N)), RATE_HZ).shape == (0, len(NAMES))
