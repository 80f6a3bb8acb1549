"""Fixes with invalid numbers are refused when they are created, with the name of the field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.values import HeadingFix, PositionFix, SpeedFix, Standstill

FIXES: dict[str, Callable[[Any], object]] = {
    "time_s of PositionFix": lambda v: PositionFix(v, (0.0, 0.0), np.eye(2)),
    "position_m of PositionFix": lambda v: PositionFix(0.0, [0.0, v], np.eye(2)),
    "cov_m2 of PositionFix": lambda v: PositionFix(0.0, (0.0, 0.0), [[v, 0.0], [0.0, 1.0]]),
    "walking_heading_rad of HeadingFix": lambda v: HeadingFix(0.0, v, 0.1),
    "std_rad of HeadingFix": lambda v: HeadingFix(0.0, 0.0, v),
    "speed_mps of SpeedFix": lambda v: SpeedFix(0.0, v, 0.1),
    "end_s of Standstill": lambda v: Standstill(0.0, v),
}


@pytest.mark.parametrize("name", FIXES)
@pytest.mark.parametrize(
    "value", ["x", 1 + 2j, 10**400, {}, object()], ids=["text", "complex", "huge", "dict", "object"]
)
def test_a_field_that_is_not_a_number_is_refused_with_its_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name.split()[0]):
        FIXES[name](value)


@pytest.mark.parametrize("name", [n for n in FIXES if "PositionFix" not in n or "time_s" in n])
def test_a_missing_number_is_refused_with_its_name(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        FIXES[name](None)


def test_numbers_of_any_kind_become_floats() -> None:
    fix = SpeedFix(3, np.float32(1.5), np.array(0.25))  # type: ignore[arg-type]
    assert (fix.time_s, fix.speed_mps, fix.std_mps) == (3.0, 1.5, 0.25)
    assert all(type(value) is float for value in (fix.time_s, fix.speed_mps, fix.std_mps))


def test_a_subclass_of_a_fix_may_have_fields_of_any_kind() -> None:
    @dataclass(frozen=True)
    class Beacon(PositionFix):
        source: str = "uwb"

    fix = Beacon(1, [1, 2], np.eye(2), source="door")
    assert (fix.time_s, fix.source, fix.position_m.tolist()) == (1.0, "door", [1.0, 2.0])


def test_extreme_positions_and_variances_give_finite_tracks() -> None:
    walk = pdr.simulate.demo_walk()
    places = [((1e9, -1e9), 1e24), ((-1e9, 1e9), 1e-24)]
    fixes = [PositionFix(20.0 + 20.0 * k, at, var * np.eye(2)) for k, (at, var) in enumerate(places)]
    with np.errstate(all="raise", under="ignore"):
        track = pdr.track(walk, pdr.recipes.default().in_world_frame(), fixes=fixes)
    assert np.isfinite(track.position_m).all()
    assert np.isfinite(track.position_cov_m2).all()
