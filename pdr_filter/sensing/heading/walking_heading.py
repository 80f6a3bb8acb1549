"""Walking direction from a phone carried anywhere: the push forward of the body shows in every stride.

The horizontal specific force at step frequency, in phase with the vertical one advanced by 85 degrees (minus the
vertical velocity), points in the walking direction, including the sign. Running has another phase. A swinging hand
moves at stride frequency, and its horizontal force in phase with its vertical one points forward
(docs/methods/heading.md).

The stage estimates the angle from the device to the walking heading, which is constant while the phone stays in its
placement. Strides are weighted by their agreement (`phone_placement`). The axis of the phone counts while it is being
read. After the phone was moved to another placement, the last walking direction gives the new angle, and so does a
previous placement with the same tilt. A track needs only the difference of the angle to that of the first placement
(`heading_offset`). The error of the device heading itself comes from the gyroscope bias and from the axes of a building
(`corridors`).

The angle is estimated in the attitude frame (`AttitudeBlock.horizontal_mps2`) and expressed relative to
`device_heading_rad`, both averaged over a stride. The relation between the two therefore does not matter, and swings
cancel. Each step reports only what is new for the filter: `pdr_filter.sensing.heading.reported_heading`.
"""

from __future__ import annotations

import cmath
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.heading.corridors import Corridors, CorridorState
from pdr_filter.sensing.heading.heading_offset import AXIS_MEASUREMENT, STRIDE_MEASUREMENT, Offset
from pdr_filter.sensing.heading.phone_placement import Placement, StrideAgreement
from pdr_filter.sensing.heading.reported_heading import Reported, Shown
from pdr_filter.sensing.heading.stride_harmonics import (
    N_NUMBERS,
    Phases,
    Stride,
    StrideSamples,
    carry_axis,
    strides_of,
)
from pdr_filter.sensing.heading.vectors import Vector, cross, dot, linear_sum, unit
from pdr_filter.sensing.steps.step_detector import ContextBlock, unknown_contexts
from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.values import (
    CARRYING_MODES,
    BoolArray,
    FloatArray,
    HeadingDrift,
    Step,
    Table,
    check_numbers,
    replace_unchecked,
    wrap_angle,
)
from pdr_filter.values.angles import UNKNOWN_STD_RAD, UNKNOWN_VAR_RAD2

_TEXTING, _CALLING = CARRYING_MODES.index("texting"), CARRYING_MODES.index("calling")
# Time by which the head is ahead of the walking direction at a corner, s (R. Grasso et al., Neuroscience Letters 253,
# 1998, doi:10.1016/S0304-3940(98)00625-9).
_HEAD_AHEAD_S = 1.0

# Rows of the buffered signals.
_FORCE, _UP, _EAST, _NORTH, _VERTICAL, _HEADING, _KNOWN = slice(3), slice(3, 6), 6, 7, 8, 9, 10
_ERROR, _ERROR_VAR, _LOST_VAR = 11, 12, 13
_N_ROWS = 14

# Shortest and longest duration of two steps that form a stride, s: 0.9 to 4.5 steps a second, as in the step detectors.
_MIN_STRIDE_S, _MAX_STRIDE_S = 0.45, 2.2
# Longest delay from a contact to its step, s, for the slowest detector or a gate behind it.
_MAX_LATENCY_S = 8.0
# Largest share of a step in its stride. Beyond it a step was missed, or the walk has just begun.
_MAX_SHARE = 0.68
# Number of first strides of a placement that are used by their sum instead of one by one.
_FIRST_STRIDES = 30
# Agreement of strides above which they overrule the axis of the phone, if they differ from it by this angle. Readers
# walk in the direction in which they read, but do not always hold the phone straight.
_OVERRULES_AXIS, _AGAINST_AXIS_RAD = 0.6, math.radians(50.0)
# Number of strides after which the direction of a placement is remembered when the phone is moved.
_SETTLED_STRIDES = 4
# Number of previous placements that are remembered. A look at the phone can produce two placements.
_N_PREVIOUS_PLACEMENTS = 3
# Strides over which the up direction of a placement is averaged.
_UP_STRIDES = 8.0
# Strides that are processed together, so that their samples fit into the processor's cache.
_MAX_GROUP = 32
# Time after a change of placement during which the classifier still reports the old carrying mode, s. It uses several
# seconds of samples, and follows slowly.
_LABEL_LAG_S = 10.0
_NO_DIRECTION = (0.0, 0.0, 0.0)
_NO_BIAS, _NO_STRIDES = np.empty((0, 4)), np.empty((0, 3 + 2 * N_NUMBERS))
# Turn of a pedestrian while no stride is measured: a random walk of 3 degrees per square root of a second.
_TURN_VAR_RAD2_PER_S = math.radians(3.0) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlacement:
    """Walking direction in the axes of the phone during one placement, estimated from all strides.

    Attributes
    ----------
    start_s : float
        Time when the phone was put there, s.
    shown_rad : float
        Walking direction, clockwise from the zero of the device heading, rad.
    var_rad2 : float
        Variance of the direction, rad2.
    """

    start_s: float
    shown_rad: float
    var_rad2: float


