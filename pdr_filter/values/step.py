"""Step of a pedestrian, and tables of steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pdr_filter.values.arrays import FloatArray, Table, table
from pdr_filter.values.checks import check_number

# Thresholds of `Step.direction_trust`, the squared length of the mean direction of strides. From the first on, strides
# agree: pockets and hands have 0.6 to 0.98, handbags 0.05 to 0.3 (docs/methods/heading.md). Below the second they agree
# no better than by chance: 13 strides of random directions have 0.08 on average, and up to 0.2 in half of the cases.
TRUSTED, HARDLY_AGREE = 0.5, 0.2
# Steps at the frequency of running, with less than half of its vertical amplitude. They are three quarters of the steps
# when jogging in a small room, at most 7 % of the steps of walks, and 1 % of those of runs (detect_steps on oxiod,
# humolire, ubicomp13, motionsense, tyrex, ipol).
_QUICK_HZ, _SOFT_MPS2 = 2.4, 5.0
# Statistics of a walking step with the phone in the hand: medians over two sites.
_TYPICAL: dict[str, Any] = {
    "variance": 4.0,
    "vertical_max_mps2": 3.5,
    "vertical_min_mps2": -3.5,
    "magnitude_max_mps2": 13.8,
    "magnitude_min_mps2": 6.8,
    "mean_abs_mps2": 1.7,
    "heading_change_rad": 0.0,
    "device_heading_rad": 0.0,
    "vertical_amplitude_mps2": 2.4,
}


@dataclass(frozen=True)
class Step:
    """Step: from the ground contact of one foot to the next contact of the other foot.

    Statistics are over the samples of the step. The magnitude is the norm of the specific force. The vertical component
    is the specific force along up, minus standard gravity.

    Attributes
    ----------
    time_s, detected_time_s : float
        Contact that ends the step, and time at which the step became known, s.
    duration_s, frequency_hz : float
        Duration, s, and 1 / duration, Hz.
    variance : float
        Variance of the magnitude, m^2/s^4 (sigma_f^2 of Martinelli et al. 2018, eq. 12).
    vertical_max_mps2, vertical_min_mps2 : float
        Extremes of the vertical component, m/s^2.
    magnitude_max_mps2, magnitude_min_mps2 : float
        Extremes of the magnitude, m/s^2.
    mean_abs_mps2 : float
        Mean of | magnitude - g |, m/s^2.
    heading_change_rad : float
        Rotation of the phone about the vertical during the step, rad, clockwise positive.
    device_heading_rad : float
        Mean heading of the phone during the step, rad, clockwise from its first heading, not wrapped.
    heading_unknown_s : float, default 0.0
        Time without angular rate since the previous step in which the phone may have turned, s. The heading is constant
        during that time.
    walking_heading_rad : float, default 0.0
        Walking direction measured from the samples, without the axes of the phone, rad. It has the zero of
        `device_heading_rad` and is not wrapped.
    walking_heading_std_rad : float, default inf
        Standard deviation of `walking_heading_rad`, rad. Infinite if there is no measurement. 0 if a heading stage
        states the direction of the step: the heading offset is then that from this direction.
    offset_change_std_rad : float, default 0.0
        Standard deviation of the change of the heading offset (walking direction minus device heading) since the
        previous step, rad. 0 while the phone stays in its place.
    shown_offset_rad, shown_offset_std_rad : float, default 0.0 and inf
        Heading offset measured from strides, and from the axis of a phone that is being read, and its standard
        deviation, rad. A track does not need it: its frame has the offset of the first place of the phone.
    direction_trust : float, default 0.0
        Agreement of the strides on the walking direction, 0 to 1: the squared length of their mean direction.
    carried_since_s : float, default -inf
        Time at which the phone was put into its present place, s. -inf before the first stride.
    on_axes : bool, default False
        True if the walk follows the axes of a building, which then correct the walking direction.
    yaw_bias_std_radps : float, default 0.0
        Standard deviation of the gyroscope bias about the vertical, after its correction, rad/s.
    vertical_amplitude_mps2 : float, default 0.0
        Amplitude of the vertical component at the frequency of the step, without heel strikes, m/s^2.
    stride_amplitude_mps2 : float, default 0.0
        Its mean over this step and the previous one of a bout, because in a pocket the two legs differ, m/s^2. 0 if
        unknown.
    usual_amplitude_mps2, usual_duration_s : float, default 0.0
        Geometric means of the amplitude over the last steps of the person with this one, m/s^2, and of the duration of
        earlier ones, s. 0 if there are none.
    turn_rate_radps : float, default 0.0
        Absolute rotation rate of the phone about the vertical, over this step and the previous one, rad/s. The sway
        within a stride cancels.
    from_rest, is_two : bool, default False
        True for the first step of a bout or after a pause, which starts with the feet together, and for two steps whose
        middle contact was missed.
    north_rad, north_std_rad : float, default 0.0 and inf
        Heading of true north in the frame of the attitude, from the magnetic field, and its standard deviation, rad.
        Device heading plus heading offset minus this is the walking direction against north.
    stepless_s : float, default 0.0
        Time since the previous step in which the phone moved although no step explains it, s, so that steps may be
        missing.
    ahead_s : float, default 0.0
        Time by which the phone may turn ahead of the walking direction, s. A head leads into curves, and turns a phone
        at the ear.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.values import steps_of
    >>> steps = steps_of(pdr.detect_steps(pdr.simulate.demo_walk()))
    >>> all(step.detected_time_s >= step.time_s for step in steps)
    True
    """

    time_s: float
    detected_time_s: float
    duration_s: float
    frequency_hz: float
    variance: float
    vertical_max_mps2: float
    vertical_min_mps2: float
    magnitude_max_mps2: float
    magnitude_min_mps2: float
    mean_abs_mps2: float
    heading_change_rad: float
    device_heading_rad: float
    heading_unknown_s: float = 0.0
    walking_heading_rad: float = 0.0
    walking_heading_std_rad: float = np.inf
    offset_change_std_rad: float = 0.0
    shown_offset_rad: float = 0.0
    shown_offset_std_rad: float = np.inf
    direction_trust: float = 0.0
    carried_since_s: float = -np.inf
    on_axes: bool = False
    yaw_bias_std_radps: float = 0.0
    vertical_amplitude_mps2: float = 0.0
    stride_amplitude_mps2: float = 0.0
    usual_amplitude_mps2: float = 0.0
    usual_duration_s: float = 0.0
    turn_rate_radps: float = 0.0
    from_rest: bool = False
    is_two: bool = False
    north_rad: float = 0.0
    north_std_rad: float = np.inf
    stepless_s: float = 0.0
    ahead_s: float = 0.0

    @classmethod
    def of(cls, time_s: float, *, duration_s: float = 0.54, **values: Any) -> Step:
        """Return a typical walking step at a time, with the given fields replaced. Own step detectors can use it.

        Parameters
        ----------
        time_s : float
            Contact that ends the step, s.
        duration_s : float, default 0.54
            Duration of the step, s.
        **values : float or bool
            Other fields by name. By default `detected_time_s` is `time_s`, `frequency_hz` is 1 / `duration_s`, the
            heading does not change, and the statistics are medians of walking with the phone in the hand. They give a
            typical step length; give your own statistics for those that the step-length model of the configuration
            uses. For known step lengths, make a step-length model that returns them
            (`pdr_filter.protocols.StepLengthModel`, `Config.with_step_length`).

        Returns
        -------
        Step
            The step.

        Raises
        ------
        ValueError
            If the duration is not that of a step.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> step = pdr.Step.of(12.3, duration_s=0.5, vertical_amplitude_mps2=3.0)
        >>> step.frequency_hz, step.detected_time_s
        (2.0, 12.3)
        """
        check_number("duration_s", duration_s, 0.1, 10.0, "give the time since the previous contact in seconds")
        given: dict[str, Any] = {"time_s": time_s, "detected_time_s": time_s, "duration_s": duration_s}
        given["frequency_hz"] = 1.0 / duration_s
        return cls(**(_TYPICAL | given | values))

    @property
    def heading_source(self) -> str:
        """Source of the heading: "axes" of a building, "strides" that agree, or the gyroscope of the "device"."""
        if self.on_axes:
            return "axes"
        return "strides" if self.direction_trust >= TRUSTED else "device"

    @property
    def states_heading(self) -> bool:
        """True if a heading stage states the direction of the step, in place of a measurement of the heading offset."""
        return self.walking_heading_std_rad == 0.0

    @property
    def reference_heading_rad(self) -> float:
        """Heading to which the filter adds its heading offset: that of the device, or the stated direction, rad."""
        return self.walking_heading_rad if self.states_heading else self.device_heading_rad

    @property
    def is_quick_and_soft(self) -> bool:
        """True if the step is too quick for walking and too soft for running, so that no model of it holds."""
        return self.frequency_hz > _QUICK_HZ and self.vertical_amplitude_mps2 < _SOFT_MPS2

    @property
    def turned_rad(self) -> float:
        """Range of possible walking directions in a curve, rad, at most half a revolution.

        It is the absolute rotation of the phone during the step. A phone that turns ahead of the walking direction adds
        a standard deviation of `turn_rate_radps` times `ahead_s`, which is that of a range sqrt(12) times as large.
        """
        return min(self.turn_rate_radps * (self.duration_s + math.sqrt(12.0) * self.ahead_s), math.pi)

    @property
    def unevenness(self) -> float:
        """Relative difference between the duration and the usual duration, at most 1. 0 if there is none."""
        if self.usual_duration_s <= 0:
            return 0.0
        return min(abs(self.duration_s / self.usual_duration_s - 1.0), 1.0)

    @property
    def vertical_range_mps2(self) -> float:
        """Peak-to-peak vertical specific force, m/s^2."""
        return self.vertical_max_mps2 - self.vertical_min_mps2


def step_table(steps: Sequence[Step]) -> Table:
    """Return a table with one row for each step and one float column for each field of `Step`."""
    return table({f.name: np.array([getattr(s, f.name) for s in steps], dtype=float) for f in fields(Step)})


def reference_headings(rows: Table) -> FloatArray:
    """Return `Step.reference_heading_rad` (K,) of the K steps of a table."""
    is_stated = np.asarray(rows.walking_heading_std_rad) == 0.0
    return np.where(is_stated, np.asarray(rows.walking_heading_rad), np.asarray(rows.device_heading_rad))


def steps_of(rows: Table) -> tuple[Step, ...]:
    """Return the steps of a table, the inverse of `step_table`. Further columns of the table are ignored."""
    columns = {f.name: rows[f.name].astype(bool if f.type == "bool" else float).tolist() for f in fields(Step)}
    return tuple(Step(*values) for values in zip(*columns.values(), strict=True))
