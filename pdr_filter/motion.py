"""One step of the pedestrian: where it leads, how that depends on the state, and how unsure it is.

State of a mode: east in m, north in m, heading offset in rad (walking heading less device heading), log step scale
(the person's own factor on every step length).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.angles import wrap_angle
from pdr_filter.step_length import StepLengthFit
from pdr_filter.types import CONTEXTS, FloatArray, Step

EAST, NORTH, HEADING_OFFSET, LOG_SCALE = range(4)
N_STATES = 4


@dataclass(frozen=True, eq=False)
class Mode:
    """A motion model of the filter.

    Parameters
    ----------
    name : str
        Unique name.
    context : str
        The context whose probability is its evidence.
    step_length : StepLengthFit
        Length of a step with its uncertainty.
    heading_offset_rad : float
        Walking direction less the heading the body faces: +pi/2 for steps to the right.
    heading_std_rad : float
        Independent error of the walking direction of each step.
    """

    name: str
    context: str
    step_length: StepLengthFit
    heading_offset_rad: float = 0.0
    heading_std_rad: float = 0.1

    def __post_init__(self) -> None:
        if self.context not in CONTEXTS:
            raise ValueError(f"context of mode {self.name!r} must be one of {CONTEXTS}, got {self.context!r}")


@dataclass(frozen=True)
class MotionNoise:
    """How fast the slow states wander, and what is known at the start.

    Parameters
    ----------
    heading_drift_rad_per_sqrt_s : float
        Random walk of the heading offset: what the bias does not explain, and the body's turning against the phone.
    unknown_heading_rad_per_sqrt_s : float
        The same while no angular rate is measured: after a few seconds nothing is known.
    initial_heading_offset_std_rad : float
        How well the phone's first heading is the person's.
    bias_correlation_s : float
        How long an error of the gyroscope's bias lasts; its variance enters the heading as a random walk with this
        memory. It is short, because the deviation at the start is that of a mixture: few phones are off by 0.05 rad/s,
        most by less than 0.002. With both values the errors of real hand-held walks are about as large as predicted
        (docs/benchmarks.md).
    log_scale_std : float
        Spread of people about the population's step lengths: 8 %.
    log_scale_drift_per_sqrt_step : float
        Random walk of the scale.
    gap_speed_mps : float
        In a gap the pedestrian may have gone anywhere at this speed (one standard deviation).
    """

    heading_drift_rad_per_sqrt_s: float = 0.008
    unknown_heading_rad_per_sqrt_s: float = 1.0
    initial_heading_offset_std_rad: float = 0.15
    bias_correlation_s: float = 3.0
    log_scale_std: float = 0.08
    log_scale_drift_per_sqrt_step: float = 0.001
    gap_speed_mps: float = 1.0


# A heading that could be anything is uniform on the circle: its variance is pi^2 / 3, and no more.
MAX_HEADING_VARIANCE = np.pi**2 / 3


def initial_estimate(noise: MotionNoise) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) at the origin."""
    std = np.array([0.0, 0.0, noise.initial_heading_offset_std_rad, noise.log_scale_std])
    return np.zeros(N_STATES), np.diag(std**2)


def learn_heading(mean: FloatArray, cov: FloatArray, step: Step, frame_rad: float) -> tuple[FloatArray, FloatArray]:
    """Means (..., M, 4) and covariances (..., M, 4, 4) after the walking direction that the samples of a step show.

    Where the phone was moved, the heading offset may be anything near the new one: its variance grows by
    `offset_change_std_rad` squared. The walking direction z is a measurement of frame + device heading + offset state,
    its innovation wrapped: gain K = P[:, o] / (P[o, o] + R). It moves positions too, as far as they went with the
    offset. It is the direction that the body faces: a mode that walks sideways has its own angle on top.

    Parameters
    ----------
    mean, cov
        Of the modes.
    step : Step
        With what the heading stage says of it.
    frame_rad : float
        Offset that counts as zero: north of the track is where the person would have walked with the first one.
    """
    o = HEADING_OFFSET
    if step.offset_change_std_rad > 0:
        cov = cov.copy()
        cov[..., o, o] += step.offset_change_std_rad**2
        cov = bound_heading_variance(cov)
    variance = step.walking_direction_std_rad**2
    if not np.isfinite(variance):
        return mean, cov
    innovation = wrap_angle(step.walking_direction_rad - step.device_heading_rad - frame_rad - mean[..., o])
    gain = cov[..., :, o] / (cov[..., o, o] + variance)[..., None]
    mean = mean + gain * innovation[..., None]
    cov = cov - gain[..., :, None] * cov[..., None, o, :]
    return mean, 0.5 * (cov + cov.swapaxes(-1, -2))


def expect_first_direction(cov: FloatArray, std_rad: float) -> FloatArray:
    """Covariances (..., M, 4, 4) in which the heading offset is as unsure as the first walking direction.

    Which way the track points is a matter of its frame, but what later directions can still change is not: the first
    offset is known as well as the direction that it comes from, and so was the direction of the steps before. With c
    the covariance of the offset with all else, v its variance and r = std^2 / v: the covariance of all else grows by
    (r - 1) c c' / v, c becomes r c and v becomes std^2.
    """
    o = HEADING_OFFSET
    cov = cov.copy()
    std_rad = min(std_rad, float(np.sqrt(MAX_HEADING_VARIANCE)))
    variance = cov[..., o, o].copy()
    ratio = std_rad**2 / variance
    c = cov[..., :, o].copy()
    cov += ((ratio - 1) / variance)[..., None, None] * c[..., :, None] * c[..., None, :]
    return cov


