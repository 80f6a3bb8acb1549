"""Tracks, steps and contexts of whole recordings, computed with the functions of the online filter."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.filter.pedestrian.alignment import Pose
from pdr_filter.filter.pedestrian.frame import Frame
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.recipes.calibration import Calibration, load_calibration, with_steps_of
from pdr_filter.recipes.config import Config, check_config
from pdr_filter.recipes.modes import notes_with_height_of
from pdr_filter.sensing.clock import one_clock
from pdr_filter.sensing.conditioning import merged_parts
from pdr_filter.sensing.contexts.context_stage import with_climbs
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.barometer import ClimbState
from pdr_filter.sensing.front_end import Event, Sensing, SensingState
from pdr_filter.sensing.heading.heading_stage import knows_north
from pdr_filter.sensing.stream_merging import absences_in
from pdr_filter.tracking.filtering import (
    PART_SAMPLES,
    Output,
    State,
    WaitingClimbs,
    add_fixes,
    add_location,
    add_terrain_locations,
    climb_at,
    finish_filter,
    frame_name,
    init_filter,
    person_of,
    update_filter,
)
from pdr_filter.tracking.georeferencing import first_heading_rad, with_north, with_north_of_attitude
from pdr_filter.tracking.gnss_alignment import aligned_outputs
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
    Note,
    Origin,
    Plan,
    PositionFix,
    Step,
    Table,
    WindowContext,
    Windows,
    all_fixes,
    check_fix,
    how_many,
    read_only,
    step_table,
    wrap_angle,
)
from pdr_filter.values.checks import shown
from pdr_filter.values.events import Climb
from pdr_filter.values.georeference import Georeference, GnssUse, NorthUse, document_georeference
from pdr_filter.values.interpolation import interpolated_rows
from pdr_filter.values.phone import phone_heading_at, phone_steps_at
from pdr_filter.values.recording import MissingSensorError, Recording, Truth


@document_georeference
def track(
    recording: Recording,
    config: Config | None = None,
    *,
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
    """Compute the online track of a recording: each position is estimated from earlier samples only.

    The track is identical to the result of `OnlineFilter` on the same samples. For a finished walk, `pdr_filter.smooth`
    gives a better estimate, because it also uses later samples.

    Parameters
    ----------
    recording : Recording
        Recording to process, as returned by `pdr_filter.read`.
    config : Config, optional
        Configuration, as returned by a recipe. The default is the default recipe for the person of the recording. A
        recipe that is called without `recording.subject` does not use the person's height.
    weighting : {"imm", "wc", "hc"}, optional
        Combination of the context probabilities into step lengths: interacting multiple model, weighted context or
        highest context. The default is the weighting of the configuration ("imm" for the default recipe).
    fixes : iterable of PositionFix, HeadingFix, RangeFix, SpeedFix or Standstill, optional
        Known positions, headings, ranges, speeds and standstills, and with a plan also GridFix. Each is used at the
        time at which it was received. Positions are in the frame of the track, with the origin at its start. Its north
        is the first heading, or that of the first heading fix. With `config.in_world_frame()` they may be in any frame.
        The whole track is then in the frame of the fixes, from the first position fix on (`Track.frame`).
    progress : callable, optional
        Function that is called with the fraction of processed samples, 0 to 1.
    calibration : Calibration or path, optional
        Step-length calibration of the person, from `pdr_filter.calibrate`, or the file where it was saved.
    device : Device or path, optional
        Gyroscope bias of the phone: `Track.device` of an earlier recording, or the file where it was saved.
    person : Person, Calibration or path, optional
        Step length of the person: `Track.person` of an earlier recording, a calibration, or the file where either was
        saved. If `calibration` is given as well, the walks of the person refine it.
    gnss, origin, heading_rad, north, plan, start : fields of `Georeference`

    Returns
    -------
    Track
        One row for each step.

    Raises
    ------
    ValueError
        If arguments are invalid or contradict each other.
    MissingSensorError
        If the recording lacks a sensor that the recipe or an argument requires.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()  # or pdr.read("walk.zip")
    >>> track = pdr.track(recording)
    >>> track.position_m.shape == (track.n_steps, 2)
    True
    >>> 120 < track.distance_m < 145  # the true distance is 138 m
    True
    >>> pdr.track(recording, weighting="hc").weighting
    'hc'
    """
    georeference = Georeference(gnss, origin, heading_rad, north, plan, start)
    run = prepared_run(recording, config, fixes, georeference, weighting, calibration, device, person)
    recording, config = run.recording, replace(run.config, keeps_path=False)
    with_fixes = run.with_location and gnss != "align"
    results = outputs(recording, config, run.fixes, progress, with_fixes, run.with_location)
    if gnss == "align":
        results = aligned_outputs(recording, results, config.model.context_set)
    return run.with_given_origin(track_of_outputs(recording, config, results, georeference.given_origin))


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Inputs of `track` and `smooth` after all arguments have been checked and combined."""

    recording: Recording  # recording with all streams on one clock
    config: Config  # configuration with person, device, weighting, plan and frame
    fixes: tuple[Fix, ...]  # fixes on the clock of the recording
    georeference: Georeference  # arguments for position, north and floor plan
    with_location: bool  # True if the locations of the recording are used
    truth_notes: tuple[str, ...] = ()  # notes on fixes that are ground truth, for a track that used fixes

    def with_given_origin(self, result: Track) -> Track:
        """Return a track with the given origin and heading, the phone's own steps, and the notes on ground truth.

        A further note tells if the locations were ignored because of the origin or the heading.
        """
        given, place = self.georeference, self.georeference.given_origin
        result = replace(
            result,
            notes=(*result.notes, *(self.truth_notes if any(fix.accepted for fix in result.fixes) else ())),
            phone_n_steps=read_only(phone_steps_at(self.recording.phone_step_count, result.time_s)),
            phone_heading_rad=read_only(phone_heading_at(self.recording.phone_heading, result.time_s)),
        )
        if self.recording.location is not None and given.gnss is None and given.is_given:
            note = "the locations of the recording were not used, because origin or heading_rad was given"
            result = replace(result, notes=(*result.notes, note))
        if given.heading_rad is None:
            return result if place is None else result.placed(place)
        turn_rad = given.heading_rad - first_heading_rad(self.recording, result)
        result = result.turned(turn_rad, None if place is None else place.turn_std_rad)
        return result if place is None else result.placed(replace(place, turn_rad=turn_rad))


