"""Smoothing of a whole recording: steps, fixes, loop closures and known headings in one least-squares problem.

States are estimated at anchors only. The steps between two anchors are summed into one linear factor
(`preintegration`). GTSAM eliminates the linear graph of every Gauss-Newton iteration and gives the marginal covariances
(docs/methods/smoothing.md).
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.filter.fixes.gnss import LocationState, independent, locations_of
from pdr_filter.filter.imm.motion_model import (
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    MotionNoise,
    bounded_position_cov,
    reach_m,
    second_order_errors,
)
from pdr_filter.filter.pedestrian.alignment import walked_var_m2 as walked_var
from pdr_filter.filter.pedestrian.fix_history import StandstillSteps
from pdr_filter.filter.pedestrian.frame import START_FRAME
from pdr_filter.filter.pedestrian.person import LengthFixes, Person, session_of_scale
from pdr_filter.offline.smoothing.clock_shift import ClockShift, ShiftedWalk, ShiftPrior, estimated_shift
from pdr_filter.offline.smoothing.dead_reckoning import (
    Passes,
    Reckoned,
    dead_reckoned,
    observed_device,
    online_path,
    pass_callbacks,
    with_first_pass,
    with_smoothed_modes,
)
from pdr_filter.offline.smoothing.factor_graph import PoseKeys, UserFactors, WalkGraph, solved_with, user_graph
from pdr_filter.offline.smoothing.location_errors import turned_to
from pdr_filter.offline.smoothing.mode_evidence import step_log_evidence, switching_walk
from pdr_filter.offline.smoothing.observations import (
    FloorChange,
    KnownHeading,
    LoopClosure,
    Observations,
    Source,
    check_options,
)
from pdr_filter.offline.smoothing.preintegration import (
    TURN,
    Increments,
    increments,
    mode_steps,
    scaled_rotation,
    step_states,
)
from pdr_filter.offline.smoothing.problem import (
    Measurements,
    Problem,
    contacts_of,
    heading_offsets,
    pose_problem,
    start_covariance,
)
from pdr_filter.offline.smoothing.smoothed import (
    KNOWN_STD_M,
    Smoothed,
    fix_results,
    floors_at_steps,
    notes_of_reckoning,
    notes_of_solution,
    observation_table,
    without_steps,
)
from pdr_filter.offline.smoothing.smoothed_georeference import aligned_walk, on_earth, with_given_origin
from pdr_filter.offline.smoothing.solve import Solution, response, solve, sum_of_squares
from pdr_filter.offline.smoothing.usable import Used, start_end_closure, usable
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.device import Device
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.walked_path import WalkedPath
from pdr_filter.tracking.warnings import conflict_notes
from pdr_filter.tracking.whole_recording import Run, prepared_run
from pdr_filter.values import (
    Fix,
    FloatArray,
    GridFix,
    IntArray,
    Origin,
    Plan,
    PositionFix,
    Samples,
    Standstill,
    interpolated_rows,
    read_only,
    wrap_angle,
)
from pdr_filter.values.georeference import Georeference, GnssUse, NorthUse
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.recording import Recording
from pdr_filter.values.serialisation import to_bytes
from pdr_filter.values.uncertainty import worst_std_m

# Prior standard deviation of the start in the frame of the fixes: only the region is known.
_REGION_STD_M = 1000.0
_KNOWN_STD_RAD = 1e-3


@dataclass(slots=True, eq=False)
class SmoothingMemory:
    """Memory for repeated calls of `smooth` with one recording and changing fixes.

    It holds the dead-reckoned track of the last call. A call with the same recording and configuration takes the track
    from here and only solves the least-squares problem again, with the same result to the last bit.

    Attributes
    ----------
    recording : Recording or None
        Recording of the last call.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.offline.smoothing.smooth import SmoothingMemory
    >>> recording, memory = pdr.simulate.demo_walk(), SmoothingMemory()
    >>> first = pdr.smooth(recording, memory=memory)
    >>> fix = pdr.PositionFix(60.0, np.array([20.0, 5.0]), np.eye(2))
    >>> second = pdr.smooth(recording, fixes=[fix], memory=memory)  # sensing and dead reckoning are not repeated
    >>> len(first.observations), len(second.observations)
    (0, 1)
    """

    recording: Recording | None = None
    _key: bytes = b""
    _found: Reckoned | None = None

    def of(self, recording: Recording, key: bytes, make: Callable[[], Reckoned]) -> Reckoned:
        """Return the dead-reckoned track from memory, or a new one if anything has changed since the last call.

        Parameters
        ----------
        recording : Recording
            Recording of this call.
        key : bytes
            Configuration and options of this call, as bytes.
        make : callable
            Function that computes the result.

        Returns
        -------
        tuple
            Configuration, dead-reckoned track, state of the sensing at its end, and steps within standstills.
        """
        if self._found is None or self.recording is not recording or self._key != key:
            self.recording, self._key, self._found = recording, key, make()
        return self._found


def smooth(
    recording: Recording,
    config: Config | None = None,
    *,
    fixes: Iterable[Fix] = (),
    calibration: Calibration | str | Path | None = None,
    weighting: str | None = None,
    progress: Callable[[float], None] | None = None,
    device: Device | str | Path | None = None,
    person: Person | Calibration | str | Path | None = None,
    gnss: GnssUse | None = None,
    origin: Origin | tuple[float, float] | None = None,
    heading_rad: float | None = None,
    north: NorthUse | None = None,
    plan: Plan | None = None,
    start: PositionFix | str | None = None,
    loop: bool = False,
    loop_closures: Iterable[LoopClosure] | Literal["wifi"] = (),
    known_headings: Iterable[KnownHeading] = (),
    floor_changes: Iterable[FloorChange] = (),
    start_heading_std_rad: float | None = None,
    anchor_interval_s: float = 2.0,
    memory: SmoothingMemory | None = None,
    factors: UserFactors | None = None,
) -> Smoothed:
    """Return the smoothed track of a recording, with a covariance at every step.

    This is the best estimate of a finished walk, because every position is estimated from all steps and all
    observations. `pdr_filter.track` gives the online estimate instead. Step scale, heading drift, and the heading
    offset of each way of carrying the phone are estimated together with the positions, and so are the errors that
    locations share. Observations that contradict the walk are rejected, and are listed in `Smoothed.observations` and
    in the notes.

    Parameters
    ----------
    recording : Recording
        The recording, from `pdr_filter.read`.
    config : Config, optional
        Configuration. The default is `pdr_filter.recipes.default(recording.subject)`.
    fixes : iterable of PositionFix, HeadingFix, SpeedFix, RangeFix or Standstill
        Fixes in any order; on a floor plan also GridFix. Positions may be in any frame, because the rotation to the
        phone's first heading is estimated. Fixes outside the recording are not used. On a plan, each fix is used at its
        reception time, as online.
    calibration : Calibration, str or Path, optional
        Step-length parameters from `pdr_filter.calibrate`, or the path of a saved calibration.
    weighting : {"imm", "wc", "hc"}, optional
        Use of the context probabilities: interacting multiple model, weighted contexts, or the most probable context.
        The default is the value of the configuration.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    device : Device, str or Path, optional
        `Track.device` of an earlier recording of the same phone, or the path of a saved one.
    person : Person, Calibration, str or Path, optional
        Step lengths of the person: `Track.person` of an earlier recording, a calibration, or the path of a saved one.
    gnss : {"filter", "align", "off"}, optional
        Use of the recording's own locations: as fixes, to rotate and shift the smoothed walk as a whole, or not at all.
        The default is "filter" if the recording has locations, unless `fixes` has positions or headings, or `origin` or
        `heading_rad` is given.
    origin : Origin or tuple of float, optional
        Geographic position of the zero of the track: an `Origin`, or latitude and longitude in degrees.
    heading_rad : float, optional
        True heading of the first steps in rad, clockwise from north. The track is rotated to it.
    north : {"magnetic", "rotation-vector", "true-heading", "off"}, optional
        Source of true north: the magnetometer, the attitude reported by the phone, or none.
    plan : FloorPlan, optional
        Floor plan that constrains the track. Fixes are then in the frame of the plan.
    start : PositionFix or str, optional
        Start on the plan: a position, the name of an area, or "anywhere".
    loop : bool, default False
        True if the walk ended within 1 m of its start. If the walk contradicts this, it is not used, and a note says
        so.
    loop_closures : iterable of LoopClosure, or "wifi"
        Pairs of times at which the pedestrian was at one place. "wifi" finds pairs of times with the same Wi-Fi signals
        (`wifi_loop_closures`).
    known_headings : iterable of KnownHeading
        Known directions between two times. Not available on a plan.
    floor_changes : iterable of FloorChange
        Known storeys. Not available on a plan.
    start_heading_std_rad : float, optional
        Standard deviation of the difference between the phone's first heading and the walking heading in the frame of
        the fixes, in rad. By default the difference is unknown if there are fixes or known headings, and otherwise has
        the value of the configuration.
    anchor_interval_s : float, default 2.0
        Largest time in s between two anchors, which are the foot contacts at which a state is estimated. Observations
        and changes of the heading offset have anchors too.
    memory : SmoothingMemory, optional
        Memory of earlier calls with the same recording. A call with other fixes then reuses the dead-reckoned track and
        takes a fraction of the time.
    factors : callable, optional
        Function that takes a `PoseKeys` and returns further factors, a `gtsam.NonlinearFactorGraph`, or a pair of it
        and the `gtsam.Values` of unknowns of its own, such as landmarks. The solution is in `Smoothed.values`. Not
        available on a plan.

    Returns
    -------
    Smoothed
        The smoothed track, the estimated offsets and scales, and the use of each observation.

    Raises
    ------
    ValueError
        If arguments contradict each other or are out of range, or if all fixes are outside the recording.
    MissingSensorError
        If the recording lacks a needed sensor, for example Wi-Fi for loop_closures="wifi".

    See Also
    --------
    pdr_filter.track : Online track of a recording.

    References
    ----------
    C. Forster et al., "On-manifold preintegration for real-time visual-inertial odometry", IEEE T-RO 33, 2017. H. Yang
    et al., "Graduated non-convexity for robust spatial perception", IEEE RA-L 5, 2020.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()
    >>> begin = pdr.PositionFix(2.0, (0.0, 0.0), 0.5**2 * np.eye(2))
    >>> end = pdr.PositionFix(117.0, (0.0, 0.0), 0.5**2 * np.eye(2))  # the walk ends at its start
    >>> smoothed = pdr.smooth(recording, fixes=[begin, end])
    >>> bool(np.hypot(*smoothed.track.position_m[-1]) < 1.5)
    True
    """
    known_headings, floor_changes = tuple(known_headings), tuple(floor_changes)
    loop_closures = loop_closures if isinstance(loop_closures, str) else tuple(loop_closures)
    is_more = loop or loop_closures or known_headings or floor_changes or start_heading_std_rad is not None or factors
    if plan is not None and is_more:
        raise ValueError(
            "smoothing on a floor plan supports fixes alone, got loop, loop_closures, known_headings, floor_changes, "
            "start_heading_std_rad or factors together with plan: omit them"
        )
    check_options(loop, loop_closures, start_heading_std_rad, anchor_interval_s)
    georeference = Georeference(gnss, origin, heading_rad, north, plan, start)
    run = prepared_run(recording, config, fixes, georeference, weighting, calibration, device, person)
    if isinstance(loop_closures, str):
        loop_closures = tuple(wifi_loop_closures(run.recording))
    passes = pass_callbacks(progress)
    if run.config.on_plan is not None:
        return with_given_origin(run, _on_plan(run, run.config.on_plan.plan, passes, is_given=plan is not None))
    load_optional("gtsam")  # before the dead reckoning, which can take a minute
    if memory is None:
        config, track, sensing, stood = _dead_reckoned(run, passes)
    else:
        key = _key_of((run.config.with_model(frame=START_FRAME), _standstills(run), north, run.with_location))
        config, track, sensing, stood = memory.of(recording, key, partial(_dead_reckoned, run, passes))
    where, locations = (LocationState(), ()) if gnss == "align" else _locations(run)
    closed = start_end_closure(track) if loop else None
    observed = Observations(
        fixes=_observed_fixes(run),
        locations=locations,
        loop_closures=(*loop_closures, *(() if closed is None else (closed,))),
        known_headings=known_headings,
        floor_changes=floor_changes,
        is_loop=closed is not None,
    )
    guess = online_path(run.recording, config, run.fixes)
    walk = ReckonedWalk(track, config, observed, where, stood, guess, start_heading_std_rad, anchor_interval_s)
    smoothed, cov, walk = walk.smoothed()
    if factors is not None and track.n_steps:
        smoothed = walk.with_factors(smoothed, factors)
    if sensing is not None and (np.asarray(smoothed.observations.weight) > 0.5).any():
        device = observed_device(smoothed, config, sensing)
        smoothed = replace(smoothed, track=replace(smoothed.track, device=device))
    if gnss == "align" and (location := run.recording.location) is not None:
        # the dead-reckoned walk is smoothed again with the locations as fixes, which shows the shift of their clock
        located = replace(walk, track=track, observed=replace(observed, locations=locations_of(location)[1]), clocks={})
        shift = located.smoothed()[2].clocks.get("locations", ClockShift())
        location = Samples(location.time_s - shift.late_s, location.values)
        walked_var_m2 = np.array([walked_var(P) for P in cov])
        smoothed, where, locations = aligned_walk(smoothed, walked_var_m2, location)
        smoothed = replace(smoothed, notes=(*smoothed.notes, *shift.notes("locations")))
        return with_given_origin(run, on_earth(smoothed, where, locations, observed))
    return with_given_origin(run, walk.on_earth(smoothed))


def _key_of(value: object) -> bytes:
    """Return the content of a value as bytes. Only a value with parts of other classes is pickled, which is slower."""
    try:
        return to_bytes(value)
    except TypeError:  # classes of other packages
        pass
    try:
        return pickle.dumps(value)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(
            f"memory cannot compare configurations with a part that cannot be pickled ({error}): define its class in a "
            "module, without lambda functions, or omit memory"
        ) from error


def _standstills(run: Run) -> list[Standstill]:
    """Return the standstills among the fixes."""
    return [fix for fix in run.fixes if isinstance(fix, Standstill)]


def _observed_fixes(run: Run) -> tuple[Any, ...]:
    """Return the fixes that are observations of a smoothed walk."""
    return tuple(fix for fix in run.fixes if not isinstance(fix, Standstill | GridFix))


def _dead_reckoned(run: Run, passes: Passes = (None, None)) -> Reckoned:
    """Return the dead reckoning of a recording, without fixes and locations."""
    return dead_reckoned(run.recording, run.config, _standstills(run), passes, run.with_location)


def _locations(run: Run) -> tuple[LocationState, tuple[PositionFix, ...]]:
    """Return the locations of a recording as fixes, after the state of their conversion, if they are used."""
    if run.with_location and run.recording.location is not None:
        return locations_of(run.recording.location)
    return LocationState(), ()


def chain_problem(recording: Recording, anchor_interval_s: float) -> tuple[Track, FloatArray, Problem]:
    """Return the dead-reckoned track of a recording, and its least-squares problem without fixes.

    The second value is the walking heading of each step minus its heading offset, (K,). North comes from the
    magnetometer if the recording has one. The problem is the part of one walk in a problem of many walks. ValueError
    for a recording without steps.
    """
    north: NorthUse | None = "magnetic" if "magnetometer" in recording.streams else None
    run = prepared_run(recording, None, (), Georeference(gnss="off", north=north))
    config, track, *_ = _with_steps(run, _dead_reckoned(run))
    track = with_smoothed_modes(track, config)
    posed = ReckonedWalk(track, config, Observations(), anchor_interval_s=anchor_interval_s).posed()
    return track, posed.used.device_rad, posed.problem


def _with_steps(run: Run, found: Reckoned) -> Reckoned:
    """Return the dead reckoning of a recording. ValueError if it has no steps."""
    if not found[1].n_steps:
        raise ValueError(f"{run.recording.name or 'the recording'} has no steps: leave it out")
    return found


def reckoned_walk(
    recording: Recording,
    config: Config | None,
    fixes: Sequence[Fix],
    loop_closures: Sequence[LoopClosure],
    log_scale_std: float,
) -> ReckonedWalk:
    """Return a walk with its fixes, loop closures and locations, smoothed alone as by `smooth`.

    The log step scale has the prior standard deviation `log_scale_std`, if that of the configuration is not larger. A
    smaller one would reject right fixes of a person who is not calibrated yet. ValueError for a recording without
    steps, or with observations outside of it.
    """
    run = prepared_run(recording, config, fixes, Georeference())
    if run.config.on_plan is not None or any(isinstance(fix, GridFix) for fix in run.fixes):
        raise ValueError("smoothing on a floor plan does not estimate step lengths: omit plan and GridFix")
    own, track, _, stood = _with_steps(run, _dead_reckoned(run))
    noise = own.model.noise
    own = own.with_model(noise=replace(noise, log_scale_std=max(noise.log_scale_std, log_scale_std)))
    where, locations = _locations(run)
    observed = Observations(fixes=_observed_fixes(run), locations=locations, loop_closures=tuple(loop_closures))
    walk = ReckonedWalk(track, own, observed, where, stood, online_path(run.recording, own, run.fixes))
    smoothed, _, walk = walk.smoothed()
    return replace(walk, shape_m=_shape_m(smoothed))


def _shape_m(smoothed: Smoothed) -> FloatArray:
    """Return the shape (K + 1, 2) of a smoothed walk: positions at the start and after each step, for scale one."""
    return np.vstack([smoothed.start_position_m, smoothed.track.position_m]) / smoothed.scale


class Posed(NamedTuple):
    """Least-squares problem of a walk, with the values that it was made of."""

    steps: Increments
    parameter_error_m: FloatArray  # (K, C, 2) errors of the steps by consider parameters
    used: Used
    problem: Problem


# Passes of mode probabilities and positions, and the difference of probabilities below which the next one is the same:
# 0.01 of the difference between two lengths is less than 1 cm. The evidence depends on a solution by its rotation and
# scale alone: 0.05 (3 degrees, 5 %) changes a difference of lengths by less than 5 %.
_MOST_MODE_PASSES, _SAME_PROB, _SAME_LINEARISATION = 3, 0.01, 0.05
# Decrease of the sum of squares by which the solution for a possible shift of a clock is improved. Other shifts reject
# other positions, each of which changes the sum by about 2.
_LEAST_GAIN = 0.1
# Smallest number of positions of a source with a shape that a shift of its clock changes.
_MIN_POSITIONS = 3
# The velocity at a fix is the mean of the walk within this time before and after, in s, so that it reaches around the
# corners of a walk.
_VELOCITY_S = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ReckonedWalk:
    """Dead-reckoned walk with its observations, and the options of its smoothing problem."""

    track: Track  # dead-reckoned; its mode probabilities may be smoothed
    config: Config
    observed: Observations  # as given
    where: LocationState = field(default_factory=LocationState)  # geographic origin of the locations
    stood: StandstillSteps = field(default_factory=StandstillSteps)  # steps within standstills
    guess: WalkedPath | None = None  # path at which measurements are first linearised
    start_heading_std_rad: float | None = None
    anchor_interval_s: float = 2.0  # as in `smooth`
    # shifts of the clocks of the observations
    clocks: Mapping[Source, ClockShift] = field(default_factory=dict[Source, ClockShift])
    # (K + 1, 2) positions of the start and of the steps that show the shape of the walk (`errors_of`), None for those
    # of the dead reckoning
    shape_m: FloatArray | None = None

    @property
    def on_clock(self) -> Observations:
        """Observations on the clock of the track."""
        observed = self.observed
        for source, shift in self.clocks.items():
            observed = observed.earlier(source, shift.late_s)
        return observed

    @property
    def ends_s(self) -> tuple[float, float]:
        """First and last time of the track, in s."""
        track = self.track
        start_s, end_s = track.start_time_s, track.start_time_s + track.duration_s
        if track.n_steps:
            start_s, end_s = min(start_s, float(track.time_s[0])), max(end_s, float(track.time_s[-1]))
        return start_s, end_s

    def increments(self) -> tuple[Increments, FloatArray]:
        """Return the increments of the steps, and their errors (K, C, 2) in m due to consider parameters.

        Steps that contradict a stated standstill have no displacement. If the statement is wrong, all of them lack
        theirs: the sum d of the displacements adds d d' to the covariance of the last one.
        """
        track, model = self.track, self.config.model
        is_weighted = track.weighting != "imm"
        of = partial(increments, track.steps, model=model, gap_before_s=track.gap_before_s, is_weighted=is_weighted)
        steps, parameter_error_m = of(mode_prob=track.mode_prob)
        inside = (track.time_s >= self.stood.first_s) & (track.time_s <= self.stood.last_s)
        if inside.any():
            free, _ = of(mode_prob=model.step_mode_prob(track.context_prob))
            withheld_m = (free.displacement_m - steps.displacement_m)[inside].sum(axis=0)
            cov = steps.cov_m2.copy()
            cov[np.flatnonzero(inside)[-1]] += np.outer(withheld_m, withheld_m)
            steps = replace(steps, cov_m2=cov)
        return steps, parameter_error_m

    def posed(self, anchors: Sequence[int] = ()) -> Posed:
        """Return the least-squares problem of the walk. `anchors` are further numbers of steps with an anchor."""
        track, model, observed = self.track, self.config.model, self.on_clock
        noise, modes = model.noise, model.modes
        steps, parameter_error_m = self.increments()
        used = usable(track, steps, modes, noise.log_scale_std, observed, observed.fixes_inside(*self.ends_s))
        offsets = heading_offsets(track, steps, modes)
        heading_std_rad, frame_std_rad = _start_directions(used, len(offsets) > 0, noise, self.start_heading_std_rad)
        shape_m = self.shape_m if observed.locations else None
        if shape_m is None:
            walk_m = np.vstack([np.zeros((1, 2)), track.position_m])
            at = contacts_of(steps, [fix.time_s for fix in used.observed.locations]).step
            shape_m = turned_to(used.observed.locations, walk_m[at], walk_m)
        measurements = None if self.guess is None else _measurements_on_path(used, self.guess)
        fixes = (*used.observed.positions, *used.observed.locations)
        centre = np.mean([f.position_m for f in fixes], axis=0) if fixes else np.zeros(2)
        if not fixes and measurements is not None and used.has_positions:
            centre = measurements.guess_m.mean(axis=0)
        start_std_m = _REGION_STD_M if used.has_positions else KNOWN_STD_M
        start_cov = start_covariance(start_std_m, heading_std_rad, noise.log_scale_std**2)
        before_first = steps.jump_var_rad2[0] + steps.drift_var_rad2[0] + steps.unknown_var_rad2[0]
        start_cov[HEADING_OFFSET, HEADING_OFFSET] += before_first
        problem = pose_problem(
            steps,
            np.array([*centre, 0.0, 0.0]),
            start_cov,
            used.observed,
            offsets,
            frame_std_rad,
            anchor_interval_s=self.anchor_interval_s,
            states=used.states,
            measurements=measurements,
            shape_m=shape_m,
            anchors=anchors,
        )
        return Posed(steps, parameter_error_m, used, problem)

    def solved(self, least_gain: float = -np.inf) -> tuple[Posed, Solution]:
        """Return the problem of the walk and its solution."""
        posed = self.posed()
        return posed, solve(posed.problem, least_gain)

    def smoothed(self) -> tuple[Smoothed, FloatArray, ReckonedWalk]:
        """Return the smoothed walk, the covariances of `result`, and this walk with its clocks and mode probabilities.

        The smoothed walk includes the person's step scale if the fixes determine it.
        """
        observed, ends_s = self.observed, self.ends_s
        observed.check_inside(*ends_s)
        walk = replace(self, track=with_smoothed_modes(self.track, self.config))
        if walk.track.n_steps == 0:
            places = compress((*observed.fixes, *observed.locations), observed.fixes_inside(*ends_s))
            known = independent([f for f in places if isinstance(f, PositionFix)])
            return without_steps(walk.track, observed, known), np.zeros((0, 4, 4)), walk
        found = walk.solved()
        for source in get_args(Source):
            places = [fix for fix in getattr(observed, source) if isinstance(fix, PositionFix)]
            if len(places) >= _MIN_POSITIONS:
                prior = ShiftPrior.of(source, places, *ends_s)
                shift = estimated_shift(partial(walk._shifted, found, source), prior)
                walk = walk._with_clock(source, shift)
                found = walk.solved() if shift.late_s else found
        walk, found = walk._with_observed_modes(self.track, found)
        smoothed, cov = walk.result(*found)
        if len(found[0].problem.errors):
            # the shrinkage of the locations follows the shape of the walk, which the first solution knows best
            smoothed, cov = walk.result(*replace(walk, shape_m=_shape_m(smoothed)).solved())
        length_fixes = LengthFixes()
        for fix, result in zip((*observed.fixes, *observed.locations), smoothed.track.fixes, strict=True):
            length_fixes = length_fixes.plus(fix) if result.accepted else length_fixes
        estimate = float(smoothed.log_scale.mean()), float(np.mean(smoothed.log_scale_std**2))
        model = self.config.model
        session = session_of_scale(model, estimate, model.noise.log_scale_std**2, length_fixes)
        if session is not None:
            person = (self.config.person or Person()).pooled(Person((session,)))
            smoothed = replace(smoothed, track=replace(smoothed.track, person=person))
        return smoothed, cov, walk

    def _with_clock(self, source: Source, shift: ClockShift) -> ReckonedWalk:
        """Return the walk with the shift of the clock of one source."""
        return replace(self, clocks={**self.clocks, source: shift})

    def _shifted(self, found: tuple[Posed, Solution], source: Source, late_s: float) -> ShiftedWalk:
        """Return the sum of squares with another shift of one clock, and its derivatives by an earlier clock.

        `found` is the solution without the shift.
        """
        if late_s:
            found = self._with_clock(source, ClockShift(late_s)).solved(least_gain=_LEAST_GAIN)
        (posed, solution), ahead_m = found, _ahead_m(*found, source)
        _, slope, information = response(posed.problem, solution, ahead_m)
        is_rejecting = bool((solution.weight[: len(ahead_m)][ahead_m.any(axis=1)] == 0).any())
        return ShiftedWalk(sum_of_squares(posed.problem, solution), slope, information, is_rejecting)

    def _with_observed_modes(
        self, filtered: Track, found: tuple[Posed, Solution]
    ) -> tuple[ReckonedWalk, tuple[Posed, Solution]]:
        """Return the walk with mode probabilities that are smoothed with the observations, and its solution.

        `filtered` has the mode probabilities of the dead reckoning, and this walk the same smoothed, without
        observations. `found` is its solution.
        """
        walk = self
        for _ in range(_MOST_MODE_PASSES if walk.track.weighting == "imm" and found[1].weight.any() else 0):
            told = self._mode_prob(filtered, *found)
            if np.abs(told - walk.track.mode_prob).max() < _SAME_PROB:
                break
            walk, before = replace(walk, track=replace(walk.track, mode_prob=told)), found[1]
            found = walk.solved()
            turned = np.abs(found[1].mean - before.mean)[:, HEADING_OFFSET:]
            if np.array_equal(found[1].weight, before.weight) and turned.max() < _SAME_LINEARISATION:
                break
        return walk, found

    def _mode_prob(self, filtered: Track, posed: Posed, found: Solution) -> FloatArray:
        """Return the mode probabilities (K, M), smoothed with the evidence of the observations in a solved problem.

        A mode with less than one expected step keeps that of this walk.
        """
        model, likely = self.config.model, self.track.mode_prob.sum(axis=0) >= 1.0
        if likely.sum() < 2:
            return self.track.mode_prob
        of_modes = mode_steps(filtered.steps, model, posed.steps.unknown_var_rad2).of(likely)
        start_prob, transition_prob = model.long_run_mode_prob, model.transition_prob
        evidence = step_log_evidence(filtered.mode_prob, start_prob, transition_prob)[:, likely]
        between = start_prob[likely], transition_prob[likely][:, likely]
        walk = switching_walk(posed.steps, of_modes, posed.problem, found, evidence, *between)
        prob = self.track.mode_prob.copy()
        prob[:, likely] = walk.smoothed_modes()[0] * prob[:, likely].sum(axis=1, keepdims=True)
        return read_only(prob)

    def with_factors(self, smoothed: Smoothed, factors: UserFactors) -> Smoothed:
        """Return a smoothed walk with factors of the user in addition to its observations, by GTSAM.

        The observations are those that the walk alone does not contradict.
        """
        start = np.array([*smoothed.start_position_m, smoothed.track.walking_heading_rad[0]])
        poses = np.column_stack([smoothed.track.position_m, smoothed.track.walking_heading_rad])
        begin_s = float(self.track.steps.time_s[0] - self.track.steps.duration_s[0])
        keys = PoseKeys(np.append(begin_s, self.track.time_s), np.vstack([start, poses]))
        user = user_graph(factors, keys)
        posed = replace(self, shape_m=_shape_m(smoothed)).posed(user.anchors)
        nodes = posed.problem.intervals.nodes
        graph = WalkGraph(posed.problem, posed.used.device_rad[np.maximum(nodes - 1, 0)], posed.steps.time_s, begin_s)
        found, values = solved_with(graph, solve(posed.problem), user)
        result, _ = self.result(posed, found)
        of_walk = replace(result.track, person=smoothed.track.person, device=smoothed.track.device)
        return replace(result, track=of_walk, values=values)

    def on_earth(self, smoothed: Smoothed) -> Smoothed:
        """Return the smoothed walk with its geographic origin and the storeys of its fixes."""
        return on_earth(smoothed, self.where, self.on_clock.locations, self.on_clock)

    def result(self, posed: Posed, found: Solution) -> tuple[Smoothed, FloatArray]:
        """Return the result of a solved problem, and the covariance (K, 4, 4) of the state after each step."""
        track, observed = self.track, self.observed
        steps, parameter_error_m, used, problem = posed
        mean, cov = step_states(problem.intervals, found.mean, found.joint_cov)
        heading_var = np.minimum(cov[:, HEADING_OFFSET, HEADING_OFFSET], MAX_HEADING_VARIANCE)
        cov[:, HEADING_OFFSET, HEADING_OFFSET], heading_std_rad = heading_var, np.sqrt(heading_var)
        position = mean[:, :2]
        before = np.vstack([found.mean[:1, :2], position[:-1]])
        moved = position - before
        rotation = scaled_rotation(mean[:, HEADING_OFFSET], mean[:, LOG_SCALE])
        own = np.einsum("kab,kb->ka", rotation, steps.displacement_m)
        length = np.exp(mean[:, LOG_SCALE]) * steps.length_m
        # across a gap, the positions give the displacement during the gap, not that of the step
        moved = np.where((steps.gap_var_m2 > 0)[:, None], own, moved)
        heading = np.where(np.hypot(*moved.T) > 0.01, np.arctan2(moved[:, 0], moved[:, 1]), track.walking_heading_rad)
        is_used, nodes = found.weight[: len(problem.positions)] > 0, problem.intervals.nodes
        of_map, closed = is_used & (problem.positions.other < 0), is_used & (problem.positions.other >= 0)
        anchored = np.unique(nodes[problem.positions.node[of_map]])
        ends = np.column_stack([nodes[problem.positions.other[closed]], nodes[problem.positions.node[closed]]])
        error_m = _consider_errors_m(own, cov, np.einsum("kab,kmb->kma", rotation, parameter_error_m))
        position_cov = cov[:, :2, :2] + _since_fix_cov_m2(error_m, anchored, ends)
        start_cov = found.joint_cov[0, :2, :2]
        for source, clock in self.clocks.items():
            if clock.var_s2:
                follows, _, _ = response(problem, found, _ahead_m(posed, found, source))
                later, _ = step_states(problem.intervals, found.mean + follows, found.joint_cov)
                late_m = clock.var_s2**0.5 * np.vstack([follows[:1, :2], later[:, :2] - position])
                late_cov = late_m[:, :, None] * late_m[:, None, :]
                start_cov, position_cov = start_cov + late_cov[0], position_cov + late_cov[1:]
        # no step is uncertain by a metre, except the last one of a standstill that the steps contradict
        step_std_m = worst_std_m(steps.cov_m2)
        withheld_m = np.where(step_std_m > 1.0, step_std_m, 0.0)
        unstepped_m = np.sqrt(steps.gap_var_m2)
        start_std_m = worst_std_m(start_cov)
        if not used.has_positions:  # the first step begins at the origin
            unstepped_m[:1] = start_std_m = 0.0
        way_m = np.cumsum(np.append(0.0, length + unstepped_m + withheld_m))
        std_m = np.append(start_std_m, worst_std_m(position_cov))
        position_cov = bounded_position_cov(position_cov, reach_m(way_m, std_m)[1:])
        observations = observation_table(observed, used.row, found)
        end_s = track.start_time_s + track.duration_s
        results, conflict = fix_results(observed, observations, used, end_s), FixConflict()
        for fix, result in zip((*observed.fixes, *observed.locations), results, strict=True):
            if isinstance(fix, PositionFix) and np.isfinite(result.nis):
                at_m = interpolated_rows(fix.time_s, track.time_s, position)
                conflict = conflict.plus(result.outcome, fix.position_m - at_m)
        position_cov = position_cov + conflict.cov_m2
        scale_std = float(np.sqrt(problem.start_cov[LOG_SCALE, LOG_SCALE]))
        start_m = read_only(found.mean[0, :2] if used.has_positions else np.zeros(2))
        reckoned = notes_of_reckoning(track, found, heading_std_rad)
        shifts = [note for source, clock in self.clocks.items() for note in clock.notes(source)]
        of_solution = notes_of_solution(track, found, observations, observed, used, scale_std)
        notes = (*reckoned, *used.notes, *shifts, *of_solution, *(note.text for note in conflict_notes(conflict)))
        smoothed = replace(
            track,
            position_m=read_only(position),
            position_cov_m2=read_only(position_cov),
            step_length_m=read_only(length),
            walked_m=read_only(np.cumsum(length)),
            walking_heading_rad=read_only(wrap_angle(heading)),
            step_speed_mps=read_only(length / np.asarray(track.steps.duration_s)),
            notes=notes,
            start_position_m=start_m,
            is_smoothed=True,
            frame=used.frame or track.frame,
            fixes=results,
        )
        result = Smoothed(
            track=smoothed,
            heading_offset_rad=read_only(wrap_angle(mean[:, HEADING_OFFSET])),
            heading_offset_std_rad=read_only(heading_std_rad),
            log_scale=read_only(mean[:, LOG_SCALE]),
            log_scale_std=read_only(np.sqrt(cov[:, LOG_SCALE, LOG_SCALE])),
            start_position_m=start_m,
            start_position_cov_m2=read_only(start_cov),
            observations=observations,
            floor=floors_at_steps(track, observed.floor_changes),
            notes=notes,
        )
        return result, cov


def _on_plan(run: Run, plan: Plan, passes: Passes, *, is_given: bool) -> Smoothed:
    """Return a walk smoothed on a floor plan, whose observations are the position fixes.

    `is_given` is True if the plan was an argument of `smooth`, whose fixes are then in the frame of the plan.
    """
    config, _ = with_first_pass(run.recording, run.config, passes[0])
    if is_given and any(not isinstance(fix, GridFix) for fix in run.fixes):
        config = config.in_world_frame()
    return plan.smoothed(run.recording, config, run.fixes, run.with_location, passes[1])


def _ahead_m(posed: Posed, found: Solution, source: Source) -> FloatArray:
    """Return the way (F, 2) in m of the walk in 1 s at each observed position of a source, zero at the others."""
    mean, _ = step_states(posed.problem.intervals, found.mean, found.joint_cov)
    time_s = np.append(posed.steps.time_s[0] - posed.steps.duration_s[0], posed.steps.time_s)
    path_m = np.vstack([found.mean[:1, :2], mean[:, :2]])
    of_source = {"fixes": posed.used.observed.positions, "locations": posed.used.observed.locations}
    at_s = np.array([f.time_s for f in of_source[source]])
    ends_s = at_s - _VELOCITY_S, at_s + _VELOCITY_S
    before, after = (np.column_stack([np.interp(t, time_s, x) for x in path_m.T]) for t in ends_s)
    first = len(of_source["fixes"]) if source == "locations" else 0
    ahead_m = np.zeros((len(posed.problem.positions), 2))
    ahead_m[first : first + len(at_s)] = (after - before) / (2.0 * _VELOCITY_S)
    return ahead_m


def _measurements_on_path(used: Used, guess: WalkedPath) -> Measurements:
    """Return the measurements with the positions of a path at their times, for the first linearisation."""
    time_s = [fix.time_s for fix in used.measured]
    columns = [np.interp(time_s, guess.time_s, column) for column in guess.position_m.T]
    return Measurements(used.measured, used.device_rad, np.column_stack(columns))


def _start_directions(
    used: Used, has_offsets: bool, noise: MotionNoise, start_heading_std_rad: float | None
) -> tuple[float, float]:
    """Return the prior standard deviations in rad of the first heading offset and of the rotation of the frame.

    The rotation is that from the phone's frame to the frame of the fixes.
    """
    is_oriented = used.is_oriented
    wide = float(np.sqrt(MAX_HEADING_VARIANCE))
    if has_offsets and not is_oriented:
        # in the phone's frame, the heading offsets already contain the prior of the start
        return wide, _KNOWN_STD_RAD
    if start_heading_std_rad is not None:
        return start_heading_std_rad, start_heading_std_rad
    return (wide, wide) if is_oriented else (noise.initial_heading_offset_std_rad, _KNOWN_STD_RAD)


def _consider_errors_m(moved: FloatArray, cov: FloatArray, parameter_error_m: FloatArray) -> FloatArray:
    """Return the error (K, 2 + C, 2) in m of each step for one standard deviation of each consider parameter.

    The parameters are those of the filter (`Estimates.consider_cov_m2`): the second-order errors along and across the
    steps, and the C parameters of `increments` with the errors `parameter_error_m` (K, C, 2). `moved` (K, 2) are the
    displacements of the steps and `cov` (K, 4, 4) the covariances of the states.
    """
    variances = np.diagonal(cov, axis1=1, axis2=2)[:, HEADING_OFFSET:]
    along, across = np.array([second_order_errors(*each) for each in variances.tolist()]).reshape(-1, 2).T
    of_step = along[:, None] * moved, across[:, None] * moved @ TURN.T
    return np.concatenate([np.stack(of_step, axis=1), parameter_error_m], axis=1)


def _since_fix_cov_m2(error_m: FloatArray, anchored: IntArray, closures: IntArray) -> FloatArray:
    """Return the covariance (K, 2, 2) in m2 of each position due to errors (K, C, 2) that all steps share.

    Each error is summed over the steps from the last or to the next known position, whichever sum is shorter. Known
    positions are the anchors with a used fix, or the start without any. `anchored` are the numbers of steps before
    these anchors. Both ends of a used loop closure have the smaller one of their errors. `closures` (L, 2) are the
    numbers of steps before them.
    """
    total = np.concatenate([np.zeros_like(error_m[:1]), np.cumsum(error_m, axis=0)])
    known = {int(k): np.zeros_like(total[0]) for k in (anchored if len(anchored) else [0])}

    def smallest(steps: IntArray) -> FloatArray:
        at = np.array(sorted(known))
        known_m, after = np.array([known[k] for k in at.tolist()]) - total[at], np.searchsorted(at, steps)
        back = total[steps] + known_m[np.maximum(after - 1, 0)]
        ahead = total[steps] + known_m[np.minimum(after, len(at) - 1)]
        return _shorter(ahead, back)

    for ends in sorted(closures.tolist()):
        at_ends = smallest(np.array(ends))
        known |= dict.fromkeys(ends, _shorter(*at_ends))
    nearest = smallest(np.arange(1, len(total)))
    return np.einsum("kca,kcb->kab", nearest, nearest)


def _shorter(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the shorter one of two vectors (..., 2), the second one if both have the same length."""
    return np.where(((first**2).sum(axis=-1) < (second**2).sum(axis=-1))[..., None], first, second)
