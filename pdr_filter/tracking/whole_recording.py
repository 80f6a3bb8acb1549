"""Whole recordings at once: loops over the same steps that an app pushes samples through."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pdr_filter.filter.fixes.alignment import Place
from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.filter.imm.pedestrian_state import StepUpdate
from pdr_filter.filter.step_length.person import Person
from pdr_filter.recipes.config import Config, check_config
from pdr_filter.recipes.step_length_calibration import Calibration, load_calibration, with_steps_of
from pdr_filter.sensing.clock import one_clock
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.context_stage import WindowContext, with_climbs
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.barometer import Climb
from pdr_filter.sensing.front_end import Event, Sensing, SensingState
from pdr_filter.tracking.filtering import (
    Output,
    State,
    add_fixes,
    add_location,
    add_terrain_locations,
    climb_at,
    finish,
    init,
    parts,
    person_of,
    update,
)
from pdr_filter.tracking.georeferencing import with_north, with_north_of_attitude
from pdr_filter.tracking.gnss_alignment import aligned
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import (
    CARRYING_MODES,
    ContextSet,
    Fix,
    FixResult,
    FloatArray,
    ImuBlock,
    IntArray,
    Origin,
    Plan,
    PositionFix,
    Step,
    Table,
    Windows,
    all_fixes,
    check_fix,
    read_only,
    step_table,
    wrap_angle,
)
from pdr_filter.values.recording import MissingSensorError, Recording
from pdr_filter.values.track_placement import GnssUse, NorthUse, TrackPlacement, documented


@documented
def track(
    recording: Recording,
    config: Config | None = None,
    weighting: str | None = None,
    fixes: Iterable[Fix] = (),
    progress: Callable[[float], None] | None = None,
    calibration: Calibration | str | Path | None = None,
    device: Device | str | Path | None = None,
    person: Person | Calibration | str | Path | None = None,
    gnss: GnssUse | None = None,
    origin: Origin | tuple[float, float] | None = None,
    heading_rad: float | None = None,
    north: NorthUse | None = None,
    plan: Plan | None = None,
    start: PositionFix | str | None = None,
) -> Track:
    """Online track of a recording: each position from what came before it, the same bits that `OnlineFilter` gives.

    For a finished walk `pdr_filter.smooth` gives the best estimate.

    Parameters
    ----------
    recording : Recording
        From `read`.
    config : Config, optional
        A recipe; the default recipe if not given.
    weighting : {"imm", "wc", "hc"}, optional
        How context probabilities become step lengths: interacting multiple model, weighted or highest context. The
        recipe's own if not given; that of the default recipe is "imm".
    fixes : iterable of PositionFix, HeadingFix, SpeedFix or Standstill; on a plan also GridFix
        What is known from elsewhere, each used when it was received. Positions and headings are in the frame of the
        track, which starts at the origin; with `config.in_world_frame()` in any frame, and so is the track then, all
        of it, from the first position fix on (`Track.frame`).
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    device : Device or path, optional
        `Track.device` of an earlier recording of the same phone, or where one was saved.
    person, calibration : Person, Calibration or path, optional
        Step lengths of the person: `Track.person` of an earlier recording, from its fixes; a calibration of
        `pdr_filter.calibrate`; or the path where one was saved. `calibration` takes only a calibration, and a person
        beside it adds the walks of that person.
    gnss, origin, heading_rad, north, plan, start : fields of `TrackPlacement`

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()  # or pdr.read("walk.zip")
    >>> track = pdr.track(recording)
    >>> track.position_m.shape == (track.n_steps, 2)
    True
    >>> 120 < track.distance_m < 145  # 138 m are true
    True
    >>> pdr.track(recording, weighting="hc").weighting
    'hc'
    """
    placement = TrackPlacement(gnss, origin, heading_rad, north, plan, start)
    run = asked_run(recording, config, fixes, placement, weighting, calibration, device, person)
    recording, config = run.recording, run.config
    with_fixes = run.with_location and gnss != "align"
    results = outputs(recording, config, run.fixes, progress, with_fixes, run.with_location)
    return run.placed(collected(recording, config, aligned(recording, results) if gnss == "align" else results))


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What `track` and `smooth` make of their arguments."""

    recording: Recording  # on one clock
    config: Config
    fixes: tuple[Fix, ...]
    placement: TrackPlacement
    with_location: bool  # whether the recording's own locations are used

    def placed(self, result: Track) -> Track:
        """A track with the given place and heading, and with notes on the locations."""
        given, place = self.placement, self.placement.place
        if self.recording.location is not None and given.gnss is None and given.is_given:
            note = "the recording's own locations are not used: its place or heading was given"
            result = replace(result, notes=(*result.notes, note))
        if place is None:
            return result if given.heading_rad is None else result.turned(given.heading_rad)
        return result.placed(place if given.heading_rad is None else replace(place, turn_rad=given.heading_rad))


