"""A recording: sensor streams, truth, and who walked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any

from pdr_filter.values import Samples, Table, Wifi, limits, pickled
from pdr_filter.values.sanitise import printable


def check_height(height_m: float) -> None:
    """ValueError unless it is the height of a person in metres, a child's included."""
    low, high = limits.HEIGHT_RANGE_M
    if not isinstance(height_m, Real) or not low <= height_m <= high:
        raise ValueError(f"height_m must be the height of a person in metres, {low} to {high}, got {height_m!r}")


@dataclass(frozen=True, slots=True)
class Subject:
    """The pedestrian, as far as known."""

    id: str | None = None
    height_m: float | None = None
    weight_kg: float | None = None
    age: float | None = None
    gender: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is known about the walk: tables with the columns of docs/formats.md, or None."""

    position: Table | None = None
    waypoints: Table | None = None
    steps: Table | None = None
    strides: Table | None = None
    segments: Table | None = None
    labels: Table | None = None

    __reduce__ = pickled

    def present(self) -> tuple[str, ...]:
        """Names of the tables that exist."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording:
    """One recording: sensor streams at their own timestamps, truth where it exists, meta data.

    Sensor frame: x right, y up along the screen, z out of it. Specific force reads +9.81 on z for a phone lying
    face up. Streams that the phone did not record are None.

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
    accelerometer: Samples  # specific force, m/s2, (N, 3)
    gyroscope: Samples | None = None  # angular rate, rad/s, (N, 3)
    magnetometer: Samples | None = None  # magnetic field, uT, (N, 3)
    barometer: Samples | None = None  # pressure, hPa, (N, 1)
    light: Samples | None = None  # illuminance, lux, (N, 1)
    proximity: Samples | None = None  # distance, cm, (N, 1)
    attitude: Samples | None = None  # sensor-to-world quaternion wxyz computed by the phone, (N, 4)
    location: Samples | None = None  # latitude and longitude deg, altitude m, horizontal accuracy m, (N, 4)
    wifi: Wifi | None = None  # which access points were heard, when and how loud
    truth: Truth = Truth()
    meta: Mapping[str, Any] = field(default_factory=dict[str, Any])
    source: str = ""  # path it was read from
    notes: tuple[str, ...] = ()  # what the reader repaired or found odd, in words

    def __post_init__(self) -> None:
        object.__setattr__(self, "meta", dict(self.meta))  # its own, and one that can be pickled
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))  # they quote files

    def __repr__(self) -> str:
        heard = () if self.wifi is None else ("wifi",)
        return f"Recording({self.name!r}, {self.duration_s:.1f} s, {', '.join((*self.streams, *heard))})"

    @property
    def subject(self) -> Subject:
        """The pedestrian, from meta; unknown fields are None."""
        known = self.meta.get("subject") or {}
        return Subject(**{f.name: known.get(f.name) for f in fields(Subject)})

    def of_height(self, height_m: float) -> Recording:
        """The same recording of a person of this height: step lengths follow it."""
        check_height(height_m)
        subject = {**(self.meta.get("subject") or {}), "height_m": height_m}
        return replace(self, meta={**self.meta, "subject": subject})

    def save(self, path: str | Path) -> Path:
        """Write it in the project's own format and return the path: a zip file, or a folder if it has no suffix.

        Times get 6 decimals and values 7 significant digits (latitude and longitude 9). The same recording always gives
        the same bytes. Notes of the reader are not written. A recording that is already there is replaced.
        """
        # Only when called: values write no files.
        from pdr_filter.io.files.own_format_writer import write_own_format

        truth = {name: getattr(self.truth, name) for name in self.truth.present()}
        return write_own_format(path, self.streams, truth, {**self.meta, "name": self.name}, self.wifi)

    @property
    def epoch_s(self) -> float | None:
        """Unix time of time zero in s, if the file says it."""
        for name, in_s in (("epoch_s", 1.0), ("epoch_ms", 1e-3), ("epoch_ns", 1e-9)):
            value = self.meta.get(name)
            if isinstance(value, int | float):
                return float(value) * in_s
        return None

    @property
    def placement(self) -> str:
        """Where and how the phone was worn, in the recording's own words, in lower case; empty if not known."""
        return str(self.meta.get("placement") or "").lower()[: limits.MAX_NAME_CHARS]

    @property
    def is_on_foot(self) -> bool:
        """Whether the sensor was on a foot, where an event is a stride."""
        return "foot" in self.placement

    @property
    def streams(self) -> dict[str, Samples]:
        """The sensor streams that exist, by name."""
        return {f.name: value for f in fields(self) if isinstance(value := getattr(self, f.name), Samples)}

    @property
    def duration_s(self) -> float:
        """Time from the first to the last accelerometer sample."""
        time_s = self.accelerometer.time_s
        return float(time_s.max() - time_s.min()) if len(time_s) else 0.0


class MissingSensorError(ValueError):
    """A recording lacks a sensor that the recipe needs; the message names both."""
