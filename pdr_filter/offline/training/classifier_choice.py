"""Classifiers of context models: each function fits one, and returns it with its classes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.ensemble import ExtraTreesClassifier, HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.utils.validation import has_fit_parameter

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.blend import Blend, Mixture
from pdr_filter.classifiers.boosting import BoostedTrees
from pdr_filter.classifiers.foreign_classifier import ForeignClassifier
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.probability_calibration import slipped_prob
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier, stratified_rows
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.offline.training.cross_validation import MachineFit, TextArray
from pdr_filter.values import FloatArray

Classes = tuple[str, ...]


def fit_softmax(Z: FloatArray, y: TextArray, weight: FloatArray, C: float = 0.02) -> tuple[SoftmaxRegression, Classes]:
    """Return a multinomial logistic regression and its classes.

    C is the inverse strength of the penalty on the weights. Values of 0.1 to 0.005 have the same log loss within 0.02
    on held-out people. With smaller values, the probabilities become less certain than the temperature can correct.
    """
    fitted: Any = LogisticRegression(C=C, max_iter=300, tol=1e-3).fit(Z, y, sample_weight=weight)
    weights, intercept = fitted.coef_, fitted.intercept_
    if len(weights) == 1:  # scikit-learn stores a single logit for two classes, that of the second class
        weights, intercept = (np.concatenate([-0.5 * each, 0.5 * each]) for each in (weights, intercept))
    return SoftmaxRegression(weights, intercept), _names(fitted.classes_)


def fit_boosted(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, Classes]:
    """Return the mean of logistic regression and boosted trees, and its classes.

    Each split sees a fifth of the features, and a leaf has at least 50 windows. This makes the trees more diverse and
    keeps them from learning one person's habits (log loss 0.149 -> 0.147 on held-out people, and 0.35 -> 0.34 in the
    pockets of ubicomp13).
    """
    linear, classes = fit_softmax(Z, y, weight)
    options: Any = {"max_iter": 100, "max_leaf_nodes": 15, "max_features": 0.2, "min_samples_leaf": 50}
    boosting = HistGradientBoostingClassifier(**options, early_stopping=cast(Any, False), random_state=0)
    boosting.fit(in_float32(Z), y, sample_weight=weight)
    return Blend((linear, BoostedTrees.from_sklearn(boosting))), classes


def fit_relevance_vectors(
    Z: FloatArray,
    y: TextArray,
    weight: FloatArray,
    kernel: str = "rbf",
    kernel_width: float | None = None,
    window_weight: float = 0.1,
    max_rows: int = 20_000,
    max_samples: int = 1000,
) -> tuple[Machine, Classes]:
    """Return a relevance vector machine (one against all) and its classes, fitted on at most `max_rows` rows.

    The rows are drawn by class. A window counts as `window_weight` of an independent example, because windows overlap
    and the steps of one person are similar. With full weight, the macro recall on held-out people is 0.935 instead of
    0.95. The default `kernel_width` is one and a half times the distance of two typical windows, which is the square
    root of twice the number of features.
    """
    rows = np.arange(len(y))
    if len(y) > max_rows:
        label = np.unique(y, return_inverse=True)[1].astype(np.int64)
        rows = stratified_rows(label, max_rows, np.random.RandomState(0))
    classifier = RelevanceVectorClassifier(
        kernel=kernel,
        kernel_width=1.5 * np.sqrt(2.0 * Z.shape[1]) if kernel_width is None else kernel_width,
        max_samples=max_samples,
        max_basis=200,
        random_state=0,
    )
    with warnings.catch_warnings():
        # the warning is about the limited number of candidates, which is intended here
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier.fit(Z[rows], y[rows], sample_weight=window_weight * weight[rows])
    return classifier.machine_, _names(classifier.classes_)


def fit_forest(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, Classes]:
    """Return a random forest of 50 trees and its classes."""
    # Leaves have at least 20 windows. Smaller leaves memorise people and increase the log loss (0.35 -> 0.38 with 5).
    options: Any = {"min_samples_leaf": 20, "random_state": 0, "n_jobs": 1}
    forest = RandomForestClassifier(50, **options).fit(Z, y, sample_weight=weight)
    return Forest.from_sklearn(forest), _names(forest.classes_)


def fit_extra_trees(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Forest, Classes]:
    """Return a forest of extremely randomised trees and its classes (Geurts, Ernst and Wehenkel 2006).

    Their thresholds are drawn at random. The trees are more diverse than those of a random forest, and smooth the
    probabilities between the training windows. A hundredth of the probability in each leaf is divided among all
    classes, because 80 trees cannot exclude a class.
    """
    options: Any = {"min_samples_leaf": 3, "max_features": 0.3, "max_leaf_nodes": 500, "random_state": 0, "n_jobs": 1}
    forest: Any = ExtraTreesClassifier(80, **options).fit(in_float32(Z), y, sample_weight=weight)
    exact = Forest.from_sklearn(forest)
    return Forest(exact.trees, slipped_prob(exact.probability, 0.01)), _names(forest.classes_)


def fit_local_relevance_vectors(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, Classes]:
    """Return the relevance vector machine with the narrow RBF kernel of the shipped blends, and its classes."""
    width = 0.8 * np.sqrt(2.0 * Z.shape[1])
    return fit_relevance_vectors(Z, y, weight, kernel_width=width, window_weight=0.5, max_rows=12_000, max_samples=2000)


def fit_blend(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, Classes]:
    """Return the mean probabilities of relevance vector machines and extremely randomised trees, and the classes.

    The first part is the mean of the logits of two relevance vector machines. The one with RBF kernel is local, and the
    linear one selects features and extrapolates. On held-out people, the mean of the probabilities of both parts has a
    log loss of 0.110, and the mean of their logits 0.112.
    """
    local, classes = fit_local_relevance_vectors(Z, y, weight)
    linear, _ = fit_relevance_vectors(Z, y, weight, kernel="linear", window_weight=0.1, max_rows=len(y))
    trees, _ = fit_extra_trees(Z, y, weight)
    return Mixture((Blend((local, linear)), trees)), classes


@dataclass(frozen=True)
class FitOfObject:
    """Fit of a classifier object with `fit`, `predict_proba` and `classes_`, such as a scikit-learn classifier.

    Each fit uses an untrained copy of the object. Weights are passed to objects that accept them. Forests of
    scikit-learn become a `Forest`, which has the same probabilities, is faster, and can be saved.
    """

    classifier: Any

    def __call__(self, Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Machine, Classes]:
        """Return the fitted classifier as a machine of a context model, and its classes.

        Raise ValueError if the fitted object cannot be used.
        """
        fitted: Any = clone(self.classifier, safe=False)
        fitted.fit(Z, y, **({"sample_weight": weight} if has_fit_parameter(fitted, "sample_weight") else {}))
        if not hasattr(fitted, "classes_"):
            raise ValueError(
                f"classifier must have classes_ after fit, but {type(fitted).__name__} has none: set it in fit"
            )
        machine, classes = getattr(fitted, "machine_", None), _names(fitted.classes_)
        if isinstance(fitted, RandomForestClassifier | ExtraTreesClassifier):
            machine = Forest.from_sklearn(fitted)
        elif not isinstance(machine, Machine):  # only that of `RelevanceVectorClassifier` is one
            machine = ForeignClassifier(fitted, Z.shape[1])
        return machine, classes


# Names of the classifiers in `fit_contexts` and `pdr-filter train`.
MACHINE_FITS: dict[str, MachineFit] = {
    "rvm": fit_relevance_vectors,
    "forest": fit_forest,
    "blend": fit_blend,
    "boosted": fit_boosted,
}
_KINDS = {
    "rvm": "Relevance vector machine",
    "forest": "Random forest",
    "blend": "Relevance vector machines, extremely randomised trees",
    "boosted": "Logistic regression, boosted trees",
}


def machine_fit_of(classifier: object) -> tuple[MachineFit, str]:
    """Return the function that fits a classifier, and the description of the classifier.

    Raises ValueError if the argument is neither a known name nor a classifier object.
    """
    if isinstance(classifier, str) and classifier in MACHINE_FITS:
        return MACHINE_FITS[classifier], _KINDS[classifier]
    is_object = not isinstance(classifier, str | type)
    if is_object and all(callable(getattr(classifier, name, None)) for name in ("fit", "predict_proba")):
        return FitOfObject(classifier), type(classifier).__name__
    raise ValueError(
        f"classifier must be one of {tuple(MACHINE_FITS)} or an object with fit, predict_proba and classes_, got "
        f"{classifier!r}: such as sklearn.ensemble.RandomForestClassifier()"
    )


def in_float32(values: FloatArray) -> FloatArray:
    """Return values rounded to float32.

    The stored trees compare float32 numbers. Trained on such numbers, they decide exactly as the trees of scikit-learn.
    """
    return values.astype(np.float32).astype(np.float64)


def _names(classes: NDArray[Any]) -> Classes:
    """Return the classes as a tuple of strings."""
    return tuple(str(c) for c in classes)
