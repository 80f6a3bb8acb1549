"""The formats and special cases in docs are true: what each reader reads, its signs, its report, its round trip."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import a_walk, assert_same_track, on_one_clock, with_level_attitude
from mutations import FORMS, SOURCES, file_of

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import FORMATS, read
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Samples
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

ROOT = Path(__file__).parents[3]
DOCS = "".join((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8") for page in ("formats", "robustness"))

# Tolerances of the round trip: of a time in s, of a value relative to the largest. docs/formats.md summarises them.
ROUND_TRIP = {
    "own": (0.51e-6, 1e-6),  # 7 digits
    "sensor_logger": (1e-9, 0.0),
    "phyphox": (1e-8, 1e-9),  # 10 digits, as the app writes
    "get_sensor_data": (1.01e-6, 0.0),
    "indoor_location": (1.01e-3, 0.0),  # times in whole milliseconds
    "core_motion": (1e-9, 1e-12),
    "ronin": (1e-12, 0.0),
    "ros_bag": (1e-9, 0.0),
    "table": (0.51e-6, 1e-12),
    "generic_csv": (1e-9, 1e-12),
}
# An attitude in the file is the only witness of the sign.
WITH_ATTITUDE = [form for form in FORMS if form.partition(":")[0] not in ("own", "phyphox", "table", "generic_csv")]


def a_recording() -> Recording:
    """Thirty metres at 50 Hz, all sensors in one row, as some formats have it; ends between two hops of the filter."""
    walk = on_one_clock(a_walk(50.0))
    n = len(walk.accelerometer) - 3
    assert walk.gyroscope is not None
    time_s = np.arange(n) / 50
    regular = replace(
        walk,
        accelerometer=Samples(time_s, walk.accelerometer.values[:n]),
        gyroscope=Samples(time_s, walk.gyroscope.values[:n]),
        magnetometer=None,
    )
    return with_level_attitude(regular)


def lying(z_mps2: float) -> Recording:
    """A phone lying still with its screen up, by its attitude, and its accelerometer reading this on z."""
    time_s = np.arange(100) / 50
    still = Samples(time_s, np.tile([0.0, 0.0, z_mps2], (100, 1)))
    level = Samples(time_s, np.tile([1.0, 0.0, 0.0, 0.0], (100, 1)))
    return Recording("lying", still, gyroscope=Samples(time_s, np.zeros((100, 3))), attitude=level)


def written(form: str, recording: Recording, folder: Path) -> Path:
    if form == "ronin":
        pytest.importorskip("h5py")
    return file_of(form, recording, folder)


def test_the_page_lists_every_format_and_each_has_its_round_trip() -> None:
    section = DOCS[DOCS.index("\nValues of `format=`") : DOCS.index("\n### Tables of other apps")]
    listed = re.findall(r"^- `(\w+)`: .", section, re.MULTILINE)
    assert listed == list(ROUND_TRIP)
    assert set(listed) == set(FORMATS) == {form.partition(":")[0] for form in FORMS} == set(SOURCES)


def test_the_page_names_the_formats_whose_round_trip_rounds() -> None:
    (sentence,) = re.findall(r"A simulated walk comes back.*?\.\n", DOCS, re.DOTALL)
    rounded = {name for name, (time_s, relative) in ROUND_TRIP.items() if time_s > 1.01e-6 or relative > 1e-12}
    assert set(re.findall(r"`(\w+)`", sentence)) == rounded


@pytest.mark.parametrize("form", FORMS)
def test_a_recording_comes_back_within_the_tolerance_of_its_format(tmp_path: Path, form: str) -> None:
    format = form.partition(":")[0]
    recording = a_recording()
    found = read(written(form, recording, tmp_path))
    time_s, relative = ROUND_TRIP[format]
    if form == "sensor_logger:ios":
        relative = 1e-15  # the sum of Accelerometer and Gravity rounds
    for name in ("accelerometer", "gyroscope"):
        ours, theirs = found.streams[name], recording.streams[name]
        np.testing.assert_allclose(ours.time_s, theirs.time_s, rtol=0, atol=time_s)
        np.testing.assert_allclose(ours.values, theirs.values, rtol=0, atol=relative * np.abs(theirs.values).max())


@pytest.mark.parametrize("form", FORMS)
def test_the_track_is_that_of_the_recording(tmp_path: Path, form: str) -> None:
    recording = a_recording()
    within_m = 5e-3 if form == "get_sensor_data" else 1e-3  # whose times are good to a microsecond
    assert_same_track(read(written(form, recording, tmp_path)), recording, within_m)


@pytest.mark.parametrize("form", FORMS)
def test_a_phone_lying_face_up_reads_plus_9_81_on_z(tmp_path: Path, form: str) -> None:
    values = read(written(form, lying(STANDARD_GRAVITY_MPS2), tmp_path)).accelerometer.values
    np.testing.assert_allclose(values, np.tile([0, 0, STANDARD_GRAVITY_MPS2], (100, 1)), atol=1e-6)


@pytest.mark.parametrize("form", WITH_ATTITUDE)
def test_a_sign_that_the_attitude_of_the_phone_contradicts_is_refused(tmp_path: Path, form: str) -> None:
    if form == "core_motion":  # its gravity column is the accelerometer's: only the angles can contradict it
        path = written(form, lying(STANDARD_GRAVITY_MPS2), tmp_path)
        lines = [line.split(",") for line in path.read_text().splitlines()]
        roll = lines[0].index("attitude.roll")
        text = "".join(",".join([*row[:roll], repr(np.pi), *row[roll + 1 :]]) + "\n" for row in lines[1:])
        path.write_text(",".join(lines[0]) + "\n" + text)
    else:
        path = written(form, lying(-STANDARD_GRAVITY_MPS2), tmp_path)
    with pytest.raises(RecordingError, match="points down in the phone's own attitude"):
        read(path)


@pytest.mark.parametrize("form", FORMS)
def test_the_report_says_what_it_was_and_how_fast(tmp_path: Path, form: str) -> None:
    recording = a_recording()
    # Half a second is missing, and one sample is there twice.
    kept = np.r_[0:100, 99, 125 : len(recording.accelerometer)]
    cut = {name: Samples(s.time_s[kept], s.values[kept]) for name, s in recording.streams.items()}
    report = reading_report(read(written(form, replace(recording, **cut), tmp_path)))
    assert SOURCES[form.partition(":")[0]] in report.source
    assert report.found
    assert report.clock
    stream = report.streams[0]
    assert (stream.name, stream.n_samples) == ("accelerometer", len(kept))
    if form == "core_motion":  # without a time column nothing can be missing
        assert (stream.n_gaps, stream.n_duplicates, stream.mean_rate_hz) == (0, 0, pytest.approx(50.0))
    else:
        assert (stream.n_gaps, stream.n_duplicates, stream.n_backward) == (1, 1, 0)
        assert stream.longest_gap_s == pytest.approx(0.52, abs=2e-3)
        assert stream.mean_rate_hz == pytest.approx((len(kept) - 1) / recording.accelerometer.time_s[-1], rel=1e-3)


# ---------------------------------------------------------------- a test for each trap


OWN, FUZZ = "test_own_format.py", "test_fuzz_readers.py"
LOGGER, PHYPHOX, GET = "test_sensor_logger.py", "test_phyphox.py", "test_get_sensor_data.py"
WIFI = "test_wifi_files.py"
INDOOR, MOTION, RONIN, HERE = "test_indoor_location.py", "test_core_motion.py", "test_ronin.py", "test_formats_table.py"
GENERIC, HOSTILE, TABLES = "test_generic_csv.py", "test_hostile_files.py", "test_tables.py"
NAMES, TIMES = "test_names_of_columns.py", "test_table_times.py"
MATLAB, ROS, JSON = "test_matlab.py", "test_ros_bag.py", "test_json_tables.py"
WRAPPED, DATES = "test_wrapped.py", "test_dates.py"

# Format and trap, and the tests that fail if it is stepped into. docs/robustness.md has those that may surprise a user.
TRAPS: dict[tuple[str, str], list[tuple[str, str]]] = {
    ("all", "units: median of specific force about 1"): [
        (OWN, "test_specific_force_in_wrong_units_is_refused"),
        (LOGGER, "test_g_units_where_mps2_are_documented_are_refused"),
        (PHYPHOX, "test_values_in_g_under_a_header_of_mps2_are_refused"),
        (GENERIC, "test_units_that_are_given_wrong_are_refused"),
    ],
    ("all", "the specific force points down in the phone's own attitude"): [
        (HERE, "test_a_sign_that_the_attitude_of_the_phone_contradicts_is_refused"),
        (LOGGER, "test_a_platform_that_contradicts_the_attitude_is_refused"),
    ],
    ("all", "times far outside a phone's rates, angular rates like deg/s"): [
        (OWN, "test_times_in_another_unit_are_refused_with_that_unit"),
        (OWN, "test_a_rate_of_more_than_2000_hz_is_refused"),
        (OWN, "test_a_gyroscope_in_degrees_is_refused"),
    ],
    ("all", "infinite or absurd values"): [
        (OWN, "test_infinite_and_absurd_values_are_unknown"),
        (FUZZ, "test_an_absurd_value_is_unknown_and_changes_no_other"),
    ],
    ("all", "a last line that is cut off"): [
        (OWN, "test_a_last_line_that_is_cut_off_is_left_out"),
        (GET, "test_a_last_line_that_is_cut_off_is_left_out"),
        (HERE, "test_a_last_line_that_is_cut_off_loses_no_other"),
    ],
    ("all", "UTF-16 without byte order mark, damaged zip, encrypted or bomb-like members, members outside the zip"): [
        (FUZZ, "test_two_byte_text_without_its_mark_is_refused_with_the_encoding_to_use"),
        (FUZZ, "test_a_mutated_file_gives_a_recording_or_a_refusal"),
        (OWN, "test_an_encrypted_member_is_refused"),
        (FUZZ, "test_a_zip_bomb_is_refused_before_it_is_unpacked"),
        (FUZZ, "test_a_member_that_points_outside_the_zip_is_refused"),
        (HOSTILE, "test_a_zip_that_unpacks_to_more_than_sensors_can_is_refused"),
    ],
    ("all", "7z, rar and tar archives, PDF, web pages, pointers of git LFS"): [
        (WRAPPED, "test_what_is_given_in_place_of_a_recording_is_named")
    ],
    ("all", "pipes, devices, links out of the folder in place of a file"): [
        (HOSTILE, "test_a_pipe_a_device_or_a_link_in_place_of_a_file_is_refused_soon"),
        (HOSTILE, "test_a_sensor_that_is_a_link_out_of_its_folder_is_refused_and_one_within_it_is_read"),
    ],
    ("Sensor Logger", "order of columns differs between versions"): [
        (LOGGER, "test_columns_are_found_by_name_whatever_their_order"),
        (LOGGER, "test_json_in_another_layout_gives_the_same_bits"),
    ],
    ("Sensor Logger", "`time` in nanoseconds since 1970"): [(LOGGER, "test_nanoseconds_keep_their_last_digit")],
    ("Sensor Logger", "`Accelerometer` lacks gravity"): [
        (LOGGER, "test_gravity_at_other_times_is_interpolated"),
        (LOGGER, "test_acceleration_without_gravity_is_restored_with_the_sign_of_the_platform"),
    ],
    ("Sensor Logger", "iOS has the opposite sign, unless `standardisation` is true"): [
        (LOGGER, "test_a_phone_lying_face_up_reads_plus_one_g_on_z"),
        (LOGGER, "test_a_platform_that_is_not_known_is_refused_unless_only_android_writes_such_a_file"),
    ],
    ("Sensor Logger", "`AccelerometerUncalibrated` on iOS is in g"): [
        (LOGGER, "test_uncalibrated_acceleration_on_ios_is_in_g_unless_standardised")
    ],
    ("Sensor Logger", "the gyroscope and the quaternion have the same sign on both systems"): [
        (LOGGER, "test_a_walk_comes_back_as_it_was"),
        (HERE, "test_a_sign_that_the_attitude_of_the_phone_contradicts_is_refused"),
    ],
    ("Sensor Logger", "`Annotation.csv` of 0 bytes, `Metadata.csv` without final line feed"): [
        (LOGGER, "test_an_annotation_file_of_no_bytes_and_metadata_without_final_line_feed_are_read")
    ],
    ("Sensor Logger", "rows from more than 60 s before the start"): [
        (LOGGER, "test_negative_seconds_elapsed_change_nothing_but_a_remembered_value_is_left_out")
    ],
    ("Sensor Logger", "half the requested rate"): [(LOGGER, "test_half_the_requested_rate_is_reported")],
    ("Sensor Logger", "horizontal accuracy -1"): [(LOGGER, "test_an_unknown_accuracy_of_a_location_is_nan")],
    ("phyphox", "five separators and decimal signs"): [
        (PHYPHOX, "test_a_walk_comes_back_whatever_separator_and_decimal_sign")
    ],
    ("phyphox", "the same sign on iOS as on Android"): [(PHYPHOX, "test_the_sign_is_androids")],
    ("phyphox", "`Linear Acceleration`"): [
        (PHYPHOX, "test_a_walk_without_gravity_is_read_with_a_warning"),
        (PHYPHOX, "test_a_phone_at_rest_without_gravity_is_refused"),
        (PHYPHOX, "test_acceleration_without_gravity_beside_the_right_one_is_ignored"),
    ],
    ("phyphox", "one CSV with several tables below each other"): [
        (PHYPHOX, "test_one_csv_with_all_tables_below_each_other_comes_back")
    ],
    ("phyphox", "wall clock and pauses in `meta/time.csv`"): [
        (PHYPHOX, "test_the_wall_clock_comes_from_the_meta_file"),
        (PHYPHOX, "test_pauses_are_noted"),
    ],
    ("GetSensorData", "two times in each line"): [
        (GET, "test_a_walk_comes_back_with_the_intervals_of_the_sensors_clock"),
        (GET, "test_clocks_that_run_at_different_rates_are_refused"),
    ],
    ("GetSensorData", "a sensor clock that stands still"): [
        (GET, "test_a_sensor_clock_that_stands_still_gives_way_to_the_apps_with_a_note")
    ],
    ("GetSensorData", "POSI lines"): [
        (GET, "test_reference_positions_are_on_the_apps_clock"),
        (GET, "test_reference_positions_are_metres_from_the_first"),
    ],
    ("GetSensorData", "logs that declare m/s^2 and hold g"): [
        (GET, "test_a_log_that_declares_mps2_and_holds_g_is_refused_with_the_remedy")
    ],
    ("GetSensorData", "`%` comments, PRES, LIGH, PROX and GNSS lines, types that are not known"): [
        (GET, "test_other_types_and_comments_are_ignored"),
        (HERE, "test_the_small_sensors_of_get_sensor_data_are_read"),
    ],
    ("indoor-location", "unknown types, `..._UNCALIBRATED` beside the calibrated type"): [
        (INDOOR, "test_uncalibrated_values_and_unknown_types_are_ignored")
    ],
    ("indoor-location", "times in whole milliseconds"): [(INDOOR, "test_a_walk_comes_back_to_the_millisecond")],
    ("indoor-location", "Wi-Fi that is reported seconds after it was heard"): [
        (WIFI, "test_indoor_location_says_when_it_was_heard_and_names_may_be_anything"),
        (WIFI, "test_times_of_another_clock_are_replaced_by_those_of_the_reports"),
        (WIFI, "test_get_sensor_data_moves_the_time_of_hearing_to_the_clock_of_the_app"),
    ],
    ("CoreMotion", "g, and Apple's sign"): [
        (MOTION, "test_a_phone_lying_face_up_reads_plus_one_g_on_z"),
        (MOTION, "test_gravity_in_mps2_is_refused"),
    ],
    ("CoreMotion", "CoreMotion without a time column"): [
        (MOTION, "test_a_walk_comes_back"),
        (MOTION, "test_a_time_column_is_used_if_there_is_one"),
    ],
    ("RoNIN", "RoNIN with `info.json`"): [
        (RONIN, "test_a_walk_comes_back_calibrated"),
        (RONIN, "test_without_info_the_values_are_as_recorded_with_a_note"),
    ],
    ("RoNIN", "data that hdf5 keeps in other files"): [
        (HOSTILE, "test_data_that_hdf5_keeps_in_another_file_are_refused")
    ],
    ("RoNIN", "quaternions wxyz in `synced`, xyzw in `raw`"): [
        (RONIN, "test_a_quaternion_of_the_other_order_is_refused")
    ],
    ("tables", "lines above the header: blank, `sep=;`, comments, the device"): [
        (TABLES, "test_the_walk_comes_back"),
        (TABLES, "test_a_header_in_the_code_of_the_phone_is_read"),
    ],
    ("tables", "decimal commas, semicolons, tabs, spaces, no header"): [(TABLES, "test_the_walk_comes_back")],
    ("tables", "acceleration without gravity (`ax`, `Linear Acceleration`, `Accelerometer` of Sensor Logger)"): [
        (TABLES, "test_acceleration_without_gravity_is_restored_with_what_to_record_next_time"),
        (TABLES, "test_the_walk_comes_back"),
    ],
    ("tables", "units that no name shows"): [
        (TABLES, "test_the_walk_comes_back"),
        (TABLES, "test_the_gyroscope_is_checked_with_how_gravity_turns"),
    ],
    ("tables", "`Rotation X` without a unit"): [
        (NAMES, "test_a_rotation_that_turns_gravity_is_a_rate_and_one_that_does_not_is_an_orientation"),
        (NAMES, "test_a_rotation_that_averages_out_is_a_gyroscope_also_beside_columns_like_those_of_phyphox"),
    ],
    ("tables", "a header in a code page, such as cp1251"): [
        (NAMES, "test_a_header_in_a_code_page_is_read_and_shown_as_it_was_written")
    ],
    ("tables", "dates and clock times, with or without a zone, `mm:ss.000`; midnight, the full hour"): [
        (TIMES, "test_dates_are_read_however_they_are_written"),
        (TIMES, "test_a_clock_goes_on_at_midnight"),
        (DATES, "test_minutes_and_seconds_go_on_at_the_full_hour"),
    ],
    (
        "tables",
        "rows out of order; packs of samples with one time; several accuracies; [further kinds](formats.md#odd-tables)",
    ): [("test_oddities.py", "test_what_is_said_of_an_odd_table_and_its_samples_are_right")],
    ("tables", "times that a spreadsheet rounded (`mm:ss.0`, `18:23`, `1.7E+18`)"): [
        (TIMES, "test_times_that_a_spreadsheet_rounded_are_refused_with_what_happened"),
        (LOGGER, "test_times_that_a_spreadsheet_rounded_are_replaced_by_the_seconds_elapsed"),
    ],
    ("tables", "large nanoseconds since the phone was started"): [
        (TIMES, "test_nanoseconds_since_the_phone_was_started_are_known_by_the_rate")
    ],
    ("tables", "decimal commas between commas; a header that is there again"): [
        (TABLES, "test_decimal_commas_between_commas_are_refused_with_what_to_export"),
        (TABLES, "test_a_header_that_is_there_again_is_two_recordings"),
    ],
    ("SensorLog", "two magnetometers (SensorLog)"): [(JSON, "test_the_walk_comes_back")],
    ("JSON", "cut off in the middle of an object"): [(JSON, "test_what_is_cut_off_is_left_out_with_a_note")],
    ("tables", "declared milliseconds at 2 Hz"): [(TIMES, "test_milliseconds_that_are_declared_are_believed_at_2_hz")],
    ("tables", "the sign of an app on two systems"): [
        (TABLES, "test_the_sign_that_nothing_shows_is_noted_and_can_be_said"),
        (GENERIC, "test_what_is_in_g_without_an_app_that_is_known_is_read_once_its_platform_is_said"),
    ],
    ("tables", "a location repeated in every row"): [
        (TABLES, "test_a_location_that_is_repeated_in_every_row_is_one_fix")
    ],
    ("Sensor Logger", "`Metadata.csv` is lost"): [
        (LOGGER, "test_without_a_platform_an_attitude_shows_the_sign"),
        (LOGGER, "test_a_platform_that_is_not_known_is_refused_unless_only_android_writes_such_a_file"),
    ],
    ("Sensor Logger", "pushed messages in any order, several sessions in a file"): [
        (LOGGER, "test_pushed_messages_in_any_order_are_the_recording_and_two_sessions_are_two")
    ],
    ("all", "two recordings in one zip"): [(TABLES, "test_two_walks_in_one_zip_are_two")],
    ("all", "files in the folder of a recording that are none of its sensors, or renamed ones"): [
        (TABLES, "test_what_is_left_out_of_a_folder_is_noted"),
        (TABLES, "test_the_walk_comes_back"),
    ],
    ("all", "a folder for each sensor"): [(WRAPPED, "test_a_folder_for_each_sensor_is_one_recording")],
    ("tables", "seconds and nanoseconds of ROS in two columns"): [(TABLES, "test_the_walk_comes_back")],
    ("MATLAB", "timetables, of MATLAB Mobile; version 7.3"): [
        (MATLAB, "test_timetables_of_matlab_mobile_are_read"),
        (MATLAB, "test_version_7_3_is_refused_with_how_to_save_it"),
    ],
    ("ROS 2", "quantities that ROS 2 drivers leave at zero"): [
        (ROS, "test_what_a_topic_leaves_at_zero_is_taken_from_another")
    ],
    ("any CSV", "units and sign are given in a TOML file"): [
        (GENERIC, "test_a_walk_comes_back_in_si_units"),
        (GENERIC, "test_without_a_mapping_the_columns_and_a_mapping_to_write_are_shown"),
    ],
}


def special_cases() -> list[str]:
    """Cases in bold on the page about odd input, as one line each."""
    section = DOCS[DOCS.index("## Special cases of formats") : DOCS.index("## Damaged and hostile files")]
    return [" ".join(case.split()) for case in re.findall(r"^- \*\*(.+?)\*\*", section, re.MULTILINE | re.DOTALL)]


def test_every_special_case_of_the_docs_is_a_trap_with_tests_that_exist() -> None:
    assert len(special_cases()) > 15
    assert set(special_cases()) <= {trap for _, trap in TRAPS}
    for trap, tests in TRAPS.items():
        assert tests, trap
        for file, name in tests:
            tree = ast.parse((Path(__file__).parent / file).read_text(encoding="utf-8"))
            assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (file, name)


@pytest.mark.parametrize(
    "form", ["own", "sensor_logger", "phyphox:csv", "indoor_location", "core_motion", "generic_csv"]
)
def test_a_last_line_that_is_cut_off_loses_no_other(tmp_path: Path, form: str) -> None:
    recording = replace(a_recording(), attitude=None) if form != "core_motion" else a_recording()
    whole = written(form, recording, tmp_path)
    before = read(whole)
    if whole.suffix == ".zip":  # cut the accelerometer's file in a folder of the same files
        import zipfile

        with zipfile.ZipFile(whole) as archive:
            archive.extractall(tmp_path / "cut")
        path = tmp_path / "cut"
        victim = next(path / name for name in ("accelerometer.csv", "TotalAcceleration.csv") if (path / name).exists())
    else:
        path = victim = whole
    text = victim.read_text(encoding="utf-8").partition("\n#\tendTime")[0].rstrip()
    end = text.rindex("\n") + 1
    victim.write_text(text[: end + 2 * (len(text) - end) // 3], encoding="utf-8")
    after = read(path)
    assert any("cut off" in note for note in after.notes)
    last = "gyroscope" if form in ("phyphox:csv", "indoor_location") else "accelerometer"  # at the end of the file
    np.testing.assert_array_equal(after.streams[last].values, before.streams[last].values[:-1])


def test_the_small_sensors_of_get_sensor_data_are_read(tmp_path: Path) -> None:
    path = written("get_sensor_data", a_recording(), tmp_path)
    lines = ["PRES;1.000;81235.5;1013.25;3;30.0", "LIGH;1.000;81235.5;120.5;3", "PROX;1.000;81235.5;5.0;3"]
    lines += ["GNSS;1.000;1700000000.0;40.31;-3.48;600.5;90.0;4.5;1.0;8;9"]
    with path.open("a", encoding="latin-1") as file:
        file.write(
            "".join(f"{line}\n{line.replace('1.000', '2.000').replace('81235.5', '81236.5')}\n" for line in lines)
        )
    found = read(path)
    assert found.barometer is not None
    np.testing.assert_allclose(found.barometer.values[:, 0], 1013.25)  # mbar are hPa
    assert found.light is not None
    np.testing.assert_allclose(found.light.values[:, 0], 120.5)
    assert found.proximity is not None
    np.testing.assert_allclose(found.proximity.values[:, 0], 5.0)
    assert found.location is not None
    np.testing.assert_allclose(found.location.values[0, :2], [40.31, -3.48])


def test_every_trap_names_a_format_that_is_read() -> None:
    known = {"all", "Sensor Logger", "phyphox", "GetSensorData", "indoor-location", "CoreMotion", "RoNIN", "any CSV"}
    known |= {"tables", "MATLAB", "ROS 2", "SensorLog", "JSON"}
    assert {trap[0] for trap in TRAPS} == known
    assert re.search(r"`pdr\.read\(path, format=\"phyphox\"\)`", DOCS)
