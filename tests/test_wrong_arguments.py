"""What is no recording, no configuration or no number is refused where it is given, with the remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.simulate import Leg, simulate


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return simulate([Leg("walking", distance_m=10.0)], seed=1)


TAKERS: dict[str, Callable[..., Any]] = {
    "track": pdr.track,
    "detect_steps": pdr.detect_steps,
    "classify": pdr.classify,
    "smooth": lambda recording, config=None: pdr.smooth(recording, config=config),
}


@pytest.mark.parametrize("name", TAKERS)
@pytest.mark.parametrize("recording", ["walk.zip", Path("walk.zip"), None])
def test_a_path_in_place_of_a_recording_is_refused_with_how_to_read_it(name: str, recording: Any) -> None:
    with pytest.raises(ValueError, match=r"recording must be a Recording, .* pdr_filter\.read"):
        TAKERS[name](recording)


@pytest.mark.parametrize("name", TAKERS)
@pytest.mark.parametrize("config", ["default", pdr.recipes.default], ids=["name", "recipe not called"])
def test_a_recipe_that_was_not_called_is_no_configuration(walk: pdr.Recording, name: str, config: Any) -> None:
    with pytest.raises(ValueError, match="config must be a Config"):
        TAKERS[name](walk, config)
    with pytest.raises(ValueError, match="config must be a Config"):
        pdr.OnlineFilter(config)


@pytest.mark.parametrize("height_m", [175, 0.0, -1.7, np.nan, "1.8"])
def test_a_height_in_centimetres_or_as_text_is_refused(walk: pdr.Recording, height_m: Any) -> None:
    with pytest.raises(ValueError, match="height_m must be the height of a person in metres"):
        pdr.OnlineFilter(height_m=height_m)
    with pytest.raises(ValueError, match="height_m"):
        pdr.track(walk.of_height(height_m))
    with pytest.raises(ValueError, match="height_m"):
        pdr.batch.track([], out="never.csv", height_m=height_m)


def test_a_height_in_place_of_a_subject_is_refused() -> None:
    with pytest.raises(ValueError, match=r"subject must be a Subject, got 1\.8"):
        pdr.recipes.default(1.8)  # type: ignore[arg-type]


@pytest.mark.parametrize("taker", [pdr.track, pdr.smooth, lambda _, plan: pdr.OnlineFilter(plan=plan)])
def test_the_path_of_a_plan_is_refused_with_how_to_read_it(walk: pdr.Recording, taker: Callable[..., Any]) -> None:
    with pytest.raises(
        ValueError, match=r"plan must be a FloorPlan, got 'mall\.geojson': read one .* pdr_filter\.FloorPlan\.read"
    ):
        taker(walk, plan="mall.geojson")


@pytest.mark.parametrize("taker", [pdr.track, pdr.smooth])
def test_one_fix_in_place_of_several_is_refused(walk: pdr.Recording, taker: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match=r"fixes must be a sequence, got one PositionFix: give \[fix\]"):
        taker(walk, fixes=pdr.PositionFix(5.0, (0.0, 0.0), np.eye(2)))


@pytest.mark.parametrize("taker", [pdr.track, pdr.smooth])
def test_what_is_no_calibration_is_refused(walk: pdr.Recording, taker: Callable[..., Any]) -> None:
    with pytest.raises(ValueError, match=r"calibration must be a Calibration, or the path of a saved one, got \{\}"):
        taker(walk, calibration={})


def test_a_path_to_calibrate_with_is_named_as_it_was_given() -> None:
    with pytest.raises(ValueError, match=r"recording must be a Recording, got 'walk\.zip'"):
        pdr.calibrate("walk.zip")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"fixes": [pdr.GridFix(5.0, (0.0, 0.0), 1.0, np.zeros((2, 2)))]}, "particle filter on a floor plan"),
        ({"fixes": [(5.0, 0.0)]}, "PositionFix"),
        ({"loop_closures": "wlan"}, "loop_closures"),
        ({"loop_closures": [LoopClosure(1.0, 9.0, 1.0)], "anchor_interval_s": np.nan}, "anchor_interval_s"),
        ({"start_heading_std_rad": np.nan}, "start_heading_std_rad"),
        ({"start_heading_std_rad": -1.0}, "start_heading_std_rad"),
    ],
)
def test_what_hindsight_cannot_use_is_refused(walk: pdr.Recording, options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        pdr.smooth(walk, **options)


def test_hindsight_takes_the_path_of_a_calibration_as_the_filter_does(walk: pdr.Recording, tmp_path: Path) -> None:
    calibration = pdr.calibrate([pdr.simulate.demo_walk()])
    calibration.save(tmp_path / "people")
    smoothed = [pdr.smooth(walk, calibration=given) for given in (calibration, tmp_path / "people")]
    np.testing.assert_array_equal(smoothed[0].track.step_length_m, smoothed[1].track.step_length_m)


@pytest.mark.parametrize(
    "options", [{"loss": "l1"}, {"anchor_std_m": -1.0}, {"anchor_std_m": np.nan}, {"file_format": "x"}]
)
def test_a_batch_refuses_an_option_before_it_reads_anything(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="|".join(["loss must", "anchor_std_m must", "format is"])):
        pdr.batch.calibrate(["/nowhere.zip"], **options)


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
