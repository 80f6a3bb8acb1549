"""Plans with several storeys, and stairs and lifts as evidence of the position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from made_up import box, feature, write
from true_positions import errors_m

import pdr_filter as pdr
from pdr_filter.simulate import BAROMETER, Gait, Leg, SensorErrors, simulate
from pdr_filter.values import Fix

# 18 steps up with a landing after half of them, on which the walk turns back
FLIGHT_M = 9 * 0.29
STAIRS = [Leg("upstairs", distance_m=FLIGHT_M), Leg("walking", distance_m=2.0, turn_rad=math.pi)]
STAIRS += [Leg("upstairs", distance_m=FLIGHT_M)]
# 20 m east, up, and 20 m north and 15 m east on the storey above
LEGS = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=20.0), *STAIRS]
LEGS += [Leg("walking", distance_m=20.0, turn_rad=math.pi / 2), Leg("walking", distance_m=15.0, turn_rad=math.pi / 2)]
ERRORS = SensorErrors(barometer=BAROMETER)
WALK = simulate(LEGS, Gait(height_m=1.65), errors=ERRORS, seed=1, start_heading_rad=math.pi / 2, name="up")
FIXES = [pdr.PositionFix(4.0, [0.5, 0.0], 0.25 * np.eye(2)), pdr.PositionFix(10.0, [7.0, 0.5], 0.5 * np.eye(2))]
WELL = box(19.8, -2.0, 24.0, 1.0)
BELOW = [feature("floor", box(-1.2, -2.2, 24.2, 1.2)), feature("stairs", WELL)]
ABOVE = [
    feature("floor", box(17.8, -2.2, 24.2, 1.2), floor=1),
    feature("floor", box(17.8, 1.2, 20.2, 20.8), floor=1),
    feature("floor", box(20.2, 18.4, 36.0, 20.8), floor=1),
    feature("stairs", WELL, floor=1),
]


def tracked(
    folder: Path, features: list, fixes: Sequence[Fix], start: pdr.PositionFix | None = None, n_most: int = 4000
) -> pdr.Track:
    plan = pdr.FloorPlan.read(write(folder / "plan.geojson", features))
    config = pdr.recipes.default().in_world_frame().with_plan(plan, start)
    assert config.on_plan is not None
    return pdr.track(WALK, replace(config, on_plan=replace(config.on_plan, n_most=n_most)), fixes=fixes)


def test_after_stairs_the_walls_are_those_of_the_upper_storey(tmp_path: Path) -> None:
    alone = pdr.track(WALK, pdr.recipes.default().in_world_frame(), fixes=FIXES)
    kept = tracked(tmp_path, [*BELOW, *ABOVE], fixes=FIXES)
    upstairs = kept.floor == 1
    assert upstairs.sum() > 30
    assert errors_m(kept, WALK)[-1] < 1.0 < 1.3 < errors_m(alone, WALK)[-1]
    assert kept.notes == alone.notes
    # with the lower storey alone it would leave the outline, where nothing fits
    elsewhere = tracked(tmp_path, BELOW, fixes=FIXES)
    assert any("leaves the outline" in note or "nothing on the plan fits" in note for note in elsewhere.notes)


def test_on_a_storey_without_a_plan_the_track_is_dead_reckoning(tmp_path: Path) -> None:
    far_above = [{**f, "properties": {**f["properties"], "floor": 7}} for f in ABOVE]
    alone = pdr.track(WALK, pdr.recipes.default().in_world_frame(), fixes=FIXES)
    track = tracked(tmp_path, [*BELOW, *far_above], fixes=FIXES)
    assert track.notes == alone.notes
    steps_m = [np.linalg.norm(np.diff(t.position_m[track.floor == 1], axis=0), axis=1) for t in (track, alone)]
    np.testing.assert_allclose(steps_m[0].sum(), steps_m[1].sum(), rtol=0.12)  # the corridor has taught the scale
    assert track.position_std_m[-1] > track.position_std_m[track.floor == 0][-1]


def test_steps_on_stairs_place_the_walk_on_the_drawn_stairs(tmp_path: Path) -> None:
    # the position of the start along the corridor is unknown, and no wall reveals it
    corridor = feature("floor", box(-30.0, -2.2, 70.0, 1.2))
    start = pdr.PositionFix(0.0, [4.0, 0.0], np.diag([9.0, 0.1]))
    heading = pdr.HeadingFix(5.0, math.pi / 2, 0.05)
    without, drawn = (
        tracked(tmp_path, [corridor, *stairs], start=start, fixes=[heading])
        for stairs in ([], [feature("stairs", WELL)])
    )
    step = int(np.searchsorted(drawn.time_s, 27.0))  # on the second flight
    assert errors_m(without, WALK)[step] > 2.5
    assert errors_m(drawn, WALK)[step] < 1.2
    assert drawn.position_std_m[step] < 0.5 * without.position_std_m[step]
