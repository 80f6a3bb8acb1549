"""Usual tables that look like odd ones are read as what they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from app_files import axes, refusal, table_text
from table_cases import FORCE, RATE, TIME_S

from pdr_filter.data.io.formats import read

N = len(TIME_S)
MS = np.round(1000 * TIME_S) + 100_000
BOTH = axes("acc_%", FORCE) | axes("gyro_%", RATE)


def write(folder: Path, text: str, name: str = "walk.csv") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_times_in_the_order_of_arrival_are_no_times_between_samples(tmp_path: Path) -> None:
    swapped = np.arange(N)
    swapped[5:-1:14], swapped[6::14] = swapped[6::14].copy(), swapped[5:-1:14].copy()
    columns = {"timestamp": MS} | BOTH
    path = write(tmp_path, table_text({name: values[swapped] for name, values in columns.items()}))
    np.testing.assert_allclose(np.sort(read(path).accelerometer.time_s), TIME_S, atol=1e-3)


def test_a_time_that_a_spreadsheet_rounded_to_a_constant_is_no_time_between_samples(tmp_path: Path) -> None:
    assert "the times may be rounded" in refusal(write(tmp_path, table_text({"timestamp": ["1E+05"] * N} | BOTH)))
