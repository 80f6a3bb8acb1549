"""Climb rate and height from a barometer, and the evidence of the rate for stairs.

Height differences come from the hydrostatic relation, dh = -(R T / (g M)) dp / p: air of 15 degrees has a scale height
of 8435 m, so that 1 hPa is 8.32 m at 1013 hPa. Only differences count: weather moves the pressure by a few hPa an hour
at most, which is less than 0.01 m/s.

What `climb_log_evidence` takes for stairs comes from building codes, what it takes for lifts from judgement, the noise
of the sensor from data sheets. Two recordings with a barometer are at hand, none with labels: draughts were measured on
them, and on eight changes of storey (ipin2023) the rates on stairs are 0.2 to 0.4 m/s, as the codes say.
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

GAS_CONSTANT_J_PER_MOL_K = 8.314462618
MOLAR_MASS_OF_AIR_KG_PER_MOL = 0.0289644  # dry; damp air at 20 degrees is up to 0.9 % lighter
ZERO_CELSIUS_K = 273.15
STANDARD_PRESSURE_HPA = 1013.25

# The range of phones' sensors (Bosch BMP280, data sheet BST-BMP280-DS001: 300 to 1100 hPa). What is outside is a failed
# reading, unless it is inside in another unit.
_MIN_HPA, _MAX_HPA = 300.0, 1100.0
_OTHER_UNITS = {"Pa": (0.01, "divide by 100"), "kPa": (10.0, "multiply by 10")}
# Times of recordings have six decimals: a sample this little outside a window is not.
_ROUNDING_S = 1e-6
# So many samples in a row behind the clock, in order, are no stragglers: the clock was set back.
_CLOCK_RESET_SAMPLES = 10


@dataclass(frozen=True, slots=True)
class Climb:
    """Climb rate over one window, and the height at its end."""

    time_s: float  # last sample of the window: the rate is the mean over the window before, half a window old
    climb_rate_mps: float  # up positive
    std_mps: float
    n_samples: int
    height_m: float  # of the mean pressure of the last hop, above that of 1013.25 hPa
    height_std_m: float  # of the sensor alone


@dataclass(frozen=True, slots=True, eq=False)
class ClimbState:
    """Samples that later windows still need, when the next is due, and whether the clock was set back."""

    samples: FloatArray  # (2, B): time, pressure
    due_s: float  # the sample nearest to this ends a window
    behind_s: float = -np.inf  # time of the last sample that was behind
    n_behind: int = 0  # samples in a row that were behind, and increasing
    quantum_hpa: float = np.inf  # least difference of two samples that follow one another


@dataclass(frozen=True)
class ClimbRate:
    """Least-squares slope of the height over a trailing window; causal, samples at any rate.

    A window ends with the sample nearest to each hop, as far as the spacing of the last two shows, and has at least
    three samples. It never spans a gap: after one, windows start afresh, the first when it is full. Duplicate and
    backward times are dropped, NaN and failed readings left out.

    Parameters
    ----------
    window_s, hop_s : float
        Length and advance. At 1 Hz, the slowest that phones deliver, 4 s are five samples: a standard deviation of
        0.026 m/s with the noise below, a tenth of what stairs climb.
    max_gap_s : float
        A longer time without samples is a gap.
    noise_hpa : float
        Least standard deviation of a sample: few samples may lie on a line by chance, and a coarse sensor repeats
        itself. 0.01 hPa (0.08 m) is the noise of the ST LPS25HB; the Bosch BMP280 has 0.005 hPa in the setting that its
        data sheet suggests for Android.
    temperature_c : float
        Of the air; 10 degrees more make the rate 3.5 % larger.
    """

    window_s: float = 4.0
    hop_s: float = 1.0
    max_gap_s: float = 2.0
    noise_hpa: float = 0.01
    temperature_c: float = 15.0

    def __post_init__(self) -> None:
        check_numbers(self, signed=("temperature_c",))
        if self.hop_s > self.window_s:
            raise ValueError(f"hop_s must be at most window_s, got {self.hop_s} and {self.window_s}")
        if not -60 <= self.temperature_c <= 60:
            raise ValueError(f"temperature_c must be in degrees Celsius, -60 to 60, got {self.temperature_c}")

    @property
    def scale_height_m(self) -> float:
        """R T / (g M): the height over which the pressure falls by a factor e."""
        temperature_k = self.temperature_c + ZERO_CELSIUS_K
        return GAS_CONSTANT_J_PER_MOL_K * temperature_k / (STANDARD_GRAVITY_MPS2 * MOLAR_MASS_OF_AIR_KG_PER_MOL)

    def init(self) -> ClimbState:
        """State before the first sample."""
        return ClimbState(np.empty((2, 0)), np.nan)

    def update(self, state: ClimbState, time_s: FloatArray, pressure_hpa: FloatArray) -> tuple[ClimbState, list[Climb]]:
        """New state and the windows that became complete, from samples (N,), N >= 0; ValueError for Pa or kPa."""
        fresh = checked_pressure(time_s, pressure_hpa)
        times, pressures = (samples.tolist() for samples in state.samples)
        due_s, behind_s, n_behind, quantum_hpa = state.due_s, state.behind_s, state.n_behind, state.quantum_hpa
        first = 0  # of the samples since a gap
        windows: list[tuple[int, int, int, float]] = []
        for t, p in fresh.T.tolist():
            if len(times) > first and t <= times[-1]:
                n_behind = n_behind + 1 if t > behind_s else 1
                behind_s = t
                if n_behind < _CLOCK_RESET_SAMPLES:
                    continue
                first = len(times)
            n_behind, behind_s = 0, -np.inf
            if len(times) == first or t - times[-1] > self.max_gap_s:
                first, due_s = len(times), t + self.window_s
                times.append(t)
                pressures.append(p)
                continue
            if p != pressures[-1]:
                quantum_hpa = min(quantum_hpa, abs(p - pressures[-1]))
            nearest_s = t + 0.5 * (t - times[-1])  # until when no later sample is expected to be nearer
            times.append(t)
            pressures.append(p)
            if nearest_s >= due_s:
                due_s += self.hop_s * (math.floor((nearest_s - due_s) / self.hop_s) + 1)
                start = bisect_left(times, t - self.window_s - _ROUNDING_S, lo=first)
                last = bisect_right(times, t - self.hop_s + _ROUNDING_S, lo=first)
                if len(times) - start >= 3:
                    windows.append((start, last, len(times), quantum_hpa))
        samples = np.array([times, pressures])
        start = bisect_left(times, times[-1] - self.window_s - _ROUNDING_S, lo=first) if times else 0
        kept = samples[:, start:].copy()
        return ClimbState(kept, due_s, behind_s, n_behind, quantum_hpa), self._fits(samples, windows) if windows else []

    def _fits(self, samples: FloatArray, windows: list[tuple[int, int, int, float]]) -> list[Climb]:
        """Climbs of windows: first sample, first of the last hop, end, and the least difference so far."""
        starts, lasts, ends = np.array([w[:3] for w in windows]).T
        quantum_hpa, n, n_last = np.array([w[3] for w in windows]), ends - starts, ends - lasts
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
        std_mps = np.sqrt(np.maximum(sums(residual_m * residual_m) / (n - 2), noise_m**2) / spread_s2)
        last_hpa = np.add.reduceat(samples[1, _ranges(lasts, n_last)], np.cumsum(n_last) - n_last) / n_last
        # noise is of each sample, rounding of all of them alike
        rounding_m = metres_per_hpa * np.where(np.isfinite(quantum_hpa), quantum_hpa, 0.0) / math.sqrt(12)
        end_m = -self.scale_height_m * np.log(last_hpa / STANDARD_PRESSURE_HPA)
        end_std_m = np.hypot(noise_m / np.sqrt(n_last), rounding_m)
        columns = (samples[0, ends - 1], rate_mps, std_mps, n, end_m, end_std_m)
        return [Climb(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]


def _ranges(starts: IntArray, n: IntArray) -> IntArray:
    """Indices of all ranges one after the other."""
    return np.repeat(starts - (np.cumsum(n) - n), n) + np.arange(n.sum())


def checked_pressure(time_s: FloatArray, pressure_hpa: FloatArray) -> FloatArray:
    """Time and pressure (2, N) without what cannot be used."""
    if time_s.ndim != 1 or time_s.shape != pressure_hpa.shape:
        raise ValueError(
            f"time_s and pressure_hpa must both be (N,), got {time_s.shape} and {pressure_hpa.shape}: of a recording, "
            "give barometer.time_s and barometer.values[:, 0]"
        )
    for unit, (factor, remedy) in _OTHER_UNITS.items():
        other = _is_plausible(factor * pressure_hpa)
        if other.any():
            raise ValueError(f"a pressure of {pressure_hpa[other][0]:g} must be {unit}, not hPa: {remedy}")
    good = np.isfinite(time_s) & _is_plausible(pressure_hpa)
    return np.stack([time_s[good], pressure_hpa[good]])


def _is_plausible(hpa: FloatArray) -> BoolArray:
    return (hpa >= _MIN_HPA) & (hpa <= _MAX_HPA)  # NaN is not


# Stairs: the riser times the steps a second. A riser is 0.14 to 0.19 m in buildings in general (DIN 18065), mostly
# about 0.17 m; people take 1.6 +- 0.3 steps a second, up or down.
RISER_M, RISER_STD_M = 0.17, 0.01
STAIR_CADENCE_HZ, STAIR_CADENCE_STD_HZ = 1.6, 0.3
# Elsewhere: ramps (1.3 m/s on 4 % are 0.05 m/s; 6 % is the steepest that DIN 18040 allows) and draughts. Rates over 4 s
# have a standard deviation of 0.055 m/s on one storey (ipin21) and of 0.07 where somebody stands near doors (ipin2023).
OTHER_STD_MPS = 0.06
# Lifts (0.5 to 2.5 m/s), doors that slam, a sensor that heats up: the share of windows of any context whose rate shows
# nothing of it, even over what lifts do. It bounds the evidence: between two contexts a window weighs at most
# log(1 + (1 - 0.1) / 0.1 * 5 m/s / (sqrt(2 pi) 0.06 m/s)) = 5.7 nats.
OUTLIER_SHARE = 0.1
LIFT_MAX_MPS = 2.5

_STAIRS_MPS = RISER_M * STAIR_CADENCE_HZ  # 0.27
# 0.08: cadence 0.051, riser 0.016, and draughts on stairs too
_STAIRS_STD_MPS = float(
    np.sqrt((RISER_M * STAIR_CADENCE_STD_HZ) ** 2 + (STAIR_CADENCE_HZ * RISER_STD_M) ** 2 + OTHER_STD_MPS**2)
)


@lru_cache
def _climb_rates(contexts: ContextSet) -> tuple[FloatArray, FloatArray]:
    """Mean climb rate (C,) in m/s of each context, and its variance (C,)."""
    climbs = np.array([c.climbs for c in contexts.contexts])
    return climbs * _STAIRS_MPS, np.where(climbs != 0, _STAIRS_STD_MPS**2, OTHER_STD_MPS**2)


def climb_log_evidence(
    climb_rate_mps: ArrayLike, std_mps: ArrayLike, contexts: ContextSet = DEFAULT_CONTEXTS
) -> FloatArray:
    """Log likelihood of climb rates (...) in each context, (..., C), up to a constant common to all.

    log((1 - e) N(v; m_c, s_c^2 + std^2) + e / (2 v_max)): upstairs 0.27 +- 0.08 m/s, downstairs -0.27 +- 0.08 m/s, the
    others 0 +- 0.06 m/s, and with probability e = 0.1 anything that a lift does. At the speed of a lift all contexts
    are equally likely, and the other sensors distinguish standing from stairs. A slow lift (0.5 m/s) is still 1 nat for
    stairs, each lift passes their rate on the way to its own, and an escalator keeps it: so the evidence is bounded,
    and must not be the only one. A rate with a large `std_mps` is no evidence.
    """
    rate, std = np.asarray(climb_rate_mps, dtype=float)[..., None], np.asarray(std_mps, dtype=float)[..., None]
    if not (np.isfinite(rate) & (std >= 0)).all():
        raise ValueError(f"climb_rate_mps must be finite and std_mps at least zero, got {climb_rate_mps}, {std_mps}")
    mean_mps, var_mps2 = _climb_rates(contexts)
    var = var_mps2 + std**2
    away = rate - mean_mps
    density = np.exp(-0.5 * away * away / var) / np.sqrt(2 * math.pi * var)
    return np.log((1 - OUTLIER_SHARE) * density + OUTLIER_SHARE / (2 * LIFT_MAX_MPS))
