"""Messages of one session become the samples of its recording, in whatever order they arrive."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from serving import EPOCH_NS, sensor_logger_messages

import pdr_filter as pdr
from pdr_filter.apps.live import assembly
from pdr_filter.apps.live.assembly import Assembly, LateError, SessionError
from pdr_filter.apps.live.messages import Message, parse
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="module")
def walk() -> Recording:
    return pdr.simulate.demo_walk()


def assembled(messages: Iterable[dict[str, Any]], platform: str = "") -> tuple[Assembly, dict[str, np.ndarray]]:
    """State at the end, and the rows (time, values) of each sensor."""
    state, held, parts = Assembly(), list[Message](), list[assembly.Streams]()
    for content in messages:
        for message in parse(json.dumps(content).encode()):
            state, held, ready = assembly.take(state, held, message, platform)
            parts += ready
    state, _, ready = assembly.finish_assembly(state, held, platform)
    parts += ready
    names = {name for part in parts for name in part}
    rows = {n: [np.column_stack([p[n].time_s, p[n].values]) for p in parts if n in p] for n in names}
    return state, {name: np.concatenate(found) for name, found in rows.items()}


def test_messages_out_of_order_and_twice_give_the_same_samples(walk: Recording) -> None:
    messages = sensor_logger_messages(walk)[:60]
    _, expected = assembled(messages)
    order = np.arange(60).reshape(-1, 4)[:, ::-1].ravel()  # 3, 2, 1, 0, 7, ...
    shuffled = [messages[i] for i in order for _ in range(1 + i % 2)]
    shuffled.insert(40, messages[3])  # long after its turn
    state, found = assembled(shuffled)
    assert found.keys() == expected.keys()
    for name in found:
        np.testing.assert_array_equal(found[name], expected[name])
    assert state.n_repeated == 31
    assert state.n_lost == 0


def test_a_lost_message_is_given_up_when_three_seconds_of_later_samples_are_there(walk: Recording) -> None:
    messages = sensor_logger_messages(walk)[:40]
    state, held = Assembly(), list[Message]()
    waited = 0
    for content in [*messages[:10], *messages[11:]]:
        (message,) = parse(json.dumps(content).encode())
        state, held, _ = assembly.take(state, held, message, "")
        waited = max(waited, len(held))
    assert state.n_lost == 1
    assert waited == 6  # of half a second each; the next one shows that three seconds are over
    assert held == []
    (late,) = parse(json.dumps(messages[10]).encode())
    with pytest.raises(LateError, match="message 10 is too late"):
        assembly.take(state, held, late, "")


@pytest.mark.parametrize("back_s", [2.0, 5.0, 3600.0])
def test_a_lost_message_is_not_waited_for_longer_if_the_clock_is_set_back_meanwhile(back_s: float) -> None:
    state, held = Assembly(), list[Message]()
    waited, n_ready = 0, 0
    for number in range(40):
        if number == 10:
            continue
        time_s = 1e5 + number + np.arange(50) / 50 - (back_s if number >= 12 else 0.0)
        samples = {name: [[t, 0.1, 0.2, 9.8] for t in time_s.tolist()] for name in ("accelerometer", "gyroscope")}
        content = {"device": "p", "session": "s", "number": number, "samples": samples}
        (message,) = parse(json.dumps(content).encode())
        state, held, ready = assembly.take(state, held, message, "")
        waited, n_ready = max(waited, len(held)), n_ready + sum(len(streams["accelerometer"]) for streams in ready)
    assert waited <= 6
    assert (held, state.n_lost, n_ready, len(state.set_backs)) == ([], 1, 39 * 50, 1)


@pytest.mark.parametrize("order", ["newest first", "in turn with new messages", "backward"])
def test_a_backlog_of_an_outage_is_kept_if_a_newer_message_comes_before_it(walk: Recording, order: str) -> None:
    messages = sensor_logger_messages(walk)[:100]
    _, expected = assembled(messages)
    before, backlog, after = messages[:20], messages[20:60], messages[60:]
    if order == "newest first":
        late = [after[0], *backlog, *after[1:]]
    elif order == "backward":
        late = [*after[:6], *backlog[::-1], *after[6:]]
    else:
        n = len(backlog) // 2
        late = [m for i in range(n) for m in (after[i], *backlog[2 * i : 2 * i + 2])] + after[n:]
    state, found = assembled([*before, *late])
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name])
    assert (state.n_lost, state.n_repeated) == (0, 0)


def test_a_message_without_number_that_comes_again_is_not_recorded_twice(walk: Recording) -> None:
    messages = [{k: v for k, v in m.items() if k != "messageId"} for m in sensor_logger_messages(walk)[:20]]
    _, expected = assembled(messages)
    state, found = assembled([*messages[:10], *messages[8:]])
    np.testing.assert_array_equal(found["accelerometer"], expected["accelerometer"])
    assert state.n_repeated == 2


def test_messages_of_an_app_that_counts_from_zero_again_are_no_repetitions(walk: Recording) -> None:
    messages = sensor_logger_messages(walk)[:60]
    _, expected = assembled(messages)
    again = [{**m, "messageId": m["messageId"] % 30} for m in messages]
    state, found = assembled([*again[:35], again[33], *again[35:]])
    np.testing.assert_array_equal(found["accelerometer"], expected["accelerometer"])
    assert (state.n_lost, state.n_repeated) == (0, 1)


def test_messages_without_any_known_sensor_are_not_held_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assembly, "_MAX_HELD_BYTES", 10_000)
    message = {
        "sessionId": "s",
        "deviceId": "d",
        "payload": [{"name": "light", "time": EPOCH_NS, "values": {"lux": 1}}],
    }
    with pytest.raises(SessionError, match="no acceleration and no gyroscope"):
        assembled({**message, "messageId": number} for number in range(200))


@pytest.mark.parametrize("unit_ns", [1, 10**6])
def test_times_that_cannot_be_nanoseconds_are_refused_with_the_unit(walk: Recording, unit_ns: int) -> None:
    messages = sensor_logger_messages(walk)[:40]
    for message in messages:
        for sample in message["payload"]:
            sample["time"] = (sample["time"] - EPOCH_NS) // unit_ns
    if unit_ns == 1:
        assembled(messages)  # from the start of the phone
    else:
        with pytest.raises(SessionError, match="times must be nanoseconds since 1970"):
            assembled(messages)


def test_gravity_apart_gives_the_specific_force_of_the_recording(walk: Recording) -> None:
    messages = sensor_logger_messages(walk, ios=True)[:60]
    _, found = assembled(messages, "ios")
    _, expected = assembled(sensor_logger_messages(walk)[:60])
    np.testing.assert_allclose(found["accelerometer"], expected["accelerometer"], atol=1e-12)


def test_gravity_that_comes_in_a_later_message_is_waited_for(walk: Recording) -> None:
    messages = sensor_logger_messages(walk, ios=True)[:60]
    _, expected = assembled(messages, "ios")
    gravity = [[s for s in m["payload"] if s["name"] == "gravity"] for m in messages]
    late = [
        {**m, "payload": [s for s in m["payload"] if s["name"] != "gravity"] + before}
        for m, before in zip(messages, [[], *gravity], strict=False)
    ]
    late.append({**messages[-1], "messageId": 60, "payload": gravity[-1]})
    _, found = assembled(late, "ios")
    np.testing.assert_array_equal(found["accelerometer"], expected["accelerometer"])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_phones_own_attitude_says_whose_sign_it_is(walk: Recording, sign: float) -> None:
    messages = sensor_logger_messages(walk, ios=True)[:20]
    for message in messages:
        for sample in message["payload"]:
            if sample["name"] in ("gravity", "accelerometer"):
                sample["values"] = {key: sign * value for key, value in sample["values"].items()}
        # Of a phone that leans back so that up is where the made gravity points, turned by its own sign.
        up = -np.array([0.5, 5.0, 8.0]) / np.linalg.norm([0.5, 5.0, 8.0])
        half = np.array([1.0 + up[2], up[1], -up[0], 0.0])
        attitude = dict(zip(("qw", "qx", "qy", "qz"), half / np.linalg.norm(half), strict=True))
        times = [s["time"] for s in message["payload"] if s["name"] == "gravity"]
        message["payload"] += [{"name": "orientation", "time": t, "values": attitude} for t in times]
    state, _ = assembled(messages)
    assert state.kind.scale == -sign


def test_a_phone_of_unknown_sign_is_refused_with_what_to_do(walk: Recording) -> None:
    with pytest.raises(SessionError, match="--platform ios"):
        assembled(sensor_logger_messages(walk, ios=True)[:20])


def test_a_phone_without_acceleration_is_told_so(walk: Recording) -> None:
    messages = sensor_logger_messages(walk)[:40]
    for message in messages:
        message["payload"] = [s for s in message["payload"] if s["name"] == "gyroscope"]
    with pytest.raises(SessionError, match="no acceleration"):
        assembled(messages)


def test_values_that_the_phone_remembered_are_left_out(walk: Recording) -> None:
    messages = sensor_logger_messages(walk)[:20]
    first = messages[0]["payload"][0]
    messages[0]["payload"].append({**first, "time": first["time"] - 100_000_000_000})
    _, found = assembled(messages)
    _, expected = assembled(sensor_logger_messages(walk)[:20])
    for name in found:
        np.testing.assert_array_equal(found[name], expected[name])


def test_the_latest_time_is_the_last_before_the_first_jump_of_a_minute() -> None:
    times_s = np.arange(20.0)
    assert assembly._latest_s(times_s) == 19.0
    assert assembly._latest_s(np.append(times_s, [500.0, 900.0])) == 19.0
