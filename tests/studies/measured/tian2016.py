"""What is measured here for the tables of Tian et al. 2016."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pdr_filter.evaluate.distance import walked_m
from pdr_filter.evaluate.tracks import (
    directions_rad,
    first_of_path,
    heading_errors_rad,
    path_m,
    position_errors_m,
    positions_at,
    rigid_fit,
)
from pdr_filter.filter.step_length.models import (
    KimStepLength,
    StepLengthFit,
    WeinbergStepLength,
    bounce_fit,
    static_fit,
)
from pdr_filter.recipes import default, tian2016
from pdr_filter.recipes.tian2016.recipe import tian_fit
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.sensing.front_end import Event
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.motion import CARRYING
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CARRYING_MODES, FloatArray, Step
from pdr_filter.values.recording import Recording, Subject
from tests.studies.data import counted_walk, with_subject
from tests.studies.printed.tian2016 import CORRIDOR_M, MODES, N_PEOPLE, N_TRANSITIONS, PATH_M, TABLE_VII, Printed

# --- Carrying modes --------------------------------------------------------------------------------------------------

TRANS = "TRANS"


@dataclass(frozen=True)
class Size:
    """How much is simulated; the paper's own numbers unless said otherwise."""

    n_people: int = N_PEOPLE
    n_transitions: int = N_TRANSITIONS
    n_walks: int = 3  # of each column of Tables VIII and IX, each of another gait


def modes_said(carrying_prob: FloatArray) -> list[str]:
    """What the machine says, or the most probable mode in its terms; none probable is TRANS."""
    names = {ours: paper for paper, ours in MODES.items()}
    # a phone at the ear is held, one in a bag lies as in a pocket (docs/methods/tian2016.md)
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

    def transitions(self) -> list[tuple[float, str]]:
        """Start of each transition, and the mode after it."""
        found: list[tuple[float, str]] = []
        for k in range(1, len(self.mode)):
            if self.mode[k] == TRANS and self.mode[k - 1] != TRANS:
                after = next((m for m in self.mode[k:] if m != TRANS), TRANS)
                found.append((float(self.time_s[k]), after))
        return found


@dataclass(frozen=True, eq=False)
class Counted:
    """Of one recording and one recipe: the mode most often said in the walk, transitions in it, and its steps."""

    true: str
    most: str
    moved_before: bool  # whether a transition was seen before the walk
    n_transitions: int
    n_found: int
    n_true: int


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
    starts = np.array([t for t, _ in said.transitions()])
    return Counted(
        true=mode[str(labels["carrying_mode"][0])],
        most=said.most(start_s, end_s),
        moved_before=bool((starts < start_s).any()),
        n_transitions=int(((starts >= start_s) & (starts <= end_s)).sum()),
        n_found=int(((steps_s >= start_s) & (steps_s <= end_s)).sum()),
        n_true=n_true,
    )


def _carried(events: Sequence[Event]) -> Carried:
    windows = [e for e in events if isinstance(e, WindowContext)]
    prob = np.array([w.carrying_prob for w in windows]).reshape(-1, len(CARRYING_MODES))
    return Carried(np.array([w.time_s for w in windows]), modes_said(prob))


# --- Simulated walks -------------------------------------------------------------------------------------------------


def _places(rng: np.random.Generator) -> dict[str, Carrying]:
    """Where a simulated person has the phone: in a pocket top up or down, screen in or out; in either swinging hand."""

    def turned(place: Carrying, roll_rad: float, twist_rad: float) -> Carrying:
        roll_rad, twist_rad = roll_rad + rng.normal(0.0, 0.2), twist_rad + rng.normal(0.0, 0.3)
        return replace(place, roll_rad=float(roll_rad), twist_rad=float(twist_rad))

    side = float(rng.choice([-1.0, 1.0]))
    pocket = turned(CARRYING["pocket"], float(rng.choice([0.0, np.pi])), float(rng.choice([0.0, np.pi])))
    return {**CARRYING, "swinging": turned(CARRYING["swinging"], (side - 1) * np.pi / 2, 0.0), "pocket": pocket}


def _changes(rng: np.random.Generator, n: int) -> list[str]:
    """Modes in a row, each another than the one before; HOLDING is before the first."""
    modes = ["HOLDING"]
    for _ in range(n):
        modes.append(str(rng.choice([m for m in MODES if m != modes[-1]])))
    return modes[1:]


def straight_walks(size: Size) -> Iterable[tuple[Recording, list[str]]]:
    """Walks of 80 m of people who change the mode about six times, and the modes that they change to."""
    least, more = divmod(size.n_transitions, size.n_people)
    for i in range(size.n_people):
        rng = np.random.default_rng([6, i])
        modes = _changes(rng, least + (i < more))
        leg_m = 80.0 / (len(modes) + 1)
        legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=leg_m)]
        legs += [Leg("walking", distance_m=leg_m, carrying_mode=MODES[m]) for m in modes]
        yield simulate(legs, Gait.random(i), seed=i, rate_hz=50.0, carrying=_places(rng)), modes


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


def round_corners(printed: Printed, modes: Sequence[str], column: int, n: int) -> list[Recording]:
    """Walks of a person of the height and gender of a column, each with another gait and other places of the phone."""
    walks: list[Recording] = []
    for i in range(n):
        rng = np.random.default_rng([9, column, i])
        gait = replace(Gait.random(100 * column + i), height_m=printed.height_m)
        walk = simulate(_turns(modes), gait, seed=100 * column + i, rate_hz=50.0, carrying=_places(rng))
        walks.append(with_subject(walk, gender=printed.gender))
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


def scores_of(recording: Recording, found: Track, smooth_s: float = 0.0) -> _Scores:
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


# --- Step lengths ----------------------------------------------------------------------------------------------------


def fits_of(subject: Subject) -> dict[str, StepLengthFit]:
    """The models of Table VII and the default's, for a person; the constants of eq. 3 and 4 are scaled later."""
    height_m = subject.height_m or 1.70

    def unit(model: Any) -> StepLengthFit:
        return StepLengthFit(model, np.ones(1), np.zeros((1, 1)), 0.06)

    models = (static_fit(height_m, subject.gender), unit(WeinbergStepLength()), unit(KimStepLength()))
    fits = dict(zip(TABLE_VII, (*models, tian_fit(height_m, subject.gender)), strict=True))
    return {**fits, "default's model": bounce_fit(height_m)}


def scaled(distance_m: Sequence[float]) -> FloatArray:
    return np.array(distance_m) * CORRIDOR_M / np.mean(distance_m)
