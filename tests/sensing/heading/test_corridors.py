"""Axes of a building as a measurement of heading drift, on synthetic walks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pdr_filter as pdr
from pdr_filter.sensing.heading.corridors import Corridors, CorridorState
from pdr_filter.values import FloatArray

AXES = Corridors()
QUARTER = np.pi / 2
OFFICE = (QUARTER, QUARTER, -QUARTER, QUARTER, QUARTER, QUARTER, -QUARTER, -QUARTER)
STEP_S = 0.55


def legs(
    turns_rad: tuple[float, ...] | FloatArray, rng: np.random.Generator, *, n: int = 18, rate_radps: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Times and headings of steps: errors of 3 degrees per leg and 2 degrees per step, corners of two steps."""
    headings: list[float] = []
    heading = 0.4
    for turn in (0.0, *turns_rad):
        headings += [heading + 0.5 * turn] if turn else []
        heading += turn
        headings += list(heading + rng.normal(scale=np.radians(3)) + rng.normal(scale=np.radians(2), size=n))
    time_s = STEP_S * np.arange(len(headings))
    return time_s, np.array(headings) + rate_radps * time_s


def run(axes: Corridors, time_s: FloatArray, headings_rad: FloatArray) -> list[CorridorState]:
    states, state = [], axes.init()
    for t, h in zip(time_s.tolist(), headings_rad.tolist(), strict=True):
        state = axes.update(state, t, h)
        states.append(state)
    return states


@pytest.mark.parametrize("rate_radps", [-0.006, -0.002, 0.0, 0.003, 0.008])
@pytest.mark.parametrize("seed", range(3))
def test_an_office_shows_the_drift_of_a_walk(rate_radps: float, seed: int) -> None:
    time_s, headings = legs(OFFICE, np.random.default_rng(seed), rate_radps=rate_radps)
    last = run(AXES, time_s, headings)[-1]
    assert AXES.is_sure(last)
    drift_rad, variance = AXES.drift(last)
    # the axis itself is known from the first leg, 4 degrees
    assert_allclose(drift_rad, rate_radps * time_s[-1], atol=np.radians(8))
    assert abs(drift_rad - rate_radps * time_s[-1]) < 3 * np.sqrt(variance) + np.radians(1)


def test_errors_of_the_drift_are_as_large_as_its_variance_says() -> None:
    """With rates drawn from twice the spread that the filter assumes."""
    rng = np.random.default_rng(3)
    squares: list[float] = []
    for _ in range(60):
        rate = float(rng.normal(scale=0.006))
        turns = QUARTER * rng.choice([-1, 1], size=10)
        time_s, headings = legs(turns, rng, n=int(rng.integers(6, 25)), rate_radps=rate)
        last = run(AXES, time_s, headings)[-1]
        shown = AXES.drift(last)
        if AXES.is_sure(last):
            squares.append((shown[0] - rate * time_s[-1]) ** 2 / shown[1])
    assert len(squares) > 50
    assert 0.3 < np.median(squares) / 0.455 < 1.7  # the median of chi-square with one degree of freedom


def test_free_walks_circles_and_diagonals_are_not_corrected() -> None:
    rng = np.random.default_rng(4)
    free = [legs(rng.uniform(0.4, 2.8, 12) * rng.choice([-1, 1], 12), rng) for _ in range(60)]
    states = [run(AXES, *walk) for walk in free]
    # Of 60 walks at most one reaches odds of 150 to 1.
    assert sum(max(s.log_odds for s in walk) > AXES.sure_log_odds for walk in states) <= 1
    # One or two right angles by chance raise the probability to about a half, and the next corners reduce it again.
    assert np.mean([AXES.probability(s) for walk in states for s in walk]) < 0.1
    assert np.median([AXES.probability(walk[-1]) for walk in states]) < 0.001
    time_s = STEP_S * np.arange(400)
    for turn_radps in (0.02, 0.05, 0.2):
        circle = turn_radps * time_s + rng.normal(scale=np.radians(3), size=400)
        assert AXES.probability(run(AXES, time_s, circle)[-1]) <= 1.001 * AXES.rectangular_prob
    # a diagonal through a hall, there and back, is one axis and no corner
    diagonal = legs((np.pi, -np.pi, 0.8, -0.8 + np.pi), rng)
    assert not AXES.is_sure(run(AXES, *diagonal)[-1])


