"""Relevance vector machine for several classes: sparse Bayesian classification with probabilities (Tipping 2001).

The model is that of section V-C of Martinelli et al. 2018 (eq. 4-9), trained by `pdr_filter.classifiers.rvm_training`.
The iteration as printed in that paper (eq. 10 and 11 of Martinelli et al. 2018) is `tests.oracles.rvm_reference`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist, pdist
from scipy.special import logsumexp
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits  # scikit-learn depends on it

from pdr_filter.classifiers.kernel_machine import KERNELS, RelevanceVectors
from pdr_filter.classifiers.rvm_training import Bernoulli, Posterior, Trained, train_rvm
from pdr_filter.values import FloatArray, IntArray, check_array

MULTI_CLASS = ("one_against_all", "multinomial")

# Kernel widths of the search with kernel_width="cv", relative to the median distance. The default is the median, which
# had the lowest mean log loss of all widths from 0.35 to 4 times the median over 22 problems.
WIDTH_GRID = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)

# Maximum number of candidates for the median distance. They have half a million distances.
_MAX_WIDTH_ROWS = 1000
# Number of candidates in the search for a width, which only needs the order of the log losses.
_MAX_SEARCH_SAMPLES = 300
# Maximum size of the matrix of basis functions, 0.4 GB. With more rows, fewer of them are candidates.
_MAX_ENTRIES = 50_000_000
# Passes of one class before the next class is trained (multinomial), and maximum number of rounds.
_PASSES_A_ROUND = 4
_MAX_ROUNDS = 10


@dataclass(frozen=True, slots=True)
class Budget:
    """Limits of the training of each class: numbers of basis functions and of passes, and the stopping criterion `tol`.

    They are described in `RelevanceVectorClassifier`.
    """

    max_basis: int
    max_iter: int
    tol: float


def basis_functions(X: FloatArray, vectors: FloatArray, kernel: str, width: float) -> FloatArray:
    """Return the basis functions at N rows, (1 + R, N), of Martinelli et al. (2018), eq. 5.

    The first one is one (bias). The others are the kernel K(x, v) of each row x with each of R vectors v.
    """
    functions = np.ones((len(vectors) + 1, len(X)))
    if kernel == "rbf":
        gram = cdist(vectors, X, "sqeuclidean")
        gram /= -2.0 * width**2
        np.exp(gram, out=functions[1:])
    else:
        functions[1:] = vectors @ X.T
    return functions


def median_distance(vectors: FloatArray) -> float:
    """Return the median Euclidean distance between pairs of different vectors (R, F), or 1 if there are none.

    Of more than `_MAX_WIDTH_ROWS` vectors, this number of evenly spaced ones is used.
    """
    spread = np.unique(np.linspace(0, len(vectors) - 1, min(len(vectors), _MAX_WIDTH_ROWS)).astype(np.int64))
    distances = pdist(vectors[spread])
    distances = distances[distances > 0]
    return float(np.median(distances)) if len(distances) else 1.0


def train_one_against_all(
    functions: FloatArray, label: IntArray, weight: FloatArray, n_classes: int, budget: Budget
) -> list[Trained]:
    """Train K binary relevance vector machines, each for its class against all others.

    For two classes, only the machine of class 1 is trained. The machine of class 0 is its copy with negated weights and
    logits. Each machine is a `Trained` on the basis functions (R, N), which are the bias and the candidates. `label`
    (N,) is 0 to K - 1, and `weight` (N,) is the weight of each row.
    """
    no_offset = np.zeros(len(label))
    machines: list[Trained] = []
    for k in [1] if n_classes == 2 else range(n_classes):
        likelihood = Bernoulli((label == k).astype(np.float64), weight, no_offset)
        machines.append(_train(functions, likelihood, None, budget.max_iter, budget))
    if n_classes != 2:
        return machines
    p = machines[0].posterior  # the other class has the negative logit with the same covariance
    return [replace(machines[0], posterior=replace(p, mean=-p.mean, logit=-p.logit)), machines[0]]


def train_multinomial(
    functions: FloatArray, label: IntArray, weight: FloatArray, n_classes: int, budget: Budget
) -> list[Trained]:
    """Train K >= 3 machines with competing logits t_k: class k has the probability p_k = exp(t_k) / sum_j exp(t_j).

    sigma is the logistic function. While all logits but t_k are fixed, ln p_k = ln sigma(t_k + o_k) with the offset o_k
    = -ln sum_{j != k} exp(t_j). All classes start from the one-against-all solution. They are trained in turn until a
    round raises the joint value by less than `tol` per class (`_joint_value`), or until a limit of rounds or passes is
    reached.
    """
    targets = [(label == k).astype(np.float64) for k in range(n_classes)]
    trained = train_one_against_all(functions, label, weight, n_classes, budget)
    n_iter = [t.n_passes for t in trained]
    logit = np.array([t.posterior.logit for t in trained])
    value, settled = _joint_value(logit, label, weight, trained), False
    for _ in range(_MAX_ROUNDS):
        if min(n_iter) >= budget.max_iter:
            break
        for k in range(n_classes):
            offset = -np.asarray(logsumexp(np.delete(logit, k, axis=0), axis=0))
            likelihood = Bernoulli(targets[k], weight, offset)
            allowed = min(_PASSES_A_ROUND, budget.max_iter - n_iter[k])
            if allowed > 0:
                trained[k] = _train(functions, likelihood, trained[k].posterior, allowed, budget)
                logit[k] = trained[k].posterior.logit
                n_iter[k] += trained[k].n_passes
        before, value = value, _joint_value(logit, label, weight, trained)
        settled = value - before < budget.tol * n_classes
        if settled:
            break
    return [
        replace(t, n_passes=n, out_of_passes=not settled or n >= budget.max_iter)
        for t, n in zip(trained, n_iter, strict=True)
    ]


def _joint_value(logit: FloatArray, label: IntArray, weight: FloatArray, trained: Sequence[Trained]) -> float:
    """Return the log-likelihood of the softmax plus the log Occam factors of all machines, in nats.

    The log Occam factor of a machine is ln p(w*) + ln |Delta| / 2, up to a constant. Here w* are the posterior means of
    its weights, p is their Gaussian prior with the precisions alpha, and Delta is their posterior covariance.
    """
    chosen = logit[label, np.arange(len(label))]
    value = float(weight @ (chosen - np.asarray(logsumexp(logit, axis=0))))
    for one in trained:
        p = one.posterior
        value -= 0.5 * float(np.sum(p.alpha * p.mean**2 - np.log(p.alpha)))
        value += float(np.sum(np.log(np.diag(p.cov_factor))))  # G is triangular
    return value


def _train(
    functions: FloatArray, likelihood: Bernoulli, start: Posterior | None, max_passes: int, budget: Budget
) -> Trained:
    return train_rvm(likelihood, functions, start, max_basis=budget.max_basis, max_passes=max_passes, tol=budget.tol)


def assemble(
    machines: Sequence[Trained], vectors: FloatArray, kernel: str, width: float, link: str, moderate: bool
) -> RelevanceVectors:
    """Return K trained machines as one kernel machine with shared arrays, without unused vectors.

    The machines were trained on the bias and `vectors` (R, F). If `moderate` is False, the covariance factors are zero,
    so that probabilities are not moderated. `link` is "sigmoid" or "softmax".
    """
    used = np.unique(np.concatenate([[0], *(machine.posterior.basis for machine in machines)]))  # with the bias
    size = max(len(machine.posterior.basis) for machine in machines)
    basis = np.zeros((len(machines), size), dtype=np.int64)
    weights = np.zeros((len(machines), size))
    cov_factor = np.zeros((len(machines), size, size))
    for k, machine in enumerate(machines):
        m = len(machine.posterior.basis)
        basis[k, :m] = np.searchsorted(used, machine.posterior.basis)
        weights[k, :m] = machine.posterior.mean
        if moderate:
            cov_factor[k, :m, :m] = machine.posterior.cov_factor
    return RelevanceVectors(kernel, width, vectors[used[1:] - 1], basis, weights, cov_factor, link)


def stratified_rows(labels: IntArray, n_rows: int, random: np.random.RandomState) -> IntArray:
    """Return ascending indices of about `n_rows` random rows, each class in proportion but at least once."""
    if n_rows >= len(labels):
        return np.arange(len(labels))
    chosen: list[IntArray] = []
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        n_chosen = max(1, round(n_rows * len(rows) / len(labels)))
        chosen.append(random.permutation(rows)[:n_chosen])
    return np.sort(np.concatenate(chosen))


class RelevanceVectorClassifier(ClassifierMixin, BaseEstimator):
    """Relevance vector machine: sparse kernel classifier with probabilities, for two or more classes.

    Scale the features first, for example to unit variance, because the kernel uses their Euclidean distances. The
    training time is bounded by the limits below. A ConvergenceWarning names the limits that were reached.

    Parameters
    ----------
    kernel : {"rbf", "linear"}, default "rbf"
        "rbf": one candidate basis function exp(-||x - x_i||^2 / (2 kernel_width^2)) for each training row (eq. 5 of
        Martinelli et al. 2018). "linear": one candidate for each feature, x_j divided by its root mean square, so that
        relevance selects features. (Inner products with the training rows would span the same functions with more
        candidates than dimensions.)
    kernel_width : float, "cv" or None, default None
        sigma_G of eq. 5 of Martinelli et al. 2018, in units of the features. None: the median distance between
        candidates. "cv": the width with the lowest cross-validated log loss, from 0.5 to 4 times the median distance,
        in the time of about 20 trainings. (The evidence would prefer narrower kernels than the log loss of new rows
        does.)
    multi_class : {"one_against_all", "multinomial"}, default "one_against_all"
        "one_against_all": one machine for each class against all others, with normalised sigmoids (the paper). It has
        the better probabilities on most synthetic problems.
        "multinomial": machines whose logits compete in a softmax, with 1.5 times the training time and fewer vectors.
        For two classes both are equal.
    class_weight : dict, "balanced" or None, default None
        Factor on the weight of the rows of each class. "balanced": all classes have the same total weight, and the rows
        have a total weight of N.
    max_samples : int or None, default 1000
        Approximate maximum number of candidates for relevance vectors, drawn from the rows in proportion to the
        classes. All rows always count in the likelihood. The training time is proportional to N max_samples max_basis.
        None: every row is a candidate, up to 50 million entries of the kernel matrix.
    max_basis : int, default 100
        Maximum number of basis functions of each class, including the bias.
    moderate : bool, default True
        Average the probabilities over the uncertainty of the logits (Bishop 2006, eq. 4.153). This lowers the log loss
        most for narrow kernels.
    max_iter : int, default 100
        Maximum number of passes (updates of the posterior) for each class.
    tol : float, default 1.0
        Training of a class stops when two consecutive passes each raise its log evidence by less than half of this, in
        nats.
    cv : int or splitter, default 3
        Folds for kernel_width="cv": a number (stratified, with whole `groups` if they are given) or a scikit-learn
        splitter.
    random_state : int, RandomState or None, default 0
        Source of randomness for drawing candidates from more than `max_samples` rows. Nothing else is random.

    Attributes
    ----------
    classes_ : ndarray, shape (K,)
        Sorted class labels: the columns of `predict_proba`.
    relevance_vectors_ : ndarray, shape (R, F)
        Relevance vectors of all machines.
    kernel_width_ : float
        Kernel width in use.
    cv_log_loss_ : dict
        Cross-validated log loss by kernel width. Empty unless kernel_width="cv".
    log_evidence_ : ndarray, shape (K,)
        Log evidence of each machine, in nats. It compares settings on the same data, not different data.
    n_iter_ : int
        Largest number of passes of a class.
    machine_ : RelevanceVectors
        Trained machines as plain arrays, for prediction and storage.
    n_features_in_ : int
        Number F of features.

    References
    ----------
    .. [1] Tipping, "Sparse Bayesian learning and the relevance vector machine", JMLR 1, 2001.
    .. [2] Martinelli et al. 2018, section V-C.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> rng = np.random.default_rng(0)
    >>> y = rng.integers(0, 2, 200)
    >>> X = rng.normal(size=(200, 2)) + 3.0 * y[:, None]
    >>> machine = pdr.RelevanceVectorClassifier().fit(X, y)
    >>> machine.predict_proba([[0.0, 0.0], [3.0, 3.0]]).argmax(axis=1)
    array([0, 1])
    >>> len(machine.relevance_vectors_) < 50  # of 200
    True
    """

    def __init__(
        self,
        *,
        kernel: str = "rbf",
        kernel_width: float | str | None = None,
        multi_class: str = "one_against_all",
        class_weight: dict[Any, float] | str | None = None,
        max_samples: int | None = 1000,
        max_basis: int = 100,
        moderate: bool = True,
        max_iter: int = 100,
        tol: float = 1.0,
        cv: Any = 3,
        random_state: int | np.random.RandomState | None = 0,
    ) -> None:
        self.kernel = kernel
        self.kernel_width = kernel_width
        self.multi_class = multi_class
        self.class_weight = class_weight
        self.max_samples = max_samples
        self.max_basis = max_basis
        self.moderate = moderate
        self.max_iter = max_iter
        self.tol = tol
        self.cv = cv
        self.random_state = random_state

    def fit(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None, groups: ArrayLike | None = None
    ) -> RelevanceVectorClassifier:
        """Train the classifier.

        Parameters
        ----------
        X : array_like, shape (N, F)
            Rows of features.
        y : array_like, shape (N,)
            Class label of each row.
        sample_weight : array_like, shape (N,), optional
            Weight of each row: a row of weight w counts like w rows. Rows of weight 0 are ignored.
        groups : array_like, shape (N,), optional
            Groups, such as people, that are not divided by the folds of kernel_width="cv".

        Returns
        -------
        RelevanceVectorClassifier
            The classifier itself.

        Raises
        ------
        ValueError
            If a setting or an array is invalid.

        Warns
        -----
        ConvergenceWarning
            If a limit of the training was reached.
        """
        self._check_settings()
        rows, labels, weight, group = self._checked(X, y, sample_weight, groups)
        self.classes_, label = np.unique(labels, return_inverse=True)
        if len(self.classes_) < 2:
            raise ValueError(
                "y must have at least two classes, got one class in rows of positive weight, "
                f"{self.classes_[0]!r}: give rows of another class"
            )
        weight = weight * self._class_factors(label, weight)[label]
        self.cv_log_loss_: dict[float, float] = {}
        # One thread, because BLAS threads wait for each other on a busy computer: training took eight times as long.
        with threadpool_limits(limits=1, user_api="blas"):
            candidates, messages = self._candidates(rows, label, weight)
            self.kernel_width_ = self._width(rows, label, weight, group, candidates)
            machines, self.machine_ = self._fitted(rows, label, weight, candidates, self.kernel_width_)
        messages += self._budget_messages(machines)
        if messages:
            warnings.warn("; ".join(messages), ConvergenceWarning, stacklevel=2)
        self.n_iter_ = max(machine.n_passes for machine in machines)
        self.log_evidence_ = np.array([machine.posterior.log_evidence for machine in machines])
        self.relevance_vectors_ = self.machine_.vectors
        return self

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Return the class probabilities of rows.

        Parameters
        ----------
        X : array_like, shape (N, F)
            Rows of features.

        Returns
        -------
        ndarray, shape (N, K)
            Probabilities in the order of `classes_`. Each row sums to one.
        """
        check_is_fitted(self)
        rows: Any = validate_data(self, cast(Any, X), dtype=np.float64, reset=False)
        return self.machine_.predict_proba(rows)

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return the most probable class of each row.

        Parameters
        ----------
        X : array_like, shape (N, F)
            Rows of features.

        Returns
        -------
        ndarray, shape (N,)
            Class labels.
        """
        best = self.predict_proba(X).argmax(axis=1)
        return self.classes_[best]

    def _check_settings(self) -> None:
        """Raise ValueError that names an invalid setting."""
        if self.kernel not in KERNELS:
            raise ValueError(f"kernel must be one of {KERNELS}, got {self.kernel!r}")
        if self.multi_class not in MULTI_CLASS:
            raise ValueError(f"multi_class must be one of {MULTI_CLASS}, got {self.multi_class!r}")
        width = self.kernel_width
        if isinstance(width, str) and width != "cv":
            raise ValueError(f'kernel_width must be a number, "cv" or None, got {width!r}')
        if width is not None and not isinstance(width, str):
            check_array("kernel_width", width, "positive", remedy="give it in units of the features")
        if self.max_samples is not None and self.max_samples < 1:
            raise ValueError(f"max_samples must be at least 1 or None, got {self.max_samples}")
        for name in ("max_basis", "max_iter"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        check_array("tol", self.tol, "positive", remedy="give it in nats")

    def _checked(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None, groups: ArrayLike | None
    ) -> tuple[FloatArray, NDArray[Any], FloatArray, NDArray[Any] | None]:
        """Return rows, labels, weights and groups as arrays of equal length, without rows of weight zero."""
        checked: Any = validate_data(self, cast(Any, X), cast(Any, y), dtype=np.float64)
        rows: FloatArray = checked[0]
        labels: NDArray[Any] = checked[1]
        check_classification_targets(labels)
        weight = np.ones(len(rows)) if sample_weight is None else np.asarray(sample_weight, dtype=np.float64)
        if weight.ndim == 0:
            weight = np.full(len(rows), float(weight))
        check_array("sample_weight", weight, "0 or more", (len(rows),), "give one for each row")
        if not weight.any():
            raise ValueError("sample_weight must be positive for at least one row, got only zeros")
        group = None if groups is None else np.asarray(groups)
        if group is not None and group.shape != (len(rows),):
            raise ValueError(f"groups must be ({len(rows)},), one for each row, got {group.shape}")
        counts = weight > 0
        return rows[counts], labels[counts], weight[counts], None if group is None else group[counts]

    def _class_factors(self, label: IntArray, weight: FloatArray) -> FloatArray:
        """Return the weight factor of each class, (K,), from `class_weight`. It is 1 for a class that is not in a dict.

        ValueError for other settings or factors that are not positive.
        """
        if self.class_weight is None:
            return np.ones(len(self.classes_))
        if not isinstance(self.class_weight, dict):
            if self.class_weight != "balanced":
                raise ValueError(f'class_weight must be a dict, "balanced" or None, got {self.class_weight!r}')
            return weight.sum() / (len(self.classes_) * np.bincount(label, weights=weight))
        factors = np.array([float(self.class_weight.get(c, 1.0)) for c in self.classes_.tolist()])
        check_array("class_weight", factors, "positive")
        return factors

    def _candidates(self, rows: FloatArray, label: IntArray, weight: FloatArray) -> tuple[FloatArray, list[str]]:
        """Return the unique, sorted candidates for relevance vectors (R, F), and a list of messages.

        There is one message if not all rows are candidates. For the linear kernel, the candidates are one vector for
        each feature, which divides the feature by its root mean square.
        """
        if self.kernel == "linear":
            size = np.sqrt(weight @ rows**2 / weight.sum())
            return np.diag(1.0 / np.where(size > 0, size, 1.0)), []
        room = max(1, _MAX_ENTRIES // len(rows))
        n_rows = min(len(rows), room, len(rows) if self.max_samples is None else self.max_samples)
        chosen = stratified_rows(label, n_rows, check_random_state(self.random_state))
        messages: list[str] = []
        if len(chosen) < len(rows):
            limit = "max_samples" if self.max_samples is not None and self.max_samples <= room else "memory"
            messages.append(f"only {len(chosen)} of {len(rows)} rows are candidates for relevance vectors ({limit})")
        return np.unique(rows[chosen], axis=0), messages

    def _fitted(
        self, rows: FloatArray, label: IntArray, weight: FloatArray, candidates: FloatArray, width: float
    ) -> tuple[list[Trained], RelevanceVectors]:
        """Return the trained machines, one for each class, and the kernel machine made of them for prediction."""
        functions = basis_functions(rows, candidates, self.kernel, width)
        budget = Budget(self.max_basis, self.max_iter, self.tol)
        n_classes = int(label.max()) + 1
        multinomial = self.multi_class == "multinomial" and n_classes > 2  # for two classes one logit is redundant
        trainer = train_multinomial if multinomial else train_one_against_all
        machines = trainer(functions, label, weight, n_classes, budget)
        link = "softmax" if multinomial else "sigmoid"
        return machines, assemble(machines, candidates, self.kernel, width, link, self.moderate)

    def _budget_messages(self, machines: Sequence[Trained]) -> list[str]:
        """Return messages about the limits that training reached."""
        passes = [c for c, m in zip(self.classes_.tolist(), machines, strict=True) if m.out_of_passes]
        basis = [c for c, m in zip(self.classes_.tolist(), machines, strict=True) if m.out_of_basis]
        messages: list[str] = []
        if passes:
            messages.append(
                f"training stopped before convergence for classes {passes}: raise max_iter={self.max_iter} or tol"
            )
        if basis:
            messages.append(f"classes {basis} reached the limit of basis functions: raise max_basis={self.max_basis}")
        return messages

    def _width(
        self, rows: FloatArray, label: IntArray, weight: FloatArray, group: NDArray[Any] | None, candidates: FloatArray
    ) -> float:
        """Return the kernel width: given, the median distance, or chosen by cross-validation. 1 for the linear kernel.

        Cross-validation also fills `cv_log_loss_`.
        """
        if self.kernel == "linear":
            return 1.0
        if isinstance(self.kernel_width, int | float | np.number):
            return float(self.kernel_width)
        median = median_distance(candidates)
        if self.kernel_width is None:
            return median
        folds = self._folds(rows, label, group)
        for share in WIDTH_GRID:
            self.cv_log_loss_[share * median] = self._log_loss(rows, label, weight, folds, share * median)
        return min(self.cv_log_loss_, key=lambda width: self.cv_log_loss_[width])

    def _folds(self, rows: FloatArray, label: IntArray, group: NDArray[Any] | None) -> list[tuple[IntArray, IntArray]]:
        """Return the indices of the rows for training and for scoring of each fold.

        Folds that train on a single class are left out. ValueError if no fold remains.
        """
        splitter: Any = self.cv
        if isinstance(splitter, int):
            if group is None:
                splitter = StratifiedKFold(splitter, shuffle=True, random_state=0)
            else:
                splitter = StratifiedGroupKFold(splitter)
        with warnings.catch_warnings():
            # Classes with fewer rows than folds are not scored.
            warnings.filterwarnings("ignore", message="The least populated class")
            folds = list(splitter.split(rows, label, group)) if hasattr(splitter, "split") else list(splitter)
        folds = [(fit, score) for fit, score in folds if len(np.unique(label[fit])) > 1]
        if not folds:
            raise ValueError(
                f"cv={self.cv!r} gives no fold that trains on two classes: give kernel_width, or more folds or groups"
            )
        return folds

    def _log_loss(
        self,
        rows: FloatArray,
        label: IntArray,
        weight: FloatArray,
        folds: Sequence[tuple[IntArray, IntArray]],
        width: float,
    ) -> float:
        """Return the weighted mean log loss of held-out rows, in nats.

        Only rows whose class is in the training rows of their fold count. The result is inf if there are none.
        """
        loss, total = 0.0, 0.0
        for fit, score in folds:
            seen, fit_label = np.unique(label[fit], return_inverse=True)
            n_candidates = min(_MAX_SEARCH_SAMPLES, self.max_samples or _MAX_SEARCH_SAMPLES)
            chosen = stratified_rows(fit_label, n_candidates, np.random.RandomState(0))
            candidates = np.unique(rows[fit][chosen], axis=0)
            machine = self._fitted(rows[fit], fit_label, weight[fit], candidates, width)[1]
            score = score[np.isin(label[score], seen)]
            prob = machine.predict_proba(rows[score])
            chosen_prob = prob[np.arange(len(score)), np.searchsorted(seen, label[score])]
            loss -= float(weight[score] @ np.log(np.maximum(chosen_prob, 1e-15)))
            total += float(weight[score].sum())
        return loss / total if total else np.inf
