"""Steps with and without the gate (`pdr_filter.steps.gate`): counts, false steps, steps kept, latency.

usage: .venv/bin/python tests/benchmarks/step_gate.py [--data ../shared/data]

Ubicomp13: count error of each walk against the steps counted on video (0.3 s of slack at its ends), and steps more than
1 s away from it, where the phone is handled and nobody goes anywhere. The gate was chosen on people 1 to 6; figures
are of people 7 to 13. Other sets: number of steps by context and carrying mode with and without gate; in oxford those
between the first and the last truth, 0.6 s of slack, of which F1 is at the best constant offset within 0.4 s. Without
gyroscope means that it is taken out of the recordings.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter.context.irregular import irregular_prob
from pdr_filter.features.windows import FeatureWindow, FeatureWindows
from pdr_filter.sensing import Gap, Sensing
from pdr_filter.steps.gate import StepGate
from pdr_filter.types import Step
from pdr_filter.whole import sensed_events

FloatArray = NDArray[np.float64]

SENSING = Sensing(windows=FeatureWindows("invariant"))
GATE = StepGate()
OTHER_SETS = ("humolire", "motionsense", "ms_indoor", "oxford", "tyrex")


def steps_of(recording: pdr.Recording) -> tuple[list[Step], list[Step]]:
    """Steps of the detector, and those of them that the gate lets pass."""
    state, detected, passed, now_s = GATE.init(), [], [], 0.0
    for event in sensed_events(SENSING, recording):
        if isinstance(event, FeatureWindow):
            now_s = event.time_s
            prob = irregular_prob(event.names, event.features, event.has_gyroscope)
            state, steps = GATE.on_window(state, now_s, event.time_s, prob)
        elif isinstance(event, Gap):
            state, steps = GATE.on_gap(state, now_s, event.duration_s)
        else:
            now_s = event.detected_time_s
            detected.append(event)
            state, steps = GATE.on_step(state, now_s, event)
        passed += steps
    return detected, [*passed, *GATE.finish(state, now_s)[1]]


def times_of(steps: Sequence[Step]) -> FloatArray:
    return np.array([s.time_s for s in steps])


def recordings(data: Path, name: str, with_gyroscope: bool) -> Iterator[pdr.Recording]:
    for path in sorted((data / name).glob("*.zip")):
        recording = pdr.read(path)
        if with_gyroscope and recording.gyroscope is None:
            continue
        yield recording if with_gyroscope else replace(recording, gyroscope=None)


@dataclass
class Score:
    """Count errors and false steps of some walks; first without gate, then with it."""

    error_percent: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))
    n_false: list[int] = field(default_factory=lambda: [0, 0])
    handled_s: float = 0.0
    latency_s: list[float] = field(default_factory=list[float])

    def add(self, recording: pdr.Recording, found: tuple[list[Step], list[Step]]) -> None:
        segment = recording.truth.segments[0]
        start_s, end_s, n = float(segment["start_s"]), float(segment["end_s"]), int(segment["n_steps"])
        for i, steps in enumerate(found):
            time_s = times_of(steps)
            inside = ((time_s >= start_s - 0.3) & (time_s <= end_s + 0.3)).sum()
            self.error_percent[i].append(100 * float(inside - n) / n)
            self.n_false[i] += int(((time_s < start_s - 1) | (time_s > end_s + 1)).sum())
        total_s = float(recording.accelerometer.time_s[-1])
        self.handled_s += max(0.0, start_s - 1) + max(0.0, total_s - end_s - 1)
        self.latency_s += [s.detected_time_s - s.time_s for s in found[1]]

    def row(self, name: str) -> str:
        cells = [name, str(len(self.error_percent[0])), f"{self.handled_s / 60:.1f}"]
        for i in (0, 1):
            error = np.array(self.error_percent[i])
            cells.append(f"{np.abs(error).mean():.2f}, {error.mean():+.2f}, {np.abs(error).max():.1f}")
        cells += [f"{60 * n / max(self.handled_s, 1e-9):.2f}" for n in self.n_false]
        median_s, most_s, longest_s = np.quantile(self.latency_s, [0.5, 0.95, 1.0])
        return "| " + " | ".join([*cells, f"{median_s:.1f}, {most_s:.1f}, {longest_s:.1f}"]) + " |"


def print_ubicomp(data: Path, with_gyroscope: bool) -> None:
    scores: dict[str, Score] = defaultdict(Score)
    for recording in recordings(data, "ubicomp13", with_gyroscope):
        _, person, _, kind = recording.name.split("_", 3)
        is_new = int(person[1:]) >= 7
        found = steps_of(recording)
        scores["people 7 to 13" if is_new else "people 1 to 6"].add(recording, found)
        scores[f"{'7 to 13' if is_new else '1 to 6'}, {kind}"].add(recording, found)
    print(
        "| ubicomp13 | walks | minutes handled | count error %: mean absolute, bias, largest, without gate | with | "
        "false steps a minute, without | with | latency s: median, 95 %, longest |\n" + "|---" * 8 + "|"
    )
    for name in sorted(scores, key=lambda n: (not n.startswith("people"), n)):
        print(scores[name].row(name))


def label_at(recording: pdr.Recording, time_s: float) -> str:
    """Context and carrying mode, or that there is no label."""
    for label in recording.truth.labels:
        if label["start_s"] <= time_s <= label["end_s"]:
            return f"{label['context']} {label['carrying_mode']}".strip()
    return "no label"


def f1(truth_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25) -> float:
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


def print_other_sets(data: Path, with_gyroscope: bool) -> None:
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    f1s: list[tuple[float, ...]] = []
    for name in OTHER_SETS:
        for recording in recordings(data, name, with_gyroscope):
            times = [times_of(steps) for steps in steps_of(recording)]
            if name == "oxford":
                truth_s = np.asarray(recording.truth.steps.time_s)
                times = [t[(t > truth_s[0] - 0.6) & (t < truth_s[-1] + 0.6)] for t in times]
                f1s.append(tuple(max(f1(truth_s, t + o) for o in np.arange(-0.4, 0.41, 0.02)) for t in times))
            for i, time_s in enumerate(times):
                for t in time_s:
                    kind = "between first and last truth" if name == "oxford" else label_at(recording, t)
                    counts[f"{name}: {kind}"][i] += 1
    print("\n| other sets | steps without gate | with | lost % |\n|---|---|---|---|")
    for kind, (without, kept) in sorted(counts.items()):
        print(f"| {kind} | {without} | {kept} | {100 * (1 - kept / without):.2f} |")
    if f1s:
        without, kept = np.mean(f1s, axis=0)
        print(f"\noxford: F1 within 0.25 s {without:.4f} without gate, {kept:.4f} with it")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    data = parser.parse_args().data
    for with_gyroscope in (True, False):
        print(f"\n## {'with gyroscope' if with_gyroscope else 'accelerometer alone'}\n")
        print_ubicomp(data, with_gyroscope)
        print_other_sets(data, with_gyroscope)


if __name__ == "__main__":
    main()
