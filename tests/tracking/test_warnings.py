"""Thresholds of the warnings about steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step

import pdr_filter as pdr
from pdr_filter.tracking.step_statistics import StepCounts, WindowCounts, is_in_standing
from pdr_filter.tracking.warnings import _step_notes, _window_notes  # pyright: ignore[reportPrivateUsage]


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)], seed=2)


@pytest.mark.parametrize(
    ("untrusted", "n", "is_said"), [(21, 60, True), (20, 60, False), (41, 200, True), (40, 200, False)]
)
def test_uncertain_directions_cause_a_note_above_a_fifth_of_the_steps_and_above_twenty_steps(
    untrusted: int, n: int, is_said: bool
) -> None:
    notes = list(_step_notes(StepCounts(n=n, untrusted=untrusted)))
    assert [note.about for note in notes] == (["heading"] if is_said else [])
    assert all(f"{untrusted} of {n} steps" in note.text for note in notes)


def test_only_disagreeing_strides_of_a_moved_phone_count_as_uncertain_directions() -> None:
    counts = StepCounts()
    for k in range(30):
        trust = 0.1 if k % 2 else 0.5
        moved_s = 0.5 if k < 20 else 20.5
        step = replace(a_step(1.0 + k), shown_offset_std_rad=0.3, direction_trust=trust, carried_since_s=moved_s)
        counts = counts.plus(step, 0.1, 0.0)
    assert counts.untrusted == 5


@pytest.mark.parametrize(("direction_trust", "n_told"), [(0.1, 30), (0.3, 0)])
def test_quick_and_soft_steps_count_as_on_the_spot_if_strides_push_nowhere(direction_trust: float, n_told: int) -> None:
    quick = replace(a_step(1.0, duration_s=0.4), vertical_amplitude_mps2=2.0, direction_trust=direction_trust)
    assert quick.is_quick_and_soft
    counts = StepCounts()
    for k in range(30):
        counts = counts.plus(replace(quick, time_s=1.0 + k), 0.1, 0.0)
    assert counts.on_the_spot == n_told


@pytest.mark.parametrize(
    ("in_standing", "n", "is_said"), [(21, 60, True), (20, 60, False), (41, 200, True), (40, 200, False)]
)
def test_steps_in_contexts_without_steps_cause_a_note_above_a_fifth_of_the_steps_and_above_twenty(
    in_standing: int, n: int, is_said: bool
) -> None:
    counts = StepCounts(n=n)
    for k in range(n):
        prob = np.array([0.4, 0.3, 0.3]) if k < in_standing else np.array([0.3, 0.4, 0.3])
        counts = counts.plus_context(bool(is_in_standing(prob, [0])))
    notes = list(_step_notes(counts))
    assert [note.about for note in notes] == (["contexts"] if is_said else [])
    assert all(note.text.startswith(f"{in_standing} of {n} steps") for note in notes)


@pytest.mark.parametrize(("unlike", "unknown", "said"), [(51, 0, "farther"), (50, 0, ""), (60, 6, "unlike all")])
def test_more_than_half_of_the_windows_far_from_the_training_data_cause_a_note(
    unlike: int, unknown: int, said: str
) -> None:
    notes = list(_window_notes(WindowCounts(n=100, unlike=unlike, unknown=unknown)))
    assert [note.about for note in notes] == (["contexts"] if said else [])
    assert all(said in note.text for note in notes)


def test_fixes_that_arrive_after_the_last_sample_are_late_and_not_on_another_clock() -> None:
    walk = pdr.simulate.demo_walk()
    late = [pdr.PositionFix(t, np.zeros(2), 1e4 * np.eye(2), received_time_s=t + 25.0) for t in (50.0, 100.0)]
    ahead = pdr.PositionFix(135.0, np.zeros(2), np.eye(2))
    notes = pdr.track(walk, fixes=[*late, ahead]).notes
    (arrived,) = (note for note in notes if "arrived after the last sample" in note)
    assert arrived.startswith("1 fix not used") and "clock" not in arrived
    assert any(note.startswith("fixes from after the last sample were not used: 1; check") for note in notes)


@pytest.mark.parametrize("recipe", [pdr.recipes.default, pdr.recipes.susi2013, pdr.recipes.tian2016])
def test_a_recipe_without_the_person_says_that_the_height_of_the_recording_is_not_used(
    walk: pdr.Recording, recipe: Callable[..., pdr.Config]
) -> None:
    def noted(recording: pdr.Recording, config: pdr.Config) -> list[str]:
        return [note for note in pdr.track(recording, config).notes if "person's height" in note]

    tall, unknown = walk.of_height(1.86), replace(walk, meta={})
    (unused,) = noted(tall, recipe())
    assert "does not use the person's height, which is 1.86 m in the recording: 1.70 m is assumed" in unused
    assert unused.endswith("such as pdr_filter.recipes.default(recording.subject)")
    assert noted(tall, recipe(tall.subject)) == []
    assert noted(unknown, recipe())[0].startswith("the person's height is not known: 1.70 m is assumed")


def test_the_height_of_the_recording_is_used_by_a_calibration_of_other_people(walk: pdr.Recording) -> None:
    tall = replace(walk.of_height(1.86), name="tall")
    others = [replace(walk.of_distance(20.0), meta={"subject": {"id": name}}) for name in ("anna", "ben")]
    calibration = pdr.calibrate(others)
    track = pdr.track(tall, pdr.recipes.default(), calibration=calibration)
    assert not [note for note in track.notes if "person's height" in note]
    assert any("of the calibrated population" in note for note in track.notes)


def test_rejected_fixes_are_no_ground_truth_in_a_track_and_the_note_names_the_frame(walk: pdr.Recording) -> None:
    """The true positions are those of a map, in which the walk begins far away from its start."""
    position = walk.truth.position
    assert position is not None
    moved = position.copy()
    moved["east_m"] += 500.0
    on_map = replace(walk, truth=replace(walk.truth, position=moved))
    rows = [moved[k] for k in (len(moved) // 3, 2 * len(moved) // 3)]
    fixes = [pdr.PositionFix(float(r["time_s"]), np.array([r["east_m"], r["north_m"]]), np.eye(2)) for r in rows]
    track = pdr.track(on_map, fixes=fixes)
    assert [fix.outcome for fix in track.fixes] == ["rejected", "rejected"]
    assert not any("ground truth" in note for note in track.notes)
    (told,) = (note for note in track.notes if "fit the track or its time" in note)
    assert told.endswith("as positions on a map, use a configuration of in_world_frame()")
    in_frame = pdr.track(on_map, pdr.recipes.default(walk.subject).in_world_frame(), fixes=fixes)
    assert any("2 of 2 position fixes are ground truth" in note for note in in_frame.notes)
    late = [*fixes, pdr.PositionFix(fixes[-1].time_s + 1.0, np.array([0.0, 900.0]), 0.01 * np.eye(2))]
    in_frame = pdr.track(on_map, pdr.recipes.default(walk.subject).in_world_frame(), fixes=late)
    (told,) = (note for note in in_frame.notes if "fit the track or its time" in note)
    assert "in_world_frame" not in told
