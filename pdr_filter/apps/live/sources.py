"""Sources from which the server fetches samples; `take` gets them like messages of a phone."""

from __future__ import annotations

import asyncio
import hashlib
import json
import urllib.request
import uuid
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import numpy as np

from pdr_filter.apps.live.access import MAX_BODY_BYTES
from pdr_filter.apps.live.messages import (
    ANDROID_SENSORS,
    N_VALUES,
    Message,
    MessageError,
    SensorRows,
    parse,
    phyphox_buffers,
    phyphox_rows,
    to_json,
    together,
)
from pdr_filter.apps.live.parts import Answer
from pdr_filter.values.recording import Recording
from pdr_filter.values.sanitise import printable

# Takes a body, and the names of device and session and the platform for messages that do not say them.
Taker = Callable[..., Coroutine[Any, Any, Answer]]
# Samples of so long are one message, as with phones that send several times a second.
_PART_S = 0.2
# Between two tries to reach a phone or a broker.
_AGAIN_S = 2.0
_ANSWER_S = 5.0
# Largest answer of phyphox, which keeps all samples: some two hours of two sensors at 100 Hz.
_MAX_ANSWER_BYTES = 64 * 1024**2
# Samples of such an answer that become one message, some 0.2 MB.
_LONG_S = 10.0
# Messages of a broker that are under way to the workers.
_AT_ONCE = 64


def told(take: Taker, name: str, say: Callable[[str], None]) -> Taker:
    """Return a function that passes messages to the server like `take`, again after a pause while it is busy.

    If the server refuses a message, the reason is passed to `say` after `name`, unless it equals the last one.
    """
    reason = ""

    async def taken(body: bytes, **named: str) -> Answer:
        nonlocal reason
        while (answer := await take(body, **named)).status in (429, 503):
            await asyncio.sleep(_PART_S)
        if answer.status != 200 and answer.content["error"] != reason:
            reason = answer.content["error"]
            say(f"{name}: {reason}")
        return answer

    return taken


async def replay(recording: Recording, speed: float, take: Taker) -> None:
    """Send the samples of a recording as messages, in real time or `speed` times faster."""
    streams = {name: samples for name, samples in recording.streams.items() if name in N_VALUES and name != "attitude"}
    time_s = recording.accelerometer.time_s
    # In recorded order: what a recording's clock did is replayed too. Other sensors go with the samples of their time.
    part_s = min(_PART_S * max(speed, 1.0), 1.0)  # as often where it is faster, but of a second at most
    cuts = np.append(np.arange(float(time_s[0]), float(time_s.max()), part_s)[1:], np.inf)
    subject = {name: value for name, value in asdict(recording.subject).items() if value is not None}
    meta = {"name": recording.name, "placement": recording.placement, "subject": subject}
    session, loop = uuid.uuid4().hex[:8], asyncio.get_running_loop()
    begun, sent = loop.time(), dict.fromkeys(streams, 0)
    for number, end_s in enumerate(cuts):
        rows: dict[str, SensorRows] = {}
        for name, samples in streams.items():
            ahead = samples.time_s[sent[name] :] >= end_s
            n = int(ahead.argmax()) if ahead.any() else len(ahead)
            if n:
                part = slice(sent[name], sent[name] + n)
                rows[name] = SensorRows(samples.time_s[part], samples.values[part])
                sent[name] += n
        is_end = number == len(cuts) - 1
        message = Message(f"replay {recording.name}", session, number, "android", rows, is_end=is_end, meta=meta)
        await asyncio.sleep(max(begun + (number + 1) * part_s / speed - loop.time(), 0.0))
        if (await take(to_json(message))).status != 200:
            return


