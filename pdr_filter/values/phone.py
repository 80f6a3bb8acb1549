"""Steps and headings that the phone computed itself, at the times of detected steps."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import FloatArray, IntArray
from pdr_filter.values.samples import Samples

# A phone reports its first steps in groups of some seconds. A counter that begins with more steps counts since the
# phone was started.
_MOST_FIRST_STEPS = 50


def counted_steps(counter: Samples, last: float = np.inf, n_before: float = 0.0) -> Samples:
    """Return the steps since the start of the recording (N, 1), from the readings of the phone's step counter.

    `last` is the reading before these ones, at which `n_before` steps had been counted.

    A first reading up to 50 counts from the start of the recording. A reading below the one before it is of a counter
    that was reset, as in a later part of a recording that was cut in time.
    """
    known = _known(counter)
    counts = known.values[:, 0]
    added = np.diff(counts, prepend=last)
    steps = n_before + np.cumsum(np.where(added >= 0, added, np.where(counts <= _MOST_FIRST_STEPS, counts, 0.0)))
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


class PhoneReports:
    """Steps and headings of a phone that are received in parts. Only those that a later step can need are kept."""

    def __init__(self, has_steps: bool, has_headings: bool) -> None:
        self._steps = Samples(np.empty(0), np.empty((0, 1))) if has_steps else None
        self._heading = Samples(np.empty(0), np.empty((0, 1))) if has_headings else None
        self._last, self._n_steps = np.inf, 0.0

    def add(self, counter: Samples | None, heading: Samples | None) -> None:
        """Add the samples of the next part."""
        if counter is not None and len(known := _known(counter)):
            steps = counted_steps(known, self._last, self._n_steps)
            self._last, self._n_steps = float(known.values[-1, 0]), float(steps.values[-1, 0])
            self._steps = _joined(self._steps, steps)
        if heading is not None:
            self._heading = _joined(self._heading, _known(heading))

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the steps and headings at ascending times (K,), as `phone_steps_at` and `phone_heading_at` do.

        Reports that are no longer the latest at the last of these times are released.
        """
        steps = np.empty(0) if self._steps is None else _latest(self._steps, time_s)
        heading = phone_heading_at(self._heading, time_s)
        if len(time_s):
            self._steps, self._heading = (_from_latest(kept, time_s[-1]) for kept in (self._steps, self._heading))
        return steps, heading


def _joined(before: Samples | None, samples: Samples) -> Samples:
    if before is None:
        return samples
    return Samples(np.concatenate([before.time_s, samples.time_s]), np.concatenate([before.values, samples.values]))


def _from_latest(samples: Samples | None, time_s: float) -> Samples | None:
    """Return the samples from the latest one at a time. Samples are in order of time."""
    if samples is None:
        return None
    first = max(int(samples.time_s.searchsorted(time_s, side="right")) - 1, 0)
    return Samples(samples.time_s[first:], samples.values[first:])


def _known(samples: Samples) -> Samples:
    known = np.isfinite(samples.time_s) & np.isfinite(samples.values[:, 0])
    return Samples(samples.time_s[known], samples.values[known])


def _latest(samples: Samples, time_s: FloatArray) -> FloatArray:
    order: IntArray = np.argsort(samples.time_s, kind="stable")
    index = np.searchsorted(samples.time_s[order], time_s, side="right")
    return np.append(np.nan, samples.values[order, 0])[index]
