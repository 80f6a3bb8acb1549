"""Walking heading from yaw less an offset that is trained after each transition: Tian et al. 2016, section III-E.

A phone that is held points where its owner walks. One in a swinging hand or in a pocket is turned against that by an
offset, which is taken from the first steps after the transition: they are assumed to go where the last step before it
went (Table V). The yaw swings with hand and leg and is averaged over a step, in a pocket over two.

Deviations: docs/methods/tian2016.md. A held phone's yaw is the direction in which its user looks, at right angles to
its x axis; elsewhere it is the turn about the vertical, whose unknown zero the trained offset takes up.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.recipes.tian2016.steps import HOLDING, POCKET, SWING, TRANS, Carried, CarriedState
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import FloatArray, Step, check_numbers, circular_mean, replace_unchecked, wrap_angle

# Standard deviation of an angle of which nothing is known: uniform over the circle.
_ANY_ANGLE_RAD = float(np.pi / np.sqrt(3.0))
_NAN = float("nan")
# Longer than the longest step, 2 s, and the longest time until one is reported, that of a transition.
_MEMORY_S = 6.0


def average_angle(angle_rad: FloatArray) -> float:
    """Arithmetic mean of angles (N,) that lie within half a turn of each other, wherever they jump; [-pi, pi).

    mean(a) + average(wrap(a_i - mean(a))) with the circular mean: what Table IV does where no yaw is near 0.
    """
    middle = circular_mean(angle_rad)
    return float(wrap_angle(middle + float(np.mean(wrap_angle(angle_rad - middle)))))


def viewing_direction(specific_force_mps2: FloatArray, attitude: AttitudeBlock) -> FloatArray:
    """Where the user of a held phone looks: horizontal, at right angles to its x axis, (N,), clockwise, any zero.

    With up u and x axis e, u x e is that direction in the sensor frame. The attitude gives specific force f both in
    the sensor frame and along the horizontal axes of the world: the angles from it to either frame differ by the
    heading. Undefined, and then 0, where f or the x axis is exactly vertical.
    """
    f, up = specific_force_mps2, attitude.up_sensor
    along = f[:, 0] * up[:, 0] + f[:, 1] * up[:, 1] + f[:, 2] * up[:, 2]
    right = f[:, 0] - along * up[:, 0]
    ahead = f[:, 1] * up[:, 2] - f[:, 2] * up[:, 1]
    east, north = attitude.horizontal_mps2.T
    return np.asarray(wrap_angle(np.arctan2(ahead, right) - np.arctan2(north, east)))


@dataclass(frozen=True, eq=False)
class OffsetCompensationState:
    """What the samples of the last seconds showed, and the offset or its training."""

    carried: CarriedState
    n_samples: int = 0  # of this segment
    # (3, n): time, state, and viewing direction less device heading, of the last samples
    recent: FloatArray = field(default_factory=lambda: np.empty((3, 0)))
    viewing_zero_rad: float = _NAN  # viewing direction less device heading at the first held step
    mode: int = HOLDING  # main mode of the last step
    moving: bool = False  # whether the last step was in a transition
    direction_rad: float = _NAN  # of the last step; NaN if unknown
    baseline_rad: float = _NAN  # O_b: that of the last step before the transition
    n_since: int = 0  # steps since the transition
    training_rad: FloatArray = field(default_factory=lambda: np.empty(0))  # step orientations with the offset included
    offset_rad: float = _NAN  # NaN before it is trained
    last_heading_rad: float = _NAN  # device heading of the step before, the other half of a pair in a pocket
    last_duration_s: float = _NAN
    last_time_s: float = _NAN


@dataclass(frozen=True)
class OffsetCompensation:
    """Heading stage: adaptive offset compensation.

    `walking_heading_rad` is that of the device while it is held; the direction before the transition while steps
    are filled in or an offset is trained; that of the device less the offset from then on. It is unknown (its standard
    deviation is infinite) without angular rate, and after a gap until the phone is held again.

    Parameters
    ----------
    n_swing : int
        M_SWING: steps that train the offset of a swinging hand.
    n_pocket : int
        M_POCKET: steps until the offset of a pocket is trained.
    n_omit : int
        M_omit: of them those at the start that are left out, while the phone slides into place.
    direction_std_rad : float
        Given to every direction. The paper trusts them fully; its median errors are 1 to 5 degrees (Tables VIII, IX).
        On winding walks in a room ours are 5 to 17: give more where other measurements of direction compete.
    """

    rate_hz: float = 100.0
    n_swing: int = 3
    n_pocket: int = 6
    n_omit: int = 2
    transition_s: float = 2.0
    direction_std_rad: float = 0.1

    learns_directions = False

    def __post_init__(self) -> None:
        check_numbers(self, zero=("n_omit",))
        if self.n_pocket - self.n_omit < 2:
            raise ValueError(
                f"n_pocket must be two more than n_omit, which are left out, got {self.n_pocket} and {self.n_omit}"
            )

    @property
    def _carried(self) -> Carried:
        return Carried(self.rate_hz, self.transition_s)

    def init(self) -> OffsetCompensationState:
        """State before the first sample."""
        return OffsetCompensationState(self._carried.init())

    def after_gap(self, state: OffsetCompensationState) -> OffsetCompensationState:
        """State after a time without samples: only the zero of the viewing direction lasts."""
        return replace_unchecked(self.init(), viewing_zero_rad=state.viewing_zero_rad)

    def update(
        self,
        state: OffsetCompensationState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[OffsetCompensationState, list[tuple[int, Step]]]:
        """New state and the steps of a block with their walking headings."""
        carried, states = self._carried.update(state.carried, contexts.carrying_mode)
        turned = wrap_angle(viewing_direction(block.specific_force_mps2, attitude) - attitude.device_heading_rad)
        new = np.stack([block.time_s, states.astype(float), turned])
        state = replace_unchecked(
            state,
            carried=carried,
            n_samples=state.n_samples + len(states),
            recent=np.concatenate([state.recent, new], axis=1),
        )
        state, steps = self.finish(state, steps)
        return replace_unchecked(state, recent=state.recent[:, -round(_MEMORY_S * self.rate_hz) :]), steps

    def finish(
        self, state: OffsetCompensationState, steps: list[tuple[int, Step]]
    ) -> tuple[OffsetCompensationState, list[tuple[int, Step]]]:
        """The same for steps that a gap or the end revealed."""
        out: list[tuple[int, Step]] = []
        for number, step in steps:
            state, annotated = self._annotate(state, number, step)
            out.append((number, annotated))
        return state, out

    def _annotate(
        self, state: OffsetCompensationState, number: int, step: Step
    ) -> tuple[OffsetCompensationState, Step]:
        """New state and one step with its walking heading."""
        samples = self._samples_of(state, number, step)
        mode = int(samples[1, -1]) if samples.shape[1] else state.mode
        if step.heading_unknown_s > 0.5 * step.duration_s:
            # a baseline or an offset is of no use to a heading that stood still meanwhile
            return replace_unchecked(self._forget(state), direction_rad=_NAN, baseline_rad=_NAN), step
        if mode == TRANS:
            # filled in: the yaw is of the hand that moves the phone
            return replace_unchecked(state, moving=True), self._directed(step, state.direction_rad, moved=True)
        moved = state.moving or mode != state.mode
        if mode != state.mode:
            state = replace_unchecked(self._forget(state), mode=mode, baseline_rad=state.direction_rad)
        state = replace_unchecked(state, n_since=state.n_since + 1, moving=False)
        if mode == HOLDING:
            direction_rad = step.device_heading_rad
            if samples.shape[1]:
                turned_rad = average_angle(samples[2])
                if np.isnan(state.viewing_zero_rad):
                    state = replace_unchecked(state, viewing_zero_rad=turned_rad)
                direction_rad += float(wrap_angle(turned_rad - state.viewing_zero_rad))
        else:
            state, direction_rad = self._compensated(state, step)
        state = replace_unchecked(
            state,
            direction_rad=direction_rad,
            last_heading_rad=step.device_heading_rad,
            last_duration_s=step.duration_s,
            last_time_s=step.time_s,
        )
        return state, self._directed(step, direction_rad, moved)

    def _forget(self, state: OffsetCompensationState) -> OffsetCompensationState:
        """Without offset, before any training."""
        return replace_unchecked(state, n_since=0, training_rad=np.empty(0), offset_rad=_NAN, last_heading_rad=_NAN)

    def _compensated(self, state: OffsetCompensationState, step: Step) -> tuple[OffsetCompensationState, float]:
        """New state and the direction of a step in a swinging hand or in a pocket (Table V)."""
        if np.isnan(state.baseline_rad):
            return state, _NAN
        heading_rad = step.device_heading_rad
        # the first step after a pause has no other half
        follows = step.time_s - step.duration_s <= state.last_time_s + 0.01
        if state.mode == POCKET and follows and not np.isnan(state.last_heading_rad):
            # mean over the samples of both steps
            weight = step.duration_s / (step.duration_s + state.last_duration_s)
            heading_rad = weight * heading_rad + (1 - weight) * state.last_heading_rad
        if not np.isnan(state.offset_rad):
            return state, heading_rad - state.offset_rad
        n_omit, n_trained = (0, self.n_swing) if state.mode == SWING else (self.n_omit, self.n_pocket)
        in_training = state.n_since - n_omit
        # in a pocket every second step ends a pair
        if in_training > 0 and (state.mode == SWING or in_training % 2 == 0):
            state = replace_unchecked(state, training_rad=np.append(state.training_rad, heading_rad))
        if state.n_since >= n_trained:
            offset_rad = float(wrap_angle(average_angle(state.training_rad) - state.baseline_rad))
            # the offset in the turn that continues the baseline, so that directions are not wrapped either
            offset_rad += 2 * np.pi * round((heading_rad - offset_rad - state.baseline_rad) / (2 * np.pi))
            state = replace_unchecked(state, offset_rad=offset_rad)
        return state, state.baseline_rad

    def _samples_of(self, state: OffsetCompensationState, number: int, step: Step) -> FloatArray:
        """Columns of `recent` during a step; not more of them than a whole memory before its detection."""
        first = state.n_samples - state.recent.shape[1]
        oldest = max(number - round(_MEMORY_S * self.rate_hz) + 1 - first, 0)
        remembered = state.recent[:, oldest:]
        a, b = np.searchsorted(remembered[0], [step.time_s - step.duration_s, step.time_s], side="right")
        return remembered[:, a:b]

    def _directed(self, step: Step, direction_rad: float, moved: bool) -> Step:
        """The step with its direction, if there is one; nothing is known of how a phone was moved meanwhile."""
        known = not np.isnan(direction_rad)
        return replace_unchecked(
            step,
            walking_heading_rad=direction_rad if known else 0.0,
            walking_heading_std_rad=self.direction_std_rad if known else np.inf,
            offset_change_std_rad=_ANY_ANGLE_RAD if moved else step.offset_change_std_rad,
        )
