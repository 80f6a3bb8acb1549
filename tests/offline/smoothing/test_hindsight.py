"""Smoothed tracks compared with online tracks and with the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step
from true_positions import errors_m, position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.filter.imm import imm
from pdr_filter.recipes.config import Config
from pdr_filter.simulate import Leg, demo_walk, simulate
from pdr_filter.values import PositionFix, WindowContext

pytestmark = pytest.mark.usefixtures("sensing_once")


def fixes_of(walk: pdr.Recording, seed: int = 0, std_m: float = 2.0) -> list[PositionFix]:
    """Return a noisy fix every ten seconds."""
    time_s = np.arange(10.0, float(walk.truth.position.time_s[-1]), 10.0)
    place_m = true_m(walk, time_s)
    return position_fixes(time_s, place_m + np.random.default_rng(seed).normal(scale=std_m, size=place_m.shape), std_m)


def test_with_fixes_the_smoothed_track_has_smaller_errors_and_covariances_than_the_filter() -> None:
    walks = [
        simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=40.0, turn_rad=1.5)], seed=s)
        for s in range(3)
    ]
    squares = {"filter": 0.0, "smoother": 0.0}
    for seed, walk in enumerate(walks):
        fixes = fixes_of(walk, seed)
        # in the world frame the filter has to find the rotation of the fixes, too
        world = pdr.recipes.default(walk.subject).in_world_frame()
        forward, smoothed = pdr.track(walk, world, fixes=fixes), pdr.smooth(walk, fixes=fixes).track
        squares["filter"] += np.square(errors_m(forward, walk)).mean()
        squares["smoother"] += np.square(errors_m(smoothed, walk)).mean()
        spread = [np.trace(t.position_cov_m2, axis1=1, axis2=2)[:-1].mean() for t in (forward, smoothed)]
        assert spread[1] < spread[0]
    assert squares["smoother"] < 0.9 * squares["filter"]


def test_without_fixes_the_smoothed_end_is_close_to_that_of_a_filter_with_the_same_exponent() -> None:
    walk = demo_walk()
    config = pdr.recipes.default(walk.subject)
    tempered = config.in_hindsight()
    forward, smoothed = pdr.track(walk, tempered), pdr.smooth(walk, config=config).track
    assert not np.allclose(forward.mode_prob, pdr.track(walk, config).mode_prob)
    # The smoother knows the axes and the bias of the whole walk from its first step on.
    assert np.linalg.norm(smoothed.position_m[-1] - forward.position_m[-1]) < 0.25 * forward.position_std_m[-1]
    np.testing.assert_allclose(smoothed.mode_prob[-1], forward.mode_prob[-1], atol=1e-12)
    assert smoothed.n_steps == forward.n_steps


def test_a_smoothed_change_of_context_is_earlier_than_the_online_one() -> None:
    walk = simulate([Leg("walking", distance_m=25.0), Leg("running", distance_m=40.0)], carrying_mode="pocket", seed=3)
    walk = replace(walk, gyroscope=None)  # the model with gyroscope knows that nobody's limbs swing like that
    change_s = float(walk.truth.labels.start_s[1])
    running = pdr.CONTEXTS.index("running")
    delay_s = []
    for track in (pdr.track(walk), pdr.smooth(walk).track):
        runs = track.mode_prob[:, running] > 0.5
        delay_s.append(float(track.time_s[runs][0]) - change_s)
    assert abs(delay_s[1]) < abs(delay_s[0])


def test_smoothing_reduces_the_effect_of_wrong_windows_and_keeps_true_stairs() -> None:
    config = pdr.recipes.default()
    walking, upstairs = (pdr.CONTEXTS.index(c) for c in ("walking", "upstairs"))

    def mean_prob_of_stairs(config: Config, first_s: float, last_s: float) -> float:
        """At the steps of the windows in between, which say stairs with 0.9."""
        tracker, prior = config.tracker, np.full(6, 1 / 6)
        state, prob, time_s = tracker.init(), [], np.arange(1.25, 60.0, 0.5)
        for t in time_s:
            if t % 1.0 < 0.5:
                said = upstairs if first_s <= t <= last_s else walking
                window = WindowContext(float(np.ceil(t)), np.where(np.arange(6) == said, 0.9, 0.02), prior)
                state, _ = tracker.on_window(state, window)
            state, updates = tracker.on_step(state, a_step(float(t)))
            prob += [u.mode_prob for u in updates]
        smoothed = imm.smoothed_mode_prob(np.array(prob), config.model.transition_prob)
        return float(smoothed[(time_s >= first_s) & (time_s <= last_s), upstairs].mean())

    # three windows in a row, and nobody climbs
    online, hindsight = (mean_prob_of_stairs(c, 30.0, 33.0) for c in (config, config.in_hindsight()))
    assert hindsight < 0.7 * online
    # a flight of twenty seconds
    assert mean_prob_of_stairs(config.in_hindsight(), 20.0, 40.0) > 0.95


def test_with_a_weighted_step_length_the_smoother_agrees_with_a_single_filter() -> None:
    config = pdr.recipes.default().with_weighting("wc")
    walk = simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=40.0, turn_rad=1.5)], seed=2)
    fixes = fixes_of(walk)
    forward, smoothed = pdr.track(walk, config, fixes=fixes), pdr.smooth(walk, fixes=fixes, config=config).track
    np.testing.assert_array_equal(smoothed.mode_prob, forward.mode_prob)
    assert np.trace(smoothed.position_cov_m2.mean(axis=0)) < np.trace(forward.position_cov_m2.mean(axis=0))
    assert np.square(errors_m(smoothed, walk)).mean() < np.square(errors_m(forward, walk)).mean()


@pytest.mark.parametrize(("drawn_together", "is_noted"), [(1.0, False), (0.6, True)])
def test_fixes_that_make_steps_much_shorter_than_the_model_are_noted(drawn_together: float, is_noted: bool) -> None:
    walk = simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=30.0, turn_rad=1.5)], seed=3)
    track = pdr.track(walk)
    times, places = track.time_s[::4], track.position_m[::4]
    notes = pdr.smooth(walk, fixes=position_fixes(times, drawn_together * places, 2.0)).notes
    assert any("shorter than the step-length model" in note for note in notes) == is_noted
