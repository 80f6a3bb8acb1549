"""Where a person walks, from a phone carried anywhere: the body's push forward shows in every stride.

The horizontal specific force at step frequency, in phase with the vertical one advanced by 85 degrees (minus the
vertical velocity), points where the person walks, sign included. Running has another phase; a swinging hand moves at
stride frequency, and its horizontal force in phase with its vertical one points forward (docs/methods/heading.md).

What is learnt is the angle from the device to the walking heading, which stays while the phone stays in its place.
Strides count by how well they agree with each other (`phone_placement`); the phone's own axis counts where somebody
reads on it, and after the phone was moved to another place the last walking direction does, and what was learnt in a
former place that this looks like. A track needs only how the angle differs from that of the first place
(`heading_offset`), less what the gyroscope's bias and the axes of a building say of the device's own heading
(`corridors`).

The angle is learnt in the attitude's own frame (`AttitudeBlock.horizontal_mps2`) and said against `device_heading_rad`,
both averaged over a stride: how the two relate does not matter, and swings cancel. What is reported to the filter of
each step is only what is new: `pdr_filter.sensing.heading.reported_heading`.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.heading.corridors import Corridors, CorridorState
from pdr_filter.sensing.heading.heading_offset import OF_AXIS, OF_STRIDES, UNKNOWN_STD_RAD, UNKNOWN_VAR_RAD2, Offset
from pdr_filter.sensing.heading.phone_placement import Placement, StrideAgreement
from pdr_filter.sensing.heading.reported_heading import Reported, Shown
from pdr_filter.sensing.heading.stride_harmonics import Phases, Stride, StrideSamples, carry_axis, strides_of
from pdr_filter.sensing.heading.vectors import Vector, combined, cross, dot, unit
from pdr_filter.sensing.steps.step_detector import ContextBlock, unknown_contexts
from pdr_filter.values import (
    CARRYING_MODES,
    FloatArray,
    HeadingDrift,
    Step,
    Table,
    check_numbers,
    replace_unchecked,
    wrap_angle,
)

_TEXTING = CARRYING_MODES.index("texting")

# Rows of the remembered signals.
_TIME, _FORCE, _UP, _EAST, _NORTH, _VERTICAL, _HEADING, _KNOWN = 0, slice(1, 4), slice(4, 7), 7, 8, 9, 10, 11
_ERROR, _ERROR_VAR, _LOST_VAR = 12, 13, 14
_N_ROWS = 15

# Two steps between these are a stride: 0.9 to 4.5 steps a second, as the step detectors have it.
_MIN_STRIDE_S, _MAX_STRIDE_S = 0.45, 2.2
_MAX_LATENCY_S = 8.0
# A step longer than this part of the stride is not one of two alike: one was missed, or the walk has just begun.
_MAX_SHARE = 0.68
# So many strides of a place are told from others by their sum alone.
_YOUNG_STRIDES = 30
# Strides that agree so well speak for themselves, against a phone's axis that is this far off: people walk where they
# read, but do not hold the phone upright always.
_OVERRULES_AXIS, _AGAINST_AXIS_RAD = 0.6, math.radians(50.0)
# Strides after which a direction is good enough to be kept when the phone is moved.
_SETTLED_STRIDES = 4
# Former places that are remembered: a look at the phone may be two.
_N_FORMERS = 3
# Strides over which the up direction of a place is averaged.
_UP_STRIDES = 8.0
# Strides that are described at once: their samples fit into a cache.
_MAX_GROUP = 32
# Classifiers of carrying modes look at some seconds, and follow slowly.
_LABEL_LAG_S = 10.0
_NOWHERE = (0.0, 0.0, 0.0)
# People turn while nothing is known of it: 3 degrees in a second, as a random walk.
_TURN_VAR_RAD2_PER_S = math.radians(3.0) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlace:
    """Walking direction in the phone's axes while it is carried in one place, estimated from all strides there."""

    start_s: float
    shown_rad: float  # walking direction, clockwise from the zero of the device heading
    var_rad2: float


