"""Particle filter that keeps a tracked walk on a floor plan.

The filter runs behind the tracker. All particles take the steps that the tracker reports, and a particle that crosses a
wall loses weight. A particle holds a position on the plan, a heading offset and a log scale, which correspond to the
states of the tracker's modes. It also holds the rotation from the frame of the start to the plan, and the cost of the
walls, rooms and outlines that it crossed recently.

Prediction: each step moves a particle according to `filter.imm.motion_model`, in a mode drawn from the tracker's mode
probabilities. The walking direction estimated from the strides is used in closed form, as in a Rao-Blackwellised
filter.

Weights: a step has a likelihood on the plan (`Terrain`), and so have the fixes that the tracker used. The likelihood of
a step is divided by its mean over all directions, because the pedestrian chooses one of the free directions. In a
corridor few directions are free, so a step along the corridor increases the weight more than a step in a hall. Without
this division, noise would pull the particles out of corridors, because noisy steps hit corridor walls more often than
the walls of a hall.

Initialisation: particles are drawn at the given start, or from the tracker's estimate. They are drawn again at each fix
while the rotation of the track is still unknown, and when no particle fits the steps any more. The tracker itself does
not use the plan, so that a wrong plan cannot lead the track away permanently. If most particles are drawn off the plan,
it is not used until most of them are inside. Otherwise the particles that leave the hole first would win.

Lost walks: from an unknown start, the particles may be too few to cover all positions, and the true position can be
lost. The remaining particles then pay more for the plan than a random walk would. That excess is accumulated in
`ParticleState.lost_log_odds`.

Wrong starts and wrong plans: particles drawn again find some way through any building. The mean weight of a step is
its Bayes factor of the plan against free ground, where every direction is free. `ParticleState.wrong_log_odds`
accumulates these factors over all sets of particles. A walk on the right plan gains evidence in its corridors. A walk
with a wrong start loses it at each wall that its particles do not avoid, because the drift that leads around the wall
is improbable.

References
----------
M. S. Arulampalam et al., "A tutorial on particle filters for online nonlinear/non-Gaussian Bayesian tracking", IEEE
Trans. Signal Processing 50, 2002. The log odds are similar to the augmented localisation of S. Thrun, W. Burgard and D.
Fox, "Probabilistic Robotics", 2005, section 8.3.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.random import Generator, Philox

from pdr_filter.apps.maps.crossing_costs import Ground, Terrain
from pdr_filter.apps.maps.particle_clusters import Alternative, n_needed, on_plan
from pdr_filter.apps.maps.particle_motion import (
    CROSSED,
    EAST,
    N_COLUMNS,
    NORTH,
    OFFSET,
    SCALE,
    TURN,
    advance_offsets,
    earlier_positions,
    extended_path,
    rotated_vectors,
)
from pdr_filter.apps.maps.start_area import Start, anywhere_on
from pdr_filter.apps.maps.storey import Storeys
from pdr_filter.filter.chain.handler import FixUse
from pdr_filter.filter.chain.with_plan import PlanEvent as ChainPlanEvent
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, MAX_HEADING_VARIANCE, stepless_var_m2
from pdr_filter.filter.pedestrian.frame_rotation import Compass
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.values import (
    FloatArray,
    FloorPassage,
    GridFix,
    HeadingFix,
    IntArray,
    Measurement,
    Note,
    OnPlan,
    PositionFix,
    RangeFix,
    SpeedFix,
    Standstill,
    check_numbers,
    how_many,
    interpolated_rows,
    measurement_of,
    range_log_densities,
    range_residuals,
    repetition,
    wrap_angle,
)
from pdr_filter.values.mixtures import log_sum, softmax

# Cell size for counting the occupied cells, which sets the number of particles: metres, and a twelfth of a circle.
_COUNT_M, _COUNT_RAD = 1.0, math.pi / 6
# Steps between two adjustments of the number of particles. The number is also adjusted at each resampling.
_COUNT_STEPS = 8
# Standard deviation added to the log scale after resampling, which separates the copies of one particle. All other
# columns are separated by the noise of the next steps.
_SCALE_JITTER = 0.005
# Resample if the effective sample size falls below this share of the number of particles.
_RESAMPLE_SHARE = 0.5
# Below this effective sample size the particle set is degenerate and is drawn again.
_LEAST_EFFECTIVE = 5.0
# Prior odds of an outlier are one to a thousand. This limits how much a single measurement can lower a weight.
_OUTLIER_LOG_ODDS = math.log(1000.0)
# If a fix that rotates the track leaves an effective sample size below this share, the particles are drawn again from
# the tracker. The old particles cannot represent the new rotation well, and the tracker has it in closed form.
_MIN_SAMPLE_SHARE = 0.9
# Log odds that no particle is at the true position. The initial value is 0 (even odds) if particles were drawn from a
# whole area, because they are too few to cover every heading and scale at every position. At a known position it is the
# smallest one, because plans have errors. At a hundred to one, no particle fits the steps, and they are drawn again.
# Upper limits of 2.3 to 9.2 gave the same medians on storey F1 of the mall within 0.1 m. The log odds of a wrong start
# or plan have the same limits, so that a walk that has found its way back regains its probability.
#
# The smallest odds are one to a thousand. Walks with a right start lose evidence as well, because only few of the
# directions drawn at the start, and of the ways around each corner, remain. On storey F1 of ms_indoor, 33 of 34 right
# starts lose less than 6.9. So do 28 of 34 starts that are 40 m off: short walks through wide halls do not show them.
_LOST_IN_AREA_LOG_ODDS, _LEAST_LOST_LOG_ODDS, _MOST_LOST_LOG_ODDS = 0.0, -6.9, 4.6
# A step contradicts the plan if its Bayes factor against free ground is below this value: a fifth of the particles met
# walls. A step inside a room without a door, which costs `Terrain.stay_room`, is below it.
_CONTRADICTED_LOG_FACTOR = math.log(0.8)
# Forgetting factor per step of the crossing cost of a particle. Particles that crossed a wall are few at first. It
# takes some steps until the particles that did not cross have lost their weight.
_THROUGH_MEMORY = 0.95
_MAX_EVENTS = 16
_OFF_PLAN = "in a wall, in a hole of the plan or outside of its outline"
# Additional independent variance of each step length: people stop, turn and walk around others. Without it, the scale
# would have to explain these variations. On storeys F1 and B1 of ms_indoor, legs of about 8 m and 11 steps have errors
# of 0.9 m whatever their length. Two waypoints tapped on a plan, each with an error of 0.5 m, explain 0.7 m of that. Of
# 0, 0.1, 0.15 and 0.2 m, the last had the smallest errors there. Its 95 % regions held 96 and 97 % of the waypoints (94
# and 95 % without the additional variance).
_UNEVEN_VAR_M2 = 0.2**2


@dataclass(frozen=True, slots=True)
class PlanEvent:
    """Contradiction between the floor plan and the steps."""

    time_s: float
    # feature that most of the weight has crossed: "wall", "room" or "outline"; "lost" if no particle fits the steps
    what: str
    name: str  # name of the room, or an empty string


@dataclass(frozen=True, slots=True, eq=False)
class ParticleState:
    """State of the particle filter after one event: a step, a fix, a gap or a change of storey."""

    # (N, 6) with the columns of `maps.particle_motion`
    particles: FloatArray = field(default_factory=lambda: np.empty((0, N_COLUMNS)))
    weight: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,), sum is one
    # (N,) index of the ancestor in the previous state; empty if the particles were newly drawn
    parent: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    # (R, 4) time, east, north and device heading after each of the last R steps; the step lengths are means over the
    # modes, and the steps point in the direction of the device
    reckoned: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    heading_rad: float = 0.0  # device heading at the last step
    turned_rad: float = 0.0  # rotation of the tracker's frame that the particles already include (`_turned_rad`)
    compass: Compass | None = None  # density that is already included in the weights
    last_fix_s: float = -math.inf
    last_grid_s: float = -math.inf
    lost_log_odds: float = 0.0  # that no particle is at the true position, since the particles were drawn
    wrong_log_odds: float = _LEAST_LOST_LOG_ODDS  # that the start or the plan is wrong, over all sets of particles
    n_draws: int = 0  # random draws so far; the next random numbers depend only on the seed and this number
    events: tuple[PlanEvent, ...] = ()  # latest contradictions between plan and steps
    n_contradicted: int = 0  # steps that contradict the plan
    n_lost: int = 0  # times that the particles were drawn again because none fitted the steps
    is_placed: bool = False  # whether fixes have placed the track of the tracker on the plan
    uses_plan: bool = True  # False until most of the weight has been inside since the particles were drawn
    # times of the first and the last step after which most of the weight was in walls, holes or outside, and the number
    # of such steps
    off_plan_s: tuple[float, float] = (math.nan, math.nan)
    n_off_plan: int = 0

    @property
    def elsewhere(self) -> float:
        """Probability that no particle is at the true position."""
        return 1.0 / (1.0 + math.exp(-max(self.lost_log_odds, self.wrong_log_odds)))


class _Context(NamedTuple):
    """Context of one event: what the methods that handle it need besides the state of the particles."""

    pedestrian: PedestrianState  # state of the tracker after the event
    model: PedestrianModel
    ground: Ground | None  # costs of the storey, None if the plan does not have it
    rng: Generator
    time_s: float
    scale_std: float = 0.0  # standard deviation of the log scale due to the step-length parameters


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """Particle filter that moves the steps of a tracker along a floor plan.

    The filter itself never changes: each method returns a new state, computed from the previous state and one event.
    The number of particles adapts to the area that they cover, between `n_least` and `n_most`.

    Attributes
    ----------
    plan : FloorPlan
        The floor plan.
    start : Start or None, default None
        Start position or start area on the plan. None starts from the position of the tracker.
    terrain : Terrain
        Costs of crossing walls, rooms and the outline.
    n_least : int, default 1000
        Smallest number of particles.
    n_most : int, default 50000
        Largest number of particles.
    seed : int, default 0
        Seed of the random numbers. Equal seeds and events give equal states.

    Raises
    ------
    ValueError
        If a number is not positive (the seed may be zero), or `n_least` is above `n_most`.

    See Also
    --------
    pdr_filter.Config.with_plan : Configuration with a floor plan; the usual way to use this filter.
    pdr_filter.FloorPlan.stage : Filter for a plan, with default costs and numbers of particles.

    Notes
    -----
    A saved filter contains the plan. A plan of 300 m x 300 m takes 22 MB of memory.

    References
    ----------
    M. S. Arulampalam et al., "A tutorial on particle filters for online nonlinear/non-Gaussian Bayesian tracking", IEEE
    Trans. Signal Processing 50, 2002.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.apps.maps.particle_filter import ParticleFilter
    >>> particles = ParticleFilter(pdr.FloorPlan("hall", ()))
    >>> particles.n_least, particles.n_most
    (1000, 50000)
    >>> len(particles.init().weight)  # particles are drawn at the first step
    0
    """

    plan: Storeys
    start: Start | None = None
    terrain: Terrain = field(default_factory=Terrain)
    n_least: int = 1000
    n_most: int = 50_000
    seed: int = 0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("seed",))
        if self.n_least > self.n_most:
            raise ValueError(f"n_least must not be above n_most, got {self.n_least} and {self.n_most}")

    @cached_property
    def _grounds(self) -> dict[int, Ground]:
        """Costs of each storey, by its number."""
        return {storey.floor: Ground(storey, self.terrain) for storey in self.plan.storeys}

    def ground(self, floor: int) -> Ground | None:
        """Return the costs of a storey.

        Parameters
        ----------
        floor : int
            Number of the storey, 0 for the ground floor. Ignored if the plan has only one storey.

        Returns
        -------
        Ground or None
            Costs of the cells of the storey, or None if the plan does not have it.
        """
        if len(self._grounds) == 1:
            return next(iter(self._grounds.values()))
        return self._grounds.get(floor)

    def init(self) -> ParticleState:
        """Return the initial state, without particles.

        Particles are drawn at the first step, or at the first fix that places the track.

        Returns
        -------
        ParticleState
            State without particles.
        """
        return ParticleState()

    # --- events -------------------------------------------------------------------------------------------------------

    def on(
        self, state: ParticleState, event: ChainPlanEvent, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        """Return the state after a final step, a fix, a floor passage or a gap.

        Parameters
        ----------
        state : ParticleState
            State before the event.
        event : StepUpdate, FixUse, FloorPassage or Gap
            Row of a step, use of a fix by the tracker, change of storey, or time without samples.
        pedestrian : PedestrianState
            State of the tracker after the event.
        model : PedestrianModel
            Motion model of the tracker.

        Returns
        -------
        ParticleState
            State after the event. It has no particles until a start or a fix has placed the track.
        """
        if isinstance(event, StepUpdate):
            return self._after_step(state, event, pedestrian, model)
        if isinstance(event, FixUse):
            return self._after_fix(state, event, pedestrian, model)
        if isinstance(event, FloorPassage):
            return self._after_passage(state, event, pedestrian, model)
        return self._after_gap(state, event.duration_s, model)

    def _after_step(
        self, state: ParticleState, update: StepUpdate, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        """Return the state after a step, and count the step if it ends off the plan."""
        rng, state = self._random(state)
        now = _Context(pedestrian, model, self.ground(update.floor), rng, update.step.time_s)
        state = self._with_step(state, update, now)
        if now.ground is None or len(state.weight) == 0:
            return state
        if not now.ground.is_off_plan(state.particles[:, :2], state.weight):
            return replace(state, uses_plan=True)
        first_s = state.off_plan_s[0] if state.n_off_plan else now.time_s
        return replace(state, off_plan_s=(first_s, now.time_s), n_off_plan=state.n_off_plan + 1)

    def _with_step(self, state: ParticleState, update: StepUpdate, now: _Context) -> ParticleState:
        """Return the state after a step, without the count of steps off the plan.

        Each particle takes the step in a mode drawn from the mode probabilities. Its weight is multiplied by the
        likelihood of the walking direction and by the plan's probability of the step.
        """
        step, pedestrian, model = update.step, now.pedestrian, now.model
        length_m, _, own_var_m2, parameter_std_m = model.lengths(step)
        mean_m = float(update.mode_prob @ length_m)
        # the error of the step-length parameters is one draw per person, as that of the scale, not one per step
        now = now._replace(scale_std=float(update.mode_prob @ parameter_std_m) / mean_m if mean_m > 0 else 0.0)
        is_first = len(state.reckoned) == 0 or update.gap_before_s > 0
        since_s = step.duration_s if is_first else step.time_s - state.reckoned[-1, 0]
        is_placed = pedestrian.frame.is_joined or pedestrian.frame.rotation is not None
        state = replace(
            _in_turned_frame(state, pedestrian),
            reckoned=extended_path(state.reckoned, step, mean_m),
            heading_rad=step.reference_heading_rad,
            is_placed=is_placed,
        )
        if len(state.weight) == 0:
            if self.start is not None:
                return self._from_start(state, self.start, now)
            return self._from_tracker(state, now) if is_placed else state
        n = len(state.weight)
        x, from_m = state.particles.copy(), state.particles[:, :2]
        z, prob = now.rng.standard_normal((4, n)), np.cumsum(update.mode_prob)[:-1]
        mode = np.searchsorted(prob, now.rng.random(n), side="right")
        log_weight = advance_offsets(x, step, pedestrian, model, since_s, mode, z[0])
        own_std_m = np.sqrt(own_var_m2 + _UNEVEN_VAR_M2)
        scaled_m = np.exp(x[:, SCALE]) * (length_m[mode] + own_std_m[mode] * z[1])
        own = model.directions
        psi = step.reference_heading_rad + x[:, OFFSET]
        psi += own.heading_offset_rad[mode] + np.sqrt(own.step_var_rad2(step.turned_rad))[mode] * z[2]
        x[:, EAST] += scaled_m * np.sin(psi)
        x[:, NORTH] += scaled_m * np.cos(psi)
        extra_var_m2 = own.extra_var_m2 + stepless_var_m2(step.stepless_s)
        if extra_var_m2.any():
            x[:, :2] += np.sqrt(extra_var_m2)[mode, None] * now.rng.standard_normal((n, 2))
        noise = model.noise
        x[:, SCALE] = noise.log_scale_memory * x[:, SCALE] + math.sqrt(noise.log_scale_drift_var) * z[3]
        state, log_compass = _with_compass(state, pedestrian)
        state, _ = _reweighted(replace(state, particles=x, parent=np.arange(n)), log_weight + log_compass)
        if now.ground is not None and state.uses_plan:
            up, down = model.on_stairs
            cost, through = now.ground.costs(from_m, x[:, :2], (up + down)[mode] > 0)
            x[:, CROSSED] = _THROUGH_MEMORY * x[:, CROSSED] + through
            # particles that pay more for the plan than a random walk on this storey are probably at a wrong position
            log_share = math.log(float(state.weight @ np.exp(-cost)))
            lost_log_odds = state.lost_log_odds - log_share - mean_m * now.ground.mean_cost_per_m
            state, log_factor = _reweighted(state, now.ground.choice_cost(from_m, mean_m) - cost)
            wrong_log_odds = max(state.wrong_log_odds - log_factor, _LEAST_LOST_LOG_ODDS)
            state = replace(
                state,
                lost_log_odds=max(lost_log_odds, _LEAST_LOST_LOG_ODDS),
                wrong_log_odds=min(wrong_log_odds, _MOST_LOST_LOG_ODDS),
                n_contradicted=state.n_contradicted + (log_factor < _CONTRADICTED_LOG_FACTOR),
            )
            state = self._with_contradiction(state, step.time_s, now.ground)
        return self._resampled(state, now, must_count=update.index % _COUNT_STEPS == 0)

    def _after_gap(self, state: ParticleState, gap_s: float, model: PedestrianModel) -> ParticleState:
        """Return the state after a time without samples, in which the pedestrian may have walked in any direction."""
        if len(state.weight) == 0:
            return state
        rng, state = self._random(state)
        z, x = rng.standard_normal((3, len(state.weight))), state.particles.copy()
        x[:, [EAST, NORTH]] += np.sqrt(model.noise.gap_var_m2(gap_s)) * z[:2].T
        turned_var = np.minimum(model.noise.heading_drift.unmeasured_rad2(gap_s), MAX_HEADING_VARIANCE)
        x[:, OFFSET] += np.sqrt(turned_var) * z[2]
        return replace(state, particles=x, parent=np.arange(len(x)))

    def _after_fix(
        self, state: ParticleState, use: FixUse, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        """Return the state after a fix that the tracker has used or rejected.

        Position and heading fixes change the weights only if the tracker used them. Grid fixes, ranges and other
        measurements do so whether or not the tracker used them, because particles do not need a linear update. Such
        measurements are ignored if they are from before the first remembered step. Speeds, standstills and repeated
        fixes are always ignored.
        """
        fix, outcome, _, floor = use
        if len(state.reckoned) == 0 or isinstance(fix, SpeedFix | Standstill) or outcome == "repeated":
            return state
        is_own = isinstance(fix, PositionFix | HeadingFix)
        if not is_own and outcome not in ("placed", "moved"):
            if len(state.weight) == 0 or fix.time_s < state.reckoned[0, 0]:
                return state
        elif outcome not in ("used", "placed", "turned", "moved"):
            return state
        rng, state = self._random(state)
        now = _Context(pedestrian, model, self.ground(floor), rng, fix.time_s)
        is_turned = outcome == "turned" or (isinstance(fix, HeadingFix) and _turned_rad(pedestrian) != state.turned_rad)
        state = _in_turned_frame(state, pedestrian)
        if self.start is None and (len(state.weight) == 0 or outcome == "moved"):
            return self._from_tracker(state, now)
        if len(state.weight) == 0:
            return state
        x, at_fix = state.particles, interpolated_rows(fix.time_s, state.reckoned[:, 0], state.reckoned[:, 1:4])
        position_m = earlier_positions(x, state.reckoned[-1, 1:3] - at_fix[:2])
        if isinstance(fix, HeadingFix):
            error_rad = wrap_angle(fix.walking_heading_rad - at_fix[2] - x[:, OFFSET])
            log_weight = -0.5 * (error_rad / fix.std_rad) ** 2
        elif isinstance(fix, GridFix):
            log_weight = fix.log_likelihood_at(position_m) / repetition(fix, state.last_grid_s)
            state = replace(state, last_grid_s=fix.time_s)
        elif isinstance(fix, PositionFix):
            error_m, cov_m2 = position_m - fix.position_m, repetition(fix, state.last_fix_s) * fix.cov_m2
            log_weight = -0.5 * ((error_m @ np.linalg.inv(cov_m2)) * error_m).sum(axis=1)
            state = replace(state, last_fix_s=fix.time_s)
        else:
            log_weight = _log_density(fix, position_m, at_fix[2] + x[:, OFFSET])
        state, _ = _reweighted(replace(state, parent=np.arange(len(x))), log_weight)
        if is_turned and self.start is None and _n_effective(state) < _MIN_SAMPLE_SHARE * len(x):
            return self._from_tracker(state, now)
        return self._resampled(state, now)

    def _after_passage(
        self, state: ParticleState, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        """Return the state after a change of storey. After a ride, particles far from every lift lose weight."""
        ground = self.ground(passage.to_floor)
        if passage.how != "lift" or ground is None or len(state.weight) == 0 or len(state.reckoned) == 0:
            return state
        rng, state = self._random(state)
        then_m = interpolated_rows(passage.end_s, state.reckoned[:, 0], state.reckoned[:, 1:3])
        out_m = earlier_positions(state.particles, state.reckoned[-1, 1:3] - then_m)
        state, _ = _reweighted(replace(state, parent=np.arange(len(out_m))), -ground.lift_costs(out_m))
        return self._resampled(state, _Context(pedestrian, model, ground, rng, passage.end_s))

    # --- estimates ----------------------------------------------------------------------------------------------------

    def estimate(self, state: ParticleState, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
        """Return the position estimate of the particles.

        The covariance includes the position of `alternative`, with the probability that no particle is at the true
        position.

        Parameters
        ----------
        state : ParticleState
            State after a step.
        reckoned : tuple of array (2,) and array (2, 2)
            Dead-reckoned position in m and its covariance in m^2.

        Returns
        -------
        OnPlan or None
            Mean, covariance and clusters of the particles, or None before the first particles.
        """
        if len(state.weight) == 0:
            return None
        heading_rad = state.heading_rad + state.particles[:, OFFSET]
        alternative = self.alternative(state, reckoned, state.elsewhere)
        return on_plan(state.particles[:, :2], state.weight, heading_rad, state.elsewhere, alternative)

    def alternative(
        self, state: ParticleState, reckoned: tuple[FloatArray, FloatArray], elsewhere: float
    ) -> Alternative | None:
        """Return the distribution of the position if no particle is at the true position.

        It is that of dead reckoning, if fixes place it on the plan. Otherwise the walk began anywhere on the storey of
        the start and has led in any direction, as far as dead reckoning has moved. A tenth of this spread would be more
        than the error of most walks with a right start. It therefore counts by the excess of `elsewhere` over even
        odds, 2 p - 1.

        Parameters
        ----------
        state : ParticleState
            State after a step.
        reckoned : tuple of array (2,) and array (2, 2)
            Dead-reckoned position in m and its covariance in m^2.
        elsewhere : float
            Probability that no particle is at the true position.

        Returns
        -------
        Alternative or None
            Probability, mean and covariance, or None if the plan does not have the storey.
        """
        if self.start is None or state.is_placed:
            return Alternative(elsewhere, *reckoned)
        ground = self.ground(self.start.floor)
        if ground is None:
            return None
        mean_m, cov_m2 = ground.walkable_moments
        moved_m2 = float(reckoned[0] @ reckoned[0] + np.trace(reckoned[1]))
        return Alternative(max(2.0 * elsewhere - 1.0, 0.0), mean_m, cov_m2 + 0.5 * moved_m2 * np.eye(2))

    def notes(self, state: ParticleState) -> list[Note]:
        """Return warnings about contradictions between the plan and the steps.

        Parameters
        ----------
        state : ParticleState
            State with the latest events.

        Returns
        -------
        list of Note
            One about a wrong start or plan, one per event, with its time and likely cause, and one about steps off the
            plan.
        """
        notes: list[Note] = []
        if state.n_lost or state.wrong_log_odds > 0.0:
            words = (
                f"{how_many(state.n_contradicted, 'step')} contradict the plan, and with a probability of "
                f"{100 * state.elsewhere:.0f} % the walk is elsewhere: the start, the fixes or the plan are wrong, or "
                "the plan lacks doors; correct them"
            )
            notes.append(Note("plan", words))
        for event in state.events:
            words = {
                "wall": "the walk crosses a wall: check whether the plan lacks a door there",
                "room": f"the walk enters {event.name or 'a room'}, to which the plan has no door: add it if it exists",
                "outline": "the walk leaves the outline of the floor: check whether the plan is complete",
                "lost": "nothing on the plan fits the steps: the track starts again from dead reckoning",
            }[event.what]
            notes.append(Note("plan", f"about {event.time_s:.0f} s {words}"))
        return [*self._start_notes, *notes, *off_plan_notes(state.n_off_plan, *state.off_plan_s)]

    @cached_property
    def _start_notes(self) -> list[Note]:
        """Return a note if the given start position is off the plan."""
        ground = None if self.start is None or len(self.start.cells) else self.ground(self.start.floor)
        if self.start is None or ground is None or not ground.is_closed(self.start.position_m):
            return []
        east_m, north_m = self.start.position_m
        words = (
            f"the start at {east_m:z.1f} m east, {north_m:z.1f} m north is {_OFF_PLAN}: the walk starts at the nearest "
            "walkable places within the standard deviation of the start, or the plan is used once the walk is inside; "
            "correct the start or the plan"
        )
        return [Note("plan", words)]

    # --- parts --------------------------------------------------------------------------------------------------------

    def _random(self, state: ParticleState) -> tuple[Generator, ParticleState]:
        """Return the random number generator of the next event, and the state that counts the draw."""
        numbers = Generator(Philox(key=self.seed, counter=[0, 0, 0, state.n_draws]))
        return numbers, replace(state, n_draws=state.n_draws + 1)

    def _from_tracker(self, state: ParticleState, now: _Context) -> ParticleState:
        """Return the state with particles drawn from the tracker's estimate.

        The tracker's estimate is a normal distribution. While the rotation of the track is unknown, the rotations are
        drawn from the tracker's density over all angles.
        """
        frame, estimates = now.pedestrian.frame, now.pedestrian.estimates
        x, combined = estimates.combined
        P = combined.copy()
        P[:2, :2] += estimates.consider_cov_m2
        P[LOG_SCALE, LOG_SCALE] += now.scale_std**2
        rotation = None if frame.is_joined else frame.rotation
        n = min((2 if rotation is None else 5) * self.n_least, self.n_most)
        particles = np.zeros((n, N_COLUMNS))
        # the small diagonal keeps the Cholesky factorisation valid where a variance is zero
        particles[:, :4] = x + now.rng.standard_normal((n, 4)) @ np.linalg.cholesky(P + 1e-12 * np.eye(4)).T
        if rotation is not None:
            rotation = rotation.with_compass(frame.compass)
            angle_rad = rotation.samples(now.rng, n)
            from_centre_m = particles[:, :2] - rotation.track_centre_m
            particles[:, :2] = rotated_vectors(from_centre_m, angle_rad) + rotation.world_centre_m
            particles[:, :2] += math.sqrt(rotation.centre_var_m2) * now.rng.standard_normal((n, 2))
            particles[:, OFFSET] += angle_rad
            particles[:, TURN] = angle_rad
        state = _with_particles(state, particles, now.pedestrian)
        return state if now.ground is None else _on_ground(state, now.ground, -now.ground.heights(particles[:, :2]))

    def _from_start(self, state: ParticleState, start: Start, now: _Context) -> ParticleState:
        """Return the state with particles drawn at the start position or in the start area.

        The rotation of the track is uniform over all angles, or follows the heading fixes and the compass received so
        far.
        """
        frame, rng, n = now.pedestrian.frame, now.rng, self.n_most
        x, P = now.pedestrian.estimates.combined
        particles = np.zeros((n, N_COLUMNS))
        particles[:, :2] = start.draw(rng, n)
        turn_rad = rng.uniform(-math.pi, math.pi, n)
        if frame.north is not None:
            turn_rad = math.sqrt(frame.north.angle_var_rad2) * rng.standard_normal(n)
        particles[:, TURN] = turn_rad
        particles[:, OFFSET] = x[HEADING_OFFSET] + turn_rad
        particles[:, OFFSET] += math.sqrt(P[HEADING_OFFSET, HEADING_OFFSET]) * rng.standard_normal(n)
        particles[:, SCALE] = math.hypot(now.scale_std, now.model.noise.log_scale_std) * rng.standard_normal(n)
        state = _with_particles(state, particles, now.pedestrian)
        ground = self.ground(start.floor)
        if len(start.cells):
            state = replace(state, lost_log_odds=_LOST_IN_AREA_LOG_ODDS)
        elif ground is not None:
            # a person may start in a room without a door, but not in a wall
            is_closed = ground.is_closed(particles[:, :2])
            state = _on_ground(state, ground, np.where(is_closed, -ground.heights(particles[:, :2]), 0.0))
        if frame.north is None and frame.compass is not None:
            state, log_weight = _with_compass(replace(state, compass=None), now.pedestrian)
            state, _ = _reweighted(state, log_weight)
        return state

    def _drawn_again(self, state: ParticleState, now: _Context) -> ParticleState:
        """Return the state with particles drawn again, after no particle fitted the steps.

        The particles come from the tracker if its track is placed on the plan, otherwise from all walkable cells of the
        storey.
        """
        events = (*state.events, PlanEvent(now.time_s, "lost", ""))[-_MAX_EVENTS:]
        state, frame = replace(state, events=events, n_lost=state.n_lost + 1), now.pedestrian.frame
        if frame.is_joined or frame.rotation is not None or now.ground is None:
            return self._from_tracker(state, now)
        return self._from_start(state, anywhere_on(now.ground.storey), now)

    def _resampled(self, state: ParticleState, now: _Context, must_count: bool = False) -> ParticleState:
        """Return the state resampled to the number of particles needed, or unchanged if resampling is not necessary.

        If no particle fits the steps, all are drawn again. Resampling takes place if the effective sample size is too
        small, or if less than half of the particles are needed. It is systematic (low variance): a single random number
        draws all particles, and a particle of weight w is copied w n times, rounded up or down. `must_count` checks the
        number needed even if the effective sample size is sufficient.
        """
        if state.lost_log_odds > _MOST_LOST_LOG_ODDS or _n_effective(state) < _LEAST_EFFECTIVE:
            return self._drawn_again(state, now)
        n = len(state.weight)
        too_few = _n_effective(state) < _RESAMPLE_SHARE * n
        if not (too_few or must_count):
            return state
        alive = state.weight > 0.01 / n
        cell = np.floor(state.particles[:, [EAST, NORTH, OFFSET]][alive] / [_COUNT_M, _COUNT_M, _COUNT_RAD])
        needed = n_needed(cell.astype(np.int64), self.n_least, self.n_most)
        if not (too_few or needed < 0.5 * n):
            return state
        total = np.cumsum(state.weight)
        chosen = np.searchsorted(total, total[-1] * (np.arange(needed) + now.rng.random()) / needed)
        particles = state.particles[np.minimum(chosen, n - 1)]
        particles[:, SCALE] += _SCALE_JITTER * now.rng.standard_normal(needed)
        parent = state.parent[chosen] if len(state.parent) else state.parent
        return replace(state, particles=particles, weight=np.full(needed, 1.0 / needed), parent=parent)

    def _with_contradiction(self, state: ParticleState, time_s: float, ground: Ground) -> ParticleState:
        """Return the state with a new `PlanEvent` if most of the weight has recently crossed a wall, room or outline.

        The recent crossing costs of all particles then start from zero. Otherwise the state is unchanged.
        """
        t = self.terrain
        if float(state.weight @ state.particles[:, CROSSED]) < 0.5 * min(t.wall, t.room, t.outside):
            return state
        what, name = ground.storey.crossed_feature(state.weight @ state.particles[:, :2])
        particles = state.particles.copy()
        particles[:, CROSSED] = 0.0
        events = (*state.events, PlanEvent(time_s, what, name))[-_MAX_EVENTS:]
        return replace(state, particles=particles, events=events)


def _with_particles(state: ParticleState, particles: FloatArray, pedestrian: PedestrianState) -> ParticleState:
    """Return the state with new particles of equal weight."""
    n = len(particles)
    return replace(
        state,
        particles=particles,
        weight=np.full(n, 1.0 / n),
        parent=np.empty(0, dtype=np.int64),
        turned_rad=_turned_rad(pedestrian),
        compass=pedestrian.frame.compass,
        lost_log_odds=_LEAST_LOST_LOG_ODDS,
        uses_plan=True,
    )


def _on_ground(state: ParticleState, ground: Ground, log_weight: FloatArray) -> ParticleState:
    """Return the state of new particles with log weights (N,). The plan is used if most of their weight is inside."""
    state, _ = _reweighted(state, log_weight)
    return replace(state, uses_plan=not ground.is_off_plan(state.particles[:, :2], state.weight))


def _turned_rad(pedestrian: PedestrianState) -> float:
    """Return the total angle in rad by which heading fixes and position fixes have rotated the tracker's frame."""
    frame = pedestrian.frame
    return sum(a.angle_rad for a in (frame.north, frame.alignment, *frame.relocations) if a is not None)


