"""North from the magnetic field: how far it is off where north is known, and tracks with it and without.

usage: python -m tests.benchmarks.absolute_heading [readings] [north] [fixes] [drift] [--data ../shared/data]

Known north: the plans of ms_indoor are laid out to it, the points of ipin2023 and ipin21 are surveyed, and the room of
tyrex points there within a few degrees; oxiod has frames of its own and only shows drift. The turn from the frame of a
track to the world is that of the best fit of the whole track to the points.

readings: error of the heading of each step against true north, from the field of that step alone and from the phone's
own attitude (Android's rotation vector), with the walking direction that the phone's axis and strides show.
north: the same of `MagneticNorth` at the last step, and whether it is as good as it says.
fixes: points of the plan as fixes in the world frame, with the magnetometer, without it, with the phone's own attitude
in its place, and with a magnetometer that is wrong by a right angle. Location errors are made: 5 m on each axis, alike
for 20 s.
drift: headings from the field of the last 15 s as fixes, every 20 steps, against drift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
from pdr_filter.tracking.georeferencing import with_north_of_attitude
from pdr_filter.values import FloatArray, HeadingFix, PositionFix, circular_mean, wrap_angle
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, median_and, options, recordings

HERE = {
    "ms_indoor": pdr.Origin(30.2930, 120.0751),
    "ipin2023": pdr.Origin(49.461222, 11.111590),
    "ipin21": pdr.Origin(53.54, 10.0),
    "tyrex": pdr.Origin(45.218, 5.807),
    "oxiod": pdr.Origin(51.76, -1.26),
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
    return rows.time_s, np.column_stack([rows.east_m, rows.north_m])


def walk_of(recording: Recording, site: str) -> Walk | None:
    """A walk whose points show the turn of its track."""
    if recording.magnetometer is None or recording.gyroscope is None:
        return None
    recording = replace(recording, location=None)
    time_s, points_m = points_of(recording)
    extent_m = np.sqrt(((points_m - points_m.mean(axis=0)) ** 2).sum(axis=1).mean())
    base = pdr.recipes.default(recording.subject)
    declination_rad = HERE[site].declination_rad(YEAR)
    north = MagneticNorth(declination_rad=declination_rad)
    # the frame of the start: north is said of each step, and nothing comes of it
    track = pdr.track(recording, replace(base, sensing=replace(base.sensing, north=north)))
    if extent_m < (MIN_EXTENT_M if site == "ms_indoor" else 0.0) or track.n_steps < 20:
        return None
    at_m = evaluate.positions_at(track.time_s, track.position_m, time_s)
    rotation, _ = evaluate.rigid_fit(at_m, points_m)
    turn_rad = float(np.arctan2(rotation[0, 1], rotation[0, 0]))
    return Walk(recording, base, time_s, points_m, track, turn_rad, declination_rad)


@cache
def walks(data: Path, site: str) -> list[Walk]:
    """Walks of a data set."""
    return [walk for r in recordings(data, site) if (walk := walk_of(r, site)) is not None]


def those(data: Path, site: str, parts: Sequence[str]) -> list[Walk]:
    """Walks of a data set whose names have one of some parts."""
    return [walk for walk in walks(data, site) if any(part in walk.recording.name for part in parts)]


# --- single readings --------------------------------------------------------------------------------------------------


def attitudes(walk: Walk) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, quaternions and magnetic fields in the sensor's frame, at 100 Hz."""
    sensing = walk.config.sensing
    _, blocks = sensing.conditioner.update(sensing.conditioner.init(), merge_streams(walk.recording))
    state, rows = sensing.attitude.init(), list[tuple[FloatArray, ...]]()
    for block in blocks:
        if block.gap_before_s > 0:
            state = sensing.attitude.after_gap(state)
        state, attitude = sensing.attitude.update(state, block)
        field = np.where(block.magnetic_field_known[:, None], block.magnetic_field_ut, np.nan)
        rows.append((block.time_s, attitude.quat, field))
    time_s, quat, field = (np.concatenate(each) for each in zip(*rows, strict=True))
    return time_s, quat, field


