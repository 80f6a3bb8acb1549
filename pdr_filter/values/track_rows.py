"""Rows of a track: the estimates of a filter for each step, and values derived from them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import cos, degrees, sin
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray, Table, read_only, reduction
from pdr_filter.values.checks import check_array
from pdr_filter.values.fixes import FixResult
from pdr_filter.values.floor_passage import FloorPassage
from pdr_filter.values.origin import Origin
from pdr_filter.values.plan import Plan
from pdr_filter.values.plan_estimate import Cluster
from pdr_filter.values.step import steps_of
from pdr_filter.values.uncertainty import MAX_NORTH_STD_RAD, floor_prob, is_floor_unknown, worst_std_m
from pdr_filter.values.windows import Windows

_WINDOW_S = 2.0  # duration of a context window
_ABOUT_STEPS = 21  # number of steps in ten seconds, over which `is_quick_and_soft` takes the majority


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackRows:
    """Base class of `pdr_filter.Track`, whose docstring describes all fields, without files, plots and reports.

    Positions and headings are in one frame, named by `frame` and described by `about_frame`.
    """

    # K steps, C contexts, M modes. The docstring of `pdr_filter.Track` describes all fields.
    name: str
    time_s: FloatArray  # (K,)
    position_m: FloatArray  # (K, 2)
    position_cov_m2: FloatArray  # (K, 2, 2)
    step_length_m: FloatArray  # (K,)
    walked_m: FloatArray  # (K,)
    walking_heading_rad: FloatArray  # (K,)
    step_speed_mps: FloatArray  # (K,)
    step_speed_std_mps: FloatArray  # (K,)
    smoothed_speed_mps: FloatArray  # (K,)
    smoothed_speed_std_mps: FloatArray  # (K,)
    gap_before_s: FloatArray  # (K,)
    height_m: FloatArray  # (K,)
    height_std_m: FloatArray  # (K,)
    floor: IntArray  # (K,)
    context_prob: FloatArray  # (K, C)
    contexts: tuple[str, ...]  # C names
    mode_prob: FloatArray  # (K, M)
    modes: tuple[str, ...]  # M names
    mode_contexts: tuple[str, ...]  # M names
    steps: Table  # K rows
    windows: Windows
    start_time_s: float
    duration_s: float
    weighting: str
    notes: tuple[str, ...] = field(default=())
    fixes: tuple[FixResult, ...] = field(default=())
    floor_passages: tuple[FloorPassage, ...] = field(default=())
    start_position_m: FloatArray = field(default_factory=lambda: read_only(np.zeros(2)))  # (2,)
    frame: str = "start"
    origin: Origin | None = None
    plan: Plan | None = None
    clusters: tuple[tuple[Cluster, ...], ...] = ()  # K sets
    is_smoothed: bool = False
    effective_sample_size: FloatArray = field(default_factory=lambda: read_only(np.zeros(0)))  # (K,)
    phone_n_steps: FloatArray = field(default_factory=lambda: read_only(np.zeros(0)))  # (K,)
    phone_heading_rad: FloatArray = field(default_factory=lambda: read_only(np.zeros(0)))  # (K,)

    __reduce__ = reduction

    def __repr__(self) -> str:
        return f"Track({self.name!r}, {self.n_steps} steps, {self.how_far}, {self.weighting})"

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.time_s)

    @property
    def distance_m(self) -> float:
        """Walked distance after the last step, m. With "imm" it differs from the sum of the step lengths."""
        return float(self.walked_m[-1]) if self.n_steps else 0.0

    @property
    def position_std_m(self) -> FloatArray:
        """Standard deviation (K,) of each position in its least certain direction, m.

        Reports give its value at the end. The ellipses of `plot` have semi-axes of 2.45 standard deviations, and
        contain 95 %.
        """
        return worst_std_m(self.position_cov_m2)

    @property
    def end_position_m(self) -> FloatArray:
        """Last position, shape (2,), m. For a track without steps it is the start."""
        return self.position_m[-1] if self.n_steps else self.start_position_m

    @property
    def how_far(self) -> str:
        """Walked distance as text, for all reports. It is unknown if the phone moved and no step was detected."""
        if not self.n_steps and self.seconds_without_steps > 0:
            return "distance unknown"
        return f"{self.distance_m:.1f} m"

    @property
    def how_sure(self) -> str:
        """Standard deviation of the end position as text, for all reports."""
        if not self.n_steps:
            return "no step, no position"
        return f"± {self.position_std_m[-1]:.1f} m (one standard deviation, worst direction)"

    @property
    def latitude_deg(self) -> FloatArray:
        """Latitude (K,) of each step on WGS 84, degrees. ValueError if the track has no `origin`."""
        return self.latitude_longitude_deg(self.position_m)[0]

    @property
    def longitude_deg(self) -> FloatArray:
        """Longitude (K,) of each step on WGS 84, degrees. ValueError if the track has no `origin`."""
        return self.latitude_longitude_deg(self.position_m)[1]

    @property
    def altitude_m(self) -> FloatArray | None:
        """Altitude (K,) of each step, m, with the zero of `origin`. None if the origin has no height."""
        return None if self.origin is None or self.origin.height_m is None else self.origin.height_m + self.height_m

    def latitude_longitude_deg(self, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert positions in the frame of the track to geographic coordinates.

        Parameters
        ----------
        position_m : ndarray, shape (..., 2)
            East and north, m.

        Returns
        -------
        tuple of ndarray, shape (...)
            Latitude and longitude, degrees.

        Raises
        ------
        ValueError
            If the track has no `origin`.
        """
        if self.origin is None:
            raise ValueError(
                f"the geographic position of the track {self.name!r} is unknown: give origin=(latitude_deg, "
                "longitude_deg), use a recording with locations, or write its shape with to_local_geojson"
            )
        return self.origin.latitude_longitude_deg(position_m)

    @property
    def knows_north(self) -> bool:
        """True if directions are from true north, with a standard deviation of up to 45 degrees."""
        std_rad = None if self.origin is None else self.origin.turn_std_rad
        return self._has_true_axes and (std_rad is None or std_rad <= MAX_NORTH_STD_RAD)

    @property
    def _has_true_axes(self) -> bool:
        """True if the north of the frame is true north, even if the rotation of the walk in it is unknown."""
        return self.frame == "north" or (self.frame != "start" and self.origin is not None)

    def turned(self, turn_rad: float, std_rad: float | None = None) -> Self:
        """Return a copy rotated clockwise about its origin, so that its north is true north.

        Parameters
        ----------
        turn_rad : float
            True heading of the present north, rad, clockwise. For a track in the frame of the start, it is the
            heading of the person at the first sample.
        std_rad : float, optional
            Standard deviation of `turn_rad`, rad. The default is 0.

        Returns
        -------
        Track
            Rotated track, whose `frame` is "north".

        Raises
        ------
        ValueError
            If the axes of the frame are true already, or the track is in the frame of a floor plan.

        Notes
        -----
        An error of the angle rotates the whole track: P' = R P R' + std^2 g g', with g = (north, -east).
        """
        check_array("turn_rad", turn_rad)
        check_array("std_rad", std_rad or 0.0, "0 or more")
        if self._has_true_axes:
            raise ValueError(
                f"the north of {self.name!r} is already true north, got turn_rad={turn_rad}: do not rotate the track"
            )
        if self.plan is not None:
            raise ValueError(
                f"{self.name!r} is in the frame of its floor plan and cannot be rotated, got turn_rad={turn_rad}: read "
                "the plan in longitude and latitude, or with its origin, so that its north is true north"
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
        """Return a copy with a geographic origin.

        A track in the frame of its start is also rotated by `turn_rad` of the origin, if it has one. The covariance
        grows by the standard deviation of this rotation, and by that of the position if the track had no origin.
        Positions and covariances in the frame of fixes or of a plan do not change.

        Parameters
        ----------
        origin : Origin or (latitude_deg, longitude_deg)
            Geographic position of the origin of the frame.

        Returns
        -------
        Track
            Track with the origin.
        """
        new_origin = Origin.of(origin)
        if self.frame in ("fixes", "plan"):
            if self.origin is not None and new_origin.turn_rad is None:
                was = self.origin
                new_origin = replace(new_origin, turn_rad=was.turn_rad, turn_std_rad=was.turn_std_rad)
            return replace(self, origin=new_origin)
        turned = self
        if new_origin.turn_rad is not None and self.frame == "start":
            turned = self.turned(new_origin.turn_rad, new_origin.turn_std_rad)
        var_m2 = (new_origin.position_std_m or 0.0) ** 2 if self.origin is None else 0.0
        return replace(
            turned, origin=new_origin, position_cov_m2=read_only(turned.position_cov_m2 + var_m2 * np.eye(2))
        )

    @property
    def anchors_m(self) -> FloatArray:
        """East and north (A, 2) of the anchors whose ranges were used, each once, in the frame of the track."""
        return np.array(sorted({f.anchor_m for f in self.fixes if f.anchor_m is not None and f.accepted})).reshape(
            -1, 2
        )

    @property
    def about_frame(self) -> str:
        """Description of origin and north of the frame, as a sentence."""
        place, sure, turned = self.origin, "", ""
        at = "" if place is None else f" at {place.latitude_deg:.6f}, {place.longitude_deg:.6f}"
        if place is not None and place.turn_std_rad is not None:
            sure = f", ± {min(degrees(place.turn_std_rad), 180.0):.0f} degrees"
            turned = f"; the direction of the walk is {'known' if self.knows_north else 'unknown'}{sure}"
        if self.frame == "north":
            zero = "the origin of the fixes" if self.start_position_m.any() else "the start of the walk"
            sure = sure if self.knows_north else turned
            return f"East and north are metres from {zero}{at}; north is true north, as given or measured{sure}."
        if self.frame == "plan":
            return f"East and north are metres in the frame of the floor plan{at and f', whose zero is{at}'}."
        if self.frame == "fixes":
            at = f", whose origin is{at}; north is true north{turned}" if at else ""
            return f"East and north are metres in the frame of the fixes{at}."
        words = f"East and north are metres from the start of the walk{at}; north is"
        if self.frame == "heading fixes":
            return f"{words} that of the heading fixes."
        return f"{words} the direction of the first heading, because true north is unknown."

    @property
    def estimate(self) -> str:
        """Kind of estimate: "smoothed", from the whole recording, or "online", from earlier samples only."""
        return "smoothed" if self.is_smoothed else "online"

    @property
    def about_estimate(self) -> str:
        """Description of the kind of estimate, as a sentence."""
        if self.is_smoothed:
            return "Smoothed: each position is the best estimate from the whole recording."
        return "Online: each position is estimated from the samples up to its step."

    @property
    def is_level(self) -> bool:
        """True if no change of height exceeds one metre and two standard deviations, and the storey is the same."""
        is_significant = np.abs(self.height_m) > np.maximum(1.0, 2.0 * self.height_std_m)
        return not (is_significant.any() or self.floor_passages or (self.floor != self.floor[:1]).any())

    @property
    def floor_prob(self) -> FloatArray:
        """Probability (K,) that the storey is right. Below 0.5 files and reports give the storey as unknown."""
        return floor_prob(self.height_std_m)

    @property
    def known_floor(self) -> list[int | None]:
        """Storey of each step, or None where it is unknown."""
        unknown = is_floor_unknown(self.height_std_m)
        return [None if no else floor for floor, no in zip(self.floor.tolist(), unknown.tolist(), strict=True)]

    @property
    def direction_trust(self) -> FloatArray:
        """Agreement (K,) of the strides on the walking direction at each step, 0 to 1."""
        return np.asarray(self.steps.direction_trust)

    @property
    def is_quick_and_soft(self) -> BoolArray:
        """True (K,) where most of the surrounding steps are quick and soft (`Step.is_quick_and_soft`)."""
        each = np.array([step.is_quick_and_soft for step in steps_of(self.steps)], dtype=int)
        if not self.n_steps:
            return each > 0
        number = np.convolve(np.pad(each, _ABOUT_STEPS // 2, mode="edge"), np.ones(_ABOUT_STEPS, int), mode="valid")
        return 2 * number > _ABOUT_STEPS

    @property
    def heading_source(self) -> tuple[str, ...]:
        """Source of each heading: "axes" of a building, "strides" that agree, or the gyroscope of the "device"."""
        return tuple(step.heading_source for step in steps_of(self.steps))

    @property
    def mode_entropy(self) -> FloatArray:
        """Entropy (K,) of the mode probabilities after each step, nats. 0 if one mode is certain."""
        p = self.mode_prob
        return -(p * np.log(p, where=p > 0, out=np.zeros_like(p))).sum(axis=1)

    @property
    def effective_modes(self) -> FloatArray:
        """Effective number of modes (K,) after each step: the exponential of the entropy, from 1 to M."""
        return np.exp(self.mode_entropy)

    def speed_mps(self, t: ArrayLike) -> FloatArray:
        """Return the walking speed at given times: step length divided by duration during a step, otherwise zero.

        Parameters
        ----------
        t : array_like
            Times of any shape, s.

        Returns
        -------
        ndarray
            Speeds of the same shape, m/s. NaN where the time is NaN.
        """
        at = np.asarray(t, dtype=float)
        if self.n_steps == 0:
            return np.where(np.isnan(at), at, 0.0)
        index = np.searchsorted(self.time_s, at)  # the first contact at or after t ends the step that contains t
        inside = np.minimum(index, self.n_steps - 1)
        duration = np.asarray(self.steps.duration_s)[inside]
        walking = (index < self.n_steps) & (at >= self.time_s[inside] - duration)
        return np.where(walking, self.step_length_m[inside] / duration, np.where(np.isnan(at), at, 0.0))

    def floor_changes(self) -> list[FloorPassage]:
        """Return the changes of storey, in order of time.

        Returns
        -------
        list of FloorPassage
            Start, end, storeys and means (stairs, lift, escalator) of each change.
        """
        return list(self.floor_passages)

    def context_seconds(self) -> dict[str, float]:
        """Return the time spent in each context. Each window counts for its most probable context.

        A window that has no step although its most probable context is one with steps counts for no context (see
        `seconds_without_steps`).

        Returns
        -------
        dict of str to float
            Seconds by context.
        """
        seconds, best = self._of_windows()
        walked = ~self.moves_without_steps
        return {name: float(seconds[walked & (best == c)].sum()) for c, name in enumerate(self.contexts)}

    @property
    def seconds_without_steps(self) -> float:
        """Time in windows that have no step, but a context with steps: in a vehicle or in a moving hand, s."""
        return float(self._of_windows()[0][self.moves_without_steps].sum())

    @property
    def moves_without_steps(self) -> BoolArray:
        """True for windows (W,) whose most probable context has steps, but with no step in or near the window."""
        end_s = self.windows.time_s
        # A margin of half a step on each side, because contacts of slow steps are a second apart.
        first, last = (np.searchsorted(self.time_s, t) for t in (end_s - _WINDOW_S - 0.5, end_s + 0.5))
        return (last <= first) & ~np.isin(self._of_windows()[1], self.windows.standing_index)

    def _of_windows(self) -> tuple[FloatArray, IntArray]:
        """Return duration (W,) in s and index of the most probable context (W,)."""
        end_s = self.windows.time_s
        starts = np.concatenate([[self.start_time_s], end_s[:-1]])
        seconds = np.minimum(end_s - starts, _WINDOW_S)  # the first window and windows after a gap have full length
        return seconds[: len(end_s)], self.windows.context_prob.argmax(axis=1)

    def summary(self) -> dict[str, Any]:
        """Return the main results as JSON values, as printed by `pdr-filter track --json`.

        Returns
        -------
        dict
            `name`, `n_steps`, `distance_m`, `duration_s`, `end_east_m`, `end_north_m`, `end_std_m`, `estimate`,
            `frame`, `contexts` (seconds in each), `moving_without_steps_s` and `notes`. A track with a place also has
            `end_latitude_deg` and `end_longitude_deg`. A track with heights also has `end_height_m`,
            `end_height_std_m`, `end_floor` (None if it is unknown) and `end_floor_prob`.
        """
        end = self.end_position_m
        place: dict[str, float] = {}
        if self.origin is not None:
            latitude_deg, longitude_deg = self.latitude_longitude_deg(end)
            place = {
                "end_latitude_deg": round(float(latitude_deg), 7),
                "end_longitude_deg": round(float(longitude_deg), 7),
            }
        height: dict[str, float | int | None] = {}
        if not self.is_level:
            height = {
                "end_height_m": round(float(self.height_m[-1]), 3),
                "end_height_std_m": round(float(self.height_std_m[-1]), 3),
                "end_floor": self.known_floor[-1],
                "end_floor_prob": round(float(self.floor_prob[-1]), 3),
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
