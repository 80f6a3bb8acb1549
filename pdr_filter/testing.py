"""Checks of user-defined parts for the interfaces in `pdr_filter.protocols`: block sizes, saving, clocks and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.models import TYPICAL_STEP, StepLengthFit, length_and_jacobian
from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock, merge_streams
from pdr_filter.sensing.contexts.context_stage import ContextStage
from pdr_filter.sensing.heading.heading_stage import HeadingStage
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.detector_protocol import StepDetector
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FloatArray, Step, WindowContext, measurement_of, wrap_angle
from pdr_filter.values.schema import missing_members
from pdr_filter.values.serialisation import from_bytes, to_bytes

__all__ = ["verify_fix", "verify_stage", "verify_step_length"]


def __dir__() -> list[str]:
    return __all__


# Duration of the test walk in s, and times at which states are saved and loaded.
_WALK_S, _SAVED_AFTER_S = 18.0, (0.01, 4.3, 9.03, 13.33)
_SHIFT_S = 1024.0
# Range of step durations: 0.2 s for running, 2.5 s for slow walking or first steps.
_MIN_STEP_S, _MAX_STEP_S = 0.2, 2.5
_MIN_LENGTH_M, _MAX_LENGTH_M = 0.2, 2.5
_FEWEST_STEPS = 6


@dataclass(frozen=True)
class StageSamples:
    """Inputs of a stage for some samples: the block of samples, the attitude, the contexts, and the detected steps."""

    block: UniformBlock
    attitude: AttitudeBlock
    contexts: ContextBlock
    steps: tuple[tuple[int, Step], ...] = ()  # detected steps with the sample of their detection in the segment
    first: int = 0  # number of the first sample in the segment

    def __len__(self) -> int:
        return len(self.block.time_s)

    def part(self, a: int, b: int) -> StageSamples:
        """Return the samples from index a to index b. Only a part with the first sample keeps the gap before it."""

        def cut(columns: Any) -> Any:
            values = {f.name: getattr(columns, f.name) for f in fields(columns)}
            n = len(self)
            return replace(
                columns, **{k: v[a:b] for k, v in values.items() if isinstance(v, np.ndarray) and len(v) == n}
            )

        block = replace(cut(self.block), gap_before_s=self.block.gap_before_s if a == 0 else 0.0)
        steps = tuple(found for found in self.steps if self.first + a <= found[0] < self.first + b)
        return StageSamples(block, cut(self.attitude), cut(self.contexts), steps, self.first + a)

    def cut(self, edges: Sequence[int]) -> list[StageSamples]:
        """Return consecutive, non-empty parts of these samples, cut at indices modulo their number."""
        n = len(self)
        return [self.part(a, b) for a, b in pairwise(sorted({0, *(e % n for e in edges), n}))]

    def later(self, shift_s: float) -> StageSamples:
        """Return the samples with all times, also the times of steps, later by `shift_s` seconds."""
        block = replace(self.block, time_s=self.block.time_s + shift_s)
        steps = tuple(
            (n, replace(s, time_s=s.time_s + shift_s, detected_time_s=s.detected_time_s + shift_s))
            for n, s in self.steps
        )
        return replace(self, block=block, steps=steps)


@lru_cache(maxsize=8)
def stage_samples(rate_hz: float = 100.0, seed: int = 0) -> StageSamples:
    """Return the inputs of a stage for 18 s of a noisy simulated walk with a right turn.

    The phone is taken out of a pocket, the angular rate is missing for 1 s, and the carrying mode changes every 3.5 s.
    """
    legs = [
        Leg("walking", distance_m=12.0),
        Leg("walking", distance_m=18.0, turn_rad=np.pi / 2, carrying_mode="texting"),
    ]
    recording = simulate(legs, carrying_mode="pocket", seed=seed % 3)
    conditioner, n = Conditioner(rate_hz), round(_WALK_S * rate_hz)
    state, blocks = conditioner.update(conditioner.init(), merge_streams(recording))
    (block,) = [*blocks, *conditioner.finish(state)[1]][:1]
    names = [f.name for f in fields(block) if f.name != "gap_before_s"]
    block = replace(block, **{name: np.array(getattr(block, name)[:n]) for name in names})
    rng = np.random.default_rng(seed)
    block.specific_force_mps2[:] += 0.5 * rng.normal(size=(n, 3))
    block.angular_rate_known[round(6 * rate_hz) : round(7 * rate_hz)] = False
    estimator = AttitudeEstimator(rate_hz)
    _, attitude = estimator.update(estimator.init(), block)
    carried = np.array([CARRYING_MODES.index(mode) for mode in ("pocket", "texting", "swinging")])
    mode = carried[np.arange(n) // round(3.5 * rate_hz) % 3]
    contexts = ContextBlock(np.full(n, CONTEXTS.index("walking")), mode)
    detector = AdaptiveStepDetector(rate_hz)
    _, steps = detector.update(detector.init(), block, attitude, contexts)
    return StageSamples(block, attitude, contexts, tuple(steps))


class _Run:
    """Uniform interface to step detectors, heading stages and context stages."""

    def __init__(self, stage: Any) -> None:
        self.stage, self.name = stage, type(stage).__name__
        self.protocol = self._protocol()
        missing = missing_members(stage, self.protocol)
        if missing:
            self.fail(f"has no {', '.join(missing)}; see pdr_filter.protocols.{self.protocol.__name__}")

    def _protocol(self) -> type:
        if hasattr(self.stage, "hop_s"):
            return ContextStage
        return StepDetector if hasattr(self.stage, "latency_s") else HeadingStage

    @property
    def is_detector(self) -> bool:
        return self.protocol is StepDetector

    def fail(self, what: str) -> None:
        raise AssertionError(f"{self.name} {what}")

    def update(self, state: Any, samples: StageSamples) -> tuple[Any, list[tuple[int, Any]]]:
        inputs: list[Any] = [samples.block, samples.attitude]
        if self.protocol is not ContextStage:
            inputs.append(samples.contexts)
        if self.protocol is HeadingStage:
            inputs.append(list(samples.steps))
        result = self.stage.update(state, *inputs)
        if not (isinstance(result, tuple) and len(result) == 2):
            self.fail("must return (state, found) from update")
        state, found = result
        kind = WindowContext if self.protocol is ContextStage else Step
        for item in found:
            if not (isinstance(item, tuple) and len(item) == 2 and isinstance(item[1], kind)):
                self.fail(
                    f"must return (number of the sample, {kind.__name__}) pairs from update, got {str(item)[:80]}"
                )
        return state, list(found)

    def over(self, pieces: Sequence[StageSamples], state: Any = None) -> tuple[Any, list[tuple[int, Any]]]:
        state = self.stage.init() if state is None else state
        found: list[tuple[int, Any]] = []
        for piece in pieces:
            state, new = self.update(state, piece)
            found += new
        return state, found

    def finish(self, state: Any) -> list[tuple[int, Any]]:
        if self.is_detector:
            return list(self.stage.finish(state))
        return list(self.stage.finish(state, [])[1]) if self.protocol is HeadingStage else []


def bits(found: Sequence[tuple[int, Any]]) -> bytes:
    """Return bytes that are equal if and only if the steps or windows are bit-identical."""
    return to_bytes(tuple(found))


def verify_stage(stage: Any) -> None:
    """Check that a stage conforms to its interface in `pdr_filter.protocols`.

    The stage processes a simulated walk of 18 s. It must

    - give bit-identical results for any division of the samples into blocks;
    - not modify states that were passed to it;
    - continue identically from a saved state;
    - give the same results when all times are shifted;
    - return steps, headings or windows in the correct units.

    Parameters
    ----------
    stage : StepDetector, HeadingStage or ContextStage
        Stage to check. Its kind follows from its members.

    Raises
    ------
    AssertionError
        If a requirement is violated. The message names the requirement and the remedy.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.testing.verify_stage(pdr.recipes.default().sensing.steps)
    """
    run = _Run(stage)
    samples = stage_samples(float(getattr(stage, "rate_hz", 100.0)))
    state, whole = run.over([samples])
    _check_units(run, samples, whole)
    rng = np.random.default_rng(1)
    cuts = [samples.cut(rng.integers(0, len(samples), n).tolist()) for n in (1, 5, 40)]
    for pieces in cuts:
        cut_state, found = run.over(pieces)
        if bits(found) != bits(whole) or bits(run.finish(cut_state)) != bits(run.finish(state)):
            run.fail(
                "gives different results if the same samples come in other blocks: keep all memory in the state, and "
                "use no mean or filter over a whole block"
            )
    few = samples.part(0, len(samples) // 2)
    if bits(run.over([few.part(k, k + 1) for k in range(len(few))])[1]) != bits(run.over([few])[1]):
        run.fail("gives different results if samples come one by one: blocks may have any number of samples")
    _check_states(run, samples, whole, state)
    _, late = run.over([samples.later(_SHIFT_S)])
    if [n for n, _ in late] != [n for n, _ in whole] or not np.allclose(
        [e.time_s for _, e in late], [e.time_s + _SHIFT_S for _, e in whole], rtol=0, atol=1e-6
    ):
        run.fail(f"gives different results if all times are {_SHIFT_S:g} s later: use only differences of times")


def _check_states(run: _Run, samples: StageSamples, whole: list[tuple[int, Any]], end: Any) -> None:
    """Check that states are not modified, and that a saved state continues identically."""
    rate_hz = len(samples) / _WALK_S
    for after_s in _SAVED_AFTER_S:
        first, second = samples.cut([round(after_s * rate_hz)])
        state, before = run.over([first])
        run.finish(state)
        once = run.over([second], state)[1]
        if bits(once) != bits(run.over([second], state)[1]) or bits([*before, *once]) != bits(whole):
            run.fail(
                "changes a state that was passed to it: update and finish must return new states and not modify others"
            )
        try:
            loaded = from_bytes(to_bytes(state, run.stage.init()), run.stage.init())
        except (TypeError, ValueError) as error:
            run.fail(f"has a state that cannot be saved ({error})")
            return
        loaded, after = run.over([second], loaded)
        if bits([*before, *after, *run.finish(loaded)]) != bits([*whole, *run.finish(end)]):
            run.fail("continues differently from a saved state: keep everything that changes in the state")


def _check_units(run: _Run, samples: StageSamples, found: list[tuple[int, Any]]) -> None:
    numbers, times_s = [n for n, _ in found], samples.block.time_s
    if len(found) < _FEWEST_STEPS:
        run.fail(f"returns {len(found)} steps or windows in 18 s of walking; at least {_FEWEST_STEPS} are expected")
    if numbers != sorted(numbers) or not 0 <= numbers[0] <= numbers[-1] < len(samples):
        run.fail(
            f"must return results in order, with the number of the sample of their detection, 0 to {len(samples) - 1}"
        )
    if run.protocol is ContextStage:
        _check_windows(run, found)
        return
    for number, step in found:
        if step.time_s > times_s[number] + 1e-9:
            run.fail(
                f"is not causal: it returns a step at {step.time_s:.2f} s from samples up to {times_s[number]:.2f} s"
            )
    if run.is_detector:
        _check_steps(run, samples, [step for _, step in found])
    else:
        _check_headings(run, [step for _, step in found])


def _check_steps(run: _Run, samples: StageSamples, steps: list[Step]) -> None:
    latency_s = float(run.stage.latency_s) + 1.0 / float(run.stage.rate_hz)
    for step in steps:
        if not (_MIN_STEP_S <= step.duration_s <= _MAX_STEP_S and abs(step.duration_s * step.frequency_hz - 1) < 1e-6):
            run.fail(
                f"returns a step of {step.duration_s} s and {step.frequency_hz} Hz; "
                "durations are in s, frequencies in Hz"
            )
        if not -1e-6 <= step.detected_time_s - step.time_s <= latency_s + 1e-6:
            run.fail(
                f"returns a step {step.detected_time_s - step.time_s:.2f} s after its contact, which exceeds its "
                f"latency_s of {run.stage.latency_s:.2f} s"
            )
    near = np.abs(np.subtract.outer([s.time_s for s in steps], samples.block.time_s)).min(axis=1)
    if near.max() > 0.02:
        run.fail("returns contacts at times without samples: time_s of a step is in s on the clock of the samples")


def _check_headings(run: _Run, steps: list[Step]) -> None:
    std = np.array([s.walking_heading_std_rad for s in steps])
    if not (std >= 0).all():
        run.fail("must return a walking_heading_std_rad of 0 or more for each step, infinite for an unknown heading")
    known = [s for s in steps if np.isfinite(s.walking_heading_std_rad)]
    if len(known) > _FEWEST_STEPS:
        turned = known[-1].walking_heading_rad - known[0].walking_heading_rad
        if abs(float(wrap_angle(turned - np.pi / 2))) > 1.2 or abs(turned) > 4 * np.pi:
            run.fail(f"returns a turn of {turned:.2f} rad for a right turn of 1.57 rad: headings are clockwise, in rad")


def _check_windows(run: _Run, found: list[tuple[int, Any]]) -> None:
    shapes = {np.shape(window.prob) for _, window in found}
    if len(shapes) != 1:
        run.fail(f"returns probabilities of different shapes, {shapes}")
    for _, window in found:
        if not (np.all(window.prob >= 0) and abs(float(np.sum(window.prob)) - 1.0) < 1e-6):
            run.fail(f"returns context probabilities {window.prob}, which must be non-negative with sum one")


def verify_step_length(model: Any) -> None:
    """Check that a step-length model conforms to `pdr_filter.protocols.StepLengthModel`.

    Shapes are checked, and the Jacobian is compared with finite differences, for the steps of a simulated walk.

    Parameters
    ----------
    model : StepLengthModel or StepLengthFit
        Model to check. A `StepLengthFit` is checked with its parameters, for which step lengths must be plausible
        lengths in m.

    Raises
    ------
    AssertionError
        If a requirement is violated. The message names the requirement.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import bounce_fit
    >>> pdr.testing.verify_step_length(bounce_fit(1.8))
    """
    theta = None
    if isinstance(model, StepLengthFit):
        model, theta = model.model, model.theta
    name = type(model).__name__
    p = getattr(model, "n_params", None)
    if not (isinstance(p, int) and p > 0):
        raise AssertionError(f"{name} must have n_params, the number of parameters, got {p!r}")
    is_linear = hasattr(model, "regressors")
    if not is_linear and not (hasattr(model, "length_m") and hasattr(model, "jacobian")):
        raise AssertionError(f"{name} must have regressors(step), or length_m(step, theta) and jacobian(step, theta)")
    steps = [TYPICAL_STEP, *(step for _, step in stage_samples().steps)]
    rng = np.random.default_rng(0)
    for step in steps:
        for point in (np.full(p, 0.5), rng.uniform(0.2, 1.0, p)) if theta is None else (theta,):
            _check_length(name, model, step, point, is_linear)
    if theta is not None:
        lengths_m = [float(length_and_jacobian(model, step, theta)[0]) for step in steps]
        if not _MIN_LENGTH_M < float(np.median(lengths_m)) < _MAX_LENGTH_M:
            raise AssertionError(f"{name} gives walking steps of {np.median(lengths_m):.3g} m; lengths are in m")


def _check_length(name: str, model: Any, step: Step, theta: FloatArray, is_linear: bool) -> None:
    length, jacobian = length_and_jacobian(model, step, theta)
    if np.shape(length) != () or np.shape(jacobian) != theta.shape:
        raise AssertionError(
            f"{name} must return a number and a Jacobian of shape {theta.shape}, got shapes {np.shape(length)} and "
            f"{np.shape(jacobian)}"
        )
    if not (np.isfinite(length) and np.isfinite(jacobian).all()):
        raise AssertionError(f"{name} must return finite numbers, got {length} and {jacobian} for {step}")
    many = np.stack([theta, 1.1 * theta, 0.9 * theta])
    if not is_linear and (np.shape(model.length_m(step, many)), np.shape(model.jacobian(step, many))) != (
        (3,),
        many.shape,
    ):
        raise AssertionError(
            f"{name} must accept theta with leading axes, (..., {len(theta)}), and return lengths (...,) "
            f"and a Jacobian (..., {len(theta)})"
        )

    def length_at(theta: FloatArray) -> FloatArray:
        return length_and_jacobian(model, step, theta)[0]

    for k, by in enumerate(_differences(length_at, theta)):
        if abs(by - jacobian[k]) > 1e-4 * max(abs(by), 1.0):
            raise AssertionError(
                f"{name}: the derivative with respect to parameter {k} is {by:.6g} by finite differences, and "
                f"{jacobian[k]:.6g} by its Jacobian"
            )


def _differences(function: Any, at: FloatArray) -> Iterator[Any]:
    """Yield the derivatives of a function by each of the n components of a point (n,), from central differences."""
    for k in range(len(at)):
        small = np.zeros(len(at))
        small[k] = 1e-6 * max(abs(at[k]), 1.0)
        yield (function(at + small) - function(at - small)) / (2.0 * small[k])


def verify_fix(fix: Any, position_m: Sequence[float] = (1.0, 2.0), heading_rad: float = 0.3) -> None:
    """Check that a measurement conforms to `pdr_filter.protocols.Fix`.

    The Jacobian of the residual is compared with finite differences at a position and heading.

    Parameters
    ----------
    fix : Fix
        Measurement to check.
    position_m : sequence of float, default (1.0, 2.0)
        Position (east, north) in m at which the Jacobian is checked.
    heading_rad : float, default 0.3
        Walking heading in rad at which the Jacobian is checked.

    Raises
    ------
    AssertionError
        If a requirement is violated. The message names the requirement.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.testing.verify_fix(pdr.RangeFix(1.0, (3.0, 4.0), 5.2, 0.3))
    """
    name = type(fix).__name__
    for attribute in ("time_s", "received_time_s", "measurement"):
        if not hasattr(fix, attribute):
            raise AssertionError(f"{name} has no {attribute}; see pdr_filter.protocols.Fix")
    pose = np.array([*position_m, heading_rad], dtype=float)
    try:
        _, jacobian, _ = measurement_of(fix, pose[:2], heading_rad)
    except ValueError as error:
        raise AssertionError(str(error)) from None

    def residual_at(pose: FloatArray) -> FloatArray:
        return np.asarray(fix.measurement(pose[:2], float(pose[2]))[0], dtype=float)

    columns = list(_differences(residual_at, pose))
    if not np.allclose(jacobian, np.column_stack(columns), rtol=1e-3, atol=1e-5):
        raise AssertionError(
            f"{name}: the derivative of the residual with respect to east, north and heading is "
            f"{np.column_stack(columns).tolist()} by finite differences, and {jacobian.tolist()} by its Jacobian"
        )
