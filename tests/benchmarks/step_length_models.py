"""Every step-length model on walks it has not seen.

usage: python -m tests.benchmarks.step_length_models [--data ../shared/data]

1. humolire, one walk left out of 9: parameters from the straight legs of the others, error of the legs' sum and of
   each leg. Fitted and scored by displacement (length of the sum of the step vectors of a leg), and, for comparison, by
   the sum of the step lengths.
2. Another site: fitted on humolire, scored on ms_indoor, and the reverse; fitted on both, scored on tyrex (motion
   capture, a room of 5 m) by carrying mode.
3. Another person, another place of the phone: with the parameters of both sites, how much the length of the one route
   of ubicomp13 (steps counted on video, length not published) differs between 66 walks of 13 people. Nothing is fitted.
4. Which powers of height, cadence and amplitude the relative step lengths of that route have, from the counted steps.
5. How much a place of the phone changes the inputs of the models, the same people on the same route (ubicomp13).

A leg is a stretch between two landmarks: straight legs (humolire), waypoints more than 4 m apart (ms_indoor), two steps
on a straight stretch (tyrex: the sway of body and phone is the same at both ends).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from pdr_filter.filter.step_length import models as models
from pdr_filter.filter.step_length.models import StepLengthModel, length_and_jacobian
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Step, steps_of
from tests.benchmarks.common import Tables, options, paths

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
    walks: dict[str, list[Leg]] = defaultdict(list)
    for leg in legs:
        walks[leg.walk].append(leg)
    return walks


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


def strides_in_motion_capture(path: Path) -> list[Leg]:
    """Pairs of steps of a tyrex walk that lead straight on; none longer than 0.9 s, where a step was missed."""
    recording = pdr.read(path)
    truth = recording.truth.position
    time_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.02)
    position = np.column_stack([np.interp(time_s, truth.time_s, c) for c in (truth.east_m, truth.north_m)])
    smooth = sosfiltfilt(butter(2, 0.8, fs=50, output="sos"), position, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
    lost = truth.time_s[:-1][np.diff(truth.time_s) > 0.2]
    steps = steps_in(recording)
    legs: list[Leg] = []
    for first, second in pairwise(steps):
        start_s, end_s = first.time_s - first.duration_s, second.time_s
        gap = ((lost > start_s - 0.6) & (lost < end_s + 0.3)).any()
        if second.time_s - second.duration_s > first.time_s + 1e-6 or max(first.duration_s, second.duration_s) > 0.9:
            continue
        if gap or start_s < time_s[0] + 1 or end_s > time_s[-1] - 1:
            continue
        ends = np.array([[np.interp(t, time_s, c) for c in smooth.T] for t in (start_s, end_s)])
        distance_m = float(np.hypot(*(ends[1] - ends[0])))
        if distance_m > 0.93 * np.diff(np.interp([start_s, end_s], time_s, along))[0]:
            legs.append(
                Leg("tyrex", recording.name, height_of(recording), distance_m, (first, second), np.ones(2), np.zeros(2))
            )
    return legs


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


def leave_one_walk_out(tables: Tables, legs: list[Leg]) -> None:
    """Table 1."""
    rows = []
    walks = walks_of(legs)
    for name, make in MODELS.items():
        row = [name, str(make(UNKNOWN_HEIGHT_M).n_params)]
        for measure in (displacement, summed):
            total: list[float] = []
            one: list[float] = []
            for walk, own in walks.items():
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
    about = f"humolire, {len(walks)} walks, {len(legs)} legs, {sum(leg.distance_m for leg in legs):.0f} m."
    columns += ["summed: total %RMSE", "summed: leg %RMSE"]
    tables.write("step_length_walk_left_out", columns, rows, about)


def percent(make: Callable[[float], StepLengthModel], legs: list[Leg], theta: FloatArray) -> str:
    """Bias and spread of the sums of walks, weighted by their length."""
    totals = np.array([errors(make, own, theta, displacement).sum(axis=0) for own in walks_of(legs).values()])
    error = 100 * (totals[:, 0] / totals[:, 1] - 1)
    bias = np.average(error, weights=totals[:, 1])
    spread = np.sqrt(np.average((error - bias) ** 2, weights=totals[:, 1]))
    return f"{bias:+.0f} ± {spread:.0f}" if len(error) > 1 else f"{bias:+.0f}"


def other_sites(tables: Tables, sites: dict[str, list[Leg]], routes: list[Route]) -> None:
    """Tables 2 and 3."""
    modes = ("texting", "phoning", "swinging", "frontpocket", "backpocket")
    rows = []
    for name, make in MODELS.items():
        here, there = sites["humolire"], sites["ms_indoor"]
        both = fit(make, here + there, displacement)
        row = [name, percent(make, there, fit(make, here, displacement))]
        row += [percent(make, here, fit(make, there, displacement)), percent(make, here, both)]
        row.append(percent(make, there, both))
        row += [percent(make, [leg for leg in sites["tyrex"] if leg.walk.endswith(m)], both) for m in modes]
        walks, people, places = spread_on_one_route(make, routes, both)
        row += [f"{walks:.1f}", f"{people:.1f}", f"{places:.1f}"]
        rows.append(row)
        print(name, both.round(4).tolist(), flush=True)
    columns = ["model", "humolire to ms_indoor", "ms_indoor to humolire", "both to humolire", "both to ms_indoor"]
    columns += [*(f"both to tyrex {m}" for m in modes), "ubicomp13: walks", "people", "places"]
    tables.write("step_length_other_sites", columns, rows, "Bias ± spread of walks in %; standard deviations in %.")


def spread_on_one_route(
    make: Callable[[float], StepLengthModel], routes: list[Route], theta: FloatArray
) -> tuple[float, float, float]:
    """Standard deviation of the predicted log length of the route over walks, over people, and the largest place's."""
    length = np.array(
        [
            np.log(r.n_steps * np.mean([length_and_jacobian(make(r.height_m), s, theta)[0] for s in r.steps]))
            for r in routes
        ]
    )
    people, places = sorted({r.person for r in routes}), sorted({r.place for r in routes})
    design = np.array([[r.person == p for p in people] + [r.place == q for q in places[1:]] for r in routes], float)
    effect = np.linalg.lstsq(design, length, rcond=None)[0]
    place = np.concatenate([[0.0], effect[len(people) :]])
    place -= np.mean([place[places.index(r.place)] for r in routes])
    return 100 * length.std(), 100 * effect[: len(people)].std(ddof=1), 100 * float(np.abs(place).max())


