"""Distances and uncertainties of online and smoothed tracks that are possible, without the truth."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from true_positions import position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.filter.imm.motion_model import stepless_var_m2
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values.uncertainty import worst_std_m

pytestmark = pytest.mark.usefixtures("sensing_once")

WALK = simulate([Leg("walking", distance_m=25.0, turn_rad=1.2), Leg("walking", distance_m=20.0, turn_rad=-1.0)], seed=3)
# The shortest recording of each of these data sets, with and without its gyroscope.
FOLDERS = (
    *("difronzo", "humolire", "ipin2023", "motionsense", "ms_indoor"),
    *("oxford", "oxiod", "pyshoe", "tyrex", "ubicomp13"),
)


def without_gyroscope(walk: pdr.Recording, begin_s: float, end_s: float) -> pdr.Recording:
    gyroscope = walk.gyroscope
    has = (gyroscope.time_s < begin_s) | (gyroscope.time_s > end_s)
    samples = pdr.Samples(gyroscope.time_s[has], gyroscope.values[has]) if has.any() else None
    return replace(walk, gyroscope=samples)


LESS = {"all": (0.0, np.inf), "middle": (12.0, 26.0), "end": (15.0, np.inf), "none": (1e9, 1e9)}


def path_of(walk: pdr.Recording, config: pdr.Config) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard deviation of each step of the walked path, and the way along it until the step."""
    online, samples = pdr.OnlineFilter(config), pdr.merge_streams(walk)
    online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps)
    path = online.path()
    way_m = np.cumsum(np.hypot(*np.diff(path.position_m, axis=0, prepend=np.zeros((1, 2))).T))
    return path.position_std_m[: path.n_steps], way_m[: path.n_steps]


def unstepped_m(track: pdr.Track) -> np.ndarray:
    """Return the sum (K,) of the standard deviations that motion without steps adds until each step."""
    return np.sqrt(stepless_var_m2(np.asarray(track.steps.stepless_s))).cumsum()


def check_possible(online: pdr.Track, smoothed: pdr.Track) -> None:
    assert smoothed.distance_m == pytest.approx(online.distance_m, rel=0.02)
    for track in (online, smoothed):
        assert (worst_std_m(track.position_cov_m2) <= track.walked_m + unstepped_m(track) + 0.01).all()
    scatter = [np.std(np.diff(track.step_length_m)) for track in (smoothed, online)]
    assert scatter[0] < 1.1 * scatter[1] + 0.01
    moved_m = np.hypot(*np.diff(smoothed.position_m, axis=0).T)
    assert moved_m.sum() == pytest.approx(smoothed.step_length_m[1:].sum(), rel=0.05)


@pytest.mark.parametrize(("missing", "weighting"), [*((m, "imm") for m in LESS), ("middle", "wc"), ("none", "hc")])
def test_without_fixes_smoothing_keeps_the_distance_and_no_position_is_less_certain_than_the_way(
    missing: str, weighting: str
) -> None:
    walk = without_gyroscope(WALK, *LESS[missing])
    check_possible(pdr.track(walk, weighting=weighting), pdr.smooth(walk, weighting=weighting).track)
    std_m, way_m = path_of(walk, pdr.recipes.default(walk.subject).with_weighting(weighting))
    assert (std_m <= way_m + 0.01).all()


@pytest.mark.parametrize("missing", ["all", "middle"])
def test_with_fixes_no_position_is_less_certain_than_the_way_from_the_last_fix(missing: str) -> None:
    walk = without_gyroscope(WALK, *LESS[missing])
    time_s = np.arange(4.0, float(WALK.truth.position.time_s[-1]), 12.0)
    fixes = position_fixes(time_s, true_m(WALK, time_s), 1.0)
    result, online = pdr.smooth(walk, fixes=fixes), pdr.track(walk, fixes=fixes)
    assert len(result.rejected) == 0 and not [note for note in result.notes if "did not converge" in note]
    assert result.track.distance_m == pytest.approx(online.distance_m, rel=0.05)
    for track in (result.track, online):
        last = np.searchsorted(time_s, track.time_s, side="right") - 1
        walked_m = track.walked_m - np.interp(time_s[np.maximum(last, 0)], track.time_s, track.walked_m)
        # online, a fix is used after the steps that were detected before it arrived
        is_after = (last >= 0) & (track.time_s - time_s[np.maximum(last, 0)] > 2.0)
        assert (worst_std_m(track.position_cov_m2)[is_after] <= (walked_m + unstepped_m(track))[is_after] + 2.0).all()


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("is_blind", [False, True])
def test_recordings_of_all_kinds_are_smoothed_to_possible_walks(data_dir: Path, folder: str, is_blind: bool) -> None:
    walk = pdr.read(min((data_dir / folder).glob("*.zip"), key=lambda path: path.stat().st_size))
    if is_blind:
        walk = replace(walk, gyroscope=None, magnetometer=None)
    online, smoothed = pdr.track(walk, gnss="off"), pdr.smooth(walk, gnss="off").track
    for track in (online, smoothed):
        if track.n_steps:
            assert np.isfinite(track.position_m).all()
            assert (
                worst_std_m(track.position_cov_m2)
                <= track.walked_m + track.gap_before_s.cumsum() + unstepped_m(track) + 0.01
            ).all()
            # the first step begins at the origin, so that handling of the phone before it does not count
            assert worst_std_m(track.position_cov_m2[:1])[0] <= track.walked_m[0] + 0.01
    assert smoothed.distance_m == pytest.approx(online.distance_m, rel=0.05)


@pytest.mark.parametrize("missing", ["all", "middle"])
def test_the_present_position_is_not_less_certain_than_the_way_since_the_last_used_fix(missing: str) -> None:
    walk = without_gyroscope(WALK, *LESS[missing])
    samples, online = pdr.merge_streams(walk), pdr.OnlineFilter(pdr.recipes.default(walk.subject))
    used, distance_m = list[float](), 0.0
    parts = np.searchsorted(samples.time_s, np.arange(0.0, walk.duration_s, 0.5)).tolist()
    for first, end in itertools.pairwise(parts):
        time_s, rate_radps = float(samples.time_s[first]), samples.angular_rate_radps
        if int(time_s * 2) % 24 == 8:
            online.add_fix(pdr.PositionFix(time_s, true_m(WALK, time_s), np.eye(2)))
        online.push(samples.time_s[first:end], samples.specific_force_mps2[first:end], rate_radps[first:end])
        now = online.now()
        if len(used) < sum(fix.accepted for fix in now.fixes):
            used, distance_m = [fix.time_s for fix in now.fixes if fix.accepted], now.distance_m
        # steps that are not known yet, and the standard deviation of the fix with the steps until its use
        ahead_m = len(now.provisional_steps) + 3.0 + 3.0 * bool(used)
        assert now.position_std_m <= now.distance_m - distance_m + ahead_m
    assert len(used) == 3
