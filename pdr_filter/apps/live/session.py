"""Session of one phone: its filter, recording and saved state. Messages come in, events go out."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import time
from array import array
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter import recipes
from pdr_filter.apps.batch.worker_process import reason_of
from pdr_filter.apps.live import assembly
from pdr_filter.apps.live.assembly import Assembly, LateError, SessionError
from pdr_filter.apps.live.messages import FORCE, Message
from pdr_filter.apps.live.recorder import DEVICE, STATE, STEPS, DamagedError, Recorder, reading
from pdr_filter.apps.live.settings import Event, FixError, Settings
from pdr_filter.filter.pedestrian.alignment import Pose
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.stream_merging import Sensor
from pdr_filter.tracking.filtering import frame_name
from pdr_filter.tracking.georeferencing import live_config
from pdr_filter.tracking.online import OnlineFilter
from pdr_filter.tracking.warnings import device_notes
from pdr_filter.values import FixResult, FloatArray, PositionFix, RangeFix, Samples, interpolated_rows, limits
from pdr_filter.values import serialisation as serialise
from pdr_filter.values.recording import Recording
from pdr_filter.values.sanitise import file_name

# Newest positions that the page shows: three hours of walking.
_MAX_PATH = 20_000
# Shortest times between two `now` events, and between two `track` events of a path whose north is not settled. Turning
# a step costs some 50 us, so a path of hours is sent less often.
_NOW_S, _TURN_S, _TURN_STEP_S = 0.2, 5.0, 0.005
# Pages get the path again where it was corrected by more than this, no more often than this.
_CORRECTED_M, _CORRECTED_S = 1.0, 2.0
# Entries of the charts for a page that is opened late: five minutes.
_HISTORY, _HISTORY_STEP_S = 300, 1.0
# Samples that are pushed at once. `sensing.stream_merging` keeps no more waiting rows of the fastest phones.
_PART_S = 10.0
# Messages of a journal that are filtered at once, so that their samples need little memory.
_LOAD_MESSAGES = 100
_MAX_NOTES = 20
_FIX_STD_RANGE_M = (0.01, 1000.0)
# Folder with a file for each phone: its gyroscope bias at the end of its latest session.
DEVICES = "devices"
_LOG = logging.getLogger(__package__)


@lru_cache(maxsize=64)
def plain_config(settings: Settings) -> Config:
    """Configuration of a session before its first samples are known."""
    empty = Samples(np.empty(0), np.empty((0, 3)))
    return recipes.for_recording(settings.recipe, Recording("live", empty, meta=settings.meta))


@lru_cache(maxsize=64)
def plain_config_bytes(settings: Settings) -> bytes:
    """Saved form of `plain_config`, which is shared by all phones of equal settings.

    ValueError for a recipe with parts of classes outside of this package: sessions are saved with their configuration.
    """
    try:
        return serialise.to_bytes(plain_config(settings))
    except TypeError as error:
        raise ValueError(
            f"recipe {settings.recipe!r} has parts of classes outside of pdr_filter, and sessions of phones are saved "
            f"with their configuration ({error}): use an OnlineFilter of your own, or a recipe of parts of the package"
        ) from None


def session_id(device: str, session: str) -> str:
    """Return a session's name for addresses and folders: letters of the device name and a checksum."""
    letters = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in file_name(device))[:40]
    return f"{letters}-{hashlib.sha256(json.dumps([device, session]).encode()).hexdigest()[:12]}"


