"""Motion of particles over a step: the particle columns, rotations, and the update of the heading offset."""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState
from pdr_filter.filter.pedestrian.step_history import TRAIL_STEPS
from pdr_filter.values import FloatArray, IntArray, Step, wrap_angle

# Columns of a particle: position, heading offset, log scale, rotation of the track frame, recent crossing cost.
EAST, NORTH, OFFSET, SCALE, TURN, CROSSED = range(6)


N_COLUMNS = 6


def extended_path(path: FloatArray, step: Step, length_m: float) -> FloatArray:
    """Return the last rows of a path (R, 4), extended by a step of `length_m` in the direction of the device."""
    heading_rad = step.reference_heading_rad
    last = path[-1, 1:3] if len(path) else np.zeros(2)
    to = last + length_m * np.array([math.sin(heading_rad), math.cos(heading_rad)])
    return np.concatenate([path, [[step.time_s, *to, heading_rad]]])[-TRAIL_STEPS:]


def earlier_positions(particles: FloatArray, since_m: FloatArray) -> FloatArray:
    """Return the positions (N, 2) of particles (N, 6) before a displacement (2,) in the direction of the device.

    The displacement is rotated and scaled by the heading offset and the scale of each particle.
    """
    return particles[:, :2] - np.exp(particles[:, [SCALE]]) * rotated_vectors(since_m[None], particles[:, OFFSET])


def rotated_vectors(vector_m: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return vectors (N, 2), east and north, rotated clockwise by angles (N,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    east, north = vector_m.T
    return np.column_stack([c * east + s * north, c * north - s * east])


def advance_offsets(
    x: FloatArray,
    step: Step,
    pedestrian: PedestrianState,
    model: PedestrianModel,
    since_s: float,
    mode: IntArray,
    z: FloatArray,
) -> FloatArray:
    """Move the heading offsets of N particles over a step, in place, and return log weights (N,).

    The offset o of a particle is its walking heading minus the device heading. The offset is a random walk, o_k =
    o_{k-1} + N(0, q). The walking heading minus the device heading of the step is its measurement, v = o_k + N(0, r).
    The variances q and r are in rad2. The new offset o_k is drawn from its distribution given v, and the weight is the
    likelihood of v given o_{k-1}, N(o_{k-1}, q + r). `x` are the particles (N, 6), `mode` (N,) their modes, and `z`
    (N,) standard normal numbers.
    """
    measured, unmeasured = model.noise.heading_drift.variances_rad2(
        since_s, step.heading_unknown_s, step.yaw_bias_std_radps, model.directions.drift_rad2_per_s
    )
    q = np.minimum((measured + unmeasured + step.offset_change_std_rad**2)[mode], MAX_HEADING_VARIANCE)
    r, log_weight = step.walking_heading_std_rad**2, np.zeros(len(x))
    if np.isfinite(r) and not step.states_heading and step.time_s > pedestrian.heading_zero.time_s:
        shown = step.walking_heading_rad - step.device_heading_rad - pedestrian.heading_zero.offset_rad + x[:, TURN]
        v = wrap_angle(shown - x[:, OFFSET])
        gain = q / np.maximum(q + r, 1e-12)
        log_weight = -0.5 * (v**2 / np.maximum(q + r, 1e-12) + np.log(np.maximum(q + r, 1e-12)))
        x[:, OFFSET] += gain * v
        q = (1.0 - gain) * q
    x[:, OFFSET] += np.sqrt(q) * z
    return log_weight
