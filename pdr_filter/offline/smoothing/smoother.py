"""A whole recording in hindsight: steps, position fixes, loop closures and known headings in one least-squares problem.

States are at anchors only, east, north, heading offset and log step scale each; what was walked between two anchors is
one linear factor (`pdr_filter.offline.smoothing.preintegration`), so that the cost follows the anchors and not the
steps. GTSAM eliminates the linear graph of every Gauss-Newton iteration and gives the marginals; no Python is called
back from it. docs/methods/smoothing.md has the equations and the figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import gtsam
import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter.imm import smoothed_mode_prob
from pdr_filter.filter.motion import (
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    N_STATES,
    Mode,
    MotionNoise,
    second_order_errors,
)
from pdr_filter.filter.step_length import StepLengthFit
from pdr_filter.io.recording import Recording
from pdr_filter.offline.smoothing.hindsight import Hindsight, in_hindsight
from pdr_filter.offline.smoothing.preintegration import (
    MIN_STATE_VAR,
    TURN,
    Increments,
    Intervals,
    advance,
    bridge,
    frame,
    increments,
    preintegrate,
    turned,
)
from pdr_filter.recording_run import collected, default_config, outputs
from pdr_filter.tracks import Track
from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray, Table, read_only, table
from pdr_filter.values.fixes import PositionFix

if TYPE_CHECKING:
    from pdr_filter.calibration import Calibration

_POSITION = slice(0, 2)
# 99.9 % of good observations are below: chi-square with two degrees of freedom, and with one. That of the fixes is the
# gate of the filter.
_PLACE_NIS, _DIRECTION_NIS = 13.8, 10.8
# Graduated non-convexity: by how much the truncation tightens in an iteration (Yang et al. 2020, section V).
_GNC_FACTOR = 1.4
# Nothing is known of where the walk began in the frame of the fixes, apart from being in the same region.
_ANYWHERE_STD_M = 1000.0
_HERE_STD_M = _HERE_STD_RAD = 1e-3
# Fixes so far outside the samples still count as at their ends: clocks are not better than that.
_OUTSIDE_S = 1.0
# No position on a walking body means more than this.
_BEST_FIX_M = 0.01
# A heading of a corridor says nothing about somebody who stands in it.
_MIN_HEADING_LENGTH_M = 1.0


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Two times at which the pedestrian was at the same place, within `std_m` along each axis."""

    first_s: float
    second_s: float
    std_m: float = 0.5

    def __post_init__(self) -> None:
        if not (self.first_s < self.second_s and 0 < self.std_m < np.inf):
            raise ValueError(f"a loop closure needs first_s < second_s and std_m > 0, got {self}")


@dataclass(frozen=True, slots=True)
class KnownHeading:
    """The direction from where the pedestrian was at one time to where he was at another: a corridor's.

    Clockwise from north of the frame of the fixes.
    """

    start_s: float
    end_s: float
    heading_rad: float
    std_rad: float = 0.05

    def __post_init__(self) -> None:
        if not (self.start_s < self.end_s and np.isfinite(self.heading_rad) and 0 < self.std_rad < np.inf):
            raise ValueError(f"a known heading needs start_s < end_s, a finite heading and std_rad > 0, got {self}")


@dataclass(frozen=True, slots=True)
class FloorChange:
    """From this time on the pedestrian is on another storey; 0 is the ground floor. Carried through, not estimated."""

    time_s: float
    floor: int


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The track in hindsight, and what was learnt on the way.

    Where there were fixes, positions are in their frame and headings clockwise from its north; where there were none,
    they are those of the filter, from the start and the first heading.
    """

    track: Track
    heading_offset_rad: FloatArray  # (K,) walking less device heading after each step, the map's rotation included
    heading_offset_std_rad: FloatArray  # (K,)
    log_scale: FloatArray  # (K,) of the step lengths
    log_scale_std: FloatArray  # (K,)
    start_position_m: FloatArray  # (2,)
    start_position_cov_m2: FloatArray  # (2, 2)
    # A row for each observation: kind ("fix", "loop closure", "known heading"), number in its sequence, time_s, nis
    # (squared distance from what all others say, normalised by its covariance; NaN outside the recording) and weight
    # (1 used, 0 rejected or outside).
    observations: Table
    floor: FloatArray  # (K,) storey at each step, NaN where no floor change says it
    notes: tuple[str, ...]

    @property
    def scale(self) -> float:
        """The person's factor on every step length, mean over the steps; 1 without steps."""
        return float(np.exp(self.log_scale.mean())) if len(self.log_scale) else 1.0

    @property
    def scale_std(self) -> float:
        """Standard deviation of `scale`: an error that the steps share."""
        return float(self.scale * self.log_scale_std.mean()) if len(self.log_scale) else np.nan

    @property
    def rejected(self) -> Table:
        """The observations that were not used."""
        return self.observations[self.observations.weight < 0.5].view(np.recarray)

    def __repr__(self) -> str:
        return (
            f"Smoothed({self.track!r}, scale {self.scale:.3f} +- {self.scale_std:.3f}, {len(self.rejected)} rejected)"
        )


def smooth(
    recording: Recording,
    fixes: Sequence[PositionFix] = (),
    calibration: Calibration | None = None,
    *,
    config: Config | None = None,
    loop_closures: Sequence[LoopClosure] = (),
    known_headings: Sequence[KnownHeading] = (),
    floor_changes: Sequence[FloorChange] = (),
    start_heading_std_rad: float | None = None,
    anchor_interval_s: float = 10.0,
) -> Smoothed:
    """The walk of a recording as everything that is known of it says, with a covariance at every step.

    Step scale, heading drift and the heading offsets of each way of carrying the phone are estimated together with the
    positions. Fixes may be in any frame; the rotation against the phone's first heading is estimated. Observations that
    the walk cannot explain are rejected and named in `observations`.

    Parameters
    ----------
    recording : Recording
        From `read`.
    fixes : sequence of PositionFix
        In any order. Those outside the recording are not used; ValueError if all are.
    calibration : Calibration, optional
        Step lengths of the person of the recording (its subject); those of the recipe if not given.
    config : Config, optional
        A recipe; the default recipe if not given.
    loop_closures, known_headings, floor_changes : sequences
        What else is known.
    start_heading_std_rad : float, optional
        How well the phone's first heading is the walking heading in the frame of the fixes. If not given: not at all
        where there are fixes or known headings, else what the recipe says.
    anchor_interval_s : float
        Anchors are at observations, at changes of the heading offset, and not further apart than this.
    """
    if calibration is not None:
        config = calibration.config(config or default_config(recording), recording.subject)
    config = config or default_config(recording)
    if not (fixes or loop_closures or known_headings) and start_heading_std_rad is None:
        return _from_hindsight(in_hindsight(recording, config), floor_changes)
    track = collected(recording, config, outputs(recording, config))
    modes = config.model.modes
    if track.weighting == "imm":
        prob = smoothed_mode_prob(track.mode_prob, config.model.transition_prob)
        track = replace(track, mode_prob=read_only(prob))
    if calibration is not None:
        # how sure the parameters are is in the calibrated spread of the scale already
        modes = tuple(replace(m, step_length=_without_spread(m.step_length)) for m in modes)
    return smooth_track(
        track,
        modes,
        config.model.noise,
        fixes,
        loop_closures=loop_closures,
        known_headings=known_headings,
        floor_changes=floor_changes,
        start_heading_std_rad=start_heading_std_rad,
        anchor_interval_s=anchor_interval_s,
    )


