from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step, block_of
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.recipes.tian2016.heading import (
    OffsetCompensation,
    OffsetCompensationState,
    average_angle,
    viewing_direction,
)
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import CARRYING_MODES, Step, wrap_angle

TEXTING, SWINGING, IN_POCKET, UNKNOWN = *(CARRYING_MODES.index(m) for m in ("texting", "swinging", "pocket")), -1
Samples = tuple[UniformBlock, AttitudeBlock, ContextBlock]


# --- averages -------------------------------------------------------------------------------------------------------


def test_the_average_around_zero_is_zero() -> None:
    """Table IV adds a full turn to negative angles before the mean, which gives half a turn here."""
    assert average_angle(np.array([-0.1, 0.1])) == pytest.approx(0.0, abs=1e-12)


@given(st.floats(-np.pi, np.pi), st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=20))
def test_the_average_turns_with_its_angles(turn: float, deviations: list[float]) -> None:
    yaw = np.array(deviations)
    assert abs(wrap_angle(average_angle(wrap_angle(yaw + turn)) - turn - np.mean(yaw))) < 1e-9


# --- the viewing direction ------------------------------------------------------------------------------------------


def phone(
    heading: np.ndarray, pitch: np.ndarray, roll: np.ndarray, modes: np.ndarray | int = TEXTING, seed: int = 0
) -> Samples:
    """A phone whose user looks along `heading`, held at a pitch and a roll, pushed about at random."""
    n = len(heading)
    zero, one = np.zeros(n), np.ones(n)
    turn = np.array(
        [[np.cos(heading), np.sin(heading), zero], [-np.sin(heading), np.cos(heading), zero], [zero, zero, one]]
    )
    tip = np.array([[one, zero, zero], [zero, np.cos(pitch), -np.sin(pitch)], [zero, np.sin(pitch), np.cos(pitch)]])
    lean = np.array([[np.cos(roll), zero, np.sin(roll)], [zero, one, zero], [-np.sin(roll), zero, np.cos(roll)]])
    to_world = np.einsum("ijn,jkn,kln->nil", turn, tip, lean)
    force_world = np.random.default_rng(seed).normal(size=(n, 3)) + np.array([0.0, 0.0, 9.8])
    force = np.einsum("nij,ni->nj", to_world, force_world)
    block = block_of(force, np.zeros((n, 3)))
    attitude = AttitudeBlock(force_world[:, 2] - 9.8, force_world[:, :2], to_world[:, 2], heading)
    return block, attitude, ContextBlock(np.full(n, -1), np.broadcast_to(modes, n).copy())


@pytest.mark.parametrize("pitch", [-0.5, 0.0, 0.7, np.pi / 2, 2.0])
@pytest.mark.parametrize("roll", [0.0])
def test_the_viewing_direction_turns_with_the_user_at_every_pitch_upright_included(pitch: float, roll: float) -> None:
    heading = np.linspace(-10.0, 10.0, 400)
    block, attitude, _ = phone(heading, np.full(400, pitch), np.full(400, roll))
    direction = viewing_direction(block.specific_force_mps2, attitude)
    flat, level, _ = phone(heading, np.zeros(400), np.zeros(400))
    expected = viewing_direction(flat.specific_force_mps2, level)
    np.testing.assert_allclose(wrap_angle(direction - expected), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(np.unwrap(direction)), np.diff(heading), atol=1e-9)


# --- the stage ------------------------------------------------------------------------------------------------------


def steps_at(contacts_s: np.ndarray, samples: Samples, delay_s: float = 0.2) -> list[tuple[int, Step]]:
    """Steps whose device heading is the mean over their samples."""
    heading, n = samples[1].device_heading_rad, len(samples[0].time_s)
    durations_s = np.diff(contacts_s, prepend=contacts_s[0] - 0.5)
    steps = []
    for t, d in zip(contacts_s, durations_s, strict=True):
        a, b = max(round(100 * (t - d)), 0), round(100 * t)
        step = a_step(float(t), heading_rad=float(heading[a:b].mean()), duration_s=float(d))
        steps.append((min(round(100 * (t + delay_s)), n - 1), step))
    return steps


