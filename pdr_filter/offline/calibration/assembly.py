"""Assembly of a `Calibration` from the estimate of segments or of smoothed walks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from pdr_filter.offline.calibration.model_forms import models_of
from pdr_filter.offline.calibration.priors import StepLengthPrior
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.values import Table
from pdr_filter.version import __version__

if TYPE_CHECKING:
    from pdr_filter.offline.calibration.estimation import ParameterEstimate
    from pdr_filter.offline.calibration.joint_smoothing import JointEstimate


def assembled(
    priors: Mapping[str, StepLengthPrior],
    found: ParameterEstimate | JointEstimate,
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
