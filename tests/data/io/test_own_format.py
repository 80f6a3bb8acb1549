"""The project's own format: what is read, what is repaired with a note, what is refused and how it is said."""

from __future__ import annotations

import bz2
import json
import random
import zipfile
from pathlib import Path

import numpy as np
import pytest
from app_files import refusal, write_zip
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples, limits, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording, Truth

META = json.dumps({"name": "test_s1_walk", "subject": {"id": "s1", "height_m": 1.8}})


def accelerometer_csv(n: int = 200, rate_hz: float = 100.0, scale: float = 1.0) -> str:
    time_s = np.arange(n) / rate_hz
    up = scale * (9.81 + 2 * np.sin(2 * np.pi * 2 * time_s))
    return "time_s,x,y,z\n" + "".join(f"{t:.6f},0.1,-0.2,{z:.6g}\n" for t, z in zip(time_s, up, strict=True))


def folder_with(path: Path, **files: str | bytes | None) -> Path:
    """A folder with accelerometer.csv and meta.json, and with the files given by stem; None leaves one out."""
    path.mkdir(parents=True, exist_ok=True)
    for stem, content in {"accelerometer": accelerometer_csv(), "meta": META, **files}.items():
        if content is not None:
            data = content.encode() if isinstance(content, str) else content
            (path / f"{stem}{'.json' if stem == 'meta' else '.csv'}").write_bytes(data)
    return path


def good_members(n: int = 200) -> dict[str, str | bytes]:
    return {"accelerometer.csv": accelerometer_csv(n), "meta.json": META}


def whole_recording() -> Recording:
    rng = np.random.default_rng(0)
    time_s = np.arange(500) / 100
    up = np.array([0.0, 0.0, 9.81])
    location = np.array([[48.123456789, 11.987654321, 519.5, 4.0], [48.123456999, 11.987654999, np.nan, 5.0]])
    truth = Truth(
        position=table({"time_s": time_s, "east_m": time_s, "north_m": -time_s, "up_m": 0 * time_s}),
        waypoints=table({"time_s": [0.0, 4.0], "east_m": [0.0, 5.5], "north_m": [0.0, -1.0], "floor": [0.0, np.nan]}),
        steps=table({"time_s": np.empty(0)}),
        strides=table({"start_s": [0.5], "end_s": [1.5], "length_m": [1.4]}),
        segments=table({"start_s": [0.0], "end_s": [4.0], "distance_m": [np.nan], "n_steps": [8.0]}),
        labels=table({"start_s": [0.0], "end_s": [5.0], "context": ["walking"], "carrying_mode": [""]}),
    )
    return Recording(
        name="round_trip",
        accelerometer=Samples(time_s, up + rng.normal(size=(500, 3))),
        gyroscope=Samples(time_s + 0.003, rng.normal(size=(500, 3))),
        barometer=Samples([0.0, 1.0], [[1013.25], [np.nan]]),
        location=Samples([0.0, 1.0], location),
        truth=truth,
        meta={"dataset": "test", "subject": {"height_m": np.float64(1.75)}},
    )


# ---------------------------------------------------------------- what is read


# Data sets whose truth is waypoints only.
WITHOUT_LABELS = ("ipin2023", "ipin21")
# Data sets with times that repeat or go back, as published: clocks of 10 ms (oxiod, on the floor), a packet that was
# sent twice (ipol), a light sensor that gave one value twice (ipin2023).
WITH_ODD_TIMES = ("oxiod", "ipol", "ipin2023")


def odd_times(path: Path) -> set[str]:
    """The notes that the times of a recording must give, counted in its text."""
    notes: set[str] = set()
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if name.endswith(".csv") and "truth" not in name and name != "wifi.csv":
                rows = archive.read(name).decode().splitlines()[1:]
                interval_s = np.diff([float(row.split(",")[0]) for row in rows])
                repeated, backward = (interval_s == 0).sum(), (interval_s < 0).sum()
                if repeated or backward:
                    notes.add(f"{name}: {repeated} repeated and {backward} backward times, kept as recorded")
    return notes


