"""Harmonics of the strides of people who carry a phone: what `pdr_filter.simulate` draws its people around.

usage: python -m tests.benchmarks.stride_harmonics [--data ../shared/data] [--print]

Licensed recordings only: motionsense and difronzo (MIT, trouser pockets), humolire (CC BY 4.0) and ms_indoor (MIT, in
the hand), tyrex (CeCILL 2.1, one person: pockets, swinging, at the ear), oxford (CC BY 4.0, one person, accelerometer:
how large the harmonics of a swinging hand are). Written are measured_strides.npz of
`pdr_filter.simulate` and, for people to read, docs/tables/measured_strides.md. Nothing of a recording is kept but means
and scatter of Fourier coefficients.

A stride is two steps, from one maximum of the vertical specific force at step frequency to the maximum after the next.
Attitudes are those of vqf run in both directions. The frame turns with the phone's mean heading; its forward is where
the push forward points (docs/methods/heading.md), in the hand the phone's long axis. Each stride is resampled to 64
phases, closed by taking off the line between its ends, and transformed.

Where few people are known, those near are used too. A swinging hand is the mean of two, whose harmonics of the force
differ by a factor of two. The back pocket of one, in which the phone rattled, is half of what is drawn there, and
people's front pockets are the other half. That was chosen with 12 people of ubicomp13 in view: their mean stride in the
back pocket has a correlation of 0.72 with his, 0.85 with that of the front pockets and 0.90 with the mean of both.

For each place and context: the mean strides of each person, of their recording whose strides are most alike; how much
each person's strides differ; and the principal ways in which they do, of all people together.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, hilbert, sosfiltfilt
from scipy.spatial.transform import Rotation
from vqf import offlineVQF

import pdr_filter as pdr
from pdr_filter.sensing.conditioning import Conditioner, merge_streams
from pdr_filter.simulate.gait import CONTEXT_GAITS, Gait
from pdr_filter.simulate.strides import MEASURED, N_CHANNELS, N_HARMONICS, PEOPLE_SPREAD, ComplexArray, Strides
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, IntArray
from tests.benchmarks.common import Tables, recordings, run

RATE_HZ = 100.0
N_PHASES = 64
SETS = ("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor")
N_WAYS = 30  # principal ways in which strides differ: two thirds to nine tenths of the variance
OF_HANDS = 8  # recordings of humolire, all but one, and of ms_indoor
ONE_PERSON_SPREAD = 0.25  # of a coefficient's size, assumed where only one person was measured
MAX_LEVEL = 0.3  # of the forces: strides that differ more were not tracked, or are not one gait
# Published under the wrong label, by cadence, force and swing of the thigh: each is like the person's others of the
# opposite label (motionsense s09 swapped two; the second descent of difronzo user03 is an ascent).
MISLABELLED = ("motionsense_s09_ups_3", "motionsense_s09_dws_2", "difronzo_user03_exp07_downstairs_1")
_ODD = np.arange(1, N_HARMONICS + 1) % 2 == 1
_UNITS = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # a turn of 0.1 rad counts as much as all of the step's force


@dataclass(frozen=True, eq=False)
class Stretch:
    """Strides of one labelled stretch of a recording."""

    name: str
    person: str
    place: str
    context: str
    harmonics: ComplexArray  # (S, N_HARMONICS, N_CHANNELS) in m/s2 and rad
    step_hz: FloatArray  # (S,)

    @property
    def force_mps2(self) -> float:
        """Vertical, at step frequency, of the mean stride."""
        return float(abs(self.harmonics[:, 1, 2].mean()))

    @property
    def relative(self) -> ComplexArray:
        """Harmonics with the forces as parts of that."""
        return self.harmonics / np.repeat([self.force_mps2, 1.0], 3)

    @property
    def level(self) -> FloatArray:
        """How much the strides differ, (2,): their forces, their turns."""
        differ = np.abs(self.relative - self.relative.mean(axis=0)) ** 2
        return np.sqrt(differ.mean(axis=(0, 1)).reshape(2, 3).mean(axis=1))


# --- strides of samples ---------------------------------------------------------------------------------------------


def stretches(data: Path) -> Iterator[Stretch]:
    """All labelled stretches in which somebody moves."""
    for site in SETS:
        for recording in recordings(data, site):
            if "_ar" in recording.name or recording.name == "motionsense_s01_sit_13":
                continue
            steps = pdr.track(recording, pdr.recipes.for_recording("default", recording)).steps
            time_s, step_hz = np.array([(s.time_s, s.frequency_hz) for s in steps]).reshape(-1, 2).T
            seen: dict[str, int] = {}
            for label in recording.truth.labels if recording.truth.labels is not None else ():
                context, mode = str(label["context"]), str(label["carrying_mode"])
                inside = (time_s > label["start_s"]) & (time_s < label["end_s"])
                if context in ("", "stationary") or inside.sum() < 6 or (site == "tyrex" and mode == "texting"):
                    continue  # reading, in a room 5 m wide, tyrex's person shuffles
                number = seen[context] = seen.get(context, -1) + 1
                if {recording.name, f"{recording.name}_{context}_{number}"} & set(MISLABELLED):
                    continue
                place = "back_pocket" if "backpocket" in recording.name else mode
                about = (recording.name, f"{site}/{recording.subject.id}", place, context)
                between = (label["start_s"] + 1.0, label["end_s"] - 1.0)
                found = _strides(recording, between, mode, context, float(np.median(step_hz[inside])))
                if found is not None:
                    yield Stretch(*about, *found)


def _strides(
    recording: pdr.Recording, between: tuple[float, float], mode: str, context: str, step_hz: float
) -> tuple[ComplexArray, FloatArray] | None:
    """Harmonics and step frequencies of the strides; None where none can be told."""
    conditioner = Conditioner(RATE_HZ)
    for block in conditioner.update(conditioner.init(), merge_streams(recording))[1]:
        use = (block.time_s >= between[0]) & (block.time_s <= between[1])
        if use.sum() < 6 * RATE_HZ:
            continue
        force, rate = block.specific_force_mps2[use], block.angular_rate_radps[use]
        harmonics, own_hz, run, ahead = _cut(force, rate, step_hz)
        if len(harmonics) < 4:
            continue
        forward_rad = ahead if mode == "texting" else _forward_rad(harmonics, mode, context)
        harmonics = _one_foot_first(_turned(harmonics, forward_rad), run)
        # Who runs down a flight has every other step weak, and a stride is taken for a step: left out.
        if mode not in ("pocket", "swinging") or _swings(harmonics):
            return harmonics, own_hz
    return None


def _swings(harmonics: ComplexArray) -> bool:
    """Whether a limb swings once a stride, the same way in all strides."""
    swing = np.sqrt((np.abs(harmonics[:, :2, 3:]) ** 2).sum(axis=2)).mean(axis=0)
    steady = np.linalg.norm(harmonics[:, 0, 3:].mean(axis=0))
    return bool(swing[0] > 1.3 * swing[1] and steady > 0.6 * swing[0])


def _cut(force: FloatArray, rate: FloatArray, hz: float) -> tuple[ComplexArray, FloatArray, IntArray, float]:
    """Harmonics, step frequencies and unbroken runs of strides, and where the phone's y axis points, in a frame that
    turns with the phone's mean heading."""
    quat = offlineVQF(np.ascontiguousarray(rate), np.ascontiguousarray(force), None, 1 / RATE_HZ)["quat6D"]
    attitude = Rotation.from_quat(quat[:, [1, 2, 3, 0]])
    up = attitude.inv().apply([0.0, 0.0, 1.0])
    width = round(2 / hz * RATE_HZ)
    smooth = uniform_filter1d(uniform_filter1d(_heading(quat, quat[np.argmax(up @ up.mean(axis=0))]), width), width)
    attitude = Rotation.from_euler("z", smooth[:, None]) * attitude
    moved = attitude.apply(force) - [0.0, 0.0, STANDARD_GRAVITY_MPS2]
    band = butter(2, [0.75 * hz, 1.25 * hz], "bandpass", fs=RATE_HZ, output="sos")
    analytic = np.asarray(hilbert(sosfiltfilt(band, moved[:, 2])))
    size = np.abs(analytic)
    stride = np.maximum.accumulate(np.unwrap(np.angle(analytic))) / (4 * np.pi)
    sample, numbers = np.arange(len(stride)), np.arange(np.ceil(stride[0] + 0.5), np.floor(stride[-1] - 0.5))
    harmonics: list[ComplexArray] = []
    own_hz: list[float] = []
    run: list[int] = []
    broken = 0
    for number in numbers:
        at = np.interp(number + np.arange(N_PHASES + 1) / N_PHASES, stride, sample)
        i, j = int(at[0]), int(at[-1])
        step_hz = 2 * RATE_HZ / max(at[-1] - at[0], 1.0)
        even = abs(step_hz / hz - 1) < 0.2 and size[i:j].min() > 0.25 * np.median(size)
        if not even or abs(smooth[j] - smooth[i]) > 0.35:
            broken += 1
            continue
        mean = attitude[max(i - 2 * width, 0) : j + 2 * width].mean()
        near = slice(i, min(j + 2, len(sample)))
        yaw, pitch, roll = (attitude[near] * mean.inv()).as_euler("ZXY").T
        turned = [np.interp(at - i, np.arange(len(c)), c) for c in (pitch, roll, yaw)]
        signals = np.column_stack([*(np.interp(at, sample, c) for c in moved.T), *turned])
        signals -= (signals[-1] - signals[0]) * np.arange(N_PHASES + 1)[:, None] / N_PHASES
        harmonics.append(np.fft.fft(signals[:-1], axis=0)[1 : N_HARMONICS + 1] * (2 / N_PHASES))
        own_hz.append(float(step_hz))
        run.append(broken)
    ahead = attitude.mean().apply([0.0, 1.0, 0.0])
    return np.array(harmonics), np.array(own_hz), np.array(run), float(np.arctan2(ahead[1], ahead[0]))


