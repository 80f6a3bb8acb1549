"""Step-length models, and fits of their parameters.

A model gives the length of a step as a function of the step and of parameters theta. The filter and the calibration use
the same models. docs/methods/step_length.md compares them on real walks. The pages of docs/methods that are named after
the papers (martinelli2018, tian2016, guo2018, zhou2019) have the full references.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
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
    check_number,
    check_numbers,
    check_step_length,
    limits,
    read_only,
    reduction,
)


class _Parameters(Protocol):
    @property
    def n_params(self) -> int:
        """Number of parameters p."""
        ...


# Classes of models inherit from these two protocols, so that their methods need no docstrings of their own.
class _Linear(Protocol):
    def regressors(self, step: Step) -> FloatArray:
        """Return the regressors of one step, which are also the derivative of its length with respect to theta.

        Parameters
        ----------
        step : Step
            Step whose length is modelled.

        Returns
        -------
        (p,) array
            Regressors, one for each parameter.
        """
        ...


class _Smooth(Protocol):
    def length_m(self, step: Step, theta: FloatArray) -> FloatArray:
        """Return the length of a step for given parameters.

        Parameters
        ----------
        step : Step
            Step whose length is modelled.
        theta : (..., p) array
            Parameters, with any leading axes.

        Returns
        -------
        (...) array
            Length in m.
        """
        ...

    def jacobian(self, step: Step, theta: FloatArray) -> FloatArray:
        """Return the derivative of the length with respect to the parameters.

        Parameters
        ----------
        step : Step
            Step whose length is modelled.
        theta : (..., p) array
            Parameters, with any leading axes.

        Returns
        -------
        (..., p) array
            Derivative of the length in m with respect to each parameter.
        """
        ...


class LinearStepLengthModel(_Parameters, _Linear, Protocol):
    """Protocol of a step-length model that is linear in its parameters.

    The length in m is `regressors(step) @ theta`, with p parameters theta. Any class with `n_params` and `regressors`
    fulfils the protocol. A frozen dataclass is recommended, because instances should be hashable and can then be saved.

    Attributes
    ----------
    n_params : int
        Number p of parameters.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> @dataclass(frozen=True)
    ... class Affine:
    ...     n_params: int = 2
    ...
    ...     def regressors(self, step):
    ...         return np.array([1.0, step.frequency_hz])
    >>> fit = pdr.StepLengthFit(Affine(), np.array([0.2, 0.25]), np.zeros((2, 2)), residual_std_m=0.06)
    >>> length_m, var_m2 = fit.predict(TYPICAL_STEP)
    >>> round(length_m, 4), round(var_m2, 4)
    (0.6625, 0.0036)
    """


class SmoothStepLengthModel(_Parameters, _Smooth, Protocol):
    """Protocol of a step-length model that is a smooth, nonlinear function of its parameters.

    Any class with `n_params`, `length_m` and `jacobian` fulfils the protocol. The parameters theta may have leading
    axes, so that one call evaluates many parameter vectors.

    Attributes
    ----------
    n_params : int
        Number p of parameters.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> @dataclass(frozen=True)
    ... class PowerLaw:
    ...     n_params: int = 2
    ...
    ...     def length_m(self, step, theta):
    ...         return theta[..., 0] * step.frequency_hz ** theta[..., 1]
    ...
    ...     def jacobian(self, step, theta):
    ...         power = step.frequency_hz ** theta[..., 1]
    ...         return np.stack([power, theta[..., 0] * power * np.log(step.frequency_hz)], axis=-1)
    >>> fit = pdr.StepLengthFit(PowerLaw(), np.array([0.5, 0.6]), np.zeros((2, 2)), residual_std_m=0.06)
    >>> round(fit.predict(TYPICAL_STEP)[0], 3)
    0.723
    """


#: A step-length model that is linear in its parameters, or one with a Jacobian.
StepLengthModel = LinearStepLengthModel | SmoothStepLengthModel


def length_and_jacobian(model: StepLengthModel, step: Step, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the length of a step and its derivative with respect to the parameters of a model.

    Parameters
    ----------
    model : LinearStepLengthModel or SmoothStepLengthModel
        Step-length model with p parameters.
    step : Step
        Step whose length is modelled.
    theta : (..., p) array
        Parameters, with any leading axes.

    Returns
    -------
    length_m : (...) array
        Length in m, which may be negative for extreme parameters.
    jacobian : (..., p) array
        Derivative of the length with respect to theta. For a linear model it does not depend on theta and has the shape
        (p,).

    Raises
    ------
    TypeError
        If the model has neither `regressors` nor `length_m` and `jacobian`.

    Notes
    -----
    Sums run along the last axis only. The result for one theta is therefore identical, bit by bit, whether theta
    is passed alone or together with others.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, FrequencyStepLength, length_and_jacobian
    >>> length_m, jacobian = length_and_jacobian(FrequencyStepLength(), TYPICAL_STEP, np.array([0.2, 0.25]))
    >>> round(float(length_m), 4), jacobian
    (0.6625, array([1.  , 1.85]))
    """
    if is_linear(model):
        r = np.asarray(model.regressors(step), dtype=float)
        return np.add.reduce(theta * r, axis=-1), r
    if _is_smooth(model):
        return model.length_m(step, theta), model.jacobian(step, theta)
    raise TypeError(
        f"step-length model {type(model).__name__} has neither regressors nor length_m and jacobian: define the "
        "methods of LinearStepLengthModel or of SmoothStepLengthModel in pdr_filter.protocols"
    )


