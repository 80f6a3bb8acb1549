from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import cut_randomly, pushed, sensed

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.front_end import Sensing, SensingForTwoPasses
from pdr_filter.sensing.heading.walking_heading import KnownPlacement, WalkingHeading
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    FloatArray,
    ImuBlock,
    Samples,
    Step,
    WindowContext,
    known_context,
)
from pdr_filter.values.events import Gap
from tests.sensed_once import MIN_SAMPLES, sense_once

WALKING, POCKET, TEXTING = CONTEXTS.index("walking"), CARRYING_MODES.index("pocket"), CARRYING_MODES.index("texting")


@dataclass(frozen=True)
class Announcements:
    """Context stage that returns given probabilities at given samples of the segment."""

    at: tuple[tuple[int, str, str], ...]
    rate_hz: float = 100.0
    contexts: tuple[str, ...] = CONTEXTS

    def init(self) -> int:
        return 0

    def after_gap(self, state: int) -> int:
        return 0

    def update(
        self, state: int, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[int, list[tuple[int, WindowContext]]]:
        end = state + len(block.time_s)
        said = [
            (
                i,
                known_context(
                    float(block.time_s[i - state]), {context: 1.0}, {mode: 1.0} if mode else {}, CONTEXTS, ""
                ),
            )
            for i, context, mode in self.at
            if state <= i < end
        ]
        return end, said


class Listener(WaveletStepDetector):
    """Step detector that stores the carrying modes that it receives."""

    heard: list[ContextBlock]

    def update(self, state, block, attitude, modes):  # type: ignore[no-untyped-def]
        self.heard.append(modes)
        return super().update(state, block, attitude, modes)


def modes_heard(blocks: list) -> tuple[np.ndarray, np.ndarray]:
    listener = Listener()
    object.__setattr__(listener, "heard", [])
    stage = Announcements(((123, "walking", "pocket"), (457, "walking", ""), (460, "stationary", "texting")))
    sensed(Sensing(steps=listener, contexts=stage), blocks)
    return tuple(np.concatenate([getattr(m, name) for m in listener.heard]) for name in ("context", "carrying_mode"))


def test_a_step_detector_receives_a_mode_from_its_window_on_however_samples_arrive() -> None:
    samples = pdr.merge_streams(simulate([Leg("walking", distance_m=10.0)]))
    for blocks in ([samples], cut_randomly(samples, 1), cut_randomly(samples, 2, mean_length=3)):
        context, carrying_mode = modes_heard(blocks)
        assert (context[:123] == -1).all()
        assert (context[123:460] == WALKING).all()
        assert (context[460:] == CONTEXTS.index("stationary")).all()
        assert (carrying_mode[:123] == -1).all()
        assert (carrying_mode[123:457] == POCKET).all()
        assert (carrying_mode[457:460] == -1).all()  # all modes equally probable: none has half of the probability
        assert (carrying_mode[460:] == TEXTING).all()


@pytest.mark.parametrize("name", sorted(recipes.RECIPES))
def test_every_recipe_gives_the_same_track_however_samples_arrive(name: str) -> None:
    walk = simulate(
        [Leg("walking", distance_m=15.0), Leg("walking", distance_m=10.0, turn_rad=1.5, carrying_mode="pocket")], seed=4
    )
    config = recipes.for_recording(name, walk)
    whole = pdr.track(walk, config)
    _, updates = pushed(pdr.OnlineFilter(config), cut_randomly(pdr.merge_streams(walk), 7), n_resumed=5)
    final = [u for u in updates if u.is_final]
    np.testing.assert_array_equal([u.position_m for u in final], whole.position_m)
    np.testing.assert_array_equal([u.step.time_s for u in final], whole.time_s)
    assert whole.n_steps > 20


@pytest.mark.parametrize("name", sorted(recipes.RECIPES))
def test_the_distance_of_every_recipe_is_about_right_and_it_survives_a_gap(name: str) -> None:
    walk = simulate([Leg("walking", distance_m=40.0)], seed=2)
    assert walk.gyroscope is not None

    def with_gap(samples: Samples) -> Samples:
        keep = (samples.time_s < 12.0) | (samples.time_s > 14.0)
        return Samples(samples.time_s[keep], samples.values[keep])

    torn = replace(walk, accelerometer=with_gap(walk.accelerometer), gyroscope=with_gap(walk.gyroscope))
    for recording, missing_m in ((walk, 0.0), (torn, 4.0)):
        track = pdr.track(recording, recipes.for_recording(name, recording))
        assert np.isfinite(track.position_m).all()
        # martinelli2018 takes hand-held walking for stairs, as real walks show too
        least = 0.3 if name == "martinelli2018" else 0.7
        assert least * (40.0 - missing_m) < track.distance_m < 1.3 * 40.0


def test_parts_of_recipes_combine() -> None:
    walk = simulate([Leg("walking", distance_m=30.0)], seed=5)
    default = recipes.default()
    for name in ("guo2018", "tian2016", "susi2013", "zhou2019", "martinelli2018"):
        other = recipes.for_recording(name, walk)
        steps = replace(default, sensing=replace(default.sensing, steps=other.sensing.steps))
        contexts = replace(default, sensing=replace(default.sensing, contexts=other.sensing.contexts))
        for config in (steps, contexts):
            assert 0.3 * 30.0 < pdr.track(walk, config).distance_m < 1.4 * 30.0, (name, config)


def test_events_come_in_the_order_in_which_they_became_known_and_steps_before_the_gap() -> None:
    walk = simulate([Leg("walking", distance_m=30.0)], seed=6)
    block = pdr.merge_streams(walk)
    block = replace(block, time_s=np.where(block.time_s > 12.0, block.time_s + 5.0, block.time_s))
    events = sensed(recipes.default().sensing, [block])
    known_s = [k for k, _ in events]
    assert known_s == sorted(known_s)
    [gap] = [i for i, (_, e) in enumerate(events) if isinstance(e, Gap)]
    assert events[gap][1].duration_s == pytest.approx(5.0, abs=0.2)
    assert all(e.time_s < 12.1 for _, e in events[:gap] if isinstance(e, Step))
    assert all(e.time_s > 17.0 for _, e in events[gap:] if isinstance(e, Step))


class Askew(StepStage[None]):
    """Heading stage of a person who walks 0.4 rad to the right of the pointing axis of the phone."""

    def finish(self, state: None, steps: list[tuple[int, Step]]) -> tuple[None, list[tuple[int, Step]]]:
        def told(step: Step) -> Step:
            heading_rad = step.device_heading_rad + 0.4
            return replace(step, walking_heading_rad=heading_rad, walking_heading_std_rad=0.3)

        return state, [(number, told(step)) for number, step in steps]


class AskewWithOffsets(Askew):
    learns_directions = True


@pytest.mark.parametrize(("stage", "shown"), [(Askew(), (0.4, 0.3)), (AskewWithOffsets(), (0.0, np.inf))])
def test_only_steps_of_a_heading_stage_without_own_offsets_get_theirs_from_the_walking_heading(
    stage: StepStage[None], shown: tuple[float, float]
) -> None:
    walk = pdr.merge_streams(simulate([Leg("walking", distance_m=6.0)]))
    steps = [e for _, e in sensed(Sensing(steps=WaveletStepDetector(), heading=stage), [walk]) if isinstance(e, Step)]
    assert len(steps) > 5
    assert [(s.shown_offset_rad, s.shown_offset_std_rad) for s in steps] == [pytest.approx(shown)] * len(steps)


@pytest.mark.parametrize(
    ("name", "window_s", "hop_s"),
    [
        ("default", 2.0, 1.0),
        ("martinelli2018", 2.0, 1.0),
        ("guo2018", 0.6, 0.6),
        ("susi2013", 2.56, 1.28),
        ("zhou2019", 2.0, 1.0),
    ],
)
def test_a_window_states_its_start_and_its_hop(name: str, window_s: float, hop_s: float) -> None:
    walk = pdr.merge_streams(simulate([Leg("walking", distance_m=20.0)]))
    windows = [e for _, e in sensed(recipes.RECIPES[name](None).sensing, [walk]) if isinstance(e, WindowContext)]
    assert len(windows) > 5
    np.testing.assert_allclose([w.time_s - w.start_s for w in windows], window_s, atol=1e-9)
    np.testing.assert_allclose(np.diff([w.time_s for w in windows]), hop_s, atol=1e-9)
    assert {w.hop_s for w in windows} == {hop_s}


def test_a_recipe_for_the_foot_gives_no_note_about_sensors_on_the_foot() -> None:
    walk = simulate([Leg("walking", distance_m=10.0)])
    worn = replace(walk, meta={**walk.meta, "placement": "on the left foot"})
    for name, complains in (("zhou2019", False), ("default", True)):
        notes = pdr.track(worn, recipes.for_recording(name, worn)).notes
        assert any("for a carried phone" in note for note in notes) == complains


def test_a_second_pass_with_kept_results_equals_one_that_senses_again(monkeypatch: pytest.MonkeyPatch) -> None:
    walk = simulate([Leg("walking", distance_m=15.0)])
    blocks = [*pdr.merge_streams(walk).parts(500)]
    sensing = pdr.recipes.default().sensing
    kept = SensingForTwoPasses.keeping(sensing)
    sensed(kept, blocks)
    with monkeypatch.context() as patch:
        patch.setattr(Sensing, "_detect_steps", None)
        patch.setattr(Sensing, "_condition", None)
        again = sensed(replace(kept, heading=None), blocks)
    expected = sensed(replace(sensing, heading=None), blocks)
    assert [(known_s, type(event)) for known_s, event in again] == [
        (known_s, type(event)) for known_s, event in expected
    ]
    steps, wanted = ([e for _, e in events if isinstance(e, pdr.Step)] for events in (again, expected))
    assert steps == wanted


def walked_twice(bias: FloatArray) -> list[ImuBlock]:
    """Return blocks of 700 samples of two straight walks with a gap, measured with a gyroscope bias."""
    walk = simulate([Leg("walking", distance_m=20.0)])
    assert walk.gyroscope is not None
    blocks: list[ImuBlock] = []
    for start_s in (0.0, 60.0):
        force = Samples(walk.accelerometer.time_s + start_s, walk.accelerometer.values)
        rate = Samples(walk.gyroscope.time_s + start_s, walk.gyroscope.values + bias)
        blocks += pdr.merge_streams(pdr.Recording("biased", force, rate)).parts(700)
    return blocks


def test_a_second_pass_with_another_bias_keeps_the_steps_and_corrects_their_headings() -> None:
    bias = np.array([0.0, 0.01, 0.02])
    blocks, config = walked_twice(bias), pdr.recipes.default()
    known = config.with_device(Device(bias, 1e-8 * np.eye(3))).sensing
    kept = SensingForTwoPasses.keeping(config.sensing)
    first = sensed(kept, blocks)
    again, expected = sensed(kept.with_bias_of(known.attitude), blocks), sensed(known, blocks)
    old, found, wanted = ([e for _, e in events if isinstance(e, Step)] for events in (first, again, expected))
    assert [step.time_s for step in found] == [step.time_s for step in old]
    assert len(found) == len(wanted) > 40
    assert [e for _, e in again if isinstance(e, WindowContext)] == [
        e for _, e in first if isinstance(e, WindowContext)
    ]
    for name, atol in {"device_heading_rad": 0.01, "heading_change_rad": 0.01, "yaw_bias_std_radps": 5e-4}.items():
        values, of_bias, before = ([getattr(step, name) for step in steps] for steps in (found, wanted, old))
        np.testing.assert_allclose(values, of_bias, atol=atol)
        assert np.abs(np.subtract(before, of_bias)).max() > atol
    assert abs(old[-1].device_heading_rad - wanted[-1].device_heading_rad) > 0.1


@pytest.mark.parametrize("n_kept", [1400, 2800])
def test_a_second_pass_with_another_bias_senses_samples_without_kept_results(
    monkeypatch: pytest.MonkeyPatch, n_kept: int
) -> None:
    monkeypatch.setattr("pdr_filter.sensing.front_end.KEPT_SAMPLES", n_kept)
    bias = np.array([0.0, 0.01, 0.02])
    blocks, config = walked_twice(bias), pdr.recipes.default()
    known = config.with_device(Device(bias, 1e-8 * np.eye(3))).sensing
    kept = SensingForTwoPasses.keeping(config.sensing)
    sensed(kept, blocks)
    again, expected = sensed(kept.with_bias_of(known.attitude), blocks), sensed(known, blocks)
    found, wanted = ([e for _, e in events if isinstance(e, Step)] for events in (again, expected))
    assert 0 < len(kept.detected) < len(blocks)
    assert len(found) == len(wanted) > 40
    for name, atol in {"device_heading_rad": 0.01, "heading_change_rad": 0.01, "yaw_bias_std_radps": 1e-3}.items():
        values, of_bias = ([getattr(step, name) for step in steps] for steps in (found, wanted))
        # the heading of the step that begins with kept results and ends without them is less exact
        assert (np.abs(np.subtract(values, of_bias)) > atol).sum() <= 1


def test_a_released_front_end_senses_again_with_the_bias_of_the_second_pass() -> None:
    walk = simulate([Leg("walking", distance_m=12.0)])
    blocks = [*pdr.merge_streams(walk).parts(500)]
    config = pdr.recipes.default()
    known = config.with_device(Device(np.array([0.0, 0.01, 0.02]), 1e-8 * np.eye(3))).sensing
    kept = SensingForTwoPasses.keeping(config.sensing)
    sensed(kept, blocks)
    second = kept.with_bias_of(known.attitude)
    assert isinstance(second.heading, WalkingHeading)
    directed = replace(second.heading, known_placements=(KnownPlacement(0.0, 1.0, 0.1),))
    second = replace(second, heading=directed)  # relative to headings that are not estimated again
    again, expected = sensed(second.released(), blocks), sensed(known, blocks)
    assert [e for _, e in again if isinstance(e, Step)] == [e for _, e in expected if isinstance(e, Step)]
    assert not second.detected
    assert not second.conditioned


def test_stored_events_give_the_track_of_the_same_samples_and_of_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules with the fixture `sensing_once` rely on it."""
    walk = simulate([Leg("walking", distance_m=18.0)], seed=1)
    assert walk.gyroscope is not None
    turned = replace(walk, gyroscope=Samples(walk.gyroscope.time_s, walk.gyroscope.values + np.array([0.0, 0.0, 0.1])))
    assert len(walk.gyroscope) > MIN_SAMPLES
    expected = [pdr.track(recording).position_m for recording in (walk, turned)]
    sense_once(monkeypatch)
    for _ in range(2):
        for recording, position_m in zip((walk, turned), expected, strict=True):
            np.testing.assert_array_equal(pdr.track(recording).position_m, position_m)