def rotated(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """Vectors (N, 3) turned by unit quaternions wxyz (N, 4)."""
    w, v = quat[:, :1], quat[:, 1:]
    return vector + 2 * np.cross(v, np.cross(v, vector) + w * vector)


@cache
def at_steps(walk: Walk) -> tuple[FloatArray, FloatArray | None]:
    """Mean field (K, 3) over each step in the attitude's frame, and the heading of the phone's own north there (K,)."""
    time_s, quat, field = attitudes(walk)
    steps, size = walk.track.steps, 50
    in_frame = rotated(quat, field)
    last = np.clip(np.searchsorted(time_s, steps.time_s), size, len(time_s))
    mean = np.array([in_frame[k - size : k].mean(axis=0) for k in last])
    own = walk.recording.attitude
    if own is None:
        return mean, None
    ordered, first = np.unique(own.time_s, return_index=True)
    world = own.values[first][np.clip(np.searchsorted(ordered, time_s), 0, len(ordered) - 1)]
    north = rotated(quat, rotated(world * [1, -1, -1, -1], np.tile([0.0, 1.0, 0.0], (len(world), 1))))
    return mean, np.arctan2(north[:, 0], north[:, 1])[last - 1]


def errors_rad(walk: Walk, magnetic_north_rad: FloatArray) -> FloatArray:
    """By how much the world is turned too far if this is magnetic north in the attitude's frame, for known steps."""
    return wrap_angle(walk.person_rad - magnetic_north_rad + walk.declination_rad)[walk.known]


def of_field(walk: Walk) -> FloatArray:
    field, _ = at_steps(walk)
    return errors_rad(walk, np.arctan2(field[:, 0], field[:, 1]))


def spread(errors: Sequence[FloatArray]) -> list[str]:
    """Mean and standard deviation in degrees, and the share beyond 30 degrees."""
    e = np.concatenate(errors)
    e = e[np.isfinite(e)]
    if not len(e):
        return ["-", "-"]
    centre = circular_mean(e)
    std = np.sqrt((wrap_angle(e - centre) ** 2).mean())
    return [f"{np.degrees(centre):+.0f}, {np.degrees(std):.0f}", f"{100 * np.mean(np.abs(e) > np.radians(30)):.0f} %"]


def correlations(fields: Sequence[FloatArray]) -> str:
    """Of the horizontal field with that of 1, 5, 10 and 20 steps before."""
    lags = (0, 1, 5, 10, 20)
    sums = np.zeros(len(lags))
    for field in fields:
        away = field[:, :2] - field[:, :2].mean(axis=0)
        if len(away) > 2 * lags[-1]:
            sums += [(away[lag:] * away[: len(away) - lag]).sum() / (len(away) - lag) * len(away) for lag in lags]
    return ", ".join(f"{c:.1f}" for c in sums[1:] / sums[0]) if sums[0] else "-"


def readings(tables: Tables, data: Path) -> None:
    """Tables of single readings, and of what the size of the field says of them."""
    rows: list[list[str]] = []
    for name, site, parts in SETS:
        some = those(data, site, parts)
        fields = [at_steps(walk)[0] for walk in some]
        scatter = [np.nanstd(f[:, :2], axis=0).mean() for f in fields]
        own = [errors_rad(w, north) for w in some if (north := at_steps(w)[1]) is not None]
        own_spread = spread(own) if own else ["-", "-"]
        seen = spread([of_field(w) for w in some])
        rows.append([name, str(len(some)), *seen, *own_spread, f"{np.median(scatter):.0f}", correlations(fields)])
    tables.write(
        "absolute_heading_readings",
        [
            "set",
            "walks",
            "field, degrees: mean, spread",
            "beyond 30",
            "phone's attitude: mean, spread",
            "beyond 30",
            "scatter, uT",
            "correlation after 1, 5, 10, 20 steps",
        ],
        rows,
    )
    some = walks(data, "ms_indoor")
    fields = np.concatenate([at_steps(walk)[0][walk.known] for walk in some])
    errors = np.concatenate([of_field(walk) for walk in some])
    # the model's field in Hangzhou: 33.9 uT horizontal, 35.1 down
    away_ut = np.hypot(np.hypot(fields[:, 0], fields[:, 1]) - 33.9, fields[:, 2] + 35.1)
    rows = []
    for low, high in ((0, 3), (3, 6), (6, 10), (10, 15), (15, np.inf)):
        e = errors[(away_ut >= low) & (away_ut < high)]
        central = 1.4826 * np.median(np.abs(e - np.median(e)))
        label = f"{low} to {high}" if np.isfinite(high) else f"more than {low}"
        rows.append([label, str(len(e)), f"{np.degrees(central):.0f}", spread([e])[1]])
    tables.write("absolute_heading_gates", ["away from the model, uT", "steps", "spread, degrees", "beyond 30"], rows)


# --- north of a walk --------------------------------------------------------------------------------------------------


def last_error(walk: Walk) -> tuple[float, float, float]:
    """Error of north at the last step whose walking direction is known, and its standard deviations without and with
    that of the direction.
    """
    steps, last = walk.track.steps, np.flatnonzero(walk.known)[-1]
    error_rad = float(wrap_angle(walk.person_rad[last] - steps.north_rad[last]))
    of_north = float(steps.north_std_rad[last])
    return error_rad, of_north, float(np.hypot(of_north, steps.shown_offset_std_rad[last]))


def north(tables: Tables, data: Path) -> None:
    """Table of the north of walks."""
    rows: list[list[str]] = []
    for name, site, parts in SETS:
        found = np.array([last_error(walk) for walk in those(data, site, parts) if walk.known.any()])
        e, of_north, std = np.degrees(found).T
        mean_std = f"{e.mean():+.0f}, {e.std():.0f}" if len(e) > 1 else f"{e.mean():+.0f}, -"
        inside = [f"{np.sum(np.abs(e) < k * std)}" for k in (1, 2, 3)]
        rows.append(
            [
                name,
                str(len(e)),
                mean_std,
                f"{np.abs(e).max():.0f}",
                f"{np.median(of_north):.0f}",
                f"{np.median(std):.0f}",
                *inside,
            ]
        )
    tables.write(
        "absolute_heading_north",
        [
            "set",
            "walks",
            "error, degrees: mean, spread",
            "largest",
            "said: field",
            "with the direction",
            "within 1 sigma",
            "2",
            "3",
        ],
        rows,
    )


# --- tracks with fixes ------------------------------------------------------------------------------------------------


def made_fixes(walk: Walk) -> list[PositionFix]:
    """A location each ten seconds whose error is alike for twenty."""
    rng = np.random.default_rng([ord(c) for c in walk.recording.name])
    time_s = np.arange(max(walk.time_s[0], 0.0) + 0.5, walk.time_s[-1], 10.0)
    error, r = rng.normal(scale=5.0, size=(len(time_s), 2)), np.exp(-0.5)
    for k in range(1, len(time_s)):
        error[k] = r * error[k - 1] + np.sqrt(1 - r * r) * error[k]
    place_m = np.column_stack([np.interp(time_s, walk.time_s, walk.points_m[:, k]) for k in (0, 1)]) + error
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
    at_m = np.column_stack([np.interp(at_s, track.time_s, track.position_m[:, k]) for k in (0, 1)])
    error_m = at_m - walk.points_m[late]
    cov = track.position_cov_m2[np.clip(np.searchsorted(track.time_s, at_s), 0, track.n_steps - 1)]
    nees = np.einsum("ni,nij,nj->n", error_m, np.linalg.inv(cov), error_m)
    return float(np.sqrt((error_m**2).sum(axis=1).mean())), float(np.mean(nees < 5.99))


def fixes(tables: Tables, data: Path) -> None:
    """Table of tracks with fixes."""
    found: dict[tuple[str, str], list[list[tuple[float, float]]]] = {}
    for set_name, site, parts in SETS[:4]:
        for walk in those(data, site, parts):
            with_it = walk.config.with_magnetic_north(walk.declination_rad)
            ways = (
                (walk.recording, walk.config.in_world_frame()),
                (walk.recording, with_it),
                (with_north_of_attitude(walk.recording, "rotation-vector"), with_it),
                (walk.recording, walk.config.with_magnetic_north(walk.declination_rad + np.pi / 2)),
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
    tables.write(
        "absolute_heading_fixes",
        [
            "set",
            "fixes",
            "walks",
            "without, m: median, 90 %, mean",
            "with",
            "worse, better by 5 %",
            "in 95 % ellipses, without",
            "with",
            "with the phone's attitude instead, m",
            "wrong by 90 degrees, m",
        ],
        rows,
    )


# --- against drift ----------------------------------------------------------------------------------------------------


def drift(tables: Tables, data: Path) -> None:
    """Table of tracks whose heading follows the magnetic field."""
    rows: list[list[str]] = []
    for name, site, part in (
        ("ms_indoor", "ms_indoor", ""),
        ("oxiod, floor", "oxiod", "floor"),
        ("ipin21", "ipin21", ""),
        ("ipin2023", "ipin2023", ""),
    ):
        errors_m: list[list[float]] = []
        for walk in those(data, site, (part,)):
            sensing = replace(walk.config.sensing, north=MagneticNorth(memory_s=15.0))
            steps = pdr.track(walk.recording, replace(walk.config, sensing=sensing)).steps
            if len(steps) < 60:
                continue
            heading_rad = steps.device_heading_rad + steps.shown_offset_rad - steps.north_rad
            some = [
                HeadingFix(float(steps.time_s[k]), float(heading_rad[k]), float(steps.north_std_rad[k]))
                for k in range(20, len(steps), 20)
                if np.isfinite(steps.north_std_rad[k]) and steps.shown_offset_std_rad[k] < 1.0
            ]
            tracks = [walk.track, pdr.track(walk.recording, walk.config.in_world_frame(), fixes=some)]
            at_m = [evaluate.positions_at(t.time_s, t.position_m, walk.time_s) for t in tracks]
            errors_m.append([evaluate.position_rmse_m(m, walk.points_m, "all") for m in at_m])
        e = np.array(errors_m)
        shares = [f"{np.sum(e[:, 1] > 1.05 * e[:, 0])}, {np.sum(e[:, 1] < 0.95 * e[:, 0])}"]
        rows.append([name, str(len(e)), *(median_and(e[:, k], 90, 2) for k in (0, 1)), *shares])
    tables.write(
        "absolute_heading_drift",
        ["set", "walks", "as it is, m: median, 90 %", "with headings of the field", "worse, better by 5 %"],
        rows,
        "Errors of the shape: the whole track fitted to the points.",
    )


def main() -> None:
    parts: dict[str, Callable[[Tables, Path], None]] = {
        "readings": readings,
        "north": north,
        "fixes": fixes,
        "drift": drift,
    }
    args = options(__doc__, *parts).parse_args()
    tables = Tables.of(__spec__.name, args)
    for part in args.parts:
        parts[part](tables, args.data)


if __name__ == "__main__":
    main()
