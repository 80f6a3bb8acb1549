"""The default step detector and its gate against steps counted on video, foot switches and handling.

usage: python -m tests.benchmarks.steps [counts] [gate] [--data ../shared/data]

counts    count errors of ubicomp13 by placement with the single-scale wavelet, with the default detector, behind the
          gate, and with left and right evened; the same with only every second or fourth sample
gate      the gate against false steps: its weights fitted again, and what it does to people left out of the fit. Every
          step that the default detector finds is walking or not: inside the walks of ubicomp13 or more than 1 s
          outside, where the phone is handled; MotionSense's sitting and standing against its other contexts; walks of
          the other sets. The log odds are a logistic regression on the four features of
          `pdr_filter.sensing.steps.walking_evidence`, every kind of recording with the mass in `MASS`. People with odd
          numbers are judged by a fit without them, and those with even numbers likewise; the other sets have one person
          each or unknown ones, and are in both fits. Then the same with the shipped weights, which have seen everybody.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.contact_time_smoothing import ContactTimeSmoothing
from pdr_filter.sensing.steps.step_detector import unknown_contexts
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.sensing.steps.walking_evidence import EVIDENCE, WalkEvidence
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Samples, Step
from tests.benchmarks.common import Tables, recordings, run

FloatArray = NDArray[np.float64]

DETECTOR = AdaptiveStepDetector()
DEFAULT = Sensing(steps=DETECTOR, gate=StepGate(), contact_smoothing=ContactTimeSmoothing())
PIPELINES = {
    "one or two scales (Martinelli et al.)": Sensing(steps=WaveletStepDetector()),
    "default detector": Sensing(steps=DETECTOR),
    "default detector, gate": Sensing(steps=DETECTOR, gate=StepGate()),
    "the same, left and right evened": DEFAULT,
}


def thinned(recording: pdr.Recording, keep_every: int) -> pdr.Recording:
    old = recording.accelerometer
    samples = Samples(old.time_s[::keep_every], old.values[::keep_every])
    return replace(recording, accelerometer=samples, gyroscope=None, magnetometer=None)


def count_errors(sensing: Sensing, recordings: Iterable[pdr.Recording]) -> dict[str, list[float]]:
    """Per cent, by placement and together."""
    errors: dict[str, list[float]] = defaultdict(list)
    for recording in recordings:
        segment = recording.truth.segments[0]
        time_s = np.array([e.time_s for e in run_sensing(sensing, recording)[1] if isinstance(e, Step)])
        n = ((time_s >= segment["start_s"] - 0.3) & (time_s <= segment["end_s"] + 0.3)).sum()
        error = 100.0 * float(n / segment["n_steps"] - 1)
        for name in ("all", recording.name.split("_", 3)[3]):
            errors[name].append(error)
    return errors


def cell(errors: Sequence[float]) -> str:
    return f"{np.abs(errors).mean():.2f}, {np.mean(errors):+.2f}, {np.abs(errors).max():.1f}"


def counts(tables: Tables, arguments: argparse.Namespace) -> None:
    """Count errors of ubicomp13 by placement."""
    walks = list(recordings(arguments.data, "ubicomp13"))
    columns = {name: count_errors(sensing, walks) for name, sensing in PIPELINES.items()}
    for keep_every in (2, 4):
        thin = [thinned(r, keep_every) for r in walks]
        columns[f"the same at {100 // keep_every} Hz"] = count_errors(
            PIPELINES["the same, left and right evened"], thin
        )
    places = sorted(columns["default detector"], key=lambda n: (n != "all", n))
    rows = [
        [place, len(columns["default detector"][place]), *(cell(errors[place]) for errors in columns.values())]
        for place in places
    ]
    about = "Count error in per cent: mean absolute, bias, largest (ubicomp13)."
    tables.write("steps_counts", ["placement", "walks", *columns], rows, about)


# Half of the mass is walking, half is not; the sets of one person weigh less than those of 13 and of 12 people.
MASS = {
    ("ubicomp13", True): 1.0,
    ("ubicomp13", False): 1.0,
    ("motionsense", True): 1.0,
    ("motionsense", False): 1.0,
    ("tyrex", True): 0.3,
    ("oxford", True): 0.3,
    ("humolire", True): 0.2,
    ("ms_indoor", True): 0.2,
}


@dataclass
class Found:
    """One recording through the detector; steps and features of each segment."""

    recording: pdr.Recording
    segments: list[tuple[list[UniformBlock], list[list[tuple[int, Step]]]]] = field(default_factory=list)
    time_s: FloatArray = field(default_factory=lambda: np.empty(0))
    features: FloatArray = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def data_set(self) -> str:
        return "ms_indoor" if self.recording.name.startswith("ms_indoor") else self.recording.name.split("_")[0]

    @property
    def person(self) -> int:
        """Number of the person, 0 where the set has one or does not say."""
        known = self.data_set in ("ubicomp13", "motionsense")
        return int(self.recording.name.split("_")[1][1:]) if known else 0


@dataclass
class Recorder:
    """Stands in for the evidence, and remembers what the gate saw."""

    rows: list[list[float]] = field(default_factory=list)

    def log_odds(self, features: FloatArray) -> FloatArray:
        self.rows.extend(features.tolist())
        return np.zeros(len(features))


def flat(block: UniformBlock) -> AttitudeBlock:
    """No attitude: neither detector nor gate look at it, and the figures of the steps are not used here."""
    n = len(block.time_s)
    return AttitudeBlock(np.zeros(n), np.zeros((n, 2)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n))


def find(recording: pdr.Recording) -> Found:
    found = Found(recording)
    _, blocks = Conditioner().update(Conditioner().init(), merge_streams(recording))
    for block in blocks:
        if block.gap_before_s > 0:
            found.segments.append(([], []))
        found.segments[-1][0].append(block)
    for blocks, steps in found.segments:
        state = DETECTOR.init()
        for block in blocks:
            state, known = DETECTOR.update(state, block, flat(block), unknown_contexts(len(block.time_s)))
            steps.append(known)
        steps.append(DETECTOR.finish(state))
    recorder = Recorder()
    through_gate(found, StepGate(evidence=recorder))  # type: ignore[arg-type]
    times = [s.time_s for _, parts in found.segments for part in parts for _, s in part]
    if len(recorder.rows) == len(times):  # a recording of less than a second has no evidence
        found.time_s, found.features = np.array(times), np.array(recorder.rows).reshape(-1, 4)
    return found


def through_gate(found: Found, gate: StepGate) -> list[Step]:
    state, passed = gate.init(), []
    for blocks, steps in found.segments:
        for block, known in zip(blocks, steps[:-1], strict=True):
            state, out = gate.update(state, block, flat(block), unknown_contexts(len(block.time_s)), known)
            passed += out
        state, out = gate.finish(state, steps[-1])
        passed += out
    return [s for _, s in passed]


def walk_of(found: Found) -> tuple[float, float, int]:
    segment = found.recording.truth.segments[0]
    return float(segment["start_s"]), float(segment["end_s"]), int(segment["n_steps"])


def truth(found: Found, time_s: float) -> bool | None:
    """Whether somebody walked; None where that is not known."""
    if found.data_set == "ubicomp13":
        start_s, end_s, _ = walk_of(found)
        if start_s <= time_s <= end_s:
            return True
        return False if time_s < start_s - 1 or time_s > end_s + 1 else None
    if found.data_set == "oxford":
        contacts_s = found.recording.truth.steps.time_s
        return True if contacts_s[0] <= time_s <= contacts_s[-1] else None
    for label in found.recording.truth.labels if found.recording.truth.labels is not None else []:
        if label["start_s"] <= time_s <= label["end_s"] and label["context"]:
            return str(label["context"]) != "stationary"
    return None


def fit(all_found: Sequence[Found]) -> WalkEvidence:
    rows: dict[tuple[str, bool], list[FloatArray]] = defaultdict(list)
    for found in all_found:
        for time_s, features in zip(found.time_s, found.features, strict=True):
            walking = truth(found, time_s)
            if walking is not None and (found.data_set, walking) in MASS:
                rows[found.data_set, walking].append(features)
    x = np.concatenate([np.array(v) for v in rows.values()])
    y = np.concatenate([np.full(len(v), walking) for (_, walking), v in rows.items()])
    mass = np.concatenate([np.full(len(v), MASS[k] / len(v)) for k, v in rows.items()])
    mass = mass / np.where(y, mass[y].sum(), mass[~y].sum())
    mean = np.round(np.average(x, axis=0, weights=mass), 2)
    scale = np.round(np.sqrt(np.average((x - mean) ** 2, axis=0, weights=mass)), 2)
    z = np.clip((x - mean) / scale, -3, 3)
    machine = LogisticRegression(C=3e5, max_iter=1000).fit(z, y, sample_weight=mass)
    return WalkEvidence(mean, scale, np.round(machine.coef_[0], 2), float(np.round(machine.intercept_[0], 2)))


@dataclass
class Score:
    """Count errors, false steps and latencies of some walks."""

    error_percent: list[float] = field(default_factory=list)
    n_false: int = 0
    handled_s: float = 0.0
    inside_s: list[float] = field(default_factory=list)
    first_s: list[float] = field(default_factory=list)

    def add(self, found: Found, steps: Sequence[Step]) -> None:
        start_s, end_s, n = walk_of(found)
        time_s = np.array([s.time_s for s in steps])
        inside = ((time_s >= start_s - 0.3) & (time_s <= end_s + 0.3)).sum()
        self.error_percent.append(100 * float(inside - n) / n)
        self.n_false += int(((time_s < start_s - 1) | (time_s > end_s + 1)).sum())
        total_s = float(found.recording.accelerometer.time_s[-1])
        self.handled_s += max(0.0, start_s - 1) + max(0.0, total_s - end_s - 1)
        walk = [s for s in steps if start_s <= s.time_s <= end_s]
        self.first_s += [s.detected_time_s - s.time_s for s in walk[:4]]
        self.inside_s += [s.detected_time_s - s.time_s for s in walk[4:]]

    def cells(self) -> list[str]:
        """Count error, false steps, latencies."""
        error = np.array(self.error_percent)
        cells = [f"{np.abs(error).mean():.2f}, {error.mean():+.2f}, {np.abs(error).max():.1f}"]
        cells.append(f"{60 * self.n_false / max(self.handled_s, 1e-9):.2f}")
        return cells + [
            ", ".join(f"{q:.1f}" for q in np.quantile(latency_s, [0.5, 0.95]))
            for latency_s in (self.inside_s, self.first_s)
        ]


# What a column of the table says, by the set and the place that it is of.
COUNTS = (
    "count error %: mean absolute, bias, largest",
    "false steps a minute",
    "latency s in a bout: median, 95 %",
    "latency s of the first four steps",
)


def figures(all_found: Sequence[Found], gates: Sequence[StepGate | None]) -> dict[str, str]:
    """Figures of each recording behind its gate, by name; None is no gate."""
    every, in_hand = Score(), Score()
    kept: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    f1s: list[tuple[float, float]] = []
    for found, gate in zip(all_found, gates, strict=True):
        steps = through_gate(found, gate) if gate else [s for _, parts in found.segments for p in parts for _, s in p]
        time_s = np.array([s.time_s for s in steps])
        if found.data_set == "ubicomp13":
            every.add(found, steps)
            if found.recording.name.endswith("handheld_using"):
                in_hand.add(found, steps)
        elif found.data_set == "oxford":
            true_s = np.asarray(found.recording.truth.steps.time_s)
            near = time_s[(time_s > true_s[0] - 0.6) & (time_s < true_s[-1] + 0.6)]
            best = [evaluate.best_offset_s(true_s, near, tolerance_s) for tolerance_s in (0.25, 0.1)]
            f1s.append(
                tuple(evaluate.f1_score(true_s, near + o, tol) for o, tol in zip(best, (0.25, 0.1), strict=True))
            )
        for t in found.time_s:
            walking = truth(found, t)
            if walking is not None and found.data_set != "ubicomp13":
                count = kept[f"{found.data_set}: {'walking' if walking else 'sitting, standing'}"]
                count[0] += 1
                count[1] += bool(len(time_s)) and bool(np.abs(time_s - t).min() < 1e-9)
    result = dict(zip(COUNTS, every.cells(), strict=True))
    result["false steps a minute, phone in use in the hand"] = in_hand.cells()[1]
    wide, narrow = np.mean(f1s, axis=0)
    result |= {"oxford: F1 within 0.25 s": f"{wide:.4f}", "oxford: F1 within 0.1 s": f"{narrow:.4f}"}
    return result | {f"{name}, steps kept": f"{n_out} of {n}" for name, (n, n_out) in sorted(kept.items())}


def gate(tables: Tables, arguments: argparse.Namespace) -> None:
    """The gate with its weights fitted without the people that it is scored on, and as shipped."""
    names = sorted({name for name, _ in MASS})
    all_found = [find(recording) for name in names for recording in recordings(arguments.data, name)]
    left_out = [fit([f for f in all_found if f.person == 0 or f.person % 2 != fold]) for fold in (0, 1)]
    for fold, evidence in enumerate(left_out):
        print(f"without {'odd' if fold else 'even'} people: {evidence}")
    print(f"all people: {fit(all_found)}\nthe package: {EVIDENCE}")
    columns = {
        "without gate": figures(all_found, [None] * len(all_found)),
        "gate, people held out": figures(all_found, [StepGate(evidence=left_out[f.person % 2]) for f in all_found]),
        "gate as shipped": figures(all_found, [StepGate()] * len(all_found)),
        "as shipped, five steps a bout": figures(all_found, [replace(StepGate(), min_steps=5)] * len(all_found)),
    }
    rows = [[name, *(column[name] for column in columns.values())] for name in columns["without gate"]]
    tables.write("step_gate", ["", *columns], rows)


if __name__ == "__main__":
    run(__doc__, counts, gate)
