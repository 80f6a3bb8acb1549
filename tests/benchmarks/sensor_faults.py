"""Sensors that are missing, stop, stick, begin late, are noisy or rounded, or have a late clock: errors and notes.

usage: python -m tests.benchmarks.sensor_faults [--walks 4] [--print]

Simulated walks over three storeys, of people whose step lengths and cadences vary more than the filter expects, in four
carrying modes.

Each sensor is judged where it matters. Accelerometer, gyroscope and barometer are judged without locations and with a
known start, the magnetometer with `north="magnetic"`, and locations with all other sensors.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import repeat
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.simulate import BAROMETER, Gait, Leg, SensorErrors, simulate
from pdr_filter.simulate.gait import STOREY_HEIGHT_M
from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray, Samples
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, run

CARRYING_MODES = ("texting", "pocket", "swinging", "calling")
HERE = pdr.Origin(49.461222, 11.111590)  # place of ipin2023, and origin of the simulated locations
LOCATION_STD_M, LOCATION_EVERY_S = 3.0, 5.0
# White noise of ten times the noise of a phone at 100 Hz (barometer: 10 Hz), and a resolution a hundred times coarser.
# Locations: metres of noise and degrees of resolution, 11 m.
NOISE = {"accelerometer": 0.07, "gyroscope": 0.005, "magnetometer": 5.0, "barometer": 0.2, "location": 30.0}
RESOLUTION = {"accelerometer": 0.5, "gyroscope": 0.05, "magnetometer": 5.0, "barometer": 1.0, "location": 1e-4}
# Words of a note that show that it is about the sensor.
WORDS = {
    "accelerometer": ("accelerometer",),
    "gyroscope": ("gyroscope: ", "of the gyroscope", "no gyroscope", "angular rate for"),
    "magnetometer": ("magnetometer",),
    "barometer": ("barometer", "pressure"),
    "location": ("location", "fixes"),
}
UNIT = {"accelerometer": "m/s2", "gyroscope": "rad/s", "magnetometer": "uT", "barometer": "hPa", "location": "degrees"}


# --- faults -----------------------------------------------------------------------------------------------------------

Fault = Callable[[str, Samples], Samples | None]


def _part(samples: Samples, keep: Any) -> Samples:
    return Samples(samples.time_s[keep], samples.values[keep])


def _half_s(samples: Samples) -> float:
    return 0.5 * float(samples.time_s[0] + samples.time_s[-1])


def stuck(name: str, samples: Samples) -> Samples:
    """All values of the second half equal the first of them."""
    half = int(np.searchsorted(samples.time_s, _half_s(samples)))
    return Samples(
        samples.time_s,
        np.vstack([samples.values[:half], np.tile(samples.values[half], (len(samples.time_s) - half, 1))]),
    )


def noisy(name: str, samples: Samples) -> Samples:
    """White noise on all axes."""
    std, values = NOISE[name] * np.ones(samples.values.shape[1]), samples.values
    if name == "location":
        metres = np.radians(1.0) * 6371e3
        std = std[0] * np.array([1 / metres, 1 / (metres * np.cos(np.radians(HERE.latitude_deg))), 0.0, 0.0])
    return Samples(samples.time_s, values + np.random.default_rng(0).normal(size=values.shape) * std)


def rounded(name: str, samples: Samples) -> Samples:
    """Coarse values."""
    columns = slice(0, 2) if name == "location" else slice(None)
    values = samples.values.copy()
    values[:, columns] = np.round(values[:, columns] / RESOLUTION[name]) * RESOLUTION[name]
    return Samples(samples.time_s, values)


FAULTS: dict[str, Fault] = {
    "missing": lambda name, s: None,
    "stops half-way": lambda name, s: _part(s, s.time_s < _half_s(s)),
    "begins half-way": lambda name, s: _part(s, s.time_s >= _half_s(s)),
    "stuck from half-way": stuck,
    "begins 1 s late": lambda name, s: _part(s, s.time_s >= s.time_s[0] + 1.0),
    "begins 10 s late": lambda name, s: _part(s, s.time_s >= s.time_s[0] + 10.0),
    "clock 1 s late": lambda name, s: Samples(s.time_s + 1.0, s.values),
    "clock 10 s late": lambda name, s: Samples(s.time_s + 10.0, s.values),
    "noisy": noisy,
    "rounded": rounded,
}


def with_fault(recording: Recording, sensor: str, fault: str) -> Recording:
    """Return the recording with a fault of one sensor."""
    return replace(recording, **{sensor: FAULTS[fault](sensor, recording.streams[sensor])})


def name_of(sensor: str, fault: str) -> str:
    """Return the sensor and its fault with the size of the fault."""
    size = {"noisy": NOISE, "rounded": RESOLUTION}.get(fault, {}).get(sensor)
    unit = "m" if (sensor, fault) == ("location", "noisy") else UNIT[sensor]
    return f"{sensor}: {fault}" + (f", {size:g} {unit}" if size else "")


# --- walks ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording with its true positions and heights."""

    recording: Recording
    time_s: FloatArray  # (N,)
    place_m: FloatArray  # (N, 2) from the start
    height_m: FloatArray  # (N,) above the start
    floor: FloatArray  # (N,) from the start, NaN on stairs
    distance_m: float
    start_heading_rad: float

    def options(self, sensor: str) -> dict[str, Any]:
        """Return the arguments of `track` with which a sensor is judged."""
        if sensor == "location":
            return {"gnss": "filter"}
        if sensor == "magnetometer":
            return {"north": "magnetic", "gnss": "off"}
        return {"heading_rad": self.start_heading_rad}


