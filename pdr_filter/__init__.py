"""Pedestrian dead reckoning: a phone's inertial samples in, a track with honest uncertainty out."""

__version__ = "0.1.0"
