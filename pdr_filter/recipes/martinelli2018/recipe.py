"""The recipe of Martinelli et al. 2018."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.imm.modes import context_modes
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength, StepLengthFit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.martinelli2018.features import TABLE_II
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.contexts.context_stage import ContextModels
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts, shipped_model
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values.recording import Subject

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


def magnitude_contexts() -> LearnedContexts:
    """Context stage on the features of Table II."""
    models = ContextModels(shipped_model("context_martinelli_rvm"), shipped_model("context_martinelli_forest"))
    return LearnedContexts(FeatureWindows(features=TABLE_II), models)


def martinelli2018(subject: Subject | None = None) -> Config:
    """Martinelli et al. 2018: wavelet steps, relevance vector machine on the 28 features, weighted context.

    docs/methods/martinelli2018.md has all deviations.
    """
    return Config(
        name="martinelli2018",
        sensing=Sensing(steps=WaveletStepDetector(), contexts=magnitude_contexts()),
        tracker=WeightedTracker(
            PedestrianModel(context_modes(_FREQUENCY_VARIANCE_WALKING), context_transitions()), threshold=0.8
        ),
    )
