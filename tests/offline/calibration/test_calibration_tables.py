"""Tables and report of a calibration."""

from dataclasses import replace

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import table


@pytest.fixture(scope="module")
def calibration() -> pdr.Calibration:
    walks = [replace(simulate([Leg("walking", distance_m=20.0)], seed=seed), meta={}) for seed in (1, 2, 3)]
    return pdr.calibrate(walks, each_a_person=True)


def test_tables_have_the_parameters_their_covariance_and_the_held_out_residuals(
    calibration: pdr.Calibration,
) -> None:
    tables, n = calibration.tables(), len(calibration.theta)
    assert tables["parameters"]["value"].tolist() == calibration.theta.tolist()
    assert tables["covariance"]["covariance"].reshape(n, n).tolist() == calibration.theta_cov.tolist()
    assert tables["covariance"]["other_context"].reshape(n, n)[0].tolist() == tables["parameters"]["context"].tolist()
    segments = calibration.segments
    np.testing.assert_allclose(tables["segments"]["residual_m"], segments.distance_m - segments.left_out_m)


@pytest.mark.parametrize(("off_m", "is_said"), [(0.0, False), (15.0, True)])
def test_the_report_states_if_the_calibration_makes_other_people_worse(
    calibration: pdr.Calibration, off_m: float, is_said: bool
) -> None:
    segments = calibration.segments
    columns = {name: segments[name] for name in segments.dtype.names or ()}
    stranger_m = segments.distance_m + off_m * np.array([1.0, -1.0, 1.0])
    changed = replace(calibration, segments=table({**columns, "stranger_m": stranger_m}))
    assert ("strangers' segments are" in changed.report()) == is_said
