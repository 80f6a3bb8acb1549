"""Result of smoothing: the track, the estimated offsets and scales, and the use of each observation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE
from pdr_filter.offline.smoothing.location_errors import mean_position
from pdr_filter.offline.smoothing.observations import FloorChange, Observations
from pdr_filter.offline.smoothing.solve import Solution
from pdr_filter.offline.smoothing.usable import Used, name_list
from pdr_filter.tracking.step_statistics import HEADING_UNKNOWN, LATE, UNKNOWN_HEADING_RAD, StepCounts
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.warnings import NORTH_UNKNOWN, heading_note, north_note
from pdr_filter.values import FixResult, FloatArray, IntArray, PositionFix, Table, how_many, read_only, reduction, table

_KINDS = ("fix", "location", "loop closure", "known heading")
# Variance of the first heading above which the observations do not determine the direction of the walk.
_UNKNOWN_START_RAD2 = 0.5
# standard deviation of a known position
KNOWN_STD_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Smoothed track, with the estimated heading offsets and step scales and the use of each observation.

    With fixes, positions are in the frame of the fixes, and headings are clockwise from its north. Without fixes, the
    frame is the frame of the online filter, which starts at zero with the first heading.

    Attributes
    ----------
    track : Track
        The smoothed track.
    heading_offset_rad : array (K,)
        Walking heading minus device heading after each step, including the rotation from the phone's frame to that of
        the fixes.
    heading_offset_std_rad : array (K,)
        Standard deviation of `heading_offset_rad`.
    log_scale : array (K,)
        Natural logarithm of the factor on the step lengths after each step.
    log_scale_std : array (K,)
        Standard deviation of `log_scale`.
    start_position_m : array (2,)
        Position before the first step, east and north.
    start_position_cov_m2 : array (2, 2)
        Covariance of `start_position_m`.
    observations : structured array
        One row per observation: `kind` ("fix", "location", "loop closure" or "known heading"), `number` in its
        sequence, `time_s`, `nis` and `weight`. `nis` is the normalised innovation squared relative to all other
        observations, or NaN if the observation was not part of the problem. `weight` is 1 if the observation was used.
        It is 0 if the observation was rejected, outside the recording or without information, or if a fix repeats its
        last position while steps continue (frozen).
    floor : array (K,)
        Storey at each step from the given floor changes, NaN before the first change.
    notes : tuple of str
        Warnings and remarks.
    values : gtsam.Values or None
        All unknowns of the factor graph if `smooth` was given factors.

    See Also
    --------
    pdr_filter.smooth : Return a smoothed track.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> smoothed = pdr.smooth(walk)
    >>> len(smoothed.log_scale) == smoothed.track.n_steps, len(smoothed.rejected)
    (True, 0)
    """

    track: Track
    heading_offset_rad: FloatArray
    heading_offset_std_rad: FloatArray
    log_scale: FloatArray
    log_scale_std: FloatArray
    start_position_m: FloatArray
    start_position_cov_m2: FloatArray
    observations: Table
    floor: FloatArray
    notes: tuple[str, ...]
    values: Any = None

    __reduce__ = reduction

    @property
    def scale(self) -> float:
        """Factor of the person on all step lengths, geometric mean over the steps, or 1 without steps."""
        return float(np.exp(self.log_scale.mean())) if len(self.log_scale) else 1.0

    @property
    def scale_std(self) -> float:
        """Standard deviation of `scale`, an error that all steps share, or NaN without steps."""
        return float(self.scale * self.log_scale_std.mean()) if len(self.log_scale) else np.nan

    @property
    def rejected(self) -> Table:
        """Rows of `observations` that were not used, for any reason."""
        return self.observations[self.observations.weight < 0.5].view(np.recarray)

    def __repr__(self) -> str:
        return (
            f"Smoothed({self.track!r}, scale {self.scale:.3f} +- {self.scale_std:.3f}, {len(self.rejected)} rejected)"
        )


