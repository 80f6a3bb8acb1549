"""Contexts at the steps of people and sites that the classifier has not seen: windows, filter, smoother, barometer.

usage: python -m tests.benchmarks.contexts_left_out [PART ...] [--data ../shared/data] [--cache FOLDER]

`people`: the recordings of MotionSense (one activity each) and of Di Fronzo (several, with real changes), in the
default recipe with models of four folds, each without three people of the one and one of the other. What the window of
a step says, what the filter and the smoother say, and the same without the stretches whose labels are `DOUBTFUL`.

`sites`: level walking that is called stairs, at the steps and by how the phone is carried. Models of the training sets
are trained without the whole set; the others are never trained on. With and without the guard of stairs.

`corridors`: distances of the recipe martinelli2018, its machine trained without the site.

`barometer`: ipin2023 goes up and down stairs with the phone in the hand, ipin21 stays on one storey. Truth is the climb
rate of the barometer about each step (4 s, not causal): above 0.1 m/s it is on stairs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.offline.training.context_training import PLANS, SCORED_DATASETS, labelled_windows, model_without
from pdr_filter.offline.training.cross_validation import DOUBTFUL, LabelledWindows, recordings_of
from pdr_filter.offline.training.transition_training import contexts_at
from pdr_filter.recipes import context_transitions, default, martinelli2018, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.learned_contexts import shipped_model
from pdr_filter.sensing.features.barometer import ClimbRate
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray, TrackRows
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, options, recordings
from tests.benchmarks.mixed_contexts import LAG_STEPS, cached, windows_of

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


def people(tables: Tables, data: Path, cache: Path | None, windows: LabelledWindows) -> None:
    """Single activities and real changes, at the steps."""
    of_set = [sorted({p for p in windows.person if p.startswith(f"{name}/")}) for name in SCORED_DATASETS]
    answers = ("window", "filtered", "lagged", "smoothed")
    prob: dict[tuple[str, str], list[FloatArray]] = {}
    truth: dict[str, list[IntArray]] = {}
    sure: dict[str, list[BoolArray]] = {}
    for k in range(N_FOLDS):
        fold = [p for everybody in of_set for p in everybody[k::N_FOLDS]]
        model = without(windows, fold, cache, f"people_{k}")
        for path in recordings_of(data, SCORED_DATASETS):
            recording = pdr.read(path)
            name = path.parent.name
            if f"{name}/{recording.subject.id}" not in fold:
                continue
            config, track = tracked(recording, model)
            y = contexts_at(recording, track.time_s)
            use = (y >= 0) & ((y != STATIONARY) | (name != "difronzo"))
            if not use.any():
                continue
            lagged = smoothed_mode_prob(track.mode_prob, context_transitions(), LAG_STEPS)
            found = track.context_prob, track.mode_prob, lagged, pdr.smooth(recording, config=config).track.mode_prob
            for answer, each in zip(answers, found, strict=True):
                prob.setdefault((name, answer), []).append(each[use])
            truth.setdefault(name, []).append(y[use])
            sure.setdefault(name, []).append(track.time_s[use] < DOUBTFUL.get(recording.name, np.inf))
    rows = []
    for name in SCORED_DATASETS:
        y, certain = np.concatenate(truth[name]), np.concatenate(sure[name])
        for answer in answers:
            p = np.concatenate(prob[name, answer])
            right, loss = p.argmax(axis=1) == y, -np.log(np.maximum(p[np.arange(len(y)), y], 1e-6))
            by_context = ", ".join(f"{right[certain & (y == c)].mean():.3f}" for c in (WALKING, UP, DOWN))
            cells = [f"{right[u].mean():.3f}, {loss[u].mean():.2f}" for u in (y >= 0, certain)]
            rows.append([f"{name} ({len(y)} steps)", answer, *cells, by_context])
    columns = ["", "answer", "right, log loss", "without doubtful labels", "walking, up, down"]
    about = f"Four folds of people left out; lagged is {LAG_STEPS} steps later."
    tables.write("context_people", columns, rows, about)


def sites(tables: Tables, data: Path, cache: Path | None, windows: LabelledWindows) -> None:
    """Level walking called stairs."""
    rows = []
    for site, part in SITES.items():
        known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
        model = without(windows, known, cache, f"site_{site}") if known else shipped_model("context")
        of_kind: dict[str, list[FloatArray]] = {}
        for recording in recordings(data, site):
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


def barometer(tables: Tables, data: Path, cache: Path | None, windows: LabelledWindows) -> None:
    """Stairs in the hand, by barometer."""
    rows = []
    for site in ("ipin2023", "ipin21"):
        for recording in recordings(data, site):
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


def corridors(tables: Tables, data: Path, cache: Path | None, _: LabelledWindows) -> None:
    """Distance of the recipe martinelli2018 on level legs, its machine trained without the site."""
    plan = next(plan for plan in PLANS if plan.name == "context_martinelli_rvm")
    paths = recordings_of(data, plan.datasets)
    windows = cached(cache, "martinelli", lambda: plan.of(labelled_windows(paths, feature_set=plan.feature_set)))
    rows = []
    for site in ("humolire", "ms_indoor"):
        known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
        model = model_without(shipped_model(plan.name), plan, windows, known)
        error, is_level = [], []
        for recording in recordings(data, site):
            track = pdr.track(recording, config=with_context_model(martinelli2018(recording.subject), model))
            walked_m = np.concatenate([[0.0], np.cumsum(track.step_length_m)])
            time_s = np.concatenate([[track.start_time_s], track.time_s])
            legs = legs_of(recording)
            found_m = sum(np.diff(np.interp(leg[:2], time_s, walked_m))[0] for leg in legs)
            error.append(100 * (found_m / sum(leg[2] for leg in legs) - 1))
            is_level.append(track.context_prob.argmax(axis=1) == WALKING)
        e = np.array(error)
        cells = [f"{e.mean():+.1f}", f"{np.median(np.abs(e)):.1f}", f"{np.abs(e).max():.1f}"]
        rows.append([f"{site} ({len(e)} walks)", *cells, f"{100 * np.concatenate(is_level).mean():.1f}"])
    columns = ["", "distance: bias %", "median of its size %", "largest %", "steps called walking %"]
    tables.write("martinelli2018_corridors", columns, rows, "Each site left out of the machine's training.")


def legs_of(recording: Recording) -> list[tuple[float, float, float]]:
    """Begin, end and length of what was walked: the legs of known length, else from the first waypoint to the last."""
    segments, points = recording.truth.segments, recording.truth.waypoints
    if segments is not None and len(segments):
        return [(float(s["start_s"]), float(s["end_s"]), float(s["distance_m"])) for s in segments]
    assert points is not None
    length_m = float(np.hypot(np.diff(points["east_m"]), np.diff(points["north_m"])).sum())
    return [(float(points["time_s"][0]), float(points["time_s"][-1]), length_m)]


def main() -> None:
    parts = {"people": people, "sites": sites, "barometer": barometer, "corridors": corridors}
    parser = options(str(__doc__), *parts)
    parser.add_argument("--cache", type=Path, default=None, help="keeps windows and models")
    args = parser.parse_args()
    tables = Tables.of(__spec__.name, args)
    windows: LabelledWindows = cached(args.cache, "windows", lambda: windows_of(args.data))
    for part in args.parts:
        parts[part](tables, args.data, args.cache, windows)


if __name__ == "__main__":
    main()
