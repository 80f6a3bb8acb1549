"""One step of the pedestrian: where it leads, how that depends on the state, and how unsure it is.

State of a mode: east in m, north in m, heading offset in rad (walking heading less device heading), log step scale
(the person's own factor on every step length).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.imm.imm import predict_cov
from pdr_filter.filter.step_length.models import StepLengthFit, bounce_fit, known_length
from pdr_filter.values import (
    CARRYING_MODES,
    Context,
    FloatArray,
    Gait,
    HeadingDrift,
    Step,
    check_numbers,
    read_only,
    wrap_angle,
)

EAST, NORTH, HEADING_OFFSET, LOG_SCALE = range(4)
N_STATES = 4
# Context of a mode besides those of the classifier: motion of the phone while its owner stays where he is.
IRREGULAR = "irregular"
# Standard deviation along each axis of a step that leads nowhere.
STANDING_STD_M = 0.02


_PEOPLE = bounce_fit()


@dataclass(frozen=True, eq=False)
class Mode:
    """Motion model of the filter for one context: whether steps lead anywhere, how far and in which direction.

    The context whose probability is the evidence of the mode has the name of the mode unless `context` is given. The
    step length is that of people in general (`bounce_fit`) unless it is given, and has no effect where `moves` is
    False. ValueError names what cannot be used.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> resting = pdr.Mode("resting", moves=False)
    >>> treadmill = pdr.Mode("treadmill", moves=False, gait="walking")  # steps without displacement
    >>> up = pdr.Mode("up", step_length=pdr.known_length(0.29, 0.05), climbs=1)
    >>> resting.gait, treadmill.gait, up.gait
    (None, 'walking', 'walking')
    """

    name: str  # unique
    context: str = ""  # whose probability is its evidence, or "irregular" for handling of the phone; empty: the name
    step_length: StepLengthFit = _PEOPLE
    heading_offset_rad: float = 0.0  # walking heading less the heading the body faces: +pi/2 for steps to the right
    heading_std_rad: float = 0.1  # independent error of the walking heading of each step
    carrying_mode: str | None = None  # where the phone is, whose probability is evidence too; None for any
    heading_drift_rad_per_sqrt_s: float = 0.0  # random walk of the heading offset besides that of `MotionNoise`
    extra_noise_m: float = 0.0  # independent error of each step along each axis, besides length and direction
    moves: bool = True  # whether a step leads anywhere; never in an irregular mode
    climbs: int = 0  # +1 where steps go up stairs, -1 where they go down
    gait: Gait | None = None  # how the person steps; None where nobody steps; "walking" if the mode moves

    def __post_init__(self) -> None:
        object.__setattr__(self, "context", self.context or self.name)
        object.__setattr__(self, "moves", self.moves and self.context != IRREGULAR)
        object.__setattr__(self, "gait", self.meaning.gait)  # checks the meaning, too
        if not self.moves and self.step_length is _PEOPLE:
            object.__setattr__(self, "step_length", known_length(0.0, STANDING_STD_M))
        if self.carrying_mode not in (None, *CARRYING_MODES):
            raise ValueError(
                f"carrying_mode of mode {self.name!r} must be None or one of {CARRYING_MODES}, "
                f"got {self.carrying_mode!r}"
            )
        may_be_zero = ("heading_std_rad", "heading_drift_rad_per_sqrt_s", "extra_noise_m")
        check_numbers(self, zero=may_be_zero, signed=("heading_offset_rad", "climbs"))

    @property
    def meaning(self) -> Context:
        """Meaning of its context for the stages before the filter."""
        return Context(self.context, self.moves, self.climbs, self.gait, self.heading_offset_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Where modes walk and how unsurely, an entry for each mode."""

    heading_offset_rad: FloatArray  # (M,)
    heading_var_rad2: FloatArray  # (M,) of each step alone
    drift_rad2_per_s: FloatArray  # (M,) of the heading offset, besides that of all modes
    extra_var_m2: FloatArray  # (M,) of a step along each axis

    @classmethod
    def of(cls, modes: Sequence[Mode]) -> Directions:
        """Those of some modes."""
        return cls(
            heading_offset_rad=np.array([m.heading_offset_rad for m in modes]),
            heading_var_rad2=np.array([m.heading_std_rad**2 for m in modes]),
            drift_rad2_per_s=np.array([m.heading_drift_rad_per_sqrt_s**2 for m in modes]),
            extra_var_m2=np.array([m.extra_noise_m**2 for m in modes]),
        )

    def step_var_rad2(self, turned_rad: FloatArray | float) -> FloatArray:
        """Variance (..., M) of the direction of a step alone: who turns in it may walk in any direction in between."""
        return self.heading_var_rad2 + turned_rad * turned_rad / 12.0

    def weighted(self, weights: FloatArray) -> Directions:
        """Of one filter for all modes: the offset of the mode of the highest weight (M,), the mean of the variances."""
        return Directions(
            heading_offset_rad=self.heading_offset_rad[[int(weights.argmax())]],
            heading_var_rad2=np.array([weights @ self.heading_var_rad2]),
            drift_rad2_per_s=np.array([weights @ self.drift_rad2_per_s]),
            extra_var_m2=np.array([weights @ self.extra_var_m2]),
        )


