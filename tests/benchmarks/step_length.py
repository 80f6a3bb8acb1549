"""Every step-length model on sites that it has not seen, and the fit of Zhou's model.

usage: python -m tests.benchmarks.step_length [sites] [places] [slow] [zhou] [--data ../shared/data]

sites   bias and spread of the recordings of each left-out site, and the RMS of a recording of any site, sites alike.
        "Chosen by the others" takes for each site the model that is best on the other sites, each of those left out.
        People: RMS of the mean error of each (of a walk, where surveyors are not named). After five segments: the
        left-out person's scale from the first five stretches of 20 m, the RMS of that person's others, and of the sum
        of these. ubicomp13, one route of unknown length: spread of its predicted length over 66 walks.
places  the default as it ships, by site and place of the phone: in sample but for running, and but for ipin21.
slow    the default on slow to normal walks of one person with a phone in the hand (archeries, used for nothing else):
        mean step length against the strides of a module on the foot. A row of the truth may hold several strides: one
        of 2.5 m and more certainly does. Its number of strides is its length over 1.2 m, rounded. "As they come" takes
        each row for one stride. "Longer when slow" multiplies steps below 1.1 steps/s by sqrt(1.1 / f).
zhou    parameters of Zhou's two-segment model M7 for the `zhou2019` recipe; the paper prints none. Carried phone: by
        displacement (length of the sum of the step vectors) on the legs of humolire and ms_indoor, with the steps of
        the recipe's own detector, sites alike, outlying legs lightly. Foot: on
        pyshoe, the sum of the step lengths of each trial against the way of the foot between its stances (motion
        capture); every other trial is left out and scored.

Sites with known distances, the walks on foot of: humolire (straight legs by displacement), ms_indoor and ipin21
(waypoints more than 4 m apart, by displacement), oxiod (visual odometry over a floor, motion capture in a room) and
tyrex (motion capture), both by the path in stretches of eight steps, low-passed at 0.5 Hz, and ipol (20 m out and back;
steps in the turn on the spot count nothing). A site is left out as a whole: its people, phones and places. Parameters
are those with the least squared log error of the distances of recordings, outlying ones lightly (soft L1 at 10 %), all
sites alike; ipin21, one recording of 120 m, is never fitted to, only predicted.
"""

from __future__ import annotations

import argparse
import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.filter.step_length import models as models
from pdr_filter.filter.step_length.models import (
    BounceStepLength,
    LinearStepLengthModel,
    StepLengthModel,
    bounce_fit,
    length_and_jacobian,
)
from pdr_filter.recipes.zhou2019 import contexts as behaviours
from pdr_filter.recipes.zhou2019 import steps as zhou_steps
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Step, steps_of
from tests.benchmarks.common import Tables, bias_spread_rms, paths, run, way_of

FloatArray = NDArray[np.float64]
UNKNOWN_HEIGHT_M = 1.70
# A click is early by up to 0.8 s, or late by 0.1 s: about 0.25 m at each end of a leg.
LEG_STD_M = 0.35
# Prior of every linear model: each term of a typical step is 0 +- 0.7 m, the first one 0.7 +- 0.7 m. With a hundred
# legs it only decides between regressors that say the same (1, 1 / f and 1 / sqrt(f) over one person's cadences).
TERM_STD_M = 0.7
TYPICAL = Step(0.54, 0.54, 0.54, 1.85, 4.0, 3.5, -3.5, 13.8, 6.8, 1.7, 0.0, 0.0, vertical_amplitude_mps2=2.4)
CHEN_PRIOR = np.array([0.371, 0.227, 1.0]), np.array([0.3, 0.3, 0.3])


# --- models with an offset, and today's form with the cadence ---------------------------------------------------------


@dataclass(frozen=True)
class WithOffset:
    """L = k0 + k1 x: what the cube root of an acceleration leaves of the length at rest."""

    x: Callable[[Step], float]
    n_params: int = 2

    def regressors(self, step: Step) -> FloatArray:
        """(1, x)."""
        return np.array([1.0, self.x(step)])


