"""Calibration of the step-length models that a configuration has, and their priors between people."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_segments import segment, step

import pdr_filter as pdr
from pdr_filter.filter.step_length.models import (
    TYPICAL_STEP,
    BounceStepLength,
    KimStepLength,
    StaticStepLength,
    WeinbergStepLength,
    bounce_fit,
    length_and_jacobian,
)
from pdr_filter.offline.calibration.fit import Contexts, calibrate_segments
from pdr_filter.offline.calibration.priors import (
    DEFAULT_PRIORS,
    own_priors,
    prior,
    separate_modes,
    weak_prior,
    with_relative_std,
)
from pdr_filter.offline.calibration.segments import Segment, segments_of
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import CONTEXTS, FloatArray, Step
from pdr_filter.values.recording import Recording, Subject

KIM = pdr.StepLengthFit(KimStepLength(), np.array([0.45]), np.array([[0.05**2]]), 0.08)
WEINBERG = pdr.StepLengthFit(WeinbergStepLength(), np.array([0.38]), np.array([[0.05**2]]), 0.08)
CONSTANT = pdr.known_length(0.55, 0.08, shared_std_m=0.06)


def of_three_modes() -> pdr.Config:
    """Return the default configuration with three modes of walking, each with a model of its own."""
    config = pdr.recipes.default()
    walking = next(mode for mode in config.model.modes if mode.name == "walking")
    fits = {"kim": KIM, "walking": WEINBERG, "constant": CONSTANT}
    others = [mode for mode in config.model.modes if mode is not walking]
    return config.with_modes([*others, *(replace(walking, name=name, step_length=f) for name, f in fits.items())])


def model_kinds(config: pdr.Config) -> dict[str, type]:
    return {mode.name: type(mode.step_length.model) for mode in config.model.modes}


@pytest.fixture(scope="module")
def corridor() -> Recording:
    legs = [Leg("walking", distance_m=25.0), Leg("stationary", duration_s=3.0)]
    return simulate(4 * legs, Gait(height_m=1.75), "texting", seed=4)


@pytest.mark.parametrize(
    "config", [of_three_modes(), pdr.recipes.default().with_step_length("walking", WEINBERG)], ids=["three", "weinberg"]
)
def test_each_mode_of_a_configuration_keeps_its_model_and_the_walk_gets_its_length(
    config: pdr.Config, corridor: Recording, tmp_path: Path
) -> None:
    found = pdr.calibrate(corridor, config=config)
    own = found.config(config, corridor.subject)
    assert model_kinds(own) == model_kinds(config)
    for before, after in zip(config.model.modes, own.model.modes, strict=True):
        assert (after.step_length is before.step_length) == (after.context != "walking")
    assert not any("in place of" in str(note) for note in own.notes)
    track = pdr.track(corridor, config=config, calibration=found)
    assert pdr.track(corridor, config=config).distance_m < 92.0
    assert track.distance_m == pytest.approx(100.0, rel=0.03)
    path = found.save(tmp_path / "mine")
    assert pdr.track(corridor, config=config, calibration=path).distance_m == track.distance_m


def test_a_calibration_of_other_models_or_modes_says_so_in_the_track(corridor: Recording) -> None:
    config = of_three_modes()
    by_context = pdr.calibrate(corridor, config=config, model="tian")
    assert by_context.contexts == ("walking",)
    (note,) = (n.text for n in by_context.config(config).notes if "in place of" in n.text)
    assert "TianStepLength in place of WeinbergStepLength for walking" in note
    assert "TianStepLength in place of FrequencyVarianceStepLength for constant" in note
    by_mode = pdr.calibrate(corridor, config=config)
    notes = [n.text for n in by_mode.config(pdr.recipes.default()).notes]
    assert any("calibrated step lengths of constant, kim are not used" in note for note in notes)
    level = pdr.ContextModel.load("context").renamed({"walking": "level"})
    modes = [replace(m, name="level", context="level") if m.name == "walking" else m for m in config.model.modes[:-3]]
    renamed = pdr.recipes.default().with_contexts(level, [*modes, pdr.Mode("level")])
    with pytest.raises(ValueError, match=r"step lengths of walking, but recipe 'default' has the modes .*level"):
        by_context.config(renamed)


def test_steps_count_for_each_mode_by_its_own_probability(corridor: Recording) -> None:
    track = pdr.track(corridor, config=of_three_modes())
    prob = np.random.default_rng(0).dirichlet(np.ones(len(track.modes)), track.n_steps)
    track = replace(track, mode_prob=prob)
    (found, *_), _ = segments_of(corridor, track, separate=("kim", "walking", "constant"))
    assert found.context_names == track.modes
    first = int(np.flatnonzero(np.all(prob[:, None] == found.context_prob[0], axis=2))[0])
    np.testing.assert_array_equal(found.context_prob, prob[first : first + len(found.steps)])
    with pytest.raises(ValueError, match="the track has no modes slow"):
        segments_of(corridor, track, separate=("slow", "kim"))


def test_modes_of_two_models_recover_their_exact_parameters() -> None:
    rng, k = np.random.default_rng(1), {"kim": 0.6, "constant": 0.7}
    segments: list[Segment] = []
    for share in (1.0, 0.7, 0.4, 0.0) * 4:
        one = segment(rng, StaticStepLength(1.0), np.array([0.7]))
        lengths_m = [share * 0.6 * KimStepLength().regressors(s)[0] + (1 - share) * 0.7 for s in one.steps]
        prob = np.tile([share, 1 - share], (len(one.steps), 1))
        segments.append(
            replace(one, distance_m=sum(lengths_m), context_prob=prob, context_names=tuple(k), heading_rad=None)
        )
    priors = {
        "kim": prior(KimStepLength(), [0.4], [np.inf], [0.0]),
        "constant": prior(StaticStepLength(1.0), [0.5], [np.inf], [0.0]),
    }
    found = calibrate_segments(
        segments, priors, recording_std=0.0, contexts=Contexts(of_modes=dict.fromkeys(k, "walking"))
    )
    assert {name: pytest.approx(value, abs=1e-8) for name, value in k.items()} == {
        name: value[0] for name, value in found.k.items()
    }
    # both modes of the context are calibrated, although one has most steps in every segment of this part
    part = [s for s in segments if s.context_prob[0, 0] == 0.7]
    assert calibrate_segments(part, {n: replace(p, std=np.ones(1)) for n, p in priors.items()}).contexts == ("kim",)
    both = calibrate_segments(
        part,
        {n: replace(p, std=np.ones(1)) for n, p in priors.items()},
        contexts=Contexts(of_modes=dict.fromkeys(k, "walking")),
    )
    assert both.contexts == ("kim", "constant")


# --- priors of a configuration --------------------------------------------------------------------------------------


@pytest.mark.parametrize("height_m", [None, 1.62])
def test_default_step_lengths_have_the_default_priors_whatever_the_names_of_the_contexts(
    height_m: float | None,
) -> None:
    config = pdr.recipes.default(Subject(height_m=height_m))
    assert separate_modes(config.model) == {}
    assert own_priors(config.model) == DEFAULT_PRIORS  # the same objects
    renamed = {name: f"my {name}" for name in CONTEXTS}
    modes = [replace(m, name=renamed[m.name], context=renamed[m.context]) for m in config.model.modes]
    own = config.with_contexts(pdr.ContextModel.load("context").renamed(renamed), modes)
    assert own_priors(own.model) == {renamed[name]: p for name, p in DEFAULT_PRIORS.items()}


def test_another_step_length_has_the_parameters_and_covariance_of_its_mode_as_prior() -> None:
    wider = pdr.StepLengthFit(BounceStepLength(), np.array([0.34]), np.array([[0.1**2]]), 0.05)
    config = pdr.recipes.default(Subject(height_m=1.8)).with_step_length("walking", wider)
    found = own_priors(config.model)["walking"]
    assert (found.mean[0], found.std[0], found.step_std_m) == (0.34, pytest.approx(0.1), 0.05)
    assert found.between_std[0] == pytest.approx(0.07 * 0.34)


def test_modes_with_one_step_length_or_a_named_model_are_calibrated_together() -> None:
    config = of_three_modes()
    assert separate_modes(config.model) == dict.fromkeys(("kim", "walking", "constant"), "walking")
    assert separate_modes(config.model, ["walking"]) == {}
    assert "kim" not in own_priors(config.model, ["walking"])
    assert separate_modes(config.with_step_length("walking", KIM).with_step_length("constant", KIM).model) == {}
    treadmill = replace(config.model.modes[-1], name="treadmill", step_length=bounce_fit(), moves=False)
    both = pdr.recipes.default().with_modes([*pdr.recipes.default().model.modes, treadmill])
    assert separate_modes(both.model) == {"walking": "walking", "treadmill": "walking"}
    assert own_priors(both.model)["walking"] is DEFAULT_PRIORS["walking"]
    with pytest.raises(ValueError, match="modes running have the name of another context"):
        modes = [m for m in config.model.modes if m.name != "running"]
        separate_modes(config.with_modes([*modes, replace(modes[-1], name="running", step_length=KIM)]).model)


def test_step_lengths_that_are_held_are_refused_or_named(corridor: Recording) -> None:
    config = pdr.recipes.default().with_step_length("walking", pdr.known_length(0.7, 0.05))
    with pytest.raises(ValueError, match=r"step length of walking is not fitted.*theta_cov.*shared_std_m"):
        pdr.calibrate(corridor, config=config)
    with pytest.raises(ValueError, match="modes of walking have different ones: set theta_cov"):
        pdr.calibrate(corridor, config=of_three_modes(), prior_std=0.1)
    rng, k = np.random.default_rng(2), np.array([0.34])
    held = prior(StaticStepLength(1.0), [0.64], [0.0], [0.0])
    walked = [segment(rng, BounceStepLength(), k), segment(rng, BounceStepLength(), k, upstairs=1.0)]
    found = calibrate_segments(walked, {"upstairs": held})
    (note,) = (n for n in found.notes if "not fitted" in n)
    assert note.startswith("the step length of upstairs is not fitted")
    assert (
        "calibrated for walking, upstairs (held, not fitted); other"
        in found.config(pdr.recipes.default()).notes[0].text
    )


# --- parameters without an effect -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoBranches:
    """Length b0 + b1 r for a small range r of the acceleration, b2 + b3 r for a large one, in a given order."""

    order: tuple[int, ...] = (0, 1, 2, 3)
    n_params: int = 4

    def regressors(self, step: Step) -> FloatArray:
        r = step.variance**0.25
        row = np.array([1.0, r, 0.0, 0.0]) if step.variance < 3.5 else np.array([0.0, 0.0, 1.0, r])
        return row[list(self.order)]


ORDERS = [(0, 1, 2, 3), (2, 3, 0, 1), (2, 0, 1, 3), (0, 2, 3, 1)]


def own_prior(order: tuple[int, ...], std: Any = 0.05) -> Any:
    theta_cov = np.diag(np.full(4, std) ** 2)
    fit = pdr.StepLengthFit(TwoBranches(order), np.array([0.2, 0.3, 0.2, 0.3])[list(order)], theta_cov, 0.08)
    return own_priors(pdr.recipes.default().with_step_length("walking", fit).model)["walking"]


@pytest.mark.parametrize("order", ORDERS)
def test_people_differ_in_a_parameter_with_an_effect_in_any_order_of_the_branches(order: tuple[int, ...]) -> None:
    for found, share in (
        (own_prior(order), 0.1),
        (weak_prior(TwoBranches(order), own_prior(order).mean), 0.07),
        (weak_prior(TwoBranches(order)), 0.07),
    ):
        length_m, slope = length_and_jacobian(found.model, TYPICAL_STEP, found.mean)
        np.testing.assert_array_equal(np.flatnonzero(found.between_std), [order.index(2)])
        assert np.abs(slope @ found.between_std) == pytest.approx(share * length_m)
    wide = with_relative_std(own_prior(order), 0.2)
    assert wide.std[order.index(2)] == pytest.approx(0.2 * (0.2 + 0.3 * 4.0**0.25) if TYPICAL_STEP.variance == 4 else 0)
    assert np.sum(wide.std != 0.05) == 1


def test_the_order_of_the_branches_does_not_change_a_calibration() -> None:
    rng, k = np.random.default_rng(3), np.array([0.25, 0.3, 0.22, 0.33])
    walked = [
        segment(rng, TwoBranches(), k, f"s{i % 3}", recording=f"r{i}", error_m=float(rng.normal(0, 0.3)))
        for i in range(18)
    ]
    assert len({s.variance < 3.5 for one in walked for s in one.steps}) == 2
    results = [calibrate_segments(walked, {"walking": own_prior(order)}) for order in ORDERS]
    for order, found in zip(ORDERS, results, strict=True):
        np.testing.assert_allclose(found.k["walking"], results[0].k["walking"][list(order)], rtol=1e-5)
        np.testing.assert_allclose(found.segments.left_out_m, results[0].segments.left_out_m, rtol=1e-5)


def test_parameters_that_are_held_or_without_effect_have_no_spread_between_people() -> None:
    held = own_prior((0, 1, 2, 3), [0.05, 0.05, 0.0, 0.0])
    np.testing.assert_array_equal(held.between_std, np.zeros(4))
    assert with_relative_std(own_prior((0, 1, 2, 3), 0.0), 0.1).std.nonzero()[0] == [2]
    quick = replace(step(1.9), variance=1.0)
    assert weak_prior(TwoBranches(), step=quick).between_std.nonzero()[0] == [0]
    none = prior(StaticStepLength(1.0), [0.0], [np.inf], [0.0])
    assert with_relative_std(replace(none, mean=np.array([0.7])), 0.1).std[0] == pytest.approx(0.07)
