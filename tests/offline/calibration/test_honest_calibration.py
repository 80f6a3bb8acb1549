"""People who differ from the prior: step lengths, noise and covariances must be right nevertheless."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up_segments import sums_of

from pdr_filter.filter.step_length.models import TYPICAL_STEP, BounceStepLength
from pdr_filter.offline.calibration.estimation import Hierarchy, ParameterEstimate, estimate_parameters
from pdr_filter.offline.calibration.fit import bias_warnings, calibrate_segments
from pdr_filter.offline.calibration.priors import (
    DEFAULT_PRIORS,
    GROUP_RELATIVE_STD,
    PEOPLE_RELATIVE_STD,
    prior,
    with_relative_std,
)
from pdr_filter.offline.calibration.segments import Segment, SegmentSums
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.values import CONTEXTS, table

WALKING = CONTEXTS.index("walking")
K = float(DEFAULT_PRIORS["walking"].mean[0])
STEP_STD_M, ANCHOR_STD_M, DAY_STD = 0.08, 0.35, 0.025
LAYOUTS = [(12, 1), (30, 1), (100, 1), (12, 3), (12, 10)]
# Groups of unknown height on real walks, against the lengths that are shipped.
GROUPS = np.array([-0.10, 0.0, 0.10, 0.20])


def walked(
    rng: np.random.Generator, n_people: int, per_person: int, factor: float = 1.0, wrong: float = 0.0
) -> tuple[SegmentSums, np.ndarray]:
    """Return sums of segments of about 12 m, three recordings a person, and the true k of the people.

    People differ by 7 % of the prior's k to either side. A share `wrong` of the segments is half or twice as long as
    stated.
    """
    k = factor * K + PEOPLE_RELATIVE_STD * K * rng.choice([-1, 1], n_people)
    n = n_people * per_person
    person, recording = np.repeat(np.arange(n_people), per_person), np.arange(n) // max(per_person // 3, 1)
    steps = rng.integers(12, 20, n).astype(float)
    row = steps * rng.normal(2.27, 0.104, n)
    distance = row * k[person] * (1 + rng.normal(0, DAY_STD, recording[-1] + 1)[recording])
    distance += rng.normal(size=n) * np.sqrt(ANCHOR_STD_M**2 + steps * STEP_STD_M**2)
    is_wrong = rng.random(n) < wrong
    distance[is_wrong] *= rng.choice([0.5, 2.0], is_wrong.sum())
    return sums_of(row[:, None], distance, person, steps, recording, ANCHOR_STD_M), k


def prior_of_k(relative_std: float = GROUP_RELATIVE_STD) -> Hierarchy:
    """Return the prior of the default model of walking."""
    known = with_relative_std(DEFAULT_PRIORS["walking"], relative_std)
    return Hierarchy(known.mean, known.std, known.between_std, np.full(len(CONTEXTS), known.step_std_m), DAY_STD)


def noise(found: ParameterEstimate) -> float:
    """Return the ratio of the estimated to the true standard deviation of the segments."""
    return float(np.sqrt(found.noise_factor[WALKING]))


@pytest.mark.parametrize(("wrong", "factor"), [(0.0, 1.22), (0.1, 1.0), (0.2, 1.22)])
@pytest.mark.parametrize(("n_people", "per_person"), LAYOUTS)
def test_the_noise_of_steps_is_estimated_within_10_percent_despite_outliers_and_unusual_people(
    n_people: int, per_person: int, wrong: float, factor: float
) -> None:
    rng = np.random.default_rng(1)
    # 180 segments in all leave the mean noise a standard error of 1 / sqrt(360), 5 %
    n_runs = max(180 // (n_people * per_person), 3)
    runs = [
        estimate_parameters(walked(rng, n_people, per_person, factor, wrong)[0], prior_of_k()) for _ in range(n_runs)
    ]
    assert all(found.converged for found in runs)
    assert float(np.mean([noise(found) for found in runs])) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("loss", ["gnc", "cauchy", "huber"])
def test_no_robust_loss_biases_the_noise_of_good_segments(loss: str) -> None:
    """A loss reduces the tails, which the estimate must correct exactly once. 24,000 segments resolve 1.3 %."""
    sums, _ = walked(np.random.default_rng(2), 400, 60)
    free = replace(prior_of_k(), noise_dof=0.0)
    plain, found = (noise(estimate_parameters(sums, free, name)) for name in ("none", loss))
    assert plain == pytest.approx(1.0, abs=0.013)
    assert found == pytest.approx(plain, abs=0.013)


@pytest.mark.parametrize(("loss", "efficiency"), [("none", 1.0), ("huber", 0.95), ("cauchy", 0.95), ("gnc", 0.97)])
def test_a_robust_loss_increases_the_covariance_by_its_loss_of_efficiency(loss: str, efficiency: float) -> None:
    """Two people with many segments and normal noise of a known size: the factor is 1 / (E (E psi')^2 / E psi^2)."""
    sums, _ = walked(np.random.default_rng(9), 2, 6000)
    held = replace(prior_of_k(5.0), recording_std=0.0, noise_dof=np.inf, between_std=np.array([np.inf]))
    clean = replace(sums, distance_m=sums.regressors[:, 0, 0] * K)
    error = np.random.default_rng(10).normal(size=len(sums)) * np.sqrt(ANCHOR_STD_M**2 + sums.n_steps * STEP_STD_M**2)
    found = estimate_parameters(replace(clean, distance_m=clean.distance_m + error), held, loss)
    plain = estimate_parameters(replace(clean, distance_m=clean.distance_m + error), held, "none")
    ratio = plain.people_cov[:, 0, 0] / found.people_cov[:, 0, 0]
    np.testing.assert_allclose(ratio, efficiency, atol=0.012)


@pytest.mark.parametrize(("factor", "per_person"), [(0.85, 3), (1.22, 1)])
def test_twelve_people_far_from_the_prior_predict_another_within_2_percent(factor: float, per_person: int) -> None:
    """As a mean over groups; the twelve people of a single group scatter by 7 % / sqrt(12)."""
    rng = np.random.default_rng(3)
    error = [
        estimate_parameters(walked(rng, 12, per_person, factor, 0.1)[0], prior_of_k()).population[0] / (factor * K) - 1
        for _ in range(40)
    ]
    assert abs(np.mean(error)) < 0.02
    assert np.std(error) < 0.03


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_95_percent_intervals_contain_people_of_a_group_far_from_the_prior(wrong: float) -> None:
    rng = np.random.default_rng(4)
    inside: list[np.ndarray] = []
    for factor in 1 + np.tile(GROUPS, 8):
        sums, k = walked(rng, 12, 6, factor, wrong)
        found = estimate_parameters(sums, prior_of_k())
        inside.append(np.abs(found.people[:, 0] - k) < 1.96 * np.sqrt(found.people_cov[:, 0, 0]))
    assert 0.92 < np.mean(inside) < 0.98


def test_the_prior_is_as_wide_as_the_spread_of_the_measured_groups() -> None:
    """A person of an uncalibrated group has a root mean square error of 12 % over four groups."""
    claimed = float(np.hypot(GROUP_RELATIVE_STD, PEOPLE_RELATIVE_STD))
    assert claimed == pytest.approx(np.sqrt(np.square(GROUPS).mean()), rel=0.1)
    usual = DEFAULT_PRIORS["walking"]
    np.testing.assert_allclose(usual.std / usual.mean, GROUP_RELATIVE_STD)


# --- the report -----------------------------------------------------------------------------------------------------


def corridors(rng: np.random.Generator, factor: float, n_people: int, per_person: int = 1) -> list[Segment]:
    """Return straight segments of people whose steps are longer than usual."""
    n = 16
    prob = np.zeros((n, len(CONTEXTS)))
    prob[:, WALKING] = 1.0
    step_m = float(BounceStepLength().regressors(TYPICAL_STEP)[0] * K)
    return [
        Segment(
            subject=f"s{i}",
            recording=f"s{i} r{j}",
            distance_m=n * step_m * factor * (1 + rng.normal(0, 0.04)) + rng.normal(0, 0.4),
            steps=(TYPICAL_STEP,) * n,
            inside=np.ones(n),
            heading_rad=np.zeros(n),
            context_prob=prob,
        )
        for i in range(n_people)
        for j in range(per_person)
    ]


def warnings_of(found: Calibration) -> list[str]:
    return [note for note in found.notes if note.startswith("WARNING")]


def test_a_significant_bias_gives_a_warning_with_a_remedy() -> None:
    segments = corridors(np.random.default_rng(5), 1.22, 12)
    held = calibrate_segments(segments, prior_std=0.01)
    first = warnings_of(held)[0]
    assert "held-out segments are predicted" in first
    assert "% too short" in first
    assert "standard errors" in first
    assert "(prior_std, --prior)" in first
    assert held.notes[0] == first
    assert first in held.report()
    assert not warnings_of(calibrate_segments(segments))


@pytest.mark.parametrize(("bias", "warned"), [(2.7, False), (3.3, True), (-3.3, True)])
def test_a_bias_is_significant_above_three_standard_errors_of_the_recordings(bias: float, warned: bool) -> None:
    """Ten recordings of three segments each, 3 % to either side, have a standard error of 1 %."""
    recording = np.repeat(np.arange(10), 3)
    error = bias + np.where(recording % 2, 3.0, -3.0)
    columns = {
        "subject": np.full(30, "anna"),
        "recording": recording.astype(str),
        "distance_m": np.full(30, 10.0),
        "left_out_m": 10.0 * (1 + error / 100),
        "stranger_m": np.full(30, np.nan),
        "distrusted": np.zeros(30, dtype=bool),
    }
    found = bias_warnings(table(columns), 0.025)
    assert bool(found) == warned
    assert all(("long" if bias > 0 else "short") in words and "3.3 % too" in words for words in found)


def test_a_single_recording_can_give_a_bias_warning_beyond_the_spread_of_recordings() -> None:
    segments = [replace(s, recording="r") for s in corridors(np.random.default_rng(6), 1.22, 1, 20)]
    usual = DEFAULT_PRIORS["walking"]
    held = prior(usual.model, usual.mean, [0.005 * K], [0.0])
    assert "held-out segments are predicted" in warnings_of(calibrate_segments(segments, {"walking": held}))[0]
    for factor in (0.85, 1.0, 1.22):
        other = [replace(s, recording="r") for s in corridors(np.random.default_rng(7), factor, 1, 20)]
        assert not warnings_of(calibrate_segments(other))


def test_good_calibrations_rarely_give_a_warning() -> None:
    rng = np.random.default_rng(8)
    warned = sum(bool(warnings_of(calibrate_segments(corridors(rng, f, 6, 2)))) for f in 1 + np.tile(GROUPS, 5))
    assert warned <= 1
