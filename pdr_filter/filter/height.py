"""Height beside the track: what barometer, steps and contexts say of it.

The state of each mode is [climbed, its rate, sloped, air]: metres climbed on stairs, lifts and escalators, how fast,
metres that level ground and slopes led up, and what the air added to the height that the pressure shows, weather and
draughts. The barometer measures climbed + sloped + air. Height is climbed + sloped; storeys are of climbed alone
(`floors`), so that neither a hill nor the weather of a day leads to another one.

Seven modes explain a second: level ground, where nothing moves but the air; a slope, on which steps lead up or down
little by little; stairs up and down, a riser a step; a lift, or an escalator, that moves somebody who makes no steps,
at a rate that lasts; a jump of the air, a door or a fan, all at once; and a drift of the air about somebody who sits,
as in the cabin of an aeroplane. They are mixed as those of the track are (`imm`), once for each second of the
barometer. Without a barometer a step climbs a riser as probably as the track's own modes say that it was made on
stairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.classifiers.model import to_be_told_apart
from pdr_filter.filter import imm
from pdr_filter.filter.floors import (
    LEVEL_STD_M,
    Climbing,
    FloorState,
    Level,
    finished,
    fixed,
    followed,
    known_level,
    learnt,
    with_level,
)
from pdr_filter.filter.model import PedestrianModel
from pdr_filter.filter.weighting import context_log_evidence
from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.sensing.features.barometric import RISER_M, Climb
from pdr_filter.values import CONTEXTS, FloatArray, FloorPassage, Note, read_only, replace

CLIMBED, RATE, SLOPED, AIR = range(4)
LEVEL, SLOPE, UP, DOWN, LIFT, JUMP, DRIFT = range(7)
N_MODES, N_STATES = 7, 4

# The mean pressure of a second differs from that of the seconds around it by 0.12 m, and by 0.025 m a root second more
# the further they are (ipin21, one storey in two minutes).
DRAUGHT_STD_M, AIR_WALK_M = 0.12, 0.025
# A door, a fan: 5 to 50 Pa.
JUMP_STD_M = 1.5
# The cabin of an aeroplane on its way changes by a hPa a minute, 0.14 m/s: half of what an escalator climbs.
DRIFT_M = 0.12
# Ramps of 6 % are the steepest for wheels (DIN 18040), 0.08 m/s at 1.3 m/s.
SLOPE_MPS = 0.08
# Risers of one staircase are alike, and mostly within a centimetre of 0.17 m (`barometric`); a step is known a second
# after its contact, so that the steps of a second are wrong by one.
STAIRS_STD_M = 0.12
# Lifts start and stop with 0.5 to 1 m/s2 (ISO 8100-34 calls more uncomfortable).
LIFT_ACCELERATION_MPS2 = 0.7
# Escalators climb with 0.25 to 0.4 m/s, lifts faster: what moves more slowly than this is air.
LEAST_RIDE_MPS = 0.2
# No lift and hardly an escalator takes longer; a cabin, a train and a cable car do.
LONGEST_RIDE_S = 120.0
# The air of a vehicle is calm again when the barometer has been below this rate, a half of a ride's, for some time.
CALM_MPS, CALM_S = 0.1, 10.0

# Mean stays in seconds: flights and level stretches of the terrain labels (`modes`), rides and slopes by judgement.
_STAYS_S = {LEVEL: 15.0, SLOPE: 20.0, UP: 6.6, DOWN: 5.8, LIFT: 15.0, JUMP: 1.1, DRIFT: 60.0}
# Where they lead to.
_NEXT = {
    LEVEL: {SLOPE: 0.35, UP: 0.25, DOWN: 0.25, LIFT: 0.09, JUMP: 0.05, DRIFT: 0.01},
    SLOPE: {LEVEL: 0.7, UP: 0.1, DOWN: 0.1, LIFT: 0.05, JUMP: 0.05},
    UP: {LEVEL: 0.9, SLOPE: 0.05, DOWN: 0.02, JUMP: 0.03},
    DOWN: {LEVEL: 0.9, SLOPE: 0.05, UP: 0.02, JUMP: 0.03},
    LIFT: {LEVEL: 0.95, JUMP: 0.05},
    JUMP: {LEVEL: 0.8, SLOPE: 0.1, UP: 0.03, DOWN: 0.03, LIFT: 0.03, DRIFT: 0.01},
    DRIFT: {LEVEL: 0.9, LIFT: 0.05, JUMP: 0.05},
}
# A step every 0.55 s on stairs: seldom none in a second, but steps after a pause are known late.
_NO_STEP_ON_STAIRS = math.log(0.2)
# A stay that does not fit its level is on another one: 99 % of those that do, chi-square of one.
_LEVEL_GATE = 6.6
LONGEST_STEP_S = 10.0
# What is climbed without a barometer is wrong for a flight as a whole: a dozen steps.
_FLIGHT_STEPS = 12
_RISER_STD_M = 0.01
# Where slopes are not measured, what a minute of walking leads up or down: 0.4 m.
_UNSEEN_SLOPE_M = 0.05
# Where stairs are not seen either (a phone in the hand), a storey in ten minutes may have been climbed.
_UNSEEN_STAIRS_M = 0.14
# Without pressure for so long a step counts by itself.
PRESSURE_AGE_S = 4.0
# The first steps of a bout wait for the gate for so long: until then a second of the barometer may get more of them.
LATE_S = 6.0
_UNKNOWN_M2 = 1e8
# From which on it is worth saying that the air changed: 5 hPa, more than the weather of some hours.
_NOTABLE_AIR_M = 40.0
_M_PER_HPA = 8.3


def _transitions() -> FloatArray:
    rows = np.zeros((N_MODES, N_MODES))
    for mode, stay_s in _STAYS_S.items():
        rows[mode, mode] = 1.0 - 1.0 / stay_s
        for after, share in _NEXT[mode].items():
            rows[mode, after] = share / stay_s
    return read_only(rows)


_TRANSITIONS = _transitions()
_PRESSURE = read_only(np.array([1.0, 0.0, 1.0, 1.0]))  # what the states add up to
_CLIMBED = read_only(np.eye(N_STATES)[CLIMBED])


def _entries(at: dict[tuple[int, ...], float], shape: tuple[int, ...]) -> FloatArray:
    array = np.zeros(shape)
    for index, value in at.items():
        array[index] = value
    return read_only(array)


# Of each mode: which states last (a rate in a lift only), what a step climbs, the variances of each prediction, and
# those that grow with its time, where nobody makes steps and where somebody does.
_LASTS = _entries(
    {(m, s, s): 1.0 for m in range(N_MODES) for s in range(N_STATES) if s != RATE or m == LIFT},
    (N_MODES, N_STATES, N_STATES),
)
_RISEN = _entries({(UP, CLIMBED): RISER_M, (DOWN, CLIMBED): -RISER_M}, (N_MODES, N_STATES))
_AT_ONCE = {(m, CLIMBED, CLIMBED): STAIRS_STD_M**2 for m in (UP, DOWN)} | {(JUMP, AIR, AIR): JUMP_STD_M**2}
_BY_TIME = {(m, AIR, AIR): AIR_WALK_M**2 + (m == DRIFT) * DRIFT_M**2 for m in range(N_MODES)}
_NOISE = _entries(_AT_ONCE, (N_MODES, N_STATES, N_STATES))
_WALK = tuple(
    _entries(more, (N_MODES, N_STATES, N_STATES))
    for more in (_BY_TIME, _BY_TIME | {(SLOPE, SLOPED, SLOPED): SLOPE_MPS**2})
)
_STANDING, _UPSTAIRS, _DOWNSTAIRS = (CONTEXTS.index(c) for c in ("stationary", "upstairs", "downstairs"))
_ON_FOOT = [CONTEXTS.index(c) for c in ("walking", "running", "sideways")]


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the height at one time: estimates of the modes, their sum, and the storeys."""

    mean: FloatArray  # (7, 4)
    cov: FloatArray  # (7, 4, 4)
    prob: FloatArray  # (7,)
    climbed_m: float = 0.0
    height_m: float = 0.0  # above the start
    height_var_m2: float = 0.0
    pressure_s: float = np.nan  # of the last second of the barometer
    ride: tuple[float, float] | None = None  # since when somebody rides, and what was climbed until then
    calm_in_s: float = 0.0  # the pressure is that of a vehicle until it has been calm for so long
    first_air_m: float = np.nan
    most_air_m: float = 0.0  # that the air has changed since then
    floors: FloorState = field(default_factory=FloorState)

    @property
    def height_std_m(self) -> float:
        """Standard deviation of the height."""
        return math.sqrt(max(self.height_var_m2, 0.0))


