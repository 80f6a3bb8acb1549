"""What a few position fixes teach: fixes in the first third of a walk, errors on the rest, with and without learning.

usage: python -m tests.benchmarks.fix_learning [--data ../shared/data] [--fix-std 1.0]

humolire (9 walks of one person, 215 to 239 m). Fixes are waypoints, in a frame turned by what the waypoints of the
first third fit best, so that only the walk is judged and not the unknown north of the floor plan. The person's height
is taken as unknown. Learning: the log step scale and the heading offset are states. Without scale: its standard
deviation is zero, so that fixes move positions only. Figures for the last two thirds: distance of the straight legs by
displacement, and the position error at the waypoints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from tests.benchmarks.common import Tables, bias_spread_rms, median_and, options, recordings


def errors(recording: pdr.Recording, track: pdr.Track, turned_m: np.ndarray, first_s: float) -> tuple[float, float]:
    """Distance error in per cent and position RMSE in m, both after the first third."""
    points, legs = recording.truth.waypoints, recording.truth.segments
    late, after = legs[legs.start_s > first_s], points.time_s > first_s
    moved_m = evaluate.moved_m(track.time_s, track.position_m, late.start_s, late.end_s)
    at_m = evaluate.positions_at(track.time_s, track.position_m, points.time_s[after])
    distance = evaluate.percent_error(moved_m.sum(), late.distance_m.sum())
    return float(distance), evaluate.position_rmse_m(at_m, turned_m[after])


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--fix-std", type=float, default=1.0)
    args = parser.parse_args()
    config = pdr.recipes.default()
    stiff = config.with_model(noise=replace(config.model.noise, log_scale_std=1e-4))
    found: dict[str, list[tuple[float, float]]] = {"no fixes": [], "fixes, scale not learnt": [], "fixes": []}
    for recording in recordings(args.data, "humolire"):
        points = recording.truth.waypoints
        reference = np.column_stack([points.east_m, points.north_m])
        first_s = float(points.time_s[0] + (points.time_s[-1] - points.time_s[0]) / 3)
        alone = pdr.track(recording, config)
        estimate = evaluate.positions_at(alone.time_s, alone.position_m, points.time_s)
        use = np.asarray(points.time_s <= first_s)
        turned_m = evaluate.fitted(reference, estimate, use)
        cov_m2 = args.fix_std**2 * np.eye(2)
        fixes = [pdr.PositionFix(float(t), p, cov_m2) for t, p in zip(points.time_s[use], turned_m[use], strict=True)]
        found["no fixes"].append(errors(recording, alone, turned_m, first_s))
        for name, used in (("fixes, scale not learnt", stiff), ("fixes", config)):
            found[name].append(errors(recording, pdr.track(recording, used, fixes=fixes), turned_m, first_s))
    Tables.of(__spec__.name, args).write(
        "fix_learning",
        ["", "distance of the rest %: bias, spread, RMS", "position RMSE of the rest m: median, largest"],
        [
            [name, bias_spread_rms([d for d, _ in each]), median_and([p for _, p in each], 100)]
            for name, each in found.items()
        ],
    )


if __name__ == "__main__":
    main()
