"""Features that show where a moving person carries the phone: its attitude, rotation and vibration.

While reading, the screen faces up and the phone hardly rotates. At the ear the phone stands on its edge. In a swinging
hand it tilts by tens of degrees in each stride about one axis, at the end of a lever, the arm. In a trouser pocket it
tilts with the thigh, and heel strikes reach it strongly, also sideways. Angles are computed from the spectrum of the
angular rate, each bin divided by 2 pi f, so that neither drift nor the start of the window matters. Features relative
to the vertical acceleration of the step do not grow with the pace.

Only absolute components of up are used, and whether the screen faces up, because signs would memorise habits. No
feature depends on north, on left or right, or on which end of the phone is up. The features are meaningful only for
windows of a moving person, because a phone at rest has no carrying mode.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.sensing.features.invariant import (
    MotionLines,
    columns,
    hann_taper,
    mean_of,
    mean_square,
    side_by_side,
)
from pdr_filter.values import STANDARD_GRAVITY_MPS2, ComplexArray, FloatArray

ATTITUDE: tuple[str, ...] = (
    "screen_up",
    "lowest_screen_up",
    "screen_up_share",
    "abs_up_x",
    "abs_up_y",
    "abs_up_z",
    "squared_up_x",
    "squared_up_y",
    "long_axis_aslant",
)
_FORCE_NAMES: tuple[str, ...] = (
    "log_vertical",
    "log_horizontal_to_vertical",
    "log_vertical_4_7.5_hz_share",
    "log_horizontal_4_7.5_hz_to_vertical",
    "log_vertical_7.5_12_hz_share",
    "log_horizontal_7.5_12_hz_to_vertical",
    "log_vertical_12_20_hz_share",
    "log_horizontal_12_20_hz_to_vertical",
    "log_vertical_stride_to_step",
    "log_horizontal_stride_to_vertical_step",
    "log_horizontal_step_to_vertical_step",
    "vertical_skewness",
    "log_vertical_kurtosis",
    "horizontal_on_one_line",
)
_TURNING_NAMES: tuple[str, ...] = (
    "log_tilt_angle",
    "log_yaw_angle",
    "log_stride_tilt_angle",
    "log_tilt_stride_to_step",
    "log_tilt_angle_to_vertical",
    "log_tilt_to_yaw_angle",
    "log_tilt_rate",
    "log_tilt_rate_4_12_hz_share",
    "tilts_about_one_axis",
    "log_lever_m",
    "lever_coherence",
    "log_horizontal_to_tilted_gravity",
    "share_of_turning_about_x",
    "share_of_turning_about_y",
    "share_of_turning_about_z",
)
WITHOUT_GYROSCOPE: tuple[str, ...] = (*ATTITUDE, *_FORCE_NAMES)
NAMES: tuple[str, ...] = (*WITHOUT_GYROSCOPE, *_TURNING_NAMES)

# Added to amplitudes before the logarithm: the noise of the sensors of a phone, and a tenth of a degree.
_FLOOR_MPS2, _FLOOR_RADPS, _FLOOR_RAD = 0.02, 0.005, 0.002
# Component of up along the screen normal above which the screen faces up: at most 60 degrees from horizontal, cos 60.
_FACES_UP = 0.5
# Quantile of the screen direction taken as its lowest value. A tenth of the window is longer than a single knock.
_LOWEST = 0.1
# Bands of heel impacts, Hz. The remaining power in each band shows how the body between heel and phone damps impacts.
_IMPACTS_HZ: tuple[tuple[float, float], ...] = ((4.0, 7.5), (7.5, 12.0), (12.0, 20.0))
# Band of angles, Hz, from the slowest stride to the fastest step. Slower rotation is a turn of the person, or drift.
_ANGLE_HZ = (0.5, 3.5)
_STRIDE_HZ = (0.5, 1.3)
_SWING_HZ = (0.5, 1.8)  # swing of a limb up to the fastest stride, without the steps
_FAST_HZ = (4.0, 12.0)  # rocking of a loose phone
_BANDS_HZ = (*_IMPACTS_HZ, _ANGLE_HZ, _STRIDE_HZ, _SWING_HZ, _FAST_HZ, (0.0, np.inf))
_IMPACTS, _ANGLE, _STRIDE, _SWING, _FAST, _ALL = slice(0, 3), 3, 4, 5, 6, 7
# Band that contains the step frequency from slow walking to running, Hz. The strongest vertical frequency in it is
# taken as the step frequency.
_STEP_HZ = (1.25, 3.3)
# Noise variances that make the lever vanish at small rotation, (0.14 rad/s2)^2, and the coherence at small motion,
# (0.03 rad/s2)^2 and (0.03 m/s2)^2. The third value is added to the lever before the logarithm, m: the thickness of a
# hand.
_LEVER_NOISE, _COHERENCE_NOISE, _FLOOR_M = 0.02, 1e-3, 0.05


def carrying_features_of_motion(motion: MotionLines, rate_hz: float) -> FloatArray:
    """Return the features (W, 38) of a few windows, given their `motion_lines`, in the order of `NAMES`.

    A missing gyroscope is given as three rows of zeros. The features named in `WITHOUT_GYROSCOPE` do not use it.
    """
    n = motion.centred.shape[2]
    centred = np.concatenate([motion.centred[:, :3], motion.turning], axis=1)
    spectrum = np.fft.rfft(centred * hann_taper(n))
    # Power spectra, each of which sums to a variance: vertical, horizontal, tilt rate, tilt angle, yaw angle.
    axis_power = _squared_abs(spectrum) * (2.0 / n**2)
    tilt, squared_omega = axis_power[:, 3] + axis_power[:, 4] + axis_power[:, 5], _omega(n, rate_hz) ** 2
    horizontal, yaw = axis_power[:, 1] + axis_power[:, 2], axis_power[:, 6]
    power = side_by_side(axis_power[:, 0], horizontal, tilt, tilt / squared_omega, yaw / squared_omega)
    bands = power @ _bin_sums(n, rate_hz)
    about_axes = mean_square(motion.centred[:, 3:6])
    stride, step = _stride_and_step(power, n, rate_hz)
    return columns(
        [
            _attitude_features(motion.windows[:, 8], motion.mean[:, 6:9]),
            _force_features(centred[:, :3], bands, stride, step),
            _rotation_features(motion, spectrum, bands, stride, step, rate_hz),
            about_axes / (np.add.reduce(about_axes, axis=1) + _FLOOR_RADPS**2)[:, None],
        ]
    )


def _attitude_features(screen: FloatArray, mean_up: FloatArray) -> FloatArray:
    """Return the features of the attitude (W, 9), in the order of `ATTITUDE`.

    `screen` (W, N) is the component of up along the screen normal, and `mean_up` (W, 3) the mean of up.
    """
    mean = mean_up / (np.sqrt(np.add.reduce(mean_up * mean_up, axis=1)) + 1e-9)[:, None]
    x, y, z = np.abs(mean).T
    lowest = np.sort(screen, axis=1)[:, int(_LOWEST * screen.shape[1])]
    return columns(
        [
            np.maximum(mean[:, 2], 0.0),
            np.clip(lowest, 0.0, 1.0),
            np.add.reduce(screen > _FACES_UP, axis=1, dtype=np.float64) / screen.shape[1],
            x,
            y,
            z,
            x * x,
            y * y,
            x * y,  # largest (0.5) when the long axis is 45 degrees off the vertical, as from ear to mouth
        ]
    )


def _force_features(force: FloatArray, bands: FloatArray, stride: FloatArray, step: FloatArray) -> FloatArray:
    """Return the features of the specific force (W, 14), in the order of `_FORCE_NAMES`.

    `force` (W, 3, N) is the centred vertical, east and north specific force. Most features are relative to the vertical
    force, so that they do not depend on how hard the person steps.
    """
    vertical, east, north = force[:, 0], force[:, 1], force[:, 2]
    size = _log_rms(bands[:, :2, _ALL], _FLOOR_MPS2)
    impacts = _log_rms(bands[:, :2, _IMPACTS], _FLOOR_MPS2) - size[:, :1, None]
    stride_size, step_size = _log_rms(stride[:, :2], _FLOOR_MPS2), _log_rms(step[:, :2], _FLOOR_MPS2)
    scaled = vertical / (np.sqrt(mean_square(vertical)) + _FLOOR_MPS2)[:, None]
    squared = scaled * scaled
    # (a - b) / (a + b) with the variances a and b along the main horizontal axis and across it
    squared_east, squared_north = east * east, north * north
    difference, mixed = mean_of(squared_east - squared_north), 2 * mean_of(east * north)
    total = mean_of(squared_east + squared_north)
    return columns(
        [
            size[:, 0],
            size[:, 1] - size[:, 0],
            impacts.transpose(0, 2, 1).reshape(len(force), -1),
            stride_size[:, 0] - step_size[:, 0],
            stride_size[:, 1] - step_size[:, 0],
            step_size[:, 1] - step_size[:, 0],
            mean_of(squared * scaled),
            np.log(mean_square(squared) + 0.5),
            np.sqrt(difference * difference + mixed * mixed) / (total + _FLOOR_MPS2**2),
        ]
    )


def _rotation_features(
    motion: MotionLines,
    spectrum: ComplexArray,
    bands: FloatArray,
    stride: FloatArray,
    step: FloatArray,
    rate_hz: float,
) -> FloatArray:
    """Return the features of the rotation (W, 12): `_TURNING_NAMES` without the last three."""
    n, variance, axes = motion.centred.shape[2], motion.variance[2], motion.axes[2]
    size = _log_rms(bands[:, 0, _ALL], _FLOOR_MPS2)
    tilt, yaw = _log_rms(bands[:, 3, _ANGLE], _FLOOR_RAD), _log_rms(bands[:, 4, _ANGLE], _FLOOR_RAD)
    tilt_rate_size = _log_rms(bands[:, 2, _ALL], _FLOOR_RADPS)
    swing = slice(*_bins(_SWING_HZ, n, rate_hz))
    main_rate = np.add.reduce(axes[:, :, 2][:, :, None] * spectrum[:, 3:6, swing], axis=1)
    lever, coherence = _lever(main_rate * _omega(n, rate_hz)[swing], spectrum[:, 1:3, swing], n)
    return columns(
        [
            tilt,
            yaw,
            _log_rms(bands[:, 3, _STRIDE], _FLOOR_RAD),
            _log_rms(stride[:, 3], _FLOOR_RAD) - _log_rms(step[:, 3], _FLOOR_RAD),
            tilt - size,
            tilt - yaw,
            tilt_rate_size,
            _log_rms(bands[:, 2, _FAST], _FLOOR_RADPS) - tilt_rate_size,
            (variance[:, 2] - variance[:, 1]) / (np.add.reduce(variance, axis=1) + _FLOOR_RADPS**2),
            np.log(lever + _FLOOR_M),
            coherence,
            # A phone that only tilts has a horizontal force of gravity times the tilt angle, so this log ratio is 0.
            _log_rms(bands[:, 1, _SWING], _FLOOR_MPS2)
            - np.log(STANDARD_GRAVITY_MPS2)
            - _log_rms(bands[:, 3, _SWING], _FLOOR_RAD),
        ]
    )


def _lever(acceleration_about: ComplexArray, horizontal: ComplexArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the length of the lever, (W,) in m, and the share of the horizontal force that it explains, (W,), 0 to 1.

    The lever is the distance from the axis about which the phone tilts to the phone, such as the length of a swinging
    arm. It is the factor from the angular acceleration to the horizontal specific force.

    `acceleration_about` (W, B) is the spectrum of the angular acceleration about the main axis. `horizontal` (W, 2, B)
    is the spectrum of the horizontal specific force. The windows have `n` samples.
    """
    # Least squares of the horizontal acceleration on the angular one. The factor i between angular rate and angular
    # acceleration is omitted, because only absolute values are used.
    product = np.add.reduce(horizontal * acceleration_about.conj()[:, None], axis=2)
    matched = np.add.reduce(_squared_abs(product), axis=1)
    about = np.add.reduce(_squared_abs(acceleration_about), axis=1)
    moved = np.add.reduce(np.add.reduce(_squared_abs(horizontal), axis=2), axis=1)
    noise = n**2 / 2.0  # summed squared spectrum of a line with variance one
    lever = np.sqrt(matched) / (about + _LEVER_NOISE * noise)
    coherence = matched / ((about + _COHERENCE_NOISE * noise) * (moved + _COHERENCE_NOISE * noise))
    return lever, coherence


