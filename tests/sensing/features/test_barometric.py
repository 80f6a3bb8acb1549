from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.sensing.features.barometer import (
    LIFT_MAX_MPS,
    OUTLIER_SHARE,
    STAIRS_MPS,
    ClimbRate,
    climb_log_evidence,
)
from pdr_filter.values import CONTEXTS
from pdr_filter.values.events import Climb

STAGE = ClimbRate()
UP, DOWN = CONTEXTS.index("upstairs"), CONTEXTS.index("downstairs")
OTHERS = [c for c in range(len(CONTEXTS)) if c not in (UP, DOWN)]


def run(stage: ClimbRate, time_s: np.ndarray, hpa: np.ndarray, cuts: list[int] | None = None) -> list[Climb]:
    state, found = stage.init(), []
    for a, b in pairwise([0, *sorted(cuts or []), len(time_s)]):
        state, climbs = stage.update(state, time_s[a:b], hpa[a:b])
        found += climbs
    return found


def climbing(
    rate_mps: float,
    rate_hz: float = 10.0,
    duration_s: float = 30.0,
    seed: int | None = None,
    ground_hpa: float = 1013.25,
) -> tuple[np.ndarray, np.ndarray]:
    """Times, jittered if there is a seed, and pressures in an atmosphere of 15 degrees."""
    time_s = np.arange(0, duration_s, 1 / rate_hz)
    if seed is not None:
        time_s += np.random.default_rng(seed).uniform(-0.1, 0.1, len(time_s)) / rate_hz
    return time_s, ground_hpa * np.exp(-rate_mps * time_s / STAGE.scale_height_m)


# --- the rate ---------------------------------------------------------------------------------------------------------


def test_one_hectopascal_is_eight_metres() -> None:
    assert pytest.approx(8434.7, abs=0.1) == STAGE.scale_height_m  # R T / (g M) of the standard atmosphere
    assert STAGE.scale_height_m / 1013.25 == pytest.approx(8.324, abs=0.001)
    assert STAGE.scale_height_m / 1000 == pytest.approx(8.435, abs=0.001)
    assert ClimbRate(temperature_c=25.0).scale_height_m / STAGE.scale_height_m == pytest.approx(298.15 / 288.15)


@pytest.mark.parametrize("slope_hpa_per_s", [0.0, -0.0325, 0.03, 0.3])
def test_pressure_on_a_line_gives_its_slope_exactly_and_the_noise_of_the_sensor(slope_hpa_per_s: float) -> None:
    time_s, _ = climbing(0.0, seed=3)
    hpa = 990.03 + slope_hpa_per_s * (time_s - 15)
    for climb in run(STAGE, time_s, hpa):
        inside = (time_s >= climb.time_s - 4) & (time_s <= climb.time_s)
        metres_per_hpa = STAGE.scale_height_m / hpa[inside].mean()
        assert climb.climb_rate_mps == pytest.approx(-metres_per_hpa * slope_hpa_per_s, rel=1e-9, abs=1e-12)
        spread = np.sqrt(((time_s[inside] - time_s[inside].mean()) ** 2).sum())
        assert climb.std_mps == pytest.approx(metres_per_hpa * 0.01 / spread)
        assert climb.n_samples == inside.sum()


def test_the_climb_rate_is_the_least_squares_slope_of_numpy() -> None:
    rng = np.random.default_rng(0)
    time_s, hpa = climbing(0.3, 5.0, seed=1)
    hpa = hpa + rng.normal(0, 0.05, len(hpa))
    for climb in run(STAGE, time_s, hpa):
        inside = (time_s >= climb.time_s - 4) & (time_s <= climb.time_s)
        height_m = -STAGE.scale_height_m * (hpa[inside] / hpa[inside].mean() - 1)
        line, cov = np.polyfit(time_s[inside] - climb.time_s, height_m, 1, cov=True)
        assert climb.climb_rate_mps == pytest.approx(line[0])
        assert climb.std_mps == pytest.approx(np.sqrt(cov[0, 0]))


def test_noise_below_that_of_the_sensor_does_not_reduce_the_standard_deviation() -> None:
    time_s = np.arange(0.0, 10.0)
    (first, *_) = run(STAGE, time_s, np.full(10, 1000.03))  # a coarse sensor repeats itself
    assert first.climb_rate_mps == 0.0
    assert first.n_samples == 5
    assert first.std_mps == pytest.approx(8.4347 * 0.01 / np.sqrt(10), rel=1e-4)
    (twice, *_) = run(ClimbRate(noise_hpa=0.02), time_s, np.full(10, 1000.03))
    assert twice.std_mps == pytest.approx(2 * first.std_mps)


