"""Floor plans of the workbench: saved, put on Earth, edited again and checked; their pictures."""

from __future__ import annotations

import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw

import pdr_filter as pdr
from pdr_filter.apps.maps.plan_checks import problems_of
from pdr_filter.apps.workbench.pictures import convert_picture, rectify
from pdr_filter.apps.workbench.plans import Plans, pictures_of
from pdr_filter.apps.workbench.walks import ConflictError

HALL = [[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0], [0.0, 0.0]]


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    shape = "LineString" if kind in ("wall", "door") else "Polygon"
    geometry = {"type": shape, "coordinates": coordinates if shape == "LineString" else [coordinates]}
    return {"type": "Feature", "properties": {"type": kind, "floor": 0, **properties}, "geometry": geometry}


def house() -> list[dict[str, Any]]:
    return [
        feature("floor", HALL, name="hall"),
        feature("wall", [[15.0, 0.0], [15.0, 20.0]]),
        feature("door", [[15.0, 9.0], [15.0, 11.0]]),
        feature("door", [[0.0, 9.0], [0.0, 11.0]]),
    ]


@pytest.fixture
def plans(tmp_path: Path) -> Plans:
    """Plans of a folder, with an empty one of the name House."""
    found = Plans(tmp_path)
    assert found.new("House") == "House"
    return found


def test_a_plan_is_saved_as_pdr_filter_reads_it_and_edited_again(tmp_path: Path) -> None:
    plans = Plans(tmp_path)
    name = plans.new("House: <1>/..")
    assert plans.new("House: <1>/..") != name
    loaded = plans.load(name)
    storeys = {"0": {"name": "Ground", "metres_per_pixel": 0.05, "width": 600, "height": 400}}
    saved = plans.save(name, loaded["version"], loaded | {"features": house(), "storeys": storeys})
    assert (saved["problems"], saved["reason"]) == ([], "")
    assert plans.load(name) == saved
    read = pdr.FloorPlan.read(plans.path(name))
    assert read.storeys[0].summary()["features"] == {"door": 2, "floor": 1, "wall": 1}
    assert read.origin is None
    with pytest.raises(ConflictError, match="another browser"):
        plans.save(name, loaded["version"], loaded)
    assert plans.load(name) == saved


