"""A walk in which the phone goes from the hand into the pocket, back, and into the swinging hand: docs/images.

usage: .venv/bin/python tests/benchmarks/carrying_change.py [--out docs/images/carrying_change.png] [--walks 10]

Simulated, because no public recording has such a change on a walk of known path. The figure has one walk with the
default recipe and with the direction of the device taken for that of the person; the table has errors of ten walks. The
pocket is tighter than the simulator's usual one, which the classifier takes for stairs (real pockets it does not).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from pdr_filter.simulate.motion import CARRYING

RIGHT = np.pi / 2
LEGS = [
    Leg("stationary", duration_s=3.0),
    Leg("walking", distance_m=35.0),
    Leg("walking", distance_m=25.0, turn_rad=RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="pocket"),
    Leg("walking", distance_m=35.0, turn_rad=RIGHT),
    Leg("walking", distance_m=15.0, turn_rad=RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="texting"),
    Leg("walking", distance_m=20.0, turn_rad=-RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="swinging"),
    Leg("walking", distance_m=30.0, turn_rad=-RIGHT),
]


PLACES = {**CARRYING, "pocket": replace(CARRYING["pocket"], wobble_roll_rad=0.1, wobble_twist_rad=0.05)}


def errors_m(walk: pdr.Recording, track: pdr.Track) -> np.ndarray:
    """Distance to the truth after each step."""
    truth = walk.truth.position
    at = np.column_stack([np.interp(track.time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    return np.linalg.norm(track.position_m - at, axis=1)


def both(walk: pdr.Recording) -> dict[str, pdr.Track]:
    """With the walking direction learnt, and with the device's direction."""
    config = pdr.recipes.for_recording("default", walk)
    deaf = replace(config, sensing=replace(config.sensing, heading=None))
    return {"walking direction learnt": pdr.track(walk, config), "device direction": pdr.track(walk, deaf)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/images/carrying_change.png"))
    parser.add_argument("--walks", type=int, default=10)
    args = parser.parse_args()
    ends: dict[str, list[float]] = {}
    for seed in range(args.walks):
        walk = simulate(LEGS, seed=seed, carrying=PLACES)
        for name, track in both(walk).items():
            ends.setdefault(name, []).append(float(errors_m(walk, track)[-1]))
    for name, found in ends.items():
        print(f"{name}: end error m median {np.median(found):.1f}, largest {np.max(found):.1f} (n = {len(found)})")

    walk = simulate(LEGS, seed=1, carrying=PLACES)
    truth, tracks = walk.truth.position, both(walk)
    figure, (plane, time) = plt.subplots(2, 1, figsize=(7.0, 8.5), height_ratios=[2.2, 1.0], layout="constrained")
    plane.plot(truth.east_m, truth.north_m, color="black", linestyle="--", linewidth=1.2, label="truth")
    for (name, track), color in zip(tracks.items(), ("#0072b2", "#d55e00"), strict=True):
        path = np.vstack([[0.0, 0.0], track.position_m])
        plane.plot(*path.T, color=color, linewidth=1.8, label=name)
    for label in walk.truth.labels:
        if label["context"] == "stationary" and label["start_s"] > 1.0:
            place = [np.interp(label["start_s"], truth.time_s, truth[n]) for n in ("east_m", "north_m")]
            plane.plot(*place, marker="o", color="black")
            plane.annotate(f"  {label['carrying_mode']}", place)
    plane.set(xlabel="east, m", ylabel="north, m", aspect="equal", title="The phone changes its place three times")
    plane.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.02, 1.0))
    windows = tracks["walking direction learnt"].windows
    colors = ("#0072b2", "#999999", "#009e73", "#e69f00", "#cc79a7")
    for i, (mode, color) in enumerate(zip(windows.carrying_modes, colors, strict=True)):
        if windows.carrying_prob[:, i].max() > 0.2:
            time.plot(windows.time_s, windows.carrying_prob[:, i], color=color, linewidth=1.8, label=mode)
    for label in walk.truth.labels:
        time.axvline(label["start_s"], color="black", linewidth=0.4)
    time.set(xlabel="time, s", ylabel="probability of carrying mode", ylim=(-0.02, 1.02))
    time.legend(frameon=False, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    args.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out, dpi=110)
    print(f"figure in {args.out}")


if __name__ == "__main__":
    main()
