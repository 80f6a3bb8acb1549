from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import against_foot_switches, contacts_of, count_error, cut_uniform, detect, times_s, uniform_block

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.guo2018.contexts import PoseContext
from pdr_filter.recipes.guo2018.steps import PoseStepDetector, feature_signals, signal_rows
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import CARRYING_MODES, STANDARD_GRAVITY_MPS2
from pdr_filter.values.recording import Recording

DETECTOR = PoseStepDetector()


def modes(name: str, n: int) -> ContextBlock:
    index = CARRYING_MODES.index(name) if name else -1
    return ContextBlock(np.full(n, 1), np.full(n, index))


def walk(frequency_hz: float, n_steps: int = 24, amplitude_mps2: float = 3.0) -> tuple[np.ndarray, UniformBlock]:
    """Contacts, and a phone face up whose |f| is a sinusoid with its maxima there: rest, steps, rest."""
    n_rest = 300
    n_walk = round(100 * n_steps / frequency_hz)
    t = (np.arange(n_walk) + 0.5) / 100
    swing = -amplitude_mps2 * np.cos(2 * np.pi * frequency_hz * t)
    magnitude = STANDARD_GRAVITY_MPS2 + np.concatenate([np.zeros(n_rest), swing + amplitude_mps2, np.zeros(n_rest)])
    contacts_s = n_rest / 100 + (np.arange(n_steps) + 0.5) / frequency_hz
    return contacts_s, uniform_block(magnitude, rate=np.zeros((len(magnitude), 3)))


def swinging(swing_hz: float, n: int = 2000, amplitude_radps: float = 2.5) -> UniformBlock:
    """A hand that swings about the phone's z-axis, and no bump at the contacts at all."""
    time_s = (np.arange(n) + 0.5) / 100
    rate = np.zeros((n, 3))
    rate[:, 2] = amplitude_radps * np.sin(2 * np.pi * swing_hz * time_s)
    return uniform_block(np.full(n, STANDARD_GRAVITY_MPS2), rate=rate)


def noisy_walk(seed: int, n: int = 1500) -> UniformBlock:
    """Steps in all signals, with noise and a second without angular rate."""
    rng = np.random.default_rng(seed)
    t = (np.arange(n) + 0.5) / 100
    bounce = 3.0 * np.sin(2 * np.pi * 1.9 * t)
    force = np.column_stack([0.4 * bounce, 0.6 * bounce, STANDARD_GRAVITY_MPS2 + bounce]) + rng.normal(0, 0.7, (n, 3))
    rate = rng.normal(0, 0.3, (n, 3)) + 2.0 * np.sin(2 * np.pi * 0.95 * t)[:, None]
    block = uniform_block(np.zeros(n), rate=rate)
    known = np.ones(n, dtype=bool)
    known[700:800] = False
    return replace(block, specific_force_mps2=force, angular_rate_known=known)


# --- the signals ----------------------------------------------------------------------------------------------------


def test_the_signals_are_equations_3_to_6() -> None:
    block = noisy_walk(0, n=5)
    for i, ((x, y, z), (_, _, rate_z)) in enumerate(
        zip(block.specific_force_mps2, block.angular_rate_radps, strict=True)
    ):
        literal = [np.hypot(y, z), np.hypot(x, y), (x**2 + y**2 + z**2) ** 0.5, abs(rate_z)]
        np.testing.assert_allclose(feature_signals(block)[:, i], literal)


def test_each_pose_has_its_signal_and_where_it_is_unknown_or_its_sensor_missing_it_is_the_magnitude() -> None:
    mode = np.array([CARRYING_MODES.index(m) for m in ("texting", "calling", "pocket", "swinging", "bag")] + [-1])
    np.testing.assert_array_equal(signal_rows(mode, np.ones(6, dtype=bool)), [0, 1, 2, 3, 2, 2])
    np.testing.assert_array_equal(signal_rows(mode, np.zeros(6, dtype=bool)), [0, 1, 2, 2, 2, 2])


# --- synthetic steps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pose", ["texting", "pocket", ""])
@pytest.mark.parametrize("frequency_hz", [1.2, 1.6, 2.0, 2.4])
def test_a_contact_is_at_the_maximum_of_the_signal_although_the_low_pass_delays_it(
    pose: str, frequency_hz: float
) -> None:
    contacts_s, block = walk(frequency_hz)
    _, found = detect(DETECTOR, [block], [modes(pose, len(block.time_s))])
    inside = [t for t in times_s(found) if contacts_s[4] - 0.2 < t < contacts_s[-4] + 0.2]
    np.testing.assert_allclose(inside, contacts_s[4:-3], atol=0.02)
    assert abs(len(found) - len(contacts_s)) <= 2  # the low-pass rings where the walk ends
    assert all(step.detected_time_s - step.time_s <= DETECTOR.latency_s for _, step in found)


