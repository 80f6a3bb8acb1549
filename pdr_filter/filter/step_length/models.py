"""Step-length models: how long a step is, and how that depends on a model's parameters.

The filter and the calibration use the same ones. docs/methods/step_length.md compares them on real walks.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeGuard

import numpy as np

from pdr_filter.values import (
    STANDARD_GRAVITY_MPS2,
    FloatArray,
    Step,
    check_array,
    check_cov,
    check_numbers,
    pickled,
    read_only,
)


class _Parameters(Protocol):
    @property
    def n_params(self) -> int:
        """Number of parameters p."""
        ...


class LinearStepLengthModel(_Parameters, Protocol):
    """A model that is linear in its parameters: length = regressors(step) @ theta."""

    def regressors(self, step: Step) -> FloatArray:
        """Regressors of one step, shape (p,): also the derivative of the length with respect to theta."""
        ...


class SmoothStepLengthModel(_Parameters, Protocol):
    """A model that is not linear in its parameters; theta may have any leading axes."""

    def length_m(self, step: Step, theta: FloatArray) -> FloatArray:
        """Length in m under theta (..., p), shape (...)."""
        ...

    def jacobian(self, step: Step, theta: FloatArray) -> FloatArray:
        """Derivative of the length with respect to theta (..., p), same shape."""
        ...


#: A step-length model that is linear in its parameters, or one with a Jacobian.
StepLengthModel = LinearStepLengthModel | SmoothStepLengthModel


def length_and_jacobian(model: StepLengthModel, step: Step, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Length in m, shape (...), and its derivative (..., p), for parameters theta (..., p); the length may be negative.

    The jacobian of a linear model is the same for every theta and has the shape (p,). Sums go along the last axis only,
    so that the bits of one theta do not depend on those beside it.
    """
    if _is_linear(model):
        r = np.asarray(model.regressors(step), dtype=float)
        return np.add.reduce(theta * r, axis=-1), r
    if _is_smooth(model):
        return model.length_m(step, theta), model.jacobian(step, theta)
    raise TypeError(f"{type(model).__name__} has neither regressors nor length_m and jacobian")


def _is_linear(model: StepLengthModel) -> TypeGuard[LinearStepLengthModel]:
    return hasattr(model, "regressors")


def _is_smooth(model: StepLengthModel) -> TypeGuard[SmoothStepLengthModel]:
    return hasattr(model, "jacobian")


# Height of somebody of whom it is not known, m: between the means of women and men.
USUAL_HEIGHT_M = 1.70

# --- models from papers ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StaticStepLength:
    """L = k h, theta = (k,) without unit (Tian et al. 2016, eq. 2; Guo et al. 2018, eq. 10)."""

    height_m: float
    n_params: int = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        """(h,)."""
        return np.array([self.height_m])


@dataclass(frozen=True)
class FrequencyStepLength:
    """L = k0 + k1 f, theta = (k0, k1) in m, m s (Zhou et al. 2019, eq. 7: their M1)."""

    n_params: int = 2

    def regressors(self, step: Step) -> FloatArray:
        """(1, f)."""
        return np.array([1.0, step.frequency_hz])


@dataclass(frozen=True)
class FrequencyVarianceStepLength:
    """L = k0 + k1 f_s + k2 sigma_f^2, theta = (k0, k1, k2) in m, m s, s4/m.

    Martinelli et al. (2018), eq. 12; Zhou et al. (2019), eq. 8: their M2. `max_variance` bounds sigma_f^2 in m2/s4:
    the variance of a phone in a trouser pocket reaches ten times that of one in the hand, and a parameter fitted in the
    hand would make giants of them (deviation: the papers have one placement, waist or foot, and no bound).
    `max_frequency_hz` bounds f_s: sprinters reach 4.5 steps per second, and shorter intervals end at a false contact.
    """

    max_variance: float = np.inf
    max_frequency_hz: float = 4.5
    n_params: int = 3

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("max_variance", "max_frequency_hz"))

    def regressors(self, step: Step) -> FloatArray:
        """(1, f_s, sigma_f^2)."""
        frequency_hz = min(step.frequency_hz, self.max_frequency_hz)
        return np.array([1.0, frequency_hz, min(step.variance, self.max_variance)])


