"""`make models`: recordings from a mirror, their checksums, and the comparison with the shipped files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from models.training import make_models, train_all
from models.training.sine_people import simulated_person
from pdr_filter.offline.training.cross_validation import Progress

WALK = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=3.0)])


@pytest.fixture
def mirror(tmp_path: Path) -> Path:
    """A folder with one recording of each data set."""
    for name in make_models.NAMES:
        walk = replace(WALK, name=f"{name}_1", meta={"licence": f"licence of {name}"})
        walk.save(tmp_path / name / f"{name}_1.zip")
    return tmp_path


def test_recordings_of_a_mirror_are_used_and_their_licences_and_sizes_shown(
    mirror: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert [path.stem for path in make_models.gathered(mirror)] == [f"{name}_1" for name in make_models.NAMES]
    shown = capsys.readouterr().err
    for name in make_models.NAMES:
        assert f"{name}: 1 recordings, 0.0 MB, licence: licence of {name}" in shown


def test_data_sets_without_a_folder_in_the_mirror_are_downloaded_without_duplicates(
    mirror: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, object]] = []

    def fetch(name: str, folder: object, of: object) -> list[Path]:
        asked.append((name, of))
        return [Path(f"{make_models.DUPLICATES[0]}.zip"), Path(f"{name}_2.zip")]

    shutil.rmtree(mirror / "humolire")
    (mirror / "motionsense" / "motionsense_1.zip").rename(mirror / "motionsense" / "published.csv")
    monkeypatch.setattr(make_models.datasets, "fetch", fetch)
    names = {path.stem for path in make_models.gathered(mirror)}
    assert asked == [("humolire", None), ("motionsense", mirror)]
    assert {"humolire_2", "motionsense_2"} < names
    assert make_models.DUPLICATES[0] not in names


def test_recordings_with_other_samples_or_labels_and_missing_ones_are_named(mirror: Path) -> None:
    paths = make_models.gathered(mirror)
    known = {path.stem: make_models.checksum(pdr.read(path)) for path in paths}
    assert make_models.different(paths, known) == []
    changed = pdr.read(paths[1])
    force = replace(changed.accelerometer, values=changed.accelerometer.values + 1e-3)
    replace(changed, accelerometer=force).save(paths[1])
    assert make_models.different(paths[:-1], known) == [paths[1].stem, paths[-1].stem]


def test_the_shipped_cards_name_the_command_and_the_checksums_all_their_data_sets() -> None:
    known = make_models.known_checksums()
    for path in make_models.MODELS.glob("*.json"):
        card = json.loads(path.read_text(encoding="utf-8"))["card"]
        assert card["command"] == "make models", path
        for name in card["data"]:
            assert any(recording.startswith(f"{name}_") for recording in known), (path, name)


def test_every_training_set_can_be_downloaded() -> None:
    assert set(make_models.NAMES) <= set(make_models.datasets.DATASETS)


def made(folder: Path) -> Path:
    """A folder with copies of the shipped models."""
    folder.mkdir()
    for path in make_models.MODELS.iterdir():
        if path.suffix in (".npz", ".json"):
            shutil.copy(path, folder)
    return folder


def test_the_table_says_which_models_have_other_bytes_and_which_are_not_trained(tmp_path: Path) -> None:
    new = made(tmp_path / "new")
    card = json.loads((new / "context.json").read_text("utf-8"))
    (new / "context.json").write_text(json.dumps(card), "utf-8")  # other bytes, the same content
    (new / "guo_pose.json").unlink()
    rows = {str(row[0]): list(row[1:]) for row in make_models.table_rows(new, {"context": 12.6})}
    versions = ", ".join(f"{name} {version}" for name, version in card["card"]["versions"].items())
    assert rows["`context`"] == ["13", "**no**", versions]
    assert rows["`carrying`"] == ["", "yes", versions]
    assert rows["`guo_pose`"] == ["", "not trained", ""]
    assert len(rows) == 13


def test_an_interrupted_training_resumes_with_the_missing_models(
    mirror: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    new, asked = made(tmp_path / "new"), list[set[str]]()
    for suffix in (".npz", ".json"):
        (new / "guo_pose").with_suffix(suffix).rename((tmp_path / "guo_pose").with_suffix(suffix))
    (new / make_models.SECONDS).write_text('{"context": 5.0}')

    def train(paths: list[Path], out_dir: Path, progress: Progress, without: set[str]) -> None:
        asked.append(without)
        for suffix in (".npz", ".json"):
            shutil.copy((tmp_path / "guo_pose").with_suffix(suffix), out_dir)

    monkeypatch.setattr(train_all, "train_models", train)
    make_models.main(new, mirror, tmp_path / "tables")
    assert asked == [set(make_models.model_names(new)) - {"guo_pose"}]
    assert set(json.loads((new / make_models.SECONDS).read_text())) == {"context", "guo_pose"}
    table = (tmp_path / "tables" / "models_made.md").read_text("utf-8")
    assert table.count("| yes |") == 13 and "| `context` | 5 | yes |" in table
    assert "the models will differ" in capsys.readouterr().err


def test_models_in_the_folder_are_not_trained_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def windows(*_: object) -> None:
        asked.append("windows")

    def no_carrying(*_: object, plans: list[Any]) -> list[Any]:
        asked.extend(plan.name for plan in plans)
        return []

    def pose(*_: object) -> dict[str, Any]:
        asked.append("guo_pose")
        return {}

    monkeypatch.setattr(train_all.contexts, "labelled_windows", windows)
    monkeypatch.setattr(train_all.carrying, "train_carrying", no_carrying)
    monkeypatch.setattr(train_all.guo2018, "train_guo", pose)
    names = set(make_models.model_names(make_models.MODELS))
    train_all.train_models([], tmp_path, without=names)
    assert asked == []
    train_all.train_models([], tmp_path, without=names - {"carrying", "guo_pose"})
    assert asked == ["carrying", "guo_pose"]


def test_the_plans_name_all_shipped_models() -> None:
    names = [name for plan in train_all.contexts.PLANS for name in plan.model_names]
    names += [plan.name for plan in train_all.carrying.PLANS] + [train_all.guo2018.PLAN.name]
    assert sorted(names) == make_models.model_names(make_models.MODELS)


def test_simulated_people_of_the_training_are_those_of_the_shipped_models() -> None:
    walk = simulated_person("swinging", 3)
    assert walk.gyroscope is not None
    assert (len(walk.accelerometer.time_s), walk.truth.labels["context"].tolist()) == (
        1851,
        ["stationary", "walking", "walking", "walking", "running"],
    )
    np.testing.assert_allclose(
        walk.accelerometer.values[1000], [-5.710170959472656, -5.418078356933593, -0.5219359619140624], rtol=1e-9
    )
    np.testing.assert_allclose(
        walk.gyroscope.values[1000], [0.2671205135674249, -0.3980202074669996, -0.5555255302079513], rtol=1e-9
    )


TRAINING = """
import sys
from pathlib import Path

