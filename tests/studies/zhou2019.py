"""Zhou et al. 2019: behaviours, steps against Levi and Judd's method, and distances with seven length models.

usage: python -m tests.studies.zhou2019 [behaviours] [steps_and_distances]

behaviours: confusion matrix of the four behaviours (the paper has Fig. 5, of one person). Foot: pyshoe, in sample,
because the thresholds were chosen on these trials; a window is labelled if the speed of the foot in motion capture is
that of one behaviour in all of it. Phone: people on whom nothing was chosen; motionsense (sitting and standing,
walking and stairs, jogging) and, as irregular swing, handling of the phone before and after the walks of ubicomp13.

steps_and_distances: Tables 4 to 8. A foot: the trials of pyshoe, with motion capture. A phone elsewhere: oxford,
ubicomp13, humolire and ms_indoor. Runners, of whom no public recording has counted steps, are simulated.

Levi and Judd's method is what the paper says of it, with the band, spectra and thresholds of the other detector.
Parameters of the length models are those of other trials of pyshoe (some may be of the same person), of the person's
own other walks (humolire), of other persons in another building, and of other simulated persons.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks, firwin

from pdr_filter.evaluate.distance import percent_error
from pdr_filter.evaluate.steps import StepScores, best_offset_s, step_scores
from pdr_filter.evaluate.tracks import moved_m
from pdr_filter.filter.step_length.models import LinearStepLengthModel
from pdr_filter.offline.calibration.segments import Segment, segments_of, step_contexts
from pdr_filter.recipes import for_recording
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.zhou2019.contexts import BEHAVIOURS, BehaviourStage, BehaviourThresholds
from pdr_filter.recipes.zhou2019.contexts import CARRIED as CARRIED_BEHAVIOURS
from pdr_filter.recipes.zhou2019.contexts import FOOT as FOOT_BEHAVIOURS
from pdr_filter.recipes.zhou2019.step_length import M1, M2, M3, M4, M5, M6, M7
from pdr_filter.recipes.zhou2019.steps import CARRIED, FOOT, EventSearch, ReferenceLineStepDetector, dominant_period_s
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import detect_steps, run_sensing
from pdr_filter.tracking.whole_recording import track as track_of
from pdr_filter.values import CONTEXTS, STANDARD_GRAVITY_MPS2, FloatArray, Step, WindowContext, steps_of
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings
from tests.studies.data import (
    HEIGHT_M,
    NAN,
    Part,
    by_count,
    counted_walk,
    paper_table,
    people_left_out,
    prefixed,
    run_study,
    together,
    with_subject,
)

# --- steps ----------------------------------------------------------------------------------------------------------

# A foot that moves slower stands; the constants of a stance are those with which the detector's trials were counted.
_STANCE_MPS, _MIN_STANCE_S, _MIN_STRIDE_S, _MIN_STRIDE_M = 0.35, 0.06, 0.12, 0.1
# Faster than this on average a trial of pyshoe is run: walkers of the paper reach 2 m/s in the open, those in the room
# 1.5 m/s, and the one trial that is known to run has 1.8 m/s.
_RUN_MPS = 1.65
# Steps of the walk's edges belong to it if they are this close (counts on video begin and end with a foot in the air).
_EDGE_S = 0.3
_RATE_HZ = 100.0
# Levi and Judd: the one band of walking for all, spectra of 4 s, peaks at least 0.6 of a period apart (as in the
# detector, whose constants those of their method are) and as high as its smallest maximum. Their frequencies reach to
# those of runners.
_MIN_PERIOD_PART, _SPECTRUM_S, _LOW_PASS_TAPS = 0.6, 4.0, 51
LEVI_JUDD_FOOT, LEVI_JUDD_CARRIED = (
    replace(d.walking, max_frequency_hz=d.running.max_frequency_hz) for d in (FOOT, CARRIED)
)


def levi_judd_times_s(recording: Recording, search: EventSearch) -> FloatArray:
    """Steps (strides on a foot) as peaks, one to a period of the dominant frequency of the spectrum; ascending (K,).

    What Zhou et al. say of Levi and Judd's patent (US 5583776): a fast Fourier transform gives the frequency, which is
    used to detect peaks; one frequency band for walking and running. Over the whole recording, not causal.
    """
    _, blocks = Conditioner(_RATE_HZ).update(Conditioner(_RATE_HZ).init(), merge_streams(recording))
    found: list[FloatArray] = []
    taps = np.asarray(firwin(_LOW_PASS_TAPS, search.cutoff_hz, window="hamming", fs=_RATE_HZ), dtype=float)
    n = round(_SPECTRUM_S * _RATE_HZ)
    last_s = -np.inf
    for block in blocks:
        magnitude = specific_force_magnitude(block.specific_force_mps2) - STANDARD_GRAVITY_MPS2
        a = np.convolve(np.pad(magnitude, len(taps) // 2, mode="edge"), taps, mode="valid")
        for start in range(0, len(a), n):
            window = slice(start, start + n)
            period_s = dominant_period_s(a[window], search, _RATE_HZ)
            if period_s is None:
                continue
            gap_s = _MIN_PERIOD_PART * period_s
            peaks, _ = find_peaks(a[window], height=search.min_maximum_mps2, distance=max(gap_s * _RATE_HZ, 1.0))
            time_s = block.time_s[window][peaks]
            time_s = time_s[time_s - last_s >= gap_s]  # one hump is not two where two windows meet
            found.append(time_s)
            last_s = float(time_s[-1]) if len(time_s) else last_s
    return np.concatenate(found) if found else np.empty(0)


@dataclass(frozen=True, eq=False)
class FootTruth:
    """What motion capture sees of a foot: when strides ended, and how far the foot went from stance to stance."""

    stride_end_s: FloatArray  # (N,)
    way_m: float
    speed_mps: float  # while it strides


def foot_truth(recording: Recording) -> FootTruth:
    """Strides of the foot of a pyshoe recording: moves of more than 0.1 m between stances."""
    position = recording.truth.position
    if position is None:
        raise ValueError(f"{recording.name}: no truth_position.csv, which the strides of a foot are read from")
    place = np.column_stack([position.east_m, position.north_m, position.up_m])
    seen = np.concatenate([[True], (np.diff(place, axis=0) != 0).any(axis=1)])  # a lost marker stays to the last digit
    grid_s = np.arange(position.time_s[0], position.time_s[-1], 1.0 / _RATE_HZ)
    at = [np.interp(grid_s, position.time_s[seen], p) for p in place[seen].T]
    smooth = np.column_stack([np.convolve(np.pad(p, 4, mode="edge"), np.hanning(9) / 4, "valid") for p in at])
    speed = np.linalg.norm(np.gradient(smooth, 1.0 / _RATE_HZ, axis=0), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], speed > _STANCE_MPS, [0]]).astype(int))).reshape(-1, 2)
    moves: list[tuple[int, int]] = []
    for start, end in edges.tolist():
        if moves and start - moves[-1][1] < _MIN_STANCE_S * _RATE_HZ:  # too short for a stance
            start = moves.pop()[0]
        moves.append((start, end))
    # from the mean place of one stance to that of the next: a move is seen only where it is faster than a stance
    stances = zip([0, *(b for _, b in moves)], [*(a for a, _ in moves), len(smooth)], strict=True)
    places = np.array(
        [smooth[min(start, len(smooth) - 1) : max(end, start + 1)].mean(axis=0) for start, end in stances]
    )
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1).tolist()
    strides = [
        (a, b, length)
        for (a, b), length in zip(moves, lengths, strict=True)
        if length >= _MIN_STRIDE_M and b - a >= _MIN_STRIDE_S * _RATE_HZ
    ]
    end_s = grid_s[np.array([min(b, len(grid_s) - 1) for _, b, _ in strides], dtype=np.int64)]
    way_m = float(sum(length for *_, length in strides))
    duration_s = float(end_s[-1] - grid_s[strides[0][0]]) if strides else 0.0
    return FootTruth(end_s, way_m, way_m / duration_s if duration_s else 0.0)


@dataclass(frozen=True)
class Counted:
    """Steps of one walk by the two methods and by the default recipe."""

    source: str
    behaviour: str
    person: str
    levi_judd: StepScores
    ours: StepScores
    default: StepScores | None


def success_percent(scores: StepScores) -> float:
    """100 (1 - (over-counted + missed) / true): both kinds are wrong steps, as in Tables 4 and 5."""
    wrong = (scores.n_found - scores.n_matched) + (scores.n_true - scores.n_matched)
    return 100.0 * (1.0 - wrong / scores.n_true)


def _matched(true_s: FloatArray, found_s: FloatArray) -> StepScores:
    """Matches within half of the usual interval, a constant offset of the method's event taken off."""
    half_s = 0.5 * float(np.median(np.diff(true_s)))
    offset_s = best_offset_s(true_s, found_s, half_s, np.linspace(-2.0 * half_s, 2.0 * half_s, 41))
    return step_scores(true_s, found_s + offset_s, half_s)


