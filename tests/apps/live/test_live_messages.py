"""Messages of phones become rows, or an error that says why; nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.apps.live.messages import (
    Message,
    MessageError,
    SensorRows,
    parse,
    phyphox_buffers,
    phyphox_rows,
    to_json,
)

EXAMPLE = Path(__file__).resolve().parents[4] / "shared" / "app_files" / "sensor_logger" / "http_push.json"
CONFIG = {
    "inputs": [
        {"source": "accelerometer", "outputs": [{"x": "aX"}, {"y": "aY"}, {"z": "aZ"}, {"t": "a_time"}]},
        {"source": "gyroscope", "outputs": [{"x": "gX"}, {"y": "gY"}, {"z": "gZ"}, {"t": "g_time"}]},
        {"source": "light", "outputs": [{"x": "l"}, {"t": "l_time"}]},
    ]
}


def test_a_push_of_sensor_logger_is_read_to_the_nanosecond() -> None:
    if not EXAMPLE.exists():
        pytest.skip(f"no example at {EXAMPLE}")
    (message,) = parse(EXAMPLE.read_bytes())
    assert message.device == "8b5937fb-2160-4825-ba40-4bc646f93839"
    assert message.number == 17
    gravity = message.rows["gravity"]
    assert gravity.time.tolist() == [1716760513715797500, 1716760516584638000]
    np.testing.assert_array_equal(gravity.values[0], [-0.3973714246124029, -5.317313797414302, -8.230349946337938])
    assert message.rows["attitude"].values.shape == (1, 4)


def test_a_message_of_our_own_comes_back_as_it_was() -> None:
    rng = np.random.default_rng(1)
    rows = {"gyroscope": SensorRows(np.sort(rng.random(5)), rng.normal(size=(5, 3)))}
    meta = {"name": "walk", "placement": "hand", "subject": {"id": "p01", "height_m": 1.8}}
    message = Message("p", "s", 3, "ios", rows, is_end=True, meta=meta)
    (again,) = parse(to_json(message))
    assert again.meta == meta
    assert (again.device, again.session, again.number, again.platform, again.is_end) == ("p", "s", 3, "ios", True)
    np.testing.assert_array_equal(again.rows["gyroscope"].time, rows["gyroscope"].time)
    np.testing.assert_array_equal(again.rows["gyroscope"].values, rows["gyroscope"].values)


def test_an_event_of_android_is_one_sample() -> None:
    event = {
        "type": "android.sensor.gyroscope",
        "timestamp": 3925657519043709,
        "values": [0.1, -0.2, 0.3],
        "accuracy": 3,
    }
    (message,) = parse(json.dumps(event).encode(), device="a", session="b")
    assert message.rows["gyroscope"].time.tolist() == [3925657519043709]
    assert message.rows["gyroscope"].values.tolist() == [[0.1, -0.2, 0.3]]


def test_phyphox_gives_the_sensors_that_have_times() -> None:
    buffers = phyphox_buffers(json.dumps(CONFIG).encode())
    assert buffers == {"accelerometer": ("a_time", "aX", "aY", "aZ"), "gyroscope": ("g_time", "gX", "gY", "gZ")}
    filled = {name: {"buffer": [1.0, 2.0]} for name in ("a_time", "aX", "aY", "aZ", "g_time", "gX", "gY")}
    filled["gZ"] = {"buffer": [1.0]}  # one that was read before the last sample came
    rows = phyphox_rows(json.dumps({"buffer": filled}).encode(), buffers)
    assert len(rows["accelerometer"].time) == 2
    assert len(rows["gyroscope"].time) == 1


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"3", "JSON object"),
        (b'{"payload": 3}', "array"),
        (b'{"payload": [3]}', "must have a name"),
        (b'{"payload": [{"name": "gyroscope", "time": "x", "values": {}}]}', "nanoseconds"),
        (b'{"payload": [{"name": "gyroscope", "time": 1e400, "values": {}}]}', "nanoseconds"),
        (b'{"payload": [{"name": "gyroscope", "time": 1, "values": {"x": "a"}}]}', "must be numbers"),
        (b'{"samples": {"gyroscope": [[1, 2]]}}', "3 numbers"),
        (b'{"samples": {"gyroscope": [[1, 2], [1]]}}', "must be numbers"),
        (b'{"samples": {"../x": [[1, 2]]}}', "unknown sensor"),
        (b'{"type": "android.sensor.gyroscope", "timestamp": 1, "values": [1]}', "3 numbers"),
        (b'{"fix": 1}', "a fix must be"),
        (json.dumps([{}] * 2000).encode(), "2000 messages"),
    ],
)
def test_what_is_no_message_is_said_to_be_none(body: bytes, words: str) -> None:
    with pytest.raises(MessageError, match=words):
        parse(body)


@pytest.mark.parametrize(
    ("meta", "kept", "words"),
    [
        ("null", {}, []),
        ("1", {}, ["meta .* is '1', .*object"]),
        ('{"subject": 1, "name": "walk"}', {"name": "walk"}, ["subject .*object"]),
        ('{"subject": {"height_m": 178, "age": 40}}', {"subject": {"age": 40.0}}, ["height_m .* '178', .*in metres"]),
        ('{"subject": {"age": "25-30", "weight_kg": 1e400}}', {}, ["weight_kg", "age .* '25-30', .*a number"]),
        ('{"placement": ["x"], "subject": {"id": 5}}', {"subject": {"id": "5"}}, ["placement .*a text"]),
    ],
)
def test_meta_data_that_cannot_be_used_are_noted_and_the_samples_are_taken(
    meta: str, kept: dict[str, object], words: list[str]
) -> None:
    (message,) = parse(b'{"samples": {"gyroscope": [[1, 0, 0, 0]]}, "meta": %s}' % meta.encode())
    assert (message.n_samples, message.meta) == (1, kept)
    assert len(message.notes) == len(words)
    for note, pattern in zip(message.notes, words, strict=True):
        assert re.match(pattern, note)


def test_a_test_of_an_app_without_samples_is_no_error() -> None:
    assert parse(b'{"hello": "world"}') == []


def test_values_that_no_sensor_gives_are_unknown() -> None:
    body = b'{"samples": {"gyroscope": [[1, NaN, Infinity, 1e30], [2, 1, 2, 3], [NaN, 1, 2, 3]]}}'
    rows = parse(body)[0].rows["gyroscope"]
    assert rows.time.tolist() == [1.0, 2.0]
    assert np.isnan(rows.values[0]).all()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                [
                    "payload",
                    "samples",
                    "name",
                    "time",
                    "values",
                    "x",
                    "fix",
                    "gyroscope",
                    "type",
                    "timestamp",
                    "messageId",
                    "meta",
                    "subject",
                    "height_m",
                ]
            ),
            inner,
            max_size=5,
        )
    ),
    max_leaves=12,
)


@given(JSON)
def test_no_message_whatever_provokes_anything_but_a_message_error(content: object) -> None:
    try:
        parse(json.dumps(content).encode())
    except MessageError as error:
        assert str(error).isprintable()
