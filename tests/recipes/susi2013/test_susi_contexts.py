from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import block_of, conditioned, flat_attitude, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.susi2013.contexts import (
    MODES,
    TREE,
    TREE_ACCELEROMETER,
    TREE_FEATURES,
    MotionModes,
    Node,
    tree_features,
)
from pdr_filter.recipes.susi2013.features import NAMES, MotionWindow, dominance
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CARRYING_MODES, CONTEXTS, WindowContext
from pdr_filter.values.recording import Recording

WALKING, STATIONARY = CONTEXTS.index("walking"), CONTEXTS.index("stationary")
SWINGING = CARRYING_MODES.index("swinging")


def window(variance_acc: float, variance_gyro: float, has_gyroscope: bool = True, **more: float) -> MotionWindow:
    features = np.zeros(len(NAMES))
    features[NAMES.index("variance_acc")] = variance_acc
    features[NAMES.index("variance_gyro")] = variance_gyro
    features[NAMES.index("dominant_frequency_1_acc_hz")] = more.get("frequency_hz", 1.8)
    dominant = np.array([more.get("dominance_acc", 0.85), more.get("dominance_gyro", 0.85)])
    return MotionWindow(0.0, 2.56, features, has_gyroscope, dominant, more.get("rotation_energy", 2 * variance_gyro))


def assessed(blocks: list[UniformBlock]) -> list[tuple[int, WindowContext]]:
    stage = MotionModes()
    state, found = stage.init(), []
    for block in blocks:
        if np.isfinite(block.gap_before_s) and block.gap_before_s > 0:
            state = stage.after_gap(state)
        state, windows = stage.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]))
        found += windows
    return found


def mode_of(context: WindowContext) -> str:
    if context.irregular_prob > 0.5:
        return "irregular"
    if context.prob[STATIONARY] > 0.5:
        return "static"
    return "swinging" if context.carrying_prob[SWINGING] > 0.5 else "arm_at_rest"


def modes_in(recording: Recording, start_s: float, end_s: float) -> list[str]:
    """Motion modes of the windows wholly inside a stretch of time."""
    windows = [w for _, w in assessed(conditioned(recording))]
    return [mode_of(w) for w in windows if w.time_s - 2.56 >= start_s and w.time_s <= end_s]


def share(modes: list[str], mode: str) -> float:
    assert len(modes) > 30
    return modes.count(mode) / len(modes)


# --- the tree -------------------------------------------------------------------------------------------------------


def test_tree_features_are_logarithms_dominances_and_the_ratio_to_the_frequency_of_gait() -> None:
    given_ = window(np.e**2, np.e, frequency_hz=3.6, rotation_energy=np.e**3, dominance_acc=0.4, dominance_gyro=0.6)
    assert len(TREE_FEATURES) == 6
    np.testing.assert_allclose(tree_features(given_), [2.0, 1.0, 3.0, 0.4, 0.6, np.log(2.0)])
    slow = tree_features(window(1.0, 1.0, frequency_hz=0.9))
    np.testing.assert_allclose(slow[5], np.log(2.0))


