"""One real walk with a fault each: how far its track leads from that without, and what it says.

usage: python -m tests.benchmarks.broken_recordings [--data ../shared/data] [--print]

"Off" is the largest distance between the two tracks at the steps of the undisturbed one, with the largest standard
deviation that the disturbed one claims. *Before* is the version before samples, fixes and pressure had one clock, and
sensors a watchdog.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

import pdr_filter as pdr
from pdr_filter.values import Fix, FloatArray, PositionFix
from pdr_filter.values.recording import Recording, Samples
from tests.benchmarks.common import Tables, run

DAY_S, YEARS_S = 86400.0, 3 * 365 * 86400.0


@dataclass(frozen=True)
class Walk:
    """The undisturbed recording and its track."""

    recording: Recording
    track: pdr.Track

    def of(self, found: pdr.Track) -> list[object]:
        """Steps, how far off with the standard deviation claimed, and the notes that the undisturbed track lacks."""
        if found.n_steps < 2:
            return [found.n_steps, "-", said(found.notes, self.track.notes)]
        at = np.column_stack([np.interp(self.track.time_s, found.time_s, found.position_m[:, k]) for k in (0, 1)])
        off_m = np.linalg.norm(at - self.track.position_m, axis=1).max()
        std_m = np.sqrt(0.5 * found.position_cov_m2.trace(axis1=1, axis2=2).max())
        return [found.n_steps, f"{off_m:.1f} ({std_m:.0f})", said(found.notes, self.track.notes)]

    def with_times(self, change: Callable[[FloatArray], FloatArray]) -> Recording:
        streams = {name: Samples(change(s.time_s), s.values) for name, s in self.recording.streams.items()}
        return replace(self.recording, **streams)

    def with_values(self, name: str, change: Callable[[FloatArray], None]) -> Recording:
        stream = self.recording.streams[name]
        values = stream.values.copy()
        change(values)
        return replace(self.recording, **{name: Samples(stream.time_s, values)})

    def online(self, change: Callable[[FloatArray], FloatArray]) -> list[object]:
        """The same pushed in blocks of a second, with other times: steps, and what was said; times tell no distance."""
        block = pdr.merge_streams(self.recording)
        time_s, online, n_steps = change(block.time_s.copy()), pdr.OnlineFilter(), 0
        for start in range(0, len(time_s), 100):
            part = slice(start, start + 100)
            values = (block.specific_force_mps2[part], block.angular_rate_radps[part], block.magnetic_field_ut[part])
            try:
                n_steps += len(online.push(time_s[part], *values))
            except ValueError as error:
                return ["-", "-", f"refused: {said([str(error)], ())}"]
        return [n_steps + len(online.finish()), "-", said(online.notes, self.track.notes)]


def said(notes: Sequence[str], without: Sequence[str]) -> str:
    """The first note of each kind that the undisturbed track does not have, shortened."""
    new = [note for note in notes if note not in without]
    return "; ".join(note[:110] + ("..." if len(note) > 110 else "") for note in new[:2]) or "nothing"


def set_back(time_s: FloatArray, by_s: float) -> FloatArray:
    half_s = 0.5 * (time_s[0] + time_s[-1])
    return np.where(time_s >= half_s, time_s - by_s, time_s)


def ahead(time_s: FloatArray, by_s: float) -> FloatArray:
    """Two samples in the middle."""
    time_s = time_s.copy()
    middle = len(time_s) // 2
    time_s[middle : middle + 2] += by_s
    return time_s


def stuck(axis: int) -> Callable[[FloatArray], None]:
    """From the first third on."""

    def change(values: FloatArray) -> None:
        values[len(values) // 3 :, axis] = values[len(values) // 3, axis]

    return change


def impacts(values: FloatArray) -> None:
    """150 of 39 g and 20 ms."""
    for k in np.random.default_rng(0).integers(0, len(values) - 8, 150):
        part = values[k : k + 8]
        values[k : k + 8] = 39 * 9.81 * part / np.linalg.norm(part, axis=1, keepdims=True)


def with_fixes(walk: Walk, change: Callable[[FloatArray], FloatArray]) -> list[object]:
    """Every second step a fix of 1 m, all streams and fixes with other times."""
    fixes: list[Fix] = [
        PositionFix(float(change_one(change, walk, t)), place, np.eye(2))
        for t, place in zip(walk.track.time_s[2::2], walk.track.position_m[2::2], strict=True)
    ]
    found = pdr.track(walk.with_times(change), fixes=fixes)
    steps, off, note = walk.of(found)
    return [f"{steps}; {sum(fix.accepted for fix in found.fixes)} of {len(fixes)} fixes used", off, note]


RIDE_S, RIDE_M, FIX_STD_M = 600.0, np.array([4000.0, 2600.0]), 3.0


def by_bus(walk: Walk) -> list[object]:
    """After a fifth of the walk ten minutes in a bus, without steps and fixes; before and after one a second."""
    rng, ride_s = np.random.default_rng(0), float(np.quantile(walk.recording.accelerometer.time_s, 0.2))
    streams: dict[str, Samples] = {}
    for name, shaking in (("accelerometer", 0.3), ("gyroscope", 0.005)):
        stream = walk.recording.streams[name]
        before, n = stream.time_s < ride_s, int(100 * RIDE_S)
        sitting = stream.values[before].mean(axis=0) if name == "accelerometer" else np.zeros(3)
        streams[name] = Samples(
            np.concatenate([stream.time_s[before], ride_s + np.arange(n) / 100, stream.time_s[~before] + RIDE_S]),
            np.vstack(
                [stream.values[before], sitting + rng.normal(scale=shaking, size=(n, 3)), stream.values[~before]]
            ),
        )
    ridden = replace(walk.recording, **streams, magnetometer=None)
    time_s, place_m = walk.track.time_s, walk.track.position_m
    at_s = np.arange(time_s[0], time_s[-1])
    there = np.column_stack([np.interp(at_s, time_s, place_m[:, k]) for k in (0, 1)])
    there = there + (at_s > ride_s)[:, None] * RIDE_M + rng.normal(scale=FIX_STD_M, size=there.shape)
    fixes = [
        PositionFix(float(t + RIDE_S * (t > ride_s)), place, FIX_STD_M**2 * np.eye(2))
        for t, place in zip(at_s, there, strict=True)
    ]
    found = pdr.track(ridden, fixes=fixes)
    later = [fix.accepted for fix in found.fixes if fix.time_s > ride_s + RIDE_S]
    off_m = np.linalg.norm(found.position_m[-1] - place_m[-1] - RIDE_M)
    std_m = np.sqrt(0.5 * found.position_cov_m2[-1].trace())
    steps = f"{found.n_steps}; {sum(later)} of {len(later)} fixes behind it used"
    return [steps, f"{off_m:.1f} at the end ({std_m:.0f})", said(found.notes, walk.track.notes)]


def change_one(change: Callable[[FloatArray], FloatArray], walk: Walk, t: float) -> float:
    """What a clock that was changed shows at a time."""
    time_s = walk.recording.accelerometer.time_s
    return float(np.interp(t, time_s, change(time_s))) if change(time_s)[-1] != time_s[-1] else t


def turntable() -> list[object]:
    """A minute on a table that turns by 0.05 rad/s."""
    rng = np.random.default_rng(0)
    online, n = pdr.OnlineFilter(), 6000
    force = np.array([0.0, 0.0, 9.81]) + rng.normal(scale=0.02, size=(n, 3))
    online.push(np.arange(n) / 100, force, np.array([0.0, 0.0, 0.05]) + rng.normal(scale=0.002, size=(n, 3)))
    device = online.device
    assert device is not None
    std = np.sqrt(device.bias_cov_radps2[2, 2])
    return ["-", "-", f"bias {device.bias_radps[2]:.4f}, standard deviation {std:.4f} rad/s"]


def many_fixes() -> list[object]:
    """10,000 fixes given at once."""
    online = pdr.OnlineFilter()
    begin_s = time.process_time()
    for k in range(10_000):
        online.add_fix(PositionFix(0.01 * k, np.zeros(2), np.eye(2)))
    return ["-", "-", f"{time.process_time() - begin_s:.1f} s"]


def faults(tables: Tables, arguments: argparse.Namespace) -> None:
    """One walk with a fault each."""
    recording = pdr.read(arguments.data / "humolire" / "humolire_user1_3r.zip")
    walk = Walk(recording, pdr.track(recording))
    rows: list[list[object]] = [
        ["no fault", "-", *walk.of(walk.track)],
        ["clock set back by 30 s", "122 m off", *walk.of(pdr.track(walk.with_times(lambda t: set_back(t, 30.0))))],
        [
            "times floored to 20 ms, set back by an hour",
            "150 steps",
            *walk.online(lambda t: set_back(np.floor(t * 50) / 50, 3600.0)),
        ],
        [
            "packets of equal times, two samples a day ahead",
            "149 steps",
            *walk.online(lambda t: ahead(np.floor(t * 10) / 10, DAY_S)),
        ],
        ["times in ms", "0 steps, 'gaps'", *walk.online(lambda t: 1e3 * t)],
        ["times in ns", "0 steps, 'gaps'", *walk.online(lambda t: 1e9 * t)],
        [
            "times since 1970 as float32",
            "0 steps, 'gaps'",
            *walk.online(lambda t: np.float32(t + 1.7e9).astype(float)),
        ],
        ["fixes, clock set back by an hour", "74 of 147 used", *with_fixes(walk, lambda t: set_back(t, 3600.0))],
        ["fixes, two samples three years ahead", "77 of 147 used", *with_fixes(walk, lambda t: ahead(t, YEARS_S))],
        ["ten minutes in a bus without steps or fixes, then right ones", "1 of 1848 used", *by_bus(walk)],
        ["angular rate times 0", "243 m off, 54 m claimed", *walk.of(pdr.track(walk.with_values("gyroscope", zero)))],
        ["z of the gyroscope stuck", "241 m off", *walk.of(pdr.track(walk.with_values("gyroscope", stuck(2))))],
        [
            "y of the accelerometer stuck",
            "not measured",
            *walk.of(pdr.track(walk.with_values("accelerometer", stuck(1)))),
        ],
        [
            "150 impacts of 39 g",
            "a third of the distance lost",
            *walk.of(pdr.track(walk.with_values("accelerometer", impacts))),
        ],
        ["on a turntable, 0.05 rad/s", "bias 0.0500, 0.0005 rad/s", *turntable()],
        ["10,000 fixes at once", "155 s", *many_fixes()],
    ]
    columns = ["fault", "before", "steps", "off, m (standard deviation)", "notes, or refusal"]
    tables.write("broken_recordings", columns, rows, "One walk of humolire with a fault each.")


def zero(values: FloatArray) -> None:
    values[:] = 0.0


if __name__ == "__main__":
    run(__doc__, faults)
