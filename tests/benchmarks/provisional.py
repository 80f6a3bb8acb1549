"""What `OnlineFilter.now()` shows before steps are accepted, against the track that is accepted later.

usage: python -m tests.benchmarks.provisional [--data ../shared/data]

Every 25 samples the position of `now()`, and that of the last accepted step, are compared with the track at the same
time, interpolated between its steps. Walking: between two steps less than 1.5 s apart; the start of a bout is its first
3 s, the stop the 3 s after its last step. ms_indoor: every third walk; of these every second one served to choose
between predictors and has its own row. humolire: all nine, one person.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.values import interpolated_rows
from tests.benchmarks.common import Tables, median_and, paths, push, run

_SAMPLES = 25
_PAUSE_S, _EDGE_S = 1.5, 3.0


def errors(path: Path) -> list[tuple[str, float, float]]:
    """Where in the walk, error of the last accepted step, and of now."""
    recording = pdr.read(path)
    samples, online = pdr.merge_streams(recording), pdr.OnlineFilter(pdr.recipes.default(recording.subject))
    seen, updates = list[tuple[float, np.ndarray, np.ndarray]](), list[pdr.StepUpdate]()
    for part in samples.parts(_SAMPLES):
        updates += push(online, part)
        now = online.now()
        seen.append((now.time_s, online.position_m, now.position_m))
    updates += online.finish()
    if len(updates) < 10:
        return []
    time_s, position_m = np.array([u.step.time_s for u in updates]), np.array([u.position_m for u in updates])
    begins_s = time_s[np.diff(time_s, prepend=-np.inf) > _PAUSE_S]
    rows = []
    for now_s, accepted_m, shown_m in seen:
        if not time_s[0] <= now_s < time_s[-1] + _EDGE_S:
            continue
        after = int(np.searchsorted(time_s, now_s, side="right"))
        if after < len(time_s) and time_s[after] - time_s[after - 1] < _PAUSE_S:
            true_m = interpolated_rows(now_s, time_s, position_m)
            where = "start" if now_s - begins_s[begins_s <= now_s][-1] < _EDGE_S else "walk"
        else:
            true_m, where = position_m[after - 1], "stop" if now_s - time_s[after - 1] < _EDGE_S else "rest"
        rows.append((where, *(float(np.linalg.norm(m - true_m)) for m in (accepted_m, shown_m))))
    return rows


def between_steps(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors at one time against the track accepted later."""
    walks = paths(arguments.data, "ms_indoor")[::3]
    sets = {
        "ms_indoor, chosen on": walks[1::2],
        "ms_indoor, others": walks[0::2],
        "humolire": paths(arguments.data, "humolire"),
    }
    rows = []
    for name, files in sets.items():
        found = [r for path in files for r in errors(path)]
        for where in ("walk", "start", "stop"):
            accepted, shown = np.array([r[1:] for r in found if r[0] == where]).T
            rows.append([name, len(files), where, len(shown), median_and(accepted, 90), median_and(shown, 90)])
    about = "Errors in m at one time against the track accepted later, median and 90th percentile."
    columns = "recordings | walks | where | n | last accepted step | `now()`"
    tables.write("provisional", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, between_steps)
