"""Stretches of known length in recordings, and the sums over their steps that a calibration needs.

A segment is preintegrated: whatever the number of its steps, it enters as the sum of their regressors times the sine
and cosine of their headings. Given those, the displacement is linear in the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.models import StepLengthModel, length_and_jacobian
from pdr_filter.recipes.step_length_calibration import UNNAMED, of_height, slices_of
from pdr_filter.values import CONTEXTS, RADIUS_68, FloatArray, IntArray, Origin, Step, TrackRows, steps_of
from pdr_filter.values.recording import Recording

# How well the distance between two clicked landmarks is known: clicks are up to 0.8 s early or 0.1 s late, about 0.25 m
# at each end (measured on 133 straight legs of one person; docs/methods/step_length.md).
ANCHOR_STD_M = 0.35
# A "segment" shorter than this is a single step (group B of Martinelli et al. 2018: one stair, 0.29 or 0.43 m), whose
# length is that of the tread and not a distance between clicks.
SINGLE_STEP_M = 1.5
# Waypoints of a floor map are good to a metre or so; this is the residual of 165 legs between them.
WAYPOINT_STD_M = 0.9
STRIDE_STD_M = 0.02  # strides of motion capture or of a walkway, and treads
# Waypoints closer than this say little about the steps between them: the path may go round a corner.
MIN_WAYPOINT_DISTANCE_M = 4.0
# Nearer ones in distance or time are grouped into stretches of ten times the standard deviation of a waypoint. Steps at
# both ends are only partly inside, and three seconds have no more than five or six.
MIN_WAYPOINT_TIME_S, GROUPED_M = 3.0, 10.0
# GNSS fixes are thinned until they are this far apart, and this many times their own standard deviation.
MIN_FIX_DISTANCE_M, MIN_FIX_DISTANCE_STDS = 20.0, 4.0
# Displacement over walked distance below which a stretch of known *walked* distance has a turn in it. A step or two
# round the corner at the ends of a leg of ten steps leave 0.92; half of the leg at a right angle 0.71.
STRAIGHT = 0.85
MIN_STEPS = 0.5  # less than half a step inside is none
_MIN_PROB = 1e-3  # a context with less than this probability adds less than a millimetre to a step


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Steps of one person between two anchors whose distance is known.

    Parameters
    ----------
    subject, recording : str
        Who, and where it was recorded: segments of one recording share its error of scale.
    distance_m : float
        Displacement from anchor to anchor, or walked distance if `heading_rad` is None.
    steps : (n,) of Step
        Steps at least partly between the anchors.
    inside : (n,)
        Share of each step that is inside, 0 to 1.
    heading_rad : (n,) or None
        Directions of the steps, clockwise, up to one unknown angle for the whole segment; None where none are known:
        then lengths are summed instead of vectors.
    context_prob : (n, C)
        Probabilities of the contexts of each step.
    anchor_std_m : float
        Standard deviation of `distance_m`.
    height_m : float, optional
        Of the person.
    start_s, end_s : float
        When the anchors were passed.
    context_names : (C,), optional
        Names of the contexts; those of the default if not given.
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
        """What messages call it."""
        return f"{self.recording} {self.start_s:.1f}-{self.end_s:.1f} s"

    @property
    def steps_in(self) -> FloatArray:
        """How many steps there are of each context, (C,)."""
        return np.asarray(self.inside @ self.context_prob)

    @property
    def n_steps(self) -> float:
        """How many steps."""
        return float(self.inside.sum())

    @property
    def is_along(self) -> bool:
        """Whether lengths are summed and not vectors."""
        return self.heading_rad is None

    def sums(self, context: str, model: StepLengthModel, about: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums over the steps in a context: derivative (2, p) of the displacement by the parameters, and the rest (2,).

        Displacement = derivative @ theta + rest near the parameters `about` (p,); without rest for a linear model.
        """
        own, weight = (
            of_height(model, self.height_m),
            self.inside * self.context_prob[:, self.context_names.index(context)],
        )
        used = np.flatnonzero(weight > _MIN_PROB)
        if self.heading_rad is None:
            vectors = np.stack([weight[used], np.zeros(len(used))])
        else:
            vectors = np.stack([np.sin(self.heading_rad[used]), np.cos(self.heading_rad[used])]) * weight[used]
        pairs = [length_and_jacobian(own, self.steps[k], about) for k in used]
        jacobian = np.array([j for _, j in pairs]).reshape(-1, model.n_params)
        if hasattr(model, "regressors"):
            return vectors @ jacobian, np.zeros(2)
        length = np.array([float(x) for x, _ in pairs])
        return vectors @ jacobian, vectors @ (length - jacobian @ about)


