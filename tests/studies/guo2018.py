"""Guo et al. 2018: poses by a random forest, steps, step lengths and walking speed by pose.

usage: python -m tests.studies.guo2018 [poses] [steps] [lengths] [speed]

poses: Table 3. steps: Table 5. lengths: Table 7 and Fig. 10, five step-length models by pose. speed: Tables 8 and 9.

Poses: five public data sets, every person classified by a forest without them, calling of one person, swinging of two.
Steps: ubicomp13 (persons 7 to 13) and oxford; swinging and calling are simulated. Speed: humolire and tyrex, the height
of tyrex's person not known. Thresholds were chosen on persons 1 to 6 of ubicomp13, parameters of the default detector
on all 13. Each length model has one constant, from walks of other people or, where there is one person, from the
person's other walks in all poses.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.training import guo2018_training as train_guo
from models.training.data_sets import recordings_of
from pdr_filter.evaluate.classification import accuracy, confusion_matrix, kappa, macro_recall, precision
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.filter.step_length.models import (
    KimStepLength,
    StepLengthFit,
    WeinbergStepLength,
    one_parameter_fit,
    static_fit,
)
from pdr_filter.recipes import for_recording
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.recipe import chen_fit
from pdr_filter.recipes.tian2016.recipe import tian_fit
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.motion import CARRYING
from pdr_filter.tracking.whole_recording import track as track_of
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, IntArray, Step, steps_of
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings, say, way_of
from tests.studies.data import (
    HEIGHT_M,
    NAN,
    Part,
    counted_walk,
    paper_table,
    people_left_out,
    place_of,
    prefixed,
    run_study,
    with_subject,
)

POSES = ("texting", "swinging", "pocket", "calling")  # order of Tables 3, 5 and 8

# --- poses ----------------------------------------------------------------------------------------------------------

# Folds of people who are left out together, by the start of their name: three forests instead of one for each.
_FOLDS = (("tyrex", "motionsense/s0"), ("oxford", "motionsense/s1"), ("humolire", "ms_indoor"))
_N_SIMULATED_IN_TRAINING = 10


@dataclass(frozen=True, eq=False)
class Classified:
    """True and predicted poses of windows."""

    truth: IntArray  # (W,) into POSES
    predicted: IntArray  # (W,)
    dataset: tuple[str, ...]  # those that there are

    def confusion(self) -> IntArray:
        """Counts (4, 4), rows the true pose."""
        return confusion_matrix(self.truth, self.predicted, len(POSES))


def classified_poses(data: Path) -> Classified | None:
    """Poses of windows of people who walk, each classified by a forest without them; None without two of the folds."""
    found = recordings_of(data, train_guo.DATASETS)
    paths = [p for p in found if not p.stem.startswith("motionsense") or "_wlk_" in p.stem]
    if not paths:
        return None
    windows, _ = train_guo.labelled_poses(paths, _N_SIMULATED_IN_TRAINING)
    real = train_guo.PLAN.is_real(windows)
    folds = [_of_people(windows.person, names) for names in _FOLDS]
    if sum(bool((fold & real).any()) for fold in folds) < 2:
        return None
    truth: list[IntArray] = []
    predicted: list[IntArray] = []
    columns = [CARRYING_MODES.index(pose) for pose in POSES]
    for fold in folds:
        test = fold & real
        if test.any():
            model = train_guo.PLAN.fit(windows.part(~fold))
            predicted.append(model.probabilities(windows.features[test])[:, columns].argmax(axis=1))
            truth.append(np.array([POSES.index(mode) for mode in windows.carrying_mode[test]]))
    found = tuple(str(d) for d in np.unique(windows.dataset[real]))
    return Classified(np.concatenate(truth), np.concatenate(predicted), found)


def _of_people(person: Sequence[str] | np.ndarray, names: Sequence[str]) -> BoolArray:
    return np.array([str(p).startswith(tuple(names)) for p in person])


# Where phones of ubicomp13 are, and the pose that this is.
PLACES = {
    "handheld_using": "texting",
    "hand_held": "texting",
    "trousers_front_pocket": "pocket",
    "trousers_back_pocket": "pocket",
}


# --- steps, lengths, speeds -----------------------------------------------------------------------------------------

_N_SIMULATED, _SIMULATED_M = 12, 80.0
# A contact that ends the last step of a walk may be found late.
_EDGE_S = 0.3


@dataclass(frozen=True, eq=False)
class PoseWalk:
    """A walk in one pose: what was true, and the steps of Guo's recipe and the default's."""

    source: str
    person: str
    pose: str
    n_true: int
    n_found: int
    n_default: int
    true_m: float  # NaN where it is not known, as all below
    true_mps: float
    steps: tuple[Step, ...]
    default_m: float
    default_mps: float
    height_m: float

    def lengths_m(self, fit: StepLengthFit) -> FloatArray:
        """Length of each step (n,)."""
        return np.array([fit.predict(step)[0] for step in self.steps])

    def distance_m(self, fit: StepLengthFit) -> float:
        """Sum of the step lengths."""
        return float(self.lengths_m(fit).sum())

    def speed_mps(self, fit: StepLengthFit) -> float:
        """Mean speed, v = L f averaged over the time of the steps."""
        return self.distance_m(fit) / sum(step.duration_s for step in self.steps)


def pose_walk(
    recording: Recording,
    source: str,
    pose: str,
    parts: Sequence[tuple[float, float]],
    *,
    edge_s: float = _EDGE_S,
    n_true: int = 0,
    true_m: float = NAN,
    true_mps: float = NAN,
) -> PoseWalk:
    """A walk in the parts (start, end in s) of a recording: the steps that end in them, or so soon before or after."""
    track, default = track_of(recording, _recipe(recording)), track_of(recording)

    def inside(time_s: FloatArray) -> BoolArray:
        return np.any([(time_s > a - edge_s) & (time_s <= b + edge_s) for a, b in parts], axis=0)

    steps = tuple(s for s, use in zip(steps_of(track.steps), inside(track.time_s), strict=True) if use)
    use = inside(default.time_s)
    default_m, default_s = float(default.step_length_m[use].sum()), float(np.sum(default.steps.duration_s[use]))
    return PoseWalk(
        source,
        str(recording.subject.id or recording.meta.get("dataset")),
        pose,
        n_true,
        len(steps),
        int(use.sum()),
        true_m,
        true_mps,
        steps,
        default_m,
        default_m / default_s if default_s else NAN,
        recording.subject.height_m or HEIGHT_M,
    )


def _recipe(recording: Recording) -> Config:
    """The recipe, which needs a gyroscope for a track, without that need: only steps are looked at."""
    return replace(for_recording("guo2018", recording), needs=())


def _scale(walks: Sequence[PoseWalk]) -> float:
    """Chen's c: true over estimated distance of walks of known length."""
    return sum(w.true_m for w in walks) / sum(w.distance_m(chen_fit(w.height_m)) for w in walks)


