"""What one stride shows: its axes in the sensor frame, and the harmonics of its motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import FloatArray

# Longer ones may be two: 1.4 steps a second is slow, 2.8 running.
_TWO_STRIDES_S = 1.4
# Horizontal amplitude at step frequency beyond that of slow steps: a swinging hand has it at stride frequency.
_SLOW_STEP_MPS2 = 2.0
# y is up rather than forward beyond 60 degrees.
_UPRIGHT = math.sin(math.radians(60.0))


@dataclass(frozen=True, slots=True, eq=False)
class Stride:
    """What one stride shows. Angles are clockwise, vectors (forward, right) of the reference axis, m/s2."""

    up: FloatArray  # (3,) mean, sensor frame
    axis: FloatArray  # (3,) the reference axis, sensor frame
    axis_heading_rad: float  # its mean direction in the attitude's frame, clockwise from north
    device_heading_rad: float  # mean
    pointing_rad: float  # where the phone points, from the axis
    runs: bool
    vectors: FloatArray  # (3, 2) as in `Place`
    powers: FloatArray  # (3,) squared amplitudes: horizontal once and twice a stride, vertical once

    @property
    def axis_offset_rad(self) -> float:
        """The reference axis, clockwise from where the device heads."""
        return self.axis_heading_rad - self.device_heading_rad


def pointing_axis(up: FloatArray) -> FloatArray:
    """Horizontal unit vector (3,) along which somebody who reads holds the phone: y, or -z if it stands upright."""
    axis = np.array([0.0, 1.0, 0.0]) if abs(up[1]) < _UPRIGHT else np.array([0.0, 0.0, -1.0])
    return across(axis, up)


def carry_axis(axis: FloatArray, up: FloatArray, new_up: FloatArray) -> FloatArray:
    """The axis (3,), across `up`, turned by the shortest way from `up` to `new_up`.

    v' = v - (m . v) / (1 + u . m) (u + m) turns v, across u, by the shortest way from u to m.
    """
    cosine = float(up @ new_up)
    if cosine < -0.99:
        return pointing_axis(new_up)  # turned over: no way is the shortest
    return across(axis - float(new_up @ axis) / (1.0 + cosine) * (up + new_up), new_up)


def in_mean_frame(force: FloatArray, up: FloatArray, frame: FloatArray) -> FloatArray:
    """Horizontal part of vectors (3, N), sensor frame, as complex numbers (N,): along the axis, and right of it.

    Each is turned by the shortest way from its own `up` (3, N) to the mean one, as in `carry_axis`: what turns with the
    device stays, what swings with it does not. The rows of `frame` (3, 3) are axis, right and mean up.
    """
    forces, ups = frame @ force, frame @ up
    flat = forces - (force * up).sum(axis=0) * ups
    tilted = flat[2] / np.maximum(1.0 + ups[2], 1e-6)
    return (flat[0] - tilted * ups[0]) + 1j * (flat[1] - tilted * ups[1])


def harmonics(signals: FloatArray, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Complex amplitudes (3,) of signals (3, N), once and twice a stride.

    The last signal is the vertical specific force, the others are horizontal. The samples are a stride, or two strides
    if every other step was missed: if they are slow, and the vertical force goes up and down four times rather than
    twice, or the horizontal one twice with an amplitude that nobody has at each of such slow steps.
    """
    waves = _waves(signals.shape[1])
    centred = signals - signals.mean(axis=1)[:, None]
    once, twice = (centred * waves[0]).sum(axis=1), (centred * waves[1]).sum(axis=1)
    if duration_s < _TWO_STRIDES_S:
        return once, twice
    four_times = (centred * waves[2]).sum(axis=1)
    is_double = abs(four_times[-1]) > abs(twice[-1]) or power(twice[:-1]) > _SLOW_STEP_MPS2**2
    return (twice, four_times) if is_double else (once, twice)


def in_phase(amplitudes: FloatArray, phase_rad: float) -> FloatArray:
    """Part (2,) of the horizontal amplitudes, m/s2, in phase with the vertical one advanced by an angle."""
    horizontal, vertical = amplitudes[:2], amplitudes[2]
    size = abs(vertical)
    if size == 0:
        return np.zeros(2)
    return np.asarray((horizontal * (vertical / size * np.exp(1j * phase_rad)).conjugate()).real)


def power(amplitudes: FloatArray) -> float:
    """Squared amplitude of all signals together."""
    return float((amplitudes * amplitudes.conj()).real.sum())


@lru_cache(maxsize=512)
def _waves(n: int) -> NDArray[np.complex128]:
    """Waves (3, N) once, twice and four times in N samples, scaled to give amplitudes; phases are at the middle."""
    part = (np.arange(n) - 0.5 * (n - 1)) / n
    waves: NDArray[np.complex128] = np.exp(-2j * np.pi * np.outer([1.0, 2.0, 4.0], part))
    # the faster ones have no slope, so that a slow change does not enter; of the first too little would remain
    waves[1:] -= np.outer(waves[1:] @ part / (part @ part), part)
    return 2.0 / n * waves


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of two vectors (3,): np.cross takes ten times as long."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def across(axis: FloatArray, up: FloatArray) -> FloatArray:
    """Unit vector (3,): the part of an axis across up."""
    flat = axis - float(axis @ up) * up
    return flat / math.sqrt(float(flat @ flat))
