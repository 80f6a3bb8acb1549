"""What strides show: their axes in the sensor frame, and the harmonics of their motion.

Many strides are described together, each with the bits that it has alone: their samples stand one after the other, T in
all, and `ends` (K + 1) are the columns at which each begins, and where the last one ends.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pdr_filter.sensing.heading.vectors import Vector, across, combined, cross, dot
from pdr_filter.values import BoolArray, ComplexArray, FloatArray, IntArray

# Longer ones may be two: 1.4 steps a second is slow, 2.8 running.
_TWO_STRIDES_S = 1.4
# Horizontal amplitude at step frequency beyond that of slow steps: a swinging hand has it at stride frequency.
_SLOW_STEP_MPS2 = 2.0
# y is up rather than forward beyond 60 degrees.
_UPRIGHT = math.sin(math.radians(60.0))
_AHEAD, _UPRIGHT_AHEAD = (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Stride:
    """What one stride shows. Angles are clockwise, vectors forward + i right of the reference axis, m/s2."""

    up: Vector  # mean, sensor frame
    axis: Vector  # the reference axis, sensor frame
    axis_heading_rad: float  # its mean direction in the attitude's frame, clockwise from north
    device_heading_rad: float  # mean
    pointing_rad: float  # where the phone points, from the axis
    runs: bool
    vectors: tuple[complex, complex, complex]  # as in `Place`
    powers: Vector  # squared amplitudes: horizontal once and twice a stride, vertical once

    @property
    def axis_offset_rad(self) -> float:
        """The reference axis, clockwise from where the device heads."""
        return self.axis_heading_rad - self.device_heading_rad

    def about(self, axis: Vector) -> Stride:
        """The same about another axis across up."""
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


@dataclass(frozen=True, slots=True, eq=False)
class StrideSamples:
    """Samples of strides, one after the other; all but the force and up in the attitude's frame."""

    ends: IntArray  # (K + 1,)
    force_mps2: FloatArray  # (3, T) sensor frame
    up: FloatArray  # (3, T) sensor frame
    east_mps2: FloatArray  # (T,)
    north_mps2: FloatArray  # (T,)
    vertical_mps2: FloatArray  # (T,)
    heading_rad: FloatArray  # (T,) of the device


@dataclass(frozen=True)
class Phases:
    """By how much the vertical force is advanced to be in phase with the push forward; see `WalkingHeading`."""

    walking_rad: float
    running_rad: float
    running_mps2: float


def strides_of(samples: StrideSamples, is_running: BoolArray, rate_hz: float, phases: Phases) -> list[Stride]:
    """Strides about where the phone points in each; `is_running` (K,) says which of them are surely running."""
    ends, starts = samples.ends, samples.ends[:-1]
    n = np.diff(ends)
    ups = np.add.reduceat(samples.up, starts, axis=1).T
    ups = ups / np.sqrt(ups[:, 0] * ups[:, 0] + ups[:, 1] * ups[:, 1] + ups[:, 2] * ups[:, 2])[:, None]
    up_of: list[Vector] = [(x, y, z) for x, y, z in ups.tolist()]
    axes = [pointing_axis(up) for up in up_of]
    frames = np.array([[axis, cross(axis, up), up] for axis, up in zip(axes, up_of, strict=True)])
    forward, right = in_mean_frame(samples.force_mps2, samples.up, frames, ends)
    # Both, the device's and the attitude's, are one vector, so their angle is that of the axis, clockwise from north.
    # Where there is no horizontal force, none is known, and the samples around decide.
    size = np.maximum(forward * forward + right * right, 1e-12)
    along = (samples.north_mps2 * forward + samples.east_mps2 * right) / size
    across_ = (samples.east_mps2 * forward - samples.north_mps2 * right) / size
    along, across_, heading = np.add.reduceat(np.stack([along, across_, samples.heading_rad]), starts, axis=1)
    once, twice = harmonics(np.stack([forward, right, samples.vertical_mps2]), ends, rate_hz)
    runs = is_running | (np.abs(twice[:, 2]) > phases.running_mps2)
    phase_rad = np.where(runs, phases.running_rad, phases.walking_rad)
    vectors = in_phase(once, np.zeros(len(n))), in_phase(twice, phase_rad), in_phase(twice, phase_rad + 0.5 * np.pi)
    powers = power(once[:, :2]), power(twice[:, :2]), power(once[:, 2:])
    rows = zip(
        up_of,
        axes,
        np.arctan2(across_, along).tolist(),
        (heading / n).tolist(),
        runs.tolist(),
        zip(*(vector.tolist() for vector in vectors), strict=True),
        zip(*(power_of.tolist() for power_of in powers), strict=True),
        strict=True,
    )
    return [
        Stride(up, axis, at_rad, device_rad, 0.0, run, *motion) for up, axis, at_rad, device_rad, run, *motion in rows
    ]


