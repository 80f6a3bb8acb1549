"""Causal filters that several stages share: how they are designed, how they start and how late they are.

SciPy's signal processing is loaded by the first recursive filter: it takes longer to import than all of a filter that
has none, as the default.
"""

from __future__ import annotations

import numpy as np

from pdr_filter.values import FloatArray


def butterworth(order: int, cutoff_hz: float, rate_hz: float) -> FloatArray:
    """Second-order sections of a Butterworth low-pass."""
    from scipy.signal import butter

    if not 0 < cutoff_hz < 0.5 * rate_hz:
        raise ValueError(
            f"low_pass_hz must be below half the rate, got {cutoff_hz} at {rate_hz} Hz: resample to a higher rate or "
            "lower the cutoff"
        )
    return np.asarray(butter(order, cutoff_hz, fs=rate_hz, output="sos"))


def filtered(sos: FloatArray, rows: FloatArray, zi: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Filtered rows (R, N) and the new memory (n_sections, R, 2); without a memory these are the first samples.

    What was before the first sample is assumed to be like it: a zero there would look like a blow.
    """
    from scipy.signal import sosfilt, sosfilt_zi

    before = np.asarray(sosfilt_zi(sos))[:, None, :] * rows[None, :, :1] if zi is None else zi
    return sosfilt(sos, rows, zi=before)


def phase_delay_s(sos: FloatArray, frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """How much later a sinusoid leaves the filter, (F,), s; frequencies so close that the phase can be unwrapped."""
    from scipy.signal import sosfreqz

    response = np.asarray(sosfreqz(sos, worN=frequency_hz, fs=rate_hz)[1])
    return -np.unwrap(np.angle(response)) / (2 * np.pi * frequency_hz)


def low_pass_kernel(cutoff_hz: float, rate_hz: float, length_s: float = 0.25) -> FloatArray:
    """Linear-phase low-pass (Hamming window): symmetric, odd length, unit gain at rest.

    The default of 0.25 s rolls off within 13 Hz: it joins the two humps of one step and keeps the harmonics of the
    next. h_k = w_k sin(2 pi f_c k) / k about the middle, w the Hamming window: `scipy.signal.firwin`, bit by bit.
    """
    half = round(0.5 * length_s * rate_hz)
    share = min(cutoff_hz, 0.45 * rate_hz) / (0.5 * rate_hz)
    hamming = 0.54 + (1 - 0.54) * np.cos(np.linspace(-np.pi, np.pi, 2 * half + 1))
    kernel = share * np.sinc(share * np.arange(-half, half + 1)) * hamming
    return np.asarray(kernel / kernel.sum())


def with_unit_gain(kernel: FloatArray, frequency_hz: float, rate_hz: float) -> FloatArray:
    """A symmetric kernel of odd length, scaled to unit gain at a frequency."""
    offset_s = (np.arange(len(kernel)) - len(kernel) // 2) / rate_hz
    return np.asarray(kernel / np.sum(kernel * np.cos(2 * np.pi * frequency_hz * offset_s)))


def running_sums(rows: FloatArray, n: int) -> FloatArray:
    """Sums of n values in a row, (..., N - n + 1) of rows (..., N), each added up in the same order.

    Of 1, 2, 4 ... values, each of two shorter ones; n is a sum of these. A box of 176 samples takes 9 additions, not
    176, and unlike a cumulative sum nothing of what was before.
    """
    size, start, n_sums = 1, 0, rows.shape[-1] - n + 1
    total: FloatArray = np.zeros((*rows.shape[:-1], n_sums))
    while True:
        if n & size:
            total = total + rows[..., start : start + n_sums]
            start += size
        if 2 * size > n:
            return total
        rows = rows[..., :-size] + rows[..., size:]
        size *= 2
