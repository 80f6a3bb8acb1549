"""Detect motion without steps: a phone on a trolley, in a pram or in a vehicle.

Such a phone vibrates without a pause. The jitter of a second is the rms of the differences between successive means of
|f| over 20 ms, which measures motion of about 5 to 25 Hz. A second vibrates if its jitter exceeds `min_jitter_mps2`. A
run of at least `min_run_s` vibrating seconds without a step counts as moving. The duration excludes a phone that is
held or handled, because a hand pauses.

The stage finds 85 % of the time of seven recordings on a trolley (oxiod, in sample), and at most 0.1 % of people who
sit, stand and walk. A smooth ride is not detected.

Until the steps of a second are known, a vibrating phone may also belong to a pedestrian whose first steps still wait.
`stepless_s` therefore returns the time of motion that no step explains yet. The filter adds it to the uncertainty of
the present position.

The position after a pause is less certain if the phone moved in the pause, because bouts of one to three steps are not
detected. `update` therefore gives each step the time of motion since the previous step, beginning a second after its
contact. Until the next step, each such second is an event of its own as soon as its steps would be known. A fix of a
time from which steps may still become known waits for them (`Undecided`). It is then compared with a position that has
the steps before it and the uncertainty of the motion without steps.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.values import FloatArray, Step, check_numbers, replace_unchecked
from pdr_filter.values.events import Stepless, Undecided

# Rate of the means of |f|, Hz.
_JITTER_HZ = 50.0
# Delay after which all steps of a second are known, in s. The first steps of a bout become known up to 4 s after their
# contacts, and a step lasts up to 1 s.
_WAIT_S = 5
# A step up to this long before or after a second means that the pedestrian walks in this second.
_STEP_S = 1.0
# Longest time of motion that remains unexplained after a vibration that was too short for a ride, in s. The gate drops
# bouts of up to three steps, which take two seconds. Many short vibrations are handling by a person who stays in place,
# so that their times are not added.
_SHORT_S = 2.0
# Fewest means of |f| from which the motion of an incomplete second is judged. Before, it is that of the last second.
_MIN_MEANS = 10
# Standard deviation of |f| in a second in which the pedestrian may walk, m/s2. 96 % of the seconds of persons who stand
# (motionsense) are below it, and 99 % of the seconds of walks with a phone in the hand (ms_indoor) are above it. A
# smooth walk has less jitter than a trolley.
_WALKING_MPS2 = 0.3


@dataclass(frozen=True, eq=False)
class VehicleVibrationState:
    """Seconds that are not judged yet, the current run of vibrating seconds, and the totals."""

    n_samples: int = 0  # samples of the segment
    start_s: float = 0.0  # time of the first sample of the segment, s
    # Norm of the specific force for the samples of the incomplete second, m/s2
    rest: FloatArray = field(default_factory=lambda: np.empty(0))
    # Jitter and standard deviation of |f| of the complete seconds that are not judged yet, m/s2
    waiting_mps2: tuple[tuple[float, float], ...] = ()
    # Recent steps: number of the sample that revealed the step, and time of the step in s
    steps: tuple[tuple[int, float], ...] = ()
    run_s: float = 0.0  # length of the current run of vibrating seconds without steps, s
    # Unexplained time of motion before this run and since the last step, s: the durations of all rides, or up to 2 s if
    # there was only shorter vibration.
    before_run_s: float = 0.0
    moving_s: int = 0  # total duration of the runs that are long enough, s
    seen_s: int = 0  # seconds judged
    last_contact_s: float = -np.inf  # contact of the last known step, s. -inf before the first step.
    stepless_s: int = 0  # seconds since that contact that are judged to be motion without steps
    undecided_s: float = np.inf  # begin of the motion whose steps are not known yet, s, or infinity


@dataclass(frozen=True, slots=True)
class VehicleVibration:
    """Causal stage that counts the seconds in which the phone moves although the pedestrian does not walk.

    The default recipe uses the count for a warning about rides.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, a multiple of 50 Hz.
    min_jitter_mps2 : float, default 0.2
        Smallest jitter of a vibrating second, m/s2. The default is four times the median of standing persons and half
        the median on a trolley.
    min_run_s : int, default 20
        Smallest number of consecutive vibrating seconds. With 10 s, 2 % of the phones that are taken out and put away
        are counted; with 20 s, 0.1 %.

    Raises
    ------
    ValueError
        If a parameter is not positive, or `rate_hz` is not a multiple of 50 Hz.

    Examples
    --------
    A phone that vibrates at 12 Hz for a minute and makes no step:

    >>> import numpy as np
    >>> from pdr_filter.sensing.conditioning import Conditioner
    >>> from pdr_filter.sensing.vehicle_vibration import VehicleVibration
    >>> from pdr_filter.values import ImuBlock
    >>> time_s = np.arange(0.0, 60.0, 0.01)
    >>> force, unknown = np.zeros((6000, 3)), np.full((6000, 3), np.nan)
    >>> force[:, 2] = 9.81 + 2.0 * np.sin(2 * np.pi * 12.0 * time_s)
    >>> conditioner, vibration = Conditioner(), VehicleVibration()
    >>> _, (uniform,) = conditioner.update(conditioner.init(), ImuBlock(time_s, force, unknown, unknown))
    >>> state, _ = vibration.update(vibration.init(), uniform, steps=[])
    >>> state.moving_s, state.seen_s
    (54, 54)
    """

    rate_hz: float = 100.0
    min_jitter_mps2: float = 0.2
    min_run_s: int = 20

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.rate_hz % _JITTER_HZ:
            raise ValueError(
                f"rate_hz must be a multiple of {_JITTER_HZ:g}, got {self.rate_hz}: set Conditioner.rate_hz, for "
                "example to 100"
            )

    def init(self) -> VehicleVibrationState:
        """Return the state before the first sample.

        Returns
        -------
        VehicleVibrationState
            Initial state.
        """
        return VehicleVibrationState()

    def after_gap(self, state: VehicleVibrationState) -> VehicleVibrationState:
        """Return the state before the first sample after a gap, which keeps only the totals and the unexplained time.

        Parameters
        ----------
        state : VehicleVibrationState
            State before the gap.

        Returns
        -------
        VehicleVibrationState
            State with the totals, `before_run_s`, and the motion without steps since the last step.
        """
        known_s = max((time_s for _, time_s in state.steps), default=-np.inf)
        run_s, before_run_s, _ = self._after_waiting(state, known_s)
        _, before_run_s = self._runs(run_s, before_run_s, moves=False)
        return VehicleVibrationState(
            before_run_s=before_run_s,
            moving_s=state.moving_s,
            seen_s=state.seen_s,
            last_contact_s=state.last_contact_s,
            stepless_s=state.stepless_s,
        )

    def stepless_s(self, state: VehicleVibrationState, since_s: float, until_s: float) -> float:
        """Return the time for which the phone has moved although no step explains it.

        A second counts if the phone vibrates in it. A second whose steps are not known yet also counts if the phone
        moves as in the hand of a pedestrian. A run of such seconds counts while it lasts, and if it has lasted for
        `min_run_s`. Shorter runs that ended count for up to 2 s in total. A phone at rest therefore adds nothing. A
        phone that is handled by a person who stays in place adds the duration of the present handling, which falls back
        to 2 s at its end.

        Parameters
        ----------
        state : VehicleVibrationState
            State after the last block.
        since_s : float
            Time of the last known contact, s, or -inf.
        until_s : float
            Time of the newest sample, s, which may be later than the last block.

        Returns
        -------
        float
            Unexplained time of motion between the two times, s.
        """
        run_s, before_run_s, moves = self._after_waiting(state, since_s)
        rest = state.rest[None, : len(state.rest) // self._n_mean * self._n_mean]
        if rest.shape[1] >= _MIN_MEANS * self._n_mean:
            moves = self._moves(*self._jitter_and_std(rest)[0])
        rest_s = until_s - max(state.start_s + state.n_samples // round(self.rate_hz), since_s)
        return before_run_s + run_s + (rest_s if moves and rest_s > 0 else 0.0)

    def _after_waiting(self, state: VehicleVibrationState, since_s: float) -> tuple[float, float, bool]:
        """Return run and unexplained time before it after all complete seconds, and whether the last one moves.

        Only motion after the contact at `since_s` counts.
        """
        judged_s = state.start_s + state.n_samples // round(self.rate_hz) - len(state.waiting_mps2)
        run_s, before_run_s, moves = state.run_s, state.before_run_s, state.run_s > 0
        if since_s > judged_s - run_s:
            run_s, before_run_s = max(judged_s - since_s, 0.0), 0.0
        for second, spread_mps2 in enumerate(state.waiting_mps2, start=1):
            moves = self._moves(*spread_mps2)
            run_s, before_run_s = self._runs(run_s, before_run_s, moves, min(judged_s + second - since_s, 1.0))
        return run_s, before_run_s, moves

    def _moves(self, jitter_mps2: float, std_mps2: float) -> bool:
        """Return True if the pedestrian may walk or ride in a second whose steps are not known yet."""
        return jitter_mps2 > self.min_jitter_mps2 or std_mps2 > _WALKING_MPS2

    def _runs(self, run_s: float, before_run_s: float, moves: bool, new_s: float = 1.0) -> tuple[float, float]:
        """Return the length of the run of moving seconds and the unexplained time before it, after one more second.

        `new_s` is the time since the last contact in this second. It is not positive if the contact came later.
        """
        if new_s <= 0:
            return 0.0, 0.0
        if moves:
            return run_s + new_s, before_run_s
        if run_s >= self.min_run_s:
            return 0.0, before_run_s + run_s
        return 0.0, max(before_run_s, min(run_s, _SHORT_S))

    def update(
        self, state: VehicleVibrationState, block: UniformBlock, steps: NumberedSteps
    ) -> tuple[VehicleVibrationState, list[tuple[int, Step | Stepless | Undecided]]]:
        """Return the state after a block, its steps with their `stepless_s`, and its motion without known steps.

        Parameters
        ----------
        state : VehicleVibrationState
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow.
        steps : sequence of (int, Step)
            Steps that became known in this block, each with the number of the sample in the segment that revealed it.

        Returns
        -------
        state : VehicleVibrationState
            New state. `moving_s` and `seen_s` count up to five seconds before the end of the block.
        events : list of (int, Step, Stepless or Undecided)
            The steps, a `Stepless` for each second after the last known step in which the phone moved, and an
            `Undecided` where the motion without known steps begins, is judged or ends. Each comes with the number of
            the sample that revealed it.
        """
        x, y, z = block.specific_force_mps2.T
        magnitude = np.concatenate([state.rest, np.sqrt(x * x + y * y + z * z)])
        n = round(self.rate_hz)
        first, n_whole = state.n_samples // n, len(magnitude) // n
        state = replace_unchecked(
            state,
            n_samples=state.n_samples + len(block.time_s),
            start_s=float(block.time_s[0]) if state.n_samples == 0 else state.start_s,
            rest=magnitude[n_whole * n :],
        )
        events, n_known = list[tuple[int, Step | Stepless | Undecided]](), 0
        spreads_mps2 = self._jitter_and_std(magnitude[: n_whole * n].reshape(n_whole, n)) if n_whole else []
        for second, spread_mps2 in enumerate(spreads_mps2):
            end = (first + second + 1) * n
            until = bisect_left(steps, end, lo=n_known, key=itemgetter(0))
            state, found = self._with_steps(state, steps[n_known:until], first + second)
            events += found
            state = replace_unchecked(state, waiting_mps2=(*state.waiting_mps2, spread_mps2))
            n_before, state, n_known = state.stepless_s, self._judge(state, first + second), until
            if state.stepless_s > n_before:
                events.append((end - 1, Stepless()))
            since_s = self._undecided_s(state, first + second + 1)
            if since_s != state.undecided_s:
                events.append((end - 1, Undecided(since_s)))
                state = replace_unchecked(state, undecided_s=since_s)
        state, found = self._with_steps(state, steps[n_known:], first + n_whole)
        return state, [*events, *found]

    def finish(self, state: VehicleVibrationState, steps: NumberedSteps) -> tuple[VehicleVibrationState, NumberedSteps]:
        """Return the state and the steps with their `stepless_s` at the end of a segment.

        Parameters
        ----------
        state : VehicleVibrationState
            State after the last block.
        steps : sequence of (int, Step)
            Steps that the end of the segment revealed.

        Returns
        -------
        state : VehicleVibrationState
            New state.
        steps : list of (int, Step)
            The steps.
        """
        return self._with_steps(state, steps, state.n_samples // round(self.rate_hz))

    def _with_steps(
        self, state: VehicleVibrationState, steps: NumberedSteps, second: int
    ) -> tuple[VehicleVibrationState, NumberedSteps]:
        """Return the state after steps revealed in second number `second`, and the steps with their `stepless_s`."""
        found: NumberedSteps = []
        for number, step in steps:
            begin_s, since_s = step.time_s - step.duration_s, state.last_contact_s + _STEP_S
            stepless_s, judged_s = float(state.stepless_s), state.start_s + second - len(state.waiting_mps2)
            for k, (_, std_mps2) in enumerate(state.waiting_mps2):
                lasted_s = min(judged_s + k + 1, begin_s) - max(judged_s + k, since_s)
                stepless_s += max(lasted_s, 0.0) if std_mps2 > _WALKING_MPS2 else 0.0
            found.append((number, replace_unchecked(step, stepless_s=stepless_s)))
            state = replace_unchecked(
                state, steps=(*state.steps, (number, step.time_s)), last_contact_s=step.time_s, stepless_s=0
            )
        return state, found

    def _judge(self, state: VehicleVibrationState, second: int) -> VehicleVibrationState:
        """Return the state after second number `second`, with the second `_WAIT_S` earlier judged.

        All steps of that earlier second are known now.
        """
        if len(state.waiting_mps2) <= _WAIT_S:
            return state
        (jitter_mps2, std_mps2), *waiting_mps2 = state.waiting_mps2
        begin_s, known = state.start_s + second - _WAIT_S, round((second + 1) * self.rate_hz)
        recent = tuple(s for s in state.steps if s[1] > begin_s - _STEP_S)
        walks = any(number < known and time_s < begin_s + 1.0 + _STEP_S for number, time_s in recent)
        run_s, before_run_s = 0.0, 0.0
        if not walks:
            run_s, before_run_s = self._runs(state.run_s, state.before_run_s, jitter_mps2 > self.min_jitter_mps2)
        # the motion before a known step is part of its `stepless_s`
        is_stepless = std_mps2 > _WALKING_MPS2 and begin_s > state.last_contact_s + _STEP_S
        moving_s = self.min_run_s if run_s == self.min_run_s else int(run_s > self.min_run_s)
        return replace_unchecked(
            state,
            waiting_mps2=tuple(waiting_mps2),
            steps=recent,
            run_s=run_s,
            before_run_s=before_run_s,
            moving_s=state.moving_s + moving_s,
            seen_s=state.seen_s + 1,
            stepless_s=state.stepless_s + is_stepless,
        )

    def _undecided_s(self, state: VehicleVibrationState, n_seconds: int) -> float:
        """Return the begin of the motion whose steps are not known yet, after a number of seconds, or infinity."""
        first_s = state.start_s + n_seconds - len(state.waiting_mps2)
        begins_s = (first_s + k for k, (_, std_mps2) in enumerate(state.waiting_mps2) if std_mps2 > _WALKING_MPS2)
        return next((begin_s for begin_s in begins_s if begin_s > state.last_contact_s + _STEP_S), np.inf)

    @property
    def _n_mean(self) -> int:
        """Samples in each mean of |f|."""
        return round(self.rate_hz / _JITTER_HZ)

    def _jitter_and_std(self, magnitude: FloatArray) -> list[tuple[float, float]]:
        """Return jitter and standard deviation in m/s2 of the specific force, with magnitudes (S, N), of S times."""
        means = magnitude.reshape(len(magnitude), -1, self._n_mean).mean(axis=2)
        jitter = np.sqrt((np.diff(means) ** 2).mean(axis=1))
        return list(zip(jitter.tolist(), means.std(axis=1).tolist(), strict=True))
