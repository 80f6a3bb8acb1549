"""Written tracks say what the track says, in the form that other programs read."""

from __future__ import annotations

import csv
import importlib.util
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pymap3d
import pytest
from helpers import windows_of
from made_tracks import make_track
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.data.io.files import track_writers as writers
from pdr_filter.simulate import Leg
from pdr_filter.tracking.track import Track

ORIGIN = (48.137, 11.575)
GPX, KML = {"g": "http://www.topografix.com/GPX/1/1"}, {"k": "http://www.opengis.net/kml/2.2"}


def small_track(n: int = 3) -> Track:
    """Steps to the east, to the north, and to the west again."""
    contexts = ("stationary", "walking")
    return make_track(
        n,
        0,
        name="small <walk>",
        time_s=np.array([1.5, 2.0, 2.5])[:n],
        position_m=np.array([[0.7, 0.0], [0.7, 0.8], [0.0, 0.8]])[:n],
        position_cov_m2=np.array([[0.1, 0.02], [0.02, 0.2]]) * np.arange(1, n + 1)[:, None, None],
        step_length_m=np.array([0.7, 0.8, 0.7])[:n],
        walked_m=np.array([0.7, 1.5, 2.2])[:n],
        walking_heading_rad=np.array([np.pi / 2, 0.0, -np.pi / 2])[:n],
        smoothed_speed_mps=np.array([1.4, 1.5, 1.45])[:n],
        context_prob=np.tile([0.25, 0.75], (n, 1)),
        contexts=contexts,
        mode_prob=np.ones((n, 1)),
        modes=("walk, normal",),
        mode_contexts=("walking",),
        windows=windows_of(np.empty(0), np.empty((0, 2)), contexts),
        start_time_s=1.0,
        duration_s=2.0,
        notes=("only a test",),
    )


def assert_places(latitude_deg: np.ndarray, longitude_deg: np.ndarray, origin: tuple[float, float] = ORIGIN) -> None:
    """Check the origin and the positions of the small track."""
    assert (latitude_deg[0], longitude_deg[0]) == origin
    east, north, _ = pymap3d.geodetic2enu(latitude_deg[1:], longitude_deg[1:], 0, *origin, 0)
    np.testing.assert_allclose(np.column_stack([east, north]), small_track().position_m, atol=1e-3)


WRITERS: dict[str, Callable[[Track, Path], Path]] = {
    "csv": writers.write_csv,
    "geojson": lambda track, path: writers.write_geojson(track, path, ORIGIN),
    "gpx": lambda track, path: writers.write_gpx(track, path, ORIGIN, 1.7e9),
    "kml": lambda track, path: writers.write_kml(track, path, ORIGIN),
    "local.geojson": writers.write_local_geojson,
    "tum": writers.write_tum,
}
PARQUET = importlib.util.find_spec("pyarrow") is not None and importlib.util.find_spec("pandas") is not None
needs_parquet = pytest.mark.skipif(not PARQUET, reason="needs the extra `parquet`")


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("n", [0, 1, 3])
def test_every_writer_makes_the_folder_and_returns_the_path(tmp_path: Path, kind: str, n: int) -> None:
    path = WRITERS[kind](small_track(n), tmp_path / "new" / "folder" / f"track.{kind}")
    assert path == tmp_path / "new" / "folder" / f"track.{kind}"
    assert path.read_text().endswith("\n")


def test_a_file_of_a_track_without_steps_has_the_start_alone(tmp_path: Path) -> None:
    text = {kind: write(small_track(0), tmp_path / f"t.{kind}").read_text() for kind, write in WRITERS.items()}
    assert len(text["csv"].splitlines()) == 1
    geometry = json.loads(text["geojson"])["features"][0]["geometry"]
    assert geometry == {"type": "Point", "coordinates": [11.575, 48.137]}
    placemarks = ElementTree.fromstring(text["kml"].encode()).findall("k:Document/k:Placemark", KML)
    assert [placemark.findtext("k:name", "", KML) for placemark in placemarks] == ["start"]
    (row,) = text["tum"].splitlines()
    assert [float(field) for field in row.split()[:4]] == [1.0, 0, 0, 0]


