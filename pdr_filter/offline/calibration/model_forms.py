"""Choice of the step-length model of walking by cross-validation over people or recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdr_filter.filter.step_length.calibration_result import slices_of
from pdr_filter.filter.step_length.models import RECORDING_STD, StepLengthModel, is_linear
from pdr_filter.offline.calibration.estimation import Hierarchy, ParameterEstimate, estimate_parameters
from pdr_filter.offline.calibration.hierarchy import SingularError
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, candidates, with_relative_std
from pdr_filter.offline.calibration.segments import Segment, SegmentSums, integrate
from pdr_filter.offline.robust_loss import OUTLIER_STDS
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray

# The default model is used below these numbers of segments, people or recordings. Above them, the chosen model is no
# worse than the default on the totals of walks held out of the choice, apart from 0.2 points at one of five sites
# (docs/benchmarks.md).
MIN_SEGMENTS, MIN_GROUPS = 30, 5
COMPARED = ("bounce", "eq12", "kim", "tian", "weinberg")
_MAX_SEGMENTS = 2000  # about this many segments are used for the choice: more only take longer
_N_FOLDS = 5
# Share by which the held-out error of a form must be smaller than that of the default.
_MIN_IMPROVEMENT = 0.05

Priors = Mapping[str, StepLengthPrior]


def forms_of(
    priors: Priors | None = None,
    model: str | None = None,
    prior_std: float | None = None,
    contexts: tuple[str, ...] = CONTEXTS,
    walking: str = "walking",
) -> dict[str, dict[str, StepLengthPrior]]:
    """Return the priors of all contexts for each candidate model of walking, by name.

    There is one candidate if `priors` contains the context of walking, if it is none of `contexts`, or if a `model` is
    named, otherwise all of `COMPARED`. The contexts are in the order of `contexts`. Raises ValueError for unknown or
    contradicting arguments.
    """
    given, known = dict(priors or {}), {name: {walking: of["walking"]} for name, of in candidates().items()}
    if unknown := set(given) - set(contexts):
        raise ValueError(
            f"priors are of no context {', '.join(sorted(unknown))}; there are {', '.join(contexts)}: contexts of "
            "yours need pdr_filter.calibrate(recordings, config=config)"
        )
    if model is not None and walking in given:
        raise ValueError(f"priors has a model of walking, but model is {model!r} too: give only one of the two")
    if model is not None and model not in known:
        raise ValueError(f"model must be one of {', '.join(known)}, got {model!r}")
    if prior_std is not None and not 0 < prior_std <= 1:
        raise ValueError(
            f"prior_std (--prior) must be a fraction of a step, above 0 and up to 1, got {prior_std}; 0.1 is usual"
        )
    is_given = walking in given or walking not in contexts
    compared = {name: known[name] for name in COMPARED}
    chosen = {model: known[model]} if model is not None else {"given": given} if is_given else compared
    forms: dict[str, dict[str, StepLengthPrior]] = {}
    for name, own in chosen.items():
        full = {**DEFAULT_PRIORS, **given, **own}
        if prior_std is not None:
            full[walking] = with_relative_std(full[walking], prior_std)
        forms[name] = {c: full[c] for c in contexts if c in full}
    return forms


def models_of(priors: Priors) -> dict[str, StepLengthModel]:
    """Return the step-length model of each context, taken from the priors of the calibration."""
    return {name: p.model for name, p in priors.items()}


def prior_means(priors: Priors) -> dict[str, FloatArray]:
    """Return the prior means of each context, at which nonlinear models are first linearised."""
    return {name: p.mean for name, p in priors.items()}


def hierarchy_of(
    priors: Priors, recording_std: float = RECORDING_STD, contexts: tuple[str, ...] = CONTEXTS
) -> Hierarchy:
    """Return the priors of all contexts concatenated into one `Hierarchy`."""
    step_std_m = np.full(len(contexts), 0.08)
    for name, prior in priors.items():
        step_std_m[contexts.index(name)] = prior.step_std_m
    mean, std, between = (
        np.concatenate([getattr(p, name) for p in priors.values()]) for name in ("mean", "std", "between_std")
    )
    return Hierarchy(mean, std, between, step_std_m, recording_std)


def estimate_segments(
    segments: Sequence[Segment], sums: SegmentSums, priors: Priors, loss: str, recording_std: float
) -> ParameterEstimate:
    """Return the parameter estimate of segments and their sums.

    Nonlinear models are linearised again in each iteration.
    """
    models = models_of(priors)
    slices, _ = slices_of(models)

    def relinearise(theta: FloatArray) -> SegmentSums:
        about = [{name: theta[s][part] for name, part in slices.items()} for s in sums.subject]
        return integrate(segments, models, about)

    linear = all(map(is_linear, models.values()))
    prior = hierarchy_of(priors, recording_std, segments[0].context_names)
    return estimate_sums(sums, prior, models, loss, None if linear else relinearise)


def estimate_sums(
    sums: SegmentSums,
    hierarchy: Hierarchy,
    models: Mapping[str, StepLengthModel],
    loss: str = "gnc",
    relinearise: Callable[[FloatArray], SegmentSums] | None = None,
) -> ParameterEstimate:
    """Return the parameter estimate of sums. ValueError names the parameters that the data do not determine."""
    try:
        return estimate_parameters(sums, hierarchy, loss, relinearise)
    except SingularError as error:
        names = [f"{name} k{i}" for name, model in models.items() for i in range(model.n_params)]
        free = np.flatnonzero((hierarchy.std > 0) | (hierarchy.between_std > 0))
        which = ", ".join(names[free[i]] for i in error.indices) or "all parameters"
        raise ValueError(
            f"the segments do not determine {which} (no steps of the context, or all at one speed): give these "
            "parameters a prior (std less than inf), hold them (std 0), or add segments at other speeds"
        ) from error


def left_out_errors(
    segments: Sequence[Segment], forms: Mapping[str, Priors], loss: str = "gnc", recording_std: float = RECORDING_STD
) -> tuple[dict[str, FloatArray], BoolArray]:
    """Return the relative errors of step-length models on held-out segments.

    The cross-validation has five folds. It holds out whole people, or whole recordings if there are fewer than five
    people.

    Parameters
    ----------
    segments : sequence of Segment
        N segments of known length.
    forms : mapping of str to mapping of str to StepLengthPrior
        Priors of all contexts, by the name of the model.
    loss : {"gnc", "cauchy", "huber", "none"}
        Robust loss of the calibration.
    recording_std : float, default RECORDING_STD
        Initial relative standard deviation of one person's scale between recordings.

    Returns
    -------
    errors : dict of str to array (N,)
        Predicted over known length minus one, by the name of the model.
    good : array (N,) of bool
        True for segments that are not an outlier under any of the models.

    Raises
    ------
    ValueError
        If the segments do not determine a parameter.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import pdr_filter as pdr
    >>> from pdr_filter.offline.calibration.model_forms import forms_of, left_out_errors
    >>> from pdr_filter.offline.calibration.segments import segments_of
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> (segment,), _ = segments_of(walk, pdr.track(walk))
    >>> segments = [segment, replace(segment, recording="second walk")]
    >>> errors, good = left_out_errors(segments, forms_of(model="bounce"))
    >>> good, bool(abs(errors["bounce"]).max() < 0.2)
    (array([ True,  True]), True)
    """
    errors: dict[str, FloatArray] = {}
    good = np.ones(len(segments), dtype=bool)
    for name, priors in forms.items():
        sums = integrate(segments, models_of(priors), prior_means(priors))
        fold = _groups(sums) % _N_FOLDS
        predicted = np.empty(len(sums))
        for k in np.unique(fold):
            training = fold != k
            seen = [segments[i] for i in np.flatnonzero(training).tolist()]
            found = estimate_segments(seen, sums.rows(training), priors, loss, recording_std)
            predicted[~training] = lengths(sums.rows(~training), found.people)
        errors[name] = predicted / sums.distance_m - 1
        good &= np.abs(estimate_segments(segments, sums, priors, loss, recording_std).misfit) <= OUTLIER_STDS
    return errors, good


def lengths(sums: SegmentSums, people: FloatArray) -> FloatArray:
    """Return the predicted lengths (N,) of segments, each with the parameters of its person, for linear models.

    `people` (S, P) are the parameters of all people.
    """
    vector = np.einsum("ndp,np->nd", sums.regressors, people[sums.subject]) + sums.offset_m
    return np.hypot(vector[:, 0], vector[:, 1])


def best_form(
    segments: Sequence[Segment],
    forms: Mapping[str, Priors],
    loss: str,
    recording_std: float,
    walking: str = "walking",
) -> tuple[str, list[str]]:
    """Return the name of the best model of the context `walking`, and a list with a note about the choice.

    The first model is kept unless another one has a clearly smaller held-out error on the segments of walking. The
    error must be smaller by the fraction `_MIN_IMPROVEMENT`, and by two standard errors of the paired difference of
    squared errors. With a single model, or too few segments, people or recordings, there is no choice: the first model
    is returned with an empty list.
    """
    first = next(iter(forms))
    walked = [s for s in segments if s.context_names[int(np.argmax(s.steps_in))] == walking]
    groups = _groups_of([s.subject for s in walked], [s.recording for s in walked])
    n_groups = len(set(groups.tolist()))
    if len(forms) < 2 or len(walked) < MIN_SEGMENTS or n_groups < MIN_GROUPS:
        return first, []
    every = min(-(-len(walked) // _MAX_SEGMENTS), n_groups // MIN_GROUPS)
    some = [s for s, g in zip(walked, groups.tolist(), strict=True) if g % every == 0]
    errors, good = left_out_errors(some, forms, loss, recording_std)
    rms = {name: 100 * float(np.sqrt(np.square(e[good]).mean())) for name, e in errors.items()}
    best = min(rms, key=lambda name: rms[name])
    gained = (np.square(errors[first]) - np.square(errors[best]))[good]
    std = standard_error(gained, _groups_of([s.subject for s in some], [s.recording for s in some])[good])
    is_clear = rms[best] <= (1.0 - _MIN_IMPROVEMENT) * rms[first] and float(gained.mean()) >= 2.0 * std
    best, which = (best, f"clearly better than {first}") if is_clear else (first, "no other model is clearly better")
    others = ", ".join(f"{name} {value:.1f} %" for name, value in rms.items() if name != best)
    kind = "people" if n_groups == len({s.subject for s in walked}) else "recordings"
    n_left_out = len(range(0, n_groups, every))
    return best, [
        f"step lengths of walking by the model {best} ({len(forms)} models compared, {which}): error of "
        f"{rms[best]:.1f} % on held-out {kind} ({good.sum()} segments, {n_left_out} {kind}); {others}"
    ]


def standard_error(values: FloatArray, group: NDArray[Any]) -> float:
    """Return the standard error of the mean of values (N,) that are correlated within groups.

    sqrt(G / (G - 1) sum_g (sum_i (x_i - mean))^2) / N, where the inner sum is over the values of a group. The result is
    inf for fewer than two groups.
    """
    number = np.unique(group, return_inverse=True)[1]
    sums = np.bincount(number, values - values.mean())
    n_groups = len(sums)
    return float(np.sqrt(n_groups / (n_groups - 1) * (sums**2).sum()) / len(values)) if n_groups > 1 else np.inf


def _groups(sums: SegmentSums) -> IntArray:
    """Return the cross-validation group of each segment of the sums."""
    return _groups_of(sums.subject.tolist(), sums.recording.tolist())


def _groups_of(subject: Sequence[object], recording: Sequence[object]) -> IntArray:
    """Return the group number of each segment, in order of appearance.

    Groups are people, or recordings if there are fewer than five people.
    """
    names = subject if len(set(subject)) >= MIN_GROUPS else recording
    order = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], dtype=np.int64)