def _in_turned_frame(state: ParticleState, pedestrian: PedestrianState) -> ParticleState:
    """Return the state with the rotations of its particles relative to the tracker's present frame."""
    by_rad = _turned_rad(pedestrian) - state.turned_rad
    if by_rad == 0.0:
        return state
    particles = state.particles.copy()
    particles[:, TURN] -= by_rad
    return replace(state, particles=particles, turned_rad=state.turned_rad + by_rad)


def _with_compass(state: ParticleState, pedestrian: PedestrianState) -> tuple[ParticleState, FloatArray]:
    """Return the state updated by magnetic north, and the change of the log weights, shape (N,) for N particles.

    The change is zero without a new density of the compass, and once fixes determine the rotation of the track.
    """
    new, old = pedestrian.frame.compass, state.compass
    if pedestrian.frame.is_joined or new is None or new is old or pedestrian.frame.rotation is not None:
        return state, np.zeros(len(state.weight))
    turn_rad = state.particles[:, TURN]
    log_weight = np.log(new.density(turn_rad)) - (0.0 if old is None else np.log(old.density(turn_rad)))
    return replace(state, compass=new), log_weight


def _reweighted(state: ParticleState, log_weight: FloatArray) -> tuple[ParticleState, float]:
    """Return the state with log weights (N,) added, and the log of the mean factor that this applied to the weights."""
    with np.errstate(divide="ignore"):
        total = np.log(state.weight) + log_weight
    return replace(state, weight=softmax(total)), log_sum(total)


