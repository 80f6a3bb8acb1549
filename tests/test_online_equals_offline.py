"""One filter, two faces: a pushed stream and a whole recording give the same bits."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import cut, cut_randomly, from_hand_to_pocket, of_nobody, part_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.filtering import MAX_CLIMBS
from pdr_filter.tracking.track import Track
from pdr_filter.values import ImuBlock, PositionFix, Samples, step_table, wrap_angle
from pdr_filter.values.recording import Recording

WEIGHTINGS = ("imm", "wc", "hc")
REAL = (
    "humolire/humolire_user1_3f.zip",
    "ubicomp13/ubicomp13_p04_e1_trousers_front_pocket.zip",
    "oxford/oxford_jamie_pixel_hard_swingingarm_2.zip",  # accelerometer only
)


@pytest.fixture(scope="module")
def demo() -> Recording:
    return of_nobody(from_hand_to_pocket())


@pytest.fixture(scope="module")
def tracked_demo(demo: Recording) -> Callable[[str], Track]:
    """Track of the demo with each weighting."""
    return cache(lambda weighting: tracked(demo, weighting=weighting))


@pytest.fixture(scope="module")
def short_walk() -> Recording:
    walking = [Leg("walking", distance_m=15.0), Leg("walking", distance_m=8.0, turn_rad=1.0)]
    return simulate([Leg("stationary", duration_s=4.0), *walking], seed=5)


def push(online: pdr.OnlineFilter, block: ImuBlock) -> list[pdr.StepUpdate]:
    return online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)


def stream(online: pdr.OnlineFilter, blocks: Sequence[ImuBlock]) -> list[pdr.StepUpdate]:
    return [*(u for block in blocks for u in push(online, block)), *online.finish()]


def tracked(recording: Recording, config: pdr.Config | None = None, **arguments: Any) -> Track:
    """The whole recording with the configuration of `online_filter`, which knows nothing of the person."""
    return pdr.track(recording, config or recipes.default(), **arguments)


def online_filter(weighting: str) -> pdr.OnlineFilter:
    return pdr.OnlineFilter(recipes.default().with_weighting(weighting))


def assert_updates_are_the_track(updates: Sequence[pdr.StepUpdate], track: Track) -> None:
    """Every bit of every final update."""
    final = [u for u in updates if u.is_final]
    assert [u.index for u in final] == list(range(track.n_steps))
    names = "position_m position_cov_m2 step_length_m walked_m context_prob mode_prob height_m height_std_m floor"
    for name in names.split():
        np.testing.assert_array_equal([getattr(u, name) for u in final], getattr(track, name), err_msg=name)
    np.testing.assert_array_equal(wrap_angle([u.walking_heading_rad for u in final]), track.walking_heading_rad)
    steps = step_table([u.step for u in final])
    for name in steps.dtype.names or ():
        np.testing.assert_array_equal(steps[name], track.steps[name], err_msg=name)


def assert_same_updates(actual: Sequence[pdr.StepUpdate], expected: Sequence[pdr.StepUpdate]) -> None:
    assert [(u.index, u.is_final, u.step) for u in actual] == [(u.index, u.is_final, u.step) for u in expected]
    for name in ("position_m", "position_cov_m2", "mode_prob", "step_length_m", "walked_m", "walking_heading_rad"):
        ours, theirs = ([getattr(update, name) for update in updates] for updates in (actual, expected))
        np.testing.assert_array_equal(ours, theirs, err_msg=name)


# --- chunking -------------------------------------------------------------------------------------------------------


# The front end, where blocks matter most, is the same for all weightings: only one of them gets tiny blocks.
@pytest.mark.parametrize(("weighting", "mean_length"), [("imm", 7), ("wc", 40), ("hc", 40)])
def test_the_simulated_walk_gives_the_same_bits_however_it_arrives(
    demo: Recording, tracked_demo: Callable[[str], Track], weighting: str, mean_length: int
) -> None:
    track = tracked_demo(weighting)
    assert track.n_steps > 190
    blocks = cut_randomly(pdr.merge_streams(demo), seed=mean_length, mean_length=mean_length)
    online = online_filter(weighting)
    assert_updates_are_the_track(stream(online, blocks), track)
    assert online.notes == track.notes
    np.testing.assert_array_equal(online.position_m, track.position_m[-1])


@pytest.mark.parametrize("weighting", ["wc", "hc"])
def test_every_division_into_blocks_reports_the_same_provisional_steps(short_walk: Recording, weighting: str) -> None:
    samples = pdr.merge_streams(short_walk)
    several, single = (stream(online_filter(weighting), cut(samples, cuts)) for cuts in ([], list(range(0, 9999, 10))))
    provisional = [[u for u in updates if not u.is_final] for updates in (several, single)]
    assert_same_updates(provisional[0], provisional[1])
    assert len(provisional[0]) > 20


def test_a_whole_recording_computes_no_provisional_steps(
    short_walk: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(tracker: object, state: object) -> None:
        raise AssertionError("nobody asked for a provisional step")

    monkeypatch.setattr(WeightedTracker, "provisional", refuse)
    assert tracked(short_walk, weighting="wc").n_steps > 0


@pytest.mark.recordings
@pytest.mark.parametrize(("name", "weighting"), list(zip(REAL, ("hc", "wc", "imm"), strict=True)))
def test_real_recordings_give_the_same_bits_however_they_arrive(data_dir: Path, name: str, weighting: str) -> None:
    recording = pdr.read(data_dir / name)
    blocks = cut_randomly(pdr.merge_streams(recording), seed=len(name))
    track = tracked(recording, weighting=weighting)
    assert track.n_steps > 70
    assert_updates_are_the_track(stream(online_filter(weighting), blocks), track)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(0, 5000), max_size=40), weighting=st.sampled_from(WEIGHTINGS))
def test_empty_blocks_and_single_samples_change_nothing(short_walk: Recording, cuts: list[int], weighting: str) -> None:
    blocks = cut(pdr.merge_streams(short_walk), cuts)
    assert_updates_are_the_track(stream(online_filter(weighting), blocks), tracked(short_walk, weighting=weighting))


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_fixes_added_beforehand_give_the_same_bits(short_walk: Recording, weighting: str) -> None:
    rng = np.random.default_rng(0)
    fixes = [
        PositionFix(t, rng.normal(size=2) * 5, np.eye(2) * 4, received_time_s=t + delay)
        for t, delay in [(12.0, 0.0), (6.0, 1.5), (9.0, 0.2), (7.0, 30.0)]
    ]
    track = tracked(short_walk, weighting=weighting, fixes=fixes)
    without = tracked(short_walk, weighting=weighting)
    online = online_filter(weighting)
    for fix in fixes:
        online.add_fix(fix)
    assert_updates_are_the_track(stream(online, cut_randomly(pdr.merge_streams(short_walk), 3)), track)
    # before the first fix arrives nothing differs, after it the positions do
    early = track.steps.detected_time_s < 7.5 - 1.0
    np.testing.assert_array_equal(track.position_m[early], without.position_m[early])
    assert np.abs(track.position_m[-1] - without.position_m[-1]).max() > 0.01


def test_a_fix_added_when_it_arrives_is_used_as_if_it_had_been_known(short_walk: Recording) -> None:
    fix = PositionFix(9.0, np.array([1.0, 4.0]), np.eye(2), received_time_s=9.5)
    track = tracked(short_walk, fixes=[fix])
    block = pdr.merge_streams(short_walk)
    before, after = cut(block, [int(np.searchsorted(block.time_s, 9.4))])
    online = online_filter("imm")
    updates = [u for piece in cut_randomly(before, 8, mean_length=10) for u in push(online, piece)]
    online.add_fix(fix)
    assert_updates_are_the_track([*updates, *stream(online, cut_randomly(after, 9, mean_length=10))], track)


def test_a_fix_moves_the_steps_that_become_known_after_it_was_received_and_no_earlier_one(
    short_walk: Recording,
) -> None:
    known_s = tracked(short_walk).steps.detected_time_s
    for received_s in (known_s[5] - 1e-4, known_s[5] + 1e-4):
        fix = PositionFix(2.0, np.array([30.0, 30.0]), 400 * np.eye(2), received_time_s=received_s)
        moved = (tracked(short_walk, fixes=[fix]).position_m != tracked(short_walk).position_m).any(axis=1)
        np.testing.assert_array_equal(moved, known_s >= received_s)


def test_a_fix_waits_for_the_step_that_it_falls_into(short_walk: Recording) -> None:
    block = pdr.merge_streams(short_walk)
    steps = tracked(short_walk).steps
    sensing = pdr.OnlineFilter().config.sensing
    fix_s = float(steps.time_s[12])
    due = fix_s + sensing.step_latency_s + sensing.steps.first_step_s
    early, late = np.searchsorted(block.time_s, [due - 0.15, due + 0.15])
    walk, around, _ = cut(block, [int(early), int(late)])
    online = online_filter("imm")
    push(online, walk)
    before_m = online.position_m
    online.add_fix(PositionFix(fix_s, before_m + 1.0, 0.01 * np.eye(2)))
    np.testing.assert_array_equal(online.position_m, before_m)
    push(online, around)
    assert online.state.waiting_fixes == ()
    assert (online.position_m > before_m + 0.3).all()


@pytest.mark.parametrize("weighting", ["imm", "wc"])
@pytest.mark.parametrize("late_s", [0.0, 5.0])
def test_true_fixes_do_not_move_the_track_however_late_they_come(
    short_walk: Recording, weighting: str, late_s: float
) -> None:
    free = tracked(short_walk, weighting=weighting)
    fixes = [
        PositionFix(t, p, 0.25 * np.eye(2), received_time_s=t + late_s)
        for t, p in zip(free.time_s[5::4], free.position_m[5::4], strict=True)
    ]
    track = tracked(short_walk, weighting=weighting, fixes=fixes)
    error_m = np.linalg.norm(track.position_m - free.position_m, axis=1)
    assert np.sqrt((error_m**2).mean()) < 0.4
    assert not any("not fit the track" in note for note in track.notes)


def test_a_finished_filter_says_so_and_finishes_only_once(short_walk: Recording) -> None:
    block = pdr.merge_streams(short_walk)
    online = online_filter("imm")
    push(online, block)
    online.finish()
    end_m = online.position_m
    assert online.finish() == []
    np.testing.assert_array_equal(online.position_m, end_m)
    with pytest.raises(ValueError, match="finished"):
        push(online, block)


def test_what_a_filter_returns_cannot_be_written_to(short_walk: Recording) -> None:
    online = online_filter("wc")
    update = push(online, pdr.merge_streams(short_walk))[0]
    track = tracked(short_walk)
    for array in (update.position_m, update.mode_prob, update.position_cov_m2, track.position_m, track.mode_prob):
        with pytest.raises(ValueError, match="read-only"):
            array += 1.0


def test_steps_and_windows_of_the_track_are_those_of_detect_steps_and_classify(short_walk: Recording) -> None:
    track, steps, windows = tracked(short_walk), pdr.detect_steps(short_walk), pdr.classify(short_walk)
    of_directions = {n for n in steps.dtype.names if n.startswith(("walking_heading", "shown_offset", "north"))}
    of_directions |= {"offset_change_std_rad", "direction_trust", "carried_since_s", "on_axes", "yaw_bias_std_radps"}
    for name in sorted(set(steps.dtype.names) - of_directions):
        np.testing.assert_array_equal(track.steps[name], steps[name], name)
    assert np.isinf(steps.walking_heading_std_rad).all() and np.isinf(steps.north_std_rad).all()
    np.testing.assert_array_equal(track.windows.time_s, windows.time_s)
    np.testing.assert_array_equal(track.windows.context_prob, windows.context_prob)


@pytest.mark.parametrize("recipe", ["guo2018", "martinelli2018", "susi2013", "tian2016", "zhou2019"])
def test_detect_steps_finds_the_steps_of_the_track_whether_or_not_the_detector_uses_contexts(
    short_walk: Recording, recipe: str
) -> None:
    config = getattr(pdr.recipes, recipe)(short_walk.subject)
    track, steps = pdr.track(short_walk, config), pdr.detect_steps(short_walk, config)
    assert len(steps) > 0
    for name in ("time_s", "detected_time_s", "variance", "vertical_amplitude_mps2", "device_heading_rad", "is_two"):
        np.testing.assert_array_equal(track.steps[name], steps[name], name)


# --- saving ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_a_filter_saved_in_the_middle_of_a_walk_continues_as_if_nothing_had_happened(
    demo: Recording, short_walk: Recording, weighting: str
) -> None:
    # The state of the IMM depends on the whole walk. Boosted trees are saved five times as fast as the default.
    blocks = cut(pdr.merge_streams(demo if weighting == "imm" else short_walk), [1500, 2003, 2007, 9000])
    config = recipes.default(classifier="boosted").with_weighting(weighting)
    expected = stream(pdr.OnlineFilter(config), blocks)
    online, updates = pdr.OnlineFilter(config), []
    for block in blocks:
        online = pdr.OnlineFilter.load(online.save())
        updates += push(online, block)
    assert_same_updates([*updates, *pdr.OnlineFilter.load(online.save()).finish()], expected)


def test_a_filter_saved_while_a_window_waits_loses_no_step() -> None:
    config = recipes.zhou2019()
    walk = simulate([Leg("walking", distance_m=8.0)], seed=4)
    online, updates = pdr.OnlineFilter(config), list[pdr.StepUpdate]()
    for i, block in enumerate(cut(pdr.merge_streams(walk), list(range(0, 9999, 10)))):
        updates += push(online, block)
        if i % 10 == 2:  # most windows of this recipe with a step wait after one of these blocks
            online = pdr.OnlineFilter.load(online.save())
    updates += online.finish()
    np.testing.assert_array_equal([u.step.time_s for u in updates if u.is_final], pdr.track(walk, config).time_s)


def test_saving_changes_nothing_and_loading_gives_an_equal_filter(short_walk: Recording) -> None:
    first, second = cut(pdr.merge_streams(short_walk), [900])
    online = online_filter("wc")
    online.add_fix(PositionFix(15.0, np.zeros(2), np.eye(2)))
    push(online, first)
    blob = online.save()
    loaded = pdr.OnlineFilter.load(blob)
    assert loaded.save() == blob
    assert_same_updates(stream(loaded, [second]), stream(online, [second]))
    assert loaded.notes == online.notes


# --- invariance of the walk -----------------------------------------------------------------------------------------


def test_a_phone_turned_by_180_degrees_about_its_screen_takes_the_same_steps(short_walk: Recording) -> None:
    def turned(samples: Samples | None) -> Samples | None:
        return samples and Samples(samples.time_s, samples.values * [-1.0, -1.0, 1.0])

    names = ("accelerometer", "gyroscope", "magnetometer")
    other = replace(short_walk, **{n: turned(getattr(short_walk, n)) for n in names})
    straight, upside_down = tracked(short_walk), tracked(other)
    np.testing.assert_array_equal(upside_down.time_s, straight.time_s)
    np.testing.assert_allclose(upside_down.step_length_m, straight.step_length_m, atol=1e-3)
    # people hold a phone with its top ahead: it takes a while to see that this one walks the other way
    turned_m = np.linalg.norm(upside_down.position_m - straight.position_m, axis=1)
    assert turned_m.max() < 0.15 * straight.distance_m


def test_where_the_walk_heads_in_the_world_does_not_matter() -> None:
    """The track is relative to the first heading."""
    legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=12.0), Leg("walking", 8.0, turn_rad=-1.0)]
    north, south_west = (tracked(simulate(legs, start_heading_rad=a)) for a in (0.0, -2.5))
    np.testing.assert_allclose(south_west.time_s, north.time_s, atol=1e-6)
    # the noise of the magnetometer is not turned with the walk
    np.testing.assert_allclose(south_west.position_m, north.position_m, atol=0.03)


def test_when_the_walk_began_does_not_matter(short_walk: Recording) -> None:
    late = replace(short_walk, **{n: Samples(s.time_s + 4096.0, s.values) for n, s in short_walk.streams.items()})
    track, late_track = tracked(short_walk), tracked(late)
    np.testing.assert_allclose(late_track.time_s, track.time_s + 4096.0, atol=1e-6)
    np.testing.assert_allclose(late_track.position_m, track.position_m, atol=1e-6)


def test_a_right_turn_of_the_walk_is_a_right_turn_of_the_track() -> None:
    legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=20.0)]
    legs += [Leg("walking", distance_m=20.0, turn_rad=np.pi / 2)]
    track = tracked(simulate(legs))
    headings = track.walking_heading_rad
    assert abs(headings[5:20].mean()) < 0.3
    assert headings[-15:].mean() == pytest.approx(np.pi / 2, abs=0.3)
    east_m, north_m = track.position_m[-1]
    assert (east_m, north_m) == (pytest.approx(20.0, abs=5.0), pytest.approx(20.0, abs=5.0))


# --- what a track says ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_a_track_is_whole_and_in_order(demo: Recording, tracked_demo: Callable[[str], Track], weighting: str) -> None:
    track = tracked_demo(weighting)
    assert (np.diff(track.time_s) > 0).all()
    assert (track.steps.detected_time_s >= track.time_s).all()
    # the gate lets the first steps of each bout go together
    latency_s = track.steps.detected_time_s - track.time_s
    assert np.quantile(latency_s, 0.8) < 1.5
    assert latency_s.max() < 5.0
    np.testing.assert_allclose(track.context_prob.sum(axis=1), 1.0)
    np.testing.assert_allclose(track.mode_prob.sum(axis=1), 1.0)
    assert (track.step_length_m >= 0).all()
    assert np.linalg.eigvalsh(track.position_cov_m2).min() > 0
    # what the imm thinks of a step when it is made is not all that it will know of it
    assert track.distance_m == track.walked_m[-1]
    assert track.distance_m == pytest.approx(track.step_length_m.sum(), rel=0.05 if weighting == "imm" else 1e-9)
    assert (track.start_time_s, track.duration_s) == (0.0, pytest.approx(demo.duration_s))
    assert track.n_steps == pytest.approx(len(demo.truth.steps), rel=0.03)


def test_the_weightings_differ_and_share_their_steps(demo: Recording, tracked_demo: Callable[[str], Track]) -> None:
    imm, wc, hc = map(tracked_demo, WEIGHTINGS)
    np.testing.assert_array_equal(imm.time_s, hc.time_s)
    np.testing.assert_array_equal(wc.time_s, hc.time_s)
    assert imm.distance_m != hc.distance_m
    # WC differs from HC in uncertain windows only, which the default has none of on this walk
    boosted = pdr.recipes.default(demo.subject, classifier="boosted")
    assert len({pdr.track(demo, config=boosted, weighting=w).distance_m for w in ("hc", "wc")}) == 2


# --- recordings with faults -----------------------------------------------------------------------------------------


def keep(samples: Samples, rows: np.ndarray) -> Samples:
    return Samples(samples.time_s[rows], samples.values[rows])


def with_nan(recording: Recording) -> Recording:
    values = recording.accelerometer.values.copy()
    values[1500:1580] = np.nan
    return replace(recording, accelerometer=Samples(recording.accelerometer.time_s, values))


def with_gap(recording: Recording) -> Recording:
    time_s = recording.accelerometer.time_s
    return replace(recording, accelerometer=keep(recording.accelerometer, (time_s < 9.0) | (time_s > 13.0)))


def with_duplicates(recording: Recording) -> Recording:
    rows = np.sort(np.append(np.arange(len(recording.accelerometer)), [400, 400, 1200]))
    return replace(recording, accelerometer=keep(recording.accelerometer, rows))


def without_gyroscope(recording: Recording) -> Recording:
    return replace(recording, gyroscope=None)


def at_50_hz(recording: Recording) -> Recording:
    return replace(recording, **{n: keep(s, np.arange(0, len(s), 2)) for n, s in recording.streams.items()})


FAULTS = {
    with_nan: ("had no finite value", "gap"),
    with_gap: ("1 gap",),
    with_duplicates: ("3 of .* repeated",),
    without_gyroscope: ("no gyroscope",),
    at_50_hz: (),
}


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.__name__)
def test_a_recording_with_faults_is_tracked_and_says_so(short_walk: Recording, fault: object, weighting: str) -> None:
    recording = fault(short_walk)  # type: ignore[operator]
    track = tracked(recording, weighting=weighting)
    n_true = len(short_walk.truth.steps)
    assert 0.7 * n_true <= track.n_steps <= 1.1 * n_true
    assert np.isfinite(track.position_m).all()
    assert np.isfinite(track.position_cov_m2).all()
    text = "\n".join(track.notes)
    for pattern in FAULTS[fault]:  # type: ignore[index]
        assert re.search(pattern, text)
    assert (len(track.notes) > 1) == bool(FAULTS[fault])  # type: ignore[index]
    updates = stream(online_filter(weighting), cut_randomly(pdr.merge_streams(recording), 4))
    assert_updates_are_the_track(updates, track)


def test_all_faults_at_once_are_tracked(short_walk: Recording) -> None:
    recording = short_walk
    for fault in (with_duplicates, with_nan, with_gap, at_50_hz, without_gyroscope):
        recording = fault(recording)
    for weighting in WEIGHTINGS:
        track = tracked(recording, weighting=weighting)
        updates = stream(online_filter(weighting), cut_randomly(pdr.merge_streams(recording), 6))
        assert_updates_are_the_track(updates, track)
    assert len(track.notes) == 6


def test_a_gap_widens_the_covariance_by_what_may_have_been_walked(short_walk: Recording) -> None:
    whole, gap = tracked(short_walk), tracked(with_gap(short_walk))
    after = gap.time_s > 13.0
    assert np.trace(gap.position_cov_m2[after][0]) > np.trace(whole.position_cov_m2[-1]) + 4.0**2
    assert not ((gap.time_s > 9.0) & (gap.time_s < 13.0)).any()


def test_without_a_gyroscope_the_heading_is_said_to_be_unknown(short_walk: Recording) -> None:
    track, blind = tracked(short_walk), tracked(without_gyroscope(short_walk))
    assert (blind.steps.heading_unknown_s > 0).all()
    assert not track.steps.heading_unknown_s.any()
    np.testing.assert_array_equal(blind.time_s, track.time_s)
    assert np.trace(blind.position_cov_m2[-1]) > 5 * np.trace(track.position_cov_m2[-1])


def with_barometer(recording: Recording, climb_rate_mps: float, rate_hz: float = 10.0) -> Recording:
    """The recording with a barometer that climbs steadily, with the noise of a phone's."""
    time_s = np.arange(0.0, recording.duration_s, 1 / rate_hz)
    noise_hpa = 0.01 * np.random.default_rng(0).normal(size=len(time_s))
    pressure = 1013.25 * np.exp(-climb_rate_mps * time_s / 8434.0) + noise_hpa
    return replace(recording, barometer=Samples(time_s, pressure[:, None]))


