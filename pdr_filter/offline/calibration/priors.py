"""What is known of step lengths before a calibration, for each context."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import (
    USUAL_HEIGHT_M,
    BounceStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    StepLengthModel,
    TianStepLength,
    WeinbergStepLength,
    bounce_fit,
    length_and_jacobian,
    scale_std,
)
from pdr_filter.recipes.step_length_calibration import TYPICAL_STEP
from pdr_filter.values import FloatArray, Step, check_array, read_only

PEOPLE_RELATIVE_STD = scale_std(USUAL_HEIGHT_M)  # how people of known height differ in their step lengths, 7 %
# How far the mean of a group of people with their phones may be from the lengths that are shipped. The step lengths of
# four groups of unknown height are off by -10, 0, +10 and +20 %, root mean square 12.2 %: hypot(0.10, 0.07).
GROUP_RELATIVE_STD = 0.10
_PACKAGE = __name__.split(".")[0]
_MIN_SLOPE = 1e-9  # smallest derivative of the length by a parameter, against division by zero


@dataclass(frozen=True, eq=False)
class StepLengthPrior:
    """A step-length model of one context, and what is known of its parameters.

    Parameters
    ----------
    model : StepLengthModel
        One with a `height_m` takes that of each person, and its own where it is unknown.
    mean, std : (p,)
        Of the population. Std 0 holds a parameter at its mean, inf knows nothing.
    between_std : (p,)
        How people differ, where the estimate of the spread starts: 0 for a parameter that all share, positive for one
        of each person's own, inf for one in which people are independent (as in Martinelli et al. 2018, eq. 14).
    step_std_m : float
        Of single steps about the model.
    """

    model: StepLengthModel
    mean: FloatArray
    std: FloatArray
    between_std: FloatArray
    step_std_m: float = 0.08

    def __post_init__(self) -> None:
        for name in ("mean", "std", "between_std"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            if getattr(self, name).shape != (self.model.n_params,):
                kind, shape = type(self.model).__name__, getattr(self, name).shape
                raise ValueError(f"{name} of {kind} must be ({self.model.n_params},), got {shape}")
        check_array("mean", self.mean)
        if not ((self.std >= 0).all() and (self.between_std >= 0).all()):
            raise ValueError(f"std and between_std must be 0 or more, got {self.std} and {self.between_std}")
        if not self.step_std_m >= 0:
            raise ValueError(f"step_std_m must not be negative, got {self.step_std_m}")
        if ((self.std == 0) & (self.between_std > 0)).any():
            raise ValueError("a parameter that is held (std 0) cannot differ between people (between_std 0)")


def prior(
    model: StepLengthModel, mean: ArrayLike, std: ArrayLike, between_std: ArrayLike, step_std_m: float = 0.08
) -> StepLengthPrior:
    """`StepLengthPrior` from plain lists."""
    arrays = [np.array(a, dtype=float) for a in (mean, std, between_std)]
    return StepLengthPrior(model, *arrays, step_std_m=step_std_m)


def weak_prior(
    model: StepLengthModel, mean: ArrayLike | None = None, personal: tuple[int, ...] = (0,), step: Step = TYPICAL_STEP
) -> StepLengthPrior:
    """Prior for any model, of a size that only decides between parameters with the same effect.

    Each term of a typical step is 0 +- 0.7 m, the first one 0.7 +- 0.7 m; with a `mean`, each term is uncertain by
    0.35 m. People differ by 7 % of a step in each of the `personal` parameters, if there is one, and by less in each
    of several.
    """
    start = np.ones(model.n_params) if mean is None else np.array(mean, dtype=float)
    length, slope = length_and_jacobian(model, step, start)
    slope = np.where(np.abs(slope) < 1e-9, 1.0, slope)
    if mean is None:
        std = 0.7 / np.abs(slope)
        centre = np.where(np.arange(model.n_params) == 0, 0.7 / slope, 0.0)
        length_m = 0.7
    else:
        std, centre, length_m = 0.35 / np.abs(slope), start, float(length)
    between = np.zeros(model.n_params)
    own = list(personal)
    between[own] = PEOPLE_RELATIVE_STD * length_m / np.abs(slope[own]) / np.sqrt(max(len(own), 1))
    return StepLengthPrior(model, centre, std, between)


def _known(length_m: float, std_m: float, between_m: float, step_std_m: float) -> StepLengthPrior:
    """One length whatever the step: k1 and k2 of eq. 12 are held at zero."""
    return prior(FrequencyVarianceStepLength(), [length_m, 0, 0], [std_m, 0, 0], [between_m, 0, 0], step_std_m)


_BOUNCE = bounce_fit()
_BOUNCE_K = float(_BOUNCE.theta[0])
DEFAULT_PRIORS: Mapping[str, StepLengthPrior] = MappingProxyType(
    {
        "stationary": _known(0.0, 0.0, 0.0, 0.02),
        "walking": prior(
            BounceStepLength(),
            [_BOUNCE_K],
            [GROUP_RELATIVE_STD * _BOUNCE_K],
            [PEOPLE_RELATIVE_STD * _BOUNCE_K],
            _BOUNCE.residual_std_m,
        ),
        # Treads of public stairs are 0.26 to 0.32 m and belong to the stairs more than to the person.
        "upstairs": _known(0.29, 0.03, 0.02, 0.05),
        "downstairs": _known(0.43, 0.08, 0.05, 0.10),
        "sideways": _known(0.45, 0.10, 0.07, 0.10),
        "running": prior(FrequencyVarianceStepLength(), [0, 0.35, 0], [0.2, 0.1, 0], [0.08, 0, 0], 0.10),
    }
)


def eq12_priors(between_std_m: float = 0.05) -> dict[str, StepLengthPrior]:
    """k0 + k1 f + k2 sigma^2 in every moving context, k0 of each person, k1 and k2 shared.

    Martinelli et al. 2018, eq. 12-16, with weak priors: k0 +- 0.5 m, k1 +- 0.2 m s about 0.2 (stairs: 0), k2 +- 0.02.
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


