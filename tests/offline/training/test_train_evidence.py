"""Transitions and exponents estimated by `pdr-filter train` from labelled sequences of held-out people."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joblib import parallel_config
from typer.testing import CliRunner

import pdr_filter as pdr
from models.training import carrying_training as train_carrying
from models.training import context_training as training
from models.training import guo2018_training as train_guo
from models.training.context_training import PLANS, labelled_windows, model_without
from models.training.train_all import train
from pdr_filter.apps.cli.app import app
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.transition_files import Transitions, load_transitions
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.offline.training.classifier_choice import fit_softmax
from pdr_filter.offline.training.context_sequences import (
    UNKNOWN,
    LabelledProbabilities,
    count_transitions,
    estimate_transitions,
    fit_tempering,
    log_loss_by_person,
)
from pdr_filter.offline.training.cross_validation import LabelledWindows, train_one
from pdr_filter.offline.training.transition_training import (
    MIN_CHANGES,
    MIN_PEOPLE,
    LabelledSequences,
    changing_recordings,
    contexts_at,
    estimate,
    held_out_log_loss,
    labelled_sequences,
    shipped_model_without,
    train_evidence,
)
from pdr_filter.recipes import context_transitions, default, with_transitions
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CONTEXTS, Samples, table
from pdr_filter.values.recording import Recording

WALKING, UPSTAIRS, RUNNING = (CONTEXTS.index(c) for c in ("walking", "upstairs", "running"))
DEFAULT = default().model


def as_of(recording: Recording, dataset: str, person: str) -> Recording:
    """Return the recording, relabelled as that of a person in a data set."""
    name = f"{dataset}_{person}"
    meta: dict[str, Any] = {**recording.meta, "dataset": dataset, "subject": {"id": person}, "name": name}
    return replace(recording, name=name, meta=meta)


def mixed_walk(seed: int) -> Recording:
    """Return a walk of half a minute with five changes of context."""
    contexts = ("walking", "running", "walking", "upstairs", "walking", "running")
    legs = [Leg("stationary", duration_s=3.0), *(Leg(c, duration_s=5.0) for c in contexts)]
    return simulate(legs, carrying_mode="pocket", seed=seed)


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return [mixed_walk(seed) for seed in range(4)]


def written(recordings: list[Recording], folder: Path) -> list[Path]:
    folder.mkdir(exist_ok=True)
    return [write_recording(recording, folder / f"{recording.name}.zip") for recording in recordings]


@pytest.fixture(scope="module")
def mine(walks: list[Recording], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with recordings of four people of no data set."""
    folder = tmp_path_factory.mktemp("mine")
    written([as_of(walk, "mine", f"p{i}") for i, walk in enumerate(walks)], folder)
    return folder


def drawn(n_people: int, n: int, stay: float = 0.95, repeats: int = 3, seed: int = 0) -> LabelledSequences:
    """Return sequences of two contexts, whose windows of two steps repeat their evidence `repeats` times."""
    rng = np.random.default_rng(seed)
    two = np.array([WALKING, UPSTAIRS])
    step_label = np.concatenate([two[np.cumsum(rng.random(2 * n) > stay) % 2] for _ in range(n_people)])
    label = step_label[::2]
    person = np.repeat([f"set/p{i}" for i in range(n_people)], n)
    feature = (label == UPSTAIRS) + 0.7 * rng.normal(size=len(label))
    log_prob = np.full((len(label), len(CONTEXTS)), -12.0)
    log_prob[:, two] = -0.5 * repeats * ((feature[:, None] - np.arange(2)) / 0.7) ** 2
    prob = np.exp(log_prob - log_prob.max(axis=1, keepdims=True))
    prob /= prob.sum(axis=1, keepdims=True)
    windows = LabelledProbabilities(prob, np.full_like(prob, 1 / len(CONTEXTS)), label, person, person)
    return LabelledSequences(step_label, np.repeat(person, 2), np.repeat(person, 2), windows, n_people)


# --- Sequences from recordings