def directed(
    samples: Samples, steps: list[tuple[int, Step]], stage: OffsetCompensation | None = None
) -> tuple[OffsetCompensationState, list[Step]]:
    stage = stage or OffsetCompensation()
    state, annotated = stage.update(stage.init(), *samples, steps)
    assert [i for i, _ in annotated] == [i for i, _ in steps]
    return state, [s for _, s in annotated]


def directions(steps: list[Step]) -> np.ndarray:
    """NaN where nothing is known."""
    known = [np.isfinite(s.walking_heading_std_rad) for s in steps]
    return np.where(known, [s.walking_heading_rad for s in steps], np.nan)


def moved_to(
    mode: int, *, offset_rad: float, sway_rad: float = 0.0, turn_rad: float = 0.0
) -> tuple[Samples, np.ndarray]:
    """A walk at 2 steps a second: 5 s in the hand, 2 s of transition, 13 s in another mode, and its true direction.

    The phone ends up turned by `offset_rad`, sways with the stride, and the person turns at 14 s.
    """
    n = 2000
    time_s = (np.arange(n) + 0.5) / 100
    walk = 0.3 + turn_rad * np.clip(time_s - 14.0, 0.0, 1.0)
    offset = offset_rad * np.clip((time_s - 5.0) / 2.0, 0.0, 1.0)
    sway = np.where(time_s > 7.0, sway_rad * np.sin(2 * np.pi * time_s), 0.0)
    roll = 1.3 * np.clip((time_s - 5.0) / 2.0, 0.0, 1.0)
    modes = np.repeat([TEXTING, UNKNOWN, mode], [500, 200, 1300])
    return phone(walk + offset + sway, np.full(n, 0.4), roll, modes), walk


CONTACTS_S = np.arange(1, 39) * 0.5


def test_a_held_phone_points_where_its_owner_walks() -> None:
    heading = np.linspace(0.0, 12.0, 2000)
    samples = phone(heading, np.full(2000, 0.6), np.zeros(2000))
    _, steps = directed(samples, steps_at(CONTACTS_S, samples))
    # the mean over a step lags by half a step, and nothing is wrapped over two turns
    np.testing.assert_allclose(directions(steps), 12.0 * (CONTACTS_S - 0.25) / 20, atol=0.01)
    assert {s.walking_heading_std_rad for s in steps} == {0.1}
    assert {s.offset_change_std_rad for s in steps} == {0.0}


@pytest.mark.parametrize("offset_rad", [0.05, -1.9, 3.0, 7.0])
@pytest.mark.parametrize("mode", [SWINGING, IN_POCKET])
def test_the_offset_of_a_mode_is_trained_on_the_direction_before_the_transition(mode: int, offset_rad: float) -> None:
    samples, walk = moved_to(mode, offset_rad=offset_rad, turn_rad=2.5)
    _, steps = directed(samples, steps_at(CONTACTS_S, samples))
    truth = walk[np.round(100 * (CONTACTS_S - 0.25)).astype(int)]
    straight = (CONTACTS_S < 14.0) | (CONTACTS_S > 16.0)  # in a pocket two steps are averaged
    np.testing.assert_allclose(directions(steps)[straight], truth[straight], atol=0.02)
    # in the transition and with the first step after it the phone may be turned by anything
    expected = (CONTACTS_S > 5.0) & (CONTACTS_S <= 7.5)
    np.testing.assert_allclose([s.offset_change_std_rad for s in steps], np.where(expected, np.pi / np.sqrt(3), 0.0))


def test_in_a_pocket_the_swing_of_the_leg_averages_out_over_two_steps_but_not_over_one() -> None:
    for mode, good in [(IN_POCKET, True), (SWINGING, False)]:
        samples, walk = moved_to(mode, offset_rad=1.0, sway_rad=0.6)
        _, steps = directed(samples, steps_at(CONTACTS_S, samples))
        error = np.abs(directions(steps) - walk[0])[CONTACTS_S > 10.5]
        assert (error.max() < 0.05) == good


