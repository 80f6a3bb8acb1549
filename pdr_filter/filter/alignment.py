"""From the frame in which a track starts to the frame of its position fixes: a rotation and a shift, found once.

Dead reckoning knows neither where it starts nor which way is north. Fixes show both as soon as the walk between them is
long against their errors: the rotation and shift that bring the track to the fixes best (W. Kabsch, "A solution for the
best rotation to relate two sets of vectors", Acta Cryst. A32, 1976, in the plane).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.filter.motion import HEADING_OFFSET
from pdr_filter.values import FloatArray, read_only

# The rotation is taken when it is known to 15 degrees (one standard deviation): the filter refines it linearly.
MAX_ANGLE_STD_RAD = 0.26
# Fixes that are remembered for it; of more, the first and the last ones.
MAX_PAIRS = 24
# Errors of dead reckoning itself, as a part of the distance between two fixes.
_DRIFT = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class PairedPoint:
    """A fix, and where the track was at its time."""

    track_m: FloatArray  # (2,)
    world_m: FloatArray  # (2,)
    var_m2: float  # of the fix, mean of both axes


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """World = R (track - track_centre) + world_centre, R clockwise by an angle."""

    angle_rad: float
    angle_var_rad2: float
    track_centre_m: FloatArray  # (2,)
    world_centre_m: FloatArray  # (2,)
    centre_var_m2: float
    n_steps: int  # steps that were reported in the frame of the start

    @property
    def rotation(self) -> FloatArray:
        """R, (2, 2), for columns east, north: headings grow by the angle."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.array([[c, s], [-s, c]])

    def positions(self, track_m: FloatArray) -> FloatArray:
        """Positions (..., 2) in the world."""
        return (track_m - self.track_centre_m) @ self.rotation.T + self.world_centre_m


def align(pairs: Sequence[PairedPoint], n_steps: int) -> Alignment | None:
    """The alignment that the pairs show, or None while they leave the angle open.

    With weights w and centred places l in the track and d in the world, a = atan2(sum w (d_e l_n - d_n l_e),
    sum w d . l), and var a = 1 / sum w l . l.
    """
    if len(pairs) < 2:
        return None
    track, world = np.stack([a.track_m for a in pairs]), np.stack([a.world_m for a in pairs])
    reach = np.linalg.norm(track - track.mean(axis=0), axis=1)
    weight = 1.0 / (np.array([a.var_m2 for a in pairs]) + (_DRIFT * reach) ** 2)
    track_centre, world_centre = weight @ track / weight.sum(), weight @ world / weight.sum()
    l, d = track - track_centre, world - world_centre
    spread = float(weight @ (l * l).sum(axis=1))
    if spread * MAX_ANGLE_STD_RAD**2 < 1.0:
        return None
    cross = weight @ (d[:, 0] * l[:, 1] - d[:, 1] * l[:, 0])
    along = weight @ (d * l).sum(axis=1)
    angle_rad = float(np.arctan2(cross, along))
    return Alignment(angle_rad, 1.0 / spread, track_centre, world_centre, float(1.0 / weight.sum()), n_steps)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Whether positions are in the frame of the fixes, and what is known of how to bring them there."""

    is_joined: bool
    pairs: tuple[PairedPoint, ...] = ()  # fixes that wait for the alignment
    alignment: Alignment | None = None  # how the frame of the start became that of the fixes
    knows_north: bool = False  # a heading fix has turned the frame

    def with_pair(self, pair: PairedPoint) -> Frame:
        """With one more pair: the first of them and the latest are kept."""
        pairs = self.pairs[:1] + (*self.pairs[1:], pair)[-(MAX_PAIRS - 1) :] if self.pairs else (pair,)
        return replace(self, pairs=pairs)

    def moved(self, alignment: Alignment) -> Frame:
        """With the places of the track moved."""
        pairs = tuple(replace(p, track_m=read_only(alignment.positions(p.track_m))) for p in self.pairs)
        return replace(self, pairs=pairs)


START_FRAME = Frame(is_joined=True)
UNKNOWN_FRAME = Frame(is_joined=False)


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
