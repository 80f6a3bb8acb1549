from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from pdr_filter.simulate import Gait, Leg, SensorErrors, demo_walk, phone_motion, simulate, walk
from pdr_filter.simulate.gait import nominal_step
from pdr_filter.simulate.motion import CARRYING, build_motion, leg_strides
from pdr_filter.simulate.sensors import BIASES_AT_REST_RADPS
from pdr_filter.simulate.strides import of_person, strides_in
from pdr_filter.values import CONTEXTS, STANDARD_GRAVITY_MPS2
from pdr_filter.values.recording import Recording


@pytest.fixture(autouse=True)
def _motions_afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """`tests/conftest.py` stores them for the tests of other things."""
    monkeypatch.setattr(walk, "build_motion", build_motion)


CARRYING_MODES = ("texting", "pocket", "swinging", "calling")
RIGHT = np.pi / 2
ALL_CONTEXTS = [
    Leg("stationary", duration_s=3.0),
    Leg("walking", distance_m=12.0),
    Leg("upstairs", distance_m=2.9, turn_rad=RIGHT),
    Leg("downstairs", distance_m=2.9, turn_rad=-RIGHT),
    Leg("sideways", duration_s=5.0),
    Leg("running", distance_m=15.0, turn_rad=2.0, curve=True),
    Leg("stationary", duration_s=3.0),
]


@pytest.fixture(scope="module")
def demo() -> Recording:
    return demo_walk()


def path_m(recording: Recording) -> np.ndarray:
    position = recording.truth.position
    assert position is not None
    return np.column_stack([position.east_m, position.north_m])


def norms(samples: np.ndarray) -> np.ndarray:
    return np.linalg.norm(samples, axis=1)


@pytest.mark.parametrize("mode", CARRYING_MODES)
def test_error_free_angular_rate_integrates_to_the_attitude(mode: str) -> None:
    motion = phone_motion(ALL_CONTEXTS, carrying_mode=mode, seed=3)
    gyroscope = simulate(ALL_CONTEXTS, carrying_mode=mode, seed=3, rate_hz=500, errors=SensorErrors.none()).gyroscope
    assert gyroscope is not None
    # The rate in the middle of an interval turns its beginning into its end (second order).
    half_s = 0.001
    attitude = motion.rotation(gyroscope.time_s[:1] - half_s)[0]
    for turn in Rotation.from_rotvec(gyroscope.values * 2 * half_s):
        attitude = attitude * turn
    expected = motion.rotation(gyroscope.time_s[-1:] + half_s)[0]
    assert (expected.inv() * attitude).magnitude() < 2e-4


@pytest.mark.parametrize("mode", CARRYING_MODES)
def test_error_free_specific_force_integrates_twice_to_the_position(mode: str) -> None:
    motion = phone_motion(ALL_CONTEXTS, carrying_mode=mode, seed=4)
    force = simulate(ALL_CONTEXTS, carrying_mode=mode, seed=4, rate_hz=500, errors=SensorErrors.none()).accelerometer
    t = force.time_s
    acceleration = motion.rotation(t).apply(force.values.copy()) - [0.0, 0.0, STANDARD_GRAVITY_MPS2]
    around = motion.position_m(t[0] + np.array([-1e-3, 0.0, 1e-3]))
    start_mps = (around[2] - around[0]) / 2e-3
    velocity = start_mps + cumulative_simpson(acceleration, x=t, axis=0, initial=0)
    position = around[1] + cumulative_simpson(velocity, x=t, axis=0, initial=0)
    np.testing.assert_allclose(position, motion.position_m(t), atol=0.02)


def test_a_phone_held_for_reading_feels_gravity_on_y_and_z_and_one_in_the_pocket_on_minus_y() -> None:
    at_rest = [Leg("stationary", duration_s=5)]
    texting, pocket = (
        simulate(at_rest, carrying_mode=mode, errors=SensorErrors.none()).accelerometer.values.mean(axis=0)
        / STANDARD_GRAVITY_MPS2
        for mode in ("texting", "pocket")
    )
    tilt_rad = Gait().tilt_rad
    np.testing.assert_allclose(texting, [0.0, np.sin(tilt_rad), np.cos(tilt_rad)], atol=0.02)
    np.testing.assert_allclose(pocket, [0.0, -1.0, 0.0], atol=0.02)