async def again(name: str, source: Callable[[], Awaitable[None]], say: Callable[[str], None]) -> None:
    """Run a source for ever, and restart it 2 s after its connection breaks."""
    said = ""
    while True:
        try:
            await source()
        except Exception as error:  # network clients raise many kinds, and the wrong experiment may be open
            reason = str(error) if isinstance(error, MessageError) else f"{type(error).__name__}: {error}"
            if reason != said:
                say(f"{name}: {reason}; trying again")
            said = reason
        await asyncio.sleep(_AGAIN_S)


# --- phyphox ----------------------------------------------------------------------------------------------------------


class Phyphox:
    """Source that fetches the new samples of a phone with phyphox five times a second.

    Remote access must be on in the app. After a broken connection, the source continues after the last sample.
    """

    def __init__(self, address: str, take: Taker) -> None:
        self._address, self._take = _with_scheme(address, "http").rstrip("/"), take
        self._session, self._seen_s = "", dict[str, float]()

    async def run(self) -> None:
        """Fetch samples and pass them to `take`, until an error of the connection ends the method."""
        buffers = phyphox_buffers(await self._got("config"))
        if not self._session:
            await self._got("control?cmd=start")
        while True:
            answer = await self._got(f"get?{_phyphox_query(buffers, self._seen_s)}")
            rows = phyphox_rows(answer, buffers)
            status: Any = json.loads(answer).get("status") or {}
            found = str(status.get("session", self._session or uuid.uuid4().hex[:8]))
            if found != self._session:  # another experiment: its times begin again
                is_first, self._session, self._seen_s = not self._session, found, {}
                if not is_first:
                    continue
            later = {name: r.time > self._seen_s.get(name, -np.inf) for name, r in rows.items()}
            await self._give({name: SensorRows(r.time[later[name]], r.values[later[name]]) for name, r in rows.items()})
            await asyncio.sleep(_PART_S)

    async def _give(self, rows: Mapping[str, SensorRows]) -> None:
        """Send new samples in messages of bounded length. Their times show which samples were already sent."""
        for part in _parts({name: r for name, r in rows.items() if len(r.time)}):
            message = Message(f"phyphox {urlsplit(self._address).netloc}", self._session, None, "android", part)
            await self._take(to_json(message))
            self._seen_s |= {name: float(r.time.max()) for name, r in part.items()}

    async def _got(self, path: str) -> bytes:
        return await asyncio.to_thread(_got, f"{self._address}/{path}")


def _parts(rows: Mapping[str, SensorRows]) -> Iterator[dict[str, SensorRows]]:
    """Yield the samples of all sensors in parts of ten seconds."""
    numbers = {name: np.floor(r.time / _LONG_S) for name, r in rows.items()}
    for number in np.unique(np.concatenate([*numbers.values(), np.empty(0)])):
        inside = {name: numbers[name] == number for name in rows}
        yield {n: SensorRows(r.time[inside[n]], r.values[inside[n]]) for n, r in rows.items() if inside[n].any()}


def _phyphox_query(buffers: Mapping[str, tuple[str, ...]], seen_s: Mapping[str, float]) -> str:
    """Return the query for the samples of each sensor after the last received one."""
    asked: list[str] = []
    for name, (time, *values) in buffers.items():
        after = f"{seen_s.get(name, 0.0)!r}"
        asked += [f"{quote(time)}={after}", *(f"{quote(v)}={after}%7C{quote(time)}" for v in values)]
    return "&".join(asked)


def _got(address: str) -> bytes:
    """Return the content of an address, in bytes. MessageError if it is too large, OSError if it cannot be reached.

    Each request opens a connection, because phyphox keeps none open.
    """
    with urllib.request.urlopen(address, timeout=_ANSWER_S) as answer:
        content = answer.read(_MAX_ANSWER_BYTES + 1)
    if len(content) > _MAX_ANSWER_BYTES:
        raise MessageError(f"phyphox holds more than {_MAX_ANSWER_BYTES} bytes: clear its data and start it again")
    return content


# --- SensorServer -----------------------------------------------------------------------------------------------------


