"""Segments of synthetic people for calibration tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdr_filter.filter.step_length.models import (
    TYPICAL_STEP,
    FrequencyVarianceStepLength,
    StepLengthModel,
    length_and_jacobian,
)
from pdr_filter.offline.calibration.priors import StepLengthPrior
from pdr_filter.offline.calibration.segments import Segment, SegmentSums
from pdr_filter.values import CONTEXTS, Step

INF = np.inf
WALKING = CONTEXTS.index("walking")


def step(frequency_hz: float, variance: float = 4.0, mean_abs_mps2: float = 1.7, amplitude_mps2: float = 2.4) -> Step:
    return replace(
        TYPICAL_STEP,
        frequency_hz=frequency_hz,
        duration_s=1 / frequency_hz,
        variance=variance,
        vertical_amplitude_mps2=amplitude_mps2,
        mean_abs_mps2=mean_abs_mps2,
    )


def of_context(n: int, **prob: float) -> np.ndarray:
    return np.tile([prob.get(c, 0.0) for c in CONTEXTS], (n, 1))


def segment(
    rng: np.random.Generator,
    model: StepLengthModel,
    theta: np.ndarray,
    subject: str = "anna",
    *,
    n: int = 14,
    recording: str = "",
    turn_rad: float = 0.0,
    error_m: float = 0.0,
    **prob: float,
) -> Segment:
    """Return a segment whose displacement is that of its steps under theta, on a straight line or an arc."""
    pace = rng.normal(1.9, 0.15)
    features = (rng.normal(pace, 0.1, n), rng.normal(4, 1, n), rng.normal(rng.uniform(1.2, 2.4), 0.2, n))
    steps = tuple(step(*values) for values in zip(*features, strict=True))
    heading = rng.uniform(0, 6) + np.linspace(0, turn_rad, n)
    length = np.array([length_and_jacobian(model, s, theta)[0] for s in steps])
    vector = np.array([length @ np.sin(heading), length @ np.cos(heading)])
    return Segment(
        subject=subject,
        recording=recording or subject,
        distance_m=float(np.hypot(*vector)) + error_m,
        steps=steps,
        inside=np.ones(n),
        heading_rad=heading,
        context_prob=of_context(n, **(prob or {"walking": 1.0})),
    )


def flat(n_params: int, personal: int = 0) -> StepLengthPrior:
    """Return uninformative priors. The first parameters are independent between people."""
    between = np.where(np.arange(n_params) < personal, INF, 0.0)
    return StepLengthPrior(FrequencyVarianceStepLength(), np.zeros(n_params), np.full(n_params, INF), between)


def sums_of(
    rows: np.ndarray,
    distance_m: np.ndarray,
    person: np.ndarray,
    steps: np.ndarray,
    recording: np.ndarray | None = None,
    anchor_std_m: float = 1.0,
) -> SegmentSums:
    """Return sums of straight segments with summed regressors (N, P), of one recording for each person."""
    n, recording = len(rows), person if recording is None else recording
    return SegmentSums(
        regressors=np.stack([rows, np.zeros_like(rows)], axis=1),
        offset_m=np.zeros((n, 2)),
        distance_m=distance_m,
        anchor_std_m=np.full(n, anchor_std_m),
        n_steps=steps,
        context=np.full(n, WALKING),
        subject=person,
        recording=recording,
        subjects=tuple(f"s{i}" for i in range(person.max() + 1)),
        recordings=tuple(f"r{i}" for i in range(recording.max() + 1)),
    )


def design(rng: np.random.Generator, n_people: int = 15, per_person: int = 33) -> tuple[SegmentSums, np.ndarray]:
    """Return segments of eq. 14 with summed lengths, and their joint matrix H."""
    n = n_people * per_person
    person = rng.permutation(np.repeat(np.arange(n_people), per_person))
    steps = rng.integers(12, 20, n).astype(float)
    rows = np.stack([np.ones(n), rng.normal(1.9, 0.15, n), rng.normal(4.0, 0.7, n)], axis=1) * steps[:, None]
    full = np.zeros((n, n_people + 2))
    full[np.arange(n), person], full[:, n_people:] = rows[:, 0], rows[:, 1:]
    k = np.concatenate([rng.normal(0.4, 0.05, n_people), [0.2, 0.005]])
    return sums_of(rows, full @ k + rng.normal(0, 0.3, n), person, steps), full