def _without_spread(fit: StepLengthFit) -> StepLengthFit:
    return replace(fit, theta_cov=np.zeros_like(fit.theta_cov))


def _from_hindsight(found: Hindsight, floor_changes: Sequence[FloorChange]) -> Smoothed:
    """Nothing was observed from elsewhere: what the recording itself says."""
    variance = np.diagonal(found.cov, axis1=1, axis2=2)
    return Smoothed(
        track=found.track,
        heading_offset_rad=read_only(wrap_angle(found.mean[:, HEADING_OFFSET])),
        heading_offset_std_rad=read_only(np.sqrt(variance[:, HEADING_OFFSET])),
        log_scale=read_only(found.mean[:, LOG_SCALE]),
        log_scale_std=read_only(np.sqrt(variance[:, LOG_SCALE])),
        start_position_m=read_only(np.zeros(2)),
        start_position_cov_m2=read_only(np.zeros((2, 2))),
        observations=_observations(None, (), (), (), ()),
        floor=_floors(found.track, floor_changes),
        notes=found.track.notes,
    )


def waypoint_fixes(recording: Recording, std_m: float = 1.0) -> list[PositionFix]:
    """The surveyed waypoints of a recording as fixes; ValueError where they are missing or their times go back."""
    points = recording.truth.waypoints
    if points is None:
        raise ValueError(f"{recording.name or 'the recording'} has no waypoints; give fixes")
    back = np.flatnonzero(np.diff(points.time_s) < 0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(
            f"waypoints must be in the order of their times: waypoint {k} at {points.time_s[k]} s comes after one at "
            f"{points.time_s[k - 1]} s; correct the times, or sort rows whose times are right"
        )
    cov = std_m**2 * np.eye(2)
    return [PositionFix(float(p.time_s), np.array([p.east_m, p.north_m]), cov) for p in points]


def smooth_track(
    track: Track,
    modes: Sequence[Mode],
    noise: MotionNoise,
    fixes: Sequence[PositionFix] = (),
    *,
    loop_closures: Sequence[LoopClosure] = (),
    known_headings: Sequence[KnownHeading] = (),
    floor_changes: Sequence[FloorChange] = (),
    start_heading_std_rad: float | None = None,
    anchor_interval_s: float = 10.0,
) -> Smoothed:
    """`smooth` of a track that the filter made without fixes; `modes` and `noise` are those of its tracker."""
    if anchor_interval_s <= 0:
        raise ValueError(f"anchor_interval_s must be positive, got {anchor_interval_s}")
    start_s, end_s = track.start_time_s, track.start_time_s + track.duration_s
    if track.n_steps:
        start_s, end_s = min(start_s, float(track.time_s[0])), max(end_s, float(track.time_s[-1]))
    inside = [start_s - _OUTSIDE_S <= f.time_s <= end_s + _OUTSIDE_S for f in fixes]
    if fixes and not any(inside):
        raise ValueError(
            f"none of {len(fixes)} fixes, {min(f.time_s for f in fixes):.1f} to {max(f.time_s for f in fixes):.1f} s, "
            f"is within the recording, {start_s:.1f} to {end_s:.1f} s: are their times of the same clock?"
        )
    for time_s in [t for c in loop_closures for t in (c.first_s, c.second_s)] + [
        t for h in known_headings for t in (h.start_s, h.end_s)
    ]:
        if not start_s - _OUTSIDE_S <= time_s <= end_s + _OUTSIDE_S:
            raise ValueError(
                f"an observation at {time_s} s is outside the recording, {start_s:.1f} to {end_s:.1f} s; times are "
                "those of the samples"
            )
    used = [f for f, known in zip(fixes, inside, strict=True) if known]
    if track.n_steps == 0:
        return _without_steps(track, fixes, used, floor_changes, loop_closures, known_headings)

    steps, shared_var = increments(track.steps, track.mode_prob, modes, noise, track.gap_before_s)
    anchored = bool(used)
    oriented = anchored or bool(known_headings)
    offsets = heading_offsets(track, steps, modes, noise)
    if len(offsets) and not oriented:
        # in the phone's own frame the measurements have what is known of the start
        start_heading_std_rad, frame_std_rad = float(np.sqrt(MAX_HEADING_VARIANCE)), _HERE_STD_RAD
    elif start_heading_std_rad is None:
        wide = float(np.sqrt(MAX_HEADING_VARIANCE))
        start_heading_std_rad = wide if oriented else noise.initial_heading_offset_std_rad
        frame_std_rad = wide if oriented else _HERE_STD_RAD
    else:
        frame_std_rad = start_heading_std_rad
    centre = np.mean([f.position_m for f in used], axis=0) if anchored else np.zeros(2)
    start_std = np.array([_ANYWHERE_STD_M if anchored else _HERE_STD_M] * 2 + [start_heading_std_rad, 0.0])
    start_cov = np.diag(start_std**2)
    start_cov[LOG_SCALE, LOG_SCALE] = noise.log_scale_std**2 + shared_var
    start_cov += np.diag([0.0, 0.0, MIN_STATE_VAR, MIN_STATE_VAR])
    problem = pose_problem(
        steps,
        np.array([*centre, 0.0, 0.0]),
        start_cov,
        used,
        loop_closures,
        known_headings,
        offsets,
        frame_std_rad,
        anchor_interval_s,
    )
    found = estimate(problem)
    mean, cov = bridge(problem.intervals, found.mean, found.joint_cov)
    return _smoothed(
        track, steps, problem, found, mean, cov, fixes, inside, loop_closures, known_headings, floor_changes
    )


# --- the least-squares problem --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Observations of positions: where anchor `node` is, or where it is from anchor `other`."""

    node: IntArray  # (F,)
    other: IntArray  # (F,) -1: the place is one of the map
    ahead_m: FloatArray  # (F, 2) part of the step from the anchor to the observation, before heading offset and scale
    position_m: FloatArray  # (F, 2)
    whiten: FloatArray  # (F, 2, 2) inverse of the lower Cholesky factor of the covariance

    def __len__(self) -> int:
        return len(self.node)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Observed directions from one anchor to another."""

    first: IntArray  # (H,)
    last: IntArray  # (H,)
    length_m: FloatArray  # (H,) by dead reckoning
    heading_rad: FloatArray  # (H,)
    std_rad: FloatArray  # (H,)

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Measured heading offsets (walking less device heading), by the number of steps before them."""

    node: IntArray  # (O,)
    offset_rad: FloatArray  # (O,)
    std_rad: FloatArray  # (O,)

    def __len__(self) -> int:
        return len(self.node)


NO_OFFSETS = Offsets(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Steps between anchors, what is known before them, and what was observed."""

    intervals: Intervals
    start_mean: FloatArray  # (4,)
    start_cov: FloatArray  # (4, 4)
    places: Places
    directions: Directions
    offsets: Offsets
    frame_std_rad: float  # of the rotation from the frame of the offsets to that of the places
    known_mean: FloatArray | None = None  # (n + 1, 4) where to begin; found by itself if None

    @property
    def n_nodes(self) -> int:
        """Number of anchors."""
        return len(self.intervals.nodes)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Smoothed states at the anchors, and what became of the observations."""

    mean: FloatArray  # (n + 1, 4)
    joint_cov: FloatArray  # (n, 8, 8) both ends of each interval
    frame_rad: float  # rotation from the frame of the offsets
    place_nis: FloatArray  # (F,)
    place_weight: FloatArray  # (F,)
    direction_nis: FloatArray  # (H,)
    direction_weight: FloatArray  # (H,)
    converged: bool


def pose_problem(
    steps: Increments,
    start_mean: FloatArray,
    start_cov: FloatArray,
    fixes: Sequence[PositionFix],
    loop_closures: Sequence[LoopClosure],
    known_headings: Sequence[KnownHeading],
    offsets: Offsets,
    frame_std_rad: float,
    anchor_interval_s: float,
    wanted: Sequence[int] = (),
) -> Problem:
    """The problem with an anchor where an observation or a change of the heading offset needs one, or is `wanted`."""
    at = [_nearest_contact(steps, f.time_s) for f in fixes]
    loops = [(_nearest_contact(steps, c.first_s), _nearest_contact(steps, c.second_s)) for c in loop_closures]
    headings = [(_nearest_contact(steps, h.start_s)[0], _nearest_contact(steps, h.end_s)[0]) for h in known_headings]
    observed = [i for i, _, _ in at] + [p[0] for pair in loops for p in pair] + [i for pair in headings for i in pair]
    nodes = anchors(steps, [*wanted, *observed], anchor_interval_s)

    def number(step: int) -> int:
        return int(np.searchsorted(nodes, step))

    var_m2 = [
        f.cov_m2 + max(extra, _BEST_FIX_M**2 - float(np.linalg.eigvalsh(f.cov_m2)[0])) * np.eye(2)
        for f, (_, _, extra) in zip(fixes, at, strict=True)
    ]
    var_m2 += [(c.std_m**2 + a[2] + b[2]) * np.eye(2) for c, (a, b) in zip(loop_closures, loops, strict=True)]
    place = Places(
        node=np.array([number(i) for i, _, _ in at] + [number(b[0]) for _, b in loops], dtype=np.int64),
        other=np.array([-1] * len(at) + [number(a[0]) for a, _ in loops], dtype=np.int64),
        ahead_m=np.array([d for _, d, _ in at] + [np.zeros(2) for _ in loops]).reshape(-1, 2),
        position_m=np.array([f.position_m for f in fixes] + [np.zeros(2) for _ in loops]).reshape(-1, 2),
        whiten=read_only(np.linalg.inv(np.linalg.cholesky(np.array(var_m2).reshape(-1, 2, 2)))),
    )
    walked = np.concatenate([np.zeros((1, 2)), np.cumsum(steps.displacement_m, axis=0)])
    direction = Directions(
        first=np.array([number(a) for a, _ in headings], dtype=np.int64),
        last=np.array([number(b) for _, b in headings], dtype=np.int64),
        length_m=np.array([np.hypot(*(walked[b] - walked[a])) for a, b in headings]),
        heading_rad=np.array([h.heading_rad for h in known_headings]),
        std_rad=np.array([h.std_rad for h in known_headings]),
    )
    return Problem(
        preintegrate(steps, nodes),
        start_mean,
        start_cov,
        place,
        direction,
        _at_anchors(steps, nodes, offsets),
        frame_std_rad,
    )


def anchors(steps: Increments, wanted: Sequence[int], interval_s: float) -> IntArray:
    """Numbers of steps before each anchor, increasing from 0 to K: those wanted, those before a change, and between."""
    changed = np.flatnonzero((steps.jump_var_rad2 > 0) | (steps.gap_var_m2 > 0))
    needed = np.unique(np.concatenate([[0, len(steps)], changed, np.asarray(wanted, dtype=np.int64)]).astype(np.int64))
    nodes: list[int] = [0]
    for a, b in pairwise(needed.tolist()):
        pieces = int(np.ceil((steps.time_s[b - 1] - steps.time_s[a]) / interval_s))
        nodes += np.unique(np.linspace(a, b, max(pieces, 1) + 1).round().astype(int))[1:].tolist()
    return np.array(nodes, dtype=np.int64)


def _nearest_contact(steps: Increments, time_s: float) -> tuple[int, FloatArray, float]:
    """Steps before the contact nearest to a time, the part of a step from there to that time, and a variance in m2.

    The variance is of what lies between: part of a step, or of a gap.
    """
    k = int(np.searchsorted(steps.time_s, time_s))
    if k == len(steps):
        return k, np.zeros(2), 0.0
    begin_s = steps.time_s[k] - steps.duration_s[k]
    done = float(np.clip((time_s - begin_s) / max(steps.duration_s[k], 1e-3), 0.0, 1.0))
    gap_var = 0.0
    if time_s < begin_s and steps.gap_var_m2[k] > 0:
        lasted_s = begin_s - (steps.time_s[k - 1] if k else begin_s - 1.0)
        gap_var = float(steps.gap_var_m2[k]) * min(1.0, (begin_s - time_s) / max(lasted_s, 1e-3)) ** 2
    step_var = 0.5 * float(np.trace(steps.cov_m2[k]))
    if done <= 0.5:
        return k, done * steps.displacement_m[k], done**2 * step_var + gap_var
    left, after = 1.0 - done, k + 1
    if after < len(steps) and (steps.jump_var_rad2[after] > 0 or steps.gap_var_m2[after] > 0):
        # the anchor there is after the change, which says nothing about the heading of this step
        moved_var = left**2 * float(steps.displacement_m[k] @ steps.displacement_m[k])
        return after, np.zeros(2), moved_var + float(steps.gap_var_m2[after])
    return after, -left * steps.displacement_m[k], left**2 * step_var


def heading_offsets(track: Track, steps: Increments, modes: Sequence[Mode], noise: MotionNoise) -> Offsets:
    """What the steps themselves show of the heading offset: walking direction less device heading and mode's offset.

    A direction tells only what is new to a filter that knows those before (docs/methods/heading.md), and may point far
    beyond what it is evidence for. So a filter of the heading offset alone goes along, and each measurement is taken as
    its prediction and the innovation, which is wrapped there and linear from then on.
    """
    std = np.asarray(track.steps.walking_direction_std_rad)
    known = np.isfinite(std)
    if not known.any():
        return NO_OFFSETS
    own = np.array([m.heading_offset_rad for m in modes])
    sideways = np.arctan2(track.mode_prob @ np.sin(own), track.mode_prob @ np.cos(own))
    shown = np.asarray(track.steps.walking_direction_rad) - np.asarray(track.steps.device_heading_rad) - sideways
    drift = steps.drift_var_rad2 + steps.unknown_var_rad2
    offset, variance = 0.0, noise.initial_heading_offset_std_rad**2
    measured = np.zeros(len(steps))
    for k in range(len(steps)):
        variance = min(variance + (steps.jump_var_rad2[k] if k else 0.0), MAX_HEADING_VARIANCE)
        if known[k]:
            innovation = float(wrap_angle(shown[k] - offset))
            measured[k] = offset + innovation
            # the first step's direction stands alone: nothing was known before it
            gain = variance / (variance + std[k] ** 2) if k else 1.0
            offset, variance = offset + gain * innovation, (1 - gain) * variance if k else float(std[k] ** 2)
        variance = min(variance + drift[k], MAX_HEADING_VARIANCE)
    node, value, spread = np.flatnonzero(known), measured[known], std[known]
    if not known[0]:
        node = np.concatenate([[0], node])
        value = np.concatenate([[0.0], value])
        spread = np.concatenate([[noise.initial_heading_offset_std_rad], spread])
    return Offsets(node.astype(np.int64), value, spread)


def _at_anchors(steps: Increments, nodes: IntArray, offsets: Offsets) -> Offsets:
    """Measured offsets moved to the anchor before them, those of one anchor joined.

    What the heading offset may have drifted since the anchor is added to the variance of each.
    """
    if len(offsets) == 0:
        return NO_OFFSETS
    index = np.searchsorted(nodes, offsets.node, side="right") - 1
    drift = np.concatenate([[0.0], np.cumsum(steps.drift_var_rad2 + steps.unknown_var_rad2)])
    weight = 1 / (offsets.std_rad**2 + drift[offsets.node] - drift[nodes[index]])
    used, group = np.unique(index, return_inverse=True)
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * offsets.offset_rad) / total
    return Offsets(used.astype(np.int64), mean, 1 / np.sqrt(total))


# --- its solution ---------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Rows:
    """Whitened linear equations A x_a + B x_b = b, one block for each pair of keys."""

    a: IntArray
    A: FloatArray  # (n, m, da)
    b: IntArray  # the second key; -1 for none
    B: FloatArray  # (n, m, db)
    rhs: FloatArray  # (n, m)
    weight: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,); empty for weight one


