"""Features that do not change when the phone is turned over, put in the other pocket or carried by somebody else.

Of one window: statistics and band powers of vertical and horizontal acceleration, of the turning about the vertical and
of the tilting, of the device's own main axes of rotation, how regular the steps are, and how the horizontal
acceleration follows the vertical. No feature depends on the device's attitude, on its handedness or on north: signed
angles and axes memorise a person's habit and fail on the next one (docs/benchmarks.md).

Amplitudes and powers enter as logarithms: people differ by factors, and a classifier that is linear in the features
then needs no interactions for it.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.types import FloatArray

# Rows of a window, as `FeatureWindows` keeps them.
SIGNALS: tuple[str, ...] = (
    "vertical",  # specific force along up less gravity, m/s2
    "east",  # horizontal specific force in the attitude's frame, m/s2
    "north",
    "rate_x",  # angular rate, sensor frame, rad/s
    "rate_y",
    "rate_z",
    "up_x",  # unit vector up, sensor frame
    "up_y",
    "up_z",
)
# Sub-harmonics to harmonics of a step: stride 0.6 to 1.2 Hz, step 1.2 to 3 Hz, and the blow of the heel above.
BANDS_HZ: tuple[tuple[float, float], ...] = (
    (0.4, 1.2),
    (1.2, 1.7),
    (1.7, 2.2),
    (2.2, 3.2),
    (3.2, 4.7),
    (4.7, 7.0),
    (7.0, 11.0),
    (11.0, 18.0),
)
QUANTILES: tuple[float, ...] = (0.05, 0.25, 0.5, 0.75, 0.95)
LAGS_S: tuple[float, ...] = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
# Floor of amplitudes before the logarithm: the noise of a phone's accelerometer and gyroscope.
_FLOOR_MPS2, _FLOOR_RADPS = 0.02, 0.005

_LINES = ("vertical", "forward", "lateral", "horizontal", "yaw_rate", "tilt_rate", "main_rate")
_FORCES = _LINES[:4]
_RATES = _LINES[4:]


def _band_names(line: str) -> list[str]:
    return [f"log_band_{line}_{low:g}_{high:g}_hz" for low, high in BANDS_HZ]


_FORCE_NAMES: tuple[str, ...] = (
    *(f"log_std_{s}" for s in _FORCES),
    *(f"q{round(100 * q):02d}_{s}" for s in ("vertical", "horizontal") for q in QUANTILES),
    *(f"{m}_{s}" for s in ("vertical", "horizontal") for m in ("skewness", "kurtosis")),
    *(n for s in ("vertical", "forward", "lateral") for n in _band_names(s)),
    "peak_frequency_vertical_hz",
    "step_regularity",
    "step_lag_s",
    "stride_regularity",
    *(f"horizontal_follows_vertical_{lag:+g}_s" for lag in LAGS_S),
    "log_step_asymmetry",
)
_RATE_NAMES: tuple[str, ...] = (
    *(f"log_std_{s}" for s in _RATES),
    "log_second_rate",
    "log_third_rate",
    *(f"log_mean_abs_{s}" for s in _RATES),
    *(f"q{round(100 * q):02d}_tilt_rate" for q in QUANTILES),
    *(n for s in ("yaw_rate", "tilt_rate", "main_rate") for n in _band_names(s)),
    "peak_frequency_main_rate_hz",
    *(f"main_rate_follows_vertical_{lag:+g}_s" for lag in LAGS_S),
    "main_axis_tilt",
    "log_swing",
    "main_rate_skewness",
)
NAMES: tuple[str, ...] = (*_FORCE_NAMES, *_RATE_NAMES)
WITHOUT_GYROSCOPE: tuple[str, ...] = _FORCE_NAMES


@cache
def _bands(n: int, rate_hz: float) -> FloatArray:
    """Matrix (n // 2 + 1, B) that sums the bins of each band, each bin shared by the bands that it touches."""
    frequency = np.arange(n // 2 + 1) * rate_hz / n
    width = rate_hz / n
    low, high = np.array(BANDS_HZ).T
    overlap = np.minimum(frequency[:, None] + width / 2, high) - np.maximum(frequency[:, None] - width / 2, low)
    return np.maximum(overlap, 0.0) / width


@cache
def _taper(n: int) -> FloatArray:
    taper = np.hanning(n + 2)[1:-1]
    return np.asarray(taper / np.sqrt((taper**2).mean()))


def invariant_features(window: FloatArray, rate_hz: float) -> FloatArray:
    """Features of a window of `SIGNALS`, shape (9, N), in the order of `NAMES`.

    A missing gyroscope is three rows of zeros: the features named in `WITHOUT_GYROSCOPE` do not use it.
    """
    n = window.shape[1]
    vertical = window[0] - window[0].mean()
    horizontal = window[1:3] - window[1:3].mean(axis=1, keepdims=True)
    rate, up = window[3:6], window[6:9]

    forward, lateral = _main_axes(horizontal)
    yaw_rate = -(rate * up).sum(axis=0)
    tilt = rate + up * yaw_rate
    tilt_rate = np.sqrt((tilt * tilt).sum(axis=0))
    centred_rate = rate - rate.mean(axis=1, keepdims=True)
    axes, spread = _principal(centred_rate)
    main_rate = axes[:, 2] @ centred_rate
    size = np.sqrt((horizontal * horizontal).sum(axis=0))

    lines = np.stack([vertical, forward, lateral, size, yaw_rate, tilt_rate, main_rate])
    mean = lines.mean(axis=1, keepdims=True)
    centred = lines - mean
    std = np.sqrt((centred * centred).mean(axis=1))
    power = np.abs(np.fft.rfft(centred * _taper(n), axis=1)) ** 2 * (2.0 / n**2)
    bands = power[[0, 1, 2, 4, 5, 6]] @ _bands(n, rate_hz)
    order = np.sort(lines[[0, 3, 5]], axis=1)
    quantiles = order[:, [min(int(q * n), n - 1) for q in QUANTILES]]
    regularity, lag_s, stride = _regularity(power[0], n, rate_hz)

    force = [
        np.log(std[:4] + _FLOOR_MPS2),
        quantiles[0],
        quantiles[1],
        _moments(centred[0], std[0], _FLOOR_MPS2),
        _moments(centred[3], std[3], _FLOOR_MPS2),
        0.5 * np.log(bands[:3].ravel() + _FLOOR_MPS2**2),
        [power[0, 1 : n // 4].argmax() * rate_hz / n + rate_hz / n, regularity, lag_s, stride],
        _follows(vertical, horizontal, rate_hz),
        [_asymmetry(power[0], lag_s, n, rate_hz)],
    ]
    turning = [
        np.log(std[4:] + _FLOOR_RADPS),
        np.log(np.sqrt(np.maximum(spread[1::-1], 0.0)) + _FLOOR_RADPS),
        np.log(np.abs(lines[4:]).mean(axis=1) + _FLOOR_RADPS),
        quantiles[2],
        0.5 * np.log(bands[3:].ravel() + _FLOOR_RADPS**2),
        [power[6, 1 : n // 4].argmax() * rate_hz / n + rate_hz / n],
        _follows(vertical, main_rate[None, :], rate_hz),
        [abs(float(axes[:, 2] @ up.mean(axis=1))), np.log(_swing(up) + 0.01)],
        [abs(_moments(centred[6], std[6], _FLOOR_RADPS)[0])],
    ]
    return np.concatenate([*force, *turning])


def _main_axes(horizontal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Components (N,) along the axis of largest spread in the horizontal plane, and across it.

    Whether that axis is the walking direction does not matter here; which way it points is not used.
    """
    cov = horizontal @ horizontal.T
    angle = 0.5 * np.arctan2(2 * cov[0, 1], cov[0, 0] - cov[1, 1])
    c, s = np.cos(angle), np.sin(angle)
    return c * horizontal[0] + s * horizontal[1], c * horizontal[1] - s * horizontal[0]


def _principal(centred: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Principal axes (3, 3) in columns and variances (3,), smallest first."""
    variance, axes = np.linalg.eigh(centred @ centred.T / centred.shape[1])
    return axes, variance


def _moments(centred: FloatArray, std: float, floor: float) -> FloatArray:
    """Skewness and kurtosis, those of a constant being zero."""
    scaled = centred / max(float(std), floor)
    squared = scaled * scaled
    return np.array([(squared * scaled).mean(), (squared * squared).mean()])


def _regularity(power: FloatArray, n: int, rate_hz: float) -> tuple[float, float, float]:
    """Largest autocorrelation at a step's lag (0.28 to 1 s), that lag in s, and the autocorrelation at twice it.

    From the power spectrum (Wiener-Khinchin), divided by the overlap's share of the taper at each lag.
    """
    correlation = np.fft.irfft(power, n)
    taper = np.fft.irfft(np.abs(np.fft.rfft(_taper(n))) ** 2, n)
    correlation = correlation / max(float(correlation[0]), 1e-12) * taper[0] / np.maximum(taper, 0.05 * taper[0])
    first, last = round(0.28 * rate_hz), min(round(1.0 * rate_hz), n // 2)
    lag = first + int(correlation[first:last].argmax())
    return float(correlation[lag]), lag / rate_hz, float(correlation[min(2 * lag, n // 2)])


def _follows(vertical: FloatArray, others: FloatArray, rate_hz: float) -> FloatArray:
    """Size of the correlation of the vertical with other components at each lag, 0 to 1, whatever their axes."""
    n = len(vertical)
    scale = np.sqrt((vertical @ vertical) * (others * others).sum()) + 1e-9
    result = np.empty(len(LAGS_S))
    for i, lag_s in enumerate(LAGS_S):
        lag = round(lag_s * rate_hz)
        early, late = slice(max(-lag, 0), n - max(lag, 0)), slice(max(lag, 0), n - max(-lag, 0))
        product = others[:, late] @ vertical[early]
        result[i] = np.sqrt((product * product).sum()) / scale
    return result


def _asymmetry(power: FloatArray, step_lag_s: float, n: int, rate_hz: float) -> float:
    """Log ratio of the vertical's power at stride frequency to that at step frequency: a limp, or one pocket."""
    step = step_lag_s and n / (step_lag_s * rate_hz)  # bin of the step frequency
    low, high = round(step / 2), round(step)
    stride_power = power[max(low - 1, 1) : low + 2].max()
    step_power = power[max(high - 1, 1) : high + 2].max()
    return float(0.5 * np.log((stride_power + _FLOOR_MPS2**2) / (step_power + _FLOOR_MPS2**2)))


def _swing(up: FloatArray) -> float:
    """Root mean square angle of the up vector about its mean direction, rad (small angles)."""
    centred = up - up.mean(axis=1, keepdims=True)
    return float(np.sqrt((centred * centred).sum(axis=0).mean()))
