from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import contacts_of, count_error, times_s, uniform_block

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.tian2016.steps import (
    HOLDING,
    POCKET,
    SWING,
    TRANS,
    Carried,
    TianDetectorState,
    TianStepDetector,
    ios_acceleration,
    n_filled_in,
    step_signals,
)
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import CARRYING_MODES, CONTEXTS, STANDARD_GRAVITY_MPS2, Step, known_context
from pdr_filter.values.recording import Recording

TEXTING, SWINGING, IN_POCKET, UNKNOWN = *(CARRYING_MODES.index(m) for m in ("texting", "swinging", "pocket")), -1


def phone(
    user_g: np.ndarray, carrying_mode: np.ndarray | int, up: tuple[float, float, float] = (0.0, 0.0, 1.0), rate_hz=100.0
) -> tuple[UniformBlock, AttitudeBlock, ContextBlock]:
    """A phone that never turns, with the user acceleration of iOS (N, 3), in g."""
    n = len(user_g)
    direction = np.tile(np.array(up) / np.linalg.norm(up), (n, 1))
    force = STANDARD_GRAVITY_MPS2 * (direction - user_g)
    block = replace(uniform_block(np.zeros(n), rate_hz, rate=np.zeros((n, 3))), specific_force_mps2=force)
    vertical = (force * direction).sum(axis=1) - STANDARD_GRAVITY_MPS2
    attitude = AttitudeBlock(vertical, np.zeros((n, 2)), direction, np.zeros(n))
    return block, attitude, ContextBlock(np.full(n, -1), np.broadcast_to(carrying_mode, n).copy())


def detect(
    detector: TianStepDetector, samples: tuple[UniformBlock, AttitudeBlock, ContextBlock]
) -> tuple[TianDetectorState, list[tuple[int, Step]]]:
    return detector.update(detector.init(), *samples)


def cosine(axis: int, amplitude_g: float, frequency_hz: float, seconds: float = 10.0, rate_hz: float = 100.0):
    """User acceleration that is a cosine on one axis: a maximum at 0 s and each period after."""
    user = np.zeros((round(seconds * rate_hz), 3))
    user[:, axis] = amplitude_g * np.cos(2 * np.pi * frequency_hz * (np.arange(len(user)) + 0.5) / rate_hz)
    return user


# --- signs and signals ----------------------------------------------------------------------------------------------


def test_a_phone_face_up_has_the_gravity_of_ios_and_pushed_upwards_a_negative_user_acceleration() -> None:
    force = np.array([[0.0, 0.0, 9.80665], [0.0, 0.0, 1.5 * 9.80665]])
    gravity, user = ios_acceleration(force, np.tile([0.0, 0.0, 1.0], (2, 1)))
    np.testing.assert_allclose(gravity, [[0, 0, -1], [0, 0, -1]])
    np.testing.assert_allclose(user, [[0, 0, 0], [0, 0, -0.5]], atol=1e-15)


def test_gravity_and_user_acceleration_add_up_to_minus_the_specific_force_in_g() -> None:
    rng = np.random.default_rng(0)
    force, up = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    gravity, user = ios_acceleration(force, up / np.linalg.norm(up, axis=1)[:, None])
    np.testing.assert_allclose(-9.80665 * (gravity + user), force)


def test_the_vertical_acceleration_is_that_of_equations_5_and_6_for_a_phone_that_somebody_reads() -> None:
    rng = np.random.default_rng(1)
    up = np.column_stack([rng.normal(size=200) * 0.3, rng.uniform(0, 1, 200), rng.uniform(0, 1, 200)])
    up /= np.linalg.norm(up, axis=1)[:, None]
    force = 9.8 * up + rng.normal(size=(200, 3))
    gravity, user = ios_acceleration(force, up)
    phi = np.arctan(np.abs(gravity[:, 2] / gravity[:, 1]))
    literal = user[:, 2] * np.sin(phi) + user[:, 1] * np.cos(phi)
    signals = step_signals(force, up)
    np.testing.assert_allclose(signals[0], literal, atol=1e-12)
    np.testing.assert_array_equal(signals[1:], user[:, 1:].T)


