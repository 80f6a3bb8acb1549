"""What several tests share: cutting sample blocks, joining what comes out, walking through the front end."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import pdr_filter as pdr
from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.weighting import HC
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.filter.step_length.models import FrequencyVarianceStepLength, StepLengthFit
from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import Conditioner, ConditionerState, UniformBlock, merge_streams
from pdr_filter.sensing.front_end import Event, Sensing
from pdr_filter.sensing.steps.step_detector import ContextBlock, unknown_contexts
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    STANDARD_GRAVITY_MPS2,
    FloatArray,
    ImuBlock,
    Step,
    Windows,
    wrap_angle,
)
from pdr_filter.values.recording import Recording
from pdr_filter.values.serialisation import to_bytes

T = TypeVar("T")


def imu(
    time_s: FloatArray, force: FloatArray | None = None, rate: FloatArray | None = None, field: FloatArray | None = None
) -> ImuBlock:
    """A block of samples; a phone that lies face up, without gyroscope and magnetometer, unless said otherwise."""
    n = len(time_s)
    missing = np.full((n, 3), np.nan)
    return ImuBlock(
        np.asarray(time_s, dtype=float),
        np.tile([0.0, 0.0, STANDARD_GRAVITY_MPS2], (n, 1)) if force is None else force,
        missing if rate is None else rate,
        missing if field is None else field,
    )


def of_nobody(recording: Recording) -> Recording:
    """Return a recording without its person, whom an online filter does not know either."""
    return replace(recording, meta={**recording.meta, "subject": None})


def part_of(block: ImuBlock, part: slice | np.ndarray) -> ImuBlock:
    return ImuBlock(*(getattr(block, f.name)[part] for f in fields(ImuBlock)))


def cut(block: ImuBlock, cuts: Sequence[int]) -> list[ImuBlock]:
    """The block in pieces; cuts may repeat (an empty piece) and follow each other (a single sample)."""
    n = len(block.time_s)
    edges = [0, *sorted(c % (n + 1) for c in cuts), n]
    return [part_of(block, slice(a, b)) for a, b in pairwise(edges)]


def cut_randomly(block: ImuBlock, seed: int, mean_length: int = 120) -> list[ImuBlock]:
    rng = np.random.default_rng(seed)
    n = len(block.time_s)
    return cut(block, list(rng.integers(0, n + 1, size=max(n // mean_length, 1))))


def resumed(online: pdr.OnlineFilter) -> pdr.OnlineFilter:
    """The filter after it was saved, without its configuration, and loaded with it.

    The default configuration has 14 MB of models: to save and load it as well takes half a second, 15 times as long.
    `test_saved.py` and `test_online_equals_offline.py` do.
    """
    return pdr.OnlineFilter.load(to_bytes({"config": None, "state": online.state}), config=online.config)


def pushed(
    online: pdr.OnlineFilter,
    blocks: Sequence[ImuBlock],
    before: Callable[[pdr.OnlineFilter, float], None] | None = None,
    n_resumed: int = 0,
) -> tuple[pdr.OnlineFilter, list[pdr.StepUpdate]]:
    """The finished filter and all its updates.

    `before` may push other things that were measured until the end of a block; its last call is for all that is left.
    The filter is saved and loaded after `n_resumed` of the blocks.
    """
    resumed_at = set(np.linspace(len(blocks) - 1, 0, n_resumed, dtype=int).tolist())
    updates: list[pdr.StepUpdate] = []
    for k, block in enumerate(blocks):
        if before and len(block.time_s):
            before(online, float(block.time_s[-1]))
        updates += online.push(
            block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut
        )
        if k in resumed_at:
            online = resumed(online)
    if before:
        before(online, np.inf)
    return online, [*updates, *online.finish()]


def streamed(
    walk: Recording, config: pdr.Config, fixes: Iterable[Any] = (), seed: int = 1, n_resumed: int = 0
) -> tuple[pdr.OnlineFilter, list[pdr.StepUpdate]]:
    """The finished filter and its updates for fixes added beforehand and samples in random blocks."""
    online = pdr.OnlineFilter(config)
    for fix in fixes:
        online.add_fix(fix)
    return pushed(online, cut_randomly(pdr.merge_streams(walk), seed), n_resumed=n_resumed)


def condition(conditioner: Conditioner, blocks: Sequence[ImuBlock]) -> tuple[ConditionerState, list[UniformBlock]]:
    state, outputs = conditioner.init(), []
    for block in blocks:
        state, uniform = conditioner.update(state, block)
        outputs += uniform
    return state, outputs


def joined(blocks: Sequence[UniformBlock]) -> dict[str, np.ndarray]:
    """All columns of consecutive blocks; the gap before a block stands at its first sample."""
    names = [f.name for f in fields(UniformBlock) if f.name != "gap_before_s"]
    columns = {name: np.concatenate([getattr(b, name) for b in blocks]) for name in names}
    gaps = [np.concatenate([[b.gap_before_s], np.zeros(len(b.time_s) - 1)]) for b in blocks]
    return {**columns, "gap_before_s": np.concatenate(gaps)}


def assert_same_bits(actual: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert actual.keys() == expected.keys()
    for name in expected:
        np.testing.assert_array_equal(actual[name], expected[name], err_msg=name)


def uniform_block(
    magnitude: FloatArray,
    rate_hz: float = 100.0,
    gap_before_s: float = np.inf,
    start_s: float = 0.0,
    rate: FloatArray | None = None,
    field: FloatArray | None = None,
) -> UniformBlock:
    """Uniform samples of a phone face up, whose |specific force| is given."""
    n = len(magnitude)
    zeros = np.zeros((n, 3))
    return UniformBlock(
        time_s=start_s + (np.arange(n) + 0.5) / rate_hz,
        specific_force_mps2=np.column_stack([np.zeros(n), np.zeros(n), magnitude]),
        angular_rate_radps=zeros if rate is None else rate,
        angular_rate_known=np.full(n, rate is not None),
        turn_known=np.full(n, rate is not None),
        magnetic_field_ut=zeros if field is None else field,
        magnetic_field_known=np.full(n, field is not None),
        gap_before_s=gap_before_s,
    )


def cut_uniform(block: UniformBlock, edges: Sequence[int]) -> list[UniformBlock]:
    """The block in non-empty pieces; only the first has the gap before it."""
    n = len(block.time_s)
    unique = sorted({0, n, *(e % n for e in edges)})
    pieces = []
    for a, b in pairwise(unique):
        columns = {
            f.name: getattr(block, f.name)[a:b] if f.name != "gap_before_s" else (block.gap_before_s if a == 0 else 0.0)
            for f in fields(UniformBlock)
        }
        pieces.append(UniformBlock(**columns))
    return pieces


def flat_attitude(magnitude: FloatArray, heading_rad: FloatArray | None = None) -> AttitudeBlock:
    """Attitude of a phone face up, whose |specific force| is given."""
    n = len(magnitude)
    return AttitudeBlock(
        vertical_mps2=magnitude - STANDARD_GRAVITY_MPS2,
        horizontal_mps2=np.zeros((n, 2)),
        up_sensor=np.tile([0.0, 0.0, 1.0], (n, 1)),
        device_heading_rad=np.zeros(n) if heading_rad is None else heading_rad,
    )


def sensed(sensing: Sensing, blocks: Sequence[ImuBlock]) -> list[tuple[float, Event]]:
    """All events of the front end, the end of the recording included."""
    state, events = sensing.init(), []
    for block in blocks:
        state, found = sensing.update(state, block)
        events += found
    return [*events, *sensing.finish(state)[1]]


def bumps(time_s: np.ndarray, contacts_s: np.ndarray, amplitude_mps2: float, frequency_hz: float) -> np.ndarray:
    """|f| with one bump of zero mean at each contact."""
    u = (time_s[:, None] - contacts_s) * frequency_hz / 0.225
    return STANDARD_GRAVITY_MPS2 + amplitude_mps2 * ((1 - u**2) * np.exp(-(u**2) / 2)).sum(axis=1)


def walk_of_bumps(
    frequency_hz: float, amplitude_mps2: float, n: int = 20, rate_hz: float = 100.0
) -> tuple[np.ndarray, ...]:
    """Contacts and |f| at the middles of the samples: 3 s of rest, n steps, 3 s of rest."""
    contacts_s = 3.0 + np.arange(n) / frequency_hz
    time_s = (np.arange(int((contacts_s[-1] + 3.0) * rate_hz)) + 0.5) / rate_hz
    return contacts_s, bumps(time_s, contacts_s, amplitude_mps2, frequency_hz)


def true_position_m(recording: Recording, time_s: FloatArray | float) -> FloatArray:
    """True positions (..., 2) at some times."""
    truth = recording.truth.position
    return np.stack([np.interp(time_s, truth.time_s, truth[name]) for name in ("east_m", "north_m")], axis=-1)


def clockwise(angle_rad: float) -> FloatArray:
    """Matrix (2, 2) that rotates vectors (east, north) clockwise."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, s], [-s, c]])


