"""Where on Earth a local frame of east and north lies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.checks import are_numbers, check_array

# Of the declination from the model, because a recording need not know its date: in ten years it changes by less than
# 0.75 degrees on half of the Earth, by less than 1.9 on nine tenths of it.
DECLINATION_STD_RAD = math.radians(1.0)
# The models of the library.
_FIRST_YEAR, _LAST_YEAR = 2010.0, 2029.99


def check_place(what: str, latitude_deg: float, longitude_deg: float) -> None:
    """ValueError unless it is a place on Earth."""
    if not (are_numbers(latitude_deg, longitude_deg) and -90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        raise ValueError(
            f"{what} must be (latitude, longitude) in degrees, -90..90 and -180..180, got ({latitude_deg!r}, "
            f"{longitude_deg!r}); are the two exchanged?"
        )


@dataclass(frozen=True, slots=True)
class Origin:
    """The place where east and north are zero, on WGS 84; north is true north there.

    A track that was put there knows how: `turn_rad` is the true heading of the first heading, by which the frame of its
    start was turned, and the standard deviations say how well turn and shift were known then. `Track.placed` takes them
    from an origin that is given.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> origin = pdr.Origin(48.137, 11.575)
    >>> origin.east_north_m(48.138, 11.576).round()
    array([ 74., 111.])
    """

    latitude_deg: float
    longitude_deg: float
    # Where heights are zero; from locations as the phone counts, above the ellipsoid (Android) or the sea (iOS).
    height_m: float | None = None
    turn_rad: float | None = None  # of the frame of the start, clockwise; None if not known
    turn_std_rad: float | None = None  # None if nobody said it
    position_std_m: float | None = None  # of the shift along each axis; None if nobody said it
    height_std_m: float | None = None  # None if nobody said it

    def __post_init__(self) -> None:
        check_place("origin", self.latitude_deg, self.longitude_deg)
        for name in ("height_m", "turn_rad", "turn_std_rad", "position_std_m", "height_std_m"):
            if getattr(self, name) is not None:
                kind = "0 or more" if "_std_" in name else "finite"
                check_array(f"{name} of an origin", getattr(self, name), kind, (), "leave it out if it is not known")
        if self.turn_std_rad is not None and self.turn_rad is None:
            raise ValueError(f"turn_std_rad of an origin is that of turn_rad, got {self.turn_std_rad} alone: give both")

    @classmethod
    def of(cls, place: Origin | tuple[float, float]) -> Origin:
        """The origin that is given, or the one at (latitude_deg, longitude_deg)."""
        if isinstance(place, Origin):
            return place
        try:
            latitude_deg, longitude_deg = (float(number) for number in place)
        except (TypeError, ValueError):
            words = f"origin must be an Origin, or (latitude, longitude) in degrees, got {place!r}"
            raise ValueError(words) from None
        return cls(latitude_deg, longitude_deg)

    @property
    def _here(self) -> tuple[float, float, float]:
        """Latitude, longitude and height: at 1,000 m above the ellipsoid a metre is 0.02 % fewer degrees."""
        return self.latitude_deg, self.longitude_deg, self.height_m or 0.0

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
        # Only when called: `pdr-filter --help` imports values.
        import pymap3d

        latitude, longitude = np.asarray(latitude_deg), np.asarray(longitude_deg)
        east_m, north_m, _ = pymap3d.geodetic2enu(latitude, longitude, self._here[2], *self._here)
        return np.stack([np.asarray(east_m, dtype=float), np.asarray(north_m, dtype=float)], axis=-1)

    def latitude_longitude_deg(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitudes and longitudes (...) of positions (..., 2) in the frame."""
        import pymap3d

        east_m, north_m = position_m[..., 0], position_m[..., 1]
        latitude_deg, longitude_deg, _ = pymap3d.enu2geodetic(east_m, north_m, np.zeros_like(east_m), *self._here)
        return np.asarray(latitude_deg, dtype=float), np.asarray(longitude_deg, dtype=float)