def test_the_vertical_acceleration_is_minus_the_upward_one_however_the_phone_is_pitched() -> None:
    pitch = np.linspace(-np.pi, np.pi, 50)
    up = np.column_stack([np.zeros(50), np.sin(pitch), np.cos(pitch)])
    np.testing.assert_allclose(step_signals(1.3 * 9.80665 * up, up)[0], -0.3, atol=1e-12)


# --- which state a carrying mode is ---------------------------------------------------------------------------------


def test_before_anything_is_known_the_phone_is_held_and_an_unknown_mode_is_a_transition_of_two_seconds() -> None:
    modes = np.repeat([UNKNOWN, IN_POCKET, UNKNOWN, SWINGING, UNKNOWN, TEXTING], [300, 50, 250, 10, 200, 10])
    expected = np.repeat([HOLDING, POCKET, TRANS, POCKET, SWING, TRANS, HOLDING], [300, 50, 200, 50, 10, 200, 10])
    carried = Carried()
    np.testing.assert_array_equal(carried.update(carried.init(), modes)[1], expected)
    state, pieces = carried.init(), []
    for sample in modes:
        state, found = carried.update(state, np.array([sample]))
        pieces += list(found)
    np.testing.assert_array_equal(pieces, expected)


# --- steps ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
@pytest.mark.parametrize("frequency_hz", [1.2, 1.8, 2.4])
@pytest.mark.parametrize(("mode", "axis"), [(TEXTING, 2), (IN_POCKET, 2)])
def test_each_period_is_one_step_at_its_maximum_when_held_and_in_a_pocket(
    mode: int, axis: int, frequency_hz: float, rate_hz: float
) -> None:
    samples = phone(cosine(axis, 0.3, frequency_hz, rate_hz=rate_hz), mode, rate_hz=rate_hz)
    _, found = detect(TianStepDetector(rate_hz=rate_hz), samples)
    expected = np.arange(1, 30) / frequency_hz
    np.testing.assert_allclose(times_s(found), expected[: len(found)], atol=0.02)
    assert len(found) >= 9.6 * frequency_hz - 1
    np.testing.assert_allclose([s.frequency_hz for _, s in found[1:]], frequency_hz, rtol=0.02)


@pytest.mark.parametrize("frequency_hz", [0.7, 0.9, 1.1])
def test_a_swing_of_the_arm_is_two_steps(frequency_hz: float) -> None:
    _, found = detect(TianStepDetector(), phone(cosine(1, 0.4, frequency_hz), SWINGING, up=(1.0, 0.0, 0.0)))
    np.testing.assert_allclose(times_s(found), np.arange(1, len(found) + 1) / (2 * frequency_hz), atol=0.025)
    assert len(found) >= 2 * 9.6 * frequency_hz - 1


@pytest.mark.parametrize(("mode", "axes"), [(TEXTING, {1, 2}), (SWINGING, {1}), (IN_POCKET, {2})])
def test_each_mode_looks_at_its_own_axis(mode: int, axes: set[int]) -> None:
    for axis in range(3):
        _, found = detect(TianStepDetector(), phone(cosine(axis, 0.4, 1.0), mode, up=(0.0, 0.6, 0.8)))
        assert (len(found) > 5) == (axis in axes)


@pytest.mark.parametrize(("mode", "axis", "smallest_g"), [(TEXTING, 2, 0.05), (SWINGING, 1, 0.15), (IN_POCKET, 2, 0.1)])
def test_peaks_below_the_threshold_of_the_mode_are_no_steps(mode: int, axis: int, smallest_g: float) -> None:
    for scale, any_steps in [(0.95, False), (1.1, True)]:
        # a slow swing, which the low-pass leaves as it is, beginning at zero
        user = scale * smallest_g * np.sin(2 * np.pi * 0.8 * np.arange(1000) / 100)[:, None] * np.eye(3)[axis]
        _, found = detect(TianStepDetector(), phone(user, mode))
        assert (len(found) > 0) == any_steps


def bumps(seconds: float, at_s: list[float], height_g: float, width_s: float = 0.05) -> np.ndarray:
    """User acceleration on z with a smooth bump at each time."""
    time_s = (np.arange(round(100 * seconds)) + 0.5) / 100
    user = np.zeros((len(time_s), 3))
    user[:, 2] = sum(height_g * np.exp(-0.5 * ((time_s - t) / width_s) ** 2) for t in at_s)
    return user


