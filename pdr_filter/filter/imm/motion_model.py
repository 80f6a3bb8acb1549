"""Motion model of the filter: modes, process noise, and the growth of covariances between steps.

The state of a mode is (east in m, north in m, heading offset in rad, log step scale). The heading offset is the walking
heading minus the device heading. The step scale is the factor of the person on every step length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from pdr_filter.filter.step_length.models import (
    TYPICAL_STEP,
    StepLengthFit,
    bounce_fit,
    constant_fit,
    length_and_jacobian,
)
from pdr_filter.values import (
    CARRYING_MODES,
    Context,
    FloatArray,
    Gait,
    HeadingDrift,
    check_numbers,
    check_step_length,
    read_only,
)

EAST, NORTH, HEADING_OFFSET, LOG_SCALE = range(4)
N_STATES = 4
# Context that no classifier has: the phone is moved by hand while the pedestrian stays in place.
IRREGULAR = "irregular"
# Standard deviation along each axis of a step without displacement.
STANDING_STD_M = 0.02


_POPULATION_FIT = bounce_fit()


@dataclass(frozen=True, eq=False, repr=False)
class Mode:
    """Motion model of the filter for one context: step length, direction and meaning of its steps.

    The classifier's probability of `context` is the evidence for the mode.

    Attributes
    ----------
    name : str
        Unique name of the mode.
    context : str, default the name
        Context whose probability is the evidence for the mode, or "irregular" for handling of the phone.
    step_length : StepLengthFit, default `bounce_fit()`
        Step length in this mode. The default is the step length of the population. It has no effect if `moves` is
        False.
    heading_offset_rad : float, default 0.0
        Walking heading minus the heading that the body faces, in rad: +pi/2 for steps to the right.
    heading_std_rad : float, default 0.1
        Standard deviation in rad of the walking heading of a step, independent between steps.
    carrying_mode : str, optional
        Carrying mode whose probability is further evidence for the mode. None stands for any carrying mode.
    heading_drift_rad_per_sqrt_s : float, default 0.0
        Random walk of the heading offset in rad per square root of a second, in addition to the drift in `MotionNoise`.
    extra_noise_m : float, default 0.0
        Standard deviation in m of each step along each axis, in addition to the errors of length and direction.
    moves : bool, default True
        True if a step displaces the pedestrian. Always False for the context "irregular".
    climbs : int, default 0
        +1 if steps lead up stairs, -1 if they lead down, 0 on level ground.
    gait : {"walking", "running"}, optional
        Type of the steps. None means that a pedestrian in this mode makes no steps. The default is "walking" if `moves`
        is True.

    Raises
    ------
    ValueError
        If a number, `climbs`, `gait` or `carrying_mode` is not allowed, or if a typical step of level walking is not
        0.05 to 3 m long. The message names the field.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> resting = pdr.Mode("resting", moves=False)
    >>> treadmill = pdr.Mode("treadmill", moves=False, gait="walking")  # steps without displacement
    >>> up = pdr.Mode("up", step_length=pdr.known_length(0.29, 0.05), climbs=1)
    >>> resting.gait, treadmill.gait, up.gait
    (None, 'walking', 'walking')
    """

    name: str
    context: str = ""
    step_length: StepLengthFit = _POPULATION_FIT
    heading_offset_rad: float = 0.0
    heading_std_rad: float = 0.1
    carrying_mode: str | None = None
    heading_drift_rad_per_sqrt_s: float = 0.0
    extra_noise_m: float = 0.0
    moves: bool = True
    climbs: int = 0
    gait: Gait | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.step_length, StepLengthFit):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(
                f"step_length of mode {self.name!r} must be a StepLengthFit, got {self.step_length!r}: give a length "
                "in m with its deviations as pdr.known_length(0.7, 0.05), or a model with its parameters as "
                "pdr.StepLengthFit(model, theta, theta_cov, residual_std_m)"
            )
        object.__setattr__(self, "context", self.context or self.name)
        object.__setattr__(self, "moves", self.moves and self.context != IRREGULAR)
        object.__setattr__(self, "gait", self.meaning.gait)  # also checks climbs and gait
        if not self.moves and self.step_length is _POPULATION_FIT:
            object.__setattr__(self, "step_length", constant_fit(0.0, STANDING_STD_M))
        if self.carrying_mode not in (None, *CARRYING_MODES):
            raise ValueError(
                f"carrying_mode of mode {self.name!r} must be None or one of {CARRYING_MODES}, "
                f"got {self.carrying_mode!r}: correct the spelling, or leave it out for any carrying mode"
            )
        if self.moves and self.gait == "walking" and not self.climbs:
            length_m = float(length_and_jacobian(self.step_length.model, TYPICAL_STEP, self.step_length.theta)[0])
            if not math.isnan(length_m):
                check_step_length(f"the typical step length of mode {self.name!r}", length_m)
        may_be_zero = ("heading_std_rad", "heading_drift_rad_per_sqrt_s", "extra_noise_m")
        check_numbers(self, zero=may_be_zero, signed=("heading_offset_rad", "climbs"))

    def __repr__(self) -> str:
        fit, gait = self.step_length, "walking" if self.moves else None
        length_m = float(length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)[0])
        usual = {f.name: f.default for f in fields(self)[1:]} | {"context": self.name, "step_length": fit, "gait": gait}
        own = [f", {name}={value!r}" for name, value in vars(self).items() if value != usual.get(name, value)]
        return f"Mode({self.name!r}, {type(fit.model).__name__}, {length_m:.2f} m for a typical step{''.join(own)})"

    @property
    def meaning(self) -> Context:
        """Meaning of the context of this mode, as used by the stages before the filter."""
        return Context(self.context, self.moves, self.climbs, self.gait, self.heading_offset_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Walking directions of the modes relative to the body, and their variances."""

    heading_offset_rad: FloatArray  # (M,) walking heading minus the heading that the body faces
    heading_var_rad2: FloatArray  # (M,) variance of the direction of a single step
    # (M,) variance rate of the heading offset, in addition to the drift that all modes share.
    drift_rad2_per_s: FloatArray
    extra_var_m2: FloatArray  # (M,) additional variance of a step along each axis

    @classmethod
    def of(cls, modes: Sequence[Mode]) -> Directions:
        """Return the walking directions of M modes.

        The heading offset, heading noise, heading drift and extra position noise are those in the fields of each
        `Mode`.
        """
        return cls(
            heading_offset_rad=np.array([m.heading_offset_rad for m in modes]),
            heading_var_rad2=np.array([m.heading_std_rad**2 for m in modes]),
            drift_rad2_per_s=np.array([m.heading_drift_rad_per_sqrt_s**2 for m in modes]),
            extra_var_m2=np.array([m.extra_noise_m**2 for m in modes]),
        )

    def step_var_rad2(self, turned_rad: FloatArray | float) -> FloatArray:
        """Return the variance (..., M) of the direction of a single step, rad2, for each of M modes.

        A step in a curve may lead anywhere in the range `turned_rad` (`Step.turned_rad`), which has the variance
        turned_rad^2 / 12.
        """
        return self.heading_var_rad2 + turned_rad * turned_rad / 12.0

    def of_one_filter(self, weights: FloatArray) -> Directions:
        """Return the directions of a single filter for all modes, with mode weights (M,).

        The heading offset belongs to the mode with the highest weight. Variances are means weighted by mode.
        """
        return Directions(
            heading_offset_rad=self.heading_offset_rad[[int(weights.argmax())]],
            heading_var_rad2=np.array([weights @ self.heading_var_rad2]),
            drift_rad2_per_s=np.array([weights @ self.drift_rad2_per_s]),
            extra_var_m2=np.array([weights @ self.extra_var_m2]),
        )


