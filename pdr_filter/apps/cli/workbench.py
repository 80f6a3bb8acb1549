"""Command `pdr-filter app`: the local workbench in a browser."""

from __future__ import annotations

import asyncio
import webbrowser
from contextlib import ExitStack
from pathlib import Path

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.live import Address, bound_socket, run_server
from pdr_filter.apps.cli.options import Tiles


def workbench_command(
    address: Address,
    folder: Path = typer.Argument(
        Path(), metavar="FOLDER", help="Folder of walks. It is created if it does not exist."
    ),
    tiles: Tiles = "",
    texts: Path | None = typer.Option(None, help="JSON file with translated texts of the pages."),
    jobs: int | None = typer.Option(None, min=1, help="Number of worker processes. Default: one for each core."),
    no_browser: bool = typer.Option(False, "--no-browser", help="Do not open a browser."),
) -> None:
    """Open the walks of a folder in a browser: mark known points, place and export them, and draw floor plans.

    Nothing leaves the machine. docs/workbench.md shows how.
    """
    with console.one_line_errors(), ExitStack() as opened:
        try:
            import shapely  # noqa: F401  # pyright: ignore[reportUnusedImport]
            import uvicorn  # noqa: F401  # pyright: ignore[reportUnusedImport]

            from pdr_filter.apps.live.folder_lock import folder_lock
            from pdr_filter.apps.live.hub import Live
            from pdr_filter.apps.live.settings import Settings
            from pdr_filter.apps.workbench.hub import Workbench
            from pdr_filter.apps.workbench.server import read_texts, workbench_application
            from pdr_filter.apps.workbench.walks import HIDDEN, PHONES
        except ImportError as error:
            raise ValueError(f'app needs more packages ({error}): pip install "pdr_filter[app]"') from None
        known = read_texts(texts)
        folder = folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        token = address.token_in(folder / HIDDEN)
        workbench = Workbench(folder, jobs)
        live = None
        if address.is_open:
            (folder / PHONES).mkdir(exist_ok=True)
            live = Live(Settings(), folder / PHONES)
        listening = opened.enter_context(bound_socket(address.host, address.port))
        root, query = address.url(listening.getsockname()[1]), f"?token={token}" if token else ""
        for written in (folder / HIDDEN, folder / PHONES) if address.is_open else (folder / HIDDEN,):
            opened.enter_context(folder_lock(written, f"pdr-filter app at {root}"))
        phone = f"{root}/live/{'phone' if address.https else 'data'}{query}" if address.is_open else ""
        application = workbench_application(workbench, live, token, tiles, f"{root}/{query}", phone, known)
        server = address.server(application, folder / PHONES)

        def say() -> None:
            console.say(f"workbench    {root}/{query}")
            if phone:
                console.say(f"phones send  {phone}")
            console.say("Ctrl+C stops the workbench.")
            if not no_browser:
                webbrowser.open(f"{root}/{query}")

        parts = [workbench] if live is None else [workbench, live]
        asyncio.run(run_server(server, listening, parts, list, say))
