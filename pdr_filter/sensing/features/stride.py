"""Features of the harmonics of the stride: how force and rotation are distributed over them.

A window holds two or three strides, so the bins of its spectrum are wider than the difference between walking and
stairs. The frequency f of the stride is therefore estimated first. Each signal is then fitted by a sum of `N_HARMONICS`
harmonics of f. Even harmonics repeat every step, odd ones distinguish left from right. Shares of harmonics do not
change with step frequency or pace, and no feature depends on the attitude or handedness of the device.

The frequency is the one of `STRIDES_HZ` at which even harmonics explain the vertical force and odd harmonics explain
the swing of the limb best. At half of the true frequency all harmonics would be even, and at twice none would fit.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.sensing.features.invariant import (
    MotionLines,
    about_mean,
    columns,
    hann_taper,
    side_by_side,
)
from pdr_filter.values import FloatArray, IntArray

# Candidate stride frequencies, Hz, from slow walkers (0.5) to sprinters (1.6). The spacing of 5 % is less than the
# tenth of a cycle that a window of two seconds resolves.
STRIDES_HZ: FloatArray = np.geomspace(0.5, 1.6, 24)
# The harmonics reach three times the step frequency, up to which phones in pockets and hands follow the body.
N_HARMONICS = 6
LINES: tuple[str, ...] = ("vertical", "forward", "lateral", "swing_rate", "yaw_rate", "roll_rate")
VERTICAL, FORWARD, LATERAL, SWING, YAW, ROLL = range(len(LINES))
# Phases as products of powers of complex harmonics, (line, harmonic, power), with the conjugate for a negative power.
# They do not depend on the start of the window, because harmonic times power adds up to zero. They do not depend on the
# sign of the swing axis either, which reverses `FORWARD`, `LATERAL`, `SWING` and `ROLL`, because the powers of these
# lines add up to an even number.
PHASES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "swing": ((SWING, 1, 2), (VERTICAL, 2, -1)),
    "yaw": ((YAW, 1, 2), (VERTICAL, 2, -1)),
    "lateral": ((LATERAL, 1, 2), (VERTICAL, 2, -1)),
    "forward": ((FORWARD, 1, 2), (VERTICAL, 2, -1)),
    "vertical_1": ((VERTICAL, 1, 2), (VERTICAL, 2, -1)),
    "vertical_4": ((VERTICAL, 4, 1), (VERTICAL, 2, -2)),
    "vertical_6": ((VERTICAL, 6, 1), (VERTICAL, 2, -3)),
    "forward_against_swing": ((FORWARD, 1, 1), (SWING, 1, -1)),
    "forward_2_against_swing_2": ((FORWARD, 2, 1), (SWING, 2, -1)),
    "forward_2": ((FORWARD, 2, 2), (VERTICAL, 2, -2)),
    "lateral_2": ((LATERAL, 2, 2), (VERTICAL, 2, -2)),
    "swing_2": ((SWING, 2, 2), (VERTICAL, 2, -2)),
    "swing_3": ((SWING, 3, 1), (SWING, 1, -1), (VERTICAL, 2, -1)),
    "yaw_against_swing": ((YAW, 1, 2), (SWING, 1, -2)),
}
NAMES: tuple[str, ...] = (
    "stride_hz",
    "stride_fit",
    *(f"periodic_share_{line}" for line in LINES),
    *(f"share_of_harmonic_{k}_{line}" for line in LINES for k in range(1, N_HARMONICS + 1)),
    *(f"log_periodic_{line}_to_vertical" for line in LINES[1:]),
    "log_bounce_m",
    "log_swing_rad",
    "log_forward_to_vertical_step",
    *(f"{part}_of_phase_{name}" for name in PHASES for part in ("cosine", "sine")),
)
# Noise of each line (accelerometer, m/s2; gyroscope, rad/s), of the swing angle (rad) and of the bounce (m).
_FLOOR = np.array([0.02, 0.02, 0.02, 0.005, 0.005, 0.005])
_FLOOR_RAD, _FLOOR_M = 0.01, 0.001
# Amplitudes below which the shares fade to zero, because the person does not walk.
_LEAST_SHARE_OF = 0.05, 0.05, 0.05, 0.02, 0.02, 0.02


@cache
def _harmonics(n: int, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return two matrices for each of S stride frequencies that fit H harmonics to a signal of N samples.

    The shapes are (S, N, K) and (S, K, K), with K = 1 + 2 H. The first matrix converts a tapered signal to orthonormal
    parts, whose squares sum to the explained power. The second converts these parts to coefficients: of the constant,
    and of the cosine and sine of each harmonic.
    """
    t = (np.arange(n) - (n - 1) / 2) / rate_hz
    root = hann_taper(n) ** 0.5
    phase = 2 * np.pi * STRIDES_HZ[:, None, None] * t[:, None] * np.arange(1, N_HARMONICS + 1)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(STRIDES_HZ), n, -1)
    design = np.concatenate([np.ones((len(STRIDES_HZ), n, 1)), waves], axis=2) * root[:, None]
    basis, triangle = np.linalg.qr(design)
    scale = np.sqrt(root @ root)
    to_coefficients = np.linalg.inv(triangle).transpose(0, 2, 1) * scale
    return np.ascontiguousarray(basis * root[:, None] / scale), np.ascontiguousarray(to_coefficients)


