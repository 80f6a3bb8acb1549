"""The benchmark against other packages: nothing is hidden, and its own measure and axes are right."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from pdr_filter.simulate import Leg, phone_motion, simulate
from tests.benchmarks.peers import ours, tables, textbook
from tests.benchmarks.peers.harness import outcome, table
from tests.benchmarks.peers.speed import Contestant, times_real_time
from tests.benchmarks.peers.walks import Found, Method, Run, Walk, between, of_steps, rotated, turned

COUNT = ("steps",)


LEGS = (
    Leg("stationary", duration_s=4.0),
    Leg("walking", distance_m=25.0),
    Leg("walking", distance_m=15.0, turn_rad=np.pi / 2),
    Leg("stationary", duration_s=4.0),
)


@cache
def a_walk() -> Walk:
    recording = simulate(LEGS, seed=3)
    step_s = recording.truth.steps.time_s
    return Walk(recording, float(step_s[0]) - 1.0, float(step_s[-1]) + 0.6)


def cells(o: object) -> list[str]:
    return [str(sum(len(found.step_s) for _, found in o.found))]  # type: ignore[attr-defined]


def missing() -> Run:
    import no_such_package_for_gait  # noqa: F401 # pyright: ignore[reportMissingImports]

    raise AssertionError("unreachable")


def failing(walk: Walk) -> Found:
    raise RuntimeError("no gait in sight")


def test_a_missing_package_has_a_row_that_names_it() -> None:
    outcomes = [outcome(Method("peer", "gaitpeer", missing), [a_walk()]), outcome(textbook.METHODS[1], [a_walk()])]
    columns, rows = table(COUNT, outcomes, cells)
    assert columns == ["method", "steps"]
    assert len(rows) == 2
    assert "not run: gaitpeer is not installed" in rows[0][1]
    assert "no_such_package_for_gait" in rows[0][1]
    for question in (tables.counts_by_place, tables.legs, tables.room):
        columns, rows = question(outcomes[:1])
        assert "gaitpeer is not installed" in " ".join(rows[0])
        assert len(rows[0]) == max(len(columns), 2)


def test_a_package_that_fails_on_a_walk_is_said_to() -> None:
    def sometimes(walk: Walk) -> Found:
        return failing(walk) if walk.start_s == 0.0 else Found(np.array([1.0]))

    whole = Walk(a_walk().recording, 0.0, 1.0)
    always = outcome(Method("peer", "gaitpeer", lambda: failing), [a_walk()])
    once = outcome(Method("peer", "gaitpeer", lambda: sometimes), [whole, a_walk()])
    _, rows = table(COUNT, [always, once], cells)
    assert "failed on every walk" in rows[0][1]
    assert "failed on 1: simulated_walk, RuntimeError: no gait in sight" in rows[1][0]
    assert rows[1][-1] == "1"


def test_ours_and_a_textbook_detector_count_a_simulated_walk() -> None:
    walk = a_walk()
    n_true = len(walk.recording.truth.steps)
    for method in (ours.METHODS[0], *textbook.METHODS[:2]):
        found = outcome(method, [walk]).found[0][1]
        assert abs(len(tables.within(found, walk, 0.3)) - n_true) <= 0.03 * n_true, method.name


def test_track_has_the_steps_of_detect_steps() -> None:
    detected, lengths, smoothed = (method.load()(a_walk()).step_s for method in ours.METHODS)
    np.testing.assert_array_equal(lengths, detected)
    np.testing.assert_array_equal(smoothed, detected)


def test_distance_of_ours_is_the_sum_of_its_step_lengths() -> None:
    walk = a_walk()
    found = ours.METHODS[1].load()(walk)
    speed = found.speeds(np.arange(0.0, walk.recording.duration_s, 0.01))
    assert 0.01 * np.nansum(speed) == pytest.approx(pdr.track(walk.recording).step_length_m.sum(), rel=2e-3)


def test_constant_steps_go_their_length_times_their_number() -> None:
    contact_s = np.array([1.0, 1.5, 2.0, 2.6, 7.0, 7.5])  # a pause between the fourth and the fifth
    found = between(contact_s, 0.7)
    np.testing.assert_array_equal(found.step_s, contact_s)
    assert 0.01 * np.nansum(found.speeds(np.arange(0.0, 9.0, 0.01))) == pytest.approx(4 * 0.7, rel=1e-6)


def test_overlapping_stretches_give_their_mean_speed_and_the_rest_none() -> None:
    found = Found(np.empty(0), np.array([1.0, 1.5, 4.0]), np.array([2.0, 3.0, 5.0]), np.array([1.0, 2.0, np.nan]))
    speed = found.speeds(np.array([0.5, 1.2, 1.7, 2.5, 3.5, 4.5]))
    np.testing.assert_allclose(speed, [np.nan, 1.0, 1.5, 2.0, np.nan, np.nan])


def test_steps_become_stretches_that_end_with_their_contacts() -> None:
    found = of_steps(np.array([1.0, 1.5]), np.array([0.5, 0.5]), np.array([0.6, 0.8]))
    np.testing.assert_allclose(found.start_s, [0.5, 1.0])
    np.testing.assert_allclose(found.speed_mps, [1.2, 1.6])


def test_quaternions_turn_as_those_of_scipy() -> None:
    rng = np.random.default_rng(0)
    rotation, vectors = Rotation.random(20, rng=rng), rng.normal(size=(20, 3))
    np.testing.assert_allclose(
        rotated(rotation.as_quat(scalar_first=True), vectors), rotation.apply(vectors), atol=1e-12
    )


def test_a_vector_ahead_is_ahead_whatever_the_heading() -> None:
    heading_rad = np.linspace(-np.pi, np.pi, 9)
    east, north = np.sin(heading_rad), np.cos(heading_rad)
    ahead = turned(heading_rad, np.column_stack([east, north, np.full(9, 2.0)]))
    np.testing.assert_allclose(ahead, np.tile([0.0, 1.0, 2.0], (9, 1)), atol=1e-12)


def test_body_axes_of_a_simulated_walk_are_those_of_the_person() -> None:
    walk = a_walk()
    motion, steps = phone_motion(LEGS, seed=3), walk.recording.truth.steps
    first_leg = walk.recording.truth.segments.end_s[1]  # northward
    use = (walk.time_s > steps.time_s[2]) & (walk.time_s < first_leg - 3.0)
    time_s = walk.time_s[use]
    exact = motion.rotation(time_s).apply(motion.specific_force_mps2(time_s))  # east, north, up
    force = walk.body[0][use]
    np.testing.assert_allclose(force.mean(axis=0), exact.mean(axis=0), atol=0.3)  # a phone's own bias
    for axis in (1, 2):  # ahead, with its sign, and up
        assert np.corrcoef(force[:, axis], exact[:, axis])[0, 1] > 0.9


def test_the_speed_of_a_method_is_that_of_its_fastest_runs_on_the_walks_that_it_gets_through() -> None:
    walk, slow_s = a_walk(), iter([9.0, 2.0, 4.0])

    def times_s(files: list, walks: list[Walk]) -> np.ndarray:
        return np.array([next(slow_s), np.nan])[: len(walks)]

    known = Contestant("peer", times_s, walk_known=True)
    speed = times_real_time([known], [Path("a"), Path("b")], [walk, walk], rounds=2)
    np.testing.assert_allclose(speed, (walk.end_s - walk.start_s) / 2.0)
