"""Alignment of a dead-reckoned track to the locations of its recording, by one rotation and one shift."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.filter.chain.handler import part_of, with_part, with_pedestrian
from pdr_filter.filter.chain.with_height import HeightTrack
from pdr_filter.filter.fixes.gnss import INTERVAL_S, LocationState, position_fixes
from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.filter.height.height_filter import HeightState
from pdr_filter.filter.pedestrian.alignment import walked_var_m2
from pdr_filter.filter.pedestrian.frame import UNKNOWN_FRAME, Frame
from pdr_filter.filter.pedestrian.frame_rotation import PairedPoint, align, centre_weights, consistent_pairs
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.filter.pedestrian.repeated_fixes import Repetition, repetitions
from pdr_filter.tracking.filtering import Output, State
from pdr_filter.tracking.step_statistics import is_moving
from pdr_filter.values import (
    ContextSet,
    FixOutcome,
    FixResult,
    FloatArray,
    PositionFix,
    Samples,
    interpolated_rows,
    read_only,
)
from pdr_filter.values.recording import Recording

# Maximum number of locations used for the alignment. Of more locations, this number is taken at even intervals, because
# the computing time grows with the fourth power of the number.
MAX_LOCATIONS = 40


@dataclass(frozen=True, slots=True, eq=False)
class DeadReckoning:
    """Dead-reckoned positions including the start, with their variances for an exactly known heading."""

    time_s: FloatArray  # (K + 1,) times of the start and of the steps, s
    position_m: FloatArray  # (K + 1, 2) positions in the frame of the start, m
    walked_m: FloatArray  # (K + 1,) walked distance, m
    # (K + 1,) variance of each position that remains if the heading is known exactly, mean of both axes, m^2. It
    # increases monotonically.
    walked_var_m2: FloatArray

    @classmethod
    def of(cls, start_s: float, updates: Sequence[StepUpdate], var_m2: Sequence[float]) -> DeadReckoning:
        """Return the dead-reckoned positions of final steps, given the start time and `walked_var_m2` at each step."""
        places = [update.position_m if update.of_start is None else update.of_start.position_m for update in updates]
        return cls(
            np.array([start_s, *(update.step.time_s for update in updates)]),
            np.vstack([np.zeros((1, 2)), *places]),
            np.array([0.0, *(update.walked_m for update in updates)]),
            np.array([0.0, *var_m2]),
        )

    def at(self, time_s: float) -> tuple[FloatArray, float]:
        """Return the position (2,) in m and `walked_var_m2`, interpolated at a time."""
        place = interpolated_rows(time_s, self.time_s, np.column_stack([self.position_m, self.walked_var_m2]))
        return read_only(place[:2]), float(place[2])

    def own_var_m2(self, agreeing: Sequence[PairedPoint]) -> FloatArray:
        """Return the variance (K,) in m^2 that dead reckoning adds to the variance of the alignment at each position.

        The alignment fixes the centre of the track, which is the weighted mean of the paired locations. The variance of
        an aligned position along each axis is the variance of this centre plus the result. Let w(t) be the variance of
        dead reckoning until t. Its error is shared by all later positions, so that the covariance of two positions is
        min(w(t), w(s)). Let a_i be the weights of the locations in the centre, and w_i the variances w at their times.
        The dead-reckoning error at t relative to the error of the centre has the variance

            w(t) - 2 sum_i a_i min(w(t), w_i) + sum_ij a_i a_j min(w_i, w_j).

        The variance of the centre already contains the last sum minus w_0, the smallest w_i. The result is therefore
        w(t) - 2 sum_i a_i min(w(t), w_i) + w_0. It is negative for positions near the centre, which are more certain
        than the centre itself.
        """
        weight, walked = centre_weights(agreeing), np.array([pair.walked_var_m2 for pair in agreeing])
        shared = [float(weight @ np.minimum(w, walked)) for w in self.walked_var_m2[1:]]
        return self.walked_var_m2[1:] - 2.0 * np.array(shared) + walked.min()


@dataclass(frozen=True, slots=True, eq=False)
class AlignedTrack:
    """Alignment of a track to the locations of its recording."""

    locations: LocationState  # state of the conversion from locations to fixes
    fixes: tuple[PositionFix, ...]  # position fixes from the locations
    # For each fix, whether and how it repeats the previous position (`repeated_fixes.repetitions`)
    repetitions: tuple[Repetition, ...]
    pairs: tuple[PairedPoint, ...]  # for each fix, the pair of the fix and the dead-reckoned position at its time
    frame: Frame  # rotation and shift, if the locations determine them

    def results(self, at_s: float) -> list[FixResult]:
        """Return the outcome of each fix, "turned", "rejected", "frozen" or "repeated", at the time `at_s`.

        A fix is "turned" if it determined the alignment. It is "frozen" if it repeats the last position during walking,
        and "repeated" if it does so at the same place.
        """
        outcomes: list[FixOutcome] = [
            repetition or ("turned" if pair in self.frame.agreeing else "rejected")
            for repetition, pair in zip(self.repetitions, self.pairs, strict=True)
        ]
        return [FixResult.of(fix, at_s, outcome) for fix, outcome in zip(self.fixes, outcomes, strict=True)]


def align_dead_reckoning(
    location: Samples, reckoning: DeadReckoning, first_s: float, last_s: float, n_steps: int
) -> AlignedTrack:
    """Return the alignment of a track to the locations between the times of its first and last sample."""
    locations, fixes = _even_fixes(location, first_s, last_s)
    repeated = tuple(repetitions(fixes, reckoning.time_s, reckoning.position_m, reckoning.walked_m))
    pairs = tuple(_paired(reckoning, fix) for fix in fixes)
    asked = tuple(pair for pair, repetition in zip(pairs, repeated, strict=True) if not repetition)
    frame = _frame(asked, n_steps) if fixes else UNKNOWN_FRAME
    return AlignedTrack(locations, fixes, repeated, pairs, frame)


def aligned_outputs(
    recording: Recording, results: Iterable[tuple[State, Output]], contexts: ContextSet
) -> Iterator[tuple[State, Output]]:
    """Yield the last state and the whole output of dead reckoning, aligned to the locations of the recording.

    `results` are from `whole_recording.outputs` in an unknown frame. The yielded state contains the alignment, from
    which `whole_recording.track_of_outputs` computes the track in the frame of the locations. The output contains a
    result for each fix that was compared. Nothing is yielded for a recording without locations.
    """
    last: State | None = None
    whole, var_m2 = Output(), list[float]()
    for state, output in results:
        last = state
        whole.extend(output)
        if any(update.is_final for update in output.updates):
            pedestrian = state.pedestrian
            walked = walked_var_m2(pedestrian.estimates.combined[1])
            var_m2 += [walked] * sum(update.is_final for update in output.updates)
    if last is None or recording.location is None:
        return
    report, pedestrian = last.sensing.conditioner.report, last.pedestrian
    finals = [update for update in whole.updates if update.is_final]
    reckoning = DeadReckoning.of(report.first_time_s, finals, var_m2)
    alignment = align_dead_reckoning(
        recording.location, reckoning, report.first_time_s, report.last_time_s, pedestrian.steps.n_final
    )
    if alignment.fixes:
        n_frozen, n_repeated = (alignment.repetitions.count(kind) for kind in ("frozen", "repeated"))
        fixes = replace(pedestrian.fixes, n_frozen=n_frozen, n_repeated=n_repeated)
        pedestrian = replace(pedestrian, frame=alignment.frame, fixes=fixes)
        whole.fixes.extend(alignment.results(last.sensing.processed_s))
        if pedestrian.frame.alignment is not None:
            whole.updates[:] = _with_own_errors(finals, reckoning.own_var_m2(alignment.frame.agreeing))
    step_time_s = np.array([update.step.time_s for update in finals])
    window_time_s = np.array([window.time_s for window in whole.windows])
    moves = is_moving(np.array([window.prob[contexts.standing].sum() for window in whole.windows]))
    rides = Rides.of(alignment.fixes, step_time_s, window_time_s, moves)
    n_rejected = sum(fix.outcome == "rejected" for fix in whole.fixes)
    height = part_of(last.chain, HeightTrack)
    height = replace(height, height=_with_altitudes(height.height, alignment.fixes, finals))
    chain = with_pedestrian(with_part(last.chain, height), pedestrian)
    statistics = replace(last.statistics, rides=rides, n_rejected_fixes=n_rejected)
    yield replace(last, chain=chain, locations=alignment.locations, statistics=statistics), whole


def _even_fixes(location: Samples, first_s: float, last_s: float) -> tuple[LocationState, tuple[PositionFix, ...]]:
    """Return the state of the conversion of locations, and the fixes between two times.

    Successive fixes are at least `INTERVAL_S` apart, or more on a long walk, so that about `MAX_LOCATIONS` remain.
    """
    inside = (location.time_s >= first_s) & (location.time_s <= last_s)
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values[inside].T
    interval_s = max(INTERVAL_S, (last_s - first_s) / MAX_LOCATIONS) if inside.any() else INTERVAL_S
    where = latitude_deg, longitude_deg, accuracy_m
    return position_fixes(LocationState(), location.time_s[inside], *where, interval_s, altitude_m)


def _with_altitudes(state: HeightState, fixes: Sequence[PositionFix], finals: Sequence[StepUpdate]) -> HeightState:
    """Return the height state with the altitude of the start, estimated from fixes and step heights."""
    altitude = state.start_altitude
    for fix in fixes:
        n_before = bisect_right(finals, fix.time_s, key=lambda update: update.step.time_s)
        height_m, std_m = (finals[n_before - 1].height_m, finals[n_before - 1].height_std_m) if n_before else (0.0, 0.0)
        if fix.altitude_m is not None:
            altitude = altitude.with_fix(fix, height_m, std_m**2)
    return replace(state, start_altitude=altitude)


def _paired(reckoning: DeadReckoning, fix: PositionFix) -> PairedPoint:
    track_m, var_m2 = reckoning.at(fix.time_s)
    return PairedPoint(track_m, fix.position_m, fix.var_m2, var_m2, fix.time_s, fix.correlation_s)


def _frame(pairs: tuple[PairedPoint, ...], n_steps: int) -> Frame:
    agreeing, rotation = consistent_pairs(pairs)
    alignment = align(agreeing, n_steps)
    if alignment is None:
        return Frame(is_joined=False, pairs=pairs, agreeing=agreeing, rotation=rotation)
    return Frame(is_joined=True, agreeing=agreeing, alignment=alignment)


def _with_own_errors(updates: Sequence[StepUpdate], own_var_m2: FloatArray) -> list[StepUpdate]:
    """Return steps whose covariance in the start frame is what dead reckoning adds to their aligned positions.

    `own_var_m2` (K,) is its variance along each axis.
    """
    moved: list[StepUpdate] = []
    for update, own_var in zip(updates, own_var_m2.tolist(), strict=True):
        if update.of_start is not None:
            update = replace(update, of_start=replace(update.of_start, cov_m2=own_var * np.eye(2)))
        moved.append(update)
    return moved