@dataclass(frozen=True)
class WithCadence:
    """L = k h r (f A)^(1/4): the bounce with the cadence."""

    height_m: float
    n_params: int = 1

    def regressors(self, step: Step) -> FloatArray:
        """(h r (f A)^(1/4),)."""
        return BounceStepLength(self.height_m).regressors(step) * min(max(step.frequency_hz, 1.2), 2.4) ** 0.25


M1, M6, M7 = "M1 k0 + k1 f", "M6, Kim k cbrt(mean abs)", "M7 k0 + k1/f + k2/sqrt f + k3 max"
Make = Callable[[float], StepLengthModel]  # the model of a person of a height, m
MODELS: dict[str, Make] = {
    "static k h": models.StaticStepLength,
    M1: lambda h: models.FrequencyStepLength(),
    "M2, Martinelli k0 + k1 f + k2 var": lambda h: models.FrequencyVarianceStepLength(),
    "M3 k0 + k1/f + k2 max": lambda h: models.PeriodPeakStepLength(),
    "Weinberg k range^1/4": lambda h: models.WeinbergStepLength(),
    "M4 k range(magnitude)^1/4": lambda h: models.MagnitudeRangeStepLength(),
    "M5, Tian k h sqrt f": models.TianStepLength,
    M6: lambda h: models.KimStepLength(),
    M7: lambda h: models.ZhouWalkingStepLength(),
    "Chen a, b, c": models.ChenStepLength,
    "k h A^1/4": models.BounceStepLength,
    "Kim with offset k0 + k1 cbrt(mean abs)": lambda h: WithOffset(lambda s: float(np.cbrt(s.mean_abs_mps2))),
    "k0 + k1 A^1/3": lambda h: WithOffset(lambda s: float(np.cbrt(s.vertical_amplitude_mps2))),
    "k h (f A)^1/4": WithCadence,
}


# --- reading --------------------------------------------------------------------------------------------------------


def steps_in(recording: pdr.Recording) -> Sequence[Step]:
    """Steps of the default detector."""
    return steps_of(pdr.detect_steps(recording))


def height_of(recording: pdr.Recording) -> float:
    """Height of the person, or the usual one."""
    return recording.subject.height_m or UNKNOWN_HEIGHT_M


def landmarks(recording: pdr.Recording) -> list[tuple[float, float, float]]:
    """Start, end and length of the straight legs, or between waypoints more than 4 m apart."""
    segments, points = recording.truth.segments, recording.truth.waypoints
    if segments is not None:
        return [(float(s["start_s"]), float(s["end_s"]), float(s["distance_m"])) for s in segments]
    apart = np.hypot(np.diff(points.east_m), np.diff(points.north_m)).tolist()
    pairs = zip(points.time_s[:-1].tolist(), points.time_s[1:].tolist(), apart, strict=True)
    return [pair for pair in pairs if pair[2] > 4.0]


def shares(steps: Sequence[Step], start_s: float, end_s: float) -> FloatArray:
    """Part of each step (n,) that is inside a time."""
    end = np.array([s.time_s for s in steps])
    duration = np.array([s.duration_s for s in steps])
    return np.clip((np.minimum(end, end_s) - np.maximum(end - duration, start_s)) / duration, 0, 1)


@dataclass(frozen=True, eq=False)
class Route:
    """One walk of the one route of ubicomp13."""

    person: str
    place: str
    height_m: float
    n_steps: float  # counted on video
    steps: tuple[Step, ...]  # found


def route_of(path: Path) -> Route:
    """A walk of ubicomp13."""
    recording = pdr.read(path)
    walk = recording.truth.segments[0]
    inside = [s for s in steps_in(recording) if walk["start_s"] + 0.3 < s.time_s < walk["end_s"] + 0.3]
    _, person, _, place = path.stem.split("_", 3)
    return Route(person, place, height_of(recording), float(walk["n_steps"]), tuple(inside))


SITES = ("humolire", "ms_indoor", "oxiod", "tyrex", "ipol", "ipin21")
NEVER_FITTED = "ipin21"
LOG_STD = 0.1  # of the distance of a recording about a model of strangers
SHORTEST_M = 15.0  # of the distance of a recording
STRETCH_STEPS = 8
SEGMENT_M, N_SEGMENTS = 20.0, 5
# People, and one person's segments of 20 m, about the model: how far five of them are believed.
PEOPLE_STD, SEGMENT_STD = 0.07, 0.06


