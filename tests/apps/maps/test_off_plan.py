"""Walks that start or lie in a hole of the plan, in a wall, or outside of its outline."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cut_randomly, pushed
from made_up import FEATURES, box, feature, line, write
from numpy.testing import assert_allclose, assert_array_equal

import pdr_filter as pdr
from pdr_filter.apps.maps.storey import OUTSIDE
from pdr_filter.simulate import Gait, Leg, simulate

pytestmark = pytest.mark.usefixtures("sensing_once")

HALL = box(-15, -15, 45, 15)
WALK = simulate([Leg("walking", distance_m=20.0)], Gait(height_m=1.8), seed=1, start_heading_rad=math.pi / 2)
OFF = "in a wall, in a hole of the plan or outside of its outline"


def config(path: Path, start: pdr.PositionFix | None, holes: list[list[list[float]]]) -> pdr.Config:
    """Return a configuration with few particles and a hall that has holes."""
    floor = {"type": "Polygon", "coordinates": HALL["coordinates"] + holes}
    plan = pdr.FloorPlan.read(write(path / "hall.geojson", [feature("floor", floor)]))
    found = pdr.recipes.default().with_plan(plan, start)
    assert found.on_plan is not None
    return replace(found, on_plan=replace(found.on_plan, n_most=4000))


def at(east_m: float, north_m: float, std_m: float) -> pdr.PositionFix:
    return pdr.PositionFix(0.0, [east_m, north_m], std_m**2 * np.eye(2))


HOLE = box(-3, -3, 3, 3)["coordinates"][0]


def is_off(given: pdr.Config, position_m: np.ndarray) -> np.ndarray:
    return given.on_plan.plan.storeys[0].kind_at(position_m) == OUTSIDE


def test_a_start_in_a_hole_is_named_with_the_number_of_steps_online_and_smoothed(tmp_path: Path) -> None:
    given = config(tmp_path, at(0, 0, 0.3), [HOLE])
    track = pdr.track(WALK, given)
    start, steps = (note for note in track.notes if OFF in note)
    assert start.startswith("the start at 0.0 m east, 0.0 m north is in a wall")
    # three metres to the edge are four or five steps
    assert int(steps.split()[0]) in (4, 5)
    smoothed = pdr.smooth(WALK, config=given)
    counted = next(note for note in smoothed.notes if OFF in note and "step" in note.split()[1])
    assert int(counted.split()[0]) in (4, 5)
    online, _ = pushed(pdr.OnlineFilter(given), cut_randomly(pdr.merge_streams(WALK), 1), n_resumed=5)
    assert [note for note in online.notes if OFF in note] == [start, steps]


def test_the_plan_is_not_used_until_a_walk_that_starts_in_a_hole_is_inside(tmp_path: Path) -> None:
    """The first steps are those on a plan without the hole: no particle wins because its direction leaves it first."""
    corner = at(2.0, 2.0, 0.1)  # one metre from two edges
    in_hole = pdr.track(WALK, config(tmp_path, corner, [HOLE]))
    open_field = pdr.track(WALK, config(tmp_path, corner, []))
    assert_array_equal(in_hole.position_m[0], open_field.position_m[0])
    assert np.abs(in_hole.position_m - open_field.position_m)[-1].max() > 0.1
    n_off = next(int(note.split()[0]) for note in in_hole.notes if "placed" in note)
    assert n_off >= 1
    assert_allclose(in_hole.position_m[: n_off + 1], open_field.position_m[: n_off + 1], atol=1e-9)


def test_particles_start_at_the_walkable_places_within_the_deviation_of_the_start(tmp_path: Path) -> None:
    """Half a metre inside of the edge with a deviation of 1 m: at e^6 to one, the others are outside of the hole."""
    given = config(tmp_path, at(2.5, 0.0, 1.0), [HOLE])
    track = pdr.track(WALK, given)
    assert track.position_m[0, 0] > 3.0
    assert not any("placed" in note for note in track.notes)
    assert any(note.startswith("the start at 2.5 m east") for note in track.notes)


def test_fixes_in_a_hole_and_outside_of_the_outline_are_named(tmp_path: Path) -> None:
    for east_m, holes in ((0.0, [HOLE]), (-25.0, [])):
        given = config(tmp_path, None, holes).in_world_frame()
        fixes = [pdr.PositionFix(0.5 + t, [east_m + t, 0.0], 0.01 * np.eye(2)) for t in (0.0, 4.0)]
        notes = pdr.track(WALK, given, fixes=fixes).notes
        assert any("placed " + OFF in note for note in notes), notes


def test_a_start_in_a_wall_is_named_and_one_in_a_room_without_a_door_is_not(tmp_path: Path) -> None:
    thick = feature("wall", {"type": "Polygon", "coordinates": [box(4, -1, 7, 1)["coordinates"][0]]})
    plan = pdr.FloorPlan.read(write(tmp_path / "p.geojson", [*FEATURES, thick, feature("wall", line((0, 9), (1, 9)))]))
    for start, is_named in ((at(5.5, 0.0, 0.2), True), (at(4.0, 8.0, 0.2), False)):
        found = pdr.recipes.default().with_plan(plan, start)
        notes = found.on_plan.notes(found.on_plan.init())
        assert bool(notes) == is_named


@pytest.mark.parametrize("std_m", [0.3, 1.0])
def test_a_walk_on_the_plan_has_no_such_note(tmp_path: Path, std_m: float) -> None:
    track = pdr.track(WALK, config(tmp_path, at(10.0, 0.0, std_m), [HOLE]))
    assert not any(OFF in note for note in track.notes)
    assert not is_off(config(tmp_path, None, [HOLE]), track.position_m[:1]).any()
