from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joblib import parallel_config
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.dummy import DummyClassifier
from sklearn.feature_selection import SequentialFeatureSelector
from sklearn.model_selection import GroupKFold, KFold, LeaveOneGroupOut, StratifiedKFold, cross_val_score
from sklearn.tree import DecisionTreeClassifier

from tests.studies.feature_selection import Selection, select_features

Table = Mapping[frozenset[int], float]


def numbered(n_columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Data whose column j holds j, so that a scorer sees which columns it was given."""
    return np.tile(np.arange(float(n_columns)), (8, 1)), np.array([0, 1] * 4)


def looking_up(table: Table, asked: Counter[frozenset[int]] | None = None) -> Callable[[Any, Any, Any], float]:
    def score(_estimator: Any, x: np.ndarray, _y: Any) -> float:
        columns = frozenset(x[0].astype(int).tolist())
        if asked is not None:
            asked[columns] += 1
        return table[columns]

    return score


def select_by(table: Table, n_columns: int, **options: Any) -> Selection:
    return select_features(DummyClassifier(), *numbered(n_columns), cv=2, scoring=looking_up(table), **options)


def subsets_of(n_columns: int, size: int) -> list[frozenset[int]]:
    return [frozenset(c) for c in combinations(range(n_columns), size)]


def random_table(n_columns: int, seed: int) -> dict[frozenset[int], float]:
    rng = np.random.default_rng(seed)
    return {c: float(rng.uniform()) for k in range(1, n_columns + 1) for c in subsets_of(n_columns, k)}


def forward_scores(table: Table, n_columns: int) -> list[float]:
    """Plain forward selection: best score of each size on its way."""
    chosen: frozenset[int] = frozenset()
    scores = []
    while len(chosen) < n_columns:
        chosen = max([chosen | {c} for c in range(n_columns) if c not in chosen], key=lambda s: table[s])
        scores.append(table[chosen])
    return scores


def trap() -> dict[frozenset[int], float]:
    """Feature 0 is the best alone and leads astray: the best pair is {1, 2}, the best three are {3, 4, 5}.

    Forward selection never lets go of 0. The floating search drops it once 1 and 2 are there, goes on with 3, 4 and 5,
    and then drops 1 and, continuing, 2.
    """
    table = {c: 0.1 * len(c) - 0.01 * sum(c) for k in range(1, 7) for c in subsets_of(6, k)}
    table |= {frozenset({0}): 0.5, frozenset({0, 1}): 0.55, frozenset({0, 1, 2}): 0.6, frozenset({0, 1, 2, 3}): 0.78}
    table |= {frozenset({0, 1, 2, 3, 4}): 0.8, frozenset({1, 2}): 0.7, frozenset({1, 2, 3}): 0.75}
    table |= {frozenset({1, 2, 3, 4}): 0.95, frozenset({1, 2, 3, 4, 5}): 0.96}
    table |= {frozenset({2, 3, 4, 5}): 0.97, frozenset({3, 4, 5}): 0.9}
    return table


def people(n_people: int = 6, n_each: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two useful features, one that is their noisy sum, two of noise; rows of several people."""
    rng = np.random.default_rng(seed)
    n = n_people * n_each
    useful = rng.normal(size=(n, 2))
    total = useful.sum(axis=1)
    x = np.column_stack([total + rng.normal(0, 0.7, n), useful, rng.normal(size=(n, 2))])
    return x, (total > 0).astype(int), np.repeat(np.arange(n_people), n_each)


def test_where_plain_forward_selection_is_trapped_the_floating_search_is_not() -> None:
    table = trap()
    forward, selection = forward_scores(table, 6), select_by(table, 6)
    best = {k: max(table[c] for c in subsets_of(6, k)) for k in range(1, 7)}
    assert all(forward[size - 1] < best[size] for size in (2, 3, 4, 5))
    assert [subset.score for subset in selection.curve] == pytest.approx([best[size] for size in range(1, 7)])
    assert selection.best.columns == (2, 3, 4, 5)
    assert [c.name for c in selection.history if c.action == "remove"] == ["x0", "x1", "x2"]


def test_on_data_the_best_pair_is_found_only_by_looking_back() -> None:
    x, y, _ = people(n_people=10, n_each=40)
    classifier, folds = LinearDiscriminantAnalysis(), StratifiedKFold(5, shuffle=True, random_state=0)
    forward = SequentialFeatureSelector(classifier, n_features_to_select=2, cv=folds).fit(x, y)
    assert 0 in forward.get_support(indices=True)  # the noisy sum is the best single feature
    selection = select_features(classifier, x, y, cv=folds)
    assert selection.curve[0].columns == (0,)
    assert selection.curve[1].columns == (1, 2)
    exhaustive = {c: cross_val_score(classifier, x[:, list(c)], y, cv=folds).mean() for c in combinations(range(5), 2)}
    assert selection.curve[1].score == pytest.approx(max(exhaustive.values()))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_where_features_add_up_every_size_is_as_good_as_exhaustive_search(seed: int) -> None:
    worth = np.random.default_rng(seed).normal(size=5)
    table = {c: float(worth[sorted(c)].sum()) for k in range(1, 6) for c in subsets_of(5, k)}
    for size, subset in enumerate(select_by(table, 5).curve, start=1):
        assert subset.score == pytest.approx(max(table[c] for c in subsets_of(5, size)))


def test_on_small_real_problems_every_size_is_as_good_as_exhaustive_search() -> None:
    for seed in range(2):
        x, y, person = people(n_each=30, seed=seed)
        classifier, folds = LinearDiscriminantAnalysis(), GroupKFold(3)
        curve = select_features(classifier, x, y, groups=person, cv=folds).curve
        for size, subset in enumerate(curve, start=1):
            scores = [
                cross_val_score(classifier, x[:, list(c)], y, groups=person, cv=folds).mean()
                for c in combinations(range(5), size)
            ]
            assert subset.score == pytest.approx(max(scores))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n_columns=st.integers(1, 6))
