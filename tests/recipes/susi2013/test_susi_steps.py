from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import (
    against_foot_switches,
    assert_last_steps_at_their_times,
    contacts_of,
    count_error,
    cut_uniform,
    detect,
    times_s,
    uniform_block,
)
from scipy.signal import butter, sosfilt, sosfiltfilt

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.susi2013.contexts import MotionModes
from pdr_filter.recipes.susi2013.steps import NormMinimaStepDetector
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CARRYING_MODES, CONTEXTS
from pdr_filter.values.recording import Recording

WALKING, STATIONARY = CONTEXTS.index("walking"), CONTEXTS.index("stationary")
SWINGING, TEXTING = CARRYING_MODES.index("swinging"), CARRYING_MODES.index("texting")
START_S, N_STEPS = 4.0, 24
DETECTOR = NormMinimaStepDetector()
SENSING = Sensing(contexts=MotionModes(), steps=DETECTOR)


def walk(step_hz: float, start_s: float = START_S, rate_hz: float = 100.0) -> tuple[np.ndarray, UniformBlock]:
    """Contacts, and a hand in which |f| is highest and |omega| lowest at them: an arm that turns at each contact."""
    contacts_s = start_s + np.arange(N_STEPS) / step_hz
    n = int((contacts_s[-1] + 4.0) * rate_hz)
    time_s = (np.arange(n) + 0.5) / rate_hz
    inside = (time_s > contacts_s[0] - 0.5 / step_hz) & (time_s < contacts_s[-1] + 0.5 / step_hz)
    force = 9.81 + inside * 2.5 * np.cos(2 * np.pi * step_hz * (time_s - start_s))
    turning = inside * 2.5 * np.sin(np.pi * step_hz * (time_s - start_s))
    return contacts_s, uniform_block(force, rate_hz, rate=np.outer(turning, [0.8, 0.0, 0.6]))


def assert_one_step_at_each(contacts_s: np.ndarray, found_s: np.ndarray, tolerance_s: float) -> None:
    """Each contact but the first and the last, where the motion is cut off, has its step; at most these are more."""
    inside = (found_s > contacts_s[1] - 0.5 * tolerance_s) & (found_s < contacts_s[-2] + 0.5 * tolerance_s)
    np.testing.assert_allclose(found_s[inside], contacts_s[1:-1], atol=tolerance_s)
    assert len(found_s) <= len(contacts_s) + 1


def modes_like(block: UniformBlock, context: int = WALKING, carrying_mode: int = TEXTING) -> ContextBlock:
    n = len(block.time_s)
    return ContextBlock(np.full(n, context), np.full(n, carrying_mode))


