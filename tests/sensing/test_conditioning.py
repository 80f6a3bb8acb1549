from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import assert_same_bits, condition, cut, imu, joined
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import ImuBlock, Samples
from pdr_filter.values.recording import Recording

OFFSET = np.array([1.0, -2.0, 9.8])
SLOPE = np.array([0.3, 0.1, -0.7])


def linear(time_s: np.ndarray) -> np.ndarray:
    return OFFSET + SLOPE * time_s[:, None]


def jittered_times(rng: np.random.Generator, n: int, rate_hz: float) -> np.ndarray:
    return np.cumsum(rng.uniform(0.3, 1.7, n)) / rate_hz


def area_until(time_s: np.ndarray, values: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Integral of the linear interpolant from its first sample, one column."""
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])
    left = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
    return whole[left] + 0.5 * (values[left] + np.interp(at_s, time_s, values)) * (at_s - time_s[left])


# --- closed forms ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [15.0, 50.0, 100.0, 173.0, 400.0])
@pytest.mark.parametrize("jitter", [False, True])
def test_a_linear_signal_is_resampled_exactly(rate_hz: float, jitter: bool) -> None:
    n = int(4 * rate_hz)
    time_s = 7.0 + (jittered_times(np.random.default_rng(1), n, rate_hz) if jitter else np.arange(n) / rate_hz)
    _, blocks = condition(Conditioner(), [imu(time_s, linear(time_s), linear(time_s) + 5, linear(time_s) - 3)])
    out = joined(blocks)
    assert len(out["time_s"]) > 350
    np.testing.assert_allclose(out["time_s"], time_s[0] + (np.arange(len(out["time_s"])) + 0.5) / 100, atol=1e-12)
    np.testing.assert_allclose(out["specific_force_mps2"], linear(out["time_s"]), atol=1e-9)
    np.testing.assert_allclose(out["angular_rate_radps"], linear(out["time_s"]) + 5, atol=1e-9)
    np.testing.assert_allclose(out["magnetic_field_ut"], linear(out["time_s"]) - 3, atol=1e-9)
    assert out["angular_rate_known"].all()
    assert out["magnetic_field_known"].all()


@pytest.mark.parametrize("rate_hz", [40.0, 100.0, 330.0])
def test_a_uniform_sample_is_the_mean_of_the_interpolated_signal_over_its_interval(rate_hz: float) -> None:
    rng = np.random.default_rng(3)
    time_s = jittered_times(rng, int(3 * rate_hz), rate_hz)
    force = rng.normal(size=(len(time_s), 3))
    _, blocks = condition(Conditioner(), [imu(time_s, force)])
    out = joined(blocks)
    starts, ends = out["time_s"] - 0.005, out["time_s"] + 0.005
    for axis in range(3):
        area = area_until(time_s, force[:, axis], ends) - area_until(time_s, force[:, axis], starts)
        np.testing.assert_allclose(out["specific_force_mps2"][:, axis], area / 0.01, atol=1e-9)


def test_output_comes_in_whole_hops_at_the_asked_rate() -> None:
    time_s = np.arange(437) / 100
    state, blocks = condition(Conditioner(rate_hz=50.0, hop_samples=7), [imu(time_s)])
    assert len(joined(blocks)["time_s"]) == 217  # 4.36 s are 218 samples: 31 hops of 7
    assert state.report.n_emitted == 217


def test_the_remainder_of_a_hop_comes_at_the_end_unless_no_hop_came_before() -> None:
    conditioner, time_s = Conditioner(), np.arange(455) / 100
    state, blocks = condition(conditioner, [imu(time_s, linear(time_s))])
    state, last = conditioner.finish(state)
    out = joined([*blocks, *last])
    assert (len(blocks[0].time_s), len(out["time_s"]), state.report.n_emitted) == (440, 453, 453)
    np.testing.assert_allclose(np.diff(out["time_s"]), 0.01)
    np.testing.assert_allclose(out["specific_force_mps2"], linear(out["time_s"]), atol=1e-9)
    state, blocks = condition(conditioner, [imu(time_s[:12])])
    assert (blocks, conditioner.finish(state)[1]) == ([], [])


# --- faulty samples -------------------------------------------------------------------------------------------------


def test_duplicate_and_backward_times_are_dropped_and_counted() -> None:
    time_s = np.arange(300) / 100
    clean = imu(time_s, linear(time_s))
    dirty_time = np.insert(time_s, [50, 120, 121], [time_s[49], time_s[10], -3.0])
    dirty = imu(dirty_time, np.insert(linear(time_s), [50, 120, 121], 99.0, axis=0))
    expected = joined(condition(Conditioner(), [clean])[1])
    state, blocks = condition(Conditioner(), [dirty])
    assert_same_bits(joined(blocks), expected)
    assert state.report.n_not_increasing == 3
    assert state.report.n_received == 303
    assert any("3 of 303" in note for note in state.report.notes())


def test_rows_that_are_not_finite_are_bridged_below_the_longest_gap() -> None:
    time_s = np.arange(300) / 100
    force = linear(time_s)
    force[100:125] = np.nan  # 0.26 s between the finite neighbours
    force[200, 1] = np.inf
    state, blocks = condition(Conditioner(), [imu(time_s, force)])
    out = joined(blocks)
    assert len(blocks) == 1
    np.testing.assert_allclose(out["specific_force_mps2"], linear(out["time_s"]), atol=1e-9)
    assert (state.report.n_not_finite, state.report.n_gaps) == (26, 0)


def test_a_longer_stretch_of_rows_that_are_not_finite_is_a_gap() -> None:
    time_s = np.arange(400) / 100
    force = linear(time_s)
    force[100:140] = np.nan
    state, blocks = condition(Conditioner(), [imu(time_s, force)])
    assert state.report.n_gaps == 1
    assert [b.gap_before_s for b in blocks] == [np.inf, pytest.approx(time_s[140] - 0.98)]
    assert state.report.n_not_finite == 40


def test_samples_with_a_time_that_is_not_finite_are_dropped() -> None:
    time_s = np.arange(100) / 100
    time_s[[20, 50]] = np.nan, np.inf
    state, _ = condition(Conditioner(), [imu(time_s)])
    assert state.report.n_not_finite == 2
    assert state.report.last_time_s == 0.99


def test_no_sample_is_interpolated_in_a_gap_and_the_gap_is_the_time_without_output() -> None:
    time_s = np.concatenate([np.arange(0, 204), np.arange(700, 900)]) / 100
    state, blocks = condition(Conditioner(), [imu(time_s, linear(time_s))])
    out = joined(blocks)
    first, second = blocks
    assert not ((out["time_s"] > 2.03) & (out["time_s"] < 7.0)).any()
    assert first.time_s[-1] == pytest.approx(2.015)  # of the last hop only the samples that are followed by another one
    assert second.time_s[0] == pytest.approx(7.005)
    assert second.gap_before_s == pytest.approx(4.98)
    lost_s = second.gap_before_s
    assert (state.report.n_gaps, state.report.lost_s, state.report.longest_gap_s) == (1, lost_s, lost_s)
    np.testing.assert_allclose(out["specific_force_mps2"], linear(out["time_s"]), atol=1e-9)


def test_a_segment_too_short_for_a_hop_counts_as_part_of_the_gap() -> None:
    time_s = np.concatenate([np.arange(0, 202), [300, 301], np.arange(400, 500)]) / 100
    state, blocks = condition(Conditioner(), [imu(time_s)])
    assert [b.gap_before_s for b in blocks] == [np.inf, pytest.approx(2.0)]
    assert state.report.lost_s == pytest.approx(2.0)


def test_an_interval_just_below_the_longest_gap_is_bridged_and_one_above_is_not() -> None:
    for interval_s, n_blocks in [(0.299, 1), (0.301, 2)]:
        time_s = np.concatenate([np.arange(101) / 100, 1.0 + interval_s + np.arange(101) / 100])
        assert len(condition(Conditioner(), [imu(time_s)])[1]) == n_blocks


def test_a_missing_gyroscope_gives_zeros_that_are_marked_as_unknown() -> None:
    state, blocks = condition(Conditioner(), [imu(np.arange(500) / 100)])
    out = joined(blocks)
    assert not out["angular_rate_radps"].any()
    assert not out["angular_rate_known"].any()
    assert not out["magnetic_field_known"].any()
    assert any("no gyroscope" in note for note in state.report.notes())


def test_angular_rate_that_stops_is_held_as_long_as_a_bridged_gap_and_then_unknown() -> None:
    time_s = np.arange(500) / 100
    rate = np.ones((500, 3))
    rate[200:300] = np.nan
    state, blocks = condition(Conditioner(), [imu(time_s, rate=rate)])
    out = joined(blocks)
    unknown_s = out["time_s"][~out["angular_rate_known"]]
    assert unknown_s[0] == pytest.approx(1.99 + 0.3, abs=0.011)
    assert unknown_s[-1] == pytest.approx(2.985)
    assert (out["angular_rate_radps"] == np.where(out["angular_rate_known"], 1.0, 0.0)[:, None]).all()
    assert state.report.n_without_rate == len(unknown_s)


def test_clean_samples_give_no_notes() -> None:
    time_s = np.arange(500) / 100
    state, _ = condition(Conditioner(), [imu(time_s, rate=np.zeros((500, 3)))])
    assert state.report.notes() == ()


def test_no_samples_give_no_output() -> None:
    state, blocks = condition(Conditioner(), [imu(np.empty(0)), imu(np.array([1.0]))])
    assert blocks == []
    assert state.report.n_received == 1


# --- invariance -----------------------------------------------------------------------------------------------------


def messy_block(seed: int, rate_hz: float, jitter: bool) -> ImuBlock:
    """Samples with everything that goes wrong: gaps, NaN in every sensor, repeated and backward times."""
    rng = np.random.default_rng(seed)
    n = 400
    time_s = jittered_times(rng, n, rate_hz) if jitter else np.arange(n) / rate_hz
    for start in rng.integers(0, n, 2):
        time_s[start:] += rng.choice([0.28, 0.5, 3.0])
    time_s = np.round(time_s, 6)
    for i in rng.integers(1, n, 4):
        time_s[i] = time_s[i - 1] - rng.choice([0.0, 0.1])
    values = rng.normal(size=(n, 9))
    for first_column in (0, 3, 6):
        start = rng.integers(0, n)
        values[start : start + rng.integers(0, 80), first_column : first_column + 3] = np.nan
    return ImuBlock(time_s, values[:, :3], values[:, 3:6], values[:, 6:])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rate_hz=st.sampled_from([50.0, 99.0, 100.0, 200.0]),
    jitter=st.booleans(),
    cuts=st.lists(st.integers(0, 400), max_size=60),
)
def test_the_output_does_not_depend_on_how_samples_arrive(
    seed: int, rate_hz: float, jitter: bool, cuts: list[int]
) -> None:
    block = messy_block(seed, rate_hz, jitter)
    whole_state, whole = condition(Conditioner(), [block])
    state, pieces = condition(Conditioner(), cut(block, cuts))
    assert_same_bits(joined(pieces), joined(whole))
    assert state.report == whole_state.report


@pytest.mark.parametrize("hop_samples", [20, 100])
def test_rows_of_quiet_times_complete_no_hop(hop_samples: int) -> None:
    rng, conditioner = np.random.default_rng(0), Conditioner(hop_samples=hop_samples)
    force, rate = rng.normal(size=(600, 3)) + 9.8, rng.normal(size=(600, 3))
    force[:, 0] = np.where(np.arange(600) % 200 < 150, 1.0, force[:, 0])  # stuck now and then: samples are dropped
    state, n_quiet = conditioner.init(), 0
    for row in imu(np.cumsum(rng.uniform(0.005, 0.01, 600)), force, rate).parts(1):
        after_s, until_s = conditioner.quiet_s(state)
        state, blocks = conditioner.update(state, row)
        is_quiet = after_s < row.time_s[0] <= until_s
        assert not (is_quiet and blocks)
        n_quiet += is_quiet
    assert state.report.n_dead_force > 50
    assert n_quiet > 100


def test_the_conditioner_does_not_modify_its_input() -> None:
    block = messy_block(1, 100.0, jitter=True)
    copies = [getattr(block, n).copy() for n in ImuBlock.__slots__]
    condition(Conditioner(), cut(block, [3, 100, 250]))
    for name, copy in zip(ImuBlock.__slots__, copies, strict=True):
        np.testing.assert_array_equal(getattr(block, name), copy)


def test_an_old_state_is_not_changed_by_a_step() -> None:
    conditioner = Conditioner()
    first, second = cut(messy_block(2, 100.0, jitter=True), [200])
    state, _ = conditioner.update(conditioner.init(), first)
    rows, report = state.rows.copy(), state.report
    once = joined(conditioner.update(state, second)[1])
    assert_same_bits(joined(conditioner.update(state, second)[1]), once)
    np.testing.assert_array_equal(state.rows, rows)
    assert state.report == report


# --- merge_streams --------------------------------------------------------------------------------------------------


def recording(gyroscope: Samples | None, n: int = 200) -> Recording:
    time_s = np.arange(n) / 100
    return Recording("walk", Samples(time_s, linear(time_s)), gyroscope=gyroscope)


def test_streams_are_interpolated_at_the_times_of_the_accelerometer() -> None:
    time_s = jittered_times(np.random.default_rng(6), 300, 120.0) - 0.1
    block = merge_streams(recording(Samples(time_s, linear(time_s))))
    np.testing.assert_allclose(block.angular_rate_radps, linear(block.time_s), atol=1e-12)
    np.testing.assert_array_equal(block.specific_force_mps2, linear(np.arange(200) / 100))


def test_a_missing_stream_is_nan() -> None:
    block = merge_streams(recording(None))
    assert np.isnan(block.angular_rate_radps).all()
    assert np.isnan(block.magnetic_field_ut).all()


def test_a_stream_that_starts_later_is_held_for_a_moment_and_missing_before() -> None:
    time_s = 1.0 + np.arange(200) / 100
    block = merge_streams(recording(Samples(time_s, linear(time_s))))
    near = block.time_s > 0.7 + 1e-9
    assert np.isnan(block.angular_rate_radps[~near]).all()
    expected = linear(np.maximum(block.time_s[near], 1.0))
    np.testing.assert_allclose(block.angular_rate_radps[near], expected, atol=1e-12)


def test_a_hole_in_a_stream_is_interpolated_only_if_it_is_short() -> None:
    time_s = np.arange(200) / 100
    for hole, n_missing in [(slice(50, 75), 0), (slice(50, 100), 50), (slice(1, 50), 49)]:
        values = linear(time_s)
        values[hole] = np.nan
        rate = merge_streams(recording(Samples(time_s, values))).angular_rate_radps
        assert np.isnan(rate).all(axis=1).sum() == n_missing
        known = ~np.isnan(rate).any(axis=1)
        np.testing.assert_allclose(rate[known], linear(time_s[known]), atol=1e-12)


def test_a_stream_out_of_order_is_sorted() -> None:
    time_s = np.arange(200) / 100
    order = np.random.default_rng(7).permutation(200)
    disordered = Samples(np.append(time_s[order], 0.5), np.vstack([linear(time_s)[order], np.full(3, 77.0)]))
    rate = merge_streams(recording(disordered)).angular_rate_radps
    np.testing.assert_allclose(rate, linear(time_s), atol=1e-12)


def test_a_stream_of_one_sample_is_missing() -> None:
    block = merge_streams(recording(Samples(np.array([0.5]), np.ones((1, 3)))))
    assert np.isnan(block.angular_rate_radps).all()


# --- clocks and spikes ----------------------------------------------------------------------------------------------


def test_a_single_time_far_in_the_future_loses_one_sample() -> None:
    time_s = np.arange(500) / 100
    time_s[200] = 1e9
    state, blocks = condition(Conditioner(), [imu(time_s)])
    assert len(joined(blocks)["time_s"]) >= 480
    assert [b.gap_before_s for b in blocks] == [np.inf]
    assert state.report.n_not_increasing == 1
    assert (state.report.n_clock_jumps, state.report.n_clock_glitches) == (0, 1)
    assert any("the clock jumped ahead and returned once" in note for note in state.report.notes())


def test_implausible_values_are_dropped_and_counted() -> None:
    time_s = np.arange(300) / 100
    force, rate = linear(time_s), np.zeros((300, 3))
    clean = joined(condition(Conditioner(), [imu(time_s, force, rate)])[1])
    force, rate = force.copy(), rate.copy()
    force[100, 1], rate[150, 2] = 1e6, 1e4
    state, blocks = condition(Conditioner(), [imu(time_s, force, rate)])
    assert state.report.n_implausible == 2
    for name, values in joined(blocks).items():
        np.testing.assert_allclose(values, clean[name], atol=1e-9)


@pytest.mark.parametrize("bad", [np.inf, 1e9])
def test_a_gyroscope_with_only_implausible_values_counts_as_missing(bad: float) -> None:
    """The samples of the accelerometer are kept."""
    time_s = np.arange(300) / 100
    force = linear(time_s)
    _, without = condition(Conditioner(), [imu(time_s, force)])
    state, found = condition(Conditioner(), [imu(time_s, force, np.full((300, 3), bad))])
    assert_same_bits(joined(found), joined(without))
    assert state.report.n_implausible == 300


@pytest.mark.parametrize("offset_s", [1e6, 200.0, -3600.0])
def test_a_gyroscope_on_another_clock_is_refused_by_name(offset_s: float) -> None:
    time_s = np.arange(0.0, 5.0, 0.01)
    with pytest.raises(
        ValueError, match=r"gyroscope: its times, .* are outside those of the accelerometer.*remove the stream"
    ):
        merge_streams(recording(Samples(time_s + offset_s, linear(time_s))))


def test_without_angular_rate_the_turn_is_known_while_the_noise_of_the_force_is_that_of_a_phone_at_rest() -> None:
    time_s, rng = np.arange(600) / 100, np.random.default_rng(0)
    scale = np.repeat([0.02, 0.5, 0.0], 200)[:, None]  # at rest, moved, and a constant force as of a stuck sensor
    force = np.array([0.0, 0.0, 9.8]) + rng.normal(size=(600, 3)) * scale
    block = imu(time_s, force, np.full((600, 3), np.nan))
    state, blocks = condition(Conditioner(), [block])
    turn_known = joined(blocks)["turn_known"]
    assert turn_known[:180].all() and not turn_known[200:].any()
    assert not joined(blocks)["angular_rate_known"].any()
    assert state.report.n_without_turn < state.report.n_without_rate == len(turn_known)
    for edges in ([1, 77, 333], [100, 101, 420]):
        _, cut_blocks = condition(Conditioner(), cut(block, edges))
        assert_same_bits(joined(cut_blocks), joined(blocks))


def test_a_gyroscope_that_begins_a_second_late_at_rest_leaves_the_stated_position_as_it_is() -> None:
    legs = [Leg("stationary", duration_s=4.0), Leg("walking", distance_m=30.0)]
    walk = simulate(legs, carrying_mode="pocket", seed=3)
    assert walk.gyroscope is not None
    begun = walk.gyroscope.time_s >= 1.0
    late = replace(walk, gyroscope=Samples(walk.gyroscope.time_s[begun], walk.gyroscope.values[begun]))
    tracks = [pdr.track(recording, heading_rad=0.0) for recording in (walk, late)]
    assert tracks[1].position_std_m[-1] == pytest.approx(tracks[0].position_std_m[-1], rel=0.1)
    assert not any("angular rate for" in note for note in tracks[1].notes)
