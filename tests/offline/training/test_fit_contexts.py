"""Context models of any recordings: any names, any classifier, held-out people."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import cut_randomly
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.linear_model import LogisticRegression

import pdr_filter as pdr
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.model_files import ArtefactFormat
from pdr_filter.offline.training.classifier_choice import FitOfObject, fit_softmax, machine_fit_of
from pdr_filter.offline.training.context_sequences import estimate_transitions
from pdr_filter.offline.training.transition_training import contexts_at
from pdr_filter.recipes import context_transitions
from pdr_filter.sensing.features.feature_windows import N_SIGNALS
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import WINDOW_SIGNALS, Context, table

pytestmark = pytest.mark.usefixtures("sensing_once")

NAMES = {"stationary": "resting", "walking": "level", "running": "jog"}
PEOPLE = ["anna", "ben", "carla"]
MODES = [
    pdr.Mode("level"),
    pdr.Mode("resting", moves=False),
    pdr.Mode("jog", gait="running", step_length=pdr.known_length(0.9, 0.1)),
]


def with_labels(recording: pdr.Recording, names: Mapping[str, str], carrying: str | None = None) -> pdr.Recording:
    labels = recording.truth.labels
    columns: dict[str, Any] = {"start_s": labels.start_s, "end_s": labels.end_s}
    columns["context"] = np.array([names.get(c, "") for c in labels.context])
    columns["carrying_mode"] = labels.carrying_mode if carrying is None else np.full(len(labels), carrying)
    return replace(recording, truth=replace(recording.truth, labels=table(columns)))


def walk(seed: int, mode: str = "pocket") -> pdr.Recording:
    contexts = ("stationary", "walking", "running", "walking", "running", "walking")
    legs = [Leg(c, duration_s=8.0) for c in contexts]
    return simulate(legs, Gait.random(seed), mode, seed=seed, name=f"walk{seed}")


@pytest.fixture(scope="module")
def walks() -> list[pdr.Recording]:
    return [with_labels(walk(seed), NAMES) for seed in range(3)]


@pytest.fixture(scope="module")
def forest(walks: list[pdr.Recording]) -> pdr.ContextModel:
    return pdr.fit_contexts(walks, classifier="forest", people=PEOPLE)


def strictly(text: str) -> Any:
    """Return parsed JSON, without the NaN that Python would accept."""

    def refused(word: str) -> None:
        raise AssertionError(word)

    return json.loads(text, parse_constant=refused)


def few(signals: Mapping[str, np.ndarray]) -> dict[str, float]:
    return {"force_std": signals["force_mps2"].std(), "rate": signals["rate_radps"].mean()}


def test_arbitrary_names_are_kept_from_labels_through_model_and_files_to_a_track(
    walks: list[pdr.Recording], forest: pdr.ContextModel, tmp_path: Path
) -> None:
    assert forest.contexts == ("jog", "level", "resting")
    forest.save(tmp_path / "mine")
    again = pdr.ContextModel.load(tmp_path / "mine")
    stranger = walk(9)
    tracks = [pdr.track(stranger, pdr.recipes.default().with_contexts(model, MODES)) for model in (forest, again)]
    np.testing.assert_array_equal(tracks[0].position_m, tracks[1].position_m)
    assert tracks[0].contexts == ("jog", "level", "resting")
    seen = pdr.classify(stranger, pdr.recipes.default().with_contexts(again, MODES))
    true = contexts_at(with_labels(stranger, NAMES), seen.time_s - 1.0, again.contexts)
    assert np.mean(seen.context_prob.argmax(axis=1) == true) > 0.75


def test_report_and_card_have_counts_people_log_loss_and_confusion_matrix_of_the_data(
    walks: list[pdr.Recording], forest: pdr.ContextModel, tmp_path: Path
) -> None:
    n = sum(forest.card["n_windows"].values())
    report = forest.report()
    assert f"{n} windows of 3 people" in report and "log loss" in report and "resting" in report
    scores = forest.card["leave_one_subject_out"]
    assert sum(sum(row.values()) for row in scores["confusion"].values()) == scores["n_windows"] == n
    right = sum(scores["confusion"][c][c] for c in forest.contexts)
    assert right / n == pytest.approx(scores["accuracy"], abs=1e-4) and right / n > 0.7
    card = strictly(forest.save(tmp_path).with_suffix(".json").read_text("utf-8"))["card"]
    assert (card["data"], card["n_people"], card["n_recordings"]) == (["simulated"], 3, 3)


@pytest.mark.parametrize("classifier", ["rvm", "blend", LogisticRegression()])
def test_each_classifier_learns_two_contexts(walks: list[pdr.Recording], classifier: Any) -> None:
    two = [with_labels(walk(seed), {"walking": "level", "running": "jog"}) for seed in range(2)]
    model = pdr.fit_contexts(two, classifier, features=few, people=PEOPLE[:2])
    assert model.contexts == ("jog", "level")
    assert model.card["leave_one_subject_out"]["accuracy"] > 0.75


def test_logistic_regression_of_two_classes_has_the_probabilities_of_scikit_learn() -> None:
    rng = np.random.default_rng(0)
    y = np.array(["level", "jog"] * 40)
    rows = rng.normal(size=(80, 3)) + (y == "jog")[:, None]
    machine, classes = fit_softmax(rows, y, np.ones(80))
    expected = LogisticRegression(C=0.02, max_iter=300, tol=1e-3).fit(rows, y)
    assert classes == tuple(expected.classes_)
    np.testing.assert_allclose(machine.predict_proba(rows), expected.predict_proba(rows), rtol=1e-9)


class Recorded(ClassifierMixin, BaseEstimator):
    """A classifier that keeps what it was fitted on."""

    def __init__(self, kept: list[np.ndarray] | None = None) -> None:
        self.kept = kept

    def __deepcopy__(self, memo: Any) -> Recorded:
        return Recorded(self.kept)

    def __sklearn_clone__(self) -> Recorded:
        return Recorded(self.kept)

    def fit(self, X: np.ndarray, y: np.ndarray) -> Recorded:  # noqa: N803
        self.kept.append(y)
        self.classes_ = np.unique(y)
        return self

    def predict_proba(self, X: np.ndarray) -> np.ndarray:  # noqa: N803
        return np.full((len(X), len(self.classes_)), 1 / len(self.classes_))


def test_each_person_is_held_out_once_and_the_model_is_fitted_on_all(walks: list[pdr.Recording]) -> None:
    kept: list[np.ndarray] = []
    given = Recorded(kept)
    model = pdr.fit_contexts([*walks, walks[0]], given, features=few, people=["a", "b", "c", "a"])
    assert not hasattr(given, "classes_")  # a copy was fitted
    without_a, without_b, without_c, everybody = map(len, kept)
    assert everybody == sum(model.card["n_windows"].values())
    of_a, of_b, of_c = (everybody - n for n in (without_a, without_b, without_c))
    assert of_a + of_b + of_c == everybody and of_a > 1.8 * of_b > 1.5 * of_c > 0


def test_a_foreign_classifier_can_filter_but_not_be_saved_and_the_message_has_the_remedy(
    walks: list[pdr.Recording], tmp_path: Path
) -> None:
    model = pdr.fit_contexts(walks, LogisticRegression(), features=few, people=PEOPLE)
    with pytest.raises(ValueError, match=r"LogisticRegression.*cannot be saved.*joblib\.dump.*pdr\.fit_contexts"):
        model.save(tmp_path / "mine")
    assert not (tmp_path / "mine").exists()
    config = pdr.recipes.default().with_contexts(model, MODES)
    track = pdr.track(walks[0], config)
    online = pdr.OnlineFilter(config)
    updates = [
        u
        for block in cut_randomly(pdr.merge_streams(walks[0]), seed=1)
        for u in online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)
    ]
    final = [*(u for u in updates if u.is_final), *(u for u in online.finish() if u.is_final)]
    # a library may round a row in a batch otherwise than alone
    np.testing.assert_allclose([u.position_m for u in final], track.position_m, rtol=0, atol=1e-9)


def test_a_foreign_classifier_gets_the_weights_and_a_whole_recording_at_once(walks: list[pdr.Recording]) -> None:
    calls = list[int]()

    class Counting(LogisticRegression):
        def predict_proba(self, X: np.ndarray) -> np.ndarray:  # noqa: N803
            calls.append(len(X))
            return super().predict_proba(X)

    rng = np.random.default_rng(0)
    rows, y, weight = rng.normal(size=(300, 2)), np.repeat(["a", "b", "c"], 100), rng.uniform(0.1, 3.0, 300)
    machine, _ = machine_fit_of(LogisticRegression())[0](rows, y, weight)
    expected = LogisticRegression().fit(rows, y, sample_weight=weight).predict_proba(rows)
    np.testing.assert_allclose(machine.predict_proba(rows), expected, atol=1e-12)
    model = pdr.fit_contexts(walks, Counting(), features=few, people=PEOPLE)
    config = pdr.recipes.default().with_contexts(model, MODES)
    calls.clear()
    assert len(pdr.classify(walks[0], config).time_s) - 2 <= max(calls) and len(calls) <= 3


def test_a_forest_of_scikit_learn_keeps_weights_and_probabilities_and_becomes_one_that_can_be_saved() -> None:
    rng = np.random.default_rng(0)
    y = np.array(["level", "jog"] * 40)
    rows, weight = rng.normal(size=(80, 3)) + (y == "jog")[:, None], rng.uniform(0.2, 2.0, 80)
    given = ExtraTreesClassifier(10, random_state=0)
    machine, classes = FitOfObject(given)(rows, y, weight)
    expected = ExtraTreesClassifier(10, random_state=0).fit(rows, y, sample_weight=weight)
    assert classes == tuple(expected.classes_) and isinstance(machine, Forest)
    np.testing.assert_allclose(machine.predict_proba(rows), expected.predict_proba(rows), atol=1e-14)


def test_an_rvm_that_is_passed_as_an_object_can_be_saved(walks: list[pdr.Recording], tmp_path: Path) -> None:
    model = pdr.fit_contexts(walks, pdr.RelevanceVectorClassifier(), features=few, people=PEOPLE)
    model.save(tmp_path)
    features = np.array([1.0, 2.0])
    again = pdr.ContextModel.load(tmp_path, features=few)
    np.testing.assert_array_equal(again.predict(features), model.predict(features))


def test_a_feature_function_must_be_given_again_when_the_model_is_loaded(
    walks: list[pdr.Recording], tmp_path: Path
) -> None:
    model = pdr.fit_contexts(walks, "forest", features=few, people=PEOPLE)
    assert model.feature_names == ("force_std", "rate")
    model.save(tmp_path)
    with pytest.raises(ValueError, match=r"force_std.*ContextModel\.load\(path, features="):
        pdr.recipes.default().with_contexts(pdr.ContextModel.load(tmp_path), MODES)
    with pytest.raises(ValueError, match=r"features must include \['rate'\]"):
        pdr.ContextModel.load(tmp_path, features=lambda signals: {"force_std": 0.0})
    config = pdr.recipes.default().with_contexts(pdr.ContextModel.load(tmp_path, features=few), MODES)
    seen = pdr.classify(walks[0], config)
    np.testing.assert_array_equal(
        seen.context_prob, pdr.classify(walks[0], pdr.recipes.default().with_contexts(model, MODES)).context_prob
    )
    assert seen.carrying_modes[int(seen.carrying_prob[-1].argmax())] == "pocket"  # the default's, of its own features


def test_a_feature_function_receives_every_signal_by_its_name(walks: list[pdr.Recording]) -> None:
    assert len(WINDOW_SIGNALS) == N_SIGNALS
    seen: list[dict[str, np.ndarray]] = []

    def kept(signals: Mapping[str, np.ndarray]) -> dict[str, float]:
        seen.append(dict(signals))
        return few(signals)

    pdr.fit_contexts(walks[:2], "forest", features=kept, people=PEOPLE[:2])
    signals = seen[-1]
    force = np.sqrt(sum(signals[f"force_{axis}_mps2"] ** 2 for axis in "xyz"))
    np.testing.assert_allclose(signals["force_mps2"], force, rtol=1e-9)
    rate = np.sqrt(sum(signals[f"rate_{axis}_radps"] ** 2 for axis in "xyz"))
    np.testing.assert_allclose(signals["rate_radps"], rate, rtol=1e-9)
    up = sum(signals[f"force_{axis}_mps2"] * signals[f"up_{axis}"] for axis in "xyz")
    np.testing.assert_allclose(signals["vertical_mps2"], up - 9.80665, atol=0.05)


def test_transitions_are_counted_at_the_steps_of_the_recordings_and_used_by_the_filter(
    walks: list[pdr.Recording], forest: pdr.ContextModel
) -> None:
    counts = np.zeros((3, 3))
    for recording in walks:
        labels = recording.truth.labels
        assert labels is not None
        of_step = [
            next((str(r["context"]) for r in labels if r["start_s"] <= t < r["end_s"]), "")
            for t in pdr.detect_steps(recording).time_s
        ]
        for before, after in pairwise(of_step):
            if before and after:
                counts[forest.contexts.index(before), forest.contexts.index(after)] += 1
    assert forest.card["n_changes"] == counts.sum() - np.trace(counts) >= 10
    prior = context_transitions([Context(name) for name in forest.contexts])
    expected = estimate_transitions(counts, prior)
    assert forest.transition_prob is not None
    np.testing.assert_allclose(forest.transition_prob, expected)
    config = pdr.recipes.default().with_contexts(forest, MODES)
    order = [forest.contexts.index(mode.context) for mode in MODES]
    np.testing.assert_allclose(config.model.transition_prob, expected[np.ix_(order, order)])


def test_recordings_with_few_changes_give_no_transitions(walks: list[pdr.Recording]) -> None:
    model = pdr.fit_contexts(walks[:2], "forest", features=few, people=PEOPLE[:2])
    assert model.transition_prob is None and model.card["transition_prob"].startswith("default: ")


def test_exponents_estimated_from_the_labels_are_used_by_the_filter(forest: pdr.ContextModel) -> None:
    assert forest.evidence_exponent is None  # three people
    known = replace(forest, evidence_exponent=0.7, prior_exponent=0.4)
    usual = pdr.recipes.default().model
    for model, expected in ((known, (0.7, 0.4)), (forest, (usual.evidence_exponent, usual.prior_exponent))):
        found = pdr.recipes.default().with_contexts(model, MODES).model
        assert (found.evidence_exponent, found.prior_exponent) == expected


def test_windows_without_gyroscope_are_classified_only_by_a_model_trained_without_it(
    walks: list[pdr.Recording], forest: pdr.ContextModel
) -> None:
    blind = [replace(each, gyroscope=None) for each in walks]
    without = pdr.fit_contexts(blind, "forest", features=few, people=PEOPLE)
    assert (without.needs_gyroscope, forest.needs_gyroscope) == (False, True)
    shares = [
        pdr.classify(blind[0], pdr.recipes.default().with_contexts(model, MODES)).unknown_share
        for model in (without, forest)
    ]
    assert shares[0].mean() < 0.2 and (shares[1] == 1.0).all()


def test_fit_contexts_also_fits_carrying_modes(tmp_path: Path) -> None:
    own = [walk(3 * k + i, mode) for k, mode in enumerate(("pocket", "texting")) for i in range(2)]
    model = pdr.fit_contexts(own, "forest", head="carrying_mode", people=["a", "b", "a", "b"])
    assert (model.head, model.classes) == ("carrying_mode", ("pocket", "texting"))
    # five legs each, because windows without motion are not used
    assert sum(model.card["n_windows"].values()) <= 4 * 5 * 7
    model.save(tmp_path)
    config = pdr.recipes.default().with_carrying_model(pdr.ContextModel.load(tmp_path))
    seen = pdr.classify(walk(9, "texting"), config)
    assert seen.carrying_modes[int(seen.carrying_prob[-1].argmax())] == "texting"
    assert config.sensing.contexts != pdr.recipes.default().sensing.contexts
    odd = [with_labels(own[0], NAMES, "backpack"), *own[1:]]
    with pytest.raises(ValueError, match=r"carrying modes must be among .* got \['backpack'\].*rename"):
        pdr.fit_contexts(odd, "forest", head="carrying_mode", people=list("abab"))


def rate_kurtosis(signals: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Features of which constant signals do not have the first."""
    from_mean = signals["rate_radps"] - signals["rate_radps"].mean()
    return {"kurtosis": (from_mean**4).mean() / from_mean.var() ** 2, "force": signals["force_mps2"].std()}