@pytest.mark.recordings
def test_recordings_of_every_data_set_are_read_whole_and_without_a_note_but_of_odd_times(data_dir: Path) -> None:
    sets = {folder.name: sorted(folder.glob("*.zip")) for folder in sorted(data_dir.iterdir())}
    n = {name: 12 if name in WITH_ODD_TIMES else 2 for name in sets}
    paths = [path for name, of_set in sets.items() for path in of_set[:: max(len(of_set) // n[name], 1)]]
    assert len(paths) > 40
    noted: set[str] = set()
    for path in paths:
        data_set = path.parent.name
        recording = read(path)
        assert recording.name == path.stem
        assert recording.duration_s > 1
        with zipfile.ZipFile(path) as archive:
            files = {Path(name).stem for name in archive.namelist()} - {"meta"}
        heard = set() if recording.wifi is None else {"wifi"}
        truth = {f"truth_{name}" for name in recording.truth.present()}
        assert {*recording.streams, *truth} | heard == files
        assert (recording.truth.labels is not None) == (data_set not in WITHOUT_LABELS), path
        assert set(recording.notes) == (odd_times(path) if data_set in WITH_ODD_TIMES else set()), path
        noted |= {data_set} if recording.notes else set()
    assert noted == set(WITH_ODD_TIMES)


@pytest.mark.parametrize("where", ["", "some folder/"])
def test_a_zip_reads_like_the_folder_it_was_made_of(tmp_path: Path, where: str) -> None:
    folder = folder_with(tmp_path / "walk", gyroscope="time_s,x,y,z\n0.0,1,2,3\n")
    members = {f"{where}{file.name}": file.read_bytes() for file in folder.iterdir()}
    from_zip, from_folder = read(write_zip(tmp_path / "walk.zip", members)), read(folder)
    np.testing.assert_array_equal(from_zip.accelerometer.values, from_folder.accelerometer.values)
    np.testing.assert_array_equal(from_zip.streams["gyroscope"].values, [[1, 2, 3]])
    assert from_zip.name == from_folder.name == "test_s1_walk"
    assert from_zip.subject.height_m == 1.8


@pytest.mark.parametrize("target", ["sub/walk.zip", "sub/walk"])
def test_what_was_written_is_read_back(tmp_path: Path, target: str) -> None:
    written = whole_recording()
    recording = read(write_recording(written, tmp_path / target))
    assert recording.streams.keys() == written.streams.keys()
    for name, samples in written.streams.items():
        np.testing.assert_allclose(recording.streams[name].time_s, samples.time_s, atol=1e-6)
        np.testing.assert_allclose(recording.streams[name].values, samples.values, rtol=1e-6)
    np.testing.assert_allclose(recording.location.values[:, :2], written.location.values[:, :2], rtol=1e-10, atol=1e-7)
    assert recording.truth.present() == written.truth.present()
    assert len(recording.truth.steps) == 0
    for name in written.truth.present():
        ours, theirs = getattr(recording.truth, name), getattr(written.truth, name)
        assert ours.dtype.names == theirs.dtype.names
        for column in ours.dtype.names:
            np.testing.assert_array_equal(ours[column], theirs[column])
    assert recording.truth.labels.carrying_mode[0] == ""
    assert dict(recording.meta) == {"dataset": "test", "subject": {"height_m": 1.75}, "name": "round_trip"}
    assert recording.notes == ()


def test_writing_what_was_read_gives_the_same_bytes(tmp_path: Path) -> None:
    first = write_recording(whole_recording(), tmp_path / "a.zip")
    second = write_recording(read(first), tmp_path / "b.zip")
    assert first.read_bytes() == second.read_bytes()


def test_a_recording_written_over_another_does_not_mix_with_it(tmp_path: Path) -> None:
    write_recording(whole_recording(), tmp_path / "walk")
    only_accelerometer = Recording(name="other", accelerometer=whole_recording().accelerometer)
    assert list(read(write_recording(only_accelerometer, tmp_path / "walk")).streams) == ["accelerometer"]


def test_columns_are_found_by_name_and_others_are_ignored(tmp_path: Path) -> None:
    rows = "".join(f"a,{9.81},{i / 100},0.5,1.5\n" for i in range(50))
    recording = read(folder_with(tmp_path / "w", accelerometer="sensor, z,time_s,x,y\n" + rows))
    np.testing.assert_array_equal(recording.accelerometer.values[0], [0.5, 1.5, 9.81])
    assert recording.accelerometer.time_s[-1] == 0.49


def test_byte_order_mark_and_windows_line_ends_change_nothing(tmp_path: Path) -> None:
    windows = ("\ufeff" + accelerometer_csv()).replace("\n", "\r\n")
    ours = read(folder_with(tmp_path / "a", accelerometer=windows, meta="\ufeff" + META)).accelerometer
    np.testing.assert_array_equal(ours.values, read(folder_with(tmp_path / "b")).accelerometer.values)


def test_empty_fields_are_nan_and_change_no_other_value(tmp_path: Path) -> None:
    lines = accelerometer_csv().splitlines()
    lines[5] = "0.040000,, ,9.5"
    recording = read(folder_with(tmp_path / "w", accelerometer="\n".join(lines)))
    whole = read(folder_with(tmp_path / "v")).accelerometer
    assert np.isnan(recording.accelerometer.values[4, :2]).all()
    assert recording.accelerometer.values[4, 2] == 9.5
    np.testing.assert_array_equal(np.delete(recording.accelerometer.values, 4, 0), np.delete(whole.values, 4, 0))


# ---------------------------------------------------------------- what is repaired or odd, and said in a note


def noted(path: Path) -> tuple[Recording, str]:
    recording = read(path)
    return recording, " | ".join(recording.notes)


def test_a_recording_without_meta_is_named_after_its_file(tmp_path: Path) -> None:
    recording, notes = noted(folder_with(tmp_path / "my_walk", meta=None))
    assert recording.name == "my_walk"
    assert "meta.json is missing" in notes


@pytest.mark.parametrize("name", ["../evil", "a/b", "..", "", 3, "bell\u0007"])
def test_a_name_that_is_no_file_name_is_replaced(tmp_path: Path, name: object) -> None:
    recording, notes = noted(folder_with(tmp_path / "my_walk", meta=json.dumps({"name": name})))
    assert recording.name == "my_walk"
    assert "no usable name" in notes


def test_repeated_and_backward_times_are_kept_and_counted(tmp_path: Path) -> None:
    lines = accelerometer_csv().splitlines()
    lines[10], lines[20], lines[50] = lines[9], lines[19], "0.3,0,0,9.8"
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer="\n".join(lines)))
    assert len(recording.accelerometer) == 200
    assert recording.accelerometer.time_s[49] == 0.3
    assert "accelerometer.csv: 2 repeated and 1 backward times" in notes


@pytest.mark.parametrize(
    "content", ["", "time_s,x,y,z\n", "time_s,x,y,z\n0.0,,,\n0.1,,,\n", "time_s,x,y,z\n0,nan,nan,nan\n"]
)
def test_a_gyroscope_without_values_is_left_out(tmp_path: Path, content: str) -> None:
    recording, notes = noted(folder_with(tmp_path / "w", gyroscope=content))
    assert recording.gyroscope is None
    assert "gyroscope.csv: no values" in notes


@pytest.mark.parametrize("value", ["inf", "-inf", "1e308", "1e999"])
def test_infinite_and_absurd_values_are_unknown(tmp_path: Path, value: str) -> None:
    lines = accelerometer_csv().splitlines()
    lines[7] = f"0.06,{value},0,9.8"
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer="\n".join(lines) + "\n"))
    assert np.isnan(recording.accelerometer.values[6, 0])
    assert notes == "accelerometer.csv: 1 infinite or absurdly large values taken as unknown"