def _events(detector: ReferenceLineStepDetector, config: Config) -> Config:
    """The recipe with one step for each event, which is a stride on a foot."""
    return replace(config, sensing=replace(config.sensing, steps=replace(detector, steps_per_event=1)))


def counted_on_foot(recording: Recording, detector: ReferenceLineStepDetector = FOOT) -> Counted:
    """Strides of a trial of pyshoe, by Levi and Judd's method and by a detector."""
    truth = foot_truth(recording)
    config = _events(detector, for_recording("zhou2019", recording))
    behaviour = "running" if truth.speed_mps > _RUN_MPS else "walking"
    ours = np.asarray(detect_steps(recording, config).time_s, dtype=float)
    theirs = levi_judd_times_s(recording, LEVI_JUDD_FOOT)
    levi_judd, bctfd = (_matched(truth.stride_end_s, found) for found in (theirs, ours))
    return Counted("pyshoe", behaviour, recording.name, levi_judd, bctfd, None)


@dataclass(frozen=True, eq=False)
class Followed:
    """A recording of a carried phone with what the recipes make of it."""

    recording: Recording
    levi_judd_s: FloatArray
    zhou: Track
    default: Track

    def counted(self, source: str, behaviour: str) -> Counted:
        """Steps against those of the truth: by their times, or by counts alone where only these are known."""
        steps, segments = self.recording.truth.steps, self.recording.truth.segments
        if steps is not None:
            true_s = np.asarray(steps.time_s, dtype=float)
            start_s, end_s, n_true = float(true_s[0]), float(true_s[-1]), len(true_s)
        elif segments is not None:
            true_s = None
            start_s, end_s, n_true = (segments[0][name] for name in ("start_s", "end_s", "n_steps"))
        else:
            raise ValueError(f"{self.recording.name}: neither truth_steps.csv nor truth_segments.csv")
        found = [
            time_s[(time_s >= start_s - _EDGE_S) & (time_s <= end_s + _EDGE_S)]
            for time_s in (self.levi_judd_s, self.zhou.time_s, self.default.time_s)
        ]
        scores = [by_count(int(n_true), len(f)) if true_s is None else _matched(true_s, f) for f in found]
        return Counted(source, behaviour, str(self.recording.subject.id or self.recording.name), *scores)


