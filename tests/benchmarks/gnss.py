"""Locations of a phone in the filter: simulated walks with errors that are alike for a while, and a surveyed walk.

usage: python -m tests.benchmarks.gnss [--data ../shared/data] [--walks 60]

Simulated: one location a second whose error has 5 m on each axis and the correlation exp(-t / T), 2 % outliers of 20 m
and a gap of 30 s; the phone claims the radius of 68 % of it. Walks of nine legs, in the hand, in a turned frame. The
figures are of steps from the fix that settled the turn on, or after the last location where these stop after a third.
ipin2023: indoors, the surveyed points of one walk, against the locations that the phone gave there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.gnss import RADIUS_68
from pdr_filter.io.recording import Recording
from pdr_filter.simulate import Leg, simulate
from pdr_filter.simulate.people import random_person
from tests.benchmarks.common import Tables, median_and, options, recordings

HERE, STD_M = pdr.Origin(48.137, 11.575), 5.0
SURVEYED = pdr.Origin(49.461222, 11.111590)  # first point of the walk, from the notes of its data set


def walked(number: int) -> tuple[Recording, np.ndarray]:
    """A walk of somebody, and its true positions in a turned frame."""
    rng = np.random.default_rng([17, number])
    gait, carrying = random_person("texting", number)
    legs = [Leg("walking", distance_m=rng.uniform(20, 60), turn_rad=rng.uniform(-1.6, 1.6)) for _ in range(9)]
    walk = simulate(legs, gait, carrying={"texting": carrying}, seed=number)
    truth, angle = walk.truth.position, rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return walk, np.column_stack([truth.east_m, truth.north_m]) @ turn.T


def located(walk: Recording, true_m: np.ndarray, correlation_s: float, seed: int, until_s: float) -> Recording:
    """With locations until some time."""
    rng, time_s = np.random.default_rng([seed, int(correlation_s)]), np.arange(1.0, walk.duration_s)
    error, r = rng.normal(scale=STD_M, size=(len(time_s), 2)), np.exp(-1.0 / correlation_s)
    for k in range(1, len(time_s)):
        error[k] = r * error[k - 1] + np.sqrt(1 - r**2) * error[k]
    error += 20.0 * (rng.random(len(time_s)) < 0.02)[:, None] * rng.normal(size=(len(time_s), 2))
    place_m = np.column_stack([np.interp(time_s, walk.truth.position.time_s, true_m[:, k]) for k in (0, 1)])
    rows = np.column_stack(
        [*HERE.latitude_longitude_deg(place_m + error), np.full((len(time_s), 2), STD_M * RADIUS_68)]
    )
    gap = walk.duration_s * rng.uniform(0.2, 0.7)
    use = (time_s <= until_s) & ~((time_s > gap) & (time_s < gap + 30.0))
    return replace(walk, location=pdr.Samples(time_s[use], rows[use]))


def errors(track: pdr.Track, walk: Recording, true_m: np.ndarray, from_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Error in m and squared error over its covariance of the steps from a time on."""
    at_m = np.column_stack([np.interp(track.time_s, walk.truth.position.time_s, true_m[:, k]) for k in (0, 1)])
    error = (HERE.east_north_m(track.latitude_deg, track.longitude_deg) - at_m)[track.time_s > from_s]
    cov = track.position_cov_m2[track.time_s > from_s]
    return np.linalg.norm(error, axis=1), np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov), error)


def simulated(correlation_s: float, share: float, walks: list[tuple[Recording, np.ndarray]]) -> list[str]:
    """A row: correlation, until when, error, share inside of ellipses, NIS."""
    found: list[tuple[np.ndarray, np.ndarray]] = []
    nis: list[float] = []
    for number, (walk, true_m) in enumerate(walks):
        until_s = share * walk.duration_s
        # the world is turned, and the magnetic field is not
        track = pdr.track(located(walk, true_m, correlation_s, number, until_s), north="off")
        turned_s = [fix.used_s for fix in track.fixes if fix.outcome in ("placed", "turned")]
        found.append(errors(track, walk, true_m, max(turned_s) if share == 1.0 else until_s))
        nis += [fix.nis for fix in track.fixes if fix.outcome == "used"]
    error_m, nees = (np.concatenate(each) for each in zip(*found, strict=True))
    inside = [f"{100 * np.mean(nees < chi2.ppf(p, 2)):.0f} %" for p in (0.5, 0.95)]
    ends = "all along" if share == 1.0 else "the first third"
    return [f"{correlation_s:.0f} s", ends, median_and(error_m, 95, 1), *inside, f"{np.mean(nis):.2f}"]


def surveyed(recording: Recording) -> list[list[str]]:
    """Rows of the walk with surveyed points: its locations, and the track with them."""
    points, location = recording.truth.waypoints, recording.location
    tracks = [("track", pdr.track(recording)), ("track without the magnetometer", pdr.track(recording, north="off"))]
    raw_m = SURVEYED.east_north_m(location.values[:, 0], location.values[:, 1])
    true_m = np.column_stack([points.east_m, points.north_m])
    rows: list[list[str]] = []
    ways = [("its locations", location.time_s, raw_m)]
    for name, track in tracks:
        ways.append((name, track.time_s, SURVEYED.east_north_m(track.latitude_deg, track.longitude_deg)))
    for name, time_s, way_m in ways:
        at_m = np.column_stack([np.interp(points.time_s, time_s, way_m[:, k]) for k in (0, 1)])
        rows.append([name, median_and(np.linalg.norm(at_m - true_m, axis=1), 100, 1)])
    alone = pdr.track(recording, gnss="off")
    at_m = evaluate.positions_at(alone.time_s, alone.position_m, points.time_s) - alone.position_m[0]
    first_m = np.array([np.interp(alone.time_s[0], location.time_s, raw_m[:, k]) for k in (0, 1)])
    rows.append(
        ["dead reckoning from its first location", median_and(np.linalg.norm(at_m + first_m - true_m, axis=1), 100, 1)]
    )
    return rows


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--walks", type=int, default=60)
    args = parser.parse_args()
    tables, walks = Tables.of(__spec__.name, args), [walked(k) for k in range(args.walks)]
    tables.write(
        "gnss_simulated",
        ["T", "locations", "error m: median, 95 %", "in 50 % ellipses", "in 95 % ellipses", "mean NIS"],
        [simulated(T, share, walks) for T in (10.0, 20.0, 60.0) for share in (1.0, 1 / 3)],
        f"{args.walks} walks.",
    )
    tables.write(
        "gnss_surveyed",
        ["ipin2023", "error m: median, largest"],
        [row for recording in recordings(args.data, "ipin2023") for row in surveyed(recording)],
    )


if __name__ == "__main__":
    main()
