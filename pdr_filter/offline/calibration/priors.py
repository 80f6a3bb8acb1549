"""Prior distributions of step-length parameters before a calibration, by context."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.filter.imm.motion_model import IRREGULAR, Mode
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import (
    TYPICAL_STEP,
    USUAL_HEIGHT_M,
    BounceStepLength,
    ChenStepLength,
    FrequencyStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    MagnitudeRangeStepLength,
    PeriodPeakStepLength,
    StaticStepLength,
    StepLengthModel,
    TianStepLength,
    WeinbergStepLength,
    ZhouWalkingStepLength,
    bounce_fit,
    equal_fits,
    length_and_jacobian,
    scale_std,
)
from pdr_filter.recipes.modes import context_modes
from pdr_filter.values import FloatArray, Step, check_array, read_only

# relative standard deviation of step lengths between people of known height, 7 %
PEOPLE_RELATIVE_STD = scale_std(USUAL_HEIGHT_M)
# Relative standard deviation of a group's mean step length about the default one. The step lengths of four groups of
# unknown height deviate by -10, 0, +10 and +20 %, which is a root mean square of 12.2 %: hypot(0.10, 0.07).
GROUP_RELATIVE_STD = 0.10
# Share of the largest effect on a typical step from which a parameter can differ between people. A weaker parameter
# would need ten times as many of its standard deviations as the strongest one for the same difference of lengths.
_MIN_EFFECT = 0.1


@dataclass(frozen=True, eq=False)
class StepLengthPrior:
    """Step-length model of one context, with the prior distribution of its parameters.

    Parameters
    ----------
    model : StepLengthModel
        Step-length model with p parameters. A model with a `height_m` takes the body height of each person, or its own
        if the person's height is unknown.
    mean : array (p,)
        Prior mean of the population's parameters.
    std : array (p,)
        Prior standard deviation of the population's parameters. 0 holds a parameter at its mean, and inf is an
        uninformative prior.
    between_std : array (p,)
        Initial standard deviation of the parameters between people: 0 for a parameter that all people share, a positive
        value for a parameter of each person, and inf for a parameter that is independent between people (as in
        Martinelli et al. 2018, eq. 14).
    step_std_m : float, default 0.08
        Standard deviation of single steps about the model, in m.

    Raises
    ------
    ValueError
        If shapes or signs are wrong, or a held parameter (std 0) differs between people.

    See Also
    --------
    prior : The same from plain lists.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.step_length.models import WeinbergStepLength
    >>> from pdr_filter.offline.calibration.priors import StepLengthPrior
    >>> own = StepLengthPrior(WeinbergStepLength(), np.array([0.45]), np.array([0.1]), np.array([0.03]))
    >>> own.mean, own.step_std_m
    (array([0.45]), 0.08)
    """

    model: StepLengthModel
    mean: FloatArray
    std: FloatArray
    between_std: FloatArray
    step_std_m: float = 0.08

    def __post_init__(self) -> None:
        for name in ("mean", "std", "between_std"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
            if getattr(self, name).shape != (self.model.n_params,):
                kind, shape = type(self.model).__name__, getattr(self, name).shape
                raise ValueError(
                    f"{name} of {kind} must have the shape ({self.model.n_params},), got {shape}: give one value per "
                    "parameter"
                )
        check_array("mean", self.mean)
        if not ((self.std >= 0).all() and (self.between_std >= 0).all()):
            raise ValueError(f"std and between_std must be 0 or more, got {self.std} and {self.between_std}")
        if not self.step_std_m >= 0:
            raise ValueError(f"step_std_m must be 0 or more, got {self.step_std_m}")
        if ((self.std == 0) & (self.between_std > 0)).any():
            raise ValueError(
                "a parameter that is held (std 0) cannot differ between people: set its between_std to 0 too"
            )


def prior(
    model: StepLengthModel, mean: ArrayLike, std: ArrayLike, between_std: ArrayLike, step_std_m: float = 0.08
) -> StepLengthPrior:
    """Return a `StepLengthPrior` from plain lists.

    Parameters
    ----------
    model : StepLengthModel
        Step-length model with p parameters.
    mean : array_like (p,)
        Prior mean of the population's parameters.
    std : array_like (p,)
        Prior standard deviation of the population's parameters. 0 holds a parameter, inf is uninformative.
    between_std : array_like (p,)
        Initial standard deviation between people. 0 for shared parameters, inf for independent people.
    step_std_m : float, default 0.08
        Standard deviation of single steps about the model, in m.

    Returns
    -------
    StepLengthPrior
        The prior.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import WeinbergStepLength
    >>> from pdr_filter.offline.calibration.priors import prior
    >>> prior(WeinbergStepLength(), mean=[0.45], std=[0.1], between_std=[0.03]).std
    array([0.1])
    """
    arrays = [np.array(a, dtype=float) for a in (mean, std, between_std)]
    return StepLengthPrior(model, *arrays, step_std_m=step_std_m)


def weak_prior(
    model: StepLengthModel,
    mean: ArrayLike | None = None,
    personal: tuple[int, ...] | None = None,
    step: Step = TYPICAL_STEP,
) -> StepLengthPrior:
    """Return a weakly informative prior for any step-length model.

    The prior is only strong enough to separate parameters that have the same effect on the data. A term is the
    contribution of one parameter to the length of the typical step: the parameter times the derivative of the length
    with respect to it. Without a `mean`, the first term with an effect has the mean 0.7 m and each other term the mean
    0 m. All terms have a standard deviation of 0.7 m. With a `mean`, each parameter has this mean, and each term has a
    standard deviation of 0.35 m.

    Parameters
    ----------
    model : StepLengthModel
        Step-length model with p parameters.
    mean : array_like (p,), optional
        Prior mean of the parameters.
    personal : tuple of int, optional
        Indices of the parameters that differ between people, by default the first one with an effect on the typical
        step. A single one has a standard deviation of 7 % of a step between people. With n of them, each has this value
        divided by sqrt(n).
    step : Step, optional
        Typical step for which the terms are computed.

    Returns
    -------
    StepLengthPrior
        The prior.

    Examples
    --------
    >>> from pdr_filter.filter.step_length.models import WeinbergStepLength
    >>> from pdr_filter.offline.calibration.priors import weak_prior
    >>> weak = weak_prior(WeinbergStepLength())
    >>> weak.mean.round(2), weak.std.round(2)
    (array([0.43]), array([0.43]))
    """
    start = np.ones(model.n_params) if mean is None else np.array(mean, dtype=float)
    length, slope = length_and_jacobian(model, step, start)
    has_effect = np.abs(slope) > 1e-9
    slope = np.where(has_effect, slope, 1.0)
    first = int(np.argmax(has_effect))
    if mean is None:
        std = 0.7 / np.abs(slope)
        centre = np.where(np.arange(model.n_params) == first, 0.7 / slope, 0.0)
        length_m = 0.7
    else:
        std, centre, length_m = 0.35 / np.abs(slope), start, float(length)
    between = np.zeros(model.n_params)
    own = [first] if personal is None else list(personal)
    between[own] = PEOPLE_RELATIVE_STD * length_m / np.abs(slope[own]) / np.sqrt(max(len(own), 1))
    return StepLengthPrior(model, centre, std, between)


def _constant_length(length_m: float, std_m: float, between_m: float, step_std_m: float) -> StepLengthPrior:
    """Return a prior of a constant step length: k1 and k2 of eq. 12 of Martinelli et al. 2018 are fixed at zero."""
    return prior(FrequencyVarianceStepLength(), [length_m, 0, 0], [std_m, 0, 0], [between_m, 0, 0], step_std_m)


_BOUNCE = bounce_fit()
_BOUNCE_K = float(_BOUNCE.theta[0])
DEFAULT_PRIORS: Mapping[str, StepLengthPrior] = MappingProxyType(
    {
        "stationary": _constant_length(0.0, 0.0, 0.0, 0.02),
        "walking": prior(
            BounceStepLength(),
            [_BOUNCE_K],
            [GROUP_RELATIVE_STD * _BOUNCE_K],
            [PEOPLE_RELATIVE_STD * _BOUNCE_K],
            _BOUNCE.residual_std_m,
        ),
        # Treads of public stairs are 0.26 to 0.32 m. They depend on the stairs more than on the person.
        "upstairs": _constant_length(0.29, 0.03, 0.02, 0.05),
        "downstairs": _constant_length(0.43, 0.08, 0.05, 0.10),
        "sideways": _constant_length(0.45, 0.10, 0.07, 0.10),
        "running": prior(FrequencyVarianceStepLength(), [0, 0.35, 0], [0.2, 0.1, 0], [0.08, 0, 0], 0.10),
    }
)


def eq12_priors(between_std_m: float = 0.05) -> dict[str, StepLengthPrior]:
    """Return the priors of Martinelli et al. for all contexts.

    The step length of each moving context is k0 + k1 f + k2 sigma^2, with k0 of each person, and k1 and k2 shared.

    Parameters
    ----------
    between_std_m : float, default 0.05
        Initial standard deviation of k0 between people, in m.

    Returns
    -------
    dict of str to StepLengthPrior
        Prior of each context, for `calibrate(..., priors=...)`.

    Notes
    -----
    The priors are weak: k0 +- 0.5 m, k1 +- 0.2 m s about 0.2 (0 on stairs and sideways, 0.35 for running), k2 +- 0.02.

    References
    ----------
    A. Martinelli et al., "Probabilistic context-aware step length estimation for pedestrian dead reckoning", IEEE
    Sensors Journal 18, 2018, eq. 12 to 16.

    Examples
    --------
    >>> from pdr_filter.offline.calibration.priors import eq12_priors
    >>> eq12_priors()["walking"].mean
    array([0.4, 0.2, 0. ])
    """
    model = FrequencyVarianceStepLength()
    k0 = {"walking": 0.4, "upstairs": 0.29, "downstairs": 0.43, "sideways": 0.45, "running": 0.0}
    k1 = {"walking": 0.2, "upstairs": 0.0, "downstairs": 0.0, "sideways": 0.0, "running": 0.35}
    moving = {
        name: StepLengthPrior(
            model,
            np.array([k0[name], k1[name], 0.0]),
            np.array([0.5, 0.2, 0.02]),
            np.array([between_std_m, 0.0, 0.0]),
            DEFAULT_PRIORS[name].step_std_m,
        )
        for name in k0
    }
    return {"stationary": DEFAULT_PRIORS["stationary"], **moving}


def separate_modes(model: PedestrianModel, joined: Collection[str] = ()) -> dict[str, str]:
    """Return the context of each mode that shares it with a mode of another length of steps, by the name of the mode.

    These modes are calibrated separately, under their own names, unless the context is in `joined`. ValueError if such
    a mode has the name of another context.
    """

    def is_apart(one: Mode, other: Mode) -> bool:
        is_equal = one.moves == other.moves and equal_fits(one.step_length, other.step_length)
        return one.context == other.context and not is_equal

    separate = {
        mode.name: mode.context
        for mode in model.modes
        if mode.context not in (IRREGULAR, *joined) and any(is_apart(mode, other) for other in model.modes)
    }
    if taken := [name for name, context in separate.items() if name != context and name in model.contexts]:
        raise ValueError(
            f"modes {', '.join(taken)} have the name of another context, so that calibrated step lengths would be "
            "confused: rename the modes"
        )
    return separate


def own_priors(model: PedestrianModel, joined: Collection[str] = ()) -> dict[str, StepLengthPrior]:
    """Return priors from the step lengths of a filter's modes, by context, or by mode for `separate_modes`.

    A step length of the default recipe, in a context with the same meaning, has its prior in `DEFAULT_PRIORS`. For
    others, a parameter with zero variance in the filter is fixed in the calibration. The first parameter with an effect
    on a typical step differs between people. Its standard deviation changes the length of a typical step by the
    relative standard deviation of the filter's step scale.
    """
    separate, relative_std = separate_modes(model, joined), model.noise.log_scale_std or PEOPLE_RELATIVE_STD
    named = {m.name if m.name in separate else m.context: m for m in reversed(model.modes) if m.context != IRREGULAR}
    return {name: _prior_of(mode, relative_std) for name, mode in named.items()}


def _prior_of(mode: Mode, relative_std: float) -> StepLengthPrior:
    """Return the prior of the step length of a mode, with zero length if the mode does not move."""
    fit = mode.step_length
    for usual in context_modes(bounce_fit(getattr(fit.model, "height_m", None))):
        if replace(mode.meaning, name=usual.context) == usual.meaning and equal_fits(fit, usual.step_length):
            return DEFAULT_PRIORS[usual.context]
    if not mode.moves:
        return _constant_length(0.0, 0.0, 0.0, fit.residual_std_m)
    std, between_std = np.sqrt(np.maximum(np.diag(fit.theta_cov), 0.0)), np.zeros(len(fit.theta))
    length_m, slope = length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)
    main = _main_parameter(std, slope)
    if std[main] * slope[main] != 0:
        between_std[main] = relative_std * abs(float(length_m) / slope[main])
    return StepLengthPrior(fit.model, fit.theta, std, between_std, fit.residual_std_m)


def _main_parameter(std: FloatArray, slope: FloatArray) -> int:
    """Return the index of the first parameter with an effect on a typical step, or 0 if no parameter has one.

    The effect is the prior standard deviation (p,) times the derivative (p,) of the length, or the derivative if all
    parameters are held. It is at least the share `_MIN_EFFECT` of the largest effect, so that the parameter of an
    inactive branch is not taken.
    """
    active = slope != 0
    effect = np.abs(np.where(active, std if std[active].any() else 1.0, 0.0) * slope)
    return int(np.argmax(effect >= _MIN_EFFECT * effect.max()))


def candidates() -> dict[str, dict[str, StepLengthPrior]]:
    """Return the priors of all step-length models of walking that a calibration takes by name.

    Returns
    -------
    dict of str to dict of str to StepLengthPrior
        Priors of walking by the name of the model. The first five are compared if no model is named.

    Notes
    -----
    docs/methods/step_length.md has the models. The parameter a of Chen's model is held, because for one person it has
    the effect of c. Its b is as weakly known as k1 of `eq12_priors`.

    Examples
    --------
    >>> from pdr_filter.offline.calibration.priors import candidates
    >>> list(candidates())
    ['bounce', 'eq12', 'kim', 'tian', 'weinberg', 'chen', 'frequency', 'peak', 'range', 'static', 'zhou']
    """
    a, b, c = 0.371, 0.227, 1.0  # as in the recipe of Guo et al. 2018
    own = {
        "bounce": DEFAULT_PRIORS["walking"],
        "eq12": eq12_priors()["walking"],
        "kim": weak_prior(KimStepLength()),
        "tian": weak_prior(TianStepLength(USUAL_HEIGHT_M)),
        "weinberg": weak_prior(WeinbergStepLength()),
        "chen": prior(ChenStepLength(USUAL_HEIGHT_M), [a, b, c], [0.0, 0.2, 0.5], [0.0, 0.0, PEOPLE_RELATIVE_STD]),
        "frequency": weak_prior(FrequencyStepLength()),
        "peak": weak_prior(PeriodPeakStepLength()),
        "range": weak_prior(MagnitudeRangeStepLength()),
        "static": weak_prior(StaticStepLength(USUAL_HEIGHT_M)),
        "zhou": weak_prior(ZhouWalkingStepLength()),
    }
    return {name: {"walking": of_walking} for name, of_walking in own.items()}


def with_relative_std(prior: StepLengthPrior, relative_std: float) -> StepLengthPrior:
    """Return a prior with a standard deviation of this share of a typical step in its `_main_parameter`."""
    check_array("the relative standard deviation of a prior", relative_std, "positive", (), "0.1 is usual")
    length, slope = length_and_jacobian(prior.model, TYPICAL_STEP, prior.mean)
    std, main = prior.std.copy(), _main_parameter(prior.std, slope)
    if slope[main] == 0:
        raise ValueError(
            f"no parameter of {type(prior.model).__name__} changes the length of a typical step: omit prior_std "
            "(--prior), and give the parameters a standard deviation"
        )
    std[main] = relative_std * abs(float(length) / slope[main])
    return replace(prior, std=std)
