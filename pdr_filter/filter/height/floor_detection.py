"""Detection of storeys: levels at which people stay.

The only prior knowledge about a building is the height of storeys, 2.6 to 5.5 m (0.31 to 0.66 hPa). Between visited
levels the storey number is interpolated by height. Beyond them the next storey is one storey height away, which is
estimated from the usual height and the storeys of this building. The present storey changes when another one is clearly
closer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pdr_filter.values import FloorPassage, HowClimbed, replace_unchecked

# Usual storey height. Heights from 2.6 to 5.5 m must count as one storey, and the limits are half of the usual height
# and one and a half of it. The geometric mean has the same relative margin at both.
USUAL_STOREY_M = 3.8
# Smallest distance between two levels, because rooms are at least 2.3 m high. A closer level is a landing.
MIN_STOREY_M = 2.3
# Hysteresis about the middle between two storeys, in storeys. Otherwise noise would change the storey with every step
# of a person on a landing.
_HYSTERESIS = 0.05
# Longest interval between two pressure values whose motion counts as climbing.
_MAX_INTERVAL_S = 4.0
# Distance from a storey, in storeys, within which the person has not left it.
_SAME_STOREY = 0.25
# Time on level ground, with at least one step, after which the person has arrived. A landing between two flights takes
# two or three steps, and an intermediate stop of a lift no steps.
ARRIVED_S = 3.0
# Smallest time and number of steps on level ground that count as a stay. A person who waits in a lift makes no steps.
STAY_S, STAY_STEPS = 5.0, 3
NEW_STAY_S = 8.0  # smallest time of a stay that adds a level
# Standard deviation of the level within one storey, including the height at which the phone is carried.
LEVEL_STD_M = 0.1
# Smallest number of steps per metre on stairs. Stairs take 5.3 to 7.1, walking on an escalator half of that.
_STEPS_PER_M = 4.0
# Limit between the climb rates of escalators, 0.25 to 0.4 m/s, and of a slow lift, 0.6 m/s or 0.5 m/s with start and
# stop.
_ESCALATOR_MPS = 0.45
# Ratio of horizontal displacement to height above which a climb was a slope. Stairs lead 1.5 to 2 m forward for each
# metre up and turn back at a landing. On 8 climbs of ipin2023 locations moved by at most 3.2 m for each metre, and on a
# hill by 6 m. A walkable ramp needs 6 m or more.
_MIN_HILL_RATIO = 4.5


# East and north in metres of an accurate location.
Position = tuple[float, float]


@dataclass(frozen=True)
class Level:
    """Height of one storey."""

    floor: int  # number of the storey
    climbed_m: float  # climbed height of the level above the start
    std_m: float  # standard deviation of the level


@dataclass(frozen=True)
class Climbing:
    """Motion since a storey was left."""

    start_s: float  # time at which the storey was left
    from_floor: int = 0  # number of that storey
    from_m: float = 0.0  # climbed height at that time
    n_steps: int = 0  # steps while climbing
    # Time on stairs, and time in lifts or on escalators.
    stairs_s: float = 0.0
    ride_s: float = 0.0
    # Position at which the storey was left, if accurate locations are available since then.
    position: Position | None = None

    def is_hill(self, position: Position | None, climbed_m: float) -> bool:
        """Return True if the horizontal displacement is too large for stairs, so that a slope was walked.

        `position` is the present position. The result is False in a lift, or if one of the two positions is unknown.
        """
        if position is None or self.position is None or self.how(climbed_m) == "lift":
            return False
        return math.dist(position, self.position) > _MIN_HILL_RATIO * max(abs(climbed_m - self.from_m), 1.0)

    def how(self, climbed_m: float) -> HowClimbed:
        """Return the kind of climb: "stairs", "escalator", "lift" or "unknown".

        It follows from the number of steps per metre and the climb rate. It is "unknown" before any time on stairs or
        in a ride.
        """
        height_m = abs(climbed_m - self.from_m)
        if max(self.stairs_s, self.ride_s) == 0.0:
            return "unknown"
        if self.stairs_s > self.ride_s and self.n_steps >= _STEPS_PER_M * height_m:
            return "stairs"
        rate_mps = height_m / (self.stairs_s + self.ride_s)
        return "escalator" if self.n_steps > height_m or rate_mps < _ESCALATOR_MPS else "lift"


@dataclass(frozen=True)
class FloorState:
    """Known storeys, the present storey, and the motion towards another one."""

    floor: int = 0  # number of the present storey
    floor_since_s: float = np.nan  # time of the last change of `floor`
    levels: tuple[Level, ...] = (Level(0, 0.0, LEVEL_STD_M),)  # known levels, from the lowest to the highest
    climbing: Climbing = Climbing(np.nan)  # motion since a storey was left
    level_since_s: float = np.nan  # start of the present stay on level ground, or NaN while climbing
    n_level_steps: int = 0  # steps in the present stay
    is_used: bool = False  # True if the present stay has already updated a level
    passages: tuple[FloorPassage, ...] = ()  # passages completed by the last event
    is_numbered: bool = False  # True if a storey was given, so that the numbers of the storeys are known


def storey_m(levels: tuple[Level, ...]) -> float:
    """Return the estimated storey height, m.

    It is the mean of the usual storey height and the heights of the known storeys of this building. Each storey between
    two known levels counts once.
    """
    heights_m = [USUAL_STOREY_M]
    for lower, upper in pairwise(levels):
        n = upper.floor - lower.floor
        heights_m += n * [(upper.climbed_m - lower.climbed_m) / n]
    return sum(heights_m) / len(heights_m)


def storey_number(levels: tuple[Level, ...], climbed_m: float) -> float:
    """Return the storey number of a height as a real number.

    It is interpolated between known levels and extrapolated beyond them.
    """
    lowest, highest = levels[0], levels[-1]
    if climbed_m <= lowest.climbed_m:
        return lowest.floor + (climbed_m - lowest.climbed_m) / storey_m(levels)
    if climbed_m >= highest.climbed_m:
        return highest.floor + (climbed_m - highest.climbed_m) / storey_m(levels)
    return float(np.interp(climbed_m, [level.climbed_m for level in levels], [level.floor for level in levels]))


def level_of(levels: tuple[Level, ...], floor: int, storey_std_m: float) -> Level:
    """Return the level of a storey, interpolated or extrapolated from known levels.

    `storey_std_m` is the standard deviation of the height of a storey that has not been visited.
    """
    nearest = min(levels, key=lambda level: abs(level.floor - floor))
    n = floor - nearest.floor
    std_m = math.hypot(nearest.std_m, storey_std_m * math.sqrt(abs(n)))
    return Level(floor, nearest.climbed_m + n * storey_m(levels), std_m)


def after_motion(
    state: FloorState,
    now_s: float,
    elapsed_s: float,
    climbed_m: float,
    p_stairs: float,
    p_ride: float,
    n_steps: int,
    position: Position | None,
) -> tuple[FloorState, float]:
    """Return the state of the storeys after an interval, and the part of the climbed height that was a slope, m.

    The person has made `n_steps` steps and reached `climbed_m` at `now_s`, after `elapsed_s`. `p_stairs` and `p_ride`
    are the probabilities of stairs and of a lift or escalator. `position` is an accurate location, or None. Only
    accurate locations can identify a slope. The state holds the passage that the interval completes.
    """
    at, climbs = storey_number(state.levels, climbed_m), p_stairs + p_ride > 0.5
    floor = round(at) if climbs or abs(at - state.floor) > 0.5 + _HYSTERESIS else state.floor
    floor_since_s = state.floor_since_s if floor == state.floor else now_s
    climbing = state.climbing if position is not None else replace_unchecked(state.climbing, position=None)
    if floor != climbing.from_floor and climbing.is_hill(position, climbed_m):
        back = _new_climbing(now_s, climbing.from_floor, climbing.from_m, position)
        since_s = state.floor_since_s if state.floor == back.from_floor else now_s
        state = replace_unchecked(state, floor=back.from_floor, floor_since_s=since_s, climbing=back, passages=())
        return state, climbed_m - climbing.from_m
    if climbs:
        is_on_stairs = p_stairs > p_ride
        elapsed_s = elapsed_s if elapsed_s < _MAX_INTERVAL_S else 0.0
        climbing = replace_unchecked(
            climbing,
            n_steps=climbing.n_steps + n_steps,
            stairs_s=climbing.stairs_s + is_on_stairs * elapsed_s,
            ride_s=climbing.ride_s + (not is_on_stairs) * elapsed_s,
        )
        return FloorState(floor, floor_since_s, state.levels, climbing, is_numbered=state.is_numbered), 0.0
    since_s = now_s if math.isnan(state.level_since_s) else state.level_since_s
    is_back = floor == climbing.from_floor
    if is_back and abs(at - floor) < _SAME_STOREY:
        climbing = _new_climbing(now_s, floor, climbed_m, position)
    state = replace_unchecked(
        state,
        floor=floor,
        floor_since_s=floor_since_s,
        climbing=climbing,
        level_since_s=since_s,
        n_level_steps=state.n_level_steps + n_steps,
        passages=(),
    )
    has_arrived = not is_back and now_s - since_s >= ARRIVED_S and state.n_level_steps > 0
    return _arrived(state, now_s, climbed_m, position) if has_arrived else state, 0.0


def floors_at_end(state: FloorState, now_s: float, climbed_m: float) -> FloorState:
    """Return the state of the storeys at the end of a walk.

    A person on another storey than at the last stay has arrived there. The state then holds the passage to this storey,
    otherwise none.
    """
    is_same = state.floor == state.climbing.from_floor
    return replace_unchecked(state, passages=()) if is_same else _arrived(state, now_s, climbed_m, None)


def _new_climbing(now_s: float, floor: int, climbed_m: float, position: Position | None) -> Climbing:
    """Return a motion that starts at a time on a storey with the climbed height `climbed_m`."""
    return Climbing(now_s, floor, climbed_m, position=position)


def _arrived(state: FloorState, now_s: float, climbed_m: float, position: Position | None) -> FloorState:
    """Return the state of the storeys after the arrival on another one, with the passage that led there."""
    climbing, level_s = state.climbing, now_s if np.isnan(state.level_since_s) else state.level_since_s
    end_s = max(level_s, state.floor_since_s)
    passage = FloorPassage(climbing.start_s, end_s, climbing.from_floor, state.floor, climbing.how(climbed_m))
    climbing = _new_climbing(now_s, state.floor, climbed_m, position)
    return replace_unchecked(state, climbing=climbing, passages=(passage,))


def known_level(state: FloorState, now_s: float) -> Level | None:
    """Return the level of the present storey, or None.

    The level must be known, the person must have stayed there, and the stay must not have been used yet.
    """
    if state.is_used or not _stays(state, now_s, STAY_S):
        return None
    return next((level for level in state.levels if level.floor == state.floor), None)


def with_new_level(state: FloorState, now_s: float, climbed_m: float, std_m: float) -> FloorState:
    """Return the state with the level of the present storey added, if the person has stayed there for long enough.

    A level closer than `MIN_STOREY_M` to a known one is not added. `std_m` is the standard deviation of the climbed
    height `climbed_m`.
    """
    if state.is_used or not _stays(state, now_s, NEW_STAY_S):
        return state
    if any(abs(climbed_m - level.climbed_m) < MIN_STOREY_M for level in state.levels):
        return replace_unchecked(state, is_used=True)
    return with_level(state, Level(state.floor, climbed_m, float(np.hypot(std_m, LEVEL_STD_M))))


def with_level(state: FloorState, level: Level) -> FloorState:
    """Return the state with a known level of one storey, which replaces an earlier one.

    The present stay is marked as used.
    """
    others = [other for other in state.levels if other.floor != level.floor]
    return replace_unchecked(state, levels=tuple(sorted([*others, level], key=lambda e: e.floor)), is_used=True)


def on_storey(state: FloorState, level: Level) -> FloorState:
    """Return the state on a storey that was given by a fix, with its level known."""
    climbing = Climbing(state.floor_since_s, level.floor, level.climbed_m)
    return replace_unchecked(with_level(state, level), floor=level.floor, climbing=climbing)


def floors_numbered_from(state: FloorState, up: int) -> FloorState:
    """Return the state with the numbers of all storeys increased by `up`."""
    levels = tuple(replace_unchecked(level, floor=level.floor + up) for level in state.levels)
    climbing = replace_unchecked(state.climbing, from_floor=state.climbing.from_floor + up)
    return replace_unchecked(state, floor=state.floor + up, levels=levels, climbing=climbing, is_numbered=True)


def _stays(state: FloorState, now_s: float, stay_s: float) -> bool:
    """Return True if the person has been on level ground for `stay_s` and has made `STAY_STEPS` steps there."""
    return now_s - state.level_since_s >= stay_s and state.n_level_steps >= STAY_STEPS
