from __future__ import annotations

import hashlib
import json
import sys
import zlib
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import pdr_filter as pdr
from pdr_filter.filter.imm.motion_model import MotionNoise
from pdr_filter.filter.step_length.models import known_length
from pdr_filter.values import PositionFix, saved_bytes, saved_formats, serialisation
from pdr_filter.values.serialisation import _packed, from_bytes, to_bytes

NUMBERS = st.floats(allow_nan=True) | st.integers(-(2**63), 2**63) | st.booleans()
VALUES = st.recursive(
    NUMBERS | st.text() | st.none(),
    lambda children: (
        st.lists(children, max_size=4)
        | st.lists(children, max_size=4).map(tuple)
        | st.dictionaries(st.text(), children, max_size=4)
    ),
    max_leaves=20,
)
ARRAYS = hnp.arrays(st.sampled_from(["<f8", ">f8", "<f4", "<i8", "u1", "?"]), hnp.array_shapes(min_dims=0, min_side=0))


def same(a: Any, b: Any) -> bool:
    """Return whether two values are equal in type and in every bit."""
    if type(a) is not type(b):
        return False
    if isinstance(a, float):
        return np.float64(a).tobytes() == np.float64(b).tobytes() or (a != a and b != b)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b)


# --- round trips ----------------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(VALUES)
def test_plain_values_are_restored_unchanged(value: Any) -> None:
    assert same(from_bytes(to_bytes(value)), value)


@given(ARRAYS)
def test_arrays_are_restored_bit_for_bit(array: np.ndarray) -> None:
    assert same(from_bytes(to_bytes(array)), array)


@pytest.mark.parametrize("value", [-0.0, float("inf"), float("-inf"), 5e-324, 0.1, 1.7976931348623157e308])
def test_special_numbers_keep_their_bits(value: float) -> None:
    assert np.float64(from_bytes(to_bytes(value))).tobytes() == np.float64(value).tobytes()


def test_the_payload_of_a_nan_in_an_array_survives() -> None:
    array = np.array([0x7FF8000000000123, 0xFFF8000000000001], dtype=np.uint64).view(np.float64)
    assert from_bytes(to_bytes(array)).tobytes() == array.tobytes()


def test_a_non_contiguous_array_is_restored_with_its_values_and_writable() -> None:
    array = np.arange(24.0).reshape(4, 6)[::2, ::-3].T
    array.flags.writeable = False
    back = from_bytes(to_bytes(array))
    np.testing.assert_array_equal(back, array)
    back[0, 0] = 1.0


def test_dataclasses_of_the_package_are_restored_with_their_fields() -> None:
    value = {"noise": MotionNoise(log_scale_std=0.2), "fits": (known_length(0.3, 0.1),)}
    fix = PositionFix(1.5, np.array([1.0, 2.0]), np.eye(2))
    back = from_bytes(to_bytes({**value, "fix": fix}))
    assert back["noise"] == value["noise"]
    assert same(back["fits"], value["fits"])
    assert same(back["fix"], fix)


def test_numpy_numbers_are_restored_as_numbers() -> None:
    assert from_bytes(to_bytes((np.float64(0.1), np.int64(3), np.bool_(True)))) == (0.1, 3, True)


# --- what is refused ------------------------------------------------------------------------------------------------


@dataclass
class Foreign:
    """A dataclass that is not of the package."""

    x: float = 1.0


@pytest.mark.parametrize(
    "value",
    [
        Foreign(),
        {1, 2},
        b"bytes",
        datetime.now(UTC),
        len,
        np.array([object()]),
        np.zeros(2, dtype=[("x", float)]),
        np.zeros(2, dtype=complex),
        {1: "keys that are no strings"},
    ],
    ids=["dataclass", "set", "bytes", "date", "function", "object array", "table", "complex array", "number as key"],
)
def test_values_that_cannot_be_restored_are_refused(value: object) -> None:
    with pytest.raises(TypeError):
        to_bytes({"nested": [value]})


@pytest.mark.parametrize(
    "value",
    [
        {"dataclass": "subprocess:Popen", "fields": {"args": ["true"]}},
        {"dataclass": "pdr_filter_evil:Thing", "fields": {}},
        {"dataclass": "builtins:dict", "fields": {}},
        {"dataclass": "pdr_filter.tracking.online:OnlineFilter", "fields": {}},
        {"dataclass": "pdr_filter.tracking.track:np", "fields": {}},
        {"dataclass": "pdr_filter.tracking.track:Nothing", "fields": {}},
        {"dataclass": "pdr_filter.nothing:Step", "fields": {}},
        {"dataclass": "pdr_filter.tracking.track:Step", "fields": {"unknown": 1}},
        {"dataclass": "pdr_filter.tracking.track:Step", "fields": {}},
        {"dataclass": "pdr_filter.tracking.track:Step"},
        {"dataclass": 5, "fields": {}},
        {"array": "AAAA", "dtype": "O", "shape": [1]},
        {"array": "AAAA", "dtype": "<f8", "shape": [1]},
        {"array": "not base64!", "dtype": "<f8", "shape": [1]},
        {"array": "", "dtype": "nonsense", "shape": [0]},
        {"array": "", "dtype": "(1", "shape": [0]},
        {"array": "", "dtype": "<f8", "shape": "x"},
        {"array": 5, "dtype": "<f8", "shape": [1]},
        {"array": -8, "dtype": "<f8", "shape": [1]},
        {"array": 1.0, "dtype": "<f8", "shape": [0]},
        {"array": 0, "dtype": "<f8", "shape": [-1, -1]},
        {"tuple": 5},
        {"dict": [1]},
        {},
    ],
    ids=str,
)
def test_bytes_that_name_other_classes_are_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(_packed(value))


