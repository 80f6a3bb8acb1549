"""Recipes: functions that return a configuration. `default` is the one to use; the others are published systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pdr_filter.classifiers.model import ContextModel, load_model
from pdr_filter.classifiers.transitions import Transitions, load_transitions
from pdr_filter.config import Config
from pdr_filter.filter.imm_tracker import ImmTracker
from pdr_filter.filter.model import PedestrianModel
from pdr_filter.filter.motion import Mode, MotionNoise
from pdr_filter.filter.step_length import (
    FrequencyVarianceStepLength,
    KimStepLength,
    StepLengthFit,
    ZhouWalkingStepLength,
    bounce_fit,
    chen_fit,
    known_length,
    static_fit,
    tian_fit,
)
from pdr_filter.filter.weighted_tracker import WeightedTracker
from pdr_filter.filter.weighting import HC
from pdr_filter.io.recording import Recording, Subject
from pdr_filter.papers.guo2018.contexts import NOTE as POSE_NOTE
from pdr_filter.papers.guo2018.contexts import PoseContext
from pdr_filter.papers.guo2018.steps import PoseStepDetector
from pdr_filter.papers.susi2013.contexts import MotionModes
from pdr_filter.papers.susi2013.steps import NormMinimaStepDetector
from pdr_filter.papers.tian2016.contexts import TianContexts
from pdr_filter.papers.tian2016.heading import OffsetCompensation
from pdr_filter.papers.tian2016.steps import TianStepDetector
from pdr_filter.papers.zhou2019 import contexts as behaviours
from pdr_filter.papers.zhou2019 import steps as reference_lines
from pdr_filter.sensing.contexts.learned import LearnedContexts
from pdr_filter.sensing.contexts.stage import ContextModels
from pdr_filter.sensing.features.windows import FEATURE_SETS, FeatureWindows
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.walking_direction import WalkingDirection
from pdr_filter.sensing.steps.adaptive import AdaptiveStepDetector
from pdr_filter.sensing.steps.gate import StepGate
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.contexts import CONTEXTS
from pdr_filter.values.heading_drift import HeadingDrift
from pdr_filter.values.notes import Note

# Eq. 12 for walking: fitted to 298 legs of known displacement (humolire, one person; ms_indoor, several surveyors) with
# the priors k1 = 0.30 +- 0.05 m s (a person's own change of step length with cadence, which two sites with one cadence
# each cannot show) and k2 = 0 +- 0.003. The default recipe has a model that carries over better between people, sites
# and carrying modes (docs/methods/step_length.md).
_FREQUENCY_VARIANCE_WALKING = StepLengthFit(
    FrequencyVarianceStepLength(max_variance=8.0),
    theta=np.array([0.4298, 0.1776, -0.0020]),
    # Of the fit: k0 and k1 are known badly, the length at 1.9 Hz to 1 cm. How people differ is in log_scale_std.
    theta_cov=np.array(
        [[1.825e-2, -9.432e-3, -1.185e-4], [-9.432e-3, 4.971e-3, 3.579e-5], [-1.185e-4, 3.579e-5, 9.574e-6]]
    ),
    residual_std_m=0.06,
)
# Stairs advance by one tread a step: 0.29 m up, and 0.43 m down where people skip the landing's end (Martinelli et al.
# 2018, group B). Treads of public stairs are 0.26 to 0.32 m.
_UPSTAIRS = known_length(0.29, 0.05)
_DOWNSTAIRS = known_length(0.43, 0.10)
# No recording with sideways steps of known length is public. 0.45 m is a comfortable side step; half of it and twice
# it are within two standard deviations.
_SIDEWAYS = known_length(0.45, 0.15)
# Jogging at 2.7 steps a second and 2.6 m/s: 0.95 m a step, with 0.35 m s of change with cadence (after Cavanagh and
# Kram, "Stride length in distance running", Med. Sci. Sports Exerc. 21, 1989). Not fitted: the only running here with
# truth is in a room of 5 m.
_RUNNING = StepLengthFit(
    FrequencyVarianceStepLength(),
    theta=np.array([0.0, 0.35, 0.0]),
    theta_cov=np.diag([0.1, 0.03, 0.0]) ** 2,
    residual_std_m=0.10,
)
_STATIONARY = known_length(0.0, 0.02)


def context_modes(walking: StepLengthFit, running: StepLengthFit = _RUNNING) -> tuple[Mode, ...]:
    """One mode for each context, with models for walking and running and the default lengths of all others."""
    lengths = {
        "stationary": _STATIONARY,
        "walking": walking,
        "upstairs": _UPSTAIRS,
        "downstairs": _DOWNSTAIRS,
        "sideways": _SIDEWAYS,
        "running": running,
    }
    # Which side a side step goes to is not observable from the features; to the right is the convention.
    offsets = {"sideways": np.pi / 2}
    return tuple(Mode(c, c, lengths[c], heading_offset_rad=offsets.get(c, 0.0)) for c in CONTEXTS)


def context_transitions() -> FloatArray:
    """Transition matrix between the contexts for one step, rows from.

    Mean stays: walking 100 steps, running 50, stairs one flight of 12 to 20 steps, standing 5 false steps, sideways
    10. From every other context the way leads to walking; walking leaves for each of the others alike, so that walking
    is the most frequent context by far, as in life and unlike in training sets.
    """
    stay = {"stationary": 0.8, "walking": 0.99, "upstairs": 0.94, "downstairs": 0.94, "sideways": 0.9, "running": 0.98}
    rows = np.zeros((len(CONTEXTS), len(CONTEXTS)))
    walking = CONTEXTS.index("walking")
    for i, context in enumerate(CONTEXTS):
        others = [j for j in range(len(CONTEXTS)) if j != i]
        leave = 1 - stay[context]
        rows[i, i] = stay[context]
        for j in others:
            # nine of ten leave for walking
            rows[i, j] = leave / 5 if i == walking else leave * (0.9 if j == walking else 0.1 / 4)
    return rows


# The context model of each feature set for windows without angular rate.
_CONTEXT_WITHOUT_GYROSCOPE = {"invariant": "context_accelerometer", "martinelli": "context_martinelli_forest"}


def with_context_model(config: Config, model: ContextModel) -> Config:
    """The configuration with another context model for windows with gyroscope, and with the features that it needs."""
    for feature_set, names in FEATURE_SETS.items():
        if set(model.feature_names) <= set(names):
            return replace(config, sensing=replace(config.sensing, contexts=learned_contexts(model, feature_set)))
    raise ValueError(f"model {model.name!r} needs features that no set has; the sets are {tuple(FEATURE_SETS)}")


def with_transitions(config: Config, transitions: Transitions | str | Path) -> Config:
    """The configuration with transition probabilities and exponents of the evidence that were estimated.

    `transitions`, or the path of its file, is what `pdr-filter train` writes; the exponents in it are of the default's
    context model. The weightings "hc" and "wc" take step lengths from the windows and not from transitions. ValueError
    if the file cannot be used, or if the modes of the configuration are not the contexts, each once.
    """
    learnt = transitions if isinstance(transitions, Transitions) else load_transitions(transitions)
    contexts = [mode.context for mode in config.model.modes]
    if sorted(contexts) != sorted(CONTEXTS):
        raise ValueError(
            f"transitions are between the contexts {CONTEXTS}, but recipe {config.name!r} has modes of {contexts}; "
            "give its model a transition_prob of its own"
        )
    of_mode = [CONTEXTS.index(context) for context in contexts]
    return config.with_model(
        transition_prob=learnt.transition_prob[np.ix_(of_mode, of_mode)],
        evidence_exponent=learnt.evidence_exponent,
        prior_exponent=learnt.prior_exponent,
    )


def learned_contexts(with_gyroscope: ContextModel, feature_set: str) -> LearnedContexts:
    """Context stage with a model for windows with gyroscope, and the shipped models for all else."""
    without_gyroscope = _model(_CONTEXT_WITHOUT_GYROSCOPE[feature_set])
    models = ContextModels(with_gyroscope, without_gyroscope)
    if feature_set == "invariant":
        models = ContextModels(with_gyroscope, without_gyroscope, _model("carrying"), _model("carrying_accelerometer"))
    return LearnedContexts(FeatureWindows(feature_set), models)


@cache
def _model(name: str) -> ContextModel:
    return load_model(name)


def default(subject: Subject | None = None) -> Config:
    """The recipe to use: adaptive steps behind a gate, contexts from attitude-free features, learnt walking direction.

    Of the subject only the height counts. How people differ in their step lengths beyond it, the deviation of the log
    step scale, is 6.5 % for a known height and 8 % without (docs/methods/step_length.md).
    """
    height_m = subject.height_m if subject else None
    drift = HeadingDrift()
    return Config(
        name="default",
        sensing=Sensing(
            steps=AdaptiveStepDetector(),
            gate=StepGate(),
            contexts=learned_contexts(_model("context"), "invariant"),
            heading=WalkingDirection(drift=drift),
        ),
        tracker=ImmTracker(
            PedestrianModel(
                modes=context_modes(bounce_fit(height_m)),
                transition_prob=context_transitions(),
                noise=MotionNoise(heading_drift=drift, log_scale_std=0.08 if height_m is None else 0.065),
            )
        ),
        notes=_height_note(height_m, _HEIGHT_M),
    )


def martinelli2018(subject: Subject | None = None) -> Config:
    """Martinelli et al. 2018: wavelet steps, relevance vector machine on the 28 features, weighted context.

    Deviations: the machine is trained on other people than theirs, without a magnetometer and without sideways
    walking, for which no public recordings exist; the parameters of eq. 12 are fitted to other walks, because theirs
    are not printed.
    """
    return Config(
        name="martinelli2018",
        sensing=Sensing(contexts=learned_contexts(_model("context_martinelli_rvm"), "martinelli")),
        tracker=WeightedTracker(
            PedestrianModel(context_modes(_FREQUENCY_VARIANCE_WALKING), context_transitions()), threshold=0.8
        ),
    )


# Height of somebody of whom it is not known, m: between the means of women and men.
_HEIGHT_M = 1.70


def tian2016(subject: Subject | None = None) -> Config:
    """Tian et al. 2016: carrying modes by a state machine, peaks of one axis, k h sqrt(f), heading compensated.

    Needs a gyroscope; height and gender of the subject give the step length. The first step from rest has the
    frequency of a step of 0.6 s, which gives 0.41 (men) or 0.38 (women) of the height: within 7 % the static model that
    the paper uses for it. docs/methods/tian2016.md has all deviations.
    """
    height_m, gender = _height_and_gender(subject)
    return _of_one_hot_contexts(
        "tian2016",
        Sensing(contexts=TianContexts(), steps=TianStepDetector(), heading=OffsetCompensation()),
        context_modes(tian_fit(height_m, gender)),
        notes=(
            Note(
                "recipe",
                "tian2016 follows changes of the carrying mode: a phone that was put away before the recording began "
                "is taken to be held",
            ),
            *_height_note(subject.height_m if subject else None, _HEIGHT_M),
        ),
    )


# Zhou et al. 2019, eq. 14 (M7): fitted by tests/benchmarks/fit_zhou.py, because the paper prints no parameters.
# Carried: legs of two sites; on a foot: the way of the foot in 24 trials, of which those left out scatter by 16 %.
_ZHOU_CARRIED = (
    StepLengthFit(ZhouWalkingStepLength(), np.array([-0.690, -3.159, 4.351, -0.0084]), np.zeros((4, 4)), 0.10),
    StepLengthFit(KimStepLength(), np.array([0.552]), np.zeros((1, 1)), 0.10),
)
_ZHOU_FOOT = (
    StepLengthFit(ZhouWalkingStepLength(), np.array([-5.226, -6.963, 12.361, 0.0273]), np.zeros((4, 4)), 0.15),
    StepLengthFit(KimStepLength(), np.array([0.389]), np.zeros((1, 1)), 0.15),
)


def zhou2019(subject: Subject | None = None, placement: str = "carried") -> Config:
    """Zhou et al. 2019: behaviours by a state machine, crossings of reference lines, two-segment step length M7.

    Made for a sensor on the foot, `placement="foot"`, where an event is a stride; `placement="carried"` is for a phone
    elsewhere, where it is a step. Needs nothing of the subject and no gyroscope, but for the heading, which the paper
    does not treat: it is that of the device. docs/methods/zhou2019.md has all deviations.
    """
    if placement not in ("carried", "foot"):
        raise ValueError(f'placement must be "carried" or "foot", got {placement!r}')
    thresholds, detector, lengths = (
        (behaviours.FOOT, reference_lines.FOOT, _ZHOU_FOOT)
        if placement == "foot"
        else (behaviours.CARRIED, reference_lines.CARRIED, _ZHOU_CARRIED)
    )
    sensing = Sensing(contexts=behaviours.BehaviourStage(thresholds), steps=detector)
    note = (
        "zhou2019 on a foot: steps are two for each stride of the instrumented foot, the second one half way"
        if placement == "foot"
        else "zhou2019 is made for a sensor on the foot; here every event is a step of a carried phone"
    )
    config = _of_one_hot_contexts("zhou2019", sensing, context_modes(*lengths), needs=(), notes=(Note("recipe", note),))
    return replace(config, on_foot=placement == "foot")


def guo2018(subject: Subject | None = None) -> Config:
    """Guo et al. 2018: poses by a random forest, steps on the signal of the pose, Chen's step length.

    Needs a gyroscope; the height of the subject gives the step length. The recordings here have neither light nor
    proximity: the forest uses the other 12 of the 18 features. docs/methods/guo2018.md has all deviations.
    """
    height_m, _ = _height_and_gender(subject)
    return _of_one_hot_contexts(
        "guo2018",
        Sensing(contexts=PoseContext(), steps=PoseStepDetector()),
        context_modes(chen_fit(height_m)),
        notes=(Note("recipe", POSE_NOTE), *_height_note(subject.height_m if subject else None, _HEIGHT_M)),
    )


def susi2013(subject: Subject | None = None) -> Config:
    """Susi et al. 2013: motion modes by a decision tree, minima of the norms of force or rotation.

    For a phone in the hand, at the ear or in a bag, with a gyroscope. The paper ends with the steps: their length is
    the static one of the subject's height and gender, and the heading that of the device. docs/methods/susi2013.md.
    """
    height_m, gender = _height_and_gender(subject)
    return _of_one_hot_contexts(
        "susi2013",
        Sensing(contexts=MotionModes(), steps=NormMinimaStepDetector()),
        context_modes(static_fit(height_m, gender)),
        notes=(
            Note(
                "recipe",
                "susi2013 is made for a phone in the hand, at the ear or in a bag: a trouser pocket looks like a "
                "swinging arm to it",
            ),
            *_height_note(subject.height_m if subject else None, _HEIGHT_M),
        ),
    )


def _height_and_gender(subject: Subject | None) -> tuple[float, str | None]:
    subject = subject or Subject()
    return _HEIGHT_M if subject.height_m is None else subject.height_m, subject.gender


def _of_one_hot_contexts(
    name: str,
    sensing: Sensing,
    modes: tuple[Mode, ...],
    needs: tuple[str, ...] = ("gyroscope",),
    notes: tuple[Note, ...] = (),
) -> Config:
    """A published system that decides for one context: the step length is that of the most probable one."""
    tracker = WeightedTracker(PedestrianModel(modes, context_transitions()), HC)
    return Config(name=name, sensing=sensing, tracker=tracker, needs=needs, notes=notes)


def _height_note(height_m: float | None, assumed_m: float) -> tuple[Note, ...]:
    if height_m is not None:
        return ()
    text = f"the person's height is not known: {assumed_m:.2f} m is assumed, and the track may be 8 % too long or short"
    return (Note("height", text),)


def for_recording(name: str, recording: Recording) -> Config:
    """The recipe of that name for the person and the placement of a recording; ValueError if there is none."""
    check_name(name)
    if name == "zhou2019" and recording.is_on_foot:
        return zhou2019(recording.subject, placement="foot")
    return RECIPES[name](recording.subject)


def check_name(name: str) -> None:
    """ValueError that lists the recipes if there is none of that name."""
    if name not in RECIPES:
        raise ValueError(f"no recipe {name!r}; there are {', '.join(sorted(RECIPES))}")


RECIPES: Mapping[str, Callable[[Subject | None], Config]] = MappingProxyType(
    {
        "default": default,
        "martinelli2018": martinelli2018,
        "guo2018": guo2018,
        "susi2013": susi2013,
        "tian2016": tian2016,
        "zhou2019": zhou2019,
    }
)
