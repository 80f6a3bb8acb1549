"""The recipe of Zhou et al. 2019."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.imm.modes import context_modes, one_hot_tracker
from pdr_filter.filter.step_length.models import StepLengthFit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.zhou2019 import contexts as behaviours
from pdr_filter.recipes.zhou2019 import steps as reference_lines
from pdr_filter.recipes.zhou2019.step_length import M6, M7
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject

# Eq. 14 (M7): fitted by tests/benchmarks/step_length.py, because the paper prints no parameters.
# Carried: legs of two sites; on a foot: the way of the foot in 24 trials, of which those left out scatter by 16 %.
_CARRIED_LENGTHS = (
    StepLengthFit(M7(), np.array([-0.690, -3.159, 4.351, -0.0084]), np.zeros((4, 4)), 0.10),
    StepLengthFit(M6(), np.array([0.552]), np.zeros((1, 1)), 0.10),
)
_FOOT_LENGTHS = (
    StepLengthFit(M7(), np.array([-5.226, -6.963, 12.361, 0.0273]), np.zeros((4, 4)), 0.15),
    StepLengthFit(M6(), np.array([0.389]), np.zeros((1, 1)), 0.15),
)


def zhou2019(subject: Subject | None = None, placement: str = "carried") -> Config:
    """Zhou et al. 2019: behaviours by a state machine, crossings of reference lines, two-segment step length M7.

    Made for a sensor on the foot, `placement="foot"`, where an event is a stride; `placement="carried"` is for a phone
    elsewhere, where it is a step. Needs nothing of the subject and no gyroscope, but for the heading, which the paper
    does not treat: it is that of the device. docs/methods/zhou2019.md has all deviations.
    """
    if placement not in ("carried", "foot"):
        raise ValueError(f'placement must be "carried" or "foot", got {placement!r}')
    if placement == "foot":
        thresholds, detector, lengths = behaviours.FOOT, reference_lines.FOOT, _FOOT_LENGTHS
        note = "zhou2019 on a foot: steps are two for each stride of the instrumented foot, the second one half way"
    else:
        thresholds, detector, lengths = behaviours.CARRIED, reference_lines.CARRIED, _CARRIED_LENGTHS
        note = "zhou2019 is made for a sensor on the foot; here every event is a step of a carried phone"
    return Config(
        name="zhou2019",
        sensing=Sensing(contexts=behaviours.BehaviourStage(thresholds=thresholds), steps=detector),
        tracker=one_hot_tracker(context_modes(*lengths)),
        notes=(Note("recipe", note),),
        on_foot=placement == "foot",
    )
