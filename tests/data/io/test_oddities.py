"""Odd tables are read or refused as the table of docs/formats.md says, and say so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import (
    assert_same_streams,
    axes,
    on_one_clock,
    physics_toolbox_text,
    refusal,
    table_text,
    write_folder,
    write_text,
    write_zip,
)
from helpers import resumed
from oddities import (
    ACCURACY_M,
    BOTH,
    ODDITIES,
    N,
    Oddity,
    clock_set_back,
    columns,
    event_rows,
    hourly,
    lines_of,
    moved_rows,
    packs,
    places,
    ride,
    sensor_logger_of_2021,
    trials,
)
from table_cases import FORCE, GRAVITY, RATE, TIME_S, WALK

import pdr_filter as pdr
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.values import STANDARD_GRAVITY_MPS2

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize("oddity", ODDITIES, ids=lambda oddity: oddity.kind)
def test_what_is_said_of_an_odd_table_and_its_samples_are_right(tmp_path: Path, oddity: Oddity) -> None:
    path = oddity.write(tmp_path)
    assert oddity.sentence(path)
    if oddity.is_refused:
        refusal(path)
    elif oddity.streams:
        assert_same_streams(read(path), WALK, oddity.streams, time_s=oddity.time_s, rtol=1e-6)


def test_the_table_of_odd_tables_in_the_docs_has_every_kind() -> None:
    rows = (DOCS / "tables" / "oddities.md").read_text(encoding="utf-8").splitlines()[2:]
    shown = [row.strip("| ").split(" | ")[:2] for row in rows if row.startswith("|")]
    assert shown == [[oddity.kind, oddity.done] for oddity in ODDITIES]


def accuracy_m(path: Path) -> float:
    location = read(path).location
    return float(np.nanmax(location.values[:, 3], initial=-1.0))


def test_a_horizontal_accuracy_goes_before_one_that_does_not_say_of_what_it_is(tmp_path: Path) -> None:
    both = {"accuracy": np.full(N, 99.0), "hacc": np.full(N, ACCURACY_M)}
    for named in (both, dict(reversed(both.items()))):
        assert accuracy_m(write_text(tmp_path / "walk.csv", table_text(columns() | places() | named))) == ACCURACY_M


def test_each_cause_for_which_locations_are_not_used_is_named_alone() -> None:
    time_s = np.arange(0.0, 20.0)
    good = np.tile([10.0, 20.0, 0.0, 5.0], (len(time_s), 1))
    causes = {"coordinates that are not a place on Earth": (0, 95.0), "no horizontal accuracy": (3, -1.0)}
    for cause, (column, value) in causes.items():
        values = good.copy()
        values[:, 0] += time_s / 111_000
        values[::2, column] = value
        notes = pdr.track(replace(WALK, location=pdr.Samples(time_s, values))).notes
        said = [note for note in notes if "locations are not used" in note]
        assert len(said) == 1
        assert f"10 of 20 locations are not used: 10 with {cause}" in said[0]
        assert sum(other in said[0] for other in causes) == 1


@pytest.mark.parametrize(
    ("force", "linear"),
    [
        *(
            ("total_acc_%", "body_acc_%"),
            ("WAL_acc_%", "lin_acc_%"),
            ("normal_acc%", "lacc_%"),
            ("totalacc_%", "lacc%"),
        ),
        *(
            ("TOTALACC%", "LACC%"),
            ("vertical_acc_%", "user_acc_%"),
            ("globalAcc%", "LAcc%"),
            ("manual acc %", "useracc%"),
        ),
        ("accelerationIncludingGravity%", "acceleration%"),
        ("accel incl gravity %", "accel without gravity %"),
        ("acc_with_g_%", "acc_no_gravity_%"),
        ("Beschleunigung mit g %", "Beschleunigung ohne g %"),
    ],
)
def test_the_acceleration_with_gravity_is_found_by_words_and_values(tmp_path: Path, force: str, linear: str) -> None:
    for names in ((linear, force), (force, linear)):
        values = {force: FORCE, linear: FORCE - GRAVITY}
        by_name = {"time": TIME_S} | axes(names[0], values[names[0]]) | axes(names[1], values[names[1]])
        path = write_text(tmp_path / "walk.csv", table_text(by_name | axes("gyro_%", RATE)))
        assert_same_streams(read(path), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_a_mapping_beside_a_file_counts_in_a_folder_and_on_the_command_line(tmp_path: Path) -> None:
    oddity = next(oddity for oddity in ODDITIES if oddity.path == "accelerometer.csv")
    path = oddity.write(tmp_path)
    assert recordings_in(path.parent) == [path]
    assert_same_streams(read(path.parent), WALK, "accelerometer", time_s=1e-6, rtol=1e-6)


@pytest.mark.parametrize("packed", [True, False])
def test_the_platform_of_the_metadata_is_used_by_every_way_in(tmp_path: Path, packed: bool) -> None:
    files = sensor_logger_of_2021()
    path = write_zip(tmp_path / "w.zip", files) if packed else write_folder(tmp_path / "w", files)
    for way in (path, *recordings_in(path), *recordings_in(tmp_path)):
        assert_same_streams(read(way), WALK, BOTH, time_s=1e-6, rtol=1e-6)
    assert "leave platform out" in refusal(path, platform="android")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("Metadata.csv", "platform,app\niOS,some\n"),
        ("metadata.json", '{"os": "iOS 17.1"}'),
        ("device.csv", "property,value\nmodel,iPhone 12\n"),
        ("meta.txt", "Device model: iPad\n"),
    ],
)
def test_metadata_beside_tables_of_an_unknown_app_give_the_sign(tmp_path: Path, name: str, text: str) -> None:
    files = {"walk.csv": table_text({"time": TIME_S} | axes("acc_%", -FORCE) | axes("gyro_%", RATE)), name: text}
    for path in (
        write_folder(tmp_path / "w", files),
        tmp_path / "w" / "walk.csv",
        write_zip(tmp_path / "z.zip", files),
    ):
        assert_same_streams(read(path), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    above = f"# platform: iOS\n{files['walk.csv']}"
    assert_same_streams(read(write_text(tmp_path / "above.csv", above)), WALK, BOTH, time_s=1e-6, rtol=1e-9)


def test_moved_rows_have_the_track_of_the_sorted_ones_and_a_clock_that_was_set_back_is_left_to_the_filter(
    tmp_path: Path,
) -> None:
    right = pdr.track(read(write_text(tmp_path / "right.csv", table_text(columns()))))
    moved = pdr.track(read(write_text(tmp_path / "moved.csv", moved_rows())))
    np.testing.assert_array_equal(moved.position_m, right.position_m)
    header, rows = lines_of(table_text(columns()))
    swapped = read(write_text(tmp_path / "swapped.csv", header + "".join(rows[N // 2 :] + rows[: N // 2])))
    assert_same_streams(swapped, WALK, BOTH, time_s=1e-6, rtol=1e-9)
    back = read(write_text(tmp_path / "back.csv", clock_set_back()))
    assert not any("out of order" in note for note in back.notes)
    np.testing.assert_array_equal(back.accelerometer.values, FORCE)
    far = np.where(np.arange(N) < N // 2, TIME_S + 3600.0, TIME_S)
    others = {name: values for name, values in columns().items() if name != "time"}
    hour = read(write_text(tmp_path / "hour.csv", table_text({"time (s)": far, **others})))
    assert not any("out of order" in note for note in hour.notes)
    np.testing.assert_array_equal(hour.accelerometer.values, FORCE)


def test_a_slow_sensor_may_lose_two_samples_between_files_of_an_hour(tmp_path: Path) -> None:
    def fixes(begin_s: float) -> str:
        rows = (f"{1_664_625_600_000 + 1000 * (begin_s + k):.0f},48.0,11.{k:05.0f}\n" for k in (0.0, 7.0, 14.0))
        return "timestamp,latitude,longitude\n" + "".join(rows)

    files = hourly() | {"gps/2022-10-01 11_00_00.csv": fixes(-15.0), "gps/2022-10-01 12_00_00.csv": fixes(19.0)}
    location = read(write_folder(tmp_path / "w", files)).location
    assert location is not None
    assert len(location) == 6


def test_the_unix_time_of_a_sorted_recording_is_that_of_its_first_sample(tmp_path: Path) -> None:
    ns: dict[str, np.ndarray | list[str]] = {"time": [str(1_700_000_000_000_000_000 + round(t * 1e9)) for t in TIME_S]}
    header, rows = lines_of(table_text(ns | axes("acc_%", FORCE)))
    epochs = [
        read(write_text(tmp_path / f"{i}.csv", header + "".join(text))).epoch_s
        for i, text in enumerate((rows, rows[N // 2 :] + rows[: N // 2]))
    ]
    assert epochs[1] == pytest.approx(epochs[0], abs=1e-6)
    assert epochs[0] is not None


@pytest.mark.parametrize("n", [2, 3, 8])
def test_packs_with_one_time_are_spread_and_a_lost_pack_leaves_a_gap(tmp_path: Path, n: int) -> None:
    header, rows = lines_of(packs(n))
    rows = rows[: N // n * n]
    found = read(write_text(tmp_path / "walk.csv", header + "".join(rows))).accelerometer
    np.testing.assert_allclose(np.diff(found.time_s), 0.02, atol=1e-6)
    lost = 60 // n * n
    cut = read(write_text(tmp_path / "cut.csv", header + "".join(rows[:240] + rows[240 + lost :]))).accelerometer
    assert np.diff(cut.time_s).max() == pytest.approx(0.02 * (lost + 1), abs=1e-6)


def test_the_rate_of_packs_can_be_given(tmp_path: Path) -> None:
    path = write_text(tmp_path / "walk.csv", packs())
    toml = '[time]\ncolumn = "timestamp_ms"\nunit = "ms"\nrate_hz = 50\n'
    toml += '[accelerometer]\ncolumns = ["acc_x", "acc_y", "acc_z"]\nunit = "m/s2"\n'
    write_text(tmp_path / "walk.toml", toml)
    recording = read(path)
    np.testing.assert_allclose(np.diff(recording.accelerometer.time_s[: N // 3 * 3]), 0.02, atol=1e-6)
    assert any("at 50 Hz (as given)" in note for note in recording.notes)


def test_a_ride_is_named_with_the_place_where_the_track_stopped_and_a_walk_is_none(tmp_path: Path) -> None:
    note = next(n for n in pdr.track(read(write_text(tmp_path / "ride.csv", ride()))).notes if "vehicle" in n)
    assert "move 498 m without steps from 0 to 50 s" in note
    assert "stops at 0.0 m east" in note
    assert any("vehicle" in n for n in pdr.track(read(tmp_path / "ride.csv"), gnss="align").notes)
    slow = pdr.track(read(write_text(tmp_path / "escalator.csv", ride(2.0)))).notes
    assert not any("vehicle" in n for n in slow)
    for speed_mps in (0.0, 1.4):
        walk = table_text(columns() | places(speed_mps) | {"accuracy": np.full(N, 5.0)})
        assert not any("vehicle" in n for n in pdr.track(read(write_text(tmp_path / "walk.csv", walk))).notes)


def test_a_ride_without_steps_is_named_in_a_smoothed_track(tmp_path: Path) -> None:
    smoothed = pdr.smooth(read(write_text(tmp_path / "ride.csv", ride())))
    assert smoothed.track.n_steps == 0
    assert any("as in a vehicle" in n and "stops at 0.0 m east, 0.0 m north" in n for n in smoothed.notes)


@pytest.mark.parametrize("late_s", [0.0, 25.0])
def test_an_app_is_told_of_a_ride_and_neither_of_a_walk_nor_of_an_outlier(late_s: float) -> None:
    walk = on_one_clock(pdr.simulate.demo_walk())
    n = int(np.searchsorted(walk.accelerometer.time_s, 50.0))
    time_s, walking, rate = walk.accelerometer.time_s[:n], walk.accelerometer.values[:n], walk.gyroscope.values[:n]

    def notes(places_m: list[float], force: np.ndarray) -> list[str]:
        online = pdr.OnlineFilter()
        for k, north_m in enumerate(places_m):
            received_s = 10.0 * k + late_s
            online.add_fix(pdr.PositionFix(10.0 * k, [0.0, north_m], 9.0 * np.eye(2), received_time_s=received_s))
        online.push(time_s, force, rate if force is walking else 0.01 * rate)
        return [n for n in resumed(online).notes if "vehicle" in n]

    still = np.random.default_rng(0).normal([0.2, 3.9, 9.0], 0.02, walking.shape)
    (note,) = notes([0.0, 120.0, 240.0], still)
    assert "move 240 m without steps from 0 to 20 s" in note
    assert not notes([0.0, 14.0, 28.0], walking)
    assert not notes([0.0, 30.0, 60.0], walking)
    assert not notes([0.0, 90.0, 1.0], still)


@pytest.mark.parametrize(
    "names", ["walk1_%.csv", "%_walk1.csv", "walk1%.csv", "trial 1 - %.csv", "2024-05-01_10-01 %.csv"]
)
@pytest.mark.parametrize("packed", [True, False])
def test_pairs_of_files_of_two_trials_are_two_recordings(tmp_path: Path, names: str, packed: bool) -> None:
    files = {
        ("2" if "walk2" in name else "1").join(names.rsplit("1", 1)).replace("%", sensor): text
        for name, text in trials().items()
        for sensor in [name.removesuffix(".csv").partition("_")[2].title()]
    }
    path = write_zip(tmp_path / "w.zip", files) if packed else write_folder(tmp_path / "w", files)
    found = recordings_in(path)
    assert len(found) == 2
    for recording in found:
        assert_same_streams(read(recording), WALK, BOTH, time_s=1e-6, rtol=1e-9)
    message = refusal(path)
    assert "holds 2 recordings" in message
    assert found[0].name in message


@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("acc/data gyro/data walk_2/acc walk_2/gyro", ". walk_2"),
        ("acc/walk1 acc/walk2 gyro/walk1 gyro/walk2 others/full", "walk1 walk2 others/full.csv"),
        ("walk1_acc walk1_gyro walk2_acc walk2_gyro acc_tests/full", "walk1 walk2 acc_tests/full.csv"),
        ("raw_acc/1 gyro/1 gps/1", "."),
        ("1_acc/1 2_gyro/1 gps/1", "."),
    ],
)
def test_a_folder_beside_those_of_sensors_is_a_recording_of_its_own(
    tmp_path: Path, names: str, expected: str, packed: bool
) -> None:
    texts = {"full": physics_toolbox_text(WALK), "gyro": trials()["walk1_gyro.csv"], "acc": trials()["walk1_acc.csv"]}
    texts["gps"] = "time,latitude,longitude\n" + "".join(f"{k},48.0,11.{k:05d}\n" for k in range(10))
    files = {f"{name}.csv": next(text for key, text in texts.items() if key in name) for name in names.split()}
    path = write_zip(tmp_path / "w.zip", files) if packed else write_folder(tmp_path / "w", files)
    assert {str(found.relative_to(path)) for found in recordings_in(path)} == {*expected.split()}
    if expected == ".":
        assert read(path).location is not None
    else:
        assert f"read one, such as {path}/walk" in refusal(path)


@pytest.mark.parametrize(
    ("header", "accelerometer", "gyroscope"),
    [
        ("type,timestamp,x,y,z\n", "ACC,{t},{x},{y},{z}", "GYRO,{t},{x},{y},{z}"),
        (
            "timestamp,x,y,z,sensor\n",
            "{t},{x},{y},{z},android.sensor.accelerometer",
            "{t},{x},{y},{z},android.sensor.gyroscope",
        ),
        ("timestamp,event,v0,v1,v2\n", "{t},TYPE_ACCELEROMETER,{x},{y},{z}", "{t},TYPE_GYROSCOPE,{x},{y},{z}"),
        (
            "timestamp,event,values[0],values[1],values[2]\n",
            "{t},Accelerometer,{x},{y},{z}",
            "{t},Gyroscope,{x},{y},{z}",
        ),
        ("sensor_type,timestamp,x,y,z\n", "1,{t},{x},{y},{z}", "4,{t},{x},{y},{z}"),
        ("name,timestamp,x,y,z\n", "a,{t},{x},{y},{z}", "g,{t},{x},{y},{z}"),
        ("", "ACC;{t};{x};{y};{z}", "GYR;{t};{x};{y};{z}"),
        ("", "{t} accelerometer {x} {y} {z}", "{t} gyroscope {x} {y} {z}"),
        ("", "{t} Accelerometer: {x} {y} {z}", "{t} Gyroscope: {x} {y} {z}"),
        ("sensor;time (s);x;y;z\n", "acc;{t};{x};{y};{z}", "gyro;{t};{x};{y};{z}"),
    ],
)
def test_the_sensor_of_a_row_is_known_from_a_column_or_the_line(
    tmp_path: Path, header: str, accelerometer: str, gyroscope: str
) -> None:
    path = write_text(tmp_path / "walk.txt", header + event_rows(accelerometer, gyroscope))
    assert_same_streams(read(path), WALK, BOTH, time_s=1e-6, rtol=1e-9)


@pytest.mark.parametrize(
    ("accelerometer", "gyroscope"),
    [
        ("ACC: {t}, {x}, {y}, {z}", "GYR: {t}, {x}, {y}, {z}"),
        ("{t},accelerometer,x={x},y={y},z={z}", "{t},gyroscope,x={x},y={y},z={z}"),
    ],
)
def test_values_with_names_in_front_are_refused_with_the_line_to_write(
    tmp_path: Path, accelerometer: str, gyroscope: str
) -> None:
    message = refusal(write_text(tmp_path / "walk.txt", event_rows(accelerometer, gyroscope)))
    assert "names in front of their numbers" in message
    assert "sensor,time,x,y,z" in message


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m/s2"), (STANDARD_GRAVITY_MPS2, "g")])
@pytest.mark.parametrize("per_s", [1.0, 1e3])
def test_the_mapping_for_an_unknown_table_has_the_columns_that_its_values_show(
    tmp_path: Path, scale: float, unit: str, per_s: float
) -> None:
    values = {"n": np.arange(N), "u": RATE[:, 0], "v": RATE[:, 1]} | dict(zip("fgh", FORCE.T / scale, strict=True))
    text = table_text({**values, "w": RATE[:, 2], "tick": TIME_S * per_s}).replace("f,g,h", "fa,fb,fc")
    message = refusal(write_text(tmp_path / "walk.csv", text))
    time_unit = "s" if per_s == 1.0 else "ms"
    assert f'time = {{ column = "tick", unit = "{time_unit}" }}' in message
    assert f'accelerometer = {{ columns = ["fa", "fb", "fc"], unit = "{unit}", sign = "?" }}' in message
    mapping = message.partition("MAP.toml:\n")[2].replace('"?"', "1")
    write_text(tmp_path / "walk.toml", mapping)
    assert_same_streams(read(tmp_path / "walk.csv"), WALK, "accelerometer", time_s=1e-6, rtol=1e-9)
