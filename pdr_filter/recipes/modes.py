"""Filter modes that the recipes share: one for each context, with its step length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdr_filter.filter.chain.weighted_tracker import DetectedStepTracker
from pdr_filter.filter.imm.motion_model import STANDING_STD_M, Mode
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import (
    USUAL_HEIGHT_M,
    FrequencyVarianceStepLength,
    StepLengthFit,
    constant_fit,
    known_length,
    scale_std,
)
from pdr_filter.values import DEFAULT_CONTEXTS, Note
from pdr_filter.values.recording import Subject

# A step on stairs advances by one tread: 0.29 m up, and 0.43 m down for people who skip the end of the landing
# (Martinelli et al. 2018, group B). Treads of public stairs are 0.26 to 0.32 m. The shared standard deviation is for
# level steps of 0.7 m that are classified as stairs during a whole walk: 5 to 7 % of level steps of unknown people with
# the phone in a back pocket (docs/benchmarks.md). For as many level steps as stairs the variance of this error is
# 0.07 x 0.93 x 0.41^2 m2, or 0.10 m squared. It is the same downstairs, because it is not known who skips the landing.
_UPSTAIRS = known_length(0.29, 0.05, shared_std_m=0.10)
_DOWNSTAIRS = known_length(0.43, 0.10, shared_std_m=0.10)
# No public recording has sideways steps of known length. 0.45 m is a comfortable side step. Half and twice this length
# are 1.5 and 3 standard deviations away.
_SIDEWAYS = known_length(0.45, 0.15)
# Jogging at 2.7 steps a second and 2.6 m/s: 0.95 m a step, with a change of 0.35 m s with the cadence (after Cavanagh
# and Kram, "Stride length in distance running", Med. Sci. Sports Exerc. 21, 1989). The parameters are not fitted. The
# only available running with ground truth is in rooms of 4 to 6 m. Its cadence and force are the same, but its steps
# are 0.46 to 0.62 m long, hence the large parameter covariance. The errors of a single step along and across were
# measured in one of these rooms: 0.2 m each, for steps of 0.53 m (oxiod: error of eight steps, divided by the square
# root of eight).
_RUNNING = StepLengthFit(
    FrequencyVarianceStepLength(),
    theta=np.array([0.0, 0.35, 0.0]),
    theta_cov=np.diag([0.1, 0.1, 0.0]) ** 2,
    residual_std_m=0.20,
)
_RUNNING_HEADING_STD_RAD = 0.35
_STATIONARY = constant_fit(0.0, STANDING_STD_M)
_ASSUMED = (
    f"{USUAL_HEIGHT_M:.2f} m is assumed, and step lengths may be off by {100 * scale_std(None):.0f} % "
    f"({100 * scale_std(USUAL_HEIGHT_M):.0f} % if the height is given)"
)


def context_modes(walking: StepLengthFit, running: StepLengthFit = _RUNNING) -> tuple[Mode, ...]:
    """Return one mode for each of the default contexts.

    Stairs, sideways steps and standing have the step lengths of the default recipe.

    Parameters
    ----------
    walking : StepLengthFit
        Step length of walking.
    running : StepLengthFit, optional
        Step length of running. The default is 0.95 m at 2.7 Hz, which changes by 0.35 m s with the cadence.

    Returns
    -------
    tuple of Mode
        Modes in the order of `pdr_filter.CONTEXTS`.

    Examples
    --------
    >>> from pdr_filter.recipes.modes import context_modes
    >>> from pdr_filter.filter.step_length.models import bounce_fit
    >>> [mode.name for mode in context_modes(bounce_fit())]
    ['stationary', 'walking', 'upstairs', 'downstairs', 'sideways', 'running']
    """
    lengths = {
        "stationary": _STATIONARY,
        "walking": walking,
        "upstairs": _UPSTAIRS,
        "downstairs": _DOWNSTAIRS,
        "sideways": _SIDEWAYS,
        "running": running,
    }
    return tuple(
        Mode(
            c.name,
            step_length=lengths[c.name],
            heading_offset_rad=c.heading_offset_rad,
            heading_std_rad=_RUNNING_HEADING_STD_RAD if c.runs else 0.1,
            moves=c.moves,
            climbs=c.climbs,
            gait=c.gait,
        )
        for c in DEFAULT_CONTEXTS.contexts
    )


def one_hot_tracker(modes: tuple[Mode, ...]) -> DetectedStepTracker:
    """Return a tracker with the weighting "hc", for published systems whose step detectors use the context.

    A step has the length of the most probable context with steps, in the first window that contains it.

    Parameters
    ----------
    modes : tuple of Mode
        One mode for each of the default contexts, as from `context_modes`.

    Returns
    -------
    DetectedStepTracker
        Tracker with the default transition probabilities between contexts.

    Examples
    --------
    >>> from pdr_filter.recipes.modes import context_modes, one_hot_tracker
    >>> from pdr_filter.filter.step_length.models import bounce_fit
    >>> one_hot_tracker(context_modes(bounce_fit())).weighting
    'hc'
    """
    return DetectedStepTracker(PedestrianModel(modes, context_transitions()))


def height_of(subject: Subject | None) -> float:
    """Return the height of a subject, or the usual 1.70 m if it is not known.

    Parameters
    ----------
    subject : Subject or None
        Person who carries the phone, or None if nothing is known about the person.

    Returns
    -------
    float
        Body height, m.

    Examples
    --------
    >>> from pdr_filter.recipes.modes import height_of
    >>> from pdr_filter.values.recording import Subject
    >>> height_of(Subject(height_m=1.85)), height_of(None)
    (1.85, 1.7)
    """
    return USUAL_HEIGHT_M if subject is None or subject.height_m is None else subject.height_m


def height_notes(subject: Subject | None) -> tuple[Note, ...]:
    """Return a note on the uncertain step lengths if the height of a subject is not known, else no notes.

    Parameters
    ----------
    subject : Subject or None
        Person who carries the phone, or None if nothing is known about the person.

    Returns
    -------
    tuple of Note
        One note or none.

    Examples
    --------
    >>> from pdr_filter.recipes.modes import height_notes
    >>> from pdr_filter.values.recording import Subject
    >>> [note.about for note in height_notes(None)], height_notes(Subject(height_m=1.85))
    (['height'], ())
    """
    if subject is not None and subject.height_m is not None:
        return ()
    return (Note("height", f"the person's height is not known: {_ASSUMED}"),)


def notes_with_height_of(subject: Subject, notes: Sequence[Note]) -> tuple[Note, ...]:
    """Return the notes of a configuration that has no height, for the recording of a subject that has one."""
    if subject.height_m is None:
        return tuple(notes)
    text = (
        f"the configuration does not use the person's height, which is {subject.height_m:.2f} m in the recording: "
        f"{_ASSUMED}; give the person to the recipe, such as pdr_filter.recipes.default(recording.subject)"
    )
    return tuple(Note("height", text) if note.about == "height" else note for note in notes)
