"""Gyroscope bias of a phone, carried from recording to recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cut_randomly, from_hand_to_pocket, pushed, true_position_m
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values.recording import Recording

BIAS = np.array([0.004, -0.006, 0.02])


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Walk with a phone whose gyroscope has a bias."""
    return biased(from_hand_to_pocket())


def biased(recording: Recording) -> Recording:
    assert recording.gyroscope is not None
    return replace(recording, gyroscope=replace(recording.gyroscope, values=recording.gyroscope.values + BIAS))


def test_the_bias_of_a_recording_is_the_prior_of_the_next_one(walk: Recording) -> None:
    learnt = pdr.track(walk).device
    assert learnt is not None
    std = np.sqrt(np.diag(learnt.bias_cov_radps2))
    assert (np.abs(learnt.bias_radps - BIAS) < 3 * std).all()
    assert std.min() < 0.01
    config = pdr.recipes.default().with_device(learnt)
    first = config.sensing.attitude.bias.init()
    # a prior probability of 0.9 that it is this phone
    assert_allclose(first.bias_radps, 0.9 * learnt.bias_radps, rtol=1e-12)


def test_with_a_known_phone_the_heading_is_accurate_from_the_start(walk: Recording) -> None:
    """With an accurate device the first legs are as straight as without a bias."""
    known = pdr.Device(BIAS, 1e-8 * np.eye(3))
    clean = pdr.track(from_hand_to_pocket(), device=pdr.Device(np.zeros(3), 1e-8 * np.eye(3)))
    with_device = pdr.track(walk, device=known)
    without = pdr.track(walk)
    n = min(clean.n_steps, with_device.n_steps, without.n_steps)

    def off(track: pdr.Track) -> float:
        return float(np.abs(np.angle(np.exp(1j * (track.walking_heading_rad - clean.walking_heading_rad)[:n]))).max())

    assert off(with_device) < np.radians(1.5)
    assert off(with_device) < 0.5 * off(without)


@pytest.mark.parametrize("with_fixes", [True, False])
def test_fixes_of_a_smoothed_walk_teach_the_bias_of_the_phone(with_fixes: bool) -> None:
    bias = np.array([0.0, 0.003, 0.003])
    clean = simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=40.0, turn_rad=1.5)] * 3, seed=3)
    assert clean.gyroscope is not None
    walk = replace(clean, gyroscope=replace(clean.gyroscope, values=clean.gyroscope.values + bias))
    times_s = np.arange(clean.truth.position.time_s[0] + 1.0, clean.duration_s, 15.0)
    fixes = [pdr.PositionFix(float(t), true_position_m(clean, t), np.eye(2) / 4) for t in times_s]
    device = pdr.smooth(walk, fixes=fixes if with_fixes else ()).track.device
    up = np.array([0.0, *clean.accelerometer.values.mean(axis=0)[1:]])
    up /= np.linalg.norm(up)
    error, std = up @ (device.bias_radps - bias), np.sqrt(up @ device.bias_cov_radps2 @ up)
    assert abs(error) < 3 * std
    assert (std < 0.0015) == with_fixes


def test_a_device_of_another_phone_causes_a_note(walk: Recording) -> None:
    fitting, other = (pdr.Device(sign * BIAS, 1e-8 * np.eye(3)) for sign in (1.0, -3.0))
    words = "gyroscope bias of the given device fits this walk"
    assert not any(words in note for note in pdr.track(walk, device=fitting).notes)
    assert any(words in note for note in pdr.track(walk, device=other).notes)


def test_days_and_temperature_increase_the_covariance() -> None:
    device = pdr.Device(BIAS, 1e-6 * np.eye(3))
    assert_array_equal(device.after().bias_cov_radps2, device.bias_cov_radps2)
    day, week, warm = device.after(days=1), device.after(days=7), device.after(warmer_k=-15.0)
    assert device.bias_cov_radps2[0, 0] < day.bias_cov_radps2[0, 0] < week.bias_cov_radps2[0, 0]
    assert_allclose(warm.bias_cov_radps2[0, 0], 1e-6 + (15 * 0.0003) ** 2)
    assert_array_equal(week.bias_radps, BIAS)


def test_a_saved_device_is_the_same_when_it_is_read(tmp_path: Path) -> None:
    device = pdr.Device(BIAS, np.diag([1e-6, 2e-6, 3e-6]))
    read = pdr.Device.load(device.save(tmp_path / "phone.json"))
    assert_array_equal(read.bias_radps, device.bias_radps)
    assert_array_equal(read.bias_cov_radps2, device.bias_cov_radps2)


@pytest.mark.parametrize(
    "content",
    [
        *("", "[]", "{}", "null", "3", '{"pdr_filter_device": 2}', '{"pdr_filter_device": 1}'),
        '{"pdr_filter_device": 1, "bias_radps": [1' + 400 * "0" + ", 0, 0]}",
    ],
)
def test_a_file_that_is_not_a_device_is_refused_with_its_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"other\.json: no device file of pdr_filter .*write one with"):
        pdr.Device.load(path)


def test_an_online_filter_estimates_the_same_device(walk: Recording) -> None:
    blocks = cut_randomly(pdr.merge_streams(walk), 1, mean_length=777)
    online, _ = pushed(pdr.OnlineFilter(pdr.recipes.default(walk.subject)), blocks)
    learnt = pdr.track(walk).device
    assert learnt is not None
    assert_array_equal(online.device.bias_radps, learnt.bias_radps)
    assert_array_equal(online.device.bias_cov_radps2, learnt.bias_cov_radps2)


def test_the_command_line_reads_a_device_file_and_updates_it_unless_the_file_is_more_certain(
    walk: Recording, tmp_path: Path
) -> None:
    file, phone = walk.save(tmp_path / "walk.zip"), tmp_path / "phone.json"
    runner = CliRunner()
    written = runner.invoke(app, ["track", str(file), "--device", str(phone)])
    assert (written.exit_code, "phone.json: gyroscope bias " in written.stderr) == (0, True)
    first = pdr.Device.load(phone)
    assert runner.invoke(app, ["track", str(file), "--device", str(phone)]).exit_code == 0
    second = pdr.Device.load(phone)
    assert np.trace(second.bias_cov_radps2) < np.trace(first.bias_cov_radps2)
    certain = pdr.Device(np.array([0.001, 0.0, -0.002]), 1e-12 * np.eye(3))
    certain.save(phone)
    kept = runner.invoke(app, ["track", str(file), "--device", str(phone)])
    assert "was not changed, because its gyroscope bias, 1.0 ± 0.0, 0.0 ± 0.0, -2.0 ± 0.0 mrad/s about" in kept.stderr
    assert_array_equal(pdr.Device.load(phone).bias_cov_radps2, certain.bias_cov_radps2)
