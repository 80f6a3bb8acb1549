"""One step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from pdr_filter.values.arrays import Table, table

# Strides that share half of their squared length and more agree: pockets and hands have 0.6 to 0.98, handbags 0.05 to
# 0.3 (docs/methods/heading.md). Less than the second is no better than chance: 13 strides of no direction share 0.08 on
# average, and half of them up to 0.2.
TRUSTED, HARDLY_AGREE = 0.5, 0.2
# Steps as quick as running, with less than half of its bounce: three quarters of those of somebody who jogs in a small
# room, at most 7 % on walks and 1 % on runs (detect_steps on oxiod, humolire, ubicomp13, motionsense, tyrex, ipol).
_QUICK_HZ, _SOFT_MPS2 = 2.4, 5.0


@dataclass(frozen=True)
class Step:
    """One step: from a contact of one foot to the next contact of the other.

    Statistics are over the samples of the step. `magnitude` is of the specific force, `vertical` its component along
    gravity minus standard gravity (up positive).
    """

    time_s: float  # contact that ends the step
    detected_time_s: float  # when it became known, causally
    duration_s: float
    frequency_hz: float  # 1 / duration_s
    variance: float  # of the magnitude, m2/s4 (sigma_f^2 of Martinelli et al. 2018, eq. 12)
    vertical_max_mps2: float
    vertical_min_mps2: float
    magnitude_max_mps2: float
    magnitude_min_mps2: float
    mean_abs_mps2: float  # mean of | magnitude - g |
    heading_change_rad: float  # of the device over the step, clockwise positive
    device_heading_rad: float  # mean over the step, clockwise from the first heading, not wrapped
    heading_unknown_s: float = 0.0  # time since the step before without angular rate: the heading stood still
    # Where the person walked, as the samples show it without the device's axes: same zero as `device_heading_rad`,
    # clockwise, any number of turns. A measurement for the filter; unknown where its standard deviation is infinite.
    walking_heading_rad: float = 0.0
    walking_heading_std_rad: float = np.inf
    # How much the angle between walking and device may have changed since the step before (standard deviation): 0
    # while the phone stays where it is, large when it was moved to another place.
    offset_change_std_rad: float = 0.0
    # Walking less device heading as strides, and the axis of a phone that somebody reads, show it: where the phone
    # points against the body. It need not be known for a track, whose frame holds that of the first place.
    shown_offset_rad: float = 0.0
    shown_offset_std_rad: float = np.inf
    # How well the strides agree on it, 0 to 1: the squared length of their mean direction.
    direction_trust: float = 0.0
    carried_since_s: float = -np.inf  # when the phone was put where it is; -inf before the first stride
    on_axes: bool = False  # the walk keeps to the axes of a building, and its heading is corrected by them
    # Standard deviation of the gyroscope's bias about the vertical at this step, after correction.
    yaw_bias_std_radps: float = 0.0
    # Of the sinusoid at the step's own frequency in the vertical: the bounce of the body without heel strikes.
    vertical_amplitude_mps2: float = 0.0
    # Mean of that over this step and the one before: in a pocket the steps of one leg bounce more than the other's. 0
    # where nothing says; of this step alone after a rest.
    stride_amplitude_mps2: float = 0.0
    # Geometric mean of the amplitude over the person's last steps, this one included; 0 before the second of a bout.
    usual_amplitude_mps2: float = 0.0
    usual_duration_s: float = 0.0  # geometric mean over the person's steps before; 0 where there are none
    # How fast the device turned over this step and the one before, without sign: the sway of a stride is not in it.
    turn_rate_radps: float = 0.0
    from_rest: bool = False  # the first of a bout, or after a pause: it began with the feet together
    is_two: bool = False  # the contact in the middle was missed
    # Heading of true north in the attitude's frame, as the magnetic field shows it: device heading and shown offset
    # less this is where the person walks against north. Unknown where its standard deviation is infinite.
    north_rad: float = 0.0
    north_std_rad: float = np.inf

    @property
    def heading_source(self) -> str:
        """What leads the track here: "axes" of a building, "strides" that agree, or the "device" and its turn alone."""
        if self.on_axes:
            return "axes"
        return "strides" if self.direction_trust >= TRUSTED else "device"

    @property
    def is_quick_and_soft(self) -> bool:
        """Whether it is too quick for walking and too soft for running: no model of its length or direction holds."""
        return self.frequency_hz > _QUICK_HZ and self.vertical_amplitude_mps2 < _SOFT_MPS2

    @property
    def turned_rad(self) -> float:
        """How far the device turned in it, without sign, at most half a turn."""
        return min(self.turn_rate_radps * self.duration_s, math.pi)

    @property
    def unevenness(self) -> float:
        """By which part of the usual duration it is shorter or longer, at most 1; 0 where none is usual."""
        if self.usual_duration_s <= 0:
            return 0.0
        return min(abs(self.duration_s / self.usual_duration_s - 1.0), 1.0)

    @property
    def vertical_range_mps2(self) -> float:
        """Peak-to-peak vertical specific force."""
        return self.vertical_max_mps2 - self.vertical_min_mps2


def step_table(steps: Sequence[Step]) -> Table:
    """Return one row for each step, one float column for each field of `Step`."""
    return table({f.name: np.array([getattr(s, f.name) for s in steps], dtype=float) for f in fields(Step)})


def steps_of(rows: Table) -> tuple[Step, ...]:
    """Return the steps of a table, the inverse of `step_table`; further columns of the table are left out."""
    columns = {f.name: rows[f.name].astype(bool if f.type == "bool" else float).tolist() for f in fields(Step)}
    return tuple(Step(*values) for values in zip(*columns.values(), strict=True))
