"""Command `pdr-filter live`, a server that tracks the phones that send it samples."""

from __future__ import annotations

import asyncio
import socket
import sys
import tempfile
import uuid
from collections.abc import Callable, Coroutine, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import Platform, Tiles, height_in_metres

if TYPE_CHECKING:
    from pdr_filter.apps.live.hub import Live
    from pdr_filter.apps.live.settings import Settings
    from pdr_filter.apps.workbench.hub import Workbench
    from pdr_filter.values.recording import Recording


# Interval at which the server is checked for shutdown.
_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class Address:
    """Address of the server, and the token for access."""

    host: str = typer.Option(
        "127.0.0.1",
        help="Address on which the server listens. 0.0.0.0 accepts phones in the same network, with a token.",
    )
    port: int = typer.Option(8000, min=0, max=65535, help="Port. 0 takes any free port.")
    token: str | None = typer.Option(
        None,
        help="Access token, which is part of the URL. Default: a random token if the server accepts other machines.",
    )
    https: bool = typer.Option(
        False,
        "--https",
        help="Serve over HTTPS with a self-made certificate, which the page that sends from a browser needs.",
    )

    @property
    def name(self) -> str:
        """Name or address by which phones reach this computer."""
        from pdr_filter.apps.live.access import lan_address

        return lan_address() if self.host in ("0.0.0.0", "::") else self.host

    @property
    def is_open(self) -> bool:
        """True if other machines can reach the server."""
        from pdr_filter.apps.live.access import is_loopback

        return not is_loopback(self.host)

    def url(self, port: int) -> str:
        """URL of the server without a path."""
        host = f"[{self.name}]" if ":" in self.name else self.name
        return f"http{'s' * self.https}://{host}:{port}"

    def token_in(self, folder: Path | None) -> str:
        """Return the token, by default the one that is stored in a folder. It is empty without --token on loopback."""
        from pdr_filter.apps.live.access import made_token

        return (self.token or made_token(folder)) if self.is_open or self.token else ""

    def server(self, application: Any, folder: Path) -> Any:
        """Return the server of an application. `folder` holds the certificate for --https."""
        import uvicorn

        from pdr_filter.apps.live.certificate import certificate
        from pdr_filter.apps.live.connections import LimitedConnection, TlsConnection, backlog, tls_context

        protocol: Any = LimitedConnection
        if self.https:
            protocol = partial(TlsConnection, tls_context(certificate(folder / "certificate", self.name)))
        return uvicorn.Server(
            uvicorn.Config(
                application,
                http=protocol,
                backlog=backlog(),
                log_level="warning",
                access_log=False,
                ws_max_size=4 * 1024**2,
                timeout_graceful_shutdown=2,
                lifespan="off",
            )
        )


@dataclass(frozen=True, slots=True)
class Phones:
    """Options for phones and pedestrians."""

    platform: Platform = None
    height: list[str] | None = typer.Option(
        None,
        metavar="[PHONE=]M",
        help="Height of the persons in metres, such as 1.78, if a phone does not send another one. PHONE=1.78 is the "
        "height of the person with one phone, where PHONE is its name or the first letters of its name.",
    )
    recipe: str = typer.Option("default", help="Name of a recipe, or module:function for a recipe of your own.")
    max_devices: int = typer.Option(64, min=1, help="Maximum number of phones at the same time.")
    workers: int = typer.Option(1, min=1, help="Number of processes among which the phones are divided.")
    scheduler: str | None = typer.Option(
        None,
        help="Address of a Dask cluster among whose machines the phones are divided, such as tcp://host:8786. All "
        "machines need access to the folder of --record.",
    )

    def settings(self) -> Settings:
        """Return the settings of the server. ValueError for a recipe that does not exist or cannot be saved."""
        from pdr_filter.apps.live.settings import Settings

        named: list[tuple[str, float]] = []
        for text in self.height or ():
            name, _, metres = text.rpartition("=")
            named.append((name, height_in_metres(metres)))
        of_all = [height_m for name, height_m in named if not name]
        of_phones = tuple((name, height_m) for name, height_m in named if name)
        height_m = of_all[-1] if of_all else None
        settings = Settings(self.recipe, height_m, self.platform or "", self.max_devices, of_phones)
        if self.recipe != "default":
            from pdr_filter.apps.live.session import plain_config_bytes

            plain_config_bytes(settings)
        return settings


