"""Distance metrics: closed forms, and a paper's printed numbers against each other."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.evaluate import distance
from pdr_filter.evaluate.tables import Markdown, markdown

# Martinelli et al. 2018, Table V: %error of 15 subjects.
HC = [0.6, -3.3, -5.7, -3.0, -6.9, -7.8, -3.6, -6.0, -4.5, -7.5, -13.6, -13.5, -7.8, -7.5, -13.1]
WC = [5.1, 1.2, 4.5, -3.3, -10.3, -9.0, 0.0, -7.5, -0.3, -6.0, -3.0, -3.9, 1.8, 1.2, -6.1]


def test_too_short_is_negative() -> None:
    np.testing.assert_allclose(distance.percent_error([93.0, 104.0], [100.0, 200.0]), [-7.0, -48.0])


def test_bias_and_spread_make_the_rmse() -> None:
    scores = distance.distance_scores(np.random.default_rng(0).normal(-4, 3, 40))
    assert scores.rmse_percent**2 == pytest.approx(scores.bias_percent**2 + scores.spread_percent**2)


@pytest.mark.parametrize(("errors", "rmse", "of_subgroups"), [(HC, 7.9, (4.5, 6.2, 11.5)), (WC, 5.2, (5.7, 5.9, 3.6))])
def test_table_v_of_the_paper_gives_its_table_iv(
    errors: list[float], rmse: float, of_subgroups: tuple[float, ...]
) -> None:
    """To within what rounding both tables to a tenth can do."""
    assert distance.distance_scores(errors).rmse_percent == pytest.approx(rmse, abs=0.1)
    for k, printed in enumerate(of_subgroups):
        assert distance.distance_scores(errors[5 * k : 5 * k + 5]).rmse_percent == pytest.approx(printed, abs=0.1)


def test_the_papers_errors_are_biased() -> None:
    """So that most of its %RMSE with HC is a bias that a calibration takes away."""
    assert distance.distance_scores(HC).bias_percent == pytest.approx(-6.88, abs=0.005)
    assert distance.distance_scores(WC).bias_percent == pytest.approx(-2.37, abs=0.005)


def test_scores_of_nothing_are_not_known() -> None:
    scores = distance.distance_scores([])
    assert scores.n == 0
    assert np.isnan([scores.bias_percent, scores.spread_percent, scores.rmse_percent, scores.largest_percent]).all()


def test_the_table_has_each_context_and_all() -> None:
    found = distance.distance_table([11.0, 9.0, 20.0], [10.0, 10.0, 10.0], ["walking", "walking", "running"])
    assert found.context.tolist() == ["running", "walking", "all"]
    assert found.n.tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.bias_percent, [100, 0, 100 / 3])
    np.testing.assert_allclose(found.spread_percent[:2], [0, 10])
    np.testing.assert_allclose(found.largest_percent, [100, 10, 100])


def test_a_leg_has_the_steps_that_end_in_it() -> None:
    """A step that ends at the start of a leg is of the one before; every step is in one leg only."""
    time_s, length_m = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, 0.6, 0.7, 0.8])
    np.testing.assert_allclose(distance.walked_m(time_s, length_m, [0.0, 2.0], [2.0, 4.0]), [1.1, 1.5])
    np.testing.assert_allclose(distance.walked_m(time_s, length_m, [5.0], [9.0]), [0.0])


def test_tables_are_printed_in_the_order_of_their_columns() -> None:
    found = distance.distance_table([11.0, 9.0], [10.0, 10.0], ["walking", "walking"])
    lines = markdown(found, digits=1).splitlines()
    assert lines[0] == "| context | n | bias_percent | spread_percent | rmse_percent | largest_percent |"
    assert lines[1] == "|---|---|---|---|---|---|"
    assert lines[2] == "| walking | 2 | 0.0 | 10.0 | 10.0 | 10.0 |"
    assert len(lines) == 4


def test_a_number_that_is_not_known_is_a_dash() -> None:
    text = markdown([{"name": "none", "rmse": np.nan, "mean": np.float64(1.0)}])
    assert text.splitlines()[2] == "| none | - | 1.00 |"
    assert isinstance(text, Markdown)
    assert text._repr_markdown_() == text


def test_a_cell_of_any_text_stays_one_cell() -> None:
    text = markdown([{"a|b": "x|y\nz", "mean": np.float32(1.239)}])
    assert text.splitlines() == ["| a\\|b | mean |", "|---|---|", "| x\\|y z | 1.24 |"]


def test_the_distance_between_times_that_are_not_known_is_not_known() -> None:
    time_s, length_m = np.arange(3.0), np.ones(3)
    found_m = distance.walked_m(time_s, length_m, [np.nan, 0.0, -np.inf], [1.0, np.nan, np.inf])
    np.testing.assert_array_equal(found_m, [np.nan, np.nan, 3.0])
