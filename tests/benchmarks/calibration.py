"""Calibration on walks that it has not seen, and coverage of its intervals: docs/benchmarks.md.

usage: python -m tests.benchmarks.calibration [left_out] [smoothed] [coverage] [--data ../shared/data]

left_out  whole walks of five sites. humolire: straight legs between landmarks; ms_indoor: between waypoints; oxiod and
          tyrex: walked lengths of stretches of 20 s along the path of a tracking system, lengths summed. Running,
          trolleys and a phone that is pointed around are left out.
smoothed  held-out walks after calibrations by smoothing, with waypoints or every third of them as fixes, and from
          segments. humolire: one walk of the person is held out; ms_indoor: one floor; ipin2023: one route. People of
          the last two are unknown, so that each recording is a person, and others get the population's parameters.
coverage  500 simulated calibrations: how often 95 % intervals have the truth; people with little data
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.offline.calibration.assembly import scale_std_of
from pdr_filter.offline.calibration.estimation import Hierarchy, estimate_parameters
from pdr_filter.offline.calibration.fit import calibrate_segments
from pdr_filter.offline.calibration.joint_smoothing import CalibrationWalk, estimate_jointly
from pdr_filter.offline.calibration.model_forms import forms_of, lengths, prior_means
from pdr_filter.offline.calibration.segments import (
    WAYPOINT_STD_M,
    Segment,
    SegmentSums,
    integrate,
    segments_of,
    truth_fixes,
)
from pdr_filter.offline.calibration.smoothed_calibration import calibration_walk
from pdr_filter.offline.smoothing.observations import waypoint_fixes
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS, table
from pdr_filter.values.recording import Recording, Truth
from tests.benchmarks.common import Tables, bias_spread_rms, recordings, run, way_of

FloatArray = NDArray[np.float64]


# --- real walks -----------------------------------------------------------------------------------------------------


def tracked(data: Path, site: str, pattern: str = "*.zip") -> list[tuple[Recording, Track]]:
    """Recordings of a site with their tracks."""
    return [(r, pdr.track(r)) for r in recordings(data, site, pattern)]


# --- simulated ------------------------------------------------------------------------------------------------------

# Parameters of eq. 12, their spread of the prior and of people, and a typical step.
MEAN, STD, BETWEEN = np.array([0.42, 0.18, 0.004]), np.array([0.1, 0.05, 0.005]), np.array([0.04, 0.0, 0.0])
TYPICAL = np.array([1.0, 1.9, 4.0])


def simulated(
    rng: np.random.Generator, n_people: int, per_person: int, outliers: float
) -> tuple[SegmentSums, Hierarchy, FloatArray, FloatArray]:
    """Sums of eq. 12 for people drawn from the prior; with the prior, the population's and the people's truth."""
    population = rng.normal(MEAN, STD)
    people = population + rng.normal(size=(n_people, 3)) * BETWEEN
    n = n_people * per_person
    person = np.repeat(np.arange(n_people), per_person)
    recording = np.arange(n) // max(per_person // 3, 1)
    n_steps = rng.integers(12, 20, n).astype(float)
    each = np.stack([np.ones(n), rng.normal(1.9, 0.15, n), rng.normal(4.0, 0.8, n)], axis=1) * n_steps[:, None]
    scale = 1 + rng.normal(0, 0.02, recording.max() + 1)
    error = rng.normal(size=n) * np.sqrt(0.35**2 + n_steps * 0.08**2)
    distance = (each * people[person]).sum(axis=1) * scale[recording] + error
    wrong = rng.random(n) < outliers
    distance[wrong] *= rng.choice([0.5, 2.0], wrong.sum())
    sums = SegmentSums(
        regressors=np.stack([each, np.zeros_like(each)], axis=1),
        offset_m=np.zeros((n, 2)),
        distance_m=np.maximum(distance, 0.1),
        anchor_std_m=np.full(n, 0.35),
        n_steps=n_steps,
        context=np.ones(n, dtype=int),
        subject=person,
        recording=recording,
        subjects=tuple(f"s{i}" for i in range(n_people)),
        recordings=tuple(f"r{i}" for i in range(int(recording.max()) + 1)),
    )
    return sums, Hierarchy(MEAN, STD, BETWEEN, np.full(len(CONTEXTS), 0.08), 0.02), population, people


def coverage(tables: Tables, arguments: argparse.Namespace) -> None:
    """How often 95 % intervals have the truth."""
    rows, n_runs = [], 500
    for n_people, per_person, outliers, loss in (
        (5, 12, 0.0, "gnc"),
        (5, 12, 0.0, "none"),
        (15, 3, 0.0, "gnc"),
        (5, 12, 0.1, "gnc"),
        (5, 12, 0.1, "cauchy"),
        (5, 12, 0.1, "huber"),
        (5, 12, 0.1, "none"),
    ):
        rng = np.random.default_rng(0)
        own, shared, square = [], [], []
        for _ in range(n_runs):
            sums, prior, population, people = simulated(rng, n_people, per_person, outliers)
            e = estimate_parameters(sums, prior, loss)
            std = np.sqrt(np.diagonal(e.people_cov, axis1=1, axis2=2))
            own.append(np.abs(e.people - people)[:, 0] < 1.96 * std[:, 0])
            shared.append(np.abs(e.population - population) < 1.96 * np.sqrt(np.diagonal(e.population_cov)))
            errors = [(e.people - people) @ TYPICAL, (e.population - people) @ TYPICAL]
            square.append([np.square(x).mean() for x in errors])
        k = np.mean(shared, axis=0)
        rms = 100 * np.sqrt(np.mean(square, axis=0))
        shares = [f"{100 * share:.1f} %" for share in (np.mean(own), *k)]
        figures = [f"{100 * outliers:.0f} %", loss, *shares, *(f"{v:.2f}" for v in rms)]
        rows.append([f"{n_people} x {per_person}", *figures])
    columns = "people x segments | wrong | loss | k0 of people | k0 | k1 | k2 | a person's step, cm | "
    columns += "the population's step, cm"
    about = f"{n_runs} simulated calibrations: share of 95 % intervals with the truth; RMS error of a typical step."
    tables.write("calibration_coverage", columns, rows, about)


def along_the_path(recording: Recording, track: Track) -> Recording:
    """The recording with the walked lengths of stretches of 20 s as truth, from its continuous reference.

    Below 0.7 Hz: a phone sways with the body, and a body with its steps. Stretches with a hole of more than 1.5 s, or
    that were hardly walked, are left out.
    """
    path = recording.truth.position
    assert path is not None
    grid_s, way_m = way_of(recording, below_hz=0.7)
    length_m = evaluate.path_m(way_m)
    edges_s = np.arange(max(path.time_s[0], track.time_s[0] - 0.5), min(path.time_s[-1], track.time_s[-1]), 20.0)
    walked = np.diff(np.interp(edges_s, grid_s, length_m))
    holes_s = path.time_s[1:][np.diff(path.time_s) > 1.5]
    stretches = zip(edges_s[:-1], edges_s[1:], walked, strict=True)
    good = [d > 3.0 and not ((holes_s > a) & (holes_s < b + 1.5)).any() for a, b, d in stretches]
    columns = {"start_s": edges_s[:-1][good], "end_s": edges_s[1:][good], "distance_m": walked[good]}
    segments = table(columns | {"n_steps": np.full(sum(good), np.nan)})
    return replace(recording, truth=Truth(segments=segments))


def five_sites(data: Path) -> dict[str, list[Segment]]:
    """Walking of one person each in four of them, and of 95 in a mall.

    The surveyors of ms_indoor have no names: each recording is of a person of its own.
    """
    sites = {
        site: [s for r, t in tracked(data, site) for s in segments_of(r, t, subject=r.name)[0]]
        for site in ("humolire", "ms_indoor")
    }
    for name, site, pattern in (
        ("oxiod, over a floor", "oxiod", "*floor1*.zip"),
        ("oxiod, in a room", "oxiod", "*room_[hp]*.zip"),
        ("tyrex", "tyrex", "*dist_[bfpst]*.zip"),
    ):
        found = tracked(data, site, pattern)
        cut_out = [s for r, t in found for s in segments_of(along_the_path(r, t), t, measure="length")[0]]
        sites[name] = [replace(s, subject="one") for s in cut_out]
    return sites


def theta_of(found: Calibration, subjects: tuple[str, ...]) -> FloatArray:
    """Parameters of people (S, P), the population's of those who were not calibrated."""
    known = found.subject_ids
    return np.array([found.people[known.index(s)] if s in known else found.theta for s in subjects])