def asked_run(
    recording: Recording,
    config: Config | None,
    fixes: Iterable[Fix],
    placement: TrackPlacement,
    weighting: str | None = None,
    calibration: Calibration | str | Path | None = None,
    device: Device | str | Path | None = None,
    person: Person | Calibration | str | Path | None = None,
) -> Run:
    """The run that arguments of `track` ask for; ValueError for what contradicts itself."""
    config = given_or_default(recording, config).placed(placement)
    fixes = all_fixes(fixes)
    for fix in fixes:
        check_fix(fix, config.on_plan is not None)
    plan = None if config.on_plan is None else config.on_plan.plan
    with_location = placement.uses_location(recording, fixes, plan)
    recording, fixes = one_clock(recording, fixes)
    for known in (None if calibration is None else load_calibration(calibration, config), person):
        if known is not None:
            config = with_steps_of(config, known, recording.subject)
    if device is not None:
        config = config.with_device(device if isinstance(device, Device) else Device.load(device))
    if weighting is not None:
        config = config.with_weighting(weighting)
    if with_location:
        config = config.in_world_frame()
    config = with_north(config, recording, placement, with_location)
    recording = with_north_of_attitude(recording, placement.north)
    return Run(recording, config, fixes, placement, with_location)


def outputs(
    recording: Recording,
    config: Config,
    fixes: Sequence[Fix] = (),
    progress: Callable[[float], None] | None = None,
    with_location: bool = False,
    with_hills: bool = False,
) -> Iterator[tuple[State, Output]]:
    """What each stretch of a recording brings, with the filter's state after it; the last one is the end's.

    The recording's own locations are fixes (`with_location`), or only tell hills from storeys (`with_hills`).
    MissingSensorError if the tracks of the recipe need what was not recorded.
    """
    missing = [name for name in config.needs if name not in recording.streams]
    if missing:
        raise MissingSensorError(
            f"{recording.name or 'the recording'} has no {' and no '.join(missing)}, which recipe {config.name!r} "
            'needs for a track; use recipe "default", which does without'
        )
    state = add_fixes(config, replace(init(config), climbs=_climbs(config, recording)), fixes)
    if (with_location or with_hills) and (location := recording.location) is not None:
        latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
        where = latitude_deg, longitude_deg, accuracy_m
        if with_location:
            state = add_location(config, state, location.time_s, *where, altitude_m)
        elif (origin := origin_of(location)) is not None:
            state = add_terrain_locations(state, origin, location.time_s, *where)
    for part in _parts(merge_streams(recording), progress):
        state, output = update(config, state, part)
        yield state, output
    yield finish(config, state)


