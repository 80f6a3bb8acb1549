"""The walking heading in any carrying mode, against motion capture, and how steady it is on other sets.

usage: python -m tests.benchmarks.walking_heading [tyrex] [other_sets] [--data ../shared/data]

Tyrex: one person, two minutes for each scenario, motion capture of the phone. Truth is the direction of the body's
velocity:

1. The frame of the phone's attitude is turned to the room by its horizontal specific force and the acceleration of the
   motion capture, both between 0.4 and 4 Hz, in pieces of 5 s; a parabola through them is the angle, because the
   gyroscope drifts. Nothing of the walking heading enters, so no constant error is hidden. The attitude that the
   phone computed itself, with its magnetometer, agrees within 6 degrees in the scenarios without magnets.
2. The body is the phone less a lever arm that turns with the phone: the constant arm that leaves the least jerk in
   the path below 0.5 Hz. A phone held in front is 0.35 m ahead, and sweeps sideways in every turn.
3. Steps count where the body moves faster than 0.4 m/s and its path turns slower than 1 rad/s, for 70 % of the step.

"Learnt" is the direction that each step shows against the device, from where its standard deviation is below 45 degrees
on. "Fixed" keeps the true offset of the first six steps; "best" is the best constant offset: what remains is the hand
or leg that turns against the body, the gyroscope, and the truth. Parameters were chosen on `nodist`; `dist` is the same
person on other walks. Other sets have no truth of the direction: there, an offset that stays the same in one place is
all that can be asked, and that in one person's pocket the angle between walking and screen is the same on stairs and
running (the running phase was chosen on these people).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.sensing.steps.step_detector import ContextBlock, unknown_contexts
from pdr_filter.values import CARRYING_MODES, Step, circular_mean, wrap_angle
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, median_and, paths, recordings, run

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]

RATE_HZ = 100.0
SCENARIOS = {
    "texting": "texting",
    "phoning": "calling",
    "swinging": "swinging",
    "frontpocket": "pocket",
    "backpocket": "pocket",
    "runninghand": "swinging",
    "runningpocket": "pocket",
}
PLACES = {"handheld_using": "texting", "hand_held": "", "handbag": "bag", "backpack": "bag"}


@dataclass(frozen=True)
class Walk:
    """The longest part of a recording without gap: samples, attitude, steps with the sample that revealed each."""

    recording: Recording
    block: UniformBlock
    attitude: AttitudeBlock
    steps: list[tuple[int, Step]]

    @classmethod
    def of(cls, recording: Recording) -> Walk:
        conditioner, estimator = Conditioner(RATE_HZ), AttitudeEstimator(RATE_HZ)
        detector = WaveletStepDetector(RATE_HZ)
        _, blocks = conditioner.update(conditioner.init(), merge_streams(recording))
        block = max(blocks, key=lambda b: len(b.time_s))
        _, attitude = estimator.update(estimator.init(), block)
        state, steps = detector.update(detector.init(), block, attitude, unknown_contexts(len(block.time_s)))
        return cls(recording, block, attitude, steps + detector.finish(state))

    def annotated(self, stage: WalkingHeading, carrying_mode: str) -> list[Step]:
        """Steps with their directions; the carrying mode is known at once, or never if it is empty."""
        n = len(self.block.time_s)
        mode = CARRYING_MODES.index(carrying_mode) if carrying_mode else -1
        modes = ContextBlock(np.full(n, -1), np.full(n, mode))
        _, steps = stage.update(stage.init(), self.block, self.attitude, modes, self.steps)
        return [step for _, step in steps]


def believed(steps: list[Step]) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Heading offset that each step shows, its standard deviation, and whether that is below 45 degrees."""
    offsets = np.array([step.shown_offset_rad for step in steps])
    stds = np.array([step.shown_offset_std_rad for step in steps])
    return offsets, stds, stds < np.radians(45)


# --- truth -----------------------------------------------------------------------------------------------------------


def low_pass(signal: ComplexArray, cutoff_hz: float) -> ComplexArray:
    return np.asarray(sosfiltfilt(butter(4, cutoff_hz, fs=RATE_HZ, output="sos"), signal))