def test_the_methods_of_a_track_write_the_same_files(tmp_path: Path) -> None:
    track = small_track()
    for kind in ("csv", "geojson", "gpx", "kml", "local_geojson", "tum"):
        options = [ORIGIN] if kind in ("geojson", "gpx", "kml") else []
        ours = getattr(track, f"to_{kind}")(tmp_path / "ours", *options)
        theirs = getattr(writers, f"write_{kind}")(track, tmp_path / "theirs", *options)
        assert ours.read_bytes() == theirs.read_bytes()


def test_csv_has_one_line_for_each_step_under_names_with_units(tmp_path: Path) -> None:
    with writers.write_csv(small_track(), tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3
    assert {name: float(value) for name, value in rows[1].items()} == pytest.approx(
        {
            "time_s": 2.0,
            "east_m": 0.7,
            "north_m": 0.8,
            "cov_ee_m2": 0.2,
            "cov_en_m2": 0.04,
            "cov_nn_m2": 0.4,
            "position_std_m": np.sqrt(np.linalg.eigvalsh([[0.2, 0.04], [0.04, 0.4]])[-1]),
            "step_length_m": 0.8,
            "walked_m": 1.5,
            "walking_heading_rad": 0.0,
            "smoothed_speed_mps": 1.5,
            "smoothed_speed_std_mps": 0.1,
            "height_m": 0.0,
            "height_std_m": 0.0,
            "floor": 0.0,
            "floor_prob": 1.0,
            "context_prob_stationary": 0.25,
            "context_prob_walking": 0.75,
            "mode_prob_walk, normal": 1.0,
        }
    )


def test_csv_of_a_placed_track_says_where_each_step_was_on_earth(tmp_path: Path) -> None:
    track = small_track().placed(ORIGIN)
    for path in (track.to_csv(tmp_path / "a.csv"), small_track().to_csv(tmp_path / "b.csv", ORIGIN)):
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        place = np.array([[float(row["latitude_deg"]), float(row["longitude_deg"])] for row in rows])
        np.testing.assert_allclose(place, np.column_stack([track.latitude_deg, track.longitude_deg]), atol=1e-9)


@needs_parquet
@pytest.mark.parametrize("n", [0, 1, 3])
def test_parquet_read_back_in_pandas_and_written_as_csv_is_the_csv_file(tmp_path: Path, n: int) -> None:
    import pandas as pd

    track = replace(small_track(n), step_length_m=np.array([1 / 3, np.nan, 1e-9])[:n])
    frame = pd.read_parquet(track.to_parquet(tmp_path / "new" / "t.parquet"))
    times = frame.pop("time_s").map("{:.6f}".format)
    texts = frame.map(lambda value: f"{value:.7g}")
    texts.insert(0, "time_s", times)
    texts.to_csv(tmp_path / "frame.csv", index=False, lineterminator="\n")
    assert (tmp_path / "frame.csv").read_text() == track.to_csv(tmp_path / "t.csv").read_text()
    np.testing.assert_array_equal(frame.step_length_m, track.step_length_m)  # with all digits
    assert all(dtype == np.float64 for dtype in frame.dtypes)


@needs_parquet
def test_a_frame_of_pandas_has_the_columns_of_the_csv_file_and_windows_have_one_row_each(tmp_path: Path) -> None:
    track = small_track()
    import pandas as pd

    frame = track.to_pandas(origin=(48.1, 11.5))
    written = pd.read_csv(track.to_csv(tmp_path / "t.csv", origin=(48.1, 11.5)))
    assert list(frame.columns) == list(written.columns)
    np.testing.assert_allclose(frame.to_numpy(), written.to_numpy(), rtol=1e-6, atol=1e-6)
    assert frame.attrs["name"] == track.name
    windows = track.windows.to_pandas()
    assert len(windows) == len(track.windows)
    names = [f"context_prob_{name}" for name in track.windows.contexts]
    np.testing.assert_array_equal(windows[names].to_numpy(), track.windows.context_prob)


def test_without_pandas_a_frame_is_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r'Track\.to_pandas needs pandas, .*: pip install "pdr_filter\[parquet\]"'):
        small_track().to_pandas()
    with pytest.raises(ImportError, match=r"Windows\.to_pandas needs pandas"):
        small_track().windows.to_pandas()