def prepared_run(
    recording: Recording,
    config: Config | None,
    fixes: Iterable[Fix],
    georeference: Georeference,
    weighting: str | None = None,
    calibration: Calibration | str | Path | None = None,
    device: Device | str | Path | None = None,
    person: Person | Calibration | str | Path | None = None,
) -> Run:
    """Return checked and combined inputs from the arguments of `track`.

    ValueError if arguments contradict each other.
    """
    config = given_or_default(recording, config).with_georeference(georeference)
    if georeference.states_north and knows_north(config.sensing.heading):
        raise ValueError(
            f"heading_rad, or turn_rad of origin, states north, which the heading stage "
            f"{type(config.sensing.heading).__name__} knows already: omit it, or set knows_north of the stage to False "
            "if its directions are not clockwise from north"
        )
    fixes = all_fixes(fixes)
    for fix in fixes:
        check_fix(fix, config.on_plan is not None)
    plan = None if config.on_plan is None else config.on_plan.plan
    with_location = georeference.uses_location(recording, fixes, plan)
    notes = tuple(_truth_notes(recording.truth, fixes))
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
    config = replace(config, notes=notes_with_height_of(recording.subject, config.notes))
    config = with_north(config, recording, georeference, with_location)
    recording = with_north_of_attitude(recording, georeference.north)
    return Run(recording, config, fixes, georeference, with_location, notes)