def test_two_peaks_within_a_fifth_of_a_second_are_one_step() -> None:
    detector = TianStepDetector(held_rejection_s=0.0, low_pass_hz=20.0)
    for apart_s, n in [(0.17, 1), (0.23, 2)]:
        _, found = detect(detector, phone(bumps(4.0, [2.0, 2.0 + apart_s], 0.5, 0.03), TEXTING))
        assert len(found) == n


def test_a_peak_that_a_trough_follows_within_the_rejection_window_is_false() -> None:
    # the trough between the two comes 0.08 s after the first: in the window of a held phone, not in that of a pocket
    user = bumps(4.0, [2.0], 0.5, 0.08) + bumps(4.0, [1.74], 0.5, 0.03)
    for mode, expected_s in [(TEXTING, [2.0]), (IN_POCKET, [1.74, 2.0])]:
        _, found = detect(TianStepDetector(low_pass_hz=20.0), phone(user, mode))
        np.testing.assert_allclose(times_s(found), expected_s, atol=0.02)


def test_only_a_step_that_no_step_precedes_by_two_seconds_is_from_rest() -> None:
    at_s = [2.0, 2.5, 3.0, 3.5, 5.0, 5.5, 8.0]  # pauses of 1.5 s and of 2.5 s
    _, found = detect(TianStepDetector(), phone(bumps(10.0, at_s, 0.3), TEXTING))
    assert [s.from_rest for _, s in found] == [True, False, False, False, False, False, True]


# --- transitions ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [1.3, 1.6, 1.9])
def test_steps_of_a_transition_are_filled_in_evenly_when_it_ends(frequency_hz: float) -> None:
    modes = np.repeat([TEXTING, UNKNOWN, IN_POCKET], [500, 200, 500])
    rng = np.random.default_rng(0)
    user = cosine(2, 0.3, frequency_hz, 12.0)
    user[500:700] += rng.normal(size=(200, 3))  # the hand that moves the phone
    _, found = detect(TianStepDetector(), phone(user, modes))
    filled = [(i, s) for i, s in found if 5.0 <= s.time_s < 7.0]
    n = round(2.0 * frequency_hz)
    assert len(filled) == n
    np.testing.assert_allclose(times_s(filled), 5.0 + 2.0 * (np.arange(n) + 0.5) / n, atol=0.006)
    np.testing.assert_allclose([s.frequency_hz for _, s in filled], frequency_hz, rtol=0.02)
    np.testing.assert_allclose([s.duration_s * s.frequency_hz for _, s in filled], 1.0)
    assert all(7.0 < s.detected_time_s < 7.2 for _, s in filled)
    assert (np.diff(times_s(found)) > 0.19).all()
    assert len(found) == pytest.approx(12.0 * frequency_hz, abs=2.5)


def test_nothing_is_filled_in_for_who_stood_or_had_made_a_first_step_only() -> None:
    modes = np.repeat([TEXTING, UNKNOWN, TEXTING], [500, 200, 300])
    for at_s, n in [([], 0), ([4.5], 1), ([1.0, 1.5, 2.0], 3)]:
        _, found = detect(TianStepDetector(), phone(bumps(10.0, at_s, 0.3), modes))
        assert len(found) == n


def test_a_transition_that_the_recording_cuts_off_is_not_filled_in() -> None:
    modes = np.repeat([TEXTING, UNKNOWN], [500, 150])
    detector = TianStepDetector()
    state, found = detect(detector, phone(cosine(2, 0.3, 1.8, 6.5), modes))
    assert max(s.time_s for _, s in [*found, *detector.finish(state)]) < 5.0


def test_an_unknown_mode_that_lasts_is_the_one_before_again() -> None:
    modes = np.repeat([TEXTING, UNKNOWN], [500, 700])
    _, found = detect(TianStepDetector(), phone(cosine(2, 0.3, 1.8, 12.0), modes))
    assert len(found) == pytest.approx(12.0 * 1.8, abs=2)
    assert np.diff(times_s(found)).max() < 1.5 / 1.8


@pytest.mark.parametrize(("transition_s", "hz", "n"), [(2.0, 1.7, 3), (2.0, 1.75, 4), (2.0, 1.8, 4), (2.0, 0.0, 0)])
def test_equation_8_rounds_to_the_nearest_number(transition_s: float, hz: float, n: int) -> None:
    assert n_filled_in(transition_s, hz) == n


