"""A whole recording in hindsight: steps, position fixes, loop closures and known headings in one least-squares problem.

States are at anchors only, and what was walked between two anchors is one linear factor (`preintegration`).
GTSAM eliminates the linear graph of every Gauss-Newton iteration and gives the marginals (docs/methods/smoothing.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np

from pdr_filter.calibration import Calibration, load_calibration
from pdr_filter.config import Config, on_plan
from pdr_filter.filter.frozen import frozen_fixes
from pdr_filter.filter.imm import smoothed_mode_prob
from pdr_filter.filter.motion import (
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    Mode,
    MotionNoise,
    second_order_errors,
)
from pdr_filter.gnss import independent
from pdr_filter.io.recording import Recording
from pdr_filter.offline.smoothing.observations import (
    FloorChange,
    KnownHeading,
    LoopClosure,
    Observations,
    check_options,
    says_nothing,
)
from pdr_filter.offline.smoothing.plan_result import Hindsight as OnPlanHindsight
from pdr_filter.offline.smoothing.preintegration import Increments, bridge, increments, turned
from pdr_filter.offline.smoothing.problem import Problem, heading_offsets, pose_problem, start_covariance
from pdr_filter.offline.smoothing.solve import Solution, solve
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.recording_run import collected, given_or_default, outputs, run_sensing
from pdr_filter.sensing.clock import one_clock
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.heading.walking_heading import WalkingHeading, known_places
from pdr_filter.tracks import Track
from pdr_filter.values import (
    BoolArray,
    Fix,
    FloatArray,
    GridFix,
    IntArray,
    Plan,
    PositionFix,
    Step,
    Table,
    all_fixes,
    pickled,
    read_only,
    step_table,
    table,
    wrap_angle,
)

# Nothing is known of where the walk began in the frame of the fixes, apart from being in the same region.
_ANYWHERE_STD_M = 1000.0
_HERE_STD_M = _HERE_STD_RAD = 1e-3
_KINDS = ("fix", "loop closure", "known heading")


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
    # (squared distance from what all others say, normalised by its covariance; NaN if it was not used) and weight
    # (1 used, 0 rejected, outside the recording, frozen or without information).
    observations: Table
    floor: FloatArray  # (K,) storey at each step, NaN where no floor change says it
    notes: tuple[str, ...]

    __reduce__ = pickled

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
    fixes: Iterable[Fix] = (),
    calibration: Calibration | str | Path | None = None,
    *,
    config: Config | None = None,
    loop_closures: Iterable[LoopClosure] | Literal["wifi"] = (),
    known_headings: Iterable[KnownHeading] = (),
    floor_changes: Iterable[FloorChange] = (),
    start_heading_std_rad: float | None = None,
    anchor_interval_s: float = 2.0,
    plan: Plan | None = None,
    start: PositionFix | str | None = None,
) -> Smoothed:
    """The walk of a recording as everything that is known of it says, with a covariance at every step.

    Step scale, heading drift and the heading offsets of each way of carrying the phone are estimated together with the
    positions. Fixes may be in any frame; the rotation against the phone's first heading is estimated. Observations that
    the walk cannot explain are rejected and named in `observations`.

    Parameters
    ----------
    recording : Recording
        From `read`.
    fixes : sequence of PositionFix; on a plan of any fixes
        In any order. Those outside the recording are not used; ValueError if all are. Locations whose errors are alike
        count as `pdr_filter.gnss.independent` has it.
    calibration : Calibration or path, optional
        Step lengths of the person of the recording (its subject), or where one was saved; those of the recipe if not
        given.
    config : Config, optional
        A recipe; the default recipe if not given.
    loop_closures : sequence of LoopClosure, or "wifi"
        Times at which the walk was at one place. "wifi": those at which the recording heard the same access points
        equally loud (`wifi_loop_closures`); MissingSensorError if it has no Wi-Fi.
    known_headings, floor_changes : sequences
        What else is known.
    start_heading_std_rad : float, optional
        How well the phone's first heading is the walking heading in the frame of the fixes. If not given: not at all
        where there are fixes or known headings, else what the recipe says.
    anchor_interval_s : float
        Anchors are at observations, at changes of the heading offset, and not further apart than this.
    plan : FloorPlan, optional
        The walk is on this floor plan, and `fixes` are in its frame; then fixes are all that may be known besides, and
        they are used when they came, as online. Needs no fix if there is a `start`.
    start : PositionFix or str, optional
        Where on the plan the walk begins: a place, the name of an area, or "anywhere".

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()
    >>> begin = pdr.PositionFix(2.0, (0.0, 0.0), 0.5**2 * np.eye(2))
    >>> end = pdr.PositionFix(110.0, (0.0, 0.0), 0.5**2 * np.eye(2))  # it ends where it began
    >>> smoothed = pdr.smooth(recording, [begin, end])
    >>> bool(np.hypot(*smoothed.track.position_m[-1]) < 1.5)
    True
    """
    fixes, known_headings, floor_changes = all_fixes(fixes), tuple(known_headings), tuple(floor_changes)
    loop_closures = loop_closures if isinstance(loop_closures, str) else tuple(loop_closures)
    if plan is not None and (loop_closures or known_headings or floor_changes or start_heading_std_rad is not None):
        raise ValueError(
            "on a floor plan hindsight knows fixes alone, got loop closures, known headings, floor changes or "
            "start_heading_std_rad beside plan: leave them out"
        )
    config = given_or_default(recording, config)
    has_plan = plan is not None or config.on_plan is not None
    check_options(fixes, has_plan, loop_closures, start_heading_std_rad, anchor_interval_s)
    recording, fixes = one_clock(recording, fixes)
    if isinstance(loop_closures, str):
        loop_closures = wifi_loop_closures(recording)
    if calibration is not None:
        calibration = calibration if isinstance(calibration, Calibration) else load_calibration(calibration)
        config = calibration.config(config, recording.subject)
    config = _with_first_pass(recording, config)
    if plan is not None and any(not isinstance(fix, GridFix) for fix in fixes):
        config = config.in_world_frame()
    config = on_plan(config, plan, start)
    places = [fix for fix in fixes if isinstance(fix, PositionFix)]
    observed = Observations(tuple(places), tuple(loop_closures), known_headings, floor_changes)
    if config.on_plan is not None:
        # Only when called: a plan is an application.
        from pdr_filter.offline.smoothing.on_plan import smooth_on_plan

        return _on_plan(smooth_on_plan(recording, config, tuple(fixes)), observed)
    config = config.in_hindsight()
    track = collected(recording, config, outputs(recording, config))
    modes = config.model.modes
    if track.weighting == "imm":
        prob = smoothed_mode_prob(track.mode_prob, config.model.transition_prob)
        track = replace(track, mode_prob=read_only(prob))
    if calibration is not None:
        # how sure the parameters are is in the calibrated spread of the scale already
        fits = [replace(m.step_length, theta_cov=np.zeros_like(m.step_length.theta_cov)) for m in modes]
        modes = tuple(replace(m, step_length=fit) for m, fit in zip(modes, fits, strict=True))
    return smooth_track(track, modes, config.model.noise, observed, start_heading_std_rad, anchor_interval_s)


def _with_first_pass(recording: Recording, config: Config) -> Config:
    """Return the configuration with the walking directions and the gyroscope bias of a first pass over the recording.

    Strides show a walking direction better at the end of a place of the phone than at its start, and the axes of a
    building show the bias only after some corners. The second pass has both from the first step. The covariance of the
    bias counts double, because the second pass sees the same samples. Without axes the bias is not used: straight
    walking that is seen twice is taken for straighter than it is, and costs as often as it gains.
    """
    if "gyroscope" not in recording.streams:
        return config
    state, events = run_sensing(config.sensing, recording)
    steps = [event for event in events if isinstance(event, Step)]
    if not steps:
        return config
    device, heading = config.sensing.device(state), config.sensing.heading
    if isinstance(heading, WalkingHeading):
        heading = replace(heading, known_places=known_places(step_table(steps)))
        config = replace(config, sensing=replace(config.sensing, heading=heading))
    if config.sensing.attitude.bias.device is not None or not steps[-1].on_axes:
        return config
    return config.with_device(Device(device.bias_radps, 2.0 * device.bias_cov_radps2))


def _on_plan(found: OnPlanHindsight, observed: Observations) -> Smoothed:
    """What a floor plan shows."""
    results = {result.time_s: result for result in found.track.fixes}
    each = [results.get(fix.time_s) for fix in observed.fixes]
    observations = _table(observed).copy()
    observations.nis = [np.nan if result is None else result.nis for result in each]
    observations.weight = [float(result is not None and result.accepted) for result in each]
    observations.flags.writeable = False
    return Smoothed(
        track=found.track,
        heading_offset_rad=read_only(wrap_angle(found.heading_offset_rad)),
        heading_offset_std_rad=found.heading_offset_std_rad,
        log_scale=found.log_scale,
        log_scale_std=found.log_scale_std,
        start_position_m=found.track.start_position_m,
        start_position_cov_m2=read_only(found.track.position_cov_m2[0]),
        observations=observations,
        floor=_floors(found.track, ()),
        notes=found.track.notes,
    )


def smooth_track(
    track: Track,
    modes: Sequence[Mode],
    noise: MotionNoise,
    observed: Observations,
    start_heading_std_rad: float | None,
    anchor_interval_s: float,
) -> Smoothed:
    """`smooth` of a track that the filter made without fixes; `modes` and `noise` are those of its tracker."""
    if anchor_interval_s <= 0:
        raise ValueError(f"anchor_interval_s must be positive, got {anchor_interval_s}")
    start_s, end_s = track.start_time_s, track.start_time_s + track.duration_s
    if track.n_steps:
        start_s, end_s = min(start_s, float(track.time_s[0])), max(end_s, float(track.time_s[-1]))
    inside = observed.fixes_inside(start_s, end_s)
    if track.n_steps == 0:
        return _without_steps(track, observed, independent(tuple(compress(observed.fixes, inside))))
    used, row, notes = _usable(track, observed, inside)
    steps, shared_var = increments(track.steps, track.mode_prob, modes, noise, track.gap_before_s)
    offsets = heading_offsets(track, steps, modes)
    heading_std_rad, frame_std_rad = _start_directions(used, len(offsets) > 0, noise, start_heading_std_rad)
    centre = np.mean([f.position_m for f in used.fixes], axis=0) if used.fixes else np.zeros(2)
    start_std_m = _ANYWHERE_STD_M if used.fixes else _HERE_STD_M
    start_cov = start_covariance(start_std_m, heading_std_rad, noise.log_scale_std**2 + shared_var)
    before_first = steps.jump_var_rad2[0] + steps.drift_var_rad2[0] + steps.unknown_var_rad2[0]
    start_cov[HEADING_OFFSET, HEADING_OFFSET] += before_first
    start = np.array([*centre, 0.0, 0.0])
    problem = pose_problem(steps, start, start_cov, used, offsets, frame_std_rad, anchor_interval_s=anchor_interval_s)
    return _smoothed(track, steps, problem, solve(problem), observed, row, notes)


def _usable(track: Track, observed: Observations, inside: BoolArray) -> tuple[Observations, IntArray, list[str]]:
    """Observations that carry information, the row of each given one among these, and why others are not used.

    The row is -1 for an observation that is not used. Loop closures of the same two contacts share one row: copies of
    a wrong one would confirm each other.
    """
    frozen = np.array(frozen_fixes(observed.fixes, track.time_s, track.position_m, track.walked_m), dtype=bool)
    fixes = inside & ~frozen
    closures = observed.loop_closures
    at_s = np.array([(c.first_s, c.second_s) for c in closures]).reshape(-1, 2)
    walked_m = np.diff(np.interp(at_s, track.time_s, track.walked_m), axis=1)[:, 0]
    near = np.array([says_nothing(c, d) for c, d in zip(closures, walked_m.tolist(), strict=True)], dtype=bool)
    contacts = np.searchsorted(track.time_s, at_s)
    kept: dict[tuple[int, int], int] = {}
    of_closure = np.full(len(closures), -1)
    for k in np.flatnonzero(~near).tolist():
        of_closure[k] = kept.setdefault((int(contacts[k, 0]), int(contacts[k, 1])), len(kept))
    firsts = [int(np.flatnonzero(of_closure == j)[0]) for j in range(len(kept))]
    used = replace(
        observed,
        fixes=independent(tuple(compress(observed.fixes, fixes))),
        loop_closures=tuple(closures[k] for k in firsts),
    )
    n_fixes, n_all = int(fixes.sum()), int(fixes.sum()) + len(kept)
    row = np.concatenate(
        [
            np.where(fixes, np.cumsum(fixes) - 1, -1),
            np.where(of_closure >= 0, n_fixes + of_closure, -1),
            n_all + np.arange(len(observed.known_headings)),
        ]
    )
    reasons = (
        ("fix", ~inside, "outside the recording"),
        ("fix", inside & frozen, "repeats the last position while steps go on"),
        ("loop closure", near, "its two times are so near that the way between them is within its uncertainty"),
    )
    notes = [
        f"{kind} {_numbers(np.flatnonzero(which))}: {why}, not used" for kind, which, why in reasons if which.any()
    ]
    return used, row.astype(np.int64), notes


def _start_directions(
    used: Observations, has_offsets: bool, noise: MotionNoise, start_heading_std_rad: float | None
) -> tuple[float, float]:
    """Standard deviations of the first heading, and of the rotation from the phone's frame to that of the fixes."""
    is_oriented = bool(used.fixes or used.known_headings)
    wide = float(np.sqrt(MAX_HEADING_VARIANCE))
    if has_offsets and not is_oriented:
        # in the phone's own frame the measurements have what is known of the start
        return wide, _HERE_STD_RAD
    if start_heading_std_rad is not None:
        return start_heading_std_rad, start_heading_std_rad
    return (wide, wide) if is_oriented else (noise.initial_heading_offset_std_rad, _HERE_STD_RAD)


