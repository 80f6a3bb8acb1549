"""Recipe of Martinelli et al. 2018."""

from __future__ import annotations

import numpy as np

from pdr_filter.classifiers.context_model import load_model
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength, StepLengthFit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.martinelli2018.features import TABLE_II
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.modes import context_modes
from pdr_filter.sensing.contexts.context_stage import ContextModels
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values.recording import Subject

# Eq. 12 for walking, fitted to 298 legs of known displacement (humolire, one person; ms_indoor, several surveyors). The
# priors are k1 = 0.30 +- 0.05 m s and k2 = 0 +- 0.003. The prior of k1 is needed because k1 is the change of a person's
# step length with cadence, and each of the two sites has only one cadence. The step-length model of the default recipe
# generalises better between persons, sites and carrying modes (docs/methods/step_length.md).
_FREQUENCY_VARIANCE_WALKING = StepLengthFit(
    FrequencyVarianceStepLength(max_variance=8.0),
    theta=np.array([0.4298, 0.1776, -0.0020]),
    # Covariance of the fit: k0 and k1 are uncertain, but the length at 1.9 Hz is known to 1 cm. The variation between
    # persons is in log_scale_std.
    theta_cov=np.array(
        [[1.825e-2, -9.432e-3, -1.185e-4], [-9.432e-3, 4.971e-3, 3.579e-5], [-1.185e-4, 3.579e-5, 9.574e-6]]
    ),
    residual_std_m=0.06,
)


def magnitude_contexts() -> LearnedContexts:
    """Return the context stage on the features of Table II of Martinelli et al. (2018).

    Returns
    -------
    LearnedContexts
        Context stage with the shipped models for windows with and without gyroscope.

    Notes
    -----
    Deviations from the paper:

    - The features correct the printed table (`pdr_filter.recipes.martinelli2018.features`).
    - The training data of the paper (waist, six contexts) are not public. These models are trained on motionsense,
      difronzo, tyrex, humolire and ms_indoor, with phones in pockets and hands. They have neither magnetometer nor
      sideways walking.
    - Without a gyroscope, a random forest classifies the features of the accelerometer. The paper always has a
      gyroscope.

    Examples
    --------
    >>> from pdr_filter.recipes.martinelli2018.recipe import magnitude_contexts
    >>> magnitude_contexts().models.with_gyroscope.name
    'context_martinelli_rvm'
    """
    models = ContextModels(load_model("context_martinelli_rvm"), load_model("context_martinelli_forest"))
    return LearnedContexts(FeatureWindows(features=TABLE_II), models)


def martinelli2018(subject: Subject | None = None) -> Config:
    """Return the configuration of Martinelli et al. 2018.

    Steps are detected in the wavelet transform of the specific force, and a relevance vector machine classifies
    contexts. It uses the 23 of the paper's 28 features that need no magnetometer. Without a gyroscope, a random forest
    uses 16 of them. Step lengths are weighted by the context probabilities ("wc").

    Parameters
    ----------
    subject : Subject, optional
        Person who carries the phone. It has no effect, because the step length does not depend on the person.

    Returns
    -------
    Config
        Configuration of the filter.

    Notes
    -----
    Deviations from the paper are listed in `WaveletStepDetector` and `magnitude_contexts`, and in
    docs/methods/martinelli2018.md. Further deviations:

    - k0, k1 and k2 of eq. 12 are not printed. They are fitted to public recordings of known displacement for walking.
      Steps on stairs have the length of the tread.
    - The variance of eq. 12 is at most 8 m2/s4, because in a trouser pocket it is ten times that in the hand.
    - A detected step is evidence against contexts without steps (`PedestrianModel.step_log_odds_stationary`).
    - The paper does not treat the heading. Here it is the integrated turning rate, with side steps to the right.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.martinelli2018()
    >>> config.name, config.tracker.weighting
    ('martinelli2018', 'wc')
    """
    return Config(
        name="martinelli2018",
        sensing=Sensing(steps=WaveletStepDetector(), contexts=magnitude_contexts()),
        tracker=WeightedTracker(PedestrianModel(context_modes(_FREQUENCY_VARIANCE_WALKING), context_transitions())),
    )