def speeds_mps(walks: Sequence[PoseWalk], pretraining: Sequence[PoseWalk]) -> FloatArray:
    """Mean speed of each walk (N,) by Chen's model with the person's own c, or the general one without pretraining."""
    found: list[float] = []
    for walk in walks:
        own = [w for w in pretraining if w.person == walk.person and w is not walk]
        found.append((_scale(own) if own else 1.0) * walk.speed_mps(chen_fit(walk.height_m)))
    return np.array(found)


# --- walks ----------------------------------------------------------------------------------------------------------


def counted_walks(data: Path) -> list[PoseWalk]:
    """Walks of ubicomp13 (persons 7 to 13) and oxford with counted steps, hand and trouser pockets."""
    walks: list[PoseWalk] = []
    for recording in people_left_out(data, PLACES):
        start_s, end_s, n_true = counted_walk(recording)
        pose = PLACES[place_of(recording)]
        walks.append(pose_walk(recording, "ubicomp13", pose, [(start_s, end_s)], n_true=n_true))
    for recording in recordings(data, "oxford"):
        labels, steps = recording.truth.labels, recording.truth.steps
        pose = str(labels.carrying_mode[0]) if labels is not None and len(labels) else ""
        if pose in POSES and steps is not None:
            part = (float(steps.time_s[0]), float(steps.time_s[-1]))
            walks.append(pose_walk(recording, "oxford", pose, [part], n_true=len(steps)))
    return walks


