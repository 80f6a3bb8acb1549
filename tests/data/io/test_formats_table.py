"""The formats and special cases in docs are true: what each reader reads, its signs, its report, its round trip."""

from __future__ import annotations

import re
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import a_walk, on_one_clock, with_level_attitude
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
    assert re.search(r"`pdr\.read\(path, format=\"phyphox\"\)`", DOCS)
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


# ---------------------------------------------------------------- a test for each special case


# Special cases on the page about odd input, and a test that fails where a reader does not know the case.
SPECIAL_CASES = {
    "infinite or absurd values": "own_format::infinite_and_absurd_values_are_unknown",
    "a last line that is cut off": "formats_table::a_last_line_that_is_cut_off_loses_no_other",
    "`Accelerometer` lacks gravity": "sensor_logger::gravity_at_other_times_is_interpolated",
    "iOS has the opposite sign, unless `standardisation` is true": (
        "sensor_logger::a_phone_lying_face_up_reads_plus_one_g_on_z"
    ),
    "`AccelerometerUncalibrated` on iOS is in g": (
        "sensor_logger::uncalibrated_acceleration_on_ios_is_in_g_unless_standardised"
    ),
    "`Metadata.csv` is lost": "sensor_logger::without_a_platform_an_attitude_shows_the_sign",
    "rows from more than 60 s before the start": (
        "sensor_logger::negative_seconds_elapsed_change_nothing_but_a_remembered_value_is_left_out"
    ),
    "two times in each line": "get_sensor_data::a_walk_comes_back_with_the_intervals_of_the_sensors_clock",
    "POSI lines": "get_sensor_data::reference_positions_are_metres_from_the_first",
    "logs that declare m/s^2 and hold g": (
        "get_sensor_data::a_log_that_declares_mps2_and_holds_g_is_refused_with_the_remedy"
    ),
    "Wi-Fi that is reported seconds after it was heard": (
        "wifi_files::indoor_location_says_when_it_was_heard_and_names_may_be_anything"
    ),
    "CoreMotion without a time column": "core_motion::a_walk_comes_back",
    "RoNIN with `info.json`": "ronin::a_walk_comes_back_calibrated",
    "quantities that ROS 2 drivers leave at zero": "ros_bag::what_a_topic_leaves_at_zero_is_taken_from_another",
    "units that no name shows": "tables::the_gyroscope_is_checked_with_how_gravity_turns",
    "the sign of an app on two systems": "tables::the_sign_that_nothing_shows_is_noted_and_can_be_said",
    "`Rotation X` without a unit": (
        "names_of_columns::a_rotation_that_turns_gravity_is_a_rate_and_one_that_does_not_is_an_orientation"
    ),
    "large nanoseconds since the phone was started": (
        "table_times::nanoseconds_since_the_phone_was_started_are_known_by_the_rate"
    ),
    "two magnetometers (SensorLog)": "json_tables::the_walk_comes_back",
    "a location repeated in every row": "tables::a_location_that_is_repeated_in_every_row_is_one_fix",
}


def test_every_special_case_of_the_docs_has_a_test_that_exists() -> None:
    section = DOCS[DOCS.index("## Special cases of formats") : DOCS.index("## Damaged and hostile files")]
    cases = re.findall(r"^- \*\*(.+?)\*\*", section, re.MULTILINE | re.DOTALL)
    assert [" ".join(case.split()) for case in cases] == list(SPECIAL_CASES)
    for test in SPECIAL_CASES.values():
        file, _, name = test.partition("::")
        assert f"\ndef test_{name}(" in (Path(__file__).parent / f"test_{file}.py").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "form", ["own", "sensor_logger:android", "phyphox:csv", "indoor_location", "core_motion", "generic_csv"]
)
def test_a_last_line_that_is_cut_off_loses_no_other(tmp_path: Path, form: str) -> None:
    recording = replace(a_recording(), attitude=None) if form != "core_motion" else a_recording()
    whole = written(form, recording, tmp_path)
    before = read(whole)
    if whole.suffix == ".zip":  # cut the accelerometer's file in a folder of the same files
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
    np.testing.assert_allclose(found.barometer.values[:, 0], 1013.25)  # mbar are hPa
    np.testing.assert_allclose(found.light.values[:, 0], 120.5)
    np.testing.assert_allclose(found.proximity.values[:, 0], 5.0)
    np.testing.assert_allclose(found.location.values[0, :2], [40.31, -3.48])
