"""Position estimate of the particle filter on a floor plan, with one or several candidate areas."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Group of particles on a floor plan: one candidate area for the position, separate from all others.

    Attributes
    ----------
    share : float
        Probability of the group. If the probabilities of all groups do not sum to one, the rest is the probability that
        the walk is in none of them.
    position_m, position_cov_m2 : ndarray, shape (2,) and (2, 2)
        Mean position, east and north, m, and covariance within the group, m^2.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter import Cluster
    >>> corridor = Cluster(0.8, np.array([3.0, 12.0]), 0.5 * np.eye(2))
    >>> corridor.share
    0.8
    """

    share: float
    position_m: FloatArray
    position_cov_m2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class OnPlan:
    """Estimate of the particle filter on a floor plan after a step: moments of all particles, and their groups.

    The covariance also covers the dead-reckoned position, or the storey if no fix places it, with the probability that
    the pedestrian is where no particle is.

    Attributes
    ----------
    position_m, position_cov_m2 : ndarray, shape (2,) and (2, 2)
        Mean position of all particles, east and north, m, and its covariance, m^2.
    walking_heading_rad : float
        Mean walking direction, rad, clockwise from the north of the plan.
    clusters : tuple of Cluster
        Groups of particles, most probable first. Their shares sum to less than 1 by the probability of particles
        outside of all groups.
    n_particles : int
        Number of particles.
    effective_sample_size : float
        1 / sum of squared weights.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter import OnPlan
    >>> estimate = OnPlan(np.zeros(2), np.eye(2), 0.0, clusters=(), n_particles=1000, effective_sample_size=640.0)
    >>> estimate.effective_sample_size / estimate.n_particles
    0.64
    """

    position_m: FloatArray
    position_cov_m2: FloatArray
    walking_heading_rad: float
    clusters: tuple[Cluster, ...]
    n_particles: int
    effective_sample_size: float