def test_of_two_saves_at_the_same_time_the_second_is_a_conflict(plans: Plans, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "House"
    loaded = plans.load(name)
    write, is_writing = plans._write, Event()

    def slow_write(*arguments: Any) -> None:
        is_writing.set()
        time.sleep(0.2)
        write(*arguments)

    monkeypatch.setattr(plans, "_write", slow_write)
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(plans.save, name, loaded["version"], loaded | {"features": house()})
        assert is_writing.wait(10)
        with pytest.raises(ConflictError, match="another browser"):
            plans.save(name, loaded["version"], loaded)
        assert len(first.result()["features"]) == len(house())
    assert len(plans.load(name)["features"]) == len(house())


def test_a_plan_with_two_known_points_lies_on_earth_and_comes_back_in_its_own_frame(plans: Plans) -> None:
    name = "House"
    origin = pdr.Origin(48.1, 11.5)
    # The plan's x axis points to the north.
    latitude, longitude = origin.latitude_longitude_deg(np.array([0.0, 30.0]))
    points = [[0.0, 0.0, 48.1, 11.5], [30.0, 0.0, float(latitude), float(longitude)]]
    loaded = plans.load(name)
    content = loaded | {"features": house(), "georeference": {"points": points}}
    saved = plans.save(name, loaded["version"], content)
    for got, wanted in zip(saved["features"], house(), strict=True):
        found, given = (np.array(f["geometry"]["coordinates"]) for f in (got, wanted))
        np.testing.assert_allclose(found, given, atol=1e-3)
    read = pdr.FloorPlan.read(plans.path(name), origin)
    corners = read.storeys[0].features[0].lines[0]
    np.testing.assert_allclose(corners[1], [0.0, 30.0], atol=0.01)
    np.testing.assert_allclose(corners[3], [-20.0, 0.0], atol=0.01)
    points[1][2] += 0.0001  # 11 m
    with pytest.raises(ValueError, match="correct the scale"):
        plans.save(name, saved["version"], content)


def test_a_plan_in_degrees_of_another_program_can_be_edited(plans: Plans, tmp_path: Path) -> None:
    name = "House"
    origin = pdr.Origin(48.1, 11.5)
    latitude, longitude = origin.latitude_longitude_deg(np.array(HALL))
    ring = np.column_stack([longitude, latitude]).tolist()
    collection = {"type": "FeatureCollection", "features": [feature("floor", ring)]}
    (tmp_path / "plans" / f"{name}.geojson").write_text(json.dumps(collection))
    loaded = plans.load(name)
    np.testing.assert_allclose(loaded["features"][0]["geometry"]["coordinates"][0], HALL, atol=0.01)
    saved = plans.save(name, loaded["version"], loaded)
    np.testing.assert_allclose(saved["features"][0]["geometry"]["coordinates"][0], HALL, atol=0.01)


def test_a_geojson_file_is_imported_as_it_is_or_refused_with_its_reason(plans: Plans) -> None:
    text = json.dumps({"type": "FeatureCollection", "features": house()})
    assert plans.new("House", text) == "House_2"
    assert plans.path("House_2").read_text("utf-8") == text
    assert len(plans.load("House_2")["features"]) == 4
    for bad in ("{", "[]", '{"features": [{"geometry": {"type": "Point", "coordinates": [1, 2]}}]}'):
        with pytest.raises(ValueError, match="Other cannot be shown as a floor plan: "):
            plans.new("Other", bad)
    assert plans.names() == ["House", "House_2"]


def test_the_picture_of_a_plan_on_earth_is_turned_and_shifted_with_it(plans: Plans) -> None:
    """A picture of 40 m by 20 m whose right points to the north."""
    origin = pdr.Origin(48.0, 11.0)
    north = [float(v) for v in np.ravel(origin.latitude_longitude_deg(np.array([[0.0, 30.0]])))]
    loaded = plans.load("House")
    storeys = {"0": {"metres_per_pixel": 0.1, "width": 400, "height": 200, "stamp": 7}, "1": {}}
    content = loaded | {"features": house(), "storeys": storeys}
    plans.save("House", loaded["version"], content)
    (picture,) = pictures_of(plans.path("House"), None)
    assert (picture["floor"], picture["stamp"]) == (0, 7)
    np.testing.assert_allclose(picture["corners"], [[0, 0], [40, 0], [0, 20]], atol=1e-9)
    reference = {"points": [[0.0, 0.0, 48.0, 11.0], [30.0, 0.0, *north]]}
    plans.save("House", plans.load("House")["version"], content | {"georeference": reference})
    (picture,) = pictures_of(plans.path("House"), origin)
    np.testing.assert_allclose(picture["corners"], [[0, 0], [0, 40], [-20, 0]], atol=0.01)


@pytest.mark.parametrize(
    ("features", "words", "number"),
    [
        ([*house(), feature("wall", [[15.0, 5.0], [25.0, 5.0]])], "open at 25.0, 5.0", 4),
        (house()[:2], "no entrance", None),
        ([feature("floor", [[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]])], "crosses itself", 0),
        ([feature("wall", [[0.0, 0.0], [9.0, 0.0]])], "no outline", None),
        ([*house(), feature("lift", [[1, 1], [1.1, 1], [1.1, 1.1], [1, 1]])], "area is only", 4),
    ],
)
def test_mistakes_of_a_drawing_are_named_with_their_shape(
    features: list[dict[str, Any]], words: str, number: int | None
) -> None:
    found = [p for p in problems_of(features) if words in p["words"]]
    assert found
    assert found[0]["feature"] == number
    assert problems_of(house()) == []


def test_a_photograph_is_rectified_by_four_corners(tmp_path: Path) -> None:
    picture = Image.new("RGB", (400, 300), "white")
    corners = [(60, 40), (340, 70), (380, 280), (20, 250)]
    ImageDraw.Draw(picture).polygon(corners, fill="red")
    path = tmp_path / "plan.png"
    picture.save(path)
    size = rectify(path, corners)
    made = np.asarray(Image.open(path))
    assert made.shape == (size["height"], size["width"], 3)
    inside = made[4:-4, 4:-4].reshape(-1, 3)
    assert (inside == [255, 0, 0]).all()
    with pytest.raises(ValueError, match="without crossing"):
        rectify(path, [corners[k] for k in (0, 2, 1, 3)])
    with pytest.raises(ValueError, match="four points"):
        rectify(path, corners[:3])


def test_pictures_become_png_of_bounded_size(tmp_path: Path) -> None:
    source = tmp_path / "scan"
    Image.new("L", (6000, 3000), 200).save(source, "JPEG")
    assert convert_picture(source, 1, tmp_path / "plan.png") == {"width": 4000, "height": 2000}
    assert Image.open(tmp_path / "plan.png").format == "PNG"


def test_a_page_of_a_pdf_file_becomes_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("pypdfium2")
    import matplotlib.figure

    source = tmp_path / "plan.pdf"
    matplotlib.figure.Figure((8, 4)).savefig(source)
    assert convert_picture(source, 1, tmp_path / "plan.png") == {"width": 4000, "height": 2000}
    with pytest.raises(ValueError, match="no page 2"):
        convert_picture(source, 2, tmp_path / "plan.png")
