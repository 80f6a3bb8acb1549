"""What every method is given, and what it has to hand back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfiltfilt
from vqf import offlineVQF

import pdr_filter as pdr
from pdr_filter.sensing.conditioning import Conditioner, merge_streams

FloatArray = NDArray[np.float64]
RATE_HZ = 100.0
UNKNOWN_HEIGHT_M = 1.70
# Of the speed on which walked distances are taken; a tenth of the shortest step.
GRID_S = 0.02
# Acceleration along the way has the frequency of steps, that across it half of it: 1.2 Hz keeps the second out.
STEP_BAND_HZ = (1.2, 3.0)
# Ten steps show an axis, and a corner is not smeared over more than that.
AXIS_STD_S = 1.5


@dataclass(frozen=True, eq=False)
class Found:
    """What a method found: contacts, and the speeds it gives for stretches of time.

    Stretches may overlap (strides of both feet do) and leave time out; times are those of the recording.
    """

    step_s: FloatArray  # (K,) ascending
    start_s: FloatArray = field(default_factory=lambda: np.empty(0))  # (M,)
    end_s: FloatArray = field(default_factory=lambda: np.empty(0))  # (M,)
    speed_mps: FloatArray = field(default_factory=lambda: np.empty(0))  # (M,) NaN where it was refused

    def speeds(self, grid_s: FloatArray) -> FloatArray:
        """Mean speed (G,) of the stretches that cover each time; NaN where none does."""
        total, count = np.zeros(len(grid_s) + 1), np.zeros(len(grid_s) + 1)
        known = np.isfinite(self.speed_mps)
        for edge_s, sign in ((self.start_s, 1.0), (self.end_s, -1.0)):
            at = np.searchsorted(grid_s, edge_s[known])
            np.add.at(total, at, sign * self.speed_mps[known])
            np.add.at(count, at, sign)
        n = np.cumsum(count)[:-1]
        # above a half: sums of whole numbers, but of floating-point type
        return np.divide(np.cumsum(total)[:-1], n, out=np.full(len(grid_s), np.nan), where=n > 0.5)


def of_steps(time_s: FloatArray, duration_s: FloatArray, length_m: FloatArray) -> Found:
    """Contacts that end steps, with their lengths."""
    return Found(time_s, time_s - duration_s, time_s, length_m / duration_s)


def between(contact_s: FloatArray, length_m: float, longest_s: float = 1.5) -> Found:
    """Contacts with one length for all steps; two contacts further apart than `longest_s` are no step."""
    duration_s = np.diff(contact_s, prepend=np.nan)
    step = duration_s < longest_s
    found = of_steps(contact_s[step], duration_s[step], np.full(step.sum(), length_m))
    return Found(contact_s, found.start_s, found.end_s, found.speed_mps)


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording, when the person walks in it, and its samples in the axes of the body.

    Packages for a sensor on the lower back expect axes fixed to the trunk. A phone has none, so that they are given
    the best that the whole recording gives: up from `vqf.offlineVQF`, which looks ahead, and the way ahead from the
    principal axis of the horizontal acceleration at the frequency of steps, its sign from our own walking heading.
    The work for that is not counted as theirs.
    """

    recording: pdr.Recording
    start_s: float
    end_s: float

    @property
    def height_m(self) -> float:
        """Height of the person, 1.70 m if it is not known."""
        return self.recording.subject.height_m or UNKNOWN_HEIGHT_M

    @cached_property
    def track(self) -> pdr.Track:
        """What the default recipe says."""
        return pdr.track(self.recording)

    @cached_property
    def _uniform(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (N,), specific force and angular rate (N, 3) in the axes of the sensor; gaps are bridged linearly."""
        conditioner = Conditioner(RATE_HZ)
        _, blocks = conditioner.update(conditioner.init(), merge_streams(self.recording))
        known_s = np.concatenate([b.time_s for b in blocks])
        time_s = np.arange(known_s[0], known_s[-1], 1 / RATE_HZ)
        columns = np.hstack(
            [np.concatenate([getattr(b, n) for b in blocks]) for n in ("specific_force_mps2", "angular_rate_radps")]
        )
        signals = np.column_stack([np.interp(time_s, known_s, c) for c in columns.T])
        return time_s, np.ascontiguousarray(signals[:, :3]), np.ascontiguousarray(signals[:, 3:])

    @property
    def time_s(self) -> FloatArray:
        """Times of the uniform samples (N,)."""
        return self._uniform[0]

    @property
    def magnitude_mps2(self) -> FloatArray:
        """Of the specific force (N,)."""
        return np.linalg.norm(self._uniform[1], axis=1)

    @cached_property
    def body(self) -> tuple[FloatArray, FloatArray]:
        """Specific force in m/s2 and angular rate in rad/s, (N, 3) each: right, ahead, up."""
        time_s, force, rate = self._uniform
        quat = offlineVQF(rate, force, None, 1 / RATE_HZ)["quat6D"]
        force, rate = rotated(quat, force), rotated(quat, rate)
        ahead_rad = self._ahead_rad(time_s, force[:, :2])
        return turned(ahead_rad, force), turned(ahead_rad, rate)

    def _ahead_rad(self, time_s: FloatArray, horizontal_mps2: FloatArray) -> FloatArray:
        """Way ahead (N,), clockwise from the second horizontal axis."""
        band = butter(2, STEP_BAND_HZ, btype="band", fs=RATE_HZ, output="sos")
        x, y = sosfiltfilt(band, horizontal_mps2, axis=0).T
        smooth = [gaussian_filter1d(p, AXIS_STD_S * RATE_HZ) for p in (2 * x * y, y * y - x * x)]
        axis_rad = 0.5 * np.unwrap(np.arctan2(*smooth))
        track = self.track
        if not len(track.time_s):
            return axis_rad
        apart = np.interp(track.time_s, time_s, axis_rad) - track.walking_heading_rad
        return axis_rad + (np.pi if np.cos(apart).sum() < 0 else 0.0)

    @property
    def inside(self) -> slice:
        """The samples of the walk."""
        return slice(*np.searchsorted(self.time_s, [self.start_s, self.end_s]))


Run = Callable[[Walk], Found]


@dataclass(frozen=True)
class Method:
    """One way to find steps, by a package that may be missing."""

    name: str
    package: str  # as it is installed
    load: Callable[[], Run]  # imports the package
    walk_known: bool = False  # the interval of the walk is given
    own_steps: bool = True  # finds them otherwise than the methods before it


def rotated(quat: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (N, 3) turned by unit quaternions (N, 4), scalar first."""
    w, axis = quat[:, :1], quat[:, 1:]
    twice = 2 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)


def turned(ahead_rad: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (N, 3) of x, y, up as right, ahead, up; the way ahead is clockwise from y."""
    sin, cos = np.sin(ahead_rad), np.cos(ahead_rad)
    x, y, up = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, up])
