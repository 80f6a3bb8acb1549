"""Many recordings: the same numbers as one by one, and each exactly once in the table whatever dies."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jobs import square_or_die
from true_positions import located

import pdr_filter as pdr
from pdr_filter import batch
from pdr_filter.apps.batch import batch_calibration as calibration
from pdr_filter.apps.batch import result_table as rows_table
from pdr_filter.apps.batch import run, workers
from pdr_filter.apps.batch.worker_process import LostError, WorkerProcess
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.values import CONTEXTS, table
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

N = 5


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of simulated walks of different lengths."""
    folder = tmp_path_factory.mktemp("walks")
    whole = pdr.simulate.demo_walk()
    for i in range(N):
        end_s = 20.0 + 4.0 * i
        cut = {
            name: pdr.Samples(stream.time_s[stream.time_s < end_s], stream.values[stream.time_s < end_s])
            for name, stream in whole.streams.items()
        }
        write_recording(replace(whole, name=f"walk_{i}", **cut), folder / f"walk_{i}.zip")
    return folder


def test_rows_are_those_of_one_by_one_to_the_last_bit(walks: Path, tmp_path: Path) -> None:
    rows = batch.track(walks, out=tmp_path / "tracks.csv")
    assert batch.read_table(tmp_path / "tracks.csv") == rows
    assert [Path(row.path).name for row in rows] == [f"walk_{i}.zip" for i in range(N)]
    for row in rows:
        recording = pdr.read(row.path)
        track = pdr.track(recording, pdr.recipes.for_recording("default", recording))
        assert row.status == "done"
        assert (row.name, row.n_steps, row.distance_m) == (track.name, track.n_steps, track.distance_m)
        assert (row.end_east_m, row.end_north_m) == tuple(track.position_m[-1])
        assert row.end_std_m == track.position_std_m[-1]
        assert row.notes == "; ".join(track.notes)
        assert dict(row.context_s) == track.context_seconds()
    assert rows[-1].n_steps
    assert rows[-1].n_steps > 30


def test_a_row_has_the_person_and_the_steps_that_the_phone_counted(tmp_path: Path) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    for person, n_steps in (("anna", 7), ("ben", 9), ("anna", 8)):
        counter = pdr.Samples([0.0, 3.0], [[1.0], [n_steps]])
        counted = replace(walk, meta={"name": "walk"}, phone_step_count=counter)
        counted.save(tmp_path / f"{person}_walk{n_steps}-2024-05-01_10-11-12.zip")
    rows = batch.track(tmp_path, out=tmp_path / "tracks.csv")
    assert [(row.subject, row.phone_n_steps) for row in rows] == [("anna", 7), ("anna", 8), ("ben", 9)]
    assert batch.read_table(tmp_path / "tracks.csv") == rows


def test_one_process_and_two_give_the_same_table(walks: Path, tmp_path: Path) -> None:
    options = {"recipe": "martinelli2018", "weighting": "hc"}
    some = [walks / f"walk_{i}.zip" for i in range(3)]
    one = batch.track(some, **options, out=tmp_path / "one.csv")
    two = batch.track(some, **options, jobs=2, out=tmp_path / "two.csv")
    assert one == two
    assert sorted((tmp_path / "one.csv").read_text().splitlines()) == sorted(
        (tmp_path / "two.csv").read_text().splitlines()
    )


def test_failures_stand_beside_the_successes_with_their_reason(walks: Path, tmp_path: Path) -> None:
    broken, missing = tmp_path / "broken, 'a' \"b\".zip", tmp_path / "missing.zip"
    broken.write_text("this is no zip file")
    in_two_lines = shutil.copy(walks / "walk_0.zip", tmp_path / "two\nlines.zip")
    paths = [broken, walks / "walk_0.zip", missing, in_two_lines]
    rows = batch.track(paths, out=tmp_path / "out" / "tracks.csv")
    assert [row.status for row in rows] == ["failed", "done", "failed", "failed"]
    assert "line break" in rows[3].reason
    assert batch.track(paths, out=tmp_path / "out" / "tracks.csv") == rows
    assert all(row.reason and row.n_steps is None and "\n" not in row.reason for row in (rows[0], rows[2]))
    assert rows[1].reason == ""
    assert {row.path for row in batch.read_table(tmp_path / "out" / "tracks.csv")} == {row.path for row in rows}


