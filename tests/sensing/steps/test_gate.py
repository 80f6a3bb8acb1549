from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import a_step, bumps, cut_uniform, flat_attitude, imu, sensed, uniform_block, walk_of_bumps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from pdr_filter.data.io.formats import read
from pdr_filter.sensing.conditioning import UniformBlock, merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.step_detector import unknown_contexts
from pdr_filter.sensing.steps.step_gate import StepGate, StepGateState
from pdr_filter.sensing.steps.walking_evidence import (
    EVIDENCE,
    WalkEvidence,
    autocorrelation_peaks,
    evidence_features,
    slowness,
)
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Step

STEP_LATENCY_S = 0.88
GATE = StepGate()


class Told:
    """Evidence with log odds given by a test, in the order of the steps."""

    def __init__(self, log_odds: Sequence[float]) -> None:
        self.left = list(log_odds)

    def log_odds(self, features: FloatArray) -> FloatArray:
        return np.array([self.left.pop(0) for _ in features])


def told_gate(log_odds: Sequence[float], **kwargs: float) -> StepGate:
    return StepGate(evidence=Told(log_odds), evidence_weight=1.0, **kwargs)  # type: ignore[arg-type]


def known_steps(times_s: Sequence[float]) -> list[tuple[int, Step]]:
    """Steps as the detector gives them, in a segment that starts at time zero."""
    found = []
    for time_s in times_s:
        number = math.ceil((time_s + STEP_LATENCY_S) * 100 - 0.5)
        found.append((number, replace(a_step(time_s), detected_time_s=(number + 0.5) / 100)))
    return found


def update(gate: StepGate, state: StepGateState, block: UniformBlock, steps: list[tuple[int, Step]]) -> tuple:
    attitude, contexts = flat_attitude(block.specific_force_mps2[:, 2]), unknown_contexts(len(block.time_s))
    return gate.update(state, block, attitude, contexts, steps)


def advance(gate: StepGate, blocks: list[UniformBlock], steps: list[tuple[int, Step]], n_before: int = 0) -> tuple:
    """State and released steps after some blocks; the steps that are known by then."""
    state, released = gate.init(), []
    for block in blocks:
        n_after = n_before + len(block.time_s)
        part = [s for s in steps if n_before <= s[0] < n_after]
        state, out = update(gate, state, block, part)
        released += out
        n_before = n_after
    return state, released


def passed(gate: StepGate, times_s: Sequence[float], rest_s: float = 3.0) -> list[Step]:
    """Steps that pass the gate, including those released at the end."""
    block = uniform_block(np.full(int(100 * (max(times_s, default=0.0) + rest_s)), STANDARD_GRAVITY_MPS2))
    state, released = advance(gate, [block], known_steps(times_s))
    return [s for _, s in [*released, *gate.finish(state, [])[1]]]


def times_of(steps: Sequence[Step]) -> list[float]:
    return [s.time_s for s in steps]


def walk_block(times_s: Sequence[float], duration_s: float, amplitude_mps2: float = 3.0, seed: int = 0) -> UniformBlock:
    """A phone that bounces at each contact, tilted and a little noisy."""
    time_s = (np.arange(int(duration_s * 100)) + 0.5) / 100
    rng = np.random.default_rng(seed)
    magnitude = bumps(time_s, np.array(times_s), amplitude_mps2, 0.225 / 0.12)
    block = uniform_block(magnitude)
    force = np.outer(magnitude, [0.0, 0.6, 0.8]) + rng.normal(0.0, 0.1, (len(time_s), 3))
    return replace(block, specific_force_mps2=force)


# --- the evidence ---------------------------------------------------------------------------------------------------


def of_one(force: FloatArray, intervals_s: Sequence[float]) -> FloatArray:
    """Features (4,) of one step."""
    return evidence_features([force], [intervals_s])[0]


def repetition(signals: FloatArray, n_lags: int = 57) -> FloatArray:
    """Repetition (B,) of vectors (B, N, 3); the repetition of their first axis alone differs."""
    of_all = np.concatenate([signals, signals[:, :, :1]], axis=2).swapaxes(1, 2)
    return autocorrelation_peaks(of_all - of_all.mean(axis=2, keepdims=True), n_lags)[:, 0]


