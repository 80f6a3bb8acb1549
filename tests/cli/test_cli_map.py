"""`pdr-filter map`: a folder of walks becomes a map."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from commands import run
from heard import round_a_block, walk_with_wifi

import pdr_filter as pdr


def test_a_folder_becomes_a_map_with_a_radio_map_a_plan_and_a_report(tmp_path: Path) -> None:
    walks = tmp_path / "walks"
    walks.mkdir()
    for seed in (1, 2):
        walk_with_wifi(round_a_block(), seed).save(walks / f"walk{seed}.zip")
    pdr.simulate.demo_walk().save(walks / "deaf.zip")
    marks = walks / "walk1.zip.marks"
    marks.mkdir()
    (marks / "fixes.csv").write_text("time_s,east_m,north_m,std_m\n0.5,100.0,50.0,0.5\n")
    out = tmp_path / "out"
    result = run("map", walks, "--out", out, "--hash", "secret")
    assert "group 0: 2 walks" in result.stdout
    assert "apart: demo_walk: no Wi-Fi" in result.stdout
    found = pdr.WalkMap.load(out / "map")
    assert len(found.walks) == 2
    at_mark_m = found.walks[0].position_m[0]
    assert abs(at_mark_m - [100.0, 50.0]).max() < 2.0
    assert len(pdr.RadioMap.load(out / "radio_0").position_m) > 20
    assert json.loads((out / "plan_0.geojson").read_text())["features"]
    assert (out / "map.html").read_text("utf-8").count("<polyline") == 2


def test_an_empty_folder_is_named(tmp_path: Path) -> None:
    result = run("map", tmp_path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert tmp_path.name in result.output.replace("\n", "")


@pytest.mark.parametrize("option", ["--hash", "--jobs", "--scheduler", "--times"])
def test_the_help_has_the_options(option: str) -> None:
    assert option in run("map", "--help").stdout
