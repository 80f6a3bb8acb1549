"""Walks with exact truth: a simulated person carries a simulated phone.

For tests and for the demonstration, where the truth has to be known exactly. The signals resemble real ones: medians
over 2 s windows of the standard deviation and main frequency of |specific force|, and of the mean and standard
deviation of |angular rate|, are within 30 % of those of public recordings of hand-held walking and, with the phone in
the pocket, of walking, stairs, running and standing. Other pairs of context and carrying mode are plausible, not
fitted, and real people are less regular. Never quote accuracy measured on simulated walks as accuracy.
"""

from pdr_filter.simulate.gait import Gait, Leg
from pdr_filter.simulate.motion import Carrying, Motion
from pdr_filter.simulate.sensors import SensorError, SensorErrors
from pdr_filter.simulate.walk import demo_walk, phone_motion, simulate

__all__ = ["Carrying", "Gait", "Leg", "Motion", "SensorError", "SensorErrors", "demo_walk", "phone_motion", "simulate"]
