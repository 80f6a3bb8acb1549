"""Every reader against hostile and damaged files: a recording or a clear refusal, soon, and nothing written."""

from __future__ import annotations

import random
import zipfile
from pathlib import Path
from time import process_time as time_of_processor

import numpy as np
import pytest
from app_files import a_walk, phyphox_files, refusal, sensor_logger_files, sensor_logger_json, write_folder, write_zip
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutations import FORMS, faults_of_recording, faults_of_refusal, good_file, mutated_file

from pdr_filter.data.io.detection import detect
from pdr_filter.data.io.formats import FORMATS, read
from pdr_filter.values.errors import RecordingError

AS_TABLES = ("phyphox", "core_motion")  # formats that are read like the tables of any app
TEXTS = ("sensor_logger:json", "get_sensor_data", "indoor_location", "core_motion", "phyphox:csv")
# Of processor time; each takes some 0.1 s, and a machine may be busy. The benchmark of the same mutations says seconds.
SOON_S = 5.0
FUZZ = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def good(form: str, folder: Path) -> Path:
    if form == "ronin":
        pytest.importorskip("h5py")
    folder.mkdir(exist_ok=True)
    return good_file(form, folder)


def files_in(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_recording_or_refusal(path: Path, format: str | None) -> None:
    """A refusal that names the file, or a recording that its report fits; no file is written, changed or removed."""
    before = files_in(path.parent)
    try:
        recording = read(path, format)
    except RecordingError as error:
        assert faults_of_refusal(str(error), path) == []
    else:
        assert faults_of_recording(recording, format) == []
    assert files_in(path.parent) == before


# ---------------------------------------------------------------- formats are found by content


@pytest.mark.parametrize("form", FORMS)
def test_the_format_is_found_by_content_whatever_the_name(tmp_path: Path, form: str) -> None:
    path = good(form, tmp_path / "x")
    format = form.partition(":")[0]
    format = "table" if format in AS_TABLES else format
    assert detect(path) == format
    if form != "generic_csv":  # which the file beside it makes known
        renamed = path.rename(path.with_name("recording.bin"))
        assert detect(renamed) == format
        assert len(read(renamed).accelerometer) > 0


@pytest.mark.parametrize("format", sorted(set(FORMATS) - {"table", *AS_TABLES}))  # which read the tables of others, too
def test_a_format_that_is_forced_on_another_file_is_refused_clearly(tmp_path: Path, format: str) -> None:
    if format == "ronin":
        pytest.importorskip("h5py")
    for form in FORMS[:-1]:
        if form.partition(":")[0] != format:
            assert refusal(good(form, tmp_path / form.replace(":", "_")), format)


# ---------------------------------------------------------------- damaged files


@pytest.mark.parametrize("form", FORMS)
@FUZZ
@given(seed=st.integers(0, 2**32))
def test_a_mutated_file_gives_a_recording_or_a_refusal(tmp_path: Path, form: str, seed: int) -> None:
    rng = random.Random(seed)
    path = good(form, tmp_path / "good")
    folder = tmp_path / "mutated"
    folder.mkdir(exist_ok=True)
    mutated = mutated_file(path, folder, rng)
    assert_recording_or_refusal(mutated, rng.choice([None, form.partition(":")[0]]))
    assert {entry.name for entry in tmp_path.iterdir()} == {"good", "mutated"}


@pytest.mark.parametrize("format", sorted(set(FORMATS) - {"ronin"}))
@FUZZ
@given(content=st.binary(max_size=200))
def test_any_bytes_give_a_recording_or_a_refusal(tmp_path: Path, format: str, content: bytes) -> None:
    (tmp_path / "any_bytes").write_bytes(content)
    assert_recording_or_refusal(tmp_path / "any_bytes", format)
    assert_recording_or_refusal(tmp_path / "any_bytes", None)


# ---------------------------------------------------------------- hostile files


@pytest.mark.parametrize(
    "files",
    [sensor_logger_files(a_walk()), phyphox_files(a_walk()), {"accelerometer.csv": "time_s,x,y,z\n"}],
    ids=["sensor_logger", "phyphox", "own"],
)
@pytest.mark.parametrize("name", ["../evil.csv", "/etc/evil.csv", "a/../../evil.csv", "..\\evil.csv", "C:\\evil.csv"])
def test_a_member_that_points_outside_the_zip_is_refused(tmp_path: Path, files: dict[str, str], name: str) -> None:
    path = write_zip(tmp_path / "w.zip", {**files, name: "x"})
    assert "points outside the zip" in refusal(path)
    assert {entry.name for entry in tmp_path.iterdir()} == {"w.zip"}


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("accelerometer.csv", b""),
        ("TotalAcceleration.csv", b"time,seconds_elapsed,z,y,x\n"),
        ("Raw Data.csv", b'"Time (s)","Acceleration x (m/s^2)"\n'),
        ("log.txt", b"ACCE;0.1;0.1;0.1;0.1;9.8;3\n"),
        ("walk.txt", b"1574659531598\tTYPE_ACCELEROMETER\t0\t0\t9.8\t3\n"),
        ("walk.csv", b"gravity.x,gravity.y,gravity.z,userAcceleration.x,userAcceleration.y,userAcceleration.z\n"),
    ],
)
def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, name: str, head: bytes) -> None:
    path = tmp_path / "w.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        with file.open(name, "w") as member:
            member.write(head)
            for _ in range(65):
                member.write(b"0" * 2**20)
        file.writestr("Metadata.csv", "platform,standardisation\nandroid,false")
    begin = time_of_processor()
    assert "times its size" in refusal(path)
    assert time_of_processor() - begin < SOON_S
    assert [entry.name for entry in tmp_path.iterdir()] == ["w.zip"]


