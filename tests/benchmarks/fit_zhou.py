"""Parameters of Zhou's two-segment model M7 for the `zhou2019` recipe; the paper prints none.

usage: python -m tests.benchmarks.fit_zhou [--data ../shared/data]

Carried phone: by displacement on the legs of humolire and ms_indoor, as in step_length_models.py, with the steps of the
recipe's own detector. Foot: on pyshoe, the sum of the step lengths of each trial against the way of the foot between
its stances (motion capture); every other trial is left out and scored.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.recipes.zhou2019 import contexts as behaviours
from pdr_filter.recipes.zhou2019 import steps as steps
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Step
from tests.benchmarks.common import options, paths
from tests.benchmarks.step_length_models import MODELS, Leg, displacement, fit, legs_between_landmarks, summed


def detected(recording: pdr.Recording, on_foot: bool) -> list[Step]:
    """Steps of the recipe's detector."""
    thresholds, detector = (behaviours.FOOT, steps.FOOT) if on_foot else (behaviours.CARRIED, steps.CARRIED)
    sensing = Sensing(contexts=behaviours.BehaviourStage(thresholds=thresholds), steps=detector)
    return [event for event in run_sensing(sensing, recording)[1] if isinstance(event, Step)]


def way_of_the_foot_m(recording: pdr.Recording) -> float:
    """Sum of the distances between the places where the foot stands."""
    truth = recording.truth.position
    place = np.column_stack([truth.east_m, truth.north_m])
    grid_s = np.arange(truth.time_s[0], truth.time_s[-1], 0.01)
    at = np.column_stack([np.interp(grid_s, truth.time_s, p) for p in place.T])
    smooth = np.column_stack([np.convolve(np.pad(p, 4, mode="edge"), np.hanning(9) / 4, "valid") for p in at.T])
    stands = np.linalg.norm(np.gradient(smooth, 0.01, axis=0), axis=1) < 0.35
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands, [0]]).astype(int))).reshape(-1, 2)
    stances = [smooth[a:b].mean(axis=0) for a, b in edges if b - a >= 6]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(stances)))


def trial(path: Path) -> Leg:
    """A whole trial as one leg."""
    recording = pdr.read(path)
    found = tuple(detected(recording, on_foot=True))
    return Leg(
        "pyshoe", path.stem, 1.75, way_of_the_foot_m(recording), found, np.ones(len(found)), np.zeros(len(found))
    )


def main() -> None:
    data = options(__doc__).parse_args().data
    m7, kim = MODELS["M7 k0 + k1/f + k2/sqrt f + k3 max"], MODELS["M6, Kim k cbrt(mean abs)"]

    trials = [trial(p) for p in paths(data, "pyshoe")]
    trials = [t for t in trials if len(t.steps) > 4]
    for name, model in (("M7", m7), ("M1", MODELS["M1 k0 + k1 f"]), ("Kim", kim)):
        theta = fit(model, trials[::2], summed)
        error = np.array([100 * (summed(model(1.75), t, theta)[0] / t.distance_m - 1) for t in trials[1::2]])
        print(
            f"foot, {name}: theta {np.round(theta, 4)}; {len(error)} trials left out: bias {error.mean():+.1f} %, "
            f"spread {error.std():.1f} %; all trials: theta {np.round(fit(model, trials, summed), 4)}"
        )

    legs = [
        leg
        for site in ("humolire", "ms_indoor")
        for path in paths(data, site)
        for leg in legs_between_landmarks(path, lambda recording: detected(recording, on_foot=False))
    ]
    for name, model in (("M7", m7), ("Kim", kim)):
        theta = fit(model, legs, displacement)
        print(f"carried, {name}: theta {np.round(theta, 4)} ({len(legs)} legs)")


if __name__ == "__main__":
    main()
