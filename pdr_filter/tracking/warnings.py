"""Warnings about a track, derived from the state of its filter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from pdr_filter.filter.chain.handler import part_of
from pdr_filter.filter.chain.two_hypotheses import Hypotheses
from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.filter.height import height_filter as height
from pdr_filter.filter.pedestrian.frame_rotation import MAX_ANGLE_STD_RAD
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.clock import sorted_note
from pdr_filter.sensing.stream_merging import SENSORS
from pdr_filter.tracking import step_statistics as criteria
from pdr_filter.tracking.filtering import State
from pdr_filter.tracking.step_statistics import UNKNOWN_HEADING_RAD, StepCounts, WindowCounts
from pdr_filter.values import MAX_NORTH_STD_RAD, FloatArray, Note, how_many, replace_unchecked

# A warning about windows appears if more than this share of all windows, and more than this number, are affected.
_NOTABLE_SHARE, _NOTABLE_NUMBER = 0.05, 3
# Limits of share and number for steps: a turn or a door affects about ten steps.
_UNTRUSTED_SHARE, _UNTRUSTED_NUMBER = 0.2, 20
# Share of windows unlike the training data above which the whole recording is. In the average held-out person it is a
# tenth. The largest share in moving windows of MotionSense was 0.38, in models of 2, 4 and 8 other people.
_UNLIKE_SHARE = 0.5
# Probability below which the device of an earlier recording does not fit.
_UNFIT_DEVICE_PROB = 0.05
# Number of steps with an unknown heading that causes no warning: as many pass until the new direction of a phone that
# was moved to another place is known.
_UNKNOWN_NUMBER = 20


def notes_of(
    config: Config, state: State, vertices: FloatArray | None = None, absent: Sequence[Note] = ()
) -> list[Note]:
    """Return the warnings about a track so far, for a whole recording and for an app.

    `vertices` (K, 3) of a whole track are time, east and north. They give the position at which the track stops during
    a ride. `absent` are the warnings about sensors of a whole recording that begin or end too early or too late.
    """
    absent = [*absent, *config.merger.absences(state.merger)]
    notes = [*absent, *(Note("samples", text) for text in _sample_notes(state))]
    if state.finished and state.pedestrian.steps.n_final == 0:
        notes.append(Note("steps", criteria.NO_STEPS))
    report, walked = state.sensing.conditioner.report, state.statistics.walked
    is_turn_named = any(note.text.startswith("gyroscope") for note in absent)
    # True if the heading was certain until the gyroscope ended, which `absent` names
    is_ended = (
        is_turn_named and walked.unknown_from_s > report.last_time_s - report.n_without_rate / report.rate_hz - 1.0
    )
    notes += [
        *_sensor_notes(config, state),
        *_window_notes(state.statistics.seen, is_turn_named),
        *_step_notes(walked, report.has_gyroscope and not is_ended),
    ]
    is_pressure_named = any(note.text.startswith("barometer") for note in absent)
    notes += [*config.notes, *height.notes(state.height, state.waiting_climbs.barometer, is_pressure_named)]
    if config.on_plan is not None:
        notes += config.on_plan.notes(state.particles)
    return [
        *notes,
        *_frame_notes(config, state),
        *notes_of_rides(state.statistics.rides, vertices),
        *_fix_notes(config, state),
    ]


def _sample_notes(state: State) -> Iterator[str]:
    """Yield warnings about the samples, as a track of the recording with the same samples has them."""
    conditioner, stream = state.sensing.conditioner, state.merger.stream("accelerometer")
    if stream.n_sorted:
        yield sorted_note(stream.n_sorted, stream.n_received)
    report = conditioner.report
    report = replace_unchecked(
        report,
        n_received=stream.n_received or report.n_received,
        n_not_increasing=report.n_not_increasing + stream.n_late,
    )
    yield from replace_unchecked(conditioner, report=report).notes()


def device_notes(config: Config, state: State) -> list[str]:
    """Return a warning if the given device (gyroscope bias of an earlier walk) does not fit this walk."""
    device_prob = config.sensing.attitude.bias.device_fits(state.sensing.attitude.bias)
    if device_prob >= _UNFIT_DEVICE_PROB:
        return []
    words = f"the gyroscope bias of the given device fits this walk with a probability of {device_prob:.1g} only "
    return [words + "and is hardly used: it may be of another phone; give the device of this phone"]


def _sensor_notes(config: Config, state: State) -> Iterator[Note]:
    moving_s, seen_s = state.sensing.vibration.moving_s, state.sensing.vibration.seen_s
    if moving_s:
        yield Note("steps", f"for {moving_s} s, {100 * moving_s / seen_s:.0f} % of the time, {criteria.STEPLESS}")
    yield from (Note("sensors", text) for text in device_notes(config, state))
    for sensor, stream in zip(SENSORS[1:], state.merger.streams[1:], strict=True):
        if stream.n_late:
            words = (
                f"{sensor}: {stream.n_late} of {stream.n_received} samples were dropped, because they are repeated, "
            )
            words += f"behind later ones, or more than {config.merger.wait_s:g} s behind the accelerometer: send the "
            yield Note("samples", words + "samples of a sensor in order, and all sensors in turn in shorter blocks")
    if state.waiting_climbs.n_lost:
        lost = how_many(state.waiting_climbs.n_lost, "climb rate")
        words = f"{lost} of the barometer not used, because its times are ahead "
        yield Note("sensors", words + "of the other samples: put both on one clock")


def _window_notes(seen: WindowCounts, is_turn_named: bool = False) -> Iterator[Note]:
    """Yield warnings about windows. `is_turn_named` is True if another note names the missing angular rate."""
    of_all, notable = f"of {seen.n} windows", max(_NOTABLE_SHARE * seen.n, _NOTABLE_NUMBER)
    if seen.without_gyroscope and not is_turn_named:
        words = f"contexts of {seen.without_gyroscope} {of_all} were classified without gyroscope and are less "
        words += "certain: there was no angular rate; record the gyroscope at the rate of the accelerometer"
        yield Note("sensors", words)
    if seen.unknown > notable:
        yield Note("contexts", f"in {seen.unknown} {of_all} {criteria.UNFAMILIAR}")
    elif seen.unlike > max(_UNLIKE_SHARE * seen.n, _NOTABLE_NUMBER):
        yield Note("contexts", f"in {seen.unlike} {of_all} {criteria.UNLIKE}")
    if seen.irregular > notable:
        yield Note("steps", f"in {seen.irregular} {of_all} {criteria.HANDLED}")


def _step_notes(walked: StepCounts, is_bias_cause: bool = True) -> Iterator[Note]:
    """Yield warnings about steps. `is_bias_cause` is False if another note names why the heading is unknown."""
    notable = max(_UNTRUSTED_SHARE * walked.n, _UNTRUSTED_NUMBER)
    if walked.in_standing > notable:
        yield Note("contexts", f"{walked.in_standing} of {walked.n} {criteria.IN_STANDING}")
    if walked.on_the_spot > notable:
        yield Note("steps", f"{walked.on_the_spot} of {walked.n} {criteria.QUICK_AND_SOFT}")
    if is_bias_cause and walked.heading_unknown > _UNKNOWN_NUMBER:
        yield heading_note(walked)
    if walked.largest_move_m > 0:
        words = f"the track moved by {walked.largest_move_m:.1f} m at {walked.largest_move_s:.0f} s, "
        yield Note("heading", words + criteria.LATE)
    if walked.untrusted > notable:
        yield Note("heading", f"in {walked.untrusted} of {walked.n} steps {criteria.NO_DIRECTION}")


def heading_note(walked: StepCounts) -> Note:
    """Return a warning about the steps with an unknown heading."""
    words = (
        f"the heading is uncertain by more than {UNKNOWN_HEADING_RAD} rad in {walked.heading_unknown} of "
        f"{walked.n} steps, from {walked.unknown_from_s:.0f} to {walked.unknown_until_s:.0f} s: "
    )
    return Note("heading", words + criteria.HEADING_UNKNOWN)


def _frame_notes(config: Config, state: State) -> Iterator[Note]:
    frame, where = state.pedestrian.frame, state.locations
    if where.n_unusable:
        yield Note("fixes", where.unusable())
    if state.finished and frame.alignment is None and (frame.is_known or where.origin is not None):
        std_rad = math.sqrt(frame.rotation_var_rad2) if frame.is_known else math.pi
        if std_rad > MAX_ANGLE_STD_RAD:
            yield Note("fixes", rotation_note("position fixes" if where.origin is None else "locations", std_rad))
    if frame.is_north_wrong:
        words = "position fixes contradict an earlier heading fix, which is no longer used: check its time, its unit "
        yield Note("fixes", words + "(rad) and its zero (north, clockwise)")
    if frame.relocations:
        far_m = ", ".join(f"{np.linalg.norm(m.world_centre_m - m.track_centre_m):.0f}" for m in frame.relocations)
        words = f"the track was moved by {far_m} m to fixes that agree with each other but not with the track (after a "
        yield Note("fixes", words + "ride, or when the first fixes were wrong): earlier positions were not changed")
    if state.finished and (frame.name == "north" or (frame.name == "start" and config.sensing.north is not None)):
        yield Note("heading", north_note(math.inf if frame.compass is None else frame.compass.std_rad))


def rotation_note(what: str, std_rad: float) -> str:
    """Return the warning that the positions named `what` leave the rotation of a track with a standard deviation."""
    figure = f"± {math.degrees(min(std_rad, math.pi)):.0f} degrees, one standard deviation"
    heading = "heading_rad" if what == "locations" else "a heading fix"
    words = f"the {what} do not determine the rotation of the track ({figure}), probably because they are too few or "
    return words + f"too close to each other: give {heading} or more {what}"


NORTH_UNKNOWN = "the magnetic field does not determine north"


def north_note(std_rad: float) -> str:
    """Return the warning about a north from the magnetic field, given its standard deviation in rad."""
    figure = f"± {math.degrees(std_rad):.0f} degrees" if std_rad <= 1.0 else "± a radian or more"
    figure += ", one standard deviation"
    if std_rad <= MAX_NORTH_STD_RAD:
        return f"north comes from the magnetic field ({figure}): give position fixes or heading_rad for a better north"
    return (
        f"{NORTH_UNKNOWN} ({figure}), probably because of iron in the phone or a missing calibration: walk with "
        "turns, or give position fixes or heading_rad"
    )


def notes_of_rides(rides: Rides, vertices: FloatArray | None) -> Iterator[Note]:
    """Return warnings about vehicle rides, which the track does not follow.

    `vertices` (K, 3) are time, east and north of the track.
    """
    for ride in rides.found:
        if ride.is_outlier:
            continue
        place = ""
        if vertices is not None:
            _, east_m, north_m = vertices[max(np.searchsorted(vertices[:, 0], ride.begin_s, side="right") - 1, 0)]
            place = f" at {east_m:z.1f} m east, {north_m:z.1f} m north"
        words = (
            f"the position fixes move {ride.length_m:.0f} m without steps from {ride.begin_s:.0f} to {ride.end_s:.0f} "
            f"s, as in a vehicle: the track does not follow them and stops{place}; "
        )
        yield Note("fixes", words + "track the walks before and after the ride separately, each with a new filter")


def conflict_notes(conflict: FixConflict) -> Iterator[Note]:
    """Return a warning if many position fixes contradict the walk."""
    if conflict.is_doubtful:
        n = conflict.n_used + conflict.n_rejected
        words = (
            f"{conflict.n_rejected} of {n} position fixes contradict the walk, so that its place and direction are "
            "doubtful. Their axes are probably mirrored, exchanged or rotated, they are of another walk, or less "
            "accurate than stated: "
        )
        words += (
            "check that positions are (east, north) in m, latitude before longitude, and their accuracy; for positions "
            "on a map, use a configuration of in_world_frame()"
        )
        yield Note("fixes", words)


def _fix_notes(config: Config, state: State) -> Iterator[Note]:
    conflict = part_of(state.chain, Hypotheses).conflict
    yield from conflict_notes(conflict)
    if n_rejected := state.statistics.n_rejected_fixes:
        words = f"fixes that do {criteria.REJECTED} were not used: {n_rejected}; check their accuracy, and "
        words += "that fixes and samples have one clock (pdr_filter.smooth estimates a shift)"
        if config.model.frame.is_joined and not conflict.is_doubtful:
            words += "; if they are not east and north of the start of the track, as positions on a map, use a "
            words += "configuration of in_world_frame()"
        yield Note("fixes", words)
    fixes = state.pedestrian.fixes
    stood = fixes.standstill_steps
    if n_walked := round(stood.n_contradicting):
        words = (
            f"{n_walked} clear steps from {stood.first_s:.0f} to {stood.last_s:.0f} s contradict a stated standstill. "
            "They have no length, and the position is uncertain by their lengths. The times of the standstill are "
        )
        yield Note("fixes", words + "probably wrong: correct them, or leave the standstill out")
    if fixes.n_repeated:
        words = f"{how_many(fixes.n_repeated, 'fix', 'fixes')} not used, because they repeat an earlier fix: "
        words += "a receiver or a bridge has probably sent it again; give each fix once, at its own time"
        yield Note("fixes", words)
    if fixes.n_frozen:
        words = f"{how_many(fixes.n_frozen, 'fix', 'fixes')} not used, because they repeat the last position during "
        yield Note("fixes", words + "walking: the phone has probably lost GNSS reception")
    if not state.finished:
        return
    last_s = state.sensing.conditioner.report.last_time_s
    n_late = sum(fix.time_s <= last_s for fix in state.waiting_fixes)
    if n_late:
        words = f"{how_many(n_late, 'fix', 'fixes')} not used, because they arrived after the last sample at "
        yield Note("fixes", words + f"{last_s:.1f} s: smooth the recording (pdr_filter.smooth), which uses late fixes")
    ranges = state.pedestrian.fixes.ranges
    if ranges and next(fix for fix in reversed(state.last.fixes) if fix.anchor_m is not None).outcome == "waiting":
        n_anchors = len({tuple(pair.fix.anchor_m.tolist()) for pair in ranges})
        words = (
            f"the last {how_many(len(ranges), 'range')}, to {how_many(n_anchors, 'anchor')}, fit more than one "
            "position of the track, and were not used: "
        )
        yield Note("fixes", words + "give ranges to more anchors, or a position, or smooth the recording")
    if n_ahead := len(state.waiting_fixes) - n_late:
        words = f"fixes from after the last sample were not used: {n_ahead}; check that fixes and "
        yield Note("fixes", words + "samples have one clock (pdr_filter.smooth estimates a shift)")
