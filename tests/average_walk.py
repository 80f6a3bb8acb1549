"""The demonstration walk of an average person along right angles, for tests that need a phone with usual errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdr_filter.simulate import Gait, simulate
from pdr_filter.simulate.walk import demo_legs
from pdr_filter.values.recording import Recording


def average_walk() -> Recording:
    right = np.pi / 2
    legs = [replace(leg, turn_rad=right * round(leg.turn_rad / right)) for leg in demo_legs(0)]
    return simulate(legs, Gait(height_m=1.86), "pocket", seed=0, name="demo_walk")
