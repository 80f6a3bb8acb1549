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
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.values import FloatArray

OFFSET, FRAME, SYSTEMATIC = range(3)
OF_STRIDES, OF_AXIS = np.array([1.0, 1.0, 1.0]), np.array([1.0, 1.0, 0.0])
# An angle that could be anything is uniform on the circle.
UNKNOWN_STD_RAD = math.pi / math.sqrt(3.0)
UNKNOWN_VAR_RAD2 = UNKNOWN_STD_RAD**2
# Nothing at all is known of g at first: large against any variance of a stride, small enough for the arithmetic.
_NO_IDEA_RAD2 = 1e4
# The first offset is 0 by definition, and as a measurement it needs a variance: 1 degree.
_DEFINED_RAD2 = math.radians(1.0) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """Mean (3,) and covariance (3, 3) of offset, frame and systematic error, rad."""

    mean: FloatArray = field(default_factory=lambda: np.zeros(3))
    cov: FloatArray = field(default_factory=lambda: np.diag([_DEFINED_RAD2, _NO_IDEA_RAD2, 0.0]))

    @property
    def var_rad2(self) -> float:
        """Variance of the heading offset in the track's frame."""
        return float(self.cov[OFFSET, OFFSET])

    @property
    def shown_rad(self) -> float:
        """The angle from the device's zero to the walking direction, as strides and axis show it."""
        return float(self.mean @ OF_AXIS)

    @property
    def shown_var_rad2(self) -> float:
        """Its variance; that of a uniform angle at most."""
        (offset_var, covariance, _), (_, frame_var, _), _ = self.cov.tolist()
        return min(offset_var + 2.0 * covariance + frame_var, UNKNOWN_VAR_RAD2)

    def wandered(self, var_rad2: float, stay: float, systematic_rad2: float) -> Offset:
        """After a while: the phone was turned a little against the body, and strides are off by something else.

        `stay` is the share of the systematic error that is left, and `systematic_rad2` the variance that it keeps.
        """
        keep = np.array([1.0, 1.0, stay])
        cov = self.cov * (keep[:, None] * keep)
        cov[OFFSET, OFFSET] += var_rad2
        cov[SYSTEMATIC, SYSTEMATIC] += (1.0 - stay * stay) * systematic_rad2
        return Offset(self.mean * keep, cov)

    def seen(self, of: FloatArray, toward: complex, var_rad2: float) -> Offset:
        """After a direction was seen: `of` says of which sum, `toward` points there, with a length of 1 on average.

        The mean goes to the direction of the sum of two von Mises likelihoods, e^(ia) / V + toward / r, which is that
        of a Kalman filter where both are narrow; a vector that is shorter than usual counts less.
        """
        predicted_rad = float(self.mean @ of)
        gain = self.cov @ of
        variance = float(gain @ of)
        turn = toward * cmath.exp(-1j * predicted_rad)
        innovation_rad = cmath.phase(1.0 / variance + turn / var_rad2)
        mean = self.mean + gain / variance * innovation_rad
        return Offset(mean, self.cov - gain[:, None] * gain / (variance + var_rad2))

    def moved(self, offset_rad: float, var_rad2: float, systematic_rad2: float) -> Offset:
        """In another place: the offset goes there with a variance more, and strides are off by something else."""
        cov = self.cov.copy()
        cov[SYSTEMATIC], cov[:, SYSTEMATIC] = 0.0, 0.0
        cov[SYSTEMATIC, SYSTEMATIC] = systematic_rad2
        cov[OFFSET, OFFSET] += var_rad2
        # no angle is less known than a uniform one
        if cov[OFFSET, OFFSET] > UNKNOWN_VAR_RAD2:
            scale = math.sqrt(UNKNOWN_VAR_RAD2 / cov[OFFSET, OFFSET])
            cov[OFFSET] *= scale
            cov[:, OFFSET] *= scale
        return Offset(np.array([offset_rad, self.mean[FRAME], 0.0]), cov)
