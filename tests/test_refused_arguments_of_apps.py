"""Calls of apps, smoother, calibration and training that cannot be used: the message names the argument or remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heard import round_a_block, walk_with_wifi
from made_up import write

import pdr_filter as pdr
from models.training.train_all import train
from pdr_filter.apps.live.sources import Mqtt
from pdr_filter.apps.maps.radio.radio_map import RadioMap
from pdr_filter.apps.report import plot
from pdr_filter.apps.report.html import html_report
from pdr_filter.classifiers.transition_files import Transitions
from pdr_filter.filter.step_length.models import BounceStepLength, FrequencyVarianceStepLength
from pdr_filter.offline.calibration.fit import calibrate, calibrate_segments
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, prior, with_relative_std
from pdr_filter.offline.calibration.segments import Segment
from pdr_filter.offline.smoothing.observations import KnownHeading, LoopClosure, waypoint_fixes
from pdr_filter.offline.smoothing.preintegration import preintegrate
from pdr_filter.offline.training.context_sequences import (
    UNKNOWN,
    LabelledProbabilities,
    count_transitions,
    estimate_transitions,
    filter_windows,
    fit_tempering,
    sequence_starts,
)
from pdr_filter.offline.training.transition_training import shipped_model_without
from pdr_filter.recipes import context_transitions, with_transitions
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray, FunctionFeatures, JoinedFeatures, Step, table
from pdr_filter.values.recording import Truth
from pdr_filter.values.serialisation import to_bytes
from tests.offline.calibration.made_up_segments import flat, segment, step
from tests.simulated_steps import simulated_walk


@cache
def walk() -> pdr.Recording:
    return simulate([Leg("walking", distance_m=12.0)], seed=3, name="walk")


@cache
def length_m() -> float:
    return pdr.track(walk()).distance_m


@cache
def heard() -> pdr.Recording:
    return walk_with_wifi(round_a_block(1), 1)


@cache
def radio() -> RadioMap:
    return RadioMap.fit([heard()])


def plan(folder: Path) -> pdr.FloorPlan:
    return pdr.FloorPlan.read(write(folder / "plan.geojson"))


GRID = pdr.GridFix(4.0, (0.0, 0.0), 3.0, np.zeros((2, 2)))
FIX = pdr.PositionFix(4.0, (0.0, 0.0), np.eye(2))
DISORDERED = table({"time_s": np.array([1.0, 9.0, 4.0]), "east_m": np.zeros(3), "north_m": np.zeros(3)})


def map_one(*known: Any) -> pdr.WalkMap:
    return pdr.map_walks([heard()], known)


Rows = list[tuple[Callable[[Path], object], str]]
APPS: Rows = [
    (lambda f: pdr.track(walk(), plan=plan(f), start="attic"), "block, ground, west"),
    (lambda f: pdr.track(walk(), start="west"), "without plan"),
    (lambda f: pdr.smooth(walk(), plan=plan(f), start=FIX, start_heading_std_rad=0.1), "fixes alone"),
    (lambda f: replace(GRID, cell_m=0.0), "cell_m"),
    (lambda f: replace(GRID, log_likelihood=np.zeros(3)), "log_likelihood"),
    (lambda f: replace(GRID, log_likelihood=[[np.nan]]), "log_likelihood"),
    (lambda f: replace(GRID, floor=0.5), "floor"),
    (lambda f: replace(radio(), position_std_m=-1.0), "position_std_m must be a number from 0 to 1000"),
    (lambda f: replace(radio(), position_std_m=1e5), "position_std_m must be a number from 0 to 1000"),
    (lambda f: replace(radio(), position_std_m=np.nan), "position_std_m must be a number from 0 to 1000"),
    (lambda f: RadioMap.fit([walk()]), "no walk has Wi-Fi scans at known positions"),
    (lambda f: radio().fixes(walk()), "has no Wi-Fi"),
    (lambda f: pdr.smooth(walk(), loop_closures="wifi"), 'has no Wi-Fi, which loop_closures="wifi"'),
    (lambda f: pdr.map_walks([]), "recordings is empty"),
    (lambda f: map_one(("nobody", pdr.HeadingFix(1.0, 0.0, 0.1))), "'nobody'"),
    (lambda f: map_one((heard().name, replace(FIX, time_s=-5.0))), "at -5.0 s for the walk .*, which is from 0.0 to"),
    (lambda f: map_one((heard().name, replace(FIX, time_s=1e6))), "at 1000000.0 s for the walk"),
    (lambda f: map_one((heard().name, pdr.SpeedFix(1.0, 1.0, 0.1))), "PositionFix or HeadingFix"),
    (lambda f: plot.nees(np.full(3, np.nan)), "finite value, got none"),
    (lambda f: html_report([]), "at least one track, got none"),
    (lambda f: Mqtt("ws://broker.local:9001/phones", nobody), r"mqtt://HOST:PORT/TOPIC.*fall behind"),
]


ROWS = np.zeros((3, 3))
ONLINE: Rows = [
    *((lambda f, b=b: pdr.OnlineFilter.load(b), "filter") for b in (b"", b"something else", to_bytes({"config": 1}))),
    (lambda f: pdr.OnlineFilter(pdr.recipes.default(), height_m=1.8), "height_m is for the default recipe"),
    (lambda f: pdr.OnlineFilter(weighting="best"), "weighting must be one of"),
    (lambda f: pdr.track(walk(), weighting="best"), "weighting must be one of"),
    (lambda f: pdr.OnlineFilter().push(np.zeros((3, 1)), ROWS), "must be"),
    (lambda f: pdr.OnlineFilter().push(np.zeros(3), ROWS[:2]), "must be"),
    (lambda f: pdr.OnlineFilter().push(np.zeros(3), ROWS[:, :2]), "must be"),
]


async def nobody(*_: Any, **__: Any) -> Any:
    raise AssertionError("nothing is sent")


SMOOTHER: Rows = [
    (
        lambda f: pdr.smooth(walk(), fixes=[replace(FIX, time_s=1e6, received_time_s=1e6)]),
        r"none of 1 fixes.*same clock",
    ),
    (lambda f: pdr.smooth(walk(), loop_closures=[LoopClosure(1.0, 900.0)]), "outside the recording"),
    (lambda f: LoopClosure(5.0, 4.0), "first_s < second_s"),
    (lambda f: LoopClosure(1.0, 2.0, "0.5"), "std_m > 0"),  # pyright: ignore[reportArgumentType]
    (lambda f: KnownHeading(5.0, 4.0, 0.0), "start_s < end_s"),
    *(
        (
            lambda f, std=std: pdr.smooth(walk(), fixes=[FIX], start_heading_std_rad=std),
            "start_heading_std_rad .* omit it",
        )
        for std in (0.0, -1.0, np.nan, "1")
    ),
    (lambda f: pdr.smooth(walk(), fixes=[FIX], anchor_interval_s=0.0), "anchor_interval_s must be a number"),
    (lambda f: waypoint_fixes(replace(walk(), truth=Truth(waypoints=DISORDERED))), "waypoint 3 of 3, at 4.0 s, comes"),
    (lambda f: waypoint_fixes(replace(walk(), truth=Truth())), "no waypoints"),
    (lambda f: preintegrate(simulated_walk(60, np.random.default_rng(1)).steps, np.array([0, 30, 30])), "anchors must"),
]


@cache
def good() -> Segment:
    return segment(np.random.default_rng(19), BounceStepLength(), np.array([0.3]))


def at_one_speed() -> list[Segment]:
    once = segment(np.random.default_rng(18), FrequencyVarianceStepLength(), np.array([0.45, 0.15, 0.01]))
    return [replace(once, steps=(step(1.9),) * 14)] * 30


@dataclass(frozen=True)
class Nothing:
    n_params: int = 1

    def regressors(self, step: Step) -> FloatArray:
        return np.zeros(1)


def of_nothing() -> StepLengthPrior:
    return prior(Nothing(), [0.7], [1.0], [0.0])


def asked(**options: Any) -> Callable[[Path], object]:
    """A calibration that must be refused before the walk is tracked."""
    return lambda f: calibrate(walk(), tracks=[None], **options)  # type: ignore[list-item]


CALIBRATION: Rows = [
    *(
        (
            lambda f, of=of: calibrate_segments([good(), replace(good(), distance_m=of)]),
            "s: distance_m must be positive",
        )
        for of in (0.0, -3.0, np.nan)
    ),
    (lambda f: calibrate_segments([replace(good(), inside=np.zeros(14))]), "no steps"),
    (lambda f: calibrate_segments([]), "no segments"),
    (lambda f: calibrate([]), "no recordings"),
    (lambda f: pdr.track(walk(), calibration=write(f / "plan.geojson")), "plan.geojson: not usable as calibration, "),
    (lambda f: calibrate_segments([good()], loss="tukey"), "loss must be one of"),
    (lambda f: calibrate_segments([good()], model="guess"), "model must be one of bounce, eq12, kim, .* got 'guess'"),
    (lambda f: calibrate_segments([good()], DEFAULT_PRIORS, model="kim"), "give only one of the two"),
    (
        lambda f: calibrate_segments([good()], {"hopping": DEFAULT_PRIORS["walking"]}),
        r"no context hopping; .* need pdr_filter.calibrate\(recordings, config=config\)",
    ),
    (lambda f: calibrate_segments(at_one_speed(), {"walking": flat(3)}), "not determine walking k0, .*one speed"),
    (lambda f: calibrate_segments([good()] * 5, {"running": flat(3)}), "do not determine running k0"),
    (lambda f: prior(BounceStepLength(), [0.3], [0.0], [0.1]), "cannot differ between people"),
    (lambda f: prior(BounceStepLength(), [0.3, 0.1], [0.0], [0.1]), r"mean of BounceStepLength .* shape \(1,\)"),
    (lambda f: with_relative_std(of_nothing(), 0.1), "no parameter of Nothing changes the length of a typical step"),
    (asked(recording_std=float("nan")), "recording_std must be a number from 0 to 1, got .*usual"),
    (asked(recording_std=-1.0), "recording_std must be a number from 0 to 1, got .*usual"),
    (asked(recording_std="1"), "recording_std must be a number from 0 to 1, got .*usual"),
    *((asked(prior_std=std), r"prior_std \(--prior\) must be a fraction") for std in (0.0, -0.1, 10.0, np.nan)),
    (asked(subject="anna", each_a_person=True), "'anna' names one person, but each_a_person means several"),
    (lambda f: walk().of_distance(0.0), "distance_m must be positive"),
    (lambda f: walk().of_distance(float("nan")), "distance_m must be positive"),
    (lambda f: walk().of_distance(12.0, 0), "n_steps must be positive"),
    (lambda f: walk().of_distance(12.0, -3), "n_steps must be positive"),
    (lambda f: walk().of_distance(100 * length_m()), r"faster than 12\.5 m/s"),
    (lambda f: walk().of_distance(length_m(), 2), "step lengths are in metres"),
]

LABEL, NAMES, DEFAULT = np.array([0, 1]), np.array(["a", "b", "a"]), context_transitions()
WINDOWS = LabelledProbabilities(
    np.full((5, 3), 1 / 3), np.full((5, 3), 1 / 3), np.zeros(5, dtype=np.int64), np.full(5, "p"), np.full(5, "p")
)
CHAIN = np.array([[0.90, 0.07, 0.03], [0.02, 0.95, 0.03], [0.10, 0.10, 0.80]])
ONE_FEATURE = FunctionFeatures.of(lambda signals: {"force_std": signals["force_mps2"].std()})
TWO_MODES = pdr.recipes.default().model.modes[:2]
SIX = np.eye(6)
TRAINING: Rows = [
    (
        lambda f: shipped_model_without(["mine/p0", "motionsense/s03"]),
        "motionsense/s03.*train the models again without",
    ),
    (lambda f: train(f, f), r"has none of the data sets \['difronzo', .*give the folder"),
    (
        lambda f: with_transitions(pdr.recipes.default().with_modes(TWO_MODES), Transitions(SIX, 0.7, 0.1, SIX, {})),
        "'default' has modes of",
    ),
    (lambda f: sequence_starts(NAMES), "must be contiguous"),
    (lambda f: count_transitions(np.array([0, 2]), NAMES[:2], 2), "labels must be from -1 to 1"),
    (lambda f: count_transitions(LABEL, NAMES[:1], 2), "must have the same length"),
    (lambda f: count_transitions(LABEL, NAMES[:2], 2, steps=np.array([1.0, np.nan])), "steps must be 0 or more"),
    (lambda f: estimate_transitions(np.zeros((6, 6)), DEFAULT.T), "transpose"),
    (lambda f: estimate_transitions(np.zeros((6, 6)), DEFAULT, 0.0), "prior_steps"),
    (lambda f: estimate_transitions(np.zeros((3, 3)), DEFAULT), "both be"),
    (lambda f: estimate_transitions(np.full((6, 6), np.nan), DEFAULT), "counts must be 0 or more and finite"),
    (lambda f: replace(WINDOWS, label=WINDOWS.label[:4]), "label must have 5 rows"),
    (lambda f: replace(WINDOWS, prob=np.full((5, 3), np.nan)), "prob must be 0 or more"),
    (lambda f: replace(WINDOWS, training_prior=WINDOWS.training_prior[0]), "must both be"),
    (lambda f: fit_tempering(replace(WINDOWS, label=np.full(5, UNKNOWN)), CHAIN), "no window has a known context"),
    (lambda f: filter_windows(WINDOWS, CHAIN.T, 0.5, 0.25, 0.01), "transition_prob"),
    (lambda f: filter_windows(WINDOWS, CHAIN, 0.5, 0.25, 0.0), "floor"),
    (lambda f: JoinedFeatures((ONE_FEATURE, ONE_FEATURE)), "must have different names"),
]


@pytest.mark.parametrize(("call", "message"), [*APPS, *ONLINE, *SMOOTHER, *CALIBRATION, *TRAINING])
def test_what_cannot_be_used_is_refused_with_its_name(
    tmp_path: Path, call: Callable[[Path], object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call(tmp_path)