def test_a_recording_without_the_sensors_of_the_recipe_fails_with_a_reason_that_names_them(tmp_path: Path) -> None:
    recording = replace(pdr.simulate.demo_walk(), gyroscope=None)
    path = write_recording(recording, tmp_path / "no_gyroscope.zip")
    (row,) = batch.track(path, "tian2016", out=tmp_path / "tracks.csv")
    assert row.failed
    assert "gyroscope" in row.reason


def test_a_batch_uses_locations_as_it_is_asked_to(tmp_path: Path) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=d, turn_rad=1.5) for d in (15.0, 12.0)])
    path = write_recording(located(walk, np.arange(1.0, walk.duration_s), accuracy_m=6.0), tmp_path / "located.zip")
    recording, ends = pdr.read(path), set[tuple[float, float]]()
    for gnss in (None, "align", "off"):
        (row,) = batch.track(path, out=tmp_path / "tracks.csv", gnss=gnss)
        track = pdr.track(recording, gnss=gnss)
        assert (row.gnss, row.end_east_m, row.end_north_m) == (gnss or "", *track.position_m[-1])
        ends.add(tuple(track.position_m[-1]))
    assert len(ends) == len(batch.read_table(tmp_path / "tracks.csv")) == 3


def test_finished_recordings_are_not_done_again_and_other_recipes_are(
    walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "tracks.csv"
    first = batch.track(walks, out=table)
    content = table.read_bytes()
    asked = count_reads(monkeypatch)
    assert batch.track(walks, out=table) == first
    assert asked == []
    assert table.read_bytes() == content
    batch.track(walks, weighting="hc", out=table)
    batch.track(walks / "walk_0.zip", height_m=1.9, out=table)
    assert len(asked) == N + 1
    assert len(batch.read_table(table)) == 2 * N + 1


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are read from now on."""
    asked: list[str] = []

    def counting(path: str, format: str | None = None) -> pdr.Recording:
        asked.append(Path(path).name)
        return pdr.read(path, format)

    monkeypatch.setattr(run, "read", counting)
    return asked


@pytest.mark.parametrize("lost_bytes", [1, 100])
def test_a_line_that_was_cut_short_is_dropped_and_its_recording_done_again(
    walks: Path, tmp_path: Path, lost_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "tracks.csv"
    rows = batch.track([walks / "walk_0.zip", walks / "walk_1.zip"], out=table)
    whole = table.read_bytes()
    assert lost_bytes < len(whole.splitlines()[-1])
    table.write_bytes(whole[:-lost_bytes])
    assert batch.read_table(table) == rows[:1]
    asked = count_reads(monkeypatch)
    assert batch.track([walks / "walk_0.zip", walks / "walk_1.zip"], out=table) == rows
    assert asked == ["walk_1.zip"]
    assert table.read_bytes() == whole


def test_failures_are_tried_again_only_if_asked(walks: Path, tmp_path: Path) -> None:
    path, table = tmp_path / "late.zip", tmp_path / "tracks.csv"
    assert batch.track([path, walks / "walk_0.zip"], out=table)[0].failed
    shutil.copy(walks / "walk_1.zip", path)
    assert batch.track([path, walks / "walk_0.zip"], out=table)[0].failed
    rows = batch.track([path, walks / "walk_0.zip"], out=table, retry_failed=True)
    assert [row.status for row in rows] == ["done", "done"]
    assert len(batch.read_table(table)) == 2


SCRIPT = """
import sys, time
from pdr_filter import batch
def tell(progress):
    print(progress.n_done, flush=True)
    if progress.n_done == 2:
        time.sleep(600)  # until it is killed
batch.track(sys.argv[1], out=sys.argv[2], jobs=int(sys.argv[3]), progress=tell)
"""


@pytest.mark.skipif(os.name != "posix", reason="kills a process group")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_batch_goes_on_where_it_was(
    walks: Path, tmp_path: Path, jobs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "tracks.csv"
    command = [sys.executable, "-c", SCRIPT, str(walks), str(table), str(jobs)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    for line in process.stdout:
        if int(line) == 2:
            break
    os.killpg(process.pid, signal.SIGKILL)  # The process and its workers are a session of their own.
    process.wait(timeout=90)
    process.stdout.close()
    before = batch.read_table(table)
    assert len(before) == 2
    asked = count_reads(monkeypatch)
    rows = batch.track(walks, out=table)
    assert sorted(asked) == sorted({f"walk_{i}.zip" for i in range(N)} - {Path(r.path).name for r in before})
    assert sorted(map(astuple, batch.read_table(table)), key=str) == sorted(map(astuple, rows), key=str)
    assert rows == batch.track(walks, out=tmp_path / "uninterrupted.csv")


def test_a_second_batch_on_the_same_table_is_refused(walks: Path, tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    table = tmp_path / "tracks.csv"
    refused: list[str] = []

    def intrude(_: batch.Progress) -> None:
        with pytest.raises(ValueError, match="another batch"):
            batch.track(walks / "walk_0.zip", out=table)
        refused.append("yes")

    batch.track(walks / "walk_0.zip", out=table, progress=intrude)
    assert refused == ["yes", "yes"]


def test_a_table_on_a_drive_without_locks_is_refused_with_the_reason(
    walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fcntl = pytest.importorskip("fcntl")

    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(ValueError, match=r"cannot be locked \(No locks available\)"):
        batch.track(walks / "walk_0.zip", out=tmp_path / "tracks.csv")


def test_progress_counts_every_recording_and_the_time_left_ends_at_zero(walks: Path, tmp_path: Path) -> None:
    (walks / "notes.txt").write_text("no recording\n")
    seen: list[batch.Progress] = []
    paths = [*(walks / f"walk_{i}.zip" for i in range(N)), tmp_path / "missing.zip"]
    batch.track(paths, out=tmp_path / "tracks.csv", progress=seen.append)
    assert [p.n_done for p in seen] == list(range(N + 2))
    assert seen[0].left_s is None
    assert seen[-1].left_s == 0.0
    assert all(p.left_s is not None and p.left_s > 0 for p in seen[1:-1])
    assert (seen[-1].n_failed, seen[-1].fraction, seen[0].fraction) == (1, 1.0, 0.0)
    again: list[batch.Progress] = []
    batch.track(paths, out=tmp_path / "tracks.csv", progress=again.append)
    assert [(p.n_done, p.n_failed, p.left_s) for p in again] == [(N + 1, 1, 0.0)]


def test_the_estimate_of_the_time_left_follows_the_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    sizes = {"a": 99, "b": 299, "c": 599}
    for name, size in sizes.items():
        (tmp_path / name).write_bytes(b"x" * size)

    def ten_seconds_later(task: batch.Task) -> batch.Row:
        now[0] += 10.0
        return rows_table.failed_row(task, "not tracked here")

    monkeypatch.setattr(run, "track_one", ten_seconds_later)
    left: list[float | None] = []
    out = tmp_path / "tracks.csv"
    batch.track([tmp_path / name for name in sizes], out=out, progress=lambda p: left.append(p.left_s))
    # 100 bytes in 10 s leave 900; 400 in 20 s leave 600.
    assert left == [None, pytest.approx(90.0), pytest.approx(30.0), 0.0]


# --- calibration of a cohort ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cohort(walks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The walks with the distance of a stretch of each, of two people, and a file that is none."""
    folder = tmp_path_factory.mktemp("cohort")
    for i in range(N):
        recording = pdr.read(walks / f"walk_{i}.zip")
        ends_s = recording.accelerometer.time_s[-1] - np.array([16.0, 2.0])
        values = {"start_s": ends_s[:1], "end_s": ends_s[1:], "distance_m": [15.0 + i], "n_steps": [np.nan]}
        truth = replace(recording.truth, segments=table({name: np.array(v) for name, v in values.items()}))
        meta = {**recording.meta, "subject": {"id": f"s{i % 2}", "height_m": 1.75}}
        write_recording(replace(recording, name="walk", truth=truth, meta=meta), folder / f"walk_{i}.zip")
    (folder / "broken.zip").write_text("no zip")
    return folder


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_calibration_of_many_has_the_bits_of_one_by_one_and_names_what_it_left_out(cohort: Path, jobs: int) -> None:
    expected = pdr.calibrate([pdr.read(cohort / f"walk_{i}.zip") for i in range(N)])
    seen: list[float] = []
    found = batch.calibrate(cohort, jobs=jobs, progress=seen.append)
    assert found.k.keys() == expected.k.keys()
    for context, k in expected.k.items():
        np.testing.assert_array_equal(found.k[context], k)
        np.testing.assert_array_equal(found.k_cov[context], expected.k_cov[context])
    assert {name: person.k0 for name, person in found.subjects.items()} == {
        name: person.k0 for name, person in expected.subjects.items()
    }
    assert set(found.subjects) == {"s0", "s1"}
    assert [note for note in found.notes if "broken.zip" in note and "skipped" in note]
    assert seen == pytest.approx([(i + 1) / (N + 1) for i in range(N + 1)])
    assert found.segments.recording.tolist() == expected.segments.recording.tolist()
    assert len(set(found.segments.recording)) == N  # all recordings have the same name


def test_a_calibration_that_was_killed_goes_on_with_what_it_had(
    cohort: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [cohort / f"walk_{i}.zip" for i in range(N)]
    whole = batch.calibrate(files)
    read: list[str] = []

    def until(n: int) -> None:
        def killed(path: str, *options: object) -> Recording:
            if len(read) >= n:
                raise KeyboardInterrupt
            read.append(Path(path).name)
            return pdr.read(path)

        monkeypatch.setattr(calibration, "read", killed)

    until(2)
    with pytest.raises(KeyboardInterrupt):
        batch.calibrate(files, resume=tmp_path / "kept")
    (tmp_path / "kept" / "rest_of_a_kill.123").write_bytes(b"half")
    until(N)
    found = batch.calibrate(files, resume=tmp_path / "kept")
    assert read == [f.name for f in files]
    np.testing.assert_array_equal(found.people, whole.people)
    assert found.notes == whole.notes
    until(N + 1)  # with other options what is kept does not count
    with pytest.raises(KeyboardInterrupt):
        batch.calibrate(files, resume=tmp_path / "kept", measure="length")


def test_nothing_to_calibrate_with_is_told_with_the_reason_of_each(walks: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.zip").write_text("no zip")
    with pytest.raises(ValueError, match=r"no usable segments to calibrate with: .*broken\.zip"):
        batch.calibrate(tmp_path)
    with pytest.raises(ValueError, match="measure must be"):
        batch.calibrate(walks, measure="volume")


# --- what can go wrong -----------------------------------------------------------------------------------------------


def test_a_file_that_is_no_table_of_a_batch_is_left_as_it_is(walks: Path, tmp_path: Path) -> None:
    other = tmp_path / "letters.csv"
    for content in (b"dear Anna,\nI write\n", b"half a line"):
        other.write_bytes(content)
        with pytest.raises(ValueError, match="not a table of a batch"):
            batch.track(walks, out=other)
        assert other.read_bytes() == content


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"recipe": "nobody1999"}, "no recipe"),
        ({"weighting": "best"}, "weighting"),
        ({"file_format": "tape"}, "format"),
        ({"calibration": "nowhere.json"}, "nowhere.json"),
        ({"gnss": "on"}, "gnss must be one of"),
        ({"out": "."}, "is a folder"),
        ({"jobs": 0}, "jobs"),
        ({"jobs": -2}, "jobs"),
    ],
)
def test_options_that_cannot_be_used_are_refused_at_once(
    walks: Path, tmp_path: Path, options: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        batch.track(walks, **{"out": tmp_path / "tracks.csv", **options})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def tracked(walks: Path) -> pdr.Track:
    return pdr.track(pdr.read(walks / "walk_0.zip"))


def check_written(track: pdr.Track, folder: Path) -> tuple[batch.Row, list[str]]:
    """Write the row of a track, check that it is read back from one line, and return it with its cells."""
    row = rows_table.row_of(
        batch.Task(str(folder / "a, b.zip")),
        track,
        pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)]),
    )
    cells = rows_table._cells(row, CONTEXTS)
    text = rows_table._header(CONTEXTS) + rows_table._line(cells)
    assert len(text.splitlines()) == 2
    (folder / "tracks.csv").write_text(text)
    assert batch.read_table(folder / "tracks.csv") == [row]
    return row, cells


