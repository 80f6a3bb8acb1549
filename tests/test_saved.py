"""What is loaded was what a filter, a model or a calibration can be, or it is refused: at loading, and soon."""

from __future__ import annotations

import io
import json
import random
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from saved_mutations import (
    END_S,
    FILTERS,
    PAUSE_S,
    a_calibration,
    at,
    between,
    config_of,
    damaged_filter,
    good_filter,
    tree_of,
    try_one,
)

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.classifiers import model_files as artefact
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.filter.step_length.calibration_result import slices_of
from pdr_filter.recipes.calibration import load_calibration
from pdr_filter.values import limits
from pdr_filter.values import serialisation as serialise
from pdr_filter.values.saved_bytes import compressed, decompressed
from pdr_filter.values.serialisation import from_bytes, to_bytes

SLOW_S = 2.0  # a second on a machine that is not busy


@pytest.mark.parametrize(("form", "n"), [*((form, 8) for form in FILTERS), ("model", 15), ("calibration", 40)])
def test_a_mutation_is_refused_at_loading_or_does_no_harm(form: str, n: int, tmp_path: Path) -> None:
    try_one(form, 0, 1, tmp_path)  # makes what is mutated
    for number in range(n):
        begin = process_time()
        assert try_one(form, number, 1, tmp_path) in ("worked", "refused"), number
        assert process_time() - begin < SLOW_S, number


def test_a_covariance_of_one_context_is_checked_alone_as_the_filter_uses_it() -> None:
    calibration = a_calibration()
    part = slices_of(calibration.models)[0]["stationary"]
    wrong = calibration.people_cov.copy()
    assert not wrong[0, part, part].any()
    wrong[0, part.start, part.stop - 1] = 1e-300  # far below the rounding errors of all contexts together
    with pytest.raises(ValueError, match="people_cov must be finite and symmetric"):
        replace(calibration, people_cov=wrong)


# --- saved filters ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(20))
def test_a_damaged_filter_is_refused(number: int) -> None:
    good = good_filter("default", located=False)
    damaged = damaged_filter(good, random.Random(number))
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        pdr.OnlineFilter.load(damaged)


def test_a_saved_filter_of_which_one_digit_has_changed_is_refused() -> None:
    text, arrays = decompressed(good_filter("default", located=False), 1 << 26)
    changed = text.replace(b'"height_m": 1.7', b'"height_m": 1.8')
    assert changed != text
    with pytest.raises(ValueError, match="the checksum does not match"):
        from_bytes(compressed(changed, arrays, b""))


def tree(recipe: str = "default") -> Any:
    return tree_of(good_filter(recipe, located=False))


def load(content: Any) -> pdr.OnlineFilter:
    return pdr.OnlineFilter.load(serialise._packed(content["value"]))


STATE = ("value", "dict", "state", "fields")
SENSING = (*STATE, "sensing", "fields")
STATISTICS = (*STATE, "statistics", "fields")
ATTITUDE_OF_CONFIG = ("value", "dict", "config", "fields", "sensing", "fields", "attitude", "fields")


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ((*ATTITUDE_OF_CONFIG, "tau_acc_s"), 0.0, "tau_acc_s of AttitudeEstimator must be positive"),
        ((*ATTITUDE_OF_CONFIG, "tau_acc_s"), "3", "tau_acc_s of AttitudeEstimator must be .*float"),
        ((*STATISTICS, "n_rejected_fixes"), 1.5, "n_rejected_fixes of Statistics must be .*int.*, got 1.5"),
        ((*STATISTICS, "n_rejected_fixes"), 10**400, "n_rejected_fixes of Statistics must be|digits"),
        ((*STATE, "finished"), 0, "finished of State must be .*bool"),
        ((*STATE, "waiting_fixes"), {"tuple": [1.0]}, "waiting_fixes of State must be"),
        ((*STATE, "waiting_fixes"), {"tuple": {}}, "the items of a tuple must be stored as a list, got {}.*: process"),
        ((*STATISTICS, "walked"), None, "walked of Statistics must be .*StepCounts"),
        ((*SENSING, "cadence"), {"tuple": [{"tuple": [1.0]}]}, "cadence of SensingState must be"),
        ((*SENSING, "processed_s"), 1e31, "processed_s of SensingState must be"),
        ((*SENSING, "n_samples"), 2**70, "n_samples of SensingState must be"),
        (
            (*STATE, "waiting_climbs", "fields", "n_used"),
            -1,
            "n_used of WaitingClimbs must be a non-negative count",
        ),
        ((*SENSING, "vibration", "fields", "extra"), 1.0, "VehicleVibrationState has no field extra"),
    ],
)
def test_a_saved_filter_of_which_one_value_cannot_be_is_refused_by_its_name(
    path: tuple[str, ...], value: Any, words: str
) -> None:
    content = tree()
    at(content, path[:-1])[path[-1]] = value
    with pytest.raises(ValueError, match=words):
        load(content)


