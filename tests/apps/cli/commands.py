"""Run commands in the test process, as from a terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from typer.testing import CliRunner, Result

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"})


def one_line(text: str) -> str:
    """Return the text of a message of one line, without a traceback."""
    (line,) = text.strip().splitlines()
    return line


def succeed(*arguments: object) -> Result:
    """Run a command that ends with exit code 0."""
    result = run(*arguments)
    assert result.exit_code == 0, result.stderr
    return result


def refusal(*arguments: object) -> str:
    """Return the error message of a command that prints one line and ends with exit code 2."""
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    line = one_line(result.stderr)
    assert line.startswith("error: ")
    return line


def copies(walk: Path, folder: Path, *names: str) -> Path:
    """Return a folder of the same recording with different names, and a broken file."""
    for name in names:
        replace(pdr.read(walk), name=name).save(folder / f"{name}.zip")
    (folder / "0.zip").write_bytes(b"no zip")
    return folder


def mark(walk: Path, fixes: str = "", settings: str = "") -> None:
    """Write marks of a recording."""
    folder = walk.parent / f"{walk.name}.marks"
    folder.mkdir(exist_ok=True)
    if fixes:
        (folder / "fixes.csv").write_text(fixes)
    if settings:
        (folder / "walk.json").write_text(settings)


def short_walk() -> pdr.Recording:
    """Simulated walk of half a minute around a square of 7 m, which is three times as fast to process as the demo."""
    legs = [pdr.simulate.Leg("walking", distance_m=7.0, turn_rad=turn) for turn in (0.0, *[np.pi / 2] * 3)]
    still = pdr.simulate.Leg("stationary", duration_s=4.0)
    return pdr.simulate.simulate([still, *legs], pdr.simulate.Gait(height_m=1.86), "pocket", name="short_walk")