def is_linear(model: StepLengthModel) -> TypeGuard[LinearStepLengthModel]:
    """Return True if a model has regressors, so that it is linear in its parameters."""
    return hasattr(model, "regressors")


def _is_smooth(model: StepLengthModel) -> TypeGuard[SmoothStepLengthModel]:
    return hasattr(model, "jacobian")


# Body height of a person of unknown height, in m: between the means of women and men.
USUAL_HEIGHT_M = 1.70


# --- models from papers ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StaticStepLength(_Linear):
    """Step length proportional to the body height, L = k h.

    The parameter theta = (k,) has no unit.

    Attributes
    ----------
    height_m : float
        Body height h in m.

    Notes
    -----
    Tian et al. (2016), eq. 2; Guo et al. (2018), eq. 10.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, StaticStepLength
    >>> StaticStepLength(height_m=1.7).regressors(TYPICAL_STEP).round(3)
    array([1.7])
    """

    height_m: float
    n_params = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        return np.array([self.height_m])


@dataclass(frozen=True)
class FrequencyStepLength(_Linear):
    """Step length linear in the step frequency, L = k0 + k1 f.

    The parameters are theta = (k0, k1) in m and m s.

    Notes
    -----
    Model M1 of Zhou et al. (2019), eq. 7.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, FrequencyStepLength
    >>> FrequencyStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.  , 1.85])
    """

    n_params = 2

    def regressors(self, step: Step) -> FloatArray:
        return np.array([1.0, step.frequency_hz])


@dataclass(frozen=True)
class FrequencyVarianceStepLength(_Linear):
    """Step length linear in step frequency and variance, L = k0 + k1 f_s + k2 sigma_f^2.

    The parameters are theta = (k0, k1, k2) in m, m s and s4/m. sigma_f^2 is the variance of the magnitude of the
    specific force over the step.

    Attributes
    ----------
    max_variance : float, default infinity
        Upper bound of sigma_f^2 in m2/s4; larger values count as the bound. The variance of a phone in a trouser pocket
        reaches ten times the variance of a phone in the hand. Parameters that were fitted in the hand would then give
        far too long steps.
    max_frequency_hz : float, default 4.5
        Upper bound of f_s in Hz; larger values count as the bound. Sprinters reach 4.5 steps per second. Shorter
        intervals end at a false contact.

    Raises
    ------
    ValueError
        If a field is not a positive number (the bounds may be infinite).

    Notes
    -----
    Martinelli et al. (2018), eq. 12; model M2 of Zhou et al. (2019), eq. 8. The bounds are a deviation: each
    paper has only one placement of the sensor (waist or foot) and no bound.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, FrequencyVarianceStepLength
    >>> FrequencyVarianceStepLength(max_variance=3.0).regressors(TYPICAL_STEP).round(3)
    array([1.  , 1.85, 3.  ])
    """

    max_variance: float = np.inf
    max_frequency_hz: float = 4.5
    n_params = 3

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("max_variance", "max_frequency_hz"))

    def regressors(self, step: Step) -> FloatArray:
        frequency_hz = min(step.frequency_hz, self.max_frequency_hz)
        return np.array([1.0, frequency_hz, min(step.variance, self.max_variance)])


