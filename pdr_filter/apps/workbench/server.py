"""HTTP routes of the workbench. Ids and names in addresses are looked up among what exists; they never become paths."""

from __future__ import annotations

import asyncio
import errno
import html
import json
import re
import secrets
import shutil
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import segno
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Mount, Route

from pdr_filter.apps.live.hub import Live
from pdr_filter.apps.live.server import (
    APPS,
    Site,
    application,
    asset_of,
    attachment,
    body_of,
    event_stream,
    page_files,
    page_headers,
)
from pdr_filter.apps.workbench.hub import FailedError, Workbench
from pdr_filter.apps.workbench.pictures import MAX_PICTURE_BYTES
from pdr_filter.apps.workbench.plans import Plans
from pdr_filter.apps.workbench.walks import PEOPLE, ConflictError, Walk
from pdr_filter.apps.workbench.worker import EXPORTS
from pdr_filter.recipes import RECIPES
from pdr_filter.values import limits
from pdr_filter.values.safe_files import read_json
from pdr_filter.values.sanitise import file_name, free_name

_TEXTS = APPS / "workbench" / "page" / "texts.json"
_TEXT = re.compile(r"\{\{(\w+)\}\}")
# A recording of a day at 200 Hz in a zip file has 1 GB.
_MAX_DROP_BYTES = 1024**3
_MAX_DROP_FILES = 10_000
# A page waits no longer than this for the list of recordings.
_SCAN_S = 1.5
_MAX_EDIT_BYTES = 8 * 1024**2
_TOKEN, _FLOOR = re.compile(r"[0-9a-f]{16}"), re.compile(r"[0-9]{1,3}")

Handler = Callable[[Request], Awaitable[Response]]


class UnknownError(ValueError):
    """Error for an id or a name that does not exist."""


class TooLargeError(ValueError):
    """Error for a file or message that is larger than allowed."""


