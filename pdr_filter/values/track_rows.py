"""The rows of a track: what a filter says of each step, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import cos, degrees, sin
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray, Table, pickled, read_only
from pdr_filter.values.checks import check_array
from pdr_filter.values.fixes import FixResult
from pdr_filter.values.floor_passage import FloorPassage
from pdr_filter.values.origin import Origin
from pdr_filter.values.plan import Plan
from pdr_filter.values.plan_estimate import Cluster
from pdr_filter.values.step import steps_of
from pdr_filter.values.uncertainty import worst_std_m
from pdr_filter.values.windows import Windows

_WINDOW_S = 2.0  # of the context windows
_ABOUT_STEPS = 21  # ten seconds


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackRows:
    """Where the pedestrian walked: one row for each step, positions in metres with covariance.

    Positions are in one frame, which `frame` names: that of the "start", whose origin is where the track begins and
    whose north is where the device's heading was zero; the same turned to true "north"; or that of the "fixes". Where
    few fixes leave open how the track is turned in their frame, a position is the mean over all turns, and its
    covariance says how far they differ. `about_frame` says it in words.

    `context_prob` is what the classifier said of the window, `mode_prob` what the filter made of it over time; step
    lengths come from the latter. With `imm` position and walked distance are the best estimates at their step: when the
    evidence changes from one context to another, earlier steps count differently, and both may change by more or less
    than the length of the step, which stays what was thought of it when it was made.
    """

    name: str
    time_s: FloatArray  # (K,) foot contacts
    position_m: FloatArray  # (K, 2) east, north
    position_cov_m2: FloatArray  # (K, 2, 2)
    step_length_m: FloatArray  # (K,)
    walked_m: FloatArray  # (K,) distance of all steps up to each
    walking_heading_rad: FloatArray  # (K,) clockwise from north (or from the first heading)
    step_speed_mps: FloatArray  # (K,) length over duration of each step
    step_speed_std_mps: FloatArray  # (K,)
    smoothed_speed_mps: FloatArray  # (K,) after each step, of the steps of its bout so far
    smoothed_speed_std_mps: FloatArray  # (K,)
    gap_before_s: FloatArray  # (K,) time without samples since the step before
    height_m: FloatArray  # (K,) above the start
    height_std_m: FloatArray  # (K,)
    floor: IntArray  # (K,) the storey: from that of the start, which is 0, or as a fix has named it
    context_prob: FloatArray  # (K, C)
    contexts: tuple[str, ...]
    mode_prob: FloatArray  # (K, M)
    modes: tuple[str, ...]
    mode_contexts: tuple[str, ...]  # M, of each mode
    steps: Table  # (K,) rows of Step
    windows: Windows
    start_time_s: float
    duration_s: float
    weighting: str
    notes: tuple[str, ...] = field(default=())  # what was odd about it, in plain words
    fixes: tuple[FixResult, ...] = field(default=())
    floor_passages: tuple[FloorPassage, ...] = field(default=())  # see `floor_changes`
    start_position_m: FloatArray = field(default_factory=lambda: read_only(np.zeros(2)))  # (2,) before the first step
    frame: str = "start"  # of positions and headings: "start", "north", "fixes" or "plan"
    origin: Origin | None = None  # where on Earth its zero is, if the recording's own locations or somebody said it
    plan: Plan | None = None  # that kept it where people can walk
    # (K,) with a plan: where the walk may be after each step, the most probable place first; none before its start
    clusters: tuple[tuple[Cluster, ...], ...] = ()
    is_smoothed: bool = False  # whether each row is estimated from the whole recording, not from what came before it
    effective_sample_size: FloatArray = field(default_factory=lambda: read_only(np.zeros(0)))  # (K,) of its particles

    __reduce__ = pickled

    def __repr__(self) -> str:
        return f"Track({self.name!r}, {self.n_steps} steps, {self.distance_m:.1f} m, {self.weighting})"

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.time_s)

    @property
    def distance_m(self) -> float:
        """Walked distance after the last step; with `imm` not quite the sum of the step lengths, see `walked_m`."""
        return float(self.walked_m[-1]) if self.n_steps else 0.0

    @property
    def position_std_m(self) -> FloatArray:
        """Standard deviation of each position in the worst direction, shape (K,).

        Reports, tables and summaries say it of the end. The ellipses that `plot` draws hold 95 %: 2.45 times as long.
        """
        return worst_std_m(self.position_cov_m2)

    @property
    def end_position_m(self) -> FloatArray:
        """Where it ends, (2,): where it starts if there is no step."""
        return self.position_m[-1] if self.n_steps else self.start_position_m

    @property
    def how_sure(self) -> str:
        """`position_std_m` of the end, in the words of all reports."""
        if not self.n_steps:
            return "no step, no position"
        return f"± {self.position_std_m[-1]:.1f} m (one standard deviation, worst direction)"

    @property
    def latitude_deg(self) -> FloatArray:
        """Latitude of each step on WGS 84, shape (K,); ValueError if the track has no `origin`."""
        return self.latitude_longitude_deg(self.position_m)[0]

    @property
    def longitude_deg(self) -> FloatArray:
        """Longitude of each step, shape (K,); ValueError if the track has no `origin`."""
        return self.latitude_longitude_deg(self.position_m)[1]

    @property
    def altitude_m(self) -> FloatArray | None:
        """Altitude of each step, shape (K,), as `origin` counts; None if it says none."""
        return None if self.origin is None or self.origin.height_m is None else self.origin.height_m + self.height_m

    def latitude_longitude_deg(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitudes and longitudes (...) of positions (..., 2) in its frame; ValueError if it has no `origin`."""
        if self.origin is None:
            raise ValueError(
                f"no location says where on Earth the track {self.name!r} is: give origin=(latitude_deg, "
                "longitude_deg), or the recording a location stream; to_local_geojson writes its shape without a place"
            )
        return self.origin.latitude_longitude_deg(position_m)

    @property
    def knows_north(self) -> bool:
        """Whether its north is true north, as locations or somebody said it."""
        return self.frame == "north" or (self.frame in ("fixes", "plan") and self.origin is not None)

    def turned(self, turn_rad: float, std_rad: float | None = None) -> Self:
        """The same turned clockwise about its zero, so that its north is true north.

        `turn_rad` is the true heading of what was its north: for a track in the frame of the start, the direction in
        which the person first walked. Its error turns the whole track: P' = R P R' + std^2 g g', g = (north, -east).
        ValueError for a track that a floor plan has placed.
        """
        check_array("turn_rad", turn_rad)
        check_array("std_rad", std_rad or 0.0, "0 or more")
        if self.plan is not None:
            raise ValueError(
                f"{self.name!r} lies in the frame of its floor plan, got a turn of {turn_rad} rad: read the plan in "
                "longitude and latitude, or with its origin, so that its north is true north"
            )
        if self.knows_north:
            raise ValueError(
                f"the north of {self.name!r} is true north already, got a turn of {turn_rad} rad: leave it out"
            )
        rotation = np.array([[cos(turn_rad), sin(turn_rad)], [-sin(turn_rad), cos(turn_rad)]])
        position_m = self.position_m @ rotation.T
        g = (std_rad or 0.0) * np.stack([position_m[:, 1], -position_m[:, 0]], axis=1)
        return replace(
            self,
            position_m=read_only(position_m),
            position_cov_m2=read_only(rotation @ self.position_cov_m2 @ rotation.T + g[:, :, None] * g[:, None, :]),
            walking_heading_rad=read_only(wrap_angle(self.walking_heading_rad + turn_rad)),
            start_position_m=read_only(rotation @ self.start_position_m),
            fixes=tuple(f.turned(rotation) for f in self.fixes),
            frame="north",
            origin=self.origin and replace(self.origin, turn_rad=turn_rad, turn_std_rad=std_rad),
        )

    def placed(self, origin: Origin | tuple[float, float]) -> Self:
        """The same with its zero at a place on Earth, an Origin or (latitude_deg, longitude_deg).

        A track in the frame of its start is `turned` by the turn of the origin, if it has one, and its covariance grows
        by what the origin says of its standard deviations. One in the frame of fixes stays as it is.
        """
        here = Origin.of(origin)
        if self.frame in ("fixes", "plan"):
            return replace(self, origin=here)
        turned = self
        if here.turn_rad is not None and self.frame == "start":
            turned = self.turned(here.turn_rad, here.turn_std_rad)
        var_m2 = (here.position_std_m or 0.0) ** 2 if self.origin is None else 0.0
        return replace(turned, origin=here, position_cov_m2=read_only(turned.position_cov_m2 + var_m2 * np.eye(2)))

    @property
    def anchors_m(self) -> FloatArray:
        """East and north (A, 2) of the anchors whose ranges were used, each once, in the frame of the track."""
        return np.array(sorted({f.anchor_m for f in self.fixes if f.anchor_m is not None and f.accepted})).reshape(
            -1, 2
        )

    @property
    def about_frame(self) -> str:
        """Where its zero is and what its north is, in words."""
        place, sure = self.origin, ""
        at = "" if place is None else f" at {place.latitude_deg:.6f}, {place.longitude_deg:.6f}"
        if place is not None and place.turn_std_rad is not None:
            sure = f", ± {min(degrees(place.turn_std_rad), 180.0):.0f} degrees"
        if self.frame == "north":
            zero = "the origin of the fixes" if self.start_position_m.any() else "the start of the walk"
            return f"East and north are metres from {zero}{at}; north is true north as it was given or measured{sure}."
        if self.frame == "plan":
            return f"East and north are metres in the frame of the floor plan{at and f', whose zero is{at}'}."
        if self.frame == "fixes" and sure:
            return f"East and north are metres from the first location{at}; locations turned it to true north{sure}."
        if self.frame == "fixes":
            return f"East and north are metres in the frame of the fixes{at and f', whose origin is{at}'}."
        words = f"East and north are metres from the start of the walk{at}; north is the direction of the first heading"
        return f"{words}: nothing says which way is true north."

    @property
    def estimate(self) -> str:
        """Which estimate it is: "smoothed", from the whole recording, or "online", from what came before each step."""
        return "smoothed" if self.is_smoothed else "online"

    @property
    def about_estimate(self) -> str:
        """Which estimate it is, in words."""
        if self.is_smoothed:
            return "Smoothed: each position is the best estimate from the whole recording."
        return "Online: each position is what a phone knew when the step was made."

    @property
    def is_level(self) -> bool:
        """Whether nothing says that somebody left the height of the start: by a metre and two deviations, a storey."""
        told = np.abs(self.height_m) > np.maximum(1.0, 2.0 * self.height_std_m)
        return not (told.any() or self.floor_passages or (self.floor != self.floor[:1]).any())

    @property
    def direction_trust(self) -> FloatArray:
        """How well strides agreed on where walking leads at each step, shape (K,), 0 to 1."""
        return np.asarray(self.steps.direction_trust)

    @property
    def is_quick_and_soft(self) -> BoolArray:
        """Where most of the steps about each are (`Step.is_quick_and_soft`), shape (K,)."""
        each = np.array([step.is_quick_and_soft for step in steps_of(self.steps)], dtype=int)
        if not self.n_steps:
            return each > 0
        number = np.convolve(np.pad(each, _ABOUT_STEPS // 2, mode="edge"), np.ones(_ABOUT_STEPS, int), mode="valid")
        return 2 * number > _ABOUT_STEPS

    @property
    def heading_source(self) -> tuple[str, ...]:
        """What led the track at each step: "axes" of a building, "strides" that agree, or the "device" alone."""
        return tuple(step.heading_source for step in steps_of(self.steps))

    @property
    def mode_entropy(self) -> FloatArray:
        """Entropy of the mode probabilities after each step, shape (K,), nats: 0 where one mode is certain."""
        p = self.mode_prob
        return -(p * np.log(p, where=p > 0, out=np.zeros_like(p))).sum(axis=1)

    @property
    def effective_modes(self) -> FloatArray:
        """Number of modes that are as good as alive after each step, shape (K,): e to the entropy, 1 to M."""
        return np.exp(self.mode_entropy)

    def speed_mps(self, t: ArrayLike) -> FloatArray:
        """Walking speed at times t, m/s, same shape as t: step length over duration during a step, else zero.

        NaN where t is.
        """
        at = np.asarray(t, dtype=float)
        if self.n_steps == 0:
            return np.where(np.isnan(at), at, 0.0)
        index = np.searchsorted(self.time_s, at)  # the first contact at or after t ends the step that t is in
        inside = np.minimum(index, self.n_steps - 1)
        duration = np.asarray(self.steps.duration_s)[inside]
        walking = (index < self.n_steps) & (at >= self.time_s[inside] - duration)
        return np.where(walking, self.step_length_m[inside] / duration, np.where(np.isnan(at), at, 0.0))

    def floor_changes(self) -> list[FloorPassage]:
        """When the pedestrian went from one storey to another, and how, in order."""
        return list(self.floor_passages)

    def context_seconds(self) -> dict[str, float]:
        """Seconds spent in each context: every window votes for its most probable one.

        A window with motion but without a step is none of them: see `seconds_without_steps`.
        """
        seconds, best, walked = self._of_windows()
        return {name: float(seconds[walked & (best == c)].sum()) for c, name in enumerate(self.contexts)}

    @property
    def seconds_without_steps(self) -> float:
        """Seconds that the classifier takes for a way of walking though nobody stepped: a vehicle, a busy hand."""
        seconds, _, walked = self._of_windows()
        return float(seconds[~walked].sum())

    def _of_windows(self) -> tuple[FloatArray, IntArray, BoolArray]:
        """Seconds (W,) that each window stands for, its most probable context, and whether that agrees with steps."""
        end_s = self.windows.time_s
        starts = np.concatenate([[self.start_time_s], end_s[:-1]])
        seconds = np.minimum(end_s - starts, _WINDOW_S)  # the first window, or the first after a gap, is as long
        best = self.windows.context_prob.argmax(axis=1)
        # half a step more on each side: contacts of slow steps are a second apart
        first, last = (np.searchsorted(self.time_s, t) for t in (end_s - _WINDOW_S - 0.5, end_s + 0.5))
        return seconds[: len(end_s)], best, (last > first) | np.isin(best, self.windows.standing_index)

    def summary(self) -> dict[str, Any]:
        """What `pdr-filter track --json` prints: name, n_steps, distance_m, duration_s, end, contexts and more."""
        end = self.end_position_m
        place: dict[str, float] = {}
        if self.origin is not None:
            latitude_deg, longitude_deg = self.latitude_longitude_deg(end)
            place = {
                "end_latitude_deg": round(float(latitude_deg), 7),
                "end_longitude_deg": round(float(longitude_deg), 7),
            }
        height: dict[str, float] = {}
        if not self.is_level:
            height = {
                "end_height_m": round(float(self.height_m[-1]), 3),
                "end_height_std_m": round(float(self.height_std_m[-1]), 3),
                "end_floor": int(self.floor[-1]),
            }
        return {
            "name": self.name,
            "n_steps": self.n_steps,
            "distance_m": round(self.distance_m, 3),
            "duration_s": round(self.duration_s, 3),
            "end_east_m": round(float(end[0]), 3),
            "end_north_m": round(float(end[1]), 3),
            "end_std_m": round(float(self.position_std_m[-1]), 3) if self.n_steps else None,
            "estimate": self.estimate,
            "frame": self.frame,
            **place,
            **height,
            "contexts": {name: round(seconds, 1) for name, seconds in self.context_seconds().items()},
            "moving_without_steps_s": round(self.seconds_without_steps, 1),
            "notes": list(self.notes),
        }