@dataclass(frozen=True)
class PeriodPeakStepLength(_Linear):
    """Step length linear in step duration and acceleration maximum, L = k0 + k1 / f + k2 max(a).

    The parameters are theta = (k0, k1, k2) in m, m/s and s2. a = |f| - g is the magnitude of the specific force less
    standard gravity.

    Notes
    -----
    Model M3 of Zhou et al. (2019), eq. 9.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, PeriodPeakStepLength
    >>> PeriodPeakStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.   , 0.541, 3.993])
    """

    n_params = 3

    def regressors(self, step: Step) -> FloatArray:
        return np.array([1.0, 1 / step.frequency_hz, step.magnitude_max_mps2 - STANDARD_GRAVITY_MPS2])


@dataclass(frozen=True)
class WeinbergStepLength(_Linear):
    """Step length from the range of the vertical acceleration, L = k (a_max - a_min)^(1/4).

    The parameter theta = (k,) has the unit m^(3/4) s^(1/2). a is the vertical specific force less gravity.

    Notes
    -----
    Tian et al. (2016), eq. 3; Guo et al. (2018), eq. 11.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, WeinbergStepLength
    >>> WeinbergStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.627])
    """

    n_params = 1

    def regressors(self, step: Step) -> FloatArray:
        return np.array([step.vertical_range_mps2**0.25])


@dataclass(frozen=True)
class MagnitudeRangeStepLength(_Linear):
    """Step length from the range of the acceleration magnitude, L = k (max(a) - min(a))^(1/4).

    The parameter theta = (k,) has the unit m^(3/4) s^(1/2). a = |f| - g is the magnitude of the specific force less
    standard gravity.

    Notes
    -----
    Model M4 of Zhou et al. (2019), eq. 10.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, MagnitudeRangeStepLength
    >>> MagnitudeRangeStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.627])
    """

    n_params = 1

    def regressors(self, step: Step) -> FloatArray:
        return np.array([(step.magnitude_max_mps2 - step.magnitude_min_mps2) ** 0.25])


@dataclass(frozen=True)
class KimStepLength(_Linear):
    """Step length from the mean absolute acceleration, L = k (mean |a|)^(1/3).

    The parameter theta = (k,) has the unit m^(2/3) s^(2/3). a = |f| - g is the magnitude of the specific force less
    standard gravity.

    Notes
    -----
    Tian et al. (2016), eq. 4; Guo et al. (2018), eq. 13; Zhou et al. (2019), eq. 12 (model M6) and the running part of
    eq. 14 (model M7). There are two deviations:

    - a is |f| - g and not the vertical acceleration, because |f| needs no attitude.
    - Zhou et al. average a without the modulus. This works for the impacts of a foot-mounted sensor. For a phone the
      mean of |f| - g is about zero, so the modulus is needed.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, KimStepLength
    >>> KimStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.193])
    """

    n_params = 1

    def regressors(self, step: Step) -> FloatArray:
        return np.array([np.cbrt(step.mean_abs_mps2)])


@dataclass(frozen=True)
class TianStepLength(_Linear):
    """Step length from body height and step frequency, L = k h sqrt(f).

    The parameter theta = (k,) has the unit s^(1/2).

    Attributes
    ----------
    height_m : float
        Body height h in m.

    Notes
    -----
    Tian et al. (2016), eq. 9; Guo et al. (2018), eq. 12; model M5 of Zhou et al. (2019), eq. 11.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, TianStepLength
    >>> TianStepLength(height_m=1.7).regressors(TYPICAL_STEP).round(3)
    array([2.312])
    """

    height_m: float
    n_params = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        return np.array([self.height_m * np.sqrt(step.frequency_hz)])


