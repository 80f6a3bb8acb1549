# ruff: noqa: N803, N806 - the letters of the equations
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, flat_attitude, steps_of, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import pdr_filter as pdr
from pdr_filter.filter.step_length.models import (
    BounceStepLength,
    ChenStepLength,
    FrequencyStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    LinearStepLengthModel,
    MagnitudeRangeStepLength,
    PeriodPeakStepLength,
    StaticStepLength,
    StepLengthFit,
    StepLengthModel,
    StepLengths,
    TianStepLength,
    WeinbergStepLength,
    ZhouWalkingStepLength,
    bounce_fit,
    known_length,
    length_and_jacobian,
    scale_std,
    static_fit,
)
from pdr_filter.recipes import default
from pdr_filter.recipes.guo2018.recipe import chen_fit
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.modes import context_modes
from pdr_filter.recipes.tian2016.recipe import recipe_fit, tian_fit
from pdr_filter.recipes.zhou2019 import step_length as zhou2019
from pdr_filter.sensing.steps.step_detector import unknown_contexts
from pdr_filter.sensing.steps.step_log import amplitude as amplitude_of
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Step
from pdr_filter.values.serialisation import from_bytes, to_bytes

MODELS: list[StepLengthModel] = [
    StaticStepLength(1.8),
    FrequencyStepLength(),
    FrequencyVarianceStepLength(),
    FrequencyVarianceStepLength(max_variance=8.0),
    PeriodPeakStepLength(),
    WeinbergStepLength(),
    MagnitudeRangeStepLength(),
    KimStepLength(),
    TianStepLength(1.8),
    ChenStepLength(1.6),
    ZhouWalkingStepLength(),
    BounceStepLength(),
    BounceStepLength(height_m=1.6),
]
every_model = pytest.mark.parametrize("model", MODELS, ids=lambda m: type(m).__name__)


def step_of(
    frequency_hz: float = 2.0,
    variance: float = 4.0,
    vertical: tuple[float, float] = (-4.0, 12.0),
    magnitude: tuple[float, float] = (7.0, 15.0),
    mean_abs: float = 1.5,
    amplitude: float = 2.0,
) -> Step:
    return replace(
        a_step(duration_s=1 / frequency_hz, variance=variance),
        vertical_min_mps2=vertical[0],
        vertical_max_mps2=vertical[1],
        magnitude_min_mps2=magnitude[0],
        magnitude_max_mps2=magnitude[1],
        mean_abs_mps2=mean_abs,
        vertical_amplitude_mps2=amplitude,
    )


steps = st.builds(
    step_of,
    frequency_hz=st.floats(0.5, 4.0),
    variance=st.floats(0.0, 60.0),
    vertical=st.tuples(st.floats(-10.0, 0.0), st.floats(0.0, 30.0)),
    magnitude=st.tuples(st.floats(0.0, 9.0), st.floats(10.0, 40.0)),
    mean_abs=st.floats(0.0, 8.0),
    amplitude=st.floats(0.0, 12.0),
)
numbers = st.floats(-2.0, 2.0)


def length_of(model: StepLengthModel, step: Step, *theta: float) -> float:
    return float(length_and_jacobian(model, step, np.array(theta))[0])


# --- the papers' equations ------------------------------------------------------------------------------------------


def test_the_static_model_of_tian_et_al_applies_to_steps_from_rest_and_the_frequency_model_to_others() -> None:
    fit, second = recipe_fit(1.8, "M"), step_of()
    first = replace(second, from_rest=True)
    assert fit.predict(first)[0] == pytest.approx(0.415 * 1.8)
    assert fit.predict(second) == tian_fit(1.8, "M").predict(second)
    assert fit.predict(first)[1] == pytest.approx(static_fit(1.8, "M").predict(first)[1])