def _heading(quat: FloatArray, reference: FloatArray) -> FloatArray:
    """Turn about up since a reference attitude, clockwise, as `pdr_filter.sensing.attitude` has it."""
    w, x, y, z = quat.T
    a, b, c, d = reference
    return np.unwrap(-2.0 * np.arctan2(-w * d - x * c + y * b + z * a, w * a + x * b + y * c + z * d))


def _forward_rad(harmonics: ComplexArray, mode: str, context: str) -> float:
    """Where the person walks in the horizontal plane, counter-clockwise from x (docs/methods/heading.md).

    On stairs the limb swings truer than the push points: across its axis, and 15 degrees on, as the same people's
    pushes have it in walking.
    """
    first, second = harmonics[:, 0], harmonics[:, 1]
    if mode == "swinging":
        push = np.real(first[:, :2] * first[:, 2:3].conj())
    else:
        lag = np.exp(-1j * np.radians(-135.0 if context == "running" else 85.0))
        push = np.real(second[:, :2] * second[:, 2:3].conj() * lag) / np.abs(second[:, 2:3])
    forward = float(np.arctan2(*push.sum(axis=0)[::-1]))
    if mode == "pocket" and context in ("upstairs", "downstairs"):
        turns = first[:, 3:5]
        axis = np.linalg.eigh(np.real(turns.T @ turns.conj()))[1][:, 1]
        across = float(np.arctan2(axis[1], axis[0]) + np.pi / 2)
        across += np.pi if np.cos(across - forward) < 0 else 0.0
        return across + np.radians(15.0)
    return forward


