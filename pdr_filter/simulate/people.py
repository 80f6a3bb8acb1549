"""Simulated people who differ in gait and in how they hold the phone.

`simulate` walks one typical person; a classifier trained on that one learns a habit. Every size here is drawn around
the typical one, with a spread that is a guess: no statistics of how people hold phones are public.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pdr_filter.io.recording import Recording
from pdr_filter.simulate.gait import Gait, Leg
from pdr_filter.simulate.motion import Carrying
from pdr_filter.simulate.sensors import SensorErrors
from pdr_filter.simulate.walk import simulate

MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket")
# At the ear: the top end raised, and rolled until the screen faces the head.
EAR_PITCH_RAD, EAR_ROLL_RAD = 0.75, 1.45


def simulated_person(mode: str, number: int) -> Recording:
    """A walk of somebody who carries a phone in one mode, turns corners, runs or climbs stairs.

    The same person for the same mode and number. Gait and grip vary more than the typical person's of `simulate`, and
    the hand shakes sideways too: simulated hands that hold still know only clean windows.
    """
    rng = np.random.default_rng([MODES.index(mode), number])
    seed = number * len(MODES) + MODES.index(mode)
    gait = Gait.random(1000 + seed)
    gait = replace(
        gait,
        bounce_factor=gait.bounce_factor * _about(rng, 1.0, 0.2),
        impact_factor=gait.impact_factor * _about(rng, 1.0, 0.3),
        swing_factor=gait.swing_factor * _about(rng, 1.0, 0.15),
        tilt_rad=float(np.clip(rng.normal(0.4, 0.3), -0.1, 1.15)),
    )
    return simulate(
        _walk(number, rng),
        gait,
        mode,
        rate_hz=(50.0, 100.0, 200.0)[number % 3],
        errors=SensorErrors() if number % 2 else SensorErrors.bmi160(),
        seed=seed,
        start_heading_rad=float(rng.uniform(0.0, 2 * np.pi)),
        name=f"simulated_{mode}_{number}",
        carrying={mode: _PLACES[mode](rng)},
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
    wobble = _about(rng, 0.75, 0.4)
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.12 else 0.0
    return Carrying(
        pivot=(rng.uniform(-0.05, 0.05), rng.uniform(0.14, 0.24), rng.uniform(0.62, 0.78)),
        roll_rad=rng.normal(0.0, 0.12),
        twist_rad=across + rng.normal(0.0, 0.12),
        **_hand(rng, 0.2, (0.012, 0.03), wobble, 0.03),
    )


def _calling(rng: np.random.Generator) -> Carrying:
    """At the right or the left ear."""
    side, wobble = _side(rng), _about(rng, 0.75, 0.4)
    return Carrying(
        pivot=(side * 0.05, 0.03, 0.93),
        pitch_rad=rng.normal(EAR_PITCH_RAD, 0.2),
        roll_rad=-side * rng.normal(EAR_ROLL_RAD, 0.25),
        **_hand(rng, 0.18, (0.015, 0.035), wobble, 0.04),
    )


def _hand(
    rng: np.random.Generator, impact: float, width_s: tuple[float, float], wobble: float, roll_rad: float
) -> dict[str, Any]:
    """What reaches a phone that a raised hand holds, and how the hand moves."""
    return {
        "bounce": rng.uniform(0.6, 1.1),
        "impact": _about(rng, impact, 0.5),
        "impact_width_s": rng.uniform(*width_s),
        "impact_sideways": _about(rng, 0.5, 0.5),
        "wobble_pitch_rad": 0.025 * wobble,
        "wobble_roll_rad": roll_rad * wobble * rng.uniform(0.5, 1.5),
        "wobble_yaw_rad": 0.05 * wobble * rng.uniform(0.5, 1.5),
        "tremor": _about(rng, 0.8, 0.4),
    }


def _swinging(rng: np.random.Generator) -> Carrying:
    """At the end of the arm, bent in three of ten: mostly along the fingers, else the long edge hangs."""
    side, wobble = _side(rng), _about(rng, 1.0, 0.4)
    along = rng.uniform() < 0.7
    long_arm = rng.uniform() < 0.7
    return Carrying(
        pivot=(side * 0.12, 0.0, rng.uniform(0.66, 0.72)),
        lever=(0.0, rng.uniform(0.0, 0.08), -rng.uniform(0.2, 0.36) if long_arm else -rng.uniform(0.08, 0.2)),
        pitch_rad=rng.normal(0.0, 0.45) if along else _side(rng) * np.pi / 2 + rng.normal(0.0, 0.35),
        roll_rad=side * (np.pi / 2 + rng.normal(0.0, 0.35)) if along else rng.uniform(-np.pi, np.pi),
        twist_rad=rng.normal(0.0, 0.15),
        arm=_about(rng, 0.9, 0.4),
        bounce=rng.uniform(0.7, 1.05),
        impact=_about(rng, 0.25, 0.45),
        impact_width_s=rng.uniform(0.014, 0.035),
        impact_sideways=_about(rng, 0.75, 0.5),
        wobble_pitch_rad=0.02 * wobble,
        wobble_roll_rad=0.1 * wobble * rng.uniform(0.4, 1.4),
        wobble_yaw_rad=0.08 * wobble * rng.uniform(0.0, 1.5),
        wobble_twist_rad=0.08 * wobble,
        tremor=_about(rng, 1.1, 0.4),
    )


def _pocket(rng: np.random.Generator) -> Carrying:
    """In a front or, nearly half, a back pocket: either end down, any face to the leg, one in twelve lying across."""
    side, wobble = _side(rng), _about(rng, 1.0, 0.4)
    back = rng.uniform() < 0.45
    across = _side(rng) * np.pi / 2 if rng.uniform() < 0.08 else 0.0
    return Carrying(
        pivot=(side * 0.06, 0.0, 0.0),
        lever=(
            side * 0.02,
            -rng.uniform(0.03, 0.07) if back else rng.uniform(0.02, 0.06),
            -rng.uniform(0.0, 0.07) if back else -rng.uniform(0.06, 0.16),
        ),
        pitch_rad=_side(rng) * np.pi / 2 + rng.normal(0.0, 0.15),
        roll_rad=rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2], p=[0.4, 0.1, 0.4, 0.1]) + rng.normal(0.0, 0.35),
        twist_rad=across + rng.normal(0.0, 0.35),
        thigh=(rng.uniform(0.4, 0.9) if back else rng.uniform(0.6, 1.1)) * _about(rng, 0.86, 0.3),
        bounce=rng.uniform(0.8, 1.1),
        impact=_about(rng, 0.6 if back else 0.8, 0.4),
        impact_width_s=rng.uniform(0.012, 0.028),
        impact_sideways=rng.uniform(0.5, 1.3),
        one_sided=rng.uniform(0.1, 0.6),
        wobble_roll_rad=0.2 * wobble * rng.uniform(0.3, 1.4),
        wobble_yaw_rad=0.06 * wobble,
        wobble_twist_rad=0.12 * wobble * rng.uniform(0.3, 1.4),
        tremor=_about(rng, 1.1, 0.3),
    )


_PLACES: dict[str, Callable[[np.random.Generator], Carrying]] = {
    "texting": _texting,
    "calling": _calling,
    "swinging": _swinging,
    "pocket": _pocket,
}
