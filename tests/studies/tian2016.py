"""Tian et al. 2016: how the phone is carried, step lengths of people of any height, tracks with compensated heading.

Counted steps and carrying modes are of ubicomp13, tracks of humolire (phone in the hand) and tyrex (a room of 5 m).
Nobody changes the carrying mode on a public walk of known path: those walks are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.evaluate.comparison import straight_leg_error_percent
from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import (
    directions_rad,
    end_error_percent,
    first_of_path,
    heading_errors_rad,
    path_m,
    position_errors_m,
    positions_at,
    rigid_fit,
)
from pdr_filter.filter.step_length import (
    KimStepLength,
    StepLengthFit,
    WeinbergStepLength,
    bounce_fit,
    static_fit,
)
from pdr_filter.io.recording import Recording, Subject
from pdr_filter.papers.tian2016.recipe import tian_fit
from pdr_filter.recipes import default, tian2016
from pdr_filter.recording_run import classify, sensed_events, track
from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.sensing.front_end import Event
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.motion import CARRYING
from pdr_filter.tracks import Track
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.contexts import CARRYING_MODES
from pdr_filter.values.step import Step
from tests.studies.data import has, recordings
from tests.studies.report import Study, StudyTable

Rows = tuple[Mapping[str, object], ...]
Row = dict[str, object]

PAPER = (
    'Q. Tian, Z. Salcic, K. I.-K. Wang, Y. Pan, "A Multi-Mode Dead Reckoning System for Pedestrian Tracking Using '
    'Smartphones", IEEE Sensors Journal, 2016, doi:10.1109/JSEN.2015.2510364.'
)

# --- What is printed -------------------------------------------------------------------------------------------------

# The machine's modes and our names of them.
MODES = {"HOLDING": "texting", "SWING": "swinging", "POCKET": "pocket"}
# Table VI, per cent: columns the true mode, rows the one found; then transitions missed, and false ones.
TABLE_VI = np.array([[96.88, 5.26, 3.57], [0.0, 89.48, 3.57], [3.12, 5.26, 92.86]])
MISSED, FALSE = 7.55, 1.89
N_TRANSITIONS, N_PEOPLE = 106, 17
# Table VII, m: minimum, maximum, median, standard deviation of the distances estimated over 28 m.
TABLE_VII = {
    "eq. (2), static": (22.19, 36.31, 26.92, 3.58),
    "eq. (3), Weinberg": (22.70, 33.59, 28.04, 2.69),
    "eq. (4), Kim": (22.64, 32.04, 28.39, 2.73),
    "eq. (9), k h sqrt(f)": (24.56, 32.27, 27.96, 2.30),
}
CORRIDOR_M = 28.0
PATH_M = 96.33


@dataclass(frozen=True)
class Printed:
    """A column of Table VIII or IX."""

    name: str
    n_true: int
    n_found: int
    percent: float  # of the steps
    distance_m: float
    max_heading_deg: float
    median_heading_deg: float
    position_m: float
    height_m: float = 1.73
    gender: str = "M"


TABLE_VIII = (
    Printed("HOLDING", 131, 131, 100.0, 96.37, 14.23, 1.96, 0.75),
    Printed("SWING", 128, 127, 99.22, 94.76, 14.8, 4.63, 1.33),
    Printed("POCKET", 128, 126, 98.44, 93.31, 10.58, 3.16, 0.71),
)
TABLE_IX = (
    Printed("S1", 140, 139, 99.3, 96.70, 17.0, 3.41, 1.34, 1.65, "F"),
    Printed("S2", 140, 141, 100.71, 95.07, 15.98, 5.00, 2.00, 1.60, "M"),
    Printed("S3", 140, 137, 97.9, 91.43, 13.52, 3.58, 0.83, 1.59, "F"),
    Printed("S4", 130, 124, 95.4, 92.86, 11.22, 2.97, 1.01, 1.74, "M"),
    Printed("S5, jeans", 133, 127, 95.5, 96.03, 9.91, 1.94, 0.30, 1.73, "M"),
    Printed("S5, casual trousers", 128, 125, 97.66, 93.33, 6.43, 0.94, 0.84, 1.73, "M"),
)
# Averages that the text gives, per cent.
DISTANCE_SINGLE, STEPS_MULTI, DISTANCE_MULTI, POSITION_MULTI = 98.43, 97.75, 97.83, 98.91
_WALK_S = 90.0


def printed_checks() -> tuple[str, ...]:
    """What the paper's printed figures say against each other, one sentence or two each."""
    n_of = np.array(_denominators())
    right = np.rint(np.diagonal(TABLE_VI) / 100 * n_of).astype(int)
    missed, wrong = round(N_TRANSITIONS * MISSED / 100), round(N_TRANSITIONS * FALSE / 100)
    largest = max(abs(100 * p.n_found / p.n_true - p.percent) for p in (*TABLE_VIII, *TABLE_IX))
    single, multi = (np.array([p.distance_m for p in t]) for t in (TABLE_VIII, TABLE_IX))
    shares = np.array([100 * p.n_found / p.n_true for p in TABLE_IX])
    position = 100 - 100 * np.mean([p.position_m for p in TABLE_IX]) / PATH_M
    first = TABLE_VIII[0]
    # of eq. 9 with equal steps: f = (L / (k h))^2
    k_h = float(tian_fit(first.height_m, first.gender).theta[0]) * first.height_m
    frequency_hz = (first.distance_m / first.n_found / k_h) ** 2
    return (
        f"Table VI is of {n_of[0]}, {n_of[1]} and {n_of[2]} transitions: the only numbers whose shares print so within "
        f"0.01 and that add up to {n_of.sum()}, which is {N_TRANSITIONS} less the {missed} missed ones. {right[0]}, "
        f"{right[1]} and {right[2]} of them are right: {100 * right.sum() / n_of.sum():.1f} % of those seen and "
        f"{100 * right.sum() / N_TRANSITIONS:.1f} % of all. False triggers: {wrong}.",
        f"Shares of steps in Tables VIII and IX follow from the counts within {largest:.2f} points.",
        f"The accuracy of the distance in Table VIII, printed {DISTANCE_SINGLE} %, is that of the total, "
        f"{_of_total(single):.2f} %; the mean over the walks is {_mean_accuracy(single):.2f} %. In Table IX, printed "
        f"{DISTANCE_MULTI} %, of the total {_of_total(multi):.2f} %, over the walks {_mean_accuracy(multi):.2f} %.",
        f"The accuracy of the steps in Table IX, printed {STEPS_MULTI} %, is the mean of the shares, "
        f"{shares.mean():.2f} %, in which the surplus of S2 makes up for steps missed by others; the mean of the "
        f"absolute errors leaves {100 - np.abs(shares - 100).mean():.2f} %.",
        f"The position accuracy, printed {POSITION_MULTI} %, is 100 % less the mean position error of Table IX in per "
        f"cent of the path: {position:.2f} %. It is no error of the end.",
        f"{first.n_found} steps of {first.distance_m / first.n_found:.3f} m by a man of {first.height_m} m need "
        f"{frequency_hz:.2f} steps a second in eq. (9), that is {first.n_found / frequency_hz:.0f} s of walking; the "
        f"text has about {_WALK_S:.0f} s.",
    )