@dataclass(frozen=True, slots=True, eq=False)
class SummedSegment:
    """A `Segment` whose steps are summed, for models that are linear in their parameters: all that has to travel."""

    subject: str
    recording: str
    distance_m: float
    anchor_std_m: float
    height_m: float | None
    start_s: float
    end_s: float
    steps_in: FloatArray  # (C,)
    n_steps: float
    is_along: bool
    contexts: tuple[str, ...]  # of the sums
    models: tuple[StepLengthModel, ...]
    derivatives: tuple[FloatArray, ...]  # (2, p) each
    context_names: tuple[str, ...] = CONTEXTS  # C, of `steps_in`

    @classmethod
    def of(cls, segment: Segment, models: Sequence[tuple[str, StepLengthModel]]) -> SummedSegment:
        """The sums of a segment for models of contexts."""
        same = {f.name: getattr(segment, f.name) for f in fields(cls) if hasattr(segment, f.name)}
        sums = tuple(segment.sums(context, model, np.zeros(model.n_params))[0] for context, model in models)
        return cls(**same, contexts=tuple(c for c, _ in models), models=tuple(m for _, m in models), derivatives=sums)

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"{self.recording} {self.start_s:.1f}-{self.end_s:.1f} s"

    def sums(self, context: str, model: StepLengthModel, about: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As `Segment.sums`; ValueError for a model for which it was not summed."""
        for name, other, derivative in zip(self.contexts, self.models, self.derivatives, strict=True):
            if name == context and other == model:
                return derivative, np.zeros(2)
        raise ValueError(f"{self.name}: its steps are not summed for {model} of {context}; cut it out again")


AnySegment = Segment | SummedSegment


@dataclass(frozen=True, eq=False)
class SegmentSums:
    """All that a calibration needs of N segments, as arrays: predicted length = | regressors @ theta + offset_m |.

    theta (P,) are the parameters of all contexts, one after the other (`slices_of`), of the segment's subject.
    """

    # (N, 2, P) sums over the steps of context probability times regressors times (sin, cos) of the heading. For summed
    # lengths the second row is zero.
    regressors: FloatArray
    offset_m: FloatArray  # (N, 2) zero for models that are linear in theta
    distance_m: FloatArray  # (N,) known length
    anchor_std_m: FloatArray  # (N,) its standard deviation
    n_steps: FloatArray  # (N,)
    context: IntArray  # (N,) index of the context that most of the steps are of
    subject: IntArray  # (N,) index into `subjects`
    recording: IntArray  # (N,) index into `recordings`
    subjects: tuple[str, ...]
    recordings: tuple[str, ...]

    def __post_init__(self) -> None:
        n = len(self.distance_m)
        if self.regressors.ndim != 3 or self.regressors.shape[:2] != (n, 2) or self.offset_m.shape != (n, 2):
            raise ValueError(
                f"regressors must be ({n}, 2, P) and offset_m ({n}, 2) for {n} distances, got "
                f"{self.regressors.shape} and {self.offset_m.shape}"
            )
        for name in ("anchor_std_m", "n_steps", "context", "subject", "recording"):
            if getattr(self, name).shape != (n,):
                raise ValueError(f"{name} must be ({n},), got {getattr(self, name).shape}")
        if not (np.isfinite(self.regressors).all() and np.isfinite(self.offset_m).all()):
            raise ValueError("regressors and offset_m must be finite: leave out segments without features")
        if not ((self.distance_m > 0).all() and (self.n_steps > 0).all() and (self.anchor_std_m >= 0).all()):
            raise ValueError("distance_m and n_steps must be positive, anchor_std_m not negative")

    def __len__(self) -> int:
        return len(self.distance_m)

    def rows(self, chosen: Any) -> SegmentSums:
        """The segments of an index or mask, subjects and recordings numbered as before."""
        names = [f.name for f in fields(self) if f.name not in ("subjects", "recordings")]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


def integrate(
    segments: Sequence[AnySegment],
    models: Mapping[str, StepLengthModel],
    theta: Mapping[str, FloatArray] | Sequence[Mapping[str, FloatArray]],
) -> SegmentSums:
    """Sums of segments for a model of each context, in the order of the parameters.

    A model with a `height_m` takes that of the person; one that is not linear in theta is linearised about `theta`, one
    mapping or one for each segment.
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
    start_s: float
    end_s: float
    distance_m: float
    anchor_std_m: float
    walked: bool = False  # the distance is known along the way, not from end to end

    @property
    def where(self) -> str:
        return f"{self.start_s:.1f}-{self.end_s:.1f} s"


def segments_of(
    recording: Recording,
    track: TrackRows,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
    subject: str | None = None,
) -> tuple[list[Segment], list[str]]:
    """Segments of a recording, and in words what was left out or taken otherwise.

    From its truth: `segments` of known distance, else `strides`, else pairs of `waypoints` on one floor, else fixes of
    `location`.

    Parameters
    ----------
    recording : Recording
    track : TrackRows
        Its track: steps, headings, contexts.
    anchor_std_m : float, optional
        Standard deviation of the distances of `segments` and `waypoints`; else `ANCHOR_STD_M` and `WAYPOINT_STD_M`.
    measure : {"displacement", "length"}
        Sum the step vectors, or the step lengths against the same distance. Without gyroscope, and in segments of known
        walked distance that have a turn in them, lengths are summed in any case.
    subject : str, optional
        Who walked, if the recording does not say it.
    """
    if measure not in ("displacement", "length"):
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    stretches, notes = _stretches(recording, anchor_std_m)
    if recording.gyroscope is None and stretches and measure == "displacement":
        measure = "length"
        notes.append("no gyroscope, so no headings: summed step lengths instead of displacement")
    steps = steps_of(track.steps)
    prob = step_contexts(track)
    segments: list[Segment] = []
    empty: list[str] = []
    bent: list[str] = []
    for stretch in stretches:
        inside = _share_inside(track, stretch)
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
                context_names=track.contexts,
            )
        )
    if empty:
        notes.append(f"no steps in {_some(empty)}: left out")
    if bent:
        notes.append(f"turns in {_some(bent)}: summed step lengths instead of displacement")
    return segments, [f"{recording.name}: {note}" for note in notes]


