"""Restore gravity in recordings whose acceleration lacks it ("linear acceleration", "user acceleration").

The gyroscope gives a frame that hardly rotates in the world: the attitude of the phone relative to the start of a
segment. In this frame the vertical is nearly constant. Windows of 8 s in which a person walks show its axis:

- The acceleration of walking is largest along the vertical.
- The acceleration at step frequency lies in the vertical plane of the walking direction. Its smallest component is
  sideways, and therefore horizontal.
- A person turns about the vertical. The phone follows, so that its angular rate over several steps is vertical.

With the acceleration a of a window, the angular rate w averaged over 4 s, and the unit vector n along the smallest
component of a at step frequency, the axis is the largest eigenvector of

    mean(a a') / mean(a' a) - n n' + 2 mean(w w') / (mean(w' w) + 0.1 rad2/s2),

averaged over neighbouring windows (Gaussian, 20 s). Three cues show which end is up:

- In a pocket or a swinging hand the phone is a pendulum at half the step frequency. Its pivot is above it: for the
  angular rate w and a lever arm r the acceleration is dw/dt x r, and Im(conj(w) x a) points to the pivot.
- At mid-stance the leg and the arm swing fastest, and the body is highest. The phase of the acceleration at step
  frequency relative to the squared angular rate shows up.
- The screen of a phone in the hand faces up.

With the Fourier components a_f and a_h of the acceleration at step frequency and at half of it, w_h of the angular
rate, and the direction z of the screen, up has a positive product with the mean over 60 s of

    1.5 Im(conj(w_h) x a_h) / (|w_h| |a_h|) + Im(a_f conj(w_h . w_h)) / (|a_f| |w_h|^2) + 0.75 z.

If the mean product is below 0.3, the path may be mirrored, and a note says so. Without a gyroscope the rotation of the
phone is not undone. Then w = 0, and only the components of a at multiples of the step frequency count.

Only whole recordings can be restored: the estimate uses windows before and after each sample.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from vqf import VQF

from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples, interpolated_rows, median
from pdr_filter.values.quaternions import rotation_matrix
from pdr_filter.values.recording import Recording

_RATE_HZ = Conditioner().rate_hz
_WINDOW_S, _HOP_S, _TURN_S = 8.0, 4.0, 4.0
# Step frequencies of walking and running, Hz.
_STEP_HZ = np.arange(1.3, 2.9, 0.02)
# Harmonics of half the step frequency.
_HARMONICS = np.arange(1, 7)
# A window is walked if its acceleration exceeds this root mean square, and if the power at the harmonics of its step
# frequency exceeds the mean power of the band by this factor.
_BAND_HZ = (0.4, 6.0)
_LEAST_RMS_MPS2, _LEAST_CONTRAST = 0.7, 2.2
# Smallest number of walked windows, 12 s of walking.
_LEAST_WINDOWS = 2
# Standard deviations of the weights of neighbouring windows. The axis drifts with the gyroscope; its sense does not.
_AXIS_S, _SENSE_S = 20.0, 60.0
# Weight of the direction of the angular rate, and the variance of the rate at which it has half of this weight. The
# directions of acceleration and sideways motion have the weights 1 and -1.
_TURN_WEIGHT, _TURN_VAR_RAD2PS2 = 2.0, 0.1
# A window whose acceleration exceeds the median of the walked windows by this factor is shaken, and is not used.
_SHAKEN = 2.5
# Weights of the cues for the sense of the axis: pendulum, phase and screen; and the margin of a sure decision.
_PENDULUM, _PHASE, _SCREEN = 1.5, 1.0, 0.75
_SURE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """Specific force of a recording without gravity."""

    force: Samples  # specific force at the times of the acceleration, m/s2
    is_sense_sure: bool  # True if the cues for up agree. Otherwise the path may be mirrored.


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """Uniform samples without a gap, and their rotation (N, 3, 3) to the frame of the first one."""

    time_s: FloatArray
    acceleration: FloatArray
    rate: FloatArray
    turned: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Cues for the vertical from one window in which a person walks: its axis, and which end of the axis is up.

    `axis` is a symmetric matrix whose quadratic form is largest along the vertical. `sense` is a vector whose component
    along up is positive. Both are in the frame of the first sample of the segment, which the gyroscope alone maintains.
    `time_s` is the middle of the window, and `rms_mps2` the root mean square of its acceleration without the mean.
    """

    time_s: float
    rms_mps2: float
    axis: FloatArray  # (3, 3), largest along the vertical
    sense: FloatArray  # (3,), positive along up