def _denominators() -> tuple[int, ...]:
    """Numbers of transitions into each mode that have the shares of Table VI and together are those not missed."""
    n_seen = N_TRANSITIONS - round(N_TRANSITIONS * MISSED / 100)
    (found,) = (ns for ns in product(*(_possible(column) for column in TABLE_VI.T)) if sum(ns) == n_seen)
    return found


def _possible(percent: FloatArray) -> list[int]:
    """Numbers of which all these shares are whole ones, to the last printed digit or one beside it."""
    # 0.011: two printed figures are rounded so that the column adds up to 100
    return [n for n in range(1, N_TRANSITIONS) if np.abs(100 * np.rint(percent / 100 * n) / n - percent).max() < 0.011]


def _of_total(distance_m: FloatArray) -> float:
    return 100 - abs(100 * distance_m.mean() / PATH_M - 100)


def _mean_accuracy(distance_m: FloatArray) -> float:
    return 100 - float(np.abs(percent_error(distance_m, PATH_M)).mean())


# --- Carrying modes --------------------------------------------------------------------------------------------------

TRANS = "TRANS"


@dataclass(frozen=True)
class Size:
    """How much is simulated; the paper's own numbers unless said otherwise."""

    n_people: int = N_PEOPLE
    n_transitions: int = N_TRANSITIONS
    n_walks: int = 3  # of each column of Tables VIII and IX, each of another gait


