"""Warnings about a track, derived from the state of its filter."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pdr_filter.filter.fixes.gnss import Rides
from pdr_filter.filter.height import height_filter as height
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.stream_merging import SENSORS
from pdr_filter.tracking import step_statistics as doubtful
from pdr_filter.tracking.filtering import State
from pdr_filter.tracking.step_statistics import UNKNOWN_HEADING_RAD, StepCounts, WindowCounts
from pdr_filter.values import FloatArray, Note, how_many

# Share of all windows, and number, above which it is worth saying that something is odd about them.
_NOTABLE_SHARE, _NOTABLE_NUMBER = 0.05, 3
# The same of steps: a turn, or a door, is ten of them.
_UNTRUSTED_SHARE, _UNTRUSTED_NUMBER = 0.2, 20
# Steps with an unknown heading that are not worth a warning: those until a moved phone has shown its new direction.
_UNKNOWN_NUMBER = 20


def notes_of(config: Config, state: State, vertices: FloatArray | None = None) -> list[Note]:
    """Return the warnings about a track so far, for a whole recording and for an app.

    `vertices` (K, 3) of a whole track, time, east and north, say where it stopped during a ride.
    """
    notes = [Note("samples", text) for text in state.sensing.conditioner.notes()]
    if state.finished and state.tracker.pedestrian.steps.n_final == 0:
        notes.append(Note("steps", doubtful.NO_STEPS))
    notes += [*_of_sensors(config, state), *_of_windows(state.seen), *_of_steps(state.walked)]
    notes += [*config.notes, *height.notes(state.height)]
    if config.on_plan is not None:
        notes += config.on_plan.notes(state.particles)
    return [*notes, *_of_frame(state), *notes_of_rides(state.rides, vertices), *_of_fixes(state)]


def _of_sensors(config: Config, state: State) -> Iterator[Note]:
    moving_s, seen_s = state.sensing.rattle.moving_s, state.sensing.rattle.seen_s
    if moving_s:
        yield Note("steps", f"for {moving_s} s, {100 * moving_s / seen_s:.0f} % of the time, {doubtful.STEPLESS}")
    for sensor, last_s in config.merger.silent(state.merger):
        words = f"{sensor}: silent since {last_s:.1f} s, the others go on without it; if it still sends, its times are "
        yield Note("sensors", words + "of another clock: all sensors need one")
    for sensor, stream in zip(SENSORS, state.merger.streams, strict=True):
        if stream.n_late:
            words = f"{sensor}: {stream.n_late} of {stream.n_received} samples came again or too late for the others, "
            yield Note("samples", words + "and were left out")
    if state.n_lost_climbs:
        words = f"{how_many(state.n_lost_climbs, 'climb rate')} of the barometer not used: its times are ahead of the "
        yield Note("sensors", words + "samples, both need one clock")


def _of_windows(seen: WindowCounts) -> Iterator[Note]:
    of_all, notable = f"of {seen.n} windows", max(_NOTABLE_SHARE * seen.n, _NOTABLE_NUMBER)
    if seen.without_gyroscope:
        words = f"contexts of {seen.without_gyroscope} {of_all} without gyroscope, which are less sure: "
        yield Note("sensors", words + "there was no angular rate")
    if seen.unknown > notable:
        yield Note("contexts", f"in {seen.unknown} {of_all} {doubtful.UNFAMILIAR}")
    if seen.stairs_unknown > notable:
        words = f"stairs would be missed in {seen.stairs_unknown} {of_all}: the context model knows them from trouser "
        yield Note("contexts", words + "pockets only, and no barometer helped")
    if seen.irregular > notable:
        yield Note("steps", f"in {seen.irregular} {of_all} {doubtful.HANDLED}")


def _of_steps(walked: StepCounts) -> Iterator[Note]:
    notable = max(_UNTRUSTED_SHARE * walked.n, _UNTRUSTED_NUMBER)
    if walked.quick_and_soft > notable:
        yield Note("steps", f"{walked.quick_and_soft} of {walked.n} {doubtful.QUICK_AND_SOFT}")
    if walked.heading_unknown > _UNKNOWN_NUMBER:
        words = (
            f"the heading is uncertain by more than {UNKNOWN_HEADING_RAD} rad in {walked.heading_unknown} of "
            f"{walked.n} steps, from {walked.unknown_from_s:.0f} to {walked.unknown_until_s:.0f} s: "
        )
        yield Note("heading", words + doubtful.HEADING_UNKNOWN)
    if walked.largest_move_m > 0:
        words = f"the track moved by {walked.largest_move_m:.1f} m at {walked.largest_move_s:.0f} s, "
        yield Note("heading", words + doubtful.LATE)
    if walked.untrusted > notable:
        yield Note("heading", f"in {walked.untrusted} of {walked.n} steps {doubtful.NO_DIRECTION}")


def _of_frame(state: State) -> Iterator[Note]:
    frame, where = state.tracker.pedestrian.frame, state.locations
    if where.n_unusable:
        yield Note("fixes", where.unusable())
    if state.finished and where.origin is not None and frame.alignment is None:
        words = "the locations do not settle which way the track lies: its north is the most probable one"
        yield Note("fixes", words)
    if frame.is_north_wrong:
        words = "position fixes contradict a heading fix before them, which is not used any more: check its time, its "
        yield Note("fixes", words + "unit (rad) and its zero (north, clockwise)")
    if frame.relocations:
        far_m = ", ".join(f"{np.linalg.norm(m.world_centre_m - m.track_centre_m):.0f}" for m in frame.relocations)
        words = (
            f"fixes that agree with each other and not with the track moved it by {far_m} m: after a ride, or wrong "
        )
        yield Note("fixes", words + "first fixes; what was before stays as it was")
    if state.finished and frame.name == "north" and frame.compass is not None:
        words = f"north is where the magnetic field says, give or take {np.degrees(frame.compass.std_rad):.0f} degrees"
        yield Note("heading", words)


def notes_of_rides(rides: Rides, vertices: FloatArray | None) -> Iterator[Note]:
    """Notes on rides that a track does not follow; `vertices` (K, 3) are time, east and north of the track."""
    for ride in rides.found:
        if ride.is_outlier:
            continue
        place = ""
        if vertices is not None:
            _, east_m, north_m = vertices[max(np.searchsorted(vertices[:, 0], ride.begin_s, side="right") - 1, 0)]
            place = f" at {east_m:z.1f} m east, {north_m:z.1f} m north"
        words = (
            f"the position fixes move {ride.way_m:.0f} m without steps from {ride.begin_s:.0f} to {ride.end_s:.0f} s, "
            f"as in a vehicle: the track does not follow them and stops{place}; "
        )
        yield Note("fixes", words + "take the walks before and after the ride apart, each with a filter of its own")


def _of_fixes(state: State) -> Iterator[Note]:
    if state.n_rejected_fixes:
        yield Note("fixes", f"fixes that do {doubtful.REJECTED}, and were not used: {state.n_rejected_fixes}")
    n_frozen = state.tracker.pedestrian.fixes.n_frozen
    if n_frozen:
        words = f"{how_many(n_frozen, 'fix', 'fixes')} not used, because they repeat the last position while steps go "
        yield Note("fixes", words + "on: the app has probably lost GNSS")
    if state.finished and state.waiting_fixes:
        yield Note("fixes", f"fixes from after the last sample, not used: {len(state.waiting_fixes)}")
