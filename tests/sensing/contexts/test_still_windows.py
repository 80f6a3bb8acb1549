"""Windows without motion are recognised by two standard deviations, and no step or context is lost after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from data_folder import DATA, DataSets
from helpers import block_of, cut_randomly, imu, run_stage

import pdr_filter as pdr
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts, attitude_free_contexts, stage_of
from pdr_filter.sensing.features.feature_windows import AttitudeFreeFeatures
from pdr_filter.tracking.filtering import Output, finish_filter, init_filter, update_filter
from pdr_filter.values import FloatArray, ImuBlock

HOP_S = 1.0
REST_S, WALK = 12.0, slice(3000, 3800)


def walk_between_rests(phase_s: float) -> ImuBlock:
    """Rest on a table, from one sample to the next the middle of a walk, and rest again."""
    walk = pdr.merge_streams(pdr.simulate.demo_walk())
    rng, n_before, n_after = np.random.default_rng(1), round(100 * (REST_S + phase_s)), round(100 * REST_S)

    def around(moving: FloatArray, mean: FloatArray, std: float) -> FloatArray:
        before, after = (mean + rng.normal(0.0, std, (n, 3)) for n in (n_before, n_after))
        return np.concatenate([before, moving[WALK], after])

    # No other attitude at rest, which VQF would follow for some seconds after the motion.
    force = around(walk.specific_force_mps2, walk.specific_force_mps2[WALK].mean(axis=0), 0.03)
    rate = around(walk.angular_rate_radps, np.array([0.003, -0.002, 0.001]), 0.002)
    return imu(0.01 * np.arange(len(force)), force, rate)


def filtered(config: pdr.Config, blocks: Sequence[ImuBlock]) -> Output:
    """All rows and windows of a filter."""
    state, whole = init_filter(config), Output()
    for block in blocks:
        state, output = update_filter(config, state, block)
        whole.extend(output)
    whole.extend(finish_filter(config, state)[1])
    return whole


def all_described() -> pdr.Config:
    """The default, but no window is still."""
    config, stage = pdr.recipes.default(), attitude_free_contexts()
    stage = replace(stage, windows=replace(stage.windows, still_mps2=0.0, still_radps=0.0))
    return replace(config, sensing=replace(config.sensing, contexts=stage))


def rows(output: Output) -> FloatArray:
    return np.array([(u.step.time_s, *u.position_m, *u.position_cov_m2.ravel()) for u in output.updates])


def context_prob(output: Output) -> FloatArray:
    return np.array([window.prob for window in output.windows])


def described_counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of windows whose features are computed from now on."""
    counts, describe = list[int](), AttitudeFreeFeatures.describe

    def counting(self: AttitudeFreeFeatures, windows: FloatArray, rate_hz: float) -> FloatArray:
        counts.append(len(windows))
        return describe(self, windows, rate_hz)

    monkeypatch.setattr(AttitudeFreeFeatures, "describe", counting)
    return counts


@pytest.mark.parametrize("phase_s", np.arange(0.0, HOP_S, 0.1).round(1))
def test_a_walk_that_begins_abruptly_after_a_rest_loses_no_step_and_no_context(phase_s: float) -> None:
    block = walk_between_rests(phase_s)
    found, expected = (filtered(config, [block]) for config in (pdr.recipes.default(), all_described()))
    assert len(found.updates) >= 10
    np.testing.assert_array_equal(rows(found), rows(expected))
    differs = (context_prob(found) != context_prob(expected)).any(axis=1)
    assert differs.sum() >= 18
    assert (context_prob(found)[differs] == context_prob(found)[0]).all()
    np.testing.assert_allclose(context_prob(found), context_prob(expected), atol=1e-3)


def test_rests_have_the_same_bits_however_samples_arrive() -> None:
    block, config = walk_between_rests(0.3), pdr.recipes.default()
    whole = filtered(config, [block])
    for blocks in (cut_randomly(block, 1, 7), cut_randomly(block, 2, 300)):
        parts = filtered(config, blocks)
        np.testing.assert_array_equal(rows(parts), rows(whole))
        np.testing.assert_array_equal(context_prob(parts), context_prob(whole))
        for part, window in zip(parts.windows, whole.windows, strict=True):
            np.testing.assert_array_equal(part.carrying_prob, window.carrying_prob)


