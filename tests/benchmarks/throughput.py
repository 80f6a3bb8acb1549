"""How fast the whole pipeline is: an hour of 100 Hz data at once, and the cost of one pushed block of 0.1 s.

usage: python -m tests.benchmarks.throughput [--hours 1]

The hour is the embedded simulated walk repeated in time. One core: BLAS threads are set to one.
"""

from __future__ import annotations

import time

import numpy as np

import pdr_filter as pdr
from pdr_filter.recipes import default
from pdr_filter.sensing.features.windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.values import Samples
from tests.benchmarks.common import Tables, options


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
    parser = options(__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    args = parser.parse_args()
    recording, rows = long_walk(args.hours), []
    pdr.track(pdr.simulate.demo_walk())  # loads models, fills caches
    for weighting in ("imm", "wc", "hc"):
        best = np.inf
        for _ in range(3):
            start = time.perf_counter()
            track = pdr.track(recording, weighting=weighting)
            best = min(best, time.perf_counter() - start)
        times = recording.duration_s / best
        rows.append([f"an hour, `{weighting}`, {track.n_steps} steps", f"{best:.1f} s, {times:.0f} times real time"])
    best, n_windows = min(features_s(recording) for _ in range(3))
    rows.append([f"{len(ATTITUDE_FREE.names)} features of its {n_windows} windows", f"{best:.2f} s"])
    block = pdr.merge_streams(recording)
    online = pdr.OnlineFilter()
    cost: list[float] = []
    for i in range(0, min(len(block.time_s), 60_000), 10):
        part = slice(i, i + 10)
        start = time.perf_counter()
        online.push(block.time_s[part], block.specific_force_mps2[part], block.angular_rate_radps[part])
        cost.append(1e3 * (time.perf_counter() - start))
    high = np.percentile(cost, 99)
    rows.append(["one pushed block of 0.1 s", f"mean {np.mean(cost):.2f} ms, 99th percentile {high:.1f} ms"])
    blob = online.save()
    start = time.perf_counter()
    pdr.OnlineFilter.load(blob)
    loaded_ms = 1e3 * (time.perf_counter() - start)
    rows.append(["a saved filter, models included", f"{len(blob) / 1e3:.0f} kB, loaded in {loaded_ms:.0f} ms"])
    Tables.of(__spec__.name, args).write("throughput", ["what", "result"], rows, "One core.")


if __name__ == "__main__":
    main()
