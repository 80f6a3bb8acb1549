"""pdr_filter itself, with its default recipe, on the whole recording."""

from __future__ import annotations

import pdr_filter as pdr

from .walks import Found, Method, Walk, of_steps


def _track(walk: Walk) -> Found:
    track = pdr.track(walk.recording)
    return of_steps(track.time_s, track.steps.duration_s, track.step_length_m)


def _smoothed_speed(walk: Walk) -> Found:
    track = pdr.track(walk.recording)
    duration_s = track.steps.duration_s
    return of_steps(track.time_s, duration_s, track.smoothed_speed_mps * duration_s)


def _detect_steps(walk: Walk) -> Found:
    return Found(pdr.detect_steps(walk.recording).time_s)


METHODS = (
    Method("pdr_filter, detect_steps", "pdr_filter", lambda: _detect_steps),
    Method("pdr_filter, track, length of each step", "pdr_filter", lambda: _track, own_steps=False),
    Method("pdr_filter, track, smoothed speed", "pdr_filter", lambda: _smoothed_speed, own_steps=False),
)