@dataclass(frozen=True)
class PeriodPeakStepLength:
    """L = k0 + k1 / f + k2 max(a), theta = (k0, k1, k2) in m, m/s, s2; a = |f| - g (Zhou et al. 2019, eq. 9: M3)."""

    n_params: int = 3

    def regressors(self, step: Step) -> FloatArray:
        """(1, 1 / f, max(a))."""
        return np.array([1.0, 1 / step.frequency_hz, step.magnitude_max_mps2 - STANDARD_GRAVITY_MPS2])


@dataclass(frozen=True)
class WeinbergStepLength:
    """L = k (a_max - a_min)^(1/4), a vertical, theta = (k,) in m^(3/4) s^(1/2).

    Tian et al. (2016), eq. 3; Guo et al. (2018), eq. 11.
    """

    n_params: int = 1

    def regressors(self, step: Step) -> FloatArray:
        """((a_max - a_min)^(1/4),)."""
        return np.array([step.vertical_range_mps2**0.25])


@dataclass(frozen=True)
class MagnitudeRangeStepLength:
    """L = k (max(a) - min(a))^(1/4), a = |f| - g, theta = (k,) (Zhou et al. 2019, eq. 10: M4)."""

    n_params: int = 1

    def regressors(self, step: Step) -> FloatArray:
        """((max(a) - min(a))^(1/4),)."""
        return np.array([(step.magnitude_max_mps2 - step.magnitude_min_mps2) ** 0.25])


@dataclass(frozen=True)
class KimStepLength:
    """L = k (mean |a|)^(1/3), theta = (k,) in m^(2/3) s^(2/3).

    Tian et al. (2016), eq. 4; Guo et al. (2018), eq. 13; Zhou et al. (2019), eq. 12 and the running half of eq. 14: M6
    and M7. Deviations: a is |f| - g and not the vertical, because |f| needs no attitude; Zhou's mean has no modulus,
    which a phone does not allow: without that of the foot's impacts the mean of |f| - g is about zero.
    """

    n_params: int = 1

    def regressors(self, step: Step) -> FloatArray:
        """((mean |a|)^(1/3),)."""
        return np.array([np.cbrt(step.mean_abs_mps2)])


@dataclass(frozen=True)
class TianStepLength:
    """L = k h sqrt(f), theta = (k,) in s^(1/2) (Tian et al. 2016, eq. 9; Guo et al. 2018, eq. 12; Zhou's M5)."""

    height_m: float
    n_params: int = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        """(h sqrt(f),)."""
        return np.array([self.height_m * np.sqrt(step.frequency_hz)])


@dataclass(frozen=True)
class ChenStepLength:
    """L = (0.7 + a (h - 1.75) + b (f - 1.79) h / 1.75) c, theta = (a, b, c), a and c without unit, b in m s.

    Guo et al. (2018), eq. 14, after Chen et al. 2011; all three belong to the person.
    """

    height_m: float
    n_params: int = 3

    def __post_init__(self) -> None:
        check_numbers(self)

    def length_m(self, step: Step, theta: FloatArray) -> FloatArray:
        """Length in m under theta (..., 3)."""
        a, b, c = theta[..., 0], theta[..., 1], theta[..., 2]
        return (0.7 + a * (self.height_m - 1.75) + b * self._quickness(step)) * c

    def jacobian(self, step: Step, theta: FloatArray) -> FloatArray:
        """(c (h - 1.75), c (f - 1.79) h / 1.75, L / c)."""
        a, b, c = theta[..., 0], theta[..., 1], theta[..., 2]
        taller, quicker = self.height_m - 1.75, self._quickness(step)
        return np.stack([c * taller, c * quicker, 0.7 + a * taller + b * quicker], axis=-1)

    def _quickness(self, step: Step) -> float:
        return (step.frequency_hz - 1.79) * self.height_m / 1.75