def _modes_of(carrying_prob: FloatArray) -> list[str]:
    """What the machine says, or the most probable mode in its terms; none probable is TRANS."""
    names = {ours: paper for paper, ours in MODES.items()}
    # a phone at the ear is held, one in a bag lies as in a pocket (docs/methods/tian2016.md)
    names |= {"calling": "HOLDING", "bag": "POCKET"}
    return [names[CARRYING_MODES[int(p.argmax())]] if p.max() > 0.5 else TRANS for p in carrying_prob]


@dataclass(frozen=True, eq=False)
class _Carried:
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

    def transitions(self) -> list[tuple[float, str]]:
        """Start of each transition, and the mode after it."""
        found: list[tuple[float, str]] = []
        for k in range(1, len(self.mode)):
            if self.mode[k] == TRANS and self.mode[k - 1] != TRANS:
                after = next((m for m in self.mode[k:] if m != TRANS), TRANS)
                found.append((float(self.time_s[k]), after))
        return found


@dataclass(frozen=True, eq=False)
class _Counted:
    """Of one recording and one recipe: the mode most often said in the walk, transitions in it, and its steps."""

    true: str
    most: str
    moved_before: bool  # whether a transition was seen before the walk
    n_transitions: int
    n_found: int
    n_true: int


def _counted(recording: Recording, config: Any) -> _Counted | None:
    """None for carrying modes that the machine does not have."""
    labels, segments = recording.truth.labels, recording.truth.segments
    mode = {ours: paper for paper, ours in MODES.items()}
    if labels is None or segments is None or str(labels["carrying_mode"][0]) not in mode:
        return None
    start_s, end_s = float(segments["start_s"][0]), float(segments["end_s"][0])
    events = list(sensed_events(config.sensing, recording))
    said = _carried(events)
    steps_s = np.array([e.time_s for e in events if isinstance(e, Step)])
    starts = np.array([t for t, _ in said.transitions()])
    return _Counted(
        true=mode[str(labels["carrying_mode"][0])],
        most=said.most(start_s, end_s),
        moved_before=bool((starts < start_s).any()),
        n_transitions=int(((starts >= start_s) & (starts <= end_s)).sum()),
        n_found=int(((steps_s >= start_s) & (steps_s <= end_s)).sum()),
        n_true=int(segments["n_steps"][0]),
    )


def _carried(events: Sequence[Event]) -> _Carried:
    windows = [e for e in events if isinstance(e, WindowContext)]
    prob = np.array([w.carrying_prob for w in windows]).reshape(-1, len(CARRYING_MODES))
    return _Carried(np.array([w.time_s for w in windows]), _modes_of(prob))


def _table_vi_real(tian: Sequence[_Counted], by_default: Sequence[_Counted]) -> Rows:
    """Per cent of the recordings of each true mode."""
    rows: list[Row] = []
    for i, found in enumerate((*MODES, TRANS)):
        row: Row = {"": f"classified as {found}" if found != TRANS else "no mode"}
        for j, true in enumerate(MODES):
            row[f"paper {true}"] = float(TABLE_VI[i, j]) if found != TRANS else np.nan
            for name, counted in (("ours", tian), ("ours default", by_default)):
                own = [c.most == found for c in counted if c.true == true]
                row[f"{name} {true}"] = 100.0 * float(np.mean(own)) if own else np.nan
        rows.append(row)
    return tuple(rows)


def _table_viii_steps(tian: Sequence[_Counted], by_default: Sequence[_Counted]) -> Rows:
    """Steps in per cent of the true ones, of the totals as the paper counts, and absolute errors walk by walk."""
    rows: list[Row] = []
    for printed in TABLE_VIII:
        row: Row = {"mode": printed.name, "n": sum(c.true == printed.name for c in tian)}
        row["paper, % of steps"] = printed.percent
        for name, counted in (("ours", tian), ("ours default", by_default)):
            own = [c for c in counted if c.true == printed.name]
            n_true = np.array([c.n_true for c in own], dtype=float)
            n_found = np.array([c.n_found for c in own], dtype=float)
            row[f"{name}, % of steps"] = float(100 * n_found.sum() / n_true.sum()) if own else np.nan
            row[f"{name}, mean absolute error, %"] = (
                float(np.abs(count_error_percent(n_found, n_true)).mean()) if own else np.nan
            )
        rows.append(row)
    return tuple(rows)


