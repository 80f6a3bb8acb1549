"""Tian et al. 2016: how the phone is carried, steps, step lengths, and tracks with compensated heading.

usage: python -m tests.studies.tian2016 [modes_and_steps] [lengths] [tracks] [headings]

modes_and_steps: Tables VI and VIII on ubicomp13, where nobody swings the phone. The thresholds of the recipe were
chosen on people 1 to 6 of the 13. A walk in a trouser pocket begins with one transition, from the hand. It is missed if
the machine never left HOLDING before the walk ends. A transition that starts during a walk is false.

lengths: Table VII, the spread of the estimated distance of one route (ubicomp13, steps of the default detector). Each
model is scaled to the mean distance, as in the paper.

tracks: Table VIII, HOLDING, at the landmarks of humolire (phone in the hand).

headings: heading error of each step and position error at each metre of the path, as in Tables VIII and IX, against the
motion capture of tyrex and oxiod. The frame of the track is aligned on the first 20 % of the steps. Heights of these
people are not known. The phone is in its place from the start.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.evaluate.comparison import leg_error_percent
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import end_error_percent, path_m, position_errors_m, positions_at
from pdr_filter.filter.step_length.models import KimStepLength, WeinbergStepLength, one_parameter_fit, static_fit
from pdr_filter.recipes import default, tian2016
from pdr_filter.recipes.tian2016.recipe import tian_fit
from pdr_filter.sensing.front_end import Event
from pdr_filter.tracking.whole_recording import run_sensing, track
from pdr_filter.values import CARRYING_MODES, FloatArray, Step, WindowContext, interpolated_rows, steps_of
from pdr_filter.values.recording import Recording, Subject
from tests.benchmarks.common import Tables, places_of, recordings, way_of
from tests.studies.data import Part, counted_walk, paper_table, prefixed, run_study

# --- Carrying modes --------------------------------------------------------------------------------------------------

# The machine's modes and our names of them.
MODES = {"HOLDING": "texting", "SWING": "swinging", "POCKET": "pocket"}
TRANS = "TRANS"
Recipe = Callable[[Subject | None], Any]
RECIPES: Mapping[str, Recipe] = {"ours": tian2016, "ours default": default}


def modes_said(carrying_prob: FloatArray) -> list[str]:
    """What the machine says, or the most probable mode in its terms; none probable is TRANS."""
    names = {ours: paper for paper, ours in MODES.items()}
    # a phone at the ear is held, one in a bag lies as in a pocket (notes of TianStepDetector)
    names |= {"calling": "HOLDING", "bag": "POCKET"}
    return [names[CARRYING_MODES[int(p.argmax())]] if p.max() > 0.5 else TRANS for p in carrying_prob]


@dataclass(frozen=True, eq=False)
class Carried:
    """What was said of the carrying mode in a recording."""

    time_s: FloatArray  # (W,)
    mode: list[str]

    def within(self, start_s: float, end_s: float) -> list[str]:
        """What was said in an interval, and at its start."""
        first = max(int(np.searchsorted(self.time_s, start_s, side="right")) - 1, 0)
        return self.mode[first : int(np.searchsorted(self.time_s, end_s, side="right"))]

    def most(self, start_s: float, end_s: float) -> str:
        """The main mode that was most often said in an interval; TRANS if none was."""
        said = self.within(start_s, end_s)
        # half a vote: TRANS wins where nothing else was said
        return max((*MODES, TRANS), key=lambda m: said.count(m) if m != TRANS else 0.5)


@dataclass(frozen=True, eq=False)
class Counted:
    """Most frequent mode, steps and transitions of one recipe in one recording."""

    true: str
    most: str
    n_found: int
    n_true: int
    left_holding: bool  # a transition was found from the start of the recording to the end of the walk
    n_false: int  # transitions that start during the walk
    walk_s: float


def counted_of(recording: Recording, config: Any) -> Counted | None:
    """None for carrying modes that the machine does not have."""
    labels, segments = recording.truth.labels, recording.truth.segments
    mode = {ours: paper for paper, ours in MODES.items()}
    if labels is None or segments is None or str(labels["carrying_mode"][0]) not in mode:
        return None
    start_s, end_s, n_true = counted_walk(recording)
    events = run_sensing(config.sensing, recording)[1]
    said = _carried(events)
    steps_s = np.array([e.time_s for e in events if isinstance(e, Step)])
    return Counted(
        true=mode[str(labels["carrying_mode"][0])],
        most=said.most(start_s, end_s),
        n_found=int(((steps_s >= start_s) & (steps_s <= end_s)).sum()),
        n_true=n_true,
        left_holding=bool({TRANS, "POCKET", "SWING"} & set(said.within(-np.inf, end_s))),
        n_false=sum(a != TRANS and b == TRANS for a, b in pairwise(said.within(start_s, end_s))),
        walk_s=end_s - start_s,
    )


def _carried(events: Sequence[Event]) -> Carried:
    windows = [e for e in events if isinstance(e, WindowContext)]
    prob = np.array([w.carrying_prob for w in windows]).reshape(-1, len(CARRYING_MODES))
    return Carried(np.array([w.time_s for w in windows]), modes_said(prob))


# --- tables ----------------------------------------------------------------------------------------------------------

Rows = tuple[Mapping[str, object], ...]
Row = dict[str, object]

# Table VI, per cent: columns the true mode, rows the one found.
_TABLE_VI = np.array([[96.88, 5.26, 3.57], [0.0, 89.48, 3.57], [3.12, 5.26, 92.86]])
_STEPS_PERCENT = {"HOLDING": 100.0, "SWING": 99.22, "POCKET": 98.44}  # Table VIII
# Table VIII, HOLDING: distance and mean position error, m, of a path of this length.
_DISTANCE_M, _POSITION_M, _PATH_M = 96.37, 0.75, 96.33


def _table_vi_real(tian: Sequence[Counted], by_default: Sequence[Counted]) -> Rows:
    """Per cent of the recordings of each true mode."""
    rows: list[Row] = []
    for i, found in enumerate((*MODES, TRANS)):
        row: Row = {"": f"classified as {found}" if found != TRANS else "no mode"}
        for j, true in enumerate(MODES):
            row[f"paper {true}"] = float(_TABLE_VI[i, j]) if found != TRANS else np.nan
            for name, counted in (("ours", tian), ("ours default", by_default)):
                own = [c.most == found for c in counted if c.true == true]
                row[f"{name} {true}"] = 100.0 * float(np.mean(own)) if own else np.nan
        rows.append(row)
    return tuple(rows)


def _transitions(counted: Sequence[Counted]) -> Rows:
    """Transitions of Table VI: missed ones into a pocket, and false ones during walks."""
    pocket = [c for c in counted if c.true == "POCKET"]
    missed = 100.0 * float(np.mean([not c.left_holding for c in pocket]))
    n_false, walk_min = sum(c.n_false for c in counted), sum(c.walk_s for c in counted) / 60
    return (
        {"": "transitions", "paper": 106.0, "ours": float(len(pocket))},
        {"": "missed, %", "paper": 7.55, "ours": missed},
        {"": "false", "paper": 2.0, "ours": float(n_false)},
        {"": "false, a minute of walking", "paper": np.nan, "ours": n_false / walk_min},
    )


def _table_viii_steps(tian: Sequence[Counted], by_default: Sequence[Counted]) -> Rows:
    """Steps in per cent of the true ones, of the totals as the paper counts, and absolute errors walk by walk."""
    rows: list[Row] = []
    for mode, percent in _STEPS_PERCENT.items():
        row: Row = {"mode": mode, "n": sum(c.true == mode for c in tian)}
        row["paper, % of steps"] = percent
        for name, counted in (("ours", tian), ("ours default", by_default)):
            own = [c for c in counted if c.true == mode]
            n_true = np.array([c.n_true for c in own], dtype=float)
            n_found = np.array([c.n_found for c in own], dtype=float)
            row[f"{name}, % of steps"] = float(100 * n_found.sum() / n_true.sum()) if own else np.nan
            row[f"{name}, mean absolute error, %"] = (
                float(np.abs(count_error_percent(n_found, n_true)).mean()) if own else np.nan
            )
        rows.append(row)
    return tuple(rows)


def _humolire_rows(data: Path) -> Rows:
    """HOLDING at landmarks: mean over nine walks of what is known there."""
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in RECIPES}
    for walk in recordings(data, "humolire"):
        points = walk.truth.waypoints
        assert points is not None
        reference = places_of(points)
        for name, recipe in RECIPES.items():
            own = track(walk, recipe(walk.subject))
            estimate = positions_at(own.time_s, own.position_m, points.time_s)
            position = position_errors_m(estimate, reference, "first")
            legs = 100.0 + leg_error_percent(walk, own)
            share = 100.0 * position.mean() / path_m(reference)[-1]
            found[name].append((legs, float(position.mean()), share, end_error_percent(estimate, reference, "first")))
    names = {
        "distance of straight legs, % of the true one": 100.0 * _DISTANCE_M / _PATH_M,
        "mean position error, m": _POSITION_M,
        "mean position error, % of the path": 100.0 * _POSITION_M / _PATH_M,
        "end error, % of the path": np.nan,
    }
    return tuple(
        {"walk": "HOLDING", "n": len(found["ours"]), "": name, "paper": printed}
        | {who: float(np.median([v[k] for v in values])) for who, values in found.items()}
        for k, (name, printed) in enumerate(names.items())
        if found["ours"]
    )


def modes_and_steps(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table VI and the steps of Table VIII, of the same walks."""
    counted: dict[str, list[Counted]] = {name: [] for name in RECIPES}
    for recording in recordings(arguments.data, "ubicomp13"):
        for name, recipe in RECIPES.items():
            own = counted_of(recording, recipe(recording.subject))
            if own is not None:
                counted[name].append(own)
    tian, by_default = counted.values()
    data = f"ubicomp13, {len(tian)} walks of 13 people, phone in the hand or in a trouser pocket"
    vi, viii = _table_vi_real(tian, by_default), _table_viii_steps(tian, by_default)
    paper_table(tables, "tian2016_table_vi", "Table VI: mode classification, %", vi, data)
    title = "Table VI, transitions: from the hand into a trouser pocket"
    paper_table(tables, "tian2016_table_vi_transitions", title, _transitions(tian), data, digits=2)
    title = "Table VIII, steps: those found in per cent of those counted"
    paper_table(tables, "tian2016_table_viii_steps", title, viii, data)


