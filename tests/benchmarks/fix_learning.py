"""What a few position fixes teach: fixes in the first third of a walk, errors on the rest, with and without learning.

usage: .venv/bin/python tests/benchmarks/fix_learning.py [--data ../shared/data] [--fix-std 1.0]

humolire (9 walks of one person, 215 to 239 m). Fixes are waypoints, in a frame turned by what the waypoints of the
first third fit best, so that only the walk is judged and not the unknown north of the floor plan. Learning: the log
step scale and the heading offset are states. Without scale: its deviation is zero, so that fixes move positions only.
Figures for the last two thirds: distance of the straight legs by displacement, and the position error at the waypoints.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from accuracy import aligned

import pdr_filter as pdr


def errors(recording: pdr.Recording, track: pdr.Track, turned: np.ndarray, first: float) -> tuple[float, float]:
    """Distance error in per cent and position RMSE in m, both after the first third."""
    points, legs = recording.truth.waypoints, recording.truth.segments
    time_s = np.concatenate([[min(points.time_s[0], track.time_s[0]) - 1e-3], track.time_s])
    position = np.vstack([[0.0, 0.0], track.position_m])

    def at(t: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(t, time_s, position[:, k]) for k in (0, 1)])

    late = legs.start_s > first
    moved = np.linalg.norm(at(legs.end_s[late]) - at(legs.start_s[late]), axis=1)
    after = points.time_s > first
    error = np.linalg.norm(at(points.time_s[after]) - turned[after], axis=1)
    return 100 * (moved.sum() / legs.distance_m[late].sum() - 1), float(np.sqrt((error**2).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--fix-std", type=float, default=1.0)
    args = parser.parse_args()
    config = pdr.recipes.default()
    stiff = config.with_model(noise=replace(config.model.noise, log_scale_std=1e-4))
    rows: dict[str, list[tuple[float, float]]] = {"no fixes": [], "fixes, scale not learnt": [], "fixes": []}
    for path in sorted((args.data / "humolire").glob("*.zip")):
        recording = pdr.read(path)
        points = recording.truth.waypoints
        reference = np.column_stack([points.east_m, points.north_m])
        first = float(points.time_s[0] + (points.time_s[-1] - points.time_s[0]) / 3)
        alone = pdr.track(recording, config)
        time_s = np.concatenate([[min(points.time_s[0], alone.time_s[0]) - 1e-3], alone.time_s])
        position = np.vstack([[0.0, 0.0], alone.position_m])
        estimate = np.column_stack([np.interp(points.time_s, time_s, position[:, k]) for k in (0, 1)])
        turned = aligned(estimate, reference, points.time_s <= first)
        cov = args.fix_std**2 * np.eye(2)
        fixes = [pdr.PositionFix(float(t), p, cov) for t, p in zip(points.time_s, turned, strict=True) if t <= first]
        rows["no fixes"].append(errors(recording, alone, turned, first))
        for name, used in (("fixes, scale not learnt", stiff), ("fixes", config)):
            rows[name].append(errors(recording, pdr.track(recording, used, fixes=fixes), turned, first))
    print(
        "| | distance of the rest %: bias, spread, RMS | position RMSE of the rest m: median, largest |\n|---|---|---|"
    )
    for name, row in rows.items():
        distance, rmse = np.array(row).T
        print(
            f"| {name} | {distance.mean():+.1f}, {distance.std():.1f}, {np.sqrt((distance**2).mean()):.1f} | "
            f"{np.median(rmse):.2f}, {rmse.max():.2f} |"
        )


if __name__ == "__main__":
    main()
