from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, cut_randomly, imu, sensed
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from pdr_filter import serialise
from pdr_filter.conditioning import merge_streams
from pdr_filter.context.irregular import irregular_prob
from pdr_filter.features.windows import FeatureWindow, FeatureWindows
from pdr_filter.sensing import Event, Gap, Sensing
from pdr_filter.simulate import demo_walk
from pdr_filter.steps.gate import StepGate, StepGateState
from pdr_filter.types import STANDARD_GRAVITY_MPS2, Step

WALKING, IRREGULAR, STILL, UNKNOWN = 1e-6, 1 - 1e-6, 0.0, math.nan
STEP_LATENCY_S = 0.81
GATE = StepGate()

# An event is when it became known, and a contact time, a window (its probability of irregular motion) or a gap.
Events = list[tuple[float, str, float]]


def contacts(times_s: list[float]) -> Events:
    return [(t + STEP_LATENCY_S, "step", t) for t in times_s]


def windows(probs: list[float], first_end_s: float = 2.0) -> Events:
    return [(first_end_s + i, "window", p) for i, p in enumerate(probs)]


def in_order(*events: Events) -> Events:
    return sorted((e for part in events for e in part), key=lambda e: e[0])


def advance(gate: StepGate, state: StepGateState, event: tuple[float, str, float]) -> tuple[StepGateState, list[Step]]:
    known_s, kind, value = event
    if kind == "window":
        return gate.on_window(state, known_s, known_s, value)
    if kind == "gap":
        return gate.on_gap(state, known_s, value)
    return gate.on_step(state, known_s, replace(a_step(value), detected_time_s=known_s))


def passed(events: Events, gate: StepGate = GATE) -> list[Step]:
    """All steps that pass, those at the end of the recording included."""
    state, steps = gate.init(), []
    for event in events:
        state, found = advance(gate, state, event)
        steps += found
    return [*steps, *gate.finish(state, events[-1][0] if events else 0.0)[1]]


def times_of(steps: list[Step]) -> list[float]:
    return [s.time_s for s in steps]


def jagged(n: int, first_s: float, seed: int = 0) -> list[float]:
    """Contacts that are never regular."""
    intervals_s = np.tile([0.4, 0.8, 0.7, 0.5], n)[: n - 1] * np.random.default_rng(seed).uniform(0.95, 1.05, n - 1)
    return [first_s, *(first_s + np.cumsum(intervals_s))]


# --- bouts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [5, 6, 20, 100])
@pytest.mark.parametrize("interval_s", [0.3, 0.55, 1.0, 2.0])
def test_a_bout_of_certain_walking_passes_whole_with_its_first_steps(n: int, interval_s: float) -> None:
    times_s = [5.0 + i * interval_s for i in range(n)]
    steps = passed(in_order(contacts(times_s), windows([WALKING] * int(times_s[-1] + 5))))
    assert times_of(steps) == times_s


def test_the_shortest_bout_inside_irregular_motion_passes_if_its_windows_say_walking() -> None:
    times_s = [10.0 + 0.5 * i for i in range(5)]
    probs = [IRREGULAR if not 10.5 <= end_s <= 13.5 else WALKING for end_s in range(2, 20)]
    steps = passed(in_order(contacts(times_s), windows(probs)))
    assert times_of(steps) == times_s


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_fewer_steps_than_a_bout_are_dropped_even_while_the_windows_say_walking(n: int) -> None:
    assert passed(in_order(contacts([5.0 + 0.5 * i for i in range(n)]), windows([WALKING] * 15))) == []


def test_a_bout_may_be_as_short_as_asked_for() -> None:
    events = in_order(contacts([5.0]), windows([WALKING] * 10))
    assert times_of(passed(events, StepGate(min_steps=1))) == [5.0]


def test_after_a_pause_a_bout_begins_anew() -> None:
    first = [5.0 + 0.5 * i for i in range(6)]
    few = [first[-1] + 2.6 + 0.5 * i for i in range(4)]
    assert times_of(passed(in_order(contacts(first + few), windows([WALKING] * 20)))) == first


@pytest.mark.parametrize("prob", [IRREGULAR, STILL, 1.0])
def test_irregular_steps_of_a_phone_that_is_handled_or_lies_still_never_pass(prob: float) -> None:
    assert passed(in_order(contacts(jagged(40, 5.0)), windows([prob] * 40))) == []


