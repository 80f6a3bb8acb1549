"""Evidence of walking around the contact of a step: four features of the specific force, and what they say together.

The features of many steps are computed together, each with the bits that it has alone. Their times run with the steps:
`slowness` stretches them for a slow walker. tests/benchmarks/steps.py fits the weights.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, check_numbers, pickled, read_only

# Rate at which the evidence looks at the force: steps are below 5 Hz.
EVIDENCE_HZ = 25.0
# A window with fewer rows (1 s) is no evidence: it holds no two steps.
MIN_ROWS = 26
# Longest interval of a usual walk, 1.67 steps a second: below that the times of the evidence are stretched.
_USUAL_INTERVAL_S = 0.6
# The slowest walk to which they follow, 0.76 steps a second: more of the past would have to be remembered.
MAX_SLOWNESS = 2.2
# Longest lag at which a motion is looked for again; of slow walkers as many steps, a stride and a quarter.
_MAX_LAG_S = 2.24
_MAX_LAG_STEPS = 2.5
# Standard deviations at which a feature is cut, in the fit too: no single feature can outvote the others.
_LIMIT = 3.0
# Windows at once: their spectra fit into a cache.
_MAX_GROUP = 16


@dataclass(frozen=True, slots=True, eq=False)
class WalkEvidence:
    """Log odds of walking from the features of `evidence_features`: b + sum_i w_i clip((x_i - m_i) / s_i, -3, 3)."""

    mean: FloatArray  # (4,) m
    scale: FloatArray  # (4,) s
    weight: FloatArray  # (4,) w
    intercept: float  # b

    __reduce__ = pickled

    def __post_init__(self) -> None:
        check_numbers(self, signed=("intercept",))
        for name in ("mean", "scale", "weight"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def log_odds(self, features: FloatArray) -> FloatArray:
        """Log odds of walking (K,) of steps with features (K, 4)."""
        cut = np.minimum(np.maximum((features - self.mean) / self.scale, -_LIMIT), _LIMIT)
        return self.intercept + (self.weight * cut).sum(axis=1)


# In the order of `evidence_features`. Walking and not walking had the same mass.
EVIDENCE = WalkEvidence(
    mean=np.array([0.40, 0.25, -0.60, 0.55]),
    scale=np.array([0.37, 0.21, 0.96, 0.27]),
    weight=np.array([2.81, -1.92, -1.89, 2.04]),
    intercept=1.42,
)


def slowness(intervals_s: Sequence[float]) -> float:
    """Median step interval in longest intervals of a usual walk, 1 to 2.2; 1 where none is known."""
    if not intervals_s:
        return 1.0
    return min(max(sorted(intervals_s)[len(intervals_s) // 2] / _USUAL_INTERVAL_S, 1.0), MAX_SLOWNESS)


def evidence_features(windows: Sequence[FloatArray], intervals_s: Sequence[Sequence[float]]) -> FloatArray:
    """The features (K, 4) of steps in which walking and handling differ.

    From the specific force around each contact at 25 Hz, (N, 3), N >= 26, and up to three step intervals before it: how
    much the force repeats with its direction (the autocorrelation's highest value after it was negative), how uneven
    the rhythm is (standard deviation of the logarithm of three intervals), how far the phone turns for how little it
    bounces (log of the rms of the force averaged over 0.76 s, over that of its magnitude), and how much the magnitude
    repeats.

    A walk that is c times as slow, c the `slowness`, is averaged c times as long and looked for again at lags of a
    stride. Its bounce counts c times as much: acceleration falls with c^2 while the tilt of the phone stays. With all
    of c^2 a phone that is wagged slowly passes as a walk.
    """
    features = np.empty((len(windows), 4))
    stretch = np.array([slowness(intervals) for intervals in intervals_s])
    alike: dict[tuple[int, int, int], list[int]] = defaultdict(list)
    for i, (window, c) in enumerate(zip(windows, stretch.tolist(), strict=True)):
        n, max_lag_s = len(window), max(_MAX_LAG_S, _MAX_LAG_STEPS * _USUAL_INTERVAL_S * c)
        alike[n, min(2 * round(9 * c) + 1, n - 1), min(round(max_lag_s * EVIDENCE_HZ) + 1, n - 11)].append(i)
    for (_, n_box, n_lags), found in alike.items():
        for start in range(0, len(found), _MAX_GROUP):
            group = found[start : start + _MAX_GROUP]
            force = np.stack([windows[i].T for i in group])
            features[np.ix_(group, (0, 2, 3))] = _of_group(force, n_box, n_lags, stretch[group])
    # fewer than three intervals keep no rhythm: as uneven as handling
    rhythmic = [len(intervals) > 2 for intervals in intervals_s]
    features[:, 1] = 0.5
    if any(rhythmic):
        features[rhythmic, 1] = np.log([s for s in intervals_s if len(s) > 2]).std(axis=1)
    return features


def _of_group(force: FloatArray, n_box: int, n_lags: int, stretch: FloatArray) -> FloatArray:
    """The features of force (B, 3, N) but for the rhythm, (B, 3)."""
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    signals = np.concatenate([force, np.sqrt(x * x + y * y + z * z)[:, None]], axis=1)
    signals -= signals.mean(axis=2)[:, :, None]
    total = np.zeros((len(force), 3, force.shape[2] + 1))
    np.cumsum(signals[:, :3], axis=2, out=total[:, :, 1:])
    slow = (total[:, :, n_box:] - total[:, :, :-n_box]) / n_box
    slow_mps2 = np.sqrt(slow.var(axis=2).sum(axis=1)) + 0.05
    bounce_mps2 = (np.sqrt((signals[:, 3] ** 2).mean(axis=1)) + 0.02) * stretch
    repeats = repetitions(signals, n_lags)
    return np.stack([repeats[:, 0], np.log(slow_mps2 / bounce_mps2), repeats[:, 1]], axis=1)


def repetitions(signals: FloatArray, n_lags: int) -> FloatArray:
    """Highest autocorrelations (B, 2) after they were negative, 0 to 1; 0 if one never was.

    r(l) = sum x(t) . x(t + l) / sqrt(sum |x(t)|^2 sum |x(t + l)|^2) over the samples that both have, for lags of 0 to
    `n_lags` - 1 samples. Of signals (B, 4, N) with mean zero x is the vector of the first three, and the last alone.
    The products are summed by their spectra, of so many points that no end meets the other.
    """
    n = signals.shape[2]
    n_points = 32 * math.ceil((n + n_lags) / 32)
    spectrum = np.fft.rfft(signals, n_points)
    product = np.fft.irfft(_of_both(spectrum.real**2 + spectrum.imag**2), n_points)[:, :, :n_lags]
    energy = np.zeros((len(signals), 2, n + 1))
    np.cumsum(_of_both(signals**2), axis=2, out=energy[:, :, 1:])
    # of the samples up to each lag before the end, and from each lag on
    both = energy[:, :, : n - n_lags : -1] * (energy[:, :, -1:] - energy[:, :, :n_lags])
    correlation = product / np.sqrt(both + 1e-6)
    was_negative = np.logical_or.accumulate(correlation < 0, axis=2)
    return np.where(was_negative, correlation, 0.0).max(axis=2)


def _of_both(squares: FloatArray) -> FloatArray:
    """Squares (B, 4, N) of the vector and of the last signal, (B, 2, N)."""
    return np.add.reduceat(squares, [0, 3], axis=1)
