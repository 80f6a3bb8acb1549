"""Contexts of windows and of the filter, for people and sensors that the classifier has not seen.

usage: python -m tests.benchmarks.weightings [joined] [sites] [barometer] [--data DATA] [--cache FOLDER]

joined: windows and delays of walks through several contexts. The changes of Di Fronzo's recordings are not labelled to
the second, so recordings of one person of MotionSense (trouser pocket) are put one after the other: sitting, walking,
upstairs, walking, downstairs, walking, running, standing. Each is turned so that its mean gravity agrees with the
first's, and between two of them is a second of the same person's standing; nothing is cross-faded. Two such walks of
each of 12 people. The model is the default's, trained in three folds without the four people that it is scored on; it
runs in the default recipe, in blocks of a tenth of a second.

sites: level walking that is called stairs, at the steps and by how the phone is carried. Models of the training sets
are trained without the whole set; the others are never trained on. With and without the guard of stairs.

barometer: one walk of ipin2023 goes up and down stairs with the phone in the hand. Truth is the climb rate of the
barometer about each step (4 s, not causal): above 0.1 m/s it is on stairs. All other walks stay on one storey.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from models.training import context_training as contexts
from models.training.context_training import PLANS, labelled_windows
from models.training.data_sets import DOUBTFUL, label_of, recordings_of
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.filter.chain.tracker import Tracker
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.offline.training.context_sequences import UNKNOWN
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.offline.training.transition_training import contexts_at
from pdr_filter.recipes import context_transitions, default, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.features.barometer import ClimbRate
from pdr_filter.sensing.front_end import Event
from pdr_filter.tracking.filtering import finish_filter, init_filter, update_filter
from pdr_filter.values import (
    CONTEXTS,
    BoolArray,
    FloatArray,
    ImuBlock,
    IntArray,
    Samples,
    Step,
    WindowContext,
    interpolated_rows,
    table,
)
from pdr_filter.values.events import Gap
from pdr_filter.values.recording import Recording, Truth
from tests.benchmarks.common import Tables, part_of, recordings, run

PLAN = PLANS[0]
N_FOLDS = 3  # groups of people of the joined walks
STILL_S = 1.0
BLOCK_S = 0.1
# Two seconds of walking: what a final step of HC and WC waits too.
LAG_STEPS = 4
STATIONARY, WALKING, UP, DOWN = (CONTEXTS.index(c) for c in ("stationary", "walking", "upstairs", "downstairs"))
# Trial of each part in the two walks of a person, and how much of it, s; walking is cut at another place each time.
N_WALKS = 2
PARTS: tuple[tuple[tuple[str, str], float], ...] = (
    (("sit_5", "sit_5"), 12.0),
    (("wlk_7", "wlk_8"), 25.0),
    (("ups_3", "ups_4"), 20.0),
    (("wlk_8", "wlk_15"), 20.0),
    (("dws_1", "dws_2"), 20.0),
    (("wlk_15", "wlk_7"), 20.0),
    (("jog_9", "jog_16"), 20.0),
    (("std_6", "std_14"), 12.0),
)


# --- Models of people left out ---------------------------------------------------------------------------------------


def cached(folder: Path | None, name: str, make: Callable[[], Any]) -> Any:
    """What `make` gives, from a file of the cache folder if it is there."""
    if folder is None:
        return make()
    path = folder / f"{name}.pkl"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(make()))
    return pickle.loads(path.read_bytes())  # our own


def windows_of(data: Path, cache: Path | None) -> LabelledWindows:
    """All windows that the default's model is made of."""

    def made() -> LabelledWindows:
        return PLAN.of(labelled_windows(recordings_of(data, PLAN.datasets), feature_set=PLAN.feature_set))

    return cached(cache, "windows", made)


def without(windows: LabelledWindows, people: Sequence[str], cache: Path | None, name: str) -> ContextModel:
    """Return the shipped context model, trained without some people."""
    return cached(cache, name, lambda: contexts.model_without(load_model(PLAN.name), PLAN, windows, people))


# --- Mixed walks of real recordings ----------------------------------------------------------------------------------


def walks_left_out(data: Path, cache: Path | None) -> Iterator[tuple[Recording, str, Config]]:
    """Joined walks of everybody, each with its person and the default with a model that has not seen them."""
    windows = windows_of(data, cache)
    people = sorted(set(windows.person[windows.dataset == "motionsense"]))
    for k in range(N_FOLDS):
        model = without(windows, people[k::N_FOLDS], cache, f"model_{k}")
        for person in people[k::N_FOLDS]:
            for number in range(N_WALKS):
                walk = mixed_walk(data, "s" + person.split("/")[1][-2:], number)
                yield walk, person, with_context_model(default(walk.subject), model)


