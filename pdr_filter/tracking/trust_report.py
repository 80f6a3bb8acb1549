"""Text report of a track: accuracy, and the stretches that are unreliable."""

from __future__ import annotations

import numpy as np

from pdr_filter.filter.fixes.gnss import INTERVAL_S, MIN_ACCURACY_M
from pdr_filter.tracking import step_statistics as criteria
from pdr_filter.values import BoolArray, FloatArray, TrackRows, how_many
from pdr_filter.values.recording import Recording

# Texts that notes share with the report. Notes give the number of windows, steps or fixes instead of their times.
_SHARED_WITH_NOTES = (
    criteria.NO_STEPS,
    criteria.STEPLESS,
    criteria.HANDLED,
    criteria.UNFAMILIAR,
    criteria.IN_STANDING,
    criteria.NO_DIRECTION,
    criteria.QUICK_AND_SOFT,
    criteria.LATE,
    criteria.REJECTED,
)
# Rate of turn from which a phone at the ear is doubtful, rad/s, and the number of steps (ten seconds) over which it is
# averaged. In a curve the head turns about a second ahead of the walking direction (R. Grasso et al., Neuroscience
# Letters 253, 1998, doi:10.1016/S0304-3940(98)00625-9). 99 % of the steps of ipol, sisfall and ubicomp13 are below this
# rate; there, sensors on the trunk are classified as phones at the ear.
_CURVE_RADPS, _CURVE_STEPS = 0.4, 21
# Minimum duration of a reported stretch: turns and doors cause shorter ones.
_MIN_DOUBT_S = 5.0
# Minimum duration of motion without steps that is reported as a ride: walking has a step at least every two seconds.
_MIN_RIDE_S = 20.0
# Name of the time in which the phone moved, but no step was found, beside the names of contexts.
WITHOUT_STEPS = "moving without steps"
# Maximum number of stretches of one kind whose times are listed.
_MAX_TIMES = 8
# Excess of the distance between two positions over the step length that is reported as a jump of a track without
# fixes. None of 72 real walks has an excess of 2 m.
_JUMP_M = 3.0
# Circumference of the Earth. Larger distances are errors, which would shrink everything else in a figure to a dot.
FARTHEST_M = 4e7
# Share of the windows without distinction of stairs above which the report says so.
_NOTABLE_SHARE = 0.05
# Effective number of modes above which the context is uncertain: two equally probable modes have 2.
_DOUBTFUL_MODES = 1.9
# Longer times without steps are reported as pauses.
_LONG_PAUSE_S = 60.0
_WEIGHTINGS = {
    "hc": "those of the most probable context (HC)",
    "wc": "averaged over the contexts by their probabilities (WC)",
    "imm": "weighted by the probabilities of the contexts in an interacting multiple model (IMM)",
}
_AT_THE_EAR = (
    "the phone is held at the ear in curves: the head turns against the body, and the track turns with it; give "
    "position or heading fixes"
)
_WITHOUT_ANGULAR_RATE = (
    "there is no angular rate, so that the walking direction is unknown: record the gyroscope, or give heading fixes"
)


def doubts(track: TrackRows) -> list[str]:
    """Return sentences about unreliable stretches of a track, each with the times of its stretches.

    The sentences report rides, a handled phone, unfamiliar motion, undecided contexts, uncertain walking directions,
    missing angular rate, long pauses, jumps, and rejected fixes.

    Parameters
    ----------
    track : Track
        Track to check.

    Returns
    -------
    list of str
        One sentence for each kind of problem. Empty if there are none.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.tracking.trust_report import doubts
    >>> track = pdr.track(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=60.0)]))
    >>> doubts(track)
    []
    """
    return [
        *_doubts_about_windows(track),
        *(_doubts_about_steps(track) if track.n_steps else ()),
        *_rejected_fixes(track),
    ]


def problems(track: TrackRows) -> list[str]:
    """Return sentences about all problems of a track: its unreliable stretches, and its remaining notes.

    A note is omitted if a sentence of `doubts` reports the same problem with its times.

    Parameters
    ----------
    track : Track
        Track to check.

    Returns
    -------
    list of str
        One sentence for each problem. Empty if there are none.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from dataclasses import replace
    >>> from pdr_filter.tracking.trust_report import problems
    >>> track = pdr.track(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=60.0)]))
    >>> problems(replace(track, notes=("the clock was set back once",)))
    ['The clock was set back once.']
    """
    sentences = doubts(track)
    words = [w for w in _SHARED_WITH_NOTES if any(w in sentence for sentence in sentences)]
    return [*sentences, *(sentence(note) for note in track.notes if not any(w in note for w in words))]