def test_the_first_two_steps_in_a_pocket_are_left_out_while_the_phone_slides_into_place() -> None:
    samples, walk = moved_to(IN_POCKET, offset_rad=1.0)
    time_s = samples[0].time_s
    samples[1].device_heading_rad[:] += np.where((time_s > 7.0) & (time_s < 8.0), 0.8, 0.0)
    steps = steps_at(CONTACTS_S, samples)
    late = CONTACTS_S > 10.5
    good = directions(directed(samples, steps)[1])[late]
    np.testing.assert_allclose(good, walk[0], atol=0.01)
    off = directions(directed(samples, steps, stage=OffsetCompensation(n_omit=0))[1])[late]
    assert np.abs(off - walk[0]).min() > 0.2


def test_during_training_the_direction_is_that_before_the_transition_whatever_the_phone_does() -> None:
    for mode, n_training in [(SWINGING, 3), (IN_POCKET, 6)]:
        # the person turns as soon as the phone is put away: against the paper's assumption
        samples, _ = moved_to(mode, offset_rad=0.0)
        samples[1].device_heading_rad[:] += np.clip(samples[0].time_s - 7.0, 0.0, None)
        _, steps = directed(samples, steps_at(CONTACTS_S, samples))
        after = directions(steps)[CONTACTS_S > 7.0]
        np.testing.assert_array_equal(after[:n_training], directions(steps)[9])
        assert after[n_training] > after[n_training - 1] + 0.1


def test_back_in_the_hand_the_phone_points_ahead_again() -> None:
    samples, walk = moved_to(IN_POCKET, offset_rad=1.0)
    back = replace(samples[2], carrying_mode=np.repeat([TEXTING, UNKNOWN, IN_POCKET, UNKNOWN, TEXTING], 400))
    heading = walk + np.repeat([0.0, 0.5, 1.0, 0.5, 0.0], 400)
    turned = phone(heading, np.full(2000, 0.4), np.zeros(2000), back.carrying_mode)
    _, steps = directed(turned, steps_at(CONTACTS_S, turned))
    np.testing.assert_allclose(directions(steps)[CONTACTS_S > 16.6], 0.3, atol=0.01)


# --- what is not known ----------------------------------------------------------------------------------------------


def test_a_phone_that_was_never_held_has_no_direction() -> None:
    samples = phone(np.zeros(1000), np.zeros(1000), np.zeros(1000), IN_POCKET)
    _, steps = directed(samples, steps_at(CONTACTS_S[:15], samples))
    assert np.isnan(directions(steps)).all()
    assert {s.walking_heading_std_rad for s in steps} == {np.inf}


def test_after_a_gap_a_phone_in_a_pocket_has_no_direction_and_a_held_one_has() -> None:
    stage = OffsetCompensation()
    samples, walk = moved_to(IN_POCKET, offset_rad=1.0)
    state, _ = directed(samples, steps_at(CONTACTS_S, samples))
    for mode, known in [(IN_POCKET, False), (TEXTING, True)]:
        later = phone(np.full(500, walk[0]), np.full(500, 0.4), np.zeros(500), mode)
        _, steps = stage.update(stage.after_gap(state), *later, steps_at(CONTACTS_S[1:8], later))
        direction = directions([s for _, s in steps])
        assert np.isfinite(direction).all() == known
        if known:
            np.testing.assert_allclose(direction, 0.3, atol=0.01)


def test_steps_without_angular_rate_have_no_direction_nor_have_those_that_rely_on_them() -> None:
    samples, _ = moved_to(SWINGING, offset_rad=1.0)
    steps = steps_at(CONTACTS_S, samples)
    blind = [(i, replace(s, heading_unknown_s=0.5) if k == 25 else s) for k, (i, s) in enumerate(steps)]
    _, found = directed(samples, blind)
    assert np.isfinite(directions(found)[:25]).all()
    assert np.isnan(directions(found)[25:]).all()
    _, none = directed(samples, [(i, replace(s, heading_unknown_s=0.5)) for i, s in steps])
    assert np.isnan(directions(none)).all()


def test_steps_that_the_end_reveals_are_directed_too() -> None:
    stage = OffsetCompensation()
    samples, walk = moved_to(IN_POCKET, offset_rad=1.0)
    steps = steps_at(CONTACTS_S, samples)
    state, _ = directed(samples, steps[:-1])
    _, [(number, last)] = stage.finish(state, [(1999, steps[-1][1])])
    assert number == 1999
    assert last.walking_heading_rad == pytest.approx(walk[0], abs=0.01)