@dataclass(frozen=True)
class ChenStepLength(_Smooth):
    """Step length from body height and step frequency with three parameters of the person.

    L = (0.7 + a (h - 1.75) + b (f - 1.79) h / 1.75) c. The parameters are theta = (a, b, c); a and c have no unit, b is
    in m s. The model is not linear in theta.

    Attributes
    ----------
    height_m : float
        Body height h in m.

    Notes
    -----
    Guo et al. (2018), eq. 14, after Chen et al. (2011). All three parameters belong to the person.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, ChenStepLength
    >>> model, theta = ChenStepLength(height_m=1.7), np.array([0.371, 0.227, 1.0])
    >>> round(float(model.length_m(TYPICAL_STEP, theta)), 3)
    0.695
    """

    height_m: float
    n_params = 3

    def __post_init__(self) -> None:
        check_numbers(self)

    def length_m(self, step: Step, theta: FloatArray) -> FloatArray:
        a, b, c = theta[..., 0], theta[..., 1], theta[..., 2]
        return (0.7 + a * (self.height_m - 1.75) + b * self._quickness(step)) * c

    def jacobian(self, step: Step, theta: FloatArray) -> FloatArray:
        a, b, c = theta[..., 0], theta[..., 1], theta[..., 2]
        taller, quicker = self.height_m - 1.75, self._quickness(step)
        return np.stack([c * taller, c * quicker, 0.7 + a * taller + b * quicker], axis=-1)

    def _quickness(self, step: Step) -> float:
        return (step.frequency_hz - 1.79) * self.height_m / 1.75


@dataclass(frozen=True)
class ZhouWalkingStepLength(_Linear):
    """Step length of walking from step duration and acceleration maximum, model M7 of Zhou et al.

    L = k0 + k1 / f + k2 / sqrt(f) + k3 max(a), with a = |f| - g the magnitude of the specific force less standard
    gravity. The parameters are theta = (k0, k1, k2, k3) in m, m/s, m/s^(1/2) and s2.

    Notes
    -----
    Walking part of Zhou et al. (2019), eq. 14. The running part is `KimStepLength`, which belongs to a separate mode of
    the filter.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, ZhouWalkingStepLength
    >>> ZhouWalkingStepLength().regressors(TYPICAL_STEP).round(3)
    array([1.   , 0.541, 0.735, 3.993])
    """

    n_params = 4

    def regressors(self, step: Step) -> FloatArray:
        f = step.frequency_hz
        return np.array([1.0, 1 / f, 1 / np.sqrt(f), step.magnitude_max_mps2 - STANDARD_GRAVITY_MPS2])


# --- the default ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BounceStepLength(_Linear):
    """Default step-length model, L = k h r A^(1/4), from body height and vertical bounce.

    The parameter theta = (k,) has the unit s^(1/2) m^(-1/4). A is the amplitude of the vertical force at the frequency
    of the step. The fourth root follows Weinberg's model. r <= 1 shortens steps that are shorter than the usual steps
    of the person (see Notes).

    Attributes
    ----------
    height_m : float, default 1.70
        Body height h in m.
    max_amplitude_mps2 : float, default 3.0
        Upper bound of A in m/s2. A larger amplitude is due to an arm that lets the phone bounce, not to the body.
    min_amplitude_mps2 : float, default 0.3
        Lower bound of A in m/s2.
    max_frequency_hz : float, default 2.4
        Frequency in Hz above which lengths decrease as 1 / f: 144 steps a minute, the quickest walking.
    turn_scale_radps : float, default 2.2
        Turn rate in rad/s at which steps are shortened by the factor 1 / e. The value was compared on the sites of the
        data that calibrated k, with one site held out at a time. On the other sites, values from 2.0 to 2.15 are best
        and values up to 2.3 are as good.
    max_turn_rate_radps : float, default 1.5
        Upper bound of the turn rate in rad/s: half a turn in two seconds. Quicker turns are movements of the hand.

    Raises
    ------
    ValueError
        If a field is not a positive number.

    Notes
    -----
    A = 2 / n |sum_j v_j exp(-2 pi i j / n)|, with the n samples v_j of the vertical force of the step.

    The inputs of the other models depend on where the phone is carried. The impact of the heel reaches a trouser pocket
    but not a hand. This impact changes the range, the variance and the mean modulus of the acceleration, but hardly A
    (docs/methods/step_length.md). Up to 2.4 steps a second, the step frequency f is not an input. People step faster
    where they step harder. With A known, the frequency therefore says nothing about the step length of an unknown
    person. On one route (ubicomp13, 66 walks of 13 people) the relative step length is proportional to
    h^(1.01 +- 0.19) f^(0.07 +- 0.11) A^(0.31 +- 0.04).

    The exponent of A is the same for all people. An exponent of the person, estimated from three to five walks with a
    prior, changes the error on a further walk by less than 0.15 points, with either sign (ubicomp13, ipol).

    r is the product of these factors, in which w is the turn rate and f the step frequency:

    - (A / B)^(1/4) where A is below its usual value B, the geometric mean over about the last twenty steps, as when
      people stop or shuffle. A is here the mean over two steps, because left and right steps differ in a pocket.
    - exp(-(w / 2.2)^2) where the person turns at w rad/s, as in a small room or on the spot.
    - 1/2 for a step from rest, which begins with the feet together.
    - 2.4 / f above 2.4 steps a second, where one step was detected as two. The speed is then kept.

    Amplitudes and turn rates beyond their bounds count as the bounds. A length is therefore between 0 and 0.45 h.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, BounceStepLength
    >>> BounceStepLength(height_m=1.7).regressors(TYPICAL_STEP).round(3)
    array([2.116])
    """

    height_m: float = USUAL_HEIGHT_M
    max_amplitude_mps2: float = 3.0
    min_amplitude_mps2: float = 0.3
    max_frequency_hz: float = 2.4
    turn_scale_radps: float = 2.2
    max_turn_rate_radps: float = 1.5
    n_params = 1

    def __post_init__(self) -> None:
        check_numbers(self)

    def regressors(self, step: Step) -> FloatArray:
        amplitude_mps2 = min(max(step.vertical_amplitude_mps2, self.min_amplitude_mps2), self.max_amplitude_mps2)
        return np.array([self.height_m * self._part_of_usual(step) * amplitude_mps2**0.25])

    def _part_of_usual(self, step: Step) -> float:
        """Return the factor r <= 1 that shortens an unusual step.

        It is the product of factors for turning, for a step frequency above the limit, and for a step from rest or with
        a smaller amplitude than usual.
        """
        turn_rate_radps = min(step.turn_rate_radps, self.max_turn_rate_radps)
        part = math.exp(-((turn_rate_radps / self.turn_scale_radps) ** 2))
        part *= min(self.max_frequency_hz / step.frequency_hz, 1.0)
        if step.from_rest:
            return 0.5 * part
        if step.usual_amplitude_mps2 <= 0 or step.stride_amplitude_mps2 <= 0:
            return part
        return part * min(step.stride_amplitude_mps2 / step.usual_amplitude_mps2, 1.0) ** 0.25


