"""Walks with exact truth: a simulated person carries a simulated phone.

For tests and for the demonstration, where the truth has to be known exactly. Phones move as they do with people: the
harmonics of a stride, how they differ between people and from stride to stride were measured on public recordings of
walking in five places of the phone and, in the trouser pocket, of stairs and running (`strides`). Step length, cadence
and the force of the steps go together as in the data. What was not measured is made of what was: stairs with the phone
in the hand, running at the ear, walking sideways. The shipped models tell the contexts of simulated people as they do
those of real ones; how far a classifier can tell simulated windows from real ones is in docs/benchmarks.md.
Never quote accuracy measured on simulated walks as accuracy.
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