def _turned(harmonics: ComplexArray, forward_rad: float) -> ComplexArray:
    """In a frame whose second axis is forward."""
    c, s = np.cos(np.pi / 2 - forward_rad), np.sin(np.pi / 2 - forward_rad)
    turned = harmonics.copy()
    for i, j in ((0, 1), (3, 4)):  # forces right and forward; turns about them
        turned[..., i] = c * harmonics[..., i] - s * harmonics[..., j]
        turned[..., j] = s * harmonics[..., i] + c * harmonics[..., j]
    return turned


# --- which foot, which side -----------------------------------------------------------------------------------------


def other_foot(harmonics: ComplexArray) -> ComplexArray:
    """Half a stride later."""
    return np.where(_ODD[:, None], -harmonics, harmonics)


def mirrored(harmonics: ComplexArray) -> ComplexArray:
    """Left for right."""
    return harmonics * np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])


def alike(a: ComplexArray, b: ComplexArray) -> float:
    """Correlation of two mean strides."""
    a, b = a[:11] / _UNITS, b[:11] / _UNITS
    return float(np.real((a * b.conj()).sum()) / (np.linalg.norm(a) * np.linalg.norm(b)))


def _one_foot_first(harmonics: ComplexArray, run: IntArray) -> ComplexArray:
    """Runs that begin with the other foot moved by half a stride."""
    harmonics, reference = harmonics.copy(), harmonics[0]
    for _ in range(3):
        for number in np.unique(run):
            own = run == number
            mean = harmonics[own].mean(axis=0)
            if alike(other_foot(mean), reference) > alike(mean, reference):
                harmonics[own] = other_foot(harmonics[own])
        reference = harmonics.mean(axis=0)
    return harmonics