def test_names_and_notes_of_several_lines_are_one_line_of_the_table(tracked: pdr.Track, tmp_path: Path) -> None:
    odd = replace(tracked, name='two\nlines, "quoted"', notes=("odd;\r\n\x1b[31m",))
    assert check_written(odd, tmp_path)[0].name == 'two lines, "quoted"'


@pytest.mark.parametrize("text", ["=cmd|'calc'!A0", "@SUM(1)", "'quoted", "a; =1", "-1"])
def test_no_text_of_a_recording_is_a_formula_in_the_table(tracked: pdr.Track, tmp_path: Path, text: str) -> None:
    _, cells = check_written(replace(tracked, name=text, notes=(text,)), tmp_path)
    for cell in (cells[rows_table.columns_of(CONTEXTS).index(name)] for name in ("name", "notes")):
        assert not any(part.strip()[:1] in {"=", "+", "-", "@"} for part in cell.split(";"))


RECIPE = """
from dataclasses import replace
import pdr_filter as pdr

NAMES = dict(zip(pdr.CONTEXTS, ("at rest", "level", "=up", "down, far", "sideways", "running")))

def recipe(subject):
    config = pdr.recipes.default(subject)
    model = pdr.ContextModel.load("context").renamed(NAMES)
    modes = [replace(m, name=NAMES[m.name], context=NAMES[m.context]) for m in config.model.modes]
    return config.with_contexts(model, modes)

def for_the_tall(subject):
    return recipe(subject) if subject is None else pdr.recipes.default(subject)

def timed():
    model = pdr.ContextModel.load("context").renamed({"walking": "duration"})
    return pdr.recipes.default().with_contexts(model, [pdr.Mode("stationary", moves=False), pdr.Mode("duration")])
"""