@dataclass(frozen=True)
class MotionNoise:
    """How fast the slow states wander, and what is known at the start.

    A person's log scale keeps its spread: s_k = a s_{k-1} + w with a^2 = 1 - drift^2 / std^2, which forgets in 13,000
    steps, so that after a day the scale is not less known than that of a stranger.
    """

    heading_drift: HeadingDrift = field(default_factory=HeadingDrift)  # of the heading offset in all modes
    initial_heading_offset_std_rad: float = 0.15  # how well the phone's first heading is the person's
    log_scale_std: float = 0.08  # spread of people about the population's step lengths
    log_scale_drift_per_sqrt_step: float = 0.001
    gap_speed_mps: float = 1.0  # standard deviation: in a gap the pedestrian may have gone anywhere at this speed

    def __post_init__(self) -> None:
        check_numbers(self, zero=[name for name in vars(self) if name != "heading_drift"])

    def gap_var_m2(self, gap_s: FloatArray | float) -> FloatArray:
        """Variance of the position along each axis that a time without samples adds."""
        return np.asarray((self.gap_speed_mps * gap_s) ** 2)

    @cached_property
    def log_scale_drift_var(self) -> float:
        """Variance that the log scale gains with each step: that of the drift, at most the spread of people."""
        return min(self.log_scale_drift_per_sqrt_step, self.log_scale_std) ** 2

    @cached_property
    def log_scale_memory(self) -> float:
        """The share a of the log scale that is left a step later."""
        if self.log_scale_std == 0:
            return 1.0
        return float(np.sqrt(1.0 - self.log_scale_drift_var / self.log_scale_std**2))

    @cached_property
    def of_log_scale(self) -> tuple[FloatArray, FloatArray]:
        """F and Q (4, 4) of a step that leads nowhere: only the log scale changes."""
        F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
        F[LOG_SCALE, LOG_SCALE], Q[LOG_SCALE, LOG_SCALE] = self.log_scale_memory, self.log_scale_drift_var
        return read_only(F), read_only(Q)


# A heading that could be anything is uniform on the circle: its variance is pi^2 / 3, and no more.
MAX_HEADING_VARIANCE = np.pi**2 / 3
# Divides where the offset is known exactly: a microradian, squared.
_MIN_HEADING_VARIANCE = 1e-12


def initial_estimate(noise: MotionNoise) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) at the origin."""
    std = np.array([0.0, 0.0, noise.initial_heading_offset_std_rad, noise.log_scale_std])
    return np.zeros(N_STATES), np.diag(std**2)


def predict_heading(
    cov: FloatArray, step: Step, elapsed_s: float, directions: Directions, noise: MotionNoise
) -> FloatArray:
    """Return the covariances (..., M, 4, 4) of the heading offset at a step, before its displacement.

    The offset drifts for `elapsed_s`, the time since the step before, also while the phone lies on a table. Where the
    phone was moved, the offset is free again: its variance grows by `offset_change_std_rad` squared.
    """
    measured_var, unmeasured_var = noise.heading_drift.variances_rad2(
        elapsed_s, step.heading_unknown_s, step.yaw_bias_std_radps, directions.drift_rad2_per_s
    )
    cov = cov.copy()
    cov[..., HEADING_OFFSET, HEADING_OFFSET] += measured_var + unmeasured_var + step.offset_change_std_rad**2
    return bound_heading_variance(cov)


def update_heading(mean: FloatArray, cov: FloatArray, step: Step, frame_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return means (..., M, 4) and covariances (..., M, 4, 4) updated with the measured walking heading of a step.

    The walking heading z is a measurement of frame + device heading + offset state, its innovation wrapped:
    K = P[o, o] / (P[o, o] + R). It is the direction that the body faces: a mode that walks sideways has its own angle
    on top. `frame_rad` is the offset that counts as zero.

    The update corrects the past: steps since the heading was lost are rotated by the correction delta = K innovation.
    The linear update moves the position along the tangent, by the lever l = P[p, o] / P[o, o] times delta. With
    l = J d, d is the displacement that turns with the offset, and the update moves the position along the arc,
    p + (R(delta) - I) d = p + sin(delta) l + (cos(delta) - 1) d, never further than twice the length of d. The lever
    turns with it: P[p, :] gains (R(delta) - I) l P[o, :].
    """
    o = HEADING_OFFSET
    variance = step.walking_heading_std_rad**2
    if not math.isfinite(variance):
        return mean, cov
    innovation = wrap_angle(step.walking_heading_rad - step.device_heading_rad - frame_rad - mean[..., o])
    by_offset = cov[..., :, o] / np.maximum(cov[..., o, o], _MIN_HEADING_VARIANCE)[..., None]
    gain = cov[..., o, o] / (cov[..., o, o] + variance)
    correction_rad = gain * innovation
    cov = cov - gain[..., None, None] * by_offset[..., :, None] * cov[..., None, o, :]
    sine, versine = np.sin(correction_rad), 1.0 - np.cos(correction_rad)
    lever_east, lever_north = by_offset[..., EAST], by_offset[..., NORTH]
    # d = -J l, with J (east, north) = (north, -east)
    moved_east = sine * lever_east + versine * lever_north
    moved_north = sine * lever_north - versine * lever_east
    updated_mean = mean + by_offset * correction_rad[..., None]
    updated_mean[..., EAST] = mean[..., EAST] + moved_east
    updated_mean[..., NORTH] = mean[..., NORTH] + moved_north
    # (R(delta) - I) l is the move (R(delta) - I) d turned by J
    turn = np.broadcast_to(np.eye(N_STATES), cov.shape).copy()
    turn[..., EAST, o] = moved_north
    turn[..., NORTH, o] = -moved_east
    cov = turn @ cov @ turn.swapaxes(-1, -2)
    return updated_mean, 0.5 * (cov + cov.swapaxes(-1, -2))