@needs_parquet
def test_parquet_has_in_its_metadata_what_is_in_no_column(tmp_path: Path) -> None:
    import pandas as pd

    said = pd.read_parquet(small_track().to_parquet(tmp_path / "t.parquet")).attrs
    assert (said["name"], said["weighting"]) == ("small <walk>", "imm")
    assert (said["start_time_s"], said["duration_s"]) == (1.0, 2.0)
    assert said["notes"] == ["only a test"]
    assert said["frame"] == small_track().about_frame
    assert said["origin"] is None


@needs_parquet
def test_the_command_line_writes_parquet_and_a_page_for_each_of_two_tracks_of_one_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas as pd

    walk = pdr.simulate.simulate([Leg("walking", distance_m=12.0)], rate_hz=50.0, name="walk")
    paths = [str(walk.save(tmp_path / place / "walk.zip")) for place in ("a", "b")]
    command = ["track", *paths, "--parquet", "--report", "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert {path.stem for path in (tmp_path / "out").glob("*.html")} == {"walk", "walk_2"}
    for name in ("walk", "walk_2"):
        frame = pd.read_parquet(tmp_path / "out" / f"{name}.parquet")
        csv_frame = pd.read_csv(tmp_path / "out" / f"{name}.csv", dtype=float)
        pd.testing.assert_frame_equal(frame, csv_frame, rtol=1e-6, atol=1e-6)
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["track", paths[0], "--export", "parquet"]).exit_code == 0
    assert (tmp_path / "walk.parquet").read_bytes() == (tmp_path / "out" / "walk.parquet").read_bytes()
    many = CliRunner().invoke(app, ["track", *paths, "--jobs", "1", "--parquet", "--out", str(tmp_path / "many")])
    assert many.exit_code == 0
    assert len(pd.read_parquet(tmp_path / "many" / "tracks.parquet")) == 2


@pytest.mark.parametrize("missing", ["pandas", "pyarrow"])
def test_parquet_without_its_packages_is_refused_with_the_extra_to_install(
    tmp_path: Path, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ValueError, match=r"t\.parquet.*pip install 'pdr_filter\[parquet\]'"):
        small_track().to_parquet(tmp_path / "t.parquet")
    assert not list(tmp_path.iterdir())


def test_geojson_is_one_line_from_the_origin_through_all_steps(tmp_path: Path) -> None:
    track = small_track()
    collection = json.loads(writers.write_geojson(track, tmp_path / "t.geojson", ORIGIN).read_text())
    assert collection["type"] == "FeatureCollection"
    (feature,) = collection["features"]
    assert feature["geometry"]["type"] == "LineString"
    lon, lat = np.array(feature["geometry"]["coordinates"]).T
    assert_places(lat, lon)
    properties = feature["properties"]
    assert properties["coordTimes"] == [1.0, 1.5, 2.0, 2.5]
    assert properties["covariance_m2"] == [[0, 0, 0], [0.1, 0.02, 0.2], [0.2, 0.04, 0.4], [0.3, 0.06, 0.6]]
    assert properties["distance_m"] == 2.2
    assert (properties["frame"], properties["about"]) == ("start", track.placed(ORIGIN).about_frame)
    assert properties["end_std_m"] == pytest.approx(track.position_std_m[-1], abs=1e-3)
    assert properties["notes"] == ["only a test"]


@pytest.mark.parametrize("origin", [(91.0, 0.0), (-90.1, 0.0), (0.0, 181.0), (0.0, -181.0), (float("nan"), 0.0)])
def test_an_origin_that_is_nowhere_is_refused_and_nothing_is_written(
    tmp_path: Path, origin: tuple[float, float]
) -> None:
    for write in (writers.write_geojson, writers.write_gpx, writers.write_kml, writers.write_csv):
        with pytest.raises(ValueError, match=r"origin must be \(latitude, longitude\)"):
            write(small_track(), tmp_path / "t", origin)
    assert not list(tmp_path.iterdir())


def test_a_track_without_a_place_is_drawn_in_the_open_sea_and_says_that_it_is_nowhere(tmp_path: Path) -> None:
    track = small_track()
    for name in ("a.geojson", "a.local.geojson", "a"):
        assert track.to_local_geojson(tmp_path / name) == tmp_path / "a.local.geojson"
    (feature,) = json.loads((tmp_path / "a.local.geojson").read_text())["features"]
    said = feature["properties"]
    assert (said["name"], said["frame"]) == ("small <walk> (local, not on Earth)", "local, not on Earth")
    assert said["about"].startswith(track.about_frame)
    lon, lat = np.array(feature["geometry"]["coordinates"]).T
    assert_places(lat, lon, (0.0, 0.0))
    with pytest.raises(ValueError, match="has a place on Earth"):
        track.placed(ORIGIN).to_local_geojson(tmp_path / "b.geojson")