def test_rows_without_a_time_are_left_out(tmp_path: Path) -> None:
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer=accelerometer_csv() + ",0,0,9.8\n,,,\n"))
    assert len(recording.accelerometer) == 200
    assert "2 rows without a time" in notes


def test_a_last_line_that_is_cut_off_is_left_out(tmp_path: Path) -> None:
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer=accelerometer_csv() + "2.00,0.1"))
    assert len(recording.accelerometer) == 200
    assert "last line is cut off" in notes


def test_a_sensor_on_another_clock_is_noted(tmp_path: Path) -> None:
    _, notes = noted(folder_with(tmp_path / "w", barometer="time_s,pressure_hpa\n900,1000\n901,1000\n"))
    assert "barometer.csv: its times do not overlap" in notes


def test_times_that_do_not_begin_at_zero_are_noted(tmp_path: Path) -> None:
    rows = "".join(f"{1.7e9 + i / 100:.6f},0,0,9.8\n" for i in range(50))
    _, notes = noted(folder_with(tmp_path / "w", accelerometer="time_s,x,y,z\n" + rows))
    assert "begins at 1700000000" in notes


def test_a_context_that_the_default_does_not_have_is_kept_and_noted(tmp_path: Path) -> None:
    labels = "start_s,end_s,context,carrying_mode\n0,1,elevator,pocket\n"
    recording, notes = noted(folder_with(tmp_path / "w", truth_labels=labels))
    assert recording.truth.labels.context[0] == "elevator"
    assert "contexts that the default recipe does not have (elevator)" in notes


