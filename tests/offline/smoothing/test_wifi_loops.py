"""Loop closures from Wi-Fi."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heard import round_a_block, walk_with_wifi
from true_positions import true_m

import pdr_filter as pdr
from pdr_filter.offline.smoothing.wifi_loops import STD_M, fingerprint_cosines, wifi_loop_closures
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Walk twice around the block."""
    return walk_with_wifi(round_a_block(turns=7), 1)


def test_wifi_closures_are_at_revisited_positions(walk: Recording) -> None:
    found = wifi_loop_closures(walk)
    assert len(found) >= 3
    apart_m = true_m(walk, [c.first_s for c in found]) - true_m(walk, [c.second_s for c in found])
    assert np.sqrt(np.mean(apart_m**2)) < STD_M
    assert all(c.second_s - c.first_s > 30 for c in found)


def test_two_visits_of_a_position_give_one_closure(walk: Recording) -> None:
    times = np.array([(c.first_s, c.second_s) for c in wifi_loop_closures(walk)])
    between = np.abs(times[:, None] - times).max(axis=-1)
    assert between[~np.eye(len(times), dtype=bool)].min() >= 12.0


def test_walks_without_a_revisited_position_have_no_closures(walk: Recording) -> None:
    assert wifi_loop_closures(walk_with_wifi(round_a_block(turns=1), 2)) == []
    moved = replace(walk.wifi, bssid=walk.wifi.bssid + 1000 * (walk.wifi.time_s // 25.0).astype(int))
    assert wifi_loop_closures(replace(walk, wifi=moved)) == []


def test_a_fingerprint_cosine_is_one_with_itself_and_zero_without_a_common_access_point(walk: Recording) -> None:
    scans = walk.wifi.scans()[:3]
    other = replace(scans[0], bssid=scans[0].bssid + 1000)
    likeness = fingerprint_cosines([*scans, other])
    np.testing.assert_allclose(np.diag(likeness), 1.0)
    assert likeness[0, 3] == 0


def test_smooth_finds_wifi_closures_by_name(walk: Recording) -> None:
    by_name = pdr.smooth(walk, loop_closures="wifi")
    given = pdr.smooth(walk, loop_closures=wifi_loop_closures(walk))
    np.testing.assert_array_equal(by_name.track.position_m, given.track.position_m)
    assert (by_name.observations.kind == "loop closure").all()
    assert len(by_name.rejected) == 0