def _squared_abs(values: ComplexArray) -> FloatArray:
    """Return the squared absolute values of complex numbers, without the square root that `abs` computes."""
    return values.real**2 + values.imag**2


def _stride_and_step(power: FloatArray, n: int, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return the power (W, L) of spectra (W, L, K) at stride frequency and at step frequency.

    The step frequency is the frequency of the strongest vertical motion.
    """
    first, last = _bins(_STEP_HZ, n, rate_hz)
    step = first + power[:, 0, first:last].argmax(axis=1)
    stride = np.maximum(step // 2, 1)
    window = np.arange(len(power))
    # For a step at an odd bin, the stride frequency lies between two bins.
    at_stride = power[window, :, stride] + power[window, :, stride + 1] * (step % 2)[:, None]
    return at_stride, power[window, :, step - 1] + power[window, :, step] + power[window, :, step + 1]


def _log_rms(power: FloatArray, floor: float) -> FloatArray:
    """Return the logarithm of the rms amplitude for a power, with a floor of the amplitude."""
    return np.asarray(0.5 * np.log(power + floor**2))


@cache
def _omega(n: int, rate_hz: float) -> FloatArray:
    """Return the angular frequency of each bin, rad/s. The bin of zero frequency has the value of the next bin."""
    bins = np.arange(n // 2 + 1, dtype=np.float64)
    return 2 * np.pi * rate_hz / n * np.maximum(bins, 1.0)


@cache
def _bins(band_hz: tuple[float, float], n: int, rate_hz: float) -> tuple[int, int]:
    """Return the first bin of a band and the first bin after it."""
    frequency_hz = np.arange(n // 2 + 1) * rate_hz / n
    first, last = np.searchsorted(frequency_hz, np.array(band_hz) - 1e-9)
    return int(first), int(last)


@cache
def _bin_sums(n: int, rate_hz: float) -> FloatArray:
    """Return the matrix (n // 2 + 1, B) that sums the bins of each of `_BANDS_HZ`."""
    matrix = np.zeros((n // 2 + 1, len(_BANDS_HZ)))
    for column, band in enumerate(_BANDS_HZ):
        first, last = _bins(band, n, rate_hz)
        matrix[first:last, column] = 1.0
    return matrix