from models.training import carrying_training, guo2018_training, make_models, train_all

folder, out_dir = map(Path, sys.argv[1:])
paths = sorted(folder.glob("*.zip"))
guo2018_training.train_guo(paths, out_dir, n_simulated=1)
carrying_training.train_carrying(paths, out_dir, n_simulated=1)
names = set(make_models.model_names(make_models.MODELS))
train_all.train_models(paths, out_dir, without=names - {"context_martinelli_forest"})
"""


def test_the_same_recordings_give_the_same_bytes_with_another_hash_seed_and_in_another_folder(tmp_path: Path) -> None:
    people = [("motionsense", "a", "pocket"), ("motionsense", "b", "pocket"), ("tyrex", "t", "swinging")]
    people += [("humolire", "h", "texting"), ("oxford", "o", "texting")]
    for number, (dataset, subject, mode) in enumerate(people):
        walk = simulated_person(mode, 500 + number)
        meta: dict[str, Any] = {**walk.meta, "dataset": dataset, "subject": {"id": subject}}
        replace(walk, name=f"{dataset}_{subject}", meta=meta).save(tmp_path / "walks" / f"{dataset}_{subject}.zip")
    made_bytes: list[dict[str, bytes]] = []
    for seed in ("1", "2"):
        here = tmp_path / seed
        here.mkdir()
        env = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(make_models.MODELS.parent)}
        walks = os.path.relpath(tmp_path / "walks", here)
        subprocess.run([sys.executable, "-c", TRAINING, walks, "new"], cwd=here, env=env, check=True)
        made_bytes.append({path.name: path.read_bytes() for path in (here / "new").iterdir()})
    assert len(made_bytes[0]) == 8  # two files of each of the four models
    assert made_bytes[0] == made_bytes[1]