def known_placements(steps: Table) -> tuple[KnownPlacement, ...]:
    """Return the placements of the phone during a track, in order of time.

    Each has the walking direction in the axes of the phone, as estimated at the last stride in this placement.
    """
    since_s, std_rad = np.asarray(steps.carried_since_s), np.asarray(steps.shown_offset_std_rad)
    shown_rad = np.asarray(steps.shown_offset_rad)
    (is_shown,) = (np.isfinite(since_s) & np.isfinite(std_rad)).nonzero()
    last = is_shown[np.flatnonzero(np.diff(since_s[is_shown], append=np.inf))]
    return tuple(KnownPlacement(float(since_s[k]), float(shown_rad[k]), float(std_rad[k]) ** 2) for k in last)


@dataclass(frozen=True, slots=True, eq=False)
class PreviousPlacement:
    """A previous placement of the phone, to which it may return."""

    left_s: float  # time when the phone left the placement, s
    n_strides: int  # strides in the placement
    up: Vector  # mean unit vector up of its last stride, sensor frame
    direction: Vector  # walking direction, a unit vector perpendicular to `up`, sensor frame


@dataclass(frozen=True, slots=True)
class BiasError:
    """Error of the device heading due to the gyroscope bias."""

    error_rad: float = 0.0
    var_rad2: float = 0.0  # variance of `error_rad`
    lost_var_rad2: float = 0.0  # heading variance that the uncertain bias has added since the start


@dataclass(frozen=True, eq=False)
class WalkingHeadingState:
    """Buffered signals, the last contacts, and the estimates of the stage."""

    n_samples: int  # samples of the segment
    start_s: float  # time of the first sample of the segment, s
    signals: FloatArray  # (14, H) buffered signals
    contacts_s: tuple[float, ...]  # last two contacts, s
    up: Vector | None  # mean unit vector up of the last stride, sensor frame. None before the first.
    axis: Vector  # reference axis, a unit vector perpendicular to `up`, sensor frame
    placement: Placement | None  # statistics of the strides in the present placement of the phone
    # Heading offset without temporary information (the axis of the phone, and the first strides of a placement).
    offset: Offset
    shown: Offset  # heading offset with the temporary information
    trust: float  # agreement of the strides in this placement, 0 to 1
    corridors: CorridorState  # state of the estimation of drift from the axes of a building
    error_at_restart_rad: float  # error of the device heading when the search for axes last restarted, rad
    bias_error_at_restart_rad: float  # error of the device heading according to the gyroscope bias at that time, rad
    bias: BiasError  # present error of the device heading according to the gyroscope bias
    reported: Reported  # information already passed to the filter
    walking_rad: float  # last walking heading in the frame of the track, not wrapped, rad. NaN before the first.
    walking_s: float  # time of the last walking heading, s
    direction: Vector  # last walking direction, a unit vector perpendicular to `direction_up`, sensor frame
    direction_up: Vector  # mean unit vector up of that stride, sensor frame
    previous_placements: tuple[PreviousPlacement, ...]  # up to three previous placements of the phone
    # Results for the steps that waited at the gate when the filter was saved, instead of their samples. A row of
    # `saved_bias` (B, 4) is a contact and the numbers of its `BiasError`. A row of `saved_strides` (S, 41) is the three
    # contacts of a stride, and the numbers of the stride if the pedestrian walks, and if the pedestrian runs.
    saved_bias: FloatArray
    saved_strides: FloatArray