def _carried(mode: str, rng: np.random.Generator) -> Carrying:
    """A place of the phone with somebody's own grip."""
    typical = CARRYING[mode]
    return replace(
        typical,
        pitch_rad=typical.pitch_rad + float(rng.normal(0.0, 0.25)),
        roll_rad=typical.roll_rad + float(rng.normal(0.0, 0.3)),
        twist_rad=typical.twist_rad + float(rng.normal(0.0, 0.2)),
        side=1.0,
    )


def simulated_walks() -> list[PoseWalk]:
    """Walks of simulated people in all four poses."""
    legs = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=_SIMULATED_M)]
    return [_simulated(k, pose, legs, k) for k in range(1, _N_SIMULATED + 1) for pose in POSES]


def _simulated(number: int, pose: str, legs: Sequence[Leg], seed: int) -> PoseWalk:
    carrying = {pose: _carried(pose, np.random.default_rng([seed, POSES.index(pose)]))}
    name = f"simulated_{number}_{pose}"
    recording = simulate(legs, Gait.random(2018 + number), pose, seed=seed, name=name, carrying=carrying)
    recording = with_subject(recording, id=f"S{number}")
    segments = recording.truth.segments
    assert segments is not None  # of every simulated recording
    start_s, end_s = float(segments.start_s[1]), float(segments.end_s[-1])
    true_m, n_true = float(segments.distance_m[1:].sum()), int(segments.n_steps[1:].sum())
    true_mps = true_m / (end_s - start_s)
    return pose_walk(recording, "simulated", pose, [(start_s, end_s)], n_true=n_true, true_m=true_m, true_mps=true_mps)


def real_walks(data: Path) -> list[PoseWalk]:
    """Walks of known speed: the straight legs of humolire, and tyrex by motion capture."""
    walks: list[PoseWalk] = []
    for recording in recordings(data, "humolire"):
        legs = recording.truth.segments
        if legs is not None and len(legs):
            true_m, true_s = float(legs.distance_m.sum()), float((legs.end_s - legs.start_s).sum())
            parts = [(float(a), float(b)) for a, b in zip(legs.start_s, legs.end_s, strict=True)]
            true_mps = true_m / true_s
            walks.append(
                pose_walk(recording, "humolire", "texting", parts, edge_s=0.0, true_m=true_m, true_mps=true_mps)
            )
    for recording in recordings(data, "tyrex"):
        labels = recording.truth.labels
        if labels is not None and len(labels) and labels.context[0] == "walking" and labels.carrying_mode[0] in POSES:
            part = (float(labels.start_s[0]), float(labels.end_s[0]))
            pose, true_mps = str(labels.carrying_mode[0]), _mean_speed_mps(recording, *part)
            walks.append(pose_walk(recording, "tyrex", pose, [part], edge_s=0.0, true_mps=true_mps))
    return walks


def _mean_speed_mps(recording: Recording, start_s: float, end_s: float) -> float:
    """Of the phone in motion capture, its path low-passed at 0.5 Hz, so that sway and swing are not walked."""
    grid_s, way_m = way_of(recording)
    inside = (grid_s >= start_s) & (grid_s <= end_s)
    return float(np.linalg.norm(np.gradient(way_m, 0.02, axis=0), axis=1)[inside].mean())


# --- tables ---------------------------------------------------------------------------------------------------------

