"""North from the magnetic field: how far it is off where north is known, and tracks with it and without.

usage: python -m tests.benchmarks.absolute_heading [north] [fixes] [--data ../shared/data]

Known north: the plans of ms_indoor are laid out to it, the points of ipin2023 and ipin21 are surveyed, and the room of
tyrex points there within a few degrees. The turn from the frame of a track to the world is that of the best fit of the
whole track to the points.

north: error of `MagneticNorth` at the last step of each walk, and whether it is as good as it says.
fixes: points of the plan as fixes in the world frame, with the magnetometer, without it, with the phone's own attitude
in its place, and with a magnetometer that is wrong by a right angle. Location errors are synthetic: 5 m on each axis,
alike for 20 s.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.georeferencing import with_north_of_attitude
from pdr_filter.values import FloatArray, PositionFix, interpolated_rows, wrap_angle
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import MOST, Tables, median_and, places_of, recordings, run

HERE = {
    "ms_indoor": pdr.Origin(30.2930, 120.0751),
    "ipin2023": pdr.Origin(49.461222, 11.111590),
    "ipin21": pdr.Origin(53.54, 10.0),
    "tyrex": pdr.Origin(45.218, 5.807),
}
SETS = (
    ("ms_indoor, storeys B1 and F1 (chosen on)", "ms_indoor", ("_b1_", "_f1_")),
    ("ms_indoor, storeys F2 to F4", "ms_indoor", ("_f2_", "_f3_", "_f4_")),
    ("ipin2023", "ipin2023", ("",)),
    ("ipin21", "ipin21", ("",)),
    ("tyrex, undisturbed", "tyrex", ("_nodist_",)),
    ("tyrex, magnets brought near", "tyrex", ("_dist_",)),
)
YEAR = 2020.0  # of most of them; a few years change nothing here
# Root mean square distance of the points from their centre: less does not show the turn of a track.
MIN_EXTENT_M = 4.0


# --- what is known ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Walk:
    """A recording with points in a frame whose north is true north, and the turn of its dead reckoning to it."""

    recording: Recording
    config: Config
    time_s: FloatArray  # (N,) of the points
    points_m: FloatArray  # (N, 2)
    track: pdr.Track  # in the frame of the start, with `north_rad` of its steps
    turn_rad: float
    declination_rad: float
    field_ut: tuple[float, float]

    @property
    def known(self) -> np.ndarray:
        """Steps whose walking direction against the phone is known."""
        return self.track.steps.shown_offset_std_rad < 1.0

    @property
    def person_rad(self) -> FloatArray:
        """Walking heading in the attitude's frame less that in the world, of each step: where north should be."""
        steps = self.track.steps
        in_attitude = steps.device_heading_rad + steps.shown_offset_rad
        return wrap_angle(in_attitude - self.track.walking_heading_rad - self.turn_rad)


