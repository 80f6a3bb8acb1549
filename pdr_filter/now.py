"""What a filter knows at this moment: between steps, and of steps that are not accepted yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter import imm
from pdr_filter.filter.motion import HEADING_OFFSET
from pdr_filter.filter.pedestrian import StepUpdate, present_position
from pdr_filter.filtering import State, notes_of
from pdr_filter.sensing.merging import SENSORS
from pdr_filter.sensing.steps.gate import StepGateState
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FixResult, FloatArray, Step, as_plain, read_only


@dataclass(frozen=True, slots=True, eq=False)
class ProvisionalStep:
    """A step that is found and not accepted yet: it may still be none."""

    time_s: float  # contact
    position_m: FloatArray  # (2,) east, north, after it


@dataclass(frozen=True, slots=True, eq=False)
class Now:
    """The filter at the time of its newest sample."""

    time_s: float  # of the newest sample, on the track's time base; NaN before the first
    latency_s: float  # by how much what is merged and processed is behind it
    n_steps: int  # accepted
    distance_m: float  # of these
    position_m: FloatArray  # (2,) east, north
    position_cov_m2: FloatArray  # (2, 2)
    is_provisional: bool  # that the position is ahead of the last accepted step: it may be taken back
    provisional_steps: tuple[ProvisionalStep, ...]  # that led there, in order
    walking_heading_rad: float  # clockwise, of the walk, or of the person who stands and turns; not wrapped
    walking_heading_std_rad: float
    walking_speed_mps: float  # smoothed; 0 while nobody steps
    walking_speed_std_mps: float  # NaN while nobody steps
    context_prob: FloatArray  # (C,) of `CONTEXTS` in the last window; NaN before the first
    carrying_prob: FloatArray  # (D,) of `CARRYING_MODES`
    height_m: float
    height_std_m: float
    floor: int
    fixes: tuple[FixResult, ...]  # what became of the last ones
    rates_hz: Mapping[str, float]  # of each sensor as it arrives
    n_gaps: int  # in the samples
    lost_s: float  # in these
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON has them: None for what is not finite, contexts and carrying modes by their names."""
        return {
            **as_plain(self),
            "context_prob": as_plain(dict(zip(CONTEXTS, self.context_prob, strict=True))),
            "carrying_prob": as_plain(dict(zip(CARRYING_MODES, self.carrying_prob, strict=True))),
        }


# A pause this many steps long ends a walk (`pedestrian.with_step` starts the smoothed speed afresh then).
_PAUSE_STEPS = 1.5


def now(config: Config, state: State) -> Now:
    """What is known at this moment."""
    sensing, pedestrian = state.sensing, state.tracker.pedestrian
    newest_s = _newest_s(state)
    tracker, update = state.tracker, None
    steps = list[ProvisionalStep]()
    for step in candidates(state):
        tracker, output = config.tracker.on_step(tracker, step)
        update = output.updates[-1]
        steps.append(ProvisionalStep(step.time_s, update.position_m))
    position_m, cov_m2 = present_position(pedestrian) if update is None else (update.position_m, update.position_cov_m2)
    present = tracker.pedestrian
    mean, cov = imm.combine(present.mean, present.cov, present.prob)
    last_s = update.step.time_s if update else pedestrian.last_step_s
    speed = update.speed if update else pedestrian.speed
    walks = speed is not None and newest_s - last_s <= _until_pause_s(config, update)
    heading_rad = sensing.attitude.device_heading_rad + float(mean[HEADING_OFFSET])
    if update and walks:
        heading_rad = update.walking_heading_rad
    window, report, known = state.window, sensing.conditioner.report, state.height.known
    unknown = np.full(len(CONTEXTS), np.nan), np.full(len(CARRYING_MODES), np.nan)
    context_prob, carrying_prob = (window.prob, window.carrying_prob) if window else unknown
    return Now(
        time_s=newest_s,
        latency_s=newest_s - sensing.processed_s if math.isfinite(sensing.processed_s) else math.nan,
        n_steps=pedestrian.n_final,
        distance_m=float(pedestrian.prob @ pedestrian.walked_m),
        position_m=position_m,
        position_cov_m2=cov_m2,
        is_provisional=bool(steps),
        provisional_steps=tuple(steps),
        walking_heading_rad=heading_rad,
        walking_heading_std_rad=math.sqrt(float(cov[HEADING_OFFSET, HEADING_OFFSET])),
        walking_speed_mps=speed.smoothed_mps if speed and walks else 0.0,
        walking_speed_std_mps=speed.smoothed_std_mps if speed and walks else math.nan,
        context_prob=read_only(context_prob),
        carrying_prob=read_only(carrying_prob),
        height_m=known.height_m,
        height_std_m=known.height_std_m,
        floor=known.floors.floor,
        fixes=state.last_fixes,
        rates_hz=_rates_hz(state),
        n_gaps=report.n_gaps,
        lost_s=report.lost_s,
        notes=tuple(note.text for note in notes_of(config, state)),
    )


def candidates(state: State) -> list[Step]:
    """The steps that are found and not out yet, of which the gate would let the next one pass."""
    gate = state.sensing.gate
    if not isinstance(gate, StepGateState):
        return []
    return [*(judged.step for judged in gate.held), *(step for _, step in gate.waiting)]


def _until_pause_s(config: Config, update: StepUpdate | None) -> float:
    """How long after the last step somebody still walks: a pause, and what the next step needs to be known."""
    duration_s = update.step.duration_s if update else 0.6
    return _PAUSE_STEPS * duration_s + config.sensing.step_latency_s


def _newest_s(state: State) -> float:
    """Time of the newest sample, on the track's time base."""
    if state.merger.is_used:
        return max(s.last_s for s in state.merger.streams) + state.clock_offset_s
    return state.sensing.conditioner.report.last_time_s


def _rates_hz(state: State) -> dict[str, float]:
    """Of each sensor as it arrives; of samples that were pushed together as they were."""
    if state.merger.is_used:
        streams = zip(SENSORS, state.merger.streams, strict=True)
        return {sensor: stream.rate_hz for sensor, stream in streams if stream.n_received}
    report = state.sensing.conditioner.report
    seen_s = report.last_time_s - report.first_time_s - report.lost_s
    return {"accelerometer": report.n_received / seen_s} if seen_s > 0 else {}
