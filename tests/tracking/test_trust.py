from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import true_position_m, windows_of

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.step_statistics import UNFAMILIAR
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.trust_report import doubts, problems, sentence
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FixResult, PositionFix, Samples, read_only
from pdr_filter.values.recording import Recording

WALKING, STATIONARY = CONTEXTS.index("walking"), CONTEXTS.index("stationary")


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate([Leg("walking", distance_m=60.0)], seed=1)


@pytest.fixture(scope="module")
def track(walk: Recording) -> Track:
    return pdr.track(walk)


def test_an_ordinary_walk_has_no_doubts(track: Track) -> None:
    assert doubts(track) == []
    assert track.report().startswith(f"simulated_walk: {track.distance_m:.1f} m in 42 s, {track.n_steps} steps")
    assert f"± {track.position_std_m[-1]:.1f} m (one standard deviation, worst direction)" in track.report()


def test_a_phone_on_a_table_is_reported_as_not_moving() -> None:
    time_s = np.arange(3000) / 100
    rng = np.random.default_rng(0)
    still = Recording(
        "table",
        Samples(time_s, rng.normal([0, 0, 9.81], 0.01, (3000, 3))),
        Samples(time_s, rng.normal(0.0, 0.002, (3000, 3))),
    )
    [told] = doubts(pdr.track(still))
    assert "did not move" in told


def test_a_ride_without_steps_is_reported_with_its_times(track: Track) -> None:
    stepped = track.time_s < 18.0
    names = ("time_s", "position_m", "position_cov_m2", "mode_prob", "context_prob", "step_length_m", "steps")
    riding = replace(track, **{name: getattr(track, name)[stepped] for name in names})
    [told] = doubts(riding)
    assert "as in a vehicle" in told
    begin, end = (float(t) for t in told.removeprefix("From ").split(" s ")[0].split(" to "))
    assert begin == pytest.approx(22.0, abs=1.5)
    assert end == pytest.approx(float(track.windows.time_s[-1]), abs=1.0)


def test_time_with_motion_but_no_steps_does_not_count_as_walking(track: Track) -> None:
    nobody = replace(track, time_s=track.time_s[:0])
    moving_s = sum(s for name, s in track.context_seconds().items() if name != "stationary")
    assert moving_s > 30 and track.seconds_without_steps < 3
    assert sum(s for name, s in nobody.context_seconds().items() if name != "stationary") == 0.0
    assert nobody.seconds_without_steps == pytest.approx(moving_s + track.seconds_without_steps)
    assert nobody.context_seconds()["stationary"] == track.context_seconds()["stationary"]


@pytest.mark.parametrize(("field", "words"), [("irregular_prob", "phone was handled"), ("unknown_share", "unlike all")])
@pytest.mark.parametrize(("from_s", "to_s", "is_told"), [(10.0, 20.0, True), (10.0, 17.0, True), (10.0, 13.5, False)])
def test_a_stretch_of_unreliable_windows_is_reported_from_five_seconds_on(
    track: Track, field: str, words: str, from_s: float, to_s: float, is_told: bool
) -> None:
    odd = (track.windows.time_s > from_s) & (track.windows.time_s < to_s)
    told = [d for d in doubts(with_windows(track, **{field: odd.astype(float)})) if words in d]
    assert [d.startswith(f"From 11 to {to_s - 1:.0f} s") for d in told] == [True] * is_told


def with_windows(track: Track, **columns: object) -> Track:
    return replace(track, windows=replace(track.windows, **{name: read_only(v) for name, v in columns.items()}))


def with_steps(track: Track, **columns: object) -> Track:
    steps = track.steps.copy()
    for name, values in columns.items():
        steps[name] = values
    return replace(track, steps=steps)


@pytest.mark.parametrize(
    ("mode", "turn_rate_radps", "is_reported"), [("calling", 0.5, True), ("calling", 0.3, False), ("bag", 0.5, False)]
)
def test_a_phone_at_the_ear_is_reported_in_curves_only(
    track: Track, mode: str, turn_rate_radps: float, is_reported: bool
) -> None:
    prob = np.tile(np.where(np.array(CARRYING_MODES) == mode, 0.9, 0.025), (len(track.windows), 1))
    told = doubts(with_steps(with_windows(track, carrying_prob=prob), turn_rate_radps=turn_rate_radps))
    assert len(told) == any("the head turns against the body" in sentence for sentence in told) == is_reported


def test_strides_that_disagree_are_reported_only_after_the_phone_was_moved(track: Track) -> None:
    assert doubts(with_steps(track, direction_trust=0.1)) == []
    moved_s = np.where(track.time_s < 20.0, 2.0, 20.0)
    [told] = doubts(with_steps(track, direction_trust=0.1, carried_since_s=moved_s))
    assert "the phone was moved to another place where strides do not agree" in told
    assert float(told.removeprefix("From ").split(" to ")[0]) == pytest.approx(20.0, abs=1.0)
    assert doubts(with_steps(track, direction_trust=0.3, carried_since_s=moved_s)) == []


