"""True positions of simulated walks, and observations with known errors that are made from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

import pdr_filter as pdr
from pdr_filter.values import FloatArray, Samples

HERE = pdr.Origin(48.137, 11.575)


def true_m(walk: pdr.Recording, time_s: ArrayLike) -> FloatArray:
    """Return the true positions (N, 2) at some times, or the position (2,) at one time."""
    truth = walk.truth.position
    return np.stack([np.interp(time_s, truth.time_s, truth[axis]) for axis in ("east_m", "north_m")], axis=-1)


def errors_m(track: pdr.Track, walk: pdr.Recording) -> FloatArray:
    """Return the distance of each step from the true position."""
    return np.linalg.norm(track.position_m - true_m(walk, track.time_s), axis=1)


def position_fixes(time_s: Sequence[float] | FloatArray, place_m: FloatArray, std_m: float) -> list[pdr.PositionFix]:
    """Return fixes with equal and independent errors of both axes."""
    return [pdr.PositionFix(float(t), p, std_m**2 * np.eye(2)) for t, p in zip(time_s, place_m, strict=True)]


def located(
    walk: pdr.Recording, time_s: FloatArray, origin: pdr.Origin = HERE, accuracy_m: float = 5.0, off_m: ArrayLike = 0.0
) -> pdr.Recording:
    """Return a walk with locations at some times, with errors `off_m` that broadcast to (N, 2)."""
    latitude_deg, longitude_deg = origin.latitude_longitude_deg(true_m(walk, time_s) + np.asarray(off_m))
    values = np.column_stack([latitude_deg, longitude_deg, np.full((len(time_s), 2), [520.0, accuracy_m])])
    return replace(walk, location=Samples(time_s, values))
