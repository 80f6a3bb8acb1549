"""The source of the heading is reported: source and trust of each step, notes and report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, true_position_m

import pdr_filter as pdr
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.tracking.step_statistics import is_on_the_spot
from pdr_filter.tracking.trust_report import doubts


def test_the_source_of_a_heading_is_axes_then_strides_then_the_device() -> None:
    step = a_step(1.0)
    assert step.heading_source == "device"
    assert replace(step, direction_trust=0.9).heading_source == "strides"
    assert replace(step, direction_trust=0.1, on_axes=True).heading_source == "axes"


def path_of(data_dir: Path, name: str) -> Path:
    return data_dir / "oxiod" / f"oxiod_anon_floor1_{name}.zip"


def tracked(data_dir: Path, name: str) -> pdr.Track:
    return pdr.track(pdr.read(path_of(data_dir, name)))


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["handbag7", "handbag8", "handbag10"])
def test_in_a_handbag_the_heading_follows_the_phone_without_a_warning_and_within_four_metres(
    data_dir: Path, name: str
) -> None:
    recording = pdr.read(path_of(data_dir, name))
    track, truth = pdr.track(recording), recording.truth.position
    inside = (track.time_s >= truth.time_s[0]) & (track.time_s <= truth.time_s[-1])
    true_m = true_position_m(recording, track.time_s[inside])
    assert pdr.evaluate.position_rmse_m(track.position_m[inside], true_m, "all") < 4.0
    assert np.median(track.direction_trust) < 0.25
    assert sum(source == "device" for source in track.heading_source) > 0.7 * track.n_steps
    assert not any("strides do not agree" in note for note in track.notes)
    assert doubts(track) == []
    # the offset is constant: without the axes of a building the track follows the turn of the device
    config = pdr.recipes.default()
    heading = config.sensing.heading
    assert isinstance(heading, WalkingHeading)
    heading = replace(heading, corridors=replace(heading.corridors, rectangular_prob=1e-12))
    track = pdr.track(recording, replace(config, sensing=replace(config.sensing, heading=heading)))
    device = np.unwrap(np.asarray(track.steps.device_heading_rad))
    assert np.degrees(np.std(np.unwrap(track.walking_heading_rad) - device)) < 6.0


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["handheld1", "pocket4", "pocket6"])
def test_in_hand_and_pocket_strides_agree_and_there_is_no_note(data_dir: Path, name: str) -> None:
    track = tracked(data_dir, name)
    assert np.median(track.direction_trust) > 0.7
    assert sum(source == "device" for source in track.heading_source) < 0.1 * track.n_steps
    assert not any("strides do not agree" in note for note in track.notes)


@pytest.mark.recordings
def test_jogging_in_a_small_room_causes_a_warning_only_if_strides_push_nowhere(data_dir: Path) -> None:
    track = pdr.track(pdr.read(data_dir / "oxiod" / "oxiod_user1_room_running1_7.zip"))
    assert track.is_quick_and_soft.mean() > 0.7
    assert is_on_the_spot(track.is_quick_and_soft, track.direction_trust).mean() < 0.05
    assert not any("as quick as running" in note for note in track.notes)
    in_place = track.steps.copy()
    in_place.direction_trust = 0.1
    [told] = doubts(replace(track, steps=in_place))
    assert "as quick as running and as soft as walking" in told
    assert not tracked(data_dir, "handheld1").is_quick_and_soft.any()