# --- latency, the end, invariance -----------------------------------------------------------------------------------


def test_no_step_is_known_before_its_contact_nor_later_than_the_latency() -> None:
    detector = TianStepDetector()
    modes = np.repeat([TEXTING, UNKNOWN, IN_POCKET], [500, 200, 500])
    samples = phone(cosine(2, 0.3, 1.9, 12.0), modes)
    state, found = detect(detector, samples)
    assert all(samples[0].time_s[i] == s.detected_time_s for i, s in found)
    delays_s = np.array([s.detected_time_s - s.time_s for _, s in found])
    in_transition = (times_s(found) > 5.0) & (times_s(found) < 7.0)
    np.testing.assert_allclose(delays_s[~in_transition], 0.175, atol=0.011)
    assert delays_s.min() >= 0
    assert delays_s.max() <= detector.latency_s < 2.3
    assert all(s.time_s <= s.detected_time_s == samples[0].time_s[-1] for _, s in detector.finish(state))


def test_at_the_end_a_peak_that_waits_for_its_future_is_a_step() -> None:
    detector = TianStepDetector()
    samples = phone(bumps(2.12, [1.0, 1.5, 2.0], 0.3), TEXTING)
    state, found = detect(detector, samples)
    assert len(found) == 2
    [(number, last)] = detector.finish(state)
    assert number == 211
    assert last.time_s == pytest.approx(2.0, abs=0.02)
    assert detector.finish(detector.init()) == []


# --- real recordings ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class AlwaysCarried:
    """Context stage of a carrying mode that is known in advance."""

    carrying_mode: str
    rate_hz: float = 100.0
    contexts: tuple[str, ...] = CONTEXTS

    def init(self) -> bool:
        return False

    def after_gap(self, state: bool) -> bool:
        return False

    def update(self, state: bool, block: UniformBlock, attitude: AttitudeBlock) -> tuple[bool, list[Any]]:
        known = known_context(float(block.time_s[0]), {"walking": 1.0}, {self.carrying_mode: 1.0}, CONTEXTS, "")
        return True, [] if state else [(0, known)]


def steps_s(path: Path, carrying_mode: str) -> tuple[np.ndarray, Recording]:
    """Contacts in a recording whose carrying mode is given."""
    recording = read(path)
    sensing = Sensing(steps=TianStepDetector(), contexts=AlwaysCarried(carrying_mode))
    return contacts_of(recording, sensing), recording


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("placement", "mode", "n_walks", "largest_error"),
    [("handheld_using", "texting", 7, 0.10), ("trousers_*_pocket", "pocket", 14, 0.17)],
)
def test_steps_of_people_7_to_13_of_ubicomp13_are_counted(
    data_dir: Path, placement: str, mode: str, n_walks: int, largest_error: float
) -> None:
    """The thresholds were chosen on people 1 to 6. In a pocket one axis is a poor pedometer."""
    errors = []
    for person in range(7, 14):
        for path in sorted((data_dir / "ubicomp13").glob(f"ubicomp13_p{person:02d}_*_{placement}.zip")):
            found_s, recording = steps_s(path, mode)
            errors.append(count_error(recording, found_s))
    assert len(errors) == n_walks
    assert np.mean(np.abs(errors)) < largest_error


@pytest.mark.recordings
def test_steps_in_the_front_pocket_are_matched_with_those_of_foot_switches(data_dir: Path) -> None:
    for path in sorted((data_dir / "oxford").glob("*frontpocket*.zip")):
        found_s, recording = steps_s(path, "pocket")
        truth_s = recording.truth.steps.time_s
        found_s = found_s[(found_s > truth_s[0] - 0.6) & (found_s < truth_s[-1] + 0.6)]
        assert abs(len(found_s) / len(truth_s) - 1) < 0.05
        # the z axis of a leg does not peak at contacts: compared after the best shift
        shifts_s = np.arange(-0.4, 0.41, 0.02)
        nearest_s = [np.abs(truth_s[:, None] - found_s - shift).min(axis=1) for shift in shifts_s]
        assert max((n <= 0.25).mean() for n in nearest_s) > 0.95
