"""Good saved filters, models and calibrations, and what can happen to them: damage, other types, shapes and numbers."""

from __future__ import annotations

import base64
import copy
import hashlib
import io
import json
import os
import random
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.classifiers.context_model import available_models, load_model
from pdr_filter.classifiers.model_files import file_pair
from pdr_filter.recipes.calibration import Calibration, load_calibration
from pdr_filter.values import ImuBlock
from pdr_filter.values import serialisation as serialise
from pdr_filter.values.recording import Subject
from pdr_filter.values.saved_bytes import compressed, decompressed

sys.path.insert(0, str(Path(__file__).parent / "data" / "io"))

sys.path.insert(0, str(Path(__file__).parent))

from mutations import truncated, with_absurd_numbers, with_flipped_bits, with_pieces_moved
from own_parts import own_config

# And one of parts of other packages, whose configuration is not in the bytes.
FILTERS = (*(f"filter:{name}" for name in recipes.RECIPES), "filter:own")
ANCHORS = ((-8.0, -6.0), (25.0, -5.0))
FORMS = (*FILTERS, "model", "calibration")

BEGIN_S, PAUSE_S, END_S = 12.0, 25.0, 35.0  # of the walk that the filters have seen, and of what comes after loading

MUTATIONS_OF_BYTES = (truncated, with_flipped_bits, with_pieces_moved)
ABSURD: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 0.0, 1.0, -1.0, 0.5, 2, 100, 1e-300, 1e-9, 1e9, 1e30, 1e300, -1e308),
    *(float("nan"), float("inf"), float("-inf"), 2**31, 2**53, 2**63, -(2**63), 10**30, 10**400),
    *("", "x", "walking", "imm", "1", [], {}, {"tuple": []}, {"list": []}, {"dict": {}}, {"tuple": [0.0, 0.0]}),
    *({"array": "", "dtype": "<f8", "shape": [0]}, {"array": "AAAAAAAA8D8=", "dtype": "<f8", "shape": [1]}),
    *({"dataclass": "pdr_filter.values.fixes:Standstill", "fields": {"time_s": 0.0, "end_s": 1e9}},),
)
TYPES = ("<f4", ">f8", "<i8", "|b1", "|u1", "<f2", "O", "<c16", "<U8", "<M8[s]", "(2,)f8", "f8,f8", "1" * 60, "")


# --- good ones -------------------------------------------------------------------------------------------------------


@cache
def walk() -> ImuBlock:
    """Somebody walks."""
    return pdr.merge_streams(pdr.simulate.demo_walk())


def between(begin_s: float, end_s: float) -> tuple[np.ndarray, ...]:
    """What is pushed of that time."""
    block = walk()
    part = slice(*np.searchsorted(block.time_s, [begin_s, end_s]))
    return tuple(
        column[part]
        for column in (block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)
    )


@cache
def good_filter(recipe: str, *, located: bool) -> bytes:
    """A filter in the middle of a walk, with climbs, fixes that wait, and perhaps in the world frame."""
    config = config_of(recipe)
    online = pdr.OnlineFilter(config.in_world_frame() if located else config)
    for begin_s, end_s in ((0.0, 8.0), (BEGIN_S, PAUSE_S)):  # and a gap
        time_s, *signals = between(begin_s, end_s)
        online.push_pressure(time_s[::10], 1000.0 - 0.001 * time_s[::10])
        if located:
            online.push_location(
                time_s[::100], 50.0 + 1e-5 * time_s[::100], 8.0 + 0 * time_s[::100], 5.0 + 0 * time_s[::100]
            )
        for t in time_s[100::200].tolist() if recipe == "own" else ():
            for anchor_m in ANCHORS:
                away_m = np.array([0.0, max(t - 5.0, 0.0)]) - anchor_m
                online.add_fix(pdr.RangeFix(t, np.array(anchor_m), float(np.hypot(*away_m)), 0.3))
        online.push(time_s, *signals)
    online.add_fix(pdr.PositionFix(PAUSE_S + 1.0, np.zeros(2), 100.0 * np.eye(2)))
    online.add_fix(pdr.Standstill(PAUSE_S + 2.0, PAUSE_S + 3.0))
    online.add_fix(pdr.RangeFix(PAUSE_S + 1.0, np.array(ANCHORS[0]), 9.0, 3.0))
    return online.save()


