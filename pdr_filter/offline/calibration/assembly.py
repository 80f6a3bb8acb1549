"""Assembly of a `Calibration` from the estimate of segments or of smoothed walks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from types import MappingProxyType
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.calibration_result import typical_step_m
from pdr_filter.offline.calibration.estimation import PeopleEstimate
from pdr_filter.offline.calibration.model_forms import models_of
from pdr_filter.offline.calibration.priors import StepLengthPrior
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.values import FloatArray, Table, limits
from pdr_filter.version import __version__


def calibration_of(
    priors: Mapping[str, StepLengthPrior],
    found: PeopleEstimate,
    heights_m: Mapping[str, float | None],
    rows: Table,
    notes: Sequence[str],
    *,
    n_recordings: int,
    counts: Mapping[str, int] = MappingProxyType({}),
    **more: Any,
) -> Calibration:
    """Return the `Calibration` of an estimate of the people with the heights `heights_m`.

    `rows` are its segments, `counts` further counts of its card, and `more` the other attributes.
    """
    return Calibration(
        models=models_of(priors),
        theta=found.population,
        theta_cov=found.population_cov,
        between_cov=found.between_cov,
        people=found.people,
        people_cov=found.people_cov,
        subject_ids=tuple(heights_m),
        heights_m=np.array([np.nan if height_m is None else height_m for height_m in heights_m.values()]),
        recording_std=found.recording_std,
        segments=rows,
        notes=tuple(notes),
        card={
            "date": date.today().isoformat(),
            "pdr_filter": __version__,
            "people": len(heights_m),
            "recordings": n_recordings,
            "segments": len(rows),
            **counts,
            "metres": round(float(rows.distance_m.sum()), 1),
        },
        **more,
    )


# A warning names a recording whose step lengths differ from the prior by more than this number of standard deviations
# of the prior. `smooth` has the same limit.
_UNUSUAL_STDS = 2.0
_CAUSE = "the fixes or known lengths probably have a wrong unit or scale"


def scale_std_of(prior: StepLengthPrior | None, recording_std: float) -> float:
    """Return the prior standard deviation of the log step scale of an unknown person in one recording."""
    if prior is None:
        return recording_std
    cov = np.diag(prior.std**2 + prior.between_std**2)
    length_m, std_m = typical_step_m(prior.model, prior.mean, cov)
    return float(np.hypot(min(std_m / max(length_m, 1e-3), 1.0), recording_std))


def length_warnings(
    rows: Table, fitted_m: FloatArray, priors: Mapping[str, StepLengthPrior], recording_std: float
) -> list[str]:
    """Return a warning for each context in which people hardly take the fitted steps, with likely cause and remedy.

    `fitted_m` are the fitted lengths of the segments `rows`. They are compared with those of the prior, because a fit
    agrees with wrong lengths, too.
    """
    found: list[str] = []
    for context, prior in priors.items():
        good = (rows.context == context) & ~rows.distrusted & (rows.uncalibrated_m > 0)
        std = scale_std_of(prior, recording_std)
        unusual: dict[str, tuple[float, float, float]] = {}
        for name in dict.fromkeys(rows.recording[good].tolist()):
            own = good & (rows.recording == name)
            length_m = float(fitted_m[own].sum())
            ratio = length_m / float(rows.uncalibrated_m[own].sum())
            stds = abs(np.log(max(ratio, 1e-9))) / max(std, 1e-9)
            if stds > _UNUSUAL_STDS:
                unusual[name] = stds, ratio, length_m / float(rows.n_steps[own].sum())
        if unusual:
            name = max(unusual, key=lambda n: unusual[n][0])
            stds, ratio, step_m = unusual[name]
            others = f" (and {len(unusual) - 1} more)" if len(unusual) > 1 else ""
            found.append(
                f"WARNING: steps of {context} in {name}{others} are {step_m:.2f} m long, {abs(ratio - 1):.0%} "
                f"{'longer' if ratio > 1 else 'shorter'} than usual, {stds:.1f} standard deviations between people: "
                f"{_CAUSE}; check them, and do not use this calibration if they are wrong"
            )
    return found


def impossible_steps(length_m: float, n_steps: float, n_running: float) -> str:
    """Return a text with cause and remedy if nobody takes steps of this total length, or an empty string.

    `n_running` of the `n_steps` steps are of running.
    """
    shortest_m, longest_m = limits.STEP_LENGTH_RANGE_M
    most_m = limits.MAX_WALKING_STEP_M * (n_steps - n_running) + longest_m * n_running
    if shortest_m * n_steps <= length_m <= most_m:
        return ""
    return (
        f"its steps would be {length_m / max(n_steps, 1e-9):.2g} m long, which nobody walks: {_CAUSE}, or most steps "
        "were not detected; correct them, or leave the recording out"
    )