def test_own_features_of_a_carrying_model_are_computed_from_measured_samples_alone() -> None:
    own = [walk(k, mode) for k, mode in enumerate(("pocket", "texting") * 2)]
    model = pdr.fit_contexts(own, "forest", head="carrying_mode", features=rate_kurtosis, people=list("aabb"))
    rng = np.random.default_rng(0)
    noise = [pdr.Samples(0.01 * np.arange(500), rng.normal(0.0, std, (500, 3))) for std in (0.01, 0.001)]
    rest = replace(own[0], accelerometer=replace(noise[0], values=noise[0].values + 5.0), gyroscope=noise[1])
    assert len(pdr.classify(rest, pdr.recipes.default().with_carrying_model(model)).time_s) == 3


def test_phones_at_places_without_a_carrying_mode_are_left_out_and_named_in_the_card() -> None:
    own = [walk(3 * k + i, mode) for k, mode in enumerate(("pocket", "texting")) for i in range(2)]
    chest = with_labels(own[0], NAMES, "chest")
    models = [
        pdr.fit_contexts(each, "forest", head="carrying_mode", people=list("ababa")[: len(each)])
        for each in (own, [*own, chest])
    ]
    assert models[0].card["n_windows"] == models[1].card["n_windows"]
    limits = "Not learnt, because the filter has no such carrying mode: chest."
    assert [model.card["limits"] for model in models] == ["", limits]
    assert models[1].card["limits"] in models[1].report()