def test_nothing_moves_but_the_hand_while_stationary(demo: Recording) -> None:
    truth = demo.truth
    assert truth.labels is not None and truth.position is not None
    for row in truth.labels[truth.labels.context == "stationary"]:
        inside = (truth.position.time_s >= row.start_s) & (truth.position.time_s <= row.end_s)
        assert np.ptp(path_m(demo)[inside], axis=0).max() < 1e-5


def test_a_person_who_stops_stands_still_with_the_phone() -> None:
    legs = [Leg("walking", distance_m=8), Leg("stationary", duration_s=3), Leg("walking", distance_m=8)]
    motion = phone_motion(legs, seed=1)
    t = np.arange(motion.plan.leg_start_s[1] + 0.25, motion.plan.leg_end_s[1], 0.01)
    assert np.ptp(motion.position_m(t), axis=0).max() < 0.01


def test_the_body_never_changes_speed_at_once() -> None:
    motion = phone_motion(ALL_CONTEXTS, seed=2)
    velocity_mps = np.diff(motion.body_position_m, axis=0) / np.diff(motion.grid_s)[:, None]
    assert np.abs(np.diff(velocity_mps, axis=0)).max() < 0.03  # 30 m/s2 on the grid of 1 kHz


def test_a_phone_held_for_reading_is_ahead_of_the_person() -> None:
    motion = phone_motion([Leg("walking", distance_m=10.0)], start_heading_rad=1.0)
    ahead = (motion.position_m(motion.grid_s) - motion.body_position_m)[:, :2].mean(axis=0)
    np.testing.assert_allclose(ahead, 0.19 * Gait().height_m * np.array([np.sin(1.0), np.cos(1.0)]), atol=0.01)


def test_the_number_of_steps_is_the_number_of_contacts_and_of_ups_and_downs() -> None:
    legs = [Leg("stationary", duration_s=2), Leg("walking", distance_m=30), Leg("stationary", duration_s=2)]
    recording = simulate(legs, seed=5)
    truth = recording.truth
    assert truth.steps is not None and truth.segments is not None
    assert len(truth.steps) == truth.segments.n_steps.sum()
    t = np.arange(0.0, recording.duration_s, 0.01)
    steady = {"texting": replace(CARRYING["texting"], loose=0.0, tremor=0.0)}
    height = phone_motion(legs, seed=5, carrying=steady).position_m(t)[:, 2]
    lowest, _ = find_peaks(-height, prominence=0.01, distance=25)
    assert abs(len(lowest) - len(truth.steps)) <= 1


def test_in_the_pocket_every_contact_is_felt_and_those_of_the_own_foot_most() -> None:
    recording = simulate([Leg("walking", duration_s=20)], carrying_mode="pocket", seed=6)
    steps = recording.truth.steps
    assert steps is not None
    force = recording.accelerometer
    strength = []
    for contact_s in steps.time_s[3:-3]:
        around = np.abs(force.time_s - contact_s) < 0.25
        strongest_s = force.time_s[around][np.argmax(norms(force.values[around]))]
        assert abs(strongest_s - contact_s) < 0.13
        strength.append(norms(force.values[around]).max())
    # the right foot, whose pocket it is, lands at even numbers of steps: the fourth contact of the walk is one
    assert np.median(strength[0::2]) > 1.3 * np.median(strength[1::2])


def test_the_vertical_force_of_the_steps_is_highest_just_after_the_contacts() -> None:
    walk, steady = [Leg("walking", duration_s=20)], replace(CARRYING["texting"], loose=0.0, tremor=0.0)
    motion = phone_motion(walk, carrying={"texting": steady})
    between = motion.plan.contact_s[4:-4]
    for contact_s, next_s in pairwise(between):
        t = np.linspace(contact_s, next_s, 50, endpoint=False)
        up = motion.spline(t, 2)[:, 2]
        phase = np.angle((up * np.exp(-2j * np.pi * np.arange(50) / 50)).sum())
        assert phase == pytest.approx(-2 * np.pi * 0.03, abs=0.15)


