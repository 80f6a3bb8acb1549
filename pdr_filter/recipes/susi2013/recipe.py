"""The recipe of Susi et al. 2013."""

from __future__ import annotations

from pdr_filter.filter.imm.modes import context_modes, height_notes, height_of, one_hot_tracker
from pdr_filter.filter.step_length.models import static_fit
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.susi2013.contexts import MotionModes
from pdr_filter.recipes.susi2013.steps import NormMinimaStepDetector
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.values import Note
from pdr_filter.values.recording import Subject


def susi2013(subject: Subject | None = None) -> Config:
    """Susi et al. 2013: motion modes by a decision tree, minima of the norms of force or rotation.

    For a phone in the hand, at the ear or in a bag, with a gyroscope. The paper ends with the steps: their length is
    the static one of the subject's height and gender, and the heading that of the device. docs/methods/susi2013.md.
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
                "susi2013 is made for a phone in the hand, at the ear or in a bag: a trouser pocket looks like a"
                " swinging arm to it",
            ),
            *height_notes(subject),
        ),
    )