def test_the_curve_holds_the_best_of_all_subsets_that_were_scored(seed: int, n_columns: int) -> None:
    table, asked = random_table(n_columns, seed), Counter[frozenset[int]]()
    selection = select_features(DummyClassifier(), *numbered(n_columns), cv=2, scoring=looking_up(table, asked))
    assert [len(s.columns) for s in selection.curve] == list(range(1, n_columns + 1))
    for size, subset in enumerate(selection.curve, start=1):
        assert subset.score == pytest.approx(max(table[c] for c in asked if len(c) == size))
        assert subset.score == pytest.approx(table[frozenset(subset.columns)])
    assert selection.best.score == max(s.score for s in selection.curve)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n_columns=st.integers(1, 6))
def test_no_subset_is_scored_twice_on_a_fold(seed: int, n_columns: int) -> None:
    asked = Counter[frozenset[int]]()
    score = looking_up(random_table(n_columns, seed), asked)
    selection = select_features(DummyClassifier(), *numbered(n_columns), cv=2, scoring=score)
    assert set(asked.values()) == {2}  # once on each of two folds
    assert len(asked) == selection.n_evaluated <= 2**n_columns - 1


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_every_removal_beats_the_best_of_its_size_and_no_addition_lowers_it(seed: int) -> None:
    table = random_table(6, seed)
    current, best = set[str](), dict[int, float]()
    for change in select_by(table, 6).history:
        if change.action == "add":
            assert change.name not in current
            current.add(change.name)
        else:
            current.remove(change.name)
            assert change.score > best[len(current)]
        assert change.n_features == len(current)
        assert change.score == pytest.approx(table[frozenset(int(n[1:]) for n in current)])
        best[len(current)] = max(change.score, best.get(len(current), -np.inf))


def test_a_search_ends_at_the_size_asked_for_and_may_come_back_from_it() -> None:
    selection = select_by(trap(), 6, max_features=3)
    assert len(selection.curve) == 3
    assert [(c.action, c.n_features) for c in selection.history] == [
        ("add", 1),
        ("add", 2),
        ("add", 3),
        ("remove", 2),
        ("add", 3),
    ]


def test_of_equal_scores_the_lowest_columns_and_the_fewest_features_win() -> None:
    table = {c: 0.5 for k in range(1, 5) for c in subsets_of(4, k)}
    selection = select_by(table, 4)
    assert [s.columns for s in selection.curve] == [(0,), (0, 1), (0, 1, 2), (0, 1, 2, 3)]
    assert selection.best.columns == (0,)
    assert {c.action for c in selection.history} == {"add"}


