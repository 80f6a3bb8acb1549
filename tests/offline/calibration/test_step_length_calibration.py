"""Step lengths from segments of known length: exactness, probabilities, bad input, and choice of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_up_segments import INF, WALKING, design, flat, segment, step, sums_of

from pdr_filter.filter.step_length.models import (
    TYPICAL_STEP,
    BounceStepLength,
    ChenStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    StepLengthModel,
    length_and_jacobian,
)
from pdr_filter.offline.calibration import model_forms as forms
from pdr_filter.offline.calibration.estimation import Hierarchy, estimate_parameters
from pdr_filter.offline.calibration.fit import calibrate_segments
from pdr_filter.offline.calibration.priors import (
    DEFAULT_PRIORS,
    StepLengthPrior,
    candidates,
    eq12_priors,
    weak_prior,
)
from pdr_filter.offline.calibration.segments import Segment, SegmentSums, integrate
from pdr_filter.values import CONTEXTS

EQ16 = Hierarchy(
    mean=np.zeros(3),
    std=np.full(3, INF),
    between_std=np.array([INF, 0.0, 0.0]),
    step_std_m=np.zeros(len(CONTEXTS)),
    recording_std=0.0,
    noise_dof=0.0,
)


# --- exactness ------------------------------------------------------------------------------------------------------


def test_without_priors_the_estimate_solves_the_normal_equations_of_eq_16() -> None:
    sums, full = design(np.random.default_rng(0))
    d = sums.distance_m
    k = np.linalg.solve(full.T @ full, full.T @ d)
    found = estimate_parameters(sums, EQ16, loss="none")
    np.testing.assert_allclose(found.people[:, 0], k[:15], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.people[:, 1:], np.tile(k[15:], (15, 1)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.population[0], k[:15].mean(), rtol=0, atol=1e-9)
    residual = d - full @ k
    variance = residual @ residual / (len(d) - 17)
    cov = variance * np.linalg.inv(full.T @ full)
    np.testing.assert_allclose(found.noise_factor[WALKING], variance, rtol=1e-4)
    np.testing.assert_allclose(found.people_cov[:, 0, 0], np.diagonal(cov)[:15], rtol=1e-4)
    np.testing.assert_allclose(found.population_cov[1:, 1:], cov[15:, 15:], rtol=1e-4)
    np.testing.assert_allclose(found.people_cov[3][:, :], cov[np.ix_([3, 15, 16], [3, 15, 16])], rtol=1e-4)


def test_the_error_of_a_held_out_segment_is_that_of_a_fit_without_it() -> None:
    sums, full = design(np.random.default_rng(1), 4, 6)
    found = estimate_parameters(sums, EQ16, loss="none")
    for i in range(len(sums)):
        others = np.arange(len(sums)) != i
        k = np.linalg.lstsq(full[others], sums.distance_m[others], rcond=None)[0]
        assert found.left_out_m[i] == pytest.approx(full[i] @ k, abs=1e-6)


HELD = Hierarchy(
    mean=np.array([0.4, 0.2, 0.0]),
    std=np.array([0.3, 0.1, 0.01]),
    between_std=np.array([0.05, 0.0, 0.0]),
    step_std_m=np.full(len(CONTEXTS), 0.08),
    recording_std=0.03,
    between_dof=INF,
    recording_dof=INF,
    noise_dof=INF,
)


def test_the_estimate_with_people_recordings_and_priors_equals_a_dense_solution() -> None:
    rng = np.random.default_rng(2)
    sums, _ = design(rng, 5, 12)
    sums = replace(sums, recording=3 * sums.subject + rng.integers(0, 3, len(sums)), anchor_std_m=np.full(60, 0.35))
    found = estimate_parameters(sums, HELD, loss="none")
    # unknown: population (3), deviations of k0 (5); recordings in the covariance of the data
    rows = sums.regressors[:, 0]
    both = np.hstack([rows, rows[:, :1] * np.eye(5)[sums.subject]])
    size = found.predicted_m
    same = sums.recording[:, None] == sums.recording
    noise = np.diag(0.35**2 + sums.n_steps * 0.08**2) + 0.03**2 * same * np.outer(size, size)
    information = both.T @ np.linalg.solve(noise, both) + np.diag(1 / np.concatenate([HELD.std, np.full(5, 0.05)]) ** 2)
    right = both.T @ np.linalg.solve(noise, sums.distance_m)
    right[:3] += HELD.mean / HELD.std**2
    x, cov = np.linalg.solve(information, right), np.linalg.inv(information)
    # predicted sizes of the last iteration but one are within the tolerance of its end
    np.testing.assert_allclose(found.population, x[:3], rtol=1e-5)
    np.testing.assert_allclose(found.people[:, 0], x[0] + x[3:], rtol=1e-5)
    np.testing.assert_allclose(found.population_cov, cov[:3, :3], rtol=1e-4, atol=1e-10)
    own = np.eye(8)[0] + np.eye(8)[3:]
    np.testing.assert_allclose(found.people_cov[:, 0, 0], np.diagonal(own @ cov @ own.T), rtol=1e-4)


def test_the_prediction_for_a_held_out_person_is_that_of_a_calibration_without_them() -> None:
    sums, _ = design(np.random.default_rng(3), 5, 12)
    found = estimate_parameters(sums, HELD, loss="none")
    others = np.flatnonzero(sums.subject != 2)
    without = estimate_parameters(sums.rows(others), HELD, loss="none")
    own = sums.subject == 2
    np.testing.assert_allclose(found.stranger_m[own], sums.regressors[own, 0] @ without.population, rtol=1e-5)


def test_the_order_of_the_segments_does_not_change_the_result() -> None:
    sums, _ = design(np.random.default_rng(5))
    order = np.random.default_rng(6).permutation(len(sums))
    a, b = estimate_parameters(sums, HELD), estimate_parameters(sums.rows(order), HELD)
    np.testing.assert_allclose(b.people, a.people, rtol=1e-9)
    np.testing.assert_allclose(b.left_out_m, a.left_out_m[order], rtol=1e-6)


@pytest.mark.parametrize(
    ("model", "theta"),
    [
        (FrequencyVarianceStepLength(), [0.4, 0.2, 0.01]),
        (BounceStepLength(1.8), [0.29]),
        (ChenStepLength(1.8), [0.4, 0.25, 1.1]),
    ],
)
def test_the_sums_are_the_derivative_of_the_displacement(model: StepLengthModel, theta: list[float]) -> None:
    k = np.array(theta)
    arc = segment(np.random.default_rng(7), model, k, turn_rad=2.0)
    sums = integrate([arc], {"walking": model}, {"walking": k})

    def displacement(at: np.ndarray) -> np.ndarray:
        length = np.array([length_and_jacobian(model, s, at)[0] for s in arc.steps])
        return np.array([length @ np.sin(arc.heading_rad), length @ np.cos(arc.heading_rad)])

    np.testing.assert_allclose(sums.regressors[0] @ k + sums.offset_m[0], displacement(k), atol=1e-12)
    for p, direction in enumerate(np.eye(len(k))):
        numeric = (displacement(k + 1e-6 * direction) - displacement(k - 1e-6 * direction)) / 2e-6
        np.testing.assert_allclose(sums.regressors[0, :, p], numeric, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("turn_rad", [0.0, 2.5])
def test_exact_displacements_recover_the_parameters_for_any_bend(turn_rad: float) -> None:
    rng, model, k = np.random.default_rng(8), FrequencyVarianceStepLength(), np.array([0.45, 0.15, 0.01])
    segments = [segment(rng, model, k, turn_rad=turn_rad) for _ in range(12)]
    found = calibrate_segments(segments, {"walking": flat(3)}, recording_std=0.0)
    np.testing.assert_allclose(found.k["walking"], k, atol=1e-8)


def test_a_nonlinear_model_recovers_its_exact_parameters() -> None:
    rng, k = np.random.default_rng(9), np.array([0.5, 0.3, 1.15])
    segments = [
        replace(segment(rng, ChenStepLength(h), k, turn_rad=1.0, subject=f"{h} m"), height_m=h)
        for h in (1.6, 1.7, 1.8, 1.9)
        for _ in range(8)
    ]
    flat_chen = StepLengthPrior(ChenStepLength(1.7), np.array([0.371, 0.227, 1.0]), np.full(3, INF), np.zeros(3))
    found = calibrate_segments(segments, {"walking": flat_chen}, recording_std=0.0)
    np.testing.assert_allclose(found.k["walking"], k, atol=1e-6)


def test_steps_count_for_each_context_by_their_probability() -> None:
    """Segments of one certain context each, and of two uncertain ones, have one exact solution."""
    rng, model = np.random.default_rng(10), FrequencyVarianceStepLength()
    walk, side = np.array([0.6, 0.1, 0.0]), np.array([0.35, 0.02, 0.0])
    segments: list[Segment] = []
    for share in (1.0, 0.8, 0.5, 0.2, 0.0) * 3:
        mixed = share * walk + (1 - share) * side
        segments.append(segment(rng, model, mixed, walking=share, sideways=1 - share))
    priors = {
        name: StepLengthPrior(model, np.zeros(3), np.array([INF, INF, 0.0]), np.zeros(3))
        for name in ("walking", "sideways")
    }
    found = calibrate_segments(segments, priors, recording_std=0.0)
    np.testing.assert_allclose(found.k["walking"][:2], walk[:2], atol=1e-8)
    np.testing.assert_allclose(found.k["sideways"][:2], side[:2], atol=1e-8)


def test_stairs_of_group_b_and_corridors_of_group_a_are_solved_together() -> None:
    rng, model = np.random.default_rng(22), FrequencyVarianceStepLength()
    corridors = [segment(rng, model, np.array([0.45, 0.15, 0.01]), f"s{i % 3}") for i in range(30)]
    stairs = [
        replace(
            segment(rng, model, np.array([0.29, 0.0, 0.0]), f"s{i % 3}", n=1, upstairs=0.95, walking=0.05),
            distance_m=0.29,
            anchor_std_m=0.02,
        )
        for i in range(60)
    ]
    found = calibrate_segments([*corridors, *stairs], eq12_priors())
    assert found.contexts == ("walking", "upstairs")
    # 5 % of every stair is said to be walking, 0.78 m a step
    up = model.regressors(TYPICAL_STEP) @ found.k["upstairs"]
    assert 0.95 * up + 0.05 * 0.78 == pytest.approx(0.29, abs=0.01)
    assert model.regressors(TYPICAL_STEP) @ found.k["walking"] == pytest.approx(0.77, abs=0.02)


# --- probabilities --------------------------------------------------------------------------------------------------


PEOPLE = Hierarchy(
    np.array([0.42, 0.18, 0.004]),
    np.array([0.1, 0.05, 0.005]),
    np.array([0.04, 0.0, 0.0]),
    np.full(len(CONTEXTS), 0.08),
    0.02,
)


def simulated(
    rng: np.random.Generator, n_people: int, per_person: int, wrong: float = 0.0
) -> tuple[SegmentSums, Hierarchy, np.ndarray, np.ndarray]:
    """Return segments of people drawn from the prior, and the true parameters."""
    population = rng.normal(PEOPLE.mean, PEOPLE.std)
    people = population + rng.normal(size=(n_people, 3)) * PEOPLE.between_std
    return walked(rng, people, per_person, wrong), PEOPLE, population, people


def walked(rng: np.random.Generator, people: np.ndarray, per_person: int, wrong: float = 0.0) -> SegmentSums:
    """Return segments of people with parameters (S, 3), a share of which has twice the true length."""
    n_people = len(people)
    n = n_people * per_person
    person = np.repeat(np.arange(n_people), per_person)
    recording = np.arange(n) // max(per_person // 3, 1)
    steps = rng.integers(12, 20, n).astype(float)
    rows = np.stack([np.ones(n), rng.normal(1.9, 0.15, n), rng.normal(4.0, 0.8, n)], axis=1) * steps[:, None]
    day = 1 + rng.normal(0, 0.02, recording[-1] + 1)[recording]
    distance = np.einsum("np,np->n", rows, people[person]) * day
    distance += rng.normal(size=n) * np.sqrt(0.35**2 + steps * 0.08**2)
    distance[rng.random(n) < wrong] *= 2.0
    return sums_of(rows, distance, person, steps, recording, 0.35)


def test_95_percent_intervals_of_200_calibrations_contain_the_truth_in_92_to_98_percent() -> None:
    rng = np.random.default_rng(11)
    own: list[np.ndarray] = []
    shared: list[np.ndarray] = []
    for _ in range(200):
        sums, prior, population, people = simulated(rng, 3, 8)
        found = estimate_parameters(sums, prior)
        own.append(np.abs(found.people - people)[:, 0] < 1.96 * np.sqrt(found.people_cov[:, 0, 0]))
        shared.append(np.abs(found.population - population) < 1.96 * np.sqrt(np.diagonal(found.population_cov)))
    assert 0.92 < np.mean(own) < 0.98
    for share in np.mean(shared, axis=0):
        assert 0.92 < share < 0.98


def test_estimates_of_people_shrink_towards_the_population_and_are_no_worse_on_average() -> None:
    """People have one, three or twelve segments.

    The error decreases with their number and is below the population's.
    """
    rng = np.random.default_rng(12)
    typical = np.array([1.0, 1.9, 4.0])
    errors: dict[int, list[float]] = {1: [], 3: [], 12: []}
    population: list[float] = []
    for _ in range(40):
        sums, prior, _, people = simulated(rng, 12, 12)
        keep = np.zeros(len(sums), dtype=bool)
        wanted = np.tile([1, 3, 12], 4)
        for s, n in enumerate(wanted):
            keep[np.flatnonzero(sums.subject == s)[:n]] = True
        found = estimate_parameters(sums.rows(keep), prior)
        for s, n in enumerate(wanted):
            errors[n].append(float((found.people[s] - people[s]) @ typical))
            population.append(float((found.population - people[s]) @ typical))
    rms = {n: np.sqrt(np.square(e).mean()) for n, e in errors.items()}
    assert rms[12] < 0.75 * rms[3] < 0.75 * rms[1]
    assert rms[1] < 0.9 * np.sqrt(np.square(population).mean())


def test_a_person_without_segments_has_the_parameters_and_spread_of_the_population() -> None:
    sums, prior, _, _ = simulated(np.random.default_rng(13), 6, 10)
    sums = replace(sums, subjects=(*sums.subjects, "nobody"))
    found = estimate_parameters(sums, prior)
    np.testing.assert_allclose(found.people[6], found.population, atol=1e-12)
    np.testing.assert_allclose(found.people_cov[6], found.population_cov + found.between_cov, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("loss", ["gnc", "cauchy", "huber"])
def test_outlying_segments_are_named_and_hardly_change_the_parameters(loss: str) -> None:
    rng, model, k = np.random.default_rng(14), BounceStepLength(), np.array([0.3])
    good = [segment(rng, model, k, error_m=float(rng.normal(0, 0.4)), recording=f"r{i}") for i in range(40)]
    wrong = [replace(s, distance_m=2 * s.distance_m, start_s=float(i + 1)) for i, s in enumerate(good[:4])]
    clean = calibrate_segments(good, loss=loss)
    found = calibrate_segments([*good[4:], *wrong], loss=loss)
    names = {(str(r.recording), float(r.start_s)) for r in found.distrusted}
    assert {(s.recording, s.start_s) for s in wrong} <= names
    assert len(names) <= 6
    assert sum("distrusted" in note for note in found.notes) == len(names)
    shift = abs(found.subjects["anna"].k0 / clean.subjects["anna"].k0 - 1)
    plain = calibrate_segments([*good[4:], *wrong], loss="none")
    assert shift < 0.03 < 0.05 < abs(plain.subjects["anna"].k0 / clean.subjects["anna"].k0 - 1)


def test_a_calibration_whose_segments_all_contradict_the_steps_says_that_nothing_was_learned() -> None:
    good = segment(np.random.default_rng(15), BounceStepLength(), np.array([0.3]))
    found = calibrate_segments([replace(good, distance_m=4 * good.distance_m)])
    assert found.distrusted.size == 1
    assert "the step lengths are those of the prior" in found.notes[0]
    assert not any("those of the prior" in note for note in calibrate_segments([good]).notes)


def test_known_lengths_of_a_wrong_scale_are_named_and_impossible_steps_are_not_used() -> None:
    rng, model = np.random.default_rng(15), BounceStepLength()
    many = [segment(rng, model, np.array([0.33]), recording=f"r{i}") for i in range(12)]
    half, three = ([replace(s, distance_m=factor * s.distance_m) for s in many] for factor in (0.5, 3.0))
    (note,) = (note for note in calibrate_segments(half).notes if "than usual" in note)
    assert "(and 11 more) are 0.3" in note
    assert "shorter" in note
    mixed = calibrate_segments([*many, *(replace(s, subject="ben", recording=f"b{i}") for i, s in enumerate(three))])
    assert mixed.subject_ids == ("anna",)
    assert sum("nobody walks" in note for note in mixed.notes) == 12
    with pytest.raises(ValueError, match="nothing to calibrate with: r0: its steps would be"):
        calibrate_segments(three)


def test_segments_of_one_recording_count_less_than_independent_segments() -> None:
    rng, model, k = np.random.default_rng(15), BounceStepLength(), np.array([0.3])
    many = [segment(rng, model, k, error_m=float(rng.normal(0, 0.4)), recording=f"r{i}") for i in range(40)]
    one = [replace(s, recording="r") for s in many]
    std = [calibrate_segments(s).subjects["anna"].k_std["walking"][0] for s in (one, many)]
    assert std[0] > 1.5 * std[1]


# --- bad input ------------------------------------------------------------------------------------------------------


def test_standard_deviations_of_people_and_population_are_those_of_their_covariances() -> None:
    found = calibrate_segments([segment(np.random.default_rng(16), BounceStepLength(), np.array([0.383]))])
    for result in (found, found.subjects["anna"]):
        for name, cov in result.k_cov.items():
            np.testing.assert_allclose(result.k_std[name] ** 2, np.diagonal(cov), rtol=1e-12)


def test_one_corridor_of_one_person_gives_a_k_between_the_data_and_the_prior() -> None:
    rng = np.random.default_rng(16)
    only = segment(rng, BounceStepLength(), np.array([0.383]))
    found = calibrate_segments([only])
    prior_k = DEFAULT_PRIORS["walking"].mean[0]
    assert prior_k < found.k["walking"][0] < found.subjects["anna"].k0 < 0.383
    own, population = found.subjects["anna"].k_cov["walking"][0, 0], found.between["walking"][0, 0]
    assert 0 < own < population + found.k_cov["walking"][0, 0]
    assert found.fits("anna")["walking"].theta[0] == found.subjects["anna"].k0
    assert found.fits("somebody else")["walking"].theta[0] == found.k["walking"][0]


def test_a_single_speed_leaves_the_slopes_at_the_prior_with_a_large_covariance() -> None:
    model, k = FrequencyVarianceStepLength(), np.array([0.45, 0.15, 0.01])
    rng = np.random.default_rng(17)
    once = segment(rng, model, k)
    same = replace(once, steps=(step(1.9),) * 14, distance_m=14 * 0.775)
    found = calibrate_segments([same] * 30, eq12_priors())
    cov = found.subjects["anna"].k_cov["walking"]
    regressors = model.regressors(step(1.9))
    assert regressors @ found.subjects["anna"].k["walking"] == pytest.approx(0.775, rel=0.03)
    assert np.sqrt(regressors @ cov @ regressors) < 0.03
    assert np.sqrt(cov[1, 1]) > 0.1


def test_any_model_has_a_weak_prior_that_the_data_outweigh() -> None:
    rng, model, k = np.random.default_rng(20), FrequencyVarianceStepLength(), np.array([0.3, 0.25, 0.01])
    segments = [segment(rng, model, k, f"s{i % 4}") for i in range(80)]
    found = calibrate_segments(segments, {"walking": weak_prior(model)})
    regressors = model.regressors(TYPICAL_STEP)
    assert regressors @ found.k["walking"] == pytest.approx(regressors @ k, rel=0.02)


def test_people_of_a_weak_prior_differ_by_seven_percent_of_a_typical_step() -> None:
    model = FrequencyVarianceStepLength()
    known = weak_prior(model, mean=[0.3, 0.25, 0.01], personal=(0, 1))
    terms_m = model.regressors(TYPICAL_STEP) * known.between_std
    length_m = model.regressors(TYPICAL_STEP) @ known.mean
    assert np.hypot(*terms_m[:2]) == pytest.approx(0.07 * length_m, rel=1e-6)
    assert terms_m[2] == 0.0


@pytest.mark.parametrize("walking", ["walking", "level"])
@pytest.mark.parametrize(("errors", "name"), [((3.00, 2.99, 5.0), "bounce"), ((3.0, 2.0, 5.0), "eq12")])
def test_another_model_is_chosen_only_if_it_is_clearly_better(
    monkeypatch: pytest.MonkeyPatch, errors: tuple[float, ...], name: str, walking: str
) -> None:
    def held_out(some: Sequence[Any], priors: Mapping[str, Any], *_: object) -> tuple[dict[str, Any], Any]:
        each = (*errors, *[max(errors)] * len(priors))
        return {n: np.full(len(some), e / 100) for n, e in zip(priors, each, strict=False)}, np.ones(len(some), bool)

    monkeypatch.setattr(forms, "left_out_errors", held_out)
    rng = np.random.default_rng(1)
    walked = [segment(rng, KimStepLength(), np.array([0.55]), f"p{i % 8}") for i in range(40)]
    contexts = tuple(walking if c == "walking" else c for c in CONTEXTS)
    walked = [replace(s, context_names=contexts) for s in walked]
    found, (note,) = forms.best_form(walked, forms.forms_of(contexts=contexts, walking=walking), "gnc", 0.025, walking)
    assert found == name
    assert "clearly better" in note


@pytest.mark.parametrize(
    ("name", "model", "theta"),
    [("kim", KimStepLength(), [0.55]), ("eq12", FrequencyVarianceStepLength(), [0.1, 0.2, 0.06])],
)
def test_enough_segments_choose_their_true_model_and_few_keep_the_default(
    name: str, model: StepLengthModel, theta: list[float]
) -> None:
    rng = np.random.default_rng(21)
    segments = [
        segment(rng, model, np.array(theta), error_m=float(rng.normal(0, 0.1)), recording=f"r{i % 6}")
        for i in range(60)
    ]
    found = calibrate_segments(segments)
    assert type(found.models["walking"]) is type(model)
    assert any(
        f"walking by the model {name} (5 models" in note and "clearly better than" in note for note in found.notes
    )
    assert "6 recordings" in found.report()
    few = calibrate_segments(segments[:29])
    in_one = calibrate_segments([replace(s, recording="r") for s in segments])
    asked = calibrate_segments(segments, model="bounce")
    for kept in (few, in_one, asked):
        assert type(kept.models["walking"]) is BounceStepLength
        assert not any("forms" in note for note in kept.notes)
    assert type(calibrate_segments(segments[:5], model=name).models["walking"]) is type(model)


@pytest.mark.parametrize("name", [n for n in candidates() if n not in forms.COMPARED])
def test_every_model_of_the_five_papers_is_calibrated_by_its_name(name: str) -> None:
    prior, rng = candidates()[name]["walking"], np.random.default_rng(3)
    theta = prior.mean * 1.08  # a person with longer steps, where the model has one parameter of the person
    segments = [segment(rng, prior.model, theta, recording=f"r{i % 4}") for i in range(12)]
    found = calibrate_segments(segments, model=name)
    assert type(found.models["walking"]) is type(prior.model)
    length, true = (length_and_jacobian(prior.model, TYPICAL_STEP, k)[0] for k in (found.k["walking"], theta))
    assert float(length) == pytest.approx(float(true), rel=0.02)


def test_a_part_of_a_large_cohort_chooses_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forms, "_MAX_SEGMENTS", 20)
    rng = np.random.default_rng(22)
    segments = [
        segment(rng, KimStepLength(), np.array([0.55]), f"s{i % 12}", error_m=float(rng.normal(0, 0.1)))
        for i in range(60)
    ]
    found = calibrate_segments(segments)
    assert type(found.models["walking"]) is KimStepLength
    assert len(found.subjects) == 12
    assert any("6 people)" in note for note in found.notes)  # not four: five at least