@dataclass(frozen=True, eq=False)
class Second:
    """One second of the barometer, and what was known before it."""

    before: Known
    climb: Climb
    log_evidence: FloatArray  # (7,) of the windows that ended in it
    n_steps: int


@dataclass(frozen=True, eq=False)
class HeightState:
    """What is known, the last seconds, of which steps may still become known, and what waits for the next one."""

    known: Known
    recent: tuple[Second, ...] = ()  # oldest first
    log_evidence: FloatArray = field(default_factory=lambda: np.zeros(N_MODES))
    n_steps: int = 0
    step_s: float = np.nan  # of the last step
    stairs_unknown_share: float = 0.0  # of the last window


def initial_height() -> HeightState:
    """State at the start, whose height is zero."""
    cov = np.diag([0.0, 0.0, 0.0, _UNKNOWN_M2])
    return HeightState(Known(np.zeros((N_MODES, N_STATES)), np.tile(cov, (N_MODES, 1, 1)), np.eye(N_MODES)[LEVEL]))


def on_window(state: HeightState, window: WindowContext, model: PedestrianModel) -> HeightState:
    """State with what a window's motion says of stairs; the climb rate must not be in it, which is pressure."""
    state = replace(state, stairs_unknown_share=window.stairs_unknown_share)
    if not state.recent or not np.isfinite(window.prob).all():
        return state
    said = context_log_evidence(
        to_be_told_apart(window.prob, window.stairs_unknown_share),
        window.training_prior,
        model.evidence_exponent,
        model.evidence_floor,
        model.prior_exponent,
    )
    on_foot, standing = float(said[_ON_FOOT].max()), float(said[_STANDING])
    either = max(on_foot, standing)
    of_modes = [either, on_foot, said[_UPSTAIRS], said[_DOWNSTAIRS], standing, either, standing]
    return replace(state, log_evidence=state.log_evidence + np.array(of_modes))


