"""The reading report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import a_walk, metadata, sensor_logger_files, write_folder

from pdr_filter.data.io.describe import describe, reading_report
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording


def test_a_report_counts_gaps_repeated_and_backward_times() -> None:
    time_s = np.concatenate([np.arange(100), np.arange(200, 300), [299, 298]]) / 100
    samples = Samples(time_s, np.tile([0.0, 0.0, 9.81], (len(time_s), 1)))
    (stream,) = reading_report(Recording("w", samples, meta={"nominal_rate_hz": 100})).streams
    assert (stream.n_gaps, stream.n_duplicates, stream.n_backward) == (1, 1, 1)
    assert stream.longest_gap_s == pytest.approx(1.01)
    assert "100.0 Hz requested" in stream.sentence()
    assert "1 gap (longest 1.01 s), 1 repeated and 1 backward times" in stream.sentence()


def test_a_report_is_plain_and_survives_being_written(tmp_path: Path) -> None:
    files = sensor_logger_files(a_walk(), "ios")
    files["Metadata.csv"] = metadata("ios", period_ms=5)
    recording = read(write_folder(tmp_path / "w", files))
    report = reading_report(recording)
    plain = report.as_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    again = reading_report(read(write_recording(recording, tmp_path / "own.zip")))
    assert (again.source, again.found, again.clock) == (report.source, report.found, report.clock)
    assert [s.requested_hz for s in again.streams] == [s.requested_hz for s in report.streams] == [200, 200, 200]
    assert report.lines()[0] == "read as Sensor Logger 1.64 (ios)"


def test_the_description_has_the_requested_rates_of_the_report() -> None:
    recording = replace(a_walk(), meta={"nominal_rate_hz": 400})
    assert describe(recording).streams == reading_report(recording).streams
    assert [stream.requested_hz for stream in describe(recording).streams] == [400, None, None]
    assert describe(recording).streams[0].is_slow


@pytest.mark.parametrize(
    "said", [None, [], "x", {"found": "x", "requested_hz": 3}, {"requested_hz": {"accelerometer": "x"}}]
)
def test_nonsense_in_the_meta_data_of_a_file_is_no_report(said: object) -> None:
    recording = replace(a_walk(), meta={"reading": said})
    report = reading_report(recording)
    assert report.source == "own format"
    assert report.streams[0].requested_hz is None