def _share_inside(track: TrackRows, stretch: _Stretch) -> FloatArray:
    """Share of each step that is between the anchors, (K,)."""
    end_s, duration_s = track.time_s, np.asarray(track.steps.duration_s)
    overlap_s = np.minimum(end_s, stretch.end_s) - np.maximum(end_s - duration_s, stretch.start_s)
    return np.clip(overlap_s / np.maximum(duration_s, 1e-9), 0.0, 1.0)


def _is_bent(heading_rad: FloatArray, length_m: FloatArray) -> bool:
    vector = np.exp(1j * heading_rad) * length_m
    return abs(vector.sum()) < STRAIGHT * np.abs(vector).sum()


def step_contexts(track: TrackRows) -> FloatArray:
    """Context probabilities of each step (K, C): the filter's by mode, else the windows'."""
    prob = np.zeros((track.n_steps, len(track.contexts)))
    for m, context in enumerate(track.mode_contexts):
        if context not in track.contexts:
            return track.context_prob
        prob[:, track.contexts.index(context)] += track.mode_prob[:, m]
    return prob


def _stretches(recording: Recording, anchor_std_m: float | None) -> tuple[list[_Stretch], list[str]]:
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
            notes = [f"no two position fixes are {MIN_FIX_DISTANCE_M:g} m and four of their standard deviations apart"]
    else:
        return [], ["no truth of known length, no waypoints, no position fixes"]
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
    return good, [*notes, *(f"{why} in {_some(which)}: left out" for why, which in bad.items())]


def _of_known_distance(segments: Any, clicked_std_m: float) -> list[_Stretch]:
    known = segments[np.isfinite(segments.distance_m)]
    anchor_std_m = np.where(known.distance_m < SINGLE_STEP_M, min(clicked_std_m, STRIDE_STD_M), clicked_std_m)
    columns = (known.start_s, known.end_s, known.distance_m, anchor_std_m)
    return [_Stretch(*map(float, row), walked=True) for row in zip(*columns, strict=True)]