def points_of(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Times and places of what is known of a walk."""
    if recording.truth.waypoints is not None:
        rows = recording.truth.waypoints
    else:
        rows = recording.truth.position[:: max(len(recording.truth.position) // 1000, 1)]
    return rows.time_s, places_of(rows)


def walk_of(recording: Recording, site: str) -> Walk | None:
    """A walk whose points show the turn of its track."""
    if recording.magnetometer is None or recording.gyroscope is None:
        return None
    recording = replace(recording, location=None)
    time_s, points_m = points_of(recording)
    extent_m = np.sqrt(((points_m - points_m.mean(axis=0)) ** 2).sum(axis=1).mean())
    base = pdr.recipes.default(recording.subject)
    declination_rad, field_ut = HERE[site].declination_rad(YEAR), HERE[site].magnetic_field_ut(YEAR)
    with_north = base.with_magnetic_north(declination_rad, field_ut=field_ut)
    # the frame of the start: north is said of each step, and nothing comes of it
    track = pdr.track(recording, replace(base, sensing=with_north.sensing))
    if extent_m < (MIN_EXTENT_M if site == "ms_indoor" else 0.0) or track.n_steps < 20:
        return None
    at_m = evaluate.positions_at(track.time_s, track.position_m, time_s)
    rotation, _ = evaluate.rigid_fit(at_m, points_m)
    turn_rad = float(np.arctan2(rotation[0, 1], rotation[0, 0]))
    return Walk(recording, base, time_s, points_m, track, turn_rad, declination_rad, field_ut)


@cache
def walks(data: Path, site: str) -> list[Walk]:
    """Walks of a data set."""
    return [walk for r in recordings(data, site) if (walk := walk_of(r, site)) is not None]


def those(data: Path, site: str, parts: Sequence[str]) -> list[Walk]:
    """Walks of a data set whose names have one of some parts."""
    return [walk for walk in walks(data, site) if any(part in walk.recording.name for part in parts)]


# --- north of a walk --------------------------------------------------------------------------------------------------


def last_error(walk: Walk) -> tuple[float, float, float]:
    """Error of north at the last step whose walking direction is known, and its standard deviations without and with
    that of the direction.
    """
    steps, last = walk.track.steps, np.flatnonzero(walk.known)[-1]
    error_rad = float(wrap_angle(walk.person_rad[last] - steps.north_rad[last]))
    of_north = float(steps.north_std_rad[last])
    return error_rad, of_north, float(np.hypot(of_north, steps.shown_offset_std_rad[last]))


def north(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table of the north of walks."""
    rows: list[list[str]] = []
    for name, site, parts in SETS:
        found = np.array([last_error(walk) for walk in those(arguments.data, site, parts) if walk.known.any()])
        e, of_north, std = np.degrees(found).T
        mean_std = f"{e.mean():+.0f}, {e.std():.0f}" if len(e) > 1 else f"{e.mean():+.0f}, -"
        inside = [f"{np.sum(np.abs(e) < k * std)}" for k in (1, 2, 3)]
        stds = [f"{np.median(v):.0f}" for v in (of_north, std)]
        rows.append([name, str(len(e)), mean_std, f"{np.abs(e).max():.0f}", *stds, *inside])
    columns = "set | walks | error, degrees: mean, spread | largest | std given: field | with the direction | "
    tables.write("absolute_heading_north", columns + "within 1 sigma | 2 | 3", rows)


# --- tracks with fixes ------------------------------------------------------------------------------------------------


def made_fixes(walk: Walk) -> list[PositionFix]:
    """A location each ten seconds whose error is alike for twenty."""
    rng = np.random.default_rng([ord(c) for c in walk.recording.name])
    time_s = np.arange(max(walk.time_s[0], 0.0) + 0.5, walk.time_s[-1], 10.0)
    error, r = rng.normal(scale=5.0, size=(len(time_s), 2)), np.exp(-0.5)
    for k in range(1, len(time_s)):
        error[k] = r * error[k - 1] + np.sqrt(1 - r * r) * error[k]
    place_m = interpolated_rows(time_s, walk.time_s, walk.points_m) + error
    # as `gnss.independent` has it
    shared = 1.0 / np.tanh(10.0 / 40.0)
    variances = 25.0 * np.where(np.arange(len(time_s)) > 0, shared, 1.0)
    return [PositionFix(t, p, v * np.eye(2)) for t, p, v in zip(time_s, place_m, variances, strict=True)]


def points(walk: Walk, n: int) -> tuple[list[PositionFix], float]:
    """The first points as fixes of half a metre, and the time of the last of them."""
    rows = zip(walk.time_s[:n], walk.points_m[:n], strict=True)
    return [PositionFix(max(t, 0.0), p, 0.25 * np.eye(2)) for t, p in rows], float(walk.time_s[n - 1])


def scenarios(walk: Walk) -> Iterator[tuple[str, list[PositionFix], float]]:
    """Names, fixes, and from when on the track is judged."""
    yield "the first point", *points(walk, 1)
    yield "the first two points", *points(walk, 2)
    third_s = walk.time_s[0] + (walk.time_s[-1] - walk.time_s[0]) / 3.0
    made = made_fixes(walk)
    yield "locations over the first third", [fix for fix in made if fix.time_s <= third_s], third_s
    yield "locations all along", made, float(walk.time_s[0])


def judged(
    walk: Walk, recording: Recording, config: Config, fixes: list[PositionFix], from_s: float
) -> tuple[float, float]:
    """Root mean square error at the points after a time, and the share of them inside the ellipses of 95 %."""
    track, late = pdr.track(recording, config, fixes=fixes), walk.time_s > from_s
    at_s = walk.time_s[late]
    error_m = interpolated_rows(at_s, track.time_s, track.position_m) - walk.points_m[late]
    cov = track.position_cov_m2[np.clip(np.searchsorted(track.time_s, at_s), 0, track.n_steps - 1)]
    inside = evaluate.nees(error_m, cov) < MOST
    return float(np.sqrt((error_m**2).sum(axis=1).mean())), float(np.mean(inside))


def fixes(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table of tracks with fixes."""
    found: dict[tuple[str, str], list[list[tuple[float, float]]]] = {}
    for set_name, site, parts in SETS[:4]:
        for walk in those(arguments.data, site, parts):
            with_it = walk.config.with_magnetic_north(walk.declination_rad, field_ut=walk.field_ut)
            by_attitude = walk.config.with_magnetic_north(walk.declination_rad)
            wrong = walk.config.with_magnetic_north(walk.declination_rad + np.pi / 2, field_ut=walk.field_ut)
            ways = (
                (walk.recording, walk.config.in_world_frame()),
                (walk.recording, with_it),
                (with_north_of_attitude(walk.recording, "rotation-vector"), by_attitude),
                (walk.recording, wrong),
            )
            for name, some, from_s in scenarios(walk):
                if (walk.time_s > from_s).any() and len(walk.time_s) > 2:
                    row = [judged(walk, recording, config, some, from_s) for recording, config in ways]
                    found.setdefault((set_name, name), []).append(row)
    rows: list[list[str]] = []
    for (set_name, name), results in found.items():
        rmse, inside = np.array(results).transpose(2, 1, 0)
        without, with_it, _, _ = rmse
        text = [f"{median_and(e, 90, 1)}, {e.mean():.1f}" for e in rmse]
        if set_name == "ipin21":  # which has no attitude
            text[2] = "-"
        share = [f"{100 * i.mean():.0f} %" for i in inside[:2]]
        worse, better = (int(np.sum(c)) for c in (with_it > 1.05 * without, with_it < 0.95 * without))
        rows.append([set_name, name, str(len(without)), *text[:2], f"{worse}, {better}", *share, *text[2:]])
    columns = "set | fixes | walks | without, m: median, 90 %, mean | with | worse, better by 5 % | in 95 % ellipses, "
    columns += "without | with | with the phone's attitude instead, m | wrong by 90 degrees, m"
    tables.write("absolute_heading_fixes", columns, rows)


if __name__ == "__main__":
    run(__doc__, north, fixes)