def on_pressure(
    state: HeightState, climb: Climb, model: PedestrianModel
) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """New state after a second of the barometer whose steps are known, and what is certain now of floor changes."""
    second = Second(state.known, climb, state.log_evidence, state.n_steps)
    known = _after(second, model)
    recent = (*state.recent, second)
    n_final = sum(s.climb.time_s < climb.time_s - LATE_S for s in state.recent)
    passages = [p for later in recent[1 : n_final + 1] for p in later.before.floors.passages]
    waits = replace(state, log_evidence=np.zeros(N_MODES), n_steps=0)
    return replace(waits, known=known, recent=recent[n_final:]), tuple(passages)


def on_step(
    state: HeightState, now_s: float, step_s: float, up_prob: float, down_prob: float, model: PedestrianModel
) -> tuple[HeightState, Known, tuple[FloorPassage, ...]]:
    """New state after a step that became known now, what is known of its own time, and of floor changes.

    With a barometer it counts in its own second. Without, it climbs as far as it was probably made on stairs.
    """
    elapsed_s = min(max(step_s - state.step_s, 0.0), 2.0) if math.isfinite(state.step_s) else 0.5
    state = replace(state, step_s=step_s)
    if state.recent and now_s - state.known.pressure_s < PRESSURE_AGE_S and state.known.calm_in_s == 0:
        if step_s > state.known.pressure_s:
            return replace(state, n_steps=state.n_steps + 1), state.known, ()
        i = next(i for i, s in enumerate(state.recent) if step_s <= s.climb.time_s)
        again = [*state.recent[:i], replace(state.recent[i], n_steps=state.recent[i].n_steps + 1)]
        for later in state.recent[i + 1 :]:
            again.append(replace(later, before=_after(again[-1], model)))
        known = _after(again[-1], model)
        own = again[i + 1].before if i + 1 < len(again) else known
        return replace(state, known=known, recent=tuple(again)), own, ()
    passages = tuple(p for later in state.recent[1:] for p in later.before.floors.passages)
    if state.recent:
        passages += state.known.floors.passages
    unseen_var = (_UNSEEN_SLOPE_M**2 + state.stairs_unknown_share * _UNSEEN_STAIRS_M**2) * elapsed_s
    known = _climbed(state.known, step_s, elapsed_s, up_prob, down_prob, unseen_var)
    state = replace(state, known=known, recent=(), log_evidence=np.zeros(N_MODES), n_steps=0)
    return state, known, passages + known.floors.passages


def with_floor(state: HeightState, floor: int) -> HeightState:
    """State that is known to be on a storey of this number now."""

    def named(known: Known) -> Known:
        return replace(known, floors=fixed(known.floors, floor - state.known.floors.floor))

    recent = tuple(replace(second, before=named(second.before)) for second in state.recent)
    return replace(state, known=named(state.known), recent=recent)


