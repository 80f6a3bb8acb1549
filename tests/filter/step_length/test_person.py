"""Step length of a person: learnt from fixes, pooled over walks, and used in the next recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import cut_randomly, pushed, true_position_m
from typer.testing import CliRunner

import pdr_filter as pdr
from models.training.simulated_people import random_person
from pdr_filter import recipes
from pdr_filter.apps.cli.app import app
from pdr_filter.filter.fixes.gnss import RADIUS_68, origin_of
from pdr_filter.filter.imm.motion_model import LOG_SCALE
from pdr_filter.filter.pedestrian.pedestrian_state import initial_state
from pdr_filter.filter.pedestrian.person import LengthFixes, Session, session_of, session_of_scale
from pdr_filter.filter.step_length.models import RECORDING_STD, TYPICAL_STEP, length_and_jacobian, scale_std
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values.recording import Recording, Subject

pytestmark = pytest.mark.usefixtures("sensing_once")

HERE = pdr.Origin(48.137, 11.575)


def walk_of(number: int, seed: int, minutes: float, leg_m: float = 50.0) -> Recording:
    """Return a walk of a person of unknown height."""
    gait, carrying = random_person("texting", number)
    n = int(minutes * 75 / leg_m)
    turns = np.random.default_rng(seed).uniform(-1.5, 1.5, size=n)
    legs = [Leg("walking", distance_m=leg_m, turn_rad=turn) for turn in turns]
    walk = simulate(legs, gait, carrying={"texting": carrying}, seed=seed, name=f"walk_{seed}")
    return replace(walk, meta={**walk.meta, "subject": {}})


def located(walk: Recording, shrinkage_m: float = 0.0) -> Recording:
    """Return the recording with one location a second, each moved towards their mean by `shrinkage_m`."""
    times = np.arange(1.0, walk.duration_s)
    position_m = true_position_m(walk, times)
    away_m = position_m - position_m.mean(axis=0)
    position_m -= away_m * np.minimum(0.5, shrinkage_m / np.maximum(np.hypot(*away_m.T), 1e-6))[:, None]
    degrees = HERE.latitude_longitude_deg(position_m)
    accuracy = np.full((len(times), 2), [520.0, 3.0 * RADIUS_68])
    return replace(walk, location=pdr.Samples(times, np.column_stack([*degrees, accuracy])))


def length_error(track: pdr.Track, walk: Recording) -> float:
    position_m = true_position_m(walk, np.arange(0.0, walk.duration_s, 0.5))
    return track.distance_m / np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum() - 1.0


@pytest.fixture(scope="module")
def first() -> Recording:
    return located(walk_of(NUMBER, 1, 5.0))


@pytest.fixture(scope="module")
def learnt(first: Recording) -> pdr.Person:
    person = pdr.track(first).person
    assert person is not None
    return person


@pytest.fixture(scope="module")
def learnt_by_smoothing(first: Recording) -> pdr.Person:
    person = pdr.smooth(first).track.person
    assert person is not None
    return person


# Person whose steps are a tenth longer than those of the default for an unknown height.
NUMBER = 8


def test_locations_of_a_person_of_unknown_height_improve_the_next_recording(learnt: pdr.Person) -> None:
    second = walk_of(NUMBER, 2, 2.0)
    alone, known = (length_error(pdr.track(second, person=person), second) for person in (None, learnt))
    assert abs(alone) > 0.08
    assert abs(known) < 0.04
    assert learnt.std < 0.07


def test_without_fixes_the_person_is_unchanged(first: Recording, learnt: pdr.Person) -> None:
    assert pdr.track(first, gnss="off").person is None
    assert pdr.track(first, gnss="off", person=learnt).person == learnt


def test_prior_knowledge_of_a_person_is_not_learnt_again(first: Recording, learnt: pdr.Person) -> None:
    """Tracking a walk with the person learnt from it gives an equal session with the same precision."""
    again = pdr.track(first, person=learnt).person
    assert again is not None and len(again.sessions) == 2
    one, two = again.sessions
    assert one == learnt.sessions[0]
    assert two.step_length_m == pytest.approx(one.step_length_m, rel=0.02)
    assert two.std > 0.7 * one.std


@pytest.mark.parametrize("measurement_std", [0.01, 0.05, 0.09])
def test_a_session_is_the_measurement_without_the_prior(measurement_std: float) -> None:
    model, measured = recipes.default().model, 0.11
    prior_var = model.noise.log_scale_std**2
    gain = prior_var / (prior_var + measurement_std**2)
    estimates = initial_state(model, np.ones(1)).estimates
    mean, cov = estimates.mean.copy(), estimates.cov.copy()
    mean[:, LOG_SCALE], cov[:, LOG_SCALE, LOG_SCALE] = gain * measured, (1 - gain) * prior_var
    session = session_of(model, replace(estimates, mean=mean, cov=cov), LengthFixes(7))
    fit = next(m for m in model.modes if m.context == "walking").step_length
    usual_m = float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])
    assert session is not None
    assert (session.std, session.n_fixes) == (pytest.approx(measurement_std), 7)
    assert session.step_length_m == pytest.approx(usual_m * np.exp(measured))
    assert session_of(model, estimates, LengthFixes(7)) is None


@pytest.mark.parametrize("prior_std", [0.03, 0.1])
def test_a_walk_that_is_less_certain_than_the_spread_of_people_is_not_learnt(prior_std: float) -> None:
    """The limit is that of the walk alone: a known person, which has a smaller prior, does not change it."""
    model = recipes.default().model

    def learnt(std: float) -> Session | None:
        var = 1 / (prior_std**-2 + std**-2)
        return session_of_scale(model, (0.02, var), prior_std**2, LengthFixes(7))

    assert learnt(0.099) is not None
    assert learnt(0.101) is None
    barely_less = float(np.nextafter(prior_std**2, 0.0))
    assert session_of_scale(model, (0.0, barely_less), prior_std**2, LengthFixes(7)) is None


def spread_fixes(extent_m: float, std_m: float, correlation_s: float) -> LengthFixes:
    """Return the sums of fixes at the four corners of a square."""
    corners = extent_m * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]) + [900.0, -400.0]
    fixes = LengthFixes()
    for time_s, position_m in enumerate(corners):
        fixes = fixes.plus(
            pdr.PositionFix(float(time_s), position_m, std_m**2 * np.eye(2), correlation_s=correlation_s)
        )
    return fixes


def test_locations_that_a_phone_has_smoothed_determine_the_size_of_large_walks_alone() -> None:
    away_m = np.hypot(200.0, 200.0)
    assert spread_fixes(200.0, 4.0, 20.0).size_std == pytest.approx(1.5 * 4.0 / away_m)
    assert spread_fixes(5.0, 4.0, 20.0).size_std == pytest.approx(0.5)
    assert spread_fixes(0.0, 4.0, 20.0).size_std == pytest.approx(0.5)
    assert spread_fixes(5.0, 4.0, 0.0).size_std == 0.0
    assert spread_fixes(5.0, 4.0, 0.0).n == 4


def test_locations_of_a_walk_around_a_building_teach_no_step_length() -> None:
    walk = located(walk_of(NUMBER, 3, 3.0, leg_m=10.0), shrinkage_m=4.0)
    assert pdr.track(walk).person is None
    assert pdr.smooth(walk).track.person is None


def test_locations_closer_together_than_the_walk_bias_the_step_length_within_its_uncertainty(
    first: Recording, learnt: pdr.Person, learnt_by_smoothing: pdr.Person
) -> None:
    shrunk = located(first, shrinkage_m=5.0)
    for unbiased, track in ((learnt, pdr.track(shrunk)), (learnt_by_smoothing, pdr.smooth(shrunk).track)):
        person = track.person
        assert np.log(unbiased.step_length_m / person.step_length_m) < person.std


def test_smoothing_learns_the_same_from_a_walk_with_and_without_earlier_walks(
    first: Recording, learnt_by_smoothing: pdr.Person
) -> None:
    alone = learnt_by_smoothing
    earlier = pdr.Person((Session(1.1 * alone.step_length_m, 0.02, 30),))
    both = pdr.smooth(first, person=earlier).track.person
    assert both is not None and len(both.sessions) == 2
    assert both.sessions[1].step_length_m == pytest.approx(alone.step_length_m, rel=0.007)
    # without the earlier walks, the locations are larger than the walk, so that less of it is taken for shrinkage
    assert both.sessions[1].std == pytest.approx(alone.sessions[0].std, rel=0.1)


def test_walks_are_pooled_by_precision_and_each_counts_once() -> None:
    a, b = Session(0.70, 0.02, 40), Session(0.76, 0.05, 10)
    pooled = pdr.Person((a,)).pooled(pdr.Person((b,)))
    weights = [1 / (s.std**2 + RECORDING_STD**2) for s in (a, b)]
    assert np.log(pooled.step_length_m) == pytest.approx(np.average(np.log([0.70, 0.76]), weights=weights))
    assert pooled.std == pytest.approx(sum(weights) ** -0.5)
    assert pooled.n_fixes == 50
    assert pooled.pooled(pdr.Person((a,))) == pooled
    assert np.isnan(pdr.Person().step_length_m) and np.isinf(pdr.Person().std)


def test_the_population_prior_counts_once_and_a_walk_by_its_precision() -> None:
    """The step length is the product of two normal densities of the log length of a typical step."""
    config = recipes.default()
    fit = next(m for m in config.model.modes if m.context == "walking").step_length
    usual_m = float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])
    for std in (0.01, 0.10, 1.0):
        known = config.with_person(pdr.Person((Session(1.2 * usual_m, std, 5),))).model
        now = next(m for m in known.modes if m.context == "walking").step_length
        precisions = np.array([scale_std(None) ** -2, 1 / (std**2 + RECORDING_STD**2)])
        expected = np.exp(precisions[1] * np.log(1.2) / precisions.sum())
        assert float(now.theta[0] / fit.theta[0]) == pytest.approx(expected)
        assert known.noise.log_scale_std == pytest.approx(np.sqrt(1 / precisions.sum() + RECORDING_STD**2))


def test_the_step_length_is_that_of_the_person_for_any_body_height() -> None:
    person = pdr.Person((Session(0.75, 1e-3, 1000),))
    lengths = []
    for height_m in (None, 1.5, 1.95):
        known = recipes.default(Subject(height_m=height_m)).with_person(person).model
        fit = next(m for m in known.modes if m.context == "walking").step_length
        lengths.append(float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0]))
    np.testing.assert_allclose(lengths, 0.75, rtol=0.03)


def test_a_configuration_with_a_person_notes_the_step_length(learnt: pdr.Person) -> None:
    config = recipes.default()
    assert any("height is not known" in note.text for note in config.notes)
    notes = [note.text for note in config.with_person(learnt).notes]
    assert not any("height is not known" in note for note in notes)
    assert any(f"{learnt.step_length_m:.2f} m, of 1 walk" in note for note in notes)
    assert config.with_person(pdr.Person()).notes == config.notes
    with pytest.raises(ValueError, match="combine both"):
        config.with_person(learnt).with_person(learnt)


def test_online_and_offline_tracking_learn_the_same_person(first: Recording, learnt: pdr.Person) -> None:
    here = origin_of(first.location)
    assert here is not None
    own = recipes.default(first.subject)
    own = own.with_magnetic_north(here.declination_rad(), field_ut=here.magnetic_field_ut())
    online = pdr.OnlineFilter(own)
    assert online.person is None
    online.push_location(first.location.time_s, *first.location.values.T[[0, 1, 3]])
    online, _ = pushed(online, cut_randomly(pdr.merge_streams(first), 3, mean_length=700), n_resumed=1)
    assert online.person == learnt


def test_a_saved_person_is_equal_after_loading(learnt: pdr.Person, tmp_path: Path) -> None:
    assert pdr.Person.load(learnt.save(tmp_path / "me.json")) == learnt
    assert pdr.Person.load(pdr.Person().save(tmp_path / "nobody.json")) == pdr.Person()


def test_the_command_line_reads_an_existing_person_file_and_replaces_it(
    first: Recording, learnt: pdr.Person, tmp_path: Path
) -> None:
    file, me = first.save(tmp_path / "walk.zip"), tmp_path / "me.json"
    runner = CliRunner()
    assert runner.invoke(app, ["track", str(file), "--person", str(me)]).exit_code == 0
    assert len(pdr.Person.load(me).sessions) == 1
    assert runner.invoke(app, ["track", str(file), "--person", str(me)]).exit_code == 0
    assert len(pdr.Person.load(me).sessions) == 2


@pytest.fixture(scope="module")
def calibrated(first: Recording) -> Calibration:
    return pdr.calibrate([replace(first, location=None)], subject="me")


def test_a_calibration_used_as_person_gives_the_same_track(first: Recording, calibrated: Calibration) -> None:
    by_name, as_person = (pdr.track(first, gnss="off", **{name: calibrated}) for name in ("calibration", "person"))
    np.testing.assert_array_equal(by_name.position_m, as_person.position_m)


def test_the_uncertainty_of_a_calibrated_person_is_one_factor_of_all_steps(calibrated: Calibration) -> None:
    model = calibrated.config(recipes.default()).model
    walking = next(m for m in model.modes if m.context == "walking")
    assert model.noise.log_scale_std == calibrated.scale_std()
    assert walking.step_length is not None and not walking.step_length.theta_cov.any()


def test_the_command_line_does_not_change_a_calibration_file(
    first: Recording, calibrated: Calibration, tmp_path: Path
) -> None:
    file, me = first.save(tmp_path / "walk.zip"), calibrated.save(tmp_path / "me.json")
    before = me.read_bytes()
    for option in ("--person", "--calibration"):
        assert CliRunner().invoke(app, ["track", str(file), "--online", option, str(me)]).exit_code == 0
    assert me.read_bytes() == before


@pytest.mark.parametrize("given", [{}, 5, "missing.json"])
def test_an_object_that_is_not_a_person_is_refused(first: Recording, given: Any) -> None:
    with pytest.raises(
        ValueError, match=r"person must be a Person, a Calibration, or|missing\.json: not a person file"
    ):
        pdr.track(first, person=given)