def mixed_walk(data: Path, person: str, number: int) -> Recording:
    """Recordings of one person one after the other, a still second between them, labels of each."""

    def trial(name: str) -> Recording:
        return pdr.read(data / "motionsense" / f"motionsense_{person}_{name}.zip")

    def labelled_right(names: tuple[str, str]) -> str:
        other = (names[number], *names)
        return next(name for name in other if f"motionsense_{person}_{name}" not in DOUBTFUL)

    standing = trial("std_6")

    def pieces() -> Iterator[Piece]:
        for k, (names, length_s) in enumerate(PARTS):
            if k > 0:
                yield *clip(standing, 10.0 + k, STILL_S), "stationary"
            recording = trial(labelled_right(names))
            context = str(recording.truth.labels["context"][0])
            # 4 s in: the phone has been put away by then
            start_s = 4.0 + 3.0 * k * (context == "walking")
            last_s = max(recording.accelerometer.time_s[-1] - length_s, 0.0)
            yield *clip(recording, min(start_s, last_s), length_s), context

    interval_s = float(np.median(np.diff(standing.accelerometer.time_s)))
    return joined_walk(f"{person}_{number}", pieces(), interval_s, standing.meta)


Piece = tuple[FloatArray, FloatArray, str]  # specific force (N, 3), angular rate (N, 3), context


def joined_walk(name: str, pieces: Iterable[Piece], interval_s: float, meta: Mapping[str, Any]) -> Recording:
    """Pieces of recordings one after the other, turned to the mean gravity of the first, with labels of each.

    Nothing is cross-faded. The phone is in a trouser pocket.
    """
    force, rate, names = list[FloatArray](), list[FloatArray](), list[str]()
    for own_force, own_rate, context in pieces:
        down = force[0].mean(axis=0) if force else own_force.mean(axis=0)
        turn = Rotation.align_vectors([down], [own_force.mean(axis=0)])[0]
        force.append(turn.apply(own_force))
        rate.append(turn.apply(own_rate))
        names.append(context)
    edges_s = interval_s * np.cumsum([0, *map(len, force)])
    time_s = interval_s * np.arange(sum(map(len, force)))
    labels = {"start_s": edges_s[:-1], "end_s": edges_s[1:], "context": np.array(names)}
    return Recording(
        name=name,
        accelerometer=Samples(time_s, np.concatenate(force)),
        gyroscope=Samples(time_s, np.concatenate(rate)),
        truth=Truth(labels=table(labels | {"carrying_mode": np.full(len(names), "pocket")})),
        meta=dict(meta),
    )


def clip(recording: Recording, start_s: float, length_s: float) -> tuple[FloatArray, FloatArray]:
    """Specific force and angular rate of a part; of a shorter recording what there is."""
    force, rate = recording.accelerometer, recording.gyroscope
    assert rate is not None
    use = (force.time_s >= start_s) & (force.time_s < start_s + length_s)
    return force.values[use], interpolated_rows(force.time_s[use], rate.time_s, rate.values)


# --- What was said, and when -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Said:
    """Of a walk: windows and steps with their probabilities and when they became known."""

    walk: Recording
    person: str
    window_s: FloatArray  # (W,) ends
    window_known_s: FloatArray
    window_prob: FloatArray  # (W, C)
    step_s: FloatArray  # (K,)
    step_known_s: FloatArray
    of_window: FloatArray  # (K, C) the window that each step used
    filtered: FloatArray  # (K, C)
    smoothed: FloatArray  # (K, C)

    @property
    def lagged(self) -> FloatArray:
        """Of each step with the evidence of some more, (K, C)."""
        return smoothed_mode_prob(self.filtered, context_transitions(), LAG_STEPS)

    @property
    def lagged_known_s(self) -> FloatArray:
        """When that is known, (K,): with the step so many later, or with the last."""
        return self.step_known_s[np.minimum(np.arange(len(self.step_s)) + LAG_STEPS, len(self.step_s) - 1)]