def followed(recording: Recording) -> Followed:
    """Both recipes and Levi and Judd's method on a recording."""
    zhou = track_of(recording, for_recording("zhou2019", recording))
    return Followed(recording, levi_judd_times_s(recording, LEVI_JUDD_CARRIED), zhou, track_of(recording))


# --- distances ------------------------------------------------------------------------------------------------------

# By the height of the person, which only M5 uses.
_LINEAR: Mapping[str, Callable[[float], LinearStepLengthModel]] = {
    "M1": lambda height_m: M1(),
    "M2": lambda height_m: M2(),
    "M3": lambda height_m: M3(),
    "M4": lambda height_m: M4(),
    "M5": M5,
    "M6": lambda height_m: M6(),
    "M7": lambda height_m: M7(),
}
MODELS = tuple(_LINEAR)
_RUNNING = CONTEXTS.index("running")
# Prior of each term of an average step, m: it decides between terms that are the same over few cadences, as 1, 1 / f
# and 1 / sqrt(f) of M7 do. A walk is taken to be known to 5 %, as persons differ.
_TERM_STD_M, _WALK_STD = 0.7, 0.05


@dataclass(frozen=True, eq=False)
class Walk:
    """Steps of a stretch of known length."""

    person: str
    true_m: float
    steps: tuple[Step, ...]
    part: FloatArray  # (n,) of each step that is inside
    is_running: tuple[bool, ...]  # (n,) as the behaviours were recognised
    height_m: float | None
    default_m: float  # distance of the default recipe; NaN where it does not apply

    def sums(self, model: str) -> FloatArray:
        """Sum of the regressors (p,): distance = sums @ theta. M7 has one more, of its running half."""
        walking, running = _LINEAR[model](self.height_m or HEIGHT_M), M6()
        has_two = model == "M7"
        n = walking.n_params
        total = np.zeros(n + (running.n_params if has_two else 0))
        for step, part, runs in zip(self.steps, self.part, self.is_running, strict=True):
            if has_two and runs:
                total[n:] += part * running.regressors(step)
            else:
                total[:n] += part * walking.regressors(step)
        return total