class WorkbenchSite:
    """Handlers of all HTTP routes of the workbench.

    `address` is the whole address of the workbench, with its token.
    """

    def __init__(self, workbench: Workbench, tiles: str, address: str, phone: str, texts: dict[str, str]) -> None:
        self.workbench, self.plans = workbench, Plans(workbench.folder)
        self.tiles, self.address, self.phone, self.texts = tiles, address, phone, texts
        self._files = page_files("report/assets", "report/page", "workbench/page")
        self._drops: dict[Path, tuple[int, int]] = {}  # files and bytes of each drop that has not ended

    def routes(self) -> list[BaseRoute]:
        """Routes of the application."""
        get: list[tuple[str, Handler]] = [
            ("/", self.page),
            ("/walk/{id}", self.page),
            ("/plan/{name}", self.page),
            ("/page/{name}", self.asset),
            ("/events", self.events),
            ("/walks", self.walks),
            ("/walks/{id}", self.walk),
            ("/walks/{id}/report", self.report),
            ("/walks/{id}/compare", self.compare),
            ("/walks/{id}/export/{kind}", self.export),
            ("/plans/{name}", self.plan),
            ("/plans/{name}/{floor}.png", self.picture),
        ]
        post: list[tuple[str, Handler]] = [
            ("/drops/{token}", self.drop),
            ("/drops/{token}/end", self.end_drop),
            ("/walks/{id}/marks", self.edit),
            ("/walks/{id}/undo", self.undo),
            ("/walks/{id}/redo", self.redo),
            ("/walks/{id}/teach", self.teach),
            ("/plans", self.new_plan),
            ("/plans/{name}", self.save_plan),
            ("/plans/{name}/{floor}.png", self.set_picture),
            ("/plans/{name}/{floor}/rectify", self.rectify),
        ]
        return [
            Route(path, _answering(handler), methods=[method])
            for method, handlers in (("GET", get), ("POST", post))
            for path, handler in handlers
        ]

    # --- pages ---

    async def page(self, request: Request) -> Response:
        """Serve an HTML page: the list of walks, a walk or a floor plan, with `texts` in the language of the user."""
        kind = request.url.path.split("/")[1] or "index"
        if kind == "walk":
            self._walk(request)
        elif kind == "plan":
            self._plan(request)
        content = self._files[f"{kind}.html"].decode()
        filled = _TEXT.sub(lambda found: html.escape(self.texts[found[1]]), content)
        about = {"texts": self.texts, "tiles": self.tiles, "recipes": list(RECIPES), "exports": list(EXPORTS)}
        data = json.dumps(about).replace("<", "\\u003c")
        return HTMLResponse(filled.replace("[[about]]", data), headers=page_headers(self.tiles))

    async def asset(self, request: Request) -> Response:
        """Serve scripts and styles of the pages."""
        return asset_of(request, self._files, self.tiles)

    async def events(self, _: Request) -> Response:
        """Send events as server-sent events."""
        return event_stream(self.workbench.broadcast, self.workbench.events())

    # --- walks ---

    async def walks(self, _: Request) -> Response:
        """Return all walks, floor plans and people, and the addresses for phones and other browsers."""
        with suppress(TimeoutError):  # of thousands of files; pages are told of them when they are found
            await asyncio.wait_for(asyncio.shield(self.workbench.scan()), _SCAN_S)
        phone = {"address": self.phone, "code": segno.make(self.phone, micro=False).svg_inline(scale=3)}
        found = {
            "folder": self.workbench.folder.name,
            "walks": [walk.event() for walk in self.workbench.walks.by_id.values()],
            "plans": self.plans.names(),
            "people": self.workbench.walks.people(),
            "address": self.address,
            "phone": phone if self.phone else None,
        }
        return JSONResponse(found)

    async def walk(self, request: Request) -> Response:
        """Return the marks of a walk, and its summary if the walk has been processed."""
        return JSONResponse(self._state(self._walk(request)))

    async def report(self, request: Request) -> Response:
        """Serve the report of a walk, computed with its present marks."""
        summary = await self.workbench.show(self._walk(request))
        return self._cached(summary["key"])

    async def compare(self, request: Request) -> Response:
        """Serve a report that compares several recipes on one walk.

        Each pair `recipe/weighting` of the query names a recipe and a method that weights its step-length models:
        "imm", "hc", "wc", or an empty string for the method of the recipe.
        """
        walk = self._walk(request)
        given = request.query_params.getlist("with")[:12]
        if not given:
            raise ValueError("nothing to compare: the address has no recipes; add them, such as with=default/imm")
        pairs = [tuple(pair.split("/")) for pair in given]
        weightings = ("", "imm", "hc", "wc")
        for text, pair in zip(given, pairs, strict=True):
            if len(pair) != 2 or pair[0] not in RECIPES or pair[1] not in weightings:
                raise ValueError(
                    f"{text[:80]!r} is not a recipe and a weighting that this version knows: give one of "
                    f"{', '.join(RECIPES)}, then a slash, then imm, hc, wc or nothing, such as with=default/imm"
                )
        found = await self.workbench.quick("compare", str(walk.path), pairs)
        return self._cached(found["key"])

    async def export(self, request: Request) -> Response:
        """Return an exported file of a walk, of one of the kinds `EXPORTS`."""
        walk, kind = self._walk(request), request.path_params["kind"]
        if kind not in EXPORTS:
            raise UnknownError(f"there is no export {kind[:20]!r}; give one of {', '.join(EXPORTS)}")
        name, content = await self.workbench.quick("export", str(walk.path), kind)
        headers = attachment(quote(file_name(name)))
        return Response(content, media_type=EXPORTS[kind], headers=headers)

    async def edit(self, request: Request) -> Response:
        """Replace the marks of a walk, and return them with their new version. Status 409 if they have changed."""
        walk, content = self._walk(request), await _json_of(request)
        return self._changed(walk, lambda: walk.edit(content["version"], content["marks"], self.workbench.folder))

    async def undo(self, request: Request) -> Response:
        """Undo the last edit of a walk, and return its marks with their new version."""
        walk, content = self._walk(request), await _json_of(request)
        return self._changed(walk, lambda: walk.undo(content["version"]))

    async def redo(self, request: Request) -> Response:
        """Redo the edit of a walk that was undone last, and return its marks with their new version."""
        walk, content = self._walk(request), await _json_of(request)
        return self._changed(walk, lambda: walk.redo(content["version"]))

    async def teach(self, request: Request) -> Response:
        """Save the step length that the fixes of a walk determine in the file of its person, for other walks."""
        walk = self._walk(request)
        name = walk.marks(self.workbench.folder)["marks"]["walk"].get("person", "")
        if not name:
            raise ValueError("the walk has no name of a person; write it, so that other walks can use the step length")
        path = self.workbench.folder / PEOPLE / f"{file_name(name)}.json"
        return JSONResponse(await self.workbench.quick("teach", str(walk.path), str(path)))

    def _walk(self, request: Request) -> Walk:
        walk = self.workbench.walks.by_id.get(request.path_params["id"])
        if walk is None:
            raise UnknownError("there is no such walk in this folder: reload the list of walks")
        return walk

    def _state(self, walk: Walk) -> dict[str, Any]:
        return {**walk.marks(self.workbench.folder), "walk": walk.event(), "files": str(walk.folder)}

    def _changed(self, walk: Walk, change: Callable[[], None]) -> Response:
        change()
        state = self._state(walk)
        self.workbench.tell({"event": "marks", "id": walk.id, "version": state["version"]})
        return JSONResponse(state)

    def _cached(self, key: str) -> Response:
        headers = {"Cache-Control": "no-store", "Content-Security-Policy": "frame-ancestors 'none'"}
        return FileResponse(self.workbench.cache / f"{key}.html", media_type="text/html", headers=headers)

    # --- dropped files ---

    async def drop(self, request: Request) -> Response:
        """Save one uploaded file of a drop, and return its name.

        A drop is a file or folder that the user drags onto the page. It is uploaded file by file to a temporary folder.
        The path of the file in the dropped folder is sanitised, and only its last two parts are used.
        """
        folder = self._drop(request)
        if not folder.is_dir():
            folder.mkdir()
            self._drops[folder] = 0, 0
        parts = [file_name(part) for part in request.query_params.get("name", "")[:500].split("/")[-2:] if part]
        n_files, n_bytes = self._drops.get(folder, (0, 0))
        target = folder.joinpath(*(parts or ["recording"]))
        try:
            if n_files >= _MAX_DROP_FILES:
                raise TooLargeError(f"more than {_MAX_DROP_FILES} files; drop the folder of one recording")
            target.parent.mkdir(exist_ok=True)
            too_large = (
                f"more than {_MAX_DROP_BYTES // 1024**2} MB in one drop, which may hold more than sensor data; drop "
                "the sensor files of one recording"
            )
            n_new = await _stream_to(request, target, _MAX_DROP_BYTES - n_bytes, too_large)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self._drops[folder] = n_files + 1, n_bytes + n_new
        return JSONResponse({"name": target.name})

    async def end_drop(self, request: Request) -> Response:
        """Move the files of a complete drop into the folder of the workbench if their first recording can be read.

        Return the name of the new folder and the number of recordings `n`. Otherwise delete the files and raise
        FailedError with the reason.
        """
        folder = self._drop(request)
        if not folder.is_dir():
            raise UnknownError("no files were uploaded: drop them on the page again")
        try:
            inside = list(folder.iterdir())
            source = inside[0] if len(inside) == 1 else folder
            found = await self.workbench.quick("check", str(source))
            wanted = request.query_params.get("name", "") or source.name
            stem = file_name(Path(wanted).stem if source.is_file() else wanted)
            home = self.workbench.folder
            target = home / free_name(stem, lambda name: (home / name).exists())
            if source.is_file():  # in a folder of its own name, where its marks will be
                target.mkdir()
                source.replace(target / f"{target.name}{''.join(source.suffixes[-1:])}")
            else:
                source.replace(target)
        except FailedError as error:
            raise FailedError(str(error).replace(f"{folder}/", ""), error.errno) from None
        finally:
            self._drops.pop(folder, None)
            shutil.rmtree(folder, ignore_errors=True)
        await self.workbench.scan(is_forced=True)
        return JSONResponse({"name": target.name, **found})

    def _drop(self, request: Request) -> Path:
        token = request.path_params["token"]
        if not _TOKEN.fullmatch(token):
            raise UnknownError("the name of an upload must have sixteen hexadecimal digits: reload the page")
        return self.workbench.incoming / token

    # --- floor plans ---

    async def plan(self, request: Request) -> Response:
        """Return a floor plan for the editor."""
        return JSONResponse(await asyncio.to_thread(self.plans.load, self._plan(request)))

    async def new_plan(self, request: Request) -> Response:
        """Create an empty floor plan, or one from the text of a GeoJSON file, and return its name."""
        content = await _json_of(request)
        return JSONResponse({"name": self.plans.new(str(content["name"])[:100], str(content.get("file", "")))})

    async def save_plan(self, request: Request) -> Response:
        """Replace a floor plan; return it with its problems."""
        name, content = self._plan(request), await _json_of(request)
        saved = await asyncio.to_thread(self.plans.save, name, str(content["version"]), content)
        self.workbench.tell({"event": "plan", "name": name, "version": saved["version"]})
        return JSONResponse(saved)

    async def picture(self, request: Request) -> Response:
        """Serve the picture of a storey."""
        path = self._picture(request)
        if not path.exists():
            raise UnknownError("this storey has no picture: add one to the floor plan")
        return FileResponse(path, headers={"Cache-Control": "no-store"})

    async def set_picture(self, request: Request) -> Response:
        """Store the uploaded picture of a storey, and return its size."""
        path = self._picture(request)
        source = self.workbench.incoming / f"{secrets.token_hex(8)}.source"  # two uploads may run at the same time
        try:
            too_large = f"the picture has more than {MAX_PICTURE_BYTES // 1024**2} MB; give a smaller file"
            await _stream_to(request, source, MAX_PICTURE_BYTES, too_large)
            page = int(request.query_params.get("page", "1"))
            return JSONResponse(await self.workbench.quick("picture", str(source), page, str(path)))
        finally:
            source.unlink(missing_ok=True)

    async def rectify(self, request: Request) -> Response:
        """Rectify the picture of a storey by four corners, and return its size."""
        path = self._picture(request)
        content = await _json_of(request)
        return JSONResponse(await self.workbench.quick("rectify", str(path), content["corners"]))

    def _picture(self, request: Request) -> Path:
        """Return the file of the picture of a storey. UnknownError for a number that no storey has."""
        name, floor = self._plan(request), request.path_params["floor"]
        if not _FLOOR.fullmatch(floor):
            raise UnknownError("the number of a storey must have one to three digits: reload the floor plan")
        return self.plans.picture(name, int(floor))

    def _plan(self, request: Request) -> str:
        name = request.path_params["name"]
        if self.plans.path(name) is None:
            raise UnknownError("there is no such floor plan in this folder: reload the list of plans")
        return name


