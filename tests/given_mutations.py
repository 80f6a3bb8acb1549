"""Other files and messages that people give: floor plans, radio maps, people, phones, mappings, what phones send."""

from __future__ import annotations

import json
import math
import os
import random
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from heard import round_a_block, walk_with_wifi
from saved_mutations import changed, later, mutated_files, outcome

import pdr_filter as pdr
from pdr_filter.apps.live import assembly, messages
from pdr_filter.apps.maps.radio.radio_map import RadioMap
from pdr_filter.apps.maps.storey import LIFT
from pdr_filter.data.io.tables.column_mapping import read_mapping
from pdr_filter.filter.pedestrian.person import Session

sys.path.insert(0, str(Path(__file__).parent / "data" / "io"))
sys.path.insert(0, str(Path(__file__).parent / "apps" / "maps"))

import made_up
from app_files import GENERIC_MAPPING, push_messages, sensor_logger_files
from mutations import LARGE_MUTATIONS, MUTATIONS, small_recording

# --- good ones --------------------------------------------------------------------------------------------------------


def a_plan(*, degrees: bool) -> bytes:
    """Two storeys with all kinds of features, in metres or in longitude and latitude."""
    areas = [
        *made_up.FEATURES,
        made_up.feature("stairs", made_up.box(9.0, 0.0, 11.0, 1.0), name="up"),
        made_up.feature("lift", made_up.box(39.0, 0.0, 40.0, 1.0)),
        made_up.feature("floor", made_up.box(-1.2, -1.2, 41.2, 19.2), floor=1),
    ]
    lines = [
        made_up.feature("wall", made_up.line((0.0, 5.0), (8.0, 5.0), (8.0, 9.0))),
        made_up.feature("door", made_up.line((8.8, 4.0), (8.8, 5.0))),
    ]
    found = made_up.in_degrees(areas, pdr.Origin(50.0, 8.0)) if degrees else [*areas, *lines]
    return json.dumps({"type": "FeatureCollection", "name": "made up", "features": found}).encode()


@cache
def a_radio_map() -> RadioMap:
    """Of two walks round the block."""
    return RadioMap.fit([walk_with_wifi(round_a_block(1), seed) for seed in (1, 2)])


def messages_of_sensor_logger() -> list[bytes]:
    files = sensor_logger_files(small_recording(), "android")
    return [json.dumps(message).encode() for message in push_messages(files)]


def messages_of_sensor_server() -> list[bytes]:
    samples = small_recording().accelerometer
    return [
        json.dumps({"type": "android.sensor.accelerometer", "timestamp": round(1e9 * t), "values": v}).encode()
        for t, v in zip(samples.time_s.tolist(), samples.values.tolist(), strict=True)
    ]


