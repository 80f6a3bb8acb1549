"""Plans in degrees use the locations of a recording; plans in metres cannot, because their position is unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import true_positions
from made_up import FEATURES, in_degrees, round_the_block, write

import pdr_filter as pdr

HERE = pdr.Origin(48.1, 11.5)
WALK = round_the_block()


@pytest.fixture(scope="module")
def located() -> pdr.Recording:
    """Walk with a location every second, with an error of 2 m and an accuracy of 3 m, in the first corridor."""
    time_s = np.arange(0.5, 35.0)
    off_m = np.random.default_rng(0).normal(0.0, 2.0, (len(time_s), 2))
    return true_positions.located(WALK, time_s, HERE, 3.0, off_m)


def test_a_plan_in_degrees_uses_the_locations_of_the_recording(located: pdr.Recording, tmp_path: Path) -> None:
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", in_degrees(FEATURES, HERE)), origin=HERE)
    track = pdr.track(located, plan=plan)
    assert track.frame == "plan" and track.origin == HERE
    assert sum(fix.accepted for fix in track.fixes) > 3
    assert true_positions.errors_m(track, WALK)[-1] < 2.0


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
