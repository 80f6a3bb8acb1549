"""What a filter knows at this moment: between steps, and of steps that are not accepted yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pdr_filter.filter.fixes.alignment import Place
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.filter.imm.pedestrian_state import StepUpdate, present_position, track_place
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.stream_merging import SENSORS
from pdr_filter.tracking.filtering import State
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import CARRYING_MODES, FixResult, FloatArray, OnPlan, Step, as_plain, read_only
from pdr_filter.values.uncertainty import worst_std_m


@dataclass(frozen=True, slots=True, eq=False)
class ProvisionalStep:
    """A step that is found and not accepted yet: it may still be none."""

    time_s: float  # contact
    position_m: FloatArray  # (2,) east, north, after it


@dataclass(frozen=True, slots=True, eq=False)
class Now:
    """The filter at the time of its newest sample.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> samples = pdr.merge_streams(pdr.simulate.demo_walk())
    >>> online = pdr.OnlineFilter()
    >>> _ = online.push(samples.time_s[:2000], samples.specific_force_mps2[:2000], samples.angular_rate_radps[:2000])
    >>> now = online.now()
    >>> now.walking_speed_mps > 0.5
    True
    >>> now.to_dict()["n_steps"] == now.n_steps
    True
    """

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
    context_prob: FloatArray  # (C,) in the last window; NaN before the first
    contexts: tuple[str, ...]  # C names
    carrying_prob: FloatArray  # (D,) of `CARRYING_MODES`
    height_m: float
    height_std_m: float
    floor: int
    fixes: tuple[FixResult, ...]  # what became of the last ones
    rates_hz: Mapping[str, float]  # of each sensor as it arrives
    n_gaps: int  # in the samples
    lost_s: float  # in these
    notes: tuple[str, ...]

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position in the worst direction."""
        return float(worst_std_m(self.position_cov_m2))

    def to_dict(self) -> dict[str, Any]:
        """The fields and `position_std_m` as JSON has them: None for what is not finite, probabilities by names."""
        named = as_plain(self)
        del named["contexts"]
        return {
            **named,
            "position_std_m": as_plain(self.position_std_m),
            "context_prob": as_plain(dict(zip(self.contexts, self.context_prob, strict=True))),
            "carrying_prob": as_plain(dict(zip(CARRYING_MODES, self.carrying_prob, strict=True))),
        }


# Errors of the way beyond the last known contact, along and across, as shares of it (root mean squares): the person may
# have stopped or turned. Chosen, with `_QUIET_MPS2`, on every second of 34 walks of ms_indoor; the others have 0.39 and
# 0.17, humolire 0.21 and 0.07 (tests/benchmarks/provisional.py).
_ALONG_SHARE, _ACROSS_SHARE = 0.4, 0.15
# Nobody walks whose |specific force| had a smaller standard deviation for the last half second, in rows at 25 Hz.
_QUIET_MPS2, _QUIET_ROWS = 0.8, 13


class Present(NamedTuple):
    """Where the pedestrian is at the time of the newest sample, in the frame of the filter's states."""

    time_s: float
    place: Place
    steps: tuple[ProvisionalStep, ...]  # that are found and not accepted yet, and led there
    way_m: float  # since the last contact
    speed_mps: float
    speed_std_mps: float


def present_place(config: Config, state: State) -> Present:
    """The place at this moment, before the frame of the fixes and a floor plan.

    Behind the last accepted step come the candidates: steps that the gate has not judged yet, and those that wait for a
    bout while walking is more probable than not. From the last contact the position goes on at the smoothed speed, in
    the direction of the step turned by half of what the phone has turned since, until the next contact is overdue or
    the phone is quiet. After `finish` nothing is provisional.
    """
    sensing = state.sensing
    tracker, last, steps = state.tracker, state.last_update, list[ProvisionalStep]()
    for step in () if state.finished else _candidates(sensing.gate):
        tracker, updates = config.tracker.on_step(tracker, step)
        last = updates[-1]
        step_place_m = last.position_m if last.of_start is None else last.of_start.position_m
        steps.append(ProvisionalStep(step.time_s, step_place_m))
    pedestrian = state.tracker.pedestrian
    mean, _ = pedestrian.estimates.combined
    device_rad = sensing.attitude.device_heading_rad
    place = replace(track_place(pedestrian), heading_rad=device_rad + float(mean[HEADING_OFFSET]))
    if last is not None and (steps or not last.is_final):
        last_place = Place(last.position_m, last.position_cov_m2, last.walking_heading_rad, pedestrian.steps.n_final)
        turned_rad = device_rad - last.step.device_heading_rad
        place = last.of_start or last_place
        place = replace(place, heading_rad=place.heading_rad + turned_rad)
    speed_mps, speed_std_mps, way_m = 0.0, math.nan, 0.0
    if last is not None and not state.finished and _walks(config, state, last, bool(steps)):
        speed_mps, speed_std_mps = last.speed.smoothed_mps, last.speed.smoothed_std_mps
        way_m = speed_mps * max(_felt_s(state) - last.step.time_s, 0.0)
        place = _further(place, way_m, device_rad - last.step.device_heading_rad)
    return Present(_newest_s(state), place, tuple(steps), way_m, speed_mps, speed_std_mps)


