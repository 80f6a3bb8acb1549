"""Conversion of the messages of one session to samples for the filter: in order, each once, with gravity added.

Messages wait until two seconds of samples show the sensors, the sign of the specific force and whether there are
locations. Messages with a number are put in order. A missing number is waited for until three seconds of later samples
have come without any message of the hole. A numbered message whose samples all lie before those of the message before
it shows that the clock of the phone was set back: times go on from there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pdr_filter.apps.live.messages import FORCE, GRAVITY, LINEAR, RAW, Message, SensorRows, together
from pdr_filter.data.io.checks import up_cosine
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples, interpolated_near, limits, replace_unchecked

PRELUDE_S = 2.0
# A phone without acceleration is told so; sensors of one phone start within a second or two.
_NO_FORCE_S = 10.0
# Sensor Logger sends again within some seconds, or never.
_WAIT_S = 3.0
# Memory for messages that wait: ten minutes of four sensors at 100 Hz.
_MAX_HELD_BYTES = 25 * 1024**2
# Smaller overlaps of two messages are sensors that are read late. A set-back within a message needs as many samples
# after it, because a single old sample is one that the phone remembered.
_SET_BACK_S, _SET_BACK_SAMPLES = 1.0, 10
_GRAVITY_WAIT_S = 1.0
# A value from longer before the first specific force is one that the phone remembered.
_STALE_S = 60.0

_NONE = np.empty(0)
_NO_ROWS = np.empty((0, 3))


class SessionError(ValueError):
    """Error for a session that cannot be tracked. The message states the reason and what to change on the phone."""


class LateError(ValueError):
    """Error for a message that arrived after the server had stopped waiting for it.

    Its samples are not in the track.
    """


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """Properties of a live session that its first seconds show, such as unit and sign of the acceleration."""

    force: str  # name of the sensor from which the specific force is taken
    scale: float  # factor from the values of this sensor to m/s2 with Android's sign
    how: str  # description of unit and sign for messages
    zero_ns: int  # time that becomes zero if the times of the phone are in ns, else 0
    has_location: bool  # True if the messages contain locations


@dataclass(frozen=True, eq=False)
class Assembly:
    """State of a session between its messages, without the messages that still wait to be processed."""

    kind: Kind | None = None
    next_number: int = -1  # expected number of the next message if the app numbers them; -1 before the first
    given_up: tuple[tuple[int, int], ...] = ()  # first and last number of each gap that is no longer waited for
    hole_s: float = np.nan  # time since which missing messages are waited for; NaN if none is missing
    recent: tuple[str, ...] = ()  # digests of the last messages without a number
    last_s: float = -np.inf  # last time of the samples that were passed on
    ahead_s: float = 0.0  # correction of the phone's clock after backward jumps
    set_backs: tuple[tuple[float, float], ...] = ()  # time and size in s of each backward clock jump
    linear_s: FloatArray = field(default_factory=lambda: _NONE)  # linear acceleration for which gravity has not arrived
    linear: FloatArray = field(default_factory=lambda: _NO_ROWS)
    gravity_s: FloatArray = field(default_factory=lambda: _NONE)  # the last of gravity
    gravity: FloatArray = field(default_factory=lambda: _NO_ROWS)
    n_repeated: int = 0  # messages that came again
    n_lost: int = 0  # messages that did not come in time


# Messages without a number that are recognised when they come again: more than a worker is given at once.
_N_RECENT = 64
# Holes and set-backs that are remembered.
_N_HOLES = 1000
# Samples from which a wrong unit of times is recognised.
_RATE_SAMPLES = 400

_MOVING = (FORCE, LINEAR, RAW, "gyroscope")

# Samples of one message by sensor, in seconds; specific force is whole.
Streams = dict[str, Samples]


def take(
    state: Assembly, held: Sequence[Message], message: Message, platform: str
) -> tuple[Assembly, list[Message], list[Streams]]:
    """Return the state, the messages that wait, and the samples that became ready, by message and sensor.

    `held` are the messages that waited before, and `message` is the new one. If it came before, it is counted and
    dropped. `platform` ("ios", "android" or "") is used if no message names one. SessionError if the session cannot be
    tracked, LateError if the number of the message was given up.
    """
    state, came_before = remembered(state, held, message)
    if came_before:
        return replace_unchecked(state, n_repeated=state.n_repeated + 1), list(held), []
    waiting = [*held, message]
    if state.kind is None:
        kind = _kind(waiting, platform)
        if isinstance(kind, str):
            if _is_too_much(waiting):
                raise SessionError(f"there is still no track after {len(waiting)} messages: {kind}")
            return state, waiting, []
        state = replace_unchecked(state, kind=kind)
    return _released(state, waiting)


def finish_assembly(
    state: Assembly, held: Sequence[Message], platform: str
) -> tuple[Assembly, list[Message], list[Streams]]:
    """Return state, waiting messages and ready samples after the last message of a session.

    The kind of the acceleration is decided from fewer than two seconds of samples, too. Without motion samples, the
    messages are dropped and nothing is ready. SessionError if the kind cannot be known.
    """
    if state.kind is None:
        kind = _kind(held, platform, is_last=True)
        if isinstance(kind, str):
            return state, [], []
        state = replace_unchecked(state, kind=kind)
    return release(state, held)


def release(state: Assembly, held: Sequence[Message]) -> tuple[Assembly, list[Message], list[Streams]]:
    """Return the state, the messages that still wait, and the samples that are ready, at the end of a session.

    Missing messages and gravity samples are no longer waited for. If the kind of the acceleration is still unknown, no
    samples are ready and all messages remain in the list.
    """
    return (state, list(held), []) if state.kind is None else _released(state, list(held), is_last=True)


def reason_to_wait(state: Assembly, held: Sequence[Message], platform: str) -> str:
    """Return the reason why messages of a session wait, for the user, or an empty string if none waits."""
    if not held:
        return ""
    if state.kind is None:
        kind = _kind(held, platform)
        return kind if isinstance(kind, str) else ""
    return f"message {state.next_number} is missing: {len(held)} later ones wait for it"


def remembered(state: Assembly, held: Sequence[Message], message: Message) -> tuple[Assembly, bool]:
    """Return the state, and whether the message came before. LateError if its number was given up.

    A message with a number is compared with the numbers passed on and those in `held`. A message without one is
    compared with the digests in the state, to which its own is added. If an app was started again, the state expects
    its number next.
    """
    number = message.number
    if number is None:
        digest = hashlib.sha256(message.source).hexdigest()[:16]
        came_before = bool(message.source) and digest in state.recent
        return replace_unchecked(state, recent=(*state.recent, digest)[-_N_RECENT:]), came_before
    if any(first <= number <= last for first, last in state.given_up):
        raise LateError(
            f"message {number} is too late: it was given up after {_WAIT_S:g} s of later samples, and the track went "
            "on without it"
        )
    if number < state.next_number and _is_newer(state, message):
        # an app that was started again counts from zero
        return replace_unchecked(state, next_number=number, hole_s=np.nan), False
    return state, number < state.next_number or any(m.number == number for m in held)


def _is_newer(state: Assembly, message: Message) -> bool:
    """Return True if all motion samples of a message are later than those already passed on.

    False after a backward clock jump in the session, because the times do not show the order then.
    """
    begin_s, end_s = _span_s(state, message)
    return not state.set_backs and np.isfinite(end_s) and begin_s > state.last_s


def _is_too_much(messages: Sequence[Message]) -> bool:
    return sum(len(m.source) for m in messages) > _MAX_HELD_BYTES


def _released(
    state: Assembly, waiting: list[Message], is_last: bool = False
) -> tuple[Assembly, list[Message], list[Streams]]:
    """Return the state, the numbered messages that still wait, and the samples of those that are next in order.

    The samples are a list with an item for each message. Messages without a number never wait. A missing number is
    given up after three seconds of later samples, or at once if `is_last`.
    """
    uncounted = [m for m in waiting if m.number is None]
    counted = sorted((m for m in waiting if m.number is not None), key=_number)
    ready: list[Streams] = []
    for message in uncounted:
        state, samples = _samples(state, message)
        ready.append(samples)
    has_moved = False
    while counted:
        first = _number(counted[0])
        n_missing = 0 if state.next_number < 0 else first - state.next_number
        if n_missing:
            newest_s = next((end_s for m in reversed(counted) if np.isfinite(end_s := _span_s(state, m)[1])), np.nan)
            begun_s = state.hole_s
            if np.isnan(begun_s):  # a backlog that is coming in makes the hole smaller, and the wait begins again
                begun_s = newest_s if has_moved else _span_s(state, counted[0])[0]
            # it also begins again if the clock of the phone is set back meanwhile
            state = replace_unchecked(state, hole_s=float(np.fmin(begun_s, newest_s)))
            is_due = newest_s - state.hole_s > _WAIT_S
            if not (is_last or is_due or _is_too_much(counted)):
                break
            hole = (state.next_number, first - 1)
            state = replace_unchecked(
                state, n_lost=state.n_lost + n_missing, given_up=(*state.given_up, hole)[-_N_HOLES:]
            )
        message, has_moved = counted.pop(0), True
        state = replace_unchecked(state, next_number=_number(message) + 1, hole_s=np.nan)
        state, samples = _samples(state, message)
        ready.append(samples)
    if is_last and len(state.linear_s):
        state, force = _with_gravity(state, None, None, is_last=True)
        ready.append(_whole(state, force))
    return state, counted, [samples for samples in ready if samples]


def _number(message: Message) -> int:
    return -1 if message.number is None else message.number


def _samples(state: Assembly, message: Message) -> tuple[Assembly, Streams]:
    """Return the state and the samples of one message by sensor, each in order of time.

    Sensors without samples are left out. Values that the phone had stored long before the session are dropped. Linear
    acceleration waits in the state until gravity is known.
    """
    kind = known_kind(state)
    state, times_s = _on_one_clock(state, message, kind)
    found: Streams = {}
    for name, time_s in times_s.items():
        values = message.rows[name].values
        kept = time_s > (0.0 if kind.zero_ns else -np.inf) - _STALE_S
        if not kept.all() or (time_s[1:] < time_s[:-1]).any():
            order = np.argsort(time_s[kept], kind="stable")
            time_s, values = time_s[kept][order], values[kept][order]
        found[name] = Samples(time_s, values)
    force = found.get(kind.force)
    if kind.force == LINEAR:
        state, force = _with_gravity(state, force, found.get(GRAVITY))
    ready = {} if force is None else _whole(state, force)
    ready |= {name: found[name] for name in ("gyroscope", "magnetometer", "barometer", "location") if name in found}
    moving_s = times_s.get(kind.force, _NONE)
    if len(moving_s):
        state = replace_unchecked(state, last_s=max(state.last_s, _latest_s(moving_s)))
    return state, {name: rows for name, rows in ready.items() if len(rows)}


def _whole(state: Assembly, force: Samples) -> Streams:
    """Return the specific force in m/s2 with the sign of Android, or no stream if it has no samples."""
    return {FORCE: Samples(force.time_s, known_kind(state).scale * force.values)} if len(force) else {}


def known_kind(state: Assembly) -> Kind:
    """Return the kind of acceleration that was found in the first samples of the session. ValueError before them."""
    if state.kind is None:
        raise ValueError("units and sign of the acceleration are unknown: wait for the first seconds of samples")
    return state.kind


def _latest_s(time_s: FloatArray) -> float:
    """Return the latest time, without a few outliers far ahead of all other times."""
    latest_s = np.sort(time_s)[-_SET_BACK_SAMPLES:]
    far = np.flatnonzero(np.diff(latest_s) > _STALE_S)
    return float(latest_s[far[0]] if len(far) else latest_s[-1])


def _on_one_clock(state: Assembly, message: Message, kind: Kind) -> tuple[Assembly, dict[str, FloatArray]]:
    """Return the state, and the times of a message in seconds, by sensor, on a clock without backward jumps.

    A backward jump of more than 1 s in the acceleration adds to the correction of the clock in the state. Only the
    order of numbered messages distinguishes a jump from samples that are sent again. Other messages get the correction
    of the earlier jumps alone.
    """
    times_s = {name: seconds(rows, kind.zero_ns) + state.ahead_s for name, rows in message.rows.items()}
    force_s = times_s.get(kind.force, _NONE)
    if message.number is None or len(force_s) == 0 or not np.isfinite(state.last_s):
        return state, times_s
    i, back_s = _set_back(state.last_s, force_s, _SET_BACK_S)
    is_whole = i == 0 or len(force_s) - i >= _SET_BACK_SAMPLES
    if i == len(force_s) or not is_whole or force_s[i:].max() >= force_s[i] + back_s:
        return state, times_s
    intervals_s = np.diff(force_s)
    usual_s = float(np.median(intervals_s[intervals_s > 0])) if (intervals_s > 0).any() else 0.0
    back_s += usual_s
    for name, time_s in times_s.items():
        after = _set_back(state.last_s, time_s, 0.5 * back_s)[0]
        times_s[name] = np.concatenate([time_s[:after], time_s[after:] + back_s])
    at_s = float(force_s[i] + back_s)
    set_backs = (*state.set_backs, (at_s, back_s))[-_N_HOLES:]
    return replace_unchecked(state, ahead_s=state.ahead_s + back_s, set_backs=set_backs), times_s


def _set_back(last_s: float, time_s: FloatArray, least_s: float) -> tuple[int, float]:
    """Return the index and the size of the first backward clock jump in N times, or (N, 0) if there is none.

    The size is the positive time in s by which a time is earlier than the latest time before it. Only jumps of more
    than `least_s` count. `last_s` is the time before the first of the N times.
    """
    behind_s = np.maximum.accumulate(np.concatenate([[last_s], time_s]))[:-1] - time_s
    (back,) = (behind_s > least_s).nonzero()
    return (int(back[0]), float(behind_s[back[0]])) if len(back) else (len(time_s), 0.0)


def _with_gravity(
    state: Assembly, linear: Samples | None, gravity: Samples | None, is_last: bool = False
) -> tuple[Assembly, Samples]:
    """Return the state, and the sum of linear acceleration and gravity.

    The sum ends at the time until which gravity is known. Later samples wait in the state for at most 1 s of linear
    acceleration, or not at all if no more gravity can arrive (`is_last`). Samples in a gap of gravity are dropped.
    """
    linear_s, values = _appended(state.linear_s, state.linear, linear)
    gravity_s, known = _appended(state.gravity_s, state.gravity, gravity)
    order = np.argsort(gravity_s, kind="stable")
    gravity_s, known = gravity_s[order], known[order]
    newest_s = float(gravity_s[-1]) if len(gravity_s) else -np.inf
    if len(linear_s):
        newest_s = np.inf if is_last else max(newest_s, float(linear_s[-1]) - _GRAVITY_WAIT_S)
    ready = linear_s <= newest_s
    force = values[ready] + interpolated_near(linear_s[ready], gravity_s, known, limits.GRAVITY_GAP_S)
    begin_s = min([newest_s, *linear_s[~ready]]) - 2 * limits.GRAVITY_GAP_S
    later = gravity_s >= begin_s
    state = replace_unchecked(
        state, linear_s=linear_s[~ready], linear=values[~ready], gravity_s=gravity_s[later], gravity=known[later]
    )
    finite = np.isfinite(force).all(axis=1)
    return state, Samples(linear_s[ready][finite], force[finite])


def _appended(time_s: FloatArray, values: FloatArray, rows: Samples | None) -> tuple[FloatArray, FloatArray]:
    if rows is None:
        return time_s, values
    return np.concatenate([time_s, rows.time_s]), np.concatenate([values, rows.values])


def seconds(rows: SensorRows, zero_ns: int) -> FloatArray:
    """Return the times of a sensor in seconds. Nanoseconds are counted from `zero_ns`."""
    if rows.time.dtype.kind == "f":
        return rows.time.astype(np.float64)
    return (rows.time - zero_ns).astype(np.float64) * 1e-9  # the difference is exact in int64


def _span_s(state: Assembly, message: Message) -> tuple[float, float]:
    """First and last time of the motion samples of a message on the phone's clock, s. (inf, -inf) without samples."""
    zero_ns = 0 if state.kind is None else state.kind.zero_ns
    times_s = [seconds(rows, zero_ns) for rows in _moving(message) if len(rows.time)]
    return min([np.inf, *(float(t.min()) for t in times_s)]), max([-np.inf, *(float(t.max()) for t in times_s)])


