"""Train the pose forest of Guo et al. 2018 and the thresholds of its walk detection, on recordings with a licence.

`python -m pdr_filter.training.guo2018 DATA_DIR OUT_DIR` runs it: two minutes.

Their 101 people are not public. Here calling is known from one person, swinging from two, and pitch and roll are the
habit of a person as much as the pose: trained on the recordings alone, the forest finds none of the calling and half of
the swinging of a person left out, and takes texting for swinging. So windows stand for others, as in `train_carrying`:

- **mirrored** windows: the other hand, the other side of the body;
- windows turned **over**: the phone in the pocket upside down, screen in or out, in all combinations;
- **turned** windows: a hand held in front of the body, the phone turned to the ear;
- **simulated** people in all poses.

Every pose has the same weight, and inside it every source its own. What was made of a recording is left out with it.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, cast
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation
from sklearn.ensemble import RandomForestClassifier

from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.model import ContextModel
from pdr_filter.io.formats import read
from pdr_filter.io.recording import Recording
from pdr_filter.papers.guo2018.features import (
    WITHOUT_LIGHT_AND_PROXIMITY,
    MotionLevel,
    pitch_and_roll,
    pose_features,
)
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.simulate.people import EAR_PITCH_RAD, EAR_ROLL_RAD, MODES, simulated_person
from pdr_filter.training.carrying import balanced_weight
from pdr_filter.training.contexts import LabelledWindows, Plan, Progress, TextArray, card_of, label_of, score
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.contexts import CARRYING_MODES

DATASETS = ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford")
MIRRORED, OVER, TURNED, SIMULATED = "mirrored", "over", "turned", "simulated"
# A recording has one. Half and a third: what is made must not outvote what is real, and the pocket, which from pitch
# and roll alone is hard to tell from the ear, loses with every window turned to the ear.
SOURCE_WEIGHT = {SIMULATED: 0.5, TURNED: 0.3}
N_SIMULATED = 60
# Of the windows of a pocket, every so manyth is turned over: there are far more of them than of anything else.
_EVERY = 4
_WINDOW_SAMPLES, _RATE_HZ = 60, 100.0


def fit_forest(X: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Forest, tuple[str, ...]]:
    """A random forest of 30 trees and its classes.

    Each split looks at one feature drawn at random, and leaves have at least 60 windows. With the usual three features
    nearly all pockets of oxford, left out, were missed, with one a half; how many depends on the random numbers, as the
    four recordings are of one person. The paper's trees grow to their full depth; leaves of 20 windows make the file
    twice as large and are no better on people left out.
    """
    options: Any = {"max_features": 1, "min_samples_leaf": 60, "random_state": 0, "n_jobs": 1}
    # The stored trees compare float32 numbers: trained on such, they decide everywhere as scikit-learn's.
    values = X.astype(np.float32).astype(np.float64)
    fitted = RandomForestClassifier(30, **options).fit(values, y, sample_weight=weight)
    return _compact(Forest.from_sklearn(fitted)), tuple(str(c) for c in fitted.classes_)


def _compact(forest: Forest) -> Forest:
    """The forest with probabilities of leaves in steps of about 1/100, so that its file packs well."""
    is_leaf = forest.left < 0
    counts = np.round(100 * forest.probability)
    probability = np.where(is_leaf[:, None], counts / np.maximum(counts.sum(axis=1), 1)[:, None], 0.0)
    threshold = forest.threshold.astype(np.float32).astype(np.float64)
    down = np.nextafter(threshold.astype(np.float32), np.float32(-np.inf)).astype(np.float64)
    threshold = np.where(threshold > forest.threshold, down, threshold)  # decides as before on float32 numbers
    return replace(forest, probability=probability, threshold=threshold)


PLAN = Plan(
    "guo_pose",
    "carrying_mode",
    "guo",
    WITHOUT_LIGHT_AND_PROXIMITY,
    DATASETS,
    cast(Any, fit_forest),
    "Random forest on the 12 statistics of pitch and roll of Guo et al. 2018, Table 1; real recordings, the same "
    "mirrored, turned over in the pocket and turned to the ear, and simulated people.",
    "Windows of 0.6 s of somebody who walks; the guo2018 recipe.",
    "Without the six features of light and proximity. Four modes: a bag has probability zero. Pitch and roll show how "
    "somebody holds the phone rather than where it is: a pocket is often taken for the ear or a swinging hand. Calling "
    "is known from one real person, swinging from two. The default model `carrying` is better.",
    MODES,
)


@dataclass(frozen=True, eq=False)
class WalkWindows:
    """Levels of motion (eq. 1) of labelled windows."""

    level: FloatArray  # (W,)
    level_accelerometer: FloatArray  # (W,) without the term of the angular rate
    has_rate: BoolArray  # (W,)
    is_moving: BoolArray  # (W,)
    place: TextArray  # (W,) data set and carrying mode
    person: TextArray  # (W,)


@dataclass(frozen=True, eq=False)
class _Ups:
    """Directions of up in windows of one recording."""

    up_sensor: FloatArray  # (W, N, 3)
    context: TextArray  # (W,)
    mode: TextArray  # (W,)
    has_rate: BoolArray  # (W,)
    level: FloatArray  # (W,)
    level_accelerometer: FloatArray  # (W,)

    def part(self, use: BoolArray | slice) -> _Ups:
        """Some of the windows."""
        return _Ups(*(getattr(self, f.name)[use] for f in fields(_Ups)))


def labelled_poses(
    paths: Sequence[Path], n_simulated: int = N_SIMULATED, progress: Progress | None = None
) -> tuple[LabelledWindows, WalkWindows]:
    """Windows of moving people with their 12 features, real, made of real ones and simulated; and levels of motion.

    `dataset` of a window is its source: a data set, `simulated`, or what was made of which data set.
    """
    parts: list[LabelledWindows] = []
    levels: list[WalkWindows] = []
    jobs: list[Path | tuple[str, int]] = [*paths, *((mode, i) for i in range(n_simulated) for mode in MODES)]
    for i, job in enumerate(jobs):
        recording = read(job) if isinstance(job, Path) else simulated_person(*job)
        dataset = str(recording.meta.get("dataset", "")) if isinstance(job, Path) else SIMULATED
        person = f"{dataset}/{recording.subject.id if isinstance(job, Path) else recording.name}"
        ups = _windows_of(recording) if dataset in (*DATASETS, SIMULATED) else None
        if progress is not None:
            progress(f"poses of {recording.name}", (i + 1) / len(jobs))
        if ups is None or not len(ups.mode):
            continue
        if isinstance(job, Path):
            levels.append(_walk_windows(ups, dataset, person))
        ups = ups.part((ups.context != "stationary") & np.isin(ups.mode, MODES))
        made = _made_of(ups, recording.name) if isinstance(job, Path) else []
        for source, some in [(dataset, ups), *((f"{kind}_{dataset}", more) for kind, more in made)]:
            if len(some.mode):
                parts.append(_labelled(some, source, person, recording.name))
    if not levels:
        raise ValueError(f"no labelled windows of {', '.join(DATASETS)}: give recordings with truth_labels.csv")
    names = [f.name for f in fields(LabelledWindows)]
    windows = LabelledWindows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    names = [f.name for f in fields(WalkWindows)]
    return windows, WalkWindows(*(np.concatenate([getattr(part, name) for part in levels]) for name in names))


def _windows_of(recording: Recording) -> _Ups:
    """All windows that lie inside one label."""
    conditioner, attitudes, level = Conditioner(), AttitudeEstimator(), MotionLevel()
    rows: list[tuple[FloatArray, str, str, bool, float, float]] = []
    attitude_state = attitudes.init()
    for block in conditioner.step(conditioner.init(), merge_streams(recording))[1]:
        attitude_state, attitude = attitudes.step(attitudes.after_gap(attitude_state), block)
        levels = level.step(level.init(), block)[1]
        blind = replace(block, angular_rate_known=np.zeros(len(block.time_s), dtype=bool))
        levels_accelerometer = level.step(level.init(), blind)[1]
        for start in range(0, len(block.time_s) - _WINDOW_SAMPLES + 1, _WINDOW_SAMPLES):
            last, half_s = start + _WINDOW_SAMPLES - 1, 0.5 / _RATE_HZ
            label = label_of(recording, float(block.time_s[start]) - half_s, float(block.time_s[last]) + half_s)
            if label is not None:
                has_rate = bool(block.angular_rate_known[start : last + 1].all())
                up = attitude.up_sensor[start : last + 1]
                rows.append((up, *label, has_rate, float(levels[last]), float(levels_accelerometer[last])))
    if not rows:
        none = np.array([])
        return _Ups(
            np.empty((0, _WINDOW_SAMPLES, 3)), none.astype(str), none.astype(str), none.astype(bool), none, none
        )
    up, context, mode, has_rate, first, second = zip(*rows, strict=True)
    return _Ups(*(np.array(column) for column in (up, context, mode, has_rate, first, second)))


def _walk_windows(ups: _Ups, dataset: str, person: str) -> WalkWindows:
    place = np.array([f"{dataset} {mode}".strip() for mode in ups.mode])
    moving = ups.context != "stationary"
    return WalkWindows(ups.level, ups.level_accelerometer, ups.has_rate, moving, place, np.full(len(place), person))


def _made_of(ups: _Ups, name: str) -> list[tuple[str, _Ups]]:
    """What stands for other people, by kind."""
    made = [(MIRRORED, replace(ups, up_sensor=ups.up_sensor * np.array([-1.0, 1.0, 1.0])))]
    pocket = ups.part(ups.mode == "pocket").part(slice(None, None, _EVERY))
    for signs in itertools.product((1.0, -1.0), repeat=3):
        if signs[1:] != (1.0, 1.0):
            made.append((OVER, replace(pocket, up_sensor=pocket.up_sensor * np.array(signs))))
    held = ups.part(ups.mode == "texting")
    rng = np.random.default_rng(crc32(name.encode()))
    for grip in range(min(4, len(held.mode))):
        some = held.part(slice(grip, None, 4))
        mean = some.up_sensor.mean(axis=(0, 1))
        level = Rotation.align_vectors([0.0, 0.0, 1.0], mean / np.sqrt(mean @ mean))[0]
        side = rng.choice([-1.0, 1.0])
        pitch_rad, roll_rad = rng.normal(EAR_PITCH_RAD, 0.2), -side * rng.normal(EAR_ROLL_RAD, 0.25)
        matrix = (Rotation.from_euler("ZXY", [0.0, pitch_rad, roll_rad]).inv() * level).as_matrix()
        mode = np.full(len(some.mode), "calling")
        made.append((TURNED, replace(some, up_sensor=some.up_sensor @ matrix.T, mode=mode)))
    return made


def _labelled(ups: _Ups, source: str, person: str, name: str) -> LabelledWindows:
    features = np.array([pose_features(np.stack(pitch_and_roll(up))) for up in ups.up_sensor])
    n = len(features)
    return LabelledWindows(
        features, ups.context, ups.mode, np.full(n, person), np.full(n, source), np.full(n, name), ups.has_rate
    )


def is_real(windows: LabelledWindows) -> BoolArray:
    """Which windows were recorded as they are, (W,)."""
    return np.isin(windows.dataset, DATASETS)


def fitted_model(windows: LabelledWindows, use: BoolArray, card: dict[str, Any]) -> ContextModel:
    """The forest of some of the windows."""
    y, source = windows.carrying_mode[use], windows.dataset[use]
    machine, classes = fit_forest(windows.features[use], y, balanced_weight(y, source, SOURCE_WEIGHT))
    n_features = len(PLAN.feature_names)
    prior = np.array([float(mode in classes) for mode in CARRYING_MODES])  # so weighted, all that it knows are alike
    return ContextModel(
        name=PLAN.name,
        feature_names=PLAN.feature_names,
        classes=classes,
        training_prior=prior / prior.sum(),
        feature_mean=np.zeros(n_features),
        feature_scale=np.ones(n_features),
        machine=machine,
        card=card,
        head=PLAN.head,
    )


def probabilities(model: ContextModel, features: FloatArray) -> FloatArray:
    """Probabilities (W, L) of many windows at once."""
    result = np.zeros((len(features), len(CARRYING_MODES)))
    result[:, [CARRYING_MODES.index(c) for c in model.classes]] = model.machine.predict_proba(features)
    return result


def left_out_scores(windows: LabelledWindows, left_out: BoolArray) -> dict[str, Any]:
    """Scores of the real windows of those left out, by a forest of all others."""
    test = left_out & is_real(windows)
    prob = probabilities(fitted_model(windows, ~left_out, {}), windows.features[test])
    truth = windows.carrying_mode[test]
    n = {mode: int((truth == mode).sum()) for mode in MODES if (truth == mode).any()}
    scores = {**score(truth, prob, CARRYING_MODES), "n": n}
    return {**scores, "kappa": kappa(truth, prob)} if len(n) > 1 else scores


def kappa(truth: TextArray, prob: FloatArray) -> float:
    """Cohen's kappa of the most probable class; at least two classes must be true of some window."""
    predicted = np.array(CARRYING_MODES)[prob.argmax(axis=1)]
    by_chance = sum(float(np.mean(truth == c) * np.mean(predicted == c)) for c in CARRYING_MODES)
    agreed = float(np.mean(truth == predicted))
    return round((agreed - by_chance) / (1 - by_chance), 4)


