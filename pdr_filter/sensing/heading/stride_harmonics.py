"""Harmonics of the motion in each stride, and the axes of the phone to which they refer.

Many strides are computed together, with the same bits as for each stride alone. Their samples are concatenated to T
columns. `ends` (K + 1) holds the first column of each of the K strides, and finally T.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pdr_filter.sensing.heading.vectors import Vector, across, cross, dot, linear_sum
from pdr_filter.values import BoolArray, ComplexArray, FloatArray, IntArray

# Duration in s from which a stride may be two strides with missed contacts: 1.4 steps a second is slow, 2.8 is running.
_TWO_STRIDES_S = 1.4
# Largest horizontal amplitude at step frequency of slow steps. A larger one is the stride frequency of a swinging hand.
_SLOW_STEP_MPS2 = 2.0
# Sine of the elevation of the y axis above which it points up rather than forward, 60 degrees.
_UPRIGHT = math.sin(math.radians(60.0))
_AHEAD, _UPRIGHT_AHEAD = (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Stride:
    """Motion of one stride relative to a horizontal reference axis of the phone.

    Angles are clockwise.
    """

    up: Vector  # mean unit vector up, sensor frame
    axis: Vector  # reference axis, a unit vector perpendicular to `up`, sensor frame
    axis_heading_rad: float  # mean direction of the axis in the attitude frame, from north, rad
    device_heading_rad: float  # mean device heading, rad
    pointing_rad: float  # direction in which the phone points, from the axis, rad
    runs: bool  # true if the pedestrian runs
    # Three horizontal vectors, forward + i right of the axis, m/s2: amplitudes of the horizontal specific force in
    # phase with the vertical specific force. The first is the part at stride frequency. The second is the part at step
    # frequency, in phase with the vertical force advanced by the phase of `Phases`. The third is the part at step
    # frequency, in phase with the vertical force advanced by another 90 degrees.
    vectors: tuple[complex, complex, complex]
    # squared amplitudes, (m/s2)^2: horizontal at stride frequency, horizontal at step frequency, and vertical at stride
    # frequency
    powers: Vector

    @property
    def axis_offset_rad(self) -> float:
        """Direction of the reference axis, clockwise from the device heading, rad."""
        return self.axis_heading_rad - self.device_heading_rad

    def turned(self, turn_rad: float) -> Stride:
        """Return the stride with all headings changed by an angle."""
        axis_rad, device_rad = self.axis_heading_rad + turn_rad, self.device_heading_rad + turn_rad
        return replace(self, axis_heading_rad=axis_rad, device_heading_rad=device_rad)

    def about(self, axis: Vector) -> Stride:
        """Return the stride relative to another axis perpendicular to up."""
        turn_rad = math.atan2(dot(self.axis, cross(axis, self.up)), dot(self.axis, axis))
        (a, b, c), turn = self.vectors, cmath.rect(1.0, turn_rad)
        return Stride(
            up=self.up,
            axis=axis,
            axis_heading_rad=self.axis_heading_rad - turn_rad,
            device_heading_rad=self.device_heading_rad,
            pointing_rad=self.pointing_rad + turn_rad,
            runs=self.runs,
            vectors=(a * turn, b * turn, c * turn),
            powers=self.powers,
        )

    @property
    def numbers(self) -> list[float]:
        """All numbers of the stride, as `of_numbers` takes them."""
        vectors = [part for vector in self.vectors for part in (vector.real, vector.imag)]
        angles = self.axis_heading_rad, self.device_heading_rad, self.pointing_rad
        return [*self.up, *self.axis, *angles, float(self.runs), *vectors, *self.powers]

    @classmethod
    def of_numbers(cls, numbers: Sequence[float]) -> Stride:
        """Return the stride with these `numbers`."""
        ux, uy, uz, ax, ay, az, axis_rad, device_rad, pointing_rad, runs, a, b, c, d, e, f, *powers = numbers
        vectors, (x, y, z) = (complex(a, b), complex(c, d), complex(e, f)), powers
        return cls((ux, uy, uz), (ax, ay, az), axis_rad, device_rad, pointing_rad, runs > 0, vectors, (x, y, z))


N_NUMBERS = 19  # length of `Stride.numbers`


@dataclass(frozen=True, slots=True, eq=False)
class StrideSamples:
    """Concatenated samples of K strides."""

    ends: IntArray  # (K + 1,) first column of each stride, and the number of columns T
    force_mps2: FloatArray  # (3, T) specific force in the sensor frame, m/s2
    up: FloatArray  # (3, T) unit vectors up in the sensor frame
    # (T,) specific force in the attitude frame, m/s2.
    east_mps2: FloatArray
    north_mps2: FloatArray
    vertical_mps2: FloatArray
    heading_rad: FloatArray  # (T,) device heading, rad


@dataclass(frozen=True)
class Phases:
    """Phases by which the vertical specific force is advanced to be in phase with the push forward."""

    walking_rad: float  # phase of walking, rad
    running_rad: float  # phase of running, rad
    running_mps2: float  # vertical amplitude at step frequency from which the motion is running, m/s2


def strides_of(samples: StrideSamples, is_running: BoolArray, rate_hz: float, phases: Phases) -> list[Stride]:
    """Return the strides in samples of K strides, each relative to the pointing axis of the phone in that stride.

    `is_running` (K,) is True for strides that are known to be running.
    """
    ends, starts = samples.ends, samples.ends[:-1]
    n = np.diff(ends)
    ups = np.add.reduceat(samples.up, starts, axis=1).T
    ups = ups / np.sqrt(ups[:, 0] * ups[:, 0] + ups[:, 1] * ups[:, 1] + ups[:, 2] * ups[:, 2])[:, None]
    mean_ups: list[Vector] = [(x, y, z) for x, y, z in ups.tolist()]
    axes = [pointing_axis(up) for up in mean_ups]
    frames = np.array([[axis, cross(axis, up), up] for axis, up in zip(axes, mean_ups, strict=True)])
    forward, right = in_mean_frame(samples.force_mps2, samples.up, frames, ends)
    # The horizontal force is the same vector in the axes of the device and in the attitude frame, so the angle between
    # its two representations is the heading of the axis. A sample without horizontal force has no weight.
    size = np.maximum(forward * forward + right * right, 1e-12)
    along = (samples.north_mps2 * forward + samples.east_mps2 * right) / size
    across_ = (samples.east_mps2 * forward - samples.north_mps2 * right) / size
    along, across_, heading = np.add.reduceat(np.array([along, across_, samples.heading_rad]), starts, axis=1)
    once, twice = harmonics(np.array([forward, right, samples.vertical_mps2]), ends, rate_hz)
    runs = is_running | (np.abs(twice[:, 2]) > phases.running_mps2)
    phase_rad = np.where(runs, phases.running_rad, phases.walking_rad)
    vectors = in_phase(once, np.zeros(len(n))), in_phase(twice, phase_rad), in_phase(twice, phase_rad + 0.5 * np.pi)
    powers = power(once[:, :2]), power(twice[:, :2]), power(once[:, 2:])
    rows = zip(
        mean_ups,
        axes,
        np.arctan2(across_, along).tolist(),
        (heading / n).tolist(),
        runs.tolist(),
        zip(*(vector.tolist() for vector in vectors), strict=True),
        zip(*(squared.tolist() for squared in powers), strict=True),
        strict=True,
    )
    return [
        Stride(up, axis, axis_rad, device_rad, 0.0, run, *motion)
        for up, axis, axis_rad, device_rad, run, *motion in rows
    ]


def pointing_axis(up: Vector) -> Vector:
    """Return the horizontal unit vector in the sensor frame that points away from a user who reads the phone.

    It is the horizontal part of the axis y, or of -z if the user holds the phone upright.
    """
    return across(_AHEAD if abs(up[1]) < _UPRIGHT else _UPRIGHT_AHEAD, up)


def carry_axis(axis: Vector, up: Vector, new_up: Vector) -> Vector:
    """Return an axis perpendicular to `up`, rotated by the shortest rotation from `up` to `new_up`.

    With u = up, m = new_up and an axis v perpendicular to u, the rotated axis is v' = v - (m . v) / (1 + u . m) (u +
    m). All are unit vectors.
    """
    cosine = dot(up, new_up)
    if cosine < -0.99:
        return pointing_axis(new_up)  # the phone was turned over, so the shortest rotation is not unique
    between = linear_sum(1.0, up, 1.0, new_up)
    return across(linear_sum(1.0, axis, -dot(new_up, axis) / (1.0 + cosine), between), new_up)


def in_mean_frame(
    force: FloatArray, up: FloatArray, frames: FloatArray, ends: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal components of vectors (3, T): (T,) along the axis of each stride and (T,) right of it.

    Each vector is given in the sensor frame. It is rotated by the shortest rotation from its own `up` (3, T) to the
    mean up of its stride, as in `carry_axis`. This removes the swing of the device, but keeps its turn about the
    vertical. The rows of `frames` (K, 3, 3) are the axis, the direction right of it, and the mean up.
    """
    vectors, rotated = np.array([force, up]), np.empty((2, *force.shape))
    for frame, start, end in zip(frames, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        np.matmul(frame, vectors[:, :, start:end], out=rotated[:, :, start:end])
    ups = rotated[1]
    flat = rotated[0] - (force[0] * up[0] + force[1] * up[1] + force[2] * up[2]) * ups
    tilted = flat[2] / np.maximum(1.0 + ups[2], 1e-6)
    return flat[0] - tilted * ups[0], flat[1] - tilted * ups[1]


def harmonics(signals: FloatArray, ends: IntArray, rate_hz: float) -> tuple[ComplexArray, ComplexArray]:
    """Return the complex amplitudes (K, 3) of signals (3, T) at stride frequency, and those at step frequency.

    The last signal is the vertical specific force, the others are horizontal. The samples of a stride may be two
    strides if every other step was missed. This is assumed for slow strides under one of two conditions. Either the
    vertical force oscillates four times rather than twice, or the horizontal amplitude at twice the stride frequency is
    too large for slow steps.
    """
    amplitudes: ComplexArray = np.empty((len(ends) - 1, 3, 3), np.complex128)
    for rows, start, end in zip(amplitudes.view(np.float64), ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        np.matmul(signals[:, start:end], _waves(end - start), out=rows)
    once, twice, four_times = amplitudes[:, :, 0], amplitudes[:, :, 1], amplitudes[:, :, 2]
    is_slow = np.diff(ends) >= _TWO_STRIDES_S * rate_hz
    is_shaken = power(twice[:, :-1]) > _SLOW_STEP_MPS2**2
    is_double = (is_slow & ((np.abs(four_times[:, -1]) > np.abs(twice[:, -1])) | is_shaken))[:, None]
    return np.where(is_double, twice, once), np.where(is_double, four_times, twice)


def in_phase(amplitudes: ComplexArray, phase_rad: FloatArray) -> ComplexArray:
    """Return the part (K,) of the horizontal amplitudes of K strides in phase with their vertical amplitudes.

    The vertical amplitudes are first advanced by a phase (K,). `amplitudes` is (K, 3): forward, right, vertical,
    complex, in m/s2. The result is forward + i right in m/s2.
    """
    horizontal, vertical = amplitudes[:, :2], amplitudes[:, 2]
    size = np.abs(vertical)
    direction = vertical / np.where(size > 0, size, 1.0) * np.exp(1j * phase_rad)
    shared = (horizontal * direction.conj()[:, None]).real
    return shared[:, 0] + 1j * shared[:, 1]


def power(amplitudes: ComplexArray) -> FloatArray:
    """Return the sum of the squared amplitudes (K,) of signals with complex amplitudes (K, n)."""
    return np.add.reduce(amplitudes.real**2 + amplitudes.imag**2, axis=1)


@lru_cache(maxsize=512)
def _waves(n: int) -> FloatArray:
    """Return waves with one, two and four periods in n samples, (n, 6), whose products with signals are amplitudes.

    The columns are real and imaginary parts in turn. Phases refer to the middle of the samples. All waves have zero
    mean, so that the mean of a signal has no influence.
    """
    part = (np.arange(n) - 0.5 * (n - 1)) / n
    waves: ComplexArray = np.exp(-2j * np.pi * np.outer(part, [1.0, 2.0, 4.0]))
    # Remove the slope of the faster waves, so that a slow change has no influence. The first wave keeps its slope,
    # because too little of it would remain.
    waves[:, 1:] -= np.outer(part, part @ waves[:, 1:] / (part @ part))
    return (2.0 / n * waves).view(np.float64)