def said_online(walk: Recording, person: str, config: Config) -> Said:
    """Everything that the filter says, samples pushed in blocks of a tenth of a second, and the smoother after it."""
    samples = pdr.merge_streams(walk)
    state = init_filter(config)
    windows: list[tuple[float, Any]] = []
    updates: list[tuple[float, Any]] = []
    for block in blocks(samples):
        state, output = update_filter(config, state, block)
        known_s = float(block.time_s[-1])
        windows += [(known_s, w) for w in output.windows]
        updates += [(known_s, u) for u in output.updates if u.is_final]
    state, output = finish_filter(config, state)
    end_s = float(samples.time_s[-1])
    updates += [(end_s, u) for u in output.updates if u.is_final]
    smoothed = pdr.smooth(walk, config=config).track
    assert len(smoothed.time_s) == len(updates)
    return Said(
        walk,
        person,
        np.array([w.time_s for _, w in windows]),
        np.array([t for t, _ in windows]),
        np.array([w.prob for _, w in windows]),
        np.array([u.step.time_s for _, u in updates]),
        np.array([t for t, _ in updates]),
        np.array([u.context_prob for _, u in updates]),
        np.array([u.mode_prob for _, u in updates]),
        smoothed.mode_prob,
    )


def mean_of_five(prob: FloatArray) -> FloatArray:
    """Mean probabilities (W, C) of each window with two before and two after it: what averaging alone is worth."""
    return np.array([prob[max(k - 2, 0) : k + 3].mean(axis=0) for k in range(len(prob))])


def blocks(samples: ImuBlock) -> Iterator[ImuBlock]:
    """The samples in blocks of a tenth of a second."""
    edges = np.searchsorted(samples.time_s, np.arange(BLOCK_S, samples.time_s[-1] + BLOCK_S, BLOCK_S))
    for start, end in pairwise([0, *edges]):
        if end > start:
            yield part_of(samples, slice(start, end))


def context_at(walk: Recording, time_s: float) -> int:
    """True context at a time, `UNKNOWN` outside every label and in the still seconds put in."""
    for label in walk.truth.labels:
        if label["start_s"] <= time_s < label["end_s"] and label["end_s"] - label["start_s"] > 2 * STILL_S:
            return CONTEXTS.index(str(label["context"]))
    return UNKNOWN


def last_steps(said: Said) -> IntArray:
    """The last step that used each window, (W,): in its last second; -1 where there is none."""
    last = np.searchsorted(said.step_s, said.window_s) - 1
    found = (last >= 0) & (said.step_s[np.maximum(last, 0)] >= said.window_s - 1.0)
    return np.where(found, last, -1)


def answers_of(said: Said) -> dict[str, IntArray]:
    """Context of each window by each answer, (W,); stationary where a window has no step."""
    last = last_steps(said)
    found = {"arg-max": said.window_prob.argmax(axis=1), "mean of 5": mean_of_five(said.window_prob).argmax(axis=1)}
    for name in ("filtered", "lagged", "smoothed"):
        found[name] = np.where(last >= 0, getattr(said, name)[last].argmax(axis=1), STATIONARY)
    return found


def window_scores(tables: Tables, all_said: list[Said]) -> None:
    """Accuracy over windows, clean or not, with and without those that have no step."""
    rows, by_walk = [], [answers_of(said) for said in all_said]
    answers = {name: np.concatenate([of_walk[name] for of_walk in by_walk]) for name in by_walk[0]}
    ends = [(said, t) for said in all_said for t in said.window_s]
    y = np.array([context_at(said.walk, t - 1.0) for said, t in ends])
    is_clean = np.array([label_of(said.walk, t - 2.0, t) is not None for said, t in ends])
    who = np.array([said.person for said, _ in ends])
    has_step = np.concatenate([last_steps(said) >= 0 for said in all_said])
    for name, use in (
        ("inside one context, with a step", is_clean & has_step & (y >= 0)),
        ("inside one context, all", is_clean & (y >= 0)),
        ("also across a change, all", y >= 0),
    ):
        right = {answer: of == y for answer, of in answers.items()}
        for answer, ok in right.items():
            recall = ", ".join(f"{ok[use & (y == c)].mean():.2f}" for c in np.unique(y[use]))
            by_person = np.array([ok[use & (who == p)].mean() for p in np.unique(who)])
            gain = by_person - np.array([right["arg-max"][use & (who == p)].mean() for p in np.unique(who)])
            points = f"{100 * gain.mean():+.1f} ± {100 * gain.std(ddof=1) / np.sqrt(len(gain)):.1f}"
            people = f"{np.sum(gain > 1e-9)}, {np.sum(gain < -1e-9)}"
            rows.append([f"{name} (n = {use.sum()})", answer, f"{ok[use].mean():.3f}", recall, points, people])
    columns = "windows | answer | accuracy | recall by context | gain, points | people better, worse"
    order = ", ".join(CONTEXTS[c] for c in np.unique(y[y >= 0]))
    about = f"Recall in the order {order}; gain over the arg-max, mean of people."
    tables.write("mixed_contexts_windows", columns, rows, about)


