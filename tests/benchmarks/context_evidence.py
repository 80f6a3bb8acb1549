"""How far to divide the training prior out of the context probabilities, and how much to temper them.

usage: python -m tests.benchmarks.context_evidence [--data ../shared/data] [--cache FOLDER] [--every 3]

The filter's own steps, windows and transitions, once for each choice of the two exponents, on people and sites that
the classifier has not seen: the walks through several contexts of `mixed_contexts.py` (MotionSense, people left out in
three folds), tyrex left out as a whole, and every third walk of ubicomp13, of which no model has seen any. The
accuracy over the windows of the mixed walks (inside one context, with a step) beside that of the classifier's arg-max,
the log loss at their steps, the recall of each context; and for the others, who walk and run only, the mean
probability of walking at its steps, and how many of them it is the most probable.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.offline.training.cross_validation import label_of
from pdr_filter.recipes import for_recording, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.sensing.front_end import Event
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, FloatArray, IntArray
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, options, paths, recordings
from tests.benchmarks.mixed_contexts import (
    cached,
    context_at,
    model_without,
    tracked,
    walks_left_out,
    windows_of,
)

CHOICES = tuple((e, p) for e in (0.5, 0.7, 1.0) for p in (0.0, 0.2, 0.5, 1.0))
STATIONARY, WALKING = CONTEXTS.index("stationary"), CONTEXTS.index("walking")
Sensed = tuple[Recording, Config, list[Event]]


def sensed(recording: Recording, config: Config) -> Sensed:
    """Steps and windows of a recording."""
    return recording, config, run_sensing(config.sensing, recording)[1]


def walks_of(data: Path, cache: Path | None, every: int) -> dict[str, list[Sensed]]:
    """Walks by set, each sensed with a model that has not seen its person."""
    windows = cached(cache, "windows", lambda: windows_of(data))
    found: dict[str, list[Sensed]] = {"mixed": [], "tyrex": [], "ubicomp13 pocket": [], "ubicomp13 hand, bag": []}
    for walk, _, config in walks_left_out(data, cache, windows):
        found["mixed"].append(sensed(walk, config))
    of_tyrex = tuple(np.unique(windows.person[windows.dataset == "tyrex"]))
    model = cached(cache, "model_tyrex", lambda: model_without(windows, of_tyrex))
    for walk in recordings(data, "tyrex"):
        found["tyrex"].append(sensed(walk, with_context_model(for_recording("default", walk), model)))
    for path in paths(data, "ubicomp13")[::every]:
        walk = pdr.read(path)
        name = "ubicomp13 pocket" if "pocket" in path.stem else "ubicomp13 hand, bag"
        found[name].append(sensed(walk, for_recording("default", walk)))
    return found


def at_steps(walk: Sensed, evidence_exponent: float, prior_exponent: float) -> tuple[FloatArray, FloatArray]:
    """Times (K,) and mode probabilities (K, C) of the steps."""
    _, config, events = walk
    config = config.with_model(evidence_exponent=evidence_exponent, prior_exponent=prior_exponent)
    updates = tracked(events, config, "imm")
    return np.array([u.step.time_s for u in updates]), np.array([u.mode_prob for u in updates]).reshape(
        -1, len(CONTEXTS)
    )


def window_answers(walk: Sensed, time_s: FloatArray, prob: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """True context, arg-max and the filter's answer (W,) of the windows inside one context that have a step."""
    windows = [e for e in walk[2] if isinstance(e, WindowContext)]
    rows: list[tuple[int, int, int]] = []
    for window in windows:
        last = int(np.searchsorted(time_s, window.time_s)) - 1
        has_step = last >= 0 and time_s[last] >= window.time_s - 1.0
        truth = context_at(walk[0], window.time_s - 1.0)
        if has_step and truth >= 0 and label_of(walk[0], window.time_s - 2.0, window.time_s) is not None:
            rows.append((truth, int(window.prob.argmax()), int(prob[last].argmax())))
    truth, highest, answer = np.array(rows).T
    return truth, highest, answer


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--cache", type=Path, default=None, help="keeps windows and models of the folds")
    parser.add_argument("--every", type=int, default=3, help="so many walks of ubicomp13 are one")
    args = parser.parse_args()
    walks = walks_of(args.data, args.cache, args.every)
    rows, others = [], []
    for evidence_exponent, prior_exponent in CHOICES:
        truth, highest, answer, losses = [], [], [], []
        for walk in walks["mixed"]:
            time_s, prob = at_steps(walk, evidence_exponent, prior_exponent)
            for column, found in zip((truth, highest, answer), window_answers(walk, time_s, prob), strict=True):
                column.append(found)
            y = np.array([context_at(walk[0], t) for t in time_s])
            losses.append(-np.log(np.maximum(prob[y >= 0, y[y >= 0]], 1e-6)).mean())
        y, first, filtered = (np.concatenate(column) for column in (truth, highest, answer))
        recall = ", ".join(f"{(filtered[y == c] == c).mean():.2f}" for c in np.unique(y) if c != STATIONARY)
        others = []
        for name, found in walks.items():
            if name == "mixed":
                continue
            of_walking = []
            for walk in found:
                time_s, prob = at_steps(walk, evidence_exponent, prior_exponent)
                of_walking.append(prob[[context_at(walk[0], t) == WALKING for t in time_s]])
            prob = np.concatenate(of_walking)
            others.append(f"{prob[:, WALKING].mean():.2f}, {(prob.argmax(axis=1) == WALKING).mean():.2f}")
        figures = [f"{(first == y).mean():.3f}", f"{(filtered == y).mean():.3f}", f"{np.mean(losses):.3f}", recall]
        rows.append([evidence_exponent, prior_exponent, *figures, *others])
        print(rows[-1], flush=True)
    columns = ["evidence", "prior", "accuracy of the arg-max", "accuracy", "log loss"]
    columns += ["recall walking, upstairs, downstairs, running", *(f"{n} walking" for n in walks if n != "mixed")]
    about = "Walking: mean probability at its steps, share of its steps of which it is the most probable."
    Tables.of(__spec__.name, args).write("context_evidence", columns, rows, about)


if __name__ == "__main__":
    main()
