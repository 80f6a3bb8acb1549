"""What is known of a walk besides its steps: position fixes, loop closures, known headings, floor changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import BoolArray, HeadingFix, Measurement, PositionFix, SpeedFix, are_numbers, check_number
from pdr_filter.values.recording import Recording

_OUTSIDE_S = 1.0  # fixes so far outside the samples still count as at their ends: clocks are not better than that


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Two times at which the pedestrian was at the same place, within `std_m` along each axis."""

    first_s: float
    second_s: float
    std_m: float = 0.5

    def __post_init__(self) -> None:
        numbers = are_numbers(self.first_s, self.second_s, self.std_m)
        if not (numbers and self.first_s < self.second_s and self.std_m > 0):
            raise ValueError(f"a loop closure needs first_s < second_s and std_m > 0, got {self}")


# Least way between the two times of a loop closure: so many of its standard deviations, and a few steps, since each
# time is moved to the nearest contact. On a shorter way the pedestrian is near in any case.
_CLOSURE_STDS, _CLOSURE_M = 3.0, 3.0


def says_nothing(closure: LoopClosure, walked_m: float) -> bool:
    """True if a loop closure carries no information, given the distance walked between its two times."""
    return walked_m <= max(_CLOSURE_STDS * closure.std_m, _CLOSURE_M)


@dataclass(frozen=True, slots=True)
class KnownHeading:
    """The direction from where the pedestrian was at one time to where he was at another: a corridor's.

    Clockwise from north of the frame of the fixes.
    """

    start_s: float
    end_s: float
    heading_rad: float
    std_rad: float = 0.05

    def __post_init__(self) -> None:
        numbers = are_numbers(self.start_s, self.end_s, self.heading_rad, self.std_rad)
        if not (numbers and self.start_s < self.end_s and self.std_rad > 0):
            raise ValueError(f"a known heading needs start_s < end_s, a finite heading and std_rad > 0, got {self}")


@dataclass(frozen=True, slots=True)
class FloorChange:
    """From this time on the pedestrian is on another storey; 0 is the ground floor. Carried through, not estimated."""

    time_s: float
    floor: int


@dataclass(frozen=True, slots=True)
class Observations:
    """All that was observed of one walk, each kind in any order."""

    fixes: tuple[PositionFix | HeadingFix | SpeedFix | Measurement, ...] = ()
    loop_closures: tuple[LoopClosure, ...] = ()
    known_headings: tuple[KnownHeading, ...] = ()
    floor_changes: tuple[FloorChange, ...] = ()
    locations: tuple[PositionFix, ...] = ()  # of the recording itself
    is_loop: bool = False  # whether the last loop closure is the statement that the walk ended where it began

    @property
    def positions(self) -> tuple[PositionFix, ...]:
        """The fixes of positions."""
        return tuple(f for f in self.fixes if isinstance(f, PositionFix))

    def fixes_inside(self, start_s: float, end_s: float) -> BoolArray:
        """Which fixes, then locations, are within a recording (F,).

        ValueError if there are fixes and none of them is, or if anything else than a fix or a location is not.
        """

        def is_inside(time_s: float) -> bool:
            return start_s - _OUTSIDE_S <= time_s <= end_s + _OUTSIDE_S

        times_s = [f.time_s for f in self.fixes]
        inside = np.array([is_inside(f.time_s) for f in (*self.fixes, *self.locations)], dtype=bool)
        if times_s and not inside[: len(times_s)].any():
            raise ValueError(
                f"none of {len(times_s)} fixes, {min(times_s):.1f} to {max(times_s):.1f} s, "
                f"is within the recording, {start_s:.1f} to {end_s:.1f} s: are their times of the same clock?"
            )
        closed_s = [("loop closure", k, t) for k, c in enumerate(self.loop_closures) for t in (c.first_s, c.second_s)]
        known_s = [("known heading", k, t) for k, h in enumerate(self.known_headings) for t in (h.start_s, h.end_s)]
        for what, k, time_s in (*closed_s, *known_s):
            if not is_inside(time_s):
                raise ValueError(
                    f"{what} {k + 1} at {time_s} s is outside the recording, {start_s:.1f} to {end_s:.1f} s; times are "
                    "those of the samples"
                )
        return inside


def check_options(
    loop_closures: object,
    start_heading_std_rad: float | None,
    anchor_interval_s: float,
) -> None:
    """ValueError for what `smooth` cannot use."""
    if isinstance(loop_closures, str) and loop_closures != "wifi":
        raise ValueError(f'loop_closures must be a sequence of LoopClosure or "wifi", got {loop_closures!r}')
    if start_heading_std_rad is not None:
        remedy = "no heading is known exactly; give 0.01 for a surveyed direction, or leave it out"
        check_number("start_heading_std_rad", start_heading_std_rad, 1e-6, 1e3, remedy)
    check_number("anchor_interval_s", anchor_interval_s, 1e-6, 1e6, "10 is usual; leave it out")


def waypoint_fixes(recording: Recording, std_m: float = 1.0) -> list[PositionFix]:
    """The surveyed waypoints of a recording as fixes; ValueError where they are missing or their times go back."""
    points = recording.truth.waypoints
    if points is None:
        raise ValueError(f"{recording.name or 'the recording'} has no waypoints; give fixes or loop closures")
    back = np.flatnonzero(np.diff(points.time_s) < 0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(
            f"waypoints must be in the order of their times: waypoint {k} at {points.time_s[k]} s comes after one at "
            f"{points.time_s[k - 1]} s; correct the times, or sort rows whose times are right"
        )
    cov = std_m**2 * np.eye(2)
    return [PositionFix(float(p.time_s), np.array([p.east_m, p.north_m]), cov) for p in points]