def finish(state: HeightState) -> tuple[HeightState, tuple[FloorPassage, ...]]:
    """State when nothing more will come, and the last floor changes."""
    passages = [p for later in state.recent[1:] for p in later.before.floors.passages]
    if state.recent:
        passages += state.known.floors.passages
    times = [t for t in (state.step_s, state.known.pressure_s) if np.isfinite(t)]
    last = finished(state.known.floors, max(times, default=0.0), state.known.climbed_m)
    return replace(state, known=replace(state.known, floors=last), recent=()), (*passages, *last.passages)


def notes(state: HeightState) -> list[Note]:
    """What to keep in mind about heights."""
    if state.known.most_air_m < _NOTABLE_AIR_M:
        return []
    hpa = state.known.most_air_m / _M_PER_HPA
    words = f"the pressure changed by {hpa:.0f} hPa that nobody climbed, as in a cabin, a vehicle or by the weather: "
    return [Note("height", words + "heights and floors do not count it")]


def _after(second: Second, model: PedestrianModel) -> Known:
    """What is known after a second of the barometer."""
    known, climb, n_steps = second.before, second.climb, second.n_steps
    if known.calm_in_s > 0:
        calm_in_s = CALM_S if abs(climb.climb_rate_mps) > CALM_MPS else known.calm_in_s - 1.0
        return replace(known, pressure_s=climb.time_s, calm_in_s=max(calm_in_s, 0.0))
    elapsed_s = climb.time_s - known.pressure_s
    if not elapsed_s > 0:  # the first, or a clock that was set back
        elapsed_s = 1.0
    mean, cov, prob = imm.mix(known.mean, known.cov, known.prob, _TRANSITIONS)
    mean, cov = _predict(mean, cov, elapsed_s, n_steps)
    variance = DRAUGHT_STD_M**2 + climb.height_std_m**2
    mean, cov, log_likelihood = _measured(mean, cov, _PRESSURE, climb.height_m, variance)
    log_likelihood = log_likelihood + second.log_evidence
    log_likelihood[[LIFT, DRIFT]] += n_steps * model.step_log_odds_stationary
    log_likelihood[LIFT] += _log_prob_rides(float(mean[LIFT, RATE]), float(cov[LIFT, RATE, RATE]))
    if n_steps == 0:
        log_likelihood[UP : DOWN + 1] += _NO_STEP_ON_STAIRS
    prob = imm.update_mode_prob(prob, log_likelihood)
    x, P = imm.combine(mean, cov, prob)
    rides = float(prob[LIFT])
    ride = (known.ride or (climb.time_s, known.climbed_m)) if rides > 0.5 else None
    if ride is not None and climb.time_s - ride[0] > LONGEST_RIDE_S:
        return _in_vehicle(known, climb.time_s, x, P, ride[1])
    way = followed(
        known.floors, climb.time_s, elapsed_s, float(x[CLIMBED]), float(prob[UP] + prob[DOWN]), rides, n_steps
    )
    level = known_level(way, climb.time_s)
    if level is not None:
        variance = level.std_m**2 + LEVEL_STD_M**2
        if (level.climbed_m - x[CLIMBED]) ** 2 < _LEVEL_GATE * (P[CLIMBED, CLIMBED] + variance):
            mean, cov, _ = _measured(mean, cov, _CLIMBED, level.climbed_m, variance)
            x, P = imm.combine(mean, cov, prob)  # pyright: ignore[reportConstantRedefinition]
            level = Level(level.floor, float(x[CLIMBED]), _climbed_std(P))
        way = with_level(way, level)
    else:
        way = learnt(way, climb.time_s, float(x[CLIMBED]), _climbed_std(P))
    first_air_m = float(x[AIR]) if np.isnan(known.first_air_m) else known.first_air_m
    return Known(
        mean=mean,
        cov=cov,
        prob=prob,
        **_sum(x, P),
        pressure_s=climb.time_s,
        ride=ride,
        first_air_m=first_air_m,
        most_air_m=known.most_air_m if prob[JUMP] > 0.5 else max(known.most_air_m, abs(float(x[AIR]) - first_air_m)),
        floors=way,
    )


