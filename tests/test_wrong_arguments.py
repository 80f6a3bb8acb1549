"""What is no recording, no configuration or no number is refused where it is given, with the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return simulate([Leg("walking", distance_m=10.0)], seed=1)


def test_hindsight_takes_the_path_of_a_calibration_as_the_filter_does(walk: pdr.Recording, tmp_path: Path) -> None:
    calibration = pdr.calibrate([pdr.simulate.demo_walk()])
    calibration.save(tmp_path / "people")
    smoothed = [pdr.smooth(walk, calibration=given) for given in (calibration, tmp_path / "people")]
    np.testing.assert_array_equal(smoothed[0].track.step_length_m, smoothed[1].track.step_length_m)


def test_a_configuration_and_a_filter_say_in_a_line_what_they_are(walk: pdr.Recording) -> None:
    config = pdr.recipes.tian2016().with_weighting("hc")
    text = f"Config('tian2016', hc of {', '.join(mode.name for mode in config.model.modes)})"
    online = pdr.OnlineFilter(config)
    assert (repr(config), repr(online)) == (text, f"OnlineFilter({text}, no steps)")
    samples = pdr.merge_streams(walk)
    online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps)
    online.finish()
    assert re.search(r", 1\d steps, 1?\d\.\d m\)$", repr(online))


# --- the face for apps ------------------------------------------------------------------------------------------------

FORCE = np.tile([0.0, 0.0, 9.81], (100, 1))
TIME_S = np.arange(100) / 100


def test_a_filter_takes_samples_merged_or_apart_and_never_both() -> None:
    merged = pdr.OnlineFilter()
    merged.push(TIME_S, FORCE)
    for push in (merged.push_accelerometer, merged.push_gyroscope, merged.push_magnetometer):
        with pytest.raises(ValueError, match="use only one of the two ways"):
            push(TIME_S + 1.0, FORCE)
    for name in ("push_accelerometer", "push_gyroscope", "push_magnetometer"):
        apart = pdr.OnlineFilter()
        getattr(apart, name)(TIME_S, FORCE)
        with pytest.raises(ValueError, match="use only one of the two ways"):
            apart.push(TIME_S + 1.0, FORCE)


def test_a_finished_filter_takes_no_pressure() -> None:
    online = pdr.OnlineFilter()
    online.finish()
    with pytest.raises(ValueError, match="the filter is finished"):
        online.push_pressure([0.0], [1000.0])


def test_samples_without_times_are_refused_and_none_of_either_is_nothing() -> None:
    with pytest.raises(ValueError, match=r"specific_force_mps2 must be \(0, 3\)"):
        pdr.OnlineFilter().push([], FORCE)
    assert pdr.OnlineFilter().push([], []) == []


def test_bytes_with_something_behind_are_no_saved_filter() -> None:
    blob = pdr.OnlineFilter().save()
    with pytest.raises(ValueError, match="followed by other data"):
        pdr.OnlineFilter.load(blob + b"x")
