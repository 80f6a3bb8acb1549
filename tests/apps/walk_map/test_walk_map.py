"""Maps of walks through a simulated building, with known truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heard import chains_made_once, walk_with_wifi
from true_positions import true_m

import pdr_filter as pdr
from pdr_filter.apps.maps.marks import Marks
from pdr_filter.apps.walk_map.chains import chain_of, hashed
from pdr_filter.apps.walk_map.drawing import plan_text
from pdr_filter.apps.walk_map.joint import _with_known
from pdr_filter.apps.walk_map.mapped_walk import MappedWalk
from pdr_filter.apps.walk_map.walk_map import _known_pose, in_one_frame
from pdr_filter.simulate import Leg
from pdr_filter.values.recording import Recording

RIGHT = np.pi / 2
STOREYS = 3


def legs_of(number: int) -> list[Leg]:
    """Loops of different lengths, all from the same corner and to the north first."""
    a, b = 26.0 + 3 * (number % 3), 18.0 + 4 * (number % 2)
    sign = 1 if number % 2 else -1
    turns = [Leg("walking", distance_m=d, turn_rad=sign * RIGHT) for d in (b, a, b)]
    return [Leg("stationary", duration_s=1.0), Leg("walking", distance_m=a), *turns]


def walk(number: int, storey: int = 0) -> Recording:
    """A walk of one phone on a storey with its own access points."""
    found = walk_with_wifi(
        legs_of(number), 100 * storey + number, start_m=(4.0 * (number % 3), 0.0), first=1000 * storey
    )
    return replace(found, name=f"phone{number}_storey{storey}")


def known(recording: Recording, floor: int | None = None) -> list[tuple[str, object]]:
    start = recording.truth.waypoints
    place = np.array([start.east_m[0], start.north_m[0]])
    return [
        (recording.name, pdr.PositionFix(1.0, place, 0.3**2 * np.eye(2), floor=floor)),
        (recording.name, pdr.HeadingFix(4.0, 0.0, 0.1)),
    ]


@pytest.fixture(scope="module", autouse=True)
def _chains_once() -> Iterator[None]:
    with chains_made_once():
        yield


@pytest.fixture(scope="module")
def building() -> list[Recording]:
    """Eight phones on three storeys."""
    return [walk(k, k % STOREYS) for k in range(8)]


@pytest.fixture(scope="module")
def mapped(building: list[Recording]) -> pdr.WalkMap:
    fixes = [fix for storey in range(STOREYS) for fix in known(building[storey], storey)]
    return pdr.map_walks(building, fixes)


def variances_of_scans(found: pdr.WalkMap) -> np.ndarray:
    """Sum of the variances of both axes at each scan."""
    steps = [chain.scans.step for chain in found._chains]
    return np.concatenate(
        [np.trace(w.position_cov_m2[s], axis1=1, axis2=2) for w, s in zip(found.walks, steps, strict=True)]
    )


def errors(found: pdr.WalkMap, recordings: list[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 2) at the waypoints of joined walks, and their covariances (n, 2, 2)."""
    by_name = {r.name: r for r in recordings}
    error, cov = [], []
    for joined in found.walks:
        points = by_name[joined.name].truth.waypoints
        for t, e, n in zip(points.time_s, points.east_m, points.north_m, strict=True):
            position_m, cov_m2 = joined.at(float(t))
            error.append(position_m - (e, n))
            cov.append(cov_m2)
    return np.array(error), np.array(cov)


def test_all_walks_of_a_simulated_building_are_joined_on_their_storeys(mapped: pdr.WalkMap) -> None:
    assert mapped.apart == () and mapped.n_groups == 1
    assert [set(w.floor.tolist()) for w in mapped.walks] == [{k % STOREYS} for k in range(8)]


def test_the_covariances_of_a_simulated_building_hold_the_truth(mapped: pdr.WalkMap, building: list[Recording]) -> None:
    error, cov = errors(mapped, building)
    nees = np.einsum("na,nab,nb->n", error, np.linalg.inv(cov + 0.2**2 * np.eye(2)), error)
    assert np.median(np.hypot(*error.T)) < 5.0
    assert 0.1 < nees.mean() / 2 < 1.6 and (nees < 5.99).mean() > 0.85


