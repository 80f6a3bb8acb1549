"""The web side: what phones send goes to the workers, what the workers say goes to pages and programs."""

from __future__ import annotations

import asyncio
import io
import json
import re
import time
import uuid
import zipfile
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from pdr_filter.io.own_writer import FILES
from pdr_filter.live.access import LOOPBACK_NAMES, MAX_BODY_BYTES, TOKEN_COOKIE, Rates, is_token
from pdr_filter.live.certificate import NAMES
from pdr_filter.live.geojson import geojson
from pdr_filter.live.settings import Event, Settings
from pdr_filter.live.workers import Answer, Take, Workers

PAGE = Path(__file__).parent / "page"
_ASSETS = Path(__file__).parents[1] / "report" / "assets"  # uPlot, which reports hold, too
# Events that wait for one reader at most: some seconds of many phones. Who reads slower gets the whole anew.
_MAX_WAITING = 500
_MAX_READERS = 100
_DEVICE = re.compile(rb'"device(?:Id)?"\s*:\s*"([^"\\]{1,200})"')
_ALIVE_S = 15.0


class Live:
    """What the parts of a running server share."""

    def __init__(self, settings: Settings, folder: Path, n_workers: int = 1) -> None:
        self.settings, self.folder, self.n_workers = settings, folder, n_workers
        self.rates = Rates()
        self.sessions: dict[str, Event] = {}
        self._readers: set[Reader] = set()
        self._workers: Workers | None = None

    @property
    def workers(self) -> Workers:
        """Of the server while it runs."""
        if self._workers is None:
            raise RuntimeError("the server does not run")
        return self._workers

    async def start(self) -> None:
        """Start the workers, which go on with the sessions that they find."""
        self._workers = Workers(self.settings, self.folder, self.n_workers, self._shown)
        await self._workers.ready()
        self.sessions = await self.tracks()

    async def tracks(self) -> dict[str, Event]:
        """Sessions with their paths, by their names."""
        return {event["id"]: event for event in await self.workers.whole() if event["event"] == "track"}

    def stop(self) -> None:
        """Save everything."""
        self.workers.close()

    async def take(self, body: bytes, device: str = "", session: str = "", platform: str = "") -> Answer:
        """What became of the body of a message; `device` and the others are for messages that do not say them."""
        if len(body) > MAX_BODY_BYTES:
            return Answer(413, {"error": f"more than {MAX_BODY_BYTES} bytes in one message; send smaller ones"})
        found = _DEVICE.search(body)
        name = found[1].decode("utf-8", "replace") if found else device
        if not self.rates.allows(name, len(body)):
            return Answer(429, {"error": f"{name} sends too much; a phone may send 1 MB a second"})
        return await self.workers.take(Take(body, name, session, platform, time.time()))

    def _shown(self, text: str) -> None:
        """An event of a worker, to all who read."""
        head = json.loads(text[: text.index(",")] + "}")["event"]
        if head in ("session", "gone"):
            event = json.loads(text)
            if head == "gone":
                self.sessions.pop(event["id"], None)
            else:
                self.sessions[event["id"]] = event
        for reader in self._readers:
            reader.put(text)

    @property
    def is_full(self) -> bool:
        """Whether as many read as may."""
        return len(self._readers) >= _MAX_READERS

    async def events(self) -> AsyncIterator[str]:
        """Everything there is to show, from the whole as it is now; "" now and then while there is nothing."""
        reader = Reader()
        self._readers.add(reader)
        try:
            while True:
                if reader.is_stale:
                    reader.clear()
                    for event in await self.workers.whole():
                        yield json.dumps(event, allow_nan=False)
                yield await reader.get()
        finally:
            self._readers.discard(reader)


