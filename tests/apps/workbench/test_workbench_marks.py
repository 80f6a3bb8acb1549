"""Marks beside recordings: what is written, read back and used by the command line, through kills and by two pages."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benches import Client, running, short_walk
from true_positions import located

import pdr_filter as pdr
from pdr_filter.apps.maps.marks import (
    FIXES,
    WALK,
    checksum_of,
    mark_files,
    marks_folder,
    read_marks,
    table_bytes,
    table_rows,
    write_mark_files,
)
from pdr_filter.apps.workbench.walks import Walk
from pdr_filter.apps.workbench.worker import Worker
from pdr_filter.offline.smoothing.smooth import SmoothingMemory
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values.recording import Recording, Truth

# the first runs the tests that are coroutines
pytestmark = [pytest.mark.anyio, pytest.mark.usefixtures("sensing_once")]

FIRST, SECOND = [2.0, 0.0, 0.0, 0.5, None, None, None], [35.0, 3.0, 20.0, 0.5, None, None, None]


def test_smoothing_with_a_memory_has_the_bits_of_smoothing_without() -> None:
    recording, memory = short_walk(), SmoothingMemory()
    fixes = [pdr.PositionFix(2.0, (0.0, 0.0), np.eye(2)), pdr.PositionFix(35.0, (3.0, 20.0), np.eye(2))]
    alone = pdr.smooth(recording, fixes=fixes, loop=True)
    pdr.smooth(recording, memory=memory)
    kept = memory._found
    again = pdr.smooth(recording, fixes=fixes, loop=True, memory=memory)
    assert memory._found is kept
    np.testing.assert_array_equal(again.track.position_m, alone.track.position_m)
    np.testing.assert_array_equal(again.track.position_cov_m2, alone.track.position_cov_m2)
    assert again.notes == alone.notes
    taller = pdr.smooth(recording.of_height(2.0), fixes=fixes, memory=memory)
    assert memory._found is not kept
    assert taller.track.distance_m != alone.track.distance_m


def test_marks_are_in_a_recording_that_is_a_folder_and_beside_one_that_is_a_file(tmp_path: Path) -> None:
    folder, file = short_walk().save(tmp_path / "a"), short_walk().save(tmp_path / "b.zip")
    own = short_walk().save(tmp_path / "c" / "c.zip")
    assert marks_folder(folder) == folder
    assert marks_folder(file) == tmp_path / "b.zip.marks"
    assert marks_folder(own) == marks_folder(tmp_path / "c") == tmp_path / "c"
    before = pdr.read(folder)
    write_mark_files(folder, {FIXES: table_bytes(FIXES, [FIRST]), WALK: b'{"is_loop": true}'})
    after = pdr.read(folder)
    assert (after.notes, after.meta, set(after.streams)) == (before.notes, before.meta, set(before.streams))


def test_a_heading_beside_a_fix_turns_the_walk(tmp_path: Path) -> None:
    path = short_walk().save(tmp_path / "walk.zip")
    start = pdr.smooth(pdr.read(path)).track
    east = [5.0, 100.0, 50.0, 0.5, 90.0, 3.0]
    write_mark_files(marks_folder(path), {FIXES: table_bytes(FIXES, [east])})
    marks = read_marks(path)
    turned = pdr.smooth(pdr.read(path), **marks.arguments(pdr.read(path))).track
    row = int(np.searchsorted(start.time_s, 5.0))
    assert np.degrees(turned.walking_heading_rad[row]) == pytest.approx(90.0, abs=3.0)
    assert np.hypot(*(turned.position_m[row] - [100.0, 50.0])) < 2.0
    assert turned.distance_m == pytest.approx(start.distance_m, rel=0.01)


def test_a_storey_beside_a_fix_numbers_the_storeys_of_the_walk_and_stays_when_a_page_adds_a_fix(tmp_path: Path) -> None:
    path = short_walk().save(tmp_path / "walk.zip")
    folder = marks_folder(path)
    folder.mkdir()
    (folder / FIXES).write_text("time_s,east_m,north_m,floor\n5,100,50,2\n9,101,50,\n")
    marks = read_marks(path)
    assert [fix.floor for fix in marks.fixes if isinstance(fix, pdr.PositionFix)] == [2, None]
    smoothed = pdr.smooth(pdr.read(path), **marks.arguments(pdr.read(path))).track
    assert set(smoothed.floor) == {2}
    rows = table_rows(FIXES, (folder / FIXES).read_bytes())
    write_mark_files(folder, {FIXES: table_bytes(FIXES, [*rows, SECOND])})
    assert [fix.floor for fix in read_marks(path).fixes if isinstance(fix, pdr.PositionFix)] == [2, None, None]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"height_m": 18}', "height"),
        ('{"origin": [100, 200]}', "latitude"),
        ('{"is_loop": 1}', "is_loop"),
        ('{"person": "Ann", "hight_m": 1.8}', r"got \['hight_m'"),
        ("[]", "object"),
    ],
)
def test_marks_that_cannot_be_used_are_refused_with_file_and_reason(tmp_path: Path, content: str, words: str) -> None:
    path = short_walk().save(tmp_path / "walk")
    (path / WALK).write_text(content)
    with pytest.raises(ValueError, match=rf"walk\.json.*{words}"):
        read_marks(path)


def test_the_command_line_smooths_with_the_marks_to_the_same_bits_as_the_workbench(tmp_path: Path) -> None:
    path = short_walk().save(tmp_path / "walk.zip")
    worker = Worker(tmp_path / "cache")
    worker.walk(str(path), True)  # the memory has the walk without marks
    walk = {"height_m": 1.6, "is_loop": True, "origin": [48.1, 11.5], "person": "Ann"}
    files = {FIXES: table_bytes(FIXES, [FIRST, SECOND]), WALK: json.dumps(walk).encode()}
    write_mark_files(marks_folder(path), files)
    name, content = worker.export(str(path), "csv")
    command = [sys.executable, "-m", "pdr_filter", "smooth", str(path), "--out", str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "fixes.csv" in said.stderr
    assert content == (tmp_path / name).read_bytes()
    assert b"latitude_deg" in content


def two_legs() -> Recording:
    return simulate([Leg("walking", distance_m=25.0), Leg("walking", distance_m=15.0, turn_rad=1.5)], seed=1)


@pytest.mark.parametrize("has_locations", [True, False])
def test_a_mark_on_the_path_of_a_walk_with_own_positions_hardly_moves_it(tmp_path: Path, has_locations: bool) -> None:
    recording = two_legs()
    if has_locations:
        recording = replace(located(recording, np.arange(1.3, 30.0), accuracy_m=6.0), truth=Truth())
    path = recording.save(tmp_path / "walk")
    before = pdr.smooth(pdr.read(path), **read_marks(path).arguments(pdr.read(path))).track
    row = before.n_steps // 2
    mark = [float(before.time_s[row]), *before.position_m[row].tolist(), 1.0, None, None]
    files = {FIXES: table_bytes(FIXES, [mark])}
    if has_locations:  # as the page does with the first mark
        files[WALK] = json.dumps({"origin": [before.origin.latitude_deg, before.origin.longitude_deg]}).encode()
    write_mark_files(marks_folder(path), files)
    found = read_marks(path).arguments(pdr.read(path))
    assert len(found["fixes"]) == 1
    after = pdr.smooth(pdr.read(path), **found).track
    assert np.linalg.norm(after.position_m - before.position_m, axis=1).max() < (1.5 if has_locations else 0.5)
    assert np.linalg.det(after.position_cov_m2[row]) < np.linalg.det(before.position_cov_m2[row])


def test_the_truth_of_a_recording_is_used_as_fixes_only_if_the_marks_say_so_and_then_every_output_says_it(
    tmp_path: Path,
) -> None:
    path = two_legs().save(tmp_path / "walk")
    recording = pdr.read(path)  # with the rounded values of the files
    n = len(recording.truth.waypoints)
    assert read_marks(path).arguments(recording)["fixes"] == []
    without = Worker(tmp_path / "cache").walk(str(path))
    assert without["distance_m"] == pytest.approx(pdr.smooth(recording).track.distance_m, abs=0.05)
    assert not any("ground truth" in note for note in without["notes"])
    write_mark_files(path, {WALK: b'{"truth_as_fixes": true}'})
    track = pdr.smooth(recording, **read_marks(path).arguments(recording)).track
    worker = Worker(tmp_path / "cache")
    summary = worker.walk(str(path))
    assert summary["distance_m"] == round(track.distance_m, 1)
    said = f"{n} of {n} position fixes are ground truth of the recording"
    page = (tmp_path / "cache" / f"{summary['key']}.html").read_text()
    exported = worker.export(str(path), "geojson")[1].decode()
    placed = track.placed((48.0, 11.0))
    files = [write(tmp_path / "out").read_text() for write in (placed.to_gpx, placed.to_kml, placed.to_geojson)]
    texts = [*summary["notes"][-1:], page, exported, *files, str(placed.summary()["notes"])]
    assert [k for k, text in enumerate(texts) if said not in text] == []


def test_results_are_kept_by_the_content_of_recording_marks_and_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = short_walk().save(tmp_path / "walk")
    worker = Worker(tmp_path / "cache")
    first = worker.walk(str(path))
    report = tmp_path / "cache" / f"{first['key']}.html"
    written_ns = report.stat().st_mtime_ns
    os.utime(path / "accelerometer.csv")
    moved = path.rename(tmp_path / "other")
    assert Worker(tmp_path / "cache").walk(str(moved)) == first
    assert report.stat().st_mtime_ns == written_ns
    checksum = checksum_of(moved)
    write_mark_files(moved, {WALK: b'{"is_loop": true}'})
    assert checksum_of(moved) == checksum
    assert worker._key(moved, checksum) != first["key"]
    before = worker._key(moved, checksum)
    monkeypatch.setattr("pdr_filter.apps.workbench.worker._of_report", lambda: "of another page")
    assert worker._key(moved, checksum) != before
    with (moved / "gyroscope.csv").open("a") as file:
        file.write("\n")
    assert checksum_of(moved) != checksum


async def test_edits_are_taken_back_and_made_again(client: Client, tmp_path: Path) -> None:
    short_walk().save(tmp_path / "walk")
    walk = await client.walk("walk")
    empty = await client.get(walk)
    assert (empty["can_undo"], empty["can_redo"]) == (False, False)
    one = await client.edit(walk, fixes=[FIRST])
    two = await client.edit(walk, fixes=[SECOND, FIRST])
    assert two["marks"]["fixes"] == [FIRST, SECOND]  # by time
    state = two
    for wanted in (one, empty):
        state = await client.post(f"{walk}/undo", {"version": state["version"]})
        assert state["marks"] == wanted["marks"]
    assert not (tmp_path / "walk" / FIXES).exists()
    assert (state["can_undo"], state["can_redo"]) == (False, True)
    await client.post(f"{walk}/undo", {"version": state["version"]}, 409)
    for wanted in (one, two):
        state = await client.post(f"{walk}/redo", {"version": state["version"]})
        assert state["marks"] == wanted["marks"]
    # an edit between forbids the way forward
    state = await client.post(f"{walk}/undo", {"version": state["version"]})
    state = await client.edit(walk, walk={"is_loop": True})
    assert not state["can_redo"]


async def test_of_two_browsers_the_later_one_is_told_and_nothing_is_lost(client: Client, tmp_path: Path) -> None:
    short_walk().save(tmp_path / "walk")
    walk = await client.walk("walk")
    version = (await client.get(walk))["version"]
    await client.edit(walk, fixes=[FIRST])
    answer = await client.edit(walk, 409, version=version, fixes=[SECOND])
    assert "another browser" in answer["error"]
    assert (await client.get(walk))["marks"]["fixes"] == [FIRST]
    # also an edit of another program
    version = (await client.get(walk))["version"]
    with (tmp_path / "walk" / FIXES).open("a") as file:
        file.write("20.0,1.0,1.0,0.5\n")
    await client.edit(walk, 409, version=version, fixes=[SECOND])
    await client.post(f"{walk}/undo", {"version": version}, 409)
    assert len((await client.get(walk))["marks"]["fixes"]) == 2


HEIGHT = "the field Height (m) must be the height of a person in metres, 0.4 to 2.8"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fixes": [[1.0, 0.0, 0.0, 0.0, None, None]]}, ""),
        ({"fixes": [[None, 0.0, 0.0, 0.5, None, None]]}, ""),
        ({"fixes": [[1.0, 0.0, 0.0, 0.5, 90.0, -1.0]]}, ""),
        ({"loop_closures": [[20.0, 10.0, 0.5]]}, ""),
        ({"walk": {"height_m": 18}}, HEIGHT),
        ({"walk": {"plan": "../../etc/passwd"}}, ""),
        ({"walk": {"unknown": 1}}, ""),
        ({"fixes": "x"}, ""),
    ],
)
async def test_an_edit_that_cannot_be_used_changes_nothing(
    client: Client, tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    short_walk().save(tmp_path / "walk")
    walk = await client.walk("walk")
    await client.edit(walk, fixes=[FIRST])
    before = mark_files(tmp_path / "walk")
    answer = await client.edit(walk, 400, **changes)
    assert answer["error"] and answer["error"].startswith(words)
    assert mark_files(tmp_path / "walk") == before


async def test_the_step_length_of_a_person_is_used_by_other_walks_only(client: Client, tmp_path: Path) -> None:
    name = "Ann: 1/2"
    short_walk().save(tmp_path / "a")
    short_walk().save(tmp_path / "b")
    track = pdr.smooth(short_walk()).track
    longer = [
        [float(t), *(1.05 * p).tolist(), 0.1, None, None] for t, p in zip(track.time_s, track.position_m, strict=True)
    ]
    first, second = await client.walk("a"), await client.walk("b")
    await client.post(f"{first}/teach", {}, 400)  # no name yet
    await client.edit(first, walk={"person": name}, fixes=longer[::10])
    found = await client.post(f"{first}/teach", {})
    assert 0.3 < found["step_length_m"] < 1.2
    assert not (tmp_path / "a" / "person.json").exists()
    await client.edit(second, walk={"person": name})
    (known,) = (tmp_path / "people").iterdir()
    assert (tmp_path / "b" / "person.json").read_bytes() == known.read_bytes()
    assert read_marks(tmp_path / "b").arguments(pdr.read(tmp_path / "b"))["person"].name == "person.json"
    await client.edit(second, walk={})
    assert not (tmp_path / "b" / "person.json").exists()


SAVING = """
import sys
from pathlib import Path
from pdr_filter.apps.maps.marks import write_mark_files
print("ready", flush=True)
while True:
    for n in (1, 2):
        fixes = b"time_s,east_m,north_m\\n" + b"%d,0,0\\n" % n * 2000
        write_mark_files(Path(sys.argv[1]), {"fixes.csv": fixes, "walk.json": b'{"height_m": 1.%d}' % n})