def truth(walk: Walk) -> tuple[FloatArray, BoolArray]:
    """Walking heading (K,) of each step in the attitude's frame, clockwise from north, and where it is defined.

    Complex numbers are (north, east): their angle is clockwise from north.
    """
    time_s, place = walk.block.time_s, walk.recording.truth.position
    next_frame = np.searchsorted(place.time_s, time_s).clip(1, len(place) - 1)
    seen = (time_s > place.time_s[0]) & (time_s < place.time_s[-1]) & (np.diff(place.time_s)[next_frame - 1] < 0.1)
    seen &= np.convolve(~seen, np.ones(101), "same") == 0
    phone = np.interp(time_s, place.time_s, place.north_m) + 1j * np.interp(time_s, place.time_s, place.east_m)
    force = walk.attitude.horizontal_mps2[:, 1] + 1j * walk.attitude.horizontal_mps2[:, 0]
    room_rad = frame_in_room(phone, force, seen)
    device = np.exp(1j * (walk.attitude.device_heading_rad + room_rad))
    velocity, arm_velocity = (RATE_HZ * np.gradient(low_pass(z, 0.5)) for z in (phone, device))
    jerk, arm_jerk = (RATE_HZ**2 * np.gradient(np.gradient(v))[seen] for v in (velocity, arm_velocity))
    velocity = velocity - (arm_jerk.conj() @ jerk) / (arm_jerk.conj() @ arm_jerk) * arm_velocity
    turn_rate = RATE_HZ * np.abs(np.gradient(np.unwrap(np.angle(velocity))))
    defined = seen & (np.abs(velocity) > 0.4) & (turn_rate < 1.0)
    heading, counts = np.zeros(len(walk.steps)), np.zeros(len(walk.steps), dtype=bool)
    for i, (_, step) in enumerate(walk.steps):
        first, last = np.searchsorted(time_s, [step.time_s - step.duration_s, step.time_s])
        if last > first + 5:
            heading[i] = circular_mean(np.angle(velocity[first:last]) - room_rad[first:last])
            counts[i] = defined[first:last].mean() > 0.7
    return heading, counts