def workbench_application(
    workbench: Workbench,
    live: Live | None,
    token: str = "",
    tiles: str = "",
    address: str = "",
    phone: str = "",
    texts: dict[str, str] | None = None,
) -> Starlette:
    """Application of a running workbench, with the pages of `live` for phones below /live."""
    site = WorkbenchSite(workbench, tiles, address, phone, texts or read_texts())
    routes = site.routes()
    if live is not None:
        routes.append(Mount("/live", routes=Site(live, tiles).routes()))
    return application(routes, token)


def read_texts(path: Path | None = None) -> dict[str, str]:
    """Return the texts of the pages, with translated texts in place of English ones. ValueError for unknown names."""
    texts: dict[str, str] = read_json(_TEXTS, limits.MAX_SMALL_BYTES)
    own = {} if path is None else read_json(path, limits.MAX_SMALL_BYTES)
    if not isinstance(own, dict) or own.keys() - texts.keys() or not all(isinstance(v, str) for v in own.values()):
        raise ValueError(f"{path}: must be a JSON object of texts by name, with no other names than in {_TEXTS}")
    return texts | own


# Status of errors whose words are for the user; all others are ValueErrors of the content: 400.
_STATUS: dict[type[Exception], int] = {UnknownError: 404, ConflictError: 409, TooLargeError: 413}