# --- the delay of the filter ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [0.4, 0.9, 1.8, 2.6])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0])
def test_the_delay_is_that_of_a_sinusoid_through_the_filter(frequency_hz: float, rate_hz: float) -> None:
    detector = NormMinimaStepDetector(rate_hz=rate_hz)
    time_s = np.arange(int(40 * rate_hz)) / rate_hz
    sos = butter(10, 3.0, fs=rate_hz, output="sos")
    filtered = np.asarray(sosfilt(sos, np.sin(2 * np.pi * frequency_hz * time_s)))[len(time_s) // 2 :]
    late = np.exp(-2j * np.pi * frequency_hz * time_s[len(time_s) // 2 :])
    phase = np.angle((filtered * late).mean() * 2j)  # of sin(w (t - delay)): -w delay
    period_s = 1 / frequency_hz
    difference_s = (detector.delay_s(frequency_hz) + phase / (2 * np.pi * frequency_hz)) % period_s
    assert min(difference_s, period_s - difference_s) < 0.003
    assert 0.3 < detector.delay_s(frequency_hz) < 0.45


# --- steps at known contacts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_hz", [1.2, 1.5, 1.8, 2.2, 2.6])
@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0])
def test_an_arm_at_rest_has_a_step_at_each_bump_of_the_body(step_hz: float, rate_hz: float) -> None:
    contacts_s, block = walk(step_hz, rate_hz=rate_hz)
    _, found = detect(NormMinimaStepDetector(rate_hz=rate_hz), [block], [modes_like(block)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.04)


@pytest.mark.parametrize("step_hz", [1.2, 1.5, 1.8, 2.2, 2.6])
def test_a_full_cycle_of_a_swinging_arm_is_a_stride_of_two_steps(step_hz: float) -> None:
    contacts_s, block = walk(step_hz)
    # a hand that shows nothing of the body, only the pull of the arm once a stride
    block.specific_force_mps2[:, 2] = 9.81 + 2.5 * np.cos(np.pi * step_hz * (block.time_s - START_S))
    _, found = detect(DETECTOR, [block], [modes_like(block, carrying_mode=SWINGING)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.04)
    n_cycles = (N_STEPS - 1) / 2
    assert len(found) == pytest.approx(2 * n_cycles, abs=2)


def test_a_swinging_hand_whose_angular_rate_is_unknown_is_counted_by_its_force() -> None:
    contacts_s, block = walk(1.8)
    without = uniform_block(block.specific_force_mps2[:, 2])
    _, found = detect(DETECTOR, [without], [modes_like(block, carrying_mode=SWINGING)])
    assert_one_step_at_each(contacts_s, times_s(found), 0.04)


def test_an_unknown_mode_is_counted_like_an_arm_at_rest() -> None:
    _, block = walk(1.8)
    assert detect(DETECTOR, [block])[1] == detect(DETECTOR, [block], [modes_like(block)])[1]


@pytest.mark.parametrize("carrying_mode", [TEXTING, SWINGING, -1])
def test_nobody_who_stands_makes_steps(carrying_mode: int) -> None:
    _, block = walk(1.8)
    state, found = detect(DETECTOR, [block], [modes_like(block, STATIONARY, carrying_mode)])
    assert found == NormMinimaStepDetector().finish(state) == []


def test_the_mode_of_a_contact_is_known_1_to_2_seconds_after_it() -> None:
    contacts_s, block = walk(2.0)
    change_s = contacts_s[12]
    modes = ContextBlock(np.where(block.time_s < change_s, STATIONARY, WALKING), np.full(len(block.time_s), TEXTING))
    found_s = times_s(detect(DETECTOR, [block], [modes])[1])
    assert change_s - 2.2 < found_s[0] < change_s - 1.3


def test_a_change_of_the_carrying_mode_loses_and_doubles_no_step() -> None:
    _, block = walk(1.8)
    swinging = (block.time_s // 3.7) % 2 == 0
    modes = ContextBlock(np.full(len(swinging), WALKING), np.where(swinging, SWINGING, TEXTING))
    found_s = times_s(detect(DETECTOR, [block], [modes])[1])
    # both norms know the same contacts, and a contact that neither was asked for is the worst that can happen
    assert (np.diff(found_s) > 0.3).all()
    assert len(found_s) >= N_STEPS - 3


@pytest.mark.parametrize("step_hz", [1.1, 1.3])
@pytest.mark.parametrize("second_mps2", [0.8, 2.8])
def test_a_second_bump_that_rises_little_above_the_mean_makes_no_second_step(
    step_hz: float, second_mps2: float
) -> None:
    _, block = walk(step_hz)
    phase = 2 * np.pi * step_hz * (block.time_s - START_S)
    moving = block.specific_force_mps2[:, 2] != 9.81
    block.specific_force_mps2[:, 2] += moving * second_mps2 * np.cos(2 * phase)
    _, found = detect(DETECTOR, [block], [modes_like(block)])
    assert len(found) == pytest.approx(N_STEPS, abs=1)
    np.testing.assert_allclose(np.diff(times_s(found))[3:-3], 1 / step_hz, atol=0.02)


# --- when a step becomes known --------------------------------------------------------------------------------------


@pytest.mark.parametrize("carrying_mode", [TEXTING, SWINGING])
@pytest.mark.parametrize("after_last_s", [0.4, 0.7, 1.5])
def test_at_the_end_the_last_steps_are_found_at_their_times(carrying_mode: int, after_last_s: float) -> None:
    contacts_s, block = walk(1.8)
    block = cut_uniform(block, [int(100 * (contacts_s[-1] + after_last_s))])[0]
    modes = modes_like(block, carrying_mode=carrying_mode)
    assert len(assert_last_steps_at_their_times(NormMinimaStepDetector(), contacts_s, block, [modes])) >= 2


# --- invariance -----------------------------------------------------------------------------------------------------


# --- with the motion modes: simulated and real walks ----------------------------------------------------------------


def within(time_s: np.ndarray, start_s: float, end_s: float) -> np.ndarray:
    return time_s[(time_s > start_s) & (time_s < end_s)]


@pytest.mark.parametrize("carrying_mode", ["texting", "swinging"])
def test_steps_of_a_simulated_walk_are_counted(carrying_mode: str) -> None:
    recording = simulate([Leg("walking", distance_m=80.0)], carrying_mode=carrying_mode, seed=2)
    assert recording.truth.steps is not None
    truth_s = recording.truth.steps.time_s
    found_s = contacts_of(recording, SENSING)
    assert len(found_s) == pytest.approx(len(truth_s), rel=0.04)


@pytest.mark.recordings
def test_steps_of_oxford_in_the_hand_are_counted_and_timed_as_by_foot_switches(data_dir: Path) -> None:
    """Neither the modes nor the depth of a minimum were fitted on Oxford; there is no gyroscope."""
    offsets_s = []
    for path in sorted((data_dir / "oxford").glob("*inhand*.zip")):
        recording = read(path)
        error, offset_s = against_foot_switches(recording, contacts_of(recording, SENSING))
        assert abs(error) < 0.025
        offsets_s.append(np.median(offset_s))
    assert len(offsets_s) == 4
    # the switches were read every 0.1 s, so that they are up to that late
    assert abs(np.mean(offsets_s)) < 0.08


def arm_turns_s(recording: Recording) -> np.ndarray:
    """Times at which the hand overtakes the body or falls behind, twice in each cycle of the arm, by motion capture."""
    position = recording.truth.position
    assert position is not None
    time_s = np.arange(position.time_s[0], position.time_s[-1], 0.01)
    path = np.column_stack([np.interp(time_s, position.time_s, c) for c in (position.east_m, position.north_m)])
    velocity, body = (
        sosfiltfilt(butter(order, hz, fs=100, output="sos"), np.gradient(path, 0.01, axis=0), axis=0)
        for order, hz in ((3, 3.5), (2, 0.3))
    )
    ahead = ((velocity - body) * body).sum(axis=1)
    return time_s[np.flatnonzero(np.diff(np.sign(ahead)) != 0)]


@pytest.mark.recordings
@pytest.mark.parametrize(("name", "tolerance"), [("nodist", 0.06), ("dist", 0.15)])
def test_real_swinging_walks_have_a_step_for_each_turn_of_the_arm(data_dir: Path, name: str, tolerance: float) -> None:
    recording = read(data_dir / "tyrex" / f"tyrex_thibaud_nexus5_{name}_swinging.zip")
    assert recording.truth.labels is not None
    [label] = recording.truth.labels
    turns_s = within(arm_turns_s(recording), label.start_s, label.end_s)
    found_s = within(contacts_of(recording, SENSING), label.start_s, label.end_s)
    assert len(turns_s) > 180
    assert len(found_s) == pytest.approx(len(turns_s), rel=tolerance)


@pytest.mark.recordings
def test_people_7_to_13_of_ubicomp13_with_the_phone_in_the_hand_are_counted(data_dir: Path) -> None:
    """The detector was chosen on people 1 to 6; person 8, who walks slowly, is the worst."""
    errors = []
    for person in (7, 9, 11, 13):
        for path in sorted((data_dir / "ubicomp13").glob(f"ubicomp13_p{person:02d}_*hand_held.zip")):
            recording = read(path)
            errors.append(count_error(recording, contacts_of(recording, SENSING)))
    assert len(errors) == 4
    assert np.mean(np.abs(errors)) < 0.03
