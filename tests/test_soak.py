"""Ten minutes of what `tests.benchmarks.soak` does for two days, on a simulated walk."""

from __future__ import annotations

import numpy as np

from pdr_filter.simulate import Leg, simulate
from tests.benchmarks.placements import Walk
from tests.benchmarks.soak import soak


def test_broken_clocks_sensors_and_fixes_neither_stop_the_filter_nor_make_it_contradict_itself() -> None:
    legs = [Leg("walking", distance_m=25.0), *(Leg("walking", distance_m=25.0, turn_rad=np.pi / 2) for _ in range(3))]
    made = simulate(legs, seed=4)
    truth = made.truth.position
    assert truth is not None
    walk = Walk("simulated", made, truth.time_s, np.column_stack([truth.east_m, truth.north_m]))
    (tally,) = soak([walk], hours=1 / 6, seed=3)
    assert tally.n_steps > 100
    assert (tally.n_nan, tally.n_not_psd) == (0, 0)
    assert tally.n_resumed > 0
    assert tally.n_resumed_differently == 0
    assert max(tally.save_bytes) < 2e6