def test_progress_grows_to_one(walks: list[pdr.Recording]) -> None:
    told: list[float] = []
    pdr.fit_contexts(walks, "forest", features=few, people=PEOPLE, progress=told.append)
    assert told == sorted(told) and told[-1] == pytest.approx(1.0) and len(told) > 6


def without_labels(recording: pdr.Recording) -> pdr.Recording:
    return replace(recording, truth=replace(recording.truth, labels=None))


class Silent:
    """No classes_ after fit."""

    def fit(self, X: Any, y: Any) -> None:  # noqa: N803
        return None

    def predict_proba(self, X: Any) -> Any:  # noqa: N803
        return np.ones((len(X), 1))


class Unsure(Silent):
    """Probabilities that do not sum to one."""

    def fit(self, X: Any, y: Any) -> None:  # noqa: N803
        self.classes_ = np.unique(y)

    def predict_proba(self, X: Any) -> Any:  # noqa: N803
        return np.ones((len(X), 3))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"classifier": "svm"}, r"classifier must be one of .* got 'svm': such as sklearn"),
        ({"classifier": LogisticRegression}, "classifier must be one of"),
        ({"classifier": Silent()}, "classifier must have classes_ after fit, but Silent has none"),
        ({"classifier": Unsure()}, "predict_proba of Unsure must return a probability for each of 3 classes_"),
        ({"head": "mood"}, r"head must be .* got 'mood'"),
        ({"people": ["anna"]}, "people must have 3 names, one for each recording, got 1"),
        ({"features": 3}, "features must be a feature set or a function"),
        ({"features": lambda signals: None}, "features must return a dict of a number for each name"),
        ({"features": lambda signals: {"a": np.nan}}, r"features must be finite, but a is NaN or infinite in 'walk0'"),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(value),
)
def test_invalid_arguments_are_refused_with_their_name_and_the_remedy(
    walks: list[pdr.Recording], arguments: dict[str, Any], message: str
) -> None:
    given: dict[str, Any] = {"classifier": "forest", "features": few, "people": PEOPLE, **arguments}
    with pytest.raises(ValueError, match=message):
        pdr.fit_contexts(walks, **given)