# --- changes, files and results ---------------------------------------------------------------------------------------


def test_a_removed_walk_can_be_added_again_without_moving_the_others(
    mapped: pdr.WalkMap, building: list[Recording]
) -> None:
    last = building[-1]
    without = mapped.remove([last.name])
    assert last.name not in [w.name for w in without.walks] and len(without.walks) == 7
    again = without.add([last])
    assert len(again.walks) == 8
    for before in without.walks:
        after = next(w for w in again.walks if w.name == before.name)
        np.testing.assert_array_equal(after.position_m, before.position_m)
    with pytest.raises(ValueError, match="nobody"):
        mapped.remove(["nobody"])


def test_a_saved_map_has_no_times_and_no_names_unless_they_are_asked_for(mapped: pdr.WalkMap, tmp_path: Path) -> None:
    loaded = pdr.WalkMap.load(mapped.save(tmp_path / "map"))
    assert [len(w.time_s) for w in loaded.walks] == [0] * 8
    assert not any("phone" in w.name for w in loaded.walks)
    content = b"".join(p.read_bytes() for p in (tmp_path / "map").iterdir())
    assert b"phone0" not in content
    for a, b in zip(loaded.walks, mapped.walks, strict=True):
        np.testing.assert_array_equal(a.position_m, b.position_m)
        np.testing.assert_array_equal(a.position_cov_m2, b.position_cov_m2)
    with pytest.raises(ValueError, match="no times"):
        loaded.walks[0].at(3.0)
    fewer = loaded.remove([loaded.walks[-1].name])
    assert len(fewer.walks) == 7
    np.testing.assert_array_equal(fewer.walks[0].position_m, mapped.walks[0].position_m)  # the frame stays
    fewer.save(tmp_path / "map")
    assert len(list((tmp_path / "map").glob("*.walk"))) == 7  # none of the earlier map is left
    whole = pdr.WalkMap.load(mapped.save(tmp_path / "whole", times=True))
    assert [w.name for w in whole.walks] == [w.name for w in mapped.walks]
    np.testing.assert_array_equal(whole.walks[3].at(9.0)[0], mapped.walks[3].at(9.0)[0])


def test_a_damaged_map_is_refused_with_its_folder(mapped: pdr.WalkMap, tmp_path: Path) -> None:
    folder = mapped.save(tmp_path / "map")
    (folder / "groups.bin").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="not a map of walks"):
        pdr.WalkMap.load(folder)


def test_the_plan_can_be_read_and_contains_the_walks(mapped: pdr.WalkMap, tmp_path: Path) -> None:
    plan = pdr.FloorPlan.read(mapped.write_plan(tmp_path / "plan.geojson"))
    assert [s.floor for s in plan.storeys] == [0, 1, 2]
    for joined in mapped.walks:
        storey = plan.storey(int(joined.floor[0]))
        assert (storey.kind_at(joined.position_m) == 0).mean() > 0.95


def test_the_plan_surrounds_a_path_by_a_corridor_and_twice_its_standard_deviation() -> None:
    path_m = np.column_stack([np.zeros(41), np.linspace(0.0, 20.0, 41)])
    cov_m2 = np.tile(np.diag([9.0, 1.0]), (41, 1, 1))
    straight = MappedWalk("walk", 0, np.arange(40.0), path_m, cov_m2, np.zeros(41, dtype=np.int64))
    area = json.loads(plan_text([straight]))["features"][0]["geometry"]["coordinates"][0]
    east, north = np.array(area).T
    assert (east.min(), east.max()) == pytest.approx((-7.5, 7.5), abs=0.25)
    assert (north.min(), north.max()) == pytest.approx((-7.5, 27.5), abs=0.25)


def test_the_density_counts_every_step_of_a_storey(mapped: pdr.WalkMap) -> None:
    _, steps = mapped.density(floor=1)
    n = sum(int((w.floor == 1).sum()) for w in mapped.walks)
    assert steps.sum() == pytest.approx(n, rel=0.02)
    with pytest.raises(ValueError, match="floors are"):
        mapped.density(floor=7)
    with pytest.raises(ValueError, match="group must be"):
        mapped.density(group=3)


