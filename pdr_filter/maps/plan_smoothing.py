"""Smoothing of a walk on a floor plan: the ancestral paths of the final particles.

Each final particle has one ancestor at every earlier step. By the end of the walk, the plan and the fixes have already
judged the other descendants of that ancestor. A path that ended at a wall has no descendants. Means and covariances
over the ancestral paths, with the final weights, are those of the smoothed distribution (G. Kitagawa, "Monte Carlo
filter and smoother for non-Gaussian nonlinear state space models", J. Comput. Graph. Stat. 5, 1996).

Paths share more of their early steps the fewer particles there are. Therefore the smoother uses four times as many
particles as the online filter, and the covariance of the paths is never smaller than the accuracy of the plan. The
final probability that no particle is at the true position applies to all steps, and inflates their covariances up to
dead reckoning.

Drawing the ancestors again from all particles of the previous step (S. J. Godsill, A. Doucet and M. West, "Monte Carlo
smoothing for nonlinear time series", J. Amer. Stat. Assoc. 99, 2004) would change nothing. A step changes offset and
scale so little that of 4000 particles only 1.03 could be the ancestor (effective number, median on F1 and B1 of
ms_indoor), and of 16,000 only 1.4. Four times as many paths had the same errors with Wi-Fi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.maps.particle_clusters import inflated_cov, moments
from pdr_filter.maps.particle_filter import ParticleFilter, ParticleState
from pdr_filter.maps.particle_motion import EAST, NORTH, OFFSET, SCALE, earlier_positions
from pdr_filter.offline.smoothing.plan_result import SmoothedOnPlan
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.whole_recording import collected, outputs, position_before
from pdr_filter.values import Cluster, Fix, FixOutcome, FloatArray, FloorPassage, read_only, wrap_angle
from pdr_filter.values.recording import Recording

# Factor on the smallest number of particles of the online filter: paths share fewer of their early steps.
_PARTICLE_FACTOR = 4
# Accuracy of a position on a plan: drawn edges, and the distance that people keep from walls, vary by some decimetres.
_PLAN_STD_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Event:
    """State of the particles after one event.

    `is_restart` is True if the particles do not descend from those before the event. `reckoned` is the dead-reckoned
    position and its covariance after a step, None for other events.
    """

    state: ParticleState
    is_restart: bool
    reckoned: tuple[FloatArray, FloatArray] | None


@dataclass(frozen=True, eq=False)
class _RecordingFilter(ParticleFilter):
    """Particle filter that records all its states for the smoother.

    It needs many times the memory of the online filter.
    """

    events: list[_Event] = field(default_factory=list[_Event])

    def on_step(
        self, state: ParticleState, update: StepUpdate, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        reckoned = update.position_m, update.position_cov_m2
        return self._recorded(super().on_step(state, update, pedestrian, model), state, reckoned=reckoned)

    def on_gap(self, state: ParticleState, gap_s: float, model: PedestrianModel) -> ParticleState:
        return self._recorded(super().on_gap(state, gap_s, model), state)

    def on_fix(
        self,
        state: ParticleState,
        fix: Fix,
        outcome: FixOutcome,
        pedestrian: PedestrianState,
        model: PedestrianModel,
        floor: int,
    ) -> ParticleState:
        updated = super().on_fix(state, fix, outcome, pedestrian, model, floor)
        return self._recorded(updated, state, is_moved=outcome == "moved")

    def on_passage(
        self, state: ParticleState, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        return self._recorded(super().on_passage(state, passage, pedestrian, model), state)

    def _recorded(
        self,
        after: ParticleState,
        before: ParticleState,
        is_moved: bool = False,
        reckoned: tuple[FloatArray, FloatArray] | None = None,
    ) -> ParticleState:
        """Append the state after an event to `events`, and return this state.

        Each step is recorded, other events only if they changed the weights of the particles. `reckoned` is the
        dead-reckoned position and its covariance after a step, and None for other events. `is_moved` is True if a fix
        shifted the track.
        """
        is_lost = after.n_lost > before.n_lost
        if after.weight is not before.weight or reckoned is not None:
            self.events.append(_Event(after, (is_lost or is_moved) and len(before.weight) > 0, reckoned))
        return after


def smooth_on_plan(
    recording: Recording,
    config: Config,
    fixes: tuple[Fix, ...],
    with_location: bool = False,
    progress: Callable[[float], None] | None = None,
) -> SmoothedOnPlan:
    """Return the track of a configuration with a floor plan, smoothed over the whole recording.

    Raises ValueError if the configuration has no particle filter, or nothing places the walk on the plan. `progress` is
    called with the fraction done, 0 to 1. `with_location` uses the locations of the recording too.
    """
    online = config.on_plan
    if not isinstance(online, ParticleFilter):
        raise ValueError(
            f"smoothing on a plan needs a configuration with a particle filter, got {online!r}: use Config.with_plan"
        )
    n_least = _PARTICLE_FACTOR * online.n_least
    on_plan = _RecordingFilter(
        online.plan, online.start, online.terrain, n_least, max(n_least, online.n_most), seed=online.seed
    )
    config = replace(config.in_hindsight(), on_plan=on_plan)
    track = collected(recording, config, outputs(recording, config, fixes, progress, with_location))
    if not any(track.clusters):
        raise ValueError(
            "the position of the walk on the plan is unknown: give fixes, or start, such as the name of an area"
        )
    rows = _ancestral_rows(on_plan.events, includes_reckoned=online.start is None)
    position = np.array([row.cluster.position_m for row in rows])
    moved = np.diff(position, axis=0, prepend=position[:1])
    offset, scale = np.array([row.offset for row in rows]), np.array([row.scale for row in rows])
    heading = np.asarray(track.steps.device_heading_rad) + offset[:, 0]
    length = track.step_length_m.copy()
    length[1:] = np.hypot(*moved[1:].T)
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
        origin=online.plan.origin,
        is_smoothed=True,
    )
    return SmoothedOnPlan(smoothed, *(read_only(column) for column in (*offset.T, *scale.T)))


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """Smoothed estimate of one step.

    `offset` (rad) and `scale` (log) are each a mean and a standard deviation.
    """

    cluster: Cluster
    offset: tuple[float, float]
    scale: tuple[float, float]


def _ancestral_rows(events: list[_Event], includes_reckoned: bool) -> list[_Row]:
    """Return the smoothed rows of all steps, in order, by following the ancestors backwards from the last event.

    `includes_reckoned` inflates the covariances up to dead reckoning, with the final probability that no particle is at
    the true position.
    """
    rows: list[_Row] = []
    led_m = [s.state.way[-1, 1:3] for s in events]  # dead-reckoned positions in the direction of the device
    last = events[-1].state
    particles, weight, chosen = last.particles, last.weight, np.arange(len(last.weight))
    # event at which the particles were drawn; earlier positions follow from its offsets and scales alone
    anchor: int | None = None
    for i in range(len(events) - 1, -1, -1):
        s = events[i]
        if anchor is None:
            particles = s.state.particles[chosen]
        if s.reckoned is not None:
            at = particles
            if anchor is not None:
                at = particles.copy()
                at[:, :2] = earlier_positions(particles, led_m[anchor] - led_m[i])
            rows.append(_row(at, weight, last.elsewhere, s.reckoned if includes_reckoned else None))
        if anchor is not None:
            continue
        if len(s.state.parent):
            chosen = s.state.parent[chosen]
        elif s.is_restart:
            weight = events[i - 1].state.weight
            chosen = np.arange(len(weight))
        else:
            anchor = i
    return rows[::-1]


def _row(
    particles: FloatArray, weight: FloatArray, elsewhere: float, alternative: tuple[FloatArray, FloatArray] | None
) -> _Row:
    """Return the smoothed row of one step from its weighted particles (N, 6)."""
    position_m, cov_m2 = moments(particles[:, [EAST, NORTH]], weight)
    cov_m2 = inflated_cov(position_m, cov_m2, elsewhere, alternative)
    # headings are circular: average the differences from the first particle's
    about = particles[0, OFFSET]
    turned = wrap_angle(particles[:, OFFSET] - about)
    (offset, offset_std), (scale, scale_std) = (_mean_and_std(v, weight) for v in (turned, particles[:, SCALE]))
    cluster = Cluster(1.0 - elsewhere, position_m, read_only(cov_m2 + _PLAN_STD_M**2 * np.eye(2)))
    return _Row(cluster, (float(about + offset), offset_std), (scale, scale_std))


def _mean_and_std(values: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return the weighted mean and standard deviation of values (N,)."""
    mean = float(weight @ values)
    return mean, float(np.sqrt(weight @ (values - mean) ** 2))