def observation_table(observed: Observations, row: IntArray | None = None, found: Solution | None = None) -> Table:
    """Return the table `Smoothed.observations`: fixes, locations, loop closures and known headings, in this order.

    `row` has the row of each observation in the solution, or -1 if it was not part of the problem. Without a solution,
    every `nis` is NaN and every `weight` 0. The time of a loop closure is its second one, that of a known heading its
    first one.
    """
    times_s = [
        [f.time_s for f in observed.fixes],
        [f.time_s for f in observed.locations],
        [c.second_s for c in observed.loop_closures],
        [h.start_s for h in observed.known_headings],
    ]
    counts = [len(t) for t in times_s]
    nis, weight = np.full(sum(counts), np.nan), np.zeros(sum(counts))
    if found is not None and row is not None:
        used = row >= 0
        nis[used], weight[used] = found.nis[row[used]], found.weight[row[used]]
    return table(
        {
            "kind": np.repeat(_KINDS, counts),
            "number": np.concatenate([np.arange(n) for n in counts]),
            "time_s": np.concatenate([np.array(t, dtype=float) for t in times_s]),
            "nis": nis,
            "weight": weight,
        }
    )


def fix_results(observed: Observations, observations: Table, used: Used, end_s: float) -> tuple[FixResult, ...]:
    """Return the outcome of each fix, followed by each location: "used", "rejected", "frozen" or "repeated".

    A fix is frozen if it repeats the last position while steps continue, and repeated if it was delivered again. All
    other unused fixes are "rejected", also those outside the recording. `end_s` is the end of the recording.
    """
    fixes = (*observed.fixes, *observed.locations)
    rows = zip(fixes, observations.weight.tolist(), observations.nis.tolist(), used.repetitions, strict=False)
    return tuple(
        FixResult.of(f, end_s, repetition or ("used" if weight >= 0.5 else "rejected"), nis)
        for f, weight, nis, repetition in rows
    )


def notes_of_solution(
    track: Track,
    found: Solution,
    observations: Table,
    observed: Observations,
    used: Used,
    prior_log_scale_std: float,
) -> list[str]:
    """Return warnings about the solution, such as rejected observations and unknown directions.

    `prior_log_scale_std` is the standard deviation of the log scale (logarithm of the factor on the step lengths)
    before any fix.
    """
    notes: list[str] = []
    for kind in _KINDS:
        rows = (observations.kind == kind) & (observations.weight < 0.5) & ~np.isnan(observations.nis)
        if kind == "location" and rows.any():
            times = name_list([f"{t:.0f}" for t in observations.time_s[rows]])
            notes.append(f"the walk contradicts {how_many(int(rows.sum()), 'location')}, at {times} s: not used")
            continue
        if observed.is_loop and kind == "loop closure":
            last = int(np.flatnonzero(observations.kind == kind)[-1])
            if rows[last]:
                notes.append("the walk did not end within 1 m of its start: loop was not used")
            rows[last] = False
        if rows.any():
            notes.append(f"{kind} {name_list(observations.number[rows])}: not used, because the walk contradicts it")
    n_good = int((observations.weight[np.isin(observations.kind, _KINDS[:2])] >= 0.5).sum())
    if used.has_positions and n_good == 0:
        notes.append(
            "no fix agrees with the walk: positions in the frame of the fixes are unknown; check the times, the units "
            "and the axes of the fixes"
        )
    elif n_good == 1 and _is_without_direction(found):
        notes.append("a single fix gives a position but no direction: the walking directions are unknown; add a fix")
    elif n_good and _is_without_direction(found):
        notes.append("the fixes do not determine the direction of the walk: the most probable north is used")
    if used.knows_north and (found.weight[-used.n_north :] < 0.5).any():
        notes.append("magnetic north contradicts all other observations of the walk: not used")
    is_north = used.frame == "north"
    if is_north or (not used.frame and any(NORTH_UNKNOWN in note for note in track.notes)):
        last_rad = np.hypot(track.steps.north_std_rad[-1:], track.steps.shown_offset_std_rad[-1:])
        notes.append(north_note(float((used.states.std[-used.n_north :] if is_north else last_rad).min())))
    log_scale = float(found.mean[:, LOG_SCALE].mean())
    if n_good and abs(log_scale) > 2.0 * prior_log_scale_std:
        longer = "longer" if log_scale > 0 else "shorter"
        notes.append(
            f"the fixes make the steps {abs(np.expm1(log_scale)):.0%} {longer} than the step-length model, "
            f"{abs(log_scale) / prior_log_scale_std:.1f} standard deviations: compare with the walk smoothed without "
            'fixes (gnss="off" for locations)'
        )
    unknown_s = float(np.asarray(track.steps.heading_unknown_s).sum())
    if unknown_s > 1.0 and n_good:
        notes.append(
            f"no angular rate for {unknown_s:.0f} s: the directions there come only from the fixes before and after"
        )
    if not found.converged:
        notes.append(
            "the least squares did not converge, because there is too little information on this walk: do not use the "
            "track, or add fixes"
        )
    return notes


