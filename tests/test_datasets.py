"""Public recordings from a home that is a local server: cache, checksums, licence, a local folder, no network."""

from __future__ import annotations

import hashlib
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter import datasets
from pdr_filter.datasets import DATASETS, Dataset

pytest.importorskip("pooch")

ROWS = "".join(f"{i / 50:.2f} 0.0 0.1 9.8\n" for i in range(100))
FILES = ("walk_1/accelerometer.txt", "walk_1/gyroscope.txt", "walk_2/accelerometer.txt", "walk_2/gyroscope.txt")


class Quiet(SimpleHTTPRequestHandler):
    asked: list[str] = []  # noqa: RUF012 - of the test that runs

    def log_message(self, *_: object) -> None:
        self.asked.append(self.path)


@pytest.fixture
def home(tmp_path: Path) -> Iterator[str]:
    """The address of a server with the files of a data set."""
    for file in FILES:
        (tmp_path / "home" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "home" / file).write_text(ROWS if "acc" in file else ROWS.replace("9.8", "0.0"))
    Quiet.asked = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path / "home")))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def little(home: str, sha256: tuple[str, ...] = ()) -> Dataset:
    return Dataset("Two little walks", "CC0", "Nobody", home, FILES, sha256)


@pytest.fixture(autouse=True)
def _without_a_local_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PDR_DATA", raising=False)


def test_recordings_are_downloaded_once_and_their_licence_is_shown(
    tmp_path: Path, home: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(DATASETS, "little", little(home))
    paths = datasets.fetch("little", tmp_path / "cache")
    assert [path.name for path in paths] == ["walk_1", "walk_2"]
    shown = capsys.readouterr().err
    assert "licence: CC0" in shown
    assert "attribution: Nobody" in shown
    assert (tmp_path / "cache" / "little" / "ATTRIBUTION.txt").read_text() in shown
    np.testing.assert_allclose(pdr.read(paths[0]).accelerometer.values[0], [0.0, 0.1, 9.8])
    n_asked = len(Quiet.asked)
    assert n_asked == len(FILES)
    assert datasets.fetch("little", tmp_path / "cache") == paths
    assert len(Quiet.asked) == n_asked
    assert capsys.readouterr().err == ""


def test_a_file_with_another_checksum_is_refused(tmp_path: Path, home: str, monkeypatch: pytest.MonkeyPatch) -> None:
    right = tuple(hashlib.sha256((tmp_path / "home" / file).read_bytes()).hexdigest() for file in FILES)
    monkeypatch.setitem(DATASETS, "little", little(home, right))
    assert datasets.fetch("little", tmp_path / "cache")
    monkeypatch.setitem(DATASETS, "little", little(home, ("0" * 64, *right[1:])))
    with pytest.raises(ValueError, match="is not what it was"):
        datasets.fetch("little", tmp_path / "other")


def test_a_download_that_broke_off_goes_on_where_it_was(
    tmp_path: Path, home: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(DATASETS, "little", little(home))
    gone = tmp_path / "home" / FILES[2]
    content = gone.read_text()
    gone.unlink()
    with pytest.raises(ConnectionError, match="goes on where it was"):
        datasets.fetch("little", tmp_path / "cache")
    gone.write_text(content)
    assert len(datasets.fetch("little", tmp_path / "cache")) == 2
    assert sum(FILES[0] in path for path in Quiet.asked) == 1


def test_without_network_the_message_says_what_else_can_be_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(DATASETS, "little", little("http://127.0.0.1:9"))
    with pytest.raises(ConnectionError, match=r"little: http://127.0.0.1:9/.* cannot be had .*PDR_DATA"):
        datasets.fetch("little", tmp_path)


def test_a_local_folder_is_used_in_place_of_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walk = pdr.simulate.demo_walk().save(tmp_path / "humolire" / "walk.zip")
    walk_of_mine = pdr.simulate.demo_walk().save(tmp_path / "mine" / "walk.zip")
    monkeypatch.setenv("PDR_DATA", str(tmp_path))
    assert datasets.fetch("humolire") == [walk]
    assert datasets.fetch("mine") == [walk_of_mine]
    with pytest.raises(ValueError, match="name is 'theirs'; known are humolire, motionsense, ms_indoor"):
        datasets.fetch("theirs")


def test_a_zip_is_unpacked_beside_itself(tmp_path: Path, home: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import zipfile

    with zipfile.ZipFile(tmp_path / "home" / "all.zip", "w") as archive:
        for file in FILES:
            archive.write(tmp_path / "home" / file, file)
        archive.writestr("notes.pdf", "no text")
    monkeypatch.setitem(DATASETS, "little", Dataset("Zipped", "CC0", "Nobody", home, ("all.zip",)))
    paths = datasets.fetch("little", tmp_path / "cache")
    assert [path.name for path in paths] == ["walk_1", "walk_2"]
    assert not list((tmp_path / "cache").rglob("notes.pdf"))


def test_without_the_package_for_downloads_the_message_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(ValueError, match=r"pip install \"pdr_filter\[datasets\]\""):
        datasets.fetch("humolire", tmp_path)


@pytest.mark.parametrize("name", ["humolire", "motionsense", "ms_indoor"])
def test_every_data_set_says_its_terms_and_where_it_is_from(name: str) -> None:
    dataset = DATASETS[name]
    assert dataset.licence
    assert dataset.attribution
    assert dataset.home.startswith("https://")
    assert len(set(dataset.files)) == len(dataset.files) > 0