def test_the_deviation_of_the_height_is_that_of_the_noise_of_the_samples_at_any_rate_of_climb() -> None:
    for rate_hz, rate_mps, noise_hpa in ((10.0, 0.01, 0.2), (10.0, 2.5, 0.2), (5.0, -0.3, 0.05), (1.0, 0.3, 0.1)):
        time_s, hpa = climbing(rate_mps, rate_hz, duration_s=400.0)
        noisy = hpa + np.random.default_rng(0).normal(scale=noise_hpa, size=len(hpa))
        exact, found = run(STAGE, time_s, hpa), run(STAGE, time_s, noisy)
        error_m = np.array([a.height_m - b.height_m for a, b in zip(found, exact, strict=True)])
        variance = np.array([climb.height_std_m**2 for climb in found])
        # an error of 400 seconds is known to 1 / sqrt(200), and the variance of a window of five samples is rough
        assert (error_m**2).mean() / variance.mean() == pytest.approx(1.0, abs=0.25)


def test_a_fine_barometer_that_repeats_its_value_for_five_seconds_gives_no_climbs_until_it_changes() -> None:
    time_s, hpa = climbing(0.2, duration_s=60.0)
    hpa[(time_s >= 20.0) & (time_s < 40.0)] = hpa[200]
    found = run(STAGE, time_s, hpa, cuts=[3, 210, 333, 401])
    times_s = np.array([climb.time_s for climb in found])
    assert not ((times_s > 25.1) & (times_s < 40.0)).any()
    assert ((times_s > 20.0) & (times_s < 25.1)).sum() == 4
    assert (times_s >= 40.0).sum() >= 19
    state, _ = STAGE.update(STAGE.init(), time_s, hpa)
    assert state.stuck_s == pytest.approx(15.0, abs=0.2)


@pytest.mark.parametrize(("quantum_hpa", "shows_stairs"), [(1.0, False), (0.01, True)])
def test_a_step_of_a_coarse_barometer_is_no_climb_at_the_rate_of_stairs(quantum_hpa: float, shows_stairs: bool) -> None:
    time_s = np.arange(0.0, 30.0, 0.1)
    noise_hpa = np.random.default_rng(0).normal(scale=0.005, size=300)
    hpa = np.round((1000.0 + np.where(time_s > 14.95, 0.6 * quantum_hpa, 0.0) + noise_hpa) / quantum_hpa) * quantum_hpa
    climbs = [climb for climb in run(STAGE, time_s, hpa) if climb.time_s > 14.95]  # the first one ends with the step
    assert all(
        climb.std_mps < 0.5 * STAIRS_MPS if shows_stairs else climb.std_mps > 2.0 * STAIRS_MPS for climb in climbs
    )
    assert all(abs(climb.climb_rate_mps) < 4.0 * climb.std_mps for climb in climbs)


@pytest.mark.parametrize("resolution_hpa", [0.3, 0.5])
def test_the_resolution_is_the_smallest_change_and_not_the_decimals(resolution_hpa: float) -> None:
    time_s, hpa = climbing(0.2, duration_s=60.0)
    coarse_hpa = np.round(hpa / resolution_hpa) * resolution_hpa
    state, _ = STAGE.update(STAGE.init(), time_s, coarse_hpa)
    assert state.resolution_hpa == pytest.approx(resolution_hpa)
    state, _ = STAGE.update(STAGE.init(), time_s, np.full(len(time_s), 1013.2))
    assert state.resolution_hpa == 0.1


def test_equal_values_of_a_coarse_barometer_share_their_rounding_error() -> None:
    time_s = np.arange(0.0, 60.0, 0.1)
    hpa = 1000.0 - (time_s > 10.0)
    found = run(STAGE, time_s, hpa)
    std_m = {round(climb.time_s): climb.height_std_m for climb in found}
    rounding_m = STAGE.scale_height_m / 1000.0 / np.sqrt(12.0)
    for equal_s in (1, 9, 36):
        assert std_m[10 + equal_s] == pytest.approx(rounding_m * np.sqrt(equal_s), rel=0.06)
    assert min(climb.std_mps for climb in found if climb.time_s > 16.0) > 0.5  # stairs have 0.27 m/s


# --- windows ----------------------------------------------------------------------------------------------------------


