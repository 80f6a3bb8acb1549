from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.calibration import TYPICAL_STEP, Calibration, load_calibration
from pdr_filter.filter.step_length import (
    BounceStepLength,
    ChenStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    StepLengthModel,
    length_and_jacobian,
)
from pdr_filter.io.recording import Recording, Subject, Truth
from pdr_filter.offline.calibration import estimation, forms
from pdr_filter.offline.calibration.estimation import Hierarchy, estimate_parameters
from pdr_filter.offline.calibration.fit import calibrate, calibrate_segments
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, eq12_priors, prior, weak_prior
from pdr_filter.offline.calibration.segments import Segment, SegmentSums, integrate, segments_of
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracks import Track
from pdr_filter.values import CONTEXTS, Samples, Step, table

INF = np.inf
WALKING = CONTEXTS.index("walking")


# --- made-up segments -----------------------------------------------------------------------------------------------


def step(frequency_hz: float, variance: float = 4.0, mean_abs_mps2: float = 1.7, amplitude_mps2: float = 2.4) -> Step:
    return replace(
        TYPICAL_STEP,
        frequency_hz=frequency_hz,
        duration_s=1 / frequency_hz,
        variance=variance,
        vertical_amplitude_mps2=amplitude_mps2,
        mean_abs_mps2=mean_abs_mps2,
    )


def of_context(n: int, **prob: float) -> np.ndarray:
    return np.tile([prob.get(c, 0.0) for c in CONTEXTS], (n, 1))


def segment(
    rng: np.random.Generator,
    model: StepLengthModel,
    theta: np.ndarray,
    subject: str = "anna",
    *,
    n: int = 14,
    recording: str = "",
    turn_rad: float = 0.0,
    error_m: float = 0.0,
    **prob: float,
) -> Segment:
    """A segment whose displacement is that of its steps under theta, in a straight line or along an arc."""
    pace = rng.normal(1.9, 0.15)
    features = (rng.normal(pace, 0.1, n), rng.normal(4, 1, n), rng.normal(rng.uniform(1.2, 2.4), 0.2, n))
    steps = tuple(step(*values) for values in zip(*features, strict=True))
    heading = rng.uniform(0, 6) + np.linspace(0, turn_rad, n)
    length = np.array([length_and_jacobian(model, s, theta)[0] for s in steps])
    vector = np.array([length @ np.sin(heading), length @ np.cos(heading)])
    return Segment(
        subject=subject,
        recording=recording or subject,
        distance_m=float(np.hypot(*vector)) + error_m,
        steps=steps,
        inside=np.ones(n),
        heading_rad=heading,
        context_prob=of_context(n, **(prob or {"walking": 1.0})),
    )


def flat(n_params: int, personal: int = 0) -> StepLengthPrior:
    """Nothing is known: the first parameters are each person's own, without a tie."""
    between = np.where(np.arange(n_params) < personal, INF, 0.0)
    return StepLengthPrior(FrequencyVarianceStepLength(), np.zeros(n_params), np.full(n_params, INF), between)


def design(rng: np.random.Generator, n_people: int = 15, per_person: int = 33) -> tuple[SegmentSums, np.ndarray]:
    """Segments of eq. 14, summed lengths, and the matrix H of all of them."""
    n = n_people * per_person
    person = rng.permutation(np.repeat(np.arange(n_people), per_person))
    steps = rng.integers(12, 20, n).astype(float)
    rows = np.stack([np.ones(n), rng.normal(1.9, 0.15, n), rng.normal(4.0, 0.7, n)], axis=1) * steps[:, None]
    full = np.zeros((n, n_people + 2))
    full[np.arange(n), person], full[:, n_people:] = rows[:, 0], rows[:, 1:]
    k = np.concatenate([rng.normal(0.4, 0.05, n_people), [0.2, 0.005]])
    sums = SegmentSums(
        regressors=np.stack([rows, np.zeros_like(rows)], axis=1),
        offset_m=np.zeros((n, 2)),
        distance_m=full @ k + rng.normal(0, 0.3, n),
        anchor_std_m=np.ones(n),
        n_steps=steps,
        context=np.full(n, WALKING),
        subject=person,
        recording=person,
        subjects=tuple(f"s{i}" for i in range(n_people)),
        recordings=tuple(f"r{i}" for i in range(n_people)),
    )
    return sums, full


