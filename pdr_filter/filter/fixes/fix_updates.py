"""Measurement updates by position, heading and speed fixes, and by standstills.

Position fixes with correlated errors: let a fix have the index n, the position z_n and the true position p_n, and let
z_i be an earlier fix with the error e_i. The error of fix n is sum_i A_i e_i + w, with regression matrices A_i and an
independent w (`error_given_before`). Let d_i be the displacement of the track from fix i to fix n, psi the error of the
heading offset and s the error of the log scale (true minus estimate). Then z_i + d_i = p_n - psi J d_i - s d_i + e_i,
where J (east, north) = (north, -east).

The measurement is z_n - sum_i A_i (z_i + d_i), in which the errors e_i cancel. Its mean is
(I - sum_i A_i) p_n + sum_i A_i (psi J d_i + s d_i). A filter with the errors of the fixes as further states would give
the same result (A. E. Bryson and L. J. Henrikson, "Estimation using sampled data containing sequentially correlated
noise", J. Spacecraft 5, 1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pdr_filter.filter.fixes.gating import (
    Filters,
    KalmanUpdate,
    Result,
    gap_displacement_var_m2,
    gated_update,
    joined_updates,
    with_consider_path,
)
from pdr_filter.filter.fixes.measurement_updates import on_measurement
from pdr_filter.filter.fixes.range_updates import on_range
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.filter.imm.step_cycle import expect_first_direction
from pdr_filter.filter.pedestrian.alignment import Alignment, walked_var_m2
from pdr_filter.filter.pedestrian.fix_history import UsedFix
from pdr_filter.filter.pedestrian.frame_rotation import PairedPoint, align, degrees_of_freedom, least_squares_error
from pdr_filter.filter.pedestrian.pedestrian_state import (
    PedestrianState,
    in_other_frame,
    reckoned_position,
    track_pose,
    with_change,
    with_detached_path,
    with_joined_frame,
    with_reach_after_fix,
    with_reopened_rotation,
)
from pdr_filter.filter.pedestrian.relocation import RelocationEvidence
from pdr_filter.filter.pedestrian.repeated_fixes import Repetition
from pdr_filter.values import (
    N_BEFORE,
    Fix,
    FloatArray,
    GridFix,
    HeadingFix,
    Measurement,
    PositionFix,
    RangeFix,
    SpeedFix,
    Standstill,
    error_given_before,
    read_only,
    repeated_cov_m2,
    stated_fixes,
    wrap_angle,
)
from pdr_filter.values.uncertainty import variance_factor


def use_fix(filters: Filters, state: PedestrianState, fix: Fix) -> Result:
    """Return the result of `_after_fix`, in which the state has the reach that a fix of the position gives it."""
    updated, outcome, nis = _after_fix(filters, state, fix)
    if updated.estimates is not state.estimates:
        updated = with_reach_after_fix(updated, fix)
    return updated, outcome, nis


def _after_fix(filters: Filters, state: PedestrianState, fix: Fix) -> Result:
    """Return the state after a fix, the outcome of the fix, and its normalised innovation squared (NIS).

    The NIS is that of the mixture of all filters (`gating.gated_update`), or NaN if no filter was compared with the
    fix. A fix is rejected if its NIS exceeds the gate. A fix older than the stored steps is rejected with infinite NIS,
    except speed fixes, grid fixes and standstills. A fix that repeats an earlier one is not used: it is "repeated", or
    "frozen" if it is a position and steps continue. If the frame of the fixes is unknown, the first position fix poses
    the track in it, and later ones rotate it. A standstill is stored and changes no estimate. In an unknown frame, a
    measurement of position and heading is used as two fixes (`stated_fixes`), with the outcome of the position.
    """
    if isinstance(fix, Standstill):
        return replace(state, fixes=state.fixes.with_standstill(fix)), "used", np.nan
    if isinstance(fix, GridFix | SpeedFix):
        state, repetition = _with_memory(state, fix, np.zeros(3))
        if repetition:
            return state, repetition, np.nan
        if isinstance(fix, GridFix):  # used only by the particle filter on a floor plan
            return state, "nothing to compare", np.nan
        return _on_speed(filters, state, fix)
    state = with_reopened_rotation(state)
    if state.frame.is_of_start and not isinstance(fix, PositionFix | HeadingFix | RangeFix):
        state = with_joined_frame(state)  # no density of the rotation follows from a measurement of another class
    if not state.frame.is_joined and isinstance(fix, Measurement) and (stated := stated_fixes(fix)):
        for each in stated[:-1]:
            state, *_ = _after_fix(filters, state, each)
        return _after_fix(filters, state, stated[-1])
    pose = _pose_at(state, fix.time_s)
    if pose is None:
        return state, "rejected", np.inf
    state, repetition = _with_memory(state, fix, pose)
    if repetition:
        return state, repetition, np.nan
    track_m, device_heading_rad = pose[:2], float(pose[2])
    if isinstance(fix, HeadingFix):
        return _on_heading(filters, state, fix, device_heading_rad)
    if isinstance(fix, RangeFix):
        return on_range(filters, state, fix, pose)
    if not isinstance(fix, PositionFix):
        return on_measurement(filters, state, fix, pose)
    if gap_var_m2 := gap_displacement_var_m2(filters, state, fix.time_s):
        fix = replace(fix, cov_m2=read_only(fix.cov_m2 + gap_var_m2 * np.eye(2)))
    if not state.frame.is_joined:
        return _on_first_positions(filters, state, fix, track_m)
    return _on_known_frame(filters, state, fix, track_m)


def _with_memory(state: PedestrianState, fix: Fix, pose: FloatArray) -> tuple[PedestrianState, Repetition]:
    """Return the state that remembers a fix, and whether the fix is a repetition.

    `pose` (3,) is east, north and device heading of the track at the time of the fix.
    """
    fixes = state.fixes
    memory, repetition = fixes.memory.plus(fix, pose, state.estimates.distance_m)
    n_frozen = fixes.n_frozen + (repetition == "frozen")
    n_repeated = fixes.n_repeated + (repetition == "repeated")
    return replace(state, fixes=replace(fixes, memory=memory, n_frozen=n_frozen, n_repeated=n_repeated)), repetition


def _on_position(filters: Filters, state: PedestrianState, fix: PositionFix, track_m: FloatArray) -> Result:
    """Return the state after a position fix in a joined frame, the outcome "used" or "rejected", and the NIS.

    The residual at the time of the fix corrects the present state. A rejected fix leaves the state unchanged. Errors
    have a Student's t distribution, as in `frame_rotation`. If the innovations so far are larger than expected, the
    covariances of track and fixes are increased, with one more degree of freedom for each innovation (M. Roth, E. Ozkan
    and F. Gustafsson, "A Student's t filter for heavy tailed process and measurement noise", ICASSP 2013).
    """
    z, H, R = _without_shared_error(filters, state, fix, track_m)
    estimates, fixes = state.estimates, state.fixes
    cov = estimates.cov.copy()
    cov[:, :2, :2] += estimates.consider_cov_m2
    update = KalmanUpdate(*filters.arithmetic.update(estimates.mean, cov, z, H, R))
    updated, outcome, nis = gated_update(filters, with_consider_path(state, cov), update, filters.model.fix_gate_nis)
    if outcome == "used":
        n_errors, squares = fixes.n_errors + 2, fixes.squares + nis
        # factor for all innovations so far; the covariance already contains the factor for the earlier ones
        larger = variance_factor(squares, n_errors) / variance_factor(fixes.squares, fixes.n_errors)
        no_error_m = np.zeros_like(estimates.consider_error_m)
        estimates = replace(updated.estimates, cov=larger * updated.estimates.cov, consider_error_m=no_error_m)
        fixes = updated.fixes.with_used(fix, _track_m(updated, fix.time_s))
        fixes = replace(fixes, relocation=fixes.relocation.with_used(), n_errors=n_errors, squares=squares)
        frame = updated.frame.with_position(fix.position_m, fix.var_m2)
        updated = replace(updated, estimates=estimates, fixes=fixes, frame=frame)
        updated = with_change(updated, lambda path: path.after_correction(np.zeros(N_STATES), larger))
    return updated if outcome == "used" else state, outcome, nis


def _without_shared_error(
    filters: Filters, state: PedestrianState, fix: PositionFix, track_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a linear measurement (z, H, R) by a fix, with noise that is independent of the errors of earlier fixes.

    The measurement is z (2,) = H x + noise of covariance R, with the present state x (4,): east, north, heading offset
    and log step scale. `track_m` (2,) is the track position at the time of the fix. The docstring of the module has the
    equations. After a gap the displacements d_i are unknown. Then z_n is returned with a larger covariance
    (`repeated_cov_m2`).

    The state x contains the present position and not p_n. The displacement of the track since fix n is therefore added
    to z. Its variance, which is due to heading and step lengths, is added to R.
    """
    x, P = state.estimates.combined
    since_m = track_pose(state).position_m - track_m
    used = state.fixes.used if fix.correlation_s > 0 else ()
    ways_m = [track_m - u.track_m for u in used if u.track_m is not None]
    z, H = fix.position_m, np.eye(2, N_STATES)
    if len(ways_m) < len(used):
        innovation_cov_m2 = repeated_cov_m2(fix, [u.fix for u in used])
    else:
        by_error, innovation_cov_m2 = error_given_before(fix, [u.fix for u in used])
        for A, u, d in zip(by_error, used, ways_m, strict=True):
            z = z - A @ (u.fix.position_m + d)
            H[:, :2] -= A
            H[:, HEADING_OFFSET] += A @ (d[1], -d[0])
            H[:, LOG_SCALE] += A @ d
    since_var = filters.model.noise.log_scale_std**2 + float(P[HEADING_OFFSET, HEADING_OFFSET])
    R = innovation_cov_m2 + since_var * float(since_m @ since_m) * np.eye(2)
    return z + H[:, :2] @ since_m + H[:, 2:] @ x[2:], H, R


