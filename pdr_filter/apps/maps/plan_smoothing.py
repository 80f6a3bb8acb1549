"""Smoothing of a walk on a floor plan: the ancestral paths of the final particles.

Each final particle has one ancestor at every earlier step. By the end of the walk, the plan and the fixes have already
judged the other descendants of that ancestor. A path that ended at a wall has no descendants. Means and covariances
over the ancestral paths, with the final weights, are those of the smoothed distribution (G. Kitagawa, "Monte Carlo
filter and smoother for non-Gaussian nonlinear state space models", J. Comput. Graph. Stat. 5, 1996).

Paths share more of their early steps the fewer particles there are. Therefore the smoother uses four times as many
particles as the online filter, and the covariance of the paths is never smaller than the accuracy of the plan. The
final probability that no particle is at the true position applies to all steps, and inflates their covariances up to
dead reckoning. Steps before a restart of lost particles have a probability of 99 %.

Drawing the ancestors again from all particles of the previous step (S. J. Godsill, A. Doucet and M. West, "Monte Carlo
smoothing for nonlinear time series", J. Amer. Stat. Assoc. 99, 2004) would change nothing: of 4000 particles only 1.03
could be the ancestor (effective number, median on F1 and B1 of ms_indoor).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pdr_filter.apps.maps.crossing_costs import Ground
from pdr_filter.apps.maps.particle_clusters import Alternative, inflated_cov, weighted_moments
from pdr_filter.apps.maps.particle_filter import ParticleFilter, ParticleState, off_plan_notes
from pdr_filter.apps.maps.particle_motion import EAST, NORTH, OFFSET, SCALE, earlier_positions
from pdr_filter.filter.chain.handler import FixUse
from pdr_filter.filter.chain.with_plan import PlanEvent
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.smoothed import Smoothed, floors_at_steps, observation_table
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.step_statistics import UNKNOWN_HEADING_RAD
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import outputs, position_before, track_of_outputs
from pdr_filter.values import (
    Cluster,
    Fix,
    FloatArray,
    Note,
    Origin,
    PositionFix,
    Table,
    read_only,
    reference_headings,
    wrap_angle,
)
from pdr_filter.values.recording import Recording

# Factor on the smallest number of particles of the online filter: paths share fewer of their early steps.
_PARTICLE_FACTOR = 4
# Accuracy of a position on a plan: drawn edges, and the distance that people keep from walls, vary by some decimetres.
_PLAN_STD_M = 0.2
# Probability that particles were not at the true position if they were drawn again because none fitted the steps.
_LOST_PROB = 0.99
# A note appears if the walking direction is unknown in more steps than this number, or than this share of a short walk.
_UNKNOWN_NUMBER, _UNKNOWN_SHARE = 20, 0.5


class _Event(NamedTuple):
    """State of the particles after one event: a step, a fix, a gap or a change of storey."""

    state: ParticleState
    reckoned: tuple[FloatArray, FloatArray] | None  # dead-reckoned position (2,) and covariance (2, 2) after a step
    length_m: float  # length of the step for a scale of one, mean over the modes
    is_restart: bool  # True if the particles do not descend from those before the event


class _Recorder:
    """Plan stage that passes all events to a particle filter and records its states in `events`."""

    def __init__(self, particle_filter: ParticleFilter) -> None:
        self.events: list[_Event] = []
        self.plan, self.start = particle_filter.plan, particle_filter.start
        self.init, self.estimate = particle_filter.init, particle_filter.estimate
        self._filter = particle_filter

    def notes(self, state: ParticleState) -> list[Note]:
        # The smoothed positions have their own number of steps off the plan.
        return self._filter.notes(replace(state, n_off_plan=0))

    def on(
        self, state: ParticleState, event: PlanEvent, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        after = self._filter.on(state, event, pedestrian, model)
        reckoned, length_m = None, 0.0
        if isinstance(event, StepUpdate):
            reckoned = event.position_m, event.position_cov_m2
            length_m = float(event.mode_prob @ model.lengths(event.step).length_m)
        # each step is recorded, other events only if they changed the weights
        if after.weight is not state.weight or reckoned is not None:
            is_moved = isinstance(event, FixUse) and event.outcome == "moved"
            is_new = is_moved or after.n_lost > state.n_lost
            self.events.append(_Event(after, reckoned, length_m, is_restart=is_new and len(state.weight) > 0))
        return after


def smooth_on_plan(
    recording: Recording,
    config: Config,
    fixes: tuple[Fix, ...],
    with_location: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Smoothed:
    """Return the track on a floor plan, smoothed over a whole recording. `pdr_filter.smooth` uses it.

    Parameters
    ----------
    recording : Recording
        Recording of the walk.
    config : Config
        Configuration with a particle filter on the plan.
    fixes : tuple of fixes
        Measurements from outside, in the frame of the plan.
    with_location : bool, default False
        Whether the locations of the recording are used too.
    progress : callable, optional
        Function that is called with the fraction done, 0 to 1.

    Returns
    -------
    Smoothed
        Smoothed track, whose observations are the position fixes.

    Raises
    ------
    ValueError
        If the configuration has no particle filter, the recording has no steps, or nothing places it on the plan.
    """
    online = config.on_plan
    if not isinstance(online, ParticleFilter):
        raise ValueError(
            f"smoothing on a plan needs a configuration with a particle filter, got {online!r}: use Config.with_plan"
        )
    n_least = _PARTICLE_FACTOR * online.n_least
    recorder = _Recorder(replace(online, n_least=n_least, n_most=max(n_least, online.n_most)))
    config = replace(config.in_hindsight(), on_plan=recorder)
    track = track_of_outputs(recording, config, outputs(recording, config, fixes, progress, with_location))
    if not track.n_steps:
        raise ValueError("the recording has no steps, which place a walk on the plan: smooth it without plan")
    if not any(track.clusters):
        raise ValueError(
            "the position of the walk on the plan is unknown: give fixes, or start, such as the name of an area"
        )
    floors, rows = iter(track.floor[::-1].tolist()), list[_Row]()
    for ancestors in _ancestors(recorder.events):
        if (reckoned := ancestors.event.reckoned) is not None:
            alternative = online.alternative(ancestors.event.state, reckoned, ancestors.elsewhere)
            rows.append(_row(ancestors, alternative, online.ground(next(floors))))
    return _smoothed(track, rows[::-1], online.plan.origin, _observations(fixes, track))


class _Ancestors(NamedTuple):
    """Ancestors of the N final particles after one event."""

    event: _Event
    particles: FloatArray  # (N, 6) states of the ancestors
    weight: FloatArray  # (N,) of the paths from the ancestors to the final particles
    elsewhere: float  # probability that no final particle is at the true position


def _ancestors(events: Sequence[_Event]) -> Iterator[_Ancestors]:
    """Yield the ancestors of the final particles after each recorded event, from the last one to the first.

    Events are steps, fixes, gaps and changes of storey. Before a restart the weights belong to the particles that the
    restart replaced. If none of those fitted the steps, they are probably not at the true position. Before the
    particles were first drawn, the earlier positions follow from their heading offsets and scales, which are then
    constant.
    """
    weight, elsewhere = events[-1].state.weight, events[-1].state.elsewhere
    index = np.arange(len(weight))
    for n_before in reversed(range(len(events))):
        event = events[n_before]
        drawn = _Ancestors(event, event.state.particles[index], weight, elsewhere)
        yield drawn
        if len(event.state.parent):
            index = event.state.parent[index]
        elif event.is_restart:
            before = events[n_before - 1].state
            weight, elsewhere = before.weight, before.elsewhere
            if event.state.n_lost > before.n_lost:
                elsewhere = _LOST_PROB
            index = np.arange(len(weight))
        else:
            yield from (_before_drawing(event, drawn) for event in reversed(events[:n_before]))
            return


def _before_drawing(event: _Event, drawn: _Ancestors) -> _Ancestors:
    """Return the ancestors after an event that precedes the event at which the particles were first drawn."""
    led_m = drawn.event.state.reckoned[-1, 1:3] - event.state.reckoned[-1, 1:3]  # in the direction of the device
    particles = drawn.particles.copy()
    particles[:, :2] = earlier_positions(particles, led_m)
    return drawn._replace(event=event, particles=particles)


class _Row(NamedTuple):
    """Smoothed estimate of one step: position, length, and means and standard deviations of offset and log scale."""

    cluster: Cluster
    length_m: float
    offset: float  # rad
    offset_std: float  # rad
    log_scale: float
    log_scale_std: float
    is_off_plan: bool  # most of the weight is in walls, in holes or outside the outline


def _row(ancestors: _Ancestors, alternative: Alternative | None, ground: Ground | None) -> _Row:
    """Return the smoothed estimate of one step."""
    event, particles, weight, elsewhere = ancestors
    offset_rad, log_scales = particles[:, OFFSET], particles[:, SCALE]
    position_m, cov_m2 = weighted_moments(particles[:, [EAST, NORTH]], weight)
    cov_m2 = inflated_cov(position_m, cov_m2, alternative)
    offset = float(np.arctan2(weight @ np.sin(offset_rad), weight @ np.cos(offset_rad)))
    offset_std = float(np.sqrt(weight @ wrap_angle(offset_rad - offset) ** 2))
    # the mean position hardly moves if the particles walk in different directions: average their own lengths
    length_m = event.length_m * float(weight @ np.exp(log_scales))
    log_scale = float(weight @ log_scales)
    log_scale_std = float(np.sqrt(weight @ (log_scales - log_scale) ** 2))
    cluster = Cluster(1.0 - elsewhere, position_m, read_only(cov_m2 + _PLAN_STD_M**2 * np.eye(2)))
    is_off_plan = ground is not None and ground.is_off_plan(particles[:, [EAST, NORTH]], weight)
    return _Row(cluster, length_m, offset, offset_std, log_scale, log_scale_std, is_off_plan)


def _notes(offset_std_rad: FloatArray) -> tuple[str, ...]:
    """Return a note if the walking direction is unknown in many steps, given its standard deviations (K,)."""
    n, unknown = len(offset_std_rad), int((offset_std_rad > UNKNOWN_HEADING_RAD).sum())
    if unknown <= min(_UNKNOWN_NUMBER, _UNKNOWN_SHARE * n):
        return ()
    return (
        "several routes on the plan fit the walk, so that its direction is uncertain by more than "
        f"{UNKNOWN_HEADING_RAD} rad in {unknown} of {n} steps: positions of these steps are averages over the routes; "
        "give fixes or a radio map",
    )


def _observations(fixes: Sequence[Fix], track: Track) -> Table:
    """Return the table of the position fixes, with their use in a track."""
    observed = Observations(tuple(fix for fix in fixes if isinstance(fix, PositionFix)))
    results = {result.time_s: result for result in track.fixes}
    each = [results.get(fix.time_s) for fix in observed.fixes]
    observations = observation_table(observed).copy()
    observations.nis = [np.nan if result is None else result.nis for result in each]
    observations.weight = [float(result is not None and result.accepted) for result in each]
    observations.flags.writeable = False
    return observations


def _smoothed(track: Track, rows: Sequence[_Row], origin: Origin | None, observations: Table) -> Smoothed:
    """Return a track with the positions, headings and step lengths of the smoothed rows."""
    position = np.array([row.cluster.position_m for row in rows])
    length = np.array([row.length_m for row in rows])
    offset, offset_std = np.array([(row.offset, row.offset_std) for row in rows]).T
    heading = reference_headings(track.steps) + offset
    off_plan_s = track.time_s[[row.is_off_plan for row in rows]]
    off_plan = [note.text for note in off_plan_notes(len(off_plan_s), *off_plan_s[[0, -1]])] if len(off_plan_s) else []
    smoothed = replace(
        track,
        position_m=read_only(position),
        position_cov_m2=read_only(np.array([row.cluster.position_cov_m2 for row in rows])),
        step_length_m=read_only(length),
        walked_m=read_only(np.cumsum(length)),
        walking_heading_rad=read_only(wrap_angle(heading)),
        step_speed_mps=read_only(length / np.asarray(track.steps.duration_s)),
        clusters=tuple((row.cluster,) for row in rows),
        start_position_m=read_only(position_before(position[0], length[0], heading[0])),
        frame="plan",
        origin=origin,
        is_smoothed=True,
        notes=(*track.notes, *off_plan, *_notes(offset_std)),
    )
    return Smoothed(
        track=smoothed,
        heading_offset_rad=read_only(wrap_angle(offset)),
        heading_offset_std_rad=read_only(offset_std),
        log_scale=read_only(np.array([row.log_scale for row in rows])),
        log_scale_std=read_only(np.array([row.log_scale_std for row in rows])),
        start_position_m=smoothed.start_position_m,
        start_position_cov_m2=read_only(smoothed.position_cov_m2[0]),
        observations=observations,
        floor=floors_at_steps(smoothed, ()),
        notes=smoothed.notes,
    )
