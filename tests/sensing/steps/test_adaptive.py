from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import (
    against_foot_switches,
    assert_last_steps_at_their_times,
    assert_one_step_at_each,
    bumps,
    contacts_of,
    count_error,
    detect,
    imu,
    sensed,
    times_s,
    uniform_block,
    walk_of_bumps,
)

from pdr_filter.data.io.formats import read
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.adaptive_detector import (
    AdaptiveStepDetector,
    bounce_kernel,
    low_pass_kernel,
)
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Step

DETECTOR = AdaptiveStepDetector()
# Steps a second with the amplitude of the bump that one step makes, m/s2: strolling, walking, then running.
GAITS = [(0.5, 2.0), (0.8, 2.0), (1.1, 2.0), (1.5, 3.0), (1.8, 4.0), (2.2, 5.0), (2.7, 12.0), (3.5, 15.0), (4.5, 20.0)]


# --- the kernels ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [0.6, 1.0, 1.9, 4.8])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
def test_a_hat_is_symmetric_with_zero_mean_and_unit_gain_at_its_frequency(frequency_hz: float, rate_hz: float) -> None:
    kernel = bounce_kernel(frequency_hz, 4.0, 0.75, rate_hz)
    assert kernel.sum() == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-12)
    assert len(kernel) // 2 <= round(0.875 * rate_hz)
    t = np.arange(-500, 501) / rate_hz
    response = np.convolve(2.0 * np.cos(2 * np.pi * frequency_hz * t), kernel, mode="same")
    assert response[500] == pytest.approx(2.0)


def test_between_two_hats_of_the_bank_a_sinusoid_of_the_expected_frequency_keeps_its_amplitude() -> None:
    time_s = (np.arange(2000) + 0.5) / 100
    for rms_mps2 in np.geomspace(0.3, 8.0, 9):
        frequency_hz = DETECTOR.frequency_at_1_mps2_hz * rms_mps2**DETECTOR.frequency_exponent
        line = np.sqrt(2) * rms_mps2 * np.cos(2 * np.pi * frequency_hz * time_s)
        response, *_ = DETECTOR._response(line[None])
        assert response.max() == pytest.approx(np.sqrt(2) * rms_mps2, rel=0.15)


def test_the_power_is_the_deviation_of_the_low_passed_magnitude_around_a_sample() -> None:
    line = np.random.default_rng(0).normal(size=700)
    smooth = np.convolve(line, low_pass_kernel(5.5, 100.0), mode="same")
    expected = [np.std(smooth[i - 100 : i + 76]) for i in range(112, 612)]
    _, rms, _ = DETECTOR._response(line[None])
    np.testing.assert_allclose(rms[:500], expected, rtol=1e-9)


def sine_hz(line: FloatArray) -> FloatArray:
    return DETECTOR._sine_hz(*DETECTOR._rms(line, DETECTOR._derivatives))


def test_the_frequency_of_a_sine_is_measured_and_heel_strikes_are_not_a_sine() -> None:
    time_s = (np.arange(1000) + 0.5) / 100
    for frequency_hz, amplitude_mps2 in ((2.3, 1.5), (2.6, 2.0), (2.8, 2.0)):
        sine = amplitude_mps2 * np.cos(2 * np.pi * frequency_hz * time_s)
        np.testing.assert_allclose(sine_hz(sine), 0.8 * frequency_hz, rtol=0.05)
    heel_strikes = 1.5 * np.cos(2 * np.pi * 1.4 * time_s) + 0.8 * np.cos(2 * np.pi * 2.8 * time_s)
    assert not sine_hz(heel_strikes).any()
    twice_a_step = 3.0 * np.cos(2 * np.pi * 3.6 * time_s)
    assert not sine_hz(twice_a_step).any()


@pytest.mark.parametrize("uneven", [0.0, 0.25])
def test_soft_running_has_every_step_though_its_power_is_that_of_walking(uneven: float) -> None:
    # 2.6 steps a second at the 2 m/s2 of strolling, as jogging in place or in a small room has it
    time_s = (np.arange(4000) + 0.5) / 100
    blow = 2.3 * np.cos(2 * np.pi * 2.6 * time_s) * (1.0 + uneven * np.cos(2 * np.pi * 1.3 * time_s))
    magnitude = STANDARD_GRAVITY_MPS2 + blow * ((time_s > 5) & (time_s < 35))
    _, found = detect(DETECTOR, [uniform_block(magnitude)])
    assert abs(len(found) - 78) <= 2