def simulated_walk(seed: int, carrying_mode: str | None = None, legs: Sequence[Leg] | None = None) -> Walk:
    """Return a walk up two storeys and down one."""
    rng, right = np.random.default_rng(seed), np.pi / 2
    gait = Gait(
        height_m=rng.uniform(1.5, 2.0),
        length_factor=rng.uniform(0.85, 1.15),
        frequency_factor=rng.uniform(0.88, 1.12),
        habit=seed,
    )
    up, down = Leg("upstairs", distance_m=5.22), Leg("downstairs", distance_m=5.22)
    legs = legs or [
        Leg("stationary", duration_s=5.0),
        Leg("walking", distance_m=30.0),
        Leg("walking", distance_m=20.0, turn_rad=right),
        up,
        Leg("walking", distance_m=20.0, turn_rad=right),
        Leg("stationary", duration_s=4.0),
        Leg("walking", distance_m=25.0, turn_rad=-right),
        up,
        Leg("walking", distance_m=25.0, turn_rad=-right),
        down,
        Leg("walking", distance_m=20.0, turn_rad=right),
        Leg("stationary", duration_s=4.0),
    ]
    heading_rad = float(rng.uniform(0.0, 2 * np.pi))
    walk = simulate(
        legs,
        gait,
        carrying_mode or CARRYING_MODES[seed % 4],
        errors=SensorErrors(barometer=BAROMETER),
        seed=seed,
        start_heading_rad=heading_rad,
    )
    truth = walk.truth.position[::25]
    place_m = np.column_stack([truth.east_m, truth.north_m])
    at_s = np.arange(1.0, walk.duration_s, LOCATION_EVERY_S)
    found_m = evaluate.positions_at(truth.time_s, place_m, at_s) + rng.normal(0, LOCATION_STD_M, (len(at_s), 2))
    latitude_deg, longitude_deg = HERE.latitude_longitude_deg(found_m)
    location = np.column_stack(
        [latitude_deg, longitude_deg, np.full(len(at_s), np.nan), np.full(len(at_s), 1.5 * LOCATION_STD_M)]
    )
    storeys = truth.up_m / STOREY_HEIGHT_M
    return Walk(
        replace(walk, location=Samples(at_s, location)),
        truth.time_s,
        place_m,
        truth.up_m,
        np.where(np.abs(storeys - np.round(storeys)) < 0.02, np.round(storeys), np.nan),
        float(walk.truth.segments.distance_m.sum()),
        heading_rad,
    )


# --- figures ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Figures:
    """Errors of one track."""

    distance_percent: float
    end_m: float
    end_std_m: float
    direction_deg: float
    height_m: float
    height_std_m: float
    floor_right: float
    notes: tuple[str, ...]
    nees: float = np.nan


