"""Recording of a walk: sensor streams, ground truth and subject."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any

from pdr_filter.values import Samples, Table, Wifi, check_array, check_step_length, check_walked, limits
from pdr_filter.values.arrays import reduction, table
from pdr_filter.values.phone import counted_steps
from pdr_filter.values.sanitise import printable

# Key of the reading report in `Recording.meta`. It has plain values, so that it can be saved with the recording.
READING_KEY = "reading"


def check_height(height_m: float) -> None:
    """Raise ValueError unless a number is a plausible height of a person (adult or child), in metres.

    Parameters
    ----------
    height_m : float
        Body height, m.

    Raises
    ------
    ValueError
        If the height is not a number or outside `HEIGHT_RANGE_M`, for example in centimetres.

    Examples
    --------
    >>> from pdr_filter.values.recording import check_height
    >>> check_height(1.75)
    """
    low, high = limits.HEIGHT_RANGE_M
    if isinstance(height_m, bool) or not isinstance(height_m, Real) or not low <= height_m <= high:
        raise ValueError(f"height_m must be the height of a person in metres, {low} to {high}, got {height_m!r}")


@dataclass(frozen=True, slots=True)
class Subject:
    """Pedestrian of a recording. Unknown fields are None.

    Attributes
    ----------
    id, gender : str, optional
        Identifier of the person, and gender, as the data set states them.
    height_m, weight_kg, age : float, optional
        Body height in m, weight in kg and age in years.

    Examples
    --------
    >>> from pdr_filter.values.recording import Subject
    >>> Subject(id="p01", height_m=1.8).height_m
    1.8
    """

    id: str | None = None
    height_m: float | None = None
    weight_kg: float | None = None
    age: float | None = None
    gender: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Ground truth of a recording: tables, or None.

    Attributes
    ----------
    position : Table, optional
        Measured positions over time: time_s, east_m, north_m, up_m.
    waypoints : Table, optional
        Known points with the times at which the pedestrian passed them: time_s, east_m, north_m, floor. The path
        between them is unknown.
    steps, strides : Table, optional
        Contacts of the true steps (time_s), and strides of known length (start_s, end_s, length_m).
    segments, labels : Table, optional
        Stretches of known distance or number of steps (start_s, end_s, distance_m, n_steps), and of known context and
        carrying mode (start_s, end_s, context, carrying_mode).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> truth = pdr.simulate.demo_walk().truth
    >>> "position" in truth.present()
    True
    """

    position: Table | None = None
    waypoints: Table | None = None
    steps: Table | None = None
    strides: Table | None = None
    segments: Table | None = None
    labels: Table | None = None

    __reduce__ = reduction

    def present(self) -> tuple[str, ...]:
        """Return the names of the tables that are not None.

        Returns
        -------
        tuple of str
            Names of the attributes.
        """
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording:
    """Recording of a walk: sensor streams with their own timestamps, ground truth if available, and meta data.

    Axes of the sensor frame are x to the right, y up along the screen, and z out of the screen. The specific force of a
    phone lying face up is +9.81 m/s^2 on z. Streams that were not recorded are None.

    Attributes
    ----------
    name : str
        Name of the recording.
    accelerometer : Samples, values (N, 3)
        Specific force, m/s^2.
    gyroscope, magnetometer : Samples, values (N, 3), optional
        Angular rate, rad/s, and magnetic field, microtesla.
    barometer, light, proximity : Samples, values (N, 1), optional
        Air pressure, hPa, illuminance, lux, and distance to an object in front of the phone, cm.
    attitude : Samples, values (N, 4), optional
        Quaternion wxyz that rotates sensor coordinates into world coordinates, computed by the phone.
    location : Samples, values (N, 4), optional
        Latitude and longitude in degrees, altitude in m, and horizontal accuracy in m.
    wifi : Wifi, optional
        Received Wi-Fi access points.
    truth : Truth
        Ground truth.
    meta : mapping of str to object
        Meta data, such as "subject", "placement" and "epoch_s".
    source : str
        Path of the file from which the recording was read.
    notes : tuple of str
        Problems that the reader repaired or found.
    phone_heading : Samples, values (N, 1), optional
        Heading of the phone as the phone computed it, rad, clockwise from magnetic or true north.
    phone_step_count : Samples, values (N, 1), optional
        Readings of the phone's own step counter.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> time_s = np.arange(0.0, 10.0, 0.01)
    >>> face_up = np.tile([0.0, 0.0, 9.81], (len(time_s), 1))
    >>> recording = pdr.Recording("table", pdr.Samples(time_s, face_up), gyroscope=pdr.Samples(time_s, 0.0 * face_up))
    >>> recording
    Recording('table', 10.0 s, accelerometer, gyroscope)
    """

    name: str
    accelerometer: Samples
    gyroscope: Samples | None = None
    magnetometer: Samples | None = None
    barometer: Samples | None = None
    light: Samples | None = None
    proximity: Samples | None = None
    attitude: Samples | None = None
    location: Samples | None = None
    wifi: Wifi | None = None
    truth: Truth = Truth()
    meta: Mapping[str, Any] = field(default_factory=dict[str, Any])
    source: str = ""
    notes: tuple[str, ...] = ()
    phone_heading: Samples | None = None
    phone_step_count: Samples | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "meta", dict(self.meta))  # a copy, of a type that can be pickled
        # Notes quote files, which may contain control characters.
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))

    def __repr__(self) -> str:
        heard = () if self.wifi is None else ("wifi",)
        return f"Recording({self.name!r}, {self.duration_s:.1f} s, {', '.join((*self.streams, *heard))})"

    @property
    def subject(self) -> Subject:
        """Pedestrian, from the meta data. Unknown fields are None."""
        known = self.meta.get("subject") or {}
        return Subject(**{f.name: known.get(f.name) for f in fields(Subject)})

    def of_height(self, height_m: float) -> Recording:
        """Return a copy with another body height of the person.

        The height changes the step lengths of `pdr_filter.track(recording)`, and of a recipe that is called with the
        `subject` of the copy.

        Parameters
        ----------
        height_m : float
            Body height, m.

        Returns
        -------
        Recording
            Copy with the height in its meta data.

        Raises
        ------
        ValueError
            If the height is not plausible.
        """
        check_height(height_m)
        subject = {**(self.meta.get("subject") or {}), "height_m": height_m}
        return replace(self, meta={**self.meta, "subject": subject})

    def of_distance(self, distance_m: float, n_steps: int | None = None) -> Recording:
        """Return a copy whose walk has a known length, for `pdr_filter.calibrate`.

        Parameters
        ----------
        distance_m : float
            Length of the path walked in the whole recording, m.
        n_steps : int, optional
            Number of steps, if it was counted. The calibration compares it with the detected steps.

        Returns
        -------
        Recording
            Copy whose only truth is one segment from the first sample to the last.

        Raises
        ------
        ValueError
            If a value is not positive, or if nobody goes so far in the time of the recording, or with so few or so many
            steps.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=45.0)]).of_distance(45.0)
        >>> calibration = pdr.calibrate(walk)
        >>> round(pdr.track(walk, calibration=calibration).distance_m)
        45
        """
        check_array("distance_m", distance_m, "positive", remedy="give the length of the walk in metres")
        if n_steps is not None:
            check_array("n_steps", n_steps, "positive", remedy="give the number of steps, or leave it out")
            check_step_length("distance_m (--distance) / n_steps (--steps)", distance_m / n_steps)
        start_s, end_s = (float(self.accelerometer.time_s[k]) for k in (0, -1))
        check_walked("distance_m", distance_m, end_s - start_s)
        known = {"start_s": [start_s], "end_s": [end_s], "distance_m": [float(distance_m)]}
        steps = {"n_steps": [math.nan if n_steps is None else float(n_steps)]}
        return replace(self, truth=Truth(segments=table(known | steps)))

    def save(self, path: str | Path) -> Path:
        """Write the recording in the format of this package: a zip file, or a folder if the path has no suffix.

        Times are written with 6 decimals and values with 7 significant digits (latitude and longitude with 9). Equal
        recordings give identical bytes. An existing recording is replaced.

        Parameters
        ----------
        path : str or Path
            File or folder to write.

        Returns
        -------
        Path
            The written file or folder.
        """
        # Imported late, because this package must not import the writers of files.
        from pdr_filter.data.io.files.own_format_writer import NOTES_KEY, write_own_format

        truth = {name: getattr(self.truth, name) for name in self.truth.present()}
        notes = {NOTES_KEY: self.notes} if self.notes else {}
        return write_own_format(path, self.streams, truth, {**self.meta, "name": self.name, **notes}, self.wifi)

    @property
    def epoch_s(self) -> float | None:
        """Unix time of time zero, s. None if the file does not contain it."""
        for name, in_s in (("epoch_s", 1.0), ("epoch_ms", 1e-3), ("epoch_ns", 1e-9)):
            value = self.meta.get(name)
            if isinstance(value, int | float):
                return float(value) * in_s
        return None

    @property
    def placement(self) -> str:
        """Place and manner of wearing the phone, as stated by the recording, in lower case. Empty if unknown."""
        return str(self.meta.get("placement") or "").lower()[: limits.MAX_NAME_CHARS]

    @property
    def phone_steps(self) -> int | None:
        """Number of steps that the phone counted itself, or None if the file does not have it."""
        counted = None if self.phone_step_count is None else counted_steps(self.phone_step_count).values
        return None if counted is None or not len(counted) else int(counted[-1, 0])

    @property
    def is_on_foot(self) -> bool:
        """True if the stated placement is on a foot, where each detected ground contact ends a stride, not a step."""
        return "foot" in self.placement

    @property
    def streams(self) -> dict[str, Samples]:
        """Sensor streams that are not None, by name."""
        return {f.name: value for f in fields(self) if isinstance(value := getattr(self, f.name), Samples)}

    @property
    def duration_s(self) -> float:
        """Time from the smallest to the largest time of an accelerometer sample, s.

        A backward jump of the clock enters it. `pdr-filter info` gives the duration without such jumps.
        """
        time_s = self.accelerometer.time_s
        return float(time_s.max() - time_s.min()) if len(time_s) else 0.0


class MissingSensorError(ValueError):
    """Error for a recording without a sensor that the recipe, another argument or a radio map needs.

    The message names the missing sensor.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> issubclass(pdr.MissingSensorError, ValueError)
    True
    """
