"""Recording of a simulated walk along legs, with exact ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pdr_filter.simulate.gait import STOREY_HEIGHT_M, Gait, Leg, plan_steps
from pdr_filter.simulate.motion import CARRYING, Carrying, Motion, build_motion
from pdr_filter.simulate.sensors import SensorErrors
from pdr_filter.values import FloatArray, Samples, table
from pdr_filter.values.recording import Recording, Truth

MAGNETOMETER_RATE_HZ = 50.0
BAROMETER_RATE_HZ = 10.0
# Pressure at the start, and the height over which it falls by a factor e in air of 15 degrees Celsius.
GROUND_HPA, SCALE_HEIGHT_M = 1013.25, 8435.0
# East, north, up: about the magnetic field of central Europe. North is magnetic north.
MAGNETIC_FIELD_UT = (0.0, 20.0, -44.0)
# Standard deviation of the direction of a leg about the axis of its building. Legs between surveyed points at least 5 m
# apart deviate by 2.2 (humolire), 4.0 (ipin2023), 3.8 (ipin21) and 6.3 degrees (ms_indoor). Legs that deviate by more
# than 15 degrees follow no axis and are not counted.
LEG_STD_RAD = np.radians(4.0)


def phone_motion(
    legs: Sequence[Leg],
    gait: Gait | None = None,
    carrying_mode: str = "texting",
    *,
    seed: int = 0,
    start_heading_rad: float = 0.0,
    carrying: Mapping[str, Carrying] | None = None,
) -> Motion:
    """Return the exact motion of the phone and the body on a simulated walk.

    With the same arguments, `simulate` records this motion with sensor errors.

    Parameters
    ----------
    legs, gait, carrying_mode, seed, start_heading_rad, carrying : as in `simulate`
        Stretches of the walk, person, carrying mode, seed, heading at the start, and place of the phone by mode.

    Returns
    -------
    Motion
        Position, attitude, specific force and angular rate of the phone at any time, and position and heading of the
        body.

    Raises
    ------
    ValueError
        If there are no legs, or if a carrying mode is not in `carrying`.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.simulate import Leg, phone_motion
    >>> motion = phone_motion([Leg("stationary", duration_s=2.0)])
    >>> motion.position_m(np.array([1.0])).shape
    (1, 3)
    """
    if not legs:
        raise ValueError('legs is empty: give at least one leg, such as Leg("walking", distance_m=20.0)')
    gait = gait or Gait()
    places = _places(legs, carrying_mode, CARRYING if carrying is None else carrying)
    plan_seed, motion_seed, _ = np.random.SeedSequence(seed).spawn(3)
    plan = plan_steps(legs, gait, np.random.default_rng(plan_seed))
    return build_motion(legs, places, gait, plan, np.random.default_rng(motion_seed), start_heading_rad)


def simulate(
    legs: Sequence[Leg],
    gait: Gait | None = None,
    carrying_mode: str = "texting",
    *,
    rate_hz: float = 100.0,
    errors: SensorErrors | None = None,
    seed: int = 0,
    start_heading_rad: float = 0.0,
    name: str = "simulated_walk",
    carrying: Mapping[str, Carrying] | None = None,
) -> Recording:
    """Return the recording of a simulated walk, with accelerometer, gyroscope, magnetometer and exact ground truth.

    The recording also has pressure if `errors.barometer` is given.

    Parameters
    ----------
    legs : sequence of Leg
        Stretches of the walk, which starts at east 0, north 0.
    gait : Gait, optional
        Person who walks. By default a typical person.
    carrying_mode : {"texting", "pocket", "swinging", "calling"}, default "texting"
        Carrying mode until a leg changes it.
    rate_hz : float, default 100.0
        Sampling rate of accelerometer and gyroscope in Hz, from 20 to 500.
    errors : SensorErrors, optional
        Errors of the sensors. The default are the errors of a typical phone.
    seed : int, default 0
        Seed of all random numbers. Equal seeds give equal recordings. The walk does not depend on `errors` and
        `rate_hz`.
    start_heading_rad : float, default 0.0
        Heading at the start in rad, clockwise from north.
    name : str, default "simulated_walk"
        Name of the recording.
    carrying : mapping of str to Carrying, optional
        Place and attitude of the phone in each carrying mode, for persons with their own way of carrying it. By default
        the typical ones (`motion.CARRYING`).

    Returns
    -------
    Recording
        Recording with ground truth. `position` is the position of the person (east, north, height of the ground), not
        of the phone. `steps` are the foot contacts. `strides`, `segments` and `labels` follow the legs. `waypoints` are
        the start and the ends of the legs.

    Raises
    ------
    ValueError
        If the rate is out of range, if there are no legs, or if a carrying mode is not in `carrying`.

    Examples
    --------
    >>> from pdr_filter.simulate import Gait, Leg, simulate
    >>> legs = [Leg("stationary", duration_s=3.0), *(Leg("walking", distance_m=d, turn_rad=1.57) for d in (20.0, 10.0))]
    >>> walk = simulate(legs, Gait(height_m=1.8), "pocket", seed=1)
    >>> walk.truth.segments.distance_m.round(1)
    array([ 0., 20., 10.])
    """
    if not 20.0 <= rate_hz <= 500.0:
        raise ValueError(f"rate_hz must be from 20 to 500, got {rate_hz}: steps need 20 Hz, phones sample up to 500 Hz")
    gait = gait or Gait()
    motion = phone_motion(legs, gait, carrying_mode, seed=seed, start_heading_rad=start_heading_rad, carrying=carrying)
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(3)[2])
    return Recording(
        name,
        *_streams(motion, rate_hz, errors or SensorErrors(), rng),
        truth=_truth(motion, legs, carrying_mode),
        meta=_meta(name, gait, carrying_mode, rate_hz, seed),
        source="simulated",
    )


def demo_walk(seed: int = 0) -> Recording:
    """Return a simulated walk of two minutes through all contexts that the shipped models recognise.

    A random person (`Gait.random`) carries a random phone (`SensorErrors.random`) in the pocket. The walk is a loop of
    138 m: along two corridors, up to the next storey, back along it with the last metres running, down again, and
    towards the start. The corridors are at right angles, and each leg deviates from its corridor by a random angle.

    Parameters
    ----------
    seed : int, default 0
        Seed of person, phone and walk. Equal seeds give equal recordings.

    Returns
    -------
    Recording
        Recording with exact ground truth.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()
    >>> walk.name, round(walk.duration_s), round(float(walk.truth.segments.distance_m.sum()))
    ('demo_walk', 120, 138)
    """
    legs, errors = demo_legs(seed), SensorErrors.random(seed)
    return simulate(legs, Gait.random(seed), "pocket", errors=errors, seed=seed, name="demo_walk")


def demo_legs(seed: int) -> list[Leg]:
    """Return the legs of the demonstration walk, whose directions deviate from the axes of the building."""
    right = np.pi / 2
    legs = [
        Leg("stationary", duration_s=5.0),
        Leg("walking", distance_m=30.0),
        Leg("walking", distance_m=34.0, turn_rad=right),
        Leg("upstairs", distance_m=5.22),
        Leg("walking", distance_m=16.0, turn_rad=right),
        Leg("stationary", duration_s=4.0),
        Leg("walking", distance_m=20.0, turn_rad=right),
        Leg("running", distance_m=14.0),
        Leg("downstairs", distance_m=5.22),
        Leg("walking", distance_m=14.0, turn_rad=-right),
        Leg("stationary", duration_s=5.0),
    ]
    # Each leg has its own deviation from its axis, so a corner also undoes the deviation of the leg before.
    rng, deviation_rad = np.random.default_rng([seed, 1]), 0.0
    for k, leg in enumerate(legs):
        if leg.turn_rad:
            before_rad, deviation_rad = deviation_rad, LEG_STD_RAD * float(rng.standard_normal())
            legs[k] = replace(leg, turn_rad=leg.turn_rad + deviation_rad - before_rad)
    return legs


def _places(legs: Sequence[Leg], carrying_mode: str, places: Mapping[str, Carrying]) -> list[tuple[str, Carrying]]:
    """Return carrying mode and place of the phone for each leg. ValueError for a carrying mode without a place."""
    found: list[tuple[str, Carrying]] = []
    for leg in legs:
        carrying_mode = leg.carrying_mode or carrying_mode
        if carrying_mode not in places:
            raise ValueError(
                f"carrying_mode must be one of {', '.join(places)}, got {carrying_mode!r}: give its place in the "
                "argument carrying"
            )
        found.append((carrying_mode, places[carrying_mode]))
    return found


def _streams(
    motion: Motion, rate_hz: float, errors: SensorErrors, rng: np.random.Generator
) -> tuple[Samples, Samples, Samples, Samples | None]:
    """Return accelerometer, gyroscope, magnetometer and barometer samples, if any, each with its own clock."""
    end_s = float(motion.plan.leg_end_s[-1])

    def clock(rate: float, start_s: float) -> FloatArray:
        return start_s + np.arange(int(np.floor((end_s - start_s) * rate + 1e-9)) + 1) / rate

    accelerometer_s = clock(rate_hz, 0.0)
    gyroscope_s = clock(rate_hz, 0.3 / rate_hz)
    magnetometer_s = clock(MAGNETOMETER_RATE_HZ, -0.004)
    field = np.tile(MAGNETIC_FIELD_UT, (len(magnetometer_s), 1))
    seen_field = motion.rotation(magnetometer_s).inv().apply(field)
    exact = {
        "accelerometer": (accelerometer_s, motion.specific_force_mps2(accelerometer_s), rate_hz, errors.accelerometer),
        "gyroscope": (gyroscope_s, motion.angular_rate_radps(gyroscope_s), rate_hz, errors.gyroscope),
        "magnetometer": (magnetometer_s, seen_field, MAGNETOMETER_RATE_HZ, errors.magnetometer),
    }
    if errors.barometer is not None:
        barometer_s = clock(BAROMETER_RATE_HZ, 0.02)
        pressure = GROUND_HPA * np.exp(-motion.position_m(barometer_s)[:, 2:] / SCALE_HEIGHT_M)
        exact["barometer"] = barometer_s, pressure, BAROMETER_RATE_HZ, errors.barometer
    streams: dict[str, Samples] = {}
    for name, (time_s, values, rate, error) in exact.items():
        jitter_s = errors.jitter_s * rng.standard_normal(len(time_s))
        if not streams:
            jitter_s[0] = 0.0  # the first accelerometer sample is the origin of time
        streams[name] = Samples(time_s + jitter_s, error.apply(values, rate, rng))
    return streams["accelerometer"], streams["gyroscope"], streams["magnetometer"], streams.get("barometer")


def _truth(motion: Motion, legs: Sequence[Leg], carrying_mode: str) -> Truth:
    """Return the ground truth tables: position, waypoints, steps, strides, segments and labels."""
    plan = motion.plan
    modes = [carrying_mode := leg.carrying_mode or carrying_mode for leg in legs]
    step_of_leg = [plan.leg == k for k in range(len(legs))]
    end_s = float(plan.leg_end_s[-1])
    position_s = np.append(np.arange(0.0, end_s, 0.02), end_s)
    position = motion.body_at(position_s)
    corner_s = np.append(0.0, plan.leg_end_s)
    corner = motion.body_at(corner_s)
    pair = plan.leg[1:] == plan.leg[:-1]
    return Truth(
        position=table({"time_s": position_s} | dict(zip(("east_m", "north_m", "up_m"), position.T, strict=True))),
        waypoints=table(
            {
                "time_s": corner_s,
                "east_m": corner[:, 0],
                "north_m": corner[:, 1],
                "floor": np.round(corner[:, 2] / STOREY_HEIGHT_M).astype(np.int64),
            }
        ),
        steps=table({"time_s": plan.contact_s}),
        strides=table(  # two consecutive steps of one leg, between two contacts of the same foot
            {
                "start_s": plan.start_s[:-1][pair],
                "end_s": plan.contact_s[1:][pair],
                "length_m": (plan.length_m[:-1] + plan.length_m[1:])[pair],
            }
        ),
        segments=table(
            {
                "start_s": plan.leg_start_s,
                "end_s": plan.leg_end_s,
                "distance_m": np.array([plan.length_m[own].sum() for own in step_of_leg]),
                "n_steps": np.array([own.sum() for own in step_of_leg], dtype=np.int64),
            }
        ),
        labels=table(
            {
                "start_s": plan.leg_start_s,
                "end_s": plan.leg_end_s,
                "context": np.array([leg.context for leg in legs]),
                "carrying_mode": np.array(modes),
            }
        ),
    )


def _meta(name: str, gait: Gait, carrying_mode: str, rate_hz: float, seed: int) -> dict[str, Any]:
    """Return the metadata, which state clearly that the walk is simulated."""
    return {
        "name": name,
        "dataset": "simulated",
        "licence": "MIT",
        "attribution": "pdr_filter.simulate",
        "subject": {"id": "simulated", "height_m": gait.height_m, "weight_kg": None, "age": None, "gender": None},
        "device": "simulated phone",
        "placement": carrying_mode,
        "nominal_rate_hz": rate_hz,
        "truth": "exact",
        "notes": f"Simulated walk without a real person, seed {seed}.",
    }