def _smoothed(
    track: Track,
    steps: Increments,
    problem: Problem,
    found: Solution,
    observed: Observations,
    row: IntArray,
    unused: Sequence[str],
) -> Smoothed:
    mean, cov = bridge(problem.intervals, found.mean, found.joint_cov)
    position = mean[:, :2]
    before = np.vstack([found.mean[:1, :2], position[:-1]])
    moved = position - before
    # across a gap positions say where the pedestrian went, not how he stepped
    own = np.einsum("kab,kb->ka", turned(mean[:, HEADING_OFFSET], mean[:, LOG_SCALE]), steps.displacement_m)
    moved = np.where((steps.gap_var_m2 > 0)[:, None], own, moved)
    length = np.hypot(*moved.T)
    heading = np.where(length > 0.01, np.arctan2(moved[:, 0], moved[:, 1]), track.walking_heading_rad)
    of_map = found.weight[: len(problem.positions)] * (problem.positions.other < 0) > 0
    anchored = np.unique(problem.intervals.nodes[problem.positions.node[of_map]])
    along = _second_order(moved, cov[:, HEADING_OFFSET, HEADING_OFFSET], anchored)
    position_cov = cov[:, :2, :2] + along[:, :, None] * along[:, None, :]
    observations = _table(observed, row, found)
    notes = (*track.notes, *unused, *_notes(track, found, observations, bool(observed.fixes)))
    smoothed = replace(
        track,
        position_m=read_only(position),
        position_cov_m2=read_only(position_cov),
        step_length_m=read_only(length),
        walked_m=read_only(np.cumsum(length)),
        walking_heading_rad=read_only(wrap_angle(heading)),
        step_speed_mps=read_only(length / np.asarray(track.steps.duration_s)),
        notes=notes,
        start_position_m=read_only(found.mean[0, :2]),
        frame="fixes" if observed.fixes else track.frame,
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
        floor=_floors(track, observed.floor_changes),
        notes=notes,
    )


