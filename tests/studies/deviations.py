"""Effects of deviations from the papers: results of the recipe and of the printed formula.

usage: python -m tests.studies.deviations

A row replaces one formula or parameter of the recipe by that of the paper, or by none where the paper has none. Counts:
mean absolute error of the steps of persons 7 to 13 of ubicomp13, on whom nothing was chosen. Transitions and modes: of
Tian's machine over whole recordings of these persons, in which a phone in a pocket was put there once. Shares of
walking: distance of Martinelli's recipe within these walks, in which everybody walks, by that of the same steps as
walking. Strides: of the foot in pyshoe, by motion capture. Runners are simulated. Headings: held phones in motion
capture. Machines that are trained for a row classify people left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.special import expit
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from models.training import guo2018_training as train_guo
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.rvm import basis_functions
from pdr_filter.evaluate.classification import confusion_matrix, macro_recall
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength
from pdr_filter.recipes import for_recording, martinelli2018, tian2016, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.steps import PoseStepDetector
from pdr_filter.recipes.martinelli2018.features import TABLE_II, WITHOUT_MAGNETOMETER
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.susi2013.contexts import tree_features
from pdr_filter.recipes.susi2013.features import MotionWindow, MotionWindows
from pdr_filter.recipes.tian2016 import heading as tian_heading
from pdr_filter.recipes.tian2016.contexts import TRANS, CarryingMachine, TianContexts
from pdr_filter.recipes.zhou2019 import features as zhou_features
from pdr_filter.recipes.zhou2019 import steps as reference_lines
from pdr_filter.recipes.zhou2019.contexts import CARRIED, BehaviourMemory, BehaviourStage, context_of
from pdr_filter.recipes.zhou2019.features import BehaviourWindow, BehaviourWindows
from pdr_filter.recipes.zhou2019.steps import ReferenceLines, ReferenceLineState, ReferenceLineStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing, track
from pdr_filter.values import (
    BoolArray,
    FloatArray,
    Samples,
    Step,
    WindowContext,
    replace_unchecked,
    steps_of,
    wrap_angle,
)
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, paths, recordings, say, timed
from tests.oracles.rvm_reference import train_plain
from tests.studies import guo2018 as study_guo
from tests.studies import martinelli2018 as study_martinelli
from tests.studies import tian2016 as study_tian
from tests.studies import zhou2019 as study_zhou
from tests.studies.data import NAN, Part, counted_walk, paper_table, people_left_out, place_of, run_study

Row = Mapping[str, object]


def _row(recipe: str, item: str, measure: str, printed: float, here: float) -> Row:
    return {"recipe": recipe, "item": item, "measure": measure, "as printed": printed, "here": here}


# --- counts of steps --------------------------------------------------------------------------------------------------

_COUNT = "steps, mean absolute error %"


def _counted(walk: Recording) -> tuple[float, float, int]:
    """Start, end and number of steps of a walk, from its steps where these are known."""
    steps = walk.truth.steps
    if steps is None:
        return counted_walk(walk)
    return float(steps.time_s[0]), float(steps.time_s[-1]), len(steps)


def count_error(walks: Iterable[Recording], recipe: str, **parts: Any) -> tuple[float, int]:
    """Mean absolute count error in %, and number of steps, of a recipe with other parts (`steps`, `contexts`)."""
    errors, n_found = list[float](), 0
    for walk in walks:
        sensing = replace(for_recording(recipe, walk).sensing, **parts)
        start_s, end_s, n_true = _counted(walk)
        found = [e for e in run_sensing(sensing, walk)[1] if isinstance(e, Step)]
        n = sum(start_s - 0.3 <= s.time_s <= end_s + 0.3 for s in found)
        errors.append(abs(float(count_error_percent(n, n_true))))
        n_found += n
    return float(np.mean(errors)), n_found


# --- Martinelli et al. ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class UnsignedWavelet(WaveletStepDetector):
    """Steps at the maxima of |W|, as printed, instead of those of W."""

    def _response(self, line: FloatArray) -> FloatArray:
        return np.abs(super()._response(line))


def share_of_walking(walks: Sequence[Recording], config: Config) -> tuple[float, float]:
    """Distance by that of the same steps as walking, %: mean, and root mean square of its difference from 100."""
    walking = next(m.step_length for m in config.model.modes if m.context == "walking")
    shares: list[float] = []
    for walk in walks:
        own = track(walk, config)
        start_s, end_s, _ = counted_walk(walk)
        use = (own.time_s >= start_s) & (own.time_s <= end_s)
        all_m = sum(walking.predict(s)[0] for s, u in zip(steps_of(own.steps), use, strict=True) if u)
        shares.append(100.0 * float(own.step_length_m[use].sum()) / all_m)
    return float(np.mean(shares)), float(np.sqrt(np.mean((np.array(shares) - 100.0) ** 2)))


def step_length_m(walks: Sequence[Recording], config: Config, max_variance: float) -> float:
    """Mean length of the steps as walking, m, with a limit of the variance in eq. 12."""
    walking = next(m.step_length for m in config.model.modes if m.context == "walking")
    fit = replace(walking, model=FrequencyVarianceStepLength(max_variance=max_variance))
    lengths: list[float] = []
    for walk in walks:
        start_s, end_s, _ = counted_walk(walk)
        steps = steps_of(track(walk, config).steps)
        lengths += [fit.predict(s)[0] for s in steps if start_s <= s.time_s <= end_s]
    return float(np.mean(lengths))


def recall_of_plain(data: Path, with_bias: bool) -> float:
    """Mean recall in % of people left out, by the literal machines of eq. 4 to 11 with and without a bias term."""
    of = study_martinelli.examples_of(study_martinelli.in_pocket(data), {"2": FeatureWindows(features=TABLE_II)}, 12)[
        "2"
    ]
    classes = np.unique(of.context)
    label, found = list[int](), list[int]()
    for people in study_martinelli.subgroups(of.person):
        is_test = np.isin(of.person, people)
        scaler = StandardScaler().fit(of.rows(~is_test).of(WITHOUT_MAGNETOMETER))
        x = np.asarray(scaler.transform(of.of(WITHOUT_MAGNETOMETER)))
        vectors = x[~is_test][::3]
        design = basis_functions(x, vectors, "rbf", 3.0).T[:, 0 if with_bias else 1 :]
        machines = [train_plain(design[~is_test], (of.context[~is_test] == c).astype(float)) for c in classes]
        prob = np.array([expit(design[is_test][:, m.basis] @ m.mean) for m in machines])
        label += np.searchsorted(classes, of.context[is_test]).tolist()
        found += prob.argmax(axis=0).tolist()
    return 100.0 * float(macro_recall(confusion_matrix(np.array(label), np.array(found), len(classes))))


def of_martinelli(data: Path, walks: Sequence[Recording]) -> Iterator[Row]:
    """Rows of Martinelli et al."""
    row = partial(_row, "martinelli2018")
    here, n_here = count_error(walks, "martinelli2018")
    printed, n_printed = count_error(walks, "martinelli2018", steps=UnsignedWavelet())
    yield row("maxima of the magnitude of W, here of W", _COUNT, printed, here)
    yield row("maxima of the magnitude of W, here of W", "steps found", n_printed, n_here)
    detectors = {
        # the Mexican hat has its largest response at 0.25 periods per sample and scale
        "wavelet of scale 16, here 1.5 Hz": WaveletStepDetector(wavelet_frequency_hz=0.25 * 100.0 / 16.0),
        "no low-pass, here of 4 Hz": WaveletStepDetector(low_pass_hz=45.0),
        "no threshold, here of recent peaks": WaveletStepDetector(min_peak_mps2=0.0, relative_peak=0.0),
    }
    for item, detector in detectors.items():
        yield row(item, _COUNT, count_error(walks, "martinelli2018", steps=detector)[0], here)
    runners = [study_zhou.simulated(person, "running", 200.0) for person in range(1, 7)]
    one_scale = WaveletStepDetector(running_rms_mps2=np.inf)
    printed, here = (count_error(runners, "martinelli2018", **p)[0] for p in ({"steps": one_scale}, {}))
    yield row("one scale, here a second one for running", f"simulated runners: {_COUNT}", printed, here)

    shipped, config = load_model("context_martinelli_rvm"), replace(martinelli2018(), needs=())
    plain = with_context_model(config, replace(shipped, temperature=1.0, slip=0.0))
    blind = replace(config.tracker.model, step_log_odds_stationary=0.0)
    unaided = replace(config, tracker=replace(config.tracker, model=blind))
    mean, spread = share_of_walking(walks, config)
    for item, other in (
        ("probabilities without temperature and slip", plain),
        ("a step no evidence against contexts without steps", unaided),
    ):
        other_mean, other_spread = share_of_walking(walks, other)
        yield row(item, "share of walking %", other_mean, mean)
        yield row(item, "share of walking, RMS from 100 %", other_spread, spread)
    pockets = [w for w in walks if "trousers" in place_of(w)]
    lengths = (100.0 * step_length_m(pockets, config, m) for m in (np.inf, 8.0))
    yield row("variance of eq. 12 unlimited", "trouser pockets: mean step length cm", *lengths)
    recalls = (recall_of_plain(data, with_bias) for with_bias in (False, True))
    yield row("no bias term in eq. 4", "people left out: mean recall %", *recalls)


# --- Tian et al. ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SignedRates(CarryingMachine):
    """Transitions by r > R, as printed, instead of |r| > R."""

    def _moved(self, angular_rate_radps: FloatArray, rate_known: BoolArray) -> BoolArray:
        return super()._moved(np.maximum(angular_rate_radps, 0.0), rate_known)


def blocks_of(recording: Recording) -> Iterator[tuple[UniformBlock, AttitudeBlock]]:
    """Conditioned samples of a recording with their attitude."""
    estimator, conditioner = AttitudeEstimator(), Conditioner()
    state = estimator.init()
    for block in conditioner.update(conditioner.init(), merge_streams(recording))[1]:
        state, attitude = estimator.update(state, block)
        yield block, attitude


def n_transitions(walks: Sequence[Recording], machine: CarryingMachine) -> int:
    """Number of transitions that a machine finds."""
    n = 0
    for walk in walks:
        state = machine.init()
        for block, attitude in blocks_of(walk):
            state, modes = machine.update(state, block.angular_rate_radps, block.angular_rate_known, attitude.up_sensor)
            n += int((np.diff((modes == TRANS).astype(int)) == 1).sum())
    return n


def right_modes_percent(walks: Sequence[Recording], contexts: TianContexts) -> dict[str, float]:
    """Walks of each true mode whose most frequent mode is the true one, %."""
    right: dict[str, list[bool]] = {}
    for walk in walks:
        config = tian2016(walk.subject)
        sensing = replace(config.sensing, contexts=contexts)
        own = study_tian.counted_of(walk, replace(config, sensing=sensing))
        if own is not None:
            right.setdefault(own.true, []).append(own.most == own.true)
    return {mode: 100.0 * float(np.mean(r)) for mode, r in right.items()}


def euler_yaw(specific_force_mps2: FloatArray, attitude: AttitudeBlock) -> FloatArray:
    """Yaw of R = R_z R_x R_y, clockwise: the horizontal direction of the y axis, as `viewing_direction` of the x."""
    f, up = specific_force_mps2, attitude.up_sensor
    level = np.array([0.0, 1.0, 0.0]) - up * up[:, 1:2]
    ahead, right = (f * level).sum(axis=1), (f * np.cross(level, up)).sum(axis=1)
    east, north = attitude.horizontal_mps2.T
    return np.asarray(wrap_angle(np.arctan2(east, north) - np.arctan2(right, ahead)))


def average_of_table_iv(angle_rad: FloatArray) -> float:
    """Mean of yaws after 2 pi is added to negative ones."""
    return float(wrap_angle(np.mean(np.where(angle_rad < 0, angle_rad + 2.0 * np.pi, angle_rad))))


def heading_error_deg(walks: Sequence[Recording]) -> float:
    """Median heading error of the steps."""
    each = [h for w in walks if (h := study_tian.heading_of(w, tian2016(w.subject))) is not None]
    return float(np.median(np.concatenate([h.heading_deg for h in each])))


def of_tian(data: Path, walks: Sequence[Recording]) -> Iterator[Row]:
    """Rows of Tian et al."""
    row, stage = partial(_row, "tian2016"), TianContexts()
    signed = SignedRates(**{f.name: getattr(stage.machine, f.name) for f in fields(stage.machine)})
    numbers = (n_transitions(walks, machine) for machine in (signed, stage.machine))
    yield row("signed rates, here absolute ones", "transitions", *numbers)
    never_again = replace(stage, machine=replace(stage.machine, held_again_s=3.0))
    printed, here = (right_modes_percent(walks, s) for s in (never_again, stage))
    for mode in here:
        yield row("never HOLDING again after HOLDING", f"{mode}: walks of the right mode %", printed[mode], here[mode])
    held = [r for s, p in (("oxiod", "*floor1_handheld*"), ("tyrex", "*_texting*")) for r in recordings(data, s, p)]
    deg = heading_error_deg(held)
    measure = "held phones: median heading error deg"
    for item, name, other in (
        ("Euler yaw, here viewing direction", "viewing_direction", euler_yaw),
        ("average of Table IV, here about the circular mean", "average_angle", average_of_table_iv),
    ):
        with patch.object(tian_heading, name, other):
            yield row(item, measure, heading_error_deg(held), deg)


# --- Zhou et al. ------------------------------------------------------------------------------------------------------


class OneCycle(BehaviourStage):
    """Transitions that last one cycle."""

    def assess(self, memory: BehaviourMemory, window: BehaviourWindow) -> tuple[BehaviourMemory, WindowContext]:
        memory, context = super().assess(memory, window)
        return replace(memory, n_transition=min(memory.n_transition, 1)), context


class TransitionsCount(BehaviourStage):
    """Steps in transitions are counted, whatever the behaviour turns out to be."""

    def assess(self, memory: BehaviourMemory, window: BehaviourWindow) -> tuple[BehaviourMemory, WindowContext]:
        memory, context = super().assess(memory, window)
        return memory, context_of("walking", window.time_s) if memory.n_transition else context


@dataclass(frozen=True, kw_only=True)
class MeanAcceleration(ReferenceLineStepDetector):
    """M6 and M7 with the mean of the acceleration instead of that of its magnitude."""

    def _contact(
        self, state: ReferenceLineState, sample: float, known: int, a_mps2: FloatArray, first: int
    ) -> tuple[ReferenceLineState, Step | None]:
        state, step = super()._contact(state, sample, known, a_mps2, first)
        if step is None:
            return state, None
        end = int(np.floor(sample)) + 1 - first
        mean = float(a_mps2[max(end - round(step.duration_s * self.rate_hz), 0) : end].mean())
        return state, replace_unchecked(step, mean_abs_mps2=max(mean, 0.0))


def right_behaviours_percent(walks: Sequence[Recording], stage: BehaviourStage) -> float:
    """Mean recall in % of standing, walking and running, in windows of one behaviour."""
    names = ("standing", "walking", "running")
    true, found = list[int](), list[int]()
    for walk in walks:
        labels = walk.truth.labels
        assert labels is not None
        for window in run_sensing(Sensing(contexts=stage, steps=reference_lines.CARRIED), walk)[1]:
            if not isinstance(window, WindowContext):
                continue
            inside = (labels["start_s"] <= window.time_s - stage.windows.window_s) & (window.time_s <= labels["end_s"])
            if inside.any():
                context = str(labels["context"][inside][0])  # stairs are walking
                true.append({"stationary": 0, "running": 2}.get(context, 1))
                name = study_zhou.behaviour_of(window)
                found.append(names.index(name) if name in names else len(names))
    return 100.0 * float(macro_recall(confusion_matrix(np.array(true), np.array(found), len(names) + 1)))


def n_outside(walks: Sequence[Recording], **parts: Any) -> int:
    """Number of steps outside the walks."""
    n = 0
    for walk in walks:
        start_s, end_s, _ = counted_walk(walk)
        found = run_sensing(replace(for_recording("zhou2019", walk).sensing, **parts), walk)[1]
        n += sum(isinstance(e, Step) and not start_s - 0.3 <= e.time_s <= end_s + 0.3 for e in found)
    return n


@dataclass(frozen=True, kw_only=True)
class LinesKept(ReferenceLineStepDetector):
    """The reference lines stay after a pause."""

    def _cross(
        self, lines: ReferenceLines, window: FloatArray, state: ReferenceLineState
    ) -> tuple[ReferenceLines, list[float]]:
        after, ends = super()._cross(lines, window, state)
        if after.large_mps2 is None:
            after = replace(after, large_mps2=lines.large_mps2, small_mps2=lines.small_mps2)
        return after, ends


def without_bias(recording: Recording) -> Recording:
    """The recording without the bias of its first second, if the foot stands then."""
    force = recording.accelerometer
    start = force.values[force.time_s < force.time_s[0] + 1.0]
    if np.linalg.norm(start, axis=1).std() > 0.3:
        return recording
    return replace(recording, accelerometer=Samples(force.time_s, force.values - zhou_features.static_bias(start)))


def of_detector(detector: ReferenceLineStepDetector, kind: type[ReferenceLineStepDetector]) -> Any:
    """The detector as another class."""
    return kind(**{f.name: getattr(detector, f.name) for f in fields(detector)})


def strides_percent(trials: Sequence[Recording], detector: ReferenceLineStepDetector) -> float:
    """Mean success of strides on the foot, %."""
    counted = [study_zhou.counted_on_foot(r, detector) for r in trials]
    return float(np.mean([study_zhou.success_percent(c.ours) for c in counted]))


def m6_error_percent(walks: Sequence[study_zhou.Walk]) -> float:
    """Mean absolute error of M6 with parameters of the other walks."""
    return float(np.abs(study_zhou.errors_percent(walks, "M6", study_zhou.without_the_walk(walks))).mean())


def runs_of(people: Sequence[Recording], detector: ReferenceLineStepDetector) -> list[study_zhou.Walk]:
    """Simulated runs with a detector."""
    runs: list[study_zhou.Walk] = []
    for recording in people:
        own = track(recording, for_recording("zhou2019", recording).with_steps(detector))
        found = study_zhou.walk_of(study_zhou.Followed(recording, np.empty(0), own, own))
        runs += [] if found is None else [found]
    return runs


def of_zhou(data: Path, walks: Sequence[Recording]) -> Iterator[Row]:
    """Rows of Zhou et al."""
    row, carried, foot = partial(_row, "zhou2019"), reference_lines.CARRIED, reference_lines.FOOT
    error = partial(count_error, walks, "zhou2019")
    here = error()[0]
    trials = list(recordings(data, "pyshoe"))
    success, strides = strides_percent(trials, foot), "foot: strides, success %"
    level = partial(zhou_features.static_bias, up_sensor=np.array([0.0, 0.0, 1.0]))
    with patch.object(zhou_features, "static_bias", level):
        yield row("bias of a level sensor (eq. 3)", _COUNT, error()[0], here)
        yield row("bias of a level sensor (eq. 3)", strides, strides_percent(trials, foot), success)
    kept, counting = (kind(thresholds=CARRIED) for kind in (BehaviourStage, TransitionsCount))
    apart = BehaviourStage(windows=BehaviourWindows(hop_s=2.0), thresholds=CARRIED)
    people = (study_martinelli.put_together(data, f"s{k:02d}") for k in range(7, 25))
    joined = [r for r in people if r is not None]
    right, recall = right_behaviours_percent(joined, kept), "joined walks: mean recall of behaviours %"
    for item, stage in (
        ("windows follow each other", apart),
        ("transition of one cycle", OneCycle(thresholds=CARRIED)),
    ):
        yield row(item, _COUNT, error(contexts=stage)[0], here)
        yield row(item, recall, right_behaviours_percent(joined, stage), right)
    outside = (n_outside(walks, contexts=stage) for stage in (counting, kept))
    yield row("steps in transitions counted", "steps outside the walks", *outside)
    yield row("FIR of a band of 0.5 Hz, 6.6 s", _COUNT, error(steps=replace(carried, low_pass_s=6.6))[0], here)
    formulas: dict[str, Callable[..., float]] = {
        "small_line_mps2": lambda minimum, large, part=0.0: 2.0 * minimum,
        "median_line_mps2": lambda large, small: 0.25 * (large + small),
    }
    for item, name in (("R_S twice the minimum", "small_line_mps2"), ("R_M without limit", "median_line_mps2")):
        with patch.object(reference_lines, name, formulas[name]):
            yield row(item, _COUNT, error()[0], here)
            yield row(item, strides, strides_percent(trials, foot), success)
    no_limit = [replace(d, min_line_part=1e-6) for d in (carried, foot)]
    yield row("R_S without lower limit", _COUNT, error(steps=no_limit[0])[0], here)
    yield row("R_S without lower limit", strides, strides_percent(trials, no_limit[1]), success)
    yield row("bias removed for the steps", strides, strides_percent([without_bias(r) for r in trials], foot), success)
    yield row("lines kept after a pause", _COUNT, error(steps=of_detector(carried, LinesKept))[0], here)
    each = (replace(d, min_period_part=1e-6) for d in (carried, foot))
    yield row("each fall through R_S an event", _COUNT, error(steps=next(each))[0], here)
    yield row("each fall through R_S an event", strides, strides_percent(trials, next(each)), success)
    people = [study_zhou.simulated(person, "running", 200.0) for person in range(1, 7)]
    errors = (m6_error_percent(runs_of(people, d)) for d in (of_detector(carried, MeanAcceleration), carried))
    yield row("M6 by the mean of the acceleration", "simulated runners: error of the distance %", *errors)


# --- Guo et al. -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class BelowMean(PoseStepDetector):
    """Maxima above mu - 0.45 sigma, as the sign of eq. 8 is printed, instead of mu + 0.45 sigma."""

    @property
    def _thresholds(self) -> tuple[float, float, float, float]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return -self.texting, -self.calling, -self.pocket, -self.swinging


def deep_forest(z: FloatArray, y: Any, weight: FloatArray) -> tuple[Forest, tuple[str, ...]]:
    """The usual random forest: 100 trees, the square root of the features at each split, leaves of one window."""
    fitted = RandomForestClassifier(100, random_state=0, n_jobs=1).fit(z, y, sample_weight=weight)
    return Forest.from_sklearn(fitted), tuple(map(str, fitted.classes_))


def of_guo(data: Path, walks: Sequence[Recording]) -> Iterator[Row]:
    """Rows of Guo et al."""
    row = partial(_row, "guo2018")
    error = partial(count_error, [w for w in walks if "hand" in w.name], "guo2018")
    (printed, n_printed), (here, n_here) = error(steps=BelowMean()), error()
    yield row("eq. 8 with minus, here plus", _COUNT, printed, here)
    yield row("eq. 8 with minus, here plus", "steps found", n_printed, n_here)
    recalls: list[float] = []
    for plan in (replace(train_guo.PLAN, machine_fit=deep_forest), train_guo.PLAN):
        with patch.object(train_guo, "PLAN", plan):
            poses = study_guo.classified_poses(data)
        recalls.append(NAN if poses is None else 100.0 * float(macro_recall(poses.confusion())))
    yield row("100 full trees, here 30 with large leaves", "people left out: mean recall %", *recalls)
    any_hz = PoseStepDetector(max_step_hz=10.0)
    yield row("no limit of the step frequency, here 3 Hz", _COUNT, error(steps=any_hz)[0], here)


# --- Susi et al. ------------------------------------------------------------------------------------------------------


def printed_features(window: MotionWindow) -> FloatArray:
    """Energies, variances and dominant frequencies of both norms (10,), the first four in logarithms."""
    return np.concatenate([np.log(np.maximum(window.features[:4], 1e-4)), window.features[4:]])


def labelled_windows(walks: Iterable[Recording]) -> tuple[list[MotionWindow], list[bool]]:
    """Windows that are not static, with True inside the walk and False more than 1 s from it."""
    found, is_walk = list[MotionWindow](), list[bool]()
    stage = MotionWindows()
    for walk in walks:
        start_s, end_s, _ = counted_walk(walk)
        state = stage.init()
        for block, attitude in blocks_of(walk):
            state, windows = stage.update(state, block, attitude)
            for _, window in windows:
                inside = window.start_s >= start_s and window.time_s <= end_s
                outside = window.start_s > end_s + 1.0 or window.time_s < start_s - 1.0
                is_static = window.features[2] < 0.05 and window.features[3] < 0.03
                if (inside or outside) and not is_static:
                    found.append(window)
                    is_walk.append(inside)
    return found, is_walk


def of_susi(data: Path, walks: Sequence[Recording]) -> Iterator[Row]:
    """Rows of Susi et al."""
    names = {w.name for w in walks}
    places = ("hand_held", "handheld_using", "backpack")
    own = [r for r in recordings(data, "ubicomp13") if place_of(r) in places]
    train, train_label = labelled_windows(r for r in own if r.name not in names)
    test, label = labelled_windows(r for r in own if r.name in names)
    recalls: list[float] = []
    for features in (printed_features, tree_features):
        model = make_pipeline(StandardScaler(), LogisticRegression(class_weight="balanced", max_iter=1000))
        model.fit([features(w) for w in train], train_label)
        found = np.asarray(model.predict([features(w) for w in test]), dtype=int)
        recalls.append(100.0 * float(macro_recall(confusion_matrix(np.array(label, dtype=int), found, 2))))
    item = "the printed features, here those of the tree"
    yield _row("susi2013", item, "walking or irregular: mean recall %, one linear test of each", *recalls)


# --- table ------------------------------------------------------------------------------------------------------------


# Rows of each recipe, and the data sets that they need besides ubicomp13.
RECIPES: Mapping[Callable[[Path, Sequence[Recording]], Iterator[Row]], tuple[str, ...]] = {
    of_martinelli: ("motionsense",),
    of_tian: ("oxiod", "tyrex"),
    of_zhou: ("motionsense", "pyshoe"),
    of_guo: train_guo.DATASETS,
    of_susi: (),
}


def effects(tables: Tables, arguments: argparse.Namespace) -> None:
    """Measures as printed, and here."""
    walks = list(people_left_out(arguments.data))
    rows: list[Row] = []
    for of_recipe, sets in RECIPES.items():
        if missing := [name for name in sets if not paths(arguments.data, name)]:
            say(f"{of_recipe.__name__} is left out: no recordings of {', '.join(missing)}")
            continue
        with timed(of_recipe.__name__):
            rows += of_recipe(arguments.data, walks)
    title = "Effects of deviations from the papers"
    paper_table(
        tables,
        "deviations",
        title,
        rows,
        f"ubicomp13, persons 7 to 13, {len(walks)} walks, unless the measure names others",
    )


if __name__ == "__main__":
    others = tuple(dict.fromkeys(name for sets in RECIPES.values() for name in sets))
    # Persons 7 to 13 of ubicomp13 are scored by a test that is fitted to at least one of persons 1 to 6.
    run_study(__doc__, Part(make=effects, needs=("ubicomp13",), uses=others, min_people=8))