# Texts of warnings about headings while walking, which the smoother has estimated again.
_ONLINE_ALONE = (HEADING_UNKNOWN, LATE, NORTH_UNKNOWN)
# Standard deviation of the smoothed heading from which a note says what the online track warns of: half of the limit of
# the online track. A step then ends at a quarter of its length beside its true end.
_DOUBTFUL_HEADING_RAD = 0.5 * UNKNOWN_HEADING_RAD


def notes_of_reckoning(track: Track, found: Solution, heading_std_rad: FloatArray) -> list[str]:
    """Return the notes of the dead-reckoned track that hold for the smoothed track.

    If one warns about unknown headings, the note is about the smoothed headings with standard deviations
    `heading_std_rad` (K,) instead. One step with an angular rate is enough for it, because the direction of a phone
    that was moved is known from its first step on. If these headings are known and some are doubtful, the note gives
    the largest standard deviation. There is no note if the direction of the whole walk is unknown, because another
    one says so.
    """
    notes = [note for note in track.notes if not any(text in note for text in _ONLINE_ALONE)]
    if _is_without_direction(found) or not any(HEADING_UNKNOWN in note for note in track.notes):
        return notes
    # notes about samples and fixes name the time without angular rate
    measured_std_rad = np.where(np.asarray(track.steps.heading_unknown_s) > 0, 0.0, heading_std_rad)
    k = int(measured_std_rad.argmax())
    if measured_std_rad[k] > UNKNOWN_HEADING_RAD:
        (unknown,) = np.nonzero(heading_std_rad > UNKNOWN_HEADING_RAD)
        first_s, last_s = track.time_s[unknown[[0, -1]]].tolist()
        counts = StepCounts(track.n_steps, heading_unknown=len(unknown), unknown_from_s=first_s, unknown_until_s=last_s)
        return [*notes, heading_note(counts).text]
    if measured_std_rad[k] > _DOUBTFUL_HEADING_RAD:
        std_rad = measured_std_rad[k]
        words = f"the smoothed heading is uncertain by up to {std_rad:.2f} rad, at {track.time_s[k]:.0f} s, "
        notes.append(words + f"and that of the online track by more than {UNKNOWN_HEADING_RAD} rad: {HEADING_UNKNOWN}")
    return notes


def _is_without_direction(found: Solution) -> bool:
    """True if the observations do not determine the direction of the walk at its start."""
    return bool(found.joint_cov[0, HEADING_OFFSET, HEADING_OFFSET] > _UNKNOWN_START_RAD2)


def floors_at_steps(track: Track, floor_changes: Sequence[FloorChange]) -> FloatArray:
    """Return the storey (K,) at each step from the given floor changes, NaN before the first one."""
    changes = sorted(floor_changes, key=lambda c: c.time_s)
    index = np.searchsorted([c.time_s for c in changes], track.time_s, side="right") - 1
    floors = np.array([np.nan, *(float(c.floor) for c in changes)])
    return read_only(floors[index + 1])


def without_steps(track: Track, observed: Observations, fixes: Sequence[PositionFix]) -> Smoothed:
    """Return the result of a recording without steps: the position is the weighted mean of the fixes.

    Without fixes it is zero, with the covariance of a known position.
    """
    place, cov = mean_position(fixes) if fixes else (np.zeros(2), KNOWN_STD_M**2 * np.eye(2))
    none = read_only(np.zeros(0))
    return Smoothed(
        track=replace(track, is_smoothed=True),
        heading_offset_rad=none,
        heading_offset_std_rad=none,
        log_scale=none,
        log_scale_std=none,
        start_position_m=read_only(place),
        start_position_cov_m2=read_only(cov),
        observations=observation_table(observed),
        floor=floors_at_steps(track, observed.floor_changes),
        notes=track.notes,
    )