def known_places(steps: Table) -> tuple[KnownPlace, ...]:
    """Return the places of the phone in the steps of a track, each with the direction after its last stride."""
    since_s, std_rad = np.asarray(steps.carried_since_s), np.asarray(steps.shown_offset_std_rad)
    shown_rad = np.asarray(steps.shown_offset_rad)
    (in_place,) = (np.isfinite(since_s) & np.isfinite(std_rad)).nonzero()
    last = in_place[np.flatnonzero(np.diff(since_s[in_place], append=np.inf))]
    return tuple(KnownPlace(float(since_s[k]), float(shown_rad[k]), float(std_rad[k]) ** 2) for k in last)


@dataclass(frozen=True, slots=True, eq=False)
class Former:
    """A place where the phone was, and where it may come back to."""

    left_s: float
    n_strides: int
    up: Vector  # mean up direction of its last stride, sensor frame
    direction: Vector  # of walking, across it


@dataclass(frozen=True, eq=False)
class WalkingHeadingState:
    """Signals of the last seconds, the last contacts, and what was learnt."""

    n_samples: int  # of this segment
    start_s: float  # its first sample
    signals: FloatArray  # (15, H)
    contacts_s: tuple[float, ...]  # the last two
    up: Vector | None  # mean up direction of the last stride; None before the first
    axis: Vector  # unit, across `up`: the reference axis, sensor frame
    place: Placement | None
    offset: Offset  # without what is believed for the moment only
    shown: Offset  # with that
    trust: float  # how well the strides of the place agree
    corridors: CorridorState
    error_rad: float  # of the device's heading when axes were looked for anew
    error_of_bias_rad: float  # what biases found late said of it then
    of_bias_rad: float  # what they say now
    of_bias_var_rad2: float
    lost_var_rad2: float  # by biases so far
    reported: Reported
    walking_rad: float  # last walking heading, in the track's frame with any number of turns; NaN before
    walking_s: float
    direction: Vector  # the same in the sensor frame, across `direction_up`
    direction_up: Vector  # mean up direction of that stride
    formers: tuple[Former, ...]  # the last three


