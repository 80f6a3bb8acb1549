"""Sessions of devices without a web: the track of `pdr_filter.track`, whatever happens to the process meanwhile."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
import tracemalloc
import zipfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from serving import EPOCH_NS, own_messages, sensor_logger_messages, short_walk, take

import pdr_filter as pdr
from pdr_filter.apps.live import session as live_session
from pdr_filter.apps.live import sessions as live_sessions
from pdr_filter.apps.live.assembly import LateError, SessionError
from pdr_filter.apps.live.messages import MessageBatch, parse
from pdr_filter.apps.live.recorder import exported_files, zip_parts
from pdr_filter.apps.live.session import DeviceSession, PathRows, session_id
from pdr_filter.apps.live.sessions import Sessions
from pdr_filter.apps.live.settings import BusyError, Event, FixError, Settings, worker_of
from pdr_filter.data.io.fix_files import ranges_of_file
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="module")
def walk() -> Recording:
    """A walk of half a minute."""
    return short_walk(32.0)


def taken(folder: Path, bodies: Sequence[bytes], **settings: Any) -> tuple[DeviceSession, list[Event]]:
    """The session after these messages, and what was shown."""
    events: list[Event] = []
    devices = Sessions(Settings(**settings), folder, events.append)
    take_all(devices, bodies, time.time())
    (session,) = devices.sessions.values()
    session.save()
    return session, events


def take_all(devices: Sessions, bodies: Sequence[bytes], unix_s: float = 0.0) -> None:
    for body in bodies:
        take(devices, body, unix_s)


def sessions_in(folder: Path, events: list[Event] | None = None) -> Sessions:
    return Sessions(Settings(), folder, (lambda _: None) if events is None else events.append)


def with_fix(fix: dict[str, Any]) -> list[bytes]:
    """A message with a position or a range that the user states."""
    return encoded([{"device": "p", "session": "s", "fix": fix}])


def encoded(messages: Sequence[Any]) -> list[bytes]:
    return [json.dumps(message).encode() for message in messages]


def positions(session: DeviceSession) -> np.ndarray:
    return session.path.values[:, 1:3]


def test_the_track_is_that_of_what_was_sent_and_of_what_was_recorded(walk: Recording, tmp_path: Path) -> None:
    session, events = taken(tmp_path, own_messages(walk), height_m=walk.subject.height_m)
    again = pdr.track(pdr.read(session.recorder.folder))
    np.testing.assert_array_equal(positions(session), again.position_m)
    np.testing.assert_array_equal(again.position_m, pdr.track(walk).position_m)
    shown = [e["position_m"] for e in events if e["event"] == "step" and e["is_final"]]
    np.testing.assert_array_equal(shown, again.position_m)


@pytest.mark.parametrize("is_real", [False, True])
@pytest.mark.parametrize("n_saved", [3, 40])
def test_a_process_that_dies_loses_nothing_that_it_took(
    walk: Recording, tmp_path: Path, n_saved: int, is_real: bool
) -> None:
    """Saved after some messages, first before the session is known, and killed after others; with real times, too."""
    bodies = encoded(sensor_logger_messages(walk)) if is_real else own_messages(walk)
    expected, _ = taken(tmp_path / "whole", bodies)
    events: list[Event] = []
    devices = sessions_in(tmp_path / "broken", events)
    for i, body in enumerate(bodies):
        take(devices, body)
        if i + 1 == n_saved:
            devices.close()
        if i in (n_saved + 5, n_saved + 30):
            devices = sessions_in(tmp_path / "broken", events)
            take(devices, body)  # the answer was lost, so that it is sent again
    devices.close()
    (session,) = devices.sessions.values()
    np.testing.assert_array_equal(positions(session), positions(expected))
    assert len(list(session.recorder.steps())) == len(session.path)
    for name in ("accelerometer.csv", "gyroscope.csv", "magnetometer.csv"):
        assert (session.recorder.folder / name).read_bytes() == (expected.recorder.folder / name).read_bytes()


def test_writes_that_were_broken_off_are_left_out(walk: Recording, tmp_path: Path) -> None:
    bodies = own_messages(walk)[:20]
    session, _ = taken(tmp_path, bodies[:10])
    samples = session.recorder.folder / "accelerometer.csv"
    whole = samples.read_bytes()
    samples.write_bytes(whole + b"9.0,1,2,3\n9.1,1")  # written, and then the state was not
    devices = sessions_in(tmp_path)
    take(devices, bodies[10])
    (journal,) = session.recorder.folder.glob("journal_*.json")
    journal.write_bytes(journal.read_bytes()[:-7])
    (again,) = sessions_in(tmp_path).sessions.values()
    assert again.assembly.next_number == 10
    assert samples.read_bytes() == whole


def test_a_walk_with_locations_lies_in_the_world_as_its_recording_does(walk: Recording, tmp_path: Path) -> None:
    time_s = np.arange(0.0, 60.0, 1.0)
    truth = np.interp(time_s, [0, 60], [0, 60])
    place = pdr.Origin(51.5, -0.1).latitude_longitude_deg(np.column_stack([truth * 0.7, truth * 0.7]))
    values = np.column_stack([*place, np.zeros(60), np.full(60, 5.0)])
    located = replace(walk, location=Samples(time_s, values))
    session, events = taken(tmp_path, own_messages(located))
    again = pdr.track(pdr.read(session.recorder.folder))
    np.testing.assert_allclose(positions(session), again.position_m, atol=1e-9)
    assert session.about()["origin"] == pytest.approx([51.5, -0.1], abs=1e-3)
    assert any(e["event"] == "track" for e in events)  # told anew while its north was sought


def test_an_iphone_with_gravity_apart_gives_the_track_of_the_same_walk(walk: Recording, tmp_path: Path) -> None:
    messages = sensor_logger_messages(walk, ios=True)
    session, _ = taken(tmp_path, encoded(messages), platform="ios")
    session.finish()
    expected = pdr.track(replace(walk, meta={}))
    np.testing.assert_allclose(positions(session), expected.position_m, atol=1e-3)


@pytest.mark.parametrize(("at_s", "back_s"), [(30.2, 1.5), (30.0, 30.0), (30.2, 7200.0)])
def test_no_step_is_lost_when_the_clock_of_a_phone_with_numbered_messages_is_set_back(
    walk: Recording, tmp_path: Path, at_s: float, back_s: float
) -> None:
    """At the end of a message, and within one."""
    messages = sensor_logger_messages(walk)
    for message in messages:
        for sample in message["payload"]:
            sample["time"] -= round(back_s * 1e9) * (sample["time"] >= EPOCH_NS + at_s * 1e9)
    session, events = taken(tmp_path, encoded(messages))
    recording = pdr.read(session.recorder.folder)
    assert len(recording.accelerometer) == len(walk.accelerometer)
    np.testing.assert_array_equal(positions(session), pdr.track(recording).position_m[: len(session.path)])
    expected = pdr.track(replace(walk, meta={}))
    np.testing.assert_allclose(positions(session), expected.position_m[: len(session.path)], atol=0.1)
    assert expected.n_steps - 8 <= len(session.path)
    (about,) = [e for e in events if e["event"] == "session" and e["notes"]][:1]
    assert f"set back by {back_s:.1f} s" in about["notes"][0]


def test_after_the_clock_is_set_back_by_minutes_i_am_here_is_of_now(tmp_path: Path) -> None:
    bodies: list[bytes] = []
    for body in own_messages(short_walk(110.0), part_s=1.0):
        content = json.loads(body)
        for rows in content["samples"].values():
            for row in rows:
                row[0] += 900.0 * (row[0] < 30.0)
        bodies.append(json.dumps(content).encode())
    here = b'{"device": "p", "session": "s", "fix": {"east_m": 0.0, "north_m": 0.0, "std_m": 1000.0}}'
    session, events = taken(tmp_path, [*bodies[:-8], here, *bodies[-8:-1]])
    assert session.assembly.ahead_s > 800.0
    assert [e["outcome"] for e in events if e["event"] == "fix"] == ["waiting", "used"]


def test_meta_data_of_several_messages_add_up_and_what_cannot_be_used_is_noted(tmp_path: Path) -> None:
    metas = [{"name": "walk", "subject": {"height_m": 1.6}}, {"placement": "hand", "subject": {"age": "old"}}, {}]
    messages = [{"device": "p", "number": i, "samples": {}, "meta": meta} for i, meta in enumerate(metas)]
    session, events = taken(tmp_path, encoded(messages))
    assert session.settings.meta == {"subject": {"height_m": 1.6}, "placement": "hand"}
    assert session.name == "walk"
    (note,) = [e for e in events if e["event"] == "session"][-1]["notes"]
    assert note.startswith("age in the meta data of the phone is 'old'")


def test_a_note_on_meta_data_is_kept_when_the_server_starts_again(walk: Recording, tmp_path: Path) -> None:
    first, *others = own_messages(walk)[:20]
    devices = sessions_in(tmp_path)
    take_all(devices, encoded([json.loads(first) | {"meta": {"subject": {"age": "old"}}}]) + others)
    devices.close()
    (session,) = sessions_in(tmp_path).sessions.values()
    (note,) = session.about()["notes"]
    assert note.startswith("age in the meta data of the phone is 'old'")


def test_two_phones_of_one_name_are_two_sessions(walk: Recording, tmp_path: Path) -> None:
    devices = sessions_in(tmp_path)
    for bodies in zip(own_messages(walk, "p", "a"), own_messages(walk, "p", "b"), strict=True):
        take_all(devices, bodies)
    one, two = devices.sessions.values()
    np.testing.assert_array_equal(positions(one), positions(two))
    assert one.recorder.folder != two.recorder.folder


@pytest.mark.parametrize("name", ["../../etc", "/root/x", "a\x00b", "..", ".", "a" * 500, "con", "é\u202e", "\\\\h\\s"])
def test_no_name_leads_out_of_the_folder(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "inside"
    devices = sessions_in(folder)
    body = json.dumps({"device": name, "session": name, "samples": {"gyroscope": [[0, 1, 2, 3]]}}).encode()
    take(devices, body)
    assert [path.name for path in tmp_path.iterdir()] == ["inside"]
    assert all(path.resolve().is_relative_to(folder.resolve()) for path in folder.rglob("*"))
    assert session_id(name, "") != session_id(name, "1")


def on_the_way(walk: Recording, folder: Path, n: int) -> tuple[Sessions, DeviceSession, list[Event], list[bytes]]:
    """Sessions after `n` messages of a walk, what they have shown, and the messages that follow."""
    events, bodies = list[Event](), own_messages(walk)
    devices = sessions_in(folder, events)
    take_all(devices, bodies[:n])
    (session,) = devices.sessions.values()
    return devices, session, events, bodies[n:]


def test_a_fix_pulls_the_track_and_is_on_record(walk: Recording, tmp_path: Path) -> None:
    devices, session, events, rest = on_the_way(walk, tmp_path, 55)
    unfixed = pdr.track(replace(walk, meta={}))
    time_s = session.online.now().time_s
    here = [float(np.interp(time_s, unfixed.time_s, axis)) for axis in unfixed.position_m.T]
    here[1] += 3.0
    fix = with_fix({"east_m": here[0], "north_m": here[1], "std_m": 0.2})
    take_all(devices, [*fix, *rest])
    devices.close()
    assert positions(session)[-1, 1] - unfixed.position_m[-1, 1] > 0.5
    assert any(e["event"] == "path" for e in events)
    (shown,) = (e["path"] for e in session.snapshot() if e["event"] == "path")
    drawn, path = np.array(shown), session.online.path()
    np.testing.assert_allclose(drawn[:, 1:], path.position_m[: path.n_steps], atol=1.0)
    lines = (session.recorder.folder / "fixes.csv").read_text().splitlines()
    assert lines[0] == "time_s,east_m,north_m,std_m"
    assert len(lines) == 2
    assert {"fixes.csv", "steps.jsonl"} <= exported_files(session.recorder.folder).keys()


def test_a_range_to_an_anchor_is_used_and_is_on_record_as_a_file_of_ranges(walk: Recording, tmp_path: Path) -> None:
    devices, session, events, rest = on_the_way(walk, tmp_path, 55)
    east_m, north_m = session.online.position_m
    fix = {"east_m": east_m + 12.0, "north_m": north_m, "range_m": 12.4, "std_m": 1.0}
    take_all(devices, [*with_fix(fix), *rest])
    devices.close()
    told = [(e["kind"], e["outcome"]) for e in events if e["event"] == "fix"]
    assert told == [("range", "waiting"), ("range", "used")]
    assert [e["anchor_m"] for e in events if e["event"] == "fix"] == [[east_m + 12.0, north_m]] * 2
    (read,) = ranges_of_file(session.recorder.folder / "ranges.csv")
    assert (read.range_m, read.std_m) == (12.4, 1.0)
    np.testing.assert_allclose(read.anchor_m, [east_m + 12.0, north_m])
    assert "ranges.csv" in exported_files(session.recorder.folder)


@pytest.mark.parametrize(("away_m", "outcome"), [(1.0, "used"), (500.0, "rejected")])
def test_what_became_of_a_fix_is_told_also_by_the_next_process(
    walk: Recording, tmp_path: Path, away_m: float, outcome: str
) -> None:
    devices, session, events, rest = on_the_way(walk, tmp_path, 48)
    east_m, north_m = session.online.position_m
    take_all(devices, with_fix({"east_m": east_m + away_m, "north_m": north_m, "std_m": 1.0}))
    (waiting,) = (e for e in events if e["event"] == "fix")
    assert (waiting["outcome"], waiting["east_m"]) == ("waiting", pytest.approx(east_m + away_m))
    devices.close()
    devices = sessions_in(tmp_path, events)
    take_all(devices, rest[:10])
    _, told = (e for e in events if e["event"] == "fix")
    assert (told["outcome"], told["time_s"]) == (outcome, waiting["time_s"])
    assert told["accepted"] == (outcome == "used")


@pytest.mark.parametrize(
    ("fix", "words"),
    [
        ({}, "the fix has no 'east_m'"),
        ({"east_m": "a", "north_m": 0}, "'a'"),
        ({"east_m": float("nan"), "north_m": 0}, "nan"),
        ({"latitude_deg": 1}, "nowhere on Earth"),
        ({"std_m": -1}, "the fix has no 'east_m'"),
    ],
)
def test_a_fix_that_cannot_be_used_is_refused_and_changes_nothing(
    walk: Recording, tmp_path: Path, fix: dict, words: str
) -> None:
    devices = sessions_in(tmp_path)
    take_all(devices, own_messages(walk)[:20])
    (session,) = devices.sessions.values()
    before = session.online.state
    with pytest.raises(FixError, match=words):
        take_all(devices, with_fix(fix))
    assert session.online.state is before
    take(devices, own_messages(walk)[20])


def test_a_message_that_is_too_late_does_not_end_the_track(walk: Recording, tmp_path: Path) -> None:
    bodies = own_messages(walk)
    devices = sessions_in(tmp_path)
    take_all(devices, [*bodies[:10], *bodies[11:40]])
    with pytest.raises(LateError, match="message 10 is too late"):
        take(devices, bodies[10])
    (session,) = devices.sessions.values()
    n_steps = len(session.path)
    take_all(devices, bodies[40:])
    assert session.refused == ""
    assert len(session.path) > n_steps


def test_there_is_room_for_so_many_phones_and_the_next_is_told_so(tmp_path: Path) -> None:
    devices = Sessions(Settings(max_devices=2), tmp_path, lambda _: None)
    bodies = [json.dumps({"device": f"p{i}", "samples": {}}).encode() for i in range(3)]
    take_all(devices, bodies[:2])
    with pytest.raises(BusyError, match="max-devices"):
        take(devices, bodies[2])


def test_what_comes_after_the_end_is_refused_also_by_the_next_process(walk: Recording, tmp_path: Path) -> None:
    bodies = own_messages(walk)
    taken(tmp_path, bodies)
    devices = sessions_in(tmp_path)
    with pytest.raises(SessionError, match="has ended"):
        take(devices, bodies[-1].replace(b'"number": ', b'"number": 9'))
    (session,) = devices.sessions.values()
    assert (session.about()["has_ended"], session.about()["refused"]) == (True, "")


def test_the_last_message_may_be_sent_again(walk: Recording, tmp_path: Path) -> None:
    devices = sessions_in(tmp_path)
    body = own_messages(walk)[0].replace(b'"number": 0', b'"number": 0, "end": true')
    for _ in range(2):  # the first answer was lost
        take(devices, body)
    (session,) = devices.sessions.values()
    assert (session.has_ended, session.about()["n_repeated_messages"]) == (True, 1)


def test_an_error_of_the_filter_ends_the_track_of_one_session_whose_messages_are_kept(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = own_messages(walk)[:16]
    devices = sessions_in(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(live_session, "_pushed", lambda online, samples: [][1])
        with pytest.raises(SessionError, match="IndexError: list index out of range"):
            take_all(devices, bodies[:8])
        for body in bodies[8:]:
            with contextlib.suppress(SessionError):
                take(devices, body)
        (session,) = devices.sessions.values()
        exported = exported_files(session.recorder.folder, is_refused=True)
        assert "accelerometer.csv" in exported
        assert b'"number": 15' in exported["messages.json"].read_bytes()
    (session,) = sessions_in(tmp_path).sessions.values()  # of a version without the error
    assert session.about()["refused"] == ""
    assert session.assembly.next_number == len(bodies)
    assert not list(tmp_path.glob("*.damaged*"))


def with_bias(walk: Recording, bias_radps: float) -> Recording:
    gyroscope = walk.gyroscope
    return replace(walk, gyroscope=Samples(gyroscope.time_s, gyroscope.values + np.array([0.0, 0.0, bias_radps])))


def test_the_gyroscope_bias_of_a_phone_is_used_in_its_next_session(walk: Recording, tmp_path: Path) -> None:
    biased = with_bias(walk, 0.02)
    first, _ = taken(tmp_path, own_messages(biased, session="first"))
    learnt = first.online.device
    bodies = own_messages(biased, session="second")
    devices = sessions_in(tmp_path)
    take_all(devices, bodies[:20], time.time())
    # killed before a state was saved, and the phone's device is written by another session in between
    learnt.after(days=400.0).save(next((tmp_path / "devices").glob("*.json")))
    devices = sessions_in(tmp_path)
    take_all(devices, bodies[20:], time.time())
    second = devices.sessions[session_id("p", "second")]
    second.save()
    device = pdr.Device.load(second.recorder.folder / "device.json")
    np.testing.assert_array_equal(device.bias_radps, learnt.bias_radps)
    assert (np.diag(device.bias_cov_radps2) < 1.1 * np.diag(learnt.bias_cov_radps2) + 1e-9).all()
    again = pdr.track(pdr.read(second.recorder.folder), device=device)
    np.testing.assert_array_equal(positions(second), again.position_m)
    assert (positions(second) != positions(first)).any()


def test_a_gyroscope_bias_that_does_not_fit_the_session_is_noted_and_replaced(tmp_path: Path) -> None:
    still = simulate([Leg("stationary", duration_s=60.0), Leg("walking", distance_m=20.0)], seed=2)
    taken(tmp_path, own_messages(with_bias(still, 0.05), session="first", part_s=2.0))
    events: list[Event] = []
    devices = sessions_in(tmp_path, events)
    take_all(devices, own_messages(with_bias(still, -0.05), session="second", part_s=2.0), time.time())
    last = [e for e in events if e["event"] == "session"][-1]
    assert any("may be of another phone" in note for note in last["notes"])
    (file,) = (tmp_path / "devices").iterdir()
    assert pdr.Device.load(file).bias_radps[2] == pytest.approx(-0.05, abs=0.01)


def test_a_session_without_gyroscope_or_of_two_seconds_keeps_no_gyroscope_bias(walk: Recording, tmp_path: Path) -> None:
    short = {name: Samples(s.time_s[s.time_s < 2.0], s.values[s.time_s < 2.0]) for name, s in walk.streams.items()}
    taken(tmp_path / "short", own_messages(replace(walk, **short)))
    taken(tmp_path / "without", own_messages(replace(walk, gyroscope=None)))
    assert not list(tmp_path.glob("*/devices/*"))


def test_a_damaged_file_of_a_phone_does_not_stop_its_next_session(walk: Recording, tmp_path: Path) -> None:
    first, _ = taken(tmp_path, own_messages(walk, session="first"))
    (file,) = (tmp_path / "devices").iterdir()
    file.write_text("{")
    devices = sessions_in(tmp_path)
    take_all(devices, own_messages(walk, session="second"), time.time())
    second = devices.sessions[session_id("p", "second")]
    second.save()
    np.testing.assert_array_equal(positions(second), positions(first))


def test_each_device_belongs_to_one_worker() -> None:
    parts = [worker_of(f"phone {i}", 2) for i in range(100)]
    assert 30 < sum(parts) < 70
    assert parts == [worker_of(f"phone {i}", 2) for i in range(100)]


def test_a_message_of_a_minute_gives_the_same_track_as_many_short_ones(walk: Recording, tmp_path: Path) -> None:
    short, _ = taken(tmp_path / "short", own_messages(walk))
    long, _ = taken(tmp_path / "long", own_messages(walk, part_s=30.0))
    np.testing.assert_array_equal(positions(long), positions(short))


def test_messages_of_many_phones_are_recorded_at_once_and_filtered_together(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two seconds of one phone are filtered in one pass, but each message is written before its answer."""
    spans_s: list[float] = []
    pushed = live_session._pushed

    def counted(online: pdr.OnlineFilter, samples: dict[str, Samples]) -> list[pdr.StepUpdate]:
        spans_s.append(float(np.ptp(samples["accelerometer"].time_s)))
        return pushed(online, samples)

    monkeypatch.setattr(live_session, "_pushed", counted)
    monkeypatch.setattr(live_session, "time", SimpleNamespace(monotonic=lambda: 1000.0, time=time.time))
    devices = sessions_in(tmp_path)
    for number in range(9):
        take(devices, own_messages(walk, f"other {number}")[0])
    samples, n_sent = tmp_path / session_id("p", "s") / "accelerometer.csv", 0
    for body in own_messages(walk, part_s=0.2)[:100]:
        n_sent += len(json.loads(body)["samples"]["accelerometer"])
        assert devices.take([MessageBatch("p", parse(body), 0.0)]) == [None]
        if n_sent > 210:  # until then it is not known which sensors there are
            assert samples.read_bytes().count(b"\n") == 1 + n_sent
    assert len(spans_s) >= 8
    assert min(spans_s) > 1.9
    assert max(spans_s) < 2.5


