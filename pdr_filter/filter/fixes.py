"""What a fix of position, heading or speed, or a standstill, does to what a filter knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdr_filter.filter import imm
from pdr_filter.filter.alignment import Alignment, Frame, PairedPoint, align
from pdr_filter.filter.imm import ImmArithmetic
from pdr_filter.filter.model import PedestrianModel
from pdr_filter.filter.motion import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.filter.pedestrian import (
    TRAIL_HEADING,
    TRAIL_POSITION,
    TRAIL_STEPS,
    TRAIL_TIME,
    PedestrianState,
    in_other_frame,
    own_place,
    shared_cov,
)
from pdr_filter.values import (
    Fix,
    FixOutcome,
    FloatArray,
    HeadingFix,
    PositionFix,
    SpeedFix,
    Standstill,
    read_only,
    wrap_angle,
)

MAX_STANDSTILLS = 16
_Result = tuple[PedestrianState, FixOutcome, float]


def use_fix(
    model: PedestrianModel, arithmetic: ImmArithmetic, state: PedestrianState, offset_rad: FloatArray, fix: Fix
) -> _Result:
    """New state, what became of the fix, and its normalised innovation squared in the filter that explains it best.

    A fix that no filter can explain, or that is older than the remembered steps, is rejected. Where the frame of the
    fixes is not known, the first position fix places the track in it, and those that follow turn it.
    `offset_rad` (F,) is the filters' own walking heading less the heading that the body faces.
    """
    if isinstance(fix, Standstill):
        standstills = (*state.standstills, (fix.time_s, fix.end_s))[-MAX_STANDSTILLS:]
        return replace(state, standstills=standstills), "used", np.nan
    if isinstance(fix, SpeedFix):
        return _on_speed(model, arithmetic, state, fix)
    then = _place_at(state, fix.time_s)
    if then is None:
        return state, "rejected", np.inf
    if isinstance(fix, HeadingFix):
        return _on_heading(model, arithmetic, state, offset_rad, fix, float(then[2]))
    if not state.frame.is_joined:
        return _on_first_positions(model, arithmetic, state, fix, then[:2])
    return _on_position(model, arithmetic, state, fix, then[:2])


def _on_position(
    model: PedestrianModel, arithmetic: ImmArithmetic, state: PedestrianState, fix: PositionFix, then_m: FloatArray
) -> _Result:
    """The track at the fix's own time corrects the present; the heading's part in what was walked since stays as is."""
    since_m = state.trail[-1, TRAIL_POSITION] - then_m if len(state.trail) else np.zeros(2)
    # what was walked since is known as well as a person's step length is
    R = fix.cov_m2 + (model.noise.log_scale_std**2 * float(since_m @ since_m)) * np.eye(2)
    cov = state.cov.copy()
    cov[:, :2, :2] += shared_cov(state)
    updated = arithmetic.update(state.mean, cov, fix.position_m + since_m, np.eye(2, N_STATES), R)
    state, outcome, nis = _gated(arithmetic, state, updated, model.fix_gate_nis)
    if outcome == "used":
        state = replace(state, shared_m=np.zeros_like(state.shared_m))
    return state, outcome, nis


def _on_heading(
    model: PedestrianModel,
    arithmetic: ImmArithmetic,
    state: PedestrianState,
    offset_rad: FloatArray,
    fix: HeadingFix,
    device_heading_rad: float,
) -> _Result:
    """Z = device heading then + heading offset + the filter's own; where no north is known yet, it defines it."""
    if len(state.trail) == 0:
        return state, "nothing to compare", np.nan
    innovation = fix.walking_heading_rad - device_heading_rad - state.mean[:, HEADING_OFFSET]
    innovation = wrap_angle(innovation - offset_rad)
    if not state.frame.is_joined and state.frame.north is None:
        angle_rad = float(np.arctan2(state.prob @ np.sin(innovation), state.prob @ np.cos(innovation)))
        turn = Alignment(angle_rad, fix.std_rad**2, np.zeros(2), np.zeros(2), 0.0, state.n_final)
        state = in_other_frame(state, turn)
        return replace(state, frame=state.frame.with_north(turn)), "used", np.nan
    return _on_state(model, arithmetic, state, HEADING_OFFSET, innovation, fix.std_rad**2)


