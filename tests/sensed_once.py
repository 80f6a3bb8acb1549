"""The front end computes its events once for equal samples: tests of fixes track the same walk many times."""

from __future__ import annotations

from dataclasses import astuple
from functools import lru_cache

import numpy as np
import pytest

from pdr_filter.sensing.front_end import KnownEvents, Sensing, SensingState
from pdr_filter.values import ImuBlock

MIN_SAMPLES = 1_000  # blocks of a recording; the short blocks of an online filter are seldom equal

# Configurations and states are compared by their identity, and stored results return the same state.
_init, _finished = lru_cache(128)(Sensing.init), lru_cache(128)(Sensing.finish)
_update = Sensing.update


@lru_cache(128)
def _updated(sensing: Sensing, state: SensingState, columns: tuple[bytes, ...]) -> tuple[SensingState, KnownEvents]:
    time_s, *others = (np.frombuffer(column) for column in columns)
    return _update(sensing, state, ImuBlock(time_s, *(values.reshape(-1, 3) for values in others)))


def _updated_once(sensing: Sensing, state: SensingState, block: ImuBlock) -> tuple[SensingState, KnownEvents]:
    if len(block.time_s) < MIN_SAMPLES:
        return _update(sensing, state, block)
    state, events = _updated(sensing, state, tuple(column.tobytes() for column in astuple(block)))
    return state, list(events)


def _finished_once(sensing: Sensing, state: SensingState) -> tuple[SensingState, KnownEvents]:
    state, events = _finished(sensing, state)
    return state, list(events)


def sense_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the front end return stored results for blocks that are equal, with all blocks before them."""
    monkeypatch.setattr(Sensing, "init", _init)
    monkeypatch.setattr(Sensing, "update", _updated_once)
    monkeypatch.setattr(Sensing, "finish", _finished_once)
