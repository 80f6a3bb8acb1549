"""Observations of a walk other than its steps: fixes, loop closures, known headings and floor changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pdr_filter.sensing.clock import on_track_clock
from pdr_filter.values import BoolArray, HeadingFix, Measurement, PositionFix, SpeedFix, are_numbers, check_number
from pdr_filter.values.recording import Recording

# Observations with a common clock: the given fixes, and the locations of the recording.
Source = Literal["fixes", "locations"]

OUTSIDE_S = 1.0  # fixes up to this far outside the samples are moved to the ends, because clocks are not more accurate


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Pair of times at which the pedestrian was at the same place.

    Attributes
    ----------
    first_s : float
        First time, in s.
    second_s : float
        Second time, after the first.
    std_m : float, default 0.5
        Standard deviation of the distance between the two positions along each axis, in m.

    Raises
    ------
    ValueError
        If the times are not finite and increasing, or `std_m` is not positive.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.offline.smoothing.observations import LoopClosure
    >>> walk = pdr.simulate.demo_walk()
    >>> smoothed = pdr.smooth(walk, loop_closures=[LoopClosure(2.0, 110.0)])
    >>> smoothed.observations.kind.tolist()
    ['loop closure']
    """

    first_s: float
    second_s: float
    std_m: float = 0.5

    def __post_init__(self) -> None:
        numbers = are_numbers(self.first_s, self.second_s, self.std_m)
        if not (numbers and self.first_s < self.second_s and self.std_m > 0):
            raise ValueError(f"a loop closure must have finite first_s < second_s and std_m > 0, got {self}")


# Shortest distance walked between the two times of an informative loop closure: this many of its standard deviations,
# and a few steps, because each time is moved to the nearest contact. On a shorter path the pedestrian is near in any
# case.
_CLOSURE_STDS, _CLOSURE_M = 3.0, 3.0


def is_uninformative(closure: LoopClosure, walked_m: float) -> bool:
    """True if a loop closure carries no information, because the distance walked between its times is too short.

    The limit of `walked_m` is 3 m or three standard deviations of the closure, whichever is longer.
    """
    return walked_m <= max(_CLOSURE_STDS * closure.std_m, _CLOSURE_M)


@dataclass(frozen=True, slots=True)
class KnownHeading:
    """Known direction, in the frame of the fixes, from the position at one time to that at another, as of a corridor.

    Attributes
    ----------
    start_s : float
        First time, in s.
    end_s : float
        Second time, after the first.
    heading_rad : float
        Direction in rad, clockwise from north of the frame of the fixes.
    std_rad : float, default 0.05
        Standard deviation of the direction.

    Raises
    ------
    ValueError
        If the numbers are not finite, the times do not increase, or `std_rad` is not positive.

    Examples
    --------
    >>> from pdr_filter.offline.smoothing.observations import KnownHeading
    >>> corridor = KnownHeading(start_s=10.0, end_s=25.0, heading_rad=1.57)
    >>> corridor.std_rad
    0.05
    """

    start_s: float
    end_s: float
    heading_rad: float
    std_rad: float = 0.05

    def __post_init__(self) -> None:
        numbers = are_numbers(self.start_s, self.end_s, self.heading_rad, self.std_rad)
        if not (numbers and self.start_s < self.end_s and self.std_rad > 0):
            raise ValueError(f"a known heading must have finite start_s < end_s, heading and std_rad > 0, got {self}")


@dataclass(frozen=True, slots=True)
class FloorChange:
    """Time from which the pedestrian is on another storey.

    The storey is copied to the result. It has no influence on the positions.

    Attributes
    ----------
    time_s : float
        Time of the change, in s.
    floor : int
        Number of the storey, 0 for the ground floor.

    Examples
    --------
    >>> from pdr_filter.offline.smoothing.observations import FloorChange
    >>> FloorChange(time_s=60.0, floor=1).floor
    1
    """

    time_s: float
    floor: int