@dataclass(frozen=True)
class WalkingHeading:
    """The heading stage for any carrying mode; it needs a gyroscope, and says nothing without.

    Parameters
    ----------
    phase_rad : float
        By which the vertical specific force is advanced to be in phase with the push forward. Phones in hands, at ears
        and in pockets have 40 to 145 degrees.
    running_phase_rad : float
        The same for running: -60 to -180 degrees in the trouser pockets of twelve people, if they run with the phone
        as they walk with it.
    running_mps2 : float
        Amplitude of the vertical specific force at step frequency that is running. Walking has up to 6.5 m/s2,
        jogging 11 to 16.
    strides : StrideAgreement
        What the strides of one place have in common.
    systematic_std_rad : float
        How far the push forward is from the walking heading after any number of strides.
    held_systematic_std_rad : float
        The same for a phone with its screen up, where the arm that holds it gives way to one side, and for running.
    systematic_s : float
        How long such an error lasts.
    axis_std_rad : float
        How far the axis of a phone that somebody reads, or may read, is from the walking heading.
    max_tilt_rad : float
        If the mean up direction of a stride is further from that of the place, the phone was moved.
    change_std_rad : float
        How far people turn while they move the phone.
    away_s, return_std_rad : float
        A phone that within this time is found tilted as in a former place is as it was there, this well.
    corridors : Corridors
        What the axes of a building say of the drift.
    known_places : tuple of KnownPlace
        Directions from a first pass over the same recording, in order of time. Strides are not used in these places.
    drift : HeadingDrift
        That of the filter behind (`MotionNoise.heading_drift`); `Config` refuses another one.
    """

    rate_hz: float = 100.0
    phase_rad: float = math.radians(85.0)
    running_phase_rad: float = math.radians(-135.0)
    running_mps2: float = 8.5
    strides: StrideAgreement = field(default_factory=StrideAgreement)
    systematic_std_rad: float = math.radians(6.0)
    held_systematic_std_rad: float = math.radians(20.0)
    systematic_s: float = 300.0
    axis_std_rad: float = math.radians(12.0)
    max_tilt_rad: float = math.radians(35.0)
    change_std_rad: float = math.radians(35.0)
    away_s: float = 30.0
    return_std_rad: float = math.radians(20.0)
    corridors: Corridors = field(default_factory=Corridors)
    known_places: tuple[KnownPlace, ...] = ()
    drift: HeadingDrift = field(default_factory=HeadingDrift)

    def __post_init__(self) -> None:
        check_numbers(self, zero=("away_s",), signed=("phase_rad", "running_phase_rad"))

    def init(self) -> WalkingHeadingState:
        """State before the first sample."""
        return WalkingHeadingState(
            n_samples=0,
            start_s=math.nan,
            signals=np.empty((_N_ROWS, 0)),
            contacts_s=(),
            up=None,
            axis=_NOWHERE,
            place=None,
            offset=Offset(),
            shown=Offset(),
            trust=0.0,
            corridors=self.corridors.init(),
            error_rad=0.0,
            error_of_bias_rad=0.0,
            of_bias_rad=0.0,
            of_bias_var_rad2=0.0,
            lost_var_rad2=0.0,
            reported=Reported(),
            walking_rad=math.nan,
            walking_s=math.nan,
            direction=_NOWHERE,
            direction_up=_NOWHERE,
            formers=(),
        )

    def after_gap(self, state: WalkingHeadingState) -> WalkingHeadingState:
        """State after a time without samples: where the person turned in it is unknown, where the phone is may not be.

        A phone that is found tilted as before is taken to be where it was.
        """
        signals = np.empty((_N_ROWS, 0))
        state = self._without_axes(state)
        return replace_unchecked(
            state, n_samples=0, signals=signals, contacts_s=(), walking_rad=math.nan, walking_s=math.nan, formers=()
        )

    def update(
        self,
        state: WalkingHeadingState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[WalkingHeadingState, list[tuple[int, Step]]]:
        """New state and the steps of a block with their walking headings."""
        n_before = state.n_samples
        if n_before == 0:
            gap_s = block.gap_before_s if math.isfinite(block.gap_before_s) else 0.0
            reported = state.reported.after_loss(float(self.drift.unmeasured_rad2(gap_s)))
            state = replace_unchecked(state, start_s=float(block.time_s[0]), reported=reported)
        n_old, n_new = state.signals.shape[1], len(block.time_s)
        signals = np.empty((_N_ROWS, n_old + n_new))
        signals[:, :n_old], rows = state.signals, signals[:, n_old:]
        rows[_TIME], rows[_FORCE], rows[_UP] = block.time_s, block.specific_force_mps2.T, attitude.up_sensor.T
        rows[_EAST], rows[_NORTH] = attitude.horizontal_mps2.T
        rows[_VERTICAL], rows[_HEADING] = attitude.vertical_mps2, attitude.device_heading_rad
        rows[_KNOWN] = block.angular_rate_known
        if len(attitude.heading_error_rad):
            rows[_ERROR], rows[_ERROR_VAR] = attitude.heading_error_rad, attitude.heading_error_var_rad2
            rows[_LOST_VAR] = attitude.heading_lost_var_rad2
        else:
            rows[_ERROR:] = 0.0
        state = replace_unchecked(state, n_samples=n_before + n_new, signals=signals)
        indices = [number - n_before for number, _ in steps]
        at_steps = ContextBlock(*(getattr(contexts, f.name)[indices] for f in fields(contexts))) if steps else contexts
        state, result = self._annotated(state, steps, at_steps)
        return replace_unchecked(state, signals=state.signals[:, -self._n_kept :]), result

    def finish(
        self, state: WalkingHeadingState, steps: list[tuple[int, Step]]
    ) -> tuple[WalkingHeadingState, list[tuple[int, Step]]]:
        """The same for steps that a gap or the end revealed; nothing new is said of modes."""
        return self._annotated(state, steps, unknown_contexts(len(steps)))

    @property
    def _n_kept(self) -> int:
        # a stride, and the time that the slowest detector, or a gate behind it, takes to let its last step pass
        return round((_MAX_STRIDE_S + _MAX_LATENCY_S) * self.rate_hz)

    def _annotated(
        self,
        state: WalkingHeadingState,
        steps: list[tuple[int, Step]],
        contexts: ContextBlock,
    ) -> tuple[WalkingHeadingState, list[tuple[int, Step]]]:
        """New state and steps with their walking headings, from what their strides show."""
        if not steps:
            return state, []
        contacts_s = (*state.contacts_s, *(step.time_s for _, step in steps))
        first = len(state.contacts_s) + 1
        samples = [
            self._stride_samples(state, contacts_s[max(first + i - 3, 0) : first + i], number)
            for i, (number, _) in enumerate(steps)
        ]
        strides = self._strides(samples, contexts)
        result: list[tuple[int, Step]] = []
        for (number, step), stride, mode in zip(steps, strides, contexts.carrying_mode.tolist(), strict=True):
            state, changes = self._annotate(state, step, self._bias_error(state, step.time_s, number), stride, mode)
            result.append((number, replace_unchecked(step, **changes) if changes else step))
        return replace_unchecked(state, contacts_s=contacts_s[-2:]), result

    def _annotate(
        self,
        state: WalkingHeadingState,
        step: Step,
        bias_error: tuple[float, float, float],
        stride: Stride | None,
        carrying_mode: int,
    ) -> tuple[WalkingHeadingState, dict[str, Any]]:
        """Return the new state, and the fields of a step that its stride and the gyroscope's bias show.

        `bias_error` is by how much the device's heading is too large at the contact, its variance, and the variance
        that the heading has gained by the uncertain bias so far.
        """
        loss = self._loss(state, step, bias_error[2] - state.lost_var_rad2)
        reported = state.reported.at_step(step, self.drift, loss.get("yaw_bias_std_radps", step.yaw_bias_std_radps))
        of_bias_rad, of_bias_var_rad2, lost_var_rad2 = bias_error
        state = replace_unchecked(
            state, of_bias_rad=of_bias_rad, of_bias_var_rad2=of_bias_var_rad2, lost_var_rad2=lost_var_rad2
        )
        if stride is None and state.place is None:
            return replace_unchecked(state, reported=reported), loss
        if stride is None:
            # a bias that was found while the pedestrian stood turns the first step already, not the first stride
            heard = dict[str, float]()
            if step.heading_unknown_s == 0:
                error_rad, var_rad2 = self._error(state, state.shown.var_rad2 + of_bias_var_rad2)
                reported, heard = reported.with_report(step, self._reportable(state), error_rad, var_rad2, 0.0)
            return replace_unchecked(state, reported=reported), loss | heard | _shown(state)
        stride = stride.about(stride.axis if state.up is None else carry_axis(state.axis, state.up, stride.up))
        offset, formers, place, change_std_rad = self._settle(state, stride, step.time_s, carrying_mode)
        known_place = self._known(step.time_s)
        if known_place is not None and (change_std_rad > 0 or state.place is None):
            offset = offset.seen(OF_AXIS, cmath.rect(1.0, known_place.shown_rad), known_place.var_rad2)
        may_read = place.carrying_mode == _TEXTING or (place.carrying_mode < 0 and stride.up[2] > 0.5)
        place = self.strides.learn(replace_unchecked(place, n_read=place.n_read + may_read), stride, step.duration_s)
        elapsed_s = step.duration_s if math.isnan(state.walking_s) else step.time_s - state.walking_s
        offset, shown, trust = self._believe(place, offset, stride, elapsed_s)
        shown = self._with_axis(place, shown, stride, trust) if known_place is None else offset
        angle_rad = shown.shown_rad - stride.axis_offset_rad
        offset_rad = shown.offset_rad
        walking_rad = stride.device_heading_rad + offset_rad
        if change_std_rad > 0 or step.heading_unknown_s > 0:
            state = self._without_axes(state)
        state = replace_unchecked(
            state,
            up=stride.up,
            axis=stride.axis,
            formers=formers,
            place=place,
            offset=offset,
            shown=shown,
            trust=trust,
            walking_rad=walking_rad,
            walking_s=step.time_s,
            direction=combined(math.cos(angle_rad), stride.axis, math.sin(angle_rad), cross(stride.axis, stride.up)),
            direction_up=stride.up,
            corridors=self.corridors.update(state.corridors, step.time_s, walking_rad),
        )
        error_rad, var_rad2 = self._error(state, shown.var_rad2 + of_bias_var_rad2)
        reported, heard = reported.with_report(step, self._reportable(state), error_rad, var_rad2, change_std_rad)
        shown_too = _shown(state, on_axes=self.corridors.is_sure(state.corridors))
        return replace_unchecked(state, reported=reported), loss | heard | shown_too

    def _reportable(self, state: WalkingHeadingState) -> Shown:
        return Shown(state.shown.offset_rad, state.shown.var_rad2, self.corridors.probability(state.corridors))

    def _loss(self, state: WalkingHeadingState, step: Step, lost_var_rad2: float) -> dict[str, float]:
        """Field of a step with the random walk of the filter that loses as much of the heading as the bias has."""
        if lost_var_rad2 <= 0:
            return {}
        since_s = step.duration_s if math.isnan(state.reported.time_s) else step.time_s - state.reported.time_s
        return {"yaw_bias_std_radps": math.sqrt(lost_var_rad2 / (2.0 * self.drift.bias_correlation_s * since_s))}

    def _bias_error(self, state: WalkingHeadingState, contact_s: float, number: int) -> tuple[float, float, float]:
        """By how much the device's heading is too large at a contact, its variance, and the variance lost so far.

        Those of the step before where the samples are no longer remembered.
        """
        index = round((contact_s - state.start_s) * self.rate_hz) - 1
        if not max(number + 1 - self._n_kept, 0) <= index <= number:
            return state.of_bias_rad, state.of_bias_var_rad2, state.lost_var_rad2
        error_rad, var_rad2, lost_var_rad2 = state.signals[_ERROR:, index - state.n_samples].tolist()
        return error_rad, var_rad2, lost_var_rad2

    def drift_in_time(self, state: WalkingHeadingState) -> tuple[float, float]:
        """What time has added to the device's heading, rad, and its variance: infinite unless axes are sure."""
        if not self.corridors.is_sure(state.corridors):
            return 0.0, math.inf
        shown_rad, var_rad2 = self.corridors.drift_in_time(state.corridors)
        return state.error_rad + shown_rad, var_rad2

    def _error(self, state: WalkingHeadingState, free_var_rad2: float) -> tuple[float, float]:
        """By how much the device's heading is too large, and the variance of the walking heading without that error.

        Axes show the walking heading itself. Without axes there is what biases show of the device's heading, and the
        walking heading has the variance `free_var_rad2`.
        """
        free_rad = state.of_bias_rad - state.error_of_bias_rad
        drift_rad, var_rad2 = self.corridors.mixed(state.corridors, free_rad, free_var_rad2)
        return state.error_rad + drift_rad, var_rad2

    def _without_axes(self, state: WalkingHeadingState) -> WalkingHeadingState:
        """State that looks for axes anew, because headings do not follow on those before; what they showed is kept."""
        return replace_unchecked(
            state,
            corridors=self.corridors.restart(state.corridors),
            error_rad=self._error(state, 0.0)[0],
            error_of_bias_rad=state.of_bias_rad,
        )

    def _stride_samples(
        self, state: WalkingHeadingState, contacts_s: tuple[float, ...], number: int
    ) -> FloatArray | None:
        """Samples of the last two steps, or None if they are not two steps alike with angular rate."""
        if len(contacts_s) < 3:
            return None
        start_s, middle_s, end_s = contacts_s
        longer_s = max(middle_s - start_s, end_s - middle_s)
        if not _MIN_STRIDE_S <= end_s - start_s <= _MAX_STRIDE_S or longer_s > _MAX_SHARE * (end_s - start_s):
            return None
        first, last = (round((t - state.start_s) * self.rate_hz) for t in (start_s, end_s))
        # Samples after the step are ignored even if they are in its block: otherwise the result would depend on the
        # length of the blocks.
        if first < max(number + 1 - self._n_kept, 0) or last > number + 1:
            return None
        oldest = state.n_samples - state.signals.shape[1]
        samples = state.signals[:, first - oldest : last - oldest]
        return samples if samples[_KNOWN].all() else None

    def _strides(self, samples: Sequence[FloatArray | None], contexts: ContextBlock) -> list[Stride | None]:
        """What each stride shows; None where there is none, and where the person does not walk forward.

        A person who steps sideways pushes sideways.
        """
        strides: list[Stride | None] = [None] * len(samples)
        is_turned, is_running = contexts.is_turned.tolist(), contexts.runs.tolist()
        usable = [(i, s) for i, s in enumerate(samples) if s is not None and not is_turned[i]]
        for start in range(0, len(usable), _MAX_GROUP):
            group = usable[start : start + _MAX_GROUP]
            joined = np.concatenate([s for _, s in group], axis=1)
            ends = np.cumsum([0, *(s.shape[1] for _, s in group)])
            of_all = StrideSamples(
                ends, joined[_FORCE], joined[_UP], joined[_EAST], joined[_NORTH], joined[_VERTICAL], joined[_HEADING]
            )
            runs = np.array([is_running[i] for i, _ in group])
            group_strides = strides_of(of_all, runs, self.rate_hz, self._phases)
            for (i, _), stride in zip(group, group_strides, strict=True):
                strides[i] = stride
        return strides

    @cached_property
    def _phases(self) -> Phases:
        return Phases(self.phase_rad, self.running_phase_rad, self.running_mps2)

    def _settle(
        self, state: WalkingHeadingState, stride: Stride, time_s: float, carrying_mode: int
    ) -> tuple[Offset, tuple[Former, ...], Placement, float]:
        """The offset, former places, the place that a stride is in, and by how much the offset may have changed."""
        place_before, formers = state.place, state.formers
        if place_before is None:
            offset = state.offset.moved(0.0, 0.0, self._systematic_rad2(stride))
            return offset, formers, Placement(time_s, carrying_mode, -1, stride.up), 0.0
        is_moved = math.acos(min(max(dot(place_before.up, stride.up), -1.0), 1.0)) > self.max_tilt_rad
        is_old = carrying_mode == place_before.old_mode and time_s - place_before.start_s < _LABEL_LAG_S
        label = place_before.carrying_mode if is_old or carrying_mode < 0 else carrying_mode
        if not is_moved:
            up = unit(combined(1.0 - 1.0 / _UP_STRIDES, place_before.up, 1.0 / _UP_STRIDES, stride.up))
            return state.offset, formers, replace_unchecked(place_before, up=up, carrying_mode=label), 0.0
        # What is said of the mode is of windows that ended before the phone was moved.
        place = Placement(time_s, -1, carrying_mode, stride.up)
        offset = state.shown
        moved_rad, turned_var = offset.offset_rad, UNKNOWN_VAR_RAD2
        if not math.isnan(state.walking_rad):
            turned_var = self.change_std_rad**2 + _TURN_VAR_RAD2_PER_S * (time_s - state.walking_s)
            moved_rad = state.walking_rad - stride.device_heading_rad
        offset = offset.moved(moved_rad, turned_var, self._systematic_rad2(stride))
        former_rad = self._came_back(state.formers, stride, time_s)
        if former_rad is not None:
            shown_rad = stride.axis_offset_rad + former_rad
            offset = offset.seen(OF_STRIDES, cmath.rect(1.0, shown_rad), self.return_std_rad**2)
        if place_before.n_strides >= _SETTLED_STRIDES:
            former = Former(time_s, place_before.n_strides, state.direction_up, state.direction)
            formers = (*formers, former)[-_N_FORMERS:]
        return offset, formers, place, UNKNOWN_STD_RAD

    def _known(self, time_s: float) -> KnownPlace | None:
        """Place of the first pass that holds at a time; None without a first pass."""
        i = bisect_right(self.known_places, time_s, key=attrgetter("start_s"))
        return self.known_places[i - 1] if i else None

    def _came_back(self, formers: tuple[Former, ...], stride: Stride, time_s: float) -> float | None:
        """The direction learnt in a former place, if this looks like it: a hand takes the phone up and swings on."""
        alike = [
            f for f in formers if time_s - f.left_s < self.away_s and dot(f.up, stride.up) > math.cos(self.max_tilt_rad)
        ]
        if not alike:
            return None
        former = max(alike, key=lambda f: f.n_strides)
        direction = carry_axis(former.direction, former.up, stride.up)
        right = cross(stride.axis, stride.up)
        return math.atan2(dot(direction, right), dot(direction, stride.axis))

    def _systematic_rad2(self, stride: Stride) -> float:
        is_vague = stride.runs or stride.up[2] > 0.5
        return (self.held_systematic_std_rad if is_vague else self.systematic_std_rad) ** 2

    def _with_axis(self, place: Placement, offset: Offset, stride: Stride, trust: float) -> Offset:
        """What is believed for the moment: the phone's own axis counts as long as somebody reads on it."""
        if 2 * place.n_read < place.n_strides:
            return offset
        pointing_rad = stride.axis_offset_rad + stride.pointing_rad
        if trust > _OVERRULES_AXIS and abs(wrap_angle(pointing_rad - offset.shown_rad)) > _AGAINST_AXIS_RAD:
            return offset
        return offset.seen(OF_AXIS, cmath.rect(1.0, pointing_rad), self.axis_std_rad**2)

    def _believe(
        self, place: Placement, offset: Offset, stride: Stride, elapsed_s: float
    ) -> tuple[Offset, Offset, float]:
        """The offset after a stride, what is believed for the moment, and how well strides agree: so much they count.

        The first strides of a place count as their sum, which later ones may show in another light: that it is a hand
        which swings, or another phase. From then on each has its say.
        """
        stay = math.exp(-elapsed_s / self.systematic_s)
        wandered_rad2 = self.drift.random_walk_rad_per_sqrt_s**2 * elapsed_s
        offset = offset.wandered(wandered_rad2, stay, self._systematic_rad2(stride))
        mix = self.strides.mix(place)
        length2, share = self.strides.agreement(place, mix)
        if length2 == 0 or self.known_places:
            return offset, offset, share
        # half of what is not shared is across the direction, and two overlapping strides count as one
        is_young = place.n_strides <= _YOUNG_STRIDES
        vectors, weight = (_as_complex(place), place.weight) if is_young else (stride.vectors, 1.0)
        forward = (mix[0] * vectors[0] + mix[1] * vectors[1] + mix[2] * vectors[2]) / weight
        toward = forward / math.sqrt(share * length2) * cmath.rect(1.0, stride.axis_offset_rad)
        shown = offset.seen(OF_STRIDES, toward, (1.0 - share) / share / weight)
        return (offset if place.n_strides < _YOUNG_STRIDES else shown), shown, share


def _as_complex(place: Placement) -> tuple[complex, complex, complex]:
    a, b, c = place.vectors
    return complex(*a), complex(*b), complex(*c)


def _shown(state: WalkingHeadingState, on_axes: bool = False) -> dict[str, Any]:
    """What a step has of where the phone points against the body."""
    return {
        "on_axes": on_axes,
        "shown_offset_rad": state.shown.shown_rad,
        "shown_offset_std_rad": math.sqrt(state.shown.shown_var_rad2),
        "direction_trust": state.trust,
        "carried_since_s": -math.inf if state.place is None else state.place.start_s,
    }
