"""Steps and headings that the phone computed itself, at the times of detected steps."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import FloatArray, IntArray
from pdr_filter.values.samples import Samples

# A phone reports its first steps in groups of some seconds. A counter that begins with more steps counts since the
# phone was started.
_MOST_FIRST_STEPS = 50


def counted_steps(counter: Samples) -> Samples:
    """Return the steps since the start of the recording (N, 1), from the readings of the phone's step counter.

    A first reading up to 50 counts from the start of the recording. A reading below the one before it is of a counter
    that was reset, as in a later part of a recording that was cut in time.
    """
    known = _known(counter)
    counts = known.values[:, 0]
    added = np.diff(counts, prepend=np.inf)
    steps = np.cumsum(np.where(added >= 0, added, np.where(counts <= _MOST_FIRST_STEPS, counts, 0.0)))
    return Samples(known.time_s, steps[:, np.newaxis])


def phone_steps_at(counter: Samples | None, time_s: FloatArray) -> FloatArray:
    """Return the steps (K,) that the phone had counted at each time (K,), NaN before its first report.

    The result is empty without a counter.
    """
    return np.empty(0) if counter is None else _latest(counted_steps(counter), time_s)


def phone_heading_at(heading: Samples | None, time_s: FloatArray) -> FloatArray:
    """Return the latest heading (K,) that the phone had reported at each time (K,), NaN before the first one.

    It is in rad, in [-pi, pi). It is not interpolated, because a phone reports its heading when it changes. The result
    is empty without headings.
    """
    return np.empty(0) if heading is None else wrap_angle(_latest(_known(heading), time_s))


def _known(samples: Samples) -> Samples:
    known = np.isfinite(samples.time_s) & np.isfinite(samples.values[:, 0])
    return Samples(samples.time_s[known], samples.values[known])


def _latest(samples: Samples, time_s: FloatArray) -> FloatArray:
    order: IntArray = np.argsort(samples.time_s, kind="stable")
    index = np.searchsorted(samples.time_s[order], time_s, side="right")
    return np.append(np.nan, samples.values[order, 0])[index]
