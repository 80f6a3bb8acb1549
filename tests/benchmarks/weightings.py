"""HC, WC and IMM on people and sensors that the classifier has not seen: distances and probabilities.

usage: python -m tests.benchmarks.weightings [--data ../shared/data] [--cache FOLDER]

The steps, windows and lengths of the default recipe are the same for all weightings; the reference is the distance of
these steps with the length of their true contexts. What differs is the error that is due to contexts. Steps outside of
every label, and those in the still seconds of the joined walks, are left out.

Walks joined of recordings of one activity (`mixed_contexts.py`) and the recordings of Di Fronzo with their real
changes, models trained without the people; terrain, a sensor on the leg that no model has seen; and level walking of
tyrex, left out as a whole, and of every third walk of ubicomp13, which trains nothing. Distances of each weighting, and
the probabilities behind them, also of the recordings of MotionSense with one activity each.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.evaluate.comparison import second_over_first
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.offline.training.context_sequences import UNKNOWN
from pdr_filter.offline.training.cross_validation import DOUBTFUL, LabelledWindows, recordings_of
from pdr_filter.recipes import default, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, FloatArray, IntArray, Step
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, paths, run
from tests.benchmarks.contexts_left_out import N_FOLDS as N_LEFT_OUT_FOLDS
from tests.benchmarks.contexts_left_out import on_the_level, without
from tests.benchmarks.mixed_contexts import (
    LAG_STEPS,
    Event,
    cached,
    context_at,
    tracked,
    updates_of,
    walks_left_out,
    windows_of,
)

WALKING = CONTEXTS.index("walking")
MIN_STEPS = 20  # a recording with fewer says little in per cent
EVERY = 3
WC_THRESHOLD = 0.8  # of Algorithm 2
WC_THRESHOLDS = {"WC, threshold 0.8": WC_THRESHOLD, "WC, always": 0.0}


@dataclass(frozen=True, eq=False)
class Walk:
    """Of a recording: what the front end found, without steps whose context is not known."""

    recording: Recording
    person: str
    config: Config
    events: list[Event]
    label: IntArray  # (K,) true context of each step

    @property
    def length_m(self) -> FloatArray:
        """Length of each step in each mode, (K, M); the default's modes are the contexts."""
        return np.array([self.config.model.lengths(e)[0] for e in self.events if isinstance(e, Step)])

    @property
    def known_m(self) -> float:
        """Distance in the true contexts."""
        return float(self.length_m[np.arange(len(self.label)), self.label].sum())


def walk_of(recording: Recording, person: str, config: Config, is_level: bool = False) -> Walk:
    """A recording through the front end; of level walking alone what is not labelled as something else."""
    found = run_sensing(config.sensing, recording)[1]
    time_s = np.array([e.time_s for e in found if isinstance(e, Step)])
    if is_level:
        label = np.where(on_the_level(recording, time_s), WALKING, UNKNOWN)
    else:
        label = np.array([context_at(recording, t) for t in time_s], dtype=np.int64)
        label[time_s >= DOUBTFUL.get(recording.name, np.inf)] = UNKNOWN
    known = iter(label != UNKNOWN)
    events = [e for e in found if not isinstance(e, Step) or next(known)]
    return Walk(recording, person, config, events, label[label != UNKNOWN])


# --- Real walks ------------------------------------------------------------------------------------------------------


def joined_walks(data: Path, cache: Path | None, windows: LabelledWindows) -> Iterator[Walk]:
    """Those of `mixed_contexts.py`, with the same models."""
    for each in walks_left_out(data, cache, windows):
        yield walk_of(*each)


def people_left_out(data: Path, cache: Path | None, windows: LabelledWindows, dataset: str) -> Iterator[Walk]:
    """Recordings of a scored data set, with the models of `contexts_left_out.py`."""
    of_set = [sorted({p for p in windows.person if p.startswith(f"{n}/")}) for n in ("motionsense", "difronzo")]
    for k in range(N_LEFT_OUT_FOLDS):
        fold = [p for everybody in of_set for p in everybody[k::N_LEFT_OUT_FOLDS]]
        model = without(windows, fold, cache, f"people_{k}")
        for path in recordings_of(data, (dataset,)):
            recording = pdr.read(path)
            person = f"{dataset}/{recording.subject.id}"
            if person in fold:
                yield walk_of(recording, person, with_context_model(default(recording.subject), model))


def other_sites(data: Path, cache: Path | None, windows: LabelledWindows, site: str) -> Iterator[Walk]:
    """Recordings of a site that the model has not seen: level walking, and terrain with its labels."""
    known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
    for path in paths(data, site)[:: EVERY if site == "ubicomp13" else 1]:
        recording = pdr.read(path)
        config = default(recording.subject)
        if known:
            config = with_context_model(config, without(windows, known, cache, f"site_{site}"))
        yield walk_of(recording, f"{site}/{recording.subject.id}", config, is_level=site != "terrain")


