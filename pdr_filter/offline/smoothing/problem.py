"""Least-squares problem of a walk: anchors, the steps between them, and the observations at them.

An anchor is a foot contact at which the smoother estimates a state. Arrays have rows for F positions, H directions,
S states and X measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pdr_filter.filter.fixes.measurement_updates import high_quantile
from pdr_filter.filter.imm.motion_model import LOG_SCALE, MAX_HEADING_VARIANCE, Mode
from pdr_filter.offline.columns import Columns
from pdr_filter.offline.smoothing.location_errors import NO_ERRORS, Errors, errors_of, independent_share
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations
from pdr_filter.offline.smoothing.preintegration import MIN_STATE_VAR, Increments, Intervals, preintegrate
from pdr_filter.values import (
    BoolArray,
    FloatArray,
    IntArray,
    Measurement,
    PositionFix,
    TrackRows,
    measurement_of,
    read_only,
    wrap_angle,
)

# Gates: 99.9 % quantiles of the chi-square distribution with two degrees of freedom and with one. The gate of the
# positions is that of the online filter.
_POSITION_NIS, _DIRECTION_NIS = 13.8, 10.8
_BEST_FIX_M = 0.01  # best possible accuracy of a position on a walking body
MIN_HEADING_LENGTH_M = 1.0  # the heading of a corridor carries no information on a pedestrian who stands in it


@dataclass(frozen=True, slots=True, eq=False)
class ObservedPositions(Columns):
    """Observed positions of anchors, on the map or relative to another anchor."""

    node: IntArray  # (F,) index of the observed anchor
    other: IntArray  # (F,) index of the anchor to which the position is relative, -1 for a position on the map
    ahead_m: FloatArray  # (F, 2) part of the step from the anchor to the observation, before heading offset and scale
    position_m: FloatArray  # (F, 2) observed position, east and north. Zero for a loop closure.
    whiten: FloatArray  # (F, 2, 2) inverse of the lower Cholesky factor of the covariance

    @classmethod
    def on_map(
        cls, node: IntArray, ahead_m: FloatArray, position_m: Sequence[FloatArray], cov_m2: Sequence[FloatArray]
    ) -> ObservedPositions:
        """Return observed positions (2,) on the map, with their covariances (2, 2)."""
        whiten = np.linalg.inv(np.linalg.cholesky(np.reshape(cov_m2, (-1, 2, 2))))
        return cls(node, np.full(len(node), -1), ahead_m, np.reshape(position_m, (-1, 2)), read_only(whiten))


@dataclass(frozen=True, slots=True, eq=False)
class ObservedDirections(Columns):
    """Observed directions from one anchor to another."""

    first: IntArray  # (H,) anchor at the start
    last: IntArray  # (H,) anchor at the end
    length_m: FloatArray  # (H,) distance between both by dead reckoning
    heading_rad: FloatArray  # (H,) observed direction
    std_rad: FloatArray  # (H,) standard deviation of the direction


@dataclass(frozen=True, slots=True, eq=False)
class ObservedOffsets(Columns):
    """Observed heading offsets, each the walking heading minus the device heading."""

    # (O,) number of steps before the offset. In a `Problem` it is the index of the anchor (state) instead.
    node: IntArray
    offset_rad: FloatArray  # (O,) observed heading offset in rad
    std_rad: FloatArray  # (O,) standard deviation of the observed heading offset in rad


@dataclass(frozen=True, slots=True, eq=False)
class ObservedStates(Columns):
    """Measurements of the heading offset or the log scale at anchors."""

    node: IntArray  # (S,) anchor, or number of steps before the measurement
    state: IntArray  # (S,) HEADING_OFFSET or LOG_SCALE
    value: FloatArray  # (S,) measured value
    std: FloatArray  # (S,) standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class ObservedMeasurements(Columns):
    """User-defined measurements (`values.Measurement`), each assigned to the anchor nearest in time.

    Positions, directions and states have classes of their own.
    """

    fixes: tuple[Measurement, ...]  # the X measurements
    node: IntArray  # (X,) anchor of each measurement
    ahead_m: FloatArray  # (X, 2) part of the step from the anchor to the measurement, before heading offset and scale
    # (X,) variance of the displacement between the anchor and the measurement, along each axis
    extra_var_m2: FloatArray
    device_rad: FloatArray  # (X,) walking heading minus the heading offset
    guess_m: FloatArray  # (X, 2) position for the first linearisation


NO_MEASUREMENTS = ObservedMeasurements(
    (), np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 2))
)
NO_STATES = ObservedStates(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
NO_OFFSETS = ObservedOffsets(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Steps between anchors, priors, and observations of a walk.

    Positions, directions, states and measurements may be outliers. Arrays of their weights (1 used, 0 rejected) and of
    their gates (`limit_nis`) have the shape (F + H + S + X,), in this order. The keys of the unknowns are the anchors,
    then the errors of correlated fixes, and last the rotation of the frame.
    """

    intervals: Intervals  # steps summed between the anchors
    start_mean: FloatArray  # (4,) prior mean of the first state: east, north, heading offset and log scale
    start_cov: FloatArray  # (4, 4) prior covariance of the first state
    positions: ObservedPositions  # fixes, locations and loop closures
    directions: ObservedDirections  # known headings
    # heading offsets measured by the strides (`heading_offsets`), relative to the first one. They are never outliers.
    offsets: ObservedOffsets
    # prior standard deviation in rad of the rotation from the frame of the offsets to the frame of the positions
    frame_std_rad: float
    errors: Errors = NO_ERRORS  # errors of correlated fixes
    # measurements of the heading offset or the log scale, from heading fixes, speed fixes and magnetic north
    states: ObservedStates = NO_STATES
    measurements: ObservedMeasurements = NO_MEASUREMENTS  # all other measurements

    @property
    def n_states(self) -> int:
        """Number of anchors and errors of correlated fixes, which is also the key of the rotation of the frame."""
        return self.n_nodes + len(self.errors)

    @property
    def n_nodes(self) -> int:
        """Number of anchors."""
        return len(self.intervals.nodes)

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Return the parts of values (F + H + S + X,) for positions, directions, states and measurements."""
        n = [len(self.positions), len(self.directions), len(self.states)]
        return np.split(values, np.cumsum(n))

    @property
    def limit_nis(self) -> FloatArray:
        """Gates (F + H + S + X,) of the normalised innovation squared, above which an observation is an outlier."""
        of = {1: _DIRECTION_NIS, 2: _POSITION_NIS}
        guesses = zip(self.measurements.fixes, self.measurements.guess_m, strict=True)
        sizes = [len(measurement_of(fix, guess_m, 0.0)[0]) for fix, guess_m in guesses]
        of_measurements = np.array([of.get(k) or high_quantile(k) for k in sizes])
        n = [len(self.positions), len(self.directions) + len(self.states)]
        return np.concatenate([np.repeat([_POSITION_NIS, _DIRECTION_NIS], n), of_measurements])

    @property
    def possible(self) -> FloatArray:
        """Mask of usable observations (F + H + S + X,): 1, or 0 for a direction over too short a distance."""
        walked = self.directions.length_m > MIN_HEADING_LENGTH_M
        n_others = len(self.states) + len(self.measurements)
        return np.concatenate([np.ones(len(self.positions)), walked.astype(float), np.ones(n_others)])


def start_covariance(position_std_m: float, heading_std_rad: float, log_scale_var: float) -> FloatArray:
    """Return the prior covariance (4, 4) of east, north, heading offset and log scale before the first step."""
    cov = np.diag(np.square([position_std_m, position_std_m, heading_std_rad, 0.0]))
    cov[LOG_SCALE, LOG_SCALE] = log_scale_var
    return cov + np.diag([0.0, 0.0, MIN_STATE_VAR, MIN_STATE_VAR])


def pose_problem(
    steps: Increments,
    start_mean: FloatArray,
    start_cov: FloatArray,
    observed: Observations,
    offsets: ObservedOffsets = NO_OFFSETS,
    frame_std_rad: float = 1.0,
    *,
    anchor_interval_s: float,
    states: ObservedStates = NO_STATES,
    measurements: Measurements | None = None,
    shape_m: FloatArray | None = None,
    anchors: Sequence[int] = (),
) -> Problem:
    """Return the least-squares problem, with anchors at observations, changes of the heading offset and gaps.

    `anchor_interval_s` is about the largest time between two of them (`choose_nodes`). The positions of the problem are
    the fixes, the locations and the loop closures, in this order. Correlated fixes must be in order of time and at
    different contacts (`joined_at_contacts`). `states` and `offsets` are given by the number of steps before them.
    `shape_m` (K + 1, 2) are positions of the start and of the steps that show the shape of the walk to the errors of
    locations (`errors_of`). `anchors` are further numbers of steps with an anchor.
    """
    fixes, loops, known = (*observed.positions, *observed.locations), observed.loop_closures, observed.known_headings
    is_location = np.arange(len(fixes)) >= len(observed.positions)
    measured = () if measurements is None else measurements.fixes
    times_s = (
        [f.time_s for f in fixes],
        [c.first_s for c in loops],
        [c.second_s for c in loops],
        [h.start_s for h in known],
        [h.end_s for h in known],
        [f.time_s for f in measured],
    )
    contacts = [contacts_of(steps, time_s) for time_s in times_s]
    wanted = np.concatenate([*(c.step for c in contacts), states.node, anchors]).astype(np.int64)
    nodes = choose_nodes(steps, wanted, anchor_interval_s)
    contacts = [replace(c, node=np.searchsorted(nodes, c.step)) for c in contacts]
    at, before, after, first, last, of_measured = contacts
    walked_m = np.concatenate([np.zeros((1, 2)), np.cumsum(steps.displacement_m, axis=0)])
    return Problem(
        preintegrate(steps, nodes),
        start_mean,
        start_cov,
        _positions(fixes, is_location, loops, at, before, after),
        ObservedDirections(
            first=first.node,
            last=last.node,
            length_m=np.hypot(*(walked_m[last.step] - walked_m[first.step]).T),
            heading_rad=np.array([h.heading_rad for h in known]),
            std_rad=np.array([h.std_rad for h in known]),
        ),
        _at_anchors(steps, nodes, offsets),
        frame_std_rad,
        errors_of(fixes, is_location, at.node, None if shape_m is None else shape_m[at.step]),
        replace(states, node=np.searchsorted(nodes, states.node)),
        NO_MEASUREMENTS
        if measurements is None
        else ObservedMeasurements(
            fixes=measured,
            node=of_measured.node,
            ahead_m=of_measured.ahead_m,
            extra_var_m2=of_measured.var_m2,
            device_rad=measurements.device_rad[np.maximum(of_measured.step - 1, 0)],
            guess_m=measurements.guess_m,
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Measurements before they are assigned to anchors.

    `device_rad` (K,) are the walking headings of the steps minus the heading offset. `guess_m` (X, 2) are the positions
    for the first linearisation.
    """

    fixes: tuple[Measurement, ...]
    device_rad: FloatArray
    guess_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Contacts(Columns):
    """Foot contacts nearest to the times of N observations (see `nearest_contact`)."""

    node: IntArray  # (N,) anchor at the contact, once the anchors are chosen
    step: IntArray  # (N,) number of steps before the contact
    ahead_m: FloatArray  # (N, 2) displacement from the contact to the observation
    var_m2: FloatArray  # (N,) variance of it along each axis


