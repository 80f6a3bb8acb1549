"""Whole recordings at once: loops over the same steps that an app pushes samples through."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pdr_filter.config import Config
from pdr_filter.filter.alignment import Alignment
from pdr_filter.filter.tracking import StepUpdate, TrackerState
from pdr_filter.filtering import Output, Watch, climb_at, context_notes, due_s, finish, init, parts, step
from pdr_filter.io.recording import MissingSensorError, Recording
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.contexts.stage import WindowContext, with_climb
from pdr_filter.sensing.features.barometric import Climb
from pdr_filter.sensing.front_end import Event, Sensing
from pdr_filter.tracks import Track
from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import Table, read_only
from pdr_filter.values.contexts import CARRYING_MODES, CONTEXTS
from pdr_filter.values.fixes import Fix, FixResult
from pdr_filter.values.samples import ImuBlock
from pdr_filter.values.step import Step, step_table
from pdr_filter.values.windows import Windows

if TYPE_CHECKING:
    from pdr_filter.calibration import Calibration


def track(
    recording: Recording,
    config: Config | None = None,
    weighting: str | None = None,
    fixes: Sequence[Fix] = (),
    progress: Callable[[float], None] | None = None,
    calibration: Calibration | str | Path | None = None,
) -> Track:
    """Track of a recording, the same that `OnlineFilter` gives for its samples.

    Parameters
    ----------
    recording : Recording
        From `read`.
    config : Config, optional
        A recipe; the default recipe if not given.
    weighting : {"imm", "wc", "hc"}, optional
        How context probabilities become step lengths: interacting multiple model, weighted or highest context. The
        recipe's own if not given; that of the default recipe is "imm".
    fixes : sequence of PositionFix, HeadingFix, SpeedFix or Standstill
        What is known from elsewhere, each used when it was received. Positions and headings are in the frame of the
        track, which starts at the origin; with `config.in_world_frame()` in any frame, and so is the track then, its
        steps from before that was found out included.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    calibration : Calibration or path, optional
        Of `pdr_filter.calibrate`, or where one was saved: step lengths and their covariance for this person.
    """
    config = config or _default(recording)
    if calibration is not None:
        from pdr_filter.calibration import Calibration, load_calibration  # which makes tracks to calibrate with

        known = calibration if isinstance(calibration, Calibration) else load_calibration(calibration)
        config = known.config(config, recording.subject)
    _check_sensors(config, recording)
    if weighting is not None:
        config = config.with_weighting(weighting)
    return _run(recording, config, fixes, progress, None)[0]


def watched_track(
    recording: Recording, config: Config | None, fixes: Sequence[Fix], watch: Watch
) -> tuple[Track, TrackerState, Config]:
    """The track, the filter's last state, and the configuration used; `watch` sees every state before."""
    config = config or _default(recording)
    _check_sensors(config, recording)
    return *_run(recording, config, fixes, None, watch), config


def _run(
    recording: Recording,
    config: Config,
    fixes: Sequence[Fix],
    progress: Callable[[float], None] | None,
    watch: Watch | None,
) -> tuple[Track, TrackerState]:
    state = replace(init(config), waiting_fixes=tuple(sorted(fixes, key=lambda f: due_s(config, f))))
    state = replace(state, climbs=_climbs(config, recording))
    updates: list[StepUpdate] = []
    windows: list[WindowContext] = []
    results: list[FixResult] = []

    def collect(output: Output) -> None:
        updates.extend(u for u in output.updates if u.is_final)
        windows.extend(output.windows)
        results.extend(output.fixes)

    for part in _parts(merge_streams(recording), progress):
        state, output = step(config, state, part, watch)
        collect(output)
    state, output = finish(config, state, watch)
    collect(output)

    report = state.sensing.conditioner.report
    notes = [*recording.notes, *report.notes(), *_fit_notes(recording, config, updates)]
    notes += [*context_notes(state.seen), *config.notes]
    if state.tracker.rejected_fixes:
        notes.append(f"fixes rejected as outliers: {state.tracker.rejected_fixes}")
    if state.waiting_fixes:
        notes.append(f"fixes from after the last sample, not used: {len(state.waiting_fixes)}")
        end_s = state.sensing.processed_s
        results += [FixResult.of(fix, end_s, np.inf, False) for fix in state.waiting_fixes]
    start_s = 0.0 if np.isnan(report.first_time_s) else report.first_time_s
    duration_s = 0.0 if np.isnan(report.last_time_s) else report.last_time_s - start_s
    track = _collect(recording.name, config, updates, _windows(windows), start_s, duration_s, notes)
    track = replace(track, fixes=tuple(results))
    if state.tracker.alignment is not None:
        track = _in_world(track, state.tracker.alignment)
    return track, state.tracker


def detect_steps(recording: Recording, config: Config | None = None) -> Table:
    """Steps of a recording: a table with a row for each `Step` and its fields as columns."""
    config = config or _default(recording)
    return step_table([e for e in sensed_events(config.sensing, recording) if isinstance(e, Step)])


def classify(recording: Recording, config: Config | None = None) -> Windows:
    """Context and carrying-mode probabilities of all windows of a recording."""
    config = config or _default(recording)
    climbs = _climbs(config, recording)
    events = sensed_events(config.sensing, recording)
    return _windows([with_climb(e, climb_at(climbs, e.time_s)) for e in events if isinstance(e, WindowContext)])


