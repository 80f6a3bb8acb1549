"""Tracks on people, phones and placements that no model was trained on: recipes, axes, trust.

usage: python -m tests.benchmarks.placements [expected] [recipes] [corridors] [trust] [phone]
           [ear] [--data ../shared/data]

Three scalars were seen on oxiod: the step length's k is fitted to five sites of which it is one, and the limits of soft
running and of a field that jumps were looked at there.

expected: accuracy of the default by the place of the phone. Steps: error of the count on the walks of ubicomp13.
Distance and position: walks over a floor (oxiod, humolire in the hand). The distance is the walked distance against the
length of the reference, or of straight legs. The position error is the RMSE after rotation and translation onto the
reference of the first 20 % of the path, as if the start and the first direction were known.

recipes: oxiod against its continuous reference, at the times of the steps: RMSE of the position after rotation and
translation onto the whole reference; median over the walks of a group. The reference is averaged over half a second,
and on the trolley, where there are no steps, taken every second.

corridors: the same figure without axes, with them as they come, and smoothed; how many walks surely kept to them in
the end. They were chosen on humolire and ms_indoor, not on the others.

trust: share of the positions that are outside their 95 % ellipse, after the truth is rotated and shifted into the
track's frame by the first 20 % of the path, which then do not count. Beside it, share of the positions with a warning
of the report, its precision (share of the marked positions that are outside) and its recall (share of the positions
outside that are marked), and the share of all positions that are outside and not marked. Warnings are a handled phone,
unfamiliar motion, undecided contexts, a direction that strides do not show after the phone was moved, steps on the
spot, and a phone at the ear in curves. The covariance of the reference is added to the ellipse: 0.7 m along each axis
(humolire), 1 m (ms_indoor), 0.3 m (oxiod, tyrex), and the error of the rotation and shift that it causes. The limits
of the warnings were chosen on ipol, sisfall and ubicomp13. The classifier of phones at the ear was trained on tyrex. In
the back pocket of tyrex all positions outside without a warning are of one of two walks, in a room of 5 m where steps
are short at any cadence.

phone: the same positions and ellipses without and with the device of another walk of the same group, a day later. The
device is from the online track of that walk, or from its smoothed track with a fix of 0.5 m every twenty seconds
(humolire: every fourth waypoint). The last column also uses the person of the smoothed track. No number was chosen on
these walks.

ear: where the error of a walk with the phone at the ear comes from, beside the other walks of the same person. RMS
errors after alignment on the first 20 % of the path: of the track, with the true direction or the true length of each
step, without the constant drift of the direction that is best for the whole walk, and without the error of the
direction as averaged over Hann windows of 9 and 33 steps. The last columns are the shares of positions outside their
95 % ellipse if no head is ahead of the walking direction, and if it is.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal
from unittest.mock import patch

import numpy as np
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.sensing.heading import walking_heading
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.tracking import trust_report as report
from pdr_filter.tracking.step_statistics import is_handled, is_on_the_spot, is_unfamiliar
from pdr_filter.values import BoolArray, ComplexArray, FloatArray, interpolated_rows
from tests.benchmarks.common import Tables, places_of, recordings, run

RECIPES = ("default", "guo2018", "martinelli2018", "susi2013", "tian2016", "zhou2019")
REFERENCE_STD_M = {"humolire": 0.7, "ms_indoor": 1.0, "oxiod": 0.3, "tyrex": 0.3}


@dataclass(frozen=True)
class Walk:
    """A recording, its group, and where the person was."""

    group: str
    recording: pdr.Recording
    time_s: FloatArray  # (N,)
    position_m: FloatArray  # (N, 2)


def walks(data: Path, sites: tuple[str, ...] = ("oxiod", "humolire", "ms_indoor")) -> Iterator[Walk]:
    """Those with gyroscope and three places at least."""
    for site in sites:
        for recording in recordings(data, site):
            if recording.gyroscope is None:
                continue
            found = re.search(r"_(floor|room)\d*_([a-z]+)", recording.name)
            group = f"oxiod {found[1]} {found[2]}" if found else site
            if site == "tyrex":
                group = f"tyrex {recording.name.rsplit('_', 1)[1]}"
            truth = recording.truth.position if site in ("oxiod", "tyrex") else recording.truth.waypoints
            if truth is None or len(truth) < 3:
                continue
            yield Walk(group, recording, truth.time_s, places_of(truth))


def places(walk: Walk, track: pdr.Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, true places and those of the track: at waypoints, or at the steps where the reference is continuous."""
    when, true_m = walk.time_s, walk.position_m
    if len(when) > 300:
        inside = (track.time_s >= when[0]) & (track.time_s <= when[-1])
        times = track.time_s[inside] if inside.sum() >= 10 else np.arange(when[0], when[-1])
        when, true_m = times, interpolated_rows(times, when, true_m)
    return when, true_m, evaluate.positions_at(track.time_s, track.position_m, when)