# --- Simulated walks -------------------------------------------------------------------------------------------------


# The default's classifier takes walking with the simulator's loose pocket for stairs, which real pockets it does not.
_TIGHT_POCKET = replace(CARRYING["pocket"], wobble_roll_rad=0.1, wobble_twist_rad=0.05)


def _places(rng: np.random.Generator) -> dict[str, Carrying]:
    """Where a simulated person has the phone: in a pocket top up or down, screen in or out; in either swinging hand."""

    def turned(place: Carrying, roll_rad: float, twist_rad: float) -> Carrying:
        roll_rad, twist_rad = roll_rad + rng.normal(0.0, 0.2), twist_rad + rng.normal(0.0, 0.3)
        return replace(place, roll_rad=float(roll_rad), twist_rad=float(twist_rad))

    side = float(rng.choice([-1.0, 1.0]))
    pocket = turned(_TIGHT_POCKET, float(rng.choice([0.0, np.pi])), float(rng.choice([0.0, np.pi])))
    return {**CARRYING, "swinging": turned(CARRYING["swinging"], (side - 1) * np.pi / 2, 0.0), "pocket": pocket}


def _changes(rng: np.random.Generator, n: int) -> list[str]:
    """Modes in a row, each another than the one before; HOLDING is before the first."""
    modes = ["HOLDING"]
    for _ in range(n):
        modes.append(str(rng.choice([m for m in MODES if m != modes[-1]])))
    return modes[1:]


def _straight_walks(size: Size) -> Iterable[tuple[Recording, list[str]]]:
    """Walks of 80 m of people who change the mode about six times, and the modes that they change to."""
    least, more = divmod(size.n_transitions, size.n_people)
    for i in range(size.n_people):
        rng = np.random.default_rng([6, i])
        modes = _changes(rng, least + (i < more))
        leg_m = 80.0 / (len(modes) + 1)
        legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=leg_m)]
        legs += [Leg("walking", distance_m=leg_m, carrying_mode=MODES[m]) for m in modes]
        yield simulate(legs, Gait.random(i), seed=i, rate_hz=50.0, carrying=_places(rng)), modes


def _table_vi_simulated(size: Size) -> Rows:
    """Of all transitions that were seen, the modes found; those missed and those invented in per cent of all."""
    counts = np.zeros((4, len(MODES)))
    names = (*MODES, TRANS)
    n_missed = n_false = 0
    for walk, modes in _straight_walks(size):
        windows = classify(walk, tian2016(walk.subject))
        found = _Carried(windows.time_s, _modes_of(windows.carrying_prob)).transitions()
        labels = walk.truth.labels
        assert labels is not None
        for start_s, true in zip(labels["start_s"][2:], modes, strict=True):
            # the phone is on the way for 1.2 s about the start of the leg
            own = [k for k, (t, _) in enumerate(found) if abs(t - start_s) <= 1.0]
            n_missed += not own
            if own:
                counts[names.index(found.pop(own[0])[1]), list(MODES).index(true)] += 1
        n_false += len(found)
    share = 100.0 * counts / np.maximum(counts.sum(axis=0), 1)
    rows: list[Row] = []
    for i, name in enumerate(MODES):
        row: Row = {"": f"classified as {name}"}
        for j, true in enumerate(MODES):
            row |= {f"paper {true}": float(TABLE_VI[i, j]), f"ours {true}": float(share[i, j])}
        rows.append(row)
    for name, printed, n in (("missed, all modes", MISSED, n_missed), ("false, all modes", FALSE, n_false)):
        nan: Row = {f"{who} {true}": np.nan for true in MODES for who in ("paper", "ours")}
        rows.append({"": name} | nan | {"paper HOLDING": printed, "ours HOLDING": 100.0 * n / size.n_transitions})
    return tuple(rows)


