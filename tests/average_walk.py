"""The demonstration walk of an average person, for tests that need a phone with usual errors."""

from __future__ import annotations

from pdr_filter.simulate import Gait, simulate
from pdr_filter.simulate.walk import demo_legs
from pdr_filter.values.recording import Recording


def average_walk() -> Recording:
    return simulate(demo_legs(0), Gait(height_m=1.86), "pocket", seed=0, name="demo_walk")
