"""Simulated people beside real ones: contexts, a tree that tells them apart, walking headings, honesty of the track.

usage: python -m tests.benchmarks.simulated_people [contexts] [tracks] [--people 48] [--data ../shared/data] [--print]

contexts: windows of simulated people, classified by the shipped context model, beside those of real people by the same
plan without them: a fourth of the people of motionsense and difronzo at a time, the other sites one at a time. A
decision tree of depth 5 is trained on the features of the context model to tell simulated windows from real ones, and
tested on people left out, real and simulated; 0.5 is no difference. Its best feature is the one it uses most.

tracks: walks of nine legs, 80 to 270 m, with corners, by the default recipe. The truth is turned into the frame of the
track, whose north is where the person walks at first. NEES of the last position: 2 is right. "Direction known" and
"length known" put the true walking direction or the true length in the place of each step's own and leave the rest; the
ellipses stay. The second table has as many times four people and phones that are drawn wider than the filter takes
them: lengths by 8 % where it takes 7, and the gyroscope's bias from its prior, a mixture, a fourth larger.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold
from sklearn.tree import DecisionTreeClassifier

import pdr_filter as pdr
from pdr_filter.offline.training.context_training import PLANS, labelled_windows
from pdr_filter.offline.training.cross_validation import LabelledWindows, label_of, recordings_of
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.learned_contexts import shipped_model
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate import Leg, SensorErrors, simulate
from pdr_filter.simulate.population import random_person
from pdr_filter.values import BoolArray, FloatArray
from tests.benchmarks.common import Tables, run

TextArray = NDArray[np.str_]
PLAN = {plan.name: plan for plan in PLANS}["context"]
SETS = ("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor")
# Carrying mode, strides (None: of any kind), and what the place is called; a pocket is a front or a back one.
PLACES = {
    "front pocket": ("pocket", "pocket"),
    "back pocket": ("pocket", "back_pocket"),
    "texting": ("texting", None),
    "swinging": ("swinging", None),
    "calling": ("calling", None),
}
MOVING = ("walking", "upstairs", "downstairs", "running")


def person_in(place: str, number: int) -> tuple[pdr.simulate.Gait, pdr.simulate.Carrying]:
    """Somebody who carries the phone there."""
    mode, strides = PLACES[place]
    found = (random_person(mode, n) for n in range(1000 * number, 1000 * (number + 1)))
    return next((g, c) for g, c in found if strides is None or c.strides == strides)


# --- contexts -------------------------------------------------------------------------------------------------------


def simulated_windows(place: str, n_people: int) -> LabelledWindows:
    """Feature windows of people who stand, walk, climb, walk, descend and run."""
    stage, mode = FeatureWindows(features=ATTITUDE_FREE), PLACES[place][0]
    parts: list[LabelledWindows] = []
    for number in range(n_people):
        gait, carrying = person_in(place, number)
        turn_rad = 0.7 * (number % 3 - 1)
        legs = [Leg("stationary", duration_s=8.0)]
        legs += [Leg(c, duration_s=14.0, turn_rad=turn_rad) for c in ("walking", "upstairs", "walking", "downstairs")]
        legs.append(Leg("running", duration_s=14.0))
        rate_hz = 50.0 if number % 2 else 100.0
        walk = simulate(legs, gait, mode, rate_hz=rate_hz, seed=number, carrying={mode: carrying})
        found = [
            (window.features, *label)
            for window in feature_windows(stage, [merge_streams(walk)])
            if (label := label_of(walk, window.time_s - stage.window_s, window.time_s)) is not None
        ]
        features, context, carried = (np.array(column) for column in zip(*found, strict=True))
        known = np.ones(len(features), dtype=bool)
        parts.append(LabelledWindows.of_one(features, context, carried, f"simulated/{number}", "simulated", "", known))
    return replace(w := LabelledWindows.joined(parts), features=PLAN.features(w))


def real_windows(data: Path) -> LabelledWindows:
    """Those of all licensed sites with a gyroscope."""
    found = labelled_windows(recordings_of(data, SETS), feature_set="invariant")
    return replace(found, features=PLAN.features(found))


def left_out(windows: LabelledWindows) -> TextArray:
    """Context of each window by models that have not seen its person."""
    named = np.isin(windows.dataset, ("motionsense", "difronzo"))
    folds = [
        np.isin(np.arange(len(named)), np.flatnonzero(named)[test]) for _, test in _folds(windows.person[named], 4)
    ]
    folds += [windows.dataset == site for site in SETS if site not in ("motionsense", "difronzo")]
    trained = np.isin(windows.dataset, PLAN.datasets) & windows.has_gyroscope
    said = np.empty(len(windows.context), dtype=object)
    for test in folds:
        model = PLAN.fit_machine(windows.part(trained & ~test))
        said[test] = np.array(PLAN.labels)[model.probabilities(windows.features[test]).argmax(axis=1)]
    return said.astype(str)


def _folds(groups: TextArray, n: int) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    return GroupKFold(n).split(groups, groups=groups)


def of_place(windows: LabelledWindows, place: str) -> BoolArray:
    """Which real windows are of a place."""
    back = np.char.find(windows.recording, "backpocket") >= 0
    return (windows.carrying_mode == PLACES[place][0]) & (back if place == "back pocket" else ~back)


def told_apart(real: LabelledWindows, made: LabelledWindows) -> tuple[float, str]:
    """Area under the curve of a tree on people left out, and its best feature with medians of both."""
    x, y = np.vstack([real.features, made.features]), np.repeat([0, 1], [len(real.context), len(made.context)])
    who = np.concatenate([np.where(real.person == "ms_indoor/None", real.recording, real.person), made.person])
    weight = np.where(y == 0, 1 / (y == 0).sum(), 1 / (y == 1).sum()) * len(y)
    tree, prob = DecisionTreeClassifier(max_depth=5, min_samples_leaf=20, random_state=0), np.empty(len(y))
    for train, test in _folds(who, 5):
        prob[test] = tree.fit(x[train], y[train], sample_weight=weight[train]).predict_proba(x[test])[:, 1]
    best = int(tree.fit(x, y, sample_weight=weight).feature_importances_.argmax())
    medians = ", ".join(f"{np.median(w.features[:, best]):.2f}" for w in (real, made))
    return float(roc_auc_score(y, prob, sample_weight=weight)), f"`{PLAN.feature_names[best]}` ({medians})"


def contexts(tables: Tables, arguments: argparse.Namespace) -> None:
    real, model = real_windows(arguments.data), shipped_model("context")
    said, rows = left_out(real), list[list[object]]()
    for place in PLACES:
        made = simulated_windows(place, arguments.people)
        made_said = np.array(PLAN.labels)[model.probabilities(made.features).argmax(axis=1)]
        for context in MOVING:
            own = made.context == context
            there = of_place(real, place) & (real.context == context)
            people = np.unique(real.person[there])
            of_each = [np.mean(said[there & (real.person == p)] == context) for p in people]
            cells: list[object] = [f"{np.mean(made_said[own] == context):.2f}"]
            cells += [f"{np.mean(of_each):.2f}" if len(people) else "-", len(people) or "-"]
            if len(people) and there.sum() > 300:
                area, best = told_apart(real.part(there), made.part(own))
                cells += [f"{area:.2f}", best]
            else:
                cells += ["-", "-"]
            rows.append([place, context, *cells])
    columns = ["place", "context", "recall: simulated", "real, left out", "real people", "tree: AUC"]
    about = f"{arguments.people} simulated people in each place. Recall of windows, mean over people; "
    about += "medians: real, simulated."
    tables.write("simulated_people", [*columns, "its best feature"], rows, about)


# --- tracks ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """Of one walk."""

    nees: FloatArray  # (3,) as it is, direction known, length known
    error_m: float
    distance: float  # relative error
    lost_steps: float  # share
    heading_rad: float  # median error of the walking direction
    walking: float  # mean probability of walking


def walk_of(place: str, number: int) -> pdr.Recording:
    """Somebody's walk of nine straight legs."""
    gait, carrying = person_in(place, number)
    rng, mode = np.random.default_rng([7, number]), PLACES[place][0]
    legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=float(rng.uniform(10, 30)))]
    for _ in range(8):
        turn_rad = float(rng.choice([-1.0, 1.0])) * np.pi / 2
        legs.append(Leg("walking", distance_m=float(rng.uniform(10, 30)), turn_rad=turn_rad))
    return simulate(
        legs, gait, mode, errors=SensorErrors(), seed=number, carrying={mode: carrying}, name=f"{mode}_{number}"
    )


