"""Saved filters are small, and what they leave out is not needed to continue."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from handling import handled_walk

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import ImuBlock

EVERY_S = 1.3


def parts_of(block: ImuBlock, until_s: float, every_s: float = EVERY_S) -> list[tuple[np.ndarray, ...]]:
    edges = np.searchsorted(block.time_s, np.arange(0.0, until_s, every_s))
    columns = block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut
    return [tuple(column[a:b] for column in columns) for a, b in pairwise(edges)]


def test_a_filter_saved_while_walking_has_at_most_60_kb_and_its_path_a_tenth_for_each_step() -> None:
    online = pdr.OnlineFilter()
    for part in parts_of(pdr.merge_streams(simulate([Leg("walking", distance_m=60.0)])), 40.0):
        online.push(*part)
        small = len(online.save(path=False))
        assert small < 60_000
        assert len(online.save()) - small < 11_000 + 120 * online.now().n_steps
    assert online.now().n_steps > 50


@pytest.mark.parametrize("path", [True, False])
def test_a_filter_saved_with_a_handled_phone_and_while_walking_continues_with_the_same_bits(path: bool) -> None:
    whole, resumed = pdr.OnlineFilter(), pdr.OnlineFilter()
    n_left_out = n_held = n_steps = 0
    for part in parts_of(pdr.merge_streams(handled_walk(2)), 55.0):
        updates = whole.push(*part), resumed.push(*part)
        n_steps += len(updates[0])
        bits = [[u.position_m.tobytes() + u.position_cov_m2.tobytes() for u in some] for some in updates]
        assert bits[0] == bits[1]
        before: Any = resumed.state.sensing
        saved = resumed.save(path=path)
        assert path or len(saved) < 60_000
        resumed = pdr.OnlineFilter.load(saved)
        after: Any = resumed.state.sensing
        n_left_out = max(n_left_out, before.heading.signals.shape[1] - after.heading.signals.shape[1])
        n_held = max(n_held, len(before.gate.held))
        is_same = resumed.save(path=False) == whole.save(path=False)
        assert is_same
    if path:
        is_same = resumed.save() == whole.save()
        assert is_same
        np.testing.assert_array_equal(resumed.path().position_m, whole.path().position_m)
    assert n_steps > 15 and n_held > 1 and n_left_out > 100


def test_steps_released_by_a_loaded_filter_have_the_same_bits_without_the_samples_of_their_strides() -> None:
    walk = simulate([Leg("stationary", duration_s=4.0), Leg("walking", distance_m=5.0, frequency_factor=0.5)] * 2)
    whole, resumed = pdr.OnlineFilter(), pdr.OnlineFilter()
    n_strides, left_out_s = 0, list[float]()
    for part in parts_of(pdr.merge_streams(walk), walk.duration_s, 0.7):
        steps, resumed_steps = ([update.step for update in some.push(*part)] for some in (whole, resumed))
        assert repr(steps) == repr(resumed_steps)
        # contact times are smoothed after the headings
        n_strides += sum(abs(step.time_s - t) < 0.2 for step in steps for t in left_out_s)
        resumed = pdr.OnlineFilter.load(resumed.save(path=False))
        state: Any = resumed.state.sensing.heading
        left_out_s = state.saved_strides[:, 2].tolist()
    assert n_strides > 1


class OwnGate:
    """Gate of a user, which keeps nothing and releases each step at once."""

    latency_s = 0.0

    def init(self) -> tuple[()]:
        return ()

    def update(self, state: tuple[()], block: Any, attitude: Any, contexts: Any, steps: Any) -> Any:
        return state, steps


def test_a_filter_with_a_gate_of_a_user_keeps_its_samples_when_it_is_saved() -> None:
    config = pdr.recipes.default()
    config = replace(config, sensing=replace(config.sensing, gate=cast(Any, OwnGate())))
    online = pdr.OnlineFilter(config)
    for part in parts_of(pdr.merge_streams(simulate([Leg("walking", distance_m=20.0)])), 12.0):
        online.push(*part)
    sensing: Any = online.state.sensing
    assert config.sensing.trimmed(sensing) is sensing