# --- distances --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stretch:
    """Steps over a known distance: the length along it is the sum of weight times length."""

    site: str
    recording: str
    person: str
    place: str  # of the phone
    height_m: float | None
    distance_m: float
    steps: tuple[Step, ...]
    weight: FloatArray  # (n,) the part inside, and the cosine of the direction where it is a displacement


def stretch(
    recording: pdr.Recording, steps: Sequence[Step], part: FloatArray, distance_m: float, person: str, place: str
) -> Stretch:
    """The steps that are inside."""
    used = np.flatnonzero(part > 0)
    own = tuple(steps[i] for i in used)
    site, height_m = str(recording.meta["dataset"]), recording.subject.height_m
    return Stretch(site, recording.name, person, place, height_m, distance_m, own, part[used])


def between_landmarks(recording: pdr.Recording, steps: Sequence[Step]) -> list[Stretch]:
    """Displacements between landmarks. Surveyors are not named: a walk is a person."""
    person = "humolire" if recording.meta["dataset"] == "humolire" else recording.name
    heading = np.array([s.device_heading_rad for s in steps])
    found: list[Stretch] = []
    for start_s, end_s, distance_m in landmarks(recording):
        part = shares(steps, start_s, end_s)
        along = np.arctan2(part @ np.sin(heading), part @ np.cos(heading))
        if part.sum() >= 4:
            found.append(stretch(recording, steps, part * np.cos(heading - along), distance_m, person, "hand"))
    return found


def along_the_reference(recording: pdr.Recording, steps: Sequence[Step]) -> list[Stretch]:
    """Stretches of eight steps in a row against the path of a continuous reference."""
    truth, name, label = recording.truth.position, recording.name, recording.truth.labels
    time_s, way_m = way_of(recording)
    path_m = evaluate.path_m(way_m)
    lost_s = truth.time_s[:-1][np.diff(truth.time_s) > 0.3]
    first_s, last_s = time_s[0] + 1, time_s[-1] - 1
    if len(label):
        first_s, last_s = max(first_s, label[0]["start_s"]), min(last_s, label[0]["end_s"])
    room = re.search(r"_(floor|room)", name)
    person = f"oxiod {room[1]}" if room else "tyrex"
    end = np.array([s.time_s for s in steps])
    start = end - np.array([s.duration_s for s in steps])
    found: list[Stretch] = []
    k = 0
    while k + STRETCH_STEPS < len(steps):
        n = k + STRETCH_STEPS
        start_s, end_s = start[k], end[n - 1]
        in_a_row = (np.abs(start[k + 1 : n] - end[k : n - 1]) < 0.15).all()
        is_lost = ((lost_s > start_s - 0.5) & (lost_s < end_s + 0.5)).any()
        if in_a_row and not is_lost and start_s > first_s and end_s < last_s:
            distance_m = float(np.diff(np.interp([start_s, end_s], time_s, path_m))[0])
            part = np.zeros(len(steps))
            part[k:n] = 1.0
            found.append(stretch(recording, steps, part, distance_m, person, place_of(name)))
            k = n
        else:
            k += 1
    return found


def out_and_back(recording: pdr.Recording, steps: Sequence[Step]) -> list[Stretch]:
    """10 m and 10 m back without the steps of the turn on the spot."""
    turn = re.search(r"from ([\d.]+) to ([\d.]+) s", str(recording.meta["notes"]))
    assert turn
    # a step that is in the turn for no more than 0.15 s is not of it
    away = [s.time_s < float(turn[1]) + 0.15 or s.time_s - s.duration_s > float(turn[2]) - 0.15 for s in steps]
    whole = recording.truth.segments[0]
    part = shares(steps, float(whole["start_s"]), float(whole["end_s"])) * np.array(away)
    person = f"ipol {recording.subject.id}"
    return [stretch(recording, steps, part, float(whole["distance_m"]), person, "lower back")]


def place_of(name: str) -> str:
    """Place of the phone in a name of oxiod or tyrex."""
    return re.sub(r"\d", "", name.split("_")[3] if name.startswith("oxiod") else name.split("_")[-1])


