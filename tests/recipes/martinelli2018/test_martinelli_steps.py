from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pywt
from helpers import (
    against_foot_switches,
    assert_last_steps_at_their_times,
    assert_one_step_at_each,
    bumps,
    contacts_of,
    count_error,
    detect,
    flat_attitude,
    times_s,
    uniform_block,
    walk_of_bumps,
)
from scipy.signal import butter, sosfilt

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector, wavelet_kernel
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_detector import unknown_contexts
from pdr_filter.values import STANDARD_GRAVITY_MPS2

# Steps a second with the amplitude of the bump that one step makes, m/s2: walking, then running.
SENSING = Sensing(steps=WaveletStepDetector())
GAITS = [(1.2, 4.0), (1.5, 4.0), (1.8, 4.0), (2.2, 4.0), (2.7, 12.0), (3.2, 20.0)]


# --- the kernel -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [1.0, 1.45, 2.8])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
def test_the_kernel_is_symmetric_with_zero_mean_and_unit_gain_at_its_frequency(
    frequency_hz: float, rate_hz: float
) -> None:
    kernel = wavelet_kernel("mexh", frequency_hz, rate_hz)
    assert kernel.sum() == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-12)
    t = np.arange(-1000, 1001) / rate_hz
    response = np.convolve(2.0 * np.cos(2 * np.pi * frequency_hz * t), kernel, mode="same")
    assert response[1000] == pytest.approx(2.0)


@pytest.mark.parametrize("frequency_hz", [1.45, 2.8])
def test_the_kernel_gives_the_continuous_wavelet_transform(frequency_hz: float) -> None:
    sos = butter(2, (0.5, 3.0), "bandpass", fs=100, output="sos")
    signal = sosfilt(sos, np.random.default_rng(0).normal(size=2000))
    scale = pywt.frequency2scale("mexh", frequency_hz / 100)
    u = np.arange(-200, 201) / scale
    literal = np.convolve(signal, (1 - u**2) * np.exp(-(u**2) / 2), mode="same")  # eq. 3 up to its factor
    # pywt samples the integral of the wavelet: up to half a sample off
    [oracle], _ = pywt.cwt(signal, [scale], "mexh", precision=14)
    ours = np.convolve(signal, wavelet_kernel("mexh", frequency_hz, 100.0), mode="same")[200:-200]
    for transform, tolerance in [(literal[200:-200], 0.003), (oracle[200:-200], 0.06)]:
        factor = (ours @ transform) / (ours @ ours)
        np.testing.assert_allclose(factor * ours, transform, atol=tolerance * np.abs(transform).max())


