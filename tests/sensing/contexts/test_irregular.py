from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import imu
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation
from sklearn.metrics import roc_auc_score

from pdr_filter.data.io.formats import read
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.irregular_motion import (
    GATE,
    GATE_ACCELEROMETER,
    IrregularGate,
    irregular_prob,
)
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindow, FeatureWindows
from pdr_filter.sensing.features.invariant import NAMES, WITHOUT_GYROSCOPE
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import STANDARD_GRAVITY_MPS2, ImuBlock

WINDOWS = FeatureWindows(features=ATTITUDE_FREE)
GATES = {"gyroscope": GATE, "accelerometer": GATE_ACCELEROMETER}
each_gate = pytest.mark.parametrize("gate", GATES.values(), ids=list(GATES))

# Features of a window of ubicomp13 in which a phone is handled, and the probability computed where the gate was fitted.
CHECKS = {
    "gyroscope": ((-2.8733, -1.1923, -1.9717, -2.1371, 0.2346, 0.9775, 11.1695, -0.0021), 0.999685),
    "accelerometer": ((-2.7528, -3.2898, -3.1186, -2.0576, 0.2272, 0.2800, -0.7182, -0.8843), 0.999502),
}


def moving(gate: IrregularGate, of_logit: np.ndarray) -> np.ndarray:
    """Features in the order of `names`, of a window that is not still."""
    return np.concatenate([of_logit, gate.still_below + 1.0])


def windows(block: ImuBlock) -> list[FeatureWindow]:
    return list(feature_windows(WINDOWS, [block]))


def probs(block: ImuBlock) -> np.ndarray:
    return np.array([irregular_prob(w.names, w.features, w.has_gyroscope) for w in windows(block)])


def handled(seed: int, with_gyroscope: bool = True) -> ImuBlock:
    """Samples of a phone that a hand turns to and fro by up to 90 degrees in one or two seconds and hardly lifts."""
    rng = np.random.default_rng(seed)
    t = np.arange(1600) / 100
    angles = np.array(
        [[rng.normal(0, 0.5) * np.sin(f * t + rng.uniform(0, 6)) for f in (1.1, 2.3, 3.1)] for _ in "xyz"]
    )
    turn = Rotation.from_rotvec(angles.sum(axis=1).T)
    force = turn.inv().apply([0.0, 0.0, STANDARD_GRAVITY_MPS2]) + rng.normal(0, 0.15, (1600, 3))
    rate = np.vstack([(turn[:-1].inv() * turn[1:]).as_rotvec() * 100, np.zeros(3)])
    return imu(t, force, rate if with_gyroscope else None)


@pytest.mark.parametrize("name", GATES)
def test_the_check_vectors_have_the_probabilities_of_the_fit(name: str) -> None:
    features, expected = CHECKS[name]
    assert GATES[name].prob(moving(GATES[name], np.array(features))) == pytest.approx(expected, abs=2e-6)


@each_gate
@settings(max_examples=50, deadline=None)
@given(x=arrays(float, 8, elements=st.floats(-30, 30)))
def test_the_probability_equals_its_literal_formula(gate: IrregularGate, x: np.ndarray) -> None:
    logit = gate.intercept
    for value, mean, scale, weight in zip(x, gate.mean, gate.scale, gate.weight, strict=True):
        logit += weight * min(max((value - mean) / scale, -4.0), 4.0)
    p = gate.prob(moving(gate, x))
    assert p == pytest.approx(1 / (1 + math.exp(-logit)), rel=1e-9)
    assert 0 < p <= 1


@each_gate
def test_a_window_is_still_only_if_all_features_of_stillness_are_low(gate: IrregularGate) -> None:
    limit = gate.still_below
    assert gate.prob(np.concatenate([gate.mean, limit - 0.01])) == 0.0
    for moves in ([0.01, -0.01], [-0.01, 0.01], [0.0, 0.0]):
        assert gate.prob(np.concatenate([gate.mean, limit + moves])) > 0


@each_gate
def test_names_are_those_of_the_features(gate: IrregularGate) -> None:
    assert set(gate.names) <= set(NAMES)
    assert len(set(gate.feature_names)) == len(gate.feature_names) == 8
    assert set(GATE_ACCELEROMETER.names) <= set(WITHOUT_GYROSCOPE)


