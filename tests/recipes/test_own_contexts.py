"""Contexts, modes, step lengths and weightings of users: from the public names to every output."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import streamed

import pdr_filter as pdr
from pdr_filter.apps.report.html import html_report
from pdr_filter.filter.step_length.models import bounce_fit
from pdr_filter.recipes.modes import context_modes
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate import BAROMETER, Gait, Leg, SensorErrors, simulate
from pdr_filter.values import DEFAULT_CONTEXTS, FloatArray, Step

pytestmark = pytest.mark.usefixtures("sensing_once")

CLASSES = ("level", "resting", "treadmill")
MODES = [
    pdr.Mode("resting", moves=False),
    pdr.Mode("level", step_length=bounce_fit(1.75)),
    # a length that must not matter
    pdr.Mode("treadmill", step_length=pdr.known_length(0.9, 0.05), moves=False, gait="running"),
]
NEW_NAMES = {
    "stationary": "resting",
    "walking": "level",
    "upstairs": "climbing",
    "downstairs": "descending",
    "sideways": "crab",
    "running": "jogging",
}


def gym_visit(seed: int) -> pdr.Recording:
    """A walk to a treadmill, half a minute of running on it (which the simulation does elsewhere), and a walk back."""
    legs = [
        Leg("stationary", duration_s=8.0),
        Leg("walking", distance_m=40.0),
        Leg("running", duration_s=30.0),
        Leg("walking", distance_m=40.0, turn_rad=np.pi / 2),
        Leg("stationary", duration_s=8.0),
    ]
    return simulate(legs, Gait(height_m=1.75), "pocket", seed=seed, name="gym")


@pytest.fixture(scope="module")
def visit() -> pdr.Recording:
    return gym_visit(3)


@pytest.fixture(scope="module")
def model() -> pdr.ContextModel:
    """A context model with names of its own, trained on other simulated visits."""
    rows: list[FloatArray] = []
    names: list[str] = []
    words = {"stationary": "resting", "walking": "level", "running": "treadmill"}
    for seed in (1, 2):
        recording = gym_visit(seed)
        labels: Any = recording.truth.labels
        for window in feature_windows(FeatureWindows(features=ATTITUDE_FREE), [merge_streams(recording)]):
            inside = (labels.start_s <= window.start_s) & (window.time_s <= labels.end_s)
            if inside.any():
                rows.append(window.features)
                names.append(words[str(labels.context[inside][0])])
    features, y = np.array(rows), np.array(names)
    mean, scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-3)
    classifier = pdr.RelevanceVectorClassifier().fit(np.clip((features - mean) / scale, -5, 5), y)
    assert tuple(classifier.classes_) == CLASSES
    prior = np.array([(y == name).mean() for name in CLASSES])
    return pdr.ContextModel(
        "gym",
        ATTITUDE_FREE.names,
        CLASSES,
        prior,
        mean,
        scale,
        classifier.machine_,
        {},
        feature_limit=5.0,
        labels=CLASSES,
    )


@pytest.fixture(scope="module")
def config(model: pdr.ContextModel) -> pdr.Config:
    return pdr.recipes.default().with_contexts(model, MODES)


@pytest.fixture(scope="module")
def track(visit: pdr.Recording, config: pdr.Config) -> pdr.Track:
    return pdr.track(visit, config=config)


# --- a treadmill ----------------------------------------------------------------------------------------------------


def test_steps_on_a_treadmill_count_and_lead_nowhere(visit: pdr.Recording, track: pdr.Track) -> None:
    labels: Any = visit.truth.labels
    start_s, end_s = float(labels.start_s[2]), float(labels.end_s[2])
    running = (track.time_s > start_s + 4.0) & (track.time_s < end_s - 4.0)
    assert running.sum() > 40
    assert track.step_length_m[running].max() < 0.05
    assert track.distance_m == pytest.approx(80.0, rel=0.1)
    assert pdr.track(visit).distance_m > 120.0


def test_a_track_shows_the_contexts_of_its_model(track: pdr.Track) -> None:
    assert track.contexts == track.windows.contexts == CLASSES
    assert track.modes == ("resting", "level", "treadmill")
    assert track.context_prob.shape == (track.n_steps, 3)
    seconds = track.context_seconds()
    assert set(seconds) == set(CLASSES)
    assert seconds["treadmill"] == pytest.approx(30.0, abs=4.0)
    assert "treadmill 3" in track.report() or "treadmill 2" in track.report()
    assert set(json.loads(json.dumps(track.summary()))["contexts"]) == set(CLASSES)


def test_the_report_page_and_tables_name_own_contexts(track: pdr.Track, visit: pdr.Recording, tmp_path: Path) -> None:
    assert "treadmill" in html_report(track, visit)
    track.to_csv(tmp_path / "track.csv")
    assert "treadmill" in (tmp_path / "track.csv").read_text(encoding="utf-8").splitlines()[0]


def test_an_online_filter_gives_the_same_track_and_names_own_contexts(
    visit: pdr.Recording, config: pdr.Config, track: pdr.Track
) -> None:
    online, updates = streamed(visit, config, n_resumed=2)
    assert set(json.loads(json.dumps(online.now().to_dict()))["context_prob"]) == set(CLASSES)
    assert set(json.loads(json.dumps(updates[-1].to_dict()))["context_prob"]) == set(CLASSES)
    found = np.array([u.position_m for u in updates if u.is_final])
    np.testing.assert_array_equal(found, track.position_m)


def test_a_smoothed_walk_stands_still_on_the_treadmill(visit: pdr.Recording, config: pdr.Config) -> None:
    smoothed = pdr.smooth(visit, config=config).track
    assert smoothed.contexts == CLASSES
    assert smoothed.distance_m == pytest.approx(80.0, rel=0.1)


def test_a_model_with_own_contexts_comes_back_from_its_files(model: pdr.ContextModel, tmp_path: Path) -> None:
    prob = np.array([[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.02, 0.03, 0.95]])
    replace(model, transition_prob=prob).save(tmp_path)
    again = pdr.ContextModel.load(tmp_path)
    assert again.contexts == CLASSES
    np.testing.assert_array_equal(again.transition_prob, prob)
    row = model.feature_mean + 0.1 * model.feature_scale
    np.testing.assert_array_equal(again.predict(row), model.predict(row))


def test_windows_without_gyroscope_are_unknown_to_a_model_that_needs_one(
    visit: pdr.Recording, config: pdr.Config
) -> None:
    windows = pdr.classify(replace(visit, gyroscope=None), config)
    assert (windows.unknown_share == 1.0).all()


# --- the default under other names ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def renamed_config() -> pdr.Config:
    default = pdr.recipes.default()
    models = tuple(pdr.ContextModel.load(name).renamed(NEW_NAMES) for name in ("context", "context_accelerometer"))
    modes = [replace(mode, name=NEW_NAMES[mode.name], context=NEW_NAMES[mode.context]) for mode in default.model.modes]
    return default.with_contexts((models[0], models[1]), modes)


@pytest.mark.parametrize("weighting", ["imm", "wc", "hc"])
def test_the_default_with_other_names_of_its_contexts_gives_the_same_bits(
    weighting: str, renamed_config: pdr.Config
) -> None:
    # all six contexts, and a barometer for stairs
    legs = [
        Leg("stationary", duration_s=4.0),
        Leg("walking", distance_m=20.0),
        Leg("upstairs", distance_m=5.0),
        Leg("sideways", distance_m=4.0),
        Leg("running", distance_m=20.0, turn_rad=1.0),
        Leg("downstairs", distance_m=5.0),
        Leg("walking", distance_m=10.0, carrying_mode="texting"),
    ]
    walk = simulate(legs, Gait(height_m=1.75), "pocket", seed=2, errors=SensorErrors(barometer=BAROMETER))
    expected = pdr.track(walk, config=pdr.recipes.default(), weighting=weighting)
    found = pdr.track(walk, config=renamed_config, weighting=weighting)
    assert found.contexts == tuple(NEW_NAMES.values())
    for name in ("position_m", "position_cov_m2", "step_length_m", "mode_prob", "context_prob", "height_m", "floor"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    np.testing.assert_array_equal(found.windows.context_prob, expected.windows.context_prob)
    assert found.notes == expected.notes
    assert list(found.context_seconds().values()) == list(expected.context_seconds().values())


def test_the_default_modes_state_what_the_default_contexts_mean() -> None:
    assert tuple(mode.meaning for mode in context_modes(bounce_fit())) == DEFAULT_CONTEXTS.contexts


# --- modes, step lengths, transitions -------------------------------------------------------------------------------


class HalfAMetre:
    """A step-length model from outside: theta = (k,), L = k."""

    n_params = 1

    def regressors(self, step: Step) -> FloatArray:
        return np.ones(1)


def test_an_own_step_length_is_used_in_its_mode_and_in_smoothing(visit: pdr.Recording, track: pdr.Track) -> None:
    fit = pdr.StepLengthFit(HalfAMetre(), np.array([0.5]), np.array([[1e-6]]), 0.03)
    walk = simulate([Leg("walking", distance_m=30.0)], Gait(height_m=1.75), "texting", seed=5)
    config = pdr.recipes.default().with_step_length("walking", fit)
    for found in (pdr.track(walk, config=config), pdr.smooth(walk, config=config).track):
        assert np.median(found.step_length_m) == pytest.approx(0.5, abs=0.02)
    assert "height" not in [note.about for note in config.notes]
    with pytest.raises(ValueError, match="no mode or context is named 'flying': give one of stationary, walking"):
        pdr.recipes.default().with_step_length("flying", fit)


def test_a_calibration_fits_an_own_step_length_in_a_context_with_an_own_name(renamed_config: pdr.Config) -> None:
    corridor = [Leg("walking", distance_m=30.0), Leg("stationary", duration_s=3.0)]
    walk = simulate(4 * corridor, Gait(height_m=1.75), "texting", seed=4)
    prior = pdr.StepLengthFit(HalfAMetre(), np.array([0.5]), np.array([[0.2**2]]), 0.06)
    config = renamed_config.with_step_length("level", prior)
    uncalibrated_m = pdr.track(walk, config=config).distance_m
    assert uncalibrated_m < 100.0
    calibration = pdr.calibrate(walk, config=config)
    assert calibration.contexts == ("level",)
    assert pdr.track(walk, config=config, calibration=calibration).distance_m == pytest.approx(120.0, rel=0.03)
    # a default context with a step length from outside is calibrated with it, too
    own = pdr.calibrate(walk, config=pdr.recipes.default().with_step_length("walking", prior))
    assert isinstance(own.models["walking"], HalfAMetre)
    np.testing.assert_allclose(own.k["walking"], calibration.k["level"], rtol=0.02)


@pytest.mark.parametrize("model_name", [None, "kim"])
def test_a_person_is_calibrated_by_a_named_model_in_the_context_of_walking_whatever_its_name(
    renamed_config: pdr.Config, model_name: str | None, tmp_path: Path
) -> None:
    walk = simulate(
        [Leg("walking", distance_m=25.0), Leg("stationary", duration_s=3.0)] * 4, Gait(height_m=1.8), seed=4
    )
    renamed = pdr.calibrate(walk, config=renamed_config, model=model_name)
    assert renamed.main_context == "level"
    person = renamed.subjects["simulated"]
    assert person.k0 == person.k["level"][0]
    if model_name is not None:
        usual = pdr.calibrate(walk, config=pdr.recipes.default(walk.subject), model=model_name)
        assert person.k0 == pytest.approx(usual.subjects["simulated"].k0, rel=1e-4)
    assert "level" in renamed.report()
    again = pdr.track(walk, config=renamed_config, calibration=renamed.save(tmp_path / "anna"))
    assert again.distance_m == pytest.approx(100.0, rel=0.03)


def test_transitions_come_from_the_model_else_from_what_the_modes_mean(model: pdr.ContextModel) -> None:
    default = pdr.recipes.default()
    known = np.array([[0.9, 0.05, 0.05], [0.1, 0.8, 0.1], [0.02, 0.03, 0.95]])  # level, resting, treadmill
    estimated = default.with_contexts(replace(model, transition_prob=known), MODES).model.transition_prob
    np.testing.assert_array_equal(estimated, known[np.ix_([1, 0, 2], [1, 0, 2])])  # in the order of the modes
    documented = default.with_contexts(model, MODES).model.transition_prob
    np.testing.assert_allclose(documented[0], [0.8, 0.18, 0.02])
    np.testing.assert_allclose(documented[1], [1 / 110, 54 / 55, 1 / 110])
    given = default.with_contexts(model, MODES, np.full((3, 3), 1 / 3)).model.transition_prob
    np.testing.assert_array_equal(given, np.full((3, 3), 1 / 3))


def test_other_modes_of_the_same_contexts_keep_the_transitions(model: pdr.ContextModel) -> None:
    config = pdr.recipes.default().with_contexts(model, MODES, np.full((3, 3), 1 / 3))
    assert config.with_modes(MODES).model.transition_prob[0, 0] == 1 / 3
    two = config.with_modes([pdr.Mode("slow", "level"), pdr.Mode("fast", "level")])
    np.testing.assert_allclose(two.model.transition_prob[0], [54 / 55, 1 / 55])
    assert two.sensing.context_set == two.model.context_set


def test_a_mode_changes_what_its_context_means_for_the_stages_before_the_filter() -> None:
    default = pdr.recipes.default()
    modes = [replace(m, climbs=1) if m.name == "sideways" else m for m in default.model.modes]
    config = default.with_modes(modes)
    assert config.sensing.context_set.contexts[4].climbs == 1
    assert config.sensing.contexts is not None
    assert getattr(config.sensing.contexts, "context_set") == config.sensing.context_set  # noqa: B009


def test_contexts_without_modes_keep_those_of_the_recipe_and_others_walk() -> None:
    default = pdr.recipes.default()
    model = pdr.ContextModel.load("context").renamed({"upstairs": "ramp"})
    config = default.with_contexts(model)
    kept = {mode.name: mode for mode in default.model.modes}
    assert [mode.name for mode in config.model.modes] == list(config.contexts)
    assert all(mode is kept[mode.name] for mode in config.model.modes if mode.name != "ramp")
    ramp = config.model.modes[config.contexts.index("ramp")]
    assert (ramp.moves, ramp.climbs, ramp.gait) == (True, 0, "walking")


def test_modes_of_one_length_are_named_and_modes_of_two_lengths_are_not(model: pdr.ContextModel) -> None:
    resting, level, treadmill = MODES
    same = replace(treadmill, moves=True, gait=None, step_length=level.step_length)
    with pytest.warns(UserWarning, match="the 2 modes that move have the same step length"):
        pdr.recipes.default().with_contexts(model, [resting, level, same])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pdr.recipes.default().with_contexts(model, MODES)


def test_a_mode_of_an_unknown_context_is_refused(model: pdr.ContextModel) -> None:
    with pytest.raises(ValueError, match=r"context of mode 'flying' must be one of .*'treadmill'.*got 'flying'"):
        pdr.recipes.default().with_contexts(model, [*MODES, pdr.Mode("flying")])
    with pytest.raises(ValueError, match="need exactly one mode for each"):
        pdr.recipes.default().with_weighting("hc").with_contexts(model, MODES[:2])


def test_modes_of_a_configuration_that_knows_a_person_are_refused() -> None:
    from pdr_filter.filter.pedestrian.person import Session

    known = pdr.recipes.default().with_person(pdr.Person((Session(0.7, 0.02, 30),)))
    with pytest.raises(ValueError, match="set modes and step lengths first"):
        known.with_modes(known.model.modes)


# --- weightings -----------------------------------------------------------------------------------------------------


def highest(context_prob: FloatArray) -> FloatArray:
    return np.eye(len(context_prob))[int(context_prob.argmax())]


def test_a_function_that_takes_the_highest_context_is_hc(visit: pdr.Recording) -> None:
    expected = pdr.track(visit, weighting="hc")
    found = pdr.track(visit, config=pdr.recipes.default(visit.subject).with_weighting(highest))
    assert found.weighting == "highest"
    np.testing.assert_array_equal(found.position_m, expected.position_m)
    back = pdr.recipes.default().with_weighting(highest).with_weighting("hc")
    assert back.tracker.weighting == "hc"


def test_a_function_of_another_shape_sum_or_sign_is_refused(visit: pdr.Recording) -> None:
    for wrong in (lambda p: p[:2], lambda p: 2 * p, lambda p: p - 1.0, lambda p: p * np.nan):
        with pytest.raises(ValueError, match="must return 6 weights that are 0 or more and sum to one"):
            pdr.track(visit, config=pdr.recipes.default().with_weighting(wrong))
