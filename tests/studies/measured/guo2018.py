"""What is measured here for the tables of Guo et al. 2018."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pdr_filter.evaluate.classification import confusion_matrix
from pdr_filter.filter.step_length.models import KimStepLength, StepLengthFit, WeinbergStepLength, static_fit
from pdr_filter.offline.training import guo2018_training as train_guo
from pdr_filter.offline.training.classifier_choice import fit_pose_forest
from pdr_filter.offline.training.cross_validation import leave_out, recordings_of
from pdr_filter.recipes import for_recording
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.features import PoseWindows
from pdr_filter.recipes.guo2018.recipe import chen_fit
from pdr_filter.recipes.tian2016.recipe import tian_fit
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.simulate import Carrying, Gait, Leg, simulate
from pdr_filter.simulate.motion import CARRYING
from pdr_filter.tracking.whole_recording import classify
from pdr_filter.tracking.whole_recording import track as track_of
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, IntArray, Step, steps_of
from pdr_filter.values.recording import Recording
from tests.studies.data import HEIGHT_M, counted_walk, even_way, people_left_out, place_of, recordings, with_subject
from tests.studies.printed.guo2018 import POSE_OF_SIDED, POSES, SIDED
from tests.studies.report import NAN

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
            prob = leave_out(train_guo.PLAN, windows, fold).prob[:, columns]
            predicted.append(prob.argmax(axis=1))
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


def poses_by_recipe(recording: Recording, recipe: str) -> IntArray:
    """Poses of the windows inside the walk: the most probable of the four carrying modes; a bag counts as a pocket."""
    start_s, end_s, _ = counted_walk(recording)
    windows = classify(recording, for_recording(recipe, recording))
    inside = (windows.time_s > start_s + 1.0) & (windows.time_s < end_s)
    prob = windows.carrying_prob[inside]
    of_pose = np.stack([prob[:, CARRYING_MODES.index(pose)] for pose in POSES], axis=1)
    of_pose[:, POSES.index("pocket")] += prob[:, CARRYING_MODES.index("bag")]
    return of_pose.argmax(axis=1)


# --- left and right, simulated --------------------------------------------------------------------------------------

N_SIDED = 20


def sided(mode: str, side: float, rng: np.random.Generator) -> Carrying:
    """A place of the phone at the right (+1) or left (-1) of the body, with somebody's own grip."""
    typical = CARRYING[mode]
    x, y, z = typical.place
    return replace(
        typical,
        place=(side * x, y, z),
        pitch_rad=typical.pitch_rad + float(rng.normal(0.0, 0.25)),
        roll_rad=side * (typical.roll_rad + float(rng.normal(0.0, 0.3))),
        twist_rad=side * (typical.twist_rad + float(rng.normal(0.0, 0.2))),
        side=side,
    )


def _sided_windows(n_people: int) -> tuple[FloatArray, IntArray, IntArray]:
    """Features (W, 12), classes (W,) into `SIDED`, person (W,) of simulated people in all seven."""
    features: list[FloatArray] = []
    label: list[int] = []
    person: list[int] = []
    for number in range(n_people):
        gait = Gait.random(4000 + number)
        for k, pose in enumerate(POSES[i] for i in POSE_OF_SIDED):
            side = -1.0 if SIDED[k].endswith("(L)") else 1.0
            carrying = {pose: sided(pose, side, np.random.default_rng([number, k]))}
            legs = [Leg("walking", duration_s=12.0)]
            recording = simulate(legs, gait, pose, seed=100 * number + k, carrying=carrying)
            own = list(_pose_windows(recording))[2:-2]  # without setting off and stopping
            features += own
            label += [k] * len(own)
            person += [number] * len(own)
    return np.array(features), np.array(label), np.array(person)


def _pose_windows(recording: Recording) -> Iterator[FloatArray]:
    attitudes, windows = AttitudeEstimator(), PoseWindows()
    attitude_state, state = attitudes.init(), windows.init()
    for block in Conditioner().update(Conditioner().init(), merge_streams(recording))[1]:
        attitude_state, attitude = attitudes.update(attitude_state, block)
        state, found = windows.update(state, block, attitude)
        yield from (window.features for _, window in found)


