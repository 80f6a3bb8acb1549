"""Where a track should not be trusted, in plain words: what `Track.report` prints."""

from __future__ import annotations

import numpy as np

from pdr_filter.values import CARRYING_MODES, HARDLY_AGREE, BoolArray, FloatArray, TrackRows, how_many

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
        moves = windows.standing_prob < 0.5
        stepless = moves & ~_has_step(track)
        if track.n_steps == 0 and not moves.any():
            sentences.append("The phone did not move: there is no walk to reckon.")
        rides = [(a, b) for a, b in _stretches(windows.time_s, stepless) if b - a >= _MIN_RIDE_S]
        sentences += _said(
            rides,
            "the phone moved without steps, as in a vehicle or a lift: dead reckoning does not apply, and the track "
            "stands still there.",
        )
        handled = _long(windows.time_s, moves & (windows.irregular_prob > 0.5))
        sentences += _said(handled, "the phone was handled, not carried: steps there may be false or lost.")
        sentences += _said(
            _long(windows.time_s, windows.unknown_share > 0.5),
            "the motion is unlike all that the classifier was trained on: its contexts, and the step lengths that "
            "follow from them, are guesses.",
        )
    if track.n_steps:
        undecided = track.effective_modes > _DOUBTFUL_MODES
        sentences += [
            f"From {a:.0f} to {b:.0f} s the filter hesitates between {_names(track, a, b)}: their step lengths differ."
            for a, b in _long(track.time_s, undecided)
        ]
        is_shown = np.isfinite(np.asarray(track.steps.shown_offset_std_rad))
        sentences += _said(
            _long(track.time_s, is_shown & (track.direction_trust < HARDLY_AGREE)),
            "strides do not agree on where walking leads, as in a bag: the turn of the phone alone leads the track, "
            "and where the phone was turned against the body the track has turned too.",
        )
        sentences += _said(
            _long(track.time_s, track.is_quick_and_soft),
            "steps are as quick as running and as soft as walking, as on the spot: how long they are, and where they "
            "lead, is unsure.",
        )
        sentences += _said(
            _long(windows.time_s, is_loose(track)),
            "the phone is held as at the ear, or dangles as in a bag: if it turns against the body without a tilt, the "
            "track turns with it.",
        )
        blind = np.asarray(track.steps.heading_unknown_s) > 0.5 * np.asarray(track.steps.duration_s)
        sentences += _said(
            _long(track.time_s, blind), "there is no angular rate: the direction of the walk is unknown."
        )
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
        sentences.append(
            f"{len(rejected)} of {len(track.fixes)} fixes do not fit the track or its time and were not used: "
            f"at {times} s."
        )
    return sentences


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
    problems = [*doubts(track), *map(sentence, track.notes)]
    lines += ["where not to trust it:", *(f"- {p}" for p in problems)] if problems else ["nothing odd was seen"]
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
    moves = windows.standing_prob < 0.5
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
    return [f"{every[:1].upper()}{every[1:]} {words}"]


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
    return [
        f"The track jumps ({', '.join(each)}): how the heading drifts showed late, and places before are as they were "
        "believed then; `smooth` corrects them."
    ]


def _names(track: TrackRows, start_s: float, end_s: float) -> str:
    inside = (track.time_s >= start_s) & (track.time_s <= end_s)
    prob = track.mode_prob[inside].mean(axis=0)
    best = np.argsort(prob)[::-1][:2]
    return " and ".join(track.modes[i] for i in best)