def test_a_time_has_the_context_of_its_label_and_none_outside_every_label(walks: list[Recording]) -> None:
    rows = {"start_s": [1.0, 2.0, 5.0], "end_s": [2.0, 4.0, 6.0], "context": ["walking", "running", "cycling"]}
    labels = table({name: np.array(values) for name, values in rows.items()})
    recording = replace(walks[0], truth=replace(walks[0].truth, labels=labels))
    found = contexts_at(recording, np.array([0.9, 1.0, 1.9, 2.0, 3.9, 4.0, 5.5]))
    np.testing.assert_array_equal(found, [UNKNOWN, WALKING, WALKING, RUNNING, RUNNING, UNKNOWN, UNKNOWN])


def test_only_recordings_with_gyroscope_whose_context_changes_are_used(walks: list[Recording], tmp_path: Path) -> None:
    walk = as_of(walks[0], "mine", "anna")
    columns = {name: walk.truth.labels[name] for name in ("start_s", "end_s", "carrying_mode")}
    same = table({**columns, "context": np.full(7, "walking")})
    one_context = replace(walk, name="same", truth=replace(walk.truth, labels=same))
    no_labels = replace(walk, name="none", truth=replace(walk.truth, labels=None))
    no_gyroscope = replace(walk, name="half", gyroscope=None)
    paths = written([walk, one_context, no_labels, no_gyroscope], tmp_path)
    assert changing_recordings([*paths, paths[0]], pdr.read) == {paths[0].resolve(): "mine/anna"}


def test_steps_are_counted_as_the_default_recipe_detects_them(mine: Path) -> None:
    changing = changing_recordings(sorted(mine.glob("*.zip")), pdr.read)
    sequences = labelled_sequences(changing, pdr.read, shipped_model_without)
    assert sequences is not None and sequences.n_recordings == 4
    expected = np.zeros((len(CONTEXTS), len(CONTEXTS)))
    for path in changing:
        walk = pdr.read(path)
        of_step = contexts_at(walk, np.asarray(pdr.detect_steps(walk).time_s))
        for before, after in pairwise(of_step):
            expected[before, after] += UNKNOWN not in (before, after)
    np.testing.assert_array_equal(sequences.counts(), expected)
    assert expected[WALKING, RUNNING] == 8 and expected[WALKING, UPSTAIRS] == expected[UPSTAIRS, WALKING] == 4
    assert sequences.counts(without=["mine/p0", "mine/p1", "mine/p2", "mine/p3"]).sum() == 0


def test_windows_are_those_of_the_filter_with_the_context_at_their_middle(mine: Path) -> None:
    path = sorted(mine.glob("*.zip"))[0]
    sequences = labelled_sequences({path: "mine/p0"}, pdr.read, shipped_model_without)
    walk = pdr.read(path)
    seen = pdr.classify(walk)
    np.testing.assert_array_equal(sequences.windows.prob, seen.context_prob)
    np.testing.assert_array_equal(sequences.windows.label, contexts_at(walk, seen.time_s - 1.0))
    np.testing.assert_array_equal(sequences.windows.training_prior[0], load_model("context").training_prior)
    assert len(set(sequences.windows.label)) == 4


def test_no_transition_is_counted_across_a_gap(walks: list[Recording], tmp_path: Path) -> None:
    gap = (9.0, 15.0)  # walking before it, walking after it

    def cut(samples: Samples) -> Samples:
        use = (samples.time_s < gap[0]) | (samples.time_s > gap[1])
        return Samples(samples.time_s[use], samples.values[use])

    walk = as_of(walks[0], "mine", "p0")
    assert walk.gyroscope is not None
    with_gap = replace(walk, accelerometer=cut(walk.accelerometer), gyroscope=cut(walk.gyroscope), magnetometer=None)
    path = written([with_gap], tmp_path)[0]
    sequences = labelled_sequences({path: "mine/p0"}, pdr.read, shipped_model_without)
    assert len(np.unique(sequences.step_sequence)) == len(np.unique(sequences.windows.sequence)) == 2
    joined = count_transitions(sequences.step_label, np.full(len(sequences.step_label), "a"), len(CONTEXTS))
    assert joined.sum() == sequences.counts().sum() + 1


# --- People who must not have been in training


