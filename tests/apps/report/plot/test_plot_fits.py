"""Figures draw the given data, into given axes or into new axes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import a_plan
from made_tracks import make_track
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from pdr_filter import evaluate
from pdr_filter.apps.report import plot
from pdr_filter.values import CONTEXTS, Cluster
from pdr_filter.values.arrays import table


def offsets(axes: Axes) -> list[np.ndarray]:
    """Return the positions of the dots, an array for each call of scatter."""
    return [np.asarray(dots.get_offsets()) for dots in axes.collections if isinstance(dots, PathCollection)]


def test_figures_are_drawn_into_the_axes_that_are_given() -> None:
    track = make_track(12, 6)
    for draw in (plot.way, plot.contexts, plot.heights, plot.step_lengths):
        axes = Figure().add_subplot()
        assert draw(track, axes) is axes
        assert axes.has_data()
        assert draw(track).figure is not axes.figure


def test_a_floor_plan_lies_below_the_way(tmp_path: Path) -> None:
    axes = plot.way(make_track(12, 6), plan=a_plan(tmp_path))
    areas = [c for c in axes.collections if isinstance(c, PathCollection) and len(c.get_paths())]
    np.testing.assert_allclose(np.ptp(areas[0].get_paths()[0].vertices, axis=0), [60.0, 60.0])
    assert len(areas) == 2
    assert max(area.get_zorder() for area in areas) < min(line.get_zorder() for line in axes.lines)


def test_each_place_where_a_walk_may_have_ended_is_drawn_with_its_probability() -> None:
    track = make_track(12, 6)
    here = Cluster(0.62, np.array([3.0, 4.0]), np.diag([1.0, 4.0]))
    there, hardly = Cluster(0.31, np.array([30.0, -9.0]), np.eye(2)), Cluster(0.01, np.array([90.0, 90.0]), np.eye(2))
    axes = plot.way(replace(track, clusters=((),) * 11 + ((here, there, hardly),)))
    first, second = (p for p in axes.patches if isinstance(p, Ellipse))
    assert (first.get_center(), second.get_center()) == ((3.0, 4.0), (30.0, -9.0))
    assert (first.width, first.height) == pytest.approx((2 * 2.448 * 2, 2 * 2.448), rel=1e-3)
    assert abs(first.angle) == pytest.approx(90.0)
    assert [t.get_text() for t in axes.texts] == ["62 %", "31 %"]
    assert "possible end" in [t.get_text() for t in axes.get_legend().get_texts()]
    alone = plot.way(replace(track, clusters=((),) * 11 + ((here,),)))
    assert not alone.texts


def test_every_step_length_stands_with_its_context_beside_its_median() -> None:
    n = 60
    walking = np.arange(n) < 40
    prob = np.eye(6)[np.where(walking, CONTEXTS.index("walking"), CONTEXTS.index("running"))]
    length_m = np.where(walking, 0.7, 1.1) + np.random.default_rng(0).normal(scale=0.05, size=n)
    axes = plot.step_lengths(replace(make_track(n, 30), context_prob=prob, step_length_m=length_m))
    drawn = offsets(axes)
    for place, own in enumerate((walking, ~walking)):
        np.testing.assert_array_equal(np.sort(drawn[place][:, 1]), np.sort(length_m[own]))
        assert np.abs(drawn[place][:, 0] - place).max() < 0.5
    assert [t.get_text() for t in axes.get_xticklabels()] == ["walking\n40 steps", "running\n20 steps"]
    medians = {segment[0][1] for c in axes.collections if hasattr(c, "get_segments") for segment in c.get_segments()}
    assert {np.median(length_m[walking]), np.median(length_m[~walking])} <= medians


def test_a_track_without_steps_has_an_empty_figure() -> None:
    for draw in (plot.way, plot.contexts, plot.heights, plot.step_lengths):
        axes = draw(make_track(0, 0))
        axes.figure.canvas.draw()
        # nothing of a step: a legend's samples and marks of the start have one or no point
        assert all(len(np.asarray(line.get_xdata())) <= 1 for line in axes.lines)
        assert all(len(dots) <= 1 for dots in offsets(axes))


def test_the_dots_of_a_reliability_diagram_are_its_bins() -> None:
    prob = np.array([[0.9, 0.1]] * 10 + [[0.4, 0.6]] * 10)
    correct = np.arange(20) % 2 == 0
    (dots,) = offsets(plot.reliability(prob, correct, n_bins=10))
    np.testing.assert_allclose(dots[np.argsort(dots[:, 0])], [[0.6, 0.5], [0.9, 0.5]])


def test_errors_of_a_right_covariance_lie_along_the_chi_square_density() -> None:
    rng = np.random.default_rng(1)
    cov = np.array([[4.0, 1.0], [1.0, 2.0]])
    error = rng.multivariate_normal([0.0, 0.0], cov, 20_000)
    axes = plot.nees(evaluate.nees(error, np.tile(cov, (20_000, 1, 1))))
    share, edges, _ = axes.patches[0].get_data()
    middle = 0.5 * (edges[1:] + edges[:-1])
    np.testing.assert_allclose(share, chi2.pdf(middle, 2), atol=0.02)
    labels = [t.get_text() for t in axes.get_legend().get_texts()]
    assert "95 % ellipse: contains 95 %" in labels


@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_a_figure_is_saved_from_its_axes_in_vector_form_with_its_fonts(tmp_path: Path, suffix: str) -> None:
    path = plot.save(plot.way(make_track(12, 6)), tmp_path / "new" / f"way.{suffix}")
    content = path.read_bytes()
    assert content.startswith({"pdf": b"%PDF", "svg": b"<?xml", "png": b"\x89PNG"}[suffix])
    assert b"/Type3" not in content
    assert (b"/FontFile2" in content) == (suffix == "pdf")
    assert suffix != "svg" or b"<image" not in content
    plot.track(make_track(3, 2), path)
    assert path.read_bytes()[:4] == content[:4]


def test_residuals_of_contexts_with_own_names_are_drawn_in_colours_that_differ() -> None:
    segments = table(
        {
            "context": np.array(["level", "ramp"]),
            "distance_m": np.array([50.0, 80.0]),
            "left_out_m": np.array([51.0, 79.0]),
            "distrusted": np.array([False, False]),
        }
    )
    first, second = (points.get_facecolor().tolist() for points in plot.residuals(segments).collections)
    assert first != second
