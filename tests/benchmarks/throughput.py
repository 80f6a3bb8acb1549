"""How fast the whole pipeline is: an hour of 100 Hz data at once, and the cost of one pushed block of 0.1 s.

usage: .venv/bin/python tests/benchmarks/throughput.py [--hours 1]

The hour is the embedded simulated walk repeated in time. One core: BLAS threads are set to one.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import pdr_filter as pdr
from pdr_filter.recipes import default
from pdr_filter.sensing.features.windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.values.samples import Samples


def long_walk(hours: float) -> pdr.Recording:
    """The demo walk again and again, at 100 Hz."""
    walk = pdr.simulate.demo_walk()
    period_s = walk.duration_s + 0.01
    n = int(np.ceil(hours * 3600 / period_s))

    def repeat(stream: Samples | None) -> Samples | None:
        if stream is None:
            return None
        time_s = (stream.time_s[None, :] + period_s * np.arange(n)[:, None]).ravel()
        return Samples(time_s, np.tile(stream.values, (n, 1)))

    return pdr.Recording(
        name="long",
        accelerometer=repeat(walk.accelerometer),
        gyroscope=repeat(walk.gyroscope),  # type: ignore[arg-type]
    )


def features_s(recording: pdr.Recording) -> tuple[float, int]:
    """Time of all features of a recording, the signals given, and the number of windows."""
    sensing, stage = default().sensing, FeatureWindows(features=ATTITUDE_FREE)
    _, uniform = sensing.conditioner.step(sensing.conditioner.init(), pdr.merge_streams(recording))
    state, parts = sensing.attitude.init(), []
    for part in uniform:
        state, attitude = sensing.attitude.step(state, part)
        parts.append((part, attitude))
    start, n, windows = time.perf_counter(), 0, stage.init()
    for part, attitude in parts:
        windows, found = stage.step(windows, part, attitude)
        n += len(found)
    return time.perf_counter() - start, n


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=1.0)
    recording = long_walk(parser.parse_args().hours)
    pdr.track(pdr.simulate.demo_walk())  # loads models, fills caches
    for weighting in ("imm", "wc", "hc"):
        best = np.inf
        for _ in range(3):
            start = time.perf_counter()
            track = pdr.track(recording, weighting=weighting)
            best = min(best, time.perf_counter() - start)
        print(
            f"{weighting}: {recording.duration_s:.0f} s of data, {track.n_steps} steps, in {best:.2f} s: "
            f"{recording.duration_s / best:.0f} times real time"
        )
    best, n_windows = min(features_s(recording) for _ in range(3))
    print(f"all {len(ATTITUDE_FREE.names)} features of {n_windows} windows: {best:.2f} s")
    block = pdr.merge_streams(recording)
    online = pdr.OnlineFilter()
    cost: list[float] = []
    for i in range(0, min(len(block.time_s), 60_000), 10):
        part = slice(i, i + 10)
        start = time.perf_counter()
        online.push(block.time_s[part], block.specific_force_mps2[part], block.angular_rate_radps[part])
        cost.append(1e3 * (time.perf_counter() - start))
    high = np.percentile(cost, 99)
    print(f"one pushed 0.1 s block: mean {np.mean(cost):.3f} ms, 99th percentile {high:.3f} ms, n = {len(cost)}")
    blob = online.save()
    start = time.perf_counter()
    pdr.OnlineFilter.load(blob)
    print(f"saved filter: {len(blob) / 1e3:.0f} kB, loaded in {1e3 * (time.perf_counter() - start):.0f} ms")


if __name__ == "__main__":
    main()