def test_the_radio_map_locates_a_walk_that_had_no_part_in_it(mapped: pdr.WalkMap) -> None:
    other, radio = walk(11, 0), mapped.radio()
    fixes = radio.fixes(other)
    assert radio.position_std_m == pytest.approx(np.sqrt(0.5 * np.mean(variances_of_scans(mapped))))
    away_m = np.array([fix.position_m for fix in fixes]) - true_m(other, [fix.time_s for fix in fixes])
    error_m = np.linalg.norm(away_m, axis=1)
    assert {f.floor for f in fixes} == {0}
    assert np.median(error_m) < 10.0


def test_the_report_has_every_walk_once(mapped: pdr.WalkMap, tmp_path: Path) -> None:
    text = mapped.write_report(tmp_path / "map.html").read_text("utf-8")
    assert text.count('"walk":') == 8
    assert all(text.count(f"</span>{w.name}</td>") == 1 for w in mapped.walks)


# --- bad input --------------------------------------------------------------------------------------------------------


def without_wifi(recording: Recording, name: str) -> Recording:
    return replace(recording, wifi=None, name=name)


def test_bad_walks_stay_apart_with_their_reasons(building: list[Recording]) -> None:
    silent = replace(building[3], wifi=pdr.Wifi([], [], [], []), name="silent")
    standing = replace(pdr.simulate.simulate([Leg("stationary", duration_s=8.0)]), name="standing")
    found = pdr.map_walks([*building[::3], building[0], without_wifi(building[6], "deaf"), silent, standing])
    reasons = dict(found.apart)
    copy = f"{building[0].name} (copy)"
    assert reasons.keys() == {copy, "deaf", "silent", "standing"}
    assert "the same recording as" in reasons[copy]
    assert reasons["deaf"] == reasons["silent"] == "no Wi-Fi scans: record Wi-Fi with the walk"
    assert "no steps" in reasons["standing"]
    assert len(found.walks) == 3


def test_a_single_walk_is_named_and_a_known_one_is_mapped(building: list[Recording]) -> None:
    (alone,) = pdr.map_walks([building[0]]).apart
    assert alone[0] == building[0].name and "recognises no place" in alone[1]
    found = pdr.map_walks([building[0]], known(building[0], 2))
    assert [w.floor[0] for w in found.walks] == [2]


def test_a_known_heading_is_that_of_the_step_that_ends_at_its_time(building: list[Recording]) -> None:
    chain = chain_of(building[0])
    own = chain.position_m(np.array([0]))[0]
    # the walk has right angles, at which one step differs from the next one by up to 90 degrees
    assert np.abs(np.diff(chain.device_rad)).max() > 0.3
    for k, time_s in enumerate(chain.time_s.tolist()):
        node = int(chain.node_of(np.array([k + 1]))[0][0])
        heading_rad = float(chain.device_rad[k] + chain.mean[node, 2]) + 0.5
        pose = _known_pose(chain, [pdr.PositionFix(0.0, own, np.eye(2)), pdr.HeadingFix(time_s, heading_rad, 0.1)])
        assert pose is not None and pose.turn_rad == pytest.approx(0.5, abs=1e-9)
    turn = int(np.argmax(np.abs(np.diff(chain.device_rad)))) + 1
    heading = pdr.HeadingFix(float(chain.time_s[turn - 1]), float(chain.device_rad[turn - 1]) + 0.5, 0.001)
    observed = _with_known(chain, [heading], 0.0).states
    assert (observed.value[-1], observed.std[-1]) == (pytest.approx(0.5), 0.001)


def test_a_map_does_not_depend_on_the_zero_of_time(building: list[Recording]) -> None:
    def later(recording: Recording, by_s: float) -> Recording:
        streams = {
            n: pdr.Samples(s.time_s + by_s, s.values) for n, s in recording.streams.items() if n != "magnetometer"
        }
        wifi = recording.wifi
        return replace(recording, wifi=replace(wifi, time_s=wifi.time_s + by_s), **streams)

    first, second = (
        pdr.map_walks([replace(later(building[k], by_s), magnetometer=None) for k in (0, 3)]) for by_s in (0.0, -20.0)
    )
    for a, b in zip(first.walks, second.walks, strict=True):
        np.testing.assert_allclose(a.position_m, b.position_m, atol=0.3)
        np.testing.assert_allclose(a.position_cov_m2[0], b.position_cov_m2[0], atol=0.1)


