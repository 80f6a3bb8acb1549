"""The recipe of Tian et al. 2016, and its step length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.filter.step_length.models import StepLengthFit, TianStepLength, of_gender, one_parameter_fit, static_fit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.tian2016.contexts import TianContexts
from pdr_filter.recipes.tian2016.heading import OffsetCompensation
from pdr_filter.recipes.tian2016.steps import TianStepDetector
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import FloatArray, Note, Step, check_numbers
from pdr_filter.values.recording import Subject

# k of men and women: text of eq. 9. Of the distances of ten people over 28 m Table VII has a standard deviation of
# 2.30 m.
_K = {"M": 0.3139, "F": 0.2975}
_RELATIVE_STD = 2.30 / 28


@dataclass(frozen=True)
class StaticFirstStepLength:
    """L = k h sqrt(f), but L = k_1 h for the first step from rest, which has no frequency yet; theta = (k, k_1)."""

    height_m: float
    n_params: int = 2

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        """(h sqrt(f), 0), or (0, h)."""
        moving = TianStepLength(self.height_m).regressors(step)[0]
        return np.array([0.0, self.height_m]) if step.from_rest else np.array([moving, 0.0])


def tian_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Eq. 9 with the printed k; gender "M", "F" or unknown."""
    return one_parameter_fit(TianStepLength(height_m), of_gender(_K, gender), _RELATIVE_STD)


def recipe_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Eq. 9, and eq. 2 for the first step from rest (section III-D), both with the printed k."""
    moving, first = tian_fit(height_m, gender), static_fit(height_m, gender)
    theta, variance = np.concatenate([moving.theta, first.theta]), [moving.theta_cov[0, 0], first.theta_cov[0, 0]]
    return StepLengthFit(StaticFirstStepLength(height_m), theta, np.diag(variance), moving.residual_std_m)


def tian2016(subject: Subject | None = None) -> Config:
    """Tian et al. 2016: carrying modes by a state machine, peaks of one axis, k h sqrt(f), heading compensated.

    Needs a gyroscope; height and gender of the subject give the step length, that of the first step from rest by the
    static model. docs/methods/tian2016.md has all deviations.
    """
    return Config(
        name="tian2016",
        sensing=Sensing(contexts=TianContexts(), steps=TianStepDetector(), heading=OffsetCompensation()),
        tracker=one_hot_tracker(context_modes(recipe_fit(height_of(subject), subject.gender if subject else None))),
        needs=("gyroscope",),
        notes=(
            Note(
                "recipe",
                "tian2016 follows changes of the carrying mode: a phone that was put away before the recording "
                "began is taken to be held",
            ),
            *height_notes(subject),
        ),
    )
