"""Step-length models M1 to M7 of Zhou et al. 2019, by their names in the paper."""

from pdr_filter.filter.step_length.models import (
    FrequencyStepLength,
    FrequencyVarianceStepLength,
    KimStepLength,
    MagnitudeRangeStepLength,
    PeriodPeakStepLength,
    TianStepLength,
    ZhouWalkingStepLength,
)

M1 = FrequencyStepLength  # eq. 7
M2 = FrequencyVarianceStepLength  # eq. 8
M3 = PeriodPeakStepLength  # eq. 9
M4 = MagnitudeRangeStepLength  # eq. 10
M5 = TianStepLength  # eq. 11
M6 = KimStepLength  # eq. 12
M7 = ZhouWalkingStepLength  # eq. 14, the walking half; the running half is M6
