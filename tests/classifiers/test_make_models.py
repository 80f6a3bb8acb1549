"""`make models`: recordings from a mirror, their checksums, and the comparison with the shipped files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import pdr_filter as pdr
from models.training import make_models

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


def test_a_data_set_that_cannot_be_downloaded_is_named_before_anything_is_loaded(mirror: Path) -> None:
    shutil.rmtree(mirror / "tyrex")
    shutil.rmtree(mirror / "humolire")
    with pytest.raises(ValueError, match=r"cannot be downloaded: tyrex \(.*CeCILL.*make models MIRROR=FOLDER"):
        make_models.gathered(mirror)


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


def test_files_with_the_same_bytes_are_equal_and_others_are_not(tmp_path: Path) -> None:
    shutil.copytree(make_models.MODELS, tmp_path / "new", ignore=shutil.ignore_patterns("training"))
    (tmp_path / "new" / "context.npz").write_bytes(b"other")
    (tmp_path / "new" / "guo_pose.json").unlink()
    equal = make_models.compared(tmp_path / "new")
    assert sorted(name for name, is_equal in equal.items() if not is_equal) == ["context.npz", "guo_pose.json"]
