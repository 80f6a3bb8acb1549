"""The track of a whole recording in hindsight: the filter forwards, the IMM smoother backwards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter import imm
from pdr_filter.filter.alignment import Alignment, moved
from pdr_filter.filter.frame import Frame
from pdr_filter.filter.imm import ModeEstimates, Transition
from pdr_filter.filter.motion import HEADING_OFFSET, MAX_HEADING_VARIANCE, N_STATES
from pdr_filter.filter.tracker import Passage
from pdr_filter.filtering import Output, State
from pdr_filter.io.recording import Recording
from pdr_filter.offline.smoothing.imm_smoother import smooth_imm
from pdr_filter.recording_run import collected, default_config, outputs, track
from pdr_filter.sensing.clock import one_clock
from pdr_filter.sensing.device import Device
from pdr_filter.tracks import Track
from pdr_filter.values import Fix, FloatArray, HeadingFix, read_only, wrap_angle


@dataclass(frozen=True, slots=True, eq=False)
class Hindsight:
    """A track whose rows have what the whole recording says of their steps, and the states behind it."""

    track: Track
    mean: FloatArray  # (K, 4) after each step, see `pdr_filter.filter.motion`
    cov: FloatArray  # (K, 4, 4)


def knowing_the_device(recording: Recording, config: Config) -> Config:
    """The configuration with what the axes of a building teach of the phone's gyroscope, for its first seconds too.

    Its covariance counts double: the second pass sees the same samples. Without axes a second pass costs as often as it
    gains, because straight walking, seen twice, is taken for straighter than it is.
    """
    if "gyroscope" not in recording.streams or config.sensing.attitude.bias.device is not None:
        return config
    found = track(recording, config, gnss="off")
    if found.device is None or not (found.n_steps and found.steps.on_axes[-1]):
        return config
    return config.with_device(Device(found.device.bias_radps, 2.0 * found.device.bias_cov_radps2))


def in_hindsight(recording: Recording, config: Config | None = None, fixes: Sequence[Fix] = ()) -> Hindsight:
    """The track of `pdr_filter.track`, every row with what the whole recording says of its step.

    Positions, covariances and mode probabilities are smoothed, with the evidence of `Config.in_hindsight`; step lengths
    and headings are those between smoothed positions. To the smoothed covariance comes what all steps since the last
    fix share (`PedestrianState.shared_m`), as the filter knew it. With the weightings "hc" and "wc" mode probabilities
    stay as they are. `fixes` are in the frame of the track, or with `config.in_world_frame()` positions in any frame,
    and so is the track then; a late one is used when it came, as by the filter.
    """
    recording, fixes = one_clock(recording, fixes)
    config = config or default_config(recording)
    if not config.model.frame.is_joined and any(isinstance(fix, HeadingFix) for fix in fixes):
        raise ValueError(
            "in the world frame hindsight finds north from position fixes, got a HeadingFix, which turns the track on "
            "the way: leave it out, or give pdr_filter.smooth a KnownHeading"
        )
    config = config.in_hindsight()
    passages: list[Passage] = []
    last: list[ModeEstimates] = []
    frames: list[Frame] = []

    def kept() -> Iterator[tuple[State, Output]]:
        for state, output in outputs(recording, config, fixes):
            passages.extend(output.passages)
            known = state.tracker.pedestrian
            last[:] = [ModeEstimates(known.mean, known.cov, known.prob)]
            frames[:] = [known.frame]
            yield state, output

    track = collected(recording, config, kept())
    if track.n_steps == 0:
        return Hindsight(track, np.zeros((0, 4)), np.zeros((0, 4, 4)))
    alignment = frames[0].alignment
    if alignment is not None:
        for turn in (alignment, *frames[0].later):
            passages = _in_world(passages, turn)
    passages = _with_moves(passages, frames[0].moves)
    smoothed = smooth_imm([*(p.before for p in passages), *last], [p.transition for p in passages])
    return _with_hindsight(track, smoothed, passages, alignment is not None)


# Of a ride, or of first fixes in another town: nothing is said of where the track was before by where it is after.
_ANYWHERE_VAR_M2 = 1e10


def _with_moves(passages: Sequence[Passage], moves: Sequence[Alignment]) -> list[Passage]:
    """Passages of which those that led to where fixes moved the track may have led anywhere."""
    found = list(passages)
    steps = np.flatnonzero([passage.is_step for passage in passages])
    for move in moves:
        last = int(steps[move.n_steps - 1])
        transition = found[last].transition
        Q = transition.Q.copy()
        Q[:, :2, :2] += _ANYWHERE_VAR_M2 * np.eye(2)
        if move.angle_var_rad2 > 0:
            Q[:, HEADING_OFFSET, HEADING_OFFSET] += MAX_HEADING_VARIANCE
        found[last] = replace(found[last], transition=replace(transition, Q=Q))
    return found


def _in_world(passages: Sequence[Passage], alignment: Alignment) -> list[Passage]:
    """Passages as they would be had the filter known the frame of the fixes, as well as it did then, from the start.

    What is unsure about the alignment is an error of the first state that the steps carry on: x' = T x with the
    covariance of `alignment.moved`, F' = T F T^-1, Q' = T Q T'.
    """
    T = np.eye(N_STATES)
    T[:2, :2] = alignment.rotation
    found: list[Passage] = []
    n_steps = 0
    for passage in passages:
        # the gap in which the heading was lost comes before the first step in the new frame
        number = n_steps if passage.is_step or alignment.since == 0 else n_steps - 1
        is_turned = alignment.since <= number and n_steps < alignment.n_steps
        n_steps += passage.is_step
        if not is_turned:
            found.append(passage)
            continue
        mean, cov = moved(passage.before.mean, passage.before.cov, alignment)
        t = passage.transition
        origin, predicted = (moved(x, np.zeros((N_STATES, N_STATES)), alignment)[0] for x in (t.origin, t.predicted))
        R = alignment.rotation
        found.append(
            Passage(
                ModeEstimates(mean, cov, passage.before.mode_prob),
                Transition(t.transition_prob, origin, predicted, T @ t.F @ T.T, T @ t.Q @ T.T),
                R @ passage.shared_cov_m2 @ R.T,
                passage.is_step,
            )
        )
    return found


def _with_hindsight(
    track: Track, smoothed: Sequence[ModeEstimates], passages: Sequence[Passage], is_in_world: bool
) -> Hindsight:
    combined = [imm.combine(e.mean, e.cov, e.mode_prob) for e in smoothed]
    mean, cov = np.stack([x for x, _ in combined]), np.stack([P for _, P in combined])
    is_step = np.array([p.is_step for p in passages])
    shared_cov_m2 = np.stack([p.shared_cov_m2 for p in passages])[is_step]
    position = mean[:, :2]
    after = 1 + np.flatnonzero(is_step)  # the estimate after each step; the one before it is where the step began
    displacement = position[after] - position[after - 1]
    length = np.hypot(*displacement.T)
    # a step that led nowhere has no direction of its own
    heading = np.where(length > 0.01, np.arctan2(displacement[:, 0], displacement[:, 1]), track.walking_heading_rad)
    start_m = position[0] if is_in_world else np.zeros(2)
    has_modes = len(smoothed[0].mode_prob) == track.mode_prob.shape[1]
    mode_prob = np.stack([e.mode_prob for e in smoothed])[after] if has_modes else track.mode_prob
    track = replace(
        track,
        position_m=read_only(position[after] - position[0] + start_m),
        start_position_m=read_only(start_m),
        frame="fixes" if is_in_world else "start",  # of a turn that fixes have not settled hindsight says nothing
        position_cov_m2=read_only(cov[after, :2, :2] + shared_cov_m2),
        step_length_m=read_only(length),
        walked_m=read_only(np.cumsum(length)),
        walking_heading_rad=read_only(wrap_angle(heading)),
        step_speed_mps=read_only(length / np.asarray(track.steps.duration_s)),
        mode_prob=read_only(mode_prob),
    )
    return Hindsight(track, read_only(mean[after]), read_only(cov[after]))
