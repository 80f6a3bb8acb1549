from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import flat_attitude, uniform_block

from pdr_filter.sensing.steps.step_log import USUAL_DECAY, StepLog, StepLogState, amplitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Step

LOG = StepLog(rate_hz=100.0, latency_s=0.8)


def logged(contacts: list[int], amplitude: np.ndarray) -> list[Step]:
    """Steps of contacts at samples of a signal of one sine for each half second, with an amplitude for each sample."""
    t = np.arange(len(amplitude)) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + amplitude * np.sin(2 * np.pi * 2.0 * t)
    state: StepLogState = LOG.extend(LOG.init(), uniform_block(magnitude), flat_attitude(magnitude))
    steps = []
    for contact in contacts:
        state, step = LOG.add(state, contact, contact + 80)
        steps.append(step)
    return steps


def test_the_first_step_of_a_bout_and_one_after_a_pause_begin_with_a_rest() -> None:
    contacts = [100, 150, 200, 250, 350, 400, 700, 750]  # a pause of a second, and one of three
    walks = np.full(900, 2.0)
    walks[255:345] = walks[405:695] = 0.0
    assert [s.from_rest for s in logged(contacts, walks)] == [True, False, False, False, True, False, True, False]


def test_a_long_step_with_two_bounces_is_two_steps_and_does_not_change_the_usual_duration() -> None:
    contacts = [100, 150, 200, 250, 350, 400]
    steps = logged(contacts, np.full(600, 2.0))
    assert [s.from_rest for s in steps] == [True, False, False, False, False, False]
    assert [s.is_two for s in steps] == [False, False, False, False, True, False]
    assert steps[4].usual_amplitude_mps2 == steps[3].usual_amplitude_mps2
    assert steps[5].stride_amplitude_mps2 == steps[5].vertical_amplitude_mps2


def test_a_long_step_while_running_is_a_rest_whatever_its_amplitude() -> None:
    t = np.arange(400) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + 2.0 * np.sin(2 * np.pi * 2.5 * t)
    state = LOG.extend(LOG.init(), uniform_block(magnitude), flat_attitude(magnitude))
    steps = []
    for contact in (80, 120, 160, 200, 280):
        state, step = LOG.add(state, contact, contact + 80)
        steps.append(step)
    assert [s.from_rest for s in steps] == [True, False, False, False, True]


def test_a_slow_walker_does_not_rest_between_steps() -> None:
    steps = logged([100, 240, 385, 525, 670], np.full(900, 2.0))
    assert [s.from_rest for s in steps] == [True, False, False, False, False]


def test_usual_duration_and_unevenness_come_from_earlier_steps_without_pauses() -> None:
    walks = np.full(900, 2.0)
    walks[315:445] = 0.0
    steps = logged([100, 150, 200, 260, 310, 450, 500], walks)
    assert [s.usual_duration_s for s in steps[:2]] == [0.0, 0.0]
    assert steps[2].usual_duration_s == pytest.approx(0.5)
    assert [s.unevenness for s in steps[:4]] == pytest.approx([0.0, 0.0, 0.0, 0.2])
    assert steps[5].unevenness == 1.0
    assert steps[6].usual_duration_s == pytest.approx(steps[5].usual_duration_s)


def test_the_usual_amplitude_is_the_geometric_mean_of_the_steps_so_far_without_those_from_rest() -> None:
    amplitude = np.concatenate([np.full(150, 5.0), np.full(50, 2.0), np.full(50, 1.0), np.full(150, 3.0)])
    steps = logged([150, 200, 250, 300], amplitude)
    assert steps[0].usual_amplitude_mps2 == 0.0
    logs, weights = np.log([2.0, 1.0, 3.0]), USUAL_DECAY ** np.array([2.0, 1.0, 0.0])
    assert steps[1].usual_amplitude_mps2 == pytest.approx(2.0, rel=1e-6)
    assert steps[3].usual_amplitude_mps2 == pytest.approx(np.exp(np.average(logs, weights=weights)), rel=1e-6)
    assert steps[2].vertical_amplitude_mps2 == pytest.approx(1.0, rel=1e-6)


def test_the_amplitude_of_a_stride_is_the_mean_of_its_two_steps_and_does_not_reach_back_over_a_rest() -> None:
    amplitude = np.concatenate([np.full(200, 2.0), np.full(50, 1.0), np.full(50, 3.0), np.full(250, 2.0)])
    steps = logged([150, 200, 250, 300, 450, 500], amplitude)
    assert [s.from_rest for s in steps] == [True, False, False, False, True, False]
    assert [s.stride_amplitude_mps2 for s in steps[1:4]] == pytest.approx([2.0, 1.5, 2.0], rel=1e-6)
    for alone in (steps[0], *steps[4:]):
        assert alone.stride_amplitude_mps2 == alone.vertical_amplitude_mps2


def test_a_single_sample_has_no_amplitude() -> None:
    assert amplitude(np.array([4.0])) == 0.0


def test_the_turn_rate_is_that_of_the_stride_without_the_sway_of_its_two_steps() -> None:
    """A person who turns by 0.4 rad/s and sways by 0.1 rad once in a stride of 1 s."""
    t = np.arange(900) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + 2.0 * np.sin(2 * np.pi * 2.0 * t)
    attitude = replace(flat_attitude(magnitude), device_heading_rad=-0.4 * t + 0.1 * np.sin(2 * np.pi * t + 0.3))
    state, steps = LOG.extend(LOG.init(), uniform_block(magnitude), attitude), []
    for contact in range(100, 800, 50):
        state, step = LOG.add(state, contact, contact + 80)
        steps.append(step)
    assert [s.turn_rate_radps for s in steps[2:]] == pytest.approx([0.4] * 12, rel=0.06)


def test_a_turn_before_a_pause_does_not_count_for_the_step_after_it() -> None:
    t = np.arange(900) / 100
    magnitude = STANDARD_GRAVITY_MPS2 + 2.0 * np.sin(2 * np.pi * 2.0 * t)
    attitude = replace(flat_attitude(magnitude), device_heading_rad=np.minimum(t, 2.0))
    state, rates = LOG.extend(LOG.init(), uniform_block(magnitude), attitude), []
    for contact in (100, 150, 200, 700):
        state, step = LOG.add(state, contact, contact + 80)
        rates.append(step.turn_rate_radps)
    assert rates[1:] == pytest.approx([0.98, 0.98, 0.0], abs=0.03)
