"""filterpy's IMMEstimator on the problem of `imm_speed.py`: 6 modes, 4 states, a fix of the position each step."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from .harness import Table
from .walks import FloatArray

N_STEPS, N_AT_ONCE = 300, 500


def filters() -> Table:
    """Time of a step, and how far the estimates are from filterpy's."""
    columns = ["filter", "ms a step and pedestrian", "times as fast", "largest difference"]
    try:
        from tests.benchmarks import imm_speed
    except ImportError as error:
        return columns, [["filterpy", f"not run: filterpy is not installed ({error})", "", ""]]
    fixes = np.cumsum(np.random.default_rng(0).normal(size=(N_STEPS, 2)), axis=0)
    oracle = imm_speed.of_filterpy()

    def theirs(fix: FloatArray) -> FloatArray:
        oracle.predict()
        oracle.update(fix)
        return oracle.x.copy()

    def ours(n: int | None) -> Callable[[FloatArray], FloatArray]:
        state = imm_speed.start(n)
        batch = () if n is None else (n,)
        noise = np.broadcast_to(imm_speed.R, (*batch, 2, 2))

        def cycle(fix: FloatArray) -> FloatArray:
            nonlocal state
            *state, mean = imm_speed.cycle(*state, np.broadcast_to(fix, (*batch, 2)), noise)
            return mean

        return cycle

    reference, reference_s = _timed(theirs, fixes)
    rows = [["filterpy, IMMEstimator", f"{1e3 * reference_s:.3f}", "1", "-"]]
    for name, n in (
        ("pdr_filter.filter.imm.imm, one pedestrian", None),
        (f"pdr_filter.filter.imm.imm, {N_AT_ONCE} at once", N_AT_ONCE),
    ):
        mean, step_s = _timed(ours(n), fixes)
        apart = max(np.abs(m - r).max() for m, r in zip(mean, reference, strict=True))
        step_s /= n or 1
        rows.append([name, f"{1e3 * step_s:.4f}", f"{reference_s / step_s:.0f}", f"{apart:.0e}"])
    return columns, rows


def _timed(cycle: Callable[[FloatArray], FloatArray], fixes: FloatArray) -> tuple[Sequence[FloatArray], float]:
    """Estimates after each fix, and the processor time of one."""
    begin_s = time.process_time()
    found = [cycle(fix) for fix in fixes]
    return found, (time.process_time() - begin_s) / len(fixes)
