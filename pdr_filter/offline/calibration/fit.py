"""Calibration of step-length parameters from walks of known length, with covariances."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.filter.step_length.calibration_result import UNNAMED
from pdr_filter.offline.calibration.assembly import calibration_of, impossible_steps, length_warnings
from pdr_filter.offline.calibration.estimation import ParameterEstimate
from pdr_filter.offline.calibration.model_forms import (
    MIN_GROUPS,
    RECORDING_STD,
    best_form,
    estimate_segments,
    forms_of,
    models_of,
    prior_means,
    standard_error,
)
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, own_priors, separate_modes
from pdr_filter.offline.calibration.segments import (
    Segment,
    SegmentSums,
    distinct_names,
    integrate,
    segments_of,
    with_distinct_names,
)
from pdr_filter.offline.robust_loss import OUTLIER_STDS
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.recipes.config import Config, check_config
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import track as track_of
from pdr_filter.values import CONTEXTS, Fix, FloatArray, Table, check_array, check_number, table
from pdr_filter.values.checks import shown
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.recording import Recording

_BIAS_LIMIT_STDS = 3.0  # A mean held-out error above this many standard errors is reported as a bias.


def calibrate(
    recordings: Recording | Iterable[Recording],
    config: Config | None = None,
    *,
    priors: Mapping[str, StepLengthPrior] | None = None,
    tracks: Iterable[Track] | None = None,
    model: str | None = None,
    prior_std: float | None = None,
    subject: str | None = None,
    each_a_person: bool = False,
    measure: str = "displacement",
    loss: str = "gnc",
    anchor_std_m: float | None = None,
    recording_std: float = RECORDING_STD,
    progress: Callable[[float], None] | None = None,
    smooth: bool = False,
    fixes: Iterable[Iterable[Fix]] | None = None,
    loop_closures: Iterable[Iterable[LoopClosure]] | None = None,
) -> Calibration:
    """Estimate the step-length parameters of people from walks of known length.

    The recordings need stretches between places whose distance is known: truth segments, strides, waypoints or GNSS
    fixes. The parameters of the population and of each person are estimated together, with robust weights for wrong
    segments.

    With `smooth`, all walks are smoothed together with the parameters, so that fixes, ranges, loop closures and
    locations calibrate them, too, also where no stretch has a known length.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Recordings with truth segments of known distance, strides, waypoints, or GNSS fixes. Their `subject.id` names
        the person. All recordings without one are attributed to one person.
    config : Config, optional
        Configuration that detects steps, headings and contexts. The default is the default recipe. The step-length
        models of its modes are fitted, and their parameters and covariances are the priors. Modes of one context with
        different step lengths are fitted separately, under their own names.
    priors : mapping of str to StepLengthPrior, optional
        Model and prior of some contexts, which replace the entries in `DEFAULT_PRIORS`. `eq12_priors()` has the model
        of Martinelli et al. for all contexts.
    tracks : iterable of Track, optional
        Tracks of the recordings, if they have been computed already.
    model : str, optional
        Step-length model of walking: "bounce", "eq12", "kim", "tian", "weinberg", "chen", "frequency", "peak",
        "range", "static" or "zhou". By default it is that of `config`. If that is the default one, the model is
        chosen: "bounce", unless there are enough segments and another of the first five has a clearly smaller
        held-out error. A note states the choice.
    prior_std : float, optional
        Relative standard deviation of the population's step length of walking, about the default one. The default is
        0.1 for "bounce".
    subject : str, optional
        Name of the person of recordings without a `subject.id`. The default is "unnamed".
    each_a_person : bool, default False
        If True, each recording without a `subject.id` is attributed to a different person, named after the recording.
    measure : {"displacement", "length"}
        Quantity fitted to the known distances: the summed step vectors (default), or the summed step lengths. The
        second gives too small parameters where a segment has a corner.
    loss : {"gnc", "cauchy", "huber", "none"}
        Robust loss, which reduces the weight of segments that do not fit.
    anchor_std_m : float, optional
        Standard deviation of the known distances in m. The default is 0.35 m for segments and 0.9 m for waypoints.
    recording_std : float, default RECORDING_STD
        Initial relative standard deviation of one person's scale between recordings. 0 assumes equal scales.
    progress : callable, optional
        Called with the fraction of recordings done, 0 to 1.
    smooth : bool, default False
        If True, solve one factor graph over all walks: poses, step scales, gyroscope biases and parameters. The result
        has the smoothed `tracks`, and one segment for each context of a walk.
    fixes : iterable of iterable of Fix, optional
        Fixes of each recording, for `smooth`, in the order of the recordings, with times on the clock of the recording.
        Positions may be in any frame in metres, the same for all fixes of a recording. A recording with fixes is
        calibrated with them instead of its truth. Speed fixes and fixes on a floor plan are not used.
    loop_closures : iterable of iterable of LoopClosure, optional
        Loop closures of each recording, for `smooth`, in addition to its fixes or truth. They have no scale.

    Returns
    -------
    Calibration
        Parameters of the population and of each person with covariances, and a table of all segments.

    Raises
    ------
    ValueError
        If there is nothing to calibrate with, if all step lengths of the segments are held, or if data and priors do
        not determine a parameter. The message names the parameters and the remedy.

    See Also
    --------
    pdr_filter.batch.calibrate : Calibration of many recordings in parallel.

    Notes
    -----
    The estimate is the maximum a posteriori by expectation-maximisation (docs/methods/calibration.md).

    References
    ----------
    A. Martinelli et al., "Probabilistic context-aware step length estimation for pedestrian dead reckoning", IEEE
    Sensors Journal 18, 2018. H. Yang et al., "Graduated non-convexity for robust spatial perception", IEEE RA-L 5,
    2020.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> corridor = [pdr.simulate.Leg("walking", distance_m=30.0), pdr.simulate.Leg("stationary", duration_s=3.0)]
    >>> walk = pdr.simulate.simulate(4 * corridor)  # its truth says that each stretch was 30 m
    >>> calibration = pdr.calibrate(walk)
    >>> _ = calibration.save("my_k.json")
    >>> abs(pdr.track(walk, calibration="my_k.json").distance_m - 120) < 3
    True

    By smoothing, fixes at the ends of a walk calibrate it. `k` are parameters of a step-length model, in its units:

    >>> import numpy as np
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=30.0)])
    >>> ends = walk.truth.position[[0, -1]]
    >>> fixes = [pdr.PositionFix(p.time_s, (p.east_m, p.north_m), 0.1**2 * np.eye(2)) for p in ends]
    >>> calibration = pdr.calibrate(walk, smooth=True, fixes=[fixes])
    >>> bool(calibration.k_std["walking"] < 0.1 * calibration.k["walking"])
    True
    >>> abs(pdr.track(walk, calibration=calibration).distance_m - 30) < 1
    True
    """
    if not isinstance(recordings, Iterable | Recording):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(
            f"recordings must be recordings, got {shown(recordings)}: give them before the configuration, and other "
            "arguments by their names"
        )
    chosen = [recordings] if isinstance(recordings, Recording | str | Path) else list(recordings)
    if not chosen:
        raise ValueError("no recordings to calibrate with: give at least one")
    known = list(tracks) if tracks is not None else [None] * len(chosen)
    if len(known) != len(chosen):
        raise ValueError(f"got {len(known)} tracks for {len(chosen)} recordings: give one track for each recording")
    check_subject(subject, each_a_person)
    _check_stds(recording_std, anchor_std_m)
    priors, names, contexts = _of_configuration(config, priors, model, prior_std)
    forms = forms_of(priors, model, prior_std, names, contexts.walking)  # raises its errors before the slow tracking
    if smooth:
        if known != [None] * len(known):
            raise ValueError("smooth computes the tracks itself, got tracks, too: omit them")
        load_optional("gtsam")  # before the tracks are computed
        observed = _for_each("fixes", fixes, chosen), _for_each("loop_closures", loop_closures, chosen)
        # imported late: most calibrations do not smooth
        from pdr_filter.offline.calibration.smoothed_calibration import calibrate_by_smoothing

        own_names = zip(chosen, distinct_names(r.name for r in chosen), strict=True)
        people = [r.subject.id or (name if each_a_person else subject) or UNNAMED for r, name in own_names]
        n_unnamed = sum(not r.subject.id for r in chosen)
        return calibrate_by_smoothing(
            chosen,
            people,
            next(iter(forms.values())),
            config,
            contexts.of_modes,
            observed,
            measure=measure,
            loss=loss,
            anchor_std_m=anchor_std_m,
            recording_std=recording_std,
            walking=contexts.walking,
            notes=without_name(n_unnamed, subject, each_a_person),
            progress=progress,
        )
    if fixes is not None or loop_closures is not None:
        raise ValueError("fixes and loop_closures are for smooth=True: give smooth, or omit them")
    of_each: list[tuple[list[Segment], bool]] = []
    notes: list[str] = []
    for done, (recording, own) in enumerate(zip(chosen, known, strict=True), 1):
        own = own if own is not None else track_of(recording, config)
        name = recording.name if each_a_person else subject
        found, remarks = segments_of(recording, own, anchor_std_m, measure, name, contexts.of_modes)
        of_each.append((found, not recording.subject.id))
        notes += remarks
        if progress is not None:
            progress(done / len(chosen))
    segments = with_distinct_names((found, each_a_person and is_nameless) for found, is_nameless in of_each)
    if not segments:
        raise ValueError("nothing to calibrate with: " + "; ".join(notes))
    n_unnamed = sum(bool(found) and is_nameless for found, is_nameless in of_each)
    name_notes = without_name(n_unnamed, subject, each_a_person)
    return calibrate_segments(
        segments,
        priors,
        model=model,
        prior_std=prior_std,
        loss=loss,
        recording_std=recording_std,
        notes=(*name_notes, *notes),
        contexts=contexts,
    )


@dataclass(frozen=True, slots=True)
class Contexts:
    """Roles of the contexts of a calibration."""

    walking: str = "walking"  # level walking
    running: Collection[str] = ("running",)
    # context of each mode whose step length is calibrated under its own name (`separate_modes`)
    of_modes: Mapping[str, str] = field(default_factory=dict[str, str])


def _of_configuration(
    config: Config | None, priors: Mapping[str, StepLengthPrior] | None, model: str | None, prior_std: float | None
) -> tuple[Mapping[str, StepLengthPrior] | None, tuple[str, ...], Contexts]:
    """Return priors, the names of the step lengths, and the roles of the contexts.

    The priors are those given in addition to the step-length models of the configuration.
    """
    if config is None:
        return priors, CONTEXTS, Contexts()
    check_config(config)
    walking = next((c.name for c in config.model.context_set.contexts if c.is_level_walking), "walking")
    joined = {*(priors or {}), *([] if model is None else [walking])}
    own, separate = own_priors(config.model, joined), separate_modes(config.model, joined)
    names = (*(c for c in config.contexts if c not in separate.values()), *separate)
    running = tuple(
        name for m in config.model.modes if m.meaning.runs for name in (m.context, *({m.name} & separate.keys()))
    )
    if prior_std is not None and walking in separate.values():
        raise ValueError(
            f"prior_std (--prior) is for one step length, but modes of {walking} have different ones: set "
            "theta_cov of each StepLengthFit instead"
        )
    if model is not None or own.get(walking) is DEFAULT_PRIORS["walking"]:
        own.pop(walking, None)
    return {**own, **(priors or {})}, names, Contexts(walking, running, separate)


def _for_each(name: str, given: Iterable[Iterable[Any]] | None, recordings: Sequence[Recording]) -> list[list[Any]]:
    """Return the observations of each recording as lists, empty ones if none are given."""
    each = [()] * len(recordings) if given is None else list(given)
    if any(not isinstance(of_one, Iterable) for of_one in each):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"{name} must have one list for each recording, got {each[0]!r:.40}: put it into a list")
    lists = [list(of_one) for of_one in each]
    if len(lists) != len(recordings):
        raise ValueError(f"got {name} of {len(lists)} recordings for {len(recordings)}: give one list for each")
    return lists


def _check_stds(recording_std: float, anchor_std_m: float | None = None) -> None:
    """Raise ValueError if one of the standard deviations is out of range."""
    remedy = f"it is the relative spread of a person's step scale between recordings; {RECORDING_STD:g} is usual"
    check_number("recording_std", recording_std, 0.0, 1.0, remedy)
    if anchor_std_m is not None:
        check_number("anchor_std_m", anchor_std_m, 0.0, 1e3, "it is in m; omit it for the default")


def check_subject(subject: str | None, each_a_person: bool) -> None:
    """Raise ValueError if both a subject and `each_a_person` are given, because they contradict each other."""
    if subject is not None and each_a_person:
        raise ValueError(
            f"subject {subject!r} names one person, but each_a_person means several people: give only one of the two"
        )


def without_name(n_recordings: int, subject: str | None, each_a_person: bool) -> list[str]:
    """Return a list with a note about the person to whom recordings without a subject id were attributed.

    `n_recordings` is the number of such recordings. If there are none, the note says that `subject` or `each_a_person`
    was not used. The list is empty if there is nothing to note.
    """
    unused = "each_a_person (--each-a-person)" if each_a_person else f"subject {subject!r}" if subject else ""
    if n_recordings == 0 and unused:
        return [f"every recording has a subject id, so {unused} was not used"]
    if n_recordings == 0 or subject is not None:
        return []
    what = "1 recording has" if n_recordings == 1 else f"{n_recordings} recordings have"
    if each_a_person:
        return [f"{what} no subject id: each is attributed to a different person"]
    remedy = "" if n_recordings == 1 else "; if they are of different people, use each_a_person (--each-a-person)"
    return [f'{what} no subject id: attributed to one person, "{UNNAMED}"{remedy}']


def calibrate_segments(
    segments: Sequence[Segment],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    model: str | None = None,
    prior_std: float | None = None,
    loss: str = "gnc",
    recording_std: float = RECORDING_STD,
    notes: Sequence[str] = (),
    contexts: Contexts | None = None,
) -> Calibration:
    """Return the calibration of segments that `segments_of` has already extracted.

    The other parameters are the same as of `calibrate`. Recordings with impossible step lengths are not used, with a
    note; ValueError if all have such lengths.
    """
    contexts = contexts or Contexts()
    _check_stds(recording_std)
    if not segments:
        raise ValueError("no segments to calibrate with: give at least one stretch of known length that contains steps")
    names = {segment.context_names for segment in segments}
    if len(names) > 1:
        raise ValueError(f"segments must be of tracks with the same contexts, got {sorted(names)}")
    forms = forms_of(priors, model, prior_std, segments[0].context_names, contexts.walking)
    for segment in segments:
        check_array(f"{segment.name}: distance_m", segment.distance_m, "positive")
        if not segment.n_steps > 0:
            raise ValueError(f"{segment.name}: the segment contains no steps; remove it")
    return _calibrated(segments, forms, loss, recording_std, notes, contexts)


def _calibrated(
    segments: Sequence[Segment],
    forms: Mapping[str, Mapping[str, StepLengthPrior]],
    loss: str,
    recording_std: float,
    notes: Sequence[str],
    contexts: Contexts,
) -> Calibration:
    """Return the calibration of segments with the best of the models `forms`."""
    name, choice = best_form(segments, forms, loss, recording_std, contexts.walking)
    full = forms[name]
    held = _held(segments, full)
    sums = integrate(segments, models_of(full), prior_means(full))
    found = estimate_segments(segments, sums, full, loss, recording_std)
    rows = _table(segments, sums, found, np.concatenate([prior.mean for prior in full.values()]))
    if impossible := _impossible(segments, rows, contexts.running):
        left = [segment for segment in segments if segment.recording not in impossible]
        if not left:
            raise ValueError("nothing to calibrate with: " + "; ".join(impossible.values()))
        notes = (*(f"WARNING: not used: {text}" for text in impossible.values()), *notes)
        return _calibrated(left, forms, loss, recording_std, notes, contexts)
    noise_factor = dict(zip(segments[0].context_names, found.noise_factor.tolist(), strict=True))
    heights = {s.subject: s.height_m for s in segments}
    return calibration_of(
        full,
        found,
        {name: heights[name] for name in sums.subjects},
        rows,
        # warnings about the calibration come before those about single recordings
        (
            *bias_warnings(rows, recording_std),
            *length_warnings(rows, rows.predicted_m, full, recording_std),
            *choice,
            *held,
            *_notes(rows, found, full),
            *notes,
        ),
        n_recordings=len(sums.recordings),
        residual_std_m={name: float(p.step_std_m * np.sqrt(noise_factor[name])) for name, p in full.items()},
        n_segments=_segments_per_context(segments, full),
        mode_contexts=contexts.of_modes,
    )


def _impossible(segments: Sequence[Segment], rows: Table, running: Collection[str]) -> dict[str, str]:
    """Return a text for each recording whose segments that were not rejected have impossible step lengths."""
    runs = np.array([name in running for name in segments[0].context_names])
    good = np.array([(s.distance_m, s.n_steps, float(s.steps_in[runs].sum())) for s in segments])
    good = np.where(rows.distrusted[:, None], 0.0, good)
    names = dict.fromkeys(rows.recording[~rows.distrusted].tolist())
    texts = {name: impossible_steps(*good[rows.recording == name].sum(axis=0).tolist()) for name in names}
    return {name: f"{name}: {text}" for name, text in texts.items() if text}


def _held(segments: Sequence[Segment], priors: Mapping[str, StepLengthPrior]) -> list[str]:
    """Return a list with a note about step lengths of the segments that have no free parameter.

    ValueError if no step length of the segments has one.
    """
    walked = {s.context_names[int(np.argmax(s.steps_in))] for s in segments} & set(priors)
    held = sorted(name for name in walked if priors[name].mean.any() and not priors[name].std.any())
    if not held:
        return []
    what = f"the step length of {', '.join(held)} is not fitted, because the standard deviation of its parameters is 0"
    remedy = (
        "give it one (theta_cov of its StepLengthFit, shared_std_m of known_length, std of its prior), or, if the "
        "configuration has been calibrated before, give that of the recipe"
    )
    if len(held) < len(walked):
        return [f"{what}: {remedy}"]
    raise ValueError(f"nothing to calibrate: {what}: {remedy}, or name a model of walking (model, --model)")


def _table(segments: Sequence[Segment], sums: SegmentSums, found: ParameterEstimate, start: FloatArray) -> Table:
    """Return the table `Calibration.segments`. `start` (P,) are the parameters before the calibration."""
    vector = sums.regressors @ start + sums.offset_m
    return table(
        {
            "subject": np.array([s.subject for s in segments]),
            "recording": np.array([s.recording for s in segments]),
            "context": np.array([segments[0].context_names[c] for c in sums.context]),
            "start_s": np.array([s.start_s for s in segments]),
            "end_s": np.array([s.end_s for s in segments]),
            "distance_m": sums.distance_m,
            "n_steps": sums.n_steps,
            "summed": np.array([s.is_along for s in segments]),
            "predicted_m": found.predicted_m,
            "left_out_m": found.left_out_m,
            "stranger_m": found.stranger_m,
            "uncalibrated_m": np.hypot(vector[:, 0], vector[:, 1]),
            "misfit": found.misfit,
            "weight": found.weight,
            "distrusted": np.abs(found.misfit) > OUTLIER_STDS,
        }
    )


def _segments_per_context(segments: Sequence[Segment], names: Iterable[str]) -> dict[str, float]:
    """Return the number of segments of each context. A segment counts for its contexts in proportion to their steps."""
    steps_in = np.stack([s.steps_in for s in segments])
    share = (steps_in / np.maximum(steps_in.sum(axis=1, keepdims=True), 1e-9)).sum(axis=0)
    return {name: float(share[segments[0].context_names.index(name)]) for name in names}


def bias_warnings(rows: Any, recording_std: float) -> list[str]:
    """Return warnings about significant biases of held-out segments, with likely causes and remedies."""
    found: list[str] = []
    for what, group, predicted_m in (
        ("held-out segments", rows.recording, rows.left_out_m),
        ("held-out people", rows.subject, rows.stranger_m),
    ):
        good = ~rows.distrusted & np.isfinite(predicted_m)
        n_groups = len(np.unique(group[good]))
        if n_groups == 0:
            continue
        # relative to the mean length: relative to a segment's own length, which has an error too, the mean error would
        # be biased upwards
        error = 100 * (predicted_m[good] - rows.distance_m[good]) / float(rows.distance_m[good].mean())
        if n_groups >= MIN_GROUPS:
            std = standard_error(error, group[good])
        # the common error of a recording is a single draw
        elif what == "held-out segments" and len(error) >= MIN_GROUPS:
            std = np.hypot(standard_error(error, np.arange(len(error))), 100 * recording_std / np.sqrt(n_groups))
        else:
            continue
        bias = float(error.mean())
        if 0 < _BIAS_LIMIT_STDS * std < abs(bias):  # copies of one walk have no spread and give no standard error
            found.append(
                f"WARNING: {what} are predicted {abs(bias):.1f} % too {'long' if bias > 0 else 'short'}, which is "
                f"{abs(bias) / std:.1f} standard errors: the calibration does not fit its own walks. "
                "Check that the known distances are right and in metres, and that the subject ids are correct; "
                "if they are, allow steps to deviate more from the usual lengths (prior_std, --prior) or try another "
                "model (model, --model)"
            )
    return found


def _notes(rows: Any, found: ParameterEstimate, priors: Mapping[str, StepLengthPrior]) -> list[str]:
    """Return notes about convergence, outliers, and contexts without segments."""
    notes: list[str] = []
    if not found.converged:
        notes.append(
            f"the calibration did not converge: the variances still changed after {found.n_iterations} iterations"
        )
    outliers = rows[rows.distrusted]
    if len(outliers) == len(rows):
        notes.append(
            f"WARNING: the step lengths are those of the prior, because all segments ({len(rows)}) contradict the "
            "detected steps. Check that the known lengths are in metres and belong to these recordings, and that all "
            "steps are detected; if both are right, allow steps to deviate more from the usual lengths (prior_std, "
            "--prior)"
        )
    for r in outliers[np.argsort(-np.abs(outliers.misfit))]:
        notes.append(
            f"distrusted: {r.recording} {r.start_s:.1f}-{r.end_s:.1f} s: {r.distance_m:.2f} m given, "
            f"{r.predicted_m:.2f} m from its steps, {abs(r.misfit):.1f} standard deviations, weight {r.weight:.2f}"
        )
    with_length = [name for name, prior in priors.items() if prior.mean.any() or prior.std.any()]
    without = [c for c in with_length if c not in set(rows.context.tolist())]
    if without:
        notes.append(f"no segments of {', '.join(without)}: the filter keeps its default step lengths there")
    return notes
