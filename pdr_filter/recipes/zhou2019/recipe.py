"""Recipe of Zhou et al. 2019."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.step_length.models import StepLengthFit, scale_std
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.modes import context_modes, one_hot_tracker
from pdr_filter.recipes.zhou2019 import contexts as behaviours
from pdr_filter.recipes.zhou2019 import steps as reference_lines
from pdr_filter.recipes.zhou2019.step_length import M6, M7
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject

# Eq. 14 (M7), fitted by `python -m tests.benchmarks.step_length zhou`, because the paper prints no parameters. Carried
# phones: fitted on 570 legs of two sites. Foot: fitted on the path of the foot in 24 trials, with a bias of +1 % and a
# spread of 9 % over the trials held out.
# k0 has the spread of people, so that a calibration can fit it.
_PEOPLE_STD = scale_std(None)
_M7_COV = np.diag([0.75 * _PEOPLE_STD, 0.0, 0.0, 0.0]) ** 2  # k0 acts on a step of about 0.75 m
_CARRIED_LENGTHS = (
    StepLengthFit(M7(), np.array([-2.933, -7.076, 10.258, -0.0076]), _M7_COV, 0.10),
    StepLengthFit(M6(), np.array([0.5414]), np.array([[0.5414 * _PEOPLE_STD]]) ** 2, 0.10),
)
_FOOT_LENGTHS = (
    StepLengthFit(M7(), np.array([-3.2426, -4.0845, 7.616, 0.0365]), _M7_COV, 0.15),
    StepLengthFit(M6(), np.array([0.3931]), np.array([[0.3931 * _PEOPLE_STD]]) ** 2, 0.15),
)


def zhou2019(subject: Subject | None = None, placement: str = "carried") -> Config:
    """Return the configuration of Zhou et al. 2019.

    A state machine classifies the behaviour, steps are crossings of adaptive reference lines, and the step length is
    the two-segment model M7. The paper is about a sensor on the foot.

    Parameters
    ----------
    subject : Subject, optional
        Person who carries the phone. It has no effect, because the step length does not depend on the person.
    placement : {"carried", "foot"}, default "carried"
        Placement of the sensor. On the foot, a detected event is a stride. For a phone carried elsewhere it is a step.

    Returns
    -------
    Config
        Configuration of the filter.

    Raises
    ------
    ValueError
        If `placement` is unknown.

    Notes
    -----
    Steps and contexts need no gyroscope. The paper does not describe a heading, so that the heading of the device is
    used, which needs one. The paper has the sensor on the foot only. Deviations from the paper are listed in
    `zhou2019.contexts.BehaviourStage` and `zhou2019.steps.ReferenceLineStepDetector`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.zhou2019()
    >>> config.name, config.on_foot
    ('zhou2019', False)
    """
    if placement not in ("carried", "foot"):
        raise ValueError(f'placement must be "carried" or "foot", got {placement!r}')
    if placement == "foot":
        thresholds, detector, lengths = behaviours.FOOT, reference_lines.FOOT, _FOOT_LENGTHS
        note = "zhou2019 on a foot: a stride counts as two steps, with the contact of the other foot assumed half way"
    else:
        thresholds, detector, lengths = behaviours.CARRIED, reference_lines.CARRIED, _CARRIED_LENGTHS
        note = "zhou2019 was designed for a sensor on the foot; here every detected event is a step of a carried phone"
    return Config(
        name="zhou2019",
        sensing=Sensing(contexts=behaviours.BehaviourStage(thresholds=thresholds), steps=detector),
        tracker=one_hot_tracker(context_modes(*lengths)),
        notes=(Note("recipe", note),),
        on_foot=placement == "foot",
    )
