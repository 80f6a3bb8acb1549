"""Online tracks of phones whose gyroscope has a bias: how far they jump, and whether a jump corrects the position.

usage: python -m tests.benchmarks.heading_jumps [--walks 60]

Simulated walks of nine legs with corners, with phones in four carrying modes and no magnetometer. The gyroscope bias
has a standard deviation of 0.005, 0.03 or 0.06 rad/s, far wider than the prior of the filter. A jump is a move of
more than 3 m between two steps that are less than 2 s apart.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import pdr_filter as pdr
from pdr_filter.simulate import Gait, Leg, SensorErrors, simulate
from tests.benchmarks.common import Tables, run

CARRYING_MODES = ("pocket", "swinging", "calling", "texting")
TURNS_RAD = (-1.57, 1.57, 0.8, -0.8, 3.1)


def walk(seed: int) -> pdr.Recording:
    """Simulated walk without magnetometer, of a person and a gyroscope that are drawn at random."""
    rng = np.random.default_rng(seed + 1000)
    legs = [
        Leg("walking", distance_m=rng.uniform(8.0, 40.0), turn_rad=float(rng.choice(TURNS_RAD)) if i else 0.0)
        for i in range(9)
    ]
    errors = SensorErrors()
    errors = replace(errors, gyroscope=replace(errors.gyroscope, bias_std=float(rng.choice([0.005, 0.03, 0.06]))))
    gait = Gait(height_m=rng.uniform(1.55, 1.95))
    return replace(simulate(legs, gait, CARRYING_MODES[seed % 4], seed=seed, errors=errors), magnetometer=None)


def jumps(tables: Tables, arguments: argparse.Namespace) -> None:
    """Simulated walks with large biases."""
    jumps, ends = list[tuple[float, float, float, float]](), list[tuple[float, float]]()
    n_with_jump = 0
    for seed in range(arguments.walks):
        recording = walk(seed)
        track, truth = pdr.track(recording), recording.truth.position
        true_m = np.column_stack([np.interp(track.time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
        error_m = track.position_m - true_m
        nees = np.einsum("ka,kab,kb->k", error_m, np.linalg.inv(track.position_cov_m2), error_m)
        distance_m = np.linalg.norm(error_m, axis=1)
        moved_m = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
        (at,) = np.nonzero((moved_m > 3.0) & (np.diff(track.time_s) < 2.0))
        jumps += [(distance_m[k], distance_m[k + 1], nees[k], nees[k + 1]) for k in at]
        ends.append((distance_m[-1], nees[-1]))
        n_with_jump += len(at) > 0
    before_m, after_m, nees_before, nees_after = np.array(jumps).reshape(-1, 4).T
    gain_m, (end_m, end_nees) = before_m - after_m, np.array(ends).T
    rows = [
        ["walks, walks with a jump, jumps", f"{arguments.walks}, {n_with_jump}, {len(jumps)}"],
        ["position error before and after a jump, mean", f"{before_m.mean():.1f} m, {after_m.mean():.1f} m"],
        ["gain, mean and its standard error", f"{gain_m.mean():.1f} m, {gain_m.std() / np.sqrt(len(jumps)):.1f} m"],
        ["NEES before and after a jump, mean (2 is exact)", f"{nees_before.mean():.1f}, {nees_after.mean():.1f}"],
        ["error at the end, root mean square", f"{np.sqrt((end_m**2).mean()):.1f} m"],
        ["NEES at the end, mean and median", f"{end_nees.mean():.1f}, {np.median(end_nees):.1f}"],
    ]
    about = "Simulated walks with gyroscope biases far beyond the prior."
    tables.write("heading_jumps", ["figure", "value"], rows, about)


if __name__ == "__main__":
    run(__doc__, jumps, walks=60)