def test_who_takes_longer_steps_pushes_harder_as_the_law_of_the_step_length_says() -> None:
    def force(frequency_factor: float) -> tuple[float, float, float]:
        leg = Leg("walking", duration_s=10.0, frequency_factor=frequency_factor)
        frequency_hz, length_m = nominal_step(leg, Gait())
        force = leg_strides(leg, CARRYING["calling"], Gait()).people[0, 1, 2]
        return frequency_hz, length_m, abs(force) * (2 * np.pi * frequency_hz) ** 2

    (f_0, length_0, a_0), (f_1, length_1, a_1) = force(0.8), force(1.1)
    assert length_1 / length_0 == pytest.approx((f_1 * a_1 / (f_0 * a_0)) ** 0.25, rel=1e-6)
    assert length_1 == pytest.approx(0.293 * Gait().height_m * (f_1 * a_1) ** 0.25, rel=0.03)


@pytest.mark.parametrize("mode", CARRYING_MODES)
def test_a_carried_phone_is_pushed_forward_as_the_body_rises(mode: str) -> None:
    """The push has step frequency and, but for a swinging arm, the phase by which walking headings are learnt."""
    strides = of_person(CARRYING[mode].strides, "walking", None, 1.0).people[0]
    forward, up = strides[1, 1], strides[1, 2]
    if mode == "swinging":  # higher in front
        assert np.real(strides[0, 1] * np.conj(strides[0, 2])) > 0
        assert abs(strides[0, 1]) > 3 * abs(forward)
    else:
        assert 20 < np.degrees(np.angle(forward / up)) < 150
    right = strides[1, 0]
    assert np.real(right / up * np.exp(-1j * np.radians(85))) == pytest.approx(0.0, abs=0.25)


def test_left_is_the_mirror_of_right() -> None:
    right, left = (of_person("pocket", "walking", 5, side).people[0] for side in (1.0, -1.0))
    half_later = np.where(np.arange(1, 21) % 2 == 1, -1.0, 1.0)[:, None]
    np.testing.assert_allclose(left, right * half_later * [-1, 1, 1, 1, -1, -1])


@pytest.mark.parametrize("context", ["walking", "upstairs", "downstairs", "sideways", "running"])
@pytest.mark.parametrize("place", ["texting", "calling", "swinging", "pocket", "back_pocket"])
def test_there_are_strides_of_every_context_in_every_place(place: str, context: str) -> None:
    strides = strides_in(place, context)
    assert np.isfinite(strides.people).all() and np.isfinite(strides.ways).all()
    assert (strides.amplitude_mps2 > 0.5).all()
    np.testing.assert_allclose(np.median(np.abs(strides.people[:, 1, 2])), 1.0, rtol=0.15)


def test_people_are_drawn_around_those_measured_and_further_apart() -> None:
    table = strides_in("pocket", "walking")
    drawn = np.array([of_person("pocket", "walking", habit, 1.0).people[0] for habit in range(300)])
    measured = np.linalg.norm((table.people - table.people.mean(axis=0)).reshape(len(table.people), -1), axis=1)
    spread = np.linalg.norm((drawn - drawn.mean(axis=0)).reshape(300, -1), axis=1)
    assert 1.03 < np.sqrt((spread**2).mean() / (measured**2).mean()) < 1.2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_length_of_the_true_path_is_the_sum_of_the_step_lengths(seed: int) -> None:
    truth = simulate(ALL_CONTEXTS, Gait.random(seed), seed=seed).truth
    assert truth.segments is not None and truth.position is not None
    path = np.column_stack([truth.position.east_m, truth.position.north_m])
    assert norms(np.diff(path, axis=0)).sum() == pytest.approx(truth.segments.distance_m.sum(), rel=1e-3)
    walking = truth.position.time_s <= truth.segments.end_s[1] + 0.01
    assert norms(np.diff(path[walking], axis=0)).sum() == pytest.approx(12.0, abs=0.03)