def uneven_var_m2(step: Step) -> float:
    """Return the additional variance of the length of a step from rest or of unusual duration, in m2."""
    return (_PAUSE_STD_M if step.from_rest else 0.0) ** 2 + (_UNEVEN_STD_M * step.unevenness) ** 2


# --- fits -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StepLengthFit:
    """Step-length model with estimated parameters, their covariance and the scatter of single steps.

    Attributes
    ----------
    model : LinearStepLengthModel or SmoothStepLengthModel
        Step-length model with p parameters.
    theta : (p,) array
        Parameters of the model.
    theta_cov : (p, p) array
        Covariance of the parameters, which have the same error in all steps.
    residual_std_m : float
        Standard deviation in m of the length of a single step about the model.

    Raises
    ------
    ValueError
        If a shape does not match `model.n_params`, if `theta_cov` is not a covariance, or if a number is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import FrequencyStepLength
    >>> theta_cov = np.diag([0.02, 0.01]) ** 2
    >>> fit = pdr.StepLengthFit(FrequencyStepLength(), np.array([0.2, 0.25]), theta_cov, residual_std_m=0.06)
    >>> config = pdr.recipes.default().with_step_length("walking", fit)
    """

    model: StepLengthModel
    theta: FloatArray
    theta_cov: FloatArray
    residual_std_m: float

    __reduce__ = reduction

    def __post_init__(self) -> None:
        check_numbers(self, zero=("residual_std_m",))
        object.__setattr__(self, "theta", read_only(self.theta, "theta"))
        object.__setattr__(self, "theta_cov", read_only(self.theta_cov, "theta_cov"))
        p = self.model.n_params
        check_array("theta", self.theta, shape=(p,))
        check_array("theta_cov", self.theta_cov, shape=(p, p))
        check_cov(self.theta_cov, "theta_cov")

    def predict(self, step: Step) -> tuple[float, float]:
        """Return the length of a step and its variance.

        Parameters
        ----------
        step : Step
            Step whose length is modelled.

        Returns
        -------
        length_m : float
            Length in m, never negative.
        var_m2 : float
            Variance in m2: J theta_cov J' + residual_std_m^2, with J the derivative of the length with respect to
            theta.
        """
        length, parameter_var = np.maximum(_moments(self.model, step, self.theta, self.theta_cov), 0.0)
        return float(length), float(parameter_var) + self.residual_std_m**2


