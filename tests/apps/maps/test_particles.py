"""Particle filter on a plan: closed forms, invariances, and walks through a synthetic building."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import a_step, cut_randomly, pushed, updates_of
from made_up import FEATURES, box, feature, line, round_the_block, turned, write
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import truncnorm
from true_positions import errors_m, true_m

import pdr_filter as pdr
from pdr_filter.apps.maps.crossing_costs import Ground, Terrain
from pdr_filter.apps.maps.particle_clusters import Alternative, cluster_numbers, n_needed, on_plan
from pdr_filter.apps.maps.particle_filter import ParticleState
from pdr_filter.apps.maps.particle_motion import OFFSET, SCALE
from pdr_filter.apps.maps.plan_smoothing import _Ancestors, _Event, _row
from pdr_filter.apps.maps.storey import FREE
from pdr_filter.filter.chain.handler import FixUse
from pdr_filter.values import FloorPassage, Step

pytestmark = pytest.mark.usefixtures("sensing_once")

WALK = round_the_block()
# Two fixes a few metres apart: they say the start, and hardly the direction.
FIXES = [pdr.PositionFix(0.0, [0.0, 0.0], 0.25 * np.eye(2)), pdr.PositionFix(7.0, [8.0, 0.5], 0.5 * np.eye(2))]


def in_world(seed: int = 0, plan: pdr.FloorPlan | None = None) -> pdr.Config:
    config = pdr.recipes.default().in_world_frame()
    return config if plan is None else config.with_plan(plan, seed=seed)


def begun(plan: pdr.FloorPlan, start: pdr.PositionFix | str, n_most: int = 4000) -> pdr.Config:
    """Return a configuration with fewer particles than for a whole building."""
    config = pdr.recipes.default().with_plan(plan, start)
    assert config.on_plan is not None
    return replace(config, on_plan=replace(config.on_plan, n_most=n_most))


def drawn(folder: Path, *features: dict[str, Any]) -> pdr.FloorPlan:
    return pdr.FloorPlan.read(write(folder / "plan.geojson", list(features)))


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> pdr.FloorPlan:
    return pdr.FloorPlan.read(write(tmp_path_factory.mktemp("plan") / "plan.geojson"))


@pytest.fixture(scope="module")
def alone() -> pdr.Track:
    """Track of the walk without a plan."""
    return pdr.track(WALK, in_world(), fixes=FIXES)


@pytest.fixture(scope="module")
def kept(plan: pdr.FloorPlan) -> pdr.Track:
    """Track of the walk on the plan."""
    return pdr.track(WALK, in_world(), fixes=FIXES, plan=plan)


def on(particles_m: np.ndarray, plan: pdr.FloorPlan, way: list[list[float]], **changes: Any) -> Scene:
    """The plan stage of a configuration, with particles of equal weight and reckoned positions as its state."""
    config, n = pdr.recipes.default().with_plan(plan), len(particles_m)
    particles = np.column_stack([particles_m, np.zeros((n, 4))])
    stage = config.on_plan
    state = replace(stage.init(), particles=particles, weight=np.full(n, 1 / n), reckoned=np.array(way), **changes)
    return Scene(config, stage, state)


@dataclass(frozen=True)
class Scene:
    """Particles before an event."""

    config: pdr.Config
    stage: Any
    state: ParticleState

    def after(self, event: Any) -> ParticleState:
        """State after an event of a pedestrian who stands still."""
        return self.stage.on(self.state, event, self.config.tracker.init().pedestrian, self.config.model)

    def after_grid(self, grid: pdr.GridFix, **changes: Any) -> ParticleState:
        """State after a grid."""
        before = replace(self.state, **changes)
        return replace(self, state=before).after(FixUse(grid, "nothing to compare", math.nan))

    def after_step(self, step: Step) -> ParticleState:
        """State after a step of walking."""
        state, [update] = updates_of(self.config.tracker.on_step(self.config.tracker.init(), step))
        is_walking = [mode.context == "walking" for mode in self.config.model.modes]
        walking = replace(update, mode_prob=np.array(is_walking, dtype=float))
        return self.stage.on(self.state, walking, state.pedestrian, self.config.model)


# --- closed form ------------------------------------------------------------------------------------------------------


def test_steps_against_a_wall_have_a_truncated_normal_distribution(tmp_path: Path) -> None:
    walled = drawn(tmp_path, *FEATURES, feature("wall", line((5, -1.2), (5, 1.2))))
    ground = Ground(walled.storeys[0], Terrain(wall=50.0))
    rng, n = np.random.default_rng(0), 100_000
    to_m = np.column_stack([rng.normal(4.6, 0.5, n), np.zeros(n)])
    cost, _ = ground.costs(np.full((n, 2), [4.0, 0.0]), to_m, np.zeros(n, dtype=bool))
    left = to_m[cost < 1, 0]
    # the wall is a cell, whose side is where it begins
    edge = (ground.storey.south_west_m[0] + 0.2 * np.floor((5 - ground.storey.south_west_m[0]) / 0.2) - 4.6) / 0.5
    expected = truncnorm(-np.inf, edge, 4.6, 0.5)
    assert_allclose(left.mean(), expected.mean(), atol=0.01)
    assert_allclose(left.std(), expected.std(), atol=0.01)


def test_entering_a_room_without_a_door_costs_once_and_leaving_it_nothing(plan: pdr.FloorPlan) -> None:
    terrain = Terrain(stay_room=0.0)
    ground = Ground(plan.storeys[0], terrain)
    way = np.column_stack([np.full(30, 20.0), np.linspace(0.0, 6.0, 30)])
    cost, _ = ground.costs(way[:-1], way[1:], np.zeros(29, dtype=bool))
    assert_allclose(cost.sum(), terrain.room, rtol=1e-5)
    back, _ = ground.costs(way[:0:-1], way[-2::-1], np.zeros(29, dtype=bool))
    assert back.sum() == 0


def test_two_groups_of_particles_are_two_clusters_with_their_weights() -> None:
    rng = np.random.default_rng(0)
    places = np.concatenate([rng.normal([0, 0], 0.5, (300, 2)), rng.normal([20, 5], 0.5, (100, 2))])
    place = on_plan(places, np.full(400, 1 / 400), np.zeros(400))
    assert_allclose([c.share for c in place.clusters], [0.75, 0.25])
    assert_allclose(place.position_m, places.mean(axis=0))
    assert_allclose(place.position_cov_m2, np.cov(places.T, bias=True))
    assert_allclose(place.effective_sample_size, 400)
    assert len(set(cluster_numbers(places))) == 2
    # the clusters share the rest of the probability
    doubted = on_plan(places, np.full(400, 1 / 400), np.zeros(400), elsewhere=0.2)
    assert_allclose([c.share for c in doubted.clusters], [0.6, 0.2])


def test_the_covariance_is_that_of_the_mixture_of_particles_and_dead_reckoning() -> None:
    rng = np.random.default_rng(0)
    particles, reckoned = rng.normal([0, 0], 0.5, (1000, 2)), rng.normal([6, -2], 1.5, (1000, 2))
    there = reckoned.mean(axis=0), np.cov(reckoned.T, bias=True)
    place = on_plan(particles, np.full(1000, 1e-3), np.zeros(1000), 0.2, Alternative(0.2, *there))
    assert_allclose(place.position_m, particles.mean(axis=0))
    # four to one: the particles four times, and the others once
    away = np.concatenate([*[particles] * 4, reckoned]) - place.position_m
    assert_allclose(place.position_cov_m2, away.T @ away / len(away))


def test_more_occupied_cells_need_more_particles() -> None:
    rng = np.random.default_rng(0)
    needed = [n_needed(rng.integers(0, k, (5000, 3)), 100, 100_000) for k in (1, 3, 10)]
    assert needed[0] == 100 and needed[0] < needed[1] < needed[2]
    # Fox 2003: 27 cells, e = 0.05, 99 %: half of the 0.99 quantile of chi-square with 26 degrees, 45.64, over 0.05
    assert_allclose(needed[1], 45.64 / (2 * 0.05), rtol=0.01)


def test_random_steps_from_any_position_have_a_mean_weight_of_one(plan: pdr.FloorPlan) -> None:
    terrain, rng, n = Terrain(stay_room=0.0, stay_outside=0.0), np.random.default_rng(0), 4000
    ground = Ground(plan.storeys[0], terrain)
    for place in ([5.0, 0.0], [20.0, 1.0], [40.0, 9.0], [0.5, 12.0]):
        angle = rng.uniform(0, 2 * math.pi, n)
        from_m = np.full((n, 2), place)
        to_m = from_m + terrain.look_m * np.column_stack([np.sin(angle), np.cos(angle)])
        cost, _ = ground.costs(from_m, to_m, np.zeros(n, dtype=bool))
        choice_cost = ground.choice_cost(from_m, terrain.leg_m)
        assert choice_cost[0] > 0.2
        assert np.exp(choice_cost - cost).mean() == pytest.approx(1.0, abs=0.25)


def test_the_cost_per_metre_of_a_random_walk_is_the_mean_over_positions_and_directions(plan: pdr.FloorPlan) -> None:
    terrain, rng, n = Terrain(stay_room=0.0, stay_outside=0.0), np.random.default_rng(0), 200_000
    ground = Ground(plan.storeys[0], terrain)
    places, angle = rng.uniform([-1.2, -1.2], [41.2, 19.2], (n, 2)), rng.uniform(0, 2 * math.pi, n)
    places, angle = (of[ground.storey.kind_at(places) == FREE] for of in (places, angle))
    to_m = places + terrain.look_m * np.column_stack([np.sin(angle), np.cos(angle)])
    cost, _ = ground.costs(places, to_m, np.zeros(len(places), dtype=bool))
    assert_allclose(ground.mean_cost_per_m * terrain.look_m, -np.log(np.exp(-cost).mean()), rtol=0.05)


def test_steps_along_a_corridor_gain_weight_over_steps_in_a_hall(tmp_path: Path) -> None:
    both = [feature("floor", box(-1, -1.4, 41, 1.4)), feature("floor", box(-1, 10, 41, 40))]
    ground = Ground(drawn(tmp_path, *both).storeys[0], Terrain())
    in_corridor, in_hall = ground.choice_cost(np.array([[20.0, 0.0], [20.0, 25.0]]), 0.75)
    # three of eight directions are free for 3 m, and a step is an eighth of a leg
    assert in_corridor == pytest.approx(-0.125 * math.log(3 / 8), abs=0.01)
    assert in_hall == 0.0
    assert ground.choice_cost(np.array([[500.0, 0.0]]), 0.75) == 0.0


def test_a_grid_weights_particles_by_their_cell_at_its_time_and_less_if_errors_are_correlated(
    plan: pdr.FloorPlan,
) -> None:
    # a step ago each was 0.7 m further south, in the southern row of cells
    particles_m = np.repeat([[10.0, 0.3], [20.0, 0.3]], 2000, axis=0)
    scene = on(particles_m, plan, [[20.0, 0, 0, 0], [20.5, 0, 0.7, 0]])
    grid = pdr.GridFix(20.0, (5.0, -10.0), 10.0, np.log([[0.8, 0.2], [0.1, 0.9]]), correlation_s=6.0)
    west = particles_m[:, 0] == 10.0

    def odds(state: ParticleState) -> float:
        return float(state.weight[west].sum() / state.weight[~west].sum())

    assert odds(scene.after_grid(grid)) == pytest.approx(4.0)
    assert odds(scene.after_grid(grid, last_grid_s=17.5)) == pytest.approx(4.0 ** math.tanh(2.5 / 12.0))
    off = pdr.GridFix(20.0, (500.0, -10.0), 10.0, grid.log_likelihood)
    assert odds(scene.after_grid(off)) == pytest.approx(1.0)
    before_the_first_position = scene.after_grid(replace(grid, time_s=19.0))
    assert_array_equal(before_the_first_position.weight, scene.state.weight)


def test_after_a_ride_in_a_lift_particles_that_were_in_a_lift_have_most_weight(tmp_path: Path) -> None:
    plan = drawn(tmp_path, *FEATURES, feature("lift", box(9, -1, 11, 1)), feature("lift", box(29, -1, 31, 1)))
    # a quarter of the particles in each lift, the others in the corridor, two steps after they got out to the north
    particles_m = np.repeat([[10, 1.4], [30, 1.4], [20, 1.4], [5, 1.4]], 1000, axis=0)
    scene = on(particles_m, plan, [[20.0, 0, 0, 0], [20.5, 0, 0.7, 0], [21.0, 0, 1.4, 0]])
    by_lift = FloorPassage(5.0, 20.0, 0, 1, "lift")
    after = scene.after(by_lift)
    in_lift = np.isin(after.particles[:, 0], [10, 30])
    assert after.weight[in_lift].sum() == pytest.approx(1 / (1 + math.exp(-4.6)), abs=0.005)
    for how in ("stairs", "unknown"):
        assert_array_equal(scene.after(replace(by_lift, how=how)).weight, scene.state.weight)


def test_particles_spread_over_the_angle_turned_within_a_step(tmp_path: Path) -> None:
    field = drawn(tmp_path, feature("floor", box(-20, -20, 20, 20)))
    scene, across = on(np.zeros((20_000, 2)), field, [[0.5, 0.0, 0.0, 0.0]]), list[float]()
    for turn_rate_radps in (0.0, 1.0):
        after = scene.after_step(replace(a_step(), turn_rate_radps=turn_rate_radps))
        east_m, north_m = after.particles[:, :2].T
        across.append(east_m.var() / np.mean(east_m**2 + north_m**2))
    assert across[1] - across[0] == pytest.approx(0.5**2 / 12, rel=0.15)


@pytest.mark.parametrize(("in_room", "begun_at"), [(False, 1.0), (True, 1.0), (True, 4.5), (False, -6.9)])
def test_a_step_changes_the_odds_of_a_wrong_plan_by_its_bayes_factor_within_limits(
    tmp_path: Path, in_room: bool, begun_at: float
) -> None:
    """In the middle of a hall it is one. In a room without a door it is the cost of staying there."""
    rooms = [feature("room", box(-15, -15, 15, 15))] * in_room
    plan = drawn(tmp_path, feature("floor", box(-20, -20, 20, 20)), *rooms)
    scene = on(np.zeros((4000, 2)), plan, [[0.5, 0.0, 0.0, 0.0]], wrong_log_odds=begun_at)
    after = scene.after_step(a_step())
    assert after.wrong_log_odds == pytest.approx(min(begun_at + Terrain().stay_room * in_room, 4.6), abs=1e-6)
    assert after.n_contradicted == int(in_room)
    assert replace(after, wrong_log_odds=math.log(3.0)).elsewhere == pytest.approx(0.75)


def test_a_wrong_start_may_be_anywhere_on_the_storey_and_the_walk_may_have_led_in_any_direction(
    tmp_path: Path,
) -> None:
    field = drawn(tmp_path, feature("floor", box(-10, -20, 30, 20)))
    on_plan = begun(field, pdr.PositionFix(0.0, [0.0, 0.0], np.eye(2))).on_plan
    reckoned = np.array([3.0, 4.0]), np.diag([1.0, 2.0])
    alternative = on_plan.alternative(on_plan.init(), reckoned, 0.9)
    assert alternative is not None and alternative.prob == pytest.approx(0.9 - 0.1)
    assert_allclose(alternative.mean_m, [10.0, 0.0], atol=0.11)  # half a cell
    assert_allclose(alternative.cov_m2, (40.0**2 / 12 + (25 + 3) / 2) * np.eye(2), atol=2.0)
    even = on_plan.alternative(on_plan.init(), reckoned, 0.5)
    assert even is not None and even.prob == 0.0
    # fixes place dead reckoning on the plan
    placed = on_plan.alternative(replace(on_plan.init(), is_placed=True), reckoned, 0.5)
    assert placed == (0.5, *reckoned)


# --- invariances ------------------------------------------------------------------------------------------------------


def test_the_track_is_bit_identical_for_any_blocks_and_after_save_and_resume(plan: pdr.FloorPlan) -> None:
    walk = replace(WALK, magnetometer=None)
    track = pdr.track(walk, in_world(), fixes=FIXES, plan=plan)
    online = pdr.OnlineFilter(in_world(), plan=plan)
    for fix in FIXES:
        online.add_fix(fix)
    online, updates = pushed(online, cut_randomly(pdr.merge_streams(walk), 1, 1200), n_resumed=2)
    assert_array_equal(np.array([u.position_m for u in updates]), track.position_m)
    assert_array_equal(np.array([u.position_cov_m2 for u in updates]), track.position_cov_m2)
    assert_array_equal(online.position_m, track.end_position_m)
    assert_allclose(online.now().position_m, online.position_m, atol=3.0)  # two steps that are not sure yet
    assert online.on_plan is not None and len(online.on_plan.clusters) == len(track.clusters[-1])


def test_equal_seeds_give_identical_tracks_and_another_seed_a_similar_one(plan: pdr.FloorPlan, kept: pdr.Track) -> None:
    again, other = (pdr.track(WALK, in_world(seed, plan), fixes=FIXES) for seed in (0, 1))
    assert_array_equal(kept.position_m, again.position_m)
    away = np.linalg.norm(kept.position_m - other.position_m, axis=1)
    assert 0 < np.median(away) < 0.5 * np.median(kept.position_std_m)


def test_a_rotated_plan_rotates_the_track(kept: pdr.Track, tmp_path: Path) -> None:
    angle = math.pi / 2
    other = drawn(tmp_path, *turned(FEATURES, angle))
    rotation = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    fixes = [replace(fix, position_m=rotation @ fix.position_m) for fix in FIXES]
    there = pdr.track(WALK, in_world(), fixes=fixes, plan=other)
    away = np.linalg.norm(kept.position_m @ rotation.T - there.position_m, axis=1)
    assert np.median(away) < 0.3


def test_an_open_field_as_a_plan_hardly_changes_the_track(alone: pdr.Track, tmp_path: Path) -> None:
    field = drawn(tmp_path, feature("floor", box(-200, -200, 200, 200)))
    on_field = pdr.track(WALK, in_world(), fixes=FIXES, plan=field)
    late = alone.time_s > FIXES[-1].time_s + 5.0  # earlier, the rotation is less certain
    away = np.linalg.norm(alone.position_m - on_field.position_m, axis=1)[late]
    assert np.all(away < 0.2 * alone.position_std_m[late])
    assert_allclose(on_field.position_std_m[late], alone.position_std_m[late], rtol=0.25)


# --- walks ------------------------------------------------------------------------------------------------------------


def test_walls_keep_a_drifting_track_in_the_corridor(plan: pdr.FloorPlan, alone: pdr.Track, kept: pdr.Track) -> None:
    assert kept.frame == "plan" and kept.plan is plan
    assert np.median(errors_m(kept, WALK)) < 0.5 * np.median(errors_m(alone, WALK))
    assert errors_m(kept, WALK)[-1] < 0.5 * errors_m(alone, WALK)[-1]
    assert errors_m(kept, WALK)[-1] < 2.0 * kept.position_std_m[-1]
    assert len(kept.clusters) == kept.n_steps == len(kept.effective_sample_size)


def test_corridors_determine_an_unknown_walking_direction(plan: pdr.FloorPlan) -> None:
    track = pdr.track(WALK, begun(plan, pdr.PositionFix(0.0, [0.0, 0.0], 0.25 * np.eye(2))))
    assert errors_m(track, WALK)[-1] < 2.0
    assert len(track.clusters[-1]) == 1
    assert track.position_std_m[-1] < 3.0
    assert not any("the plan" in note for note in track.notes)


def test_a_walk_along_a_corridor_is_placed_in_the_corridor_and_not_in_the_adjacent_hall(tmp_path: Path) -> None:
    hall = [feature("floor", box(-1.4, -1.4, 60, 1.4)), feature("floor", box(-1.4, 1.6, 60, 40))]
    plan = drawn(tmp_path, *hall)
    beside = pdr.PositionFix(0.0, [0.0, 1.5], np.diag([0.25, 9.0]))
    first = WALK.truth.position.time_s[np.argmax(WALK.truth.position.east_m > 39.0)]  # time of the first corner
    track = pdr.track(WALK, begun(plan, beside), fixes=[pdr.HeadingFix(3.0, math.pi / 2, 0.1)])
    before = int(np.searchsorted(track.time_s, first)) - 1
    in_corridor = sum(c.share for c in track.clusters[before] if c.position_m[1] < 1.5)
    assert in_corridor > 0.85


def test_a_walk_with_an_unknown_start_is_found_and_has_a_high_probability_only_then(plan: pdr.FloorPlan) -> None:
    track = pdr.track(WALK, plan=plan, start="anywhere")
    share = np.array([clusters[0].share for clusters in track.clusters])
    assert sum(c.share for c in track.clusters[0]) == pytest.approx(0.5, abs=0.01)  # few particles for many places
    assert share[-1] > 0.95 and errors_m(track, WALK)[-1] < 2.0
    assert np.all(errors_m(track, WALK)[share > 0.95] < 3.0 * track.position_std_m[share > 0.95])
    # it does not begin at the zero of the plan, where nobody put it
    assert np.linalg.norm(track.position_m[0] - track.start_position_m) == pytest.approx(track.step_length_m[0])


def test_a_wrong_start_is_named_and_the_deviation_covers_the_true_position_online_and_smoothed(
    plan: pdr.FloorPlan,
) -> None:
    config, walk = begun(plan, pdr.PositionFix(0.0, [25.0, 18.0], 0.25 * np.eye(2))), replace(WALK, magnetometer=None)
    track, smoothed = pdr.track(walk, config), pdr.smooth(walk, config=config).track
    for found in (track, smoothed):
        [note] = [note for note in found.notes if "contradict the plan" in note]
        assert int(note.split()[0]) > 20 and "the start, the fixes or the plan are wrong" in note
        assert errors_m(found, WALK)[-1] < 2.0 * found.position_std_m[-1]
        assert sum(c.share for c in found.clusters[-1]) < 0.5
    assert sum(c.share for c in track.clusters[0]) == pytest.approx(0.999, abs=0.0005)
    assert np.all(errors_m(smoothed, WALK) < 3.0 * smoothed.position_std_m)
    online, updates = pushed(pdr.OnlineFilter(config), cut_randomly(pdr.merge_streams(walk), 2, 2000), n_resumed=4)
    assert_array_equal(np.array([u.position_cov_m2 for u in updates]), track.position_cov_m2)
    assert next(note for note in online.notes if "contradict the plan" in note) in track.notes


def test_the_right_start_of_a_real_walk_is_not_contradicted_while_its_direction_is_learnt(data_dir: Path) -> None:
    """It loses 5.7 nats of evidence in 28 s: most of the directions drawn at the start lead into walls."""
    recording = pdr.read(next((data_dir / "ms_indoor").glob("*f2_5dda40259191710006b57386*")))
    first = recording.truth.waypoints[0]
    start = pdr.PositionFix(0.0, [first.east_m, first.north_m], 0.25 * np.eye(2))
    track = pdr.track(recording, plan=pdr.FloorPlan.read(data_dir / "maps" / "ms_indoor_site1_F2.geojson"), start=start)
    assert not any("contradict the plan" in note for note in track.notes)
    last, end_m = recording.truth.waypoints[-1], track.end_position_m
    assert math.hypot(end_m[0] - last.east_m, end_m[1] - last.north_m) < 3.0 * track.position_std_m[-1] < 15.0


def test_a_walk_starts_in_the_named_room(plan: pdr.FloorPlan) -> None:
    track = pdr.track(WALK, begun(plan, "west", 1000))
    assert_allclose(track.position_m[0], [3.8, 10.2], atol=1.0)


def test_grids_with_two_candidates_find_a_walk_with_an_unknown_start_for_any_blocks(
    plan: pdr.FloorPlan,
) -> None:
    wrong = np.array([2, 7])
    grids: list[pdr.GridFix] = []
    for time_s in (8.0, 20.0, 35.0):
        cells = np.full((12, 20), 1e-6)
        column_row = ((true_m(WALK, time_s) + 3.75) // 2.5).astype(int)
        for row, column in (column_row[::-1], wrong):
            cells[row - 1 : row + 2, column - 1 : column + 2] = 0.05
        grids.append(pdr.GridFix(time_s, (-3.75, -3.75), 2.5, np.log(cells)))
    config = begun(plan, "anywhere", 20_000)
    walk = replace(WALK, magnetometer=None)
    track = pdr.track(walk, config, fixes=grids)
    assert [fix.outcome for fix in track.fixes] == ["used"] * 3 and track.fixes[0].kind == "grid"
    assert errors_m(track, WALK)[-1] < 2.5
    online = pdr.OnlineFilter(config)
    for grid in grids:
        online.add_fix(grid)
    _, updates = pushed(online, cut_randomly(pdr.merge_streams(walk), 3, 1500), n_resumed=4)
    assert_array_equal(np.array([u.position_m for u in updates]), track.position_m)


def test_a_grid_without_a_plan_is_refused_with_the_remedy() -> None:
    grid = pdr.GridFix(4.0, (0.0, 0.0), 3.0, np.zeros((2, 2)))
    for use in (
        lambda: pdr.track(WALK, fixes=[grid]),
        lambda: pdr.OnlineFilter().add_fix(grid),
        lambda: pdr.smooth(WALK, fixes=[grid]),
    ):
        with pytest.raises(ValueError, match=r"give plan as well.*RadioMap.fixes"):
            use()


def test_the_smoothed_covariance_includes_dead_reckoning_if_the_end_is_uncertain(
    alone: pdr.Track, tmp_path: Path
) -> None:
    closed = [*FEATURES, feature("room", box(4, -1.4, 38, 1.4))]  # the whole of its first corridor
    plan = drawn(tmp_path, *closed)
    hindsight = pdr.smooth(WALK, fixes=FIXES, config=in_world(6, plan)).track
    doubt = 1.0 - hindsight.clusters[-1][0].share
    assert doubt > 0.25
    away_m = hindsight.position_m - alone.position_m
    reached = np.einsum("ni,nij,nj->n", away_m, np.linalg.inv(hindsight.position_cov_m2), away_m)
    assert np.linalg.norm(away_m, axis=1).max() > 5.0
    assert np.all(reached < 1.2 / doubt)  # because the covariance is at least d a a'


def test_later_steps_improve_earlier_smoothed_positions(plan: pdr.FloorPlan) -> None:
    # how far along the corridor the walk began shows at the first turn
    start = pdr.PositionFix(0.0, [4.0, 0.0], np.diag([16.0, 0.25]))
    config = begun(plan, start)
    online, hindsight = pdr.track(WALK, config), pdr.smooth(WALK, config=config)
    early = slice(0, 40)
    assert np.median(errors_m(hindsight.track, WALK)[early]) < 0.6 * np.median(errors_m(online, WALK)[early])
    apart_m = np.linalg.norm(hindsight.track.end_position_m - online.end_position_m)
    assert apart_m < 2 * online.position_std_m[-1] and apart_m < 1.5
    assert_allclose([clusters[0].share for clusters in hindsight.track.clusters], 0.999, atol=0.002)


def test_smoothed_steps_keep_their_lengths_if_the_direction_is_unknown_and_a_note_says_so(tmp_path: Path) -> None:
    hall = drawn(tmp_path, feature("floor", box(-90, -90, 90, 90)))
    walk = replace(WALK, magnetometer=None)
    config = begun(hall, pdr.PositionFix(0.0, [0.0, 0.0], 0.25 * np.eye(2)))
    found, alone = pdr.smooth(walk, config=config), pdr.smooth(walk, config=pdr.recipes.default()).track
    assert found.heading_offset_std_rad.min() > 1.5
    assert np.linalg.norm(np.diff(found.track.position_m, axis=0), axis=1).sum() < 0.5 * alone.distance_m
    assert_allclose(found.track.step_length_m, alone.step_length_m, rtol=0.1)
    assert_allclose(found.track.distance_m, alone.distance_m, rtol=0.05)
    assert_allclose(found.track.step_speed_mps * np.asarray(alone.steps.duration_s), found.track.step_length_m)
    assert any("several routes on the plan fit the walk" in note for note in found.track.notes)


def test_smoothed_positions_are_sums_of_the_steps_if_the_direction_is_known(plan: pdr.FloorPlan) -> None:
    track = pdr.smooth(WALK, fixes=FIXES, plan=plan).track
    moved_m = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1).sum()
    assert_allclose(track.walked_m[-1] - track.walked_m[0], moved_m, rtol=0.02)
    assert not any("several routes on the plan" in note for note in track.notes)


def test_a_smoothed_step_has_the_circular_mean_heading_and_the_mean_length_of_its_particles() -> None:
    particles, weight = np.zeros((3, 6)), np.array([0.2, 0.4, 0.4])
    particles[:, OFFSET], particles[:, SCALE] = [3.0, 0.3, -0.3], np.log([0.9, 1.0, 1.2])
    event = _Event(ParticleState(particles, weight), None, length_m=0.7, is_restart=False)
    for order in ([0, 1, 2], [2, 0, 1]):
        row = _row(_Ancestors(event, particles[order], weight[order], 0.01), alternative=None, ground=None)
        assert_allclose(row.offset, np.angle(weight @ np.exp(1j * particles[:, OFFSET])))
        assert_allclose(row.offset_std**2, weight @ (particles[:, OFFSET] - row.offset) ** 2)
        assert_allclose(row.length_m, 0.2 * 0.63 + 0.4 * 0.7 + 0.4 * 0.84)


def test_a_wall_across_the_corridor_is_crossed_with_a_note(tmp_path: Path) -> None:
    closed = [*FEATURES, feature("wall", line((38.0, 9), (42.0, 9)))]
    plan = drawn(tmp_path, *closed)
    track = pdr.track(WALK, in_world(), fixes=FIXES, plan=plan)
    assert errors_m(track, WALK)[-1] < 2.0
    said = ("crosses a wall: check whether the plan lacks a door", "enters block, to which the plan has no door")
    assert any(words in note for note in track.notes for words in said)


def test_a_plan_of_another_building_gives_a_note_that_nothing_fits(alone: pdr.Track, tmp_path: Path) -> None:
    plan = drawn(tmp_path, *turned(FEATURES, 1.2))
    misled = [pdr.track(WALK, in_world().with_plan(plan, seed=seed), fixes=FIXES) for seed in range(3)]
    assert all(any("nothing on the plan fits" in note for note in track.notes) for track in misled)
    assert np.median([np.median(errors_m(track, WALK)) for track in misled]) < np.median(errors_m(alone, WALK)) + 4.0


def test_a_thousand_particles_run_much_faster_than_real_time(plan: pdr.FloorPlan) -> None:
    from time import process_time

    times = []
    for p in (None, plan):
        began = process_time()
        pdr.track(WALK, in_world(), fixes=FIXES, plan=p)
        times.append(process_time() - began)
    assert times[1] - times[0] < WALK.duration_s / 30  # a third of the speed is left for a busy machine


@pytest.mark.parametrize("weighting", ["imm", "hc"])
def test_the_plan_gets_each_step_with_the_state_after_it_also_at_the_end(
    plan: pdr.FloorPlan, weighting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, numbers = begun(plan, pdr.PositionFix(0.0, (0.0, 0.0), np.eye(2)), n_most=1000), list[int]()
    on = type(config.on_plan).on

    def counting(stage: Any, state: Any, event: Any, pedestrian: Any, model: Any) -> Any:
        numbers.extend([pedestrian.steps.n_final] * isinstance(event, pdr.StepUpdate))
        return on(stage, state, event, pedestrian, model)

    monkeypatch.setattr(type(config.on_plan), "on", counting)
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=12.0)], seed=1)
    track = pdr.track(walk, config, weighting=weighting)
    assert len(numbers) == track.n_steps > 10
    assert numbers[-1] == track.n_steps