def test_every_model_gives_the_value_of_its_equation() -> None:
    step = step_of()  # f = 2 Hz, vertical range 16, magnitude 7 to 15, mean modulus 1.5
    peak = 15.0 - STANDARD_GRAVITY_MPS2
    for length, value in [
        (length_of(StaticStepLength(1.8), step, 0.415), 0.415 * 1.8),
        (length_of(FrequencyStepLength(), step, 0.3, 0.2), 0.7),
        (length_of(FrequencyVarianceStepLength(), step, 0.3, 0.2, 0.01), 0.74),
        (length_of(FrequencyVarianceStepLength(max_variance=3.0), step, 0.3, 0.2, 0.01), 0.73),
        (length_of(PeriodPeakStepLength(), step, 0.3, 0.4, 0.05), 0.5 + 0.05 * peak),
        (length_of(WeinbergStepLength(), step, 0.35), 0.7),
        (length_of(MagnitudeRangeStepLength(), step, 0.4), 0.4 * 8**0.25),
        (length_of(KimStepLength(), step_of(mean_abs=8.0), 0.35), 0.7),
        (length_of(TianStepLength(1.8), step, 0.3), 0.3 * 1.8 * 2**0.5),
        (length_of(ChenStepLength(1.85), step, 0.4, 0.2, 1.1), (0.7 + 0.04 + 0.2 * 0.21 * 1.85 / 1.75) * 1.1),
        (length_of(ZhouWalkingStepLength(), step, 0.2, 0.4, 0.1, 0.05), 0.2 + 0.4 / 2 + 0.1 / 2**0.5 + 0.05 * peak),
        (length_of(BounceStepLength(height_m=1.8), step_of(amplitude=1.6), 0.3), 0.54 * 1.6**0.25),
    ]:
        assert length == pytest.approx(value, rel=1e-12)


def test_the_models_of_zhou_et_al_have_the_numbers_of_the_paper() -> None:
    of_paper = [getattr(zhou2019, f"M{k}") for k in range(1, 8)]
    first = [FrequencyStepLength, FrequencyVarianceStepLength, PeriodPeakStepLength, MagnitudeRangeStepLength]
    assert of_paper == [*first, TianStepLength, KimStepLength, ZhouWalkingStepLength]


def test_the_printed_constants_give_the_lengths_of_men_and_women() -> None:
    step = step_of(frequency_hz=1.8)
    assert static_fit(1.8, "M").predict(step)[0] == pytest.approx(0.415 * 1.8)
    assert static_fit(1.6, "F").predict(step)[0] == pytest.approx(0.413 * 1.6)
    assert tian_fit(1.8, "M").predict(step)[0] == pytest.approx(0.3139 * 1.8 * 1.8**0.5)
    assert tian_fit(1.6, "F").predict(step)[0] == pytest.approx(0.2975 * 1.6 * 1.8**0.5)
    unknown = tian_fit(1.7).predict(step)[0]
    assert unknown == pytest.approx((tian_fit(1.7, "M").predict(step)[0] + tian_fit(1.7, "F").predict(step)[0]) / 2)


def test_the_printed_fits_are_as_uncertain_as_their_authors_distances() -> None:
    for fit, relative in [(static_fit(1.7), 0.128), (tian_fit(1.7), 0.082), (chen_fit(1.7), 0.08)]:
        length_m, var_m2 = fit.predict(step_of())
        assert np.sqrt(var_m2 - fit.residual_std_m**2) / length_m == pytest.approx(relative, abs=0.001)


def test_the_model_of_chen_gives_0_7_m_at_its_reference() -> None:
    assert chen_fit(1.75).predict(step_of(frequency_hz=1.79))[0] == pytest.approx(0.7)


def test_all_models_of_known_constants_agree_on_a_usual_walk() -> None:
    step = step_of(frequency_hz=1.85, amplitude=2.2)
    for fit in (static_fit(1.75), tian_fit(1.75), chen_fit(1.75), bounce_fit(1.75)):
        assert fit.predict(step)[0] == pytest.approx(0.72, abs=0.02)


# --- scaling laws ---------------------------------------------------------------------------------------------------


@given(frequency_hz=st.floats(0.5, 2.4), A=st.floats(0.3, 3.0))
def test_the_default_model_grows_with_the_fourth_root_of_the_bounce_at_any_cadence(
    frequency_hz: float, A: float
) -> None:
    length = length_of(BounceStepLength(), step_of(frequency_hz=frequency_hz, amplitude=A), 0.34)
    assert length == pytest.approx(0.34 * 1.70 * A**0.25, rel=1e-12)


def test_the_default_model_bounds_implausible_inputs() -> None:
    model = BounceStepLength()
    assert length_of(model, step_of(amplitude=50.0), 0.34) == length_of(model, step_of(amplitude=3.0), 0.34)
    assert length_of(model, step_of(amplitude=0.0), 0.34) == length_of(model, step_of(amplitude=0.3), 0.34)
    spun = [length_of(model, replace(step_of(), turn_rate_radps=w), 0.34) for w in (1.5, 30.0)]
    assert spun[0] == spun[1]


