"""Filters of earlier formats continue their walks.

The files were saved by the code of each format: 6 by version 0.2.0, 7 to 11 by commits 25e4afb1^, 25e4afb1, b9ec2df3,
bba98d9c and 7d516332. Each filter has seen `samples(0.0, 3.5)`. Its configuration is the default one with small context
models.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.values.saved_bytes import decompressed
from pdr_filter.values.saved_formats import EARLIER_FORMATS

FOLDER = Path(__file__).parent / "saved_filters"


def samples(begin_s: float, end_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, specific force and angular rate of a walk whose strides are equal."""
    i = np.arange(round(begin_s * 100), round(end_s * 100))
    step, stride = 2 * np.pi * (i % 50) / 50, 2 * np.pi * (i % 100) / 100
    force = (
        0.5 * np.sin(stride),
        1.2 * np.cos(step + 1.5) + 0.4 * np.cos(stride),
        9.81 + 2.5 * np.sin(step) + 0.8 * np.sin(2 * step),
    )
    rate = 0.3 * np.sin(stride), 0.2 * np.cos(stride), 0.1 * np.sin(stride)
    return i / 100, np.column_stack(force), np.column_stack(rate)


def test_there_is_a_file_of_each_earlier_format() -> None:
    assert {path.name for path in FOLDER.iterdir()} == {f"format_{n}.bin" for n in EARLIER_FORMATS}


@pytest.mark.parametrize("number", EARLIER_FORMATS)
def test_a_filter_of_an_earlier_format_ends_where_a_filter_of_the_whole_walk_ends(number: int) -> None:
    blob = (FOLDER / f"format_{number}.bin").read_bytes()
    assert decompressed(blob, 1 << 26)[0].startswith(b'{"format": %d,' % number)
    resumed = pdr.OnlineFilter.load(blob)
    assert resumed.now().n_steps == 5
    resumed.push(*samples(3.5, 8.0))
    resumed = pdr.OnlineFilter.load(resumed.save())
    whole = pdr.OnlineFilter(resumed.config)
    whole.push(*samples(0.0, 8.0))
    assert resumed.now().n_steps == whole.now().n_steps > 12
    np.testing.assert_allclose(resumed.now().position_m, whole.now().position_m, atol=1e-3)
    np.testing.assert_allclose(resumed.now().position_cov_m2, whole.now().position_cov_m2, rtol=1e-3)
    np.testing.assert_allclose(resumed.path().position_m, whole.path().position_m, atol=1e-3)
