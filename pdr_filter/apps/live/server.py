"""HTTP and WebSocket routes of the server, for pages, programs and phones."""

from __future__ import annotations

import json
import uuid
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from pdr_filter.apps.live.access import LOOPBACK_NAMES, MAX_BODY_BYTES, TOKEN_COOKIE, is_token
from pdr_filter.apps.live.broadcast import Broadcast
from pdr_filter.apps.live.certificate import NAMES
from pdr_filter.apps.live.connections import ALLOWED
from pdr_filter.apps.live.geojson import geojson
from pdr_filter.apps.live.hub import Live
from pdr_filter.apps.live.parts import Answer
from pdr_filter.apps.live.recorder import exported_files, zip_parts

APPS = Path(__file__).parents[1]
# Media types of the files that a page can request, by suffix.
_MEDIA_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}


def page_files(*folders: str) -> dict[str, bytes]:
    """Return the contents of all files of pages in some folders of `pdr_filter.apps`, by their names.

    They are read once, at the start, because another version of the package may be installed while a server runs. What
    a page asks for is looked up here, and never becomes a path.
    """
    paths = [path for folder in folders for path in (APPS / folder).iterdir() if path.suffix in _MEDIA_TYPES]
    return {path.name: path.read_bytes() for path in paths}


class Site:
    """Handlers of all routes of the web server. `tiles` is the address of the map tiles."""

    def __init__(self, live: Live, tiles: str) -> None:
        self.live, self.tiles = live, tiles
        self._files = page_files("report/assets", "report/page", "live/page")  # reports, too, have uPlot and the map

    def routes(self) -> list[Route | WebSocketRoute]:
        """Routes of the application."""
        return [
            Route("/", self.page),
            Route("/phone", self.page),
            Route("/page/{name}", self.asset),
            Route("/data", self.data, methods=["POST"]),
            Route("/sessions", self.sessions),
            Route("/sessions/{id}/fix", self.fix, methods=["POST"]),
            Route("/sessions/{id}/track.geojson", self.track),
            Route("/sessions/{id}/recording.zip", self.recording),
            Route("/authority.pem", self.authority),
            Route("/events", self.events),
            WebSocketRoute("/ws", self.events_socket),
            WebSocketRoute("/stream", self.stream),
        ]

    # --- the page ---

    async def page(self, request: Request) -> Response:
        """Serve the page that shows the tracks, or the page on which a phone records in its browser."""
        name = {"/": "index.html", "/phone": "phone.html"}[request.url.path]
        return HTMLResponse(self._files[name], headers=page_headers(self.tiles))

    async def asset(self, request: Request) -> Response:
        """Serve scripts and styles of the pages."""
        return asset_of(request, self._files, self.tiles)

    async def authority(self, _: Request) -> Response:
        """Serve the certificate of the authority."""
        path = self.live.folder / "certificate" / NAMES[0]
        kind = "application/x-x509-ca-cert"
        return FileResponse(path, media_type=kind) if path.exists() else PlainTextResponse("not with --https", 404)

    # --- messages ---

    async def data(self, request: Request) -> Response:
        """Process the body of a message that a phone sends."""
        return _json(await self.live.take(await body_of(request), **_named(request)))

    async def stream(self, socket: WebSocket) -> None:
        """Process messages that arrive over a WebSocket. Each message gets an answer."""
        await socket.accept()
        named = _named(socket)
        named["session"] = named["session"] or uuid.uuid4().hex
        named["device"] = named["device"] or f"websocket {named['session'][:6]}"
        with suppress(WebSocketDisconnect, RuntimeError, OSError):  # the sender has gone
            while (received := await socket.receive())["type"] != "websocket.disconnect":
                body = received.get("bytes") or (received.get("text") or "").encode()
                answer = await self.live.take(body, **named)
                await socket.send_text(json.dumps({"status": answer.status, **answer.content}))

    async def fix(self, request: Request) -> Response:
        """Pass a fix that a user has marked on the page to the session in the address, and return the answer."""
        about = self.live.sessions.get(request.path_params["id"])
        if about is None:
            return JSONResponse({"error": "no such session"}, 404)
        try:
            content: Any = json.loads(await body_of(request) or b"")
        except (ValueError, RecursionError):
            return JSONResponse({"error": "not JSON; send east_m, north_m and perhaps std_m"}, 400)
        body = json.dumps({"device": about["device"], "session": about["session"], "fix": content}).encode()
        return _json(await self.live.take(body))

    # --- results ---

    async def sessions(self, _: Request) -> Response:
        """Return all sessions, without their paths."""
        return JSONResponse({"sessions": list(self.live.sessions.values()), "tiles": self.tiles})

    async def track(self, request: Request) -> Response:
        """Return the path of the session in the address as a GeoJSON file, or status 404 if it does not exist."""
        key = request.path_params["id"]
        tracks = await self.live.tracks()
        if key not in tracks:
            return JSONResponse({"error": "no such session"}, 404)
        content = json.dumps(geojson(tracks[key]))
        return Response(content, media_type="application/geo+json", headers=attachment(f"{key}.geojson"))

    async def recording(self, request: Request) -> Response:
        """Return the recording of the session in the address as a zip file, or status 404 if it does not exist."""
        key = request.path_params["id"]
        if key not in self.live.sessions:  # otherwise a name from outside would become a path
            return JSONResponse({"error": "no such session"}, 404)
        is_refused = bool(self.live.sessions[key]["refused"])
        parts = zip_parts(exported_files(self.live.folder / key, is_refused))
        return StreamingResponse(parts, media_type="application/zip", headers=attachment(f"{key}.zip"))

    async def events(self, _: Request) -> Response:
        """Send events as server-sent events."""
        return event_stream(self.live.broadcast, self.live.events())

    async def events_socket(self, socket: WebSocket) -> None:
        """Send events over WebSocket."""
        if self.live.broadcast.is_full:
            await socket.close(1013)
            return
        await socket.accept()
        with suppress(WebSocketDisconnect, RuntimeError, OSError):  # the reader has gone
            async for text in self.live.events():
                await socket.send_text(text or "{}")