def _on_known_frame(filters: Filters, state: PedestrianState, fix: PositionFix, track_m: FloatArray) -> Result:
    """Return the state after a position fix in a joined frame, the outcome of the fix, and its NIS.

    A rejected fix is stored. If many stored fixes contradict the track and agree with each other, the track is
    relocated to them, with outcome "moved".
    """
    updated, outcome, nis = _on_position(filters, state, fix, track_m)
    if outcome == "used":
        return updated, outcome, nis
    pair, heading_var = _paired(state, fix, track_m)
    relocation, can_turn = state.fixes.relocation.with_rejected(pair), state.frame.is_rotation_estimated
    state = replace(state, fixes=replace(state.fixes, relocation=relocation))
    alignment = relocation.alignment(pair, heading_var, state.steps.n_final, can_turn)
    if alignment is None:
        return state, outcome, nis
    state = with_detached_path(state)
    # the alignment already contains the prior of the heading
    cov = expect_first_direction(state.estimates.cov, 0.0)
    fixes = replace(state.fixes, relocation=RelocationEvidence())
    state = in_other_frame(replace(state, estimates=replace(state.estimates, cov=cov), fixes=fixes), alignment)
    moved = replace(alignment, since=alignment.n_steps)
    state = replace(state, frame=replace(state.frame, later=(*state.frame.later, moved)))
    pairs = [pair.with_moved_track(alignment.positions) for pair in relocation.pairs]
    state, nis = _with_second_half(filters, state, fix, alignment.positions(track_m), pairs)
    return state, "moved", nis


