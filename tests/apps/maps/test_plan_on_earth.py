"""Plans in degrees use the locations of a recording; plans in metres cannot, because their position is unknown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import FEATURES, errors_m, in_degrees, round_the_block, write

import pdr_filter as pdr

HERE = pdr.Origin(48.1, 11.5)
WALK = round_the_block()


@pytest.fixture(scope="module")
def located() -> pdr.Recording:
    """Walk with a location every second, with an error of 2 m and an accuracy of 3 m, in the first corridor."""
    truth = WALK.truth.position
    time_s, rng = np.arange(0.5, 35.0), np.random.default_rng(0)
    place_m = np.column_stack([np.interp(time_s, truth.time_s, truth[k]) for k in ("east_m", "north_m")])
    latitude, longitude = HERE.latitude_longitude_deg(place_m + rng.normal(0.0, 2.0, place_m.shape))
    rows = np.column_stack([latitude, longitude, np.full(len(time_s), 500.0), np.full(len(time_s), 3.0)])
    return replace(WALK, location=pdr.Samples(time_s, rows))


def test_a_plan_in_degrees_uses_the_locations_of_the_recording(located: pdr.Recording, tmp_path: Path) -> None:
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", in_degrees(FEATURES, HERE)), origin=HERE)
    track = pdr.track(located, plan=plan)
    assert track.frame == "plan" and track.origin == HERE
    assert sum(fix.accepted for fix in track.fixes) > 3
    assert errors_m(track, WALK)[-1] < 2.0


def test_a_plan_in_metres_ignores_locations_and_refuses_a_request_to_use_them(
    located: pdr.Recording, tmp_path: Path
) -> None:
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson"))
    assert pdr.track(located, plan=plan, start=pdr.PositionFix(0.0, [0.0, 0.0], np.eye(2))).fixes == ()
    for gnss in ("filter", "align"):
        with pytest.raises(ValueError, match="plan in metres"):
            pdr.track(located, plan=plan, gnss=gnss)
        with pytest.raises(ValueError, match="plan in metres"):
            pdr.track(located, pdr.recipes.default().with_plan(plan), gnss=gnss)
    online = pdr.OnlineFilter(plan=plan, start="anywhere")
    with pytest.raises(ValueError, match="plan in metres"):
        online.push_location(1.0, 48.1, 11.5, 3.0)
