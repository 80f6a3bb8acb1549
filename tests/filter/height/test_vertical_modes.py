from __future__ import annotations

import math

import numpy as np
import pytest

from pdr_filter.filter.height import vertical_modes as vertical
from pdr_filter.filter.height.vertical_modes import DOWN, DRIFT, JUMP, LIFT, N_MODES, SLOPE, UP
from pdr_filter.filter.imm import imm
from pdr_filter.values import FloatArray, mixtures

CLIMBED, RATE, SLOPED, AIR = range(4)
RISER_M = 0.17


def some_estimates(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means (7, 4), covariances (7, 4, 4) and probabilities (7,). Only a lift has a rate."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(0.0, [5.0, 1.0, 2.0, 300.0], (N_MODES, 4))
    root = rng.normal(0.0, 0.3, (N_MODES, 4, 4))
    cov = root @ root.swapaxes(1, 2)
    others = np.arange(N_MODES) != LIFT
    mean[others, RATE] = 0.0
    cov[others, RATE, :] = 0.0
    cov[others, :, RATE] = 0.0
    return mean, cov, rng.dirichlet(np.ones(N_MODES))


def moments_of(mean: FloatArray, cov: FloatArray, prob: FloatArray) -> FloatArray:
    moments = np.zeros((N_MODES, 5, 5))
    y = np.column_stack([np.ones(N_MODES), mean])
    moments[:, 1:, 1:] = cov
    return prob[:, None, None] * (moments + y[:, :, None] * y[:, None, :])


def predicted_by(mode: int, elapsed_s: float, n_steps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return transition matrix, offset and noise of a mode, as the module describes them."""
    lead, added, noise = np.diag([1.0, 0.0, 1.0, 1.0]), np.zeros(4), np.zeros((4, 4))
    noise[AIR, AIR] = elapsed_s * vertical.AIR_WALK_M**2
    if mode in (UP, DOWN):
        added[CLIMBED] = n_steps * RISER_M * (1 if mode == UP else -1)
        noise[CLIMBED, CLIMBED] = vertical.STAIRS_STD_M**2
    if mode == SLOPE and n_steps:
        noise[SLOPED, SLOPED] = elapsed_s * vertical.SLOPE_MPS**2
    if mode == JUMP:
        noise[AIR, AIR] += vertical.JUMP_STD_M**2
    if mode == DRIFT:
        noise[AIR, AIR] += elapsed_s * vertical.DRIFT_M**2
    if mode == LIFT:
        lead[RATE, RATE], lead[CLIMBED, RATE] = 1.0, elapsed_s
        by = vertical.LIFT_ACCELERATION_MPS2 * np.array([0.5 * elapsed_s**2, elapsed_s, 0.0, 0.0])
        noise += np.outer(by, by)
    return lead, added, noise


@pytest.mark.parametrize(("elapsed_s", "n_steps", "seed"), [(1.0, 0, 0), (1.0, 2, 1), (2.0, 3, 2), (0.9, 1, 3)])
def test_a_second_of_moments_equals_an_imm_of_means_and_covariances(elapsed_s: float, n_steps: int, seed: int) -> None:
    mean, cov, prob = some_estimates(seed)
    evidence = np.random.default_rng(seed).normal(0.0, 1.0, N_MODES)
    height_m = float(prob @ (mean[:, CLIMBED] + mean[:, SLOPED] + mean[:, AIR]))
    after = vertical.moments_after_second(moments_of(mean, cov, prob), elapsed_s, n_steps, height_m, 0.01, evidence)

    stays = np.array([15.0, 20.0, 6.6, 5.8, 15.0, 1.1, 60.0])
    transition = vertical._TRANSITIONS  # pyright: ignore[reportPrivateUsage]
    np.testing.assert_allclose(np.diag(transition), 1.0 - 1.0 / stays)
    mixed_mean, mixed_cov, prior = imm.mix(mean, cov, prob, transition)
    moved = [predicted_by(mode, elapsed_s, n_steps) for mode in range(N_MODES)]
    to_mean = np.array([lead @ x + added for (lead, added, _), x in zip(moved, mixed_mean, strict=True)])
    to_cov = np.array([lead @ each @ lead.T + noise for (lead, _, noise), each in zip(moved, mixed_cov, strict=True)])
    rows, var = np.array([[1.0, 0.0, 1.0, 1.0]]), np.array([[vertical.DRAUGHT_STD_M**2 + 0.01]])
    x, after_cov, log_likelihood, _ = imm.update(to_mean, to_cov, np.array([height_m]), rows, var)
    spread = math.sqrt(2.0 * after_cov[LIFT, RATE, RATE])
    slower = math.erf((0.2 - x[LIFT, RATE]) / spread) - math.erf((-0.2 - x[LIFT, RATE]) / spread)
    log_likelihood[LIFT] += math.log(1.0 - 0.5 * slower)
    if n_steps == 0:
        log_likelihood[[UP, DOWN]] += math.log(0.2)
    posterior = mixtures.posterior_prob(prior, log_likelihood + evidence)

    np.testing.assert_allclose(after[:, 0, 0], posterior, rtol=1e-6)
    np.testing.assert_allclose(after[:, 0, 1:] / posterior[:, None], x, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(after, moments_of(x, after_cov, posterior), rtol=1e-6, atol=1e-6)
    total, total_cov = imm.combine(x, after_cov, posterior)
    now = vertical.combined_height(after)
    assert now.climbed_m == pytest.approx(total[CLIMBED])
    assert now.height_m == pytest.approx(total[CLIMBED] + total[SLOPED])
    assert now.air_m == pytest.approx(total[AIR])
    up = np.array([1.0, 0.0, 1.0, 0.0])
    assert now.climbed_var_m2 == pytest.approx(total_cov[CLIMBED, CLIMBED], rel=1e-6)
    assert now.height_var_m2 == pytest.approx(up @ total_cov @ up, rel=1e-6)


def test_a_known_level_corrects_each_mode_and_keeps_the_mode_probabilities() -> None:
    mean, cov, prob = some_estimates(5)
    after = vertical.at_level(moments_of(mean, cov, prob), 3.0, 0.04)
    x, after_cov, _, _ = imm.update(mean, cov, np.array([3.0]), np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.04]]))
    np.testing.assert_allclose(after, moments_of(x, after_cov, prob), rtol=1e-6, atol=1e-6)


def test_an_unmeasured_step_climbs_in_each_mode() -> None:
    mean, cov, prob = some_estimates(6)
    after = vertical.moments_after_step(moments_of(mean, cov, prob), 0.17, 0.02, 0.003)
    cov[:, CLIMBED, CLIMBED] += 0.02
    cov[:, SLOPED, SLOPED] += 0.003
    mean[:, CLIMBED] += 0.17
    np.testing.assert_allclose(after, moments_of(mean, cov, prob), atol=1e-9)


def test_an_excluded_mode_becomes_probable_again() -> None:
    evidence = np.where(np.arange(N_MODES) == DRIFT, 0.0, -1e6)
    moments = vertical.moments_after_second(vertical.initial(), 1.0, 0, 0.0, 0.0, evidence)
    for _ in range(30):
        moments = vertical.moments_after_second(moments, 1.0, 2, 0.0, 0.0, np.zeros(N_MODES))
    assert np.isfinite(moments).all()
    assert moments[[0, SLOPE], 0, 0].sum() > 0.9
    assert vertical.combined_height(moments).climbed_m == pytest.approx(0.0, abs=0.2)


def test_forgetting_the_air_keeps_the_climbed_variance_and_resets_the_rate() -> None:
    mean, cov, prob = some_estimates(7)
    total, total_cov = imm.combine(mean, cov, prob)
    after = vertical.with_air_unknown(moments_of(mean, cov, prob), 6.0)
    now = vertical.combined_height(after)
    assert after[:, 0, 0].sum() == after[0, 0, 0] == 1.0
    assert now.climbed_m == 6.0
    assert now.climbed_var_m2 == pytest.approx(total_cov[CLIMBED, CLIMBED], rel=1e-6)
    assert now.height_m == pytest.approx(6.0 + total[SLOPED])
    assert after[0, 4, 4] - after[0, 0, 4] ** 2 > 1e7