@dataclass(frozen=True, eq=False)
class StepLengths:
    """Several fits that are evaluated together for one step.

    `moments` plus `residual_var_m2` equals `StepLengthFit.predict` of each fit, except for rounding.
    """

    fits: tuple[StepLengthFit, ...]

    @cached_property
    def _linear(self) -> tuple[LinearStepLengthModel, ...]:
        """Distinct linear models of the fits."""
        return tuple({_key(fit.model): fit.model for fit in self.fits if is_linear(fit.model)}.values())

    @cached_property
    def _of_terms(self) -> FloatArray:
        """Matrix (2M, T) that maps T products of one step to the M lengths and then to the M parameter variances.

        With r the regressors of each distinct linear model, the T terms are the elements of r and of r r'. A length is
        linear in r, and its variance is linear in r r'.
        """
        starts, n_terms = dict[Hashable, int](), 0
        for model in self._linear:
            starts[_key(model)], n_terms = n_terms, n_terms + model.n_params + model.n_params**2
        coefficients = np.zeros((2, len(self.fits), n_terms))
        for (of_length, of_var), fit in zip(coefficients.swapaxes(0, 1), self.fits, strict=True):
            if is_linear(fit.model):
                start, p = starts[_key(fit.model)], fit.model.n_params
                of_length[start : start + p] = fit.theta
                of_var[start + p : start + p + p * p] = fit.theta_cov.ravel()
        return coefficients.reshape(2 * len(self.fits), n_terms)

    @cached_property
    def residual_var_m2(self) -> FloatArray:
        """Variance of the length of a single step about each fit, (M,), in m2."""
        return np.array([fit.residual_std_m**2 for fit in self.fits])

    def moments(self, step: Step) -> tuple[FloatArray, FloatArray]:
        """Return the length of one step for each of M fitted models, and its variance due to their parameters alone.

        Lengths are in m and never negative, variances in m2. Both have the shape (M,).
        """
        moments = self._of_terms.dot(np.array(self._terms(step))).reshape(2, len(self.fits))
        for i, fit in self._smooth:
            moments[:, i] = _moments(fit.model, step, fit.theta, fit.theta_cov)
        moments = np.maximum(moments, 0.0)
        return moments[0], moments[1]

    def moments_of_all(self, steps: Sequence[Step]) -> tuple[FloatArray, FloatArray]:
        """Return the lengths and variances (K, M) of K steps, which equal those of `moments` except for rounding."""
        terms = np.array([self._terms(step) for step in steps]).reshape(len(steps), self._of_terms.shape[1])
        moments = (terms @ self._of_terms.T).reshape(len(steps), 2, len(self.fits))
        for i, fit in self._smooth:
            of_fit = [_moments(fit.model, step, fit.theta, fit.theta_cov) for step in steps]
            moments[:, :, i] = np.array(of_fit).reshape(len(steps), 2)
        moments = np.maximum(moments, 0.0)
        return moments[:, 0], moments[:, 1]

    def _terms(self, step: Step) -> list[float]:
        """Return the terms of a step by which `_of_terms` is multiplied."""
        terms: list[float] = []
        for model in self._linear:
            r = np.asarray(model.regressors(step)).tolist()
            terms += r
            terms += [a * b for a in r for b in r]
        return terms

    @cached_property
    def _smooth(self) -> list[tuple[int, StepLengthFit]]:
        """Fits with a nonlinear model, each with its index in `fits`."""
        return [(i, fit) for i, fit in enumerate(self.fits) if not is_linear(fit.model)]


def _key(model: StepLengthModel) -> Hashable:
    """Return the model as a dictionary key, or its identity if its class is not hashable.

    Equal models share their regressors.
    """
    try:
        hash(model)
    except TypeError:
        return id(model)
    return model


def equal_fits(one: StepLengthFit, other: StepLengthFit) -> bool:
    """Return True if two fits have equal models, parameters, covariances and residuals."""
    a, b = ((_key(f.model), f.theta.tolist(), f.theta_cov.tolist(), f.residual_std_m) for f in (one, other))
    return a == b


