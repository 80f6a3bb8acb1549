"""Simulated people who differ in gait and in the way they carry the phone.

`simulate` walks one typical person, and a classifier trained on that person alone would learn individual habits. Here
every quantity is drawn around the typical value. The spreads are assumptions, because there are no public statistics on
how people hold phones.
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
# Attitude at the ear: the top end is raised, and the phone is rolled until the screen faces the head.
EAR_PITCH_RAD, EAR_ROLL_RAD = 0.75, 1.45


def random_person(mode: str, number: int) -> tuple[Gait, Carrying]:
    """Return the gait of a random person and the placement of the phone in a carrying mode.

    Equal modes and numbers give equal persons.
    """
    seed = number * len(MODES) + MODES.index(mode)
    rng = np.random.default_rng([MODES.index(mode), number])
    tilt_rad = float(np.clip(rng.normal(0.4, 0.3), -0.1, 1.15))
    return replace(Gait.random(1000 + seed), tilt_rad=tilt_rad), _PLACES[mode](rng)


def simulated_person(mode: str, number: int) -> Recording:
    """Return a walk of a random person with corners, and with running or stairs, in one carrying mode.

    Equal modes and numbers give equal recordings. The number determines rate, sensor errors and legs together:
    recordings at 50 Hz have no stairs, those at 100 Hz upstairs and those at 200 Hz downstairs. Use the recordings for
    carrying modes, not for contexts.
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
    """Return 4 s of standing and 25 s of slow and fast walking with two turns, followed by running, stairs, or both."""
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
    """Return -1 or 1 with equal probability."""
    return float(rng.choice([-1.0, 1.0]))


def _about(rng: np.random.Generator, median: float, spread: float) -> float:
    """Return a random log-normal value with a median and a standard deviation of the logarithm (`spread`)."""
    return median * float(np.exp(rng.normal(0.0, spread)))


def _texting(rng: np.random.Generator) -> Carrying:
    """Return a random place and attitude of a phone in front of the chest. One in eight people holds it in landscape.

    The pitch is the pitch of this person (`Gait.tilt_rad`).
    """
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.12 else 0.0
    return Carrying(
        place=(rng.uniform(-0.05, 0.05), rng.uniform(0.14, 0.24), rng.uniform(0.62, 0.78)),
        roll_rad=rng.normal(0.0, 0.12),
        twist_rad=across + rng.normal(0.0, 0.12),
        side=_side(rng),
        force=_about(rng, 1.35, 0.2),  # the arm yields: 1 to 1.8 times the force
        **_grip(rng),
    )


def _calling(rng: np.random.Generator) -> Carrying:
    """Return a random place and attitude of a phone at the right or the left ear."""
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
    """Return a random place and attitude of a phone in a swinging hand at the side of the body.

    With a probability of 0.7 the phone lies along the fingers, otherwise with a long edge down.
    """
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
    """Return a random place and attitude of a phone in a front pocket or, for one in four, a back pocket.

    Either end may be down and any face towards the leg. One phone in twelve lies across.
    """
    side, back = _side(rng), rng.uniform() < 0.25
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.08 else 0.0
    return Carrying(
        place=(side * 0.08, -0.05 if back else 0.04, 0.48 if back else 0.4),
        strides="back_pocket" if back else "pocket",
        pitch_rad=_side(rng) * np.pi / 2 + rng.normal(0.0, 0.15),
        roll_rad=rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2], p=[0.4, 0.1, 0.4, 0.1]) + rng.normal(0.0, 0.35),
        twist_rad=across + rng.normal(0.0, 0.35),
        side=side,
        force=1.0 if back else 1.45,  # ratio 0.70 as measured for 11 people of ubicomp13
        **_grip(rng),
    )


def _grip(rng: np.random.Generator) -> dict[str, Any]:
    """Return random factors for how firmly a hand or a pocket holds the phone.

    They are the fields `turn`, `loose` and `tremor` of `Carrying`, by name.
    """
    return {"turn": _about(rng, 1.0, 0.1), "loose": _about(rng, 1.0, 0.15), "tremor": _about(rng, 1.0, 0.4)}


_PLACES: dict[str, Callable[[np.random.Generator], Carrying]] = {
    "texting": _texting,
    "calling": _calling,
    "swinging": _swinging,
    "pocket": _pocket,
}
