"""Public recordings from a home that is a local server: cache, checksums, licence, a local folder, no network."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from app_files import core_motion_text, indoor_location_text, on_one_clock, write_folder

import pdr_filter as pdr
from models.training import make_models
from pdr_filter import datasets
from pdr_filter.data.datasets import DATASETS, Dataset, from_raw

pytest.importorskip("pooch")

ROWS = "".join(f"{i / 50:.2f} 0.0 0.1 9.8\n" for i in range(100))
FILES = ("walk_1/accelerometer.txt", "walk_1/gyroscope.txt", "walk_2/accelerometer.txt", "walk_2/gyroscope.txt")


class Quiet(SimpleHTTPRequestHandler):
    asked: list[str] = []  # noqa: RUF012 - of the test that runs

    def log_message(self, *_: object) -> None:
        if self.command == "GET":  # HEAD asks for the size alone
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


Publish = Callable[..., Dataset]
Fetched = Callable[[str, Mapping[str, str | bytes]], list[Path]]


@pytest.fixture
def publish(monkeypatch: pytest.MonkeyPatch) -> Publish:
    """Add a data set of two walks with a home, or another data set under another name."""

    def published(home: str, sha256: tuple[str, ...] = (), name: str = "little", **changes: Any) -> Dataset:
        dataset = (
            Dataset("Two little walks", "CC0", "Nobody", home, FILES, sha256) if name == "little" else DATASETS[name]
        )
        monkeypatch.setitem(DATASETS, name, replace(dataset, home=home, **changes))
        return DATASETS[name]

    return published


@pytest.fixture(autouse=True)
def _without_a_local_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PDR_DATA", raising=False)


def test_recordings_are_downloaded_once_and_their_licence_is_shown(
    tmp_path: Path, home: str, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(home)
    paths = datasets.fetch("little", tmp_path / "cache")
    assert [path.name for path in paths] == ["walk_1.zip", "walk_2.zip"]
    shown = capsys.readouterr().err
    assert "licence: CC0" in shown
    assert "attribution: Nobody" in shown
    assert (tmp_path / "cache" / "little" / "ATTRIBUTION.txt").read_text() in shown
    walk = pdr.read(paths[0])
    np.testing.assert_allclose(walk.accelerometer.values[0], [0.0, 0.1, 9.8])
    assert walk.meta["licence"] == "CC0"
    assert walk.meta["dataset"] == "little"
    n_asked = len(Quiet.asked)
    assert n_asked == len(FILES)
    assert datasets.fetch("little", tmp_path / "cache") == paths
    assert len(Quiet.asked) == n_asked
    assert capsys.readouterr().err == ""


def test_a_file_with_another_checksum_is_refused(tmp_path: Path, home: str, publish: Publish) -> None:
    right = tuple(hashlib.sha256((tmp_path / "home" / file).read_bytes()).hexdigest() for file in FILES)
    publish(home, right)
    assert datasets.fetch("little", tmp_path / "cache")
    publish(home, ("0" * 64, *right[1:]))
    with pytest.raises(ValueError, match="has changed since"):
        datasets.fetch("little", tmp_path / "other")


def test_a_proxy_that_requests_cannot_use_is_not_taken_for_another_checksum(
    tmp_path: Path, home: str, publish: Publish, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(home)
    monkeypatch.setenv("HTTP_PROXY", "http:///nowhere")
    monkeypatch.setenv("NO_PROXY", "")
    with pytest.raises(ConnectionError, match="cannot be downloaded"):
        datasets.fetch("little", tmp_path / "cache")


def test_what_came_without_a_known_checksum_says_so_and_can_be_checked_later(
    tmp_path: Path, home: str, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(home)
    datasets.fetch("little", tmp_path)
    assert "no sha256 is known yet" in capsys.readouterr().err
    rows = [row.split("  ") for row in (tmp_path / "little" / ".raw" / "SHA256SUMS").read_text().splitlines()]
    assert [name for _, name in rows] == list(FILES)
    for checksum, name in rows:
        assert hashlib.sha256((tmp_path / "home" / name).read_bytes()).hexdigest() == checksum
    checked = publish(home, tuple(checksum for checksum, _ in rows))
    assert "checked: sha256 of each file" in checked.about()


def test_a_file_that_differs_from_the_first_download_is_refused(tmp_path: Path, home: str, publish: Publish) -> None:
    publish(home)
    (first,) = {path.parent for path in datasets.fetch("little", tmp_path / "cache")}
    shutil.rmtree(first)
    assert datasets.fetch("little", tmp_path / "cache")
    shutil.rmtree(first)
    (tmp_path / "home" / FILES[0]).write_bytes(b"changed")
    with pytest.raises(ValueError, match=r"has changed since .*\.little\.sha256: do not use"):
        datasets.fetch("little", tmp_path / "cache")


def test_a_download_that_broke_off_goes_on_where_it_was(tmp_path: Path, home: str, publish: Publish) -> None:
    publish(home)
    gone = tmp_path / "home" / FILES[2]
    content = gone.read_text()
    gone.unlink()
    with pytest.raises(ConnectionError, match="resumes the download"):
        datasets.fetch("little", tmp_path / "cache")
    gone.write_text(content)
    assert len(datasets.fetch("little", tmp_path / "cache")) == 2
    assert sum(FILES[0] in path for path in Quiet.asked) == 1


def test_without_network_the_message_says_what_else_can_be_done(tmp_path: Path, publish: Publish) -> None:
    publish("http://127.0.0.1:9")
    with pytest.raises(ConnectionError, match=r"little: http://127.0.0.1:9/.* cannot be downloaded .*PDR_DATA"):
        datasets.fetch("little", tmp_path)


def test_a_local_folder_is_used_in_place_of_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walk = pdr.simulate.demo_walk().save(tmp_path / "humolire" / "walk.zip")
    walk_of_mine = pdr.simulate.demo_walk().save(tmp_path / "mine" / "walk.zip")
    monkeypatch.setenv("PDR_DATA", str(tmp_path))
    assert datasets.fetch("humolire") == [walk]
    assert datasets.fetch("mine") == [walk_of_mine]
    with pytest.raises(ValueError, match=r"data set 'theirs' is unknown: give one of humolire, .*, ms_indoor"):
        datasets.fetch("theirs")


def test_a_zip_is_unpacked_beside_itself(tmp_path: Path, home: str, publish: Publish) -> None:
    with ZipFile(tmp_path / "home" / "all.zip", "w") as archive:
        for file in FILES:
            archive.write(tmp_path / "home" / file, file)
        archive.writestr("notes.pdf", "no text")
    publish(home, files=("all.zip",))
    paths = datasets.fetch("little", tmp_path / "cache")
    assert [path.name for path in paths] == ["walk_1.zip", "walk_2.zip"]
    assert not list((tmp_path / "cache").rglob("notes.pdf"))


def test_without_the_package_for_downloads_the_message_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(ImportError, match=r"pip install \"pdr_filter\[datasets\]\""):
        datasets.fetch("humolire", tmp_path)


def test_a_mirror_is_used_in_place_of_the_network_and_its_size_is_shown_first(
    tmp_path: Path, home: str, publish: Publish, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(home)
    (tmp_path / "home").rename(tmp_path / "little")
    Quiet.asked = []
    paths = datasets.fetch("little", tmp_path / "cache", mirror=tmp_path)
    assert [path.name for path in paths] == ["walk_1.zip", "walk_2.zip"]
    assert Quiet.asked == []
    shown = capsys.readouterr().err
    n_bytes = sum((tmp_path / "little" / file).stat().st_size for file in FILES)
    assert shown.index("licence: CC0") < shown.index(f"size: {n_bytes / 1e6:.1f} MB in 4 files")


def test_a_download_that_fails_at_once_leaves_no_files_and_keeps_the_given_folder(
    tmp_path: Path, publish: Publish
) -> None:
    publish("http://127.0.0.1:9")
    (tmp_path / "cache").mkdir()
    with pytest.raises(ConnectionError):
        datasets.fetch("little", tmp_path / "cache")
    assert list(tmp_path.rglob("*")) == [tmp_path / "cache"]


def test_a_data_set_has_its_name_only_when_it_is_complete(tmp_path: Path, home: str, publish: Publish) -> None:
    def breaks_off(raw: Path) -> Iterator[pdr.Recording]:
        yield pdr.read(raw / "walk_1")
        raise KeyboardInterrupt

    publish(home, recordings=breaks_off)
    with pytest.raises(KeyboardInterrupt):
        datasets.fetch("little", tmp_path / "cache")
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [".little.partial"]


# ---------------------------------------------------------------- as their owners publish them


@pytest.fixture
def fetched(tmp_path: Path, home: str, publish: Publish) -> Fetched:
    """Function that fetches a data set with made-up files of its layout from a local home."""

    def fetch(name: str, files: Mapping[str, str | bytes]) -> list[Path]:
        write_folder(tmp_path / "home", files)
        publish(home, name=name, files=tuple(files))
        return datasets.fetch(name, tmp_path / "cache")

    return fetch


def senslogs(rows: Iterable[str]) -> str:
    head = "name.txt\n\nAll values are in something.\nhttp://\n\nelapsed-time-system elapsed-time-sensor x y z\n"
    return head + "".join(f"{row}\n" for row in rows)


def humolire_files() -> dict[str, str | bytes]:
    """Walks along a corridor, round a corner and along another; the sensor's clock begins at 0.054 s."""
    at_s = np.arange(0.054, 40.0, 0.02)
    swing = np.where(at_s > 2.0, 3.0 * np.sin(12 * at_s), 0.0)
    force = [f"{t + 0.004:.3f} {t:.3f} 0.1 0.2 {9.8 + s:.4f}" for t, s in zip(at_s, swing, strict=True)]
    rate = [f"{t + 0.004:.3f} {t:.3f} 0.01 0.02 0.03" for t in at_s]
    points = [(10.0, 0.1), (20.0, 0.0), (28.0, 6.0), (28.1, 12.0)]
    keypoints = {"starting_position": {"x": 0.0, "y": 0.0}, "starting_heading": 2, "count": len(points)}
    keypoints |= {str(i): {"x": x, "y": y} for i, (x, y) in enumerate(points)}
    clicks = "references.txt\n\ntimestamp Reference timestamp when clicked.\nhttp://TODO\n\nelapsed-time-system\n"
    clicks += "".join(f"{t:.3f} 0.0 0.0\n" for t in (9.054, 18.054, 27.054, 33.054))
    files: dict[str, str | bytes] = {}
    for walk in ("straight", "forward", "weinberg_sequences/1f"):
        files |= {
            f"imus/1/{walk}/accelerometer-calibrated.txt": senslogs(force),
            f"imus/1/{walk}/gyroscope-calibrated.txt": senslogs(rate),
            f"imus/1/{walk}/record.properties": "[Device]\nManufacturer = OnePlus\nModel = ONEPLUS A6010\n",
            f"imus/1/{walk}/references.txt": clicks,
        }
        if walk != "straight":  # whose landmarks are those of 1f
            files[f"imus/1/{walk}/keypoints.json"] = json.dumps(keypoints)
    link = {"id": 0, "layer": 0, "node0": {"x": 100.0, "y": 915.0}, "node1": {"x": 100.0, "y": 15.0}}
    return files | {"maps/map_data.json": json.dumps({"scale": 0.04, "links": [link]})}


