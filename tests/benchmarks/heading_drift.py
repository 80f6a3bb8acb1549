"""Heading alone: how far the direction of walking drifts, whatever the step lengths are.

usage: python -m tests.benchmarks.heading_drift [--data ../shared/data]

The error of a leg is its dead-reckoned direction (unit steps along the device's heading) less the direction between its
ends; on tyrex a leg is a second of motion capture with more than 0.5 m, and the device's heading in it. One constant
is taken off each recording, because how the phone lies in the hand is not known here. RMS is over the legs of a
recording, weighted with their lengths. Waypoints of ms_indoor are good to a metre or so: a leg of 10 m is uncertain by
6 degrees.

before   integral of the angular rate about the vertical, less the bias of vqf's rest detector (2 deg/s, 0.5 m/s2)
twist    the twist of the attitude about the vertical, without bias
now      `AttitudeEstimator()`

What was chosen where: the scatter of still windows on motionsense (people who stand) and ubicomp13, the settings of
straight walking and of the field on every second recording of ms_indoor (sorted by name), the probabilities of the
prior on all of it, on humolire and on what ubicomp13 showed. tyrex was looked at for the twist and the weight of the
field. Axes of buildings are not in these figures (`pdr_filter.sensing.heading.corridors`).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vqf import VQF

import pdr_filter as pdr
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.gyroscope_bias import GyroBias
from tests.benchmarks.common import Tables, paths, run

FloatArray = NDArray[np.float64]
SLOW_M = 0.5
# The attitude without a learnt bias.
NO_BIAS = GyroBias(still_gyr_radps=0.0, walking_acc_mps2=np.inf)


@dataclass(frozen=True)
class Leg:
    """A stretch whose direction is known."""

    start_s: float
    end_s: float
    direction_rad: float
    length_m: float


@dataclass(frozen=True)
class Walk:
    """A recording with what its scores need."""

    name: str
    group: str
    blocks: list[UniformBlock]
    legs: list[Leg]
    step_times_s: FloatArray | None  # None: motion capture, the heading of the device itself
    up_sensor: FloatArray  # (3,) mean

    @property
    def time_s(self) -> FloatArray:
        return np.concatenate([b.time_s for b in self.blocks])


def legs_of(recording: pdr.Recording) -> list[Leg]:
    truth = recording.truth
    if truth.position is not None:
        p, found = truth.position, []
        for start in np.arange(p.time_s[0], p.time_s[-1] - 1.0):
            inside = (p.time_s >= start) & (p.time_s <= start + 1)
            if inside.sum() > 30 and np.diff(p.time_s[inside]).max() < 0.2:
                ends = [start, start + 1]
                found.append(leg(*ends, *(np.interp(ends, p.time_s, c) for c in (p.east_m, p.north_m))))
        return [x for x in found if x.length_m > SLOW_M]
    w = truth.waypoints
    if truth.segments is not None:  # straight ones only
        ends = [[int(np.argmin(np.abs(w.time_s - t))) for t in (s.start_s, s.end_s)] for s in truth.segments]
    else:
        ends = [[k, k + 1] for k in range(len(w.time_s) - 1)]
    found = [leg(w.time_s[a], w.time_s[b], w.east_m[[a, b]], w.north_m[[a, b]]) for a, b in ends]
    return [x for x in found if x.length_m > 3.0]


def leg(start_s: float, end_s: float, east_m: FloatArray, north_m: FloatArray) -> Leg:
    east, north = float(np.diff(east_m)[0]), float(np.diff(north_m)[0])
    return Leg(float(start_s), float(end_s), np.arctan2(east, north), np.hypot(east, north))


def walks(data: Path) -> list[Walk]:
    result: list[Walk] = []
    for path in (p for name in ("humolire", "ms_indoor", "tyrex") for p in paths(data, name)):
        recording = pdr.read(path)
        legs = legs_of(recording)
        if recording.gyroscope is None or len(legs) < 3:
            continue
        conditioner = Conditioner()
        _, blocks = conditioner.update(conditioner.init(), merge_streams(recording))
        steps = None if recording.truth.position is not None else np.array(pdr.detect_steps(recording).time_s)
        duration_s = legs[-1].end_s - legs[0].start_s
        group = {"humolire": "humolire", "ms_indoor": "ms_indoor, 40 s or longer"}.get(path.parent.name, "")
        if path.parent.name == "ms_indoor" and duration_s < 45:
            group = "ms_indoor, shorter"
        if not group:
            group = "tyrex, magnets" if "_dist_" in path.name else "tyrex"
        walk = Walk(path.stem, group, blocks, legs, steps, np.array([0.0, 0.0, 1.0]))
        up = np.concatenate([b.specific_force_mps2 for b in blocks]).mean(axis=0)
        walk = replace(walk, up_sensor=up / np.linalg.norm(up))
        if score(walk, estimated(walk, NO_BIAS, False)) is not None:
            result.append(walk)
    return result


def estimated(walk: Walk, bias: GyroBias, with_field: bool) -> FloatArray:
    """Headings of the attitude."""
    estimator = AttitudeEstimator(bias=bias)
    state, headings = estimator.init(), []
    for block in walk.blocks:
        if headings and block.gap_before_s > 0:
            state = estimator.after_gap(state)
        block = replace(block, magnetic_field_known=block.magnetic_field_known & with_field)
        state, attitude = estimator.update(state, block)
        headings.append(attitude.device_heading_rad)
    return np.concatenate(headings)


def integrated(walk: Walk) -> FloatArray:
    """Headings as they were before."""
    filt = VQF(0.01, tauAcc=3.0, motionBiasEstEnabled=False, restThGyr=2.0, restThAcc=0.5)
    headings = []
    for block in walk.blocks:
        out = filt.updateBatch(
            np.ascontiguousarray(block.angular_rate_radps), np.ascontiguousarray(block.specific_force_mps2)
        )
        w, x, y, z = out["quat6D"].T
        up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        bias = np.where(block.angular_rate_known[:, None], out["bias"], 0.0)
        headings.append(-((block.angular_rate_radps - bias) * up).sum(axis=1))
    return np.cumsum(np.concatenate(headings)) / 100


def score(walk: Walk, heading_rad: FloatArray) -> float | None:
    time_s, rows = walk.time_s, []
    for x in walk.legs:
        if walk.step_times_s is None:
            headings = heading_rad[(time_s > x.start_s) & (time_s < x.end_s)]
        else:
            at = walk.step_times_s[(walk.step_times_s > x.start_s) & (walk.step_times_s <= x.end_s)]
            headings = np.interp(at - 0.25, time_s, heading_rad)  # in the middle of the step
        if len(headings) >= 3:
            off = np.angle(np.exp(1j * (headings - x.direction_rad)).sum())
            rows.append((off, x.length_m))
    if len(rows) < 3:
        return None
    off, length = np.array(rows).T
    weight = length / length.sum()
    constant = np.angle((weight * np.exp(1j * off)).sum())
    error = np.unwrap(np.angle(np.exp(1j * (off - constant))))
    return float(np.rad2deg(np.sqrt((weight * (error - weight @ error) ** 2).sum())))


def scored(walk: Walk, heading_rad: FloatArray) -> float:
    result = score(walk, heading_rad)
    assert result is not None
    return result


def three(values: list[float]) -> str:
    return f"{np.median(values):.1f}, {np.mean(values):.1f}, {np.quantile(values, 0.9):.1f}"


def drift(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors of legs, and the drift in a room."""
    found: dict[str, list[tuple[str, float, float, float]]] = {}
    for walk in walks(arguments.data):
        twist = scored(walk, estimated(walk, NO_BIAS, False))
        before = scored(walk, integrated(walk))
        now = scored(walk, estimated(walk, GyroBias(), True))
        found.setdefault(walk.group, []).append((walk.name, before, twist, now))
    rows = []
    for group, scores in found.items():
        columns = [three([s[k] for s in scores]) for k in (1, 2, 3)]
        worse = max(now - twist for _, _, twist, now in scores)
        rows.append([group, len(scores), *columns, f"{worse:.1f}"])
    columns = ["", "n", "before", "twist", "now", "largest loss, now against twist"]
    about = "RMS error of the direction of legs in degrees: median, mean, 90th percentile over recordings."
    tables.write("heading_drift", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, drift)