def with_gravity(acceleration: Samples, gyroscope: Samples | None = None) -> Restored:
    """Return the specific force of a walk from its acceleration without gravity.

    Parameters
    ----------
    acceleration : Samples
        Acceleration without gravity in the sensor frame, shape (N, 3), m/s2, with Android's sign.
    gyroscope : Samples, optional
        Angular rate, shape (M, 3), rad/s. Without it the attitude is taken as constant, so that only steps and distance
        can be trusted.

    Returns
    -------
    Restored
        Specific force, with the same times.

    Raises
    ------
    ValueError
        If nobody walks in the recording for at least 12 s.

    Examples
    --------
    A walk with the phone in the hand, whose tilt hardly changes, without its mean:

    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.gravity import with_gravity
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=40.0)])
    >>> force = walk.accelerometer
    >>> linear = pdr.Samples(force.time_s, force.values - force.values.mean(axis=0))
    >>> restored = with_gravity(linear, walk.gyroscope)
    >>> error_mps2 = (restored.force.values - force.values).mean(axis=0)
    >>> bool(np.linalg.norm(error_mps2) < 2.0), restored.is_sense_sure
    (True, True)
    """
    up_s, up, sense = _up(_segments(acceleration, gyroscope))
    ups = interpolated_rows(acceleration.time_s, up_s, up)
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    force = Samples(acceleration.time_s, acceleration.values + STANDARD_GRAVITY_MPS2 * ups)
    return Restored(force, sense > _SURE)


def _segments(acceleration: Samples, gyroscope: Samples | None) -> list[_Segment]:
    """Return the parts of a recording between gaps of a sensor. Without a gyroscope the angular rate is zero."""
    conditioner = Conditioner()
    merged = merge_streams(Recording("", acceleration, gyroscope=gyroscope))
    _, blocks = conditioner.update(conditioner.init(), merged)
    is_known = any(block.angular_rate_known.any() for block in blocks)
    found = list[_Segment]()
    for block in blocks:
        known = block.angular_rate_known if is_known else np.ones(len(block.time_s), dtype=bool)
        ends = [0, *(np.flatnonzero(np.diff(known)) + 1), len(known)]
        for rows in (slice(*pair) for pair in itertools.pairwise(ends) if known[pair[0]]):
            rate = block.angular_rate_radps[rows] if is_known else np.zeros_like(block.angular_rate_radps[rows])
            found.append(_Segment(block.time_s[rows], block.specific_force_mps2[rows], rate, _rotation_matrices(rate)))
    return found


def _rotation_matrices(rate: FloatArray) -> FloatArray:
    """Return rotation matrices (N, 3, 3) from the sensor to the frame of the first sample, from the gyroscope alone."""
    vqf = VQF(1 / _RATE_HZ, motionBiasEstEnabled=False, restBiasEstEnabled=False)
    return rotation_matrix(vqf.updateBatchFullState(np.ascontiguousarray(rate), np.zeros_like(rate))["gyrQuat"])


def _up(segments: Sequence[_Segment]) -> tuple[FloatArray, FloatArray, float]:
    """Return times (K,), up in the sensor frame (K, 3), and the mean agreement of the cues for its sense."""
    times, ups, senses = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    walked = [_walked_windows(segment) for segment in segments]
    all_rms = np.array([w.rms_mps2 for windows in walked for w in windows])
    for segment, walked_here in zip(segments, walked, strict=True):
        windows = [w for w in walked_here if w.rms_mps2 < _SHAKEN * median(all_rms)]
        if not windows:
            continue
        at_s = np.array([w.time_s for w in windows])
        up, sense = _local_up(at_s, np.array([w.axis for w in windows]), np.array([w.sense for w in windows]))
        times.append(segment.time_s)
        ups.append(np.einsum("nji,nj->ni", segment.turned, interpolated_rows(segment.time_s, at_s, up)))
        senses.append(sense)
    found = np.concatenate(senses) if senses else np.empty(0)
    if len(found) < _LEAST_WINDOWS:
        raise ValueError(
            "the acceleration lacks gravity, and nobody walks in it for 12 s, which would show the vertical: walk for "
            "longer"
        )
    return np.concatenate(times), np.concatenate(ups), float(found.mean())