def _answering(handler: Handler) -> Handler:
    """Return a handler that answers errors with an HTTP status and a JSON object with the message of the error."""

    async def answer(request: Request) -> Response:
        try:
            return await handler(request)
        except FailedError as error:
            return JSONResponse({"error": str(error)}, 507 if error.errno in _FULL else 422)
        except OSError as error:
            if error.errno in _FULL:
                words = "the disk is full: nothing was changed. Free some space, and try again"
                return JSONResponse({"error": words}, 507)
            return JSONResponse({"error": f"{error.strerror or error}: {Path(error.filename or '').name}"}, 500)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            words = str(error) if isinstance(error, ValueError) else f"the request has another form: {error}"
            return JSONResponse({"error": words}, _STATUS.get(type(error), 400))

    return answer


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


async def _json_of(request: Request) -> dict[str, Any]:
    body = await body_of(request, _MAX_EDIT_BYTES)
    if body is None:
        raise TooLargeError(
            f"the request has more than {_MAX_EDIT_BYTES} bytes: remove marks of the walk, or draw a simpler plan"
        )
    try:
        content = json.loads(body)
    except RecursionError:
        raise ValueError("the body of the request must be JSON: reload the page") from None
    if not isinstance(content, dict):
        raise ValueError("the body of the request must be a JSON object: reload the page")
    return content


async def _stream_to(request: Request, target: Path, most: int, too_large: str) -> int:
    """Write the body of a request to a file and return its size.

    If it has more than `most` bytes, TooLargeError with the message `too_large`.
    """
    n_bytes = 0
    with target.open("wb") as file:
        async for part in request.stream():
            n_bytes += len(part)
            if n_bytes > most:
                raise TooLargeError(too_large)
            await asyncio.to_thread(file.write, part)
    return n_bytes
