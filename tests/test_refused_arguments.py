"""Constructors and calls refuse wrong arguments with a message that names the argument or the remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import mode_of_each_context

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.classifiers.familiarity import Familiarity
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.evaluate import classification, consistency, distance, latex, steps, tracks
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.imm import check_transition_prob, smoothed_mode_prob
from pdr_filter.filter.imm.motion_model import Mode, MotionNoise
from pdr_filter.filter.imm.weighting import weighted_distances
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.person import Session
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength, StepLengthFit, known_length
from pdr_filter.imm import JumpMarkovModel
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.recipes.guo2018.features import PoseWindows, pose_features
from pdr_filter.recipes.guo2018.steps import PoseStepDetector
from pdr_filter.recipes.martinelli2018.features import NAMES as MARTINELLI_NAMES
from pdr_filter.recipes.martinelli2018.features import TABLE_II
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.susi2013.features import MotionWindows
from pdr_filter.recipes.susi2013.steps import NormMinimaStepDetector
from pdr_filter.recipes.tian2016.contexts import CarryingMachine, TianContexts
from pdr_filter.recipes.tian2016.heading import OffsetCompensation
from pdr_filter.recipes.tian2016.steps import TianStepDetector
from pdr_filter.recipes.zhou2019.contexts import BehaviourStage
from pdr_filter.recipes.zhou2019.features import BehaviourWindows
from pdr_filter.recipes.zhou2019.steps import CARRIED, FOOT
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner
from pdr_filter.sensing.contexts.irregular_motion import irregular_prob
from pdr_filter.sensing.features.barometer import ClimbRate, climb_log_evidence
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.features.invariant import WITHOUT_GYROSCOPE
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.gyroscope_bias import GyroBias
from pdr_filter.sensing.signal_filters import butterworth
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.sensing.vehicle_vibration import VehicleVibration
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import (
    HeadingDrift,
    HeadingFix,
    Origin,
    PositionFix,
    Samples,
    SpeedFix,
    Standstill,
    Wifi,
    as_floats,
)
from pdr_filter.values.georeference import Georeference

NAN, INF = np.nan, np.inf
EYE, ZEROS = np.eye(2), np.zeros(2)
HERE = (48.0, 11.0)

# --- calls whose other arguments are right ----------------------------------------------------------------------------

a_heading = partial(HeadingFix, time_s=1.0, walking_heading_rad=0.0, std_rad=0.1)
a_rate = partial(climb_log_evidence, climb_rate_mps=0.1, std_mps=0.1)
a_transition = partial(check_transition_prob, n=2)
a_table = partial(classification.confusion_matrix, label=np.zeros(1, int), predicted=np.zeros(1, int), n_classes=2)
scores = partial(steps.step_scores, true_s=ZEROS[:1], found_s=ZEROS[:1])
a_speed = partial(SpeedFix, time_s=1.0, speed_mps=1.0, std_mps=0.1)
a_position = partial(PositionFix, time_s=1.0, position_m=ZEROS, cov_m2=EYE)
a_place = partial(PositionFix.from_lat_lon, 7.0, *HERE, HERE)
a_range = partial(pdr.RangeFix, time_s=1.0, anchor_m=np.ones(2), range_m=1.0, std_m=1.0)
a_wifi = partial(Wifi, time_s=ZEROS[:1], bssid=np.zeros(1, dtype=int), rssi_dbm=ZEROS[:1], frequency_mhz=ZEROS[:1])
an_origin = partial(Origin, *HERE)
a_mode = partial(Mode, "walk", "walking", known_length(1.0, 0.1))
a_fit = partial(StepLengthFit, FrequencyVarianceStepLength(), theta=np.ones(3), theta_cov=np.eye(3), residual_std_m=0.1)
a_jump_model = partial(
    JumpMarkovModel, F=np.ones((2, 1, 1)), Q=np.ones((2, 1, 1)), H=[[1.0]], R=[[1.0]], transition_prob=EYE
)
an_imm_filter = partial(a_jump_model().filter, z=np.zeros((5, 1)), mean=[0.0], cov=[[1.0]])
a_familiarity = partial(Familiarity, axes=EYE, variance=np.ones(2), limit=1.0)
a_regression = partial(SoftmaxRegression, weights=np.zeros((2, 3)), intercept=ZEROS)
nees = partial(consistency.nees, np.zeros((3, 2)))
RECORDING = simulate([Leg("walking", distance_m=10.0)], seed=1)
A_FIX = PositionFix(5.0, ZEROS, EYE)
A_WALK = [Leg("walking", duration_s=5)]
A_LINE = np.cumsum(np.ones((5, 2)), axis=0)


@cache
def config() -> pdr.Config:
    return recipes.default()


def a_model(**changed: Any) -> PedestrianModel:
    return replace(PedestrianModel(mode_of_each_context(), np.eye(6)), **changed)


def walking_mode(length_m: float) -> Mode:
    fit = StepLengthFit(FrequencyVarianceStepLength(), np.array([length_m, 0.0, 0.0]), np.zeros((3, 3)), 0.05)
    return replace(next(mode for mode in config().model.modes if mode.context == "walking"), step_length=fit)


def a_filter() -> pdr.OnlineFilter:
    return pdr.OnlineFilter(config())


def relevance_vectors(**changed: Any) -> RelevanceVectors:
    basis, weights = np.array([[0], [1]]), np.array([[1.0], [2.0]])
    good = RelevanceVectors("rbf", 1.0, np.zeros((1, 3)), basis, weights, np.zeros((2, 1, 1)))
    return RelevanceVectors.from_arrays(good.to_arrays() | changed)


def fitted(sample_weight: Any = None, **settings: Any) -> RelevanceVectorClassifier:
    X = np.random.default_rng(0).normal(size=(60, 2))  # noqa: N806
    return RelevanceVectorClassifier(**settings).fit(X, np.repeat([0, 1, 2], 20), sample_weight=sample_weight)


def pressure(values: Any) -> object:
    return ClimbRate().update(ClimbRate().init(), np.arange(300) / 10, np.asarray(values))


# --- what is refused --------------------------------------------------------------------------------------------------

Refusal = tuple[Callable[..., Any], dict[str, Any], str]  # a call, its wrong arguments, and a part of the message


def of(call: Callable[..., Any], message: str, **wrong: Iterable[Any]) -> list[Refusal]:
    """One row for each wrong value of each argument."""
    return [(call, {name: value}, message) for name, values in wrong.items() for value in values]


SENSING: list[Refusal] = [
    *of(
        ClimbRate,
        "must be",
        hop_s=(0.0, 5.0),
        window_s=(INF,),
        max_gap_s=(0.0,),
        noise_hpa=(0.0,),
        temperature_c=(288.15,),
    ),
    *of(a_rate, "must be finite", climb_rate_mps=(NAN, INF), std_mps=(-1.0, NAN)),
    (pressure, {"values": np.full(300, 1e5)}, "must be Pa, not hPa: divide by 100"),
    (pressure, {"values": np.full(300, 100.0)}, "kPa.*by 10"),
    (pressure, {"values": np.full((300, 1), 1e3)}, r"values\[:, 0\]"),
    (
        irregular_prob,
        {"names": MARTINELLI_NAMES, "features": np.zeros(28), "has_gyroscope": True},
        "log_swing.*use windows with .*ATTITUDE",
    ),
    (irregular_prob, {"names": WITHOUT_GYROSCOPE, "features": np.zeros(99), "has_gyroscope": True}, "log_swing"),
    (FeatureWindows, {"features": TABLE_II, "window_s": 1.0, "hop_s": 2.0}, "hop_s must be positive and at most"),
    *of(StepGate, "must be", rate_hz=(0.0, 60.0), mean_walk_s=(0.0,), mean_pause_s=(-1.0,), min_steps=(0,)),
    (GyroBias, {"prior_std_radps": (0.01,)}, "must be"),
    (GyroBias, {"prior_std_radps": (), "prior_prob": ()}, "must be"),
    (GyroBias, {"prior_std_radps": (0.002, -0.01, 0.05)}, "must be"),
    (GyroBias, {"window_s": 0.0}, "must be"),
    (GyroBias, {"straight_s": (10.0, 4.0)}, "must be"),
    (GyroBias, {"straight_s": (4.0,)}, "must be"),
    *of(Conditioner, "must be positive", rate_hz=(0.0,), max_gap_s=(-1.0,), hop_samples=(0,)),
    (pdr.Device, {"bias_radps": np.array([0.0, NAN, 0.0])}, "bias_radps"),
    (pdr.Device, {"bias_radps": np.zeros(3), "bias_cov_radps2": -np.eye(3)}, "positive definite"),
    (pdr.Device().after, {"days": -1}, "days"),
    (butterworth, {"order": 2, "cutoff_hz": 50.0, "rate_hz": 100.0}, "below half the rate"),
    (Sensing, {"steps": WaveletStepDetector(), "attitude": AttitudeEstimator(rate_hz=50.0)}, "one rate_hz"),
    *of(VehicleVibration, "rate_hz", rate_hz=(0.0, 60.0)),
    (Samples, {"time_s": ZEROS, "values": [["a"], ["b"]]}, "^values must be"),
    (Samples, {"time_s": ZEROS, "values": [[object()], [1.0]]}, "^values must be"),
    (Samples, {"time_s": ZEROS, "values": [[1.0, 2.0], [3.0]]}, "^values must be"),
    (as_floats, {"values": np.zeros(3, dtype=complex), "name": "a"}, "a must be real numbers, got complex128"),
]
FIXES: list[Refusal] = [
    (a_heading, {"time_s": NAN}, "time_s of a fix must be finite"),
    (a_heading, {"walking_heading_rad": INF}, "walking_heading_rad must be finite"),
    (
        a_heading,
        {"walking_heading_rad": 30.0},
        r"heading_rad must be in radians .*got 30.0: .*np.deg2rad\(30.0",
    ),
    (Georeference, {"heading_rad": 90.0}, r"heading_rad must be in radians .*got 90.0: .*np.deg2rad\(90.0"),
    *of(a_heading, "std_rad must be a number from", std_rad=(0.0, 1e200)),
    (a_heading, {"received_time_s": 0.5}, "received_time_s not before time_s"),
    (a_speed, {"speed_mps": 0.0}, "give a Standstill"),
    (a_speed, {"speed_mps": "1.5"}, "speed_mps of SpeedFix"),
    *of(a_speed, "std_mps must be a number from", std_mps=(NAN, 1e200)),
    (Standstill, {"time_s": 2.0, "end_s": 2.0}, "must be finite and after its time_s"),
    (a_position, {"position_m": np.array([NAN, 0.0])}, "position_m must be"),
    *of(a_position, "position_m", position_m=((1e15, 0.0), (INF, 0.0))),
    (a_position, {"correlation_s": -1.0}, "correlation_s must be 0 or more"),
    *of(a_position, "floor must be a whole number", floor=(1.5, NAN)),
    *of(a_position, "floor", floor=(INF, "first")),
    (a_position, {"altitude_m": 5.0}, "must be given together"),
    (a_position, {"altitude_m": INF, "altitude_std_m": 1.0}, "must be finite"),
    (a_position, {"altitude_m": 5.0, "altitude_std_m": 0.0}, "give a positive one"),
    *((a_position, {"cov_m2": var * EYE}, "cov_m2") for var in (1e-300, 1e200, 0.0, NAN)),
    *((a_place, {"accuracy_m": std}, "accuracy_m must be a number from") for std in (1e-300, 1e200, 0.0, INF, NAN)),
    (a_place, {}, "either std_m .* or accuracy_m"),
    (a_place, {"std_m": 1.0, "accuracy_m": 1.0}, "either std_m .* or accuracy_m"),
    (a_place, {"std_m": NAN}, r"std_m must be a number from .* got nan"),
    (partial(PositionFix.from_lat_lon, 7.0, 91.0, 0.0, HERE), {"std_m": 1.0}, r"a fix must be \(latitude, longitude\)"),
    (partial(PositionFix.from_lat_lon, 7.0, NAN, 0.0, HERE), {"std_m": 1.0}, r"a fix must be \(latitude, longitude\)"),
    *of(a_range, "anchor_m", anchor_m=((1.0,), (1.0, NAN))),
    (a_range, {"range_m": -1.0}, "range_m"),
    (a_range, {"std_m": 0.0}, "std_m"),
    (a_range, {"std_m": INF}, "std_m must be a number from 1e-12 to"),
    (Origin, {"latitude_deg": 91.0, "longitude_deg": 0.0}, "check the order of the two"),
    (Origin, {"latitude_deg": 0.0, "longitude_deg": 181.0}, "check the order of the two"),
    (Origin, {"latitude_deg": NAN, "longitude_deg": 0.0}, "check the order of the two"),
    (Origin, {"latitude_deg": "48", "longitude_deg": 11.0}, "origin"),
    (Origin, {"latitude_deg": 48.0, "longitude_deg": None}, "origin"),
    (an_origin, {"height_m": "520"}, "origin"),
    (an_origin, {"height_m": INF}, "leave it out if it is not known"),
    (an_origin, {"turn_rad": NAN}, "leave it out if it is not known"),
    (an_origin, {"turn_rad": 1.0, "turn_std_rad": -1.0}, "leave it out if it is not known"),
    (an_origin, {"turn_std_rad": 0.1}, "give both"),
    *((Origin.of, {"place": p}, "must be") for p in (5, None, "ab", (1.0, 2.0, 3.0), ("48", "x"), (None, 11.0))),
    (Georeference, {"gnss": "on"}, r"gnss must be one of \('filter', 'align', 'off'\), got 'on'"),
    (Georeference, {"north": "south"}, "north must be one of .*'magnetic'.*got 'south'"),
    (Georeference, {"origin": HERE, "plan": pdr.FloorPlan("", (), Origin(1.0, 2.0))}, "both define the frame"),
    (Georeference, {"start": "hall"}, "start is a position on a floor plan, got 'hall' without plan"),
    (Georeference, {"gnss": "align", "north": "magnetic"}, "both define north"),
    (Georeference, {"heading_rad": 0.1, "north": "magnetic"}, "both define north"),
    (Georeference, {"origin": Origin(*HERE, turn_rad=0.3), "north": "magnetic"}, "both define north"),
    (Georeference, {"heading_rad": 0.1, "origin": Origin(*HERE, turn_rad=0.1)}, "define the same angle: leave one"),
    (a_wifi, {"time_s": ZEROS}, "give equal lengths"),
    (a_wifi, {"bssid": np.array([1 << 48])}, "48 bits"),
    *of(
        a_wifi, "bssid must be whole numbers", bssid=(np.array([1.5]), np.array([NAN]), np.array(["06:74:9c:2e:95:ea"]))
    ),
]
FILTER: list[Refusal] = [
    *of(a_transition, "transpose", transition_prob=(np.array([[0.9, 0.3], [0.1, 0.7]]),)),
    *of(a_transition, "rows", transition_prob=np.array([[[1.1, -0.1], [0.5, 0.5]], [[NAN, 1.0], [0.5, 0.5]]])),
    *of(a_transition, "must be", transition_prob=(np.ones((1, 2)) / 2, np.eye(4))),
    (smoothed_mode_prob, {"mode_prob": EYE, "transition_prob": EYE, "lag": -1}, "lag is a number of steps .*got -1"),
    (a_jump_model, {"F": np.eye(1)}, r"F must be \(M, n, n\).*np.stack"),
    (a_jump_model, {"Q": np.ones((1, 1, 1))}, r"Q must have the shape \(2, 1, 1\).*a matrix for each mode"),
    (a_jump_model, {"R": [[NAN]]}, "R must contain finite numbers"),
    (a_jump_model, {"transition_prob": [[0.5, 0.2], [0.1, 0.9]]}, "must sum to 1"),
    (a_jump_model, {"F": [np.eye(2), np.eye(1)]}, "F must have matrices of one size.*rows and columns of zeros"),
    (a_jump_model, {"R": 0.01}, r"R must have the shape \(2, 1, 1\).* or \(1, 1\) for all modes, got \(\)"),
    (a_jump_model, {"Q": -np.ones((2, 1, 1))}, "Q must have no negative eigenvalue"),
    (an_imm_filter, {"z": np.zeros(5)}, r"z must have the shape \(T, ..., 1\).*z\[:, None\]"),
    (an_imm_filter, {"z": [[0.0], [np.inf]]}, "z must contain finite numbers or NaN, got inf: replace inf by NaN"),
    (an_imm_filter, {"z": np.zeros((5, 2))}, "put the values last"),
    (an_imm_filter, {"mean": [[0.0], [1.0]]}, r"mean must have the shape \(1,\), got \(2, 1\): give one state"),
    (an_imm_filter, {"cov": 1.0}, r"cov must have the shape \(1, 1\), got \(\)"),
    (an_imm_filter, {"cov": [[-1.0]]}, "cov must have no negative eigenvalue"),
    (an_imm_filter, {"mode_prob": [0.5, 0.3, 0.2]}, "mode_prob must be 2 probabilities that sum to one"),
    (an_imm_filter, {"mode_prob": [1.5, -0.5]}, "mode_prob must be 2 probabilities that sum to one"),
    (an_imm_filter, {"mode_prob": [0.9, 0.3]}, "divide by the sum"),
    (a_fit, {"theta": ZEROS}, "theta"),
    (a_fit, {"theta": np.array([1.0, NAN, 0.0])}, r"theta must be \(3,\), finite"),
    (a_fit, {"theta_cov": -np.eye(3)}, "theta_cov must have no negative eigenvalue"),
    *of(a_fit, "theta_cov must be", theta_cov=(np.eye(3) * NAN, np.triu(np.ones((3, 3))))),
    (
        PedestrianModel,
        {"modes": (replace(a_mode(), context="flying", name="fly"),), "transition_prob": 1},
        "context of mode",
    ),
    (a_mode, {"carrying_mode": "hat"}, r"carrying_mode of mode 'walk'.*hat"),
    (a_mode, {"extra_noise_m": -1.0}, r"extra_noise_m of Mode must be 0 or more .*, got -1"),
    (a_mode, {"heading_std_rad": NAN}, r"heading_std_rad of Mode must be 0 or more .*, got nan"),
    (Mode, {"name": "up", "step_length": 0.7}, r"step_length of mode 'up' must be a StepLengthFit, got 0\.7.*known"),
    (Mode, {"name": "up", "climbs": 2}, "climbs of 'up' must be"),
    (Mode, {"name": "up", "gait": "flying"}, "gait of 'up' must be"),
    (MotionNoise, {"log_scale_std": NAN}, r"log_scale_std of MotionNoise must be 0 or more .*, got nan"),
    (MotionNoise, {"gap_speed_mps": -1.0}, r"gap_speed_mps of MotionNoise must be 0 or more .*, got -1"),
    (HeadingDrift, {"bias_correlation_s": -1.0}, "bias_correlation_s of HeadingDrift must be"),
    (a_model, {"modes": (mode_of_each_context()[0],) * 6}, "distinct"),
    (a_model, {"transition_prob": np.eye(5)}, "transition_prob"),
    (a_model, {"modes": (), "transition_prob": np.empty((0, 0))}, "modes is empty"),
    (a_model, {"transition_prob": np.full((6, 6), NAN)}, "must sum to 1"),
    (a_model, {"transition_prob": np.eye(6)[[0, 0, 0, 1, 2, 3]].T}, "transpose the matrix"),
    (a_model, {"evidence_exponent": NAN}, "evidence_exponent of PedestrianModel must be 0 or more .*, got nan"),
    (a_model, {"evidence_floor": -0.1}, "evidence_floor of PedestrianModel must be 0 or more"),
    (a_model, {"step_log_odds_stationary": INF}, "step_log_odds_stationary of PedestrianModel must be finite"),
    (WeightedTracker, {"model": PedestrianModel(mode_of_each_context()[:5], np.eye(5))}, "exactly one mode"),
    (WeightedTracker, {"model": a_model(), "threshold": NAN}, "threshold of WeightedTracker must be 0 or more .*nan"),
    (partial(weighted_distances, np.zeros((5, 6))), {"context_prob": np.ones((5, 6)) / 6, "threshold": 0.8}, "one row"),
    *of(partial(known_length, std_m=0.05), "in metres|must be positive", length_m=(70, 5.0, 0.0, -0.7, NAN)),
    (known_length, {"length_m": 0.7, "std_m": 5.0}, "in metres"),
    *of(partial(Session, std=0.02, n_fixes=3), "metres|positive", step_length_m=(70.0, 5.0, 0.0, -0.7, NAN)),
    *of(walking_mode, "typical step length of mode 'walking' .* step lengths are in metres", length_m=(70.0, 5.0)),
]
EVALUATE: list[Refusal] = [
    (a_table, {"predicted": np.array([2])}, "predicted must be"),
    (a_table, {"label": np.array([-1])}, "label must be"),
    (a_table, {"label": np.zeros(2, int)}, "same length"),
    (classification.class_table, {"confusion": np.eye(3, dtype=int), "classes": ("a", "b")}, "for the given classes"),
    *((nees, {"cov": np.array([EYE, cov, EYE])}, "cov must") for cov in (0 * EYE, -EYE, np.ones((2, 2)))),
    *((partial(consistency.mean_bounds, 2, 50), {"prob": p}, "between 0 and 1") for p in (95, 0.0, 1.0, NAN)),
    (partial(consistency.ellipse_coverage, ZEROS[None], EYE[None]), {"prob": 95}, "between 0 and 1"),
    (distance.percent_error, {"estimate_m": [1.0], "true_m": [0.0]}, "true_m must be positive"),
    (partial(distance.distance_table, [1.0, 2.0], [1.0, 1.0]), {"context": ["walking"]}, "one value for each"),
    (steps.count_error_percent, {"n_found": 3, "n_true": 0}, "n_true must be positive"),
    (
        partial(steps.matched_steps, ZEROS, np.array([2.0, 1.0])),
        {"tolerance_s": 0.25},
        "found_s must be ascending",
    ),
    (scores, {"found_s": np.array([NAN])}, "found_s must be ascending without NaN"),
    *of(scores, "tolerance_s", tolerance_s=(-0.1, NAN)),
    (partial(tracks.end_error_percent, A_LINE), {"reference_m": 0 * A_LINE}, "path length of zero"),
    (partial(tracks.aligned, A_LINE, A_LINE), {"align": "some"}, "none, origin, first or all"),
    (partial(tracks.aligned, A_LINE[1:]), {"reference_m": A_LINE}, "same shape"),
    (partial(tracks.relative_error_m, A_LINE, A_LINE), {"n_ahead": 5}, "n_ahead"),
    (partial(latex, [{"a": 1.0}]), {"label": "tab:a"}, "needs a caption"),
]
CLASSIFIERS: list[Refusal] = [
    *of(
        a_familiarity,
        "must be",
        limit=(0.0,),
        variance=(np.ones(3), ZEROS),
        axes=(np.full((2, 2), NAN),),
        usual=(0.0,),
        centre=(np.array([INF, 0.0]),),
    ),
    *of(a_regression, "must be", intercept=(np.zeros(3),), weights=(np.full((2, 3), NAN),)),
    (a_regression().predict_proba, {"X": [[NAN, 0.0, 0.0]]}, "feature 0 is nan in row 0"),
    (fitted, {"kernel": "poly"}, "kernel must be"),
    *of(fitted, "kernel_width", kernel_width=(-1.0, "scale")),
    (fitted, {"multi_class": "ovo"}, "multi_class"),
    (fitted, {"max_samples": 0}, "max_samples"),
    (fitted, {"max_basis": 0}, "max_basis"),
    (fitted, {"max_iter": 0}, "max_iter"),
    (fitted, {"tol": 0.0}, "tol"),
    *of(fitted, "class_weight", class_weight=("even", 2.0, {0: -1.0})),
    *of(fitted, "sample_weight", sample_weight=(np.full(60, NAN), -np.ones(60), np.zeros(60), np.ones(59))),
    (RelevanceVectorClassifier().fit, {"X": np.eye(3), "y": ["walking"] * 3}, "at least two classes, got one class"),
    (relevance_vectors, {"kernel": np.array("poly")}, "kernel"),
    (relevance_vectors, {"width": np.array(0.0)}, "width"),
    *of(relevance_vectors, "basis must hold", basis=(np.array([[0], [99]]), np.array([[0], [-1]]))),
    (relevance_vectors, {"basis": np.array([[0.0], [1.0]])}, "integers"),
    (relevance_vectors, {"weights": np.array([[1.0], [NAN]])}, "finite"),
    (relevance_vectors, {"weights": np.array([[1.0, 2.0]])}, "K > 1"),
    (relevance_vectors, {"cov_factor": np.zeros((2, 2, 2))}, "shapes"),
    (relevance_vectors, {"link": np.array("probit")}, "link"),
]
RECIPES: list[Refusal] = [
    *((pose_features, {"window": np.zeros(shape)}, "rows") for shape in ((1, 60), (3, 60), (5, 60), (2, 0), (60,))),
    (PoseWindows, {"hop_s": 0.7}, "hop_s"),
    (PoseStepDetector, {"max_interval_s": 0.3, "max_step_hz": 2.0}, "longer than a step at max_step_hz"),
    (PoseStepDetector, {"statistics_s": 0.01}, "at least three samples"),
    *of(MotionWindows, "must be", rate_hz=(30.0,), hop_s=(3.0, 0.0), low_pass_hz=(0.0,)),
    *of(NormMinimaStepDetector, "low_pass_hz.* must be", low_pass_hz=(0.0, 50.0)),
    (partial(TianContexts, CarryingMachine(rate_hz=50.0)), {"steps": TianStepDetector(rate_hz=100.0)}, "rate_hz"),
    (OffsetCompensation, {"n_swing": 0}, "must be"),
    (OffsetCompensation, {"n_pocket": 3, "n_omit": 2}, "must be"),
    (OffsetCompensation, {"n_omit": -1}, "must be"),
    (partial(BehaviourStage, BehaviourWindows(hop_s=0.7)), {"thresholds": FOOT}, "multiple of hop_s"),
    *of(BehaviourWindows, "must be", hop_s=(3.0,), static_s=(2.5, 0.0), low_pass_hz=(50.0,)),
    *of(
        partial(replace, CARRIED),
        "must be",
        steps_per_event=(0,),
        walking=(replace(CARRIED.walking, min_frequency_hz=3.0),),
        running=(replace(CARRIED.running, cutoff_hz=60.0),),
    ),
    (recipes.default, {"classifier": "svm"}, r"classifier must be one of \('blend', 'rvm', 'forest', 'boosted'\), got"),
    (config().with_weighting, {"weighting": "best"}, r"weighting must be one of \('hc', 'wc', 'imm'\) or a function"),
    (config().with_contexts, {"model": None, "modes": []}, "must be a ContextStage .* got NoneType without .*contexts"),
    (pdr.OnlineFilter(replace(config(), keeps_path=False)).path, {}, "keeps_path of the configuration is False: use"),
    (pdr.OnlineFilter(plan=pdr.FloorPlan("hall", storeys=())).path, {}, "with a floor plan"),
    (config().with_handler, {"add": 5}, "takes a handler, got 5: give"),
]
SIMULATE: list[Refusal] = [
    (Leg, {"context": "flying", "duration_s": 1.0}, "context must be one of"),
    (Leg, {"context": "treadmill", "duration_s": 9.0}, "simulate a movement that is like it, and rename the labels"),
    (Leg, {"context": "walking"}, "either duration_s or distance_m"),
    (Leg, {"context": "walking", "duration_s": 1.0, "distance_m": 1.0}, "either duration_s or distance_m"),
    (Leg, {"context": "stationary", "distance_m": 1.0}, "give its duration_s"),
    (Leg, {"context": "walking", "duration_s": -1.0}, "duration_s of a leg must be positive and finite"),
    (Leg, {"context": "walking", "duration_s": 1.0, "turn_rad": NAN}, "turn_rad of a leg must be finite"),
    (simulate, {"legs": []}, "legs is empty"),
    (simulate, {"legs": A_WALK, "carrying_mode": "hat"}, "carrying_mode must be one of"),
    (simulate, {"legs": A_WALK, "rate_hz": 5}, "rate_hz must be from 20 to 500"),
    (simulate, {"legs": [Leg("running", duration_s=5, frequency_factor=0.1)]}, "use a factor closer to 1"),
    (Gait, {"height_m": 175.0}, "metres"),
    *of(Gait, "metres|positive|0 or more", length_factor=(100.0, 0.0), frequency_std=(-1.0,)),
]
TAKERS = (pdr.track, pdr.detect_steps, pdr.classify, pdr.smooth)
WITH_RECORDING = [partial(taker, RECORDING) for taker in TAKERS]
of_track, *_, of_smoothing = WITH_RECORDING
HEIGHTS = (175, 0.0, -1.7, NAN, "1.8", True)
NO_RECORDING = r"recording must be a Recording, .* pdr_filter\.read"
NO_PLAN = r"plan must be a FloorPlan, got 'mall\.geojson': read one .* pdr_filter\.FloorPlan\.read"
FACES: list[Refusal] = [
    *(row for call in TAKERS for row in of(call, NO_RECORDING, recording=("walk.zip", Path("walk.zip"), None))),
    (pdr.calibrate, {"recordings": "walk.zip"}, r"recording must be a Recording, got 'walk\.zip'"),
    *(
        row
        for call in (*WITH_RECORDING, pdr.OnlineFilter)
        for row in of(call, "config must be a Config", config=("default", recipes.default))
    ),
    *of(pdr.OnlineFilter, "height_m must be the height of a person in metres", height_m=HEIGHTS),
    *of(lambda height_m: pdr.track(RECORDING.of_height(height_m)), "height_m", height_m=HEIGHTS),
    *of(partial(pdr.batch.track, [], out="never.csv"), "height_m", height_m=HEIGHTS),
    (recipes.default, {"subject": 1.8}, r"subject must be a Subject, got 1\.8"),
    *((call, {"plan": "mall.geojson"}, NO_PLAN) for call in (of_track, of_smoothing, pdr.OnlineFilter)),
    *((call, {"fixes": A_FIX}, r"sequence, got one PositionFix: give \[fix\]") for call in (of_track, of_smoothing)),
    *(
        (call, {"calibration": {}}, r"calibration must be a Calibration, or the path of a saved one, got \{\}")
        for call in (of_track, of_smoothing)
    ),
    (of_smoothing, {"fixes": [(5.0, 0.0)]}, "PositionFix"),
    (of_smoothing, {"fixes": recipes.default()}, r"fixes .* got Config\('default'.*by their names"),
    (pdr.calibrate, {"recordings": recipes.default()}, r"recordings .* got Config\('default'.*by their names"),
    (of_smoothing, {"loop_closures": "wlan"}, "loop_closures"),
    *of(of_smoothing, "loop must be True or False, got .*loop_closures", loop=("yes", 1, None)),
    (partial(of_smoothing, loop_closures=[LoopClosure(1.0, 9.0, 1.0)]), {"anchor_interval_s": NAN}, "anchor_interval"),
    *of(of_smoothing, "start_heading_std_rad", start_heading_std_rad=(NAN, -1.0)),
    *of(partial(pdr.batch.calibrate, ["/nowhere.zip"]), "anchor_std_m must", anchor_std_m=(-1.0, NAN)),
    (partial(pdr.batch.calibrate, ["/nowhere.zip"]), {"loss": "l1"}, "loss must"),
    (partial(pdr.batch.calibrate, ["/nowhere.zip"]), {"file_format": "x"}, "format is"),
    *of(pdr.read, "path is .* give the path of a file", path=(5, None, [5], b"walk.zip")),
]
# Calls of a filter: the name of the method, its arguments, and a part of the message.
PUSHES: list[tuple[str, tuple[Any, ...], str]] = [
    ("push", (np.zeros((3, 1)), np.zeros((3, 3))), "must be"),
    ("push", (np.zeros(3), np.zeros((2, 3))), "must be"),
    ("push", (np.zeros(3), np.zeros((3, 2))), "must be"),
    ("push", ([0.0, 1.0], [["a"], ["b"]]), "^specific_force_mps2 must be"),
    ("push", ([0.0, 1.0], [[object()], [1.0]]), "^specific_force_mps2 must be"),
    ("push", ([0.0, 1.0], [[1.0, 2.0], [3.0]]), "^specific_force_mps2 must be"),
    *(("push_gyroscope", (np.zeros(3), np.zeros(n)), r"angular_rate_radps must be \(3, 3\)") for n in ((3, 2), 3)),
    ("push_gyroscope", (np.zeros((4, 1)), np.zeros((4, 3))), r"time_s must be one-dimensional, got shape \(4, 1\)"),
    ("push_streams", ({"light": Samples(np.zeros(1), np.zeros((1, 3)))},), "keys of streams must be .*got 'light'"),
    ("push_pressure", (np.datetime64("2026-01-01", "ns"), 1000.0), "time_s must be numbers, got datetime64"),
    ("push_location", (0.0, *HERE, 5.0), r"in_world_frame\(\)"),
    ("add_fix", (object(),), "measurement"),
    ("add_fix", (PositionFix,), "instance"),
    ("add_fix", ((30.0, 1.0, 1.0),), r"a fix must be a PositionFix, .*got \(30.0, 1.0, 1.0\); for a position give"),
]


@pytest.mark.parametrize(
    ("call", "wrong", "message"),
    [*SENSING, *FIXES, *FILTER, *EVALUATE, *CLASSIFIERS, *RECIPES, *SIMULATE, *FACES],
)
def test_wrong_arguments_are_refused(call: Callable[..., Any], wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(**wrong)


@pytest.mark.parametrize(("method", "arguments", "message"), PUSHES)
def test_a_filter_refuses_wrong_samples_and_fixes(method: str, arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        getattr(a_filter(), method)(*arguments)
