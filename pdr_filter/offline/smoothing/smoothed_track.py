"""The track of a whole recording with hindsight: the filter forwards, the IMM smoother backwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter import imm
from pdr_filter.filter.tracking import TrackerState
from pdr_filter.io.recording import Recording
from pdr_filter.offline.smoothing.imm_smoother import ModeEstimates, Transition, smooth_imm
from pdr_filter.recording_run import watched_track
from pdr_filter.sensing.front_end import Event, Gap
from pdr_filter.tracks import Track
from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.fixes import Fix
from pdr_filter.values.step import Step


def smoothed_track(recording: Recording, config: Config | None = None, fixes: Sequence[Fix] = ()) -> Track:
    """The track of `pdr_filter.track`, every row with what the whole recording says of its step.

    Positions, covariances and mode probabilities are smoothed; step lengths and headings are those between smoothed
    positions. To the smoothed covariance comes what all steps since the last fix share (`TrackerState.shared_m`), as
    the filter knew it: a fix that comes later would make that smaller, so that before a fix it is on the safe side.

    Parameters
    ----------
    recording : Recording
        From `read`.
    config : Config, optional
        A recipe with weighting "imm"; the default recipe if not given. ValueError for other weightings.
    fixes : sequence of PositionFix, HeadingFix, SpeedFix or Standstill
        In the frame of the track. A late one is used when it came, as by the filter.
    """
    if config is not None and config.tracker.weighting != "imm":
        raise ValueError(f'the smoother needs weighting "imm", got {config.tracker.weighting!r}: use with_weighting')
    if config is not None and config.tracker.frame != "start":
        raise ValueError(
            f'the smoother works in the frame "start", got {config.tracker.frame!r}: '
            "pdr_filter.smooth takes fixes in any frame"
        )
    passages: list[tuple[TrackerState, Step | Gap]] = []

    def watch(state: TrackerState, event: Event) -> None:
        if isinstance(event, (Step, Gap)):
            passages.append((state, event))

    track, last, used = watched_track(recording, config, fixes, watch)
    if track.n_steps == 0:
        return track
    tracker = used.tracker
    filtered: list[ModeEstimates] = []
    transitions: list[Transition] = []
    for state, event in passages:
        if isinstance(event, Step):
            ahead = tracker.prediction(state, event)
            filtered.append(ModeEstimates(ahead.mean, ahead.cov, state.mode_prob))
            transitions.append(Transition(tracker.transition_prob, ahead.mixed, ahead.predicted, ahead.F, ahead.Q))
        else:
            grown = tracker.on_gap(state, event.duration_s)[0].cov - state.cov
            stay = np.broadcast_to(np.eye(state.mean.shape[1]), state.cov.shape)
            filtered.append(ModeEstimates(state.mean, state.cov, state.mode_prob))
            transitions.append(Transition(np.eye(len(state.mode_prob)), state.mean, state.mean, stay, grown))
    filtered.append(ModeEstimates(last.mean, last.cov, last.mode_prob))
    is_step = [isinstance(event, Step) for _, event in passages]
    shared_cov = [state.shared_m.T @ state.shared_m for state in (*(s for s, _ in passages[1:]), last)]
    return _with_hindsight(track, smooth_imm(filtered, transitions), is_step, np.stack(shared_cov)[is_step])


def _with_hindsight(
    track: Track, smoothed: Sequence[ModeEstimates], is_step: Sequence[bool], shared_cov_m2: FloatArray
) -> Track:
    combined = [imm.combine(e.mean, e.cov, e.mode_prob) for e in smoothed]
    position = np.stack([x[:2] for x, _ in combined])
    after = 1 + np.flatnonzero(is_step)  # the estimate after each step; the one before it is where the step began
    displacement = position[after] - position[after - 1]
    length = np.hypot(*displacement.T)
    # a step that led nowhere has no direction of its own
    heading = np.where(length > 0.01, np.arctan2(displacement[:, 0], displacement[:, 1]), track.walking_heading_rad)
    return replace(
        track,
        position_m=read_only(position[after] - position[0]),
        position_cov_m2=read_only(np.stack([cov[:2, :2] for _, cov in combined])[after] + shared_cov_m2),
        step_length_m=read_only(length),
        walking_heading_rad=read_only(wrap_angle(heading)),
        mode_prob=read_only(np.stack([e.mode_prob for e in smoothed])[after]),
    )