def collected(recording: Recording, config: Config, results: Iterable[tuple[State, Output]]) -> Track:
    """The track of a recording from its `outputs`."""
    state, whole = init(config), Output()
    for new_state, output in results:
        state = new_state
        whole.extend(output)
    report, end_s = state.sensing.conditioner.report, state.sensing.processed_s
    late = (FixResult.of(fix, end_s, "waiting") for fix in state.waiting_fixes)
    start_s = 0.0 if np.isnan(report.first_time_s) else report.first_time_s
    duration_s = 0.0 if np.isnan(report.last_time_s) else report.last_time_s - start_s
    misplaced = ("worn on the foot: this recipe is for a carried phone, its steps and lengths do not fit",)
    if config.on_foot or not recording.is_on_foot:
        misplaced = ()
    frame = state.tracker.pedestrian.frame
    origin = state.locations.origin if frame.is_known else None
    if origin is not None:
        frame = frame.drawn()
        origin = state.height.start_altitude.of(frame.origin(origin))
    updates = [u.in_frame(frame) for u in whole.updates if u.is_final]
    track = _track(recording.name, config, updates, _windows(whole.windows, config.model.context_set))
    is_on_plan = any(update.on_plan is not None for update in updates)
    if config.on_plan is not None:
        track = _on_plan(track, config.on_plan.plan, updates)
        origin = config.on_plan.plan.origin if is_on_plan else None
    start_m = frame.world(Place(np.zeros(2), np.zeros((2, 2)), 0.0, 0)).position_m
    if updates and updates[0].on_plan is not None:  # which knows nothing of before
        start_m = a_step_before(track.position_m[0], track.step_length_m[0], track.walking_heading_rad[0])
    vertices = np.vstack([[start_s, *start_m], np.column_stack([track.time_s, track.position_m])])
    return replace(
        track,
        start_time_s=start_s,
        start_position_m=read_only(start_m),
        frame="plan" if is_on_plan else frame.name,
        origin=origin,
        duration_s=duration_s,
        fixes=(*whole.fixes, *late),
        floor_passages=tuple(whole.floor_passages),
        device=config.sensing.device(state.sensing),
        person=person_of(config, state),
        notes=(*recording.notes, *misplaced, *(note.text for note in notes_of(config, state, vertices))),
    )


def a_step_before(position_m: FloatArray, length_m: float, heading_rad: float) -> FloatArray:
    """Where somebody was (2,) who came to a place with a step."""
    return position_m - length_m * np.array([np.sin(heading_rad), np.cos(heading_rad)])


def detect_steps(recording: Recording, config: Config | None = None) -> Table:
    """Steps of a recording: a table with a row for each `Step` and its fields as columns.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> steps = pdr.detect_steps(pdr.simulate.demo_walk())
    >>> bool((steps.frequency_hz > 1).all())
    True
    """
    config = given_or_default(recording, config)
    return step_table([e for e in run_sensing(config.sensing, recording)[1] if isinstance(e, Step)])


def classify(recording: Recording, config: Config | None = None) -> Windows:
    """Context and carrying-mode probabilities of all windows of a recording.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> windows = pdr.classify(pdr.simulate.demo_walk())
    >>> windows.contexts[windows.context_prob[0].argmax()]
    'stationary'
    """
    config = given_or_default(recording, config)
    recording, _ = one_clock(recording)
    climbs = _climbs(config, recording)
    _, events = run_sensing(config.sensing, recording)
    windows = [event for event in events if isinstance(event, WindowContext)]
    context_set = config.model.context_set
    return _windows(with_climbs(windows, [climb_at(climbs, w.time_s) for w in windows], context_set), context_set)


def _climbs(config: Config, recording: Recording) -> tuple[Climb, ...]:
    """Climb rates of the barometer, if there is one."""
    barometer = recording.barometer
    if barometer is None:
        return ()
    return tuple(config.climb_rate.update(config.climb_rate.init(), barometer.time_s, barometer.values[:, 0])[1])


def given_or_default(recording: object, config: Config | None) -> Config:
    """The configuration that is given, or the default recipe for a recording; ValueError for what is neither."""
    if not isinstance(recording, Recording):
        raise ValueError(f"recording must be a Recording, got {recording!r}: pdr_filter.read(path) makes one of a file")
    if config is None:
        return default_config(recording)
    check_config(config)
    return config


def default_config(recording: Recording) -> Config:
    """The default recipe for the person of a recording."""
    from pdr_filter.recipes import default  # loads the shipped models, which training makes

    return default(recording.subject)