EQ16 = Hierarchy(
    mean=np.zeros(3),
    std=np.full(3, INF),
    between_std=np.array([INF, 0.0, 0.0]),
    step_std_m=np.zeros(len(CONTEXTS)),
    recording_std=0.0,
    noise_dof=0.0,
)


# --- exactness ------------------------------------------------------------------------------------------------------


def test_without_priors_it_is_the_normal_equations_of_eq_16() -> None:
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


def test_the_error_with_a_segment_left_out_is_that_of_a_fit_without_it() -> None:
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


def test_people_recordings_and_priors_are_those_of_one_dense_solution() -> None:
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


def test_a_person_left_out_gets_what_a_calibration_without_the_person_gives() -> None:
    sums, _ = design(np.random.default_rng(3), 5, 12)
    found = estimate_parameters(sums, HELD, loss="none")
    others = np.flatnonzero(sums.subject != 2)
    without = estimate_parameters(sums.rows(others), HELD, loss="none")
    own = sums.subject == 2
    np.testing.assert_allclose(found.stranger_m[own], sums.regressors[own, 0] @ without.population, rtol=1e-5)


def test_cutting_the_work_in_pieces_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    sums, _ = design(np.random.default_rng(4))
    whole = estimate_parameters(sums, HELD)
    monkeypatch.setattr(estimation, "_CHUNK_SEGMENTS", 50)
    np.testing.assert_allclose(estimate_parameters(sums, HELD).people, whole.people, rtol=1e-12)


def test_the_order_of_the_segments_changes_nothing() -> None:
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
def test_exact_displacements_give_back_the_parameters_round_any_bend(turn_rad: float) -> None:
    rng, model, k = np.random.default_rng(8), FrequencyVarianceStepLength(), np.array([0.45, 0.15, 0.01])
    segments = [segment(rng, model, k, turn_rad=turn_rad) for _ in range(12)]
    found = calibrate_segments(segments, {"walking": flat(3)}, recording_std=0.0)
    np.testing.assert_allclose(found.k["walking"], k, atol=1e-8)


def test_a_model_that_is_not_linear_is_calibrated_to_its_exact_parameters() -> None:
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


def test_single_stairs_of_group_b_give_their_length_in_one_solution_with_the_corridors_of_group_a() -> None:
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
    """Segments of people drawn from the prior, and the truth."""
    population = rng.normal(PEOPLE.mean, PEOPLE.std)
    people = population + rng.normal(size=(n_people, 3)) * PEOPLE.between_std
    return walked(rng, people, per_person, wrong), PEOPLE, population, people


def walked(rng: np.random.Generator, people: np.ndarray, per_person: int, wrong: float = 0.0) -> SegmentSums:
    """Segments of people with these parameters (S, 3), a share of them of twice the true length."""
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
    return SegmentSums(
        np.stack([rows, np.zeros_like(rows)], axis=1),
        np.zeros((n, 2)),
        distance,
        np.full(n, 0.35),
        steps,
        np.full(n, WALKING),
        person,
        recording,
        tuple(f"s{i}" for i in range(n_people)),
        tuple(f"r{i}" for i in range(recording[-1] + 1)),
    )


def test_95_percent_intervals_of_200_calibrations_have_the_truth_in_92_to_98_percent() -> None:
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


