"""Causal filters that several stages share: their design, initial conditions and delays.

SciPy's signal processing is imported by the first recursive filter, because the import takes longer than a whole filter
without recursive filters, such as the default one.
"""

from __future__ import annotations

import numpy as np

from pdr_filter.values import FloatArray


def butterworth(order: int, cutoff_hz: float, rate_hz: float) -> FloatArray:
    """Return the second-order sections of a Butterworth low-pass.

    Parameters
    ----------
    order : int
        Order of the filter.
    cutoff_hz : float
        Cutoff frequency, Hz, at which the gain is 1 / sqrt(2).
    rate_hz : float
        Sampling rate, Hz.

    Returns
    -------
    (n_sections, 6) array
        Second-order sections in the layout of SciPy.

    Raises
    ------
    ValueError
        If the cutoff is not between 0 and half the rate.

    Examples
    --------
    >>> from pdr_filter.sensing.signal_filters import butterworth
    >>> butterworth(order=4, cutoff_hz=3.0, rate_hz=100.0).shape
    (2, 6)
    """
    from scipy.signal import butter

    if not 0 < cutoff_hz < 0.5 * rate_hz:
        raise ValueError(
            f"low_pass_hz must be positive and below half the rate, got {cutoff_hz} at {rate_hz} Hz: lower the cutoff "
            "or resample to a higher rate"
        )
    return np.asarray(butter(order, cutoff_hz, fs=rate_hz, output="sos"))


def filtered_rows(sos: FloatArray, rows: FloatArray, zi: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the filtered rows (R, N) and the new filter state (n_sections, R, 2).

    Parameters
    ----------
    sos : (n_sections, 6) array
        Second-order sections of the filter.
    rows : (R, N) array
        Signals, one in each row.
    zi : (n_sections, R, 2) array or None
        State after the previous samples. None means that these are the first samples. The filter then starts in the
        steady state of the first value, because a start at zero would act as an impulse.

    Returns
    -------
    rows : (R, N) array
        Filtered signals, in the unit of the signals.
    zi : (n_sections, R, 2) array
        State after the last sample, for the next call.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.signal_filters import butterworth, filtered_rows
    >>> rows, state = filtered_rows(butterworth(2, 3.0, 100.0), np.full((1, 4), 9.81), None)
    >>> rows.round(2), state.shape
    (array([[9.81, 9.81, 9.81, 9.81]]), (1, 1, 2))
    """
    from scipy.signal import sosfilt, sosfilt_zi

    before = np.asarray(sosfilt_zi(sos))[:, None, :] * rows[None, :, :1] if zi is None else zi
    return sosfilt(sos, rows, zi=before)


def phase_delay_s(sos: FloatArray, frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return the phase delay of a filter at given frequencies.

    Parameters
    ----------
    sos : (n_sections, 6) array
        Second-order sections of the filter.
    frequency_hz : (F,) array
        Positive frequencies, Hz. They must be close enough together for the phase to be unwrapped.
    rate_hz : float
        Sampling rate, Hz.

    Returns
    -------
    (F,) array
        Phase delay, s.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.signal_filters import butterworth, phase_delay_s
    >>> phase_delay_s(butterworth(2, 3.0, 100.0), np.array([1.0, 2.0]), 100.0).round(3)
    array([0.077, 0.082])
    """
    from scipy.signal import sosfreqz

    response = np.asarray(sosfreqz(sos, worN=frequency_hz, fs=rate_hz)[1])
    return -np.unwrap(np.angle(response)) / (2 * np.pi * frequency_hz)


def low_pass_kernel(cutoff_hz: float, rate_hz: float, length_s: float = 0.25) -> FloatArray:
    """Return a symmetric linear-phase low-pass kernel (Hamming window) of odd length with unit gain at zero frequency.

    Parameters
    ----------
    cutoff_hz : float
        Cutoff frequency f_c, Hz. Values above 0.45 of the rate count as 0.45 of the rate.
    rate_hz : float
        Sampling rate, Hz.
    length_s : float, default 0.25
        Length of the kernel, s. The default gives a transition band of 13 Hz. It merges the two maxima within one step
        and keeps the harmonics of steps.

    Returns
    -------
    (K,) array
        Kernel, whose values sum to one.

    Notes
    -----
    The kernel is h_k = w_k sin(2 pi f_c k) / k about the middle with the Hamming window w. It equals
    `scipy.signal.firwin` bit by bit.

    Examples
    --------
    >>> from pdr_filter.sensing.signal_filters import low_pass_kernel
    >>> kernel = low_pass_kernel(cutoff_hz=3.0, rate_hz=100.0)
    >>> len(kernel), round(float(kernel.sum()), 6)
    (25, 1.0)
    """
    half = round(0.5 * length_s * rate_hz)
    share = min(cutoff_hz, 0.45 * rate_hz) / (0.5 * rate_hz)
    hamming = 0.54 + (1 - 0.54) * np.cos(np.linspace(-np.pi, np.pi, 2 * half + 1))
    kernel = share * np.sinc(share * np.arange(-half, half + 1)) * hamming
    return np.asarray(kernel / kernel.sum())


def with_unit_gain(kernel: FloatArray, frequency_hz: float, rate_hz: float) -> FloatArray:
    """Return a symmetric kernel of odd length, scaled to unit gain at one frequency.

    Parameters
    ----------
    kernel : (K,) array
        Symmetric kernel of odd length.
    frequency_hz : float
        Frequency at which the gain becomes one, Hz.
    rate_hz : float
        Sampling rate, Hz.

    Returns
    -------
    (K,) array
        Scaled kernel.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.signal_filters import with_unit_gain
    >>> with_unit_gain(np.ones(5), frequency_hz=0.0, rate_hz=100.0)
    array([0.2, 0.2, 0.2, 0.2, 0.2])
    """
    offset_s = (np.arange(len(kernel)) - len(kernel) // 2) / rate_hz
    return np.asarray(kernel / np.sum(kernel * np.cos(2 * np.pi * frequency_hz * offset_s)))


def running_sums(rows: FloatArray, n: int) -> FloatArray:
    """Return the sums of n consecutive values, shape (..., N - n + 1), for signals of N samples (..., N).

    The sums of 2, 4, 8, ... values are each computed from two sums of half the length, and the sum of n values from
    these by the binary digits of n. A box of 176 samples takes 9 additions instead of 176. Unlike the difference of two
    cumulative sums, a result depends only on its own n values, which are always added in the same order.
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
