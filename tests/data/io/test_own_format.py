"""The project's own format: what is read, what is repaired with a note, what is refused and how it is said."""

from __future__ import annotations

import bz2
import json
import random
import zipfile
from itertools import groupby
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


def test_notes_of_a_reader_are_saved_and_read_once(tmp_path: Path) -> None:
    time_s = np.arange(200) / 100
    time_s[100:] -= 0.5
    notes = ("nothing shows the sign", "accelerometer: 0 repeated and 1 backward times, kept as recorded")
    walk = Recording("walk", Samples(time_s, np.tile([0.1, 0.2, 9.8], (200, 1))), notes=notes)
    once = read(walk.save(tmp_path / "once.zip"))
    assert once.notes == (notes[0], notes[1].replace(":", ".csv:"))
    twice = read(once.save(tmp_path / "twice.zip"))
    assert (twice.notes, twice.meta) == (once.notes, once.meta)


@pytest.mark.parametrize(("gap_s", "n"), [(3600.01, 1), (3590.0, 0)])
def test_a_gap_of_an_hour_may_be_the_change_to_daylight_saving_time(tmp_path: Path, gap_s: float, n: int) -> None:
    time_s = np.arange(200) / 100
    time_s[100:] += gap_s - 0.01
    walk = Recording("walk", Samples(time_s, np.tile([0.1, 0.2, 9.8], (200, 1))))
    found = read(walk.save(tmp_path / "walk.zip")).notes
    assert sum("gap of an hour after 1.0 s" in note and "daylight saving" in note for note in found) == n


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
    paths = sorted(Path(data_dir).glob("*/*.zip"))
    if not paths:
        pytest.skip(f"no recordings at {data_dir}")
    sets = {name: list(of_set) for name, of_set in groupby(paths, lambda path: path.parent.name)}
    n = {name: 12 if name in WITH_ODD_TIMES else 2 for name in sets}
    paths = [path for name, of_set in sets.items() for path in of_set[:: max(len(of_set) // n[name], 1)]]
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
    assert noted == sets.keys() & WITH_ODD_TIMES


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


def with_rows(*rows: str) -> str:
    """Samples of the accelerometer with other rows in place of the first ones."""
    return "\n".join(["time_s,x,y,z", *rows, *accelerometer_csv().splitlines()[1 + len(rows) :], ""])


NOTED: dict[str, tuple[dict[str, str | None], int, str]] = {
    "no meta": ({"meta": None}, 200, "meta.json is missing"),
    "repeated and backward times": (
        {"accelerometer": with_rows(*(f"0.0{i},0,0,9.8" for i in (0, 1, 1, 2, 2, 1)))},
        200,
        "accelerometer.csv: 2 repeated and 1 backward times",
    ),
    "rows without a time": ({"accelerometer": accelerometer_csv() + ",0,0,9.8\n,,,\n"}, 200, "2 rows without a time"),
    "a last line that is cut off": ({"accelerometer": accelerometer_csv() + "2.00,0.1"}, 200, "last line is cut off"),
    "a sensor on another clock": (
        {"barometer": "time_s,pressure_hpa\n900,1000\n901,1000\n"},
        200,
        "barometer.csv: its times do not overlap",
    ),
    "times that do not begin at zero": (
        {"accelerometer": "time_s,x,y,z\n" + "".join(f"{1.7e9 + i / 100:.6f},0,0,9.8\n" for i in range(50))},
        50,
        "begins at 1700000000",
    ),
}


@pytest.mark.parametrize("kind", NOTED)
def test_what_is_odd_is_kept_or_left_out_with_a_note(tmp_path: Path, kind: str) -> None:
    files, n, words = NOTED[kind]
    recording, notes = noted(folder_with(tmp_path / "my_walk", **files))
    assert (recording.name, len(recording.accelerometer)) == ("my_walk" if kind == "no meta" else "test_s1_walk", n)
    assert words in notes


@pytest.mark.parametrize("name", ["../evil", "a/b", "..", "", 3, "bell\u0007"])
def test_a_name_that_is_no_file_name_is_replaced(tmp_path: Path, name: object) -> None:
    recording, notes = noted(folder_with(tmp_path / "my_walk", meta=json.dumps({"name": name})))
    assert recording.name == "my_walk"
    assert "no usable name" in notes


@pytest.mark.parametrize(
    "content", ["", "time_s,x,y,z\n", "time_s,x,y,z\n0.0,,,\n0.1,,,\n", "time_s,x,y,z\n0,nan,nan,nan\n"]
)
def test_a_gyroscope_without_values_is_left_out(tmp_path: Path, content: str) -> None:
    recording, notes = noted(folder_with(tmp_path / "w", gyroscope=content))
    assert recording.gyroscope is None
    assert "gyroscope.csv: no values" in notes


@pytest.mark.parametrize("value", ["inf", "-inf", "1e308", "1e999"])
def test_infinite_and_absurd_values_are_unknown(tmp_path: Path, value: str) -> None:
    recording, notes = noted(folder_with(tmp_path / "w", accelerometer=with_rows(f"0.0,{value},-0.2,9.8")))
    assert np.isnan(recording.accelerometer.values[0, 0])
    assert notes == "accelerometer.csv: 1 infinite or absurdly large values taken as unknown"


def test_a_context_that_the_default_does_not_have_is_kept_and_noted(tmp_path: Path) -> None:
    labels = "start_s,end_s,context,carrying_mode\n0,1,elevator,pocket\n"
    recording, notes = noted(folder_with(tmp_path / "w", truth_labels=labels))
    assert recording.truth.labels.context[0] == "elevator"
    assert "contexts that the default recipe does not have (elevator)" in notes


# ---------------------------------------------------------------- what is refused: file, column, value, remedy


REFUSED: dict[str, tuple[dict[str, str | bytes | None], str]] = {
    "no accelerometer": ({"accelerometer": None}, "no accelerometer.csv (found: meta.json)"),
    "no column x": (
        {"accelerometer": accelerometer_csv().replace("x", "other", 1)},
        "accelerometer.csv: no column 'x' (found: time_s, other, y, z)",
    ),
    "no column of times": (
        {"accelerometer": accelerometer_csv().replace("time_s", "other", 1)},
        "accelerometer.csv: no column 'time_s' (found: other, x, y, z)",
    ),
    "a column twice": ({"accelerometer": accelerometer_csv().replace("y,z", "y,z,z", 1)}, "2 columns 'z'"),
    "text in a truth table": (
        {"truth_labels": "start_s,end_s,context,carrying_mode\n0,1,walking,pocket\n1,soon,walking,pocket\n"},
        "truth_labels.csv, line 3, column end_s: 'soon' is not a number",
    ),
    "too few fields": ({"accelerometer": with_rows("0,0,0,9.8", "0.01,0.1")}, "line 3: only 2 fields ('0.01,0.1')"),
    "no UTF-8": ({"accelerometer": accelerometer_csv().encode("utf-16-le")}, "accelerometer.csv: not UTF-8"),
    "g": ({"accelerometer": accelerometer_csv(scale=1 / 9.80665)}, "multiply by 9.80665"),
    "less than gravity": ({"accelerometer": accelerometer_csv(scale=0.3)}, "gravity was removed"),
    "more than gravity": ({"accelerometer": accelerometer_csv(scale=100.0)}, "about 9.81 at rest"),
    "degrees": (
        {"gyroscope": "time_s,x,y,z\n" + "".join(f"{i / 100},10,-30,5\n" for i in range(200))},
        "looks like deg/s",
    ),
    "no values": (
        {"accelerometer": "time_s,x,y,z\n" + "".join(f"{i / 100},,nan,\n" for i in range(50))},
        "no values in column x, y, z",
    ),
    "no samples": ({"accelerometer": accelerometer_csv(0)}, "only 0 samples"),
    "few samples": ({"accelerometer": accelerometer_csv(3)}, "and 10 are needed; record for longer"),
    "ms": ({"accelerometer": accelerometer_csv(rate_hz=0.1)}, "look like milliseconds, convert them to seconds"),
    "us": ({"accelerometer": accelerometer_csv(rate_hz=1e-4)}, "look like microseconds, convert them to seconds"),
    "ns": ({"accelerometer": accelerometer_csv(rate_hz=1e-7)}, "look like nanoseconds, convert them to seconds"),
    "a high rate": ({"accelerometer": accelerometer_csv(rate_hz=1e4)}, "rate of 1e+04 Hz"),
    "half an object": ({"meta": "{"}, "meta.json: not JSON"),
    "a zero byte": ({"meta": "\x00"}, "meta.json: not JSON"),
    "deep JSON": ({"meta": "[" * 100_000}, "correct it or leave the file out"),
    "a long number": ({"meta": '{"a": ' + "9" * 5000 + "}"}, "meta.json: not JSON"),
    "no object": ({"meta": "[1, 2]"}, "one object"),
    "a subject that is a text": ({"meta": '{"subject": "s1"}'}, "subject is 's1'"),
    "a height that is a text": ({"meta": '{"subject": {"height_m": "tall"}}'}, "height_m is 'tall'"),
    "a height in centimetres": ({"meta": '{"subject": {"height_m": 180}}'}, "give it in metres"),
    "a height that is not a number": ({"meta": '{"subject": {"height_m": NaN}}'}, "give it in metres"),
    "an age that is true": ({"meta": '{"subject": {"age": true}}'}, "age is True"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_folder_with_a_fault_is_refused_with_the_file_and_the_remedy(tmp_path: Path, kind: str) -> None:
    files, words = REFUSED[kind]
    assert words in refusal(folder_with(tmp_path / "w", **files))


def test_a_zip_without_accelerometer_is_refused_with_what_was_found(tmp_path: Path) -> None:
    message = refusal(write_zip(tmp_path / "w.zip", {"photo.jpg": b"x", "gyroscope.csv": "time_s,x,y,z\n"}))
    assert "no accelerometer.csv (found: gyroscope.csv, photo.jpg)" in message


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


@pytest.mark.parametrize("file", ["accelerometer", "gyroscope"])
@pytest.mark.parametrize("text", ["abc", "1_0", "9;8", "0x10", '"1,5"'])
def test_text_in_a_number_column_is_refused_with_line_and_column(tmp_path: Path, file: str, text: str) -> None:
    message = refusal(folder_with(tmp_path / "w", **{file: with_rows("0,0.1,0.1,9.8", f"0.01,0.1,{text},9.8")}))
    unquoted = text.strip('"')
    assert f"{file}.csv, line 3, column y: {unquoted!r} is not a number" in message


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


# ---------------------------------------------------------------- hostile zips


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "w.zip", good_members())
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):  # general purpose flags, bit 0
        data[data.index(signature) + offset] |= 1
    path.write_bytes(data)
    assert "accelerometer.csv is encrypted" in refusal(path)


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


def test_every_single_damaged_header_byte_gives_a_recording_or_a_refusal(tmp_path: Path) -> None:
    good = write_zip(tmp_path / "good.zip", good_members(20)).read_bytes()
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