def rmse_m(walk: Walk, track: pdr.Track) -> float:
    _, true_m, at_m = places(walk, track)
    return evaluate.position_rmse_m(at_m, true_m, "all")


def without_axes(config: pdr.Config) -> pdr.Config:
    heading = config.sensing.heading
    assert isinstance(heading, WalkingHeading)
    heading = replace(heading, corridors=replace(heading.corridors, rectangular_prob=1e-12))
    return replace(config, sensing=replace(config.sensing, heading=heading))


def grouped(rows: list[tuple[str, tuple[float, ...]]]) -> dict[str, FloatArray]:
    return {g: np.array([v for name, v in rows if name == g]) for g in sorted({name for name, _ in rows})}


CARRIED = {
    "in the hand": (("hand_held", "handheld_using"), ("humolire", "oxiod floor handheld")),
    "in a trouser pocket": (("trousers_front_pocket", "trousers_back_pocket"), ("oxiod floor pocket",)),
    "in a bag": (("backpack", "handbag"), ("oxiod floor handbag",)),
}


def distance_error(walk: Walk, track: pdr.Track) -> float:
    """Relative error of the walked distance: over straight legs, else along the continuous reference."""
    segments = walk.recording.truth.segments
    if segments is not None:
        moved_m = evaluate.moved_m(track.time_s, track.position_m, segments.start_s, segments.end_s)
        return float(moved_m.sum() / segments.distance_m.sum() - 1)
    inside = (track.time_s >= walk.time_s[0]) & (track.time_s <= walk.time_s[-1])
    grid_s = np.arange(track.time_s[inside][0], track.time_s[inside][-1], 1.0)
    true_m = interpolated_rows(grid_s, walk.time_s, walk.position_m)
    return float(track.step_length_m[inside].sum() / evaluate.path_m(true_m)[-1] - 1)


def position_error_m(walk: Walk, track: pdr.Track) -> tuple[float, float]:
    """RMSE after alignment on the first 20 % of the path, and the length of the path."""
    _, true_m, at_m = places(walk, track)
    return evaluate.position_rmse_m(at_m, true_m, "first"), float(evaluate.path_m(true_m)[-1])