def test_only_windows_with_motion_are_described(monkeypatch: pytest.MonkeyPatch) -> None:
    block, config = walk_between_rests(0.5), pdr.recipes.default()
    filtered(config, [block])  # computes the features of a motionless phone, which takes one window
    counts = described_counts(monkeypatch)
    windows = filtered(config, [block]).windows
    # eight seconds, and at each end the hop in which the walk begins or ends and the overlap
    assert len(windows) == 31
    assert sum(counts) <= 8 + 2 + 1


@pytest.mark.parametrize(
    ("force_mps2", "rate_radps", "is_still"),
    [(0.02, 0.003, True), (0.06, 0.003, False), (0.02, 0.01, False), (0.06, 0.01, False)],
)
def test_a_window_is_still_if_neither_force_nor_rate_varies(
    force_mps2: float, rate_radps: float, is_still: bool
) -> None:
    rng, stage = np.random.default_rng(0), attitude_free_contexts().windows
    # The mean of a gyroscope is its bias, and a force may point anywhere.
    force = np.array([5.0, -3.0, 8.0]) + rng.normal(0.0, force_mps2, (200, 3))
    rate = np.array([0.05, 0.0, -0.1]) + rng.normal(0.0, rate_radps, (200, 3))
    _, [(_, window)] = run_stage(stage, [block_of(force, rate)])
    assert window.is_still == is_still


def test_without_gyroscope_a_window_is_still_if_the_force_does_not_vary() -> None:
    rng, config = np.random.default_rng(0), pdr.recipes.default()
    force = np.array([5.0, -3.0, 8.0]) + rng.normal(0.0, 0.02, (1000, 3))
    windows = filtered(config, [imu(0.01 * np.arange(1000), force)]).windows
    assert len(windows) >= 8
    for window in windows:
        np.testing.assert_array_equal(window.prob, windows[0].prob)
        assert window.model == "context_accelerometer"
    assert windows[0].prob[0] > 0.99


def test_a_still_window_gives_no_evidence_of_the_carrying_mode() -> None:
    models = attitude_free_contexts().models
    _, [(_, rest)] = run_stage(attitude_free_contexts().windows, [block_of(np.full((200, 3), 5.0), np.zeros((200, 3)))])
    assert rest.is_still
    known, before = models.init() > 0, np.array([0.9, 0.1, 0.0, 0.0, 0.0])
    after, window = models.update(before, rest)
    leave = (1.0 - models.carrying_stay_prob) / (known.sum() - 1)
    np.testing.assert_allclose(after[known], (before * (models.carrying_stay_prob - leave) + leave)[known])
    assert window.irregular_prob == 0.0


def test_a_model_of_the_user_classifies_each_window_because_it_may_know_several_kinds_of_rest() -> None:
    stage = stage_of(load_model("context"), attitude_free_contexts())
    assert isinstance(stage, LearnedContexts)
    force = np.array([0.0, 0.0, 9.8]) + np.random.default_rng(0).normal(0.0, 0.01, (400, 3))
    _, windows = run_stage(stage.windows, [block_of(force, np.zeros((400, 3)))])
    assert not any(window.is_still for _, window in windows)
    assert len({window.features.tobytes() for _, window in windows}) == 3


def test_persons_who_sit_and_stand_have_the_contexts_of_a_motionless_phone() -> None:
    walk = pdr.read(DataSets(DATA) / "difronzo" / "difronzo_user01_exp01.zip")
    block = pdr.merge_streams(walk)
    found, expected = (filtered(config, [block]) for config in (pdr.recipes.default(), all_described()))
    np.testing.assert_array_equal(rows(found), rows(expected))
    differ = (context_prob(found) != context_prob(expected)).any(axis=1)
    assert differ.sum() > 50
    np.testing.assert_allclose(context_prob(found), context_prob(expected), atol=1e-3)