@dataclass(frozen=True)
class ZhouWalkingStepLength:
    """L = k0 + k1 / f + k2 / sqrt(f) + k3 max(a), a = |f| - g, theta = (k0, k1, k2, k3).

    The walking half of Zhou et al. (2019), eq. 14: M7; the running half is `KimStepLength`, in a mode of its own.
    """

    n_params: int = 4

    def regressors(self, step: Step) -> FloatArray:
        """(1, 1 / f, 1 / sqrt(f), max(a))."""
        f = step.frequency_hz
        return np.array([1.0, 1 / f, 1 / np.sqrt(f), step.magnitude_max_mps2 - STANDARD_GRAVITY_MPS2])


# --- the default ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BounceStepLength:
    """L = k h r A^(1/4), theta = (k,) in s^(1/2) m^(-1/4): the fourth root of the bounce, as Weinberg has it.

    A is the amplitude of the vertical force at the step's own frequency. What the models above take of the
    acceleration depends on where the phone is: the impact of the heel, which a trouser pocket passes on and a hand does
    not, is in the range, the variance and the mean modulus, but hardly in A. The cadence has no part beside A: people
    step faster where they step harder, and with A known it says nothing about the length of strangers
    (docs/methods/step_length.md).

    r is for the steps that are shorter than the person's usual ones:

    - where A, over two steps because left and right differ in a pocket, is below its usual value B, as when people stop
      or shuffle, (A / B)^(1/4);
    - where the person turns at w rad/s, as in a small room or on the spot, exp(-(w / 2.2)^2);
    - a step from rest, which begins with the feet together, is half a step;
    - beyond 2.4 steps a second, where a step was found twice, it is the speed that stays: 2.4 / f.

    Amplitudes and turn rates beyond their limits count as the limits: a length is between 0 and 0.44 h.
    """

    height_m: float = USUAL_HEIGHT_M
    max_amplitude_mps2: float = 3.0  # a larger one is the give of a soft arm, not the body's
    min_amplitude_mps2: float = 0.3
    max_frequency_hz: float = 2.4  # 144 steps a minute: the quickest walking
    # 2.0 to 2.15 are best whichever of the sites of `_BOUNCE_K` is left out; up to 2.3 there is no difference.
    turn_scale_radps: float = 2.2
    max_turn_rate_radps: float = 1.5  # half a turn in two seconds: quicker ones are of the hand
    n_params: int = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        """(h r A^(1/4),)."""
        amplitude_mps2 = min(max(step.vertical_amplitude_mps2, self.min_amplitude_mps2), self.max_amplitude_mps2)
        return np.array([self.height_m * self._part_of_usual(step) * amplitude_mps2**0.25])

    def _part_of_usual(self, step: Step) -> float:
        turn_rate_radps = min(step.turn_rate_radps, self.max_turn_rate_radps)
        part = math.exp(-((turn_rate_radps / self.turn_scale_radps) ** 2))
        part *= min(self.max_frequency_hz / step.frequency_hz, 1.0)
        if step.from_rest:
            return 0.5 * part
        if step.usual_amplitude_mps2 <= 0 or step.stride_amplitude_mps2 <= 0:
            return part
        return part * min(step.stride_amplitude_mps2 / step.usual_amplitude_mps2, 1.0) ** 0.25


def uneven_var_m2(step: Step) -> float:
    """Variance that a step has besides that of an even one."""
    return (_PAUSE_STD_M if step.from_rest else 0.0) ** 2 + (_UNEVEN_STD_M * step.unevenness) ** 2


# --- fits -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StepLengthFit:
    """A model with its parameters, their covariance, and what it leaves unexplained."""

    model: StepLengthModel
    theta: FloatArray  # (p,)
    theta_cov: FloatArray  # (p, p)
    residual_std_m: float  # standard deviation of a single step about the model

    __reduce__ = pickled

    def __post_init__(self) -> None:
        check_numbers(self, zero=("residual_std_m",))
        object.__setattr__(self, "theta", read_only(self.theta))
        object.__setattr__(self, "theta_cov", read_only(self.theta_cov))
        p = self.model.n_params
        check_array("theta", self.theta, shape=(p,))
        check_array("theta_cov", self.theta_cov, shape=(p, p))
        check_cov(self.theta_cov, "theta_cov")

    def predict(self, step: Step) -> tuple[float, float]:
        """Length in m (never negative) and its variance in m2: J theta_cov J' + residual variance, J = dL / dtheta."""
        length, parameter_var = np.maximum(_moments(self.model, step, self.theta, self.theta_cov), 0.0)
        return float(length), float(parameter_var) + self.residual_std_m**2


