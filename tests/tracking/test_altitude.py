"""Altitude of a track: estimated from the locations of a phone, and written to files."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cut_randomly, pushed, true_position_m

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.height.height_filter import Altitude
from pdr_filter.simulate import Leg, SensorErrors, simulate
from pdr_filter.simulate.sensors import BAROMETER
from pdr_filter.values import PositionFix, Samples
from pdr_filter.values.recording import Recording

HERE = pdr.Origin(48.137, 11.575)
START_M, NOISE_M = 519.0, 6.0


@pytest.fixture(scope="module")
def walk() -> Recording:
    """A walk up one storey, with a barometer and with locations whose altitudes have errors of some metres."""
    legs = [Leg("walking", distance_m=50.0), Leg("upstairs", distance_m=9.0), Leg("walking", distance_m=50.0)]
    bare = simulate(legs, seed=4, name="walk", errors=SensorErrors(barometer=BAROMETER))
    truth = bare.truth.position
    time_s = np.arange(1.3, bare.duration_s)
    up_m = np.interp(time_s, truth.time_s, truth["up_m"])
    latitude_deg, longitude_deg = HERE.latitude_longitude_deg(true_position_m(bare, time_s))
    altitude_m = START_M + up_m + np.random.default_rng(3).normal(scale=NOISE_M, size=len(time_s))
    values = np.column_stack([latitude_deg, longitude_deg, altitude_m, np.full(len(time_s), 6.0)])
    return replace(bare, location=Samples(time_s, values))


@pytest.fixture(scope="module")
def track(walk: Recording) -> pdr.Track:
    return pdr.track(walk)


def fix(altitude_m: float, std_m: float, time_s: float = 0.0, correlation_s: float = 0.0) -> PositionFix:
    how = {"correlation_s": correlation_s, "altitude_m": altitude_m, "altitude_std_m": std_m}
    return PositionFix(time_s, np.zeros(2), np.eye(2), **how)


def known_from(fixes: Sequence[PositionFix], heights_m: Sequence[float]) -> Altitude:
    known = Altitude()
    for each, height_m in zip(fixes, heights_m, strict=True):
        known = known.with_fix(each, height_m, 0.0)
    return known


# --- of the start -----------------------------------------------------------------------------------------------------


def test_altitudes_minus_heights_are_averaged_with_inverse_variance_weights() -> None:
    known = known_from([fix(103.0, 2.0), fix(110.0, 4.0)], [0.0, 6.0])
    assert known.altitude_m == pytest.approx((103.0 / 4.0 + 104.0 / 16.0) / (1 / 4.0 + 1 / 16.0))
    assert known.var_m2 == pytest.approx(1.0 / (1 / 4.0 + 1 / 16.0))


def test_many_simultaneous_altitudes_have_little_more_weight_than_one() -> None:
    known = known_from([fix(100.0, 3.0, 0.01 * k, correlation_s=20.0) for k in range(100)], np.zeros(100).tolist())
    assert known.altitude_m == pytest.approx(100.0)
    assert 0.9 < math.sqrt(known.var_m2) / 3.0 <= 1.0


def test_an_outlying_altitude_moves_the_altitude_of_the_start_by_less_than_a_standard_deviation() -> None:
    good = [fix(100.0, 3.0) for _ in range(9)]
    known = known_from([*good, fix(1100.0, 3.0)], [0.0] * 10)
    assert abs(known.altitude_m - 100.0) < 1.0


def test_a_track_has_the_altitude_of_its_start_and_of_each_step(walk: Recording, track: pdr.Track) -> None:
    for found in (track, pdr.track(walk, gnss="align")):
        assert found.origin is not None
        assert found.altitude_m is not None
        assert found.origin.height_m is not None
        assert found.origin.height_std_m is not None
        assert abs(found.origin.height_m - START_M) < 3.0 * found.origin.height_std_m
        assert 1.0 < found.origin.height_std_m < 2.0 * NOISE_M
        np.testing.assert_array_equal(found.altitude_m, found.origin.height_m + found.height_m)
        assert found.height_m[-1] > 1.5  # which the barometer shows: the altitude of the end is not that of the start


def test_an_online_filter_has_the_same_altitude_as_a_track_of_the_recording(walk: Recording, track: pdr.Track) -> None:
    # `pdr.track` uses the magnetic field with the declination of the place by default
    config = recipes.default().with_magnetic_north(HERE.declination_rad())
    online = pdr.OnlineFilter(config)
    location, barometer = walk.location, walk.barometer
    assert location is not None
    assert barometer is not None
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
    online.push_location(location.time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m)
    online.push_pressure(barometer.time_s, barometer.values[:, 0])
    online, _ = pushed(online, cut_randomly(pdr.merge_streams(walk), 2), n_resumed=4)
    assert track.origin is not None
    assert online.origin is not None
    assert online.origin.height_m == pytest.approx(track.origin.height_m, abs=1e-9)
    assert online.origin.height_std_m == pytest.approx(track.origin.height_std_m, abs=1e-9)


@pytest.mark.parametrize("altitude_m", [0.0, np.nan])
def test_an_altitude_of_zero_or_nan_is_ignored(walk: Recording, altitude_m: float, tmp_path: Path) -> None:
    assert walk.location is not None
    values = walk.location.values.copy()
    values[:, 2] = altitude_m
    track = pdr.track(replace(walk, location=Samples(walk.location.time_s, values)))
    assert track.origin is not None
    assert track.origin.height_m is None
    assert track.altitude_m is None
    assert "<ele>" not in track.to_gpx(tmp_path / "a.gpx").read_text()
    feature = json.loads(track.to_geojson(tmp_path / "a.geojson").read_text())["features"][0]
    assert feature["properties"]["height"] == "metres above the start of the walk"
    assert feature["geometry"]["coordinates"][0][2] == 0.0


# --- files ------------------------------------------------------------------------------------------------------------


def test_the_summary_of_a_walk_with_climbs_has_the_height_and_storey_of_its_end(track: pdr.Track) -> None:
    summary = track.summary()
    assert summary["end_height_m"] == pytest.approx(track.height_m[-1], abs=1e-3)
    assert summary["end_height_std_m"] == pytest.approx(track.height_std_m[-1], abs=1e-3)
    assert summary["end_floor"] == track.floor[-1]
    none = np.zeros(track.n_steps)
    level = replace(track, height_m=none, floor=none.astype(np.int64), floor_passages=())
    assert not {"end_height_m", "end_height_std_m", "end_floor"} & level.summary().keys()


def test_files_have_the_altitude_where_it_is_known(track: pdr.Track, tmp_path: Path) -> None:
    assert track.altitude_m is not None
    feature = json.loads(track.to_geojson(tmp_path / "a.geojson").read_text())["features"][0]
    assert feature["geometry"]["coordinates"][-1][2] == pytest.approx(track.altitude_m[-1], abs=1e-3)
    assert feature["properties"]["height"].startswith("altitude")
    assert f"<ele>{track.altitude_m[-1]:.2f}</ele>" in track.to_gpx(tmp_path / "a.gpx").read_text()
    rows = list(csv.DictReader(track.to_csv(tmp_path / "a.csv").read_text().splitlines()))
    assert float(rows[-1]["altitude_m"]) == pytest.approx(track.altitude_m[-1], abs=1e-3)