def _walked_windows(segment: _Segment) -> list[_Window]:
    """Return the cues of the walked windows of a segment."""
    n, hop, n_turn = (round(s * _RATE_HZ) for s in (_WINDOW_S, _HOP_S, _TURN_S))
    accelerations, rates = (np.einsum("nij,nj->ni", segment.turned, x) for x in (segment.acceleration, segment.rate))
    hann, hann_turn = np.hanning(n), np.hanning(n_turn) / np.hanning(n_turn).sum()
    n_fft = 8 * n
    steps = np.rint(np.outer(_HARMONICS, _STEP_HZ) / 2 * n_fft / _RATE_HZ).astype(int)  # (6, F)
    band = slice(*(round(hz * n_fft / _RATE_HZ) for hz in _BAND_HZ))
    found = list[_Window]()
    for start in range(0, len(accelerations) - n + 1, hop):
        rows = slice(start, start + n)
        a, w = accelerations[rows] - accelerations[rows].mean(axis=0), rates[rows]
        power = float((a * a).sum() / n)
        if power < _LEAST_RMS_MPS2**2:
            continue
        at = np.fft.rfft(np.hstack([a, w - w.mean(axis=0)]) * hann[:, None], n_fft, axis=0) / (0.5 * hann.sum())
        by_frequency = (np.abs(at[:, :3]) ** 2).sum(axis=1)
        best = by_frequency[steps].sum(axis=0).argmax()
        if by_frequency[steps[:, best]].mean() < _LEAST_CONTRAST * by_frequency[band].mean():
            continue
        force, swing = at[steps[:, best], :3], at[steps[:, best], 3:]
        turns = np.array([hann_turn @ w[k : k + n_turn] for k in range(0, n - n_turn + 1, n_turn // 4)])
        at_step = np.real(np.outer(force[1], force[1].conj()))
        sideways = np.linalg.eigh(at_step)[1][:, 0]
        turn = turns.T @ turns / len(turns)
        shaken = a.T @ a
        if not rates.any():  # without gyroscope the swing of the phone, at odd harmonics, is not undone
            shaken = np.real(force[1::2].T @ force[1::2].conj())
        axis = shaken / np.trace(shaken) - np.outer(sideways, sideways)
        axis += _TURN_WEIGHT * turn / (np.trace(turn) + _TURN_VAR_RAD2PS2)
        swung = float(np.linalg.norm(swing[0]))
        screen = segment.turned[rows, :, 2].mean(axis=0)
        sense = _SCREEN * screen
        if swung > 0:
            half, full = (force[k] / max(float(np.linalg.norm(force[k])), 1e-12) for k in (0, 1))
            pivot = np.imag(np.cross(swing[0].conj(), half)) / swung
            phase = np.imag(full * np.conj(swing[0] @ swing[0])) / swung**2
            sense = sense + _PENDULUM * pivot + _PHASE * phase
        found.append(_Window(float(segment.time_s[start + n // 2]), power**0.5, axis, sense))
    return found


def _local_up(at_s: FloatArray, axes: FloatArray, senses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return up (W, 3) and the agreement (W,) of the cues with it, from all windows near each window."""
    up, agreement = np.empty((len(at_s), 3)), np.empty(len(at_s))
    for k, time_s in enumerate(at_s):
        near = slice(*np.searchsorted(at_s, [time_s - 4 * _SENSE_S, time_s + 4 * _SENSE_S]))
        away_s = at_s[near] - time_s
        axis_weight, sense_weight = (np.exp(-0.5 * (away_s / s) ** 2) for s in (_AXIS_S, _SENSE_S))
        axis = np.linalg.eigh(np.tensordot(axis_weight, axes[near], 1))[1][:, -1]
        agree = float(axis @ (sense_weight @ senses[near])) / sense_weight.sum()
        up[k], agreement[k] = (axis, agree) if agree >= 0 else (-axis, -agree)
    return up, agreement