@given(seed=st.integers(0, 1000), n_lags=st.integers(20, 49))
def test_repetition_is_the_autocorrelation_of_the_vectors_written_as_a_sum(seed: int, n_lags: int) -> None:
    x = np.random.default_rng(seed).normal(size=(60, 3)).cumsum(axis=0)
    d = x - x.mean(axis=0)
    of_one_axis = autocorrelation_peaks(np.concatenate([d, d[:, 1:2]], axis=1).T[None], n_lags)[0, 1]
    for found, v in ((repetition(x[None], n_lags)[0], d), (of_one_axis, d[:, 1:2])):
        r = [1.0]
        for lag in range(1, n_lags):
            a, b = v[:-lag], v[lag:]
            r.append(float((a * b).sum() / math.sqrt((a**2).sum() * (b**2).sum())))
        negative = next((i for i, c in enumerate(r) if c < 0), None)
        expected = max(0.0, max(r[negative:])) if negative is not None else 0.0
        assert found == pytest.approx(expected, abs=1e-6)


def test_a_step_has_the_same_features_alone_and_among_others() -> None:
    rng = np.random.default_rng(0)
    windows = [rng.normal(size=(n, 3)) for n in rng.choice([26, 60, 88, 150], 200)]
    intervals_s = [rng.uniform(0.4, 1.5, rng.integers(0, 4)).tolist() for _ in windows]
    alone = [of_one(*of_step) for of_step in zip(windows, intervals_s, strict=True)]
    np.testing.assert_array_equal(evidence_features(windows, intervals_s), alone)


@given(seed=st.integers(0, 1000))
def test_the_features_do_not_change_when_the_phone_is_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force = rng.normal(size=(88, 3)) + np.array([0.0, 0.0, 9.8])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    intervals_s = (0.6, 0.5, 0.6)
    turned = of_one(np.ascontiguousarray(force @ turn), intervals_s)
    np.testing.assert_allclose(of_one(force, intervals_s), turned, rtol=1e-6)


def test_the_rhythm_is_the_scatter_of_three_intervals_and_unknown_before() -> None:
    force = np.random.default_rng(0).normal(size=(88, 3))
    assert of_one(force, (0.5, 0.5, 0.5))[1] == pytest.approx(0.0, abs=1e-9)
    assert of_one(force, (0.5, 0.6, 0.4))[1] == pytest.approx(np.std(np.log([0.5, 0.6, 0.4])))
    assert of_one(force, (0.5, 0.5))[1] == 0.5


def test_a_pause_does_not_count_as_an_interval_of_the_rhythm() -> None:
    seen: list[float] = []

    class Told:
        def log_odds(self, features: FloatArray) -> FloatArray:
            seen.extend(features[:, 1])
            return np.full(len(features), 9.0)

    passed(StepGate(evidence=Told()), [2.0, 2.5, 3.0, 3.5, 6.1, 6.6, 7.1])  # type: ignore[arg-type]
    np.testing.assert_allclose(seen, [0.5, 0.5, 0.5, 0.0, 0.5, 0.5, 0.5], atol=1e-9)


def walking_force(cadence_hz: float, bounce_mps2: float, duration_s: float) -> FloatArray:
    """A phone in a pocket at 25 Hz: it bounces with each step and tilts with each stride."""
    t = np.arange(round(25 * duration_s)) / 25
    tilt = 0.3 * np.sin(np.pi * cadence_hz * t)
    up = np.column_stack([np.sin(tilt), np.zeros(len(t)), np.cos(tilt)])
    return (STANDARD_GRAVITY_MPS2 + bounce_mps2 * np.sin(2 * np.pi * cadence_hz * t))[:, None] * up


@pytest.mark.parametrize("c", [1.3, 1.7, 2.2])
def test_repetition_and_rhythm_do_not_depend_on_the_pace(c: float) -> None:
    usual = of_one(walking_force(1 / 0.6, 3.0, 3.52), [0.6] * 3)
    slow = of_one(walking_force(1 / 0.6 / c, 3.0 / c**2, 3.52 * c), [0.6 * c] * 3)
    np.testing.assert_allclose(np.delete(slow, 2), np.delete(usual, 2), atol=0.06)
    assert usual[0] > 0.8
    # the bounce is c^2 times weaker and counts c times as much
    assert slow[2] - usual[2] == pytest.approx(np.log(c), abs=0.15)


