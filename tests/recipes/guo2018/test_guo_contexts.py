from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import uniform_block
from joblib import parallel_config

from models.training.data_sets import recordings_of
from models.training.guo2018_training import DATASETS, kappa, train_guo, walk_threshold
from models.training.sine_people import MODES, simulated_person
from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.formats import read
from pdr_filter.recipes.guo2018.contexts import PoseContext
from pdr_filter.recipes.guo2018.features import NAMES, AmbientSamples, MotionLevel, PoseWindows
from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.values import CARRYING_MODES, CONTEXTS, Samples, WindowContext
from pdr_filter.values.recording import Recording

STAGE = PoseContext()
WALKING, STATIONARY = CONTEXTS.index("walking"), CONTEXTS.index("stationary")


def sensed(recording: Recording) -> list[tuple[UniformBlock, AttitudeBlock]]:
    conditioner, attitudes = Conditioner(), AttitudeEstimator()
    state, found = attitudes.init(), []
    for block in conditioner.update(conditioner.init(), merge_streams(recording))[1]:
        state, attitude = attitudes.update(state, block)
        found.append((block, attitude))
    return found


def windows_of(parts: list[tuple[UniformBlock, AttitudeBlock]], stage: PoseContext = STAGE) -> list[WindowContext]:
    state, found = stage.init(), []
    for block, attitude in parts:
        state, windows = stage.update(state, block, attitude)
        found += [window for _, window in windows]
    return found


def moving(seed: int, n: int = 1200, up: tuple[float, float, float] = (0.0, 0.6, 0.8)) -> UniformBlock:
    rng = np.random.default_rng(seed)
    block = uniform_block(np.zeros(n), rate=rng.normal(0, 0.4, (n, 3)))
    return replace(block, specific_force_mps2=9.8 * np.array(up) + rng.normal(0, 1.5, (n, 3)))


def attitude_of(block: UniformBlock, up: tuple[float, float, float] = (0.0, 0.6, 0.8)) -> AttitudeBlock:
    n = len(block.time_s)
    wobble = 0.05 * np.sin(np.arange(n) / 9.0)[:, None] * np.array([1.0, 0.0, 0.0])
    direction = np.array(up) + wobble
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return AttitudeBlock(np.zeros(n), np.zeros((n, 2)), direction, np.zeros(n))


# --- the level of motion --------------------------------------------------------------------------------------------


def test_the_level_of_motion_is_equation_1() -> None:
    block, stage = moving(0, n=100), MotionLevel()
    _, level, has_rate = stage.update(stage.init(), block)
    assert has_rate.all()
    for i in (0, 7, 58, 59, 60, 99):
        f = block.specific_force_mps2[max(i - 59, 0) : i + 1]
        w = block.angular_rate_radps[max(i - 59, 0) : i + 1]
        literal = np.mean([np.sum((a - f.mean(axis=0)) ** 2) + 9.8 * np.sum(b**2) for a, b in zip(f, w, strict=True)])
        assert level[i] == pytest.approx(literal, abs=1e-10)


def test_without_angular_rate_anywhere_in_the_window_the_level_is_of_the_accelerometer_alone() -> None:
    stage, block = MotionLevel(), moving(2, n=200)
    known = np.ones(200, dtype=bool)
    known[100] = False
    _, level, has_rate = stage.update(stage.init(), replace(block, angular_rate_known=known))
    np.testing.assert_array_equal(has_rate, [not 100 <= i < 160 for i in range(200)])
    f = block.specific_force_mps2[90:150]
    assert level[149] == pytest.approx(f.var(axis=0).sum())


# --- the stage ------------------------------------------------------------------------------------------------------


def test_a_window_comes_every_0_6_s_and_says_that_light_and_proximity_are_missing() -> None:
    block = moving(3)
    found = STAGE.update(STAGE.init(), block, attitude_of(block))[1]
    np.testing.assert_array_equal([last for last, _ in found], np.arange(59, 1200, 60))
    assert found[0][1].time_s == pytest.approx(0.6)
    for _, window in found:
        assert window.model == "guo_pose_without_light_and_proximity"
        assert window.prob.sum() == pytest.approx(1.0) and window.carrying_prob.sum() == pytest.approx(1.0)
        assert window.carrying_prob[CARRYING_MODES.index("bag")] == 0.0