def test_two_buildings_are_two_groups(building: list[Recording]) -> None:
    found = pdr.map_walks([building[k] for k in (0, 1, 3, 4)])
    assert found.n_groups == 2 and found.apart == ()
    assert {w.name: w.group for w in found.walks}["phone0_storey0"] == {w.name: w.group for w in found.walks}[
        "phone3_storey0"
    ]


def test_marks_with_different_origins_are_in_the_frame_of_the_first(tmp_path: Path) -> None:
    here, there = pdr.Origin(48.0, 11.0), pdr.Origin(48.001, 11.002)
    cov_m2 = np.eye(2)
    marks = [
        (name, Marks(tmp_path, (pdr.PositionFix(1.0, place, cov_m2), pdr.HeadingFix(4.0, 0.0, 0.1)), walk=walk))
        for name, place, walk in (
            ("a", [5.0, 6.0], {"origin": [48.0, 11.0]}),
            ("b", here.east_north_m(48.0, 11.0) - here.east_north_m(48.001, 11.002), {"origin": [48.001, 11.002]}),
            ("c", [7.0, 8.0], {}),
        )
    ]
    fixes, place = in_one_frame(marks)
    assert (place, [name for name, _ in fixes]) == (here, [*"aabbcc"])
    at_m = [fix.position_m for _, fix in fixes[::2]]
    np.testing.assert_allclose(at_m, [[5.0, 6.0], [0.0, 0.0], [7.0, 8.0]], atol=0.02)
    later, _ = in_one_frame(marks[:1], there)
    np.testing.assert_allclose(
        there.latitude_longitude_deg(later[0][1].position_m),
        here.latitude_longitude_deg(np.array([5.0, 6.0])),
        atol=1e-6,
    )


