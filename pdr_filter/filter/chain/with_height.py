"""Handler that adds height and storey to the rows, and finds the floor passages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdr_filter.filter.chain.handler import Around, End, Event, FixUse, Handler, Locations, Output, Window
from pdr_filter.filter.fixes.gnss import location_at
from pdr_filter.filter.height import height_filter
from pdr_filter.filter.height.height_filter import HeightState, initial_height
from pdr_filter.filter.height.vertical_modes import N_MODES
from pdr_filter.filter.imm.weighting import context_log_evidence
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.sensing.contexts.context_stage import with_stairs_in_thirds
from pdr_filter.values import FloatArray, GridFix, PositionFix, WindowContext, replace_unchecked
from pdr_filter.values.events import Climb


@dataclass(frozen=True, eq=False)
class HeightTrack(Around):
    """State of the inner handler, of the height filter, and recent accurate locations.

    Attributes
    ----------
    inner : object
        State of the inner handler.
    height : HeightState
        State of the height filter.
    locations : ndarray, shape (N, 3)
        Recent accurate locations (`gnss.good_locations`), which distinguish hills from storeys.
    """

    height: HeightState
    locations: FloatArray = field(default_factory=lambda: np.empty((0, 3)))


def window_log_evidence(windows: Sequence[WindowContext], model: PedestrianModel) -> FloatArray:
    """Return the log evidence (W, 7) of context windows for the vertical modes (`height_filter.mode_log_evidence`)."""
    if not windows:
        return np.zeros((0, N_MODES))
    prob = np.array([with_stairs_in_thirds(w.prob, w.stairs_unknown_share, model.context_set) for w in windows])
    prior, exponents = np.array([w.training_prior for w in windows]), (model.evidence_exponent, model.evidence_floor)
    context_evidence = context_log_evidence(prob, prior, *exponents, model.prior_exponent)
    return height_filter.mode_log_evidence(context_evidence, model.context_set)


class WithHeight:
    """Handler around another one, with a height filter. `start_floor` is the storey of the start, if it is known."""

    def __init__(self, inner: Handler[Any], model: PedestrianModel, start_floor: int | None = None) -> None:
        self.inner, self.on_stairs, self.start_floor = inner, model.on_stairs, start_floor
        self.log_odds = model.step_log_odds_stationary

    def init(self) -> HeightTrack:
        """Return the state at the height of the start."""
        height = initial_height()
        if self.start_floor is not None:
            height = height_filter.with_floor(height, self.start_floor)
        return HeightTrack(self.inner.init(), height)

    def on(self, state: HeightTrack, event: Event, known_s: float) -> tuple[HeightTrack, tuple[Output, ...]]:
        """Return the state after an event, and the outputs of the inner handler with heights and floor passages."""
        if isinstance(event, Climb):
            position = location_at(state.locations, event.time_s)
            height, passages = height_filter.on_pressure(state.height, event, self.log_odds, position)
            return replace_unchecked(state, height=height), passages
        if isinstance(event, Locations):
            recent = state.locations[state.locations[:, 0] >= event.since_s]
            return replace_unchecked(state, locations=np.concatenate([recent, event.rows])), ()
        height, rows = state.height, list[Output]()
        if isinstance(event, Window):
            height = height_filter.on_window(height, event.context, event.height_log_evidence)
        inner, outputs = self.inner.on(state.inner, event, known_s)
        for output in outputs:
            if isinstance(output, StepUpdate):
                height, row = self._on_row(height, state.locations, output, known_s)
                rows += row
            elif isinstance(output, FixUse):
                rows.append(output._replace(floor=height.known.floors.floor))
                height = _with_fix(height, output)
            else:
                rows.append(output)
        if isinstance(event, End):
            height, passages = height_filter.finish_height(height)
            rows += passages
        return replace_unchecked(state, inner=inner, height=height), tuple(rows)

    def _on_row(
        self, height: HeightState, locations: FloatArray, row: StepUpdate, known_s: float
    ) -> tuple[HeightState, tuple[Output, ...]]:
        """Return the height after a row, the floor passages that it completes, and the row with height and storey."""
        at_step, passages = height.known, ()
        if row.is_final:
            up_prob, down_prob = self.on_stairs.dot(row.mode_prob).tolist()
            step_s = row.step.time_s
            height, at_step, passages = height_filter.on_step(
                height, known_s, step_s, up_prob, down_prob, self.log_odds, location_at(locations, step_s)
            )
        row = replace_unchecked(
            row, height_m=at_step.height_m, height_std_m=at_step.height_std_m, floor=at_step.floors.floor
        )
        return height, (*passages, row)


def _with_fix(height: HeightState, use: FixUse) -> HeightState:
    """Return the height after a fix, whose storey and altitude count unless the fix was rejected or repeats another."""
    if isinstance(use.fix, PositionFix | GridFix) and use.outcome not in ("rejected", "frozen", "repeated"):
        return height_filter.with_fix(height, use.fix)
    return height