def estimate(problem: Problem) -> Solution:
    """Smoothed states at the anchors, wrong observations left out.

    1. A linear problem without angles finds where to begin: heading offset and scale together are a vector
       z = e^s (cos theta, sin theta), a displacement is M(D) z and thus linear in it. Graduated non-convexity with
       truncated least squares (Yang et al. 2020, "Graduated non-convexity for robust spatial perception", IEEE RA-L,
       eq. 14) leaves out wrong observations on the way.
    2. Gauss-Newton with angles and scales. Observations that are further from what all others say than the 99.9 %
       quantile are left out, those nearer come back, until nothing changes.
    """
    known = problem.known_mean
    if known is None:
        mean, frame_rad, place_weight, direction_weight = _beginning(problem)
    else:
        mean, frame_rad = known, 0.0
        place_weight, direction_weight = np.ones(len(problem.places)), _walked(problem)
    walked = _walked(problem)
    limit = np.concatenate([np.full(len(problem.places), _PLACE_NIS), np.full(len(walked), _DIRECTION_NIS)])
    possible = np.concatenate([np.ones(len(problem.places)), walked])
    weight = np.concatenate([place_weight, direction_weight])
    seen: set[bytes] = set()
    while True:
        place_weight, direction_weight = weight[: len(problem.places)], weight[len(problem.places) :]
        mean, frame_rad, converged = _gauss_newton(problem, mean, frame_rad, place_weight, direction_weight)
        rows = linearised(problem, mean, frame_rad, place_weight, direction_weight)
        tree = _graph(rows).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)
        nis = _innovations(problem, mean, weight, tree)
        seen.add(weight.tobytes())
        after = next((w for w in _changes(weight, possible * nis / limit, possible) if w.tobytes() not in seen), None)
        if after is None:
            break
        weight = after
    joint_cov = np.array([_cov_of(tree, [j, j + 1]) for j in range(len(problem.intervals))])
    n = len(problem.places)
    return Solution(mean, joint_cov, frame_rad, nis[:n], place_weight, nis[n:], direction_weight, converged)


