"""The gate against false steps: its weights fitted anew, and what it does to people left out of the fit.

    python tests/benchmarks/step_gate.py [--data ../shared/data]

Every step that the default detector finds is walking or not: inside the walks of ubicomp13 or more than 1 s outside,
where the phone is handled; MotionSense's sitting and standing against its other contexts; walks of the other sets. The
log odds are a logistic regression on the four features of `pdr_filter.sensing.steps.gate.evidence_features`, every
kind of recording with the mass in `MASS`. Figures are of people left out: people with odd numbers are judged by a fit
without them, and those with even numbers likewise; the other sets have one person each or unknown ones, and are in
both fits. Then the same with the weights that the package has, which have seen everybody.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

import pdr_filter as pdr
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.steps.adaptive import AdaptiveStepDetector
from pdr_filter.sensing.steps.detector import unknown_contexts
from pdr_filter.sensing.steps.gate import EVIDENCE, StepGate, WalkEvidence
from pdr_filter.values.step import Step

FloatArray = NDArray[np.float64]

DETECTOR = AdaptiveStepDetector()
# Half of the mass is walking, half is not; the sets of one person weigh less than that with 13 people and 7 placements.
MASS = {
    ("ubicomp13", True): 1.0,
    ("ubicomp13", False): 1.0,
    ("motionsense", True): 0.3,
    ("motionsense", False): 0.3,
    ("tyrex", True): 0.3,
    ("oxford", True): 0.3,
    ("humolire", True): 0.2,
    ("ms_indoor", True): 0.2,
}
# To lose a step of a walk is worse than a false step now and then.
BONUS = 0.7


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

    rows: list[tuple[float, ...]] = field(default_factory=list)

    def log_odds(self, features: Sequence[float]) -> float:
        self.rows.append(tuple(features))
        return 0.0


def flat(block: UniformBlock) -> AttitudeBlock:
    """No attitude: neither detector nor gate look at it, and the figures of the steps are not used here."""
    n = len(block.time_s)
    return AttitudeBlock(np.zeros(n), np.zeros((n, 2)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n))


def find(recording: pdr.Recording) -> Found:
    found = Found(recording)
    _, blocks = Conditioner().step(Conditioner().init(), merge_streams(recording))
    for block in blocks:
        if block.gap_before_s > 0:
            found.segments.append(([], []))
        found.segments[-1][0].append(block)
    for blocks, steps in found.segments:
        state = DETECTOR.init()
        for block in blocks:
            state, known = DETECTOR.step(state, block, flat(block), unknown_contexts(len(block.time_s)))
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
            state, out = gate.step(state, block, flat(block), known)
            passed += out
        state, out = gate.close(state, steps[-1], np.inf)
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
    return WalkEvidence(mean, scale, np.round(machine.coef_[0], 2), float(np.round(machine.intercept_[0] + BONUS, 2)))


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

    def row(self, name: str) -> str:
        error = np.array(self.error_percent)
        cells = [name, str(len(error)), f"{np.abs(error).mean():.2f}", f"{error.mean():+.2f}"]
        cells += [f"{np.abs(error).max():.1f}", f"{60 * self.n_false / max(self.handled_s, 1e-9):.2f}"]
        for latency_s in (self.inside_s, self.first_s):
            cells.append(", ".join(f"{q:.1f}" for q in np.quantile(latency_s, [0.5, 0.95])))
        return "| " + " | ".join(cells) + " |"


def f1(truth_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> float:
    """F1 of one-to-one matches in time order."""
    i = j = hits = 0
    while i < len(truth_s) and j < len(found_s):
        if abs(found_s[j] - truth_s[i]) <= tolerance_s:
            hits, i, j = hits + 1, i + 1, j + 1
        elif found_s[j] < truth_s[i]:
            j += 1
        else:
            i += 1
    return 2 * hits / (len(truth_s) + len(found_s))


def report(all_found: Sequence[Found], gates: Sequence[StepGate | None]) -> None:
    """Figures of each recording behind its gate; None is no gate."""
    scores: dict[str, Score] = defaultdict(Score)
    kept: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    f1s: list[tuple[float, float]] = []
    for found, gate in zip(all_found, gates, strict=True):
        steps = through_gate(found, gate) if gate else [s for _, parts in found.segments for p in parts for _, s in p]
        time_s = np.array([s.time_s for s in steps])
        if found.data_set == "ubicomp13":
            for name in (
                "all",
                f"people {'odd' if found.person % 2 else 'even'}",
                found.recording.name.split("_", 3)[3],
            ):
                scores[name].add(found, steps)
        elif found.data_set == "oxford":
            truth_s = np.asarray(found.recording.truth.steps.time_s)
            near = time_s[(time_s > truth_s[0] - 0.6) & (time_s < truth_s[-1] + 0.6)]
            offsets = np.arange(-0.4, 0.41, 0.02)
            f1s.append(
                (max(f1(truth_s, near + o, 0.25) for o in offsets), max(f1(truth_s, near + o, 0.1) for o in offsets))
            )
        for t in found.time_s:
            walking = truth(found, t)
            if walking is not None and found.data_set != "ubicomp13":
                count = kept[f"{found.data_set}, {'walking' if walking else 'not walking'}"]
                count[0] += 1
                count[1] += bool(len(time_s)) and bool(np.abs(time_s - t).min() < 1e-9)
    print(
        "| ubicomp13 | walks | mean absolute % | bias % | largest % | false steps a minute | "
        "latency s: median, 95 % | of the first four |\n" + "|---" * 8 + "|"
    )
    for name, score in sorted(scores.items(), key=lambda item: (item[0] != "all", "people" not in item[0], item[0])):
        print(score.row(name))
    print("\n| other sets | steps of the detector | out |\n|---|---|---|")
    for name, (n, n_out) in sorted(kept.items()):
        print(f"| {name} | {n} | {n_out} |")
    close = np.mean(f1s, axis=0)
    print(f"\nOxford: F1 within 0.25 s {close[0]:.4f}, within 0.1 s {close[1]:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    data = parser.parse_args().data
    names = sorted({name for name, _ in MASS})
    all_found = [find(pdr.read(p)) for name in names for p in sorted((data / name).glob("*.zip"))]
    left_out = [fit([f for f in all_found if f.person == 0 or f.person % 2 != fold]) for fold in (0, 1)]
    for fold, evidence in enumerate(left_out):
        print(f"without {'odd' if fold else 'even'} people: {evidence}")
    print(f"all people: {fit(all_found)}\nthe package: {EVIDENCE}")
    print("\n## Without gate\n")
    report(all_found, [None] * len(all_found))
    print("\n## People left out\n")
    report(all_found, [StepGate(evidence=left_out[f.person % 2]) for f in all_found])
    print("\n## The package's weights\n")
    report(all_found, [StepGate()] * len(all_found))
    print("\n## The package's weights, five steps a bout\n")
    report(all_found, [replace(StepGate(), min_steps=5)] * len(all_found))


if __name__ == "__main__":
    main()
