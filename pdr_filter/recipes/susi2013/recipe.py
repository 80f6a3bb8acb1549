"""Recipe of Susi et al. 2013."""

from __future__ import annotations

from pdr_filter.filter.step_length.models import static_fit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.recipes.susi2013.contexts import MotionModes
from pdr_filter.recipes.susi2013.steps import NormMinimaStepDetector
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject


def susi2013(subject: Subject | None = None) -> Config:
    """Return the configuration of Susi et al. 2013.

    A decision tree classifies the motion mode, and steps are minima of the norm of the specific force or of the angular
    rate. The recipe is for a phone in the hand, at the ear or in a bag, and requires a gyroscope.

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
    The paper describes only motion modes and step detection. The step length here is constant for a height and gender,
    and the heading is the heading of the device. Deviations from the paper are listed in
    `susi2013.contexts.MotionModes` and `susi2013.steps.NormMinimaStepDetector`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.susi2013()
    >>> config.name, config.needs
    ('susi2013', ('gyroscope',))
    """
    length = static_fit(height_of(subject), subject.gender if subject else None)
    return Config(
        name="susi2013",
        sensing=Sensing(contexts=MotionModes(), steps=NormMinimaStepDetector()),
        tracker=one_hot_tracker(context_modes(length)),
        needs=("gyroscope",),
        notes=(
            Note(
                "recipe",
                "susi2013 is for a phone in the hand, at the ear or in a bag: a phone in a trouser pocket is "
                "classified as a swinging hand; use the default recipe for one",
            ),
            *height_notes(subject),
        ),
    )
