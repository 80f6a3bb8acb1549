"""Sensors that arrive separately give the bits of the finished recording, and none of them blocks the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers import of_nobody, resumed
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.data.io.describe import describe
from pdr_filter.sensing.clock import MAX_GAP_S, ClockState, accept_rows, one_clock
from pdr_filter.sensing.stream_merging import (
    _MAX_ROWS,
    SENSORS,
    Merged,
    MergerState,
    Sensor,
    StreamMerger,
    absences,
    absences_in,
)
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray, ImuBlock, Samples
from pdr_filter.values.recording import Recording

# One piece of a stream: time of arrival, sensor, and rows.
Piece = tuple[float, Sensor, FloatArray, FloatArray]


def noise(n: int, rate_hz: float, seed: int, begin_s: float = 0.0, d: int = 3) -> Samples:
    """Samples at uneven times."""
    rng = np.random.default_rng(seed)
    time_s = begin_s + (np.arange(n) + rng.uniform(-0.4, 0.4, n)) / rate_hz
    return Samples(time_s, rng.normal(size=(n, d)) + (1000.0 if d == 1 else 0.0))


def a_recording() -> Recording:
    """Twelve seconds; the gyroscope begins later and has a hole, the magnetometer is slow and ends early."""
    gyroscope = noise(2400, 200.0, 2, begin_s=0.13)
    kept = (gyroscope.time_s < 3.0) | (gyroscope.time_s > 3.7)
    gyroscope = Samples(gyroscope.time_s[kept], gyroscope.values[kept])
    field = noise(110, 10.0, 3, begin_s=-0.2)
    field.values.flags.writeable = True
    field.values[30:33] = np.nan
    accelerometer = noise(1200, 100.0, 1)
    return Recording("noise", accelerometer, gyroscope=gyroscope, magnetometer=field, barometer=noise(24, 2.0, 4, d=1))


RECORDING = a_recording()
# A seed is as good as any other: nothing to shrink.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)


def pieces_of(recording: Recording, seed: int, longest_s: float = 1.0, latest_s: float = 3.5) -> list[Piece]:
    """Each stream cut anywhere and each piece late by up to some seconds, in order within its stream."""
    rng = np.random.default_rng(seed)
    found: list[Piece] = []
    for sensor in SENSORS:
        stream = recording.streams.get(sensor)
        if stream is None:
            continue
        n_cuts = int(2 * len(stream) / (longest_s * len(stream) / np.ptp(stream.time_s))) + 1
        edges = {0, len(stream), *rng.integers(0, len(stream), n_cuts).tolist()}
        for second in np.arange(stream.time_s[0], stream.time_s[-1], longest_s):
            edges.add(int(np.searchsorted(stream.time_s, second)))
        bounds, arrival_s = sorted(edges), -np.inf
        for begin, end in pairwise(bounds):
            arrival_s = max(arrival_s, stream.time_s[end - 1] + rng.uniform(0, latest_s))
            found.append((arrival_s, sensor, stream.time_s[begin:end], stream.values[begin:end]))
    return sorted(found, key=lambda piece: piece[0])


def update(
    merger: StreamMerger, state: MergerState, sensor: Sensor, time_s: FloatArray, values: FloatArray
) -> tuple[MergerState, Merged]:
    """The new state and the released samples after samples of one sensor."""
    return merger.together(state, {sensor: (time_s, values)})


def merged(pieces: Iterable[Piece], merger: StreamMerger | None = None) -> tuple[ImuBlock, FloatArray, int]:
    """All released samples, the pressures, and the number of accelerometer samples released before the end."""
    merger = merger or StreamMerger()
    state, outputs = merger.init(), list[Merged]()
    for _, sensor, time_s, values in pieces:
        state, output = update(merger, state, sensor, time_s, values)
        outputs.append(output)
    n_early = sum(len(o.block.time_s) for o in outputs)
    outputs.append(merger.finish(state)[1])
    blocks = [o.block for o in outputs]
    names = ("time_s", "specific_force_mps2", "angular_rate_radps", "magnetic_field_ut")
    block = ImuBlock(*(np.concatenate([getattr(b, name) for b in blocks]) for name in names))
    pressure = np.concatenate([np.column_stack([o.pressure_time_s, o.pressure_hpa]) for o in outputs])
    return block, pressure, n_early


def assert_same_block(actual: ImuBlock, expected: ImuBlock) -> None:
    for name in ("time_s", "specific_force_mps2", "angular_rate_radps", "magnetic_field_ut"):
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), err_msg=name)


@example(seed=104993, longest_s=0.2, latest_s=3.5)  # one sample of the gyroscope comes first
@settings(max_examples=8, deadline=None, phases=PHASES)
@given(
    seed=st.integers(0, 10**6), longest_s=st.sampled_from([0.03, 0.2, 1.0]), latest_s=st.sampled_from([0.0, 1.0, 3.5])
)
def test_any_interleaving_and_chunking_gives_the_bits_of_merge_streams(
    seed: int, longest_s: float, latest_s: float
) -> None:
    block, pressure, n_early = merged(pieces_of(RECORDING, seed, longest_s, latest_s))
    assert_same_block(block, pdr.merge_streams(RECORDING))
    assert RECORDING.barometer is not None
    np.testing.assert_array_equal(pressure[:, 1], RECORDING.barometer.values[:, 0])
    assert n_early > len(block.time_s) - 100 * (latest_s + longest_s + 1.8)  # the magnetometer ends early


@settings(max_examples=6, deadline=None, phases=PHASES)
@given(seed=st.integers(0, 10**6))
def test_repeated_messages_change_no_sample_that_is_used(seed: int) -> None:
    rng, pieces = np.random.default_rng(seed), pieces_of(RECORDING, seed)
    twice = [(a + rng.uniform(0, 6.0), *rest) for a, *rest in pieces if rng.uniform() < 0.3]
    block, pressure, _ = merged(sorted([*pieces, *twice], key=lambda piece: piece[0]))
    first = np.unique(block.time_s, return_index=True)[1]
    assert (np.diff(block.time_s) >= 0).all()
    names = ("time_s", "specific_force_mps2", "angular_rate_radps", "magnetic_field_ut")
    assert_same_block(ImuBlock(*(getattr(block, name)[first] for name in names)), pdr.merge_streams(RECORDING))
    assert len(pressure) == len(np.unique(pressure[:, 0]))


@settings(max_examples=2, deadline=None, phases=PHASES)
@given(seed=st.integers(0, 10**6), reorder_s=st.sampled_from([0.05, 0.5]))
def test_samples_out_of_order_by_less_than_reorder_s_are_sorted(seed: int, reorder_s: float) -> None:
    rng = np.random.default_rng(seed)
    pieces: list[Piece] = []
    for sensor, stream in RECORDING.streams.items():
        for row in range(len(stream)):
            arrival_s = stream.time_s[row] + rng.uniform(0, reorder_s)
            pieces.append((arrival_s, sensor, stream.time_s[row : row + 1], stream.values[row : row + 1]))  # type: ignore[arg-type]
    pieces.sort(key=lambda piece: piece[0])
    block, _, _ = merged(pieces, StreamMerger(reorder_s=reorder_s))
    assert_same_block(block, pdr.merge_streams(RECORDING))


@pytest.mark.parametrize("late_s", [1.5, 3.5])
def test_a_message_that_was_overtaken_fills_the_hole_that_it_left(late_s: float) -> None:
    pieces: list[Piece] = []
    for sensor, stream in RECORDING.streams.items():
        number = np.floor(stream.time_s).astype(int)
        for second in np.unique(number):
            rows = number == second
            arrival_s = second + 1.0 + late_s * (second in (5, 7))
            pieces.append((arrival_s, sensor, stream.time_s[rows], stream.values[rows]))  # type: ignore[arg-type]
    block, _, _ = merged(sorted(pieces, key=lambda piece: piece[0]))
    assert_same_block(block, pdr.merge_streams(RECORDING))


def push_all(online: pdr.OnlineFilter, pieces: Iterable[Piece]) -> list[pdr.StepUpdate]:
    updates: list[pdr.StepUpdate] = []
    for _, sensor, time_s, values in pieces:
        updates += give(online, sensor, time_s, values)
    return updates


def give(online: pdr.OnlineFilter, sensor: str, time_s: Any, values: Any) -> list[pdr.StepUpdate]:
    if sensor == "barometer":
        return online.push_pressure(time_s, np.asarray(values)[..., 0])
    return getattr(online, f"push_{sensor}")(time_s, values)


def a_walk() -> Recording:
    legs = [Leg("stationary", duration_s=4.0), Leg("walking", distance_m=18.0), Leg("walking", 9.0, turn_rad=1.0)]
    walk = simulate(legs, seed=5)
    time_s = np.arange(0.0, walk.duration_s, 0.2)
    pressure = 1000.0 + 0.01 * np.random.default_rng(0).normal(size=(len(time_s), 1))
    return replace(walk, barometer=Samples(time_s, pressure))


WALK = a_walk()


def assert_same_track(updates: Sequence[pdr.StepUpdate], track: pdr.Track) -> None:
    assert len(updates) == track.n_steps > 20
    np.testing.assert_array_equal([u.position_m for u in updates], track.position_m)
    np.testing.assert_array_equal([u.position_cov_m2 for u in updates], track.position_cov_m2)
    np.testing.assert_array_equal([u.context_prob for u in updates], track.context_prob)
    np.testing.assert_array_equal([u.height_m for u in updates], track.height_m)


def with_backward_times(recording: Recording, seed: int) -> Recording:
    """The recording with times of each sensor that repeat, or go back once, for a few samples or from there on."""
    rng, moved = np.random.default_rng(seed), {}
    for name, stream in recording.streams.items():
        time_s, n = stream.time_s.copy(), len(stream)
        few = max(2, int(0.19 * n / recording.duration_s))
        for at in rng.integers(n // 10, n, rng.integers(1, n // 80 + 2)):
            kind = rng.integers(5)
            if kind == 0:
                time_s[at] = time_s[at - 1]
            elif kind == 1:
                time_s[at] -= rng.uniform(0, 0.099)
            elif kind == 2:
                time_s[at:] -= rng.uniform(0, 0.02)
            elif kind == 3:
                time_s[at : at + rng.integers(1, few)] -= rng.uniform(0.1, 4.0)
            else:
                time_s[at] = rng.choice(time_s[max(at - 30, 0) : at])
        moved[name] = Samples(time_s, stream.values)
    return replace(recording, **moved)


def pieces_in_order(recording: Recording, moved: Recording, seed: int) -> list[Piece]:
    """Each stream of `moved` cut anywhere, into single samples or longer pieces, by the times of `recording`."""
    rng, found = np.random.default_rng(seed), list[Piece]()
    for sensor, stream in moved.streams.items():
        true_s, arrival_s = recording.streams[sensor].time_s, 0.0
        edges = {0, len(stream), *rng.integers(0, len(stream), rng.choice([5, 50, 800])).tolist()}
        edges |= set(true_s.searchsorted(np.arange(0.0, true_s[-1])).tolist())
        for begin, end in pairwise(sorted(edges)):
            arrival_s = max(arrival_s, true_s[end - 1] + rng.uniform(0, 1.0))
            found.append((arrival_s, sensor, stream.time_s[begin:end], stream.values[begin:end]))  # type: ignore[arg-type]
    return sorted(found, key=lambda piece: piece[0])


def accepted(block: ImuBlock) -> FloatArray:
    columns = (block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)
    return accept_rows(ClockState(), np.column_stack([block.time_s, *columns]), MAX_GAP_S).rows


@settings(max_examples=10, deadline=None, phases=PHASES)
@given(seed=st.integers(0, 10**6))
def test_times_that_go_back_give_the_samples_of_the_recording_however_they_arrive(seed: int) -> None:
    moved = with_backward_times(WALK, seed)
    block, pressure, _ = merged(pieces_in_order(WALK, moved, seed))
    np.testing.assert_array_equal(accepted(block), accepted(pdr.merge_streams(moved)))
    barometer = one_clock(moved)[0].barometer
    assert barometer is not None
    np.testing.assert_array_equal(pressure[:, 0], np.unique(barometer.time_s))


@pytest.mark.parametrize("seed", [3, 7])
def test_times_that_go_back_give_the_track_and_notes_of_the_recording_also_when_saved_between(seed: int) -> None:
    moved = of_nobody(with_backward_times(WALK, seed))
    track = pdr.track(moved, pdr.recipes.default())
    online, updates = pdr.OnlineFilter(), list[pdr.StepUpdate]()
    for number, piece in enumerate(pieces_in_order(WALK, moved, seed)):
        if number % 100 == 50:
            online = resumed(online)
        updates += push_all(online, [piece])
        if number % 7 == 0:
            online.now()
    assert_same_track([u for u in [*updates, *online.finish()] if u.is_final], track)
    own = [note for note in online.notes if not note.startswith(SENSORS)]
    assert sorted(own) == sorted(note for note in track.notes if note not in moved.notes)
    for words in ("were sorted by time", "had a repeated or backward time and were dropped"):
        assert any(words in note for note in own)


def test_samples_in_any_order_within_a_tenth_of_a_second_give_the_track_of_the_sorted_ones() -> None:
    rng, mixed = np.random.default_rng(1), {}
    for name, stream in WALK.streams.items():
        order = np.argsort(stream.time_s + rng.uniform(0.0, 0.099, len(stream)))
        mixed[name] = Samples(stream.time_s[order], stream.values[order])
    assert_same_block(pdr.merge_streams(replace(WALK, **mixed)), pdr.merge_streams(WALK))


def test_a_single_row_is_taken_as_a_block_of_one() -> None:
    online, block = pdr.OnlineFilter(), pdr.OnlineFilter()
    for i in range(300):
        online.push_accelerometer(0.01 * i, (0.1, 0.0, 9.8))
        online.push_gyroscope(0.01 * i, (0.0, 0.01, 0.0))
        online.push_pressure(0.01 * i, 1000.0)
    block.push_accelerometer(0.01 * np.arange(300), np.tile([0.1, 0.0, 9.8], (300, 1)))
    block.push_gyroscope(0.01 * np.arange(300), np.tile([0.0, 0.01, 0.0], (300, 1)))
    for one in (online, block):
        one.finish()
    np.testing.assert_array_equal(
        online.state.sensing.attitude.vqf["gyrQuat"], block.state.sensing.attitude.vqf["gyrQuat"]
    )  # type: ignore[index]


def test_single_samples_are_released_in_groups_with_little_delay() -> None:
    merger, state = StreamMerger(), StreamMerger().init()
    n_releases = 0
    for time_s in 0.01 * np.arange(1000):
        for sensor in ("gyroscope", "magnetometer", "accelerometer"):
            state, output = update(merger, state, sensor, np.array([time_s]), np.zeros((1, 3)))
            n_releases += len(output.block.time_s) > 0
        if time_s > 6.0:  # the merger no longer waits for the barometer
            assert time_s - state.released_s <= merger.reorder_s + merger.bunch_s + 0.011
    assert 100 < n_releases < 250


def test_a_block_is_released_when_the_last_sensor_has_passed_it() -> None:
    merger, state = StreamMerger(), StreamMerger().init()
    for second in range(10):
        time_s = second + 0.01 * np.arange(100)
        for sensor in ("gyroscope", "magnetometer", "accelerometer"):
            state, _ = update(merger, state, sensor, time_s, np.zeros((100, 3)))  # type: ignore[arg-type]
    assert state.released_s == pytest.approx(time_s[-1] - merger.reorder_s, abs=0.011)


def test_a_silent_sensor_gives_a_note_and_delays_the_others_by_at_most_wait_s() -> None:
    merger = StreamMerger()
    online, time_s = pdr.OnlineFilter(), 0.01 * np.arange(2000)
    for second in range(20):
        rows = slice(100 * second, 100 * second + 100)
        online.push_accelerometer(time_s[rows], np.tile([0.0, 0.0, 9.8], (100, 1)))
        if second < 8:
            online.push_gyroscope(time_s[rows], np.zeros((100, 3)))
        if second == 12:
            assert not any("silent" in note for note in online.notes)
            assert online.now().latency_s > merger.wait_s - 1.0
    assert any(
        note.startswith("gyroscope: no samples since 8.0 s")
        and "so that the walking direction is unknown there" in note
        for note in online.notes
    )
    assert online.now().latency_s < 0.5
    online.push_gyroscope(time_s + 20.0, np.zeros((2000, 3)))
    assert not any("gyroscope: silent" in note for note in online.notes)


@pytest.fixture(scope="module")
def demo() -> pdr.Recording:
    return pdr.simulate.demo_walk()


def between(samples: Samples, begin_s: float, end_s: float) -> Samples:
    rows = slice(*np.searchsorted(samples.time_s, [begin_s, end_s]))
    return Samples(samples.time_s[rows], samples.values[rows])


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope", "magnetometer"])
@pytest.mark.parametrize("is_end", [True, False])
def test_a_sensor_that_ends_or_begins_half_way_is_named_online_offline_and_in_info(
    demo: pdr.Recording, sensor: str, is_end: bool
) -> None:
    end_s, half_s = 50, 25.0
    streams = {name: between(stream, 0.0, end_s) for name, stream in demo.streams.items()}
    streams[sensor] = part = between(streams[sensor], *((0.0, half_s) if is_end else (half_s, end_s)))
    recording = replace(demo, **streams)
    at = f"since {part.time_s[-1]:.1f}" if is_end else f"before {part.time_s[0]:.1f}"
    lost = {
        "accelerometer": "the track has no steps there",
        "gyroscope": "the walking direction is unknown there",
        "magnetometer": "the other sensors are used without it",
    }[sensor]
    (note,) = (note.text for note in absences_in(recording.streams))
    assert note.startswith(f"{sensor}: no samples {at} s") and lost in note
    assert note in describe(recording).notes
    online = pdr.OnlineFilter()
    for second in range(end_s):
        pushed = {name: between(recording.streams[name], second, second + 1) for name in SENSORS[:3]}
        online.push_streams({name: samples for name, samples in pushed.items() if len(samples)})
    assert note in online.notes
    assert note in resumed(online).notes
    of_bias = [text for text in online.notes if "gyroscope bias" in text or "without gyroscope" in text]
    assert sensor != "gyroscope" or not is_end or not of_bias  # one cause has one note


def test_an_accelerometer_that_ends_half_way_is_named_in_the_track_and_a_complete_one_is_not(
    demo: pdr.Recording,
) -> None:
    kept = demo.accelerometer.time_s < 60.0
    part = replace(demo.accelerometer, time_s=demo.accelerometer.time_s[kept], values=demo.accelerometer.values[kept])
    track = pdr.track(replace(demo, accelerometer=part))
    assert any(note.startswith("accelerometer: no samples since 60.0 s") for note in track.notes)
    assert not any("no samples" in note for note in pdr.track(demo).notes)


def test_small_differences_between_the_ends_of_sensors_are_not_named() -> None:
    spans: dict[Sensor, tuple[float, float]] = {"accelerometer": (0.0, 100.0), "barometer": (4.9, 95.1)}
    assert absences(spans, 5.0) == []
    assert len(absences(spans, 4.8)) == 2


def test_without_a_gyroscope_the_first_samples_alone_wait() -> None:
    merger, force = StreamMerger(), np.zeros((100, 3))
    state, left = merger.init(), []
    for second in range(10):
        state, output = update(merger, state, "accelerometer", second + 0.01 * np.arange(100), force)
        left.append(len(output.block.time_s))
    assert left[:5] == [0] * 5
    assert sum(left) == 1000 - 10  # samples that a late message may still precede


def test_late_samples_are_counted_and_dropped() -> None:
    online, time_s = pdr.OnlineFilter(), 0.01 * np.arange(1000)
    online.push_gyroscope(time_s, np.zeros((1000, 3)))
    online.push_accelerometer(time_s, np.tile([0.0, 0.0, 9.8], (1000, 1)))
    online.push_accelerometer(time_s[:30], np.tile([0.0, 0.0, 9.8], (30, 1)))
    assert "30 of 1030 samples had a repeated or backward time and were dropped" in online.notes


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_buffer_is_bounded(sensor: Sensor) -> None:
    merger = StreamMerger()
    state = merger.init()
    for block in np.array_split(0.001 * np.arange(3 * _MAX_ROWS), 50):
        state, _ = update(merger, state, sensor, block, np.zeros((len(block), 1 if sensor == "barometer" else 3)))
    assert len(state.stream(sensor).rows) <= _MAX_ROWS


def test_the_buffer_is_bounded_while_the_clock_stands_still() -> None:
    merger, state = StreamMerger(), StreamMerger().init()
    for _ in range(30):
        state, _ = update(merger, state, "accelerometer", np.full(1000, 7.0), np.zeros((1000, 3)))
    assert len(state.stream("accelerometer").rows) <= _MAX_ROWS


def test_a_single_time_far_ahead_does_not_stop_the_merging() -> None:
    for sensor in ("accelerometer", "gyroscope"):
        pieces = pieces_of(RECORDING, 0, longest_s=0.2)
        at = len(pieces) // 2
        pieces.insert(at, (pieces[at][0], sensor, np.array([1e6]), np.ones((1, 3))))
        block, _, n_early = merged(pieces)
        expected = pdr.merge_streams(RECORDING)
        kept = block.time_s < 1e5
        np.testing.assert_array_equal(block.angular_rate_radps[kept][:1100], expected.angular_rate_radps[:1100])
        assert n_early > 700


def test_a_clock_that_is_set_back_is_followed_after_a_minute_of_late_samples_alone() -> None:
    merger, force, state = StreamMerger(), np.zeros((100, 3)), StreamMerger().init()
    left = 0
    for begin_s in (*range(1000, 1010), *range(0, 90)):
        time_s = begin_s + 0.01 * np.arange(100)
        for sensor in ("gyroscope", "accelerometer"):
            state, output = update(merger, state, sensor, time_s, force)  # type: ignore[arg-type]
        left += len(output.block.time_s)
    assert 1000 + 2600 < left < 1000 + 3000
    assert state.released_s == pytest.approx(89.99 - merger.reorder_s, abs=0.011)


def test_sensors_that_come_in_one_message_give_the_bits_of_those_that_come_apart() -> None:
    walk = pdr.simulate.demo_walk()
    early = {name: s.time_s < 25.0 for name, s in walk.streams.items() if name in SENSORS}
    streams = {n: Samples(walk.streams[n].time_s[e], walk.streams[n].values[e]) for n, e in early.items()}
    tracks: list[np.ndarray] = []
    for part_s, is_whole in ((0.1, False), (0.7, True), (30.0, True)):
        online, updates = pdr.OnlineFilter(), list[pdr.StepUpdate]()
        for begin_s in np.arange(0.0, 25.0, part_s):
            inside = {n: (s.time_s >= begin_s) & (s.time_s < begin_s + part_s) for n, s in streams.items()}
            message = {n: Samples(s.time_s[inside[n]], s.values[inside[n]]) for n, s in streams.items()}
            for some in [message] if is_whole else [{n: s} for n, s in message.items()]:
                updates += online.push_streams(some)  # type: ignore[arg-type]
        updates += online.finish()
        tracks.append(np.array([[u.step.time_s, *u.position_m] for u in updates if u.is_final]))
    assert len(tracks[0]) > 30
    for track in tracks[1:]:
        np.testing.assert_array_equal(track, tracks[0])
