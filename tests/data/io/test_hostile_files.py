"""Small files that ask for much, and files that stand for others: refused soon, in little memory."""

from __future__ import annotations

import json
import os
import random
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from app_files import a_walk, phyphox_files, refusal, write_folder, write_zip
from mutations import FORMS, faults_of_recording, faults_of_refusal, good_file, of_another_kind
from oddities import N, hourly

from pdr_filter import batch
from pdr_filter.data.io.detection import detect
from pdr_filter.data.io.fix_files import fixes_of_file
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples, limits
from pdr_filter.values.errors import RecordingError

ROWS = "time_s,x,y,z\n" + "".join(f"{i / 100},0.1,0.2,9.8\n" for i in range(50))
SOON_S = 3.0  # of processor time, on a machine that may be busy; each takes some 0.1 s
LITTLE_BYTES = 100 << 20


@contextmanager
def soon_and_in_little_memory() -> Iterator[None]:
    tracemalloc.start()
    begin = process_time()
    try:
        yield
        assert process_time() - begin < SOON_S
        assert tracemalloc.get_traced_memory()[1] < LITTLE_BYTES
    finally:
        tracemalloc.stop()


# ---------------------------------------------------------------- text that takes long


@pytest.mark.parametrize("column", ['"a{}b"', '"a{}b (m/s^2)"', '"a{}(m/s^2"', '"{}x (g)"', "a{}x(", "({}", "){}"])
def test_a_phyphox_header_takes_no_longer_than_its_length(tmp_path: Path, column: str) -> None:
    (tmp_path / "a.csv").write_text(f'"Time (s)",{column.format(" " * 130_000)}\n0,0\n')
    with soon_and_in_little_memory():
        assert refusal(tmp_path / "a.csv", "phyphox")


def test_a_table_of_a_hundred_thousand_columns_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"accelerometer.csv": "time_s,x,y,z" + ",a" * 100_000 + "\n0,0,0,9.8\n"})
    assert "100004 columns" in refusal(path)


# ---------------------------------------------------------------- small zips that unpack to much


def labels(n: int, longest: int) -> str:
    return f"start_s,end_s,context,carrying_mode\n0,1,{'w' * longest},\n" + "0,1,walking,\n" * n


def test_a_long_label_is_cut_with_a_note_so_that_others_are_not_as_wide(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"accelerometer.csv": ROWS, "truth_labels.csv": labels(10_000, 4000)})
    with soon_and_in_little_memory():
        recording = read(path)
    assert [len(text) for text in recording.truth.labels.context[:2]] == [limits.MAX_NAME_CHARS, len("walking")]
    assert any("texts of more than 200 characters" in note for note in recording.notes)


def test_more_labels_than_seconds_of_a_day_are_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"accelerometer.csv": ROWS, "truth_labels.csv": labels(200_000, 10)})
    with soon_and_in_little_memory():
        assert "truth_labels.csv: more than 86400 rows" in refusal(path)