@dataclass(frozen=True, eq=False)
class StepLengths:
    """Lengths of one step under several fits at once: but for rounding those of each `StepLengthFit.predict`."""

    fits: tuple[StepLengthFit, ...]

    @cached_property
    def _linear(self) -> tuple[LinearStepLengthModel, ...]:
        return tuple({_key(fit.model): fit.model for fit in self.fits if _is_linear(fit.model)}.values())

    @cached_property
    def _of_terms(self) -> FloatArray:
        """Coefficients (2M, T) of lengths, then of variances, both linear in the regressors r and the products r r'."""
        starts, n_terms = dict[Hashable, int](), 0
        for model in self._linear:
            starts[_key(model)], n_terms = n_terms, n_terms + model.n_params + model.n_params**2
        coefficients = np.zeros((2, len(self.fits), n_terms))
        for (of_length, of_var), fit in zip(coefficients.swapaxes(0, 1), self.fits, strict=True):
            if _is_linear(fit.model):
                start, p = starts[_key(fit.model)], fit.model.n_params
                of_length[start : start + p] = fit.theta
                of_var[start + p : start + p + p * p] = fit.theta_cov.ravel()
        return coefficients.reshape(2 * len(self.fits), n_terms)

    @cached_property
    def residual_var_m2(self) -> FloatArray:
        """Variance of the length of a step about each fit, (M,)."""
        return np.array([fit.residual_std_m**2 for fit in self.fits])

    def predict(self, step: Step) -> tuple[FloatArray, FloatArray]:
        """Lengths in m (never negative) and their variances in m2, shape (M,) each."""
        length, parameter_var = self.moments(step)
        return length, parameter_var + self.residual_var_m2

    def moments(self, step: Step) -> tuple[FloatArray, FloatArray]:
        """Lengths in m (never negative) and their variances in m2 that are due to the parameters, shape (M,) each."""
        terms: list[float] = []
        for model in self._linear:
            r = np.asarray(model.regressors(step)).tolist()
            terms += r
            terms += [a * b for a in r for b in r]
        moments = self._of_terms.dot(np.array(terms)).reshape(2, len(self.fits))
        for i, fit in self._smooth:
            moments[:, i] = _moments(fit.model, step, fit.theta, fit.theta_cov)
        moments = np.maximum(moments, 0.0)
        return moments[0], moments[1]

    @cached_property
    def _smooth(self) -> list[tuple[int, StepLengthFit]]:
        return [(i, fit) for i, fit in enumerate(self.fits) if not _is_linear(fit.model)]


def _key(model: StepLengthModel) -> Hashable:
    """The model itself, whose equals share their regressors; of a class without a hash its identity."""
    try:
        hash(model)
    except TypeError:
        return id(model)
    return model


