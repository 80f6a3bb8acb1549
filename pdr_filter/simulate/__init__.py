"""Simulated walks with exact ground truth: a simulated person carries a simulated phone.

They are for tests and demonstrations that need exact ground truth. The motion of the phone is based on measurements.
The harmonics of strides, their variation between people and from stride to stride were measured on public recordings:
walking with the phone in five places, and stairs and running in the trouser pocket (`strides`). Step length, cadence
and force of the steps are related as in the data. Other motions are derived from the measured ones: stairs with the
phone in the hand, running with the phone at the ear, sideways walking.

The shipped models recognise contexts of simulated people as well as those of real people. docs/benchmarks.md says how
well a classifier can distinguish simulated from real windows. Accuracy on simulated walks must not be reported as
accuracy on real ones.
"""

from pdr_filter.simulate.gait import Gait, Leg
from pdr_filter.simulate.motion import Carrying, Motion
from pdr_filter.simulate.sensors import BAROMETER, SensorError, SensorErrors
from pdr_filter.simulate.walk import demo_walk, phone_motion, simulate

__all__ = [
    "BAROMETER",
    "Carrying",
    "Gait",
    "Leg",
    "Motion",
    "SensorError",
    "SensorErrors",
    "demo_walk",
    "phone_motion",
    "simulate",
]


def __dir__() -> list[str]:
    return __all__
