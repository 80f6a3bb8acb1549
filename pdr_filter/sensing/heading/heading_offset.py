"""Heading offset between device and walking direction, and the part of it that a track needs.

A track begins in its own frame, whose north is the walking direction at a device heading of zero. The angle from the
device to the walking direction in the first placement of the phone is therefore part of the definition of the frame. An
error of this angle does not deform the track, because the turn of the device alone determines its shape. The angle
matters when the phone moves to another placement, because the track needs the difference of the two angles. Three
normally distributed quantities with a joint covariance describe this:

- o, the heading offset in the frame of the track: walking heading minus device heading. It starts at 0 and drifts
  slowly.
- g, the angle that defines the zero of o: strides measure o + g in the axes of the phone.
- s, the systematic error of all strides in the present placement.

A stride measures o + g + s. The axis of a phone that is being read measures o + g. In the first placement o is known
and g is estimated. In the next placement o is estimated from g, and from the walking direction before the change.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from pdr_filter.sensing.heading.vectors import Vector
from pdr_filter.values.angles import UNKNOWN_VAR_RAD2

# Coefficient of the systematic error s in a measurement by strides and in one by the axis of the phone.
STRIDE_MEASUREMENT, AXIS_MEASUREMENT = 1.0, 0.0
# Prior variance of g, which is unknown at first: large against the variance of a stride, small enough for rounding.
_NO_IDEA_RAD2 = 1e4
# Variance of the first offset, (1 degree)^2. It is 0 by definition, but the filter needs a positive variance.
_DEFINED_RAD2 = math.radians(1.0) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Mean and covariance of the heading offset o, the reference angle g and the systematic error s, all in rad.

    o is the walking heading minus the device heading, in the frame of the track. It is 0 in the first placement of the
    phone by definition of that frame. g is the angle from the device to the walking direction in the first placement.
    Strides measure o + g + s, with the systematic error s of the strides in the present placement.
    """

    mean: Vector = (0.0, 0.0, 0.0)  # means of (o, g, s), rad
    # Covariances oo, og, os, gg, gs and ss, rad2.
    cov: tuple[float, float, float, float, float, float] = (_DEFINED_RAD2, 0.0, 0.0, _NO_IDEA_RAD2, 0.0, 0.0)

    @property
    def offset_rad(self) -> float:
        """Heading offset o in the frame of the track, rad."""
        return self.mean[0]

    @property
    def var_rad2(self) -> float:
        """Variance of the heading offset o, rad2."""
        return self.cov[0]

    @property
    def shown_rad(self) -> float:
        """Angle from the zero of the device heading to the walking direction, rad.

        It is the sum of the heading offset o and the reference angle g. Strides measure this sum plus a systematic
        error.
        """
        return self.mean[0] + self.mean[1]

    @property
    def shown_var_rad2(self) -> float:
        """Variance of `shown_rad`, rad2, at most the variance of a uniformly distributed angle (pi^2 / 3)."""
        oo, og, _, gg, _, _ = self.cov
        return min(oo + 2.0 * og + gg, UNKNOWN_VAR_RAD2)

    def after_time(self, var_rad2: float, stay: float, systematic_rad2: float) -> Offset:
        """Return the offset after a time in which the phone was turned slightly against the body.

        `var_rad2` is the variance of this turn. The systematic error keeps the share `stay`, and a new error is added
        so that its stationary variance is `systematic_rad2`.
        """
        (o, g, s), (oo, og, os, gg, gs, ss) = self.mean, self.cov
        ss = stay * stay * ss + (1.0 - stay * stay) * systematic_rad2
        return Offset((o, g, stay * s), (oo + var_rad2, og, stay * os, gg, stay * gs, ss))

    def after_measurement(self, c: float, direction: complex, var_rad2: float) -> Offset:
        """Return the offset after a measurement of o + g + c s with variance `var_rad2`.

        o is the heading offset, g the reference angle and s the systematic error of strides. `c` is
        `STRIDE_MEASUREMENT` or `AXIS_MEASUREMENT`. `direction` is a complex number whose argument is the measured
        angle, with an absolute value of 1 on average. A shorter one has less weight.

        Let P be the covariance of (o, g, s), h = (1, 1, c) and r = `var_rad2`. With the predicted angle a and its
        variance V = h' P h, the mean moves to the direction of e^(ia) / V + direction / r. This is the product of two
        von Mises distributions, and equals a Kalman update if both are narrow.
        """
        (o, g, s), (oo, og, os, gg, gs, ss) = self.mean, self.cov
        ph_o, ph_g, ph_s = oo + og + c * os, og + gg + c * gs, os + gs + c * ss  # P h
        variance = ph_o + ph_g + c * ph_s
        turn = direction * cmath.exp(-1j * (o + g + c * s))
        shift = cmath.phase(1.0 / variance + turn / var_rad2) / variance
        total = variance + var_rad2
        k_o, k_g, k_s = ph_o / total, ph_g / total, ph_s / total  # gain P h / (h' P h + r)
        cov = (oo - k_o * ph_o, og - k_o * ph_g, os - k_o * ph_s, gg - k_g * ph_g, gs - k_g * ph_s, ss - k_s * ph_s)
        return Offset((o + ph_o * shift, g + ph_g * shift, s + ph_s * shift), cov)

    def after_move(self, offset_rad: float, var_rad2: float, systematic_rad2: float) -> Offset:
        """Return the offset after the phone was moved to another placement.

        The new heading offset is `offset_rad`, with a variance increased by `var_rad2`. The systematic error is a new
        one with variance `systematic_rad2`.
        """
        oo, og, _, gg, _, _ = self.cov
        oo += var_rad2
        # The variance of an angle is at most that of a uniform distribution; the covariance with g is scaled with it.
        scale = math.sqrt(min(UNKNOWN_VAR_RAD2 / oo, 1.0))
        return Offset((offset_rad, self.mean[1], 0.0), (scale * scale * oo, scale * og, 0.0, gg, 0.0, systematic_rad2))