def test_the_table_has_a_column_for_each_context_of_the_recipe(
    walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "renaming.py").write_text(RECIPE)
    monkeypatch.syspath_prepend(tmp_path)
    path, out = walks / "walk_0.zip", tmp_path / "tracks.csv"
    (row,) = batch.track([path], "renaming:recipe", out=out)
    (usual,) = batch.track([path], out=tmp_path / "usual.csv")
    assert list(usual.context_s) == list(CONTEXTS)
    assert list(row.context_s) == ["at rest", "level", "=up", "down, far", "sideways", "running"]
    assert row.context_s["level"] == pytest.approx(usual.context_s["walking"], abs=2.0)
    header = out.read_text().splitlines()[0]
    assert ",at rest_s,level_s," in header
    assert ",=up_s," not in header
    assert batch.read_table(out) == [row]
    assert batch.track([path], "renaming:recipe", out=out) == [row]
    with pytest.raises(ValueError, match="not a result table with the contexts stationary, walking"):
        batch.track([path], out=out)
    (failed,) = batch.track([path], "renaming:for_the_tall", out=out)
    assert "not those of the recipe for an unknown person" in failed.reason
    with pytest.raises(ValueError, match="cannot have the column 'duration_s'"):
        batch.track([path], "renaming:timed", out=tmp_path / "timed.csv")