def sets_of(data: Path, cache: Path | None) -> dict[str, list[Walk]]:
    """All walks that have enough steps, by set."""
    windows: LabelledWindows = cached(cache, "windows", lambda: windows_of(data))
    found = {
        "joined walks": joined_walks(data, cache, windows),
        "difronzo": people_left_out(data, cache, windows, "difronzo"),
        "terrain": other_sites(data, cache, windows, "terrain"),
        "tyrex, level": other_sites(data, cache, windows, "tyrex"),
        "ubicomp13, level": other_sites(data, cache, windows, "ubicomp13"),
        "motionsense": people_left_out(data, cache, windows, "motionsense"),
    }
    return {name: [w for w in walks if len(w.label) >= MIN_STEPS] for name, walks in found.items()}


# --- Distances -------------------------------------------------------------------------------------------------------


def distances_m(walk: Walk) -> dict[str, float]:
    """Distance of the same steps by each weighting."""
    hc = tracked(walk.events, walk.config, "hc")
    found = {"HC": hc[-1].walked_m}
    for name, threshold in WC_THRESHOLDS.items():
        found[name] = updates_of(WeightedTracker(walk.config.model, threshold), walk.events)[-1].walked_m
    imm = tracked(walk.events, walk.config, "imm")
    prob = np.array([u.mode_prob for u in imm])
    lagged = smoothed_mode_prob(prob, walk.config.model.transition_prob, LAG_STEPS)
    return found | {
        "IMM, steps as they were made": sum(u.step_length_m for u in imm),
        "IMM": imm[-1].walked_m,
        "IMM, lagged": float((lagged * walk.length_m).sum()),
        "IMM, smoothed": float((hindsight_prob(walk) * walk.length_m).sum()),
    }


def hindsight_prob(walk: Walk) -> FloatArray:
    """Mode probabilities (K, M) with all evidence, as `in_hindsight` has them where no fixes are."""
    config = walk.config.in_hindsight()
    prob = np.array([u.mode_prob for u in tracked(walk.events, config, "imm")])
    return smoothed_mode_prob(prob, config.model.transition_prob)


ERRORS = ["bias %", "spread %", "RMS %", "largest %"]


def error_cells(found_m: Sequence[float], true_m: FloatArray) -> list[str]:
    """Bias and spread of relative distance errors."""
    e = 100 * (np.array(found_m) / true_m - 1)
    figures = (e.std(ddof=1), np.sqrt(np.mean(e**2)), np.abs(e).max())
    return [f"{e.mean():+.1f}", *(f"{v:.1f}" for v in figures)]


def columns_of(rows: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Distances by weighting, of all walks."""
    return {name: [row[name] for row in rows] for name in rows[0]}


def probabilities(walk: Walk) -> dict[str, FloatArray]:
    """What each answer says of the steps, (K, C) each."""
    imm = tracked(walk.events, walk.config, "imm")
    prob = np.array([u.mode_prob for u in imm])
    transition_prob = walk.config.model.transition_prob
    return {
        "windows": np.array([u.context_prob for u in imm]),
        "IMM": prob,
        "IMM, lagged": smoothed_mode_prob(prob, transition_prob, LAG_STEPS),
        "IMM, smoothed": hindsight_prob(walk),
        "IMM, smoothed with the exponent of online": smoothed_mode_prob(prob, transition_prob),
    }


def log_loss(prob: FloatArray, label: IntArray) -> FloatArray:
    """Of each step, (K,)."""
    return -np.log(np.maximum(prob[np.arange(len(label)), label], 1e-6))


def walks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Distances and probabilities of each weighting."""
    sets = sets_of(arguments.data, arguments.cache)
    rows, of_prob, of_doubt = [], [], []
    for name, found_walks in sets.items():
        people = len({w.person for w in found_walks})
        what = f"{name} ({len(found_walks)} of {people} {'person' if people == 1 else 'people'})"
        known = np.array([w.known_m for w in found_walks])
        moved = known > 0
        for weighting, found in columns_of([distances_m(w) for w in found_walks]).items():
            if name != "motionsense":
                rows.append([what, weighting, *error_cells(np.array(found)[moved], known[moved])])
        said = [probabilities(w) for w in found_walks]
        y = np.concatenate([w.label for w in found_walks])
        for answer in said[0]:
            prob = np.concatenate([s[answer] for s in said])
            right = f"{np.mean(prob.argmax(axis=1) == y):.3f}"
            of_prob.append([f"{name} ({len(y)} steps)", answer, right, f"{log_loss(prob, y).mean():.3f}"])
        doubt = second_over_first(np.concatenate([s["windows"] for s in said])) >= WC_THRESHOLD
        wrong = np.concatenate([s["windows"].argmax(axis=1) for s in said]) != y
        of_doubt.append(
            [f"{name} ({len(y)} steps)", *(f"{100 * v:.1f}" for v in (doubt.mean(), wrong.mean(), doubt[wrong].mean()))]
        )
    about = "Against the same steps in the true contexts, of people or sites left out."
    tables.write("weightings_distance", ["walks", "weighting", *ERRORS], rows, about)
    tables.write("weightings_probabilities", ["walks", "answer", "right", "log loss"], of_prob)
    columns = ["walks", "weighted by WC, % of the steps", "window wrong, %", "of these weighted by WC, %"]
    about = "Steps whose window's second highest probability is 0.8 of the highest or more."
    tables.write("weightings_doubt", columns, of_doubt, about)


if __name__ == "__main__":
    run(__doc__, walks, cache=None)