_TABLE_VII = {  # least, largest, median and standard deviation of the distance of 28 m, m
    "eq. 2, static": (22.19, 36.31, 26.92, 3.58),
    "eq. 3, Weinberg": (22.70, 33.59, 28.04, 2.69),
    "eq. 4, Kim": (22.64, 32.04, 28.39, 2.73),
    "eq. 9, Tian": (24.56, 32.27, 27.96, 2.30),
}
_ROUTE_M = 28.0
_MEN, _USUAL = "M", 1.70


def lengths(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table VII: spread of the distances of one route."""
    found: dict[str, list[float]] = {name: [] for name in _TABLE_VII}
    for recording in recordings(arguments.data, "ubicomp13"):
        if not recording.name.endswith(("handheld_using", "hand_held")):
            continue
        start_s, end_s, _ = counted_walk(recording)
        own = track(recording)
        steps = [s for s in steps_of(own.steps) if start_s <= s.time_s <= end_s]
        height_m, gender = recording.subject.height_m or _USUAL, recording.subject.gender or _MEN
        fits = (
            static_fit(height_m, gender),
            one_parameter_fit(WeinbergStepLength(), 0.5, 0.1),
            one_parameter_fit(KimStepLength(), 0.5, 0.1),
            tian_fit(height_m, gender),
        )
        for distances, fit in zip(found.values(), fits, strict=True):
            distances.append(sum(fit.predict(s)[0] for s in steps))
    rows: list[Row] = []
    for name, printed in _TABLE_VII.items():
        d = np.array(found[name])
        d *= _ROUTE_M / d.mean()
        figures = d.min(), d.max(), np.median(d), d.std()
        names = ("least", "largest", "median", "spread")
        rows.append({"model": name} | prefixed("paper", names, printed, " m") | prefixed("ours", names, figures, " m"))
    data = f"ubicomp13, {len(d)} walks of 13 people with the phone in the hand on one route, distances scaled to 28 m"
    paper_table(tables, "tian2016_table_vii", "Table VII: distances by step-length models", rows, data, digits=2)


@dataclass(frozen=True, eq=False)
class Heading:
    """Heading errors of the steps and position errors at each metre of a walk, by one recipe."""

    heading_deg: FloatArray  # (K,) absolute
    position_m: FloatArray  # (M,)


def heading_of(recording: Recording, config: Any) -> Heading | None:
    """Errors against motion capture; None with fewer than ten steps."""
    time_s, way_m = way_of(recording)
    own = track(recording, replace(config, needs=()))
    use = (own.time_s > time_s[0] + 1.0) & (own.time_s < time_s[-1] - 1.0)
    if use.sum() < 10:
        return None
    velocity = np.gradient(way_m, 0.02, axis=0)
    middle_s = own.time_s[use] - 0.5 * np.asarray(own.steps.duration_s)[use]
    east, north = (np.interp(middle_s, time_s, v) for v in velocity.T)
    moves = np.hypot(east, north) > _WALKS_MPS
    step_m = np.diff(own.position_m, axis=0, prepend=np.zeros((1, 2)))[use][moves]
    error = np.angle((step_m[:, 1] + 1j * step_m[:, 0]) / (north + 1j * east)[moves])
    first = max(len(error) // 5, 1)
    offset = np.angle(np.exp(1j * error[:first]).sum())
    path = path_m(way_m)
    at_s = np.interp(np.arange(0.0, path[-1], 1.0), path, time_s)
    reference = interpolated_rows(at_s, time_s, way_m)
    estimate = positions_at(own.time_s, own.position_m, at_s)
    errors_m = position_errors_m(estimate, reference, "first")
    return Heading(np.degrees(np.abs(np.angle(np.exp(1j * (error - offset))))), errors_m)


_WALKS_MPS = 0.3  # slower, the direction of the path says nothing
# Set, pattern of the files, and the paper's mode. A phone that is in its place from the start counts as HOLDING.
_CAPTURED = (
    ("oxiod", "*floor1_handheld*", "HOLDING"),
    ("oxiod", "*room_handheld*", "HOLDING"),
    ("tyrex", "*_texting*", "HOLDING"),
    ("tyrex", "*_swinging*", "SWING"),
    ("oxiod", "*floor1_pocket*", "POCKET"),
    ("oxiod", "*room_pocket*", "POCKET"),
    ("tyrex", "*_frontpocket*", "POCKET"),
)
# Tables VIII and IX: median and largest heading error, degrees, and mean position error, m.
_TRACKED = {
    "HOLDING": (1.96, 14.23, 0.75),
    "SWING": (4.63, 14.8, 1.33),
    "POCKET": (3.16, 10.58, 0.71),
}


def headings(tables: Tables, arguments: argparse.Namespace) -> None:
    """Heading error of each step and position error at each metre."""
    rows: list[Row] = []
    for site, pattern, mode in _CAPTURED:
        walks = list(recordings(arguments.data, site, f"{pattern}.zip"))
        if not walks:
            continue
        where = pattern.strip("*_").replace("_", ", ")
        row: Row = {"mode": mode, "where": f"{site}, {where}", "walks": len(walks)}
        names = ("median deg", "largest deg", "position m")
        row |= prefixed("paper", names, _TRACKED[mode])
        for who, recipe in RECIPES.items():
            each = [h for w in walks if (h := heading_of(w, recipe(w.subject))) is not None]
            deg, m = (np.concatenate([getattr(h, f) for h in each]) for f in ("heading_deg", "position_m"))
            row |= prefixed(who, names, (float(np.median(deg)), float(deg.max()), float(m.mean())))
        rows.append(row)
    title = "Tables VIII and IX: heading error of each step, and mean position error at each metre"
    data = "motion capture or visual odometry; the paper's path has 96 m"
    paper_table(tables, "tian2016_headings", title, rows, data)


def tracks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table VIII: errors of tracks with the phone held in front."""
    rows = _humolire_rows(arguments.data)
    data = f"humolire, {rows[0]['n']} walks of one person of 1.86 m, HOLDING, medians"
    paper_table(tables, "tian2016_table_viii", "Table VIII: tracking in a single mode", rows, data, digits=2)


if __name__ == "__main__":
    run_study(
        __doc__,
        Part(make=modes_and_steps, needs=("ubicomp13",)),
        Part(make=lengths, needs=("ubicomp13",)),
        Part(make=tracks, needs=("humolire",)),
        Part(make=headings, uses=("oxiod", "tyrex")),
    )
