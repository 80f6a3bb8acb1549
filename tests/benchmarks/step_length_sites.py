"""Every step-length model on sites that it has not seen, with the height known and unknown.

usage: python -m tests.benchmarks.step_length_sites [--data ../shared/data] [sites places floor]

Sites with known distances, the walks on foot of: humolire (straight legs by displacement), ms_indoor and ipin21
(waypoints more than 4 m apart, by displacement), oxiod (visual odometry over a floor, motion capture in a room) and
tyrex (motion capture), both by the path in stretches of eight steps, low-passed at 0.5 Hz, and ipol (20 m out and back;
steps in the turn on the spot count nothing). A site is left out as a whole: its people, phones and places. Parameters
are those with the least squared log error of the distances of recordings, outlying ones lightly (soft L1 at 10 %), all
sites alike; ipin21, one recording of 120 m, is never fitted to, only predicted.

1. Bias and spread of the recordings of each left-out site, and the RMS of all: of a recording of any site, sites alike.
   "Chosen by the others" takes for each site the model that is best on the other sites, each of those left out. People:
   RMS of the mean error of each (of a walk, where surveyors are not named). After five segments: the left-out person's
   scale from the first five stretches of 20 m, the RMS of that person's others, and of the sum of these.
   ubicomp13, one route of unknown length: spread of its predicted length over 66 walks.
2. The default as it ships, by site and place of the phone: in sample but for running, and but for ipin21.
3. What people leave of the error, and what is left when somebody's own factor is known: two halves of each recording
   (every other stretch) of ms_indoor and humolire, the recordings of each person of ipol. Differences between them are
   of single stretches, of the truth and of trials; what they have in common is of the person, or of the day.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from pdr_filter.filter.step_length.models import BounceStepLength, StepLengthModel, bounce_fit, length_and_jacobian
from pdr_filter.values import Step, steps_of
from tests.benchmarks.common import Tables, options, paths
from tests.benchmarks.step_length_models import CHEN_PRIOR, MODELS, TERM_STD_M, TYPICAL, UNKNOWN_HEIGHT_M, route_of

FloatArray = NDArray[np.float64]
Make = Callable[[float], StepLengthModel]

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


ALL: dict[str, Make] = {
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


def is_chen(make: Make) -> bool:
    return type(make(1.7)).__name__ == "ChenStepLength"


def terms(make: Make, theta: FloatArray) -> FloatArray:
    """What the sums are multiplied with: theta, but for Chen's product."""
    return np.array([theta[0] * theta[2], theta[1] * theta[2], theta[2]]) if is_chen(make) else theta


def totals(make: Make, groups: Sequence[Sequence[Stretch]], height_is_known: bool) -> Totals:
    """Sums of groups of stretches."""
    rows: list[FloatArray] = []
    for group in groups:
        row = np.zeros(make(1.7).n_params)
        for s in group:
            model = make(s.height_m if height_is_known and s.height_m else UNKNOWN_HEIGHT_M)
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


def fit(make: Make, known: Totals) -> FloatArray:
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
        site: log_errors(make, fit(make, known.at(known.site != site)), known.at(known.site == site))
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


def with_five_segments(make: Make, recordings: Totals, segments: Totals) -> tuple[float, float]:
    """RMS log error after a person's first five segments, site left out: of the others, and of their sum."""
    single: list[float] = []
    rest: list[float] = []
    for site in SITES:
        theta = fit(make, recordings.at(recordings.site != site))
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


def sites_tables(tables: Tables, walks: list[list[Stretch]], data: Path) -> None:
    """Table 1, once for each knowledge of the height."""
    routes = [route_of(p) for p in paths(data, "ubicomp13")]
    segments = segments_of(walks)
    for name, height_is_known in (("step_length_sites", True), ("step_length_sites_unknown_height", False)):
        known = {n: totals(make, walks, height_is_known) for n, make in ALL.items()}
        rows: list[list[str]] = []
        for n, make in ALL.items():
            errors, theta = left_out(make, known[n]), fit(make, known[n])
            five = with_five_segments(make, known[n], totals(make, segments, height_is_known))
            route = [
                np.log(r.n_steps * np.mean([length_and_jacobian(make(h), s, theta)[0] for s in r.steps]))
                for r in routes
                for h in [r.height_m if height_is_known else UNKNOWN_HEIGHT_M]
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
        height = "the person's where it is stated" if height_is_known else f"{UNKNOWN_HEIGHT_M:.2f} m for all"
        about = f"Left-out sites (recordings): bias ± spread in %; height {height}."
        tables.write(name, columns, rows, about)


def log_error(stretches: Sequence[Stretch]) -> float:
    """Of the default as it ships, over some stretches."""
    fit_m = sum(
        w * bounce_fit(s.height_m).predict(step)[0]
        for s in stretches
        for w, step in zip(s.weight, s.steps, strict=True)
    )
    return float(np.log(fit_m / sum(s.distance_m for s in stretches)))


def places_table(tables: Tables, walks: list[list[Stretch]]) -> None:
    """Table 2."""
    by_place: dict[tuple[str, str], list[float]] = defaultdict(list)
    for walk in walks:
        one = walk[0]
        group = one.person if one.site in ("oxiod", "ipol") else one.site
        by_place[group, one.place].append(log_error(walk))
    rows = [[group, place, str(len(e)), percent(np.array(e))] for (group, place), e in by_place.items()]
    tables.write("step_length_places", ["who, where", "place of the phone", "recordings", "bias ± spread %"], rows)


def floor_table(tables: Tables, walks: list[list[Stretch]]) -> None:
    """Table 3."""
    rows: list[list[str]] = []
    for site in ("ms_indoor", "humolire", "ipol"):
        of_site = [w for w in walks if w[0].site == site]
        if site == "ipol":
            people = sorted({w[0].person for w in of_site})
            groups = [np.array([log_error(w) for w in of_site if w[0].person == p]) for p in people]
            who, in_recording = "people", 1
        else:
            groups = [np.array([log_error(w[::2]), log_error(w[1::2])]) for w in of_site if len(w) > 1]
            who, in_recording = "recordings", 2
        own_var = float(np.mean([g.var(ddof=1) for g in groups]))
        between_var = float(np.var([g.mean() for g in groups], ddof=1)) - own_var / len(groups[0])
        e = np.array([log_error(w) for w in of_site])
        figures = [
            np.sqrt(np.mean(e**2)),
            abs(e.mean()),
            np.sqrt(max(between_var, 0.0)),
            np.sqrt(own_var / in_recording),
        ]
        rows.append([site, str(len(e)), f"{len(groups)} {who}", *(f"{100 * v:.1f}" for v in figures)])
    columns = ["site", "recordings", "of", "RMS", "bias", "these differ by", "left with the factor of each"]
    tables.write("step_length_floor", columns, rows, "Error of the distance of a recording, %, as shipped.")


def main() -> None:
    args = options(__doc__, "sites", "places", "floor").parse_args()
    tables = Tables.of(__spec__.name, args)
    found = [list(stretches_of(p)) for site in SITES for p in paths(args.data, site)]
    walks = [w for w in found if sum(s.distance_m for s in w) >= SHORTEST_M]
    if "sites" in args.parts:
        sites_tables(tables, [w for w in walks if "running" not in w[0].place], args.data)
    if "places" in args.parts:
        places_table(tables, walks)
    if "floor" in args.parts:
        floor_table(tables, walks)


if __name__ == "__main__":
    main()
