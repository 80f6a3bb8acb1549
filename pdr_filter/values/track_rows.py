"""The rows of a track: what a filter says of each step, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray, Table, read_only
from pdr_filter.values.fixes import FixResult
from pdr_filter.values.origin import Origin
from pdr_filter.values.step import steps_of
from pdr_filter.values.windows import Windows

_WINDOW_S = 2.0  # of the context windows


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackRows:
    """Where the pedestrian walked: one row for each step, positions in metres with covariance.

    Positions are in one frame, which `frame` names: that of the "start", whose origin is where the track begins and
    whose north is where the device's heading was zero; the same with true "north"; or that of the "fixes". Where few
    fixes leave open how the track is turned in their frame, a position is the mean over all turns, and its covariance
    says how far they differ.

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
    start_position_m: FloatArray = field(default_factory=lambda: read_only(np.zeros(2)))  # (2,) before the first step
    frame: str = "start"  # of positions and headings: "start", "north" or "fixes"
    origin: Origin | None = None  # where its zero is, if the recording's own locations placed the track

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
    def latitude_deg(self) -> FloatArray:
        """Latitude of each step on WGS 84, shape (K,); ValueError if the track has no `origin`."""
        return self.placed_at(None).latitude_longitude_deg(self.position_m)[0]

    @property
    def longitude_deg(self) -> FloatArray:
        """Longitude of each step, shape (K,); ValueError if the track has no `origin`."""
        return self.placed_at(None).latitude_longitude_deg(self.position_m)[1]

    def placed_at(self, origin: Origin | tuple[float, float] | None) -> Origin:
        """Where its zero is: as given, Origin or (latitude_deg, longitude_deg), or else the track's own `origin`."""
        if origin is None:
            origin = self.origin
        if origin is None:
            raise ValueError(
                f"no location says where on Earth the track {self.name!r} is: give a file origin=(latitude_deg, "
                "longitude_deg), or the recording a location stream"
            )
        return origin if isinstance(origin, Origin) else Origin(*origin)

    @property
    def direction_trust(self) -> FloatArray:
        """How well strides agreed on where walking leads at each step, shape (K,), 0 to 1."""
        return np.asarray(self.steps.direction_trust)

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
        """Walking speed at times t, m/s, same shape as t: step length over duration during a step, else zero."""
        at = np.asarray(t, dtype=float)
        if self.n_steps == 0:
            return np.zeros_like(at)
        index = np.searchsorted(self.time_s, at)  # the first contact at or after t ends the step that t is in
        inside = np.minimum(index, self.n_steps - 1)
        duration = np.asarray(self.steps.duration_s)[inside]
        walking = (index < self.n_steps) & (at >= self.time_s[inside] - duration)
        return np.where(walking, self.step_length_m[inside] / duration, 0.0)

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
        return seconds[: len(end_s)], best, (last > first) | (best == self.contexts.index("stationary"))

    def summary(self) -> dict[str, Any]:
        """What `pdr-filter track --json` prints: name, n_steps, distance_m, duration_s, end, contexts and more."""
        end = self.position_m[-1] if self.n_steps else np.zeros(2)
        place: dict[str, float] = {}
        if self.origin is not None:
            latitude_deg, longitude_deg = self.origin.latitude_longitude_deg(end)
            place = {
                "end_latitude_deg": round(float(latitude_deg), 7),
                "end_longitude_deg": round(float(longitude_deg), 7),
            }
        return {
            "name": self.name,
            "n_steps": self.n_steps,
            "distance_m": round(self.distance_m, 3),
            "duration_s": round(self.duration_s, 3),
            "end_east_m": round(float(end[0]), 3),
            "end_north_m": round(float(end[1]), 3),
            **place,
            "contexts": {name: round(seconds, 1) for name, seconds in self.context_seconds().items()},
            "moving_without_steps_s": round(self.seconds_without_steps, 1),
        }
