"""Sensor Logger: every trap of its files, iOS and Android, standardised or not, zip, folder and JSON."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from app_files import (
    T0_NS,
    a_walk,
    assert_same_bits,
    assert_same_streams,
    metadata,
    push_messages,
    refusal,
    sensor_logger_csv,
    sensor_logger_files,
    sensor_logger_json,
    with_level_attitude,
    write_folder,
    write_zip,
)

from pdr_filter.data.io.describe import describe, reading_report
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Samples, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

WALK = with_level_attitude(a_walk())
ALL = "accelerometer gyroscope magnetometer attitude"


def at_rest(platform: str, standardisation: bool) -> dict[str, str]:
    """A phone lying face up, as the documents of the app describe it: gravity -z on iOS, +z on Android."""
    sign = -1.0 if platform == "ios" and not standardisation else 1.0
    still = Samples(np.arange(100) / 100, np.zeros((100, 3)))
    gravity = np.tile([0.0, 0.0, sign * STANDARD_GRAVITY_MPS2], (100, 1))
    return {
        "Metadata.csv": metadata(platform, standardisation),
        "Accelerometer.csv": sensor_logger_csv(still),
        "Gravity.csv": sensor_logger_csv(still, values=gravity),
    }


def changed(folder: Path, platform: str = "android", **files: str | None) -> Path:
    """The files of the walk, some with another content, by their stems; None leaves one out."""
    whole = sensor_logger_files(WALK, platform) | {f"{stem}.csv": text for stem, text in files.items()}
    return write_folder(folder / "w", {name: text for name, text in whole.items() if text is not None})


# ---------------------------------------------------------------- round trip, signs


@pytest.mark.parametrize(("platform", "standardisation"), [("android", False), ("ios", False), ("ios", True)])
@pytest.mark.parametrize("kind", ["folder", "zip", "zip with a folder", "json"])
def test_a_walk_comes_back_as_it_was(tmp_path: Path, platform: str, standardisation: bool, kind: str) -> None:
    files = sensor_logger_files(WALK, platform, standardisation)
    path = tmp_path / "walk"
    if kind == "json":
        path = tmp_path / "walk.json"
        path.write_text(sensor_logger_json(files))
    elif kind == "folder":
        write_folder(path, files)
    else:
        write_zip(path, files, "2026-08-28/" if "folder" in kind else "")
    assert_same_streams(read(path), WALK, ALL, time_s=1e-9, rtol=1e-14)


@pytest.mark.parametrize(("platform", "standardisation"), [("android", False), ("ios", False), ("ios", True)])
def test_a_phone_lying_face_up_reads_plus_one_g_on_z(tmp_path: Path, platform: str, standardisation: bool) -> None:
    recording = read(write_folder(tmp_path / "w", at_rest(platform, standardisation)))
    np.testing.assert_allclose(recording.accelerometer.values, np.tile([0, 0, STANDARD_GRAVITY_MPS2], (100, 1)))
    report = reading_report(recording)
    assert platform in report.source
    assert any("Accelerometer + Gravity" in line for line in report.found)


@pytest.mark.parametrize(("standardisation", "scale"), [(False, -1 / STANDARD_GRAVITY_MPS2), (True, 1.0)])
def test_uncalibrated_acceleration_on_ios_is_in_g_unless_standardised(
    tmp_path: Path, standardisation: bool, scale: float
) -> None:
    values = WALK.accelerometer.values * scale
    text = sensor_logger_csv(WALK.accelerometer, values=values)
    files = {"Metadata.csv": metadata("ios", standardisation), "AccelerometerUncalibrated.csv": text}
    assert_same_streams(read(write_folder(tmp_path / "w", files)), WALK, "accelerometer", time_s=1e-9)


def test_gravity_at_other_times_is_interpolated(tmp_path: Path) -> None:
    files = at_rest("android", False)
    time_s = np.arange(-10, 250) / 230  # a Pixel delivers gravity three times as fast
    tilt = 0.1 * time_s
    gravity = STANDARD_GRAVITY_MPS2 * np.column_stack([0 * tilt, tilt, 1 + 0 * tilt])
    files["Gravity.csv"] = sensor_logger_csv(Samples(time_s, gravity))
    recording = read(write_folder(tmp_path / "w", files))
    expected = 0.1 * STANDARD_GRAVITY_MPS2 * np.arange(100) / 100
    np.testing.assert_allclose(recording.accelerometer.values[:, 1], expected, atol=1e-6)


# ---------------------------------------------------------------- traps of the files


def test_members_are_known_in_small_letters_too(tmp_path: Path) -> None:
    files = {name.lower(): text for name, text in sensor_logger_files(WALK).items()}
    recording = read(write_zip(tmp_path / "walk.zip", files))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-8)
    assert "android" in recording.meta["reading"]["source"]


def test_members_with_something_around_their_names_are_known_and_two_of_a_sensor_are_refused(tmp_path: Path) -> None:
    files = {f"walk 3_{name.removesuffix('.csv')} (1).csv": text for name, text in sensor_logger_files(WALK).items()}
    recording = read(write_folder(tmp_path / "walk", files))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-9, rtol=0)
    assert "(android)" in reading_report(recording).source
    twice = files | {"TotalAcceleration_2.csv": files["walk 3_TotalAcceleration (1).csv"]}
    assert "are both TotalAcceleration; keep one" in refusal(write_folder(tmp_path / "twice", twice))


def test_times_that_a_spreadsheet_rounded_are_replaced_by_the_seconds_elapsed(tmp_path: Path) -> None:
    text = re.sub(r"(?m)^1\d{18},", "1.78792E+18,", sensor_logger_csv(WALK.accelerometer))
    recording = read(changed(tmp_path, TotalAcceleration=text.replace(",", ";").replace(".", ",")))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=2e-9, rtol=0)
    assert any("time was rounded, so seconds_elapsed is taken" in note for note in recording.notes)


def test_columns_are_found_by_name_whatever_their_order(tmp_path: Path) -> None:
    for columns in ("x,y,z", "z,y,x", "y,z,x"):
        path = changed(tmp_path, TotalAcceleration=sensor_logger_csv(WALK.accelerometer, columns))
        assert_same_streams(read(path), WALK, "accelerometer", time_s=1e-9)


def test_nanoseconds_keep_their_last_digit(tmp_path: Path) -> None:
    time_ns = T0_NS + np.arange(0, 100 * 10_000_000, 10_000_000) + np.arange(100) % 3
    assert (time_ns.astype(float).astype(np.int64) != time_ns).any()  # why: a float loses them
    rows = "".join(f"{t},{i / 100},9.8,0.1,0.2\n" for i, t in enumerate(time_ns.tolist()))
    files = {"Metadata.csv": metadata("android"), "TotalAcceleration.csv": "time,seconds_elapsed,z,y,x\n" + rows}
    for kind in ("folder", "json"):
        path = write_folder(tmp_path / "w", files)
        if kind == "json":
            path = tmp_path / "w.json"
            path.write_text(sensor_logger_json(files))
        recording = read(path)
        np.testing.assert_array_equal(
            np.round(recording.accelerometer.time_s * 1e9).astype(np.int64), time_ns - time_ns[0]
        )
        assert recording.meta["epoch_ns"] == T0_NS


def test_an_annotation_file_of_no_bytes_and_metadata_without_final_line_feed_are_read(tmp_path: Path) -> None:
    files = sensor_logger_files(WALK)
    assert files["Annotation.csv"] == ""
    assert not files["Metadata.csv"].endswith("\n")
    recording = read(write_folder(tmp_path / "w", files))
    assert recording.meta["device"] == "Some Phone"
    assert "annotations" not in recording.meta


def test_annotations_are_kept_with_their_time(tmp_path: Path) -> None:
    text = f'time,seconds_elapsed,text,millisecond_press_duration\n{T0_NS + 2_500_000_000},2.5,"door, left",80'
    zero_s = WALK.accelerometer.time_s[0]
    (annotation,) = read(changed(tmp_path, Annotation=text)).meta["annotations"]
    assert annotation["text"] == "door, left"
    assert annotation["time_s"] == pytest.approx(2.5 - zero_s, abs=1e-6)


def test_a_sensor_file_of_no_bytes_is_left_out_with_a_note(tmp_path: Path) -> None:
    recording = read(changed(tmp_path, Magnetometer=""))
    assert recording.magnetometer is None
    assert "Magnetometer.csv: empty, left out" in recording.notes


def test_a_sensor_file_whose_header_is_missing_is_refused(tmp_path: Path) -> None:
    text = "\n" + sensor_logger_csv(WALK.magnetometer).split("\n", 1)[1]
    assert "Magnetometer.csv: no column 'time'" in refusal(changed(tmp_path, Magnetometer=text))


def test_negative_seconds_elapsed_change_nothing_but_a_remembered_value_is_left_out(tmp_path: Path) -> None:
    header, *rows = sensor_logger_csv(WALK.accelerometer).splitlines(keepends=True)
    early = f"{T0_NS - 300_000_000},-0.3,9.8,0.0,0.0\n"
    stale = f"{T0_NS - 328_883_000_000_000},-328883.4,0,0,0\n"
    recording = read(changed(tmp_path, TotalAcceleration=header + stale + early + "".join(rows)))
    assert len(recording.accelerometer) == len(WALK.accelerometer) + 1
    assert recording.accelerometer.time_s[1] == pytest.approx(0.3 + WALK.accelerometer.time_s[0], abs=1e-6)
    assert any("1 values that the phone had stored before" in note for note in recording.notes)


def test_half_the_requested_rate_is_reported(tmp_path: Path) -> None:
    recording = read(changed(tmp_path, Metadata=metadata("android", period_ms=5)))
    stream = reading_report(recording).streams[0]
    assert stream.requested_hz == 200
    assert stream.mean_rate_hz == pytest.approx(100, rel=0.01)
    assert "accelerometer: 200.0 Hz requested, 100.0 Hz delivered" in describe(recording).notes


def test_metadata_of_the_first_versions_has_no_standardisation(tmp_path: Path) -> None:
    first = "version,device name,recording time,platform,appVersion\n2,iPhone 11,2021-07-20,ios,1.6.0"
    recording = read(changed(tmp_path, "ios", Metadata=first))
    assert_same_streams(recording, WALK, "accelerometer", time_s=1e-9)
    assert reading_report(recording).source == "Sensor Logger 1.6.0 (ios)"


def test_an_unknown_accuracy_of_a_location_is_nan(tmp_path: Path) -> None:
    text = "time,seconds_elapsed,horizontalAccuracy,altitude,longitude,latitude,bearing\n"
    text += f"{T0_NS},0.0,-1,519.5,11.98,48.12,\n{T0_NS + 10**9},1.0,4.5,519.5,11.98,48.12,\n"
    location = read(changed(tmp_path, Location=text)).location
    np.testing.assert_array_equal(location.values, [[48.12, 11.98, 519.5, math.nan], [48.12, 11.98, 519.5, 4.5]])


def test_only_uncalibrated_gyroscope_is_taken_with_a_note(tmp_path: Path) -> None:
    recording = read(changed(tmp_path, Gyroscope=None, GyroscopeUncalibrated=sensor_logger_csv(WALK.gyroscope)))
    assert_same_streams(recording, WALK, "gyroscope", time_s=1e-9)
    assert any("uncalibrated" in note for note in recording.notes)


# ---------------------------------------------------------------- what is refused


def test_a_platform_that_is_not_known_is_refused_unless_only_android_writes_such_a_file(tmp_path: Path) -> None:
    path = changed(tmp_path / "ios", "ios", Metadata=None, Orientation=None)
    message = refusal(path)
    assert "names no platform" in message
    assert "convert FILE --platform ios" in message
    assert_same_streams(read(path, platform="ios"), WALK, "accelerometer", time_s=1e-9)
    recording = read(changed(tmp_path / "android", Metadata=None))
    assert any("taken as Android" in note for note in recording.notes)


@pytest.mark.parametrize("platform", ["ios", "android"])
def test_acceleration_without_gravity_is_restored_with_the_sign_of_the_platform(tmp_path: Path, platform: str) -> None:
    sign, force = -1.0 if platform == "ios" else 1.0, WALK.accelerometer.values
    linear = sensor_logger_csv(WALK.accelerometer, values=sign * (force - force.mean(axis=0)))
    files = {"Gravity": None, "TotalAcceleration": None, "Orientation": None, "Accelerometer": linear}
    recording = read(changed(tmp_path, platform, **files))
    error_mps2 = (recording.accelerometer.values - WALK.accelerometer.values).mean(axis=0)
    assert np.linalg.norm(error_mps2) < 2.5
    assert "the acceleration (Accelerometer) lacks gravity" in recording.notes[0]
    unknown = changed(tmp_path / "unknown", platform, Metadata=None, **files)
    assert "say it with pdr-filter convert FILE --platform" in refusal(unknown)


def test_one_sensor_alone_is_read_and_says_what_to_record_if_gravity_is_not_in_it(tmp_path: Path) -> None:
    write_folder(tmp_path, sensor_logger_files(WALK, "ios") | sensor_logger_files(WALK))
    (tmp_path / "Metadata.csv").unlink()
    alone = read(tmp_path / "TotalAcceleration.csv")
    assert_same_streams(alone, WALK, "accelerometer", time_s=1e-9)
    assert any("Android's is taken" in note for note in alone.notes)
    assert "and TotalAcceleration, or Gravity" in read(tmp_path / "Accelerometer.csv").notes[0]
    assert "no accelerometer" in refusal(tmp_path / "Gyroscope.csv")


@pytest.mark.parametrize(("platform", "standardisation"), [("ios", False), ("ios", True), ("android", False)])
def test_the_sign_of_one_sensor_alone_is_that_of_the_metadata_beside_it(
    tmp_path: Path, platform: str, standardisation: bool
) -> None:
    sign = -1.0 if platform == "ios" and not standardisation else 1.0
    files = {"Metadata.csv": metadata(platform, standardisation)}
    files["TotalAcceleration.csv"] = sensor_logger_csv(WALK.accelerometer, "z,y,x", sign * WALK.accelerometer.values)
    write_folder(tmp_path, files)
    alone = read(tmp_path / "TotalAcceleration.csv")
    assert_same_streams(alone, WALK, "accelerometer", time_s=1e-9)
    assert not any("nothing in the file shows its sign" in note for note in alone.notes)


def test_without_a_platform_an_attitude_shows_the_sign(tmp_path: Path) -> None:
    force = WALK.accelerometer.values
    gravity = np.tile(force.mean(axis=0), (len(force), 1))
    for platform, sign in (("ios", -1.0), ("android", 1.0)):
        texts = [sensor_logger_csv(WALK.accelerometer, values=sign * part) for part in (gravity, force - gravity)]
        files = {"Gravity": texts[0], "Accelerometer": texts[1], "Metadata": None, "TotalAcceleration": None}
        recording = read(changed(tmp_path / platform, platform, **files))
        assert_same_streams(recording, WALK, "accelerometer", time_s=1e-9)
        assert any(f"{platform}, because Gravity points" in note for note in recording.notes)


def test_pushed_messages_in_any_order_are_the_recording_and_two_sessions_are_two(tmp_path: Path) -> None:
    messages = push_messages(sensor_logger_files(WALK))
    path = tmp_path / "log.json"
    path.write_text(json.dumps(messages[::-1]))
    assert_same_streams(read(path), WALK, "accelerometer gyroscope magnetometer", time_s=1e-9)
    others = push_messages(sensor_logger_files(with_level_attitude(a_walk(seed=5))), "two")
    path.write_text("\n".join(map(json.dumps, [*others, *messages])))
    assert "holds 2 recordings (two, one)" in refusal(path)
    assert f"read one of them, as {path}/two" in refusal(path / "three")
    assert [str(p.relative_to(path)) for p in recordings_in(path)] == ["two", "one"]
    assert_same_streams(read(path / "one"), WALK, "accelerometer", time_s=1e-9)
    path.write_text(json.dumps(messages[0] | {"payload": {}}))
    assert "no message has a list as payload" in refusal(path)
    path.write_text(json.dumps(messages[0]))
    assert "put all messages into one file" in refusal(path)


def test_a_missing_column_is_refused_with_its_name(tmp_path: Path) -> None:
    text = sensor_logger_csv(WALK.gyroscope).replace("z,y,x", "w,y,x", 1)
    assert "Gyroscope.csv: no column 'z'" in refusal(changed(tmp_path, Gyroscope=text))


def test_a_json_object_without_a_time_is_refused_with_its_key(tmp_path: Path) -> None:
    rows = json_objects()
    del next(row for row in reversed(rows) if row["sensor"] == "Gyroscope")["time"]
    (tmp_path / "w.json").write_text(json.dumps(rows))
    assert "Gyroscope: an object has no key 'time'" in refusal(tmp_path / "w.json")


def test_json_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    text = sensor_logger_json(sensor_logger_files(WALK))
    for end in (len(text) // 2, text.index("},{", len(text) // 2) + 1, -1):  # in an object, behind one, behind all
        (tmp_path / "w.json").write_text(text[:end])
        assert "cut off behind" in refusal(tmp_path / "w.json")


def test_json_with_a_brace_in_a_text_is_read_and_an_unknown_sensor_is_no_annotation(tmp_path: Path) -> None:
    for sensor, expected in (("Annotation", ['odd "},{" text']), ("Future", [])):
        more = {"sensor": sensor, "time": str(T0_NS), "seconds_elapsed": "0", "text": 'odd "},{" text'}
        recording = of_json(tmp_path / "w.json", json.dumps([*json_objects(), more], separators=(",", ":")))
        assert [annotation["text"] for annotation in recording.meta.get("annotations", [])] == expected


def json_objects() -> list[dict[str, str]]:
    return json.loads(sensor_logger_json(sensor_logger_files(WALK)))


def of_json(path: Path, text: str) -> Recording:
    path.write_text(text)
    return read(path)


@pytest.mark.parametrize("layout", ["with spaces", "by time", "other order of keys", "numbers", "one object differs"])
def test_json_in_another_layout_gives_the_same_bits(tmp_path: Path, layout: str) -> None:
    compact = {"separators": (",", ":")}
    objects = json_objects()
    expected = of_json(tmp_path / "w.json", json.dumps(objects, **compact))
    if layout == "with spaces":
        text = json.dumps(objects, indent=1)
    elif layout == "by time":  # sensors mixed, each in its order
        text = json.dumps(sorted(objects, key=lambda item: int(item.get("time", 0))), **compact)
    elif layout == "other order of keys":
        text = json.dumps([dict(reversed(item.items())) for item in objects], **compact)
    elif layout == "numbers":
        number = {"time": int, "x": float, "y": float, "z": float}
        text = json.dumps([{k: number.get(k, str)(v) for k, v in item.items()} for item in objects], **compact)
    else:
        objects[500] = dict(sorted(objects[500].items())) | {"more": ""}
        text = json.dumps(objects, **compact)
    found = of_json(tmp_path / "w.json", text)
    assert found.meta == expected.meta
    assert_same_bits(found, expected)


@pytest.mark.parametrize("value", ["", "null", "1e999", "0x10", "1_0", "--1", "1e", "."])
def test_a_value_that_is_no_number_means_the_same_in_json_of_every_layout(tmp_path: Path, value: str) -> None:
    objects = json_objects()
    accelerometer = [item for item in objects if item["sensor"] == "TotalAcceleration"]
    accelerometer[7]["x"] = value
    outcomes: list[str | np.ndarray] = []
    for separators in ((",", ":"), (", ", ": ")):
        try:
            outcomes.append(
                of_json(tmp_path / "w.json", json.dumps(objects, separators=separators)).accelerometer.values
            )
        except RecordingError as error:
            outcomes.append(str(error))
    if value in ("", "null", "1e999"):
        np.testing.assert_array_equal(*outcomes)
        assert np.isnan(outcomes[0][7, 0])
        assert np.isnan(outcomes[0]).sum() == 1
    else:
        assert outcomes[0] == outcomes[1]
        assert "not a number" in outcomes[0]


def test_json_larger_than_a_block_loses_no_object_where_it_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = sensor_logger_json(sensor_logger_files(WALK))
    expected = of_json(tmp_path / "w.json", text)
    monkeypatch.setattr(limits, "BLOCK_BYTES", 10_007)
    found = read(tmp_path / "w.json")
    assert_same_bits(found, expected)


@pytest.mark.parametrize(
    ("counts", "n_steps"), [([0, 4, 31], 31), ([3, 9, 31], 31), ([9000, 9004, 9031], 31), ([], None)]
)
def test_steps_and_headings_of_the_phone_are_reported(tmp_path: Path, counts: list[int], n_steps: int | None) -> None:
    rows = "".join(f"{T0_NS + 10**9 * k},{k}.0,{count}\n" for k, count in enumerate(counts))
    compass = "".join(f"{T0_NS + 10**9 * k},{k}.0,{heading}\n" for k, heading in enumerate((359.6, 20.0, 91.2)))
    files = sensor_logger_files(WALK) | {
        "Pedometer.csv": f"time,seconds_elapsed,steps\n{rows}",
        "Compass.csv": f"time,seconds_elapsed,magneticBearing\n{compass}",
    }
    recording = read(write_zip(tmp_path / "walk.zip", files))
    assert recording.phone_steps == n_steps
    np.testing.assert_allclose(np.degrees(recording.phone_heading.values[:, 0]), [359.6, 20.0, 91.2])
    lines = reading_report(recording).lines()
    assert ("steps counted by the phone: 31" in lines) == (n_steps == 31)
    assert "heading by the phone: 360 degrees at the start, 91 at the end" in lines
    again = read(recording.save(tmp_path / "own.zip"))
    assert_same_streams(again, recording, "phone_heading", time_s=1e-6, rtol=1e-6)
    assert again.phone_steps == n_steps