@pytest.mark.parametrize(
    ("name", "line"),
    [("gyroscope.csv", b",,,\n"), ("truth_position.csv", b"0,,,\n"), ("meta.json", b"{},"), ("notes.txt", b"\n")],
)
def test_a_zip_that_unpacks_to_more_than_sensors_can_is_refused(tmp_path: Path, name: str, line: bytes) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("accelerometer.csv", ROWS)
        with archive.open(name, "w") as member:
            for _ in range(5):
                member.write(line * (1_000_000 // len(line)))
    assert path.stat().st_size < 50_000
    with soon_and_in_little_memory():
        assert "times its size" in refusal(path)


def test_many_members_are_refused_like_one_that_is_as_large(tmp_path: Path) -> None:
    files = {f"{i}.csv": "0,0,0,0\n" * 60_000 for i in range(10)}  # each is harmless
    assert "times its size" in refusal(write_zip(tmp_path / "a.zip", {"accelerometer.csv": ROWS, **files}))


def test_a_walk_whose_phone_lies_still_is_not_taken_for_a_bomb(tmp_path: Path) -> None:
    files = phyphox_files(a_walk())
    lines = ['"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"\n']
    lines += [f"{i / 200:.9E},{0:.9E},{0:.9E},{9.81:.9E}\n" for i in range(100_000)]
    files["Accelerometer.csv"] = "".join(lines)
    assert len(files["Accelerometer.csv"]) > limits.UNPACKED_FREELY_BYTES
    path = write_zip(tmp_path / "a.zip", {"Accelerometer.csv": files["Accelerometer.csv"]})
    assert len(read(path).accelerometer) == 100_000


@pytest.mark.parametrize("write", [write_zip, write_folder])
def test_meta_data_of_more_than_a_megabyte_are_refused(
    tmp_path: Path, write: Callable[[Path, dict[str, str]], Path]
) -> None:
    meta = json.dumps({"notes": random.Random(0).randbytes(600_000).hex()})
    path = write(tmp_path / "a.zip", {"accelerometer.csv": ROWS, "meta.json": meta})
    assert f"meta.json: more than {limits.MAX_SMALL_BYTES} bytes" in refusal(path)


def test_what_is_read_of_one_recording_is_bounded_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {"accelerometer.csv": ROWS, "gyroscope.csv": ROWS, "magnetometer.csv": ROWS}
    path = write_folder(tmp_path / "a", files)
    read(path)
    monkeypatch.setattr(limits, "MAX_READ_BYTES", 2 * len(ROWS))
    assert f"more than {2 * len(ROWS)} bytes" in refusal(path)


def test_more_tables_than_are_read_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_folder(tmp_path / "a", hourly())
    assert len(read(path).accelerometer) == N
    monkeypatch.setattr(limits, "MAX_FILES_LOOKED_AT", 3)
    assert "4 tables, and at most 3 are read" in refusal(path)


def test_a_name_that_no_file_could_have_is_not_taken(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"accelerometer.csv": ROWS, "meta.json": json.dumps({"name": "n" * 300})})
    assert read(path).name == "a"


def test_notes_print_whatever_a_file_holds(tmp_path: Path) -> None:
    files = {"accelerometer.csv": ROWS, "truth_labels.csv": "start_s,end_s,context,carrying_mode\n0,1,\x1b[2J,\n"}
    recording = read(write_zip(tmp_path / "a.zip", files))
    assert any("does not have (\\x1b[2J)" in note for note in recording.notes)
    assert all(note.isprintable() for note in recording.notes)


# ---------------------------------------------------------------- what is no file, or another one


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seed", range(4))
def test_a_pipe_a_device_or_a_link_in_place_of_a_file_is_refused_soon(tmp_path: Path, form: str, seed: int) -> None:
    if form == "ronin":
        pytest.importorskip("h5py")
    for name in ("good", "x", "elsewhere"):
        (tmp_path / name).mkdir()
    path = of_another_kind(
        good_file(form, tmp_path / "good"), tmp_path / "x", tmp_path / "elsewhere", random.Random(seed)
    )
    for format in (None, form.partition(":")[0]):
        begin = process_time()
        try:
            recording = read(path, format)
        except RecordingError as error:
            assert faults_of_refusal(str(error), path) == []
        else:  # the member is one that this format does without
            assert faults_of_recording(recording, format) == []
        assert process_time() - begin < SOON_S


def test_a_sensor_that_is_a_link_out_of_its_folder_is_refused_and_one_within_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "private.csv").write_text(ROWS)
    folder = write_folder(tmp_path / "walk", {"rows": ROWS})
    (folder / "accelerometer.csv").symlink_to("rows")
    assert len(read(folder).accelerometer) == 50
    (folder / "accelerometer.csv").unlink()
    (folder / "accelerometer.csv").symlink_to(tmp_path / "private.csv")
    assert "accelerometer.csv: a link that leads out of its folder" in refusal(folder)


def test_a_recording_may_itself_be_a_link(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"accelerometer.csv": ROWS})
    (tmp_path / "chosen").mkdir()
    (tmp_path / "chosen" / "a.zip").symlink_to(path)
    (tmp_path / "chosen" / "b").symlink_to(write_folder(tmp_path / "b", {"accelerometer.csv": ROWS}))
    for name in ("a.zip", "b"):
        assert len(read(tmp_path / "chosen" / name).accelerometer) == 50


def test_a_batch_over_a_folder_with_pipes_and_devices_ends(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walks", {"note.md": "x"})
    for name in ("a.csv", "a.zip", "data.h5"):
        os.mkfifo(folder / name)
    (folder / "b.csv").symlink_to("/dev/zero")
    (folder / "c").mkdir()
    os.mkfifo(folder / "c" / "data.hdf5")
    assert recordings_in(folder) == [folder / "c"]
    (row,) = batch.track(folder, out=tmp_path / "tracks.csv")
    assert "data.hdf5: not a file but a pipe" in row.reason


@pytest.mark.parametrize("beside", ["good.toml", "good.csv.toml"])
def test_a_mapping_that_is_a_link_out_of_its_folder_is_refused(tmp_path: Path, beside: str) -> None:
    (tmp_path / "x").mkdir()
    path = good_file("generic_csv", tmp_path / "x")
    path.with_suffix(".toml").rename(tmp_path / "mapping.toml")
    (tmp_path / "x" / beside).symlink_to(tmp_path / "mapping.toml")
    assert "a link that leads out of its folder" in refusal(path, "generic_csv")


def test_fixes_of_a_pipe_and_more_than_a_walk_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match=r"pipe\.csv: not a file but a pipe"):
        fixes_of_file(tmp_path / "pipe.csv")
    (tmp_path / "fixes.csv").write_text("time_s,east_m,north_m\n" + "1,2,3\n" * 5)
    assert len(fixes_of_file(tmp_path / "fixes.csv")) == 5
    monkeypatch.setattr(limits, "MAX_FIXES", 4)
    with pytest.raises(ValueError, match=r"fixes\.csv: more than 4 fixes"):
        fixes_of_file(tmp_path / "fixes.csv")