def test_fold_scores_in_another_order_are_no_improvement() -> None:
    in_order = [0.1, 0.2, 0.3]
    assert sum(in_order) / 3 != sum(reversed(in_order)) / 3
    calls = Counter[frozenset[int]]()

    def score(_estimator: Any, x: np.ndarray, _y: Any) -> float:
        columns = frozenset(x[0].astype(int).tolist())
        calls[columns] += 1
        k = calls[columns] - 1
        return in_order[k] if 0 in columns else in_order[2 - k]

    x, y = numbered(3)
    selection = select_features(DummyClassifier(), x, y, cv=KFold(3), scoring=score)
    assert {c.action for c in selection.history} == {"add"}
    assert selection.best.columns == (0,)


def test_two_runs_and_any_number_of_jobs_give_the_same_selection() -> None:
    x, y, person = people()
    classifier = DecisionTreeClassifier(max_depth=3, random_state=0)
    once = select_features(classifier, x, y, groups=person, cv=3)
    assert select_features(classifier, x, y, groups=person, cv=3) == once
    with parallel_config(backend="threading"):
        assert select_features(classifier, x, y, groups=person, cv=3, n_jobs=2) == once
    assert select_features(classifier, x, y, cv=3) == select_features(classifier, x, y, cv=3)


def test_scores_and_their_spread_are_those_of_cross_validation() -> None:
    x, y, person = people()
    selection = select_features(LinearDiscriminantAnalysis(), x, y, groups=person, cv=6, scoring="neg_log_loss")
    for subset in selection.curve:
        scores = cross_val_score(
            LinearDiscriminantAnalysis(),
            x[:, list(subset.columns)],
            y,
            groups=person,
            cv=GroupKFold(6),
            scoring="neg_log_loss",
        )
        assert subset.score == pytest.approx(scores.mean())
        assert subset.score_std == pytest.approx(scores.std())


class Remembering(ClassifierMixin, BaseEstimator):
    """Keeps the person column of its training rows, to be looked at by a scorer."""

    def fit(self, x: np.ndarray, y: np.ndarray) -> Remembering:
        self.people_, self.classes_ = set(x[:, 0].tolist()), np.unique(y)
        return self


def test_no_person_is_ever_in_training_and_test() -> None:
    _, y, person = people()
    in_test = Counter[float]()

    def score(estimator: Remembering, x: np.ndarray, _y: Any) -> float:
        tested = set(x[:, 0].tolist())
        assert not tested & estimator.people_
        in_test.update(tested)
        return 0.5

    x = np.column_stack([person, person]).astype(float)
    for cv in (3, 6, LeaveOneGroupOut()):
        select_features(Remembering(), x, y, groups=person, cv=cv, scoring=score)
    # each of the two columns and the pair, once for each of the three splitters
    assert in_test == dict.fromkeys(range(6), 9)


@pytest.mark.filterwarnings("ignore:The groups parameter is ignored")
def test_folds_that_split_people_are_refused() -> None:
    x, y, person = people()
    with pytest.raises(ValueError, match="GroupKFold"):
        select_features(DummyClassifier(), x, y, groups=person, cv=KFold(4, shuffle=True, random_state=0))


def test_names_go_with_their_columns() -> None:
    names = ("a", "b", "c", "d", "e", "f")
    selection = select_by(trap(), 6, names=names)
    assert selection.best.names == ("c", "d", "e", "f")
    assert selection.history[0].name == "a"


def test_progress_rises_to_one_and_tells_every_move() -> None:
    told: list[tuple[str, float]] = []
    selection = select_by(trap(), 6, progress=lambda what, fraction: told.append((what, fraction)))
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert len(told) == len(selection.history)
    assert told[0][0] == "add x0: 1 features, score 0.5000"


@pytest.mark.parametrize("wrong", [{"names": ("a",)}, {"max_features": 0}, {"max_features": 7}])
def test_arguments_that_do_not_fit_the_data_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="column"):
        select_by(trap(), 6, **wrong)


def test_a_score_that_is_no_number_is_an_error() -> None:
    table = dict.fromkeys(trap(), float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        select_by(table, 6)


def test_the_data_are_not_changed() -> None:
    x, y, person = people()
    before = x.copy(), y.copy(), person.copy()
    select_features(LinearDiscriminantAnalysis(), x, y, groups=person, cv=3)
    for array, copy in zip((x, y, person), before, strict=True):
        np.testing.assert_array_equal(array, copy)