READERS = {"oxiod": along_the_reference, "tyrex": along_the_reference, "ipol": out_and_back}


@cache
def stretches_of(path: Path) -> tuple[Stretch, ...]:
    """Those of a recording; none where the phone does not go with the steps."""
    if path.stem.endswith("_ar") or "trolley" in path.stem:
        return ()
    recording = pdr.read(path)
    steps = steps_of(pdr.detect_steps(recording))
    return tuple(READERS.get(path.parent.name, between_landmarks)(recording, steps))


# --- fits -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Totals:
    """Sums over the stretches of recordings under a model: predicted distance = sums @ terms(theta)."""

    site: NDArray[np.str_]  # (n,)
    person: NDArray[np.str_]
    sums: FloatArray  # (n, p)
    distance_m: FloatArray

    def at(self, use: NDArray[np.bool_]) -> Totals:
        """Those of some recordings."""
        return Totals(self.site[use], self.person[use], self.sums[use], self.distance_m[use])


def is_chen(make: Make) -> bool:
    return type(make(1.7)).__name__ == "ChenStepLength"


def terms(make: Make, theta: FloatArray) -> FloatArray:
    """What the sums are multiplied with: theta, but for Chen's product."""
    return np.array([theta[0] * theta[2], theta[1] * theta[2], theta[2]]) if is_chen(make) else theta


def totals(make: Make, groups: Sequence[Sequence[Stretch]]) -> Totals:
    """Sums of groups of stretches."""
    rows: list[FloatArray] = []
    for group in groups:
        row = np.zeros(make(1.7).n_params)
        for s in group:
            model = make(s.height_m or UNKNOWN_HEIGHT_M)
            at = np.array([0.0, 0.0, 1.0]) if is_chen(make) else np.ones(model.n_params)
            row += sum(w * length_and_jacobian(model, step, at)[1] for w, step in zip(s.weight, s.steps, strict=True))
        rows.append(row)
    return Totals(
        np.array([g[0].site for g in groups]),
        np.array([g[0].person for g in groups]),
        np.array(rows),
        np.array([sum(s.distance_m for s in g) for g in groups]),
    )


def prior_of(make: Make) -> tuple[FloatArray, FloatArray]:
    """Weak prior of theta, as in step_length_models."""
    if is_chen(make):
        return CHEN_PRIOR
    model = make(UNKNOWN_HEIGHT_M)
    _, slope = length_and_jacobian(model, TYPICAL, np.ones(model.n_params))
    std = TERM_STD_M / slope
    return std * (np.arange(len(slope)) == 0), std


def log_errors(make: Make, theta: FloatArray, known: Totals) -> FloatArray:
    """Log of predicted over true distance, (n,)."""
    return np.log(np.maximum(known.sums @ terms(make, theta), 1e-3) / known.distance_m)


def fit_of(make: Make, known: Totals) -> FloatArray:
    """Theta (p,) from the sites that are fitted to."""
    used = known.at(known.site != NEVER_FITTED)
    mean, std = prior_of(make)
    n = np.array([np.sum(used.site == s) for s in used.site])
    weight = np.sqrt(20.0 / n) / LOG_STD  # each site as twenty recordings

    def residuals(theta: FloatArray) -> FloatArray:
        return np.concatenate([weight * log_errors(make, theta, used), (theta - mean) / std])

    start = mean + (0.0 if is_chen(make) else 0.3 * std)
    return np.asarray(least_squares(residuals, start, loss="soft_l1", f_scale=2.0, x_scale=std).x)


def left_out(make: Make, known: Totals) -> dict[str, FloatArray]:
    """Log errors of the recordings of each site, fitted without it."""
    return {
        site: log_errors(make, fit_of(make, known.at(known.site != site)), known.at(known.site == site))
        for site in dict.fromkeys(known.site.tolist())
    }


def rms_over_sites(errors: dict[str, FloatArray], of: str = "") -> float:
    """Root mean square of a recording of any site, sites alike; without one of them."""
    return float(np.sqrt(np.mean([np.mean(e**2) for site, e in errors.items() if site != of])))


