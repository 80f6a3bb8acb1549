"""Classifiers of other libraries, such as scikit-learn, in a context model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.values import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ForeignClassifier(Machine):
    """Fitted classifier of another library, with `predict_proba` and `classes_`. ValueError for invalid probabilities.

    It classifies all rows at once, which is many times faster than one by one. Libraries may give a row other last bits
    in a batch than alone, so that offline results agree with online results only up to rounding.
    """

    estimator: Any
    features: int  # number F of features

    def __post_init__(self) -> None:
        prob = np.asarray(self.estimator.predict_proba(np.zeros((1, self.features))), dtype=np.float64)
        if prob.shape != (1, self.n_classes) or not (prob >= 0).all() or not np.isclose(prob.sum(), 1.0, atol=1e-6):
            raise ValueError(
                f"predict_proba of {self.kind} must return a probability for each of {self.n_classes} classes_, which "
                f"sum to one, got {prob} for one row: give a classifier that returns probabilities"
            )

    @property
    def kind(self) -> str:
        """Name of the class of the classifier."""
        return type(self.estimator).__name__

    @property
    def n_features(self) -> int:
        return self.features

    @property
    def n_classes(self) -> int:
        return len(self.estimator.classes_)

    def _predict(self, rows: FloatArray) -> FloatArray:
        if not len(rows):
            return np.empty((0, self.n_classes))
        return np.asarray(self.estimator.predict_proba(rows), dtype=np.float64)

    def to_arrays(self) -> Arrays:
        raise ValueError(
            f"a classifier of another library ({self.kind}) cannot be saved, because files hold arrays and no code: "
            "keep the model with joblib.dump(model, path), which executes code when it is loaded; or pass the "
            'classifier to pdr.fit_contexts again; or fit with classifier="rvm", "forest" or "blend"'
        )
