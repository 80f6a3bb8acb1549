"""Strides where few people were measured: what people elsewhere, or another person, say of them.

For `stride_harmonics`, which says why.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pdr_filter.simulate.strides import ComplexArray, Strides
from pdr_filter.values import FloatArray
from tests.benchmarks.common import recordings

RATE_HZ = 100.0
N_PHASES = 64
N_SIZED = 10  # harmonics of a swinging hand that are not noise


def halfway(table: Strides, people: Strides) -> Strides:
    """People of another place, each halfway to the one who was measured here."""
    return replace(people, people=0.5 * (people.people + table.people))


def towards_sizes(table: Strides, size: FloatArray) -> Strides:
    """One person's table with forces (N_SIZED, 2), vertical and horizontal, halfway to those of somebody else."""
    own = np.abs(table.people[0, :N_SIZED])
    factor = np.ones(table.people.shape[1:])
    factor[:N_SIZED, 2] = np.sqrt(size[:, 0] / own[:, 2])
    factor[:N_SIZED, :2] = np.sqrt(size[:, 1] / np.linalg.norm(own[:, :2], axis=1))[:, None]
    return table.scaled(factor)


def sizes_of_oxford(data: Path, pattern: str) -> FloatArray:
    """Vertical and horizontal amplitudes (N_SIZED, 2) of the mean stride between foot contacts, in parts of the
    vertical one at step frequency; the mean over recordings."""
    found: list[FloatArray] = []
    for recording in recordings(data, "oxford", pattern):
        assert recording.truth.steps is not None
        samples, contact_s = recording.accelerometer, np.asarray(recording.truth.steps.time_s)
        time_s = np.arange(samples.time_s[0], samples.time_s[-1], 1 / RATE_HZ)
        force = np.column_stack([np.interp(time_s, samples.time_s, c) for c in samples.values.T])
        up = sosfiltfilt(butter(2, 0.3, fs=RATE_HZ, output="sos"), force, axis=0)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        vertical = (force * up).sum(axis=1)
        across = np.linalg.svd(up.mean(axis=0)[None])[2][1:]
        signals = np.column_stack([vertical, (force - vertical[:, None] * up) @ across.T])
        stride_s = 2 * np.median(np.diff(contact_s))
        harmonics: list[ComplexArray] = []
        for start_s, end_s in zip(contact_s[:-2:2], contact_s[2::2], strict=True):
            if abs(end_s - start_s - stride_s) < 0.12 * stride_s:
                at_s = np.linspace(start_s, end_s, N_PHASES + 1)
                course = np.column_stack([np.interp(at_s, time_s, c) for c in signals.T])
                course -= (course[-1] - course[0]) * np.arange(N_PHASES + 1)[:, None] / N_PHASES
                harmonics.append(np.fft.fft(course[:-1], axis=0)[1 : N_SIZED + 1])
        size = np.abs(np.mean(harmonics, axis=0))
        found.append(np.column_stack([size[:, 0], np.hypot(size[:, 1], size[:, 2])]) / size[1, 0])
    return np.mean(found, axis=0)
