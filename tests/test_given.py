"""Plans, radio maps, people, phones, mappings and messages: each is read, or refused by name, whatever is in it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from given_mutations import GIVEN, PHYPHOX_ANSWER, PHYPHOX_CONFIG, a_plan, a_radio_map, try_given, use_phyphox

import pdr_filter as pdr
from pdr_filter.apps.live.messages import MessageError
from pdr_filter.apps.maps.radio.radio_map import RadioMap
from pdr_filter.classifiers.model_files import file_pair
from pdr_filter.filter.pedestrian.person import Session
from pdr_filter.values import limits

SLOW_S = 2.0  # a second on a machine that is not busy


@pytest.mark.parametrize("form", GIVEN)
def test_a_mutation_is_refused_or_works(form: str, tmp_path: Path) -> None:
    try_given(form, 0, 1, tmp_path)  # makes what is mutated
    for number in range(30):
        begin = process_time()
        assert try_given(form, number, 1, tmp_path) in ("worked", "refused"), number
        assert process_time() - begin < SLOW_S, number


READERS: dict[str, Callable[[Path], object]] = {
    "plan": pdr.FloorPlan.read,
    "person": pdr.Person.load,
    "device": pdr.Device.load,
    "radio map": RadioMap.load,
}


@pytest.mark.parametrize("what", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "deep", "large"])
def test_what_is_no_small_file_is_refused_and_not_waited_for(what: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "given.json"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.write_bytes(b"[" * 100_000 if kind == "deep" else b" " * (limits.MAX_PLAN_BYTES + 1))
    with pytest.raises(ValueError, match=r"given.json: "):
        READERS[what](path)


def person(**changed: Any) -> dict[str, Any]:
    return {"pdr_filter_person": 1, "sessions": [{"step_length_m": 0.7, "std": 0.03, "n_fixes": 3, **changed}]}


@pytest.mark.parametrize(
    "content",
    [
        person(step_length_m=1e300),
        person(std=1e-300),
        person(n_fixes=float("inf")),
        person(n_fixes=1.5),
        person(n_fixes="3"),
        person(more=1),
        {"pdr_filter_person": 1, "sessions": ["x"]},
        {"pdr_filter_person": 1, "sessions": 3},
        {"pdr_filter_person": 2, "sessions": []},
        {"pdr_filter_person": 1},
        person(step_length_m=-1),
        person(step_length_m=float("nan")),
        {},
        [],
    ],
    ids=str,
)
def test_a_person_of_whom_one_value_cannot_be_is_refused(content: Any, tmp_path: Path) -> None:
    path = tmp_path / "anna.json"
    path.write_text(json.dumps(person()))
    assert pdr.Person.load(path) == pdr.Person((Session(0.7, 0.03, 3),))
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"anna.json: not a person file of pdr_filter .*write one with"):
        pdr.Person.load(path)


def plan_with(change: Callable[[dict[str, Any]], object], path: Path) -> Path:
    content = json.loads(a_plan(degrees=False))
    change(content)
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(features=3), "not a GeoJSON FeatureCollection .*features not a list"),
        (lambda c: c.update(properties=[1]), "not a GeoJSON FeatureCollection .*properties not an object"),
        (lambda c: c["features"].insert(0, 3), "feature 0 is not a feature with properties, got 3"),
        (lambda c: c["features"][0].update(properties=[3]), "feature 0 is not a feature with properties"),
        (lambda c: c["features"][0]["properties"].update(floor=float("inf")), "feature 0 .* has floor inf"),
        (lambda c: c["features"][0]["geometry"]["coordinates"][0].__setitem__(1, [1500, -1500]), ".*square kilometres"),
    ],
)
def test_a_plan_of_which_one_part_cannot_be_is_refused(
    change: Callable[[dict[str, Any]], object], words: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=rf"plan.geojson: {words}"):
        pdr.FloorPlan.read(plan_with(change, tmp_path / "plan.geojson"))


def test_cells_of_a_large_plan_are_those_of_its_outline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = plan_with(lambda c: None, tmp_path / "plan.geojson")
    whole = pdr.FloorPlan.read(path)
    monkeypatch.setattr("pdr_filter.apps.maps.geojson._BLOCK_CELLS", 1000)  # a few rows together
    for storey, again in zip(whole.storeys, pdr.FloorPlan.read(path).storeys, strict=True):
        np.testing.assert_array_equal(again.cells, storey.cells)


@pytest.mark.parametrize("name", ["floor", "rssi_dbm"])
def test_a_radio_map_with_columns_that_are_no_columns_is_refused(name: str, tmp_path: Path) -> None:
    radio = a_radio_map()
    arrays = {n: getattr(radio, n) for n in ("position_m", "floor", "bssid", "point", "access_point", "rssi_dbm")}
    path = tmp_path / "radio"
    radio.save(path)
    RadioMap.load(path)
    with pytest.raises(ValueError, match=r"floor must be \(N,\) and rssi_dbm \(H,\)"):
        RadioMap(**{**arrays, name: arrays[name][:, None]})
    assert file_pair(path)[0].exists()


@pytest.mark.parametrize("buffer", [3, {"a": 1}, [[1.0]], "abc", [[[1]]], None], ids=str)
def test_an_answer_of_phyphox_whose_buffer_is_no_list_of_numbers_is_refused(buffer: Any) -> None:
    config, answer = json.dumps(PHYPHOX_CONFIG).encode(), json.loads(json.dumps(PHYPHOX_ANSWER))
    use_phyphox(config, json.dumps(answer).encode())
    answer["buffer"]["gx"]["buffer"] = buffer
    with pytest.raises(MessageError, match=r"/get is not that of phyphox"):
        use_phyphox(config, json.dumps(answer).encode())


def test_json_that_is_too_deep_is_no_message() -> None:
    deep = b"[" * 100_000
    with pytest.raises(MessageError, match="/config is not that of phyphox"):
        use_phyphox(deep, b"{}")
    with pytest.raises(MessageError, match="/get is not that of phyphox"):
        use_phyphox(json.dumps(PHYPHOX_CONFIG).encode(), deep)
