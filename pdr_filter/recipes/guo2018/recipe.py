"""The recipe of Guo et al. 2018, and its step length."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.imm.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.filter.step_length.models import RESIDUAL_STD_M, ChenStepLength, StepLengthFit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.contexts import PoseContext
from pdr_filter.recipes.guo2018.steps import PoseStepDetector
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject


def chen_fit(height_m: float) -> StepLengthFit:
    """Chen's model for a person of whom only the height is known: a = 0.371, b = 0.227 m s, c = 1 +- 0.08.

    a and b are the values in general use for walking; Guo et al. do not print them. How far people differ from them is
    put into c alone.
    """
    return StepLengthFit(
        ChenStepLength(height_m), np.array([0.371, 0.227, 1.0]), np.diag([0.0, 0.0, 0.08]) ** 2, RESIDUAL_STD_M
    )


def guo2018(subject: Subject | None = None) -> Config:
    """Guo et al. 2018: poses by a random forest, steps on the signal of the pose, Chen's step length.

    Needs a gyroscope; the height of the subject gives the step length. The recordings here have neither light nor
    proximity: the forest uses the other 12 of the 18 features. docs/methods/guo2018.md has all deviations.
    """
    return Config(
        name="guo2018",
        sensing=Sensing(contexts=PoseContext(), steps=PoseStepDetector()),
        tracker=one_hot_tracker(context_modes(chen_fit(height_of(subject)))),
        needs=("gyroscope",),
        notes=(
            Note(
                "recipe",
                "the pose is classified from pitch and roll alone (12 of 18 features): light and proximity are "
                "not among the samples",
            ),
            *height_notes(subject),
        ),
    )