def frame_rad(track: pdr.Track, at: FloatArray) -> float:
    """True headings less those of the device in the first ten steps: the track's north is where that angle leads."""
    moved = np.diff(at[:11], axis=0)
    true = np.arctan2(moved[:, 0], moved[:, 1])
    return float(np.angle(np.exp(1j * (true - np.asarray(track.steps.device_heading_rad)[1 : 1 + len(true)])).sum()))


def outcome(walk: pdr.Recording) -> Outcome:
    """Errors of the default recipe."""
    track, truth = pdr.track(walk, pdr.recipes.for_recording("default", walk)), walk.truth.position
    at = np.column_stack([np.interp(track.time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    turn_rad = frame_rad(track, at)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    at = at @ np.array([[c, s], [-s, c]])
    moved, own = (np.diff(np.vstack([[0.0, 0.0], p]), axis=0) for p in (at, track.position_m))
    length, own_length = (np.linalg.norm(m, axis=1, keepdims=True) for m in (moved, own))
    towards, own_towards = moved / np.maximum(length, 1e-6), own / np.maximum(own_length, 1e-6)
    ends = np.stack([own.sum(axis=0), (own_length * towards).sum(axis=0), (length * own_towards).sum(axis=0)])
    error = ends - at[-1]
    off = np.arctan2(own_towards[:, 0], own_towards[:, 1]) - np.arctan2(towards[:, 0], towards[:, 1])
    steps = walk.truth.steps.time_s
    return Outcome(
        nees=np.einsum("ka,kb,ab->k", error, error, np.linalg.inv(track.position_cov_m2[-1])),
        error_m=float(np.linalg.norm(error[0])),
        distance=float(own_length.sum() / length.sum() - 1),
        lost_steps=1 - track.n_steps / len(steps),
        heading_rad=float(np.median((off + np.pi) % (2 * np.pi) - np.pi)),
        walking=float(track.context_prob[:, list(track.contexts).index("walking")].mean()),
    )


def tracks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tracks of simulated people by the default recipe."""
    n_people = arguments.people
    rows: list[list[object]] = []
    for place in PLACES:
        found = [outcome(walk_of(place, number)) for number in range(n_people)]
        nees = np.array([o.nees for o in found])
        both = [
            f"{mean:.1f} ({median:.1f})"
            for mean, median in zip(nees.mean(axis=0), np.median(nees, axis=0), strict=True)
        ]
        sure = nees[np.array([o.walking > 0.9 and o.lost_steps < 0.02 for o in found]), 0]
        rest = f"{sure.mean():.1f} ({np.median(sure):.1f}), {len(sure)}" if len(sure) else "-"
        distance = np.array([o.distance for o in found])
        off = np.degrees(np.abs([o.heading_rad for o in found]))
        rows.append(
            [
                *(
                    place,
                    f"{both[0]} ± {nees[:, 0].std() / np.sqrt(n_people):.1f}",
                    *both[1:],
                    rest,
                    f"{np.median([o.error_m for o in found]):.1f}",
                ),
                f"{100 * distance.mean():+.1f}, {100 * distance.std():.1f}",
                f"{100 * np.mean([o.lost_steps for o in found]):.1f}",
                f"{np.median(off):.0f}, {np.percentile(off, 90):.0f}",
                f"{np.mean([o.walking for o in found]):.2f}",
            ]
        )
    columns = [
        "place",
        "NEES: mean (median) ± its error",
        "direction known",
        "length known",
        "of walks well sensed, their number",
    ]
    columns += ["error m", "distance %: bias, spread", "steps lost %", "direction deg: median, 90 %", "P(walking)"]
    about = f"{n_people} simulated people. Well sensed: walking for 0.9 of the steps, under 2 % of them lost."
    tables.write("simulated_people_tracks", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, contexts, tracks, people=48)