def _changes(weight: FloatArray, excess: FloatArray, possible: FloatArray) -> list[FloatArray]:
    """Weights to try next, the best first: without the worst observations, else with all that fit again, or one.

    A wrong observation makes its neighbours look wrong, and of two that contradict each other both look wrong: only
    the worst are left out at a time. `excess` is the distance of each over its limit.
    """
    used = np.where(weight > 0, excess, 0.0)
    if used.max(initial=0.0) > 1:
        worst = np.arange(len(weight)) == used.argmax()
        many = (used > 1) & (used >= 0.5 * used.max())
        choices = [many, worst] if many.sum() > 3 else [worst]
        return [np.where(c, 0.0, weight) for c in choices]
    fits = (weight == 0) & (excess <= 1) & (possible > 0)
    if not fits.any():
        return []
    best = np.arange(len(weight)) == np.where(fits, excess, np.inf).argmin()
    return [np.where(c, 1.0, weight) for c in (fits, best)]


def _innovations(problem: Problem, mean: FloatArray, weight: FloatArray, tree: gtsam.GaussianBayesTree) -> FloatArray:
    """How far each observation is from what all others say: chi-square with its dimension if it is right.

    r' (I - L)^-1 r for a whitened residual r of an observation that is used, with its leverage L = H P H'; and
    r' (I + L)^-1 r for one that is not: by so much the least sum of squares changes with it.
    """
    places, directions = problem.places, problem.directions
    blocks: list[tuple[int, int, FloatArray, FloatArray, FloatArray]] = []
    residual, by_node, by_other = _place_residuals(places, mean)
    blocks += zip(places.node.tolist(), places.other.tolist(), residual, by_node, by_other, strict=True)
    residual, by_last = _direction_residuals(directions, mean)
    blocks += zip(directions.last.tolist(), directions.first.tolist(), residual, by_last, -by_last, strict=True)
    nis = np.empty(len(blocks))
    for i, (a, b, r, A, B) in enumerate(blocks):
        keys, H = ([a], A) if b < 0 else ([a], A + B) if a == b else ([a, b], np.hstack([A, B]))
        leverage = H @ _cov_of(tree, keys) @ H.T
        S = np.eye(len(r)) + (-leverage if weight[i] > 0 else leverage)
        # where nothing else says anything of it, the difference is rounding
        nis[i] = r @ np.linalg.solve(S + 1e-12 * np.eye(len(r)), r)
    return np.maximum(nis, 0.0)