def test_a_window_without_any_motion_has_finite_features() -> None:
    empty = window(0.0, 0.0, frequency_hz=0.0, rotation_energy=0.0)
    assert np.isfinite(tree_features(empty)).all()
    assert TREE.classify(empty) == TREE_ACCELEROMETER.classify(empty) == "static"


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_a_node_is_a_linear_test(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights, bias, x = rng.normal(size=6), float(rng.normal()), rng.normal(size=6)
    expected = sum(w * v for w, v in zip(weights.tolist(), x.tolist(), strict=True)) + bias > 0
    assert Node(tuple(weights.tolist()), bias).passes(x) == expected


@pytest.mark.parametrize("tree", [TREE, TREE_ACCELEROMETER])
@pytest.mark.parametrize("mode", MODES)
def test_the_probabilities_of_each_leaf_add_up_and_its_own_mode_has_most(tree: object, mode: str) -> None:
    assert isinstance(tree, type(TREE))
    prob = tree.prob(mode)
    assert sum(prob.values()) == pytest.approx(1.0)
    # without angular rate no window comes to the leaf of the swinging arm
    if not (tree is TREE_ACCELEROMETER and mode == "swinging"):
        assert max(prob, key=lambda m: prob[m]) == mode


# --- what is said of a window ---------------------------------------------------------------------------------------


def test_each_mode_becomes_a_context_a_carrying_mode_and_irregular_motion() -> None:
    stage = MotionModes()
    static, rest, swinging, irregular = (
        stage.assess(None, w)[1]
        for w in (
            window(0.001, 0.001),
            window(3.0, 0.05, rotation_energy=0.3),
            window(3.0, 0.5, rotation_energy=3.5),
            window(0.5, 1.0, dominance_acc=0.5, dominance_gyro=0.7, frequency_hz=4.0),
        )
    )
    for each in (static, rest, swinging, irregular):
        assert each.prob.sum() == pytest.approx(1.0)
        assert each.carrying_prob.sum() == pytest.approx(1.0)
        assert each.model == "susi2013"
        assert each.carrying_prob[CARRYING_MODES.index("pocket")] == 0.0
    assert static.prob[STATIONARY] > 0.9
    assert static.irregular_prob < 0.1
    assert irregular.prob[STATIONARY] > 0.8
    assert irregular.irregular_prob > 0.8
    assert min(rest.prob[WALKING], swinging.prob[WALKING]) > 0.8
    assert swinging.carrying_prob[SWINGING] > 0.8
    at_rest = [rest.carrying_prob[CARRYING_MODES.index(m)] for m in ("texting", "calling", "bag")]
    np.testing.assert_allclose(at_rest, at_rest[0])
    assert rest.carrying_prob[SWINGING] < 0.1


def test_without_angular_rate_walking_has_no_carrying_mode() -> None:
    context = MotionModes().assess(None, window(3.0, 0.0, has_gyroscope=False, dominance_gyro=0.0))[1]
    assert context.model == "susi2013_accelerometer"
    assert context.prob[WALKING] > 0.8
    held = [context.carrying_prob[CARRYING_MODES.index(m)] for m in ("texting", "calling", "swinging", "bag")]
    np.testing.assert_allclose(held, 0.25, atol=0.01)


def test_one_window_is_given_every_128_samples_with_its_last_sample() -> None:
    found = assessed([block_of(np.tile([0.0, 0.0, 9.81], (700, 1)), np.zeros((700, 3)))])
    assert [last for last, _ in found] == [255, 383, 511, 639]
    assert [mode_of(w) for _, w in found] == ["static"] * 4


def test_after_a_gap_nothing_of_before_is_left() -> None:
    rng = np.random.default_rng(0)
    before = block_of(rng.normal([0, 0, 9.8], 3.0, (300, 3)), rng.normal(size=(300, 3)))
    after = uniform_block(np.full(300, 9.81), rate=np.zeros((300, 3)), gap_before_s=5.0, start_s=8.0)
    _, with_gap = assessed([before, after])[-1]
    _, alone = assessed([after])[-1]
    np.testing.assert_array_equal(with_gap.prob, alone.prob)
    assert mode_of(with_gap) == "static"


@pytest.mark.parametrize(
    ("leg", "carrying", "expected"),
    [
        (Leg("walking", distance_m=80.0), "texting", "arm_at_rest"),
        (Leg("walking", distance_m=80.0), "swinging", "swinging"),
        (Leg("stationary", duration_s=50.0), "texting", "static"),
    ],
)
def test_a_simulated_recording_has_the_mode_it_was_made_with(leg: Leg, carrying: str, expected: str) -> None:
    recording = simulate([leg], carrying_mode=carrying, seed=1)
    assert share(modes_in(recording, 3.0, recording.duration_s - 3.0), expected) > 0.8


def test_a_phone_that_is_turned_at_random_by_somebody_who_stands_is_irregular() -> None:
    # slow random turns of about 1 rad/s, the phone's own acceleration below 1 m/s2
    rng = np.random.default_rng(2)
    smooth = np.ones(40) / 40
    rate = 8.0 * np.stack([np.convolve(rng.normal(size=5039), smooth, mode="valid") for _ in range(3)], axis=1)
    turn = Rotation.identity()
    force = np.empty((5000, 3))
    for i, omega in enumerate(rate):
        turn = turn * Rotation.from_rotvec(omega / 100)
        force[i] = turn.inv().apply([0.0, 0.0, 9.81])
    force += 2.0 * np.stack([np.convolve(rng.normal(size=5039), smooth, mode="valid") for _ in range(3)], axis=1)
    assert share([mode_of(w) for _, w in assessed([block_of(force, rate)])], "irregular") > 0.8


# --- how much repeats -----------------------------------------------------------------------------------------------


def test_the_dominance_of_a_sinusoid_is_one_of_noise_small_and_of_nothing_zero() -> None:
    t = np.arange(256) / 100
    sinusoid = 3.0 + np.sin(2 * np.pi * 25 / 2.56 * t)
    noise = np.random.default_rng(0).normal(size=256)
    of_sinusoid, of_noise, of_nothing = dominance(np.stack([sinusoid, noise, np.full(256, 9.81)]))
    assert of_sinusoid == pytest.approx(1.0)
    assert of_noise < 0.35
    assert of_nothing == 0.0


# --- real recordings that the tree was not trained on ---------------------------------------------------------------


@pytest.mark.recordings
def test_the_walks_of_humolire_that_were_not_trained_on_are_of_an_arm_at_rest(data_dir: Path) -> None:
    for name in ("1f", "3r"):
        recording = read(data_dir / "humolire" / f"humolire_user1_{name}.zip")
        assert share(modes_in(recording, 3.0, recording.duration_s - 3.0), "arm_at_rest") > 0.95


@pytest.mark.recordings
def test_a_swinging_arm_is_found_with_and_never_without_angular_rate(data_dir: Path) -> None:
    recording = read(data_dir / "tyrex" / "tyrex_thibaud_nexus5_dist_swinging.zip")
    assert share(modes_in(recording, 4.0, 122.0), "swinging") > 0.85
    recording = read(data_dir / "oxford" / "oxford_jamie_pixel_hard_swingingarm_1.zip")
    assert share(modes_in(recording, 4.0, 140.0), "arm_at_rest") > 0.95


@pytest.mark.recordings
@pytest.mark.parametrize("person", [9, 11])
def test_people_who_were_not_trained_on_walk_in_their_walks_and_handle_the_phone_outside(
    data_dir: Path, person: int
) -> None:
    walking, outside = [], []
    for path in sorted((data_dir / "ubicomp13").glob(f"ubicomp13_p{person:02d}_*hand*.zip")):
        recording = read(path)
        assert recording.truth.segments is not None
        [segment] = recording.truth.segments
        walking += modes_in(recording, segment.start_s, segment.end_s)
        outside += modes_in(recording, -1.0, segment.start_s - 1) + modes_in(recording, segment.end_s + 1, np.inf)
    assert share(walking, "arm_at_rest") > 0.9
    assert share(outside, "irregular") + share(outside, "static") > 0.85