def _truth_notes(truth: Truth, fixes: Sequence[Fix]) -> Iterator[str]:
    """Yield a note if position fixes are waypoints or true positions of the recording, to 1 mm and 1 ms.

    There is no note if all of them are at the origin, because they may only state where the frame begins.
    """
    given = np.array([(f.time_s, *f.position_m) for f in fixes if isinstance(f, PositionFix)]).reshape(-1, 3)
    is_true = np.zeros(len(given), dtype=bool)
    for known in (truth.waypoints, truth.position):
        if known is None or not len(known):
            continue
        rows = np.column_stack([known["time_s"], known["east_m"], known["north_m"]])
        rows = rows[np.argsort(rows[:, 0])]
        near = np.clip(rows[:, 0].searchsorted(given[:, 0] + np.array([[-1e-3], [0.0]])), 0, len(rows) - 1)
        is_true |= (np.abs(rows[near] - given) < 1e-3).all(axis=2).any(axis=0)
        if known is truth.position:
            away_m = np.abs(interpolated_rows(given[:, 0], rows[:, 0], rows[:, 1:]) - given[:, 1:])
            is_true |= (away_m < 1e-3).all(axis=1)
    if given[is_true, 1:].any():
        yield (
            f"{is_true.sum()} of {how_many(len(given), 'position fix', 'position fixes')} are ground truth of the "
            "recording, so that the errors of this track against its truth are too small: for an evaluation, track "
            "without these fixes"
        )


def outputs(
    recording: Recording,
    config: Config,
    fixes: Sequence[Fix] = (),
    progress: Callable[[float], None] | None = None,
    with_location: bool = False,
    with_hills: bool = False,
) -> Iterator[tuple[State, Output]]:
    """Yield the state of the filter and its output for each part of a recording.

    The last pair is the result of `finish`. The locations of the recording are used as fixes (`with_location`), or only
    to distinguish hills from storeys (`with_hills`). MissingSensorError if the recording lacks a sensor that the recipe
    requires for a track.
    """
    check_sensors(recording, config)
    barometer, climbs = _climbs(config, recording)
    waiting_climbs = WaitingClimbs(barometer, tuple(climbs))
    state = add_fixes(config, replace(init_filter(config), waiting_climbs=waiting_climbs), fixes)
    location = recording.location
    if location is not None and with_location:
        state = add_location(config, state, location)
    elif location is not None and with_hills and (origin := origin_of(location)) is not None:
        state = add_terrain_locations(config, state, origin, location)
    for part in _parts(recording, progress):
        state, output = update_filter(config, state, part)
        yield state, output
    yield finish_filter(config, state)


def check_sensors(recording: Recording, config: Config) -> None:
    """Raise MissingSensorError if a recording lacks a sensor that the recipe requires for a track."""
    missing = [name for name in config.needs if name not in recording.streams]
    if missing:
        raise MissingSensorError(
            f"{recording.name or 'the recording'} has no {' and no '.join(missing)}, which recipe {config.name!r} "
            'needs for a track: use recipe "default", which does not need it'
        )


class RowStore:
    """Rows of a track while it is computed, in memory.

    Pieces of the track are columns, which take a tenth of the memory of the outputs of the filter. Outputs whose rows a
    later fix can move wait for the end.
    """

    def __init__(self) -> None:
        self.pieces, self.waiting = list[Track](), list[Output]()

    def add(self, piece: Track) -> None:
        """Add consecutive rows that no fix can move any more."""
        self.pieces.append(piece)

    def wait(self, output: Output) -> None:
        """Keep an output until the end."""
        self.waiting.append(output)

    def outputs(self) -> Iterator[Output]:
        """Yield the outputs that wait."""
        return iter(self.waiting)

    def joined(self) -> Track:
        """Return all pieces as one track, and release them."""
        return _joined(self.pieces)

    def vertices(self, track: Track) -> FloatArray:
        """Return time, east and north (K, 3) of the steps. `track` is the result of `joined`."""
        return np.column_stack([track.time_s, track.position_m])