class DeviceSession:
    """One session of one phone: its filter, its recording, and its waiting messages."""

    def __init__(self, device: str, session: str, settings: Settings, folder: Path) -> None:
        self.id = session_id(device, session)
        self.device, self.session, self.settings = device, session, settings.of_phone(device, {})
        self.name = ""  # that the phone gives the recording
        self.recorder = Recorder(folder / self.id)
        self._known_device = folder / DEVICES / f"{session_id(device, '')}.json"  # from earlier sessions of the phone
        self._device: Device | None = None  # with which this session began
        self.assembly, self.held = Assembly(), list[Message]()
        self.online: OnlineFilter | None = None
        self.refused = ""  # reason why the session cannot be tracked
        self.unloaded = ""  # reason why the files of the session are not loaded before its next message
        self.has_ended = False
        self.begun_unix_s: float | None = None  # when the first message came
        self.notes: tuple[str, ...] = ()  # about the session as a whole, besides those of the filter
        self._ready: list[assembly.Streams] = []  # samples that are not filtered yet
        self._ready_s = 0.0  # time that they span
        self._received_s = math.nan  # unix time of the last message
        self._told: Event = {}  # by the last `session` event
        self.path = PathRows(6)  # time, east, north and the covariance ee, en, nn after each step
        # For each row of `path`: the place in the frame of the start, if the row still turns until north is settled.
        self._starts: deque[Pose | None] = deque(maxlen=_MAX_PATH)
        self._drawn = PathRows(3)  # time, east and north of the path that pages draw
        self._unsaved_at = math.inf  # monotonic time of the first change that is not saved
        self._history: deque[Event] = deque(maxlen=_HISTORY)  # of `now` events, for the charts
        self._is_untold = False  # whether samples came after the last `now` event
        self._judged: tuple[FixResult, ...] = ()  # fixes whose outcome was already sent
        self._now_at, self._turn_at, self._drawn_at, self._advanced_at = -math.inf, -math.inf, -math.inf, -math.inf
        self.seen_at = time.monotonic()

    # --- messages ---

    def begin(self) -> None:
        """Give a new session the gyroscope bias of the phone's latest session, if there is one."""
        if self._known_device.exists():
            days = max(time.time() - self._known_device.stat().st_mtime, 0.0) / 86400.0
            with suppress(DamagedError):
                self._device = load_device(self._known_device).after(days)
                self._device.save(self.recorder.folder / DEVICE)

    def is_kept(self, message: Message) -> bool:
        """Return True if a message belongs in the journal, False if it came before, too late or after the end."""
        return not self.has_ended and self._is_new(message)

    def _is_new(self, message: Message) -> bool:
        try:
            return not assembly.remembered(self.assembly, self.held, message)[1]
        except LateError:
            return False

    def take(self, message: Message, received_s: float = math.nan) -> list[Event]:
        """Take a message, which `advance` filters, and return the events that it causes. The journal has it before.

        FixError or LateError if the message cannot be used, SessionError if the session has ended. A message of a
        session that cannot be tracked changes nothing, and `refused` holds the reason.
        """
        if self.has_ended and self._is_new(message):
            raise SessionError("this session has ended; begin a new one")
        self._received_s, self.seen_at = received_s, time.monotonic()
        self._unsaved_at = min(self._unsaved_at, self.seen_at)
        if self.refused:
            return []
        try:
            if message.fix is not None:
                events = self.advance()
                known, came_before = assembly.remembered(self.assembly, self.held, message)
                if not came_before:
                    events += [self._fixed(message.fix), *self._now(is_due=True)]
                    self.assembly = known
                return events
            if self.online is None:
                self.settings = self.settings.of_phone(self.device, message.meta)
                self.name = message.meta.get("name", self.name)
                self.notes = tuple(dict.fromkeys((*self.notes, *message.notes)))[:_MAX_NOTES]
            self.assembly, self.held, ready = assembly.take(self.assembly, self.held, message, self.settings.platform)
            self._record(ready)
            return self.finish() if message.is_end and not self.has_ended else []
        except (FixError, LateError, MemoryError):
            raise
        except Exception as error:
            return self._refuse(error)

    def _record(self, ready: Sequence[assembly.Streams]) -> None:
        """Append samples to the recording, and keep them for the filter, which is created at the first samples."""
        if ready and self.online is None:
            self.online = OnlineFilter(self._begun(_joined(ready)))
        for samples in ready:
            for name, rows in samples.items():
                self.recorder.samples(name, rows)
            self._ready_s += float(np.ptp(samples[FORCE].time_s)) if FORCE in samples else 0.0
        self._ready += ready

    def is_due(self, wait_s: float) -> bool:
        """Return True if samples of `wait_s` seconds wait, or if the last call of `advance` was twice as long ago.

        A worker that is behind so filters more at once, and needs less time for it.
        """
        return self._ready_s >= wait_s or time.monotonic() - self._advanced_at >= 2 * wait_s

    def advance(self) -> list[Event]:
        """Filter the samples of all messages that `take` received, and return the events. May set `refused`.

        MemoryError ends the process, which says less about the session than about all of them.
        """
        ready, self._ready, self._ready_s, self._advanced_at = self._ready, [], 0.0, time.monotonic()
        if self.refused:
            return []
        try:
            return [*self._filtered(_joined(ready)), *self._about_changed()]
        except MemoryError:
            raise
        except Exception as error:
            return self._refuse(error)

    def _refuse(self, error: Exception) -> list[Event]:
        """Track the session no longer. An error of any other kind stops one session only, whose journal goes on."""
        if not isinstance(error, ValueError):
            _LOG.error("%s: not tracked any more", self.recorder.folder, exc_info=error)
        self.refused, self.held = reason_of(error), []
        return self._about_changed()

    def release(self) -> list[Event]:
        """Filter the messages that wait for a missing one, after a long silence of the phone, and return the events."""
        self.assembly, self.held, ready = assembly.release(self.assembly, self.held)
        self._record(ready)
        events = self.advance()
        self._keep_device()
        return events

    def finish(self) -> list[Event]:
        """Filter the last steps, when no further message can arrive, and return the events. The session then ends."""
        self.assembly, self.held, ready = assembly.finish_assembly(self.assembly, self.held, self.settings.platform)
        self._record(ready)
        events = self.advance()
        if self.refused:
            return events
        if self.online is not None:
            events += self._stepped(self.online.finish())
        self.has_ended = True
        self._keep_device()
        told = [*self._outcomes(), *self._about_changed(), *self._turned(is_due=True), *self._corrected(is_due=True)]
        return [*events, *told, *self._now(is_due=True)]

    def _filtered(self, samples: assembly.Streams) -> list[Event]:
        if self.online is None or not samples:
            return []
        events = self._stepped(_pushed(self.online, samples))
        return [*events, *self._outcomes(), *self._turned(), *self._corrected(), *self._now()]

    def _begun(self, samples: assembly.Streams) -> Config:
        """Return the configuration for the sensors in the first samples, and record it and metadata."""
        kind = assembly.known_kind(self.assembly)
        name = self.name or f"{self.device} {self.session}".strip()[: limits.MAX_NAME_CHARS] or self.id
        meta: dict[str, Any] = {
            "name": file_name(name),
            "source": "pdr-filter live",
            "accelerometer": f"{kind.force}, {kind.how}",
        }
        if kind.zero_ns:
            meta["epoch_ns"] = kind.zero_ns
        meta |= self.settings.meta
        first = Recording(name, **cast(Any, samples), meta=meta)
        plain = plain_config(self.settings)
        config = live_config(first, plain)
        self.recorder.describe(
            meta, plain_config_bytes(self.settings) if config is plain else serialise.to_bytes(config)
        )
        return self._with_device(config)

    def _with_device(self, config: Config) -> Config:
        """Return the configuration with the gyroscope bias from an earlier session, if this session began with one."""
        return config if self._device is None else config.with_device(self._device)

    def _keep_device(self) -> None:
        """Write the gyroscope bias of the phone for its next session, if this session has taught at least half."""
        if self.online is None:
            return
        plain, learnt = plain_config(self.settings).sensing, self.online.device
        unknown = plain.device(plain.init())
        if np.trace(learnt.bias_cov_radps2) > 0.5 * np.trace(unknown.bias_cov_radps2):
            return
        with suppress(OSError):  # the next session then learns the bias without it
            learnt.save(self._known_device)

    def _fixed(self, content: Any) -> Event:
        """Add a fix of a user, in the frame of the track or as latitude and longitude; return its `fix` event.

        One with `range_m` is a range to an anchor there (`east_m` and `north_m`, or latitude and longitude). Without
        `time_s`, the fix is of the present time. FixError if it cannot be used.
        """
        online = self.online
        if online is None:
            raise FixError("the track has not begun yet: give the fix when it has begun")
        now = online.now()
        try:
            std_m = float(content.get("std_m", 1.0))
            # samples are on the clock of the phone, and `now` on that of the track, which is never set back
            time_s = float(content.get("time_s", now.time_s - online.state.clock_offset_s))
            if "latitude_deg" in content:
                if online.origin is None:
                    raise FixError("the track lies nowhere on Earth yet: give east_m and north_m")
                place = float(content["latitude_deg"]), float(content["longitude_deg"])
                east_m, north_m = map(float, online.origin.east_north_m(*place))
            else:
                east_m, north_m = float(content["east_m"]), float(content["north_m"])
            if not _FIX_STD_RANGE_M[0] <= std_m <= _FIX_STD_RANGE_M[1]:
                raise FixError(f"std_m must be {_FIX_STD_RANGE_M[0]} to {_FIX_STD_RANGE_M[1]} m, got {std_m}")
            position_m = np.array([east_m, north_m])
            range_m = content.get("range_m")
            fix = (
                PositionFix(time_s, position_m, std_m**2 * np.eye(2))
                if range_m is None
                else RangeFix(time_s, position_m, float(range_m), std_m)
            )
            result = online.add_fix(fix)
        except KeyError as error:
            raise FixError(f"the fix has no {error}: see docs/live.md") from None
        except (TypeError, ValueError) as error:
            raise error if isinstance(error, FixError) else FixError(str(error)) from None
        event = {**self._outcome(result), "east_m": east_m, "north_m": north_m, "std_m": std_m}
        if range_m is None:
            self.recorder.fix(time_s, east_m, north_m, std_m)
            return event
        self.recorder.range(time_s, east_m, north_m, float(range_m), std_m)
        return {**event, "range_m": float(range_m)}

    # --- events ---

    def about(self) -> Event:
        """Return the `session` event: properties of the session, with the reason why it waits or cannot be tracked."""
        kind, origin = self.assembly.kind, None if self.online is None else self.online.origin
        set_backs = [
            f"the clock of the phone was set back by {size_s:.1f} s at {at_s:.1f} s: times go on from there"
            for at_s, size_s in self.assembly.set_backs
        ]
        of_device = [] if self.online is None else device_notes(self.online.config, self.online.state)
        waits = self.unloaded
        if not (self.unloaded or self.refused):
            waits = assembly.reason_to_wait(self.assembly, self.held, self.settings.platform)
        return {
            "event": "session",
            "id": self.id,
            "device": self.device,
            "session": self.session,
            "begun_unix_s": self.begun_unix_s,
            "force": "" if kind is None else f"{kind.force}, {kind.how}",
            "has_location": kind is not None and kind.has_location,
            "origin": None if origin is None else [origin.latitude_deg, origin.longitude_deg],
            "frame": "" if self.online is None else frame_name(self.online.config, self.online.state),
            "waits": waits,
            "refused": self.refused,
            "has_ended": self.has_ended,
            "notes": [*self.notes, *set_backs, *of_device],
            "n_lost_messages": self.assembly.n_lost,
            "n_repeated_messages": self.assembly.n_repeated,
        }

    def _about_changed(self) -> list[Event]:
        """Return a list with the `session` event if it has changed since the last call, otherwise an empty list."""
        about = self.about()
        if about == self._told:
            return []
        self._told = about
        return [about]

    def _stepped(self, updates: Iterable[StepUpdate]) -> list[Event]:
        events: list[Event] = []
        for update in updates:
            content = update.to_dict()
            if update.is_final:
                self.recorder.step(json.dumps(content))
                self._add(update)
            events.append({"event": "step", "id": self.id, **content})
        return events

    def _outcomes(self) -> list[Event]:
        """Return events for fixes and locations of the phone with a new outcome."""
        results = () if self.online is None else self.online.state.last.fixes
        new = [self._outcome(result) for result in results if result not in self._judged]
        self._judged = results
        return new

    def _outcome(self, result: FixResult) -> Event:
        return {"event": "fix", "id": self.id, **result.to_dict()}

    def _add(self, update: StepUpdate) -> None:
        row = _row(update.step.time_s, update.position_m, update.position_cov_m2)
        self.path.append(row)
        self._starts.append(update.of_start)
        self._drawn.append(row[:3])

    def _now(self, is_due: bool = False, is_live: bool = True) -> list[Event]:
        online = self.online
        self._is_untold = online is not None and time.monotonic() - self._now_at < _NOW_S and not is_due
        if online is None or self._is_untold:
            return []
        self._now_at = time.monotonic()
        sent = self._received_s if is_live and not math.isnan(self._received_s) else None
        now = online.now().to_dict()
        last_s = self._history[-1]["time_s"] if self._history else -math.inf
        if now["time_s"] is not None and not 0 <= now["time_s"] - last_s < _HISTORY_STEP_S:
            self._history.append({name: now[name] for name in ("time_s", "context_prob", "walking_speed_mps")})
        silent_s = time.monotonic() - self.seen_at
        return [{"event": "now", "id": self.id, "received_unix_s": sent, "silent_s": silent_s, **now}]

    def _turned(self, is_due: bool = False) -> list[Event]:
        """Return a list with a `track` event now and then while north is uncertain, otherwise an empty list.

        The whole path rotates with the estimate of north. The event is also sent once when north has become certain.
        """
        online = self.online
        wait_s = _TURN_S + len(self.path) * _TURN_STEP_S
        if online is None or (time.monotonic() - self._turn_at < wait_s and not is_due):
            return []
        frame = online.state.pedestrian.frame
        if not frame.is_known or all(place is None for place in self._starts):
            return []
        self._turn_at, drawn = time.monotonic(), frame.at_most_probable_rotation()
        rows = self.path.values
        for row, start in zip(rows, self._starts, strict=True):
            if start is not None:
                place = drawn.world(start)
                row[:] = _row(row[0], place.position_m, place.cov_m2)
        if frame.is_joined:  # for good
            self._starts = deque([None] * len(rows), maxlen=_MAX_PATH)
        self.path, self._drawn = PathRows(6, rows), PathRows(3, rows[:, :3])
        return [self.track()]

    def _corrected(self, is_due: bool = False) -> list[Event]:
        """Return a list with a `path` event if later samples and fixes moved the drawn path by more than a metre.

        The list is empty within two seconds of the previous check, unless `is_due`.
        """
        if self.online is None or (time.monotonic() - self._drawn_at < _CORRECTED_S and not is_due):
            return []
        self._drawn_at = time.monotonic()
        path = self.online.path()
        rows = np.column_stack([path.time_s, path.position_m])[: path.n_steps]
        if not len(rows) or not self._drawn:
            return []
        drawn = self._drawn.values
        off_m = interpolated_rows(drawn[:, 0], rows[:, 0], rows[:, 1:]) - drawn[:, 1:]
        if np.hypot(*off_m.T).max() <= _CORRECTED_M:
            return []
        self._drawn = PathRows(3, rows)
        return [self._drawn_path()]

    def _drawn_path(self) -> Event:
        return {"event": "path", "id": self.id, "path": self._drawn.values.tolist()}

    def track(self) -> Event:
        """Return the event with the session and its path: time, east, north, covariance (ee, en, nn) of each step."""
        silent_s = time.monotonic() - self.seen_at
        return {**self.about(), "event": "track", "silent_s": silent_s, "path": self.path.values.tolist()}

    def rest(self) -> list[Event]:
        """Return a list with a `now` event for the last samples if they came too soon after the previous event."""
        return self._now(is_due=True, is_live=False) if self._is_untold else []

    def snapshot(self) -> list[Event]:
        """Return the events that show the whole session to a newly opened page."""
        track = {**self.track(), "history": list(self._history)}
        return [track, self._drawn_path(), *self._now(is_due=True, is_live=False)]

    @property
    def unsaved_s(self) -> float:
        """Time since the first change that was not saved, s. 0 if all are saved."""
        return max(time.monotonic() - self._unsaved_at, 0.0)

    def save(self) -> list[Event]:
        """Filter what waits, write the state of a session that is tracked, and return the events.

        A session that is not tracked goes on from its journal, and so does one whose state cannot be written.
        A saved state ends the journal, so that samples which it does not know would be missing in the track.
        """
        events, self._unsaved_at = self.advance(), math.inf
        try:
            if self.online is None or self.refused:
                self.recorder.flush()
            else:
                known = {"assembly": self.assembly, "state": self.online.state, "notes": self.notes}
                self.recorder.save(known, self.held)
        except OSError as error:
            self._unsaved_at = time.monotonic()
            _LOG.warning("%s: the state cannot be saved (%s) and is tried again", self.recorder.folder, error.strerror)
        return events

    @classmethod
    def load(cls, device: str, session: str, settings: Settings, folder: Path) -> DeviceSession:
        """Return the session with all acknowledged messages, however the last process ended.

        DamagedError if its files cannot be those that were written. An OSError is no damage.
        """
        self = cls(device, session, settings, folder)
        files = list((folder / self.id).iterdir())
        silent_s = time.time() - max((file.stat().st_mtime for file in files), default=0.0)
        with self.recorder.trying():
            self._resume()
        self.save()
        self._drawn = PathRows(3, self.path.values[:, :3])
        self._turned(is_due=True)
        self._corrected(is_due=True)
        self.seen_at = time.monotonic() - max(silent_s, 0.0)
        return self

    def _resume(self) -> None:
        """Continue from the saved state, and take the messages of the journal."""
        saved, messages = self.recorder.load()
        if (path := self.recorder.folder / DEVICE).exists():
            self._device = load_device(path)
        with reading(STATE):
            if saved is not None:
                self._restore(saved)
        for number, message in enumerate(messages, start=1):
            with suppress(FixError, LateError, SessionError):
                self.take(message)
            if number % _LOAD_MESSAGES == 0:
                self.advance()
                with suppress(OSError):  # on a full disk, lines wait in memory
                    self.recorder.flush()
        self.advance()

    def _restore(self, saved: Mapping[str, Any]) -> None:
        self.assembly, self.notes = saved["assembly"], saved.get("notes", ())
        self.online = OnlineFilter(self._with_device(self.recorder.config()))
        self.online.state = saved["state"]
        self.has_ended = self.online.state.finished
        self._judged = self.online.state.last.fixes
        with reading(STEPS):
            for step in self.recorder.steps():
                self.path.append(_row(step["time_s"], step["position_m"], np.array(step["position_cov_m2"])))
                start = step["of_start"]
                self._starts.append(None if start is None else _pose(start))


