"""Calibration by smoothing whole walks: observations of each walk, and the result as a `Calibration`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.filter.step_length.calibration_result import of_height, slices_of
from pdr_filter.filter.step_length.models import StepLengthModel, length_and_jacobian
from pdr_filter.offline.calibration.assembly import calibration_of, impossible_steps, length_warnings, scale_std_of
from pdr_filter.offline.calibration.joint_smoothing import CalibrationWalk, JointEstimate, estimate_jointly, mode_names
from pdr_filter.offline.calibration.model_forms import models_of
from pdr_filter.offline.calibration.priors import StepLengthPrior
from pdr_filter.offline.calibration.segments import MIN_WAYPOINT_DISTANCE_M, has_known_lengths, segments_of, truth_fixes
from pdr_filter.offline.robust_loss import LOSSES
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.offline.smoothing.smooth import reckoned_walk
from pdr_filter.offline.smoothing.smoothed import Smoothed
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.recipes.config import Config
from pdr_filter.values import Fix, FloatArray, SpeedFix, Step, Table, steps_of, table
from pdr_filter.values.recording import Recording, Truth


def calibrate_by_smoothing(
    recordings: Sequence[Recording],
    people: Sequence[str],
    priors: Mapping[str, StepLengthPrior],
    config: Config | None,
    separate: Mapping[str, str],
    observed: tuple[Sequence[Sequence[Fix]], Sequence[Sequence[LoopClosure]]],
    *,
    measure: str,
    loss: str,
    anchor_std_m: float | None,
    recording_std: float,
    walking: str,
    notes: Sequence[str],
    progress: Callable[[float], None] | None,
) -> Calibration:
    """Return the calibration of recordings that are smoothed together with the step-length parameters.

    `people` has the name of the person of each recording, and `observed` the fixes and the loop closures of each. The
    other parameters are those of `calibrate`.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    scale_std = scale_std_of(priors.get(walking), recording_std)
    walks, remarks = list[CalibrationWalk](), list[str](notes)
    walk_of = partial(
        calibration_walk,
        config=config,
        separate=separate,
        measure=measure,
        anchor_std_m=anchor_std_m,
        scale_std=scale_std,
    )
    for i, (recording, name, fixes, closures) in enumerate(zip(recordings, people, *observed, strict=True), 1):
        walk, of_walk = walk_of(recording, name, fixes=list(fixes), closures=list(closures))
        walks.append(walk)
        remarks += of_walk
        if progress is not None:
            progress(0.5 * i / len(recordings))
    unscaled = [f"{w.walk.track.name}: {why}" for w in walks if (why := _why_without_scale(w))]
    if len(unscaled) == len(walks):
        raise ValueError("nothing to calibrate with: " + "; ".join(unscaled))
    remarks += unscaled

    def of_estimate(share: float) -> None:
        if progress is not None:
            progress(0.5 + 0.5 * share)

    found = estimate_jointly(walks, priors, separate, recording_std, loss, of_estimate)
    wrong = [_why_impossible(of, smoothed) for of, smoothed in zip(walks, found.smoothed, strict=True)]
    if all(wrong):
        raise ValueError("nothing to calibrate with: " + "; ".join(wrong))
    if any(wrong):
        remarks += [f"WARNING: not used: {why}" for why in wrong if why]
        for i, (recording, name) in enumerate(zip(recordings, people, strict=True)):
            if wrong[i]:
                bare = replace(recording, truth=Truth(), location=None)
                walks[i], _ = walk_of(bare, name, fixes=[], closures=[])
        found = estimate_jointly(walks, priors, separate, recording_std, loss, of_estimate)
    if progress is not None:
        progress(1.0)
    if not found.converged:
        remarks.append(f"the calibration did not converge in {found.n_iterations} iterations: treat it with caution")
    for of, is_wrong, smoothed in zip(walks, found.outliers, found.smoothed, strict=True):
        name, of_sensors = of.walk.track.name, of.walk.track.notes
        remarks += [f"{name}: {note}" for note in smoothed.notes if note not in of_sensors]
        wrong = [s for s, is_one in zip(of.segments, is_wrong, strict=True) if is_one]
        remarks += [f"distrusted: {s.name}: {s.distance_m:.2f} m given, which its steps contradict" for s in wrong]
    heights_m = {w.subject: w.height_m for w in walks}
    rows = _table(walks, found, priors, separate, tuple(heights_m))
    return calibration_of(
        priors,
        found,
        heights_m,
        rows,
        (*length_warnings(rows, rows.distance_m, priors, recording_std), *remarks),
        n_recordings=len(walks),
        counts={"observations": sum(int((w.found.weight > 0).sum()) + len(w.segments) for w in walks)},
        residual_std_m={name: float(p.step_std_m) for name, p in priors.items()},
        n_segments={name: float(np.sum(rows.context == name)) for name in priors},
        mode_contexts=separate,
        tracks=tuple(s.track for s in found.smoothed),
    )