# Table 3, rows the pose.
_CONFUSION = np.array([[1219, 2, 8, 0], [2, 1031, 5, 1], [3, 3, 1018, 16], [4, 5, 2, 1101]])
_SCORES = {"accuracy %": 98.85, "kappa %": 98.46, "mean precision %": 98.833, "mean recall %": 98.828}
# Table 5: true and estimated steps of S1 to S12, by pose.
_STEPS: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "texting": (
        (128, 113, 118, 103, 119, 126, 126, 106, 116, 102, 110, 121),
        (128, 115, 119, 103, 118, 126, 125, 108, 116, 103, 110, 120),
    ),
    "swinging": (
        (124, 112, 116, 102, 111, 121, 117, 101, 108, 103, 103, 114),
        (123, 112, 115, 101, 112, 117, 116, 115, 109, 107, 106, 108),
    ),
    "pocket": (
        (121, 112, 117, 100, 109, 123, 126, 106, 107, 102, 106, 109),
        (124, 112, 115, 102, 103, 117, 127, 106, 109, 104, 108, 113),
    ),
    "calling": (
        (125, 114, 115, 102, 121, 122, 122, 104, 111, 103, 108, 116),
        (126, 115, 115, 103, 117, 123, 119, 105, 112, 104, 108, 113),
    ),
}
_COUNTED_PERCENT = {"texting": 99.78, "swinging": 99.32, "pocket": 99.85, "calling": 99.78}
# Mean absolute error by Table 9, m/s. Its columns of calling and swinging are exchanged against Table 8.
_SPEED_MAE_MPS = {"texting": 0.042, "calling": 0.048, "pocket": 0.063, "swinging": 0.094}
_QUANTILES = ("50 %", "95 %", "largest")
_SPEED_QUANTILES_MPS = {
    "texting": (0.031, 0.089, 0.090),
    "calling": (0.039, 0.068, 0.122),
    "pocket": (0.046, 0.126, 0.176),
    "swinging": (0.058, 0.110, 0.507),
}


def poses(tables: Tables, arguments: argparse.Namespace) -> None:
    """Scores of Table 3."""
    found = classified_poses(arguments.data)
    if found is None:
        say("poses are left out: one fold is held out, and fewer than two folds of people have recordings")
        return
    confusion = found.confusion()

    def scores(c: IntArray) -> dict[str, float]:
        return {
            "accuracy %": 100.0 * accuracy(c),
            "kappa %": 100.0 * kappa(c),
            "mean precision %": 100.0 * float(np.nanmean(precision(c))),
            "mean recall %": 100.0 * macro_recall(c),
        }

    ours, theirs = scores(confusion), scores(_CONFUSION)
    rows = [{"score": s, "paper": v, "paper from its table": theirs[s], "ours": ours[s]} for s, v in _SCORES.items()]
    title, data = "Table 3, scores: poses of held-out people", f"as Table 3: {int(confusion.sum())} windows"
    paper_table(tables, "guo2018_table_3_scores", title, rows, data, digits=2)
    matrix: list[Mapping[str, object]] = []
    for who, c in (("paper", _CONFUSION), ("ours", confusion)):
        for pose, counts in zip(POSES, c, strict=True):
            cells = prefixed("found", POSES, (100.0 * counts / counts.sum()).tolist(), " %")
            matrix.append({"who": who, "true": pose, "windows": int(counts.sum())} | cells)
    about = f"people held out; {', '.join(found.dataset)}"
    paper_table(tables, "guo2018_table_3", "Table 3: confusion matrix of the poses", matrix, about)


