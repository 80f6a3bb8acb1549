"""Tracks of files in parts: equal to those of whole recordings, in any division into parts and blocks."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.data.io import parts
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples, limits


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    """A walk whose gyroscope has a hole, has other times than the accelerometer, and begins late."""
    whole = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0, turn_rad=1.0)])
    assert whole.gyroscope is not None
    time_s, values = whole.gyroscope.time_s + 0.003, whole.gyroscope.values
    kept = (np.abs(time_s - 6.0) > 0.4) & (time_s > 0.2)
    pressure = Samples(np.arange(0.0, 15.0, 0.2), 1000.0 + 0.01 * np.arange(75.0)[:, None])
    return replace(whole, gyroscope=Samples(time_s[kept], values[kept]), magnetometer=None, barometer=pressure)


def own(walk: pdr.Recording, path: Path) -> Path:
    return walk.save(path / "walk.zip")


def table(walk: pdr.Recording, path: Path) -> Path:
    block = pdr.merge_streams(walk)
    rows = np.column_stack([block.time_s + 7.1, block.specific_force_mps2, block.angular_rate_radps])
    text = "\n".join(",".join(format(v, ".9g") for v in row) for row in rows.tolist())
    (path / "walk.csv").write_text(f"time,ax,ay,az,gx,gy,gz\n{text}\n".replace("nan", ""))
    return path / "walk.csv"


def ronin(walk: pdr.Recording, path: Path) -> Path:
    h5py: Any = pytest.importorskip("h5py")
    block = pdr.merge_streams(walk)
    with h5py.File(path / "data.hdf5", "w") as file:
        file["synced/time"], file["synced/acce"] = block.time_s + 7.1, block.specific_force_mps2
        file["synced/gyro"] = block.angular_rate_radps
    return path / "data.hdf5"


def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "_PART_SAMPLES", 170)
    monkeypatch.setattr(parts, "_RONIN_ROWS", 330)
    monkeypatch.setattr(limits, "BLOCK_BYTES", 9_000)


@pytest.mark.parametrize("write", [own, table])
def test_files_that_are_too_long_to_be_held_in_memory_are_tracked_in_parts(
    walk: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Any
) -> None:
    path = write(walk, tmp_path)
    monkeypatch.setattr(limits, "MAX_MEMBER_BYTES", 1000)
    with pytest.raises(ValueError, match="more than 1000"):
        pdr.track(pdr.read(path))
    assert pdr.batch.track_file(path, tmp_path / "track.csv").n_steps > 20


@pytest.mark.parametrize("write", [own, table, ronin])
def test_the_file_of_a_track_in_parts_equals_that_of_the_whole_recording(
    walk: pdr.Recording, write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(walk, tmp_path)
    whole = pdr.track(read(path))
    small_parts(monkeypatch)
    done: list[float] = []
    written = pdr.batch.track_file(path, tmp_path / "parts.csv", progress=done.append)
    assert written.path.read_bytes() == whole.to_csv(tmp_path / "whole.csv").read_bytes()
    assert (written.n_steps, written.distance_m) == (whole.n_steps, whole.distance_m)
    assert written.about.notes == whole.notes
    assert len(done) > 5
    assert done == sorted(done)
    assert done[-1] == pytest.approx(1.0)


def test_streams_that_begin_late_and_reports_of_the_phone_are_those_of_the_whole_recording(
    walk: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    time_s = np.arange(5.0, 15.0)
    place = np.column_stack([48.0 + 1e-5 * time_s, 11.0 + 0 * time_s, 500.0 + 0 * time_s, 5.0 + 0 * time_s])
    counts = np.where(time_s < 9.0, 7000.0, 0.0) + time_s.round()  # the phone was started again
    late = replace(
        walk,
        location=Samples(time_s, place),
        phone_step_count=Samples(time_s, counts[:, None]),
        phone_heading=Samples(np.arange(0.0, 15.0, 0.5), np.arange(0.0, 3.0, 0.1)[:, None]),
    )
    path = own(late, tmp_path)
    whole = pdr.track(read(path))
    small_parts(monkeypatch)
    written = pdr.batch.track_file(path, tmp_path / "parts.csv")
    assert written.path.read_bytes() == whole.to_csv(tmp_path / "whole.csv").read_bytes()
    assert written.about.notes == whole.notes
    assert written.about.origin == whole.origin is not None


def test_a_table_with_a_column_that_is_empty_at_first_is_tracked_as_a_whole(
    walk: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = table(walk, tmp_path)
    header, *rows = path.read_text().splitlines()
    rows = [f"{row},{900 + 0.01 * i:.2f}" if i > 800 else f"{row}," for i, row in enumerate(rows)]
    path.write_text("\n".join([f"{header},pressure (hPa)", *rows, ""]))
    whole = pdr.track(read(path))
    small_parts(monkeypatch)
    written = pdr.batch.track_file(path, tmp_path / "parts.csv")
    assert written.path.read_bytes() == whole.to_csv(tmp_path / "whole.csv").read_bytes()
    assert any("barometer: no samples before" in note for note in whole.notes)
    assert written.about.notes == whole.notes


def test_the_place_where_a_ride_begins_and_a_track_on_a_plan_are_those_of_the_whole_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    legs = [pdr.simulate.Leg("walking", distance_m=20.0), pdr.simulate.Leg("stationary", duration_s=40.0)]
    path = own(pdr.simulate.simulate(legs), tmp_path)
    north_m = [min(1.4 * s, 20.0) + 10.0 * max(s - 20.0, 0.0) for s in np.arange(1.0, 45.0, 2.0)]
    fixes = [pdr.PositionFix(1.0 + 2.0 * i, np.array([0.5, y]), np.eye(2)) for i, y in enumerate(north_m)]
    corners = [[-9, -9], [9, -9], [9, 40], [-9, 40], [-9, -9]]
    geometry = {"type": "Polygon", "coordinates": [corners]}
    hall = {"type": "Feature", "properties": {"type": "floor", "name": "hall"}, "geometry": geometry}
    (tmp_path / "hall.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [hall]}))
    on_plan = pdr.recipes.default().with_plan(pdr.FloorPlan.read(tmp_path / "hall.geojson"))
    ride = pdr.track(read(path), fixes=fixes)
    plan = pdr.track(read(path), on_plan)
    small_parts(monkeypatch)
    assert any("as in a vehicle" in note for note in ride.notes)
    assert pdr.batch.track_file(path, tmp_path / "ride.csv", fixes=fixes).about.notes == ride.notes
    written = pdr.batch.track_file(path, tmp_path / "plan.csv", on_plan)
    assert written.path.read_bytes() == plan.to_csv(tmp_path / "whole.csv").read_bytes()


@pytest.mark.parametrize("seed", [0, 1])
def test_merged_parts_equal_merged_streams(
    walk: pdr.Recording, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    late_s = rng.choice([0.0, 0.06], len(walk.accelerometer), p=[0.6, 0.4])  # sorted by time
    force = Samples(walk.accelerometer.time_s - late_s, walk.accelerometer.values)
    path = own(replace(walk, accelerometer=force), tmp_path)
    whole = pdr.merge_streams(read(path))
    small_parts(monkeypatch)
    monkeypatch.setattr(parts, "_PART_SAMPLES", 1)  # parts then end where blocks end
    with parts.recording_in_parts(path) as opened:
        blocks = [part.block for part in opened.parts]
    assert len(blocks) > 5
    for name in ("time_s", "specific_force_mps2", "angular_rate_radps", "magnetic_field_ut"):
        np.testing.assert_array_equal(np.concatenate([getattr(block, name) for block in blocks]), getattr(whole, name))


def test_a_clock_that_is_set_back_is_tracked_as_a_whole(
    walk: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    time_s = walk.accelerometer.time_s - 3.0 * (walk.accelerometer.time_s > 9.0)
    path = own(replace(walk, accelerometer=Samples(time_s, walk.accelerometer.values)), tmp_path)
    small_parts(monkeypatch)
    written = pdr.batch.track_file(path, tmp_path / "parts.csv")
    whole = pdr.track(read(path)).to_csv(tmp_path / "whole.csv")
    assert written.path.read_bytes() == whole.read_bytes()


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_an_interrupted_run_leaves_no_file(
    walk: pdr.Recording, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(fraction: float) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    path = own(walk, tmp_path)
    small_parts(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        pdr.batch.track_file(path, tmp_path / "out" / f"parts.{kind}", progress=stop)
    assert [*(tmp_path / "out").iterdir()] == []


TRACKS_OF_MANY = """
import functools, sys, jobs
from pdr_filter import batch
for _, written in batch.each(functools.partial(jobs.track_into, sys.argv[1]), sys.argv[2:], jobs=2):
    print(written, flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="kills a process group")
