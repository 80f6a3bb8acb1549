from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import against_foot_switches, contacts_of, count_error, flat_attitude, times_s, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import firwin

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.zhou2019 import contexts as behaviour
from pdr_filter.recipes.zhou2019.steps import (
    CARRIED,
    FOOT,
    ReferenceLineState,
    ReferenceLineStepDetector,
    dominant_period_s,
    median_line_mps2,
    small_line_mps2,
)
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import CONTEXTS, STANDARD_GRAVITY_MPS2, Step, Table
from pdr_filter.values.recording import Recording
from pdr_filter.values.serialisation import to_bytes

G = STANDARD_GRAVITY_MPS2
STATIONARY, WALKING, RUNNING, UNKNOWN = *(CONTEXTS.index(c) for c in ("stationary", "walking", "running")), -1
LOW = CARRIED.walking


def sway(seconds: float, frequency_hz: float, amplitude_mps2: float = 3.0, rest_s: float = 3.0) -> np.ndarray:
    """|f| of a phone on the body: rest, one sinusoid a step from its zero upwards, rest."""
    t = np.arange(round(100 * seconds)) / 100 + 0.005
    rest = np.full(round(100 * rest_s), G)
    return np.concatenate([rest, G + amplitude_mps2 * np.sin(2 * np.pi * frequency_hz * t), rest])


def strides(n: int, period_s: float, push_mps2: float = 9.0, strike_mps2: float = 12.0, dip_mps2: float = 2.0):
    """|f| on a foot: it stands for 40 % of each stride, then pushes off, swings and strikes."""
    t = np.arange(round(100 * n * period_s)) / 100 % period_s / period_s
    hump = [a * np.exp(-(((t - c) / 0.07) ** 2)) for a, c in ((push_mps2, 0.45), (-dip_mps2, 0.62), (strike_mps2, 0.8))]
    rest = np.random.default_rng(0).normal(G, 0.02, 400)
    return np.concatenate([rest, G + sum(hump), rest])


def detect(
    detector: ReferenceLineStepDetector,
    blocks: list[UniformBlock] | np.ndarray,
    context: np.ndarray | int = UNKNOWN,
    *,
    finish: bool = True,
) -> tuple[ReferenceLineState, list[tuple[int, Step]]]:
    blocks = [uniform_block(blocks)] if isinstance(blocks, np.ndarray) else blocks
    edges = np.cumsum([0, *(len(b.time_s) for b in blocks)])
    context = np.broadcast_to(context, edges[-1])
    state, found = detector.init(), []
    for block, (a, b) in zip(blocks, pairwise(edges), strict=True):
        modes = ContextBlock(context[a:b].copy(), np.full(b - a, UNKNOWN))
        state, steps = detector.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]), modes)
        found += steps
    return state, found + (detector.finish(state) if finish else [])


# --- lines and frequency --------------------------------------------------------------------------------------------


def test_the_lines_are_those_of_table_2_where_they_can_be_crossed() -> None:
    assert small_line_mps2(1.5, 12.0) == 3.0  # rule 2
    assert median_line_mps2(12.0, -2.0) == 2.5  # rule 4
    assert small_line_mps2(-3.0, 12.0) == -1.5  # twice a negative minimum could not be reached


@settings(max_examples=100, deadline=None)
@given(minimum=st.floats(-9.8, 20.0), height=st.floats(0.1, 50.0), part=st.floats(0.0, 0.3))
def test_a_signal_that_rises_to_its_maximum_and_falls_to_its_minimum_crosses_both_lines(
    minimum: float, height: float, part: float
) -> None:
    large = minimum + height
    small = small_line_mps2(minimum, large, part)
    assert small >= minimum
    if small < large:  # not where the foot never comes to rest between two small humps
        assert small < median_line_mps2(large, small) < large or large < 0