@dataclass(frozen=True, slots=True)
class Sources:
    """Sources from which the server fetches samples."""

    phyphox: list[str] | None = typer.Option(
        None, metavar="HOST:PORT", help="Address of a phone that runs phyphox with remote access enabled."
    )
    sensorserver: list[str] | None = typer.Option(
        None, metavar="HOST:PORT", help="Address of an Android phone that runs SensorServer."
    )
    mqtt: list[str] | None = typer.Option(
        None,
        metavar="URL",
        help="Topic of an MQTT broker: mqtt://HOST/TOPIC or mqtts://HOST/TOPIC, with "
        "USER:PASSWORD@ before HOST if needed.",
    )
    replay: Path | None = typer.Option(None, help="Replay this recording instead of listening to a phone.")
    speed: float = typer.Option(1.0, min=0.01, help="Playback speed relative to real time.")

    def walk(self, height_m: float | None) -> Recording | None:
        """Return the recording that is replayed, or None. `height_m` replaces the height in the recording."""
        from pdr_filter.data.io.formats import read

        recording = None if self.replay is None else read(self.replay)
        return recording if recording is None or height_m is None else recording.of_height(height_m)

    def tasks(self, walk: Recording | None, shared: Live, record: Path | None) -> list[Coroutine[Any, Any, None]]:
        """Return a coroutine for each source, which fetches its samples and passes them to the server `shared`.

        With the folder `record`, brokers keep messages for the next start of the server.
        """
        from pdr_filter.apps.live import sources

        def take(name: str) -> sources.Taker:
            return sources.told(shared.take, name, console.say_error)

        session = uuid.uuid4().hex[:8]
        made: list[tuple[str, Callable[[], Coroutine[Any, Any, None]]]] = [
            *((at, sources.Phyphox(at, take(at)).run) for at in self.phyphox or ()),
            *((at, partial(sources.sensor_server, at, session, take(at))) for at in self.sensorserver or ()),
            # not named by `at`, which may have a password
            *(("--mqtt", sources.Mqtt(at, take("--mqtt"), record).run) for at in self.mqtt or ()),
        ]
        replay = [] if walk is None else [sources.replay(walk, self.speed, take(f"--replay {walk.name}"))]
        return [*(sources.again(name, source, console.say_error) for name, source in made), *replay]


def live_command(
    address: Address,
    phones: Phones,
    sources: Sources,
    record: Path | None = typer.Option(None, help="Folder for recordings. A restarted server resumes the walks in it."),
    tiles: Tiles = "",
) -> None:
    """Track phones in real time. A web page shows the position of each phone with its uncertainty.

    Phones send with Sensor Logger, SensorServer, phyphox, MQTT or their browser, as described in docs/live.md.
    """
    with console.one_line_errors(), ExitStack() as opened:
        try:
            import uvicorn  # noqa: F401  # pyright: ignore[reportUnusedImport]

            from pdr_filter.apps.live.folder_lock import folder_lock
            from pdr_filter.apps.live.hub import Live
            from pdr_filter.apps.live.server import live_application
        except ImportError as error:
            raise ValueError(
                f'the packages of the live server are not installed ({error}): pip install "pdr_filter[live]"'
            ) from None
        settings = phones.settings()
        walk = sources.walk(settings.height_m)  # before the server starts, because a bad file must end the command
        token = address.token_in(record)
        folder = record or Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="pdr_filter_live_")))
        folder.mkdir(parents=True, exist_ok=True)
        shared = Live(settings, folder, phones.workers, phones.scheduler or "")
        listening = opened.enter_context(bound_socket(address.host, address.port))
        port = listening.getsockname()[1]
        opened.enter_context(folder_lock(folder, f"pdr-filter live at {address.url(port)}"))
        server = address.server(live_application(shared, token, tiles), folder)  # may write a certificate there
        say = partial(_print_addresses, address, port, token)
        asyncio.run(run_server(server, listening, [shared], partial(sources.tasks, walk, shared, record), say))


def bound_socket(host: str, port: int) -> socket.socket:
    """Return a bound socket. ValueError if the address is in use or not permitted."""
    made = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise ValueError(
            f"cannot listen on {host}, port {port}: {error.strerror}; give another --host or --port"
        ) from None
    return made


async def run_server(
    server: Any,
    listening: socket.socket,
    parts: Sequence[Live | Workbench],
    sources: Callable[[], list[Coroutine[Any, Any, None]]],
    say: Callable[[], None],
) -> None:
    """Start the workers of all parts, serve until Ctrl+C, and stop the workers.

    `say` is called, and the sources run, when the server accepts connections.
    """
    try:
        for part in parts:
            await part.start()
        fetching = sources()  # before the server accepts connections, because a wrong address ends the command
        serving = asyncio.create_task(server.serve([listening]))
        while not (server.started or serving.done()):
            await asyncio.sleep(0.02)
        say()
        ends = [_end_events(server, part) for part in parts]
        tasks = [*map(asyncio.create_task, ends), *(asyncio.create_task(_run_source(source)) for source in fetching)]
        try:
            await serving
        finally:
            for task in tasks:
                task.cancel()
    finally:
        for part in parts:
            await part.stop()


async def _end_events(server: Any, part: Live | Workbench) -> None:
    """Close the event streams of a part when the server shuts down, because the server waits for open connections."""
    while not server.should_exit:
        await asyncio.sleep(_POLL_S)
    part.broadcast.end()


async def _run_source(source: Coroutine[Any, Any, None]) -> None:
    """Run a source. A ValueError or OSError that ends it is printed, so that the other sources continue."""
    try:
        await source
    except (ValueError, OSError) as error:
        console.say_error(console.message(error))


def _print_addresses(address: Address, port: int, token: str) -> None:
    """Print the URLs of the server, and a QR code for phones if there is a token."""
    import segno

    root, query = address.url(port), f"?token={token}" if token else ""
    console.say(f"page         {root}/{query}")
    console.say(f"phones send  {root}/data{query}")
    if address.https:
        console.say(f"browsers     {root}/phone{query}")
    if token:
        segno.make(f"{root}/{'phone' * address.https}{query}", micro=False).terminal(sys.stderr, compact=True)
    console.say("Ctrl+C stops the server.")