def left_out(tables: Tables, arguments: argparse.Namespace) -> None:
    """Every tenth of the walks (every one, if there are ten or fewer) from the others."""
    priors, rows = forms_of()["bounce"], []
    start = np.concatenate([p.mean for p in priors.values()])
    for site, segments in five_sites(arguments.data).items():
        names = list(dict.fromkeys(s.recording for s in segments))
        walk = np.array([names.index(s.recording) for s in segments])
        before_m, after_m = np.empty((2, len(segments)))
        for k in np.unique(walk % 10):
            test = np.flatnonzero(walk % 10 == k)
            found = calibrate_segments([segments[i] for i in np.flatnonzero(walk % 10 != k)], priors)
            own = integrate([segments[i] for i in test], found.models, prior_means(priors))
            after_m[test] = lengths(own, theta_of(found, own.subjects))
            before_m[test] = lengths(own, np.tile(start, (len(own.subjects), 1)))
        true_m = np.bincount(walk, [s.distance_m for s in segments])
        before, after = (100 * (np.bincount(walk, m) / true_m - 1) for m in (before_m, after_m))
        rows.append([site, len(names), bias_spread_rms(before), bias_spread_rms(after), f"{np.abs(after).max():.1f}"])
    about = "Totals of held-out walks, default form: bias, spread, RMS in %. In ms_indoor the other walks are those of "
    about += "other people."
    columns = "site | walks | no calibration | from the other walks | largest error"
    tables.write("calibration_left_out", columns, rows, about)