def test_labels_of_one_class_or_none_and_no_recordings_are_refused(walks: list[pdr.Recording]) -> None:
    def fit(recordings: list[pdr.Recording]) -> None:
        pdr.fit_contexts(recordings, "forest", features=few, people=PEOPLE[: len(recordings)])

    with pytest.raises(ValueError, match=r"at least two contexts, got 'level': add"):
        fit([with_labels(walk(seed), {"walking": "level"}) for seed in range(2)])
    with pytest.raises(ValueError, match=r"2 recordings with \d+ windows .* truth_labels.csv"):
        fit([without_labels(each) for each in walks[:2]])
    with pytest.raises(ValueError, match="0 recordings"):
        fit([])
    with pytest.raises(
        ValueError, match=r"recordings must contain Recording objects, got 'walk.zip': read files with pdr.read"
    ):
        fit(["walk.zip"])  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"'anna' cannot be held out, .* only windows of 'level': label"):
        fit([walks[0], with_labels(walk(1), {"walking": "level"})])


def test_a_context_of_one_person_is_learnt_but_not_scored_and_the_card_states_it(walks: list[pdr.Recording]) -> None:
    more = with_labels(walk(5), {**NAMES, "running": "sprint"})
    model = pdr.fit_contexts([*walks, more], "forest", features=few, people=[*PEOPLE, "dora"])
    assert "sprint" in model.classes and "sprint" in model.card["limits"]
    assert "sprint" not in model.card["leave_one_subject_out"]["confusion"]