def test_humolire_comes_with_landmarks_legs_person_and_plan(tmp_path: Path, fetched: Fetched) -> None:
    paths = fetched("humolire", humolire_files())
    names = ["humolire_user1_1f", "humolire_user1_forward", "humolire_user1_straight"]
    assert [path.stem for path in paths] == names
    for walk in map(pdr.read, paths):
        waypoints, segments, labels = walk.truth.waypoints, walk.truth.segments, walk.truth.labels
        # on the clock of the sensors, which begins with the first sample; the start is where motion begins
        np.testing.assert_allclose(waypoints["time_s"], [1.5, 9.0, 18.0, 27.0, 33.0], atol=0.1)
        np.testing.assert_allclose(waypoints["time_s"][1:], [9.0, 18.0, 27.0, 33.0], atol=1e-6)
        np.testing.assert_allclose(waypoints["east_m"], [0.0, 10.0, 20.0, 28.0, 28.1])
        np.testing.assert_allclose(segments["start_s"], [9.0, 27.0])  # neither the first nor round the corner
        np.testing.assert_allclose(segments["distance_m"], [10.0005, 6.000833], rtol=1e-6)
        assert labels["carrying_mode"].tolist() == ["texting"]
        assert walk.subject.height_m == 1.86
        assert walk.accelerometer.time_s[0] == 0.0
        assert pdr.read(paths[0]).notes == ()
    content = json.loads((tmp_path / "cache" / "maps" / "humolire.geojson").read_text())
    assert content["features"][0]["geometry"]["coordinates"] == [[4.0, 0.0], [4.0, 36.0]]


