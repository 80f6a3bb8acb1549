"""Locations of a phone in the filter: simulated walks with errors that are alike for a while, and real walks.

usage: python -m tests.benchmarks.gnss [--data ../shared/data] [--app-files ../shared/app_files] [--walks 200]

Simulated: one location a second whose error has 5 m on each axis and the correlation exp(-t / T), 2 % outliers of 20 m
and a gap of 30 s; the phone claims the radius of 68 % of it. Walks of nine legs, in the hand, in a turned frame, of
people whose steps differ more than the filter takes them to, every other phone with the errors of a BMI160. The figures
are of steps from the fix that settled the turn on, or after the last location where these stop after a third.
Afterwards: sudden changes, and how long they last.
Phones: the walk of a phone against its own locations, and the same with those of the first third alone.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

import pdr_filter as pdr
from models.training.simulated_people import random_person
from pdr_filter import evaluate
from pdr_filter.filter.fixes.gnss import CORRELATION_S, RADIUS_68
from pdr_filter.simulate import Leg, SensorErrors, simulate
from pdr_filter.values import interpolated_rows
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import DATA, HALF, MOST, Tables, median_and, places_of, run

HERE, STD_M = pdr.Origin(48.137, 11.575), 5.0
PHONES = {
    "Sensor Logger, Android": "sensor_logger/walk_with_gps_android_1_12.zip",
    "phyphox, 157 steps": "phyphox/157_steps",
}


@dataclass(frozen=True)
class Wrong:
    """Locations that are off together for a time."""

    begin_s: float
    end_s: float
    by_m: float


def walked(number: int) -> tuple[Recording, np.ndarray]:
    """A walk of somebody of unknown height, and its true positions in a turned frame."""
    rng = np.random.default_rng([17, number])
    gait, carrying = random_person("texting", number)
    legs = [Leg("walking", distance_m=rng.uniform(20, 60), turn_rad=rng.uniform(-1.6, 1.6)) for _ in range(9)]
    phone = SensorErrors() if number % 2 else SensorErrors.bmi160()
    walk = simulate(legs, gait, carrying={"texting": carrying}, errors=phone, seed=number)
    walk = replace(walk, meta={**walk.meta, "subject": {}})
    truth, angle = walk.truth.position, rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return walk, places_of(truth) @ turn.T


def located(
    walk: Recording, true_m: np.ndarray, correlation_s: float, seed: int, until_s: float, wrong: Wrong | None = None
) -> Recording:
    """With locations until some time, some of them wrong."""
    rng, time_s = np.random.default_rng([seed, int(correlation_s)]), np.arange(1.0, walk.duration_s)
    error, r = rng.normal(scale=STD_M, size=(len(time_s), 2)), np.exp(-1.0 / correlation_s)
    for k in range(1, len(time_s)):
        error[k] = r * error[k - 1] + np.sqrt(1 - r**2) * error[k]
    error += 20.0 * (rng.random(len(time_s)) < 0.02)[:, None] * rng.normal(size=(len(time_s), 2))
    if wrong is not None:
        error[(time_s > wrong.begin_s) & (time_s < wrong.end_s)] += [wrong.by_m, 0.0]
    place_m = interpolated_rows(time_s, walk.truth.position.time_s, true_m)
    rows = np.column_stack(
        [*HERE.latitude_longitude_deg(place_m + error), np.full((len(time_s), 2), STD_M * RADIUS_68)]
    )
    gap = walk.duration_s * rng.uniform(0.2, 0.7)
    use = (time_s <= until_s) & ~((time_s > gap) & (time_s < gap + 30.0))
    return replace(walk, location=pdr.Samples(time_s[use], rows[use]))


def errors(track: pdr.Track, walk: Recording, true_m: np.ndarray, from_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Error in m and squared error over its covariance of the steps from a time on."""
    at_m = interpolated_rows(track.time_s, walk.truth.position.time_s, true_m)
    error = (HERE.east_north_m(track.latitude_deg, track.longitude_deg) - at_m)[track.time_s > from_s]
    return np.linalg.norm(error, axis=1), evaluate.nees(error, track.position_cov_m2[track.time_s > from_s])


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
    inside = [f"{100 * np.mean(nees < limit):.0f} %" for limit in (HALF, MOST)]
    ends = "all along" if share == 1.0 else "the first third"
    return [f"{correlation_s:.0f} s", ends, median_and(error_m, 95, 1), *inside, f"{np.mean(nis):.2f}"]