def own_priors(model: PedestrianModel) -> dict[str, StepLengthPrior]:
    """Priors of the contexts of a filter that `DEFAULT_PRIORS` does not fit, from the step lengths of their modes.

    These are contexts with other names, and step-length models from outside the package. A parameter with the variance
    zero is held. People differ in the first free parameter, by the spread of the filter's step scale.
    """
    named = {m.context: m for m in reversed(model.modes) if m.context in model.contexts}
    return {
        context: _prior_of(mode, model.noise.log_scale_std)
        for context, mode in named.items()
        if context not in DEFAULT_PRIORS or type(mode.step_length.model).__module__.split(".")[0] != _PACKAGE
    }


def _prior_of(mode: Mode, relative_std: float) -> StepLengthPrior:
    """Prior with the step length of a mode, and with that of no displacement if the mode does not move."""
    fit = mode.step_length
    if not mode.moves:
        return _known(0.0, 0.0, 0.0, fit.residual_std_m)
    std, between_std = np.sqrt(np.maximum(np.diag(fit.theta_cov), 0.0)), np.zeros(len(fit.theta))
    free = np.flatnonzero(std > 0)[:1]
    length_m, slope = length_and_jacobian(fit.model, TYPICAL_STEP, fit.theta)
    between_std[free] = relative_std * abs(float(length_m)) / np.maximum(np.abs(slope[free]), _MIN_SLOPE)
    return StepLengthPrior(fit.model, fit.theta, std, between_std, fit.residual_std_m)


def candidates() -> dict[str, dict[str, StepLengthPrior]]:
    """Sets of priors that differ in the model of walking, by name, the default first (`choice.best_form`)."""
    return {
        "bounce": {"walking": DEFAULT_PRIORS["walking"]},
        "eq12": {"walking": eq12_priors()["walking"]},
        "kim": {"walking": weak_prior(KimStepLength())},
        "tian": {"walking": weak_prior(TianStepLength(USUAL_HEIGHT_M))},
        "weinberg": {"walking": weak_prior(WeinbergStepLength())},
    }


def as_wide_as(prior: StepLengthPrior, relative_std: float) -> StepLengthPrior:
    """The prior of a population whose typical step is uncertain by this share of it, in the first parameter."""
    check_array("the relative standard deviation of a prior", relative_std, "positive", (), "0.1 is usual")
    length, slope = length_and_jacobian(prior.model, TYPICAL_STEP, prior.mean)
    std = prior.std.copy()
    std[0] = relative_std * float(length) / abs(slope[0])
    return replace(prior, std=std)