def test_at_every_contact_the_person_has_walked_the_steps_so_far() -> None:
    legs = [Leg("stationary", duration_s=2.0), Leg("walking", distance_m=10.0), Leg("running", distance_m=10.0)]
    motion = phone_motion(legs, seed=9)
    north_m = motion.body_at(motion.plan.contact_s)[:, 1]
    np.testing.assert_allclose(north_m, np.cumsum(motion.plan.length_m), atol=1e-3)


def test_the_person_covers_the_length_of_a_stride_between_its_contacts() -> None:
    truth = simulate([Leg("walking", distance_m=25.0)], seed=8).truth
    assert truth.strides is not None and truth.position is not None
    north = np.interp([truth.strides.start_s, truth.strides.end_s], truth.position.time_s, truth.position.north_m)
    np.testing.assert_allclose(north[1] - north[0], truth.strides.length_m, atol=2e-3)


def test_a_leg_keeps_its_distance_or_its_duration() -> None:
    segments = simulate([Leg("walking", distance_m=17.3), Leg("running", duration_s=6.2)], seed=1).truth.segments
    assert segments is not None
    assert segments.distance_m[0] == pytest.approx(17.3)
    assert segments.end_s[1] - segments.start_s[1] == pytest.approx(6.2)


def test_the_demo_walk_has_all_contexts_that_models_know_and_ends_near_its_start_after_two_minutes(
    demo: Recording,
) -> None:
    assert demo.truth.labels is not None and demo.truth.waypoints is not None
    assert set(demo.truth.labels.context) == set(CONTEXTS) - {"sideways"}
    assert set(demo.truth.labels.carrying_mode) == {"pocket"}
    assert 100 < demo.duration_s < 140
    end = demo.truth.waypoints[-1]
    assert np.hypot(end.east_m, end.north_m) < 2.0
    assert end.floor == 0 and demo.truth.waypoints.floor.max() == 1


def test_the_demo_walk_of_another_seed_has_another_person_and_another_phone(demo: Recording) -> None:
    other = demo_walk(1)
    assert other.subject.height_m != demo.subject.height_m
    still_radps = [walk.gyroscope.values[walk.gyroscope.time_s < 4.0].mean(axis=0) for walk in (demo, other)]
    assert np.abs(still_radps[0] - still_radps[1]).max() > 5e-4


def test_a_leg_of_the_demo_walk_deviates_from_its_corridor_and_not_from_the_leg_before() -> None:
    turns_rad = np.array([[leg.turn_rad for leg in walk.demo_legs(seed) if leg.turn_rad] for seed in range(400)])
    direction_rad = np.cumsum(turns_rad, axis=1)
    deviation_rad = direction_rad - RIGHT * np.round(direction_rad / RIGHT)
    # 95 % bounds of a standard deviation of 400 values are 7 % apart from it; all four legs stay within twice that
    np.testing.assert_allclose(deviation_rad.std(axis=0), walk.LEG_STD_RAD, rtol=0.14)
    correlation = np.corrcoef(deviation_rad.T)
    assert np.abs(correlation - np.eye(4)).max() < 0.2


def test_a_random_phone_has_the_bias_of_a_real_one_and_else_the_errors_of_the_typical_phone() -> None:
    phones, typical = [SensorErrors.random(seed) for seed in range(200)], SensorErrors()
    assert {phone.gyroscope.bias_std for phone in phones} == set(BIASES_AT_REST_RADPS)
    for phone in phones:
        gyroscope = replace(phone.gyroscope, bias_std=typical.gyroscope.bias_std)
        assert replace(phone, gyroscope=gyroscope) == typical


def test_meta_says_that_it_is_simulated_and_how_tall_the_person_is() -> None:
    recording = simulate([Leg("walking", duration_s=5)], Gait(height_m=1.66))
    assert recording.meta["dataset"] == "simulated" and recording.meta["truth"] == "exact"
    assert recording.subject.height_m == 1.66


def test_the_same_seed_gives_the_same_recording_and_another_seed_another_one() -> None:
    first, again, other = (simulate(ALL_CONTEXTS, seed=seed) for seed in (7, 7, 8))
    for name, stream in first.streams.items():
        np.testing.assert_array_equal(stream.time_s, again.streams[name].time_s)
        np.testing.assert_array_equal(stream.values, again.streams[name].values)
    assert len(first.accelerometer) != len(other.accelerometer) or not np.allclose(
        first.accelerometer.values, other.accelerometer.values
    )