@pytest.mark.parametrize("byte", [b"0", b"\n", b",", b";", b'"', b"\t", b" ", b"\r"])
@pytest.mark.parametrize("form", TEXTS)
def test_megabytes_of_one_byte_after_good_lines_end_soon(tmp_path: Path, form: str, byte: bytes) -> None:
    path = good(form, tmp_path / "x")
    path.write_bytes(path.read_bytes() + byte * 500_000)
    begin = time_of_processor()
    assert_recording_or_refusal(path, form.partition(":")[0])
    assert time_of_processor() - begin < SOON_S


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("form", TEXTS)
def test_two_byte_text_without_its_mark_is_refused_with_the_encoding_to_use(
    tmp_path: Path, form: str, encoding: str
) -> None:
    path = good(form, tmp_path / "x")
    path.write_bytes(path.read_bytes().decode("latin-1").encode(encoding))
    assert "UTF-8" in refusal(path, form.partition(":")[0])
    assert refusal(path)


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e999", "nan"])
@pytest.mark.parametrize("form", ["sensor_logger", "get_sensor_data", "indoor_location", "phyphox"])
def test_an_absurd_value_is_unknown_and_changes_no_other(tmp_path: Path, form: str, value: str) -> None:
    path = good({"phyphox": "phyphox:csv", "sensor_logger": "sensor_logger:json"}.get(form, form), tmp_path / "x")
    before = read(path).accelerometer.values
    text = path.read_text(encoding="latin-1")
    number = repr(float(before[3, 1])) if form != "phyphox" else None
    if number is None:
        lines = text.splitlines(keepends=True)
        fields = lines[4].split(";")
        lines[4] = ";".join([*fields[:2], value, *fields[3:]])
        text = "".join(lines)
    else:
        assert text.count(number) >= 1
        text = text.replace(number, value, 1)
    path.write_text(text, encoding="latin-1")
    after = read(path).accelerometer.values
    assert np.isnan(after[3, 1])
    before = before.copy()
    before[3, 1] = np.nan
    np.testing.assert_array_equal(after, before)


def test_a_folder_that_is_no_recording_is_refused_with_what_is_in_it(tmp_path: Path) -> None:
    write_folder(tmp_path / "w", {"photo.jpg": "x", "notes.txt": "hello"})
    assert "found: notes.txt, photo.jpg" in refusal(tmp_path / "w")


def test_times_that_an_int64_cannot_subtract_are_refused(tmp_path: Path) -> None:
    files = sensor_logger_files(a_walk())
    lines = files["TotalAcceleration.csv"].splitlines(keepends=True)
    for far in (9_223_372_036_854_775_807, -9_223_372_036_854_775_808):
        files["TotalAcceleration.csv"] = "".join([*lines, f"{far},25.0,9.8,0.0,0.0\n"])
        assert "export them as they were recorded" in refusal(write_folder(tmp_path / "w", files))


@pytest.mark.parametrize(
    "time", ["1e999999999", "-1e999999", "1e-999999999", "9" * 30, "1_0", "0x1", "Infinity", "1e18.5"]
)
def test_a_time_that_is_no_whole_number_is_refused_or_unknown_soon(tmp_path: Path, time: str) -> None:
    files = sensor_logger_files(a_walk())
    files["TotalAcceleration.csv"] += f"{time},25.0,9.8,0.0,0.0\n"
    begin = time_of_processor()
    for format in (None, "sensor_logger"):
        assert_recording_or_refusal(write_folder(tmp_path / "walk", files), format)
    (tmp_path / "walk.json").write_text(sensor_logger_json(files))
    assert_recording_or_refusal(tmp_path / "walk.json", None)
    assert time_of_processor() - begin < SOON_S


@pytest.mark.parametrize("form", ["sensor_logger:json", "get_sensor_data", "indoor_location"])
def test_a_value_whose_square_vanishes_is_read_without_a_warning(tmp_path: Path, form: str) -> None:
    path = good(form, tmp_path / "x")
    text, row = path.read_text(encoding="latin-1"), read(path).accelerometer.values[3]
    for number in row.tolist():
        text = text.replace(repr(number), "1e-200", 1)
    path.write_text(text, encoding="latin-1")
    np.testing.assert_array_equal(read(path).accelerometer.values[3], [1e-200] * 3)