def now(config: Config, state: State) -> Now:
    """What is known at this moment: `present_place` in the frame of the fixes, and all else."""
    sensing, pedestrian, present = state.sensing, state.tracker.pedestrian, present_place(config, state)
    newest_s, steps, place, frame = present.time_s, present.steps, present.place, pedestrian.frame
    mean, cov = pedestrian.estimates.combined
    if not frame.is_joined:
        n_steps = pedestrian.steps.n_final
        places = (frame.world(Place(s.position_m, np.zeros((2, 2)), 0.0, n_steps)) for s in steps)
        steps = tuple(replace(s, position_m=p.position_m) for s, p in zip(steps, places, strict=True))
    place = place if frame.is_joined else frame.world(place)
    reckoned = present_position(pedestrian)
    on_plan = None if config.on_plan is None else config.on_plan.place(state.particles, reckoned)
    if on_plan is not None and state.particles is not None:
        base = replace(track_place(pedestrian), heading_rad=state.particles.heading_rad + float(mean[HEADING_OFFSET]))
        base = base if frame.is_joined else frame.world(base)
        step_positions_m = [_on_plan(replace(place, position_m=s.position_m), base, on_plan).position_m for s in steps]
        steps = tuple(replace(s, position_m=at) for s, at in zip(steps, step_positions_m, strict=True))
        place = _on_plan(place, base, on_plan)
    window, report, height = state.window, sensing.conditioner.report, state.height.known
    contexts = config.model.contexts
    unknown = np.full(len(contexts), np.nan), np.full(len(CARRYING_MODES), np.nan)
    context_prob, carrying_prob = (window.prob, window.carrying_prob) if window else unknown
    return Now(
        time_s=newest_s,
        latency_s=newest_s - sensing.processed_s if math.isfinite(sensing.processed_s) else math.nan,
        n_steps=pedestrian.steps.n_final,
        distance_m=pedestrian.estimates.distance_m,
        position_m=read_only(place.position_m),
        position_cov_m2=read_only(place.cov_m2),
        is_provisional=bool(steps) or present.way_m > 0,
        provisional_steps=steps,
        walking_heading_rad=place.heading_rad,
        walking_heading_std_rad=math.sqrt(float(cov[HEADING_OFFSET, HEADING_OFFSET]) + frame.rotation_var_rad2),
        walking_speed_mps=present.speed_mps,
        walking_speed_std_mps=present.speed_std_mps,
        context_prob=read_only(context_prob),
        contexts=contexts,
        carrying_prob=read_only(carrying_prob),
        height_m=height.height_m,
        height_std_m=height.height_std_m,
        floor=height.floors.floor,
        fixes=state.last_fixes,
        rates_hz=_rates_hz(state),
        n_gaps=report.n_gaps,
        lost_s=report.lost_s,
        notes=tuple(note.text for note in notes_of(config, state)),
    )


def _further(place: Place, way_m: float, turned_rad: float) -> Place:
    """The place of somebody who went on while the phone turned to where it points there."""
    heading_rad = place.heading_rad - 0.5 * turned_rad
    along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    across = np.array([along[1], -along[0]])
    share = _ALONG_SHARE**2 * np.outer(along, along) + _ACROSS_SHARE**2 * np.outer(across, across)
    return replace(place, position_m=place.position_m + way_m * along, cov_m2=place.cov_m2 + way_m**2 * share)


def _on_plan(place: Place, base: Place, on_plan: OnPlan) -> Place:
    """A place of the tracker ahead of that of its last step, as seen from where the particles have that step."""
    turn_rad = on_plan.walking_heading_rad - base.heading_rad
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    rotation = np.array([[c, s], [-s, c]])
    value, vector = np.linalg.eigh(place.cov_m2 - base.cov_m2)
    grown = vector @ np.diag(np.maximum(value, 0.0)) @ vector.T
    return replace(
        place,
        position_m=on_plan.position_m + rotation @ (place.position_m - base.position_m),
        cov_m2=on_plan.position_cov_m2 + rotation @ grown @ rotation.T,
        heading_rad=place.heading_rad + turn_rad,
    )


def _candidates(gate: Any) -> list[Step]:
    """Steps that are found and not accepted yet, where somebody seems to walk."""
    return list(getattr(gate, "candidates", ()))


def _walks(config: Config, state: State, last: StepUpdate, is_candidate: bool) -> bool:
    """Whether somebody walks on after the last step: the next one is not overdue, and the phone is not quiet."""
    sensing, gate = config.sensing, state.sensing.gate
    latency_s = sensing.steps.latency_s if is_candidate else sensing.step_latency_s
    if not state.sensing.processed_s - last.step.time_s <= latency_s + last.step.duration_s:
        return False
    rows = getattr(gate, "rows", np.empty((0, 3)))[-_QUIET_ROWS:]
    return len(rows) < _QUIET_ROWS or float(np.sqrt((rows * rows).sum(axis=1)).std()) >= _QUIET_MPS2


def _newest_s(state: State) -> float:
    """Time of the newest sample, on the track's time base."""
    if state.merger.is_used:
        return max(s.last_s for s in state.merger.streams) + state.clock_offset_s
    return state.sensing.conditioner.report.last_time_s


def _felt_s(state: State) -> float:
    """Time of the newest sample of the accelerometer, as another sensor may be on another clock."""
    if not state.merger.is_used:
        return _newest_s(state)
    return state.merger.stream("accelerometer").last_s + state.clock_offset_s


def _rates_hz(state: State) -> dict[str, float]:
    """Of each sensor as it arrives; of samples that were pushed together as they were."""
    if state.merger.is_used:
        streams = zip(SENSORS, state.merger.streams, strict=True)
        return {sensor: stream.rate_hz for sensor, stream in streams if stream.n_received}
    report = state.sensing.conditioner.report
    seen_s = report.last_time_s - report.first_time_s - report.lost_s
    return {"accelerometer": report.n_received / seen_s} if seen_s > 0 else {}