def _walked(problem: Problem) -> FloatArray:
    """1 for the known headings between whose times somebody walked."""
    return (problem.directions.length_m > _MIN_HEADING_LENGTH_M).astype(float)


def _gauss_newton(
    problem: Problem, mean: FloatArray, frame_rad: float, place_weight: FloatArray, direction_weight: FloatArray
) -> tuple[FloatArray, float, bool]:
    """States, rotation, and whether the iteration came to rest."""
    for iteration in range(60):
        rows = linearised(problem, mean, frame_rad, place_weight, direction_weight)
        change, turn = _solved(rows, problem)
        largest_turn = max(float(np.abs(change[:, HEADING_OFFSET]).max()), abs(turn))
        largest_scale = float(np.abs(change[:, LOG_SCALE]).max())
        # never further than the linearisation reaches; shorter steps where it does not come to rest
        share = min(1.0, 0.7 / max(largest_turn, 1e-9), 0.3 / max(largest_scale, 1e-9)) * (
            1.0 if iteration < 20 else 0.5
        )
        mean, frame_rad = mean + share * change, frame_rad + share * turn
        if share * float(np.abs(change).max()) < 1e-9 * (1 + float(np.abs(mean).max())):
            return mean, frame_rad, True
    return mean, frame_rad, False


def linearised(
    problem: Problem, mean: FloatArray, frame_rad: float, place_weight: FloatArray, direction_weight: FloatArray
) -> list[_Rows]:
    """Whitened equations for the change of the states (n + 1, 4) at which they are linearised."""
    none = np.zeros((0, 0, 0))
    start_whiten = read_only(np.linalg.inv(np.linalg.cholesky(problem.start_cov)))
    off = mean[0] - problem.start_mean
    zero, absent = np.zeros(1, dtype=np.int64), np.full(1, -1)
    rows = [_Rows(zero, start_whiten[None], absent, none, -(start_whiten @ off)[None])]

    start, n = mean[:-1], len(mean) - 1
    ahead, F = advance(start, problem.intervals.total_m)
    whiten = problem.intervals.whiten @ np.linalg.inv(frame(start))
    residual = np.einsum("nab,nb->na", whiten, mean[1:] - ahead)
    rows.append(_Rows(np.arange(n), -whiten @ F, np.arange(1, n + 1), whiten, -residual))

    places = problem.places
    if len(places):
        residual, H, H_other = _place_residuals(places, mean)
        rows.append(_Rows(places.node, H, places.other, H_other, -residual, place_weight))
    directions = problem.directions
    if len(directions):
        residual, by_last = _direction_residuals(directions, mean)
        rows.append(_Rows(directions.last, by_last, directions.first, -by_last, -residual, direction_weight))
    offsets = problem.offsets
    if len(offsets):
        inverse = 1 / offsets.std_rad
        residual = wrap_angle(mean[offsets.node, HEADING_OFFSET] - frame_rad - offsets.offset_rad) * inverse
        by_state = np.zeros((len(offsets), 1, N_STATES))
        by_state[:, 0, HEADING_OFFSET] = inverse
        frame_key = np.full(len(offsets), problem.n_nodes)
        rows.append(_Rows(offsets.node, by_state, frame_key, -inverse[:, None, None], -residual[:, None]))
        prior = np.array([[[1 / problem.frame_std_rad]]])
        rows.append(_Rows(frame_key[:1], prior, absent, none, -prior[0] * frame_rad))
    return rows


