"""Distance of a window to the training data of a model, against confident classification of unfamiliar motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdr_filter.classifiers.base_classifier import Stored
from pdr_filter.values import BoolArray, FloatArray, check_array, read_only

# Standardised features are cut at this value, so that a single broken feature cannot make the distance infinite.
_FEATURE_LIMIT = 8.0
# Minimum variance along a direction of standardised features. Directions of smaller variance are differences of nearly
# equal features, in which every new person would be far from the training data.
_MIN_VARIANCE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Familiarity(Stored):
    """Mahalanobis distance of a window to the training windows, and the unknown share that follows from it.

    d^2 = min_c 1/F sum_k y_ck^2 / max(v_ck, 0.05), with the F features of a window less the centre of group c of the
    training windows, projected on the principal axes of the group, y_ck, and the variances v_ck along them. Windows
    like the training windows have squared distances of about one.
    """

    axes: FloatArray  # (C, K, F) or (K, F) principal axes of the standardised features with a variance above 0.05
    variance: FloatArray  # (C, K) or (K,) variances along the axes
    limit: float  # distance exceeded by one to two percent of the windows of held-out people
    sharpness: float = 2.0  # growth of the unknown share beyond the limit
    centre: FloatArray | float = 0.0  # (C, F) centres of the groups
    usual: float = np.inf  # distance exceeded by a tenth of the windows of held-out people, infinite if not stored

    def __post_init__(self) -> None:
        self._make_read_only("axes", "variance")
        if self.axes.ndim not in (2, 3) or self.variance.shape != self.axes.shape[:-1]:
            raise ValueError(
                f"axes must be (C, K, F) and variance (C, K), got {self.axes.shape}, {self.variance.shape}"
            )
        check_array("axes", self.axes)
        if not (self.variance >= _MIN_VARIANCE).all():
            raise ValueError(f"variance must be at least {_MIN_VARIANCE}, got {self.variance}")
        for name in ("limit", "sharpness"):
            check_array(name, getattr(self, name), "positive")
        if not self.usual > 0:
            raise ValueError(f"usual must be a positive distance, got {self.usual}: leave it out if it is unknown")
        centre = np.zeros((*self.axes.shape[:-2], self.n_features)) + self.centre
        check_array("centre", centre, shape=(*self.axes.shape[:-2], self.n_features))
        object.__setattr__(self, "centre", read_only(centre))

    @property
    def n_features(self) -> int:
        """Number F of features."""
        return self.axes.shape[-1]

    def distance(self, standardised: FloatArray) -> FloatArray:
        """Return the distance d of each window to the training windows, (...), from standardised features (..., F)."""
        z = np.minimum(np.maximum(standardised, -_FEATURE_LIMIT), _FEATURE_LIMIT)
        centres, n_axes = np.reshape(self.centre, (-1, self.n_features)), self.axes.shape[-2]
        axes = self.axes.reshape(len(centres), n_axes, self.n_features)
        variance = self.variance.reshape(len(centres), n_axes)
        groups = zip(centres, axes, variance, strict=True)
        return np.minimum.reduce([_distance(z - centre, of_group, along) for centre, of_group, along in groups])

    def is_unlike(self, distance: FloatArray) -> BoolArray:
        """True for windows whose distances (...) exceed `usual` or `limit`.

        It holds for few windows of people like those of the training, so that it tells more of a whole recording than
        of one window.
        """
        return distance > min(self.usual, self.limit)

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


def _distance(y: FloatArray, axes: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the distances (...) of features (..., F) from the centre of a group with principal axes (K, F)."""
    # One product per window, because products of a batch can differ in the last bits.
    along = y[..., None, :] @ axes.T
    narrow = np.add.reduce(y * y, axis=-1) / _MIN_VARIANCE
    wide = (along * along @ (1 / variance - 1 / _MIN_VARIANCE))[..., 0]
    return np.sqrt(np.maximum(narrow + wide, 0.0) / y.shape[-1])


def fit_familiarity(
    standardised: FloatArray,
    limit: float,
    label: NDArray[np.str_] | None = None,
    usual: float = np.inf,
) -> Familiarity:
    """Return the familiarity that is fitted to standardised features (N, F) of windows.

    The features are first cut to the range from -8 to 8. With `label` (N,) each class is a group about its mean. A
    window between the classes, such as soft walking between standing and usual walking, is then unfamiliar.

    Without `label` all windows are one group. Its principal axes and variances are computed about zero, not about the
    mean of these features. Zero is the mean of all training windows. A subset such as the windows on stairs has another
    mean, so its variance along the line through both means is larger. Windows between both means are therefore
    familiar, too.

    `limit` is the distance from which windows are partly unknown, and `usual` the smaller one beyond which a tenth of
    the windows lie. Both are chosen on held-out people.
    """
    cut = np.clip(standardised, -_FEATURE_LIMIT, _FEATURE_LIMIT)
    if label is None:
        return Familiarity(*_principal_axes(cut), limit, usual=usual)
    groups = [cut[label == c] for c in np.unique(label)]
    centre = np.array([group.mean(axis=0) for group in groups])
    found = [_principal_axes(group - mean) for group, mean in zip(groups, centre, strict=True)]
    # An axis of zeros with the smallest variance has no effect.
    axes = np.zeros((len(found), max(len(v) for _, v in found), cut.shape[1]))
    variance = np.full(axes.shape[:2], _MIN_VARIANCE)
    for c, (of_class, along) in enumerate(found):
        axes[c, : len(along)], variance[c, : len(along)] = of_class, along
    return Familiarity(axes, variance, limit, centre=centre, usual=usual)


def _principal_axes(centred: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the principal axes (K, F) of centred features (N, F) with a variance above the smallest, and variances."""
    variance, axes = np.linalg.eigh(centred.T @ centred / len(centred))
    wide = variance > _MIN_VARIANCE
    # float16 reduces the file to a third, and changes the distances by a thousandth.
    return axes[:, wide].T.astype(np.float16).astype(np.float64), variance[wide]
