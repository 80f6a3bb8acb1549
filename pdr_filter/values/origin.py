"""Geographic origin of a local frame of east and north."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.checks import are_numbers, check_array

if TYPE_CHECKING:
    from pygeomag.geomag import GeoMagResult

# Standard deviation of the declination from the model. The date of a recording may be unknown, and in ten years the
# declination changes by less than 0.75 degrees on half of the Earth, and by less than 1.9 degrees on 90 % of it.
DECLINATION_STD_RAD = math.radians(1.0)
# Years covered by the models of the library.
_FIRST_YEAR, _LAST_YEAR = 2010.0, 2029.99


def check_coordinates(what: str, latitude_deg: float, longitude_deg: float) -> None:
    """Raise ValueError unless latitude and longitude are valid. `what` is the name of the argument in the message."""
    if not (are_numbers(latitude_deg, longitude_deg) and -90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        raise ValueError(
            f"{what} must be (latitude, longitude) in degrees, -90..90 and -180..180, got ({latitude_deg!r}, "
            f"{longitude_deg!r}): check the order of the two"
        )


@dataclass(frozen=True, slots=True)
class Origin:
    """Geographic position (WGS 84) of the origin of a local frame, in which north is true north.

    The origin of a track also contains the rotation of its frame, and the accuracy of rotation and shift.
    `Track.placed` uses these fields of a given origin.

    Attributes
    ----------
    latitude_deg, longitude_deg : float
        WGS 84 coordinates, degrees.
    height_m : float, optional
        Altitude of the zero of heights, m. From locations of a phone it is above the ellipsoid (Android) or the sea
        (iOS).
    turn_rad : float, optional
        True heading of the first heading of the track, rad, clockwise: the angle by which the frame of the start was
        rotated.
    turn_std_rad : float, optional
        Standard deviation of `turn_rad`, rad. None if unknown.
    position_std_m : float, optional
        Standard deviation of the position along each axis, m. None if unknown.
    height_std_m : float, optional
        Standard deviation of `height_m`, m. None if unknown.

    Raises
    ------
    ValueError
        If coordinates are invalid, or `turn_std_rad` is given without `turn_rad`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> origin = pdr.Origin(48.137, 11.575)
    >>> origin.east_north_m(48.138, 11.576).round()
    array([ 74., 111.])
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float | None = None
    turn_rad: float | None = None
    turn_std_rad: float | None = None
    position_std_m: float | None = None
    height_std_m: float | None = None

    def __post_init__(self) -> None:
        check_coordinates("origin", self.latitude_deg, self.longitude_deg)
        for name in ("height_m", "turn_rad", "turn_std_rad", "position_std_m", "height_std_m"):
            if getattr(self, name) is not None:
                kind = "0 or more" if "_std_" in name else "finite"
                check_array(f"{name} of an origin", getattr(self, name), kind, (), "leave it out if it is not known")
        if self.turn_std_rad is not None and self.turn_rad is None:
            raise ValueError(f"turn_std_rad of an origin requires turn_rad, got {self.turn_std_rad} alone: give both")

    @classmethod
    def of(cls, place: Origin | tuple[float, float]) -> Origin:
        """Return an origin unchanged, or create one from coordinates.

        Parameters
        ----------
        place : Origin or (latitude_deg, longitude_deg)
            Origin, or its coordinates in degrees.

        Returns
        -------
        Origin
            The origin.

        Raises
        ------
        ValueError
            If `place` is neither of them.
        """
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
        """Latitude, longitude and height: at 1,000 m, a metre is 0.02 % less in degrees than on the ellipsoid."""
        return self.latitude_deg, self.longitude_deg, self.height_m or 0.0

    def declination_rad(self, year: float = 2025.0) -> float:
        """Return the magnetic declination on the ground: the clockwise angle from true north to magnetic north.

        Parameters
        ----------
        year : float, default 2025.0
            Year with fraction. Years before 2010 or after 2029 are replaced by the nearest year of the models.

        Returns
        -------
        float
            Declination, rad.

        Notes
        -----
        World Magnetic Model, from the package pygeomag.
        """
        return math.radians(self._magnetic_model(year).d)

    def magnetic_field_ut(self, year: float = 2025.0) -> tuple[float, float]:
        """Return the magnetic field of the Earth on the ground: its horizontal and its upward component.

        Parameters
        ----------
        year : float, default 2025.0
            Year with fraction, as for `declination_rad`.

        Returns
        -------
        (float, float)
            Horizontal and upward component, uT. The upward one is negative in most of the northern hemisphere.

        Notes
        -----
        World Magnetic Model, from the package pygeomag.
        """
        result = self._magnetic_model(year)
        return 1e-3 * result.h, -1e-3 * result.z

    def _magnetic_model(self, year: float) -> GeoMagResult:
        """Return the World Magnetic Model at the origin, in degrees and nanotesla."""
        import pygeomag  # imported late, because few users need it

        year = min(max(year, _FIRST_YEAR), _LAST_YEAR)
        model = pygeomag.GeoMag(base_year=year)  # pyright: ignore[reportArgumentType]  (a number is its own example)
        return model.calculate(glat=self.latitude_deg, glon=self.longitude_deg, alt=0.0, time=year)

    def east_north_m(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> FloatArray:
        """Convert geographic coordinates to east and north, in the plane tangent to the ellipsoid at the origin.

        Parameters
        ----------
        latitude_deg, longitude_deg : array_like, shape (...)
            WGS 84 coordinates, degrees.

        Returns
        -------
        ndarray, shape (..., 2)
            East and north, m.
        """
        # Imported late, because `pdr-filter --help` imports this module and must start fast.
        import pymap3d

        latitude, longitude = np.asarray(latitude_deg), np.asarray(longitude_deg)
        east_m, north_m, _ = pymap3d.geodetic2enu(latitude, longitude, self._here[2], *self._here)
        return np.stack([np.asarray(east_m, dtype=float), np.asarray(north_m, dtype=float)], axis=-1)

    def latitude_longitude_deg(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert positions in the frame to geographic coordinates.

        Parameters
        ----------
        position_m : ndarray, shape (..., 2)
            East and north, m.

        Returns
        -------
        tuple of ndarray, shape (...)
            Latitude and longitude, degrees.
        """
        import pymap3d

        east_m, north_m = position_m[..., 0], position_m[..., 1]
        latitude_deg, longitude_deg, _ = pymap3d.enu2geodetic(east_m, north_m, np.zeros_like(east_m), *self._here)
        return np.asarray(latitude_deg, dtype=float), np.asarray(longitude_deg, dtype=float)