def track_of_outputs(
    recording: Recording,
    config: Config,
    results: Iterable[tuple[State, Output]],
    place: Origin | None = None,
    rows: RowStore | None = None,
    absent: Callable[[], Sequence[Note]] | None = None,
) -> Track:
    """Return the track of a recording from its `outputs`. Only final steps are rows of the track.

    `place` is the given origin of the frame of the fixes. Locations define their own. `rows` collects the rows, and
    `absent` returns the notes on missing sensors at the end, by default those of the streams of the recording.
    """
    rows = RowStore() if rows is None else rows
    state, whole, n_waiting = init_filter(config), Output(), 0
    for new_state, output in results:
        state = new_state
        whole.extend(replace(output, updates=[], windows=[]))
        if n_waiting or not _is_settled(config, state, whole, output):
            rows.wait(output)
            n_waiting += 1
        else:
            rows.add(_piece(recording.name, config, output))
    report, end_s = state.sensing.conditioner.report, state.sensing.processed_s
    late = (FixResult.of(fix, end_s, "waiting") for fix in state.waiting_fixes)
    start_s = 0.0 if np.isnan(report.first_time_s) else report.first_time_s
    duration_s = 0.0 if np.isnan(report.last_time_s) else report.last_time_s - start_s
    misplaced = list[str]()
    if recording.is_on_foot and not config.on_foot:
        misplaced.append(
            f"the sensor was worn on the foot, but recipe {config.name!r} is for a carried phone: steps and step "
            'lengths are wrong; use a recipe for the foot, such as recipes.zhou2019(placement="foot")'
        )
    frame = state.pedestrian.frame
    origin = (state.locations.origin or place) if frame.is_known else None
    if origin is not None:
        frame = frame.at_most_probable_rotation() if state.locations.origin is not None else frame
        origin = state.height.start_altitude.of(frame.origin(origin))
    first = next((u for output in rows.outputs() for u in output.updates if u.is_final), None)
    is_on_plan = False
    for output in rows.outputs() if n_waiting else ():
        piece = replace(_piece(recording.name, config, output, frame), origin=origin)
        if config.on_plan is not None:
            updates = [u for u in output.updates if u.is_final]
            is_on_plan = is_on_plan or any(update.on_plan is not None for update in updates)
            piece = _on_plan(piece, config.on_plan.plan, updates)
        rows.add(piece)
    track = rows.joined()
    if config.on_plan is not None:
        origin = config.on_plan.plan.origin if is_on_plan else None
    start_m = frame.world(Pose(np.zeros(2), np.zeros((2, 2)), 0.0, 0)).position_m
    if first is not None and first.on_plan is not None:  # particles give no position before the first step
        start_m = position_before(track.position_m[0], track.step_length_m[0], track.walking_heading_rad[0])
    vertices = np.vstack([[start_s, *start_m], rows.vertices(track)])
    notes = notes_of(config, state, vertices, absences_in(recording.streams) if absent is None else absent())
    return replace(
        track,
        start_time_s=start_s,
        start_position_m=read_only(start_m),
        frame="plan" if is_on_plan else frame_name(config, state),
        origin=origin,
        duration_s=duration_s,
        fixes=(*whole.fixes, *late),
        floor_passages=tuple(whole.floor_passages),
        device=config.sensing.device(state.sensing),
        person=person_of(config, state),
        notes=(*recording.notes, *misplaced, *(note.text for note in notes)),
    )


def _is_settled(config: Config, state: State, before: Output, output: Output) -> bool:
    """Return True if no later fix can move the rows of an output. `before` has the fixes so far."""
    has_fixes = bool(before.fixes or state.waiting_fixes) or config.on_plan is not None
    return not has_fixes and all(update.of_start is None for update in output.updates)


def _piece(name: str, config: Config, output: Output, frame: Frame | None = None) -> Track:
    """Return the final rows and the windows of an output as a track, in a frame whose rotation is known by now."""
    updates = [u if frame is None else u.in_frame(frame) for u in output.updates if u.is_final]
    return _track(name, config, updates, _windows(output.windows, config.model.context_set))


