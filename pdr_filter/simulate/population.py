"""Simulated people who differ in gait and in how they hold the phone.

`simulate` walks one typical person; a classifier trained on that one learns a habit. Every size here is drawn around
the typical one, with a spread that is a guess: no statistics of how people hold phones are public.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pdr_filter.simulate.gait import Gait, Leg
from pdr_filter.simulate.motion import Carrying
from pdr_filter.simulate.sensors import SensorErrors
from pdr_filter.simulate.walk import simulate
from pdr_filter.values.recording import Recording

MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket")
# At the ear: the top end raised, and rolled until the screen faces the head.
EAR_PITCH_RAD, EAR_ROLL_RAD = 0.75, 1.45


def random_person(mode: str, number: int) -> tuple[Gait, Carrying]:
    """Somebody's gait, and how they carry a phone in one mode; the same ones for the same mode and number."""
    seed = number * len(MODES) + MODES.index(mode)
    rng = np.random.default_rng([MODES.index(mode), number])
    tilt_rad = float(np.clip(rng.normal(0.4, 0.3), -0.1, 1.15))
    return replace(Gait.random(1000 + seed), tilt_rad=tilt_rad), _PLACES[mode](rng)


def simulated_person(mode: str, number: int) -> Recording:
    """A walk of somebody who carries a phone in one mode, turns corners, runs or climbs stairs.

    The same person for the same mode and number.
    """
    seed = number * len(MODES) + MODES.index(mode)
    rng = np.random.default_rng([number, MODES.index(mode)])
    gait, carrying = random_person(mode, number)
    return simulate(
        _walk(number, rng),
        gait,
        mode,
        rate_hz=(50.0, 100.0, 200.0)[number % 3],
        errors=SensorErrors() if number % 2 else SensorErrors.bmi160(),
        seed=seed,
        start_heading_rad=float(rng.uniform(0.0, 2 * np.pi)),
        name=f"simulated_{mode}_{number}",
        carrying={mode: carrying},
    )


def _walk(number: int, rng: np.random.Generator) -> list[Leg]:
    """Half a minute slow and fast with two corners, then most people run and all climb or descend or run."""
    slow, fast = float(rng.uniform(0.6, 0.95)), float(rng.uniform(0.9, 1.15))
    turns = [float(_side(rng) * rng.uniform(0.4, 2.2)) for _ in range(2)]
    legs = [
        Leg("stationary", duration_s=4.0),
        Leg("walking", duration_s=9.0, frequency_factor=slow),
        Leg("walking", duration_s=7.0, frequency_factor=slow, turn_rad=turns[0], curve=bool(rng.random() < 0.5)),
        Leg("walking", duration_s=9.0, frequency_factor=fast, turn_rad=turns[1]),
    ]
    if number % 3 == 0 or number % 2:
        legs.append(Leg("running", duration_s=8.0))
    if number % 3:
        legs.append(Leg(("upstairs", "downstairs")[number % 3 - 1], duration_s=8.0))
    return legs


def _side(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _about(rng: np.random.Generator, median: float, spread: float) -> float:
    """A factor or size, log-normal."""
    return median * float(np.exp(rng.normal(0.0, spread)))


def _texting(rng: np.random.Generator) -> Carrying:
    """In front of the chest, one in eight across; the pitch is the person's own, `Gait.tilt_rad`."""
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.12 else 0.0
    return Carrying(
        place=(rng.uniform(-0.05, 0.05), rng.uniform(0.14, 0.24), rng.uniform(0.62, 0.78)),
        roll_rad=rng.normal(0.0, 0.12),
        twist_rad=across + rng.normal(0.0, 0.12),
        side=_side(rng),
        force=_about(rng, 1.35, 0.2),  # an arm gives, 1 to 1.8 times
        **_grip(rng),
    )


def _calling(rng: np.random.Generator) -> Carrying:
    """At the right or the left ear."""
    side = _side(rng)
    return Carrying(
        place=(side * 0.05, 0.03, 0.93),
        strides="calling",
        pitch_rad=rng.normal(EAR_PITCH_RAD, 0.2),
        roll_rad=-side * rng.normal(EAR_ROLL_RAD, 0.25),
        side=side,
        force=1.1,
        **_grip(rng),
    )


def _swinging(rng: np.random.Generator) -> Carrying:
    """At the end of the arm, mostly along the fingers, else the long edge hangs."""
    side = _side(rng)
    along = rng.uniform() < 0.7
    return Carrying(
        place=(side * 0.12, rng.uniform(0.0, 0.08), rng.uniform(0.35, 0.5)),
        strides="swinging",
        pitch_rad=rng.normal(0.0, 0.45) if along else _side(rng) * np.pi / 2 + rng.normal(0.0, 0.35),
        roll_rad=side * (np.pi / 2 + rng.normal(0.0, 0.35)) if along else rng.uniform(-np.pi, np.pi),
        twist_rad=rng.normal(0.0, 0.15),
        side=side,
        force=1.1,
        **_grip(rng),
    )


def _pocket(rng: np.random.Generator) -> Carrying:
    """In a front or, one in four, a back pocket: either end down, any face to the leg, one in twelve lying across."""
    side, back = _side(rng), rng.uniform() < 0.25
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.08 else 0.0
    return Carrying(
        place=(side * 0.08, -0.05 if back else 0.04, 0.48 if back else 0.4),
        strides="back_pocket" if back else "pocket",
        pitch_rad=_side(rng) * np.pi / 2 + rng.normal(0.0, 0.15),
        roll_rad=rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2], p=[0.4, 0.1, 0.4, 0.1]) + rng.normal(0.0, 0.35),
        twist_rad=across + rng.normal(0.0, 0.35),
        side=side,
        force=1.0 if back else 1.45,  # the ratio is that of 11 people of ubicomp13, 0.70
        **_grip(rng),
    )


def _grip(rng: np.random.Generator) -> dict[str, Any]:
    """How firmly a hand or pocket holds the phone."""
    return {"turn": _about(rng, 1.0, 0.1), "loose": _about(rng, 1.0, 0.15), "tremor": _about(rng, 1.0, 0.4)}


_PLACES: dict[str, Callable[[np.random.Generator], Carrying]] = {
    "texting": _texting,
    "calling": _calling,
    "swinging": _swinging,
    "pocket": _pocket,
}
