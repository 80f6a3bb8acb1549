"""Attacks on the workbench: other sites, names that are paths, bombs, floods, a full disk."""

from __future__ import annotations

import asyncio
import errno
import io
import struct
import tempfile
import zipfile
import zlib
from pathlib import Path

import httpx
import pytest
from benches import Client, running, short_walk
from starlette.routing import Mount, Route

from pdr_filter.apps.workbench import server, worker
from pdr_filter.apps.workbench.hub import Workbench
from pdr_filter.apps.workbench.server import WorkbenchSite, workbench_application
from pdr_filter.apps.workbench.walks import Walks
from pdr_filter.values import safe_files

pytestmark = pytest.mark.anyio  # runs the tests that are coroutines


def everything_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def zipped() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return short_walk().save(Path(folder) / "walk.zip").read_bytes()


def test_every_address_refuses_other_sites_other_hosts_and_wrong_tokens(tmp_path: Path) -> None:
    bench = Workbench(tmp_path, 1)
    routes = [route for route in WorkbenchSite(bench, "", "", "", {}).routes() if isinstance(route, Route)]
    addresses = [(method, r.path) for r in routes for method in r.methods or () if method != "HEAD"]
    assert len(addresses) > 20
    filled = {"{id}": "0" * 16, "{name}": "x", "{kind}": "csv", "{token}": "0" * 16, "{floor}": "0"}

    async def run() -> None:
        for token, headers, status in (
            ("", {"Origin": "http://evil.example"}, 403),
            ("", {"Host": "evil.example"}, 403),
            ("secret", {}, 401),
            ("secret", {"Authorization": "Bearer wrong"}, 401),
            ("secret", {"Cookie": "pdr_filter_token=wrong"}, 401),
            ("secret", {"Authorization": "Bearer secret", "Origin": "http://evil.example"}, 403),
        ):
            transport = httpx.ASGITransport(workbench_application(bench, None, token))
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
                for method, path in addresses:
                    for name, value in filled.items():
                        path = path.replace(name, value)
                    answer = await http.request(method, path, headers=headers, content=b"{}")
                    assert answer.status_code == status, (method, path, headers)

    asyncio.run(run())
    assert not any(isinstance(route, Mount) for route in routes)


PATHS = ["../../evil.zip", "/etc/evil.zip", "..", "a/../../evil.zip", "..\\evil.zip", "\0evil.zip", "C:\\x.zip", ".zip"]


async def test_names_of_dropped_files_never_are_paths(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "folder"
    folder.mkdir(parents=True)
    content = zipped()
    async with running(folder) as client:
        for name in PATHS:
            before = everything_in(folder)
            added = await client.drop(name, content)
            assert "/" not in added["name"]
            assert added["name"].strip(".")
            (path,) = [p for p in everything_in(folder) - before if not p.startswith(".pdr_filter/cache")]
            assert path.startswith(f"{added['name']}/")
    assert everything_in(tmp_path) == {f"deep/folder/{path}" for path in everything_in(folder)}


async def test_addresses_with_paths_in_them_find_nothing(client: Client, tmp_path: Path) -> None:
    (tmp_path / "plans").mkdir()
    (tmp_path / "secret.geojson").write_text("{}")
    await client.post("/plans", {"name": "House"})
    for path in (
        "/page/..%2fserver.py",
        "/page/%2e%2e%2fworker.py",
        "/plans/..%2fsecret",
        "/plan/..%2fsecret",
        "/plans/..%2fsecret/0.png",
        "/walks/..%2f..%2fetc",
        "/walks/x/report",
        "/walks/x/export/csv",
        *(f"/{kind}/{'x' * 3000}" for kind in ("page", "walk", "plan", "walks", "plans")),
        *(f"/plans/House/{'9' * n_digits}.png" for n_digits in (300, 5000)),
    ):
        answer = await client.http.get(path)
        assert answer.status_code == 404, path
    for token in ("..", "..%2f..%2fx", "0" * 15, "G" * 16):
        answer = await client.http.post(f"/drops/{token}", content=b"x")
        assert answer.status_code in (404, 405), token


async def test_pages_are_served_after_another_version_was_installed(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    await client.post("/plans", {"name": "House"})

    def read_text(path: Path, *_: str, **__: str) -> str:
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))

    monkeypatch.setattr(Path, "read_text", read_text)
    monkeypatch.setattr(Path, "read_bytes", read_text)
    monkeypatch.setattr(Path, "iterdir", read_text)
    for path in ("/", "/plan/House", "/page/walk.js", "/page/leaflet.js", "/page/page.css"):
        assert await client.get(path)
    # the worker processes may still need other files
    monkeypatch.setattr(worker.Worker, "walk", lambda *_: read_text(Path(server.__file__)))
    answer = worker.make_worker(str(client.bench.cache))
    assert "start the workbench again" in answer(("walk", [""]))["error"]
    package = Path(server.__file__).parents[2]  # the name of a folder beside the package may begin like its name
    monkeypatch.setattr(worker.Worker, "walk", lambda *_: read_text(Path(f"{package}_walks", "walk.csv")))
    assert "start the workbench again" not in answer(("walk", [""]))["error"]


