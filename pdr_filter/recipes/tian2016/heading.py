"""Heading stage of Tian et al. 2016, section III-E: yaw minus an offset that is estimated after each transition.

A held phone points in the walking direction. A phone in a swinging hand or in a pocket is rotated by an offset. The
offset is estimated from the first steps after the transition, which are assumed to have the direction of the last step
before it (Table V). The yaw oscillates with hand and leg. It is averaged over a step, and over two steps in a pocket.

The yaw of a held phone is the viewing direction of its user, which is perpendicular to the x axis of the phone. In
other modes it is the rotation about the vertical, whose unknown zero is part of the estimated offset. Deviations from
the paper are listed in `OffsetCompensation`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.recipes.tian2016.steps import HOLDING, POCKET, SWING, TRANS, Carried, CarriedState
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.values import FloatArray, Step, check_numbers, circular_mean, replace_unchecked, wrap_angle

# Standard deviation of an unknown angle, uniform over the circle.
_ANY_ANGLE_RAD = float(np.pi / np.sqrt(3.0))
_NAN = float("nan")
# Length of the sample memory in s. It exceeds the longest step, 2 s, plus the longest delay of its report, which is
# that of a transition.
_MEMORY_S = 6.0


def average_angle(angle_rad: FloatArray) -> float:
    """Return the arithmetic mean, in [-pi, pi), of angles (N,) in rad that lie within half a turn of each other.

    The angles may be wrapped, for example 3.1 and -3.1. The result is m + average(wrap(a_i - m)), with the circular
    mean m of the angles a_i. If no angle needs wrapping, it equals the mean of Tian et al. 2016, Table IV.
    """
    middle = circular_mean(angle_rad)
    return float(wrap_angle(middle + float(np.mean(wrap_angle(angle_rad - middle)))))


def viewing_direction(specific_force_mps2: FloatArray, attitude: AttitudeBlock) -> FloatArray:
    """Return the viewing direction (N,) of a user who holds the phone in front of the body.

    It is in rad, clockwise from an arbitrary zero. The direction is horizontal and perpendicular to the x axis of the
    phone. In the sensor frame it is the cross product of the unit vectors up and x axis. The specific force f is known
    in the sensor frame and along the horizontal axes of the world. Its angles in the two frames differ by the heading.
    The result is undefined, and then 0, if f or the x axis is exactly vertical.
    """
    f, up = specific_force_mps2, attitude.up_sensor
    along = f[:, 0] * up[:, 0] + f[:, 1] * up[:, 1] + f[:, 2] * up[:, 2]
    right = f[:, 0] - along * up[:, 0]
    ahead = f[:, 1] * up[:, 2] - f[:, 2] * up[:, 1]
    east, north = attitude.horizontal_mps2.T
    return np.asarray(wrap_angle(np.arctan2(ahead, right) - np.arctan2(north, east)))


@dataclass(frozen=True, eq=False)
class OffsetCompensationState:
    """Samples of the last seconds, and the heading offset or the data for its estimate. NaN means unknown."""

    carried: CarriedState
    n_samples: int = 0  # samples of this segment
    # (3, n): time, carrying state, and viewing direction minus device heading of the last samples
    recent: FloatArray = field(default_factory=lambda: np.empty((3, 0)))
    viewing_zero_rad: float = _NAN  # viewing direction minus device heading at the first held step
    mode: int = HOLDING  # main mode of the last step
    moving: bool = False  # the last step was in a transition
    direction_rad: float = _NAN  # direction of the last step
    baseline_rad: float = _NAN  # O_b, direction of the last step before the transition
    n_since: int = 0  # steps since the transition
    training_rad: FloatArray = field(
        default_factory=lambda: np.empty(0)
    )  # device headings of the steps for the estimate of the offset
    offset_rad: float = _NAN  # estimated offset
    last_heading_rad: float = _NAN  # device heading of the previous step, for the mean over two steps in a pocket
    last_duration_s: float = _NAN
    last_time_s: float = _NAN


@dataclass(frozen=True)
class OffsetCompensation(StepStage[OffsetCompensationState]):
    """Heading stage of Tian et al. 2016 with adaptive offset compensation.

    `walking_heading_rad` of a step is the device heading while the phone is held. During a transition, and until the
    offset is estimated, it is the direction before the transition. Afterwards, it is the device heading minus the
    offset. It is unknown (infinite standard deviation) without angular rate, and after a gap until the phone is held
    again.

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    n_swing : int, default 3
        Number of steps that estimate the offset of a swinging hand, M_SWING.
    n_pocket : int, default 6
        Number of steps until the offset of a pocket is estimated, M_POCKET.
    n_omit : int, default 2
        Number of these steps that are skipped at the start, M_omit, while the phone slides into place.
    transition_s : float, default 2.0
        Longest duration of a transition in s.
    direction_std_rad : float, default 0.1
        Standard deviation of every direction in rad. The paper uses directions without uncertainty; its median errors
        are 1 to 5 degrees (Tables VIII, IX). On winding walks in a room they are 5 to 17 degrees here. Use a larger
        value if other measurements of the direction are combined with these.

    Raises
    ------
    ValueError
        If a number is invalid, or if `n_pocket` is less than `n_omit + 2`.

    Notes
    -----
    Deviations from the paper:

    - The yaw is not the Euler angle of iOS, which has no meaning for a phone that is upright in a pocket. It is the
      viewing direction of the user for a held phone, and the rotation about the vertical otherwise.
    - The average of Table IV adds 2 pi to negative yaws first, so that the average of -0.1 and 0.1 is pi. Here the
      deviations from the circular mean are averaged (`average_angle`).
    - In a pocket, the paper averages the yaw once for each pair of steps. Here each step is averaged with the step
      before it, so that each step has its own direction.
    - After a gap in the samples, the direction is unknown until the phone is held. The paper has no gaps.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.recipes.tian2016.heading import OffsetCompensation
    >>> heading = OffsetCompensation(direction_std_rad=0.2)
    >>> pdr.recipes.tian2016().with_heading(heading).sensing.heading.direction_std_rad
    0.2
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
                f"n_pocket must be at least n_omit + 2, because n_omit steps are skipped, got {self.n_pocket} and "
                f"{self.n_omit}"
            )

    @property
    def _carried(self) -> Carried:
        return Carried(self.rate_hz, self.transition_s)

    def init(self) -> OffsetCompensationState:
        return OffsetCompensationState(self._carried.init())

    def after_gap(self, state: OffsetCompensationState) -> OffsetCompensationState:
        return replace_unchecked(self.init(), viewing_zero_rad=state.viewing_zero_rad)

    def update(
        self,
        state: OffsetCompensationState,
        block: UniformBlock,
        attitude: AttitudeBlock,
        contexts: ContextBlock,
        steps: list[tuple[int, Step]],
    ) -> tuple[OffsetCompensationState, list[tuple[int, Step]]]:
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
        out: list[tuple[int, Step]] = []
        for number, step in steps:
            state, annotated = self._annotate(state, number, step)
            out.append((number, annotated))
        return state, out

    def _annotate(
        self, state: OffsetCompensationState, number: int, step: Step
    ) -> tuple[OffsetCompensationState, Step]:
        """Return the new state, and a step with its walking heading."""
        samples = self._samples_of(state, number, step)
        mode = int(samples[1, -1]) if samples.shape[1] else state.mode
        if step.heading_unknown_s > 0.5 * step.duration_s:
            # without angular rate the heading was not updated, so that baseline and offset are invalid
            return replace_unchecked(self._forget(state), direction_rad=_NAN, baseline_rad=_NAN), step
        if mode == TRANS:
            # in a transition the yaw shows the motion of the hand, so that the last direction is kept
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
        """Return the state without an offset and without data for its estimate."""
        return replace_unchecked(state, n_since=0, training_rad=np.empty(0), offset_rad=_NAN, last_heading_rad=_NAN)

    def _compensated(self, state: OffsetCompensationState, step: Step) -> tuple[OffsetCompensationState, float]:
        """Return the new state, and the walking direction of a step in a swinging hand or in a pocket, rad.

        The direction is the device heading minus the offset. Until the offset is estimated, it is the direction before
        the transition (Tian et al. 2016, Table V). It is NaN if that direction is unknown.
        """
        if np.isnan(state.baseline_rad):
            return state, _NAN
        heading_rad = step.device_heading_rad
        # the first step after a pause cannot be averaged with the previous step
        follows = step.time_s - step.duration_s <= state.last_time_s + 0.01
        if state.mode == POCKET and follows and not np.isnan(state.last_heading_rad):
            # mean over the samples of both steps, weighted by duration
            weight = step.duration_s / (step.duration_s + state.last_duration_s)
            heading_rad = weight * heading_rad + (1 - weight) * state.last_heading_rad
        if not np.isnan(state.offset_rad):
            return state, heading_rad - state.offset_rad
        n_omit, n_trained = (0, self.n_swing) if state.mode == SWING else (self.n_omit, self.n_pocket)
        in_training = state.n_since - n_omit
        # in a pocket, only every second step is used, because a heading is the mean of two steps
        if in_training > 0 and (state.mode == SWING or in_training % 2 == 0):
            state = replace_unchecked(state, training_rad=np.append(state.training_rad, heading_rad))
        if state.n_since >= n_trained:
            offset_rad = float(wrap_angle(average_angle(state.training_rad) - state.baseline_rad))
            # add whole turns, because directions must continue the baseline without a wrap
            offset_rad += 2 * np.pi * round((heading_rad - offset_rad - state.baseline_rad) / (2 * np.pi))
            state = replace_unchecked(state, offset_rad=offset_rad)
        return state, state.baseline_rad

    def _samples_of(self, state: OffsetCompensationState, number: int, step: Step) -> FloatArray:
        """Return the columns of `recent` (3, n) during a step, at most `_MEMORY_S` before its detection.

        The rows are time, carrying state, and viewing direction minus device heading. `number` is the number of the
        sample at which the step was detected.
        """
        first = state.n_samples - state.recent.shape[1]
        oldest = max(number - round(_MEMORY_S * self.rate_hz) + 1 - first, 0)
        remembered = state.recent[:, oldest:]
        a, b = np.searchsorted(remembered[0], [step.time_s - step.duration_s, step.time_s], side="right")
        return remembered[:, a:b]

    def _directed(self, step: Step, direction_rad: float, moved: bool) -> Step:
        """Return the step with its walking heading. An unknown direction (NaN) gets an infinite standard deviation.

        If the phone was moved during the step (`moved`), the change of its heading offset is marked as unknown.
        """
        known = not np.isnan(direction_rad)
        return replace_unchecked(
            step,
            walking_heading_rad=direction_rad if known else 0.0,
            walking_heading_std_rad=self.direction_std_rad if known else np.inf,
            offset_change_std_rad=_ANY_ANGLE_RAD if moved else step.offset_change_std_rad,
        )