def _climbs(config: Config, recording: Recording) -> tuple[Climb, ...]:
    """Climb rates of the barometer, if there is one."""
    barometer = recording.barometer
    if barometer is None:
        return ()
    return tuple(config.climb_rate.step(config.climb_rate.init(), barometer.time_s, barometer.values[:, 0])[1])


def _default(recording: Recording) -> Config:
    from pdr_filter.recipes import default  # loads the shipped models, which training makes

    return default(recording.subject)


def _check_sensors(config: Config, recording: Recording) -> None:
    """MissingSensorError if the tracks of the recipe need what was not recorded."""
    missing = [name for name in config.needs if name not in recording.streams]
    if missing:
        raise MissingSensorError(
            f"{recording.name or 'the recording'} has no {' and no '.join(missing)}, which recipe {config.name!r} "
            'needs for a track; use recipe "default", which does without'
        )


def sensed_events(sensing: Sensing, recording: Recording) -> Iterator[Event]:
    """Steps, contexts and gaps of a recording in the order in which they became known."""
    state = sensing.init()
    for part in _parts(merge_streams(recording), None):
        state, events = sensing.step(state, part)
        yield from (event for _, event in events)
    yield from (event for _, event in sensing.finish(state))


def _parts(block: ImuBlock, progress: Callable[[float], None] | None) -> Iterator[ImuBlock]:
    done, n = 0, len(block.time_s)
    for part in parts(block):
        yield part
        done += len(part.time_s)
        if progress is not None:
            progress(done / n)


def _windows(found: Sequence[WindowContext]) -> Windows:
    return Windows(
        time_s=read_only(np.array([w.time_s for w in found])),
        context_prob=read_only(np.array([w.prob for w in found]).reshape(-1, len(CONTEXTS))),
        contexts=CONTEXTS,
        carrying_prob=read_only(np.array([w.carrying_prob for w in found]).reshape(-1, len(CARRYING_MODES))),
        carrying_modes=CARRYING_MODES,
        unknown_share=read_only(np.array([w.unknown_share for w in found])),
        irregular_prob=read_only(np.array([w.irregular_prob for w in found])),
        climb_rate_mps=read_only(np.array([w.climb_rate_mps for w in found])),
        model=tuple(w.model for w in found),
    )


def _collect(
    name: str,
    config: Config,
    updates: Sequence[StepUpdate],
    windows: Windows,
    start_s: float,
    duration_s: float,
    notes: Sequence[str],
) -> Track:
    n, n_modes = len(updates), len(config.tracker.modes)
    steps = step_table([u.step for u in updates])
    return Track(
        name=name,
        time_s=read_only(np.asarray(steps.time_s)),
        position_m=read_only(np.array([u.position_m for u in updates]).reshape(n, 2)),
        position_cov_m2=read_only(np.array([u.position_cov_m2 for u in updates]).reshape(n, 2, 2)),
        step_length_m=read_only(np.array([u.step_length_m for u in updates])),
        walking_heading_rad=read_only(wrap_angle(np.array([u.walking_heading_rad for u in updates]))),
        step_speed_mps=read_only(np.array([u.speed.step_mps for u in updates])),
        step_speed_std_mps=read_only(np.array([u.speed.step_std_mps for u in updates])),
        smoothed_speed_mps=read_only(np.array([u.speed.smoothed_mps for u in updates])),
        smoothed_speed_std_mps=read_only(np.array([u.speed.smoothed_std_mps for u in updates])),
        context_prob=read_only(np.array([u.context_prob for u in updates]).reshape(n, len(CONTEXTS))),
        contexts=CONTEXTS,
        mode_prob=read_only(np.array([u.mode_prob for u in updates]).reshape(n, n_modes)),
        modes=tuple(m.name for m in config.tracker.modes),
        steps=steps,
        windows=windows,
        start_time_s=start_s,
        duration_s=duration_s,
        weighting=config.tracker.weighting,
        notes=tuple(notes),
    )


def _in_world(track: Track, alignment: Alignment) -> Track:
    """The track with the steps from before the alignment in the frame of the others."""
    first = np.arange(track.n_steps) < alignment.n_steps
    R = alignment.rotation
    turned = track.walking_heading_rad + np.where(first, alignment.angle_rad, 0.0)
    return replace(
        track,
        start_position_m=read_only(alignment.positions(np.zeros(2))),
        position_m=read_only(np.where(first[:, None], alignment.positions(track.position_m), track.position_m)),
        position_cov_m2=read_only(
            np.where(first[:, None, None], R @ track.position_cov_m2 @ R.T, track.position_cov_m2)
        ),
        walking_heading_rad=read_only(wrap_angle(turned)),
    )


def _fit_notes(recording: Recording, config: Config, updates: Sequence[StepUpdate]) -> list[str]:
    notes: list[str] = []
    if not config.on_foot and recording.is_on_foot:
        notes.append("worn on the foot: this recipe is for a carried phone, its steps and lengths do not fit")
    if not updates:
        notes.append("no steps found: dead reckoning does not apply here")
    return notes
