"""Limits on connections, which uvicorn does not have: it waits without end for the rest of a request.

Without them, a program that opens connections and sends half a request uses up the file descriptors of the server, and
phones get no answer. An access token does not help, because it stands in the missing half.
"""

from __future__ import annotations

import asyncio
from asyncio.sslproto import SSLProtocol
from pathlib import Path
from ssl import PROTOCOL_TLS_SERVER, SSLContext
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

# Field of the state of a request that `server.AccessMiddleware` has let pass.
ALLOWED = "is_allowed"
# Connections in all, and from one address, which the phones behind a router share. Each phone and each page needs two.
MAX_CONNECTIONS, MAX_OF_ADDRESS = 512, 256
# File descriptors that the server asks for, because many systems give 256 or 1024. In a burst, connections need them
# before they count.
_FILE_DESCRIPTORS = 8192
_BACKLOG = 2048  # as in uvicorn
# A phone sends a head, of at most 16 kB, at once, or after the TLS handshake. A phone that falls silent within a body
# has lost its network.
_HEAD_S, _SILENT_BODY_S = 10.0, 30.0


class LimitedConnection(H11Protocol):
    """HTTP connection that is closed if its requests do not arrive in time, or if there are too many connections.

    If there are too many, the connection that has waited longest for its first allowed request is closed, so that a
    flood displaces itself and no phone of another address.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._begun_s = self.loop.time()
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Count a new connection, and close another one if there are too many.

        With TLS, this method is called at the start of the handshake and again at its end.
        """
        super().connection_made(transport)
        self._wait()
        of_address = [other for other in self.connections if _address(other) == _address(self)]
        for group, most in ((of_address, MAX_OF_ADDRESS), (self.connections, MAX_CONNECTIONS)):
            unknown = [c for c in group if isinstance(c, LimitedConnection) and not c.is_allowed]
            if len(group) > most and unknown:
                min(unknown, key=lambda connection: connection._begun_s).drop()

    @property
    def is_allowed(self) -> bool:
        """True if the access middleware has let the latest request of this connection pass."""
        return bool(self.cycle) and ALLOWED in self.cycle.scope.get("state", ())

    def drop(self) -> None:
        """Close the connection without an answer."""
        self.connections.discard(self)  # it no longer counts, although the loop closes it later
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Process received bytes, and wait for those that are missing."""
        super().data_received(data)
        self._wait()

    def on_response_complete(self) -> None:
        """Wait for the rest of a body whose request was answered before its end."""
        super().on_response_complete()
        self._wait()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Pass the connection to the WebSocket protocol, which ends silent connections by pings."""
        self._stop()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop()
        super().connection_lost(exc)

    def end(self) -> None:
        """Count the connection no longer, because its TLS handshake has failed."""
        self.connections.discard(self)
        self._stop()

    def _wait(self) -> None:
        """Start or stop the timer that closes the connection."""
        if self not in self.connections:  # closed, or passed to the WebSocket protocol
            return
        receives = self.conn.their_state
        if receives is h11.SEND_BODY and not self.cycle.response_complete:
            self._stop()
            self._timer = self.loop.call_later(_SILENT_BODY_S, self._end_body)
        elif receives not in (h11.IDLE, h11.SEND_BODY):
            self._stop()
        elif self._timer is None:
            self._timer = self.loop.call_later(_HEAD_S, self.drop)

    def _end_body(self) -> None:
        if self.flow.read_paused:  # the application is slower than the sender
            self._timer = self.loop.call_later(_SILENT_BODY_S, self._end_body)
        else:
            self.drop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class TlsConnection(SSLProtocol):
    """TLS layer of a `LimitedConnection`, which counts from the start of its handshake.

    Handshake and first head have one timeout together. With the `ssl` of `uvicorn.Config`, connections would count
    after the handshake, which may take a minute.
    """

    def __init__(self, context: SSLContext, **named: Any) -> None:
        self._inner = LimitedConnection(**named)
        waiter: Any = None  # nothing waits for the end of the handshake
        super().__init__(self._inner.loop, self._inner, context, waiter, True, ssl_shutdown_timeout=_HEAD_S)

    def connection_made(self, transport: Any) -> None:
        """Begin the handshake."""
        self._inner.connection_made(transport)
        super().connection_made(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """Stop waiting."""
        super().connection_lost(exc)
        self._inner.end()


def tls_context(certificate: Path) -> SSLContext:
    """Return the context of a server with the certificate and key in a file."""
    context = SSLContext(PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    return context


def _address(connection: Any) -> str:
    """Return the address of the other side of an HTTP or WebSocket connection."""
    return connection.client[0] if connection.client else ""


def backlog() -> int:
    """Return how many connections the system may accept ahead of the server, and raise its number of file descriptors.

    Connections that wait need at most half of the file descriptors that counted ones leave.
    """
    try:
        import resource
    except ImportError:  # Windows, which has no such limit
        return _BACKLOG
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _FILE_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _FILE_DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    return min(_BACKLOG, max((most - MAX_CONNECTIONS) // 2, 1))
