"""Features that show where a moving person carries the phone: its attitude, how it turns and what shakes it.

Held for reading, the screen looks up and the phone barely turns. At the ear it stands on its edge. In a swinging hand
it tilts by tens of degrees once a stride about one axis, at the end of a lever, the arm. In a trouser pocket it tilts
with the thigh, and heel strikes reach it hard, sideways too. Angles come from the spectrum of the rate, each bin
divided by 2 pi f, so neither drift nor the start of the window matters; relative to the vertical acceleration, the step
itself, they do not grow with the pace.

Of the attitude only sizes of the components of up enter, and whether the screen faces up: a sign memorises habits.
Nothing depends on north, on left or right, or on which end of the phone is up. Use them of windows of a moving person
only: a phone that lies still is carried nowhere.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.sensing.features.invariant import about_mean, columns, hann_taper, in_groups, mean_square
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

# Floors of amplitudes before the logarithm: the noise of a phone's sensors, and a tenth of a degree.
_FLOOR_MPS2, _FLOOR_RADPS, _FLOOR_RAD = 0.02, 0.005, 0.002
# The screen faces up when it leans less than 60 degrees from level: cos 60.
_FACES_UP = 0.5
# The lowest that the screen faces up: below it for a tenth of the window, which one knock is not.
_LOWEST = 0.1
# How much of a heel strike is left, in which band, shows what lies between heel and phone.
_BLOWS_HZ: tuple[tuple[float, float], ...] = ((4.0, 7.5), (7.5, 12.0), (12.0, 20.0))
# Angles: from the slowest stride to the fastest step; slower is turning round a corner, and drift.
_ANGLE_HZ = (0.5, 3.5)
_STRIDE_HZ = (0.5, 1.3)
_SWING_HZ = (0.5, 1.8)  # a limb's swing and its fastest stride, without the step
_FAST_HZ = (4.0, 12.0)  # rocking of a loose phone
_BANDS_HZ = (*_BLOWS_HZ, _ANGLE_HZ, _STRIDE_HZ, _SWING_HZ, _FAST_HZ, (0.0, np.inf))
_BLOWS, _ANGLE, _STRIDE, _SWING, _FAST, _ALL = slice(0, 3), 3, 4, 5, 6, 7
# The strongest vertical frequency from a slow walk to a run is the step's.
_STEP_HZ = (1.25, 3.3)
# Variances below which there is no lever to speak of, (0.14 rad/s2)^2, and no coherence, (0.03 rad/s2)^2 and
# (0.03 m/s2)^2; and the floor of the lever, m, before the logarithm: the thickness of a hand.
_LEVER_NOISE, _COHERENCE_NOISE, _FLOOR_M = 0.02, 1e-3, 0.05


def carrying_features(windows: FloatArray, rate_hz: float) -> FloatArray:
    """Features (W, 38) of windows of `invariant.SIGNALS`, shape (W, 12, N), in the order of `NAMES`.

    A missing gyroscope is three rows of zeros: the features named in `WITHOUT_GYROSCOPE` do not use it.
    """
    return in_groups(features_of, windows, rate_hz, len(NAMES))


def features_of(windows: FloatArray, rate_hz: float) -> FloatArray:
    """The same of few windows."""
    n = windows.shape[2]
    force, rate, up = windows[:, :3], windows[:, 3:6], windows[:, 6:9]
    yaw_rate = (rate * up).sum(axis=1)
    tilt_rate = rate - up * yaw_rate[:, None]
    centred = about_mean(np.concatenate([force, tilt_rate, yaw_rate[:, None]], axis=1))
    spectrum = np.fft.rfft(centred * hann_taper(n))
    # Lines of power, which sum to the variance: vertical, horizontal, tilt rate, tilt angle, yaw angle.
    each = (spectrum.real**2 + spectrum.imag**2) * (2.0 / n**2)
    tilt, squared_omega = each[:, 3] + each[:, 4] + each[:, 5], _omega(n, rate_hz) ** 2
    lines = [each[:, 0], each[:, 1] + each[:, 2], tilt, tilt / squared_omega, each[:, 6] / squared_omega]
    power = np.stack(lines, axis=1)
    bands = power @ _bands(n, rate_hz)
    centred_rate = about_mean(rate)
    about_axes = mean_square(centred_rate)
    stride, step = _stride_and_step(power, n, rate_hz)
    return columns(
        [
            _attitude(up),
            _shaking(centred[:, :3], bands, stride, step),
            _turning(centred[:, 3:6], spectrum, bands, stride, step, rate_hz),
            about_axes / (about_axes.sum(axis=1) + _FLOOR_RADPS**2)[:, None],
        ]
    )


def _attitude(up: FloatArray) -> FloatArray:
    mean = up.mean(axis=2)
    mean = mean / (np.sqrt((mean * mean).sum(axis=1)) + 1e-9)[:, None]
    x, y, z = np.abs(mean).T
    screen = up[:, 2]
    lowest = np.sort(screen, axis=1)[:, int(_LOWEST * screen.shape[1])]
    return columns(
        [
            np.maximum(mean[:, 2], 0.0),
            np.clip(lowest, 0.0, 1.0),
            (screen > _FACES_UP).mean(axis=1),
            x,
            y,
            z,
            x * x,
            y * y,
            x * y,  # largest, 0.5, when the long axis is 45 degrees off the vertical: from ear to mouth
        ]
    )


def _shaking(force: FloatArray, bands: FloatArray, stride: FloatArray, step: FloatArray) -> FloatArray:
    """Of the centred vertical, east and north force (W, 3, N), relative to the vertical: not the person's strength."""
    vertical, east, north = force[:, 0], force[:, 1], force[:, 2]
    size = _log_rms(bands[:, :2, _ALL], _FLOOR_MPS2)
    blows = _log_rms(bands[:, :2, _BLOWS], _FLOOR_MPS2) - size[:, :1, None]
    stride_size, step_size = _log_rms(stride[:, :2], _FLOOR_MPS2), _log_rms(step[:, :2], _FLOOR_MPS2)
    scaled = vertical / (np.sqrt(mean_square(vertical)) + _FLOOR_MPS2)[:, None]
    squared = scaled * scaled
    # variances along the main horizontal axis and across it: their difference over their sum
    difference, mixed = (east * east - north * north).mean(axis=1), 2 * (east * north).mean(axis=1)
    total = (east * east + north * north).mean(axis=1)
    return columns(
        [
            size[:, 0],
            size[:, 1] - size[:, 0],
            blows.transpose(0, 2, 1).reshape(len(force), -1),
            stride_size[:, 0] - step_size[:, 0],
            stride_size[:, 1] - step_size[:, 0],
            step_size[:, 1] - step_size[:, 0],
            (squared * scaled).mean(axis=1),
            np.log(mean_square(squared) + 0.5),
            np.sqrt(difference * difference + mixed * mixed) / (total + _FLOOR_MPS2**2),
        ]
    )