# ---------------------------------------------------------------- what is refused: file, column, value, remedy


def test_a_path_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    message = refusal(tmp_path / "nothing.zip")
    assert "nothing.zip: no such file" in message
    assert "check the path" in message


def test_an_empty_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "w.zip").write_bytes(b"")
    assert "empty (0 bytes)" in refusal(tmp_path / "w.zip")


def test_a_zip_without_accelerometer_is_refused_with_what_was_found(tmp_path: Path) -> None:
    message = refusal(write_zip(tmp_path / "w.zip", {"photo.jpg": b"x", "gyroscope.csv": "time_s,x,y,z\n"}))
    assert "no accelerometer.csv (found: gyroscope.csv, photo.jpg)" in message


def test_a_folder_without_accelerometer_is_refused_with_what_was_found(tmp_path: Path) -> None:
    assert "no accelerometer.csv (found: meta.json)" in refusal(folder_with(tmp_path / "w", accelerometer=None))


def test_a_zip_with_two_recordings_is_refused(tmp_path: Path) -> None:
    members = {f"{name}/accelerometer.csv": accelerometer_csv() for name in "ab"}
    assert "holds 2 recordings (a, b)" in refusal(write_zip(tmp_path / "w.zip", members))


def test_a_file_that_is_no_zip_is_refused(tmp_path: Path) -> None:
    (tmp_path / "accelerometer.csv").write_text(accelerometer_csv())
    (tmp_path / "meta.json").write_text("{}")
    message = refusal(tmp_path / "accelerometer.csv")
    assert "the folder that holds accelerometer.csv" in message
    (tmp_path / "picture.jpg").write_bytes(bytes(range(256)))
    for text in (message, refusal(tmp_path / "picture.jpg")):
        assert "not a zip file" not in text


def test_a_zip_with_a_changed_byte_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "w.zip", good_members(), compression=zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    data[500] ^= 1
    path.write_bytes(data)
    assert "damaged" in refusal(path)


@pytest.mark.parametrize("column", ["time_s", "x", "z"])
def test_a_missing_column_is_refused_with_the_columns_found(tmp_path: Path, column: str) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv().replace(column, "other", 1)))
    assert f"accelerometer.csv: no column '{column}' (found: " in message
    assert "other" in message


def test_a_column_named_twice_is_refused(tmp_path: Path) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv().replace("y,z", "z,z", 1)))
    assert "no column 'y'" in message
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv().replace("y,z", "y,z,z", 1)))
    assert "2 columns 'z'" in message


@pytest.mark.parametrize("file", ["accelerometer", "gyroscope"])
@pytest.mark.parametrize("text", ["abc", "1_0", "9;8", "0x10", '"1,5"'])
def test_text_in_a_number_column_is_refused_with_line_and_column(tmp_path: Path, file: str, text: str) -> None:
    lines = accelerometer_csv().splitlines()
    lines[6] = f"0.05,0.1,{text},9.8"
    message = refusal(folder_with(tmp_path / "w", **{file: "\n".join(lines) + "\n"}))
    unquoted = text.strip('"')
    assert f"{file}.csv, line 7, column y: {unquoted!r} is not a number" in message


def test_text_in_a_truth_table_is_refused_with_line_and_column(tmp_path: Path) -> None:
    labels = "start_s,end_s,context,carrying_mode\n0,1,walking,pocket\n1,soon,walking,pocket\n"
    message = refusal(folder_with(tmp_path / "w", truth_labels=labels))
    assert "truth_labels.csv, line 3, column end_s: 'soon' is not a number" in message