def fitted(sums: FloatArray, true_m: FloatArray) -> FloatArray:
    """Parameters (p,) of distances (N,) = sums (N, p) @ theta: least squares of relative errors, with a weak prior.

    The first term of a step is 0.7 +- 0.7 m on average, all others 0 +- 0.7 m.
    """
    # about so many steps; a term that no step has, like the running half of M7, is left at the prior
    per_step = np.abs(sums / np.maximum(true_m / _TERM_STD_M, 1.0)[:, None]).mean(axis=0)
    weight = np.where(per_step > 0, per_step, 1.0) / _TERM_STD_M
    matrix = np.vstack([sums / (_WALK_STD * true_m[:, None]), np.diag(weight)])
    wanted = np.concatenate([np.full(len(sums), 1.0 / _WALK_STD), np.arange(sums.shape[1]) == 0])
    return np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=float)


def errors_percent(walks: Sequence[Walk], model: str, rest: Callable[[Walk], Sequence[Walk]]) -> FloatArray:
    """Error of each walk (N,) with parameters of `rest(walk)`, walks that it is not among."""
    needed = {id(w): w for walk in walks for w in (walk, *rest(walk))}
    sums = {key: w.sums(model) for key, w in needed.items()}
    found: list[float] = []
    for walk in walks:
        others = rest(walk)
        theta = fitted(np.array([sums[id(w)] for w in others]), np.array([w.true_m for w in others]))
        found.append(float(percent_error(sums[id(walk)] @ theta, walk.true_m)))
    return np.array(found)


def without_the_person(walks: Sequence[Walk]) -> Callable[[Walk], Sequence[Walk]]:
    """All walks of other persons."""
    return lambda walk: [w for w in walks if w.person != walk.person]


def without_the_walk(walks: Sequence[Walk]) -> Callable[[Walk], Sequence[Walk]]:
    """All walks but this one."""
    return lambda walk: [w for w in walks if w is not walk]


def walk_of(found: Followed) -> Walk | None:
    """All stretches of known length of a recording as one walk; None if there is none with steps.

    Where landmarks mark the stretch, a step counts by its part along it, as the steps' own directions have it: people
    do not walk straight lines.
    """
    recording = found.recording
    segments = [s for s in segments_of(recording, found.zhou)[0] if s.inside.sum() >= 4]
    if not segments:
        return None
    start_s, end_s = [s.start_s for s in segments], [s.end_s for s in segments]
    default_m = float(moved_m(found.default.time_s, found.default.position_m, start_s, end_s).sum())
    return Walk(
        person=str(recording.subject.id or recording.meta.get("dataset")),
        true_m=sum(s.distance_m for s in segments),
        steps=tuple(step for s in segments for step in s.steps),
        part=np.concatenate([s.inside * _along(s) for s in segments]),
        is_running=tuple(bool(p.argmax() == _RUNNING) for s in segments for p in s.context_prob),
        height_m=recording.subject.height_m,
        default_m=default_m,
    )


def _along(segment: Segment) -> FloatArray:
    """Part of each step along the way from end to end, (n,)."""
    if segment.heading_rad is None:
        return np.ones(len(segment.steps))
    vector = segment.inside * np.exp(1j * segment.heading_rad)
    return np.cos(segment.heading_rad - np.angle(vector.sum()))


