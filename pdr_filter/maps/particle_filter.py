"""A particle filter behind the tracker: many pedestrians who make the same steps, of whom the plan keeps those who can.

A particle is a place on the plan, a heading offset and a log scale, as the states of the tracker's modes, the turn from
the frame of the start to the plan, and what it went through of late. A step leads it on as `filter.imm.motion_model`
says, in a mode drawn from the tracker's probabilities; the direction that strides show is used in closed form, given
the particle (a Kalman update of its offset, as in a Rao-Blackwellised filter). What the plan makes of the step weighs
it (`Terrain`), and so do fixes that the tracker used. A step along a corridor weighs more than one in a hall: people
choose where to go among the ways that are free, and whom few are free to is found on one of them by chance less often.
Without it noise, which leads into walls, would draw the particles out of the corridors.

The tracker stays what it is without a plan. From it the particles come: at a start that is given, at each fix while
fixes leave the turn of the track open, and again where nothing on the plan fits the steps any more. So the plan cannot
lead the track away for good. From an unknown start particles can lose the walk, few as they are for so many places:
those that are left then pay more for the plan than somebody would who walks at random. That is counted as doubt.

M. S. Arulampalam et al., "A tutorial on particle filters for online nonlinear/non-Gaussian Bayesian tracking", IEEE
Trans. Signal Processing 50, 2002. The doubt is akin to the augmented localisation of S. Thrun, W. Burgard and D. Fox,
"Probabilistic Robotics", 2005, section 8.3.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator, Philox

from pdr_filter.filter.fixes.frame_rotation import Compass
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, MAX_HEADING_VARIANCE
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.maps.crossing_costs import Ground, Terrain
from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.maps.particle_clusters import n_needed, on_plan
from pdr_filter.maps.particle_motion import (
    EAST,
    N_COLUMNS,
    NORTH,
    OFFSET,
    SCALE,
    THROUGH,
    TURN,
    backwards,
    led_on,
    rotated,
    turned,
)
from pdr_filter.maps.start_area import ANYWHERE, Start, start_of
from pdr_filter.values import (
    Fix,
    FixOutcome,
    FloatArray,
    FloorPassage,
    GridFix,
    HeadingFix,
    IntArray,
    Measurement,
    Note,
    OnPlan,
    Plan,
    PositionFix,
    RangeFix,
    SpeedFix,
    Standstill,
    check_numbers,
    interpolated,
    measured,
    range_log_densities,
    range_residuals,
    repetition,
    wrap_angle,
)
from pdr_filter.values.mixtures import log_sum, softmax

# Side of the cells in which particles are counted for their number: metres, and a twelfth of a circle.
_COUNT_M, _COUNT_RAD = 1.0, math.pi / 6
# Particles are counted every so many steps, and whenever they are drawn again.
_COUNT_STEPS = 8
# After drawing again from some of them, their scales differ by so much: the steps' own noise moves all else.
_SCALE_JITTER = 0.005
# Half of the particles without weight: they are drawn again.
_RESAMPLE_SHARE = 0.5
# Fewer than this many have all the weight: the set is degenerate.
_LEAST_EFFECTIVE = 5.0
# One measurement in a thousand is an outlier that nothing explains.
_OUTLIER_LOG_ODDS = math.log(1000.0)
# A fix that turns the track says more than particles that were drawn before can show, if it takes more than a tenth of
# them: they are drawn from the tracker, which knows the turn in closed form.
_SHOWN_SHARE = 0.9
# Log odds that the walk is where no particle is. Even, where particles were drawn from a whole area: they are too few
# to hold every heading and scale at every place. One to a hundred where they were placed, and never less: plans are
# wrong. At a hundred to one nothing on the plan fits; limits of 2.3 to 9.2 gave the same medians on storey F1 of the
# mall within 0.1 m.
_DOUBT_OF_AREA, _LEAST_DOUBT, _MOST_DOUBT = 0.0, -4.6, 4.6
# What a particle went through is forgotten with this factor a step: those who went through a wall are few at first, and
# it takes some steps until all others are gone.
_THROUGH_MEMORY = 0.95
_MAX_EVENTS = 16
# What the lengths of steps are off besides, each for itself: people stop, turn and walk around others. Without it the
# scale has to explain that. The legs of the storeys F1 and B1 of ms_indoor, about 8 m and 11 steps long, are off by
# 0.9 m whatever their length, of which two taps of 0.5 m on a plan make 0.7. Of 0, 0.1, 0.15 and 0.2 m the last had the
# smallest errors there, and regions of 95 % that held 96 and 97 % (94 and 95 without).
_UNEVEN_VAR_M2 = 0.2**2


@dataclass(frozen=True, slots=True)
class PlanEvent:
    """Where the plan and the steps contradict each other."""

    time_s: float
    what: str  # "wall", "room" or "outline" that the walk goes through, or "lost": nothing on the plan fits
    name: str  # of the room


@dataclass(frozen=True, slots=True, eq=False)
class ParticleState:
    """All that changes."""

    particles: FloatArray = field(default_factory=lambda: np.empty((0, N_COLUMNS)))  # (N, 6)
    weight: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) sums to one
    parent: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))  # (N,) of before; none: newly drawn
    # (R, 4) time, east, north and device heading after the last steps, each as long as the modes say and in the
    # direction of the device
    way: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    heading_rad: float = 0.0  # of the device at the last step
    turned_rad: float = 0.0  # see `_turned_rad`
    compass: Compass | None = None  # as it was used
    last_fix_s: float = -math.inf  # of a position
    last_grid_s: float = -math.inf
    doubt: float = 0.0  # log odds that no particle is where the walk is
    n_draws: int = 0  # of random numbers: the next ones follow from seed and number alone
    events: tuple[PlanEvent, ...] = ()  # the last ones
    n_lost: int = 0  # how often nothing on the plan fitted

    @property
    def elsewhere(self) -> float:
        """Probability that no particle is where the walk is."""
        return 1.0 / (1.0 + math.exp(-self.doubt))


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """Where the steps of a tracker lead on a floor plan; each state follows from the one before and an event alone.

    The number of particles follows what they are spread over, from `n_least` to `n_most`.
    """

    plan: FloorPlan
    start: Start | None = None  # None: where the tracker is
    terrain: Terrain = field(default_factory=Terrain)
    n_least: int = 1000
    n_most: int = 50_000
    seed: int = 0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("seed",))
        if self.n_least > self.n_most:
            raise ValueError(f"n_least must not be above n_most, got {self.n_least} and {self.n_most}")

    @classmethod
    def of(cls, plan: Plan, start: PositionFix | str | None = None, seed: int = 0) -> ParticleFilter:
        """The filter on a plan from a start: a place, the name of an area, or "anywhere"."""
        if not isinstance(plan, FloorPlan):
            raise ValueError(
                f"plan must be a FloorPlan, got {plan!r}: pdr_filter.FloorPlan.read(path) makes one of a file"
            )
        return cls(plan, None if start is None else start_of(plan, start), seed=seed)

    @cached_property
    def _grounds(self) -> dict[int, Ground]:
        return {storey.floor: Ground(storey, self.terrain) for storey in self.plan.storeys}

    def ground(self, floor: int) -> Ground | None:
        """The storey that somebody is on: of a plan with one storey that one, whatever its number."""
        if len(self._grounds) == 1:
            return next(iter(self._grounds.values()))
        return self._grounds.get(floor)

    def init(self) -> ParticleState:
        """No particles: they are drawn at the first step, or fix, that places the track."""
        return ParticleState()

    # --- events -------------------------------------------------------------------------------------------------------

    def on_step(
        self,
        state: ParticleState,
        update: StepUpdate,
        pedestrian: PedestrianState,
        model: PedestrianModel,
    ) -> ParticleState:
        """State after a step, and what the tracker knows then."""
        step = update.step
        rng, state = self._random(state)
        ground = self.ground(update.floor)
        length_m, _, own_var_m2, parameter_std_m = model.lengths(step)
        mean_m = float(update.mode_prob @ length_m)
        # the parameters of the lengths are off once for a person, as the scale is
        scale_std = float(update.mode_prob @ parameter_std_m) / mean_m if mean_m > 0 else 0.0
        is_first = len(state.way) == 0 or update.gap_before_s > 0
        since_s = step.duration_s if is_first else step.time_s - state.way[-1, 0]
        state = _in_turned_frame(state, pedestrian)
        is_placed = pedestrian.frame.is_joined or pedestrian.frame.turn is not None
        state = replace(state, way=led_on(state.way, step, mean_m), heading_rad=step.device_heading_rad)
        if len(state.weight) == 0:
            if self.start is not None:
                return self._from_start(state, self.start, pedestrian, model, rng, scale_std)
            return self._from_tracker(state, pedestrian, ground, rng, scale_std) if is_placed else state
        n = len(state.weight)
        x, from_m = state.particles.copy(), state.particles[:, :2]
        z, prob = rng.standard_normal((4, n)), np.cumsum(update.mode_prob)[:-1]
        mode = np.searchsorted(prob, rng.random(n), side="right")
        log_weight = turned(x, step, pedestrian, model, since_s, mode, z[0])
        own_std_m = np.sqrt(own_var_m2 + _UNEVEN_VAR_M2)
        scaled_m = np.exp(x[:, SCALE]) * (length_m[mode] + own_std_m[mode] * z[1])
        own = model.directions
        psi = step.device_heading_rad + x[:, OFFSET]
        psi += own.heading_offset_rad[mode] + np.sqrt(own.step_var_rad2(step.turned_rad))[mode] * z[2]
        x[:, EAST] += scaled_m * np.sin(psi)
        x[:, NORTH] += scaled_m * np.cos(psi)
        if own.extra_var_m2.any():
            x[:, :2] += np.sqrt(own.extra_var_m2)[mode, None] * rng.standard_normal((n, 2))
        noise = model.noise
        x[:, SCALE] = noise.log_scale_memory * x[:, SCALE] + math.sqrt(noise.log_scale_drift_var) * z[3]
        state, log_compass = _with_compass(state, pedestrian)
        state, _ = _weighed(replace(state, particles=x, parent=np.arange(n)), log_weight + log_compass)
        if ground is not None:
            up, down = model.on_stairs
            cost, through = ground.costs(from_m, x[:, :2], (up + down)[mode] > 0)
            x[:, THROUGH] = _THROUGH_MEMORY * x[:, THROUGH] + through
            # whoever pays more for the plan than somebody who knows nothing of it, is not where he is thought to be
            log_share = math.log(float(state.weight @ np.exp(-cost)))
            doubt = max(state.doubt - log_share - mean_m * ground.of_storey, _LEAST_DOUBT)
            state, _ = _weighed(state, ground.of_anybody(from_m, mean_m) - cost)
            state = self._noted(replace(state, doubt=doubt), step.time_s, ground)
        if state.doubt > _MOST_DOUBT or _n_effective(state) < _LEAST_EFFECTIVE:
            return self._again(state, pedestrian, model, ground, rng, scale_std, step.time_s)
        return self._resampled(state, rng, must_count=update.index % _COUNT_STEPS == 0)

    def on_gap(self, state: ParticleState, gap_s: float, model: PedestrianModel) -> ParticleState:
        """State after a time without samples, in which anybody may have gone anywhere at a walk."""
        if len(state.weight) == 0:
            return state
        rng, state = self._random(state)
        z, x = rng.standard_normal((3, len(state.weight))), state.particles.copy()
        x[:, [EAST, NORTH]] += np.sqrt(model.noise.gap_var_m2(gap_s)) * z[:2].T
        turned_var = np.minimum(model.noise.heading_drift.unmeasured_rad2(gap_s), MAX_HEADING_VARIANCE)
        x[:, OFFSET] += np.sqrt(turned_var) * z[2]
        return replace(state, particles=x, parent=np.arange(len(x)))

    def on_fix(
        self,
        state: ParticleState,
        fix: Fix,
        outcome: FixOutcome,
        pedestrian: PedestrianState,
        model: PedestrianModel,
        floor: int,
    ) -> ParticleState:
        """State after a fix of position or heading that the tracker used, or of a grid; and what it knows then.

        Any other measurement weighs the particles whether the tracker used it or not: they need no linear update.
        """
        if len(state.way) == 0 or isinstance(fix, SpeedFix | Standstill):
            return state
        is_own = isinstance(fix, PositionFix | HeadingFix)
        if not is_own and outcome not in ("placed", "moved"):
            if len(state.weight) == 0 or fix.time_s < state.way[0, 0]:
                return state
        elif outcome not in ("used", "placed", "turned", "moved"):
            return state
        rng, state = self._random(state)
        ground = self.ground(floor)
        state, is_moved = _in_turned_frame(state, pedestrian), outcome == "moved"
        if self.start is None and (len(state.weight) == 0 or is_moved):
            return self._from_tracker(state, pedestrian, ground, rng, 0.0)
        if len(state.weight) == 0:
            return state
        x, then = state.particles, interpolated(fix.time_s, state.way[:, 0], state.way[:, 1:4])
        if isinstance(fix, HeadingFix):
            error = wrap_angle(fix.walking_heading_rad - then[2] - x[:, OFFSET])
            state, _ = _weighed(state, -0.5 * (error / fix.std_rad) ** 2)
        elif isinstance(fix, GridFix):
            there = fix.log_likelihood_at(backwards(x, state.way[-1, 1:3] - then[:2]))
            state, _ = _weighed(state, there / repetition(fix, state.last_grid_s))
            state = replace(state, last_grid_s=fix.time_s)
        elif not isinstance(fix, PositionFix):
            there = backwards(x, state.way[-1, 1:3] - then[:2])
            state, _ = _weighed(state, _log_density(fix, there, then[2] + x[:, OFFSET]))
        else:
            error = backwards(x, state.way[-1, 1:3] - then[:2]) - fix.position_m
            cov = repetition(fix, state.last_fix_s) * fix.cov_m2
            state, _ = _weighed(state, -0.5 * ((error @ np.linalg.inv(cov)) * error).sum(axis=1))
            state = replace(state, last_fix_s=fix.time_s)
        state = replace(state, parent=np.arange(len(state.weight)))
        n_effective = _n_effective(state)
        if outcome == "turned" and self.start is None and n_effective < _SHOWN_SHARE * len(state.weight):
            return self._from_tracker(state, pedestrian, ground, rng, 0.0)
        if n_effective < _LEAST_EFFECTIVE:
            return self._again(state, pedestrian, model, ground, rng, 0.0, fix.time_s)
        return self._resampled(state, rng, must_count=False)

    def on_passage(
        self, state: ParticleState, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel
    ) -> ParticleState:
        """State after somebody has come to another storey: who took a lift was in one."""
        ground = self.ground(passage.to_floor)
        if passage.how != "lift" or ground is None or len(state.weight) == 0 or len(state.way) == 0:
            return state
        rng, state = self._random(state)
        then_m = interpolated(passage.end_s, state.way[:, 0], state.way[:, 1:3])
        out_m = backwards(state.particles, state.way[-1, 1:3] - then_m)
        state, _ = _weighed(state, -ground.lift_costs(out_m))
        state = replace(state, parent=np.arange(len(state.weight)))
        if _n_effective(state) < _LEAST_EFFECTIVE:
            return self._again(state, pedestrian, model, ground, rng, 0.0, passage.end_s)
        return self._resampled(state, rng, must_count=False)

    # --- what is known ------------------------------------------------------------------------------------------------

    def place(self, state: ParticleState, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
        """Where the particles are; None before there are some.

        As far as the walk may be where none of them is, it is where dead reckoning says, if that begins on the plan:
        the covariance reaches there.
        """
        if len(state.weight) == 0:
            return None
        heading_rad = state.heading_rad + state.particles[:, OFFSET]
        there = reckoned if self.start is None else None
        return on_plan(state.particles[:, :2], state.weight, heading_rad, state.elsewhere, there)

    def notes(self, state: ParticleState) -> list[Note]:
        """Where the plan and the steps contradict each other, in words."""
        notes: list[Note] = []
        for event in state.events:
            words = {
                "wall": "the walk goes through a wall: a door that the plan lacks?",
                "room": f"the walk enters {event.name or 'a room'}, to which the plan has no door",
                "outline": "the walk leaves the outline of the floor: is the plan complete?",
                "lost": "nothing on the plan fits the steps: the track begins again from dead reckoning",
            }[event.what]
            notes.append(Note("plan", f"about {event.time_s:.0f} s {words}"))
        return notes

    # --- parts --------------------------------------------------------------------------------------------------------

    def _random(self, state: ParticleState) -> tuple[Generator, ParticleState]:
        """The random numbers of the next event: they follow from the seed and its number, whatever came before."""
        numbers = Generator(Philox(key=self.seed, counter=[0, 0, 0, state.n_draws]))
        return numbers, replace(state, n_draws=state.n_draws + 1)

    def _from_tracker(
        self, state: ParticleState, pedestrian: PedestrianState, ground: Ground | None, rng: Generator, scale_std: float
    ) -> ParticleState:
        """Particles of the tracker's normal distribution, or of its density over all turns while it is open."""
        x, combined = pedestrian.estimates.combined
        P = combined.copy()
        P[:2, :2] += pedestrian.estimates.consider_cov_m2
        P[LOG_SCALE, LOG_SCALE] += scale_std**2
        open_turn = None if pedestrian.frame.is_joined else pedestrian.frame.turn
        n = min((2 if open_turn is None else 5) * self.n_least, self.n_most)
        particles = np.zeros((n, N_COLUMNS))
        # a variance that is zero has no factor
        particles[:, :4] = x + rng.standard_normal((n, 4)) @ np.linalg.cholesky(P + 1e-12 * np.eye(4)).T
        if open_turn is not None:
            open_turn = open_turn.with_compass(pedestrian.frame.compass)
            angle_rad = open_turn.samples(rng, n)
            from_centre_m = particles[:, :2] - open_turn.track_centre_m
            particles[:, :2] = rotated(from_centre_m, angle_rad) + open_turn.world_centre_m
            particles[:, :2] += math.sqrt(open_turn.centre_var_m2) * rng.standard_normal((n, 2))
            particles[:, OFFSET] += angle_rad
            particles[:, TURN] = angle_rad
        return self._begun(state, particles, pedestrian, ground)

    def _from_start(
        self,
        state: ParticleState,
        start: Start,
        pedestrian: PedestrianState,
        model: PedestrianModel,
        rng: Generator,
        scale_std: float,
    ) -> ParticleState:
        """Particles at the start, turned any way that the heading fixes and the compass so far allow."""
        n = self.n_most
        x, P = pedestrian.estimates.combined
        particles = np.zeros((n, N_COLUMNS))
        particles[:, :2] = start.draw(rng, n)
        frame, turn_rad = pedestrian.frame, rng.uniform(-math.pi, math.pi, n)
        if frame.north is not None:
            turn_rad = math.sqrt(frame.north.angle_var_rad2) * rng.standard_normal(n)
        particles[:, TURN] = turn_rad
        particles[:, OFFSET] = x[HEADING_OFFSET] + turn_rad
        particles[:, OFFSET] += math.sqrt(P[HEADING_OFFSET, HEADING_OFFSET]) * rng.standard_normal(n)
        scale_std = math.hypot(scale_std, model.noise.log_scale_std)
        particles[:, SCALE] = scale_std * rng.standard_normal(n)
        state = self._begun(state, particles, pedestrian, None, _DOUBT_OF_AREA if len(start.cells) else _LEAST_DOUBT)
        if pedestrian.frame.north is None and pedestrian.frame.compass is not None:
            state, log_weight = _with_compass(replace(state, compass=None), pedestrian)
            state, _ = _weighed(state, log_weight)
        return state

    def _begun(
        self,
        state: ParticleState,
        particles: FloatArray,
        pedestrian: PedestrianState,
        ground: Ground | None,
        doubt: float = _LEAST_DOUBT,
    ) -> ParticleState:
        """State with new particles, where somebody can be."""
        n = len(particles)
        state = replace(
            state,
            particles=particles,
            weight=np.full(n, 1.0 / n),
            parent=np.empty(0, dtype=np.int64),
            turned_rad=_turned_rad(pedestrian),
            compass=pedestrian.frame.compass,
            doubt=doubt,
        )
        return state if ground is None else _weighed(state, -ground.heights(particles[:, :2]))[0]

    def _again(
        self,
        state: ParticleState,
        pedestrian: PedestrianState,
        model: PedestrianModel,
        ground: Ground | None,
        rng: Generator,
        scale_std: float,
        time_s: float,
    ) -> ParticleState:
        """State whose particles are drawn again, because what they say cannot be: from the tracker, or anywhere."""
        events = (*state.events, PlanEvent(time_s, "lost", ""))[-_MAX_EVENTS:]
        state = replace(state, events=events, n_lost=state.n_lost + 1)
        if pedestrian.frame.is_joined or pedestrian.frame.turn is not None or ground is None:
            return self._from_tracker(state, pedestrian, ground, rng, scale_std)
        anywhere = start_of(FloorPlan("", (ground.storey,)), ANYWHERE)
        return self._from_start(state, anywhere, pedestrian, model, rng, scale_std)

    def _resampled(self, state: ParticleState, rng: Generator, must_count: bool) -> ParticleState:
        """State with as many particles as are needed, of one weight, if too few of them have weight or too many are.

        One random number draws all (low variance): a particle of weight w comes w n times, rounded up or down.
        """
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
        chosen = np.searchsorted(total, total[-1] * (np.arange(needed) + rng.random()) / needed)
        particles = state.particles[np.minimum(chosen, n - 1)]
        particles[:, SCALE] += _SCALE_JITTER * rng.standard_normal(needed)
        parent = state.parent[chosen] if len(state.parent) else state.parent
        return replace(state, particles=particles, weight=np.full(needed, 1.0 / needed), parent=parent)

    def _noted(self, state: ParticleState, time_s: float, ground: Ground) -> ParticleState:
        """State with an event, if most of the weight has gone through what the plan draws."""
        t = self.terrain
        if float(state.weight @ state.particles[:, THROUGH]) < 0.5 * min(t.wall, t.room, t.outside):
            return state
        what, name = ground.storey.what_is_near(state.weight @ state.particles[:, :2])
        particles = state.particles.copy()
        particles[:, THROUGH] = 0.0
        events = (*state.events, PlanEvent(time_s, what, name))[-_MAX_EVENTS:]
        return replace(state, particles=particles, events=events)


