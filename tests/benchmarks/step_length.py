"""Every step-length model on walks and sites that it has not seen, and the fit of Zhou's model.

usage: python -m tests.benchmarks.step_length [walks] [sites] [places] [slow] [zhou] [--data ../shared/data]

walks   humolire, one walk left out of 9: parameters from the straight legs of the others, error of the legs' sum and of
        each leg. Fitted and scored by displacement (length of the sum of the step vectors of a leg), and, for
        comparison, by the sum of the step lengths.
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
        displacement on the legs of humolire and ms_indoor, with the steps of the recipe's own detector. Foot: on
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
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from pdr_filter.filter.step_length import models as models
from pdr_filter.filter.step_length.models import BounceStepLength, StepLengthModel, bounce_fit, length_and_jacobian
from pdr_filter.recipes.zhou2019 import contexts as behaviours
from pdr_filter.recipes.zhou2019 import steps as zhou_steps
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Step, steps_of
from tests.benchmarks.common import Tables, bias_spread_rms, paths, run

FloatArray = NDArray[np.float64]
UNKNOWN_HEIGHT_M = 1.70
# A click is early by up to 0.8 s, or late by 0.1 s: about 0.25 m at each end of a leg.
LEG_STD_M = 0.35
# Prior of every linear model: each term of a typical step is 0 +- 0.7 m, the first one 0.7 +- 0.7 m. With a hundred
# legs it only decides between regressors that say the same (1, 1 / f and 1 / sqrt(f) over one person's cadences).
TERM_STD_M = 0.7
TYPICAL = Step(0.54, 0.54, 0.54, 1.85, 4.0, 3.5, -3.5, 13.8, 6.8, 1.7, 0.0, 0.0, vertical_amplitude_mps2=2.4)
CHEN_PRIOR = np.array([0.371, 0.227, 1.0]), np.array([0.3, 0.3, 0.3])

MODELS: dict[str, Callable[[float], StepLengthModel]] = {
    "static k h": models.StaticStepLength,
    "M1 k0 + k1 f": lambda h: models.FrequencyStepLength(),
    "M2, Martinelli k0 + k1 f + k2 var": lambda h: models.FrequencyVarianceStepLength(),
    "M3 k0 + k1/f + k2 max": lambda h: models.PeriodPeakStepLength(),
    "Weinberg k range^1/4": lambda h: models.WeinbergStepLength(),
    "M4 k range(magnitude)^1/4": lambda h: models.MagnitudeRangeStepLength(),
    "M5, Tian k h sqrt f": models.TianStepLength,
    "M6, Kim k cbrt(mean abs)": lambda h: models.KimStepLength(),
    "M7 k0 + k1/f + k2/sqrt f + k3 max": lambda h: models.ZhouWalkingStepLength(),
    "Chen a, b, c": models.ChenStepLength,
    "k h A^1/4": lambda h: models.BounceStepLength(h),
}


@dataclass(frozen=True, eq=False)
class Leg:
    """Steps between two landmarks and how far these are apart."""

    site: str
    walk: str
    height_m: float
    distance_m: float
    steps: tuple[Step, ...]
    part: FloatArray  # (n,) of each step that is inside
    heading_rad: FloatArray  # (n,)


def lengths(model: StepLengthModel, leg: Leg, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths (n,) of the parts of the steps inside a leg, and their derivative (n, p)."""
    pairs = [length_and_jacobian(model, step, theta) for step in leg.steps]
    return leg.part * np.array([p[0] for p in pairs]), leg.part[:, None] * np.array([p[1] for p in pairs])


def displacement(model: StepLengthModel, leg: Leg, theta: FloatArray) -> tuple[float, FloatArray]:
    """Length of the sum of the step vectors and its derivative (p,)."""
    length, jacobian = lengths(model, leg, theta)
    along = np.stack([np.sin(leg.heading_rad), np.cos(leg.heading_rad)])
    vector = along @ length
    distance = float(np.hypot(*vector))
    return distance, vector @ (along @ jacobian) / distance


def summed(model: StepLengthModel, leg: Leg, theta: FloatArray) -> tuple[float, FloatArray]:
    """Sum of the step lengths and its derivative (p,)."""
    length, jacobian = lengths(model, leg, theta)
    return float(length.sum()), jacobian.sum(axis=0)


Measure = Callable[[StepLengthModel, Leg, FloatArray], tuple[float, FloatArray]]