def expect_first_direction(cov: FloatArray, std_rad: float) -> FloatArray:
    """Covariances (..., M, 4, 4) in which the heading offset is as unsure as the first walking heading.

    Which way the track points is a matter of its frame, but what later directions can still change is not: the first
    offset is known as well as the direction that it comes from, and so was the direction of the steps before. With c
    the covariance of the offset with all else, v its variance and r = std^2 / v: the covariance of all else grows by
    (r - 1) c c' / v, c becomes r c and v becomes std^2.
    """
    o = HEADING_OFFSET
    cov = cov.copy()
    std_rad = min(std_rad, float(np.sqrt(MAX_HEADING_VARIANCE)))
    c, variance = cov[..., :, o].copy(), np.maximum(cov[..., o, o], _MIN_HEADING_VARIANCE)
    ratio = std_rad**2 / variance
    cov += ((ratio - 1) / variance)[..., None, None] * c[..., :, None] * c[..., None, :]
    return cov


class Advance(NamedTuple):
    """A step of the modes, and their predicted means and covariances."""

    motion: StepMotion
    mean: FloatArray  # (..., M, 4)
    cov: FloatArray  # (..., M, 4, 4)
    by_state: FloatArray  # (..., M, 4, 4) F, the derivative with respect to the state before


def advance(
    mean: FloatArray,
    cov: FloatArray,
    step: Step,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    directions: Directions,
    noise: MotionNoise,
) -> Advance:
    """Return the means (..., M, 4) and covariances (..., M, 4, 4) after a step, one length for each mode.

    p_k = p_{k-1} + d as `StepMotion` has it; s_k = a s_{k-1}; P_k = F P_{k-1} F' + Q with F = d (p, o, s)_k /
    d (p, o, s)_{k-1}. The drift of the heading offset comes before the step (`predict_heading`).
    """
    motion = step_motion(
        step.device_heading_rad,
        mean[..., HEADING_OFFSET],
        mean[..., LOG_SCALE],
        length_m,
        length_var_m2,
        directions,
        step.turned_rad,
    )
    # component by component: of so few numbers broadcasting costs more than the product
    east_m, north_m = motion.length_m * motion.sine, motion.length_m * motion.cosine
    predicted_mean = mean.copy()
    predicted_mean[..., EAST] += east_m
    predicted_mean[..., NORTH] += north_m
    predicted_mean[..., LOG_SCALE] *= noise.log_scale_memory
    F, Q = np.empty((2, *mean.shape, N_STATES))
    F[...], Q[...] = noise.of_log_scale
    F[..., EAST, HEADING_OFFSET] = F[..., NORTH, LOG_SCALE] = north_m
    F[..., NORTH, HEADING_OFFSET], F[..., EAST, LOG_SCALE] = -east_m, east_m
    # var(along) u u' + var(across) v v', and u u' + v v' = I
    excess_m2, isotropic_m2 = motion.var_along_m2 - motion.var_across_m2, motion.var_across_m2 + directions.extra_var_m2
    excess_east_m2 = excess_m2 * motion.sine
    Q[..., EAST, EAST] = excess_east_m2 * motion.sine + isotropic_m2
    Q[..., EAST, NORTH] = Q[..., NORTH, EAST] = excess_east_m2 * motion.cosine
    Q[..., NORTH, NORTH] = excess_m2 * motion.cosine * motion.cosine + isotropic_m2
    return Advance(motion, predicted_mean, predict_cov(cov, F, Q), F)


