from dataclasses import replace

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.values import table
from tests.studies import tian2016 as tian
from tests.studies.tian2016 import TRANS, Carried


def test_what_was_said_last_holds_on_and_the_mode_most_often_said_wins() -> None:
    said = Carried(np.arange(7.0), ["HOLDING", TRANS, TRANS, "POCKET", "POCKET", TRANS, TRANS])
    assert said.within(3.5, 4.5) == ["POCKET", "POCKET"]
    assert said.most(0.0, 6.0) == "POCKET"
    assert said.most(5.0, 6.0) == TRANS


def test_a_track_turned_by_a_constant_angle_has_no_heading_error(monkeypatch: pytest.MonkeyPatch) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=15.0)])
    found = pdr.track(walk, gnss="off")
    true = walk.truth.position
    monkeypatch.setattr(tian, "track", lambda *_: found)
    errors = tian.heading_of(walk, pdr.recipes.default())
    assert errors is not None
    assert np.median(errors.heading_deg) < 5.0
    turned = replace(walk, truth=replace(walk.truth, position=table({
        "time_s": true.time_s, "east_m": true.north_m, "north_m": -true.east_m, "up_m": true.up_m,
    })))  # fmt: skip
    other = tian.heading_of(turned, pdr.recipes.default())
    assert other is not None
    np.testing.assert_allclose(other.heading_deg, errors.heading_deg, atol=1e-6)