def test_kml_has_the_way_its_start_and_its_end_with_how_far_and_how_sure(tmp_path: Path) -> None:
    track = small_track()
    root = ElementTree.parse(track.to_kml(tmp_path / "t.kml", ORIGIN)).getroot()
    assert root.findtext("k:Document/k:name", namespaces=KML) == "small <walk>"
    about = root.findtext("k:Document/k:description", "", KML)
    for words in ("3 steps, 2.2 m", track.how_sure, track.placed(ORIGIN).about_frame, "Note: only a test."):
        assert words in about
    places = {
        placemark.findtext("k:name", "", KML): [
            [float(value) for value in vertex.split(",")]
            for vertex in (placemark.findtext("*/k:coordinates", "", KML)).split()
        ]
        for placemark in root.findall("k:Document/k:Placemark", KML)
    }
    way = np.array(places["small <walk>"])
    assert_places(way[:, 1], way[:, 0])
    assert places["start"] == [list(way[0])] == [[ORIGIN[1], ORIGIN[0]]]
    assert places["end"] == [list(way[-1])]


def test_gpx_has_a_point_with_time_for_the_start_and_each_step(tmp_path: Path) -> None:
    path = writers.write_gpx(small_track(), tmp_path / "t.gpx", ORIGIN, epoch_s=1_700_000_000.0)
    root = ElementTree.parse(path).getroot()
    assert root.tag == "{http://www.topografix.com/GPX/1/1}gpx"
    assert root.get("version") == "1.1"
    assert root.findtext("g:trk/g:name", namespaces=GPX) == "small <walk>"
    points = root.findall("g:trk/g:trkseg/g:trkpt", GPX)
    times = [point.findtext("g:time", namespaces=GPX) for point in points]
    assert times == [f"2023-11-14T22:13:{second}Z" for second in ("21.000", "21.500", "22.000", "22.500")]
    lat, lon = (np.array([float(point.get(name, "nan")) for point in points]) for name in ("lat", "lon"))
    assert_places(lat, lon)


def test_gpx_and_kml_stay_readable_with_a_name_that_xml_cannot_hold(tmp_path: Path) -> None:
    odd = replace(small_track(), name="a\x00\ud800b")
    gpx = ElementTree.parse(writers.write_gpx(odd, tmp_path / "t.gpx", ORIGIN)).getroot()
    kml = ElementTree.parse(writers.write_kml(odd, tmp_path / "t.kml", ORIGIN)).getroot()
    assert gpx.findtext("g:trk/g:name", namespaces=GPX) == kml.findtext("k:Document/k:name", namespaces=KML) == "ab"


@pytest.mark.parametrize("epoch_s", [-10.0, 1.7e12, float("nan"), float("inf")])
def test_an_epoch_outside_the_calendar_is_refused(tmp_path: Path, epoch_s: float) -> None:
    with pytest.raises(ValueError, match="epoch_s must be the unix time"):
        writers.write_gpx(small_track(), tmp_path / "t.gpx", ORIGIN, epoch_s)