def aligned(group: Sequence[Stretch], reference: ComplexArray) -> tuple[list[Stretch], ComplexArray]:
    """Stretches of one place and context with the same foot and side first, and their mean."""
    group = list(group)
    for _ in range(4):
        for i, stretch in enumerate(group):
            found = [stretch.harmonics]
            for change in (other_foot, mirrored):
                found += [change(h) for h in found]
            best = max(found, key=lambda h: alike(h.mean(axis=0), reference))
            group[i] = replace(stretch, harmonics=best)
        reference = np.mean([s.harmonics.mean(axis=0) for s in group], axis=0)
    return group, reference


# --- tables ---------------------------------------------------------------------------------------------------------


def of_people(group: Sequence[Stretch]) -> list[Stretch]:
    """One stretch of each person: of those of a dozen strides, the one whose strides are most alike.

    In the hand, where one site has one person and the other surveyors without names, the longest of each site.
    """
    if group[0].place == "texting":
        sites = sorted({s.person for s in group})
        own = [sorted((s for s in group if s.person == site), key=lambda s: -len(s.harmonics)) for site in sites]
        return [stretch for stretches_ in own for stretch in stretches_[:OF_HANDS]]
    people: dict[str, list[Stretch]] = {}
    for stretch in group:
        people.setdefault(stretch.person, []).append(stretch)
    chosen: list[Stretch] = []
    for _, stretches_ in sorted(people.items()):
        long = [s for s in stretches_ if len(s.harmonics) >= 12] or [max(stretches_, key=lambda s: len(s.harmonics))]
        chosen.append(min(long, key=lambda s: float(s.level[0])))
    return chosen


def measured(group: Sequence[Stretch], max_level: FloatArray) -> Strides:
    """The table of one place and context."""
    group = [s for s in of_people(group) if s.level[0] < MAX_LEVEL or len(group) < 4]
    mean = np.array([s.relative.mean(axis=0) for s in group])
    few = len(group) < 3
    if few:
        mean = mean.mean(axis=0, keepdims=True)
    first = int(np.argmin(np.linalg.norm(((mean - mean.mean(axis=0)) / _UNITS).reshape(len(mean), -1), axis=1)))
    order = [first, *(i for i in range(len(mean)) if i != first)]
    level = np.array([s.level for s in group])
    ways, rest = _ways(group, level)
    force = np.array([s.force_mps2 * _to_usual_cadence(s) for s in group])
    if few:
        force, level = (
            np.exp(np.log(force).mean(keepdims=True)),
            np.minimum(level.mean(axis=0, keepdims=True), max_level),
        )
    return Strides(
        people=mean[order],
        amplitude_mps2=force[order],
        people_rest=ONE_PERSON_SPREAD / PEOPLE_SPREAD * np.abs(mean[0]) * few,
        level=level[order],
        ways=ways,
        ways_rest=rest,
    )


def _to_usual_cadence(stretch: Stretch) -> float:
    """Walking, what the force would be at the usual cadence, as a factor; else 1."""
    if stretch.context != "walking":
        return 1.0
    usual_hz = CONTEXT_GAITS["walking"].frequency_hz
    usual, own = (
        Gait().vertical_force_mps2("walking", hz, Gait().step_length_m("walking", hz), 0.0)
        for hz in (usual_hz, float(np.median(stretch.step_hz)))
    )
    return usual / own


