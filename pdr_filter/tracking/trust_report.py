"""Where a track should not be trusted, in plain words: what `Track.report` prints."""

from __future__ import annotations

import numpy as np

from pdr_filter.tracking import step_statistics as doubtful
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, TrackRows, how_many

# Doubts that notes have too, with the number of windows, steps or fixes in place of their times.
_OF_NOTES = (
    doubtful.NO_STEPS,
    doubtful.STEPLESS,
    doubtful.HANDLED,
    doubtful.UNFAMILIAR,
    doubtful.NO_DIRECTION,
    doubtful.QUICK_AND_SOFT,
    doubtful.LATE,
    doubtful.REJECTED,
)
# A head looks around, and a bag dangles.
_LOOSE = [CARRYING_MODES.index(mode) for mode in ("calling", "bag")]
# Shorter doubts are ordinary: a turn, a door.
_MIN_DOUBT_S = 5.0
# So long a movement without a step is no walk: people take one every two seconds.
_MIN_RIDE_S = 20.0
# Stretches of one kind whose times are said.
_MAX_TIMES = 8
# A track without fixes that goes so much further than its step was led anew: of 72 real walks none did by 2 m.
_JUMP_M = 3.0
# Nobody walks round the Earth: what is further away is nonsense that would make a dot of all else.
FARTHEST_M = 4e7
# Two modes that are as probable as each other count as doubt.
_DOUBTFUL_MODES = 1.9


def doubts(track: TrackRows) -> list[str]:
    """Sentences about the stretches of a track that mean little, each with its times; empty if there are none."""
    windows = track.windows
    sentences: list[str] = []
    if len(windows):
        moves = doubtful.is_moving(windows.standing_prob)
        stepless = moves & ~_has_step(track)
        if track.n_steps == 0 and not moves.any():
            sentences.append(f"The phone did not move: {doubtful.NO_STEPS}.")
        rides = [(a, b) for a, b in _stretches(windows.time_s, stepless) if b - a >= _MIN_RIDE_S]
        sentences += _said(rides, doubtful.STEPLESS)
        handled = doubtful.is_handled(windows.irregular_prob, windows.standing_prob)
        sentences += _said(_long(windows.time_s, handled), doubtful.HANDLED)
        unfamiliar = doubtful.is_unfamiliar(windows.unknown_share)
        sentences += _said(_long(windows.time_s, unfamiliar), doubtful.UNFAMILIAR)
    if track.n_steps:
        undecided = track.effective_modes > _DOUBTFUL_MODES
        sentences += [
            f"From {a:.0f} to {b:.0f} s the filter hesitates between {_names(track, a, b)}: their step lengths differ."
            for a, b in _long(track.time_s, undecided)
        ]
        without_direction = doubtful.is_without_direction(track.steps.shown_offset_std_rad, track.direction_trust)
        sentences += _said(_long(track.time_s, without_direction), doubtful.NO_DIRECTION)
        sentences += _said(_long(track.time_s, track.is_quick_and_soft), doubtful.QUICK_AND_SOFT)
        sentences += _said(
            _long(windows.time_s, is_loose(track)),
            "the phone is held as at the ear, or dangles as in a bag: if it turns against the body without a tilt, the "
            "track turns with it",
        )
        blind = np.asarray(track.steps.heading_unknown_s) > 0.5 * np.asarray(track.steps.duration_s)
        sentences += _said(_long(track.time_s, blind), "there is no angular rate: the direction of the walk is unknown")
        sentences += [
            f"Between {a:.0f} and {b:.0f} s there is nothing for {b - a:.0f} s: a rest, or a gap in the samples; the "
            "track goes on where it was."
            for a, b in zip(track.time_s[:-1], track.time_s[1:], strict=True)
            if b - a > 60.0
        ]
        sentences += _jumps(track)
    rejected = [fix for fix in track.fixes if fix.outcome == "rejected"]
    if rejected:
        times = ", ".join(f"{fix.time_s:.0f}" for fix in rejected[:_MAX_TIMES])
        times += ", ..." if len(rejected) > _MAX_TIMES else ""
        share = f"{len(rejected)} of {len(track.fixes)} fixes do"
        sentences.append(f"{share} {doubtful.REJECTED} and were not used: at {times} s.")
    return sentences


def problems(track: TrackRows) -> list[str]:
    """Sentences about all that is doubtful: the doubts with their times, and the notes on anything else."""
    told = doubts(track)
    words = [w for w in _OF_NOTES if any(w in sentence for sentence in told)]
    return [*told, *(sentence(note) for note in track.notes if not any(w in note for w in words))]