def test_a_model_without_people_is_trained_on_all_others_and_unchanged_for_unseen_people(
    walks: list[Recording], tmp_path: Path
) -> None:
    paths = written([as_of(walk, "motionsense", f"s{i}") for i, walk in enumerate(walks)], tmp_path)
    plan = replace(PLANS[0], machine_fit=fit_softmax, datasets=("motionsense",))
    windows = plan.of(labelled_windows(paths, feature_set=plan.feature_set))
    rest = plan.of(labelled_windows(paths[1:], feature_set=plan.feature_set))
    with parallel_config(backend="threading"):
        model = train_one(plan, windows, lambda what, done: None)
        others = train_one(plan, rest, lambda what, done: None)
    assert model_without(model, plan, windows, ["mine/p0"]) is model
    without = model_without(model, plan, windows, ["motionsense/s0"])
    for name in ("training_prior", "feature_mean", "feature_scale"):
        np.testing.assert_array_equal(getattr(without, name), getattr(others, name))
    features = windows.features[0]
    # calibration and limits of familiarity are kept from all held-out people
    assert (without.temperature, without.slip) == (model.temperature, model.slip)
    assert without.stairs is not None and model.stairs is not None and without.stairs.limit == model.stairs.limit
    calibrated = replace(others, temperature=model.temperature, slip=model.slip, stairs=without.stairs)
    np.testing.assert_array_equal(without.predict(features), calibrated.predict(features))
    assert without.familiarity is not None and model.familiarity is not None and others.familiarity is not None
    assert without.familiarity.limit == model.familiarity.limit
    # an eigenvalue's last bits depend on the number of threads that LAPACK happens to have
    np.testing.assert_allclose(without.familiarity.variance, others.familiarity.variance, rtol=1e-9)
    all_of_both = model.probabilities(windows.features), without.probabilities(windows.features)
    assert np.abs(all_of_both[0] - all_of_both[1]).max() > 1e-6


def test_every_persons_windows_come_from_a_model_without_them(mine: Path) -> None:
    asked: list[list[str]] = []

    def recorded(people: Any) -> ContextModel:
        asked.append(list(people))
        return load_model("context")

    changing = changing_recordings(sorted(mine.glob("*.zip")), pdr.read)
    labelled_sequences(changing, pdr.read, recorded)
    assert sorted(person for fold in asked for person in fold) == sorted(changing.values()) and len(asked) == 3


def test_groups_hold_out_each_scored_person_once_and_whole_sites() -> None:
    people = [f"motionsense/s{i}" for i in range(6)] + [f"difronzo/u{i}" for i in range(5)] + ["tyrex/a", "humolire/b"]
    person = np.repeat(people, 3)
    dataset = np.array([name.partition("/")[0] for name in person])
    text = np.full(len(person), "walking")
    windows = LabelledWindows(np.zeros((len(person), 1)), text, text, person, dataset, text, np.ones(len(person), bool))
    groups = PLANS[0].held_out(windows)
    of_people = np.sum([mask for name, mask in groups.items() if name.startswith("group")], axis=0)
    np.testing.assert_array_equal(of_people, np.isin(dataset, ["motionsense", "difronzo"]))
    assert all(len(np.unique(mask[person == name])) == 1 for mask in groups.values() for name in people)
    assert [name for name in groups if not name.startswith("group")] == ["tyrex", "humolire"]


# --- The estimate


def test_true_transitions_and_exponents_of_synthetic_sequences_are_recovered() -> None:
    sequences = drawn(6, 500, stay=0.9, repeats=3)
    found = estimate(sequences, DEFAULT)
    assert (found.card["transition_prob"], found.card["exponents"]) == ("estimated", "estimated")
    assert found.transition_prob[WALKING, WALKING] == pytest.approx(0.9, abs=0.02)
    assert found.transition_prob[UPSTAIRS, WALKING] == pytest.approx(0.1, abs=0.02)
    np.testing.assert_array_equal(found.transition_prob[RUNNING], context_transitions()[RUNNING])
    assert found.evidence_exponent == pytest.approx(1 / 3, abs=0.11)
    losses = found.card["log_loss"]
    assert losses["held_out"] < losses["held_out_default_exponents"] < losses["default"]
    assert found.card["n_people"] == 6 and found.card["n_changes"] == np.sum(found.counts[~np.eye(6, dtype=bool)])