def pointing_axis(up: Vector) -> Vector:
    """Horizontal unit vector along which somebody who reads holds the phone: y, or -z if it stands upright."""
    return across(_AHEAD if abs(up[1]) < _UPRIGHT else _UPRIGHT_AHEAD, up)


def carry_axis(axis: Vector, up: Vector, new_up: Vector) -> Vector:
    """The axis, across `up`, turned by the shortest way from `up` to `new_up`.

    v' = v - (m . v) / (1 + u . m) (u + m) turns v, across u, by the shortest way from u to m.
    """
    cosine = dot(up, new_up)
    if cosine < -0.99:
        return pointing_axis(new_up)  # turned over: no way is the shortest
    between = combined(1.0, up, 1.0, new_up)
    return across(combined(1.0, axis, -dot(new_up, axis) / (1.0 + cosine), between), new_up)


def in_mean_frame(
    force: FloatArray, up: FloatArray, frames: FloatArray, ends: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Horizontal part of vectors (3, T), sensor frame: (T,) along the axis of each stride, and (T,) right of it.

    Each is turned by the shortest way from its own `up` (3, T) to the mean one, as in `carry_axis`: what turns with the
    device stays, what swings with it does not. The rows of `frames` (K, 3, 3) are axis, right and mean up.
    """
    vectors, turned = np.stack([force, up]), np.empty((2, *force.shape))
    for frame, start, end in zip(frames, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        np.matmul(frame, vectors[:, :, start:end], out=turned[:, :, start:end])
    ups = turned[1]
    flat = turned[0] - (force[0] * up[0] + force[1] * up[1] + force[2] * up[2]) * ups
    tilted = flat[2] / np.maximum(1.0 + ups[2], 1e-6)
    return flat[0] - tilted * ups[0], flat[1] - tilted * ups[1]


def harmonics(signals: FloatArray, ends: IntArray, rate_hz: float) -> tuple[ComplexArray, ComplexArray]:
    """Complex amplitudes (K, 3) of signals (3, T), once and twice a stride.

    The last signal is the vertical specific force, the others are horizontal. The samples are a stride, or two strides
    if every other step was missed: if they are slow, and the vertical force goes up and down four times rather than
    twice, or the horizontal one twice with an amplitude that nobody has at each of such slow steps.
    """
    amplitudes: ComplexArray = np.empty((len(ends) - 1, 3, 3), np.complex128)
    for of_stride, start, end in zip(amplitudes.view(np.float64), ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        np.matmul(signals[:, start:end], _waves(end - start), out=of_stride)
    once, twice, four_times = amplitudes[:, :, 0], amplitudes[:, :, 1], amplitudes[:, :, 2]
    is_slow = np.diff(ends) >= _TWO_STRIDES_S * rate_hz
    is_shaken = power(twice[:, :-1]) > _SLOW_STEP_MPS2**2
    is_double = (is_slow & ((np.abs(four_times[:, -1]) > np.abs(twice[:, -1])) | is_shaken))[:, None]
    return np.where(is_double, twice, once), np.where(is_double, four_times, twice)


def in_phase(amplitudes: ComplexArray, phase_rad: FloatArray) -> ComplexArray:
    """Part (K,) of horizontal amplitudes, forward + i right, m/s2, in phase with the vertical ones advanced by (K,)."""
    horizontal, vertical = amplitudes[:, :2], amplitudes[:, 2]
    size = np.abs(vertical)
    direction = vertical / np.where(size > 0, size, 1.0) * np.exp(1j * phase_rad)
    shared = (horizontal * direction.conj()[:, None]).real
    return shared[:, 0] + 1j * shared[:, 1]


def power(amplitudes: ComplexArray) -> FloatArray:
    """Squared amplitude (K,) of all signals (K, n) together."""
    return (amplitudes.real**2 + amplitudes.imag**2).sum(axis=1)


@lru_cache(maxsize=512)
def _waves(n: int) -> FloatArray:
    """Waves once, twice and four times in n samples, scaled to give amplitudes; phases are at the middle.

    Real and imaginary parts one after the other, (N, 6). None has a mean, so that that of a signal does not enter.
    """
    part = (np.arange(n) - 0.5 * (n - 1)) / n
    waves: ComplexArray = np.exp(-2j * np.pi * np.outer(part, [1.0, 2.0, 4.0]))
    # the faster ones have no slope, so that a slow change does not enter; of the first too little would remain
    waves[:, 1:] -= np.outer(part, part @ waves[:, 1:] / (part @ part))
    return (2.0 / n * waves).view(np.float64)