@pytest.mark.parametrize("has_gyroscope", [True, False])
def test_features_are_looked_up_by_name(has_gyroscope: bool) -> None:
    gate = GATE if has_gyroscope else GATE_ACCELEROMETER
    features = np.random.default_rng(0).normal(size=len(NAMES))
    expected = gate.prob(features[[NAMES.index(n) for n in gate.names]])
    assert irregular_prob(NAMES, features, has_gyroscope) == expected
    assert irregular_prob(NAMES[::-1], features[::-1], has_gyroscope) == expected
    if not has_gyroscope:
        n = len(WITHOUT_GYROSCOPE)
        assert irregular_prob(WITHOUT_GYROSCOPE, features[:n], has_gyroscope) == expected


@each_gate
def test_nan_and_a_wrong_number_of_features_are_refused(gate: IrregularGate) -> None:
    features = moving(gate, gate.mean)
    features[2] = np.nan
    with pytest.raises(ValueError, match=gate.feature_names[2]):
        gate.prob(features)
    with pytest.raises(ValueError, match=r"columns that .* lists"):
        gate.prob(gate.mean)


def test_the_parameters_of_a_gate_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        GATE.weight[0] = 0.0


# --- from samples -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_gyroscope", [True, False])
def test_a_phone_on_the_table_is_not_irregular(with_gyroscope: bool) -> None:
    rng = np.random.default_rng(0)
    force = rng.normal([0.0, 0.0, STANDARD_GRAVITY_MPS2], 0.02, (1000, 3))
    rate = rng.normal(0, 0.002, (1000, 3))
    found = probs(imu(np.arange(1000) / 100, force, rate if with_gyroscope else None))
    np.testing.assert_array_equal(found, np.zeros(len(found)))


@pytest.mark.parametrize("with_gyroscope", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_phone_that_is_turned_about_is_irregular(seed: int, with_gyroscope: bool) -> None:
    found = probs(handled(seed, with_gyroscope))
    assert np.median(found) > 0.9
    assert (found > 0.5).all()


@pytest.mark.parametrize("with_gyroscope", [True, False])
@pytest.mark.parametrize("carrying_mode", ["texting", "pocket"])
def test_a_simulated_walk_is_not_irregular(carrying_mode: str, with_gyroscope: bool) -> None:
    recording = simulate([Leg("walking", duration_s=30.0)], carrying_mode=carrying_mode, seed=1)
    if not with_gyroscope:
        recording = replace(recording, gyroscope=None)
    found = probs(merge_streams(recording))
    assert np.median(found) < 0.1
    assert (found > 0.5).mean() < 0.1


@pytest.mark.recordings
@pytest.mark.parametrize(("with_gyroscope", "least_auc", "least_recall"), [(True, 0.985, 0.90), (False, 0.98, 0.88)])
def test_irregular_motion_of_persons_outside_the_fit_is_recognised(
    data_dir: Path, with_gyroscope: bool, least_auc: float, least_recall: float
) -> None:
    """Check the figures in the docstring of the module, with a margin."""
    irregular: list[float] = []
    gait: list[float] = []
    for person in range(7, 14):
        for path in sorted((data_dir / "ubicomp13").glob(f"ubicomp13_p{person:02d}_*.zip")):
            recording = read(path)
            assert recording.truth.segments is not None
            [segment] = recording.truth.segments
            block = merge_streams(recording if with_gyroscope else replace(recording, gyroscope=None))
            for window in windows(block):
                if window.has_gyroscope == with_gyroscope:
                    p = irregular_prob(window.names, window.features, with_gyroscope)
                    if window.time_s - 2 >= segment.start_s and window.time_s <= segment.end_s:
                        gait.append(p)
                    elif p > 0 and (window.time_s < segment.start_s - 1 or window.time_s - 2 > segment.end_s + 1):
                        irregular.append(p)
    assert min(len(irregular), len(gait)) > 700
    truth = np.repeat([1, 0], [len(irregular), len(gait)])
    assert roc_auc_score(truth, [*irregular, *gait]) > least_auc
    assert np.mean(np.array(irregular) > 0.5) > least_recall
    assert np.mean(np.array(gait) > 0.5) < 0.05