def _on_heading(filters: Filters, state: PedestrianState, fix: HeadingFix, device_heading_rad: float) -> Result:
    """Return the state after a heading fix z, the outcome of the fix, and its NIS.

    The measurement equation is z = device heading at the time of the fix + heading offset (state) + heading offset of
    the mode's filter, in rad. If the frame is open (`Frame.is_open`), the first fix rotates the frame and is not gated:
    the NIS is NaN. Before the first step the outcome is "nothing to compare".
    """
    if len(state.steps.trail) == 0:
        return state, "nothing to compare", np.nan
    prob = state.estimates.prob
    innovation = fix.walking_heading_rad - device_heading_rad - state.estimates.mean[:, HEADING_OFFSET]
    innovation = wrap_angle(innovation - filters.offset_rad)
    frame, var = state.frame, fix.std_rad**2
    if frame.is_lost_before_north and state.fixes.n_errors == 0:
        angle_rad = float(np.arctan2(prob @ np.sin(innovation), prob @ np.cos(innovation)))
        turn, whole = frame.turns_about_start(angle_rad, var, state.steps.n_final)
        state = in_other_frame(with_change(state, lambda path: path.turned_until_loss(whole)), turn)
        return replace(state, frame=state.frame.with_whole_north(whole, turn)), "used", np.nan
    if frame.is_open and (frame.north is None or frame.since):
        angle_rad = float(np.arctan2(prob @ np.sin(innovation), prob @ np.cos(innovation)))
        share = 1.0 / (1.0 + var / frame.north_var_rad2)  # weight of the fix against the prior of the rotation
        about_m = frame.pairs[0].track_m if frame.since else np.zeros(2)
        turn = Alignment(share * angle_rad, share * var, about_m, about_m, 0.0, state.steps.n_final, frame.since)
        state = in_other_frame(state, turn)
        return replace(state, frame=state.frame.with_north(turn)), "used", np.nan
    return _on_state(filters, state, HEADING_OFFSET, innovation, var)


