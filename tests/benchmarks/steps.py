"""The default step detector and its gate against steps counted on video and against foot switches.

    python tests/benchmarks/steps.py [--data ../shared/data]

Prints the step frequency as a function of the power of the motion (the law the detector rests on); count errors of
ubicomp13 by placement with the single-scale wavelet, with the default detector, and behind the gate; the same with
only every second or fourth sample; F1 of oxford at several rates; and step rates of running and stairs, which have no
counted steps. What the gate does to handling, with people left out, is in step_gate.py.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter.papers.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.adaptive import AdaptiveStepDetector, low_pass_kernel
from pdr_filter.sensing.steps.gate import StepGate
from pdr_filter.values.samples import Samples
from pdr_filter.values.step import Step

FloatArray = NDArray[np.float64]

DETECTOR = AdaptiveStepDetector()
PIPELINES = {
    "one or two scales (Martinelli et al.)": Sensing(steps=WaveletStepDetector()),
    "default detector": Sensing(steps=DETECTOR),
    "default detector, gate": Sensing(steps=DETECTOR, gate=StepGate()),
}


def thinned(recording: pdr.Recording, keep_every: int) -> pdr.Recording:
    old = recording.accelerometer
    samples = Samples(old.time_s[::keep_every], old.values[::keep_every])
    return replace(recording, accelerometer=samples, gyroscope=None, magnetometer=None)


def step_times(sensing: Sensing, recording: pdr.Recording) -> FloatArray:
    state, events = sensing.step(sensing.init(), merge_streams(recording))
    return np.array([e.time_s for _, e in [*events, *sensing.finish(state)] if isinstance(e, Step)])


def count_errors(sensing: Sensing, recordings: Iterable[pdr.Recording]) -> dict[str, list[float]]:
    """Per cent, by placement and together."""
    errors: dict[str, list[float]] = defaultdict(list)
    for recording in recordings:
        segment = recording.truth.segments[0]
        time_s = step_times(sensing, recording)
        n = ((time_s >= segment["start_s"] - 0.3) & (time_s <= segment["end_s"] + 0.3)).sum()
        error = 100.0 * float(n / segment["n_steps"] - 1)
        for name in ("all", recording.name.split("_", 3)[3]):
            errors[name].append(error)
    return errors


def cell(errors: Sequence[float]) -> str:
    return f"{np.abs(errors).mean():.2f}, {np.mean(errors):+.2f}, {np.abs(errors).max():.1f}"


def print_counts(recordings: Sequence[pdr.Recording]) -> None:
    columns = {name: count_errors(sensing, recordings) for name, sensing in PIPELINES.items()}
    for keep_every in (2, 4):
        thin = [thinned(r, keep_every) for r in recordings]
        columns[f"... at {100 // keep_every} Hz"] = count_errors(PIPELINES["default detector, gate"], thin)
    print("\nubicomp13, count error %: mean absolute, bias, largest\n")
    print(f"| placement | walks | {' | '.join(columns)} |\n" + "|---" * (len(columns) + 2) + "|")
    for name in sorted(next(iter(columns.values())), key=lambda n: (n != "all", n)):
        n = len(columns["default detector"][name])
        print(f"| {name} | {n} | {' | '.join(cell(c[name]) for c in columns.values())} |")


def f1(truth_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> float:
    """F1 of one-to-one matches in time order, at the best constant offset."""
    best = 0.0
    for offset_s in np.arange(-0.4, 0.41, 0.02):
        i = j = hits = 0
        while i < len(truth_s) and j < len(found_s):
            if abs(found_s[j] + offset_s - truth_s[i]) <= tolerance_s:
                hits, i, j = hits + 1, i + 1, j + 1
            elif found_s[j] + offset_s < truth_s[i]:
                j += 1
            else:
                i += 1
        best = max(best, 2 * hits / (len(truth_s) + len(found_s)))
    return best


def print_oxford(recordings: Sequence[pdr.Recording]) -> None:
    print("\noxford, F1\n\n| | Hz | within 0.25 s | lowest | within 0.1 s |\n|---|---|---|---|---|")
    for name, sensing in PIPELINES.items():
        for keep_every in (1, 2, 4, 8, 16) if "gate" in name else (1,):
            close: list[tuple[float, float]] = []
            for recording in recordings:
                truth_s = np.asarray(recording.truth.steps.time_s)
                time_s = step_times(sensing, thinned(recording, keep_every))
                time_s = time_s[(time_s > truth_s[0] - 0.6) & (time_s < truth_s[-1] + 0.6)]
                close.append((f1(truth_s, time_s, 0.25), f1(truth_s, time_s, 0.1)))
            wide, narrow = np.array(close).T
            print(f"| {name} | {405 // keep_every} | {wide.mean():.4f} | {wide.min():.3f} | {narrow.mean():.4f} |")


def power_and_frequency(recording: pdr.Recording) -> tuple[FloatArray, FloatArray]:
    """log R and log f at the detected steps of the walk."""
    time_s = step_times(PIPELINES["default detector"], recording)
    if recording.truth.segments is not None:
        segment = recording.truth.segments[0]
        time_s = time_s[(time_s > segment["start_s"]) & (time_s < segment["end_s"])]
    interval_s = np.array([np.median(np.diff(time_s[i - 2 : i + 3])) for i in range(2, len(time_s) - 2)])
    grid_s = np.arange(recording.accelerometer.time_s[0], recording.accelerometer.time_s[-1], 0.01)
    at_s, size = recording.accelerometer.time_s, np.linalg.norm(recording.accelerometer.values, axis=1)
    smooth = np.convolve(np.interp(grid_s, at_s, size), low_pass_kernel(DETECTOR.power_low_pass_hz, 100.0), mode="same")
    before, after = round(100 * DETECTOR.before_s), round(100 * DETECTOR.after_s)
    at = np.searchsorted(grid_s, time_s[2:-2])
    rms = np.array([np.std(smooth[max(i - before, 0) : i + after + 1]) for i in at])
    return np.log(rms), -np.log(interval_s)


def print_law(recordings: Sequence[pdr.Recording]) -> None:
    parts = [power_and_frequency(r) for r in recordings]
    x, y = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    mass = np.concatenate([np.full(len(p[0]), 1.0 / max(len(p[0]), 1)) for p in parts])
    slope, offset = np.polyfit(x, y, 1, w=np.sqrt(mass))
    deviation = np.sqrt(np.average((y - slope * x - offset) ** 2, weights=mass))
    print(f"f = {np.exp(offset):.2f} R^{slope:.2f} Hz, deviation {100 * deviation:.0f} %, {len(parts)} recordings")


def print_rates(recordings: Sequence[pdr.Recording]) -> None:
    print("\nmotionsense, steps a second by context: 10, 50 and 90 % of recordings\n")
    rates: dict[str, list[float]] = defaultdict(list)
    for recording in recordings:
        time_s = step_times(PIPELINES["default detector, gate"], recording)
        duration_s = float(recording.accelerometer.time_s[-1])
        rates[recording.name.split("_")[2]].append(len(time_s) / duration_s)
    for context, values in sorted(rates.items()):
        print(context, len(values), np.round(np.quantile(values, [0.1, 0.5, 0.9]), 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    data = parser.parse_args().data
    sets = {n: [pdr.read(p) for p in sorted((data / n).glob("*.zip"))] for n in ("ubicomp13", "oxford", "motionsense")}
    print_law([*sets["ubicomp13"], *sets["oxford"], *(r for r in sets["motionsense"] if "_jog_" in r.name)])
    print_counts(sets["ubicomp13"])
    print_oxford(sets["oxford"])
    print_rates(sets["motionsense"])


if __name__ == "__main__":
    main()
