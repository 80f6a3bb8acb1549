"""Days on one filter: real walks, rest, gaps, broken clocks and sensors, wrong fixes, and a restart now and then.

usage: python -m tests.benchmarks.soak [--hours 48] [--seed 0] [--data ../shared/data] [--print]

One `OnlineFilter` in the world frame takes everything, in blocks of 0.1 to 2 s. Walks follow each other with a rest of
10 s to 5 minutes and a minute without samples between them, and are moved so that each begins where the one before
ended; which way a walk leads in the world is its own. Walks are recorded at their own rate or read at 20 to 400 Hz. In
one of five of them each: values are NaN for up to a second, many times; an axis of a sensor stands still for up to a
minute; nothing comes for up to 30 s; and all fixes are 60 m off for up to two minutes. In one of five rests the clock
is set back by up to an hour, and in one of five two samples are years ahead. Every 20 to 40 s of a walk there is a fix
of 3 m. At random times the filter is saved and loaded, and both run on for 20 s: what they say must be the same bits.

"Beyond 99 %" is the share of the steps of walks with a continuous reference that are further from it than the 99 %
ellipse, which includes all times before the fixes have settled a new walk. It is given for the walks in which all fixes
are right, and for those in which some are 60 m off: if the heading is lost there too nothing tells that they are.
"Unsaid" leaves out the steps of which a note about samples, sensors or fixes told within a minute: a new one, or one
that tells of something more, such as another rejected fix.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.progress import Progress
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import BoolArray, FloatArray, ImuBlock, PositionFix, interpolated_rows
from tests.benchmarks.common import Tables, part_of, push, run
from tests.benchmarks.placements import Walk, walks

G = np.array([0.0, 0.0, 9.81])
YEARS_S = 1e8
HOUR_S = 3600.0
FIX_STD_M, WRONG_M = 3.0, 60.0
TOLD_S = 60.0
SWITCHED_OFF_S = 60.0
LIMIT = chi2.ppf(0.99, 2)
TELLING = ("samples", "sensors", "fixes")
_OF_ALL = re.compile(r" of \d+|, \d+ % of the time|since [\d.]+ s|the last \d+")  # what grows without anything new


@dataclass
class Tally:
    """What an hour brought."""

    n_steps: int = 0
    # with right fixes and with wrong ones
    n_judged: list[int] = field(default_factory=lambda: [0, 0])
    n_beyond: list[int] = field(default_factory=lambda: [0, 0])
    n_unsaid: list[int] = field(default_factory=lambda: [0, 0])  # of those beyond
    n_nan: int = 0
    n_not_psd: int = 0
    n_resumed: int = 0
    n_resumed_differently: int = 0
    save_bytes: list[int] = field(default_factory=list[int])
    memory_mb: float = 0.0


@dataclass(frozen=True)
class Stretch:
    """Samples of a walk or a rest on true time from zero, and where the person is; (0, 2) where nobody knows."""

    block: ImuBlock
    truth_s: FloatArray  # (N,)
    truth_m: FloatArray  # (N, 2)

    @property
    def duration_s(self) -> float:
        return float(self.block.time_s[-1])


# --- what comes -------------------------------------------------------------------------------------------------------


def of_walk(walk: Walk, rng: np.random.Generator) -> Stretch:
    block = pdr.merge_streams(walk.recording)
    start_s = float(block.time_s[0])
    if rng.random() < 0.5:
        time_s = np.arange(start_s, block.time_s[-1], 1 / rng.choice([20.0, 25.0, 50.0, 100.0, 200.0, 400.0]))
        nearest = np.searchsorted(block.time_s, time_s).clip(max=len(block.time_s) - 1)
        block = replace(part_of(block, nearest), time_s=time_s)
    return Stretch(replace(block, time_s=block.time_s - start_s), walk.time_s - start_s, walk.position_m)


def of_rest(rng: np.random.Generator) -> Stretch:
    time_s = np.arange(0.0, rng.uniform(10.0, 300.0), 0.01)
    noise = rng.normal(size=(2, len(time_s), 3))
    return Stretch(
        ImuBlock(time_s, G + 0.02 * noise[0], 0.002 * noise[1], np.full((len(time_s), 3), np.nan)),
        np.empty(0),
        np.empty((0, 2)),
    )


def broken(stretch: Stretch, rng: np.random.Generator) -> Stretch:
    """With NaN, a sensor that stands still, or a gap."""
    block = stretch.block
    force, rate = block.specific_force_mps2.copy(), block.angular_rate_radps.copy()
    time_s, keep = block.time_s, np.ones(len(block.time_s), dtype=bool)
    if rng.random() < 0.2:
        for start_s in rng.uniform(0, stretch.duration_s, 8):
            some = (time_s > start_s) & (time_s < start_s + rng.uniform(0, 1))
            (force if rng.random() < 0.5 else rate)[some] = np.nan
    if rng.random() < 0.2:
        some = between(stretch, rng.uniform(1.0, 60.0), rng)
        sensor, axis = (force if rng.random() < 0.5 else rate), int(rng.integers(3))
        sensor[some, axis] = sensor[some.argmax(), axis]
    if rng.random() < 0.2:
        keep &= ~between(stretch, rng.uniform(0.4, 30.0), rng)
    block = part_of(replace(block, specific_force_mps2=force, angular_rate_radps=rate), keep)
    return replace(stretch, block=block)


def between(stretch: Stretch, length_s: float, rng: np.random.Generator) -> BoolArray:
    start_s = rng.uniform(0.0, stretch.duration_s)
    time_s = stretch.block.time_s
    return np.asarray((time_s >= start_s) & (time_s < start_s + length_s))


def fixes_of(stretch: Stretch, rng: np.random.Generator) -> list[PositionFix]:
    """On true time from the stretch's start."""
    if len(stretch.truth_s) == 0:
        return []
    found: list[PositionFix] = []
    wrong_s = rng.uniform(0, stretch.duration_s) if rng.random() < 0.2 else np.inf
    t = float(max(stretch.truth_s[0], 0.0)) + 5.0
    while t < min(stretch.truth_s[-1], stretch.duration_s):
        at = at_time(stretch, t) + rng.normal(scale=FIX_STD_M, size=2)
        if wrong_s <= t < wrong_s + 120.0:
            at = at + WRONG_M
        found.append(PositionFix(t, at, FIX_STD_M**2 * np.eye(2)))
        t += rng.uniform(20.0, 40.0)
    return found


