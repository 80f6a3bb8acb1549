"""Stretches of known length in recordings, and the sums over their steps for a calibration.

A segment is preintegrated. Whatever its number of steps, it enters the calibration as the sum of the regressors of the
steps times the sine and cosine of their headings. Given this sum, the displacement is linear in the parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.calibration_result import UNNAMED, of_height, slices_of
from pdr_filter.filter.step_length.models import StepLengthModel, is_linear, length_and_jacobian
from pdr_filter.values import (
    CONTEXTS,
    RADIUS_68,
    FloatArray,
    IntArray,
    Origin,
    PositionFix,
    Step,
    TrackRows,
    check_array,
    limits,
    steps_of,
)
from pdr_filter.values.recording import Recording, Truth
from pdr_filter.values.sanitise import free_name

# Standard deviation of the distance between two clicked landmarks. Clicks are up to 0.8 s early or 0.1 s late, which is
# about 0.25 m at each end (measured on 133 straight legs of one person; docs/methods/step_length.md).
ANCHOR_STD_M = 0.35
# A segment shorter than this is a single step (group B of Martinelli et al. 2018: one stair, 0.29 or 0.43 m). Its
# length is that of the tread and not a distance between clicks.
SINGLE_STEP_M = 1.5
# Standard deviation of the distance between two waypoints on a floor map: the residual of 165 legs between waypoints.
WAYPOINT_STD_M = 0.9
STRIDE_STD_M = 0.02  # strides from motion capture or an instrumented walkway, and treads
# Closer waypoints give little information about the steps between them, because the path may turn a corner.
MIN_WAYPOINT_DISTANCE_M = 4.0
# Waypoints that are closer in time or distance are grouped into stretches of `GROUPED_M`, about ten times the standard
# deviation of a waypoint. The steps at both ends are only partly inside, and three seconds contain at most five or six
# steps.
MIN_WAYPOINT_TIME_S, GROUPED_M = 3.0, 10.0
# GNSS fixes are thinned until they are this far apart, in metres and in multiples of the standard deviation of their
# distance.
MIN_FIX_DISTANCE_M, MIN_FIX_DISTANCE_STDS = 20.0, 4.0
# Relative difference of detected and counted steps from which a note names a segment. Detected steps of careful walks
# are within 5 %. The counted steps do not enter the calibration: lengths per counted step predict held-out walks no
# better than lengths per detected step (ipol, 60 walks of 10 people: 4.4 and 4.3 % RMS), because a detector that misses
# steps of a person misses them in later walks too.
MAX_MISCOUNT = 0.1
MIN_STEPS = 0.5  # a stretch with less than half a step is empty
_MIN_PROB = 1e-3  # a context with a smaller probability adds less than a millimetre to a step


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Steps of one person between two places whose distance is known.

    Parameters
    ----------
    subject : str
        Name of the person.
    recording : str
        Name of the recording. Segments of one recording share its error of scale.
    distance_m : float
        Displacement between the two places in m, or walked distance if `heading_rad` is None.
    steps : tuple of Step
        The n steps that are at least partly between the two places.
    inside : array (n,)
        Share of each step that is inside, 0 to 1.
    heading_rad : array (n,) or None
        Directions of the steps in rad, clockwise. They may share one unknown rotation per segment. None if the
        directions are unknown: then step lengths are summed instead of step vectors.
    context_prob : array (n, C)
        Context probabilities of each step.
    anchor_std_m : float, default 0.35
        Standard deviation of `distance_m`.
    height_m : float, optional
        Body height of the person.
    start_s : float, default 0.0
        Time at the first place, in s.
    end_s : float, default 0.0
        Time at the second place, in s.
    context_names : tuple of str, optional
        Names of the C contexts, by default `CONTEXTS`.

    See Also
    --------
    segments_of : Segments of a recording.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.offline.calibration.segments import Segment
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> walking = np.eye(6)[[1, 1]]  # two steps in the context "walking"
    >>> segment = Segment("anna", "corridor", 1.3, (TYPICAL_STEP,) * 2, np.array([1.0, 0.5]), None, walking)
    >>> segment.n_steps, segment.is_along
    (1.5, True)
    """

    subject: str
    recording: str
    distance_m: float
    steps: tuple[Step, ...]
    inside: FloatArray
    heading_rad: FloatArray | None
    context_prob: FloatArray
    anchor_std_m: float = ANCHOR_STD_M
    height_m: float | None = None
    start_s: float = 0.0
    end_s: float = 0.0
    context_names: tuple[str, ...] = CONTEXTS

    @property
    def name(self) -> str:
        """Name of the segment in messages: recording and times."""
        return f"{self.recording} {self.start_s:.1f}-{self.end_s:.1f} s"

    @property
    def steps_in(self) -> FloatArray:
        """Expected number of steps of each context, shape (C,): context probabilities summed over the steps inside."""
        return np.asarray(self.inside @ self.context_prob)

    @property
    def n_steps(self) -> float:
        """Number of steps, which may include fractions of steps."""
        return float(self.inside.sum())

    @property
    def is_along(self) -> bool:
        """True if step lengths are summed, False if step vectors are summed."""
        return self.heading_rad is None

    def sums(self, context: str, model: StepLengthModel, about: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sums over the steps of one context: the derivative of the displacement, and a constant.

        Near the parameters `about`, the displacement is derivative @ theta + constant.

        Parameters
        ----------
        context : str
            Name of the context.
        model : StepLengthModel
            Step-length model of the context. A model with a `height_m` takes the body height of the person.
        about : array (p,)
            Parameters at which a nonlinear model is linearised.

        Returns
        -------
        derivative : array (2, p)
            Derivative of the displacement, east and north, with respect to the parameters.
        constant : array (2,)
            Displacement at theta = 0, which is zero for a linear model.
        """
        own = of_height(model, self.height_m)
        weight = self.inside * self.context_prob[:, self.context_names.index(context)]
        used = np.flatnonzero(weight > _MIN_PROB)
        if self.heading_rad is None:
            vectors = np.stack([weight[used], np.zeros(len(used))])
        else:
            vectors = np.stack([np.sin(self.heading_rad[used]), np.cos(self.heading_rad[used])]) * weight[used]
        pairs = [length_and_jacobian(own, self.steps[k], about) for k in used]
        jacobian = np.array([j for _, j in pairs]).reshape(-1, model.n_params)
        if is_linear(model):
            return vectors @ jacobian, np.zeros(2)
        length = np.array([float(x) for x, _ in pairs])
        return vectors @ jacobian, vectors @ (length - jacobian @ about)


@dataclass(frozen=True, eq=False)
class SegmentSums:
    """Arrays of N segments from which a calibration is computed.

    The predicted length of a segment is | regressors @ theta + offset_m |. theta (P,) are the parameters of the person,
    for all contexts one after the other (`slices_of`).
    """

    # (N, 2, P) sums over the steps of context probability times regressors times (sin, cos) of the heading. The second
    # row is zero if step lengths are summed.
    regressors: FloatArray
    offset_m: FloatArray  # (N, 2) constant part of the displacement, zero for models that are linear in theta
    distance_m: FloatArray  # (N,) known length
    anchor_std_m: FloatArray  # (N,) standard deviation of the known length
    n_steps: FloatArray  # (N,) number of steps
    context: IntArray  # (N,) index of the context with most steps
    subject: IntArray  # (N,) index into `subjects`
    recording: IntArray  # (N,) index into `recordings`
    subjects: tuple[str, ...]  # names of the people
    recordings: tuple[str, ...]  # names of the recordings

    def __post_init__(self) -> None:
        n = len(self.distance_m)
        if self.regressors.ndim != 3 or self.regressors.shape[:2] != (n, 2) or self.offset_m.shape != (n, 2):
            raise ValueError(
                f"regressors must be ({n}, 2, P) and offset_m ({n}, 2) for {n} distances, got "
                f"{self.regressors.shape} and {self.offset_m.shape}"
            )
        for name in ("anchor_std_m", "n_steps", "context", "subject", "recording"):
            check_array(name, getattr(self, name), "positive" if name == "n_steps" else "0 or more", (n,))
        for name in ("regressors", "offset_m"):
            check_array(name, getattr(self, name), remedy="remove segments whose steps have no features")
        check_array("distance_m", self.distance_m, "positive")

    def __len__(self) -> int:
        return len(self.distance_m)

    def rows(self, chosen: Any) -> SegmentSums:
        """Return the segments of an index or mask, with unchanged numbers of subjects and recordings."""
        names = [f.name for f in fields(self) if f.name not in ("subjects", "recordings")]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


def with_distinct_names(found: Iterable[tuple[Sequence[Segment], bool]]) -> list[Segment]:
    """Return the segments of several recordings, with a number after the name of a recording that repeats.

    Otherwise, recordings with the same name would share an error of scale. Each entry has the segments of one
    recording, and True if its person is named after the recording.
    """
    segments = list[Segment]()
    used = [(of_one, is_named_after) for of_one, is_named_after in found if of_one]
    names = distinct_names(of_one[0].recording for of_one, _ in used)
    for (of_one, is_named_after), name in zip(used, names, strict=True):
        for s in of_one:
            is_same = name == s.recording
            segments.append(s if is_same else replace(s, recording=name, subject=name if is_named_after else s.subject))
    return segments


def distinct_names(names: Iterable[str]) -> list[str]:
    """Return names, with a number after each one that repeats an earlier one."""
    used = dict[str, None]()
    for name in names:
        used[free_name(name, used.__contains__, "{} ({})")] = None
    return list(used)


def integrate(
    segments: Sequence[Segment],
    models: Mapping[str, StepLengthModel],
    theta: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
) -> SegmentSums:
    """Return the sums of segments for the step-length model of each context.

    `models` gives the order of the parameters. A model with a `height_m` takes the body height of the person. A
    nonlinear model is linearised at `theta`, which is one mapping for all segments or one mapping per segment.
    """
    slices, n_params = slices_of(models)
    regressors, offset = np.zeros((len(segments), 2, n_params)), np.zeros((len(segments), 2))
    context = np.zeros(len(segments), dtype=np.int64)
    for i, segment in enumerate(segments):
        about = theta if isinstance(theta, Mapping) else theta[i]
        context[i] = int(segment.steps_in.argmax())
        for name, model in models.items():
            regressors[i, :, slices[name]], rest = segment.sums(name, model, about[name])
            offset[i] += rest
    subjects = {name: i for i, name in enumerate(dict.fromkeys(s.subject for s in segments))}
    recordings = {name: i for i, name in enumerate(dict.fromkeys(s.recording for s in segments))}
    return SegmentSums(
        regressors=regressors,
        offset_m=offset,
        distance_m=np.array([s.distance_m for s in segments], dtype=float),
        anchor_std_m=np.array([s.anchor_std_m for s in segments], dtype=float),
        n_steps=np.array([s.n_steps for s in segments]),
        context=context,
        subject=np.array([subjects[s.subject] for s in segments], dtype=np.int64),
        recording=np.array([recordings[s.recording] for s in segments], dtype=np.int64),
        subjects=tuple(subjects),
        recordings=tuple(recordings),
    )


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch of known length between two times.

    `walked` is True if the known length is the length of the path, and False if it is the straight distance between the
    ends. `n_steps` is the counted number of steps, NaN if it is unknown.
    """

    start_s: float
    end_s: float
    distance_m: float
    anchor_std_m: float
    walked: bool = False
    n_steps: float = np.nan

    @property
    def where(self) -> str:
        """Times of the stretch, for messages."""
        return f"{self.start_s:.1f}-{self.end_s:.1f} s"


def segments_of(
    recording: Recording,
    track: TrackRows,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
    subject: str | None = None,
    separate: Collection[str] = (),
) -> tuple[list[Segment], list[str]]:
    """Return the segments of known length of a recording, with notes about the rest.

    The first of these sources in the truth is used: `segments` with a known distance, `strides`, pairs of `waypoints`
    on one floor, fixes of `location`.

    Parameters
    ----------
    recording : Recording
        Recording with a truth of known length or with locations.
    track : TrackRows
        Track of the recording, with its steps, headings and contexts.
    anchor_std_m : float, optional
        Standard deviation of the distances of `segments` and `waypoints` in m. The defaults are `ANCHOR_STD_M` and
        `WAYPOINT_STD_M`.
    measure : {"displacement", "length"}
        Sum the step vectors (default) or the step lengths. Step lengths are always summed without a gyroscope, and in
        segments of known walked distance that contain a turn.
    subject : str, optional
        Name of the person, for a recording without one.
    separate : collection of str, optional
        Names of modes that have their own step length, although they share their context with other modes. In the
        segments, these modes replace their context.

    Returns
    -------
    segments : list of Segment
        Segments with at least half a step, in order of time.
    notes : list of str
        Stretches that were not used, or whose step lengths were summed instead of step vectors, and why.

    Raises
    ------
    ValueError
        If `measure` is unknown, or if the track does not have the modes `separate`.

    Notes
    -----
    Waypoints of a segment are more than 4 m and 3 s apart. Closer ones are grouped into straight segments of 10 m. GNSS
    fixes are at least 20 m and four times the standard deviation of their distance apart. The known distances have a
    standard deviation of 0.35 m between clicked landmarks, 0.9 m between waypoints, and 0.02 m for strides and single
    stairs.

    Displacements are fitted by default, because summed step lengths give too small parameters where a segment has a
    corner. A drift of the heading by 28 degrees within a segment shortens its displacement by 1 %. The errors of two
    segments that share a waypoint are taken as independent.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.offline.calibration.segments import segments_of
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> segments, notes = segments_of(walk, pdr.track(walk))
    >>> [round(s.distance_m) for s in segments]
    [20]
    """
    if measure not in ("displacement", "length"):
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    stretches, notes = _stretches(recording, anchor_std_m)
    if recording.gyroscope is None and stretches and measure == "displacement":
        measure = "length"
        notes.append("no gyroscope, so no headings: step lengths are summed instead of step vectors")
    steps = steps_of(track.steps)
    names, prob = _of_modes(track, separate) if separate else (track.contexts, step_contexts(track))
    segments: list[Segment] = []
    empty: list[str] = []
    bent: list[str] = []
    miscounted: list[str] = []
    for stretch in stretches:
        inside = _share_inside(track, stretch)
        if abs(inside.sum() - stretch.n_steps) > MAX_MISCOUNT * stretch.n_steps:
            miscounted.append(f"{stretch.where} ({inside.sum():.0f} detected, {stretch.n_steps:.0f} counted)")
        if inside.sum() < MIN_STEPS:
            empty.append(stretch.where)
            continue
        used = np.flatnonzero(inside > 0)
        heading: FloatArray | None = track.walking_heading_rad[used] if measure == "displacement" else None
        length_m = inside[used] * np.maximum(track.step_length_m[used], 1e-3)
        if heading is not None and stretch.walked and _is_bent(heading, length_m):
            bent.append(stretch.where)
            heading = None
        segments.append(
            Segment(
                subject=recording.subject.id or subject or UNNAMED,
                recording=recording.name,
                distance_m=stretch.distance_m,
                steps=tuple(steps[k] for k in used),
                inside=inside[used],
                heading_rad=heading,
                context_prob=prob[used],
                anchor_std_m=stretch.anchor_std_m,
                height_m=recording.subject.height_m,
                start_s=stretch.start_s,
                end_s=stretch.end_s,
                context_names=names,
            )
        )
    if empty:
        notes.append(f"no steps in {_abbreviated(empty)}: not used")
    if miscounted:
        where = _abbreviated(miscounted)
        notes.append(
            f"the detected steps differ from the counted ones in {where}: check the times, the count, and that the "
            "person walked all the time"
        )
    if bent:
        notes.append(f"turns in {_abbreviated(bent)}: step lengths are summed instead of step vectors")
    return segments, [f"{recording.name}: {note}" for note in notes]


def has_known_lengths(truth: Truth) -> bool:
    """Return True if a truth has segments of known distance, or strides."""
    is_walked = truth.segments is not None and bool(np.isfinite(truth.segments.distance_m).any())
    return is_walked or (truth.strides is not None and len(truth.strides) > 0)


def truth_fixes(recording: Recording, anchor_std_m: float | None = None) -> list[PositionFix]:
    """Return the waypoints at the ends of the segments of a recording as position fixes, in the order of time.

    The list is empty unless waypoints are the source of `segments_of`. `anchor_std_m` is the standard deviation of the
    distance of two waypoints.
    """
    truth = recording.truth
    if has_known_lengths(truth) or truth.waypoints is None:
        return []
    std_m = WAYPOINT_STD_M if anchor_std_m is None else anchor_std_m
    stretches, _ = _stretches(recording, anchor_std_m)
    ends_s = {t for s in stretches for t in (s.start_s, s.end_s)}
    cov_m2 = 0.5 * std_m**2 * np.eye(2)
    points = truth.waypoints
    return [
        PositionFix(float(p.time_s), np.array([p.east_m, p.north_m], dtype=float), cov_m2)
        for p in points
        if float(p.time_s) in ends_s
    ]


def _share_inside(track: TrackRows, stretch: _Stretch) -> FloatArray:
    """Return the share (K,) of each step that lies between the ends of a stretch."""
    end_s, duration_s = track.time_s, np.asarray(track.steps.duration_s)
    overlap_s = np.minimum(end_s, stretch.end_s) - np.maximum(end_s - duration_s, stretch.start_s)
    return np.clip(overlap_s / np.maximum(duration_s, 1e-9), 0.0, 1.0)


def _is_bent(heading_rad: FloatArray, length_m: FloatArray) -> bool:
    """Return True if a path has a turn: its displacement is less than the share `limits.STRAIGHT` of its length."""
    vector = np.exp(1j * heading_rad) * length_m
    return abs(vector.sum()) < limits.STRAIGHT * np.abs(vector).sum()


def step_contexts(track: TrackRows) -> FloatArray:
    """Return the context probabilities (K, C) of each step.

    They are the filter's mode probabilities summed by context. If a mode has a context that is not in `track.contexts`,
    the result is `track.context_prob`, the classifier's probabilities for the window of each step.
    """
    prob = np.zeros((track.n_steps, len(track.contexts)))
    for m, context in enumerate(track.mode_contexts):
        if context not in track.contexts:
            return track.context_prob
        prob[:, track.contexts.index(context)] += track.mode_prob[:, m]
    return prob


def _of_modes(track: TrackRows, separate: Collection[str]) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the modes `separate` and of the contexts of other modes, and their probabilities (K, N)."""
    if unknown := set(separate) - set(track.modes):
        raise ValueError(
            f"the track has no modes {', '.join(sorted(unknown))}, which the configuration has: give tracks of this "
            "configuration, or leave them out"
        )
    of_mode = [m if m in separate else c for m, c in zip(track.modes, track.mode_contexts, strict=True)]
    names = tuple(dict.fromkeys(n for n, c in zip(of_mode, track.mode_contexts, strict=True) if c in track.contexts))
    return names, track.mode_prob @ np.array([[name == n for n in names] for name in of_mode], dtype=float)


def _stretches(recording: Recording, anchor_std_m: float | None) -> tuple[list[_Stretch], list[str]]:
    """Return the stretches of known length of a recording, and notes about those that are not used.

    They are from the first source that the recording has: truth segments, strides, waypoints, or GNSS fixes.
    """
    truth, notes = recording.truth, list[str]()
    if truth.segments is not None and np.isfinite(truth.segments.distance_m).any():
        found = _of_known_distance(truth.segments, ANCHOR_STD_M if anchor_std_m is None else anchor_std_m)
    elif truth.strides is not None and len(truth.strides):
        found = [
            _Stretch(float(s["start_s"]), float(s["end_s"]), float(s["length_m"]), STRIDE_STD_M, True)
            for s in truth.strides
        ]
    elif truth.waypoints is not None and len(truth.waypoints) > 1:
        std_m = WAYPOINT_STD_M if anchor_std_m is None else anchor_std_m
        found, notes = _between_waypoints(truth.waypoints, std_m)
    elif recording.location is not None and len(recording.location) > 1:
        found = _between_fixes(recording.location.time_s, recording.location.values)
        if not found:
            notes = [f"no two position fixes are {MIN_FIX_DISTANCE_M:g} m and four standard deviations apart"]
    else:
        return [], ["the recording has no known lengths, no waypoints and no position fixes"]
    good: list[_Stretch] = []
    bad: dict[str, list[str]] = {}
    for s in found:
        if not (np.isfinite([s.start_s, s.end_s, s.distance_m]).all()):
            bad.setdefault("time or distance is not a number", []).append(s.where)
        elif s.end_s <= s.start_s:
            bad.setdefault("the end is not after the start (anchors out of time order)", []).append(s.where)
        elif s.distance_m <= 0:
            bad.setdefault("the distance is not positive", []).append(f"{s.where} ({s.distance_m:g} m)")
        else:
            good.append(s)
    return good, [*notes, *(f"{why} in {_abbreviated(which)}: not used" for why, which in bad.items())]


def _of_known_distance(segments: Any, clicked_std_m: float) -> list[_Stretch]:
    """Return one stretch for each truth segment with a known distance.

    `clicked_std_m` is the standard deviation of the distances. A segment shorter than `SINGLE_STEP_M` is a single step,
    whose distance has at most the standard deviation `STRIDE_STD_M`.
    """
    known = segments[np.isfinite(segments.distance_m)]
    anchor_std_m = np.where(known.distance_m < SINGLE_STEP_M, min(clicked_std_m, STRIDE_STD_M), clicked_std_m)
    n_steps = known.n_steps if "n_steps" in (known.dtype.names or ()) else np.full(len(known), np.nan)
    columns = (known.start_s, known.end_s, known.distance_m, anchor_std_m, np.asarray(n_steps, dtype=float))
    return [_Stretch(*row[:4], walked=True, n_steps=row[4]) for row in zip(*(c.tolist() for c in columns), strict=True)]


def _between_waypoints(points: Any, anchor_std_m: float) -> tuple[list[_Stretch], list[str]]:
    """Return the stretches between waypoints on one floor that are far enough apart, and notes about unused ones.

    Successive waypoints that are far apart in distance and time give one stretch each. Waypoints out of time order are
    kept, so that the caller reports them. Dense waypoints are grouped into straight stretches of `GROUPED_M`, because
    between close waypoints their errors exceed the errors of the steps.
    """
    names = points.dtype.names or ()
    floor = np.asarray(points.floor, dtype=float) if "floor" in names else np.zeros(len(points))
    level = np.where(np.isfinite(floor), floor, 0.0)
    time_s, position_m = np.asarray(points.time_s, dtype=float), np.column_stack([points.east_m, points.north_m])
    leg_m, lasts_s = np.hypot(*np.diff(position_m, axis=0).T), np.diff(time_s)
    same = np.diff(level) == 0
    near = same & (lasts_s > 0) & ((leg_m <= MIN_WAYPOINT_DISTANCE_M) | (lasts_s < MIN_WAYPOINT_TIME_S))
    far = same & ~near & ~(leg_m <= MIN_WAYPOINT_DISTANCE_M)

    def stretch(i: int, j: int) -> _Stretch:
        length_m = float(np.hypot(*(position_m[j] - position_m[i])))
        return _Stretch(float(time_s[i]), float(time_s[j]), length_m, anchor_std_m)

    found = [stretch(k, k + 1) for k in np.flatnonzero(far).tolist()]
    unused: list[str] = []
    # first and last waypoint of each run of close ones
    change = np.diff(np.concatenate([[0], near.astype(int), [0]]))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        pairs = _groups(position_m[begin : end + 1])
        found += [stretch(begin + i, begin + j) for i, j in pairs]
        if not pairs:
            unused.append(f"{time_s[begin]:.1f}-{time_s[end]:.1f} s")
    notes: list[str] = []
    if unused:
        notes.append(
            f"waypoints in {_abbreviated(unused)} are close to each other and no straight stretch of "
            f"{MIN_WAYPOINT_DISTANCE_M:g} m connects them: not used"
        )
    floors = [f"{time_s[k]:.1f}-{time_s[k + 1]:.1f} s" for k in np.flatnonzero(~same).tolist()]
    if floors:
        notes.append(f"waypoints on two floors in {_abbreviated(floors)}: not used")
    return sorted(found, key=lambda s: s.start_s), notes


def _groups(position_m: FloatArray) -> list[tuple[int, int]]:
    """Return the first and last index of successive groups of waypoint positions (N, 2) that form straight stretches.

    Each stretch is at least `GROUPED_M` long. The last one may be shorter, but not below `MIN_WAYPOINT_DISTANCE_M`.
    Positions from which no straight stretch begins are skipped.
    """
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position_m, axis=0).T))])
    found: list[tuple[int, int]] = []
    first, last = 0, len(position_m) - 1
    while first < last:
        chord_m = np.hypot(*(position_m[first:] - position_m[first]).T)
        far = np.flatnonzero(chord_m >= GROUPED_M)
        end = first + int(far[0]) if len(far) else last
        length_m = float(chord_m[end - first])
        if length_m > MIN_WAYPOINT_DISTANCE_M and length_m >= limits.STRAIGHT * (along_m[end] - along_m[first]):
            found.append((first, end))
            first = end
        else:  # the stretch has a turn: search for a straight one from the next waypoint on
            first += 1
    return found


def _between_fixes(time_s: FloatArray, values: FloatArray) -> list[_Stretch]:
    """Return the stretches between GNSS fixes, thinned until the distances exceed the errors of the fixes.

    `values` (N, 4) are latitude and longitude in degrees, altitude and accuracy in m.
    """
    lat_deg, lon_deg, _, accuracy_m = values.T
    std_m = np.where(np.isfinite(accuracy_m) & (accuracy_m > 0), accuracy_m, 10.0) / RADIUS_68
    is_place = (np.abs(lat_deg) <= 90) & (np.abs(lon_deg) <= 180)
    usable = np.flatnonzero(is_place & np.isfinite(time_s))
    found: list[_Stretch] = []
    if not len(usable):
        return found
    last = int(usable[0])
    origin = Origin(float(lat_deg[last]), float(lon_deg[last]))
    position_m = np.zeros((len(values), 2))
    position_m[usable] = origin.east_north_m(lat_deg[usable], lon_deg[usable])
    for i in usable[1:].tolist():
        distance = float(np.hypot(*(position_m[i] - position_m[last])))
        std = float(np.hypot(std_m[i], std_m[last]))
        if distance > max(MIN_FIX_DISTANCE_M, MIN_FIX_DISTANCE_STDS * std):
            # the cross-track error lengthens the distance: E d^2 = D^2 + std^2, apart from the along-track error
            length = float(np.sqrt(distance**2 - std**2))
            found.append(_Stretch(float(time_s[last]), float(time_s[i]), length, std))
            last = i
    return found


def _abbreviated(names: Sequence[str]) -> str:
    """Return the first four names as a list for a message, and the number of the others."""
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
