"""Fixtures of the report tests: the demonstration walk and its track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.tracking.track import Track
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="session")
def recording() -> Recording:
    return pdr.simulate.demo_walk()


@pytest.fixture(scope="session")
def track(recording: Recording) -> Track:
    """Track of the demonstration walk on one storey."""
    found = pdr.track(recording)
    zeros = np.zeros(found.n_steps)
    return replace(found, height_m=zeros, floor=zeros.astype(np.int64), floor_passages=())
