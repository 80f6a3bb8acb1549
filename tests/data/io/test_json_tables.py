"""Tables in JSON: SensorLog's, and what people write."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from app_files import a_walk, assert_same_streams, on_one_clock, refusal, write_zip

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_guessed, read_mapped
from pdr_filter.data.io.tables.column_mapping import read_mapping
from pdr_filter.values import STANDARD_GRAVITY_MPS2

WALK = on_one_clock(a_walk(50.0))
TIME_S, FORCE = WALK.accelerometer.time_s.tolist(), WALK.accelerometer.values
RATE = WALK.gyroscope.values
GRAVITY = FORCE.mean(axis=0)
BOTH = "accelerometer gyroscope"
Row = dict[str, Any]


def axes(names: str, values: np.ndarray) -> Row:
    return {names.replace("%", axis): v for axis, v in zip("XYZ", values.tolist(), strict=True)}


def sensorlog_row(t: float, force: np.ndarray, rate: np.ndarray, raw: bool = True) -> Row:
    """As the app writes them: every value a text, in g with Apple's sign, a clock for each kind of sensor."""
    row: Row = {
        "loggingTime": str(np.datetime64("2021-04-09T12:31:12.000000") + np.timedelta64(round(t * 1e6), "us"))
        + "+0200",
        "logSampleNr": 1,
        "locationTimestamp_since1970": 1617964271.999422,
        "locationLatitude": 52.1,
        "locationLongitude": 13.4,
        "motionTimestamp_sinceReboot": 174394.5 + t,
        "motionAttitudeReferenceFrame": "XMagneticNorthZVertical",
        "magnetometerX": -4.2,
        "magnetometerY": -28.4,
        "magnetometerZ": -254.1,
        "altimeterPressure": None,
        **axes("motionRotationRate%", rate),
        **axes("motionUserAcceleration%", -(force - GRAVITY) / STANDARD_GRAVITY_MPS2),
        **axes("motionGravity%", -GRAVITY / STANDARD_GRAVITY_MPS2),
        **axes("motionMagneticField%", np.array([20.0, 5.0, -43.0])),
    }
    if raw:
        row["accelerometerTimestamp_sinceReboot"] = 174394.5 + t
        row |= axes("accelerometerAcceleration%", -force / STANDARD_GRAVITY_MPS2)
    return {key: value if value is None else str(value) for key, value in row.items()}


def sensorlog(raw: bool = True) -> list[Row]:
    return [sensorlog_row(t, f, w, raw) for t, f, w in zip(TIME_S, FORCE, RATE, strict=True)]


def xyz(values: np.ndarray) -> Row:
    return dict(zip("xyz", values.tolist(), strict=True))


def lines(rows: list[Row]) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)


def columns() -> Row:
    """An array for each column, numbers as numbers."""
    rows = sensorlog()
    plain = ("loggingTime", "motionAttitudeReferenceFrame", "altimeterPressure")
    return {key: [row[key] if key in plain else float(row[key]) for row in rows] for key in rows[0]}


CASES: dict[str, Callable[[], str]] = {
    "SensorLog, array": lambda: json.dumps(sensorlog(), indent=1),
    "SensorLog, lines": lambda: lines(sensorlog()),
    "SensorLog, motion only": lambda: lines(sensorlog(raw=False)),
    "SensorLog, an array for each column": lambda: json.dumps(columns()),
    "SensorLog, no clock but that of the rows": lambda: lines(
        [{key: value for key, value in row.items() if "Timestamp" not in key} for row in sensorlog()]
    ),
    "objects in objects": lambda: json.dumps(
        {
            "device": {"model": "Some Phone"},
            "data": [
                {"timestamp": 1.6e12 + 1000 * t, "accelerometer": xyz(f), "gyroscope": w.tolist()}
                for t, f, w in zip(TIME_S, FORCE, RATE, strict=True)
            ],
        }
    ),
    "an array for each sensor": lambda: json.dumps(
        {
            "accelerometer": [{"t": t, **xyz(f)} for t, f in zip(TIME_S, FORCE, strict=True)],
            "gyroscope": [{"t": t, **xyz(w)} for t, w in zip(TIME_S, RATE, strict=True)],
        }
    ),
    "a row for each sample of any sensor": lambda: lines(
        [
            {"type": kind, "time_ns": 1_787_923_304_123_456_789 + round(t * 1e9), "values": values.tolist()}
            for t, f, w in zip(TIME_S, FORCE, RATE, strict=True)
            for kind, values in (("ACCELEROMETER", f), ("GYROSCOPE", w))
        ]
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_walk_comes_back(tmp_path: Path, case: str) -> None:
    text = CASES[case]()
    (tmp_path / "walk.json").write_text(text)
    recording = read(tmp_path / "walk.json")
    assert_same_streams(recording, WALK, BOTH, time_s=2e-4 if "1.6e12" in text else 2e-6, rtol=1e-6)
    assert recordings_in(tmp_path) == [tmp_path / "walk.json"]
    assert_same_streams(read(write_zip(tmp_path / "w.zip", {"a.json": text})), WALK, BOTH, time_s=2e-6, rtol=1e-6)
    found = read_guessed(tmp_path / "walk.json")
    (tmp_path / "map.toml").write_text(found.guess.mapping.toml())
    again = read_mapped(tmp_path / "walk.json", read_mapping(tmp_path / "map.toml"))
    for name, samples in again.streams.items():
        np.testing.assert_array_equal(samples.values, recording.streams[name].values)
    if "SensorLog" in case:
        assert "SensorLog" in reading_report(recording).source
        # of two magnetometers the one without the phone's own magnets, and a place that is on another clock
        np.testing.assert_allclose(recording.magnetometer.values[0], [20.0, 5.0, -43.0])
        assert recording.location.time_s.tolist() == [0.0]


def test_what_is_cut_off_is_left_out_with_a_note(tmp_path: Path) -> None:
    for text in (lines(sensorlog())[:-99], json.dumps(sensorlog())[:-99]):
        (tmp_path / "walk.json").write_text(text)
        recording = read(tmp_path / "walk.json")
        assert len(recording.accelerometer) == len(TIME_S) - 1
        assert any(f"cut off behind {len(TIME_S) - 1:,} objects" in note for note in recording.notes)
    (tmp_path / "walk.json").write_text(json.dumps(sensorlog())[:-1])  # behind the last object
    assert any(f"cut off behind {len(TIME_S):,} objects" in note for note in read(tmp_path / "walk.json").notes)


def test_json_of_something_else_is_refused_with_what_was_seen(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    path.write_text(json.dumps([{"heart_rate": 60 + i, "speed": 1.5} for i in range(99)]))
    assert "Columns seen: heart_rate, speed" in refusal(path)
    path.write_text(json.dumps({"hello": "you"}))
    assert "not recognised as a recording" in refusal(path)
    path.write_text(json.dumps(columns())[:-9])
    assert "damaged or cut off" in refusal(path)
    for text in ("[" * 100_000, '{"a":' * 100_000):
        path.write_text(text)
        assert "not recognised as a recording" in refusal(path)
    path.write_text(lines([{f"c{i}": 1.0 for i in range(2000)}] * 20))
    assert "columns" in refusal(path)