def test_a_row_with_too_few_fields_is_refused_with_its_line(tmp_path: Path) -> None:
    lines = accelerometer_csv().splitlines()
    lines[6] = "0.05,0.1"
    message = refusal(folder_with(tmp_path / "w", accelerometer="\n".join(lines) + "\n"))
    assert "line 7: only 2 fields ('0.05,0.1')" in message


def test_a_file_that_is_no_utf8_is_refused(tmp_path: Path) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv().encode("utf-16-le")))
    assert "accelerometer.csv: not UTF-8" in message


@pytest.mark.parametrize(
    ("scale", "hint"),
    [(1 / 9.80665, "multiply by 9.80665"), (0.3, "gravity was removed"), (100.0, "about 9.81 at rest")],
)
def test_specific_force_in_wrong_units_is_refused(tmp_path: Path, scale: float, hint: str) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv(scale=scale)))
    assert "accelerometer.csv: median |a| is" in message
    assert hint in message


def test_a_gyroscope_in_degrees_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{i / 100},10,-30,5\n" for i in range(200))
    assert "looks like deg/s" in refusal(folder_with(tmp_path / "w", gyroscope="time_s,x,y,z\n" + rows))


def test_an_accelerometer_without_values_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{i / 100},,nan,\n" for i in range(50))
    message = refusal(folder_with(tmp_path / "w", accelerometer="time_s,x,y,z\n" + rows))
    assert "no values in column x, y, z" in message


@pytest.mark.parametrize("n", [0, 3])
def test_too_few_samples_are_refused_with_their_number(tmp_path: Path, n: int) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv(n)))
    assert f"only {n} samples" in message
    assert "10 are needed; record for longer" in message


def test_an_accelerometer_alone_is_read_whatever_its_file_is_called(tmp_path: Path) -> None:
    for name in ("accelerometer.csv", "walk.csv"):
        (tmp_path / name).write_text(accelerometer_csv())
    ours, theirs = (read(tmp_path / name).accelerometer for name in ("accelerometer.csv", "walk.csv"))
    np.testing.assert_array_equal(ours.values, theirs.values)


def test_reversed_rows_are_sorted_with_a_note(tmp_path: Path) -> None:
    header, *rows = accelerometer_csv().splitlines()
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer="\n".join([header, *reversed(rows)])))
    right = read(folder_with(tmp_path / "right", accelerometer=accelerometer_csv()))
    np.testing.assert_array_equal(recording.accelerometer.values, right.accelerometer.values)
    assert "accelerometer.csv: 199 rows out of order" in notes


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_times_in_another_unit_are_refused_with_that_unit(tmp_path: Path, factor: float, unit: str) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv(rate_hz=100 / factor)))
    assert f"look like {unit}, convert them to seconds" in message


def test_a_rate_of_more_than_2000_hz_is_refused(tmp_path: Path) -> None:
    message = refusal(folder_with(tmp_path / "w", accelerometer=accelerometer_csv(rate_hz=1e4)))
    assert "rate of 1e+04 Hz" in message
    assert "give the times in seconds" in message


@pytest.mark.parametrize("text", ["{", "\x00", "[" * 100_000, '{"a": ' + "9" * 5000 + "}"])
def test_broken_meta_is_refused(tmp_path: Path, text: str) -> None:
    message = refusal(folder_with(tmp_path / "w", meta=text))
    assert "meta.json: not JSON" in message
    assert "correct it or leave the file out" in message


@pytest.mark.parametrize(
    ("meta", "hint"),
    [
        ("[1, 2]", "one object"),
        ('{"subject": "s1"}', "subject is 's1'"),
        ('{"subject": {"height_m": "tall"}}', "height_m is 'tall'"),
        ('{"subject": {"height_m": 180}}', "give it in metres"),
        ('{"subject": {"height_m": NaN}}', "give it in metres"),
        ('{"subject": {"age": true}}', "age is True"),
    ],
)
def test_meta_that_says_nonsense_is_refused(tmp_path: Path, meta: str, hint: str) -> None:
    assert hint in refusal(folder_with(tmp_path / "w", meta=meta))


# ---------------------------------------------------------------- hostile zips


