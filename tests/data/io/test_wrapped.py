"""Recordings as they arrive: packed once more, unpacked into a folder of their own, or saved in another code."""

from __future__ import annotations

import gzip
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from app_files import (
    assert_same_streams,
    axes,
    phyphox_files,
    phyphox_sheets,
    physics_toolbox_text,
    refusal,
    sensor_logger_files,
    table_text,
    write_folder,
    write_mat,
    write_zip,
    xlsx_files,
)
from table_cases import FORCE, RATE, TIME_S, WALK

from pdr_filter.data.io import folders
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.values import limits
from pdr_filter.values.recording import Recording

FILES = phyphox_files(WALK)


def assert_walk(recording: Recording) -> None:
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-6, rtol=1e-9)


@pytest.mark.parametrize("around", ["a", "a/b/c"])
def test_a_folder_around_one_recording_is_that_recording(tmp_path: Path, around: str) -> None:
    inner = write_folder(tmp_path / "export" / around, FILES)
    write_folder(tmp_path / "export", {".DS_Store": "x", "__MACOSX/._Accelerometer.csv": "x"})
    found = read(tmp_path / "export")
    assert_walk(found)
    assert found.source == str(inner)
    assert_walk(read(write_zip(tmp_path / "export.zip", FILES, folder=f"{around}/")))


def test_a_zip_alone_in_a_folder_is_read(tmp_path: Path) -> None:
    (tmp_path / "export").mkdir()
    write_zip(tmp_path / "export" / "walk.zip", FILES)
    assert_walk(read(tmp_path / "export"))


def test_what_lies_beside_the_folders_of_sensors_in_one_of_its_own_is_read(tmp_path: Path) -> None:
    files = sensor_logger_files(WALK)
    read_together = read(write_folder(tmp_path / "together", files))
    apart = {f"{Path(name).stem}/{name}": text for name, text in files.items()}
    apart["Microphone/Microphone.csv"] = "time,seconds_elapsed,dBFS\n" + "1700000000000000000,0.0,-40.0\n" * 20
    for path in (write_folder(tmp_path / "apart", apart), write_zip(tmp_path / "apart.zip", apart)):
        recording = read(path)
        assert recording.streams.keys() == read_together.streams.keys()
        assert recording.notes == read_together.notes


def in_folders(name: str) -> dict[str, str]:
    """The files of each sensor in a folder that is called after it."""
    folders = {member: Path(member).stem for member in FILES if not member.startswith("meta/")}
    return {f"{folder}/{name.format(folder=folder)}": FILES[member] for member, folder in folders.items()}


@pytest.mark.parametrize("name", ["data.csv", "{folder}.csv"])
def test_a_folder_for_each_sensor_is_one_recording(tmp_path: Path, name: str) -> None:
    files = in_folders(name)
    write_folder(tmp_path / "walk", files)
    assert recordings_in(tmp_path / "walk") == [tmp_path / "walk"]
    assert_walk(read(tmp_path / "walk"))
    assert_walk(read(write_zip(tmp_path / "walk.zip", files)))
    assert_walk(read(write_zip(tmp_path / "around.zip", files, folder="a/")))


def test_several_walks_in_folders_of_sensors_are_as_many_recordings(tmp_path: Path) -> None:
    files = in_folders("a.csv") | in_folders("b.csv")
    for path in (write_folder(tmp_path / "walks", files), write_zip(tmp_path / "walks.zip", files)):
        assert recordings_in(path) == [path / walk for walk in ("a", "b")]
        for recording in recordings_in(path):
            assert_walk(read(recording))
        assert "holds 2 recordings (a, b)" in refusal(path)


def hourly(names: tuple[str, str], gap_s: float = 0.0) -> dict[str, str]:
    """Files of accelerometer and gyroscope in folders, cut in the middle of the walk."""
    cut_s = float(np.median(TIME_S))
    late = np.where(cut_s <= TIME_S, gap_s, 0.0)
    ms = 1_664_625_543_000 + np.round(1000 * (TIME_S + late)).astype(np.int64)
    parts = dict(zip(names, (cut_s > TIME_S, cut_s <= TIME_S), strict=True))
    return {
        f"{sensor}/{name}.csv": table_text({"timestamp": ms[part]} | axes("%", values[part]))
        for sensor, values in (("accelerometer", FORCE), ("gyro", RATE))
        for name, part in parts.items()
    }


HOURS = ("2022-10-01 11_00_00+00_00", "2022-10-01 12_00_00+00_00")


