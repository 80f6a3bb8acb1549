"""What the description of a recording contains."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from pdr_filter.data.io.describe import StreamDescription, describe, describe_stream, median_norm
from pdr_filter.values import Samples, table
from pdr_filter.values.recording import Recording, Truth


def at_rest(time_s: np.ndarray, norm: float = 9.81) -> Samples:
    return Samples(time_s, np.tile([0.0, 0.0, norm], (len(time_s), 1)))


def recording(**changes: object) -> Recording:
    return replace(Recording(name="w", accelerometer=at_rest(np.arange(1001) / 100)), **changes)


def accelerometer(time_s: np.ndarray) -> StreamDescription:
    return describe_stream("accelerometer", at_rest(np.asarray(time_s, dtype=float)))


def test_duration_and_rate_are_those_without_a_backward_clock_jump() -> None:
    time_s = np.arange(1001) / 100
    values = np.random.default_rng(0).normal([0.0, 0.0, 9.81], 0.1, (1001, 3))
    back = recording(accelerometer=Samples(time_s - 3600.0 * (time_s > 5.0), values))
    found = describe(back)
    assert found.duration_s == pytest.approx(10.0)
    (stream,) = found.streams
    assert (stream.mean_rate_hz, stream.n_backward) == (pytest.approx(100.0), 1)


def test_a_regular_stream_has_its_rate_and_no_oddities() -> None:
    found = accelerometer(np.arange(1001) / 100)
    assert found.n_samples == 1001
    assert found.unit == "m/s2"
    assert found.rate_hz == pytest.approx(100)
    assert found.mean_rate_hz == pytest.approx(100)
    assert (found.first_s, found.last_s) == (0.0, 10.0)
    assert (found.n_gaps, found.longest_gap_s, found.n_duplicates, found.n_backward, found.n_missing_rows) == (0,) * 5


def test_gaps_lower_the_mean_rate_but_not_the_rate() -> None:
    time_s = np.arange(1001) / 100
    found = accelerometer(time_s[(time_s < 2) | (time_s > 4) & (time_s < 6) | (time_s > 6.5)])
    assert found.n_gaps == 2
    assert found.longest_gap_s == pytest.approx(2.02)
    assert found.rate_hz == pytest.approx(100)
    assert found.mean_rate_hz is not None
    assert found.mean_rate_hz < 80


def test_an_interval_of_exactly_the_limit_is_no_gap() -> None:
    assert accelerometer(np.array([0.0, 0.01, 0.02, 0.32])).n_gaps == 0
    assert accelerometer(np.array([0.0, 0.01, 0.02, 0.33])).n_gaps == 1


def test_a_slow_sensor_has_a_gap_only_where_samples_are_missing() -> None:
    assert accelerometer(np.arange(10)).n_gaps == 0
    assert accelerometer(np.array([0, 1, 2, 5, 6])).n_gaps == 1


def test_repeated_and_backward_times_are_counted() -> None:
    found = accelerometer(np.array([0.0, 0.01, 0.01, 0.01, 0.02, 0.015, 0.03]))
    assert (found.n_duplicates, found.n_backward) == (2, 1)


def test_rows_with_an_empty_value_are_counted_once() -> None:
    values = np.full((4, 3), 9.0)
    values[1] = np.nan
    values[2, 0] = np.nan
    assert describe_stream("gyroscope", Samples(np.arange(4.0), values)).n_missing_rows == 2


def test_a_stream_lasts_from_the_first_to_the_last_row_with_a_value() -> None:
    values = np.full((6, 3), np.nan)
    values[1:4, 0] = 9.0
    found = describe_stream("gyroscope", Samples(np.arange(6.0), values))
    assert (found.first_s, found.last_s) == (1.0, 3.0)


def test_a_column_without_values_makes_no_row_incomplete() -> None:
    values = np.full((3, 4), 9.0)
    values[:, 2] = np.nan
    values[1, 0] = np.nan
    assert describe_stream("location", Samples(np.arange(3.0), values)).n_missing_rows == 1


@pytest.mark.parametrize("n", [0, 1])
def test_one_sample_or_none_has_no_rate(n: int) -> None:
    found = accelerometer(np.zeros(n))
    assert found.rate_hz is None
    assert found.mean_rate_hz is None
    assert (found.first_s is None) == (n == 0)


def test_units_are_said_to_be_plausible_or_not() -> None:
    time_s = np.arange(1001) / 100
    good, weak = describe(recording(magnetometer=at_rest(time_s, 48.0))), recording(magnetometer=at_rest(time_s, 0.48))
    assert good.units == (
        "accelerometer: median |specific force| 9.81 m/s2, plausible",
        "magnetometer: median |magnetic field| 48 uT, plausible",
    )
    assert describe(weak).units[1] == "magnetometer: median |magnetic field| 0.48 uT, not plausible, expected 20 to 80"


def test_stuck_and_coarse_sensors_are_named() -> None:
    time_s, rng = np.arange(0.0, 20.0, 0.01), np.random.default_rng(0)
    force, rate = 9.81 + rng.normal(size=(2000, 3)), rng.normal(size=(2000, 3))
    whole = recording(accelerometer=Samples(time_s, force), gyroscope=Samples(time_s, rate))
    assert describe(whole).notes == ()
    force[1000:] = force[1000]
    stuck = replace(whole, accelerometer=Samples(time_s, force))
    assert [n.partition(" while")[0] for n in describe(stuck).notes] == [
        "an axis of the accelerometer was stuck at one value"
    ]
    pressure = Samples(time_s, 1000.0 + np.round(time_s[:, None] / 5.0) * 0.5)
    assert [n.partition(";")[0] for n in describe(replace(whole, barometer=pressure)).notes] == [
        "heights and stairs are uncertain: the pressure is rounded to 0.5 hPa"
    ]


def test_median_norm_leaves_out_incomplete_rows_and_bears_absurd_values() -> None:
    assert median_norm(np.array([[3.0, 4.0], [np.nan, 100.0], [1e308, 1e308], [3.0, 4.0]])) == 5.0
    assert math.isnan(median_norm(np.full((2, 3), np.nan)))
    assert math.isnan(median_norm(np.empty((0, 3))))


def test_a_description_is_plain_and_json_can_write_it() -> None:
    truth = Truth(steps=table({"time_s": [1.0, 2.0]}), labels=table({"start_s": np.empty(0), "end_s": np.empty(0)}))
    description = describe(recording(truth=truth, notes=("odd",), gyroscope=Samples([0.0], [[0.0, 0.0, 0.0]])))
    assert description.duration_s == 10.0
    assert description.truth_rows == {"steps": 2, "labels": 0}
    plain = description.as_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert [stream["name"] for stream in plain["streams"]] == ["accelerometer", "gyroscope"]
    assert plain["notes"][0] == "odd"
    assert [note[:27] for note in plain["notes"][1:]] == ["gyroscope: no samples since"]