def delays_s(said: Said, known_s: FloatArray, prob: FloatArray) -> dict[int, list[float]]:
    """Time from each change to a moving context until it is named for a second on end; infinite if it never is."""
    result: dict[int, list[float]] = {}
    answer = prob.argmax(axis=1)
    for label in said.walk.truth.labels[1:]:
        context = CONTEXTS.index(str(label["context"]))
        if context == STATIONARY:
            continue
        found = np.inf
        for i in np.flatnonzero((known_s >= label["start_s"]) & (known_s < label["end_s"])):
            if (answer[(known_s >= known_s[i]) & (known_s <= known_s[i] + 1.0 + BLOCK_S)] == context).all():
                found = float(known_s[i] - label["start_s"])
                break
        result.setdefault(context, []).append(found)
    return result


def delays(tables: Tables, all_said: list[Said]) -> None:
    """Median and ninth decile of the delays, by context."""
    rows = []
    for name, known, prob in (
        ("arg-max", "window_known_s", "window_prob"),
        ("filtered", "step_known_s", "filtered"),
        ("lagged", "lagged_known_s", "lagged"),
        ("arg-max of its step, by the step's own time", "step_s", "of_window"),
        ("filtered, by the step's own time", "step_s", "filtered"),
        ("smoothed, by the step's own time", "step_s", "smoothed"),
    ):
        found: dict[int, list[float]] = {}
        for said in all_said:
            for context, of_walk in delays_s(said, getattr(said, known), getattr(said, prob)).items():
                found.setdefault(context, []).extend(of_walk)
        every = [d for of_context in found.values() for d in of_context]
        by_context = {"all": every, **{CONTEXTS[c]: d for c, d in sorted(found.items())}}
        cells = [
            f"{np.quantile(d, 0.5, method='higher'):.1f}, {np.quantile(d, 0.9, method='higher'):.1f}"
            for d in by_context.values()
        ]
        rows.append([name, *cells, f"{np.isinf(every).sum()} of {len(every)}"])
    columns = ["answer", *by_context, "never"]
    tables.write("mixed_contexts_delays", columns, rows, "Seconds: median, 90 %; never found counts as infinite.")


def tracked(events: list[Event], config: Config, weighting: str) -> list[StepUpdate]:
    """Final steps of the events of a walk."""
    tracker = config.with_weighting(weighting).tracker
    return updates_of(tracker, events)


def updates_of(tracker: Tracker[Any], events: list[Event]) -> list[StepUpdate]:
    """Final steps that a tracker makes of the events of a walk."""
    state, updates = tracker.init(), list[StepUpdate]()
    for event in events:
        if isinstance(event, WindowContext):
            state, new = tracker.on_window(state, event)
        elif isinstance(event, Gap):
            state, new = tracker.on_gap(state, event.duration_s)
        elif isinstance(event, Step):
            state, new = tracker.on_step(state, event)
        else:  # motion without steps, which is also part of the next step
            continue
        updates += [u for u in new if u.is_final]
    return updates + [u for u in tracker.finish(state)[1] if u.is_final]


def joined(tables: Tables, arguments: argparse.Namespace) -> None:
    """Both tables."""
    all_said = [said_online(*each) for each in walks_left_out(arguments.data, arguments.cache)]
    window_scores(tables, all_said)
    delays(tables, all_said)


STAIRS_MPS = 0.1
# Data sets of level walking, each with the field of the recording's name that has the carrying mode.
SITES = {"humolire": 0, "ms_indoor": 0, "tyrex": 2, "oxiod": 1, "ubicomp13": 3, "ipol": 0, "sisfall": -1}


