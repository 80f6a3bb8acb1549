"""Dates of tables: the quick way gives the numbers of the plain one, or leaves it to that."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.data.io.tables.dates import (
    as_nanoseconds,
    column_nanoseconds,
    is_date,
    nanoseconds_of,
    without_midnights,
)

STYLES = (
    *("%Y-%m-%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S", "%Y-%m-%dT%H:%M:%S_%f", "%H:%M:%S.%f"),
    *("%d/%m/%Y %H:%M", "%M:%S.%f", "%S.%f sec"),
)


@pytest.mark.parametrize("style", STYLES)
@given(start=st.datetimes(datetime(1971, 1, 1), datetime(2099, 1, 1)), place=st.integers(0, 2), days=st.booleans())
def test_a_column_of_dates_is_read_as_each_of_them(style: str, start: datetime, place: int, days: bool) -> None:
    steps = [timedelta(days=i * days, microseconds=5003 * i) for i in range(20)]
    dates = [(start + step).strftime(style) for step in steps]
    rows = [[f"{i}.5", f"-{i}"] for i in range(20)]
    for row, date in zip(rows, dates, strict=True):
        row.insert(place, date)
    text = "".join(";".join(row) + "\n" for row in rows).encode()
    quick = column_nanoseconds(text, b";", place)
    plain = [int(line.split(b";")[place]) for line in as_nanoseconds(text, b";", place).splitlines()]
    assert quick.tolist() == plain == [nanoseconds_of(date) for date in dates]
    if "%d" in style and "%f" in style:
        expected = [(start + step).replace(tzinfo=UTC).timestamp() for step in steps]
        np.testing.assert_allclose(quick * 1e-9, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        b"2023-03-16 14:00:00.1,1\n2023-03-16 14:00:00.12,1\n",  # of another width
        b"2023-03-16 14:00:00,1\n2023-03-16 14:00:0x,1\n",
        b"2023-03-16 14:00:00,1\n2023-03-16x14:00:00,1\n",
        b"2023-03-16 14:00:00,1\n\n2023-03-16 14:00:01,1\n",
        b"2023-03-16 14:00:00,1\n2023-03-16 14:00:01,1",
        b"2023-03-16 14:00:00,1,2\n2023-03-16 14:00:01\n",
        b'"2023-03-16 14:00:00",1\n"2023-03-16 14:00:01",1\n',
        b"2023-03-16 14:00:00+01:00,1\n2023-03-16 14:00:01+01:00,1\n",
        b"1,2\n3,4\n",
        b"".join(b"2023-%02d-%02d 14:00:00,1\n" % (1 + i % 12, 1 + i % 28) for i in range(100)),  # of many days
        b"",
    ],
)
def test_what_is_not_alike_is_left_to_the_plain_way(text: bytes) -> None:
    assert column_nanoseconds(text, b",", 0) is None


def test_a_clock_that_begins_anew_at_midnight_goes_on_and_a_date_stays() -> None:
    clock = np.array([nanoseconds_of(text) for text in ("23:59:59.5", "00:00:00.5", "00:00:01.0")])
    assert np.diff(without_midnights(clock)).tolist() == [10**9, 5 * 10**8]
    dates = np.array([nanoseconds_of("2024-01-02 00:00:00"), nanoseconds_of("2024-01-01 00:00:00")])
    np.testing.assert_array_equal(without_midnights(dates), dates)


def test_minutes_and_seconds_go_on_at_the_full_hour() -> None:
    clock = np.array([nanoseconds_of(text) for text in ("59:59.5", "00:00.5", "00:01.0")])
    assert np.diff(without_midnights(clock)).tolist() == [10**9, 5 * 10**8]


@pytest.mark.parametrize("text", ["16-Mrz-2023 14:00:00", "16-mar-2023 14:00:00", "16.03.2023 14:00"])
def test_months_of_other_languages_and_dates_of_spreadsheets_are_known(text: str) -> None:
    assert nanoseconds_of(text) == nanoseconds_of("2023-03-16 14:00:00")


@pytest.mark.parametrize("text", ["", "12", "2023-03-16", "1.5", "a:b:c", "Tue 12:00"])
def test_what_is_no_date_is_none(text: str) -> None:
    assert not is_date(text)


def test_a_month_that_does_not_exist_is_refused() -> None:
    for text in ("16-Mae-2023 14:00:00", "9999-03-16 14:00:00"):
        with pytest.raises(ValueError, match="no date from 1900 to 2200"):
            nanoseconds_of(text)
