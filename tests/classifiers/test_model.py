# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

import hashlib
import io
import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sklearn.datasets import make_blobs
from sklearn.ensemble import RandomForestClassifier

from pdr_filter.classifiers import context_model as model_module
from pdr_filter.classifiers.blend import Blend
from pdr_filter.classifiers.context_model import ContextModel, available_models, load_model
from pdr_filter.classifiers.familiarity import fit_familiarity
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.sensing.contexts.context_stage import with_stairs_in_thirds
from pdr_filter.values import CARRYING_MODES, CONTEXTS, limits

# in the alphabetical order of scikit-learn, which is not the order of CONTEXTS
CLASSES = ("running", "upstairs", "walking")
FEATURES = ("mean", "variance", "energy", "peak")
PRIOR = np.array([0.0, 0.25, 0.25, 0.0, 0.0, 0.5])


def rows_and_labels() -> tuple[np.ndarray, np.ndarray]:
    X, y = make_blobs(120, 4, centers=3, cluster_std=3.0, random_state=0)
    return 5.0 + 10.0 * X, np.array(CLASSES)[y]


def build(kind: str) -> ContextModel:
    X, y = rows_and_labels()
    machine: Any
    if kind == "forest":
        mean, scale = np.zeros(4), np.ones(4)
        machine = Forest.from_sklearn(RandomForestClassifier(10, random_state=0).fit(X, y))
    else:
        mean, scale = X.mean(axis=0), X.std(axis=0)
        machine = RelevanceVectorClassifier().fit((X - mean) / scale, y).machine_
    card = {"data": "made up", "log_loss": np.float64(0.25), "confusion": np.eye(2), "note": "Größe"}
    return ContextModel(f"pocket-{kind}.v1", FEATURES, CLASSES, PRIOR, mean, scale, machine, card)


@pytest.fixture(scope="module", params=["forest", "rvm"])
def model(request: pytest.FixtureRequest) -> ContextModel:
    return build(request.param)


@pytest.fixture(scope="module")
def forest_model() -> ContextModel:
    return build("forest")


def test_probabilities_are_in_the_order_of_the_contexts_and_sum_to_one(model: ContextModel) -> None:
    X, _ = rows_and_labels()
    expected = model.machine.predict_proba((X - model.feature_mean) / model.feature_scale)
    for row, (running, upstairs, walking) in zip(X, expected, strict=True):
        np.testing.assert_allclose(model.predict(row), [0, walking, upstairs, 0, 0, running], atol=1e-15)
        assert model.predict(row).sum() == pytest.approx(1.0, abs=1e-15)