def test_the_same_recording_twice_is_one_row(walks: Path, tmp_path: Path) -> None:
    path = walks / "walk_0.zip"
    assert len(batch.track([path, str(path), walks / ".." / walks.name / "walk_0.zip"], out=tmp_path / "t.csv")) == 1


def test_recordings_of_a_folder_are_found_in_it_and_below_and_broken_ones_too(tmp_path: Path, walks: Path) -> None:
    (tmp_path / "deep" / "er").mkdir(parents=True)
    shutil.copy(walks / "walk_0.zip", tmp_path / "deep" / "er" / "walk_0.zip")
    (tmp_path / "broken.zip").write_text("no zip")
    (tmp_path / "README.txt").write_text("about these\n")
    (tmp_path / "table.csv").write_text("a,b,c,d\n1,2,3,4\n5,6,7,8\n")
    write_recording(pdr.read(walks / "walk_0.zip"), tmp_path / "folder")
    found = recordings_in(tmp_path)
    assert found == [tmp_path / "broken.zip", tmp_path / "deep" / "er" / "walk_0.zip", tmp_path / "folder"]


def test_a_folder_whose_files_were_given_a_prefix_is_one_recording(tmp_path: Path) -> None:
    for name, unit in (("157_Accelerometer.csv", "m/s^2"), ("Gyroscope.csv", "rad/s"), ("Magnetometer.csv", "\u00b5T")):
        header = ",".join(['"Time (s)"', *(f'"{axis} ({unit})"' for axis in "XYZ")])
        (tmp_path / name).write_text(header + "\n" + "0,1,2,9\n" * 3)
    assert recordings_in(tmp_path) == [tmp_path]
    shutil.copy(tmp_path / "157_Accelerometer.csv", tmp_path / "158_Accelerometer.csv")
    assert recordings_in(tmp_path) == [tmp_path]  # the stray one will be a note