def contacts_of(steps: Increments, time_s: Sequence[float]) -> Contacts:
    """Return the contacts nearest to some times."""
    found = [nearest_contact(steps, t) for t in time_s]
    step = np.array([i for i, _, _ in found], dtype=np.int64)
    ahead_m, var_m2 = np.array([d for _, d, _ in found]).reshape(-1, 2), np.array([var_m2 for _, _, var_m2 in found])
    return Contacts(step, step, ahead_m, var_m2)


def _positions(
    fixes: Sequence[PositionFix],
    is_location: BoolArray,
    loop_closures: Sequence[LoopClosure],
    at: Contacts,
    before: Contacts,
    after: Contacts,
) -> ObservedPositions:
    """Return fixes at their contacts, and loop closures between their contacts, as observed positions.

    A loop closure is the position of its second anchor relative to the first one, which is zero.
    """
    own_shares = [independent_share(f, is_one) for f, is_one in zip(fixes, is_location.tolist(), strict=True)]
    fix_cov_m2 = [
        own * f.cov_m2 + max(extra, _BEST_FIX_M**2 - own * float(np.linalg.eigvalsh(f.cov_m2)[0])) * np.eye(2)
        for f, own, extra in zip(fixes, own_shares, at.var_m2.tolist(), strict=True)
    ]
    loop_var_m2 = np.array([c.std_m**2 for c in loop_closures]) + before.var_m2 + after.var_m2
    cov_m2 = np.array([*fix_cov_m2, *(var_m2 * np.eye(2) for var_m2 in loop_var_m2)]).reshape(-1, 2, 2)
    nowhere_m = np.zeros((len(loop_closures), 2))
    return ObservedPositions(
        node=np.concatenate([at.node, after.node]),
        other=np.concatenate([np.full(len(fixes), -1), before.node]),
        ahead_m=np.concatenate([at.ahead_m, nowhere_m]),
        position_m=np.concatenate([np.reshape([f.position_m for f in fixes], (-1, 2)), nowhere_m]),
        whiten=read_only(np.linalg.inv(np.linalg.cholesky(cov_m2))),
    )