def test_windows_come_every_hop_from_the_first_full_one_on() -> None:
    assert [c.time_s for c in run(STAGE, *climbing(0.1, 1.0, 10.0))] == [4, 5, 6, 7, 8, 9]
    found = run(ClimbRate(window_s=6.0, hop_s=0.5), *climbing(0.1, 10.0, 10.0))
    np.testing.assert_allclose([c.time_s for c in found], np.arange(6.0, 9.91, 0.5))
    assert {c.n_samples for c in found} == {61}


def test_slow_samples_end_one_window_each_and_missed_hops_are_skipped() -> None:
    time_s, hpa = climbing(0.1, 1 / 1.7)
    found = run(STAGE, time_s, hpa)
    np.testing.assert_allclose([c.time_s for c in found], time_s[2:])
    assert {c.n_samples for c in found} == {3}


def test_no_window_spans_a_gap() -> None:
    time_s, hpa = climbing(0.0, 10.0, 40.0)
    hpa = np.where(time_s > 20, hpa - 0.5, hpa)  # four metres, meanwhile
    whole = (time_s <= 18) | (time_s > 20.5)
    found = run(STAGE, time_s[whole], hpa[whole])
    np.testing.assert_allclose([c.climb_rate_mps for c in found], 0.0, atol=1e-9)
    late = [c.time_s for c in found if c.time_s > 18.05]
    assert late[0] == pytest.approx(24.6)
    shorter = (time_s <= 18.5) | (time_s > 20.4)
    assert max(c.climb_rate_mps for c in run(STAGE, time_s[shorter], hpa[shorter])) > 0.5


def test_unusable_samples_change_nothing() -> None:
    time_s, hpa = climbing(0.2, 10.0, seed=5)
    expected = run(STAGE, time_s, hpa)
    rng = np.random.default_rng(0)
    for bad_time, bad_hpa in [
        (lambda t: t, lambda p: p + 1.0),  # a repeated time
        (lambda t: t - 3.0, lambda p: p),  # a late sample
        (lambda t: t + 0.01, lambda _: np.nan),
        (lambda t: t + 0.01, lambda _: 0.0),  # a failed reading
        (lambda t: t + 0.01, lambda _: -np.inf),
        (lambda _: np.nan, lambda p: p),
        (lambda _: np.inf, lambda p: p),
    ]:
        at = np.sort(rng.integers(30, len(time_s), 20))
        dirty_s = np.insert(time_s, at, [bad_time(time_s[k - 1]) for k in at])
        dirty_hpa = np.insert(hpa, at, [bad_hpa(hpa[k - 1]) for k in at])
        assert run(STAGE, dirty_s, dirty_hpa) == expected


def test_a_clock_that_is_set_back_is_followed() -> None:
    time_s, hpa = climbing(0.2, 10.0)
    later_s, later_hpa = climbing(-0.3, 10.0)
    found = run(STAGE, np.concatenate([time_s, later_s - 1000]), np.concatenate([hpa, later_hpa]))
    after = [c for c in found if c.time_s < 0]
    assert after[0].time_s == pytest.approx(-1000 + 4.9)
    np.testing.assert_allclose([c.climb_rate_mps for c in after], -0.3, rtol=1e-5)


def test_a_single_time_far_ahead_does_not_stop_the_windows() -> None:
    time_s, hpa = climbing(0.2, 10.0)
    time_s[100] = 1e6
    found = run(STAGE, time_s, hpa)
    np.testing.assert_allclose([c.climb_rate_mps for c in found], 0.2, rtol=1e-5)
    assert found[-1].time_s > 28


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), rate_hz=st.sampled_from([1.0, 7.0, 30.0]), cuts=st.lists(st.integers(0, 400)))
def test_windows_do_not_depend_on_how_samples_arrive(seed: int, rate_hz: float, cuts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.exponential(1 / rate_hz, 400))
    time_s[rng.integers(0, 400, 10)] -= 2.0
    time_s[rng.integers(0, 400) :] += 3.0 if seed % 2 else -100.0
    hpa = 1000 + np.cumsum(rng.normal(0, 0.01, 400))
    hpa[rng.integers(0, 400, 10)] = np.nan
    whole = run(STAGE, time_s, hpa)
    assert run(STAGE, time_s, hpa, cuts) == whole
    assert run(STAGE, time_s, hpa, list(range(400))) == whole


def test_the_state_keeps_the_samples_of_one_window_and_the_input_is_not_modified() -> None:
    time_s, hpa = climbing(0.2)
    state, _ = STAGE.update(STAGE.init(), time_s, hpa)
    assert state.samples.shape[1] <= 42
    expected_s, expected_hpa = climbing(0.2)
    np.testing.assert_array_equal(time_s, expected_s)
    np.testing.assert_array_equal(hpa, expected_hpa)