def steps(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table 5."""
    counted = [*counted_walks(arguments.data), *simulated_walks()]
    where = {
        "ubicomp13": "ubicomp13, persons 7 to 13 (video)",
        "oxford": "oxford, one person, no gyroscope (foot switches)",
        "simulated": f"simulated: {len({w.person for w in counted if w.source == 'simulated'})} people",
    }
    rows: list[Mapping[str, object]] = []
    for pose in POSES:
        true, estimated = (np.array(n) for n in _STEPS[pose])
        for source in where:
            own = [w for w in counted if (w.pose, w.source) == (pose, source)]
            if not own:
                continue
            n_true, n_found, n_default = (
                np.array([getattr(w, name) for w in own]) for name in ("n_true", "n_found", "n_default")
            )
            error = count_error_percent(n_found, n_true)
            rows.append(
                {
                    "pose": pose,
                    "paper of totals %": _COUNTED_PERCENT[pose],
                    "paper MAE %": float(np.abs(count_error_percent(estimated, true)).mean()),
                    "paper worst %": float(np.abs(count_error_percent(estimated, true)).max()),
                    "where": source,
                    "walks": len(own),
                    "persons": len({w.person for w in own}),
                    "ours of totals %": 100.0 - abs(float(count_error_percent(n_found.sum(), n_true.sum()))),
                    "ours MAE %": float(np.abs(error).mean()),
                    "ours worst %": float(np.abs(error).max()),
                    "ours default MAE %": float(np.abs(count_error_percent(n_default, n_true)).mean()),
                }
            )
    data = "; ".join(words for source, words in where.items() if any(w.source == source for w in counted))
    paper_table(tables, "guo2018_table_5", "Table 5: steps by pose", rows, data, digits=2)


# The five models of Table 7. Constants do not matter, because each model is scaled.
_LENGTHS: Mapping[str, Callable[[float], StepLengthFit]] = {
    "static": static_fit,
    "Weinberg": lambda height_m: one_parameter_fit(WeinbergStepLength(), 0.5, 0.1),
    "Tian": tian_fit,
    "Kim": lambda height_m: one_parameter_fit(KimStepLength(), 0.5, 0.1),
    "Chen": chen_fit,
}
# Table 7: error in % and standard deviation in m of 80 m, by pose.
_TABLE_7: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "static": {
        "texting": (11.42, 5.11),
        "calling": (19.26, 7.12),
        "pocket": (14.54, 11.72),
        "swinging": (30.82, 16.09),
    },
    "Weinberg": {
        "texting": (11.49, 5.62),
        "calling": (9.36, 5.34),
        "pocket": (11.15, 6.74),
        "swinging": (14.68, 11.87),
    },
    "Tian": {"texting": (12.60, 5.57), "calling": (9.89, 5.35), "pocket": (9.89, 7.50), "swinging": (10.24, 8.07)},
    "Kim": {"texting": (19.26, 7.12), "calling": (11.42, 5.11), "pocket": (10.69, 6.59), "swinging": (17.05, 17.52)},
    "Chen": {"texting": (3.14, 2.91), "calling": (3.66, 3.40), "pocket": (4.81, 5.07), "swinging": (6.99, 9.18)},
}


def relative_distances(walks: Sequence[PoseWalk], model: str) -> FloatArray:
    """Return estimated over true distance (N,) of walks, with the model scaled on walks of other people."""
    # tyrex has a known speed instead of a known distance
    true_m = np.array([w.true_mps * sum(s.duration_s for s in w.steps) for w in walks])
    found_m = np.array([w.distance_m(_LENGTHS[model](w.height_m)) for w in walks])
    person = np.array([w.person for w in walks])
    several = len(set(person)) > 1
    ratio: list[float] = []
    for k in range(len(walks)):
        others = person != person[k] if several else np.arange(len(walks)) != k
        ratio.append(float(found_m[k] / true_m[k] * true_m[others].sum() / found_m[others].sum()))
    return np.array(ratio)


def lengths(tables: Tables, arguments: argparse.Namespace) -> None:
    """Table 7 and Fig. 10."""
    errors: list[Mapping[str, object]] = []
    quartiles: list[Mapping[str, object]] = []
    for model, cells in _TABLE_7.items():
        row: dict[str, object] = {"where": "paper", "model": model}
        for pose in POSES:
            row |= {f"{pose} error %": cells[pose][0], f"{pose} std %": cells[pose][1] / 0.8}
        errors.append(row | {"mean error %": float(np.mean([error for error, _ in cells.values()]))})
    walks = [*real_walks(arguments.data), *simulated_walks()]
    for where in ("humolire", "tyrex", "simulated"):
        of_site = [w for w in walks if w.source == where]
        for model in _LENGTHS if of_site else ():
            ratio, row = relative_distances(of_site, model), {"where": where, "model": model}
            for pose in POSES:
                own = ratio[[w.pose == pose for w in of_site]]
                error, std = (100 * np.abs(own - 1).mean(), 100 * own.std()) if len(own) else (NAN, NAN)
                row |= {f"{pose} error %": float(error), f"{pose} std %": float(std)}
                if len(own):
                    five = np.quantile(80 * own, (0, 0.25, 0.5, 0.75, 1)).tolist()
                    names = ("least", "25 %", "median", "75 %", "largest")
                    quartiles.append({"where": where, "pose": pose, "model": model} | prefixed("m:", names, five))
            errors.append(row | {"mean error %": float(100 * np.abs(ratio - 1).mean())})
    about = (
        "Chen's model has the person's own three parameters in the paper, here one constant like each other model. "
        "humolire: straight legs of one person, tyrex: one person in a room of 5 m, simulated: 12 people"
    )
    paper_table(tables, "guo2018_table_7", "Table 7: five step-length models by pose", errors, about)
    about = "a true distance of 80 m; as Table 7"
    paper_table(tables, "guo2018_fig_10", "Fig. 10: distances by five step-length models", quartiles, about)


def speed(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors of Table 9: real walks, and simulated ones."""
    title = "Table 9, real walks: errors of the mean walking speed, m/s"
    data = "humolire: straight legs between landmarks; tyrex: motion capture in a room of 5 m; one person each"
    real = real_walks(arguments.data)
    paper_table(tables, "guo2018_table_9_real_walks", title, _speeds(real, ("humolire", "tyrex")), data, digits=3)
    title = "Table 9, simulated people: errors of the mean walking speed, m/s"
    rows = _speeds(simulated_walks(), ("simulated",))
    paper_table(tables, "guo2018_table_9_simulated", title, rows, "12 simulated people, 80 m each", digits=3)


def _speeds(walks: Sequence[PoseWalk], sources: Sequence[str]) -> list[Mapping[str, object]]:
    """Rows of Table 9 by source and pose."""
    rows: list[Mapping[str, object]] = []
    for source in sources:
        for pose in POSES:
            own = [w for w in walks if (w.source, w.pose) == (source, pose)]
            if not own:
                continue
            true = np.array([w.true_mps for w in own])
            general = speeds_mps(own, ()) - true
            # the person's other walks in any pose
            trained = [w for w in walks if w.source == source and np.isfinite(w.true_m)]
            has_length = all(np.isfinite(w.true_m) for w in own) and len(trained) > 1
            personal = np.abs(speeds_mps(own, trained) - true).mean() if has_length else NAN
            theirs, half = _SPEED_QUANTILES_MPS[pose], np.quantile(np.abs(general), (0.5, 0.95, 1.0)).tolist()
            rows.append(
                {
                    "where": source,
                    "pose": pose,
                    "walks": len(own),
                    "true m/s": float(true.mean()),
                    "paper MAE": _SPEED_MAE_MPS[pose],
                    **prefixed("paper", _QUANTILES, theirs),
                    "ours MAE, general c": float(np.abs(general).mean()),
                    **prefixed("ours", _QUANTILES, half),
                    "ours bias, general c": float(general.mean()),
                    "ours MAE, own c": float(personal),
                    "ours default MAE": float(np.abs([w.default_mps for w in own] - true).mean()),
                }
            )
    return rows


if __name__ == "__main__":
    run_study(
        __doc__,
        Part(make=poses, uses=train_guo.DATASETS),
        Part(make=steps, uses=("ubicomp13", "oxford")),
        Part(make=lengths, uses=("humolire", "tyrex")),
        Part(make=speed, uses=("humolire", "tyrex")),
    )