@pytest.mark.parametrize(("unknown_share", "climb_rate_mps", "is_told"), [(1, np.nan, 1), (1, 0.0, 0), (0, np.nan, 0)])
def test_undetectable_stairs_are_told_beside_the_contexts_and_are_no_warning(
    track: Track, unknown_share: float, climb_rate_mps: float, is_told: bool
) -> None:
    n = len(track.windows)
    walk = with_windows(
        track, stairs_unknown_share=np.full(n, unknown_share), climb_rate_mps=np.full(n, climb_rate_mps)
    )
    assert problems(walk) == [sentence(note) for note in walk.notes]
    assert ("stairs: any would count as level walking" in walk.report()) == is_told


def stairs_line(track: Track, climb_rate_mps: np.ndarray, context: str = "walking") -> str:
    """Return the line of the report on stairs of windows that are unlike the stairs of the training data."""
    n = len(track.windows)
    prob = np.tile(np.array([name == context for name in track.windows.contexts], dtype=float), (n, 1))
    walk = with_windows(track, stairs_unknown_share=np.ones(n), climb_rate_mps=climb_rate_mps, context_prob=prob)
    lines = walk.report().split("\n")
    return next((line for line in lines if line.startswith("stairs:")), "")


def test_stairs_of_a_recording_with_a_barometer_are_told_only_in_gaps_of_the_pressure(track: Track) -> None:
    n = len(track.windows)
    assert "because there is no barometer" in stairs_line(track, np.full(n, np.nan))
    scattered = np.where(np.arange(n) % 5 == 0, np.nan, 0.0)
    assert stairs_line(track, scattered) == ""
    stopped = np.where(np.arange(n) < n // 2, 0.0, np.nan)
    line = stairs_line(track, stopped)
    assert f"in {n - n // 2} of {n} windows, because pressure is missing there" in line
    assert "no barometer" not in line


def test_running_is_not_counted_among_the_stairs_that_look_like_level_walking(track: Track) -> None:
    assert stairs_line(track, np.full(len(track.windows), np.nan), "running") == ""


def test_the_report_of_the_demo_walk_in_a_trouser_pocket_has_no_doubts_about_stairs() -> None:
    assert "stairs:" not in pdr.track(pdr.simulate.demo_walk()).report()


def test_modes_of_an_undecided_stretch_are_named(track: Track) -> None:
    prob = np.array(track.mode_prob)
    middle = (track.time_s > 12.0) & (track.time_s < 24.0)
    prob[middle] = 0.0
    prob[middle, WALKING], prob[middle, CONTEXTS.index("upstairs")] = 0.55, 0.45
    [told] = doubts(replace(track, mode_prob=prob))
    assert "cannot decide between walking and upstairs" in told


def test_the_exponential_of_the_entropy_is_the_effective_number_of_modes(track: Track) -> None:
    prob = np.zeros((3, 6))
    prob[0, 1], prob[1, :2], prob[2] = 1.0, 0.5, 1 / 6
    found = replace(track, mode_prob=prob)
    np.testing.assert_allclose(found.effective_modes, [1.0, 2.0, 6.0])
    np.testing.assert_allclose(found.mode_entropy, np.log([1.0, 2.0, 6.0]))


def test_fixes_are_reported_with_their_innovations_and_rejected_ones_with_their_times(walk: Recording) -> None:
    fixes = [PositionFix(t, true_position_m(walk, t), 4.0 * np.eye(2)) for t in (10.0, 20.0, 30.0)]
    wild = PositionFix(25.0, np.array([500.0, 500.0]), np.eye(2))
    track = pdr.track(walk, fixes=[*fixes, wild])
    assert [f.accepted for f in track.fixes] == [True, True, False, True]
    assert track.fixes[2].nis > 1000
    assert all(f.nis < 6 for f in track.fixes if f.accepted)
    assert all(f.used_s >= f.time_s for f in track.fixes)
    [told] = doubts(track)
    assert told == "1 of 4 fixes do not fit the track or its time and were not used: at 25 s."
    assert "fixes: 3 used" in track.report()


def test_a_missing_gyroscope_is_reported_as_unknown_direction(walk: Recording) -> None:
    assert any("no angular rate" in d for d in doubts(pdr.track(replace(walk, gyroscope=None))))


def test_a_long_time_between_two_steps_is_reported(track: Track) -> None:
    later = np.where(np.arange(track.n_steps) < 50, 0.0, 90.0)
    told = doubts(replace(track, time_s=track.time_s + later))
    gap_s = float(track.time_s[50] - track.time_s[49]) + 90.0
    assert any(f"there are no steps for {gap_s:.0f} s" in line for line in told)
    assert not any("there are no steps for" in line for line in doubts(track))


def test_the_track_of_a_recording_without_usable_samples_starts_at_zero_with_no_duration() -> None:
    nothing = Recording("empty", Samples(np.arange(300) / 100, np.full((300, 3), np.nan)))
    track = pdr.track(nothing)
    assert (track.start_time_s, track.duration_s, track.n_steps) == (0.0, 0.0, 0)


@pytest.mark.parametrize(("n", "end"), [(1, "to 5 s"), (2, "and from 12 to 17 s"), (12, "and 4 times more")])
def test_one_sentence_has_all_times_of_a_problem(track: Track, n: int, end: str) -> None:
    time_s = np.arange(144.0)
    windows = windows_of(time_s, np.tile(np.eye(len(CONTEXTS))[STATIONARY], (144, 1)))
    strange = (time_s % 12 < 6) & (time_s < 12 * n)
    doubted = replace(track, windows=replace(windows, unknown_share=strange.astype(float)))
    [told] = doubts(doubted)
    assert told.startswith("From 0 to 5 s")
    assert told.split(" the motion is unlike")[0].endswith(end)


def test_a_problem_is_reported_once_with_its_times_and_other_notes_are_kept(track: Track) -> None:
    time_s = track.windows.time_s
    unlike = with_windows(track, unknown_share=((time_s > 10.0) & (time_s < 20.0)).astype(float))
    counted, other = f"in 9 of {len(time_s)} windows {UNFAMILIAR}", "the clock was set back once"
    said = problems(replace(unlike, notes=(counted, other)))
    assert said == [f"From 11 to 19 s {UNFAMILIAR}.", "The clock was set back once."]
    assert problems(replace(track, notes=(counted,))) == [sentence(counted)]  # too short a stretch to have a time


def test_a_note_with_a_full_stop_gets_no_second_one(track: Track) -> None:
    told = replace(track, notes=("read as it was.", "one more")).report()
    assert told.endswith("- Read as it was.\n- One more.")


def test_a_gap_in_the_samples_counts_for_no_context(track: Track) -> None:
    time_s = np.array([1.0, 2.0, 3.0, 1003.0, 1004.0])
    windows = windows_of(time_s, np.tile(np.eye(len(CONTEXTS))[STATIONARY], (5, 1)))
    still = replace(track, windows=windows, start_time_s=0.0)
    assert still.context_seconds()["stationary"] == 1.0 + 1.0 + 1.0 + 2.0 + 1.0  # a window is of two seconds


@pytest.mark.parametrize(("soft_of_three", "told"), [(1, False), (2, True)])
def test_a_stretch_is_quick_and_soft_where_most_of_its_steps_are(track: Track, soft_of_three: int, told: bool) -> None:
    steps = track.steps.copy()
    soft = np.arange(track.n_steps) % 3 < soft_of_three
    steps.frequency_hz[:], steps.vertical_amplitude_mps2[:] = np.where(soft, 3.0, 1.8), 1.0
    found = replace(track, steps=steps).is_quick_and_soft
    assert (found[10:-10] == told).all()  # the ends stand for the steps that are not there


@pytest.mark.parametrize(("jump_m", "n_told"), [(2.0, 0), (5.0, 1), (1e300, 0), (np.inf, 0)])
def test_a_jump_of_a_track_without_fixes_is_reported_with_its_time(track: Track, jump_m: float, n_told: int) -> None:
    position_m = np.array(track.position_m)
    sideways = np.array([position_m[30, 1] - position_m[29, 1], position_m[29, 0] - position_m[30, 0]])
    position_m[30:] += jump_m * sideways / np.linalg.norm(sideways)  # the last two are of a table that was read
    jumped = replace(track, position_m=read_only(position_m))
    told = [sentence for sentence in doubts(jumped) if "jumps" in sentence]
    assert len(told) == n_told
    assert all(f"m at {track.time_s[30]:.0f} s" in sentence for sentence in told)
    fix = FixResult("position", 5.0, 5.0, "used", 1.0)
    assert not any("jumps" in sentence for sentence in doubts(replace(jumped, fixes=(fix,))))


@pytest.mark.parametrize(("lasting_s", "n_told"), [(15, 0), (25, 1)])
def test_a_short_movement_without_steps_is_not_reported_as_a_ride(track: Track, lasting_s: int, n_told: int) -> None:
    later_s = float(track.time_s[-1]) + 10.0 + np.arange(60.0)
    context = np.where(np.arange(60) < lasting_s, WALKING, STATIONARY)
    moved = replace(track, windows=windows_of(later_s, np.eye(len(CONTEXTS))[context]))
    assert sum("as in a vehicle" in told for told in doubts(moved)) == n_told


@pytest.mark.parametrize(("height_m", "std_m", "is_level"), [(0.8, 0.1, True), (1.2, 0.1, False), (1.2, 0.7, True)])
def test_a_height_change_above_a_metre_and_two_standard_deviations_is_significant(
    track: Track, height_m: float, std_m: float, is_level: bool
) -> None:
    none = np.zeros(track.n_steps)
    high = replace(track, height_m=none - height_m, height_std_m=none + std_m, floor=none.astype(int))
    assert high.is_level is is_level