# Of what somebody meets, the track is to follow the first two, and not to follow the last.
WRONGS = {
    "carried by 100 m": Wrong(120.0, np.inf, 100.0),
    "a kilometre off at first": Wrong(-1.0, 45.0, 1000.0),
    "60 m off for half a minute": Wrong(120.0, 150.0, 60.0),
}


def recovered(what: str, wrong: Wrong, walks: list[tuple[Recording, np.ndarray]]) -> list[str]:
    """A row: what is wrong, walks that were moved, how long until the track is within 25 m for good, error then."""
    moved, after_s, late_m = 0, [], []
    for number, (walk, true_m) in enumerate(walks):
        track = pdr.track(located(walk, true_m, 20.0, number, np.inf, wrong))
        is_there = wrong.end_s == np.inf  # the person is where the locations are
        truth_m = true_m + [wrong.by_m, 0.0] * (walk.truth.position.time_s > wrong.begin_s)[:, None] * is_there
        error_m, _ = errors(track, walk, truth_m, -1.0)
        moved += any(fix.outcome == "moved" for fix in track.fixes)
        from_s = wrong.begin_s if is_there else wrong.end_s
        off_s = track.time_s[(track.time_s > from_s) & (error_m > 25.0)]
        after_s.append(off_s.max() - from_s if len(off_s) else 0.0)
        late_m += list(error_m[track.time_s > from_s + 120.0])
    return [what, f"{moved} of {len(walks)}", median_and(np.array(after_s), 90, 0), median_and(np.array(late_m), 95, 1)]


def of_phone(name: str, recording: Recording) -> list[list[str]]:
    """Rows of a walk with the locations of its own phone: distance to them, all along and after the first third."""
    time_s, (latitude_deg, longitude_deg, _, _) = recording.location.time_s, recording.location.values.T
    cut_s = time_s[0] + (time_s[-1] - time_s[0]) / 3
    first = pdr.Samples(time_s[time_s <= cut_s], recording.location.values[time_s <= cut_s])
    rows: list[list[str]] = []
    for what, seen, gnss in (
        ("dead reckoning from the first location", recording, "off"),
        ("align", recording, "align"),
        ("filter", recording, "filter"),
        ("align, the first third", replace(recording, location=first), "align"),
        ("filter, the first third", replace(recording, location=first), "filter"),
    ):
        track = pdr.track(seen, gnss=gnss)
        origin = track.origin or pdr.Origin(latitude_deg[0], longitude_deg[0])
        at_s, at_m = np.r_[track.start_time_s, track.time_s], np.vstack([track.start_position_m, track.position_m])
        at_m = interpolated_rows(time_s, at_s, at_m)
        away_m = np.linalg.norm(at_m - origin.east_north_m(latitude_deg, longitude_deg), axis=1)
        std_m = np.sqrt(np.trace(track.position_cov_m2[-1]))
        rows.append([name, what, median_and(away_m, 90, 1), median_and(away_m[time_s > cut_s], 90, 1), f"{std_m:.0f}"])
    return rows


def locations(tables: Tables, arguments: argparse.Namespace) -> None:
    """All tables."""
    walks = [walked(k) for k in range(arguments.walks)]
    fewer = walks[: max(arguments.walks // 8, 1)]
    rows = [row for name, file in PHONES.items() for row in of_phone(name, pdr.read(arguments.app_files / file))]
    columns = "walk | locations | m from its own: median, 90 % | after the first third | std of the end m"
    tables.write("gnss_phones", columns, rows)
    rows = [recovered(what, wrong, fewer) for what, wrong in WRONGS.items()]
    columns = "locations | moved | s until it is within 25 m: median, 90 % | error m 120 s later: median, 95 %"
    tables.write("gnss_recovery", columns, rows, f"{len(fewer)} walks.")
    rows = [
        simulated(T, share, walks if T == CORRELATION_S else fewer)
        for T in (10.0, CORRELATION_S, 60.0)
        for share in (1.0, 1 / 3)
    ]
    columns = "T | locations | error m: median, 95 % | in 50 % ellipses | in 95 % ellipses | mean NIS"
    about = f"{arguments.walks} walks with T = {CORRELATION_S:.0f} s, {len(fewer)} with others."
    tables.write("gnss_simulated", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, locations, walks=200, app_files=DATA.parent / "app_files")