@pytest.mark.parametrize("name", ["../evil.csv", "/etc/evil.csv", "a/../../evil", "..\\evil.csv", "C:\\evil.csv"])
def test_a_member_that_points_outside_the_zip_is_refused(tmp_path: Path, name: str) -> None:
    message = refusal(write_zip(tmp_path / "w.zip", {**good_members(), name: "x"}))
    assert "points outside the zip" in message


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "w.zip", good_members())
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):  # general purpose flags, bit 0
        data[data.index(signature) + offset] |= 1
    path.write_bytes(data)
    assert "accelerometer.csv is encrypted" in refusal(path)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "w.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        with file.open("accelerometer.csv", "w") as member:
            for _ in range(65):
                member.write(b"0" * 2**20)
        file.writestr("meta.json", META)
    assert "times its size" in refusal(path)


def test_a_member_beyond_the_bound_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_MEMBER_BYTES", 1000)
    assert "more than 1000" in refusal(write_zip(tmp_path / "w.zip", good_members()))
    assert "more than 1000" in refusal(folder_with(tmp_path / "w"))


def test_a_member_longer_than_its_header_says_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "w.zip", good_members())
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):  # uncompressed size
        at = data.index(signature) + offset
        data[at : at + 4] = (100).to_bytes(4, "little")
    path.write_bytes(data)
    assert "damaged" in refusal(path)


def test_a_compression_that_unpacks_without_bound_is_refused(tmp_path: Path) -> None:
    assert len(bz2.compress(bytes(10**7))) < 100  # why: a few bytes become megabytes at once
    message = refusal(write_zip(tmp_path / "w.zip", good_members(), compression=zipfile.ZIP_BZIP2))
    assert "pack it again with deflate" in message


# ---------------------------------------------------------------- anything at all


def assert_recording_or_refusal(path: Path) -> None:
    try:
        recording = read(path)
    except RecordingError as error:
        assert path.name in str(error)
    else:
        assert np.isfinite(recording.accelerometer.time_s).all()


FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FUZZ
@given(data=st.data())
def test_a_damaged_zip_gives_a_recording_or_a_refusal(tmp_path: Path, data: st.DataObject) -> None:
    good = write_zip(
        tmp_path / "good.zip", {"accelerometer.csv": accelerometer_csv(20), "meta.json": META}
    ).read_bytes()
    damaged = bytearray(good[: data.draw(st.integers(0, len(good)) | st.just(len(good)))])
    for at, value in data.draw(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), max_size=8)):
        if at < len(damaged):
            damaged[at] = value
    path = tmp_path / "damaged.zip"
    path.write_bytes(bytes(damaged))
    assert_recording_or_refusal(path)


def test_every_single_damaged_header_byte_gives_a_recording_or_a_refusal(tmp_path: Path) -> None:
    good = write_zip(
        tmp_path / "good.zip", {"accelerometer.csv": accelerometer_csv(20), "meta.json": META}
    ).read_bytes()
    directory = good.index(b"PK\x01\x02")
    rng = random.Random(0)
    path = tmp_path / "damaged.zip"
    for at in [*range(50), *range(directory, len(good))]:
        damaged = bytearray(good)
        damaged[at] ^= 1 << rng.randrange(8)
        path.write_bytes(bytes(damaged))
        assert_recording_or_refusal(path)


FIELD = st.sampled_from(
    ["", "0", "-1.5", "9.81", "1e308", "-1e308", "1e-320", "nan", "inf", "x", '"', "\x00", "1_0", "é"]
)
ROW = st.lists(FIELD, max_size=6).map(",".join)


@FUZZ
@given(
    rows=st.lists(ROW, max_size=30),
    header=st.sampled_from(["time_s,x,y,z\n", "z,time_s,x,y,extra\n", "", '"time_s,x\n']),
    end=st.sampled_from(["", "\n", "\r\n", "\r", "\x0b", "\u2028"]),
    tail=st.text(max_size=40),
    n_good=st.sampled_from([0, 30]),
)
def test_any_csv_text_gives_a_recording_or_a_refusal(
    tmp_path: Path, rows: list[str], header: str, end: str, tail: str, n_good: int
) -> None:
    good = "".join(f"{i / 100},0.1,9.7,9.8,1\n" for i in range(n_good))
    text = header + good + (end or "\n").join(rows) + tail
    data = text.encode("utf-8", "surrogatepass")
    assert_recording_or_refusal(folder_with(tmp_path / "a", accelerometer=data))
    assert_recording_or_refusal(folder_with(tmp_path / "b", gyroscope=data, truth_position=data))


