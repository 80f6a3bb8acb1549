"""From messages of one session to samples as the filter takes them: in order, each once, specific force whole.

The first two seconds say what a session is: which sensors there are, whose sign the forces have, whether there are
locations. Until then its messages wait. An app that counts its messages has them put in order; one that is missing is
waited for until three seconds of later samples are there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pdr_filter.io import limits
from pdr_filter.live.messages import FORCE, GRAVITY, LINEAR, RAW, Message, Rows
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples

PRELUDE_S = 2.0
# A phone without acceleration is told so; sensors of one phone start within a second or two.
_NO_FORCE_S = 10.0
# Sensor Logger sends again within some seconds, or never.
_WAIT_S = 3.0
_MAX_HELD = 64
# Gravity is interpolated to the times of the accelerometer as in the files of the same app, `io.sensor_logger`.
_GRAVITY_GAP_S = 0.3
_GRAVITY_WAIT_S = 1.0
# A value from longer before the first specific force is one that the phone remembered.
_STALE_S = 60.0

_NONE = np.empty(0)
_NO_ROWS = np.empty((0, 3))


class SessionError(ValueError):
    """A session that cannot be tracked; the words say why and what to change on the phone."""


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """What the first seconds say of a session."""

    force: str  # the sensor that specific force comes from
    scale: float  # its unit and sign
    how: str  # the same in words
    zero_ns: int  # time zero where the phone's times are nanoseconds
    has_location: bool


@dataclass(frozen=True, slots=True, eq=False)
class Assembly:
    """What is kept of a session between its messages, without those that wait."""

    kind: Kind | None = None
    next_number: int = -1  # of the message that comes next, from an app that counts; -1 before the first
    last_s: float = -np.inf  # of the samples that were passed on
    linear_s: FloatArray = field(default_factory=lambda: _NONE)  # linear acceleration that waits for gravity
    linear: FloatArray = field(default_factory=lambda: _NO_ROWS)
    gravity_s: FloatArray = field(default_factory=lambda: _NONE)  # the last of gravity
    gravity: FloatArray = field(default_factory=lambda: _NO_ROWS)
    n_repeated: int = 0  # messages that came again, or after they had been given up
    n_lost: int = 0  # messages that never came


# Samples of one message by sensor, in seconds; specific force is whole.
Streams = dict[str, Samples]


def take(
    state: Assembly, held: Sequence[Message], message: Message, platform: str
) -> tuple[Assembly, list[Message], list[Streams]]:
    """State, the messages that wait, and what became ready; SessionError if the session cannot be tracked."""
    numbers = {m.number for m in held if m.number is not None}
    if message.number is not None and (message.number < state.next_number or message.number in numbers):
        return replace(state, n_repeated=state.n_repeated + 1), list(held), []
    waiting = [*held, message]
    if state.kind is None:
        kind = _kind(waiting, platform)
        if kind is None:
            return state, waiting, []
        state = replace(state, kind=kind)
    return _released(state, waiting, is_last=False)


def finish(state: Assembly, held: Sequence[Message], platform: str) -> tuple[Assembly, list[Message], list[Streams]]:
    """The same when nothing else will come."""
    if state.kind is None:
        kind = _kind(held, platform, is_last=True)
        if kind is None:
            return state, [], []
        state = replace(state, kind=kind)
    return _released(state, list(held), is_last=True)


def _released(state: Assembly, waiting: list[Message], is_last: bool) -> tuple[Assembly, list[Message], list[Streams]]:
    """Messages whose turn it is, as samples."""
    uncounted = [m for m in waiting if m.number is None]
    counted = sorted((m for m in waiting if m.number is not None), key=_number)
    ready: list[Streams] = []
    for message in uncounted:
        state, samples = _samples(state, message, is_last)
        ready.append(samples)
    while counted:
        missing = 0 if state.next_number < 0 else _number(counted[0]) - state.next_number
        newest_s = max(_last_s(state, m) for m in counted)
        given_up = is_last or len(counted) > _MAX_HELD or newest_s - state.last_s > _WAIT_S
        if missing and not given_up:
            break
        message = counted.pop(0)
        state = replace(state, next_number=_number(message) + 1, n_lost=state.n_lost + missing)
        state, samples = _samples(state, message, is_last and not counted)
        ready.append(samples)
    return state, counted, [samples for samples in ready if samples]


def _number(message: Message) -> int:
    return -1 if message.number is None else message.number


def _samples(state: Assembly, message: Message, is_last: bool) -> tuple[Assembly, Streams]:
    """The samples of one message, each sensor in order of time."""
    kind = state.kind
    assert kind is not None
    found: Streams = {}
    for name, rows in message.rows.items():
        time_s = seconds(rows, kind.zero_ns)
        kept = time_s > (0.0 if kind.zero_ns else -np.inf) - _STALE_S
        order = np.argsort(time_s[kept], kind="stable")
        found[name] = Samples(time_s[kept][order], rows.values[kept][order])
    if kind.force == LINEAR:
        state, force = _with_gravity(state, found.get(LINEAR), found.get(GRAVITY), is_last)
    else:
        force = found.get(kind.force)
    ready: Streams = {} if force is None else {FORCE: Samples(force.time_s, kind.scale * force.values)}
    ready |= {name: found[name] for name in ("gyroscope", "magnetometer", "barometer", "location") if name in found}
    ready = {name: rows for name, rows in ready.items() if len(rows)}
    if FORCE in ready:
        state = replace(state, last_s=max(state.last_s, float(ready[FORCE].time_s[-1])))
    return state, ready


def _with_gravity(
    state: Assembly, linear: Samples | None, gravity: Samples | None, is_last: bool
) -> tuple[Assembly, Samples]:
    """Specific force without its scale where gravity is known on both sides, or will not be."""
    linear_s, values = _appended(state.linear_s, state.linear, linear)
    gravity_s, known = _appended(state.gravity_s, state.gravity, gravity)
    order = np.argsort(gravity_s, kind="stable")
    gravity_s, known = gravity_s[order], known[order]
    newest_s = float(gravity_s[-1]) if len(gravity_s) else -np.inf
    if len(linear_s):
        newest_s = np.inf if is_last else max(newest_s, float(linear_s[-1]) - _GRAVITY_WAIT_S)
    ready = linear_s <= newest_s
    force = values[ready] + _at_times(gravity_s, known, linear_s[ready])
    begin_s = min([newest_s, *linear_s[~ready]]) - 2 * _GRAVITY_GAP_S
    later = gravity_s >= begin_s
    state = replace(
        state, linear_s=linear_s[~ready], linear=values[~ready], gravity_s=gravity_s[later], gravity=known[later]
    )
    finite = np.isfinite(force).all(axis=1)
    return state, Samples(linear_s[ready][finite], force[finite])


def _appended(time_s: FloatArray, values: FloatArray, rows: Samples | None) -> tuple[FloatArray, FloatArray]:
    if rows is None:
        return time_s, values
    return np.concatenate([time_s, rows.time_s]), np.concatenate([values, rows.values])


def _at_times(known_s: FloatArray, known: FloatArray, at_s: FloatArray) -> FloatArray:
    """Values interpolated linearly, NaN where nothing is near."""
    if len(known_s) == 0:
        return np.full((len(at_s), 3), np.nan)
    values = np.column_stack([np.interp(at_s, known_s, known[:, i]) for i in range(3)])
    right = np.clip(np.searchsorted(known_s, at_s), 0, len(known_s) - 1)
    left = np.maximum(right - 1, 0)
    gap_s = np.minimum(np.abs(known_s[right] - at_s), np.abs(known_s[left] - at_s))
    return np.where(gap_s[:, None] <= _GRAVITY_GAP_S, values, np.nan)


def seconds(rows: Rows, zero_ns: int) -> FloatArray:
    """Times in seconds: nanoseconds from time zero, as the files of the same apps are read; seconds as they are."""
    if rows.time.dtype.kind == "f":
        return rows.time.astype(np.float64)
    return (rows.time - zero_ns).astype(np.float64) * 1e-9  # the difference is exact in int64


def _last_s(state: Assembly, message: Message) -> float:
    zero_ns = 0 if state.kind is None else state.kind.zero_ns
    return max([-np.inf, *(float(seconds(r, zero_ns).max()) for r in _moving(message) if len(r.time))])


def _moving(message: Message) -> Iterator[Rows]:
    """Sensors whose times are those of the walk: a location may be from long before."""
    for name in (FORCE, LINEAR, RAW, "gyroscope"):
        if name in message.rows:
            yield message.rows[name]


# --- what the first seconds say ---------------------------------------------------------------------------------------


def _kind(messages: Sequence[Message], platform: str, is_last: bool = False) -> Kind | None:
    """What a session is; None while too little of it is there."""
    times = [rows.time for m in messages for rows in _moving(m) if len(rows.time)]
    if not times:
        return None
    unit_s = 1.0 if times[0].dtype.kind == "f" else 1e-9
    every: Any = np.concatenate(times)
    recent = every[every > every.max() - _STALE_S / unit_s]
    span_s = float(recent.max() - recent.min()) * unit_s
    if span_s < PRELUDE_S and not is_last:
        return None
    first = {name: _together(messages, name) for name in (FORCE, LINEAR, GRAVITY, RAW, "attitude")}
    force = next((name for name in (FORCE, LINEAR, RAW) if _is_usable(name, first)), None)
    if force is None:
        if span_s < _NO_FORCE_S and not is_last:
            return None
        sensors = sorted({name for m in messages for name in m.rows})
        raise SessionError(
            f"no acceleration with gravity in it (sent: {', '.join(sensors)}); switch on Accelerometer and Gravity, or "
            "Total Acceleration, in the app"
        )
    rows = first[force]
    assert rows is not None
    platform = next((m.platform for m in messages if m.platform), platform)
    scale, how = _scale(force, first, platform)
    zero_ns = 0 if rows.time.dtype.kind == "f" else int(rows.time[rows.time >= recent.min()].min())
    return Kind(force, scale, how, zero_ns, any("location" in m.rows for m in messages))


def _is_usable(name: str, first: Mapping[str, Rows | None]) -> bool:
    return first[name] is not None and (name != LINEAR or first[GRAVITY] is not None)


def _together(messages: Sequence[Message], name: str) -> Rows | None:
    parts = [m.rows[name] for m in messages if name in m.rows and len(m.rows[name].time)]
    if not parts:
        return None
    time: Any = np.concatenate([rows.time for rows in parts])
    return Rows(time, np.concatenate([rows.values for rows in parts]))


def _scale(force: str, first: Mapping[str, Rows | None], platform: str) -> tuple[float, str]:
    """By what the numbers of a sensor are multiplied, and how that is known; SessionError if it is not."""
    if force == FORCE:
        return (-1.0, "iOS: sign turned") if platform == "ios" else (1.0, "as it is")
    rows = first[GRAVITY] if force == LINEAR else first[RAW]
    assert rows is not None
    unit, size = 1.0, float(np.nanmedian(np.linalg.norm(rows.values, axis=1)))
    if force == RAW and limits.G_RANGE[0] <= size <= limits.G_RANGE[1]:
        return -STANDARD_GRAVITY_MPS2, "g, so iOS: sign turned"
    attitude = first["attitude"]
    up = np.nan if attitude is None else _up_cosine(rows, attitude)
    if up > limits.UP_COSINE_DOUBTFUL:
        return unit, "sign as it is, by the phone's own attitude"
    if up < limits.UP_COSINE_WRONG_SIGN:
        return -unit, "sign turned, by the phone's own attitude"
    if platform in ("ios", "android"):
        return (-unit, "iOS: sign turned") if platform == "ios" else (unit, "Android: sign as it is")
    raise SessionError(
        "iOS and Android have opposite signs, and nothing says which phone this is; switch on Orientation in the app, "
        "or start the server with --platform ios or --platform android"
    )


def _up_cosine(force: Rows, attitude: Rows) -> float:
    """Mean cosine between specific force, turned into the world by the nearest attitude, and up."""
    at = np.clip(np.searchsorted(attitude.time, force.time), 0, len(attitude.time) - 1)
    w, x, y, z = attitude.values[at].T
    up = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), w**2 - x**2 - y**2 + z**2])
    norm = np.linalg.norm(force.values, axis=1) * np.linalg.norm(up, axis=1)
    cosine = (force.values * up).sum(axis=1) / np.where(norm > 0, norm, np.nan)
    return float(np.nanmean(cosine)) if np.isfinite(cosine).any() else np.nan