async def test_a_zip_bomb_is_refused_with_its_reason_and_not_kept(client: Client, tmp_path: Path) -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Accelerometer.csv", b"0" * 200_000_000)
    answer = await client.drop("bomb.zip", content.getvalue(), 422)
    assert "times its size" in answer["error"]
    assert not [path for path in everything_in(tmp_path) if "bomb" in path]


async def test_what_is_no_recording_is_refused_with_the_reason_and_not_kept(client: Client, tmp_path: Path) -> None:
    for name, content in (("notes.txt", b"hello"), ("empty.zip", b"")):
        assert (await client.drop(name, content, 422))["error"]
        assert not [path for path in everything_in(tmp_path) if Path(name).stem in path]


def png(width: int, height: int, content: bytes = b"") -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        chunk(*c) for c in ((b"IHDR", head), (b"IDAT", zlib.compress(content)), (b"IEND", b""))
    )


async def test_pictures_that_are_too_large_or_no_pictures_are_refused(client: Client, tmp_path: Path) -> None:
    await client.post("/plans", {"name": "House"})
    huge = b"\x89PNG" + bytes(200 * 1024**2)
    for content, status, words in (
        (huge, 413, "64 MB"),
        (png(100_000, 100_000), 422, "pixels"),
        (b"GIF89a", 422, "PNG"),
        (png(10, 10), 422, "cannot be used"),
        (b"%PDF-1.7 nonsense", 422, "PNG"),
    ):
        answer = await client.http.post("/plans/House/0.png", content=content)
        assert answer.status_code == status, answer.text
        assert words in answer.json()["error"]
    assert not [path for path in everything_in(tmp_path) if ".png" in path]


async def test_a_flood_of_files_in_one_drop_is_refused(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "_MAX_DROP_FILES", 20)
    monkeypatch.setattr(server, "_MAX_DROP_BYTES", 1000)
    for k in range(20):
        assert (await client.http.post("/drops/" + "a" * 16, params={"name": f"f/{k}.csv"})).status_code == 200
    answer = await client.http.post("/drops/" + "a" * 16, params={"name": "f/last.csv"})
    assert answer.status_code == 413
    answer = await client.http.post("/drops/" + "b" * 16, params={"name": "x.zip"}, content=b"0" * 1001)
    assert answer.status_code == 413
    assert "MB in one drop" in answer.json()["error"]
    assert not (client.bench.incoming / ("b" * 16)).exists()


async def test_an_unknown_recipe_is_named(client: Client, tmp_path: Path) -> None:
    short_walk().save(tmp_path / "walk")
    address = f"{await client.walk('walk')}/compare"
    assert "nothing to compare" in (await client.get(address, 400))["error"]
    for wrong in ("other/imm", "default/other", "default", "default/imm/hc"):
        answer = await client.get(f"{address}?with=default/imm&with={wrong}", 400)
        assert answer["error"].startswith(repr(wrong))


def test_a_folder_of_thousands_of_files_is_listed(tmp_path: Path) -> None:
    for k in range(2000):
        (tmp_path / f"{k:05d}.zip").write_bytes(b"PK nothing")
    walks = Walks(tmp_path)
    assert len(walks.scan()) == 2000
    assert walks.scan() == []


async def test_a_full_disk_is_reported_and_nothing_is_lost(
    client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short_walk().save(tmp_path / "walk")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    walk = await client.walk("walk")
    fix = [1.0, 0.0, 0.0, 0.5, None, None]
    before = await client.edit(walk, fixes=[fix])
    await client.post("/plans", {"name": "House"})
    plan = await client.get("/plans/House")
    with monkeypatch.context() as patch:
        patch.setattr(safe_files.os, "fsync", full)
        answer = await client.edit(walk, 507, fixes=[])
        assert "disk is full" in answer["error"]
        answer = await client.post("/plans/House", plan | {"storeys": {"1": {}}}, 507)
        assert "disk is full" in answer["error"]
    assert (await client.get(walk))["marks"] == before["marks"]
    assert await client.get("/plans/House") == plan
    assert not [path for path in everything_in(tmp_path) if path.endswith(".part") or ".marks.json" in path]
    await client.edit(walk, fixes=[])


async def test_what_was_dropped_halfway_is_deleted_at_the_next_start(tmp_path: Path) -> None:
    left = tmp_path / ".pdr_filter" / "incoming" / ("c" * 16)
    left.mkdir(parents=True)
    (left / "part.zip").write_bytes(b"x")
    async with running(tmp_path):
        assert not left.exists()