@pytest.mark.parametrize("names", [HOURS, ("1", "2"), ("20221001T110000Z", "20221001T120000Z")])
@pytest.mark.parametrize("packed", [True, False])
def test_files_of_each_hour_in_folders_of_sensors_are_one_walk(
    tmp_path: Path, names: tuple[str, str], packed: bool
) -> None:
    files = hourly(names)
    path = write_zip(tmp_path / "walk.zip", files) if packed else write_folder(tmp_path / "walk", files)
    assert recordings_in(path) == [path]
    recording = read(path)
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-3, rtol=1e-9)
    assert recording.epoch_s == pytest.approx(1_664_625_543.0, abs=1e-3)


def test_a_folder_is_parsed_again_only_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_folder(tmp_path / "walk", hourly(HOURS))
    compared = list[int]()
    monkeypatch.setattr(folders, "in_time", lambda sheets: compared.append(len(sheets)) or sheets)
    for n_times, change in ((1, ""), (1, ""), (2, "\n")):
        with (path / "gyro" / f"{HOURS[0]}.csv").open("a") as file:
            file.write(change)
        assert recordings_in(path) == [path]
        assert len(compared) == n_times


def test_one_sensor_of_a_recording_is_refused_with_the_folder_to_give(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "hours", hourly(HOURS))
    assert f"give its folder {path}" in refusal(path / "gyro" / f"{HOURS[0]}.csv")
    path = write_folder(tmp_path / "walk", FILES)
    assert f"give its folder {path}" in refusal(path / "Gyroscope.csv")
    path = write_folder(tmp_path / "others", {f"{name}.csv": FILES["Gyroscope.csv"] for name in ("gyro_desk", "turn")})
    write_folder(path, {"gyro_hike.csv": physics_toolbox_text(WALK), "acc_hike.csv": FILES["Accelerometer.csv"]})
    for name in ("gyro_desk", "turn"):
        assert "record it and export again" in refusal(path / f"{name}.csv")


@pytest.mark.parametrize(("names", "gap_s"), [(HOURS, 60.0), (("walk1", "walk2"), 0.0)])
def test_files_that_do_not_continue_each_other_or_are_named_as_walks_are_two(
    tmp_path: Path, names: tuple[str, str], gap_s: float
) -> None:
    path = write_folder(tmp_path / "walk", hourly(names, gap_s))
    assert len(recordings_in(path)) == 2
    assert all(read(part).gyroscope is not None for part in recordings_in(path))


def test_walks_with_a_folder_for_each_sensor_are_as_many(tmp_path: Path) -> None:
    for walk in ("a", "b"):
        write_folder(tmp_path / "walks" / walk, in_folders("data.csv"))
    assert recordings_in(tmp_path / "walks") == [tmp_path / "walks" / walk for walk in ("a", "b")]


def test_of_many_recordings_three_are_named_and_that_there_are_more(tmp_path: Path) -> None:
    for name in "abcd":
        write_folder(tmp_path / "export" / name, FILES)
    message = refusal(tmp_path / "export")
    assert "holds 4 recordings (a, b, c, ...); read one, such as" in message
    assert "pdr_filter.data.io.folders.recordings_in" in message


def test_a_folder_with_more_files_than_recordings_have_is_not_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_folder(tmp_path / "home" / "walk", FILES)
    monkeypatch.setattr(limits, "MAX_MEMBERS", 3)
    assert "no recording" in refusal(tmp_path / "home")


def test_a_folder_with_a_link_is_not_searched(tmp_path: Path) -> None:
    write_folder(tmp_path / "elsewhere", FILES)
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "walk").symlink_to(tmp_path / "elsewhere")
    assert "no recording" in refusal(tmp_path / "export")


def test_a_recording_in_a_gz_is_read(tmp_path: Path) -> None:
    text = phyphox_files(WALK)["Accelerometer.csv"]
    (tmp_path / "walk.csv.gz").write_bytes(gzip.compress(text.encode()))
    assert_same_streams(read(tmp_path / "walk.csv.gz"), WALK, "accelerometer", time_s=1e-6, rtol=1e-9)
    (tmp_path / "walk.zip.gz").write_bytes(gzip.compress(write_zip(tmp_path / "walk.zip", FILES).read_bytes()))
    assert_walk(read(tmp_path / "walk.zip.gz"))
    assert tmp_path / "walk.zip.gz" in recordings_in(tmp_path)