@dataclass(frozen=True)
class MotionNoise:
    """Process noise of the slow states, and initial uncertainties.

    Attributes
    ----------
    heading_drift : HeadingDrift
        Drift of the heading offset in all modes.
    initial_heading_offset_std_rad : float, default 0.15
        Standard deviation in rad of the heading offset at the start.
    log_scale_std : float, default 0.08
        Standard deviation between people of the log step scale.
    log_scale_drift_per_sqrt_step : float, default 0.001
        Random walk of the log step scale per square root of a step.
    gap_speed_mps : float, default 1.0
        Standard deviation in m/s of the speed along each axis during a gap, in any direction.

    Raises
    ------
    ValueError
        If a number is negative or not finite.

    Notes
    -----
    The log scale is a stationary process, s_k = a s_{k-1} + w with a^2 = 1 - drift^2 / std^2. The default drift forgets
    the scale after about 13,000 steps. The variance of the scale therefore never exceeds the variance between people,
    even after a day.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.imm.motion_model import MotionNoise
    >>> noise = MotionNoise(log_scale_std=0.05)
    >>> noise.gap_var_m2(3.0)
    array(9.)
    """

    heading_drift: HeadingDrift = field(default_factory=HeadingDrift)
    initial_heading_offset_std_rad: float = 0.15
    log_scale_std: float = 0.08
    log_scale_drift_per_sqrt_step: float = 0.001
    gap_speed_mps: float = 1.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=[name for name in vars(self) if name != "heading_drift"])

    def gap_var_m2(self, gap_s: FloatArray | float) -> FloatArray:
        """Return the variance that a gap adds to the position along each axis.

        Parameters
        ----------
        gap_s : float or array
            Duration in s without samples.

        Returns
        -------
        array
            Variance in m2, with the shape of `gap_s`.
        """
        return np.asarray((self.gap_speed_mps * gap_s) ** 2)

    @cached_property
    def log_scale_drift_var(self) -> float:
        """Variance that a step adds to the log scale.

        It is at most the variance between people.
        """
        return min(self.log_scale_drift_per_sqrt_step, self.log_scale_std) ** 2

    @cached_property
    def log_scale_memory(self) -> float:
        """Factor a (0 to 1) by which the log scale of the step length is multiplied in each step."""
        if self.log_scale_std == 0:
            return 1.0
        return float(np.sqrt(1.0 - self.log_scale_drift_var / self.log_scale_std**2))

    @cached_property
    def of_log_scale(self) -> tuple[FloatArray, FloatArray]:
        """Transition matrix F and process noise Q, (4, 4) each, of a step in which only the log scale changes."""
        F, Q = np.eye(N_STATES), np.zeros((N_STATES, N_STATES))
        F[LOG_SCALE, LOG_SCALE], Q[LOG_SCALE, LOG_SCALE] = self.log_scale_memory, self.log_scale_drift_var
        return read_only(F), read_only(Q)


