"""Selection of the observations that the smoother uses, their form in the problem, and notes about the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, Mode
from pdr_filter.filter.pedestrian.frame_rotation import agreement_limit
from pdr_filter.filter.pedestrian.repeated_fixes import Repetition, repetitions
from pdr_filter.offline.smoothing.location_errors import (
    MOST_SCATTER,
    joined_at_contacts,
    scatter_of,
    with_even_variances,
    with_scatter,
)
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations, is_uninformative
from pdr_filter.offline.smoothing.preintegration import Increments
from pdr_filter.offline.smoothing.problem import ObservedStates, contacts_of, mode_offsets, nearest_contact
from pdr_filter.values import (
    MAX_NORTH_STD_RAD,
    BoolArray,
    FloatArray,
    HeadingFix,
    IntArray,
    Measurement,
    PositionFix,
    RangeFix,
    SpeedFix,
    TrackRows,
    has_position,
    reference_headings,
)

# The magnetic field during this time is one measurement of north: twice the memory of `MagneticNorth`.
_NORTH_INTERVAL_S = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class Used:
    """Observations in the form of the least-squares problem, and the use of each given observation."""

    # used position fixes (no other fixes) and locations, each in order of time, used loop closures, and known headings
    observed: Observations
    states: ObservedStates  # heading and speed fixes, followed by magnetic north, by the number of steps before them
    n_north: int  # number of `states` that are magnetic north
    measured: tuple[Measurement, ...]  # all other measurements
    device_rad: FloatArray  # (K,) walking heading of each step minus its heading offset
    # row of each given observation in the problem (positions, directions, states, measurements), -1 if it is not used.
    # The given observations are fixes, locations, loop closures and known headings, in this order.
    row: IntArray
    # "frozen" or "repeated" for fixes, followed by locations, that repeat an earlier one, else empty
    repetitions: tuple[Repetition, ...]
    notes: tuple[str, ...]  # observations that are not used, and why

    @property
    def knows_north(self) -> bool:
        """True if the magnetic field gives the direction of north."""
        return self.n_north > 0

    @property
    def has_positions(self) -> bool:
        """True if fixes or locations place the walk in their frame (`values.has_position`)."""
        return bool(self.observed.fixes or self.observed.locations) or any(map(has_position, self.measured))

    @property
    def is_oriented(self) -> bool:
        """True if an observation other than the phone's first heading may give the direction of the walk.

        Positions, locations, ranges, known headings, heading fixes and magnetic north count.
        """
        return bool(self.frame)

    @property
    def frame(self) -> str:
        """Name of the frame that the observations define (`Track.frame`), or an empty string for the start frame."""
        if self.has_positions:
            return "fixes"
        given = self.states.state[: len(self.states.state) - self.n_north]
        if self.observed.known_headings or (given == HEADING_OFFSET).any():
            return "heading fixes"
        return "north" if self.knows_north else ""


def usable(
    track: TrackRows,
    steps: Increments,
    modes: Sequence[Mode],
    log_scale_std: float,
    observed: Observations,
    inside: BoolArray,
) -> Used:
    """Return the observations that carry information: within the recording, not repeated, no uninformative closure.

    `inside` (F + L,) is a mask of the fixes and locations within the recording. `log_scale_std` is the standard
    deviation of the person's step scale in the track, an error that all speeds of the track share.

    Loop closures of the same two contacts share one row, because copies of a wrong closure would confirm each other.
    Correlated fixes at one contact share one row too.
    """
    fixes = (*observed.fixes, *observed.locations)
    is_place = np.array([isinstance(f, PositionFix) for f in fixes], dtype=bool)
    places = [f for f in fixes if isinstance(f, PositionFix)]
    repeated = tuple(repetitions(fixes, track.time_s, track.position_m, track.walked_m))
    is_frozen, is_repeated = inside & (np.array([repeated]) == np.array([["frozen"], ["repeated"]]))
    outside, inside = ~inside, inside & ~is_frozen & ~is_repeated
    is_used = is_place & inside
    n_fixes, of_places = len(places) - len(observed.locations), is_used[is_place]
    positions, number = _at_contacts(compress(places[:n_fixes], of_places[:n_fixes]), steps)
    stated = with_even_variances(list(compress(places[n_fixes:], of_places[n_fixes:])))
    scatter = scatter_of(stated, track, np.append(0, np.cumsum(steps.is_turned)))
    locations, of_location = _at_contacts(with_scatter(stated, scatter), steps)
    of_closure, near, closures = _closures(track, observed)
    is_state = np.array([isinstance(f, HeadingFix | SpeedFix) for f in fixes], dtype=bool)
    at_state, at_measured = np.flatnonzero(inside & is_state), np.flatnonzero(inside & ~is_place & ~is_state)
    other = [f for f in compress(fixes, inside) if not isinstance(f, PositionFix | HeadingFix | SpeedFix)]
    device_rad = reference_headings(track.steps) + mode_offsets(track, modes)
    state_fixes = [f for f in compress(fixes, inside) if isinstance(f, HeadingFix | SpeedFix)]
    of_states = _of_state_fixes(state_fixes, track, steps, device_rad, log_scale_std)
    # Online the gate rejects such speeds. Here many of them would agree with each other and outweigh the prior. An
    # error of the unit is one of all speeds, also of those that are too uncertain to show it.
    is_speed = of_states.state == LOG_SCALE
    is_off = is_speed & (of_states.value**2 > agreement_limit(1) * (of_states.std**2 + log_scale_std**2))
    is_off = is_speed if 2 * is_off.sum() > is_speed.sum() else is_off
    off = np.isin(np.arange(len(fixes)), at_state[is_off])
    factor = float(np.exp(np.median(of_states.value[is_off]))) if is_off.any() else 1.0
    at_state = at_state[~is_off]
    of_states = of_states.part(~is_off)
    north = _magnetic_north(track, modes)

    n_places = len(positions) + len(locations)
    n_positions = n_places + len(closures)
    n_directions = n_positions + len(observed.known_headings)
    row = np.full(len(fixes), -1)
    row[is_used] = np.concatenate([number, len(positions) + of_location])
    row[at_state] = n_directions + np.arange(len(at_state))
    row[at_measured] = n_directions + len(of_states) + len(north) + np.arange(len(at_measured))
    row = np.concatenate(
        [
            row,
            np.where(of_closure >= 0, n_places + of_closure, -1),
            n_positions + np.arange(len(observed.known_headings)),
        ]
    )
    n_given = len(observed.fixes)
    reasons = (
        ("fix", outside[:n_given], "outside the recording"),
        ("fix", is_frozen[:n_given], "repeats the last position while steps continue"),
        ("fix", is_repeated[:n_given], "repeats an earlier fix, which was delivered again"),
        (
            "fix",
            off[:n_given],
            f"the speed is {factor:.2g} times that of the steps, more than people differ; check its unit (a speed in "
            "km/h is 3.6 times as large as in m/s)",
        ),
        ("location", is_frozen[n_given:], "repeats the last position while steps continue"),
        ("loop closure", near, "the distance walked between its two times is within its uncertainty"),
    )
    notes = tuple(
        f"{kind} {name_list(np.flatnonzero(which))}: {why}, not used" for kind, which, why in reasons if which.any()
    )
    if scatter > MOST_SCATTER:
        words = f"the locations scatter about the walk by {scatter:.0f} times their stated accuracy, which the phone "
        notes = (*notes, words + "probably states too small: they are used with their scatter")
    anchors = {tuple(f.anchor_m.tolist()) if isinstance(f, RangeFix) else () for f in other if has_position(f)}
    if not n_places and len(anchors) == 1 and () not in anchors:
        words = (
            "ranges to one anchor fit the walk in any direction from it, and mirrored, so that the smoothed walk may "
        )
        notes = (*notes, words + "be wrong: give ranges to a second anchor, a position, or the heading")
    used = replace(observed, fixes=positions, locations=locations, loop_closures=tuple(closures))
    states = ObservedStates.concatenate([of_states, north])
    return Used(used, states, len(north), tuple(other), device_rad, row.astype(np.int64), repeated, notes)


def _at_contacts(fixes: Iterable[PositionFix], steps: Increments) -> tuple[tuple[PositionFix, ...], IntArray]:
    """Return the fixes with correlated ones at one contact joined, and the number of each given fix among them."""
    fixes = list(fixes)
    return joined_at_contacts(fixes, contacts_of(steps, [f.time_s for f in fixes]).step)


def name_list(names: Sequence[object] | IntArray) -> str:
    """Return the first ten names as text, followed by how many more there are."""
    shown = ", ".join(str(n) for n in names[:10])
    return shown if len(names) <= 10 else f"{shown} and {len(names) - 10} more"


def _closures(track: TrackRows, observed: Observations) -> tuple[IntArray, BoolArray, list[LoopClosure]]:
    """Return the number of each loop closure among those that are used, a mask of uninformative ones, and those used.

    The number is -1 for a closure that is not used.
    """
    closures = observed.loop_closures
    at_s = np.array([(c.first_s, c.second_s) for c in closures]).reshape(-1, 2)
    walked_m = np.diff(np.interp(at_s, track.time_s, track.walked_m), axis=1)[:, 0]
    near = np.array([is_uninformative(c, d) for c, d in zip(closures, walked_m.tolist(), strict=True)], dtype=bool)
    contacts = np.searchsorted(track.time_s, at_s)
    kept: dict[tuple[int, int], int] = {}
    number = np.full(len(closures), -1)
    for k in np.flatnonzero(~near).tolist():
        number[k] = kept.setdefault((int(contacts[k, 0]), int(contacts[k, 1])), len(kept))
    return number, near, [closures[int(np.flatnonzero(number == j)[0])] for j in range(len(kept))]


def _of_state_fixes(
    fixes: Sequence[HeadingFix | SpeedFix],
    track: TrackRows,
    steps: Increments,
    device_rad: FloatArray,
    log_scale_std: float,
) -> ObservedStates:
    """Return heading fixes as measurements of the heading offset, and speed fixes as measurements of the log scale.

    Each measurement is at the contact nearest to its fix.
    """
    rows = np.zeros((len(fixes), 4))
    for k, fix in enumerate(fixes):
        at = nearest_contact(steps, fix.time_s)[0]
        step = max(at - 1, 0)
        if isinstance(fix, HeadingFix):
            rows[k] = at, HEADING_OFFSET, fix.walking_heading_rad - device_rad[step], fix.std_rad
        else:
            speed_mps = max(float(track.smoothed_speed_mps[step]), 0.1)
            own_var = (float(track.smoothed_speed_std_mps[step]) / speed_mps) ** 2 - log_scale_std**2
            std = np.sqrt((fix.std_mps / speed_mps) ** 2 + max(own_var, 0.0))
            rows[k] = at, LOG_SCALE, np.log(fix.speed_mps / speed_mps), std
    return ObservedStates(rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2], rows[:, 3])


def _magnetic_north(track: TrackRows, modes: Sequence[Mode]) -> ObservedStates:
    """Return magnetic north as measurements of the heading offset, one for each `_NORTH_INTERVAL_S` with a known north.

    A measurement is at the last step of its interval that has a known north, if that names a direction.
    """
    steps = track.steps
    std = np.hypot(np.asarray(steps.north_std_rad), np.asarray(steps.shown_offset_std_rad))
    known = np.flatnonzero(np.isfinite(std))
    interval = (track.time_s[known] // _NORTH_INTERVAL_S).astype(int)
    last = known[np.append(np.diff(interval) > 0, True)] if len(known) else known
    last = last[std[last] <= MAX_NORTH_STD_RAD]
    value = (np.asarray(steps.shown_offset_rad) - np.asarray(steps.north_rad))[last]
    return ObservedStates(last + 1, np.full(len(last), HEADING_OFFSET), value, std[last])


# Standard deviation along each axis of the closure of a walk that ended within 1 m of its start: 86 % of such a
# Gaussian are within 1 m. Of 77 walks in a mall that end 5 m or more from their start, the test of outliers rejects the
# closure of all but one.
_LOOP_STD_M = 0.5


def start_end_closure(track: TrackRows) -> LoopClosure | None:
    """Return the loop closure between the start of the first step and the last contact, or None without steps."""
    if not track.n_steps:
        return None
    begin_s = float(track.time_s[0] - track.steps.duration_s[0])
    return LoopClosure(begin_s, float(track.time_s[-1]), _LOOP_STD_M)