def results_of(items: list[int], **options: object) -> dict[int, object]:
    found = list(batch.each(square_or_die, items, **options))  # type: ignore[arg-type]
    assert len({i for i, _ in found}) == len(found) == len(items)
    return dict(found)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_an_item_that_kills_its_process_is_a_failure_and_all_others_are_done() -> None:
    found = results_of([3, 4, -1, 5, 0, 6, 7], jobs=2)
    assert [found[i] for i in (0, 1, 3, 5, 6)] == [9, 16, 25, 36, 49]
    assert found[4] == batch.Failure("nothing to square")
    assert isinstance(found[2], batch.Failure)
    assert "died" in found[2].reason


def test_no_items_are_no_work() -> None:
    assert results_of([], jobs=4) == {}


def test_parquet_holds_the_same_rows(walks: Path, tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    rows = batch.track(walks, out=tmp_path / "tracks.parquet")
    frame = pd.read_parquet(tmp_path / "tracks.parquet")
    assert list(frame.columns) == list(rows_table.columns_of(CONTEXTS))
    assert list(frame.distance_m) == [row.distance_m for row in rows]
    assert batch.read_table(tmp_path / "tracks.csv") == rows


# --- Dask ------------------------------------------------------------------------------------------------------------


def local_cluster(n_workers: int) -> Any:
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(
        n_workers=n_workers, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    )


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_with_one_of_two_dask_workers_killed_every_recording_is_once_in_the_table(walks: Path, tmp_path: Path) -> None:
    copies = [tmp_path / f"walk_{i}.zip" for i in range(6)]
    for i, copy in enumerate(copies):
        shutil.copy(walks / f"walk_{i % 3}.zip", copy)
    broken = tmp_path / "broken.zip"
    broken.write_text("no zip")
    table = tmp_path / "tracks.csv"
    killed: list[int] = []
    with local_cluster(2) as cluster:

        def kill_one(progress: batch.Progress) -> None:
            if progress.n_done == 2:
                victim = cluster.workers[0]
                killed.append(victim.pid)
                os.kill(victim.pid, signal.SIGKILL)

        rows = batch.track([*copies, broken], out=table, scheduler=cluster.scheduler_address, progress=kill_one)
    assert len(killed) == 1
    lines = [row.path for row in batch.read_table(table)]
    assert len(lines) == len(set(lines)) == len(copies) + 1
    assert [row.status for row in rows] == ["done"] * len(copies) + ["failed"]
    for row, local in zip(rows[:3], batch.track(copies[:3], out=tmp_path / "local.csv"), strict=True):
        assert row == local


def test_what_kills_every_worker_is_a_failure_on_a_cluster() -> None:
    dask = pytest.importorskip("dask")
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), local_cluster(1) as cluster:
        found = dict(batch.each(square_or_die, [2, -1], scheduler=cluster.scheduler_address))
    assert isinstance(found[1], batch.Failure)
    assert "died" in found[1].reason


def test_a_scheduler_that_is_not_there_is_told(walks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "DASK_CONNECT_S", 0.5)
    with pytest.raises(ValueError, match="no Dask scheduler"):
        batch.track(walks, out=tmp_path / "tracks.csv", scheduler="tcp://127.0.0.1:9")