def test_a_barometer_that_climbs_makes_stairs_more_probable_and_a_level_one_less(short_walk: Recording) -> None:
    plain = pdr.classify(short_walk)
    up, down, level = (pdr.classify(with_barometer(short_walk, rate)) for rate in (0.27, -0.27, 0.0))
    assert np.isnan(plain.climb_rate_mps).all()
    np.testing.assert_allclose(up.climb_rate_mps[3:], 0.27, atol=0.045)  # four standard deviations
    for name, windows in (("upstairs", up), ("downstairs", down)):
        column = plain.contexts.index(name)
        walked = windows.time_s > 6.0
        assert (windows.context_prob[walked, column] > plain.context_prob[walked, column]).all()
        assert (level.context_prob[walked, column] < np.maximum(plain.context_prob[walked, column], 0.01)).all()
    np.testing.assert_allclose(up.context_prob.sum(axis=1), 1.0)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_pressure_pushed_before_the_other_samples_gives_the_same_bits(short_walk: Recording, weighting: str) -> None:
    recording = with_barometer(short_walk, 0.2)
    time_s, pressure = recording.barometer.time_s, recording.barometer.values[:, 0]
    online, updates, given = online_filter(weighting), [], 0
    for block in cut_randomly(pdr.merge_streams(recording), 3):
        upto = int(np.searchsorted(time_s, block.time_s[-1], side="right")) if len(block.time_s) else given
        online.push_pressure(time_s[given:upto], pressure[given:upto])
        given = max(given, upto)
        updates += push(online, block)
    updates += online.finish()
    assert_updates_are_the_track(updates, tracked(recording, weighting=weighting))
    assert len(online.state.waiting_climbs.climbs) < 5