def fit(make: Callable[[float], StepLengthModel], legs: list[Leg], measure: Measure) -> FloatArray:
    """Theta (p,): sites weigh alike, outlying legs little (soft L1)."""
    count = {site: sum(leg.site == site for leg in legs) for site in {leg.site for leg in legs}}
    weight = np.array([np.sqrt(100 / count[leg.site]) / LEG_STD_M for leg in legs])
    model = make(UNKNOWN_HEIGHT_M)
    if isinstance(model, models.ChenStepLength):
        mean, std = CHEN_PRIOR
    else:
        _, terms = length_and_jacobian(model, TYPICAL, np.ones(model.n_params))
        std = TERM_STD_M / terms
        mean = std * (np.arange(len(terms)) == 0)

    def both(theta: FloatArray) -> list[tuple[float, FloatArray]]:
        return [measure(make(leg.height_m), leg, theta) for leg in legs]

    def residuals(theta: FloatArray) -> FloatArray:
        error = np.array([d - leg.distance_m for (d, _), leg in zip(both(theta), legs, strict=True)])
        return np.concatenate([weight * error, (theta - mean) / std])

    def jacobian(theta: FloatArray) -> FloatArray:
        return np.concatenate([weight[:, None] * np.array([j for _, j in both(theta)]), np.diag(1 / std)])

    return np.asarray(least_squares(residuals, mean, jac=jacobian, loss="soft_l1", x_scale=std).x)


def errors(
    make: Callable[[float], StepLengthModel], legs: list[Leg], theta: FloatArray, measure: Measure
) -> FloatArray:
    """Predicted and true metres of each leg, (n, 2)."""
    return np.array([(measure(make(leg.height_m), leg, theta)[0], leg.distance_m) for leg in legs])


def walks_of(legs: list[Leg]) -> dict[str, list[Leg]]:
    """Legs by walk."""
    found: dict[str, list[Leg]] = defaultdict(list)
    for leg in legs:
        found[leg.walk].append(leg)
    return found


# --- reading --------------------------------------------------------------------------------------------------------


def steps_in(recording: pdr.Recording) -> Sequence[Step]:
    """Steps of the default detector."""
    return steps_of(pdr.detect_steps(recording))


def height_of(recording: pdr.Recording) -> float:
    """Height of the person, or the usual one."""
    return recording.subject.height_m or UNKNOWN_HEIGHT_M


def legs_between_landmarks(path: Path, detected: Callable[[pdr.Recording], Sequence[Step]] = steps_in) -> list[Leg]:
    """Legs of a walk of humolire or ms_indoor with at least four steps."""
    recording = pdr.read(path)
    site = str(recording.meta["dataset"])
    steps = detected(recording)
    end = np.array([s.time_s for s in steps])
    duration = np.array([s.duration_s for s in steps])
    legs: list[Leg] = []
    for start_s, end_s, distance_m in stretches(recording, site):
        part = np.clip((np.minimum(end, end_s) - np.maximum(end - duration, start_s)) / duration, 0, 1)
        used = np.flatnonzero(part > 0)
        if part.sum() >= 4:
            own = tuple(steps[i] for i in used)
            heading = np.array([s.device_heading_rad for s in own])
            legs.append(Leg(site, recording.name, height_of(recording), distance_m, own, part[used], heading))
    return legs


def stretches(recording: pdr.Recording, site: str) -> list[tuple[float, float, float]]:
    """Start, end and length of the stretches between landmarks."""
    if site == "humolire":
        segments = recording.truth.segments
        return [(float(s["start_s"]), float(s["end_s"]), float(s["distance_m"])) for s in segments]
    points = recording.truth.waypoints
    distance = np.hypot(np.diff(points.east_m), np.diff(points.north_m))
    pairs = zip(points.time_s[:-1], points.time_s[1:], distance, strict=True)
    return [(float(a), float(b), float(d)) for a, b, d in pairs if d > 4.0]


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


# --- tables ---------------------------------------------------------------------------------------------------------


def walks(tables: Tables, arguments: argparse.Namespace) -> None:
    """One walk of humolire left out of nine."""
    legs = [leg for p in paths(arguments.data, "humolire") for leg in legs_between_landmarks(p)]
    rows = []
    by_walk = walks_of(legs)
    for name, make in MODELS.items():
        row = [name, str(make(UNKNOWN_HEIGHT_M).n_params)]
        for measure in (displacement, summed):
            total: list[float] = []
            one: list[float] = []
            for walk, own in by_walk.items():
                theta = fit(make, [leg for leg in legs if leg.walk != walk], measure)
                predicted, true = errors(make, own, theta, measure).T
                total.append(100 * (predicted.sum() / true.sum() - 1))
                one += list(100 * (predicted / true - 1))
            t, o = np.array(total), np.array(one)
            row.append(f"{np.sqrt((t**2).mean()):.2f}")
            row += [f"{t.mean():+.2f}", f"{t.std():.2f}"] if measure is displacement else []
            row.append(f"{np.sqrt((o**2).mean()):.2f}")
        rows.append(row)
    columns = ["model", "p", "total %RMSE", "bias %", "spread %", "leg %RMSE"]
    about = f"humolire, {len(by_walk)} walks, {len(legs)} legs, {sum(leg.distance_m for leg in legs):.0f} m."
    columns += ["summed: total %RMSE", "summed: leg %RMSE"]
    tables.write("step_length_walk_left_out", columns, rows, about)


