"""One walk on a map of walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class MappedWalk:
    """One walk on a map.

    Attributes
    ----------
    name : str
        Name of the walk.
    group : int
        Number of its group. Walks of one group share a frame.
    time_s : array (K,)
        Times of the steps, in s. Empty on a map that was saved without times.
    position_m : array (K + 1, 2)
        East and north of the start and after each step, in m.
    position_cov_m2 : array (K + 1, 2, 2)
        Covariances of the positions, in m^2.
    floor : array (K + 1,)
        Storey at the start and after each step.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> from dataclasses import replace
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> heard_s = np.repeat([2.0, 5.0], 5)
    >>> wifi = pdr.Wifi(heard_s, np.tile(np.arange(5), 2), np.full(10, -60.0), np.full(10, 2412.0))
    >>> start = pdr.PositionFix(0.0, (3.0, 4.0), np.eye(2))
    >>> walk_map = pdr.map_walks([replace(walk, wifi=wifi)], [(walk.name, start)])
    >>> walk_map.walks[0].at(0.0)[0].round(1)
    array([3., 4.])
    """

    name: str
    group: int
    time_s: FloatArray
    position_m: FloatArray
    position_cov_m2: FloatArray
    floor: IntArray

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the position (2,) and its covariance (2, 2) at a time.

        Parameters
        ----------
        time_s : float
            Time since the first sample, in s.

        Returns
        -------
        tuple of array
            Position and covariance after the last step before this time.

        Raises
        ------
        ValueError
            If the map was saved without times.
        """
        if not len(self.time_s):
            raise ValueError(f"{self.name} has no times: save the map with times=True, or map the recordings again")
        k = int(np.searchsorted(self.time_s, time_s, side="right"))
        return self.position_m[k], self.position_cov_m2[k]