def test_time_scales_are_not_compressed_for_fast_walkers_and_their_stretch_is_bounded() -> None:
    assert slowness([]) == slowness([0.3] * 3) == slowness([0.6] * 3) == 1.0
    assert slowness([0.9, 0.9, 0.3]) == pytest.approx(1.5)
    assert slowness([2.4] * 3) == 2.2


def test_a_walk_has_high_odds_and_a_phone_that_is_turned_low_ones() -> None:
    contacts_s = [0.5 + 0.55 * i for i in range(7)]
    force = walk_block(contacts_s, 3.52).specific_force_mps2.reshape(-1, 4, 3).mean(axis=1)
    assert EVIDENCE.log_odds(of_one(force, [0.55] * 3)[None]) > 4
    t = np.arange(88) / 25
    tilt = 1.2 * np.sin(2 * np.pi * 0.2 * t) + 0.3 * np.sin(5.0 * t)
    turned = 9.8 * np.column_stack([np.sin(tilt), np.zeros(88), np.cos(tilt)])
    turned += np.random.default_rng(0).normal(0.0, 0.3, (88, 3))
    assert EVIDENCE.log_odds(of_one(turned, (0.9, 0.4, 0.7))[None]) < -3


def test_the_log_odds_are_a_weighted_sum_of_clipped_features() -> None:
    evidence = WalkEvidence(np.zeros(4), np.ones(4), np.array([1.0, 2.0, 3.0, 4.0]), 0.5)
    assert evidence.log_odds(np.array([[1.0, 0.0, -1.0, 0.0]])) == pytest.approx(-1.5)
    assert evidence.log_odds(np.array([[99.0, -99.0, 0.0, 0.0]])) == pytest.approx(0.5 + 3.0 - 6.0)


# --- bouts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [4, 5, 20, 60])
@pytest.mark.parametrize("interval_s", [0.3, 0.55, 1.0, 2.0])
def test_a_bout_of_certain_walking_passes_whole(n: int, interval_s: float) -> None:
    times_s = [2.0 + i * interval_s for i in range(n)]
    assert times_of(passed(told_gate([9.0] * n), times_s)) == times_s


@pytest.mark.parametrize("n", [1, 2, 3])
def test_fewer_steps_than_a_bout_are_dropped_even_if_they_walk(n: int) -> None:
    assert passed(told_gate([9.0] * n), [2.0 + 0.5 * i for i in range(n)]) == []


def test_a_bout_may_be_as_short_as_asked_for() -> None:
    assert times_of(passed(told_gate([9.0], min_steps=1), [3.0])) == [3.0]


def test_after_a_pause_a_new_bout_begins() -> None:
    first = [2.0 + 0.5 * i for i in range(6)]
    few = [first[-1] + 2.6 + 0.5 * i for i in range(3)]
    assert times_of(passed(told_gate([9.0] * 9), first + few)) == first


def test_rejected_steps_inside_a_bout_belong_to_it() -> None:
    times_s = [2.0 + 0.5 * i for i in range(30)]
    log_odds = [9.0] * 30
    log_odds[14:17] = [-3.0, -9.0, -3.0]
    assert times_of(passed(told_gate(log_odds), times_s)) == times_s


def test_handling_before_and_after_a_walk_loses_its_steps_and_the_walk_keeps_its_own() -> None:
    times_s = [2.0 + 0.5 * i for i in range(60)]
    log_odds = [-4.0] * 20 + [4.0] * 20 + [-4.0] * 20
    # one step after the walk passes: the belief of 20 steps does not fall at once; two are filled in before it
    assert times_of(passed(told_gate(log_odds, n_fill=0), times_s)) == times_s[20:41]
    assert times_of(passed(told_gate(log_odds), times_s)) == times_s[18:41]


def test_steps_with_weak_evidence_before_a_bout_belong_to_it_once_it_exists() -> None:
    times_s = [2.0 + 0.5 * i for i in range(14)]
    log_odds = [-9.0] * 4 + [-0.5, -0.3] + [4.0] * 8
    assert times_of(passed(told_gate(log_odds, n_fill=0), times_s)) == times_s[4:]