def smoothed(tables: Tables, arguments: argparse.Namespace) -> None:
    """Walks held out by person or site, after calibrations from segments and by smoothing."""
    priors, rows = forms_of()["bounce"], []
    start = np.concatenate([p.mean for p in priors.values()])
    models, scale_std = {name: p.model for name, p in priors.items()}, scale_std_of(priors["walking"], 0.025)
    # all 100 walks of ms_indoor take an hour
    for site, position, every in (("humolire", -1, 1), ("ms_indoor", -2, 3), ("ipin2023", -2, 1)):
        known: dict[str, list[CalibrationWalk]] = {"waypoints": [], "every third": []}
        own: list[list[Segment]] = []
        for recording in islice(recordings(arguments.data, site), 0, None, every):
            segments = segments_of(recording, pdr.track(recording), subject=recording.name)[0]
            points = truth_fixes(recording) or waypoint_fixes(recording, WAYPOINT_STD_M / 2**0.5)
            if not segments or len(points) < 4:
                continue
            name = recording.subject.id or recording.name
            own.append([replace(s, subject=name) for s in segments])
            for what, fixes in (("waypoints", points), ("every third", points[::3])):
                walk = calibration_walk(recording, name, None, fixes, [], {}, "displacement", None, scale_std)[0]
                known[what].append(walk)
        group = np.array([s[0].recording.split("_")[position] for s in own])
        error: dict[str, list[float]] = {}
        for held_out in np.unique(group):
            training = np.flatnonzero(group != held_out).tolist()
            calibrated = calibrate_segments([s for i in training for s in own[i]], priors)
            people = list(dict.fromkeys(known["waypoints"][i].subject for i in training))
            for what in ("none", "segments", *known):
                if what in known:
                    found = estimate_jointly([known[what][i] for i in training], priors, {}, 0.025)
                    of_people, population = dict(zip(people, found.people, strict=True)), found.population
                else:
                    of_people = dict(zip(calibrated.subject_ids, calibrated.people, strict=True))
                    population = calibrated.theta
                for i in np.flatnonzero(group == held_out).tolist():
                    sums = integrate(own[i], models, prior_means(priors))
                    theta = start if what == "none" else of_people.get(own[i][0].subject, population)
                    error.setdefault(what, []).append(
                        100 * (lengths(sums, theta[None]).sum() / sums.distance_m.sum() - 1)
                    )
        # errors in the order of the groups
        rows.append(smoothed_row(site, {name: np.array(e) for name, e in error.items()}, np.sort(group)))
        print(rows[-1], flush=True)
    about = "Totals of held-out walks: bias, spread, RMS in %, and 95 % interval over walks of the RMS minus that "
    about += "without calibration. Mean of the others: each walk less the mean error of the other groups. Default "
    about += "form, every third recording of ms_indoor."
    columns = "site | walks, groups | no calibration | segments | smooth, waypoints | smooth, every third | "
    tables.write("calibration_smoothed", columns + "mean of the others", rows, about)


def smoothed_row(site: str, error: dict[str, FloatArray], group: NDArray[np.str_]) -> list[str]:
    """Row of the table of `smoothed`: errors in % of walks of these groups by the kind of calibration.

    The last column is the mean error of the other groups, taken off each walk: no better shift is known without it.
    """
    none = error["none"]
    others = none - np.array([none[group != one].mean() for one in group])
    drawn = np.random.default_rng(0).integers(0, len(none), (10_000, len(none)))
    rms = {name: np.sqrt(np.square(e[drawn]).mean(axis=1)) for name, e in error.items()}
    cells = [bias_spread_rms(none)]
    for name in ("segments", "waypoints", "every third"):
        low, high = np.percentile(rms[name] - rms["none"], [2.5, 97.5])
        cells.append(f"{bias_spread_rms(error[name])} ({low:+.1f} to {high:+.1f})")
    return [site, f"{len(none)}, {len(set(group))}", *cells, bias_spread_rms(others)]


if __name__ == "__main__":
    run(__doc__, left_out, smoothed, coverage)
