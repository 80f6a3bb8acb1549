"""Times of tables: dates, clocks, units that nobody says, and what a spreadsheet makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from app_files import axes, physics_toolbox_text, refusal, table_text, wall_clock, write_text
from table_cases import FORCE, FORCE_G, RATE, TIME_S, WALK

from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_guessed
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.values.errors import RecordingError


def test_a_digit_that_is_no_number_is_no_time(tmp_path: Path) -> None:
    text = physics_toolbox_text(WALK)
    header, first, rest = text.split("\n", 2)
    damaged = "17879233041\u00b27456789" + first[first.index(",") :]
    (tmp_path / "walk.csv").write_text("\n".join([header, damaged, rest]), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"walk.csv: "):
        read(tmp_path / "walk.csv")


@pytest.mark.parametrize(
    "style", ["{m:02d}:{s:04.1f}", "18:{m:02d}", "18:{m:02d}:{s:02.0f}", "8/12/2022 18:{m:02d}", "{t:.0f}"]
)
def test_times_that_a_spreadsheet_rounded_are_refused_with_what_happened(tmp_path: Path, style: str) -> None:
    times = [style.format(t=t // 1, m=int(t // 60), s=t // 0.1 / 10 % 60) for t in TIME_S]
    (tmp_path / "walk.csv").write_text(table_text({"time": times} | axes("gF%", FORCE_G) | axes("w%", RATE)))
    assert "the times may be rounded, as a spreadsheet does" in refusal(tmp_path / "walk.csv")


def test_rows_that_are_there_twice_are_refused_as_repeated_rows(tmp_path: Path) -> None:
    columns = {"time_s": TIME_S} | axes("acc_%", FORCE) | axes("gyro_%", RATE)
    head, *rows = table_text(columns).splitlines(keepends=True)
    (tmp_path / "walk.csv").write_text(head + "".join(2 * row for row in rows))
    message = refusal(tmp_path / "walk.csv")
    assert "rows are repeated, with the same times and values; keep one of each" in message
    assert "rounded" not in message


def test_a_gyroscope_on_another_clock_is_refused_with_its_file_and_column(tmp_path: Path) -> None:
    """With the time column of the accelerometer in the mapping, the recording is usable."""
    times = {"acc_time (s)": TIME_S}, {"gyro_time (ms)": 1e6 + 1000 * TIME_S}
    text = table_text(times[0] | axes("acc_%", FORCE) | times[1] | axes("gyro_%", RATE))
    path = write_text(tmp_path / "walk.csv", text)
    with pytest.raises(RecordingError) as refused:
        merge_streams(read(path))
    assert str(refused.value).startswith(f"{path}: gyroscope: its times, 1000.0 to ")
    assert "column 'gyro_time (ms)', in ms" in str(refused.value)
    own, shared = ('time = "gyro_time (ms)", time_unit = "ms"', 'time = "acc_time (s)", time_unit = "s"')
    mapping = read_guessed(path).guess.mapping.toml()
    assert own in mapping
    write_text(tmp_path / "walk.toml", mapping.replace(own, shared))
    assert np.isfinite(merge_streams(read(path)).angular_rate_radps).all()


@pytest.mark.parametrize("up_s", [5.0, 172.0, 1_500.0, 172_029.0])
def test_nanoseconds_since_the_phone_was_started_are_known_by_the_rate(tmp_path: Path, up_s: float) -> None:
    times = [str(round((up_s + t) * 1e9)) for t in TIME_S]
    at_s = read_text(tmp_path, {"event.timestamp": times} | axes("acc_%", FORCE))
    np.testing.assert_allclose(at_s, TIME_S, atol=1e-8)


def test_milliseconds_that_are_declared_are_believed_at_2_hz(tmp_path: Path) -> None:
    columns = {k.upper(): v for k, v in axes("ACCE%", FORCE[:100]).items()}
    text = table_text({**columns, "Time since start in ms ": 500.0 * np.arange(100)})
    (tmp_path / "walk.csv").write_text(text)
    message = refusal(tmp_path / "walk.csv")
    assert "a rate of 2 Hz" in message
    assert "look like" not in message
    assert "AndroSensor" in message


def test_a_clock_goes_on_at_midnight(tmp_path: Path) -> None:
    time_s = read_text(tmp_path, {"time": [d[12:] for d in wall_clock(TIME_S)]} | axes("gF%", FORCE_G))
    assert time_s[0] == 0
    assert time_s[-1] == pytest.approx(TIME_S[-1], abs=1e-6)
    assert np.diff(time_s).min() > 0


def read_text(folder: Path, columns: dict[str, np.ndarray | list[str]]) -> np.ndarray:
    (folder / "walk.csv").write_text(table_text(columns))
    return read(folder / "walk.csv").accelerometer.time_s


@pytest.mark.parametrize(
    "style", ["{d} {t}", "{d}T{t}Z", "{d} {t} +0530", "{d}T{t}+02:00", "{eu} {t}", "{d} {colon}", "{us} {t}"]
)
def test_dates_are_read_however_they_are_written(tmp_path: Path, style: str) -> None:
    begin = np.datetime64("2024-02-27T22:59:50.000001", "us")
    stamps = [str(begin + np.timedelta64(round(t * 1e6), "us")) for t in TIME_S.tolist()]
    dates = []
    for stamp in stamps:
        d, t = stamp.split("T")
        y, m, day = d.split("-")
        dates.append(style.format(d=d, t=t, eu=f"{day}.{m}.{y}", us=f"{m}/{day}/{y}", colon=t.replace(".", ":")))
    time_s = read_text(tmp_path, {"date": dates} | axes("gF%", FORCE_G))
    np.testing.assert_allclose(time_s, TIME_S, atol=1e-6)


def test_a_clock_of_twelve_hours_goes_on_at_noon(tmp_path: Path) -> None:
    at = [np.datetime64("2024-02-27T11:59:58.000000", "us") + np.timedelta64(round(t * 1e6), "us") for t in TIME_S]
    clock = [stamp.astype(object).strftime("%I:%M:%S.%f %p") for stamp in at]
    assert {text[-2:] for text in clock} == {"AM", "PM"}
    np.testing.assert_allclose(read_text(tmp_path, {"time": clock} | axes("gF%", FORCE_G)), TIME_S, atol=1e-6)
