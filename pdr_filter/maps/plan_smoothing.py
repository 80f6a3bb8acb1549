"""A walk on a floor plan in hindsight: the ways that led to the particles of the end.

Each particle of the end has a mother at every step before, and what the plan and the fixes made of the mother's other
daughters is known by then: a way that ended at a wall has no daughters. Means and covariances over those ways, with the
weights of the end, are those of the smoothed distribution (G. Kitagawa, "Monte Carlo filter and smoother for
non-Gaussian nonlinear state space models", J. Comput. Graph. Stat. 5, 1996). Ways share their first steps
the sooner the fewer particles there are: there are four times as many as online, and the covariance of ways is never
taken to be less than the plan can show. Where the end is doubted, all is, and it reaches dead reckoning.

Drawing mothers anew from all particles of the step before (S. J. Godsill, A. Doucet and M. West, "Monte Carlo smoothing
for nonlinear time series", J. Amer. Stat. Assoc. 99, 2004) would change nothing: a step changes offset and scale so
little that of 4000 particles 1.03 could be the mother (effective number, median on F1 and B1 of ms_indoor), and 1.4 of
16,000. Four times as many ways had the same errors with Wi-Fi.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.maps.particle_clusters import moments, reaching
from pdr_filter.maps.particle_filter import ParticleFilter, ParticleState
from pdr_filter.maps.particle_motion import EAST, NORTH, OFFSET, SCALE, backwards
from pdr_filter.offline.smoothing.plan_result import Hindsight
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.whole_recording import collected, outputs, position_before
from pdr_filter.values import Cluster, Fix, FixOutcome, FloatArray, FloorPassage, read_only, wrap_angle
from pdr_filter.values.recording import Recording

_MORE = 4
# How well a plan shows where somebody is: edges are drawn, and kept away from, to some decimetres.
_PLAN_STD_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Particles after one event."""

    state: ParticleState
    is_restart: bool  # what was before has nothing to do with them
    reckoned: tuple[FloatArray, FloatArray] | None  # of a step: position and covariance of dead reckoning


@dataclass(frozen=True, eq=False)
class _Remembering(ParticleFilter):
    """The same filter, which remembers all its states: many times the memory that the filter needs."""

    seen: list[_Seen] = field(default_factory=list[_Seen])

    def on_step(
        self, state: ParticleState, update: StepUpdate, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        reckoned = update.position_m, update.position_cov_m2
        return self._remembered(super().on_step(state, update, pedestrian, model), state, reckoned=reckoned)

    def on_gap(self, state: ParticleState, gap_s: float, model: PedestrianModel) -> ParticleState:
        return self._remembered(super().on_gap(state, gap_s, model), state)

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
        return self._remembered(updated, state, is_moved=outcome == "moved")

    def on_passage(
        self, state: ParticleState, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        return self._remembered(super().on_passage(state, passage, pedestrian, model), state)

    def _remembered(
        self,
        after: ParticleState,
        before: ParticleState,
        is_moved: bool = False,
        reckoned: tuple[FloatArray, FloatArray] | None = None,
    ) -> ParticleState:
        is_lost = after.n_lost > before.n_lost
        if after.weight is not before.weight or reckoned is not None:
            self.seen.append(_Seen(after, (is_lost or is_moved) and len(before.weight) > 0, reckoned))
        return after


def smooth_on_plan(
    recording: Recording,
    config: Config,
    fixes: tuple[Fix, ...],
    with_location: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Hindsight:
    """The track of a configuration with a floor plan, each step as the whole recording shows it."""
    online = config.on_plan
    if not isinstance(online, ParticleFilter):
        raise ValueError(f"smoothing on a plan needs a particle filter, got {online!r}: use Config.with_plan")
    n_least = _MORE * online.n_least
    on_plan = _Remembering(
        online.plan, online.start, online.terrain, n_least, max(n_least, online.n_most), seed=online.seed
    )
    config = replace(config.in_hindsight(), on_plan=on_plan)
    track = collected(recording, config, outputs(recording, config, fixes, progress, with_location))
    if not any(track.clusters):
        raise ValueError(
            "nothing says where on the plan the walk was: give fixes, or start, such as the name of an area"
        )
    rows = _ways(on_plan.seen, reaches=online.start is None)
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
    return Hindsight(smoothed, *(read_only(column) for column in (*offset.T, *scale.T)))


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One step in hindsight."""

    cluster: Cluster
    offset: tuple[float, float]  # mean and standard deviation
    scale: tuple[float, float]


def _ways(seen: list[_Seen], reaches: bool) -> list[_Row]:
    """The rows of all steps, in their order.

    `reaches`: their covariances reach dead reckoning, as far as the end is doubted.
    """
    rows: list[_Row] = []
    led_m = [s.state.way[-1, 1:3] for s in seen]  # where the steps led in the direction of the device
    last = seen[-1].state
    particles, weight, chosen = last.particles, last.weight, np.arange(len(last.weight))
    anchor: int | None = None  # event before which nothing is known of the particles but where they came from
    for i in range(len(seen) - 1, -1, -1):
        s = seen[i]
        if anchor is None:
            particles = s.state.particles[chosen]
        if s.reckoned is not None:
            at = particles
            if anchor is not None:
                at = particles.copy()
                at[:, :2] = backwards(particles, led_m[anchor] - led_m[i])
            rows.append(_row(at, weight, last.elsewhere, s.reckoned if reaches else None))
        if anchor is not None:
            continue
        if len(s.state.parent):
            chosen = s.state.parent[chosen]
        elif s.is_restart:
            weight = seen[i - 1].state.weight
            chosen = np.arange(len(weight))
        else:
            anchor = i
    return rows[::-1]


def _row(
    particles: FloatArray, weight: FloatArray, elsewhere: float, there: tuple[FloatArray, FloatArray] | None
) -> _Row:
    position_m, cov_m2 = moments(particles[:, [EAST, NORTH]], weight)
    cov_m2 = reaching(position_m, cov_m2, elsewhere, there)
    # headings go round: about the first of them
    about = particles[0, OFFSET]
    turned = wrap_angle(particles[:, OFFSET] - about)
    (offset, offset_std), (scale, scale_std) = (_mean_and_std(v, weight) for v in (turned, particles[:, SCALE]))
    cluster = Cluster(1.0 - elsewhere, position_m, read_only(cov_m2 + _PLAN_STD_M**2 * np.eye(2)))
    return _Row(cluster, (float(about + offset), offset_std), (scale, scale_std))


def _mean_and_std(values: FloatArray, weight: FloatArray) -> tuple[float, float]:
    mean = float(weight @ values)
    return mean, float(np.sqrt(weight @ (values - mean) ** 2))
