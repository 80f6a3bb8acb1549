"""Command `pdr-filter app`: the local workbench in a browser."""

from __future__ import annotations

import asyncio
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.live import Address, bound_socket, serve_page, until_exit

if TYPE_CHECKING:
    import socket

    from pdr_filter.apps.live.hub import Live
    from pdr_filter.apps.workbench.hub import Workbench


def workbench_command(
    address: Address,
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of walks. It is created if it does not exist.")
    ] = Path(),
    tiles: Annotated[str, typer.Option(metavar="URL", help="URL of map tiles, which contains {z}, {x} and {y}.")] = "",
    texts: Annotated[Path | None, typer.Option(help="JSON file with translated texts of the pages.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Number of worker processes. Default: one for each core.")
    ] = None,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open a browser.")] = False,
) -> None:
    """Open the walks of a folder in a browser: mark known points, place and export them, and draw floor plans.

    Nothing leaves the machine. docs/workbench.md shows how.
    """
    with console.one_line_errors(), ExitStack() as opened:
        try:
            import shapely  # noqa: F401  # pyright: ignore[reportUnusedImport]
            import uvicorn

            from pdr_filter.apps.live.access import is_loopback, made_token
            from pdr_filter.apps.live.certificate import certificate
            from pdr_filter.apps.live.hub import Live
            from pdr_filter.apps.live.settings import Settings
            from pdr_filter.apps.workbench.hub import Workbench
            from pdr_filter.apps.workbench.server import read_texts
            from pdr_filter.apps.workbench.server import workbench_application as application
            from pdr_filter.apps.workbench.walks import HIDDEN, PHONES
        except ImportError as error:
            raise ValueError(f'app needs more packages ({error}): pip install "pdr_filter[app]"') from None
        known = read_texts(texts)
        folder = folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        is_open = not is_loopback(address.host)
        token = (address.token or made_token(folder / HIDDEN)) if is_open or address.token else ""
        workbench = Workbench(folder, jobs)
        live = None
        if is_open:
            (folder / PHONES).mkdir(exist_ok=True)
            live = Live(Settings(), folder / PHONES)
        certified: dict[str, Any] = {}
        if address.https:
            certified["ssl_certfile"] = certificate(folder / PHONES / "certificate", address.name)
        listening = opened.enter_context(bound_socket(address.host, address.port))
        root, query = address.address(listening.getsockname()[1]), f"?token={token}" if token else ""
        phone = f"{root}/live/{'phone' if address.https else 'data'}{query}" if is_open else ""
        made = application(workbench, live, token, tiles, f"{root}/{query}", phone, known)
        config = uvicorn.Config(
            made, **certified, log_level="warning", access_log=False, timeout_graceful_shutdown=2, lifespan="off"
        )

        def say(_: int) -> None:
            out = console.stderr()
            out.print(f"workbench    {root}/{query}")
            if phone:
                out.print(f"phones send  {phone}")
            out.print("Ctrl+C stops the workbench.")
            if not no_browser:
                webbrowser.open(f"{root}/{query}")

        asyncio.run(_run(workbench, live, uvicorn.Server(config), listening, say))


async def _run(
    workbench: Workbench, live: Live | None, server: Any, listening: socket.socket, say: Callable[[int], None]
) -> None:
    """Serve while the workers run."""
    shared = [workbench] if live is None else [workbench, live]
    try:
        for each in shared:
            await each.start()
        await serve_page(server, listening, [until_exit(server, each.broadcast.end) for each in shared], say)
    finally:
        for each in shared:
            await each.stop()
