"""Maps of walks through a simulated building, with known truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heard import round_a_block, walk_with_wifi

import pdr_filter as pdr
from pdr_filter.simulate import Leg
from pdr_filter.values.recording import Recording
from pdr_filter.walk_map.chains import chain_of, hashed

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
    found = walk_with_wifi(legs_of(number), 100 * storey + number, start_m=(4.0 * (number % 3), 0.0), first=1000 * storey)
    return replace(found, name=f"phone{number}_storey{storey}")


def known(recording: Recording, floor: int | None = None) -> list[tuple[str, object]]:
    start = recording.truth.waypoints
    place = np.array([start.east_m[0], start.north_m[0]])
    return [
        (recording.name, pdr.PositionFix(1.0, place, 0.3**2 * np.eye(2), floor=floor)),
        (recording.name, pdr.HeadingFix(4.0, 0.0, 0.1)),
    ]


@pytest.fixture(scope="module")
def building() -> list[Recording]:
    """Eight phones on three storeys."""
    return [walk(k, k % STOREYS) for k in range(8)]


@pytest.fixture(scope="module")
def mapped(building: list[Recording]) -> pdr.WalkMap:
    fixes = [fix for storey in range(STOREYS) for fix in known(building[storey], storey)]
    return pdr.map_walks(building, fixes)


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


def test_the_covariances_of_a_simulated_building_hold_the_truth(
    mapped: pdr.WalkMap, building: list[Recording]
) -> None:
    error, cov = errors(mapped, building)
    nees = np.einsum("na,nab,nb->n", error, np.linalg.inv(cov + 0.2**2 * np.eye(2)), error)
    assert np.median(np.hypot(*error.T)) < 5.0
    assert 0.1 < nees.mean() / 2 < 1.6 and (nees < 5.99).mean() > 0.85
