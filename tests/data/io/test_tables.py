"""Tables of other apps: what their versions, settings and owners change, and the walk that must come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from app_files import (
    a_walk,
    assert_same_bits,
    assert_same_streams,
    axes,
    matlab_mobile_files,
    on_one_clock,
    phyphox_files,
    phyphox_sheets,
    physics_toolbox_text,
    read_columns,
    refusal,
    table_text,
    write_folder,
    write_text,
    write_zip,
    xlsx_files,
)
from table_cases import (
    BOTH,
    CASES,
    FIELD,
    FORCE,
    FORCE_G,
    GRAVITY,
    RATE,
    TIME_S,
    WALK,
    androsensor,
    columns_of,
    phyphox_in,
    sensorlog,
)

from pdr_filter.data.io import text_table as tables
from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_guessed, read_mapped
from pdr_filter.data.io.tables.column_mapping import read_mapping
from pdr_filter.values.errors import RecordingError


@pytest.mark.parametrize("case", CASES)
def test_the_walk_comes_back(tmp_path: Path, case: str) -> None:
    files, sensors = CASES[case][0](), CASES[case][1]
    folder = write_folder(tmp_path / "walk", files)
    paths = [folder / next(iter(files))] if len(files) == 1 else [folder, write_zip(tmp_path / "walk.zip", files)]
    for path in paths:
        recording = read(path)
        # without times rows come at the rate that the header says, and those of the walk jitter by a millisecond
        assert_same_streams(recording, WALK, sensors, time_s=1e-3 if "no times" in case else 1e-6, rtol=1e-9)
        assert recordings_in(path if path.is_dir() else path.parent)
    assert recordings_in(folder) == [folder] or len(files) == 1
    app = case.partition(",")[0]
    if app in ("Physics Toolbox", "AndroSensor", "HyperIMU", "SensorLog", "MATLAB Mobile", "senslogs"):
        assert app in reading_report(recording).source


@pytest.mark.parametrize("case", CASES)
def test_the_mapping_that_was_guessed_reads_the_same_bits_when_it_is_given(tmp_path: Path, case: str) -> None:
    files = CASES[case][0]()
    folder = write_folder(tmp_path / "walk", files)
    path = folder / next(iter(files)) if len(files) == 1 else folder
    found = read_guessed(path)
    (tmp_path / "map.toml").write_text(found.guess.mapping.toml(), encoding="utf-8")
    again = read_mapped(path, read_mapping(tmp_path / "map.toml"))
    assert_same_bits(again, found.recording)


def test_a_mapping_is_written_as_it_was_read(tmp_path: Path) -> None:
    text = '[time]\nrate_hz = 50\n[accelerometer]\ncolumns = ["a", "b", "c"]\n'
    path = tmp_path / "walk.toml"
    for sign in ("", "sign = 1\n", "sign = -1\n"):
        path.write_text(text + '[gyroscope]\ncolumns = ["d", "e", "f"]\nunit = "deg/s"\n' + sign)
        mapping = read_mapping(path)
        path.write_text(mapping.toml())
        assert read_mapping(path) == mapping


def test_a_header_in_the_code_of_the_phone_is_read(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_bytes(androsensor().encode("latin-1"))
    assert_same_streams(read(tmp_path / "walk.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_a_spreadsheet_of_phyphox_is_read(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    path = write_zip(tmp_path / "walk.xlsx", xlsx_files(phyphox_sheets(WALK)))
    assert_same_streams(read(path), WALK, BOTH, time_s=1e-9, rtol=1e-12)
    assert "phyphox" in reading_report(read(path)).source


def test_a_cell_far_off_in_a_spreadsheet_is_refused_before_its_rectangle_is_made(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    files = xlsx_files(phyphox_sheets(WALK))
    sheet = "xl/worksheets/sheet1.xml"
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row></sheetData>'
    files[sheet] = files[sheet].replace("</sheetData>", far)
    assert "hardly any before it" in refusal(write_zip(tmp_path / "walk.xlsx", files))


def test_what_a_spreadsheet_claims_cannot_end_this_process(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    files = xlsx_files(phyphox_sheets(WALK))
    sheet = "xl/worksheets/sheet1.xml"
    # the cell of the last row and column, written so that a look at the text does not find it
    files[sheet] = files[sheet].replace('r="B3"', 'r="&#88;FD1048576"', 1)
    path = write_zip(tmp_path / "walk.xlsx", files)
    try:
        read(path)
    except ValueError as error:
        assert "walk.xlsx" in str(error)


def test_decimal_commas_between_commas_are_refused_with_what_to_export(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(table_text({"time": TIME_S + 0.01} | axes("gF%", FORCE_G), ",", ","))
    assert "export it with points in numbers, or with semicolons" in refusal(tmp_path / "walk.csv")


@pytest.mark.parametrize("end", ["\r\r\n", "\n\n"])
def test_a_blank_line_after_each_changes_nothing(tmp_path: Path, end: str) -> None:
    text = table_text(columns_of("time", "acc%", "gyro%"))
    (tmp_path / "walk.csv").write_bytes(text.replace("\n", end).encode())
    assert_same_streams(read(tmp_path / "walk.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_columns_that_were_not_used_are_named(tmp_path: Path) -> None:
    columns = {"time": TIME_S} | axes("acc%", FORCE) | axes("Swing %", RATE)
    (tmp_path / "walk.csv").write_text(table_text(columns))
    assert "columns not used: Swing x, Swing y, Swing z" in reading_report(read(tmp_path / "walk.csv")).lines()


def test_a_header_that_is_there_again_is_two_recordings(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(2 * table_text(columns_of("time", "acc%", "gyro%")))
    message = refusal(tmp_path / "walk.csv").replace(", column", "")
    assert f"line {len(TIME_S) + 2}: the header is there again" in message


def test_the_sign_that_nothing_shows_is_noted_and_can_be_said(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(physics_toolbox_text(WALK))
    assert any("nothing in the file shows its sign" in note for note in read(tmp_path / "walk.csv").notes)
    turned = read(tmp_path / "walk.csv", platform="ios")
    np.testing.assert_allclose(turned.accelerometer.values, -FORCE, rtol=1e-12)
    assert not turned.notes


def test_a_platform_where_the_sign_is_known_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(sensorlog())
    assert "leave platform out" in refusal(tmp_path / "walk.csv", platform="ios")
    assert "leave platform out" in refusal(write_zip(tmp_path / "w.zip", phyphox_files(WALK)), platform="ios")


def test_acceleration_without_gravity_is_restored_with_what_to_record_next_time(tmp_path: Path) -> None:
    linear = axes("a% (m/s^2)", FORCE - GRAVITY) | {"aT (m/s^2)": np.linalg.norm(FORCE - GRAVITY, axis=1)}
    recording = read_columns(tmp_path, {"time": TIME_S} | linear | axes("w% (rad/s)", RATE))
    error_mps2 = (recording.accelerometer.values - FORCE).mean(axis=0)
    assert np.linalg.norm(error_mps2) < 2.5
    assert recording.notes[0].startswith("the acceleration (ax (m/s^2), ay (m/s^2), az (m/s^2)) lacks gravity")
    assert recording.notes[0].endswith("record G-Force (gFx, gFy, gFz) in Physics Toolbox")


def test_acceleration_without_gravity_and_without_gyroscope_gives_steps_only(tmp_path: Path) -> None:
    linear = axes("linear_acceleration_% (m/s^2)", FORCE - GRAVITY)
    recording = read_columns(tmp_path, {"time": TIME_S} | linear)
    assert recording.gyroscope is None
    words = "no gyroscope: only steps and distance can be trusted; next time record the gyroscope and the"
    assert words in recording.notes[0]


def test_a_constant_axis_beside_gravity_is_in_the_notes(tmp_path: Path) -> None:
    force = np.roll(FORCE, 1 - np.abs(FORCE.mean(axis=0)).argmax(), axis=1)  # gravity along y
    columns = {"time": TIME_S} | axes("acc_%", force) | axes("gyro_%", RATE)
    is_named = [
        any("accelerometer: z is 0 in all rows; record" in note for note in read_columns(tmp_path, found).notes)
        for found in (columns, columns | {"acc_z": 0 * TIME_S})
    ]
    assert is_named == [False, True]


@pytest.mark.parametrize(
    ("names", "is_named"),
    [("% #2", True), ("gyro_% of two", True), ("gyro_%", False), ("", False), ("mag_%", False), ("grav_%", False)],
)
def test_axes_that_give_no_gyroscope_are_in_the_notes(tmp_path: Path, names: str, is_named: bool) -> None:
    others = axes(names.removesuffix(" of two"), RATE) if names else {"label": np.zeros(len(TIME_S))}
    if "of two" in names:
        del others["gyro_z"]
    recording = read_columns(tmp_path, {"time": TIME_S} | axes("%", FORCE) | others)
    assert (recording.gyroscope is None) == (names != "gyro_%")
    assert any("columns not used" in note and next(iter(others)) in note for note in recording.notes) == is_named


def test_a_location_that_is_repeated_in_every_row_is_one_fix(tmp_path: Path) -> None:
    (tmp_path / "walk.csv").write_text(androsensor())
    found = read(tmp_path / "walk.csv").location
    assert len(found) == 1


def test_acceleration_without_gravity_is_told_by_its_values_in_any_language(tmp_path: Path) -> None:
    files = phyphox_in("French")
    linear = {"Temps (s)": TIME_S} | axes("Acc\u00e9l\u00e9ration lin\u00e9aire % (m/s^2)", FORCE - GRAVITY)
    name = "Acc\u00e9l\u00e9ration lin\u00e9aire.csv"
    assert_same_streams(
        read(write_folder(tmp_path / "both", files | {name: table_text(linear)})), WALK, BOTH, time_s=1e-6, rtol=1e-9
    )
    still = {"Temps (s)": TIME_S} | axes("Acc\u00e9l\u00e9ration lin\u00e9aire % (m/s^2)", 0.01 * (FORCE - GRAVITY))
    only = write_folder(tmp_path / "only", {"Gyroscope.csv": files["Gyroscope.csv"], name: table_text(still)})
    assert "lacks gravity" in refusal(only)
    assert "'Acceleration with g' in phyphox" in refusal(only)


def test_two_walks_in_one_zip_are_two(tmp_path: Path) -> None:
    first, second = phyphox_files(WALK), phyphox_files(on_one_clock(a_walk(50.0, seed=8)))
    files = {f"a/{k}": v for k, v in first.items()} | {f"b/{k}": v for k, v in second.items()}
    path = write_zip(tmp_path / "export.zip", files)
    assert "holds 2 recordings (a, b)" in refusal(path)
    assert recordings_in(tmp_path) == [path / "a", path / "b"]
    assert_same_streams(read(path / "a"), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    assert read(path / "b").name == "b"
    assert "nothing in it is called c" in refusal(path / "c")


def test_two_tables_that_are_whole_are_two_and_one_walk_in_several_files_is_one(tmp_path: Path) -> None:
    text = physics_toolbox_text(WALK)
    write_folder(tmp_path / "two", {"walk_1.csv": text, "walk_2.csv": text})
    assert len(recordings_in(tmp_path / "two")) == 2
    assert "holds 2 recordings (walk_1.csv, walk_2.csv)" in refusal(tmp_path / "two")
    path = write_zip(tmp_path / "two.zip", {"walk_1.csv": text, "walk_2.csv": text})
    assert recordings_in(path) == [path / "walk_1.csv", path / "walk_2.csv"]
    assert_same_streams(read(path / "walk_2.csv"), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    only = {f"{n}_steps.csv": matlab_mobile_files(WALK)["Acceleration.csv"] for n in (80, 250)}
    assert len(recordings_in(write_folder(tmp_path / "steps", only))) == 2


def test_what_is_left_out_of_a_folder_is_noted(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", CASES["phyphox, members renamed and added"][0]())
    assert any("left out: old_accelerometer" in note for note in read(folder).notes)


@pytest.mark.parametrize("n_without_time", [0, 1, 3])
def test_the_gyroscope_is_checked_with_how_gravity_turns(tmp_path: Path, n_without_time: int) -> None:
    at_s = np.arange(0.0, 30.0, 0.02)
    angle = 0.8 * np.sin(2 * np.pi * at_s / 8)
    force = 9.81 * np.column_stack([0 * at_s, np.sin(angle), np.cos(angle)])
    rate = np.column_stack([np.gradient(angle, at_s), 0 * at_s, 0 * at_s])
    for unit, factor in (("rad/s", 1.0), ("deg/s", 180 / np.pi)):
        begun_s = np.where(np.arange(len(at_s)) < n_without_time, np.nan, at_s)
        text = table_text({"time": begun_s} | axes("acc%", force) | axes("gyro%", factor * rate))
        (tmp_path / "walk.csv").write_text(text)
        found = read_guessed(tmp_path / "walk.csv")
        assert any(f"gyroz, {unit}" in line for line in found.guess.evidence)
        np.testing.assert_allclose(found.recording.gyroscope.values, rate[n_without_time:], atol=1e-12)
    assert (
        any("gravity turns 1.0" in line for line in read_guessed(tmp_path / "walk.csv").guess.evidence)
        or unit == "deg/s"
    )


@pytest.mark.recordings
def test_real_files_of_apps_are_read_or_refused_rightly(data_dir: Path) -> None:
    from tests.benchmarks.app_files import FILES, row_of

    folder = data_dir.parent / "app_files"
    there = {p.relative_to(folder).as_posix() for p in folder.glob("*/*")}
    assert there == {known.path for known in FILES}
    wrong = [known.path for known in FILES if not row_of(known, folder, with_steps=False).is_right]
    assert wrong == []


def test_thousandths_of_g_and_of_degrees_are_read_once_the_platform_is_said(tmp_path: Path) -> None:
    force_mg, rate_mdps = 1e3 * FORCE_G, 1e3 * np.degrees(RATE)
    columns = {"timestamp (us)": TIME_S * 1e6} | axes("acc_% [mg]", force_mg) | axes("gyr_% [mdps]", rate_mdps)
    (tmp_path / "imu.csv").write_text(table_text(columns))
    assert "say it with pdr-filter convert FILE --platform" in refusal(tmp_path / "imu.csv")
    recording = read(tmp_path / "imu.csv", platform="android")
    assert_same_streams(recording, WALK, BOTH, time_s=1e-6, rtol=1e-9)


@pytest.mark.parametrize(
    ("separator", "names"), [(",", ("ACC", "GYR", "light")), (";", ("Accelerometer", "Gyroscope", ""))]
)
def test_a_table_with_a_row_for_each_sample_of_any_sensor_is_one_for_each(
    tmp_path: Path, separator: str, names: tuple[str, str, str]
) -> None:
    rows = [
        (int(1e9 * t), name, *values)
        for name, stream in zip(names, (FORCE, RATE, FIELD), strict=True)
        for t, values in zip(TIME_S, stream, strict=True)
    ]
    lines = [separator.join(map(str, row)) for row in sorted(rows, key=lambda row: row[0])]
    header = separator.join(("timestamp_ns", "sensor", "x", "y", "z"))
    (tmp_path / "w.csv").write_text("\n".join([header, *lines]) + "\n")
    found = read_guessed(tmp_path / "w.csv", "android")
    assert_same_streams(found.recording, WALK, "accelerometer gyroscope", time_s=1e-6, rtol=1e-9)
    assert_same_bits(read_mapped(tmp_path / "w.csv", found.guess.mapping), found.recording)


@pytest.mark.parametrize(
    "odd",
    [
        *("1,2,,4,5\n2,3,nan,4,5\n3,4,inf,5,6\n", "1,2,x,4,5\n", "1,2,1_0,4,5\n", "1,2, 3 ,4,5\n", "1,2,1e400,4,5\n"),
        *("1.0,2,3,4,5\n", ",2,3,4,5\n2,2,3,4,5\n", "1,2,#N/A,4,5\n", "1,2,3,4,5\n\n2,3,4,5,6\n", "1,2,3,4\n"),
        *("1,2,3,4,5,6\n1,2,3,4,5\n", "+1,2,+3,.5,5.\n", "1,2,None,null,5\n", "1,\u00e4,3,4,5\n", '"1",2,3,4,5\n'),
        *("1,2,true,4,5\n", "9223372036854775807,2,3,4,5\n", "1787923304123456789,2,0.1,1e-300,123456.789012345678\n"),
    ],
)
def test_the_library_for_large_tables_has_the_same_bits_and_refuses_the_same(
    monkeypatch: pytest.MonkeyPatch, odd: str
) -> None:
    pytest.importorskip("pyarrow")

    def parsed(least_bytes: int) -> object:
        monkeypatch.setattr(tables, "LARGE_BYTES", least_bytes)
        notes: list[str] = []
        try:
            found = tables.parse_blocks([odd.encode()], tables.Layout((2, 3, 4), 0), "walk.csv", notes)
        except RecordingError as error:
            return str(error)
        return found.whole.tolist(), found.values.tobytes(), notes

    assert parsed(1) == parsed(10**9)


def test_the_biases_of_uncalibrated_sensors_are_subtracted_each_from_its_own(tmp_path: Path) -> None:
    offsets = {"acc": np.array([0.1, -0.2, 0.3]), "gyro": np.array([0.01, 0.02, -0.03])}
    columns: dict[str, np.ndarray | list[str]] = {"time": TIME_S}
    for name, values in (("acc", FORCE), ("gyro", RATE)):
        columns |= axes(f"{name}_uncal_%", values + offsets[name])
        columns |= axes(f"{name}_bias_%", np.tile(offsets[name], (len(TIME_S), 1)))
    found = read_guessed(write_text(tmp_path / "walk.csv", table_text(columns)))
    assert_same_streams(found.recording, WALK, BOTH, time_s=1e-6, rtol=1e-9)
    assert "gyroscope: its biases gyro_bias_x, gyro_bias_y, gyro_bias_z are subtracted" in found.guess.evidence
    (tmp_path / "map.toml").write_text(found.guess.mapping.toml(), encoding="utf-8")
    again = read_mapped(tmp_path / "walk.csv", read_mapping(tmp_path / "map.toml"))
    assert_same_streams(again, WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_a_column_of_the_phones_own_steps_and_heading_is_reported_and_changes_nothing(tmp_path: Path) -> None:
    columns = columns_of("time", "acc%", "gyro%")
    plain = read(write_text(tmp_path / "plain.csv", table_text(columns)))
    own = {"stepCount": np.floor(TIME_S), "locationTrueHeading(°)": np.full(len(TIME_S), 12.0)}
    found = read(write_text(tmp_path / "own.csv", table_text(columns | own)))
    assert found.phone_steps == int(TIME_S[-1])
    np.testing.assert_allclose(found.phone_heading.values, np.radians(12.0))
    assert plain.phone_steps is None
    np.testing.assert_array_equal(found.accelerometer.values, plain.accelerometer.values)
