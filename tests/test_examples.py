from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pdr_filter.simulate import Leg, simulate

EXAMPLES = sorted((Path(__file__).parents[1] / "docs" / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_runs_draws_and_is_short(path: Path, tmp_path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 40
    command = [sys.executable, path]
    if path.stem == "live_track":  # with a shorter walk than its own, because it draws each half second
        legs = [Leg("walking", distance_m=d, turn_rad=1.5) for d in (50.0, 30.0)]
        command.append(simulate(legs).save(tmp_path / "walk.zip"))
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"{path.stem}.png").read_bytes().startswith(b"\x89PNG")
    if path.stem == "gnss_then_indoors":
        found = re.search(r"^([\d.]+) m from the truth, (\d+) s after", done.stdout, re.MULTILINE)
        assert float(found[1]) < 10.0
        assert int(found[2]) > 40
    else:
        assert re.search(r"^\d{3} steps, end at", done.stdout, re.MULTILINE)


def test_there_are_examples() -> None:
    assert {path.stem for path in EXAMPLES} == {"gnss_then_indoors", "live_track"}
