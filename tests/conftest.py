"""Shared fixtures: where the real recordings are, and what happens where they are not."""

from __future__ import annotations

import gc
import signal
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.simulate import Gait, Leg, walk
from pdr_filter.simulate.gait import StepPlan
from pdr_filter.simulate.motion import Carrying, Motion, build_motion
from tests.data_folder import DATA, DataSets
from tests.sensed_once import sense_once

gc.disable()  # until all tests are collected: it took a tenth of the collection, which each worker does
_TESTS = Path(__file__).parent
if not (_TESTS / "benchmarks").is_dir():  # in the sdist, which has no experiments
    collect_ignore = [
        "apps/live/test_live_soak.py",
        "evaluate/test_evaluate_consistency.py",
        "filter/imm/test_consistency.py",
        "test_docs_code.py",
        "test_peers_benchmark.py",
        "test_soak.py",
    ]

# Tests that `make test` leaves to `make test-all` and CI: nearly all that take more than 0.3 s of one fast core, all
# parameters together, and those of studies, training and pages in a browser, which together take long.
SLOW = frozenset((_TESTS / "slow_tests.txt").read_text().split())


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings, `data_dir / data_set`; a missing data set skips the test, or fails in CI."""
    return DataSets(DATA)


@pytest.fixture(scope="session", autouse=True)
def _motions_once() -> Iterator[None]:
    """Compute the motion of equal legs, people and seeds once in each process: it took a tenth of the time of tests.

    Its sensors are simulated each time. Tests of the simulation itself have no part in it.
    """
    stored: dict[str, Motion] = {}

    def once(
        legs: Sequence[Leg],
        places: Sequence[tuple[str, Carrying]],
        gait: Gait,
        plan: StepPlan,
        rng: np.random.Generator,
        start_heading_rad: float,
    ) -> Motion:
        seed = rng.bit_generator.state["state"]["state"]  # the plan has the same
        key = repr((list(legs), list(places), gait, seed, start_heading_rad))
        if key not in stored:
            stored[key] = build_motion(legs, places, gait, plan, rng, start_heading_rad)
            if len(stored) > 12:
                del stored[next(iter(stored))]
        return stored[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walk, "build_motion", once)
        yield


@pytest.fixture(scope="module")
def sensing_once() -> Iterator[None]:
    """Let equal recordings of a module pass the front end once, in modules that test what happens after it."""
    with pytest.MonkeyPatch.context() as patch:
        sense_once(patch)
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow tests, and begin with the files that have most of them, so that no worker ends with a long file."""
    n_tests, n_slow = Counter[Path](), Counter[Path]()
    for item in items:
        n_tests[item.path] += 1
        if item.nodeid.partition("[")[0] in SLOW:
            item.add_marker(pytest.mark.slow)
            n_slow[item.path] += 1
    items.sort(key=lambda item: (n_slow[item.path], n_tests[item.path]), reverse=True)


def pytest_collection_finish() -> None:
    """Exempt modules and collected tests from garbage collection, which took 8 % of the time of the tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Let a worker end in its own time.

    execnet interrupts a worker that needs more than five seconds to free its objects. Python would print the interrupt
    below the result of the tests.
    """
    if hasattr(session.config, "workerinput"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