def test_clicks_without_a_landmark_each_are_refused(fetched: Fetched) -> None:
    files = humolire_files()
    files["imus/1/forward/references.txt"] = str(files["imus/1/forward/references.txt"]) + "35.0 0.0 0.0\n"
    with pytest.raises(ValueError, match="5 clicks and 4 landmarks"):
        fetched("humolire", files)


def test_motionsense_comes_with_person_and_activity(fetched: Fetched) -> None:
    packed = BytesIO()
    with ZipFile(packed, "w") as archive:
        for trial, code in (("dws_1", 1), ("jog_9", 3), ("std_6", 3), ("wlk_7", 24)):
            text = core_motion_text(simulated())
            archive.writestr(f"A_DeviceMotion_data/{trial}/sub_{code}.csv", text)
            archive.writestr(f"__MACOSX/A_DeviceMotion_data/{trial}/._sub_{code}.csv", "x")
    people = "code,weight,height,age,gender\n1,102,188,46,1\n3,48,161,28,0\n24,74,173,18,0"
    files = {"data_subjects_info.csv": people, "A_DeviceMotion_data.zip": packed.getvalue()}
    found = {path.stem: pdr.read(path) for path in fetched("motionsense", files)}
    assert sorted(found) == ["motionsense_s01_dws_1", "motionsense_s03_jog_9", "motionsense_s03_std_6"]
    labels = {name: walk.truth.labels for name, walk in found.items()}
    contexts = [rows["context"][0] for rows in labels.values() if rows is not None]
    assert contexts == ["downstairs", "running", "stationary"]
    subject = found["motionsense_s03_jog_9"].subject
    assert (subject.id, subject.height_m, subject.weight_kg, subject.gender) == ("s03", 1.61, 48.0, "F")