def test_held_out_losses_use_matrix_and_exponents_of_other_people() -> None:
    sequences = drawn(4, 120)
    found = held_out_log_loss(sequences, DEFAULT, DEFAULT.transition_prob)
    expected: dict[str, list[float]] = {"held_out_default_exponents": [], "held_out": []}
    for person in np.unique(sequences.windows.person):
        others = sequences.step_person != person
        counts = count_transitions(sequences.step_label[others], sequences.step_sequence[others], len(CONTEXTS))
        between = np.linalg.matrix_power(estimate_transitions(counts, context_transitions()), 2)
        choice = fit_tempering(part_of(sequences.windows, sequences.windows.person != person), between)
        own = part_of(sequences.windows, sequences.windows.person == person)
        for name, of_evidence, of_prior in (
            ("held_out", choice.evidence_exponent, choice.prior_exponent),
            ("held_out_default_exponents", 1.0, 0.2),
        ):
            loss = log_loss_by_person(own, between, np.array([of_evidence]), np.array([of_prior]), 0.01)[1]
            expected[name].append(float(loss[0, 0]))
    for name, values in expected.items():
        assert found[name] == pytest.approx(np.mean(values), rel=1e-12)


def part_of(windows: LabelledProbabilities, use: np.ndarray) -> LabelledProbabilities:
    rows: dict[str, Any] = {name: getattr(windows, name)[use] for name in windows.__dataclass_fields__}
    return LabelledProbabilities(**rows)


def test_many_people_are_held_out_in_parts() -> None:
    losses = held_out_log_loss(drawn(12, 40), DEFAULT, DEFAULT.transition_prob)
    assert all(np.isfinite(value) and value > 0 for value in losses.values())
    assert losses["held_out"] < losses["default"]


def is_default(found: Transitions, what: str = "both") -> bool:
    same_matrix = np.array_equal(found.transition_prob, context_transitions())
    same_exponents = (found.evidence_exponent, found.prior_exponent) == (1.0, 0.2)
    return same_exponents and (same_matrix or what == "exponents")


def test_without_sequences_the_default_is_kept_and_the_file_states_the_reason(tmp_path: Path) -> None:
    card = train_evidence({}, pdr.read, tmp_path, shipped_model_without)
    found = load_transitions(tmp_path / "transitions.json")
    assert is_default(found) and found.card == card
    assert card["transition_prob"].startswith("default: 0 changes") and str(MIN_CHANGES) in card["transition_prob"]
    assert card["exponents"] == card["transition_prob"] and card["n_recordings"] == 0


def test_with_too_few_changes_the_default_is_kept() -> None:
    sequences = drawn(5, 400, stay=0.9)
    end = int(np.flatnonzero(np.diff(sequences.step_label))[MIN_CHANGES - 1]) + 1  # before one change too many

    def first_steps(n: int) -> LabelledSequences:
        names = ("step_label", "step_person", "step_sequence")
        return replace(sequences, **{name: getattr(sequences, name)[:n] for name in names})

    found = estimate(first_steps(end), DEFAULT)
    assert is_default(found)
    assert found.card["transition_prob"].startswith(f"default: {MIN_CHANGES - 1} changes")
    assert found.counts.sum() == end - 1  # the counts are in the file although the default is kept
    assert estimate(first_steps(end + 1), DEFAULT).card["transition_prob"] == "estimated"


def test_with_few_people_the_matrix_is_estimated_but_not_the_exponents() -> None:
    found = estimate(drawn(MIN_PEOPLE - 1, 300), DEFAULT)
    assert found.card["transition_prob"] == "estimated" and not is_default(found)
    assert is_default(found, "exponents") and f"{MIN_PEOPLE - 1} people" in found.card["exponents"]
    assert found.card["log_loss"] == {}


def test_exponents_that_do_not_lower_the_held_out_loss_are_not_used() -> None:
    sequences = drawn(4, 200, repeats=1)
    # Two people whose windows are too unsure and two whose are too sure: what three ask for is wrong for the fourth.
    prob = sequences.windows.prob ** np.repeat([0.3, 4.0, 0.3, 4.0], 200)[:, None]
    windows = replace(sequences.windows, prob=prob / prob.sum(axis=1, keepdims=True))
    found = estimate(replace(sequences, windows=windows), DEFAULT)
    losses = found.card["log_loss"]
    assert losses["held_out"] > losses["held_out_default_exponents"]
    assert is_default(found, "exponents") and "do not lower the log loss of others" in found.card["exponents"]
    assert found.card["transition_prob"] == "estimated" and not is_default(found)


# --- The file, and its use