@given(gaps_s=st.lists(st.floats(2.6, 10.0), min_size=1, max_size=20), prob=st.sampled_from([WALKING, 0.5, IRREGULAR]))
def test_isolated_steps_never_pass(gaps_s: list[float], prob: float) -> None:
    times_s = list(3.0 + np.cumsum(gaps_s))
    assert passed(in_order(contacts(times_s), windows([prob] * int(times_s[-1] + 3)))) == []


def test_one_irregular_window_does_not_interrupt_a_bout() -> None:
    times_s = jagged(60, 3.0)
    probs = [WALKING] * 45
    probs[20] = IRREGULAR
    assert times_of(passed(in_order(contacts(times_s), windows(probs)))) == times_s


def test_handling_before_and_after_a_walk_loses_its_steps_and_the_walk_keeps_its_own() -> None:
    times_s = jagged(100, 0.5)
    probs = [WALKING if 20 <= end_s - 1 <= 40 else IRREGULAR for end_s in range(2, 65)]
    steps = times_of(passed(in_order(contacts(times_s), windows(probs))))
    assert {t for t in times_s if 20 <= t <= 40} <= set(steps)
    # the change is between two windows, and one step is filled in
    assert steps[0] > 18.0
    assert steps[-1] < 42.0


def test_regular_steps_are_a_walk_whatever_the_windows_say() -> None:
    times_s = [5.0 + 1.0 * i + 0.1 * (i % 2) for i in range(20)]  # the two feet differ
    assert times_of(passed(in_order(contacts(times_s), windows([IRREGULAR] * 30)))) == times_s
    assert passed(in_order(contacts(times_s[:7]), windows([IRREGULAR] * 30))) == []


def test_without_any_window_the_steps_of_a_bout_pass_as_the_prior_has_it() -> None:
    times_s = [0.3 + 0.3 * i for i in range(5)]
    assert times_of(passed(contacts(times_s))) == times_s
    assert passed(contacts(times_s), StepGate(mean_walk_s=10.0, mean_pause_s=20.0)) == []


def test_a_window_of_unknown_evidence_tells_nothing() -> None:
    times_s = jagged(20, 5.0)
    seen, unseen = (
        times_of(passed(in_order(contacts(times_s), windows(p))))
        for p in ([WALKING] * 30, [WALKING, UNKNOWN, UNKNOWN] * 10)
    )
    assert seen == unseen == times_s


# --- the smoother ---------------------------------------------------------------------------------------------------


def forward_backward(gate: StepGate, log_ratios: list[float], time_s: float) -> float:
    """Walking at a time by summing over all paths of a chain on a fine grid; windows at 1, 2, 3 ... s."""
    n_fine, enter, leave = 2000, 1 / gate.mean_pause_s, 1 / gate.mean_walk_s
    grid_s = np.linspace(0.0, 1.0, n_fine + 1)
    fine = np.array([[1 - enter / n_fine, enter / n_fine], [leave / n_fine, 1 - leave / n_fine]])
    share = gate.mean_walk_s / (gate.mean_walk_s + gate.mean_pause_s)

    def likelihood(i: int) -> np.ndarray:
        return np.diag([1.0, math.exp(log_ratios[i])])

    second, fraction = divmod(time_s, 1.0)
    split = int(np.argmin(np.abs(grid_s - fraction)))
    path = np.array([1 - share, share]) @ likelihood(0)
    for i in range(1, int(second)):
        path = path @ np.linalg.matrix_power(fine, n_fine) @ likelihood(i)
    path = path @ np.linalg.matrix_power(fine, split)
    after = np.ones(2)
    for i in reversed(range(int(second), len(log_ratios))):
        steps = n_fine if i > second else n_fine - split
        after = np.linalg.matrix_power(fine, steps) @ likelihood(i) @ after
    return float((path * after)[1] / (path * after).sum())


@settings(max_examples=30, deadline=None)
@given(probs=st.lists(st.floats(0.01, 0.99), min_size=2, max_size=4), time_s=st.floats(1.01, 1.99))
def test_the_belief_is_that_of_a_two_state_chain_over_all_paths(probs: list[float], time_s: float) -> None:
    state = GATE.init()
    for known_s, _, prob in windows(probs):
        state, _ = GATE.on_window(state, known_s, known_s, prob)
    neutral = math.log(GATE.neutral_prob / (1 - GATE.neutral_prob))
    log_ratios = [GATE.evidence_weight * (neutral - math.log(p / (1 - p))) for p in probs]
    assert GATE._walking_prob(state, time_s) == pytest.approx(forward_backward(GATE, log_ratios, time_s), abs=1e-4)


# --- when -----------------------------------------------------------------------------------------------------------