def without_rows(track: Track) -> Track:
    """Return a track without its rows and windows."""
    names = [f.name for f in fields(track) if isinstance(getattr(track, f.name), np.ndarray)]
    empty = {name: getattr(track, name)[:0] for name in set(names) - {"start_position_m"}}
    windows = replace(track.windows, model=(), **{n: a[0][:0] for n, a in _columns_of([track.windows]).items()})
    return replace(track, windows=windows, clusters=(), **empty)


def _joined(pieces: list[Track]) -> Track:
    """Return consecutive pieces of a track as one, and empty the list, so that one column at a time is there twice."""
    last = pieces[-1]
    if len(pieces) == 1:
        return last
    clusters = tuple(chain.from_iterable(piece.clusters for piece in pieces))
    windows = _columns_of([piece.windows for piece in pieces])
    models = tuple(chain.from_iterable(piece.windows.model for piece in pieces))
    rows = _columns_of(pieces)
    pieces.clear()
    del rows["start_position_m"]
    joined = {name: _concatenated(windows.pop(name)) for name in [*windows]}
    whole = replace(last.windows, model=models, **joined)
    return replace(last, windows=whole, clusters=clusters, **{name: _concatenated(rows.pop(name)) for name in [*rows]})


def _columns_of(pieces: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the arrays of dataclasses of one type by the name of their field."""
    names = [f.name for f in fields(pieces[0]) if isinstance(getattr(pieces[0], f.name), np.ndarray)]
    return {name: [getattr(piece, name) for piece in pieces] for name in names}


def _concatenated(arrays: list[Any]) -> Any:
    joined = np.concatenate(arrays)
    joined.flags.writeable = False
    return joined.view(np.recarray) if isinstance(arrays[0], np.recarray) else joined


def position_before(position_m: FloatArray, length_m: float, heading_rad: float) -> FloatArray:
    """Return the position (2,) before a step, given the position after the step, its length and its heading."""
    return position_m - length_m * np.array([np.sin(heading_rad), np.cos(heading_rad)])


def detect_steps(recording: Recording, config: Config | None = None) -> Table:
    """Detect the steps of a recording.

    Parameters
    ----------
    recording : Recording
        Recording to process.
    config : Config, optional
        Configuration, as returned by a recipe. The default is the default recipe.

    Returns
    -------
    Table
        One row for each step, with the fields of `Step` as columns.

    Raises
    ------
    ValueError
        If `recording` is not a Recording or `config` is not a Config.

    Notes
    -----
    The steps are the same as in `track`. The columns of the walking direction and of north stay unknown, with an
    infinite standard deviation: `track(recording).steps` has them, and takes two to three times as long.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> steps = pdr.detect_steps(pdr.simulate.demo_walk())
    >>> bool((steps.frequency_hz > 1).all())
    True
    """
    config = given_or_default(recording, config)
    return step_table([e for e in run_sensing(config.sensing.steps_only, recording)[1] if isinstance(e, Step)])


def classify(recording: Recording, config: Config | None = None) -> Windows:
    """Classify context and carrying mode in all windows of a recording.

    Parameters
    ----------
    recording : Recording
        Recording to process.
    config : Config, optional
        Configuration, as returned by a recipe. The default is the default recipe.

    Returns
    -------
    Windows
        Probabilities of contexts and carrying modes, one row for each window.

    Raises
    ------
    ValueError
        If `recording` is not a Recording or `config` is not a Config.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> windows = pdr.classify(pdr.simulate.demo_walk())
    >>> windows.contexts[windows.context_prob[0].argmax()]
    'stationary'
    """
    config = given_or_default(recording, config)
    recording, _ = one_clock(recording)
    _, climbs = _climbs(config, recording)
    _, events = run_sensing(config.sensing, recording)
    windows = [event for event in events if isinstance(event, WindowContext)]
    context_set = config.model.context_set
    return _windows(with_climbs(windows, [climb_at(climbs, w.time_s) for w in windows], context_set), context_set)


def _climbs(config: Config, recording: Recording) -> tuple[ClimbState, list[Climb]]:
    """Return the state after all pressures, and the climb rates, which are none without barometer."""
    state, barometer = config.climb_rate.init(), recording.barometer
    if barometer is None:
        return state, []
    return config.climb_rate.update(state, barometer.time_s, barometer.values[:, 0])


def given_or_default(recording: object, config: Config | None) -> Config:
    """Return the given configuration, or the default recipe for the person of the recording.

    ValueError if `recording` is not a Recording or `config` is not a Config.
    """
    if not isinstance(recording, Recording):
        raise ValueError(
            f"recording must be a Recording, got {shown(recording)}: read a file with pdr_filter.read(path), and give "
            "the recording before the configuration"
        )
    if config is None:
        return default_config(recording)
    check_config(config)
    return config


def default_config(recording: Recording) -> Config:
    """Return the default recipe for the person of a recording."""
    # Imported late, because it loads the shipped models and training must run without them.
    from pdr_filter.recipes import default

    return default(recording.subject)


def run_sensing(
    sensing: Sensing, recording: Recording, progress: Callable[[float], None] | None = None
) -> tuple[SensingState, list[Event]]:
    """Return the final state of the front end, and its events in the order in which they became known.

    Events are steps, classified windows and gaps.
    """
    state, all_events = sensing.init(), list[tuple[int, Event]]()
    for part in _parts(recording, progress):
        state, events = sensing.update(state, part)
        all_events += events
    state, events = sensing.finish(state)
    return state, [event for _, event in all_events + events]


def _parts(recording: Recording, progress: Callable[[float], None] | None) -> Iterator[ImuBlock]:
    done, n = 0, len(recording.accelerometer)
    for part in merged_parts(recording, PART_SAMPLES):
        yield part
        done += len(part.time_s)
        if progress is not None:
            progress(done / max(n, 1))


def _windows(contexts: Sequence[WindowContext], context_set: ContextSet) -> Windows:
    same = ("time_s", "unknown_share", "stairs_unknown_share", "irregular_prob", "climb_rate_mps")
    columns: dict[str, Any] = {column: _column(contexts, column) for column in same}
    return Windows(
        context_prob=_column(contexts, "prob", len(context_set.names)),
        contexts=context_set.names,
        standing_contexts=tuple(context_set.names[i] for i in context_set.standing),
        carrying_prob=_column(contexts, "carrying_prob", len(CARRYING_MODES)),
        carrying_modes=CARRYING_MODES,
        model=tuple(w.model for w in contexts),
        **columns,
    )


def _track(name: str, config: Config, updates: Sequence[StepUpdate], windows: Windows) -> Track:
    modes, contexts, steps = config.model.modes, config.model.contexts, step_table([u.step for u in updates])
    speeds = [u.speed for u in updates]
    same = ("step_length_m", "walked_m", "gap_before_s", "height_m", "height_std_m")
    columns: dict[str, Any] = {column: _column(updates, column) for column in same}
    return Track(
        name=name,
        time_s=read_only(np.asarray(steps.time_s)),
        position_m=_column(updates, "position_m", 2),
        position_cov_m2=_column(updates, "position_cov_m2", 2, 2),
        walking_heading_rad=read_only(wrap_angle(_column(updates, "walking_heading_rad"))),
        step_speed_mps=_column(speeds, "step_mps"),
        step_speed_std_mps=_column(speeds, "step_std_mps"),
        smoothed_speed_mps=_column(speeds, "smoothed_mps"),
        smoothed_speed_std_mps=_column(speeds, "smoothed_std_mps"),
        floor=_whole([u.floor for u in updates]),
        context_prob=_column(updates, "context_prob", len(contexts)),
        contexts=contexts,
        mode_prob=_column(updates, "mode_prob", len(modes)),
        modes=tuple(m.name for m in modes),
        mode_contexts=tuple(m.context for m in modes),
        steps=steps,
        windows=windows,
        start_time_s=0.0,
        duration_s=0.0,
        weighting=config.tracker.weighting,
        **columns,
    )


def _column(rows: Sequence[object], name: str, *shape: int) -> FloatArray:
    """Return the values (N, ...) of an attribute of N objects, with the given shape of each."""
    return read_only(np.array([getattr(row, name) for row in rows]).reshape(len(rows), *shape))


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
