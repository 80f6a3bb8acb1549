"""Estimated path of the whole walk so far."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import cut_randomly, push_part, pushed

import pdr_filter as pdr
from pdr_filter.filter.chain.handler import states_of
from pdr_filter.filter.chain.with_path import PathState
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.whole_recording import outputs
from pdr_filter.values import FloatArray, ImuBlock, PositionFix


@pytest.fixture(scope="module")
def straight() -> ImuBlock:
    return pdr.merge_streams(simulate([Leg("walking", distance_m=100.0)], seed=2))


@pytest.fixture(scope="module")
def around() -> ImuBlock:
    sides = [Leg("walking", distance_m=25.0, turn_rad=np.pi / 2)] * 4
    return pdr.merge_streams(simulate(sides, seed=4))


def with_fix_at_the_end(online: pdr.OnlineFilter, block: ImuBlock, off_m: tuple[float, float]) -> tuple[Any, Any, Any]:
    """Paths before and after a fix that is so far ahead and to the right, and the unit vectors ahead and right."""
    push_part(online, block)
    before = online.path()
    along = before.position_m[-1] / np.linalg.norm(before.position_m[-1])
    axes = np.array([along, [along[1], -along[0]]])
    place_m = before.position_m[-1] + off_m @ axes
    online.add_fix(PositionFix(float(block.time_s[-1]) - 0.2, place_m, 0.1**2 * np.eye(2)))
    online.finish()
    return before, online.path(), axes


def until(block: ImuBlock, time_s: float) -> ImuBlock:
    n = int(np.searchsorted(block.time_s, time_s))
    return ImuBlock(*(getattr(block, name)[:n] for name in ImuBlock.__dataclass_fields__))


@pytest.mark.parametrize("weighting", ["imm", "wc", "hc"])
def test_a_whole_recording_keeps_no_path_of_past_steps(weighting: str) -> None:
    recording = simulate([Leg("walking", distance_m=60.0)], seed=2)
    config = replace(pdr.recipes.default().with_weighting(weighting), keeps_path=False)
    *_, (state, _) = outputs(recording, config, [PositionFix(20.0, np.array([0.0, 30.0]), np.eye(2))])
    assert state.last.fixes[-1].accepted
    assert not any(isinstance(part, PathState) for part in states_of(state.chain))


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_a_fix_at_the_end_of_a_straight_walk_corrects_the_past_in_proportion_to_the_distance(
    straight: ImuBlock, weighting: str
) -> None:
    before, after, (along, _) = with_fix_at_the_end(pdr.OnlineFilter(weighting=weighting), straight, (4.0, 0.0))
    n = before.n_steps
    moved_m = (after.position_m[:n] - before.position_m[:n]) @ along
    share = before.position_m[:n] @ along / (before.position_m[-1] @ along)
    assert moved_m[-1] == pytest.approx(4.0, abs=0.2)
    assert np.abs(moved_m - share * moved_m[-1]).max() < 0.35
    assert after.position_std_m[n // 2] < before.position_std_m[n // 2]


def test_a_fix_beside_a_straight_walk_rotates_the_walk_about_its_start(straight: ImuBlock) -> None:
    before, after, (along, across) = with_fix_at_the_end(pdr.OnlineFilter(), straight, (0.0, 6.0))
    n = before.n_steps
    moved_m = (after.position_m[:n] - before.position_m[:n]) @ across
    share = before.position_m[:n] @ along / (before.position_m[-1] @ along)
    assert moved_m[-1] == pytest.approx(6.0, abs=0.5)
    assert np.all(moved_m <= share * moved_m[-1] + 0.3)  # a heading that drifts turns the end more
    assert moved_m[n // 2] > 0.1 * moved_m[-1]


def test_the_last_row_is_the_position_of_now(around: ImuBlock) -> None:
    online = pdr.OnlineFilter()
    assert len(online.path()) == 0
    for end_s in (0.5, 10.0, 31.3, 70.0):
        seen_s = online.now().time_s
        part = until(around, end_s)
        new = part.time_s > (seen_s if np.isfinite(seen_s) else -1.0)
        push_part(online, ImuBlock(*(getattr(part, name)[new] for name in ImuBlock.__dataclass_fields__)))
        path, now = online.path(), online.now()
        np.testing.assert_allclose(path.position_m[-1], now.position_m, atol=1e-9)
        np.testing.assert_allclose(path.position_cov_m2[-1], now.position_cov_m2, atol=1e-9)
        assert path.n_steps == now.n_steps
        assert len(path) > path.n_steps
        assert (np.diff(path.time_s) > 0).all()


def rows(online: pdr.OnlineFilter) -> FloatArray:
    path = online.path()
    return np.column_stack([path.time_s, path.position_m, path.position_cov_m2.reshape(-1, 4)])


def test_the_path_does_not_depend_on_the_blocks_of_samples_and_survives_saving(around: ImuBlock) -> None:
    fixes = [PositionFix(t, (30.0 + 0.1 * t, -5.0), 2.0**2 * np.eye(2)) for t in (20.0, 40.0, 60.0)]
    filters: list[pdr.OnlineFilter] = []
    for blocks, n_resumed in (([around], 0), (cut_randomly(around, 0), 4)):
        online = pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
        for fix in fixes:
            online.add_fix(fix)
        filters.append(pushed(online, blocks, n_resumed=n_resumed)[0])
    np.testing.assert_array_equal(rows(filters[1]), rows(filters[0]))


def test_the_past_is_rotated_as_a_whole_when_the_frame_of_fixes_is_known(around: ImuBlock) -> None:
    plain, placed = pdr.OnlineFilter(), pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
    push_part(plain, around)
    reckoned = plain.path()
    for t in np.arange(5.0, 60.0, 5.0):
        east_m, north_m = (np.interp(t, reckoned.time_s, axis) for axis in reckoned.position_m.T)
        placed.add_fix(PositionFix(float(t), (north_m + 100.0, -east_m), 1.0**2 * np.eye(2)))  # a quarter turn
    push_part(placed, around)
    assert placed.state.pedestrian.frame.is_joined
    found = placed.path().position_m - (100.0, 0.0)
    expected = np.column_stack([reckoned.position_m[:, 1], -reckoned.position_m[:, 0]])
    assert np.linalg.norm(found - expected, axis=1).max() < 1.0


def test_a_path_with_an_undetermined_rotation_keeps_its_shape(straight: ImuBlock) -> None:
    plain, placed = pdr.OnlineFilter(), pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
    placed.add_fix(PositionFix(10.0, (50.0, 60.0), np.eye(2)))
    for online in (plain, placed):
        push_part(online, straight)
    lengths_m = [np.linalg.norm(np.diff(online.path().position_m, axis=0), axis=1) for online in (plain, placed)]
    np.testing.assert_allclose(lengths_m[1], lengths_m[0], atol=1e-6)
    path = placed.path()
    there_m = [np.interp(10.0, path.time_s, axis) for axis in path.position_m.T]
    np.testing.assert_allclose(there_m, (50.0, 60.0), atol=0.5)