def _log_density(fix: Measurement, position_m: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Return the log density (N,) of a measurement at positions (N, 2) and walking headings (N,).

    An outlier lowers the density by at most `_OUTLIER_LOG_ODDS` relative to the best particle. The density of a range
    is a mixture of direct and reflected paths.
    """
    if isinstance(fix, RangeFix):
        residual, _ = range_residuals(position_m, fix.anchor_m[:2], fix.up_m, fix.range_m)
        density = np.logaddexp(*range_log_densities(residual, np.array(fix.std_m**2), np.array(fix.std_m)))
    else:
        each = [
            measurement_of(fix, place, heading) for place, heading in zip(position_m, heading_rad.tolist(), strict=True)
        ]
        nis = np.array([float(r @ np.linalg.solve(cov, r)) for r, _, cov in each])
        density = -0.5 * (nis + np.array([np.linalg.slogdet(cov)[1] for _, _, cov in each]))
    return np.maximum(density, density.max() - _OUTLIER_LOG_ODDS)


def off_plan_notes(n_steps: int, first_s: float, last_s: float) -> list[Note]:
    """Return a note about the number of steps off the plan, and the times of the first and the last of them."""
    if n_steps == 0:
        return []
    words = (
        f"{how_many(n_steps, 'step')} between {first_s:.0f} and {last_s:.0f} s placed {_OFF_PLAN}: the start or the "
        "fixes do not fit the plan, or the plan is incomplete; correct them"
    )
    return [Note("plan", words)]


def _n_effective(state: ParticleState) -> float:
    """Return the effective sample size, 1 / sum of the squared weights."""
    return 1.0 / float((state.weight**2).sum())