def _turned_rad(pedestrian: PedestrianState) -> float:
    """By how much heading fixes and position fixes have turned the frame of the tracker's states so far."""
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
    """Return the state updated by magnetic north, and the change of the log weights, shape (N,) for N particles."""
    new, old = pedestrian.frame.compass, state.compass
    if pedestrian.frame.is_joined or new is None or new is old or pedestrian.frame.turn is not None:
        return state, np.zeros(len(state.weight))
    turn_rad = state.particles[:, TURN]
    log_weight = np.log(new.density(turn_rad)) - (0.0 if old is None else np.log(old.density(turn_rad)))
    return replace(state, compass=new), log_weight


def _weighed(state: ParticleState, log_weight: FloatArray) -> tuple[ParticleState, float]:
    """State with log weights (N,) on top, and the logarithm of the mean weight that these were."""
    with np.errstate(divide="ignore"):
        total = np.log(state.weight) + log_weight
    return replace(state, weight=softmax(total)), log_sum(total)


def _log_density(fix: Measurement, position_m: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Log density (N,) of a measurement at positions (N, 2) and walking headings (N,); an outlier costs a limited odds.

    Of a range that of direct and reflected paths together.
    """
    if isinstance(fix, RangeFix):
        residual, _ = range_residuals(position_m, fix.anchor_m[:2], fix.up_m, fix.range_m)
        density = np.logaddexp(*range_log_densities(residual, np.array(fix.std_m**2), np.array(fix.std_m)))
    else:
        each = [measured(fix, place, heading) for place, heading in zip(position_m, heading_rad.tolist(), strict=True)]
        nis = np.array([float(r @ np.linalg.solve(cov, r)) for r, _, cov in each])
        density = -0.5 * (nis + np.array([np.linalg.slogdet(cov)[1] for _, _, cov in each]))
    return np.maximum(density, density.max() - _OUTLIER_LOG_ODDS)


def _n_effective(state: ParticleState) -> float:
    return 1.0 / float((state.weight**2).sum())
