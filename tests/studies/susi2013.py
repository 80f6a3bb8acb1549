"""Susi et al. 2013: motion modes of a handheld device, and its steps, Tables 1 to 4.

Modes and steps of people on whom nothing was trained or chosen: ubicomp13 (hand, backpack, the phone handled), oxford
(foot switches; hand, purse, swinging), and of tyrex the walks with magnets near (swinging, phoning, texting; other
walks of this person are in the training). Swinging and phoning of several people are simulated, in tables of their own.
Irregular motion has no ground truth: the phone is handled and at times at rest. As in the paper, only the mode
"irregular" is right there. Steps match within 0.25 s, without an offset; where only counts
are known (ubicomp13), over-counted and missed steps of a walk cancel.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pdr_filter.evaluate.steps import StepScores, step_scores
from pdr_filter.recipes import for_recording
from pdr_filter.recipes.config import Config
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FloatArray, IntArray, Step, WindowContext
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings
from tests.studies.data import (
    NAN,
    Part,
    by_count,
    counted_walk,
    even_way,
    paper_table,
    people_left_out,
    place_of,
    prefixed,
    run_study,
    together,
    with_subject,
)

# --- what the recipes say -------------------------------------------------------------------------------------------

MODES = ("swinging", "arm at rest", "irregular", "static")
_WINDOW_S, _EDGE_S, _TOLERANCE_S = 2.56, 0.3, 0.25
_STATIONARY = CONTEXTS.index("stationary")
_SWINGING = CARRYING_MODES.index("swinging")


def mode_of(window: WindowContext) -> int:
    """Motion mode that a window says, into `MODES`: irregular, else static, else whether the arm swings."""
    if window.irregular_prob > 0.5:
        return MODES.index("irregular")
    if window.prob[_STATIONARY] > 0.5:
        return MODES.index("static")
    return MODES.index("swinging" if int(window.carrying_prob.argmax()) == _SWINGING else "arm at rest")


@dataclass(frozen=True, eq=False)
class Sensed:
    """Ends and modes of windows, and contacts, of one recipe."""

    window_s: FloatArray  # (W,)
    mode: IntArray  # (W,) into MODES
    step_s: FloatArray  # (K,)

    def modes_within(self, start_s: float, end_s: float) -> IntArray:
        """Modes of the windows that lie wholly inside."""
        return self.mode[(self.window_s - _WINDOW_S >= start_s) & (self.window_s <= end_s)]

    def steps_within(self, start_s: float, end_s: float) -> FloatArray:
        """Contacts inside, or so soon before or after that they may belong to it."""
        return self.step_s[(self.step_s >= start_s - _EDGE_S) & (self.step_s <= end_s + _EDGE_S)]


def sensed(recording: Recording, config: Config) -> Sensed:
    """Windows and steps of a recording."""
    events = run_sensing(config.sensing, recording)[1]
    windows = [e for e in events if isinstance(e, WindowContext)]
    return Sensed(
        np.array([w.time_s for w in windows]),
        np.array([mode_of(w) for w in windows], dtype=np.int64),
        np.sort([e.time_s for e in events if isinstance(e, Step)]),
    )


@dataclass(frozen=True, eq=False)
class Stretch:
    """A time in which somebody did one thing, with what both recipes say of it."""

    source: str
    person: str
    activity: str  # of ACTIVITIES
    carrying: str  # row of Table 2; empty where there are no steps to be found
    ours: IntArray  # (W,) into MODES
    default: IntArray
    steps: StepScores | None
    default_steps: StepScores | None


def _scores(true_s: FloatArray | int, found_s: FloatArray) -> StepScores:
    """By times, or where only their number is known by counts, of which over-counted and missed ones cancel."""
    if isinstance(true_s, int):
        return by_count(true_s, len(found_s))
    return step_scores(true_s, found_s, _TOLERANCE_S)


def _both(recording: Recording) -> tuple[Sensed, Sensed]:
    ours, default = (sensed(recording, for_recording(name, recording)) for name in ("susi2013", "default"))
    return ours, default


def _stretch(
    recording: Recording, activity: str, carrying: str, part: tuple[float, float], true_s: FloatArray | int | None
) -> Stretch:
    ours, default = _both(recording)
    return _said(recording, ours, default, activity, carrying, [part], true_s)


def _said(
    recording: Recording,
    ours: Sensed,
    default: Sensed,
    activity: str,
    carrying: str,
    parts: Sequence[tuple[float, float]],
    true_s: FloatArray | int | None,
) -> Stretch:
    steps = [None if true_s is None else _scores(true_s, s.steps_within(*parts[0])) for s in (ours, default)]
    return Stretch(
        str(recording.meta.get("dataset")),
        str(recording.subject.id or recording.name),
        activity,
        carrying,
        np.concatenate([ours.modes_within(*part) for part in parts]),
        np.concatenate([default.modes_within(*part) for part in parts]),
        *steps,
    )


# --- recordings -----------------------------------------------------------------------------------------------------

# Places of ubicomp13 that the modes of the paper know, and their row of Table 2; handbags are of persons 1 and 5 only.
_PLACES = {"hand_held": "texting", "handheld_using": "texting", "backpack": "bag"}
# Handling further from the walk than this is none of it.
_APART_S = 1.0
_OXFORD = {"inhand": "texting", "purse": "bag", "swingingarm": "swinging"}


def walks_and_handling(data: Path) -> Iterator[Stretch]:
    """Walks of persons 7 to 13 of ubicomp13, steps counted on video, and what they do with the phone outside."""
    for recording in people_left_out(data, _PLACES):
        start_s, end_s, n_true = counted_walk(recording)
        ours, default = _both(recording)
        walk, around = [(start_s, end_s)], [(-np.inf, start_s - _APART_S), (end_s + _APART_S, np.inf)]
        yield _said(recording, ours, default, "texting/phoning/bag", _PLACES[place_of(recording)], walk, n_true)
        yield _said(recording, ours, default, "irregular", "", around, None)


def foot_switches(data: Path) -> Iterator[Stretch]:
    """Walks of oxford in the hand, the purse and the swinging hand; it has no gyroscope."""
    for place, carrying in _OXFORD.items():
        for recording in recordings(data, "oxford", f"*_{place}_*.zip"):
            steps = recording.truth.steps
            if steps is not None:
                true_s = np.asarray(steps.time_s, dtype=float)
                activity = "swinging" if carrying == "swinging" else "texting/phoning/bag"
                yield _stretch(recording, activity, carrying, (float(true_s[0]), float(true_s[-1])), true_s)


_TYREX = {"swinging": "swinging", "phoning": "texting/phoning/bag", "texting": "texting/phoning/bag"}


def walks_in_motion_capture(data: Path) -> Iterator[Stretch]:
    """Walks of tyrex on which nothing was chosen. Steps of the swinging one are the turns of its arm."""
    for carrying, activity in _TYREX.items():
        for recording in recordings(data, "tyrex", f"*_dist_{carrying}.zip"):
            labels = recording.truth.labels
            if labels is None or not len(labels):
                continue
            part = (float(labels.start_s[0]), float(labels.end_s[0]))
            true_s = arm_turns_s(recording) if carrying == "swinging" else None
            if true_s is not None:
                true_s = true_s[(true_s >= part[0]) & (true_s <= part[1])]
            yield _stretch(recording, activity, carrying, part, true_s)


def arm_turns_s(recording: Recording) -> FloatArray:
    """Times at which the hand overtakes the body or falls behind, twice in each cycle of the arm, by motion capture.

    Zero crossings of the hand's horizontal velocity less that of the body (its 0.3 Hz low-pass), along the latter.
    """
    time_s, path = even_way(recording, 0.01)
    velocity, body = (
        np.asarray(sosfiltfilt(butter(order, hz, fs=100, output="sos"), np.gradient(path, 0.01, axis=0), axis=0))
        for order, hz in ((3, 3.5), (2, 0.3))
    )
    ahead = ((velocity - body) * body).sum(axis=1)
    return time_s[np.flatnonzero(np.diff(np.sign(ahead)) != 0)]


_N_SIMULATED, _SIMULATED_M = 10, 120.0
_CARRYING = {"texting": "texting", "swinging": "swinging", "phoning": "calling"}


def controlled(n_people: int, way_m: float) -> Iterator[Stretch]:
    """Simulated people who walk a way with two corners, texting, swinging and phoning."""
    for number in range(1, n_people + 1):
        for carrying, mode in _CARRYING.items():
            legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=way_m / 3)]
            legs += [Leg("walking", distance_m=way_m / 3, turn_rad=turn) for turn in (0.5 * np.pi, -0.5 * np.pi)]
            recording = simulate(legs, Gait.random(2013 + number), mode, seed=number, name=f"S{number}")
            recording = with_subject(recording, id=f"S{number}")
            segments, steps = recording.truth.segments, recording.truth.steps
            assert segments is not None and steps is not None  # of every simulated recording
            part = (float(segments.start_s[1]), float(segments.end_s[-1]))
            activity = "swinging" if carrying == "swinging" else "texting/phoning/bag"
            yield _stretch(recording, activity, carrying, part, np.asarray(steps.time_s, dtype=float))


# --- tables ---------------------------------------------------------------------------------------------------------

_ACTIVITIES = ("swinging", "texting/phoning/bag", "irregular")
_PAPER_MODES_PERCENT = np.array([[95, 2, 3], [1, 98, 3], [6, 0, 94]])  # Table 1, rows the activity
_PAPER_OCCURRENCE_PERCENT = (42, 53, 5)
# Table 2: occurrence, Pdet, Pfa, Pmd in per cent.
_PAPER_STEPS_PERCENT: Mapping[str, tuple[int, int, int, int]] = {
    "swinging": (42, 99, 1, 1),
    "texting": (25, 100, 0, 0),
    "phoning": (20, 99, 0, 1),
    "bag": (8, 97, 1, 3),
}
# Table 4: Pdet of the motion and of the steps of each person, %.
_TABLE_4 = {
    **{f"M{k}": (m, s) for k, m, s in ((1, 100, 99), (2, 100, 100), (3, 99, 100), (4, 100, 99), (5, 100, 100))},
    **{f"W{k}": (m, s) for k, m, s in ((1, 98, 97), (2, 100, 100), (3, 98, 99), (4, 100, 98), (5, 100, 100))},
}
_SOURCES = ("ubicomp13", "tyrex", "oxford")
_REAL = {
    "ubicomp13": "ubicomp13, persons 7 to 13 (hand, backpack; irregular is the phone taken out, started, put away more "
    "than 1 s from the walk)",
    "oxford": "oxford, one person, no gyroscope",
    "tyrex": "tyrex, one person, walks with magnets near",
}


def _data(stretches: Sequence[Stretch], sources: Sequence[str] = tuple(_REAL)) -> str:
    """The data sets that there are."""
    present = {s.source for s in stretches}
    return "; ".join(_REAL[source] for source in sources if source in present) or "no recordings"


def _shares_percent(modes: IntArray) -> FloatArray:
    """Share of each of `MODES` (4,)."""
    return 100.0 * np.bincount(modes, minlength=len(MODES)) / len(modes) if len(modes) else np.full(len(MODES), NAN)


def _mode_rows(stretches: Sequence[Stretch], sources: Sequence[str]) -> list[Mapping[str, object]]:
    """Rows of Table 1."""
    rows: list[Mapping[str, object]] = []
    for k, activity in enumerate(_ACTIVITIES):
        for source in sources:
            own = [s for s in stretches if (s.activity, s.source) == (activity, source) and source != "oxford"]
            if not own:
                continue
            modes, default = (np.concatenate([getattr(s, name) for s in own]) for name in ("ours", "default"))
            row: dict[str, object] = {"activity": activity, "paper occurrence %": _PAPER_OCCURRENCE_PERCENT[k]}
            row |= prefixed("paper", _ACTIVITIES, _PAPER_MODES_PERCENT[k].tolist(), " %")
            row |= {"where": source, "windows": len(modes)}
            row |= prefixed("ours", MODES, _shares_percent(modes).tolist(), " %")
            row["ours default right %"] = float(_shares_percent(default)[k])
            rows.append(row)
    return rows


def _step_rows(stretches: Sequence[Stretch], sources: Sequence[str]) -> list[Mapping[str, object]]:
    """Rows of Table 2."""
    rows: list[Mapping[str, object]] = []
    for carrying, (occurrence, detected, false, missed) in _PAPER_STEPS_PERCENT.items():
        for source in sources:
            own = [s for s in stretches if (s.carrying, s.source) == (carrying, source)]
            ours = together([s.steps for s in own if s.steps is not None])
            default = together([s.default_steps for s in own if s.default_steps is not None])
            if not ours.n_true:
                continue
            rows.append(
                {
                    "steps in": carrying,
                    "paper occurrence %": occurrence,
                    "paper Pdet %": detected,
                    "paper Pfa %": false,
                    "paper Pmd %": missed,
                    "where": source + (" (counts)" if source == "ubicomp13" else ""),
                    "recordings": len(own),
                    "steps": ours.n_true,
                    "ours Pdet %": 100.0 * ours.detection_prob,
                    "ours Pfa %": 100.0 * ours.false_alarm_prob,
                    "ours Pmd %": 100.0 * ours.miss_prob,
                    "ours default Pdet %": 100.0 * default.detection_prob,
                    "ours default Pfa %": 100.0 * default.false_alarm_prob,
                }
            )
    return rows


def _person_rows(stretches: Sequence[Stretch]) -> list[Mapping[str, object]]:
    """Rows of Table 4, by person and, where there are several, by the way of carrying."""
    rows: list[Mapping[str, object]] = []
    for source, person, carrying in sorted({(s.source, s.person, s.carrying) for s in stretches if s.carrying}):
        own = [s for s in stretches if (s.source, s.person, s.carrying) == (source, person, carrying)]
        modes = np.concatenate([s.ours for s in own]) if source != "oxford" else np.empty(0, np.int64)
        steps = [s.steps for s in own if s.steps is not None]
        k = _ACTIVITIES.index(own[0].activity)
        rows.append(
            {
                "where": source + (" (counts)" if source == "ubicomp13" else ""),
                "person": person,
                "carrying": carrying,
                "Pdet motion %": float(_shares_percent(modes)[k]),
                "Pdet steps %": 100.0 * together(steps).detection_prob if steps else NAN,
            }
        )
    return rows


def modes_and_steps(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tables 1 to 4 of the paper, of the same walks."""
    data = arguments.data
    real = [*walks_and_handling(data), *foot_switches(data), *walks_in_motion_capture(data)]
    made = list(controlled(_N_SIMULATED, _SIMULATED_M))
    about, amount = _data(real), f"{_N_SIMULATED} simulated people, {_SIMULATED_M:.0f} m in each mode"
    title = "Table 1: motion modes, real recordings"
    paper_table(tables, "susi2013_table_1", title, _mode_rows(real, _SOURCES), _data(real, ("ubicomp13", "tyrex")))
    title = "Table 2: step detection, real recordings"
    paper_table(tables, "susi2013_table_2", title, _step_rows(real, _SOURCES), about)
    title = "Table 4: real people, modes and steps of each person"
    paper: list[Mapping[str, object]] = [
        {"where": "paper", "person": person, "carrying": "texting, swinging", "Pdet motion %": m, "Pdet steps %": s}
        for person, (m, s) in _TABLE_4.items()
    ]
    paper_table(tables, "susi2013_table_4", title, [*paper, *_person_rows(real)], about)
    title = "Tables 1 and 3, simulated people: motion modes"
    paper_table(tables, "susi2013_table_1_simulated", title, _mode_rows(made, ("simulated",)), amount)
    title = "Table 2, simulated people: step detection"
    paper_table(tables, "susi2013_table_2_simulated", title, _step_rows(made, ("simulated",)), amount)
    title = "Table 4, simulated people: modes and steps of each person"
    paper_table(tables, "susi2013_table_4_simulated", title, _person_rows(made), amount)


if __name__ == "__main__":
    run_study(__doc__, Part(make=modes_and_steps, uses=_SOURCES))
