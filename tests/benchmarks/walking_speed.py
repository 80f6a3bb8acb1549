"""Walking speed against straight legs and continuous references: error, and what was said of it.

usage: python -m tests.benchmarks.walking_speed [--data ../shared/data]

humolire: mean smoothed speed of each leg against its length over its time (9 walks, 133 legs, one person). tyrex:
smoothed speed at each step against the speed of the phone, its path low-passed at 0.5 Hz (one person; walking
scenarios). oxiod: the same against visual odometry over a floor and motion capture in a room. The share of the scatter
that counts as lasting was chosen on tyrex, with oxiod in view. Inside: share of the errors within one and two of the
standard deviations that the filter gives, 0.68 and 0.95 if these are right. Those have the spread of people, of whom
each row has one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from tests.benchmarks.common import Tables, options, paths

WALKING = ("texting", "phoning", "swinging", "frontpocket", "backpocket")
OXIOD = ("floor1_handheld", "floor1_pocket", "floor1_handbag", "room_handheld", "room_pocket")


def on_legs(path: Path) -> list[tuple[float, float, float]]:
    """True speed, found speed and its standard deviation of each leg."""
    recording = pdr.read(path)
    track = pdr.track(recording)
    rows = []
    for leg in recording.truth.segments:
        inside = (track.time_s >= leg["start_s"]) & (track.time_s <= leg["end_s"])
        if inside.sum() >= 4:
            true = leg["distance_m"] / (leg["end_s"] - leg["start_s"])
            rows.append((true, track.smoothed_speed_mps[inside].mean(), track.smoothed_speed_std_mps[inside].mean()))
    return rows


def in_the_room(path: Path) -> list[tuple[float, float, float]]:
    """The same at each step."""
    recording = pdr.read(path)
    track, truth, label = pdr.track(recording), recording.truth.position, recording.truth.labels[0]
    grid_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.02)
    place = np.column_stack([np.interp(grid_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    smooth = sosfiltfilt(butter(2, 0.5, fs=50.0, output="sos"), place, axis=0)
    speed = np.linalg.norm(np.gradient(smooth, 0.02, axis=0), axis=1)
    inside = (track.time_s >= label["start_s"]) & (track.time_s <= label["end_s"])
    true = np.interp(track.time_s[inside], grid_s, speed)
    return list(zip(true, track.smoothed_speed_mps[inside], track.smoothed_speed_std_mps[inside], strict=True))


def row(name: str, found: list[tuple[float, float, float]]) -> list[str]:
    """One line of the table."""
    true, speed, std = np.array(found).T
    error = speed - true
    within = [np.mean(np.abs(error) <= k * std) for k in (1, 2)]
    figures = [f"{true.mean():.2f}", f"{error.mean():+.3f}", f"{error.std():.3f}", f"{np.abs(error).mean():.3f}"]
    return [name, str(len(error)), *figures, f"{within[0]:.2f}, {within[1]:.2f}"]


def main() -> None:
    args = options(__doc__).parse_args()
    rows = [row("humolire, legs", [r for p in paths(args.data, "humolire") for r in on_legs(p)])]
    for scenario in WALKING:
        of_steps = [r for p in paths(args.data, "tyrex", f"*_{scenario}.zip") for r in in_the_room(p)]
        rows.append(row(f"tyrex {scenario}, steps", of_steps))
    for scenario in OXIOD:
        of_steps = [r for p in paths(args.data, "oxiod", f"*_{scenario}*.zip") for r in in_the_room(p)]
        rows.append(row(f"oxiod {scenario.replace('1_', ' ').replace('_', ' ')}, steps", of_steps))
    columns = ["where", "n", "true m/s", "bias m/s", "spread m/s", "mean absolute m/s", "inside 1, 2 std"]
    Tables.of(__spec__.name, args).write("walking_speed", columns, rows)


if __name__ == "__main__":
    main()