def _between_waypoints(points: Any, anchor_std_m: float) -> tuple[list[_Stretch], list[str]]:
    """Stretches between waypoints on one floor that are far enough apart, and why others are left out.

    Neighbours that are far apart in distance and time are one stretch; those out of order stay in. Dense waypoints are
    grouped into stretches of `GROUPED_M` that are straight: between near ones their errors hide the steps.
    """
    names = points.dtype.names or ()
    floor = np.asarray(points.floor, dtype=float) if "floor" in names else np.zeros(len(points))
    level = np.where(np.isfinite(floor), floor, 0.0)
    time_s, place_m = np.asarray(points.time_s, dtype=float), np.column_stack([points.east_m, points.north_m])
    leg_m, lasts_s = np.hypot(*np.diff(place_m, axis=0).T), np.diff(time_s)
    same = np.diff(level) == 0
    near = same & (lasts_s > 0) & ((leg_m <= MIN_WAYPOINT_DISTANCE_M) | (lasts_s < MIN_WAYPOINT_TIME_S))
    far = same & ~near & ~(leg_m <= MIN_WAYPOINT_DISTANCE_M)

    def stretch(i: int, j: int) -> _Stretch:
        length_m = float(np.hypot(*(place_m[j] - place_m[i])))
        return _Stretch(float(time_s[i]), float(time_s[j]), length_m, anchor_std_m)

    found = [stretch(k, k + 1) for k in np.flatnonzero(far).tolist()]
    unused: list[str] = []
    # first and last waypoint of each run of near ones
    change = np.diff(np.concatenate([[0], near.astype(int), [0]]))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        pairs = _groups(place_m[begin : end + 1])
        found += [stretch(begin + i, begin + j) for i, j in pairs]
        if not pairs:
            unused.append(f"{time_s[begin]:.1f}-{time_s[end]:.1f} s")
    notes: list[str] = []
    if unused:
        notes.append(
            f"waypoints in {_some(unused)} are near each other and no straight way of {MIN_WAYPOINT_DISTANCE_M:g} m "
            "leads through them: left out"
        )
    floors = [f"{time_s[k]:.1f}-{time_s[k + 1]:.1f} s" for k in np.flatnonzero(~same).tolist()]
    if floors:
        notes.append(f"waypoints on two floors in {_some(floors)}: left out")
    return sorted(found, key=lambda s: s.start_s), notes


def _groups(place_m: FloatArray) -> list[tuple[int, int]]:
    """First and last of successive groups of places (N, 2), each a straight way of `GROUPED_M`, the last maybe less."""
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place_m, axis=0).T))])
    found: list[tuple[int, int]] = []
    first, last = 0, len(place_m) - 1
    while first < last:
        chord_m = np.hypot(*(place_m[first:] - place_m[first]).T)
        far = np.flatnonzero(chord_m >= GROUPED_M)
        end = first + int(far[0]) if len(far) else last
        length_m = float(chord_m[end - first])
        if length_m > MIN_WAYPOINT_DISTANCE_M and length_m >= STRAIGHT * (along_m[end] - along_m[first]):
            found.append((first, end))
            first = end
        else:  # a turn: the next straight way begins after it
            first += 1
    return found


def _between_fixes(time_s: FloatArray, values: FloatArray) -> list[_Stretch]:
    """Stretches between GNSS fixes, thinned until the distance stands out from their errors."""
    lat_deg, lon_deg, _, accuracy_m = values.T
    std_m = np.where(np.isfinite(accuracy_m) & (accuracy_m > 0), accuracy_m, 10.0) / RADIUS_68
    is_place = (np.abs(lat_deg) <= 90) & (np.abs(lon_deg) <= 180)
    usable = np.flatnonzero(is_place & np.isfinite(time_s))
    found: list[_Stretch] = []
    if not len(usable):
        return found
    last = int(usable[0])
    origin = Origin(float(lat_deg[last]), float(lon_deg[last]))
    place_m = np.zeros((len(values), 2))
    place_m[usable] = origin.east_north_m(lat_deg[usable], lon_deg[usable])
    for i in usable[1:].tolist():
        distance = float(np.hypot(*(place_m[i] - place_m[last])))
        std = float(np.hypot(std_m[i], std_m[last]))
        if distance > max(MIN_FIX_DISTANCE_M, MIN_FIX_DISTANCE_STDS * std):
            # the error across the way makes the distance longer: E d^2 = D^2 + std^2 but for the error along it
            length = float(np.sqrt(distance**2 - std**2))
            found.append(_Stretch(float(time_s[last]), float(time_s[i]), length, std))
            last = i
    return found


def _some(names: Sequence[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
