"""What the server fetches itself, given to `take` as if a phone had sent it."""

from __future__ import annotations

import asyncio
import json
import urllib.request
import uuid
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import numpy as np

from pdr_filter.live.access import MAX_BODY_BYTES
from pdr_filter.live.messages import (
    ANDROID_SENSORS,
    N_VALUES,
    Message,
    MessageError,
    Rows,
    parse,
    phyphox_buffers,
    phyphox_rows,
    to_json,
)
from pdr_filter.live.parts import Answer

# Takes a body, and the names of device and session and the platform for messages that do not say them.
Taker = Callable[..., Awaitable[Answer]]
# Samples of so long are one message, as with phones that send several times a second.
_PART_S = 0.2
# Between two tries to reach a phone or a broker.
_AGAIN_S = 2.0
_ANSWER_S = 5.0


async def _given(take: Taker, body: bytes, **named: str) -> None:
    """Give a message to the server, again where it has no time for it."""
    while (await take(body, **named)).status in (429, 503):
        await asyncio.sleep(_PART_S)


async def replay(file: Path, speed: float, take: Taker) -> None:
    """Send a recording as if it were walked now, or `speed` times as fast."""
    from pdr_filter.io.formats import read

    recording = await asyncio.to_thread(read, file)
    streams = {name: samples for name, samples in recording.streams.items() if name in N_VALUES and name != "attitude"}
    time_s = recording.accelerometer.time_s
    # In recorded order: what a recording's clock did is replayed too. Other sensors go with the samples of their time.
    cuts = np.append(np.arange(float(time_s[0]), float(time_s.max()), _PART_S)[1:], np.inf)
    session, loop = uuid.uuid4().hex[:8], asyncio.get_running_loop()
    begun, sent = loop.time(), dict.fromkeys(streams, 0)
    for number, end_s in enumerate(cuts):
        rows: dict[str, Rows] = {}
        for name, samples in streams.items():
            ahead = samples.time_s[sent[name] :] >= end_s
            n = int(ahead.argmax()) if ahead.any() else len(ahead)
            if n:
                part = slice(sent[name], sent[name] + n)
                rows[name] = Rows(samples.time_s[part], samples.values[part])
                sent[name] += n
        is_end = number == len(cuts) - 1
        message = Message(f"replay {recording.name}", session, number, "android", rows, is_end=is_end)
        await asyncio.sleep(max(begun + (number + 1) * _PART_S / speed - loop.time(), 0.0))
        await _given(take, to_json(message))


async def again(source: Callable[[], Awaitable[None]], say: Callable[[str], None]) -> None:
    """A source for as long as the server runs: one that breaks off is begun again; each new reason is said once."""
    said = ""
    while True:
        try:
            await source()
        except MessageError:
            raise
        except Exception as error:  # whatever clients of networks raise
            reason = f"{type(error).__name__}: {error}"
            if reason != said:
                say(f"{reason}; trying again")
            said = reason
        await asyncio.sleep(_AGAIN_S)


# --- phyphox ----------------------------------------------------------------------------------------------------------


async def phyphox(address: str, take: Taker) -> None:
    """Ask a phone with phyphox for its new samples five times a second; its remote access must be on."""
    address = _with_scheme(address, "http").rstrip("/")
    buffers = phyphox_buffers(await asyncio.to_thread(_got, f"{address}/config"))
    await asyncio.to_thread(_got, f"{address}/control?cmd=start")
    session, number, seen_s = "", 0, dict.fromkeys(buffers, -1.0)
    while True:
        answer = await asyncio.to_thread(_got, f"{address}/get?{_phyphox_query(buffers, seen_s)}")
        rows = phyphox_rows(answer, buffers)
        status: Any = json.loads(answer).get("status") or {}
        found = str(status.get("session", session or uuid.uuid4().hex[:8]))
        if found != session:  # its data were cleared: times begin again
            is_first, session, number, seen_s = not session, found, 0, dict.fromkeys(buffers, -1.0)
            if not is_first:
                continue
        new = {name: _later(rows[name], seen_s[name]) for name in rows}
        new = {name: r for name, r in new.items() if len(r.time)}
        if new:
            await _given(take, to_json(Message(f"phyphox {urlsplit(address).netloc}", session, number, "android", new)))
            number += 1
            seen_s |= {name: float(r.time.max()) for name, r in new.items()}
        await asyncio.sleep(_PART_S)


