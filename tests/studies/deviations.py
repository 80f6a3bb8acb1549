"""Effects of deviations from the papers: the recipe as it is, beside the formula as printed.

usage: python -m tests.studies.deviations

Counts: mean absolute error of the steps of persons 7 to 13 of ubicomp13, on whom nothing was chosen. Transitions: of
Tian's machine over whole recordings of these persons, in which a phone in a pocket was put there once.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.recipes import for_recording
from pdr_filter.recipes.guo2018.steps import PoseStepDetector
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.recipes.tian2016.contexts import TRANS, CarryingMachine, TianContexts
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import BoolArray, FloatArray, Step
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, run
from tests.studies.data import counted_walk, paper_table, people_left_out


@dataclass(frozen=True, kw_only=True)
class UnsignedWavelet(WaveletStepDetector):
    """Steps at the maxima of |W|, as printed, instead of those of W."""

    def _response(self, line: FloatArray) -> FloatArray:
        return np.abs(super()._response(line))


@dataclass(frozen=True)
class SignedRates(CarryingMachine):
    """Transitions by r > R, as printed, instead of |r| > R."""

    def _moved(self, angular_rate_radps: FloatArray, rate_known: BoolArray) -> BoolArray:
        return super()._moved(np.maximum(angular_rate_radps, 0.0), rate_known)


@dataclass(frozen=True, kw_only=True)
class BelowMean(PoseStepDetector):
    """Maxima above mu - 0.45 sigma, as the sign of eq. 8 is printed, instead of mu + 0.45 sigma."""

    @property
    def _thresholds(self) -> tuple[float, float, float, float]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return -self.texting, -self.calling, -self.pocket, -self.swinging


def count_error(walks: Sequence[Recording], recipe: str, steps: type | None = None) -> tuple[float, float]:
    """Mean absolute count error in %, and the number of steps found, of a recipe with its or another detector."""
    errors, n_found = list[float](), 0
    for walk in walks:
        config = replace(for_recording(recipe, walk), needs=())
        sensing: Sensing = config.sensing if steps is None else replace(config.sensing, steps=steps())
        start_s, end_s, n_true = counted_walk(walk)
        found = [e for e in run_sensing(sensing, walk)[1] if isinstance(e, Step)]
        n = sum(start_s - 0.3 <= s.time_s <= end_s + 0.3 for s in found)
        errors.append(abs(float(count_error_percent(n, n_true))))
        n_found += n
    return float(np.mean(errors)), n_found


def n_transitions(walks: Sequence[Recording], machine: CarryingMachine) -> int:
    """Number of transitions that a machine finds."""
    n = 0
    for walk in walks:
        state, estimator, conditioner = machine.init(), AttitudeEstimator(), Conditioner()
        attitude_state = estimator.init()
        for block in conditioner.update(conditioner.init(), merge_streams(walk))[1]:
            attitude_state, attitude = estimator.update(attitude_state, block)
            state, modes = machine.update(state, block.angular_rate_radps, block.angular_rate_known, attitude.up_sensor)
            n += int((np.diff((modes == TRANS).astype(int)) == 1).sum())
    return n


def effects(tables: Tables, arguments: argparse.Namespace) -> None:
    """Measures as printed, and here."""
    walks = list(people_left_out(arguments.data))
    front = [w for w in walks if "hand" in w.name]
    rows: list[Mapping[str, object]] = []

    def add(recipe: str, item: str, measure: str, printed: float, here: float) -> None:
        rows.append({"recipe": recipe, "item": item, "measure": measure, "as printed": printed, "here": here})

    for recipe, item, detector, some in (
        ("martinelli2018", "maxima of the magnitude of W, here of W", UnsignedWavelet, walks),
        ("guo2018", "eq. 8 with minus, here plus", BelowMean, front),
    ):
        (printed, n_printed), (here, n_here) = count_error(some, recipe, detector), count_error(some, recipe)
        add(recipe, item, "steps, mean absolute error %", printed, here)
        add(recipe, item, "steps found", n_printed, n_here)
    machine = TianContexts().machine
    signed = SignedRates(**{f: getattr(machine, f) for f in machine.__dataclass_fields__})
    add(
        "tian2016",
        "signed rates, here absolute ones",
        "transitions",
        n_transitions(walks, signed),
        n_transitions(walks, machine),
    )
    title = "Effects of deviations from the papers"
    paper_table(tables, "deviations", title, rows, f"ubicomp13, persons 7 to 13, {len(walks)} walks")


if __name__ == "__main__":
    run(__doc__, effects)
