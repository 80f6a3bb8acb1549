"""Where on Earth a local frame of east and north lies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray

# Of the declination from the model, because a recording need not know its date: in ten years it changes by less than
# 0.75 degrees on half of the Earth, by less than 1.9 on nine tenths of it.
DECLINATION_STD_RAD = math.radians(1.0)
# The models of the library.
_FIRST_YEAR, _LAST_YEAR = 2010.0, 2029.99


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

    def declination_rad(self, year: float = 2025.0) -> float:
        """By how much magnetic north is east of true north here, on the ground: World Magnetic Model.

        `year` may have a fraction; the models are of 2010 to 2029, and before and after the nearest counts.
        """
        import pygeomag  # for those who ask

        year = min(max(year, _FIRST_YEAR), _LAST_YEAR)
        model = pygeomag.GeoMag(base_year=year)  # pyright: ignore[reportArgumentType]  (a number is its own example)
        return math.radians(model.calculate(glat=self.latitude_deg, glon=self.longitude_deg, alt=0.0, time=year).d)

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