def frame_in_room(phone: ComplexArray, force: ComplexArray, seen: BoolArray) -> FloatArray:
    """Angle of the attitude's north in the room, clockwise, for each sample."""
    acceleration = RATE_HZ**2 * np.gradient(np.gradient(low_pass(phone, 4.0)))
    product = band(acceleration) * band(low_pass(force, 4.0)).conj() * seen
    mean_rad = np.angle(product.sum())
    n_piece = round(5 * RATE_HZ)
    starts = np.arange(0, len(product) - n_piece // 2, n_piece)
    pieces = np.add.reduceat(product, starts) * np.exp(-1j * mean_rad)
    some = np.abs(pieces) > 0
    at = (starts + 0.5 * n_piece) / len(product)
    drift = np.polyfit(at[some], np.unwrap(np.angle(pieces[some])), 2, w=np.sqrt(np.abs(pieces[some])))
    return mean_rad + np.polyval(drift, np.arange(len(product)) / len(product))


def band(signal: ComplexArray) -> ComplexArray:
    """The signal above 0.4 Hz."""
    return signal - low_pass(signal, 0.4)


# --- tables ----------------------------------------------------------------------------------------------------------


def tyrex(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors against motion capture."""
    stage = WalkingHeading()
    columns = "scenario | steps | mode known: median, 90 % | reversed after 20 s | bias | std given | error / std | "
    columns += "first direction at | mode unknown: median, 90 % | fixed | best"
    rows = []
    for kind in ("nodist", "dist"):
        for scenario, carrying_mode in SCENARIOS.items():
            for recording in recordings(arguments.data, "tyrex", f"*_{kind}_{scenario}.zip"):
                rows.append([f"{kind} {scenario}", *tyrex_row(Walk.of(recording), stage, carrying_mode)])
    tables.write("walking_heading", columns, rows, "Errors in degrees, tyrex (one person).")


def tyrex_row(walk: Walk, stage: WalkingHeading, carrying_mode: str) -> list[str]:
    heading, counts = truth(walk)
    device = np.array([s.device_heading_rad for _, s in walk.steps])
    time_s = np.array([s.time_s for _, s in walk.steps])
    true_offset = wrap_angle(heading - device)

    def errors(mode: str) -> tuple[FloatArray, FloatArray, BoolArray]:
        offset, std, known = believed(walk.annotated(stage, mode))
        return np.degrees(wrap_angle(offset - true_offset)), np.degrees(std), known

    error, std, known = errors(carrying_mode)
    scored = counts & known
    late = np.abs(error[scored & (time_s > 20.0)])
    cells = [f"{scored.sum()} of {counts.sum()}", median_and(np.abs(error[scored]), 90, 1), f"{(late > 90).sum()}"]
    cells += [f"{np.degrees(circular_mean(np.radians(error[scored]))):+.1f}", f"{np.median(std[scored]):.0f}"]
    cells += [f"{np.sqrt(np.mean((error[scored] / std[scored]) ** 2)):.2f}", f"{time_s[known.argmax()]:.0f} s"]
    error, _, known = errors("")
    cells.append(median_and(np.abs(error[counts & known]), 90, 1))
    first = np.flatnonzero(counts)[:6]
    for constant in (circular_mean(true_offset[first]), circular_mean(true_offset[counts])):
        cells.append(f"{np.degrees(np.median(np.abs(wrap_angle(true_offset - constant)[counts]))):.1f}")
    return cells


class Steadiness(NamedTuple):
    """How much the learnt offset of a walk wanders."""

    n_steps: int
    spread_deg: float  # standard deviation of the offset, from 8 s after the first direction
    n_reversed: int  # steps more than 90 degrees from the mean offset, from 20 s after it
    n_moves: int
    std_deg: float  # median of what the stage gives


def other_sets(tables: Tables, arguments: argparse.Namespace) -> None:
    """How steady the direction is where the truth is not known."""
    stage = WalkingHeading()
    found: dict[tuple[str, str], list[Steadiness]] = {}
    for site, pattern in (
        ("humolire", "*.zip"),
        ("ms_indoor", "*.zip"),
        ("motionsense", "*wlk*.zip"),
        ("motionsense", "*jog*.zip"),
        ("ubicomp13", "*.zip"),
    ):
        for path in paths(arguments.data, site, pattern):
            place, mode = site, "texting"
            if site == "motionsense":
                place, mode = f"motionsense {'walking' if 'wlk' in pattern else 'running'}", "pocket"
            elif site == "ubicomp13":
                kind = path.stem.split("_", 3)[-1]
                place, mode = f"ubicomp13 {kind}", PLACES.get(kind, "pocket")
            walk = Walk.of(pdr.read(path))
            for carrying_mode, known in {mode: "known", "": "unknown"}.items():
                of_walk = steadiness(walk, stage, carrying_mode)
                if of_walk is not None:
                    found.setdefault((place, known), []).append(of_walk)
    rows = []
    for (place, known), walks in sorted(found.items()):
        n_steps, spread, n_reversed, n_moves, std = zip(*walks, strict=True)
        cells = [median_and(spread, 100, 1), sum(n_reversed), sum(n_moves), f"{np.median(std):.0f}"]
        rows.append([place, known, len(walks), sum(n_steps), *cells])
    columns = "recordings | mode | walks | steps | spread of the offset: median, largest | reversed | moves | std given"
    tables.write("walking_heading_other_sets", columns, rows, "Degrees.")


def steadiness(walk: Walk, stage: WalkingHeading, carrying_mode: str) -> Steadiness | None:
    """Of a walk; None where there are too few steps to say."""
    steps = walk.annotated(stage, carrying_mode)
    if len(steps) < 12:
        return None
    offset, std, known = believed(steps)
    time_s = np.array([s.time_s for s in steps])
    if (segments := walk.recording.truth.segments) is not None and walk.recording.name.startswith("ubicomp13"):
        known = known & (time_s > segments.start_s[0]) & (time_s < segments.end_s[0])
    since_s = time_s - time_s[known.argmax()]
    settled = known & (since_s > 8.0)
    if known.sum() < 10 or settled.sum() < 5:
        return None
    away = np.degrees(wrap_angle(offset - circular_mean(offset[settled])))
    return Steadiness(
        int(known.sum()),
        float(away[settled].std()),
        int((np.abs(away) > 90)[known & (since_s > 20.0)].sum()),
        sum(s.offset_change_std_rad > 1.0 for s, inside in zip(steps, known, strict=True) if inside),
        float(np.degrees(np.median(std[known]))),
    )


if __name__ == "__main__":
    run(__doc__, tyrex, other_sets)