def chosen_by_the_others(known: dict[str, Totals]) -> dict[str, FloatArray]:
    """Errors of each site under the model that is best on the others, where each of those is left out too."""
    result: dict[str, FloatArray] = {}
    for site in SITES:
        inner = {name: left_out(MODELS[name], t.at(t.site != site)) for name, t in known.items()}
        best = min(inner, key=lambda name: rms_over_sites(inner[name], NEVER_FITTED))
        print(f"for {site}: {best}", flush=True)
        result[site] = left_out(MODELS[best], known[best])[site]
    return result


def with_five_segments(make: Make, recordings: Totals, segments: Totals) -> tuple[float, float]:
    """RMS log error after a person's first five segments, site left out: of the others, and of their sum."""
    single: list[float] = []
    rest: list[float] = []
    for site in SITES:
        theta = fit_of(make, recordings.at(recordings.site != site))
        own = segments.at(segments.site == site)
        for person in dict.fromkeys(own.person.tolist()):
            one = own.at(own.person == person)
            e = log_errors(make, theta, one)
            if len(e) > N_SEGMENTS:
                belief = N_SEGMENTS / (N_SEGMENTS + (SEGMENT_STD / PEOPLE_STD) ** 2)
                after = e[N_SEGMENTS:] - belief * e[:N_SEGMENTS].mean()
                d = one.distance_m[N_SEGMENTS:]
                single.append(float(np.mean(after**2)))
                rest.append(float(np.log(d @ np.exp(after) / d.sum()) ** 2))
    return float(np.sqrt(np.mean(single))), float(np.sqrt(np.mean(rest)))


def rms_of_people(errors: dict[str, FloatArray], known: Totals) -> float:
    """RMS of the mean error of each person, sites alike."""
    squares = []
    for site, e in errors.items():
        person = known.person[known.site == site]
        squares.append(np.mean([e[person == p].mean() ** 2 for p in set(person.tolist())]))
    return float(np.sqrt(np.mean(squares)))


def segments_of(recordings: Sequence[Sequence[Stretch]]) -> list[list[Stretch]]:
    """Stretches of a recording put together to 20 m and more."""
    groups: list[list[Stretch]] = []
    for recording in recordings:
        group: list[Stretch] = []
        for one in recording:
            group.append(one)
            if sum(s.distance_m for s in group) >= SEGMENT_M - 0.1:
                groups.append(group)
                group = []
    return groups


# --- tables -----------------------------------------------------------------------------------------------------------


def percent(errors: FloatArray) -> str:
    e = 100 * np.expm1(errors)
    return f"{e.mean():+.1f} ± {e.std():.1f}" if len(e) > 1 else f"{e.mean():+.1f}"


def walks_of_sites(data: Path) -> list[list[Stretch]]:
    """Recordings of all sites that are long enough."""
    found = [list(stretches_of(p)) for site in SITES for p in paths(data, site)]
    return [w for w in found if sum(s.distance_m for s in w) >= SHORTEST_M]


def sites(tables: Tables, arguments: argparse.Namespace) -> None:
    """Every model on sites that were left out."""
    routes = [route_of(p) for p in paths(arguments.data, "ubicomp13")]
    walks = [w for w in walks_of_sites(arguments.data) if "running" not in w[0].place]
    segments = segments_of(walks)
    known = {n: totals(make, walks) for n, make in MODELS.items()}
    rows: list[list[str]] = []
    for n, make in MODELS.items():
        errors, theta = left_out(make, known[n]), fit_of(make, known[n])
        five = with_five_segments(make, known[n], totals(make, segments))
        route = [
            np.log(r.n_steps * np.mean([length_and_jacobian(make(r.height_m), s, theta)[0] for s in r.steps]))
            for r in routes
        ]
        figures = [percent(errors[s]) for s in SITES]
        last = [rms_over_sites(errors), rms_of_people(errors, known[n]), *five, float(np.std(route))]
        rows.append([n, str(len(theta)), *figures, *(f"{100 * value:.1f}" for value in last)])
        print(n, theta.round(4).tolist(), flush=True)
    errors = chosen_by_the_others(known)
    chosen = [*map(percent, errors.values()), f"{100 * rms_over_sites(errors):.1f}"]
    rows.append(["chosen by the others", "", *chosen, *4 * [""]])
    count = {s: sum(w[0].site == s for w in walks) for s in SITES}
    columns = ["model", "p", *(f"{s} ({n})" for s, n in count.items()), "RMS", "people"]
    columns += ["after five segments: one of 20 m", "their sum", "ubicomp13"]
    about = "Left-out sites (recordings): bias ± spread in %; height the person's where it is stated."
    tables.write("step_length_sites", columns, rows, about)


