"""Where somebody is on a floor plan, as particles say it: one place or several."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """A part of the plan where somebody may be, apart from all others."""

    share: float  # its probability
    position_m: FloatArray  # (2,) mean
    position_cov_m2: FloatArray  # (2, 2)


@dataclass(frozen=True, slots=True, eq=False)
class OnPlan:
    """What particles on a floor plan say after a step: mean and covariance of all, and where they are in groups.

    The covariance reaches dead reckoning as well, as far as the walk may be where no particle is.
    """

    position_m: FloatArray  # (2,) east, north
    position_cov_m2: FloatArray  # (2, 2)
    walking_heading_rad: float
    clusters: tuple[Cluster, ...]  # the most probable first; what their shares lack to one is that it is in none
    n_particles: int
    effective_sample_size: float  # 1 / sum of squared weights
