"""Parts of users, written outside of the package: step detectors, heading stages, step lengths, measurements."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
from helpers import cut, part_of
from own_parts import FIT, Crossings, CrossingState, DeviceHeading, Exponential, HeadingRule, RootOfRange, own_config

import pdr_filter as pdr
from pdr_filter.filter.step_length.models import bounce_fit
from pdr_filter.offline.smoothing.smooth import SmoothingMemory
from pdr_filter.sensing.contexts.context_stage import WindowStageState
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import FloatArray, Origin
from pdr_filter.values import serialisation as serialise


@pytest.fixture(scope="module")
def recording() -> pdr.Recording:
    legs = [Leg("walking", distance_m=d, turn_rad=1.5) for d in (25.0, 20.0, 25.0)]
    return simulate(legs, Gait(height_m=1.75), seed=1)


def pushed(online: pdr.OnlineFilter, recording: pdr.Recording, begin: int = 0, end: int | None = None) -> list[Any]:
    samples = part_of(pdr.merge_streams(recording), slice(begin, end))
    blocks = cut(samples, range(0, len(samples.time_s), 73))
    columns = [[getattr(block, f.name) for f in fields(block)] for block in blocks]
    return [update for block in columns for update in online.push(*block)]


def test_parts_of_other_packages_give_the_same_track_online_and_offline(recording: pdr.Recording) -> None:
    config = own_config()
    track, online = pdr.track(recording, config=config), pdr.OnlineFilter(config)
    updates = [u for u in (*pushed(online, recording), *online.finish()) if u.is_final]
    np.testing.assert_array_equal([u.position_m for u in updates], track.position_m)
    assert 80 < track.n_steps < 140
    assert track.distance_m == pytest.approx(70.0, rel=0.2)
    default = pdr.track(recording)
    assert not np.array_equal(track.steps.time_s, default.steps.time_s)


@pytest.mark.parametrize("weighting", ["imm", "hc"])
def test_steps_lead_along_the_directions_that_a_stage_states(recording: pdr.Recording, weighting: str) -> None:
    """With one known length, the path is the sum of the stated unit vectors; fixes turn it as a whole."""
    plain = pdr.recipes.default(recording.subject)
    modes = [
        replace(mode, step_length=pdr.known_length(0.7, 0.03), heading_offset_rad=0.0) for mode in plain.model.modes
    ]
    config = plain.with_modes(modes).with_heading(HeadingRule())
    track = pdr.track(recording, config=config, weighting=weighting)
    held = np.asarray(track.steps.walking_heading_rad)
    stated_m = np.cumsum(0.7 * np.column_stack([np.sin(held), np.cos(held)]), axis=0)
    moved = np.abs(np.diff(track.position_m, axis=0) - np.diff(stated_m, axis=0)).max(axis=1)
    assert len(set(held.tolist())) < 0.7 * track.n_steps and np.isfinite(track.position_cov_m2).all()
    assert np.median(moved) < 1e-3 and (track.steps.device_heading_rad != held).any()
    assert track.frame == "north" and pdr.track(recording, config=own_config()).frame == "start"
    online = pdr.OnlineFilter(replace(config.with_weighting(weighting)))
    updates = [u for u in (*pushed(online, recording), *online.finish()) if u.is_final]
    np.testing.assert_array_equal([u.position_m for u in updates], track.position_m)
    if weighting == "imm":
        turned_m = np.column_stack([stated_m[:, 1], -stated_m[:, 0]])  # by a quarter of a revolution
        fixes = [pdr.PositionFix(track.time_s[k], turned_m[k], 0.01 * np.eye(2)) for k in range(5, track.n_steps, 10)]
        smoothed = pdr.smooth(recording, fixes=fixes, config=config).track
        np.testing.assert_allclose(smoothed.position_m, turned_m, atol=0.25)


def test_a_direction_that_the_user_states_is_refused_with_a_stage_that_knows_north(recording: pdr.Recording) -> None:
    config = pdr.recipes.default().with_heading(HeadingRule())
    for given in ({"heading_rad": 1.0}, {"origin": Origin(48.0, 11.0, turn_rad=0.3)}):
        with pytest.raises(ValueError, match="stage HeadingRule knows already: omit it, or set knows_north"):
            pdr.smooth(recording, config=config, **given)


def test_a_memory_of_smoothing_compares_parts_of_other_packages() -> None:
    class Local(DeviceHeading):
        pass

    short, memory = simulate([Leg("walking", distance_m=9.0)]), SmoothingMemory()
    fixes = [pdr.PositionFix(t, [0.0, t], np.eye(2)) for t in (1.0, 5.0)]
    config = own_config()
    pdr.smooth(short, config=config, memory=memory)
    again = pdr.smooth(short, fixes=fixes, config=config, memory=memory).track.position_m
    np.testing.assert_array_equal(again, pdr.smooth(short, fixes=fixes, config=config).track.position_m)
    with pytest.raises(ValueError, match="omit memory"):
        pdr.smooth(short, config=config.with_heading(Local()), memory=memory)


def test_tracks_with_parts_of_other_packages_are_smoothed_and_drawn(recording: pdr.Recording, tmp_path: Any) -> None:
    smoothed = pdr.smooth(recording, config=own_config())
    assert smoothed.track.distance_m == pytest.approx(70.0, rel=0.2)
    from pdr_filter.apps.report.html import write_report

    write_report([smoothed.track], tmp_path / "own.html", recording)
    assert (tmp_path / "own.html").stat().st_size > 10_000


def test_a_filter_with_parts_of_other_packages_continues_after_loading_with_its_configuration(
    recording: pdr.Recording,
) -> None:
    online = pdr.OnlineFilter(own_config())
    pushed(online, recording, end=2345)
    loaded = pdr.OnlineFilter.load(online.save(), config=own_config())
    assert isinstance(loaded.state.sensing.steps, CrossingState)
    rest = [pushed(f, recording, begin=2345) for f in (online, loaded)]
    np.testing.assert_array_equal(*([u.position_m for u in updates] for updates in rest))


def test_bytes_without_configuration_require_it_and_refuse_another_one(
    recording: pdr.Recording,
) -> None:
    online = pdr.OnlineFilter(own_config())
    pushed(online, recording, end=900)
    with pytest.raises(ValueError, match=r"OnlineFilter.load\(blob, config=config\)"):
        pdr.OnlineFilter.load(online.save())
    with pytest.raises(ValueError, match="refused to load 'own_parts:CrossingState'"):
        pdr.OnlineFilter.load(online.save(), config=pdr.recipes.default())
    with pytest.raises(ValueError, match="another configuration"):
        pdr.OnlineFilter.load(online.save(), config=own_config().with_weighting("hc"))


def test_a_saved_filter_of_package_classes_can_also_be_loaded_with_its_configuration(recording: pdr.Recording) -> None:
    online = pdr.OnlineFilter()
    pushed(online, recording, end=900)
    loaded = pdr.OnlineFilter.load(online.save(), config=pdr.recipes.default())
    np.testing.assert_array_equal(loaded.position_m, online.position_m)


def test_a_state_that_cannot_be_saved_is_refused_when_it_is_saved(recording: pdr.Recording) -> None:
    class Forgetful(DeviceHeading):
        def init(self) -> Any:
            return {"n_steps": 0, "open": object()}

    with pytest.warns(UserWarning, match="save will refuse the state of Forgetful: a object cannot be saved"):
        config = pdr.recipes.default().with_heading(Forgetful())
    online = pdr.OnlineFilter(config)
    with pytest.raises(ValueError, match="the state of one of your own parts: a object"):
        online.save()


@dataclass(frozen=True)
class Bout:
    n_steps: int


class LateHeading(DeviceHeading):
    """Its state gets a value of an own class with the first steps."""

    def __init__(self, before: Any, after: Any) -> None:
        self.before, self.after = before, after

    def init(self) -> Any:
        return {"bout": self.before}

    def update(self, state: Any, block: Any, attitude: Any, contexts: Any, steps: Any) -> Any:
        _, steps = super().update({"n_steps": 0}, block, attitude, contexts, steps)
        return {"bout": self.after} if steps else state, steps


@dataclass(frozen=True)
class Stretch:
    begin_s: float
    bout: Bout | None = None


@dataclass(frozen=True)
class Walked:
    """State whose fields have no value of an own class at first."""

    last: Bout | None = None
    all: tuple[Bout, ...] = ()
    by_name: dict[str, list[Bout]] | None = None
    stretch: Stretch | None = None
    undeclared: Any = None


LATE = Walked(Bout(1), (Bout(1), Bout(2)), {"first": [Bout(1)]}, Stretch(0.5, Bout(3)))


@dataclass(frozen=True)
class Turn:  # with the fields of Bout
    n_steps: int


@dataclass(frozen=True)
class Either:
    last: Bout | Turn | None = None


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (Bout(0), Bout(3)),
        ((Bout(0),) * 2, (Bout(1), Bout(2))),
        ({"last": Bout(0)}, {"last": Bout(1)}),
        (Walked(), LATE),  # the fields declare the classes
        (Either(Bout(0)), Either(Turn(1))),
    ],
)
def test_a_state_comes_back_whose_own_classes_are_in_the_first_state_or_declared_there(
    recording: pdr.Recording, before: Any, after: Any
) -> None:
    config = pdr.recipes.default().with_heading(LateHeading(before, after))
    online = pdr.OnlineFilter(config)
    pushed(online, recording, end=900)
    assert pdr.OnlineFilter.load(online.save(), config=config).state.sensing.heading == {"bout": after}


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (None, Bout(3), r"a Bout cannot be saved, .*: let init\(\) put a"),
        ((), (Bout(1), Bout(2)), r"a Bout cannot be saved, .*: let init\(\) put a"),
        ([], [Bout(1)], r"a Bout cannot be saved, .*: let init\(\) put a"),
        (0, {"last": Bout(1)}, r"a Bout cannot be saved, .*: let init\(\) put a"),
        (Walked(), Walked(undeclared=Turn(1)), "a Turn cannot be saved, because the first state has none"),
        (Bout(0), Turn(1), "a Turn cannot be saved, because the first state has none"),
    ],
)
def test_an_own_class_that_the_first_state_neither_has_nor_declares_is_refused_when_it_is_saved(
    recording: pdr.Recording, before: Any, after: Any, message: str
) -> None:
    online = pdr.OnlineFilter(pdr.recipes.default().with_heading(LateHeading(before, after)))
    online.save()
    pushed(online, recording, end=900)
    with pytest.raises(ValueError, match=message):
        online.save()


def test_two_own_classes_of_one_name_are_refused() -> None:
    def made() -> type[Any]:
        @dataclass(frozen=True)
        class Own:
            n: int = 0

        return Own

    with pytest.raises(TypeError, match=r"two dataclasses are named .*Own"):
        serialise.to_bytes(0, (made()(), made()()))


def test_a_state_of_this_package_gets_back_the_own_classes_in_it() -> None:
    first = WindowStageState((0.0, [0.0]), Bout(0))
    loaded = serialise.from_bytes(serialise.to_bytes(WindowStageState((1.0, [2.0]), Bout(3)), first), first)
    assert (loaded.windows, loaded.memory) == ((1.0, [2.0]), Bout(3))


def test_a_part_whose_state_cannot_be_saved_is_named_when_the_configuration_is_made() -> None:
    class Stage:
        contexts, rate_hz, hop_s = ("stationary", "walking"), 100.0, 1.0

        def init(self) -> Any:
            return lambda: 0

        def after_gap(self, state: Any) -> Any:
            return state

        def update(self, state: Any, block: Any, attitude: Any) -> Any:
            return state, []

    config, modes = pdr.recipes.default(), [pdr.Mode("stationary", moves=False), pdr.Mode("walking", step_length=FIT)]
    with pytest.warns(UserWarning, match="save will refuse the state of _Lambda: a function cannot be saved"):
        config.with_steps(_Lambda())
    with pytest.warns(UserWarning, match="save will refuse the state of Stage: a function"):
        config.with_contexts(Stage(), modes)


def test_parts_without_a_state_never_stand_in_the_way_of_saving(recording: pdr.Recording) -> None:
    class Unsaved:
        n_params = 2
        scale = staticmethod(lambda: 1.0)

        def regressors(self, step: pdr.Step) -> list[float]:
            return [self.scale(), step.frequency_hz]

    def squared(prob: FloatArray) -> FloatArray:
        return prob**2 / (prob**2).sum()

    fit = pdr.StepLengthFit(Unsaved(), np.array([0.1, 0.3]), 1e-4 * np.eye(2), 0.06)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        config = pdr.recipes.default().with_weighting(squared).with_step_length("walking", fit)
        online = pdr.OnlineFilter(config)
        pushed(online, recording, end=1500)
        loaded = pdr.OnlineFilter.load(online.save(), config=config)
    np.testing.assert_array_equal(loaded.position_m, online.position_m)


def test_north_is_found_with_a_heading_stage_from_outside() -> None:
    walk = simulate([Leg("walking", distance_m=60.0)], seed=3, start_heading_rad=1.0)
    place = Origin(51.4779, -0.0015)
    track = pdr.track(walk, config=pdr.recipes.default().with_heading(DeviceHeading()), north="magnetic", origin=place)
    assert track.frame == "north"
    walked = track.position_m[-1]
    declination = place.declination_rad()
    assert math.atan2(*walked) == pytest.approx(1.0 + declination, abs=0.25)


def test_locations_use_north_with_a_heading_stage_of_another_package_unless_it_forbids_it() -> None:
    config = pdr.recipes.default()
    assert config.with_heading(DeviceHeading()).learns_directions

    class Unsure(DeviceHeading):
        learns_directions = False

    with pytest.raises(ValueError, match="does not estimate the walking direction"):
        config.with_heading(Unsure()).with_magnetic_north(0.0)


def test_missing_members_of_a_part_are_named() -> None:
    with pytest.raises(ValueError, match=r"steps must be a StepDetector .* without first_step_s, latency_s, rate_hz"):
        pdr.recipes.default().with_steps(DeviceHeading())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="a class, not one of its instances"):
        pdr.recipes.default().with_heading(DeviceHeading)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no mode or context is named 'swimming'"):
        pdr.recipes.default().with_step_length("swimming", FIT)


def test_the_checks_pass_for_parts_that_implement_the_protocols() -> None:
    for part in (Crossings(), DeviceHeading()):
        pdr.testing.verify_stage(part)
    for model in (RootOfRange(), Exponential(), FIT, bounce_fit()):
        pdr.testing.verify_step_length(model)
    pdr.testing.verify_fix(pdr.RangeFix(1.0, (3.0, 4.0, 1.0), 5.2, 0.3))


class _BlockMean(Crossings):
    def update(self, state: Any, block: Any, attitude: Any, contexts: Any) -> Any:
        level = replace(attitude, vertical_mps2=attitude.vertical_mps2 - attitude.vertical_mps2.mean())
        return super().update(state, block, level, contexts)


class _Milliseconds(Crossings):
    def update(self, state: Any, block: Any, attitude: Any, contexts: Any) -> Any:
        state, steps = super().update(state, block, attitude, contexts)
        return state, [(n, replace(step, duration_s=1000 * step.duration_s)) for n, step in steps]


class _Memory(DeviceHeading):
    def __init__(self) -> None:
        self.n = 0

    def update(self, state: Any, block: Any, attitude: Any, contexts: Any, steps: Any) -> Any:
        state, steps = super().update(state, block, attitude, contexts, steps)
        self.n += len(steps)
        return state, [(n, replace(step, direction_trust=self.n / 1000)) for n, step in steps]


class _Degrees(DeviceHeading):
    @staticmethod
    def _directed(step: pdr.Step) -> pdr.Step:
        return replace(step, walking_heading_rad=math.degrees(step.device_heading_rad), walking_heading_std_rad=20.0)


class _Lambda(Crossings):
    def init(self) -> Any:
        return replace(super().init(), low=lambda: 0.0)  # type: ignore[arg-type]

    def update(self, state: Any, block: Any, attitude: Any, contexts: Any) -> Any:
        before = replace(state, low=state.low() if callable(state.low) else state.low)
        state, steps = super().update(before, block, attitude, contexts)
        low = state.low
        return replace(state, low=lambda: low), steps  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (_BlockMean(), "in other blocks"),
        (_Milliseconds(), "durations are in s"),
        (_Memory(), "in other blocks|changes a state"),
        (_Degrees(), "clockwise, in rad"),
        (_Lambda(), "cannot be saved"),
        (object(), "has no"),
    ],
    ids=["mean of a block", "milliseconds", "hidden state", "degrees", "state that cannot be saved", "no stage"],
)
def test_a_stage_that_breaks_the_protocol_is_refused_with_the_reason(part: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        pdr.testing.verify_stage(part)


class _WrongSlope(Exponential):
    def jacobian(self, step: pdr.Step, theta: FloatArray) -> FloatArray:
        return 2.0 * super().jacobian(step, theta)


class _OneTheta(Exponential):
    def length_m(self, step: pdr.Step, theta: FloatArray) -> FloatArray:
        return np.asarray(math.exp(theta.ravel()[0]))

    def jacobian(self, step: pdr.Step, theta: FloatArray) -> FloatArray:
        return np.full(theta.shape, self.length_m(step, theta))


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (_WrongSlope(), "by finite differences"),
        (_OneTheta(), "leading axes"),
        (object(), "n_params"),
        (replace(FIT, theta=100 * FIT.theta), "lengths are in m"),
    ],
)
def test_a_step_length_that_breaks_the_protocol_is_refused_with_the_reason(model: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        pdr.testing.verify_step_length(model)


def test_waiting_measurements_of_user_classes_are_not_saved_and_cause_a_warning(recording: pdr.Recording) -> None:
    class Line:
        time_s, received_time_s = 8.9, None

        def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
            return position_m[:1] - 1.0, np.array([[1.0, 0.0]]), np.eye(1)

    online = pdr.OnlineFilter()
    pushed(online, recording, end=900)
    online.add_fix(Line())
    with pytest.warns(UserWarning, match="1 waiting measurements are not saved"):
        blob = online.save()
    assert pdr.OnlineFilter.load(blob).state.waiting_fixes == ()


class PlainRootOfRange:  # no dataclass
    n_params = 2

    def regressors(self, step: pdr.Step) -> list[float]:
        return RootOfRange().regressors(step)


@pytest.mark.parametrize("model", [RootOfRange, PlainRootOfRange])
def test_a_calibrated_model_of_another_package_is_saved_and_loaded_with_its_configuration(
    model: Any, tmp_path: Any
) -> None:
    config = pdr.recipes.default().with_step_length("walking", replace(FIT, model=model()))
    legs = [Leg("walking", distance_m=20.0), Leg("stationary", duration_s=3.0)] * 4
    walk = simulate(legs, Gait(height_m=1.8), seed=2)
    calibration = pdr.calibrate(walk, config=config)
    assert isinstance(calibration.models["walking"], model)
    again = pdr.track(walk, config=config, calibration=calibration)
    assert again.distance_m == pytest.approx(80.0, rel=0.03)
    path = tmp_path / "own.json"
    calibration.save(path)
    assert "RootOfRange" not in path.read_text()
    with pytest.raises(ValueError, match="pass the configuration"):
        pdr.track(walk, calibration=path)
    np.testing.assert_array_equal(pdr.track(walk, config=config, calibration=path).position_m, again.position_m)