def log_error(stretches: Sequence[Stretch]) -> float:
    """Of the default as it ships, over some stretches."""
    fit_m = sum(
        w * bounce_fit(s.height_m).predict(step)[0]
        for s in stretches
        for w, step in zip(s.weight, s.steps, strict=True)
    )
    return float(np.log(fit_m / sum(s.distance_m for s in stretches)))


def places(tables: Tables, arguments: argparse.Namespace) -> None:
    """The default as it ships, by site and place of the phone."""
    by_place: dict[tuple[str, str], list[float]] = defaultdict(list)
    for walk in walks_of_sites(arguments.data):
        one = walk[0]
        group = one.person if one.site in ("oxiod", "ipol") else one.site
        by_place[group, one.place].append(log_error(walk))
    rows = [[group, place, str(len(e)), percent(np.array(e))] for (group, place), e in by_place.items()]
    tables.write("step_length_places", ["who, where", "place of the phone", "recordings", "bias ± spread %"], rows)


def detected(recording: pdr.Recording, on_foot: bool) -> list[Step]:
    """Steps of the recipe's detector."""
    thresholds, detector = (behaviours.FOOT, zhou_steps.FOOT) if on_foot else (behaviours.CARRIED, zhou_steps.CARRIED)
    sensing = Sensing(contexts=behaviours.BehaviourStage(thresholds=thresholds), steps=detector)
    return [event for event in run_sensing(sensing, recording)[1] if isinstance(event, Step)]


def way_of_the_foot_m(recording: pdr.Recording) -> float:
    """Sum of the distances between the places where the foot stands."""
    truth = recording.truth.position
    place = np.column_stack([truth.east_m, truth.north_m])
    grid_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.01)
    at = np.column_stack([np.interp(grid_s, truth.time_s, p) for p in place.T])
    smooth = np.column_stack([np.convolve(np.pad(p, 4, mode="edge"), np.hanning(9) / 4, "valid") for p in at.T])
    stands = np.linalg.norm(np.gradient(smooth, 0.01, axis=0), axis=1) < 0.35
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands, [0]]).astype(int))).reshape(-1, 2)
    stances = [smooth[a:b].mean(axis=0) for a, b in edges if b - a >= 6]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(stances)))


@dataclass(frozen=True, eq=False)
class Leg:
    """Steps over a known distance, with their parts inside and their directions."""

    site: str
    distance_m: float
    steps: Sequence[Step]
    part: FloatArray  # (n,)
    heading_rad: FloatArray  # (n,)

    def vectors(self, model: LinearStepLengthModel) -> FloatArray:
        """Matrix (2, p) whose product with the parameters is the sum of the step vectors."""
        along = np.stack([np.sin(self.heading_rad), np.cos(self.heading_rad)])
        return along @ (self.part[:, None] * np.array([model.regressors(step) for step in self.steps]))


def distances(vectors: FloatArray, theta: FloatArray) -> FloatArray:
    """Lengths (n,) of the sums of the step vectors of legs, whose matrices are (n, 2, p)."""
    return np.linalg.norm(vectors @ theta, axis=1)


def fit_of_legs(make: Make, legs: Sequence[Leg], vectors: FloatArray) -> FloatArray:
    """Parameters (p,): all sites have the same weight, and outlying legs have little (soft L1)."""
    site, distance_m = np.array([leg.site for leg in legs]), np.array([leg.distance_m for leg in legs])
    weight = np.sqrt(100 / (site[:, None] == site).sum(axis=1)) / LEG_STD_M
    mean, std = prior_of(make)

    def residuals(theta: FloatArray) -> FloatArray:
        return np.concatenate([weight * (distances(vectors, theta) - distance_m), (theta - mean) / std])

    return np.asarray(least_squares(residuals, mean, loss="soft_l1", x_scale=std).x)