@dataclass(frozen=True)
class WalkingHeading(StepStage[WalkingHeadingState]):
    """Causal heading stage that estimates the walking direction of each step for any carrying mode.

    It needs a gyroscope, and gives no headings without. It is the heading stage of the default recipe.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    phase_rad : float, default 85 degrees
        Phase by which the vertical specific force is advanced to be in phase with the push forward while walking, rad.
        Phones in hands, at ears and in pockets have 40 to 145 degrees.
    running_phase_rad : float, default -135 degrees
        Phase for running, rad. It is -60 to -180 degrees in the trouser pockets of twelve persons, if they run with the
        phone in the same placement as they walk.
    running_mps2 : float, default 8.5
        Amplitude of the vertical specific force at step frequency from which the motion is running, m/s2. Walking has
        up to 6.5 m/s2, jogging 11 to 16.
    strides : StrideAgreement, optional
        Statistics over the strides of one placement.
    systematic_std_rad : float, default 6 degrees
        Standard deviation of the error of the push forward that remains after any number of strides, rad.
    held_systematic_std_rad : float, default 20 degrees
        The same standard deviation for running and for a phone with its screen up, where the arm that holds it gives
        way to one side, rad.
    systematic_s : float, default 300
        Correlation time of the systematic error, s.
    axis_std_rad : float, default 12 degrees
        Standard deviation of the angle between walking heading and the axis of a phone that is or may be read, rad.
    max_tilt_rad : float, default 35 degrees
        The phone was moved if the mean up direction of a stride differs from the up direction of the placement by more
        than this angle, rad.
    change_std_rad : float, default 35 degrees
        Standard deviation of the turn of the pedestrian while the phone is moved, rad.
    away_s, return_std_rad : float, default 30 and 20 degrees
        A phone that returns within `away_s` seconds to the tilt of a previous placement has the direction that it had
        there, with a standard deviation of `return_std_rad`.
    corridors : Corridors, optional
        Estimation of the heading drift from the axes of a building.
    known_placements : tuple of KnownPlacement, default empty
        Directions from a first pass over the same recording, in order of time. If given, strides are not used.
    drift : HeadingDrift, optional
        Heading drift of the filter of the track (`MotionNoise.heading_drift`). `Config` refuses a different one.
    kept_strides : dict, optional
        Memory for the strides of a first pass, by the time of their step, each with the device heading of the step. A
        second pass takes them from here.

    Attributes
    ----------
    learns_directions : bool
        True: the stage sets `Step.shown_offset_rad`.

    Notes
    -----
    docs/methods/heading.md has the equations. With the complex amplitudes H (forward and right) and V of the horizontal
    and vertical specific force at step frequency over a stride, the push forward is d = Re(H conj(V) exp(-i phase)) /
    abs(V).

    Examples
    --------
    The strides of a simulated walk with the phone in a trouser pocket agree on a direction:

    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.heading.walking_heading import WalkingHeading
    >>> recording = pdr.simulate.simulate([pdr.simulate.Leg("walking", duration_s=10.0)], carrying_mode="pocket")
    >>> config = pdr.recipes.default().with_heading(WalkingHeading())
    >>> steps = pdr.track(recording, config).steps
    >>> bool(steps[-1].direction_trust > 0.5)
    True
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
    known_placements: tuple[KnownPlacement, ...] = ()
    drift: HeadingDrift = field(default_factory=HeadingDrift)
    kept_strides: dict[float, tuple[Stride | None, float]] | None = field(default=None, compare=False, repr=False)

    learns_directions = True

    def __post_init__(self) -> None:
        check_numbers(self, zero=("away_s",), signed=("phase_rad", "running_phase_rad"))

    def after_first_pass(self, steps: Table) -> WalkingHeading:
        """Return the stage for a second pass over the same recording, with the directions of the first pass.

        Parameters
        ----------
        steps : Table
            Steps of the first pass, such as `Track.steps`.

        Returns
        -------
        WalkingHeading
            Stage with `known_placements`.
        """
        return replace(self, known_placements=known_placements(steps))

    def init(self) -> WalkingHeadingState:
        return WalkingHeadingState(
            n_samples=0,
            start_s=math.nan,
            signals=np.empty((_N_ROWS, 0)),
            contacts_s=(),
            up=None,
            axis=_NO_DIRECTION,
            placement=None,
            offset=Offset(),
            shown=Offset(),
            trust=0.0,
            corridors=self.corridors.init(),
            error_at_restart_rad=0.0,
            bias_error_at_restart_rad=0.0,
            bias=BiasError(),
            reported=Reported(),
            walking_rad=math.nan,
            walking_s=math.nan,
            direction=_NO_DIRECTION,
            direction_up=_NO_DIRECTION,
            previous_placements=(),
            saved_bias=_NO_BIAS,
            saved_strides=_NO_STRIDES,
        )

    def after_gap(self, state: WalkingHeadingState) -> WalkingHeadingState:
        """Return the state after a gap, during which the pedestrian may have turned in an unknown way.

        A phone whose tilt is the same as before is assumed to be in the same placement.

        Parameters
        ----------
        state : WalkingHeadingState
            State before the gap.

        Returns
        -------
        WalkingHeadingState
            State before the first sample after the gap.
        """
        return replace_unchecked(
            self._without_axes(state),
            n_samples=0,
            signals=np.empty((_N_ROWS, 0)),
            contacts_s=(),
            walking_rad=math.nan,
            walking_s=math.nan,
            previous_placements=(),
            saved_bias=_NO_BIAS,
            saved_strides=_NO_STRIDES,
        )

    def update(
        self,
        state: WalkingHeadingState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: NumberedSteps,
    ) -> tuple[WalkingHeadingState, NumberedSteps]:
        n_before = state.n_samples
        if n_before == 0:
            gap_s = block.gap_before_s if math.isfinite(block.gap_before_s) else 0.0
            reported = state.reported.after_loss(float(self.drift.unmeasured_rad2(gap_s)))
            state = replace_unchecked(state, start_s=float(block.time_s[0]), reported=reported)
        n_old, n_new = state.signals.shape[1], len(block.time_s)
        signals = np.empty((_N_ROWS, n_old + n_new))
        signals[:, :n_old], rows = state.signals, signals[:, n_old:]
        rows[_FORCE], rows[_UP] = block.specific_force_mps2.T, attitude.up_sensor.T
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
        state, result = self._with_headings(state, steps, at_steps)
        return replace_unchecked(state, signals=state.signals[:, -self._n_needed(state) :]), result

    def finish(self, state: WalkingHeadingState, steps: NumberedSteps) -> tuple[WalkingHeadingState, NumberedSteps]:
        return self._with_headings(state, steps, unknown_contexts(len(steps)))

    @property
    def _n_kept(self) -> int:
        """Number of buffered samples: a stride and the longest delay of a step."""
        return round((_MAX_STRIDE_S + _MAX_LATENCY_S) * self.rate_hz)

    def _n_needed(self, state: WalkingHeadingState) -> int:
        """Return the number of buffered samples that a later step may need, at least one.

        Its stride begins at the earlier of the last two contacts, or later. Saved filters are smaller without the
        samples before.
        """
        if len(state.contacts_s) < 2:
            return self._n_kept
        n_since = state.n_samples - round((state.contacts_s[0] - state.start_s) * self.rate_hz)
        return min(max(n_since, 1), self._n_kept)

    def trimmed(
        self, state: WalkingHeadingState, undecided_s: Sequence[float], contact_s: float
    ) -> WalkingHeadingState:
        """Return the state without samples that no later step needs, and with the strides of undecided steps instead.

        Parameters
        ----------
        state : WalkingHeadingState
            State after any number of samples.
        undecided_s : sequence of float
            Contacts of the detected steps that may still arrive, in order of time, s. If one of them arrives, all later
            ones do.
        contact_s : float
            Earliest contact of a step that is not detected yet, s.

        Returns
        -------
        WalkingHeadingState
            State with fewer signals.
        """
        # A stride of a later step begins at one of these contacts, or later.
        recent_s = [t for t in (*state.contacts_s, *undecided_s) if t >= contact_s - _MAX_STRIDE_S]
        first = math.floor((min([*recent_s, contact_s]) - state.start_s) * self.rate_hz) - 1
        first = max(first, state.n_samples - state.signals.shape[1])
        last = state.n_samples - 1
        bias = [
            [t, *astuple(self._bias_error(state, t, last))]
            for t in undecided_s
            if last + 1 - self._n_kept <= self._sample(state, t) - 1 < first
        ]
        parts = ((*state.contacts_s, *undecided_s[i : i + 3]) for i in range(len(undecided_s)))
        strides = dict.fromkeys(triple for part in parts for triple in zip(part, part[1:], part[2:], strict=False))
        found = {s: self._stride_samples(state, s, last) for s in strides if self._sample(state, s[0]) < first}
        sampled = {s: samples for s, samples in found.items() if isinstance(samples, np.ndarray)}
        runs = np.repeat([False, True], len(sampled))
        both = self._strides_of_samples([*sampled.values()] * 2, runs) if sampled else []
        found |= dict(zip(sampled, zip(both[: len(sampled)], both[len(sampled) :], strict=True), strict=True))
        rows = [[*s, *of[0].numbers, *of[1].numbers] for s, of in found.items() if isinstance(of, tuple)]
        return replace_unchecked(
            state,
            signals=state.signals[:, first - state.n_samples :],
            saved_bias=np.array(bias) if bias else _NO_BIAS,
            saved_strides=np.array(rows) if rows else _NO_STRIDES,
        )

    def _with_headings(
        self, state: WalkingHeadingState, steps: NumberedSteps, contexts: ContextBlock
    ) -> tuple[WalkingHeadingState, NumberedSteps]:
        """Return the new state and the steps with their walking headings."""
        if not steps:
            return state, []
        contacts_s, kept = (*state.contacts_s, *(step.time_s for _, step in steps)), self.kept_strides or {}
        if all(step.time_s in kept for _, step in steps):
            strides = [_at_heading(*kept[step.time_s], step.device_heading_rad) for _, step in steps]
        else:
            first = len(state.contacts_s) + 1
            samples = [
                self._stride_samples(state, contacts_s[max(first + i - 3, 0) : first + i], number)
                for i, (number, _) in enumerate(steps)
            ]
            strides = self._strides(samples, contexts)
            if self.kept_strides is not None:
                pairs = zip(steps, strides, strict=True)
                self.kept_strides.update(
                    (step.time_s, (stride, step.device_heading_rad)) for (_, step), stride in pairs
                )
        result: NumberedSteps = []
        for (number, step), stride, mode in zip(steps, strides, contexts.carrying_mode.tolist(), strict=True):
            state, changes = self._annotate(state, step, self._bias_error(state, step.time_s, number), stride, mode)
            if mode == _CALLING:
                changes["ahead_s"] = _HEAD_AHEAD_S
            result.append((number, replace_unchecked(step, **changes) if changes else step))
        return replace_unchecked(state, contacts_s=contacts_s[-2:]), result

    def _annotate(
        self, state: WalkingHeadingState, step: Step, bias: BiasError, stride: Stride | None, carrying_mode: int
    ) -> tuple[WalkingHeadingState, dict[str, Any]]:
        """Return the new state and the changed fields of a step.

        The stride that the step ends updates the placement of the phone and the heading offset. The new information is
        reported in the fields of the step. `stride` is None if the step ends no usable stride. The step then receives
        only the heading error due to the gyroscope bias and the present offset. Before the first usable stride there is
        no offset.
        """
        loss = self._bias_field(state, step, bias.lost_var_rad2 - state.bias.lost_var_rad2)
        reported = state.reported.at_step(step, self.drift, loss.get("yaw_bias_std_radps", step.yaw_bias_std_radps))
        state = replace_unchecked(state, bias=bias)
        if stride is None and state.placement is None:
            return replace_unchecked(state, reported=reported), loss
        if stride is None:
            # A bias that was estimated while the pedestrian stood must already correct the first step, before the first
            # complete stride.
            report = dict[str, float]()
            if step.heading_unknown_s == 0:
                error_rad, var_rad2 = self._error(state, state.shown.var_rad2 + bias.var_rad2)
                reported, report = reported.with_report(step, self._reportable(state), error_rad, var_rad2, 0.0)
            return replace_unchecked(state, reported=reported), loss | report | _shown_fields(state)
        stride = stride.about(stride.axis if state.up is None else carry_axis(state.axis, state.up, stride.up))
        offset, previous_placements, placement, change_std_rad = self._update_placement(
            state, stride, step.time_s, carrying_mode
        )
        known_placement = self._known_placement_at(step.time_s)
        if known_placement is not None and (change_std_rad > 0 or state.placement is None):
            known_direction = cmath.rect(1.0, known_placement.shown_rad)
            offset = offset.after_measurement(AXIS_MEASUREMENT, known_direction, known_placement.var_rad2)
        may_read = placement.carrying_mode == _TEXTING or (placement.carrying_mode < 0 and stride.up[2] > 0.5)
        placement = replace_unchecked(placement, n_read=placement.n_read + may_read)
        placement = self.strides.learn(placement, stride, step.duration_s)
        elapsed_s = step.duration_s if math.isnan(state.walking_s) else step.time_s - state.walking_s
        offset, shown, trust = self._update_offset(placement, offset, stride, elapsed_s)
        shown = self._with_axis(placement, shown, stride, trust) if known_placement is None else offset
        angle_rad = shown.shown_rad - stride.axis_offset_rad
        offset_rad = shown.offset_rad
        walking_rad = stride.device_heading_rad + offset_rad
        if change_std_rad > 0 or step.heading_unknown_s > 0:
            state = self._without_axes(state)
        state = replace_unchecked(
            state,
            up=stride.up,
            axis=stride.axis,
            previous_placements=previous_placements,
            placement=placement,
            offset=offset,
            shown=shown,
            trust=trust,
            walking_rad=walking_rad,
            walking_s=step.time_s,
            direction=linear_sum(math.cos(angle_rad), stride.axis, math.sin(angle_rad), cross(stride.axis, stride.up)),
            direction_up=stride.up,
            corridors=self.corridors.update(state.corridors, step.time_s, walking_rad),
        )
        error_rad, var_rad2 = self._error(state, shown.var_rad2 + bias.var_rad2)
        reported, report = reported.with_report(step, self._reportable(state), error_rad, var_rad2, change_std_rad)
        shown_fields = _shown_fields(state, on_axes=self.corridors.is_sure(state.corridors))
        return replace_unchecked(state, reported=reported), loss | report | shown_fields

    def _reportable(self, state: WalkingHeadingState) -> Shown:
        """Return the present heading offset in the form that `Reported.with_report` takes."""
        return Shown(state.shown.offset_rad, state.shown.var_rad2, self.corridors.probability(state.corridors))

    def _bias_field(self, state: WalkingHeadingState, step: Step, lost_var_rad2: float) -> dict[str, float]:
        """Return the field `yaw_bias_std_radps` of a step, or an empty dict if the bias added no heading variance.

        `lost_var_rad2` is the heading variance that the uncertain gyroscope bias has added since the last step. The
        value is the standard deviation of the bias about the vertical for which the filter of the track adds exactly
        this variance.
        """
        if lost_var_rad2 <= 0:
            return {}
        since_s = step.duration_s if math.isnan(state.reported.time_s) else step.time_s - state.reported.time_s
        return {"yaw_bias_std_radps": math.sqrt(lost_var_rad2 / (2.0 * self.drift.bias_correlation_s * since_s))}

    def _bias_error(self, state: WalkingHeadingState, contact_s: float, number: int) -> BiasError:
        """Return the error of the device heading at a contact, or that of the previous step if it is not buffered."""
        index = self._sample(state, contact_s) - 1
        if not max(number + 1 - self._n_kept, 0) <= index <= number:
            return state.bias
        if index < state.n_samples - state.signals.shape[1]:
            saved = next((error for t, *error in state.saved_bias.tolist() if t == contact_s), None)
            return state.bias if saved is None else BiasError(*saved)
        return BiasError(*state.signals[_ERROR:, index - state.n_samples].tolist())

    def _sample(self, state: WalkingHeadingState, time_s: float) -> int:
        """Return the number of the sample at a time in the segment."""
        return round((time_s - state.start_s) * self.rate_hz)

    def drift_in_time(self, state: WalkingHeadingState) -> tuple[float, float]:
        """Return the error of the device heading accumulated over time, and its variance.

        Parameters
        ----------
        state : WalkingHeadingState
            State after any step.

        Returns
        -------
        error_rad : float
            Error of the device heading, clockwise, rad.
        var_rad2 : float
            Variance of the error, rad2. Infinite unless the walk certainly follows the axes of a building.
        """
        if not self.corridors.is_sure(state.corridors):
            return 0.0, math.inf
        shown_rad, var_rad2 = self.corridors.drift_in_time(state.corridors)
        return state.error_at_restart_rad + shown_rad, var_rad2

    def _error(self, state: WalkingHeadingState, free_var_rad2: float) -> tuple[float, float]:
        """Return the error of the device heading, and the variance of the walking heading corrected by it.

        The axes of a building measure the walking heading itself. Without axes, the error follows from the gyroscope
        bias, and the variance is `free_var_rad2`. The result is the mixture of both cases.
        """
        free_rad = state.bias.error_rad - state.bias_error_at_restart_rad
        drift_rad, var_rad2 = self.corridors.mixture_drift(state.corridors, free_rad, free_var_rad2)
        return state.error_at_restart_rad + drift_rad, var_rad2

    def _without_axes(self, state: WalkingHeadingState) -> WalkingHeadingState:
        """Return the state with the search for axes restarted, after a break in the headings.

        The error of the device heading found so far is kept.
        """
        return replace_unchecked(
            state,
            corridors=self.corridors.restart(state.corridors),
            error_at_restart_rad=self._error(state, 0.0)[0],
            bias_error_at_restart_rad=state.bias.error_rad,
        )

    def _stride_samples(
        self, state: WalkingHeadingState, contacts_s: tuple[float, ...], number: int
    ) -> FloatArray | tuple[Stride, Stride] | None:
        """Return the samples of the last two steps, or None if they do not form a regular stride with angular rate.

        If the samples were left out when the filter was saved, return the stride, of walking and of running.
        """
        if len(contacts_s) < 3:
            return None
        start_s, middle_s, end_s = contacts_s
        longer_s = max(middle_s - start_s, end_s - middle_s)
        if not _MIN_STRIDE_S <= end_s - start_s <= _MAX_STRIDE_S or longer_s > _MAX_SHARE * (end_s - start_s):
            return None
        first, last = self._sample(state, start_s), self._sample(state, end_s)
        # Samples after sample `number`, which revealed the step, are not used even if they are in the block. Otherwise
        # the result would depend on the length of the blocks.
        if first < max(number + 1 - self._n_kept, 0) or last > number + 1:
            return None
        oldest = state.n_samples - state.signals.shape[1]
        if first < oldest:
            rows = (row for row in state.saved_strides.tolist() if (*row[:3],) == contacts_s)
            row = next(rows, None)
            return row and (Stride.of_numbers(row[3 : 3 + N_NUMBERS]), Stride.of_numbers(row[3 + N_NUMBERS :]))
        samples = state.signals[:, first - oldest : last - oldest]
        return samples if samples[_KNOWN].all() else None

    def _strides(
        self, samples: Sequence[FloatArray | tuple[Stride, Stride] | None], contexts: ContextBlock
    ) -> list[Stride | None]:
        """Return the stride of each step, or None.

        A step has no stride if its samples are missing or the pedestrian walks sideways or backward, because the push
        then does not point forward.
        """
        strides: list[Stride | None] = [None] * len(samples)
        is_turned, is_running = contexts.is_turned.tolist(), contexts.runs.tolist()
        usable = list[tuple[int, FloatArray]]()
        for i, of_step in enumerate(samples):
            if isinstance(of_step, tuple):
                strides[i] = None if is_turned[i] else of_step[is_running[i]]
            elif of_step is not None and not is_turned[i]:
                usable.append((i, of_step))
        for start in range(0, len(usable), _MAX_GROUP):
            numbers, group = zip(*usable[start : start + _MAX_GROUP], strict=True)
            group_strides = self._strides_of_samples(group, np.array([is_running[i] for i in numbers]))
            for i, stride in zip(numbers, group_strides, strict=True):
                strides[i] = stride
        return strides

    def _strides_of_samples(self, samples: Sequence[FloatArray], runs: BoolArray) -> list[Stride]:
        """Return the strides of K buffered signals. `runs` (K,) is True for strides of running."""
        joined = np.concatenate(samples, axis=1)
        ends = np.cumsum([0, *(s.shape[1] for s in samples)])
        stride_samples = StrideSamples(
            ends, joined[_FORCE], joined[_UP], joined[_EAST], joined[_NORTH], joined[_VERTICAL], joined[_HEADING]
        )
        return strides_of(stride_samples, runs, self.rate_hz, self._phases)

    @cached_property
    def _phases(self) -> Phases:
        """Phases by which the vertical force is advanced to be in phase with the push forward."""
        return Phases(self.phase_rad, self.running_phase_rad, self.running_mps2)

    def _update_placement(
        self, state: WalkingHeadingState, stride: Stride, time_s: float, carrying_mode: int
    ) -> tuple[Offset, tuple[PreviousPlacement, ...], Placement, float]:
        """Return the heading offset, the previous placements, the placement of a stride, and the change of the offset.

        The phone was moved if the mean up direction of the stride is too far from the up direction of the placement. A
        new placement then begins. Its offset follows from the last walking direction, and from a previous placement
        with the same tilt if there is one. The change of the offset is a standard deviation in rad, and zero unless the
        phone was moved.
        """
        placement_before, previous_placements = state.placement, state.previous_placements
        if placement_before is None:
            offset = state.offset.after_move(0.0, 0.0, self._systematic_rad2(stride))
            return offset, previous_placements, Placement(time_s, carrying_mode, -1, stride.up), 0.0
        is_moved = math.acos(min(max(dot(placement_before.up, stride.up), -1.0), 1.0)) > self.max_tilt_rad
        is_old = carrying_mode == placement_before.old_mode and time_s - placement_before.start_s < _LABEL_LAG_S
        label = placement_before.carrying_mode if is_old or carrying_mode < 0 else carrying_mode
        if not is_moved:
            up = unit(linear_sum(1.0 - 1.0 / _UP_STRIDES, placement_before.up, 1.0 / _UP_STRIDES, stride.up))
            placement = replace_unchecked(placement_before, up=up, carrying_mode=label)
            return state.offset, previous_placements, placement, 0.0
        # The reported carrying mode comes from windows that ended before the phone was moved, so it is the old one.
        placement = Placement(time_s, -1, carrying_mode, stride.up)
        offset = state.shown
        moved_rad, turned_var = offset.offset_rad, UNKNOWN_VAR_RAD2
        if not math.isnan(state.walking_rad):
            turned_var = self.change_std_rad**2 + _TURN_VAR_RAD2_PER_S * (time_s - state.walking_s)
            moved_rad = state.walking_rad - stride.device_heading_rad
        offset = offset.after_move(moved_rad, turned_var, self._systematic_rad2(stride))
        previous_rad = self._previous_direction(state.previous_placements, stride, time_s)
        if previous_rad is not None:
            shown_rad = stride.axis_offset_rad + previous_rad
            offset = offset.after_measurement(STRIDE_MEASUREMENT, cmath.rect(1.0, shown_rad), self.return_std_rad**2)
        if placement_before.n_strides >= _SETTLED_STRIDES:
            previous = PreviousPlacement(time_s, placement_before.n_strides, state.direction_up, state.direction)
            previous_placements = (*previous_placements, previous)[-_N_PREVIOUS_PLACEMENTS:]
        return offset, previous_placements, placement, UNKNOWN_STD_RAD

    def _known_placement_at(self, time_s: float) -> KnownPlacement | None:
        """Return the placement of the phone at a time, as estimated in the first pass.

        The result is None without a first pass, and before the first placement.
        """
        i = bisect_right(self.known_placements, time_s, key=attrgetter("start_s"))
        return self.known_placements[i - 1] if i else None

    def _previous_direction(
        self, previous_placements: tuple[PreviousPlacement, ...], stride: Stride, time_s: float
    ) -> float | None:
        """Return the walking direction in a previous placement with the tilt of this stride, or None if there is none.

        The direction is clockwise from the reference axis of the stride, in rad. It helps when a hand lifts the phone
        for a look and then swings on.
        """
        matching = [
            placement
            for placement in previous_placements
            if time_s - placement.left_s < self.away_s and dot(placement.up, stride.up) > math.cos(self.max_tilt_rad)
        ]
        if not matching:
            return None
        previous = max(matching, key=lambda placement: placement.n_strides)
        direction = carry_axis(previous.direction, previous.up, stride.up)
        right = cross(stride.axis, stride.up)
        return math.atan2(dot(direction, right), dot(direction, stride.axis))

    def _systematic_rad2(self, stride: Stride) -> float:
        """Return the variance of the systematic error of a stride, rad2.

        It is larger in running and with the screen up.
        """
        has_large_error = stride.runs or stride.up[2] > 0.5
        return (self.held_systematic_std_rad if has_large_error else self.systematic_std_rad) ** 2

    def _with_axis(self, placement: Placement, offset: Offset, stride: Stride, trust: float) -> Offset:
        """Return the heading offset updated with the pointing axis of the phone, as of a phone that is being read.

        The axis is used only if the phone may have been read during at least half of the strides in this placement
        (`Placement.n_read`). It is not used if strides with high agreement (`trust`) contradict it.
        """
        if 2 * placement.n_read < placement.n_strides:
            return offset
        pointing_rad = stride.axis_offset_rad + stride.pointing_rad
        if trust > _OVERRULES_AXIS and abs(wrap_angle(pointing_rad - offset.shown_rad)) > _AGAINST_AXIS_RAD:
            return offset
        return offset.after_measurement(AXIS_MEASUREMENT, cmath.rect(1.0, pointing_rad), self.axis_std_rad**2)

    def _update_offset(
        self, placement: Placement, offset: Offset, stride: Stride, elapsed_s: float
    ) -> tuple[Offset, Offset, float]:
        """Return the permanent heading offset after a stride, the offset to report, and the agreement of the strides.

        The permanent offset does not contain the first strides of a placement, because later strides may change the
        direction of their sum: they may show a swinging hand or another phase. Until stride number `_FIRST_STRIDES`,
        the reported offset is therefore the permanent one, updated with the sum of all strides of the placement. At
        this stride the sum becomes permanent. From then on, each stride updates the permanent offset, and both results
        are equal.
        """
        stay = math.exp(-elapsed_s / self.systematic_s)
        random_walk_rad2 = self.drift.random_walk_rad_per_sqrt_s**2 * elapsed_s
        offset = offset.after_time(random_walk_rad2, stay, self._systematic_rad2(stride))
        mix = self.strides.mix(placement)
        length2, share = self.strides.agreement(placement, mix)
        if length2 == 0 or self.known_placements:
            return offset, offset, share
        # Variance (1 - share) / share per stride: half of the squared length that strides do not share is across the
        # direction, and two overlapping strides count as one.
        uses_sum = placement.n_strides <= _FIRST_STRIDES
        sums = [complex(*vector) for vector in placement.vectors]
        vectors, weight = (sums, placement.weight) if uses_sum else (stride.vectors, 1.0)
        forward = (mix[0] * vectors[0] + mix[1] * vectors[1] + mix[2] * vectors[2]) / weight
        direction = forward / math.sqrt(share * length2) * cmath.rect(1.0, stride.axis_offset_rad)
        shown = offset.after_measurement(STRIDE_MEASUREMENT, direction, (1.0 - share) / share / weight)
        return (offset if placement.n_strides < _FIRST_STRIDES else shown), shown, share


def _at_heading(stride: Stride | None, before_rad: float, device_heading_rad: float) -> Stride | None:
    """Return the stride of a step whose device heading has changed from `before_rad`."""
    return (
        stride if stride is None or device_heading_rad == before_rad else stride.turned(device_heading_rad - before_rad)
    )


def _shown_fields(state: WalkingHeadingState, on_axes: bool = False) -> dict[str, Any]:
    """Return the fields of a step that describe the walking direction relative to the phone.

    They are the direction with its standard deviation, the agreement of the strides, the time since which the phone is
    in its placement, and `on_axes`. `on_axes` is True if the walk certainly follows the axes of a building.
    """
    return {
        "on_axes": on_axes,
        "shown_offset_rad": state.shown.shown_rad,
        "shown_offset_std_rad": math.sqrt(state.shown.shown_var_rad2),
        "direction_trust": state.trust,
        "carried_since_s": -math.inf if state.placement is None else state.placement.start_s,
    }
