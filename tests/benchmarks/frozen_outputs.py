"""Hashes of everything that the package computes, to show that a change of the code does not change a bit.

usage: python -m tests.benchmarks.frozen_outputs [--out FILE.json] [--data ../shared/data]
       python -m tests.benchmarks.frozen_outputs --compare BEFORE.json AFTER.json

Write one file before a change and one after it, on the same machine with the same libraries, and compare them. Only
public names are used, so that the script runs on both. A hash covers the bytes of every array and every number, and no
name of a class or module. It takes about two minutes on one core.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import pdr_filter as pdr
from tests.data_folder import DATA

WEIGHTINGS = ("imm", "wc", "hc")
RECIPES = ("default", "martinelli2018", "guo2018", "susi2013", "tian2016", "zhou2019")
BLOCKS = (7, 37, 1000)  # samples in one push
PLANS = {  # recordings, and the plan on which the first of them was walked
    "ms_indoor/*_site1_f1_*.zip": "ms_indoor_site1_F1.geojson",
    "humolire/*.zip": "humolire.geojson",
}
N_OF_EACH = 2  # recordings of each data set


# Class and name of fields that did not exist when the outputs to compare with were written.
_NEW_FIELDS = {("Windows", "standing_contexts"), ("StepUpdate", "contexts")}


def digest(value: object) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of a value made of arrays, numbers, texts and dataclasses."""
    state = hashlib.sha256()
    _feed(state.update, value)
    return state.hexdigest()[:16]


def _feed(update: Callable[[bytes], None], value: object) -> None:
    if isinstance(value, np.ndarray) and value.dtype.names:
        for name in value.dtype.names:
            _feed(update, name)
            _feed(update, np.asarray(value[name]))
    elif isinstance(value, np.ndarray) and value.dtype.hasobject:
        _feed(update, value.tolist())
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        update(f"array {array.dtype.str} {array.shape}".encode() + array.tobytes())
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _feed(update, key)
            _feed(update, item)
    elif isinstance(value, list | tuple):
        update(f"sequence {len(value)}".encode())
        for item in value:
            _feed(update, item)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            if (type(value).__name__, field.name) not in _NEW_FIELDS:
                _feed(update, getattr(value, field.name))
    elif value is None or isinstance(value, str | bytes | bool | int | float):
        update(repr(value).encode())
    else:
        raise TypeError(f"a {type(value).__name__} has no frozen form")


# The fields of a track that hold results; `plan` is an input, and `source` of a recording a path.
_NOT_FROZEN = ("plan",)


def track_digest(track: pdr.Track) -> str:
    """Return the digest of all results in a track."""
    return digest([getattr(track, field.name) for field in fields(track) if field.name not in _NOT_FROZEN])