def trial(path: Path) -> Leg:
    """A whole trial as one leg whose step lengths are summed."""
    recording = pdr.read(path)
    found = detected(recording, on_foot=True)
    return Leg("pyshoe", way_of_the_foot_m(recording), found, np.ones(len(found)), np.zeros(len(found)))


def legs_of(path: Path) -> list[Leg]:
    """Legs of a walk of humolire or ms_indoor with at least four steps."""
    recording = pdr.read(path)
    steps, legs = detected(recording, on_foot=False), list[Leg]()
    heading = np.array([s.device_heading_rad for s in steps])
    for start_s, end_s, distance_m in landmarks(recording):
        part = shares(steps, start_s, end_s)
        if part.sum() >= 4:
            legs.append(Leg(path.parent.name, distance_m, steps, part, heading))
    return legs


def zhou(tables: Tables, arguments: argparse.Namespace) -> None:
    """Parameters of Zhou's model for a foot and for a carried phone; no table."""
    trials = [trial(p) for p in paths(arguments.data, "pyshoe")]
    trials = [t for t in trials if len(t.steps) > 4]
    for name in (M7, M1, M6):
        make = MODELS[name]
        vectors = np.array([t.vectors(make(UNKNOWN_HEIGHT_M)) for t in trials])
        theta = fit_of_legs(make, trials[::2], vectors[::2])
        error = 100 * (distances(vectors[1::2], theta) / [t.distance_m for t in trials[1::2]] - 1)
        print(
            f"foot, {name}: theta {np.round(theta, 4)}; {len(error)} trials left out: bias {error.mean():+.1f} %, "
            f"spread {error.std():.1f} %; all trials: theta {np.round(fit_of_legs(make, trials, vectors), 4)}"
        )
    legs = [leg for site in ("humolire", "ms_indoor") for p in paths(arguments.data, site) for leg in legs_of(p)]
    for name in (M7, M6):
        vectors = np.array([leg.vectors(MODELS[name](UNKNOWN_HEIGHT_M)) for leg in legs])
        print(f"carried, {name}: theta {np.round(fit_of_legs(MODELS[name], legs, vectors), 4)} ({len(legs)} legs)")


SLOW_HZ, USUAL_STRIDE_M = 1.1, 1.2


def slow(tables: Tables, arguments: argparse.Namespace) -> None:
    """The default on slow walks."""
    lines, errors = list[list[object]](), list[FloatArray]()
    for path in paths(arguments.data, "archeries"):
        recording = pdr.read(path)
        strides = recording.truth.strides
        if strides is None or "20181024" in path.stem:  # some of its strides have no row
            continue
        track = pdr.track(recording)
        inside = (track.time_s > strides.start_s.min() - 0.2) & (track.time_s < strides.end_s.max() + 0.2)
        length_m = track.step_length_m[inside]
        longer_m = length_m * np.sqrt(np.maximum(SLOW_HZ / np.asarray(track.steps.frequency_hz)[inside], 1.0))
        n = np.maximum(np.round(strides.length_m / USUAL_STRIDE_M), 1.0)
        found_m = 2 * np.array([length_m.mean(), length_m.mean(), longer_m.mean()])
        true_m = np.array([strides.length_m.mean(), *2 * [strides.length_m.sum() / n.sum()]])
        errors.append(100 * (found_m / true_m - 1))
        steps_hz = 2 * n.sum() / (strides.end_s.max() - strides.start_s.min())
        known = [path.stem[-6:], f"{steps_hz:.2f}", len(n), int((n > 1).sum())]
        lines.append([*known, *(f"{error:+.1f}" for error in errors[-1])])
    lines.append(["all: bias, spread, RMS", "", "", "", *(bias_spread_rms(e) for e in np.array(errors).T)])
    columns = "walk | steps/s | rows | rows of several strides | as they come % | split % | longer when slow, split %"
    tables.write("step_length_slow", columns, lines, "Error of the mean step length.")


if __name__ == "__main__":
    run(__doc__, sites, places, slow, zhou)
