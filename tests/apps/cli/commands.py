"""Run commands in the test process, as from a terminal."""

from __future__ import annotations

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


def short_walk() -> pdr.Recording:
    """Simulated walk of half a minute around a square of 7 m, which is three times as fast to process as the demo."""
    legs = [pdr.simulate.Leg("walking", distance_m=7.0, turn_rad=turn) for turn in (0.0, *[np.pi / 2] * 3)]
    still = pdr.simulate.Leg("stationary", duration_s=4.0)
    return pdr.simulate.simulate([still, *legs], pdr.simulate.Gait(height_m=1.86), "pocket", name="short_walk")