def _moving(message: Message) -> Iterator[SensorRows]:
    """Return the rows of the motion sensors. The time of a location may be long before the walk."""
    for name in _MOVING:
        if name in message.rows:
            yield message.rows[name]


# --- what the first seconds say ---------------------------------------------------------------------------------------


def _kind(messages: Sequence[Message], platform: str, is_last: bool = False) -> Kind | str:
    """Return the properties of a session, or why they are not known yet. SessionError if they can never be known."""
    moving = [rows for m in messages for rows in _moving(m) if len(rows.time)]
    sensors = ", ".join(sorted({name for m in messages for name in m.rows})) or "no sensor"
    if not moving:
        return f"no acceleration and no gyroscope yet (sent: {sensors}); switch on Accelerometer and Gravity in the app"
    unit_s = moving[0].unit_s
    every: Any = np.concatenate([rows.time for rows in moving])
    recent = every[every >= every.max() - _STALE_S / unit_s]
    span_s = float(recent.max() - recent.min()) * unit_s
    if span_s < PRELUDE_S and not is_last:
        _check_rate(recent, unit_s)
        return f"{PRELUDE_S:g} s of samples are needed, {span_s:.1f} s are there"
    first = {name: together(messages, name) for name in (FORCE, LINEAR, GRAVITY, RAW, "attitude")}
    usable = [name for name in (FORCE, LINEAR, RAW) if name != LINEAR or first[GRAVITY] is not None]
    force = next((name for name in usable if first[name] is not None), None)
    rows = None if force is None else first[force]
    if force is None or rows is None:
        words = (
            f"no acceleration with gravity in it (sent: {sensors}); switch on Accelerometer and Gravity, or Total "
            "Acceleration, in the app"
        )
        if span_s < _NO_FORCE_S and not is_last:
            return words
        raise SessionError(words)
    platform = next((m.platform for m in messages if m.platform), platform)
    scale, how = _scale(force, first, platform)
    zero_ns = 0 if rows.time.dtype.kind == "f" else int(rows.time[rows.time >= recent.min()].min())
    return Kind(force, scale, how, zero_ns, any("location" in m.rows for m in messages))