def foot_walk(recording: Recording) -> Walk:
    """A trial of pyshoe: two steps for each stride of the foot."""
    track = track_of(recording, for_recording("zhou2019", recording))
    steps = steps_of(track.steps)
    runs = tuple(bool(p.argmax() == _RUNNING) for p in step_contexts(track))
    return Walk(recording.name, foot_truth(recording).way_m, steps, np.ones(len(steps)), runs, None, NAN)


# --- simulated people -----------------------------------------------------------------------------------------------

_N_SIMULATED = 6
_SIMULATED_M = 400.0  # one lap of the paper's stadium
_STRAIGHT_M = 100.0


def simulated(person: int, behaviour: str, distance_m: float) -> Recording:
    """Somebody with the phone in a front pocket who walks or runs straights at changing cadence."""
    legs = [Leg("stationary", duration_s=5.0)]
    for k in range(max(round(distance_m / _STRAIGHT_M), 1)):
        factor, turn_rad = (0.9, 1.0, 1.1)[k % 3], -np.pi / 2 if k else 0.0
        legs.append(Leg(behaviour, distance_m=min(_STRAIGHT_M, distance_m), frequency_factor=factor, turn_rad=turn_rad))
    name = f"simulated_{behaviour}_{person}"
    recording = simulate(legs, Gait.random(2019 + person), "pocket", seed=person, name=name)
    return with_subject(recording, id=f"S{person}")


# --- tables ---------------------------------------------------------------------------------------------------------

_PAPER_SUCCESS = {"walking": (98.5, 99.1), "running": (97.1, 98.5)}  # Table 6: Levi and Judd, BCTFD
_PAPER_ERROR_PERCENT = {  # Table 8, M1 to M7
    "walking": (6.01, 5.08, 3.63, 6.33, 5.07, 6.47, 3.31),
    "running": (12.1, 9.9, 11.1, 8.32, 12.56, 7.83, 6.32),
}
# Tables 4 and 5: true steps, and over-counted and missed ones by Levi and Judd's method and by BCTFD.
_TABLES_4_AND_5 = {
    ("walking", "PA"): (891, (6, 10), (0, 0)),
    ("walking", "PB"): (747, (0, 6), (0, 0)),
    ("walking", "PC"): (877, (10, 6), (1, 0)),
    ("walking", "PD"): (870, (4, 4), (1, 0)),
    ("running", "PA"): (384, (0, 4), (0, 0)),
    ("running", "PB"): (349, (0, 11), (1, 0)),
    ("running", "PC"): (470, (0, 10), (4, 0)),
    ("running", "PD"): (401, (0, 8), (3, 0)),
}
_TABLE_7 = {  # distance in m, and errors of M1 to M7 in m
    ("walking", "PA"): (1200, (53.44, 49.78, 22.61, 52.82, 44.41, 38.46, 20.07)),
    ("walking", "PB"): (1200, (86.17, 53.46, 15.76, 117.6, 64.14, 157.06, 14.06)),
    ("walking", "PC"): (1200, (44.44, 26.36, 27.29, 19.81, 41.82, 28.39, 30.74)),
    ("walking", "PD"): (1200, (35.59, 85.46, 31.82, 56.42, 16.35, 62.81, 16.21)),
    ("running", "PA"): (800, (55.87, 35.54, 34.17, 37.79, 57.56, 31.11, 20.46)),
    ("running", "PB"): (800, (72.52, 70.14, 70.73, 43.29, 64.83, 49.75, 19.7)),
    ("running", "PC"): (800, (53.72, 51.15, 51.15, 50.91, 53.22, 50.05, 46.95)),
    ("running", "PD"): (800, (124.63, 128.34, 80.53, 65.86, 122.89, 55.73, 50.44)),
}
_SITES = ("humolire", "ms_indoor")
_PLACES = {
    "pyshoe": "foot, pyshoe (motion capture)",
    "oxford": "phone, oxford (foot switches)",
    "ubicomp13": "phone, ubicomp13, persons 7 to 13 (video, counts only)",
    "simulated": "phone in a pocket, simulated",
}


def _present(walk: Walk | None) -> list[Walk]:
    return [] if walk is None else [walk]


def _groups(counted: Sequence[Counted]) -> Iterator[tuple[str, str, list[Counted]]]:
    """Behaviour, source, and walks of both, those that there are."""
    for behaviour in ("walking", "running"):
        for source in _PLACES:
            own = [c for c in counted if (c.behaviour, c.source) == (behaviour, source)]
            if own:
                yield behaviour, source, own


