"""Context models that do not fit: steps in contexts without steps, and motion unlike the training data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import cut

import pdr_filter as pdr
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.tracking.step_statistics import IN_STANDING, UNLIKE
from pdr_filter.values import WindowContext

WEIGHTINGS = ("imm", "wc", "hc")


class MistakenContexts(LearnedContexts):
    """Context stage of the default recipe whose model takes all motion for standing, with little certainty."""

    def assess_all(self, memory: Any, windows: Sequence[Any]) -> tuple[Any, list[WindowContext]]:
        memory, contexts = super().assess_all(memory, windows)
        prob = np.array([0.6, 0.3, 0.04, 0.03, 0.02, 0.01])
        return memory, [replace(c, prob=prob, is_unlike=True) for c in contexts]


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return simulate([Leg("walking", distance_m=30.0)], Gait(height_m=1.75), seed=2)


def config_of(weighting: str, is_mistaken: bool = True) -> pdr.Config:
    config = pdr.recipes.default().with_weighting(weighting)
    stage = config.sensing.contexts
    assert isinstance(stage, LearnedContexts)
    return config.with_contexts(MistakenContexts(stage.windows, stage.models), config.model.modes)


def notes_about(notes: Sequence[Any]) -> list[str]:
    return [str(note) for note in notes if IN_STANDING in str(note) or UNLIKE in str(note)]


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_a_model_that_takes_walking_for_standing_does_not_keep_the_track_at_its_start(
    walk: pdr.Recording, weighting: str
) -> None:
    track = pdr.track(walk, config=config_of(weighting))
    default = pdr.track(walk, weighting=weighting)
    assert track.n_steps == default.n_steps
    assert track.distance_m == pytest.approx(default.distance_m, rel=0.35)
    of_steps, of_windows = notes_about(track.notes)[::-1]
    assert of_steps == f"{track.n_steps} of {track.n_steps} {IN_STANDING}"
    assert of_windows == f"in {len(track.windows)} of {len(track.windows)} windows {UNLIKE}"
    assert notes_about(default.notes) == []
    assert IN_STANDING in track.report() and IN_STANDING not in default.report()


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_the_notes_are_the_same_online_after_saving_and_offline(walk: pdr.Recording, weighting: str) -> None:
    config = config_of(weighting)
    online = pdr.OnlineFilter(config)
    for k, block in enumerate(cut(pdr.merge_streams(walk), [500, 900, 1300, 1700])):
        if k == 3:
            online = pdr.OnlineFilter.load(online.save(), config=config)
        online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps)
    online.finish()
    expected = notes_about(pdr.track(walk, config=config).notes)
    assert len(expected) == 2 and notes_about(online.notes) == expected


def test_a_smoothed_track_has_the_notes_too(walk: pdr.Recording) -> None:
    smoothed = pdr.smooth(walk, config=config_of("imm"))
    assert len(notes_about(smoothed.notes)) == 2