def test_a_step_detected_twice_keeps_its_speed() -> None:
    once, twice = (length_of(BounceStepLength(), step_of(frequency_hz=f), 0.34) for f in (2.4, 4.8))
    assert twice == pytest.approx(0.5 * once)


@given(steps, st.floats(0.0, 6.0), st.floats(0.0, 20.0), st.booleans())
def test_a_length_of_the_default_is_bounded_and_shorter_in_a_turn(
    step: Step, turn_rate_radps: float, usual_mps2: float, from_rest: bool
) -> None:
    """A length is at most 0.45 of the height, and at least a twentieth of that with all factors at their limits."""
    step = replace(step, from_rest=from_rest, usual_amplitude_mps2=usual_mps2)
    step = replace(step, vertical_amplitude_mps2=max(step.vertical_amplitude_mps2, 0.1))
    step = replace(step, stride_amplitude_mps2=step.vertical_amplitude_mps2)
    turning = replace(step, turn_rate_radps=turn_rate_radps)
    straight_m, turning_m = (bounce_fit(1.8).predict(s)[0] for s in (step, turning))
    assert 0.45 * 1.8 / 20 < turning_m <= straight_m < 0.45 * 1.8


def test_steps_at_a_turn_rate_of_one_radian_a_second_are_a_fifth_shorter() -> None:
    """The value is that of people in rooms of 4 to 6 m (tyrex, oxiod)."""
    straight, turning = (length_of(BounceStepLength(), replace(step_of(), turn_rate_radps=w), 0.34) for w in (0, 1))
    assert turning == pytest.approx(4 / 5 * straight, rel=0.02)


# --- derivatives ----------------------------------------------------------------------------------------------------


@every_model
def test_every_model_passes_the_checks_for_models_of_users(model: StepLengthModel) -> None:
    pdr.testing.verify_step_length(model)


@given(steps, arrays(float, (5, 3), elements=numbers))
def test_many_parameters_at_once_give_the_lengths_and_derivatives_of_each(step: Step, thetas: np.ndarray) -> None:
    model = ChenStepLength(1.82)
    length, jacobian = length_and_jacobian(model, step, thetas)
    for i, theta in enumerate(thetas):
        one, own = length_and_jacobian(model, step, theta)
        assert length[i] == one
        np.testing.assert_array_equal(jacobian[i], own)


def test_an_object_that_is_not_a_step_length_model_is_refused_by_name() -> None:
    with pytest.raises(TypeError, match="str has neither regressors nor"):
        length_and_jacobian("0.7 m", a_step(), np.zeros(1))  # type: ignore[arg-type]


# --- fits -----------------------------------------------------------------------------------------------------------


def random_fit(model: StepLengthModel, rng: np.random.Generator) -> StepLengthFit:
    root = rng.normal(size=(model.n_params, model.n_params))
    return StepLengthFit(model, rng.normal(size=model.n_params), root @ root.T, abs(rng.normal()))


@settings(max_examples=50)
@given(step=steps, other=steps, seed=st.integers(0, 10_000))
def test_fits_together_give_the_results_of_each_alone(step: Step, other: Step, seed: int) -> None:
    rng = np.random.default_rng(seed)
    fits = tuple(random_fit(MODELS[i], rng) for i in rng.integers(0, len(MODELS), rng.integers(1, 12)))
    together = StepLengths(fits)
    length, parameter_var = together.moments(step)
    variance = parameter_var + together.residual_var_m2
    alone = np.array([fit.predict(step) for fit in fits])
    np.testing.assert_allclose(np.stack([length, variance], axis=1), alone, rtol=1e-9, atol=1e-9)
    of_all = zip(*together.moments_of_all([other, step]), strict=True)
    for found, each in zip(of_all, (other, step), strict=True):
        np.testing.assert_allclose(found, together.moments(each), rtol=1e-9, atol=1e-9)
    assert together.moments_of_all([])[0].shape == (0, len(fits))


@every_model
def test_the_variance_of_a_length_is_that_of_its_parameters_and_its_residual(model: StepLengthModel) -> None:
    rng = np.random.default_rng(0)
    step = step_of(frequency_hz=1.9)
    theta = np.full(model.n_params, 0.5)
    root = 0.01 * rng.normal(size=(model.n_params, model.n_params))  # small, so that the models are linear in it
    fit = StepLengthFit(model, theta, root @ root.T, 0.05)
    drawn = theta + rng.normal(size=(40_000, model.n_params)) @ root.T
    length = length_and_jacobian(model, step, drawn)[0] + 0.05 * rng.normal(size=40_000)
    assert fit.predict(step)[1] == pytest.approx(length.var(), rel=0.03)