def test_with_an_origin_the_map_has_true_north(building: list[Recording]) -> None:
    place = pdr.Origin(64.0, -22.0)  # with a declination of about -12 degrees
    turned_rad = []
    for origin in (None, place):
        walks = pdr.map_walks([building[0], building[3]], origin=origin).walks
        east, north = walks[0].position_m[len(walks[0].position_m) // 2] - walks[0].position_m[0]
        turned_rad.append(np.arctan2(east, north))
    assert turned_rad[1] - turned_rad[0] == pytest.approx(place.declination_rad(), abs=np.radians(4.0))


def test_an_access_point_that_was_moved_is_named_and_not_mapped(building: list[Recording]) -> None:
    moved = 0xABCDEF
    near = []
    for k, end in ((0, slice(0, 3)), (1, slice(0, 3))):  # all other access points differ
        wifi = building[k].wifi
        times = np.unique(np.array([s.time_s for s in wifi.scans()]))[end]
        near.append(
            replace(
                building[k],
                wifi=pdr.Wifi(
                    np.concatenate([wifi.time_s, times]),
                    np.concatenate([wifi.bssid, np.full(len(times), moved)]),
                    np.concatenate([wifi.rssi_dbm, np.full(len(times), -40.0)]),
                    np.concatenate([wifi.frequency_mhz, np.full(len(times), 2412.0)]),
                ),
            )
        )
    fixes = [*known(near[0]), (near[1].name, pdr.PositionFix(1.0, (150.0, 0.0), np.eye(2)))]
    found = pdr.map_walks(near, fixes)
    assert moved in found.moved_access_points
    assert moved not in found.radio().bssid


def test_two_places_of_a_walk_in_one_second_are_both_named_and_not_used(building: list[Recording]) -> None:
    name = building[0].name
    fixes = [(name, pdr.PositionFix(2.0, (east, 0.0), np.eye(2))) for east in (0.0, 300.0)]
    found = pdr.map_walks([building[0], building[3]], fixes)
    assert len(found.notes) == 2 and all(f"position of {name} at 2.0 s" in note for note in found.notes)
    np.testing.assert_array_equal(
        found.walks[0].position_m, pdr.map_walks([building[0], building[3]]).walks[0].position_m
    )


def moved(fixes: list[tuple[str, object]], east_m: float) -> list[tuple[str, object]]:
    """Known positions moved to the east, and known headings."""
    return [
        (name, replace(f, position_m=np.add(f.position_m, (east_m, 0.0))) if isinstance(f, pdr.PositionFix) else f)
        for name, f in fixes
    ]


def test_a_walk_whose_known_positions_the_scans_contradict_is_named_and_placed_by_them(
    building: list[Recording], tmp_path: Path
) -> None:
    walks = building[::3]
    fixes = [fix for k, w in enumerate(walks) for fix in moved(known(w, 0), 40.0 * (k == 1))]
    found = pdr.map_walks(walks, fixes)
    (note,) = found.notes
    assert f"positions of {walks[1].name} are not used" in note
    error, cov = errors(found, walks)
    nees = np.einsum("na,nab,nb->n", error, np.linalg.inv(cov + 0.2**2 * np.eye(2)), error)
    assert len(found.walks) == 3 and np.hypot(*error.T).max() < 12.0 and (nees < 9.2).mean() > 0.85
    assert pdr.map_walks(walks, [fix for w in walks for fix in known(w, 0)]).notes == ()
    assert note in found.write_report(tmp_path / "map.html").read_text("utf-8")
    assert pdr.WalkMap.load(found.save(tmp_path / "times", times=True)).notes == found.notes
    assert pdr.WalkMap.load(found.save(tmp_path / "map")).notes == ()  # notes have names


def test_of_two_known_walks_that_the_scans_contradict_neither_is_used(building: list[Recording]) -> None:
    walks = [building[0], building[3]]
    found = pdr.map_walks(walks, [*known(walks[0], 0), *moved(known(walks[1], 0), 40.0)])
    assert [any(f"of {w.name} are not used" in note for note in found.notes) for w in walks] == [True, True]


def test_a_storey_on_which_no_walk_joins_the_known_one_is_named(building: list[Recording]) -> None:
    found = pdr.map_walks([building[k] for k in (0, 3, 2)], [*known(building[0], 4), *known(building[2], 7)])
    assert [note.split(":")[0] for note in found.notes] == []  # no walk is left
    found = pdr.map_walks([building[k] for k in (0, 3, 2, 1, 4)], [*known(building[0], 4), *known(building[2], 7)])
    assert [note.split(":")[0] for note in found.notes] == ["storey 7 has no map"]


# --- privacy and files ------------------------------------------------------------------------------------------------


def test_hashed_addresses_hide_the_access_points_and_keep_the_fingerprints(building: list[Recording]) -> None:
    wifi = building[0].wifi
    other = hashed(wifi, "secret")
    assert not set(other.bssid) & set(wifi.bssid)
    assert other.n_access_points == wifi.n_access_points
    assert set(hashed(wifi, "another").bssid) != set(other.bssid)
    plain, hidden = chain_of(building[0]), chain_of(building[0], salt="secret")
    assert len(plain.scans.rssi_dbm) == len(hidden.scans.rssi_dbm)
    assert not set(plain.scans.bssid) & set(hidden.scans.bssid)


def test_a_second_run_takes_the_walks_from_the_cache(
    building: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [building[k].save(tmp_path / f"walk{k}.zip") for k in (0, 3)]
    first = pdr.map_walks(paths, cache=tmp_path / "cache")
    monkeypatch.setattr("pdr_filter.apps.walk_map.chains.chain_of", None)  # a call would fail
    second = pdr.map_walks(paths, cache=tmp_path / "cache")
    assert len(second.walks) == 2
    for a, b in zip(first.walks, second.walks, strict=True):
        np.testing.assert_array_equal(a.position_m, b.position_m)
    (file,) = [f for f in (tmp_path / "cache").iterdir()][:1]
    file.write_bytes(b"damaged")
    assert len(pdr.map_walks(paths, cache=tmp_path / "cache").apart) == 2  # computed again, which fails here