def choose_nodes(steps: Increments, wanted: IntArray, interval_s: float) -> IntArray:
    """Return the number of steps before each anchor, increasing from 0 to the number of steps K.

    There are anchors at the wanted numbers, and before each change of the heading offset and each gap. More anchors in
    between keep the time between anchors at about `interval_s` or less.
    """
    changed = np.flatnonzero(steps.is_turned)
    needed = np.unique(np.concatenate([[0, len(steps)], changed, wanted]).astype(np.int64))
    nodes: list[int] = [0]
    for a, b in pairwise(needed.tolist()):
        pieces = int(np.ceil((steps.time_s[b - 1] - steps.time_s[a]) / interval_s))
        nodes += np.unique(np.linspace(a, b, max(pieces, 1) + 1).round().astype(int))[1:].tolist()
    return np.array(nodes, dtype=np.int64)


def nearest_contact(steps: Increments, time_s: float) -> tuple[int, FloatArray, float]:
    """Return the number of steps before the nearest contact, the displacement (2,) from it, and its variance in m^2.

    The displacement is the part of a step between the contact and the given time, before heading offset and scale. It
    is zero after the last contact. In the second half of the last step before a change of the heading offset or a gap
    it is also zero, and its variance contains the missing part of the step.
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
    if after < len(steps) and steps.is_turned[after]:
        # the anchor there is after the change and has no information on the heading of this step
        moved_var = left**2 * float(steps.displacement_m[k] @ steps.displacement_m[k])
        return after, np.zeros(2), moved_var + float(steps.gap_var_m2[after])
    return after, -left * steps.displacement_m[k], left**2 * step_var


def heading_offsets(track: TrackRows, steps: Increments, modes: Sequence[Mode]) -> ObservedOffsets:
    """Return the heading offsets measured by the strides: walking heading minus device heading minus the mode's offset.

    Offsets are relative to the first one, which becomes a measurement of zero before the first step with its own
    standard deviation. The walking heading of a later step is a pseudo-measurement. It contains only the information
    that is new after the earlier ones (docs/methods/heading.md), and may lie far from the true offset. The difference
    from the prediction must therefore be wrapped correctly. For this purpose, the function runs a scalar Kalman filter
    of the heading offset along the steps. Each returned value is the filter's prediction plus the wrapped innovation,
    so the smoother can use it as a linear measurement. The standard deviations are the same as of the walking headings.
    """
    std = np.asarray(track.steps.walking_heading_std_rad)
    (known,) = (np.isfinite(std) & (std > 0.0)).nonzero()
    if not len(known):
        return NO_OFFSETS
    sideways = mode_offsets(track, modes)
    shown = np.asarray(track.steps.walking_heading_rad) - np.asarray(track.steps.device_heading_rad) - sideways
    gained = steps.drift_var_rad2 + steps.unknown_var_rad2 + steps.jump_var_rad2
    first, measured = int(known[0]), np.zeros(len(known))
    offset, variance = 0.0, float(std[first] ** 2)
    for i, k in enumerate(known[1:].tolist(), start=1):
        variance = min(variance + float(gained[known[i - 1] + 1 : k + 1].sum()), MAX_HEADING_VARIANCE)
        innovation = float(wrap_angle(shown[k] - shown[first] - offset))
        measured[i] = offset + innovation
        gain = variance / (variance + float(std[k] ** 2))
        offset, variance = offset + gain * innovation, (1 - gain) * variance
    return ObservedOffsets(np.concatenate([[0], known[1:]]), measured, std[known])


def mode_offsets(track: TrackRows, modes: Sequence[Mode]) -> FloatArray:
    """Return the angle (K,) from the heading of the body to the walking heading, as a circular mean over the modes.

    It is zero except for sideways steps.
    """
    own = np.array([m.heading_offset_rad for m in modes])
    return np.arctan2(track.mode_prob @ np.sin(own), track.mode_prob @ np.cos(own))


def _at_anchors(steps: Increments, nodes: IntArray, offsets: ObservedOffsets) -> ObservedOffsets:
    """Return measured heading offsets moved to the last anchor at or before them, as one weighted mean per anchor.

    `nodes` has the number of steps before each anchor. The variance includes the drift between the anchor and the
    measurement.
    """
    if len(offsets) == 0:
        return NO_OFFSETS
    index = np.searchsorted(nodes, offsets.node, side="right") - 1
    # both the measurement and the state of an anchor are after the drift that precedes their step
    drift = np.cumsum(steps.drift_var_rad2 + steps.unknown_var_rad2)
    weight = 1 / (offsets.std_rad**2 + drift[offsets.node] - drift[nodes[index]])
    used, group = np.unique(index, return_inverse=True)
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * offsets.offset_rad) / total
    return ObservedOffsets(used.astype(np.int64), mean, 1 / np.sqrt(total))