INPUTS: dict[str, Callable[[Step], float]] = {
    "step frequency": lambda s: s.frequency_hz,
    "amplitude A": lambda s: s.vertical_amplitude_mps2,
    "mean modulus": lambda s: s.mean_abs_mps2,
    "vertical range": lambda s: s.vertical_max_mps2 - s.vertical_min_mps2,
    "maximum of a": lambda s: s.magnitude_max_mps2 - STANDARD_GRAVITY_MPS2,
    "variance": lambda s: s.variance,
}


def one_route(tables: Tables, routes: list[Route]) -> None:
    """Table 4: log of the relative step length by least squares."""
    length = -np.log([r.n_steps for r in routes])
    amplitude = [np.mean(np.log([np.clip(s.vertical_amplitude_mps2, 0.3, 3.0) for s in r.steps])) for r in routes]
    cadence = [np.mean(np.log([s.frequency_hz for s in r.steps])) for r in routes]
    logs = {"h": np.log([r.height_m for r in routes]), "f": np.array(cadence), "A": np.array(amplitude)}
    rows = []
    for names in ("h", "hf", "hA", "hfA"):
        design = np.column_stack([*(logs[n] for n in names), np.ones(len(routes))])
        power = np.linalg.lstsq(design, length, rcond=None)[0]
        error = length - design @ power
        std = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * (error @ error) / (len(error) - len(power)))
        cells = {n: f"{power[i]:.2f} ± {std[i]:.2f}" for i, n in enumerate(names)}
        rows.append([", ".join(names), *(cells.get(n, "") for n in "hfA"), f"{100 * error.std():.1f}"])
    tables.write("step_length_one_route", ["logs of", "h", "f", "A", "left %"], rows, "A within 0.3 and 3 m/s².")


def inputs(tables: Tables, routes: list[Route]) -> None:
    """Table 5: 100 times the mean log over the steps, less that of the mean place, people apart."""
    people, places = sorted({r.person for r in routes}), sorted({r.place for r in routes})
    design = np.array([[r.person == p for p in people] + [r.place == q for q in places[1:]] for r in routes], float)
    rows = []
    for name, value in INPUTS.items():
        of_walk = [np.mean(np.log([max(value(s), 1e-3) for s in r.steps])) for r in routes]
        effect = np.linalg.lstsq(design, np.array(of_walk), rcond=None)[0]
        place = 100 * np.concatenate([[0.0], effect[len(people) :]])
        place -= np.mean([place[places.index(r.place)] for r in routes])
        rows.append([name, *(f"{e:+.0f}" for e in place)])
    tables.write("step_length_inputs", ["input", *places], rows, "In % of the input.")


def main() -> None:
    args = options(__doc__).parse_args()
    data, tables = args.data, Tables.of(__spec__.name, args)
    sites = {
        site: [leg for p in paths(data, site) for leg in legs_between_landmarks(p)]
        for site in ("humolire", "ms_indoor")
    }
    walking = [p for p in paths(data, "tyrex") if not p.stem.endswith(("_ar", "hand", "runningpocket"))]
    sites["tyrex"] = [leg for p in walking for leg in strides_in_motion_capture(p)]
    routes = [route_of(p) for p in paths(data, "ubicomp13")]
    leave_one_walk_out(tables, sites["humolire"])
    other_sites(tables, sites, routes)
    one_route(tables, routes)
    inputs(tables, routes)


if __name__ == "__main__":
    main()