def sites(tables: Tables, arguments: argparse.Namespace) -> None:
    """Level walking called stairs."""
    windows = windows_of(arguments.data, arguments.cache)
    rows = []
    for site, part in SITES.items():
        known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
        model = without(windows, known, arguments.cache, f"site_{site}")
        of_kind: dict[str, list[FloatArray]] = {}
        for recording in recordings(arguments.data, site):
            kind = kind_of(recording.name, part)
            found = []
            for each in (replace(model, stairs=None), model):
                track = pdr.track(recording, with_context_model(default(recording.subject), each))
                use = on_the_level(recording, track.time_s)
                stairs = np.isin(track.mode_prob[use].argmax(axis=1), (UP, DOWN))
                found += [stairs, track.mode_prob[use][:, [UP, DOWN]].sum(axis=1)]
            of_kind.setdefault(kind, []).append(np.array(found, dtype=float))
        for kind, parts in sorted(of_kind.items()):
            figures = np.concatenate(parts, axis=1)
            if figures.shape[1]:
                cells = [f"{100 * v:.1f}" for v in figures.mean(axis=1)]
                rows.append([f"{site} {kind}".strip(), figures.shape[1], ", ".join(cells[:2]), ", ".join(cells[2:])])
    columns = "set, placement | steps | no guard: called stairs %, mean probability % | with the guard"
    tables.write("context_false_stairs", columns, rows, "A set that is in the training is held out as a whole.")


def kind_of(name: str, part: int) -> str:
    """How the phone is carried, from the name of a recording."""
    if part == 0:
        return ""
    pieces = name.split("_")
    text = " ".join(pieces[part:]) if part > 0 else pieces[-1]
    return "".join(c for c in text if not c.isdigit()).strip() if part != -1 else text[:3]


def on_the_level(recording: Recording, time_s: FloatArray) -> BoolArray:
    """Which steps are inside the walk, and not labelled as anything but walking."""
    segments, labels = recording.truth.segments, recording.truth.labels
    if recording.meta["dataset"] == "ubicomp13" and segments is not None:
        return (time_s >= segments[0]["start_s"]) & (time_s <= segments[0]["end_s"])
    if labels is None or not len(labels) or recording.meta["dataset"] == "sisfall":
        return np.ones(len(time_s), dtype=bool)
    return np.isin(contexts_at(recording, time_s), (WALKING, -1))


def changes_storey(recording: Recording) -> bool:
    """True if the waypoints are on several storeys."""
    return len(set(recording.truth.waypoints.floor.tolist())) > 1


def barometer(tables: Tables, arguments: argparse.Namespace) -> None:
    """Stairs in the hand, by barometer."""
    of_walks: dict[str, list[dict[str, IntArray]]] = {}
    for site in ("ipin2023", "ipin21"):
        for recording in recordings(arguments.data, site):
            config = default(recording.subject)
            live, later = pdr.track(recording, config=config), pdr.smooth(recording, config=config).track
            alone = pdr.track(replace(recording, barometer=None), config=config)
            is_climbing = changes_storey(recording)
            said = {
                "truth": climbs_at(recording, live.time_s) if is_climbing else np.full(live.n_steps, WALKING),
                "without barometer": alone.mode_prob.argmax(axis=1),
                "window": live.context_prob.argmax(axis=1),
                "filtered": live.mode_prob.argmax(axis=1),
                "smoothed": later.mode_prob.argmax(axis=1),
            }
            of_walks.setdefault(f"{site}, {'stairs' if is_climbing else 'one storey'}", []).append(said)
    rows: list[list[str]] = []
    for name, walks in of_walks.items():
        truth, *answers = (np.concatenate([walk[column] for walk in walks]) for column in walks[0])
        for answer, best in zip(list(walks[0])[1:], answers, strict=True):
            cells = [f"{np.mean(best[truth == c] == c):.2f}" if (truth == c).any() else "-" for c in (UP, DOWN)]
            level = np.isin(best, (UP, DOWN))[truth == WALKING]
            rows.append([f"{name} ({len(walks)}, {len(truth)} steps)", answer, *cells, f"{level.mean():.2f}"])
    columns = "walks | answer | climbing called upstairs | descending called downstairs | level called stairs"
    tables.write("context_barometer", columns, rows, "Climb rates above 0.1 m/s, of the barometer about each step.")


def climbs_at(recording: Recording, time_s: FloatArray) -> IntArray:
    """Level walking, stairs up or stairs down at times (K,), by the climb rate of the barometer about each."""
    climb, pressure = ClimbRate(), recording.barometer
    assert pressure is not None
    _, climbs = climb.update(climb.init(), pressure.time_s, pressure.values[:, 0])
    middle_s = np.array([c.time_s - climb.window_s / 2 for c in climbs])
    rate_mps = np.interp(time_s, middle_s, [c.climb_rate_mps for c in climbs])
    return np.where(rate_mps > STAIRS_MPS, UP, np.where(rate_mps < -STAIRS_MPS, DOWN, WALKING))


if __name__ == "__main__":
    run(__doc__, joined, sites, barometer, cache=None)