def test_a_step_in_a_bout_is_known_with_the_first_window_that_ends_the_lag_after_it() -> None:
    times_s = [5.0 + 0.53 * i for i in range(60)]
    steps = passed(in_order(contacts(times_s), windows([WALKING] * 50)))
    latency_s = np.array([s.detected_time_s - s.time_s for s in steps])
    assert latency_s.min() >= GATE.lag_s
    assert latency_s[5:].max() <= GATE.lag_s + 1.0
    assert latency_s[0] <= GATE.lag_s + 1.0 + 0.53 * 4
    assert len({s.detected_time_s for s in steps[:5]}) == 1


def test_only_the_time_at_which_a_step_became_known_changes() -> None:
    times_s = [5.0 + 0.5 * i for i in range(10)]
    steps = passed(in_order(contacts(times_s), windows([WALKING] * 20)))
    assert [replace(s, detected_time_s=0.0) for s in steps] == [
        replace(a_step(t), detected_time_s=0.0) for t in times_s
    ]


def test_the_end_of_the_recording_decides_on_what_waits() -> None:
    walk = [3.0 + 0.5 * i for i in range(12)]
    events = in_order(contacts(walk), windows([WALKING] * 7))
    state, early = GATE.init(), []
    for event in events:
        state, found = advance(GATE, state, event)
        early += found
    assert len(early) < len(walk)
    state, late = GATE.finish(state, 9.5)
    assert times_of(early + late) == walk
    assert {s.detected_time_s for s in late} == {9.5}
    assert GATE.finish(state, 9.5)[1] == []


def test_a_gap_decides_on_what_waits_and_drops_what_is_no_bout() -> None:
    walk = [3.0 + 0.5 * i for i in range(8)]
    gap = [(8.0, "gap", 5.0)]
    before = in_order(contacts(walk), windows([WALKING] * 6))
    few = contacts([14.0, 14.5, 15.0])
    after = in_order(few, windows([WALKING] * 3, 15.2))
    assert times_of(passed([*before, *gap, *after])) == walk
    assert passed([*contacts(walk[:4]), (6.0, "gap", 0.5), *contacts([6.4, 6.9])]) == []


def test_a_bout_goes_on_after_a_short_gap() -> None:
    walk = [3.0 + 0.5 * i for i in range(8)]
    before = in_order(contacts(walk), windows([WALKING] * 6))
    after = in_order(contacts([8.2, 8.7]), windows([WALKING], 10.5))
    assert times_of(passed([*before, (7.5, "gap", 0.5), *after])) == [*walk, 8.2, 8.7]


def test_the_belief_fades_over_a_gap() -> None:
    handled = windows([IRREGULAR] * 8)
    times_s = jagged(6, 9.6)
    for gap_s, n in [(0.4, 0), (300.0, 6)]:
        moved = [t + gap_s for t in times_s]
        assert len(passed([*handled, (9.0, "gap", gap_s), *contacts(moved)])) == n


# --- any events -----------------------------------------------------------------------------------------------------


@st.composite
def any_events(draw: st.DrawFn) -> Events:
    times_s = 2.0 + np.cumsum(draw(st.lists(st.floats(0.25, 3.0), max_size=60)))
    end_s = times_s[-1] if len(times_s) else 2.0
    probs = st.sampled_from([WALKING, 0.2, 0.5, 0.8, IRREGULAR, STILL, 1.0, UNKNOWN])
    known = draw(st.lists(probs, min_size=int(end_s) + 3, max_size=int(end_s) + 3))
    events = in_order(contacts([float(t) for t in times_s]), windows(known))
    for place in sorted(draw(st.lists(st.integers(0, len(events)), max_size=2)), reverse=True):
        known_s = events[place - 1][0] if place else 0.0
        events.insert(place, (known_s, "gap", 0.5))
    return events


@settings(deadline=None)
@given(events=any_events())
def test_steps_come_out_once_in_order_and_not_before_they_are_known(events: Events) -> None:
    steps = passed(events)
    times_s, known_s = np.array(times_of(steps)), np.array([s.detected_time_s for s in steps])
    assert (np.diff(times_s) > 0).all()
    assert (np.diff(known_s) >= 0).all()
    assert (known_s >= times_s + STEP_LATENCY_S - 1e-9).all()
    assert set(times_s) <= {value for _, kind, value in events if kind == "step"}


@settings(deadline=None)
@given(events=any_events(), cut=st.integers(0, 200))
def test_a_state_saved_and_loaded_between_any_events_goes_on_the_same(events: Events, cut: int) -> None:
    state, steps = GATE.init(), []
    for i, event in enumerate(events):
        if i == cut % (len(events) + 1):
            state = serialise.from_bytes(serialise.to_bytes(state))
        state, found = advance(GATE, state, event)
        steps += found
    steps += GATE.finish(state, events[-1][0])[1]
    assert [(s.time_s, s.detected_time_s) for s in steps] == [(s.time_s, s.detected_time_s) for s in passed(events)]


