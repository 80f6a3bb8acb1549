"""phyphox: five separators and decimal signs, zip, folder and single CSV, units in the headers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from app_files import a_walk, assert_same_streams, phyphox_files, phyphox_table, refusal, write_folder, write_zip

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.app_dialects import dialect_of
from pdr_filter.tracking.whole_recording import track
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Samples

WALK = a_walk()
CHOICES = [(",", "."), ("\t", "."), (";", "."), ("\t", ","), (";", ",")]
ALL = "accelerometer gyroscope magnetometer"


def assert_walk(folder: Path, files: dict[str, str], names: str = ALL) -> None:
    assert_same_streams(read(write_zip(folder / "w.zip", files)), WALK, names, time_s=1e-7, rtol=1e-8)


@pytest.mark.parametrize(("separator", "decimal"), CHOICES)
def test_a_walk_comes_back_whatever_separator_and_decimal_sign(tmp_path: Path, separator: str, decimal: str) -> None:
    files = phyphox_files(WALK, separator, decimal)
    for path in (write_zip(tmp_path / "w.zip", files), write_folder(tmp_path / "w", files)):
        recording = read(path)
        assert_same_streams(recording, WALK, ALL, time_s=1e-7, rtol=1e-9)
        assert recording.notes == ()


@pytest.mark.parametrize(("separator", "decimal"), CHOICES)
def test_one_csv_with_all_tables_below_each_other_comes_back(tmp_path: Path, separator: str, decimal: str) -> None:
    files = phyphox_files(WALK, separator, decimal)
    (tmp_path / "w.csv").write_text("".join(text for name, text in files.items() if "meta" not in name))
    assert_same_streams(read(tmp_path / "w.csv"), WALK, ALL, time_s=1e-7, rtol=1e-9)


def test_the_wall_clock_comes_from_the_meta_file(tmp_path: Path) -> None:
    recording = read(write_zip(tmp_path / "w.zip", phyphox_files(WALK, ";", ",")))
    assert recording.meta["epoch_s"] == pytest.approx(1770000000.25, abs=1e-6)
    assert "1770000000.250" in reading_report(recording).clock
    assert reading_report(recording).source == "phyphox 1.1.16"
    assert recording.meta["device"] == "Some Phone"


def test_pauses_are_noted(tmp_path: Path) -> None:
    files = phyphox_files(WALK)
    files["meta/time.csv"] += '"START",3.1E1,1770000100.000,"x"\n"PAUSE",4.0E1,1770000109.000,"x"\n'
    assert any("paused once" in note for note in read(write_zip(tmp_path / "w.zip", files)).notes)


@pytest.mark.parametrize(("unit", "factor"), [("m/s\u00b2", 1.0), ("g", STANDARD_GRAVITY_MPS2)])
def test_the_unit_of_the_header_is_obeyed(tmp_path: Path, unit: str, factor: float) -> None:
    scaled = Samples(WALK.accelerometer.time_s, WALK.accelerometer.values / factor)
    (tmp_path / "w.csv").write_text(phyphox_table(scaled, "Acceleration", unit), encoding="utf-8")
    assert_same_streams(read(tmp_path / "w.csv"), WALK, "accelerometer", time_s=1e-7, rtol=1e-8)


def test_degrees_and_both_signs_of_micro_are_known(tmp_path: Path) -> None:
    assert WALK.magnetometer is not None
    files = phyphox_files(WALK)
    degrees = Samples(WALK.gyroscope.time_s, np.degrees(WALK.gyroscope.values))
    files["Gyroscope.csv"] = phyphox_table(degrees, "Gyroscope", "\u00b0/s")
    files["Magnetometer.csv"] = phyphox_table(WALK.magnetometer, "Magnetic field", "\u03bcT")
    assert_walk(tmp_path, files)


def test_columns_called_x_y_z_belong_to_the_sensor_of_the_file(tmp_path: Path) -> None:
    text = phyphox_files(WALK)["Accelerometer.csv"].replace("Acceleration ", "").replace('"x (', '"X (', 1)
    assert_walk(tmp_path, phyphox_files(WALK) | {"Accelerometer.csv": text})


def test_a_file_called_like_one_of_the_own_format_is_recognised_by_its_header(tmp_path: Path) -> None:
    assert_walk(tmp_path, {"accelerometer.csv": phyphox_files(WALK)["Accelerometer.csv"]}, "accelerometer")


def test_short_columns_padded_with_nan_lose_nothing(tmp_path: Path) -> None:
    text = phyphox_files(WALK)["Gyroscope.csv"] + "9.9E1,NaN,NaN,NaN\n"
    assert_walk(tmp_path, phyphox_files(WALK) | {"Gyroscope.csv": text})


def test_pressure_and_location_are_read(tmp_path: Path) -> None:
    files = phyphox_files(WALK)
    files["Pressure.csv"] = '"Time (s)","Pressure (hPa)"\n0.0E0,1.0132E3\n1.0E0,1.0133E3\n'
    files["Location.csv"] = (
        '"Time (s)","Latitude (\u00b0)","Longitude (\u00b0)","Height (m)","Velocity (m/s)","Direction (\u00b0)",'
        '"Horizontal Accuracy (m)","Vertical Accuracy (m)"\n0.0E0,4.8E1,1.1E1,5.0E2,1.0E0,9.0E1,4.0E0,6.0E0\n'
    )
    recording = read(write_zip(tmp_path / "w.zip", files))
    np.testing.assert_array_equal(recording.barometer.values[:, 0], [1013.2, 1013.3])
    np.testing.assert_array_equal(recording.location.values, [[48.0, 11.0, 500.0, 4.0]])


def test_a_walk_without_gravity_is_read_with_a_warning(tmp_path: Path) -> None:
    files = phyphox_files(WALK)
    del files["Accelerometer.csv"]
    linear = Samples(WALK.accelerometer.time_s, WALK.accelerometer.values - WALK.accelerometer.values.mean(axis=0))
    files["Linear.csv"] = phyphox_table(linear, "Linear Acceleration", "m/s^2")
    recording = read(write_zip(tmp_path / "w.zip", files))
    mean_mps2 = recording.accelerometer.values.mean(axis=0)
    assert np.linalg.norm(mean_mps2 - WALK.accelerometer.values.mean(axis=0)) < 2.5
    assert "lacks gravity, so that the vertical was estimated from the gyroscope and the steps" in recording.notes[0]
    assert recording.notes[0].endswith("next time record 'Acceleration with g' in phyphox")
    assert track(recording).n_steps == pytest.approx(track(WALK).n_steps, rel=0.03)
    assert recording.notes[0] in track(recording).notes
    again = read(recording.save(tmp_path / "converted"))
    assert any("was recorded without gravity" in note for note in track(again).notes)


def test_a_phone_at_rest_without_gravity_is_refused(tmp_path: Path) -> None:
    still = Samples(WALK.accelerometer.time_s, 0.001 * WALK.accelerometer.values)
    files = {"Linear.csv": phyphox_table(still, "Linear Acceleration", "m/s^2")}
    message = refusal(write_zip(tmp_path / "w.zip", files))
    assert "lacks gravity, and nobody walks in it for 12 s" in message
    assert "which would show the vertical: walk for longer; or export 'Acceleration with g' in phyphox" in message


def test_acceleration_without_gravity_beside_the_right_one_is_ignored(tmp_path: Path) -> None:
    files = phyphox_files(WALK)
    still = Samples(WALK.accelerometer.time_s, 0 * WALK.accelerometer.values)
    files["Linear.csv"] = phyphox_table(still, "Linear Acceleration", "m/s^2")
    assert_walk(tmp_path, files)


def test_a_file_of_nothing_but_headers_is_refused_soon(tmp_path: Path) -> None:
    (tmp_path / "w.csv").write_text('"Time (s)","Acceleration x (m/s^2)"\n' + '"Time (s)"\n' * 100_000)
    assert "lines begin with" in refusal(tmp_path / "w.csv") or "no column" in refusal(tmp_path / "w.csv")


def test_a_table_whose_columns_have_no_units_is_not_one_of_phyphox() -> None:
    phyphox = ("Time (s),Acceleration x (m/s^2)", "Time (s),Acceleration x (g),Acceleration y (g)")
    assert all((dialect := dialect_of(header)) is not None and dialect.app == "phyphox" for header in phyphox)
    physics_toolbox = dialect_of("Time (s),gFx,gFy,gFz,wx (rad/s),wy (rad/s),wz (rad/s)")
    assert physics_toolbox.app == "Physics Toolbox"