def some(**changes: Any) -> Transitions:
    values: dict[str, Any] = {
        "transition_prob": estimate_transitions(100.0 * np.eye(6), context_transitions()),
        "evidence_exponent": 0.7,
        "prior_exponent": 0.1,
        "counts": 100.0 * np.eye(6),
        "card": {"name": "transitions"},
    }
    return Transitions(**values | changes)


def test_saved_transitions_are_loaded_bit_identically(tmp_path: Path) -> None:
    path = some().save(tmp_path / "new")
    again = load_transitions(path)
    assert path == tmp_path / "new" / "transitions.json"
    np.testing.assert_array_equal(again.transition_prob, some().transition_prob)
    np.testing.assert_array_equal(again.counts, some().counts)
    assert (again.evidence_exponent, again.prior_exponent, again.card) == (0.7, 0.1, {"name": "transitions"})


def rows(value: float) -> list[list[float]]:
    changed = context_transitions()
    changed[WALKING, RUNNING] = value
    return changed.tolist()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("transition_prob", rows(0.5), r"row 1 is .* with sum 1\.49"),
        ("transition_prob", rows(-0.1), "row 1 is"),
        ("transition_prob", rows(float("nan")), "row 1 is .*nan"),
        ("transition_prob", rows(float("inf")), "row 1 is .*inf"),
        ("transition_prob", context_transitions().T.tolist(), "transpose the matrix"),
        ("transition_prob", np.eye(5).tolist(), r"must be \(6, 6\).*got \(5, 5\)"),
        ("transition_prob", [[1.0], [0.5, 0.5]], "inhomogeneous"),
        ("transition_prob", "even", "could not convert"),
        ("evidence_exponent", float("nan"), "evidence_exponent must be 0 or more and finite, got nan"),
        ("prior_exponent", -0.5, "prior_exponent must be 0 or more and finite, got -0.5"),
        ("prior_exponent", None, "not 'NoneType'"),
        ("counts", np.full((6, 6), -1.0).tolist(), "counts must be"),
        ("contexts", ["walking", "standing"], r"must be \(2, 2\), one row for each"),
        ("contexts", ["walking"] * 6, "contexts must have different names"),
        ("contexts", [1, 2, 3, 4, 5, 6], "name of a context must be a string .*got 1;"),
        ("contexts", None, "not iterable"),
        ("format_version", 2, "format_version is 2, this version reads 1"),
        ("kind", "calibration", "its kind is 'calibration', not 'transitions'"),
        ("card", 3, "not iterable"),
    ],
)
def test_an_inconsistent_file_is_refused_with_its_name_the_value_and_the_remedy(
    name: str, value: Any, message: str, tmp_path: Path
) -> None:
    path = some().save(tmp_path)
    path.write_text(json.dumps({**json.loads(path.read_text()), name: value}))
    with pytest.raises(ValueError, match=f"(?s)transitions.json: .*{message}.*with pdr-filter train"):
        load_transitions(path)


def test_a_missing_invalid_or_incomplete_file_is_refused_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"other\.json: no such file"):
        load_transitions(tmp_path / "other.json")
    path = some().save(tmp_path)
    content = json.loads(path.read_text())
    for text in ("{", "[1]", '"transitions"', "\x00", json.dumps({k: v for k, v in content.items() if k != "counts"})):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"transitions\.json: not usable as transitions: .*pdr-filter train"):
            load_transitions(path)


def test_with_transitions_changes_only_matrix_and_exponents_of_a_configuration(tmp_path: Path) -> None:
    config = default()
    for given in (some(), some().save(tmp_path), str(tmp_path / "transitions.json")):
        changed = with_transitions(config, given)
        np.testing.assert_array_equal(changed.model.transition_prob, some().transition_prob)
        assert (changed.model.evidence_exponent, changed.model.prior_exponent) == (0.7, 0.1)
        assert changed.sensing is config.sensing and changed.model.modes is config.model.modes
        assert changed.model.noise == config.model.noise and changed.name == config.name


def test_transitions_follow_the_order_of_the_modes() -> None:
    config = default()
    order = [3, 1, 5, 0, 4, 2]
    modes = tuple(config.model.modes[i] for i in order)
    matrix = estimate_transitions(np.arange(36.0).reshape(6, 6), context_transitions())
    config = config.with_model(modes=modes, transition_prob=context_transitions()[np.ix_(order, order)])
    changed = with_transitions(config, some(transition_prob=matrix)).model
    np.testing.assert_array_equal(changed.transition_prob, matrix[np.ix_(order, order)])