@every_model
def test_no_model_gives_a_negative_length(model: StepLengthModel) -> None:
    # the length of Chen is a product, so its sign is that of c
    theta = np.array([1.0, 1.0, -1.0]) if isinstance(model, ChenStepLength) else -np.ones(model.n_params)
    fit = StepLengthFit(model, theta, np.zeros((model.n_params,) * 2), 0.0)
    assert length_of(model, step_of(), *theta) < 0
    assert fit.predict(step_of())[0] == 0.0


@every_model
def test_a_saved_fit_comes_back_with_its_model(model: StepLengthModel) -> None:
    fit = random_fit(model, np.random.default_rng(3))
    back = from_bytes(to_bytes(fit))
    assert back.model == model
    assert back.predict(step_of()) == fit.predict(step_of())


def test_an_unknown_height_is_the_usual_one() -> None:
    assert bounce_fit().predict(step_of()) == bounce_fit(1.70).predict(step_of())
    assert bounce_fit(1.9).predict(step_of())[0] == pytest.approx(1.9 / 1.70 * bounce_fit().predict(step_of())[0])


def test_a_known_height_reduces_the_standard_deviation_by_less_than_half() -> None:
    """The values are those of held-out sites: docs/tables/step_length_sites.md for a known height."""
    assert 0.5 * scale_std(None) < scale_std(1.8) < 0.8 * scale_std(None)


def test_all_steps_on_stairs_may_share_one_error() -> None:
    fits = {mode.context: mode.step_length for mode in context_modes(bounce_fit(1.7))}
    for context in ("upstairs", "downstairs"):
        assert StepLengths((fits[context],)).moments(step_of())[1] == pytest.approx(0.1**2)


def test_a_step_weaker_than_usual_is_shorter_and_a_stronger_one_is_not_longer() -> None:
    model = BounceStepLength()
    usual = replace(step_of(amplitude=1.6), stride_amplitude_mps2=1.6)
    lengths = {ratio: length_of(model, replace(usual, usual_amplitude_mps2=1.6 / ratio), 0.3) for ratio in (0.5, 1, 2)}
    assert lengths[1] == lengths[2] == length_of(model, usual, 0.3)
    assert lengths[0.5] == pytest.approx(0.5**0.25 * lengths[1])


def test_in_a_pocket_the_steps_of_the_weaker_leg_are_not_shorter() -> None:
    model = BounceStepLength()
    weak = replace(step_of(amplitude=1.0), usual_amplitude_mps2=2.0)
    of_pocket = length_of(model, replace(weak, stride_amplitude_mps2=2.5), 0.3)
    assert of_pocket == length_of(model, step_of(amplitude=1.0), 0.3)


def test_a_step_from_rest_is_half_a_step() -> None:
    model = BounceStepLength()
    assert length_of(model, replace(step_of(), from_rest=True), 0.3) == pytest.approx(
        0.5 * length_of(model, step_of(), 0.3)
    )


# --- the bounce of a step -------------------------------------------------------------------------------------------


@given(st.integers(8, 120), st.floats(0.1, 9.0), st.floats(-3.0, 3.0), st.floats(-20.0, 20.0), st.floats(0.0, 9.0))
def test_the_amplitude_is_that_of_the_sinusoid_in_spite_of_level_and_harmonics(
    n: int, amplitude: float, phase: float, level: float, heel_strike: float
) -> None:
    turn = 2 * np.pi * np.arange(n) / n
    signal = level + amplitude * np.cos(turn + phase)
    harmonics = heel_strike * (np.cos(2 * turn) + np.sin(3 * turn))
    assert amplitude_of(signal + harmonics) == pytest.approx(amplitude, rel=1e-9, abs=1e-9)


def test_a_detected_step_has_the_amplitude_of_the_bounce() -> None:
    time_s = (np.arange(1000) + 0.5) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + 2.0 * np.sin(2 * np.pi * 1.8 * time_s)
    detector = WaveletStepDetector()
    found = detector.update(
        detector.init(), uniform_block(magnitude), flat_attitude(magnitude), unknown_contexts(len(magnitude))
    )[1]
    amplitudes = [step.vertical_amplitude_mps2 for _, step in found[1:]]
    assert len(amplitudes) > 10
    assert amplitudes == pytest.approx([2.0] * len(amplitudes), rel=0.03)


# --- real walks -----------------------------------------------------------------------------------------------------

Sums = tuple[str, np.ndarray, float]  # walk, regressors summed along the leg (p,), true metres