def report(track: TrackRows) -> str:
    """Return a short text about a track: steps, distance, accuracy, contexts, and where not to trust it."""
    lines = [f"{track.name}: {track.how_far} in {track.duration_s:.0f} s, {how_many(track.n_steps, 'step')}"]
    if track.n_steps:
        lines.append(f"end: {end(track)}")
        lines += [track.about_frame, about_weighting(track)]
    if contexts := context_durations(track):
        lines.append(f"contexts: {contexts}")
    without_stairs = _is_without_stairs(track)
    if without_stairs.sum() > _NOTABLE_SHARE * len(without_stairs):
        share = f"{without_stairs.sum()} of {len(without_stairs)} windows"
        words = f"stairs: any would count as level walking in {share}, because "
        has_pressure = np.isfinite(track.windows.climb_rate_mps).any()
        words += "pressure is missing there" if has_pressure else "there is no barometer"
        lines.append(words + " and stairs are recognised by motion only in a trouser pocket; record the pressure")
    used = [fix.nis for fix in track.fixes if fix.accepted and np.isfinite(fix.nis)]
    if used:
        fit = "about 2 if positions are consistent" if track.origin is None else "below 2 if locations are consistent"
        mean = f"mean normalised squared innovation {np.mean(used):.1f}, {fit}"
        lines.append(f"fixes: {len(used)} used ({mean})")
    sentences = problems(track)
    lines += ["where not to trust it:", *(f"- {p}" for p in sentences)] if sentences else ["no problems were found"]
    return "\n".join(lines)


def sentence(note: str) -> str:
    """Return a note as a sentence: first letter in upper case, with a full stop."""
    return f"{note[:1].upper()}{note[1:]}" + ("" if note.endswith((".", "!", "?")) else ".")


def context_durations(track: TrackRows) -> str:
    """Return the durations of the contexts of a track as text, such as "walking 30 s, upstairs 4 s"."""
    every = {**track.context_seconds(), WITHOUT_STEPS: track.seconds_without_steps}
    return ", ".join(f"{name} {seconds:.0f} s" for name, seconds in every.items() if seconds >= 0.5)


def end(track: TrackRows) -> str:
    """Return how far the end of a track with steps is from its start, and its standard deviation, as text."""
    place = f"{closure(track)} ({direction(track)})" if is_end_known(track) else closure(track)
    return f"{place}, {track.how_sure}"


def is_end_known(track: TrackRows) -> bool:
    """Return False if the direction from the start to the end is unknown, as without a gyroscope.

    It is unknown if the standard deviation at the end exceeds half of the walked distance, unless fixes or a plan give
    the position.
    """
    is_reckoned = track.n_steps > 0 and track.frame in ("start", "north")
    return not is_reckoned or float(track.position_std_m[-1]) <= 0.5 * track.distance_m


def closure(track: TrackRows) -> str:
    """Return the distance between the start and the end of a track as text, or "unknown" (`is_end_known`)."""
    if not is_end_known(track):
        return "unknown"
    return f"{np.linalg.norm(track.end_position_m - track.start_position_m):.1f} m from the start"


def direction(track: TrackRows) -> str:
    """Return how far the end of a track is east or west, and north or south of its start, as text."""
    east_m, north_m = track.end_position_m - track.start_position_m
    east, north = "west" if east_m < 0 else "east", "south" if north_m < 0 else "north"
    return f"{abs(east_m):.1f} m {east}, {abs(north_m):.1f} m {north}"


def about_weighting(track: TrackRows) -> str:
    """Return a sentence about the weighting of the contexts, which decides the step lengths."""
    how = _WEIGHTINGS.get(track.weighting, f"weighted by {track.weighting}")
    return f"Step lengths are {how}."


def about_locations(track: TrackRows, recording: Recording | None) -> str:
    """Return a sentence about how the locations of the phone became fixes, or "" if they did not."""
    if recording is None or recording.location is None or track.origin is None or track.frame == "start":
        return ""
    return (
        f"The recording has {how_many(len(recording.location), 'location')}. Errors of locations that follow each "
        f"other are alike, so that the filter takes one in {INTERVAL_S:.0f} s as a fix, and counts its accuracy as "
        f"{MIN_ACCURACY_M} m or more."
    )


