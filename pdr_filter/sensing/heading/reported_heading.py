"""Keep track of the heading information already passed to the filter, so that each step reports only what is new.

The errors of successive headings are correlated, but a Kalman filter treats them as independent. Each step therefore
reports only the new information. Let a filter use all measurements so far, with an offset that drifts as stated by
`HeadingDrift`. The reported measurement and its variance are those whose Kalman update takes this filter from its
present estimate to the new one (docs/methods/heading.md). Variance added by a time without angular rate or by a gap
stays, because the device heading itself was lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from pdr_filter.values import HeadingDrift, Step, replace_unchecked, wrap_angle
from pdr_filter.values.angles import UNKNOWN_VAR_RAD2

# Variance above which a heading counts as unknown, because it gives no information on the circle.
_UNKNOWN_VAR_RAD2 = 1.0
# Smallest gain that is reported. With a smaller one, the measurement z would be implausibly far from the estimate.
_MIN_GAIN = 1e-3
_MAX_INNOVATION_RAD = 2.5
# Largest variance that the device heading is counted to have lost. Without a limit, no later measurement would be
# reported, not even that of a phone that is moved.
_MAX_LOST_VAR_RAD2 = 1.0


class Shown(NamedTuple):
    """Heading offset (walking heading minus device heading) that strides and the axis of the phone show."""

    offset_rad: float  # heading offset, rad
    var_rad2: float  # variance of the offset, rad2
    axes_prob: float  # probability that the walk follows the axes of a building


@dataclass(frozen=True, eq=False)
class Reported:
    """Estimate of the heading offset that the filter of the track has after all measurements passed to it so far.

    A measurement that a step passes to this filter is called reported. The offset that strides and the axis of the
    phone show is called the shown offset (`Shown`).
    """

    offset_rad: float = 0.0  # walking heading minus device heading, rad
    shown_rad: float = 0.0  # part of the offset that comes from strides and the axis of the phone, rad
    # Smallest variance of `shown_rad` in the present placement of the phone so far, rad2.
    shown_var_rad2: float = math.inf
    error_rad: float = 0.0  # error of the device heading (estimate minus truth) in the last report, rad
    var_rad2: float = math.inf  # variance of `offset_rad`, rad2. Infinite before the first report.
    # Part of `var_rad2` due to the device heading itself: gaps, times without angular rate, and the uncertain gyroscope
    # bias, rad2. It only grows, up to 1 rad2, because measurements by strides cannot reduce it.
    lost_var_rad2: float = 0.0
    time_s: float = math.nan  # time of the last step, s

    def after_loss(self, lost_var_rad2: float) -> Reported:
        """Return the estimate with a variance increased by `lost_var_rad2`.

        This variance in rad2 makes the device heading itself less certain. The cause is a gap, a time without angular
        rate, or the uncertain gyroscope bias.
        """
        if lost_var_rad2 == 0.0 and (self.var_rad2 <= UNKNOWN_VAR_RAD2 or math.isinf(self.var_rad2)):
            return self
        lost = min(self.lost_var_rad2 + lost_var_rad2, _MAX_LOST_VAR_RAD2)
        var = self.var_rad2 + lost_var_rad2
        return replace_unchecked(
            self, lost_var_rad2=lost, var_rad2=var if math.isinf(var) else min(var, UNKNOWN_VAR_RAD2)
        )

    def at_step(self, step: Step, drift: HeadingDrift, yaw_bias_std_radps: float) -> Reported:
        """Return the estimate predicted to the time of a step, with the variance increased by the drift of the heading.

        `yaw_bias_std_radps` is the standard deviation of the gyroscope bias about the vertical.
        """
        elapsed_s = step.duration_s if math.isnan(self.time_s) else step.time_s - self.time_s
        wandered_var, lost_var = drift.variances_rad2(elapsed_s, step.heading_unknown_s, yaw_bias_std_radps)
        drifted = replace_unchecked(self, var_rad2=self.var_rad2 + wandered_var, time_s=step.time_s)
        return drifted.after_loss(lost_var)

    def with_report(
        self, step: Step, shown: Shown, error_rad: float, var_rad2: float, change_std_rad: float
    ) -> tuple[Reported, dict[str, float]]:
        """Return the estimate after a step, and the heading fields of the step for the filter of the track.

        The new heading offset (walking heading minus device heading) is `shown.offset_rad` - `error_rad`. Its variance
        is `var_rad2` plus `lost_var_rad2`. `error_rad` is the error of the device heading, estimated from the gyroscope
        bias or the axes of a building. `change_std_rad` is the standard deviation of the change of the offset if the
        phone was moved, else 0.

        A change of `error_rad` is always passed on. A change of `shown.offset_rad` is passed on in full if the phone
        was moved or the walk follows the axes of a building. Otherwise its limit is proportional to the part of its
        variance that strides have removed, because this offset fluctuates. Each change would turn the whole past track
        if the heading has been uncertain for a long time.

        Let o- be the estimated offset before the step, of variance P-, and o the new offset, of variance P. The
        measurement is z = o- + (o - o-) / K with the gain K = 1 - P / P-. Its variance is P- P / (P- - P)
        (docs/methods/heading.md).

        The fields are `walking_heading_rad` (device heading plus z), `walking_heading_std_rad` and
        `offset_change_std_rad`. They are only `offset_change_std_rad` if the step has no new information.
        """
        var_rad2 += self.lost_var_rad2
        if math.isinf(self.var_rad2):
            first = replace_unchecked(self, offset_rad=shown.offset_rad - error_rad, var_rad2=var_rad2)
            first = replace_unchecked(
                first, shown_rad=shown.offset_rad, shown_var_rad2=shown.var_rad2, error_rad=error_rad
            )
            return first, _heading(step, first.offset_rad, var_rad2, 0.0)
        before_var = min(self.var_rad2 + change_std_rad**2, UNKNOWN_VAR_RAD2)
        shown_rad = float(wrap_angle(shown.offset_rad - self.shown_rad))
        if change_std_rad == 0:
            max_rad = _MAX_INNOVATION_RAD * max(1.0 - shown.var_rad2 / self.shown_var_rad2, 0.0)
            limited_rad = min(max(shown_rad, -max_rad), max_rad)
            shown_rad = limited_rad + shown.axes_prob * (shown_rad - limited_rad)
        change_rad = float(wrap_angle(shown_rad - (error_rad - self.error_rad)))
        # An innovation of half a turn or more would be applied in the opposite direction, so it is limited. If the
        # gain is too small for the required change, the variance of the filter was too small. It is then inflated,
        # because the rest of the change would otherwise never be reported.
        gain = 1.0 - var_rad2 / before_var
        if gain < abs(change_rad) / _MAX_INNOVATION_RAD:
            gain = min(abs(change_rad) / _MAX_INNOVATION_RAD, 1.0 - var_rad2 / UNKNOWN_VAR_RAD2)
            before_var = var_rad2 / (1.0 - gain)
        added_std_rad = math.sqrt(max(before_var - self.var_rad2, 0.0))
        is_unknown = var_rad2 > _UNKNOWN_VAR_RAD2 and change_std_rad == 0
        if gain < _MIN_GAIN or is_unknown:
            unreported = replace_unchecked(self, var_rad2=max(before_var, self.var_rad2))
            return unreported, {"offset_change_std_rad": added_std_rad}
        innovation_rad = min(max(change_rad / gain, -_MAX_INNOVATION_RAD), _MAX_INNOVATION_RAD)
        reported = replace_unchecked(
            self,
            offset_rad=self.offset_rad + gain * innovation_rad,
            var_rad2=var_rad2,
            shown_rad=self.shown_rad + shown_rad,
            shown_var_rad2=min(self.shown_var_rad2, shown.var_rad2) if change_std_rad == 0 else shown.var_rad2,
            error_rad=error_rad,
        )
        return reported, _heading(step, self.offset_rad + innovation_rad, var_rad2 / gain, added_std_rad)


def _heading(step: Step, offset_rad: float, var_rad2: float, change_std_rad: float) -> dict[str, float]:
    """Return the fields of `Step` for a measurement of its heading offset with variance `var_rad2`.

    The fields are the walking heading, its standard deviation, and the standard deviation of the change of the offset.
    """
    return {
        "walking_heading_rad": step.device_heading_rad + offset_rad,
        "walking_heading_std_rad": math.sqrt(var_rad2),
        "offset_change_std_rad": change_std_rad,
    }