def test_ms_indoor_comes_with_points_of_the_map_storey_and_labels(fetched: Fetched) -> None:
    text = indoor_location_text(simulated(), ((0.5, 3.0, 4.0), (9.0, 13.0, 4.5)))
    files = {"B1/path_data_files/5dda.txt": text.replace("FloorName:F2", "FloorName:B1")}
    (path,) = fetched("ms_indoor", files)
    assert path.stem == "ms_indoor_anon_site1_b1_5dda"
    walk = pdr.read(path)
    assert walk.truth.waypoints["floor"].tolist() == [-1.0, -1.0]
    np.testing.assert_allclose(walk.truth.waypoints["east_m"], [3.0, 13.0])
    np.testing.assert_allclose([walk.truth.labels["start_s"][0], walk.truth.labels["end_s"][0]], [0.5, 9.0])


def test_difronzo_has_the_values_and_labels_with_which_the_models_are_trained(
    data_dir: Path, fetched: Fetched, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = data_dir / "difronzo" / "difronzo_user03_exp05.zip"
    if not path.is_file():
        pytest.skip(f"needs {path}")
    monkeypatch.setattr(from_raw, "DIFRONZO", ("exp05_user03",))
    expected = pdr.read(path)
    truth = expected.truth.labels
    rows = np.rint(50 * np.column_stack([truth["start_s"], truth["end_s"]])).astype(int) + 3
    activity = [{"walking": 1, "stationary": 4}[context] for context in truth["context"]]
    lines = [f"5 3 {kind} {begin} {end}" for kind, (begin, end) in zip(activity, rows, strict=True)]
    files = {
        "labels.txt": "4 2 1 7 9\n" + "\n".join(lines) + "6\n\n",  # with the misprint of the last label
        "acc_exp05_user03.txt": "0.0 0.0 0.0\n0.1 0.2 9.8\n0.1 0.2 9.8\n" + text_of(expected.accelerometer.values),
        "gyro_exp05_user03.txt": "0.0 0.0 0.0\n" * 3 + text_of(expected.gyroscope.values),
    }
    (found,) = map(pdr.read, fetched("difronzo", files))
    assert found.name == expected.name
    assert found.subject.id == expected.subject.id
    for name in ("accelerometer", "gyroscope"):
        np.testing.assert_array_equal(getattr(found, name).time_s, getattr(expected, name).time_s)
        np.testing.assert_array_equal(getattr(found, name).values, getattr(expected, name).values)
    for name in truth.dtype.names:
        np.testing.assert_array_equal(found.truth.labels[name], truth[name])


def test_oxford_has_the_times_steps_and_labels_of_the_published_files(
    fetched: Fetched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(from_raw, "OXFORD", ("InHand_1", "Armband_1"))
    # the first rows as published, and two readings of a switch that bounces
    force = (
        "583718602288785,3,-1.829795,2.5267458,9.544153\n583718622014098,3,-1.223855,3.1973512,7.077283\n"
        "583718641739411,3,-1.465752,3.2189064,7.8197393\n"
    ) + "".join(f"{583718650000000 + 2465664 * i},3,0.0,3.0,9.0\n" for i in range(10))
    feet = (
        "583718802379394,1,0\n583718891990445,1,0\n583719342055854,0,0\n583719432788676,0,1\n583719523575924,0,1\n"
        "583719657460208,0,0\n583719747170009,0,1\n583719838125435,0,0\n583720197726929,1,0\n583720290337615,1,0\n"
    )
    files = {
        f"Pixel_Jamie_Hard_{walk}/{name}.csv": text
        for walk in ("InHand_1", "Armband_1")
        for name, text in (("accelerometer", force), ("stepcounter", feet))
    }
    armband, hand = map(pdr.read, fetched("oxford", files))
    assert (hand.name, armband.name) == ("oxford_jamie_pixel_hard_inhand_1", "oxford_jamie_pixel_hard_armband_1")
    np.testing.assert_array_equal(hand.accelerometer.time_s[:3], [0.0, 0.019725, 0.039451])
    np.testing.assert_array_equal(hand.accelerometer.values[0], [-1.829795, 2.526746, 9.544153])
    assert hand.gyroscope is None
    # The switch is already closed in the first row. This is not counted as a step.
    np.testing.assert_array_equal(hand.truth.steps["time_s"], [0.8305, 1.595438])
    (label,) = hand.truth.labels.tolist()
    assert label == (0.8305, 1.595438, "walking", "texting")
    assert armband.truth.labels["carrying_mode"].tolist() == [""]


def test_tyrex_has_both_sensors_on_the_clock_of_the_accelerometer_and_spans_of_motion(
    fetched: Fetched, monkeypatch: pytest.MonkeyPatch
) -> None:
    spans = {trial: from_raw.TYREX[trial] for trial in ("NoDist_Texting", "NoDist_RunningHand", "Dist_AR")}
    monkeypatch.setattr(from_raw, "TYREX", spans)
    # the first rows as published
    force = "0.153586954 -0.74057007 1.3436584 9.141418\n0.158622354 -0.7410126 1.2962494 9.170898\n"
    force += "".join(f"{0.17 + 0.005 * i:.9f} 0.0 1.0 9.0\n" for i in range(10))
    rate = "0.430533975 0.27468872 -0.035339355 0.22795105\n0.435569375 6.2561035E-4 -0.043121338 0.22518921\n"
    rate += "".join(f"{0.44 + 0.005 * i:.9f} 0.0 0.1 0.2\n" for i in range(10))
    files = {
        f"Thibaud_Nexus5_{trial}/{sensor}.txt": text
        for trial in spans
        for sensor, text in (("accelerometer", force), ("gyroscope-calibrated", rate))
    }
    found = {path.stem: pdr.read(path) for path in fetched("tyrex", files)}
    walk = found["tyrex_thibaud_nexus5_nodist_texting"]
    np.testing.assert_array_equal(walk.accelerometer.time_s[:2], [0.0, 0.005035])
    np.testing.assert_array_equal(walk.accelerometer.values[0], [-0.7405701, 1.343658, 9.141418])
    np.testing.assert_array_equal(walk.gyroscope.time_s[:2], [0.276947, 0.281982])
    np.testing.assert_array_equal(walk.gyroscope.values[:2, 0], [0.2746887, 0.0006256103])
    labels = {name.rpartition("_")[2]: each.truth.labels.tolist() for name, each in found.items()}
    assert labels == {
        "ar": [(2.839858, 122.823191, "", "texting")],
        "runninghand": [(2.663565, 122.646898, "running", "swinging")],
        "texting": [(0.000903, 118.867569, "walking", "texting")],
    }


@pytest.mark.parametrize(("name", "form"), [("oxford", "Pixel_Jamie_Hard_{}/"), ("tyrex", "Thibaud_Nexus5_{}/")])
def test_the_training_data_of_a_mirror_come_out_of_the_published_layout(
    name: str, form: str, data_dir: Path, fetched: Fetched, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials: Any = getattr(from_raw, name.upper())
    trial = next(iter(trials))
    (path,) = (data_dir / name).glob(f"*_{trial.lower()}.zip") if (data_dir / name).is_dir() else [None]
    if path is None:
        pytest.skip(f"needs {data_dir / name}")
    monkeypatch.setattr(from_raw, name.upper(), {trial: trials[trial]} if isinstance(trials, dict) else (trial,))
    expected = pdr.read(path)
    folder = form.format(trial)
    if name == "oxford":
        at_ns = np.rint(1e9 * expected.truth.steps["time_s"]).astype(int)
        # the feet take turns, and each step is closed for 20 ms
        feet = [
            (0, 0, 0),
            *((t + k, i % 2 * (k == 0), (i + 1) % 2 * (k == 0)) for i, t in enumerate(at_ns) for k in (0, 20_000_000)),
        ]
        rows = zip(
            np.rint(1e9 * expected.accelerometer.time_s).astype(int),
            expected.accelerometer.values.tolist(),
            strict=True,
        )
        files = {
            f"{folder}accelerometer.csv": "".join(f"{t},3,{x},{y},{z}\n" for t, (x, y, z) in rows),
            f"{folder}stepcounter.csv": "".join(f"{t},{left},{right}\n" for t, left, right in feet),
        }
    else:
        files = {
            f"{folder}{sensor}.txt": "".join(
                f"{t + 0.153586954:.9f} {x} {y} {z}\n"
                for t, (x, y, z) in zip(samples.time_s, samples.values.tolist(), strict=True)
            )
            for sensor, samples in (
                ("accelerometer", expected.accelerometer),
                ("gyroscope-calibrated", expected.gyroscope),
            )
        }
    (found,) = map(pdr.read, fetched(name, files))
    assert make_models.checksum(found) == make_models.known_checksums()[expected.name]


def text_of(values: np.ndarray) -> str:
    return "".join(f"{x} {y} {z}\n" for x, y, z in (values + 1e-7).tolist())  # more digits than are kept


def simulated() -> pdr.Recording:
    return on_one_clock(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=12.0)], rate_hz=50.0))


@pytest.mark.parametrize("name", DATASETS)
def test_every_data_set_says_its_terms_and_where_it_is_from(name: str) -> None:
    dataset = DATASETS[name]
    assert dataset.licence
    assert dataset.attribution
    assert dataset.home.startswith("https://")
    assert len(set(dataset.files)) == len(dataset.files) > 0