@pytest.mark.parametrize("people", [None, ["anna"] * 3])
def test_recordings_of_one_person_are_held_out_and_the_report_says_so(
    walks: list[pdr.Recording], people: list[str] | None
) -> None:
    model = pdr.fit_contexts(walks, "forest", features=few, people=people)
    of_recordings = pdr.fit_contexts(walks, "forest", features=few, people=["a", "b", "c"])
    scores = model.card["leave_one_subject_out"]
    assert model.card["n_people"] == 1 and scores["people"] == "3 recordings of one person"
    expected = of_recordings.card["leave_one_subject_out"]
    assert (scores["log_loss"], scores["confusion"]) == (expected["log_loss"], expected["confusion"])
    assert "recordings not in training" in model.report() and "nothing is known about other people" in model.report()
    assert "1 people" in model.card["exponents"]


def test_a_single_recording_is_refused_with_the_remedy(walks: list[pdr.Recording]) -> None:
    with pytest.raises(ValueError, match=r"two of one person.* got one with labels, .walk0 .recording 1..: add"):
        pdr.fit_contexts(walks[:1], "forest", features=few)
    unlabelled = without_labels(walks[1])
    with pytest.raises(ValueError, match=r"got one with labels, 'walk0"):
        pdr.fit_contexts([walks[0], unlabelled], "forest", features=few, people=["anna", "ben"])


def test_a_recording_of_one_person_without_which_one_class_is_left_is_named() -> None:
    both, level = walk(0), with_labels(walk(1), {"walking": "level"})
    with pytest.raises(ValueError, match=r"recording 1\)' cannot be held out, .* other recordings have only .*'level'"):
        pdr.fit_contexts([both, level], "forest", features=few)


def test_the_report_says_what_the_numbers_of_people_and_placements_mean(forest: pdr.ContextModel) -> None:
    worst = forest.card["leave_one_subject_out"]["worst_person_accuracy"]
    words = f"has an accuracy of {worst:.3f}: a further person is worse with a probability of about 1 in 4"
    assert words in forest.report()
    assert forest.card["placements"] == ["pocket"]
    assert "placements of the phone in training: pocket; nothing is known about other" in forest.report()
    unlabelled = replace(forest, card={**forest.card, "placements": []})
    assert "placements of the phone are not labelled" in unlabelled.report()


def test_a_file_with_nan_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        ArtefactFormat("thing", 1, "").write(tmp_path / "thing", {"value": float("nan")})
    assert not list(tmp_path.iterdir())