class StepMotion(NamedTuple):
    """Where steps lead and how unsure that is, for arrays of steps or pedestrians (...) and M modes; each (..., M).

    d = L e^s u, u = [sin psi, cos psi], psi = device heading + heading offset + the mode's own offset, and its
    covariance (e^s)^2 var(L) u u' + (L e^s)^2 var(psi) v v', u along and v across the step.
    """

    sine: FloatArray  # of psi
    cosine: FloatArray
    scale: FloatArray  # e^s
    length_m: FloatArray  # L e^s
    var_along_m2: FloatArray
    var_across_m2: FloatArray

    @property
    def along(self) -> FloatArray:
        """The direction u of each step, (..., M, 2)."""
        along = np.empty((*self.sine.shape, 2))
        along[..., EAST], along[..., NORTH] = self.sine, self.cosine
        return along

    @property
    def across(self) -> FloatArray:
        """Of each step v = d u / d psi, (..., M, 2)."""
        return self.along[..., ::-1] * (1.0, -1.0)


def step_motion(
    device_heading_rad: FloatArray | float,
    heading_offset_rad: FloatArray | float,
    log_scale: FloatArray | float,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    directions: Directions,
    turned_rad: FloatArray | float,
) -> StepMotion:
    """`StepMotion` of lengths (..., M) of steps in which the person turned by `turned_rad`."""
    scale = np.exp(log_scale)
    scaled_m = length_m * scale
    psi = device_heading_rad + heading_offset_rad + directions.heading_offset_rad
    return StepMotion(
        sine=np.sin(psi),
        cosine=np.cos(psi),
        scale=scale,
        length_m=scaled_m,
        var_along_m2=scale * scale * length_var_m2,
        var_across_m2=scaled_m * scaled_m * directions.step_var_rad2(turned_rad),
    )


def bound_heading_variance(cov: FloatArray) -> FloatArray:
    """Return covariances whose heading variance is that of a uniform heading at most.

    The covariance with the other states shrinks with it, so that the lever P[p, o] / P[o, o] stays: the present
    heading says less and less about steps from before it was lost.
    """
    variance = cov[..., HEADING_OFFSET, HEADING_OFFSET]
    if max(variance.ravel().tolist()) <= MAX_HEADING_VARIANCE:
        return cov
    share = np.minimum(1.0, MAX_HEADING_VARIANCE / variance)
    bounded = cov.copy()
    bounded[..., :, HEADING_OFFSET] *= share[..., None]
    bounded[..., HEADING_OFFSET, :HEADING_OFFSET] *= share[..., None]
    bounded[..., HEADING_OFFSET, HEADING_OFFSET + 1 :] *= share[..., None]
    return bounded


def second_order_errors(heading_var_rad2: float, log_scale_var: float) -> tuple[float, float]:
    """Root mean square errors along and across a step of unit length that the linear covariance does not know.

    With a heading error e and an error s of the log scale, both normal and independent, of variances v and w, the step
    is e^s (cos e, sin e) in place of (1 + s, e). Along it E[(e^s cos e - 1 - s)^2] = e^2w (1 + e^-2v) / 2 + 1 + w
    - 2 (1 + w) e^(w/2) e^(-v/2). Across it only what the scale adds, E[((e^s - 1) sin e)^2] =
    (e^2w - 2 e^(w/2) + 1) (1 - e^-2v) / 2: e itself is more than sin e. All steps share e and s, so that these errors
    add up as vectors, not as variances. 0 to 1.22 along a step whose scale is known.
    """
    v, w = heading_var_rad2, log_scale_var
    of_scale, of_scale_squared = math.exp(0.5 * w), math.exp(2 * w)
    along = 0.5 * of_scale_squared * (1 + math.exp(-2 * v)) + 1 + w - 2 * (1 + w) * of_scale * math.exp(-0.5 * v)
    across = 0.5 * (of_scale_squared - 2 * of_scale + 1) * (1 - math.exp(-2 * v))
    return math.sqrt(max(along, 0.0)), math.sqrt(max(across, 0.0))


def grow_over_gap(cov: FloatArray, gap_s: float, noise: MotionNoise) -> FloatArray:
    """Covariances (M, 4, 4) after a time without samples: any way walked, any turn taken."""
    grown = cov.copy()
    grown[:, [EAST, NORTH], [EAST, NORTH]] += noise.gap_var_m2(gap_s)
    grown[:, HEADING_OFFSET, HEADING_OFFSET] += noise.heading_drift.unmeasured_rad2(gap_s)
    return bound_heading_variance(grown)