def test_a_state_that_is_saved_between_two_passes_of_the_filter_misses_no_sample(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = own_messages(walk)
    expected, _ = taken(tmp_path / "whole", bodies)
    monkeypatch.setattr(live_sessions, "_PASS_S", 1000.0)
    monkeypatch.setattr(live_sessions, "_LONGEST_WAIT_S", 1000.0)
    for number, body in enumerate(bodies):
        if number % 30 == 0:  # the process before has died
            devices = sessions_in(tmp_path / "broken")
        devices.take([MessageBatch("p", parse(body), 0.0)])
        if number % 30 == 20:
            monkeypatch.setattr(live_sessions, "_SAVE_S", -1.0)
            devices.maintain()
            monkeypatch.setattr(live_sessions, "_SAVE_S", 1000.0)
    devices.close()
    (session,) = devices.sessions.values()
    np.testing.assert_array_equal(positions(session), positions(expected))


def test_a_session_that_cannot_be_tracked_is_shown_with_the_reason(walk: Recording, tmp_path: Path) -> None:
    events: list[Event] = []
    devices = sessions_in(tmp_path, events)
    with pytest.raises(SessionError, match="--platform ios"):
        take_all(devices, encoded(sensor_logger_messages(walk, ios=True)[:10]))
    assert "--platform ios" in events[-1]["refused"]
    waiting = next(e["waits"] for e in events if e["event"] == "session")
    assert waiting == "2 s of samples are needed, 0.5 s are there"


@pytest.mark.parametrize(("n", "state"), [(2, "waits"), (None, "refused")])
def test_what_an_untracked_phone_sends_is_recorded_and_can_be_read(
    walk: Recording, tmp_path: Path, n: int | None, state: str
) -> None:
    messages = sensor_logger_messages(walk, ios=True)[:n]
    devices = sessions_in(tmp_path)
    for number, body in enumerate(encoded(messages)):
        with contextlib.suppress(SessionError):
            take(devices, body)
        if number == 60:  # the process dies, and the next one records on
            devices = sessions_in(tmp_path)
    devices.close()
    (session,) = devices.sessions.values()
    assert session.about()[state]
    recording = pdr.read(session.recorder.folder, platform="ios")
    n_rows = Counter(sample["name"] for message in messages for sample in message["payload"])
    expected = walk.accelerometer.values[: n_rows["gravity"]]
    np.testing.assert_allclose(recording.accelerometer.values, expected, atol=1e-12)
    assert len(recording.gyroscope) == n_rows["gyroscope"]
    (name,) = exported_files(session.recorder.folder)
    assert name == "messages.json"


@pytest.mark.parametrize("damage", ["state.bin", "config.txt", "journal_1.json", "no state.bin", "no journal_1.json"])
def test_a_session_that_cannot_be_loaded_is_set_aside_and_the_others_go_on(
    walk: Recording, tmp_path: Path, damage: str
) -> None:
    bodies = {name: own_messages(walk, name) for name in ("bad", "good")}
    devices = sessions_in(tmp_path)
    take_all(devices, [*bodies["bad"][:20], *bodies["good"][:20]])
    devices.close()
    (bad,) = tmp_path.glob("bad-*")
    file, n = bad / damage.removeprefix("no "), 20
    if file.name == damage:
        file.write_bytes(b"damaged\n")
    else:
        take(devices, bodies["bad"][20])
        file.unlink()
        n = 21
    events: list[Event] = []
    devices = sessions_in(tmp_path, events)
    take_all(devices, [*bodies["bad"][n:], *bodies["good"][20:]])
    devices.close()
    (aside,) = tmp_path.glob("bad-*.damaged1")
    notes = {s.device: s.about()["notes"] for s in devices.sessions.values()}
    assert aside.name in notes["bad"][0]
    assert notes["good"] == []
    folders = [aside, bad]
    rows = sum(len(pdr.read(folder).accelerometer) for folder in folders)
    assert rows == len(walk.accelerometer)


@pytest.mark.parametrize("is_disk", [False, True])
def test_a_session_that_is_not_loaded_is_shown_until_its_next_message_loads_it(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_disk: bool
) -> None:
    """Loading it has ended the last process, or the disk does not answer, and the phone is silent."""

    def broken(*_: Any) -> DeviceSession:
        raise OSError(5, "Input/output error")

    bodies = own_messages(walk)
    session, _ = taken(tmp_path, bodies[:20])
    events: list[Event] = []
    if is_disk:
        monkeypatch.setattr(DeviceSession, "load", broken)
    else:
        (session.recorder.folder / ".tries").write_bytes(b"x")
    devices = sessions_in(tmp_path, events)
    monkeypatch.undo()
    (event,) = events
    assert (event["event"], event["id"], event["device"]) == ("session", session.id, "p")
    assert ("Input/output error" if is_disk else "ended while it loaded") in event["waits"]
    assert [event["event"] for event in devices.snapshots()] == ["track", "path"]
    take(devices, bodies[20])
    assert events[-1]["id"] == session.id
    assert [event["waits"] for event in events if event["event"] == "session"][-1] == ""
    (told,) = (event for event in events if event["event"] == "track")
    assert len(told["path"]) >= len(session.path) > 0
    assert [event["id"] for event in devices.snapshots() if event["event"] == "track"] == [session.id]


def test_kills_while_a_session_is_loaded_and_saved_do_not_set_it_aside(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = own_messages(walk)
    session, _ = taken(tmp_path, bodies[:20])
    mark = session.recorder.folder / ".tries"
    mark.write_bytes(b"xxx")
    devices = sessions_in(tmp_path)
    take(devices, bodies[20])
    assert not mark.exists()
    assert devices.sessions[session.id].assembly.next_number == 21
    tries: list[bool] = []
    monkeypatch.setattr(DeviceSession, "save", lambda _: tries.append(mark.exists()))
    sessions_in(tmp_path)
    assert tries == [False]  # waiting for the disk may take long, and says nothing about the messages
    assert not list(tmp_path.glob("*.damaged*"))


def test_a_session_that_is_not_loaded_is_gone_after_ten_minutes(walk: Recording, tmp_path: Path) -> None:
    session, _ = taken(tmp_path, own_messages(walk)[:8])
    (session.recorder.folder / ".tries").write_bytes(b"x")
    events: list[Event] = []
    devices = sessions_in(tmp_path, events)
    (unloaded,) = devices._unloaded.values()
    devices.maintain()
    assert [event["event"] for event in events] == ["session"]
    unloaded.seen_at -= 601.0
    devices.maintain()
    assert events[-1] == {"event": "gone", "id": session.id}
    assert devices.snapshots() == []


@pytest.mark.parametrize("deleted", ["", "gyroscope.csv"])
def test_a_session_whose_files_are_deleted_begins_again_or_is_set_aside(
    walk: Recording, tmp_path: Path, deleted: str
) -> None:
    devices, session, events, rest = on_the_way(walk, tmp_path, 10)
    session.save()
    path = session.recorder.folder / deleted
    if deleted:
        path.unlink()
    else:
        shutil.rmtree(path)
    errors = [devices.take([MessageBatch("p", parse(body), 0.0)])[0] for body in rest[:20]]
    assert sum(error is not None for error in errors) <= 1  # the one that finds it out is sent again
    assert "free some space" not in str(errors)
    assert {"event": "gone", "id": session.id} in events
    (again,) = devices.sessions.values()
    assert (again.refused, again.recorder._waiting) == ("", {})
    assert len(list(tmp_path.glob("*.damaged1"))) == (deleted == "gyroscope.csv")


def test_a_session_without_the_file_of_its_names_goes_on_with_what_it_has(walk: Recording, tmp_path: Path) -> None:
    devices, session, _, rest = on_the_way(walk, tmp_path, 20)
    devices.close()
    (names,) = (tmp_path / "sessions").iterdir()
    names.unlink()
    again, _ = taken(tmp_path, rest)
    assert again.id == session.id
    assert len(pdr.read(again.recorder.folder).accelerometer) == len(walk.accelerometer)
    assert names.exists()


def test_a_zip_file_of_a_long_recording_needs_little_memory(tmp_path: Path) -> None:
    content = np.random.default_rng(0).bytes(12_000_000)
    (tmp_path / "accelerometer.csv").write_bytes(content)
    with (tmp_path / "made.zip").open("wb") as made:
        tracemalloc.start()
        try:
            for part in zip_parts({"accelerometer.csv": tmp_path / "accelerometer.csv"}):
                made.write(part)
            peak_bytes = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert peak_bytes < 6_000_000
    with zipfile.ZipFile(tmp_path / "made.zip") as archive:
        assert archive.read("accelerometer.csv") == content
        assert archive.getinfo("accelerometer.csv").date_time[0] > 2020  # the time of the file


def test_a_path_keeps_its_newest_rows_in_the_bytes_of_its_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdr_filter.apps.live.session._MAX_PATH", 100)
    rows = np.arange(450.0).reshape(150, 3)
    path = PathRows(3, rows[:20])
    for row in rows[20:]:
        path.append(row.tolist())
    np.testing.assert_array_equal(path.values, rows[-100:])
    np.testing.assert_array_equal(PathRows(3, rows).values, rows[-100:])


def test_a_session_with_a_long_journal_is_loaded_in_little_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after hours of a full disk, on which no state could be saved."""
    monkeypatch.setattr(live_session, "_LOAD_MESSAGES", 10)
    peaks_bytes: list[int] = []
    for n in (40, 40, 120):  # the first one loads the filter
        folder = tmp_path / str(len(peaks_bytes))
        session = DeviceSession("p", "s", Settings(platform="android"), folder)
        for number in range(n):
            rows = [[number + 0.02 * k, 0.1, 0.2, 9.81] for k in range(50)]
            content = {"number": number, "samples": {"accelerometer": rows, "gyroscope": rows}}
            session.recorder.journal(parse(json.dumps(content).encode(), "p", "s"))
        tracemalloc.start()
        try:
            loaded = DeviceSession.load("p", "s", session.settings, folder)
            peaks_bytes.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        assert loaded.assembly.next_number == n
        assert len((folder / loaded.id / "accelerometer.csv").read_text().splitlines()) == 1 + 50 * n
    assert peaks_bytes[2] - peaks_bytes[1] < 200_000
