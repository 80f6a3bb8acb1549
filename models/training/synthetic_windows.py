"""Synthetic windows for people who were not recorded, and the weights of their sources.

The licensed recordings contain calling, swinging and the back pocket of one person each. Missing windows are simulated,
or made from real ones. Windows made from a recording are held out together with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from zlib import crc32

import numpy as np
from scipy.spatial.transform import Rotation

from models.training.sine_people import EAR_PITCH_RAD, EAR_ROLL_RAD, MODES, simulated_person
from pdr_filter.data.io.formats import read
from pdr_filter.offline.training.cross_validation import LabelledWindows, Progress, TextArray, in_parallel, source_of
from pdr_filter.values import BoolArray, FloatArray
from pdr_filter.values.recording import Recording

R = TypeVar("R")
SIMULATED, TURNED = "simulated", "turned"
# Path of a recording, or carrying mode and number of a simulated person.
Source = Path | tuple[str, int]


def from_sources(
    work: Callable[[Recording, str, str], R], paths: Sequence[Path], n_simulated: int, what: str, progress: Progress
) -> list[R]:
    """Return the results of `work` for all recordings, followed by `n_simulated` people in each carrying mode.

    `work` receives the recording, its data set or "simulated", and its person.
    """
    jobs: list[Source] = [*paths, *((mode, number) for number in range(n_simulated) for mode in MODES)]
    results: list[R] = []
    for job, result in zip(jobs, in_parallel(partial(_on_source, work), jobs), strict=True):
        results.append(result)
        name = job.stem if isinstance(job, Path) else f"a simulated person, {job[0]}"
        progress(f"{what} of {name}", len(results) / len(jobs))
    return results


def _on_source(work: Callable[[Recording, str, str], R], source: Source) -> R:
    """Return the result of `work` for one recording or simulated person."""
    if isinstance(source, Path):
        recording = read(source)
        return work(recording, *source_of(recording))
    recording = simulated_person(*source)
    return work(recording, SIMULATED, f"{SIMULATED}/{recording.name}")


def ear_rotations(mean_up: Sequence[FloatArray], name: str) -> Iterator[FloatArray]:
    """Yield random rotations (3, 3) of the sensor axes that move a phone from in front of the body to the ear.

    `mean_up` are the mean directions of up (3,) in front of the body, one for each rotation. The random numbers depend
    on `name`.
    """
    rng = np.random.default_rng(crc32(name.encode()))
    for up in mean_up:
        level = Rotation.align_vectors([0.0, 0.0, 1.0], up / np.sqrt(up @ up))[0]
        side = rng.choice([-1.0, 1.0])
        pitch_rad, roll_rad = rng.normal(EAR_PITCH_RAD, 0.2), -side * rng.normal(EAR_ROLL_RAD, 0.25)
        yield (Rotation.from_euler("ZXY", [0.0, pitch_rad, roll_rad]).inv() * level).as_matrix()


def balanced_weight(label: TextArray, source: TextArray, source_weight: Mapping[str, float]) -> FloatArray:
    """Return weights (W,) with mean one, which give all classes the same total weight.

    Within a class, each source has the total weight `source_weight`, or one if it is not listed. `source_weight` is by
    the source's name up to the first underscore, or by the whole name.
    """
    weight = np.zeros(len(label))
    for name in np.unique(label):
        own = label == name
        for part in np.unique(source[own]):
            rows = own & (source == part)
            weight[rows] = source_weight.get(part, source_weight.get(part.split("_")[0], 1.0)) / rows.sum()
        weight[own] /= weight[own].sum()
    return weight / weight.mean()


def synthetic_card(source: TextArray, source_weight: Mapping[str, float]) -> dict[str, Any]:
    """Return the entries of a card about synthetic windows: their number by source, and the weights of the sources.

    `source` (W,) is the source of each synthetic window.
    """
    n_windows = {str(name): int((source == name).sum()) for name in np.unique(source)}
    return {"made_windows": n_windows, "source_weight": dict(source_weight)}


def windows_of_one(
    features: FloatArray,
    context: TextArray,
    carrying_mode: TextArray,
    person: str,
    dataset: str,
    recording: str,
    has_gyroscope: BoolArray,
) -> LabelledWindows:
    """Return the windows of a single recording, or synthetic windows made from it."""
    people, source, name = (np.full(len(features), text) for text in (person, dataset, recording))
    return LabelledWindows(features, context, carrying_mode, people, source, name, has_gyroscope)