def test_a_gz_that_unpacks_to_more_than_sensors_can_is_refused(tmp_path: Path) -> None:
    packed = gzip.compress(b"t,ax,ay,az\n0.00,0,0,9.8\n0.02,0,0,9.8\n" + b"0.04,0,0,9.8\n" * 500_000)
    (tmp_path / "bomb.csv.gz").write_bytes(packed)
    assert limits.MAX_COMPRESSION_RATIO * len(packed) < limits.UNPACKED_FREELY_BYTES
    assert f"more than {limits.UNPACKED_FREELY_BYTES} bytes" in refusal(tmp_path / "bomb.csv.gz")


def zip_of(files: dict[str, bytes]) -> bytes:
    packed = BytesIO()
    with ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return packed.getvalue()


def test_a_zip_in_a_zip_is_read_and_of_several_the_one_that_is_named(tmp_path: Path) -> None:
    inner = write_zip(tmp_path / "inner.zip", FILES).read_bytes()
    for others in ({}, {"README.txt": b"Walked on Monday, 2 times\n", "photo.jpg": b"\xff\xd8"}):
        (tmp_path / "one.zip").write_bytes(zip_of({"phyphox 2026.zip": inner, **others}))
        assert_walk(read(tmp_path / "one.zip"))
    (tmp_path / "two.zip").write_bytes(zip_of({"a.zip": inner, "b.zip": inner}))
    assert "holds 2 recordings (a.zip, b.zip)" in refusal(tmp_path / "two.zip")
    assert recordings_in(tmp_path / "two.zip") == [tmp_path / "two.zip" / name for name in ("a.zip", "b.zip")]
    assert_walk(read(tmp_path / "two.zip" / "b.zip"))


def test_a_spreadsheet_or_a_matlab_file_in_a_zip_or_a_gz_is_read(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    sheet = write_zip(tmp_path / "s.xlsx", xlsx_files(phyphox_sheets(WALK))).read_bytes()
    (tmp_path / "in_a.zip").write_bytes(zip_of({"walk.xlsx": sheet}))
    (tmp_path / "w.xlsx.gz").write_bytes(gzip.compress(sheet))
    for name in ("in_a.zip", "w.xlsx.gz"):
        assert_same_streams(read(tmp_path / name), WALK, "accelerometer gyroscope", time_s=1e-9, rtol=1e-12)
    matlab = write_mat(tmp_path / "w.mat", WALK).read_bytes()
    (tmp_path / "mat.zip").write_bytes(zip_of({"walk.mat": matlab}))
    assert_walk(read(tmp_path / "mat.zip"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"7z\xbc\xaf\x27\x1c", "a 7z archive; unpack it"),
        (b"Rar!\x1a\x07", "a rar archive; unpack it"),
        (bytes(257) + b"ustar", "a tar archive; unpack it"),
        (gzip.compress(bytes(257) + b"ustar", mtime=0), "a tar archive; unpack it"),
        (b"%PDF-1.4\n", "a PDF; export the samples"),
        (b"\n<!DOCTYPE html><html>", "a web page; download the file itself"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d\n", "git lfs pull"),
    ],
)
def test_what_is_given_in_place_of_a_recording_is_named(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "walk.csv").write_bytes(content)
    assert words in refusal(tmp_path / "walk.csv")


@pytest.mark.parametrize("name", ["walk.xls", "export/walk.h5", "walk.csv.gz"])
def test_a_file_that_is_read_alone_is_to_be_taken_out_of_a_zip(tmp_path: Path, name: str) -> None:
    assert f"unpack {name}, which is read alone" in refusal(write_zip(tmp_path / "w.zip", {name: b"PK"}))


def test_of_zips_in_zips_only_the_first_is_opened(tmp_path: Path) -> None:
    """Some hold themselves."""
    packed = write_zip(tmp_path / "inner.zip", FILES).read_bytes()
    for _ in range(2):
        packed = zip_of({"inner.zip": packed})
    (tmp_path / "deep.zip").write_bytes(packed)
    assert "no recording" in refusal(tmp_path / "deep.zip")


def test_what_a_zip_in_a_zip_claims_is_compared_with_its_own_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "UNPACKED_FREELY_BYTES", 1000)
    bomb = write_zip(tmp_path / "inner.zip", {"Accelerometer.csv": "0" * 200_000}).read_bytes()
    (tmp_path / "w.zip").write_bytes(zip_of({"inner.zip": bomb, "pad.zip": FILES["Accelerometer.csv"].encode()}))
    assert "times its size" in refusal(tmp_path / "w.zip" / "inner.zip")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_text_with_a_byte_order_mark_is_read(tmp_path: Path, encoding: str) -> None:
    files = {name: text.encode(encoding) for name, text in FILES.items()}
    assert_walk(read(write_folder(tmp_path / "walk", files)))
    assert_walk(read(write_zip(tmp_path / "walk.zip", files)))