def test_the_pose_is_unknown_before_anybody_walked_and_stays_while_somebody_stands() -> None:
    still = uniform_block(np.full(600, 9.81), rate=np.zeros((600, 3)))
    state, found = STAGE.update(STAGE.init(), still, attitude_of(still))
    for _, window in found:
        np.testing.assert_array_equal(window.carrying_prob, 0.2)
        assert window.prob[STATIONARY] == 1.0
    walk = moving(4, n=600)
    state, walked = STAGE.update(state, walk, attitude_of(walk))
    assert walked[-1][1].prob[WALKING] == 1.0 and walked[-1][1].carrying_prob.max() > 0.5
    state, stood = STAGE.update(state, still, attitude_of(still, up=(1.0, 0.0, 0.0)))
    assert stood[-1][1].prob[STATIONARY] == 1.0
    np.testing.assert_array_equal(stood[-1][1].carrying_prob, walked[-1][1].carrying_prob)
    after = STAGE.update(STAGE.after_gap(state), still, attitude_of(still))[1]
    np.testing.assert_array_equal(after[0][1].carrying_prob, 0.2)


def test_what_shakes_more_than_anybody_walks_is_not_walking() -> None:
    shaken = moving(5)
    shaken = replace(shaken, specific_force_mps2=30.0 * shaken.specific_force_mps2)
    assert all(w.prob[STATIONARY] == 1.0 for _, w in STAGE.update(STAGE.init(), shaken, attitude_of(shaken))[1])


@dataclass(frozen=True)
class NearTheEar(Machine):
    """Calling where the mean proximity of the window is zero, else texting."""

    n_features = len(NAMES)
    n_classes = 2

    def _predict(self, rows: np.ndarray) -> np.ndarray:
        near = rows[:, NAMES.index("mean_proximity")] == 0.0
        return np.column_stack([near, ~near]).astype(float)


def test_a_model_of_all_18_features_sees_the_light_and_proximity_of_a_recording() -> None:
    block = moving(7, 600)
    parts, time_s, change_s = [(block, attitude_of(block))], block.time_s, 3.0
    near = Samples(np.array([time_s[0], change_s]), np.array([[5.0], [0.0]]))
    light = Samples(np.array([time_s[0] + 1.0]), np.array([[120.0]]))  # holds before, too
    walk = Recording("walk", Samples(time_s, block.specific_force_mps2))
    ambient = AmbientSamples.of(replace(walk, light=light, proximity=near))
    prior = np.array([0.5 * (mode in ("calling", "texting")) for mode in CARRYING_MODES])
    model = ContextModel(
        "own", NAMES, ("calling", "texting"), prior, np.zeros(18), np.ones(18),
        NearTheEar(), {}, head="carrying_mode",
    )  # fmt: skip
    stage = PoseContext(windows=PoseWindows(ambient=ambient), model=model)
    _, found = stage.windows.update(stage.windows.init(), *parts[0])
    np.testing.assert_allclose([w.features[NAMES.index("mean_light")] for _, w in found], 120.0)
    twelve = PoseContext(windows=PoseWindows(ambient=ambient))
    for own, plain in zip(windows_of(parts, twelve), windows_of(parts), strict=True):
        np.testing.assert_array_equal(own.carrying_prob, plain.carrying_prob)
    walking = [w for w in windows_of(parts, stage) if w.prob[WALKING] == 1.0]
    assert len(walking) >= 8
    for window in walking:
        if not change_s <= window.time_s <= change_s + 0.6:
            mode = CARRYING_MODES[int(window.carrying_prob.argmax())]
            assert mode == ("calling" if window.time_s > change_s else "texting")
    assert {w.model for w in walking} == {"own"}
    with pytest.raises(ValueError, match="needs light and proximity"):
        PoseContext(model=model)
    with pytest.raises(ValueError, match="has no light"):
        AmbientSamples.of(walk)


def test_only_a_model_of_pitch_and_roll_is_taken() -> None:
    with pytest.raises(ValueError, match="12 features"):
        PoseContext(model=load_model("carrying"))


# --- the model ------------------------------------------------------------------------------------------------------


def test_the_shipped_model_is_small_quick_and_made_of_recordings_with_a_licence() -> None:
    model = load_model("guo_pose")
    folder = Path(__file__).resolve().parents[3] / "models"
    assert (folder / "guo_pose.npz").stat().st_size < 300_000
    assert set(model.card["data"]) == set(DATASETS) and "ubicomp13" not in DATASETS
    row, best_s = np.linspace(-1, 1, 12), np.inf
    for _ in range(20):
        start_s = time.perf_counter()
        model.predict(row)
        best_s = min(best_s, time.perf_counter() - start_s)
    assert best_s < 1e-3


def test_the_thresholds_of_the_stage_and_the_detector_are_those_on_the_card() -> None:
    from pdr_filter.recipes.guo2018.steps import PoseStepDetector

    card = load_model("guo_pose").card["walk_detection"]
    for stage in (STAGE, PoseStepDetector()):
        assert stage.min_level == pytest.approx(card["min_level"], abs=0.005)
        assert stage.min_level_accelerometer == pytest.approx(card["min_level_accelerometer"], abs=0.005)
        assert stage.max_level > card["highest_level_of_movement"]