def test_temperature_limit_and_familiarity_are_restored_with_the_model(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    familiarity = fit_familiarity(rng.normal(size=(200, 4)), 1.3)
    model = replace(build("rvm"), temperature=1.7, feature_limit=3.0, familiarity=familiarity)
    again = load_model(model.save(tmp_path))
    for row in 20 * rng.normal(size=(20, 4)):
        assert again.assess(row)[1] == model.assess(row)[1]
        np.testing.assert_array_equal(again.predict(row), model.predict(row))
    assert model.assess(np.full(4, 1e6))[1] > 0.5


def test_a_window_unlike_all_stairs_distributes_walking_and_stairs_by_the_daily_prior(tmp_path: Path) -> None:
    near = replace(fit_familiarity(np.random.default_rng(0).normal(0.0, 0.1, (200, 4)), 0.2), sharpness=8.0)
    free = build("rvm")
    guarded = load_model(replace(free, stairs=near).save(tmp_path))
    gait = [CONTEXTS.index(c) for c in ("walking", "upstairs", "downstairs")]
    X, _ = rows_and_labels()
    for row in X[:20]:
        without, (prob, _, share, _) = free.predict(row), guarded.assess(row)
        expected = without.copy()
        expected[gait] = (1 - share) * without[gait] + share * without[gait].sum() * np.array([0.94, 0.03, 0.03])
        np.testing.assert_allclose(prob, expected, atol=1e-12)
        np.testing.assert_allclose(guarded.probabilities(row[None])[0], prob, atol=1e-12)
        assert prob[CONTEXTS.index("running")] == pytest.approx(without[CONTEXTS.index("running")])
    shares = np.array([guarded.assess(row).stairs_unknown_share for row in X])
    assert shares.max() > 0.99


def test_walking_and_stairs_start_with_equal_probabilities_if_another_sensor_decides() -> None:
    prob = np.array([0.1, 0.5, 0.3, 0.0, 0.0, 0.1])
    np.testing.assert_allclose(with_stairs_in_thirds(prob, 1.0), [0.1, 0.8 / 3, 0.8 / 3, 0.8 / 3, 0.0, 0.1])
    np.testing.assert_allclose(
        with_stairs_in_thirds(prob, 0.5), [0.1, 0.25 + 0.4 / 3, 0.15 + 0.4 / 3, 0.4 / 3, 0.0, 0.1]
    )
    np.testing.assert_array_equal(with_stairs_in_thirds(prob, 0.0), prob)


def test_the_temperature_makes_probabilities_less_confident_and_keeps_their_order() -> None:
    cold = build("rvm")
    warm = replace(cold, temperature=2.0)
    for row in rows_and_labels()[0][:30]:
        p, q = cold.predict(row), warm.predict(row)
        assert q.max() <= p.max()
        np.testing.assert_array_equal(np.argsort(p), np.argsort(q))


def test_a_feature_beyond_the_limit_counts_as_the_limit() -> None:
    model = replace(build("rvm"), feature_limit=3.0)
    far, edge = model.feature_mean.copy(), model.feature_mean.copy()
    far[1], edge[1] = 1e9, model.feature_mean[1] + 3.0 * model.feature_scale[1]
    np.testing.assert_allclose(model.predict(far), model.predict(edge), rtol=1e-9)


def test_a_carrying_mode_model_has_the_carrying_modes_as_labels(tmp_path: Path) -> None:
    model = build("forest")
    prior = np.array([0.25, 0.25, 0.5, 0.0, 0.0])
    carrying = replace(
        model,
        head="carrying_mode",
        classes=("swinging", "calling", "texting"),
        training_prior=prior,
        name="carrying",
        labels=(),
    )
    again = load_model(carrying.save(tmp_path))
    assert again.labels == CARRYING_MODES
    assert again.predict(model.feature_mean).shape == (5,)
    with pytest.raises(ValueError, match="head must be one of"):
        replace(carrying, head="activity")
    with pytest.raises(ValueError, match="classes must be different labels"):
        replace(carrying, head="context", labels=())


def test_a_saved_model_predicts_the_same_bits(model: ContextModel, tmp_path: Path) -> None:
    path = model.save(tmp_path / "new")
    assert path == tmp_path / "new" / f"{model.name}.npz"
    for given in (path, str(path), path.with_name(f"{model.name}.json"), path.with_name(model.name)):
        again = load_model(given)
        for row in rows_and_labels()[0][:20]:
            np.testing.assert_array_equal(again.predict(row), model.predict(row))
        assert (again.name, again.feature_names, again.classes) == (model.name, model.feature_names, model.classes)
        np.testing.assert_array_equal(again.training_prior, model.training_prior)
    assert again.card == {"data": "made up", "log_loss": 0.25, "confusion": [[1.0, 0.0], [0.0, 1.0]], "note": "Größe"}


def test_saving_twice_writes_the_same_bytes(forest_model: ContextModel, tmp_path: Path) -> None:
    first = forest_model.save(tmp_path).read_bytes()
    assert load_model(forest_model.save(tmp_path)).save(tmp_path / "b").read_bytes() == first


def test_shipped_models_are_found_by_name(
    forest_model: ContextModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model_module, "_SHIPPED", (tmp_path / "wheel", tmp_path / "checkout"))
    assert available_models() == ()
    forest_model.save(tmp_path / "checkout")
    replace(forest_model, name="a").save(tmp_path / "wheel")
    (tmp_path / "wheel" / "half.npz").touch()  # without a .json it is no model
    (tmp_path / "wheel" / "me.json").write_text('{"kind": "calibration", "format_version": 1}')
    assert available_models() == ("a", forest_model.name)
    assert load_model(forest_model.name).name == forest_model.name
    with pytest.raises(ValueError, match=r"no shipped model of that name \(there are: a, pocket-forest"):
        load_model("b")


def test_every_shipped_model_loads_and_predicts() -> None:
    for name in available_models():
        model = load_model(name)
        assert model.name == name
        assert model.predict(model.feature_mean).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("suffix", "share"), [("", 1 / 2), ("_accelerometer", 2 / 3)])
def test_the_default_model_is_the_mean_of_relevance_vector_machines_and_a_forest(suffix: str, share: float) -> None:
    blend, rvm, forest = (load_model(f"context{part}{suffix}") for part in ("", "_rvm", "_forest"))
    parts = rvm.machine.parts if isinstance(rvm.machine, Blend) else (rvm.machine,)
    assert isinstance(forest.machine, Forest) and all(isinstance(part, RelevanceVectors) for part in parts)
    X = 2.0 * np.random.default_rng(5).normal(size=(50, len(blend.feature_names)))
    machines = np.exp(np.mean([np.log(part.predict_proba(X)) for part in parts], axis=0))
    machines /= machines.sum(axis=1, keepdims=True)
    expected = (1.0 - share) * machines + share * forest.machine.predict_proba(X)
    np.testing.assert_allclose(blend.machine.predict_proba(X), expected, rtol=1e-9)
    for model in (blend, rvm, forest):
        known = model.familiarity
        assert known is not None and model.stairs is not None


