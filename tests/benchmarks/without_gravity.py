"""Walks whose gravity was removed: steps and shape of the path against the same walks with gravity.

usage: python -m tests.benchmarks.without_gravity [tracks] [counted] [--data ../shared/data] [--sites tyrex] [--print]

Gravity is removed as a phone does it, with the phone's own attitude, so that its errors stay in the acceleration. Steps
is the difference of the count from the same walk with gravity. Shape is the root mean square distance from the
reference after the best rotation and shift, online, without locations. The path of a mirrored walk has its turns in the
wrong sense. The parameters of `sensing.gravity` were chosen on tyrex, the subjects 1 to 6 of motionsense, ubicomp13
(which has no attitude), and routes 01 and 02 of ipin2023, which begin with a phone in busy hands; the other rows are
held out. Recordings shorter than 20 s do not count.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

import pdr_filter as pdr
from pdr_filter.sensing.gravity import with_gravity
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, interpolated_rows
from pdr_filter.values.quaternions import rotation_matrix
from tests.benchmarks.common import Tables, median_and, places_of, recordings, run
from tests.benchmarks.smoothed_places import aligned_errors_m, is_on_one_storey, rms

SITES = ["tyrex", "motionsense", "oxiod", "ms_indoor", "ipin2023"]
_NOT_WALKED = re.compile(r"_ar$|_sit_|_std_|trolley")
_CHOSEN = re.compile(r"tyrex|motionsense_s0[1-6]_|ipin2023_anon_trial0")


@dataclass(frozen=True)
class Pair:
    """Results of one walk without gravity, and with it; NaN where they are unknown."""

    group: str
    is_refused: bool = False
    is_mirrored: bool = False
    is_sure: bool = True
    steps_percent: float = np.nan
    shape_m: tuple[float, float] = (np.nan, np.nan)


def up_of_phone(recording: pdr.Recording) -> FloatArray:
    """Up in the sensor frame at the accelerometer's times, shape (N, 3), as the phone's own attitude has it."""
    attitude = recording.attitude
    assert attitude is not None
    up = rotation_matrix(attitude.values / np.linalg.norm(attitude.values, axis=1, keepdims=True))[:, 2]
    up = interpolated_rows(recording.accelerometer.time_s, attitude.time_s, up)
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def shape_m(recording: pdr.Recording, track: pdr.Track) -> float:
    """Shape error against the waypoints or the continuous reference, once a second; NaN without three places."""
    truth = recording.truth
    points = truth.waypoints if truth.waypoints is not None else truth.position
    if points is None or len(points) < 3 or not is_on_one_storey(points):
        return np.nan
    time_s, true_m = points.time_s, places_of(points)
    if len(time_s) > 300:
        at_s = np.arange(time_s[0], time_s[-1])
        time_s, true_m = at_s, interpolated_rows(at_s, time_s, true_m)
    return rms(aligned_errors_m(true_m, pdr.evaluate.positions_at(track.time_s, track.position_m, time_s)))


def group_of(name: str) -> str:
    """Group of a recording: data set and place or activity."""
    found = re.match(r"(motionsense)_s\d+_([a-z]+)|(oxiod)_\w*?_(floor|room)\d*_([a-z]+)|(tyrex)_\w+_(\w+)", name)
    return name.split("_anon")[0] if found is None else " ".join(word for word in found.groups() if word)


def walks(arguments: argparse.Namespace, sites: Sequence[str]) -> Iterator[tuple[pdr.Recording, pdr.Samples, str]]:
    """Recordings with gyroscope and attitude, which is left out; their acceleration without gravity; their groups."""
    for site in sites:
        for recording in recordings(arguments.data, site):
            if recording.gyroscope is None or recording.attitude is None or _NOT_WALKED.search(recording.name):
                continue
            if recording.duration_s < 20:
                continue
            side = "chosen" if _CHOSEN.match(recording.name) else "held out"
            force = recording.accelerometer
            linear = pdr.Samples(force.time_s, force.values - STANDARD_GRAVITY_MPS2 * up_of_phone(recording))
            yield replace(recording, attitude=None), linear, f"{group_of(recording.name)}, {side}"


def pairs(arguments: argparse.Namespace) -> Iterator[Pair]:
    """Yield the results of each recording with and without gravity."""
    for recording, linear, group in walks(arguments, arguments.sites):
        try:
            restored = with_gravity(linear, recording.gyroscope)
        except ValueError:
            yield Pair(group, is_refused=True)
            continue
        added, true = (force.values - linear.values for force in (restored.force, recording.accelerometer))
        is_mirrored = bool(np.nanmedian((added * true).sum(axis=1)) < 0)
        with_it = pdr.track(recording, gnss="off")
        without = pdr.track(replace(recording, accelerometer=restored.force), gnss="off")
        percent = 100 * (without.n_steps / with_it.n_steps - 1) if with_it.n_steps else np.nan
        shapes = shape_m(recording, without), shape_m(recording, with_it)
        if arguments.each:
            print(recording.name, round(percent, 1), np.round(shapes, 2), is_mirrored, restored.is_sense_sure)
        yield Pair(group, False, is_mirrored, restored.is_sense_sure, percent, shapes)


def counted(tables: Tables, arguments: argparse.Namespace) -> None:
    """Steps without gravity and without gyroscope."""
    found = dict[str, list[float]]()
    for recording, linear, group in walks(arguments, ["tyrex", "oxiod", "ipin2023"]):
        with_it = len(pdr.detect_steps(replace(recording, gyroscope=None)))
        with suppress(ValueError):  # refused
            force = with_gravity(linear).force
            without = len(pdr.detect_steps(replace(recording, accelerometer=force, gyroscope=None)))
            found.setdefault(group, []).append(abs(100 * (without / with_it - 1)) if with_it else np.nan)
    rows = [[group, len(percent), median_and(percent, 100, 1)] for group, percent in found.items()]
    tables.write("without_gravity_counted", ["walks, no gyroscope", "number", "steps %: median, worst"], rows)


def tracks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Steps and shape with and without gravity."""
    found = list(pairs(arguments))
    rows = list[list[object]]()
    for group in dict.fromkeys(pair.group for pair in found):
        of_group = [pair for pair in found if pair.group == group]
        tracked = [pair for pair in of_group if not pair.is_refused]
        percent = np.abs([pair.steps_percent for pair in tracked])
        without, with_it = np.array([pair.shape_m for pair in tracked]).reshape(-1, 2).T
        known = np.isfinite(without)
        shape = ["", ""]
        if known.any():
            medians = np.median(without[known]), np.median(with_it[known])
            shape = [f"{medians[0]:.2f}, {medians[1]:.2f}", f"{np.median(without[known] / with_it[known]):.2f}"]
        steps = [median_and(percent[np.isfinite(percent)], 100, 1)] if np.isfinite(percent).any() else [""]
        n_mirrored = sum(pair.is_mirrored for pair in tracked)
        n_told = sum(pair.is_mirrored and not pair.is_sure for pair in tracked)
        n_unsure = sum(not pair.is_sure for pair in tracked)
        mirrored = f"{n_mirrored} ({n_told})"
        rows.append([group, len(of_group), len(of_group) - len(tracked), *steps, *shape, mirrored, n_unsure])
    columns = "walks | number | refused | steps %: median, worst | shape m: without, with gravity | median ratio | "
    columns += "mirrored (of these unsure) | unsure"
    tables.write("without_gravity", columns, rows)


if __name__ == "__main__":
    run(__doc__, tracks, counted, sites=SITES, each=False)