@pytest.mark.parametrize("mode", MODES)
def test_simulated_people_who_were_not_in_training_are_mostly_told(mode: str) -> None:
    right: list[bool] = []
    for number in range(900, 905):
        for window in windows_of(sensed(simulated_person(mode, number))):
            if window.prob[WALKING] == 1.0:
                right.append(CARRYING_MODES[int(window.carrying_prob.argmax())] == mode)
    assert len(right) > 150
    # one in eight texts with the phone across, and pitch and roll know little of a pocket and a swinging hand
    assert np.mean(right) > {"texting": 0.75, "calling": 0.75, "swinging": 0.6, "pocket": 0.6}[mode]


# --- training -------------------------------------------------------------------------------------------------------


def test_the_threshold_lies_between_rest_and_movement_and_says_whom_it_misses() -> None:
    level = np.concatenate([np.linspace(0.1, 0.5, 50), np.linspace(2.0, 9.0, 50), [0.3, 5.0]])
    is_moving = np.repeat([False, True, True], [50, 50, 2])
    place = np.repeat(["", "a", "b"], [50, 50, 2])
    threshold, recall = walk_threshold(level[:100], is_moving[:100], place[:100])
    assert 0.5 <= threshold < 2.0 and recall == {"stationary": 1.0, "a": 1.0}
    assert walk_threshold(level, is_moving, place)[1]["b"] in (0.5, 1.0)


def test_kappa_is_one_for_all_right_and_zero_for_one_answer() -> None:
    truth = np.array(["texting", "pocket", "pocket", "texting"])
    prob = np.zeros((4, 5))
    prob[range(4), [CARRYING_MODES.index(t) for t in truth]] = 1.0
    assert kappa(truth, prob) == 1.0
    assert kappa(truth, np.tile([1.0, 0, 0, 0, 0], (4, 1))) == 0.0


def test_a_small_training_writes_a_model_with_a_card_of_people_left_out(tmp_path: Path) -> None:
    people = [("motionsense", "a", "pocket"), ("motionsense", "b", "pocket"), ("tyrex", "t", "swinging")]
    people += [("humolire", "h", "texting"), ("elsewhere", "e", "calling")]
    for number, (dataset, subject, mode) in enumerate(people):
        recording = simulated_person(mode, 500 + number)
        meta: dict[str, Any] = {**recording.meta, "dataset": dataset, "subject": {"id": subject}}
        name = f"{dataset}_{subject}"
        (tmp_path / dataset).mkdir(exist_ok=True)
        write_recording(replace(recording, name=name, meta={**meta, "name": name}), tmp_path / dataset / f"{name}.zip")
    paths = [*recordings_of(tmp_path, DATASETS), tmp_path / "elsewhere" / "elsewhere_e.zip"]
    told: list[float] = []
    with parallel_config(backend="threading"):
        card = train_guo(paths, tmp_path / "models", lambda _, done: told.append(done), n_simulated=1)
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)
    assert card["n_windows"]["calling"] == 0  # the recording of another data set is not used
    assert set(card["made_windows"]) == {
        "simulated", "turned_humolire", "over_motionsense", "mirrored_motionsense", "mirrored_tyrex",
        "mirrored_humolire",
    }  # fmt: skip
    assert set(card["site_left_out"]) == {"tyrex", "humolire"}
    model = load_model(tmp_path / "models" / "guo_pose.npz")
    assert PoseContext(model=model).name == STAGE.name
    assert model.predict(np.zeros(12)).sum() == pytest.approx(1.0)


def test_a_training_without_recordings_says_what_it_needs() -> None:
    with pytest.raises(ValueError, match="truth_labels"):
        train_guo([], Path("nowhere"), n_simulated=0)


# --- real recordings: none of them was in training ------------------------------------------------------------------


@pytest.mark.parametrize(("place", "mode"), [("handheld_using", "texting"), ("trousers_front_pocket", "pocket")])
def test_the_pose_of_people_of_another_data_set_is_told(data_dir: Path, place: str, mode: str) -> None:
    right: list[bool] = []
    walking: list[float] = []
    for path in sorted((data_dir / "ubicomp13").glob(f"*_{place}.zip"))[::3]:
        recording = read(path)
        [segment] = recording.truth.segments
        for w in windows_of(sensed(recording)):
            if segment.start_s < w.time_s - 0.6 and w.time_s < segment.end_s:
                right.append(CARRYING_MODES[int(w.carrying_prob.argmax())] == mode)
                walking.append(w.prob[WALKING])
    assert len(right) > 250
    assert np.mean(right) > 0.9
    assert np.mean(walking) > 0.98
