"""Step-length models M1 to M7 of Zhou et al. 2019, with the numbers of their equations.

The classes are in `filter.step_length.models`. L is the length of a step in m, f the step frequency in Hz, h the body
height in m, and a = |f| - g the acceleration in m/s2 over the samples of the step. The parameters k, k0, k1, ... are
theta of a `StepLengthFit`. The paper prints no values. `recipe` has values for M7, and `pdr_filter.calibrate` fits the
parameters of any model to known distances.
"""

from pdr_filter.filter.step_length.models import (
    FrequencyStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    MagnitudeRangeStepLength,
    PeriodPeakStepLength,
    TianStepLength,
    ZhouWalkingStepLength,
)

M1 = FrequencyStepLength  # eq. 7: L = k0 + k1 f
M2 = FrequencyVarianceStepLength  # eq. 8: L = k0 + k1 f + k2 var(a)
M3 = PeriodPeakStepLength  # eq. 9: L = k0 + k1 / f + k2 max(a)
M4 = MagnitudeRangeStepLength  # eq. 10: L = k (max(a) - min(a))^(1/4)
M5 = TianStepLength  # eq. 11: L = k h sqrt(f)
M6 = KimStepLength  # eq. 12: L = k (mean |a|)^(1/3)
M7 = ZhouWalkingStepLength  # eq. 14, walking: L = k0 + k1 / f + k2 / sqrt(f) + k3 max(a); running: M6