def is_undecided(track: TrackRows) -> BoolArray:
    """True for steps (K,) with an uncertain context, and therefore an uncertain length."""
    return track.effective_modes > _DOUBTFUL_MODES


def rows_without_direction(track: TrackRows) -> BoolArray:
    """True for steps (K,) whose strides disagree on the walking direction, after the phone was moved."""
    since_s = np.asarray(track.steps.carried_since_s)
    first_s = min(since_s[np.isfinite(since_s)], default=np.inf)
    return criteria.is_without_direction(since_s, first_s, track.direction_trust)


def turns_at_the_ear(track: TrackRows) -> BoolArray:
    """True for steps (K,) in curves with the phone at the ear, where the head turns against the body."""
    windows = track.windows
    if not len(windows) or not track.n_steps:
        return np.zeros(track.n_steps, dtype=bool)
    duration_s = np.asarray(track.steps.duration_s)
    turned_rad = np.minimum(np.asarray(track.steps.turn_rate_radps) * duration_s, np.pi)
    turned_rad, lasted_s = (
        np.convolve(np.pad(each, _CURVE_STEPS // 2, mode="edge"), np.ones(_CURVE_STEPS), mode="valid")
        for each in (turned_rad, duration_s)
    )
    calling_prob = windows.carrying_prob[:, windows.carrying_modes.index("calling")]
    is_calling = np.interp(track.time_s, windows.time_s, calling_prob) > 0.5
    return is_calling & (turned_rad > _CURVE_RADPS * lasted_s)


def _is_without_stairs(track: TrackRows) -> BoolArray:
    """True for windows (W,) with walking in which stairs could not be distinguished from level walking.

    Of a recording with a barometer, these are windows in a gap of at least `_MIN_DOUBT_S` without pressure.
    """
    windows = track.windows
    without_pressure = np.isnan(windows.climb_rate_mps)
    if not without_pressure.all():
        gaps = long_stretches(windows.time_s, without_pressure)
        in_gap = [(windows.time_s >= a) & (windows.time_s <= b) for a, b in gaps]
        without_pressure &= np.any(in_gap, axis=0) if gaps else False
    running_prob = windows.context_prob[:, [name == "running" for name in windows.contexts]].sum(axis=1)
    is_walking = criteria.is_moving(windows.standing_prob + running_prob)
    return (windows.stairs_unknown_share > 0.5) & without_pressure & is_walking


def _doubts_about_windows(track: TrackRows) -> list[str]:
    """Return sentences about motion that the windows show, such as rides and a handled phone."""
    windows = track.windows
    if not len(windows):
        return []
    moves = criteria.is_moving(windows.standing_prob)
    rides = [(a, b) for a, b in _stretches(windows.time_s, moves & ~_has_step(track)) if b - a >= _MIN_RIDE_S]
    handled = criteria.is_handled(windows.irregular_prob, windows.standing_prob)
    unfamiliar = criteria.is_unfamiliar(windows.unknown_share)
    return [
        *([f"The phone did not move: {criteria.NO_STEPS}."] if track.n_steps == 0 and not moves.any() else ()),
        *_with_times(rides, criteria.STEPLESS),
        *_with_times(long_stretches(windows.time_s, handled), criteria.HANDLED),
        *_with_times(long_stretches(windows.time_s, unfamiliar), criteria.UNFAMILIAR),
    ]


def _doubts_about_steps(track: TrackRows) -> list[str]:
    """Return sentences about steps with an uncertain length or direction, and about pauses and jumps."""
    on_the_spot = criteria.is_on_the_spot(track.is_quick_and_soft, track.direction_trust)
    in_standing = criteria.is_in_standing(track.context_prob, track.windows.standing_index)
    without_rate = np.asarray(track.steps.heading_unknown_s) > 0.5 * np.asarray(track.steps.duration_s)
    return [
        *_undecided_modes(track),
        *_with_times(long_stretches(track.time_s, in_standing), criteria.IN_STANDING),
        *_with_times(long_stretches(track.time_s, rows_without_direction(track)), criteria.NO_DIRECTION),
        *_with_times(long_stretches(track.time_s, on_the_spot), criteria.QUICK_AND_SOFT),
        *_with_times(long_stretches(track.time_s, turns_at_the_ear(track)), _AT_THE_EAR),
        *_with_times(long_stretches(track.time_s, without_rate), _WITHOUT_ANGULAR_RATE),
        *_pauses(track),
        *_jumps(track),
    ]


def _undecided_modes(track: TrackRows) -> list[str]:
    """Return one sentence for each stretch of at least `_MIN_DOUBT_S` seconds with two or more probable modes."""
    return [
        f"From {a:.0f} to {b:.0f} s the filter cannot decide between {_top_modes(track, a, b)}, whose step lengths "
        "differ: the distance is uncertain there."
        for a, b in long_stretches(track.time_s, is_undecided(track))
    ]


def _pauses(track: TrackRows) -> list[str]:
    """Return one sentence for each time between two steps of more than `_LONG_PAUSE_S` seconds."""
    return [
        f"Between {a:.0f} and {b:.0f} s there are no steps for {b - a:.0f} s (a rest, or a gap in the samples): "
        "the track continues at the same position."
        for a, b in zip(track.time_s[:-1], track.time_s[1:], strict=True)
        if b - a > _LONG_PAUSE_S
    ]


def _rejected_fixes(track: TrackRows) -> list[str]:
    """Return one sentence with the times of the rejected fixes, of which the first `_MAX_TIMES` are listed."""
    rejected = [fix for fix in track.fixes if fix.outcome == "rejected"]
    if not rejected:
        return []
    times = [*(f"{fix.time_s:.0f}" for fix in rejected[:_MAX_TIMES]), *(["..."] if len(rejected) > _MAX_TIMES else [])]
    share = f"{len(rejected)} of {len(track.fixes)} fixes do"
    return [f"{share} {criteria.REJECTED} and were not used: at {', '.join(times)} s."]


def _has_step(track: TrackRows) -> BoolArray:
    """True for windows (W,) with the end of a step within three seconds of the middle of the window."""
    middle = track.windows.time_s - 1.0
    first, last = np.searchsorted(track.time_s, middle - 3.0), np.searchsorted(track.time_s, middle + 3.0)
    return last > first


def _stretches(time_s: FloatArray, holds: BoolArray) -> list[tuple[float, float]]:
    """Return begin and end of the stretches in which a condition holds. A single exception does not end a stretch."""
    if len(holds) > 2:
        holds = holds | (np.concatenate([[False], holds[:-1]]) & np.concatenate([holds[1:], [False]]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds, [0]]).astype(int)))
    return [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges.reshape(-1, 2)]