def advance(
    mean: FloatArray,
    cov: FloatArray,
    step: Step,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    heading_offset_rad: FloatArray,
    heading_var_rad2: FloatArray,
    noise: MotionNoise,
    elapsed_s: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Predicted means (..., M, 4) and covariances (..., M, 4, 4) after one step: P_k = F P_{k-1} F' + Q.

    Arguments, F and Q are those of `linearise`.
    """
    predicted_mean, F, Q = linearise(
        mean, step, length_m, length_var_m2, heading_offset_rad, heading_var_rad2, noise, elapsed_s
    )
    return predicted_mean, bound_heading_variance(F @ cov @ F.swapaxes(-1, -2) + Q)


def linearise(
    mean: FloatArray,
    step: Step,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    heading_offset_rad: FloatArray,
    heading_var_rad2: FloatArray,
    noise: MotionNoise,
    elapsed_s: float | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predicted means (..., M, 4), F (..., M, 4, 4) and Q (..., M, 4, 4) of a step, one length for each mode.

    p_k = p_{k-1} + L e^s [sin psi, cos psi], psi = device heading + heading offset state + the mode's own offset;
    F = d p_k / d state, and Q from the variances of length and direction:
    Q_p = (e^s)^2 var(L) u u' + (L e^s)^2 var(psi) v v', u along and v across the step. The heading offset wanders for
    `elapsed_s`, the time since the step before (its duration if not given): a phone that lay on the table drifts too.
    """
    elapsed_s = step.duration_s if elapsed_s is None else elapsed_s
    scaled_m = length_m * np.exp(mean[..., LOG_SCALE])
    psi = step.device_heading_rad + mean[..., HEADING_OFFSET] + heading_offset_rad
    along = np.stack([np.sin(psi), np.cos(psi)], axis=-1)
    across = np.stack([np.cos(psi), -np.sin(psi)], axis=-1)  # d along / d psi
    displacement = scaled_m[..., None] * along

    predicted_mean = mean.copy()
    predicted_mean[..., :2] += displacement
    F = np.broadcast_to(np.eye(N_STATES), (*mean.shape, N_STATES)).copy()
    F[..., :2, HEADING_OFFSET] = scaled_m[..., None] * across
    F[..., :2, LOG_SCALE] = displacement

    var_along = np.exp(2 * mean[..., LOG_SCALE]) * length_var_m2
    var_across = scaled_m**2 * heading_var_rad2
    Q = np.zeros_like(F)
    Q[..., :2, :2] = (
        var_along[..., None, None] * along[..., :, None] * along[..., None, :]
        + var_across[..., None, None] * across[..., :, None] * across[..., None, :]
    )
    unknown_s = np.minimum(step.heading_unknown_s, elapsed_s)
    drift_rad2_per_s = noise.heading_drift_rad_per_sqrt_s**2 + 2 * noise.bias_correlation_s * step.yaw_bias_std_radps**2
    Q[..., HEADING_OFFSET, HEADING_OFFSET] = (
        drift_rad2_per_s * (elapsed_s - unknown_s) + noise.unknown_heading_rad_per_sqrt_s**2 * unknown_s
    )
    Q[..., LOG_SCALE, LOG_SCALE] = noise.log_scale_drift_per_sqrt_step**2
    return predicted_mean, F, Q


def bound_heading_variance(cov: FloatArray) -> FloatArray:
    """Scale the heading's row and column down so that its variance stays that of a uniform heading."""
    variance = cov[..., HEADING_OFFSET, HEADING_OFFSET]
    if (variance <= MAX_HEADING_VARIANCE).all():
        return cov
    scaling = np.ones(cov.shape[:-1])
    scaling[..., HEADING_OFFSET] = np.minimum(1.0, np.sqrt(MAX_HEADING_VARIANCE / variance))
    return cov * scaling[..., :, None] * scaling[..., None, :]


def second_order_error(heading_var_rad2: float) -> float:
    """Root mean square error along a step of unit length that an uncertain heading makes, 0 to 1.22.

    The linear covariance knows only the error across the step, L e. Along it the error is L (cos e - 1), for normal e
    with variance v: E[(cos e - 1)^2] = 1 - 2 exp(-v / 2) + (1 + exp(-2 v)) / 2. All steps share the error e of the
    heading offset, so that these errors add up as vectors, not as variances.
    """
    v = heading_var_rad2
    return float(np.sqrt(max(1 - 2 * np.exp(-v / 2) + 0.5 * (1 + np.exp(-2 * v)), 0.0)))


def grow_over_gap(cov: FloatArray, gap_s: float, noise: MotionNoise) -> FloatArray:
    """Covariances (M, 4, 4) after a time without samples: any way walked, any turn taken."""
    grown = cov.copy()
    walked = (noise.gap_speed_mps * gap_s) ** 2
    grown[:, EAST, EAST] += walked
    grown[:, NORTH, NORTH] += walked
    grown[:, HEADING_OFFSET, HEADING_OFFSET] += noise.unknown_heading_rad_per_sqrt_s**2 * gap_s
    return bound_heading_variance(grown)