def test_the_walk_does_not_depend_on_the_sensors() -> None:
    rough = simulate(ALL_CONTEXTS, seed=7, rate_hz=50)
    perfect = simulate(ALL_CONTEXTS, seed=7, errors=SensorErrors.none())
    np.testing.assert_array_equal(path_m(rough), path_m(perfect))


def test_time_begins_with_the_first_accelerometer_sample_and_the_streams_have_their_own_times(demo: Recording) -> None:
    assert set(demo.streams) == {"accelerometer", "gyroscope", "magnetometer"}
    assert demo.accelerometer.time_s[0] == 0.0
    assert demo.gyroscope is not None and demo.magnetometer is not None
    shift_s = demo.gyroscope.time_s - demo.accelerometer.time_s[: len(demo.gyroscope)]
    assert np.median(shift_s) == pytest.approx(0.003, abs=1e-4) and np.std(shift_s) > 1e-4
    assert np.median(np.diff(demo.accelerometer.time_s)) == pytest.approx(0.01, rel=0.01)
    assert np.median(np.diff(demo.magnetometer.time_s)) == pytest.approx(0.02, rel=0.01)


def test_stairs_gain_and_lose_seventeen_centimetres_a_step() -> None:
    truth = simulate([Leg("upstairs", distance_m=2.9), Leg("downstairs", distance_m=1.45)]).truth
    assert truth.waypoints is not None and truth.position is not None and truth.segments is not None
    up_m = np.interp(truth.waypoints.time_s, truth.position.time_s, truth.position.up_m)
    np.testing.assert_array_equal(truth.segments.n_steps, [10, 5])
    np.testing.assert_allclose(up_m, [0.0, 1.7, 0.85], atol=1e-4)


@pytest.mark.parametrize(("side", "east_m"), [("right", 4.0), ("left", -4.0)])
def test_sideways_goes_across_the_direction_the_body_faces(side: str, east_m: float) -> None:
    legs = [Leg("sideways", distance_m=4.0, side=side)]  # type: ignore[arg-type]
    end = simulate(legs, seed=2).truth.waypoints[-1]  # type: ignore[index]
    assert (end.east_m, end.north_m) == pytest.approx((east_m, 0.0), abs=1e-6)
    np.testing.assert_array_equal(phone_motion(legs, seed=2).heading_rad, 0.0)


@pytest.mark.parametrize("curve", [False, True])
def test_a_positive_turn_is_clockwise(curve: bool) -> None:
    legs = [Leg("walking", distance_m=20.0, turn_rad=RIGHT, curve=curve)]
    end = simulate(legs, seed=2).truth.waypoints[-1]  # type: ignore[index]
    assert end.east_m > 10.0 and end.north_m > 0.0
    assert phone_motion(legs, seed=2).heading_rad[-1] == pytest.approx(RIGHT)
    if curve:  # a quarter of a circle, but for the softened ends of the turn
        assert end.east_m == pytest.approx(end.north_m, rel=0.1)


def test_walking_starts_along_the_start_heading() -> None:
    end = simulate([Leg("walking", distance_m=10.0)], start_heading_rad=2.0).truth.waypoints[-1]  # type: ignore[index]
    assert (end.east_m, end.north_m) == pytest.approx((10 * np.sin(2.0), 10 * np.cos(2.0)), abs=1e-3)


def test_turns_while_walking_are_no_faster_than_people_turn() -> None:
    legs = [Leg("walking", distance_m=10.0), Leg("walking", distance_m=10.0, turn_rad=np.pi)]
    motion = phone_motion(legs)
    rate_radps = np.abs(np.gradient(motion.heading_rad, motion.grid_s)).max()
    assert 1.5 < rate_radps < 3.5


