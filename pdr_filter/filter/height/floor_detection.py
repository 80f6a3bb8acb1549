"""Storeys: the levels between which somebody climbs, learnt where people stay.

Nothing is known of a building but how high storeys are: 2.6 to 5.5 m (0.31 to 0.66 hPa). Between levels that were
visited the storey is where a height lies between them; beyond, the next storey is as far as storeys are, those of this
building among them. A storey is left when the next one is clearly nearer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pdr_filter.values import FloorPassage, HowClimbed, replace_unchecked

# The one height that makes one storey of all from 2.6 to 5.5 m, the limits being half of it and one and a half with
# the same to spare: their geometric mean.
USUAL_STOREY_M = 3.8
# Rooms are 2.3 m high at least: what is nearer to a known level is a landing.
LEAST_STOREY_M = 2.3
# In storeys, beyond the middle between two: noise must not make somebody on a landing change storeys with every step.
_CLEARLY = 0.05
# What happened in a longer time than this without pressure is not known.
_BLIND_S = 4.0
# Within a quarter of a storey somebody has not left it.
_STILL_THERE = 0.25
# Who arrives stays for so long and walks off; a landing between two flights is two or three steps, and a lift that
# stops on its way none.
ARRIVED_S = 3.0
# A stay: level ground for so long, on which somebody walked a little. Who waits in a lift makes no steps.
STAY_S, STAY_STEPS = 5.0, 3
NEW_STAY_S = 8.0
# Levels of one storey differ by this, and so does how high a phone is carried on it.
LEVEL_STD_M = 0.1
# Stairs take 5.3 to 7.1 steps a metre, an escalator that somebody walks on half of that.
_STEPS_PER_M = 4.0
# Escalators climb with 0.25 to 0.4 m/s; a slow lift 0.6 m/s, starts and stops included 0.5.
_ESCALATOR_MPS = 0.45
# Stairs lead 1.5 to 2 m forward for each metre up and come back at a landing: locations moved by at most 3.2 m for
# each metre on 8 climbs of ipin2023, and by 6 m on a hill. A ramp that people can walk leads 6 m or more.
_LEAST_WAY_OF_A_HILL = 4.5


# East and north in metres, as a good location shows it.
Place = tuple[float, float]


@dataclass(frozen=True)
class Level:
    """Where one storey is."""

    floor: int
    climbed_m: float
    std_m: float


@dataclass(frozen=True)
class Climbing:
    """What happened since a storey was left."""

    start_s: float
    from_floor: int = 0
    from_m: float = 0.0
    n_steps: int = 0
    stairs_s: float = 0.0
    ride_s: float = 0.0
    place: Place | None = None  # where the storey was left, if good locations have shown the way since then

    def is_hill(self, place: Place | None, climbed_m: float) -> bool:
        """True if good locations moved so far while the height changed that a slope was walked."""
        if place is None or self.place is None or self.how(climbed_m) == "lift":
            return False
        return math.dist(place, self.place) > _LEAST_WAY_OF_A_HILL * max(abs(climbed_m - self.from_m), 1.0)

    def how(self, climbed_m: float) -> HowClimbed:
        """What it was, by the steps of a metre and the rate."""
        height_m = abs(climbed_m - self.from_m)
        if max(self.stairs_s, self.ride_s) == 0.0:
            return "unknown"
        if self.stairs_s > self.ride_s and self.n_steps >= _STEPS_PER_M * height_m:
            return "stairs"
        rate_mps = height_m / (self.stairs_s + self.ride_s)
        return "escalator" if self.n_steps > height_m or rate_mps < _ESCALATOR_MPS else "lift"


@dataclass(frozen=True)
class FloorState:
    """Storeys that are known, the present one, and how far somebody is on the way to another."""

    floor: int = 0
    floor_since_s: float = np.nan
    levels: tuple[Level, ...] = (Level(0, 0.0, LEVEL_STD_M),)
    climbing: Climbing = Climbing(np.nan)
    level_since_s: float = np.nan  # NaN while somebody climbs
    n_level_steps: int = 0  # since then
    is_used: bool = False  # the present stay has taught what it can
    passages: tuple[FloorPassage, ...] = ()  # that were completed by the last event


def storey_m(levels: tuple[Level, ...]) -> float:
    """How high a storey is: the usual height and those of this building, each with the same weight."""
    heights_m = [USUAL_STOREY_M]
    for lower, upper in pairwise(levels):
        n = upper.floor - lower.floor
        heights_m += n * [(upper.climbed_m - lower.climbed_m) / n]
    return sum(heights_m) / len(heights_m)


def storeys_up(levels: tuple[Level, ...], climbed_m: float) -> float:
    """The storey of a height, between two storeys as far as the height is between their levels."""
    lowest, highest = levels[0], levels[-1]
    if climbed_m <= lowest.climbed_m:
        return lowest.floor + (climbed_m - lowest.climbed_m) / storey_m(levels)
    if climbed_m >= highest.climbed_m:
        return highest.floor + (climbed_m - highest.climbed_m) / storey_m(levels)
    return float(np.interp(climbed_m, [level.climbed_m for level in levels], [level.floor for level in levels]))


def followed(
    state: FloorState,
    now_s: float,
    elapsed_s: float,
    climbed_m: float,
    p_stairs: float,
    p_ride: float,
    n_steps: int,
    place: Place | None,
) -> tuple[FloorState, float]:
    """State after a time in which somebody made some steps and came to a height, at a place if it is known.

    The second value is how much of the climbed height was a slope, as good locations show.
    """
    at, climbs = storeys_up(state.levels, climbed_m), p_stairs + p_ride > 0.5
    floor = round(at) if climbs or abs(at - state.floor) > 0.5 + _CLEARLY else state.floor
    floor_since_s = state.floor_since_s if floor == state.floor else now_s
    climbing = state.climbing if place is not None else replace_unchecked(state.climbing, place=None)
    if floor != climbing.from_floor and climbing.is_hill(place, climbed_m):
        back = _left(now_s, climbing.from_floor, climbing.from_m, place)
        since_s = state.floor_since_s if state.floor == back.from_floor else now_s
        state = replace_unchecked(state, floor=back.from_floor, floor_since_s=since_s, climbing=back, passages=())
        return state, climbed_m - climbing.from_m
    if climbs:
        is_on_stairs = p_stairs > p_ride
        elapsed_s = elapsed_s if elapsed_s < _BLIND_S else 0.0
        climbing = replace_unchecked(
            climbing,
            n_steps=climbing.n_steps + n_steps,
            stairs_s=climbing.stairs_s + is_on_stairs * elapsed_s,
            ride_s=climbing.ride_s + (not is_on_stairs) * elapsed_s,
        )
        return FloorState(floor, floor_since_s, state.levels, climbing), 0.0
    since_s = now_s if math.isnan(state.level_since_s) else state.level_since_s
    is_back = floor == climbing.from_floor
    state = replace_unchecked(
        state,
        floor=floor,
        floor_since_s=floor_since_s,
        climbing=_left(now_s, floor, climbed_m, place) if is_back and abs(at - floor) < _STILL_THERE else climbing,
        level_since_s=since_s,
        n_level_steps=state.n_level_steps + n_steps,
        passages=(),
    )
    has_arrived = not is_back and now_s - since_s >= ARRIVED_S and state.n_level_steps > 0
    return _arrived(state, now_s, climbed_m, place) if has_arrived else state, 0.0


def finished(state: FloorState, now_s: float, climbed_m: float) -> FloorState:
    """State at the end: who has come to another storey has arrived."""
    is_same = state.floor == state.climbing.from_floor
    return replace_unchecked(state, passages=()) if is_same else _arrived(state, now_s, climbed_m, None)


def _left(now_s: float, floor: int, climbed_m: float, place: Place | None) -> Climbing:
    return Climbing(now_s, floor, climbed_m, place=place)


def _arrived(state: FloorState, now_s: float, climbed_m: float, place: Place | None) -> FloorState:
    way, level_s = state.climbing, now_s if np.isnan(state.level_since_s) else state.level_since_s
    end_s = max(level_s, state.floor_since_s)
    passage = FloorPassage(way.start_s, end_s, way.from_floor, state.floor, way.how(climbed_m))
    return replace_unchecked(state, climbing=_left(now_s, state.floor, climbed_m, place), passages=(passage,))


def known_level(state: FloorState, now_s: float) -> Level | None:
    """The level of the present storey, if somebody has come back to it and it has not been used since."""
    if state.is_used or not _stays(state, now_s, STAY_S):
        return None
    return next((level for level in state.levels if level.floor == state.floor), None)


def learnt(state: FloorState, now_s: float, climbed_m: float, std_m: float) -> FloorState:
    """State that knows the level of the present storey, where somebody has stayed for long enough to call it one."""
    if state.is_used or not _stays(state, now_s, NEW_STAY_S):
        return state
    if any(abs(climbed_m - level.climbed_m) < LEAST_STOREY_M for level in state.levels):
        return replace_unchecked(state, is_used=True)
    return with_level(state, Level(state.floor, climbed_m, float(np.hypot(std_m, LEVEL_STD_M))))


def with_level(state: FloorState, level: Level) -> FloorState:
    """State in which a storey is known to be at a level."""
    others = [other for other in state.levels if other.floor != level.floor]
    return replace_unchecked(state, levels=tuple(sorted([*others, level], key=lambda e: e.floor)), is_used=True)


def fixed(state: FloorState, up: int) -> FloorState:
    """State in which all storeys are numbered by so many more."""
    levels = tuple(replace_unchecked(level, floor=level.floor + up) for level in state.levels)
    climbing = replace_unchecked(state.climbing, from_floor=state.climbing.from_floor + up)
    return replace_unchecked(state, floor=state.floor + up, levels=levels, climbing=climbing)


def _stays(state: FloorState, now_s: float, stay_s: float) -> bool:
    return now_s - state.level_since_s >= stay_s and state.n_level_steps >= STAY_STEPS