def _amount(counted: Sequence[Counted]) -> str:
    words = [
        f"{_PLACES[source]}, {behaviour}: {len(own)} recordings"
        + (f" of {len({c.person for c in own})} person(s)" if source != "pyshoe" else " of persons not stated")
        for behaviour, source, own in _groups(counted)
    ]
    return "; ".join(words) if words else "none of the data sets is in the folder"


def _success(tables: Tables, counted: Sequence[Counted]) -> None:
    rows: list[Mapping[str, object]] = []
    for behaviour, source, own in _groups(counted):
        theirs, bctfd = _PAPER_SUCCESS[behaviour]
        default = [c.default for c in own if c.default is not None]
        rows.append(
            {
                "behaviour": behaviour,
                "where": _PLACES[source],
                "recordings": len(own),
                "paper Levi and Judd %": theirs,
                "paper BCTFD %": bctfd,
                "ours Levi and Judd %": float(np.mean([success_percent(c.levi_judd) for c in own])),
                "ours BCTFD %": float(np.mean([success_percent(c.ours) for c in own])),
                "ours worst BCTFD %": min(success_percent(c.ours) for c in own),
                "ours default %": float(np.mean([success_percent(s) for s in default])) if default else NAN,
            }
        )
    title = "Table 6: average success of step detection"
    paper_table(tables, "zhou2019_table_6", title, rows, _amount(counted))


def _signed_m(walks: Sequence[Walk], model: str, rest: Callable[[Walk], Sequence[Walk]]) -> FloatArray:
    true_m = np.array([w.true_m for w in walks])
    if model == "default":
        return np.array([w.default_m for w in walks]) - true_m
    return true_m * errors_percent(walks, model, rest) / 100.0


def _errors(
    tables: Tables, foot: Sequence[Walk], people: Mapping[str, Sequence[Walk]], hand: Mapping[str, Sequence[Walk]]
) -> None:
    humolire, mall = hand["humolire"], hand["ms_indoor"]
    everyone = [w for walks in people.values() for w in walks]

    def mean(walks: Sequence[Walk], model: str, rest: Callable[[Walk], Sequence[Walk]]) -> float:
        if not walks or (model in MODELS and not all(rest(w) for w in walks)):
            return NAN
        true_m = np.array([w.true_m for w in walks])
        return float(100.0 * np.mean(np.abs(_signed_m(walks, model, rest)) / true_m))

    rows: list[Mapping[str, object]] = []
    for number, model in enumerate((*MODELS, "default")):
        known = model in MODELS
        rows.append(
            {
                "model": model,
                "paper walking %": _PAPER_ERROR_PERCENT["walking"][number] if known else NAN,
                "ours foot, other trials %": mean(foot, model, without_the_walk(foot)),
                "ours hand, own other walks %": mean(humolire, model, without_the_walk(humolire)),
                "ours hand, other persons %": mean(humolire, model, lambda walk: mall),
                "ours hand, other way round %": mean(mall, model, lambda walk: humolire),
                "ours walking, simulated %": mean(people["walking"], model, without_the_person(everyone)),
                "paper running %": _PAPER_ERROR_PERCENT["running"][number] if known else NAN,
                "ours running, simulated %": mean(people["running"], model, without_the_person(everyone)),
            }
        )
    about = (
        f"pyshoe: {len(foot)} walking trials of {sum(w.true_m for w in foot):.0f} m together, persons not stated; "
        f"humolire: {len(humolire)} walks of one person; ms_indoor: {len(mall)} walks of surveyors not stated; "
        f"simulated: {len(people['walking'])} persons who walk and {len(people['running'])} who run"
    )
    title = "Table 8: average relative errors of the distance"
    paper_table(tables, "zhou2019_table_8", title, rows, about, digits=2)