def test_intervals_have_the_truth_of_people_who_are_not_as_the_prior_expects() -> None:
    """People of two kinds, off the prior's mean and further apart than it says: its own intervals have them all."""
    rng, population = np.random.default_rng(12), np.array([0.55, 0.12, 0.008])
    own: list[np.ndarray] = []
    shared: list[np.ndarray] = []
    for _ in range(200):
        people = np.tile(population, (8, 1))
        people[:, 0] += rng.choice([-0.07, 0.07], 8)
        found = estimate_parameters(walked(rng, people, 24), replace(PEOPLE, std=5 * PEOPLE.std))
        own.append(np.abs(found.people - people)[:, 0] < 1.96 * np.sqrt(found.people_cov[:, 0, 0]))
        shared.append(np.abs(found.population - population) < 1.96 * np.sqrt(np.diagonal(found.population_cov)))
    assert 0.92 < np.mean(own) < 0.98
    for share in np.mean(shared, axis=0):
        assert 0.9 < share < 0.99


def test_a_person_never_does_worse_than_the_population_on_average_and_shrinks_towards_it() -> None:
    """People with one, three and twelve segments: the error falls with each, from below that of the population."""
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


def test_somebody_without_segments_has_the_population_s_parameters_and_spread() -> None:
    sums, prior, _, _ = simulated(np.random.default_rng(13), 6, 10)
    sums = replace(sums, subjects=(*sums.subjects, "nobody"))
    found = estimate_parameters(sums, prior)
    np.testing.assert_allclose(found.people[6], found.population, atol=1e-12)
    np.testing.assert_allclose(found.people_cov[6], found.population_cov + found.between_cov, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("loss", ["gnc", "cauchy", "huber"])
def test_wrong_segments_are_named_and_hardly_move_the_parameters(loss: str) -> None:
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


def test_recordings_of_one_person_count_for_less_than_as_many_independent_segments() -> None:
    rng, model, k = np.random.default_rng(15), BounceStepLength(), np.array([0.3])
    many = [segment(rng, model, k, error_m=float(rng.normal(0, 0.4)), recording=f"r{i}") for i in range(40)]
    one = [replace(s, recording="r") for s in many]
    std = [np.sqrt(calibrate_segments(s).subjects["anna"].k_cov["walking"][0, 0]) for s in (one, many)]
    assert std[0] > 1.5 * std[1]


# --- bad input ------------------------------------------------------------------------------------------------------


def test_one_person_with_one_corridor_gets_a_k_between_the_corridor_and_the_prior() -> None:
    rng = np.random.default_rng(16)
    only = segment(rng, BounceStepLength(), np.array([0.383]))
    found = calibrate_segments([only])
    prior_k = DEFAULT_PRIORS["walking"].mean[0]
    assert prior_k < found.k["walking"][0] < found.subjects["anna"].k0 < 0.383
    own, population = found.subjects["anna"].k_cov["walking"][0, 0], found.between["walking"][0, 0]
    assert 0 < own < population + found.k_cov["walking"][0, 0]
    assert found.fits("anna")["walking"].theta[0] == found.subjects["anna"].k0
    assert found.fits("somebody else")["walking"].theta[0] == found.k["walking"][0]


def test_one_speed_only_leaves_the_slopes_to_the_prior_with_a_large_covariance() -> None:
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


def test_parameters_that_nothing_determines_are_named() -> None:
    once = segment(np.random.default_rng(18), FrequencyVarianceStepLength(), np.array([0.45, 0.15, 0.01]))
    same = [replace(once, steps=(step(1.9),) * 14)] * 30
    with pytest.raises(ValueError, match=r"do not determine walking k0, walking k1.*one speed"):
        calibrate_segments(same, {"walking": flat(3)})
    with pytest.raises(ValueError, match="do not determine running k0"):
        calibrate_segments([once] * 5, {"running": flat(3)})


def test_segments_without_length_or_steps_are_refused() -> None:
    good = segment(np.random.default_rng(19), BounceStepLength(), np.array([0.3]))
    for distance_m in (0.0, -3.0, np.nan):
        with pytest.raises(ValueError, match=r"anna 0.0-0.0 s: distance_m must be positive"):
            calibrate_segments([good, replace(good, distance_m=distance_m)])
    with pytest.raises(ValueError, match="no steps"):
        calibrate_segments([replace(good, inside=np.zeros(14))])
    with pytest.raises(ValueError, match="no segments"):
        calibrate_segments([])
    with pytest.raises(ValueError, match="no recordings"):
        calibrate([])
    with pytest.raises(ValueError, match="loss must be one of"):
        calibrate_segments([good], loss="tukey")
    with pytest.raises(ValueError, match="no context hopping"):
        calibrate_segments([good], {"hopping": DEFAULT_PRIORS["walking"]})
    with pytest.raises(ValueError, match="cannot differ between people"):
        prior(BounceStepLength(), [0.3], [0.0], [0.1])
    with pytest.raises(ValueError, match=r"mean of BounceStepLength must be \(1,\)"):
        prior(BounceStepLength(), [0.3, 0.1], [0.0], [0.1])


# --- recordings -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk() -> tuple[Recording, Track]:
    legs = [Leg("walking", distance_m=12.0), *[Leg("walking", distance_m=12.0, turn_rad=1.5)] * 2]
    recording = simulate(legs, seed=3)
    return recording, pdr.track(recording)


def with_segments(recording: Recording, rows: list[tuple[float, float, float]]) -> Recording:
    start, end, distance = np.array(rows, dtype=float).T
    n_steps = np.full(len(rows), np.nan)
    segments = table({"start_s": start, "end_s": end, "distance_m": distance, "n_steps": n_steps})
    return replace(recording, truth=Truth(segments=segments))


def test_a_simulated_walk_is_calibrated_to_its_true_length(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    progress: list[float] = []
    found = calibrate(recording, tracks=[track], progress=progress.append)
    assert progress == [1.0]
    assert found.contexts == ("walking",)
    rows = found.segments
    assert len(rows) == 3
    # the first steps are short, and simulated people do not make shorter ones in turns
    np.testing.assert_allclose(rows.predicted_m, 12.0, rtol=0.17)
    assert list(found.subjects) == ["simulated"]
    assert found.subjects["simulated"].height_m == recording.subject.height_m


def test_bad_rows_of_the_truth_are_left_out_by_name(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    rows = [(0.0, 9.0, 12.0), (9.0, 5.0, 12.0), (1.0, 5.0, 0.0), (1.0, 5.0, -2.0), (900.0, 909.0, 12.0)]
    found = calibrate(with_segments(recording, rows), tracks=[track])
    assert len(found.segments) == 1
    notes = "\n".join(found.notes)
    assert "end is not after the start (anchors out of time order) in 9.0-5.0 s: left out" in notes
    assert "distance is not positive in 1.0-5.0 s (0 m), 1.0-5.0 s (-2 m): left out" in notes
    assert "no steps in 900.0-909.0 s: left out" in notes
    with pytest.raises(ValueError, match=r"nothing to calibrate with: simulated_walk: .*no steps in"):
        calibrate(with_segments(recording, rows[1:]), tracks=[track])
    with pytest.raises(ValueError, match="no truth of known length, no waypoints, no position fixes"):
        calibrate(replace(recording, truth=Truth()), tracks=[track])


def test_waypoints_out_of_time_order_are_left_out_by_name(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    time_s = np.array([0.0, 9.3, 18.5, 14.0, 27.0])
    points = table(
        {"time_s": time_s, "east_m": np.zeros(5), "north_m": np.array([0.0, 12, 24, 30, 42]), "floor": np.zeros(5)}
    )
    segments, notes = segments_of(replace(recording, truth=Truth(waypoints=points)), track)
    assert [s.start_s for s in segments] == [0.0, 9.3, 14.0]
    assert "out of time order) in 18.5-14.0 s" in notes[0]


def test_waypoints_on_two_floors_are_no_segment(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    points = table(
        {
            "time_s": np.array([0.0, 9.3, 18.5]),
            "east_m": np.zeros(3),
            "north_m": np.array([0.0, 12.0, 24.0]),
            "floor": np.array([0.0, 0.0, 1.0]),
        }
    )
    segments, _ = segments_of(replace(recording, truth=Truth(waypoints=points)), track)
    assert [s.end_s for s in segments] == [9.3]


def test_a_turn_in_a_known_walked_distance_is_measured_along_the_way(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    ends = recording.truth.segments.end_s
    rows = [(0.0, float(ends[0]), 12.0), (float(ends[0]), float(ends[2]), 24.0)]
    found = calibrate(with_segments(recording, rows), tracks=[track])
    assert found.segments.summed.tolist() == [False, True]
    assert any("turns in" in note and "summed step lengths" in note for note in found.notes)
    np.testing.assert_allclose(found.segments.predicted_m, [12.0, 24.0], rtol=0.11)


def test_a_stair_in_the_truth_is_known_better_than_clicks(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    segments, _ = segments_of(with_segments(recording, [(2.0, 2.5, 0.29), (2.0, 9.0, 9.0)]), track)
    assert [s.anchor_std_m for s in segments] == [0.02, 0.35]


def test_without_gyroscope_lengths_are_summed_and_the_report_says_so(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    found = calibrate(replace(recording, gyroscope=None), tracks=[track])
    assert found.segments.summed.all()
    assert "no gyroscope, so no headings: summed step lengths" in found.report()


def test_position_fixes_calibrate_a_walk_without_any_truth(walk: tuple[Recording, Track]) -> None:
    """A fix a second along a straight way, good to 2 m."""
    legs = [Leg("walking", distance_m=150.0)]
    recording = simulate(legs, seed=4)
    truth = recording.truth.position
    time_s = np.arange(0.0, float(truth.time_s[-1]), 1.0)
    east, north = (np.interp(time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m"))
    rng = np.random.default_rng(5)
    lat = 48.0 + np.degrees((north + rng.normal(0, 2, len(time_s))) / 6371008.8)
    lon = 11.0 + np.degrees((east + rng.normal(0, 2, len(time_s))) / 6371008.8) / np.cos(np.radians(48.0))
    location = Samples(time_s, np.column_stack([lat, lon, np.full(len(lat), 500.0), np.full(len(lat), 2 * 1.515)]))
    found = calibrate(replace(recording, truth=Truth(), location=location))
    assert 4 <= len(found.segments) <= 8
    exact = calibrate(recording)
    assert found.subjects["simulated"].k0 == pytest.approx(exact.subjects["simulated"].k0, rel=0.08)


def test_recordings_without_subject_are_of_one_person_unless_somebody_says_otherwise(
    walk: tuple[Recording, Track],
) -> None:
    recording, track = walk
    nameless = [replace(recording, meta={}, name=name) for name in ("a", "b")]
    one = calibrate(nameless, tracks=[track, track])
    assert set(one.subjects) == {"unnamed"}
    assert any('2 recordings have no subject id: taken for one person, "unnamed"' in note for note in one.notes)
    assert any("each_a_person (--each-a-person)" in note for note in one.notes)
    anna = calibrate(nameless, tracks=[track, track], subject="anna")
    assert set(anna.subjects) == {"anna"}
    np.testing.assert_array_equal(anna.people, one.people)
    each = calibrate(nameless, tracks=[track, track], each_a_person=True)
    assert set(each.subjects) == {"a", "b"}
    assert any("each is taken for a person of its own" in note for note in each.notes)
    named = calibrate([recording, nameless[0]], tracks=[track, track], subject="anna")
    assert set(named.subjects) == {"simulated", "anna"}
    with pytest.raises(ValueError, match="'anna' names one person, and each_a_person says that there are several"):
        calibrate(nameless, tracks=[track, track], subject="anna", each_a_person=True)


# --- what the filter takes of it ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def calibration(walk: tuple[Recording, Track]) -> Calibration:
    return calibrate(walk[0], tracks=[walk[1]])


def test_saved_and_loaded_it_is_the_same(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "models" / "me.json")
    for name in (path, path.with_suffix(".npz"), str(path.with_suffix(""))):
        again = load_calibration(name)
        for part in ("theta", "theta_cov", "between_cov", "people", "people_cov", "heights_m"):
            np.testing.assert_array_equal(getattr(again, part), getattr(calibration, part))
        assert again.models == calibration.models
        assert again.report() == calibration.report()
        assert again.scale_std("simulated") == calibration.scale_std("simulated")


def test_damaged_files_are_refused_by_name(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "me.json")
    with pytest.raises(ValueError, match=r"no_such\.json: no such file"):
        load_calibration(tmp_path / "no_such.json")
    other = tmp_path / "other.json"
    other.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    other.with_suffix(".npz").write_bytes(path.with_suffix(".npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"other\.json: not usable as calibration: .*damaged"):
        load_calibration(other)
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match=r"me\.json: not usable as calibration: its kind is None"):
        load_calibration(path)


def test_the_filter_walks_a_calibrated_length_with_its_uncertainty(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    doubled = with_segments(
        recording,
        [(float(s["start_s"]), float(s["end_s"]), 1.3 * float(s["distance_m"])) for s in recording.truth.segments] * 9,
    )
    found = calibrate(doubled, tracks=[track])
    own = pdr.track(recording, config=found.config(pdr.recipes.default(recording.subject), recording.subject))
    # two of the three lengths begin with a corner, in which simulated people do not make shorter steps
    assert own.distance_m == pytest.approx(1.3 * track.distance_m, rel=0.08)
    assert any("step lengths of simulated: walking" in note for note in own.notes)
    stranger = found.config(pdr.recipes.default(), Subject(id="somebody"))
    known = found.config(pdr.recipes.default(), recording.subject)
    assert known.model.noise.log_scale_std < 0.6 * stranger.model.noise.log_scale_std
    # contexts without segments keep their lengths
    for before, after in zip(pdr.recipes.default().model.modes, known.model.modes, strict=True):
        assert (after.step_length is before.step_length) == (after.context != "walking")


def test_a_fit_is_for_the_height_of_the_person(calibration: Calibration) -> None:
    assert calibration.fits("simulated")["walking"].model == BounceStepLength(1.75)
    assert calibration.fits(Subject(height_m=1.6))["walking"].model == BounceStepLength(1.6)
    assert calibration.fits(Subject(id="somebody"))["walking"].model == BounceStepLength()


def test_a_calibrated_track_says_whose_step_lengths_it_has(walk: tuple[Recording, Track]) -> None:
    recording, track = walk
    twice = [replace(recording, meta={}, name=name) for name in ("a", "b")]
    one, two = (calibrate(twice, tracks=[track] * 2, each_a_person=each) for each in (False, True))

    def noted(found: Calibration, subject: Subject) -> str:
        notes = found.config(pdr.recipes.default(), subject).notes
        return next(n.text for n in notes if n.about == "step lengths")

    assert "of unnamed, the calibrated person, as the recording does not say whose it is" in noted(one, Subject())
    assert "of the calibrated population (1 person), as bob was not calibrated" in noted(one, Subject(id="bob"))
    assert "of the calibrated population (2 people), as the recording does not say" in noted(two, Subject())
    assert noted(two, Subject(id="b")) == "step lengths of b: walking"
    np.testing.assert_array_equal(one.fits()["walking"].theta, one.subjects["unnamed"].k["walking"])
    anna = calibrate(twice, tracks=[track] * 2, subject="anna")
    assert "of anna, the calibrated person, as the recording does not say whose it is" in noted(anna, Subject())
    assert one.scale_std() < one.scale_std("bob")
    tall = calibrate([replace(r, meta={"subject": {"height_m": 1.9}}) for r in twice], tracks=[track] * 2)
    assert tall.person_of(Subject(height_m=1.89)) == "unnamed"
    assert tall.person_of(Subject(height_m=1.6)) is None


def test_the_report_has_people_errors_and_doubts_and_the_figure_is_drawn(
    calibration: Calibration, tmp_path: Path
) -> None:
    text = calibration.report()
    for words in ("3 segments, 36 m", "BounceStepLength", "simulated", "segment left out", "needs two people"):
        assert words in text
    assert calibration.plot(tmp_path / "new" / "figure.png").axes
    assert (tmp_path / "new" / "figure.png").stat().st_size > 10_000


def test_any_model_has_a_weak_prior_that_leaves_the_data_to_decide() -> None:
    rng, model, k = np.random.default_rng(20), FrequencyVarianceStepLength(), np.array([0.3, 0.25, 0.01])
    segments = [segment(rng, model, k, f"s{i % 4}") for i in range(80)]
    found = calibrate_segments(segments, {"walking": weak_prior(model)})
    regressors = model.regressors(TYPICAL_STEP)
    assert regressors @ found.k["walking"] == pytest.approx(regressors @ k, rel=0.02)


def test_loading_a_calibration_and_filtering_with_it_needs_no_gtsam(calibration: Calibration, tmp_path: Path) -> None:
    path = calibration.save(tmp_path / "me")
    code = (
        "import sys, pdr_filter as pdr; from pdr_filter.calibration import load_calibration\n"
        f"c = load_calibration({str(path)!r}); c.config(pdr.recipes.default()); print(c.report())\n"
        "assert not {'gtsam', 'matplotlib', 'pdr_filter.offline'} & set(sys.modules), 'loaded'"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize(
    ("name", "model", "theta"),
    [("kim", KimStepLength(), [0.55]), ("eq12", FrequencyVarianceStepLength(), [0.1, 0.2, 0.06])],
)
def test_enough_segments_choose_the_form_that_made_them_and_few_keep_the_default(
    name: str, model: StepLengthModel, theta: list[float]
) -> None:
    rng = np.random.default_rng(21)
    segments = [
        segment(rng, model, np.array(theta), error_m=float(rng.normal(0, 0.1)), recording=f"r{i % 6}")
        for i in range(60)
    ]
    found = calibrate_segments(segments)
    assert type(found.models["walking"]) is type(model)
    assert any(f"walking by {name}, the best of 5 forms" in note for note in found.notes)
    assert "6 recordings" in found.report()
    few = calibrate_segments(segments[:29])
    in_one = calibrate_segments([replace(s, recording="r") for s in segments])
    asked = calibrate_segments(segments, model="bounce")
    for kept in (few, in_one, asked):
        assert type(kept.models["walking"]) is BounceStepLength
        assert not any("forms" in note for note in kept.notes)
    assert type(calibrate_segments(segments[:5], model=name).models["walking"]) is type(model)
    with pytest.raises(ValueError, match=r"model must be one of bounce, eq12, kim, tian, weinberg, got 'guess'"):
        calibrate_segments(segments, model="guess")
    with pytest.raises(ValueError, match="leave out one of them"):
        calibrate_segments(segments, {"walking": DEFAULT_PRIORS["walking"]}, model="kim")


# --- real walks -----------------------------------------------------------------------------------------------------


def test_of_a_large_cohort_some_people_choose_the_form(monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.recordings
def test_half_of_the_legs_of_a_person_predict_the_other_half(data_dir: Path) -> None:
    """Two walks of humolire: k from one of them, the other within 5 % (15 legs each).

    He is 1.86 m, which is not given: without a calibration his steps are those of somebody of 1.70 m.
    """
    paths = [data_dir / "humolire" / f"humolire_user1_{name}.zip" for name in ("1f", "2r")]
    recordings = [replace(r, meta={**r.meta, "subject": {"id": "user1"}}) for r in map(pdr.read, paths)]
    tracks = [pdr.track(r) for r in recordings]
    for training, other in ((0, 1), (1, 0)):
        found = calibrate(recordings[training], tracks=[tracks[training]])
        start = {name: DEFAULT_PRIORS[name].mean for name in found.models}
        sums = integrate(segments_of(recordings[other], tracks[other])[0], found.models, start)
        true = sums.distance_m
        uncalibrated, calibrated = (
            np.hypot(*(sums.regressors @ theta).T) for theta in (np.concatenate([*start.values()]), found.people[0])
        )
        assert abs(uncalibrated.sum() / true.sum() - 1) > 0.06
        assert abs(calibrated.sum() / true.sum() - 1) < 0.05
        assert np.sqrt(np.square(calibrated / true - 1).mean()) < 0.08