def _climbed(
    known: Known, step_s: float, elapsed_s: float, up_prob: float, down_prob: float, unseen_var: float
) -> Known:
    """What is known after a step without a barometer."""
    rise_m, on_stairs = RISER_M * (up_prob - down_prob), up_prob + down_prob
    of_stairs = on_stairs * (RISER_M**2 + _RISER_STD_M**2) - rise_m**2
    climbed_var = _FLIGHT_STEPS * max(of_stairs, 0.0)
    mean, cov = known.mean.copy(), known.cov.copy()
    mean[:, CLIMBED] += rise_m
    cov[:, CLIMBED, CLIMBED] += climbed_var
    cov[:, SLOPED, SLOPED] += unseen_var
    climbed_m = known.climbed_m + rise_m
    way = followed(known.floors, step_s, elapsed_s, climbed_m, on_stairs, 0.0, 1)
    return replace(
        known,
        mean=mean,
        cov=cov,
        climbed_m=climbed_m,
        height_m=known.height_m + rise_m,
        height_var_m2=known.height_var_m2 + climbed_var + unseen_var,
        floors=learnt(way, step_s, climbed_m, math.sqrt(max(float(known.prob.dot(cov[:, CLIMBED, CLIMBED])), 0.0))),
    )


def _predict(mean: FloatArray, cov: FloatArray, elapsed_s: float, n_steps: int) -> tuple[FloatArray, FloatArray]:
    """Mixed estimates led on by a time: x = F x + n c, P = F P F' + Q."""
    # after a gap all heights that a lift may have come to are alike
    lifted_s = min(elapsed_s, LONGEST_STEP_S)
    F, Q = _LASTS.copy(), _NOISE + elapsed_s * _WALK[n_steps > 0]
    F[LIFT, CLIMBED, RATE] = lifted_s
    to_climbed, to_rate = 0.5 * LIFT_ACCELERATION_MPS2 * lifted_s**2, LIFT_ACCELERATION_MPS2 * lifted_s
    Q[LIFT, CLIMBED, CLIMBED] = to_climbed**2
    Q[LIFT, CLIMBED, RATE] = Q[LIFT, RATE, CLIMBED] = to_climbed * to_rate
    Q[LIFT, RATE, RATE] = to_rate**2
    mean = (F @ mean[:, :, None])[:, :, 0] + n_steps * _RISEN
    return mean, F @ cov @ F.swapaxes(1, 2) + Q


def _measured(
    mean: FloatArray, cov: FloatArray, h: FloatArray, value: float, variance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Updated means, covariances and log likelihoods (7,) of a number h x: `imm.update` without its matrices."""
    innovation = value - mean @ h
    Ph = cov @ h
    S = Ph @ h + variance
    K = Ph / S[:, None]
    log_likelihood = -0.5 * (innovation**2 / S + np.log(S))
    return mean + K * innovation[:, None], cov - K[:, :, None] * Ph[:, None, :], log_likelihood


def _log_prob_rides(rate_mps: float, var: float) -> float:
    """Log probability that a rate is that of a lift or an escalator, up or down."""
    scale = math.sqrt(2.0 * max(var, 1e-12))
    slower = math.erf((LEAST_RIDE_MPS - rate_mps) / scale) - math.erf((-LEAST_RIDE_MPS - rate_mps) / scale)
    return math.log(max(1.0 - 0.5 * slower, 1e-6))


def _in_vehicle(known: Known, now_s: float, x: FloatArray, P: FloatArray, before_m: float) -> Known:
    """What is known when a ride was none: the height is that before it, and nothing of the air."""
    x[CLIMBED], x[RATE] = before_m, 0.0
    P[[RATE, AIR], :] = 0.0
    P[:, [RATE, AIR]] = 0.0
    P[AIR, AIR] = _UNKNOWN_M2
    floor = known.floors.climbing.from_floor
    return replace(
        known,
        mean=np.tile(x, (N_MODES, 1)),
        cov=np.tile(P, (N_MODES, 1, 1)),
        prob=np.eye(N_MODES)[LEVEL],
        **_sum(x, P),
        pressure_s=now_s,
        ride=None,
        calm_in_s=CALM_S,
        floors=replace(known.floors, floor=floor, climbing=Climbing(now_s, floor, before_m), passages=()),
    )


def _climbed_std(P: FloatArray) -> float:
    return math.sqrt(max(float(P[CLIMBED, CLIMBED]), 0.0))


def _sum(x: FloatArray, P: FloatArray) -> dict[str, float]:
    """What is climbed, and the height with its variance, of combined estimates."""
    variance = P[CLIMBED, CLIMBED] + P[SLOPED, SLOPED] + 2.0 * P[CLIMBED, SLOPED]
    climbed_m = float(x[CLIMBED])
    return {"climbed_m": climbed_m, "height_m": climbed_m + float(x[SLOPED]), "height_var_m2": float(variance)}
