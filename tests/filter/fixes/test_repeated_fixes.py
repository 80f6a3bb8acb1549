"""Fixes that are delivered again contain no new information, whatever their kind."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers import push_part, resumed, true_position_m

import pdr_filter as pdr
from pdr_filter.filter.pedestrian.repeated_fixes import FixMemory, repetitions
from pdr_filter.values import FloatArray, GridFix, HeadingFix, PositionFix, RangeFix, SpeedFix, Standstill

PLACE = np.zeros(3)


@dataclass
class Line:
    """The pedestrian is on a line in the north."""

    time_s: float
    north_m: float
    received_time_s: float | None = None

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        return np.array([position_m[1] - self.north_m]), np.array([[0.0, 1.0]]), np.array([[0.04]])


ONE_OF_EACH_KIND = [
    PositionFix(10.0, np.array([1.0, 8.0]), np.eye(2)),
    HeadingFix(10.0, 0.05, 0.1),
    SpeedFix(10.0, 1.3, 0.1),
    RangeFix(10.0, np.array([20.0, 5.0]), 19.5, 0.3),
    GridFix(10.0, np.zeros(2), 1.0, np.zeros((3, 3))),
    Line(10.0, 8.0),
]
KINDS = [type(fix).__name__ for fix in ONE_OF_EACH_KIND]


def at(fix: Any, time_s: float) -> Any:
    return replace(fix, time_s=time_s)


@pytest.mark.parametrize("fix", ONE_OF_EACH_KIND, ids=KINDS)
@pytest.mark.parametrize("later_s", [0.0, 0.3, 4.9, -0.3])
def test_equal_values_within_five_seconds_are_a_repetition(fix: Any, later_s: float) -> None:
    memory, first = FixMemory().plus(fix, PLACE, 10.0)
    unchanged, second = memory.plus(at(fix, fix.time_s + later_s), PLACE + 0.1, 10.4)
    assert (first, second) == ("", "repeated")
    assert unchanged.recent is memory.recent


@pytest.mark.parametrize("fix", ONE_OF_EACH_KIND[1:], ids=KINDS[1:])
def test_equal_values_after_five_seconds_are_measured_again(fix: Any) -> None:
    memory, _ = FixMemory().plus(fix, PLACE, 0.0)
    assert memory.plus(at(fix, fix.time_s + 5.0), PLACE, 7.0)[1] == ""


def test_sources_that_alternate_do_not_hide_a_repetition() -> None:
    a, b = ONE_OF_EACH_KIND[0], PositionFix(10.1, np.array([2.0, 9.0]), np.eye(2))
    fixes = [at(fix, 10.0 + 0.1 * k) for k, fix in enumerate([a, b] * 5)]
    nothing = np.empty(0)
    assert repetitions(fixes, nothing, np.empty((0, 2)), nothing) == ["", ""] + 8 * ["repeated"]


def test_a_standstill_is_never_a_repetition() -> None:
    memory, _ = FixMemory().plus(Standstill(1.0, 2.0), PLACE, 0.0)
    assert memory.plus(Standstill(1.0, 2.0), PLACE, 0.0)[1] == ""


@pytest.mark.parametrize(
    ("moved_m", "walked_m", "expected"),
    [
        (0.0, 0.0, "repeated"),  # a minute at one place
        (1.5, 1.5, "repeated"),  # the same fix while the person goes on
        (8.0, 8.0, "frozen"),
        (1.0, 12.0, ""),  # a return to a surveyed point
        (0.5, 3.0, "repeated"),  # too short to leave the place and return
    ],
)
def test_an_equal_position_is_new_only_if_the_person_can_have_returned(
    moved_m: float, walked_m: float, expected: str
) -> None:
    fix = ONE_OF_EACH_KIND[0]
    memory, _ = FixMemory().plus(fix, PLACE, 0.0)
    assert memory.plus(at(fix, 70.0), np.array([moved_m, 0.0, 0.0]), walked_m)[1] == expected


def fixes_of(walk: pdr.Recording, rng: np.random.Generator) -> list[Any]:
    times = np.arange(5.0, walk.duration_s - 2.0, 6.0)
    places = true_position_m(walk, times)
    fixes: list[Any] = []
    for t, place in zip(times.tolist(), places, strict=True):
        anchor = np.array([30.0, 5.0])
        fixes += [
            PositionFix(t, place + rng.normal(size=2), np.eye(2)),
            SpeedFix(t + 1.0, 1.3 + 0.05 * rng.normal(), 0.2),
            RangeFix(t + 2.0, anchor, float(np.linalg.norm(place - anchor) + 2.0 * rng.normal()), 3.0),
            Line(t + 3.0, float(place[1] + rng.normal()), None),
        ]
    return [*fixes, HeadingFix(8.0, 0.02, 0.1)]


@pytest.mark.parametrize("later_s", [0.0, 0.2])
def test_a_track_with_repeated_fixes_has_the_bits_of_one_without_and_a_note(later_s: float) -> None:
    walk = pdr.simulate.demo_walk()
    fixes = fixes_of(walk, np.random.default_rng(1))
    again = [at(fix, fix.time_s + later_s * k) for fix in fixes for k in range(3)]
    once, often = pdr.track(walk, fixes=fixes), pdr.track(walk, fixes=again)
    assert often.position_m.tobytes() == once.position_m.tobytes()
    assert often.position_cov_m2.tobytes() == once.position_cov_m2.tobytes()
    assert [fix.outcome for fix in often.fixes].count("repeated") == 2 * len(fixes)
    (note,) = set(often.notes) - set(once.notes)
    assert note.startswith(f"{2 * len(fixes)} fixes not used, because they repeat an earlier fix")


def test_a_filter_that_is_saved_still_knows_which_fixes_it_has_seen() -> None:
    online = pdr.OnlineFilter(pdr.recipes.default())
    block = pdr.merge_streams(pdr.simulate.demo_walk())
    fix = PositionFix(10.0, np.array([0.5, 8.0]), np.eye(2))
    for part in (slice(0, 1800), slice(1800, 2000)):
        push_part(online, block, part)
        online = resumed(online)
        online.add_fix(fix)
    online.finish()
    assert [result.outcome for result in online.now().fixes] == ["used", "repeated"]
