"""Figures of walks: files, numbers in the drawing, and few or many steps."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_tracks import make_track
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Rings
from scipy.stats import chi2

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.report import plot
from pdr_filter.apps.report.geometry import band_rings, band_rows, ellipse_axes
from pdr_filter.apps.report.palette import context_colours
from pdr_filter.values import CONTEXTS, FixOutcome, FixResult, RangeFix

PNG = b"\x89PNG"


def texts(figure) -> str:
    plane, time = figure.axes
    written = [plane.get_title(loc="left"), *(t.get_text() for axes in (plane, time) for t in axes.texts)]
    return "\n".join([*written, figure.get_supxlabel()])


@pytest.mark.parametrize(
    ("n_steps", "n_windows"), [(0, 0), (0, 5), (1, 0), (1, 1), (2, 3), (300, 150), (10_000, 5_000)]
)
def test_any_number_of_steps_and_windows_can_be_drawn(tmp_path: Path, n_steps: int, n_windows: int) -> None:
    path = tmp_path / "new" / "track.png"
    plot.track(make_track(n_steps, n_windows), path)
    assert path.read_bytes().startswith(PNG)
    assert path.stat().st_size < 1_000_000


def test_drawing_opens_no_window_and_leaves_no_figure_behind() -> None:
    code = (
        "import sys, pdr_filter as pdr\n"
        "walk = pdr.simulate.simulate([pdr.simulate.Leg('walking', distance_m=15.0)])\n"
        "pdr.track(walk).plot()\n"
        "assert 'matplotlib.pyplot' not in sys.modules, 'pyplot keeps every figure until it is closed'\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_title_tells_name_distance_duration_steps_and_closure() -> None:
    track = make_track(200, 100)
    written = texts(plot.track(track))
    for fact in ("made_up", "200 steps", f"{track.distance_m:.1f} m", "1 min 41 s", "m from the start"):
        assert fact in written or fact.replace("41", "40") in written, fact


def test_a_single_step_is_not_called_steps() -> None:
    assert "1 step " in texts(plot.track(make_track(1, 1)))


def test_notes_are_shown_and_many_are_counted() -> None:
    assert texts(plot.track(make_track(5, 5))).endswith("\n")  # no note, nothing written
    notes = tuple(f"remark number {i}" for i in range(5))
    written = texts(plot.track(make_track(5, 5, notes=notes)))
    assert "remark number 0" in written
    assert "remark number 4" not in written
    assert "2 more" in written


def test_the_legend_names_the_contexts_that_occur_and_no_others() -> None:
    track = make_track(20, 0)
    walking = np.tile(np.eye(6)[CONTEXTS.index("walking")], (20, 1))
    figure = plot.track(replace(track, context_prob=walking))
    legend = {t.get_text() for t in figure.axes[0].get_legend().get_texts()}
    assert legend & set(CONTEXTS) == {"walking"}
    assert {"start", "end"} <= legend


def test_each_step_is_drawn_in_the_colour_of_its_context() -> None:
    track = make_track(12, 3)
    lines = [c for c in plot.track(track).axes[0].collections if isinstance(c, LineCollection)]
    (way,) = lines
    expected = [context_colours()[CONTEXTS[i]] for i in track.context_prob.argmax(axis=1)]
    drawn = [f"#{''.join(f'{round(255 * part):02X}' for part in rgba[:3])}" for rgba in way.get_colors()]
    assert drawn == expected


def test_ellipses_hold_95_percent() -> None:
    track = make_track(40, 10)
    (ellipses,) = [c for c in plot.track(track).axes[0].collections if isinstance(c, EllipseCollection)]
    offsets = np.asarray(ellipses.get_offsets())
    np.testing.assert_allclose(offsets[-1], track.position_m[-1])  # the last one is at the end
    half_m = np.array([ellipses.get_widths()[-1], ellipses.get_heights()[-1]]) / 2
    angle = np.radians(ellipses.get_angles()[-1])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    drawn_cov = turn @ np.diag(half_m**2) @ turn.T / chi2(2).ppf(0.95)
    np.testing.assert_allclose(drawn_cov, track.position_cov_m2[-1], rtol=1e-3)


def test_the_band_holds_the_ellipses_of_all_steps_and_the_places_between_them() -> None:
    track = make_track(40, 10)
    (band,) = [p for p in plot.track(track).axes[0].patches if isinstance(p, PathPatch)]
    on_edge_m = []
    for position_m, cov_m2 in zip(track.position_m, track.position_cov_m2, strict=True):
        out = np.linalg.cholesky(cov_m2) @ np.array([np.cos(np.arange(0, 6.3, 0.5)), np.sin(np.arange(0, 6.3, 0.5))])
        on_edge_m.append(position_m + 0.99 * np.sqrt(chi2(2).ppf(0.95)) * out.T)
    path = band.get_path()
    rings = np.split(np.asarray(path.vertices), np.flatnonzero(np.asarray(path.codes) == Rings.MOVETO)[1:])
    assert np.any([Rings(ring).contains_points(np.vstack(on_edge_m)) for ring in rings], axis=0).all()
    assert len(rings) == 40 + 39
    area = [0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) for x, y in (ring[:-1].T for ring in rings)]
    assert min(area) > 0  # in one direction: rings of both directions would cancel each other


def test_every_step_of_a_long_walk_around_corners_lies_in_the_band() -> None:
    corners_m = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0], [0.0, 0.0]])
    walked_m = 0.7 * np.arange(3000) % 60.0
    position_m = np.column_stack([np.interp(walked_m, [0.0, 20.0, 30.0, 50.0, 60.0], side) for side in corners_m.T])
    cov_m2 = np.broadcast_to(0.3**2 * np.eye(2), (3000, 2, 2))
    minor_m = ellipse_axes(cov_m2)[0][:, 0]
    rows = band_rows(position_m, minor_m)
    assert len(rows) < 1200
    for first in range(0, len(rows) - 8, 100):  # parts, so that a later round does not cover an earlier one
        part = rows[first : first + 8]
        rings = [Rings(ring) for ring in band_rings(position_m[part], cov_m2[part])]
        steps_m = position_m[part[0] : part[-1] + 1]
        assert np.any([ring.contains_points(steps_m) for ring in rings], axis=0).all()
    straight_m = np.column_stack([0.7 * np.arange(3000), np.zeros(3000)])
    assert len(band_rows(straight_m, minor_m)) == 300
    assert [len(band_rows(straight_m[:n], minor_m[:n])) for n in (0, 1, 2)] == [0, 1, 2]


def test_north_and_east_have_the_same_scale() -> None:
    assert plot.track(make_track(30, 10)).axes[0].get_aspect() == 1.0


def test_time_without_windows_stays_empty() -> None:
    track = make_track(10, 10)
    keep = np.array([True] * 4 + [False] * 4 + [True] * 2)  # windows end at 2, 3, 4, 5 and 10, 11 s
    windows = replace(track.windows, time_s=track.windows.time_s[keep], context_prob=track.windows.context_prob[keep])
    figure = plot.track(replace(track, windows=windows))
    stack = [c for c in figure.axes[1].collections if not isinstance(c, LineCollection)]
    drawn = [path for collection in stack for path in collection.get_paths()]

    def is_covered(time_s: float) -> bool:
        return any(path.contains_point((time_s, y)) for path in drawn for y in (0.25, 0.5, 0.75))

    assert [is_covered(time_s) for time_s in (0.5, 4.5, 6.5, 8.5, 10.5)] == [True, True, False, True, True]


def ranges_of(*ranges: tuple[tuple[float, float], FixOutcome]) -> tuple[FixResult, ...]:
    fixes = [
        (RangeFix(float(t), np.array(anchor_m), 3.0, 0.3), outcome) for t, (anchor_m, outcome) in enumerate(ranges)
    ]
    return tuple(FixResult.of(fix, fix.time_s, outcome) for fix, outcome in fixes)


def test_anchors_whose_ranges_were_used_are_drawn_once_and_named() -> None:
    fixes = ranges_of(((9.0, -4.0), "used"), ((9.0, -4.0), "rejected"), ((2.0, 8.0), "used"), ((50.0, 0.0), "waiting"))
    axes = plot.way(replace(make_track(10, 3), fixes=fixes))
    (anchors,) = [line for line in axes.lines if line.get_marker() == "^"]
    np.testing.assert_array_equal(anchors.get_xydata(), [[2.0, 8.0], [9.0, -4.0]])
    (low, high), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert low < 0 and high > 9.0 and bottom < -4.0 and top > 8.0
    assert "anchor of ranges" in [text.get_text() for text in axes.get_legend().get_texts()]
    plain = plot.way(make_track(10, 3))
    assert "anchor of ranges" not in [text.get_text() for text in plain.get_legend().get_texts()]


def test_anchors_turn_with_the_track() -> None:
    track = replace(make_track(10, 3), fixes=ranges_of(((0.0, 4.0), "used")))
    np.testing.assert_allclose(track.turned(np.pi / 2).anchors_m, [[4.0, 0.0]], atol=1e-12)


def test_the_true_way_is_drawn_where_it_is_given() -> None:
    reference_m = np.array([[0.0, 0.0], [3.0, 4.0]])
    plane = plot.track(make_track(8, 4), reference_m=reference_m).axes[0]
    assert any(np.array_equal(line.get_xydata(), reference_m) for line in plane.lines)
    assert "truth" in {t.get_text() for t in plane.get_legend().get_texts()}


# Linear RGB as seen by people with protanopia, deuteranopia and tritanopia: Machado, Oliveira and Fernandes, "A
# physiologically-based model for simulation of color vision deficiency", IEEE TVCG 15(6), 2009, severity 1.
VISION = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(linear_rgb: np.ndarray) -> np.ndarray:
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ np.clip(linear_rgb, 0, 1) / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_context_colours_are_distinct_for_any_colour_vision(vision: str) -> None:
    seen = []
    for colour in context_colours().values():
        srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        seen.append(lab(np.asarray(VISION[vision]) @ linear))
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) >= 18


def test_a_dollar_in_names_and_notes_begins_no_formula(tmp_path: Path) -> None:
    track = replace(make_track(5, 3, notes=("5 $ and 6 $_ too",)), name="walk $x^ of $y")
    figure = plot.track(track, tmp_path / "walk.png")
    assert "walk $x^ of $y" in texts(figure)
    axes = plot.people("walking", {"a $b^ $c": (0.7, 0.1)}, (0.7, np.nan))
    plot.save(axes, tmp_path / "people.png")
    plan = read_plan(tmp_path, "hall $1^ $2")
    plot.plan(plan, tmp_path / "plan.png")


def test_contexts_and_storeys_are_named_where_they_are_drawn_alone() -> None:
    track = replace(make_track(12, 6), floor=np.repeat([0, 1], 6))
    named = [text.get_text() for text in plot.contexts(track).get_legend().get_texts()]
    assert named == list(CONTEXTS)
    storeys = [text.get_text() for text in plot.heights(track).get_legend().get_texts()]
    assert storeys == ["floor 1", "floor 0"]
    below = plot.track(track).axes
    assert [axes.get_legend() is not None for axes in below] == [True, False, False]


def test_one_step_of_a_context_is_not_called_steps() -> None:
    names = [label.get_text() for label in plot.step_lengths(make_track(7, 0)).get_xticklabels()]
    assert {name.split("\n")[1] for name in names} == {"1 step", "2 steps"}


def test_names_on_a_plan_do_not_lie_on_each_other(tmp_path: Path) -> None:
    axes = plot.plan(
        read_plan(tmp_path, "hall", "a room of a long name", "another room here", "a third room there")
    ).axes[0]
    words = [text for text in axes.texts if text.get_text()]
    assert words[0].get_text() == "a room of a long nam"  # the name of the largest room
    boxes = [text.get_window_extent() for text in words]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert len(words) < 3


def read_plan(folder: Path, name: str, *rooms: str) -> FloorPlan:
    """Return a plan with a hall of 30 m and nested rooms."""
    areas = [("floor", name, 15.0), *(("room", room, 5.0 - 0.1 * k) for k, room in enumerate(rooms))]
    features = [
        {
            "type": "Feature",
            "properties": {"type": kind, "name": words},
            "geometry": {"type": "Polygon", "coordinates": [[[-h, -h], [h, -h], [h, h], [-h, h], [-h, -h]]]},
        }
        for kind, words, h in areas
    ]
    path = folder / f"{name}.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return FloorPlan.read(path)
