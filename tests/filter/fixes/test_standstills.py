"""Stated standstills that clear steps contradict, and those with single false steps."""

import math

import numpy as np
import pytest
from helpers import nees_of, streamed

import pdr_filter as pdr
from pdr_filter.filter.pedestrian.fix_history import STANDSTILL_LOG_EVIDENCE, StandstillSteps
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

STEP_LOG_RATIO = math.log(110 / 16)  # rates of detections per minute in walking and in standing
STATED = pdr.Standstill(15.0, 35.0)


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate([Leg("walking", distance_m=30.0), Leg("walking", distance_m=30.0, turn_rad=np.pi / 2)], seed=3)


def counted(times_s: np.ndarray, moving_prob: float = 1.0) -> StandstillSteps:
    found, last_s = StandstillSteps(), 0.0
    for time_s in times_s.tolist():
        found, last_s = found.plus(time_s, time_s - last_s, moving_prob, STEP_LOG_RATIO), time_s
    return found


@pytest.mark.parametrize("weighting", ["imm", "wc", "hc"])
def test_clear_steps_in_a_stated_standstill_are_counted_in_a_note_and_the_deviation_covers_the_walk(
    walk: Recording, weighting: str
) -> None:
    for function in (pdr.track, pdr.smooth):
        track, free = (function(walk, fixes=fixes, weighting=weighting) for fixes in ([STATED], []))
        track, free = (t.track if isinstance(t, pdr.Smoothed) else t for t in (track, free))
        inside = (free.time_s > 15.0) & (free.time_s < 35.0)
        (note,) = (n for n in track.notes if "standstill" in n)
        assert int(note.split()[0]) == pytest.approx(inside.sum(), abs=2)
        assert track.step_length_m[inside].sum() < 0.1 * free.step_length_m[inside].sum()
        after = free.time_s > 35.0
        error_m = (free.position_m - track.position_m)[after]
        assert np.linalg.norm(error_m, axis=1).min() > 15.0
        assert nees_of(error_m, track.position_cov_m2[after]).max() < 4.0
        # the track as stated is as probable: the deviation is not much larger than the distance of the two answers
        assert track.position_std_m[-1] < 1.3 * np.linalg.norm(error_m[-1]) + free.position_std_m[-1]


def test_a_position_after_a_contradicted_standstill_brings_the_track_back(walk: Recording) -> None:
    free = pdr.track(walk)
    at = int(np.searchsorted(free.time_s, 40.0))
    fix = pdr.PositionFix(float(free.time_s[at]), free.position_m[at], np.eye(2))
    for track in (pdr.track(walk, fixes=[STATED, fix]), pdr.smooth(walk, fixes=[STATED, fix]).track):
        assert next(f for f in track.fixes if f.kind == "position").outcome == "used"
        assert np.linalg.norm(track.end_position_m - free.end_position_m) < 4.0


def test_a_short_wrong_standstill_changes_no_deviation(walk: Recording) -> None:
    track, free = (pdr.track(walk, fixes=fixes) for fixes in ([pdr.Standstill(15.0, 17.0)], []))
    assert not any("standstill" in note for note in track.notes)
    assert track.position_std_m[-1] < 1.05 * free.position_std_m[-1]


def test_a_resumed_filter_counts_the_same_steps_in_any_blocks(walk: Recording) -> None:
    whole = pdr.track(walk, fixes=[STATED])
    online, updates = streamed(walk, pdr.recipes.default(walk.subject), [STATED], seed=2, n_resumed=6)
    np.testing.assert_array_equal([u.position_cov_m2 for u in updates], whole.position_cov_m2)
    assert [n for n in online.notes if "standstill" in n] == [n for n in whole.notes if "standstill" in n]


def test_regular_steps_contradict_once_their_evidence_outweighs_the_statement() -> None:
    interval_s = 0.5
    gain = STEP_LOG_RATIO - (110 - 16) / 60 * interval_s
    # the first step has no earlier one, and each later one adds the gain
    n_needed = 1 + math.floor((STANDSTILL_LOG_EVIDENCE - STEP_LOG_RATIO) / gain) + 1
    times_s = interval_s * np.arange(1, 60)
    assert counted(times_s[: n_needed - 1]).n_contradicting == 0.0
    found = counted(times_s[:n_needed])
    assert (found.n_contradicting, found.first_s, found.last_s) == (n_needed, 0.5, times_s[n_needed - 1])
    assert counted(times_s).n_contradicting == len(times_s)
    # steps that the context classifier takes for standing are no evidence
    assert counted(times_s, moving_prob=0.1).n_contradicting == 0.0


def test_false_steps_at_their_usual_rate_never_contradict_a_long_standstill() -> None:
    times_s = np.cumsum(np.random.default_rng(0).exponential(60 / 16, 2000))  # two hours
    assert counted(times_s).n_contradicting == 0.0
    assert counted(np.array([100.0, 100.5, 101.0])).n_contradicting == 0.0
