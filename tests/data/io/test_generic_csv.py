"""Any CSV with a mapping beside it, and the hint without one."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import GENERIC_MAPPING, T0_NS, a_walk, assert_same_streams, generic_text, on_one_clock, refusal

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples

WALK = on_one_clock(a_walk())
TEXT = generic_text(WALK)


def mapped(folder: Path, text: str = TEXT, mapping: str | None = GENERIC_MAPPING) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "walk.csv").write_text(text)
    if mapping is not None:
        (folder / "walk.toml").write_text(mapping)
    return folder / "walk.csv"


def test_a_walk_comes_back_in_si_units(tmp_path: Path) -> None:
    recording = read(mapped(tmp_path))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-8, rtol=1e-12)
    assert any("factor -9.80665" in line for line in reading_report(recording).found)


UNKNOWN = TEXT.replace("t;ax;ay;az;gx;gy;gz", "when;one;two;three;four;five;six")


def test_without_a_mapping_the_columns_and_a_mapping_to_write_are_shown(tmp_path: Path) -> None:
    message = refusal(mapped(tmp_path, UNKNOWN, mapping=None))
    assert "Columns seen: when, one, two, three, four, five, six" in message
    assert f"convert {tmp_path / 'walk.csv'} --map MAP.toml" in message
    shown = tomllib.loads(message[message.index("time = {") :])
    assert shown["time"]["column"] == "when"
    assert shown["accelerometer"]["columns"] == ["one", "two", "three"]


def test_the_mapping_that_is_shown_reads_the_file_once_its_units_are_right(tmp_path: Path) -> None:
    message = refusal(mapped(tmp_path, UNKNOWN, mapping=None))
    shown = message[message.index("time = {") :]
    shown = shown.replace('"s"', '"ms"').replace('"m/s2"', '"g"').replace('sign = "?"', "sign = -1")
    assert_same_streams(read(mapped(tmp_path, UNKNOWN, mapping=shown)), WALK, "accelerometer", time_s=1e-8)


def test_what_is_in_g_without_an_app_that_is_known_is_read_once_its_platform_is_said(tmp_path: Path) -> None:
    path = mapped(tmp_path, mapping=None)
    assert "say it with pdr-filter convert FILE --platform ios" in refusal(path)
    recording = read(path, platform="ios")  # milliseconds, g and deg/s are seen
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-8, rtol=1e-12)


def test_a_table_without_header_is_asked_for_one(tmp_path: Path) -> None:
    assert "write a line with the names" in refusal(mapped(tmp_path, TEXT.split("\n", 1)[1], None))


def test_nanoseconds_keep_their_last_digit(tmp_path: Path) -> None:
    time_ns = [T0_NS + 10_000_000 * i + i % 3 for i in range(100)]
    text = "ns,x,y,z\n" + "".join(f"{t},0.1,0.2,9.8\n" for t in time_ns)
    mapping = '[time]\ncolumn = "ns"\nunit = "ns"\n[accelerometer]\ncolumns = ["x", "y", "z"]\n'
    recording = read(mapped(tmp_path, text, mapping))
    np.testing.assert_array_equal(
        np.round(recording.accelerometer.time_s * 1e9).astype(np.int64), np.array(time_ns) - T0_NS
    )


def test_time_zero_is_the_first_sample_that_has_a_time(tmp_path: Path) -> None:
    header, first, *rows = TEXT.splitlines()
    for i, unknown in enumerate(("", "inf", "1e300")):
        text = "\n".join([header, ";".join([unknown, *first.split(";")[1:]]), *rows]) + "\n"
        recording = read(mapped(tmp_path / str(i), text))
        assert recording.accelerometer.time_s[0] == 0
        assert len(recording.accelerometer) == len(WALK.accelerometer) - 1


def test_rows_at_a_fixed_rate_need_no_time_column(tmp_path: Path) -> None:
    mapping = GENERIC_MAPPING.replace('column = "t"\nunit = "ms"', "rate_hz = 100")
    recording = read(mapped(tmp_path, mapping=mapping))
    np.testing.assert_allclose(recording.accelerometer.time_s, np.arange(len(WALK.accelerometer)) / 100)


@pytest.mark.parametrize(("rate_hz", "is_said"), [(20, True), (25, False)])
def test_a_rate_below_that_of_the_tests_of_the_steps_has_a_note(tmp_path: Path, rate_hz: int, is_said: bool) -> None:
    mapping = GENERIC_MAPPING.replace('column = "t"\nunit = "ms"', f"rate_hz = {rate_hz}")
    assert any("accelerometer: 20.0 Hz" in note for note in read(mapped(tmp_path, mapping=mapping)).notes) == is_said


def test_sensors_of_different_rates_leave_fields_empty(tmp_path: Path) -> None:
    lines = TEXT.splitlines()
    thinned = [line if i % 2 == 1 else ";".join([*line.split(";")[:4], "", "", ""]) for i, line in enumerate(lines[1:])]
    recording = read(mapped(tmp_path, "\n".join([lines[0], *thinned]) + "\n"))
    assert len(recording.accelerometer) == len(WALK.accelerometer)
    np.testing.assert_allclose(recording.gyroscope.values, WALK.gyroscope.values[1::2], atol=1e-12)


def test_decimal_commas_are_read_if_the_mapping_says_so(tmp_path: Path) -> None:
    mapping = '[file]\nseparator = ";"\ndecimal = ","\n' + GENERIC_MAPPING
    recording = read(mapped(tmp_path, TEXT.replace(".", ","), mapping))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ('"ax"', '"nowhere"', "'nowhere' is in the table 0 times (columns: t, ax"),
        ('"g"', '"stone"', "unit is 'stone'; write one of m/s2, g, mg"),
        ('"g"', '["g"]', "write one of m/s2, g, mg"),
        ('"ms"', '"fortnight"', "time unit is 'fortnight'"),
        ("sign = -1", "sign = 7", "sign is 7; write 1, or -1 if a phone lying face up reads negative on z"),
        ("[gyroscope]", "[giroscope]", "unknown table 'giroscope'"),
        ('["ax", "ay", "az"]', '["ax"]', "columns is ['ax']; write 3 names"),
        ('column = "t"', "", "write column = ... or rate_hz"),
        ('column = "t"', 'rate_hz = "50"', "rate_hz is '50'; write a number"),
        ("[time]", '[attitude]\ncolumns = ["a", "b", "c", "d"]\nunit = "deg"\n[time]', "unit is 'deg'; leave it out"),
        ("[time]", "[time", "not TOML"),
        ("[accelerometer]", "[magnetometer]", "no [accelerometer]"),
        ("[time]", "[file]\nseparator = ','\ndecimal = ','\n[time]", "do not fit; write ';' and ','"),
    ],
)
def test_a_mapping_that_does_not_fit_is_refused_with_what_would(tmp_path: Path, old: str, new: str, hint: str) -> None:
    assert hint in refusal(mapped(tmp_path, mapping=GENERIC_MAPPING.replace(old, new, 1)))


def test_a_format_can_be_forced(tmp_path: Path) -> None:
    path = mapped(tmp_path)
    assert len(read(path, "generic_csv").accelerometer) == len(WALK.accelerometer)
    assert refusal(path, "get_sensor_data")


def test_a_mapping_of_an_acceleration_without_gravity_restores_it(tmp_path: Path) -> None:
    force = WALK.accelerometer.values
    linear = Samples(WALK.accelerometer.time_s, force - force.mean(axis=0))
    text = generic_text(replace(WALK, accelerometer=linear))
    recording = read(mapped(tmp_path, text, GENERIC_MAPPING.replace("[accelerometer]", "[linear_acceleration]")))
    assert np.linalg.norm((recording.accelerometer.values - force).mean(axis=0)) < 2.5
    assert "lacks gravity" in recording.notes[0]
