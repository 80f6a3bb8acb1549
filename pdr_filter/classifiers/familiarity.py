"""How far a window lies from what a model was trained on: the guard against confident answers about the unseen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.classifiers.machine import Stored
from pdr_filter.values import FloatArray

# A feature further out than this counts as this far: one broken feature alone cannot make the distance infinite.
_CUT = 8.0
# Variance below which a direction counts as this wide. Of standardised features; narrower directions are differences
# between nearly equal features, in which any new person is far out.
_LEAST_VARIANCE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Familiarity(Stored):
    """Mahalanobis distance to the training windows, and the share of it that is unknown.

    d^2 = 1/F sum_k y_k^2 / max(v_k, 0.05), y the features along the principal axes of the training windows, v their
    variances. The squared distances of what is like the training set are about one.
    """

    axes: FloatArray  # (K, F) principal axes of the standardised features with a variance above 0.05
    variance: FloatArray  # (K,) along them
    limit: float  # distance that one in a hundred windows of people left out of training exceeds

    def __post_init__(self) -> None:
        self._make_read_only("axes", "variance")
        if self.axes.ndim != 2 or self.variance.shape != self.axes.shape[:1]:
            raise ValueError(f"axes must be (K, F) and variance (K,), got {self.axes.shape}, {self.variance.shape}")
        if not (np.isfinite(self.axes).all() and (self.variance >= _LEAST_VARIANCE).all()):
            raise ValueError(f"axes must be finite and variances at least {_LEAST_VARIANCE}")
        if not (np.isfinite(self.limit) and self.limit > 0):
            raise ValueError(f"limit must be positive, got {self.limit}")

    def distance(self, standardised: FloatArray) -> float:
        """Distance of one window's standardised features (F,)."""
        z = np.clip(standardised, -_CUT, _CUT)
        along = self.axes @ z
        squared = float(z @ z) / _LEAST_VARIANCE + float(along**2 @ (1 / self.variance - 1 / _LEAST_VARIANCE))
        return float(np.sqrt(max(squared, 0.0) / len(z)))

    def unknown_share(self, standardised: FloatArray) -> float:
        """1 - (limit / d)^2 beyond the limit, else zero: 0.56 at one and a half times the limit, 0.75 at twice."""
        distance = self.distance(standardised)
        return 1.0 - (self.limit / distance) ** 2 if distance > self.limit else 0.0


def fit_familiarity(standardised: FloatArray, limit: float) -> Familiarity:
    """Principal axes and variances of standardised features (N, F), cut at 8; the limit comes from people left out."""
    cut = np.clip(standardised, -_CUT, _CUT)
    variance, axes = np.linalg.eigh(np.cov(cut.T))
    wide = variance > _LEAST_VARIANCE
    return Familiarity(axes[:, wide].T, variance[wide], limit)