def test_a_swing_of_the_hand_is_two_steps() -> None:
    block = swinging(0.9)
    _, found = detect(DETECTOR, [block], [modes("swinging", len(block.time_s))])
    assert len(found) == pytest.approx(2 * 0.9 * 20, abs=2)
    np.testing.assert_allclose(np.diff(times_s(found))[2:], 1 / 1.8, atol=0.01)


def test_the_threshold_of_a_pose_decides_in_that_pose_only() -> None:
    # every second bump is half as high: above the mean, but not by much
    t = (np.arange(3000) + 0.5) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + 2 * np.cos(2 * np.pi * 1.5 * t) + 1.2 * np.cos(2 * np.pi * 0.75 * t)
    block = uniform_block(magnitude, rate=np.zeros((3000, 3)))
    strict = PoseStepDetector(texting=0.9)
    of_texting = len(detect(strict, [block], [modes("texting", 3000)])[1])
    of_pocket = len(detect(strict, [block], [modes("pocket", 3000)])[1])
    assert of_texting == pytest.approx(30 * 0.75, abs=2)
    assert of_pocket == pytest.approx(30 * 1.5, abs=2)


def test_who_does_not_move_like_a_walker_makes_no_steps() -> None:
    contacts_s, block = walk(1.8)
    n = len(block.time_s)
    assert detect(PoseStepDetector(min_level=50.0), [block], [modes("texting", n)])[1] == []
    assert detect(PoseStepDetector(max_level=1.0), [block], [modes("texting", n)])[1] == []
    trembling = uniform_block(9.8 + np.random.default_rng(0).normal(0, 0.3, 3000), rate=np.zeros((3000, 3)))
    assert detect(DETECTOR, [trembling], [modes("texting", 3000)])[1] == []
    assert len(contacts_s) > 0


def test_steps_faster_than_people_walk_are_dropped() -> None:
    _, block = walk(2.5, n_steps=40)
    slow = PoseStepDetector(max_step_hz=2.0)
    _, found = detect(slow, [block], [modes("texting", len(block.time_s))])
    assert len(found) == pytest.approx(20, abs=2)  # every second one
    assert np.diff(times_s(found)).min() > 1 / 2.1


def test_a_change_of_pose_on_the_way_neither_loses_nor_doubles_a_step() -> None:
    contacts_s, block = walk(1.8, n_steps=40)
    n = len(block.time_s)
    mode = np.full(n, CARRYING_MODES.index("texting"))
    mode[n // 3 :] = CARRYING_MODES.index("pocket")
    mode[n // 2 :] = -1
    _, found = detect(DETECTOR, [block], [ContextBlock(np.full(n, 1), mode)])
    inside = [t for t in times_s(found) if contacts_s[4] - 0.2 < t < contacts_s[-4] + 0.2]
    np.testing.assert_allclose(inside, contacts_s[4:-3], atol=0.02)


def test_the_last_step_before_the_end_is_given_when_the_segment_is_closed() -> None:
    contacts_s, block = walk(1.8)
    end = int(100 * (contacts_s[-1] + 0.12))
    cut = cut_uniform(block, [end])[0]
    state, found = detect(DETECTOR, [cut], [modes("pocket", end)])
    last = DETECTOR.finish(state)
    assert contacts_s[-1] - times_s(found)[-1] > 0.4
    assert last[-1][1].time_s == pytest.approx(contacts_s[-1], abs=0.06)
    assert all(number == end - 1 and step.detected_time_s <= cut.time_s[-1] for number, step in last)
    assert DETECTOR.finish(DETECTOR.init()) == []


# --- invariance -----------------------------------------------------------------------------------------------------


# --- real recordings ------------------------------------------------------------------------------------------------


def steps_of(recording: Recording, contexts: PoseContext | None) -> np.ndarray:
    return contacts_of(recording, Sensing(steps=DETECTOR, contexts=contexts))


# People 7 to 13 had no say in any constant.
@pytest.mark.parametrize(("place", "at_most_percent"), [("handheld_using", 2.0), ("trousers_front_pocket", 2.0)])
def test_the_count_of_a_walk_is_that_of_the_video(data_dir: Path, place: str, at_most_percent: float) -> None:
    paths = [p for p in (data_dir / "ubicomp13").glob(f"*_{place}.zip") if int(p.stem.split("_p")[1][:2]) >= 7]
    walks = [read(path) for path in sorted(paths)]
    assert len(walks) == 7
    assert 100 * np.mean([abs(count_error(walk, steps_of(walk, PoseContext()))) for walk in walks]) < at_most_percent


@pytest.mark.parametrize("name", ["inhand_2", "frontpocket_1", "swingingarm_1"])
def test_steps_are_where_foot_switches_closed(data_dir: Path, name: str) -> None:
    recording = read(data_dir / "oxford" / f"oxford_jamie_pixel_hard_{name}.zip")
    error, offset_s = against_foot_switches(recording, steps_of(recording, None))
    assert np.mean(np.abs(offset_s) < 0.25) > 0.97
    assert abs(error) < 0.03
