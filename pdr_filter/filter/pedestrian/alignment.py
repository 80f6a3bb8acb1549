"""Alignment of a track with another frame by a shift and a rotation.

The filter is linear in a rotation that is known to some degrees. An unknown rotation is a density over all angles
(`filter.pedestrian.frame_rotation`). `filter.pedestrian.frame` decides between the two.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.values import FloatArray, read_only

EYE = read_only(np.eye(2))


def rotated_cov(cov: FloatArray, twice: complex) -> FloatArray:
    """Return the mean of R P R' over an uncertain rotation R, for a covariance P (2, 2).

    R rotates clockwise by an angle, and `twice` is the mean of e^(-2 i angle) over the distribution of this angle. Let
    P = ((xx, xy), (xy, yy)), with x east and y north. A rotation keeps (xx + yy) / 2 and multiplies (xx - yy) / 2 + i
    xy by e^(-2 i angle). The mean follows with `twice` as the factor.
    """
    (xx, xy), (_, yy) = cov.tolist()
    size, shape = 0.5 * (xx + yy), complex(0.5 * (xx - yy), xy) * twice
    return np.array([[size + shape.real, shape.imag], [shape.imag, size - shape.real]])


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Position and walking heading in some frame."""

    position_m: FloatArray  # (2,) position (east, north)
    cov_m2: FloatArray  # (2, 2) covariance of the position
    heading_rad: float  # walking heading, clockwise from the north axis of the frame
    n_steps: int  # index of the step that led to the pose, from 0 for the first step


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Transformation world = R (track - track_centre) + world_centre, with a clockwise rotation R.

    The transformation leads from a frame of the track ("track") to another frame ("world"), which is usually the frame
    of the fixes.
    """

    angle_rad: float  # angle of R
    angle_var_rad2: float  # variance of the angle
    track_centre_m: FloatArray  # (2,) centre of rotation in the track frame
    world_centre_m: FloatArray  # (2,) centre of rotation in the world frame
    centre_var_m2: float  # variance of the centre along each axis
    # Number of steps when the alignment was estimated. The alignment transforms steps with the indices k for which
    # `since` <= k < `n_steps`. Steps from `n_steps` on are reported in the world frame.
    n_steps: int
    # Index of the first step in the track frame of this alignment. Steps before it were reported in an earlier frame.
    since: int = 0

    def applies_to(self, pose: Pose) -> bool:
        """Return True if the track frame of this alignment is the frame in which a pose was estimated.

        A pose is a position with a heading. The frame is in use from step `since` until step `n_steps`.
        """
        return self.since <= pose.n_steps < self.n_steps

    @property
    def rotation(self) -> FloatArray:
        """Rotation matrix R (2, 2) for columns (east, north). It adds the angle to headings."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.array([[c, s], [-s, c]])

    def positions(self, track_m: FloatArray) -> FloatArray:
        """Return positions (..., 2) of the track frame transformed to the world frame."""
        return (track_m - self.track_centre_m) @ self.rotation.T + self.world_centre_m

    def world(self, pose: Pose) -> Pose:
        """Return a pose of the track frame transformed to the world frame, with the uncertainty of the alignment."""
        position_m = self.positions(pose.position_m)
        east_m, north_m = (position_m - self.world_centre_m).tolist()
        spread = self.angle_var_rad2 * np.array([[north_m**2, -north_m * east_m], [-north_m * east_m, east_m**2]])
        cov = rotated_cov(pose.cov_m2, cmath.exp(-2j * self.angle_rad)) + spread + self.centre_var_m2 * EYE
        return Pose(position_m, cov, pose.heading_rad + self.angle_rad, pose.n_steps)


def walked_var_m2(cov: FloatArray) -> float:
    """Return the variance of the position given the heading offset, in m2, as mean of the variances east and north.

    `cov` (4, 4) is the covariance of the filter state (east, north, heading offset, log scale). The part of the
    position variance that is due to an error of the heading offset is subtracted.
    """
    # a heading that is known exactly has variance zero
    of_heading, heading_var = cov[:2, HEADING_OFFSET], max(float(cov[HEADING_OFFSET, HEADING_OFFSET]), 1e-12)
    return 0.5 * float(np.trace(cov[:2, :2]) - of_heading @ of_heading / heading_var)


def transformed_estimates(mean: FloatArray, cov: FloatArray, alignment: Alignment) -> tuple[FloatArray, FloatArray]:
    """Return the means (M, n) and covariances (M, n, n) of M filters transformed by an alignment, with its uncertainty.

    For the position, P becomes T P T' + var(a) g g' + var(centre). T is the rotation of the position, a the rotation
    angle, g the derivative of the state with respect to a, and var(centre) the variance of the aligned centre. The
    angle is added to the heading offset of the state.
    """
    T = np.eye(mean.shape[1])
    T[:2, :2] = alignment.rotation
    turned = mean.copy()
    turned[:, :2] = alignment.positions(mean[:, :2])
    turned[:, HEADING_OFFSET] += alignment.angle_rad
    g = np.zeros_like(mean)
    lever = turned[:, :2] - alignment.world_centre_m
    g[:, 0], g[:, 1], g[:, HEADING_OFFSET] = lever[:, 1], -lever[:, 0], 1.0
    grown = T @ cov @ T.T + alignment.angle_var_rad2 * g[:, :, None] * g[:, None, :]
    grown[:, :2, :2] += alignment.centre_var_m2 * np.eye(2)
    return turned, grown
