"""A simulated walk whose sensing runs once, so that many sets of fixes can be tracked in a second each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from helpers import true_position_m

import pdr_filter as pdr
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, over_stepless
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.front_end import Event
from pdr_filter.tracking.filtering import due_s, parts
from pdr_filter.values import Fix, FixOutcome, FloatArray, Standstill, Step, WindowContext, replace_unchecked
from pdr_filter.values.events import Gap, Stepless, Undecided
from pdr_filter.values.recording import Recording


@dataclass(frozen=True)
class Tracked:
    """Steps of a track, and the outcomes of its fixes in the order of their use."""

    time_s: FloatArray  # (K,)
    position_m: FloatArray  # (K, 2)
    cov_m2: FloatArray  # (K, 2, 2)
    fixes: tuple[Fix, ...]
    outcomes: tuple[FixOutcome, ...]
    known: PedestrianState

    def times_of(self, outcome: str) -> list[float]:
        """Return the times of the fixes with an outcome."""
        return [fix.time_s for fix, own in zip(self.fixes, self.outcomes, strict=True) if own == outcome]


@dataclass(frozen=True)
class SensedWalk:
    """Recording with ground truth, and the steps and windows that the default recipe detects in it."""

    recording: Recording

    @cached_property
    def config(self) -> Config:
        return pdr.recipes.default(self.recording.subject)

    @cached_property
    def world(self) -> Config:
        return self.config.in_world_frame()

    @cached_property
    def events(self) -> list[tuple[float, Event]]:
        sensing, found = self.config.sensing, list[tuple[float, Event]]()
        state = sensing.init()
        for part in parts(pdr.merge_streams(self.recording)):
            state, events = sensing.update(state, part)
            found += events
        return found + sensing.finish(state)[1]

    @property
    def end_s(self) -> float:
        return float(self.recording.truth.position.time_s[-1])

    def at(self, time_s: FloatArray | float) -> FloatArray:
        """Return true positions (..., 2)."""
        return true_position_m(self.recording, time_s)

    def tracked(self, fixes: Sequence[Fix], config: Config | None = None, until_s: float = np.inf) -> Tracked:
        """Return the track with fixes until a time, by default in the world frame."""
        config = config or self.world
        tracker, waiting = config.tracker, sorted(fixes, key=lambda fix: due_s(config, fix))
        state, used, rows = tracker.init(), 0, []
        outcomes: list[FixOutcome] = []
        undecided_s = np.inf
        for known_s, event in [*self.events, (np.inf, None)]:
            if known_s > until_s:
                break
            if event is None or isinstance(event, Step):
                undecided_s = np.inf if event is None else max(undecided_s, event.time_s - event.duration_s)
            while (
                used < len(waiting)
                and due_s(config, waiting[used]) <= known_s
                and (waiting[used].time_s < undecided_s or isinstance(waiting[used], Standstill))
            ):
                state, outcome, _ = tracker.on_fix(state, waiting[used])
                outcomes.append(outcome)
                used += 1
            if isinstance(event, WindowContext):
                state, updates = tracker.on_window(state, event)
            elif isinstance(event, Gap):
                state, updates = tracker.on_gap(state, event.duration_s)
            elif isinstance(event, Stepless):
                state = replace_unchecked(state, pedestrian=over_stepless(state.pedestrian, event.duration_s))
                continue
            elif isinstance(event, Undecided):
                undecided_s = event.since_s
                continue
            elif event is not None:
                state, updates = tracker.on_step(state, event)
            else:
                break
            rows += [(u.step.time_s, u.position_m, u.position_cov_m2) for u in updates if u.is_final]
        times, places, covs = (np.array(column) for column in zip(*rows, strict=True))
        return Tracked(times, places, covs, tuple(waiting[:used]), tuple(outcomes), state.pedestrian)

    def errors_m(self, track: Tracked) -> FloatArray:
        """Return the distance of each step from the ground truth, (K,)."""
        return np.linalg.norm(track.position_m - self.at(track.time_s), axis=1)