# Variance rate of the position along each axis while the phone moves without a step, in m2/s. The maximum-likelihood
# estimate from the errors between waypoints is 0.12 on ipin2023 and ms_indoor (45 legs with such motion, 299 s; half of
# it costs 1.4 in log-likelihood, and twice 2.4). On tyrex, which was held out, eleven pauses give 0.08. In simulated
# walks in a room, where bouts of one to three steps are not detected, it is 0.35. The displacement is a random walk,
# because it does not grow in proportion to the time of handling.
_STEPLESS_M2_PER_S = 0.1


def stepless_var_m2(stepless_s: FloatArray | float) -> FloatArray:
    """Return the variance in m2 that a time of motion without steps adds to the position along each axis.

    The pedestrian may have made steps in this time that were not detected (`Step.stepless_s`).
    """
    return np.asarray(_STEPLESS_M2_PER_S * stepless_s)


# Variance of a heading that is uniform on the circle, which is the largest possible one: pi^2 / 3.
MAX_HEADING_VARIANCE = np.pi**2 / 3


def initial_estimate(noise: MotionNoise) -> tuple[FloatArray, FloatArray]:
    """Return the mean (4,) and covariance (4, 4) of the state at the origin."""
    std = np.array([0.0, 0.0, noise.initial_heading_offset_std_rad, noise.log_scale_std])
    return np.zeros(N_STATES), np.diag(std**2)


