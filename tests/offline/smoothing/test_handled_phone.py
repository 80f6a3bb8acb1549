"""Tracks of phones that are handled before the walk, or whose heading is unknown for a while."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from handling import HANDLED_S, handled_walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from true_positions import errors_m, true_m

import pdr_filter as pdr
from pdr_filter.simulate import Leg, SensorErrors, simulate
from pdr_filter.values.rigid_fit import rigid_fit


def aligned(reference: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return positions (N, 2) rotated and shifted onto a reference (N, 2)."""
    a, b = places - places.mean(axis=0), reference - reference.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return a @ rotation + reference.mean(axis=0)


def during_walk(track: pdr.Track, times_s: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(times_s, track.time_s, track.position_m[:, k]) for k in (0, 1)])


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 10_000), bias=st.sampled_from([0.0, 0.01, 0.05]))
def test_no_smoothed_step_is_much_longer_than_the_longest_online_step(seed: int, bias: float) -> None:
    walk = handled_walk(seed, bias_std_radps=bias)
    online, smoothed = pdr.track(walk), pdr.smooth(walk).track
    moved_m = np.linalg.norm(np.diff(smoothed.position_m, axis=0), axis=1)
    assert max(smoothed.step_length_m.max(), moved_m.max()) < 1.3 * online.step_length_m.max()
    assert smoothed.distance_m == pytest.approx(online.distance_m, rel=0.1)


@cache
def smoothed(**change: float) -> pdr.Track:
    return pdr.smooth(handled_walk(3, **change)).track


@pytest.mark.parametrize("change", [{"mirrored": True}, {"turned_rad": 1.3}, {"delay_s": 4.0}])
def test_handling_the_phone_before_the_walk_does_not_change_the_walk(change: dict[str, float]) -> None:
    times_s = np.arange(HANDLED_S + 14.0, HANDLED_S + 80.0)
    one, other = (during_walk(track, times_s) for track in (smoothed(), smoothed(**change)))
    assert np.linalg.norm(aligned(one, other) - one, axis=1).max() < 0.3


@pytest.mark.parametrize("bias", [0.004, 0.015])
def test_errors_of_the_smoothed_track_of_a_handled_phone_agree_with_its_covariances(bias: float) -> None:
    """Positions are relative to the start of the walk, in the frame of its first leg."""
    squares = list[float]()
    for seed in range(4):
        walk = handled_walk(seed + 50, bias_std_radps=bias)
        smoothed = pdr.smooth(walk).track
        begin, true = int(np.searchsorted(smoothed.time_s, HANDLED_S + 11.0)), true_m(walk, smoothed.time_s)
        ours, true = smoothed.position_m[begin:] - smoothed.position_m[begin], true[begin:] - true[begin]
        first = slice(3, 12)
        turn = np.angle(np.sum((true[first] @ [1, 1j]) * np.conj(ours[first] @ [1, 1j])))
        c, s = np.cos(turn), np.sin(turn)
        error = ours @ np.array([[c, s], [-s, c]]) - true
        rotation = np.array([[c, -s], [s, c]])
        end_cov = rotation @ smoothed.position_cov_m2[-1] @ rotation.T
        squares.append(float(error[-1] @ np.linalg.solve(end_cov, error[-1])))
    # The upper limit is the 97.5 % quantile for two degrees of freedom and 4 walks. Most phones have a better
    # gyroscope than the tail of the prior, and the frame of the first leg removes a part of the error.
    assert 0.2 < np.mean(squares) < chi2.isf(0.025, 2 * len(squares)) / len(squares)


def jumps_m(track: pdr.Track) -> np.ndarray:
    moved_m = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
    return moved_m[(moved_m > 3.0) & (np.diff(track.time_s) < 2.0)]


def test_a_correction_for_a_bias_detected_late_reduces_the_error() -> None:
    """The gyroscope bias of 0.05 rad/s, without magnetometer, is far larger than that of a phone that calibrates
    itself.
    """
    errors = SensorErrors()
    errors = replace(errors, gyroscope=replace(errors.gyroscope, bias_std=0.05))
    gained_m = list[float]()
    for seed in range(5):
        rng = np.random.default_rng(seed)
        legs = [
            Leg("walking", distance_m=float(rng.uniform(8, 40)), turn_rad=float(rng.choice([-1.57, 1.57, 0.8])))
            for _ in range(7)
        ]
        walk = replace(simulate(legs, carrying_mode="pocket", seed=seed, errors=errors), magnetometer=None)
        track = pdr.track(walk)
        error_m = errors_m(track, walk)
        moved_m = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
        gained_m += (error_m[:-1] - error_m[1:])[moved_m > 3.0].tolist()
        if len(jumps_m(track)):
            assert any("heading" in note for note in track.notes)
    assert len(gained_m) > 3
    assert np.mean(gained_m) > 0


@pytest.mark.parametrize(
    "name",
    [
        "ipin2023/ipin2023_anon_trial23_rep02",
        "motionsense/motionsense_s06_wlk_7",
        "ubicomp13/ubicomp13_p04_e2_handheld_using",
    ],
)
def test_tracks_of_real_recordings_have_plausible_steps(data_dir: Path, name: str) -> None:
    recording = pdr.read(data_dir / f"{name}.zip")
    online, smoothed = pdr.track(recording, gnss="off"), pdr.smooth(recording).track
    moved_m = np.linalg.norm(np.diff(smoothed.position_m, axis=0), axis=1)
    assert max(smoothed.step_length_m.max(), moved_m.max()) < 1.8
    assert smoothed.distance_m == pytest.approx(online.distance_m, rel=0.15)
    assert not len(jumps_m(online))


def test_the_bias_of_the_first_pass_does_not_rotate_the_walk_of_a_handled_phone(data_dir: Path) -> None:
    """The heading of a device that is turned over depends on its bias, and so do the walking directions."""
    recording = pdr.read(data_dir / "ipin2023" / "ipin2023_anon_trial22_rep01.zip")
    track, points = pdr.smooth(recording, gnss="off", north="magnetic").track, recording.truth.waypoints
    at_m = np.column_stack([np.interp(points.time_s, track.time_s, axis) for axis in track.position_m.T])
    true_m = np.column_stack([points.east_m, points.north_m])
    rotation, _ = rigid_fit(at_m, true_m)
    assert abs(np.arctan2(rotation[1, 0], rotation[0, 0])) < 0.35