def _moments(
    model: StepLengthModel, step: Step, theta: FloatArray, theta_cov: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the length (...) of a step in m, and its variance (...) in m2 due to the parameters alone.

    The p parameters theta (..., p) have the covariance (..., p, p). The length may be negative. The variance of an
    estimated covariance may be negative by rounding.
    """
    length, jacobian = length_and_jacobian(model, step, theta)
    products = theta_cov * (jacobian[..., :, None] * jacobian[..., None, :])
    return length, np.add.reduce(products.reshape(*products.shape[:-2], -1), axis=-1)


def known_length(length_m: float, std_m: float, shared_std_m: float = 0.0) -> StepLengthFit:
    """Return a fit with the same length for every step, such as the depth of stairs.

    Parameters
    ----------
    length_m : float
        Length of every step in m, 0.05 to 3.
    std_m : float
        Standard deviation in m of a single step about this length, independent between steps, at most 3.
    shared_std_m : float, default 0.0
        Standard deviation in m of the error that all steps of a walk have in common, at most 3.

    Returns
    -------
    StepLengthFit
        Fit of `FrequencyVarianceStepLength` with k1 = k2 = 0.

    Raises
    ------
    ValueError
        If a length is not plausible in metres, for example in centimetres.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> fit = pdr.known_length(0.29, 0.05)
    >>> fit.theta, fit.residual_std_m
    (array([0.29, 0.  , 0.  ]), 0.05)
    """
    check_step_length("length_m", length_m)
    for name, value in (("std_m", std_m), ("shared_std_m", shared_std_m)):
        check_number(name, value, 0.0, limits.STEP_LENGTH_RANGE_M[1], "it is in metres, such as 0.05")
    return constant_fit(length_m, std_m, shared_std_m)


def constant_fit(length_m: float, std_m: float, shared_std_m: float = 0.0) -> StepLengthFit:
    """Return the fit of `known_length` for any length, such as 0 where steps do not move."""
    theta, theta_cov = np.array([length_m, 0.0, 0.0]), np.diag([shared_std_m**2, 0.0, 0.0])
    return StepLengthFit(FrequencyVarianceStepLength(), theta, theta_cov, std_m)


#: Standard deviation of single steps of one person about any of the models, m.
RESIDUAL_STD_M = 0.06
# Additional standard deviation of a step from rest. The model gives half a step, but contacts in a pause may have been
# missed. In the pauses of 19 walks with a continuous reference (oxiod, tyrex) people went 0.7 m further. In those of
# ms_indoor half a step is right. The value is that of 0.7 m in one of four steps from rest.
_PAUSE_STD_M = 0.35
# Additional standard deviation of a step of unusual duration, per unit of `Step.unevenness`: in a turn, at a halt, or
# where a contact was missed. Maximum-likelihood estimate from 3,600 steps of walking with a continuous reference
# (oxiod). From 1,500 steps of tyrex the estimate is 0.95.
_UNEVEN_STD_M = 0.6
# k of men and women: text of eq. 2 of Tian et al. (2016). Relative standard deviation: the distances of ten people over
# 28 m have a standard deviation of 3.58 m (Table VII).
_STATIC_K = {"M": 0.415, "F": 0.413}
_STATIC_RELATIVE_STD = 3.58 / 28


def static_fit(height_m: float, gender: str | None = None) -> StepLengthFit:
    """Return the fit of `StaticStepLength` with the printed parameter k for men or women.

    Parameters
    ----------
    height_m : float
        Body height in m.
    gender : {"M", "F"}, optional
        Gender of the person. For any other value, or None, k is the mean of both.

    Returns
    -------
    StepLengthFit
        Fit with k = 0.415 ("M") or 0.413 ("F") and a relative standard deviation of 13 %.

    Notes
    -----
    k is printed in the text of eq. 2 of Tian et al. (2016). Its standard deviation is from their Table VII: the
    distances of ten people over 28 m have a standard deviation of 3.58 m.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, static_fit
    >>> length_m, var_m2 = static_fit(1.8, "M").predict(TYPICAL_STEP)
    >>> round(length_m, 3)
    0.747
    """
    return one_parameter_fit(StaticStepLength(height_m), of_gender(_STATIC_K, gender), _STATIC_RELATIVE_STD)


# Parameter of `BounceStepLength`, fitted to the distances of 174 recordings at five sites of equal weight (humolire,
# ms_indoor, oxiod, tyrex, ipol; tests/benchmarks/step_length.py). The fit gives 0.336 or 0.339, depending on whether r
# uses A of two steps or of one. Its standard deviation is the spread between sites, 4 %, over the root of five. Single
# steps scatter by 0.06 m about the model with the phone in the hand, by 0.12 m in a trouser pocket.
_BOUNCE_K, _BOUNCE_K_STD, _BOUNCE_RESIDUAL_STD_M = 0.34, 0.006, 0.08


def bounce_fit(height_m: float | None = None) -> StepLengthFit:
    """Return the fit of `BounceStepLength` for an unknown person, the default step length.

    Parameters
    ----------
    height_m : float, optional
        Body height in m; 1.70 m if it is not given.

    Returns
    -------
    StepLengthFit
        Fit with k = 0.34 and a residual standard deviation of 0.08 m. `theta_cov` is the uncertainty of the population
        mean of k only. The difference between a person and the population is a common factor of all steps (see
        `scale_std`).

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP, bounce_fit
    >>> length_m, var_m2 = bounce_fit(1.8).predict(TYPICAL_STEP)
    >>> round(length_m, 3)
    0.762
    """
    model = BounceStepLength() if height_m is None else BounceStepLength(height_m=height_m)
    return StepLengthFit(model, np.array([_BOUNCE_K]), np.array([[_BOUNCE_K_STD**2]]), _BOUNCE_RESIDUAL_STD_M)


# Standard deviation between people of the log step scale, with each site held out: 6.6 % with known heights, 8.4 %
# without (docs/benchmarks.md). These are few people at few sites, and step lengths of people at other sites were wrong
# by up to 20 %. Both values are therefore rounded up, the one for unknown heights more.
_SCALE_STD_OF_KNOWN_HEIGHT, _SCALE_STD = 0.07, 0.10


def scale_std(height_m: float | None) -> float:
    """Return the relative standard deviation between people of all step lengths about `bounce_fit`.

    Parameters
    ----------
    height_m : float or None
        Body height in m that was given to `bounce_fit`, or None if it is unknown.

    Returns
    -------
    float
        0.07 for a known height, 0.10 for an unknown one.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import scale_std
    >>> scale_std(1.8), scale_std(None)
    (0.07, 0.1)
    """
    return _SCALE_STD if height_m is None else _SCALE_STD_OF_KNOWN_HEIGHT


TYPICAL_STEP = Step.of(0.54, frequency_hz=1.85)
# Standard deviation of the step scale of one person between walks: 1.7 to 2.8 % over nine walks of one person,
# depending on the model (docs/benchmarks.md, one walk held out).
RECORDING_STD = 0.025


def of_gender(values: dict[str, float], gender: str | None) -> float:
    """Return the value for a gender, or the mean of all values if the gender is not known.

    Parameters
    ----------
    values : dict of str to float
        Value for each of the genders "M" and "F".
    gender : str or None
        Gender of the person.

    Returns
    -------
    float
        Value in the unit of `values`.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import of_gender
    >>> of_gender({"M": 0.5, "F": 0.25}, "F"), of_gender({"M": 0.5, "F": 0.25}, None)
    (0.25, 0.375)
    """
    return values.get(gender or "", sum(values.values()) / len(values))


def one_parameter_fit(model: StepLengthModel, k: float, relative_std: float) -> StepLengthFit:
    """Return the fit of a model with one parameter, whose standard deviation between people is `k * relative_std`.

    Single steps scatter by `RESIDUAL_STD_M`.

    Parameters
    ----------
    model : StepLengthModel
        Step-length model with one parameter.
    k : float
        Parameter, in the unit of the model.
    relative_std : float
        Standard deviation of the parameter between people, divided by `k`.

    Returns
    -------
    StepLengthFit
        Fit with theta = (k,) and the variance of k.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import WeinbergStepLength, one_parameter_fit
    >>> fit = one_parameter_fit(WeinbergStepLength(), k=0.5, relative_std=0.1)
    >>> fit.theta, fit.theta_cov.round(4)
    (array([0.5]), array([[0.0025]]))
    """
    return StepLengthFit(model, np.array([k]), np.array([[(k * relative_std) ** 2]]), RESIDUAL_STD_M)
