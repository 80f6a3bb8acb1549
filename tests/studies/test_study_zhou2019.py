from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.data.io.formats import read
from pdr_filter.values import Samples, table
from pdr_filter.values.recording import Recording, Truth
from tests.studies import zhou2019 as measured


def foot_on_a_line(n_strides: int, length_m: float, stride_s: float = 1.2) -> Recording:
    """A foot that stands for half of each stride and then moves on by the length."""
    time_s = np.arange(0.0, n_strides * stride_s + 1.0, 1 / 200)
    phase = np.clip(time_s - 0.5, 0.0, n_strides * stride_s - 1e-9) / stride_s
    moving = np.clip((phase % 1.0 - 0.5) / 0.5, 0.0, 1.0)
    east_m = length_m * (np.floor(phase) + moving**3 * (10 - 15 * moving + 6 * moving**2))
    zero = np.zeros_like(time_s)
    position = table({"time_s": time_s, "east_m": east_m, "north_m": zero, "up_m": zero + 0.1})
    force = Samples(time_s, np.column_stack([zero, zero, zero + 9.81]))
    return Recording("foot", force, truth=Truth(position=position))


@pytest.mark.parametrize(("n", "length_m"), [(5, 0.8), (9, 1.4)])
def test_strides_of_a_foot_are_its_moves_between_stances(n: int, length_m: float) -> None:
    truth = measured.foot_truth(foot_on_a_line(n, length_m))
    assert len(truth.stride_end_s) == n
    assert truth.way_m == pytest.approx(n * length_m, rel=0.02)
    np.testing.assert_allclose(np.diff(truth.stride_end_s), 1.2, atol=0.03)


def test_the_printed_tables_4_and_5_give_their_printed_success_rates() -> None:
    printed = [(98.2, 100), (99.2, 100), (98.2, 99.8), (99.1, 99.8), (99, 100), (96.8, 99.7), (97.9, 99.1), (98, 99.2)]
    found = [
        [100 * (1 - sum(wrong) / n_true) for wrong in (theirs, ours)]
        for n_true, theirs, ours in measured._TABLES_4_AND_5.values()
    ]
    np.testing.assert_allclose(found, printed, atol=0.11)


@pytest.mark.parametrize("frequency_hz", [1.5, 2.0, 3.0])
def test_levi_and_judd_find_a_step_in_every_period_of_walkers_and_runners(frequency_hz: float) -> None:
    time_s = np.arange(0.0, 40.0, 0.01)
    force = np.zeros((len(time_s), 3))
    force[:, 2] = 9.81 + 3.0 * np.sin(2 * np.pi * frequency_hz * time_s)
    found = measured.levi_judd_times_s(Recording("sway", Samples(time_s, force)), measured.LEVI_JUDD_CARRIED)
    assert len(found) == pytest.approx(40 * frequency_hz, abs=2)
    np.testing.assert_allclose(np.diff(found), 1 / frequency_hz, atol=0.03)


def test_parameters_of_exact_distances_are_found_again() -> None:
    rng = np.random.default_rng(0)
    sums = rng.uniform(50, 150, 40)[:, None] * np.column_stack([np.ones(40), rng.uniform(1.0, 3.0, 40)])
    theta = measured.fitted(sums, sums @ np.array([0.3, 0.2]))
    np.testing.assert_allclose(theta, [0.3, 0.2], atol=0.01)  # the prior is worth a hundredth


def test_parameters_of_other_persons_do_not_know_the_person() -> None:
    walk = next(iter(simulated_walks(1)))
    others = [replace(walk, person="B", true_m=2 * walk.true_m), replace(walk, person="C", true_m=2 * walk.true_m)]
    rest = measured.without_the_person([walk, *others])
    assert [w.person for w in rest(walk)] == ["B", "C"]
    assert measured.errors_percent([walk], "M6", rest) == pytest.approx(
        measured.errors_percent([replace(walk, true_m=7.0)], "M6", lambda _: others) * 7.0 / walk.true_m
        + 100 * (7.0 / walk.true_m - 1.0)
    )


def simulated_walks(n: int) -> list[measured.Walk]:
    found = [measured.walk_of(measured.followed(measured.simulated(k, "walking", 15.0))) for k in range(1, n + 1)]
    return [w for w in found if w is not None]


@pytest.mark.recordings
def test_strides_of_real_feet_are_found_better_than_by_levi_and_judd(data_dir: Path) -> None:
    found = [measured.counted_on_foot(read(path)) for path in sorted((data_dir / "pyshoe").glob("*.zip"))[1:12:4]]
    ours, theirs = (
        np.mean([measured.success_percent(getattr(c, name)) for c in found]) for name in ("ours", "levi_judd")
    )
    assert len(found) == 3
    assert 90.0 < ours <= 100.0
    assert ours >= theirs