def _ways(group: Sequence[Stretch], level: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Principal ways in which strides of a person differ, in parts of the person's level, and the rest of each."""
    parts: list[ComplexArray] = []
    for stretch, own in zip(group, level, strict=True):
        differ = (stretch.relative - stretch.relative.mean(axis=0)) / np.repeat(own, 3)
        parts.append(differ / np.sqrt(len(group) * len(differ)))
    rows = np.concatenate(parts).reshape(-1, N_HARMONICS * N_CHANNELS)
    u, size, ways = np.linalg.svd(np.hstack([rows.real, rows.imag]), full_matrices=False)
    n = min(N_WAYS, len(size))
    real, imaginary = np.hsplit(size[:n, None] * ways[:n], 2)
    rest = np.hsplit((((u[:, n:] * size[n:]) @ ways[n:]) ** 2).sum(axis=0), 2)
    shape = (-1, N_HARMONICS, N_CHANNELS)
    return (real + 1j * imaginary).reshape(shape), np.sqrt(rest[0] + rest[1]).reshape(shape[1:])


COLUMNS = (
    *("place", "context", "people", "steps/s", "up 2, 1, 4", "forward 1, 2", "right 1, 2", "pitch 1, 2"),
    *("roll 1", "yaw 1", "scatter of strides: up 2, pitch 1"),
)
ABOUT = (
    "Amplitudes at multiples of the stride frequency, forces in m/s2, turns in degrees: median over people (their "
    "standard deviation, relative)."
)


def _row(place: str, context: str, group: Sequence[Stretch], table: Strides) -> list[object]:
    size = np.array([np.abs(s.harmonics.mean(axis=0)) for s in group])
    differ = np.array([np.sqrt((np.abs(s.harmonics - s.harmonics.mean(axis=0)) ** 2).mean(axis=0)) for s in group])
    size[..., 3:], differ[..., 3:] = np.degrees(size[..., 3:]), np.degrees(differ[..., 3:])

    def cell(channel: int, *numbers: int) -> str:
        own = size[:, [n - 1 for n in numbers], channel]
        spread = f" ({np.log(own).std(axis=0)[0]:.2f})" if len(group) > 2 else ""
        return ", ".join(f"{m:.1f}" for m in np.median(own, axis=0)) + spread

    hz = np.array([np.median(s.step_hz) for s in group])
    cells = [cell(2, 2, 1, 4), cell(1, 1, 2), cell(0, 1, 2), cell(3, 1, 2), cell(4, 1), cell(5, 1)]
    scatter = f"{np.median(differ[:, 1, 2]):.2f}, {np.median(differ[:, 0, 3]):.1f}"
    spread = f" ({hz.std():.2f})" if len(hz) > 2 else ""
    return [place, context, len(table.people), f"{np.median(hz):.2f}{spread}", *cells, scatter]


# --- where few people were measured ----------------------------------------------------------------------------------

N_SIZED = 10  # harmonics of a swinging hand that are not noise


def halfway(table: Strides, people: Strides) -> Strides:
    """People of another place, each halfway to the one who was measured here."""
    return replace(people, people=0.5 * (people.people + table.people))


def towards_sizes(table: Strides, size: FloatArray) -> Strides:
    """One person's table with forces (N_SIZED, 2), vertical and horizontal, halfway to those of somebody else."""
    own = np.abs(table.people[0, :N_SIZED])
    factor = np.ones(table.people.shape[1:])
    factor[:N_SIZED, 2] = np.sqrt(size[:, 0] / own[:, 2])
    factor[:N_SIZED, :2] = np.sqrt(size[:, 1] / np.linalg.norm(own[:, :2], axis=1))[:, None]
    return table.scaled(factor)


def sizes_of_oxford(data: Path, pattern: str) -> FloatArray:
    """Vertical and horizontal amplitudes (N_SIZED, 2) of the mean stride between foot contacts, in parts of the
    vertical one at step frequency; the mean over recordings."""
    found: list[FloatArray] = []
    for recording in recordings(data, "oxford", pattern):
        assert recording.truth.steps is not None
        samples, contact_s = recording.accelerometer, np.asarray(recording.truth.steps.time_s)
        time_s = np.arange(samples.time_s[0], samples.time_s[-1], 1 / RATE_HZ)
        force = np.column_stack([np.interp(time_s, samples.time_s, c) for c in samples.values.T])
        up = sosfiltfilt(butter(2, 0.3, fs=RATE_HZ, output="sos"), force, axis=0)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        vertical = (force * up).sum(axis=1)
        across = np.linalg.svd(up.mean(axis=0)[None])[2][1:]
        signals = np.column_stack([vertical, (force - vertical[:, None] * up) @ across.T])
        stride_s = 2 * np.median(np.diff(contact_s))
        harmonics: list[ComplexArray] = []
        for start_s, end_s in zip(contact_s[:-2:2], contact_s[2::2], strict=True):
            if abs(end_s - start_s - stride_s) < 0.12 * stride_s:
                at_s = np.linspace(start_s, end_s, N_PHASES + 1)
                course = np.column_stack([np.interp(at_s, time_s, c) for c in signals.T])
                course -= (course[-1] - course[0]) * np.arange(N_PHASES + 1)[:, None] / N_PHASES
                harmonics.append(np.fft.fft(course[:-1], axis=0)[1 : N_SIZED + 1])
        size = np.abs(np.mean(harmonics, axis=0))
        found.append(np.column_stack([size[:, 0], np.hypot(size[:, 1], size[:, 2])]) / size[1, 0])
    return np.mean(found, axis=0)


def strides(tables: Tables, arguments: argparse.Namespace) -> None:
    """Harmonics of the strides of real people, and the file of the simulator."""
    groups: dict[tuple[str, str], list[Stretch]] = {}
    for stretch in stretches(arguments.data):
        groups.setdefault((stretch.place, stretch.context), []).append(stretch)
    # Walking first: its feet and sides are those of the other contexts, its scatter bounds that of single persons, who
    # turned all the time in a room.
    order = sorted(groups, key=lambda k: (k[1] != "walking", k[0] not in ("pocket", "texting"), k))
    reference: dict[str, ComplexArray] = {}
    level: dict[str, FloatArray] = {}
    found: dict[tuple[str, str], Strides] = {}
    rows: list[list[object]] = []
    for place, context in order:
        group = groups[place, context]
        known = reference.get("pocket") if "pocket" in place else None
        start = group[0].harmonics.mean(axis=0) if known is None else known
        group, mean = aligned(group, start)
        if context == "walking":
            if place == "pocket" and mean[0, 3].real < 0:  # the phone's own foot lands at phase 0: its thigh is ahead
                group, mean = [replace(s, harmonics=other_foot(s.harmonics)) for s in group], other_foot(mean)
            reference[place] = mean
        table = measured(group, level.get("pocket" if "pocket" in place else "texting", np.full(2, np.inf)))
        rows.append(_row(place, context, of_people(group), table))
        if (place, context) == ("swinging", "walking"):
            table = towards_sizes(table, sizes_of_oxford(arguments.data, "*swinging*"))
        if (place, context) == ("back_pocket", "walking"):
            table = halfway(table, found["pocket", context])
        if context == "walking":
            level.setdefault(place, np.median(table.level, axis=0))
        found[place, context] = table
    tables.write("measured_strides", COLUMNS, rows, ABOUT)
    if not arguments.print:
        write_measured(found)


def write_measured(found: dict[tuple[str, str], Strides]) -> None:
    """Write the tables, by place and context. Half precision exceeds their accuracy."""
    rows: dict[str, np.ndarray] = {}
    for (place, context), table in found.items():
        for field in fields(Strides):
            value = getattr(table, field.name)
            parts = np.stack([value.real, value.imag], axis=-1) if np.iscomplexobj(value) else value
            rows[f"{place}/{context}/{field.name}"] = parts.astype(np.float16)
    np.savez_compressed(MEASURED, **rows)


if __name__ == "__main__":
    run(__doc__, strides)
