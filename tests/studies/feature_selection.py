"""Which features to use: sequential forward floating selection with cross-validation by groups.

P. Pudil, J. Novovicova, J. Kittler, "Floating search methods in feature selection", Pattern Recognition Letters 15
(1994) 1119-1125. Plain forward selection can never drop a feature that later ones made useless; the floating search
looks back after every addition.

Only training uses this module; the online path never imports it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import clone
from sklearn.metrics import check_scoring
from sklearn.model_selection import GroupKFold, StratifiedKFold
from sklearn.utils.parallel import Parallel, delayed

from pdr_filter.values import FloatArray

Progress = Callable[[str, float], None]
Scoring = str | Callable[[Any, Any, Any], float]
Columns = frozenset[int]
Fold = tuple[NDArray[np.intp], NDArray[np.intp]]  # training rows, test rows


@dataclass(frozen=True, slots=True)
class Subset:
    """Features of one choice, and how good they are."""

    columns: tuple[int, ...]  # ascending
    names: tuple[str, ...]  # in the order of `columns`
    score: float  # mean over the folds, higher is better
    score_std: float  # over the folds, population


@dataclass(frozen=True, slots=True)
class Change:
    """One move of the search."""

    action: Literal["add", "remove"]
    name: str  # of the feature added or removed
    n_features: int  # after the move
    score: float  # after the move


@dataclass(frozen=True, slots=True)
class Selection:
    """Result of the search.

    The folds that gave the scores also chose the subsets, so that the best score is a little too good: a score to
    report needs people whom the search has not seen.

    Parameters
    ----------
    best : Subset
        The highest score of the curve; of equal scores the one with fewer features.
    curve : tuple of Subset
        Best subset found with 1, 2, ... features: the accuracy against the number of features.
    history : tuple of Change
        All moves in order.
    n_evaluated : int
        Subsets that were scored, each once.
    """

    best: Subset
    curve: tuple[Subset, ...]
    history: tuple[Change, ...]
    n_evaluated: int


def select_features(
    estimator: Any,
    X: ArrayLike,
    y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    cv: Any = 10,
    scoring: Scoring = "accuracy",
    max_features: int | None = None,
    names: Sequence[str] | None = None,
    n_jobs: int | None = 1,
    progress: Progress | None = None,
) -> Selection:
    """Best subset of each size, found by sequential forward floating selection.

    After each addition features are removed for as long as the smaller subset is better than every subset of its size
    so far. Each removal raises the best score of a size, so the search ends. Of equally good features the one with the
    lowest column is taken; the folds are drawn once for all subsets: the result depends on the arguments alone.

    Parameters
    ----------
    estimator : scikit-learn estimator
        Cloned for every fit. Give it its own random_state, and its own scaling (a pipeline).
    X : (N, F)
        Features.
    y : (N,)
        What to predict.
    groups : (N,), optional
        Rows of one group (one person) are never split between training and test.
    cv : int or splitter
        Number of folds, or an object with `split(X, y, groups)`. A number means GroupKFold with groups and shuffled
        StratifiedKFold (seed 0) without.
    scoring : str or callable
        Name of a scorer, or `scorer(estimator, X, y) -> float`; higher is better.
    max_features : int, optional
        Size at which the search ends; all features if not given.
    names : F strings, optional
        Of the columns; x0, x1, ... if not given.
    n_jobs : int, optional
        Subsets scored at the same time, as joblib counts; it changes no number.
    progress : callable, optional
        Called after each move with what was done and the fraction of the sizes reached, 0 to 1.
    """
    features, target = np.asarray(X), np.asarray(y)
    n_columns = features.shape[1]
    names = tuple(f"x{i}" for i in range(n_columns)) if names is None else tuple(names)
    last_size = n_columns if max_features is None else max_features
    if len(names) != n_columns:
        raise ValueError(f"{len(names)} names for {n_columns} columns: give one name for each")
    if not 1 <= last_size <= n_columns:
        raise ValueError(f"max_features must be from 1 to {n_columns}, the number of columns, got {max_features}")
    folds = _folds(features, target, groups, cv)
    scores = _Scores(estimator, features, target, folds, check_scoring(estimator, scoring), n_jobs)
    return _Search(scores, names, last_size, progress).run()


def _folds(X: Any, y: Any, groups: ArrayLike | None, cv: Any) -> list[Fold]:
    """Training and test rows of each fold; no group is in both."""
    if isinstance(cv, int):
        cv = StratifiedKFold(cv, shuffle=True, random_state=0) if groups is None else GroupKFold(cv)
    group = None if groups is None else np.asarray(groups)
    folds = [(np.asarray(train), np.asarray(test)) for train, test in cv.split(X, y, group)]
    if group is not None:
        for train, test in folds:
            split = np.intersect1d(group[train], group[test])
            if len(split):
                raise ValueError(
                    f"the folds of {cv} split {len(split)} groups between training and test ({split[0]} is one): "
                    "use a splitter that respects groups, such as GroupKFold"
                )
    return folds


def _fold_scores(
    estimator: Any, X: Any, y: Any, folds: Sequence[Fold], scorer: Any, columns: Sequence[int]
) -> FloatArray:
    """Score of one subset on each fold, shape (K,)."""
    of_subset = np.ascontiguousarray(X[:, columns])
    scores = np.empty(len(folds))
    for i, (train, test) in enumerate(folds):
        fresh: Any = clone(estimator)
        scores[i] = scorer(fresh.fit(of_subset[train], y[train]), of_subset[test], y[test])
    if not np.isfinite(scores).all():
        raise ValueError(f"the score of columns {list(columns)} is not finite: {scores}")
    return scores


class _Scores:
    """Scores of subsets over the folds; no subset is scored twice."""

    def __init__(self, estimator: Any, X: Any, y: Any, folds: Sequence[Fold], scorer: Any, n_jobs: int | None) -> None:
        self._arguments = (estimator, X, y, folds, scorer)
        self._n_jobs = n_jobs
        self._known: dict[Columns, FloatArray] = {}
        self.n_columns: int = X.shape[1]

    def __len__(self) -> int:
        return len(self._known)

    def best(self, candidates: Sequence[Columns]) -> Columns:
        """The first of the candidates with the highest score."""
        new = [c for c in dict.fromkeys(candidates) if c not in self._known]
        score = delayed(_fold_scores)
        found: Any = Parallel(n_jobs=self._n_jobs)(score(*self._arguments, sorted(c)) for c in new)
        self._known.update(zip(new, found, strict=True))
        return max(candidates, key=self.score)

    def score(self, columns: Columns) -> float:
        """Mean over the folds of a subset that was a candidate.

        To 12 digits: the same fold scores in another order are no improvement.
        """
        return round(float(self._known[columns].mean()), 12)

    def score_std(self, columns: Columns) -> float:
        """Standard deviation over the folds."""
        return float(self._known[columns].std())


class _Search:
    """The floating search; X_k is the current subset, J its score (letters of Pudil et al. 1994, section 2.2)."""

    def __init__(self, scores: _Scores, names: tuple[str, ...], last_size: int, progress: Progress | None) -> None:
        self._scores, self._names, self._last_size, self._progress = scores, names, last_size, progress
        self._best: dict[int, Columns] = {}  # of each size
        self._history: list[Change] = []

    def run(self) -> Selection:
        """Inclusion, conditional exclusion and its continuation, until the last size stands."""
        X_k: Columns = frozenset()
        while len(X_k) < self._last_size:
            rest = [c for c in range(self._scores.n_columns) if c not in X_k]
            X_k = self._move("add", X_k, self._scores.best([X_k | {c} for c in rest]))
            # Below three features there is nothing to gain: all single features were compared at the start.
            while len(X_k) > 2:
                smaller = self._scores.best([X_k - {c} for c in sorted(X_k)])
                if not self._is_better(smaller):
                    break
                X_k = self._move("remove", X_k, smaller)
        curve = tuple(self._subset(self._best[k]) for k in range(1, self._last_size + 1))
        return Selection(max(curve, key=lambda s: s.score), curve, tuple(self._history), len(self._scores))

    def _is_better(self, columns: Columns) -> bool:
        """Better than every subset of its size so far."""
        known = self._best.get(len(columns))
        return known is None or self._scores.score(columns) > self._scores.score(known)

    def _move(self, action: Literal["add", "remove"], before: Columns, after: Columns) -> Columns:
        if self._is_better(after):
            self._best[len(after)] = after
        (changed,) = before ^ after
        change = Change(action, self._names[changed], len(after), self._scores.score(after))
        self._history.append(change)
        if self._progress is not None:
            what = f"{action} {change.name}: {change.n_features} features, score {change.score:.4f}"
            self._progress(what, max(self._best) / self._last_size)
        return after

    def _subset(self, columns: Columns) -> Subset:
        ordered = tuple(sorted(columns))
        names = tuple(self._names[c] for c in ordered)
        return Subset(ordered, names, self._scores.score(columns), self._scores.score_std(columns))