def long_stretches(time_s: FloatArray, holds: BoolArray) -> list[tuple[float, float]]:
    """Return begin and end, s, of the stretches of at least `_MIN_DOUBT_S` in which a condition holds."""
    return [(a, b) for a, b in _stretches(time_s, holds) if b - a >= _MIN_DOUBT_S]


def _with_times(stretches: list[tuple[float, float]], words: str) -> list[str]:
    """Return one sentence with the times of all stretches, of which the first `_MAX_TIMES` are listed."""
    if not stretches:
        return []
    times = _first_times([f"from {a:.0f} to {b:.0f} s" for a, b in stretches])
    every = " and ".join([", ".join(times[:-1]), times[-1]] if len(times) > 1 else times)
    return [f"{every[:1].upper()}{every[1:]} {words}."]


def _first_times(times: list[str]) -> list[str]:
    """Return the first `_MAX_TIMES` times, and the number of the others."""
    n_more = len(times) - _MAX_TIMES
    return [*times[:_MAX_TIMES], how_many(n_more, "time", "times") + " more"] if n_more > 0 else times


def _jumps(track: TrackRows) -> list[str]:
    """Return one sentence about the steps at which the filter corrected the position of the whole earlier path.

    Corrections of more than `_JUMP_M` besides the step itself are reported. Tracks with fixes or a floor plan are not
    checked, because these may move the track.
    """
    if track.fixes or track.plan is not None:
        return []
    with np.errstate(invalid="ignore", over="ignore"):  # a track read from a file may contain any values
        moved_m = np.hypot(*np.diff(track.position_m, axis=0).T)
    late = np.flatnonzero((moved_m > track.step_length_m[1:] + _JUMP_M) & (moved_m < FARTHEST_M))
    if not len(late):
        return []
    each = _first_times([f"{moved_m[i]:.0f} m at {track.time_s[i + 1]:.0f} s" for i in late])
    return [f"The track jumps ({', '.join(each)}), {criteria.LATE}."]


def _top_modes(track: TrackRows, start_s: float, end_s: float) -> str:
    inside = (track.time_s >= start_s) & (track.time_s <= end_s)
    prob = track.mode_prob[inside].mean(axis=0)
    best = np.argsort(prob)[::-1][:2]
    return " and ".join(track.modes[i] for i in best)
