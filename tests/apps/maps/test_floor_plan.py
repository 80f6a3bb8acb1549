"""Floor plans are read as drawn, and invalid plans are refused with the feature and the remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_up import FEATURES, box, feature, in_degrees, line, write

import pdr_filter as pdr
from pdr_filter.apps.maps.storey import CELL_M, FREE, LIFT, OUTSIDE, ROOM, STAIRS, WALL


def kinds(plan: pdr.FloorPlan, *points: tuple[float, float]) -> list[int]:
    return plan.storeys[0].kind_at(np.array(points)).tolist()


def test_cells_have_the_kind_of_the_feature_drawn_there(tmp_path: Path) -> None:
    features = [
        *FEATURES,
        feature("stairs", box(0, -1, 2, 1)),
        feature("elevator", box(39, 10, 40, 11)),
        feature("wall", line((20, -1.2), (20, 0.5))),
    ]
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", features))
    places = [(5, 0), (20, 8), (50, 0), (1, 0), (39.5, 10.5), (20, 0), (20, 0.9)]
    assert kinds(plan, *places) == [FREE, ROOM, OUTSIDE, STAIRS, LIFT, WALL, FREE]


def test_html_entities_in_names_are_decoded(tmp_path: Path) -> None:
    shop = feature("room", box(20, 5, 25, 9), name="H&amp;M")
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", [*FEATURES, shop]))
    assert "H&M" in {f.name for f in plan.storeys[0].features}


def test_a_room_with_a_door_is_walkable_and_has_walls_except_at_the_door(tmp_path: Path) -> None:
    features = [*FEATURES, feature("door", line((20, 1.2), (21, 1.2)))]
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", features))
    assert kinds(plan, (20, 8), (20.5, 1.2), (25, 1.2), (0, 5)) == [FREE, FREE, WALL, ROOM]


def test_every_line_across_a_wall_hits_a_wall_cell(tmp_path: Path) -> None:
    wall = feature("wall", line((3, -1.1), (17.3, 0.9)))
    storey = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", [*FEATURES, wall])).storeys[0]
    along = np.linspace(0.05, 0.95, 200)[:, None] * np.array([14.3, 2.0]) + [3, -1.1]
    across = np.array([-2.0, 14.3]) / np.hypot(2.0, 14.3)
    looks = along[:, None] + np.linspace(-0.4, 0.4, 9)[None, :, None] * across
    assert (storey.kind_at(looks) == WALL).any(axis=1).all()


def test_the_middle_of_each_cell_is_in_that_cell_and_places_off_the_grid_are_in_none(tmp_path: Path) -> None:
    storey = pdr.FloorPlan.read(write(tmp_path / "plan.geojson")).storeys[0]
    number, inside = storey.index(storey.middles_m)
    assert inside.all()
    np.testing.assert_array_equal(number, np.arange(storey.cells.size).reshape(storey.cells.shape))
    n_rows, n_columns = storey.cells.shape
    off = storey.south_west_m + CELL_M * np.array([[-0.1, 0.5], [0.5, -0.1], [n_columns, 0.5], [0.5, n_rows]])
    assert not storey.index(off)[1].any()


def test_a_plan_in_degrees_equals_the_plan_in_metres(tmp_path: Path) -> None:
    origin = pdr.Origin(48.1, 11.5)
    degrees = write(tmp_path / "degrees.geojson", in_degrees(FEATURES, origin))
    plan = pdr.FloorPlan.read(degrees, origin=origin)
    metres = pdr.FloorPlan.read(write(tmp_path / "metres.geojson"))
    places = np.random.default_rng(0).uniform([-3, -3], [43, 21], (2000, 2))
    same = plan.storeys[0].kind_at(places) == metres.storeys[0].kind_at(places)
    assert same.mean() > 0.98  # cells at edges may differ
    assert plan.origin == origin


def test_features_of_one_storey_are_not_on_another(tmp_path: Path) -> None:
    upstairs = [feature("floor", box(0, 0, 10, 10), floor=1), feature("room", box(2, 2, 4, 4), floor=1, name="up")]
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", [*FEATURES, *upstairs]))
    assert [s.floor for s in plan.storeys] == [0, 1]
    first = plan.storey(1)
    assert first is not None and first.kind_at(np.array([3.0, 3.0])) == ROOM
    assert first.kind_at(np.array([20.0, 8.0])) == OUTSIDE  # the block of below
    assert plan.storey(2) is None


def test_the_order_of_walls_does_not_matter(tmp_path: Path) -> None:
    walls = [feature("wall", line((x, -1.2), (x + 3, 1.0))) for x in range(0, 30, 5)]
    plans = [pdr.FloorPlan.read(write(tmp_path / "p.geojson", FEATURES + w)) for w in (walls, walls[::-1])]
    np.testing.assert_array_equal(plans[0].storeys[0].cells, plans[1].storeys[0].cells)


def test_without_an_outline_the_floor_is_the_area_enclosed_by_the_walls(tmp_path: Path) -> None:
    walls = [feature("wall", line((0, 0), (10, 0), (10, 10), (0, 10), (0, 0)))]
    plan = pdr.FloorPlan.read(write(tmp_path / "plan.geojson", walls))
    assert kinds(plan, (5, 5), (13, 5)) == [FREE, OUTSIDE]
    assert not plan.summary()["storeys"][0]["has_outline"]


def test_an_area_of_unknown_type_is_a_room_with_a_note(tmp_path: Path) -> None:
    plan = pdr.FloorPlan.read(write(tmp_path / "p.geojson", [*FEATURES, feature("aquarium", box(5, -1, 6, 1))]))
    assert kinds(plan, (5.5, 0)) == [ROOM]
    assert any("aquarium" in note for note in plan.notes)


BOW_TIE = {"type": "Polygon", "coordinates": [[[0, 0], [9, 9], [9, 0], [0, 9], [0, 0]]]}
SWAPPED = {"type": "Polygon", "coordinates": [[[48.1, 111.5], [48.1, 111.501], [48.101, 111.501], [48.1, 111.5]]]}


@pytest.mark.parametrize(
    ("features", "words"),
    [
        ([], "no features"),
        ([feature("floor", BOW_TIE, name="tie")], r"feature 0 \('tie'\).*Self-intersection.*Fix geometries"),
        ([feature("floor", box(0, 0, 40_000, 20_000))], "millimetres"),
        ([feature("floor", box(0, 0, 0.5, 0.5))], "spans 0.5"),
        ([feature("floor", SWAPPED)], "longitude first: swap"),
        ([feature("room", box(0, 0, 5, 5))], "neither an outline nor walls"),
        ([feature("floor", line((0, 0), (5, 5)))], "draw it as a polygon"),
        ([{"type": "Feature", "properties": {}, "geometry": box(0, 0, 5, 5)}], 'no property "type"'),
        ([feature("floor", {"type": "Polygon", "coordinates": "x"})], "feature 0 has a geometry that cannot be read"),
        ([feature("floor", {"type": "Point", "coordinates": [1, 2]})], "Point"),
        ([feature("floor", box(0, 0, 9, 9), floor="attic")], "'attic'.*whole number"),
        ([feature("floor", box(0, 0, float("nan"), 9))], "feature 0"),
    ],
)
def test_an_invalid_plan_is_refused_with_the_problem(tmp_path: Path, features: list, words: str) -> None:
    with pytest.raises(ValueError, match=words) as raised:
        pdr.FloorPlan.read(write(tmp_path / "bad.geojson", features))
    assert "bad.geojson" in str(raised.value)


def test_swapped_longitude_and_latitude_are_detected_by_the_origin(tmp_path: Path) -> None:
    swapped = feature("floor", box(48.1, 11.5, 48.101, 11.501))
    with pytest.raises(ValueError, match="check the order of the coordinates"):
        pdr.FloorPlan.read(write(tmp_path / "plan.geojson", [swapped]), origin=(48.1, 11.5))


OTHER = '{"type": "Topology", "features": []}'


def test_a_missing_plan_file_is_refused_with_its_path(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.geojson: no such file; check the path"):
        pdr.FloorPlan.read(tmp_path / "none.geojson")


@pytest.mark.parametrize("text", ["", "{}", "[1, 2]", '{"type": "Feature"}', '{"type": "FeatureCollection"}', OTHER])
def test_a_file_without_a_feature_collection_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "plan.geojson"
    path.write_text(text)
    with pytest.raises(ValueError, match="not a GeoJSON FeatureCollection"):
        pdr.FloorPlan.read(path)
