"""Slow walks: how many of their steps the default finds. No public phone recordings of slow gait with steps exist.

    python -m tests.benchmarks.slow_gait [--data ../shared/data]

Walks of many people are slowed down: the same motion c times as slowly. The gravity that the phone feels, from the
attitude of the whole recording, turns c times as slowly; the rest of the force is c times as slow and c^2 times as weak
(the same path of the phone, steps as long as before), or c^3 times: as the law of docs/methods/steps.md has it for
people who walk slowly, whose steps are shorter and softer. The true steps are those that the detector finds at the
pace at which the person walked, within the walk. The share of them that is found is within 0.35 of a step interval,
after a constant offset. No slow walk was used in a fit; ubicomp13 and motionsense are judged by the weights without the
people in question, as in step_gate.py; nobody of the other three was in it but that of humolire.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.values import STANDARD_GRAVITY_MPS2, Samples
from tests.benchmarks.common import Tables, options, recordings
from tests.benchmarks.step_gate import MASS, Found, find, fit, through_gate, truth

FloatArray = NDArray[np.float64]

SETS = ("ubicomp13", "motionsense", "humolire", "oxiod", "ipol")
# Neither running nor sitting, and the phone goes where the person goes.
LEFT_OUT = ("_jog_", "_sit_", "_std_", "running", "trolley")
STEPS_PER_S = (0.75, 0.85, 0.95, 1.05)
EXPONENTS = (2, 3)


def steps_of_walk(found: Found) -> FloatArray:
    """The detector's steps while the person walked."""
    time_s = found.time_s
    if found.data_set == "ipol":
        contacts_s = np.asarray(found.recording.truth.steps.time_s)
        return time_s[(time_s > contacts_s[0] - 0.2) & (time_s < contacts_s[-1] + 0.2)]
    if found.data_set == "oxiod":
        return time_s
    return time_s[[truth(found, t) is True for t in time_s]]


def slowed(recording: pdr.Recording, factor: float, exponent: int) -> pdr.Recording:
    """The same motion `factor` times as slowly, from time 0; its accelerometer alone."""
    _, blocks = Conditioner().update(Conditioner().init(), merge_streams(recording))
    estimator = AttitudeEstimator()
    state, ups = estimator.init(), []
    for block in blocks:
        state, attitude = estimator.update(state, block)
        ups.append(attitude.up_sensor)
    old_s = np.concatenate([block.time_s for block in blocks])
    gravity = STANDARD_GRAVITY_MPS2 * np.concatenate(ups)
    motion = np.concatenate([block.specific_force_mps2 for block in blocks]) - gravity
    time_s = 0.01 * np.arange(int(100 * factor * (old_s[-1] - old_s[0])))
    force = gravity + motion / factor**exponent
    at_s = old_s[0] + time_s / factor
    values = np.column_stack([np.interp(at_s, old_s, force[:, k]) for k in range(3)])
    return replace(recording, accelerometer=Samples(time_s, values), gyroscope=None, magnetometer=None)


def share_found(true_s: FloatArray, found_s: FloatArray, interval_s: float) -> float:
    """Share of the true steps with one that was found, after a constant offset."""
    if not len(found_s):
        return 0.0
    offsets_s = np.arange(-0.5, 0.51, 0.05) * interval_s
    miss_s = np.abs((found_s - offsets_s[:, None])[:, :, None] - true_s).min(axis=1)
    best = (miss_s < 0.25 * interval_s).mean(axis=1).argmax()
    return float((miss_s[best] < 0.35 * interval_s).mean())


def shares(found: Found, gate: StepGate) -> dict[tuple[int, float], float]:
    """Share of steps found by exponent and pace; empty where nobody walked."""
    true_s = steps_of_walk(found)
    if len(true_s) < 15 or any(name in found.recording.name for name in LEFT_OUT):
        return {}
    start_s, pace = found.segments[0][0][0].time_s[0], 1.0 / float(np.median(np.diff(true_s)))
    result: dict[tuple[int, float], float] = {}
    for exponent in EXPONENTS:
        for wanted in STEPS_PER_S:
            slow = find(slowed(found.recording, pace / wanted, exponent))
            found_s = np.array([s.time_s for s in through_gate(slow, gate)])
            result[exponent, wanted] = share_found((true_s - start_s) * pace / wanted, found_s, 1.0 / wanted)
    return result


def row(name: str, walks: Sequence[dict[tuple[int, float], float]]) -> list[object]:
    return [name, len(walks), *(f"{100 * np.mean([w[key] for w in walks]):.1f}" for key in walks[0])]


def main() -> None:
    args = options(__doc__).parse_args()
    sets = {name: [find(r) for r in recordings(args.data, name)] for name in {n for n, _ in MASS} | set(SETS)}
    fitted = [f for name in {n for n, _ in MASS} for f in sets[name]]
    gates = [StepGate(evidence=fit([f for f in fitted if f.person == 0 or f.person % 2 != k])) for k in (0, 1)]
    walks: dict[str, list[dict[tuple[int, float], float]]] = defaultdict(list)
    for name in SETS:
        for found in sets[name]:
            if by_pace := shares(found, gates[found.person % 2]):
                walks[name].append(by_pace)
    columns = [f"{pace} steps/s, c^{exponent}" for exponent in EXPONENTS for pace in STEPS_PER_S]
    about = "Steps found in %, walks slowed down c times, the motion's force c^2 or c^3 times weaker; people left out."
    rows = [row(name, walks[name]) for name in SETS]
    Tables.of(__spec__.name, args).write("steps_slow", ["", "walks", *columns], rows, about)


if __name__ == "__main__":
    main()
