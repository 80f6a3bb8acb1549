"""A filter that uses all reported walking headings has the estimate of the heading stage."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step

from pdr_filter import recipes
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, Directions
from pdr_filter.filter.imm.step_cycle import step_cycle
from pdr_filter.filter.pedestrian.pedestrian_state import initial_state, since_last_step
from pdr_filter.sensing.heading.reported_heading import Reported, Shown

BIAS_STD_RADPS = 0.002


@pytest.mark.parametrize("pause_s", [0.5, 20.0, 60.0])
def test_after_a_pause_and_a_late_heading_change_the_filter_has_heading_and_variance_of_the_stage(
    pause_s: float,
) -> None:
    """In both filters the drift of the pause precedes the measurement, so both apply the same part of the change."""
    model = recipes.default().model
    drift, one_mode = model.noise.heading_drift, Directions(*np.zeros((4, 1)))
    state, reported = initial_state(model, np.ones(1)), Reported()
    shown = [(0.5, 0.0, 0.01), (1.0, 0.0, 0.01), (1.0 + pause_s, 0.4, 0.01), (1.5 + pause_s, 0.4, 0.005)]
    for time_s, offset_rad, var_rad2 in shown:
        step = replace(a_step(time_s), yaw_bias_std_radps=BIAS_STD_RADPS)
        reported = reported.at_step(step, drift, BIAS_STD_RADPS)
        reported, fields = reported.with_report(step, Shown(offset_rad, var_rad2, 0.0), 0.0, var_rad2, 0.0)
        step, since = replace(step, **fields), since_last_step(state, step)
        no_length = np.zeros(1), np.zeros(1)
        cycle = step_cycle(state.estimates, state.heading_zero, step, since, no_length, one_mode, model.noise)
        known = replace(cycle.ahead, mean=cycle.turned_mean, cov=cycle.turned_cov)
        steps = replace(state.steps, last_s=time_s)
        state = replace(state, estimates=known, heading_zero=cycle.zero, steps=steps)
        assert state.heading_zero.offset_rad + known.mean[0, HEADING_OFFSET] == pytest.approx(reported.offset_rad)
        assert known.cov[0, HEADING_OFFSET, HEADING_OFFSET] == pytest.approx(reported.var_rad2)
    assert math.isclose(reported.time_s, 1.5 + pause_s)
    assert reported.offset_rad > 0.1