@pytest.mark.parametrize("done", [0, 2])
def test_a_killed_batch_of_tracks_in_parts_has_whole_files_alone_and_goes_on(
    walk: pdr.Recording, done: int, tmp_path: Path
) -> None:
    first, out = own(walk, tmp_path), tmp_path / "out"
    whole = pdr.track(read(first)).to_csv(tmp_path / "whole.csv").read_bytes()
    walks = [shutil.copy(first, tmp_path / f"walk_{i}.zip") for i in range(3)]
    command = [sys.executable, "-c", TRACKS_OF_MANY, str(out), *map(str, walks)]
    options: Any = {"cwd": Path(__file__).parent, "stdout": subprocess.PIPE, "text": True}
    running = subprocess.Popen(command, start_new_session=True, **options)
    for _ in range(done):
        assert running.stdout.readline() == "1\n"
    if not done:
        while not [*out.glob(".*.part")]:  # a track has begun
            assert running.poll() is None
            time.sleep(0.01)
    os.killpg(running.pid, signal.SIGKILL)  # The process and its workers are a session of their own.
    running.wait(timeout=90)
    running.stdout.close()
    before = [*out.glob("walk_*.csv")]
    assert len(before) >= done
    assert all(path.read_bytes() == whole for path in before)
    again = subprocess.run(command, check=True, **options)
    assert again.stdout.count("1") == len(walks) - len(before)
    assert [path.read_bytes() for path in out.glob("walk_*.csv")] == [whole] * len(walks)


def test_rows_that_fixes_move_are_written_in_the_last_frame(
    walk: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fixes = [pdr.HeadingFix(12.0, 1.0, 0.1)]
    path = own(walk, tmp_path)
    small_parts(monkeypatch)
    written = pdr.batch.track_file(path, tmp_path / "parts.parquet", fixes=fixes)
    pandas: Any = pytest.importorskip("pandas")
    whole = pdr.track(read(path), fixes=fixes).to_parquet(tmp_path / "whole.parquet")
    found, expected = pandas.read_parquet(written.path), pandas.read_parquet(whole)
    pandas.testing.assert_frame_equal(found, expected, check_exact=True)
    assert found.attrs == expected.attrs