# --- the smoother ---------------------------------------------------------------------------------------------------


def all_paths(gate: StepGate, log_ratios: Sequence[float], times_s: Sequence[float], at: int) -> float:
    """Walking at one of the contacts by summing over all paths of a chain on a fine grid."""
    n_fine = 4000
    share = gate.mean_walk_s / (gate.mean_walk_s + gate.mean_pause_s)
    before, after = np.array([1 - share, share]), np.ones(2)
    moves = []
    for a, b in pairwise(times_s):
        enter, leave = (b - a) / n_fine / gate.mean_pause_s, (b - a) / n_fine / gate.mean_walk_s
        moves.append(np.linalg.matrix_power(np.array([[1 - enter, enter], [leave, 1 - leave]]), n_fine))
    seen = [np.diag([1.0, math.exp(r)]) for r in log_ratios]
    for i in range(at + 1):
        before = before @ (moves[i - 1] if i else np.eye(2)) @ seen[i]
    for i in range(len(times_s) - 1, at, -1):
        after = moves[i - 1] @ seen[i] @ after
    return float((before * after)[1] / (before * after).sum())


@settings(max_examples=30, deadline=None)
@given(
    log_odds=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=6),
    intervals_s=st.lists(st.floats(0.3, 1.2), min_size=6, max_size=6),
)
def test_the_probabilities_are_those_of_a_two_state_markov_chain_over_all_paths(
    log_odds: list[float], intervals_s: list[float]
) -> None:
    times_s = list(2.0 + np.cumsum(intervals_s[: len(log_odds)]))
    gate = told_gate(log_odds, min_steps=99)
    state, _ = advance(gate, [uniform_block(np.full(1500, 9.8))], known_steps(times_s))
    last = len(times_s) - 1
    assert state.walking_prob == pytest.approx(all_paths(gate, log_odds, times_s, last), abs=1e-3)
    # backwards: the first step's probability decides whether it is part of the run
    for threshold in (0.05, 0.95):
        probs = [all_paths(gate, log_odds, times_s, i) for i in range(last + 1)]
        if len(state.held) == last + 1 and all(abs(p - threshold) > 0.01 for p in probs):
            run = replace(state, run_s=(times_s[-1], times_s[-1]))
            first, _ = replace(gate, min_edge_prob=threshold)._run(run)
            expected = last
            while expected > 0 and probs[expected - 1] > threshold:
                expected -= 1
            assert first == expected


# --- when -----------------------------------------------------------------------------------------------------------


def test_in_a_bout_a_step_is_known_about_a_second_after_it_and_the_first_steps_within_three() -> None:
    times_s = [2.0 + 0.53 * i for i in range(60)]
    steps = passed(told_gate([9.0] * 60), times_s)
    latency_s = np.array([s.detected_time_s - s.time_s for s in steps])
    assert latency_s[4:].max() <= GATE.latency_s + 0.05
    assert latency_s.min() >= GATE.latency_s - 0.05
    assert latency_s.max() <= GATE.latency_s + 3 * 0.53 + 0.05 < 3.0
    assert len({s.detected_time_s for s in steps[:4]}) == 1


def test_only_the_time_at_which_a_step_became_known_changes() -> None:
    times_s = [5.0 + 0.5 * i for i in range(10)]
    steps = passed(told_gate([9.0] * 10), times_s)
    assert [replace(s, detected_time_s=0.0) for s in steps] == [
        replace(a_step(t), detected_time_s=0.0) for t in times_s
    ]


def test_a_step_that_the_detector_finds_late_passes_when_it_is_known() -> None:
    times_s = [2.0 + 0.5 * i for i in range(10)]
    steps = [(number + 250, replace(s, detected_time_s=s.detected_time_s + 2.5)) for number, s in known_steps(times_s)]
    _, released = advance(told_gate([9.0] * 10), [uniform_block(np.full(1500, 9.8))], steps)
    assert [number for number, _ in released[4:]] == [number for number, _ in steps[4:]]


