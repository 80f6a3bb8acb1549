"""Clocks that stand still, jump or are set back: the track clock continues, for samples, fixes and pressure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import condition, imu
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.sensing.clock import CLOCK_RESET_SAMPLES, MAX_GAP_S, AcceptedRows, ClockState, accept_rows, one_clock
from pdr_filter.sensing.conditioning import Conditioner
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import HeadingFix, ImuBlock, PositionFix, Samples, Standstill, Wifi
from pdr_filter.values.recording import Recording

YEAR_S = 3.2e7


def different_rows(time_s: np.ndarray) -> np.ndarray:
    """Rows whose values differ from row to row, as those of a sensor do."""
    return np.column_stack([time_s, np.random.default_rng(0).normal(size=(len(time_s), 3))])


def followed(time_s: np.ndarray, *more: np.ndarray) -> tuple[ClockState, np.ndarray, int]:
    """State, accepted times and backward jumps of a clock."""
    clock, parts = ClockState(), list[AcceptedRows]()
    rows = different_rows(np.concatenate([time_s, *more]))
    for part in np.split(rows, np.cumsum([len(time_s), *map(len, more)])[:-1]):
        parts.append(accept_rows(clock, part, MAX_GAP_S))
        clock = parts[-1].clock
    return clock, np.concatenate([part.rows[:, 0] for part in parts]), sum(part.n_set_backs for part in parts)


# --- sample by sample -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("back_s", [1.5, 30.0, 3600.0, YEAR_S])
@pytest.mark.parametrize("rate_hz", [50.0, 400.0])
def test_a_clock_with_repeated_times_is_followed_when_it_is_set_back(back_s: float, rate_hz: float) -> None:
    time_s = np.floor(np.arange(0.0, 20.0, 1 / rate_hz) * 50.0) / 50.0
    half = len(time_s) // 2
    time_s[half:] -= back_s
    clock, accepted_s, n_jumps = followed(time_s)
    assert n_jumps == 1
    assert (np.diff(accepted_s) > 0).all()
    assert len(np.unique(time_s)) - len(accepted_s) <= CLOCK_RESET_SAMPLES + 2
    assert clock.offset_s == pytest.approx(back_s + 0.6, abs=0.5 + 2 * CLOCK_RESET_SAMPLES / rate_hz)


def test_late_samples_neither_cause_nor_prevent_a_backward_clock_jump() -> None:
    time_s = np.arange(2000) / 100
    swapped = time_s.reshape(-1, 2)[:, ::-1].ravel()
    _, accepted_s, n_jumps = followed(swapped)
    assert n_jumps == 0
    assert len(accepted_s) == 1000
    _, accepted_s, n_jumps = followed(swapped, swapped - 7000.0)
    assert n_jumps == 1
    assert len(accepted_s) > 1950


@pytest.mark.parametrize("n_wrong", [1, 2, 20, CLOCK_RESET_SAMPLES - 1])
def test_a_few_samples_years_ahead_are_a_glitch_and_neither_a_gap_nor_a_backward_jump(n_wrong: int) -> None:
    time_s = np.arange(1000) / 100
    time_s[400 : 400 + n_wrong] += YEAR_S
    found = accept_rows(ClockState(), different_rows(time_s), MAX_GAP_S)
    assert len(found.rows) == 1000 - n_wrong
    assert found.rows[-1, 0] == time_s[-1]
    assert (found.n_dropped, found.n_glitches, found.n_set_backs, found.clock.offset_s) == (n_wrong, 1, 0, 0.0)


def test_a_night_without_samples_is_a_gap_and_no_sample_is_lost() -> None:
    time_s = np.concatenate([np.arange(500), np.arange(500) + 3_000_000]) / 100
    _, accepted_s, n_jumps = followed(time_s)
    assert n_jumps == 0
    np.testing.assert_array_equal(accepted_s, time_s)


def test_a_clock_that_stands_still_gives_a_note() -> None:
    time_s = np.concatenate([np.arange(500) / 100, np.full(400, 4.99)])
    clock, accepted_s, n_jumps = followed(time_s)
    assert (len(accepted_s), n_jumps) == (500, 0)
    assert clock.n_rejected_times == 400
    report = condition(Conditioner(), [imu(time_s)])[0].report
    assert any("no sample accepted since 5.0 s" in note for note in report.notes())


def test_a_clock_that_stands_still_in_the_past_is_not_followed() -> None:
    clock, accepted_s, n_jumps = followed(np.concatenate([np.arange(500) / 100, np.full(400, 2.0)]))
    assert (len(accepted_s), n_jumps, clock.offset_s) == (500, 0, 0.0)


@pytest.mark.parametrize("n", [10, 50, 100, 1000])
def test_a_block_that_arrives_again_is_dropped_and_is_no_backward_jump(n: int) -> None:
    rows = different_rows(np.arange(3000) / 100)
    rows[1000:, 0] -= 7.0  # a jump, whose samples arrive again too
    once = accept_rows(ClockState(), rows, MAX_GAP_S)
    clock, accepted, n_set_backs = ClockState(), list[np.ndarray](), 0
    for part in np.split(rows, range(n, 3000, n)):
        for _ in range(3):
            found = accept_rows(clock, part, MAX_GAP_S)
            clock, n_set_backs = found.clock, n_set_backs + found.n_set_backs
            accepted.append(found.rows)
    kept = np.concatenate(accepted)
    assert len(np.unique(kept[:, 1])) == len(kept) >= len(once.rows)
    np.testing.assert_array_equal(kept[:1000], once.rows[:1000])
    assert n_set_backs == 1
    assert clock.n_rejected_times < 50


def test_a_recording_with_repeated_blocks_has_the_same_track(walk: Recording) -> None:
    def doubled(stream: Samples) -> Samples:
        twice = np.concatenate([np.tile(i, 2) for i in np.split(np.arange(len(stream)), range(100, len(stream), 100))])
        return Samples(stream.time_s[twice], stream.values[twice])

    repeated = replace(walk, **{name: doubled(stream) for name, stream in walk.streams.items()})
    np.testing.assert_array_equal(pdr.track(repeated).position_m, pdr.track(walk).position_m)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9])
def test_times_in_another_unit_give_a_note(unit: float) -> None:
    report = condition(Conditioner(), [imu(np.arange(1000) / 100 * unit)])[0].report
    assert any("must be in seconds (not ms, us or ns)" in note for note in report.notes())


def test_unix_times_of_32_bits_give_a_note() -> None:
    time_s = np.float32(1.7e9 + np.arange(40_000) / 100).astype(float)
    report = condition(Conditioner(), [imu(time_s)])[0].report
    assert any("seconds since 1970 need 64 bits" in note for note in report.notes())


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 1000), cuts=st.lists(st.integers(0, 900), max_size=30))
def test_the_handling_of_clocks_does_not_depend_on_blocks(seed: int, cuts: list[int]) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.concatenate([np.arange(300), np.arange(300) - rng.integers(0, 10_000), np.arange(300, 600)]) / 100
    time_s = np.floor(time_s * 50) / 50 if seed % 2 else time_s
    time_s[rng.integers(0, 900, 6)] += rng.choice([YEAR_S, -50.0, 3.0, 0.02], 6)
    whole, accepted_s, n_jumps = followed(time_s)
    pieces = np.split(time_s, sorted(cuts))
    clock, in_pieces_s, n_in_pieces = followed(pieces[0], *pieces[1:])
    np.testing.assert_array_equal(in_pieces_s, accepted_s)
    assert (n_in_pieces, clock.offset_s) == (n_jumps, whole.offset_s)
    assert clock.n_rejected_times == whole.n_rejected_times


# --- recordings, fixes ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk() -> Recording:
    """A walk with a gyroscope of another rate and a barometer."""
    legs = [Leg("walking", distance_m=40.0), Leg("walking", distance_m=30.0, turn_rad=np.pi / 2)]
    # no step may be at the very end, because a backward clock jump shifts times by a hundredth of a second
    made = simulate([*legs, Leg("stationary", duration_s=1.0)], seed=5)
    gyroscope = made.gyroscope
    assert gyroscope is not None
    pressure_s = np.arange(0.0, made.duration_s, 0.2)
    return replace(
        made,
        gyroscope=Samples(gyroscope.time_s[::2] + 0.001, gyroscope.values[::2]),
        barometer=Samples(pressure_s, np.full((len(pressure_s), 1), 1000.0)),
    )


def set_back(walk: Recording, at_s: float, by_s: float) -> Recording:
    return replace(walk, **{n: Samples(back(s.time_s, at_s, by_s), s.values) for n, s in walk.streams.items()})


def back(time_s: np.ndarray, at_s: float, by_s: float) -> np.ndarray:
    return np.where(time_s >= at_s, time_s - by_s, time_s)


@pytest.mark.parametrize("by_s", [5.0, 30.0, 3600.0])
def test_a_recording_whose_clock_was_set_back_gives_the_same_track_and_a_note(walk: Recording, by_s: float) -> None:
    plain, broken = pdr.track(walk), pdr.track(set_back(walk, 20.0, by_s))
    np.testing.assert_allclose(broken.position_m, plain.position_m, atol=0.03)
    np.testing.assert_allclose(broken.time_s, plain.time_s, atol=1e-3)
    assert any(f"set back by {by_s:.1f} s after 20.0 s" in note for note in broken.notes)
    assert not any("set back" in note for note in plain.notes)


def test_wifi_times_follow_the_clock_of_the_samples(walk: Recording) -> None:
    time_s = np.arange(1.0, 30.0, 2.0)
    n = len(time_s)
    heard = replace(walk, wifi=Wifi(time_s, np.arange(n), np.full(n, -60.0), np.full(n, 2412.0)))
    broken = set_back(replace(heard, wifi=replace(heard.wifi, time_s=back(time_s, 20.0, 3600.0))), 20.0, 3600.0)
    followed, _ = one_clock(broken)
    assert followed.wifi is not None
    np.testing.assert_allclose(followed.wifi.time_s, time_s, atol=0.02)


def test_streams_that_were_sorted_or_begin_later_are_shifted_by_their_times(walk: Recording) -> None:
    broken = set_back(walk, 20.0, 3600.0)
    assert broken.gyroscope is not None and broken.barometer is not None
    order = np.argsort(broken.gyroscope.time_s)
    late = broken.barometer.time_s < 0
    broken = replace(
        broken,
        gyroscope=Samples(broken.gyroscope.time_s[order], broken.gyroscope.values[order]),
        barometer=Samples(broken.barometer.time_s[late], broken.barometer.values[late]),
    )
    mended, _ = one_clock(broken)
    assert mended.gyroscope is not None and mended.barometer is not None and walk.barometer is not None
    assert mended.barometer.time_s[0] == pytest.approx(20.0, abs=0.02)
    np.testing.assert_allclose(pdr.track(broken).position_m, pdr.track(walk).position_m, atol=0.03)


def test_a_recording_without_clock_jumps_is_not_changed(walk: Recording) -> None:
    fix = PositionFix(3.0, np.zeros(2), np.eye(2))
    same, fixes = one_clock(walk, [fix])
    assert same is walk
    assert fixes == (fix,)
    again, _ = one_clock(one_clock(set_back(walk, 20.0, 30.0))[0])
    assert sum("set back" in note for note in again.notes) == 1


@pytest.mark.parametrize("by_s", [5.0, 3600.0])
def test_fixes_follow_the_clock_of_a_recording(walk: Recording, by_s: float) -> None:
    plain = pdr.track(walk)
    some = range(4, plain.n_steps, 6)
    fixes = [PositionFix(float(plain.time_s[i]), plain.position_m[i], 0.25 * np.eye(2)) for i in some]
    moved = [replace(f, time_s=float(back(np.array(f.time_s), 20.0, by_s))) for f in fixes]
    known, broken = pdr.track(walk, fixes=fixes), pdr.track(set_back(walk, 20.0, by_s), fixes=moved)
    assert all(result.accepted for result in broken.fixes)
    np.testing.assert_allclose(broken.position_m, known.position_m, atol=0.02)


def test_online_fixes_pressure_and_standstills_follow_the_clock_of_the_samples(walk: Recording) -> None:
    block = pdr.merge_streams(walk)
    time_s = back(block.time_s, 20.0, 3600.0)
    online = pdr.OnlineFilter()
    late = np.searchsorted(block.time_s, 25.0)
    for part in (slice(0, late), slice(late, None)):
        samples = ImuBlock(*(getattr(block, n)[part] for n in block.__dataclass_fields__))
        online.push(time_s[part], samples.specific_force_mps2, samples.angular_rate_radps)
        if part.stop is not None:
            now_s = float(time_s[late - 1])
            online.add_fix(HeadingFix(now_s + 1.0, 0.0, 0.5))
            online.add_fix(Standstill(now_s, now_s + 0.1))
            online.push_pressure(now_s + np.arange(0.0, 6.0, 0.1), np.full(60, 1000.0))
            assert len(online.state.waiting_climbs.climbs) > 0
            assert online.state.waiting_climbs.climbs[0].time_s > 24.0
    assert not any("rejected" in note or "not used" in note for note in online.notes)