SITES = ("humolire", "ms_indoor", "oxiod", "tyrex", "ipol", "ipin21")
NEVER_FITTED = "ipin21"
LOG_STD = 0.1  # of the distance of a recording about a model of strangers
SHORTEST_M = 15.0  # of the distance of a recording
STRETCH_STEPS = 8
SEGMENT_M, N_SEGMENTS = 20.0, 5
# People, and one person's segments of 20 m, about the model: how far five of them are believed.
PEOPLE_STD, SEGMENT_STD = 0.07, 0.06


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


ALL: dict[str, Callable[[float], StepLengthModel]] = {
    **MODELS,
    "Kim with offset k0 + k1 cbrt(mean abs)": lambda h: WithOffset(lambda s: float(np.cbrt(s.mean_abs_mps2))),
    "k0 + k1 A^1/3": lambda h: WithOffset(lambda s: float(np.cbrt(s.vertical_amplitude_mps2))),
    "k h (f A)^1/4": WithCadence,
}


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


def shares(steps: Sequence[Step], start_s: float, end_s: float) -> FloatArray:
    """Part of each step (n,) that is inside a time."""
    end = np.array([s.time_s for s in steps])
    duration = np.array([s.duration_s for s in steps])
    return np.clip((np.minimum(end, end_s) - np.maximum(end - duration, start_s)) / duration, 0, 1)


def stretch(
    recording: pdr.Recording, steps: Sequence[Step], part: FloatArray, distance_m: float, person: str, place: str
) -> Stretch:
    """The steps that are inside."""
    used = np.flatnonzero(part > 0)
    own = tuple(steps[i] for i in used)
    site, height_m = str(recording.meta["dataset"]), recording.subject.height_m
    return Stretch(site, recording.name, person, place, height_m, distance_m, own, part[used])


def between_landmarks(recording: pdr.Recording, steps: Sequence[Step]) -> list[Stretch]:
    """Displacements: straight legs, or waypoints more than 4 m apart. Surveyors are not named: a walk is a person."""
    site = recording.meta["dataset"]
    if site == "humolire":
        known = [(float(s["start_s"]), float(s["end_s"]), float(s["distance_m"])) for s in recording.truth.segments]
    else:
        p = recording.truth.waypoints
        apart = np.hypot(np.diff(p.east_m), np.diff(p.north_m))
        known = [v for v in zip(p.time_s[:-1].tolist(), p.time_s[1:].tolist(), apart.tolist(), strict=True) if v[2] > 4]
    heading = np.array([s.device_heading_rad for s in steps])
    found: list[Stretch] = []
    for start_s, end_s, distance_m in known:
        part = shares(steps, start_s, end_s)
        along = np.arctan2(part @ np.sin(heading), part @ np.cos(heading))
        if part.sum() >= 4:
            person = "humolire" if site == "humolire" else recording.name
            found.append(stretch(recording, steps, part * np.cos(heading - along), distance_m, person, "hand"))
    return found