def figures(walk: Walk, track: Track, without: Track, sensor: str) -> Figures:
    """Return the errors of a track; `without` is the track without the fault."""
    if track.n_steps < 2:
        return Figures(-100.0, *(6 * [np.nan]), track.notes)
    found_m, cov = (
        evaluate.positions_at(track.time_s, track.position_m, walk.time_s, track.start_position_m),
        track.position_cov_m2[-1],
    )
    if sensor == "location" and track.origin is not None:
        found_m += HERE.east_north_m(track.origin.latitude_deg, track.origin.longitude_deg)
    error_m = found_m[-1] - walk.place_m[-1]
    late = walk.time_s[1:] > walk.time_s.mean()
    moved, truly = (np.diff(m, axis=0)[late] @ [1, 1j] for m in (found_m, walk.place_m))
    k = np.clip(np.searchsorted(track.time_s, walk.time_s, side="right") - 1, 0, track.n_steps - 1)
    level = np.isfinite(walk.floor)
    return Figures(
        100 * (track.distance_m / walk.distance_m - 1),
        float(np.linalg.norm(error_m)),
        float(track.position_std_m[-1]),
        float(np.degrees(np.angle(np.vdot(truly, moved)))),
        float(track.height_m[k[-1]] - walk.height_m[-1]),
        float(track.height_std_m[k[-1]]),
        float(np.mean(track.floor[k][level] == walk.floor[level])),
        tuple(note for note in track.notes if note not in without.notes),
        float(error_m @ np.linalg.solve(cov, error_m)),
    )


def smoothed(recording: Recording, **options: Any) -> Track:
    """Return the smoothed track."""
    return pdr.smooth(recording, **options).track


def cells(walks: Sequence[Walk], sensor: str, fault: str) -> list[object]:
    """Return the cells of a row: medians over the walks, and the first note on the sensor that the fault causes."""
    online: list[Figures] = []
    later: list[Figures] = []
    refusal = ""
    for walk in walks:
        recording = walk.recording if fault == "no fault" else with_fault(walk.recording, sensor, fault)
        for of, found in ((pdr.track, online), (smoothed, later)):
            try:
                found.append(figures(walk, of(recording, **walk.options(sensor)), without(walk, sensor, of), sensor))
            except ValueError as error:
                refusal = str(error)
    if refusal:
        return [*(8 * ["-"]), f"refused: {refusal}"]

    def median(found: Sequence[Figures], name: str, digits: int = 1) -> str:
        return f"{np.nanmedian([abs(getattr(f, name)) for f in found]):.{digits}f}"

    def end(found: Sequence[Figures]) -> str:
        outside = sum(not f.nees < 11.8 for f in found)  # 99.7 % quantile of chi-square with two degrees of freedom
        return f"{median(found, 'end_m')} ({median(found, 'end_std_m')})" + (f", {outside} outside" if outside else "")

    too_high = sum(not abs(f.height_m) < 3.0 * f.height_std_m for f in online)
    height = f"{median(online, 'height_m')} ({median(online, 'height_std_m')})"
    height += f", {too_high} outside" if too_high else ""
    new = [note for f in online for note in f.notes]
    notes = [note for note in new if any(word in note for word in WORDS[sensor])]
    n_named = sum(any(word in note for note in f.notes for word in WORDS[sensor]) for f in online)
    note = f"{notes[0][:80]}... ({n_named} of {len(walks)})" if notes else "-"
    return [
        median(online, "distance_percent"),
        median(later, "distance_percent"),
        end(online),
        end(later),
        median(online, "direction_deg", 0),
        median(later, "direction_deg", 0),
        height,
        f"{100 * np.mean([f.floor_right for f in online]):.0f}",
        note,
    ]


@cache
def without(walk: Walk, sensor: str, of: Callable[..., Track]) -> Track:
    """Return the track of a walk without a fault."""
    return of(walk.recording, **walk.options(sensor))


def rows_of_sensor(walks: Sequence[Walk], sensor: str) -> list[list[object]]:
    """Return the rows of one sensor."""
    # no recording is without an accelerometer
    faults = [f for f in ("no fault", *FAULTS) if (sensor, f) != ("accelerometer", "missing")]
    return [[name_of(sensor, fault), *cells(walks, sensor, fault)] for fault in faults]


def simulated(tables: Tables, arguments: argparse.Namespace) -> None:
    """One row for each sensor and fault; a process for each sensor."""
    walks = [simulated_walk(seed) for seed in range(arguments.walks)]
    with ProcessPoolExecutor(len(NOISE)) as pool:
        rows = [row for rows in pool.map(rows_of_sensor, repeat(walks), NOISE) for row in rows]
    columns = "sensor and fault | distance, % | smoothed | end, m (stated) | smoothed | direction, degrees | "
    columns += "smoothed | height, m (stated) | storey right, % | first note on it"
    about = f"{arguments.walks} simulated walks: medians of absolute errors; outside are more than three deviations."
    tables.write("sensor_faults_simulated", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, simulated, walks=4)