def report(track: TrackRows) -> str:
    """The track in a few lines: what it is, how sure it is, and where not to trust it."""
    lines = [
        f"{track.name}: {track.n_steps} steps, {track.distance_m:.1f} m in {track.duration_s:.0f} s ({track.weighting})"
    ]
    if track.n_steps:
        lines.append(f"end: {end(track)}")
        lines.append(track.about_frame)
    every = {**track.context_seconds(), "moving without steps": track.seconds_without_steps}
    seconds = {name: s for name, s in every.items() if s >= 0.5}
    if seconds:
        lines.append("contexts: " + ", ".join(f"{name} {s:.0f} s" for name, s in seconds.items()))
    used = [fix.nis for fix in track.fixes if fix.accepted and np.isfinite(fix.nis)]
    if used:
        fit = "about 2 for positions that fit" if track.origin is None else "below 2 where locations fit"
        mean = f"mean squared innovation {np.mean(used):.1f}, {fit}"
        lines.append(f"fixes: {len(used)} used ({mean})")
    said = problems(track)
    lines += ["where not to trust it:", *(f"- {p}" for p in said)] if said else ["nothing odd was seen"]
    return "\n".join(lines)


def sentence(note: str) -> str:
    """A note as a sentence."""
    return f"{note[:1].upper()}{note[1:]}" + ("" if note.endswith((".", "!", "?")) else ".")


def end(track: TrackRows) -> str:
    """Where a track with steps ends, and how sure that is."""
    east_m, north_m = track.position_m[-1]
    return f"{east_m:z.1f} m east, {north_m:z.1f} m north, {track.how_sure}"


def is_loose(track: TrackRows) -> BoolArray:
    """Windows (W,) in which the phone may turn against the body, and nothing shows it."""
    windows = track.windows
    if not len(windows):
        return np.zeros(0, dtype=bool)
    moves = doubtful.is_moving(windows.standing_prob)
    return moves & (windows.carrying_prob[:, _LOOSE].sum(axis=1) > 0.5)


def _has_step(track: TrackRows) -> BoolArray:
    """Whether a step ended within three seconds of the middle of each window."""
    middle = track.windows.time_s - 1.0
    first, last = np.searchsorted(track.time_s, middle - 3.0), np.searchsorted(track.time_s, middle + 3.0)
    return last > first


def _stretches(time_s: FloatArray, holds: BoolArray) -> list[tuple[float, float]]:
    """Begin and end of the stretches in which a condition holds; one miss does not end a stretch."""
    if len(holds) > 2:
        holds = holds | (np.concatenate([[False], holds[:-1]]) & np.concatenate([holds[1:], [False]]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds, [0]]).astype(int)))
    return [(float(time_s[a]), float(time_s[b - 1])) for a, b in edges.reshape(-1, 2)]


def _long(time_s: FloatArray, holds: BoolArray) -> list[tuple[float, float]]:
    return [(a, b) for a, b in _stretches(time_s, holds) if b - a >= _MIN_DOUBT_S]


def _said(stretches: list[tuple[float, float]], words: str) -> list[str]:
    """One sentence of all stretches, the first of them with their times."""
    if not stretches:
        return []
    times = [f"from {a:.0f} to {b:.0f} s" for a, b in stretches[:_MAX_TIMES]]
    if len(stretches) > _MAX_TIMES:
        times.append(how_many(len(stretches) - _MAX_TIMES, "time", "times") + " more")
    every = " and ".join([", ".join(times[:-1]), times[-1]] if len(times) > 1 else times)
    return [f"{every[:1].upper()}{every[1:]} {words}."]


def _jumps(track: TrackRows) -> list[str]:
    """One sentence of the steps in which the whole way before showed in another light; fixes and plans may do so."""
    if track.fixes or track.plan is not None:
        return []
    with np.errstate(invalid="ignore", over="ignore"):  # a table that was read may hold anything
        moved_m = np.hypot(*np.diff(track.position_m, axis=0).T)
    late = np.flatnonzero((moved_m > track.step_length_m[1:] + _JUMP_M) & (moved_m < FARTHEST_M))
    if not len(late):
        return []
    each = [f"{moved_m[i]:.0f} m at {track.time_s[i + 1]:.0f} s" for i in late[:_MAX_TIMES]]
    if len(late) > _MAX_TIMES:
        each.append(how_many(len(late) - _MAX_TIMES, "time", "times") + " more")
    return [f"The track jumps ({', '.join(each)}), {doubtful.LATE}."]


def _names(track: TrackRows, start_s: float, end_s: float) -> str:
    inside = (track.time_s >= start_s) & (track.time_s <= end_s)
    prob = track.mode_prob[inside].mean(axis=0)
    best = np.argsort(prob)[::-1][:2]
    return " and ".join(track.modes[i] for i in best)