def live_application(live: Live, token: str = "", tiles: str = "") -> Starlette:
    """Application of a running server. Without a token it answers requests from this computer only."""
    return application(Site(live, tiles).routes(), token)


def application(routes: Sequence[BaseRoute], token: str) -> Starlette:
    """Application with some routes behind an `AccessMiddleware`."""

    async def left(*_: Any) -> Response:
        return Response(status_code=400)  # to nobody: the sender closed the connection before the end of its body

    made = Starlette(routes=routes, exception_handlers={ClientDisconnect: left})
    made.add_middleware(AccessMiddleware, token=token)
    return made


class AccessMiddleware:
    """Middleware that refuses requests from pages of other sites, and requests without the access token.

    If the server has no token, it refuses requests from other computers instead.
    """

    def __init__(self, inner: ASGIApp, token: str) -> None:
        self.inner, self.token = inner, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request to the application, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.inner(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        refusal = self._refusal(asked)
        if refusal is None:
            scope.setdefault("state", {})[ALLOWED] = True
            await self.inner(scope, receive, self._with_cookie(asked, send))
        elif scope["type"] == "http":
            await JSONResponse({"error": refusal[1]}, refusal[0])(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1][:100]})

    def _refusal(self, asked: HTTPConnection) -> tuple[int, str] | None:
        host, origin = asked.headers.get("host", ""), asked.headers.get("origin")
        server, page = _split(f"//{host}"), _split(origin or "")
        if server is None or page is None:
            return 400, "Host or Origin is not an address; use the whole address that the server printed"
        if origin is not None and page.netloc != host:
            return 403, "pages of other sites may not ask this server"
        if not self.token:
            # a name that another site has pointed to this machine is not one of these
            return None if server.hostname in LOOPBACK_NAMES else (403, "this server is for localhost")
        bearer = asked.headers.get("authorization", "").removeprefix("Bearer ").strip()
        if is_token(self.token, [asked.query_params.get("token"), bearer, asked.cookies.get(TOKEN_COOKIE)]):
            return None
        return 401, "wrong token, or none; use the whole address that the server printed"

    def _with_cookie(self, asked: HTTPConnection, send: Send) -> Send:
        """Return `send`, extended to set a cookie with the token if the address of an HTTP request has it."""
        if not self.token or "token" not in asked.query_params or asked.scope["type"] != "http":
            return send
        secure = "; Secure" if asked.url.scheme == "https" else ""
        cookie = f"{TOKEN_COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/{secure}"

        async def with_cookie(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
            await send(message)

        return with_cookie


def _split(address: str) -> SplitResult | None:
    """Return the parts of an address, or None for a text such as "//[::1", which has none."""
    try:
        return urlsplit(address)
    except ValueError:
        return None


async def body_of(request: Request, most: int = MAX_BODY_BYTES) -> bytes | None:
    """Return the body of a request, or None if it is too long. The rest is then not read."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > most:
            return None
    return bytes(body)


def asset_of(request: Request, files: Mapping[str, bytes], tiles: str) -> Response:
    """Return the script or style that a request names, or status 404 if it is not among the files."""
    name = request.path_params["name"]
    kind = Path(name).suffix
    if name not in files or kind == ".html":
        return PlainTextResponse("not found", 404)
    return Response(files[name], media_type=_MEDIA_TYPES[kind], headers=page_headers(tiles))


def event_stream(broadcast: Broadcast, events: AsyncIterator[str]) -> Response:
    """Return a response with the events of a server as server-sent events."""
    if broadcast.is_full:
        return JSONResponse({"error": "too many pages or programs read already; close one"}, 503)

    async def lines() -> AsyncIterator[str]:
        async for text in events:
            yield f"data: {text}\n\n" if text else ": still here\n\n"

    return StreamingResponse(lines(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})


def _json(answer: Answer) -> Response:
    headers = {"Retry-After": "2"} if answer.status in (429, 503) else None
    return JSONResponse(answer.content, answer.status, headers=headers)


def _named(asked: HTTPConnection) -> dict[str, str]:
    """Return the names of device, session and platform in the address of a request."""
    return {name: asked.query_params.get(name, "")[:200] for name in ("device", "session", "platform")}


def attachment(name: str) -> dict[str, str]:
    """Return the headers with which a browser saves a response as a file."""
    return {"Content-Disposition": f'attachment; filename="{name}"'}


def image_sources(tiles: str) -> str:
    """Return the sources of images that a page may load: this server and the server of the map tiles."""
    where = urlsplit(tiles)
    return f"'self' data: {where.scheme}://{where.netloc}" if tiles else "'self' data:"


def page_headers(tiles: str) -> dict[str, str]:
    """Return headers that forbid the page to load from other servers, except map tiles of the named server."""
    policy = (
        f"default-src 'self'; img-src {image_sources(tiles)}; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
    )
    return {"Content-Security-Policy": policy, "Cache-Control": "no-cache", "Referrer-Policy": "no-referrer"}