def config_of(recipe: str) -> pdr.Config:
    """The configuration of a recipe, or of parts of users.

    The default one has boosted trees, which are saved and loaded five times as fast as its usual forest.
    """
    subject = recipes.Subject(height_m=1.7)
    if recipe == "default":
        return recipes.default(subject, classifier="boosted")
    return own_config() if recipe == "own" else recipes.RECIPES[recipe](subject)


# --- what can happen to saved filters ---------------------------------------------------------------------------------


def nodes(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all parts of what JSON holds."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield (*path, key)
        yield from nodes(part, (*path, key))


def at(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def tree_of(blob: bytes) -> Any:
    """Return the content of a saved filter, with arrays as text as before format 10."""
    text, arrays = decompressed(blob, 1 << 26)
    decoder = serialise._Decoder({}, arrays)

    def with_text(node: dict[str, Any]) -> dict[str, Any]:
        return encoded(decoder.value(node)) if set(node) == {"array", "dtype", "shape"} else node

    return json.loads(text, object_hook=with_text)


def decoded(node: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(node["array"]), dtype=node["dtype"]).reshape(node["shape"])


def encoded(array: np.ndarray) -> dict[str, Any]:
    data = base64.b64encode(array.tobytes()).decode()
    return {"array": data, "dtype": array.dtype.str, "shape": list(array.shape)}


def changed_array(node: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """An array with other numbers, another type or another shape."""
    array = decoded(node).copy()
    shape = list(array.shape)
    what = rng.randrange(7)
    if what == 0 and array.size:
        flat = array.reshape(-1)
        part = rng.choice([slice(None), slice(rng.randrange(array.size), None, rng.choice([1, 7, array.size]))])
        number = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e9, 1e300, 1e-300])
        with np.errstate(all="ignore"):
            flat[part] = np.array(number).astype(array.dtype)
    elif what == 1:
        others = [shape[::-1], [1, *shape], [*shape, 1], [array.size], shape[:-1], [0], [2**31, 2**31], [-1], []]
        return {**encoded(array), "shape": rng.choice(others)}
    elif what == 2:
        return {**node, "dtype": rng.choice(TYPES)}
    elif what == 3:
        array = array[: rng.randrange(len(array) + 1)] if array.ndim else array
    elif what == 4 and array.ndim:
        array = np.concatenate([array] * rng.choice([2, 3]), axis=rng.randrange(array.ndim))
    elif what == 5:
        array = np.zeros(rng.choice([(0,), (1,), (3, 3), (10, 10, 10)]), dtype=array.dtype)
    else:
        data = with_flipped_bits(array.tobytes(), rng) if array.size else b"x"
        return {**node, "array": base64.b64encode(data).decode()}
    return encoded(array)


def changed(tree: Any, rng: random.Random) -> Any:
    """What JSON holds with one part changed, taken away, repeated or put in the place of another."""
    tree = copy.deepcopy(tree)
    try:
        top = ("value", "dict", rng.choice(["state", "config"]))  # of a filter: its models have most of the values
        paths = [(*top, *path) for path in nodes(at(tree, top))]
    except (KeyError, TypeError):
        paths = []
    paths = paths or list(nodes(tree))
    if not paths:
        return tree
    path = rng.choice(paths)
    parent, key = at(tree, path[:-1]), path[-1]
    value = parent[key]
    if rng.random() < 0.3:
        arrays = [p for p in paths if isinstance(at(tree, p), dict) and "array" in at(tree, p)]
        if arrays:
            path = rng.choice(arrays)
            with suppress(Exception):  # of an array that is damaged already
                at(tree, path[:-1])[path[-1]] = changed_array(at(tree, path), rng)
            return tree
    what = rng.random()
    if what < 0.5:
        parent[key] = rng.choice(ABSURD)
    elif what < 0.6:
        del parent[key]
    elif what < 0.7:
        parent[key] = copy.deepcopy(at(tree, rng.choice(paths)))
    elif what < 0.8 and isinstance(value, float | int) and not isinstance(value, bool):
        with suppress(OverflowError):
            parent[key] = value * rng.choice([-1, 2, 1e3, 1e9, 1e-9])
    elif what < 0.9 and isinstance(value, list):
        parent[key] = rng.choice([value * 2, value[::-1], value[:-1], value[:1] * 1000])
    elif isinstance(parent, dict):
        parent[f"{key}x"] = value
    return tree


def damaged_filter(blob: bytes, rng: random.Random) -> bytes:
    """A mutation of the bytes or of the text of a saved filter."""
    if rng.random() < 0.3:
        return rng.choice([truncated, with_flipped_bits])(blob, rng)
    change = rng.choice([truncated, with_flipped_bits, with_pieces_moved, with_absurd_numbers])
    text, arrays = decompressed(blob, 1 << 26)
    if rng.random() < 0.5:
        return compressed(change(text, rng), b"", arrays)
    return compressed(text, change(arrays, rng), b"")


def forged_filter(blob: bytes, rng: random.Random) -> bytes:
    """A mutation of what a saved filter says, with a checksum that is right."""
    tree = tree_of(blob)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        tree = changed(tree, rng)
    return serialise._packed(tree["value"])


def use_filter(blob: bytes, recipe: str = "default") -> None:
    """Load, go on, end. A forged filter may be wrong or fail, but not refuse to end."""
    online = pdr.OnlineFilter.load(blob, config=config_of(recipe) if recipe == "own" else None)
    time_s, *signals = between(PAUSE_S, END_S)
    with suppress(Exception):
        if online.state.merger.is_used:  # this number was changed: it takes sensors apart
            _ = online.push_accelerometer(time_s, signals[0]), online.push_gyroscope(time_s, signals[1])
        else:
            online.push(time_s, *signals)
        _ = online.finish(), online.notes, online.device


# --- models and calibrations ------------------------------------------------------------------------------------------


def good_files(form: str, folder: Path, number: int) -> Path:
    """The .json, beside its .npz, of a model or a calibration."""
    if form == "model":
        model = load_model(available_models()[number % len(available_models())])
        return model.save(folder).with_suffix(".json")
    return a_calibration().save(folder / "good")


@cache
def a_calibration() -> Calibration:
    """What two walks of two people tell."""
    walk = pdr.simulate.demo_walk()
    people = [replace(walk, name=f"w_{name}", meta={**walk.meta, "subject": {"id": name}}) for name in ("anna", "ben")]
    return pdr.calibrate(people)


def mutated_files(path: Path, rng: random.Random) -> None:
    """Change the files of a model or a calibration, and make the checksum right again most of the time."""
    json_path, npz_path = file_pair(path)
    text, packed = json_path.read_text(), npz_path.read_bytes()
    description, where = json.loads(text), rng.random()
    if where < 0.1:
        json_path.write_bytes(rng.choice(MUTATIONS_OF_BYTES)(text.encode(), rng))
        return
    if where < 0.2:
        packed = rng.choice(MUTATIONS_OF_BYTES)(packed, rng)
    elif where < 0.6:
        packed = mutated_npz(packed, rng)
    else:
        for _ in range(rng.choice([1, 1, 2, 3])):
            description = changed(description, rng)
    if isinstance(description, dict) and "npz_sha256" in description and rng.random() < 0.95:
        description["npz_sha256"] = hashlib.sha256(packed).hexdigest()
    npz_path.write_bytes(packed)
    json_path.write_text(json.dumps(description))


def mutated_npz(packed: bytes, rng: random.Random) -> bytes:
    """Arrays of which some are others, or not there, or their bytes are damaged inside an intact zip."""
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(rng.choice([1, 1, 2])):
        name = rng.choice(sorted(files))
        if rng.random() < 0.2:
            files[name] = rng.choice(MUTATIONS_OF_BYTES)(files[name], rng) if files[name] else b"x"
        elif rng.random() < 0.1:
            files[rng.choice(["x.npy", "../x.npy", name.replace("_", "-", 1)])] = files.pop(name)
            break
        else:
            with suppress(Exception):  # damaged already
                array = np.load(io.BytesIO(files[name]), allow_pickle=False)
                buffer = io.BytesIO()
                np.save(buffer, decoded(changed_array(encoded(array), rng)), allow_pickle=False)
                files[name] = buffer.getvalue()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def use_model(path: Path) -> None:
    """Load and classify: ValueError only from loading, and probabilities."""
    model = load_model(path)
    rows = np.random.default_rng(0).normal(size=(3, len(model.feature_names)))
    for row in (*rows, model.feature_mean, model.feature_mean + 10 * model.feature_scale):
        with later():
            prob = model.predict(row)
        assert np.isfinite(prob).all()
        assert abs(prob.sum() - 1) < 1e-6


def use_calibration(path: Path) -> None:
    """Load, ask for everybody's step lengths, report: ValueError only from loading."""
    calibration = load_calibration(path)
    with later():
        for name in (None, *calibration.subject_ids):
            config = calibration.config(recipes.default(), Subject(id=name))
            assert np.isfinite([mode.step_length.theta[0] for mode in config.model.modes]).all()
        _ = calibration.report(), calibration.distrusted, calibration.subjects, repr(calibration)


# --- one input --------------------------------------------------------------------------------------------------------


def try_one(form: str, number: int, seed: int, folder: Path) -> str:
    """What happened to an input: "worked", "refused", or what went wrong."""
    rng = random.Random(f"{form} {seed} {number}")
    kind, _, recipe = form.partition(":")
    if kind == "filter":
        blob = forged_filter(good_filter(recipe, located=number % 2 == 1), rng)
        return outcome(partial(use_filter, blob, recipe), folder)
    path = good_files(form, folder, number)
    mutated_files(path, rng)
    return outcome(partial({"model": use_model, "calibration": use_calibration}[form], path), folder)


def outcome(use: Callable[[], None], folder: Path) -> str:
    """What happens when something is used: "worked", "refused", or what went wrong; no other folder is touched."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            with only_in(folder):
                use()
        except ValueError as error:
            return "refused" if len(str(error)) > 20 else f"refused without a reason: {error}"
        except BaseException as error:
            return f"{type(error).__name__}: {str(error)[:120]}"
    return "worked"


@contextmanager
def later() -> Iterator[None]:
    """What is used after loading may not be refused any more."""
    try:
        yield
    except ValueError as error:
        raise AssertionError(f"only later: {error}") from error


_CODE = (".py", ".pyc", ".so")  # of modules that are imported late
_allowed: list[str] = []  # the folder, while something is used
_opened: list[str] = []  # files elsewhere


@contextmanager
def only_in(folder: Path) -> Iterator[None]:
    """OSError at the end if a file elsewhere was opened, to read or to write."""
    _listen()
    _allowed.append(os.path.realpath(folder))
    _opened.clear()
    try:
        yield
    finally:
        _allowed.pop()
        if _opened:
            raise OSError(f"opened {_opened[0]}")


@cache
def _listen() -> None:
    def heard(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and _allowed and isinstance(arguments[0], str | bytes):
            where = os.path.realpath(os.fsdecode(arguments[0]))
            if not where.startswith(_allowed[-1]) and not where.endswith(_CODE):
                _opened.append(where)

    sys.addaudithook(heard)