def _by_person(tables: Tables, counted: Sequence[Counted]) -> None:
    """Tables 4 and 5: the paper's four persons, and ours."""
    rows: list[Mapping[str, object]] = []
    for (behaviour, person), (n_true, theirs, ours) in _TABLES_4_AND_5.items():
        row: dict[str, object] = {"behaviour": behaviour, "where": "paper, foot", "person": person, "true": n_true}
        for who, (over, missed) in (("Levi and Judd", theirs), ("BCTFD", ours)):
            success = 100.0 * (1.0 - (over + missed) / n_true)
            row |= prefixed(who, ("over-counted", "missed", "success %"), (over, missed, success))
        rows.append(row)
    for behaviour, _, own in _groups(counted):
        for person in sorted({_of_person(c) for c in own}):
            of_person = [c for c in own if _of_person(c) == person]
            first = of_person[0]
            row = {"behaviour": behaviour, "where": _PLACES[first.source], "person": person}
            for who, name in (("Levi and Judd", "levi_judd"), ("BCTFD", "ours")):
                sums = together([getattr(c, name) for c in of_person])
                row |= {"true": sums.n_true} if "true" not in row else {}
                cells = sums.n_found - sums.n_matched, sums.n_true - sums.n_matched, success_percent(sums)
                row |= prefixed(who, ("over-counted", "missed", "success %"), cells)
            rows.append(row)
    title = "Tables 4 and 5: step detection of each person"
    paper_table(tables, "zhou2019_table_4_5", title, rows, f"counts; {_amount(counted)}")


def _of_person(counted: Counted) -> str:
    return "not stated" if counted.source == "pyshoe" else counted.person


def _errors_m(tables: Tables, foot: Sequence[Walk], people: Mapping[str, Sequence[Walk]], hand: Sequence[Walk]) -> None:
    """Table 7: error of the distance of each person, m."""
    rows: list[Mapping[str, object]] = [
        {"behaviour": behaviour, "where": "paper, foot", "person": person, "walked m": walked_m}
        | dict(zip(MODELS, errors, strict=True))
        for (behaviour, person), (walked_m, errors) in _TABLE_7.items()
    ]
    everyone = [w for walks in people.values() for w in walks]
    groups = [("walking", "foot, pyshoe, other trials", foot, without_the_walk(foot))]
    groups += [("walking", "hand, humolire, own other walks", hand, without_the_walk(hand))]
    groups += [(b, "pocket, simulated, other persons", w, without_the_person(everyone)) for b, w in people.items()]
    for behaviour, where, walks, rest in groups:
        persons = ["not stated"] if walks is foot else sorted({w.person for w in walks})
        error_m = {model: np.abs(_signed_m(walks, model, rest)) for model in MODELS} if walks else {}
        for person in persons if walks else ():
            use = np.array([walks is foot or w.person == person for w in walks])
            row = {"behaviour": behaviour, "where": where, "person": person}
            row |= {"walked m": sum(w.true_m for w, u in zip(walks, use, strict=True) if u)}
            rows.append(row | {model: float(e[use].sum()) for model, e in error_m.items()})
    title = "Table 7: absolute errors of the distance of each person, m, summed over recordings"
    paper_table(tables, "zhou2019_table_7", title, rows, "parameters as in Table 8")