def calibration_walk(
    recording: Recording,
    subject: str,
    config: Config | None,
    fixes: list[Fix],
    closures: list[LoopClosure],
    separate: Mapping[str, str],
    measure: str,
    anchor_std_m: float | None,
    scale_std: float,
) -> tuple[CalibrationWalk, list[str]]:
    """Return the walk of a recording with its observations, and notes about unused ones."""
    notes: list[str] = []
    speeds = [fix for fix in fixes if isinstance(fix, SpeedFix)]
    if speeds:
        notes.append(f"{recording.name}: {len(speeds)} speed fixes are not used to calibrate step lengths")
        fixes = [fix for fix in fixes if not isinstance(fix, SpeedFix)]
    if (fixes or closures) and recording.gyroscope is None:
        notes.append(
            f"{recording.name}: no gyroscope, so no headings: fixes and loop closures do not calibrate its step lengths"
        )
    if not fixes and recording.gyroscope is not None:
        fixes = [*truth_fixes(recording, anchor_std_m)]
    walk = reckoned_walk(recording, config, fixes, closures, scale_std)
    segments: tuple[Any, ...] = ()
    # the graph has waypoints and locations as positions
    if not fixes and (has_known_lengths(recording.truth) or not walk.observed.locations):
        found, remarks = segments_of(recording, walk.track, anchor_std_m, measure, subject, separate)
        segments, notes = tuple(found), [*notes, *remarks]
    return CalibrationWalk(subject, recording.subject.height_m, walk, *walk.solved(), segments), notes


def _why_without_scale(of: CalibrationWalk) -> str:
    """Return why the observations of a walk do not determine its step lengths, with a remedy, or an empty string."""
    problem, is_used = of.posed.problem, of.found.weight > 0
    positions = problem.positions
    is_place = positions.other < 0
    n_places = len(np.unique(positions.node[is_place]))
    apart_m = float(np.hypot(*np.ptp(positions.position_m[is_place], axis=0))) if n_places > 1 else 0.0
    if not (apart_m >= MIN_WAYPOINT_DISTANCE_M or len(problem.measurements) or of.segments):
        return (
            f"it has no two positions (fixes, locations, waypoints) that are {MIN_WAYPOINT_DISTANCE_M:g} m apart with "
            "steps between them, no range or another measurement of the position, and no stretch of known length: give "
            "one of them, because loop closures alone have no scale"
        )
    n_used, n_rejected = int(is_used.sum()), int((~is_used).sum())
    if of.segments or not FixConflict(n_used, n_rejected).is_doubtful:
        return ""
    cause = "their clock, units or axes are probably wrong"
    if not n_places:
        cause = "the smoother has probably found a wrong solution, as with ranges to one anchor"
    return (
        f"the walk contradicts {n_rejected} of its {len(is_used)} observations: {cause}; check them, or give "
        "positions, or ranges to more anchors"
    )


def _why_impossible(of: CalibrationWalk, smoothed: Smoothed) -> str:
    """Return why nobody takes the smoothed steps of a walk, with a remedy, or an empty string."""
    track, runs = smoothed.track, [mode.meaning.runs for mode in of.walk.config.model.modes]
    n_running = float(track.mode_prob[:, runs].sum())
    text = impossible_steps(track.distance_m, float(track.n_steps), n_running)
    return f"{track.name}: {text}" if text else ""


def _table(
    walks: Sequence[CalibrationWalk],
    found: JointEstimate,
    priors: Mapping[str, StepLengthPrior],
    separate: Mapping[str, str],
    subjects: Sequence[str],
) -> Table:
    """Return the table `Calibration.segments`, with a row for each context of a walk of a few metres.

    The known length is that of the smoothed walk.
    """
    slices, _ = slices_of(models_of(priors))
    start = np.concatenate([p.mean for p in priors.values()])
    rows: list[dict[str, Any]] = []
    for of, smoothed in zip(walks, found.smoothed, strict=True):
        track, weight = of.walk.track, of.found.weight
        share = float(weight.mean()) if len(weight) else 1.0
        names, own = mode_names(of.walk.config.model, separate), found.people[subjects.index(of.subject)]
        scale, steps = np.exp(smoothed.log_scale), steps_of(track.steps)
        for name, part in slices.items():
            prob = track.mode_prob @ np.array([float(n == name) for n in names])
            model = of_height(priors[name].model, of.height_m)
            predicted_m = prob * _lengths_m(model, steps, own[part])
            if not predicted_m.sum() >= MIN_WAYPOINT_DISTANCE_M:
                continue
            inside = np.flatnonzero(prob > 0.5 * prob.max())
            row = {
                "subject": of.subject,
                "recording": track.name,
                "context": name,
                "start_s": float(track.time_s[inside[0]]),
                "end_s": float(track.time_s[inside[-1]]),
                "distance_m": float(scale @ predicted_m),
                "n_steps": float(prob.sum()),
                "summed": True,
                "predicted_m": float(predicted_m.sum()),
                "left_out_m": np.nan,
                "stranger_m": np.nan,
                "uncalibrated_m": float(prob @ _lengths_m(model, steps, start[part])),
                "misfit": float(np.log(scale @ predicted_m / predicted_m.sum())) / max(found.recording_std, 1e-9),
                "weight": share,
                "distrusted": bool(len(weight)) and share == 0.0,
            }
            rows.append(row)
    if not rows:
        raise ValueError(f"no walk leads over {MIN_WAYPOINT_DISTANCE_M:g} m in any context: record longer walks")
    return table({column: np.array([row[column] for row in rows]) for column in rows[0]})


def _lengths_m(model: StepLengthModel, steps: Sequence[Step], theta: FloatArray) -> FloatArray:
    """Return the lengths (K,) of steps."""
    return np.array([float(length_and_jacobian(model, step, theta)[0]) for step in steps])