def _on_speed(filters: Filters, state: PedestrianState, fix: SpeedFix) -> Result:
    """Return the state after a speed fix, the outcome of the fix, and its NIS.

    With z the speed of the fix and v the smoothed walking speed of the present bout of walking, log z - log v measures
    the error of the log scale to first order. Without v there is nothing to compare.
    """
    speed = state.steps.speed
    if speed is None or speed.smoothed_mps <= 0:
        return state, "nothing to compare", np.nan
    v = speed.smoothed_mps
    variance = (fix.std_mps / v) ** 2 + speed.level_var_m2ps2 / v**2
    innovation = np.full(len(state.estimates.mean), np.log(fix.speed_mps / v))
    return _on_state(filters, state, LOG_SCALE, innovation, variance)


def _on_state(filters: Filters, state: PedestrianState, index: int, innovation: FloatArray, variance: float) -> Result:
    """Return the state after a measurement of one state component, the outcome, and the NIS of the mixture.

    `index` is the index of the component. `innovation` (F,) is the measurement minus the prior mean of each of F
    filters. `variance` is the variance of the measurement. NIS is the normalised innovation squared. A measurement with
    a NIS above `scalar_gate_nis` is rejected.
    """
    prior = state.estimates
    z = prior.mean[:, index] + innovation
    H, R = np.eye(N_STATES)[[index]], np.array([[variance]])
    update = filters.arithmetic.update
    each = [KalmanUpdate(*update(prior.mean[[k]], prior.cov[[k]], z[[k]], H, R)) for k in range(len(z))]
    return gated_update(filters, state, joined_updates(each), filters.model.scalar_gate_nis)


def _on_first_positions(filters: Filters, state: PedestrianState, fix: PositionFix, track_m: FloatArray) -> Result:
    """Return the state after a position fix in a frame that is not joined, the outcome of the fix, and its NIS.

    The first fix places the track ("placed"), and later ones rotate it ("turned"). A fix that is inconsistent with the
    others is "rejected", or relocates the track ("moved"). The NIS is NaN until the frame is joined. The frame is
    joined when the rotation is known well enough. The fix with which this happens has two uses, one for the rotation
    and one for the position. Each use has half of its information.
    """
    pair, _ = _paired(state, fix, track_m)
    frame = state.frame.with_pair(pair)
    agreeing = frame.agreeing
    if state.fixes.relocation.explains(pair):  # one fix alone fits for some rotation, so rejected ones count as well
        return _on_contradicting_fix(state, pair)
    if agreeing[-1] is not pair:
        return _on_contradicting_fix(replace(state, frame=frame), pair)
    fixes = replace(state.fixes, relocation=state.fixes.relocation.with_used())
    state = replace(state, fixes=fixes)
    half = (*agreeing[:-1], replace(pair, var_m2=2.0 * pair.var_m2))
    alignment = (
        align(half, state.steps.n_final, frame.rotation_prior_var_rad2, frame.compass) if frame.is_settled else None
    )
    if alignment is None:
        state = with_reopened_rotation(replace(state, frame=frame))
        return state, "placed" if len(agreeing) == 1 else "turned", np.nan
    squares = least_squares_error(agreeing, frame.rotation_prior_var_rad2)
    state = in_other_frame(state, alignment)
    fixes = replace(state.fixes, n_errors=degrees_of_freedom(agreeing), squares=squares)
    state = replace(state, frame=frame.with_alignment(alignment), fixes=fixes)
    pairs = [pair.with_moved_track(alignment.positions) for pair in agreeing]
    state, nis = _with_second_half(filters, state, fix, alignment.positions(track_m), pairs)
    return state, "turned", nis