def test_the_end_decides_the_waiting_steps() -> None:
    times_s = [2.0 + 0.5 * i for i in range(10)]
    gate = told_gate([9.0] * 10)
    early, late = known_steps(times_s)[:9], [(694, a_step(times_s[9]))]
    state, released = advance(gate, [uniform_block(np.full(695, 9.8))], early)
    assert len(released) < 9
    state, rest = gate.finish(state, late)
    assert times_of([s for _, s in [*released, *rest]]) == times_s
    assert {number for number, _ in rest} == {694}
    assert gate.finish(state, [])[1] == []


def test_a_bout_goes_on_after_a_short_gap_and_not_after_a_long_one() -> None:
    times_s = [2.0 + 0.5 * i for i in range(8)]
    for gap_s, n in [(0.8, 3), (5.0, 0)]:
        gate = told_gate([9.0] * 11)
        state, released = advance(gate, [uniform_block(np.full(640, 9.8))], known_steps(times_s))
        state, rest = gate.finish(state, [])
        assert len(released) + len(rest) == 8
        block = uniform_block(np.full(500, 9.8), start_s=6.4 + gap_s, gap_before_s=gap_s)
        later = [(number, a_step(6.4 + gap_s + 0.005 + number / 100 - 0.9)) for number in (100, 150, 200)]
        state, after = update(gate, state, block, later)
        assert len(after) == n
        assert all(0 <= number < 500 for number, _ in after)


def test_a_gap_drops_steps_that_do_not_form_a_bout() -> None:
    gate = told_gate([9.0] * 6)
    state, released = advance(gate, [uniform_block(np.full(400, 9.8))], known_steps([1.0, 1.5, 2.0]))
    state, rest = gate.finish(state, [])
    assert [*released, *rest] == []
    block = uniform_block(np.full(400, 9.8), start_s=4.5, gap_before_s=0.5)
    later = [(number, a_step(4.505 + number / 100 - 0.9)) for number in (95, 145, 195)]
    assert update(gate, state, block, later)[1] == []


# --- any steps ------------------------------------------------------------------------------------------------------


@st.composite
def any_steps(draw: st.DrawFn) -> tuple[list[float], list[float]]:
    intervals_s = draw(st.lists(st.floats(0.25, 3.0), min_size=1, max_size=30))
    odds = draw(st.lists(st.floats(-6.0, 6.0), min_size=len(intervals_s), max_size=len(intervals_s)))
    return [float(t) for t in 0.5 + np.cumsum(intervals_s)], odds


@settings(deadline=None)
@given(steps=any_steps())
def test_steps_come_out_once_in_order_and_not_before_they_are_known(steps: tuple[list[float], list[float]]) -> None:
    times_s, odds = steps
    out = passed(told_gate(odds), times_s)
    found_s, known_s = np.array(times_of(out)), np.array([s.detected_time_s for s in out])
    assert (np.diff(found_s) > 0).all()
    assert (np.diff(known_s) >= 0).all()
    assert (known_s >= found_s + STEP_LATENCY_S - 0.01).all()
    assert set(found_s) <= set(times_s)


@settings(deadline=None)
@given(steps=any_steps())
def test_the_state_stays_small(steps: tuple[list[float], list[float]]) -> None:
    times_s, odds = steps
    gate = told_gate(odds)
    block = uniform_block(np.full(int(100 * (times_s[-1] + 3)), 9.8))
    state, n = gate.init(), 0
    for part in cut_uniform(block, list(range(100, len(block.time_s), 100))):
        known = [s for s in known_steps(times_s) if n <= s[0] < n + len(part.time_s)]
        state, _ = update(gate, state, part, known)
        n += len(part.time_s)
        assert len(state.rows) <= 300
        assert len(state.waiting) <= 6
        assert len(state.held) <= 32


# --- behind the detector --------------------------------------------------------------------------------------------

DETECTED = Sensing(steps=AdaptiveStepDetector())
GATED = Sensing(steps=AdaptiveStepDetector(), gate=GATE)


def steps_from(sensing: Sensing, blocks: list) -> list[Step]:
    return [e for _, e in sensed(sensing, blocks) if isinstance(e, Step)]


