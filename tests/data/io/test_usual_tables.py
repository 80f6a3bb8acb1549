"""Usual tables that look like odd ones are read as what they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from app_files import assert_same_streams, axes, refusal, table_text, wall_clock
from table_cases import FORCE, RATE, TIME_S, WALK

from pdr_filter.data.io.column_names import column_of
from pdr_filter.data.io.formats import read
from pdr_filter.values import STANDARD_GRAVITY_MPS2

N = len(TIME_S)
MS = np.round(1000 * TIME_S) + 100_000
BOTH = axes("acc_%", FORCE) | axes("gyro_%", RATE)


def write(folder: Path, text: str, name: str = "walk.csv") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_times_in_the_order_of_arrival_are_no_times_between_samples(tmp_path: Path) -> None:
    swapped = np.arange(N)
    swapped[5:-1:14], swapped[6::14] = swapped[6::14].copy(), swapped[5:-1:14].copy()
    columns = {"timestamp": MS} | BOTH
    path = write(tmp_path, table_text({name: values[swapped] for name, values in columns.items()}))
    np.testing.assert_allclose(np.sort(read(path).accelerometer.time_s), TIME_S, atol=1e-3)


def test_a_minus_sign_of_unicode_is_a_minus(tmp_path: Path) -> None:
    text = table_text({"timestamp": MS} | BOTH)
    plain, fancy = (read(write(tmp_path, t, n)) for t, n in ((text, "a.csv"), (text.replace("-", "\u2212"), "b.csv")))
    np.testing.assert_array_equal(fancy.accelerometer.values, plain.accelerometer.values)


def test_a_time_that_a_spreadsheet_rounded_to_a_constant_is_no_time_between_samples(tmp_path: Path) -> None:
    assert "the times may be rounded" in refusal(write(tmp_path, table_text({"timestamp": ["1E+05"] * N} | BOTH)))


@pytest.mark.parametrize(
    "more",
    [
        {"date": [f"2024-05-01 10:00:{t:09.6f}" for t in TIME_S], "gps": ["52.10 13.20"] * N},
        {"date": [f"01/05/2024 10:00:{t:09.6f}" for t in TIME_S], "gps": ["52.10/13.20"] * N},
        {"t": TIME_S, "activity": ["walking fast"] * N, "gps": ["52.10 13.20"] * N},
        {"t": TIME_S, "gps": ["52.10 13.20", "", *["52.10 13.20"] * (N - 2)]},
    ],
)
def test_numbers_in_one_field_leave_the_other_columns_as_they_are(
    tmp_path: Path, more: dict[str, np.ndarray | list[str]]
) -> None:
    recording = read(write(tmp_path, table_text(more | BOTH)))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=2e-6, rtol=1e-12)


def test_a_mark_between_thousands_is_none_between_numbers(tmp_path: Path) -> None:
    text = table_text({"Zeit": TIME_S} | BOTH | {"Luftdruck": ["1.013,25"] * N}, ";", ",")
    assert_same_streams(read(write(tmp_path, text)), WALK, "accelerometer gyroscope", time_s=1e-9, rtol=1e-12)


def test_counts_beside_an_acceleration_with_gravity_are_left_out(tmp_path: Path) -> None:
    path = write(tmp_path, table_text({"timestamp_ms": MS} | BOTH | axes("acc_raw_%", 835 * FORCE)))
    assert_same_streams(read(path), WALK, "accelerometer gyroscope", time_s=1e-3, rtol=1e-12)


UPRIGHT = FORCE @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # z up becomes y up


def upright(force: np.ndarray, pitch_rad: float) -> str:
    angles = zip(("roll", "pitch", "yaw"), (0.0, pitch_rad, 0.3), strict=True)
    attitude = {f"attitude_{name}": np.full(N, value) for name, value in angles}
    return table_text({"t": TIME_S} | axes("acc_%", force) | axes("gyro_%", RATE) | attitude)


def test_the_attitude_of_an_upright_iphone_shows_the_sign_of_an_acceleration_in_g(tmp_path: Path) -> None:
    recording = read(write(tmp_path, upright(-UPRIGHT / STANDARD_GRAVITY_MPS2, 1.4)))
    np.testing.assert_allclose(recording.accelerometer.values, UPRIGHT, rtol=1e-12)


@pytest.mark.parametrize("platform", [None, "android"])
def test_a_pitch_with_the_sign_of_android_does_not_mirror_an_upright_phone(
    tmp_path: Path, platform: str | None
) -> None:
    recording = read(write(tmp_path, upright(UPRIGHT, -1.4)), platform=platform)
    np.testing.assert_allclose(recording.accelerometer.values, UPRIGHT, rtol=1e-12)
    assert any("nothing in the file shows its sign" in note for note in recording.notes) == (platform is None)


@pytest.mark.parametrize(("name", "quantity"), [("lat_m", ""), ("lon (m)", ""), ("lat_deg", "latitude")])
def test_a_latitude_is_not_in_metres(name: str, quantity: str) -> None:
    assert column_of(0, name).quantity == quantity


@pytest.mark.parametrize("sizes", [[1], [1, 2, 3]])
def test_packets_of_one_sample_for_each_axis_are_read(tmp_path: Path, sizes: list[int]) -> None:
    packets: list[dict[str, object]] = []
    end = 0
    while end < 60:
        begin, end = end, end + sizes[len(packets) % len(sizes)]
        samples = dict(zip(("accX", "accY", "accZ"), FORCE[begin:end].T.tolist(), strict=True))
        packets.append({"timestamp": MS[begin] - MS[0], **samples})
    path = write(tmp_path, json.dumps(packets), "walk.json")
    np.testing.assert_array_equal(read(path).accelerometer.values, FORCE[:end])


def test_a_list_of_times_belongs_to_the_lists_of_the_same_length_beside_it(tmp_path: Path) -> None:
    force, rate = FORCE.tolist(), RATE.tolist()
    damaged = {"time": TIME_S.tolist(), "acc": [*force[:7], [1.0], *force[8:]], "gyro": rate}
    recording = read(write(tmp_path, json.dumps(damaged), "walk.json"))
    np.testing.assert_allclose(recording.accelerometer.time_s, np.delete(TIME_S, 7), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(recording.accelerometer.values, np.delete(FORCE, 7, axis=0))
    np.testing.assert_array_equal(recording.gyroscope.values, RATE)
    inside = {"time": TIME_S.tolist(), "acc": dict(zip("xyz", FORCE.T.tolist(), strict=True))}
    recording = read(write(tmp_path, json.dumps(inside), "inside.json"))
    np.testing.assert_array_equal(recording.accelerometer.values, FORCE)


@pytest.mark.parametrize(
    ("name", "values", "heading_deg", "n_steps"),
    [
        ("heading(rad)", np.full(N, 3.1), np.full(N, np.degrees(3.1)), None),
        ("azimuth", np.full(N, -0.1), np.full(N, np.degrees(-0.1)), None),
        ("heading_rad", np.full(N, 3.1), np.full(N, np.degrees(3.1)), None),
        ("headingDegrees", np.full(N, 3.1), np.full(N, 3.1), None),
        ("trueHeading (\u00b0)", np.full(N, 3.1), np.full(N, 3.1), None),
        ("heading(m)", np.full(N, 3.1), None, None),
        ("heading", np.full(N, 400.0), None, None),
        ("locationTrueHeading", np.append(-1.0, np.full(N - 1, 20.0)), np.full(N - 1, 20.0), None),
        ("step", np.arange(N) // 100, None, None),
        ("stepsDetected", np.arange(N) // 100, None, None),
        ("steps", np.arange(N), None, None),
        ("steps", (np.arange(N) // 100) % 2, None, None),
        ("nSteps", np.arange(N) // 100, None, (N - 1) // 100),
    ],
)
def test_only_counts_of_steps_and_directions_are_those_of_the_phone(
    tmp_path: Path, name: str, values: np.ndarray, heading_deg: np.ndarray | None, n_steps: int | None
) -> None:
    recording = read(write(tmp_path, table_text({"t": TIME_S} | BOTH | {name: values})))
    assert recording.phone_steps == n_steps
    assert (recording.phone_heading is None) == (heading_deg is None)
    if heading_deg is not None:
        np.testing.assert_allclose(np.degrees(recording.phone_heading.values[:, 0]), heading_deg)


@pytest.mark.parametrize("row", ["{x},{y},{z},3,{t}", "{i},{x},{y},{z},{t}", "{i},{x},{y},{z},{date}"])
def test_without_names_the_first_three_columns_before_the_time_are_the_axes(tmp_path: Path, row: str) -> None:
    dates = wall_clock(TIME_S)
    lines = [
        row.format(i=i, t=int(1e12) + round(1e9 * t), x=x, y=y, z=z, date=dates[i])
        for i, (t, (x, y, z)) in enumerate(zip(TIME_S.tolist(), FORCE.tolist(), strict=True))
    ]
    path = write(tmp_path, "\n".join([*lines, ""]), "accelerometer.csv")
    assert_same_streams(read(path), WALK, "accelerometer", time_s=2e-3, rtol=1e-12)


SAMPLES = {"acc": FORCE.tolist(), "gyro": RATE.tolist()}
PERIOD_S = round(float(np.median(np.diff(TIME_S))), 6)
ROWS = [{"acc": a, "gyro": w} for a, w in zip(FORCE.tolist(), RATE.tolist(), strict=True)]


@pytest.mark.parametrize(
    "content",
    [
        {"dt": PERIOD_S} | SAMPLES,
        {"info": {"phone": "x", "interval_ms": 1000 * PERIOD_S}, "data": ROWS},
        {"sampleRate": 1 / PERIOD_S, "start": 1.7e9} | SAMPLES,
        [{"dt": PERIOD_S} | row for row in ROWS],
        [{"t": t, "dt": 99.0, "fs": 5.0} | row for t, row in zip(np.arange(N) * PERIOD_S, ROWS, strict=True)],
        f"# Sampling rate: {1 / PERIOD_S} Hz\n{table_text(BOTH)}",
        f"interval = {1000 * PERIOD_S} ms\n{table_text(BOTH)}",
    ],
)
def test_a_sampling_interval_or_rate_stands_for_times(tmp_path: Path, content: object) -> None:
    is_text = isinstance(content, str)
    path = write(tmp_path, content if is_text else json.dumps(content), "walk.csv" if is_text else "walk.json")
    recording = read(path)
    for samples, values in ((recording.accelerometer, FORCE), (recording.gyroscope, RATE)):
        np.testing.assert_allclose(samples.time_s, np.arange(N) * PERIOD_S, atol=1e-6)
        np.testing.assert_allclose(samples.values, values, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "per_s", "zero", "epoch_s"),
    [
        ("time (min)", 1 / 60, 0.0, None),
        ("time_h", 1 / 3600, 5.0, None),
        ("date", 1 / 86_400, 45_245.5, 1_700_049_600.0),  # days of a spreadsheet
        ("datenum", 1 / 86_400, 739_205.5, 1_700_049_600.0),  # days of MATLAB
    ],
)
def test_times_in_minutes_hours_and_days_are_read(
    tmp_path: Path, name: str, per_s: float, zero: float, epoch_s: float | None
) -> None:
    times = [f"{zero + per_s * t:.11f}" for t in TIME_S]
    recording = read(write(tmp_path, table_text({name: times} | BOTH)))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=2e-5, rtol=1e-12)
    assert recording.epoch_s == (None if epoch_s is None else pytest.approx(epoch_s + TIME_S[0], abs=1e-3))


@pytest.mark.parametrize(("name", "per_s"), [("time", 1.0), ("Time (min)", 1 / 60)])
@pytest.mark.parametrize("hz", [0.5, 2.0])
def test_slow_sensors_have_the_unit_of_time_of_the_accelerometer(
    tmp_path: Path, name: str, per_s: float, hz: float
) -> None:
    slow_s = np.arange(TIME_S[0], TIME_S[-1], 1 / hz)
    write(tmp_path, table_text({name: TIME_S * per_s} | axes("%", FORCE)), "accelerometer.csv")
    write(tmp_path, table_text({"time": slow_s * per_s, "pressure": 1000.0 + slow_s}), "barometer.csv")
    recording = read(tmp_path)
    np.testing.assert_allclose(recording.barometer.time_s, slow_s - TIME_S[0], atol=1e-6)


@pytest.mark.parametrize("name", ["time_of_day", "Time of hour", "minute time", "timestamp day"])
def test_a_word_for_a_longer_span_in_the_name_of_seconds_is_no_unit(tmp_path: Path, name: str) -> None:
    recording = read(write(tmp_path, table_text({name: TIME_S} | BOTH)))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-9, rtol=1e-12)


@pytest.mark.parametrize(
    "content",
    [
        {"gps": {"frequency": 10}} | SAMPLES,
        {"meta": {"gpsInterval": 100}} | SAMPLES,
        f"GPS interval: 100 ms\n{table_text(BOTH)}",
    ],
)
def test_a_rate_of_something_else_does_not_stand_for_times(tmp_path: Path, content: object) -> None:
    is_text = isinstance(content, str)
    path = write(tmp_path, content if is_text else json.dumps(content), "walk.csv" if is_text else "walk.json")
    assert "no column of times" in refusal(path, format="table")


def test_values_by_row_number_are_read_in_the_order_of_the_numbers(tmp_path: Path) -> None:
    columns = {name: {str(i): v for i, v in enumerate(values[:100].tolist())} for name, values in BOTH.items()}
    recording = read(write(tmp_path, json.dumps({"dt": PERIOD_S} | columns, sort_keys=True), "walk.json"))
    np.testing.assert_array_equal(recording.accelerometer.values, FORCE[:100])


def test_each_table_of_a_database_names_its_sensor(tmp_path: Path) -> None:
    series = [
        {"name": name, "columns": ["time", *"xyz"], "values": np.column_stack([TIME_S, values]).tolist()}
        for name, values in (("accelerometer", FORCE), ("gyroscope", RATE))
    ]
    recording = read(write(tmp_path, json.dumps({"results": [{"series": series}]}), "walk.json"))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-9, rtol=1e-12)


@pytest.mark.parametrize("form", ["columns", "split", "of another key"])
def test_tables_that_pandas_writes_as_json_are_read(tmp_path: Path, form: str) -> None:
    columns = {"t": TIME_S.tolist()} | {name: values.tolist() for name, values in BOTH.items()}
    rows = [*map(list, zip(*columns.values(), strict=True))]
    content = {
        "columns": {name: {str(i): v for i, v in enumerate(values)} for name, values in columns.items()},
        "split": {"columns": [*columns], "index": [*range(N)], "data": rows},
        "of another key": {"series": [{"name": "walk", "columns": [*columns], "values": rows}]},
    }[form]
    recording = read(write(tmp_path, json.dumps(content), "walk.json"))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=1e-9, rtol=1e-12)


def test_json_with_thousands_of_columns_is_refused_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, json.dumps({f"time{i}": i for i in range(20_000)}), "walk.json")
    assert "20000 columns, over 1000" in refusal(path, format="table")


def test_a_missing_file_of_one_sensor_is_a_gap_in_it(tmp_path: Path) -> None:
    hour_of = np.searchsorted([6.0, 14.0], TIME_S, side="right")
    for sensor, values in (("accelerometer", FORCE), ("gyroscope", RATE)):
        for hour in range(3):
            part = hour_of == hour
            if (sensor, hour) != ("gyroscope", 1):
                (tmp_path / sensor).mkdir(exist_ok=True)
                text = table_text({"time": MS[part] + 1.7e12} | axes("%", values[part]))
                write(tmp_path / sensor, text, f"2023-11-14 {hour + 10}_00_00.csv")
    recording = read(tmp_path)
    np.testing.assert_array_equal(recording.accelerometer.values, FORCE)
    np.testing.assert_array_equal(recording.gyroscope.values, RATE[hour_of != 1])