# --- processes that are killed ---------------------------------------------------------------------------------------


def script(text: str) -> subprocess.Popen[str]:
    """A program beside this file, which can import `jobs`."""
    return subprocess.Popen([sys.executable, "-c", text], cwd=Path(__file__).parent, stdout=subprocess.PIPE, text=True)


KILLED_AFTER_THE_LAST = """
import os, signal, jobs
from pdr_filter import batch
for n, (_, pid) in enumerate(batch.each(jobs.pid_after, [0.01] * 6, jobs=2)):
    if n == 5:
        os.kill(pid, signal.SIGKILL)
print("all rows")
"""


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_worker_that_is_killed_after_the_last_row_does_not_hold_up_the_end() -> None:
    """Two of three such programs never ended while the processes shared locks."""
    for running in [script(KILLED_AFTER_THE_LAST) for _ in range(4)]:
        try:
            assert running.communicate(timeout=180)[0] == "all rows\n"
            assert running.returncode == 0
        finally:
            running.kill()


KILLED_ITSELF = """
import jobs
from pdr_filter import batch
for _, pid in batch.each(jobs.pid_after, [0.5, 0.5, 300.0, 300.0], jobs=2):
    print(pid, flush=True)
"""


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_workers_end_with_the_process_that_started_them_in_the_middle_of_their_work() -> None:
    running = script(KILLED_ITSELF)
    pids = {int(running.stdout.readline()) for _ in range(2)}
    time.sleep(0.2)
    assert all(is_alive(pid) for pid in pids)
    running.kill()
    running.wait()
    deadline = time.monotonic() + 60
    while any(is_alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "orphans"
        time.sleep(0.05)


CLOSED_EARLY = """
import jobs, time
from pdr_filter import batch
results = batch.each(jobs.pid_after, [0.01, 300.0, 0.01, 300.0], jobs=2)
print(next(results)[1], flush=True)
results.close()
time.sleep(300)
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs the lists of processes of Linux")
def test_results_that_are_closed_early_end_their_processes_and_start_none_again() -> None:
    running = script(CLOSED_EARLY)
    try:
        assert int(running.stdout.readline())
        deadline = time.monotonic() + 60
        n_idle, children = 0, list[list[str]]()
        while n_idle < 10:  # half a second without a process
            assert time.monotonic() < deadline, children
            children = [c.read_text().split() for c in Path(f"/proc/{running.pid}/task").glob("*/children")]
            n_idle = 0 if any(children) else n_idle + 1
            time.sleep(0.05)
    finally:
        running.kill()
        running.wait()


def test_what_the_work_prints_and_raises_does_not_disturb_the_results(capfd: pytest.CaptureFixture[str]) -> None:
    assert dict(batch.each(print, ["loud", "louder"], jobs=2)) == {0: None, 1: None}
    assert sorted(capfd.readouterr().err.split()) == ["loud", "louder"]


@pytest.mark.parametrize("as_given", [lambda work: work, partial], ids=["function", "partial"])
def test_work_that_other_processes_cannot_import_is_refused(
    as_given: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(square_or_die, "__module__", "__main__")
    with pytest.raises(ValueError, match="move it to a module"):
        list(batch.each(as_given(square_or_die), [1, 2], jobs=2))


def test_a_process_that_is_killed_between_two_requests_is_started_again() -> None:
    worker = WorkerProcess(partial, len)
    try:
        assert worker.ask([1, 2]) == 2
        for size in (10, 1_000_000):
            worker._process.kill()
            worker._process.wait()
            with pytest.raises(LostError, match="process died"):
                worker.ask(b"x" * size)
            assert worker.ask([1]) == 1
    finally:
        worker.close()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc has this allocator")
def test_workers_of_a_cluster_keep_freed_memory() -> None:
    code = (
        "import resource, numpy as np\n"
        "from pdr_filter.apps.batch.workers import keep_freed_memory\n"
        "keep_freed_memory()\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "for _ in range(100): np.ones(100_000)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"
    )
    environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}  # as Dask starts its workers
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 1000  # each of the 100 arrays has 195 pages