def test_a_barometer_whose_clock_is_ahead_is_told_of_and_does_not_pile_up(short_walk: Recording) -> None:
    online = pdr.OnlineFilter()
    time_s = np.arange(0.0, 1800.0, 0.5)
    online.push_pressure(time_s[:100] + 1e6, np.full(100, 1000.0))
    assert not any("barometer" in note for note in online.notes)
    for part in np.array_split(time_s[100:], 7):
        online.push_pressure(part + 1e6, np.full(len(part), 1000.0))
    assert len(online.state.waiting_climbs.climbs) == MAX_CLIMBS
    assert any("climb rates of the barometer not used, because its times are ahead" in note for note in online.notes)
    assert len(online.save()) < len(pdr.OnlineFilter().save()) + 50_000


def test_pressure_in_pascal_is_refused_and_changes_nothing(short_walk: Recording) -> None:
    online = online_filter("imm")
    with pytest.raises(ValueError, match="divide by 100"):
        online.push_pressure([0.0, 0.1], [101_325.0, 101_320.0])
    assert_updates_are_the_track(stream(online, [pdr.merge_streams(short_walk)]), tracked(short_walk))


@pytest.mark.parametrize("n", [0, 1, 3, 12])
def test_too_few_samples_give_no_steps_and_no_exception(n: int) -> None:
    online = online_filter("imm")
    time_s = np.arange(n) / 100
    force = np.tile([0.0, 0.0, 9.81], (n, 1))
    assert online.push(time_s, force) == []
    assert online.push([], []) == []
    assert online.finish() == []
    np.testing.assert_array_equal(online.position_m, np.zeros(2))
    if n:
        track = tracked(Recording("short", Samples(time_s, force)))
        assert (track.n_steps, track.distance_m) == (0, 0.0)
        assert any("no steps" in note for note in track.notes)