def _on_speed(model: PedestrianModel, arithmetic: ImmArithmetic, state: PedestrianState, fix: SpeedFix) -> _Result:
    """Log z - log v = error of the log scale, v the smoothed speed of the present bout, to first order."""
    if state.speed is None or state.speed.smoothed_mps <= 0:
        return state, "nothing to compare", np.nan
    v = state.speed.smoothed_mps
    variance = (fix.std_mps / v) ** 2 + state.speed.level_var_m2ps2 / v**2
    innovation = np.full(len(state.mean), np.log(fix.speed_mps / v))
    return _on_state(model, arithmetic, state, LOG_SCALE, innovation, variance)


def _on_state(
    model: PedestrianModel,
    arithmetic: ImmArithmetic,
    state: PedestrianState,
    index: int,
    innovation: FloatArray,
    variance: float,
) -> _Result:
    """State after a measurement of one of its entries, whose innovation (F,) is another one for each filter."""
    z = state.mean[:, index] + innovation
    H, R = np.eye(N_STATES)[[index]], np.array([[variance]])
    each = [arithmetic.update(state.mean[[k]], state.cov[[k]], z[[k]], H, R) for k in range(len(z))]
    mean, cov, log_likelihood, nis = (np.concatenate([result[i] for result in each]) for i in range(4))
    return _gated(arithmetic, state, (mean, cov, log_likelihood, nis), model.scalar_gate_nis)


def _gated(
    arithmetic: ImmArithmetic,
    state: PedestrianState,
    updated: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    gate_nis: float,
) -> _Result:
    """State after an update, or without it if no filter explains the measurement."""
    mean, cov, log_likelihood, nis = updated
    best_nis = float(nis.min())
    if not best_nis <= gate_nis:
        return state, "rejected", best_nis
    before_m = own_place(state).position_m
    prob = arithmetic.update_mode_prob(state.prob, log_likelihood)
    state = replace(state, mean=mean, cov=cov, prob=prob)
    trail = state.trail.copy()
    trail[:, TRAIL_POSITION] += own_place(state).position_m - before_m
    return replace(state, trail=trail), "used", best_nis


def _on_first_positions(
    model: PedestrianModel, arithmetic: ImmArithmetic, state: PedestrianState, fix: PositionFix, then_m: FloatArray
) -> _Result:
    """State that is placed or turned by one fix more, in the frame of the fixes once the turn is settled.

    The fix that settles it says two things, how far the track is turned and where it is now, each with half of what
    it knows.
    """
    _, P = imm.combine(state.mean, state.cov, state.prob)
    cov = P.copy()
    cov[:2, :2] += shared_cov(state)
    # a heading that is known has no part in it
    of_heading, heading_var = cov[:2, HEADING_OFFSET], max(float(cov[HEADING_OFFSET, HEADING_OFFSET]), 1e-12)
    walked_var = 0.5 * float(np.trace(cov[:2, :2]) - of_heading @ of_heading / heading_var)
    pair = PairedPoint(read_only(then_m), fix.position_m, 0.5 * float(np.trace(fix.cov_m2)), walked_var)
    frame = state.frame.with_pair(pair)
    agreeing = frame.agreeing
    if agreeing[-1] is not pair:
        return replace(state, frame=frame), "rejected", np.inf
    half = (*agreeing[:-1], replace(pair, var_m2=2.0 * pair.var_m2))
    alignment = align(half, state.n_final, frame.north_var_rad2, frame.compass)
    if alignment is None:
        return replace(state, frame=frame), "placed" if len(agreeing) == 1 else "turned", np.nan
    joined = Frame(is_joined=True, alignment=alignment, north=frame.north)
    state = replace(in_other_frame(state, alignment), frame=joined)
    now_m = alignment.positions(then_m)
    state, _, nis = _on_position(model, arithmetic, state, replace(fix, cov_m2=2.0 * fix.cov_m2), now_m)
    return state, "turned", nis


def _place_at(state: PedestrianState, time_s: float) -> FloatArray | None:
    """East, north and device heading (3,) at a time; None if the time is no longer remembered."""
    trail = state.trail
    if len(trail) == 0:
        return np.zeros(3)
    if time_s < trail[0, TRAIL_TIME] and len(trail) == TRAIL_STEPS:
        return None
    return np.array([np.interp(time_s, trail[:, TRAIL_TIME], trail[:, k]) for k in range(1, TRAIL_HEADING + 1)])