def bound_heading_variance(cov: FloatArray) -> FloatArray:
    """Return covariances with a heading variance of at most pi^2 / 3, as for a uniformly distributed heading.

    The covariances with the other states are scaled by the same factor, so that the lever P[p, o] / P[o, o] does not
    change. A heading measured now then has less and less influence on steps made before the heading was lost.
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


def bounded_position_cov(cov_m2: FloatArray, reach_m: FloatArray | float) -> FloatArray:
    """Return covariances (..., 2, 2) in m2 with a standard deviation of at most `reach_m` (...) along each axis.

    A pedestrian is not farther from the last known position than the way walked. The linear covariance is larger if the
    heading is unknown: the variance v of an angle gives the error v^(1/2) across a way of length one, and the true
    error is E[sin^2]^(1/2) = ((1 - exp(-2 v)) / 2)^(1/2), which is below 0.71. If the heading changes all the time
    without being measured, the pedestrian stays near the last known position, at the distance of the way from the
    estimate.
    """
    most_m2 = (1.0 - 1e-9) * np.square(reach_m)  # below the limit after rounding
    exceeds = cov_m2[..., 0, 0] + cov_m2[..., 1, 1] > most_m2
    if not np.count_nonzero(exceeds):  # `any` of a single number takes twice as long
        return cov_m2
    var_m2, axes = np.linalg.eigh(cov_m2)
    var_m2 = np.minimum(var_m2, np.asarray(most_m2)[..., None])
    bounded = (axes * var_m2[..., None, :]) @ axes.swapaxes(-1, -2)
    return np.where(exceeds[..., None, None], 0.5 * (bounded + bounded.swapaxes(-1, -2)), cov_m2)


def reach_m(way_m: FloatArray, std_m: FloatArray) -> FloatArray:
    """Return the largest possible standard deviations (N,) in m of positions that are one walk apart.

    `way_m` (N,) is the way walked until each position, and `std_m` (N,) are standard deviations of the positions. The
    result is the smallest std_m + |difference of way_m| over all positions: from one position to another, the error
    grows by at most the way between both.
    """
    since = way_m + np.minimum.accumulate(std_m - way_m)
    until = np.minimum.accumulate((std_m + way_m)[::-1])[::-1] - way_m
    return np.minimum(since, until)


def second_order_errors(heading_var_rad2: float, log_scale_var: float) -> tuple[float, float]:
    """Return the root mean square errors along and across a step of length one that the linear covariance neglects.

    Let h be the heading error in rad and s the error of the log scale, normal and independent, with variances v and w.
    The step is exp(s) (cos h, sin h), and the linear model has (1 + s, h) instead.

    - Along the step, E[(exp(s) cos h - 1 - s)^2] =
      exp(2 w) (1 + exp(-2 v)) / 2 + 1 + w - 2 (1 + w) exp(w / 2) exp(-v / 2).
    - Across the step, only the effect of the scale is added, E[((exp(s) - 1) sin h)^2] =
      (exp(2 w) - 2 exp(w / 2) + 1) (1 - exp(-2 v)) / 2. The linear error h is already larger than sin h.

    All steps share h and s, so that these errors add up as vectors and not as variances. For a known scale the error
    along the step is between 0 and 1.22.
    """
    v, w = heading_var_rad2, log_scale_var
    of_scale, of_scale_squared = math.exp(0.5 * w), math.exp(2 * w)
    along = 0.5 * of_scale_squared * (1 + math.exp(-2 * v)) + 1 + w - 2 * (1 + w) * of_scale * math.exp(-0.5 * v)
    across = 0.5 * (of_scale_squared - 2 * of_scale + 1) * (1 - math.exp(-2 * v))
    return math.sqrt(max(along, 0.0)), math.sqrt(max(across, 0.0))


def grow_over_gap(cov: FloatArray, gap_s: float, noise: MotionNoise) -> FloatArray:
    """Return covariances (M, 4, 4) after a gap, in which the pedestrian may have walked and turned in any way."""
    grown = cov.copy()
    grown[:, [EAST, NORTH], [EAST, NORTH]] += noise.gap_var_m2(gap_s)
    grown[:, HEADING_OFFSET, HEADING_OFFSET] += noise.heading_drift.unmeasured_rad2(gap_s)
    return bound_heading_variance(grown)
