"""Wi-Fi of simulated walks: access points on a square grid, power that falls with the logarithm of the distance."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from pdr_filter.apps.walk_map.chains import Chain, chain_of, content_of
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray, Wifi
from pdr_filter.values.recording import Recording

SPACING_M = 8.0
SCAN_S = 2.2


def access_points_m() -> FloatArray:
    axis = np.arange(-24.0, 49.0, SPACING_M)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def heard_along(time_s: FloatArray, place_m: FloatArray, seed: int, first: int = 0, std_db: float = 4.0) -> Wifi:
    """Scans at times (S,) and places (S, 2); addresses count from `first`."""
    rng, points_m = np.random.default_rng(seed), access_points_m()
    far_m = np.linalg.norm(place_m[:, None] - points_m, axis=-1)
    power = -35.0 - 30.0 * np.log10(np.maximum(far_m, 1.0)) + rng.normal(scale=std_db, size=far_m.shape)
    scan, point = np.nonzero(power > -92.0)
    within_s = rng.uniform(0.0, 1.2, len(scan))
    mhz = np.where(point % 2, 5180.0, 2412.0)
    return Wifi(time_s[scan] + within_s, point + first, np.round(power[scan, point]), mhz)


def walk_with_wifi(legs: list[Leg], seed: int, start_m: tuple[float, float] = (0.0, 0.0), first: int = 0) -> Recording:
    """A simulated walk that hears; the truth starts at `start_m`."""
    return hearing(
        simulate(legs, seed=seed, name=f"walk{seed}"), start_m, lambda *scans: heard_along(*scans, seed, first)
    )


def hearing(walk: Recording, start_m: ArrayLike, heard: Callable[[FloatArray, FloatArray], Wifi]) -> Recording:
    """Return the walk with Wi-Fi, and with its truth moved so that it starts at `start_m`.

    `heard` gives the receptions for the times (S,) and the places (S, 2) of the scans.
    """
    truth, points = walk.truth.position.copy(), walk.truth.waypoints.copy()
    for table in (truth, points):
        for name, start in zip(("east_m", "north_m"), np.asarray(start_m), strict=True):
            table[name] += start
    time_s = np.arange(0.2, walk.duration_s - 1.5, SCAN_S)
    place_m = np.column_stack([np.interp(time_s + 0.6, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    return replace(walk, wifi=heard(time_s, place_m), truth=replace(walk.truth, position=truth, waypoints=points))


@contextmanager
def chains_made_once() -> Iterator[None]:
    """Make the chain of equal walks once: it takes most of the time of a map of few walks."""
    made: dict[tuple[str, str, str | None], Chain] = {}

    def once(recording: Recording, key: str = "", salt: str | None = None) -> Chain:
        walk = content_of(recording), recording.name, salt
        if walk not in made:
            made[walk] = chain_of(recording, key, salt)
        return replace(made[walk], key=key)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pdr_filter.apps.walk_map.chains.chain_of", once)
        yield


def round_a_block(turns: int = 3) -> list[Leg]:
    right = np.pi / 2
    return [Leg("walking", distance_m=20.0), *[Leg("walking", distance_m=20.0, turn_rad=right)] * turns]