def at_time(stretch: Stretch, t: float) -> FloatArray:
    return interpolated_rows(t, stretch.truth_s, stretch.truth_m)


# --- the run ----------------------------------------------------------------------------------------------------------


class Soak:
    """One filter, its clocks, and what it said."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.online = pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
        self.true_s = 0.0  # when the stretch begins
        self.clock_s = 0.0  # what the phone's clock lacks of true time
        self.place_m = np.zeros(2)
        self.notes: set[str] = set()
        self.told_s = -np.inf
        self.some_wrong = False  # of the fixes of the stretch
        self.hours: list[Tally] = [Tally()]

    def take(self, stretch: Stretch) -> None:
        """A walk begins where the last one ended."""
        if len(stretch.truth_s):
            shift_m = self.place_m - stretch.truth_m[0]
            stretch = replace(stretch, truth_m=stretch.truth_m + shift_m)
            self.place_m = stretch.truth_m[-1]
            self.true_s += SWITCHED_OFF_S
        elif self.rng.random() < 0.2:
            self.clock_s -= self.rng.uniform(1.0, HOUR_S)
        block, fixes = stretch.block, fixes_of(stretch, self.rng)
        away_m = [float(np.linalg.norm(fix.position_m - at_time(stretch, fix.time_s))) for fix in fixes]
        self.some_wrong = max(away_m, default=0.0) > 0.5 * WRONG_M
        time_s = self.true_s + self.clock_s + block.time_s
        if len(stretch.truth_s) == 0 and self.rng.random() < 0.2:
            time_s[len(time_s) // 2 : len(time_s) // 2 + 2] += YEARS_S
        clocked = replace(block, time_s=time_s)
        start, resume_s = 0, self.rng.uniform(0, 4 * stretch.duration_s)
        while start < len(time_s):
            end = start + max(1, round(self.rng.uniform(0.1, 2.0) * len(time_s) / stretch.duration_s))
            part = part_of(clocked, slice(start, end))
            if block.time_s[start] > resume_s:
                resume_s = np.inf
                self.resume(stretch, clocked, start)
            updates = push(self.online, part)
            now_s = float(block.time_s[min(end, len(time_s)) - 1])
            while fixes and fixes[0].time_s <= now_s:
                fix = fixes.pop(0)
                self.online.add_fix(replace(fix, time_s=fix.time_s + self.true_s + self.clock_s))
            self.judge(stretch, updates, now_s)
            start = end
        self.true_s += stretch.duration_s + 0.01

    def resume(self, stretch: Stretch, clocked: ImuBlock, start: int) -> None:
        """Save, load, and run both on for 20 s; the loaded one goes on."""
        tally, saved = self.hours[-1], self.online.save()
        end = int(np.searchsorted(stretch.block.time_s, stretch.block.time_s[start] + 20.0))
        part = part_of(clocked, slice(start, end))
        said = [[said_bits(u) for u in push(pdr.OnlineFilter.load(blob), part)] for blob in (saved, saved)]
        said.append([said_bits(u) for u in push(self.online, part)])
        self.online = pdr.OnlineFilter.load(saved)
        tally.n_resumed += 1
        tally.n_resumed_differently += not (said[0] == said[1] == said[2])
        tally.save_bytes.append(len(saved))

    def judge(self, stretch: Stretch, updates: Sequence[StepUpdate], now_s: float) -> None:
        tally = self.hours[-1]
        notes = {note.text for note in notes_of(self.online.config, self.online.state) if note.about in TELLING}
        notes = {_OF_ALL.sub("", note) for note in notes}
        if notes - self.notes:
            self.told_s = self.true_s + now_s
        self.notes = notes
        for update in updates:
            if not update.is_final:
                continue
            position_m, cov = update.position_m, update.position_cov_m2
            tally.n_steps += 1
            if not (np.isfinite(position_m).all() and np.isfinite(cov).all()):
                tally.n_nan += 1
                continue
            tally.n_not_psd += bool(np.linalg.eigvalsh(cov)[0] < -1e-9 * np.trace(cov))
            t = update.step.time_s - self.online.state.clock_offset_s - self.clock_s - self.true_s
            if len(stretch.truth_s) < 300 or not stretch.truth_s[0] <= t <= stretch.truth_s[-1]:
                continue
            if not self.online.state.pedestrian.frame.is_known:
                continue
            away = position_m - at_time(stretch, t)
            nees = evaluate.nees(away[None], (cov + 0.3**2 * np.eye(2))[None])[0]
            tally.n_judged[self.some_wrong] += 1
            tally.n_beyond[self.some_wrong] += bool(nees > LIMIT)
            tally.n_unsaid[self.some_wrong] += bool(nees > LIMIT and self.true_s + now_s - self.told_s >= TOLD_S)

    def end_hour(self) -> None:
        self.hours[-1].memory_mb = memory_mb()
        self.hours[-1].save_bytes.append(len(self.online.save()))
        self.hours.append(Tally())


def said_bits(update: StepUpdate) -> bytes:
    return update.position_m.tobytes() + update.position_cov_m2.tobytes() + update.mode_prob.tobytes()


def memory_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def stretches(found: Sequence[Walk], rng: np.random.Generator) -> Iterator[Stretch]:
    while True:
        yield of_rest(rng)
        yield broken(of_walk(found[int(rng.integers(len(found)))], rng), rng)


def soak(found: Sequence[Walk], hours: float, seed: int) -> list[Tally]:
    """What each hour brought; the last one may be a part of one."""
    rng = np.random.default_rng(seed)
    run = Soak(rng)
    with Progress(transient=True) as progress:
        task = progress.add_task("hours", total=hours)
        for stretch in stretches(found, rng):
            run.take(stretch)
            progress.update(task, completed=run.true_s / HOUR_S)
            if run.true_s >= HOUR_S * min(len(run.hours), hours):
                run.end_hour()
            if run.true_s >= HOUR_S * hours:
                return run.hours[:-1]
    raise AssertionError("stretches never end")


def days(tables: Tables, arguments: argparse.Namespace) -> None:
    """Hours on one filter, six in a row of the table."""
    hours = soak(list(walks(arguments.data)), arguments.hours, arguments.seed)
    rows: list[list[object]] = []
    for start in range(0, len(hours), 6):
        some = hours[start : start + 6]

        def total(name: str, some: Sequence[Tally] = some) -> int:
            return sum(getattr(tally, name) for tally in some)

        def share(name: str, kind: int, some: Sequence[Tally] = some) -> float:
            of_all = max(sum(tally.n_judged[kind] for tally in some), 1)
            return 100.0 * sum(getattr(tally, name)[kind] for tally in some) / of_all

        sizes = [size for tally in some for size in tally.save_bytes]
        row = [f"{start + 1} to {start + len(some)}", total("n_steps"), f"{some[-1].memory_mb:.0f}"]
        row += [f"{min(sizes) / 1e3:.0f} to {max(sizes) / 1e3:.0f}", f"{total('n_nan')}, {total('n_not_psd')}"]
        row += [f"{total('n_resumed')}, {total('n_resumed_differently')}"]
        rows.append([*row, *(f"{share('n_beyond', kind):.1f}, {share('n_unsaid', kind):.1f}" for kind in (0, 1))])
    columns = "hours | steps | memory MB | save kB | NaN, not PSD | resumed, differently | "
    columns += "beyond 99 %, without a note | with wrong fixes"
    tables.write("soak", columns, rows, "One filter, see the script.")


if __name__ == "__main__":
    run(__doc__, days, hours=48.0, seed=0)