# --- synthetic steps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), GAITS)
def test_every_bump_is_one_step_at_the_time_of_its_maximum(frequency_hz: float, amplitude_mps2: float) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    _, found = detect(DETECTOR, [uniform_block(magnitude)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.06)


@pytest.mark.parametrize("frequency_hz", [0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0])
def test_a_sinusoid_of_half_a_hertz_to_five_has_one_step_a_period(frequency_hz: float) -> None:
    amplitude = 2.0 if frequency_hz < 2.3 else 12.0 if frequency_hz < 4.8 else 20.0  # sprinting
    time_s = (np.arange(4000) + 0.5) / 100
    inside = (time_s > 5) & (time_s < 35)
    magnitude = 9.80665 + inside * amplitude * np.cos(2 * np.pi * frequency_hz * (time_s - 5))
    _, found = detect(DETECTOR, [uniform_block(magnitude)])
    assert abs(len(found) - 30 * frequency_hz) <= 3


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 64.0, 100.0, 200.0])
@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), [(1.0, 2.0), (1.8, 4.0), (2.7, 15.0)])
def test_neither_the_sampling_rate_of_the_phone_nor_its_attitude_matters(
    rate_hz: float, frequency_hz: float, amplitude_mps2: float
) -> None:
    contacts_s = 3.0 + np.arange(20) / frequency_hz
    rng = np.random.default_rng(1)
    n = int((contacts_s[-1] + 3.0) * rate_hz)
    time_s = (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / rate_hz
    up = rng.normal(size=3)
    force = np.outer(bumps(time_s, contacts_s, amplitude_mps2, frequency_hz), up / np.linalg.norm(up))
    found = [e for _, e in sensed(Sensing(steps=DETECTOR), [imu(time_s, force)]) if isinstance(e, Step)]
    assert_one_step_at_each(contacts_s, np.array([s.time_s for s in found]), 0.06)


@pytest.mark.parametrize("frequency_hz", [1.1, 1.6, 1.9])
def test_heel_strike_and_push_off_are_one_step(frequency_hz: float) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, 4.0)
    time_s = (np.arange(len(magnitude)) + 0.5) / 100
    two_peaks = magnitude + bumps(time_s, contacts_s + 0.2, 2.0, 4.0) - STANDARD_GRAVITY_MPS2
    _, found = detect(DETECTOR, [uniform_block(two_peaks)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.1)


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), [(1.7, 4.0), (2.8, 20.0)])
def test_steps_of_unequal_feet_are_all_found_in_walking_and_running(frequency_hz: float, amplitude_mps2: float) -> None:
    contacts_s = 3.0 + np.arange(20) / frequency_hz
    time_s = (np.arange(1700) + 0.5) / 100
    magnitude = bumps(time_s, contacts_s[::2], amplitude_mps2, frequency_hz)
    magnitude += bumps(time_s, contacts_s[1::2], 0.5 * amplitude_mps2, frequency_hz) - STANDARD_GRAVITY_MPS2
    _, found = detect(DETECTOR, [uniform_block(magnitude)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.1)


def test_a_weak_step_is_kept_where_the_rhythm_expects_it_and_nowhere_else() -> None:
    contacts_s = 3.0 + np.arange(20) * 0.55
    time_s = (np.arange(1900) + 0.5) / 100
    strong = np.delete(contacts_s, 10)
    level_mps2 = 2.0  # height of the strong steps; a tenth of it is below the relative threshold of 0.15
    magnitude = bumps(time_s, strong, level_mps2, 1.8)
    for at_s, n in [(contacts_s[10], 1), (contacts_s[-1] + 0.55, 1)]:
        with_weak = magnitude + bumps(time_s, np.array([at_s]), 0.25, 1.8) - STANDARD_GRAVITY_MPS2
        found_s = times_s(detect(DETECTOR, [uniform_block(with_weak)])[1])
        strict_s = times_s(detect(AdaptiveStepDetector(rhythm_share=1.0), [uniform_block(with_weak)])[1])
        assert (np.abs(found_s - at_s) < 0.15).sum() == n
        assert (np.abs(strict_s - at_s) < 0.15).sum() <= n
    alone = bumps(time_s, np.array([8.0]), 0.2, 1.8)
    assert len(detect(DETECTOR, [uniform_block(alone)])[1]) == 0


# --- when -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), GAITS)
def test_a_step_is_known_one_latency_after_its_contact_and_never_before(
    frequency_hz: float, amplitude_mps2: float
) -> None:
    _, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    block = uniform_block(magnitude)
    state, found = detect(DETECTOR, [block])
    delays_s = np.array([s.detected_time_s - s.time_s for _, s in found])
    np.testing.assert_allclose(delays_s, DETECTOR.latency_s, atol=0.011)
    assert all(block.time_s[index] == step.detected_time_s for index, step in found)
    assert all(s.detected_time_s >= s.time_s for _, s in DETECTOR.finish(state))
    assert DETECTOR.latency_s < 0.9


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), GAITS[1:])
@pytest.mark.parametrize("after_last_s", [0.35, 0.65])
def test_at_the_end_the_last_steps_are_found_at_their_times(
    frequency_hz: float, amplitude_mps2: float, after_last_s: float
) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    block = uniform_block(magnitude[: int(100 * (contacts_s[-1] + after_last_s))])
    assert_last_steps_at_their_times(DETECTOR, contacts_s, block, tolerance_s=0.08)


# --- real recordings ------------------------------------------------------------------------------------------------


@pytest.mark.recordings
def test_steps_of_the_oxford_recordings_are_counted_and_timed_as_by_foot_switches(data_dir: Path) -> None:
    offsets_s = []
    for path in sorted((data_dir / "oxford").glob("*_1.zip")):
        recording = read(path)
        error, offset_s = against_foot_switches(recording, contacts_of(recording, Sensing(steps=DETECTOR)))
        assert abs(error) < 0.02, path.name
        assert np.mean(np.abs(offset_s - np.median(offset_s)) < 0.25) > 0.97
        offsets_s.append(np.median(offset_s))
    assert len(offsets_s) >= 7
    # the switches were read every 0.1 s, so that they are up to that late
    assert abs(np.median(offsets_s)) < 0.08


@pytest.mark.recordings
def test_steps_of_ubicomp13_are_counted_in_every_placement(data_dir: Path) -> None:
    errors: dict[str, list[float]] = {}
    for path in sorted((data_dir / "ubicomp13").glob("ubicomp13_p0[789]_*.zip")):
        recording = read(path)
        error = count_error(recording, contacts_of(recording, Sensing(steps=DETECTOR)))
        errors.setdefault(path.stem.split("_", 3)[3], []).append(error)
    assert len(errors) == 5
    assert all(np.mean(np.abs(e)) < 0.025 and np.max(np.abs(e)) < 0.06 for e in errors.values())
