"""The modes of the filter that recipes share: one for each context, with its step length, and how they follow."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.model import PedestrianModel
from pdr_filter.filter.motion import Mode
from pdr_filter.filter.step_length import USUAL_HEIGHT_M, FrequencyVarianceStepLength, StepLengthFit, known_length
from pdr_filter.filter.weighted_tracker import WeightedTracker
from pdr_filter.filter.weighting import HC
from pdr_filter.io.recording import Subject
from pdr_filter.values import CONTEXTS, FloatArray, Note

# Stairs advance by one tread a step: 0.29 m up, and 0.43 m down where people skip the landing's end (Martinelli et al.
# 2018, group B). Treads of public stairs are 0.26 to 0.32 m.
_UPSTAIRS = known_length(0.29, 0.05)
_DOWNSTAIRS = known_length(0.43, 0.10)
# No recording with sideways steps of known length is public. 0.45 m is a comfortable side step; half of it and twice
# it are within two standard deviations.
_SIDEWAYS = known_length(0.45, 0.15)
# Jogging at 2.7 steps a second and 2.6 m/s: 0.95 m a step, with 0.35 m s of change with cadence (after Cavanagh and
# Kram, "Stride length in distance running", Med. Sci. Sports Exerc. 21, 1989). Not fitted: the only running here with
# truth is in a room of 5 m.
_RUNNING = StepLengthFit(
    FrequencyVarianceStepLength(),
    theta=np.array([0.0, 0.35, 0.0]),
    theta_cov=np.diag([0.1, 0.03, 0.0]) ** 2,
    residual_std_m=0.10,
)
_STATIONARY = known_length(0.0, 0.02)


def context_modes(walking: StepLengthFit, running: StepLengthFit = _RUNNING) -> tuple[Mode, ...]:
    """One mode for each context, with models for walking and running and the default lengths of all others."""
    lengths = {
        "stationary": _STATIONARY,
        "walking": walking,
        "upstairs": _UPSTAIRS,
        "downstairs": _DOWNSTAIRS,
        "sideways": _SIDEWAYS,
        "running": running,
    }
    # Which side a side step goes to is not observable from the features; to the right is the convention.
    offsets = {"sideways": np.pi / 2}
    return tuple(Mode(c, c, lengths[c], heading_offset_rad=offsets.get(c, 0.0)) for c in CONTEXTS)


def context_transitions() -> FloatArray:
    """Transition matrix between the contexts for one step, rows from.

    Mean stays: walking 100 steps, running 50, stairs one flight of 12 to 20 steps, standing 5 false steps, sideways
    10. From every other context the way leads to walking; walking leaves for each of the others alike, so that walking
    is the most frequent context by far, as in life and unlike in training sets.
    """
    stay = {"stationary": 0.8, "walking": 0.99, "upstairs": 0.94, "downstairs": 0.94, "sideways": 0.9, "running": 0.98}
    rows = np.zeros((len(CONTEXTS), len(CONTEXTS)))
    walking = CONTEXTS.index("walking")
    for i, context in enumerate(CONTEXTS):
        leave = 1 - stay[context]
        rows[i] = leave / 5 if i == walking else leave * (0.1 / 4)
        rows[i, walking] = leave * 0.9  # nine of ten leave for walking
        rows[i, i] = stay[context]
    return rows


def one_hot_tracker(modes: tuple[Mode, ...]) -> WeightedTracker:
    """For a published system that decides for one context: the step length is that of the most probable one."""
    return WeightedTracker(PedestrianModel(modes, context_transitions()), HC)


def height_of(subject: Subject | None) -> float:
    """Height in m, or the usual one where it is not known."""
    return USUAL_HEIGHT_M if subject is None or subject.height_m is None else subject.height_m


def height_notes(subject: Subject | None) -> tuple[Note, ...]:
    """What to keep in mind where the height is not known."""
    if subject is not None and subject.height_m is not None:
        return ()
    assumed = f"the person's height is not known: {USUAL_HEIGHT_M:.2f} m is assumed"
    return (Note("height", f"{assumed}, and the track may be 8 % too long or short"),)