def test_samples_that_are_all_nan_give_no_steps_and_a_note() -> None:
    online = online_filter("wc")
    assert online.push(np.arange(500) / 100, np.full((500, 3), np.nan), np.full((500, 3), np.nan)) == []
    assert online.finish() == []
    assert "500 of 500" in online.notes[0]


def test_pushed_arrays_are_not_modified_and_may_be_overwritten_afterwards(short_walk: Recording) -> None:
    block = pdr.merge_streams(short_walk)
    expected = stream(online_filter("imm"), cut_randomly(block, 9))
    online, updates = online_filter("imm"), []
    for piece in cut_randomly(block, 9):
        names = ("time_s", "specific_force_mps2", "angular_rate_radps", "magnetic_field_ut")
        buffers = [np.array(getattr(piece, name)) for name in names]
        copies = [b.copy() for b in buffers]
        updates += online.push(*buffers)
        for buffer, copy in zip(buffers, copies, strict=True):
            np.testing.assert_array_equal(buffer, copy)
            buffer[...] = 77.0  # an app reuses its buffers
    assert_same_updates([*updates, *online.finish()], expected)


@pytest.mark.recordings
def test_without_a_gyroscope_the_covariance_covers_the_error(data_dir: Path) -> None:
    """The heading is a guess then: the track with gyroscope must lie inside what the filter admits."""
    nees = []
    for path in sorted((data_dir / "humolire").glob("*.zip"))[:4]:
        recording = pdr.read(path)
        seen = tracked(recording)
        blind = tracked(replace(recording, gyroscope=None))
        at = np.column_stack([np.interp(blind.time_s, seen.time_s, seen.position_m[:, k]) for k in (0, 1)])
        error = blind.position_m[50:] - at[50:]
        nees.append(np.einsum("ki,kij,kj->k", error, np.linalg.inv(blind.position_cov_m2[50:]), error).mean())
    assert np.mean(nees) < 6.0


