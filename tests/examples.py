"""Walk and tracks that the examples of pages and docstrings share, computed once in each process."""

from __future__ import annotations

from collections import deque
from functools import cache, partial
from typing import Any

import pytest
from matplotlib.figure import Figure

import pdr_filter as pdr
from pdr_filter.apps.maps import floor_plan

_demo_walk = cache(pdr.simulate.demo_walk)
_track = pdr.track
_LAST: deque[tuple[pdr.Recording, pdr.Track]] = deque(maxlen=8)  # the demo walk and the walks of one page


def _tracked_once(recording: pdr.Recording, *arguments: Any, **options: Any) -> pdr.Track:
    """Return the track, which is stored if the recording is the only argument."""
    if arguments or options:
        return _track(recording, *arguments, **options)
    found = next((track for known, track in _LAST if known is recording), None)
    if found is None:
        found = _track(recording)
        _LAST.append((recording, found))
    return found


def compute_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make `demo_walk` and `track` return stored results: some pages track the demo walk up to 13 times."""
    monkeypatch.setattr(pdr.simulate, "demo_walk", _demo_walk)
    monkeypatch.setattr(pdr, "track", _tracked_once)


def use_few_particles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Track and smooth on a floor plan with fewer particles, where no number is compared: it took 10 s of all pages."""
    few = partial(floor_plan.ParticleFilter, n_least=200, n_most=2_000)
    monkeypatch.setattr(floor_plan, "ParticleFilter", few)


def leave_pictures_blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave pictures of commands blank: to draw one takes as long as to track a walk. Tests of plots look at them."""
    monkeypatch.setattr(Figure, "draw", lambda *_: None)