def _moments(
    model: StepLengthModel, step: Step, theta: FloatArray, theta_cov: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Length (...,) and its variance (...,) due to the parameters, for theta (..., p) and theta_cov (..., p, p).

    The length may be negative, and the variance by its rounding, where the covariance was estimated.
    """
    length, jacobian = length_and_jacobian(model, step, theta)
    products = theta_cov * (jacobian[..., :, None] * jacobian[..., None, :])
    return length, np.add.reduce(products.reshape(*products.shape[:-2], -1), axis=-1)


def known_length(length_m: float, std_m: float, shared_std_m: float = 0.0) -> StepLengthFit:
    """A fit of eq. 12 that gives one length whatever the step: k1 = k2 = 0.

    `std_m` is that of single steps, `shared_std_m` that of what all steps of a walk have in common.
    """
    theta, theta_cov = np.array([length_m, 0.0, 0.0]), np.diag([shared_std_m**2, 0.0, 0.0])
    return StepLengthFit(FrequencyVarianceStepLength(), theta, theta_cov, std_m)


#: Standard deviation of single steps of one person about any of the models, m.
RESIDUAL_STD_M = 0.06
# What a step from rest has besides. It is half a step, or what is between two contacts that were found: in the pauses
# of walks with a continuous reference (oxiod, tyrex; 19) people went 0.7 m further, in those of ms_indoor half a step
# is right. 0.7 m in one of four.
_PAUSE_STD_M = 0.35
# What a step has besides whose duration is not the usual one, by so many times the part by which it differs: in a turn,
# a halt, or where a contact was missed. Most likely of 3,600 steps of walking with a continuous reference (oxiod); of
# 1,500 on tyrex it would be 0.95.
_UNEVEN_STD_M = 0.6
# k of men and women, text of eq. 2 of Tian et al. 2016; the distances of ten people over 28 m have a standard deviation
# of 3.58 m (Table VII).
_STATIC_K = {"M": 0.415, "F": 0.413}
_STATIC_RELATIVE_STD = 3.58 / 28


def static_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """The static model with the printed k; gender "M", "F" or unknown."""
    return one_parameter_fit(StaticStepLength(height_m), of_gender(_STATIC_K, gender), _STATIC_RELATIVE_STD)


# Of `BounceStepLength`: fitted to the distances of 174 recordings at five sites, each with the same weight (humolire,
# ms_indoor, oxiod, tyrex, ipol; tests/benchmarks/step_length.py), which gives 0.336 to 0.339 as r takes A of two
# steps or of one. Its standard deviation is the spread of sites, 4 %, over the root of five. Single steps scatter by
# 0.06 m about the model with the phone in the hand, by 0.12 m in a trouser pocket.
_BOUNCE_K, _BOUNCE_K_STD, _BOUNCE_RESIDUAL_STD_M = 0.34, 0.006, 0.08


def bounce_fit(height_m: float | None = None) -> StepLengthFit:
    """`BounceStepLength` for people in general.

    How people differ from it is not in `theta_cov`: it is one factor for all steps of a person, see `scale_std`.
    """
    model = BounceStepLength() if height_m is None else BounceStepLength(height_m=height_m)
    return StepLengthFit(model, np.array([_BOUNCE_K]), np.array([[_BOUNCE_K_STD**2]]), _BOUNCE_RESIDUAL_STD_M)


# Of the log step scale of people left out together with their site: 6.6 % with the heights that are known, 8.4 %
# without (docs/benchmarks.md). Those are few people at few sites, and strangers elsewhere were off by up to
# 20 %: rounded up, more so for those of whom nothing is known.
_SCALE_STD_OF_KNOWN_HEIGHT, _SCALE_STD = 0.07, 0.10


def scale_std(height_m: float | None) -> float:
    """Relative standard deviation of all step lengths of a person together about `bounce_fit` for that height."""
    return _SCALE_STD if height_m is None else _SCALE_STD_OF_KNOWN_HEIGHT


# A step of walking at 1.85 Hz with the phone in the hand: medians over two sites.
TYPICAL_STEP = Step(0.54, 0.54, 0.54, 1.85, 4.0, 3.5, -3.5, 13.8, 6.8, 1.7, 0.0, 0.0, vertical_amplitude_mps2=2.4)
# One person's scale differs by so much between walks: 1.7 to 2.8 % over nine walks of one, by the model
# (docs/benchmarks.md, one walk left out).
RECORDING_STD = 0.025


def of_gender(values: dict[str, float], gender: str | None) -> float:
    """Return the value for a gender "M" or "F", or the mean of both if the gender is not known."""
    return values.get(gender or "", sum(values.values()) / len(values))


def one_parameter_fit(model: StepLengthModel, k: float, relative_std: float) -> StepLengthFit:
    """Return the fit of a model with one parameter k whose standard deviation between people is `k * relative_std`.

    Single steps scatter by `RESIDUAL_STD_M`.
    """
    return StepLengthFit(model, np.array([k]), np.array([[(k * relative_std) ** 2]]), RESIDUAL_STD_M)