def _second_order(moved: FloatArray, heading_var_rad2: FloatArray, anchored: IntArray) -> FloatArray:
    """Error along the way (K, 2) by uncertain headings, from the nearer anchor with a fix (`second_order_errors`)."""
    share = np.array([second_order_errors(min(v, MAX_HEADING_VARIANCE), 0.0)[0] for v in heading_var_rad2.tolist()])
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(share[:, None] * moved, axis=0)])
    fixed = anchored if len(anchored) else np.zeros(1, dtype=np.int64)
    after = np.searchsorted(fixed, np.arange(1, len(moved) + 1))
    back = total[1:] - total[fixed[np.maximum(after - 1, 0)]]
    ahead = total[fixed[np.minimum(after, len(fixed) - 1)]] - total[1:]
    nearer = (ahead**2).sum(axis=1) < (back**2).sum(axis=1)
    return np.where(nearer[:, None], ahead, back)


def _table(observed: Observations, row: IntArray | None = None, found: Solution | None = None) -> Table:
    """The table `Smoothed.observations`, with the row of each observation in the solution (-1: not used)."""
    times_s = [
        [f.time_s for f in observed.fixes],
        [c.second_s for c in observed.loop_closures],
        [h.start_s for h in observed.known_headings],
    ]
    counts = [len(t) for t in times_s]
    nis, weight = np.full(sum(counts), np.nan), np.zeros(sum(counts))
    if found is not None and row is not None:
        used = row >= 0
        nis[used], weight[used] = found.nis[row[used]], found.weight[row[used]]
    return table(
        {
            "kind": np.repeat(_KINDS, counts),
            "number": np.concatenate([np.arange(n) for n in counts]),
            "time_s": np.concatenate([np.array(t, dtype=float) for t in times_s]),
            "nis": nis,
            "weight": weight,
        }
    )