def recordings(data: Path) -> Iterator[tuple[str, pdr.Recording]]:
    """Yield name and recording: the smallest ones of each data set, and one from its middle."""
    for folder in sorted(path for path in data.iterdir() if path.is_dir()):
        paths = sorted(folder.glob("*.zip"), key=lambda path: (path.stat().st_size, path.name))
        for path in dict.fromkeys((*paths[: N_OF_EACH - 1], *paths[len(paths) // 2 :][:1])):
            yield f"{folder.name}/{path.stem}", pdr.read(path)


Outputs = Iterator[tuple[str, Callable[[], str]]]


def outputs(data: Path) -> Outputs:
    """Yield the name of each frozen output and the function that computes its digest."""
    every = dict(recordings(data))
    walk = pdr.simulate.demo_walk()
    yield "simulated walk", lambda: digest([walk.streams, walk.truth])
    for name, recording in every.items():
        yield f"reading of {name}", lambda r=recording: digest([r.streams, r.truth, r.wifi, r.notes])
        yield f"track of {name}", lambda r=recording: track_digest(pdr.track(r))
    chosen = {name: r for name, r in every.items() if name.startswith(("ubicomp13", "difronzo", "mobgap"))}
    for name, recording in {"demo": walk, **chosen}.items():
        yield f"steps of {name}", lambda r=recording: digest(pdr.detect_steps(r))
        yield f"windows of {name}", lambda r=recording: digest(pdr.classify(r))
        for recipe in RECIPES:
            yield f"recipe {recipe} of {name}", partial(_of_recipe, recording, recipe)
        for weighting in WEIGHTINGS:
            yield f"weighting {weighting} of {name}", partial(_of_weighting, recording, weighting)
    for n in BLOCKS:
        yield f"online in blocks of {n}", partial(_online, walk, n)
    yield "online by sensors, saved in the middle", partial(_online_by_sensors, walk)
    for name, fixes in kinds_of_fixes().items():
        yield f"fixes: {name}", lambda f=fixes: track_digest(pdr.track(walk, fixes=f))
        yield f"smoothing with fixes: {name}", lambda f=fixes: _smoothed(walk, fixes=f)
    yield "smoothing", partial(_smoothed, walk)
    yield "smoothing of a recipe", lambda: _smoothed(walk, config=pdr.recipes.martinelli2018())
    yield from outputs_of_places(every)
    simulated = [pdr.simulate.demo_walk(seed) for seed in range(3)]
    with_segments = [r for r in every.values() if r.truth.segments is not None and not r.is_on_foot][:8]
    yield "calibration of simulated walks", partial(_calibrated, simulated)
    yield "calibration of recordings", partial(_calibrated, with_segments)
    yield "track with a calibration", lambda: track_digest(pdr.track(walk, calibration=pdr.calibrate(simulated)))
    for pattern, plan in PLANS.items():
        yield from outputs_on_plan(sorted(data.glob(pattern))[0], data / "maps" / plan)


def outputs_of_places(every: Mapping[str, pdr.Recording]) -> Outputs:
    """Yield the outputs of recordings with locations or waypoints."""
    for name, recording in [(name, r) for name, r in every.items() if r.location is not None][:3]:
        for gnss in ("filter", "align", "off"):
            yield f"gnss {gnss} of {name}", lambda r=recording, g=gnss: track_digest(pdr.track(r, gnss=g))
    for name, recording in every.items():
        if recording.truth.waypoints is not None:
            yield f"smoothing between waypoints of {name}", lambda r=recording: _smoothed(r, fixes=waypoints(r))


def outputs_on_plan(path: Path, plan_path: Path) -> Outputs:
    """Yield the outputs of one recording on a floor plan."""
    recording, plan = pdr.read(path), pdr.FloorPlan.read(plan_path)
    fixes = waypoints(recording)[:3]
    yield f"plan, track of {path.stem}", lambda: track_digest(pdr.track(recording, fixes=fixes, plan=plan))
    yield f"plan, smoothing of {path.stem}", lambda: _smoothed(recording, fixes=fixes, plan=plan)


def kinds_of_fixes() -> dict[str, list[Any]]:
    """Return fixes of each kind for the demo walk."""
    cov = np.eye(2)
    places = [(20.0, 0.0, 14.0), (40.0, 12.0, 30.0), (60.0, 30.0, 31.0), (80.0, 31.0, 20.0)]
    return {
        "positions": [pdr.PositionFix(t, np.array([east, north]), cov) for t, east, north in places],
        "late positions": [pdr.PositionFix(t, np.array([e, n]), cov, received_time_s=t + 3.0) for t, e, n in places],
        "headings": [pdr.HeadingFix(t, 0.3, 0.2) for t in (15.0, 45.0)],
        "speeds": [pdr.SpeedFix(t, 1.3, 0.1) for t in (15.0, 20.0, 45.0)],
    }


def waypoints(recording: pdr.Recording) -> list[pdr.PositionFix]:
    """Return the waypoints of a recording as fixes of half a metre."""
    rows = recording.truth.waypoints
    times = [] if rows is None else np.maximum.accumulate(rows.time_s)
    places = [] if rows is None else zip(rows.east_m, rows.north_m, strict=True)
    return [
        pdr.PositionFix(max(float(t), 0.0), np.array(place), 0.25 * np.eye(2))
        for t, place in zip(times, places, strict=True)
    ]


def _of_recipe(recording: pdr.Recording, recipe: str) -> str:
    return track_digest(pdr.track(recording, config=getattr(pdr.recipes, recipe)(recording.subject)))


def _of_weighting(recording: pdr.Recording, weighting: str) -> str:
    return track_digest(pdr.track(recording, weighting=weighting))


def _online(recording: pdr.Recording, n: int) -> str:
    samples, online = pdr.merge_streams(recording), pdr.OnlineFilter()
    updates: list[Any] = []
    for i in range(0, len(samples.time_s), n):
        part = slice(i, i + n)
        updates += online.push(
            samples.time_s[part], samples.specific_force_mps2[part], samples.angular_rate_radps[part]
        )
    updates += online.finish()
    return digest([_of_update(update) for update in updates])


def _online_by_sensors(recording: pdr.Recording) -> str:
    online, gyroscope = pdr.OnlineFilter(), recording.gyroscope or recording.accelerometer
    updates: list[Any] = []
    end_s = recording.duration_s
    for begin_s in np.arange(0.0, end_s + 1.0, 0.5):
        for push, samples in (
            (online.push_accelerometer, recording.accelerometer),
            (online.push_gyroscope, gyroscope),
        ):
            part = (samples.time_s >= begin_s) & (samples.time_s < begin_s + 0.5)
            updates += push(samples.time_s[part], samples.values[part])
        if begin_s == 50.0:
            online = pdr.OnlineFilter.load(online.save())
    updates += online.finish()
    return digest([_of_update(update) for update in updates])


def _of_update(update: Any) -> list[Any]:
    return [update.step, update.position_m, update.position_cov_m2, update.mode_prob, update.step_length_m]


def _smoothed(recording: pdr.Recording, **options: Any) -> str:
    smoothed = pdr.smooth(recording, **options)
    rest = [getattr(smoothed, f.name) for f in fields(smoothed) if f.name != "track"]
    return digest([track_digest(smoothed.track), rest])


def _calibrated(walks: list[pdr.Recording]) -> str:
    calibration = pdr.calibrate(walks)
    known = {name: [person.k, person.k_cov] for name, person in calibration.subjects.items()}
    return digest([calibration.k, calibration.k_cov, calibration.residual_std_m, known])


def frozen(data: Path) -> dict[str, str]:
    """Return the digest of each output by its name; of an output that raises ValueError, that of the message."""
    result: dict[str, str] = {}
    for name, compute in outputs(data):
        begin_s = time.perf_counter()
        try:
            result[name] = compute()
        except ValueError as error:
            result[name] = f"ValueError {digest(str(error))}"
        print(f"{time.perf_counter() - begin_s:6.2f} s  {result[name]}  {name}", flush=True)
    return result


def compare(before: Mapping[str, str], after: Mapping[str, str]) -> int:
    """Print the outputs that differ or exist on one side only, and return their number."""
    differing = [name for name in {**before, **after} if before.get(name) != after.get(name)]
    for name in differing:
        print(f"{name}: {before.get(name, 'missing')} before, {after.get(name, 'missing')} after")
    print(f"{len(before.keys() & after.keys())} outputs compared, {len(differing)} differ")
    return len(differing)


def main() -> None:
    """Write the digests, or compare two files of them; exit code 1 if they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    options = parser.parse_args()
    if options.compare:
        before, after = (json.loads(path.read_text()) for path in options.compare)
        raise SystemExit(compare(before, after) > 0)
    result = frozen(options.data)
    print(f"{len(result)} outputs, {sum(v.startswith('ValueError') for v in result.values())} of them refusals")
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