@pytest.mark.parametrize(("frequency_hz", "amplitude_mps2"), [(0.5, 2.0), (1.0, 2.0), (1.8, 4.0), (2.7, 12.0), (4, 20)])
def test_steps_of_any_frequency_pass(frequency_hz: float, amplitude_mps2: float) -> None:
    contacts_s, magnitude = walk_of_bumps(frequency_hz, amplitude_mps2)
    time_s = (np.arange(len(magnitude)) + 0.5) / 100
    out = steps_from(GATED, [imu(time_s, np.outer(magnitude, [0.0, 0.6, 0.8]))])
    inside = [s for s in out if contacts_s[0] - 0.1 < s.time_s < contacts_s[-1] + 0.1]
    assert len(inside) == 20


def handled(kind: str, duration_s: float = 60.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, force and rate of a phone that moves although the person does not walk."""
    rng = np.random.default_rng(0)
    n = int(duration_s * 100)
    time_s = (np.arange(n) + 0.5) / 100
    knots_s = np.arange(0.0, duration_s + 1, 0.5)
    turn = {"turned": 0.6, "typed on": 0.04, "put in a bag": 1.5, "held by a sitting person": 0.01}[kind]
    angle_rad = CubicSpline(knots_s, rng.normal(0.0, turn, len(knots_s)))
    push = 0.5 * CubicSpline(knots_s, rng.normal(0.0, 1.0, (len(knots_s), 3)))(time_s)
    if kind == "typed on":  # taps at uneven times
        taps_s = np.cumsum(rng.exponential(0.35, 200) + 0.12)
        taps = np.exp(-((time_s[:, None] - taps_s) ** 2) / (2 * 0.02**2)).sum(axis=1)
        push = 0.1 * push - 1.5 * np.outer(taps, [0.0, 0.0, 1.0])
    if kind == "held by a sitting person":
        push = 0.1 * push
    angle = angle_rad(time_s)
    force = push + STANDARD_GRAVITY_MPS2 * np.column_stack([np.zeros(n), np.sin(angle), np.cos(angle)])
    rate = np.column_stack([angle_rad(time_s, 1), np.zeros(n), np.zeros(n)])
    return time_s, force, rate


@pytest.mark.parametrize("kind", ["turned", "typed on", "put in a bag", "held by a sitting person"])
@pytest.mark.parametrize("with_gyroscope", [True, False])
def test_a_phone_that_is_handled_makes_no_steps(kind: str, with_gyroscope: bool) -> None:
    time_s, force, rate = handled(kind)
    samples = imu(time_s, force, rate) if with_gyroscope else imu(time_s, force)
    assert steps_from(GATED, [samples]) == []
    if kind in ("turned", "put in a bag"):
        assert len(steps_from(DETECTED, [samples])) > 20


@pytest.mark.recordings
def test_handling_makes_few_steps_and_the_walk_keeps_its_count(data_dir: Path) -> None:
    n_false, handled_s, n_detected, n_passed = 0, 0.0, 0, 0
    for path in sorted((data_dir / "ubicomp13").glob("ubicomp13_p0[89]*.zip")):
        recording = read(path)
        assert recording.truth.segments is not None
        [segment] = recording.truth.segments
        samples = merge_streams(recording)
        detected = np.array(times_of(steps_from(DETECTED, [samples])))
        out = np.array(times_of(steps_from(GATED, [samples])))
        n_false += int(((out < segment.start_s - 1) | (out > segment.end_s + 1)).sum())
        handled_s += max(0.0, segment.start_s - 1) + max(0.0, samples.time_s[-1] - segment.end_s - 1)
        n_detected += int(((detected >= segment.start_s) & (detected <= segment.end_s)).sum())
        n_passed += int(((out >= segment.start_s) & (out <= segment.end_s)).sum())
    assert handled_s > 300
    assert 60 * n_false / handled_s <= 1.0
    assert n_passed >= 0.995 * n_detected > 500


@pytest.mark.recordings
def test_people_who_sit_and_stand_make_no_steps(data_dir: Path) -> None:
    paths = [p for kind in ("sit", "std") for p in sorted((data_dir / "motionsense").glob(f"*_{kind}_*.zip"))]
    assert len(paths) == 48
    assert sum(len(steps_from(GATED, [merge_streams(read(p))])) for p in paths[::3]) == 0