"""


def test_a_kill_during_a_save_leaves_the_old_marks_or_the_new_ones(tmp_path: Path) -> None:
    """Both files are always of one save."""
    seen: set[int] = set()
    for k in range(6):
        process = subprocess.Popen([sys.executable, "-c", SAVING, str(tmp_path)], stdout=subprocess.PIPE)
        process.stdout.readline()
        time.sleep(0.02 + 0.011 * k)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        files = mark_files(tmp_path)
        if not files:
            continue
        n = int(files[WALK][-2:-1])
        assert files[FIXES] == b"time_s,east_m,north_m\n" + b"%d,0,0\n" % n * 2000
        assert set(p.name for p in tmp_path.iterdir() if not p.name.endswith(".part")) == {FIXES, WALK}
        seen.add(n)
    assert seen


def test_a_save_that_was_cut_off_between_two_files_is_completed(tmp_path: Path) -> None:
    write_mark_files(tmp_path, {FIXES: table_bytes(FIXES, [FIRST]), WALK: b'{"is_loop": true}'})
    new = {FIXES: table_bytes(FIXES, [SECOND]).decode()}
    (tmp_path / ".marks.json").write_text(json.dumps(new))  # all is written, nothing replaced
    assert mark_files(tmp_path) == {FIXES: new[FIXES].encode()}
    assert [path.name for path in tmp_path.iterdir()] == [FIXES]


@pytest.mark.parametrize(("latitude_deg", "is_far"), [(48.0, False), (48.02, True)])
def test_a_floor_plan_that_lies_elsewhere_is_named_with_its_distance(
    tmp_path: Path, latitude_deg: float, is_far: bool
) -> None:
    path = short_walk().save(tmp_path / "walk")
    corners = [[11.0, 48.0], [11.001, 48.0], [11.001, 48.001], [11.0, 48.001], [11.0, 48.0]]
    hall = {"properties": {"type": "floor"}, "geometry": {"type": "Polygon", "coordinates": [corners]}}
    (path / "hall.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [hall]}))
    (path / WALK).write_text(json.dumps({"origin": [latitude_deg, 11.0], "plan": "hall.geojson"}))
    (tmp_path / "cache").mkdir()
    notes = Worker(tmp_path / "cache").walk(str(path))["notes"]
    assert any(note.startswith("the floor plan lies 2") for note in notes[:1]) == is_far
    assert not any("`" in note or " windows" in note for note in notes)


async def test_an_edit_can_be_taken_back_after_the_workbench_was_started_again(tmp_path: Path) -> None:
    path = short_walk().save(tmp_path / "walk")
    async with running(tmp_path) as client:
        await client.edit(await client.walk("walk"), fixes=[FIRST])
        await client.edit(await client.walk("walk"), fixes=[FIRST, SECOND])
    async with running(tmp_path) as client:
        address = await client.walk("walk")
        state = await client.get(address)
        assert (state["can_undo"], state["can_redo"]) == (True, False)
        await client.post(f"{address}/undo", {"version": state["version"]})
        assert [fix.time_s for fix in read_marks(path).fixes] == [FIRST[0]]
    (history,) = (tmp_path / ".pdr_filter" / "undo").iterdir()
    history.write_text("[[1], {}]")  # a damaged history must not prevent edits
    async with running(tmp_path) as client:
        assert not (await client.get(await client.walk("walk")))["can_undo"]


def test_the_list_has_the_person_in_the_recording_or_else_in_the_name_of_the_file(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.zip" for name in ("anna_1", "ben_1", "anna_2")]
    for path in paths:
        path.touch()
    assert [Walk(path.name, path, path.stem).event()["subject"] for path in paths] == ["anna", "ben", "anna"]
    assert Walk("x", paths[0], "anna_1", summary={"subject": "p01"}).event()["subject"] == "p01"