def test_transitions_between_other_contexts_are_saved_and_given_to_their_modes(tmp_path: Path) -> None:
    names = {"stationary": "resting", "walking": "level"}
    model = pdr.ContextModel.load("context").renamed(names)
    modes = [replace(m, name=names.get(m.name, m.name), context="") for m in default().model.modes]
    config = default().with_contexts(model, modes[::-1])
    path = some(contexts=model.contexts).save(tmp_path)
    assert load_transitions(path).contexts == model.contexts
    changed = with_transitions(config, path)
    np.testing.assert_array_equal(changed.model.transition_prob, some().transition_prob[::-1, ::-1])
    with pytest.raises(ValueError, match=r"'stationary', .*has modes of \['running', .*give transition_prob to"):
        with_transitions(config, some())


# --- The whole command


def small_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train one small model of MotionSense alone, and no model of the carrying mode and the pose."""
    plan = replace(PLANS[0], machine_fit=fit_softmax, parts={}, datasets=("motionsense",))
    monkeypatch.setattr(training, "PLANS", (plan,))

    monkeypatch.setattr(train_carrying, "train_carrying", lambda *_, **__: [{"name": "carrying"}])
    monkeypatch.setattr(train_guo, "train_guo", lambda *_: {"name": "guo_pose"})


def test_train_estimates_transitions_with_models_trained_without_the_people(
    walks: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_training(monkeypatch)
    without: list[str] = []

    def seen(model: ContextModel, plan: Any, windows: Any, people: list[str]) -> ContextModel:
        without.extend(people)
        return model_without(model, plan, windows, people)

    monkeypatch.setattr(training, "model_without", seen)
    written([as_of(walk, "motionsense", f"s{i}") for i, walk in enumerate(walks)], tmp_path / "motionsense")
    told: list[float] = []
    with parallel_config(backend="threading"):
        cards = train(tmp_path, tmp_path / "models", lambda what, done: told.append(done))
    assert [card["name"] for card in cards] == ["context", "carrying", "guo_pose", "transitions"]
    assert sorted(without) == [f"motionsense/s{i}" for i in range(4)]
    found = load_transitions(tmp_path / "models" / "transitions.json")
    assert found.card["data"] == ["motionsense"] and found.card["n_people"] == 4
    assert found.card["transition_prob"] == "estimated" and not is_default(found)
    assert set(found.card["log_loss"]) == {"default", "held_out_default_exponents", "held_out"}
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)


def test_the_command_estimates_from_own_recordings_and_track_uses_the_file(mine: Path, tmp_path: Path) -> None:
    run = partial(CliRunner().invoke, app)
    result = run(["train", "--sequences", str(mine), "--out", str(tmp_path)])
    path = Path(result.stdout.strip())
    assert path == tmp_path / "transitions.json"
    assert "transition_prob: estimated" in result.stderr and "exponents: " in result.stderr
    found = load_transitions(path)
    assert found.card["n_people"] == found.card["n_recordings"] == 4 and found.card["n_changes"] >= 16
    walk = str(sorted(mine.glob("*.zip"))[0])

    tracked = run(["track", walk, "--json", "--online", "--transitions", str(path)])
    assert tracked.exit_code == 0, tracked.stderr
    recording = pdr.read(walk)
    expected = pdr.track(recording, with_transitions(default(recording.subject), found))
    assert json.loads(tracked.stdout) == expected.summary()
    assert expected.distance_m != pdr.track(recording).distance_m


@pytest.mark.recordings
def test_no_public_data_set_has_a_labelled_change_of_context_so_the_default_is_kept(
    data_dir: Path, tmp_path: Path
) -> None:
    paths = [p for d in PLANS[0].datasets for p in sorted((data_dir / d).glob("*.zip"))[::8]]
    changing = changing_recordings(paths, pdr.read)
    # several activities in one recording, but the times between their labels are unlabelled
    assert len(paths) > 20 and {person.split("/")[0] for person in changing.values()} == {"difronzo"}
    sequences = labelled_sequences(changing, pdr.read, lambda people: load_model("context"))
    counts = sequences.counts()
    assert counts.sum() > 100 and counts.sum() == np.trace(counts)
    train_evidence({}, pdr.read, tmp_path, shipped_model_without)
    assert is_default(load_transitions(tmp_path / "transitions.json"))