@cache
def recorded(path: Path) -> tuple[pdr.Recording, list[Step]]:
    recording = pdr.read(path)
    return recording, steps_of(recording)


def legs_of(folder: Path, model: Callable[[float], LinearStepLengthModel], every: int = 1) -> list[Sums]:
    """Return the regressors of every leg, projected on the leg, so that their product with theta is its length."""
    legs: list[Sums] = []
    for path in sorted(folder.glob("*.zip"))[::every]:
        recording, found = recorded(path)
        if recording.truth.segments is not None:
            segments = recording.truth.segments
            stretches = list(zip(segments.start_s, segments.end_s, segments.distance_m, strict=True))
        else:
            points = recording.truth.waypoints
            far = np.hypot(np.diff(points.east_m), np.diff(points.north_m))
            stretches = [x for x in zip(points.time_s[:-1], points.time_s[1:], far, strict=True) if x[2] > 4]
        end, duration = (np.array([getattr(s, n) for s in found]) for n in ("time_s", "duration_s"))
        heading = np.array([s.device_heading_rad for s in found])
        r = np.array([model(recording.subject.height_m or 1.75).regressors(s) for s in found])
        for start_s, end_s, distance_m in stretches:
            part = np.clip((np.minimum(end, end_s) - np.maximum(end - duration, start_s)) / duration, 0, 1)
            if part.sum() < 4:
                continue
            mean = np.angle((part * np.exp(1j * heading)).sum())
            legs.append((recording.name, (part * np.cos(heading - mean)) @ r, float(distance_m)))
    return legs


@pytest.mark.parametrize(
    ("model", "total_percent", "leg_percent"),
    [
        (lambda h: KimStepLength(), 2.5, 5.0),
        (lambda h: FrequencyVarianceStepLength(), 2.5, 5.0),
        (lambda h: FrequencyStepLength(), 3.0, 5.7),
        (TianStepLength, 2.7, 5.5),
        (BounceStepLength, 3.0, 5.5),
    ],
    ids=["Kim", "Martinelli", "frequency", "Tian", "bounce"],
)
def test_a_held_out_walk_is_predicted_from_the_others(
    data_dir: Path, model: Callable[[float], LinearStepLengthModel], total_percent: float, leg_percent: float
) -> None:
    legs = legs_of(data_dir / "humolire", model)
    walks = sorted({walk for walk, _, _ in legs})
    total, one = [], []
    for left_out in walks:
        A = np.array([r for walk, r, _ in legs if walk != left_out])
        d = np.array([m for walk, _, m in legs if walk != left_out])
        theta = np.linalg.lstsq(A, d)[0]
        own = [(r @ theta, m) for walk, r, m in legs if walk == left_out]
        predicted, true = np.array(own).T
        total.append(100 * (predicted.sum() / true.sum() - 1))
        one += list(100 * (predicted / true - 1))
    assert (len(walks), len(one)) == (9, 133)
    assert np.sqrt(np.mean(np.square(total))) < total_percent
    assert np.sqrt(np.mean(np.square(one))) < leg_percent


def test_the_scale_of_the_default_model_agrees_at_two_sites(data_dir: Path) -> None:
    def scale(site: str, model: Callable[[float], LinearStepLengthModel]) -> float:
        legs = legs_of(data_dir / site, model, every=2 if site == "ms_indoor" else 1)
        return sum(m for _, _, m in legs) / sum(float(r[0]) for _, r, _ in legs)

    ratio = scale("humolire", BounceStepLength) / scale("ms_indoor", BounceStepLength)
    assert abs(np.log(ratio)) < 0.07
    # a model that depends on the heel impact does not
    assert (
        abs(np.log(scale("humolire", lambda h: KimStepLength()) / scale("ms_indoor", lambda h: KimStepLength()))) > 0.2
    )


def test_a_step_faster_than_any_sprinter_is_no_longer_than_the_fastest_possible_step() -> None:
    running = next(mode for mode in default().model.modes if mode.name == "running").step_length
    length_m, _ = running.predict(step_of(frequency_hz=6.0))
    assert length_m == running.predict(step_of(frequency_hz=4.5))[0] < 1.6


@pytest.mark.parametrize("length_m", [0.05, 0.7, 3.0])
def test_any_step_length_of_people_is_accepted(length_m: float) -> None:
    walking = next(mode for mode in default().model.modes if mode.context == "walking")
    assert replace(walking, step_length=known_length(length_m, 0.05)).step_length.theta[0] == length_m