def run_sensing(
    sensing: Sensing, recording: Recording, progress: Callable[[float], None] | None = None
) -> tuple[SensingState, list[Event]]:
    """Return the final state of sensing, and the steps, contexts and gaps in the order in which they became known."""
    state, all_events = sensing.init(), list[tuple[int, Event]]()
    for part in _parts(merge_streams(recording), progress):
        state, events = sensing.update(state, part)
        all_events += events
    state, events = sensing.finish(state)
    return state, [event for _, event in all_events + events]


def _parts(block: ImuBlock, progress: Callable[[float], None] | None) -> Iterator[ImuBlock]:
    done, n = 0, len(block.time_s)
    for part in parts(block):
        yield part
        done += len(part.time_s)
        if progress is not None:
            progress(done / n)


def _windows(contexts: Sequence[WindowContext], context_set: ContextSet) -> Windows:
    return Windows(
        time_s=read_only(np.array([w.time_s for w in contexts])),
        context_prob=read_only(np.array([w.prob for w in contexts]).reshape(-1, len(context_set.names))),
        contexts=context_set.names,
        standing_contexts=tuple(context_set.names[i] for i in context_set.standing),
        carrying_prob=read_only(np.array([w.carrying_prob for w in contexts]).reshape(-1, len(CARRYING_MODES))),
        carrying_modes=CARRYING_MODES,
        unknown_share=read_only(np.array([w.unknown_share for w in contexts])),
        stairs_unknown_share=read_only(np.array([w.stairs_unknown_share for w in contexts])),
        irregular_prob=read_only(np.array([w.irregular_prob for w in contexts])),
        climb_rate_mps=read_only(np.array([w.climb_rate_mps for w in contexts])),
        model=tuple(w.model for w in contexts),
    )


def _track(name: str, config: Config, updates: Sequence[StepUpdate], windows: Windows) -> Track:
    n, modes, contexts = len(updates), config.model.modes, config.model.contexts
    steps = step_table([u.step for u in updates])
    return Track(
        name=name,
        time_s=read_only(np.asarray(steps.time_s)),
        position_m=read_only(np.array([u.position_m for u in updates]).reshape(n, 2)),
        position_cov_m2=read_only(np.array([u.position_cov_m2 for u in updates]).reshape(n, 2, 2)),
        step_length_m=read_only(np.array([u.step_length_m for u in updates])),
        walked_m=read_only(np.array([u.walked_m for u in updates])),
        walking_heading_rad=read_only(wrap_angle(np.array([u.walking_heading_rad for u in updates]))),
        step_speed_mps=read_only(np.array([u.speed.step_mps for u in updates])),
        step_speed_std_mps=read_only(np.array([u.speed.step_std_mps for u in updates])),
        smoothed_speed_mps=read_only(np.array([u.speed.smoothed_mps for u in updates])),
        smoothed_speed_std_mps=read_only(np.array([u.speed.smoothed_std_mps for u in updates])),
        gap_before_s=read_only(np.array([u.gap_before_s for u in updates])),
        height_m=read_only(np.array([u.height_m for u in updates])),
        height_std_m=read_only(np.array([u.height_std_m for u in updates])),
        floor=_whole([u.floor for u in updates]),
        context_prob=read_only(np.array([u.context_prob for u in updates]).reshape(n, len(contexts))),
        contexts=contexts,
        mode_prob=read_only(np.array([u.mode_prob for u in updates]).reshape(n, len(modes))),
        modes=tuple(m.name for m in modes),
        mode_contexts=tuple(m.context for m in modes),
        steps=steps,
        windows=windows,
        start_time_s=0.0,
        duration_s=0.0,
        weighting=config.tracker.weighting,
    )


def _on_plan(track: Track, plan: Plan, updates: Sequence[StepUpdate]) -> Track:
    places = [u.on_plan for u in updates]
    return replace(
        track,
        plan=plan,
        clusters=tuple(() if place is None else place.clusters for place in places),
        effective_sample_size=read_only(np.array([0.0 if p is None else p.effective_sample_size for p in places])),
    )


def _whole(numbers: Sequence[int]) -> IntArray:
    array = np.array(numbers, dtype=np.int64)
    array.flags.writeable = False
    return array
