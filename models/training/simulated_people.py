"""Random people for `pdr_filter.simulate`, who differ in gait and in the way they carry the phone.

Every quantity is drawn around the typical value of `simulate`. The spreads are assumptions, because there are no public
statistics on how people hold phones. Experiments use these people. The models are trained on those of `sine_people`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from models.training.sine_people import EAR_PITCH_RAD, EAR_ROLL_RAD, MODES, random_factor, random_side
from pdr_filter.simulate.gait import Gait
from pdr_filter.simulate.motion import Carrying


def random_person(mode: str, number: int) -> tuple[Gait, Carrying]:
    """Return the gait of a random person and the placement of the phone in a carrying mode.

    Equal modes and numbers give equal persons.
    """
    seed = number * len(MODES) + MODES.index(mode)
    rng = np.random.default_rng([MODES.index(mode), number])
    tilt_rad = float(np.clip(rng.normal(0.4, 0.3), -0.1, 1.15))
    return replace(Gait.random(1000 + seed), tilt_rad=tilt_rad), _PLACES[mode](rng)


def _texting(rng: np.random.Generator) -> Carrying:
    """Return a random place and attitude of a phone in front of the chest. One in eight people holds it in landscape.

    The pitch is the pitch of this person (`Gait.tilt_rad`).
    """
    across = random_side(rng) * np.pi / 2 if rng.uniform() < 0.12 else 0.0
    return Carrying(
        place=(rng.uniform(-0.05, 0.05), rng.uniform(0.14, 0.24), rng.uniform(0.62, 0.78)),
        roll_rad=rng.normal(0.0, 0.12),
        twist_rad=across + rng.normal(0.0, 0.12),
        side=random_side(rng),
        force=random_factor(rng, 1.35, 0.2),  # the arm yields: 1 to 1.8 times the force
        **_grip(rng),
    )


def _calling(rng: np.random.Generator) -> Carrying:
    """Return a random place and attitude of a phone at the right or the left ear."""
    side = random_side(rng)
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
    side = random_side(rng)
    along = rng.uniform() < 0.7
    return Carrying(
        place=(side * 0.12, rng.uniform(0.0, 0.08), rng.uniform(0.35, 0.5)),
        strides="swinging",
        pitch_rad=rng.normal(0.0, 0.45) if along else random_side(rng) * np.pi / 2 + rng.normal(0.0, 0.35),
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
    side, back = random_side(rng), rng.uniform() < 0.25
    across = random_side(rng) * np.pi / 2 if rng.uniform() < 0.08 else 0.0
    return Carrying(
        place=(side * 0.08, -0.05 if back else 0.04, 0.48 if back else 0.4),
        strides="back_pocket" if back else "pocket",
        pitch_rad=random_side(rng) * np.pi / 2 + rng.normal(0.0, 0.15),
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
    return {
        "turn": random_factor(rng, 1.0, 0.1),
        "loose": random_factor(rng, 1.0, 0.15),
        "tremor": random_factor(rng, 1.0, 0.4),
    }


_PLACES: dict[str, Callable[[np.random.Generator], Carrying]] = {
    "texting": _texting,
    "calling": _calling,
    "swinging": _swinging,
    "pocket": _pocket,
}
