from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, cut_uniform, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.vehicle_vibration import VehicleVibration, VehicleVibrationState
from pdr_filter.values import Step
from pdr_filter.values.events import Stepless, Undecided

VIBRATION = VehicleVibration()
STEP_S = a_step(0.0).duration_s


def shaking(duration_s: int, jitter_mps2: float = 0.5, seed: int = 0) -> UniformBlock:
    """Samples of |f| that alternate from sample to sample."""
    noise = np.random.default_rng(seed).normal(0.0, jitter_mps2, 100 * duration_s)
    return uniform_block(9.8 + noise)


def after(block: UniformBlock, steps: list[tuple[int, Step]] | None = None) -> VehicleVibrationState:
    return VIBRATION.update(VIBRATION.init(), block, steps or [])[0]


def known_steps(times_s: Sequence[float], late_s: float = 1.0) -> list[tuple[int, Step]]:
    return [(round(100 * (t + late_s)), a_step(t)) for t in times_s]


def test_uninterrupted_vibration_without_steps_counts_as_moving() -> None:
    state = after(shaking(65))
    assert (state.moving_s, state.seen_s) == (60, 60)


def test_rest_and_short_vibration_do_not_count_as_moving() -> None:
    assert after(shaking(65, jitter_mps2=0.05)).moving_s == 0
    assert after(shaking(24)).moving_s == 0
    force = np.concatenate([shaking(19).specific_force_mps2, np.tile([0.0, 0.0, 9.8], (200, 1))])
    assert after(uniform_block(np.tile(force[:, 2], 4))).moving_s == 0


@pytest.mark.parametrize("late_s", [0.9, 4.0])
def test_walking_does_not_count_as_moving_without_steps(late_s: float) -> None:
    times_s = np.arange(1.0, 58.0, 0.6).tolist()
    assert after(shaking(65), known_steps(times_s, late_s)).moving_s == 0
    # from twenty seconds after the last step on it counts
    assert after(shaking(65), known_steps(times_s[:20], late_s)).moving_s == pytest.approx(46, abs=2)


def test_a_gap_ends_the_run_and_keeps_the_totals() -> None:
    state = VIBRATION.after_gap(after(shaking(65)))
    assert VIBRATION.update(state, shaking(20), [])[0].moving_s == 60
    assert VIBRATION.update(state, shaking(30), [])[0].moving_s == 85


def joined(*parts: UniformBlock) -> UniformBlock:
    """Samples of blocks one after the other."""
    return uniform_block(np.concatenate([part.specific_force_mps2[:, 2] for part in parts]))


def swaying(duration_s: int, std_mps2: float) -> UniformBlock:
    """Samples of |f| that bounce twice a second, without jitter, as in a smoothly carried hand."""
    return uniform_block(9.8 + std_mps2 * math.sqrt(2) * np.sin(4 * np.pi * np.arange(100 * duration_s) / 100))


QUIET = shaking(4, jitter_mps2=0.03)


@pytest.mark.parametrize("duration_s", [3, 7, 30])
def test_unexplained_motion_lasts_from_its_begin_to_the_newest_sample(duration_s: int) -> None:
    state = after(joined(QUIET, shaking(duration_s)))
    assert VIBRATION.stepless_s(state, -np.inf, 4.0 + duration_s) == pytest.approx(duration_s, abs=0.01)
    assert VIBRATION.stepless_s(state, -np.inf, 4.3 + duration_s) == pytest.approx(duration_s + 0.3, abs=0.01)
    # a contact explains the motion before it
    for since_s in (duration_s + 3.4, duration_s + 0.8, 5.2):
        left_s = VIBRATION.stepless_s(state, since_s, 4.0 + duration_s)
        assert left_s == pytest.approx(min(4.0 + duration_s - since_s, duration_s), abs=0.01)


def test_rest_is_no_unexplained_motion_and_a_smooth_bounce_is_until_its_steps_are_decided() -> None:
    assert VIBRATION.stepless_s(after(shaking(60, jitter_mps2=0.05)), -np.inf, 60.0) == 0.0
    assert VIBRATION.stepless_s(after(swaying(60, 0.2)), -np.inf, 60.0) == 0.0
    assert VIBRATION.stepless_s(after(swaying(4, 0.5)), -np.inf, 4.0) == pytest.approx(4.0, abs=0.01)
    # seconds of more than five seconds ago have steps, or their bounce is handling
    assert VIBRATION.stepless_s(after(swaying(60, 0.5)), -np.inf, 60.0) == pytest.approx(5.0, abs=0.01)


def test_handling_leaves_two_seconds_however_often_it_happens_and_a_ride_its_whole_duration() -> None:
    handled = joined(*[shaking(9), QUIET] * 12)
    assert VIBRATION.stepless_s(after(handled), -np.inf, 13.0 * 12) == 2.0
    ridden = joined(QUIET, shaking(40), QUIET, shaking(30), QUIET)
    assert VIBRATION.stepless_s(after(ridden), -np.inf, 82.0) == pytest.approx(70.0)
    # a step ends the doubt
    steps = known_steps(np.arange(60.0, 76.0, 0.6).tolist())
    assert VIBRATION.stepless_s(after(ridden, steps), 75.6, 82.0) == pytest.approx(0.0, abs=2.5)