@pytest.mark.parametrize("until_s", [0.05, 0.3, 1.5, 8.5])
@pytest.mark.parametrize("recipe", recipes.RECIPES)
def test_a_filter_can_be_saved_at_any_time_of_a_segment(recipe: str, until_s: float) -> None:
    online = pdr.OnlineFilter(config_of(recipe))
    for begin_s in (0.0, 20.0):  # the second segment follows a gap
        online.push(*between(begin_s, begin_s + until_s))
        saved = online.save()
        is_same = pdr.OnlineFilter.load(saved).save() == saved
        assert is_same  # pytest would compare megabytes character by character


@pytest.mark.parametrize("name", recipes.RECIPES)
def test_a_filter_that_is_finished_or_has_seen_nothing_or_no_gyroscope_can_be_loaded(name: str) -> None:
    time_s, force, *_ = between(0.0, 20.0)
    fresh, finished = pdr.OnlineFilter(config_of(name)), pdr.OnlineFilter.load(good_filter(name, located=False))
    finished.push(*between(25.0, 45.0))
    finished.finish()
    blind = pdr.OnlineFilter(config_of(name))
    blind.push(time_s + 1.7e9, force)
    for online in (fresh, finished, blind):
        saved = online.save()
        is_same = pdr.OnlineFilter.load(saved).save() == saved
        assert is_same


def test_a_saved_filter_has_own_models_and_refers_to_shipped_ones_of_equal_content() -> None:
    shipped = load_model("context")
    config = recipes.default()
    assert len(pdr.OnlineFilter(config).save()) < 15_000
    own = pdr.OnlineFilter(config.with_contexts(replace(shipped, temperature=2.0)))
    assert pdr.OnlineFilter.load(own.save()).config.sensing.contexts.models.with_gyroscope.temperature == 2.0
    for name in ("models/context.npz", "unknown"):  # nothing outside of the package is read
        with pytest.raises(ValueError, match=name):
            type(shipped).of_reference(name, "")


@pytest.mark.parametrize(("name", "words"), [("context", "another"), ("gone", "no")])
def test_a_filter_whose_shipped_model_is_gone_or_changed_is_refused_with_remedies_that_work(
    name: str, words: str
) -> None:
    config = recipes.default()
    retrained = replace(load_model("context"), name=name)
    object.__setattr__(retrained, "_checksum", "0" * 64)
    online = pdr.OnlineFilter(config.with_contexts(retrained))
    online.push(*between(0.0, 8.0))
    with pytest.raises(
        ValueError, match=rf"has {words} context model '{name}'.*load\(blob, config=config\).*save\(models=True\)"
    ):
        pdr.OnlineFilter.load(online.save())
    assert pdr.OnlineFilter.load(online.save(), config=config).now().n_steps == online.now().n_steps
    whole = pdr.OnlineFilter.load(online.save(models=True))
    assert whole.config.sensing.contexts.models.with_gyroscope.name == name


