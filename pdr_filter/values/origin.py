"""Where on Earth a local frame of east and north lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Origin:
    """The place where east and north are zero, on WGS 84; north is true north there."""

    latitude_deg: float
    longitude_deg: float

    def __post_init__(self) -> None:
        if not (-90 <= self.latitude_deg <= 90 and -180 <= self.longitude_deg <= 180):
            raise ValueError(
                "origin must be (latitude, longitude) in degrees, -90..90 and -180..180, got "
                f"({self.latitude_deg}, {self.longitude_deg}); are the two exchanged, or in radians?"
            )

    def east_north_m(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> FloatArray:
        """Positions (..., 2) in the frame, in the plane that touches the ellipsoid at the origin."""
        here = (self.latitude_deg, self.longitude_deg, 0.0)
        east_m, north_m, _ = pymap3d.geodetic2enu(np.asarray(latitude_deg), np.asarray(longitude_deg), 0.0, *here)
        return np.stack([np.asarray(east_m, dtype=float), np.asarray(north_m, dtype=float)], axis=-1)

    def latitude_longitude_deg(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitudes and longitudes (...) of positions (..., 2) in the frame."""
        east_m, north_m = position_m[..., 0], position_m[..., 1]
        here = (self.latitude_deg, self.longitude_deg, 0.0)
        latitude_deg, longitude_deg, _ = pymap3d.enu2geodetic(east_m, north_m, np.zeros_like(east_m), *here)
        return np.asarray(latitude_deg, dtype=float), np.asarray(longitude_deg, dtype=float)
