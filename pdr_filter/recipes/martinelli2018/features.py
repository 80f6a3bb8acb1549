"""The 28 motion features of Martinelli et al. 2018, Table II, for one window of magnitudes.

The magnitudes are |a| of the specific force, the low-passed |a|, |g| of the angular rate and |m| of the magnetic field.
F5 to F8 are standard deviations, F9 to F12 skewnesses and F13 to F16 kurtoses. F6, F10 and F14, of the
low-passed |a|, use deviations from the mean of the unfiltered |a|, as printed in the table.

Deviations from the paper, which correct errors or omissions of the printed table:

- F2 is the range of the low-passed |a|. The table prints the range of |m|, which is F4.
- The third and fourth moments F9 to F16 are divided by the third and fourth power of the standard deviation.
- F18 is the energy of the low-passed |a|. The printed formula is wrong.
- Spectra (F21 to F26) and zero-crossing rates (F27, F28) are computed after subtraction of the mean. A magnitude never
  crosses zero, and its mean would be the largest coefficient.
- The peak frequencies F24 to F26 are in hertz and not indices, so that they are independent of window and rate.
- The low-pass, whose cutoff is not printed, is a second-order Butterworth at 5 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import WINDOW_SIGNALS, FloatArray

_OF = ("acc", "acc_f", "gyro", "magn")
NAMES: tuple[str, ...] = (
    *(f"range_{s}" for s in _OF),  # F1-F4
    *(f"std_{s}" for s in _OF),  # F5-F8
    *(f"skewness_{s}" for s in _OF),  # F9-F12
    *(f"kurtosis_{s}" for s in _OF),  # F13-F16
    *(f"energy_{s}" for s in _OF),  # F17-F20
    *(f"peak_{s}" for s in _OF[:3]),  # F21-F23
    *(f"peak_frequency_{s}_hz" for s in _OF[:3]),  # F24-F26
    *(f"zero_crossing_rate_{s}" for s in _OF[:2]),  # F27-F28
)
WITHOUT_MAGNETOMETER: tuple[str, ...] = tuple(n for n in NAMES if "magn" not in n)
WITHOUT_GYROSCOPE: tuple[str, ...] = tuple(n for n in WITHOUT_MAGNETOMETER if "gyro" not in n)

# Below this standard deviation, the third and fourth standardised moments would be rounding noise. They are set to
# zero, the value of a constant signal.
_MIN_STD = 1e-9


def features_28(magnitudes: FloatArray, rate_hz: float) -> FloatArray:
    """Return F1 to F28 of a window, shape (28,), in the order of `NAMES`.

    The rows of `magnitudes` (4, N) are the magnitude of the specific force and its low-passed version in m/s2, of the
    angular rate in rad/s and of the magnetic field in uT. A missing sensor is a row of zeros, whose features are zero.
    """
    n = magnitudes.shape[1]
    mean = magnitudes.mean(axis=1)
    centred = magnitudes - mean[:, None]
    deviation = magnitudes - mean[[0, 0, 2, 3], None]  # low-passed |a| is taken about the mean of |a|
    squared = deviation * deviation
    variance = squared.mean(axis=1)
    std = np.sqrt(variance)
    safe_std = np.where(std > _MIN_STD, std, np.inf)
    skewness = (squared * deviation).mean(axis=1) / safe_std**3
    kurtosis = (squared * squared).mean(axis=1) / safe_std**4
    energy = (magnitudes * magnitudes).sum(axis=1)
    spectrum = np.abs(np.fft.rfft(centred[:3], axis=1))
    peak = spectrum.argmax(axis=1)
    is_negative = centred[:2] < 0
    crossings = (is_negative[:, 1:] != is_negative[:, :-1]).sum(axis=1) / (n - 1)
    return np.concatenate(
        [
            magnitudes.max(axis=1) - magnitudes.min(axis=1),
            std,
            skewness,
            kurtosis,
            energy,
            spectrum[[0, 1, 2], peak],
            peak * (rate_hz / n),
            crossings,
        ]
    )


# The signals of a window begin with the magnitudes.
_N_MAGNITUDES = WINDOW_SIGNALS.index("magnetic_field_ut") + 1


@dataclass(frozen=True)
class MagnitudeFeatures:
    """Feature set (`FeatureSet`) with the 28 features."""

    name: str = "martinelli"
    names: tuple[str, ...] = NAMES
    # Table II does not state the cutoff; 5 Hz keeps the first harmonics of a step
    low_pass_hz: float = 5.0

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the 28 features (W, 28) of W windows with R signals of N samples, (W, R, N)."""
        return np.array([features_28(window, rate_hz) for window in windows[:, :_N_MAGNITUDES]])


TABLE_II = MagnitudeFeatures()