def along_the_reference(recording: pdr.Recording, steps: Sequence[Step]) -> list[Stretch]:
    """Stretches of eight steps in a row against the path of a continuous reference."""
    truth, name, label = recording.truth.position, recording.name, recording.truth.labels
    time_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.02)
    place = np.column_stack([np.interp(time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    smooth = sosfiltfilt(butter(2, 0.5, fs=50, output="sos"), place, axis=0)
    path_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
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


def is_chen(make: Callable[[float], StepLengthModel]) -> bool:
    return type(make(1.7)).__name__ == "ChenStepLength"


def terms(make: Callable[[float], StepLengthModel], theta: FloatArray) -> FloatArray:
    """What the sums are multiplied with: theta, but for Chen's product."""
    return np.array([theta[0] * theta[2], theta[1] * theta[2], theta[2]]) if is_chen(make) else theta


def totals(make: Callable[[float], StepLengthModel], groups: Sequence[Sequence[Stretch]]) -> Totals:
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


def prior_of(make: Callable[[float], StepLengthModel]) -> tuple[FloatArray, FloatArray]:
    """Weak prior of theta, as in step_length_models."""
    if is_chen(make):
        return CHEN_PRIOR
    model = make(UNKNOWN_HEIGHT_M)
    _, slope = length_and_jacobian(model, TYPICAL, np.ones(model.n_params))
    std = TERM_STD_M / slope
    return std * (np.arange(len(slope)) == 0), std


def log_errors(make: Callable[[float], StepLengthModel], theta: FloatArray, known: Totals) -> FloatArray:
    """Log of predicted over true distance, (n,)."""
    return np.log(np.maximum(known.sums @ terms(make, theta), 1e-3) / known.distance_m)


def fit_of(make: Callable[[float], StepLengthModel], known: Totals) -> FloatArray:
    """Theta (p,) from the sites that are fitted to."""
    used = known.at(known.site != NEVER_FITTED)
    mean, std = prior_of(make)
    n = np.array([np.sum(used.site == s) for s in used.site])
    weight = np.sqrt(20.0 / n) / LOG_STD  # each site as twenty recordings

    def residuals(theta: FloatArray) -> FloatArray:
        return np.concatenate([weight * log_errors(make, theta, used), (theta - mean) / std])

    start = mean + (0.0 if is_chen(make) else 0.3 * std)
    return np.asarray(least_squares(residuals, start, loss="soft_l1", f_scale=2.0, x_scale=std).x)


def left_out(make: Callable[[float], StepLengthModel], known: Totals) -> dict[str, FloatArray]:
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
        inner = {name: left_out(ALL[name], t.at(t.site != site)) for name, t in known.items()}
        best = min(inner, key=lambda name: rms_over_sites(inner[name], NEVER_FITTED))
        print(f"for {site}: {best}", flush=True)
        result[site] = left_out(ALL[best], known[best])[site]
    return result


def with_five_segments(
    make: Callable[[float], StepLengthModel], recordings: Totals, segments: Totals
) -> tuple[float, float]:
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
    known = {n: totals(make, walks) for n, make in ALL.items()}
    rows: list[list[str]] = []
    for n, make in ALL.items():
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


def trial(path: Path) -> Leg:
    """A whole trial as one leg."""
    recording = pdr.read(path)
    found = tuple(detected(recording, on_foot=True))
    return Leg(
        "pyshoe", path.stem, 1.75, way_of_the_foot_m(recording), found, np.ones(len(found)), np.zeros(len(found))
    )


def zhou(tables: Tables, arguments: argparse.Namespace) -> None:
    """Parameters of Zhou's model for a foot and for a carried phone; no table."""
    data = arguments.data
    m7, kim = MODELS["M7 k0 + k1/f + k2/sqrt f + k3 max"], MODELS["M6, Kim k cbrt(mean abs)"]

    trials = [trial(p) for p in paths(data, "pyshoe")]
    trials = [t for t in trials if len(t.steps) > 4]
    for name, model in (("M7", m7), ("M1", MODELS["M1 k0 + k1 f"]), ("Kim", kim)):
        theta = fit(model, trials[::2], summed)
        error = np.array([100 * (summed(model(1.75), t, theta)[0] / t.distance_m - 1) for t in trials[1::2]])
        print(
            f"foot, {name}: theta {np.round(theta, 4)}; {len(error)} trials left out: bias {error.mean():+.1f} %, "
            f"spread {error.std():.1f} %; all trials: theta {np.round(fit(model, trials, summed), 4)}"
        )

    legs = [
        leg
        for site in ("humolire", "ms_indoor")
        for path in paths(data, site)
        for leg in legs_between_landmarks(path, lambda recording: detected(recording, on_foot=False))
    ]
    for name, model in (("M7", m7), ("Kim", kim)):
        theta = fit(model, legs, displacement)
        print(f"carried, {name}: theta {np.round(theta, 4)} ({len(legs)} legs)")


SLOW_HZ, USUAL_STRIDE_M = 1.1, 1.2


def slow(tables: Tables, arguments: argparse.Namespace) -> None:
    """The default on slow walks."""
    lines: list[list[object]] = []
    errors: list[tuple[float, float, float]] = []
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
        true_m = strides.length_m.sum() / n.sum()
        as_come, split, longer = (
            100 * (2 * ours_m.mean() / m - 1)
            for ours_m, m in ((length_m, strides.length_m.mean()), (length_m, true_m), (longer_m, true_m))
        )
        errors.append((as_come, split, longer))
        steps_hz = 2 * n.sum() / (strides.end_s.max() - strides.start_s.min())
        lines.append(
            [
                path.stem[-6:],
                f"{steps_hz:.2f}",
                len(n),
                int((n > 1).sum()),
                f"{as_come:+.1f}",
                f"{split:+.1f}",
                f"{longer:+.1f}",
            ]
        )
    lines.append(["all: bias, spread, RMS", "", "", "", *(bias_spread_rms(e) for e in np.array(errors).T)])
    columns = [
        "walk",
        "steps/s",
        "rows",
        "rows of several strides",
        "as they come %",
        "split %",
        "longer when slow, split %",
    ]
    tables.write("step_length_slow", columns, lines, "Error of the mean step length.")


if __name__ == "__main__":
    run(__doc__, walks, sites, places, slow, zhou)
