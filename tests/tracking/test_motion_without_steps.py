"""Bouts of one to three steps, which are not detected, make the position less certain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers import nees_of, push_part, true_position_m

import pdr_filter as pdr
from pdr_filter.simulate import Gait, Leg, simulate


def bouts(seed: int, *, lines: bool) -> pdr.Recording:
    """A walk up and down a small room, of which many steps are not detected, between two straight lines or alone."""
    rng = np.random.default_rng(2000 + seed)
    line = [Leg("walking", distance_m=6.0)] * lines
    legs = [Leg("stationary", duration_s=4.0), *line]
    for _ in range(14):
        turn_rad = float(rng.choice([1, -1]) * rng.uniform(2.4, 3.14))
        legs.append(Leg("walking", distance_m=float(rng.uniform(0.8, 1.6)), turn_rad=turn_rad))
    return simulate([*legs, *line], Gait(height_m=1.6 + 0.05 * (seed % 7)), seed=seed)


def ranges(walk: pdr.Recording, seed: int) -> list[pdr.RangeFix]:
    """Ranges of 0.3 m to three corners of the room, each second."""
    rng, truth = np.random.default_rng(seed), walk.truth.position
    low, high = (f(np.stack([truth.east_m, truth.north_m]), axis=1) for f in (np.min, np.max))
    corners = [low - 0.5, high + 0.5, np.array([high[0] + 0.5, low[1] - 0.5])]
    fixes: list[pdr.RangeFix] = []
    for time_s in np.arange(5.0, walk.duration_s - 2.0):
        for k, corner in enumerate(corners):
            at_s = float(time_s + 0.01 * k)
            range_m = float(np.hypot(*(true_position_m(walk, at_s) - corner)) + rng.normal(0.0, 0.3))
            fixes.append(pdr.RangeFix(at_s, corner, max(range_m, 0.0), 0.3))
    return fixes


def normalised_squares(walk: pdr.Recording, track: pdr.Track) -> np.ndarray:
    error_m = track.position_m - true_position_m(walk, track.time_s)
    return nees_of(error_m, track.position_cov_m2 + 1e-9 * np.eye(2))


def test_ranges_in_a_small_room_are_used_although_steps_are_missed_and_the_errors_fit_the_covariance() -> None:
    squares, outcomes = [], []
    for seed, lines in ((1, True), (7, True), (0, False), (1, False), (2, False), (5, False)):
        walk = bouts(seed, lines=lines)
        track = pdr.track(walk, fixes=ranges(walk, seed))
        squares.append(normalised_squares(walk, track).mean())
        outcomes += [fix.outcome for fix in track.fixes]
    assert np.mean(squares) < 3.0  # 2 is right; 20 without the variance of motion without steps
    # 1 % is right; 11 % if ranges of the first seconds of a bout do not wait for its steps
    assert outcomes.count("rejected") <= 0.025 * len(outcomes)


def pushed(walk: pdr.Recording, fixes: list[pdr.RangeFix], longest: int) -> list[pdr.StepUpdate]:
    """Steps of an online filter that receives blocks of 1 to `longest` samples."""
    samples, online, rng, begin = pdr.merge_streams(walk), pdr.OnlineFilter(), np.random.default_rng(3), 0
    rows: list[pdr.StepUpdate] = []
    while begin < len(samples.time_s):
        part = slice(begin, begin + int(rng.integers(1, longest)))
        while fixes and fixes[0].time_s <= samples.time_s[part][-1]:
            online.add_fix(fixes.pop(0))
        rows += push_part(online, samples, part)
        begin = part.stop
    return [*rows, *online.finish()]


def test_motion_without_steps_is_the_same_in_any_blocks() -> None:
    walk = replace(bouts(7, lines=True), magnetometer=None)
    track = pdr.track(walk, fixes=ranges(walk, 7))
    assert (np.asarray(track.steps.stepless_s) > 2.0).any()
    short, long = (pushed(walk, ranges(walk, 7), n) for n in (30, 3000))
    np.testing.assert_array_equal([row.step.stepless_s for row in short], track.steps.stepless_s)
    np.testing.assert_array_equal([r.position_cov_m2 for r in short], [r.position_cov_m2 for r in long])
