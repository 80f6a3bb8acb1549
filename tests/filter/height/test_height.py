"""Heights and storeys of walks with and without a barometer."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cut_randomly, push_part, pushed, true_position_m

import pdr_filter as pdr
from pdr_filter.filter.chain.handler import part_of
from pdr_filter.filter.chain.with_height import HeightTrack
from pdr_filter.filter.height.floor_detection import FloorState, Level, storey_number, with_new_level
from pdr_filter.filter.height.height_filter import unseen_var_m2
from pdr_filter.filter.height.vertical_modes import _TRANSITIONS
from pdr_filter.offline.smoothing.storeys import with_arrivals, with_named_floors
from pdr_filter.simulate import BAROMETER, Leg, SensorErrors, simulate
from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray, ImuBlock, PositionFix, Samples
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

ERRORS = SensorErrors(barometer=BAROMETER)
AROUND = [Leg("walking", distance_m=15.0), Leg("walking", distance_m=15.0, turn_rad=np.pi / 2)]
LANDING = Leg("walking", distance_m=2.0, turn_rad=np.pi)


def storey(context: str) -> list[Leg]:
    """Return 18 steps on stairs, 3.06 m, with a landing."""
    return [Leg(context, distance_m=9 * 0.29), LANDING, Leg(context, distance_m=9 * 0.29)]


def walk(*legs: Leg, carrying_mode: str = "texting", seed: int = 0) -> Recording:
    return simulate([Leg("stationary", duration_s=5.0), *legs], carrying_mode=carrying_mode, errors=ERRORS, seed=seed)


@pytest.fixture(scope="module")
def stairs() -> Recording:
    return walk(*AROUND, *storey("upstairs"), *AROUND, *storey("downstairs"), *AROUND)


@pytest.fixture(scope="module")
def tracked(stairs: Recording) -> Track:
    return pdr.track(stairs)


@pytest.fixture(scope="module")
def in_pocket() -> Recording:
    return walk(*AROUND, *storey("upstairs"), *AROUND, *storey("downstairs"), *AROUND, carrying_mode="pocket")


@pytest.fixture(scope="module")
def level() -> Recording:
    return walk(*AROUND, *AROUND, Leg("stationary", duration_s=20.0), *AROUND)


Change = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def stuck(time_s: FloatArray, hpa: FloatArray) -> tuple[FloatArray, FloatArray]:
    return time_s, np.where(time_s > 60.0, hpa[np.searchsorted(time_s, 60.0)], hpa)


def lost(time_s: FloatArray, hpa: FloatArray) -> tuple[FloatArray, FloatArray]:
    return time_s[time_s < 60.0], hpa[time_s < 60.0]


def rounded(time_s: FloatArray, hpa: FloatArray) -> tuple[FloatArray, FloatArray]:
    return time_s, np.round(hpa)


FAULTS: dict[str, tuple[Change | None, str]] = {
    "missing": (None, "there is no barometer"),
    "lost": (lost, "barometer: no samples since 60.0 s"),
    "stuck": (stuck, "the barometer gave one value for"),
    "rounded": (rounded, "the pressure is rounded to 1 hPa"),
}


def with_pressure(recording: Recording, change: Change) -> Recording:
    assert recording.barometer is not None
    time_s, pressure = change(recording.barometer.time_s, recording.barometer.values[:, 0])
    return replace(recording, barometer=Samples(time_s, pressure[:, None]))


def error_m(track: Track, recording: Recording) -> FloatArray:
    truth = recording.truth.position
    assert truth is not None
    return track.height_m - np.interp(track.time_s, truth.time_s, truth.up_m)


def ways(track: Track) -> list[tuple[int, int, str]]:
    return [(c.from_floor, c.to_floor, c.how) for c in track.floor_changes()]


# --- climbs ---------------------------------------------------------------------------------------------------------


def test_stairs_lead_to_the_next_storey_and_back(stairs: Recording, tracked: Track, in_pocket: Recording) -> None:
    nees: list[float] = []
    for recording, track in ((stairs, tracked), (in_pocket, pdr.track(in_pocket))):
        assert ways(track) == [(0, 1, "stairs"), (1, 0, "stairs")]
        error = error_m(track, recording)
        assert np.sqrt(np.mean(error**2)) < 0.3
        nees.append(np.mean((error / track.height_std_m) ** 2))
        labels = recording.truth.labels
        for change, first, last in zip(track.floor_changes(), (3, 8), (5, 10), strict=True):
            assert change.start_s == pytest.approx(labels.start_s[first], abs=4.0)
            assert change.end_s == pytest.approx(labels.end_s[last], abs=4.0)
        held = {f: track.floor[(track.time_s > a) & (track.time_s < b)] for f, a, b in ((0, 6, 25), (1, 42, 58))}
        assert all((rows == f).all() for f, rows in held.items())
    assert 0.05 < np.mean(nees) < 3.0


def test_a_lift_moves_a_pedestrian_without_steps_by_several_storeys() -> None:
    ride = [Leg("stationary", duration_s=8.0), Leg("stationary", duration_s=11.0, ride_up_m=9.9)]
    recording = walk(*AROUND, *ride, Leg("stationary", duration_s=3.0), *AROUND)
    track = pdr.track(recording)
    assert ways(track) == [(0, 3, "lift")]
    assert set(track.floor) == {0, 3}
    assert abs(error_m(track, recording)[-1]) < 0.5


def test_the_present_height_follows_a_lift_before_the_next_step() -> None:
    recording = walk(*AROUND, Leg("stationary", duration_s=12.0, ride_up_m=10.0), Leg("stationary", duration_s=4.0))
    assert recording.barometer is not None
    online = pdr.OnlineFilter()
    online.push_pressure(recording.barometer.time_s, recording.barometer.values[:, 0])
    block = pdr.merge_streams(recording)
    updates = online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps)
    assert updates[-1].height_m == pytest.approx(0.0, abs=0.3)
    assert online.height_m == pytest.approx(10.0, abs=0.5)
    assert online.floor == 3
    assert 0.0 < online.height_std_m < 0.7


def test_a_lift_that_stops_between_storeys_is_one_ride() -> None:
    stop = [Leg("stationary", duration_s=6.0, ride_up_m=4.9), Leg("stationary", duration_s=40.0)]
    rest = [Leg("stationary", duration_s=4.0, ride_up_m=1.7), Leg("stationary", duration_s=3.0)]
    recording = walk(*AROUND, Leg("stationary", duration_s=5.0), *stop, *rest, *AROUND)
    track = pdr.track(recording)
    assert ways(track) == [(0, 2, "lift")]
    assert abs(error_m(track, recording)[-1]) < 0.5


@pytest.mark.parametrize("up_m", [4.0, -4.0])
def test_an_escalator_is_recognised_by_its_slow_climb(up_m: float) -> None:
    recording = walk(*AROUND, Leg("stationary", duration_s=13.0, ride_up_m=up_m, ride_m=7.0), *AROUND)
    track = pdr.track(recording)
    assert ways(track) == [(0, int(np.sign(up_m)), "escalator")]
    assert abs(error_m(track, recording)[-1]) < 0.5


def test_a_hill_changes_the_height_and_not_the_storey(level: Recording) -> None:
    """A slope of 5 % for a minute leads 4 m up, more than a storey."""
    hill = with_pressure(level, lambda t, p: (t, p - 0.065 / 8.32 * np.clip(t - 10.0, 0.0, 30.0)))
    track = pdr.track(hill)
    assert track.height_m[-1] == pytest.approx(1.95, abs=0.6)
    assert ways(track) == []


def located(recording: Recording, accuracy_m: float) -> Recording:
    """Return the recording with its true positions as locations, one a second."""
    truth = recording.truth.position
    assert truth is not None
    time_s = np.arange(0.5, float(truth.time_s[-1]), 1.0)
    degrees = true_position_m(recording, time_s).T / 111_195.0
    rows = [degrees[1], degrees[0], np.zeros(len(time_s)), np.full(len(time_s), accuracy_m)]
    return replace(recording, location=Samples(time_s, np.column_stack(rows)))


@pytest.fixture(scope="module")
def hill() -> Recording:
    """A slope of 15 % for 25 s, which pressure alone cannot distinguish from stairs."""
    recording = walk(Leg("walking", distance_m=70.0))
    return with_pressure(recording, lambda t, p: (t, p - 0.2 / 8.32 * np.clip(t - 15.0, 0.0, 25.0)))


def test_a_climb_with_a_long_displacement_of_accurate_locations_is_a_hill(hill: Recording) -> None:
    plain, outdoors = pdr.track(hill), pdr.track(located(hill, 5.0))
    assert ways(plain) == [(0, 1, "stairs")]
    assert ways(outdoors) == []
    assert outdoors.floor[-1] == 0
    assert outdoors.height_m[-1] == pytest.approx(plain.height_m[-1], abs=0.3)
    assert outdoors.height_m[-1] > 4.0


def test_only_accurate_locations_identify_hills_and_stairs_stay_stairs(hill: Recording, stairs: Recording) -> None:
    assert ways(pdr.track(located(hill, 30.0))) == [(0, 1, "stairs")]
    assert ways(pdr.track(located(hill, 5.0), gnss="align")) == []
    assert ways(pdr.track(located(stairs, 5.0))) == [(0, 1, "stairs"), (1, 0, "stairs")]


def test_a_smoothed_hill_never_changes_the_storey(hill: Recording) -> None:
    track = pdr.smooth(located(hill, 5.0)).track
    assert ways(track) == []
    assert set(track.floor) == {0}


def test_a_smoothed_walk_changes_the_storey_only_during_its_floor_changes(tracked: Track) -> None:
    floor = tracked.floor.copy()
    floor[[3, -3]] = 5
    np.testing.assert_array_equal(with_arrivals(replace(tracked, floor=floor)).floor, tracked.floor)


def test_a_fix_after_the_last_step_numbers_the_storey_of_the_last_step(tracked: Track) -> None:
    fixes = [PositionFix(time_s, np.zeros(2), np.eye(2), floor=floor) for time_s, floor in ((0.0, 3), (1e6, 4))]
    named = with_named_floors(tracked, fixes)
    np.testing.assert_array_equal(named.floor[:-1], tracked.floor[:-1] - tracked.floor[0] + 3)
    assert named.floor[-1] == 4


def test_probabilities_of_the_next_vertical_mode_sum_to_one() -> None:
    np.testing.assert_allclose(_TRANSITIONS.sum(axis=1), 1.0, atol=1e-12)


def test_hills_do_not_depend_on_the_blocks_of_samples_and_locations(hill: Recording) -> None:
    recording = located(hill, 5.0)
    block, location, pressure = pdr.merge_streams(recording), recording.location, recording.barometer
    assert location is not None and pressure is not None
    floors = list[list[int]]()
    for seconds in (0.7, 3.1):
        online, found = pdr.OnlineFilter(pdr.recipes.default().in_world_frame()), list[int]()
        for begin_s in np.arange(0.0, block.time_s[-1], seconds):
            rows = [(s.time_s >= begin_s) & (s.time_s < begin_s + seconds) for s in (location, pressure, block)]
            latitude_deg, longitude_deg, _, accuracy_m = location.values[rows[0]].T
            online.push_location(location.time_s[rows[0]], latitude_deg, longitude_deg, accuracy_m)
            online.push_pressure(pressure.time_s[rows[1]], pressure.values[rows[1], 0])
            found += [u.floor for u in push_part(online, block, rows[2])]
        floors.append(found + [u.floor for u in online.finish()])
        assert len(part_of(online.state.chain, HeightTrack).locations) <= 26
    assert floors[0] == floors[1]
    assert floors[0][-1] == 0


# --- pressure changes without a climb -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        lambda t, p: (t, p),
        lambda t, p: (t, p + 0.3 * (t > 20.0)),  # a door
        lambda t, p: (t, p - 0.4 * ((t > 20.0) & (t < 23.0))),  # a door that slams
        lambda t, p: (t, p + 2.0 * t / 3600),  # weather
        lambda t, p: (t[::10], np.round(p[::10], 1)),  # 1 Hz, steps of 0.1 hPa: 0.8 m
        lambda t, p: (t, np.where(t % 7.0 < 0.1, np.nan, p)),
        lambda t, p: (t, p + 50.0 * (np.abs(t - 20.0) < 0.05)),  # a failed reading
        lambda t, p: (t[(t < 10.0) | (t > 30.0)], p[(t < 10.0) | (t > 30.0)] - 0.05),
        lambda t, p: (np.where(t > 30.0, t - 20.0, t), p),  # a clock that is set back
        lambda t, p: (t[:1], p[:1]),
    ],
)
def test_nothing_but_climbing_changes_the_storey(level: Recording, change: Change) -> None:
    track = pdr.track(with_pressure(level, change))
    assert set(track.floor) == {0}
    assert track.floor_changes() == []
    assert np.abs(track.height_m).max() < 1.0
    assert np.isfinite(track.height_std_m).all()


@pytest.mark.parametrize("hpa_s", [(-10.0, 300.0), (-50.0, 300.0)])
def test_the_pressure_of_an_aircraft_cabin_is_not_a_lift(hpa_s: tuple[float, float]) -> None:
    """The pressure changes by 10 hPa while the phone lies still or is carried, and a note says so."""
    hpa, seconds = hpa_s
    recording = walk(*AROUND, Leg("stationary", duration_s=seconds + 20.0), *AROUND)
    cabin = with_pressure(recording, lambda t, p: (t, p + hpa * np.clip((t - 35.0) / seconds, 0.0, 1.0)))
    track = pdr.track(cabin)
    assert ways(track) == []
    assert set(track.floor) == {0}
    assert np.abs(track.height_m).max() < 1.0
    assert any("without a climb" in note for note in track.notes)


# --- with less ------------------------------------------------------------------------------------------------------


def test_without_a_barometer_steps_on_stairs_climb_by_their_treads(in_pocket: Recording) -> None:
    track = pdr.track(replace(in_pocket, barometer=None))
    assert ways(track) == [(0, 1, "stairs"), (1, 0, "stairs")]
    error = error_m(track, in_pocket)
    assert np.abs(error).max() < 1.0
    assert np.mean((error / track.height_std_m) ** 2) < 3.0


def test_without_information_the_height_stays_zero_and_its_variance_grows(stairs: Recording) -> None:
    """Stairs with the phone in the hand cannot be recognised from motion alone."""
    track = pdr.track(replace(stairs, barometer=None))
    assert np.abs(track.height_m).max() < 0.5
    assert set(track.floor) == {0}
    assert (np.diff(track.height_std_m) > 0).all()
    assert track.height_std_m[-1] > 1.0


def test_the_deviation_holds_the_storeys_that_were_climbed_with_the_phone_in_the_hand() -> None:
    for context, n_storeys in (("upstairs", 10), ("downstairs", 3), ("walking", 0)):
        legs = [Leg("walking", distance_m=20.0)]
        for _ in range(max(n_storeys, 4)):
            legs += [*storey(context), Leg("walking", distance_m=4.0, turn_rad=1.5)]
        recording = replace(walk(*legs), barometer=None)
        track = pdr.track(recording)
        error = error_m(track, recording)
        assert (np.abs(error) < 3.2 * track.height_std_m).all()
        assert track.height_std_m[-1] < 16.0
        assert any(str(note).startswith("height and storey are unknown") for note in track.notes)
        assert track.known_floor[-1] is None


def test_a_barometer_that_begins_after_unseen_stairs_does_not_tell_the_storey() -> None:
    """The person then climbs and descends a storey, and is on the first storey, not at the start."""
    up, down = storey("upstairs"), storey("downstairs")
    recording = walk(*AROUND, *up, *AROUND, *up, *AROUND, *down, *AROUND)
    truth = recording.truth.position
    first_s = truth.time_s[np.argmax(truth.up_m > 3.0)] + 5.0
    track = pdr.track(with_pressure(recording, lambda time_s, hpa: (time_s[time_s > first_s], hpa[time_s > first_s])))
    assert (np.abs(error_m(track, recording)) < 3.0 * track.height_std_m).all()
    assert track.known_floor[-1] is None
    (note,) = (note for note in track.notes if "barometer" in note or "pressure" in note)
    assert note.startswith("barometer: no samples before") and "heights and storeys are uncertain" in note


@pytest.mark.parametrize(("fault", "words"), FAULTS.values(), ids=FAULTS.keys())
def test_the_deviation_on_a_real_walk_holds_what_a_faulty_barometer_does_not_show(
    fault: Change | None, words: str, data_dir: Path
) -> None:
    recording = replace(pdr.read(data_dir / "ipin2023" / "ipin2023_anon_trial51_rep02.zip"), location=None)
    given = replace(recording, barometer=None) if fault is None else with_pressure(recording, fault)
    track = pdr.track(given)
    points = recording.truth.waypoints
    assert points is not None
    true_m = np.array([recording.meta["floor_heights_m"][f"{floor:g}"] for floor in points.floor])
    k = np.clip(np.searchsorted(track.time_s, points.time_s), 0, track.n_steps - 1)
    assert (np.abs(track.height_m[k] - (true_m - true_m[0])) < 3.0 * track.height_std_m[k]).all()
    (note,) = (note for note in track.notes if "barometer" in note or "pressure" in note)
    assert words in note


def test_unseen_stairs_vary_like_a_direction_that_is_slowly_forgotten() -> None:
    rng, n_steps, n_walks = np.random.default_rng(0), 300, 4000
    # with the correlation exp(-k / 66), the direction is drawn again with the probability 1 - exp(-1 / 66) a step
    direction, height_m = rng.choice([-1, 0, 1], (n_walks,), p=[0.08, 0.84, 0.08]), np.zeros((n_steps, n_walks))
    for k in range(n_steps):
        again = rng.random(n_walks) > np.exp(-1 / 66)
        direction = np.where(again, rng.choice([-1, 0, 1], (n_walks,), p=[0.08, 0.84, 0.08]), direction)
        height_m[k] = (height_m[k - 1] if k else 0.0) + 0.17 * direction
    for k in (10, 60, 299):
        assert unseen_var_m2(k + 1) == pytest.approx(height_m[k].var(), rel=0.1)


def test_two_given_storeys_measure_the_climb_between_them(stairs: Recording) -> None:
    recording = replace(stairs, barometer=None)
    fixes = [PositionFix(t, np.zeros(2), 1e4 * np.eye(2), floor=floor) for t, floor in ((8.0, 3), (40.0, 5))]
    track = pdr.track(recording, fixes=fixes)
    after = np.searchsorted(track.time_s, 42.0)
    assert track.floor[after] == 5
    assert track.height_m[after] == pytest.approx(2 * 3.8, abs=2.0)
    assert track.height_std_m[after] < 2.0
    assert track.floor[np.searchsorted(track.time_s, 12.0)] == 3


def test_a_given_storey_that_the_barometer_contradicts_leaves_the_height(stairs: Recording, tracked: Track) -> None:
    fixes = [PositionFix(t, np.zeros(2), 1e4 * np.eye(2), floor=floor) for t, floor in ((8.0, 3), (14.0, 8))]
    with_fixes = pdr.track(stairs, fixes=fixes)
    np.testing.assert_allclose(with_fixes.height_m, tracked.height_m, atol=0.05)
    assert with_fixes.floor[np.searchsorted(with_fixes.time_s, 15.0)] == 8


def test_an_unknown_storey_is_given_as_unknown(tracked: Track, tmp_path: Path) -> None:
    vague = replace(tracked, height_std_m=np.full(tracked.n_steps, 5.0))
    assert (tracked.floor_prob > 0.99).all()
    assert (vague.floor_prob < 0.5).all()
    assert (tracked.summary()["end_floor"], vague.summary()["end_floor"]) == (0, None)
    rows = np.genfromtxt(vague.to_csv(tmp_path / "track.csv"), delimiter=",", names=True)
    assert np.isnan(rows["floor"]).all()
    floors = json.loads(vague.to_geojson(tmp_path / "track.geojson", origin=(48.0, 11.0)).read_text())
    assert set(floors["features"][0]["properties"]["floor"]) == {None}


def test_pressure_that_begins_late_or_ends_early_is_used_for_its_own_time(stairs: Recording) -> None:
    late = pdr.track(with_pressure(stairs, lambda t, p: (t[t > 48.0], p[t > 48.0])))
    early = pdr.track(with_pressure(stairs, lambda t, p: (t[t < 48.0], p[t < 48.0])))
    assert ways(late) == [(0, -1, "stairs")]
    assert ways(early) == [(0, 1, "stairs")]


def test_a_fix_with_a_storey_renumbers_all_storeys(stairs: Recording) -> None:
    fix = PositionFix(10.0, np.array([0.0, 5.0]), 9.0 * np.eye(2), floor=4)
    track = pdr.track(stairs, fixes=[fix])
    assert track.floor[0] == 0
    assert ways(track) == [(4, 5, "stairs"), (5, 4, "stairs")]
    assert track.floor[-1] == 4


def test_a_storey_of_a_rejected_fix_is_not_used(stairs: Recording) -> None:
    track = pdr.track(stairs, fixes=[PositionFix(15.0, np.array([0.0, 900.0]), np.eye(2), floor=4)])
    assert track.floor.max() == 1


# --- online and offline ---------------------------------------------------------------------------------------------


def blocks_of(recording: Recording, seed: int) -> list[ImuBlock]:
    return cut_randomly(pdr.merge_streams(recording), seed, mean_length=150)


@pytest.mark.parametrize(("weighting", "rate"), [("imm", 1), ("wc", 10)])
def test_heights_do_not_depend_on_the_blocks_of_samples_and_pressure(
    stairs: Recording, weighting: str, rate: int
) -> None:
    """Pressure arrives in separate blocks before the samples, and the filter is saved and loaded in between."""
    recording = with_pressure(stairs, lambda t, p: (t[:: 10 // rate], p[:: 10 // rate]))
    assert recording.barometer is not None
    time_s, pressure = recording.barometer.time_s, recording.barometer.values[:, 0]
    config = pdr.recipes.default(recording.subject).with_weighting(weighting)
    whole = pdr.track(recording, config)
    rng = np.random.default_rng(4)
    given = 0

    def push_pressure(online: pdr.OnlineFilter, until_s: float) -> None:
        nonlocal given
        upto = max(given, int(np.searchsorted(time_s, until_s, side="right")))
        for part in np.split(np.arange(given, upto), np.sort(rng.integers(0, 5, 2))):
            online.push_pressure(time_s[part], pressure[part])
        given = upto

    online, updates = pushed(pdr.OnlineFilter(config), blocks_of(recording, 2), push_pressure, n_resumed=4)
    updates = [u for u in updates if u.is_final]
    np.testing.assert_array_equal([u.height_m for u in updates], whole.height_m)
    np.testing.assert_array_equal([u.height_std_m for u in updates], whole.height_std_m)
    np.testing.assert_array_equal([u.floor for u in updates], whole.floor)
    assert online.floor == whole.floor[-1]


def test_a_smoothed_track_has_the_heights_of_the_filter(stairs: Recording) -> None:
    smoothed = pdr.smooth(stairs).track
    assert ways(smoothed) == [(0, 1, "stairs"), (1, 0, "stairs")]
    assert smoothed.height_m.shape == smoothed.time_s.shape


# --- storeys --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("climbed_m", "floor"), [(2.6, 1), (5.5, 1), (-3.2, -1), (1.5, 0), (11.4, 3)])
def test_any_plausible_storey_height_counts_as_one_storey_in_an_unknown_building(climbed_m: float, floor: int) -> None:
    assert round(storey_number(FloorState().levels, climbed_m)) == floor


def test_visited_storeys_determine_the_height_of_the_next_one() -> None:
    low = (Level(0, 0.0, 0.1), Level(1, 2.7, 0.1), Level(2, 5.4, 0.1))
    assert storey_number(low, 1.35) == pytest.approx(0.5)
    assert storey_number(low, 5.4 + 0.5 * (3.8 + 2 * 2.7) / 3) == pytest.approx(2.5)
    assert storey_number(low, -1.0) == pytest.approx(-1.0 / ((3.8 + 2 * 2.7) / 3))


def test_a_landing_is_never_a_storey_however_long_the_stay_nor_is_a_stay_without_steps() -> None:
    at_landing = FloorState(floor=1, level_since_s=0.0, n_level_steps=20)
    assert with_new_level(at_landing, 60.0, 1.9, 0.1).levels == FloorState().levels
    assert [level.floor for level in with_new_level(at_landing, 60.0, 3.0, 0.1).levels] == [0, 1]
    assert len(with_new_level(replace(at_landing, n_level_steps=0), 60.0, 3.0, 0.1).levels) == 1