def test_a_recipe_that_needs_a_sensor_says_which_one_is_missing(short_walk: Recording) -> None:
    config = replace(recipes.default(), needs=("gyroscope", "barometer"))
    with pytest.raises(pdr.MissingSensorError, match="has no barometer, which recipe 'default' needs"):
        tracked(short_walk, config)
    assert len(pdr.detect_steps(short_walk, config)) > 0
    assert len(pdr.classify(short_walk, config)) > 0
    assert tracked(short_walk, replace(recipes.default(), needs=("gyroscope",))).n_steps > 0


def test_an_app_gets_the_notes_of_the_whole_recording(short_walk: Recording) -> None:
    """With a rejected fix, a person of unknown height, and a fix that comes too late."""
    walk = short_walk
    stranger = replace(walk, meta={k: v for k, v in walk.meta.items() if k != "subject"})
    fixes = [
        PositionFix(20.0, np.array([900.0, 0.0]), np.eye(2)),
        PositionFix(walk.duration_s + 30.0, np.zeros(2), np.eye(2)),
    ]
    track = pdr.track(stranger, fixes=fixes)
    online = pdr.OnlineFilter()
    for fix in fixes:
        online.add_fix(fix)
    stream(online, [pdr.merge_streams(stranger)])
    assert track.notes == (*stranger.notes, *online.notes)
    for words in ("height is not known", "its time were not used: 1", "after the last sample were not used: 1"):
        assert any(words in note for note in online.notes)


