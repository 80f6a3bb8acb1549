"""Runs the command as somebody would."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner, Result

import pdr_filter as pdr
from pdr_filter.cli.app import app
from pdr_filter.io.files.own_format import write_recording


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"})


def one_line(text: str) -> str:
    """The only line of a message; no traceback."""
    (line,) = text.strip().splitlines()
    return line


def demo_file(folder: Path) -> Path:
    """The simulated walk as a file."""
    return write_recording(pdr.simulate.demo_walk(), folder / "demo_walk.zip")
