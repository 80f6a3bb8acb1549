"""The gate for irregular motion (`pdr_filter.sensing.contexts.irregular_motion`) on people and sites, with and without
gyroscope.

usage: python -m tests.benchmarks.irregular_motion [--data ../shared/data]

Without gyroscope means that it is taken out of the recordings, so that the attitude is found without it too.

Ubicomp13: gait is a window inside the walk interval, irregular motion one that is more than 1 s away from it; the gate
was fitted on people 1 to 6, figures are of people 7 to 13. Windows that the stillness rule takes are neither. A recall
is at the threshold that so many per cent of these people's gait windows exceed.

Other sets: share of windows with p above 0.5 by context and carrying mode, which is of false alarms. They were in the
fit as examples of gait, except for standing and sitting, and for the windows slower than 0.5 m/s, which motion capture
(tyrex) gives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import log_loss, roc_auc_score

import pdr_filter as pdr
from pdr_filter.sensing.contexts.irregular_motion import irregular_prob
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from tests.benchmarks.common import Tables, options, recordings

FloatArray = NDArray[np.float64]

WINDOWS = FeatureWindows(features=ATTITUDE_FREE)
OTHER_SETS = ("humolire", "motionsense", "ms_indoor", "oxford", "tyrex")
SLOW_MPS = 0.5


@dataclass(frozen=True)
class Window:
    """One window: what the gate says, and what is true."""

    person: int  # 0 where it does not matter
    kind: str
    is_irregular: bool
    prob: float  # exactly zero: still


def gated(recording: pdr.Recording, with_gyroscope: bool) -> list[tuple[float, float]]:
    """End and probability of the windows that have the sensors of the gate."""
    if not with_gyroscope:
        recording = replace(recording, gyroscope=None)
    windows = list(feature_windows(WINDOWS, [pdr.merge_streams(recording)]))
    return [
        (w.time_s, float(irregular_prob(w.names, w.features, with_gyroscope)))
        for w in windows
        if w.has_gyroscope == with_gyroscope
    ]


def walks_and_handling(data: Path, with_gyroscope: bool) -> list[Window]:
    """Windows of ubicomp13; kind is how the phone is carried."""
    result: list[Window] = []
    for recording in recordings(data, "ubicomp13"):
        segment = recording.truth.segments[0]
        start_s, end_s = float(segment["start_s"]), float(segment["end_s"])
        _, person, _, kind = recording.name.split("_", 3)
        for time_s, prob in gated(recording, with_gyroscope):
            first_s = time_s - WINDOWS.window_s
            if first_s >= start_s and time_s <= end_s:
                result.append(Window(int(person[1:]), kind, False, prob))
            elif time_s < start_s - 1 or first_s > end_s + 1:
                result.append(Window(int(person[1:]), kind, True, prob))
    return result


def of_other_sets(data: Path, with_gyroscope: bool) -> list[Window]:
    """Windows wholly inside a label; kind is data set, context, carrying mode, and whether it is slow."""
    result: list[Window] = []
    for name in OTHER_SETS:
        for recording in recordings(data, name):
            for time_s, prob in gated(recording, with_gyroscope):
                first_s = time_s - WINDOWS.window_s
                label = label_of(recording, first_s, time_s)
                if label:
                    slow = speed_mps(recording, first_s, time_s) < SLOW_MPS
                    kind = f"{name}, {label}" + (f", below {SLOW_MPS} m/s" if slow else "")
                    result.append(Window(0, kind, False, prob))
    return result


def label_of(recording: pdr.Recording, start_s: float, end_s: float) -> str:
    """Context and carrying mode, empty where unknown; 0.02 s of slack, as in training."""
    for label in recording.truth.labels:
        if label["start_s"] - 0.02 <= start_s and end_s <= label["end_s"] + 0.02 and label["context"]:
            return f"{label['context']} {label['carrying_mode']}".strip()
    return ""


def speed_mps(recording: pdr.Recording, start_s: float, end_s: float) -> float:
    """Mean of the speeds over eighths of the window, infinite where no motion capture gives it."""
    position = recording.truth.position
    if position is None:
        return np.inf
    edges_s = np.linspace(start_s, end_s, 9)
    near = (position.time_s >= start_s - 0.3) & (position.time_s <= end_s + 0.3)
    if near.sum() < 15:
        return np.inf
    at = np.column_stack([np.interp(edges_s, position.time_s, c) for c in (position.east_m, position.north_m)])
    return float(np.hypot(*np.diff(at, axis=0).T).mean() / np.diff(edges_s)[0])


def of_people(windows: list[Window], sensors: str) -> list[list[str]]:
    """Rows of the people whom the gate was fitted on, and of those it was not."""
    moving, rows = [w for w in windows if w.prob > 0], []
    for name, group in {
        "1 to 6 (fitted on)": [w for w in moving if w.person <= 6],
        "7 to 13": [w for w in moving if w.person >= 7],
    }.items():
        truth, prob = np.array([w.is_irregular for w in group]), np.array([w.prob for w in group])
        thresholds = np.quantile(prob[~truth], [0.99, 0.98, 0.95])
        cells = [f"{truth.sum()}", f"{(~truth).sum()}", f"{roc_auc_score(truth, prob):.3f}"]
        cells += [f"{log_loss(truth, prob):.3f}", ", ".join(f"{(prob[truth] > t).mean():.2f}" for t in thresholds)]
        at_half = f"{(prob[truth] > 0.5).mean():.2f}, {100 * (prob[~truth] > 0.5).mean():.1f}"
        rows.append([sensors, name, *cells, at_half])
    return rows


def of_kinds(windows: list[Window], sensors: str) -> list[list[str]]:
    """Rows of the other sets, by set, context and carrying mode."""
    rows = []
    for kind in sorted({w.kind for w in windows}):
        prob = np.array([w.prob for w in windows if w.kind == kind])
        rows.append(
            [sensors, kind, str(len(prob)), f"{100 * (prob > 0.5).mean():.1f}", f"{100 * (prob == 0).mean():.1f}"]
        )
    return rows


def main() -> None:
    args = options(__doc__).parse_args()
    tables, people, kinds = Tables.of(__spec__.name, args), [], []
    for sensors, with_gyroscope in (("with gyroscope", True), ("accelerometer alone", False)):
        people += of_people(walks_and_handling(args.data, with_gyroscope), sensors)
        kinds += of_kinds(of_other_sets(args.data, with_gyroscope), sensors)
    columns = ["", "people", "handling", "gait", "area under the curve", "log loss"]
    columns += ["recall at 1, 2, 5 % false alarms", "at p > 0.5: recall, false alarms %"]
    tables.write("irregular_motion", columns, people, "Windows of ubicomp13.")
    columns = ["", "set, context, carrying mode", "windows", "p > 0.5 %", "still %"]
    Tables(tables.command, None).write("irregular_motion_other_sets", columns, kinds)


if __name__ == "__main__":
    main()