def _turns(modes: Sequence[str]) -> list[Leg]:
    """96.33 m round four corners, the first side 45 m long; modes change 8 m after a corner.

    Fig. 9 is a plan without numbers: the sides after the first are ours.
    """
    right = np.pi / 2
    sides = (45.0, 12.0, 24.0, 8.0, PATH_M - 89.0)
    legs = [Leg("stationary", duration_s=3.0)]
    # HOLDING at first, the first change after 8 m, the second on the third side
    change = {0: modes[0], 2: modes[-1]}
    for k, side_m in enumerate(sides):
        turn_rad, before_m = right if k else 0.0, 8.0 if k in change else side_m
        legs.append(Leg("walking", distance_m=before_m, turn_rad=turn_rad))
        if k in change:
            legs.append(Leg("walking", distance_m=side_m - before_m, carrying_mode=MODES[change[k]]))
    return legs


def _round_corners(printed: Printed, modes: Sequence[str], column: int, n: int) -> list[Recording]:
    """Walks of a person of the height and gender of a column, each with another gait and other places of the phone."""
    walks: list[Recording] = []
    for i in range(n):
        rng = np.random.default_rng([9, column, i])
        gait = replace(Gait.random(100 * column + i), height_m=printed.height_m)
        walk = simulate(_turns(modes), gait, seed=100 * column + i, rate_hz=50.0, carrying=_places(rng))
        subject = {**walk.meta["subject"], "gender": printed.gender}
        walks.append(replace(walk, meta={**walk.meta, "subject": subject}))
    return walks


# --- Tracks ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Scores:
    """Of a track against the true path."""

    steps_percent: float
    distance_percent: float
    max_heading_deg: float
    median_heading_deg: float
    position_m: float  # mean of the errors at every metre


def _scores(recording: Recording, found: Track, smooth_s: float = 0.0) -> _Scores:
    """Errors at every metre of the true path and at every step, after a turn and a move onto the first 20 %.

    The paper knows where the walk starts and where to; a track here begins at the origin and in the direction of the
    device.

    Parameters
    ----------
    smooth_s : float
        Length of the moving mean over the true positions, where they are those of the phone and not of the body.
    """
    position, steps = recording.truth.position, recording.truth.steps
    assert position is not None
    time_s = position.time_s
    true = np.column_stack([position.east_m, position.north_m])
    if smooth_s:
        time_s, true = _smoothed(time_s, true, smooth_s)
    along_m = path_m(true)
    first_s = np.interp(np.arange(1.0, along_m[-1]), along_m, time_s)

    def at(when_s: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(when_s, time_s, true[:, k]) for k in (0, 1)])

    reference, estimate = at(first_s), positions_at(found.time_s, found.position_m, first_s)
    rotation, _ = rigid_fit(*(p[first_of_path(reference)] for p in (estimate, reference)))
    use = (found.time_s >= time_s[0]) & (found.time_s <= time_s[-1])
    step_way = found.position_m[use] @ rotation.T
    heading = np.degrees(np.abs(heading_errors_rad(directions_rad(step_way), directions_rad(at(found.time_s[use])))))
    heading = heading[np.isfinite(heading)]
    walked = float(walked_m(found.time_s, found.step_length_m, time_s[0] - 1e-3, time_s[-1]))
    return _Scores(
        steps_percent=100.0 * found.n_steps / len(steps) if steps is not None else np.nan,
        distance_percent=100.0 * walked / along_m[-1],
        max_heading_deg=float(heading.max()),
        median_heading_deg=float(np.median(heading)),
        position_m=float(position_errors_m(estimate, reference, "first").mean()),
    )