class PathRows:
    """The newest `_MAX_PATH` rows of `width` numbers each, in a tenth of the memory of a list of lists."""

    def __init__(self, width: int, rows: FloatArray | None = None) -> None:
        self._width = width
        self._values = array("d", b"" if rows is None else rows[-_MAX_PATH:].tobytes())

    def __len__(self) -> int:
        return len(self._values) // self._width

    def append(self, row: Sequence[float]) -> None:
        """Append a row, and forget the oldest one if there are too many."""
        self._values.extend(row)
        del self._values[: max(len(self) - _MAX_PATH, 0) * self._width]

    @property
    def values(self) -> FloatArray:
        """A copy of the rows, shape (N, width)."""
        return np.array(self._values).reshape(-1, self._width)


def load_device(path: Path) -> Device:
    """Return the device of a file. DamagedError if it holds none, OSError if it cannot be read."""
    path.read_bytes()  # because `Device.load` has one kind of error for both
    with reading(path.name):
        return Device.load(path)


def _pushed(online: OnlineFilter, samples: assembly.Streams) -> list[StepUpdate]:
    """Push samples of all sensors to a filter, long stretches in parts, and return its updates."""
    begin_s = min(float(stream.time_s[0]) for stream in samples.values())
    parts = {name: np.floor((stream.time_s - begin_s) / _PART_S) for name, stream in samples.items()}
    updates: list[StepUpdate] = []
    for part in np.unique(np.concatenate(list(parts.values()))):
        rows: assembly.Streams = {}
        for name, stream in samples.items():
            first, last = np.searchsorted(parts[name], [part, part + 1])
            if last > first:
                rows[name] = Samples(stream.time_s[first:last], stream.values[first:last])
        location = rows.pop("location", None)
        # locations that began later than the track are only recorded
        if location is not None and not online.config.model.frame.is_joined:
            latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
            online.push_location(location.time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m)
        updates += online.push_streams(cast("dict[Sensor, Samples]", rows))
    return updates


def _joined(ready: Sequence[assembly.Streams]) -> assembly.Streams:
    """Return the samples of several messages joined, with each sensor in order of time."""
    if len(ready) == 1:
        return ready[0]
    found: assembly.Streams = {}
    for name in dict.fromkeys(name for samples in ready for name in samples):
        rows = [samples[name] for samples in ready if name in samples]
        time_s, values = np.concatenate([r.time_s for r in rows]), np.concatenate([r.values for r in rows])
        order = np.argsort(time_s, kind="stable")
        found[name] = Samples(time_s[order], values[order])
    return found


def _pose(content: Mapping[str, Any]) -> Pose:
    """Return the place from its JSON form that `StepUpdate.to_dict` writes."""
    position_m, cov_m2 = np.array(content["position_m"]), np.array(content["cov_m2"])
    return Pose(position_m, cov_m2, content["heading_rad"], content["n_steps"])


def _row(time_s: float, position_m: Any, cov_m2: Any) -> list[float]:
    return [float(v) for v in (time_s, *position_m, cov_m2[0, 0], cov_m2[0, 1], cov_m2[1, 1])]