@pytest.mark.parametrize("height_m", [None, 1.60])
def test_an_app_that_knows_as_much_of_a_person_as_the_recording_gives_the_same_track(
    short_walk: Recording, height_m: float | None
) -> None:
    walk = replace(short_walk, meta={**short_walk.meta, "subject": {"height_m": height_m}})
    track, samples = pdr.track(walk), pdr.merge_streams(walk)
    updates = [u for u in stream(pdr.OnlineFilter(height_m=height_m), [samples]) if u.is_final]
    np.testing.assert_array_equal([u.step_length_m for u in updates], track.step_length_m)
    np.testing.assert_array_equal([u.position_cov_m2 for u in updates], track.position_cov_m2)
    stds = [u.speed.smoothed_std_mps for u in updates]
    np.testing.assert_array_equal(stds, track.smoothed_speed_std_mps)
    assert any("height is not known" in note for note in track.notes) == (height_m is None)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_a_weighting_beside_a_configuration_or_none_is_that_of_a_track_with_it(
    short_walk: Recording, weighting: str
) -> None:
    samples = pdr.merge_streams(short_walk)
    for config in (None, recipes.default()):
        updates = [u for u in stream(pdr.OnlineFilter(config, weighting=weighting), [samples]) if u.is_final]
        nobody = replace(short_walk, meta={})
        track = pdr.track(nobody, config, weighting=weighting)
        np.testing.assert_array_equal([u.position_m for u in updates], track.position_m)


def test_pushed_samples_wait_for_a_hop_and_a_reused_buffer_does_not_change_them(short_walk: pdr.Recording) -> None:
    samples = part_of(pdr.merge_streams(short_walk), slice(300, 1300))
    online, buffer = pdr.OnlineFilter(), np.empty((1, 10))
    updates: list[pdr.StepUpdate] = []
    n_processed = set[int]()
    for i in range(1000):
        buffer[0, 0], buffer[0, 1:4] = samples.time_s[i], samples.specific_force_mps2[i]
        buffer[0, 4:7], buffer[0, 7:] = samples.angular_rate_radps[i], samples.magnetic_field_ut[i]
        updates += online.push(buffer[:, 0], buffer[:, 1:4], buffer[:, 4:7], buffer[:, 7:])
        n_processed.add(online._state.sensing.conditioner.report.n_received)
        if i == 505:
            assert online.now().time_s == samples.time_s[i]
    assert len(n_processed) < 400
    assert len(updates) > 3
    whole = pdr.OnlineFilter()
    assert_same_updates(updates, push(whole, samples))
    np.testing.assert_array_equal(online.position_m, whole.position_m)
