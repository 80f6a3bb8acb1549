"""Results and configurations stay read-only when they are copied or pickled."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.values import Wifi


def arrays_of(value: Any) -> Iterator[np.ndarray]:
    """Return the arrays of a value and of its nested values."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from arrays_of(item)
    elif is_dataclass(value):
        for each in fields(value):
            yield from arrays_of(getattr(value, each.name))


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    walk = pdr.simulate.demo_walk()
    fixes = [pdr.PositionFix(20.0, (0.0, 10.0), np.eye(2))]
    return {
        "recording": replace(walk, wifi=Wifi(np.zeros(1), np.zeros(1, dtype=int), np.full(1, -60.0), np.zeros(1))),
        "track": pdr.track(walk, fixes=fixes),
        "windows": pdr.classify(walk),
        "smoothed": pdr.smooth(walk, fixes=fixes),
        "calibration": pdr.calibrate(walk),
        "truth": walk.truth,
        "config": pdr.recipes.default(),
    }


@pytest.mark.parametrize("name", ["recording", "track", "windows", "smoothed", "calibration", "truth", "config"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_a_copy_of_a_result_is_equal_and_read_only(
    results: dict[str, Any], name: str, copied: Callable[[Any], Any]
) -> None:
    result = results[name]
    other = copied(result)
    assert type(other) is type(result)
    pairs = list(zip(arrays_of(other), arrays_of(result), strict=True))
    assert len(pairs) >= 5
    for ours, theirs in pairs:
        assert not ours.flags.writeable
        assert type(ours) is type(theirs)
        assert ours.tobytes() == theirs.tobytes()


def test_a_copy_does_not_change_the_writeable_flag_of_the_original_array(results: dict[str, Any]) -> None:
    own_m = np.zeros_like(results["track"].position_m)
    changed = copy.copy(replace(results["track"], position_m=own_m))
    assert own_m.flags.writeable
    assert not changed.position_m.flags.writeable
