"""Training of the carrying mode on simulated people."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joblib import parallel_config

from models.training.carrying_training import FEATURE_NAMES, PLANS, balanced_weight, carrying_windows, train_carrying
from models.training.sine_people import MODES, simulated_person
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.sensing.features import carrying
from pdr_filter.values import CARRYING_MODES


def recordings(folder: Path) -> list[Path]:
    """Simulated people labelled as people of data sets: one pocket each, one in the hand, and one of no data set."""
    people = [("motionsense", "a", "pocket"), ("motionsense", "b", "pocket"), ("tyrex", "t", "swinging")]
    people += [("humolire", "h", "texting"), ("elsewhere", "e", "calling")]
    paths: list[Path] = []
    for number, (dataset, subject, mode) in enumerate(people):
        recording = simulated_person(mode, 500 + number)
        meta: dict[str, Any] = {**recording.meta, "dataset": dataset, "subject": {"id": subject}}
        name = f"{dataset}_{subject}"
        paths.append(
            write_recording(replace(recording, name=name, meta={**meta, "name": name}), folder / f"{name}.zip")
        )
    return paths


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return recordings(tmp_path_factory.mktemp("recordings"))


def test_a_small_training_writes_both_models_with_held_out_scores(paths: list[Path], tmp_path: Path) -> None:
    told: list[float] = []
    with parallel_config(backend="threading"):
        cards = train_carrying(paths, tmp_path, lambda what, done: told.append(done), n_simulated=2)
    assert [card["name"] for card in cards] == ["carrying", "carrying_accelerometer"]
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)
    for card in cards:
        assert set(card["site_left_out"]) == {"tyrex", "humolire"}
        assert card["site_left_out"]["tyrex"]["n"] == {"swinging": card["n_windows"]["swinging"]}
        assert 0 <= card["leave_one_subject_out"]["recall"]["pocket"] <= 1
        model = load_model(tmp_path / f"{card['name']}.npz")
        assert model.head == "carrying_mode" and set(model.feature_names) <= set(FEATURE_NAMES)
        prob, unknown, *_ = model.assess(model.feature_mean)
        assert prob.sum() == pytest.approx(1.0) and unknown == 0.0
        assert prob[CARRYING_MODES.index("bag")] == 0.0 == model.training_prior[CARRYING_MODES.index("bag")]
    assert cards[0]["n_windows"]["calling"] == 0  # the recording of another data set is not used
    made = cards[0]["made_windows"]
    assert set(made) == {"simulated", "turned_humolire", "weak_motionsense"}
    assert set(cards[1]["made_windows"]) == {"simulated"}
    assert not set(load_model(tmp_path / "carrying_accelerometer.npz").feature_names) & (
        set(carrying.NAMES) - set(carrying.WITHOUT_GYROSCOPE)
    )


def test_windows_are_reproducible_and_only_of_moving_people(paths: list[Path]) -> None:
    first, second = (carrying_windows(PLANS[0], paths, 1) for _ in range(2))
    np.testing.assert_array_equal(first.features, second.features)
    assert "stationary" not in first.context and first.has_gyroscope.all()
    assert np.isfinite(first.features).all()


def test_synthetic_windows_made_from_a_person_have_that_person(paths: list[Path]) -> None:
    windows = carrying_windows(PLANS[0], paths, 1)
    turned, weak = windows.dataset == "turned_humolire", windows.dataset == "weak_motionsense"
    assert set(windows.person[turned]) == {"humolire/h"} and set(windows.carrying_mode[turned]) == {"calling"}
    assert set(windows.person[weak]) == {"motionsense/a", "motionsense/b"}
    assert set(windows.carrying_mode[weak]) == {"pocket"}


def test_a_weak_window_has_less_motion_and_a_turned_one_the_same_motion_on_its_edge(paths: list[Path]) -> None:
    windows = carrying_windows(PLANS[0], paths, 1)

    def median(source: str, mode: str, name: str) -> float:
        rows = (windows.dataset == source) & (windows.carrying_mode == mode) & (windows.context == "walking")
        return float(np.median(windows.features[rows, carrying.NAMES.index(name)]))

    assert median("weak_motionsense", "pocket", "log_vertical") < median("motionsense", "pocket", "log_vertical") - 0.3
    assert median("humolire", "texting", "screen_up") > 0.7
    assert median("turned_humolire", "calling", "screen_up") < 0.5
    for name in ("log_vertical", "log_tilt_angle", "log_lever_m", "horizontal_on_one_line"):
        assert median("turned_humolire", "calling", name) == pytest.approx(median("humolire", "texting", name), abs=0.1)


def test_weights_balance_classes_and_sources_whatever_their_number_of_windows() -> None:
    label = np.array(["pocket"] * 7 + ["calling"] * 5)
    source = np.array(["motionsense"] * 2 + ["tyrex"] * 4 + ["simulated"] + ["tyrex"] + ["turned_humolire"] * 4)
    weight = balanced_weight(label, source, {"simulated": 0.3, "turned": 0.5})
    assert weight.mean() == pytest.approx(1.0)
    assert weight[label == "pocket"].sum() == pytest.approx(weight[label == "calling"].sum())
    of = {(a, b): weight[(label == a) & (source == b)].sum() for a, b in zip(label, source, strict=True)}
    assert of["pocket", "motionsense"] == pytest.approx(of["pocket", "tyrex"])
    assert of["pocket", "simulated"] == pytest.approx(0.3 * of["pocket", "tyrex"])
    assert of["calling", "turned_humolire"] == pytest.approx(0.5 * of["calling", "tyrex"])


@pytest.mark.parametrize("mode", MODES)
def test_a_simulated_person_is_reproducible_and_depends_on_the_number(mode: str) -> None:
    first, again, other = (simulated_person(mode, number) for number in (4, 4, 5))
    np.testing.assert_array_equal(first.accelerometer.values, again.accelerometer.values)
    assert len(first.accelerometer.values) != len(other.accelerometer.values)
    assert first.truth.labels is not None and set(first.truth.labels.carrying_mode) == {mode}


def test_recordings_without_usable_windows_are_refused_with_the_requirements(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="motionsense"):
        train_carrying([], tmp_path, n_simulated=1)