@pytest.mark.parametrize("frequency_hz", [1.25, 1.6, 2.0, 2.5])
@pytest.mark.parametrize("harmonic", [0.0, 0.5, 2.0])
def test_the_dominant_frequency_is_the_lowest_however_strong_its_harmonic(frequency_hz: float, harmonic: float) -> None:
    t = np.arange(400) / 100
    a = np.sin(2 * np.pi * frequency_hz * t) + harmonic * np.sin(4 * np.pi * frequency_hz * t + 1.0)
    period_s = dominant_period_s(a, LOW, 100.0)
    assert period_s == pytest.approx(1 / frequency_hz, rel=0.06)


@pytest.mark.parametrize("a", [np.zeros(400), np.random.default_rng(0).normal(0, 0.02, 400), np.sin(np.arange(80))])
def test_what_is_quiet_or_short_has_no_dominant_frequency(a: np.ndarray) -> None:
    assert dominant_period_s(a, LOW, 100.0) is None


@pytest.mark.parametrize("frequency_hz", [1.4, 2.0])
def test_a_window_is_as_long_as_a_period_of_the_dominant_frequency(frequency_hz: float) -> None:
    state, _ = detect(CARRIED, sway(10.0, frequency_hz, rest_s=0.0), finish=False)
    assert state.period_s == pytest.approx(1 / frequency_hz, rel=0.06)  # eq. 5


# --- steps of a phone -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency_hz", [1.3, 1.6, 2.0, 2.4])
@pytest.mark.parametrize("amplitude_mps2", [1.5, 4.0, 7.0])
def test_every_step_ends_where_the_signal_falls_through_half_of_its_minimum(
    frequency_hz: float, amplitude_mps2: float
) -> None:
    found = times_s(detect(CARRIED, sway(12.0, frequency_hz, amplitude_mps2))[1])
    # -A sin = A / 2 on the way down: 210 degrees; the filter is linear-phase and scales line and signal alike
    exact = 3.0 + (np.arange(round(12.0 * frequency_hz)) + 210 / 360) / frequency_hz
    assert abs(len(found) - len(exact)) <= 1
    inside = found[(found > exact[2]) & (found < exact[-2])]
    assert len(inside) > 5
    nearest = exact[np.abs(exact[:, None] - inside).argmin(axis=0)]
    np.testing.assert_allclose(inside, nearest, atol=0.012)


@pytest.mark.parametrize("frequency_hz", [2.4, 2.8, 3.2])
def test_a_runner_has_a_step_at_each_contact(frequency_hz: float) -> None:
    found = times_s(detect(CARRIED, sway(12.0, frequency_hz, 12.0), RUNNING)[1])
    assert abs(len(found) - 12.0 * frequency_hz) <= 1
    np.testing.assert_allclose(np.diff(found)[2:-2], 1 / frequency_hz, atol=0.02)


def test_a_gentle_bout_after_a_wild_one_is_found() -> None:
    magnitude = np.concatenate([sway(8.0, 2.0, 8.0), sway(8.0, 1.6, 1.0)])
    found = times_s(detect(CARRIED, magnitude)[1])
    assert abs(np.sum(found > 14.0) - 8.0 * 1.6) <= 1


def test_the_same_walk_at_half_the_rate_has_the_same_steps() -> None:
    magnitude = sway(12.0, 1.8)
    slow = uniform_block(0.5 * (magnitude[::2] + magnitude[1::2]), rate_hz=50.0)
    found = times_s(detect(replace(CARRIED, rate_hz=50.0), [slow])[1])
    expected = times_s(detect(CARRIED, magnitude)[1])
    assert len(found) == len(expected)
    np.testing.assert_allclose(found[2:], expected[2:], atol=0.02)  # the first lines follow the first extrema