@pytest.mark.parametrize("whole", [False, True])
def test_bytes_with_a_constant_value_are_the_same_at_each_call(whole: bool) -> None:
    online = pdr.OnlineFilter()
    content = {"config": online.config, "state": online.state}
    expected = to_bytes(content, whole=whole)
    for _ in range(2):
        assert (to_bytes(content, whole=whole, constant=online.config) == expected) is True


@pytest.mark.parametrize("number", [1, 5, 99])
def test_a_filter_of_another_version_of_the_package_is_refused_with_a_remedy(number: int) -> None:
    old = zlib.compress(json.dumps({"format": number, "value": None}).encode())
    words = rf"another version of pdr_filter, with format {number} instead of 6 to 12\): process the samples again"
    with pytest.raises(ValueError, match=words):
        from_bytes(old)


def test_many_arrays_of_the_same_bytes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    node = {"array": 0, "dtype": "<f8", "shape": [1000]}
    monkeypatch.setattr(serialisation, "_MAX_BYTES", 100_000)
    assert not from_bytes(_packed({"list": [node] * 12}, bytes(8000)))[11].any()
    with pytest.raises(ValueError, match="more than 100000 bytes"):
        from_bytes(_packed({"list": [node] * 13}, bytes(8000)))


@pytest.mark.parametrize("position", [8, -8, [0], [0, 1 << 40], [0, "1"], None, 0.5])
def test_an_array_whose_bytes_are_not_there_is_refused(position: Any) -> None:
    node = {"array": position, "dtype": "<f8", "shape": [2, 2]}
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(_packed(node, bytes(32)))


@pytest.mark.parametrize("shape", [[10**400] * 30, [1] * 33, [-1, 2], [2.0], ["2"], [True]])
def test_an_array_of_a_shape_that_no_array_has_is_refused(shape: list[Any]) -> None:
    with pytest.raises(ValueError, match="cannot be loaded"):
        from_bytes(_packed({"array": 0, "dtype": "<f8", "shape": shape}, bytes(32)))


def test_many_kept_rows_of_a_clock_of_format_10_are_refused() -> None:
    kept = {"array": 0, "dtype": "<f8", "shape": [257, 4]}
    node = {"dataclass": "pdr_filter.sensing.clock:ClockState", "fields": {"kept": kept}}
    with pytest.raises(ValueError, match="more rows than a filter does"):
        saved_formats.in_present_format(node, 10, bytes(257 * 32))


def test_compressed_content_above_the_limit_is_refused_whichever_part_exceeds_it() -> None:
    parts = [b"{}" + bytes(1000), b'"state": ' + bytes(1000), bytes(1000), bytes(1000)]
    for n in range(1, 5):
        config, state, arrays, signals = (*parts[:n], *[b""] * (4 - n))
        size, blob = len(config + state + arrays + signals), saved_bytes.compressed(config + state, arrays, signals)
        assert saved_bytes.decompressed(blob, size + 1)[0] == config + state
        with pytest.raises(ValueError, match="too large"):
            saved_bytes.decompressed(blob, size - 1)


def test_signals_with_equal_ends_are_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serialisation, "_MAX_COMPARED", 2)
    rows = np.random.default_rng(0).normal(size=(20, 64))
    rows[:, 14:] = 0.0
    assert np.array_equal(from_bytes(to_bytes(rows)), rows)


def test_signals_that_several_arrays_contain_are_stored_once_with_their_bits() -> None:
    rng = np.random.default_rng(0)
    signals = rng.normal(size=(5, 200))
    signals[0, :3] = np.nan, -0.0, -np.inf
    one, parts = to_bytes([signals]), [signals, signals[1:4, 50:].copy(), signals[:2, -64:].T.copy(), signals[4]]
    several = to_bytes(parts)
    assert len(several) < len(one) + 300
    loaded = from_bytes(several)
    assert [a.tobytes() for a in loaded] == [a.tobytes() for a in parts]
    assert [a.shape for a in loaded] == [a.shape for a in parts]
    assert loaded[0].flags.writeable and loaded[1].base is None


def test_saved_filters_are_compressed_with_an_example_that_never_changes() -> None:
    example = saved_bytes._EXAMPLE.read_bytes()
    assert hashlib.sha256(example).hexdigest() == "d0537e6567570f71514dc013def7cb9cb154a29768b98621e6ea4d7e306ba786"


def test_a_dataclass_of_another_package_is_refused_without_importing_its_module() -> None:
    for name in (f"{__name__}:Foreign", "this:Zen"):  # importing `this` would print a poem
        with pytest.raises(ValueError, match="refused to load"):
            from_bytes(_packed({"dataclass": name, "fields": {}}))
    assert "this" not in sys.modules


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_arbitrary_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(data)


@settings(max_examples=60)
@given(st.binary(max_size=300) | st.recursive(st.none() | st.integers() | st.text(), lambda c: st.lists(c)))
def test_arbitrary_compressed_content_is_refused(content: Any) -> None:
    data = content if isinstance(content, bytes) else json.dumps(content).encode()
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(zlib.compress(data))


def test_deeply_nested_lists_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(zlib.compress(b"[" * 100_000))


@settings(max_examples=100)
@given(st.data())
def test_a_damaged_blob_is_refused(data: st.DataObject) -> None:
    good = to_bytes({"x": np.arange(50.0)})
    length = data.draw(st.integers(0, len(good) - 1))
    with pytest.raises(ValueError, match="cannot be loaded as a saved value"):
        from_bytes(good[:length])
