"""Factors of the user in the smoother."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.offline.smoothing.factor_graph import PoseKeys

WALK = pdr.simulate.simulate(
    [pdr.simulate.Leg("walking", distance_m=15.0, turn_rad=turn) for turn in (0.0, np.pi / 2, np.pi / 2)]
)
TRUTH = WALK.truth.position


def true_m(time_s: float) -> np.ndarray:
    """True position at a time."""
    return np.array([np.interp(time_s, TRUTH.time_s, TRUTH[axis]) for axis in ("east_m", "north_m")])


FIXES = [pdr.PositionFix(t, true_m(t) + e, np.eye(2)) for t, e in ((2.0, -0.4), (22.0, 0.5))]
LANDMARK = gtsam.symbol("l", 0)


def test_a_prior_of_a_pose_has_the_effect_of_the_fix_that_it_states() -> None:
    # enough fixes that their clock is estimated with and without one more
    fixes = [*FIXES, *(pdr.PositionFix(t, true_m(t), np.eye(2)) for t in (8.0, 15.0, 29.0))]
    time_s = float(pdr.smooth(WALK, fixes=fixes).track.time_s[20])
    place, noise = true_m(time_s) + np.array([0.8, -0.8]), gtsam.noiseModel.Isotropic.Sigma(2, 0.5)

    def factors(keys: PoseKeys) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(gtsam.PoseTranslationPrior2D(keys.key(time_s), gtsam.Pose2(*place, 0.0), noise))
        return graph

    as_fix = pdr.smooth(WALK, fixes=[*fixes, pdr.PositionFix(time_s, place, 0.25 * np.eye(2))])
    as_factor = pdr.smooth(WALK, fixes=fixes, factors=factors)
    without = pdr.smooth(WALK, fixes=fixes)
    assert np.abs(as_fix.track.position_m - without.track.position_m).max() > 0.2
    np.testing.assert_allclose(as_factor.track.position_m, as_fix.track.position_m, atol=0.02)
    std_m, of_fix_m = (np.sqrt(s.track.position_cov_m2[:, [0, 1], [0, 1]]) for s in (as_factor, as_fix))
    # errors that the smoother does not estimate count from fixes, and not from factors
    np.testing.assert_allclose(std_m, of_fix_m, rtol=0.15)


def test_a_landmark_seen_twice_gets_a_position_and_ties_the_walk_together() -> None:
    seen_s, place = (4.0, 27.0), np.array([6.0, 8.0])
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.05, 0.1]))

    def factors(keys: PoseKeys) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for time_s in seen_s:
            at = keys.time_s[keys.contact(time_s)]
            here, ahead = true_m(at - 0.3), true_m(at + 0.3)
            pose = gtsam.Pose2(*(0.5 * (here + ahead)), np.arctan2(*(ahead - here)[::-1]))
            graph.push_back(
                gtsam.BearingRangeFactor2D(keys.key(time_s), LANDMARK, pose.bearing(place), pose.range(place), noise)
            )
            guess = keys.estimate(time_s).transformFrom(pose.transformTo(place))
        values.insert(LANDMARK, guess)
        return graph, values

    alone, tied = pdr.smooth(WALK), pdr.smooth(WALK, factors=factors)
    np.testing.assert_allclose(tied.values.atPoint2(LANDMARK), place, atol=1.5)
    assert np.trace(tied.track.position_cov_m2[-1]) < 0.7 * np.trace(alone.track.position_cov_m2[-1])


def one(factor: Any) -> gtsam.NonlinearFactorGraph:
    """A graph of one factor."""
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor)
    return graph


def valued(key: int) -> gtsam.Values:
    """The value of one unknown."""
    values = gtsam.Values()
    values.insert(key, gtsam.Pose2())
    return values


UNIT = gtsam.noiseModel.Unit.Create(2)
RANGE = gtsam.noiseModel.Unit.Create(1)


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        (lambda keys: [], "must return a gtsam.NonlinearFactorGraph"),
        (lambda keys: one(gtsam.PoseTranslationPrior2D(gtsam.symbol("x", 900), gtsam.Pose2(), UNIT)), "the pose x900"),
        (lambda keys: one(gtsam.RangeFactor2D(keys.key(5.0), LANDMARK, 3.0, RANGE)), "l0 without a value"),
        (lambda keys: (gtsam.NonlinearFactorGraph(), valued(keys.key(5.0))), "the unknown x.*belong to the walk"),
        (lambda keys: (gtsam.NonlinearFactorGraph(), valued(gtsam.symbol("s", 0))), "the unknown s0.*another letter"),
    ],
)
def test_factors_that_cannot_be_used_are_refused(factors: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pdr.smooth(WALK, factors=factors)