def test_tum_has_positions_and_the_yaw_of_the_walking_heading(tmp_path: Path) -> None:
    text = writers.write_tum(small_track(), tmp_path / "t.tum").read_text()
    assert all(line == " ".join(line.split()) for line in text.splitlines())
    rows = np.array([[float(field) for field in line.split(" ")] for line in text.splitlines()])
    assert rows.shape == (4, 8)
    np.testing.assert_allclose(rows[:, 0], [1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(rows[:, 1:4], [[0, 0, 0], [0.7, 0, 0], [0.7, 0.8, 0], [0, 0.8, 0]])
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1, atol=1e-8)
    qz, qw = rows[:, 6], rows[:, 7]
    facing = np.column_stack([1 - 2 * qz**2, 2 * qz * qw])  # the x axis turned by the quaternion: east, north
    np.testing.assert_allclose(facing, [[1, 0], [1, 0], [0, 1], [-1, 0]], atol=1e-8)


def test_tum_times_ascend_strictly_even_where_steps_share_one(tmp_path: Path) -> None:
    track = replace(small_track(), time_s=np.array([1.0, 1.6, 1.6000001]))
    text = writers.write_tum(track, tmp_path / "t.tum").read_text()
    assert [line.split()[0] for line in text.splitlines()] == ["1.000000", "1.600000"]


def test_a_track_that_climbs_has_its_heights_as_third_coordinate_and_a_level_one_none(tmp_path: Path) -> None:
    level = small_track()
    climbs = replace(level, height_m=np.array([0.0, 1.5, 3.06]), floor=np.array([0, 0, 1]))
    (flat,), (up,) = (
        json.loads(made.to_geojson(tmp_path / "t.geojson", origin=(48.0, 11.0)).read_text())["features"]
        for made in (level, climbs)
    )
    assert {len(vertex) for vertex in flat["geometry"]["coordinates"]} == {2}
    assert [vertex[2] for vertex in up["geometry"]["coordinates"]] == [0.0, 0.0, 1.5, 3.06]
    assert [vertex[:2] for vertex in up["geometry"]["coordinates"]] == flat["geometry"]["coordinates"]
    assert up["properties"]["height"] == "metres above the start of the walk"
    assert up["properties"]["floor"] == [0, 0, 0, 1]
    assert "height" not in flat["properties"]


EDGE = (-16.8, 179.99999)  # one metre west of 180 degrees


def parts_of_line(track: pdr.Track, folder: Path) -> dict[str, list[np.ndarray]]:
    """Longitude and latitude of each part of the line in each format."""
    (feature,) = json.loads(track.to_geojson(folder / "t.geojson").read_text())["features"]
    assert feature["geometry"]["type"] == "MultiLineString"
    gpx = ElementTree.parse(track.to_gpx(folder / "t.gpx")).getroot()
    kml = ElementTree.parse(track.to_kml(folder / "t.kml")).getroot()
    lines = kml.findall("k:Document/k:Placemark/k:MultiGeometry/k:LineString/k:coordinates", KML)
    return {
        "geojson": [np.array(part)[:, :2] for part in feature["geometry"]["coordinates"]],
        "gpx": [
            np.array([[float(point.get(key)) for key in ("lon", "lat")] for point in segment])
            for segment in gpx.findall("g:trk/g:trkseg", GPX)
        ],
        "kml": [np.array([vertex.split(",") for vertex in line.text.split()], dtype=float) for line in lines],
    }


@pytest.mark.parametrize("origin", [EDGE, (EDGE[0], 180.0), (EDGE[0], -180.0)])
def test_a_line_over_180_degrees_is_cut_there_in_every_format(tmp_path: Path, origin: tuple[float, float]) -> None:
    """RFC 7946, 3.1.9: east of the start, then west of it, and east again."""
    easts = [3.0, -3.0, 2.0]
    track = replace(small_track(), position_m=np.column_stack([easts, [1.0, 2.0, 3.0]])).placed(origin)
    for name, parts in parts_of_line(track, tmp_path).items():
        assert len(parts) >= 3, name
        for part in parts:
            assert np.abs(np.diff(part[:, 0])).max() < 1e-3
        for before, after in pairwise(parts):  # each part begins where the one before ends, on the other side
            assert before[-1, 0] == -after[0, 0]
            assert abs(before[-1, 0]) == 180
            assert before[-1, 1] == pytest.approx(after[0, 1], abs=1e-9)
        along = np.concatenate([np.unwrap(part[:, 0], period=360) % 360 for part in parts])
        assert np.ptp(along) == pytest.approx(6.0 / (111_320 * np.cos(np.radians(origin[0]))), rel=0.01)


def test_each_part_of_a_cut_line_has_its_times_and_storeys(tmp_path: Path) -> None:
    track = replace(small_track(), position_m=np.array([[3.0, 1.0], [4.0, 2.0], [5.0, 3.0]])).placed(EDGE)
    (feature,) = json.loads(track.to_geojson(tmp_path / "t.geojson").read_text())["features"]
    times = feature["properties"]["coordTimes"]
    assert [len(part) for part in times] == [len(part) for part in feature["geometry"]["coordinates"]]
    assert times[0][0] == 1.0
    assert times[1][1:] == [1.5, 2.0, 2.5]
    assert times[0][-1] == times[1][0]
    assert 1.0 < times[0][-1] < 1.5