def _smoothed(time_s: FloatArray, position_m: FloatArray, length_s: float) -> tuple[FloatArray, FloatArray]:
    """Moving mean of positions over even times; shorter by the length."""
    even_s = np.arange(time_s[0], time_s[-1], 0.02)
    even = np.column_stack([np.interp(even_s, time_s, position_m[:, k]) for k in (0, 1)])
    n = round(length_s / 0.02) // 2 * 2 + 1
    mean = np.column_stack([np.convolve(even[:, k], np.full(n, 1 / n), mode="valid") for k in (0, 1)])
    return even_s[n // 2 : len(even_s) - n // 2], mean


Recipe = Callable[[Subject | None], Any]
RECIPES: Mapping[str, Recipe] = {"ours": tian2016, "ours default": default}
# Rows of Tables VIII and IX, and the paper's values.
_QUANTITIES: Mapping[str, Callable[[Printed], float]] = {
    "steps, % of the true ones": lambda p: p.percent,
    "distance, % of the true one": lambda p: 100.0 * p.distance_m / PATH_M,
    "largest heading error, degrees": lambda p: p.max_heading_deg,
    "median heading error, degrees": lambda p: p.median_heading_deg,
    "mean position error, m": lambda p: p.position_m,
}


def _track_rows(printed: Printed, walks: Sequence[Recording], smooth_s: float = 0.0) -> list[Row]:
    """Rows of one column of Table VIII or IX: medians over our walks."""
    found = {
        name: [_scores(walk, track(walk, recipe(walk.subject)), smooth_s) for walk in walks]
        for name, recipe in RECIPES.items()
    }
    rows: list[Row] = []
    fields = ("steps_percent", "distance_percent", "max_heading_deg", "median_heading_deg", "position_m")
    for (quantity, of_paper), field in zip(_QUANTITIES.items(), fields, strict=True):
        row: Row = {"walk": printed.name, "n": len(walks), "": quantity, "paper": of_paper(printed)}
        ours = {k: float(np.median([getattr(s, field) for s in v])) for k, v in found.items()}
        if not np.isnan(list(ours.values())).all():
            rows.append(row | ours)
    return rows


def _humolire_rows(data: Path) -> Rows:
    """HOLDING at landmarks: mean over nine walks of what is known there."""
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in RECIPES}
    for walk in recordings(data, "humolire"):
        points = walk.truth.waypoints
        assert points is not None
        reference = np.column_stack([points.east_m, points.north_m])
        for name, recipe in RECIPES.items():
            own = track(walk, recipe(walk.subject))
            estimate = positions_at(own.time_s, own.position_m, points.time_s)
            position = position_errors_m(estimate, reference, "first")
            legs = 100.0 + straight_leg_error_percent(walk, own)
            share = 100.0 * position.mean() / path_m(reference)[-1]
            found[name].append((legs, float(position.mean()), share, end_error_percent(estimate, reference, "first")))
    holding = TABLE_VIII[0]
    names = {
        "distance of straight legs, % of the true one": _QUANTITIES["distance, % of the true one"](holding),
        "mean position error, m": holding.position_m,
        "mean position error, % of the path": 100.0 * holding.position_m / PATH_M,
        "end error, % of the path": np.nan,
    }
    return tuple(
        {"walk": "HOLDING", "n": len(found["ours"]), "": name, "paper": printed}
        | {who: float(np.median([v[k] for v in values])) for who, values in found.items()}
        for k, (name, printed) in enumerate(names.items())
        if found["ours"]
    )


# --- Step lengths ----------------------------------------------------------------------------------------------------


def _fits(subject: Subject) -> dict[str, StepLengthFit]:
    """The models of Table VII and the default's, for a person; the constants of eq. 3 and 4 are scaled later."""
    height_m = subject.height_m or 1.70

    def unit(model: Any) -> StepLengthFit:
        return StepLengthFit(model, np.ones(1), np.zeros((1, 1)), 0.06)

    models = (static_fit(height_m, subject.gender), unit(WeinbergStepLength()), unit(KimStepLength()))
    fits = dict(zip(TABLE_VII, (*models, tian_fit(height_m, subject.gender)), strict=True))
    return {**fits, "default's model": bounce_fit(height_m)}


def _table_vii(walks: Iterable[Recording]) -> tuple[Rows, int, int]:
    """Distances of one route, each model scaled so that their mean is 28 m; and how many walks of how many people."""
    found: dict[str, dict[str, list[float]]] = {name: {} for name in RECIPES}
    people: list[str] = []
    for walk in walks:
        labels, segments = walk.truth.labels, walk.truth.segments
        if labels is None or segments is None or str(labels["carrying_mode"][0]) != MODES["HOLDING"]:
            continue
        people.append(str(walk.subject.id))
        start_s, end_s = float(segments["start_s"][0]), float(segments["end_s"][0])
        for recipe_name, recipe in RECIPES.items():
            events = sensed_events(recipe(walk.subject).sensing, walk)
            steps = [e for e in events if isinstance(e, Step) and start_s <= e.time_s <= end_s]
            for name, fit in _fits(walk.subject).items():
                found[recipe_name].setdefault(name, []).append(sum(fit.predict(step)[0] for step in steps))
    rows: list[Row] = []
    for name, values in found["ours default"].items():
        ours, with_own = _scaled(values), _scaled(found["ours"][name])
        row: Row = {"distance, m": name}
        statistics = (ours.min(), ours.max(), np.median(ours), ours.std())
        for statistic, p, o in zip(
            ("minimum", "maximum", "median", "STD"), TABLE_VII.get(name, (np.nan,) * 4), statistics, strict=True
        ):
            row |= {f"paper {statistic}": p, f"ours {statistic}": float(o)}
        rows.append(row | {"ours STD, steps of tian2016": float(with_own.std())})
    return tuple(rows), len(people), len(set(people))


