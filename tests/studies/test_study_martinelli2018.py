from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.distance import distance_scores
from tests.studies import martinelli2018 as study


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_the_printed_table_v_gives_the_printed_table_iv(weighting: str) -> None:
    errors = np.array(study.TABLE_V[weighting])
    for part, rmse in zip((*np.split(errors, 3), errors), study._TABLE_IV[weighting], strict=True):
        assert distance_scores(part).rmse_percent == pytest.approx(rmse, abs=0.11)


def test_the_printed_confusion_matrix_has_the_printed_recalls() -> None:
    np.testing.assert_allclose(study._TABLE_III.sum(axis=1), 100.0, atol=0.11)
    np.testing.assert_array_equal(np.diag(study._TABLE_III), study._RECALL_PERCENT)


def test_a_constant_of_the_others_removes_an_error_that_all_people_share() -> None:
    columns = {"ours HC": [-7.0, -7.0, -7.0]}
    rows = {str(row["person"]): row["ours HC"] for row in study._people(columns)}
    assert (rows["bias"], rows["spread"], rows["RMSE"]) == (-7.0, 0.0, 7.0)
    assert rows["RMSE with a constant of the others"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.recordings
def test_real_walks_are_put_together_with_one_gravity_and_a_label_for_each_part(data_dir: Path) -> None:
    walk = study.put_together(data_dir, "s01")
    assert walk is not None and walk.truth.labels is not None
    labels = walk.truth.labels
    assert list(labels["context"][:3]) == ["stationary", "walking", "upstairs"]
    np.testing.assert_allclose(labels["start_s"][1:], labels["end_s"][:-1])
    force, time_s = walk.accelerometer.values, walk.accelerometer.time_s
    mean = [force[(time_s >= a) & (time_s < b)].mean(axis=0) for a, b in zip(labels.start_s, labels.end_s, strict=True)]
    up = np.array([m / np.linalg.norm(m) for m in mean])
    np.testing.assert_allclose(up @ up[0], 1.0, atol=1e-6)
    assert study.put_together(data_dir, "s99") is None


def test_a_floating_search_drops_a_feature_that_two_others_replace() -> None:
    # "a" is the best alone, "b" and "c" together need no "a"
    value = {
        frozenset("a"): 3.0,
        frozenset("ab"): 4.0,
        frozenset("ac"): 3.5,
        frozenset("abc"): 5.0,
        frozenset("bc"): 6.0,
    }
    found = study.floating_search("abc", lambda names: value.get(frozenset(names), 0.0))
    assert [(score, set(names)) for score, names in found] == [(3.0, {"a"}), (6.0, {"b", "c"}), (5.0, {"a", "b", "c"})]
