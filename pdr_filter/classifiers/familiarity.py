"""Distance of a window to the training data of a model, against confident classification of unfamiliar motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.classifiers.base_classifier import Stored
from pdr_filter.values import FloatArray, check_array

# Standardised features are cut at this value, so that a single broken feature cannot make the distance infinite.
_FEATURE_LIMIT = 8.0
# Minimum variance along a direction of standardised features. Directions of smaller variance are differences of nearly
# equal features, in which every new person would be far from the training data.
_MIN_VARIANCE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Familiarity(Stored):
    """Mahalanobis distance of a window to the training windows, and the unknown share that follows from it.

    d^2 = 1/F sum_k y_k^2 / max(v_k, 0.05), with the F features of a window projected on the principal axes of the
    training windows, y_k, and their variances v_k there. Windows like the training windows have squared distances of
    about one.
    """

    axes: FloatArray  # (K, F) principal axes of the standardised features with a variance above 0.05
    variance: FloatArray  # (K,) variances along the axes
    limit: float  # distance exceeded by one to two percent of the windows of held-out people
    sharpness: float = 2.0  # growth of the unknown share beyond the limit

    def __post_init__(self) -> None:
        self._make_read_only("axes", "variance")
        if self.axes.ndim != 2 or self.variance.shape != self.axes.shape[:1]:
            raise ValueError(f"axes must be (K, F) and variance (K,), got {self.axes.shape}, {self.variance.shape}")
        check_array("axes", self.axes)
        if not (self.variance >= _MIN_VARIANCE).all():
            raise ValueError(f"variance must be at least {_MIN_VARIANCE}, got {self.variance}")
        for name in ("limit", "sharpness"):
            check_array(name, getattr(self, name), "positive")

    def distance(self, standardised: FloatArray) -> FloatArray:
        """Return the distance d of each window to the training windows, (...), from standardised features (..., F)."""
        z = np.minimum(np.maximum(standardised, -_FEATURE_LIMIT), _FEATURE_LIMIT)
        # One product per window, because products of a batch can differ in the last bits.
        along = z[..., None, :] @ self.axes.T
        narrow = np.add.reduce(z * z, axis=-1) / _MIN_VARIANCE
        wide = (along * along @ (1 / self.variance - 1 / _MIN_VARIANCE))[..., 0]
        return np.sqrt(np.maximum(narrow + wide, 0.0) / z.shape[-1])

    def unknown_share(self, standardised: FloatArray) -> FloatArray:
        """Return the unknown share of each window, 0 to 1, shape (...), from its F standardised features, (..., F).

        The unknown share says how much a window differs from all training windows. With d the distance of the window to
        the training windows (`distance`), it is zero for d <= limit and 1 - (limit / d)^sharpness beyond. For a
        sharpness of 2, it is three quarters at twice the limit.
        """
        return unknown_share(self.distance(standardised), self.limit, self.sharpness)


def unknown_share(distance: FloatArray, limit: float, sharpness: float) -> FloatArray:
    """Return the unknown share of windows at distances d (...) from the training windows.

    It is zero for d <= `limit` and 1 - (limit / d)^sharpness beyond.
    """
    return 1.0 - (limit / np.maximum(distance, limit)) ** sharpness


def fit_familiarity(standardised: FloatArray, limit: float, sharpness: float = 2.0) -> Familiarity:
    """Return the familiarity that is fitted to standardised features (N, F) of windows.

    The features are first cut to the range from -8 to 8. The principal axes and variances of the features are then
    computed about zero, not about the mean of these features. Zero is the mean of all training windows. A subset such
    as the windows on stairs has another mean, so its variance along the line through both means is larger. Windows
    between both means are therefore familiar, too. `limit` is the distance from which windows are partly unknown,
    chosen on held-out people. `sharpness` is the growth of the unknown share beyond it.
    """
    cut = np.clip(standardised, -_FEATURE_LIMIT, _FEATURE_LIMIT)
    variance, axes = np.linalg.eigh(cut.T @ cut / len(cut))
    wide = variance > _MIN_VARIANCE
    # float16 reduces the file to a third, and changes the distances by a thousandth.
    short = axes[:, wide].T.astype(np.float16)
    return Familiarity(short.astype(np.float64), variance[wide], limit, sharpness)
