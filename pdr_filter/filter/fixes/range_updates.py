"""Updates by ranges to anchors.

The update is linear if the track is known well. Otherwise a search finds the positions that fit the last ranges.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from pdr_filter.filter.fixes.gating import Filters, Result, gap_displacement_var_m2
from pdr_filter.filter.fixes.measurement_updates import on_measurement
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE
from pdr_filter.filter.pedestrian.alignment import transformed_estimates
from pdr_filter.filter.pedestrian.pedestrian_state import (
    PedestrianState,
    Rival,
    in_other_frame,
    track_pose,
    with_detached_path,
)
from pdr_filter.filter.pedestrian.range_solutions import (
    PairedRange,
    PriorPose,
    RangeSolution,
    log_density_unmoved,
    recent,
    solutions,
)
from pdr_filter.filter.pedestrian.relocation import PRIOR_LOG_ODDS
from pdr_filter.values import FloatArray, RangeFix, read_only

# Smallest number and share of rejected ranges among the last ones from which the track may be wrong. Most ranges of one
# moment can be reflections, but not most ranges of half a minute to all anchors.
_MIN_CONTRADICTING, _CONTRADICTING_SHARE = 8, 0.6
# Smallest number of direct ranges that determine the pose of a track, and of anchors. There are three unknowns, and the
# other ranges verify them, because three reflected ranges also fit some position. With a prior of the pose fewer ranges
# are sufficient.
_MIN_DIRECT, _MIN_DIRECT_KNOWN, _MIN_ANCHORS = 9, 4, 2
# Prior of the share of reflections, as counts of a beta distribution.
_PRIOR_REFLECTED, _PRIOR_RANGES = 1.0, 10.0
# Largest expected share, so that correct ranges are used again after a time behind walls.
_MAX_REFLECTED = 0.35
# Smallest time between searches. A search takes 35 ms, and ranges can arrive 60 times a second.
_SEARCH_INTERVAL_S = 0.5
# Added to covariances before inversion: the square of 1 mm.
_MIN_VAR = 1e-6


def on_range(filters: Filters, state: PedestrianState, fix: RangeFix, earlier: FloatArray) -> Result:
    """Return the state after a range, the outcome, and the normalised innovation squared.

    `earlier` (3,) is east, north and device heading of the track at the time of the range. If the frame of the anchors
    is unknown, or if the track is too uncertain for a linear update, the range waits for further ones ("waiting").
    Together they determine the position of the track ("placed"). The innovation is then NaN. Ranges that contradict the
    track for long relocate it ("moved"). If two positions fit, both are followed, and the state has a `rival`. A range
    within a gap, after which the track is too uncertain, has "nothing to compare".
    """
    is_joined = state.frame.is_joined
    if is_joined and not _is_wide(state, fix, earlier):
        direct_prob = partial(fix.direct_prob, reflected_prob=_reflected_prob(state.fixes.ranges))
        updated, outcome, nis = on_measurement(filters, state, fix, earlier, direct_prob)
        pair = PairedRange(fix, read_only(earlier[:2]), outcome == "used")
        updated = _with_ranges(updated, recent(updated.fixes.ranges, pair))
        if outcome == "used" or not _is_contradicted(updated.fixes.ranges) or _searched_just_now(state, fix):
            return updated, outcome, nis
        updated = _with_search(updated, fix)
        found = solutions(updated.fixes.ranges)
        better = found[0].log_density - log_density_unmoved(updated.fixes.ranges) if found else 0.0
        if better < 2.0 * PRIOR_LOG_ODDS or len(found) != 1 or not found[0].is_settled:
            return updated, outcome, nis
        return _with_solution(updated, found[0]), "moved", nis
    if gap_displacement_var_m2(filters, state, fix.time_s):
        # no steps connect a range within a gap with later ranges
        return state, "nothing to compare", np.nan
    pairs = recent(state.fixes.ranges, PairedRange(fix, read_only(earlier[:2]), is_used=False))
    state = _with_ranges(state, pairs)
    if is_joined:  # the state already contains the used ranges
        pairs = tuple(pair for pair in pairs if not pair.is_used)
    anchors = {tuple(pair.fix.anchor_m.tolist()) for pair in pairs}
    n_least = _MIN_DIRECT_KNOWN if is_joined else _MIN_DIRECT
    if len(pairs) < n_least or len(anchors) < _MIN_ANCHORS or len(state.steps.trail) == 0:
        return state, "waiting", np.nan
    if _searched_just_now(state, fix):
        return state, "waiting", np.nan
    state = _with_search(state, fix)
    found = solutions(pairs, _prior(state))
    is_clear = 0 < len(found) <= 2 and all(s.is_settled and sum(s.fits) >= n_least for s in found)
    if not is_clear:
        return state, "waiting", np.nan
    first, *others = (_with_solution(state, solution) for solution in found)
    if others:
        first = replace(first, rival=Rival(others[0], found[1].log_odds))
    return first, "placed", np.nan


def _reflected_prob(pairs: tuple[PairedRange, ...]) -> float:
    """Return the expected share of reflected ranges, from the last ranges, at most `_MAX_REFLECTED`.

    Ranges that the filter has not used count as reflected. The share differs between an open hall and rooms behind
    walls.
    """
    n_reflected = sum(not pair.is_used for pair in pairs)
    return min((_PRIOR_REFLECTED + n_reflected) / (_PRIOR_RANGES + len(pairs)), _MAX_REFLECTED)


def _searched_just_now(state: PedestrianState, fix: RangeFix) -> bool:
    """Return True if the range `fix` is later than the last search for a position by less than `_SEARCH_INTERVAL_S`.

    A search looks for the positions of the track that the last ranges together allow. The caller omits the search if
    the result is True. The result is False for a range of the same time as the last search.
    """
    return 0.0 < fix.time_s - state.fixes.searched_s < _SEARCH_INTERVAL_S


def _with_search(state: PedestrianState, fix: RangeFix) -> PedestrianState:
    """Return the state with the time of a range as the time of the last search."""
    return replace(state, fixes=replace(state.fixes, searched_s=fix.time_s))


def _with_ranges(state: PedestrianState, pairs: tuple[PairedRange, ...]) -> PedestrianState:
    """Return the state with its stored ranges replaced by other ones."""
    return replace(state, fixes=replace(state.fixes, ranges=pairs))


def _is_contradicted(pairs: tuple[PairedRange, ...]) -> bool:
    """Return True if at least `_MIN_CONTRADICTING` of the last ranges, and most of them, were rejected."""
    n_rejected = sum(not pair.is_used for pair in pairs)
    return n_rejected >= _MIN_CONTRADICTING and n_rejected > _CONTRADICTING_SHARE * len(pairs)


def _is_wide(state: PedestrianState, fix: RangeFix, earlier: FloatArray) -> bool:
    """Return True if the track is too uncertain for a linear update by a range.

    A range defines a circle around the anchor, which a linear update replaces by a tangent. An arc of radius r deviates
    from its tangent by s^2 / 2r (the sagitta) at a distance s from the tangent point. Here s is the standard deviation
    of the track position along the tangent. The track is too uncertain if this deviation exceeds the standard deviation
    of the range.
    """
    away_m = earlier[:2] - fix.anchor_m[:2]
    level_m, cov_m2 = math.hypot(*away_m), track_pose(state).cov_m2
    if level_m < fix.std_m:  # near the anchor its direction is unknown
        var_m2 = float(np.linalg.eigvalsh(cov_m2)[-1])
    else:
        across = np.array([-away_m[1], away_m[0]]) / level_m
        var_m2 = float(across @ cov_m2 @ across)
    return var_m2 > 2.0 * max(math.hypot(level_m, fix.up_m), fix.std_m) * fix.std_m


def _prior(state: PedestrianState) -> PriorPose | None:
    """Return the prior of position and rotation for a search, or None if nothing is known about them.

    In a joined frame it is the present estimate, which contains the used ranges. Otherwise the rotation comes from the
    compass or a heading fix, and the position from the last position fix.
    """
    frame, (x, P) = state.frame, state.estimates.combined
    if frame.is_joined:
        cov = P[: HEADING_OFFSET + 1, : HEADING_OFFSET + 1] + _MIN_VAR * np.eye(3)
        cov[:2, :2] += state.estimates.consider_cov_m2
        return PriorPose(x[:2], x[:2], np.asarray(np.linalg.inv(cov), dtype=float))
    information, angle_rad, position_m = np.zeros((3, 3)), 0.0, x[:2]
    if math.isfinite(frame.north_var_rad2):
        information[2, 2] = 1.0 / max(frame.north_var_rad2, _MIN_VAR)
    if frame.compass is not None:
        information[2, 2], angle_rad = 1.0 / max(frame.compass.std_rad**2, _MIN_VAR), frame.compass.angle_rad
    track_m = x[:2]
    if frame.pairs:  # position fixes, or the position at a lost heading
        pair = frame.pairs[-1]
        track_m, position_m = pair.track_m, pair.world_m
        information[:2, :2] = np.eye(2) / max(pair.var_m2, _MIN_VAR)
    return PriorPose(track_m, position_m, information, angle_rad) if information.any() else None


def _with_solution(state: PedestrianState, solution: RangeSolution) -> PedestrianState:
    """Return the state at the pose of a solution, which is a position and rotation that fit the last ranges.

    The solution replaces the estimates of position and heading, because it contains all information about them. In a
    joined frame, earlier steps are not changed. The stored ranges and used fixes are deleted.
    """
    n_steps, is_joined = state.steps.n_final, state.frame.is_joined
    alignment = solution.alignment(n_steps, n_steps if is_joined else state.frame.since)
    if is_joined:
        frame = replace(state.frame, later=(*state.frame.later, alignment), north_var_rad2=0.0)
        state = in_other_frame(with_detached_path(state), alignment)
    else:
        frame = state.frame.with_alignment(alignment)
        state = with_detached_path(in_other_frame(state, alignment))
    estimates = state.estimates
    mean, cov = estimates.mean.copy(), estimates.cov.copy()
    mean[:, :LOG_SCALE] = estimates.combined[0][:LOG_SCALE]
    cov[:, :LOG_SCALE] = cov[:, :, :LOG_SCALE] = 0.0
    about = replace(alignment, angle_rad=0.0, track_centre_m=alignment.world_centre_m)
    _, cov = transformed_estimates(mean, cov, about)
    no_error_m = np.zeros_like(estimates.consider_error_m)
    located = replace(estimates, mean=mean, cov=cov, consider_error_m=no_error_m)
    return replace(state, estimates=located, frame=frame, fixes=replace(state.fixes, ranges=(), used=()))