def steps_and_distances(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tables 4 to 8 of the paper, of the same walks."""
    counted: list[Counted] = []
    foot: list[Walk] = []
    for recording in recordings(arguments.data, "pyshoe"):
        counted.append(counted_on_foot(recording))
        if counted[-1].behaviour == "walking":  # one trial runs, and no other could give its parameters
            foot.append(foot_walk(recording))
    carried = {"oxford": recordings(arguments.data, "oxford"), "ubicomp13": people_left_out(arguments.data)}
    counted += [followed(r).counted(source, "walking") for source, walks in carried.items() for r in walks]
    people: dict[str, list[Walk]] = {"walking": [], "running": []}
    for behaviour, walks in people.items():
        for person in range(1, _N_SIMULATED + 1):
            found = followed(simulated(person, behaviour, _SIMULATED_M))
            counted.append(found.counted("simulated", behaviour))
            walks += _present(walk_of(found))
    hand = {
        site: [w for r in recordings(arguments.data, site) for w in _present(walk_of(followed(r)))] for site in _SITES
    }
    _success(tables, counted)
    _by_person(tables, counted)
    _errors(tables, foot, people, hand)
    _errors_m(tables, foot, people, hand["humolire"])


# --- behaviours -----------------------------------------------------------------------------------------------------

_STANDS_MPS, _WALKS_MPS = 0.05, 0.5  # speed of the foot: highest of a standing window, lowest mean of a moving one
_HANDLED_S = 2.0  # distance of handling from the walk


def _windows(recording: Recording, thresholds: BehaviourThresholds) -> list[tuple[float, float, str]]:
    """Start, end and behaviour of each window of the state machine."""
    stage = BehaviourStage(thresholds=thresholds)
    found = run_sensing(Sensing(contexts=stage, steps=FOOT if thresholds is FOOT_BEHAVIOURS else CARRIED), recording)[1]
    length_s = stage.windows.window_s
    return [(w.time_s - length_s, w.time_s, behaviour_of(w)) for w in found if isinstance(w, WindowContext)]


def behaviour_of(window: WindowContext) -> str:
    """Behaviour of a window: irregular swing is reported as standing with an irregular probability of one."""
    name = CONTEXTS[int(window.prob.argmax())]
    return name if name != "stationary" else ("irregular" if window.irregular_prob > 0.5 else "standing")


def _foot_label(recording: Recording) -> Callable[[float, float], str | None]:
    """Behaviour of the foot from motion capture; None between behaviours."""
    position = recording.truth.position
    assert position is not None
    place = np.column_stack([position.east_m, position.north_m, position.up_m])
    speed = np.linalg.norm(np.gradient(place, np.asarray(position.time_s), axis=0), axis=1)
    moving = "running" if foot_truth(recording).speed_mps > _RUN_MPS else "walking"

    def label(start_s: float, end_s: float) -> str | None:
        inside = speed[(position.time_s >= start_s) & (position.time_s <= end_s)]
        if len(inside) and np.quantile(inside, 0.95) < _STANDS_MPS:
            return "standing"
        return moving if len(inside) and inside.mean() > _WALKS_MPS else None

    return label


def _labelled(data: Path) -> Iterator[tuple[str, str, str]]:
    """Place of the sensor, true and found behaviour of each labelled window."""
    for recording in recordings(data, "pyshoe"):
        label = _foot_label(recording)
        for start_s, end_s, found in _windows(recording, FOOT_BEHAVIOURS):
            if (true := label(start_s, end_s)) is not None:
                yield "foot, in sample", true, found
    of_context = {"stationary": "standing", "running": "running"}  # stairs are walking
    for recording in recordings(data, "motionsense"):
        if int(str(recording.subject.id).strip("s")) > _N_CHOSEN and recording.truth.labels is not None:
            true = of_context.get(str(recording.truth.labels["context"][0]), "walking")
            for *_, found in _windows(recording, CARRIED_BEHAVIOURS):
                yield "phone, people held out", true, found
    for recording in people_left_out(data):
        first_s, last_s, _ = counted_walk(recording)
        for start_s, end_s, found in _windows(recording, CARRIED_BEHAVIOURS):
            if end_s < first_s - _HANDLED_S or start_s > last_s + _HANDLED_S:
                yield "phone, people held out", "irregular", found


_N_CHOSEN = 6  # people of motionsense on whom the thresholds were chosen


def behaviours(tables: Tables, arguments: argparse.Namespace) -> None:
    """Confusion matrix of the behaviours."""
    counts = Counter(_labelled(arguments.data))
    rows: list[Mapping[str, object]] = []
    for place in dict.fromkeys(place for place, *_ in counts):
        for true in BEHAVIOURS:
            of_row = [counts[place, true, found] for found in BEHAVIOURS]
            if sum(of_row):
                cells = prefixed("found", BEHAVIOURS, (100.0 * n / sum(of_row) for n in of_row), " %")
                rows.append({"sensor": place, "true": true, "windows": sum(of_row)} | cells)
    title = "Behaviours: confusion matrix of windows of 2 s"
    about = (
        "pyshoe (foot), motionsense and ubicomp13 (phone). Irregular is the time before and after the walks of "
        "ubicomp13, in which the phone is handled and at times at rest"
    )
    paper_table(tables, "zhou2019_behaviours", title, rows, about)


if __name__ == "__main__":
    run_study(
        __doc__,
        Part(make=behaviours, uses=("pyshoe", "motionsense", "ubicomp13")),
        Part(make=steps_and_distances, uses=("pyshoe", "oxford", "ubicomp13", *_SITES)),
    )