def test_the_magnetic_field_points_north_in_the_horizontal_plane() -> None:
    legs = [Leg("stationary", duration_s=4.0)]
    recording = simulate(legs, start_heading_rad=1.0, errors=SensorErrors.none())
    assert recording.magnetometer is not None
    up = recording.accelerometer.values.mean(axis=0)
    field = recording.magnetometer.values.mean(axis=0)
    east = np.cross(field, up)
    north = np.cross(up, east)
    heading_rad = np.arctan2(east[1] / np.linalg.norm(east), north[1] / np.linalg.norm(north))
    assert heading_rad == pytest.approx(1.0, abs=0.03)


def test_the_default_errors_have_the_noise_bias_and_quantum_they_claim() -> None:
    errors = SensorErrors()
    biases, scales = [], []
    for seed in range(60):
        measured = errors.gyroscope.apply(np.zeros((2000, 3)), 100.0, np.random.default_rng(seed))
        biases.append(measured.mean(axis=0))
        fast = errors.gyroscope.apply(np.full((200, 3), 20.0), 100.0, np.random.default_rng(seed))
        scales.append(fast.mean(axis=0) / 20.0 - 1.0)
    assert np.std(biases) == pytest.approx(errors.gyroscope.bias_std, rel=0.2)
    assert np.std(scales) == pytest.approx(errors.gyroscope.scale_std, rel=0.2)
    quantum = errors.gyroscope.quantum
    np.testing.assert_allclose(measured / quantum, np.round(measured / quantum), atol=1e-6)
    noise = np.hypot(errors.gyroscope.noise_density * np.sqrt(50.0), quantum / np.sqrt(12))
    assert np.diff(measured, axis=0).std() / np.sqrt(2) == pytest.approx(noise, rel=0.1)
    clipped = errors.accelerometer.apply(np.full((10, 3), 100.0), 100.0, np.random.default_rng(0))
    np.testing.assert_allclose(clipped, 8 * STANDARD_GRAVITY_MPS2)


def test_taller_and_faster_people_make_longer_steps() -> None:
    usual = Gait().step_length_m("walking", 1.9)
    assert usual == pytest.approx(0.43 * 1.75, abs=0.02)  # 0.42 to 0.44 of the height, measured at this cadence
    assert Gait(height_m=1.9).step_length_m("walking", 1.9) > usual
    assert Gait().step_length_m("walking", 2.1) > usual


def test_random_people_differ_and_the_same_seed_is_the_same_person() -> None:
    assert Gait.random(1) == Gait.random(1)
    assert len({Gait.random(seed).height_m for seed in range(20)}) == 20


# Medians of public recordings over 2 s windows: standard deviation and main frequency of |specific force|, mean and
# standard deviation of |angular rate|. Hand: median of three data sets; pocket: 12 people.
REAL = {
    ("walking", "texting"): (1.94, 1.90, 0.56, 0.28),
    ("walking", "pocket"): (5.42, 1.90, 2.18, 1.05),
    ("upstairs", "pocket"): (3.42, 1.76, 2.01, 0.97),
    ("downstairs", "pocket"): (4.40, 2.00, 1.78, 0.91),
    ("running", "pocket"): (9.90, 2.73, 3.38, 1.55),
    ("stationary", "pocket"): (0.06, np.nan, 0.07, 0.05),
}


@pytest.mark.parametrize(("context", "mode"), REAL)
def test_signals_are_within_thirty_per_cent_of_real_ones(context: str, mode: str) -> None:
    rows = []
    for seed in range(32):
        recording = simulate([Leg(context, duration_s=10)], Gait.random(seed), mode, seed=seed)
        assert recording.gyroscope is not None
        force, rate = norms(recording.accelerometer.values), norms(recording.gyroscope.values)
        for i in range(200, 800, 200):
            f = force[i : i + 200]
            spectrum = np.abs(np.fft.rfft((f - f.mean()) * np.hanning(200), 2048))
            frequency_hz = np.fft.rfftfreq(2048, 0.01)
            band = (frequency_hz > 0.7) & (frequency_hz < 5.0)
            main_hz = np.nan if context == "stationary" else frequency_hz[band][spectrum[band].argmax()]
            rows.append([f.std(), main_hz, rate[i : i + 200].mean(), rate[i : i + 200].std()])
    np.testing.assert_allclose(np.median(rows, axis=0), REAL[context, mode], rtol=0.3)
