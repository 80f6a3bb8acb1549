"""Evidence for walking around the contact of a step: four features of the specific force, and their log odds.

The features of many steps are computed together, with the same bits as for each step alone. For a slow walker the time
scales of the features are stretched by the `slowness` of the steps.

tests/benchmarks/steps.py fits the weights (`EVIDENCE`) by logistic regression with equal total weights of two classes.
Steps of walking are inside the walks of ubicomp13 (A. Brajdic and R. Harle, UbiComp 2013, doi:10.1145/2493432.2493449),
motionsense, oxford, tyrex, humolire and ms_indoor. Steps of not walking are outside the walks of ubicomp13, or of
people who sit and stand (motionsense). All handling in these data follows one protocol: phones are taken out, started
and put away.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, check_numbers, read_only, reduction

# Rate to which the specific force is averaged, Hz. It is sufficient because steps are below 5 Hz.
EVIDENCE_HZ = 25.0
# Fewest rows of a window (1 s). A shorter one does not contain two steps and gives no evidence.
MIN_ROWS = 26
# Longest step interval of normal walking, s, which is 1.67 steps a second. Slower walking stretches the time scales.
_USUAL_INTERVAL_S = 0.6
# Largest stretch, reached at 0.76 steps a second. A larger value would need a longer buffer.
MAX_SLOWNESS = 2.2
# Longest lag of the autocorrelation, in s and, for slow walkers, in step intervals (a stride and a quarter).
_MAX_LAG_S = 2.24
_MAX_LAG_STEPS = 2.5
# Number of standard deviations at which features are clipped, also in the fit, so that no single feature dominates.
_LIMIT = 3.0
# Windows that are processed together, so that their spectra fit into the processor's cache.
_MAX_GROUP = 16


@dataclass(frozen=True, slots=True, eq=False)
class WalkEvidence:
    """Linear model of the log odds of walking given the features x of `evidence_features`.

    The log odds are b + sum_i w_i clip((x_i - m_i) / s_i, -3, 3), with the bias b and, for each feature, the weight
    w_i, the mean m_i and the standard deviation s_i.
    """

    mean: FloatArray  # means m of the features, shape (4,)
    scale: FloatArray  # standard deviations s of the features, shape (4,)
    weight: FloatArray  # weights w, shape (4,)
    intercept: float  # intercept b

    __reduce__ = reduction

    def __post_init__(self) -> None:
        check_numbers(self, signed=("intercept",))
        for name in ("mean", "scale", "weight"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))

    def log_odds(self, features: FloatArray) -> FloatArray:
        """Return the log odds of walking (K,) for features (K, 4)."""
        clipped = np.minimum(np.maximum((features - self.mean) / self.scale, -_LIMIT), _LIMIT)
        return self.intercept + (self.weight * clipped).sum(axis=1)


# The order is that of `evidence_features`.
EVIDENCE = WalkEvidence(
    mean=np.array([0.40, 0.25, -0.60, 0.55]),
    scale=np.array([0.37, 0.21, 0.96, 0.27]),
    weight=np.array([2.81, -1.92, -1.89, 2.04]),
    intercept=1.42,
)


def slowness(intervals_s: Sequence[float]) -> float:
    """Return the median step interval relative to the longest one of normal walking, clipped to 1 to 2.2.

    The result is 1 if no interval is known.
    """
    if not intervals_s:
        return 1.0
    return min(max(sorted(intervals_s)[len(intervals_s) // 2] / _USUAL_INTERVAL_S, 1.0), MAX_SLOWNESS)


def evidence_features(windows: Sequence[FloatArray], intervals_s: Sequence[Sequence[float]]) -> FloatArray:
    """Return the features (K, 4) that distinguish walking from handling of the phone.

    The input of each step is the specific force around its contact at 25 Hz, (N, 3) with N >= 26, and up to three step
    intervals before it. The features are:

    0. Repetition of the force vector: highest value of its autocorrelation after it was first negative.
    1. Irregularity of the rhythm: standard deviation of the logarithm of three intervals, or 0.5 if fewer are known.
    2. Rotation relative to bounce: log of the rms of the force averaged over 0.76 s, over the rms of its magnitude.
    3. Repetition of the magnitude of the force, as for the vector.

    For a walk with slowness c the averaging time is c times longer, and the longest lag is at least 2.5 slow step
    intervals. The bounce is multiplied by c, because the acceleration falls with c^2 while the tilt of the phone does
    not change. With the full c^2, a phone that is slowly wagged would pass as walking.
    """
    features = np.empty((len(windows), 4))
    stretch = np.array([slowness(intervals) for intervals in intervals_s])
    same_size: dict[tuple[int, int, int], list[int]] = defaultdict(list)
    for i, (window, c) in enumerate(zip(windows, stretch.tolist(), strict=True)):
        n, max_lag_s = len(window), max(_MAX_LAG_S, _MAX_LAG_STEPS * _USUAL_INTERVAL_S * c)
        same_size[n, min(2 * round(9 * c) + 1, n - 1), min(round(max_lag_s * EVIDENCE_HZ) + 1, n - 11)].append(i)
    for (_, n_box, n_lags), found in same_size.items():
        for start in range(0, len(found), _MAX_GROUP):
            group = found[start : start + _MAX_GROUP]
            force = np.array([windows[i].T for i in group])
            of_force = _evidence_of_force(force, n_box, n_lags, stretch[group])
            features[group, 0], features[group, 2], features[group, 3] = of_force
    # Fewer than three intervals define no rhythm, so the irregularity is set to that of handling.
    rhythmic = [len(intervals) > 2 for intervals in intervals_s]
    features[:, 1] = 0.5
    if any(rhythmic):
        features[rhythmic, 1] = np.log([s for s in intervals_s if len(s) > 2]).std(axis=1)
    return features


def _evidence_of_force(
    force: FloatArray, n_box: int, n_lags: int, stretch: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return features 0, 2 and 3, (B,) each, of windows of specific force (B, 3, N)."""
    x, y, z = force[:, 0], force[:, 1], force[:, 2]
    n, signals = force.shape[2], np.concatenate([force, np.sqrt(x * x + y * y + z * z)[:, None]], axis=1)
    signals -= (np.add.reduce(signals, axis=2) / n)[:, :, None]
    total = np.zeros((len(force), 3, n + 1))
    np.cumsum(signals[:, :3], axis=2, out=total[:, :, 1:])
    slow = (total[:, :, n_box:] - total[:, :, :-n_box]) / n_box
    slow -= (np.add.reduce(slow, axis=2) / slow.shape[2])[:, :, None]
    slow_mps2 = np.sqrt(np.add.reduce(np.add.reduce(slow * slow, axis=2) / slow.shape[2], axis=1)) + 0.05
    bounce_mps2 = (np.sqrt(np.add.reduce(signals[:, 3] ** 2, axis=1) / n) + 0.02) * stretch
    repeats = autocorrelation_peaks(signals, n_lags)
    return repeats[:, 0], np.log(slow_mps2 / bounce_mps2), repeats[:, 1]