def walk_threshold(level: FloatArray, is_moving: BoolArray, place: TextArray) -> tuple[float, dict[str, float]]:
    """delta_min at which the worst recall is best, and the recalls: of rest, and of movement at each place."""
    at_rest, moving = np.sort(level[~is_moving]), is_moving
    places = {str(p): np.sort(level[moving & (place == p)]) for p in np.unique(place[moving])}
    candidates = np.geomspace(0.02, 20.0, 301)

    def recalls(threshold: float) -> dict[str, float]:
        found = {"stationary": float(np.searchsorted(at_rest, threshold, side="right") / len(at_rest))}
        for name, values in places.items():
            found[name] = float(1.0 - np.searchsorted(values, threshold, side="right") / len(values))
        return found

    best = float(max(candidates, key=lambda threshold: min(recalls(threshold).values())))
    return best, {name: round(value, 4) for name, value in recalls(best).items()}


def walk_card(walks: WalkWindows) -> dict[str, Any]:
    """Thresholds of eq. 1, and how well they tell walking from standing and sitting on people left out."""
    with_rate = walks.has_rate
    result: dict[str, Any] = {}
    for key, level, use in (
        ("min_level", walks.level, with_rate),
        ("min_level_accelerometer", walks.level_accelerometer, np.ones(len(with_rate), dtype=bool)),
    ):
        threshold, recall = walk_threshold(level[use], walks.is_moving[use], walks.place[use])
        people = [p for p in np.unique(walks.person) if p.startswith("motionsense/")]
        own: list[tuple[float, float]] = []
        for person in people:
            rest, test = use & (walks.person != person), use & (walks.person == person)
            without, _ = walk_threshold(level[rest], walks.is_moving[rest], walks.place[rest])
            own.append((
                float(np.mean(level[test & ~walks.is_moving] <= without)),
                float(np.mean(level[test & walks.is_moving] > without)),
            ))  # fmt: skip
        still, moving = np.array(own).T
        result[key] = round(threshold, 3)
        result[f"{key}_recall"] = recall
        result[f"{key}_motionsense_left_out"] = {
            "n_people": len(people),
            "stationary_recall": round(float(still.mean()), 4),
            "worst_stationary_recall": round(float(still.min()), 4),
            "moving_recall": round(float(moving.mean()), 4),
            "worst_moving_recall": round(float(moving.min()), 4),
        }
    result["highest_level_of_movement"] = round(float(walks.level[walks.is_moving].max()), 1)
    return result