def test_walking_straight_on_gives_no_evidence_of_axes() -> None:
    time_s, headings = legs((), np.random.default_rng(5), n=500)
    states = run(AXES, time_s, headings)
    assert states[-1].log_odds == AXES.init().log_odds


def test_a_diagonal_among_corridors_is_an_outlier_and_not_drift() -> None:
    rng = np.random.default_rng(6)
    with_diagonal = (*OFFICE, QUARTER / 2, QUARTER / 2, QUARTER, -QUARTER)
    time_s, headings = legs(with_diagonal, rng, rate_radps=0.002)
    last = run(AXES, time_s, headings)[-1]
    assert AXES.is_sure(last)
    assert_allclose(AXES.drift(last)[0], 0.002 * time_s[-1], atol=np.radians(8))


def test_turning_the_whole_walk_changes_nothing() -> None:
    time_s, headings = legs(OFFICE, np.random.default_rng(7), rate_radps=0.003)
    first = AXES.drift(run(AXES, time_s, headings)[-1])
    turned = AXES.drift(run(AXES, time_s, headings + 1.1)[-1])
    assert_allclose(turned, first, rtol=1e-6)


def test_a_restart_forgets_axes_and_odds_and_keeps_the_rates() -> None:
    time_s, headings = legs(OFFICE, np.random.default_rng(8), rate_radps=0.006)
    last = run(AXES, time_s, headings)[-1]
    again = AXES.restart(last)
    assert again.log_odds == AXES.init().log_odds
    assert_array_equal(again.log_weight, last.log_weight)
    # a walk that continues elsewhere therefore knows its drift at once
    weight = np.exp(again.log_weight)
    assert_allclose(weight @ again.mean[:, 1], 0.006, atol=0.002)


def test_the_drift_from_axes_is_weighted_with_the_probability_of_axes() -> None:
    time_s, headings = legs(OFFICE[:4], np.random.default_rng(9), rate_radps=0.004)
    states = run(AXES, time_s, headings)
    free_var = np.radians(20.0) ** 2
    state = next(s for s in states if 0.6 < AXES.probability(s) < 0.9)
    shown_rad, shown_var = AXES.drift(state)
    mean_rad, variance = AXES.mixture_drift(state, 0.0, free_var)
    assert_allclose(mean_rad, AXES.probability(state) * shown_rad)
    assert shown_var < variance < free_var
    # improbable axes far from the other estimate add no information: the variance grows
    _, doubtful = AXES.mixture_drift(states[20], AXES.drift(states[20])[0] + 1.0, free_var)
    assert doubtful > free_var


def test_a_scale_error_of_the_gyroscope_is_not_taken_for_a_bias() -> None:
    """Laps to the left and to the right, with two per cent too much turning and no bias."""
    for side in (-1, 1):
        time_s, headings = legs(np.full(24, side * QUARTER), np.random.default_rng(10))
        last = run(AXES, time_s, 1.02 * headings)[-1]
        whole, in_time = AXES.drift(last), AXES.drift_in_time(last)
        assert_allclose(whole[0], 0.02 * (headings[-1] - headings[0]), atol=np.radians(8))
        assert abs(in_time[0]) < 0.7 * abs(whole[0])
        assert abs(in_time[0]) < 2 * np.sqrt(in_time[1])


@pytest.mark.recordings
def test_a_smoothed_real_walk_through_corridors_keeps_its_right_angles(data_dir: Path) -> None:
    # uncorrected, the gyroscope of this recording is off by 28 degrees at the end
    recording = pdr.read(data_dir / "humolire" / "humolire_user1_straight.zip")
    track = pdr.smooth(recording).track
    legs_, waypoints = recording.truth.segments, recording.truth.waypoints
    errors = []
    for leg in legs_[legs_.end_s - legs_.start_s > 5]:
        a, b = (int(np.argmin(np.abs(waypoints.time_s - t))) for t in (leg.start_s, leg.end_s))
        east, north = waypoints.east_m[b] - waypoints.east_m[a], waypoints.north_m[b] - waypoints.north_m[a]
        inside = (track.time_s > leg.start_s + 1) & (track.time_s < leg.end_s - 1)
        off = np.exp(1j * (track.walking_heading_rad[inside] - np.arctan2(east, north))).mean()
        errors.append(np.angle(off))
    error = np.unwrap(errors)
    assert len(error) >= 8
    assert np.rad2deg(np.std(error)) < 6
    assert np.rad2deg(abs(error[-1] - error[-4])) < 6
