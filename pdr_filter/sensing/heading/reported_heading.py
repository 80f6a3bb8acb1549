"""What a filter knows that believes every walking heading that was reported to it, and what is new for it.

Errors of successive headings are alike, and a Kalman filter would take them for independent. So each step reports only
what is new: the measurement and the variance which, by the Kalman update, take a filter that lets the offset wander as
`HeadingDrift` says from what all measurements before have taught it to what is known now (docs/methods/heading.md).
Where the device's heading itself was lost, by a time without angular rate or a gap, that variance stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from pdr_filter.sensing.heading.heading_offset import UNKNOWN_VAR_RAD2
from pdr_filter.values import HeadingDrift, Step, replace_unchecked, wrap_angle

# With a standard deviation above one radian a heading is unknown, and says nothing on a circle.
_UNKNOWN_VAR_RAD2 = 1.0
# Less is not worth a report, and its measurement would be far from everything.
_MIN_GAIN = 1e-3
_MAX_INNOVATION_RAD = 2.5
# Where more is lost it is not reported: the filter must still hear of a phone that is moved.
_MAX_LOST_VAR_RAD2 = 1.0


class Shown(NamedTuple):
    """Heading offset that strides and the phone's axis show, and how probable it is that the walk keeps to axes."""

    offset_rad: float
    var_rad2: float
    axes_prob: float


@dataclass(frozen=True, eq=False)
class Reported:
    """Walking less device heading, as a filter knows it that believes all measurements so far."""

    offset_rad: float = 0.0
    shown_rad: float = 0.0  # the part of it that strides show
    shown_var_rad2: float = math.inf
    error_rad: float = 0.0  # of the device's heading, in the last report
    var_rad2: float = math.inf
    lost_var_rad2: float = 0.0  # the part of it that the device's heading has lost
    time_s: float = math.nan

    def after_loss(self, lost_var_rad2: float) -> Reported:
        """After the device's heading has lost this variance."""
        if lost_var_rad2 == 0.0 and (self.var_rad2 <= UNKNOWN_VAR_RAD2 or math.isinf(self.var_rad2)):
            return self
        lost = min(self.lost_var_rad2 + lost_var_rad2, _MAX_LOST_VAR_RAD2)
        var = self.var_rad2 + lost_var_rad2
        return replace_unchecked(
            self, lost_var_rad2=lost, var_rad2=var if math.isinf(var) else min(var, UNKNOWN_VAR_RAD2)
        )

    def at_step(self, step: Step, drift: HeadingDrift, yaw_bias_std_radps: float) -> Reported:
        """What the filter still knows at a step with this bias, before more is reported."""
        elapsed_s = step.duration_s if math.isnan(self.time_s) else step.time_s - self.time_s
        wandered_var, lost_var = drift.variances_rad2(elapsed_s, step.heading_unknown_s, yaw_bias_std_radps)
        drifted = replace_unchecked(self, var_rad2=self.var_rad2 + wandered_var, time_s=step.time_s)
        return drifted.after_loss(lost_var)

    def with_report(
        self, step: Step, shown: Shown, error_rad: float, var_rad2: float, change_std_rad: float
    ) -> tuple[Reported, dict[str, float]]:
        """Return what the filter knows after a step, and the fields of the step with the measurement that leads there.

        The walking heading less the device's is `shown.offset_rad` - `error_rad`, the second by the gyroscope's bias or
        the axes of a building. The filter hears of a new error always. It hears of a new offset as far as strides have
        made it more certain: the offset of a phone that stays in its place fluctuates, and the lever of a heading that
        has been uncertain for long would turn the whole past by that.

        The measurement is z = o- + (o - o-) / K, K = 1 - P / P-, and its variance P- P / (P- - P)
        (docs/methods/heading.md).
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
            most_rad = _MAX_INNOVATION_RAD * max(1.0 - shown.var_rad2 / self.shown_var_rad2, 0.0)
            limited_rad = min(max(shown_rad, -most_rad), most_rad)
            shown_rad = limited_rad + shown.axes_prob * (shown_rad - limited_rad)
        away_rad = float(wrap_angle(shown_rad - (error_rad - self.error_rad)))
        # Half a turn and more would be taken for the other way round. A filter that has to be turned further than its
        # variance allows was wrong about that variance: without more of it, the rest of the turn would never reach it.
        gain = 1.0 - var_rad2 / before_var
        if gain < abs(away_rad) / _MAX_INNOVATION_RAD:
            gain = min(abs(away_rad) / _MAX_INNOVATION_RAD, 1.0 - var_rad2 / UNKNOWN_VAR_RAD2)
            before_var = var_rad2 / (1.0 - gain)
        added_std_rad = math.sqrt(max(before_var - self.var_rad2, 0.0))
        is_unknown = var_rad2 > _UNKNOWN_VAR_RAD2 and change_std_rad == 0
        if gain < _MIN_GAIN or is_unknown:
            return replace_unchecked(self, var_rad2=max(before_var, self.var_rad2)), {
                "offset_change_std_rad": added_std_rad
            }
        innovation_rad = min(max(away_rad / gain, -_MAX_INNOVATION_RAD), _MAX_INNOVATION_RAD)
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
    return {
        "walking_heading_rad": step.device_heading_rad + offset_rad,
        "walking_heading_std_rad": math.sqrt(var_rad2),
        "offset_change_std_rad": change_std_rad,
    }
