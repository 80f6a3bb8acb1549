"""Climb rate and height from a barometer, and the evidence of the climb rate for stairs.

Height differences follow from the hydrostatic relation dh = -(R T / (g M)) dp / p. Air of 15 degrees Celsius has a
scale height of 8435 m, so that 1 hPa is 8.32 m at 1013 hPa. Only differences are used, because weather changes the
pressure by at most a few hPa an hour, which is less than 0.01 m/s.

The climb rates of stairs in `climb_log_evidence` come from building codes, those of lifts from judgement, and the noise
of the sensor from data sheets. Two recordings with a barometer were available, without labels. They gave the size of
draughts. On eight changes of storey (ipin2023) the rates on stairs are 0.2 to 0.4 m/s, which agrees with the codes.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import (
    DEFAULT_CONTEXTS,
    STANDARD_GRAVITY_MPS2,
    BoolArray,
    ContextSet,
    FloatArray,
    IntArray,
    check_numbers,
)
from pdr_filter.values.events import Climb

GAS_CONSTANT_J_PER_MOL_K = 8.314462618
MOLAR_MASS_OF_AIR_KG_PER_MOL = 0.0289644  # dry air; humid air at 20 degrees Celsius is up to 0.9 % lighter
ZERO_CELSIUS_K = 273.15
STANDARD_PRESSURE_HPA = 1013.25

# Measuring range of phone sensors (Bosch BMP280, data sheet BST-BMP280-DS001: 300 to 1100 hPa). A value outside is a
# failed reading, unless it is inside the range in another unit.
_MIN_HPA, _MAX_HPA = 300.0, 1100.0
_OTHER_UNITS = {"Pa": (0.01, "divide by 100"), "kPa": (10.0, "multiply by 10")}
# Tolerance for the ends of a window, in s, because times of recordings have six decimals.
_ROUNDING_S = 1e-6
# Resolution below which equal values of some seconds show a stuck sensor: 0.25 m, twice the standard deviation of
# draughts in a second. The longest equal stretch of the phones of ipin2023 and ipin21 lasts 0.5 s.
_FINE_HPA = 0.03
_COARSE_HPA, _DIGITS = (1.0, 0.1), 1e-4  # resolutions of whole numbers and of one decimal, and rounding errors
# Time of a stuck barometer, and resolution, from which a warning is issued. On ipin2023 a resolution of 0.1 hPa, 0.8 m,
# changes distances by less than 1 %, and 0.3 hPa hide the stairs.
_NOTABLE_STUCK_S, _NOTABLE_HPA = 5.0, 0.2
# Samples in a row, in order, that lie behind the last time and show a backward clock jump instead of late samples.
_CLOCK_RESET_SAMPLES = 10


@dataclass(frozen=True, slots=True, eq=False)
class ClimbState:
    """Buffered samples, the end of the next window, and the check of the clock."""

    samples: FloatArray  # (2, B) times and pressures that later windows still need
    due_s: float  # nominal end of the next window, s. The window ends with the sample nearest to it.
    behind_s: float = -np.inf  # time of the last sample that lies behind the last accepted one, s
    n_behind: int = 0  # consecutive samples with increasing times that lie behind the last accepted one
    # Smallest nonzero difference of consecutive samples, hPa. Infinite before the first change.
    quantum_hpa: float = np.inf
    changed_s: float = np.nan  # time of the last change of the pressure, or of the first sample after a gap, s
    stuck_s: float = 0.0  # time for which the sensor was stuck in total, s

    @property
    def resolution_hpa(self) -> float:
        """Resolution of the sensor in hPa, or infinity if it is unknown."""
        return _pressure_resolution(self.quantum_hpa, self.samples[1, -1]) if self.samples.size else math.inf

    @property
    def fault(self) -> str:
        """Clause that names a stuck or coarse barometer, or an empty text."""
        if self.stuck_s >= _NOTABLE_STUCK_S:
            return f"the barometer gave one value for {self.stuck_s:.0f} s in total"
        if _NOTABLE_HPA < self.resolution_hpa < math.inf:
            return f"the pressure is rounded to {self.resolution_hpa:.2g} hPa"
        return ""

    @property
    def note(self) -> str:
        """Warning about a stuck or coarse barometer, or an empty text."""
        return self.fault and f"heights and stairs are uncertain: {self.fault}; record the pressure without rounding"


@dataclass(frozen=True)
class ClimbRate:
    """Causal stage that estimates the climb rate as the least-squares slope of the height over a trailing window.

    Samples may come at any rate. A window ends with the sample nearest to each hop, judged by the interval of the last
    two samples, and has at least three samples. No window spans a gap. After a gap the first window is complete after
    `window_s`. Repeated and backward times are dropped, as are NaN and failed readings. A sensor whose value stays
    exactly equal for `stuck_after_s`, although its resolution is finer than draughts, is stuck and gives no climbs
    until the value changes. A coarse sensor repeats its values, and their rounding error is common to all equal values:
    the variance of the n-th equal hop is n times as large.

    Parameters
    ----------
    window_s, hop_s : float
        Length of the windows, and time between their ends, s. At 1 Hz, the slowest rate of phones, 4 s are five
        samples. With the noise below their standard deviation is 0.026 m/s, a tenth of the climb rate on stairs.
    max_gap_s : float
        A longer time without samples is a gap, s.
    stuck_after_s : float
        Time of equal values after which a sensor is stuck, s.
    noise_hpa : float
        Lower limit of the standard deviation of a sample, hPa, which is otherwise estimated from the samples of the
        window. It is needed because a few samples can lie on a line by chance, and a coarse sensor repeats its values.
        The default of 0.01 hPa (0.08 m) is the noise of the ST LPS25HB. The Bosch BMP280 has 0.005 hPa in the setting
        that its data sheet suggests for Android.
    temperature_c : float
        Temperature of the air, degrees Celsius. An increase of 10 degrees increases the rate by 3.5 %.
    """

    window_s: float = 4.0
    hop_s: float = 1.0
    max_gap_s: float = 2.0
    stuck_after_s: float = 5.0
    noise_hpa: float = 0.01
    temperature_c: float = 15.0

    def __post_init__(self) -> None:
        check_numbers(self, signed=("temperature_c",))
        if self.hop_s > self.window_s:
            raise ValueError(
                f"hop_s must be at most window_s, got {self.hop_s} and {self.window_s}: shorten hop_s or lengthen "
                "window_s"
            )
        if not -60 <= self.temperature_c <= 60:
            raise ValueError(
                f"temperature_c must be in degrees Celsius, -60 to 60, got {self.temperature_c}: convert kelvin or "
                "degrees Fahrenheit"
            )

    @property
    def scale_height_m(self) -> float:
        """Scale height of the atmosphere, R T / (g M), m, over which the pressure falls by a factor e.

        R is the gas constant, T the temperature, g the standard gravity and M the molar mass of air.
        """
        temperature_k = self.temperature_c + ZERO_CELSIUS_K
        return GAS_CONSTANT_J_PER_MOL_K * temperature_k / (STANDARD_GRAVITY_MPS2 * MOLAR_MASS_OF_AIR_KG_PER_MOL)

    def init(self) -> ClimbState:
        """Return the state before the first sample."""
        return ClimbState(np.empty((2, 0)), np.nan)

    def update(self, state: ClimbState, time_s: FloatArray, pressure_hpa: FloatArray) -> tuple[ClimbState, list[Climb]]:
        """Return the new state and the climbs of the windows completed by samples (N,), where N may be 0.

        Raises ValueError for pressures in Pa or kPa.
        """
        checked = checked_pressure(time_s, pressure_hpa)
        times, pressures = (samples.tolist() for samples in state.samples)
        due_s, behind_s, n_behind, quantum_hpa = state.due_s, state.behind_s, state.n_behind, state.quantum_hpa
        changed_s, stuck_s = state.changed_s, state.stuck_s
        first = 0  # index of the first sample after the last gap
        windows: list[tuple[int, int, int, float, float]] = []
        for t, p in checked.T.tolist():
            if len(times) > first and t <= times[-1]:
                n_behind = n_behind + 1 if t > behind_s else 1
                behind_s = t
                if n_behind < _CLOCK_RESET_SAMPLES:
                    continue
                first = len(times)
            n_behind, behind_s = 0, -np.inf
            if len(times) == first or t - times[-1] > self.max_gap_s:
                first, due_s, changed_s = len(times), t + self.window_s, t
                times.append(t)
                pressures.append(p)
                continue
            if p != pressures[-1]:
                quantum_hpa, changed_s = min(quantum_hpa, abs(p - pressures[-1])), t
            resolution_hpa = _pressure_resolution(quantum_hpa, p)
            is_stuck = t - changed_s >= self.stuck_after_s and not _FINE_HPA < resolution_hpa < np.inf
            stuck_s += is_stuck * min(t - times[-1], t - changed_s)
            nearest_s = t + 0.5 * (t - times[-1])  # this sample is the nearest one to all times up to here
            times.append(t)
            pressures.append(p)
            if nearest_s >= due_s:
                due_s += self.hop_s * (math.floor((nearest_s - due_s) / self.hop_s) + 1)
                start = bisect_left(times, t - self.window_s - _ROUNDING_S, lo=first)
                last = bisect_right(times, t - self.hop_s + _ROUNDING_S, lo=first)
                if len(times) - start >= 3 and not is_stuck:
                    windows.append((start, last, len(times), resolution_hpa, t - changed_s))
        samples = np.array([times, pressures])
        start = bisect_left(times, times[-1] - self.window_s - _ROUNDING_S, lo=first) if times else 0
        kept = samples[:, start:].copy()
        after = ClimbState(kept, due_s, behind_s, n_behind, quantum_hpa, changed_s, stuck_s)
        return after, self._climbs(samples, windows) if windows else []

    def _climbs(self, samples: FloatArray, windows: list[tuple[int, int, int, float, float]]) -> list[Climb]:
        """Return the climbs of windows of samples (2, B), which are times and pressures.

        Each window is given by the indices of its first sample, of the first sample of its last hop, and of its end.
        The other two are the resolution of the sensor so far, hPa, and the time since the last change of its value, s.
        """
        starts, lasts, ends = np.array([w[:3] for w in windows]).T
        quantum_hpa, equal_s = np.array([w[3:] for w in windows]).T
        n, n_last = ends - starts, ends - lasts
        time_s, pressure_hpa = samples[:, _ranges(starts, n)]
        each = np.cumsum(n) - n

        def sums(values: FloatArray) -> FloatArray:
            return np.add.reduceat(values, each)

        mean_hpa = sums(pressure_hpa) / n
        metres_per_hpa = self.scale_height_m / mean_hpa
        height_m = -np.repeat(metres_per_hpa, n) * (pressure_hpa - np.repeat(mean_hpa, n))
        from_middle_s = time_s - np.repeat(sums(time_s) / n, n)
        spread_s2 = sums(from_middle_s * from_middle_s)
        rate_mps = sums(from_middle_s * height_m) / spread_s2
        residual_m = height_m - np.repeat(rate_mps, n) * from_middle_s
        noise_m = metres_per_hpa * self.noise_hpa
        rate_var = np.maximum(sums(residual_m * residual_m) / (n - 2), noise_m**2) / spread_s2
        last_hpa = np.add.reduceat(samples[1, _ranges(lasts, n_last)], np.cumsum(n_last) - n_last) / n_last
        # Noise averages out over the samples. Rounding does not, because it is the same in all equal values.
        rounding_m = metres_per_hpa * np.where(np.isfinite(quantum_hpa), quantum_hpa, 0.0) / math.sqrt(12)
        # A constant climb has no second differences. Those of white noise have six times its variance.
        second_m = np.diff(height_m, 2, prepend=0.0, append=0.0)
        second_m[np.concatenate([each, each + n - 1])] = 0.0  # second differences across the border of two windows
        own_var_m2 = sums(second_m * second_m) / (6.0 * (n - 2)) - rounding_m**2
        sensor_m = np.sqrt(np.maximum(own_var_m2, noise_m**2))
        # A rate of repeated values is the difference of two rounded ones. So is each rate of a coarse sensor.
        is_rounded = (equal_s > 0) | (quantum_hpa > _FINE_HPA)
        std_mps = np.sqrt(rate_var + 2.0 * (np.where(is_rounded, rounding_m, 0.0) / self.window_s) ** 2)
        end_m = -self.scale_height_m * np.log(last_hpa / STANDARD_PRESSURE_HPA)
        end_std_m = np.hypot(sensor_m / np.sqrt(n_last), rounding_m * np.sqrt(np.maximum(equal_s / self.hop_s, 1.0)))
        columns = (samples[0, ends - 1], rate_mps, std_mps, n, end_m, end_std_m)
        return [Climb(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _pressure_resolution(quantum_hpa: float, pressure_hpa: float) -> float:
    """Return the resolution of a sensor in hPa: the smallest change, or before any change the decimals of the value."""
    if math.isfinite(quantum_hpa):
        return quantum_hpa
    return next((q for q in _COARSE_HPA if abs(pressure_hpa / q - round(pressure_hpa / q)) < _DIGITS), math.inf)


def _ranges(starts: IntArray, n: IntArray) -> IntArray:
    """Return the indices of consecutive ranges with the given starts and lengths, concatenated."""
    return np.repeat(starts - (np.cumsum(n) - n), n) + np.arange(n.sum())


def checked_pressure(time_s: FloatArray, pressure_hpa: FloatArray) -> FloatArray:
    """Return the times and pressures (2, N) of the usable samples: those with a finite time and 300 to 1100 hPa.

    Raises ValueError for wrong shapes and for pressures in Pa or kPa.
    """
    if time_s.ndim != 1 or time_s.shape != pressure_hpa.shape:
        raise ValueError(
            f"time_s and pressure_hpa must both be (N,), got {time_s.shape} and {pressure_hpa.shape}: for a recording, "
            "pass barometer.time_s and barometer.values[:, 0]"
        )
    for unit, (factor, remedy) in _OTHER_UNITS.items():
        other = _is_plausible(factor * pressure_hpa)
        if other.any():
            raise ValueError(
                f"pressure_hpa must be in hPa, got {pressure_hpa[other][0]:g}, which must be {unit}, not hPa: {remedy}"
            )
    good = np.isfinite(time_s) & _is_plausible(pressure_hpa)
    return np.stack([time_s[good], pressure_hpa[good]])


def _is_plausible(hpa: FloatArray) -> BoolArray:
    """Return True for pressures within the range of phone sensors; NaN compares False."""
    return (hpa >= _MIN_HPA) & (hpa <= _MAX_HPA)


# Climb rate on stairs: riser times steps a second. A riser is 0.14 to 0.19 m in general buildings (DIN 18065), mostly
# about 0.17 m. Persons take 1.6 +- 0.3 steps a second, up or down.
RISER_M, RISER_STD_M = 0.17, 0.01
STAIR_CADENCE_HZ, STAIR_CADENCE_STD_HZ = 1.6, 0.3
# Standard deviation of the climb rate in other contexts, due to ramps (1.3 m/s on a slope of 4 % are 0.05 m/s, and DIN
# 18040 allows at most 6 %) and draughts. Rates over 4 s have a standard deviation of 0.055 m/s on one storey (ipin21)
# and of 0.07 m/s for persons who stand near doors (ipin2023).
OTHER_STD_MPS = 0.06
# Probability that the climb rate is independent of the context, with a uniform distribution over the speeds of lifts:
# lifts (0.5 to 2.5 m/s), slamming doors, a sensor that warms up. It bounds the evidence of a window between two
# contexts by log(1 + (1 - 0.1) / 0.1 * 5 m/s / (sqrt(2 pi) 0.06 m/s)) = 5.7 nats.
OUTLIER_SHARE = 0.1
LIFT_MAX_MPS = 2.5

STAIRS_MPS = RISER_M * STAIR_CADENCE_HZ  # 0.27
# 0.08 m/s: 0.051 from the step frequency, 0.016 from the riser, and 0.06 from draughts, which occur on stairs too.
_STAIRS_STD_MPS = float(
    np.sqrt((RISER_M * STAIR_CADENCE_STD_HZ) ** 2 + (STAIR_CADENCE_HZ * RISER_STD_M) ** 2 + OTHER_STD_MPS**2)
)


@lru_cache
def _climb_rates(contexts: ContextSet) -> tuple[FloatArray, FloatArray]:
    """Return the mean climb rate (C,) of each context in m/s, and its variance (C,)."""
    climbs = np.array([c.climbs for c in contexts.contexts])
    return climbs * STAIRS_MPS, np.where(climbs != 0, _STAIRS_STD_MPS**2, OTHER_STD_MPS**2)


def climb_log_evidence(
    climb_rate_mps: ArrayLike, std_mps: ArrayLike, contexts: ContextSet = DEFAULT_CONTEXTS
) -> FloatArray:
    """Return the log likelihood of climb rates (...) in each context, (..., C), up to a common constant.

    It is log((1 - e) N(v; m_c, s_c^2 + std^2) + e / (2 v_max)), with the rate v and the mean m_c and standard deviation
    s_c of context c. The rates are 0.27 +- 0.08 m/s upstairs, -0.27 +- 0.08 m/s downstairs and 0 +- 0.06 m/s in other
    contexts. With probability e = 0.1 the rate belongs to a lift and is uniform between -2.5 and 2.5 m/s. At the speed
    of a lift all contexts are equally likely, and the other sensors must distinguish standing from stairs. A slow lift
    (0.5 m/s) still gives 1 nat for stairs, each lift passes the rate of stairs while it accelerates, and an escalator
    keeps it. The evidence is therefore bounded, and must not be the only evidence. A rate with a large `std_mps` gives
    no evidence. Raises ValueError for a rate that is not finite or a negative `std_mps`.
    """
    rate, std = np.asarray(climb_rate_mps, dtype=float)[..., None], np.asarray(std_mps, dtype=float)[..., None]
    if not (np.isfinite(rate) & (std >= 0)).all():
        raise ValueError(
            f"climb_rate_mps must be finite and std_mps at least zero, got {climb_rate_mps} and {std_mps}: leave out "
            "windows without a climb rate"
        )
    mean_mps, var_mps2 = _climb_rates(contexts)
    var = var_mps2 + std**2
    deviation = rate - mean_mps
    density = np.exp(-0.5 * deviation * deviation / var) / np.sqrt(2 * math.pi * var)
    return np.log((1 - OUTLIER_SHARE) * density + OUTLIER_SHARE / (2 * LIFT_MAX_MPS))
