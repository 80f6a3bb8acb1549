"""Wi-Fi in files: what is read, what is left out, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import T0_MS, a_walk, get_sensor_data_text, indoor_location_text, refusal, write_text

from pdr_filter.data.io.describe import describe
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.formats import read
from pdr_filter.values import Wifi
from pdr_filter.values.recording import Recording

WALK = a_walk()
HEARD = Wifi(
    np.array([-0.09, 0.25, 0.25]), np.array([0x06749C2E95EA, 1, 2**48 - 1]), [-80, -61.5, -30], [2412, np.nan, 5805]
)


def with_rows(tmp_path: Path, rows: str) -> Path:
    folder = write_recording(WALK, tmp_path / "walk")
    (folder / "wifi.csv").write_text("time_s,bssid,rssi_dbm,frequency_mhz\n" + rows, encoding="utf-8")
    return folder


def assert_same(found: Wifi | None, expected: Wifi) -> None:
    assert found is not None
    for name in ("time_s", "bssid", "rssi_dbm", "frequency_mhz"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-6, err_msg=name)


def test_wifi_that_was_written_is_read_back(tmp_path: Path) -> None:
    recording = read(write_recording(replace(WALK, wifi=HEARD), tmp_path / "w.zip"))
    assert_same(recording.wifi, HEARD)
    again = write_recording(recording, tmp_path / "again.zip")
    assert again.read_bytes() == (tmp_path / "w.zip").read_bytes()
    assert "wifi" in repr(recording)
    assert any("3 access points in 1 scans, 3 rows" in line for line in describe(recording).units)


def test_wifi_of_another_recording_is_not_left_in_its_folder(tmp_path: Path) -> None:
    write_recording(replace(WALK, wifi=HEARD), tmp_path / "w")
    assert read(write_recording(WALK, tmp_path / "w")).wifi is None


def test_addresses_may_be_hidden_by_a_hash(tmp_path: Path) -> None:
    recording = read(with_rows(tmp_path, f"0.5,{'0a1b2c3d4e5f' + 28 * '7'},-60,2412\n"))
    assert recording.wifi.bssid.tolist() == [0x0A1B2C3D4E5F]


def test_rows_that_cannot_be_used_are_left_out_with_a_note(tmp_path: Path) -> None:
    good = "0.5,aa:bb:cc:dd:ee:ff,-60,2412\n"
    bad = (
        ",aa:bb:cc:dd:ee:ff,-60,2412\n0.6,,-60,2412\n0.7,aa:bb:cc:dd:ee:ff,,\n0.8,aa:bb:cc:dd:ee:ff,600,\n0.9,-1,-60,\n"
    )
    recording = read(with_rows(tmp_path, good + bad))
    assert len(recording.wifi) == 1
    assert any("5 rows without a time, an address or a power in dBm left out" in note for note in recording.notes)


def test_what_was_heard_once_and_reported_twice_is_there_once(tmp_path: Path) -> None:
    row = "0.5,aa:bb:cc:dd:ee:ff,-60,2412\n"
    recording = read(with_rows(tmp_path, row + row + row.replace("0.5", "0.6")))
    np.testing.assert_array_equal(recording.wifi.time_s, [0.5, 0.6])


@pytest.mark.parametrize("rows", ["0.5,no address,-60,2412\n", "0.5,aa:bb:cc:dd:ee,-60,2412\n"])
def test_an_address_that_is_none_is_refused_by_line_and_column(tmp_path: Path, rows: str) -> None:
    assert "line 2, column bssid" in refusal(with_rows(tmp_path, rows))


def test_an_empty_table_is_no_wifi(tmp_path: Path) -> None:
    assert read(with_rows(tmp_path, "")).wifi is None


def indoor(tmp_path: Path, lines: str) -> Recording:
    text = indoor_location_text(WALK)
    text = "".join(line for line in text.splitlines(keepends=True) if "TYPE_WIFI" not in line)
    return read(write_text(tmp_path / "w.txt", text.replace("#\tendTime", lines + "#\tendTime")))


def test_indoor_location_says_when_it_was_heard_and_names_may_be_anything(tmp_path: Path) -> None:
    name = 'odd "net\twork;'
    lines = "".join(
        f"{T0_MS + 3000}\tTYPE_WIFI\t{name}\taa:bb:cc:dd:ee:0{i}\t-6{i}\t2412\t{T0_MS + 1000 + i}\n" for i in range(4)
    )
    recording = indoor(tmp_path, lines)
    wifi = recording.wifi
    zero_s = WALK.accelerometer.time_s[0]
    np.testing.assert_allclose(wifi.time_s, 1.0 + np.arange(4) * 1e-3 - zero_s, atol=1.1e-3)
    np.testing.assert_array_equal(wifi.rssi_dbm, [-60, -61, -62, -63])
    assert recording.notes == ()


def test_times_of_another_clock_are_replaced_by_those_of_the_reports(tmp_path: Path) -> None:
    lines = f"{T0_MS + 3000}\tTYPE_WIFI\tnet\taa:bb:cc:dd:ee:ff\t-60\t2412\t123456\n"
    recording = indoor(tmp_path, lines)
    np.testing.assert_allclose(recording.wifi.time_s, [3.0 - WALK.accelerometer.time_s[0]], atol=1.1e-3)
    assert any("not on the clock of the reports" in note for note in recording.notes)


def test_get_sensor_data_moves_the_time_of_hearing_to_the_clock_of_the_app(tmp_path: Path) -> None:
    text = get_sensor_data_text(WALK)
    lines = 'WIFI;3.000;81236.000;"a;b;aa:bb:cc:dd:ee:ff;-61\nWIFI;3.000;81236.500;c;aa:bb:cc:dd:ee:00;-70;5180\n'
    text = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("WIFI")) + lines
    wifi = read(write_text(tmp_path / "w.txt", text)).wifi
    zero_s = WALK.accelerometer.time_s[0]
    np.testing.assert_allclose(wifi.time_s + zero_s, [1.5, 2.0], atol=0.01)
    np.testing.assert_array_equal(wifi.rssi_dbm, [-61, -70])
    np.testing.assert_array_equal(wifi.frequency_mhz, [np.nan, 5180])
