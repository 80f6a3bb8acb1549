"""Modes with a carrying mode, modes for irregular motion, and several modes of one context."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step, even_transitions, updates_of
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.imm.motion_model import IRREGULAR, Mode, MotionNoise
from pdr_filter.filter.imm.weighting import ModeEvidence, carrying_log_evidence
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.filter.step_length.models import known_length
from pdr_filter.sensing.contexts.context_stage import CARRYING_STAY_PROB, follow_mode
from pdr_filter.values import CARRYING_MODES, CONTEXTS, WindowContext

PRIOR = np.full(6, 1 / 6)
WALKING = CONTEXTS.index("walking")
SURE_OF_WALKING = np.where(np.arange(6) == WALKING, 0.95, 0.01)
LENGTH = known_length(0.7, 0.05)


EVEN = np.isin(CARRYING_MODES, ["texting", "pocket"]) / 2
TEXTING = np.where(np.array(CARRYING_MODES) == "texting", 0.8, 0.2) * (EVEN > 0)


def of_pair(transition_prob: np.ndarray, second: str = "pocket") -> ImmTracker:
    """A tracker of two modes of walking, with the phone in the hand and elsewhere."""
    pair = tuple(Mode(c, "walking", LENGTH, carrying_mode=c) for c in ("texting", second))
    return ImmTracker(PedestrianModel(pair, transition_prob))


def a_window(time_s: float, carrying: np.ndarray | None = None, irregular_prob: float = 0.0) -> WindowContext:
    carrying = np.full(5, 0.2) if carrying is None else carrying
    return WindowContext(time_s, SURE_OF_WALKING, PRIOR, carrying, irregular_prob=irregular_prob)


def walked(tracker: ImmTracker, windows: list[WindowContext]) -> tuple[ImmState, list[StepUpdate]]:
    """Return state and updates after two steps with each window."""
    state, updates = tracker.init(), []
    for window in windows:
        state, _ = updates_of(tracker.on_window(state, window))
        for part in (0.5, 0.0):
            state, found = updates_of(tracker.on_step(state, a_step(window.time_s - part)))
            updates += found
    return state, updates


def test_a_printed_mode_states_its_name_its_typical_step_and_what_differs_from_walking() -> None:
    walking, up = Mode("walking", step_length=LENGTH), Mode("stairs", "upstairs", known_length(0.29, 0.05), climbs=1)
    assert repr(walking) == "Mode('walking', FrequencyVarianceStepLength, 0.70 m for a typical step)"
    assert repr(up) == (
        "Mode('stairs', FrequencyVarianceStepLength, 0.29 m for a typical step, context='upstairs', climbs=1)"
    )
    assert repr(Mode("resting", moves=False)).endswith("0.00 m for a typical step, moves=False)")


# --- carrying mode --------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), unknown=st.integers(0, 2))
def test_the_evidence_of_a_window_for_a_carrying_mode_is_that_of_the_window_alone(seed: int, unknown: int) -> None:
    """`follow_mode` multiplies the prediction by (window / prior)^exponent, and the evidence is this factor."""
    rng = np.random.default_rng(seed)
    known = np.arange(5) >= unknown
    prior = np.where(known, 1.0, 0.0) / known.sum()
    before = np.where(known, rng.dirichlet(np.ones(5)), 0.0)
    before /= before.sum()
    window = np.where(known, rng.dirichlet(np.ones(5)), 0.0)
    after = follow_mode(before, window, prior, CARRYING_STAY_PROB, 0.5)
    evidence = carrying_log_evidence(after, before, 1)
    expected = 0.5 * np.log(np.maximum(window[known], 1e-9) / prior[known])
    np.testing.assert_allclose(np.diff(evidence[known]), np.diff(expected), atol=1e-9)
    np.testing.assert_array_equal(evidence[~known], 0.0)


def test_a_mode_with_a_carrying_mode_has_the_probability_of_the_carrying_mode() -> None:
    """Filter and classifier have the same transitions and the same evidence here."""
    stay = CARRYING_STAY_PROB
    tracker = of_pair(even_transitions(2, stay), "swinging")
    rng = np.random.default_rng(3)
    prior = np.isin(CARRYING_MODES, ["texting", "swinging"]) / 2
    carrying, state = prior, tracker.init()
    index = [CARRYING_MODES.index(c) for c in ("texting", "swinging")]
    for k in range(40):
        said = np.zeros(5)
        said[index] = rng.dirichlet([1.0, 1.0])
        carrying = follow_mode(carrying, said, prior, stay, 0.5)
        state, _ = updates_of(tracker.on_window(state, a_window(2.0 + k, carrying)))
        state, [update] = updates_of(tracker.on_step(state, a_step(2.0 + k)))
        np.testing.assert_allclose(update.mode_prob, carrying[index], atol=1e-9)


def test_after_a_gap_an_uninformative_window_is_no_evidence_for_the_carrying_mode() -> None:
    """The classifier keeps its probabilities over a gap. The kept probabilities are not new evidence."""
    tracker = of_pair(even_transitions(2, CARRYING_STAY_PROB))
    state, _ = walked(tracker, [a_window(2.0, TEXTING)])
    state, _ = updates_of(tracker.on_gap(state, 60.0))
    # uninformative window: only the transition changes the probabilities
    kept = follow_mode(TEXTING, EVEN, EVEN, CARRYING_STAY_PROB, 0.5)
    state, _ = updates_of(tracker.on_window(state, a_window(63.0, kept)))
    before = state.pedestrian.estimates.prob
    state, [update] = updates_of(tracker.on_step(state, a_step(63.0)))
    np.testing.assert_allclose(update.mode_prob, before @ tracker.model.transition_prob, atol=1e-9)


def test_several_uninformative_windows_without_a_step_are_no_evidence() -> None:
    tracker = of_pair(np.eye(2))
    state, updates = walked(tracker, [a_window(2.0, TEXTING)])
    before, carrying = updates[-1].mode_prob, TEXTING
    for k in range(3):  # uninformative windows: the probabilities of the classifier decay for three windows
        carrying = follow_mode(carrying, EVEN, EVEN, CARRYING_STAY_PROB, 0.5)
        state, _ = updates_of(tracker.on_window(state, a_window(3.0 + k, carrying)))
    _, [update] = updates_of(tracker.on_step(state, a_step(5.0)))
    np.testing.assert_allclose(update.mode_prob, before, atol=1e-9)
    assert carrying.max() < 0.78


def test_windows_without_a_step_are_evidence_for_the_carrying_mode() -> None:
    tracker = of_pair(np.eye(2))
    put_away = np.where(np.array(CARRYING_MODES) == "pocket", 0.98, 0.005)
    state, _ = walked(tracker, [a_window(2.0, EVEN)])
    for k in range(3):  # the person makes no steps while the phone is put away
        state, _ = updates_of(tracker.on_window(state, a_window(3.0 + k, put_away)))
    _, [update] = updates_of(tracker.on_step(state, a_step(5.0)))
    assert update.mode_prob[1] > 0.95


def test_without_a_carrying_mode_of_their_own_modes_do_not_depend_on_it() -> None:
    modes = (Mode("walk", "walking", LENGTH), Mode("run", "running", known_length(1.0, 0.1)))
    rng = np.random.default_rng(0)
    windows = [a_window(2.0 + k) for k in range(5)]
    told = [replace(w, carrying_prob=rng.dirichlet(np.ones(5))) for w in windows]
    tracker = ImmTracker(PedestrianModel(modes, even_transitions(2, 0.9)))
    one, two = (walked(tracker, w)[1][-1] for w in (windows, told))
    np.testing.assert_array_equal(one.mode_prob, two.mode_prob)


# --- irregular motion -----------------------------------------------------------------------------------------------


def with_irregular() -> ImmTracker:
    # a long step length, which must have no effect
    modes = (Mode("walk", "walking", LENGTH), Mode("handling", IRREGULAR, known_length(2.5, 0.02)))
    return ImmTracker(PedestrianModel(modes, even_transitions(2, 0.9)))


def test_in_irregular_motion_the_irregular_mode_dominates_and_the_position_stays() -> None:
    tracker = with_irregular()
    _, updates = walked(tracker, [a_window(2.0 + k, irregular_prob=0.97) for k in range(10)])
    # a step without a window of its own follows the transitions, which leave one time in ten
    assert updates[-1].mode_prob[1] > 0.85
    assert updates[-1].step_length_m < 0.1
    assert np.linalg.norm(updates[-1].position_m - updates[-9].position_m) < 8 * 0.1


def test_in_regular_motion_an_irregular_mode_hardly_shortens_the_distance() -> None:
    _, updates = walked(with_irregular(), [a_window(2.0 + k, irregular_prob=0.01) for k in range(10)])
    assert updates[-1].mode_prob[0] > 0.85
    assert updates[-1].step_length_m == pytest.approx(0.7, abs=0.1)


def test_an_irregular_probability_of_nan_is_no_evidence() -> None:
    _, updates = walked(with_irregular(), [a_window(2.0 + k, irregular_prob=np.nan) for k in range(5)])
    assert np.isfinite(updates[-1].mode_prob).all()
    # one half, the probability of a gate without information
    _, even = walked(with_irregular(), [a_window(2.0 + k, irregular_prob=0.5) for k in range(5)])
    np.testing.assert_array_equal(updates[-1].mode_prob, even[-1].mode_prob)


def test_before_the_first_window_context_probabilities_follow_from_the_modes() -> None:
    tracker = with_irregular()
    _, [update] = updates_of(tracker.on_step(tracker.init(), a_step(1.0)))
    assert update.context_prob[WALKING] == 1.0


def test_without_an_irregular_mode_the_gate_does_not_change_the_evidence() -> None:
    evidence = ModeEvidence(("walking", "running"), (None, None), 1.0, 0.2, 0.01)
    one, two = (evidence.of(a_window(2.0, irregular_prob=p), None, 1) for p in (0.0, 0.9))
    np.testing.assert_array_equal(one, two)


# --- several modes of a context -------------------------------------------------------------------------------------


def test_two_modes_of_one_context_share_its_evidence_and_fixes_distinguish_them() -> None:
    from pdr_filter.values import PositionFix

    modes = (Mode("short", "walking", known_length(0.5, 0.02)), Mode("long", "walking", known_length(0.9, 0.02)))
    noise = MotionNoise(log_scale_std=0.02)
    tracker = ImmTracker(PedestrianModel(modes, even_transitions(2, 0.99), noise=noise))
    state, updates = walked(tracker, [a_window(2.0 + k) for k in range(5)])
    np.testing.assert_allclose(updates[-1].mode_prob, 0.5, atol=1e-12)
    north_m = 0.9 * len(updates)
    state, _, _ = tracker.on_fix(state, PositionFix(6.0, np.array([0.0, north_m]), 0.04 * np.eye(2)))
    assert state.pedestrian.estimates.prob[1] > 0.99