def _scaled(distance_m: Sequence[float]) -> FloatArray:
    return np.array(distance_m) * CORRIDOR_M / np.mean(distance_m)


# --- The study -------------------------------------------------------------------------------------------------------


def study(data: Path, size: Size | None = None) -> Study:
    """Tables VI to IX on ubicomp13, humolire and tyrex, and on simulated walks.

    Parameters
    ----------
    data : Path
        Folder of the data sets.
    size : Size, optional
        Smaller for a quick look.
    """
    size = size or Size()
    *modes, steps = _table_vi(data, size)
    return Study(
        name="tian2016",
        paper=PAPER,
        tables=(
            *modes,
            _of_step_lengths(data),
            steps,
            *_of_single_mode(data, size),
            _of_multi_mode(size),
        ),
        notes=(*printed_checks(), *_NOTES),
    )


_NOTES = (
    "Not remade: Tables I to V are the algorithms, in `pdr_filter.papers.tian2016.contexts`, "
    "`pdr_filter.papers.tian2016.steps` and "
    "`pdr_filter.papers.tian2016.heading`; Tables X and XI compare with what other papers print. The largest "
    "processing time of an iteration depends on the machine: `tests/benchmarks/throughput.py` has ours. Trained "
    "offsets of Table IX belong to their trousers. Figures 10, 11, 13 and 15 are tracks on maps that are not public.",
    "Simulated transitions take 1.2 s, which nobody has measured, and many stay below R_y and R_z: how many are missed "
    "says more about the simulator than about the method.",
)


def _table_vi(data: Path, size: Size) -> list[StudyTable]:
    """Table VI on ubicomp13 and simulated, and the steps of Table VIII, which are of the same recordings."""
    counted: dict[str, list[_Counted]] = {name: [] for name in RECIPES}
    for recording in recordings(data, "ubicomp13"):
        for name, recipe in RECIPES.items():
            own = _counted(recording, recipe(recording.subject))
            if own is not None:
                counted[name].append(own)
    tian, by_default = counted["ours"], counted["ours default"]
    in_pocket = [c for c in tian if c.true == "POCKET"]
    who = f"ubicomp13, {len(tian)} walks of 13 people, phone in the hand or in a trouser pocket"
    seen = (
        f"the mode most often said in each walk, in per cent of the walks, where the paper has that after each "
        "transition. Nobody swings the phone. Each phone in a pocket was put there before its walk: a transition was "
        f"seen before {sum(c.moved_before for c in in_pocket)} of {len(in_pocket)} of these walks; inside all walks "
        f"{sum(c.n_transitions for c in tian)} false ones. The default tells the mode of every window"
    )
    real = _table_vi_real(tian, by_default) if tian else ()
    steps = _table_viii_steps(tian, by_default) if tian else ()
    missing = "ubicomp13 is not in the folder: nothing measured"
    return [
        StudyTable("Table VI: mode classification, %", real, who if tian else missing, seen),
        StudyTable(
            "Table VI, simulated: modes after transitions, %",
            _table_vi_simulated(size),
            f"simulated, {size.n_people} people, {size.n_transitions} transitions on straight walks of 80 m",
            "nobody walked this; the number of people and transitions is the paper's. Columns are the true mode; the "
            "last two rows are in per cent of all transitions",
        ),
        StudyTable(
            "Table VIII, steps: those found in per cent of those counted",
            steps,
            who if tian else missing,
            "many people in place of one, counted on video; totals as in the paper, where errors of walks cancel, and "
            "absolute errors of single walks. The thresholds of tian2016 were chosen on people 1 to 6 of these 13",
        ),
    ]


