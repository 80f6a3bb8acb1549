"""A walk along legs as a recording, with exact truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from pdr_filter.simulate.gait import STOREY_HEIGHT_M, Gait, Leg, plan_steps
from pdr_filter.simulate.motion import CARRYING, Carrying, Motion, build_motion
from pdr_filter.simulate.sensors import SensorErrors
from pdr_filter.values import FloatArray, Samples, table
from pdr_filter.values.recording import Recording, Truth

MAGNETOMETER_RATE_HZ = 50.0
BAROMETER_RATE_HZ = 10.0
# The pressure falls by a factor e over 8435 m of air of 15 degrees.
GROUND_HPA, SCALE_HEIGHT_M = 1013.25, 8435.0
# East, north, up; about that of central Europe, north being magnetic north.
MAGNETIC_FIELD_UT = (0.0, 20.0, -44.0)


def phone_motion(
    legs: Sequence[Leg],
    gait: Gait | None = None,
    carrying_mode: str = "texting",
    *,
    seed: int = 0,
    start_heading_rad: float = 0.0,
    carrying: Mapping[str, Carrying] | None = None,
) -> Motion:
    """Exact motion behind `simulate` with the same arguments: position, attitude, specific force at any time."""
    if not legs:
        raise ValueError("a walk needs at least one leg, got none")
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
    """Recording of a walk along the legs, with accelerometer, gyroscope, magnetometer and exact truth.

    With `errors.barometer` it has the pressure, too.

    Parameters
    ----------
    legs : sequence of Leg
        The walk, starting at east 0, north 0.
    gait : Gait, optional
        The person; a typical one if not given.
    carrying_mode : {"texting", "pocket", "swinging", "calling"}
        Where the phone is until a leg says otherwise.
    rate_hz : float
        Of accelerometer and gyroscope.
    errors : SensorErrors, optional
        A typical phone's if not given.
    seed : int
        The same seed gives the same recording; the walk does not depend on `errors` and `rate_hz`.
    start_heading_rad : float
        Clockwise from north.
    carrying : mapping of str to Carrying, optional
        Where the phone is in each carrying mode, for persons who carry it in their own way; the typical places
        `motion.CARRYING` if not given.

    Returns
    -------
    Recording
        Truth: `position` is the person (east, north, height of the ground), not the phone; `steps` are the foot
        contacts; `strides`, `segments` and `labels` follow the legs; `waypoints` are the start and the ends of legs.

    Examples
    --------
    >>> from pdr_filter.simulate import Gait, Leg, simulate
    >>> legs = [Leg("stationary", duration_s=3.0), *(Leg("walking", distance_m=d, turn_rad=1.57) for d in (20.0, 10.0))]
    >>> walk = simulate(legs, Gait(height_m=1.8), "pocket", seed=1)
    >>> walk.truth.segments.distance_m.round(1)
    array([ 0., 20., 10.])
    """
    if not 20.0 <= rate_hz <= 500.0:
        raise ValueError(f"rate_hz must be from 20 to 500, got {rate_hz}: steps need 20 Hz, phones give up to 500 Hz")
    gait = gait or Gait()
    motion = phone_motion(legs, gait, carrying_mode, seed=seed, start_heading_rad=start_heading_rad, carrying=carrying)
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(3)[2])
    accelerometer, gyroscope, magnetometer, barometer = _streams(motion, rate_hz, errors or SensorErrors(), rng)
    return Recording(
        name=name,
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        magnetometer=magnetometer,
        barometer=barometer,
        truth=_truth(motion, legs, carrying_mode),
        meta=_meta(name, gait, carrying_mode, rate_hz, seed),
        source="simulated",
    )


def demo_walk(seed: int = 0) -> Recording:
    """Two minutes through all contexts that the models know, phone in the pocket.

    A loop of 138 m: along two corridors, up to the next storey, back there, the last metres running, down and towards
    start.
    """
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
    return simulate(legs, Gait(height_m=1.86), "pocket", seed=seed, name="demo_walk")


def _places(legs: Sequence[Leg], carrying_mode: str, places: Mapping[str, Carrying]) -> list[tuple[str, Carrying]]:
    """Carrying mode of each leg, and where the phone is then."""
    found: list[tuple[str, Carrying]] = []
    for leg in legs:
        carrying_mode = leg.carrying_mode or carrying_mode
        if carrying_mode not in places:
            raise ValueError(f"carrying_mode must be one of {', '.join(places)}, got {carrying_mode!r}")
        found.append((carrying_mode, places[carrying_mode]))
    return found


def _streams(
    motion: Motion, rate_hz: float, errors: SensorErrors, rng: np.random.Generator
) -> tuple[Samples, Samples, Samples, Samples | None]:
    """Accelerometer, gyroscope, magnetometer, barometer: every sensor has its own clock and begins at its own time."""
    end_s = float(motion.plan.leg_end_s[-1])

    def clock(rate: float, start_s: float) -> FloatArray:
        return start_s + np.arange(int(np.floor((end_s - start_s) * rate + 1e-9)) + 1) / rate

    accelerometer_s = clock(rate_hz, 0.0)
    gyroscope_s = clock(rate_hz, 0.3 / rate_hz)
    magnetometer_s = clock(MAGNETOMETER_RATE_HZ, -0.004)
    field = np.tile(MAGNETIC_FIELD_UT, (len(magnetometer_s), 1))
    exact = [
        (accelerometer_s, motion.specific_force_mps2(accelerometer_s), rate_hz, errors.accelerometer),
        (gyroscope_s, motion.angular_rate_radps(gyroscope_s), rate_hz, errors.gyroscope),
        (magnetometer_s, motion.rotation(magnetometer_s).inv().apply(field), MAGNETOMETER_RATE_HZ, errors.magnetometer),
    ]
    if errors.barometer is not None:
        barometer_s = clock(BAROMETER_RATE_HZ, 0.02)
        pressure = GROUND_HPA * np.exp(-motion.position_m(barometer_s)[:, 2:] / SCALE_HEIGHT_M)
        exact.append((barometer_s, pressure, BAROMETER_RATE_HZ, errors.barometer))
    streams: list[Samples] = []
    for time_s, values, rate, error in exact:
        jitter_s = errors.jitter_s * rng.standard_normal(len(time_s))
        if not streams:
            jitter_s[0] = 0.0  # the first accelerometer sample is the origin of time
        streams.append(Samples(time_s + jitter_s, error.apply(values, rate, rng)))
    accelerometer, gyroscope, magnetometer, *barometer = streams
    return accelerometer, gyroscope, magnetometer, barometer[0] if barometer else None


def _truth(motion: Motion, legs: Sequence[Leg], carrying_mode: str) -> Truth:
    """All truth tables."""
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
        strides=table(  # every two steps in a row of one leg: contact of a foot to the next contact of the same foot
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


def _meta(name: str, gait: Gait, carrying_mode: str, rate_hz: float, seed: int) -> MappingProxyType[str, Any]:
    """Meta data that leave no doubt that nobody walked."""
    return MappingProxyType(
        {
            "name": name,
            "dataset": "simulated",
            "licence": "MIT",
            "attribution": "pdr_filter.simulate",
            "subject": {"id": "simulated", "height_m": gait.height_m, "weight_kg": None, "age": None, "gender": None},
            "device": "simulated phone",
            "placement": carrying_mode,
            "nominal_rate_hz": rate_hz,
            "truth": "exact",
            "notes": f"Simulated, nobody walked this; seed {seed}.",
        }
    )