# --- the evidence -----------------------------------------------------------------------------------------------------


def test_stairs_are_where_building_codes_put_them() -> None:
    rates = np.linspace(-0.6, 0.6, 1201)
    evidence = np.array([climb_log_evidence(v, 0.0) for v in rates])
    assert rates[evidence[:, UP].argmax()] == pytest.approx(0.17 * 1.6, abs=0.001)
    assert rates[evidence[:, DOWN].argmax()] == pytest.approx(-0.17 * 1.6, abs=0.001)
    assert rates[evidence[:, 0].argmax()] == pytest.approx(0.0, abs=0.001)
    best = evidence.argmax(axis=1)
    assert set(best[rates > 0.15]) == {UP}
    assert set(best[rates < -0.15]) == {DOWN}
    assert not set(best[np.abs(rates) < 0.1]) & {UP, DOWN}
    np.testing.assert_array_equal(evidence[:, OTHERS], np.tile(evidence[:, :1], (1, len(OTHERS))))


@settings(max_examples=200, deadline=None)
@given(rate_mps=st.floats(-50, 50), std_mps=st.floats(0, 100))
def test_the_evidence_is_symmetric_and_bounded(rate_mps: float, std_mps: float) -> None:
    evidence, mirrored = climb_log_evidence(rate_mps, std_mps), climb_log_evidence(-rate_mps, std_mps)
    assert evidence.shape == (len(CONTEXTS),)
    assert evidence[UP] == pytest.approx(mirrored[DOWN])
    assert evidence[0] == pytest.approx(mirrored[0])
    bound = np.log1p((1 - OUTLIER_SHARE) / OUTLIER_SHARE * 2 * LIFT_MAX_MPS / (np.sqrt(2 * np.pi) * 0.05))
    assert np.ptp(evidence) <= bound < 5.9


@pytest.mark.parametrize("rate_mps", [0.0, 0.27, -0.27, 1.0])
def test_an_uncertain_rate_gives_no_evidence(rate_mps: float) -> None:
    assert np.ptp(climb_log_evidence(rate_mps, 10.0)) < 0.01
    np.testing.assert_array_equal(np.ptp(climb_log_evidence(rate_mps, np.inf)), 0.0)
    spreads = [np.ptp(climb_log_evidence(0.27, s)) for s in (0.0, 0.05, 0.1, 0.3, 1.0, 10.0)]
    assert (np.diff(spreads) < 0).all()


@pytest.mark.parametrize("lift_mps", [0.7, 1.0, 1.6, 2.5, -1.0])
def test_at_the_speed_of_a_lift_all_contexts_are_equally_likely(lift_mps: float) -> None:
    assert np.ptp(climb_log_evidence(lift_mps, 0.02)) < 0.01


def test_a_lift_ride_is_not_taken_for_stairs_with_certainty() -> None:
    """Four storeys at 1 m/s; windows count a quarter each, because they overlap."""
    time_s = np.arange(0, 40, 0.1)
    speed = np.clip(np.minimum(time_s - 12, 25 - time_s), 0, 1)  # 1 m/s2
    rng = np.random.default_rng(0)
    hpa = 1013 * np.exp(-np.cumsum(speed) * 0.1 / STAGE.scale_height_m) + rng.normal(0, 0.01, len(time_s))
    evidence = np.array([climb_log_evidence(c.climb_rate_mps, c.std_mps) for c in run(STAGE, time_s, hpa)]) / 4
    for_stairs = np.concatenate([[0.0], np.cumsum(evidence[:, UP] - evidence[:, 0])])
    gained = (for_stairs - np.minimum.accumulate(for_stairs)).max()
    assert 0 < gained < 3


@pytest.mark.parametrize(("rate_mps", "expected"), [(0.27, UP), (-0.27, DOWN)])
@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_a_flight_of_stairs_is_seen_through_the_noise_of_a_phone(
    rate_mps: float, expected: int, rate_hz: float
) -> None:
    time_s, hpa = climbing(rate_mps, rate_hz, seed=2)
    hpa = hpa + np.random.default_rng(0).normal(0, 0.01, len(hpa))
    for climb in run(STAGE, time_s, hpa):
        evidence = climb_log_evidence(climb.climb_rate_mps, climb.std_mps)
        assert evidence.argmax() == expected
        assert evidence[expected] - evidence[0] > 2
