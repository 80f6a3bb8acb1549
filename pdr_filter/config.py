"""The configuration of a filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from pdr_filter.filter.tracking import Tracker
from pdr_filter.sensing.features.barometric import ClimbRate
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.walking_direction import WalkingDirection


@dataclass(frozen=True, eq=False)
class Config:
    """Everything about a filter that never changes; a recipe is a function that returns one.

    `needs` names the sensor streams of `Recording`, besides the accelerometer, without which its tracks mean nothing
    (its steps and contexts may do with less); `notes` say in plain words what to keep in mind about every track.
    """

    name: str
    sensing: Sensing
    tracker: Tracker
    climb_rate: ClimbRate = field(default_factory=ClimbRate)
    needs: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    on_foot: bool = False  # made for a sensor on the foot, not for a carried phone

    def __post_init__(self) -> None:
        heading, drift = self.sensing.heading, self.tracker.noise.heading_drift
        if isinstance(heading, WalkingDirection) and heading.drift != drift:
            raise ValueError(
                f"the heading stage must reckon with the filter's heading drift, {drift}, got {heading.drift}: give "
                "one HeadingDrift to both"
            )

    def in_world_frame(self) -> Config:
        """The same for fixes in a frame whose origin and north the track does not know, such as that of a map."""
        return replace(self, tracker=replace(self.tracker, frame="world"))

    def with_weighting(self, weighting: str) -> Config:
        """The same with another weighting: "imm", "wc" or "hc"."""
        return replace(self, tracker=replace(self.tracker, weighting=weighting))
