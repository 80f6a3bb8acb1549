"""Recipes: functions that return a configuration. `default` is the one to use; the others are published systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType

import numpy as np

from pdr_filter.context.learned import LearnedContexts
from pdr_filter.context.model import ContextModel, load_model
from pdr_filter.context.stage import ContextModels
from pdr_filter.features.windows import FEATURE_SETS, FeatureWindows
from pdr_filter.motion import Mode, MotionNoise
from pdr_filter.online import Config
from pdr_filter.sensing import Sensing
from pdr_filter.step_length import FrequencyVarianceStepLength, StepLengthFit, bounce_fit, known_length
from pdr_filter.tracking import Tracker
from pdr_filter.types import CONTEXTS, FloatArray, Subject

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


def context_modes(walking: StepLengthFit) -> tuple[Mode, ...]:
    """One mode for each context, with a model for the steps of walking and the default lengths of all others."""
    lengths = {
        "stationary": _STATIONARY,
        "walking": walking,
        "upstairs": _UPSTAIRS,
        "downstairs": _DOWNSTAIRS,
        "sideways": _SIDEWAYS,
        "running": _RUNNING,
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
    """The recipe to use: wavelet steps, contexts from attitude-free features, one mode for each context.

    Of the subject only the height counts. How people differ in their step lengths beyond it, the deviation of the log
    step scale, is 6.5 % for a known height and 8 % without (docs/methods/step_length.md).
    """
    height_m = subject.height_m if subject else None
    return Config(
        name="default",
        sensing=Sensing(contexts=learned_contexts(_model("context"), "invariant")),
        tracker=Tracker(
            modes=context_modes(bounce_fit(height_m)),
            transition_prob=context_transitions(),
            noise=MotionNoise(log_scale_std=0.08 if height_m is None else 0.065),
        ),
    )


def martinelli2018(subject: Subject | None = None) -> Config:
    """Martinelli et al. 2018: wavelet steps, relevance vector machine on the 28 features, weighted context.

    Deviations: the machine is trained on other people than theirs, without a magnetometer and without sideways
    walking, for which no public recordings exist; the step lengths are those of the default recipe, because their k
    are not printed.
    """
    return Config(
        name="martinelli2018",
        sensing=Sensing(contexts=learned_contexts(_model("context_martinelli_rvm"), "martinelli")),
        tracker=Tracker(
            modes=context_modes(_FREQUENCY_VARIANCE_WALKING), transition_prob=context_transitions(), weighting="wc"
        ),
    )


RECIPES: Mapping[str, Callable[[Subject | None], Config]] = MappingProxyType(
    {"default": default, "martinelli2018": martinelli2018}
)