# Columns of `_harmonics` that are even in time (constant and cosines), and those that are odd (sines).
_EVEN, _ODD = [0, *range(1, 2 * N_HARMONICS, 2)], [*range(2, 2 * N_HARMONICS + 1, 2)]


@cache
def _side_by_side(n: int, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return the even and odd columns of the first matrix of `_harmonics`, restricted to the later half of the samples.

    They apply to a signal plus or minus its mirror image in time. The columns of all stride frequencies are next to
    each other.
    """
    later = _harmonics(n, rate_hz)[0][:, n // 2 :].copy()
    if n % 2:
        later[:, 0] *= 0.5  # the middle sample is its own mirror image, so it is counted twice
    even, odd = (later[:, :, column].swapaxes(0, 1).reshape(later.shape[1], -1) for column in (_EVEN, _ODD))
    return np.ascontiguousarray(even), np.ascontiguousarray(odd)


def _all_stride_parts(lines: FloatArray, rate_hz: float) -> FloatArray:
    """Return the orthonormal parts (W, S, L, K) of L tapered signals in W windows, (W, L, N), at S stride frequencies.

    The sum of a signal and its mirror image has only even parts, their difference only odd ones. This halves the work.
    """
    n_windows, n_lines, n = lines.shape
    later, earlier = lines[:, :, n // 2 :], lines[:, :, (n - 1) // 2 :: -1]
    even, odd = _side_by_side(n, rate_hz)
    parts = np.empty((n_windows, len(STRIDES_HZ), n_lines, 2 * N_HARMONICS + 1))
    for columns_, folded, matrix in ((_EVEN, later + earlier, even), (_ODD, later - earlier, odd)):
        parts[..., columns_] = (folded @ matrix).reshape(n_windows, n_lines, len(STRIDES_HZ), -1).swapaxes(1, 2)
    return parts


def stride_features_of_motion(motion: MotionLines, rate_hz: float) -> FloatArray:
    """Return the features (W, F) of a few windows, given their `invariant.motion_lines`."""
    n_windows, _, n = motion.centred.shape
    vertical, yaw_rate = motion.centred[:, 0], about_mean(motion.about_mean_up)
    lines = side_by_side(vertical, motion.across, motion.along, motion.rate, yaw_rate, motion.roll_rate)
    taper = hann_taper(n)
    scale = np.sqrt(np.add.reduce(lines * lines * taper, axis=2) / taper.sum()) + _FLOOR
    to_parts, to_coefficients = _harmonics(n, rate_hz)
    parts = _all_stride_parts((lines / scale[:, :, None])[:, [VERTICAL, SWING]], rate_hz)
    explained = np.add.reduce(parts * parts, axis=3)
    power = _harmonic_power(parts @ to_coefficients)
    in_step = np.empty(power.shape[:3])
    np.add.reduce(power[:, :, 0, 1::2], axis=2, out=in_step[:, :, 0])
    np.add.reduce(power[:, :, 1, 0::2], axis=2, out=in_step[:, :, 1])
    fit = np.add.reduce(explained * in_step / np.maximum(np.add.reduce(power, axis=3), 1e-9), axis=2)
    best = fit.argmax(axis=1)
    stride_hz = STRIDES_HZ[best]
    parts = lines @ to_parts[best]
    explained = np.add.reduce(parts * parts, axis=2) / scale**2
    coefficients = parts @ to_coefficients[best]
    amplitude = np.sqrt(2 * _harmonic_power(coefficients))
    total = np.sqrt(np.add.reduce(amplitude * amplitude, axis=2)) + _LEAST_SHARE_OF
    share = amplitude / total[:, :, None]
    log_total, step = np.log(total), amplitude[:, :, 1] + _LEAST_SHARE_OF
    return columns(
        [
            stride_hz,
            fit.max(axis=1),
            explained,
            share.reshape(n_windows, -1),
            log_total[:, 1:] - log_total[:, :1],
            np.log(amplitude[:, 0, 1] / (4 * np.pi * stride_hz) ** 2 + _FLOOR_M),
            np.log(amplitude[:, 3, 0] / (2 * np.pi * stride_hz) + _FLOOR_RAD),
            np.log(step[:, 1] / step[:, 0]),
            _phases(coefficients, amplitude, share),
        ]
    )


@cache
def _factors() -> tuple[IntArray, IntArray]:
    """Return the indices of the factors that `_phases` multiplies for each of `PHASES`: units (P, 4) and shares (P, 3).

    A phase of `PHASES` is a product of complex harmonics, each raised to a power. A share is the amplitude of a
    harmonic relative to all harmonics of its signal, 0 to 1.

    The units are the complex harmonics of all signals divided by their absolute values. They come signal by signal,
    followed by their conjugates and by 1. A harmonic with power p is repeated p times, and unused positions refer to
    the 1. The shares have the same order of harmonics and also end with 1.
    """
    n = len(LINES) * N_HARMONICS
    units, shares = np.full((len(PHASES), 4), 2 * n), np.full((len(PHASES), 3), n)
    for i, factors in enumerate(PHASES.values()):
        harmonics = [line * N_HARMONICS + harmonic - 1 for line, harmonic, _ in factors]
        powers = [power for _, _, power in factors]
        shares[i, : len(harmonics)] = harmonics
        repeated = [k + n * (power < 0) for k, power in zip(harmonics, powers, strict=True) for _ in range(abs(power))]
        units[i, : len(repeated)] = repeated
    return units, shares


def _phases(coefficients: FloatArray, amplitude: FloatArray, share: FloatArray) -> FloatArray:
    """Return cosine and sine (W, 2 P) of the P phases named in `PHASES`, times the shares of their harmonics.

    The shares (`_factors`) make the phase of noise vanish.
    """
    n_windows = len(share)
    unit = (coefficients[..., 1::2] - 1j * coefficients[..., 2::2]) / np.maximum(amplitude, 1e-12)
    unit, one = unit.reshape(n_windows, -1), np.ones((n_windows, 1))
    unit_indices, share_indices = _factors()
    units = np.concatenate([unit, unit.conj(), one], axis=1)[:, unit_indices]
    shares = np.concatenate([share.reshape(n_windows, -1), one], axis=1)[:, share_indices]
    product = units[..., 0] * units[..., 1] * units[..., 2] * units[..., 3]
    product = product * (shares[..., 0] * shares[..., 1] * shares[..., 2])
    return np.ascontiguousarray(product).view(np.float64)


def _harmonic_power(coefficients: FloatArray) -> FloatArray:
    """Return the mean power (..., H) of each of H harmonics from coefficients (..., 1 + 2 H)."""
    return 0.5 * (coefficients[..., 1::2] ** 2 + coefficients[..., 2::2] ** 2)
