"""The default step detector and its gate against steps counted on video and against foot switches.

    python -m tests.benchmarks.steps [--data ../shared/data]

The step frequency as a function of the power of the motion (the law of the detector); count errors of ubicomp13 by
placement with the single-scale wavelet, with the default detector, behind the gate, and with left and right evened; the
same with only every second or fourth sample; what two phones on one walk say of the count's own error and of that of
the truth; F1 of oxford at several rates, also without the faults of the foot switches: strides of ordinary length whose
halves differ by more than 2.5 times, 0.18 and 0.81 s say. What the gate does to handling, with people left out, is in
step_gate.py.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector, low_pass_kernel
from pdr_filter.sensing.steps.contact_time_smoothing import EvenSteps
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.values import Samples, Step
from tests.benchmarks.common import Tables, options, recordings

FloatArray = NDArray[np.float64]

DETECTOR = AdaptiveStepDetector()
TOLERANCES_S = (0.25, 0.1, 0.06)
DEFAULT = Sensing(steps=DETECTOR, gate=StepGate(), even=EvenSteps())
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


def step_times(sensing: Sensing, recording: pdr.Recording) -> FloatArray:
    state, events = sensing.update(sensing.init(), merge_streams(recording))
    return np.array([e.time_s for _, e in [*events, *sensing.finish(state)[1]] if isinstance(e, Step)])


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


def counts(tables: Tables, walks: Sequence[pdr.Recording]) -> None:
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


def pairs(tables: Tables, walks: Sequence[pdr.Recording]) -> None:
    """Errors of two phones that one person carried on one walk: what is common to both is not the detector's."""
    of_walk: dict[str, list[float]] = defaultdict(list)
    for recording in walks:
        of_walk["_".join(recording.name.split("_")[:3])] += count_errors(DEFAULT, [recording])["all"]
    errors = np.concatenate([np.array(e) for e in of_walk.values()])
    both = np.array([e for e in of_walk.values() if len(e) == 2])
    each, apart = np.abs(both).mean(), np.abs(both[:, 0] - both[:, 1]).mean()
    row = [
        f"{np.abs(errors).mean():.2f} ± {np.abs(errors).std() / np.sqrt(len(errors)):.2f}",
        len(both),
        f"{each:.2f}",
        f"{apart:.2f}",
        f"{apart / np.sqrt(2):.2f}",
        f"{np.corrcoef(both.T)[0, 1]:.2f}",
    ]
    columns = [
        f"{len(walks)} walks",
        "with two phones",
        "each of them",
        "one from the other",
        "of one alone",
        "correlation",
    ]
    about = "Mean absolute count error in per cent (ubicomp13), its standard error, and what the detector has of it."
    tables.write("steps_pairs", columns, [row], about)


def without_faults(true_s: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Contacts of the switches without those of a faulty stride, and steps without those nearest to one."""
    interval_s = np.diff(true_s)
    uneven = np.abs(np.log(interval_s[1:] / interval_s[:-1])) > np.log(2.5)
    at = np.flatnonzero(uneven & (interval_s[1:] + interval_s[:-1] < 1.5))
    faulty = np.zeros(len(true_s), dtype=bool)
    faulty[[at, at + 1, at + 2]] = True
    nearest = np.abs(true_s - time_s[:, None]).argmin(axis=1)
    return true_s[~faulty], time_s[~faulty[nearest]]


def best_f1(true_s: FloatArray, time_s: FloatArray, tolerance_s: float) -> float:
    """F1 with a constant offset taken off."""
    return evaluate.f1_score(true_s, time_s + evaluate.best_offset_s(true_s, time_s, tolerance_s), tolerance_s)


def switches(tables: Tables, walks: Sequence[pdr.Recording]) -> None:
    rows = []
    for name, sensing in PIPELINES.items():
        for keep_every in (1, 2, 4, 8, 16) if "evened" in name else (1,):
            close: list[tuple[float, ...]] = []
            for recording in walks:
                true_s = np.asarray(recording.truth.steps.time_s)
                time_s = step_times(sensing, thinned(recording, keep_every))
                time_s = time_s[(time_s > true_s[0] - 0.6) & (time_s < true_s[-1] + 0.6)]
                well = best_f1(*without_faults(true_s, time_s), 0.1)
                close.append((*(best_f1(true_s, time_s, tolerance_s) for tolerance_s in TOLERANCES_S), well))
            wide, narrow, narrowest, well = np.array(close).T
            means = [f"{figures.mean():.3f}" for figures in (narrow, narrowest, well)]
            rows.append([name, 405 // keep_every, f"{wide.mean():.3f}", f"{wide.min():.3f}", *means])
    within = [f"within {tolerance_s} s" for tolerance_s in TOLERANCES_S]
    columns = ["", "Hz", f"F1 {within[0]}", "lowest", *within[1:], "within 0.1 s, without faults of the switches"]
    tables.write("steps_switches", columns, rows, "16 walks of one person, foot switches (oxford).")


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


def law(tables: Tables, walks: Sequence[pdr.Recording]) -> None:
    parts = [power_and_frequency(r) for r in walks]
    x, y = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    mass = np.concatenate([np.full(len(p[0]), 1.0 / max(len(p[0]), 1)) for p in parts])
    slope, offset = np.polyfit(x, y, 1, w=np.sqrt(mass))
    spread = np.sqrt(np.average((y - slope * x - offset) ** 2, weights=mass))
    columns = ["recordings", "frequency at R = 1 m/s², Hz", "exponent", "standard deviation %"]
    tables.write("steps_law", columns, [[len(parts), f"{np.exp(offset):.2f}", f"{slope:.2f}", f"{100 * spread:.0f}"]])


def main() -> None:
    args = options(__doc__).parse_args()
    tables = Tables.of(__spec__.name, args)
    counted, switched = (list(recordings(args.data, site)) for site in ("ubicomp13", "oxford"))
    law(tables, [*counted, *switched, *recordings(args.data, "motionsense", "*_jog_*.zip")])
    counts(tables, counted)
    pairs(tables, counted)
    switches(tables, switched)


if __name__ == "__main__":
    main()