def _place_residuals(places: Places, mean: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened p + e^s R(theta) d - p_other - z (F, 2), and its derivatives by both states (F, 2, 4)."""
    at, relative = mean[places.node], places.other >= 0
    moved = np.einsum("nab,nb->na", turned(at[:, HEADING_OFFSET], at[:, LOG_SCALE]), places.ahead_m)
    origin = np.where(relative[:, None], mean[places.other, :2], 0.0)
    error = at[:, :2] + moved - origin - places.position_m
    H = np.zeros((len(places), 2, N_STATES))
    H[:, :, _POSITION] = np.eye(2)
    H_other = -H.copy()
    H[:, :, HEADING_OFFSET] = moved @ TURN.T
    H[:, :, LOG_SCALE] = moved
    return np.einsum("nab,nb->na", places.whiten, error), places.whiten @ H, places.whiten @ H_other


def _direction_residuals(directions: Directions, mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Whitened angle between the way from `first` to `last` and the known one (H, 1), derivative by the last state."""
    way = mean[directions.last, :2] - mean[directions.first, :2]
    square = np.maximum((way**2).sum(axis=1), (0.5 * directions.length_m) ** 2 + 1e-12)
    error = wrap_angle(np.arctan2(way[:, 0], way[:, 1]) - directions.heading_rad) / directions.std_rad
    H = np.zeros((len(directions), 1, N_STATES))
    H[:, 0, 0], H[:, 0, 1] = way[:, 1], -way[:, 0]
    return error[:, None], H / (square * directions.std_rad)[:, None, None]


def _beginning(problem: Problem) -> tuple[FloatArray, float, FloatArray, FloatArray]:
    """States and rotation to begin with, and which observations seem right, from the linear problem without angles."""
    n_places, n_directions = len(problem.places), len(problem.directions)
    limit = np.concatenate([np.full(n_places, _PLACE_NIS), np.full(n_directions, _DIRECTION_NIS)])
    possible = np.concatenate([np.ones(n_places), _walked(problem)])
    weight, mu = possible.copy(), None
    state, turn = _solved(_relaxed(problem, weight[:n_places], weight[n_places:]), problem)
    for _ in range(60 if len(limit) else 0):
        nis = _relaxed_squared_residuals(problem, state)
        excess = float((possible * nis / limit).max())
        if mu is None:
            if excess <= 1:
                break
            mu = 1 / max(2 * excess - 1, 1e-12)
        # eq. 14 of Yang et al.: 1 below, 0 above, and a smooth change between that steepens with mu
        ratio = np.sqrt(limit * mu * (mu + 1) / np.maximum(nis, 1e-12)) - mu
        weight = possible * np.where(
            nis >= limit * (mu + 1) / mu, 0.0, np.where(nis <= limit * mu / (mu + 1), 1.0, ratio)
        )
        mu *= _GNC_FACTOR
        state, turn = _solved(_relaxed(problem, weight[:n_places], weight[n_places:]), problem)
        if ((weight == 0) | (weight == 1)).all():
            break
    mean = state.copy()
    # more than a third longer or shorter is not the person: it is a turn that the linear problem took for a scale
    mean[:, LOG_SCALE] = np.clip(np.log(np.maximum(np.hypot(state[:, 2], state[:, 3]), 1e-3)), -0.3, 0.3)
    mean[:, LOG_SCALE] = np.median(mean[:, LOG_SCALE])
    angle = np.unwrap(np.arctan2(state[:, 3], state[:, 2]))
    nearest = wrap_angle(angle[0] - problem.start_mean[HEADING_OFFSET]) + problem.start_mean[HEADING_OFFSET]
    mean[:, HEADING_OFFSET] = angle + nearest - angle[0]
    weight = (weight > 0.5).astype(float)
    return mean, turn, weight[:n_places], weight[n_places:]


def _relaxed(problem: Problem, place_weight: FloatArray, direction_weight: FloatArray) -> list[_Rows]:
    """Equations of the problem in (p, z): isotropic covariances, because directions are not known yet."""
    none = np.zeros((0, 0, 0))
    intervals, n = problem.intervals, len(problem.intervals)
    zero, absent = np.zeros(1, dtype=np.int64), np.full(1, -1)
    _, _, theta, s = problem.start_mean
    spread = min(problem.start_cov[HEADING_OFFSET, HEADING_OFFSET], MAX_HEADING_VARIANCE)
    spread += problem.start_cov[LOG_SCALE, LOG_SCALE]
    known = np.array([*problem.start_mean[:2], np.exp(s) * np.cos(theta), np.exp(s) * np.sin(theta)])
    inverse = 1 / np.sqrt([problem.start_cov[0, 0], problem.start_cov[1, 1], spread, spread])
    rows = [_Rows(zero, read_only(np.diag(inverse)[None]), absent, none, (inverse * known)[None])]

    variance = np.empty((n, N_STATES))
    variance[:, :2] = 0.5 * (intervals.total_cov[:, 0, 0] + intervals.total_cov[:, 1, 1])[:, None]
    drift = intervals.total_cov[:, HEADING_OFFSET, HEADING_OFFSET] + intervals.total_cov[:, LOG_SCALE, LOG_SCALE]
    variance[:, 2:] = drift[:, None]
    W = 1 / np.sqrt(variance)
    A = np.broadcast_to(np.eye(N_STATES), (n, N_STATES, N_STATES)).copy()
    A[:, :2, 2:] = _linear(intervals.total_m)
    B = W[:, :, None] * np.eye(N_STATES)
    rows.append(_Rows(np.arange(n), -W[:, :, None] * A, np.arange(1, n + 1), B, np.zeros((n, N_STATES))))
    places = problem.places
    if len(places):
        H, H_other = _relaxed_places(places)
        target = np.einsum("nab,nb->na", places.whiten, places.position_m)
        rows.append(_Rows(places.node, H, places.other, H_other, target, place_weight))
    directions = problem.directions
    if len(directions):
        by_last, target = _relaxed_directions(directions)
        rows.append(_Rows(directions.last, by_last, directions.first, -by_last, target, direction_weight))
    offsets = problem.offsets
    if len(offsets):
        inverse = 1 / np.minimum(offsets.std_rad, np.sqrt(MAX_HEADING_VARIANCE))
        by_state = np.zeros((len(offsets), 2, N_STATES))
        by_state[:, 0, 2], by_state[:, 1, 3] = inverse, inverse
        frame_key = np.full(len(offsets), problem.n_nodes)
        c, s = np.cos(offsets.offset_rad) * inverse, np.sin(offsets.offset_rad) * inverse
        by_frame = -np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        rows.append(_Rows(offsets.node, by_state, frame_key, by_frame, np.zeros((len(offsets), 2))))
        prior = np.eye(2)[None] / problem.frame_std_rad
        rows.append(_Rows(frame_key[:1], prior, absent, none, prior[:, :, 0]))
    return rows


def _linear(sum_m: FloatArray) -> FloatArray:
    """M(D) (n, 2, 2): D turned and scaled is M(D) (e^s cos theta, e^s sin theta)."""
    east, north = sum_m[:, 0], sum_m[:, 1]
    return np.stack([np.stack([east, north], axis=-1), np.stack([north, -east], axis=-1)], axis=-2)


def _relaxed_places(places: Places) -> tuple[FloatArray, FloatArray]:
    H = np.zeros((len(places), 2, N_STATES))
    H[:, :, _POSITION] = np.eye(2)
    H_other = -H.copy()
    H[:, :, 2:] = _linear(places.ahead_m)
    return places.whiten @ H, places.whiten @ H_other


def _relaxed_directions(directions: Directions) -> tuple[FloatArray, FloatArray]:
    """The way between two anchors is the known direction times the length of dead reckoning, within a tenth or more."""
    inverse = 1 / (np.maximum(directions.std_rad, 0.1) * np.maximum(directions.length_m, _MIN_HEADING_LENGTH_M))
    H = np.zeros((len(directions), 2, N_STATES))
    H[:, 0, 0], H[:, 1, 1] = inverse, inverse
    way = np.column_stack([np.sin(directions.heading_rad), np.cos(directions.heading_rad)])
    return H, way * (directions.length_m * inverse)[:, None]


def _relaxed_squared_residuals(problem: Problem, state: FloatArray) -> FloatArray:
    places, directions = problem.places, problem.directions
    H, H_other = _relaxed_places(places)
    other = np.where((places.other >= 0)[:, None], state[places.other], 0.0)
    residual = np.einsum("nab,nb->na", H, state[places.node]) + np.einsum("nab,nb->na", H_other, other)
    residual -= np.einsum("nab,nb->na", places.whiten, places.position_m)
    by_last, target = _relaxed_directions(directions)
    turn = np.einsum("nab,nb->na", by_last, state[directions.last] - state[directions.first]) - target
    return np.concatenate([np.square(residual).sum(axis=1), np.square(turn).sum(axis=1)])


def _graph(rows: Sequence[_Rows]) -> gtsam.GaussianFactorGraph:
    """Linear factors of GTSAM, one for each block of rows; blocks of weight zero are left out."""
    graph = gtsam.GaussianFactorGraph()
    for block in rows:
        model = gtsam.noiseModel.Unit.Create(block.rhs.shape[1])
        root = np.sqrt(block.weight) if len(block.weight) else np.ones(len(block.a))
        a, b = block.a.tolist(), block.b.tolist()
        for i, w in enumerate(root.tolist()):
            if w == 0:
                continue
            A, rhs = w * block.A[i], w * block.rhs[i]
            if b[i] < 0:
                graph.push_back(gtsam.JacobianFactor(a[i], A, rhs, model))
            else:
                graph.push_back(gtsam.JacobianFactor(a[i], A, b[i], w * block.B[i], rhs, model))
    return graph


def _solved(rows: Sequence[_Rows], problem: Problem) -> tuple[FloatArray, float]:
    """Solution at the anchors (n + 1, 4), and the rotation (an angle; of a vector its direction)."""
    solution = _graph(rows).optimize(gtsam.EliminateQR)
    state = np.array([solution.at(j) for j in range(problem.n_nodes)])
    if len(problem.offsets) == 0:
        return state, 0.0
    turn = solution.at(problem.n_nodes)
    return state, float(turn[0]) if len(turn) == 1 else float(np.arctan2(turn[1], turn[0]))


def _cov_of(tree: gtsam.GaussianBayesTree, keys: Sequence[int]) -> FloatArray:
    """Joint covariance of some states: (R' R)^-1 of their square-root information R.

    GTSAM's own covariances are by Cholesky, which takes what is known within a kilometre for unknown.
    """
    R, _ = tree.jointBayesNet(list(keys), gtsam.EliminateQR).matrix()
    inverse = np.linalg.inv(R)
    return inverse @ inverse.T


def filtered_at(problem: Problem, found: Solution, node: int) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) at an anchor of all that was before it and at it, linearised at the solution.

    For problems without directions and offsets.
    """
    rows = linearised(problem, found.mean, found.frame_rad, found.place_weight, found.direction_weight)
    early = [_first_rows(r, (r.a <= node) & (r.b <= node)) for r in rows]
    tree = _graph(early).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)
    before = max(node - 1, 0)
    cov = _cov_of(tree, [before, node])[-N_STATES:, -N_STATES:]
    return found.mean[node] + tree.optimize().at(node), 0.5 * (cov + cov.T)


def _first_rows(rows: _Rows, keep: BoolArray) -> _Rows:
    B = rows.B[keep] if len(rows.B) else rows.B
    weight = rows.weight[keep] if len(rows.weight) else rows.weight
    return _Rows(rows.a[keep], rows.A[keep], rows.b[keep], B, rows.rhs[keep], weight)


# --- the result -----------------------------------------------------------------------------------------------------


def _smoothed(
    track: Track,
    steps: Increments,
    problem: Problem,
    found: Solution,
    mean: FloatArray,
    cov: FloatArray,
    fixes: Sequence[PositionFix],
    inside: Sequence[bool],
    loop_closures: Sequence[LoopClosure],
    known_headings: Sequence[KnownHeading],
    floor_changes: Sequence[FloorChange],
) -> Smoothed:
    position = mean[:, :2]
    before = np.vstack([found.mean[:1, :2], position[:-1]])
    moved = position - before
    # across a gap positions say where the pedestrian went, not how he stepped
    own = np.einsum("kab,kb->ka", turned(mean[:, HEADING_OFFSET], mean[:, LOG_SCALE]), steps.displacement_m)
    moved = np.where((steps.gap_var_m2 > 0)[:, None], own, moved)
    length = np.hypot(*moved.T)
    heading = np.where(length > 0.01, np.arctan2(moved[:, 0], moved[:, 1]), track.walking_heading_rad)
    anchored = np.unique(
        problem.intervals.nodes[problem.places.node[found.place_weight * (problem.places.other < 0) > 0]]
    )
    along = _second_order(moved, cov[:, HEADING_OFFSET, HEADING_OFFSET], anchored)
    position_cov = cov[:, :2, :2] + along[:, :, None] * along[:, None, :]
    observations = _observations(found, fixes, inside, loop_closures, known_headings)
    notes = [*track.notes, *_notes(track, found, observations, fixes)]
    smoothed = replace(
        track,
        position_m=read_only(position),
        position_cov_m2=read_only(position_cov),
        step_length_m=read_only(length),
        walking_heading_rad=read_only(wrap_angle(heading)),
        step_speed_mps=read_only(length / np.asarray(track.steps.duration_s)),
        notes=tuple(notes),
        start_position_m=read_only(found.mean[0, :2]),
    )
    return Smoothed(
        track=smoothed,
        heading_offset_rad=read_only(wrap_angle(mean[:, HEADING_OFFSET])),
        heading_offset_std_rad=read_only(np.sqrt(cov[:, HEADING_OFFSET, HEADING_OFFSET])),
        log_scale=read_only(mean[:, LOG_SCALE]),
        log_scale_std=read_only(np.sqrt(cov[:, LOG_SCALE, LOG_SCALE])),
        start_position_m=read_only(found.mean[0, :2]),
        start_position_cov_m2=read_only(found.joint_cov[0, :2, :2]),
        observations=observations,
        floor=_floors(track, floor_changes),
        notes=tuple(notes),
    )


def _second_order(moved: FloatArray, heading_var_rad2: FloatArray, anchored: IntArray) -> FloatArray:
    """Error along the way that uncertain headings make (K, 2), from the anchor with a fix that is nearer by it.

    The linear covariance has only the error across (`motion.second_order_errors`).
    """
    share = np.array([second_order_errors(min(v, MAX_HEADING_VARIANCE), 0.0)[0] for v in heading_var_rad2.tolist()])
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(share[:, None] * moved, axis=0)])
    fixed = anchored if len(anchored) else np.zeros(1, dtype=np.int64)
    after = np.searchsorted(fixed, np.arange(1, len(moved) + 1))
    back = total[1:] - total[fixed[np.maximum(after - 1, 0)]]
    ahead = total[fixed[np.minimum(after, len(fixed) - 1)]] - total[1:]
    nearer = (ahead**2).sum(axis=1) < (back**2).sum(axis=1)
    return np.where(nearer[:, None], ahead, back)


def _observations(
    found: Solution | None,
    fixes: Sequence[PositionFix],
    inside: Sequence[bool],
    loop_closures: Sequence[LoopClosure],
    known_headings: Sequence[KnownHeading],
) -> Table:
    """The table `Smoothed.observations`."""
    n_fixes, n_loops, n_headings = len(fixes), len(loop_closures), len(known_headings)
    nis, weight = np.full(n_fixes, np.nan), np.zeros(n_fixes)
    loop_nis, loop_weight = np.full(n_loops, np.nan), np.zeros(n_loops)
    heading_nis, heading_weight = np.full(n_headings, np.nan), np.zeros(n_headings)
    if found is not None:
        used = np.flatnonzero(inside)
        nis[used], weight[used] = found.place_nis[: len(used)], found.place_weight[: len(used)]
        loop_nis, loop_weight = found.place_nis[len(used) :], found.place_weight[len(used) :]
        heading_nis, heading_weight = found.direction_nis, found.direction_weight
    times = [f.time_s for f in fixes] + [c.second_s for c in loop_closures] + [h.start_s for h in known_headings]
    kinds = ["fix"] * n_fixes + ["loop closure"] * n_loops + ["known heading"] * n_headings
    return table(
        {
            "kind": np.array(kinds, dtype="U13"),
            "number": np.array([*range(n_fixes), *range(n_loops), *range(n_headings)], dtype=np.int64),
            "time_s": np.array(times, dtype=float),
            "nis": np.concatenate([nis, loop_nis, heading_nis]),
            "weight": np.concatenate([weight, loop_weight, heading_weight]),
        }
    )


def _notes(track: Track, found: Solution, observations: Table, fixes: Sequence[PositionFix]) -> list[str]:
    notes: list[str] = []
    for kind in ("fix", "loop closure", "known heading"):
        is_kind = observations.kind == kind
        unused = is_kind & np.isnan(observations.nis)
        rejected = is_kind & ~unused & (observations.weight < 0.5)
        for rows, why in ((unused, "outside the recording"), (rejected, "the walk cannot explain it")):
            if rows.any():
                notes.append(f"{kind} {_numbers(observations.number[rows])}: {why}, not used")
    n_good = int((observations.weight[observations.kind == "fix"] >= 0.5).sum())
    if fixes and n_good == 0:
        notes.append("no fix agrees with the walk: positions are not known in the frame of the fixes")
    elif n_good == 1 and found.joint_cov[0, HEADING_OFFSET, HEADING_OFFSET] > 0.5:
        notes.append("a single fix says where the walk was and not which way it went: directions are not known")
    unknown_s = float(np.asarray(track.steps.heading_unknown_s).sum())
    if unknown_s > 1.0:
        notes.append(f"no angular rate for {unknown_s:.0f} s: directions there come from the fixes around them alone")
    if not found.converged:
        notes.append("the least squares did not come to rest: too little is known of this walk, do not trust the track")
    return notes


def _numbers(numbers: IntArray) -> str:
    shown = ", ".join(str(n) for n in numbers[:10])
    return shown if len(numbers) <= 10 else f"{shown} and {len(numbers) - 10} more"


def _floors(track: Track, floor_changes: Sequence[FloorChange]) -> FloatArray:
    changes = sorted(floor_changes, key=lambda c: c.time_s)
    index = np.searchsorted([c.time_s for c in changes], track.time_s, side="right") - 1
    floors = np.array([np.nan, *(float(c.floor) for c in changes)])
    return read_only(floors[index + 1])


def _without_steps(
    track: Track,
    fixes: Sequence[PositionFix],
    used: Sequence[PositionFix],
    floor_changes: Sequence[FloorChange],
    loop_closures: Sequence[LoopClosure],
    known_headings: Sequence[KnownHeading],
) -> Smoothed:
    """Nobody walked: the place is the weighted mean of the fixes."""
    if used:
        information = np.linalg.inv(np.array([f.cov_m2 for f in used]))
        cov = np.linalg.inv(information.sum(axis=0))
        place = cov @ np.einsum("nab,nb->a", information, np.array([f.position_m for f in used]))
    else:
        place, cov = np.zeros(2), _HERE_STD_M**2 * np.eye(2)
    none = read_only(np.zeros(0))
    return Smoothed(
        track=track,
        heading_offset_rad=none,
        heading_offset_std_rad=none,
        log_scale=none,
        log_scale_std=none,
        start_position_m=read_only(place),
        start_position_cov_m2=read_only(cov),
        observations=_observations(None, fixes, (), loop_closures, known_headings),
        floor=_floors(track, floor_changes),
        notes=track.notes,
    )