def sided_confusion(n_people: int = N_SIDED) -> IntArray:
    """Confusion (7, 7) of the last 40 % of simulated people, by a forest of the others, as the paper shares them."""
    features, label, person = _sided_windows(n_people)
    test = person >= round(0.6 * n_people)
    forest, classes = fit_pose_forest(features[~test], np.array(SIDED)[label[~test]], np.ones(int((~test).sum())))
    predicted = np.array([SIDED.index(c) for c in classes])[forest.predict_proba(features[test]).argmax(axis=1)]
    return confusion_matrix(label[test], predicted, len(SIDED))


# --- steps, lengths, speeds -----------------------------------------------------------------------------------------

N_SIMULATED = 12
SIMULATED_M = 80.0
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
    gender: str | None

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
        recording.subject.gender,
    )


def _recipe(recording: Recording) -> Config:
    """The recipe, which needs a gyroscope for a track, without that need: only steps are looked at."""
    return replace(for_recording("guo2018", recording), needs=())


def _fit(model: str, walk: PoseWalk) -> StepLengthFit:
    """The model with the printed parameters of the person; k = 1 where none is printed, general a and b for Chen."""
    none = np.zeros((1, 1))
    return {
        "static": lambda: static_fit(walk.height_m, walk.gender),
        "Weinberg": lambda: StepLengthFit(WeinbergStepLength(), np.ones(1), none, 0.0),
        "Tian": lambda: tian_fit(walk.height_m, walk.gender),
        "Kim": lambda: StepLengthFit(KimStepLength(), np.ones(1), none, 0.0),
        "Chen": lambda: chen_fit(walk.height_m),
    }[model]()


def scale_of(model: str, walks: Sequence[PoseWalk]) -> float:
    """The one parameter k, or Chen's c: true over estimated distance of walks of known length."""
    return sum(w.true_m for w in walks) / sum(w.distance_m(_fit(model, w)) for w in walks)


def distances_m(model: str, walks: Sequence[PoseWalk], pretraining: Sequence[PoseWalk]) -> FloatArray:
    """Distance of each walk (N,).

    Static and Tian with the printed k, Weinberg and Kim with that of the other persons' pretraining, Chen with the c of
    the person's own.
    """
    found: list[float] = []
    for walk in walks:
        scale = 1.0
        if model in ("Weinberg", "Kim"):
            scale = scale_of(model, [w for w in pretraining if w.person != walk.person])
        elif model == "Chen":
            scale = scale_of(model, [w for w in pretraining if w.person == walk.person and w is not walk])
        found.append(scale * walk.distance_m(_fit(model, walk)))
    return np.array(found)


def speeds_mps(walks: Sequence[PoseWalk], pretraining: Sequence[PoseWalk]) -> FloatArray:
    """Mean speed of each walk (N,) by Chen's model with the person's own c, or the general one without pretraining."""
    found: list[float] = []
    for walk in walks:
        own = [w for w in pretraining if w.person == walk.person and w is not walk]
        found.append((scale_of("Chen", own) if own else 1.0) * walk.speed_mps(_fit("Chen", walk)))
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


def simulated_walks(n_people: int, way_m: float) -> tuple[list[PoseWalk], list[PoseWalk]]:
    """Walks of simulated people in all four poses; their pretraining: a third of the way slow, usual and fast."""
    walks: list[PoseWalk] = []
    pretraining: list[PoseWalk] = []
    for number in range(1, n_people + 1):
        slow_to_fast = [Leg("stationary", duration_s=3.0)]
        slow_to_fast += [Leg("walking", distance_m=way_m / 3, frequency_factor=f) for f in (0.85, 1.0, 1.15)]
        pretraining.append(_simulated(number, "texting", slow_to_fast, 900 + number))
        for pose in POSES:
            way = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=way_m)]
            walks.append(_simulated(number, pose, way, number))
    return walks, pretraining


def _simulated(number: int, pose: str, legs: Sequence[Leg], seed: int) -> PoseWalk:
    carrying = {pose: sided(pose, 1.0, np.random.default_rng([seed, POSES.index(pose)]))}
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
    grid_s, place = even_way(recording, 0.02)
    smooth = sosfiltfilt(butter(2, 0.5, fs=50.0, output="sos"), place, axis=0)
    inside = (grid_s >= start_s) & (grid_s <= end_s)
    return float(np.linalg.norm(np.gradient(smooth, 0.02, axis=0), axis=1)[inside].mean())