def test_a_filter_saved_without_its_path_is_small_and_continues_with_the_same_bits() -> None:
    online = pdr.OnlineFilter.load(good_filter("default", located=True))
    small = pdr.OnlineFilter.load(online.save(path=False))
    assert len(online.path()) > len(small.path()) == 1
    for filter_ in (online, small):
        filter_.push(*between(PAUSE_S, END_S))
    is_same = online.save(path=False) == small.save(path=False)
    assert is_same
    n_new = len(small.path())
    assert n_new > 5
    np.testing.assert_array_equal(small.path().time_s, online.path().time_s[-n_new:])


@pytest.mark.parametrize("part", [b"[],", b"{},", b"1.5,", b'{"a":[]},'], ids=str)
def test_a_small_file_of_many_values_does_not_fill_the_memory(part: bytes) -> None:
    content = b'{"format":8,"value":[' + part * (12_000_000 // len(part)) + b"0]}"
    blob = zlib.compress(content)
    assert len(blob) < 60_000
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="saved data must have at most"):
            from_bytes(blob)
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()


def test_what_unpacks_to_more_than_a_filter_has_is_refused_before_it_is_unpacked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serialise, "_MAX_BYTES", 1 << 20)
    with pytest.raises(ValueError, match="incomplete, or too large"):
        from_bytes(zlib.compress(b" " * (2 << 20)))
    with pytest.raises(ValueError, match="at most 1048576 bytes"):  # nor is such a filter written
        to_bytes(np.zeros(1 << 18))


def test_a_class_of_another_room_is_not_imported() -> None:
    with pytest.raises(ValueError, match="refused to load"):
        from_bytes(serialise._packed({"dataclass": "pdr_filter.live_nothing.x:Server", "fields": {}}))


# --- models and calibrations -----------------------------------------------------------------------------------------


def test_a_small_npz_of_many_zeros_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = load_model("carrying").save(tmp_path)
    monkeypatch.setattr(limits, "MAX_UNPACKED_BYTES", 1 << 20)
    load_model(path)
    files = io.BytesIO(path.read_bytes())
    with zipfile.ZipFile(files, "a", compression=zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros.npy", bytes(2 << 20))
    path.write_bytes(files.getvalue())
    assert len(files.getvalue()) < 100_000
    description = json.loads(path.with_suffix(".json").read_text())
    description["npz_sha256"] = artefact.hashlib.sha256(files.getvalue()).hexdigest()
    path.with_suffix(".json").write_text(json.dumps(description))
    with pytest.raises(ValueError, match="of arrays, more than 1048576"):
        load_model(path)


def test_what_is_too_large_to_be_read_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_model("carrying")
    monkeypatch.setattr(limits, "MAX_UNPACKED_BYTES", 1000)
    with pytest.raises(ValueError, match="make it smaller"):
        model.save(tmp_path)
    assert not list(tmp_path.iterdir())


def without(name: str) -> Callable[[dict[str, Any]], object]:
    return lambda content: content.pop(name)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("residual_std_m"), "residual_std_m is missing|'residual_std_m'"),
        (lambda c: c["residual_std_m"].pop("walking"), "residual_std_m must have a value for each"),
        (lambda c: c["residual_std_m"].update(walking="x"), "'<=' not supported|must be"),
        (lambda c: c.update(recording_std=1e30), "must be from 0 to 1000"),
        (lambda c: c.update(subject_ids=[1, 2]), r"subject_ids of Calibration must be tuple\[str"),
        (lambda c: c["models"]["walking"].update(height_m=-1), "height_m of BounceStepLength must be positive"),
        (lambda c: c["models"].pop("running"), "theta must be"),
        (lambda c: c.update(models={}), "theta must be"),
        (lambda c: c.update(notes=3), "not iterable"),
    ],
)
def test_a_calibration_of_which_one_value_cannot_be_is_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    path = a_calibration().save(tmp_path / "good")
    load_calibration(path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=f"good.json: not usable as calibration: .*({words})"):
        load_calibration(path)
