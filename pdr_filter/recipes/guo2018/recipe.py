"""Recipe of Guo et al. 2018, and its step-length model."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.step_length.models import RESIDUAL_STD_M, ChenStepLength, StepLengthFit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.contexts import PoseContext
from pdr_filter.recipes.guo2018.steps import PoseStepDetector
from pdr_filter.recipes.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject


def chen_fit(height_m: float) -> StepLengthFit:
    """Return the step-length model of Chen for a person of known height.

    Parameters
    ----------
    height_m : float
        Height of the person in m.

    Returns
    -------
    StepLengthFit
        Model `ChenStepLength` with the parameters a = 0.371, b = 0.227 m s and c = 1 +- 0.08.

    Notes
    -----
    a and b are the values in general use for walking; Guo et al. do not print them. The variation between persons is
    assigned to c alone.

    Examples
    --------
    >>> from pdr_filter.recipes.guo2018.recipe import chen_fit
    >>> chen_fit(1.75).theta.tolist()
    [0.371, 0.227, 1.0]
    """
    return StepLengthFit(
        ChenStepLength(height_m), np.array([0.371, 0.227, 1.0]), np.diag([0.0, 0.0, 0.08]) ** 2, RESIDUAL_STD_M
    )


def guo2018(subject: Subject | None = None) -> Config:
    """Return the configuration of Guo et al. 2018.

    A random forest classifies the pose of the phone, steps are detected in a signal that depends on the pose, and the
    step length follows the model of Chen. A gyroscope is required.

    Parameters
    ----------
    subject : Subject, optional
        Person who carries the phone. The height determines the step length.

    Returns
    -------
    Config
        Configuration of the filter.

    Notes
    -----
    The shipped forest uses 12 of the paper's 18 features, without light and proximity, because its training recordings
    lack these sensors. Deviations from the paper are listed in `guo2018.contexts.PoseContext` and
    `guo2018.steps.PoseStepDetector`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.guo2018()
    >>> config.name, config.needs
    ('guo2018', ('gyroscope',))
    """
    return Config(
        name="guo2018",
        sensing=Sensing(contexts=PoseContext(), steps=PoseStepDetector()),
        tracker=one_hot_tracker(context_modes(chen_fit(height_of(subject)))),
        needs=("gyroscope",),
        notes=(
            Note(
                "recipe",
                "the pose is classified from pitch and roll only (12 of the paper's 18 features): the shipped forest "
                "does not use light and proximity, so expect more confused poses than in the paper",
            ),
            *height_notes(subject),
        ),
    )
