"""Step lengths that are calibrated together with the smoothed walks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from average_walk import average_walk
from own_parts import HeadingRule
from true_positions import position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.filter.step_length.calibration_result import slices_of
from pdr_filter.offline.calibration.joint_smoothing import displacement_by_theta, mode_names, with_parameters
from pdr_filter.offline.calibration.model_forms import forms_of
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.offline.smoothing.preintegration import increments
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording, Truth

pytestmark = pytest.mark.usefixtures("sensing_once")

TWO_FIXES = [pdr.PositionFix(t, np.array([0.0, t]), np.eye(2)) for t in (15.0, 25.0)]
AT_ONCE = [TWO_FIXES[0], pdr.PositionFix(15.01, np.array([5.0, 15.0]), np.eye(2))]
CONTRADICTED = [pdr.PositionFix(t, np.array([90.0 * t % 400.0, 70.0 * t % 300.0]), np.eye(2)) for t in range(10, 34, 3)]
STAND = pdr.simulate.Leg("stationary", duration_s=2.0)


def rectangle(seed: int = 0, length_factor: float = 1.25) -> Recording:
    """A walk of 60 m around a block, of a person with long steps."""
    sides = [pdr.simulate.Leg("walking", distance_m=d, turn_rad=np.pi / 2) for d in (18.0, 12.0, 18.0, 12.0)]
    gait = pdr.simulate.Gait(length_factor=length_factor, habit=seed)
    return pdr.simulate.simulate([STAND, *sides, STAND], gait, seed=seed)


def errors_std(one: pdr.Calibration, true_m: float) -> float:
    """Error of the distance predicted by the calibration, in its standard deviations."""
    person = next(iter(one.subjects.values()))
    std = person.k_std["walking"][0] / person.k["walking"][0]
    return float((one.segments.predicted_m.sum() / true_m - 1) / std)


def test_a_loop_closure_and_two_fixes_calibrate_a_walk_without_known_lengths() -> None:
    walk = rectangle()
    fixes = position_fixes([15.0, 32.0], true_m(walk, [15.0, 32.0]), 0.3)
    blind = replace(walk, truth=Truth())
    found = pdr.calibrate(blind, smooth=True, fixes=[fixes], loop_closures=[[LoopClosure(1.0, walk.duration_s - 1.0)]])
    assert abs(errors_std(found, 60.0)) < 2.0
    assert found.segments.predicted_m.sum() == pytest.approx(60.0, rel=0.06)
    assert found.segments.uncalibrated_m.sum() < 54.0  # the average person makes shorter steps
    (track,) = found.tracks
    assert np.hypot(*(track.position_m[-1] - track.start_position_m)) < 1.5
    assert pdr.track(blind, calibration=found).distance_m == pytest.approx(60.0, rel=0.06)


def test_waypoints_and_stretches_of_known_length_give_the_parameters_of_a_calibration_from_segments() -> None:
    walks = [rectangle(seed) for seed in (1, 2)]
    for part in ("segments", "waypoints"):
        known = [replace(w, truth=Truth(**{part: getattr(w.truth, part)})) for w in walks]
        one, other = (
            next(iter(pdr.calibrate(known, smooth=s, model="bounce").subjects.values())) for s in (False, True)
        )
        std = one.k_std["walking"][0]
        assert abs(other.k0 - one.k0) < std, part
        assert other.k_std["walking"][0] == pytest.approx(std, rel=0.25), part


def test_a_wrong_length_is_rejected_and_named() -> None:
    walk = rectangle()
    segments = walk.truth.segments.copy()
    right = pdr.calibrate(replace(walk, truth=Truth(segments=segments)), smooth=True)
    segments.distance_m[1] *= 1.6
    found = pdr.calibrate(replace(walk, truth=Truth(segments=segments)), smooth=True)
    assert found.k["walking"][0] == pytest.approx(right.k["walking"][0], rel=0.01)
    assert any("distrusted" in note and "28.80 m given" in note for note in found.notes)


def test_the_only_length_is_rejected_if_it_contradicts_the_prior() -> None:
    walk = replace(rectangle(), truth=Truth())
    found = pdr.calibrate(walk.of_distance(110.0), smooth=True)
    assert any("distrusted" in note and "110.00 m given" in note for note in found.notes)
    assert not any("distrusted" in n for n in pdr.calibrate(walk.of_distance(60.0), smooth=True).notes)


def test_loop_closures_and_locations_do_not_replace_known_lengths() -> None:
    walk = replace(rectangle(), truth=Truth()).of_distance(60.0)
    alone = pdr.calibrate(walk, smooth=True).k["walking"][0]
    closed = pdr.calibrate(walk, smooth=True, loop_closures=[[LoopClosure(1.0, walk.duration_s - 1.0)]])
    time_s = np.arange(2.0, walk.duration_s, 5.0)
    coarse = Samples(time_s, np.tile([48.0, 11.0, 500.0, 50.0], (len(time_s), 1)))
    located = pdr.calibrate(replace(walk, location=coarse), smooth=True)
    for one in (closed, located):
        assert one.k["walking"][0] == pytest.approx(alone, rel=0.02)
    (track,) = located.tracks
    assert track.frame == "fixes" and track.origin is not None and abs(track.origin.latitude_deg - 48.0) < 1e-3


def test_the_notes_of_a_calibration_name_rejected_fixes_and_ranges_to_one_anchor() -> None:
    walk = replace(rectangle(), truth=Truth())
    wild = pdr.PositionFix(20.0, np.array([500.0, 0.0]), np.eye(2))
    (note,) = pdr.calibrate(walk, smooth=True, fixes=[[*TWO_FIXES, wild]]).notes
    assert note == "simulated_walk: fix 2: not used, because the walk contradicts it"
    steady = [pdr.RangeFix(t, (0.0, 0.0), 5.0, 8.0) for t in (10.0, 20.0)]
    notes = pdr.calibrate(walk, smooth=True, fixes=[steady]).notes
    assert any("ranges to one anchor fit the walk in any direction" in note for note in notes)


def straight_and_turn() -> tuple[Recording, Callable[..., pdr.PositionFix]]:
    """A walk of 22 m without truth, and a function that returns a fix at a time, with the true place times a factor."""
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=d, turn_rad=1.6) for d in (12.0, 10.0)])

    def fix(t: float, factor: float = 1.0, var_m2: float = 0.1) -> pdr.PositionFix:
        return pdr.PositionFix(t, factor * true_m(walk, t), var_m2 * np.eye(2))

    return replace(walk, truth=Truth()), fix


def test_fixes_of_a_wrong_scale_are_named_and_impossible_steps_do_not_change_the_parameters() -> None:
    blind, fix = straight_and_turn()
    half, three = ([fix(t, factor) for t in np.arange(1.0, 16.0, 2.0)] for factor in (0.5, 3.0))
    found = pdr.calibrate([blind, blind], smooth=True, fixes=[half, three])
    unusual, impossible = (note for note in found.notes if note.startswith("WARNING: "))
    assert "shorter than usual" in unusual
    assert "not used: simulated_walk: its steps would be" in impossible
    assert [t.distance_m for t in found.tracks] == pytest.approx([11.0, 15.0], rel=0.3)  # 66 m by the fixes


def test_a_fix_that_fits_its_own_walk_is_tested_with_the_step_lengths_of_all_walks() -> None:
    blind, fix = straight_and_turn()
    right = [fix(t, var_m2=0.01) for t in (1.0, 5.0, 9.0, 13.0)]
    too_far = [fix(0.5, var_m2=0.01), fix(4.0, var_m2=0.01), fix(8.5, 1.18, 0.01)]
    (alone,) = pdr.calibrate(blind, smooth=True, fixes=[too_far]).tracks
    assert all(result.accepted for result in alone.fixes)
    found = pdr.calibrate([blind] * 3, smooth=True, fixes=[right, right, too_far])
    assert [result.outcome for result in found.tracks[2].fixes] == ["used", "used", "rejected"]
    assert found.tracks[2].distance_m == pytest.approx(22.0, rel=0.04)


def test_recordings_of_one_name_are_different_people_and_the_progress_reaches_the_estimate() -> None:
    walk, shares = replace(rectangle(), truth=Truth(), meta={}), list[float]()
    found = pdr.calibrate([walk, walk], smooth=True, fixes=[TWO_FIXES] * 2, each_a_person=True, progress=shares.append)
    assert found.subject_ids == (walk.name, f"{walk.name} (2)")
    assert shares == sorted(shares)
    assert sum(0.5 < share < 1.0 for share in shares) > 1


def test_contexts_of_one_walk_have_a_joint_covariance() -> None:
    walk = average_walk()
    found = pdr.calibrate(replace(walk, truth=Truth(waypoints=walk.truth.waypoints)), smooth=True)
    part = slices_of(found.models)[0]
    walking, running = part["walking"].start, part["running"].start
    cov = found.people_cov[0][np.ix_([walking, running], [walking, running])]
    assert abs(cov[0, 1]) > 0.02 * np.sqrt(cov[0, 0] * cov[1, 1])
    assert set(found.segments.context) >= {"walking", "running"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fixes": [[]]}, "for smooth=True"),
        ({"smooth": True, "fixes": [[], []]}, "fixes of 2 recordings for 1"),
        ({"smooth": True, "fixes": [pdr.Standstill(1.0, 2.0)]}, "fixes must have one list for each recording"),
        ({"smooth": True}, "nothing to calibrate with"),
        ({"smooth": True, "fixes": [TWO_FIXES[:1]]}, "nothing to calibrate with"),
        ({"smooth": True, "fixes": [AT_ONCE]}, "no two positions .* that are 4 m apart with steps between"),
        ({"smooth": True, "loop_closures": [[LoopClosure(1.0, 37.0)]]}, "loop closures alone have no scale"),
        ({"smooth": True, "fixes": [CONTRADICTED]}, "contradicts 7 of its 8 observations: their clock, units or axes"),
        ({"smooth": True, "loss": "l1"}, "loss must be one of"),
        ({"smooth": True, "fixes": [TWO_FIXES], "priors": "inf"}, "finite std"),
    ],
)
def test_arguments_that_contradict_each_other_are_refused(arguments: dict[str, object], message: str) -> None:
    if "priors" in arguments:
        own = DEFAULT_PRIORS["walking"]
        arguments = {**arguments, "priors": {"walking": replace(own, between_std=np.array([np.inf]))}}
    with pytest.raises(ValueError, match=message):
        pdr.calibrate(replace(rectangle(), truth=Truth()), **arguments)


@pytest.mark.parametrize("weighting", ["imm", "wc", "hc", "stated heading"])
def test_displacements_depend_on_the_parameters_as_in_the_smoother(weighting: str) -> None:
    walk, config = pdr.simulate.demo_walk(), pdr.recipes.default()
    config = config.with_weighting(weighting) if " " not in weighting else config.with_heading(HeadingRule())
    track, (priors,) = pdr.track(walk, config=config), forms_of(model="eq12").values()
    slices, n = slices_of({name: p.model for name, p in priors.items()})
    names, rng = mode_names(config.model, {}), np.random.default_rng(3)
    thetas = [{name: p.mean + 0.05 * rng.normal(size=len(p.mean)) * p.std for name, p in priors.items()} for _ in "ab"]
    models = [with_parameters(config, priors, theta, names, None, 0.025).model for theta in thetas]
    is_weighted = weighting in ("wc", "hc")
    moved_m = [
        increments(track.steps, track.mode_prob, model, track.gap_before_s, is_weighted=is_weighted)[0].displacement_m
        for model in models
    ]
    by_theta = displacement_by_theta(track, models[0], names, slices, n, is_weighted=is_weighted)
    change = np.concatenate(list(thetas[1].values())) - np.concatenate(list(thetas[0].values()))
    np.testing.assert_allclose(by_theta @ change, moved_m[1] - moved_m[0], atol=1e-3)
