"""Every fault of a sensor is within the stated deviation, or a note names the sensor."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.simulate import Leg
from pdr_filter.tracking.track import Track
from tests.benchmarks.sensor_faults import FAULTS, NOISE, WORDS, Figures, Walk, figures, simulated_walk, with_fault

CASES = [(sensor, fault) for sensor in NOISE for fault in FAULTS if (sensor, fault) != ("accelerometer", "missing")]
LEGS = [
    Leg("stationary", duration_s=5.0),
    Leg("walking", distance_m=15.0),
    Leg("upstairs", distance_m=5.22),
    Leg("walking", distance_m=15.0, turn_rad=np.pi / 2),
    Leg("stationary", duration_s=3.0),
]


@cache
def walk() -> Walk:
    return simulated_walk(4, "pocket", LEGS)


@cache
def without_fault(sensor: str) -> Track:
    return pdr.track(walk().recording, **walk().options(sensor))


def is_covered(found: Figures) -> bool:
    """Return True if position and height are within three deviations, and no large part of the walk is missing.

    The steps of the simulated person are up to 15 % longer or shorter than expected.
    """
    return found.nees < 11.8 and abs(found.height_m) < 3.0 * found.height_std_m and abs(found.distance_percent) < 25.0


@pytest.mark.parametrize(("sensor", "fault"), CASES)
def test_a_fault_is_within_the_deviations_or_a_note_names_the_sensor(sensor: str, fault: str) -> None:
    recording, options = with_fault(walk().recording, sensor, fault), walk().options(sensor)
    if fault == "missing" and sensor in ("magnetometer", "location"):
        with pytest.raises(pdr.MissingSensorError, match=sensor):
            pdr.track(recording, **options)
        return
    track = pdr.track(recording, **options)
    found = figures(walk(), track, without_fault(sensor), sensor)
    named = any(word in note for note in found.notes for word in WORDS[sensor])
    assert named or is_covered(found), (found, track.notes)
