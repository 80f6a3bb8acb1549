"""Half-sent requests and floods of connections, against a server in this process."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from pdr_filter.apps.cli.live import bound_socket
from pdr_filter.apps.live import connections
from pdr_filter.apps.live.certificate import NAMES, certificate
from pdr_filter.apps.live.connections import LimitedConnection, TlsConnection, tls_context
from pdr_filter.apps.live.server import application, body_of

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]
HEAD = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\nAuthorization: Bearer %b\r\n\r\n"


@asynccontextmanager
async def port_of_server(protocol: Any = LimitedConnection) -> AsyncIterator[int]:
    """Port of a server that answers with the length of the body that is sent with the token "secret"."""

    async def length(request: Request) -> Response:
        return JSONResponse(len(await body_of(request) or b""))

    routes = application([Route("/", length, methods=["POST"])], "secret")
    config = uvicorn.Config(routes, http=protocol, lifespan="off", log_config=None, log_level="warning")
    server, listening = uvicorn.Server(config), bound_socket("127.0.0.1", 0)
    serving = asyncio.create_task(server.serve([listening]))
    while not server.started:
        await asyncio.sleep(0.01)
    yield listening.getsockname()[1]
    server.should_exit = True
    await serving


async def sent(port: int, content: bytes) -> Connection:
    """A connection over which something was sent."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(content)
    return reader, writer


async def answer_to(port: int, content: bytes) -> bytes:
    """All that the server says until it closes the connection."""
    reader, writer = await sent(port, content)
    try:
        return await asyncio.wait_for(reader.read(), 60)
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


def test_half_sent_requests_are_dropped_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "_HEAD_S", 0.4)
    monkeypatch.setattr(connections, "_SILENT_BODY_S", 1.2)
    allowed, refused = HEAD % b"secret", HEAD % b"wrong"

    async def run() -> None:
        async with port_of_server() as port:
            reader, writer = await sent(port, allowed)
            for _ in range(9):  # longer than both times together, but never silent for so long
                writer.write(b"x")
                await asyncio.sleep(0.2)
            assert (await reader.readuntil(b"9")).startswith(b"HTTP/1.1 200")
            writer.write(b"POST / HT")  # the next request of the same connection
            halves = (b"", b"POST / HTTP/1.1\r\nHost: x\r\n", allowed, allowed + b"xx", refused, refused + b"xx")
            answers = await asyncio.gather(*(answer_to(port, half) for half in halves))
            assert [answer[9:12] for answer in answers] == [b"", b"", b"", b"", b"401", b"401"]
            assert not (await asyncio.wait_for(reader.read(), 60)).startswith(b"HTTP")
            writer.close()

    asyncio.run(run())


def test_a_flood_of_half_sent_requests_displaces_itself_and_no_phone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "MAX_OF_ADDRESS", 20)
    whole = HEAD % b"secret" + b"123456789"

    async def run() -> None:
        async with port_of_server() as port:
            reader, writer = await sent(port, whole[:-1])
            flood = [await sent(port, b"POST / HTTP/1.1\r\n") for _ in range(60)]
            phone, its_writer = await sent(port, whole)
            assert (await asyncio.wait_for(phone.readuntil(b"9"), 60)).startswith(b"HTTP/1.1 200")
            writer.write(b"9")  # the rest of a request that began before the flood
            assert (await asyncio.wait_for(reader.readuntil(b"9"), 60)).startswith(b"HTTP/1.1 200")
            assert sum(r.at_eof() or r.exception() is not None for r, _ in flood) == 60 - 18
            for _, each in [(reader, writer), (phone, its_writer), *flood]:
                each.close()

    asyncio.run(run())


def test_tls_handshakes_are_dropped_in_time_and_a_flood_of_them_displaces_itself_and_no_phone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MAX_OF_ADDRESS", 20)
    context = tls_context(certificate(tmp_path, "127.0.0.1"))
    trusted = ssl.create_default_context(cafile=str(tmp_path / NAMES[0]))
    whole, hello = HEAD % b"secret" + b"123456789", b"\x16\x03\x01\x02\x00\x01"  # a handshake that begins

    async def run() -> None:
        async with port_of_server(partial(TlsConnection, context)) as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted)
            writer.write(whole[:-1])
            flood = [await sent(port, content) for content in (hello, b"") for _ in range(30)]
            phone, its_writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted)
            its_writer.write(whole)
            assert (await asyncio.wait_for(phone.readuntil(b"9"), 60)).startswith(b"HTTP/1.1 200")
            writer.write(b"9")  # the rest of a request that began before the flood
            assert (await asyncio.wait_for(reader.readuntil(b"9"), 60)).startswith(b"HTTP/1.1 200")
            assert sum(r.at_eof() or r.exception() is not None for r, _ in flood) == 60 - 18
            its_writer.close()
            writer.close()
            monkeypatch.setattr(connections, "_HEAD_S", 0.1)
            assert await asyncio.gather(answer_to(port, hello), answer_to(port, b"")) == [b"", b""]
            for _, each in flood:
                each.close()

    asyncio.run(run())


def test_a_tls_handshake_that_fails_counts_no_longer(tmp_path: Path) -> None:
    context = tls_context(certificate(tmp_path, "127.0.0.1"))
    states: list[Any] = []

    def protocol(**named: Any) -> TlsConnection:
        states.append(named["server_state"])
        return TlsConnection(context, **named)

    async def run() -> None:
        async with port_of_server(protocol) as port:
            await answer_to(port, b"GET / HTTP/1.1\r\n\r\n")
            assert states[0].connections == set()

    asyncio.run(run())
    assert len(states) == 1


def test_addresses_that_are_none_and_senders_that_leave_are_no_errors_of_the_server(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def run() -> None:
        async with port_of_server() as port:
            for headers in (b"Host: [::1", b"Host: x\r\nOrigin: http://[::1"):
                answer = await answer_to(port, b"GET / HTTP/1.1\r\nConnection: close\r\n" + headers + b"\r\n\r\n")
                assert answer.startswith(b"HTTP/1.1 400")
            _, writer = await sent(port, HEAD % b"secret" + b"x")
            await asyncio.sleep(0.02)
            writer.close()
            await asyncio.sleep(0.02)

    asyncio.run(run())
    assert not [record for record in caplog.records if record.exc_info]


def test_the_server_asks_for_file_descriptors_and_leaves_half_of_them_to_connections_that_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    resource, given = pytest.importorskip("resource"), list[tuple[int, int]]()
    monkeypatch.setattr(resource, "setrlimit", lambda _, limit: given.append(limit))
    found: list[int] = []
    for limits in ((256, 1024), (256, resource.RLIM_INFINITY), (20_000, 20_000)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, limits=limits: limits)
        found.append(connections.backlog())
    assert found == [256, 2048, 2048]
    assert given == [(1024, 1024), (8192, resource.RLIM_INFINITY)]