def _check_rate(time: Any, unit_s: float) -> None:
    """Raise SessionError if many times span so little that their unit must be wrong, or the clock stands still."""
    span_s = float(time.max() - time.min()) * unit_s
    if len(time) < _RATE_SAMPLES or 2 * span_s * len(_MOVING) * limits.RATE_RANGE_HZ[1] > len(time):
        return
    unit = "nanoseconds since 1970" if unit_s < 1.0 else "seconds"
    raise SessionError(
        f"times must be {unit}, got {len(time)} samples within {span_s:.3g} s: the unit is another one, or the clock "
        f"of the phone stands still; send {unit}"
    )


def _scale(force: str, first: Mapping[str, SensorRows | None], platform: str) -> tuple[float, str]:
    """Return the factor from the values of a sensor to m/s2 with Android's sign, and a description of the evidence.

    `force` is the sensor from which the specific force is taken, and `first` has the first samples by sensor.
    SessionError if the sign is unknown.
    """
    if force == FORCE:
        return (-1.0, "iOS: sign turned") if platform == "ios" else (1.0, "as it is")
    rows = first[GRAVITY] if force == LINEAR else first[RAW]
    if rows is None:
        raise SessionError(f"no samples of {GRAVITY if force == LINEAR else RAW}: switch the sensor on")
    unit, size = 1.0, float(np.nanmedian(np.linalg.norm(rows.values, axis=1)))
    if force == RAW and limits.G_RANGE[0] <= size <= limits.G_RANGE[1]:
        return -STANDARD_GRAVITY_MPS2, "g, so iOS: sign turned"
    attitude = first["attitude"]
    zero = 0 if rows.time.dtype.kind == "f" else int(rows.time[0])
    up = np.nan if attitude is None else up_cosine(*(Samples(seconds(r, zero), r.values) for r in (rows, attitude)))
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