class Reader:
    """What waits for one who reads events; it is bounded, and who is too slow is told so by `is_stale`."""

    def __init__(self) -> None:
        self.is_stale = True
        self._waiting: deque[str] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, text: str) -> None:
        """Add an event, or forget them all."""
        if len(self._waiting) >= _MAX_WAITING:
            self.is_stale = True
            self._waiting.clear()
        self._waiting.append(text)
        self._filled.set()

    def clear(self) -> None:
        """Begin anew."""
        self.is_stale = False
        self._waiting.clear()

    async def get(self) -> str:
        """The next event; "" after some time without one, or where there is a new beginning."""
        if not self._waiting:
            self._filled.clear()
            try:
                await asyncio.wait_for(self._filled.wait(), _ALIVE_S)
            except TimeoutError:
                return ""
        return "" if self.is_stale else self._waiting.popleft()


def app(live: Live, token: str = "", tiles: str = "") -> Starlette:
    """The application. Without a token it answers this machine only; `tiles` is the address of a map's tiles."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncGenerator[None]:
        await live.start()
        yield
        live.stop()

    async def page(request: Request) -> Response:
        name = {"/": "index.html", "/phone": "phone.html"}[request.url.path]
        return FileResponse(PAGE / name, headers=_policy(tiles))

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        path = next((p for p in (PAGE / name, _ASSETS / name) if p.is_file()), PAGE / name)
        known = path.suffix in (".js", ".css", ".txt") and path.is_file()
        return FileResponse(path, headers=_policy(tiles)) if known else PlainTextResponse("not found", 404)

    async def data(request: Request) -> Response:
        body = await _body(request)
        return _TOO_LONG if body is None else _json(await live.take(body, **_named(request)))

    async def sessions(_: Request) -> Response:
        return JSONResponse({"sessions": list(live.sessions.values()), "tiles": tiles})

    async def fix(request: Request) -> Response:
        about = live.sessions.get(request.path_params["id"])
        if about is None:
            return JSONResponse({"error": "no such session"}, 404)
        try:
            content: Any = json.loads(await _body(request) or b"")
        except (ValueError, RecursionError):
            return JSONResponse({"error": "not JSON; send east_m, north_m and perhaps std_m"}, 400)
        body = json.dumps({"device": about["device"], "session": about["session"], "fix": content}).encode()
        return _json(await live.workers.take(Take(body, about["device"], received_s=time.time())))

    async def download(request: Request) -> Response:
        key, kind = request.path_params["id"], request.path_params["kind"]
        tracks = await live.tracks()
        if key not in tracks or kind not in ("track.geojson", "recording.zip"):
            return JSONResponse({"error": "no such session or file"}, 404)
        name = {"Content-Disposition": f'attachment; filename="{key}.{kind.partition(".")[2]}"'}
        if kind == "track.geojson":
            return Response(json.dumps(geojson(tracks[key])), media_type="application/geo+json", headers=name)
        content = await asyncio.to_thread(_zipped, live.folder / key)
        return Response(content, media_type="application/zip", headers=name)

    async def authority(_: Request) -> Response:
        path = live.folder / "certificate" / NAMES[0]
        kind = "application/x-x509-ca-cert"
        return FileResponse(path, media_type=kind) if path.exists() else PlainTextResponse("not with --https", 404)

    async def events(_: Request) -> Response:
        if live.is_full:
            return JSONResponse({"error": "too many read already"}, 503)

        async def lines() -> AsyncIterator[str]:
            async for text in live.events():
                yield f"data: {text}\n\n" if text else ": still here\n\n"

        return StreamingResponse(lines(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})

    async def events_socket(socket: WebSocket) -> None:
        if live.is_full:
            return await socket.close(1013)
        await socket.accept()
        try:
            async for text in live.events():
                await socket.send_text(text or "{}")
        except (WebSocketDisconnect, RuntimeError, OSError):  # the reader has gone
            return None

    async def stream(socket: WebSocket) -> None:
        await socket.accept()
        named = _named(socket)
        named["session"] = named["session"] or uuid.uuid4().hex
        named["device"] = named["device"] or f"websocket {named['session'][:6]}"
        try:
            while True:
                received = await socket.receive()
                if received["type"] == "websocket.disconnect":
                    return
                body = received.get("bytes") or (received.get("text") or "").encode()
                answer = await live.take(body, **named)
                await socket.send_text(json.dumps({"status": answer.status, **answer.content}))
        except (WebSocketDisconnect, RuntimeError, OSError):
            return

    routes = [
        Route("/", page),
        Route("/phone", page),
        Route("/page/{name}", asset),
        Route("/data", data, methods=["POST"]),
        Route("/sessions", sessions),
        Route("/sessions/{id}/fix", fix, methods=["POST"]),
        Route("/sessions/{id}/{kind}", download),
        Route("/authority.pem", authority),
        Route("/events", events),
        WebSocketRoute("/ws", events_socket),
        WebSocketRoute("/stream", stream),
    ]
    made = Starlette(routes=routes, lifespan=lifespan)
    made.add_middleware(Door, token=token)
    return made


class Door:
    """Lets in who has the token, or, without one, who is on this machine and is not sent by another site."""

    def __init__(self, inner: ASGIApp, token: str) -> None:
        self.inner, self.token = inner, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, or refuse."""
        if scope["type"] not in ("http", "websocket"):
            await self.inner(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        refusal = self._refusal(asked)
        if refusal is None:
            await self.inner(scope, receive, self._with_cookie(asked, send))
        elif scope["type"] == "http":
            await JSONResponse({"error": refusal[1]}, refusal[0])(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1][:100]})

    def _refusal(self, asked: HTTPConnection) -> tuple[int, str] | None:
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return 403, "pages of other sites may not ask this server"
        if not self.token:
            # a name that another site has pointed to this machine is not one of these
            return None if urlsplit(f"//{host}").hostname in LOOPBACK_NAMES else (403, "this server is for localhost")
        bearer = asked.headers.get("authorization", "").removeprefix("Bearer ").strip()
        if is_token(self.token, [asked.query_params.get("token"), bearer, asked.cookies.get(TOKEN_COOKIE)]):
            return None
        return 401, "wrong token, or none; use the whole address that the server printed"

    def _with_cookie(self, asked: HTTPConnection, send: Send) -> Send:
        """So that a page that was opened with the token can load the rest without it."""
        if not self.token or "token" not in asked.query_params or asked.scope["type"] != "http":
            return send
        secure = "; Secure" if asked.url.scheme == "https" else ""
        cookie = f"{TOKEN_COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/{secure}"

        async def with_cookie(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
            await send(message)

        return with_cookie


_TOO_LONG = JSONResponse({"error": f"more than {MAX_BODY_BYTES} bytes in one message; send smaller ones"}, 413)


async def _body(request: Request) -> bytes | None:
    """The body of a request; None of one that is too long, which is not read to its end."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY_BYTES:
            return None
    return bytes(body)


def _json(answer: Answer) -> Response:
    headers = {"Retry-After": "2"} if answer.status in (429, 503) else None
    return JSONResponse(answer.content, answer.status, headers=headers)


def _named(asked: HTTPConnection) -> dict[str, str]:
    """What the address says of who sends."""
    return {name: asked.query_params.get(name, "")[:200] for name in ("device", "session", "platform")}


def _policy(tiles: str) -> dict[str, str]:
    """The page loads nothing from elsewhere, but for the tiles that the user named."""
    where = urlsplit(tiles)
    images = f"'self' data: {where.scheme}://{where.netloc}" if tiles else "'self' data:"
    policy = f"default-src 'self'; img-src {images}; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
    return {"Content-Security-Policy": policy, "Cache-Control": "no-cache", "Referrer-Policy": "no-referrer"}


def _zipped(folder: Path) -> bytes:
    """The files of a recording that are on the disk."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression=zipfile.ZIP_DEFLATED) as archive:
        for name in FILES:
            if (folder / name).exists():
                archive.write(folder / name, name)
    return content.getvalue()
