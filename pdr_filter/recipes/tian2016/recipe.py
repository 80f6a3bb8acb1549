"""Recipe of Tian et al. 2016, and its step-length model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.step_length.models import StepLengthFit, TianStepLength, of_gender, one_parameter_fit, static_fit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.recipes.tian2016.contexts import TianContexts
from pdr_filter.recipes.tian2016.heading import OffsetCompensation
from pdr_filter.recipes.tian2016.steps import TianStepDetector
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import FloatArray, Note, Step, check_numbers
from pdr_filter.values.recording import Subject

# k of men and women, from the text of eq. 9. The relative standard deviation is from Table VII, in which the distances
# of ten persons over 28 m have a standard deviation of 2.30 m.
_K = {"M": 0.3139, "F": 0.2975}
_RELATIVE_STD = 2.30 / 28


@dataclass(frozen=True)
class StaticFirstStepLength:
    """Step length L = k h sqrt(f), or L = k_1 h for the first step from rest, which has no frequency.

    L is in m, h is the body height in m, and f the step frequency in Hz. The parameters are theta = (k, k_1).
    """

    height_m: float
    n_params: int = 2

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        """Return the regressors (h sqrt(f), 0), or (0, h) for the first step from rest.

        h is the body height in m, and f the step frequency in Hz.
        """
        moving = TianStepLength(self.height_m).regressors(step)[0]
        return np.array([0.0, self.height_m]) if step.from_rest else np.array([moving, 0.0])


def tian_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Return the step-length model of Tian et al. 2016, L = k h sqrt(f) (eq. 9), with the printed k.

    L is the step length in m, h the body height in m and f the step frequency in Hz.

    Parameters
    ----------
    height_m : float
        Height h of the person in m.
    gender : {"M", "F"}, optional
        Gender, which determines k (0.3139 or 0.2975). The default is the mean of both.

    Returns
    -------
    StepLengthFit
        Model `TianStepLength` with its parameter k and the variance between persons.

    Examples
    --------
    >>> from pdr_filter.recipes.tian2016.recipe import tian_fit
    >>> tian_fit(1.75, "M").theta.tolist()
    [0.3139]
    """
    return one_parameter_fit(TianStepLength(height_m), of_gender(_K, gender), _RELATIVE_STD)


def recipe_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Return the step-length model of Tian et al. 2016 with its printed parameters.

    The step length in m is L = k h sqrt(f) (eq. 9), or L = k_1 h for the first step from rest (eq. 2, section III-D). h
    is the body height in m and f the step frequency in Hz. k and k_1 depend on the gender of the person.
    """
    moving, first = tian_fit(height_m, gender), static_fit(height_m, gender)
    theta, variance = np.concatenate([moving.theta, first.theta]), [moving.theta_cov[0, 0], first.theta_cov[0, 0]]
    return StepLengthFit(StaticFirstStepLength(height_m), theta, np.diag(variance), moving.residual_std_m)


def tian2016(subject: Subject | None = None) -> Config:
    """Return the configuration of Tian et al. 2016.

    A state machine tracks the carrying mode. Steps are peaks of the vertical acceleration for a held phone, and of that
    along one axis of the phone otherwise. The step length is k h sqrt(f). The heading is compensated for the rotation
    of the phone. A gyroscope is required.

    Parameters
    ----------
    subject : Subject, optional
        Person who carries the phone. Height and gender determine the step length.

    Returns
    -------
    Config
        Configuration of the filter.

    Notes
    -----
    The first step from rest has the length of the static model (eq. 2). Deviations from the paper are listed in
    `TianContexts`, `TianStepDetector` and `OffsetCompensation`; docs/methods/tian2016.md compares the equations.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.tian2016()
    >>> config.name, config.needs
    ('tian2016', ('gyroscope',))
    """
    return Config(
        name="tian2016",
        sensing=Sensing(contexts=TianContexts(), steps=TianStepDetector(), heading=OffsetCompensation()),
        tracker=one_hot_tracker(context_modes(recipe_fit(height_of(subject), subject.gender if subject else None))),
        needs=("gyroscope",),
        notes=(
            Note(
                "recipe",
                "tian2016 tracks changes of the carrying mode from the start: a phone that was put into a pocket or a "
                "bag before the recording began is assumed to be held in the hand; begin with the phone in the hand",
            ),
            *height_notes(subject),
        ),
    )
