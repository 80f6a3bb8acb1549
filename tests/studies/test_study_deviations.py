"""The formulas that are put in place of the recipes' own, against closed forms."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.tian2016.heading import viewing_direction
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Step
from tests.studies import deviations as study


def test_the_euler_yaw_is_the_first_angle_whatever_pitch_and_roll() -> None:
    yaw, pitch, roll = np.random.default_rng(0).uniform(-1.4, 1.4, (3, 50))
    to_world = Rotation.from_euler("ZXY", np.column_stack([-yaw, pitch, roll]))  # yaw is clockwise
    force = np.random.default_rng(1).normal(size=(50, 3))
    known = {
        "up_sensor": to_world.inv().apply([0.0, 0.0, 1.0]),
        "horizontal_mps2": to_world.apply(force)[:, :2],
    }
    attitude = AttitudeBlock(**{f.name: known.get(f.name, np.zeros(50)) for f in fields(AttitudeBlock)})
    assert study.euler_yaw(force, attitude) == pytest.approx(yaw, abs=1e-9)
    is_rolled = np.abs(roll) > 0.5
    assert (np.abs(viewing_direction(force, attitude) - yaw)[is_rolled] > 0.01).any()


def test_the_average_of_table_iv_of_two_angles_about_zero_is_half_a_turn() -> None:
    assert abs(study.average_of_table_iv(np.array([-0.1, 0.1]))) == pytest.approx(np.pi)


def test_the_magnitude_of_the_wavelet_transform_has_two_maxima_for_each_step() -> None:
    walk = simulate([Leg("walking", distance_m=20.0)])
    signed, unsigned = (
        sum(isinstance(e, Step) for e in run_sensing(Sensing(steps=steps), walk)[1])
        for steps in (WaveletStepDetector(), study.UnsignedWavelet())
    )
    assert unsigned > 1.6 * signed