def test_a_shipped_model_has_at_most_two_megabytes() -> None:
    folder = Path(__file__).parents[2] / "models"
    assert all(path.stat().st_size <= 2e6 for path in folder.glob("*.npz"))


def test_features_that_are_not_finite_or_of_another_number_are_refused(forest_model: ContextModel) -> None:
    with pytest.raises(ValueError, match=r"feature 2 \(energy\) is nan"):
        forest_model.predict(np.array([0.0, 1.0, np.nan, 2.0]))
    with pytest.raises(ValueError, match="needs 4 features"):
        forest_model.predict(np.zeros(5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "../evil"}, "becomes a file name"),
        ({"feature_names": ("mean", "mean", "energy", "peak")}, "different strings"),
        ({"feature_names": ("mean", "energy", "peak")}, "machine has 4 features"),
        ({"classes": ("running", "upstairs", "flying")}, "different labels"),
        ({"classes": ("running", "walking")}, "and 3 classes"),
        ({"classes": ("running", "downstairs", "walking")}, "training_prior is positive for"),
        ({"training_prior": np.full(6, 0.2)}, "sum to one"),
        ({"training_prior": np.array([0.5, 0.5])}, "sum to one"),
        ({"feature_mean": np.zeros(3)}, "one for each feature"),
        ({"feature_mean": np.full(4, np.nan)}, "finite"),
        ({"feature_scale": np.array([1.0, 0.0, 1.0, 1.0])}, "feature_scale must be above"),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(
    forest_model: ContextModel, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        replace(forest_model, **change)


def test_a_card_that_json_cannot_represent_is_refused_before_anything_is_written(
    forest_model: ContextModel, tmp_path: Path
) -> None:
    with pytest.raises(TypeError, match="JSON cannot hold a set"):
        replace(forest_model, card={"x": {1}}).save(tmp_path)
    assert not list(tmp_path.iterdir())


# --- hostile and damaged files: every error names the file ------------------------------------------------------


def json_of(path: Path) -> Path:
    """Path of the description of a model. The name of the model may have dots."""
    return Path(str(path).removesuffix(".npz") + ".json")


def rewrite(path: Path, content: bytes) -> None:
    """Replace the arrays and make the .json agree, as somebody with bad intentions would."""
    path.write_bytes(content)
    describe(path, npz_sha256=hashlib.sha256(content).hexdigest())


def with_arrays(path: Path, **changes: Any) -> None:
    with np.load(path) as arrays:
        kept = {name: arrays[name] for name in arrays.files} | changes
    rewrite(path, archive(**{name: array for name, array in kept.items() if array is not None}))


def describe(path: Path, **changes: Any) -> None:
    """Change entries of the description of a model."""
    description = json.loads(json_of(path).read_text(encoding="utf-8"))
    json_of(path).write_text(json.dumps(description | changes), encoding="utf-8")


def archive(save: Any = np.savez, **arrays: Any) -> bytes:
    buffer = io.BytesIO()
    save(buffer, **arrays)
    return buffer.getvalue()


def assert_refused(path: Path, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        load_model(path)
    assert str(path.parent) in str(error.value)


def test_a_missing_file_is_named(forest_model: ContextModel, tmp_path: Path) -> None:
    assert_refused(tmp_path / "none.npz", r"none\.npz: no such file")
    path = forest_model.save(tmp_path)
    path.unlink()
    json_path = json_of(path)
    assert_refused(json_path, r"v1\.json: .* pocket-forest\.v1\.npz is missing in the same folder")
    json_path.unlink()
    assert_refused(json_path, r"v1\.json: no such file")


def test_a_model_file_without_a_kind_is_still_read(forest_model: ContextModel, tmp_path: Path) -> None:
    path = forest_model.save(tmp_path)
    json_path = json_of(path)
    description = json.loads(json_path.read_text(encoding="utf-8"))
    assert description.pop("kind") == "context_model"
    json_path.write_text(json.dumps(description), encoding="utf-8")
    assert load_model(path).name == forest_model.name
    describe(path, kind="calibration")
    assert_refused(path, "its kind is 'calibration', not 'context_model'; train it again")


def test_a_mixture_of_files_of_two_trainings_is_refused(forest_model: ContextModel, tmp_path: Path) -> None:
    path = forest_model.save(tmp_path)
    other = replace(forest_model, feature_mean=np.ones(4)).save(tmp_path / "other")
    path.write_bytes(other.read_bytes())
    assert_refused(path, r"belongs to another \.json")


def test_truncated_arrays_are_refused(forest_model: ContextModel, tmp_path: Path) -> None:
    path = forest_model.save(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert_refused(path, "npz is damaged")


def test_what_is_no_archive_of_arrays_is_refused_and_a_pickle_never_opened(
    forest_model: ContextModel, tmp_path: Path
) -> None:
    path = forest_model.save(tmp_path)
    content, one_array = path.read_bytes(), io.BytesIO()
    np.save(one_array, np.zeros(3))
    pickles = (pickle.dumps(Bomb()), archive(feature_mean=np.array([Bomb()], dtype=object)))
    damaged = (content[: len(content) // 2], b"", b"PK\x03\x04 nonsense", content[:200] + b"\0" * 400 + content[600:])
    for content in (*damaged, one_array.getvalue(), *pickles):
        rewrite(path, content)
        assert_refused(path, "not usable as context model")


def test_arrays_that_unpack_to_more_than_the_limit_are_refused(
    forest_model: ContextModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = forest_model.save(tmp_path)
    rewrite(path, archive(np.savez_compressed, feature_mean=np.zeros(10**6)))
    monkeypatch.setattr(limits, "MAX_UNPACKED_BYTES", 10**6)
    assert_refused(path, "claims 80001.. bytes of arrays, more than 1000000")
    monkeypatch.setattr(limits, "MAX_WHOLE_BYTES", 100)
    assert_refused(path, r"npz: more than 100 bytes")
    monkeypatch.setattr(limits, "MAX_DESCRIPTION_BYTES", 100)
    assert_refused(path, r"json: more than 100 bytes")


class Bomb:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return exec, ("raise SystemExit('unpickled')",)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("machine_left", None, "machine_left|left"),
        ("training_prior", None, "'training_prior' is missing"),
        ("training_prior", np.array(["a"] * 6), "could not convert"),
        ("machine_n_features", np.array(5), "machine has 5 features"),
        ("machine_n_features", np.array([4, 4]), "not usable as"),
        ("machine_left", np.zeros(3), "integers"),
        ("machine_left", np.zeros((3, 2), dtype=int), "one entry for each node"),
        ("machine_probability", np.ones((3, 3)), "a row for each of"),
    ],
)
def test_arrays_that_are_missing_or_wrong_are_refused(
    forest_model: ContextModel, tmp_path: Path, name: str, value: Any, message: str
) -> None:
    path = forest_model.save(tmp_path)
    with_arrays(path, **{name: value})
    assert_refused(path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"json: not usable as context model: Expecting property name.*; train it again"),
        ("[]", "its kind is None, not 'context_model'"),
        ("{}", "its kind is None, not 'context_model'"),
        ('{"kind": "calibration", "format_version": 2}', "its kind is 'calibration', not 'context_model'"),
        ('{"kind": "context_model", "format_version": 99}', "its format_version is 99, this version reads 2 only"),
        ('{"kind": "context_model", "format_version": 1}', "format_version is 1, .* use the version that wrote it"),
    ],
)
def test_a_damaged_description_is_refused(forest_model: ContextModel, tmp_path: Path, text: str, message: str) -> None:
    path = forest_model.save(tmp_path)
    json_of(path).write_text(text)
    assert_refused(path, message)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("machine", "pickle"),
        ("machine", ["forest"]),
        ("classes", 3),
        ("classes", [1, 2, 3]),
        ("name", 7),
        ("feature_names", None),
        ("feature_names", [["a"], "b", "c", "d"]),
        ("card", 5),
    ],
)
def test_a_description_of_something_else_is_refused(
    forest_model: ContextModel, tmp_path: Path, key: str, value: Any
) -> None:
    path = forest_model.save(tmp_path)
    describe(path, **{key: value})
    assert_refused(path, "not usable as context model")


@pytest.mark.parametrize("name", ["context", "context_accelerometer", "context_boosted", "carrying"])
def test_a_shipped_model_gives_a_window_the_same_bits_alone_and_in_a_batch(name: str) -> None:
    model = load_model(name)
    rng = np.random.default_rng(4)
    X = model.feature_mean + 2.0 * model.feature_scale * rng.normal(size=(33, len(model.feature_names)))
    for row, among_others in zip(X, model.assess_all(X), strict=True):
        alone = model.assess(row)
        assert alone[1:] == among_others[1:]
        np.testing.assert_array_equal(alone.prob, among_others.prob)


def test_a_file_that_is_no_json_beside_a_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes.json").write_text("{")
    with pytest.raises(ValueError, match=r"notes.json: no JSON .*move it to another folder"):
        ContextModel.load(tmp_path)
