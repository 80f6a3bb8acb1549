"""Plans are drawn below the track, and the command prints a summary of a plan."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up import FEATURES, feature, line, round_the_block, write
from matplotlib.collections import PathCollection
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.apps.report.html import html_report
from pdr_filter.data.io.files.own_format import write_recording


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    wall = feature("wall", line((20, -1.2), (20, 0.0)))
    return write(tmp_path_factory.mktemp("plan") / "storey.geojson", [*FEATURES, wall])


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"})
    assert result.exit_code == 0, result.output
    return result.stdout


def plan_of(page: str) -> list[dict[str, Any]]:
    """Return the shapes that the page of a track draws."""
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', page)
    return json.loads(found[1])["tracks"][0]["plan"]


def test_plot_and_report_draw_the_plan_below_the_track(plan_file: Path) -> None:
    plan = pdr.FloorPlan.read(plan_file)
    start = pdr.PositionFix(0.0, [0.0, 0.0], np.eye(2))
    track = pdr.track(round_the_block(), plan=plan, start=start)
    drawn = [c for c in track.plot().axes[0].collections if isinstance(c, PathCollection)]
    assert sum(len(c.get_paths()) for c in drawn) == 3  # the outline and two rooms
    assert min(c.get_zorder() for c in drawn) < 1
    rings = [len(shape["rings"]) for shape in plan_of(html_report(track))]
    assert rings == [
        len(f.lines) for kind in ("floor", "room", "wall") for f in plan.storeys[0].features if f.kind == kind
    ]
    assert plan_of(html_report(pdr.track(round_the_block()))) == []


def test_the_picture_of_a_plan_names_its_rooms(plan_file: Path, tmp_path: Path) -> None:
    figure = pdr.plot.plan(pdr.FloorPlan.read(plan_file), tmp_path / "plan.png")
    assert {"block", "west"} <= {text.get_text() for text in figure.axes[0].texts}
    assert (tmp_path / "plan.png").stat().st_size > 1000


def test_the_command_prints_a_summary_of_a_plan(plan_file: Path, tmp_path: Path) -> None:
    text = run("plan", plan_file, "--out", tmp_path)
    assert "42.4 m" in text and "2 room" in text and "drawn" in text
    assert (tmp_path / "storey.png").exists()
    assert json.loads(run("plan", plan_file, "--json"))["storeys"][0]["features"] == {"floor": 1, "room": 2, "wall": 1}


def test_the_command_tracks_and_smooths_on_a_plan(plan_file: Path, tmp_path: Path) -> None:
    walk = write_recording(round_the_block(), tmp_path / "walk.zip")
    assert json.loads(run("track", walk, "--plan", plan_file, "--start", "0,0", "--json"))["frame"] == "plan"
    assert "1 storeys" not in run("smooth", walk, "--plan", plan_file, "--start", "0,0")
    refused = CliRunner().invoke(app, ["track", str(walk), "--start", "0,0"])
    assert refused.exit_code == 2
