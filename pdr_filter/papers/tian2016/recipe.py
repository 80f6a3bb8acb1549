"""The recipe of Tian et al. 2016, and its step length."""

from __future__ import annotations

from pdr_filter.config import Config
from pdr_filter.filter.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.filter.step_length import StepLengthFit, TianStepLength, of_gender, one_parameter_fit
from pdr_filter.io.recording import Subject
from pdr_filter.papers.tian2016.contexts import TianContexts
from pdr_filter.papers.tian2016.heading import OffsetCompensation
from pdr_filter.papers.tian2016.steps import TianStepDetector
from pdr_filter.sensing.front_end import Sensing

# k of men and women: text of eq. 9. Of the distances of ten people over 28 m Table VII has a standard deviation of
# 2.30 m.
_K = {"M": 0.3139, "F": 0.2975}
_RELATIVE_STD = 2.30 / 28


def tian_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Eq. 9 with the printed k; gender "M", "F" or unknown."""
    return one_parameter_fit(TianStepLength(height_m), of_gender(_K, gender), _RELATIVE_STD)


def tian2016(subject: Subject | None = None) -> Config:
    """Tian et al. 2016: carrying modes by a state machine, peaks of one axis, k h sqrt(f), heading compensated.

    Needs a gyroscope; height and gender of the subject give the step length, that of the first step from rest by the
    static model. docs/methods/tian2016.md has all deviations.
    """
    return Config(
        name="tian2016",
        sensing=Sensing(contexts=TianContexts(), steps=TianStepDetector(), heading=OffsetCompensation()),
        tracker=one_hot_tracker(context_modes(tian_fit(height_of(subject), subject.gender if subject else None))),
        needs=("gyroscope",),
        notes=(
            "tian2016 follows changes of the carrying mode: a phone that was put away before the recording began is "
            "taken to be held",
            *height_notes(subject),
        ),
    )
