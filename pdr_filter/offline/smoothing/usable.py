"""Which observations of a walk the smoother uses, in which form, and why it does not use the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from pdr_filter.filter.fixes.repeated_fixes import frozen_fixes
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, Mode
from pdr_filter.offline.smoothing.location_errors import by_contact, evenly_sure
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations, says_nothing
from pdr_filter.offline.smoothing.preintegration import Increments
from pdr_filter.offline.smoothing.problem import ObservedStates, mode_offsets, nearest_contact
from pdr_filter.values import (
    BoolArray,
    FloatArray,
    HeadingFix,
    IntArray,
    Measurement,
    PositionFix,
    RangeFix,
    SpeedFix,
    TrackRows,
)

# The magnetic field of so long a time is one measurement of north: twice the memory of `MagneticNorth`.
_NORTH_INTERVAL_S = 200.0


@dataclass(frozen=True, slots=True, eq=False)
class Used:
    """Observations in the form of a problem, and what became of those that were given."""

    observed: Observations  # position fixes alone, and locations, each in the order of time
    states: ObservedStates  # at numbers of steps: heading and speed fixes, then the magnetic north
    n_north: int  # of the states
    measured: tuple[Measurement, ...]  # any other measurements
    device_rad: FloatArray  # (K,) walking heading of each step less its heading offset
    row: IntArray  # of each given one among all used (positions, directions, states, measurements), -1 if it is not
    is_frozen: BoolArray  # (F + L,) fixes, then locations
    notes: tuple[str, ...]

    @property
    def knows_north(self) -> bool:
        """Whether the magnetic field says where north is."""
        return self.n_north > 0

    @property
    def has_places(self) -> bool:
        """Whether there are position fixes, locations or ranges, which may be in any frame."""
        ranges = any(isinstance(fix, RangeFix) for fix in self.measured)
        return bool(self.observed.fixes or self.observed.locations) or ranges

    @property
    def is_oriented(self) -> bool:
        """Whether anything but the phone's first heading says which way the walk went."""
        headings = len(self.states.state) and (self.states.state == HEADING_OFFSET).any()
        return bool(self.has_places or self.observed.known_headings or headings)


def usable(
    track: TrackRows,
    steps: Increments,
    modes: Sequence[Mode],
    log_scale_std: float,
    observed: Observations,
    inside: BoolArray,
) -> Used:
    """Observations that carry information; `inside` (F + L,) are fixes and locations within the recording.

    `log_scale_std` is what the track took the person's step scale for: the speeds of a track share that error.

    Loop closures of the same two contacts share one row: copies of a wrong one would confirm each other. So do
    correlated fixes at one contact.
    """
    fixes = (*observed.fixes, *observed.locations)
    is_place = np.array([isinstance(f, PositionFix) for f in fixes], dtype=bool)
    places = [f for f in fixes if isinstance(f, PositionFix)]
    is_frozen = np.zeros(len(fixes), dtype=bool)
    is_frozen[is_place] = frozen_fixes(places, track.time_s, track.position_m, track.walked_m)
    is_used = is_place & inside & ~is_frozen
    n_fixes, of_places = len(places) - len(observed.locations), is_used[is_place]
    positions, number = _at_contacts(compress(places[:n_fixes], of_places[:n_fixes]), steps)
    located = evenly_sure(list(compress(places[n_fixes:], of_places[n_fixes:])))
    locations, of_location = _at_contacts(located, steps)
    of_closure, near, closures = _closures(track, observed)
    is_state = np.array([isinstance(f, HeadingFix | SpeedFix) for f in fixes], dtype=bool)
    at_state, at_measured = np.flatnonzero(inside & is_state), np.flatnonzero(inside & ~is_place & ~is_state)
    state_fixes = [f for f in compress(fixes, inside) if isinstance(f, HeadingFix | SpeedFix)]
    other = [f for f in compress(fixes, inside) if not isinstance(f, PositionFix | HeadingFix | SpeedFix)]
    device_rad = np.asarray(track.steps.device_heading_rad) + mode_offsets(track, modes)
    of_states = _of_state_fixes(state_fixes, track, steps, device_rad, log_scale_std)
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
        ("fix", ~inside[:n_given], "outside the recording"),
        ("fix", (inside & is_frozen)[:n_given], "repeats the last position while steps go on"),
        ("location", (inside & is_frozen)[n_given:], "repeats the last position while steps go on"),
        ("loop closure", near, "its two times are so near that the way between them is within its uncertainty"),
    )
    notes = tuple(
        f"{kind} {listed(np.flatnonzero(which))}: {why}, not used" for kind, which, why in reasons if which.any()
    )
    used = replace(observed, fixes=positions, locations=locations, loop_closures=tuple(closures))
    columns = ([getattr(part, name) for part in (of_states, north)] for name in ObservedStates.__slots__)
    states = ObservedStates(*map(np.concatenate, columns))
    return Used(used, states, len(north), tuple(other), device_rad, row.astype(np.int64), is_frozen, notes)


def _at_contacts(fixes: Iterable[PositionFix], steps: Increments) -> tuple[tuple[PositionFix, ...], IntArray]:
    fixes = list(fixes)
    return by_contact(fixes, np.array([nearest_contact(steps, f.time_s)[0] for f in fixes], dtype=np.int64))


def listed(names: Sequence[object] | IntArray) -> str:
    """The first ten names, and how many there are besides."""
    shown = ", ".join(str(n) for n in names[:10])
    return shown if len(names) <= 10 else f"{shown} and {len(names) - 10} more"


def _closures(track: TrackRows, observed: Observations) -> tuple[IntArray, BoolArray, list[LoopClosure]]:
    """The number of each loop closure among those that are used, which say nothing, and those that are used."""
    closures = observed.loop_closures
    at_s = np.array([(c.first_s, c.second_s) for c in closures]).reshape(-1, 2)
    walked_m = np.diff(np.interp(at_s, track.time_s, track.walked_m), axis=1)[:, 0]
    near = np.array([says_nothing(c, d) for c, d in zip(closures, walked_m.tolist(), strict=True)], dtype=bool)
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
    """Heading and speed fixes as measurements of heading offset and log scale."""
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
    """Walking less device heading against north, as the magnetic field shows it at the last step of each interval."""
    steps = track.steps
    std = np.hypot(np.asarray(steps.north_std_rad), np.asarray(steps.shown_offset_std_rad))
    known = np.flatnonzero(np.isfinite(std))
    interval = (track.time_s[known] // _NORTH_INTERVAL_S).astype(int)
    last = known[np.append(np.diff(interval) > 0, True)] if len(known) else known
    value = (np.asarray(steps.shown_offset_rad) - np.asarray(steps.north_rad))[last]
    return ObservedStates(last + 1, np.full(len(last), HEADING_OFFSET), value, std[last])


# So well a walk is closed along each axis that ended within 1 m of its start: 86 % of such a Gaussian.
_LOOP_STD_M = 0.5


def whole_loop(track: TrackRows) -> LoopClosure | None:
    """The statement that the walk ended where it began; None if there is no step."""
    if not track.n_steps:
        return None
    begin_s = float(track.time_s[0] - track.steps.duration_s[0])
    return LoopClosure(begin_s, float(track.time_s[-1]), _LOOP_STD_M)