def train_guo(
    paths: Sequence[Path], out_dir: Path, progress: Progress | None = None, n_simulated: int = N_SIMULATED
) -> dict[str, Any]:
    """Card of the model `guo_pose`, which is written to `out_dir`.

    Parameters
    ----------
    paths : sequence of Path
        Recordings; those of data sets other than `DATASETS` are not used.
    out_dir : Path
        Where `guo_pose.npz` and `guo_pose.json` go.
    progress : callable, optional
        Called with what is done and the fraction of the whole, 0 to 1.
    n_simulated : int
        Simulated people in each pose.
    """

    def tell(what: str, fraction: float) -> None:
        if progress is not None:
            progress(what, fraction)

    windows, walks = labelled_poses(paths, n_simulated, lambda what, done: tell(what, 0.6 * done))
    real = is_real(windows)
    groups = {
        "tyrex, its scenarios with magnets left out": np.char.find(windows.recording, "_dist_") >= 0,
        **{site: _of_site(windows, site) for site in DATASETS if site != "motionsense"},
        **{p: windows.person == p for p in np.unique(windows.person) if p.startswith("motionsense/")},
    }
    scores: dict[str, Any] = {}
    for i, (name, left_out) in enumerate(groups.items()):
        if (left_out & real).any() and (~left_out & real).any():
            scores[name] = left_out_scores(windows, left_out)
        tell(f"guo_pose: without {name}", 0.6 + 0.35 * (i + 1) / len(groups))
    people = [s for name, s in scores.items() if name.startswith("motionsense/")]
    sites = {name: s for name, s in scores.items() if not name.startswith("motionsense/")}
    recalls = [s["recall"]["pocket"] for s in people]
    summary = (
        {
            "n_windows": sum(s["n_windows"] for s in people),
            "recall": {"pocket": round(float(np.mean(recalls)), 4)},
            "worst_person_recall": round(min(recalls), 4),
        }
        if people
        else {}
    )
    card = {
        **card_of(PLAN, windows.carrying_mode[real], windows.person[real], summary, sites),
        "window_s": 0.6,
        "hop_s": 0.6,
        "made_windows": {str(s): int((windows.dataset == s).sum()) for s in np.unique(windows.dataset[~real])},
        "source_weight": SOURCE_WEIGHT,
        "walk_detection": walk_card(walks),
        "scored": "People and sites that the scored forest has not seen, nor anything made of them; the scenarios with "
        "magnets are of a person whom it has seen. What is made and the size of the leaves were chosen, out of fifteen "
        "ways, on the same people left out.",
        "command": "python -m pdr_filter.training.guo2018 DATA_DIR models",
    }
    model = fitted_model(windows, np.ones(len(real), dtype=bool), card)
    model.save(out_dir)
    tell("guo_pose: done", 1.0)
    return card


def _of_site(windows: LabelledWindows, site: str) -> BoolArray:
    return np.char.startswith(windows.person, f"{site}/")


def recordings(data_dir: Path) -> list[Path]:
    """Recordings to train on; one of motionsense is published twice."""
    found = [path for dataset in DATASETS for path in sorted((data_dir / dataset).glob("*.zip"))]
    return [path for path in found if path.stem != "motionsense_s01_sit_13"]


if __name__ == "__main__":
    train_guo(
        recordings(Path(sys.argv[1])), Path(sys.argv[2]), lambda what, done: print(f"{100 * done:5.1f} %  {what}")
    )