def stepless_of(steps: list[tuple[int, Step]], *parts: UniformBlock) -> tuple[list[float], list[int]]:
    """Time of motion without steps before each step, and the seconds in which further such motion becomes known."""
    _, events = VIBRATION.update(VIBRATION.init(), joined(*parts), steps)
    before_s = [e.stepless_s for _, e in events if isinstance(e, Step)]
    return before_s, [n // 100 for n, e in events if isinstance(e, Stepless)]


@pytest.mark.parametrize("late_s", [1.0, 4.0])
@pytest.mark.parametrize("moved_s", [3, 12])
def test_a_step_has_the_time_of_motion_since_the_step_before(late_s: float, moved_s: int) -> None:
    quiet = shaking(10, jitter_mps2=0.03)
    steps = known_steps([4.0, 4.6, 25.0 + moved_s, 25.6 + moved_s], late_s)
    parts = swaying(5, 2.0), quiet, swaying(moved_s, 0.5), quiet, swaying(10, 2.0)
    before_s, seconds = stepless_of(steps, *parts)
    # the bounce until the begin of the third step began before that step
    assert before_s == pytest.approx([4.0 - STEP_S, 0.0, moved_s, 0.0], abs=0.02)
    assert [s for s in seconds if s >= 20][:moved_s] == list(range(20, 20 + moved_s))


def test_motion_before_the_first_step_counts_and_that_of_a_second_after_a_step_does_not() -> None:
    moving = swaying(20, 0.5)
    assert stepless_of([], moving) == ([], list(range(5, 20)))
    before_s, _ = stepless_of(known_steps([5.0, 7.5]), moving)
    assert before_s == pytest.approx([5.0 - STEP_S, 7.5 - STEP_S - 6.0], abs=0.02)


def undecided_of(steps: list[tuple[int, Step]], *parts: UniformBlock) -> list[list[float]]:
    """Begin of the motion without known steps, each with the number of seconds after which it became known."""
    _, events = VIBRATION.update(VIBRATION.init(), joined(*parts), steps)
    return [[(n + 1) / 100, round(e.since_s, 1)] for n, e in events if isinstance(e, Undecided)]


def test_motion_is_undecided_until_its_steps_are_known_or_excluded() -> None:
    quiet, moving = shaking(10, jitter_mps2=0.03), swaying(3, 0.5)
    assert undecided_of([], quiet) == []
    excluded = [[11, 10], [16, 11], [17, 12], [18, np.inf]]
    assert undecided_of([], quiet, moving, quiet) == excluded
    known = known_steps([10.5, 11.0, 11.5, 12.0, 12.5], late_s=2.0)
    assert undecided_of(known, quiet, moving, quiet) == [[11, 10], [13, 12], [14, np.inf]]


def test_the_end_of_the_samples_and_a_gap_keep_the_motion_since_the_last_step() -> None:
    state = after(joined(swaying(20, 0.5), QUIET), known_steps([5.0]))
    _, ((_, last),) = VIBRATION.finish(state, known_steps([22.0]))
    assert last.stepless_s == pytest.approx(14.0)
    _, ((_, later),) = VIBRATION.update(VIBRATION.after_gap(state), QUIET, known_steps([3.0]))
    assert later.stepless_s == 13.0  # the seconds of which no step can become known


def test_a_gap_keeps_the_unexplained_motion_before_it() -> None:
    state = VIBRATION.after_gap(after(joined(QUIET, shaking(40), QUIET)))
    assert VIBRATION.stepless_s(VIBRATION.update(state, QUIET, [])[0], -np.inf, 4.0) == pytest.approx(40.0)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 99), edges=st.lists(st.integers(1, 6999), max_size=30))
def test_the_state_is_the_same_however_the_samples_are_cut(seed: int, edges: list[int]) -> None:
    rng = np.random.default_rng(seed)
    block = joined(shaking(30, seed=seed), swaying(15, 0.4), QUIET, shaking(21, seed=seed))
    steps = known_steps(sorted(rng.uniform(5.0, 45.0, 3)), late_s=float(rng.uniform(0.9, 9.0)))
    (whole, events), cut, n = VIBRATION.update(VIBRATION.init(), block, steps), VIBRATION.init(), 0
    of_parts: list[tuple[int, Step | Stepless | Undecided]] = []
    for part in cut_uniform(block, sorted({*edges, *range(100, 7000, 100)})):
        cut, found = VIBRATION.update(cut, part, [s for s in steps if n <= s[0] < n + len(part.time_s)])
        of_parts += found
        n += len(part.time_s)
    assert of_parts == events
    assert (cut.moving_s, cut.seen_s, cut.run_s) == (whole.moving_s, whole.seen_s, whole.run_s)
    for since_s in (-np.inf, 41.3, 68.2):
        assert VIBRATION.stepless_s(cut, since_s, 70.0) == VIBRATION.stepless_s(whole, since_s, 70.0)
    assert len(cut.steps) <= 30


@pytest.mark.recordings
def test_a_trolley_counts_as_moving_and_a_sitting_person_does_not(data_dir: Path) -> None:
    trolley = pdr.track(pdr.read(data_dir / "oxiod" / "oxiod_user1_room_trolley2_1.zip"))
    assert any("the phone moved without steps" in note for note in trolley.notes)
    sitting = pdr.track(pdr.read(data_dir / "motionsense" / "motionsense_s01_sit_5.zip"))
    assert not any("moved without steps" in note for note in sitting.notes)