# --- synthetic steps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), GAITS)
def test_every_bump_is_one_step_at_the_time_of_its_maximum(frequency_hz: float, amplitude_mps2: float) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    _, found = detect(WaveletStepDetector(), [uniform_block(magnitude)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.05)
    durations = np.array([s.duration_s for _, s in found])
    np.testing.assert_allclose(durations[3:19], 1 / frequency_hz, atol=0.003)
    np.testing.assert_allclose([s.frequency_hz for _, s in found], 1 / durations)


def test_the_latency_is_below_a_second() -> None:
    assert 0.3 < WaveletStepDetector().latency_s < 1.0


def test_bumps_below_the_smallest_peak_are_no_steps() -> None:
    for scale, n_min, n_max in [(0.5, 0, 0), (2.0, 20, 21)]:
        contacts_s = 3.0 + np.arange(20) / 1.45
        time_s = (np.arange(2000) + 0.5) / 100
        inside = (time_s > contacts_s[0] - 0.3) & (time_s < contacts_s[-1] + 0.3)
        magnitude = 9.81 + inside * scale * 0.35 * np.cos(2 * np.pi * 1.45 * (time_s - 3.0))
        _, found = detect(WaveletStepDetector(), [uniform_block(magnitude)])
        assert n_min <= len(found) <= n_max


def test_heel_strike_and_push_off_are_one_step() -> None:
    contacts_s, magnitude = walk_of_bumps(1.6, 4.0)
    time_s = (np.arange(len(magnitude)) + 0.5) / 100
    two_peaks = magnitude + bumps(time_s, contacts_s + 0.2, 2.0, 4.0) - STANDARD_GRAVITY_MPS2
    _, found = detect(WaveletStepDetector(), [uniform_block(two_peaks)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.1)


def test_the_unequal_feet_of_a_runner_are_told_apart_by_the_fast_wavelet_only() -> None:
    contacts_s = 3.0 + np.arange(20) / 2.8
    time_s = (np.arange(1400) + 0.5) / 100
    magnitude = (
        STANDARD_GRAVITY_MPS2
        + (bumps(time_s, contacts_s[::2], 30.0, 2.8) - STANDARD_GRAVITY_MPS2)
        + (bumps(time_s, contacts_s[1::2], 12.0, 2.8) - STANDARD_GRAVITY_MPS2)
    )
    both = detect(WaveletStepDetector(), [uniform_block(magnitude)])[1]
    merged = detect(WaveletStepDetector(running_rms_mps2=np.inf), [uniform_block(magnitude)])[1]
    assert 20 <= len(both) <= 21
    assert len(merged) <= 12


def test_after_a_pause_a_new_bout_begins_with_a_step_of_typical_duration() -> None:
    time_s = (np.arange(2200) + 0.5) / 100
    contacts_s = np.concatenate([3.0 + np.arange(8) * 0.55, 14.0 + np.arange(8) * 0.55])
    _, found = detect(WaveletStepDetector(), [uniform_block(bumps(time_s, contacts_s, 4.0, 1.8))])
    steps = [s for _, s in found]
    starts = [s for s in steps if s.duration_s == 0.6]
    assert min(abs(s.time_s - 3.0) for s in starts) < 0.06
    assert min(abs(s.time_s - 14.0) for s in starts) < 0.06
    assert all(s.duration_s < 1.0 for s in steps)


# --- what a step says about itself ----------------------------------------------------------------------------------


def test_the_statistics_of_a_step_are_those_of_the_samples_since_the_contact_before() -> None:
    rng = np.random.default_rng(3)
    _, magnitude = walk_of_bumps(1.8, 4.0)
    magnitude = magnitude + 0.2 * rng.normal(size=len(magnitude))
    n = len(magnitude)
    block = uniform_block(magnitude, rate=np.zeros((n, 3)))
    block.angular_rate_known[700:705] = block.turn_known[700:705] = False
    attitude = flat_attitude(magnitude, np.cumsum(rng.normal(size=n)) / 10)
    attitude.vertical_mps2[:] += rng.normal(size=n)
    detector = WaveletStepDetector()
    _, found = detector.update(detector.init(), block, attitude, unknown_contexts(n))
    contact = [round(s.time_s * 100 - 0.5) for _, s in found]
    starts = [contact[0] - 60, *contact[:-1]]
    for (_, step), a, b in zip(found, starts, contact, strict=True):
        f, v, h = magnitude[a:b], attitude.vertical_mps2[a:b], attitude.device_heading_rad[a:b]
        assert step.variance == pytest.approx(np.mean((f - np.mean(f)) ** 2))
        assert (step.magnitude_max_mps2, step.magnitude_min_mps2) == (max(f), min(f))
        assert (step.vertical_max_mps2, step.vertical_min_mps2) == (max(v), min(v))
        assert step.vertical_range_mps2 == max(v) - min(v)
        assert step.mean_abs_mps2 == pytest.approx(np.mean(np.abs(f - 9.80665)))
        assert step.heading_change_rad == pytest.approx(h[-1] - h[0])
        assert step.device_heading_rad == pytest.approx(np.mean(h))
    # five samples without angular rate: all in the step between the contacts around them
    assert sum(s.heading_unknown_s for _, s in found) == pytest.approx(0.05)
    assert sum(s.heading_unknown_s > 0 for _, s in found) in (1, 2)


# --- the end --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), GAITS)
@pytest.mark.parametrize("after_last_s", [0.35, 0.5, 0.65])
def test_at_the_end_the_last_steps_are_found_at_their_times(
    frequency_hz: float, amplitude_mps2: float, after_last_s: float
) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    block = uniform_block(magnitude[: int(100 * (contacts_s[-1] + after_last_s))])
    last = assert_last_steps_at_their_times(WaveletStepDetector(), contacts_s, block)
    assert last[0].duration_s == pytest.approx(1 / frequency_hz, abs=0.03)


# --- real recordings ------------------------------------------------------------------------------------------------


@pytest.mark.recordings
def test_steps_of_the_oxford_recordings_are_counted_and_timed_as_by_foot_switches(data_dir: Path) -> None:
    offsets_s = []
    for path in sorted((data_dir / "oxford").glob("*.zip")):
        recording = read(path)
        error, offset_s = against_foot_switches(recording, contacts_of(recording, SENSING))
        assert abs(error) < 0.03, path.name
        offsets_s.append(np.median(offset_s))
    assert len(offsets_s) == 16
    # the switches were read every 0.1 s, so that they are up to that late
    assert abs(np.median(offsets_s)) < 0.08


@pytest.mark.recordings
def test_steps_of_people_7_to_13_of_ubicomp13_are_counted_within_2_5_percent(data_dir: Path) -> None:
    """The detector was tuned on people 1 to 6."""
    errors = []
    for person in range(7, 14):
        for path in sorted((data_dir / "ubicomp13").glob(f"ubicomp13_p{person:02d}_*.zip")):
            recording = read(path)
            errors.append(count_error(recording, contacts_of(recording, SENSING)))
    assert len(errors) == 35
    assert np.mean(np.abs(errors)) < 0.025