@FUZZ
@given(content=st.binary(max_size=200))
def test_any_bytes_give_a_recording_or_a_refusal(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bytes").write_bytes(content)
    assert_recording_or_refusal(tmp_path / "bytes")
    assert_recording_or_refusal(folder_with(tmp_path / "a", accelerometer=content))
    assert_recording_or_refusal(folder_with(tmp_path / "b", meta=content))
    assert_recording_or_refusal(folder_with(tmp_path / "c", truth_labels=content))


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["name", "subject", "height_m"]), inner)
    ),
    max_leaves=8,
)


@FUZZ
@given(meta=JSON)
def test_any_json_gives_a_recording_with_a_subject_or_a_refusal(tmp_path: Path, meta: object) -> None:
    path = folder_with(tmp_path / "w", meta=json.dumps(meta))
    try:
        recording = read(path)
    except RecordingError:
        return
    assert recording.subject.height_m is None or recording.subject.height_m > 0
    assert recording.name.isprintable()


@pytest.mark.parametrize(
    ("meta", "placement", "is_on_foot"),
    [
        ({}, "", False),
        ({"placement": None}, "", False),
        ({"placement": "On the left Foot"}, "on the left foot", True),
        ({"placement": "front trouser pocket"}, "front trouser pocket", False),
    ],
)
def test_the_placement_is_known_from_the_meta_data(meta: dict[str, object], placement: str, is_on_foot: bool) -> None:
    recording = Recording("w", whole_recording().accelerometer, meta=meta)
    assert (recording.placement, recording.is_on_foot) == (placement, is_on_foot)


@pytest.mark.parametrize("block_bytes", [7, 100, 4_000_000])
@pytest.mark.parametrize("is_ended", [True, False])
def test_line_ends_of_any_system_give_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block_bytes: int, is_ended: bool
) -> None:
    monkeypatch.setattr(limits, "BLOCK_BYTES", block_bytes)
    monkeypatch.setattr(limits, "MAX_LINE_BYTES", 200)
    expected = read(folder_with(tmp_path / "a")).accelerometer
    for i, line_end in enumerate(("\r", "\r\n", "\n\r")):
        text = accelerometer_csv().rstrip().replace("\n", line_end) + (line_end if is_ended else "")
        found = read(folder_with(tmp_path / str(i), accelerometer=text))
        np.testing.assert_array_equal(found.accelerometer.values, expected.values)
        assert found.notes == ()


def test_a_table_larger_than_a_block_loses_no_row_where_it_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = "start_s,end_s,context,carrying_mode\n" + "".join(f"{i},{i + 1},walking,\n" for i in range(50))
    path = folder_with(tmp_path / "w", truth_labels=labels)
    expected = read(path)
    monkeypatch.setattr(limits, "BLOCK_BYTES", 101)
    found = read(path)
    np.testing.assert_array_equal(found.accelerometer.time_s, expected.accelerometer.time_s)
    np.testing.assert_array_equal(found.accelerometer.values, expected.accelerometer.values)
    assert (found.truth.labels == expected.truth.labels).all()


def test_a_fault_in_a_later_block_is_named_by_its_line_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = accelerometer_csv().splitlines()
    lines[149] = "1.48,0.1,abc,9.8"
    for line_end in ("\n", "\r\n"):
        for block_bytes in (1, 101):  # of one byte, so that a piece ends between the two of a line end
            monkeypatch.setattr(limits, "BLOCK_BYTES", block_bytes)
            path = folder_with(tmp_path / "w", accelerometer=line_end.join(lines) + line_end)
            assert "line 150, column y: 'abc'" in refusal(path)
    lines[149] = "1.48,0.1,\udce9,9.8"
    data = ("\n".join(lines) + "\n").encode("utf-8", "surrogateescape")
    assert "line 150: not UTF-8 text (byte 0xe9)" in refusal(folder_with(tmp_path / "v", accelerometer=data))


def test_a_recording_that_was_saved_is_read_as_it_was(tmp_path: Path) -> None:
    from pdr_filter.simulate import demo_walk

    walk = demo_walk()
    again = read(walk.save(tmp_path / "walk.zip"))
    np.testing.assert_allclose(again.accelerometer.values, walk.accelerometer.values, rtol=1e-6, atol=1e-6)
    assert again.subject == walk.subject
