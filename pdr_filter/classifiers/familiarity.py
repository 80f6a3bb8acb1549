"""How far a window lies from what a model was trained on: the guard against confident answers about the unseen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.classifiers.base_classifier import Stored
from pdr_filter.values import FloatArray, check_array

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
    limit: float  # distance that one or two in a hundred windows of people left out of training exceed
    sharpness: float = 2.0  # how fast the unknown share grows beyond the limit

    def __post_init__(self) -> None:
        self._make_read_only("axes", "variance")
        if self.axes.ndim != 2 or self.variance.shape != self.axes.shape[:1]:
            raise ValueError(f"axes must be (K, F) and variance (K,), got {self.axes.shape}, {self.variance.shape}")
        check_array("axes", self.axes)
        if not (self.variance >= _LEAST_VARIANCE).all():
            raise ValueError(f"variance must be at least {_LEAST_VARIANCE}, got {self.variance}")
        for name in ("limit", "sharpness"):
            check_array(name, getattr(self, name), "positive")

    def distance(self, standardised: FloatArray) -> FloatArray:
        """Distances (...) of windows' standardised features (..., F)."""
        z = np.clip(standardised, -_CUT, _CUT)
        # window by window: products of a batch have other bits than those of a row
        along = z[..., None, :] @ self.axes.T
        narrow = (z * z).sum(axis=-1) / _LEAST_VARIANCE
        wide = (along * along @ (1 / self.variance - 1 / _LEAST_VARIANCE))[..., 0]
        return np.sqrt(np.maximum(narrow + wide, 0.0) / z.shape[-1])

    def unknown_share(self, standardised: FloatArray) -> FloatArray:
        """Shares (...): 1 - (limit / d)^sharpness beyond the limit, for 2 three quarters at twice of it; else zero."""
        return unknown_share(self.distance(standardised), self.limit, self.sharpness)


def unknown_share(distance: FloatArray, limit: float, sharpness: float) -> FloatArray:
    """What `Familiarity.unknown_share` is at distances (...)."""
    return 1.0 - (limit / np.maximum(distance, limit)) ** sharpness


def fit_familiarity(standardised: FloatArray, limit: float, sharpness: float = 2.0) -> Familiarity:
    """Principal axes and variances of standardised features (N, F), cut at 8; the limit comes from people left out.

    Variances are about zero, the mean of all training windows. Of a part of these (stairs) that of the part is not
    zero, and windows are then familiar as far out on the line through both as the part is.
    """
    cut = np.clip(standardised, -_CUT, _CUT)
    variance, axes = np.linalg.eigh(cut.T @ cut / len(cut))
    wide = variance > _LEAST_VARIANCE
    # eleven binary digits: the distances differ by a thousandth, the file is a third
    short = axes[:, wide].T.astype(np.float16)
    return Familiarity(short.astype(np.float64), variance[wide], limit, sharpness)