# --- strides of a foot ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("period_s", [0.95, 1.2, 1.5])
@pytest.mark.parametrize("dip_mps2", [-3.0, 0.0, 2.0, 6.0])
def test_a_stride_of_the_foot_is_two_steps_however_deep_the_signal_dips_in_the_swing(
    period_s: float, dip_mps2: float
) -> None:
    found = times_s(detect(FOOT, strides(12, period_s, dip_mps2=dip_mps2))[1])
    # while half of the spectrum is of standing, its lowest line may be too low, and two strides be lost
    assert 20 <= len(found) <= 26
    settled = found[found > 4.0 + 4.0]
    np.testing.assert_allclose(np.diff(settled), period_s / 2, atol=0.05)
    n_settled = 2 * (12 * period_s - 4.0) / period_s
    assert len(settled) == pytest.approx(n_settled, abs=2)


def test_the_second_contact_of_a_stride_is_half_way_between_two_events() -> None:
    magnitude = strides(12, 1.2)
    events = times_s(detect(replace(FOOT, steps_per_event=1), magnitude)[1])
    steps = times_s(detect(FOOT, magnitude)[1])
    np.testing.assert_allclose(steps[1::2], events, atol=1e-9)
    np.testing.assert_allclose(steps[2::2], 0.5 * (events[1:] + events[:-1]), atol=1e-9)


# --- behaviours -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("context", [UNKNOWN, WALKING, CONTEXTS.index("upstairs")])
def test_only_while_nobody_moves_steps_are_not_counted(context: int) -> None:
    magnitude = sway(10.0, 1.8)
    assert len(detect(CARRIED, magnitude, context)[1]) == pytest.approx(18, abs=1)
    assert detect(CARRIED, magnitude, STATIONARY)[1] == []


def test_steps_of_the_time_before_walking_was_recognised_are_given_then() -> None:
    magnitude = sway(10.0, 1.8)
    late = np.full(len(magnitude), STATIONARY)
    late[500:] = WALKING  # two seconds after the first step
    known, found = detect(CARRIED, magnitude, WALKING)[1], detect(CARRIED, magnitude, late)[1]
    np.testing.assert_array_equal(times_s(found), times_s(known))
    waited = [step for _, step in found if step.time_s < 4.5]
    assert len(waited) >= 2
    assert all(step.detected_time_s > 5.0 for step in waited)


def test_what_waited_too_long_is_forgotten() -> None:
    magnitude = sway(20.0, 1.8)
    late = np.full(len(magnitude), STATIONARY)
    late[1500:] = WALKING
    found = times_s(detect(CARRIED, magnitude, late)[1])
    assert 15.0 - CARRIED.latency_s < found[0] < 15.0 - CARRIED.hold_s + 1.0


# --- time, blocks, saving -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("context", "frequency_hz", "cutoff_hz"), [(WALKING, 1.8, 4.25), (RUNNING, 2.8, 10.25)])
def test_the_statistics_of_a_step_are_those_of_the_filtered_acceleration(
    context: int, frequency_hz: float, cutoff_hz: float
) -> None:
    magnitude = sway(8.0, frequency_hz, 4.0) + np.random.default_rng(1).normal(0.0, 1.0, 1400)
    taps = firwin(51, cutoff_hz, window="hamming", fs=100.0)  # the reference, over the whole signal and without delay
    filtered = np.convolve(np.pad(magnitude - G, 25, mode="edge"), taps, mode="valid")
    steps = [step for _, step in detect(CARRIED, magnitude, context)[1]]
    steps = [s for s in steps if 3.5 < s.time_s < 10.5]  # one bout
    assert len(steps) > 8
    for before, step in pairwise(steps):
        start, end = (int(np.floor(100 * s.time_s - 0.5)) for s in (before, step))
        a = filtered[start:end]
        expected = a.var(), G + a.max(), G + a.min(), np.abs(a).mean()
        found = step.variance, step.magnitude_max_mps2, step.magnitude_min_mps2, step.mean_abs_mps2
        assert found == pytest.approx(expected, rel=1e-9)