def _turning(
    tilt_rate: FloatArray,
    spectrum: ComplexArray,
    bands: FloatArray,
    stride: FloatArray,
    step: FloatArray,
    rate_hz: float,
) -> FloatArray:
    n = tilt_rate.shape[2]
    variance, axes = np.linalg.eigh(tilt_rate @ tilt_rate.transpose(0, 2, 1) / n)
    size = _log_rms(bands[:, 0, _ALL], _FLOOR_MPS2)
    tilt, yaw = _log_rms(bands[:, 3, _ANGLE], _FLOOR_RAD), _log_rms(bands[:, 4, _ANGLE], _FLOOR_RAD)
    tilt_rate_size = _log_rms(bands[:, 2, _ALL], _FLOOR_RADPS)
    swing = slice(*_bins(_SWING_HZ, n, rate_hz))
    main_rate = (axes[:, :, 2][:, :, None] * spectrum[:, 3:6, swing]).sum(axis=1)
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
            (variance[:, 2] - variance[:, 1]) / (variance.sum(axis=1) + _FLOOR_RADPS**2),
            np.log(lever + _FLOOR_M),
            coherence,
            # a phone that only tilts, without moving, would show as much horizontal force as gravity it tilts by
            _log_rms(bands[:, 1, _SWING], _FLOOR_MPS2)
            - np.log(STANDARD_GRAVITY_MPS2)
            - _log_rms(bands[:, 3, _SWING], _FLOOR_RAD),
        ]
    )


def _lever(acceleration_about: ComplexArray, horizontal: ComplexArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Length of the lever, m, and how much of the horizontal acceleration it explains, 0 to 1, each (W,)."""
    # least squares of the horizontal acceleration on the angular one, whose quarter turn to the rate falls out
    product = (horizontal * acceleration_about.conj()[:, None]).sum(axis=2)
    matched = (product.real**2 + product.imag**2).sum(axis=1)
    about = (acceleration_about.real**2 + acceleration_about.imag**2).sum(axis=1)
    moved = (horizontal.real**2 + horizontal.imag**2).sum(axis=2).sum(axis=1)
    noise = n**2 / 2.0  # spectra of this much power have a variance of one
    lever = np.sqrt(matched) / (about + _LEVER_NOISE * noise)
    coherence = matched / ((about + _COHERENCE_NOISE * noise) * (moved + _COHERENCE_NOISE * noise))
    return lever, coherence


def _stride_and_step(power: FloatArray, n: int, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Power (W, L) of lines (W, L, K) at the stride's frequency and at the step's, which the vertical shows."""
    first, last = _bins(_STEP_HZ, n, rate_hz)
    step = first + power[:, 0, first:last].argmax(axis=1)
    stride = np.maximum(step // 2, 1)
    window = np.arange(len(power))
    # a step at an odd bin has its stride between two
    at_stride = power[window, :, stride] + power[window, :, stride + 1] * (step % 2)[:, None]
    return at_stride, power[window, :, step - 1] + power[window, :, step] + power[window, :, step + 1]


def _log_rms(power: FloatArray, floor: float) -> FloatArray:
    return np.asarray(0.5 * np.log(power + floor**2))


@cache
def _omega(n: int, rate_hz: float) -> FloatArray:
    """Angular frequency of each bin, rad/s; the first bin, which holds no motion, as the second."""
    bins = np.arange(n // 2 + 1, dtype=np.float64)
    return 2 * np.pi * rate_hz / n * np.maximum(bins, 1.0)


@cache
def _bins(band_hz: tuple[float, float], n: int, rate_hz: float) -> tuple[int, int]:
    """First bin of a band and the first one after it."""
    frequency_hz = np.arange(n // 2 + 1) * rate_hz / n
    first, last = np.searchsorted(frequency_hz, np.array(band_hz) - 1e-9)
    return int(first), int(last)


@cache
def _bands(n: int, rate_hz: float) -> FloatArray:
    """Matrix (n // 2 + 1, B) that sums the bins of each of `_BANDS_HZ`."""
    matrix = np.zeros((n // 2 + 1, len(_BANDS_HZ)))
    for column, band in enumerate(_BANDS_HZ):
        first, last = _bins(band, n, rate_hz)
        matrix[first:last, column] = 1.0
    return matrix