def _of_step_lengths(data: Path) -> StudyTable:
    title = "Table VII: distances by four step-length models, scaled to a mean of 28 m"
    if not has(data, "ubicomp13"):
        return StudyTable(title, (), "ubicomp13 is not in the folder: nothing measured", "nothing to compare", 2)
    rows, n_walks, n_people = _table_vii(recordings(data, "ubicomp13"))
    return StudyTable(
        title,
        rows,
        f"ubicomp13, {n_walks} walks of {n_people} people with the phone in the hand",
        "one route for all, whose length is not published: every model is scaled, also eq. (2), which the paper leaves "
        "as it is, and the ratio of the constants of men and women is the printed one. Heights are the middle of "
        "published ranges; everybody walks at several paces in one walk, where the paper has slow, moderate and fast "
        "ones. Steps are those of the default recipe, nearly all right, so that models are compared and not steps; "
        "last column: those of tian2016, some of which are false and quick, which eq. (9) takes for long. Kim's model "
        "has |f| - g in place of the vertical",
        2,
    )


def _of_single_mode(data: Path, size: Size) -> list[StudyTable]:
    humolire = _humolire_rows(data)
    tyrex: list[Row] = []
    for printed, name in zip(TABLE_VIII, ("texting", "swinging", "frontpocket"), strict=True):
        walks = [r for r in recordings(data, "tyrex", f"*_nodist_{name}.zip")]
        tyrex += _track_rows(printed, walks, smooth_s=1.0) if walks else []
    simulated: list[Row] = []
    for k, printed in enumerate(TABLE_VIII):
        simulated += _track_rows(printed, _round_corners(printed, [printed.name], k, size.n_walks))
    return [
        StudyTable(
            "Table VIII: tracking in a single mode",
            humolire,
            f"humolire, {humolire[0]['n']} walks of one person of 1.86 m, HOLDING, medians"
            if humolire
            else "humolire is not in the folder: nothing measured",
            "219 to 239 m with many corners in place of 96 m with four; errors at 17 to 29 landmarks in place of every "
            "metre; turned and moved onto the first 20 % of the path, where the paper knows the start. The default's "
            "step length was fitted on these walks too",
            2,
        ),
        StudyTable(
            "Table VIII, in a room: tracking in a single mode",
            tuple(tyrex),
            "tyrex (nodist), one person, two minutes in each mode" if tyrex else "tyrex is not in the folder",
            "a room of 5 m in place of corridors: the walk is a string of turns, and the truth is the phone (mean over "
            "1 s). Height and gender are not known. The phone is in its place before the recording begins, so that "
            "the machine sees no transition and takes it to be held until something turns it fast; the offset is "
            "trained then. Steps are not known",
            2,
        ),
        StudyTable(
            "Table VIII, simulated: tracking in a single mode",
            tuple(simulated),
            f"simulated, {size.n_walks} walks of {PATH_M} m in each mode by people of 1.73 m, medians",
            "nobody walked this. Four right angles on sides of our own; HOLDING for the first 8 m, so that there is a "
            f"direction to train the offset with. {_SIMULATED_LENGTH}",
            2,
        ),
    ]


# measured on these walks
_SIMULATED_LENGTH = (
    "Simulated people have the step lengths of the simulator, which eq. (9) overestimates: the distance is no finding"
)


def _of_multi_mode(size: Size) -> StudyTable:
    rows: list[Row] = []
    for k, printed in enumerate(TABLE_IX):
        # the last walk of the paper has no SWING
        modes = ["POCKET", "HOLDING"] if k == len(TABLE_IX) - 1 else ["SWING", "POCKET"]
        rows += _track_rows(printed, _round_corners(printed, modes, 10 + k, size.n_walks))
    return StudyTable(
        "Table IX: tracking in several modes",
        tuple(rows),
        f"simulated, {size.n_walks} walks of {PATH_M} m for each column by people of the printed height, medians",
        "nobody walked this: no public walk of known path has a change of the carrying mode. HOLDING, then SWING after "
        "8 m, then POCKET on the third side (the last walk without SWING), where the phone lies as "
        f"everybody likes. A transition that is missed costs the rest of the walk. {_SIMULATED_LENGTH}",
        2,
    )


if __name__ == "__main__":
    from tests.studies.run import run

    run(study)
