"""Steps and headings that the phone computed itself are columns beside the detected steps."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.apps.report.page_data import track_data
from pdr_filter.values import Samples
from pdr_filter.values.phone import counted_steps, phone_heading_at


@pytest.mark.parametrize(
    ("counts", "steps"),
    [
        ([0, 4, 31], [0, 4, 31]),
        ([3, 9, 31], [3, 9, 31]),
        ([9000, 9004, 9031], [0, 4, 31]),
        ([3, 9, 0, 5], [3, 9, 9, 14]),
        ([9000, 9004, 9000, 9001], [0, 4, 4, 5]),
        ([np.nan, 2, np.nan, 4], [2, 4]),
    ],
    ids=["from zero", "late first report", "since the phone was started", "reset", "of another phone", "gaps"],
)
def test_steps_are_counted_from_the_start_of_the_recording(counts: list[float], steps: list[float]) -> None:
    counter = Samples(np.arange(len(counts)), np.array(counts, dtype=float)[:, np.newaxis])
    assert counted_steps(counter).values[:, 0].tolist() == steps


def test_the_heading_at_a_time_is_the_latest_report_in_any_order_of_rows() -> None:
    heading = Samples([3.0, 1.0, 2.0], [[0.3], [np.radians(350.0)], [np.nan]])
    found = phone_heading_at(heading, np.array([0.9, 1.0, 2.9, 3.0, 99.0]))
    np.testing.assert_allclose(found, [np.nan, np.radians(-10.0), np.radians(-10.0), 0.3, 0.3])


def test_a_track_and_its_table_and_page_have_the_columns_of_the_phone(tmp_path: Path) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=8.0)])
    phone = replace(
        walk,
        phone_step_count=Samples([2.0, 4.0, 6.0], [[1000.0], [1002.0], [1005.0]]),
        phone_heading=Samples([0.0, 4.0], [[0.5], [6.0]]),
    )
    for track in (pdr.track(phone, heading_rad=1.0), pdr.smooth(phone, gnss="off").track):
        late = track.time_s >= 4.0
        assert late.any()
        assert not late.all()
        np.testing.assert_allclose(track.phone_heading_rad, np.where(late, 6.0 - 2 * np.pi, 0.5))
        np.testing.assert_array_equal(track.phone_n_steps[late & (track.time_s < 6.0)], 2.0)
        with track.to_csv(tmp_path / "walk.csv").open() as file:
            rows = [*csv.DictReader(file)]
        for name in ("phone_heading_rad", "phone_n_steps"):
            np.testing.assert_allclose([float(row[name]) for row in rows], getattr(track, name), rtol=1e-6)
        shown = track_data(track, phone, None, 1)
        np.testing.assert_allclose(shown["phone_heading"], np.degrees(track.phone_heading_rad) % 360, atol=0.06)
        assert [np.nan if v is None else v for v in shown["phone_n_steps"]] == pytest.approx(
            track.phone_n_steps.tolist(), nan_ok=True
        )
    plain = pdr.track(walk)
    assert len(plain.phone_heading_rad) == len(plain.phone_n_steps) == 0
    assert "phone" not in plain.to_csv(tmp_path / "plain.csv").read_text()
