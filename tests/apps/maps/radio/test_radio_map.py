"""Radio maps: positions of walks that are not in the map, and the validity of their covariances."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from heard import heard_along, round_a_block, walk_with_wifi
from scipy.sparse import csr_matrix
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern, WhiteKernel
from true_positions import true_m

import pdr_filter as pdr
from pdr_filter.apps.maps.radio.radio_map import RadioMap
from pdr_filter.apps.maps.radio.signal_field import LENGTH_M, NOISE, Field
from pdr_filter.simulate import Leg
from pdr_filter.values import PositionFix, Wifi
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="module")
def radio() -> RadioMap:
    """Radio map of two walks around the block."""
    return RadioMap.fit([walk_with_wifi(round_a_block(), seed) for seed in (1, 2)])


@pytest.fixture(scope="module")
def walk() -> Recording:
    return walk_with_wifi(round_a_block(), 3)


def errors_m(fixes: list[PositionFix], walk: Recording) -> np.ndarray:
    return true_m(walk, [fix.time_s for fix in fixes]) - np.array([fix.position_m for fix in fixes])


def test_fixes_of_another_walk_agree_with_the_truth_within_their_covariance(radio: RadioMap, walk: Recording) -> None:
    fixes = radio.fixes(walk)
    assert len(fixes) > 8
    error = errors_m(fixes, walk)
    assert np.median(np.hypot(*error.T)) < 4.0
    nees = [e @ np.linalg.solve(f.cov_m2, e) for e, f in zip(error, fixes, strict=True)]
    assert np.mean(np.array(nees) < 5.99) > 0.85


def test_a_scan_in_an_unmapped_area_gives_no_fix(radio: RadioMap, walk: Recording) -> None:
    mapped, far = (heard_along(np.array([1.0]), np.array([place]), 4) for place in ([20.0, 10.0], [45.0, -20.0]))
    assert np.isin(far.bssid, radio.bssid).sum() > 20
    assert len(radio.fixes(replace(walk, wifi=mapped))) == 1
    assert radio.fixes(replace(walk, wifi=far)) == []


def test_the_reception_time_of_a_fix_is_the_end_of_its_scan(radio: RadioMap, walk: Recording) -> None:
    ends = {scan.time_s: scan.end_s for scan in walk.wifi.scans()}
    for fix in radio.fixes(walk):
        assert fix.received_time_s == ends[fix.time_s] > fix.time_s


def test_fixes_have_a_correlation_time_and_are_at_least_half_of_it_apart(radio: RadioMap, walk: Recording) -> None:
    fixes = radio.fixes(walk)
    for before, fix in pairwise(fixes):
        assert fix.correlation_s == pytest.approx(2.4 * np.sqrt(fix.var_m2))
        assert fix.time_s - before.time_s >= 0.5 * fix.correlation_s


def test_every_scan_gives_a_grid_whose_mean_is_the_position_of_its_fix(radio: RadioMap, walk: Recording) -> None:
    fixes, grids = radio.fixes(walk), radio.grids(walk)
    assert walk.wifi is not None and len(grids) == len(walk.wifi.scans())  # none is left out here
    of_time = {grid.time_s: grid for grid in grids}
    for fix in fixes:
        grid = of_time[fix.time_s]
        prob = np.exp(grid.log_likelihood)
        assert prob.sum() == pytest.approx(1.0, abs=0.01) and grid.received_time_s == fix.received_time_s
        rows, columns = prob.shape
        middle_m = [
            grid.south_west_m + grid.cell_m * np.array([c + 0.5, r + 0.5]) for r in range(rows) for c in range(columns)
        ]
        np.testing.assert_allclose(prob.ravel() @ middle_m / prob.sum(), fix.position_m, atol=1.0)
    here = [float(grid.log_likelihood_at(true_m(walk, [grid.time_s]))[0]) for grid in grids]
    even = [-np.log(g.log_likelihood.size) for g in grids]
    assert np.mean(np.array(here) - even) > 1.0


def test_a_scan_of_unmapped_access_points_gives_no_fix(radio: RadioMap, walk: Recording) -> None:
    strange = replace(walk.wifi, bssid=walk.wifi.bssid + 10**6)
    assert radio.fixes(replace(walk, wifi=strange)) == []


def test_the_field_is_the_gaussian_process_of_scikit_learn() -> None:
    rng = np.random.default_rng(0)
    place_m, heard = rng.uniform(0, 30, (25, 2)), rng.uniform(size=(25, 4))
    ours = Field.of(place_m, csr_matrix(heard))
    kernel = Matern(LENGTH_M, nu=0.5) + WhiteKernel(NOISE)
    mean, std = GaussianProcessRegressor(kernel, optimizer=None).fit(place_m, heard).predict(ours.cell_m, True)
    np.testing.assert_allclose(ours.weight.T @ heard, mean, atol=1e-8)
    np.testing.assert_allclose(ours.norm2, (mean**2).sum(axis=1), atol=1e-8)
    np.testing.assert_allclose(ours.variance, std[:, 0] ** 2, atol=1e-8)


def test_the_storey_of_a_scan_is_recognised_by_its_access_points(walk: Recording) -> None:
    below, above = walk_with_wifi(round_a_block(), 1), walk_with_wifi(round_a_block(), 2, first=1000)
    points = above.truth.waypoints.copy()
    points["floor"] = 2
    above = replace(above, truth=replace(above.truth, waypoints=points))
    both = RadioMap.fit([below, above])
    assert {f.floor for f in both.fixes(walk)} == {0}
    assert {f.floor for f in both.fixes(walk_with_wifi(round_a_block(), 5, first=1000))} == {2}


def test_a_map_fitted_to_tracks_is_in_their_frame(walk: Recording) -> None:
    others = [walk_with_wifi(round_a_block(), seed) for seed in (1, 2)]
    tracks = [pdr.track(other) for other in others]
    moved = [replace(t, position_m=t.position_m + 100.0, start_position_m=t.start_position_m + 100.0) for t in tracks]
    here, there = (RadioMap.fit(zip(others, known, strict=True)) for known in (tracks, moved))
    for a, b in zip(here.fixes(walk), there.fixes(walk), strict=True):
        np.testing.assert_allclose(b.position_m, a.position_m + 100.0, atol=1e-6)
    assert np.median(np.hypot(*errors_m(here.fixes(walk), walk).T)) < 5.0


def test_the_map_reduces_the_end_error_of_a_long_walk_with_a_wrong_scale(radio: RadioMap) -> None:
    long = walk_with_wifi([*round_a_block(), *round_a_block()[1:], *round_a_block()[1:]], 6)
    tall = long.of_height(2.4)  # steps are taken for too long
    plain, fixed = pdr.track(tall), pdr.track(tall, fixes=radio.fixes(tall))
    far_m = [np.hypot(*(t.position_m[-1] - true_m(long, long.duration_s))) for t in (plain, fixed)]
    assert far_m[1] < 0.7 * far_m[0]
    assert all(f.accepted for f in fixed.fixes[-5:])


# --- files -----------------------------------------------------------------------------------------------------------


def test_uncertain_positions_of_the_map_make_its_fixes_and_grids_less_certain(radio: RadioMap, walk: Recording) -> None:
    uncertain = replace(radio, position_std_m=6.0)
    before = {fix.time_s: fix for fix in radio.fixes(walk)}
    fixes = uncertain.fixes(walk)
    shared = [(before[fix.time_s], fix) for fix in fixes if fix.time_s in before]
    assert len(shared) >= 2
    for known, fix in shared:
        np.testing.assert_array_equal(fix.position_m, known.position_m)
        np.testing.assert_allclose(fix.cov_m2, known.cov_m2 + 36.0 * np.eye(2))
        assert fix.correlation_s == pytest.approx(2.4 * np.sqrt(fix.var_m2))
    peaks = [np.array([g.log_likelihood.max() for g in of.grids(walk)]) for of in (radio, uncertain)]
    assert np.all(peaks[1] < peaks[0] - 0.7)
    for grid in uncertain.grids(walk):
        assert grid.correlation_s == pytest.approx(6.0 + 2.4 * 6.0)


def test_a_saved_and_loaded_map_gives_the_same_fixes(radio: RadioMap, walk: Recording, tmp_path: Path) -> None:
    radio = replace(radio, position_std_m=2.0)
    loaded = RadioMap.load(radio.save(tmp_path / "mall"))
    assert repr(loaded) == repr(radio)
    for a, b in zip(radio.fixes(walk), loaded.fixes(walk), strict=True):
        np.testing.assert_array_equal(a.position_m, b.position_m)
        np.testing.assert_array_equal(a.cov_m2, b.cov_m2)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("point", lambda a: a + 10**6, "point must be whole numbers"),
        ("access_point", lambda a: -a - 1, "access_point must be whole numbers"),
        ("bssid", lambda a: a[::-1], "bssid must increase"),
        ("rssi_dbm", lambda a: a * np.nan, "finite"),
        ("rssi_dbm", lambda a: a[1:], "must have the same length"),
        ("position_m", lambda a: a * 1e9, "position_m must be metres"),
        ("floor", lambda a: a[1:], "position_m must be"),
        ("floor", lambda a: a + 0.5, "floor must be whole numbers"),
    ],
)
def test_a_map_whose_arrays_do_not_fit_is_refused(
    radio: RadioMap, tmp_path: Path, name: str, change: object, words: str
) -> None:
    from pdr_filter.apps.maps.radio.radio_map import _ARRAYS, FORMAT

    arrays = {n: np.asarray(getattr(radio, n)) for n in _ARRAYS}
    arrays[name] = change(arrays[name])  # type: ignore[operator]
    FORMAT.write(tmp_path / "bad", {"card": {}}, arrays)
    with pytest.raises(ValueError, match=words) as refusal:
        RadioMap.load(tmp_path / "bad.json")
    assert "fit it again" in str(refusal.value)


def test_a_file_without_the_uncertainty_of_its_positions_has_certain_ones(radio: RadioMap, tmp_path: Path) -> None:
    path = replace(radio, position_std_m=2.0).save(tmp_path / "mall")
    path.write_text(json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != "position_std_m"}))
    assert RadioMap.load(path).position_std_m == 0.0


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(json.dumps({"kind": "calibration", "format_version": 1}))
    with pytest.raises(ValueError, match="its kind is 'calibration', not 'radio_map'"):
        RadioMap.load(tmp_path / "other.json")


def test_a_single_leg_is_sufficient_for_a_map() -> None:
    one = RadioMap.fit([walk_with_wifi([Leg("walking", distance_m=25.0)], 1)])
    assert one.fixes(walk_with_wifi([Leg("walking", distance_m=25.0)], 2))
    assert isinstance(one.bssid, np.ndarray)
    assert Wifi is pdr.Wifi