def expected(tables: Tables, arguments: argparse.Namespace) -> None:
    """Accuracy of steps, distance and position by the place of the phone."""
    counts: dict[str, list[tuple[float, str]]] = {}
    for recording in recordings(arguments.data, "ubicomp13"):
        steps = pdr.detect_steps(recording)
        segment = recording.truth.segments[0]
        n = sum(segment["start_s"] - 1.0 <= step.time_s <= segment["end_s"] + 1.0 for step in steps)
        error = abs(n / segment["n_steps"] - 1)
        counts.setdefault(recording.name.split("_", 3)[3], []).append((error, str(recording.subject.id)))
    found: dict[str, list[tuple[float, float, float]]] = {}
    for walk in walks(arguments.data, ("humolire", "oxiod")):
        if any(walk.group in groups for _, groups in CARRIED.values()):
            track = pdr.track(walk.recording)
            found.setdefault(walk.group, []).append((abs(distance_error(walk, track)), *position_error_m(walk, track)))
    lines = []
    for carried, (at, groups) in CARRIED.items():
        errors = [e for place in at for e, _ in counts[place]]
        people = {who for place in at for _, who in counts[place]}
        distance, position_m, path_m = np.array([f for group in groups for f in found[group]]).T
        lines.append(
            [
                carried,
                f"{100 * np.mean(errors):.1f}, {100 * np.percentile(errors, 90):.1f}",
                f"{len(errors)}, {len(people)}",
                f"{100 * distance.mean():.1f}, {100 * distance.max():.1f}",
                f"{np.median(position_m):.1f}, {position_m.max():.1f}",
                f"{np.median(path_m):.0f}",
                len(distance),
            ]
        )
    columns = "phone | steps %: mean, 90 % | walks, people | distance %: mean, largest | position m: median, largest | "
    columns += "path m | walks"
    tables.write("expected_accuracy", columns, lines, "Absolute errors of the default recipe.")


def recipes(tables: Tables, arguments: argparse.Namespace) -> None:
    """oxiod by all recipes."""
    rows = [
        (
            w.group,
            tuple(rmse_m(w, pdr.track(w.recording, pdr.recipes.RECIPES[r](w.recording.subject))) for r in RECIPES),
        )
        for w in walks(arguments.data, ("oxiod",))
    ]
    lines = []
    for group, values in grouped(rows).items():
        medians = np.median(values, axis=0)
        lines.append([group, len(values), *(f"{m:.2f}" for m in medians), f"{values[:, 0].max():.1f}"])
    tables.write("placements", ["group", "walks", *RECIPES, "default, worst"], lines, "RMSE in m, medians.")


