"""Restore gravity in recordings whose acceleration lacks it ("linear acceleration", "user acceleration").

The gyroscope gives a frame that hardly rotates in the world: the attitude of the phone relative to the start of a
segment. In this frame the vertical is nearly constant. Windows of 8 s in which a person walks show its axis:

- The acceleration of walking is largest along the vertical.
- The acceleration at step frequency lies in the vertical plane of the walking direction. Its smallest component is
  sideways, and therefore horizontal.
- A person turns about the vertical. The phone follows, so that its angular rate over several steps is vertical.

The largest eigenvector of the weighted sum over neighbouring windows is the axis. Three cues show which end is up:

- In a pocket or a swinging hand the phone is a pendulum at half the step frequency. Its pivot is above it: for the
  angular rate w and a lever arm r the acceleration is dw/dt x r, and Im(conj(w) x a) points to the pivot.
- At mid-stance the leg and the arm swing fastest, and the body is highest. The phase of the acceleration at step
  frequency relative to the squared angular rate shows up.
- The screen of a phone in the hand faces up.

Only whole recordings can be restored: the estimate uses windows before and after each sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from vqf import VQF

from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples, interpolated
from pdr_filter.values.quaternions import rotation_matrix
from pdr_filter.values.recording import Recording

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
# Weight of the angular rate, per (rad/s)2, relative to the share of the acceleration.
_TURN_WEIGHT = 10.0
# Weights of the cues for the sense of the axis: pendulum, phase and screen; and the margin of a sure decision.
_PENDULUM, _PHASE, _SCREEN = 1.5, 1.0, 0.75
_SURE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Restored:
    """Specific force of a recording without gravity.

    Attributes
    ----------
    force : Samples
        Specific force at the times of the acceleration, m/s2.
    is_sense_sure : bool
        True if the cues for up agree. Otherwise the path may be mirrored.
    """

    force: Samples
    is_sense_sure: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Cues of one walked window, in the frame of the gyroscope."""

    time_s: float
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
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()
    """
    up_s, up, sense = _up(_uniform_blocks(acceleration, gyroscope))
    ups = interpolated(acceleration.time_s, up_s, up)
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    force = Samples(acceleration.time_s, acceleration.values + STANDARD_GRAVITY_MPS2 * ups)
    return Restored(force, sense > _SURE)


def _uniform_blocks(acceleration: Samples, gyroscope: Samples | None) -> list[UniformBlock]:
    """Return uniform samples, one block for each segment between gaps."""
    conditioner = Conditioner()
    state, blocks = conditioner.update(
        conditioner.init(), merge_streams(Recording("", acceleration, gyroscope=gyroscope))
    )
    return blocks


def _up(blocks: list[UniformBlock]) -> tuple[FloatArray, FloatArray, float]:
    """Return times (K,), up in the sensor frame (K, 3), and the mean agreement of the cues for its sense."""
    times, ups, senses = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for block in blocks:
        turned = _attitude(block)
        windows = _windows(block, turned)
        if not windows:
            continue
        at_s = np.array([w.time_s for w in windows])
        up, sense = _smoothed(at_s, np.array([w.axis for w in windows]), np.array([w.sense for w in windows]))
        in_frame = interpolated(block.time_s, at_s, up)
        times.append(block.time_s)
        ups.append(np.einsum("nji,nj->ni", turned, in_frame))
        senses.append(sense)
    found = np.concatenate(senses) if senses else np.empty(0)
    if len(found) < _LEAST_WINDOWS:
        raise ValueError(
            "the acceleration is without gravity, and nobody walks in it for 12 s, which would show the vertical: "
            "record the acceleration with gravity, or walk for longer"
        )
    return np.concatenate(times), np.concatenate(ups), float(found.mean())


def _attitude(block: UniformBlock) -> FloatArray:
    """Return rotation matrices (N, 3, 3) from the sensor to the frame of the first sample, from the gyroscope alone."""
    rate = np.where(block.angular_rate_known[:, None], block.angular_rate_radps, 0.0)
    vqf = VQF(0.01, motionBiasEstEnabled=False, restBiasEstEnabled=False)
    return rotation_matrix(vqf.updateBatchFullState(np.ascontiguousarray(rate), np.zeros_like(rate))["gyrQuat"])


def _windows(block: UniformBlock, turned: FloatArray) -> list[_Window]:
    """Return the cues of the walked windows of a segment."""
    rate_hz = 100.0
    n, hop, n_turn = (round(s * rate_hz) for s in (_WINDOW_S, _HOP_S, _TURN_S))
    accelerations = np.einsum("nij,nj->ni", turned, block.specific_force_mps2)
    rate = np.where(block.angular_rate_known[:, None], block.angular_rate_radps, 0.0)
    rates = np.einsum("nij,nj->ni", turned, rate)
    hann, hann_turn = np.hanning(n), np.hanning(n_turn) / np.hanning(n_turn).sum()
    n_fft = 8 * n
    steps = np.rint(np.outer(_HARMONICS, _STEP_HZ) / 2 * n_fft / rate_hz).astype(int)  # (6, F)
    band = slice(*(round(hz * n_fft / rate_hz) for hz in _BAND_HZ))
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
        axis = a.T @ a / (n * power) - np.outer(sideways, sideways) + _TURN_WEIGHT * turns.T @ turns / len(turns)
        swung = float(np.linalg.norm(swing[0]))
        screen = turned[rows][:, :, 2].mean(axis=0)
        sense = _SCREEN * screen
        if swung > 0:
            pivot = np.imag(np.cross(swing[0].conj(), force[0])) / (swung * np.linalg.norm(force[0]))
            phase = np.imag(force[1] * np.conj(swing[0] @ swing[0])) / (np.linalg.norm(force[1]) * swung**2)
            sense = sense + _PENDULUM * pivot + _PHASE * phase
        found.append(_Window(float(block.time_s[start + n // 2]), axis, sense))
    return found


def _smoothed(at_s: FloatArray, axes: FloatArray, senses: FloatArray) -> tuple[FloatArray, FloatArray]:
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