def own_messages() -> list[bytes]:
    recording = small_recording()
    found: list[bytes] = []
    for i in range(0, len(recording.accelerometer), 6):
        rows = {
            name: np.column_stack([s.time_s, s.values])[i : i + 6].tolist()
            for name, s in recording.streams.items()
            if name in messages.N_VALUES
        }
        found.append(json.dumps({"device": "d", "session": "s", "number": i // 6, "samples": rows}).encode())
    return [*found, json.dumps({"fix": {"east_m": 1.0, "north_m": 2.0, "std_m": 3.0}}).encode()]


PHYPHOX_CONFIG = {
    "inputs": [
        {"source": "accelerometer", "outputs": [{"x": "ax"}, {"y": "ay"}, {"z": "az"}, {"t": "at"}]},
        {"source": "gyroscope", "outputs": [{"x": "gx"}, {"y": "gy"}, {"z": "gz"}, {"t": "gt"}]},
    ]
}
PHYPHOX_ANSWER = {
    "buffer": {name: {"buffer": [0.1, 0.2, 0.3]} for name in ("at", "ax", "ay", "az", "gt", "gx", "gy", "gz")}
}


# --- what can be done with them ---------------------------------------------------------------------------------------


def mutated(data: bytes, rng: random.Random) -> bytes:
    """A mutation of the bytes, or, of JSON, of what they say; one of a hundred makes them large."""
    if rng.random() < 0.4:
        return rng.choice(LARGE_MUTATIONS if rng.random() < 0.02 else MUTATIONS)(data, rng)
    try:
        tree: Any = json.loads(data)
    except (ValueError, RecursionError):
        return rng.choice(MUTATIONS)(data, rng)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        tree = changed(tree, rng)
    return json.dumps(tree).encode()


def use_plan(path: Path) -> None:
    plan = pdr.FloorPlan.read(path)
    with later():
        json.dumps(plan.summary(), allow_nan=False)
    assert plan.storeys
    for storey in plan.storeys:
        assert np.isfinite(storey.south_west_m).all()
        assert all(np.isfinite(line).all() for feature in storey.features for line in feature.lines)
        assert storey.cells.max() >= LIFT >= storey.cells.min() or storey.cells.min() > LIFT


def use_radio_map(path: Path) -> None:
    radio = RadioMap.load(path)
    with later():
        fixes = radio.fixes(walk_to_find())
        radio.grids(walk_to_find())
    for fix in fixes:
        assert np.isfinite([*fix.position_m, *fix.cov_m2.ravel()]).all()
        assert np.linalg.eigvalsh(fix.cov_m2).min() > 0


@cache
def walk_to_find() -> pdr.Recording:
    return walk_with_wifi(round_a_block(1), 3)


@cache
def usual_config() -> pdr.Config:
    return pdr.recipes.default()


def use_person(path: Path) -> None:
    person = pdr.Person.load(path)
    with later():
        assert math.isfinite(person.step_length_m) or not person.sessions
        config = usual_config().with_person(person)
        assert all(np.isfinite(mode.step_length.theta).all() for mode in config.model.modes)
        assert pdr.Person.load(person.save(path)) == person


def use_device(path: Path) -> None:
    device = pdr.Device.load(path)
    with later():
        pdr.OnlineFilter(usual_config().with_device(device))
        assert (pdr.Device.load(device.save(path)).bias_cov_radps2 == device.bias_cov_radps2).all()


def use_mapping(path: Path) -> None:
    mapping = read_mapping(path)
    with later():
        path.write_text(mapping.toml(), encoding="utf-8")
        again = read_mapping(path)
    assert (again.streams, again.separator, again.decimal) == (mapping.streams, mapping.separator, mapping.decimal)


def use_messages(bodies: list[bytes]) -> None:
    """As a session does: parse each, put them in order, and parse again what the journal holds."""
    state, held, n_ready = assembly.Assembly(), list[messages.Message](), 0
    refused: ValueError | None = None
    for body in bodies:
        try:
            found = messages.parse(body, "d", "s", "android")
        except messages.MessageError as error:
            refused = error
            continue
        for message in found:
            for name, rows in message.rows.items():
                assert rows.values.shape == (len(rows.time), messages.N_VALUES[name]), (name, rows.values.shape)
                assert np.isfinite(rows.time).all()
            (again,) = messages.parse(message.source, "d", "s", "android")
            assert again.rows.keys() == message.rows.keys()
            assert again.n_samples == message.n_samples
            if message.fix is None:
                state, held, ready = assembly.take(state, held, message, "android")
                n_ready += check_ready(ready)
    state, held, ready = assembly.finish_assembly(state, held, "android")
    check_ready(ready)
    assert not held
    if refused is not None:
        raise refused


def check_ready(ready: list[assembly.Streams]) -> int:
    for samples in ready:
        for name, rows in samples.items():
            assert np.isfinite(rows.time_s).all(), name
            assert len(rows.time_s) == len(rows.values)
    return len(ready)


def use_phyphox(config: bytes, answer: bytes) -> None:
    buffers = messages.phyphox_buffers(config)
    for name, rows in messages.phyphox_rows(answer, buffers).items():
        assert rows.values.shape == (len(rows.time), messages.N_VALUES[name]), (name, rows.values.shape)


# --- one input --------------------------------------------------------------------------------------------------------


def file_in(folder: Path, name: str, content: bytes, rng: random.Random) -> Path:
    """A file; one of a hundred is a pipe or a link to a device."""
    path = folder / name
    path.unlink(missing_ok=True)
    if rng.random() < 0.01:
        os.mkfifo(path) if rng.random() < 0.5 else path.symlink_to("/dev/zero")
    else:
        path.write_bytes(content)
    return path


def try_plan(rng: random.Random, folder: Path) -> None:
    plan = mutated(a_plan(degrees=rng.random() < 0.3), rng)
    use_plan(file_in(folder, "plan.geojson", plan, rng))


def try_radio_map(rng: random.Random, folder: Path) -> None:
    path = a_radio_map().save(folder / "radio")
    mutated_files(path, rng)
    use_radio_map(path)


def try_person(rng: random.Random, folder: Path) -> None:
    person = pdr.Person((Session(0.7, 0.03, 12), Session(0.72, 0.05, 3)))
    use_person(file_in(folder, "person.json", mutated(person.save(folder / "good.json").read_bytes(), rng), rng))


def try_device(rng: random.Random, folder: Path) -> None:
    good = pdr.Device(np.array([0.01, -0.02, 0.0]), 1e-6 * np.eye(3)).save(folder / "good.json")
    use_device(file_in(folder, "device.json", mutated(good.read_bytes(), rng), rng))


def try_mapping(rng: random.Random, folder: Path) -> None:
    use_mapping(file_in(folder, "walk.toml", rng.choice(MUTATIONS)(GENERIC_MAPPING.encode(), rng), rng))


def try_messages(rng: random.Random, folder: Path) -> None:
    bodies = rng.choice([messages_of_sensor_logger, messages_of_sensor_server, own_messages])()
    for _ in range(rng.choice([1, 1, 2, 5])):
        i = rng.randrange(len(bodies))
        bodies[i] = mutated(bodies[i], rng) if bodies[i] else b"x"
    if rng.random() < 0.2:
        rng.shuffle(bodies)
    use_messages(bodies)


def try_phyphox(rng: random.Random, folder: Path) -> None:
    config, answer = json.dumps(PHYPHOX_CONFIG).encode(), json.dumps(PHYPHOX_ANSWER).encode()
    if rng.random() < 0.4:
        config = mutated(config, rng)
    else:
        answer = mutated(answer, rng)
    use_phyphox(config, answer)


GIVEN: dict[str, Callable[[random.Random, Path], None]] = {
    "plan": try_plan,
    "radio_map": try_radio_map,
    "person": try_person,
    "device": try_device,
    "mapping": try_mapping,
    "live:messages": try_messages,
    "live:phyphox": try_phyphox,
}


def try_given(form: str, number: int, seed: int, folder: Path) -> str:
    """What happened to an input: "worked", "refused", or what went wrong."""
    rng = random.Random(f"{form} {seed} {number}")
    return outcome(lambda: GIVEN[form](rng, folder), folder)