async def sensor_server(address: str, session: str, take: Taker) -> None:
    """Pass samples of an Android phone with SensorServer to `take` every 0.2 s, until the connection breaks."""
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
            await take(to_json(Message(device, session, None, "android", _joined(parts))))


def _joined(bodies: list[bytes]) -> dict[str, SensorRows]:
    """Return the samples of many messages by sensor, with times in seconds since the phone was switched on."""
    messages = [message for body in bodies for message in parse(body)]
    joined = {name: together(messages, name) for name in dict.fromkeys(name for m in messages for name in m.rows)}
    return {name: SensorRows(1e-9 * rows.time.astype(np.float64), rows.values) for name, rows in joined.items() if rows}


# --- MQTT -------------------------------------------------------------------------------------------------------------

# WebSocket (ws, wss) is not supported, because mosquitto 2.0 forwards only about 40 kB/s over it, less than the data
# rate of one phone.
_MQTT_PORTS = {"mqtt": 1883, "mqtts": 8883}


def _client_identifier(folder: Path, where: str) -> str:
    """Return the name of the server of a folder at a broker. It is the same in the next container on this folder."""
    path = folder / ".mqtt"
    if not path.exists():
        path.write_text(uuid.uuid4().hex)
    return f"pdr{hashlib.sha256(f'{path.read_text()} {where}'.encode()).hexdigest()[:20]}"


class Mqtt:
    """Subscription to a topic, mqtt://USER:PASSWORD@HOST:PORT/TOPIC, or mqtts with encryption.

    With a folder, the broker keeps messages that are published with QoS 1 while the server of this folder does not run.
    """

    def __init__(self, address: str, take: Taker, folder: Path | None = None) -> None:
        self._address, self._take = urlsplit(_with_scheme(address, "mqtt")), take
        if self._address.scheme not in _MQTT_PORTS or not self._address.hostname:
            raise MessageError(
                f"--mqtt takes mqtt://HOST:PORT/TOPIC or mqtts://HOST:PORT/TOPIC, got {printable(address)!r}; over "
                "WebSocket, brokers fall behind a phone, so give the port of the broker for TCP"
            )
        self._topic = unquote(self._address.path.lstrip("/")) or "sensor-logger"
        # another topic is another session, because the broker would continue to send the messages of the earlier topic
        where = f"{self._address.hostname} {self._address.port} {self._address.username} {self._topic}"
        self._identifier = None if folder is None else _client_identifier(folder, where)

    async def run(self) -> None:
        """Receive messages of the topic and pass them to `take`, until an error of the connection ends the method."""
        import aiomqtt

        parts = self._address
        client = aiomqtt.Client(
            str(parts.hostname),
            parts.port or _MQTT_PORTS[parts.scheme],
            username=unquote(parts.username) if parts.username else None,
            password=unquote(parts.password) if parts.password else None,
            tls_params=aiomqtt.TLSParameters() if parts.scheme == "mqtts" else None,
            identifier=self._identifier,
            clean_session=self._identifier is None,
        )
        # aiomqtt acknowledges messages when they arrive, and a server that is killed would lose those in its memory
        paho = client._client  # pyright: ignore[reportPrivateUsage]
        paho.manual_ack_set(True)

        async def give(message: aiomqtt.Message) -> None:
            await self._take(message.payload)
            paho.ack(message.mid, message.qos)

        giving = set[asyncio.Task[None]]()  # each reaches the worker of its phone in its turn
        async with client:
            await client.subscribe(self._topic, qos=1)
            async for message in client.messages:
                task = asyncio.create_task(give(message))
                giving.add(task)
                task.add_done_callback(giving.discard)
                while len(giving) >= _AT_ONCE:
                    await asyncio.wait(giving, return_when=asyncio.FIRST_COMPLETED)


def _with_scheme(address: str, scheme: str) -> str:
    return address if "://" in address else f"{scheme}://{address}"