def corridors(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tracks without axes of buildings, with them, and smoothed."""
    rows: list[tuple[str, tuple[float, ...]]] = []
    for walk in walks(arguments.data):
        config = pdr.recipes.default(walk.recording.subject)
        track = pdr.track(walk.recording, config)
        if track.n_steps < 10:
            continue
        scores = [rmse_m(walk, t) for t in (pdr.track(walk.recording, without_axes(config)), track)]
        hindsight = rmse_m(walk, pdr.smooth(walk.recording, config=config).track)
        rows.append((walk.group, (*scores, hindsight, float(track.steps.on_axes[-1]))))
    lines = [
        [g, len(v), *(f"{np.median(v[:, k]):.2f}, {v[:, k].mean():.2f}" for k in range(3)), int(v[:, 3].sum())]
        for g, v in grouped(rows).items()
    ]
    columns = "walks of | n | without axes | with | smoothed | sure"
    tables.write("corridors", columns, lines, "RMSE in m: median, mean.")


def marked(track: pdr.Track) -> BoolArray:
    """Steps (K,) in a stretch that the report names as one not to trust."""
    windows = track.windows
    criteria = (
        (windows.time_s, is_handled(windows.irregular_prob, windows.standing_prob)),
        (windows.time_s, is_unfamiliar(windows.unknown_share)),
        (track.time_s, report.is_undecided(track)),
        (track.time_s, report.rows_without_direction(track)),
        (track.time_s, is_on_the_spot(track.is_quick_and_soft, track.direction_trust)),
        (track.time_s, report.turns_at_the_ear(track)),
    )
    found = np.zeros(track.n_steps, dtype=bool)
    for time_s, holds in criteria:
        for begin_s, end_s in report.long_stretches(time_s, holds):
            found |= (track.time_s >= begin_s) & (track.time_s <= end_s)
    return found


def alignment_cov_m2(true_m: FloatArray, used: BoolArray, std_m: float) -> FloatArray:
    """Covariances (N, 2, 2) of places that were rotated and shifted by the `used` ones, whose errors have this std."""
    from_centre = true_m - true_m[used].mean(axis=0)
    across = np.column_stack([-from_centre[:, 1], from_centre[:, 0]])
    turn_var = std_m**2 / (from_centre[used] ** 2).sum()
    return std_m**2 / used.sum() * np.eye(2) + turn_var * across[:, :, None] * across[:, None, :]


def errors_and_cov(
    walk: Walk, track: pdr.Track, std_m_of: Mapping[str, float] = REFERENCE_STD_M
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Times, errors (N, 2) and covariances (N, 2, 2) of the positions after alignment, and those used for it."""
    when, true_m, at_m = places(walk, track)
    first = evaluate.first_of_path(true_m)
    first[: max(3, int(first.sum()))] = True
    turned_m = evaluate.fitted(true_m, at_m, first)
    nearest = np.clip(np.searchsorted(track.time_s, when), 0, track.n_steps - 1)
    std_m = std_m_of[walk.group.split()[0]]
    cov = track.position_cov_m2[nearest] + std_m**2 * np.eye(2) + alignment_cov_m2(turned_m, first, std_m)
    return when, at_m - turned_m, cov, first


def percent(part: BoolArray, of: BoolArray) -> str:
    return f"{100 * part[of].mean():.0f} %" if of.any() else "-"


def trust(tables: Tables, arguments: argparse.Namespace) -> None:
    """Share of the positions outside their ellipse, and precision and recall of the warnings."""
    level = chi2.ppf(0.95, 2)
    rows: list[tuple[str, tuple[float, ...]]] = []
    for walk in walks(arguments.data, ("oxiod", "humolire", "ms_indoor", "tyrex")):
        track = pdr.track(walk.recording)
        if track.n_steps < 10:
            continue
        when, error_m, cov, first = errors_and_cov(walk, track)
        off = evaluate.nees(error_m, cov) > level
        doubted = marked(track)[np.clip(np.searchsorted(track.time_s, when), 0, track.n_steps - 1)]
        rows += [(walk.group, (float(o), float(d))) for o, d in zip(off[~first], doubted[~first], strict=True)]
    lines = []
    for group, found in grouped(rows).items():
        off, doubted = found.T > 0.5
        every = np.ones(len(off), dtype=bool)
        shares = percent(off, every), percent(doubted, every), percent(off, doubted), percent(doubted, off)
        lines.append([group, len(off), *shares, percent(off & ~doubted, every)])
    columns = "walks of | positions | outside | marked | precision | recall | outside and not marked"
    tables.write("trust", columns, lines)


def with_fixes(walk: Walk) -> pdr.Track:
    """Smoothed track of a walk with fixes from its reference."""
    when = walk.time_s[1::4]
    if len(walk.time_s) > 300:
        when = np.arange(walk.time_s[0] + 1.0, walk.time_s[-1], 20.0)
    at_m = interpolated_rows(when, walk.time_s, walk.position_m)
    fixes = [pdr.PositionFix(float(t), p, 0.25 * np.eye(2)) for t, p in zip(when, at_m, strict=True)]
    return pdr.smooth(walk.recording, fixes=fixes).track


def phone(tables: Tables, arguments: argparse.Namespace) -> None:
    """Ellipses without and with the device of another walk."""
    groups: dict[str, list[Walk]] = {}
    for walk in walks(arguments.data, ("oxiod", "humolire")):
        if "trolley" not in walk.group:
            groups.setdefault(walk.group, []).append(walk)
    lines = []
    for group, several in groups.items():
        if len(several) < 2:
            continue
        found: list[list[FloatArray]] = [[] for _ in range(4)]
        for walk, other in zip(several, [*several[1:], several[0]], strict=True):
            online, smoothed = pdr.track(other.recording), with_fixes(other)
            assert online.device is not None and smoothed.device is not None
            known = {"device": smoothed.device.after(days=1.0)}
            uses = ({}, {"device": online.device.after(days=1.0)}, known, known | {"person": smoothed.person})
            for rows, use in zip(found, uses, strict=True):
                _, error_m, cov, first = errors_and_cov(walk, pdr.track(walk.recording, **use))
                inside = evaluate.nees(error_m, cov) < chi2.ppf(0.95, 2)
                square_m2 = (error_m**2).sum(axis=1)
                rows.append(np.column_stack([inside, np.trace(cov, axis1=1, axis2=2), square_m2])[~first])
        cells = []
        for rows in found:
            inside, said_m2, square_m2 = np.concatenate(rows).mean(axis=0)
            cells.append(f"{np.sqrt(said_m2 / square_m2):.2f}, {100 * inside:.0f} %, {np.sqrt(square_m2):.2f}")
        lines.append([group, len(several), sum(len(rows) for rows in found[0]), *cells])
    columns = "walks of | n | positions | no device | device, online | device, smoothed | and person"
    about = "Standard deviation over error (RMS), share inside the 95 % ellipse, RMS error in m."
    tables.write("known_phone", columns, lines, about)


def error_m(ends_m: FloatArray, move: ComplexArray, use: Literal["first", "all"] = "first") -> float:
    """RMS error of the sum of moves (east + i north) after alignment on the first 20 % of the path, or on all."""
    moved_m = np.cumsum(move)
    return evaluate.position_rmse_m(np.column_stack([moved_m.real, moved_m.imag]), ends_m, use)


def ear(tables: Tables, arguments: argparse.Namespace) -> None:
    """Sources of the errors with the phone at the ear."""
    lines = []
    for walk in walks(arguments.data, ("tyrex",)):
        with patch.object(walking_heading, "_HEAD_AHEAD_S", 0.0):
            tracks = [pdr.track(walk.recording)]
        tracks.append(pdr.track(walk.recording))
        if tracks[0].n_steps < 20 or "running" in walk.group:
            continue
        time_s, duration_s = tracks[1].time_s, np.asarray(tracks[1].steps.duration_s)
        inside = (time_s - duration_s > walk.time_s[0]) & (time_s < walk.time_s[-1])
        time_s, duration_s = time_s[inside], duration_s[inside]
        starts_m, ends_m = (interpolated_rows(t, walk.time_s, walk.position_m) for t in (time_s - duration_s, time_s))
        east_north = np.array([1.0, 1.0j])
        move = np.diff(tracks[1].position_m, axis=0, prepend=0.0)[inside] @ east_north
        truth = (ends_m - starts_m) @ east_north
        ahead = truth / np.abs(truth)
        drifted = [move * np.exp(1j * rate * (time_s - time_s[0])) for rate in np.arange(-0.02, 0.0201, 0.0005)]
        turned = [np.convolve(np.abs(truth) * move / np.abs(move) / ahead, np.hanning(n + 2), "same") for n in (9, 33)]
        moves = [
            move,
            np.abs(move) * ahead,
            np.abs(truth) * move / np.abs(move),
            min(drifted, key=partial(error_m, ends_m, use="all")),
            *(move * np.abs(each) / each for each in turned),
        ]
        outside = []
        for track in tracks:
            _, errors, cov, first = errors_and_cov(walk, track)
            outside.append(f"{100 * np.mean(evaluate.nees(errors, cov)[~first] > chi2.ppf(0.95, 2)):.0f} %")
        name = walk.recording.name.split("nexus5_")[1].replace("_", " ")
        lines.append([name, len(move), *(f"{error_m(ends_m, each):.1f}" for each in moves), *outside])
    columns = (
        "walk | steps | track, m | true directions | true lengths | no drift | without 9 steps | without 33 steps | "
    )
    columns += "outside | outside, head ahead"
    tables.write("at_the_ear", columns, lines)


if __name__ == "__main__":
    run(__doc__, expected, recipes, corridors, trust, phone, ear)