def test_the_end_gives_the_steps_of_the_window_that_it_cuts_short() -> None:
    magnitude = sway(10.0, 1.8)[:1270]  # in the middle of a walk
    state, online = detect(CARRIED, magnitude, finish=False)
    rest = CARRIED.finish(state)
    assert rest
    assert len(online) + len(rest) == pytest.approx(9.7 * 1.8, abs=1)
    assert all(known == 1269 and step.time_s <= step.detected_time_s == 12.695 for known, step in rest)
    assert CARRIED.finish(CARRIED.init()) == []


def test_memory_does_not_grow() -> None:
    state, _ = detect(FOOT, np.tile(strides(20, 1.2), 10), STATIONARY, finish=False)
    assert len(to_bytes(state)) < 100_000
    assert sum(np.size(getattr(state, f.name)) for f in fields(state) if f.name != "log") < 3000


# --- real recordings ------------------------------------------------------------------------------------------------


def steps_of_recording(
    recording: Recording, detector: ReferenceLineStepDetector, thresholds: behaviour.BehaviourThresholds
) -> np.ndarray:
    return contacts_of(recording, Sensing(steps=detector, contexts=behaviour.BehaviourStage(thresholds=thresholds)))


def n_true_strides(position: Table) -> int:
    """Moves of the foot between stances, seen by motion capture."""
    place = np.column_stack([position.east_m, position.north_m, position.up_m])
    moved = np.concatenate([[True], (np.diff(place, axis=0) != 0).any(axis=1)])  # a lost marker stays to the last digit
    grid_s = np.arange(position.time_s[0], position.time_s[-1], 0.01)
    at = np.column_stack([np.interp(grid_s, position.time_s[moved], p) for p in place[moved].T])
    smooth = np.column_stack([np.convolve(np.pad(p, 4, mode="edge"), np.hanning(9) / 4, "valid") for p in at.T])
    speed_mps = np.linalg.norm(np.gradient(smooth, 0.01, axis=0), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], speed_mps > 0.35, [0]]).astype(int)))
    moves = [[a, b] for a, b in edges.reshape(-1, 2)]
    for first, second in reversed(list(pairwise(moves))):
        if second[0] - first[1] < 6:  # too short for a stance
            first[1] = second[1]
            moves.remove(second)
    lengths_m = [np.linalg.norm(smooth[min(b, len(smooth) - 1)] - smooth[a]) for a, b in moves]
    return sum(length >= 0.1 and b - a >= 12 for length, (a, b) in zip(lengths_m, moves, strict=True))


@pytest.mark.recordings
def test_strides_of_trials_left_out_are_counted_as_motion_capture_sees_them(data_dir: Path) -> None:
    errors = []
    for path in sorted((data_dir / "pyshoe").glob("*.zip"))[1::2]:  # the constants were chosen on the others
        recording = read(path)
        n_true = n_true_strides(recording.truth.position)
        n_found = len(steps_of_recording(recording, FOOT, behaviour.FOOT)) / 2
        errors.append(100 * abs(n_found - n_true) / n_true)
    assert len(errors) == 12
    assert np.mean(errors) < 2.5
    assert max(errors) < 8.0


@pytest.mark.recordings
@pytest.mark.parametrize("place", ["inhand_1", "swingingarm_2"])
def test_steps_match_the_foot_switches_but_for_a_constant_offset(data_dir: Path, place: str) -> None:
    recording = read(data_dir / "oxford" / f"oxford_jamie_pixel_hard_{place}.zip")
    error, offset_s = against_foot_switches(recording, steps_of_recording(recording, CARRIED, behaviour.CARRIED) - 0.04)
    assert np.mean(np.abs(offset_s) < 0.25) > 0.97
    assert abs(error) <= 0.03


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["p07.*_hand_held", "p09.*_trousers_back", "p11.*_trousers_front"])
def test_people_left_out_have_their_steps_counted(data_dir: Path, name: str) -> None:
    person, placement = name.split(".*")
    recording = read(min((data_dir / "ubicomp13").glob(f"ubicomp13_{person}*{placement}*.zip")))
    assert abs(count_error(recording, steps_of_recording(recording, CARRIED, behaviour.CARRIED))) < 0.04
