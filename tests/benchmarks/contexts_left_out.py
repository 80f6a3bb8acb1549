"""Stairs at the steps of sites that the classifier has not seen: called so on the level, and found with a barometer.

usage: python -m tests.benchmarks.contexts_left_out [PART ...] [--data ../shared/data] [--cache FOLDER]

`sites`: level walking that is called stairs, at the steps and by how the phone is carried. Models of the training sets
are trained without the whole set; the others are never trained on. With and without the guard of stairs.

`barometer`: ipin2023 goes up and down stairs with the phone in the hand, ipin21 stays on one storey. Truth is the climb
rate of the barometer about each step (4 s, not causal): above 0.1 m/s it is on stairs.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.offline.training.context_training import PLANS, model_without
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.offline.training.transition_training import contexts_at
from pdr_filter.recipes import default, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.learned_contexts import shipped_model
from pdr_filter.sensing.features.barometer import ClimbRate
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, TrackRows
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings, run
from tests.benchmarks.mixed_contexts import cached, windows_of

N_FOLDS = 4
STATIONARY, WALKING, UP, DOWN = (CONTEXTS.index(c) for c in ("stationary", "walking", "upstairs", "downstairs"))
STAIRS_MPS = 0.1
# Those of level walking, with the field of the name that says how the phone is carried.
SITES: dict[str, int] = {
    "humolire": 0,
    "ms_indoor": 0,
    "tyrex": 2,
    "oxiod": 1,
    "ubicomp13": 3,
    "ipol": 0,
    "sisfall": -1,
}


def without(windows: LabelledWindows, people: list[str], cache: Path | None, name: str) -> ContextModel:
    """The shipped model as it is without some people."""
    return cached(cache, name, lambda: model_without(shipped_model("context"), PLANS[0], windows, people))


def tracked(recording: Recording, model: ContextModel) -> tuple[Config, TrackRows]:
    """The default's configuration with a model, and the track."""
    config = with_context_model(default(recording.subject), model)
    return config, pdr.track(recording, config=config)


def sites(tables: Tables, arguments: argparse.Namespace) -> None:
    """Level walking called stairs."""
    windows: LabelledWindows = cached(arguments.cache, "windows", lambda: windows_of(arguments.data))
    rows = []
    for site, part in SITES.items():
        known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
        model = without(windows, known, arguments.cache, f"site_{site}") if known else shipped_model("context")
        of_kind: dict[str, list[FloatArray]] = {}
        for recording in recordings(arguments.data, site):
            kind = kind_of(recording.name, part)
            found = []
            for each in (replace(model, stairs=None), model):
                _, track = tracked(recording, each)
                use = on_the_level(recording, track.time_s)
                stairs = np.isin(track.mode_prob[use].argmax(axis=1), (UP, DOWN))
                found += [stairs, track.mode_prob[use][:, [UP, DOWN]].sum(axis=1)]
            of_kind.setdefault(kind, []).append(np.array(found, dtype=float))
        for kind, parts in sorted(of_kind.items()):
            figures = np.concatenate(parts, axis=1)
            if figures.shape[1]:
                cells = [f"{100 * v:.1f}" for v in figures.mean(axis=1)]
                rows.append([f"{site} {kind}".strip(), figures.shape[1], ", ".join(cells[:2]), ", ".join(cells[2:])])
    columns = ["set, placement", "steps", "no guard: called stairs %, mean probability %", "with the guard"]
    tables.write("context_false_stairs", columns, rows, "The set left out as a whole where it is in training.")


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


def barometer(tables: Tables, arguments: argparse.Namespace) -> None:
    """Stairs in the hand, by barometer."""
    rows = []
    for site in ("ipin2023", "ipin21"):
        for recording in recordings(arguments.data, site):
            assert recording.barometer is not None
            config = default(recording.subject)
            climb = ClimbRate()
            pressure = recording.barometer
            _, climbs = climb.update(climb.init(), pressure.time_s, pressure.values[:, 0])
            middle_s = np.array([c.time_s - climb.window_s / 2 for c in climbs])
            live, later = pdr.track(recording, config=config), pdr.smooth(recording, config=config).track
            rate_mps = np.interp(live.time_s, middle_s, [c.climb_rate_mps for c in climbs])
            alone = pdr.track(replace(recording, barometer=None), config=config)
            truth = np.where(rate_mps > STAIRS_MPS, UP, np.where(rate_mps < -STAIRS_MPS, DOWN, WALKING))
            for answer, prob in (
                ("without barometer", alone.mode_prob),
                ("window", live.context_prob),
                ("filtered", live.mode_prob),
                ("smoothed", later.mode_prob),
            ):
                said = prob.argmax(axis=1)
                cells = [f"{np.mean(said[truth == c] == c):.2f}" for c in (UP, DOWN)]
                level = np.isin(said, (UP, DOWN))[truth == WALKING]
                rows.append([f"{site} ({len(said)} steps)", answer, *cells, f"{level.mean():.2f}"])
    columns = ["", "answer", "climbing called upstairs", "descending called downstairs", "level called stairs"]
    tables.write("context_barometer", columns, rows, "Climb rates above 0.1 m/s, of the barometer about each step.")


if __name__ == "__main__":
    run(__doc__, sites, barometer, cache=None)