def nees_of(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Normalised squared errors (K,) of errors (K, n) with covariances (K, n, n)."""
    return np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov), error)


def push_part(
    online: pdr.OnlineFilter, samples: ImuBlock, part: slice | np.ndarray = slice(None)
) -> list[pdr.StepUpdate]:
    """Push a part of merged samples into a filter, without their magnetic field."""
    block = part_of(samples, part)
    return online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps)


@dataclass(frozen=True)
class OfHeading:
    """Measurement of the walking heading by a class of a user, without a base class."""

    time_s: float
    heading_rad: float
    std_rad: float = 0.1
    received_time_s: float | None = None

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        error = float(wrap_angle(heading_rad - self.heading_rad))
        return np.array([error]), np.array([[0.0, 0.0, 1.0]]), np.array([[self.std_rad**2]])


def block_of(force: FloatArray, rate: FloatArray | None = None) -> UniformBlock:
    """Uniform samples at 100 Hz of specific force and angular rate (N, 3)."""
    return replace(uniform_block(np.zeros(len(force)), rate=rate), specific_force_mps2=force)


def conditioned(recording: Recording) -> list[UniformBlock]:
    return condition(Conditioner(), [merge_streams(recording)])[1]


def run_stage(stage: Any, blocks: Sequence[UniformBlock]) -> tuple[Any, list[tuple[int, Any]]]:
    """State and windows of a stage for a phone that lies face up."""
    state, found = stage.init(), []
    for block in blocks:
        state, windows = stage.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]))
        found += windows
    return state, found


def detect(
    detector: Any, blocks: Sequence[UniformBlock], contexts: Sequence[ContextBlock] | None = None
) -> tuple[Any, list[tuple[int, Step]]]:
    """State and steps of a detector for a phone that lies face up, by default in unknown contexts."""
    state, found = detector.init(), []
    for block, known in zip(blocks, contexts or [unknown_contexts(len(b.time_s)) for b in blocks], strict=True):
        state, steps = detector.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]), known)
        found += steps
    return state, found


def times_s(found: Sequence[tuple[int, Step]]) -> FloatArray:
    return np.array([step.time_s for _, step in found])


def assert_one_step_at_each(contacts_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> None:
    """Each contact has its step; a detector may add one before the first and after the last."""
    inside = (found_s > contacts_s[0] - tolerance_s) & (found_s < contacts_s[-1] + tolerance_s)
    np.testing.assert_allclose(found_s[inside], contacts_s, atol=tolerance_s)
    assert len(found_s) <= len(contacts_s) + 2


def assert_last_steps_at_their_times(
    detector: Any,
    contacts_s: FloatArray,
    block: UniformBlock,
    contexts: Sequence[ContextBlock] | None = None,
    tolerance_s: float = 0.06,
) -> list[Step]:
    """At the end the steps that were not known yet come; these are returned."""
    state, found = detect(detector, [block], contexts)
    last = detector.finish(state)
    assert len(last) > 0
    every = times_s([*found, *last])
    assert (np.diff(every) > 0).all()
    assert_one_step_at_each(contacts_s, every, tolerance_s)
    assert all(s.time_s <= s.detected_time_s == block.time_s[-1] for _, s in last)
    return [step for _, step in last]


def contacts_of(recording: Recording, sensing: Sensing) -> FloatArray:
    """Times of the steps that a front end detects in a recording."""
    return np.array([e.time_s for _, e in sensed(sensing, [merge_streams(recording)]) if isinstance(e, Step)])


def count_error(recording: Recording, found_s: FloatArray) -> float:
    """Relative error of the number of steps in the only segment of a recording."""
    [segment] = recording.truth.segments
    n = ((found_s > segment.start_s - 0.3) & (found_s < segment.end_s + 0.3)).sum()
    return float(n / segment.n_steps - 1)


def against_foot_switches(recording: Recording, found_s: FloatArray) -> tuple[float, FloatArray]:
    """Relative error of the number of steps, and the times of the nearest steps less those of foot switches."""
    truth_s = np.asarray(recording.truth.steps.time_s)
    found_s = found_s[(found_s > truth_s[0] - 0.3) & (found_s < truth_s[-1] + 0.3)]
    nearest_s = found_s[np.abs(found_s[:, None] - truth_s).argmin(axis=0)]
    return len(found_s) / len(truth_s) - 1, nearest_s - truth_s


def steps_of(recording: Recording) -> list[Step]:
    sensing = Sensing(steps=WaveletStepDetector())
    return [e for _, e in sensed(sensing, [merge_streams(recording)]) if isinstance(e, Step)]


def a_step(
    time_s: float = 1.0,
    *,
    heading_rad: float = 0.0,
    duration_s: float = 0.5,
    variance: float = 4.0,
    heading_unknown_s: float = 0.0,
) -> Step:
    return Step(
        time_s=time_s,
        detected_time_s=time_s + 0.6,
        duration_s=duration_s,
        frequency_hz=1.0 / duration_s,
        variance=variance,
        vertical_max_mps2=3.0,
        vertical_min_mps2=-3.0,
        magnitude_max_mps2=13.0,
        magnitude_min_mps2=7.0,
        mean_abs_mps2=1.5,
        heading_change_rad=0.0,
        device_heading_rad=heading_rad,
        heading_unknown_s=heading_unknown_s,
        vertical_amplitude_mps2=2.0,
    )


def windows_of(time_s: np.ndarray, context_prob: np.ndarray, contexts: tuple[str, ...] = CONTEXTS) -> Windows:
    """Windows of which only the contexts are known."""
    n = len(time_s)
    none = np.full(n, np.nan)
    return Windows(
        time_s, context_prob, contexts, np.full((n, 5), 0.2), CARRYING_MODES, *np.zeros((3, n)), none, ("",) * n
    )


def mode_of_each_context(sideways_rad: float = np.pi / 2) -> tuple[Mode, ...]:
    """Return modes with different lengths that depend on the step."""
    theta = np.array([[0, 0, 0], [0.3, 0.2, 0.01], [0.2, 0.05, 0], [0.3, 0.1, 0], [0.4, 0, 0], [0.2, 0.3, 0.02]])
    return tuple(
        Mode(
            context,
            context,
            StepLengthFit(FrequencyVarianceStepLength(), t, np.eye(3) * 1e-4, 0.05),
            heading_offset_rad=sideways_rad if context == "sideways" else 0.0,
            moves=context != "stationary",
            climbs={"upstairs": 1, "downstairs": -1}.get(context, 0),
        )
        for context, t in zip(CONTEXTS, theta, strict=True)
    )


def even_transitions(n_modes: int, stay_prob: float) -> np.ndarray:
    """Transition matrix (M, M) that stays with one probability and leaves for every other mode alike."""
    if n_modes == 1:
        return np.ones((1, 1))
    leave = (1 - stay_prob) / (n_modes - 1)
    return np.full((n_modes, n_modes), leave) + (stay_prob - leave) * np.eye(n_modes)


def updates_of(result: tuple[T, tuple[StepUpdate, ...]]) -> tuple[T, list[StepUpdate]]:
    """State and updates of what a tracker returns."""
    state, updates = result
    return state, list(updates)


def tracker_of(weighting: str, model: PedestrianModel) -> ImmTracker | WeightedTracker:
    """The tracker of a weighting, with its usual threshold."""
    if weighting == "imm":
        return ImmTracker(model)
    return WeightedTracker(model, HC if weighting == "hc" else 0.8)


def from_hand_to_pocket() -> Recording:
    """Two minutes through all contexts of the simulator; the phone is put away on the way."""
    right = np.pi / 2
    legs = [
        Leg("stationary", duration_s=5.0),
        Leg("walking", distance_m=30.0),
        Leg("walking", distance_m=34.0, turn_rad=right),
        Leg("stationary", duration_s=5.0, carrying_mode="pocket"),
        Leg("upstairs", distance_m=5.22),
        Leg("walking", distance_m=16.0, turn_rad=right),
        Leg("sideways", distance_m=6.0),
        Leg("stationary", duration_s=6.0),
        Leg("running", distance_m=28.0, turn_rad=right),
        Leg("downstairs", distance_m=5.22),
        Leg("stationary", duration_s=4.0),
        Leg("walking", distance_m=14.0, turn_rad=-right),
        Leg("stationary", duration_s=5.0),
    ]
    return simulate(legs, Gait(height_m=1.86), name="from_hand_to_pocket")


def a_plan(folder: Path) -> FloorPlan:
    """A square of 60 m with a room and a wall."""

    def feature(kind: str, shape: str, corners: Any) -> dict[str, Any]:
        return {"type": "Feature", "properties": {"type": kind}, "geometry": {"type": shape, "coordinates": corners}}

    def square(low: float, high: float) -> list[list[list[float]]]:
        return [[[low, low], [high, low], [high, high], [low, high], [low, low]]]

    features = [
        feature("wall", "LineString", [[0.0, 0.0], [5.0, 0.0]]),
        feature("room", "Polygon", square(2.0, 8.0)),
        feature("floor", "Polygon", square(-10.0, 50.0)),
    ]
    path = folder / "plan.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return FloorPlan.read(path)
