"""Features of windows that do not depend on the attitude of the phone, the side of its pocket, or the person.

The features of a window are statistics and band powers of the vertical and horizontal acceleration, of the rotation
about the vertical, of the tilting, and of the rotation about the main axes of the device. Further features are the
regularity of the steps and the phase relations between the parts of the motion. No feature depends on the attitude of
the device, on its handedness or on north. Signed angles and axes would memorise the habit of a person and fail for the
next one (docs/benchmarks.md).

Stairs differ from walking in the timing within a step: the swing of the limb that carries the phone relative to the
bounce of the body. The limb swings about the main axis of the angular rate, whose sign is arbitrary. Features avoid the
sign by squares or products, or choose the sign for which the acceleration across the axis points forward, weighted by
how clearly it does (docs/methods/contexts.md). Amplitudes and powers enter as logarithms, because persons differ by
factors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from pdr_filter.values import FloatArray, IntArray

# Signals of a window, in the order of `FeatureWindows`.
SIGNALS: tuple[str, ...] = (
    "vertical",  # specific force along up minus gravity, m/s2
    "east",  # horizontal specific force in the attitude frame, m/s2
    "north",
    "rate_x",  # angular rate, sensor frame, rad/s
    "rate_y",
    "rate_z",
    "up_x",  # unit vector up, sensor frame
    "up_y",
    "up_z",
    "force_x",  # specific force, sensor frame, m/s2
    "force_y",
    "force_z",
)
# Frequency bands, Hz: stride 0.6 to 1.2 Hz, step 1.2 to 3 Hz, and the harmonics and the impact of the heel above.
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
# Lags for the timing within a step, s. A step takes 0.35 to 0.8 s, of which half lies on each side.
STEP_LAGS_S: tuple[float, ...] = (-0.4, -0.32, -0.24, -0.16, -0.08, 0.0, 0.08, 0.16, 0.24, 0.32, 0.4)
# Lags for the repetition of a swing, s. It repeats after a stride of 0.7 to 1.4 s and is opposite after half a stride.
SWING_LAGS_S: tuple[float, ...] = (0.2, 0.32, 0.44, 0.56, 0.68, 0.8, 0.92)
# Added to amplitudes before the logarithm: the noise of the accelerometer and gyroscope of a phone.
_FLOOR_MPS2, _FLOOR_RADPS = 0.02, 0.005

# A line is a scalar signal of a window over time.
_LINES = ("vertical", "forward", "lateral", "horizontal", "yaw_rate", "tilt_rate", "main_rate")
_FORCES = _LINES[:4]
_RATES = _LINES[4:]


def _band_names(line: str) -> list[str]:
    """Return the names of the band powers of one signal."""
    return [f"log_band_{line}_{low:g}_{high:g}_hz" for low, high in BANDS_HZ]


def _timing_names(line: str) -> list[str]:
    """Return the names of the correlations of a signal with the vertical acceleration at each of `STEP_LAGS_S`."""
    return [f"{line}_follows_vertical_{lag:+g}_s" for lag in STEP_LAGS_S]


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
    *_timing_names("squared_vertical_velocity"),
    *_timing_names("squared_vertical"),
)
_RATE_NAMES: tuple[str, ...] = (
    *(f"log_std_{s}" for s in _RATES),
    "log_second_rate",
    "log_third_rate",
    *(f"log_mean_abs_{s}" for s in _RATES),
    *(f"q{round(100 * q):02d}_tilt_rate" for q in QUANTILES),
    *(n for s in ("yaw_rate", "tilt_rate", "main_rate") for n in _band_names(s)),
    "peak_frequency_main_rate_hz",
    "main_axis_tilt",
    "log_swing",
    "main_rate_skewness",
    *_timing_names("squared_swing_rate"),
    *_timing_names("squared_swing_angle"),
    *_timing_names("forward_swing_rate"),
    *_timing_names("forward_force"),
    *_timing_names("side_force"),
    *(f"across_force_follows_swing_rate_{lag:+g}_s" for lag in STEP_LAGS_S),
    *(f"swing_repeats_after_{lag:g}_s" for lag in SWING_LAGS_S),
    *(f"q{round(100 * q):02d}_forward_swing_angle" for q in QUANTILES),
)
NAMES: tuple[str, ...] = (*_FORCE_NAMES, *_RATE_NAMES)
WITHOUT_GYROSCOPE: tuple[str, ...] = _FORCE_NAMES


@cache
def _band_matrix(n: int, rate_hz: float) -> FloatArray:
    """Return the matrix (n // 2 + 1, B) that sums the bins of each band, with bins shared at the edges of bands."""
    frequency = np.arange(n // 2 + 1) * rate_hz / n
    width = rate_hz / n
    low, high = np.array(BANDS_HZ).T
    overlap = np.minimum(frequency[:, None] + width / 2, high) - np.maximum(frequency[:, None] - width / 2, low)
    return np.maximum(overlap, 0.0) / width


@cache
def hann_taper(n: int) -> FloatArray:
    """Return a Hann taper of n samples with a mean square of one."""
    taper = np.hanning(n + 2)[1:-1]
    return np.asarray(taper / np.sqrt((taper**2).mean()))


def about_mean(lines: FloatArray) -> FloatArray:
    """Return signals of N samples, shape (..., N), minus the mean of each signal."""
    return lines - mean_of(lines)[..., None]


def mean_of(lines: FloatArray) -> FloatArray:
    """Return the mean of each signal, shape (...), for signals of N samples, (..., N), in half the time of `mean`."""
    return np.add.reduce(lines, axis=-1) / lines.shape[-1]


def mean_square(lines: FloatArray) -> FloatArray:
    """Return the mean square of each signal, shape (...), for signals of N samples along the last axis, (..., N)."""
    return np.asarray(np.add.reduce(lines * lines, axis=-1) / lines.shape[-1], dtype=np.float64)


def columns(features: Sequence[FloatArray]) -> FloatArray:
    """Return features (W,) and (W, F) joined as columns, like np.column_stack but in a fifth of the time."""
    return np.concatenate([f[:, None] if f.ndim == 1 else f for f in features], axis=1)


def side_by_side(*lines: FloatArray) -> FloatArray:
    """Return K signals (W, N) as (W, K, N), like np.stack with axis 1 but in a third of the time."""
    return np.concatenate([line[:, None] for line in lines], axis=1)


def features_in_groups(
    features: Callable[[MotionLines, float], FloatArray], windows: FloatArray, rate_hz: float, n_features: int
) -> FloatArray:
    """Return the features (W, F) of windows, computed for 32 windows at a time.

    The signals of 32 windows fit into the processor's cache. The grouping changes no result.
    """
    groups = (features(motion_lines(windows[i : i + 32]), rate_hz) for i in range(0, len(windows), 32))
    return np.concatenate([np.empty((0, n_features)), *groups])


def invariant_features_of_motion(motion: MotionLines, rate_hz: float) -> FloatArray:
    """Return the features (W, F) of a few windows, given their `motion_lines`, in the order of `NAMES`.

    A missing gyroscope is given as three rows of zeros. The features named in `WITHOUT_GYROSCOPE` do not use it. A
    window has the same bits alone and among others, because sums run along the last axis of contiguous arrays, and
    matrix products and transforms are computed window by window.
    """
    centred, n = motion.centred, motion.centred.shape[2]
    vertical, horizontal = centred[:, 0], centred[:, 1:3]
    forward, lateral = _main_axes(horizontal)
    main_axis, spread = motion.axes[0, :, :, 2], motion.variance[0]
    main_rate = _along(main_axis, centred[:, 3:6])
    tilt_rate = _norm(motion.tilt_rate)
    lines = side_by_side(vertical, forward, lateral, _norm(horizontal), -motion.yaw_rate, tilt_rate, main_rate)
    centred = about_mean(lines)
    std = np.sqrt(mean_square(centred))
    power = _power_spectrum(centred)
    bands = power[:, [0, 1, 2, 4, 5, 6]] @ _band_matrix(n, rate_hz)
    ordered = np.sort(lines[:, [0, 3, 5]], axis=2)
    quantiles = ordered[:, :, _quantile_indices(n)]
    regularity, lag_s, stride = _regularity(power[:, 0], n, rate_hz)
    velocity = about_mean(np.cumsum(vertical, axis=1) / rate_hz)
    lagged = _lagged_lines(vertical, STEP_LAGS_S, rate_hz)

    squares = side_by_side(velocity * velocity, vertical * vertical)
    force = [
        np.log(std[:, :4] + _FLOOR_MPS2),
        quantiles[:, 0],
        quantiles[:, 1],
        _skewness_and_kurtosis(centred[:, 0], std[:, 0], _FLOOR_MPS2),
        _skewness_and_kurtosis(centred[:, 3], std[:, 3], _FLOOR_MPS2),
        _one_row_each(0.5 * np.log(bands[:, :3] + _FLOOR_MPS2**2)),
        _peak_hz(power[:, 0], n, rate_hz),
        regularity,
        lag_s,
        stride,
        _follows(vertical, horizontal, rate_hz),
        _asymmetry(power[:, 0], lag_s, n, rate_hz),
        _one_row_each(_timing(squares, _SQUARED_FLOORS, lagged, std[:, 0])),
    ]
    rotation = [
        np.log(std[:, 4:] + _FLOOR_RADPS),
        np.log(np.sqrt(np.maximum(spread[:, 1::-1], 0.0)) + _FLOOR_RADPS),
        np.log(mean_of(np.abs(lines[:, 4:])) + _FLOOR_RADPS),
        quantiles[:, 2],
        _one_row_each(0.5 * np.log(bands[:, 3:] + _FLOOR_RADPS**2)),
        _peak_hz(power[:, 6], n, rate_hz),
        np.abs(np.add.reduce(main_axis * motion.mean[:, 6:9], axis=1)),
        np.log(_swing(motion.centred[:, 6:9]) + 0.01),
        np.abs(_skewness_and_kurtosis(centred[:, 6], std[:, 6], _FLOOR_RADPS)[:, 0]),
        *_swing_timing(motion, lagged, std[:, 0], velocity, rate_hz),
    ]
    return columns([*force, *rotation])


def _norm(vectors: FloatArray) -> FloatArray:
    """Return the norms (W, N) of vectors with d components, (W, d, N), for W windows of N samples."""
    return np.sqrt(np.add.reduce(vectors * vectors, axis=1))


def _along(axis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the components (W, N) of vectors (W, 3, N) along axes (W, 3)."""
    return np.add.reduce(axis[:, :, None] * vectors, axis=1)


def _one_row_each(features: FloatArray) -> FloatArray:
    """Return features (W, ...) flattened to one row for each window."""
    return features.reshape(len(features), -1)


@cache
def _quantile_indices(n: int) -> IntArray:
    """Return the positions of the `QUANTILES` in n sorted values."""
    return np.array([min(int(q * n), n - 1) for q in QUANTILES])


def _main_axes(horizontal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the components (W, N) of horizontal vectors (W, 2, N) along the axis of largest variance and across it."""
    east, north = horizontal[:, 0], horizontal[:, 1]
    difference, mixed = (np.add.reduce(p, axis=1) for p in (east * east - north * north, east * north))
    mixed = 2 * mixed
    # The axis has half of the angle whose cosine is difference / size. The half-angle formulas avoid trigonometric
    # functions, whose bits depend on the processor.
    size = np.sqrt(difference * difference + mixed * mixed)
    cosine = np.divide(difference, size, out=np.ones_like(size), where=size > 0)
    c = np.sqrt(0.5 * (1 + cosine))[:, None]
    s = (np.where(mixed < 0, -1.0, 1.0) * np.sqrt(np.maximum(0.5 * (1 - cosine), 0.0)))[:, None]
    return c * east + s * north, c * north - s * east


def _skewness_and_kurtosis(centred: FloatArray, std: FloatArray, floor: float) -> FloatArray:
    """Return the skewness and kurtosis (W, 2) of centred signals (W, N) with the standard deviations `std` (W,).

    Standard deviations below `floor` count as `floor`, so that both are zero for a constant signal.
    """
    scaled = centred / np.maximum(std, floor)[:, None]
    squared = scaled * scaled
    return columns([mean_of(squared * scaled), mean_square(squared)])


def _power_spectrum(centred: FloatArray) -> FloatArray:
    """Return the power spectrum of signals (..., N) after a Hann taper, with N // 2 + 1 frequencies each."""
    n = centred.shape[-1]
    spectrum = np.fft.rfft(centred * hann_taper(n))
    return (spectrum.real**2 + spectrum.imag**2) * (2.0 / n**2)


def _peak_hz(power: FloatArray, n: int, rate_hz: float) -> FloatArray:
    """Return the frequency (W,) of largest power below half of the Nyquist frequency, Hz."""
    return (power[:, 1 : n // 4].argmax(axis=1) + 1) * (rate_hz / n)


@cache
def _taper_correlation(n: int) -> FloatArray:
    """Return the autocorrelation of the taper at each lag, at least 0.05, which corrects the loss of overlap."""
    overlap = np.fft.irfft(np.abs(np.fft.rfft(hann_taper(n))) ** 2, n)
    return np.maximum(overlap / overlap[0], 0.05)


def _regularity(power: FloatArray, n: int, rate_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step regularity (W,), the lag of a step (W,) in s, and the stride regularity (W,).

    The step regularity is the largest autocorrelation at a lag of 0.28 to 1 s. The stride regularity is the
    autocorrelation at twice that lag, but at most at half the window. In windows of 2 s, the lag is therefore shorter
    than a stride for steps longer than 0.5 s.
    """
    correlation = np.fft.irfft(power, n)
    correlation = correlation / np.maximum(correlation[:, :1], 1e-12) / _taper_correlation(n)
    first, last = round(0.28 * rate_hz), min(round(1.0 * rate_hz), n // 2)
    lag = first + correlation[:, first:last].argmax(axis=1)
    each = np.arange(len(power))
    return correlation[each, lag], lag / rate_hz, correlation[each, np.minimum(2 * lag, n // 2)]


_SQUARED_FLOORS = np.array([_FLOOR_MPS2**2, _FLOOR_MPS2**2])
_SWING_FLOORS = np.array([_FLOOR_RADPS**2, _FLOOR_RADPS**2, _FLOOR_RADPS, _FLOOR_MPS2, _FLOOR_MPS2])


@dataclass(frozen=True, slots=True, eq=False)
class MotionLines:
    """Signals of W windows of N samples that several sets of features use, computed once.

    The last four are the swing of the limb about its main horizontal axis, with the specific force along and across the
    axis. The sign of the axis is arbitrary.
    """

    windows: FloatArray  # (W, 12, N) the signals of `SIGNALS`
    mean: FloatArray  # (W, 12) their means
    centred: FloatArray  # (W, 12, N) the signals minus their means
    yaw_rate: FloatArray  # (W, N) angular rate about up, rad/s
    tilt_rate: FloatArray  # (W, 3, N) angular rate minus its part about up, sensor frame, rad/s
    turning: FloatArray  # (W, 4, N) `tilt_rate` and `yaw_rate` minus their means, rad/s
    # Principal axes as columns, that of the largest variance last, shape (3, W, 3, 3): of the angular rate, of the rate
    # about horizontal axes, and of `tilt_rate`.
    axes: FloatArray
    variance: FloatArray  # (3, W, 3) variances along these axes, (rad/s)^2
    about_mean_up: FloatArray  # (W, N) angular rate about the mean of up, rad/s
    rate: FloatArray  # (W, N) angular rate about the axis, rad/s
    roll_rate: FloatArray  # (W, N) angular rate about the horizontal axis perpendicular to it, rad/s
    across: FloatArray  # (W, N) specific force across the axis, which is the direction of the swing, m/s2
    along: FloatArray  # (W, N) specific force along the axis, m/s2


def motion_lines(windows: FloatArray) -> MotionLines:
    """Return the signals that several feature sets share, for W windows of `SIGNALS`, (W, 12, N).

    The swing of the limb that carries the phone is the rotation about the main horizontal axis of the angular rate,
    which is the largest eigenvector of the covariance of the levelled rate. The result has the angular rates about this
    axis and across it, and the specific forces along it and across it.
    """
    mean, rate, up = mean_of(windows), windows[:, 3:6], windows[:, 6:9]
    centred = windows - mean[:, :, None]
    yaw_rate = np.add.reduce(rate * up, axis=1)
    tilt_rate = rate - up * yaw_rate[:, None]
    turning = about_mean(np.concatenate([tilt_rate, yaw_rate[:, None]], axis=1))
    up_length = np.sqrt(np.add.reduce(mean[:, 6:9] * mean[:, 6:9], axis=1))  # zero without a direction
    mean_up = mean[:, 6:9] / np.maximum(up_length, 1e-9)[:, None]
    about_mean_up = _along(mean_up, rate)
    level_rate = about_mean(rate - mean_up[:, :, None] * about_mean_up[:, None])
    rates = np.array([centred[:, 3:6], level_rate, turning[:, :3]])
    variance, axes = np.linalg.eigh(rates @ rates.transpose(0, 1, 3, 2) / windows.shape[2])
    axis, centred_force = axes[1, :, :, 2], centred[:, 9:12]
    (x, y, z), (a, b, c) = mean_up.T, axis.T
    across = columns([y * c - z * b, z * a - x * c, x * b - y * a])
    return MotionLines(
        windows=windows,
        mean=mean,
        centred=centred,
        yaw_rate=yaw_rate,
        tilt_rate=tilt_rate,
        turning=turning,
        axes=axes,
        variance=variance,
        about_mean_up=about_mean_up,
        rate=_along(axis, level_rate),
        roll_rate=_along(across, level_rate),
        across=_along(across, centred_force),
        along=_along(axis, centred_force),
    )


def _swing_timing(
    swing: MotionLines,
    lagged_vertical: FloatArray,
    vertical_std: FloatArray,
    velocity: FloatArray,
    rate_hz: float,
) -> list[FloatArray]:
    """Return the features of the timing of the swing relative to the vertical motion within a step.

    They describe the angular rate about the swing axis, its angle, and the specific force across and along the axis.
    """
    n = swing.rate.shape[1]
    swing_rate, across_force, along_force = swing.rate, swing.across, swing.along
    angle = np.cumsum(swing_rate, axis=1) / rate_hz
    # Remove the straight line from the first to the last value, because a window cannot distinguish it from drift.
    angle = about_mean(angle - (angle[:, -1:] - angle[:, :1]) * (np.arange(n) / (n - 1)))

    swing_std = np.sqrt(mean_square(swing_rate)) + _FLOOR_RADPS
    across_std = np.sqrt(mean_square(across_force)) + _FLOOR_MPS2
    velocity_std = np.sqrt(mean_square(velocity)) + _FLOOR_MPS2
    # From -1 to 1: the sign tells whether the direction across the axis points forward, the size how clearly.
    forward = -mean_of(across_force * velocity) / (across_std * velocity_std)
    lines = side_by_side(swing_rate * swing_rate, angle * angle, swing_rate, across_force, along_force)
    timing = _timing(lines, _SWING_FLOORS, lagged_vertical, vertical_std)
    timing[:, 2:4] *= forward[:, None, None]
    timing[:, 4] = np.abs(timing[:, 4])  # left and right must not differ
    follows = _product(swing_rate, _lagged_lines(across_force, STEP_LAGS_S, rate_hz))
    repeats = _product(swing_rate, _lagged_lines(swing_rate, SWING_LAGS_S, rate_hz))
    ordered = np.sort(np.where(forward > 0, 1.0, -1.0)[:, None] * angle, axis=1)
    return [
        _one_row_each(timing),
        follows / (n * swing_std * across_std)[:, None],
        repeats / (n * swing_std * swing_std)[:, None],
        ordered[:, _quantile_indices(n)] * np.abs(forward)[:, None],
    ]


def _timing(lines: FloatArray, floor: FloatArray, lagged_vertical: FloatArray, vertical_std: FloatArray) -> FloatArray:
    """Return the correlations (W, K, L) of K signals (W, K, N) with the vertical acceleration at each of L lags.

    The lags are `STEP_LAGS_S`, and W is the number of windows of N samples. Lower bounds of the divisors make the
    result approach 0 for a phone at rest.
    """
    centred = about_mean(lines)
    std = np.sqrt(mean_square(centred)) + floor
    product = centred @ lagged_vertical.transpose(0, 2, 1)
    return product / (lines.shape[2] * (vertical_std + _FLOOR_MPS2)[:, None] * std)[:, :, None]


def _product(line: FloatArray, lagged: FloatArray) -> FloatArray:
    """Return the sums (W, L) of products of a signal (W, N) with another signal at L lags, (W, L, N)."""
    return (lagged @ line[:, :, None])[:, :, 0]


def _lagged_lines(line: FloatArray, lags_s: tuple[float, ...], rate_hz: float) -> FloatArray:
    """Return a signal (W, N) shifted by each of L lags, (W, L, N).

    Row l holds the signal at time t + lag_l, and zero outside the window.
    """
    n_windows, n = line.shape
    starts, margin = _lag_samples(lags_s, rate_hz)
    padded = np.zeros((n_windows, n + 2 * margin))
    padded[:, margin : margin + n] = line
    result = np.empty((n_windows, len(lags_s), n))
    for i, start in enumerate(starts):
        result[:, i] = padded[:, start : start + n]
    return result


@cache
def _lag_samples(lags_s: tuple[float, ...], rate_hz: float) -> tuple[tuple[int, ...], int]:
    """Return the start index of each lag in a padded signal, and the length of the padding in samples.

    The padding at each end is as long as the longest lag. A slice from the start index, as long as the signal, is the
    signal at time t + lag.
    """
    lags = [round(lag * rate_hz) for lag in lags_s]
    margin = max(abs(lag) for lag in lags)
    return tuple(lag + margin for lag in lags), margin


def _follows(vertical: FloatArray, horizontal: FloatArray, rate_hz: float) -> FloatArray:
    """Return the correlation (W, L) of the horizontal with the vertical acceleration at each of `LAGS_S`, 0 to 1.

    It is the length of the correlation vector, so that it does not depend on the horizontal axes.
    """
    scale = np.sqrt(np.add.reduce(vertical * vertical, axis=1) * (horizontal * horizontal).sum(axis=(1, 2))) + 1e-9
    product = _lagged_lines(vertical, LAGS_S[::-1], rate_hz) @ horizontal.transpose(0, 2, 1)
    return np.sqrt(np.add.reduce(product * product, axis=2)) / scale[:, None]


def _asymmetry(power: FloatArray, step_lag_s: FloatArray, n: int, rate_hz: float) -> FloatArray:
    """Return the log ratio (W,) of the vertical amplitude at stride frequency to that at step frequency.

    It is large for a limp, and for a phone in one trouser pocket.
    """
    step = n / (step_lag_s * rate_hz)  # bin of the step frequency
    each, around = np.arange(len(power))[:, None], np.arange(-1, 2)
    stride_power, step_power = (
        power[each, np.maximum(np.rint(bin_)[:, None].astype(int) + around, 1)].max(axis=1)
        for bin_ in (0.5 * step, step)
    )
    return 0.5 * np.log((stride_power + _FLOOR_MPS2**2) / (step_power + _FLOOR_MPS2**2))


def _swing(centred_up: FloatArray) -> FloatArray:
    """Return the rms angle (W,) between the up vector and its mean direction, rad (for small angles)."""
    return np.sqrt(mean_of(np.add.reduce(centred_up * centred_up, axis=1)))