def _notes(track: Track, found: Solution, observations: Table, has_fixes: bool) -> list[str]:
    notes: list[str] = []
    for kind in _KINDS:
        rows = (observations.kind == kind) & (observations.weight < 0.5) & ~np.isnan(observations.nis)
        if rows.any():
            notes.append(f"{kind} {_numbers(observations.number[rows])}: the walk cannot explain it, not used")
    n_good = int((observations.weight[observations.kind == "fix"] >= 0.5).sum())
    if has_fixes and n_good == 0:
        notes.append("no fix agrees with the walk: positions are not known in the frame of the fixes")
    elif n_good == 1 and found.joint_cov[0, HEADING_OFFSET, HEADING_OFFSET] > 0.5:
        notes.append("a single fix says where the walk was and not which way it went: directions are not known")
    unknown_s = float(np.asarray(track.steps.heading_unknown_s).sum())
    if unknown_s > 1.0:
        notes.append(f"no angular rate for {unknown_s:.0f} s: directions there come from the fixes around them alone")
    if not found.converged:
        notes.append("the least squares did not converge: too little is known of this walk, do not trust the track")
    return notes


def _numbers(numbers: IntArray) -> str:
    shown = ", ".join(str(n) for n in numbers[:10])
    return shown if len(numbers) <= 10 else f"{shown} and {len(numbers) - 10} more"


def _floors(track: Track, floor_changes: Sequence[FloorChange]) -> FloatArray:
    changes = sorted(floor_changes, key=lambda c: c.time_s)
    index = np.searchsorted([c.time_s for c in changes], track.time_s, side="right") - 1
    floors = np.array([np.nan, *(float(c.floor) for c in changes)])
    return read_only(floors[index + 1])


def _without_steps(track: Track, observed: Observations, fixes: Sequence[PositionFix]) -> Smoothed:
    """Nobody walked: the place is the weighted mean of the fixes."""
    if fixes:
        information = np.linalg.inv(np.array([f.cov_m2 for f in fixes]))
        cov = np.linalg.inv(information.sum(axis=0))
        place = cov @ np.einsum("nab,nb->a", information, np.array([f.position_m for f in fixes]))
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
        observations=_table(observed),
        floor=_floors(track, observed.floor_changes),
        notes=track.notes,
    )