def _on_contradicting_fix(state: PedestrianState, pair: PairedPoint) -> Result:
    """Return the state after a fix that is inconsistent with the other fixes of a frame that is not joined.

    The outcome and an infinite NIS follow. The fix is first stored as "rejected". If the stored rejected fixes agree
    with each other for long, the track is relocated to them ("moved"), with an unknown rotation. After a lost heading,
    the track position at the loss counts as one of the other fixes.
    """
    relocation, n_steps = state.fixes.relocation.with_rejected(pair), state.steps.n_final
    state = replace(state, fixes=replace(state.fixes, relocation=relocation))
    if not relocation.contradicts(pair):
        return state, "rejected", np.inf
    turn, (from_m, _) = state.frame.most_probable(n_steps), reckoned_position(state)
    joined = state.frame.with_alignment(turn)
    state = with_detached_path(in_other_frame(state, turn))
    opened = joined.with_lost_heading(state.fixes.relocation.pairs, np.inf, n_steps)
    state = replace(state, frame=opened, fixes=replace(state.fixes, relocation=RelocationEvidence()))
    moved = Alignment(0.0, 0.0, from_m, reckoned_position(state)[0], 0.0, n_steps, since=n_steps)
    return replace(state, frame=replace(state.frame, later=(*joined.later, moved))), "moved", np.inf


def _with_second_half(
    filters: Filters, state: PedestrianState, fix: PositionFix, track_m: FloatArray, pairs: Sequence[PairedPoint]
) -> tuple[PedestrianState, float]:
    """Return the state after an alignment, updated with the unused half of the last fix, and the NIS of this update.

    The alignment has used the other half of the information of `fix`. `pairs` are the aligned fixes, with `fix` as the
    last one, and the track positions after the alignment. `track_m` is the aligned track position of `fix`.
    """
    shared = tuple(
        UsedFix(
            PositionFix(pair.time_s, pair.world_m, pair.var_m2 * np.eye(2), correlation_s=pair.correlation_s),
            pair.track_m,
        )
        for pair in pairs[:-1]
        if pair.correlation_s > 0
    )
    state = replace(state, fixes=replace(state.fixes, used=shared[-N_BEFORE:]))
    half = replace(fix, cov_m2=2.0 * fix.cov_m2)
    updated, outcome, nis = _on_position(filters, state, half, track_m)
    fixes = updated.fixes
    if outcome == "used" and fix.correlation_s > 0:  # stored with its full covariance, not with that of the half
        fixes = replace(fixes, used=fixes.used[:-1])
    return replace(updated, fixes=fixes.with_used(fix, _track_m(updated, fix.time_s))), nis


def _paired(state: PedestrianState, fix: PositionFix, track_m: FloatArray) -> tuple[PairedPoint, float]:
    """Return the fix paired with the track position, and the variance of the heading offset.

    The variance of the track position in the pair does not include that due to the heading.
    """
    _, P = state.estimates.combined
    cov = P.copy()
    cov[:2, :2] += state.estimates.length_parameters_cov_m2
    walked_var = walked_var_m2(cov)
    pair = PairedPoint(read_only(track_m), fix.position_m, fix.var_m2, walked_var, fix.time_s, fix.correlation_s)
    return pair, float(P[HEADING_OFFSET, HEADING_OFFSET])


def _pose_at(state: PedestrianState, time_s: float) -> FloatArray | None:
    """Return east, north and device heading (3,) of the track at a time.

    The result is None if the steps of that time are no longer stored. A track without steps has its present position
    and heading 0.
    """
    if len(state.steps.trail) == 0:
        return np.append(track_pose(state).position_m, 0.0)
    return state.steps.at(time_s)


def _track_m(state: PedestrianState, time_s: float) -> FloatArray | None:
    """Return the track position (2,) at a time, or None if it is before the stored steps."""
    pose = _pose_at(state, time_s)
    return None if pose is None else pose[:2]