def _phyphox_query(buffers: Mapping[str, tuple[str, ...]], seen_s: Mapping[str, float]) -> str:
    """Of each sensor what is later than what was seen: the buffer of times, and the others where that is later."""
    asked: list[str] = []
    for name, (time, *values) in buffers.items():
        after = f"{seen_s[name]!r}"
        asked += [f"{quote(time)}={after}", *(f"{quote(v)}={after}%7C{quote(time)}" for v in values)]
    return "&".join(asked)


def _later(rows: Rows, seen_s: float) -> Rows:
    later = rows.time > seen_s
    return Rows(rows.time[later], rows.values[later])


def _got(address: str) -> bytes:
    """What is at an address; a connection for each, because phyphox keeps none open."""
    with urllib.request.urlopen(address, timeout=_ANSWER_S) as answer:
        return answer.read(MAX_BODY_BYTES)


# --- SensorServer -----------------------------------------------------------------------------------------------------


async def sensor_server(address: str, session: str, take: Taker) -> None:
    """Listen to an Android phone with SensorServer: its WebSocket gives one sample a message."""
    from websockets.asyncio.client import connect

    address = _with_scheme(address, "ws").rstrip("/")
    types = quote(json.dumps(list(ANDROID_SENSORS), separators=(",", ":")))
    async with connect(f"{address}/sensors/connect?types={types}", max_size=MAX_BODY_BYTES) as socket:
        while True:
            parts = [await socket.recv(decode=False)]
            until = asyncio.get_running_loop().time() + _PART_S
            while (left_s := until - asyncio.get_running_loop().time()) > 0:
                try:
                    parts.append(await asyncio.wait_for(socket.recv(decode=False), left_s))
                except TimeoutError:
                    break
            device = f"SensorServer {urlsplit(address).netloc}"
            await _given(take, to_json(Message(device, session, None, "android", _joined(parts))))


def _joined(bodies: list[bytes]) -> dict[str, Rows]:
    """Messages of one sample each as one, with seconds since the phone was switched on."""
    found: dict[str, list[Rows]] = {}
    for message in (message for body in bodies for message in parse(body)):
        for name, rows in message.rows.items():
            found.setdefault(name, []).append(rows)
    return {
        name: Rows(
            1e-9 * np.concatenate([r.time.astype(np.float64) for r in parts]),
            np.concatenate([r.values for r in parts]),
        )
        for name, parts in found.items()
    }


# --- MQTT -------------------------------------------------------------------------------------------------------------

_MQTT_PORTS = {"mqtt": 1883, "mqtts": 8883, "ws": 80, "wss": 443}


async def mqtt(address: str, take: Taker) -> None:
    """Take what is published under a topic, mqtt://USER:PASSWORD@HOST:PORT/TOPIC; mqtts, ws and wss as well."""
    import aiomqtt

    parts = urlsplit(_with_scheme(address, "mqtt"))
    if parts.scheme not in _MQTT_PORTS or not parts.hostname:
        raise MessageError(f"--mqtt takes mqtt://HOST:PORT/TOPIC, mqtts, ws or wss, got {address!r}")
    client = aiomqtt.Client(
        parts.hostname,
        parts.port or _MQTT_PORTS[parts.scheme],
        username=unquote(parts.username) if parts.username else None,
        password=unquote(parts.password) if parts.password else None,
        transport="websockets" if parts.scheme in ("ws", "wss") else "tcp",
        tls_params=aiomqtt.TLSParameters() if parts.scheme in ("mqtts", "wss") else None,
    )
    async with client:
        await client.subscribe(unquote(parts.path.lstrip("/")) or "sensor-logger", qos=1)
        async for message in client.messages:
            await _given(take, message.payload)


def _with_scheme(address: str, scheme: str) -> str:
    return address if "://" in address else f"{scheme}://{address}"
