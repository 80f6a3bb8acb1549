"""A shift and a turn: how a track goes over from the frame in which it starts to another one.

The filter is linear in a turn that is known to some degrees. One that is not is a density over all turns
(`filter.fixes.frame_rotation`); which of the two it is, `filter.fixes.frame` knows.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.values import FloatArray, read_only

EYE = read_only(np.eye(2))


def turned_cov(cov: FloatArray, twice: complex) -> FloatArray:
    """The mean of R P R' over turns, of a covariance (2, 2) and the mean of e^(-2 i angle).

    The half trace stays, and (xx - yy) / 2 + i xy turns back by twice the angle.
    """
    (xx, xy), (_, yy) = cov.tolist()
    size, shape = 0.5 * (xx + yy), complex(0.5 * (xx - yy), xy) * twice
    return np.array([[size + shape.real, shape.imag], [shape.imag, size - shape.real]])


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where somebody is and which way he walks, in some frame."""

    position_m: FloatArray  # (2,)
    cov_m2: FloatArray  # (2, 2)
    heading_rad: float
    n_steps: int  # number of the step that led there


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """World = R (track - track_centre) + world_centre, R clockwise by an angle."""

    angle_rad: float
    angle_var_rad2: float
    track_centre_m: FloatArray  # (2,)
    world_centre_m: FloatArray  # (2,)
    centre_var_m2: float
    n_steps: int  # steps that were reported before
    since: int = 0  # of these, the first that was reported in the frame that it turns; all are in the world before

    def turns(self, place: Place) -> bool:
        """Whether a place was reported in the frame that it turns."""
        return self.since <= place.n_steps < self.n_steps

    @property
    def rotation(self) -> FloatArray:
        """R, (2, 2), for columns east, north: headings grow by the angle."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.array([[c, s], [-s, c]])

    def positions(self, track_m: FloatArray) -> FloatArray:
        """Positions (..., 2) in the world."""
        return (track_m - self.track_centre_m) @ self.rotation.T + self.world_centre_m

    def world(self, place: Place) -> Place:
        """A place in the world."""
        position_m = self.positions(place.position_m)
        east_m, north_m = (position_m - self.world_centre_m).tolist()
        spread = self.angle_var_rad2 * np.array([[north_m**2, -north_m * east_m], [-north_m * east_m, east_m**2]])
        cov = turned_cov(place.cov_m2, cmath.exp(-2j * self.angle_rad)) + spread + self.centre_var_m2 * EYE
        return Place(position_m, cov, place.heading_rad + self.angle_rad, place.n_steps)


def walked_var_m2(cov: FloatArray) -> float:
    """Variance of a position with covariance (4, 4) that its heading does not explain, mean of both axes."""
    # a heading that is known exactly divides nothing
    of_heading, heading_var = cov[:2, HEADING_OFFSET], max(float(cov[HEADING_OFFSET, HEADING_OFFSET]), 1e-12)
    return 0.5 * float(np.trace(cov[:2, :2]) - of_heading @ of_heading / heading_var)


def moved(mean: FloatArray, cov: FloatArray, alignment: Alignment) -> tuple[FloatArray, FloatArray]:
    """Means (M, n) and covariances (M, n, n) in the world, with what is unsure about the alignment.

    P = T P T' + var(a) g g' + var(centre) on the position, with T the rotation of the position and g the derivative of
    the state with respect to the angle.
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