@dataclass(frozen=True, slots=True)
class Observations:
    """All observations of one walk, each kind in any order."""

    # position, heading and speed fixes and other measurements
    fixes: tuple[PositionFix | HeadingFix | SpeedFix | Measurement, ...] = ()
    loop_closures: tuple[LoopClosure, ...] = ()
    known_headings: tuple[KnownHeading, ...] = ()
    floor_changes: tuple[FloorChange, ...] = ()
    locations: tuple[PositionFix, ...] = ()  # locations that the phone reported in the recording
    is_loop: bool = False  # True if the last loop closure states that the walk ended at its start

    @property
    def positions(self) -> tuple[PositionFix, ...]:
        """Position fixes among the fixes."""
        return tuple(f for f in self.fixes if isinstance(f, PositionFix))

    def earlier(self, source: Source, late_s: float) -> Observations:
        """Return the observations with the times of one source earlier by `late_s`."""
        shifted = tuple(on_track_clock(fix, -late_s) for fix in getattr(self, source))
        return replace(self, **{source: shifted})

    def fixes_inside(self, start_s: float, end_s: float) -> BoolArray:
        """Return a mask (F + L,) of the F fixes, followed by the L locations, that are within a recording.

        `start_s` and `end_s` are the ends of the recording. Up to 1 s before or after them counts as within.
        """
        return np.array([_is_inside(f.time_s, start_s, end_s) for f in (*self.fixes, *self.locations)], dtype=bool)

    def check_inside(self, start_s: float, end_s: float) -> None:
        """Raise ValueError if all fixes, a loop closure or a known heading are outside a recording with these ends."""
        times_s = [f.time_s for f in self.fixes]
        if times_s and not any(_is_inside(t, start_s, end_s) for t in times_s):
            raise ValueError(
                f"none of {len(times_s)} fixes, {min(times_s):.1f} to {max(times_s):.1f} s, "
                f"is within the recording, {start_s:.1f} to {end_s:.1f} s: check that their times are of the same clock"
            )
        closed_s = [("loop closure", k, t) for k, c in enumerate(self.loop_closures) for t in (c.first_s, c.second_s)]
        known_s = [("known heading", k, t) for k, h in enumerate(self.known_headings) for t in (h.start_s, h.end_s)]
        for what, k, time_s in (*closed_s, *known_s):
            if not _is_inside(time_s, start_s, end_s):
                raise ValueError(
                    f"{what} {k + 1} at {time_s} s is outside the recording, {start_s:.1f} to {end_s:.1f} s; give "
                    "times on the clock of the samples"
                )


def _is_inside(time_s: float, start_s: float, end_s: float) -> bool:
    return start_s - OUTSIDE_S <= time_s <= end_s + OUTSIDE_S


def check_options(
    loop: object,
    loop_closures: object,
    start_heading_std_rad: float | None,
    anchor_interval_s: float,
) -> None:
    """Raise ValueError if an option of `smooth` is of the wrong type or out of range.

    `start_heading_std_rad` may be None.
    """
    if not isinstance(loop, bool):
        raise ValueError(f"loop must be True or False, got {loop!r}: give known places as loop_closures")
    if isinstance(loop_closures, str) and loop_closures != "wifi":
        raise ValueError(f'loop_closures must be a sequence of LoopClosure or "wifi", got {loop_closures!r}')
    if start_heading_std_rad is not None:
        remedy = "no heading is known exactly; give 0.01 for a surveyed direction, or omit it"
        check_number("start_heading_std_rad", start_heading_std_rad, 1e-6, 1e3, remedy)
    check_number("anchor_interval_s", anchor_interval_s, 1e-6, 1e6, "10 is usual; or omit it")


def waypoint_fixes(recording: Recording, std_m: float = 1.0) -> list[PositionFix]:
    """Return the surveyed waypoints of a recording as position fixes.

    Parameters
    ----------
    recording : Recording
        A recording with `truth.waypoints`.
    std_m : float, default 1.0
        Standard deviation of a waypoint along each axis, in m.

    Returns
    -------
    list of PositionFix
        One fix per waypoint.

    Raises
    ------
    ValueError
        If the recording has no waypoints, or their times decrease.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.offline.smoothing.observations import waypoint_fixes
    >>> fixes = waypoint_fixes(pdr.simulate.demo_walk())
    >>> len(fixes) > 2, float(fixes[0].cov_m2[0, 0])
    (True, 1.0)
    """
    points = recording.truth.waypoints
    if points is None:
        raise ValueError(f"{recording.name or 'the recording'} has no waypoints; give fixes, loop closures or a track")
    back = np.flatnonzero(np.diff(points.time_s) < 0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(
            f"waypoints must be in the order of their times: waypoint {k + 1} of {len(points)}, at "
            f"{points.time_s[k]} s, comes after one at {points.time_s[k - 1]} s; correct the times, or sort rows whose "
            "times are right"
        )
    cov = std_m**2 * np.eye(2)
    return [PositionFix(float(p.time_s), np.array([p.east_m, p.north_m]), cov) for p in points]
