"""Shift of the clock of fixes and locations: estimate, odds, uncertainty, and the smoothed walk with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import true_positions
from scipy.stats import norm
from true_positions import HERE, position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.offline.smoothing import smooth as smoothing
from pdr_filter.offline.smoothing.clock_shift import ClockShift, ShiftedWalk, ShiftPrior, estimated_shift
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.solve import response, solve, sum_of_squares
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import HeadingFix, PositionFix, Samples
from pdr_filter.values.recording import Truth

pytestmark = pytest.mark.usefixtures("sensing_once")

STD_M = 3.0
PRIOR = ShiftPrior(0.02)
R = np.pi / 2


@cache
def walk(*turns: float, leg_m: float = 45.0) -> pdr.Recording:
    """Return a simulated walk of legs with these turns between them."""
    legs = [Leg("stationary", duration_s=5.0), *(Leg("walking", distance_m=leg_m, turn_rad=t) for t in (0.0, *turns))]
    return replace(simulate(legs, seed=7, name="walk"), magnetometer=None)


def times(recording: pdr.Recording) -> np.ndarray:
    """Return every tenth second of a walk."""
    return np.arange(1.0, recording.duration_s - 1.0, 10.0)


def errors(recording: pdr.Recording) -> np.ndarray:
    return np.random.default_rng(5).normal(0.0, STD_M, (len(times(recording)), 2))


def located(recording: pdr.Recording, late_s: float) -> pdr.Recording:
    found = true_positions.located(recording, times(recording), off_m=errors(recording))
    return replace(found, location=Samples(found.location.time_s + late_s, found.location.values))


def fixes(recording: pdr.Recording, late_s: float) -> list[PositionFix]:
    place_m = true_m(recording, times(recording)) + errors(recording)
    return position_fixes(times(recording) + late_s, place_m, STD_M)


# --- posterior of a shift ---------------------------------------------------------------------------------------------


def parabola(best_s: float, information: float) -> ShiftedWalk:
    """Return a walk at shift zero whose sum of squares has its minimum, zero, at `best_s`."""
    return ShiftedWalk(information * best_s**2, -information * best_s, information)


def shift_of(best_s: float, information: float) -> ClockShift:
    return estimated_shift(lambda late_s: parabola(best_s - late_s, information), PRIOR)


@pytest.mark.parametrize(("best_s", "information"), [(18.0, 0.3), (-10.0, 0.5), (5.0, 0.3), (0.5, 2e-4)])
def test_shift_and_its_error_are_those_of_numerical_integration(best_s: float, information: float) -> None:
    late_s = np.linspace(-100.0, 100.0, 200_001)
    weight = (
        0.02
        * norm.pdf(late_s, scale=10.0)
        * np.exp(-0.5 * information * (late_s - best_s) ** 2)
        * (late_s[1] - late_s[0])
    )
    none = 0.98 * np.exp(-0.5 * information * best_s**2)
    mean_s = float(weight @ late_s / weight.sum())
    found = shift_of(best_s, information)
    if weight.sum() > 100.0 * none:
        assert found.late_s == pytest.approx(mean_s, rel=1e-3)
        assert found.var_s2 == pytest.approx(float(weight @ (late_s - mean_s) ** 2 / weight.sum()), rel=1e-3)
    else:
        assert found.late_s == 0.0
        assert found.var_s2 == pytest.approx(float(weight @ late_s**2 / (weight.sum() + none)), rel=0.05)


def test_a_walk_that_excludes_a_shift_has_none_and_no_error() -> None:
    assert shift_of(0.7, 0.5) == ClockShift(0.0, 0.0)
    below_a_second = shift_of(0.9, 30.0)
    assert below_a_second.late_s == 0.0 and below_a_second.var_s2 == pytest.approx(0.9**2 + 1.0 / 30.0, rel=0.05)
    assert shift_of(0.0, 0.0).late_s == 0.0


def test_a_misfit_that_is_lower_far_away_than_its_parabola_at_zero_does_not_exclude_a_shift() -> None:
    level = estimated_shift(lambda late_s: ShiftedWalk(0.0, 0.0, 0.1 * (late_s == 0.0)), PRIOR)
    steep = estimated_shift(lambda late_s: parabola(0.0 - late_s, 0.1), PRIOR)
    # above 5 s, the evidence is that of the other shifts
    assert level.var_s2 > 0.7 * 0.02 * 10.0**2 > 10.0 * steep.var_s2


def test_a_sharp_minimum_at_zero_does_not_hide_another_one_of_the_same_depth() -> None:
    found = estimated_shift(lambda late_s: parabola((0.0 if late_s < 5.0 else 10.0) - late_s, 1.0), ShiftPrior(0.05))
    # the prior at one deviation times the width of the minimum, against the prior of zero
    odds = 0.05 * norm.pdf(10.0, scale=10.0) * np.sqrt(2.0 * np.pi) / 0.95
    assert found.var_s2 == pytest.approx(odds * 10.0**2, rel=0.2)


def test_observations_outside_the_samples_show_another_clock_but_a_much_older_one_does_not() -> None:
    fixes = [PositionFix(t, (0.0, 0.0), 9.0 * np.eye(2)) for t in np.arange(-6.0, 95.0, 10.0)]
    found, inside = ShiftPrior.of("locations", fixes, 0.0, 100.0), ShiftPrior.of("locations", fixes[1:], 0.0, 100.0)
    # on the right clock it is within walking distance of the start
    assert found.prob / (1.0 - found.prob) == pytest.approx(1.0 + (1.4 * 6.0) ** 2 / 9.0)
    assert found.most_s == -5.0 and np.max(found.mean_s) < -5.0
    assert inside.prob == PRIOR.prob and inside.least_s < 0.0 < inside.most_s
    older = PositionFix(-60.0, (0.0, 0.0), np.eye(2))
    assert ShiftPrior.of("locations", [older, *fixes[1:]], 0.0, 100.0).most_s == inside.most_s


@pytest.mark.parametrize(("late_s", "is_named"), [(7.0, False), (9.0, True), (-9.0, True)])
def test_a_shift_that_is_more_probable_than_none_and_not_certain_is_named_and_not_applied(
    late_s: float, is_named: bool
) -> None:
    found = shift_of(late_s, 0.15)
    assert found.late_s == 0.0 and found.var_s2 > 0.0
    # its posterior mean: the information against that of the prior of 10 s
    words = f"{8.4375:.1f} s {'late' if late_s > 0 else 'early'}"
    assert found.probable_s == (pytest.approx(late_s * 0.15 / (0.15 + 0.01)) if is_named else 0.0)
    assert [words in note and "were not shifted" in note for note in found.notes("fixes")] == [True] * is_named


def test_the_response_to_moved_fixes_is_the_difference_of_two_solutions(monkeypatch: pytest.MonkeyPatch) -> None:
    problems = []
    monkeypatch.setattr(smoothing, "solve", lambda problem, *_: problems.append(problem) or solve(problem))
    pdr.smooth(located(walk(R, R), 0.0))
    problem, found = problems[0], solve(problems[0])
    moved_m = np.random.default_rng(2).normal(size=problem.positions.position_m.shape)
    follows, slope, information = response(problem, found, moved_m)
    squares, means = [], []
    for factor in (-1e-2, 1e-2):
        positions = replace(problem.positions, position_m=problem.positions.position_m + factor * moved_m)
        moved = replace(problem, positions=positions)
        squares.append(sum_of_squares(moved, solve(moved)))
        means.append(solve(moved).mean)
    np.testing.assert_allclose((means[1] - means[0]) / 2e-2, follows, atol=0.02 * np.abs(follows).max())
    assert (squares[1] - squares[0]) / 2e-2 == pytest.approx(2.0 * slope, rel=0.02, abs=0.05)
    assert sum(squares) - 2.0 * sum_of_squares(problem, found) == pytest.approx(2e-4 * information, rel=0.1)


# --- smoothed walks ---------------------------------------------------------------------------------------------------


@cache
def smoothed(late_s: float) -> pdr.Smoothed:
    return pdr.smooth(located(walk(R, R, -R), late_s))


@pytest.mark.parametrize(("source", "late_s"), [("locations", 18.0), ("fixes", -12.0)])
def test_late_observations_are_named_and_give_the_walk_of_the_right_clock(source: str, late_s: float) -> None:
    if source == "fixes":
        right, late = (pdr.smooth(walk(R, R, -R), fixes=fixes(walk(R, R, -R), d)) for d in (0.0, late_s))
    else:
        right, late = smoothed(0.0), smoothed(late_s)
    notes = [n for n in late.notes if n.startswith(f"the {source} are ")]
    assert len(notes) == 1
    assert (" late " if late_s > 0 else " early ") in notes[0]
    assert not [n for n in right.notes if "on the clock of the samples" in n]
    stated_s = float(notes[0].split(" are ")[1].split(" s ")[0])
    std_s = float(notes[0].split("± ")[1].split(" s)")[0])
    assert std_s < 3.0
    assert abs(stated_s - abs(late_s)) < 3.0 * std_s
    assert late.track.distance_m == pytest.approx(right.track.distance_m, rel=0.01)
    away_m = np.linalg.norm(late.track.position_m - right.track.position_m, axis=1)
    assert (away_m < 3.0 * late.track.position_std_m).all()
    assert away_m.max() < 6.0
    np.testing.assert_array_equal(np.diff(late.observations.time_s), np.diff(right.observations.time_s))


def test_a_right_clock_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    found = smoothed(0.0).track
    monkeypatch.setattr(smoothing, "estimated_shift", lambda *_: ClockShift())
    fixed = pdr.smooth(located(walk(R, R, -R), 0.0)).track
    np.testing.assert_array_equal(found.position_m, fixed.position_m)
    np.testing.assert_array_equal(found.position_cov_m2, fixed.position_cov_m2)


def test_without_turns_the_deviation_along_the_walk_is_wider(monkeypatch: pytest.MonkeyPatch) -> None:
    straight = walk(leg_m=70.0)
    given = [fix for fix in fixes(straight, 0.0) if 15.0 < fix.time_s < 45.0]
    found = pdr.smooth(straight, fixes=given)
    monkeypatch.setattr(smoothing, "estimated_shift", lambda *_: ClockShift())
    fixed = pdr.smooth(straight, fixes=given)
    ahead = fixed.track.position_m[40] - fixed.track.position_m[20]
    along = ahead / np.linalg.norm(ahead)
    across = np.array([-along[1], along[0]])
    wider_m2 = found.track.position_cov_m2[30] - fixed.track.position_cov_m2[30]
    assert not [n for n in found.notes if "were shifted" in n]
    assert 1.0 < along @ wider_m2 @ along < 20.0
    assert across @ wider_m2 @ across < 0.2


def test_late_fixes_that_a_small_square_hides_are_named_and_widen_its_positions() -> None:
    square = simulate([Leg("walking", distance_m=20.0, turn_rad=R)] * 4)
    at_s = np.arange(4.0, 50.0, 5.0)
    place_m = true_m(square, at_s) + np.random.default_rng(0).normal(0.0, STD_M, (len(at_s), 2))
    right, late = (pdr.smooth(square, fixes=position_fixes(at_s + d, place_m, STD_M)) for d in (0.0, 8.0))
    assert not [n for n in right.notes if "clock" in n]
    assert [n for n in late.notes if n.startswith("the fixes are perhaps ") and "were not shifted" in n]
    assert late.track.position_std_m[-1] > 2.0 * right.track.position_std_m[-1]


def test_fixes_have_another_clock_more_often_than_locations_of_the_phone() -> None:
    given = [PositionFix(t, (0.0, 0.0), np.eye(2)) for t in (10.0, 20.0, 30.0)]
    fixes, locations = (ShiftPrior.of(source, given, 0.0, 40.0) for source in ("fixes", "locations"))
    assert fixes.prob == 5.0 * locations.prob


def test_locations_from_outside_the_samples_show_another_clock_without_turns() -> None:
    straight = walk()
    right, *others = (pdr.smooth(located(straight, late_s)).track for late_s in (0.0, 18.0, -18.0))
    for other, word in zip(others, (" late ", " early "), strict=True):
        assert [n for n in other.notes if n.startswith("the locations are ") and word in n]
        places_m = [HERE.east_north_m(t.latitude_deg, t.longitude_deg) for t in (right, other)]
        assert (np.linalg.norm(places_m[1] - places_m[0], axis=1) < 3.0 * other.position_std_m).all()
    # locations from the first to the last sample exclude another clock
    assert right.position_std_m.max() < 5.0


def test_walks_aligned_to_late_locations_are_where_they_were() -> None:
    right, late = (pdr.smooth(located(walk(R, R, -R), d), gnss="align").track for d in (0.0, 18.0))
    assert any("the locations are" in n and "were shifted" in n for n in late.notes)
    places_m = [HERE.east_north_m(t.latitude_deg, t.longitude_deg) for t in (right, late)]
    assert np.linalg.norm(places_m[1] - places_m[0], axis=1).max() < 6.0


def test_a_shift_moves_all_fixes_of_its_source_alone() -> None:
    position, heading = PositionFix(3.0, (0.0, 0.0), np.eye(2)), HeadingFix(4.0, 0.1, 0.2)
    given = Observations(fixes=(position, heading), locations=(position,))
    earlier = given.earlier("fixes", 2.0)
    assert [f.time_s for f in earlier.fixes] == [1.0, 2.0]
    assert earlier.locations is given.locations


def test_a_rest_reveals_late_fixes_that_lie_outside_the_samples() -> None:
    rested = simulate([Leg("walking", distance_m=60.0), Leg("stationary", duration_s=20.0)])
    track = pdr.track(rested)
    for seed in range(3):
        at_s = np.arange(1.0, rested.duration_s - 0.5)
        place_m = np.column_stack([np.interp(at_s, track.time_s, axis) for axis in track.position_m.T])
        place_m += np.random.default_rng(seed).normal(size=place_m.shape)
        found = pdr.smooth(replace(rested, truth=Truth()), fixes=position_fixes(at_s + 18.0, place_m, 1.0)).track
        assert np.linalg.norm(found.position_m - track.position_m, axis=1).max() < 3.0