# ---------------------------------------------------------------- hdf5


def hdf5(path: Path, change: Callable[[Any, Any], object]) -> Path:
    """A good file, changed by `change(h5py, file)`."""
    h5py = pytest.importorskip("h5py")
    walk = a_walk().accelerometer
    with h5py.File(path, "w", libver="latest") as file:
        file["synced/time"] = np.arange(len(walk)) / 200
        file["synced/acce"] = walk.values
        change(h5py, file)
    return path


def elsewhere(tmp_path: Path) -> Path:
    """Another hdf5 file, with data that would pass for a sensor's."""
    h5py = pytest.importorskip("h5py")
    n = len(a_walk().accelerometer)
    with h5py.File(tmp_path / "elsewhere.h5", "w") as file:
        file["synced/magnet"] = np.full((n, 3), 1.0)
    (tmp_path / "raw").write_bytes(bytes(n * 3))
    return tmp_path / "elsewhere.h5"


def external_storage(h5py: Any, file: Any, other: Path) -> None:
    n = len(file["synced/time"])
    file.create_dataset("synced/magnet", (n, 3), "u1", external=[(str(other.parent / "raw"), 0, 3 * n)])


def external_link(h5py: Any, file: Any, other: Path) -> None:
    file["synced/magnet"] = h5py.ExternalLink(str(other), "synced/magnet")


def external_group(h5py: Any, file: Any, other: Path) -> None:
    del file["synced"]
    file["synced"] = h5py.ExternalLink(str(other), "synced")


def link_by_way_of_another(h5py: Any, file: Any, other: Path) -> None:
    file["other"] = h5py.ExternalLink(str(other), "synced")
    file["synced/magnet"] = h5py.SoftLink("/other/magnet")


def virtual(h5py: Any, file: Any, other: Path) -> None:
    shape = (len(file["synced/time"]), 3)
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource(str(other), "synced/magnet", shape)
    file.create_virtual_dataset("synced/magnet", layout)


@pytest.mark.parametrize("keep", [external_storage, external_link, external_group, link_by_way_of_another, virtual])
def test_data_that_hdf5_keeps_in_another_file_are_refused(
    tmp_path: Path, keep: Callable[[Any, Any, Path], None]
) -> None:
    other = elsewhere(tmp_path)
    path = hdf5(tmp_path / "data.hdf5", lambda h5py, file: keep(h5py, file, other))
    message = refusal(path)
    assert "is a link" in message or "other files" in message
    assert "take data.hdf5 as published, or write the values into one file with h5py" in message


def never_written(h5py: Any, file: Any) -> None:
    del file["synced/acce"]
    file.create_dataset("synced/acce", (10_000_000, 3), "f8", chunks=(1000, 3))


def large_piece(h5py: Any, file: Any) -> None:
    file.create_dataset("synced/magnet", data=np.zeros((10, 3)), maxshape=(None, 3), chunks=(10**7, 3), compression=9)


def filter_upon_filter(h5py: Any, file: Any) -> None:
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((1000, 3))
    properties.set_deflate(9)
    properties.set_deflate(9)
    space = h5py.h5s.create_simple((1000, 3))
    h5py.h5d.create(file["synced"].id, b"magnet", h5py.h5t.NATIVE_DOUBLE, space, properties)


def piece_that_grows(h5py: Any, file: Any) -> None:
    import zlib

    n = len(file["synced/time"])
    made = file.create_dataset("synced/magnet", (n, 3), "f8", chunks=(n, 3), compression=9)
    made.id.write_direct_chunk((0, 0), zlib.compress(bytes(200 << 20), 9))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (never_written, "claims 240000000 bytes and 0 are stored"),
        (large_piece, "claims 240000000 bytes"),
        (filter_upon_filter, r"filters \[1, 1\]"),
        (piece_that_grows, "bytes unpacked; write the file again"),
    ],
)
def test_an_array_that_unpacks_to_more_than_sensors_can_is_refused(
    tmp_path: Path, change: Callable[[Any, Any], None], words: str
) -> None:
    path = hdf5(tmp_path / "data.hdf5", change)
    with soon_and_in_little_memory(), pytest.raises(RecordingError, match=words):
        read(path)


@pytest.mark.parametrize(
    "options", [{"compression": "gzip", "shuffle": True, "fletcher32": True}, {"compression": "lzf"}]
)
def test_a_packed_array_is_read(tmp_path: Path, options: dict[str, Any]) -> None:
    def packed(h5py: Any, file: Any) -> None:
        file.create_dataset("synced/magnet", data=np.ones((len(file["synced/time"]), 3)), chunks=(100, 3), **options)

    samples = read(hdf5(tmp_path / "data.hdf5", packed)).magnetometer
    assert isinstance(samples, Samples)
    assert (samples.values == 1).all()


def test_a_folder_with_a_pipe_that_no_format_needs_is_what_it_would_be_without(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", {"accelerometer.csv": ROWS})
    os.mkfifo(folder / "socket")
    assert detect(folder) == "own"
    assert len(read(folder).accelerometer) == 50
