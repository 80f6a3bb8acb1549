"""Files of others are opened if they are files, and files of ours are whole or not there."""

from __future__ import annotations

import errno
import os
import resource
import stat
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from app_files import a_walk
from test_writers import small_track

from pdr_filter.apps.report.html import write_report
from pdr_filter.data.io.files import track_writers as writers
from pdr_filter.data.io.folders import notes_on_people, with_person_of_file
from pdr_filter.sensing.device import Device
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.safe_files import beside, inside, open_regular, read_small, whole_file, write_text

WALK = a_walk()
WRITERS: dict[str, Callable[[Path], object]] = {
    "recording.zip": lambda path: WALK.save(path),
    "track.csv": lambda path: writers.write_csv(small_track(), path),
    "track.geojson": lambda path: writers.write_geojson(small_track(), path, (51.0, 0.0)),
    "track.gpx": lambda path: writers.write_gpx(small_track(), path, (51.0, 0.0)),
    "track.tum": lambda path: writers.write_tum(small_track(), path),
    "track.html": lambda path: write_report(small_track(), path),
    "device.json": lambda path: Device().save(path),
}


@contextmanager
def disk_with(n_bytes: int) -> Generator[None]:
    """No file can grow beyond this: what a full disk does to a writer."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


# ---------------------------------------------------------------- reading


def test_a_pipe_is_refused_without_waiting_for_its_other_end(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingError, match="not a file but a pipe"):
        open_regular(tmp_path / "pipe")


@pytest.mark.parametrize(("name", "kind"), [("/dev/zero", "a device"), ("/", "a folder")])
def test_what_is_no_regular_file_is_refused(name: str, kind: str) -> None:
    with pytest.raises(RecordingError, match=f"{name}: not a file but {kind}"):
        open_regular(Path(name))


def test_a_device_is_not_even_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(path: Path, flags: int) -> int:
        raise AssertionError(path)

    monkeypatch.setattr(os, "open", opened)
    with pytest.raises(RecordingError, match="a device"):
        open_regular(Path("/dev/zero"))


def test_a_pipe_that_takes_the_place_of_a_file_after_the_check_is_refused_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    of_file = (tmp_path / "file").stat()
    monkeypatch.setattr(Path, "stat", lambda self, **options: of_file)
    with pytest.raises(RecordingError, match="not a file but a pipe"):
        open_regular(tmp_path / "pipe")


@pytest.mark.skipif(not hasattr(os, "SEEK_DATA"), reason="the system does not tell holes")
@pytest.mark.parametrize("begin", [b"", b"time_s,x,y,z\n"])
def test_a_file_of_holes_is_refused_and_one_with_enough_data_is_read(tmp_path: Path, begin: bytes) -> None:
    path, size = tmp_path / "sparse", 10 * limits.UNPACKED_FREELY_BYTES
    path.write_bytes(begin)
    os.truncate(path, size)
    with pytest.raises(RecordingError, match=f"{size} bytes, of which nearly all were never written"):
        open_regular(path)
    with path.open("r+b") as file:
        file.seek(size // 2)
        file.write(os.urandom(size // limits.MAX_COMPRESSION_RATIO + 4096))
    with open_regular(path) as file:
        assert file.read(4) == (begin + bytes(4))[:4]


def test_a_small_file_is_read_up_to_its_bound_and_not_beyond(tmp_path: Path) -> None:
    (tmp_path / "small").write_bytes(b"x" * 10)
    assert read_small(tmp_path / "small", 10) == b"x" * 10
    with pytest.raises(RecordingError, match="small: more than 9 bytes"):
        read_small(tmp_path / "small", 9)


def test_a_link_may_lead_within_its_folder_and_not_out_of_it(tmp_path: Path) -> None:
    (tmp_path / "walk").mkdir()
    for name in ("walk/own.csv", "private.csv"):
        (tmp_path / name).touch()
    for name in ("own.csv", "../private.csv"):
        (tmp_path / "walk" / f"link_{Path(name).name}").symlink_to(name)
    for name in ("own.csv", "link_own.csv"):
        assert inside(tmp_path / "walk" / name, tmp_path / "walk") == tmp_path / "walk" / name
    with pytest.raises(RecordingError, match=r"link_private\.csv: a link that leads out of its folder"):
        inside(tmp_path / "walk" / "link_private.csv", tmp_path / "walk")


def test_a_file_beside_a_link_may_be_a_link_into_the_same_folder(tmp_path: Path) -> None:
    for folder in ("data", "chosen", "other"):
        (tmp_path / folder).mkdir()
    for name in ("walk.csv", "walk.toml"):
        (tmp_path / "data" / name).touch()
        (tmp_path / "chosen" / name).symlink_to(tmp_path / "data" / name)
    assert beside(tmp_path / "chosen" / "walk.csv", "walk.toml") == tmp_path / "chosen" / "walk.toml"
    (tmp_path / "other" / "walk.csv").touch()
    (tmp_path / "other" / "walk.toml").symlink_to(tmp_path / "data" / "walk.toml")
    with pytest.raises(RecordingError, match="leads out"):
        beside(tmp_path / "other" / "walk.csv", "walk.toml")


# ---------------------------------------------------------------- writing


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_file_that_was_there_and_no_rest(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("before")
    with disk_with(60), pytest.raises(OSError) as caught:
        WRITERS[name](path)
    assert caught.value.errno == errno.EFBIG
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
    WRITERS[name](path)
    assert path.read_text(encoding="latin-1") != "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_the_recording_that_was_in_a_folder(tmp_path: Path) -> None:
    WALK.of_height(1.6).save(tmp_path / "walk")
    before = {path: path.read_bytes() for path in (tmp_path / "walk").iterdir()}
    largest = max(map(len, before.values()))
    with disk_with(largest - 100), pytest.raises(OSError, match="too large"):
        WALK.of_height(1.9).save(tmp_path / "walk")
    assert {path: path.read_bytes() for path in (tmp_path / "walk").iterdir()} == before


def test_a_disk_that_says_late_that_it_is_full_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_text(tmp_path / "track.csv", "time_s\n")
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_not_under_its_name_before_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "track.csv"
    with whole_file(path) as file:
        file.write(b"half")
        file.flush()
        assert not path.exists()
    assert path.read_bytes() == b"half"


def test_a_link_stays_a_link_and_a_file_keeps_its_permissions(tmp_path: Path) -> None:
    (tmp_path / "real.csv").write_text("before")
    (tmp_path / "real.csv").chmod(0o640)
    (tmp_path / "link.csv").symlink_to("real.csv")
    write_text(tmp_path / "link.csv", "after")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "real.csv").read_text() == "after"
    assert stat.S_IMODE((tmp_path / "real.csv").stat().st_mode) == 0o640


def test_a_new_file_has_the_permissions_of_any_other(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    write_text(tmp_path / "track.csv", "")
    assert (tmp_path / "track.csv").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_a_device_is_written_to_and_not_replaced() -> None:
    write_text("/dev/null", "x")
    assert Path("/dev/null").is_char_device()


@pytest.mark.parametrize(
    ("names", "people"),
    [
        ("anna_1.zip ben_1.zip anna_2.zip", "anna ben anna"),
        ("Anna-2024-05-01_10-11-12.zip Ben-2024-05-01_10-11-12.zip", "anna ben"),
        ("s01_walk.zip s02_walk.zip s01_run.zip", "s01 s02 s01"),
        ("Jörg-1.zip 李雷_1.zip Jörg_2.zip", "jörg 李雷 jörg"),
        ("anna_1.zip ben_1.zip", " "),  # walks of one person may have such names, too
        ("anna_1.zip anna_2.zip", " "),
        ("walk_1.zip run_1.zip walk_2.zip", "  "),
        ("walk1_a.zip walk2_a.zip walk1_b.zip", "  "),
        ("anna_1.zip 2024-05-01.zip anna_2.zip", "  "),
    ],
)
def test_people_are_known_by_file_names_of_a_study(tmp_path: Path, names: str, people: str) -> None:
    for name in names.split():
        write_text(tmp_path / name, "")
    nameless = replace(WALK, meta={})
    recordings = [with_person_of_file(nameless, tmp_path / name) for name in names.split()]
    assert [recording.subject.id or "" for recording in recordings] == people.split(" ")
    listed = ", ".join(sorted({*people.split()}))
    assert [f"names of files: {listed} (" in note for note in notes_on_people(recordings)] == [True][: len(listed)]
    named = replace(WALK, meta={"subject": {"id": "p1"}})
    assert with_person_of_file(named, tmp_path / names.split()[0]).subject.id == "p1"


def test_files_of_fixes_beside_recordings_are_not_of_people(tmp_path: Path) -> None:
    samples = "time_s,ax,ay,az\n" + "".join(f"{k / 50},0.1,0.2,9.8\n" for k in range(100))
    fixes = "time_s,east_m,north_m\n1.0,0.0,0.0\n"
    nameless = replace(WALK, meta={})

    def people() -> list[str | None]:
        return [with_person_of_file(nameless, tmp_path / f"{name}.csv").subject.id for name in ("b", "hall")]

    for name, text in (("b.csv", samples), ("hall.csv", samples), ("fx_1.csv", fixes), ("fx_2.csv", fixes)):
        write_text(tmp_path / name, text)
    assert people() == [None, None]
    write_text(tmp_path / "b_2.csv", samples)
    assert people() == ["b", "hall"]
