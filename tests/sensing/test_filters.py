from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import firwin

from pdr_filter.sensing.signal_filters import (
    butterworth,
    filtered_rows,
    low_pass_kernel,
    phase_delay_s,
    running_sums,
    with_unit_gain,
)


def test_a_constant_passes_from_its_first_sample_on() -> None:
    rows = np.repeat([[3.0], [-1.0]], 50, axis=1)
    smooth, _ = filtered_rows(butterworth(10, 3.0, 100.0), rows, None)
    np.testing.assert_allclose(smooth, rows, atol=1e-9)


def test_the_phase_delay_is_how_much_later_a_sinusoid_leaves_the_filter() -> None:
    sos, frequency_hz, t = butterworth(10, 3.0, 100.0), np.linspace(0.01, 3.0, 300), np.arange(3000) / 100
    delay_s = float(np.interp(1.5, frequency_hz, phase_delay_s(sos, frequency_hz, 100.0)))
    smooth, _ = filtered_rows(sos, np.sin(2 * np.pi * 1.5 * t)[None], None)
    late = np.sin(2 * np.pi * 1.5 * (t[2000:] - delay_s))
    np.testing.assert_allclose(smooth[0, 2000:] / smooth[0, 2000:].max(), late, atol=0.01)


def test_a_kernel_has_unit_gain_at_rest_or_at_its_frequency() -> None:
    kernel = low_pass_kernel(4.0, 100.0)
    assert (len(kernel), kernel.sum()) == (25, pytest.approx(1.0))
    offset_s = (np.arange(25) - 12) / 100
    scaled = with_unit_gain(kernel, 2.0, 100.0)
    assert (scaled * np.cos(2 * np.pi * 2.0 * offset_s)).sum() == pytest.approx(1.0)


def test_a_kernel_has_the_bits_of_firwin() -> None:
    np.testing.assert_array_equal(low_pass_kernel(4.0, 100.0), firwin(25, 4.0, fs=100.0))


@pytest.mark.parametrize("n", [1, 2, 7, 8, 176])
def test_running_sums_are_those_of_a_box_and_have_the_same_bits_in_any_piece(n: int) -> None:
    rows = np.random.default_rng(n).normal(size=(2, 400))
    sums = running_sums(rows, n)
    box = [np.convolve(row, np.ones(n), mode="valid") for row in rows]
    np.testing.assert_allclose(sums, box, atol=1e-12)
    np.testing.assert_array_equal(running_sums(rows[:, 37 : 37 + n + 20], n), sums[:, 37:58])
