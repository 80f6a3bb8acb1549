"""Heights and storeys: recordings with a barometer, simulated stairs, lifts and escalators.

usage: python -m tests.benchmarks.floors [recordings] [simulated] [--data ../shared/data]

Noise and drift of the air are those of the one recording on a single storey (ipin21), all else comes from building
codes and data sheets; the order of what is done was found on the one staircase that there is (ipin2023). Time counts
between two waypoints of one storey, where nobody was on stairs; storeys and heights are those from the first waypoint
on. Heights of ipin2023 are its own barometer's, good to 0.3 m.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import pdr_filter as pdr
from pdr_filter.recipes import for_recording
from pdr_filter.simulate import BAROMETER, Gait, Leg, SensorErrors, simulate
from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray, Samples
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, run
from tests.benchmarks.common import recordings as recordings_of

AROUND = (Leg("walking", distance_m=15.0), Leg("walking", distance_m=15.0, turn_rad=np.pi / 2))
REST = Leg("stationary", duration_s=4.0)


def _flights(context: str) -> list[Leg]:
    flight = Leg(context, distance_m=9 * 0.29)
    return [flight, Leg("walking", distance_m=2.0, turn_rad=np.pi), flight]


def _ride(up_m: float, seconds: float, along_m: float = 0.0) -> list[Leg]:
    return [REST, Leg("stationary", duration_s=seconds, ride_up_m=up_m, ride_m=along_m), REST]


WALKS: dict[str, list[Leg]] = {
    "one storey": [REST, *AROUND, *AROUND, REST, *AROUND, *AROUND],
    "stairs": [REST, *AROUND, *_flights("upstairs"), *AROUND, *_flights("downstairs"), *AROUND],
    "a lift, three storeys": [REST, *AROUND, *_ride(9.9, 11.0), *AROUND, *_ride(-9.9, 11.0), *AROUND],
    "an escalator": [REST, *AROUND, *_ride(4.0, 13.0, 7.0), *AROUND, *_ride(-4.0, 13.0, 7.0), *AROUND],
}
STOREYS = {"one storey": 0, "stairs": 1, "a lift, three storeys": 3, "an escalator": 1}


def _as_it_is(recording: Recording) -> Recording:
    return recording


def without_barometer(recording: Recording) -> Recording:
    """The same from a phone without one."""
    return replace(recording, barometer=None)


def with_door(recording: Recording) -> Recording:
    """The same, with a door that closes at 15 s, on the first corridor, and stays so: 0.3 hPa."""
    assert recording.barometer is not None
    time_s, pressure = recording.barometer.time_s, recording.barometer.values
    return replace(recording, barometer=Samples(time_s, pressure + 0.3 * (time_s > 15.0)[:, None]))


def coarse(recording: Recording) -> Recording:
    """The same with pressure at 1 Hz in steps of 0.1 hPa."""
    assert recording.barometer is not None
    return replace(
        recording,
        barometer=Samples(recording.barometer.time_s[::10], np.round(recording.barometer.values[::10], 1)),
    )


def floor_at(track: Track, time_s: FloatArray) -> FloatArray:
    """The storey of the last step at or before each time."""
    return track.floor[np.clip(np.searchsorted(track.time_s, time_s, side="right") - 1, 0, None)].astype(float)


def _of_recording(recording: Recording) -> list[str]:
    points, track = recording.truth.waypoints, pdr.track(recording, for_recording("default", recording), gnss="off")
    assert points is not None
    time_s, floor = np.asarray(points.time_s), np.asarray(points.floor, dtype=float)
    names = points.dtype.names or ()
    known = recording.meta["floor_heights_m"]
    up_m = np.asarray(points.up_m) if "up_m" in names else np.array([known[str(int(f))] for f in floor])
    on_one = [(a, b, f) for a, b, f, g in zip(time_s, time_s[1:], floor, floor[1:], strict=False) if f == g]
    stays = [np.arange(a, b, 0.2) for a, b, _ in on_one]
    truth = np.concatenate([np.full(len(s), f) for s, (_, _, f) in zip(stays, on_one, strict=True)])
    off = floor_at(track, time_s[:1]) - floor[0]
    right = floor_at(track, np.concatenate(stays)) - off == truth
    at_points = floor_at(track, time_s) - off == floor
    height_m, std_m = (np.interp(time_s, track.time_s, v) for v in (track.height_m, track.height_std_m))
    error_m = (height_m - height_m[0] - up_m + up_m[0])[1:]
    ways = [c.how for c in track.floor_changes()]
    return [
        f"{100 * right.mean():.1f} % of {0.2 * len(right):.0f} s, {at_points.sum()} of {len(at_points)}",
        f"{len(ways)} ({', '.join(sorted(set(ways))) or '-'}), {int((np.diff(floor) != 0).sum())}",
        f"{np.sqrt((error_m**2).mean()):.2f}, {np.abs(error_m).max():.2f}",
        f"{std_m[1:].mean():.2f}, {np.mean((error_m / std_m[1:]) ** 2):.2f}",
    ]


def recordings(tables: Tables, arguments: argparse.Namespace) -> None:
    """Storeys and heights at the waypoints, with the barometer and without."""
    data = [r for site in ("ipin2023", "ipin21") for r in recordings_of(arguments.data, site)]
    rows = [
        [name, has, *_of_recording(change(recording))]
        for recording in data
        for name in (recording.name.split("_")[0],)
        for has, change in (("yes", _as_it_is), ("no", without_barometer))
    ]
    columns = "recording | barometer | right storey: time, waypoints | floor changes found, true | "
    columns += "height error (m): rms, largest | its standard deviation (m), normalised error squared"
    tables.write("floors_recordings", columns, rows, "Both phones are in the hand, where motion alone shows no stairs.")


def _of_walk(recording: Recording, n_storeys: int) -> tuple[bool, float, float, float, int]:
    """All changes right, share of steps on the right storey (not on stairs), rms, normalised error squared, changes."""
    track = pdr.track(recording)
    position, labels = recording.truth.position, recording.truth.labels
    assert position is not None and labels is not None
    up_m = np.interp(track.time_s, position.time_s, position.up_m)
    of_storeys = np.interp(up_m, [0.0, float(position.up_m.max()) or 1.0], [0.0, n_storeys])
    settled = np.abs(of_storeys - np.round(of_storeys)) < 0.02
    right = (track.floor == np.round(of_storeys))[settled].mean()
    error_m, std_m = track.height_m - up_m, track.height_std_m
    found = [(c.from_floor, c.to_floor) for c in track.floor_changes()]
    wanted = [(0, n_storeys), (n_storeys, 0)] if n_storeys else []
    nees = np.mean((error_m / np.maximum(std_m, 0.05)) ** 2)
    return found == wanted, float(right), float(np.sqrt((error_m**2).mean())), float(nees), len(found)


def simulated(tables: Tables, arguments: argparse.Namespace) -> None:
    """People with a phone in the hand and in the pocket, by what they climb and what the phone measures."""
    errors, rows, n = SensorErrors(barometer=BAROMETER), [], arguments.people
    kinds: dict[str, Callable[[Recording], Recording]] = {
        "10 Hz": _as_it_is,
        "a door": with_door,
        "1 Hz, 0.1 hPa": coarse,
        "none": without_barometer,
    }
    for name, legs in WALKS.items():
        for carrying_mode in ("texting", "pocket"):
            walks = [
                simulate(legs, Gait.random(k), carrying_mode, errors=errors, seed=k, name=f"{name} {k}")
                for k in range(n)
            ]
            for pressure, change in kinds.items():
                if pressure == "none" and (name, carrying_mode) not in (("one storey", "pocket"), ("stairs", "pocket")):
                    continue  # nothing measures what is climbed there
                of_walks = [_of_walk(change(walk), STOREYS[name]) for walk in walks]
                well, right, rms_m, nees, n_changes = np.array(of_walks, dtype=float).T
                cells = [f"{int(well.sum())} of {n}", f"{int(n_changes.sum())}", f"{100 * right.mean():.1f} %"]
                cells += [f"{np.sqrt((rms_m**2).mean()):.2f}", f"{nees.mean():.1f}"]
                rows.append([name, carrying_mode, pressure, *cells])
    columns = "walk | phone | barometer | walks with all changes right | changes | steps on the right storey | "
    columns += "height error (m, rms) | normalised error squared"
    about = f"{n} simulated people for each line; steps on stairs do not count for the storey."
    tables.write("floors_simulated", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, recordings, simulated, people=10)
