"""`pdr-filter map`: a folder of walks becomes a map."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import mark, one_line, refusal, run, short_walk, succeed
from heard import chains_made_once, round_a_block, walk_with_wifi

import pdr_filter as pdr


@pytest.fixture(scope="module", autouse=True)
def _chains_once() -> Iterator[None]:
    with chains_made_once():
        yield


def two_walks(folder: Path) -> Path:
    for seed in (1, 2):
        walk_with_wifi(round_a_block(), seed).save(folder / f"walk{seed}.zip")
    return folder


def test_a_folder_becomes_a_map_with_a_radio_map_a_plan_and_a_report(tmp_path: Path) -> None:
    walks = two_walks(tmp_path / "walks")
    short_walk().save(walks / "deaf.zip")
    mark(walks / "walk1.zip", "time_s,east_m,north_m,std_m\n0.5,100.0,50.0,0.5\n")
    out = tmp_path / "out"
    result = succeed("map", walks, "--out", out, "--hash", "secret")
    assert "group 0: 2 walks" in result.stdout
    assert "apart: short_walk: no Wi-Fi" in result.stdout
    found = pdr.WalkMap.load(out / "map")
    assert len(found.walks) == 2
    at_mark_m = found.walks[0].position_m[0]
    assert abs(at_mark_m - [100.0, 50.0]).max() < 2.0
    assert len(pdr.RadioMap.load(out / "radio_0").position_m) > 20
    assert json.loads((out / "plan_0.geojson").read_text())["features"]
    assert (out / "map.html").read_text("utf-8").count('"walk":') == 2


def test_known_positions_that_are_not_used_are_named(tmp_path: Path) -> None:
    two_walks(tmp_path)
    mark(tmp_path / "walk1.zip", "time_s,east_m,north_m\n0.5,100,50\n0.5,400,50\n")
    result = succeed("map", tmp_path, "--out", tmp_path / "out", "--times")
    assert result.stdout.count("note: the known position of walk1 at 0.5 s is not used: ") == 2
    assert "the known position of walk1 at 0.5 s" in (tmp_path / "out" / "map.html").read_text("utf-8")
    mark(tmp_path / "walk1.zip", "time_s,east_m,north_m\n1e6,100,50\n")
    assert "fix at 1000000.0 s for the walk 'walk1'" in refusal("map", tmp_path, "--out", tmp_path / "out")


def test_a_folder_without_a_walk_that_can_be_joined_is_refused_after_the_reasons(tmp_path: Path) -> None:
    short_walk().save(tmp_path / "deaf.zip")
    for given in (tmp_path, tmp_path / "deaf.zip"):
        result = run("map", given, "--out", tmp_path / "out")
        assert result.exit_code == 2
        assert "apart: short_walk: no Wi-Fi scans" in result.stdout
        assert "no map was written, because no walk could be joined" in one_line(result.stderr)
        assert not (tmp_path / "out" / "map").exists() and not (tmp_path / "out" / "map.html").exists()


def test_a_map_with_fewer_walks_and_groups_replaces_an_earlier_one_and_removes_its_other_files(tmp_path: Path) -> None:
    walks, out = tmp_path / "walks", tmp_path / "out"
    walks.mkdir()
    for seed in (1, 2):
        walk_with_wifi(round_a_block(), seed).save(walks / f"a{seed}.zip")
        walk_with_wifi(round_a_block(), seed + 2, first=1000).save(walks / f"b{seed}.zip")
    first = run("map", walks, "--out", out)
    assert "group 1: 2 walks" in first.stdout and "or too few walks in between" in first.stdout
    assert "replaced" not in first.stderr and "removed" not in first.stderr
    (out / "radio_notes.json").write_text("{}")
    for seed in (1, 2):
        (walks / f"b{seed}.zip").unlink()
    second = run("map", walks, "--out", out)
    replaced, removed = second.stderr.strip().splitlines()[-2:]
    for name in ("map", "map.html", "radio_0.json", "radio_0.npz", "plan_0.geojson"):
        assert str(out / name) in replaced.split(": ")[1].split(", ")
    gone = [out / "plan_1.geojson", out / "radio_1.json", out / "radio_1.npz"]
    assert removed == f"removed files of an earlier map: {', '.join(map(str, gone))}"
    assert not any(path.exists() for path in gone)
    assert (out / "radio_notes.json").exists()
    assert len(pdr.WalkMap.load(out / "map").walks) == 2


def test_no_file_has_names_of_walks_unless_they_are_asked_for(tmp_path: Path) -> None:
    walks = tmp_path / "walks"
    for seed in (1, 2):
        replace(walk_with_wifi(round_a_block(), seed), name=f"anna_{seed}").save(walks / f"{seed}.zip")
    replace(short_walk(), name="anna_3").save(walks / "3.zip")

    def names_in(out: Path) -> set[str]:
        files = [path for path in out.rglob("*") if path.is_file() and path.parent.name != "cache"]
        return {path.name for path in files if b"anna_" in path.read_bytes()}

    without = run("map", walks, "--out", tmp_path / "without")
    assert "apart: anna_3" in without.stdout
    assert names_in(tmp_path / "without") == set()
    succeed("map", walks, "--out", tmp_path / "with", "--times")
    assert {"map.html", "radio_0.json", "walk_map.json"} <= names_in(tmp_path / "with")
    found, named = (pdr.RadioMap.load(tmp_path / folder / "radio_0") for folder in ("without", "with"))
    np.testing.assert_array_equal(found.position_m, named.position_m)
    plans = [(tmp_path / folder / "plan_0.geojson").read_bytes() for folder in ("without", "with")]
    assert plans[0] == plans[1]


def test_fixes_that_are_not_the_marks_of_a_recording_are_named_with_the_place_where_they_are_read(
    tmp_path: Path,
) -> None:
    walks = tmp_path / "walks"
    short_walk().save(walks / "deaf.zip")
    (walks / "fixes.csv").write_text("time_s,east_m,north_m\n0.5,100.0,50.0\n")
    place = f"known positions of deaf.zip are read from {walks / 'deaf.zip.marks' / 'fixes.csv'}"
    smoothing = ("smooth", walks / "deaf.zip"), ", or from the file of --fixes"
    for command, or_from in ((("map", walks, "--out", tmp_path / "out"), ""), smoothing):
        said = run(*command).stderr.replace("\n", " ")
        assert f"{walks / 'fixes.csv'} is not used: {place}{or_from}" in " ".join(said.split())
    assert "not used" not in run("smooth", walks / "deaf.zip", "--fixes", walks / "fixes.csv").stderr
    assert "not used" not in run("smooth", walks / "deaf.zip", "--no-marks").stderr


@pytest.mark.parametrize(
    ("command", "words"),
    [("map", "walk.zip.marks --hash --jobs --scheduler --times"), ("smooth", "walk.zip.marks")],
)
def test_the_help_names_the_place_of_the_marks_and_the_options(command: str, words: str) -> None:
    shown = run(command, "--help").stdout
    assert all(word in shown for word in words.split())
