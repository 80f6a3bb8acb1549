"""How far the walking direction is turned from the device, and how much of that a track needs to know.

A track begins in a frame of its own: its north is where the person walks when the device's heading is zero. So the
angle from the device to the walking direction in the phone's first place is a matter of the frame. However badly it is
known, it does not bend a track: the turn of the device alone leads it. It counts when the phone goes to another place,
because the track needs the difference of the two angles. Three numbers, normal with a joint covariance, hold that:

- o, the heading offset in the track's frame: walking less device heading. It is 0 at first and wanders slowly.
- g, the offset that counted as 0: the angle that strides show in the phone's own axes is o + g.
- s, what strides in this place are off by, however many there are.

A stride measures o + g + s, the axis of a phone that somebody reads on o + g. In the first place o is known and g is
learnt; in the next one o is found from g, and from where the person walked before.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from pdr_filter.sensing.heading.vectors import Vector

# What strides and the axis measure has so much of the systematic error in it.
OF_STRIDES, OF_AXIS = 1.0, 0.0
# An angle that could be anything is uniform on the circle.
UNKNOWN_STD_RAD = math.pi / math.sqrt(3.0)
UNKNOWN_VAR_RAD2 = UNKNOWN_STD_RAD**2
# Nothing at all is known of g at first: large against any variance of a stride, small enough for the arithmetic.
_NO_IDEA_RAD2 = 1e4
# The first offset is 0 by definition, and as a measurement it needs a variance: 1 degree.
_DEFINED_RAD2 = math.radians(1.0) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Mean and covariance of offset o, frame g and systematic error s, rad."""

    mean: Vector = (0.0, 0.0, 0.0)
    # oo, og, os, gg, gs, ss
    cov: tuple[float, float, float, float, float, float] = (_DEFINED_RAD2, 0.0, 0.0, _NO_IDEA_RAD2, 0.0, 0.0)

    @property
    def offset_rad(self) -> float:
        """The heading offset in the track's frame."""
        return self.mean[0]

    @property
    def var_rad2(self) -> float:
        """Its variance."""
        return self.cov[0]

    @property
    def shown_rad(self) -> float:
        """The angle from the device's zero to the walking direction, as strides and axis show it."""
        return self.mean[0] + self.mean[1]

    @property
    def shown_var_rad2(self) -> float:
        """Its variance; that of a uniform angle at most."""
        oo, og, _, gg, _, _ = self.cov
        return min(oo + 2.0 * og + gg, UNKNOWN_VAR_RAD2)

    def wandered(self, var_rad2: float, stay: float, systematic_rad2: float) -> Offset:
        """After a while: the phone was turned a little against the body, and strides are off by something else.

        `stay` is the share of the systematic error that is left, and `systematic_rad2` the variance that it keeps.
        """
        (o, g, s), (oo, og, os, gg, gs, ss) = self.mean, self.cov
        ss = stay * stay * ss + (1.0 - stay * stay) * systematic_rad2
        return Offset((o, g, stay * s), (oo + var_rad2, og, stay * os, gg, stay * gs, ss))

    def seen(self, of: float, toward: complex, var_rad2: float) -> Offset:
        """After a direction was seen: `of` says of which sum, `toward` points there, with a length of 1 on average.

        The mean goes to the direction of the sum of two von Mises likelihoods, e^(ia) / V + toward / r, which is that
        of a Kalman filter where both are narrow; a vector that is shorter than usual counts less.
        """
        (o, g, s), (oo, og, os, gg, gs, ss) = self.mean, self.cov
        of_o, of_g, of_s = oo + og + of * os, og + gg + of * gs, os + gs + of * ss
        variance = of_o + of_g + of * of_s
        turn = toward * cmath.exp(-1j * (o + g + of * s))
        shift = cmath.phase(1.0 / variance + turn / var_rad2) / variance
        # what is learnt of each, P h / (h' P h + r)
        total = variance + var_rad2
        k_o, k_g, k_s = of_o / total, of_g / total, of_s / total
        cov = (oo - k_o * of_o, og - k_o * of_g, os - k_o * of_s, gg - k_g * of_g, gs - k_g * of_s, ss - k_s * of_s)
        return Offset((o + of_o * shift, g + of_g * shift, s + of_s * shift), cov)

    def moved(self, offset_rad: float, var_rad2: float, systematic_rad2: float) -> Offset:
        """In another place: the offset goes there with a variance more, and strides are off by something else."""
        oo, og, _, gg, _, _ = self.cov
        oo += var_rad2
        # no angle is less known than a uniform one
        scale = math.sqrt(min(UNKNOWN_VAR_RAD2 / oo, 1.0))
        return Offset((offset_rad, self.mean[1], 0.0), (scale * scale * oo, scale * og, 0.0, gg, 0.0, systematic_rad2))
