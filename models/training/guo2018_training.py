"""Training of the pose forest of Guo et al. 2018 and of the thresholds of its walk detection, on licensed recordings.

Run it with `python -m models.training.guo2018_training DATA_DIR OUT_DIR` (two minutes). The recordings
contain calling of one person and swinging of two. Trained on them alone, the forest recognises none of the calling and
half of the swinging of a held-out person. Synthetic windows are therefore added (`synthetic_windows`): **mirrored**
(the other side of the body), turned **over** (in the pocket, in all combinations), **turned** to the ear from in front
of the body, and **simulated** people.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestClassifier

from models.training.data_sets import OTHER_STOREYS, SCORED_DATASET, ShippedPlan, label_of, part_progress, recordings_of
from models.training.sine_people import MODES
from models.training.synthetic_windows import (
    SIMULATED,
    TURNED,
    balanced_weight,
    ear_rotations,
    from_sources,
    synthetic_card,
    windows_of_one,
)
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.forest import Forest
from pdr_filter.offline.columns import Columns
from pdr_filter.offline.training.classifier_choice import in_float32
from pdr_filter.offline.training.cross_validation import (
    HeldOut,
    LabelledWindows,
    Progress,
    TextArray,
    most_probable_labels,
    score,
    silent,
    train_one,
)
from pdr_filter.recipes.guo2018.features import WITHOUT_LIGHT_AND_PROXIMITY, MotionLevel, pitch_and_roll, pose_features
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray
from pdr_filter.values.recording import Recording

DATASETS = ("motionsense", "tyrex", "humolire", "ms_indoor", "oxford")
MIRRORED, OVER = "mirrored", "over"
# Weights relative to a recording, which has weight one: a half and a third. Synthetic windows must not outweigh real
# ones. Besides, the pocket is hard to distinguish from the ear by pitch and roll alone, and its recall decreases with
# every window turned to the ear.
SOURCE_WEIGHT = {SIMULATED: 0.5, TURNED: 0.3}
N_SIMULATED = 60
# Interval of the pocket windows that are turned over, because there are far more of them than of all others.
_EVERY = 4
_GRIPS = 4
_WINDOW_SAMPLES, _RATE_HZ = 60, 100.0


@dataclass(frozen=True, kw_only=True)
class PosePlan(ShippedPlan):
    """Plan of the pose forest, with pitch and roll not standardised and the same weight for all poses."""

    head: str = "carrying_mode"
    feature_limit: float = np.inf

    def weight(self, windows: LabelledWindows) -> FloatArray:
        """Return weights (W,) with the same total for every pose, that is, carrying mode.

        Within a pose, each source (data set or kind of synthetic windows) has a total in proportion to `SOURCE_WEIGHT`.
        """
        return balanced_weight(windows.carrying_mode, windows.dataset, SOURCE_WEIGHT)

    def standardisation(self, features: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean zero and scale one, because the features are not standardised."""
        return np.zeros(features.shape[1]), np.ones(features.shape[1])

    def fit(self, windows: LabelledWindows) -> ContextModel:
        """Return the random forest, with equal prior probabilities of all poses (carrying modes) in the data."""
        model = super().fit(windows)
        return replace(model, training_prior=(model.training_prior > 0) / len(model.classes))

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Return the held-out groups as masks (W,) by name.

        The first group are the recordings of tyrex near magnets. The next groups are one data set each, except the
        scored data set. The last groups are the people of the scored data set, one each.

        Groups without real windows, and groups that leave no real windows for training, are omitted.
        """
        groups = {
            "tyrex, its scenarios with magnets left out": np.char.find(windows.recording, "_dist_") >= 0,
            **{s: np.char.startswith(windows.person, f"{s}/") for s in self.datasets if s != SCORED_DATASET},
            **{str(p): windows.person == p for p in np.unique(windows.person) if _is_scored(p)},
        }
        real = self.is_real(windows)
        return {name: group for name, group in groups.items() if (group & real).any() and (~group & real).any()}

    def final_model(
        self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, HeldOut]
    ) -> ContextModel:
        """Return the model with its card: scores of each held-out site, and recall of the pocket for held-out people.

        The recall is given as the mean over the people of the scored data set and for the worst person.
        """
        scores = {name: pose_scores(windows.carrying_mode[group.rows], group.prob) for name, group in left_out.items()}
        people = [s for name, s in scores.items() if _is_scored(name)]
        summary: dict[str, Any] = {}
        if people:
            recalls = [s["recall"]["pocket"] for s in people]
            summary = {
                "n_windows": sum(s["n_windows"] for s in people),
                "recall": {"pocket": round(float(np.mean(recalls)), 4)},
                "worst_person_recall": round(min(recalls), 4),
            }
        card = {
            **self.card(windows, summary, {name: s for name, s in scores.items() if not _is_scored(name)}),
            "window_s": 0.6,
            "hop_s": 0.6,
            **synthetic_card(windows.dataset[~self.is_real(windows)], SOURCE_WEIGHT),
            "scored": "People and sites that the scored forest has not seen, nor anything made of them; the scenarios "
            "with magnets are of a person whom it has seen. What is made and the size of the leaves were chosen, out "
            "of fifteen ways, on the same people left out.",
        }
        return replace(model, card=card)


def fit_pose_forest(Z: FloatArray, y: TextArray, weight: FloatArray) -> tuple[Forest, tuple[str, ...]]:
    """Return a random forest of 30 trees for the poses of Guo et al. 2018, and its classes.

    Each split sees one random feature. With the usual three, nearly all pockets of the held-out oxford data were
    missed; with one, half of them. Leaves have at least 60 windows. Leaves of 20 windows double the size of the file
    and are no better on held-out people.
    """
    options: Any = {"max_features": 1, "min_samples_leaf": 60, "random_state": 0, "n_jobs": 1}
    fitted = RandomForestClassifier(30, **options).fit(in_float32(Z), y, sample_weight=weight)
    return _compact(Forest.from_sklearn(fitted)), tuple(map(str, fitted.classes_))


def _compact(forest: Forest) -> Forest:
    """Return the forest with leaf probabilities in steps of about 1/100, so that its file compresses well.

    Thresholds are rounded to float32, without a change of any decision about float32 numbers.
    """
    trees = forest.trees
    counts = np.round(100 * forest.probability)
    probability = np.where(trees.is_leaf[:, None], counts / np.maximum(counts.sum(axis=1), 1)[:, None], 0.0)
    threshold = in_float32(trees.threshold)
    down = np.nextafter(threshold.astype(np.float32), np.float32(-np.inf)).astype(np.float64)
    threshold = np.where(threshold > trees.threshold, down, threshold)  # same decisions as before for float32 numbers
    return Forest(replace(trees, threshold=threshold), probability)


def _is_scored(name: str) -> bool:
    """Return True for the name of a person of the scored data set, "motionsense/subject"."""
    return name.startswith(f"{SCORED_DATASET}/")


PLAN = PosePlan(
    name="guo_pose",
    feature_set="guo",
    feature_names=WITHOUT_LIGHT_AND_PROXIMITY,
    datasets=DATASETS,
    excluded=OTHER_STOREYS,
    machine_fit=fit_pose_forest,
    description="Random forest on the 12 statistics of pitch and roll of Guo et al. 2018, Table 1; trained on real "
    "recordings, on the same mirrored, turned over in the pocket and rotated to the ear, and on simulated people.",
    use="Windows of 0.6 s of a walking person; the guo2018 recipe.",
    limits="Without the six features of light and proximity. Four modes: a bag has probability zero. Pitch and roll "
    "show the orientation of the phone rather than its place, so that a pocket is often classified as calling or "
    "swinging. Calling comes from one real person, swinging from two. The default model `carrying` is better.",
)


def train_guo(
    paths: Sequence[Path], out_dir: Path, progress: Progress = silent, n_simulated: int = N_SIMULATED
) -> dict[str, Any]:
    """Train the model `guo_pose`, save it to `out_dir`, and return its card.

    `n_simulated` is the number of simulated people in each pose. Recordings of data sets other than `DATASETS` are
    ignored.
    """
    windows, walks = labelled_poses(paths, n_simulated, part_progress(progress, 0.0, 0.6))
    model = train_one(PLAN, windows, part_progress(progress, 0.6, 0.4))
    model = replace(model, card={**model.card, "walk_detection": walk_card(walks)})
    model.save(out_dir)
    return model.card


@dataclass(frozen=True, eq=False)
class WalkWindows(Columns):
    """Motion levels of labelled windows, in m2/s4: the level of motion of Guo et al. 2018, eq. 1 (`MotionLevel`).

    Attributes
    ----------
    level : array (W,)
        Level of motion: variance of the specific force plus 9.8 times the mean squared angular rate.
    level_accelerometer : array (W,)
        Level without the term of the angular rate.
    has_rate : array (W,) of bool
        True for windows with an angular rate.
    is_moving : array (W,) of bool
        True unless the context is "stationary".
    place : array (W,) of str
        Data set and carrying mode, for example "motionsense pocket".
    person : array (W,) of str
        Person.
    """

    level: FloatArray
    level_accelerometer: FloatArray
    has_rate: BoolArray
    is_moving: BoolArray
    place: TextArray
    person: TextArray


@dataclass(frozen=True, eq=False)
class _UpDirections(Columns):
    """Directions of up in the windows of one recording.

    `up_sensor` is (W, N, 3) in the sensor frame. `level` and `level_accelerometer` (W,) are the levels of motion in
    m2/s4, with and without the angular rate.
    """

    up_sensor: FloatArray
    context: TextArray
    mode: TextArray
    has_rate: BoolArray
    level: FloatArray
    level_accelerometer: FloatArray


def labelled_poses(
    paths: Sequence[Path], n_simulated: int = N_SIMULATED, progress: Progress = silent
) -> tuple[LabelledWindows, WalkWindows]:
    """Return windows of moving people with their 12 features, and the motion levels of all recorded windows.

    The windows are real, made from real ones, or simulated. `dataset` of a window is its source: a data set,
    `simulated`, or the kind of synthetic windows and the data set.
    """
    found = from_sources(_windows_of, paths, n_simulated, f"{PLAN.name}: poses", progress)
    levels = [level for _, of_source in found for level in of_source]
    if not levels:
        raise ValueError(f"no labelled windows of {', '.join(DATASETS)}: give their recordings with truth_labels.csv")
    poses = [part for of_source, _ in found for part in of_source]
    return LabelledWindows.concatenate(poses), WalkWindows.concatenate(levels)


def _windows_of(recording: Recording, dataset: str, person: str) -> tuple[list[LabelledWindows], list[WalkWindows]]:
    """Return windows for training the pose model, and levels of motion, from one recording or simulated person.

    The windows have the 12 features of pitch and roll and are of moving people in the carrying modes `MODES`. Those of
    a recording include synthetic ones made from it. The levels are of all labelled windows of the recording, also at
    rest. A simulated person has none. Both lists are empty for a recording that is not used.
    """
    ups = _up_directions(recording) if dataset == SIMULATED or PLAN.uses(dataset, recording.name) else None
    if ups is None:
        return [], []
    walks: list[WalkWindows] = []
    if dataset != SIMULATED:
        place = np.array([f"{dataset} {mode}".strip() for mode in ups.mode])
        moving, person_of_window = ups.context != "stationary", np.full(len(place), person)
        walks.append(WalkWindows(ups.level, ups.level_accelerometer, ups.has_rate, moving, place, person_of_window))
    ups = ups.part((ups.context != "stationary") & np.isin(ups.mode, MODES))
    made = [] if dataset == SIMULATED else _synthetic_from(ups, recording.name)
    found = [(dataset, ups), *((f"{kind}_{dataset}", more) for kind, more in made)]
    return [_labelled(some, made_of, person, recording.name) for made_of, some in found if len(some.mode)], walks


def _up_directions(recording: Recording) -> _UpDirections | None:
    """Return the directions of up in successive windows of 0.6 s of a recording, with their labels and motion levels.

    Only windows inside one label are included. The result is None if there are none.
    """
    conditioner, attitudes, level = Conditioner(), AttitudeEstimator(), MotionLevel()
    rows: list[tuple[FloatArray, str, str, bool, float, float]] = []
    attitude_state = attitudes.init()
    for block in conditioner.update(conditioner.init(), merge_streams(recording))[1]:
        attitude_state, attitude = attitudes.update(attitudes.after_gap(attitude_state), block)
        levels = level.update(level.init(), block)[1]
        blind = replace(block, angular_rate_known=np.zeros(len(block.time_s), dtype=bool))
        levels_accelerometer = level.update(level.init(), blind)[1]
        for start in range(0, len(block.time_s) - _WINDOW_SAMPLES + 1, _WINDOW_SAMPLES):
            last, half_s = start + _WINDOW_SAMPLES - 1, 0.5 / _RATE_HZ
            label = label_of(recording, float(block.time_s[start]) - half_s, float(block.time_s[last]) + half_s)
            if label is not None:
                has_rate = bool(block.angular_rate_known[start : last + 1].all())
                up = attitude.up_sensor[start : last + 1]
                rows.append((up, *label, has_rate, float(levels[last]), float(levels_accelerometer[last])))
    return _UpDirections(*(np.array(column) for column in zip(*rows, strict=True))) if rows else None


def _synthetic_from(ups: _UpDirections, name: str) -> list[tuple[str, _UpDirections]]:
    """Return synthetic windows made from the windows of a recording, as pairs of kind and windows.

    The kinds are mirrored windows, pocket windows turned over in six ways, and hand windows rotated to the ear.
    """
    made = [(MIRRORED, replace(ups, up_sensor=ups.up_sensor * np.array([-1.0, 1.0, 1.0])))]
    pocket = ups.part(ups.mode == "pocket").part(slice(None, None, _EVERY))
    for signs in itertools.product((1.0, -1.0), repeat=3):
        if signs[1:] != (1.0, 1.0):
            made.append((OVER, replace(pocket, up_sensor=pocket.up_sensor * np.array(signs))))
    held = ups.part(ups.mode == "texting")
    parts = [held.part(slice(grip, None, _GRIPS)) for grip in range(min(_GRIPS, len(held.mode)))]
    for part, matrix in zip(
        parts, ear_rotations([part.up_sensor.mean(axis=(0, 1)) for part in parts], name), strict=True
    ):
        mode = np.full(len(part.mode), "calling")
        made.append((TURNED, replace(part, up_sensor=part.up_sensor @ matrix.T, mode=mode)))
    return made


def _labelled(ups: _UpDirections, source: str, person: str, name: str) -> LabelledWindows:
    """Return windows with the 12 features of pitch and roll.

    `source` is their data set or kind of synthetic windows, and `name` the recording.
    """
    features = np.array([pose_features(np.stack(pitch_and_roll(up))) for up in ups.up_sensor])
    return windows_of_one(features, ups.context, ups.mode, person, source, name, ups.has_rate)


def pose_scores(truth: TextArray, prob: FloatArray) -> dict[str, Any]:
    """Return the scores (`score`) of probabilities (W, L), the number of windows of each carrying mode, and kappa.

    Kappa is omitted if `truth` (W,) has only one mode.
    """
    n = {mode: int((truth == mode).sum()) for mode in MODES if (truth == mode).any()}
    scores = {**score(truth, prob, CARRYING_MODES), "n": n}
    return {**scores, "kappa": kappa(truth, prob)} if len(n) > 1 else scores


def kappa(truth: TextArray, prob: FloatArray) -> float:
    """Return Cohen's kappa of the most probable classes and the true ones, to four decimals.

    `truth` must have at least two classes.
    """
    found = most_probable_labels(prob, CARRYING_MODES)
    by_chance = sum(float(np.mean(truth == c) * np.mean(found == c)) for c in CARRYING_MODES)
    agreed = float(np.mean(truth == found))
    return round((agreed - by_chance) / (1 - by_chance), 4)


def walk_threshold(level: FloatArray, is_moving: BoolArray, place: TextArray) -> tuple[float, dict[str, float]]:
    """Return the threshold of the level of motion above which the person walks, and the recalls at this threshold.

    The threshold is delta_min of Guo et al. 2018, eq. 1, in m2/s4. It maximises the smallest of the recalls: of
    "stationary" windows, and of moving windows for each value of `place` (data set and carrying mode).
    """
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
    """Return the thresholds of the level of motion, and the recalls of moving and of rest for held-out people.

    The thresholds are delta_min of Guo et al. 2018, eq. 1, with and without the angular rate (`walk_threshold`).
    """
    with_rate = walks.has_rate
    result: dict[str, Any] = {}
    for key, level, use in (
        ("min_level", walks.level, with_rate),
        ("min_level_accelerometer", walks.level_accelerometer, np.ones(len(with_rate), dtype=bool)),
    ):
        threshold, recall = walk_threshold(level[use], walks.is_moving[use], walks.place[use])
        people = [p for p in np.unique(walks.person) if _is_scored(p)]
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


if __name__ == "__main__":
    from models.training import guo2018_training as guo2018  # by its name: other processes cannot import __main__

    guo2018.train_guo(
        recordings_of(Path(sys.argv[1]), DATASETS),
        Path(sys.argv[2]),
        lambda what, done: print(f"{100 * done:5.1f} %  {what}"),
    )
