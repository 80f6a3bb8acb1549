"""The chain of handlers: what each adds, and a handler of a user."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from helpers import a_step, push_part

import pdr_filter as pdr
from pdr_filter.filter.chain.handler import Around, FixUse, Fork, PathChanges, StepsEnd, TrackerHandler, states_of
from pdr_filter.filter.chain.two_hypotheses import Hypotheses, TwoHypotheses
from pdr_filter.filter.chain.with_height import WithHeight
from pdr_filter.filter.chain.with_path import PathState, WithPath
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, initial_state
from pdr_filter.values import FloatArray, PositionFix

MODEL = pdr.recipes.default().model
GATE_NIS = MODEL.fix_gate_nis


@dataclass(frozen=True, eq=False)
class At:
    """State of a handler that stays at a place and knows how well each fix fits it."""

    position_m: FloatArray
    pedestrian: PedestrianState = field(default_factory=lambda: initial_state(MODEL, np.ones(1)))


class Stays:
    """Handler with the NIS of a fix about its place. It finds the second place at the first fix."""

    def __init__(self, second_m: FloatArray, log_odds: float) -> None:
        self.second_m, self.log_odds = second_m, log_odds

    def init(self) -> At:
        return At(np.zeros(2))

    def on(self, state: At, event: Any, known_s: float) -> tuple[At, tuple[Any, ...]]:
        if not isinstance(event, PositionFix):
            return state, ()
        away_m = event.position_m - state.position_m
        use = FixUse(event, "used", float(away_m @ np.linalg.inv(event.cov_m2) @ away_m))
        if event.time_s == 0.0:
            return state, (use, Fork(At(self.second_m), self.log_odds, ()))
        return state, (use,)


def test_the_log_odds_of_two_hypotheses_are_those_of_all_fixes() -> None:
    second_m, prior = np.array([3.0, 0.0]), -0.7
    handler = TwoHypotheses(Stays(second_m, prior), GATE_NIS)
    state, rng = handler.init(), np.random.default_rng(0)
    fixes = [PositionFix(float(i), rng.normal([1.2, 0.0], 1.0), 4.0 * np.eye(2)) for i in range(6)]
    for fix in fixes:
        state, _ = handler.on(state, fix, fix.time_s)
    squares = np.array(
        [[np.sum((f.position_m - place) ** 2) / 4.0 for f in fixes[1:]] for place in (0 * second_m, second_m)]
    )
    assert squares.max() < GATE_NIS
    log_odds = prior + 0.5 * (squares[0].sum() - squares[1].sum())
    assert state.rival_log_odds == pytest.approx(-abs(log_odds))
    assert state.inner.position_m[0] == (3.0 if log_odds > 0.0 else 0.0)


def test_a_hypothesis_that_fits_better_becomes_the_track_and_the_other_is_dropped() -> None:
    second_m = np.array([30.0, 0.0])
    handler = TwoHypotheses(Stays(second_m, -0.1), GATE_NIS)
    state = handler.init()
    for time_s in (0.0, 1.0, 2.0):
        state, _ = handler.on(state, PositionFix(time_s, second_m, np.eye(2)), time_s)
    np.testing.assert_array_equal(state.inner.position_m, second_m)
    assert state.rival is None


def test_each_hypothesis_has_its_own_path() -> None:
    tracker = pdr.recipes.default().tracker
    handler = TwoHypotheses(WithPath(TrackerHandler(tracker)), GATE_NIS)
    state, _ = handler.on(handler.init(), a_step(1.0), 1.0)
    inner = state.inner
    fork = Fork(inner.inner, -1.0, (lambda path: path.after_correction(np.array([5.0, 0.0, 0.0, 0.0]), 1.0),))

    class Forks:
        def init(self) -> Any:
            return inner.inner

        def on(self, state: Any, event: Any, known_s: float) -> tuple[Any, tuple[Any, ...]]:
            return state, (PathChanges(()), FixUse(event, "placed", np.nan), fork)

    forked = TwoHypotheses(WithPath(Forks()), GATE_NIS)
    after, _ = forked.on(Hypotheses(inner), PositionFix(2.0, np.zeros(2), np.eye(2)), 2.0)

    def east_m(of: PathState) -> float:
        cov = of.pedestrian.estimates.combined[1]
        return float(of.path.positions(cov, np.zeros((2, 2)), np.zeros(2))[1][0, 0])

    assert east_m(after.rival) - east_m(after.inner) == pytest.approx(5.0)


def test_the_use_of_a_fix_has_the_storey_before_the_fix() -> None:
    handler = WithHeight(Stays(np.zeros(2), 0.0), MODEL, start_floor=2)
    fix = PositionFix(1.0, np.zeros(2), np.eye(2), floor=5)
    state, (use,) = handler.on(handler.init(), fix, 1.0)
    assert isinstance(use, FixUse)
    assert use.floor == 2
    assert state.height.known.floors.floor == 5


def test_a_chain_without_path_or_plan_has_no_state_of_them() -> None:
    config = pdr.recipes.default()
    names = [type(part).__name__ for part in states_of(replace(config, keeps_path=False).chain.init())]
    assert names == ["HeightTrack", "Hypotheses", "ImmState"]
    assert [type(part).__name__ for part in states_of(config.chain.init())][2] == "PathState"


@pytest.mark.parametrize("weighting", ["imm", "hc"])
def test_the_end_of_the_steps_makes_all_steps_final(weighting: str) -> None:
    chain = pdr.recipes.default().with_weighting(weighting).chain
    state, outputs = chain.init(), []
    for event in (a_step(0.5), a_step(1.0), StepsEnd()):
        state, new = chain.on(state, event, 1.0)
        outputs += new
    assert [row.index for row in outputs if isinstance(row, pdr.StepUpdate) and row.is_final] == [0, 1]


@dataclass(frozen=True, eq=False)
class Count(Around):
    n_rows: int = 0


class Counting:
    """Handler of a user: counts the rows that pass."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def init(self) -> Count:
        return Count(self.inner.init())

    def on(self, state: Count, event: Any, known_s: float) -> tuple[Count, tuple[Any, ...]]:
        inner, outputs = self.inner.on(state.inner, event, known_s)
        n_new = sum(isinstance(output, pdr.StepUpdate) for output in outputs)
        return replace(state, inner=inner, n_rows=state.n_rows + n_new), outputs


def test_a_filter_with_a_handler_of_a_user_is_saved_and_continues() -> None:
    samples = pdr.merge_streams(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=12.0)], seed=1))
    config = pdr.recipes.default().with_handler(Counting)
    online = pdr.OnlineFilter(config)
    middle = len(samples.time_s) // 2
    for part in (slice(middle), slice(middle, None)):
        online = pdr.OnlineFilter.load(online.save(), config=config)
        push_part(online, samples, part)
    online.finish()
    assert isinstance(online.state.chain, Count)
    assert online.state.chain.n_rows == online.now().n_steps > 10
