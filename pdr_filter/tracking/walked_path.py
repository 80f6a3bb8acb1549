"""Estimated path of a whole walk so far, for an app that draws it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.chain.handler import part_of
from pdr_filter.filter.chain.with_path import PathState
from pdr_filter.filter.imm.motion_model import MotionNoise, bounded_position_cov, reach_m
from pdr_filter.filter.pedestrian.past_path import aligned_positions
from pdr_filter.filter.pedestrian.pedestrian_state import PAUSE_S, track_pose, within_reach
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.extrapolation import present_pose
from pdr_filter.tracking.filtering import State
from pdr_filter.values import FloatArray, read_only
from pdr_filter.values.uncertainty import worst_std_m


@dataclass(frozen=True, slots=True, eq=False)
class WalkedPath:
    """Estimated path of a walk so far: one row for each step, and one for the present position.

    Rows of past steps are smoothed: later fixes, headings and contexts correct them. They therefore differ from the
    positions that were reported at the time of the steps. Rows before a lost heading, or before fixes moved the track,
    are no longer corrected. The filter keeps 8192 steps, an hour of walking. Of a longer walk it keeps 8192 rows, the
    older ones at even intervals. While fixes leave the rotation of the track open, the path has the most probable
    rotation, so that its shape is preserved, and `OnlineFilter.now` is the mean over all rotations.

    Attributes
    ----------
    time_s : ndarray, shape (K,)
        Increasing times on the clock of the track, s.
    position_m : ndarray, shape (K, 2)
        East and north in the frame of `OnlineFilter.now`, m.
    position_cov_m2 : ndarray, shape (K, 2, 2)
        Covariance of each position, m^2.
    n_steps : int
        Number of leading rows that are accepted steps. The other rows are provisional steps and the present position.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> samples = pdr.merge_streams(pdr.simulate.demo_walk())
    >>> online = pdr.OnlineFilter()
    >>> _ = online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps)
    >>> path = online.path()
    >>> path.position_m.shape == (len(path.time_s), 2)
    True
    >>> bool((path.position_m[-1] == online.now().position_m).all())
    True
    """

    time_s: FloatArray
    position_m: FloatArray
    position_cov_m2: FloatArray
    n_steps: int

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def position_std_m(self) -> FloatArray:
        """Standard deviation (K,) of each position in its least certain direction, m."""
        return worst_std_m(self.position_cov_m2)


def walked_path(config: Config, state: State) -> WalkedPath:
    """Return the path of the walk so far: final steps, candidate steps and the present position.

    Of a walk of more than 8192 final steps, 8192 rows are kept, the older ones at even intervals. ValueError with a
    floor plan, because each particle has its own path, and without `Config.keeps_path`.
    """
    if config.on_plan is not None:
        raise ValueError(
            "path is not available with a floor plan, because each particle has its own path: draw the positions of "
            "the updates, and smooth the finished walk with pdr_filter.smooth"
        )
    if not config.keeps_path:
        raise ValueError(
            "path is not available, because keeps_path of the configuration is False: use "
            "dataclasses.replace(config, keeps_path=True)"
        )
    pedestrian = state.pedestrian
    estimates = pedestrian.estimates
    P, present_m = estimates.combined[1], track_pose(pedestrian).position_m
    path = part_of(state.chain, PathState).path
    time_s, position_m, cov_m2 = path.positions(P, estimates.consider_cov_m2, present_m)
    n_steps, present = len(time_s), present_pose(config, state)
    ahead = [(step.time_s, step.position_m) for step in present.steps]
    last_s = ahead[-1][0] if ahead else float(time_s[-1]) if len(time_s) else -np.inf
    if present.time_s > last_s:
        ahead.append((present.time_s, present.pose.position_m))
    (ee, en), (_, nn) = present.pose.cov_m2
    time_s = np.append(time_s, [t for t, _ in ahead])
    position_m = np.concatenate([position_m, np.array([m for _, m in ahead]).reshape(-1, 2).T], axis=1)
    cov_m2 = np.concatenate([cov_m2, np.tile([[ee], [en], [nn]], len(ahead))], axis=1)
    turn = pedestrian.frame.present_alignment
    if turn is not None:
        first = int(np.searchsorted(time_s, path.since_s, side="right"))
        position_m[:, first:], cov_m2[:, first:] = aligned_positions(turn, position_m[:, first:], cov_m2[:, first:])
    cov_m2 = cov_m2[[0, 1, 1, 2]].T.reshape(-1, 2, 2)
    start_std_m = np.inf if pedestrian.frame.is_known else math.sqrt(pedestrian.unstepped_var_m2)
    known, new = slice(len(time_s) - len(ahead)), slice(len(time_s) - len(ahead), None)
    cov_m2[new] = within_reach(cov_m2[new], pedestrian.frame, present.reach_m)  # as in `OnlineFilter.now`
    cov_m2[known] = _bounded(cov_m2[known], time_s[known], position_m[:, known], config.model.noise, start_std_m)
    return WalkedPath(read_only(time_s), read_only(position_m.T), read_only(cov_m2), n_steps)


def _bounded(
    cov_m2: FloatArray, time_s: FloatArray, position_m: FloatArray, noise: MotionNoise, start_std_m: float
) -> FloatArray:
    """Return covariances (K, 2, 2) whose standard deviations change by at most the way between the positions (2, K).

    Between two steps that are a pause apart, the pedestrian may have walked as in a gap. `start_std_m` is the standard
    deviation of the start.
    """
    lasted_s = np.diff(time_s, prepend=time_s[:1])
    gap_m = np.sqrt(noise.gap_var_m2(np.where(lasted_s > PAUSE_S, lasted_s, 0.0)))
    moved_m = np.hypot(*np.diff(position_m, axis=1, prepend=np.zeros((2, 1))))
    way_m = np.append(0.0, np.cumsum(np.maximum(moved_m, gap_m)))
    return bounded_position_cov(cov_m2, reach_m(way_m, np.append(start_std_m, worst_std_m(cov_m2)))[1:])