@settings(deadline=None)
@given(events=any_events(), cut=st.integers(0, 200))
def test_later_events_change_no_step_that_is_out(events: Events, cut: int) -> None:
    """What is out after some events is the beginning of all that comes out."""
    state, early = GATE.init(), []
    for event in events[: cut % (len(events) + 1)]:
        state, found = advance(GATE, state, event)
        early += found
    assert times_of(early) == times_of(passed(events))[: len(early)]


@settings(deadline=None)
@given(events=any_events())
def test_the_state_stays_small(events: Events) -> None:
    state = GATE.init()
    for event in events:
        state, _ = advance(GATE, state, event)
        assert len(state.windows) <= 10
        assert len(state.waiting) <= 16
        assert len(state.bout) < GATE.min_steps
        assert len(state.refused) <= GATE.min_regular_steps


# --- behind the front end -------------------------------------------------------------------------------------------


def through_gate(events: list[tuple[float, Event]]) -> list[Step]:
    state, steps, known_s = GATE.init(), [], 0.0
    for known_s, event in events:
        if isinstance(event, FeatureWindow):
            prob = irregular_prob(event.names, event.features, event.has_gyroscope)
            state, found = GATE.on_window(state, known_s, event.time_s, prob)
        elif isinstance(event, Gap):
            state, found = GATE.on_gap(state, known_s, event.duration_s)
        else:
            state, found = GATE.on_step(state, known_s, event)
        steps += found
    return [*steps, *GATE.finish(state, known_s)[1]]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_gate_gives_the_same_steps_however_the_samples_are_cut(seed: int) -> None:
    sensing = Sensing(windows=FeatureWindows("invariant"))
    samples = merge_streams(demo_walk())
    whole = sensed(sensing, [samples])
    steps = through_gate(whole)
    assert steps == through_gate(sensed(sensing, cut_randomly(samples, seed)))
    assert times_of(steps) == [e.time_s for _, e in whole if isinstance(e, Step)]


def test_a_phone_that_is_turned_in_the_hand_makes_no_steps() -> None:
    rng = np.random.default_rng(0)
    time_s = (np.arange(6000) + 0.5) / 100
    angle_rad = CubicSpline(np.arange(0, 61, 0.5), rng.normal(0.0, 0.6, 122))
    push_mps2 = CubicSpline(np.arange(0, 61, 0.25), rng.normal(0.0, 0.5, (244, 3)))(time_s)
    angle = angle_rad(time_s)
    force = push_mps2 + STANDARD_GRAVITY_MPS2 * np.column_stack([np.zeros(6000), np.sin(angle), np.cos(angle)])
    rate = np.column_stack([angle_rad(time_s, 1), np.zeros(6000), np.zeros(6000)])
    events = sensed(Sensing(windows=FeatureWindows("invariant")), [imu(time_s, force, rate)])
    assert sum(isinstance(e, Step) for _, e in events) > 20
    assert through_gate(events) == []


@pytest.mark.recordings
def test_handling_makes_few_steps_and_the_walk_keeps_its_count() -> None:
    from pdr_filter.io import read

    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "ubicomp13"
    n_false, n_detected, n_passed = 0, 0, 0
    for path in sorted(folder.glob("ubicomp13_p0[1-3]*.zip")):
        recording = read(path)
        segment = recording.truth.segments[0]
        events = sensed(Sensing(windows=FeatureWindows("invariant")), [merge_streams(recording)])
        detected = np.array([e.time_s for _, e in events if isinstance(e, Step)])
        times_s = np.array(times_of(through_gate(events)))
        n_false += int(((times_s < segment["start_s"] - 1) | (times_s > segment["end_s"] + 1)).sum())
        n_detected += int(((detected >= segment["start_s"]) & (detected <= segment["end_s"])).sum())
        n_passed += int(((times_s >= segment["start_s"]) & (times_s <= segment["end_s"])).sum())
    assert n_detected > 0
    assert n_false <= 5
    assert n_passed >= 0.995 * n_detected


# --- configuration --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [{"neutral_prob": 0.0}, {"neutral_prob": 1.0}, {"mean_walk_s": 0.0}, {"mean_pause_s": -1.0}, {"min_steps": 0}],
)
def test_a_gate_that_makes_no_sense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        StepGate(**wrong)