def autocorrelation_peaks(signals: FloatArray, n_lags: int) -> FloatArray:
    """Return the highest autocorrelations (B, 2) after they were first negative, 0 to 1; 0 if they never were.

    r(l) = sum x(t) . x(t + l) / sqrt(sum |x(t)|^2 sum |x(t + l)|^2) over the samples in the overlap, for lags l of 0 to
    `n_lags` - 1 samples. For zero-mean signals (B, 4, N), x is the vector of the first three signals in the first
    result, and the fourth signal in the second. The products are computed from spectra, zero-padded to avoid circular
    wrap-around.
    """
    n = signals.shape[2]
    n_points = 32 * math.ceil((n + n_lags) / 32)
    spectrum = np.fft.rfft(signals, n_points)
    product = np.fft.irfft(_vector_and_last(spectrum.real**2 + spectrum.imag**2), n_points)[:, :, :n_lags]
    energy = np.zeros((len(signals), 2, n + 1))
    np.cumsum(_vector_and_last(signals**2), axis=2, out=energy[:, :, 1:])
    # energy of the samples in the overlap: those before the last l, and those from l on
    both = energy[:, :, : n - n_lags : -1] * (energy[:, :, -1:] - energy[:, :, :n_lags])
    correlation = product / np.sqrt(both + 1e-6)
    was_negative = np.logical_or.accumulate(correlation < 0, axis=2)
    return np.where(was_negative, correlation, 0.0).max(axis=2)


def _vector_and_last(squares: FloatArray) -> FloatArray:
    """Return the squared length of the first three signals and the square of the fourth, (B, 2, N), of (B, 4, N)."""
    return np.add.reduceat(squares, [0, 3], axis=1)
