"""What takes ten lines without any package for gait: one scale of a wavelet, peaks, steps of constant length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

from .walks import RATE_HZ, FloatArray, Found, Method, Run, Walk, between

# The settings with the smallest count error on the walks of ubicomp13 themselves: of 52 wavelets, frequencies and
# thresholds, and of 10 cut-offs and prominences. Nothing shorter than 0.3 s is a step.
WAVELET, STEP_HZ, LOWEST_STD = "mexh", 1.5, 0.2
CUT_OFF_HZ, LOWEST_MPS2 = 3.0, 1.0
CLOSEST_S = 0.3
STEP_M = 0.7
# Of the height, as in pedometers: the usual factor for men; that for women is 0.413.
STEP_PER_HEIGHT = 0.415


def _wavelet() -> Run:
    import pywt

    scale = pywt.frequency2scale(WAVELET, STEP_HZ / RATE_HZ)

    def run(walk: Walk) -> Found:
        magnitude = walk.magnitude_mps2
        coefficients = pywt.cwt(magnitude - magnitude.mean(), [scale], WAVELET, method="fft")[0][0]
        lowest = LOWEST_STD * coefficients.std()
        peaks, _ = find_peaks(coefficients, height=lowest, distance=CLOSEST_S * RATE_HZ)
        return between(walk.time_s[peaks], STEP_M)

    return run


def _peaks(length_m: Callable[[Walk], float]) -> Run:
    low_pass = butter(4, CUT_OFF_HZ, fs=RATE_HZ, output="sos")

    def run(walk: Walk) -> Found:
        return between(_contacts(walk, low_pass), length_m(walk))

    return run


def _contacts(walk: Walk, low_pass: FloatArray) -> FloatArray:
    smooth = sosfiltfilt(low_pass, walk.magnitude_mps2)
    peaks, _ = find_peaks(smooth, prominence=LOWEST_MPS2, distance=CLOSEST_S * RATE_HZ)
    return np.asarray(walk.time_s[peaks])


METHODS = (
    Method("pywt.cwt, one scale, steps of 0.7 m", "pywavelets", _wavelet),
    Method("find_peaks, steps of 0.7 m", "scipy", lambda: _peaks(lambda walk: STEP_M)),
    Method(
        "find_peaks, steps of 0.415 of the height",
        "scipy",
        lambda: _peaks(lambda walk: STEP_PER_HEIGHT * walk.height_m),
        own_steps=False,
    ),
)
