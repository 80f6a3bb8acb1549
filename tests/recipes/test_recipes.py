"""Numbers that the recipes ship, against what they stand for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, true_position_m

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.values import CONTEXTS, WindowContext


def length_m(recipe: str, context: str, height_m: float = 1.70) -> float:
    """Length of a step of 1.9 Hz with an ordinary bounce."""
    subject = recipes.Subject(height_m=height_m)
    mode = next(m for m in recipes.RECIPES[recipe](subject).model.modes if m.context == context)
    step = a_step(duration_s=1 / 1.9, variance=3.0)
    step = replace(step, vertical_amplitude_mps2=2.5, usual_amplitude_mps2=2.5)
    return float(mode.step_length.predict(step)[0])


@pytest.mark.parametrize("recipe", recipes.RECIPES)
def test_a_step_on_stairs_is_as_long_as_a_tread(recipe: str) -> None:
    """Treads of public stairs are 0.26 to 0.32 m; downstairs people skip the edge of a landing."""
    assert 0.26 <= length_m(recipe, "upstairs") <= 0.32
    assert 0.26 <= length_m(recipe, "downstairs") <= 0.45
    assert length_m(recipe, "stationary") == 0.0


def test_an_ordinary_step_of_the_default_recipe_is_as_long_as_people_walk() -> None:
    """0.41 of the height at an ordinary cadence, within a tenth; taller people make longer steps."""
    for height_m in (1.55, 1.70, 1.90):
        assert length_m("default", "walking", height_m) == pytest.approx(0.41 * height_m, rel=0.1)


def test_the_default_knows_the_steps_of_a_stranger_by_a_tenth_and_by_the_height_better() -> None:
    stds = [recipes.default(subject).model.noise.log_scale_std for subject in (None, recipes.Subject(height_m=1.9))]
    assert stds == [0.10, 0.07]


def test_a_run_in_a_room_and_one_in_the_open_are_within_two_deviations() -> None:
    """Steps of 0.46 and 0.62 m at 2.6 to 2.8 Hz in oxiod and tyrex, 0.95 m at 2.7 Hz in the open."""
    running = next(m for m in recipes.default().model.modes if m.context == "running")
    for frequency_hz, true_m in ((2.64, 0.46), (2.8, 0.62), (2.7, 0.95)):
        length_m, var_m2 = running.step_length.predict(a_step(duration_s=1 / frequency_hz))
        assert abs(length_m - true_m) < 2 * np.sqrt(var_m2)


@pytest.mark.parametrize("name", ["oxiod_user1_room_running1_6", "oxiod_user1_room_running1_7"])
def test_a_slow_jog_in_circles_is_as_long_as_it_was(data_dir: Path, name: str) -> None:
    """As motion capture has the path, within a tenth; it was 23 to 39 % short while every second step was missed."""
    recording = pdr.read(data_dir / "oxiod" / f"{name}.zip")
    track, truth = pdr.track(recording), recording.truth.position
    time_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.5)
    path = true_position_m(recording, time_s)
    inside = (track.time_s >= time_s[0]) & (track.time_s <= time_s[-1])
    true_m = np.hypot(*np.diff(path, axis=0).T).sum()
    assert track.step_length_m[inside].sum() == pytest.approx(true_m, rel=0.1)


def test_steps_of_a_jog_are_off_by_what_the_running_mode_says(data_dir: Path) -> None:
    """Sums of eight steps, turned onto the path and scaled to it over 48: along and across, divided by sqrt(8)."""
    off: list[np.ndarray] = []
    for name in ("oxiod_user1_room_running1_6", "oxiod_user1_room_running1_7"):
        recording = pdr.read(data_dir / "oxiod" / f"{name}.zip")
        track, truth = pdr.track(recording), recording.truth.position
        inside = (track.time_s > truth.time_s[0]) & (track.time_s < truth.time_s[-1])
        path = [np.interp(track.time_s[inside], truth.time_s, truth[c]) for c in ("north_m", "east_m")]
        own, true = np.diff(track.position_m[inside] @ [1j, 1.0]), np.diff(path[0] + 1j * path[1])
        true = true * np.abs(own).sum() / np.abs(true).sum()
        n = len(own) // 48 * 48
        own, true = own[:n].reshape(-1, 6, 8), true[:n].reshape(-1, 6, 8)
        turn = (own * true.conj()).sum(axis=(1, 2), keepdims=True)
        error = (own * (turn / np.abs(turn)).conj() - true).sum(axis=2)
        error = error * np.exp(-1j * np.angle(true.sum(axis=2)))
        error = (error - error.mean(axis=1, keepdims=True)) * np.sqrt(6 / 5 / 8)
        off.append(np.stack([error.real, error.imag / np.abs(own).mean()]).reshape(2, -1))
    along_m, across_rad = np.sqrt((np.concatenate(off, axis=1) ** 2).mean(axis=1))
    running = next(m for m in recipes.default().model.modes if m.context == "running")
    assert along_m == pytest.approx(running.step_length.residual_std_m, rel=0.2)
    assert across_rad == pytest.approx(running.heading_std_rad, rel=0.2)


def test_one_window_moves_the_modes_of_the_default_by_its_odds() -> None:
    """p(c | x) / prior(c)^0.2, whole: tempered or with the prior divided out whole it would be another number."""
    model = recipes.default().model
    tracker = ImmTracker(model)
    prob = np.array([0.02, 0.5, 0.3, 0.1, 0.004, 0.076])
    prior = np.array([0.3, 0.4, 0.1, 0.1, 0.0, 0.1])
    state, _ = tracker.on_window(tracker.init(), WindowContext(2.0, prob, prior))
    _, updates = tracker.on_step(state, a_step(1.5))
    of_prior = np.where(prior > 0, prior, 1 / 6)
    before = model.long_run_mode_prob @ model.transition_prob
    # a step is seven to one against standing; what the classifier does not know has the floor of one in a hundred
    of_step = np.where(np.array(CONTEXTS) == "stationary", np.exp(-1.9), 1.0)
    expected = before * np.maximum(prob, 0.01) / of_prior**0.2 * of_step
    np.testing.assert_allclose(updates[0].mode_prob, expected / expected.sum(), rtol=1e-9)


def test_the_default_transitions_stay_as_long_as_they_say() -> None:
    stay_steps = 1 / (1 - np.diagonal(recipes.context_transitions()))
    expected = {"stationary": 5, "walking": 55, "upstairs": 12, "downstairs": 11, "sideways": 10, "running": 50}
    assert dict(zip(CONTEXTS, stay_steps.round().astype(int).tolist(), strict=True)) == expected
    np.testing.assert_allclose(recipes.context_transitions().sum(axis=1), 1.0)


def test_the_threshold_of_weighted_contexts_is_kept_by_other_weightings() -> None:
    config = recipes.martinelli2018()
    own = replace(config, tracker=WeightedTracker(config.model, threshold=0.5))
    for others in (("hc",), ("imm",), ("imm", "hc"), (np.square,)):
        changed = own
        for other in others:
            changed = changed.with_weighting(other)
        assert changed.with_weighting("wc").tracker.threshold == 0.5, others
    assert recipes.default().with_weighting("wc").tracker.threshold == 0.8
